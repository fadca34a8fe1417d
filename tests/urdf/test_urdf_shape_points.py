"""Points of the shapes of links of a URDF: visual shapes, or those for collisions if meshes are missing."""

from __future__ import annotations

import numpy as np
import pytest

from newton_euler.reading.hulls import convex_hull
from urdf.shape_points import shape_points

CYLINDER = '<cylinder radius="0.1" length="1"/>'
SPHERE = '<sphere radius="0.3"/>'
MISSING = '<mesh filename="lost.stl"/>'


def shape(tag: str, geometry: str) -> str:
    return f'<{tag}><origin xyz="1 2 3" rpy="1.5707963267948966 0 0"/><geometry>{geometry}</geometry></{tag}>'


@pytest.mark.parametrize(
    ("elements", "half_sizes"),
    [
        # the axis of the cylinder is turned from z to y
        (shape("visual", CYLINDER), [0.1, 0.5, 0.1]),
        (shape("visual", CYLINDER) + shape("collision", SPHERE), [0.1, 0.5, 0.1]),
        (shape("visual", MISSING) + shape("collision", SPHERE), [0.3, 0.3, 0.3]),
        (shape("visual", CYLINDER) + shape("visual", MISSING) + shape("collision", SPHERE), [0.3, 0.3, 0.3]),
        (shape("collision", '<box size="0.2 0.4 0.6"/>'), [0.1, 0.3, 0.2]),
    ],
)
def test_a_shape_in_the_frame_of_its_link(tmp_path, elements, half_sizes):
    path = tmp_path / "robot.urdf"
    path.write_text(f'<robot name="r"><link name="a">{elements}</link></robot>')
    hull = convex_hull(shape_points(str(path), ["a"])["a"])
    assert hull is not None
    # 36 points on a circle: up to 1 - cos(5 deg) = 0.4 % smaller
    np.testing.assert_allclose(hull.high - [1, 2, 3], half_sizes, rtol=0.005)
    np.testing.assert_allclose(hull.low - [1, 2, 3], -np.array(half_sizes), rtol=0.005)


def test_a_link_whose_shapes_cannot_be_read_has_none(tmp_path):
    path = tmp_path / "robot.urdf"
    path.write_text(f'<robot name="r"><link name="a">{shape("visual", MISSING)}</link></robot>')
    assert shape_points(str(path), ["a", "absent"]) == {}
