"""Described links of URDF files and Pinocchio models move and weigh as in plain Pinocchio."""

from __future__ import annotations

import math
import re
import tempfile
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pinocchio as pin
import pytest
from robot_dynamics import Pose, mass_matrix, pose
from urdf_files import CHAIN, LOOPS, TIPS, joint, link, robot

from mjcf.robot import describe as describe_by_mujoco
from newton_euler.errors import UnknownNameError
from newton_euler.reading.robot import JointKind, LoopKind, Robot, RobotFile
from newton_euler.scalars import Array
from urdf.errors import LoopFileError
from urdf.reading.source import SourceError
from urdf.robot import describe

ROOT = Path(__file__).parents[2]
TEXTS = {
    "chain": CHAIN,
    "tips": robot(*TIPS),
    "tracker": (ROOT / "urdf/tracker.urdf").read_text(),
}
CAMERA = '<gazebo reference="{0}"><sensor:camera name="rgb"><fov>1</fov></sensor:camera></gazebo></robot>'
ROUND_OFF = 1e-12
"""Largest error relative to the largest entry: both sum the same numbers, in another order."""


def compound_model() -> Any:
    """Joints of Pinocchio with several coordinates, one after the other, and a body fixed to the last one."""
    model = pin.Model()
    random = np.random.default_rng(5)
    kinds = (
        pin.JointModelFreeFlyer(), pin.JointModelPlanar(), pin.JointModelTranslation(),
        pin.JointModelUniversal(np.array([0.6, 0.8, 0.0]), np.array([0.0, 0.0, 1.0])),
        pin.JointModelSphericalZYX(), pin.JointModelRUBY(), pin.JointModelSpherical(),
        pin.JointModelPrismaticUnaligned(np.array([0.0, 0.6, 0.8])),
    )  # fmt: skip
    parent = 0
    for number, kind in enumerate(kinds):
        placement = pin.SE3(pin.exp3(random.normal(size=3)), random.normal(size=3))
        parent = model.addJoint(parent, kind, placement if number else pin.SE3.Identity(), f"j{number}")
        inertia = pin.Inertia(1.5 + number, random.normal(size=3), np.diag([1.0, 1.5, 2.0]))
        model.appendBodyToJoint(parent, inertia, pin.SE3.Identity())
        model.addJointFrame(parent)
        model.addBodyFrame(f"b{number}", parent, pin.SE3.Identity(), -1)
    model.armature = random.uniform(size=model.nv)
    return model


def from_mjcf() -> Any:
    """A body with a slide and a hinge at other points, which Pinocchio makes one joint of."""
    text = """<mujoco><worldbody><body name="base" pos="0 0 1"><joint name="x" type="slide" axis="1 0 0"/>
      <joint name="turn" axis="0 1 0" pos="0.1 0 0.2" range="-1 2" limited="true"/>
      <inertial pos="0.1 0.2 0.3" mass="2" fullinertia="0.3 0.4 0.5 0.01 0.02 0.03"/>
      <body name="arm" pos="0.5 0 0"><joint name="elbow" axis="0 0 1" pos="0 0.3 0"/>
      <inertial pos="0.1 0 0" mass="1" diaginertia="0.1 0.2 0.15"/></body></body></worldbody></mujoco>"""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "model.xml"
        path.write_text(text)
        return pin.buildModelFromMJCF(str(path))


MODELS = {
    **{name: lambda text=text: pin.buildModelFromXML(text) for name, text in TEXTS.items()},
    "floating": lambda: pin.buildModelFromXML(CHAIN, pin.JointModelFreeFlyer()),
    "compound": compound_model,
    "MJCF": from_mjcf,
}


def coordinates(model: Any, described: Robot, q: Array) -> tuple[Pose, list[int]]:
    """Return a robot at Pinocchio's configuration, and Pinocchio's index of each column of its velocities."""
    names = {str(name): number for number, name in enumerate(model.names)}
    values, columns = {}, []
    for number, body in enumerate(described.bodies):
        for k, motion in enumerate(body.joints):
            is_part = motion.name not in names
            found = model.joints[names[motion.name.rpartition("_")[0] if is_part else motion.name]]
            x = q[found.idx_q : found.idx_q + found.nq]
            if motion.kind in (JointKind.BALL, JointKind.FREE):
                values[number, k] = np.concatenate(
                    [x[:-4], np.roll(x[-4:], 1)]
                )  # (x, y, z, w) to (w, x, y, z)
                columns += range(found.idx_v, found.idx_v + found.nv)
                continue
            if found.nq == found.nv + 1:  # the last angle has cosine and sine
                x = np.append(x[:-2], np.arctan2(x[-1], x[-2]))
            values[number, k] = x[k : k + 1]
            columns.append(found.idx_v + k)
    return pose(described, values), columns


def check_motion(model: Any, described: Robot) -> None:
    """Compare the placements of all bodies and the mass matrix with Pinocchio's at random configurations."""
    data = model.createData()
    random = np.random.default_rng(1)
    for _ in range(3):
        q = pin.integrate(model, pin.neutral(model), random.normal(size=model.nv))
        at, columns = coordinates(model, described, q)
        pin.framesForwardKinematics(model, data, q)
        for body, placed in zip(described.bodies, at.placements, strict=True):
            frame = data.oMf[model.getFrameId(body.name, pin.FrameType.BODY)]
            assert placed.position == pytest.approx(frame.translation, abs=ROUND_OFF)
            assert placed.rotation == pytest.approx(frame.rotation, abs=ROUND_OFF)
        upper = np.triu(pin.crba(model, data, q))
        expected = (upper + np.triu(upper, 1).T)[np.ix_(columns, columns)]
        armatures = np.array([column.armature for column in at.columns])
        found = mass_matrix(described, at) - np.diag(armatures)
        # the linear velocity of these joints is in the moving frame in Pinocchio
        change = np.eye(len(columns))
        for each in list(model.joints)[1:]:
            first = columns.index(each.idx_v)
            rows = slice(first, first + 3)
            if each.shortname() == "JointModelFreeFlyer":
                change[rows, rows] = at.placements[0].rotation
            elif each.shortname() == "JointModelPlanar":
                cosine, sine = q[each.idx_q + 2 : each.idx_q + 4]
                change[rows, rows] = [[cosine, -sine, 0], [sine, cosine, 0], [0, 0, 1]]
        found = change.T @ found @ change + np.diag(model.armature[columns])
        assert found == pytest.approx(expected, abs=ROUND_OFF * np.max(np.abs(expected)))


@pytest.mark.parametrize("text", TEXTS.values(), ids=TEXTS.keys())
def test_links_move_as_in_pinocchio(text: str, tmp_path: Path) -> None:
    path = tmp_path / "model.urdf"
    path.write_text(text)
    check_motion(pin.buildModelFromXML(text), describe(path).robot)


def test_a_free_base_moves_as_in_pinocchio(tmp_path: Path) -> None:
    path = tmp_path / "model.urdf"
    path.write_text(CHAIN)
    found = describe(path, base="free")
    check_motion(pin.buildModelFromXML(CHAIN, pin.JointModelFreeFlyer()), found.robot)
    assert len(found.variants) == len(describe(path).variants)
    assert all(variant.bodies[0].joints[0].kind is JointKind.FREE for variant in found.variants)


def test_an_axis_without_direction_raises(tmp_path: Path) -> None:
    path = tmp_path / "model.urdf"
    path.write_text(re.sub(r'<axis xyz="[^"]*"', '<axis xyz="0 0 0"', CHAIN, count=1))
    with pytest.raises(SourceError, match=r"axis is 0 0 0; needed: a direction"):
        describe(path)


def test_an_unknown_base_raises(tmp_path: Path) -> None:
    path = tmp_path / "model.urdf"
    path.write_text(CHAIN)
    with pytest.raises(UnknownNameError, match=r"unknown base 'loose'; choose from: fixed, free"):
        describe(path, base="loose")  # type: ignore[arg-type]


@pytest.mark.parametrize("make", MODELS.values(), ids=MODELS.keys())
def test_models_in_memory_are_described(make: Any) -> None:
    model = make()
    found = describe(model)
    check_motion(model, found.robot)
    assert (found.variants, found.source, found.format) == ((), "", "Pinocchio")
    assert found.robot.gravity == pytest.approx([0.0, 0.0, -9.81])


def test_a_ball_with_other_damping_about_each_axis_is_noted() -> None:
    model = pin.Model()
    model.addJoint(0, pin.JointModelSpherical(), pin.SE3.Identity(), "ball")
    model.damping = np.array([0.1, 0.1, 0.1])
    assert describe(model).notes == ()
    model.damping = np.array([0.1, 0.1, 0.3])
    (note,) = describe(model).notes
    assert "damping" in note
    assert "'ball'" in note


def test_a_model_in_memory_has_the_numbers_of_the_file() -> None:
    """Links keep their own masses, although Pinocchio adds that of `c` to the one of `b`."""
    bodies = {body.name: body for body in describe(pin.buildModelFromXML(CHAIN)).robot.bodies}
    assert {name: body.mass for name, body in bodies.items()} == pytest.approx(
        {"base": 0.0, "a": 1.0, "b": 2.0, "c": 0.5, "d": 0.3}, rel=1e-14
    )
    first, slide = bodies["a"].joints[0], bodies["b"].joints[0]
    assert (first.damping, first.friction) == (0.5, 0.1)
    assert (first.limits, first.effort, first.speed) == ((-1.0, 1.0), (-9.0, 9.0), 9.0)
    assert slide.kind == JointKind.SLIDE
    assert bodies["d"].joints[0].limits == (-math.inf, math.inf)
    compound = compound_model()
    motions = {motion.name: motion for body in describe(compound).robot.bodies for motion in body.joints}
    assert [motions[f"j1_{k + 1}"].armature for k in range(3)] == compound.armature[6:9].tolist()


def test_constraints_in_memory_are_loops() -> None:
    model = pin.buildModelFromXML(robot(*TIPS))
    tips = [model.frames[model.getFrameId(name, pin.FrameType.BODY)] for name in ("tip_a", "tip_b")]
    ends = [(tip.parentJoint, tip.placement) for tip in tips]
    constraint = pin.RigidConstraintModel(
        pin.ContactType.CONTACT_3D, model, *ends[0], *ends[1], pin.ReferenceFrame.LOCAL
    )
    constraint.name = "pin"
    found = describe((model, [constraint])).robot
    (loop,) = found.loops
    assert (loop.name, loop.kind) == ("pin", LoopKind.POINT)
    assert [found.bodies[k].name for k in (loop.first, loop.second)] == ["a", "b"]
    assert loop.first_frame.position == pytest.approx(np.array([0.3, 0.0, 0.4]), abs=1e-15)


def test_an_unknown_source_raises() -> None:
    with pytest.raises(SourceError, match="needed: a path of a file"):
        describe(5)  # type: ignore[arg-type]


def described(folder: Path, text: str, loops: str = "") -> RobotFile:
    """Describe files of these texts."""
    (folder / "robot.urdf").write_text(text)
    if not loops:
        return describe(folder / "robot.urdf")
    (folder / "robot.yaml").write_text(loops)
    return describe(folder / "robot.urdf", folder / "robot.yaml")


@pytest.mark.parametrize("axis", ["1 0 0", "0 2 0", "0 0 -1", "0.2 1 0.1"])
def test_a_planar_joint_moves_in_the_plane_across_its_axis_as_in_mujoco(axis: str, tmp_path: Path) -> None:
    """The format defines the axis as the normal of the plane; Pinocchio's planar joints are across z."""
    planar = joint("glides", "planar", "base", "a", '<dynamics damping="0.5" friction="0.25"/>')
    text = robot(link("a"), planar.replace("0.2 1 0.1", axis))
    x, y, turn = described(tmp_path, text).robot.bodies[1].joints
    model = mujoco.MjModel.from_xml_string(text)
    # MuJoCo keeps the three motions of the joint in the same order; its axes have round-off of a turn
    ours = np.array([x.axis, y.axis, turn.axis])
    assert ours @ ours.T == pytest.approx(np.eye(3), abs=1e-14)
    assert ours[2] == pytest.approx(model.jnt_axis[2], abs=1e-14)
    assert np.linalg.det(ours) == pytest.approx(np.linalg.det(model.jnt_axis), abs=1e-14)
    assert [each.kind for each in (x, y, turn)] == [JointKind.SLIDE, JointKind.SLIDE, JointKind.HINGE]
    assert [each.damping for each in (x, y, turn)] == model.dof_damping.tolist() == [0.5] * 3
    assert [each.friction for each in (x, y, turn)] == model.dof_frictionloss.tolist() == [0.25] * 3
    assert model.jnt_limited.tolist() == [1, 0, 0]
    assert x.limits == tuple(model.jnt_range[0].tolist())
    assert (x.effort[1], y.effort[1], turn.effort[1]) == (9.0, math.inf, math.inf)
    assert y.limits == turn.limits == (-math.inf, math.inf)


def test_joints_have_the_numbers_of_the_file(tmp_path: Path) -> None:
    found = described(
        tmp_path,
        CHAIN.replace('effort="9" velocity="9"', 'effort="7" velocity="3"', 1).replace(
            "</robot>",
            '<joint name="fourth" type="continuous"><parent link="d"/><child link="e"/>'
            '<dynamics damping="0.5" spring_stiffness="2" spring_reference="0.25" armature="0.125"/>'
            '<mimic joint="first" multiplier="-2" offset="0.5"/></joint><link name="e"/></robot>',
        ),
    )
    joints = {joint.name: joint for body in found.robot.bodies for joint in body.joints}
    first, third, fourth = joints["first"], joints["third"], joints["fourth"]
    assert (first.damping, first.friction, first.limits) == (0.5, 0.1, (-1.0, 1.0))
    assert (first.effort, first.speed, joints["second"].effort) == ((-7.0, 7.0), 3.0, (-9.0, 9.0))
    # limits of a continuous joint do not count, but those of effort and speed do
    assert (third.limits, third.effort) == ((-math.inf, math.inf), (-9.0, 9.0))
    assert (fourth.stiffness, fourth.rest, fourth.armature, fourth.damping) == (2.0, 0.25, 0.125, 0.5)
    assert (fourth.effort[1], fourth.axis.tolist()) == (math.inf, [1.0, 0.0, 0.0])
    (coupling,) = found.robot.couplings
    assert (coupling.follower, coupling.leader, coupling.powers) == ("fourth", "first", (0.5, -2.0))
    assert found.robot.gravity is None
    assert [body.name for body in found.robot.bodies] == ["base", "a", "b", "c", "d", "e"]


def test_joints_that_mimic_a_fixed_joint_are_held(tmp_path: Path) -> None:
    text = CHAIN.replace('name="first" type="revolute"', 'name="first" type="fixed"').replace(
        "</robot>",
        '<joint name="fourth" type="continuous"><parent link="d"/><child link="e"/>'
        '<mimic joint="first" multiplier="-2" offset="0.5"/></joint><link name="e"/></robot>',
    )
    assert 'type="fixed"' in text
    (coupling,) = described(tmp_path, text).robot.couplings
    assert (coupling.follower, coupling.leader, coupling.powers) == ("fourth", "", (0.5,))


def test_loop_files_are_described(tmp_path: Path) -> None:
    text = robot(
        *TIPS, link("c"), joint("jc", "revolute", "base", "c"), link("e"), joint("je", "fixed", "c", "e")
    )
    loops = (
        "closed_loop: [[tip_a, tip_b], [jc, ta], [c, a]]\ntype: [6d, 3D, rod]\nname_mot: []\n"
        "joint_name: [jb, jc]\njoint_type: [SPHERICAL, UJOINT_XZ]\ncoupled: [{ja: 2, jc: [0, 3]}, {ja: 1}]\n"
    )
    found = described(
        tmp_path, text, loops.replace("jc: [0, 3]", "je: [0, 3]").replace("[jc, ta]", "[je, ta]")
    )
    bodies = {body.name: body for body in found.robot.bodies}
    weld, point, rod = found.robot.loops
    names = [body.name for body in found.robot.bodies]
    assert [(each.kind, names[each.first], names[each.second]) for each in (weld, point, rod)] == [
        (LoopKind.WELD, "tip_a", "tip_b"),
        (LoopKind.POINT, "e", "tip_a"),
        (LoopKind.ROD, "c", "a"),
    ]
    # `c` is at (0.3, 0.1, 0), `a` at the origin
    assert rod.length == pytest.approx(math.hypot(0.3, 0.1), rel=1e-15)
    assert [motion.kind for motion in bodies["b"].joints] == [JointKind.BALL]
    assert [(motion.name, motion.axis.tolist()) for motion in bodies["c"].joints] == [
        ("jc_X", [1.0, 0.0, 0.0]),
        ("jc_Z", [0.0, 0.0, 1.0]),
    ]
    # 2 ja + 3 je^2 = 0
    (coupling,) = found.robot.couplings
    assert (coupling.follower, coupling.leader, coupling.powers) == ("ja", "je", (0.0, 0.0, -1.5))
    assert found.notes == ("coupling of joints ja is not described",)
    with pytest.raises(LoopFileError, match="nowhere"):
        described(tmp_path, text, LOOPS.format(pairs="[[tip_a, nowhere]]", types="[3d]", motors="[]"))


def test_loops_of_gazebo_are_described(tmp_path: Path) -> None:
    """The axis of the hinge is y of the joint, whose frame is that of `tip_b` moved by 0.125 along z."""
    text = robot(*TIPS).replace(
        "</robot>",
        '<gazebo><joint name="close" type="revolute"><parent>tip_a</parent><child>tip_b</child>'
        "<pose>0 0 0.125 0 0 0</pose><axis><xyz>0 1 0</xyz></axis></joint></gazebo></robot>",
    )
    found = described(tmp_path, text)
    (loop,) = found.robot.loops
    placements = found.robot.placements()
    assert (loop.name, loop.kind) == ("close", LoopKind.HINGE)
    assert found.robot.bodies[loop.second].name == "tip_b"
    assert loop.second_frame.position.tolist() == [0.0, 0.0, 0.125]
    assert loop.second_frame.rotation[:, 0] == pytest.approx([0.0, 1.0, 0.0], abs=1e-15)
    # both ends coincide in the pose of the file
    first, second = placements[loop.first] @ loop.first_frame, placements[loop.second] @ loop.second_frame
    assert first.position == pytest.approx(second.position, abs=1e-14)
    assert first.rotation == pytest.approx(second.rotation, abs=1e-14)


def test_elements_that_may_act_become_notes(tmp_path: Path) -> None:
    found = described(tmp_path, CHAIN.replace("</robot>", '<constraint name="odd"/></robot>'))
    assert "<constraint> 'odd' is unknown, and may close a loop" in found.notes[0]


def test_a_loop_file_beside_the_file_that_is_not_read_is_a_note(tmp_path: Path) -> None:
    path, loops = tmp_path / "arm.urdf", tmp_path / "arm.loops.yaml"
    path.write_text(robot(*TIPS))
    loops.write_text(LOOPS.format(pairs="[[tip_a, tip_b]]", types="[3d]", motors="[]"))
    (note,) = describe(path).notes
    assert str(loops) in note
    assert describe(path, loops).notes == ()


def test_uncertainties_by_hand(tmp_path: Path) -> None:
    """The inertia about the hinge is m c^2 + Izz, where Izz = 1 is exact, and m and c change by 0.5e-6."""
    file = described(
        tmp_path,
        '<robot name="rod"><link name="base"/><link name="rod"><inertial><origin xyz="0.75 0 0"/>'
        '<mass value="0.123"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link>'
        '<joint name="hinge" type="revolute"><parent link="base"/><child link="rod"/><axis xyz="0 0 1"/>'
        '<origin xyz="0 0.250 0" rpy="0 0 0.5"/><limit lower="-1.5" upper="2" effort="3.25" velocity="1"/>'
        "</joint></robot>",
    )
    half = 0.5e-6
    at = {(1, 0): np.zeros(1)}
    written = mass_matrix(file.robot, pose(file.robot, at))[0, 0]
    variants = [mass_matrix(variant, pose(variant, at))[0, 0] for variant in file.variants]
    assert len(variants) == 16
    expected = (0.75**2 + 2.0 * 0.123 * 0.75) * half
    assert np.max(np.abs(np.subtract(variants, written))) == pytest.approx(expected, rel=1e-5)
    for variant in file.variants:
        rod = variant.bodies[1]
        assert abs(rod.placement.position[1] - 0.25) == pytest.approx(half, rel=1e-9)
        yaw = math.atan2(rod.placement.rotation[1, 0], rod.placement.rotation[0, 0])
        assert abs(yaw - 0.5) == pytest.approx(half, rel=1e-9)
        # numbers from 1 to 10 have a sixth significant digit of 1e-5; whole numbers are exact
        low, high = rod.joints[0].limits
        assert (abs(low + 1.5), high) == (pytest.approx(0.5e-5, rel=1e-9), 2.0)
        assert abs(rod.joints[0].effort[1] - 3.25) == pytest.approx(0.5e-5, rel=1e-9)
        assert rod.joints[0].speed == 1.0


def test_loops_of_gazebo_have_uncertainties(tmp_path: Path) -> None:
    """The point of the loop is a text between tags."""
    text = robot(*TIPS).replace(
        "</robot>",
        '<gazebo><joint name="close" type="ball"><parent>tip_a</parent><child>tip_b</child>'
        "<pose>0 0 0.123 0 0 0</pose></joint></gazebo></robot>",
    )
    for variant in described(tmp_path, text).variants:
        (loop,) = variant.loops
        assert abs(loop.second_frame.position[2] - 0.123) == pytest.approx(0.5e-6, rel=1e-9)


def test_a_prefix_without_namespace_is_read_as_by_pinocchio(tmp_path: Path) -> None:
    """Files for early versions of Gazebo have `<sensor:camera>`; comments may have two hyphens."""
    plain, prefixed = tmp_path / "plain.urdf", tmp_path / "prefixed.urdf"
    plain.write_text(CHAIN)
    name = describe(plain).robot.bodies[0].name
    prefixed.write_text(CHAIN.replace("</robot>", f"<!-- a -- b -->{CAMERA.format(name)}"))
    assert pin.buildModelFromUrdf(str(prefixed)).nv == pin.buildModelFromUrdf(str(plain)).nv
    bodies = [describe(each).robot.bodies for each in (plain, prefixed)]
    assert [body.mass for body in bodies[1]] == [body.mass for body in bodies[0]]
    # MuJoCo's importer
    of_mujoco = [describe_by_mujoco(each).robot.bodies for each in (plain, prefixed)]
    assert [body.mass for body in of_mujoco[1]] == [body.mass for body in of_mujoco[0]]


@pytest.mark.parametrize("holder", ["actuator", "joint"])
def test_rotors_of_drake_are_described(holder: str, tmp_path: Path) -> None:
    rotor = '<drake:rotor_inertia value="2e-5"/><drake:gear_ratio value="50"/>'
    in_actuator = (
        f'<transmission name="t"><joint name="j"/><actuator name="m">{rotor}</actuator></transmission>'
    )
    text = (
        '<robot name="r" xmlns:drake="http://drake.mit.edu"><link name="world"/>'
        '<link name="a"><inertial><mass value="1"/>'
        '<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>'
        '<joint name="j" type="continuous"><parent link="world"/><child link="a"/>'
        f"{rotor if holder == 'joint' else ''}</joint>{in_actuator if holder == 'actuator' else ''}</robot>"
    )
    path = tmp_path / "rotor.urdf"
    path.write_text(text)
    (motion,) = describe(path).robot.bodies[1].joints
    assert motion.armature == pytest.approx(0.05)
