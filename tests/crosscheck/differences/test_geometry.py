"""Shapes of bodies in two files: one planted change is one row, and other ways to write a shape are none."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

import crosscheck
from crosscheck.compare.outcome import Outcome
from crosscheck.differences.difference import Difference, Standing
from crosscheck.differences.difference import Quantity as Q
from crosscheck.loading.convert import scene_report, write_as
from crosscheck.loading.load import load_scene
from crosscheck.report.diff import GEOMETRY, report, verdict
from crosscheck.report.render import terminal
from crosscheck.report.table import Table
from crosscheck.support.errors import CrosscheckError

ARM = """
<mujoco model="arm"><compiler angle="radian"/><asset>{assets}</asset><worldbody>{floor}
  <body name="upper"{place}><joint name="shoulder" axis="0 1 0"/>{upper}
    <inertial pos="0.1 0 0" mass="1" diaginertia="0.01 0.02 0.02"/>
  <body name="fore" pos="0.3 0 0"><joint name="elbow" axis="0 1 0"/>{fore}
    <inertial pos="0.1 0 0.02" mass="0.5" diaginertia="0.01 0.01 0.01"/>
  </body></body></worldbody></mujoco>"""
EMPTY = {"assets": "", "floor": "", "place": "", "upper": "", "fore": ""}

URDF = """
<robot name="arm"><link name="world"/>
<joint name="shoulder" type="continuous">
  <parent link="world"/><child link="upper"/><axis xyz="0 1 0"/></joint>
<link name="upper"><inertial><origin xyz="0.1 0 0"/><mass value="1"/>
  <inertia ixx="0.01" iyy="0.02" izz="0.02" ixy="0" ixz="0" iyz="0"/></inertial>{upper}</link>
<joint name="elbow" type="continuous"><origin xyz="0.3 0 0"/>
  <parent link="upper"/><child link="fore"/><axis xyz="0 1 0"/></joint>
<link name="fore"><inertial><origin xyz="0.1 0 0.02"/><mass value="0.5"/>
  <inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial>{fore}</link></robot>"""

BOX = '<geom type="box" size="{size}" pos="{pos}"{more}/>'
DRAWN = ' contype="0" conaffinity="0"'

VERTICES = np.array([[0.0, 0.0, 0.0], [0.3, 0.0, 0.0], [0.0, 0.2, 0.0], [0.0, 0.0, 0.1], [0.1, 0.1, 0.1]])
FACES = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 4], [1, 4, 3], [2, 3, 4]])


def box(size: str = "0.1 0.05 0.02", pos: str = "0.15 0 0", more: str = "") -> str:
    return BOX.format(size=size, pos=pos, more=more)


def write_mesh(path: Path, vertices: np.ndarray) -> None:
    """Write a mesh as an OBJ file."""
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in vertices.tolist()]
    lines += [f"f {a} {b} {c}" for a, b, c in (FACES + 1).tolist()]
    path.write_text("\n".join(lines) + "\n")


def of_mjcf(folder: Path, first: dict[str, str], second: dict[str, str]) -> crosscheck.Diff:
    paths = [folder / "first.xml", folder / "second.xml"]
    for path, numbers in zip(paths, (first, second), strict=True):
        path.write_text(ARM.format(**EMPTY | numbers))
    return crosscheck.diff(*paths, geometry=True)


def only_row(found: crosscheck.Diff) -> Difference:
    (row,) = found.differences
    assert (row.is_geometry, row.effect) == (True, 0.0)
    assert found.outcome is Outcome.DIFFERENT
    return row


@pytest.mark.parametrize(
    ("first", "second", "kind", "quantity", "values"),
    [
        (box(), box(size="0.1 0.05 0.03"), "collision box", Q.SIZE, ((0.2, 0.1, 0.04), (0.2, 0.1, 0.06))),
        (box(), box(pos="0.15 0 0.01"), "collision box", Q.PLACE, ((0.15, 0.0, 0.0), (0.15, 0.0, 0.01))),
        (box(), box(more=' euler="0 0 0.5"'), "collision box", Q.ORIENTATION, (0.0, 0.5)),
        (
            box(),
            '<geom type="ellipsoid" size="0.1 0.1 0.1"/>',
            "collision shape",
            Q.KIND,
            ("box", "ellipsoid"),
        ),
        (
            box(),
            box(size="0.1 0.05 0.03", pos="0.15 0 0.01"),
            "collision box",
            Q.SHAPE,
            ("0.2 0.1 0.04 at 0.15 0 0 m", "0.2 0.1 0.06 at 0.15 0 0.01 m"),
        ),
        (box(), "", "collision box", Q.PRESENCE, ("box", None)),
        (box(), box() + box(more=DRAWN), "visual box", Q.PRESENCE, (None, "box")),
        (box(), box(more=' condim="4"'), "collision box", Q.CONDIM, (3.0, 4.0)),
        (box(), box(more=' margin="0.01"'), "collision box", Q.MARGIN, (0.0, 0.01)),
        (box(), box(more=' gap="0.01"'), "collision box", Q.GAP, (0.0, 0.01)),
        (box(), box(more=' contype="2"'), "collision box", Q.CONTYPE, (1.0, 2.0)),
        (box(), box(more=' conaffinity="3"'), "collision box", Q.CONAFFINITY, (1.0, 3.0)),
        (
            box(),
            box(more=' friction="0.5"'),
            "collision box",
            Q.CONTACT_FRICTION,
            ((1.0, 0.005, 0.0001), (0.5, 0.005, 0.0001)),
        ),
    ],
)
def test_one_planted_change_of_a_shape_is_one_row(first, second, kind, quantity, values, tmp_path):
    found = of_mjcf(tmp_path, {"fore": first}, {"fore": second})
    row = only_row(found)
    assert (row.element, row.element_kind, row.quantity) == ("fore", kind, quantity)
    for value, planted in zip((row.first, row.second), values, strict=True):
        numeric = not isinstance(planted, str | None)
        assert value == (pytest.approx(planted, abs=1e-12) if numeric else planted)
    # without the option, the files are the same
    paths = tmp_path / "first.xml", tmp_path / "second.xml"
    assert crosscheck.diff(*paths).outcome is Outcome.SAME


def test_a_shape_that_no_longer_touches_is_a_change_of_its_contact(tmp_path):
    found = of_mjcf(tmp_path, {"fore": box()}, {"fore": box(more=DRAWN)})
    assert {row.quantity for row in found.differences} == {Q.CONTYPE, Q.CONAFFINITY}


def test_rows_of_shapes_stand_in_their_own_table(tmp_path):
    changed = box(size="0.1 0.05 0.03")
    found = of_mjcf(tmp_path, {"fore": box()}, {"fore": changed, "place": ' pos="0 0 0.1"'})
    assert verdict(found.comparison) == "DIFFERENT: 1 difference of shapes; both move alike"
    text = " ".join(terminal(report(found.comparison).summary).split())
    assert GEOMETRY in text
    assert "size of collision box of fore: 0.2 0.1 0.04 against 0.2 0.1 0.06 m" in text
    (table,) = (table for table in report(found.comparison).parts if isinstance(table, Table))
    heading, (number, element, what, *_) = next(iter(table.sections()))
    assert (heading, number.text, element.text, what.text) == (GEOMETRY, "1", "fore", "size of collision box")
    (row,) = found.comparison.summary()["differences"][:1]
    assert (row["element"], row["quantity"], row["effect"]) == ("fore", "size", 0.0)
    with_mass = (tmp_path / "second.xml").read_text().replace('mass="0.5"', 'mass="0.6"')
    (tmp_path / "second.xml").write_text(with_mass)
    found = crosscheck.diff(tmp_path / "first.xml", tmp_path / "second.xml", geometry=True)
    assert [row.quantity for row in found.differences] == [Q.MASS, Q.SIZE]
    assert verdict(found.comparison).startswith("DIFFERENT: 2 differences, 1 of them of shapes;")


@pytest.mark.parametrize(
    ("first", "second"),
    [
        # a box with its axes in another order, and one turned by half a turn
        (box(), box(size="0.05 0.1 0.02", more=f' euler="0 0 {np.pi / 2!r}"')),
        (box(), box(more=f' euler="{np.pi!r} 0 0"')),
        (
            '<geom type="capsule" size="0.01" fromto="0 0 0 0.1 0 0.1"/>',
            '<geom type="capsule" size="0.01" fromto="0.1 0 0.1 0 0 0"/>',
        ),
        ('<geom size="0.02"/>', '<geom size="0.02" euler="0.3 0.2 0.1"/>'),
        # shapes in another order
        (box() + box(pos="-0.15 0 0"), box(pos="-0.15 0 0") + box()),
    ],
)
def test_other_words_for_one_shape_are_no_difference(first, second, tmp_path):
    found = of_mjcf(tmp_path, {"fore": first}, {"fore": second})
    assert found.outcome in (Outcome.SAME, Outcome.SAME_TO_ROUNDING)


def test_digits_of_the_files_leave_numbers_of_shapes_open(tmp_path):
    found = of_mjcf(tmp_path, {"fore": box()}, {"fore": box(size="0.1000001 0.05 0.02", pos="0.1500001 0 0")})
    assert found.outcome is Outcome.SAME_TO_ROUNDING
    assert {row.quantity for row in found.comparison.of_standing(Standing.ROUNDING)} == {Q.SIZE, Q.PLACE}


def test_the_same_change_at_several_bodies_is_one_row(tmp_path):
    drawn = box(more=DRAWN)
    row = only_row(of_mjcf(tmp_path, {"fore": drawn, "upper": drawn}, {}))
    assert (row.element_kind, row.quantity) == ("visual box", Q.PRESENCE)
    assert {*row.elements} == {"fore", "upper"}


def test_shapes_that_only_one_file_has_at_a_body_each_are_not_exchanged(tmp_path):
    found = of_mjcf(tmp_path, {"fore": box()}, {"upper": box()})
    assert {(row.quantity, row.element, row.cause) for row in found.differences} == {
        (Q.PRESENCE, "fore", ""),
        (Q.PRESENCE, "upper", ""),
    }


def test_a_turn_below_single_precision_is_none(tmp_path):
    found = of_mjcf(tmp_path, {"fore": box()}, {"fore": box(more=' quat="1 0 0 2e-9"')})
    assert found.outcome is Outcome.SAME


def test_shapes_of_the_ground_are_compared(tmp_path):
    row = only_row(of_mjcf(tmp_path, {"floor": '<geom type="plane" size="1 1 1"/>'}, {}))
    assert (row.element, row.element_kind) == ("world", "collision plane")


LINK = '<{tag}><origin xyz="{xyz}" rpy="{rpy}"/><geometry>{shape}</geometry></{tag}>'


def link_shape(shape: str, tag: str = "collision", xyz: str = "0 0 0", rpy: str = "0 0 0") -> str:
    return LINK.format(tag=tag, xyz=xyz, rpy=rpy, shape=shape)


def test_an_mjcf_and_a_urdf_with_equal_shapes_are_the_same(tmp_path):
    rod = '<geom type="cylinder" size="0.02 0.1" pos="0.1 0 0" euler="0 1.5707963267948966 0"/>'
    paths = tmp_path / "arm.xml", tmp_path / "arm.urdf"
    paths[0].write_text(ARM.format(**EMPTY | {"upper": rod, "fore": box() + '<geom size="0.02"/>'}))
    cylinder = link_shape(
        '<cylinder radius="0.02" length="0.2"/>', xyz="0.1 0 0", rpy="0 -1.5707963267948966 0"
    )
    shapes = link_shape('<sphere radius="0.02"/>') + link_shape('<box size="0.2 0.1 0.04"/>', xyz="0.15 0 0")
    paths[1].write_text(URDF.format(upper=cylinder, fore=shapes))
    assert crosscheck.diff(*paths, geometry=True).differences == ()
    paths[1].write_text(URDF.format(upper=cylinder, fore=shapes.replace('"0.02"', '"0.03"')))
    row = only_row(crosscheck.diff(*paths, geometry=True))
    assert (row.element, row.quantity, row.first, row.second) == ("fore", Q.SIZE, (0.02,), (0.03,))


def test_equal_shapes_in_another_link_frame_are_no_difference(tmp_path):
    """The frame of the last link is turned by a quarter turn about the axis of its joint."""
    turned = URDF.replace('<origin xyz="0.3 0 0"/>', '<origin xyz="0.3 0 0" rpy="0 1.5707963267948966 0"/>')
    turned = turned.replace('<origin xyz="0.1 0 0.02"/>', '<origin xyz="-0.02 0 0.1"/>')
    block = '<box size="0.2 0.1 0.04"/>'
    paths = tmp_path / "first.urdf", tmp_path / "second.urdf"
    paths[0].write_text(URDF.format(upper="", fore=link_shape(block, xyz="0.15 0 0")))
    back = "0 -1.5707963267948966 0"
    paths[1].write_text(turned.format(upper="", fore=link_shape(block, xyz="0 0 0.15", rpy=back)))
    found = crosscheck.diff(*paths, geometry=True)
    assert found.differences == ()
    assert Q.FRAME in {row.quantity for row in found.comparison.of_standing(Standing.CONVENTION)}
    # the numbers of the first file at the turned link are another place and another orientation
    paths[1].write_text(turned.format(upper="", fore=link_shape(block, xyz="0.15 0 0")))
    found = crosscheck.diff(*paths, geometry=True)
    assert {row.quantity for row in found.differences} == {Q.PLACE, Q.ORIENTATION}


def mesh_arms(folder: Path, **second: str) -> tuple[Path, Path]:
    """Write an MJCF and a URDF of an arm with a mesh, and return their paths."""
    paths = folder / "arm.xml", folder / "arm.urdf"
    given = {"name": "block.obj", "xyz": "0.1 0 0", "scale": "1 1 1"} | second
    geom = '<geom type="mesh" mesh="block" pos="0.1 0 0"/>'
    paths[0].write_text(ARM.format(**EMPTY | {"assets": '<mesh file="block.obj"/>', "fore": geom}))
    shape = f'<mesh filename="{given["name"]}" scale="{given["scale"]}"/>'
    paths[1].write_text(URDF.format(upper="", fore=link_shape(shape, xyz=given["xyz"])))
    return paths


def test_a_mesh_is_its_vertices_and_not_its_file(tmp_path):
    write_mesh(tmp_path / "block.obj", VERTICES)
    write_mesh(tmp_path / "renamed.obj", VERTICES[:, :] + [0.1, 0.0, 0.0])
    write_mesh(tmp_path / "mm.obj", 1e3 * VERTICES)
    for same in (
        {},
        {"name": "renamed.obj", "xyz": "0 0 0"},
        {"name": "mm.obj", "scale": "0.001 0.001 0.001"},
    ):
        found = crosscheck.diff(*mesh_arms(tmp_path, **same), geometry=True)
        assert (found.differences, found.comparison.first.notes) == ((), ())


def test_planted_changes_of_meshes(tmp_path):
    write_mesh(tmp_path / "block.obj", VERTICES)
    write_mesh(tmp_path / "other.obj", VERTICES * [1.0, 1.0, 2.0])
    row = only_row(crosscheck.diff(*mesh_arms(tmp_path, xyz="0.1 0 0.2"), geometry=True))
    assert (row.element_kind, row.quantity) == ("collision mesh", Q.PLACE)
    assert row.second == pytest.approx((0.1, 0.0, 0.2), abs=1e-12)
    row = only_row(crosscheck.diff(*mesh_arms(tmp_path, scale="1 1 2"), geometry=True))
    assert (row.quantity, row.second) == (Q.MESH_SCALE, (1.0, 1.0, 2.0))
    row = only_row(crosscheck.diff(*mesh_arms(tmp_path, name="other.obj"), geometry=True))
    assert row.quantity is Q.SHAPE
    assert row.first == "5 vertices in 0.3 x 0.2 x 0.1 m"
    assert row.second == "5 vertices in 0.3 x 0.2 x 0.2 m"


def test_simplified_meshes_of_several_bodies_are_one_row(tmp_path):
    write_mesh(tmp_path / "block.obj", VERTICES)
    write_mesh(tmp_path / "simple.obj", VERTICES * [1.0, 1.0, 0.9])
    geom = '<geom type="mesh" mesh="block"/><geom type="mesh" mesh="block" pos="0.2 0 0"/>'
    first, second = (
        {
            "assets": f'<mesh name="block" file="{name}.obj"/>',
            "fore": geom,
            "upper": geom.replace("<geom", '<geom euler="0.5 0 0"'),
        }
        for name in ("block", "simple")
    )
    row = only_row(of_mjcf(tmp_path, first, second))
    assert (row.quantity, {*row.elements}) == (Q.SHAPE, {"fore", "upper"})


def test_shapes_of_bodies_without_names_are_compared(tmp_path):
    found = of_mjcf(tmp_path, {"fore": box()}, {"fore": box(size="0.1 0.05 0.03")})
    assert found.outcome is Outcome.DIFFERENT
    paths = [tmp_path / "first.xml", tmp_path / "second.xml"]
    for path in paths:
        path.write_text(path.read_text().replace(' name="fore"', ""))
    row = only_row(crosscheck.diff(*paths, geometry=True))
    assert (row.element, row.quantity) == ("body 2", Q.SIZE)


def test_a_missing_mesh_is_one_note(tmp_path):
    write_mesh(tmp_path / "block.obj", VERTICES)
    paths = mesh_arms(tmp_path, name="none.obj")
    found = crosscheck.diff(*paths, geometry=True)
    assert found.differences == ()
    (note,) = found.comparison.second.notes
    assert "none.obj" in note
    (tmp_path / "block.obj").unlink()
    found = crosscheck.diff(*paths, geometry=True)
    assert found.differences == ()
    (note,) = found.comparison.first.notes
    assert "block.obj" in note
    # a file that is no mesh, such as the pointer of a large file
    (tmp_path / "pointer.obj").write_text("version https://git-lfs.github.com/spec/v1\n")
    paths[0].write_text(paths[0].read_text().replace('file="block.obj"', 'name="block" file="pointer.obj"'))
    found = crosscheck.diff(*paths, geometry=True)
    assert found.differences == ()
    assert len(found.comparison.first.notes) == 1


def test_a_shape_of_an_unknown_geometry_is_a_note(tmp_path):
    paths = mesh_arms(tmp_path)
    paths[1].write_text(URDF.format(upper="", fore=link_shape('<cone radius="1"/>')))
    found = crosscheck.diff(paths[1], paths[1], geometry=True)
    assert found.differences == ()
    assert ["cone" in note for note in found.comparison.first.notes] == [True]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["tracker", "four_bar"])
def test_converted_files_of_a_scene_have_the_same_shapes(name, tmp_path):
    """A URDF has no capsules: `crosscheck convert` writes cylinders, and the numbers with nine decimals."""
    scene, _ = load_scene(name, {})
    paths = [tmp_path / "model.xml", tmp_path / "model.urdf"]
    for path in paths:
        write_as(scene, path, scene_report(scene))
    assert mujoco.MjModel.from_xml_path(str(paths[0])).ngeom > 0
    assert crosscheck.diff(paths[0], paths[0], geometry=True).outcome is Outcome.SAME
    loops = {"loops": str(paths[1].with_suffix(".loops.yaml"))}
    found = crosscheck.diff(*paths, geometry=True, second_options=loops)
    row = only_row(found)
    assert (row.quantity, row.first, row.second) == (Q.KIND, "capsule", "cylinder")
    paths[0].write_text(paths[0].read_text().replace('type="capsule"', 'type="cylinder"'))
    assert crosscheck.diff(*paths, geometry=True, second_options=loops).differences == ()


def test_models_without_files_of_shapes_are_refused():
    with pytest.raises(CrosscheckError, match=r"shapes of .* cannot be compared"):
        crosscheck.diff("tracker", "tracker", geometry=True)


def test_models_of_mujoco_in_memory_have_shapes():
    first, second = (
        mujoco.MjModel.from_xml_string(ARM.format(**EMPTY | {"fore": box(size=size)}))
        for size in ("0.1 0.05 0.02", "0.1 0.05 0.03")
    )
    row = only_row(crosscheck.diff(first, second, geometry=True))
    assert (row.element, row.quantity) == ("fore", Q.SIZE)
