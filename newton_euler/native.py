"""Plain Python functions that become native code: the loops around traced programs, integrators above all.

A function decorated with `native` is ordinary Python over floats, integers, NumPy vectors and other
functions, and runs as such. `newton_euler.translate` gives the same function as LLVM text. What it may
contain is what an integrator needs: assignments, if, while, `for k in range(...)`, arithmetic, comparisons,
elements `a[k]` and tails `a[k:]` of vectors, calls of other native functions, of functions passed as
arguments and of abs, min, max, sqrt. Arguments are annotated `float`, `int`, `Vector` or `Callback`; tables
of module level (tuples of floats) become constants.

Integers are 64 bit; `//` and `%` round towards zero and are meant for numbers that are not negative.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple, TypeVar

from newton_euler.scalars import Array

Vector = Array
"""A vector of doubles; native code gets its address."""

Callback = Callable[[Array, Array], None]
"""A function f(x, y) that writes the vector y; native code gets its address."""

TYPES = {"float": "double", "int": "i64", "Vector": "ptr", "Callback": "fn", "None": "void"}


F = TypeVar("F", bound=Callable[..., Any])


class NativeError(TypeError):
    """Python that `native` does not speak; names the function and the line."""


class Signature(NamedTuple):
    """LLVM types of a function's arguments (name: type) and result."""

    arguments: dict[str, str]
    result: str


def machine_type(kind: str) -> str:
    """LLVM's own type for one of those that values have here: a function to call is a pointer."""
    return "ptr" if kind == "fn" else kind


_SIGNATURES: dict[Callable[..., Any], Signature] = {}


def native(function: F) -> F:
    """Mark a function for native code; returns it unchanged."""
    hints = dict(function.__annotations__)
    try:
        result = TYPES[str(hints.pop("return", "None"))]
        arguments = {name: TYPES[str(hint)] for name, hint in hints.items()}
    except KeyError as error:
        raise NativeError(f"{function.__name__}: unknown type {error}") from error
    _SIGNATURES[function] = Signature(arguments, result)
    return function


def signature_of(function: Callable[..., Any]) -> Signature:
    """LLVM types of a native function."""
    return _SIGNATURES[function]


def is_native(function: object) -> bool:
    """Whether something is a function marked by `native`."""
    return function in _SIGNATURES
