"""Motions of a mechanism that the constraints leave free at one state, and their mass matrix."""

from __future__ import annotations

from newton_euler.equations.dense import orthonormal_null
from newton_euler.equations.redundancy import constraint_rank
from newton_euler.equations.relative import Relative
from newton_euler.equations.system import dimensionless_jacobian
from newton_euler.scalars import Array


def free_motions(system: Relative, q: Array, v: Array) -> tuple[Array, Array]:
    """Compute a basis of the velocities that the constraints allow, and the mass matrix in this basis.

    Args:
        system: equations of motion in joint coordinates.
        q: (nq,) coordinates.
        v: (nv,) velocities.

    Returns:
        The basis (nv, d), SI units, and the mass matrix (d, d).
    """
    mass, _ = system.mass_and_force(q, v)
    free = orthonormal_null(dimensionless_jacobian(system, q), constraint_rank(system))
    free = system.velocity_units[:, None] * free
    return free, free.T @ mass @ free
