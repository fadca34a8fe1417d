"""MuJoCo's coordinates of the states of described robots."""

from __future__ import annotations

import mujoco
import numpy as np

from newton_euler.reading.robot import (
    JointKind,
    Robot,
)
from newton_euler.scalars import Array


def _matrix(quaternion: Array) -> Array:
    matrix = np.zeros(9)
    mujoco.mju_quat2Mat(matrix, quaternion)
    return matrix.reshape(3, 3)


def to_mujoco(
    model: mujoco.MjModel, robot: Robot, coordinates: Array, velocities: Array
) -> tuple[Array, Array]:
    """Return qpos and qvel of coordinates and velocities in the order of `differences.dynamics`."""
    qpos, qvel = model.qpos0.copy(), np.zeros(model.nv)
    start, joint = 0, 0
    for body in robot.bodies:
        for described in body.joints:
            at, dof = model.jnt_qposadr[joint], model.jnt_dofadr[joint]
            joint += 1
            if described.kind in (JointKind.HINGE, JointKind.SLIDE):
                qpos[at], qvel[dof] = coordinates[start], velocities[start]
                start += 1
                continue
            if described.kind is JointKind.FREE:
                place = body.placement.position + body.placement.rotation @ coordinates[start : start + 3]
                qpos[at : at + 3] = place
                at, start = at + 3, start + 3
            quaternion, turn = np.zeros(4), coordinates[start : start + 3]
            mujoco.mju_axisAngle2Quat(quaternion, turn / (np.linalg.norm(turn) or 1.0), np.linalg.norm(turn))
            if described.kind is JointKind.FREE:
                mujoco.mju_mulQuat(
                    quaternion, model.body_quat[1 + robot.bodies.index(body)], quaternion.copy()
                )
                qvel[dof : dof + 3] = _matrix(quaternion) @ velocities[start - 3 : start]
                dof += 3
            qpos[at : at + 4], qvel[dof : dof + 3] = quaternion, velocities[start : start + 3]
            start += 3
    return qpos, qvel
