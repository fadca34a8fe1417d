"""Starts in singular configurations: velocities that belong to no branch of the motion.

In a singular configuration the constraint Jacobian J loses rank, so that more velocities meet J v = 0 than
any motion has. A motion exists only if some acceleration a meets J a + dJ/dt v = 0. Each combination w of
rows with w J = 0 demands w dJ/dt v = 0, an equation of second degree in v whose solutions are the branches.

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
"""Singular value, divided by the largest one, below which constraint rows are dependent."""

MAX_CONTRADICTION = 1e-3
"""Largest w dJ/dt v, by the square of the dimensionless velocities, of a start on a branch. Velocities that a
file gives with four digits reach 1e-4; velocities between two branches are of the order of 1."""

DIFFERENCE_ANGLE = 1e-4
"""Step of the difference quotient for dJ/dt to each side, rad or sizes of the mechanism."""


def joint_between_branches(system: Formulation, q: Array, v: Array) -> str:
    """Find the joint that loses rank at a start whose velocities no motion has; empty if a motion has them.

    Scenes with prescribed motions are not examined: their constraints depend on time.

    Args:
        q, v: coordinates and velocities (nv,) of the start, which meet the constraints.
    """
    # left null space of J
    speed = float(np.linalg.norm(v / system.velocity_units))
    if system.scene.motions or speed == 0.0 or not len(system.phi_units):
        return ""
    rows, values, _ = singular_values(dimensionless_jacobian(system, q), full=True)
    values = np.pad(values, (0, len(rows) - len(values)))
    dependent = rows[:, values < DEPENDENT_ROW_RATIO * max(values[0], 1.0)]
    # w dJ/dt v, by a central difference along the velocity
    step = DIFFERENCE_ANGLE / speed
    before, after = (system.phi_jacobian(system.retract(q, at * v)) @ v for at in (-step, step))
    needed = dependent.T @ ((after - before) / (2.0 * step) / system.phi_units) / speed**2
    if not np.abs(needed).max(initial=0.0) > MAX_CONTRADICTION:
        return ""
    return largest_share(system.row_owners, dependent @ needed)
