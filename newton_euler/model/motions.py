"""Prescribed motions of joint coordinates, and sums of functions of time.

`TimeFunction` is the type of all functions of time that motions, control laws and wind accept: polynomials,
sines, splines, steps, moves and sums of them. `PrescribedMotion` makes a joint coordinate follow such a
function. A function is smooth between its knots: times at which a derivative jumps.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Self, assert_never

import numpy as np

from newton_euler.errors import MechanismError, check_key, items_of, quoted
from newton_euler.model.elements import OnCoordinate
from newton_euler.model.fields import NumberField
from newton_euler.model.smooth_functions import Polynomial, Sine
from newton_euler.model.splines import Moves, Piecewise, Spline, Steps
from newton_euler.model.variable import Change, Function
from newton_euler.scalars import Array, Scalar


@dataclass(frozen=True)
class Sum(Function):
    """The sum of several functions of time.

    Attributes:
        terms: one or more functions of time; a sum may be a term of a sum.

    Raises:
        MechanismError: for a term that is not a function of time.

    Examples:
        >>> float(Sum((Polynomial((1.0,)), Sine(0.5, 2.0))).value(0.0))
        1.0
    """

    terms: tuple[TimeFunction, ...]

    # Lists of numbers, such as those of `piece` and `part`, have the numbers of the first term first. The
    # argument `change` of `with_part` copies an object with other fields: `dataclasses.replace`, or a
    # function that does not check the fields.

    def __post_init__(self) -> None:
        terms = items_of(self.terms) or ()
        if not terms or not all(isinstance(term, TimeFunction) for term in terms):
            problem = f"terms is {quoted(self.terms)}"
            raise MechanismError(
                "sum", problem, "one or more of Polynomial, Sine, Spline, Steps, Moves and Sum"
            )
        object.__setattr__(self, "terms", terms)

    @property
    def knots(self) -> tuple[float, ...]:
        return tuple(sorted({knot for term in self.terms for knot in term.knots}))

    @property
    def jumps(self) -> tuple[float, ...]:
        return tuple(sorted({jump for term in self.terms for jump in term.jumps}))

    @property
    def piece_size(self) -> int:
        return sum(term.piece_size for term in self.terms)

    @property
    def constant(self) -> Mapping[str, str]:  # type: ignore[override]
        """Reasons, by field name, why fields of the terms cannot vary from run to run."""
        return {name: reason for term in self.terms for name, reason in term.constant.items()}

    @property
    def rests(self) -> bool:
        return all(term.rests for term in self.terms)

    def is_constant_at(self, time: float) -> bool:
        return all(term.is_constant_at(time) for term in self.terms)

    def covers(self, begin: float, end: float) -> bool:
        return all(term.covers(begin, end) for term in self.terms)

    def piece(self, time: float) -> tuple[float, ...]:
        return tuple(number for term in self.terms for number in term.piece(time))

    def on_piece(self, numbers: Sequence[Scalar]) -> Sum:
        terms: list[TimeFunction] = []
        for term in self.terms:
            terms.append(term.on_piece(numbers[: term.piece_size]))
            numbers = numbers[term.piece_size :]
        return Sum(tuple(terms))

    def part(self, name: str) -> list[Scalar]:
        return [number for term in self.terms for number in term.part(name)]

    def with_part(self, name: str, numbers: Any, change: Change) -> Self:
        terms: list[TimeFunction] = []
        for term in self.terms:
            count = len(term.part(name))
            terms.append(term.with_part(name, numbers[:count], change))
            numbers = numbers[count:]
        return change(self, terms=tuple(terms))

    def value(self, time: Scalar) -> Scalar:
        return sum(term.value(time) for term in self.terms)

    def rate(self, time: Scalar) -> Scalar:
        return sum(term.rate(time) for term in self.terms)

    def acceleration(self, time: Scalar) -> Scalar:
        return sum(term.acceleration(time) for term in self.terms)


TimeFunction = Polynomial | Sine | Spline | Steps | Moves | Sum
"""Every kind of function of time that a user can give."""


def terms(function: TimeFunction) -> Iterator[Polynomial | Sine | Spline | Steps | Moves]:
    """Yield the functions that a function of time is a sum of; sums within sums are flattened."""
    if isinstance(function, Sum):
        for term in function.terms:
            yield from terms(term)
    else:
        yield function


def scaled(function: TimeFunction, factor: float) -> TimeFunction:
    """Return a function of time multiplied by a number."""
    # part "" has the numbers on which the function depends linearly
    return function.with_part("", [factor * number for number in function.part("")], replace)


def shifted(function: TimeFunction, by: float) -> TimeFunction:
    """Return a function of time with the constant `by` added to its value at all times."""
    if isinstance(function, Sum):
        return Sum((shifted(function.terms[0], by), *function.terms[1:]))
    if isinstance(function, Sine):
        return replace(function, offset=function.offset + by)
    if isinstance(function, Piecewise):
        return replace(function, values=function.values + by)
    if isinstance(function, Polynomial):
        constant, *others = function.coefficients
        return replace(function, coefficients=(constant + by, *others))
    assert_never(function)


def piece_numbers(functions: Iterable[TimeFunction], time: float) -> Array:
    """Return the numbers that determine several functions between the knots (breakpoints) around a time in s.

    The result is one array: the numbers of the first function, then those of the second, ..., see
    `Function.piece`. Compiled equations of motion take them as parameters and get new numbers at each knot.
    """
    return np.array([number for function in functions for number in function.piece(time)])


def on_piece(value: Any, numbers: list[Any]) -> Any:
    """Replace the functions of time in an attribute by their smooth pieces between two knots (breakpoints).

    Args:
        value: the attribute: a function of time, or a mapping whose values may be functions of time.
        numbers: numbers of the pieces of all functions in the attribute, one after the other, see
            `Function.piece`: floats, or symbols of the code generator.
    """
    if isinstance(value, TimeFunction):
        return value.on_piece(numbers)
    changed = dict(value)
    for key, each in value.items():
        if isinstance(each, TimeFunction):
            changed[key] = each.on_piece(numbers[: each.piece_size])
            numbers = numbers[each.piece_size :]
    return changed


@dataclass(frozen=True)
class PrescribedMotion(OnCoordinate):
    """A prescribed joint coordinate x = f(t). The joint applies whatever force the motion needs.

    Attributes:
        joint: name of the joint.
        function: f, in m or rad from the initial pose; without jumps.
        coordinate: index of the joint coordinate, from 0.

    Raises:
        MechanismError: naming the joint and the invalid value.

    Examples:
        >>> motion = PrescribedMotion("hinge", Polynomial((0.0, 2.0)))  # 2 rad/s
        >>> motion.function.rate(1.0)
        2.0
    """

    joint: str
    function: TimeFunction
    coordinate: int = 0

    noun = "motion"
    # The numbers of the function may vary from run to run. The constructor checks them (shape=None); a change
    # moves the pose in which loops are closed at the start (moves_loops)
    number_fields: ClassVar = {"function": NumberField(shape=None, may_be_function=True, moves_loops=True)}
    kind_of_parameters = ".motion"  # names of parameters in studies: `hinge.motion.function`

    def __post_init__(self) -> None:
        where, needed = self.element, "a Polynomial, Sine, Spline, Moves or Sum"
        if not isinstance(self.function, TimeFunction):
            raise MechanismError(where, f"function is {quoted(self.function)}", needed)
        if self.function.jumps:
            problem = f"function jumps at {self.function.jumps[0]:.9g} s"
            raise MechanismError(where, problem, f"{needed}, which has accelerations")
        check_key(where, self.joint, self.coordinate)

    def held_at_start(self) -> PrescribedMotion:
        """Return a motion that holds the coordinate at its value at time 0."""
        return replace(self, function=Polynomial((float(self.function.value(0.0)),)))
