"""Vectors, rotations and linear equations of many states at once.

Arrays have the components on their last axes; all axes before are states. `dynamics.py` uses the functions.
"""

from __future__ import annotations

import numpy as np

from newton_euler.scalars import Array

RANK_TOLERANCE = 1e-5
"""Singular values of the constraint Jacobian below this part of the largest one count as zero. The axes of a
planar linkage written with six digits are parallel to about 1e-6 rad, which does not lock the linkage."""


def rotation_matrix(vector: Array) -> Array:
    """Return the rotation matrices (..., 3, 3) of rotation vectors (..., 3), rad."""
    angle = np.linalg.norm(vector, axis=-1)[..., None, None]
    cross = cross_matrix(vector)
    half = np.sinc(angle / (2 * np.pi))
    return np.eye(3) + np.sinc(angle / np.pi) * cross + 0.5 * half**2 * (cross @ cross)


def rotation_vector(matrix: Array) -> Array:
    """Return the rotation vectors (..., 3), rad, of rotation matrices (..., 3, 3)."""
    # quaternion from the column of the largest of its four squares, which loses no digits at any angle
    m = matrix
    trace = np.einsum("...ii->...", m)
    q = np.empty((*m.shape[:-2], 4, 4))
    q[..., 0, 0] = 1 + trace
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        q[..., i + 1, i + 1] = 1 + 2 * m[..., i, i] - trace
        q[..., 0, i + 1] = q[..., i + 1, 0] = m[..., k, j] - m[..., j, k]
        q[..., i + 1, j + 1] = q[..., j + 1, i + 1] = m[..., i, j] + m[..., j, i]
    best = np.argmax(np.einsum("...ii->...i", q), axis=-1)
    found = np.take_along_axis(q, best[..., None, None], axis=-1)[..., 0]
    found = found / np.linalg.norm(found, axis=-1, keepdims=True)
    found = found * np.where(found[..., :1] < 0, -1.0, 1.0)
    half = np.linalg.norm(found[..., 1:], axis=-1, keepdims=True)
    angle = 2 * np.arctan2(half, found[..., :1])
    return found[..., 1:] * (angle / np.where(half > 0, half, 1.0) + 2.0 * (half == 0))


class Equations:
    """Linear equations of many states, without those that depend on others to within `RANK_TOLERANCE`.

    Attributes:
        kernel: (..., columns, columns) basis of the vectors that the matrix takes to zero, orthonormal, in
            some columns; the other columns are zero.
    """

    def __init__(self, matrix: Array) -> None:
        """Decompose the matrices (..., rows, columns)."""
        left, values, right = np.linalg.svd(matrix)
        count = values.shape[-1]
        used = values > RANK_TOLERANCE * values.max(axis=-1, initial=0.0, keepdims=True)
        self._inverse = np.where(used, 1.0 / np.where(used, values, 1.0), 0.0)
        self._left, self._right = left[..., :count], right[..., :count, :]
        is_kernel = np.ones(right.shape[:-1], bool)
        is_kernel[..., :count] = ~used
        self.kernel = np.swapaxes(right, -1, -2) * is_kernel[..., None, :]

    def solution(self, right: Array) -> Array:
        """Return the least solutions (..., columns) for right sides (..., rows)."""
        parts = self._inverse * np.einsum("...ij,...i->...j", self._left, right)
        return np.asarray(np.einsum("...ji,...j->...i", self._right, parts))


def stacked(values: object) -> Array:
    """Return numbers of several robots with an axis for states."""
    return np.asarray(values, float)[:, None]


def apply(matrix: Array, vector: Array) -> Array:
    """Return the products of matrices (..., n, m) and vectors (..., m)."""
    return np.asarray((matrix @ vector[..., None])[..., 0])


_NEXT, _LAST = [1, 2, 0], [2, 0, 1]
"""Components that follow and precede each component of a vector in cyclic order."""


def cross(a: Array, b: Array) -> Array:
    """Return the cross products of vectors (..., 3)."""
    return np.asarray(a[..., _NEXT] * b[..., _LAST] - a[..., _LAST] * b[..., _NEXT])


def cross_matrix(vector: Array) -> Array:
    """Return the matrices (..., 3, 3) that multiply b to the cross products of vectors (..., 3) and b."""
    matrix = np.zeros((*vector.shape, 3))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        matrix[..., k, j], matrix[..., j, k] = vector[..., i], -vector[..., i]
    return matrix


def cross_motion(twist: Array, motion: Array) -> Array:
    """Return the rate of a motion vector that moves with a twist; Featherstone, equation (2.31)."""
    turning, moving = twist[..., :3], twist[..., 3:]
    linear = cross(turning, motion[..., 3:]) + cross(moving, motion[..., :3])
    return np.concatenate([cross(turning, motion[..., :3]), linear], axis=-1)


def cross_force(twist: Array, force: Array) -> Array:
    """Return the rate of a force vector that moves with a twist; Featherstone, equation (2.32)."""
    turning, moving = twist[..., :3], twist[..., 3:]
    moment = cross(turning, force[..., :3]) + cross(moving, force[..., 3:])
    return np.concatenate([moment, cross(turning, force[..., 3:])], axis=-1)
