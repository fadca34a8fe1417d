"""Prescribed joint motion: functions of time with their exact derivatives, over generic scalars."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Any

from newton_euler.errors import MechanismError, check_key, is_finite_number, set_numbers
from newton_euler.model.elements import OnCoordinate
from newton_euler.scalars import Scalar, cos, sin

HIGHEST = 1e15
"""rad/s, or rad: a double holds no part of a turn beyond."""


@dataclass(frozen=True)
class Polynomial:
    """c_0 + c_1 t + c_2 t^2 + ...

    Attributes:
        coefficients: c_k in m/s^k or rad/s^k.

    Raises:
        MechanismError: for coefficients that are no finite numbers.

    Examples:
        >>> Polynomial((0.1, 2.0)).value(3.0)
        6.1
    """

    coefficients: tuple[float, ...]

    def __post_init__(self) -> None:
        given: Any = self.coefficients
        if not isinstance(given, Iterable) or isinstance(given, str):
            given = ()
        given = tuple(given)
        if not given or not all(
            is_finite_number(c) and is_finite_number(k * k * c) for k, c in enumerate(given)
        ):
            needed = "one finite number or more, lowest power first"
            raise MechanismError("polynomial", f"coefficients is {self.coefficients!r:.100}", needed)
        object.__setattr__(self, "coefficients", tuple(float(c) for c in given))

    def value(self, time: Scalar) -> Scalar:
        """At a time in s: m or rad."""
        return _horner(self.coefficients, time)

    def rate(self, time: Scalar) -> Scalar:
        """First derivative, m/s or rad/s."""
        return _horner(_derived(self.coefficients), time)

    def acceleration(self, time: Scalar) -> Scalar:
        """Second derivative, m/s^2 or rad/s^2."""
        return _horner(_derived(_derived(self.coefficients)), time)


def _horner(coefficients: tuple[float, ...], time: Scalar) -> Scalar:
    total: Scalar = 0.0
    for c in reversed(coefficients):
        total = total * time + c
    return total


def _derived(coefficients: tuple[float, ...]) -> tuple[float, ...]:
    return tuple(k * c for k, c in enumerate(coefficients))[1:]


@dataclass(frozen=True)
class Sine:
    """offset + amplitude sin(angular_frequency t + phase).

    Attributes:
        amplitude, offset: m or rad.
        angular_frequency: rad/s.
        phase: rad.

    Raises:
        MechanismError: for a value that is no finite number.

    Examples:
        >>> float(Sine(amplitude=0.5, angular_frequency=2.0).rate(0.0))
        1.0
    """

    amplitude: float
    angular_frequency: float
    phase: float = 0.0
    offset: float = 0.0

    def __post_init__(self) -> None:
        set_numbers(self, "sine", ("amplitude", "angular_frequency", "phase", "offset"))
        w = self.angular_frequency
        if not is_finite_number(self.amplitude * w * w) or abs(w) > HIGHEST or abs(self.phase) > HIGHEST:
            problem = (
                f"amplitude is {self.amplitude:g}, angular_frequency {w:g} rad/s, phase {self.phase:g} rad"
            )
            needed = f"an acceleration that a double holds, and phases of at most {HIGHEST:g} rad"
            raise MechanismError("sine", problem, needed)

    def value(self, time: Scalar) -> Scalar:
        """At a time in s: m or rad."""
        return self.offset + self.amplitude * sin(self.angular_frequency * time + self.phase)

    def rate(self, time: Scalar) -> Scalar:
        """First derivative, m/s or rad/s."""
        w = self.angular_frequency
        return self.amplitude * w * cos(w * time + self.phase)

    def acceleration(self, time: Scalar) -> Scalar:
        """Second derivative, m/s^2 or rad/s^2."""
        w = self.angular_frequency
        return -(self.amplitude * w * w) * sin(w * time + self.phase)


@dataclass(frozen=True)
class Sum:
    """The sum of functions of time.

    Raises:
        MechanismError: for a term that is none.

    Examples:
        >>> float(Sum((Polynomial((1.0,)), Sine(0.5, 2.0))).value(0.0))
        1.0
    """

    terms: tuple[TimeFunction, ...]

    def __post_init__(self) -> None:
        given: Any = self.terms
        terms = tuple(given) if isinstance(given, Iterable) else ()
        if not terms or not all(isinstance(term, TimeFunction) for term in terms):
            problem = f"terms is {self.terms!r:.100}"
            raise MechanismError("sum", problem, "one or more of Polynomial, Sine and Sum")
        object.__setattr__(self, "terms", terms)

    def value(self, time: Scalar) -> Scalar:
        """At a time in s: m or rad."""
        return sum(term.value(time) for term in self.terms)

    def rate(self, time: Scalar) -> Scalar:
        """First derivative, m/s or rad/s."""
        return sum(term.rate(time) for term in self.terms)

    def acceleration(self, time: Scalar) -> Scalar:
        """Second derivative, m/s^2 or rad/s^2."""
        return sum(term.acceleration(time) for term in self.terms)


TimeFunction = Polynomial | Sine | Sum


def terms(function: TimeFunction) -> Iterator[Polynomial | Sine]:
    """Yield the terms of sums, of sums within them, too."""
    if isinstance(function, Sum):
        for term in function.terms:
            yield from terms(term)
    else:
        yield function


def scaled(function: TimeFunction, factor: float) -> TimeFunction:
    """Return a multiple of a function of time."""
    if isinstance(function, Sum):
        return Sum(tuple(scaled(term, factor) for term in function.terms))
    if isinstance(function, Sine):
        return replace(function, amplitude=factor * function.amplitude, offset=factor * function.offset)
    return Polynomial(tuple(factor * c for c in function.coefficients))


@dataclass(frozen=True)
class PrescribedMotion(OnCoordinate):
    """A joint coordinate that follows a function of time, whatever force that takes: x = f(t).

    Attributes:
        joint: name of the joint.
        function: f, in m or rad from the initial pose.
        coordinate: which of the joint's coordinates, from 0.

    Raises:
        MechanismError: naming the joint and the value at fault.

    Examples:
        >>> motion = PrescribedMotion("hinge", Polynomial((0.0, 2.0)))  # 2 rad/s
        >>> motion.function.rate(1.0)
        2.0
    """

    joint: str
    function: TimeFunction
    coordinate: int = 0

    noun = "motion"

    def __post_init__(self) -> None:
        where = self.element
        if not isinstance(self.function, TimeFunction):
            raise MechanismError(where, f"function is {self.function!r:.100}", "a Polynomial, Sine or Sum")
        check_key(where, self.joint, self.coordinate)
