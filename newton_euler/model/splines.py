"""Functions of time that are given by samples: interpolating splines, steps, and moves from rest to rest.

They prescribe joint motions and serve as targets of control laws. Between two neighboring knots (times at
which a derivative jumps) each function is one polynomial; integrators restart at the knots.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Sequence
from functools import cached_property
from typing import Any, ClassVar, Self

import numpy as np

from newton_euler.errors import MechanismError, finite_array, quoted, real_array
from newton_euler.model.description import ArrayField, description
from newton_euler.model.smooth_functions import Piece
from newton_euler.model.variable import Change, Function
from newton_euler.scalars import Scalar, Stack, stacked_rows

SPLINE_DEGREE = 5
"""Degree of the polynomials of splines; accelerations then have two continuous derivatives."""

ALLOWED_EXTRAPOLATION = 1e-9
"""Fraction of a spline's time span by which the spline may be evaluated beyond its first and last sample. It
allows for round-off in the times of a run."""

TIME_ROUND_OFF = 1e-12
"""Relative round-off of times, which are sums of steps. A knot counts as reached at time t if it lies at most
this fraction of t after t."""


@description
class Piecewise(Function):
    """Base class of functions of time that are one polynomial between two neighboring knots.

    Attributes:
        times: (n,) times of the samples, s, ascending.
        values: (n,) values of the samples.
        noun: name of the kind of function in error messages.
        min_samples: smallest number of samples.
    """

    times: ArrayField
    values: ArrayField

    noun: ClassVar[str]
    min_samples: ClassVar[int]
    # Part "" of a `Function`: names of the fields on which the function depends linearly
    parts: ClassVar = {"": ("values",)}
    # Why times cannot vary between runs, for messages: integrators restart at the times
    constant: ClassVar = {"times": "where runs are divided"}

    def __post_init__(self) -> None:
        # Convert times and values to read-only arrays
        for name in ("times", "values"):
            given: Any = getattr(self, name)
            try:
                array = real_array(given)
            except (TypeError, ValueError, OverflowError):
                array = np.zeros((0, 0))
            if array.ndim != 1 or len(array) < self.min_samples or not np.all(np.isfinite(array)):
                needed = f"{self.min_samples} finite numbers or more"
                raise MechanismError(self.noun, f"{name} is {quoted(given)}", needed)
            array.flags.writeable = False
            object.__setattr__(self, name, array)

        # Check that each time has a value, and that times ascend; report the first one that does not
        if len(self.times) != len(self.values):
            problem = f"has {len(self.times)} times and {len(self.values)} values"
            raise MechanismError(self.noun, problem, "a value at each time")
        for k in np.flatnonzero(np.diff(self.times) <= 0.0)[:1]:
            problem = f"times[{k + 1}] is {self.times[k + 1]:.9g} s, after {self.times[k]:.9g} s"
            raise MechanismError(self.noun, problem, "times in ascending order")

    def with_part(self, name: str, numbers: Any, change: Change) -> Self:
        # Copy the function with other values; `change` makes the copy, see `Function.with_part`
        return super().with_part(name, np.array(numbers), change)

    def on_piece(self, numbers: Sequence[Scalar]) -> Piece:
        """Build the polynomial between two knots from its numbers, see `Function.on_piece`.

        Args:
            numbers: start of the piece, s, then the coefficients in ascending powers of the time since the
                start; floats, or symbols of the code generator.
        """
        return Piece(tuple(numbers[1:]), numbers[0])

    def value(self, time: Scalar) -> Scalar:
        return self._piece_at(time).value(time)

    def rate(self, time: Scalar) -> Scalar:
        return self._piece_at(time).rate(time)

    def acceleration(self, time: Scalar) -> Scalar:
        return self._piece_at(time).acceleration(time)

    def _piece_at(self, time: Scalar) -> Piece:
        """Return the polynomial around a time in s; its numbers are `Stack`s if the time is one."""
        if isinstance(time, Stack):
            pieces = [self.piece(each) for each in time.numbers.tolist()]
            return self.on_piece(stacked_rows(np.array(pieces)).tolist())
        return self.on_piece(self.piece(time))


class Spline(Piecewise):
    """Interpolating spline through samples: polynomials of degree 5 with four continuous derivatives.

    If there are six samples or fewer, the function is one polynomial. Let h be the time between samples.
    Noise in the samples is amplified: the noise of the acceleration is 4 / h^2 times that of the values. For
    samples of a sine of angular frequency w, the interpolation error is (w h)^6 / 13,000 of the amplitude.
    The error of the acceleration is (w h)^4 / 700 of the acceleration's amplitude. Near the first and the
    last few samples these two errors are (w h)^6 / 100 and (w h)^4 / 2.

    Attributes:
        times: (n,) s, ascending, two or more. A run, which begins at time 0, must lie between the first and
            the last sample.
        values: (n,) m or rad.

    Raises:
        MechanismError: for fewer than two samples, times that do not ascend, and numbers that are not finite.

    Examples:
        >>> spline = Spline(times=(0.0, 1.0, 2.0), values=(0.0, 1.0, 4.0))
        >>> round(spline.value(1.5), 9), round(spline.acceleration(1.5), 9)
        (2.25, 2.0)
    """

    noun, min_samples = "spline", 2
    piece_size = SPLINE_DEGREE + 2  # per piece: its start and SPLINE_DEGREE + 1 coefficients

    @cached_property
    def knots(self) -> tuple[float, ...]:
        """Times, s, at which the fifth derivative jumps: those of all samples except three at each end.

        The first and the last polynomial extend over three sample intervals each (not-a-knot conditions).
        """
        skipped = SPLINE_DEGREE // 2 + 1
        return tuple(self.times[skipped:-skipped].tolist())

    def covers(self, begin: float, end: float) -> bool:
        first, last = self.times[0], self.times[-1]
        allowed = ALLOWED_EXTRAPOLATION * (last - first)
        return bool(first - allowed <= begin and end <= last + allowed)

    @cached_property
    def _pieces(self) -> list[tuple[float, ...]]:
        """The numbers of all pieces, in order: start, s, then the coefficients in ascending powers."""
        from scipy.interpolate import PPoly, make_interp_spline

        degree = min(SPLINE_DEGREE, len(self.times) - 1)
        # Few samples: one polynomial without inner knots, which SciPy 1.14 cannot choose at degree 4
        ends = np.repeat([self.times[0], self.times[-1]], degree + 1) if degree < SPLINE_DEGREE else None
        spline = PPoly.from_spline(make_interp_spline(self.times, self.values, degree, t=ends))
        # SciPy lists coefficients in descending powers, and repeats end knots as pieces of length 0
        pieces = zip(spline.x[:-1].tolist(), spline.x[1:].tolist(), spline.c[::-1].T.tolist(), strict=True)
        missing = [0.0] * (SPLINE_DEGREE + 1 - len(spline.c))
        return [(start, *coefficients, *missing) for start, end, coefficients in pieces if end > start]

    def piece(self, time: float) -> tuple[float, ...]:
        return self._pieces[bisect_right(self.knots, time + TIME_ROUND_OFF * abs(time))]


class Steps(Piecewise):
    """Piecewise constant function: each value holds from its time until the next one.

    The first value also holds before its time. The function serves as the target or the feedforward of a
    control law; a prescribed motion cannot jump.

    Attributes:
        times: (n,) s, ascending, one or more.
        values: (n,) m or rad, or N or N m.

    Raises:
        MechanismError: without samples, for times that do not ascend, and for numbers that are not finite.

    Examples:
        >>> steps = Steps(times=(0.0, 60.0, 120.0), values=(0.0, 0.1, 0.3))
        >>> steps.value(59.0), steps.value(60.0)
        (0.0, 0.1)
    """

    noun, min_samples = "steps", 1
    piece_size = 2  # per piece: a start, which does not matter, and the value
    rests = True

    @cached_property
    def knots(self) -> tuple[float, ...]:
        """Times, s, at which the value jumps: all times except the first."""
        return tuple(self.times[1:].tolist())

    @property
    def jumps(self) -> tuple[float, ...]:
        return self.knots

    def is_constant_at(self, time: float) -> bool:
        return True

    def piece(self, time: float) -> tuple[float, ...]:
        return 0.0, float(self.values[bisect_right(self.knots, time + TIME_ROUND_OFF * abs(time))])


@description
class Moves(Piecewise):
    """Motion from rest to rest through given values, with a trapezoidal speed profile between two of them.

    At each time the function has the given value and a rate of zero. From one time to the next, the speed
    rises linearly for the time r, is constant, and falls linearly to zero for the time r. Let D be the
    difference of two values and T the time between them: the largest speed is D / (T - r) and the
    acceleration D / (r (T - r)). Between two equal values the function is constant, as before the first time
    and after the last one.

    Attributes:
        times: (n,) s, ascending, two or more.
        values: (n,) m or rad, or N or N m.
        ramps: (n - 1,) times r, s, above 0 and at most half of the time between two values.

    Raises:
        MechanismError: for fewer than two values, times that do not ascend, numbers that are not finite, and
            ramps that are too long.

    Examples:
        >>> moves = Moves(times=(0.0, 4.0, 10.0), values=(0.0, 0.3, 0.3), ramps=(1.0, 1.0))
        >>> round(moves.rate(2.0), 9), round(moves.acceleration(0.5), 9), moves.value(7.0)
        (0.1, 0.1, 0.3)
    """

    ramps: ArrayField

    noun, min_samples = "moves", 2
    piece_size = 4  # per piece: its start and three coefficients
    constant: ClassVar = Piecewise.constant | {"ramps": "where runs are divided"}
    rests = True

    def __post_init__(self) -> None:
        super().__post_init__()
        longest = 0.5 * np.diff(self.times)
        ramps = finite_array(self.noun, "ramps", self.ramps, longest.shape)
        slack = TIME_ROUND_OFF * np.abs(self.times[1:])
        for k in np.flatnonzero((ramps <= 0.0) | (ramps > longest + slack))[:1]:
            needed = f"above 0 s and at most {longest[k]:.9g} s, half of the time of its move"
            raise MechanismError(self.noun, f"ramps[{k}] is {ramps[k]:.9g} s", needed)
        ramps = np.minimum(ramps, longest)
        ramps.flags.writeable = False
        object.__setattr__(self, "ramps", ramps)

    @cached_property
    def knots(self) -> tuple[float, ...]:
        """Times, s, at which the acceleration jumps."""
        return tuple(start for start, *_ in self._pieces[1:])

    def is_constant_at(self, time: float) -> bool:
        return not any(self.piece(time)[2:])

    @cached_property
    def _pieces(self) -> list[tuple[float, ...]]:
        """The numbers of all pieces, in order: start, s, then three coefficients in ascending powers."""
        first, last = float(self.values[0]), float(self.values[-1])
        pieces: list[tuple[float, ...]] = [(-math.inf, first, 0.0, 0.0)]
        times, values = self.times.tolist(), self.values.tolist()
        for k, ramp in enumerate(self.ramps.tolist()):
            begin, end, change = times[k], times[k + 1], values[k + 1] - values[k]
            speed = change / (end - begin - ramp)  # the largest one
            half_acceleration = 0.5 * speed / ramp
            if change == 0.0:
                pieces.append((begin, values[k], 0.0, 0.0))
                continue
            pieces.append((begin, values[k], 0.0, half_acceleration))
            if end - begin - 2.0 * ramp > TIME_ROUND_OFF * abs(end):
                pieces.append((begin + ramp, values[k] + 0.5 * speed * ramp, speed, 0.0))
            # the last part is a parabola around its end, which is moved to its start
            rest = values[k + 1] - 0.5 * speed * ramp
            pieces.append((end - ramp, rest, speed, -half_acceleration))
        pieces.append((times[-1], last, 0.0, 0.0))
        # a rest is one piece, from the end of a move to the beginning of the next one
        return [piece for k, piece in enumerate(pieces) if k == 0 or any(piece[2:]) or any(pieces[k - 1][2:])]

    def piece(self, time: float) -> tuple[float, ...]:
        start, *coefficients = self._pieces[bisect_right(self.knots, time + TIME_ROUND_OFF * abs(time))]
        return (0.0 if np.isinf(start) else start), *coefficients  # the rest before the first move
