"""Functions of time by samples: splines through them, and steps from one to the next."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from functools import cached_property
from typing import Any, ClassVar, Self

import numpy as np

from newton_euler.errors import MechanismError, quoted, real_array
from newton_euler.model.description import ArrayField, description
from newton_euler.model.smooth_functions import Piece
from newton_euler.model.variable import Change, Function
from newton_euler.scalars import Scalar

DEGREE = 5  # of the polynomials of splines, so that accelerations have two continuous derivatives
BEYOND = 1e-9  # share of its whole time by which a spline goes on at both ends: round-off of times
ROUND_OFF = 1e-12  # share of a time by which a knot may lie after it and is reached: times are sums


@description
class Piecewise(Function):
    """A function of time of polynomials between knots, given by samples; see `Spline` and `Steps`."""

    times: ArrayField
    values: ArrayField

    noun: ClassVar[str]
    least: ClassVar[int]
    parts: ClassVar = {"": ("values",)}
    constant: ClassVar = {"times": "where runs are divided"}

    def __post_init__(self) -> None:
        for name in ("times", "values"):
            given: Any = getattr(self, name)
            try:
                array = real_array(given)
            except (TypeError, ValueError, OverflowError):
                array = np.zeros((0, 0))
            if array.ndim != 1 or len(array) < self.least or not np.all(np.isfinite(array)):
                needed = f"{self.least} finite numbers or more"
                raise MechanismError(self.noun, f"{name} is {quoted(given)}", needed)
            array.flags.writeable = False
            object.__setattr__(self, name, array)
        if len(self.times) != len(self.values):
            problem = f"has {len(self.times)} times and {len(self.values)} values"
            raise MechanismError(self.noun, problem, "a value at each time")
        for k in np.flatnonzero(np.diff(self.times) <= 0.0)[:1]:
            problem = f"times[{k + 1}] is {self.times[k + 1]:.9g} s, after {self.times[k]:.9g} s"
            raise MechanismError(self.noun, problem, "times in ascending order")

    def with_part(self, name: str, numbers: Any, change: Change) -> Self:
        return super().with_part(name, np.array(numbers), change)

    def on_piece(self, numbers: Sequence[Scalar]) -> Piece:
        """See `Function.on_piece`; the numbers are the start of the piece in s, and its coefficients."""
        return Piece(tuple(numbers[1:]), numbers[0])

    def value(self, time: float) -> float:
        return float(self.on_piece(self.piece(time)).value(time))

    def rate(self, time: float) -> float:
        return float(self.on_piece(self.piece(time)).rate(time))

    def acceleration(self, time: float) -> float:
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

    @cached_property
    def knots(self) -> tuple[float, ...]:
        """The samples but three at each end, where one polynomial goes on for two samples more."""
        return tuple(self.times[DEGREE // 2 + 1 : -(DEGREE // 2 + 1)].tolist())

    def covers(self, begin: float, end: float) -> bool:
        first, last = self.times[0], self.times[-1]
        allowed = BEYOND * (last - first)
        return bool(first - allowed <= begin and end <= last + allowed)

    @cached_property
    def _pieces(self) -> list[tuple[float, ...]]:
        from scipy.interpolate import PPoly, make_interp_spline

        degree = min(DEGREE, len(self.times) - 1)
        # one polynomial through all samples has no inner knot; SciPy 1.14 fails to place none for degree 4
        ends = np.repeat([self.times[0], self.times[-1]], degree + 1) if degree < DEGREE else None
        found = PPoly.from_spline(make_interp_spline(self.times, self.values, degree, t=ends))
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
        return self.knots

    def piece(self, time: float) -> tuple[float, ...]:
        return 0.0, float(self.values[bisect_right(self.knots, time + ROUND_OFF * abs(time))])
