"""Dense linear algebra over floats: ranks, least-squares solutions and solvers of the equations of motion.

Ranks are decided on matrices without units of length and mass, called dimensionless here; seconds remain. A
row or an unknown in meters is divided by the mechanism's size, m; a row or an unknown in radians is not
divided. Entries of a constraint Jacobian are then of order 1, whatever the size of the mechanism, and
round-off is clearly smaller.

Callers replace rows that are almost redundant by zeros: rows that would follow from others if the axes and
points of the model were exact (`newton_euler.equations.redundancy`). Exactly redundant rows remain, and the
functions below find them. If loops are closed, the rank is then clear and drops in singular configurations
only.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from newton_euler.scalars import Array

CLEAR_RANK = 1e-4
"""Ratio to the largest singular value of L^-1 J^T above which a singular value is certainly not round-off.

J is the constraint Jacobian and L the Cholesky factor of the mass matrix."""

RANK_TOLERANCE = 1e-9
"""Singular value of a dimensionless matrix below which the value counts as zero.

If the largest singular value exceeds 1, the limit is multiplied by this largest value."""


def largest(residuals: Array) -> float:
    """Return the largest absolute value in an array of residuals, 0 for an empty array."""
    return float(np.max(np.abs(residuals), initial=0.0))


def singular_values(matrix: Array, full: bool = False) -> tuple[Array, Array, Array]:
    """Compute the singular value decomposition U, s, V^T of a matrix.

    Args:
        matrix: (k, n).
        full: True for square matrices U (k, k) and V^T (n, n), False for the reduced ones.

    Raises:
        numpy.linalg.LinAlgError: for a matrix that is not finite, for which LAPACK might not return.
    """
    if not np.isfinite(matrix).all():
        raise np.linalg.LinAlgError("a matrix is not finite")
    u, s, vt = np.linalg.svd(matrix, full_matrices=full)
    return u, s, vt


def numerical_rank(values: Array) -> int:
    """Count the singular values of a dimensionless matrix that are larger than round-off."""
    return int(np.sum(values > RANK_TOLERANCE * max(1.0, np.max(values, initial=0.0))))


def largest_share(owners: Sequence[str], combination: Array) -> str:
    """Find the owner, such as a joint, of the rows with the largest coefficients in a combination of rows.

    Owners are compared by the sum of squares of the coefficients of their rows.

    Args:
        owners: (k,) name of the owner of each row.
        combination: (k,) coefficients.
    """
    weights: dict[str, float] = {}
    for owner, share in zip(owners, combination**2, strict=True):
        weights[owner] = weights.get(owner, 0.0) + share
    return max(weights, key=lambda owner: weights[owner])


def rank(matrix: Array) -> int:
    """Compute the numerical rank of a dimensionless matrix."""
    return numerical_rank(singular_values(matrix)[1]) if matrix.size else 0


def minimum_norm(
    matrix: Array, right: Array, row_units: Array, column_units: Array, max_rank: int | None = None
) -> Array:
    """Compute the minimum-norm least-squares solution x (n,) of matrix @ x = right.

    Residuals and norm are measured in dimensionless form.

    Args:
        matrix: (k, n).
        right: (k,).
        row_units: (k,) divisors that make the rows dimensionless, such as the mechanism's size or 1.
        column_units: (n,) divisors that make `x` dimensionless.
        max_rank: largest rank; None for no limit.
    """
    if not matrix.size:
        return np.zeros(matrix.shape[1])
    u, s, vt = singular_values(matrix * column_units / row_units[:, None])
    r = min(numerical_rank(s), len(s) if max_rank is None else max_rank)
    return np.asarray(column_units * (vt[:r].T @ ((u[:, :r].T @ (right / row_units)) / s[:r])))


def independent_rows(
    jacobian: Array, row_units: Array, column_units: Array, max_rank: int | None = None
) -> Array:
    """Compute independent combinations C (k, r) of the rows of a Jacobian J that span all of its rows.

    Constraints J a = gamma become C^T J a = C^T gamma. Their multipliers mu give the multipliers
    lambda = C mu of J. If redundant rows make lambda non-unique, this is the solution of minimum norm in
    dimensionless form.

    Args:
        jacobian: (k, n) matrix J.
        row_units: (k,) divisors: the mechanism's size, m, for rows in meters, 1 for rows in radians.
        column_units: (n,) divisors of the accelerations `a`: the mechanism's size, m, for m/s^2, 1 for
            rad/s^2.
        max_rank: largest r; None for no limit. A limit is needed at states whose loops are not quite closed,
            as in difference quotients and Newton iterations: there redundant rows seem independent.
    """
    u, s, _ = singular_values(jacobian * column_units / row_units[:, None])
    return np.asarray(u[:, : numerical_rank(s)][:, :max_rank] / row_units[:, None])


def solve_constrained(
    mass: Array,
    force: Array,
    jacobian: Array,
    gamma: Array,
    row_units: Array,
    column_units: Array,
    max_rank: int | None = None,
) -> tuple[Array, Array]:
    """Solve the equations of motion M a = f + J^T lambda, J a = gamma for a (n,) and lambda (k,).

    With the Cholesky factor L of M and the singular value decomposition U S V^T = L^-1 J^T of the
    dimensionless independent rows,

        L^T a = L^-1 f + U (S^-1 V^T gamma - U^T L^-1 f).

    This form does not square J, and so keeps more digits than the Schur complement J M^-1 J^T.

    Args:
        mass: (n, n) mass matrix M.
        force: (n,) force f.
        jacobian: (k, n) constraint Jacobian J.
        gamma: (k,) right side of the constraints.
        row_units, column_units, max_rank: see `independent_rows`.

    Raises:
        numpy.linalg.LinAlgError: for an M that is not positive definite, and for numbers that are not finite.
    """
    if not (np.isfinite(force).all() and np.isfinite(gamma).all()):
        raise np.linalg.LinAlgError("a force is not finite")
    lower = np.linalg.cholesky(mass)
    if not jacobian.size:
        return np.linalg.solve(lower.T, np.linalg.solve(lower, force)), np.zeros(len(gamma))
    # columns multiplied by L^-1: the force f, and J^T for dimensionless rows of J
    columns = np.linalg.solve(lower, np.column_stack([force, jacobian.T / row_units]))
    reduced_force, reduced_jacobian_t = columns[:, 0], columns[:, 1:]
    # r: number of independent rows. If the singular values do not show the expected r clearly, the rank of J
    # alone decides, because very different masses scatter the singular values of L^-1 J^T
    u, s, vt = singular_values(reduced_jacobian_t)
    r = len(gamma) if max_rank is None else min(len(gamma), max_rank)
    is_full = 0 < r <= len(s) and s[r - 1] > CLEAR_RANK * s[0]
    if not is_full or np.any(s[r:] > RANK_TOLERANCE * s[0]):
        combine = row_units[:, None] * independent_rows(jacobian, row_units, column_units, max_rank)
        u, s, vt = singular_values(reduced_jacobian_t @ combine)
        r, vt = len(s), vt @ combine.T
    # accelerations and multipliers, from the constraint forces in the basis U
    u, s, vt = u[:, :r], s[:r], vt[:r]
    constraint_force = vt @ (gamma / row_units) / s - u.T @ reduced_force
    acceleration = np.linalg.solve(lower.T, reduced_force + u @ constraint_force)
    return acceleration, vt.T @ (constraint_force / s) / row_units


def solve_augmented(
    matrix: Array,
    right: Array,
    row_units: Array,
    column_units: Array,
    force_units: Array,
    max_rank: int | None = None,
) -> tuple[Array, Array]:
    """Solve the block system [[A, B^T], [J, 0]] (a, -lambda) = right for a (n,) and lambda (k,).

    Equation (21) of `newton_euler.equations.cartesian` has this form. The unknowns `a` are the second
    derivatives of position and quaternion, 7 of each body. The rows of A are force (3) and torque (3) of each
    body, then a row of each body that keeps the norm of the quaternion at 1. J has derivatives by positions
    and quaternions. B has derivatives by positions and rotations: B^T lambda gives forces and torques on the
    bodies, and is zero in the rows of the norms. The rows of J are combined into independent ones first, and
    all rows and unknowns are made dimensionless.

    Args:
        matrix: (n + k, n + k) block matrix.
        right: (n + k,) right side.
        row_units, column_units: as in `independent_rows`.
        force_units: (n,) divisors of the rows of A: mass times size for forces, mass times size^2 for
            torques, 1 for norms; mass and size are those of the mechanism.
        max_rank: see `independent_rows`.

    Raises:
        numpy.linalg.LinAlgError: for a singular matrix, and for a Jacobian that is not finite.
    """
    # dimensionless system [[A, B^T C], [C^T J, 0]] with the combinations C of rows
    n = len(column_units)
    jacobian = matrix[n:, :n]
    combine = independent_rows(jacobian, row_units, column_units, max_rank)
    left = np.zeros((n + combine.shape[1],) * 2)
    left[:n, :n] = matrix[:n, :n] * column_units / force_units[:, None]
    left[n:, :n] = combine.T @ jacobian * column_units
    multiplier_columns = matrix[:n, n:] @ combine / force_units[:, None]
    # each column is divided by its largest element; 1e-300 avoids a division by zero
    scales = np.max(np.abs(multiplier_columns), axis=0, initial=1e-300)
    left[:n, n:] = multiplier_columns / scales
    unknowns = np.linalg.solve(left, np.concatenate([right[:n] / force_units, combine.T @ right[n:]]))
    return column_units * unknowns[:n], -(combine @ (unknowns[n:] / scales))


def orthonormal_range(matrix: Array) -> Array:
    """Compute orthonormal columns that span the range of a dimensionless matrix."""
    u, s, _ = singular_values(matrix)
    return np.asarray(u[:, : numerical_rank(s)])


def orthonormal_null(matrix: Array, rank: int | None = None) -> Array:
    """Compute orthonormal columns that span the null space of a dimensionless matrix.

    Args:
        matrix: (k, n).
        rank: rank of the matrix; None for the numerical rank.
    """
    if not matrix.size:
        return np.eye(matrix.shape[1])
    _, s, vt = singular_values(matrix, full=True)
    return np.asarray(vt[numerical_rank(s) if rank is None else rank :].T)


def least_squares(matrix: Array, right: Array, rank_tolerance: float | None = None) -> Array:
    """Compute the minimum-norm least-squares solution of matrix @ x = right.

    Args:
        matrix: (k, n).
        right: (k,).
        rank_tolerance: ratio to the largest singular value below which a singular value counts as zero;
            None for round-off.

    Raises:
        numpy.linalg.LinAlgError: for numbers that are not finite, for which LAPACK might not return.
    """
    if not (np.isfinite(matrix).all() and np.isfinite(right).all()):
        raise np.linalg.LinAlgError("a matrix is not finite")
    return np.asarray(np.linalg.lstsq(matrix, right, rcond=rank_tolerance)[0])
