"""Meshes for viewers."""

from __future__ import annotations

import numpy as np

from crosscheck.scenes.drawing import SIDES, arrow, disc, tiles
from newton_euler.model.euler_parameters import from_rotation_vector, rotation

AXIS = np.array([0.6, 0.0, 0.8])
CENTER = np.array([1.0, 2.0, 3.0])
COLOR = (0.0, 0.0, 0.0, 1.0)


def test_a_disc_is_closed_and_seen_from_outside():
    mesh = disc(2.0, 0.1, CENTER, AXIS)
    a, b, c = (mesh.vertices[mesh.triangles] - CENTER).transpose(1, 0, 2)
    volume = np.sum(a * np.cross(b, c)) / 6.0
    polygon = 0.5 * SIDES * np.sin(2.0 * np.pi / SIDES) * 2.0**2
    np.testing.assert_allclose(volume, 0.1 * polygon, rtol=1e-12)  # round-off
    np.testing.assert_allclose(np.abs((mesh.vertices - CENTER) @ AXIS), 0.05, rtol=1e-12)


def test_an_arrow_has_its_label_at_the_tip():
    mesh = arrow(CENTER, AXIS, 0.5, COLOR, "up")
    np.testing.assert_allclose(mesh.vertices[0], CENTER + 0.5 * AXIS, rtol=1e-15)
    assert mesh.label == "up"


def test_tiles_leave_lines_between_them():
    turn = rotation(from_rotation_vector(np.array([0.3, -0.2, 0.5])))
    mesh = tiles((3.0, 1.0), (6, 2), CENTER, turn, COLOR)
    points = (mesh.vertices - CENTER) @ turn
    np.testing.assert_allclose(points.max(axis=0), [2.95, 0.95, 0.0], atol=1e-14)
    a, b, c = points[mesh.triangles].transpose(1, 0, 2)
    areas = 0.5 * np.cross(b - a, c - a)[:, 2]
    np.testing.assert_allclose(areas, 0.5 * 0.9**2, rtol=1e-12)
    assert len(areas) == 2 * 6 * 2
