"""Find the elements of a model file, such as limits and contacts, that would have acted in a run.

Scenes do not simulate joint limits, contacts and dry friction of the file. If no limit is reached, nothing
touches and nothing with friction moves, the run of the scene is nevertheless valid for the whole file. Each
condition under which an element acts is a `Watch`. A watch judges the motion of the run, which is
interpolated between output times by cubic polynomials through values and rates. The interpolation error at an
output is estimated with a cubic through the neighbors of the output. If the error hides whether an element
acts, the result is *not settled*, and the run has to be repeated with more outputs.
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
"""Speed, m/s or rad/s, and displacement, m or rad, up to which a motion is round-off."""

POINTS_PER_INTERVAL = 16
"""Number of equal parts of each output interval; elements are checked at the ends of the parts."""

MAX_POSE_ERROR = 1e-2
"""Largest error of interpolated poses: rad, and m per m of length of the largest body."""

LIMIT_TOLERANCE = 1e-9
"""Largest overshoot of a limit that does not count: rad, m, or a fraction of the limit of a force."""

START_LIMIT_TOLERANCE = 1e-6
"""Largest overshoot of a limit at the start that does not count, in the same units. Files that MuJoCo saves
have six digits."""

SETTLED_SHARE = 1e-3
"""Largest interpolation error, as a fraction of the overshoot of a limit. With a larger error, the time at
which the limit is first passed is not settled."""

UNSETTLED = "may act between output times"
"""Observation for a result that only a run with more outputs can settle."""


def cubic_error(time: Array, x: Array, rate: Array) -> Array:
    """Estimate the error of cubic interpolation between outputs.

    For each output, a cubic through its two neighbors predicts the value and the rate. The error at the
    output is the error of the value plus the error of the rate times the step.

    Args:
        time: (n,) s.
        x: (n, ...) values at the outputs.
        rate: (n, ...) time derivatives of the values.

    Returns:
        (n - 1, ...) the larger error of the two outputs that bound each interval; infinite for fewer than
        three outputs.
    """
    if len(time) < 3:
        return np.full((len(time) - 1, *x.shape[1:]), np.inf)
    errors = np.zeros(x.shape)
    # Cubics through the outputs of even numbers predict those of odd numbers, and vice versa
    for first in (0, 1):
        ends, within = slice(first, None, 2), slice(first + 1, len(time) - 1, 2)
        if len(time[within]):
            curve = _cubic_curve(time[ends], x[ends], rate[ends])
            steps = np.diff(time)[within].reshape(-1, *(1,) * (x.ndim - 1))
            rate_errors = curve(time[within], 1) - rate[within]
            errors[within] = np.abs(curve(time[within]) - x[within]) + steps * np.abs(rate_errors)
    errors[0], errors[-1] = errors[1], errors[-2]  # the first and the last output have one neighbor only
    return np.maximum(errors[:-1], errors[1:])


class SampledMotion:
    """Bodies and joint coordinates of a scene at the output times of a run and between them.

    Attributes:
        scene: the scene of the run.
        run: a trajectory of the scene with velocities, at n output times.
        time: (m,) s, output times and `POINTS_PER_INTERVAL` - 1 times between each two of them.
    """

    def __init__(self, scene: Scene, run: Trajectory) -> None:
        self.scene, self.run = scene, run
        fractions = np.arange(POINTS_PER_INTERVAL) / POINTS_PER_INTERVAL
        between = run.time[:-1, None] + np.diff(run.time)[:, None] * fractions
        self.time: Array = np.append(between.ravel(), run.time[-1])
        self._coordinates: dict[Key, tuple[Array, Array, Array]] = {}

    @cached_property
    def _quaternion_rates(self) -> Array:
        """(n, b, 4) rates of the quaternions at the output times, 1/s: half of (0, omega) times q."""
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
        distances = np.linalg.norm(cubic_error(run.time, run.position, run.linear_velocity), axis=2)
        # a rotation by a small angle changes a quaternion by half the angle
        quaternion_errors = cubic_error(run.time, run.quaternion, self._quaternion_rates)
        angles = 2.0 * np.linalg.norm(quaternion_errors, axis=2)
        largest = self.scene.mechanism.largest_extent  # m, length of the largest body from its center of mass
        return bool(np.all(distances <= MAX_POSE_ERROR * largest) and np.all(angles <= MAX_POSE_ERROR))

    @cached_property
    def poses(self) -> tuple[Array, Array]:
        """Centers of mass (m, b, 3), m, and quaternions (m, b, 4) at all times, world frame."""
        quaternions = _cubic_curve(self.run.time, self.run.quaternion, self._quaternion_rates)(self.time)
        assert self.run.linear_velocity is not None
        centers = _cubic_curve(self.run.time, self.run.position, self.run.linear_velocity)(self.time)
        return centers, quaternions / np.linalg.norm(quaternions, axis=2, keepdims=True)

    # Angles of several consecutive hinges are NaN for orientations that the hinges cannot reach
    @np.errstate(invalid="ignore")
    def coordinate(self, key: Key) -> tuple[Array, Array, Array]:
        """Compute a joint coordinate, m or rad from the initial pose, with full revolutions.

        Args:
            key: name of the joint, and index of the coordinate within the joint.

        Returns:
            The coordinate (m,), its rate (m,), and its interpolation error between outputs (n - 1,). All are
            NaN if the poses do not determine the coordinate at every output time.
        """
        if key not in self._coordinates:
            (joint, index), time = key, self.run.time
            # a trajectory that was made from arrays has no mechanism
            measured = replace(self.run, mechanism=self.scene.mechanism).joint(joint)
            assert measured.rates is not None
            x, rate = measured.coordinates[:, index], measured.rates[:, index]
            if np.all(np.isfinite([x, rate])):
                curve = _cubic_curve(time, x, rate)
                self._coordinates[key] = curve(self.time), curve(self.time, 1), cubic_error(time, x, rate)
            else:
                unknown = np.full(self.time.shape, np.nan)
                self._coordinates[key] = unknown, unknown, unknown[1 : len(time)]
        return self._coordinates[key]


def _cubic_curve(time: Array, x: Array, rate: Array) -> Any:
    """Interpolate values by cubic Hermite polynomials.

    Args:
        time: (n,) s.
        x: (n, ...) values.
        rate: (n, ...) their time derivatives.

    Returns:
        A function of a time or an array of times, s, and of the order of the derivative, 0 or 1.
    """

    def curve(at: Array | float, order: int = 0) -> Array:
        if len(time) == 1:
            return np.asarray((rate if order else x)[np.zeros(np.shape(at), dtype=int)])
        # Output interval k in which each time lies; s runs from 0 to 1 within the interval
        k = np.clip(np.searchsorted(time, at, side="right") - 1, 0, len(time) - 2)
        size, shape = time[k + 1] - time[k], (*np.shape(at), *(1,) * (x.ndim - 1))
        s, h = np.reshape((at - time[k]) / size, shape), np.reshape(size, shape)
        # x(s) = x_k + begin s + square s^2 + cube s^3
        change, begin, end = x[k + 1] - x[k], h * rate[k], h * rate[k + 1]
        square, cube = 3.0 * change - 2.0 * begin - end, begin + end - 2.0 * change
        if order:
            return np.asarray((begin + s * (2.0 * square + 3.0 * s * cube)) / h)
        return np.asarray(x[k] + s * (begin + s * (square + s * cube)))

    return curve


class Activity(NamedTuple):
    """Result of a test whether and when an element would have acted in a run.

    Attributes:
        words: the observation, for the import report.
        since: s, the first time at which the element acts or may act; None if the element does not act.
        settled: False if only a run with more outputs can show whether and when the element acts.
    """

    words: str
    since: float | None = None
    settled: bool = True

    @property
    def active(self) -> bool:
        """True if the element acts, or may act, at any time of the run."""
        return self.since is not None


class Watch(Protocol):
    """Test whether one condition under which an element acts occurs in a run."""

    def judge(self, motion: SampledMotion) -> Activity:
        """Report whether the element acts at any time of a motion."""


ABSOLUTE_UNITS = ("m", "rad", "m or rad", "m/s", "rad/s")
"""Units of limits with absolute tolerances; tolerances of limits in other units (forces) are relative to the
limit."""


@dataclass(frozen=True)
class Bounds:
    """Limit of a joint coordinate or force: low <= constant + by_value * x + by_rate * dx/dt <= high.

    x is a weighted sum of joint coordinates. For a limit of a coordinate, constant = 0, by_value = 1 and
    by_rate = 0. For a limit of the force of a servo (an actuator with position and velocity feedback),
    by_value and by_rate are the negative gains.

    Attributes:
        terms: joint coordinates (joint name, index of the coordinate) with their weights in x.
        low, high: limits, may be infinite.
        unit: unit of the limits.
        constant: number, or function of time.
        by_value: factor of x: 1, or a gain in SI units.
        by_rate: factor of dx/dt: s, or a gain in SI units.
    """

    terms: tuple[tuple[Key, float], ...]
    low: float
    high: float
    unit: str
    constant: float | TimeFunction = 0.0
    by_value: float = 1.0
    by_rate: float = 0.0

    @property
    def is_of_force(self) -> bool:
        """True for a limit of forces or torques, False for one of coordinates or rates."""
        return self.unit not in ABSOLUTE_UNITS

    def judge(self, motion: SampledMotion) -> Activity:
        """Report whether the limit is passed at any time of a motion."""
        # Sum the terms and their interpolation errors; the error of a rate is estimated as the error of the
        # coordinate divided by the time between outputs
        x, rate = np.zeros((2, len(motion.time)))
        steps = np.diff(motion.run.time)
        errors = np.zeros(steps.shape)
        for key, factor in self.terms:
            value, value_rate, error = motion.coordinate(key)
            x, rate = x + factor * value, rate + factor * value_rate
            errors += abs(factor) * (abs(self.by_value) + abs(self.by_rate) / steps) * error
        if not np.all(np.isfinite(x)):
            return Activity("not judged: the poses do not determine its coordinate", since=0.0)
        constant: Any = self.constant
        if isinstance(constant, TimeFunction):
            constant = np.array([constant.value(time) for time in motion.time.tolist()])
        return self.judge_values(motion.time, constant + self.by_value * x + self.by_rate * rate, errors)

    def judge_values(self, times: Array, values: Array, errors: Array) -> Activity:
        """Find the first time at which values pass the limits.

        A coordinate that starts at its limit and moves inwards needs no force, even if the rounded digits of
        the file place the start up to `START_LIMIT_TOLERANCE` outside.

        Args:
            times: (m,) s, output times and `POINTS_PER_INTERVAL` - 1 times between each two of them.
            values: (m,) values of the limited quantity.
            errors: (n - 1,) largest interpolation error of the values in each output interval.
        """
        # Distance from the nearer limit, negative outside
        room = np.minimum(values - self.low, self.high - values)
        worst = int(np.argmin(room))
        if np.isinf(room[worst]):
            return Activity("no limit")
        limits = [abs(limit) for limit in (self.low, self.high) if np.isfinite(limit)]
        scale = max(limits) if self.is_of_force else 1.0
        # Times at which the limit is passed, except a start at the limit from which the value moves inwards
        is_passed = room < -LIMIT_TOLERANCE * scale
        inside_from, inwards_until = _way_inwards(room, START_LIMIT_TOLERANCE * scale)
        is_passed[:inside_from] = False
        # Output intervals in which the interpolation error may hide that the limit is passed
        nearest = np.min(np.minimum(room[1:], room[:-1]).reshape(-1, POINTS_PER_INTERVAL), axis=1)
        nearest[: inwards_until // POINTS_PER_INTERVAL] = np.inf
        may_hide = (nearest < errors) & (errors > LIMIT_TOLERANCE * scale)
        interval_starts = times[:-1:POINTS_PER_INTERVAL]
        if np.any(is_passed):
            first = int(np.argmax(is_passed))
            # The time is settled if the error is small, and if no earlier interval may hide an overshoot
            interval = max(0, first - 1) // POINTS_PER_INTERVAL
            is_exact = first == 0 or errors[interval] <= SETTLED_SHARE * -room[worst]
            settled = is_exact and not np.any(may_hide[:interval])
            words = f"passed from {times[first]:.4g} s on, by up to {-room[worst]:.3g} {self.unit}"
            return Activity(words, float(times[first]), bool(settled))
        if np.any(may_hide):
            return Activity(UNSETTLED, float(interval_starts[int(np.argmax(may_hide))]), settled=False)
        return Activity(f"closest {max(0.0, room[worst]):.3g} {self.unit} at {times[worst]:.4g} s")


def _way_inwards(room: Array, at_limit: float) -> tuple[int, int]:
    """Find how long a value that starts at its limit moves inwards from there.

    Args:
        room: (m,) distances from the limit, negative outside.
        at_limit: largest distance from the limit at which a value starts "at" the limit.

    Returns:
        The number of time points until the value is inside, and until the value turns back. Both are 0 for a
        value that starts elsewhere or moves outwards.
    """
    rises = np.diff(room) > 0.0
    inwards = len(rises) if np.all(rises) else int(np.argmin(rises))
    inside = room[: inwards + 1] > 0.0
    if abs(room[0]) > at_limit or not np.any(inside):
        return 0, 0
    return int(np.argmax(inside)), inwards


@dataclass(frozen=True)
class FrictionWatch:
    """Test of dry friction: friction acts from the time at which one of its joint coordinates moves.

    If the coordinates stay at rest in the run without friction, they also stay at rest with friction.

    Attributes:
        keys: the joint coordinates with friction (joint name, index of the coordinate).
    """

    keys: tuple[Key, ...]

    def judge(self, motion: SampledMotion) -> Activity:
        """Report whether a coordinate leaves its initial value or has a rate, by more than round-off."""
        coordinates = (motion.coordinate(key) for key in self.keys)
        moves = np.max([np.maximum(np.abs(x - x[0]), np.abs(rate)) for x, rate, _ in coordinates], axis=0)
        if np.max(moves) <= REST_SPEED:
            return Activity("at rest")
        first = float(motion.time[int(np.argmax(moves > REST_SPEED))])
        return Activity(f"moves from {first:.4g} s on", first)


def judge_all(watches: Sequence[Watch], motion: SampledMotion) -> Activity:
    """Combine all tests of one element: the element acts from the earliest time that any test finds."""
    found = [watch.judge(motion) for watch in watches]
    times = [each.since for each in found if each.since is not None]
    # The observations of the tests that find activity; of all tests if none does
    words = "; ".join(each.words for each in found if each.active == bool(times))
    return Activity(words, min(times, default=None), all(each.settled for each in found))
