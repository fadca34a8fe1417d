"""Conversions and products of Euler parameters p = (e0, e1, e2, e3), which are unit quaternions (w, x, y, z).

The rotation matrix R(p) takes body-frame components to world-frame components. Equation numbers are those of
S. Srang, S. Ath and M. Yamakita, Advances in Science, Technology and Engineering Systems Journal 5(5), 2020,
doi:10.25046/aj050587 (equations (1) to (3), (11) and (12) define Euler parameters).

The functions up to `product` accept arrays of generic scalars: floats or expressions of the code generator
(`newton_euler.scalars`). The functions after `product` convert and compare, for floats only. Where their
docstrings have leading dimensions "...", they work on many rotations at once.
"""

from __future__ import annotations

from math import sqrt

import numpy as np

from newton_euler.scalars import Array


def matrix_g(p: Array) -> Array:
    """Return G = [-e, tilde(e) + e0 I], (3, 4), of p (4,): world-frame angular velocity is omega = 2 G dp/dt.

    e is (e1, e2, e3), and tilde(e) the matrix of the cross product with e.
    """
    e0, e1, e2, e3 = p.tolist()
    return np.array([[-e1, e0, -e3, e2], [-e2, e3, e0, -e1], [-e3, -e2, e1, e0]])


def matrix_l(p: Array) -> Array:
    """Return L = [-e, -tilde(e) + e0 I], (3, 4), of p (4,), with e and tilde as for `matrix_g`.

    Body-frame angular velocity is omega' = 2 L dp/dt, eq. (11).
    """
    e0, e1, e2, e3 = p.tolist()
    return np.array([[-e1, e0, e3, -e2], [-e2, -e3, e0, e1], [-e3, e2, -e1, e0]])


def rotation(p: Array) -> Array:
    """Return the rotation matrix R = G L^T, (3, 3), of p (4,), eq. (3); |p|^2 times that if p is no unit
    vector."""
    return matrix_g(p) @ matrix_l(p).T


def product(p: Array, q: Array) -> Array:
    """Return the quaternion product (4,) of p and q, (4,) each: R(product(p, q)) = R(p) R(q)."""
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
    """Return the conjugate (..., 4), which is the inverse rotation of unit Euler parameters p (..., 4)."""
    return p * np.array([1.0, -1.0, -1.0, -1.0])


def from_rotation_vector(vector: Array) -> Array:
    """Return the Euler parameters (4,) of a rotation by |vector| radians about the direction of `vector`
    (3,)."""
    angle = float(np.linalg.norm(vector))
    # sin(x/2)/x; for small x by its series, whose first omitted term x^4/3840 is below 1e-15
    half_sinc = 0.5 - angle**2 / 48.0 if angle < 1e-3 else np.sin(0.5 * angle) / angle
    return np.concatenate([[np.cos(0.5 * angle)], half_sinc * np.asarray(vector)])


def from_rotation(matrix: Array) -> Array:
    """Return the Euler parameters (4,) with e0 >= 0 of a rotation matrix (3, 3), accurate at any angle.

    The component with the largest square is computed first, and the others are divided by it, so that the
    divisor is never small. Source: Nikravesh, Computer-Aided Analysis of Mechanical Systems, 1988, section
    6.2.3.
    """
    m = np.asarray(matrix, dtype=float).tolist()  # Python's floats are faster than array elements
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
    """Return the rotation matrices (..., 3, 3) of unit Euler parameters (..., 4), R = G L^T, eq. (3)."""
    e0, e1, e2, e3 = np.moveaxis(quaternions, -1, 0)
    shape = (*quaternions.shape[:-1], 3, 4)
    g = np.stack([-e1, e0, -e3, e2, -e2, e3, e0, -e1, -e3, -e2, e1, e0], axis=-1).reshape(shape)
    ell = np.stack([-e1, e0, e3, -e2, -e2, -e3, e0, e1, -e3, e2, -e1, e0], axis=-1).reshape(shape)
    return g @ np.swapaxes(ell, -1, -2)


def angle_between(p: Array, q: Array) -> Array:
    """Return the angle (...), rad, in [0, pi] of the rotation from orientation p to q, (..., 4) each.

    p and -p are the same orientation. The angle is computed from the vector part of the relative quaternion,
    so that small angles keep all digits.
    """
    p, q = np.broadcast_arrays(np.asarray(p, dtype=float), np.asarray(q, dtype=float))
    relative = product(np.moveaxis(conjugate(p), -1, 0), np.moveaxis(q, -1, 0))
    return 2.0 * np.arctan2(np.linalg.norm(relative[1:], axis=0), np.abs(relative[0]))


def continuous(quaternions: Array, first: Array) -> Array:
    """Choose the signs of quaternions (n, ..., 4) at n consecutive times so that they change continuously.

    The quaternions q and -q are the same orientation. Each gets the sign that is closer to the quaternion
    before it.

    Args:
        quaternions: (n, ..., 4).
        first: (..., 4) quaternion before the first one, which decides the first sign.
    """
    out = np.array(quaternions, dtype=float)
    dots = np.empty(out.shape[:-1])
    np.einsum("...i,...i", out[:1], np.asarray(first, dtype=float), out=dots[:1])
    np.einsum("...i,...i", out[1:], out[:-1], out=dots[1:])
    if np.any(dots < 0.0):
        out *= np.cumprod(np.where(dots < 0.0, -1.0, 1.0), axis=0)[..., None]
    return out
