"""Points of the shapes of an MJCF file against the masses that MuJoCo computes for the same shapes."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from mjcf.shape_points import shape_points
from newton_euler.reading.hulls import convex_hull

BODIES = """
<mujoco><asset><mesh name="wedge" scale="0.1 0.1 0.2" vertex="0 0 0  1 0 0  0 1 0  0 0 1"/></asset><worldbody>
{bodies}</worldbody></mujoco>"""
SHAPES = {
    "box": '<geom type="box" size="0.1 0.2 0.3" pos="1 2 3" quat="0.8 0.6 0 0"/>',
    "ball": '<geom size="0.2" pos="0 0.5 0"/>',
    "ellipsoid": '<geom type="ellipsoid" size="0.1 0.2 0.3" euler="20 30 40"/>',
    "capsule": '<geom type="capsule" size="0.05" fromto="0 0 0 0.3 0.4 0"/>',
    "cylinder": '<geom type="cylinder" size="0.1 0.4" pos="0 0 1" euler="90 0 0"/>',
    "mesh": '<geom type="mesh" mesh="wedge" pos="0 0 1" euler="0 90 0"/>',
}
INERTIAL = '<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>'


def test_hulls_have_the_volumes_and_centers_of_the_shapes(tmp_path):
    named = [f'<body name="{name}"><joint/>{INERTIAL}{shape}</body>' for name, shape in SHAPES.items()]
    path = tmp_path / "shapes.xml"
    path.write_text(BODIES.format(bodies="".join(named)))
    found = shape_points(str(path), SHAPES)
    assert found.keys() == SHAPES.keys()
    without = (
        BODIES.format(bodies="".join(named)).replace(INERTIAL, "").replace("<geom ", '<geom density="1" ')
    )
    model = mujoco.MjModel.from_xml_string(without)
    for name, points in found.items():
        hull, body = convex_hull(points), model.body(name)
        assert hull is not None
        # the polyhedra in round shapes are up to 2 % smaller
        assert hull.volume == pytest.approx(body.mass[0], rel=0.02 if name not in ("box", "mesh") else 1e-5)
        np.testing.assert_allclose(hull.center, body.ipos, atol=1e-6)


def test_only_the_named_bodies_need_their_meshes(tmp_path):
    bodies = (
        f'<body name="a">{INERTIAL}<joint/><geom size="0.1"/></body>'
        f'<body name="b">{INERTIAL}<joint/><geom type="mesh" mesh="lost"/><geom size="0.2"/></body>'
    )
    text = BODIES.format(bodies=bodies).replace("<asset>", '<asset><mesh name="lost" file="lost.stl"/>')
    path = tmp_path / "lost.xml"
    path.write_text(text)
    assert shape_points(str(path), ["a"]).keys() == {"a"}
    # the shape that is there counts
    assert np.ptp(shape_points(str(path), ["b"])["b"], axis=0) == pytest.approx([0.4, 0.4, 0.4], rel=0.01)
