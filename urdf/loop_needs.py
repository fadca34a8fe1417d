"""Rotors, springs, mimics and damping that a loop lacks if Pinocchio reads the URDF by itself.

The judged loop of `urdf.file_run` has all of these. A loop with the model of `pinocchio.buildModelFromUrdf`
simulates another robot, and the error of the judged loop is not that of the user's loop.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from newton_euler.reading.file_run import LoopNeed
from newton_euler.scalars import Array
from urdf.pinocchio_reference import PinocchioReference
from urdf.reference import UrdfReference

READER = "pinocchio.buildModelFromUrdf"
"""Function with which users read a URDF."""


def loop_needs(reference: PinocchioReference) -> Iterator[LoopNeed]:
    """Yield what the judged loop has and a user's loop lacks unless the user adds it.

    Args:
        reference: model of the judged loop. A model in memory has its own rotors.
    """
    if isinstance(reference, UrdfReference):
        armature = reference.model.armature
        if np.any(armature):
            values = " or ".join(dict.fromkeys(f"{x:.4g}" for x in armature[armature != 0.0]))
            remedy = f"{READER} drops rotors: set model.armature of these joints to {values}"
            yield LoopNeed(tuple(_of_joints("rotor", reference, armature)), remedy)
        springs = (*_of_joints("spring", reference, reference.stiffness), *reference.point_spring_names)
        if springs:
            yield LoopNeed(springs, f"{READER} drops springs: add their forces to tau")
        if reference.mimic_names:
            yield LoopNeed(reference.mimic_names, f"{READER} needs mimic=True for mimics")
    if np.any(reference.damping):
        remedy = "Pinocchio's dynamics ignore damping: add -damping * v to tau"
        yield LoopNeed(tuple(_of_joints("damping", reference, reference.damping)), remedy)


def _of_joints(what: str, reference: PinocchioReference, values: Array) -> Iterator[str]:
    """Yield a name such as "rotor of joint 'hip'" for each joint whose values (nv,) are not all zero."""
    for motion in dict.fromkeys(reference.motions[k] for k in np.flatnonzero(values)):
        yield f"{what} of {motion}"
