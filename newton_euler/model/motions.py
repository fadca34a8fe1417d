"""Prescribed joint motion: functions of time with their exact derivatives, over generic scalars."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from newton_euler.errors import MechanismError, check_key, is_finite_number, set_numbers
from newton_euler.model.description import ArrayField, description
from newton_euler.model.elements import OnCoordinate
from newton_euler.scalars import Scalar, cos, sin

HIGHEST = 1e15
"""rad/s, or rad: a double holds no part of a turn beyond."""

DEGREE = 5
"""Of the polynomials of splines, so that accelerations have two continuous derivatives."""

BEYOND = 1e-9
"""Share of the time between the first and the last sample by which a spline goes on at both ends, for the
round-off of times."""


ROUND_OFF = 1e-12
"""Share of a time by which a knot may lie after it and is reached all the same: times are sums of periods."""


class Smooth:
    """A function of time that has all derivatives at all times.

    Attributes:
        knots: s, the times at which a function has other derivatives after than before.
        jumps: the knots at which its value jumps.
        numbers: how many numbers say what it is between two knots.
        is_constant: True if it has one value between two knots.
    """

    knots: ClassVar[tuple[float, ...]] = ()
    jumps: ClassVar[tuple[float, ...]] = ()
    numbers: ClassVar[int] = 0
    is_constant: ClassVar[bool] = False

    def covers(self, end: float) -> bool:
        """Return True if the function is known from 0 to a time in s."""
        return True

    def piece(self, time: float) -> tuple[float, ...]:
        """Return the numbers of what the function is between the knots around a time in s."""
        return ()

    def on_piece(self, numbers: Sequence[Scalar]) -> TimeFunction:
        """Return the smooth function of such numbers, scalars of any kind, which are not checked."""
        return self  # type: ignore[return-value]  # all subclasses are time functions


@dataclass(frozen=True)
class Polynomial(Smooth):
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
        return _horner(self.coefficients, self._since(time))

    def rate(self, time: Scalar) -> Scalar:
        """First derivative, m/s or rad/s."""
        return _horner(_derived(self.coefficients), self._since(time))

    def acceleration(self, time: Scalar) -> Scalar:
        """Second derivative, m/s^2 or rad/s^2."""
        return _horner(_derived(_derived(self.coefficients)), self._since(time))

    def _since(self, time: Scalar) -> Scalar:
        """Compute t, s, at a time in s."""
        return time


@dataclass(frozen=True)
class Piece(Polynomial):
    """A polynomial with t counted from a start in s: what a function with knots is between two of them.

    Its numbers may be scalars of any kind, and are not checked.
    """

    start: Scalar

    def __post_init__(self) -> None:
        """Take the numbers as they are."""

    def _since(self, time: Scalar) -> Scalar:
        return time - self.start


def _horner(coefficients: tuple[float, ...], time: Scalar) -> Scalar:
    total: Scalar = 0.0
    for c in reversed(coefficients):
        total = total * time + c
    return total


def _derived(coefficients: tuple[float, ...]) -> tuple[float, ...]:
    return tuple(k * c for k, c in enumerate(coefficients))[1:]


@dataclass(frozen=True)
class Sine(Smooth):
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


@description
class Piecewise:
    """A function of time of polynomials between knots, given by samples; see `Spline` and `Steps`."""

    times: ArrayField
    values: ArrayField

    noun: ClassVar[str]
    least: ClassVar[int]
    is_constant: ClassVar[bool] = False

    def __post_init__(self) -> None:
        for name in ("times", "values"):
            given: Any = getattr(self, name)
            try:
                array = np.array(given, dtype=float)
            except (TypeError, ValueError, OverflowError):
                array = np.zeros((0, 0))
            if array.ndim != 1 or len(array) < self.least or not np.all(np.isfinite(array)):
                needed = f"{self.least} finite numbers or more"
                raise MechanismError(self.noun, f"{name} is {given!r:.100}", needed)
            array.flags.writeable = False
            object.__setattr__(self, name, array)
        if len(self.times) != len(self.values):
            problem = f"has {len(self.times)} times and {len(self.values)} values"
            raise MechanismError(self.noun, problem, "a value at each time")
        for k in np.flatnonzero(np.diff(self.times) <= 0.0)[:1]:
            problem = f"times[{k + 1}] is {self.times[k + 1]:.9g} s, after {self.times[k]:.9g} s"
            raise MechanismError(self.noun, problem, "times in ascending order")

    def piece(self, time: float) -> tuple[float, ...]:
        """See `Smooth.piece`: the start of the piece in s, and its coefficients."""
        raise NotImplementedError

    def on_piece(self, numbers: Sequence[Scalar]) -> Piece:
        """See `Smooth.on_piece`."""
        return Piece(tuple(numbers[1:]), numbers[0])

    def value(self, time: float) -> float:
        """At a time in s: m or rad."""
        return float(self.on_piece(self.piece(time)).value(time))

    def rate(self, time: float) -> float:
        """First derivative, m/s or rad/s."""
        return float(self.on_piece(self.piece(time)).rate(time))

    def acceleration(self, time: float) -> float:
        """Second derivative, m/s^2 or rad/s^2."""
        return float(self.on_piece(self.piece(time)).acceleration(time))


class Spline(Piecewise):
    """Smooth function through samples: polynomials of degree 5 with four continuous derivatives.

    Six samples, or fewer, lie on one polynomial. The function passes through all samples, with whatever noise
    they have: accelerations have 4 / h^2 times as much where samples are h apart. Of a sine of angular
    frequency w so sampled it is off by (w h)^6 / 13,000 of its amplitude, and by (w h)^4 / 700 in the
    acceleration; in the first and the last few samples by (w h)^6 / 100 and (w h)^4 / 2.

    Attributes:
        times: (n,) s, ascending, two or more. Nothing is known before the first and after the last one: runs
            begin at 0 and end between them.
        values: (n,) m or rad.

    Raises:
        MechanismError: for samples that are too few, not in order, or no finite numbers.

    Examples:
        >>> spline = Spline(times=(0.0, 1.0, 2.0), values=(0.0, 1.0, 4.0))
        >>> round(spline.value(1.5), 9), round(spline.acceleration(1.5), 9)
        (2.25, 2.0)
    """

    noun, least = "spline", 2
    numbers = DEGREE + 2
    jumps: ClassVar[tuple[float, ...]] = ()

    @cached_property
    def knots(self) -> tuple[float, ...]:
        """The samples but three at each end, where one polynomial goes on for two samples more."""
        return tuple(self.times[DEGREE // 2 + 1 : -(DEGREE // 2 + 1)].tolist())

    def covers(self, end: float) -> bool:
        first, last = self.times[0], self.times[-1]
        allowed = BEYOND * (last - first)
        return bool(first <= allowed and end <= last + allowed)

    @cached_property
    def _pieces(self) -> list[tuple[float, ...]]:
        from scipy.interpolate import PPoly, make_interp_spline

        degree = min(DEGREE, len(self.times) - 1)
        found = PPoly.from_spline(make_interp_spline(self.times, self.values, degree))
        pieces = zip(found.x[:-1].tolist(), found.x[1:].tolist(), found.c[::-1].T.tolist(), strict=True)
        missing = [0.0] * (DEGREE + 1 - len(found.c))
        return [(start, *coefficients, *missing) for start, end, coefficients in pieces if end > start]

    def piece(self, time: float) -> tuple[float, ...]:
        return self._pieces[bisect_right(self.knots, time + ROUND_OFF * abs(time))]


class Steps(Piecewise):
    """Set-points that jump: each value holds from its time on to the next one, the first one before it, too.

    For targets and feedforwards of control laws; a prescribed motion cannot jump.

    Attributes:
        times: (n,) s, ascending, one or more.
        values: (n,) m or rad, or N or N m.

    Raises:
        MechanismError: for samples that are too few, not in order, or no finite numbers.

    Examples:
        >>> steps = Steps(times=(0.0, 60.0, 120.0), values=(0.0, 0.1, 0.3))
        >>> steps.value(59.0), steps.value(60.0)
        (0.0, 0.1)
    """

    noun, least = "steps", 1
    numbers = 2
    is_constant = True

    @cached_property
    def knots(self) -> tuple[float, ...]:
        """All times but the first."""
        return tuple(self.times[1:].tolist())

    @property
    def jumps(self) -> tuple[float, ...]:
        """The same."""
        return self.knots

    def covers(self, end: float) -> bool:
        return True

    def piece(self, time: float) -> tuple[float, ...]:
        return 0.0, float(self.values[bisect_right(self.knots, time + ROUND_OFF * abs(time))])


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
            raise MechanismError("sum", problem, "one or more of Polynomial, Sine, Spline, Steps and Sum")
        object.__setattr__(self, "terms", terms)

    @property
    def knots(self) -> tuple[float, ...]:
        """Those of all terms."""
        return tuple(sorted({knot for term in self.terms for knot in term.knots}))

    @property
    def jumps(self) -> tuple[float, ...]:
        """Those of all terms."""
        return tuple(sorted({jump for term in self.terms for jump in term.jumps}))

    @property
    def numbers(self) -> int:
        """Those of all terms."""
        return sum(term.numbers for term in self.terms)

    @property
    def is_constant(self) -> bool:
        """True if all terms are constant between knots."""
        return all(term.is_constant for term in self.terms)

    def covers(self, end: float) -> bool:
        """See `Smooth.covers`."""
        return all(term.covers(end) for term in self.terms)

    def piece(self, time: float) -> tuple[float, ...]:
        """See `Smooth.piece`: the numbers of one term after the other."""
        return tuple(number for term in self.terms for number in term.piece(time))

    def on_piece(self, numbers: Sequence[Scalar]) -> Sum:
        """See `Smooth.on_piece`."""
        terms: list[TimeFunction] = []
        for term in self.terms:
            terms.append(term.on_piece(numbers[: term.numbers]))
            numbers = numbers[term.numbers :]
        return Sum(tuple(terms))

    def value(self, time: Scalar) -> Scalar:
        """At a time in s: m or rad."""
        return sum(term.value(time) for term in self.terms)

    def rate(self, time: Scalar) -> Scalar:
        """First derivative, m/s or rad/s."""
        return sum(term.rate(time) for term in self.terms)

    def acceleration(self, time: Scalar) -> Scalar:
        """Second derivative, m/s^2 or rad/s^2."""
        return sum(term.acceleration(time) for term in self.terms)


TimeFunction = Polynomial | Sine | Spline | Steps | Sum


def functions_of(value: Any) -> tuple[TimeFunction, ...]:
    """Return the functions of time that an attribute is or, as a mapping, has for values."""
    values = value.values() if isinstance(value, Mapping) else (value,)
    return tuple(each for each in values if isinstance(each, TimeFunction))


def terms(function: TimeFunction) -> Iterator[Polynomial | Sine | Spline | Steps]:
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
    if isinstance(function, Piecewise):
        return replace(function, values=factor * function.values)
    return replace(function, coefficients=tuple(factor * c for c in function.coefficients))


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
    functions = ("function",)

    def __post_init__(self) -> None:
        where, needed = self.element, "a Polynomial, Sine, Spline or Sum"
        if not isinstance(self.function, TimeFunction):
            raise MechanismError(where, f"function is {self.function!r:.100}", needed)
        if self.function.jumps:
            problem = f"function jumps at {self.function.jumps[0]:.9g} s"
            raise MechanismError(where, problem, f"{needed}, which has accelerations")
        check_key(where, self.joint, self.coordinate)

    def held(self) -> PrescribedMotion:
        """Return a motion that stays where this one is at time 0."""
        return replace(self, function=Polynomial((float(self.function.value(0.0)),)))
