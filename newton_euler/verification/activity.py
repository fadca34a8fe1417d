"""Whether an element that a scene leaves out would have done anything in a run, at its output times.

Limits, contacts and dry friction are no bilateral constraints, and scenes have none. Where a limit is not
reached and nothing touches, the run is that of the file all the same.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple, Protocol

import numpy as np

from newton_euler.model.constraints import Frame
from newton_euler.model.joint import Key
from newton_euler.model.motions import TimeFunction
from newton_euler.model.scene import Scene
from newton_euler.model.state import State
from newton_euler.model.trajectory import Trajectory
from newton_euler.scalars import Array

AT_REST = 1e-12
"""m/s and rad/s, below which velocities are round-off."""


class Course:
    """A scene's bodies and joint coordinates along a run with velocities, at its n output times."""

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
    """What was seen of an element."""

    active: bool
    words: str


class Watch(Protocol):
    """What tells whether an element is active."""

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
        found = np.array(
            [
                self.constant.value(float(time)) if isinstance(self.constant, TimeFunction) else self.constant
                for time in course.time
            ]
        )
        for key, factor in self.terms:
            x, rate = course.coordinate(key)
            found += factor * (self.by_value * x + self.by_rate * rate)
        room = np.minimum(found - self.low, self.high - found)
        if not np.all(np.isfinite(found)):
            return Judged(True, "not judged: its coordinate cannot be told from the poses")
        least = int(np.argmin(room))
        if room[least] >= 0.0:
            words = f"closest {room[least]:.3g} {self.unit} at {course.time[least]:.4g} s"
            return Judged(False, words if np.isfinite(room[least]) else "no limit")
        first = float(course.time[int(np.argmax(room < 0.0))])
        return Judged(True, f"passed from {first:.4g} s on, by up to {-room[least]:.3g} {self.unit}")


@dataclass(frozen=True)
class Rest:
    """Dry friction, which does nothing as long as its joint coordinates stay where they are by themselves."""

    keys: tuple[Key, ...]

    def judge(self, course: Course) -> Judged:
        rates = np.array([np.abs(course.coordinate(key)[1]) for key in self.keys])
        if np.max(rates) <= AT_REST:
            return Judged(False, "it stays where it is")
        first = float(course.time[int(np.argmax(np.max(rates, axis=0) > AT_REST))])
        return Judged(True, f"moves from {first:.4g} s on")


def judged(watches: Sequence[Watch], course: Course) -> Judged:
    """Of all that an element says; active if any of it is."""
    found = [watch.judge(course) for watch in watches]
    active = any(each.active for each in found)
    words = "; ".join(each.words for each in found if each.active == active)
    return Judged(active, words)
