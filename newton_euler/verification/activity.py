"""Activity in a run of elements that a scene leaves out.

Limits, contacts and dry friction are no bilateral constraints, and scenes have none. Where a limit is not
reached and nothing touches, the run is that of the file all the same. Between output times motion is that of
cubics through values and rates, which are off by about as much as those across an output miss it, and less
where outputs are close enough. What these leave open counts as active.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple, Protocol

import numpy as np

from newton_euler.model.constraints import Frame
from newton_euler.model.euler_parameters import angle_between, product
from newton_euler.model.joint import Key
from newton_euler.model.motions import TimeFunction
from newton_euler.model.scene import Scene
from newton_euler.model.state import State
from newton_euler.model.trajectory import Trajectory
from newton_euler.scalars import Array

AT_REST = 1e-12
"""m/s and rad/s, below which velocities are round-off."""

PARTS = 16
"""Of the time between outputs, at whose ends cubics are evaluated."""

UNSEEN = "not seen between output times: ask for more of them"
"""Words on what may have been active there."""


def between(time: Array, x: Array, rate: Array, n: int, at: float) -> Array:
    """The cubic through values (n, ...) and their rates at outputs n and n + 1, evaluated at a time, s."""
    return _cubic(time[n : n + 2], x[n : n + 2], rate[n : n + 2], at)[0]


def missed(time: Array, x: Array, rate: Array) -> Array:
    """By how much cubics may miss values (n, ...) between outputs, (n - 1, ...).

    The larger, of the outputs at both ends, of what the cubic across that output misses there: of the value,
    and of the rate times the step. Infinite if there are too few outputs to tell.
    """
    if len(time) < 3:
        return np.full((len(time) - 1, *x.shape[1:]), np.inf)
    miss = np.zeros(x.shape)
    for n in range(1, len(time) - 1):
        ends = slice(n - 1, n + 2, 2)
        value, slope = _cubic(time[ends], x[ends], rate[ends], float(time[n]))
        step = 0.5 * float(time[n + 1] - time[n - 1])
        miss[n] = np.abs(value - x[n]) + step * np.abs(slope - rate[n])
    miss[0], miss[-1] = miss[1], miss[-2]
    return np.maximum(miss[:-1], miss[1:])


def _cubic(time: Array, x: Array, rate: Array, at: float) -> tuple[Array, Array]:
    """Value and rate at a time of the cubic through two values and rates."""
    step = float(time[1] - time[0])
    s = (at - float(time[0])) / step
    change = x[1] - x[0] - step * rate[0]
    bend = step * (rate[1] - rate[0]) - 2.0 * change
    value = x[0] + s * step * rate[0] + s**2 * change - s**2 * (1.0 - s) * bend
    slope = rate[0] + (2.0 * s * change - (2.0 * s - 3.0 * s**2) * bend) / step
    return np.asarray(value), np.asarray(slope)


class Course:
    """A scene's bodies and joint coordinates along a run with velocities, at and between n output times."""

    def __init__(self, scene: Scene, run: Trajectory) -> None:
        self.scene, self.run, self.time = scene, run, run.time
        self._found: dict[Key, tuple[Array, Array]] = {}

    @cached_property
    def frames(self) -> list[list[Frame]]:
        """Of all bodies, at each time."""
        run = self.run
        assert run.linear_velocity is not None
        assert run.angular_velocity is not None
        rows = zip(run.position, run.quaternion, run.linear_velocity, run.angular_velocity, strict=True)
        return [State(*row).frames() for row in rows]

    @cached_property
    def spins(self) -> Array:
        """(n, b, 4) rates of the quaternions, 1/s."""
        omega = self.run.angular_velocity
        assert omega is not None
        pure = np.concatenate([np.zeros((*omega.shape[:2], 1)), omega], axis=2)
        return np.array(
            [
                [0.5 * product(w, q) for w, q in zip(*each, strict=True)]
                for each in zip(pure, self.run.quaternion, strict=True)
            ]
        )

    def poses(self, n: int, at: float) -> tuple[Array, Array]:
        """Centers of mass (b, 3) and quaternions (b, 4) at a time between outputs n and n + 1, s."""
        run = self.run
        assert run.linear_velocity is not None
        turned = between(run.time, run.quaternion, self.spins, n, at)
        centers = between(run.time, run.position, run.linear_velocity, n, at)
        return centers, turned / np.linalg.norm(turned, axis=1, keepdims=True)

    @cached_property
    def blur(self) -> tuple[Array, Array]:
        """(n - 1, b) by how much poses between outputs may be off, m and rad."""
        run = self.run
        assert run.linear_velocity is not None
        moved = missed(run.time, run.position, run.linear_velocity)
        turned = missed(run.time, run.quaternion, self.spins)
        return np.linalg.norm(moved, axis=2), 2.0 * np.linalg.norm(turned, axis=2)

    @cached_property
    def speeds(self) -> tuple[Array, Array]:
        """(n - 1, b) the largest of bodies between outputs, m/s and rad/s."""
        run, steps = self.run, np.diff(self.time)[:, None]
        assert run.linear_velocity is not None
        assert run.angular_velocity is not None
        mean = np.linalg.norm(np.diff(run.position, axis=0), axis=2) / steps
        found = []
        for rates, across in (
            (run.linear_velocity, mean),
            (run.angular_velocity, angle_between(run.quaternion[1:], run.quaternion[:-1]) / steps),
        ):
            sizes = np.linalg.norm(rates, axis=2)
            ends = np.maximum(sizes[1:], sizes[:-1])
            found.append(np.maximum(ends, 1.5 * across + 0.5 * ends))  # of a cubic through them
        return found[0], found[1]

    @np.errstate(invalid="ignore")  # of hinges in a row, which do not reach every orientation
    def coordinate(self, key: Key) -> tuple[Array, Array]:
        """A joint coordinate (n,), m or rad from the initial pose, turns counted, and its rate (n,)."""
        if key not in self._found:
            mechanism = self.scene.mechanism
            equations = mechanism.joint_equations(key[0])
            measure = equations.coordinates[key[1]]
            x, rate = np.zeros((2, len(self.time)))
            for n, frames in enumerate(self.frames):
                first, second = frames[equations.first], frames[equations.second]
                x[n] = measure.phi(first, second)[0]
                rate[n] = measure.jacobian(first, second).rate(first, second)[0]
            self._found[key] = x if measure.is_length else np.unwrap(x), rate
        return self._found[key]


class Judged(NamedTuple):
    """Observation of an element."""

    active: bool
    words: str


class Watch(Protocol):
    """Watch that tells whether an element is active."""

    def judge(self, course: Course) -> Judged:
        """Look at all output times."""


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
        for key, factor in self.terms:
            value, slope = course.coordinate(key)
            x, rate = x + factor * value, rate + factor * slope
        if not np.all(np.isfinite([x, rate])):
            return Judged(True, "not judged: its coordinate cannot be told from the poses")
        times, found = [float(course.time[0])], [self._value(float(course.time[0]), x[0], rate[0])]
        for n in range(len(course.time) - 1):
            ends = slice(n, n + 2)
            for at in np.linspace(course.time[n], course.time[n + 1], PARTS + 1)[1:].tolist():
                times.append(at)
                found.append(self._value(at, *_cubic(course.time[ends], x[ends], rate[ends], at)))
        miss = missed(course.time, x, rate)
        steps = np.diff(course.time)
        unsure = np.repeat((abs(self.by_value) + abs(self.by_rate) / steps) * miss, PARTS)
        return self.judged(np.array(times), np.array(found), unsure)

    def _value(self, time: float, x: Array, rate: Array) -> float:
        constant = self.constant.value(time) if isinstance(self.constant, TimeFunction) else self.constant
        return float(constant + self.by_value * x + self.by_rate * rate)

    def judged(self, times: Array, found: Array, unsure: Array) -> Judged:
        """Judge values at times of `PARTS` of each step, between which they may be off by `unsure`."""
        room = np.minimum(found - self.low, self.high - found)
        seen = room[::PARTS]
        if np.any(seen < 0.0):
            first, most = float(times[::PARTS][int(np.argmax(seen < 0.0))]), -float(np.min(seen))
            return Judged(True, f"passed from {first:.4g} s on, by up to {most:.3g} {self.unit}")
        if np.any(room < 0.0):
            first, most = float(times[int(np.argmax(room < 0.0))]), -float(np.min(room))
            how = f"from {first:.4g} s on, by up to {most:.3g} {self.unit}"
            return Judged(True, f"passed between output times, {how}")
        if np.all(np.isinf(room)):
            return Judged(False, "no limit")
        bends = np.abs(np.diff(found, 2)) / 8.0  # within parts
        doubt = unsure + np.maximum(np.append(bends, bends[-1:]), np.insert(bends, 0, bends[:1]))
        if np.any((np.minimum(room[1:], room[:-1]) < doubt) & (doubt > AT_REST)):
            return Judged(True, UNSEEN)
        least = int(np.argmin(room))
        return Judged(False, f"closest {room[least]:.3g} {self.unit} at {times[least]:.4g} s")


@dataclass(frozen=True)
class Rest:
    """Dry friction, which does nothing as long as its joint coordinates stay where they are by themselves."""

    keys: tuple[Key, ...]

    def judge(self, course: Course) -> Judged:
        seen = (course.coordinate(key) for key in self.keys)
        moves = np.max([np.maximum(np.abs(x - x[0]), np.abs(rate)) for x, rate in seen], axis=0)
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
        x, _ = course.coordinate(self.key)
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
