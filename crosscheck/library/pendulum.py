"""Scene of a pendulum: a point mass on a massless bar, released horizontally. Elliptic functions give its
motion.

Problem A01 of the IFToMM library of computational benchmark problems (M. Gonzalez, D. Dopico, U. Lugris,
J. Cuadrado, A benchmarking system for MBS simulation software, Multibody System Dynamics 16, 2006).

A point mass has no inertia about its center of mass, which no rigid body can have. The scene therefore uses a
dumbbell with a second point of the same mass at the pivot. The second point never moves, so motion, moment of
inertia about the pivot and kinetic energy equal those of the point mass alone. The reaction at the pivot
includes the weight of the second point; `bar_tension` subtracts it.
"""

from __future__ import annotations

import numpy as np

from crosscheck.library.measure import Quantity, components, position, velocity
from newton_euler.model.joint_kinds import Revolute
from newton_euler.model.mechanism import Body, Mechanism
from newton_euler.model.scene import Scene
from newton_euler.model.trajectory import Trajectory
from newton_euler.scalars import Array

POINT_MASS = 1.0
"""Mass of the point, kg."""

BAR_LENGTH = 1.0
"""Length of the bar, m."""

BAR_INERTIA = 1e-3
"""Moment of inertia about the bar, kg m^2. A rigid body needs one; the dumbbell never turns about the bar."""

GRAVITY = np.array([0.0, -9.81, 0.0])
"""Acceleration (3,) of gravity, m/s^2."""

X, Y, Z = np.eye(3)

POINT = -0.5 * BAR_LENGTH * X
"""Vector (3,) from the dumbbell's center of mass to the point mass, frame of the dumbbell, m."""


def pendulum() -> Scene:
    """Return the pendulum: 1 kg on a bar of 1 m that falls from rest at x = -1 m, 10 s; gravity along -y."""
    across = 0.5 * POINT_MASS * BAR_LENGTH**2
    center = -0.5 * BAR_LENGTH * X  # halfway between the pivot at the origin and the point mass
    dumbbell = Body("dumbbell", 2.0 * POINT_MASS, center, np.diag([BAR_INERTIA, across, across]))
    return Scene(
        "pendulum",
        Mechanism([Body.ground(), dumbbell], [Revolute("pivot", "ground", "dumbbell", np.zeros(3), axis=Z)]),
        duration=10.0,
        output_period=0.01,
        gravity=GRAVITY,
        description="point mass on a massless bar, falling from horizontal, closed form known",
    )


def _point(run: Trajectory) -> Array:
    """Return the positions (n, 3) of the point mass, m."""
    return position(run, "dumbbell", POINT)


def _bar_tension(run: Trajectory) -> Array:
    """Return the tension (n,) of the bar, N, positive if the bar pulls the point mass towards the pivot.

    The point at the pivot is at rest: reaction + weight + tension along the bar = 0.
    """
    assert run.reaction_force is not None
    force = run.reaction_force[:, run.joint_names.index("pivot")] + POINT_MASS * GRAVITY
    return np.asarray(-np.sum(force * _point(run), axis=1) / BAR_LENGTH)


REFERENCE_QUANTITIES: dict[str, Quantity] = {
    **components(("x", "y"), _point),
    **components(("vx", "vy"), lambda run: velocity(run, "dumbbell", POINT)),
    "bar_tension": _bar_tension,
}
"""Position (m) and velocity (m/s) of the point mass, tension of the bar (N), by name. A crosscheck compares
them with values of the closed form."""
