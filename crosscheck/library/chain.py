"""Scene of a chain of N rods on hinges: a mechanism without loops, of any size."""

from __future__ import annotations

from typing import Annotated

import numpy as np

from newton_euler.model.joint_kinds import Revolute
from newton_euler.model.mechanism import Body, Mechanism
from newton_euler.model.scene import Scene
from newton_euler.scalars import Array

ROD_MASS = 1.0
"""Mass of a rod, kg."""

ROD_LENGTH = 1.0
"""Length of a rod, m."""

ROD_INERTIA = ROD_MASS * ROD_LENGTH**2 / 12.0
"""Moment of inertia of a thin rod across the rod, about the center of mass, kg m^2."""

ROD_AXIAL_INERTIA = 1e-3
"""Moment of inertia along the rod, kg m^2, that of a solid rod 9 cm thick. A rigid body needs one."""


def rod(name: str, start: Array, axis: Array) -> Body:
    """Return a rod from `start` (3,), m, along a unit vector (3,). Its frame is parallel to the world."""
    along = np.outer(axis, axis)
    inertia = ROD_INERTIA * (np.eye(3) - along) + ROD_AXIAL_INERTIA * along
    return Body(name, ROD_MASS, start + 0.5 * ROD_LENGTH * axis, inertia)


X, Y, Z = np.eye(3)

HINGE_AXES = (Y + Z, Y - Z)
"""Axes of the hinges, of any length, used alternately, perpendicular to the rods and to each other. With
hinges along y, or along y and z alternately, the chain would stay in a plane: no force turns a hinge along
z."""


def chain(N: Annotated[int, range(1, 1001)] = 5) -> Scene:
    """Return N rods of 1 m and 1 kg that fall from rest, stretched out along x from a wall, 1 s.

    Args:
        N: number of rods, each with one hinge; the annotation has the allowed numbers.
    """
    names = ["ground", *(f"rod_{k}" for k in range(N))]
    starts = [k * ROD_LENGTH * X for k in range(N)]
    bodies = [Body.ground(), *(rod(name, start, X) for name, start in zip(names[1:], starts, strict=True))]
    joints = [
        Revolute(f"hinge_{k}", names[k], names[k + 1], start, axis=HINGE_AXES[k % 2])
        for k, start in enumerate(starts)
    ]
    return Scene(
        "chain",
        Mechanism(bodies, joints),
        duration=1.0,
        output_period=0.01,
        gravity=-9.81 * Z,
        description="N rods on hinges that alternate between two axes, falling from horizontal",
    )
