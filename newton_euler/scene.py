"""Scene: a mechanism and everything that one run of it needs."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from newton_euler.control import PD
from newton_euler.errors import MechanismError, UnknownNameError
from newton_euler.mechanism import UNIT_TOLERANCE, Mechanism
from newton_euler.scalars import Array
from newton_euler.state import State

OUTPUTS = ("velocities", "reactions", "actuation", "violation", "energy")
"""What may be asked for beside the poses."""

MAXIMUM_OUTPUTS = 1_000_000


@dataclass(frozen=True, eq=False)
class Scene:
    """A mechanism, its surroundings, its start and what is wanted of the run.

    Attributes:
        name: shown in tables and file names.
        mechanism: bodies and joints.
        duration: s.
        output_period: s between outputs; the last output is at `duration`.
        gravity: (3,) m/s^2, world frame.
        control: control laws of actuated joints, in the order of `Trajectory.actuator_force`.
        initial_state: the mechanism's initial pose, at rest, if not given.
        outputs: names out of `OUTPUTS`.
        description: one line for people.
    """

    name: str
    mechanism: Mechanism
    duration: float
    output_period: float
    gravity: Array = (0.0, 0.0, 0.0)  # type: ignore[assignment]
    control: tuple[PD, ...] = ()
    initial_state: State = field(default=None)  # type: ignore[assignment]
    outputs: frozenset[str] = frozenset(OUTPUTS)
    description: str = ""

    def __post_init__(self) -> None:
        where = f"scene {self.name!r}"
        for name in ("duration", "output_period"):
            value = getattr(self, name)
            if not isinstance(value, int | float) or not np.isfinite(value) or value <= 0.0:
                raise MechanismError(where, f"{name} is {value!r}", "a positive number of seconds")
        if self.duration / self.output_period > MAXIMUM_OUTPUTS:
            raise MechanismError(
                where,
                f"asks for {self.duration / self.output_period:.3g} outputs",
                f"at most {MAXIMUM_OUTPUTS}",
            )
        gravity = np.array(self.gravity, dtype=float)
        if gravity.shape != (3,) or not np.all(np.isfinite(gravity)):
            raise MechanismError(where, f"gravity is {self.gravity!r}", "three finite numbers, m/s^2")
        object.__setattr__(self, "gravity", gravity)
        for output in self.outputs:
            if output not in OUTPUTS:
                raise UnknownNameError("output", output, OUTPUTS)
        self._check_control()
        if self.initial_state is None:
            object.__setattr__(self, "initial_state", State.initial(self.mechanism))
        else:
            self._check_state(self.initial_state)

    def _check_control(self) -> None:
        for law in self.control:
            where = f"control of joint {law.joint!r}"
            joint = self.mechanism.joints[self.mechanism.joint_index(law.joint)]
            if not joint.actuated:
                raise MechanismError(where, "the joint is not actuated", "an actuated joint")
            if [(other.joint, other.coordinate) for other in self.control].count(
                (law.joint, law.coordinate)
            ) > 1:
                raise MechanismError(where, "has several laws for one coordinate", "one law a coordinate")
            kinds = [m.kind for m in joint.motions if m.kind != "ball"]
            if not 0 <= law.coordinate < len(kinds):
                raise MechanismError(where, f"coordinate is {law.coordinate}", f"an index below {len(kinds)}")

    def _check_state(self, state: State) -> None:
        count = len(self.mechanism.bodies)
        for name, width in (
            ("position", 3),
            ("quaternion", 4),
            ("linear_velocity", 3),
            ("angular_velocity", 3),
        ):
            value = np.asarray(getattr(state, name))
            if value.shape != (count, width) or not np.all(np.isfinite(value)):
                raise MechanismError(
                    f"initial state of scene {self.name!r}",
                    f"{name} has shape {value.shape} or holds numbers that are not finite",
                    f"finite numbers, shape ({count}, {width})",
                )
        norms = np.linalg.norm(state.quaternion, axis=1)
        worst = int(np.argmax(np.abs(norms - 1.0)))
        if abs(norms[worst] - 1.0) > UNIT_TOLERANCE:
            raise MechanismError(
                f"body {self.mechanism.body_names[worst]!r}",
                f"initial quaternion has norm {norms[worst]:.9g}",
                "a unit quaternion, w-x-y-z",
            )
        self.mechanism.check_closed(state.frames(), "in the initial state")

    @cached_property
    def times(self) -> Array:
        """(n,) output times, s: every period from 0, and the end."""
        count = int(np.floor(self.duration / self.output_period * (1.0 + 1e-12)))
        times = self.output_period * np.arange(count + 1)
        if self.duration - times[-1] > 1e-9 * self.output_period:
            return np.append(times, self.duration)
        times[-1] = self.duration
        return times
