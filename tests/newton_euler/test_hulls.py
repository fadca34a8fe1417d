"""Convex hulls against volumes and radii of gyration of homogeneous solids in closed form."""

from __future__ import annotations

import numpy as np
import pytest

from newton_euler.reading.hulls import box_points, capsule_points, convex_hull, ellipsoid_points, rim_points


def test_a_box():
    center = np.array([1.0, 2.0, 3.0])
    hull = convex_hull(center + box_points(np.array([0.1, 0.2, 0.3])))
    assert hull is not None
    assert hull.volume == pytest.approx(0.2 * 0.4 * 0.6, rel=1e-12)
    assert hull.gyration == pytest.approx(np.sqrt((0.2**2 + 0.4**2 + 0.6**2) / 12), rel=1e-12)
    assert hull.center == pytest.approx(center, abs=1e-12)
    assert hull.low == pytest.approx([0.9, 1.8, 2.7])
    assert hull.high == pytest.approx([1.1, 2.2, 3.3])


@pytest.mark.parametrize(
    ("points", "volume", "gyration"),
    [
        (ellipsoid_points(np.full(3, 0.5)), 4 / 3 * np.pi * 0.5**3, np.sqrt(0.6) * 0.5),
        (
            rim_points(np.zeros(3), np.array([0, 2.0, 0]), 0.5),
            2 * np.pi * 0.5**2,
            np.sqrt(0.5**2 / 2 + 4 / 12),
        ),
        (capsule_points(0.5, 1.0), 2 * np.pi * 0.5**2 + 4 / 3 * np.pi * 0.5**3, None),
    ],
    ids=["ball", "cylinder", "capsule"],
)
def test_round_solids(points, volume, gyration):
    hull = convex_hull(points)
    assert hull is not None
    # polygon of 36 points in a circle: 1 - sin(10 deg) / (10 deg) = 0.5 % less area; more in both directions
    assert volume * 0.98 < hull.volume < volume
    if gyration:
        assert hull.gyration == pytest.approx(gyration, rel=0.01)


def test_points_in_one_plane_have_no_hull():
    assert convex_hull(np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]])) is None
