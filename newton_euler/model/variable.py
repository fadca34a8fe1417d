"""Read and replace, by name, the numbers of a model that may vary from run to run.

`Variable` is the base class of bodies, joints, couplings, forces and control laws; `Function` is the base
class of functions of time. Parameter studies, fits and sensitivities name a number (`mass`, `target.phase`)
and give another value: `Variable.rebuilt` checks the value, `Variable.varied` accepts any scalar, such as a
symbolic expression of the code generator. The values that a number may take are declared in
`newton_euler.model.fields`.

An attribute of an element is a number, an array, a function of time, or a mapping. The mappings are those of
state feedback (`newton_euler.model.control.StateFeedback`): from joint coordinates to gains, which are
arrays, or to targets, which are numbers or functions of time.
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
"""Function that copies an object with other values of some fields, given as keywords.

The function is either `altered`, which does not check the values, or `dataclasses.replace`, which calls the
constructor and so checks them.
"""

PART_UNITS = {"angular_frequency": "rad/s", "phase": "rad"}
"""Units of the nonlinear parts of functions of time, see `Function`.

The parameter of such a part is named ATTRIBUTE.PART, such as `target.phase`.
"""

INDEX_REASON = "the index that selects a joint coordinate"
"""Reason why the index of a joint coordinate cannot vary, see `Variable.constant`."""


def altered(thing: T, **fields: Any) -> T:
    """Copy a frozen object with other, unchecked values of some fields.

    Cached properties are not copied, because they were computed from the old values.

    Args:
        thing: the object to copy.
        fields: new values by field name.
    """
    changed = copy.copy(thing)
    for name in list(vars(changed)):
        if isinstance(getattr(type(thing), name, None), cached_property):
            del vars(changed)[name]
    for name, value in fields.items():
        object.__setattr__(changed, name, value)
    return changed


class Function:
    """Base class of functions of time, which are given by numbers.

    The value of a function depends linearly on some of its numbers, such as an amplitude, and nonlinearly on
    others, such as a phase. The numbers are therefore grouped in parts. A function is smooth between its
    knots: times at which a derivative jumps. The methods of this class are those of a function without knots.

    Attributes:
        parts: names of the fields of each part. Part "" has the fields in which the function is linear; the
            other parts are "angular_frequency" and "phase", see `PART_UNITS`.
        constant: reasons, by field name, why fields cannot vary, see `Variable.constant`.
    """

    parts: ClassVar[Mapping[str, tuple[str, ...]]]
    constant: ClassVar[Mapping[str, str]] = {}

    @property
    def knots(self) -> tuple[float, ...]:
        """Times, s, at which a derivative of the function jumps."""
        return ()

    @property
    def jumps(self) -> tuple[float, ...]:
        """Times, s, at which the value of the function jumps; they are among the knots."""
        return ()

    @property
    def piece_size(self) -> int:
        """Count of the numbers that `piece` returns; 0 for a function without knots."""
        return 0

    @property
    def rests(self) -> bool:
        """True if the value is constant between some neighboring knots, see `is_constant_at`."""
        return False

    def is_constant_at(self, time: float) -> bool:
        """Return True if the value is constant between the two knots around a time in s."""
        return False

    def covers(self, begin: float, end: float) -> bool:
        """Return True if the function is defined at all times from `begin` to `end`, s."""
        return True

    def value(self, time: Scalar) -> Scalar:
        """Compute the value at a time in s; m or rad for the motion of a joint coordinate."""
        raise NotImplementedError

    def rate(self, time: Scalar) -> Scalar:
        """Compute the first derivative by time at a time in s; m/s or rad/s for a motion."""
        raise NotImplementedError

    def acceleration(self, time: Scalar) -> Scalar:
        """Compute the second derivative by time at a time in s; m/s^2 or rad/s^2 for a motion."""
        raise NotImplementedError

    def piece(self, time: float) -> tuple[float, ...]:
        """Return the numbers that determine the function between the two knots around a time in s; at a knot,
        those of the piece that begins there.

        A compiled program takes these numbers as parameters in place of the variables of the function; they
        are replaced at each knot.
        """
        return ()

    def on_piece(self, numbers: Sequence[Scalar]) -> Any:
        """Build the smooth function between two knots from its numbers.

        Args:
            numbers: unchecked numbers in the order of `piece`; floats, or symbols of the code generator.
        """
        return self

    def part(self, name: str) -> list[Scalar]:
        """Return the numbers of one part, see `parts`; an empty list if the function has no such part."""
        numbers: list[Scalar] = []
        for field in self.parts.get(name, ()):
            value = getattr(self, field)
            numbers.extend(value if isinstance(value, tuple | np.ndarray) else [value])
        return numbers

    def with_part(self, name: str, numbers: Any, change: Change) -> Self:
        """Copy the function with other numbers for one part, see `parts`.

        Args:
            name: name of the part.
            numbers: new numbers, in the order of `part`.
            change: function that makes the copy.
        """
        fields: dict[str, Any] = {}
        for field in self.parts.get(name, ()):
            if isinstance(getattr(self, field), tuple | np.ndarray):
                fields[field] = numbers  # an array is the only field of its part
            else:
                fields[field], numbers = numbers[0], numbers[1:]
        return change(self, **fields) if fields else self


class Variable:
    """Base class of model elements with numbers that may vary from run to run.

    Compiled equations of motion take these numbers as parameters, so that a new value needs no compilation.

    Attributes:
        number_fields: declarations of the attributes that may vary, by attribute name.
        constant: reasons, by attribute name, why other attributes cannot vary. A reason completes the error
            message "parameter NAME: is REASON".
    """

    number_fields: ClassVar[Mapping[str, NumberField]] = {}
    constant: ClassVar[Mapping[str, str]] = {}

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of the attributes that may vary, except points fixed in bodies (see `points`)."""
        return tuple(name for name, field in self.number_fields.items() if not field.displaces)

    @property
    def points(self) -> tuple[str, ...]:
        """Names of the attributes that are points fixed in bodies; their variable is the displacement (3,) of
        the point, m."""
        return tuple(name for name, field in self.number_fields.items() if field.displaces)

    def field_of(self, name: str) -> NumberField:
        """Return the declaration of one number, by a name from `variables`."""
        attribute, _, part = name.partition(".")
        field = self.number_fields[attribute]
        # `unit_about` is the unit at a hinge if it differs from the unit at a slide; the unit of a part, such
        # as rad of a phase, is the same at both
        return replace(field, unit=PART_UNITS[part], unit_about="") if part else field

    def set_numbers(self, where: str) -> None:
        """Check the attributes of a new object, and convert them to floats and read-only arrays.

        Args:
            where: name of the element, for error messages.

        Raises:
            MechanismError: naming `where` and the attribute, for a value that `number_fields` does not allow.
        """
        for name, field in self.number_fields.items():
            value = getattr(self, name)
            # the class of this element checks attributes without a declared shape, such as mappings
            if field.shape is not None and not (field.may_be_function and isinstance(value, Function)):
                object.__setattr__(self, name, field.checked(where, name, value))

    @property
    def variables(self) -> tuple[str, ...]:
        """Names of all numbers that may vary: ATTRIBUTE, and ATTRIBUTE.PART for the nonlinear parts of
        functions of time, such as `target.phase`."""
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
        """Reasons why numbers cannot vary, by name: ATTRIBUTE, or ATTRIBUTE.FIELD for a field of a function
        of time."""
        of_functions = {
            f"{attribute}.{name}": reason
            for attribute, field in self.number_fields.items()
            if field.may_be_function
            for function in functions_of(getattr(self, attribute))
            for name, reason in function.constant.items()
        }
        return {**self.constant, **of_functions}

    def number(self, name: str) -> Array:
        """Return the present value of one of `variables` as an array of floats.

        The linear numbers of a function of time are a vector. A nonlinear part of one number, such as the
        phase of one sine, is a scalar (): users give one number for it.

        A point has the value zeros (3,), because its variable is the displacement from the described point.
        """
        if name in self.points:
            return np.zeros(3)
        attribute, _, part = name.partition(".")
        numbers = np.asarray(_numbers(getattr(self, attribute), part), dtype=float)
        return numbers.reshape(()) if part and numbers.size == 1 else numbers

    def varied(self, values: Mapping[str, Any]) -> Self:
        """Copy the element with other, unchecked values of some `variables`.

        Args:
            values: new values by name; floats, or other scalars such as expressions of the code generator.
        """
        return altered(self, **self.fields_with(values, altered))

    def rebuilt(self, values: Mapping[str, Any]) -> Self:
        """Construct the element again with other values of some `variables`, and check them.

        Args:
            values: new values by name.

        Raises:
            MechanismError: for a value that the constructor refuses.
        """
        return replace(self, **self.fields_with(values, replace))  # type: ignore[type-var]

    def fields_with(self, values: Mapping[str, Any], change: Change) -> dict[str, Any]:
        """Return the new values of the fields that change if some `variables` have other values.

        Args:
            values: new values by name from `variables`; for a point, its displacement.
            change: function that copies a function of time with new numbers, see `Change`.
        """
        fields: dict[str, Any] = {}
        for name, value in values.items():
            # Several variables may be parts of one attribute, so that an earlier one may have changed it
            attribute, _, part = name.partition(".")
            present = fields.get(attribute, getattr(self, attribute))
            if name in self.points:
                fields[attribute] = present + value
            else:
                fields[attribute] = _changed(present, part, value, change)
        return fields


def functions_of(value: Any) -> tuple[Any, ...]:
    """Return the functions of time in an attribute: the attribute itself, or those among the values of a
    mapping."""
    if isinstance(value, Mapping):
        return tuple(each for each in value.values() if isinstance(each, Function))
    return (value,) if isinstance(value, Function) else ()


def _numbers(value: Any, part: str) -> Any:
    """Return the numbers of one part of an attribute, see `Function.parts`.

    Part "" of a function of time has the numbers on which the value depends linearly; part "" of a number or
    an array is the number or array. The numbers of a mapping are those of its values, in order: one row per
    value if each value is an array, else one list.
    """
    if isinstance(value, Function):
        return value.part(part)
    if isinstance(value, Mapping):
        rows = [_numbers(each, part) for each in value.values()]
        return rows if _is_table(value) else [number for row in rows for number in np.atleast_1d(row)]
    return [] if part else value


def _changed(present: Any, part: str, value: Any, change: Change) -> Any:
    """Return an attribute with other numbers for one part.

    Args:
        present: present value of the attribute: a number, an array, a function of time, or a mapping to such
            values.
        part: name of the part, see `Function.parts`.
        value: new numbers, in the order of `_numbers`.
        change: function that copies a function of time, see `Change`.
    """
    if isinstance(present, Function):
        return present.with_part(part, (value,) if np.ndim(value) == 0 else tuple(value), change)
    if isinstance(present, Mapping):
        return _changed_values(present, part, value, change)
    return float(value) if isinstance(value, np.ndarray) and value.ndim == 0 else value


def _changed_values(present: Mapping[Any, Any], part: str, value: Any, change: Change) -> dict[Any, Any]:
    """Return a mapping with other numbers for one part of its values; arguments as of `_changed`."""
    if _is_table(present):
        return dict(zip(present, value, strict=True))
    # Hand out the numbers to the values in order, as many as each value has in this part
    changed, numbers = dict(present), (value,) if np.ndim(value) == 0 else tuple(value)
    for key, each in present.items():
        count = np.size(_numbers(each, part))
        if count:
            # a value that is no function is one number, because arrays do not mix with other values
            new = numbers[:count] if isinstance(each, Function) else numbers[0]
            changed[key] = _changed(each, part, new, change)
        numbers = numbers[count:]
    return changed


def _is_table(values: Mapping[Any, Any]) -> bool:
    """Return True if each value of a mapping is an array of numbers, such as the gains of state feedback."""
    return all(np.ndim(each) == 1 for each in values.values())
