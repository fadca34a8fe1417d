"""Dense linear algebra and dense solvers of the equations of motion, for floats.

Ranks are decided on dimensionless matrices: rows in meters are divided by the mechanism's size and so
are velocities in m/s. Entries of a constraint Jacobian are then of order 1 whatever the size of the
mechanism, and a row of round-off is told from a constraint. Rows that are redundant but for noise are left
out before, see `newton_euler.equations.redundancy`; what is left is of full rank but in singular
configurations.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from newton_euler.scalars import Array

CLEAR_RANK = 1e-4  # share of the largest singular value, masses included, above which none is round-off
RANK_TOLERANCE = 1e-9  # singular values below this, or this share of the largest, count as zero


def largest(residuals: Array) -> float:
    """Find the largest magnitude of a set of residuals, 0 for none."""
    return float(np.max(np.abs(residuals), initial=0.0))


def singular_values(matrix: Array, full: bool = False) -> tuple[Array, Array, Array]:
    """Compute U, s and V^T of a matrix, reduced or `full`.

    Raises `numpy.linalg.LinAlgError` for a matrix that is not finite: LAPACK would not return, or print.
    """
    if not np.isfinite(matrix).all():
        raise np.linalg.LinAlgError("a matrix is not finite")
    u, s, vt = np.linalg.svd(matrix, full_matrices=full)
    return u, s, vt


def numerical_rank(singular_values: Array) -> int:
    """Count the singular values of a dimensionless matrix that are not round-off."""
    return int(np.sum(singular_values > RANK_TOLERANCE * max(1.0, np.max(singular_values, initial=0.0))))


def largest_share(owners: Sequence[str], combination: Array) -> str:
    """Find the owner with the largest share in a combination (k,) of rows."""
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
    """Compute the x (n,) of least dimensionless length with matrix @ x = right in the least-squares sense.

    Args:
        matrix: (k, n); right: (k,).
        row_units, column_units: (k,) and (n,) units of the rows and of x.
        max_rank: as in `independent_rows`.
    """
    if not matrix.size:
        return np.zeros(matrix.shape[1])
    u, s, vt = singular_values(matrix * column_units / row_units[:, None])
    r = min(numerical_rank(s), len(s) if max_rank is None else max_rank)
    return np.asarray(column_units * (vt[:r].T @ ((u[:, :r].T @ (right / row_units)) / s[:r])))


def independent_rows(
    jacobian: Array, row_units: Array, column_units: Array, max_rank: int | None = None
) -> Array:
    """Compute combinations (k, r) of the rows of a Jacobian that imply all of them.

    With them as C, constraints J a = gamma become C^T J a = C^T gamma, and multipliers mu of those are
    lambda = C mu: of all equivalent multipliers the smallest, in dimensionless terms.

    At most `max_rank` combinations are kept. Redundant closures that are open by 1e-8, as at the states
    that a difference quotient or a Newton iteration looks at, have a larger rank than closed ones.
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
    """Solve M a = f + J^T lambda, J a = gamma for a (n,) and lambda (k,).

    L is the Cholesky factor of M, and U S V^T = L^-1 J^T for dimensionless rows J without the parts that are
    redundant. L^T a = L^-1 f + U (S^-1 V^T gamma - U^T L^-1 f); not squaring J keeps its digits.
    Units are as in `minimum_norm`, `max_rank` is as in `independent_rows`.

    Raises:
        numpy.linalg.LinAlgError: for an indefinite M, and for numbers that are not finite.
    """
    if not (np.isfinite(force).all() and np.isfinite(gamma).all()):
        raise np.linalg.LinAlgError("a force is not finite")
    lower = np.linalg.cholesky(mass)
    if not jacobian.size:
        return np.linalg.solve(lower.T, np.linalg.solve(lower, force)), np.zeros(len(gamma))
    columns = np.linalg.solve(lower, np.column_stack([force, jacobian.T / row_units]))
    free, responses = columns[:, 0], columns[:, 1:]
    u, s, vt = singular_values(responses)
    rank = len(gamma) if max_rank is None else min(len(gamma), max_rank)
    clear = 0 < rank <= len(s) and s[rank - 1] > CLEAR_RANK * s[0]
    if not clear or np.any(s[rank:] > RANK_TOLERANCE * s[0]):  # the Jacobian alone decides the rank
        combine = row_units[:, None] * independent_rows(jacobian, row_units, column_units, max_rank)
        u, s, vt = singular_values(responses @ combine)
        rank, vt = len(s), vt @ combine.T
    u, s, vt = u[:, :rank], s[:rank], vt[:rank]
    push = vt @ (gamma / row_units) / s - u.T @ free
    return np.linalg.solve(lower.T, free + u @ push), vt.T @ (push / s) / row_units


def solve_augmented(
    matrix: Array,
    right: Array,
    row_units: Array,
    column_units: Array,
    force_units: Array,
    max_rank: int | None = None,
) -> tuple[Array, Array]:
    """Solve [[A, B^T], [J, 0]] (a, -lambda) = right for a (n,) and lambda (k,), as equation (21) is written.

    Redundant rows of J are combined into independent ones first, and all is made dimensionless.

    Args:
        matrix, right: (n + k, n + k) and (n + k,).
        row_units, column_units, force_units: (k,), (n,) and (n,), of rows of J, of a and of rows of A.
        max_rank: as in `independent_rows`.

    Raises:
        numpy.linalg.LinAlgError: for a singular matrix, and for a Jacobian that is not finite.
    """
    n = len(column_units)
    jacobian = matrix[n:, :n]
    combine = independent_rows(jacobian, row_units, column_units, max_rank)
    left = np.zeros((n + combine.shape[1],) * 2)
    left[:n, :n] = matrix[:n, :n] * column_units / force_units[:, None]
    left[n:, :n] = combine.T @ jacobian * column_units
    push = matrix[:n, n:] @ combine / force_units[:, None]
    share = np.max(np.abs(push), axis=0, initial=1e-300)  # multipliers in units of their own
    left[:n, n:] = push / share
    unknowns = np.linalg.solve(left, np.concatenate([right[:n] / force_units, combine.T @ right[n:]]))
    return column_units * unknowns[:n], -(combine @ (unknowns[n:] / share))


def orthonormal_range(matrix: Array) -> Array:
    """Compute orthonormal columns that span the range of a dimensionless matrix."""
    u, s, _ = singular_values(matrix)
    return np.asarray(u[:, : numerical_rank(s)])


def orthonormal_null(matrix: Array, rank: int | None = None) -> Array:
    """Compute orthonormal columns that span the null space of a dimensionless matrix of a given rank."""
    if not matrix.size:
        return np.eye(matrix.shape[1])
    _, s, vt = singular_values(matrix, full=True)
    return np.asarray(vt[numerical_rank(s) if rank is None else rank :].T)


def least_squares(matrix: Array, right: Array, rank_tolerance: float | None = None) -> Array:
    """Compute the shortest of the least-squares solutions.

    Raises `numpy.linalg.LinAlgError` for numbers that are not finite: LAPACK might not return.
    """
    if not (np.isfinite(matrix).all() and np.isfinite(right).all()):
        raise np.linalg.LinAlgError("a matrix is not finite")
    return np.asarray(np.linalg.lstsq(matrix, right, rcond=rank_tolerance)[0])
