"""Dense linear algebra of constrained dynamics, for floats."""

from __future__ import annotations

import numpy as np

from newton_euler.scalars import Array

RANK_TOLERANCE = 1e-9
"""Singular values below this fraction of the largest count as zero."""


def rank(matrix: Array) -> int:
    """Numerical rank, by singular values against `RANK_TOLERANCE`."""
    values = np.linalg.svd(matrix, compute_uv=False)
    return int(np.sum(values > RANK_TOLERANCE * np.max(values, initial=0.0)))


def minimum_norm(matrix: Array, right: Array) -> Array:
    """The smallest x that solves matrix @ x = right in the least-squares sense."""
    if not matrix.size:
        return np.zeros(matrix.shape[1])
    return np.asarray(np.linalg.lstsq(matrix, right, rcond=RANK_TOLERANCE)[0])


def solve_constrained(mass: Array, force: Array, jacobian: Array, gamma: Array) -> tuple[Array, Array]:
    """Acceleration a (n,) and multipliers (k,) of M a = f + J^T lambda, J a = gamma.

    With L the Cholesky factor of M and X = L^-1 J^T, lambda solves X^T X lambda = gamma - X^T L^-1 f.
    Working on X instead of X^T X keeps the digits that squaring would cost, and the singular value
    decomposition gives the smallest lambda where constraints are redundant.
    """
    lower = np.linalg.cholesky(mass)
    columns = np.linalg.solve(lower, np.column_stack([force, jacobian.T]))
    free, x = columns[:, 0], columns[:, 1:]
    if not x.size:
        return np.linalg.solve(lower.T, free), np.zeros(len(gamma))
    u, s, vt = np.linalg.svd(x, full_matrices=False)
    keep = s > RANK_TOLERANCE * s[0]
    u, s, vt = u[:, keep], s[keep], vt[keep]
    # X lambda = y, where y is the part of the constrained acceleration in the range of X
    y = (vt @ gamma) / s - u.T @ free
    multipliers = vt.T @ (y / s)
    return np.linalg.solve(lower.T, free + u @ y), multipliers


def orthonormal_range(matrix: Array) -> Array:
    """Orthonormal columns that span the range of a matrix."""
    u, s, _ = np.linalg.svd(matrix, full_matrices=False)
    return np.asarray(u[:, s > RANK_TOLERANCE * np.max(s, initial=0.0)])


def orthonormal_null(matrix: Array) -> Array:
    """Orthonormal columns that span the null space of a matrix."""
    if not matrix.size:
        return np.eye(matrix.shape[1])
    _, s, vt = np.linalg.svd(matrix, full_matrices=True)
    return np.asarray(vt[int(np.sum(s > RANK_TOLERANCE * np.max(s, initial=0.0))) :].T)
