"""Meshes of a user's model: read from MJCF and URDF, and drawn where the model has them."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command_line import run
from recordings import lid_runs, lid_scene, read_recording, write_recording

import mjcf
import urdf
from crosscheck.recording.shapes import GHOST_OPACITY
from newton_euler.errors import MechanismError
from newton_euler.model.euler_parameters import rotation
from newton_euler.model.geometry import Box, Capsule, Cylinder, Mesh
from newton_euler.model.mechanism import Mechanism
from urdf.reading.visuals import packages

CORNERS = np.array([[0.0, 0.0, 0.0], [0.3, 0.0, 0.0], [0.0, 0.1, 0.0], [0.0, 0.0, 0.2]])
FACES = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
"""A tetrahedron, its faces seen from outside."""

Z = np.array([0.0, 0.0, 1.0])

OBJ = "".join(f"v {x} {y} {z}\n" for x, y, z in CORNERS) + "".join(
    f"f {a + 1} {b + 1} {c + 1}\n" for a, b, c in FACES
)

MJCF = """<mujoco><compiler meshdir="meshes"/>
<asset><mesh name="t" file="t.obj"/><material name="green" rgba="0 1 0 1"/></asset>
<worldbody>
  <geom type="mesh" mesh="t" material="green" pos="0 0 -1"/>
  <body name="arm" pos="0 0 0.5" euler="0 0 90">
    <joint name="hinge" axis="0 1 0"/>
    <geom type="mesh" mesh="t" rgba="1 0 0 0.5" pos="0 0 0.1"/>
    <geom type="box" size=".1 .2 .3" group="3"/>
    <geom type="box" size=".1 .2 .3" rgba="1 1 1 0"/>
    <geom type="capsule" size=".02" fromto="0 0 0 0 0 0.1"/>
  </body>
</worldbody></mujoco>"""

URDF = """<robot name="r"><material name="blue"><color rgba="0 0 1 1"/></material>
<link name="base"><visual><geometry><box size="2 4 6"/></geometry></visual></link>
<link name="arm">
  <inertial><origin xyz="0 0 -0.3"/><mass value="1"/>
    <inertia ixx=".1" iyy=".1" izz=".1" ixy="0" ixz="0" iyz="0"/></inertial>
  {visuals}
</link>
<joint name="hinge" type="continuous"><parent link="base"/><child link="arm"/>
  <origin xyz="0 0 1"/><axis xyz="0 1 0"/></joint></robot>"""


def visual(geometry, origin='<origin xyz="0 0 -0.1" rpy="0 0 1.5707963267948966"/>'):
    return f"<visual>{origin}<geometry>{geometry}</geometry><material name='blue'/></visual>"


@pytest.fixture
def folder(tmp_path):
    """A package with a mesh."""
    meshes = tmp_path / "robot" / "meshes"
    meshes.mkdir(parents=True)
    (meshes / "t.obj").write_text(OBJ)
    (meshes / "broken.stl").write_text("no mesh")
    return tmp_path / "robot"


def of_urdf(folder: Path, *visuals: str):
    path = folder / "robot.urdf"
    path.write_text(URDF.replace("{visuals}", "".join(visuals)))
    return urdf.read(path)


def corners(vertices):
    """Points in an order that does not depend on the file's."""
    rounded = np.round(vertices, 9) + 0.0
    return rounded[np.lexsort(rounded.T)]


def volume(mesh: Mesh) -> float:
    """Enclosed by a mesh whose triangles are counterclockwise seen from outside, m^3."""
    a, b, c = mesh.vertices[mesh.triangles].transpose(1, 0, 2)
    return float(np.sum(a * np.cross(b, c))) / 6.0


def test_meshes_of_an_mjcf_are_where_mujoco_has_them(folder):
    (folder / "m.xml").write_text(MJCF)
    ground, arm = mjcf.read(folder / "m.xml").scene.mechanism.bodies
    turned = CORNERS @ np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    for body, expected, color in (
        (ground, CORNERS - Z, (0.0, 1.0, 0.0, 1.0)),
        (arm, turned + 0.6 * Z, (1.0, 0.0, 0.0, 0.5)),
    ):
        (mesh,) = body.meshes
        # single precision in MuJoCo: 6e-8 of coordinates of at most 1 m
        np.testing.assert_allclose(corners(np.round(mesh.vertices, 6)), corners(expected), atol=1e-6)
        assert volume(mesh) == pytest.approx(0.3 * 0.1 * 0.2 / 6.0, rel=1e-5)
        np.testing.assert_allclose(mesh.color, color, atol=1e-7)
    # boxes of a hidden group and without opacity are not seen
    assert [type(shape) for shape in arm.shapes] == [Capsule]


def test_a_missing_mesh_of_an_mjcf_is_one_line(folder, capsys):
    (folder / "m.xml").write_text(MJCF.replace("t.obj", "gone.obj"))
    status, out, err = run(capsys, "run", folder / "m.xml", "--output", folder / "out")
    assert (status, out) == (2, "")
    assert len(err.splitlines()) == 1
    assert "m.xml" in err
    assert "gone.obj" in err


@pytest.mark.parametrize("name", ["meshes/t.obj", "package://robot/meshes/t.obj", "../robot/meshes/t.obj"])
def test_visuals_of_a_urdf(folder, name):
    reading = of_urdf(
        folder,
        visual(f'<mesh filename="{name}" scale="2 -1 1"/>'),
        visual('<cylinder radius="0.1" length="0.6"/>', ""),
    )
    ground, arm = reading.scene.mechanism.bodies
    (mesh,) = arm.meshes
    turned = (CORNERS * [2.0, -1.0, 1.0]) @ np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    np.testing.assert_allclose(corners(mesh.vertices), corners(turned + 0.9 * Z), atol=1e-6)
    assert volume(mesh) == pytest.approx(2.0 * 0.3 * 0.1 * 0.2 / 6.0, rel=1e-5)  # mirrored, not inside out
    assert mesh.color == (0.0, 0.0, 1.0, 1.0)
    (bar,) = arm.shapes
    assert isinstance(bar, Cylinder)
    np.testing.assert_allclose([bar.start, bar.end], [[0.0, 0.0, 0.7], [0.0, 0.0, 1.3]], atol=1e-15)
    (box,) = ground.shapes
    assert isinstance(box, Box)
    np.testing.assert_allclose(box.half_sizes, [1.0, 2.0, 3.0])
    assert ("3 visuals", "drawn") in [(e.element, e.how) for e in reading.report.of("exactly")]


def test_a_package_beside_has_to_be_one(folder):
    """A folder of any name beside those around the file would reach most of the disk."""
    beside = folder.parent / "parts"
    (beside / "meshes").mkdir(parents=True)
    shutil.copy(folder / "meshes" / "t.obj", beside / "meshes")
    geometry = visual('<mesh filename="package://parts/meshes/t.obj"/>')
    assert not of_urdf(folder, geometry).scene.mechanism.bodies[1].meshes
    (beside / "package.xml").write_text("<package/>")
    assert len(of_urdf(folder, geometry).scene.mechanism.bodies[1].meshes) == 1


@pytest.mark.parametrize("name", ["", ".", "..", "\0"])
def test_no_package_is_a_folder_itself_or_a_step_up(folder, name):
    for place in (folder.parent, folder, folder / "meshes"):
        (place / "package.xml").write_text("<package/>")
    geometry = visual(f'<mesh filename="package://{name}/robot/meshes/t.obj"/>')
    if name != "\0":  # which XML cannot hold
        assert not of_urdf(folder, geometry).scene.mechanism.bodies[1].meshes
    assert packages(folder / "meshes", name) == []


@pytest.mark.parametrize(
    ("geometry", "why"),
    [
        ('<mesh filename="meshes/gone.obj"/>', "mesh 'meshes/gone.obj' does not exist"),
        ('<mesh filename="package://gone/t.obj"/>', "mesh 'package://gone/t.obj' does not exist"),
        ('<mesh filename="/etc/passwd"/>', "mesh '/etc/passwd' leads outside of "),
        ('<mesh filename="../../../etc/passwd"/>', "leads outside of "),
        ('<mesh filename="package://robot/../../../etc/passwd"/>', "leads outside of "),
        ('<mesh filename="meshes/broken.stl"/>', "no mesh can be read from 'broken.stl'"),
        ('<mesh filename="meshes/t.obj" scale="1 nan 1"/>', "scale='1 nan 1'; needed: 3 numbers"),
        ('<box size="1 2"/>', "size='1 2'; needed: 3 numbers"),
        ('<box size="1 2 -3"/>', "three positive lengths"),
        ('<sphere radius="-1"/>', "sphere: radius is -1.0; needed: a positive length"),
        ('<capsule radius="1"/>', "no box, cylinder, sphere or mesh"),
    ],
)
def test_what_cannot_be_drawn_is_reported_and_the_rest_is(folder, geometry, why):
    reading = of_urdf(folder, visual(geometry), visual('<mesh filename="meshes/t.obj"/>'))
    left_out = [e.how for e in reading.report.of("left out") if e.element == "visual of link 'arm'"]
    assert len(left_out) == 1
    assert why in left_out[0]
    assert len(reading.scene.mechanism.bodies[1].meshes) == 1


def test_meshes_in_a_recording_stand_where_the_mechanism_has_them(tmp_path):
    scene = lid_scene()
    ground, slider, lid = scene.mechanism.bodies
    mesh = Mesh(CORNERS + lid.center_of_mass, FACES, (0.2, 0.4, 0.6, 1.0))
    bodies = (ground, replace(slider, meshes=(Mesh(CORNERS, FACES),)), replace(lid, meshes=(mesh,)))
    scene = replace(scene, mechanism=Mechanism(bodies, scene.mechanism.joints), initial_state=None)
    write_recording(tmp_path / "lid.rrd", scene, lid_runs(scene))
    static = read_recording(tmp_path / "lid.rrd").static
    first, second = (f"/mechanism/{engine}/lid/mesh_0" for engine in ("zeta", "alpha"))
    drawn = np.array(static[first, "Mesh3D:vertex_positions"])
    # in single precision, 6e-8 of coordinates of at most 0.6 m
    np.testing.assert_allclose(drawn @ rotation(lid.quaternion).T, CORNERS, atol=1e-7)
    assert static[first, "Mesh3D:triangle_indices"] == FACES.tolist()
    assert static[first, "Mesh3D:albedo_factor"] == [0x336699FF]
    assert static[second, "Mesh3D:albedo_factor"][0] & 0xFF == GHOST_OPACITY
    assert static[second, "Mesh3D:vertex_positions"] == static[first, "Mesh3D:vertex_positions"]
    # bars stand in for shapes where there are no meshes
    assert ("/mechanism/zeta/slider", "Capsules3D:lengths") not in static
    assert ("/mechanism/zeta/lid", "Capsules3D:lengths") in static  # the lid's own


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (([[0.0, 0.0]], FACES), "vertices of shape"),
        (([[0.0, 0.0, np.nan]], []), "vertices of shape"),
        ((CORNERS, [[0, 1]]), "triangles of shape"),
        ((CORNERS, [[0, 1, 4]]), "name vertices 0 to 4"),
        ((CORNERS, FACES, (0.0, 0.0, 0.0, 2.0)), "four numbers from 0 to 1"),
    ],
)
def test_a_mesh_says_what_is_wrong_with_it(arguments, message):
    with pytest.raises(MechanismError, match=message):
        Mesh(*arguments)


@pytest.mark.slow
def test_meshes_beyond_the_limit_are_named_beside_the_recording(folder, capsys):
    (folder / "m.xml").write_text(MJCF)
    sizes = {}
    for limit in ("50", "0.0001"):
        out = folder / f"out_{limit}"
        options = ("--set", "duration=0.05", "--set", f"recording_size={limit}", "--output", out)
        _, text, _ = run(capsys, "run", folder / "m.xml", *options)
        assert ("--set recording_size=1" in text) == (limit != "50")
        sizes[limit] = (out / "m.rrd").stat().st_size
    assert sizes["0.0001"] < sizes["50"]
