"""A point mass on a massless bar, from a horizontal bar at rest: closed form in elliptic functions.

Problem A01 of the IFToMM library of computational benchmark problems (M. Gonzalez, D. Dopico, U. Lugris,
J. Cuadrado, A benchmarking system for MBS simulation software, Multibody System Dynamics 16, 2006).

A point has no inertia about its center of mass, and no rigid body is like that. The body here is exactly
equivalent: a dumbbell with a second point of the same mass at the pivot, which never moves, so that motion,
moment of inertia and energy are those of the point mass alone. The pivot carries the second point's weight
besides the bar; `bar_tension` leaves it out.
"""

from __future__ import annotations

import numpy as np

from crosscheck.scenes.measure import Quantity, components, position, velocity
from newton_euler.model.joint_kinds import Revolute
from newton_euler.model.mechanism import Body, Mechanism
from newton_euler.model.scene import Scene
from newton_euler.model.trajectory import Trajectory
from newton_euler.scalars import Array

MASS = 1.0
"""Of the point, kg."""

LENGTH = 1.0
"""Of the bar, m."""

BAR_INERTIA = 1e-3
"""About the bar, kg m^2, so that the inertia is a rigid body's; the dumbbell never turns about it."""

GRAVITY = np.array([0.0, -9.81, 0.0])
"""m/s^2."""

X, Y, Z = np.eye(3)

POINT = -0.5 * LENGTH * X
"""The point mass in the dumbbell's frame, m."""


def pendulum() -> Scene:
    """A point of 1 kg on a bar of 1 m that falls from rest at x = -1 m, 10 s; gravity along -y."""
    across = 0.5 * MASS * LENGTH**2
    dumbbell = Body("dumbbell", 2.0 * MASS, POINT, np.diag([BAR_INERTIA, across, across]))
    return Scene(
        "pendulum",
        Mechanism([Body.ground(), dumbbell], [Revolute("pivot", "ground", "dumbbell", np.zeros(3), axis=Z)]),
        duration=10.0,
        output_period=0.01,
        gravity=GRAVITY,
        description="point mass on a massless bar, falling from horizontal, closed form known",
    )


def _point(run: Trajectory) -> Array:
    return position(run, "dumbbell", POINT)


def _bar_tension(run: Trajectory) -> Array:
    """(n,) N: what the bar pulls the point mass with, positive towards the pivot.

    On the point at the pivot, which rests: reaction + weight + tension along the bar = 0.
    """
    assert run.reaction_force is not None
    force = run.reaction_force[:, run.joint_names.index("pivot")] + MASS * GRAVITY
    return np.asarray(-np.sum(force * _point(run), axis=1) / LENGTH)


FIGURES: dict[str, Quantity] = {
    **components(("x", "y"), _point),
    **components(("vx", "vy"), lambda run: velocity(run, "dumbbell", POINT)),
    "bar_tension": _bar_tension,
}
"""Of the point mass: position (m), velocity (m/s); tension of the bar (N)."""
