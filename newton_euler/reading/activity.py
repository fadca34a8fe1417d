"""Find the elements of a file, such as limits and contacts, that would have acted in a run.

Joint limits, contacts and dry friction are one-sided, and scenes do not simulate them. If no limit is reached
and nothing touches, the run is nevertheless the run of the file. Between output times the motion is
interpolated by cubics through values and rates. The error of the cubics is estimated from cubics across each
output. If the error hides whether an element acts, the result is not settled; closer outputs settle the
result.
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

REST_SPEED = 1e-12
"""Speed, m/s or rad/s, below which velocities are round-off."""

POINTS_PER_INTERVAL = 16
"""Number of equal parts of each output interval; elements are checked at the ends of the parts."""

MAX_POSE_ERROR = 1e-2
"""Largest error of interpolated poses: rad, and m per m of the longest body."""

LIMIT_TOLERANCE = 1e-9
"""Overshoot of a limit that carries no force: rad, m, or a fraction of the limit of a force."""

START_LIMIT_TOLERANCE = 1e-6
"""Overshoot of a limit at the start that carries no force: files that MuJoCo saves have six digits."""

SETTLED_SHARE = 1e-3
"""Largest interpolation error, as a fraction of the overshoot, that settles when a limit is first passed."""

UNSETTLED = "may act between output times"
"""Words of a result that closer outputs have to settle."""


def cubic_error(time: Array, x: Array, rate: Array) -> Array:
    """Estimate the error of cubics through values (n, ...) and rates between outputs.

    For each output, a cubic through its two neighbors predicts the value and the rate. The error at the
    output is the error of the value plus the error of the rate times the step.

    Returns:
        (n - 1, ...) the larger error of the two outputs that bound each interval; infinite for fewer than
        three outputs.
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


class SampledMotion:
    """Bodies and joint coordinates of a scene at the output times of a run and between them.

    Attributes:
        scene: the scene of the run.
        run: a trajectory with velocities.
        time: (m,) s, output times and `POINTS_PER_INTERVAL` - 1 times between each two of them.
    """

    def __init__(self, scene: Scene, run: Trajectory) -> None:
        self.scene, self.run = scene, run
        shares = np.arange(POINTS_PER_INTERVAL) / POINTS_PER_INTERVAL
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
        """True if the interpolated poses are accurate to `MAX_POSE_ERROR`."""
        run = self.run
        assert run.linear_velocity is not None
        moved = np.linalg.norm(cubic_error(run.time, run.position, run.linear_velocity), axis=2)
        turned = 2.0 * np.linalg.norm(cubic_error(run.time, run.quaternion, self._spins), axis=2)
        longest = self.scene.mechanism.longest
        return bool(np.all(moved <= MAX_POSE_ERROR * longest) and np.all(turned <= MAX_POSE_ERROR))

    @cached_property
    def poses(self) -> tuple[Array, Array]:
        """Centers of mass (m, b, 3), m, and quaternions (m, b, 4) at all times, world frame."""
        turned = _curve(self.run.time, self.run.quaternion, self._spins)(self.time)
        assert self.run.linear_velocity is not None
        centers = _curve(self.run.time, self.run.position, self.run.linear_velocity)(self.time)
        return centers, turned / np.linalg.norm(turned, axis=2, keepdims=True)

    @np.errstate(
        invalid="ignore"
    )  # angles of several hinges in a row are NaN for orientations out of their reach
    def coordinate(self, key: Key) -> tuple[Array, Array, Array]:
        """Compute a joint coordinate, m or rad from the initial pose, revolutions counted.

        Returns:
            The coordinate (m,), its rate (m,), and its interpolation error between outputs (n - 1,). All are
            NaN if the poses do not determine the coordinate at every output time.
        """
        if key not in self._found:
            (joint, number), time = key, self.run.time
            measured = replace(self.run, mechanism=self.scene.mechanism).joint(joint)
            assert measured.rates is not None
            x, rate = measured.coordinates[:, number], measured.rates[:, number]
            if np.all(np.isfinite([x, rate])):
                curve = _curve(time, x, rate)
                self._found[key] = curve(self.time), curve(self.time, 1), cubic_error(time, x, rate)
            else:
                unknown = np.full(self.time.shape, np.nan)
                self._found[key] = unknown, unknown, unknown[1 : len(time)]
        return self._found[key]


def _curve(time: Array, x: Array, rate: Array) -> Any:
    """Interpolate (n, ...) by cubic Hermite polynomials, as a function of time, s, and derivative order."""

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


class Activity(NamedTuple):
    """Activity of an element in a run.

    Attributes:
        words: the observation, for the report.
        since: s, the first time at which the element acts; None if the element does not act.
        settled: False if only closer outputs can show whether and when the element acts.
    """

    words: str
    since: float | None = None
    settled: bool = True

    @property
    def active(self) -> bool:
        """True if the element acts at any time of the run."""
        return self.since is not None


class Watch(Protocol):
    """Test of one condition under which an element acts."""

    def judge(self, motion: SampledMotion) -> Activity:
        """Report whether the element acts at any time of a motion."""


LENGTHS_AND_ANGLES = ("m", "rad", "m or rad", "m/s", "rad/s")
"""Units whose tolerances are absolute; tolerances of other units are relative to the limit."""


@dataclass(frozen=True)
class Bounds:
    """Limit of a joint coordinate or force: low <= constant + by_value * x + by_rate * dx/dt <= high.

    x is a weighted sum of joint coordinates.

    Attributes:
        terms: joint coordinates with their weights in x.
        low, high: limits, may be infinite.
        unit: unit of the limits.
        constant: number, or function of time.
        by_value: factor of x.
        by_rate: factor of dx/dt, s.
    """

    terms: tuple[tuple[Key, float], ...]
    low: float
    high: float
    unit: str
    constant: float | TimeFunction = 0.0
    by_value: float = 1.0
    by_rate: float = 0.0

    def judge(self, motion: SampledMotion) -> Activity:
        x, rate = np.zeros((2, len(motion.time)))
        steps = np.diff(motion.run.time)
        doubt = np.zeros(steps.shape)
        for key, factor in self.terms:
            value, slope, miss = motion.coordinate(key)
            x, rate = x + factor * value, rate + factor * slope
            doubt += abs(factor) * (abs(self.by_value) + abs(self.by_rate) / steps) * miss
        if not np.all(np.isfinite(x)):
            return Activity("not judged: the poses do not determine its coordinate", 0.0)
        constant: Any = self.constant
        if isinstance(constant, TimeFunction):
            constant = np.array([constant.value(time) for time in motion.time.tolist()])
        return self.judge_values(motion.time, constant + self.by_value * x + self.by_rate * rate, doubt)

    def judge_values(self, times: Array, found: Array, doubt: Array) -> Activity:
        """Find the first time at which values pass the limits.

        A coordinate that starts at its limit and moves inwards needs no force, even if the rounded digits of
        the file place the start up to `START_LIMIT_TOLERANCE` outside.

        Args:
            times: (m,) s.
            found: (m,) values of the limited quantity.
            doubt: (n - 1,) largest error of the values in each output interval.
        """
        room = np.minimum(found - self.low, self.high - found)
        least = int(np.argmin(room))
        if np.isinf(room[least]):
            return Activity("no limit")
        ends = [abs(limit) for limit in (self.low, self.high) if np.isfinite(limit)]
        scale = 1.0 if self.unit in LENGTHS_AND_ANGLES else max(ends)
        # times at which the limit is passed, without a start that moves inwards
        passed = room < -LIMIT_TOLERANCE * scale
        outside, inwards = _way_inwards(room, START_LIMIT_TOLERANCE * scale)
        passed[:outside] = False
        # output intervals in which the interpolation error may hide that the limit is passed
        nearest = np.min(np.minimum(room[1:], room[:-1]).reshape(-1, POINTS_PER_INTERVAL), axis=1)
        nearest[: inwards // POINTS_PER_INTERVAL] = np.inf
        unseen = (nearest < doubt) & (doubt > LIMIT_TOLERANCE * scale)
        starts = times[:-1:POINTS_PER_INTERVAL]
        if np.any(passed):
            first = int(np.argmax(passed))
            within = max(0, first - 1) // POINTS_PER_INTERVAL  # the number of the interval between outputs
            is_exact = first == 0 or doubt[within] <= SETTLED_SHARE * -room[least]
            settled = is_exact and not np.any(unseen[:within])
            words = f"passed from {times[first]:.4g} s on, by up to {-room[least]:.3g} {self.unit}"
            return Activity(words, float(times[first]), bool(settled))
        if np.any(unseen):
            return Activity(UNSETTLED, float(starts[int(np.argmax(unseen))]), settled=False)
        return Activity(f"closest {max(0.0, room[least]):.3g} {self.unit} at {times[least]:.4g} s")


def _way_inwards(room: Array, rounded: float) -> tuple[int, int]:
    """Follow a value that starts at its limit and moves inwards from there.

    Args:
        room: (m,) distances from the limit, negative outside.
        rounded: largest distance from the limit at which a value starts "at" the limit.

    Returns:
        The number of time points until the value is inside, and until the value turns back. Both are 0 for a
        value that starts elsewhere or moves outwards.
    """
    rises = np.diff(room) > 0.0
    inwards = len(rises) if np.all(rises) else int(np.argmin(rises))
    inside = room[: inwards + 1] > 0.0
    if abs(room[0]) > rounded or not np.any(inside):
        return 0, 0
    return int(np.argmax(inside)), inwards


@dataclass(frozen=True)
class Rest:
    """Test of dry friction, which cannot act while its joint coordinates stay at rest without friction."""

    keys: tuple[Key, ...]

    def judge(self, motion: SampledMotion) -> Activity:
        seen = (motion.coordinate(key) for key in self.keys)
        moves = np.max([np.maximum(np.abs(x - x[0]), np.abs(rate)) for x, rate, _ in seen], axis=0)
        if np.max(moves) <= REST_SPEED:
            return Activity("at rest")
        first = float(motion.time[int(np.argmax(moves > REST_SPEED))])
        return Activity(f"moves from {first:.4g} s on", first)


def judge_all(watches: Sequence[Watch], motion: SampledMotion) -> Activity:
    """Combine the watches of an element, which acts from the first time at which any of them acts."""
    found = [watch.judge(motion) for watch in watches]
    times = [each.since for each in found if each.since is not None]
    words = "; ".join(each.words for each in found if each.active == bool(times))
    return Activity(words, min(times, default=None), all(each.settled for each in found))
