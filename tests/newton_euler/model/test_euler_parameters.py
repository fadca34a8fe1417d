"""Euler parameters against their definitions and against scipy's rotations."""

from __future__ import annotations

import numpy as np
import pytest
from finite_difference import derivative
from scipy.spatial.transform import Rotation

from newton_euler.model.euler_parameters import (
    angle_between,
    continuous,
    from_rotation,
    from_rotation_vector,
    matrix_g,
    matrix_l,
    product,
    rotation,
    rotations,
)
from newton_euler.scalars import cross, tilde

RNG = np.random.default_rng(0)
UNITS = [p / np.linalg.norm(p) for p in RNG.standard_normal((20, 4))]
ROUND_OFF = 1e-15  # a handful of products of numbers below 1


@pytest.mark.parametrize("p", UNITS)
def test_rotation_is_scipys_scalar_first(p):
    expected = Rotation.from_quat(p, scalar_first=True).as_matrix()
    assert np.allclose(rotation(p), expected, rtol=0, atol=ROUND_OFF)


@pytest.mark.parametrize("p", UNITS[:5])
def test_identities_of_g_and_l(p):
    g, ell = matrix_g(p), matrix_l(p)
    for m in (g, ell):
        assert np.allclose(m @ m.T, np.eye(3), atol=ROUND_OFF)
        assert np.allclose(m @ p, 0.0, atol=ROUND_OFF)
    assert np.allclose(g @ ell.T, rotation(p), atol=ROUND_OFF)


@pytest.mark.parametrize("p", UNITS[:5])
def test_angular_velocity_is_that_of_the_rotation_matrix(p):
    pdot = RNG.standard_normal(4)
    pdot -= (p @ pdot) * p

    def path(s):
        q = p + s * pdot
        return rotation(q / np.linalg.norm(q))

    rate = derivative(path)
    # the difference formula's own error, see finite_difference.derivative
    assert np.allclose(rate @ rotation(p).T, tilde(2.0 * matrix_g(p) @ pdot), atol=1e-11)
    assert np.allclose(rotation(p).T @ rate, tilde(2.0 * matrix_l(p) @ pdot), atol=1e-11)


def test_product_composes_rotations():
    p, q = UNITS[:2]
    assert np.allclose(rotation(product(p, q)), rotation(p) @ rotation(q), atol=ROUND_OFF)


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-4, 1.0, np.pi - 1e-9, np.pi, np.pi + 1e-9, 2 * np.pi, 7.0])
@pytest.mark.parametrize("axis", [*np.eye(3), np.array([0.48, -0.6, 0.64])])
def test_conversions_at_any_angle(angle, axis):
    p = from_rotation_vector(angle * axis)
    expected = Rotation.from_rotvec(angle * axis).as_matrix()
    assert np.allclose(rotation(p), expected, atol=ROUND_OFF)
    # from_rotation divides by the largest component, at least 1/2: round-off grows fourfold at most
    assert angle_between(from_rotation(expected), p) < 4 * ROUND_OFF


@pytest.mark.parametrize("angle", [0.0, 1e-12, 1e-8, 0.5, 3.0, np.pi])
def test_angle_between_keeps_small_angles_and_knows_the_double_cover(angle):
    p = UNITS[0]
    q = product(p, from_rotation_vector(angle * np.array([0.0, 0.6, 0.8])))
    for sign in (1.0, -1.0):
        assert angle_between(p, sign * q) == pytest.approx(angle, abs=1e-15, rel=1e-14)


def test_continuous_removes_sign_flips():
    angles = np.linspace(0.0, 12.0, 200)
    smooth = np.array([from_rotation_vector([0.0, 0.0, a]) for a in angles])
    flipped = smooth * np.where(RNG.random(200) < 0.5, -1.0, 1.0)[:, None]
    assert np.array_equal(continuous(flipped, smooth[0]), smooth)


def test_stack_of_rotations():
    stack = np.array(UNITS[:6]).reshape(2, 3, 4)
    assert np.array_equal(rotations(stack)[1, 2], rotation(UNITS[5]))


def test_cross_and_tilde_agree_with_numpy():
    a, b = RNG.standard_normal((2, 3))
    assert np.allclose(cross(a, b), np.cross(a, b), atol=ROUND_OFF)
    assert np.allclose(tilde(a) @ b, np.cross(a, b), atol=ROUND_OFF)
