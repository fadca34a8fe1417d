"""Descriptions: frozen dataclasses whose fields take whatever arrays and tuples are made of.

Type checkers take the types of an argument and of the attribute from the methods of a descriptor, if the
class has a decorator that is a `dataclass_transform`; with that of the standard library mypy does not. There
is no descriptor when a program runs: constructors make the arrays, see `newton_euler.errors.set_arrays`
and `elements_of`.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import MISSING, dataclass, field, fields
from typing import TYPE_CHECKING, Any, Generic, Self, TypeVar, dataclass_transform, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from newton_euler.scalars import Floats

C = TypeVar("C")
T = TypeVar("T")
LONGEST = 9  # numbers of an array that are shown one by one

if TYPE_CHECKING:

    class ArrayField:
        """A field that takes whatever NumPy makes an array of, and is an array of floats."""

        @overload
        def __get__(self, thing: None, owner: type) -> Self: ...
        @overload
        def __get__(self, thing: object, owner: type) -> Floats: ...
        def __get__(self, thing: object | None, owner: type) -> Self | Floats: ...
        def __set__(self, thing: object, value: ArrayLike) -> None: ...

    class IndexField:
        """A field that takes whatever NumPy makes an array of, and is an array of whole numbers."""

        @overload
        def __get__(self, thing: None, owner: type) -> Self: ...
        @overload
        def __get__(self, thing: object, owner: type) -> NDArray[np.int32]: ...
        def __get__(self, thing: object | None, owner: type) -> Self | NDArray[np.int32]: ...
        def __set__(self, thing: object, value: ArrayLike) -> None: ...

    class TupleField(Generic[T]):
        """A field that takes any number of things, and is a tuple of them."""

        @overload
        def __get__(self, thing: None, owner: type) -> Self: ...
        @overload
        def __get__(self, thing: object, owner: type) -> tuple[T, ...]: ...
        def __get__(self, thing: object | None, owner: type) -> Self | tuple[T, ...]: ...
        def __set__(self, thing: object, value: Iterable[T]) -> None: ...

    class DefaultArrayField(ArrayField):
        """A field that is made from the others where it is not given, or None."""

        def __set__(self, thing: object, value: ArrayLike | None) -> None: ...

else:
    ArrayField = DefaultArrayField = IndexField = NDArray
    TupleField = tuple


@dataclass_transform(
    eq_default=False, field_specifiers=(field,)
)  # mypy gives heirs of frozen ones other types
def description(kind: type[C]) -> type[C]:
    """Make a class a frozen dataclass whose instances equal nothing else, as they hold arrays."""
    if "__repr__" not in vars(kind):
        kind.__repr__ = _in_one_line  # type: ignore[method-assign]
    return dataclass(frozen=True, eq=False, repr=False)(kind)


def _in_one_line(thing: Any) -> str:
    """Return a constructor with what is not as by default; of long arrays the shapes."""
    found = []
    for each in fields(thing):
        value, default = getattr(thing, each.name), each.default
        if each.default_factory is not MISSING:
            default = each.default_factory()
        if not np.array_equal(value, default):  # type: ignore[arg-type]
            found.append(f"{each.name}={_text(value)}")
    return f"{type(thing).__name__}({', '.join(found)})"


def _text(value: object) -> str:
    if not isinstance(value, np.ndarray):
        return repr(value)
    if value.size > LONGEST:
        return f"<{' by '.join(map(str, value.shape))} numbers>"
    return str(value.tolist())
