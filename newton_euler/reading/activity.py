"""Activity in a run of elements that a scene leaves out.

Limits, contacts and dry friction are no bilateral constraints, and scenes have none. If no limit is reached
and nothing touches, the run is that of the file all the same. Between output times the motion is taken from
cubics through values and rates. The error of the cubics is estimated from cubics across each output. If this
error hides whether an element acts, the judgment is not settled: a run with closer outputs settles it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple, Protocol

import numpy as np

from newton_euler.model.euler_parameters import product
from newton_euler.model.joint import Key
from newton_euler.model.motions import TimeFunction
from newton_euler.model.scene import Scene
from newton_euler.model.trajectory import Trajectory
from newton_euler.scalars import Array

AT_REST = 1e-12  # m/s and rad/s, below which velocities are round-off
PARTS = 16  # of the time between outputs, at whose ends elements are looked at
FINE = 1e-2  # rad, and m per m of the longest body, by which poses between outputs may be off
TOUCH = 1e-9  # rad, m, or share of a limit of a force, by which a limit may be passed and carry no force
ROUNDED = 1e-6  # the same at the start: files that MuJoCo saves have six digits
SETTLED_SHARE = 1e-3  # of the most by which a limit is passed: error of motion that tells when it first is
UNSETTLED = "may act between output times"


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
    def _spins(self) -> Array:
        """(n, b, 4) rates of the quaternions at the output times, 1/s."""
        omega = self.run.angular_velocity
        assert omega is not None
        pure = np.concatenate([np.zeros((*omega.shape[:2], 1)), omega], axis=2)
        w, q = (np.moveaxis(each, -1, 0) for each in (pure, self.run.quaternion))
        return 0.5 * np.moveaxis(product(w, q), 0, -1)

    @cached_property
    def is_fine(self) -> bool:
        """True if outputs are close enough to tell poses between them to within `FINE`."""
        run = self.run
        assert run.linear_velocity is not None
        moved = np.linalg.norm(missed(run.time, run.position, run.linear_velocity), axis=2)
        turned = 2.0 * np.linalg.norm(missed(run.time, run.quaternion, self._spins), axis=2)
        longest = self.scene.mechanism.longest
        return bool(np.all(moved <= FINE * longest) and np.all(turned <= FINE))

    @cached_property
    def poses(self) -> tuple[Array, Array]:
        """Centers of mass (m, b, 3) and quaternions (m, b, 4) at all times."""
        turned = _curve(self.run.time, self.run.quaternion, self._spins)(self.time)
        assert self.run.linear_velocity is not None
        centers = _curve(self.run.time, self.run.position, self.run.linear_velocity)(self.time)
        return centers, turned / np.linalg.norm(turned, axis=2, keepdims=True)

    @np.errstate(invalid="ignore")  # of hinges in a row, which do not reach every orientation
    def coordinate(self, key: Key) -> tuple[Array, Array, Array]:
        """Compute a joint coordinate, m or rad from the initial pose, turns counted.

        Returns:
            The coordinate (m,), its rate (m,), and by how much it may be off between outputs (n - 1,). NaN
            where poses do not tell it at all output times.
        """
        if key not in self._found:
            (joint, number), time = key, self.run.time
            motion = replace(self.run, mechanism=self.scene.mechanism).joint(joint)
            assert motion.rates is not None
            x, rate = motion.coordinates[:, number], motion.rates[:, number]
            if np.all(np.isfinite([x, rate])):
                curve = _curve(time, x, rate)
                self._found[key] = curve(self.time), curve(self.time, 1), missed(time, x, rate)
            else:
                unknown = np.full(self.time.shape, np.nan)
                self._found[key] = unknown, unknown, unknown[1 : len(time)]
        return self._found[key]


def _curve(time: Array, x: Array, rate: Array) -> Any:
    """Interpolate values (n, ...) by Hermite's cubics: a function of times, s, and the order 0 or 1."""

    def curve(at: Array | float, order: int = 0) -> Array:
        if len(time) == 1:
            return np.asarray((rate if order else x)[np.zeros(np.shape(at), dtype=int)])
        place = np.clip(np.searchsorted(time, at, side="right") - 1, 0, len(time) - 2)
        size, shape = time[place + 1] - time[place], (*np.shape(at), *(1,) * (x.ndim - 1))
        share, h = np.reshape((at - time[place]) / size, shape), np.reshape(size, shape)
        change, begin, end = x[place + 1] - x[place], h * rate[place], h * rate[place + 1]
        square, cube = 3.0 * change - 2.0 * begin - end, begin + end - 2.0 * change
        if order:
            return np.asarray((begin + share * (2.0 * square + 3.0 * share * cube)) / h)
        return np.asarray(x[place] + share * (begin + share * (square + share * cube)))

    return curve


class Judged(NamedTuple):
    """Observation of an element in a run.

    Attributes:
        words: what was seen.
        since: s, the first time at which the element acts; None if it does not.
        settled: False if outputs are too far apart to tell whether and when the element acts.
    """

    words: str
    since: float | None = None
    settled: bool = True

    @property
    def active(self) -> bool:
        """True if the element acts at any time of the run."""
        return self.since is not None


class Watch(Protocol):
    """Watch that tells whether an element is active."""

    def judge(self, course: Course) -> Judged:
        """Look at all moments of a run."""


LENGTHS_AND_ANGLES = ("m", "rad", "m or rad", "m/s", "rad/s")
"""Units in which `TOUCH` and `ROUNDED` are absolute."""


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
            return Judged("not judged: the poses do not determine its coordinate", 0.0)
        constant: Any = self.constant
        if isinstance(constant, TimeFunction):
            constant = np.array([constant.value(time) for time in course.time.tolist()])
        return self.judged(course.time, constant + self.by_value * x + self.by_rate * rate, doubt)

    def judged(self, times: Array, found: Array, doubt: Array) -> Judged:
        """Judge values (m,) at times (m,), s, whose error between outputs is at most `doubt` (n - 1,).

        A limit acts where the values pass it. A coordinate that starts at its limit and moves inwards needs
        no force, even if digits of the file put it outside by up to `ROUNDED`.
        """
        room = np.minimum(found - self.low, self.high - found)
        least = int(np.argmin(room))
        if np.isinf(room[least]):
            return Judged("no limit")
        ends = [abs(limit) for limit in (self.low, self.high) if np.isfinite(limit)]
        scale = 1.0 if self.unit in LENGTHS_AND_ANGLES else max(ends)
        passed = room < -TOUCH * scale
        outside, inwards = _way_inwards(room, ROUNDED * scale)
        passed[:outside] = False
        nearest = np.min(np.minimum(room[1:], room[:-1]).reshape(-1, PARTS), axis=1)
        nearest[: inwards // PARTS] = np.inf
        unseen = (nearest < doubt) & (doubt > TOUCH * scale)
        starts = times[:-1:PARTS]
        if np.any(passed):
            first = int(np.argmax(passed))
            within = max(0, first - 1) // PARTS  # the number of the interval between outputs
            is_exact = first == 0 or doubt[within] <= SETTLED_SHARE * -room[least]
            settled = is_exact and not np.any(unseen[:within])
            words = f"passed from {times[first]:.4g} s on, by up to {-room[least]:.3g} {self.unit}"
            return Judged(words, float(times[first]), bool(settled))
        if np.any(unseen):
            return Judged(UNSETTLED, float(starts[int(np.argmax(unseen))]), settled=False)
        return Judged(f"closest {max(0.0, room[least]):.3g} {self.unit} at {times[least]:.4g} s")


def _way_inwards(room: Array, rounded: float) -> tuple[int, int]:
    """Follow a value that starts at its limit and moves inwards from there.

    Args:
        room: (m,) distances from the limit, negative outside.
        rounded: how far from the limit a start at the limit may be.

    Returns:
        The number of moments until the value is inside, and until it turns back. Both are 0 for a value that
        starts elsewhere or moves outwards.
    """
    rises = np.diff(room) > 0.0
    inwards = len(rises) if np.all(rises) else int(np.argmin(rises))
    inside = room[: inwards + 1] > 0.0
    if abs(room[0]) > rounded or not np.any(inside):
        return 0, 0
    return int(np.argmax(inside)), inwards


@dataclass(frozen=True)
class Rest:
    """Dry friction, which does nothing as long as its joint coordinates stay where they are by themselves."""

    keys: tuple[Key, ...]

    def judge(self, course: Course) -> Judged:
        seen = (course.coordinate(key) for key in self.keys)
        moves = np.max([np.maximum(np.abs(x - x[0]), np.abs(rate)) for x, rate, _ in seen], axis=0)
        if np.max(moves) <= AT_REST:
            return Judged("it stays where it is")
        first = float(course.time[int(np.argmax(moves > AT_REST))])
        return Judged(f"moves from {first:.4g} s on", first)


def judged(watches: Sequence[Watch], course: Course) -> Judged:
    """Judge an element by all its watches: it acts from the first time on at which any of them does."""
    found = [watch.judge(course) for watch in watches]
    times = [each.since for each in found if each.since is not None]
    words = "; ".join(each.words for each in found if each.active == bool(times))
    return Judged(words, min(times, default=None), all(each.settled for each in found))
