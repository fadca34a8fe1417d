"""Solutions of the equations of motion of other engines, from their mass matrices, forces and Jacobians.

Constraints are rigid. All engines that give such matrices (`newton_euler.equations.system.System`) use the
functions of this module: accelerations and Lagrange multipliers, and the inverse dynamics of control laws.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from newton_euler.equations.dense import solve_constrained
from newton_euler.equations.redundancy import constraint_rank, rows_left_out, with_zero_rows
from newton_euler.equations.system import System
from newton_euler.errors import SingularityError
from newton_euler.model.joint import Key
from newton_euler.model.spanning_tree import SpanningTree
from newton_euler.scalars import Array


class Redundancy(NamedTuple):
    """Redundancy of the constraint rows of an engine, which is the same in all states of a scene.

    Attributes:
        left_out: numbers of the rows that are almost redundant, and that zeros replace.
        rank: number of independent rows; the other rows may be exactly dependent.
    """

    left_out: list[int]
    rank: int

    @classmethod
    def of(cls, system: System) -> Redundancy:
        """Find the redundancy of a system by newton_euler's mobility analysis of its scene."""
        return cls(rows_left_out(system), constraint_rank(system))


def solve_rigidly(
    system: System,
    redundancy: Redundancy,
    mass_and_force: tuple[Array, Array],
    jacobian_and_gamma: tuple[Array, Array],
) -> tuple[Array, Array]:
    """Solve M dv/dt = f + J^T lambda, J dv/dt = gamma for dv/dt (nv,) and multipliers lambda (k,).

    Args:
        system: the engine's equations of motion.
        redundancy: redundancy of the rows of J.
        mass_and_force: M (nv, nv) and f (nv,).
        jacobian_and_gamma: J (k, nv) and gamma (k,).

    Raises:
        SingularityError: without a joint, for M that is not positive definite or numbers that are not finite.
    """
    jacobian, gamma = (with_zero_rows(each, redundancy.left_out) for each in jacobian_and_gamma)
    units = system.phi_units, system.velocity_units
    try:
        found = solve_constrained(*mass_and_force, jacobian, gamma, *units, redundancy.rank)
    except np.linalg.LinAlgError as error:
        raise SingularityError(None, f"{system.name}: {error}") from error
    if not np.isfinite(found[0]).all():
        raise SingularityError(None, f"{system.name}: accelerations are not finite")
    return found


def tree_rows(tree: SpanningTree, keys: Sequence[Key]) -> Array:
    """Return the derivatives (n, nv) of the rates of n joint coordinates by the velocities of a tree.

    Args:
        tree: the spanning tree.
        keys: keys of the joint coordinates; none belongs to a joint that closes a loop.
    """
    rows = np.zeros((len(keys), tree.nv))
    places = [tree.place(*key) for key in keys]  # (index in q, index in v) of each coordinate
    rows[np.arange(len(keys)), [place[1] for place in places if place]] = 1.0
    return rows


def servo_forces(
    system: System,
    mass_and_force: tuple[Array, Array],
    jacobian_and_gamma: tuple[Array, Array],
    keys: Sequence[Key],
    rows_and_accelerations: tuple[Array, Array],
) -> Array:
    """Compute the forces on n joint coordinates for given accelerations of them, from an engine's matrices.

    The accelerations are prescribed by additional constraints, whose Lagrange multipliers are the forces, N
    or N m.

    Args:
        system: the engine's equations of motion.
        mass_and_force: M (nv, nv) and f (nv,) of M dv/dt = f + J^T lambda.
        jacobian_and_gamma: J (k, nv) and gamma (k,) of J dv/dt = gamma.
        keys: keys of the joint coordinates.
        rows_and_accelerations: derivatives (n, nv) of the rates of the coordinates by v, and accelerations
            (n,), m/s^2 or rad/s^2, without terms that do not depend on dv/dt.

    Raises:
        SingularityError: in a state in which the coordinates do not determine the motion; without a joint,
            for numbers that are not finite.
    """
    units = [system.mechanism.size if system.mechanism.is_slide(*key) else 1.0 for key in keys]
    # rows that are almost redundant are replaced by zeros
    left_out = rows_left_out(system)
    jacobian, gamma = (
        np.concatenate([with_zero_rows(given, left_out), added])
        for given, added in zip(jacobian_and_gamma, rows_and_accelerations, strict=True)
    )
    row_units = np.concatenate([system.phi_units, units])
    try:
        _, multipliers = solve_constrained(*mass_and_force, jacobian, gamma, row_units, system.velocity_units)
    except np.linalg.LinAlgError as error:
        if not all(np.isfinite(each).all() for each in (*mass_and_force, *jacobian_and_gamma)):
            raise SingularityError(None, f"{system.name}: {error}") from error
        raise SingularityError(keys[0][0], "control laws cannot choose the accelerations there") from error
    return np.asarray(multipliers[len(system.phi_units) :])
