"""Scene of Bricard's mechanism: an over-constrained loop of five bars and six hinges that has one freedom.

Problem A04 of the IFToMM library of computational benchmark problems (M. Gonzalez, D. Dopico, U. Lugris,
J. Cuadrado, A benchmarking system for MBS simulation software, Multibody System Dynamics 16, 2006). Six
hinges are thirty constraints on the thirty freedoms of five bodies. With these axes one constraint is
redundant in every configuration, so that one degree of freedom remains.
"""

from __future__ import annotations

import numpy as np

from crosscheck.library.measure import Quantity, angle, angular_velocity, components, position, velocity
from newton_euler.model.joint_kinds import Revolute
from newton_euler.model.mechanism import Body, Mechanism
from newton_euler.model.scene import Scene

BAR_MASS = 1.0
"""Mass of a bar, kg."""

BAR_LENGTH = 1.0
"""Length of a bar, m."""

SECTION = 0.1
"""Width of a bar's square cross section, m."""

POINTS = np.array(
    [
        [0.0, 0.0, 0.0],
        [1.0, 0.0, 0.0],
        [1.0, -1.0, 0.0],
        [1.0, -1.0, 1.0],
        [0.0, -1.0, 1.0],
        [0.0, 0.0, 1.0],
    ]
)
"""Initial positions (6, 3) of the hinges P1 to P6, m."""

X, Y, Z = np.eye(3)

HINGE_AXES = (Y, Z, X, Y, Z, X)
"""Axes of the hinges at the initial position, world frame."""


def bricard() -> Scene:
    """Return five bars of 1 kg and 1 m that fall from rest, 10 s, two periods; gravity along -y."""
    names = ["ground", *(f"bar_{k}" for k in range(1, 6)), "ground"]
    bars = [_bar(name, *ends) for name, *ends in zip(names[1:-1], POINTS[:-1], POINTS[1:], strict=True)]
    hinges = [
        Revolute(f"hinge_{k + 1}", names[k], names[k + 1], POINTS[k], axis=axis)
        for k, axis in enumerate(HINGE_AXES)
    ]
    return Scene(
        "bricard",
        Mechanism([Body.ground(), *bars], hinges),
        duration=10.0,
        output_period=0.01,
        gravity=-9.81 * Y,
        description="five bars on six hinges, one redundant constraint everywhere, one degree of freedom",
    )


def _bar(name: str, start: np.ndarray, end: np.ndarray) -> Body:
    """Return a square bar between two points (3,), m. Its frame is parallel to the world."""
    along = np.outer(end - start, end - start) / BAR_LENGTH**2
    axial, across = BAR_MASS * SECTION**2 / 6.0, BAR_MASS * (BAR_LENGTH**2 + SECTION**2) / 12.0
    return Body(name, BAR_MASS, 0.5 * (start + end), axial * along + across * (np.eye(3) - along))


P3 = 0.5 * (POINTS[2] - POINTS[1])
"""Vector (3,) from the center of mass of bar_2 to hinge P3, frame of bar_2, m."""

REFERENCE_QUANTITIES: dict[str, Quantity] = {
    **components(("P3_x", "P3_y", "P3_z"), lambda run: position(run, "bar_2", P3)),
    **components(("P3_vx", "P3_vy", "P3_vz"), lambda run: velocity(run, "bar_2", P3)),
    "q1": lambda run: angle(run, "bar_1", Y),
    "q1_dot": lambda run: angular_velocity(run, "bar_1") @ Y,
}
"""Position (m), velocity (m/s) of P3; angle (rad), angular velocity (rad/s) of the first bar about y."""
