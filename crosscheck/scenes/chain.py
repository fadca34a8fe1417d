"""N rods in a row on hinges: an open tree of any size."""

from __future__ import annotations

from typing import Annotated

import numpy as np

from newton_euler.model.joint_kinds import Revolute
from newton_euler.model.mechanism import Body, Mechanism
from newton_euler.model.scene import Scene
from newton_euler.scalars import Array

MASS = 1.0
"""kg."""

LENGTH = 1.0
"""m."""

INERTIA = MASS * LENGTH**2 / 12.0
"""About the center of mass across the rod, kg m^2: that of a thin rod."""

AXIAL_INERTIA = 1e-3
"""About the rod itself, kg m^2: that of a solid one 9 cm thick. A line has none, and no rigid body can."""


def rod(name: str, start: Array, axis: Array) -> Body:
    """A rod from `start` (3,) m along a world axis, (3,) unit; its frame is parallel to the world."""
    along = np.outer(axis, axis)
    inertia = INERTIA * (np.eye(3) - along) + AXIAL_INERTIA * along
    return Body(name, MASS, start + 0.5 * LENGTH * axis, inertia)


X, Y, Z = np.eye(3)

AXES = (Y + Z, Y - Z)
"""Of the hinges in turn, across the rods and each other. Hinges along y would keep the fall in a plane;
so would y and z in turn, as no force turns the hinges along z."""


def chain(N: Annotated[int, range(1, 1001)] = 5) -> Scene:
    """N rods of 1 m and 1 kg that fall from rest, stretched out along x from a wall, 1 s.

    Args:
        N: rods, each with one hinge.
    """
    names = ["ground", *(f"rod_{k}" for k in range(N))]
    starts = [k * LENGTH * X for k in range(N)]
    bodies = [Body.ground(), *(rod(name, start, X) for name, start in zip(names[1:], starts, strict=True))]
    joints = [
        Revolute(f"hinge_{k}", names[k], names[k + 1], start, axis=AXES[k % 2])
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
