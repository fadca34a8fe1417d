"""Simulate a URDF with a loop in Pinocchio, and write a log for `crosscheck run --log`.

The URDF is the linkage of `examples/linkage.xml`; change the constants for your robot:

    crosscheck convert examples/linkage.xml linkage.urdf --set key=go
    python examples/pinocchio_log.py linkage.urdf pinocchio.csv
    crosscheck run linkage.urdf --set loops=linkage.loops.yaml --log pinocchio.csv
"""

from __future__ import annotations

import csv
import math
import sys
from collections.abc import Iterator
from typing import Any

import numpy as np
import pinocchio as pin

STEP, DURATION = 0.001, 1.0
"""Time step and duration, s."""

LOOP = "loop_on_coupler", "loop_on_rocker"
"""Frames of the URDF whose origins the loop connects."""

ROTORS: dict[str, float] = {}
"""Gear ratio^2 times rotor inertia, kg m^2, by joint: Pinocchio's reader drops the rotors of a URDF."""

MOTOR = "motor"
"""Joint that the torque drives."""

KP, KD = 0.01 / STEP**2, 0.2 / STEP
"""Baumgarte's gains, 1/s^2 and 1/s, that close a loop within some steps of RK4."""


class Robot:
    """Accelerations and time steps of a robot with a loop."""

    def __init__(self, path: str) -> None:
        """Read a URDF, and add what Pinocchio's reader drops: rotors, and the loop."""
        self.model = model = pin.buildModelFromUrdf(path)
        self.names = list(model.names)[1:]
        self.velocity_index = {name: model.joints[model.getJointId(name)].idx_v for name in self.names}
        armature = np.zeros(model.nv)
        for name, inertia in ROTORS.items():
            armature[self.velocity_index[name]] = inertia
        model.armature = armature
        # Pinocchio reads the damping, and does not simulate it
        self.damping = np.array(model.damping)
        first, second = (model.frames[model.getFrameId(name)] for name in LOOP)
        ends = first.parentJoint, first.placement, second.parentJoint, second.placement
        loop = pin.RigidConstraintModel(pin.ContactType.CONTACT_3D, model, *ends, pin.LOCAL)
        loop.setBaumgarteCorrectorParameters(pin.BaumgarteCorrectorParameters(KP, KD))
        self.loops, self.loop_data = [loop], [loop.createData()]
        self.proximal = pin.ProximalSettings(1e-12, 1e-10, 100)
        self.data = model.createData()
        pin.initConstraintDynamics(model, self.data, self.loops, self.loop_data)

    def acceleration(self, q: Any, v: Any, tau: Any) -> Any:
        """Return the accelerations (nv,) of all joints, with the loop closed."""
        force = tau - self.damping * v
        inputs = q, v, force, self.loops, self.loop_data, self.proximal
        return pin.constraintDynamics(self.model, self.data, *inputs).copy()

    def step(self, q: Any, v: Any, tau: Any) -> tuple[Any, Any]:
        """Return configuration and velocities after a time step of the Runge-Kutta method of order 4."""
        h, model = STEP, self.model
        a1 = self.acceleration(q, v, tau)
        v2 = v + h / 2 * a1
        a2 = self.acceleration(pin.integrate(model, q, h / 2 * v), v2, tau)
        v3 = v + h / 2 * a2
        a3 = self.acceleration(pin.integrate(model, q, h / 2 * v2), v3, tau)
        v4 = v + h * a3
        a4 = self.acceleration(pin.integrate(model, q, h * v3), v4, tau)
        q = pin.integrate(model, q, h / 6 * (v + 2 * v2 + 2 * v3 + v4))
        return q, v + h / 6 * (a1 + 2 * a2 + 2 * a3 + a4)

    def coordinates(self, q: Any) -> Iterator[float]:
        """Yield an angle or a length per joint; a continuous joint has cosine and sine in q."""
        for name in self.names:
            joint = self.model.joints[self.model.getJointId(name)]
            own = q[joint.idx_q : joint.idx_q + joint.nq]
            yield float(own[0]) if joint.nq == 1 else math.atan2(own[1], own[0])


def main(urdf: str, path: str) -> None:
    """Simulate the robot from its neutral pose, which must close the loop, and write the log."""
    robot = Robot(urdf)
    q, v = pin.neutral(robot.model), np.zeros(robot.model.nv)
    motor = robot.velocity_index[MOTOR]
    velocities = [robot.velocity_index[name] for name in robot.names]
    with open(path, "w", newline="") as file:
        rows = csv.writer(file)
        rows.writerow(
            ["time", *robot.names, *(f"{name}_velocity" for name in robot.names), f"{MOTOR}.effort"]
        )
        for k in range(round(DURATION / STEP) + 1):
            # N m, the value of the middle of the step, held during the step
            tau = np.zeros(robot.model.nv)
            tau[motor] = 0.01 * math.sin(2.0 * math.pi * (k + 0.5) * STEP)
            rows.writerow([k * STEP, *robot.coordinates(q), *v[velocities], tau[motor]])
            q, v = robot.step(q, v, tau)


if __name__ == "__main__":
    main(*sys.argv[1:])
