"""Homogeneous solids: mass, center and inertia as closed forms, MuJoCo and their surfaces have them."""

from __future__ import annotations

import math
from typing import Any

import mujoco
import numpy as np
import pytest

import mjcf
import urdf
from newton_euler import Body, Box, Capsule, Cylinder, Free, Mechanism, Mesh, Scene, Sphere
from newton_euler.errors import MechanismError
from newton_euler.model.euler_parameters import rotation
from newton_euler.scalars import Array

DENSITY = 780.0

CENTER = np.array([0.3, -0.2, 0.5])
TURN = np.array([0.8, 0.2, -0.4, 0.4])
"""w-x-y-z, of norm 1."""

END = np.array([-0.1, 0.4, 0.9])

CORNERS = np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])
FACES = [
    [0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
    [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3],
]  # fmt: skip
"""Of a box with these corners, counterclockwise seen from outside."""

BOX = Box([0.3, 0.2, 0.1], CENTER, TURN)
MESH = Mesh(CENTER + (CORNERS * BOX.half_sizes) @ rotation(TURN).T, FACES)
STEP = Mesh(
    [
        *([x, 0.0, z] for x, z in ((0, 0), (2, 0), (2, 1), (1, 1), (1, 2), (0, 2))),
        *([x, 0.5, z] for x, z in ((0, 0), (2, 0), (2, 1), (1, 1), (1, 2), (0, 2))),
    ],
    [
        *([0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 5], [6, 8, 7], [6, 9, 8], [6, 10, 9], [6, 11, 10]),
        *(
            each
            for k in range(6)
            for each in ([k, 6 + k, (k + 1) % 6], [(k + 1) % 6, 6 + k, 6 + (k + 1) % 6])
        ),
    ],
)
"""A prism of an L, which is not convex: 3 squares of 1 m by 0.5 m."""

SOLIDS = {
    "box": BOX,
    "sphere": Sphere(CENTER, 0.3),
    "cylinder": Cylinder(CENTER, END, 0.1),
    "capsule": Capsule(CENTER, END, 0.1),
    "mesh": MESH,
    "mesh that is not convex": STEP,
}


def geom(solid: Any) -> str:
    """MuJoCo's geom of a solid."""

    def text(values: Array) -> str:
        return " ".join(map(repr, np.ravel(values).tolist()))

    match solid:
        case Box():
            place = f'pos="{text(solid.center)}" quat="{text(solid.quaternion)}"'
            return f'<geom type="box" size="{text(solid.half_sizes)}" {place} density="{DENSITY}"/>'
        case Sphere():
            return f'<geom size="{solid.radius}" pos="{text(solid.center)}" density="{DENSITY}"/>'
        case Mesh():
            return f'<geom type="mesh" mesh="surface" density="{DENSITY}"/>'
        case _:
            kind = type(solid).__name__.lower()
            ends = text(np.concatenate([solid.start, solid.end]))
            return f'<geom type="{kind}" size="{solid.radius}" fromto="{ends}" density="{DENSITY}"/>'


@pytest.mark.parametrize("solid", SOLIDS.values(), ids=SOLIDS)
def test_mass_center_and_inertia_are_those_of_mujoco(solid):
    asset = ""
    if isinstance(solid, Mesh):
        points, faces = (
            " ".join(map(repr, each.ravel().tolist())) for each in (solid.vertices, solid.triangles)
        )
        asset = f'<asset><mesh name="surface" inertia="exact" vertex="{points}" face="{faces}"/></asset>'
    body = f"<worldbody><body><freejoint/>{geom(solid)}</body></worldbody>"
    model = mujoco.MjModel.from_xml_string(f"<mujoco>{asset}{body}</mujoco>")
    axes = rotation(model.body_iquat[1])
    found = solid.inertia(DENSITY)
    # round-off; MuJoCo keeps vertices of meshes in single precision
    near = 1e-6 if isinstance(solid, Mesh) else 1e-13
    assert found.mass == pytest.approx(model.body_mass[1], rel=near)
    np.testing.assert_allclose(found.center_of_mass, model.body_ipos[1], rtol=0.0, atol=near)
    wanted = axes @ np.diag(model.body_inertia[1]) @ axes.T
    np.testing.assert_allclose(found.inertia, wanted, rtol=0.0, atol=near * wanted.trace())


@pytest.mark.parametrize(
    ("solid", "volume", "moments"),
    [
        (Box([1.0, 2.0, 3.0], [0.0] * 3), 48.0, [13.0 / 3.0, 10.0 / 3.0, 5.0 / 3.0]),
        (Sphere([0.0] * 3, 2.0), 32.0 / 3.0 * math.pi, [1.6] * 3),
        (Cylinder([0.0, 0.0, -3.0], [0.0, 0.0, 3.0], 2.0), 24.0 * math.pi, [4.0, 4.0, 2.0]),
        (Capsule([0.0] * 3, [0.0] * 3, 2.0), 32.0 / 3.0 * math.pi, [1.6] * 3),
    ],
    ids=["box", "sphere", "cylinder", "capsule without a bar"],
)
def test_closed_forms(solid, volume, moments):
    found = solid.inertia(1.0)
    assert found.mass == pytest.approx(volume, rel=1e-15)
    np.testing.assert_allclose(found.inertia, volume * np.diag(moments), rtol=1e-14, atol=1e-13)


@pytest.mark.parametrize("away", [0.0, 1e3])
def test_a_mesh_of_a_box_is_that_box(away):
    box = Box(BOX.half_sizes, CENTER + away, TURN).inertia(DENSITY)
    soup = (MESH.vertices + away)[MESH.triangles].reshape(-1, 3)  # as an STL has it, corner by corner
    mesh = Mesh(soup, np.arange(len(soup)).reshape(-1, 3)).inertia(DENSITY)
    digits = 1e-15 * (1.0 + away) / 0.1  # of vertices, over the least half size
    assert mesh.mass == pytest.approx(box.mass, rel=1e1 * digits)
    np.testing.assert_allclose(mesh.center_of_mass, box.center_of_mass, rtol=1e1 * digits)
    np.testing.assert_allclose(mesh.inertia, box.inertia, rtol=0.0, atol=1e2 * digits * box.inertia.trace())


def test_a_body_of_several_solids_is_their_sum():
    halves = [Box([0.15, 0.2, 0.1], CENTER + sign * np.array([0.15, 0.0, 0.0])) for sign in (-1.0, 1.0)]
    whole = Body.solid("whole", Box([0.3, 0.2, 0.1], CENTER), mass=3.0)
    body = Body.solid("halves", *halves, mass=3.0)
    assert body.mass == pytest.approx(3.0, rel=1e-15)
    np.testing.assert_allclose(body.center_of_mass, CENTER, rtol=1e-15)
    np.testing.assert_allclose(body.inertia, whole.inertia, rtol=1e-14, atol=1e-16)
    assert body.shapes == tuple(halves)
    assert Body.solid("mesh", MESH, density=1.0).meshes == (MESH,)


def test_solids_are_drawn_as_they_are_in_model_files(tmp_path):
    shapes = [SOLIDS[kind] for kind in ("box", "sphere", "cylinder")]
    base = Body.solid("base", *shapes, density=DENSITY)
    joints = [Free("floating", "ground", "base", [0.0] * 3)]
    scene = Scene("solids", Mechanism([Body.ground(), base], joints), 1.0, 0.1)
    mjcf.write(scene, tmp_path / "solids.xml")
    urdf.write(scene, tmp_path / "solids.urdf")
    for read in (
        mjcf.read(tmp_path / "solids.xml").scene,
        urdf.read(tmp_path / "solids.urdf", tmp_path / "solids.loops.yaml").scene,
    ):
        for shape, drawn in zip(shapes, read.mechanism.bodies[1].shapes, strict=True):
            one, other = shape.inertia(DENSITY), drawn.inertia(DENSITY)
            # URDF says angles of shapes to six digits
            np.testing.assert_allclose(other.center_of_mass, one.center_of_mass, atol=1e-5)
            np.testing.assert_allclose(other.inertia, one.inertia, atol=1e-5 * one.inertia.trace())


@pytest.mark.parametrize(
    ("solid", "given", "message"),
    [
        (MESH, {"density": 0.0}, "body 'a': mesh: density is 0.0; needed: a positive number of kg/m"),
        (MESH, {"mass": math.inf}, "body 'a': mass is inf; needed: a positive number of kg"),
        (MESH, {"mass": 1.0, "density": 1.0}, "body 'a': is given a density and a mass; needed: one of them"),
        (MESH, {}, "body 'a': is given no density and no mass"),
        (1.0, {"mass": 1.0}, "body 'a': solids holds 1.0"),
        (
            Mesh(MESH.vertices, FACES[1:]),
            {"mass": 1.0},
            "body 'a': mesh: 3 edges are not between two triangles of one orientation; needed: a closed",
        ),
        (Mesh(MESH.vertices, [FACES[0][::-1], *FACES[1:]]), {"mass": 1.0}, "mesh: 3 edges are not between"),
        (
            Mesh(MESH.vertices, np.zeros((0, 3))),
            {"mass": 1.0},
            "mesh: no triangles; needed: a closed surface",
        ),
        (
            Mesh(MESH.vertices, MESH.triangles[:, ::-1]),
            {"mass": 1.0},
            "mesh: encloses -0.048 m.3; needed: a positive volume, its triangles counterclockwise",
        ),
        (Sphere([0.0] * 3, 1e120), {"mass": 1.0}, "body 'a': sphere: mass is inf kg; needed: lengths"),
        (Box([1e-200] * 3, [0.0] * 3), {"mass": 1.0}, "body 'a': box: mass is 0 kg; needed: lengths"),
        (Cylinder([0.0] * 3, [1.0, 0.0, 0.0], 1e200), {"mass": 1.0}, "body 'a': cylinder: mass is inf kg"),
        (Capsule([0.0] * 3, [1.0, 0.0, 0.0], 1e200), {"mass": 1.0}, "body 'a': capsule: mass is inf kg"),
        (Sphere([0.0] * 3, 1e90), {"mass": 1.0}, "body 'a': sphere: moment of inertia is inf kg m.2; needed"),
        (Box([1e-90] * 3, [0.0] * 3), {"mass": 1.0}, "body 'a': box: moment of inertia is 0 kg m.2"),
        (Mesh(1e110 * MESH.vertices, FACES), {"mass": 1.0}, "body 'a': mesh: mass is inf kg"),
        (Mesh(1e-200 * MESH.vertices, FACES), {"mass": 1.0}, "body 'a': mesh: encloses 0 m.3"),
        (Sphere([0.0] * 3, 1e-10), {"mass": 1e300}, "body 'a': solids: mass is inf kg"),
    ],
)
def test_what_is_no_solid_is_named(solid, given, message):
    with pytest.raises(MechanismError, match=message):
        Body.solid("a", solid, **given)


def test_a_body_needs_a_solid_and_a_cylinder_two_ends():
    with pytest.raises(MechanismError, match="body 'a': has no solids"):
        Body.solid("a", mass=1.0)
    with pytest.raises(MechanismError, match="cylinder: start and end are one point; needed: two ends"):
        Cylinder(CENTER, CENTER, 1.0)
    with pytest.raises(MechanismError, match=r"sphere: radius is 0.0; needed: a positive length"):
        Sphere(CENTER, 0.0)
