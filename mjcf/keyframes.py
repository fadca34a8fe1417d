"""Keyframes of a MuJoCo model as named starts of runs."""

from __future__ import annotations

from collections.abc import Iterator

import mujoco

from newton_euler.reading.robot import FileStart

SINGLE = (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE)
"""Types of joints with one coordinate."""


def starts(model: mujoco.MjModel) -> Iterator[FileStart]:
    """Yield the coordinates and velocities of the hinges and slides that have names, in each keyframe.

    Args:
        model: the model.
    """
    single = [
        (model.joint(number).name, int(model.jnt_qposadr[number]), int(model.jnt_dofadr[number]))
        for number in range(model.njnt)
        if mujoco.mjtJoint(model.jnt_type[number]) in SINGLE and model.joint(number).name
    ]
    for number in range(model.nkey):
        coordinates, velocities = model.key_qpos[number].tolist(), model.key_qvel[number].tolist()
        yield FileStart(
            model.key(number).name,
            {name: coordinates[in_q] for name, in_q, _ in single},
            {name: velocities[in_v] for name, _, in_v in single},
        )
