"""Numbers of a description that may vary from run to run, read and replaced by name.

A `Variable` is an element with such numbers; a `Function` is a function of time with such numbers.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any, ClassVar, Self, TypeVar

import numpy as np

from newton_euler.model.fields import NumberField
from newton_euler.scalars import Array, Scalar

T = TypeVar("T")

Change = Callable[..., Any]
"""Copies an object with other values of some fields: `altered` without checks, or `dataclasses.replace`."""

PART_UNITS = {"angular_frequency": "rad/s", "phase": "rad"}
"""Units of the numbers in which functions of time are not linear, by names that follow the attribute's."""

COORDINATE_INDEX = "which coordinate it is"  # reason in messages: an index does not vary


def altered(thing: T, **fields: Any) -> T:
    """Copy a frozen object with other values of some fields, which are not checked.

    Cached properties are not copied, because they were computed from the old values.
    """
    changed = copy.copy(thing)
    for name in list(vars(changed)):
        if isinstance(getattr(type(thing), name, None), cached_property):
            del vars(changed)[name]
    for name, value in fields.items():
        object.__setattr__(changed, name, value)
    return changed


class Function:
    """A function of time that is given by numbers. The base class is smooth at all times.

    Attributes:
        parts: names of fields by part. Part "" has the fields in which the function is linear; other parts
            are the keys of `PART_UNITS`.
        constant: reasons why fields do not vary, by the field's name.
    """

    parts: ClassVar[Mapping[str, tuple[str, ...]]]
    constant: ClassVar[Mapping[str, str]] = {}

    @property
    def knots(self) -> tuple[float, ...]:
        """Times, s, at which a derivative of the function jumps."""
        return ()

    @property
    def jumps(self) -> tuple[float, ...]:
        """The knots, s, at which the value of the function jumps."""
        return ()

    @property
    def numbers(self) -> int:
        """The count of numbers that determine the function between two knots."""
        return 0

    @property
    def is_constant(self) -> bool:
        """True if the value is constant between two knots."""
        return False

    def covers(self, begin: float, end: float) -> bool:
        """Return True if the function is known at all times from `begin` to `end`, s."""
        return True

    def value(self, time: Scalar) -> Scalar:
        """Compute the value at a time in s: m or rad."""
        raise NotImplementedError

    def rate(self, time: Scalar) -> Scalar:
        """Compute the first derivative, m/s or rad/s."""
        raise NotImplementedError

    def acceleration(self, time: Scalar) -> Scalar:
        """Compute the second derivative, m/s^2 or rad/s^2."""
        raise NotImplementedError

    def piece(self, time: float) -> tuple[float, ...]:
        """Return the numbers that determine the function between the knots around a time in s."""
        return ()

    def on_piece(self, numbers: Sequence[Scalar]) -> Any:
        """Return the smooth function that the numbers of a `piece` determine; they are not checked."""
        return self

    def part(self, name: str) -> list[Scalar]:
        """Return the numbers of one of `parts`; an empty list for a part that the function lacks."""
        found: list[Scalar] = []
        for field in self.parts.get(name, ()):
            value = getattr(self, field)
            found.extend(value if isinstance(value, tuple | np.ndarray) else [value])
        return found

    def with_part(self, name: str, numbers: Any, change: Change) -> Self:
        """Return the function with other numbers for one of `parts`."""
        fields: dict[str, Any] = {}
        for field in self.parts.get(name, ()):
            if isinstance(getattr(self, field), tuple | np.ndarray):
                fields[field] = numbers
            else:
                fields[field], numbers = numbers[0], numbers[1:]
        return change(self, **fields) if fields else self


class Variable:
    """An element with numbers that may vary from run to run without a new compilation.

    Attributes:
        number_fields: declarations of the attributes that may vary, by name.
        constant: reasons why other attributes do not vary, by the attribute's name.
    """

    number_fields: ClassVar[Mapping[str, NumberField]] = {}
    constant: ClassVar[Mapping[str, str]] = {}

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of attributes that may vary, without points."""
        return tuple(name for name, field in self.number_fields.items() if not field.displaces)

    @property
    def points(self) -> tuple[str, ...]:
        """Names of attributes that are points of bodies; the displacement of a point varies."""
        return tuple(name for name, field in self.number_fields.items() if field.displaces)

    def field_of(self, name: str) -> NumberField:
        """Return the declaration of one of `variables`."""
        attribute, _, part = name.partition(".")
        field = self.number_fields[attribute]
        return replace(field, unit=PART_UNITS[part], unit_about="") if part else field

    def set_numbers(self, where: str) -> None:
        """Replace numbers and arrays by floats and read-only arrays, checked by `number_fields`.

        Raises:
            MechanismError: naming `where` and the attribute, for a value that the field does not take.
        """
        for name, field in self.number_fields.items():
            value = getattr(self, name)
            if field.shape is not None and not (field.may_be_function and isinstance(value, Function)):
                object.__setattr__(self, name, field.checked(where, name, value))

    @property
    def variables(self) -> tuple[str, ...]:
        """Names of all numbers that may vary: `ATTRIBUTE`, and `ATTRIBUTE.PART` of functions of time."""
        names: list[str] = []
        parts: list[str] = []
        for name in self.parameters:
            value = getattr(self, name)
            if isinstance(value, Mapping) and not value:
                continue
            names.append(name)
            functions = functions_of(value)
            parts += [f"{name}.{part}" for part in PART_UNITS if any(f.part(part) for f in functions)]
        return (*names, *self.points, *parts)

    @property
    def constants(self) -> dict[str, str]:
        """Reasons why numbers do not vary, by their names."""
        of_functions = {
            f"{attribute}.{name}": reason
            for attribute, field in self.number_fields.items()
            if field.may_be_function
            for function in functions_of(getattr(self, attribute))
            for name, reason in function.constant.items()
        }
        return {**self.constant, **of_functions}

    def number(self, name: str) -> Array:
        """Return the present value of one of `variables` as an array of floats; zero for a point."""
        if name in self.points:
            return np.zeros(3)
        attribute, _, part = name.partition(".")
        found = np.asarray(_numbers(getattr(self, attribute), part), dtype=float)
        return found.reshape(()) if part and found.size == 1 else found

    def varied(self, values: Mapping[str, Any]) -> Self:
        """Copy the element with other values of some `variables`; scalars of any kind, not checked."""
        return altered(self, **self.fields_with(values, altered))

    def rebuilt(self, values: Mapping[str, Any]) -> Self:
        """Construct the element again with other values of some `variables`.

        Raises:
            MechanismError: for a value that the constructor refuses.
        """
        return replace(self, **self.fields_with(values, replace))  # type: ignore[type-var]

    def fields_with(self, values: Mapping[str, Any], change: Change) -> dict[str, Any]:
        """Return the values of the fields that change if some `variables` have other values."""
        fields: dict[str, Any] = {}
        for name, value in values.items():
            attribute, _, part = name.partition(".")
            own = fields.get(attribute, getattr(self, attribute))
            fields[attribute] = own + value if name in self.points else _changed(own, part, value, change)
        return fields


def functions_of(value: Any) -> tuple[Any, ...]:
    """Return the functions of time in an attribute: the attribute itself, or values of a mapping."""
    if isinstance(value, Mapping):
        return tuple(each for each in value.values() if isinstance(each, Function))
    return (value,) if isinstance(value, Function) else ()


def _numbers(value: Any, part: str) -> Any:
    """Return the numbers of one part of an attribute; part "" is everything that is in no named part."""
    if isinstance(value, Function):
        return value.part(part)
    if isinstance(value, Mapping):
        rows = [_numbers(each, part) for each in value.values()]
        return rows if _is_table(value) else [number for row in rows for number in np.atleast_1d(row)]
    return [] if part else value


def _changed(own: Any, part: str, value: Any, change: Change) -> Any:
    """Return the value of an attribute with other numbers for one part."""
    if isinstance(own, Function):
        return own.with_part(part, (value,) if np.ndim(value) == 0 else tuple(value), change)
    if isinstance(own, Mapping):
        return _changed_values(own, part, value, change)
    return float(value) if isinstance(value, np.ndarray) and value.ndim == 0 else value


def _changed_values(own: Mapping[Any, Any], part: str, value: Any, change: Change) -> dict[Any, Any]:
    """Return a mapping with other numbers for one part, key by key."""
    if _is_table(own):
        return dict(zip(own, value, strict=True))
    found, numbers = dict(own), (value,) if np.ndim(value) == 0 else tuple(value)
    for key, each in own.items():
        count = np.size(_numbers(each, part))
        if count:
            of_one = numbers[:count] if isinstance(each, Function) else numbers[0]
            found[key] = _changed(each, part, of_one, change)
        numbers = numbers[count:]
    return found


def _is_table(values: Mapping[Any, Any]) -> bool:
    """Return True if a mapping has an array of numbers for each key."""
    return all(np.ndim(each) == 1 for each in values.values())
