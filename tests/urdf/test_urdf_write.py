"""The URDF and its loop file: what they say, and that Pinocchio reads back the mechanism's numbers."""

from __future__ import annotations

import re
import subprocess
import sys
from importlib.resources import files
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
import pytest
import yaml
from mechanisms import REGULAR, all_universal_loop, planar_four_bar, seven_hinges, spinning_top

import urdf
from newton_euler.equations.system import MassProperties
from newton_euler.errors import NewtonEulerError
from newton_euler.model.joint_kinds import Revolute, Universal
from newton_euler.model.mechanism import Body, Mechanism
from newton_euler.model.scene import Scene
from newton_euler.model.spanning_tree import weld_loops
from urdf.dynamics import PinocchioSystem
from urdf.errors import LoopFileError, NameClashError, UrdfError
from urdf.loops import parse_loops
from urdf.model import build
from urdf.write import roll_pitch_yaw

NUMBER = re.compile(r"(-?\d+\.\d+(?:e[-+]?\d+)?)")


def scenes():
    return [pytest.param(build, id=build.__name__) for build in (*REGULAR, planar_four_bar)]


@pytest.mark.parametrize(
    ("name", "generate"), [("tracker.urdf", urdf.to_urdf), ("tracker.loops.yaml", urdf.to_loops)]
)
def test_checked_in_files_are_what_is_generated(tracker, name, generate):
    """Texts are the same; numbers to 1e-15, since products of matrices may round otherwise elsewhere."""
    stored = NUMBER.split(files("urdf").joinpath(name).read_text(encoding="utf-8"))
    generated = NUMBER.split(generate(tracker))
    assert generated[::2] == stored[::2]
    assert [float(x) for x in generated[1::2]] == pytest.approx(
        [float(x) for x in stored[1::2]], rel=1e-15, abs=1e-18
    )


def test_loop_file_of_a_ball_in_the_tree_and_of_a_loop_cut_at_a_hinge():
    top = yaml.safe_load(urdf.to_loops(spinning_top()))
    assert (top["joint_name"], top["joint_type"], top["closed_loop"]) == (
        ["tip"],
        ["SPHERICAL"],
        [],
    )
    hinges = yaml.safe_load(urdf.to_loops(seven_hinges()))
    assert hinges["type"] == ["6d"]
    assert hinges["closed_loop"] == [["hinge_3_weld_on_link_4", "hinge_3_weld_on_link_4_at_hinge_3"]]


@pytest.mark.parametrize("build_scene", scenes())
def test_urdf_is_a_tree_of_links_parallel_to_the_world(build_scene):
    scene = build_scene()
    robot = ElementTree.fromstring(urdf.to_urdf(scene))
    links = {link.get("name") for link in robot.findall("link")}
    children = [joint.find("child").get("link") for joint in robot.findall("joint")]
    assert len(children) == len(set(children))
    assert links - set(children) == {scene.mechanism.body_names[0]}
    origins = robot.findall("joint/origin") + robot.findall("link/inertial/origin")
    assert {origin.get("rpy") for origin in origins} == {"0 0 0"}
    massive = {link.get("name") for link in robot.findall("link") if link.find("inertial") is not None}
    assert massive == set(weld_loops(scene.mechanism).mechanism.body_names[1:])


@pytest.mark.parametrize("build_scene", scenes())
def test_pinocchio_reads_masses_centers_and_inertias(build_scene):
    """1e-15 of mass; 2e-15 of lengths of 1 m, and of the inertia about the frame's origin: numbers
    written with all digits, moved to the world and back, and halves of bodies added up."""
    scene = build_scene()
    stated, found = MassProperties.of(scene.mechanism), PinocchioSystem(scene).mass_properties()
    np.testing.assert_allclose(found.mass, stated.mass, rtol=1e-15)
    np.testing.assert_allclose(found.center_of_mass, stated.center_of_mass, rtol=0, atol=2e-15)
    np.testing.assert_allclose(found.inertia, stated.inertia, rtol=0, atol=2e-15)


def test_visuals_draw_every_shape_in_its_bodys_color(tracker):
    robot = ElementTree.fromstring(urdf.to_urdf(tracker))
    defined = {material.get("name") for material in robot.findall("material")}
    colors = set()
    for index, body in enumerate(tracker.mechanism.bodies):
        visuals = robot.findall(f"link[@name='{body.name}']/visual")
        assert len(visuals) == len(tracker.mechanism.shapes(index)) > 0
        names = {visual.find("material").get("name") for visual in visuals}
        assert len(names) == 1
        assert names <= defined
        colors |= names
    assert len(colors) == len(tracker.mechanism.bodies)


def test_visual_of_a_bar_lies_along_it(tracker):
    """Rounded to 1e-9 rad and m."""
    robot = ElementTree.fromstring(urdf.to_urdf(tracker))
    origin = robot.find("link[@name='leg_6']/visual/origin")
    (leg,) = tracker.mechanism.shapes(5)
    start = tracker.mechanism.joints[3].point
    turn = pin.rpy.rpyToMatrix(*map(float, origin.get("rpy").split()))
    along = (leg.end - leg.start) / np.linalg.norm(leg.end - leg.start)
    np.testing.assert_allclose(turn[:, 2], along, rtol=0, atol=2e-9)
    center = start + np.array([float(x) for x in origin.get("xyz").split()])
    np.testing.assert_allclose(center, 0.5 * (leg.start + leg.end), rtol=0, atol=1e-9)


@pytest.mark.parametrize("pitch", [0.3, 0.5 * np.pi, -0.5 * np.pi])
def test_roll_pitch_yaw_turns_back_into_the_rotation(pitch):
    """1e-12: at 90 degrees roll and yaw are one angle, told from a cosine below that."""
    matrix = pin.rpy.rpyToMatrix(0.7, pitch, -2.0)
    again = pin.rpy.rpyToMatrix(*roll_pitch_yaw(matrix))
    np.testing.assert_allclose(again, matrix, rtol=0, atol=1e-12)


def test_write_puts_both_files_side_by_side(tracker, tmp_path):
    urdf.write(tracker, tmp_path / "model.urdf")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["model.loops.yaml", "model.urdf"]
    assert (tmp_path / "model.urdf").read_text() == urdf.to_urdf(tracker)
    assert (tmp_path / "model.loops.yaml").read_text() == urdf.to_loops(tracker)


def test_a_path_that_cannot_be_written_is_named(tracker, tmp_path):
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(UrdfError, match=r"cannot write .*file/model\.urdf': ") as caught:
        urdf.write(tracker, tmp_path / "file" / "model.urdf")
    assert isinstance(caught.value, NewtonEulerError)


def test_names_of_motions_count_from_the_first_body_to_the_second():
    """As in the MJCF, whichever way round the tree has the joint."""
    robot = ElementTree.fromstring(urdf.to_urdf(all_universal_loop()))
    links = {joint.get("name"): joint.find("child").get("link") for joint in robot.findall("joint")}
    # at_b joins the coupler, its first body, to the crank; the tree goes from the crank to the coupler
    assert links["at_b_2"] == "at_b_2_link"
    assert links["at_b_1"] == "coupler"
    # at_d joins the ground to the rocker, and the tree too
    assert links["at_d_1"] == "at_d_1_link"
    assert links["at_d_2"] == "rocker"


def test_write_wants_the_suffix(tracker, tmp_path):
    with pytest.raises(UrdfError, match=r"model\.xml"):
        urdf.write(tracker, tmp_path / "model.xml")
    assert not list(tmp_path.iterdir())


def test_names_that_would_clash_are_refused():
    x, y, z = np.eye(3)
    unit = np.diag([1.0, 1.0, 1.0])
    joints = [
        Universal("u", "ground", "a", [0, 0, 0], axis_on_first=x, axis_on_second=y),
        Revolute("u_1", "a", "b", [1, 0, 0], axis=z),
    ]
    bodies = [Body.ground(), Body("a", 1.0, [0, 0, 0], unit), Body("b", 1.0, [1, 0, 0], unit)]
    with pytest.raises(NameClashError, match="'u_1'"):
        urdf.to_urdf(Scene("clash", Mechanism(bodies, joints), 1.0, 0.1))


def test_pinocchios_own_name_is_refused():
    joint = Revolute("universe", "ground", "a", [0, 0, 0], axis=[0, 0, 1])
    mechanism = Mechanism([Body.ground(), Body("a", 1.0, [0, 0, 0], np.eye(3))], [joint])
    with pytest.raises(UrdfError, match="'universe'"):
        PinocchioSystem(Scene("named", mechanism, 1.0, 0.1))


def test_import_does_not_load_pinocchio():
    code = "import sys, urdf; sys.exit('pinocchio' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


MISSING = object()

GOOD = {
    "closed_loop": [["ball_67_on_leg_6", "ball_67_on_panel_7"]],
    "type": ["3d"],
    "name_mot": ["slide_12"],
    "joint_name": ["hinge_26"],
    "joint_type": ["SPHERICAL"],
}


def load(tracker, document):
    return build(urdf.to_urdf(tracker), parse_loops(yaml.safe_dump(document), "some.loops.yaml"))


def test_good_loop_file_replaces_the_named_joint(tracker):
    model = load(tracker, GOOD).model
    assert model.joints[model.getJointId("hinge_26")].shortname() == "JointModelSpherical"
    assert (model.nq, model.nv) == (8 - 1 + 4, 8 - 1 + 3)


def test_joints_of_another_type_may_be_none(tracker):
    """As in the files of robot_delta and 5bar_linkage_iso6d of example-parallel-robots."""
    few = {key: GOOD[key] for key in ("closed_loop", "type", "name_mot")}
    model = load(tracker, few).model
    assert model.joints[model.getJointId("hinge_26")].nv == 1


@pytest.mark.parametrize(
    ("key", "value", "problem"),
    [
        *((key, MISSING, "missing") for key in GOOD),
        ("type", ["5d"], "unknown '5d'; choose from: 3d, 6d"),
        ("type", [], "0 entries for 1 of closed_loop"),
        ("type", "3d", "'3d' is not a list"),
        ("type", [["3d"]], "['3d'] is not a name"),
        ("joint_type", ["HELICAL"], "unknown 'HELICAL'; choose from: SPHERICAL"),
        ("foo", 3, "unknown key; choose from: closed_loop, type, name_mot, joint_name, joint_type, coupled"),
        ("joint_type", [], "0 entries for 1 of joint_name"),
        ("joint_name", ["hinge_99"], "the URDF has no moving joint 'hinge_99'"),
        ("name_mot", ["universe"], "the URDF has no moving joint 'universe'"),
        ("closed_loop", [["ball_67_on_leg_6", "nothing"]], "no link or joint 'nothing'"),
        ("closed_loop", [["ball_67_on_leg_6"]], "is not a pair of frame names"),
        ("closed_loop", None, "'null' is not a list"),
        ("coupled", [1], ""),
        ("coupled", [{}], ""),
        ("coupled", [["slide_12", 1.0]], ""),
        ("coupled", {"slide_12": 1.0}, ""),
        ("coupled", [{"slide_12": "fast"}], "'fast'"),
        ("coupled", [{"slide_12": True}], "true"),
        ("coupled", [{"slide_12": float("nan")}], ".nan"),
        ("coupled", [{"slide_12": 1e300}], "at most 1e+15 in magnitude"),
        ("coupled", [{"slide_12": 1.0, "axle": 2.0}], "the URDF has no moving joint 'axle'"),
    ],
)
def test_bad_entry_is_named_with_its_file_and_key(tracker, key, value, problem):
    document = {k: v for k, v in (GOOD | {key: value}).items() if v is not MISSING}
    with pytest.raises(LoopFileError) as caught:
        load(tracker, document)
    assert (caught.value.source, caught.value.key) == ("some.loops.yaml", key)
    assert problem in str(caught.value)


@pytest.mark.parametrize("text", ["[a, b", "- a\n- b\n", ""])
def test_text_that_is_no_loop_file(text):
    with pytest.raises(LoopFileError, match=r"some\.loops\.yaml: document"):
        parse_loops(text, "some.loops.yaml")


def test_text_that_is_no_urdf(tracker):
    with pytest.raises(UrdfError, match="not a URDF"):
        build("<robot/>", parse_loops(urdf.to_loops(tracker), "tracker.loops.yaml"))
