"""Decorator and field types for the frozen dataclasses that describe bodies, joints, forces and scenes.

Constructors accept any input that NumPy can convert to an array, such as a list, but the attribute is an
array. The field types `ArrayField`, `IndexField`, `TupleField` and `DefaultArrayField` explain this to type
checkers: `__set__` has the type of the constructor argument and `__get__` the type of the attribute. mypy
uses these two types only if the class decorator is marked with `dataclass_transform`; hence the decorator
`description`.

The field types exist for type checkers only. In a running program the constructors convert the values, see
`set_finite_arrays` and `elements_of` in `newton_euler.errors`.
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
MAX_SHOWN_NUMBERS = 9
"""Size of the largest array whose numbers `repr` shows; of a larger array `repr` shows the shape."""

if TYPE_CHECKING:

    class ArrayField:
        """A field whose constructor argument is anything that NumPy converts, and whose attribute is a float
        array."""

        @overload
        def __get__(self, thing: None, owner: type) -> Self: ...
        @overload
        def __get__(self, thing: object, owner: type) -> Floats: ...
        def __get__(self, thing: object | None, owner: type) -> Self | Floats: ...
        def __set__(self, thing: object, value: ArrayLike) -> None: ...

    class IndexField:
        """A field whose constructor argument is anything that NumPy converts, and whose attribute is an int
        array."""

        @overload
        def __get__(self, thing: None, owner: type) -> Self: ...
        @overload
        def __get__(self, thing: object, owner: type) -> NDArray[np.int32]: ...
        def __get__(self, thing: object | None, owner: type) -> Self | NDArray[np.int32]: ...
        def __set__(self, thing: object, value: ArrayLike) -> None: ...

    class TupleField(Generic[T]):
        """A field whose constructor argument is any iterable of T, and whose attribute is a tuple of T."""

        @overload
        def __get__(self, thing: None, owner: type) -> Self: ...
        @overload
        def __get__(self, thing: object, owner: type) -> tuple[T, ...]: ...
        def __get__(self, thing: object | None, owner: type) -> Self | tuple[T, ...]: ...
        def __set__(self, thing: object, value: Iterable[T]) -> None: ...

    class DefaultArrayField(ArrayField):
        """An `ArrayField` that may be omitted or None; the constructor then computes it from the other
        fields."""

        def __set__(self, thing: object, value: ArrayLike | None) -> None: ...

else:
    ArrayField = DefaultArrayField = IndexField = NDArray
    TupleField = tuple


# frozen_default is not set, because mypy then ignores the field types of this module in subclasses
@dataclass_transform(eq_default=False, field_specifiers=(field,))
def description(kind: type[C]) -> type[C]:
    """Make a class a frozen dataclass with a short `repr` and comparison by identity.

    Instances with equal values are not equal, because comparison of array attributes has no single truth
    value.
    """
    if "__repr__" not in vars(kind):
        kind.__repr__ = _in_one_line  # type: ignore[method-assign]
    return dataclass(frozen=True, eq=False, repr=False)(kind)


def _in_one_line(thing: Any) -> str:
    """Return the `repr` of an instance: a constructor call with the fields that differ from their
    defaults."""
    arguments = []
    for each in fields(thing):
        value, default = getattr(thing, each.name), each.default
        if each.default_factory is not MISSING:
            default = each.default_factory()
        if not np.array_equal(value, default):  # type: ignore[arg-type]
            arguments.append(f"{each.name}={_text(value)}")
    return f"{type(thing).__name__}({', '.join(arguments)})"


def _text(value: object) -> str:
    """Format the value of a field for `repr`; an array of more than `MAX_SHOWN_NUMBERS` numbers as its
    shape."""
    if not isinstance(value, np.ndarray):
        return repr(value)
    if value.size > MAX_SHOWN_NUMBERS:
        return f"<{' by '.join(map(str, value.shape))} numbers>"
    return str(value.tolist())
