"""Plain Python functions that become native code: the loops around traced programs, integrators above all.

A function decorated with `native` is ordinary Python over floats, integers, NumPy vectors and other
functions, and runs as such. `newton_euler.codegen.translate` gives the same function as LLVM text, for one
run or for several side by side. It may contain all that a method of integration needs: assignments, if,
while, `for k in range(...)`, arithmetic, comparisons, elements `a[k]` and tails `a[k:]` of vectors, fields of
records, calls of other native functions, of callbacks and of abs, min, max, sqrt. Arguments are annotated
`float`, `int`, an `IntEnum`, `Vector`, `Shared`, `Callback` or a subclass of `Record`. Tables of module level
(tuples of floats) and members of an `IntEnum` become constants.

Integers are 64 bit; `//` and `%` round towards zero and are meant for numbers that are not negative.
"""

from __future__ import annotations

import ctypes
import sys
from collections.abc import Callable
from enum import EnumType, IntEnum
from functools import cached_property
from struct import Struct
from typing import Any, ClassVar, NamedTuple, Self, TypeVar

import numpy as np

from newton_euler.scalars import Array

Vector = Array
"""A vector of doubles; native code gets its address."""

Shared = Array
"""A vector that runs in all lanes share; scalar code makes no difference."""

Callback = Any
"""A function f(x, y) that writes the vector y; native code gets its address.

Native code passes the lanes that are on as the bits of a third argument, all of them in scalar code: y stays
as it is in other lanes."""

TYPES = {
    "float": "double",
    "int": "i64",
    "Vector": "ptr",
    "Shared": "shared",
    "Callback": "fn",
    "None": "void",
}


F = TypeVar("F", bound=Callable[..., Any])


class Record:
    """Base of frozen dataclasses of numbers, vectors, callbacks and records, which native code gets as one
    pointer.

    Native functions read a field once, when they are entered; what changes in a run is in vectors.
    """

    kinds: ClassVar[dict[str, Kind]]
    """LLVM type of each field, in order, or the class of a record."""

    layout: ClassVar[Struct]
    """The fields in memory, 8 bytes each: a double, an integer or an address."""

    def __init_subclass__(cls) -> None:
        known = vars(sys.modules[cls.__module__])
        cls.kinds = {name: TYPES.get(hint) or known[hint] for name, hint in cls.__annotations__.items()}
        cls.layout = Struct("".join("d" if kind == "double" else "q" for kind in cls.kinds.values()))

    @cached_property
    def _packed(self) -> Any:
        """The fields in memory, alive as long as this object is."""
        values = (address_of(getattr(self, name)) or 0 for name in self.kinds)
        return ctypes.create_string_buffer(self.layout.pack(*values), self.layout.size)

    @property
    def address(self) -> int:
        """Address of the fields, valid as long as this object lives."""
        return ctypes.addressof(self._packed)

    def overwrite_with(self, other: Self) -> None:
        """Take the fields of another record, as native code sees them; it may call this."""
        ctypes.memmove(self.address, other.address, self.layout.size)
        self.__dict__["_other"] = other  # alive as long as this object is


def address_of(argument: Any) -> Any:
    """Return the address of an array of doubles, of a record or of a native function, anything else as it is.

    Raises:
        TypeError: for an array of another kind.
    """
    if isinstance(argument, np.ndarray):
        if argument.dtype != np.float64 or not argument.flags.c_contiguous:
            raise TypeError(f"got an array of {argument.dtype}; needed: contiguous doubles")
        if argument.flags.writeable and argument.size:
            return ctypes.addressof(
                ctypes.c_char.from_buffer(argument.data)
            )  # far quicker than `ctypes.data`
        return argument.ctypes.data
    return getattr(argument, "address", argument)


Kind = str | type[Record]
"""Type of a value: double, i64, ptr (a vector), shared (by all lanes), fn (a callback), void, or a record."""


class NativeError(TypeError):
    """Python that native code cannot express, with the function and the line."""


class Signature(NamedTuple):
    """Types of a function's arguments (name: type) and result."""

    arguments: dict[str, Kind]
    result: str


def machine_type(kind: Kind) -> str:
    """Return LLVM's own type of a kind: vectors, callbacks and records are pointers."""
    return "ptr" if kind in ("shared", "fn") or not isinstance(kind, str) else kind


_SIGNATURES: dict[Callable[..., Any], Signature] = {}


def native(function: F) -> F:
    """Mark a function for native code; returns it unchanged.

    Raises:
        NativeError: for an annotation that native code does not know.
    """
    kinds: dict[str, Any] = {}
    for name, hint in function.__annotations__.items():
        kind = TYPES.get(hint) or function.__globals__.get(hint)
        if isinstance(kind, EnumType) and issubclass(kind, IntEnum):
            kind = "i64"
        if not isinstance(kind, str) and not (isinstance(kind, type) and issubclass(kind, Record)):
            raise NativeError(f"{function.__name__}: unknown type {hint!r}")
        kinds[name] = kind
    result = kinds.pop("return", "void")
    _SIGNATURES[function] = Signature(kinds, result)
    return function


def signature_of(function: Callable[..., Any]) -> Signature:
    """Return the LLVM types of a native function."""
    return _SIGNATURES[function]


def is_native(function: object) -> bool:
    """Return True for a function marked by `native`."""
    return function in _SIGNATURES
