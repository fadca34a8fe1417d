"""Placements of frames, and descriptions of robots."""

from __future__ import annotations

import numpy as np

from newton_euler.model.euler_parameters import from_rotation_vector, rotation
from newton_euler.reading.robot import FileBody, Placement, Robot

TURNED = Placement(np.array([1.0, 2.0, 3.0]), rotation(from_rotation_vector(np.array([0.3, -0.4, 1.2]))))


def test_a_placement_and_its_inverse_cancel():
    around = TURNED @ TURNED.inverse()
    assert np.allclose(around.position, 0.0, atol=1e-15)
    assert np.allclose(around.rotation, np.eye(3), atol=1e-15)


def test_bodies_are_placed_one_in_the_other():
    lift = Placement(np.array([0.0, 0.0, 0.5]), np.eye(3))
    quarter = Placement(
        np.array([1.0, 0.0, 0.0]), np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    )
    bodies = tuple(
        FileBody(name, parent, placement, (), 1.0, np.zeros(3), np.eye(3))
        for name, parent, placement in (("base", -1, lift), ("arm", 0, quarter), ("tip", 1, quarter))
    )
    tip = Robot("two_arms", bodies).placements()[2]
    # the second arm points along y of the world
    assert np.allclose(tip.position, [1.0, 1.0, 0.5])
    assert np.allclose(tip.rotation, np.diag([-1.0, -1.0, 1.0]))
