"""Activity in a run of elements that a scene leaves out.

Limits, contacts and dry friction are no bilateral constraints, and scenes have none. Where a limit is not
reached and nothing touches, the run is that of the file all the same. Between output times motion is that of
cubics through values and rates, which are off by about as much as those across an output miss it, and less
where outputs are close enough. What these leave open counts as active.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple, Protocol

import numpy as np

from newton_euler.model.constraints import Frame
from newton_euler.model.euler_parameters import product
from newton_euler.model.joint import Key
from newton_euler.model.motions import TimeFunction
from newton_euler.model.scene import Scene
from newton_euler.model.state import State
from newton_euler.model.trajectory import Trajectory
from newton_euler.scalars import Array

AT_REST = 1e-12  # m/s and rad/s, below which velocities are round-off
PARTS = 16  # of the time between outputs, at whose ends elements are looked at
FINE = 1e-2  # rad, and m per m of the longest body, by which poses between outputs may be off
UNSEEN = "not seen between output times: ask for more of them"  # words on what may have been active there


def missed(time: Array, x: Array, rate: Array) -> Array:
    """Bound by how much cubics miss values (n, ...) between outputs, (n - 1, ...).

    The larger, of the outputs at both ends, of what the cubic across that output misses there: of the value,
    and of the rate times the step. Infinite if there are too few outputs to tell.
    """
    if len(time) < 3:
        return np.full((len(time) - 1, *x.shape[1:]), np.inf)
    miss = np.zeros(x.shape)
    for first in (0, 1):
        ends, within = slice(first, None, 2), slice(first + 1, len(time) - 1, 2)
        if len(time[within]):
            curve = _curve(time[ends], x[ends], rate[ends])
            steps = np.diff(time)[within].reshape(-1, *(1,) * (x.ndim - 1))
            slopes = curve(time[within], 1) - rate[within]
            miss[within] = np.abs(curve(time[within]) - x[within]) + steps * np.abs(slopes)
    miss[0], miss[-1] = miss[1], miss[-2]
    return np.maximum(miss[:-1], miss[1:])


class Course:
    """A scene's bodies and joint coordinates along a run with velocities.

    Attributes:
        scene, run: the two.
        time: (m,) s: output times, and between each two of them the ends of `PARTS` equal parts.
    """

    def __init__(self, scene: Scene, run: Trajectory) -> None:
        self.scene, self.run = scene, run
        shares = np.arange(PARTS) / PARTS
        between = run.time[:-1, None] + np.diff(run.time)[:, None] * shares
        self.time: Array = np.append(between.ravel(), run.time[-1])
        self._found: dict[Key, tuple[Array, Array, Array]] = {}

    @cached_property
    def _frames(self) -> list[list[Frame]]:
        """Of all bodies, at each output time."""
        run = self.run
        assert run.linear_velocity is not None
        assert run.angular_velocity is not None
        rows = zip(run.position, run.quaternion, run.linear_velocity, run.angular_velocity, strict=True)
        return [State(*row).frames() for row in rows]

    @cached_property
    def _centers(self) -> Callable[[float], Array]:
        assert self.run.linear_velocity is not None
        return _curve(self.run.time, self.run.position, self.run.linear_velocity)

    @cached_property
    def _spins(self) -> Array:
        """(n, b, 4) rates of the quaternions, 1/s."""
        omega = self.run.angular_velocity
        assert omega is not None
        pure = np.concatenate([np.zeros((*omega.shape[:2], 1)), omega], axis=2)
        w, q = (np.moveaxis(each, -1, 0) for each in (pure, self.run.quaternion))
        return 0.5 * np.moveaxis(product(w, q), 0, -1)

    @cached_property
    def _quaternions(self) -> Callable[[float], Array]:
        return _curve(self.run.time, self.run.quaternion, self._spins)

    @cached_property
    def is_fine(self) -> bool:
        """True if outputs are close enough to tell poses between them to within `FINE`."""
        run = self.run
        assert run.linear_velocity is not None
        moved = np.linalg.norm(missed(run.time, run.position, run.linear_velocity), axis=2)
        turned = 2.0 * np.linalg.norm(missed(run.time, run.quaternion, self._spins), axis=2)
        longest = self.scene.mechanism.longest
        return bool(np.all(moved <= FINE * longest) and np.all(turned <= FINE))

    def poses(self, time: float) -> tuple[Array, Array]:
        """Compute centers of mass (b, 3) and quaternions (b, 4) at a time, s."""
        turned = self._quaternions(time)
        return self._centers(time), turned / np.linalg.norm(turned, axis=1, keepdims=True)

    @np.errstate(invalid="ignore")  # of hinges in a row, which do not reach every orientation
    def coordinate(self, key: Key) -> tuple[Array, Array, Array]:
        """Compute a joint coordinate, m or rad from the initial pose, turns counted.

        Returns:
            The coordinate (m,), its rate (m,), and by how much it may be off between outputs (n - 1,). NaN
            where poses do not tell it at all output times.
        """
        if key not in self._found:
            mechanism, time = self.scene.mechanism, self.run.time
            x, rate = np.array([mechanism.measure(key, frames) for frames in self._frames]).T
            if np.all(np.isfinite([x, rate])):
                x = x if mechanism.is_slide(*key) else np.unwrap(x)
                curve = _curve(time, x, rate)
                self._found[key] = curve(self.time), curve(self.time, 1), missed(time, x, rate)
            else:
                unknown = np.full(self.time.shape, np.nan)
                self._found[key] = unknown, unknown, unknown[1 : len(time)]
        return self._found[key]


def _curve(time: Array, x: Array, rate: Array) -> Any:
    """Interpolate values (n, ...) by cubics: a function of times, s, and the order of a derivative."""
    from scipy.interpolate import CubicHermiteSpline

    if len(time) == 1:
        return lambda at, order=0: (rate if order else x)[np.zeros(np.shape(at), dtype=int)]
    return CubicHermiteSpline(time, x, rate)


class Judged(NamedTuple):
    """Observation of an element."""

    active: bool
    words: str


class Watch(Protocol):
    """Watch that tells whether an element is active."""

    def judge(self, course: Course) -> Judged:
        """Look at all moments of a run."""


@dataclass(frozen=True)
class Bounds:
    """A limit: constant + by_value * x + by_rate * dx/dt stays within low and high, x a sum of coordinates.

    The constant may be a function of time.

    Attributes:
        terms: joint coordinates with what they count in x.
        low, high: may be infinite.
        unit: of the quantity.
    """

    terms: tuple[tuple[Key, float], ...]
    low: float
    high: float
    unit: str
    constant: float | TimeFunction = 0.0
    by_value: float = 1.0
    by_rate: float = 0.0

    def judge(self, course: Course) -> Judged:
        x, rate = np.zeros((2, len(course.time)))
        steps = np.diff(course.run.time)
        doubt = np.zeros(steps.shape)
        for key, factor in self.terms:
            value, slope, miss = course.coordinate(key)
            x, rate = x + factor * value, rate + factor * slope
            doubt += abs(factor) * (abs(self.by_value) + abs(self.by_rate) / steps) * miss
        if not np.all(np.isfinite(x)):
            return Judged(True, "not judged: its coordinate cannot be told from the poses")
        constant: Any = self.constant
        if isinstance(constant, TimeFunction):
            constant = np.array([constant.value(time) for time in course.time.tolist()])
        return self.judged(course.time, constant + self.by_value * x + self.by_rate * rate, doubt)

    def judged(self, times: Array, found: Array, doubt: Array) -> Judged:
        """Judge values (m,) at times (m,), s, that may be off by `doubt` (n - 1,) between outputs."""
        room = np.minimum(found - self.low, self.high - found)
        least = int(np.argmin(room))
        if room[least] < 0.0:
            first = times[int(np.argmax(room < 0.0))]
            return Judged(True, f"passed from {first:.4g} s on, by up to {-room[least]:.3g} {self.unit}")
        if np.isinf(room[least]):
            return Judged(False, "no limit")
        nearest = np.min(np.minimum(room[1:], room[:-1]).reshape(-1, PARTS), axis=1)
        if np.any((nearest < doubt) & (doubt > AT_REST)):
            return Judged(True, UNSEEN)
        return Judged(False, f"closest {room[least]:.3g} {self.unit} at {times[least]:.4g} s")


@dataclass(frozen=True)
class Rest:
    """Dry friction, which does nothing as long as its joint coordinates stay where they are by themselves."""

    keys: tuple[Key, ...]

    def judge(self, course: Course) -> Judged:
        seen = (course.coordinate(key) for key in self.keys)
        moves = np.max([np.maximum(np.abs(x - x[0]), np.abs(rate)) for x, rate, _ in seen], axis=0)
        if np.max(moves) <= AT_REST:
            return Judged(False, "it stays where it is")
        first = float(course.time[int(np.argmax(moves > AT_REST))])
        return Judged(True, f"moves from {first:.4g} s on")


@dataclass(frozen=True)
class Tangent:
    """A polynomial of a joint coordinate whose tangent at the start a scene has in its place.

    Attributes:
        key: the coordinate.
        coefficients: of rising powers of the coordinate, which is zero at the start.
        unit: of the polynomial.
    """

    key: Key
    coefficients: tuple[float, ...]
    unit: str

    def judge(self, course: Course) -> Judged:
        x, *_ = course.coordinate(self.key)
        if not np.all(np.isfinite(x)):
            return Judged(True, "not judged: its coordinate cannot be told from the poses")
        away = np.abs(np.polynomial.Polynomial((0.0, 0.0, *self.coefficients[2:]))(x))
        most = int(np.argmax(away))
        how = f"they are apart by up to {away[most]:.3g} {self.unit}, at {course.time[most]:.4g} s"
        return Judged(bool(away[most] > 0.0), how)


def judged(watches: Sequence[Watch], course: Course) -> Judged:
    """Of all that an element says; active if any of it is."""
    found = [watch.judge(course) for watch in watches]
    active = any(each.active for each in found)
    words = "; ".join(each.words for each in found if each.active == active)
    return Judged(active, words)
