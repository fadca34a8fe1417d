"""Euler parameters p = (e0, e1, e2, e3), scalar first: the paper's equations (1) to (3), (11), (12).

The rotation matrix R(p) takes body-frame components to world-frame components. Functions of the
first half accept generic scalars; those of the second half, which convert and compare, are for
float arrays and work on a whole stack of rotations (leading dimensions) at once.
"""

from __future__ import annotations

from math import sqrt

import numpy as np

from newton_euler.scalars import Array


def matrix_g(p: Array) -> Array:
    """G = [-e, tilde(e) + e0 I], (3, 4): world angular velocity is omega = 2 G pdot."""
    e0, e1, e2, e3 = p.tolist()
    return np.array([[-e1, e0, -e3, e2], [-e2, e3, e0, -e1], [-e3, -e2, e1, e0]])


def matrix_l(p: Array) -> Array:
    """L = [-e, -tilde(e) + e0 I], (3, 4): body angular velocity is omega' = 2 L pdot, eq. (11)."""
    e0, e1, e2, e3 = p.tolist()
    return np.array([[-e1, e0, e3, -e2], [-e2, -e3, e0, e1], [-e3, e2, -e1, e0]])


def rotation(p: Array) -> Array:
    """R = G L^T, (3, 3), eq. (3). For p of norm n it is n^2 times a rotation."""
    return matrix_g(p) @ matrix_l(p).T


def product(p: Array, q: Array) -> Array:
    """Quaternion product: R(product(p, q)) = R(p) R(q)."""
    a, b, c, d = p
    e, f, g, h = q
    return np.array(
        [
            a * e - b * f - c * g - d * h,
            a * f + b * e + c * h - d * g,
            a * g - b * h + c * e + d * f,
            a * h + b * g - c * f + d * e,
        ]
    )


def conjugate(p: Array) -> Array:
    """The inverse rotation of unit Euler parameters, (..., 4)."""
    return p * np.array([1.0, -1.0, -1.0, -1.0])


def from_rotation_vector(vector: Array) -> Array:
    """Euler parameters of a rotation by |vector| radians about it; (3,) floats, any angle."""
    angle = float(np.linalg.norm(vector))
    # sin(x/2)/x, by its series where the quotient loses digits (x^4/3840 < 1e-16 there)
    half_sinc = 0.5 - angle**2 / 48.0 if angle < 1e-3 else np.sin(0.5 * angle) / angle
    return np.concatenate([[np.cos(0.5 * angle)], half_sinc * np.asarray(vector)])


def from_rotation(matrix: Array) -> Array:
    """Euler parameters (4,) with e0 >= 0 of a (3, 3) rotation matrix, at full accuracy at any angle.

    The largest of the four squares is found first, so no small number is divided by (Nikravesh,
    Computer-Aided Analysis of Mechanical Systems, 1988, section 6.2.3).
    """
    m = np.asarray(matrix, dtype=float).tolist()  # Python's floats are quicker than elements of arrays
    trace = m[0][0] + m[1][1] + m[2][2]
    squares = [trace, *(2.0 * m[i][i] - trace for i in range(3))]  # 4 e_k^2 - 1
    k = squares.index(max(squares))
    antisymmetric = [m[2][1] - m[1][2], m[0][2] - m[2][0], m[1][0] - m[0][1]]
    if k == 0:
        p = [1.0 + trace, *antisymmetric]
    else:
        i = k - 1
        p = [antisymmetric[i], *(m[j][i] + m[i][j] for j in range(3))]
        p[k] = 1.0 + squares[k]
    norm = sqrt(sum(x * x for x in p))
    return np.array([x / norm if p[0] >= 0.0 else -x / norm for x in p])


def rotations(quaternions: Array) -> Array:
    """Rotation matrices (..., 3, 3) of unit Euler parameters (..., 4)."""
    e0, e1, e2, e3 = np.moveaxis(quaternions, -1, 0)
    shape = (*quaternions.shape[:-1], 3, 4)
    g = np.stack([-e1, e0, -e3, e2, -e2, e3, e0, -e1, -e3, -e2, e1, e0], axis=-1).reshape(shape)
    columns = np.stack([-e1, e0, e3, -e2, -e2, -e3, e0, e1, -e3, e2, -e1, e0], axis=-1).reshape(shape)
    return g @ np.swapaxes(columns, -1, -2)


def angle_between(p: Array, q: Array) -> Array:
    """Rotation angle (...) in [0, pi] from orientation p to q, (..., 4) each; p and -p are the same.

    From the vector part of the relative rotation, so small angles keep all their digits.
    """
    p, q = np.broadcast_arrays(np.asarray(p, dtype=float), np.asarray(q, dtype=float))
    relative = product(np.moveaxis(conjugate(p), -1, 0), np.moveaxis(q, -1, 0))
    return 2.0 * np.arctan2(np.linalg.norm(relative[1:], axis=0), np.abs(relative[0]))


def continuous(quaternions: Array, first: Array) -> Array:
    """Choose the signs of quaternions (n, ..., 4) so that each is closest to the one before it.

    `first` (..., 4) decides the sign at index 0.
    """
    out = np.array(quaternions, dtype=float)
    dots = np.empty(out.shape[:-1])
    np.einsum("...i,...i", out[:1], np.asarray(first, dtype=float), out=dots[:1])
    np.einsum("...i,...i", out[1:], out[:-1], out=dots[1:])
    if np.any(dots < 0.0):
        out *= np.cumprod(np.where(dots < 0.0, -1.0, 1.0), axis=0)[..., None]
    return out
