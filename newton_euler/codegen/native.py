"""Mark Python functions that can be compiled to machine code, such as the integrators.

A function decorated with `native` is ordinary Python and runs as such. `newton_euler.codegen.translate` turns
the same function into LLVM text, for one run or for several runs at once. The function may contain:

- assignments, if, while, `for k in range(...)`, arithmetic and comparisons;
- elements `a[k]` and tails `a[k:]` of vectors, and fields of records;
- calls of other native functions, of callbacks, and of abs, min, max and sqrt;
- constants of module level: numbers, tables (tuples of floats) and members of an `IntEnum`.

Arguments are annotated `float`, `int`, an `IntEnum`, `Vector`, `Shared`, `Callback` or a subclass of
`Record`. Integers have 64 bits. `//` and `%` round towards zero, so they are meant for numbers that are not
negative.
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
"""Annotation: a vector of doubles, passed by address. Compiled for several runs at once, one in each lane of
the vector registers, it has separate elements for each lane."""

Shared = Array
"""Annotation: a vector of doubles that the runs in all lanes share. For one run it is the same as
`Vector`."""

Callback = Any
"""Annotation: a function f(x, y) that reads the vector x and writes the vector y, passed by address.

Native code adds a third argument, an integer. If bit i is 1, lane i is active, and the function writes its y.
In code for one run all bits are 1."""

TYPES = {
    "float": "double",
    "int": "i64",
    "Vector": "ptr",
    "Shared": "shared",
    "Callback": "fn",
    "None": "void",
}
"""Kind of a value (see `Kind`) by its annotation."""

F = TypeVar("F", bound=Callable[..., Any])
"""Type of a function that the decorator `native` returns unchanged."""


class Record:
    """Base class of frozen dataclasses that native functions take as one argument.

    Fields are numbers, vectors, callbacks and other records. A native function reads a field once, when it is
    called. Values that change during a run must be elements of vectors; `overwrite_with` replaces all fields.
    """

    kinds: ClassVar[dict[str, Kind]]
    """Kind of each field, in order."""

    layout: ClassVar[Struct]
    """Format of the fields in memory, 8 bytes each: a double, an integer or an address."""

    def __init_subclass__(cls) -> None:
        """Find the kinds and the layout of the fields from the annotations of the class, which are texts."""
        names = vars(sys.modules[cls.__module__])  # with other classes of records
        cls.kinds = {name: TYPES.get(hint) or names[hint] for name, hint in cls.__annotations__.items()}
        cls.layout = Struct("".join("d" if kind == "double" else "q" for kind in cls.kinds.values()))

    @cached_property
    def _packed(self) -> Any:
        """Memory block with the values of the fields, which lives as long as this object."""
        # a callback that is None has the address 0
        values = (address_of(getattr(self, name)) or 0 for name in self.kinds)
        return ctypes.create_string_buffer(self.layout.pack(*values), self.layout.size)

    @property
    def address(self) -> int:
        """Address of the memory block with the fields, valid as long as this object lives."""
        return ctypes.addressof(self._packed)

    def overwrite_with(self, other: Self) -> None:
        """Replace the fields that native code sees by those of another record, also while native code runs.

        Native functions that are called afterwards read the new fields. A callback can thus compile a
        function at its first use and put it into the record. The attributes that Python sees stay unchanged.
        """
        ctypes.memmove(self.address, other.address, self.layout.size)
        self.__dict__["_other"] = other  # keeps the memory that the other record's fields point to


def address_of(argument: Any) -> Any:
    """Return the address of an array of doubles, of a record or of a compiled function.

    Records and compiled functions have an attribute `address`. Numbers and None are returned unchanged.

    Raises:
        TypeError: if an array has elements of another type or is not contiguous.
    """
    if isinstance(argument, np.ndarray):
        if argument.dtype != np.float64 or not argument.flags.c_contiguous:
            raise TypeError(f"got an array of {argument.dtype}; needed: contiguous doubles")
        if argument.flags.writeable and argument.size:
            # much faster than `argument.ctypes.data`, which also works for read-only and empty arrays
            return ctypes.addressof(ctypes.c_char.from_buffer(argument.data))
        return argument.ctypes.data
    return getattr(argument, "address", argument)


Kind = str | type[Record]
"""Kind of a value in native code: "double", "i64" (an integer), "ptr" (a `Vector`), "shared" (a `Shared`
vector), "fn" (a callback), "void", or a class of records."""


class NativeError(TypeError):
    """Error for Python code that cannot be compiled to native code; the message names function and line."""


class Signature(NamedTuple):
    """Kinds of the arguments of a native function, by name, and of its result."""

    arguments: dict[str, Kind]
    result: str


def machine_type(kind: Kind) -> str:
    """Return the LLVM type of a kind; vectors, callbacks and records are pointers."""
    return "ptr" if kind in ("shared", "fn") or not isinstance(kind, str) else kind


_SIGNATURES: dict[Callable[..., Any], Signature] = {}
"""Signature of every function that is marked `native`."""


def native(function: F) -> F:
    """Mark a function as one that can be compiled to native code, and return it unchanged (a decorator).

    Raises:
        NativeError: if an argument or the result has an annotation that native code does not support.
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
    """Return the kinds of the arguments and of the result of a native function."""
    return _SIGNATURES[function]


def is_native(function: object) -> bool:
    """Return True for a function marked by `native`."""
    return function in _SIGNATURES
