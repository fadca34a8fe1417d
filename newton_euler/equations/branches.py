"""Check of an initial state at a singular configuration: are its velocities tangent to a branch of motion?

In a singular configuration, such as a flat four-bar, several motions (branches) cross. The Jacobian J of the
constraint residuals phi loses rank, so that more velocities v satisfy J v = 0 than are tangent to a branch. A
motion exists only if some acceleration a satisfies J a + dJ/dt v = 0. Each combination w of rows with w J = 0
(a vector of coefficients) therefore demands w dJ/dt v = 0. This equation is of second degree in v; its
solutions are the tangents of the branches.

Source: A. Mueller, Local kinematic analysis of closed-loop linkages: mobility, singularities, and shakiness,
Journal of Mechanisms and Robotics 8, 2016.
"""

from __future__ import annotations

import numpy as np

from newton_euler.equations.dense import largest_share, singular_values
from newton_euler.equations.formulation import Formulation
from newton_euler.equations.system import dimensionless_jacobian
from newton_euler.scalars import Array

DEPENDENT_ROW_RATIO = 1e-6
"""Singular value of the dimensionless J below which rows count as dependent, divided by the largest singular
value or 1, whichever is larger."""

MAX_CONTRADICTION = 1e-3
"""Largest |w dJ/dt v| for which velocities v count as tangent to a branch, divided by the squared norm of the
dimensionless velocities.

Tangent velocities that a file gives with four digits reach 1e-4; velocities between two branches reach values
of order 1."""

DIFFERENCE_ANGLE = 1e-4
"""Step of the central difference for dJ/dt, rad, or a length divided by the mechanism's size."""


def joint_between_branches(system: Formulation, q: Array, v: Array) -> str:
    """Find the joint whose constraint is dependent, at a start with velocities tangent to no branch.

    Scenes with prescribed motions are not examined, because their constraints depend on time.

    Args:
        system: equations of motion.
        q: (nq,) initial coordinates, which satisfy the constraints.
        v: (nv,) initial velocities, which satisfy the constraints.

    Returns:
        Name of the joint or coupling; empty if the velocities are tangent to a branch.
    """
    speed = float(np.linalg.norm(v / system.velocity_units))
    if system.scene.motions or speed == 0.0 or not len(system.phi_units):
        return ""
    # left null space of J: combinations w of rows, one in each column of `null`
    left, values, _ = singular_values(dimensionless_jacobian(system, q), full=True)
    values = np.pad(values, (0, len(left) - len(values)))
    null = left[:, values < DEPENDENT_ROW_RATIO * max(values[0], 1.0)]
    # w dJ/dt v, by a central difference along the velocity
    step = DIFFERENCE_ANGLE / speed
    before, after = (system.phi_jacobian(system.retract(q, at * v)) @ v for at in (-step, step))
    contradictions = null.T @ ((after - before) / (2.0 * step) / system.phi_units) / speed**2
    if not np.abs(contradictions).max(initial=0.0) > MAX_CONTRADICTION:
        return ""
    return largest_share(system.row_owners, null @ contradictions)
