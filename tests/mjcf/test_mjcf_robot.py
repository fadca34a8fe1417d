"""Described bodies of MJCF files move and weigh as in plain MuJoCo."""

from __future__ import annotations

import math
import os
from pathlib import Path

import mujoco
import numpy as np
import pytest
from mjcf_models import ELEMENTS
from robot_dynamics import Pose, mass_matrix, pose

from mjcf.reading.xml_scan import SourceError
from mjcf.robot import describe
from newton_euler.model.source_file import SourceLine
from newton_euler.reading.robot import FilePlace, JointKind, LoopKind, PlaceKind, Robot, RobotFile

ROOT = Path(__file__).parents[2]
TEXTS = ELEMENTS | {
    "linkage": (ROOT / "examples/linkage.xml").read_text(),
    "tracker": (ROOT / "mjcf/tracker.xml").read_text(),
}
ROUND_OFF = 1e-9
"""Largest error relative to the largest entry: MuJoCo's principal axes are exact to 1e-12, times 1e3."""


def pose_of_data(robot: Robot, model: mujoco.MjModel, qpos: np.ndarray) -> Pose:
    """Place a robot at the coordinates of MuJoCo, whose joints are in the same order."""
    coordinates = {}
    joint = 0
    for number, body in enumerate(robot.bodies):
        for k, described in enumerate(body.joints):
            size = {JointKind.BALL: 4, JointKind.FREE: 7}.get(described.kind, 1)
            start = int(model.jnt_qposadr[joint])
            coordinates[number, k] = qpos[start : start + size]
            joint += 1
    return pose(robot, coordinates)


@pytest.mark.parametrize("text", TEXTS.values(), ids=TEXTS.keys())
def test_bodies_move_as_in_mujoco(text: str, tmp_path: Path) -> None:
    path = tmp_path / "model.xml"
    path.write_text(text)
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    robot = describe(path).robot
    random = np.random.default_rng(1)
    for _ in range(3):
        mujoco.mj_integratePos(model, data.qpos, random.normal(size=model.nv), 1.0)
        mujoco.mj_forward(model, data)
        at = pose_of_data(robot, model, data.qpos)
        for number, placed in enumerate(at.placements, start=1):
            assert placed.position == pytest.approx(data.xpos[number], abs=ROUND_OFF)
            assert placed.rotation.ravel() == pytest.approx(data.xmat[number], abs=ROUND_OFF)
        expected = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, data, expected)
        error = np.max(np.abs(mass_matrix(robot, at) - expected), initial=0.0)
        assert error <= ROUND_OFF * np.max(expected, initial=0.0)


ARM = """<mujoco model="arm"><compiler angle="degree" autolimits="true"/>
<option gravity="0 0 -1.62"/>
<default><joint damping="0.25" frictionloss="0.5"/></default>
<worldbody>
  <body name="upper" pos="0 0 1">
    <inertial pos="0.1 0 0" mass="2.5" fullinertia="0.02 0.03 0.04 0.001 0.002 0.003"/>
    <joint name="shoulder" axis="0 2 0" ref="30" range="-30 120" springref="10" stiffness="4" armature="0.125"
           actuatorfrcrange="-6 12"/>
    <body name="lower" pos="0.5 0 0"><inertial pos="0 0 0.1" mass="1" diaginertia="0.01 0.02 0.015"/>
      <joint name="elbow" axis="0 1 0" damping="0"/><site name="tip" pos="0.5 0 0"/></body></body>
  <body name="slider"><inertial pos="0 0 0" mass="0.5" diaginertia="0.01 0.01 0.01"/>
    <joint name="rail" type="slide" axis="0 0 1"/><joint name="turn" axis="0 0 1"/>
    <site name="end" pos="1 0 1"/></body>
</worldbody>
<tendon><fixed name="both"><joint joint="shoulder" coef="2"/><joint joint="elbow" coef="-3"/></fixed>
  <spatial name="line"><site site="tip"/><site site="end"/></spatial></tendon>
<equality>
  <connect name="pin" body1="lower" body2="slider" anchor="0.25 0 0.125"/>
  <weld name="glue" body1="slider" body2="lower" relpose="1 2 3 0 1 0 0" anchor="0.5 0.25 0"/>
  <joint name="cam" joint1="rail" joint2="turn" polycoef="0.5 0 0.25 0 0"/>
  <joint name="hold" joint1="turn" polycoef="0.125 0 0 0 0"/>
  <tendon name="geared" tendon1="both"/>
  <tendon name="rope" tendon1="line"/>
  <connect name="off" body1="upper" body2="slider" anchor="0 0 0" active="false"/>
</equality>
<actuator>
  <motor name="motor" joint="shoulder" gear="-50" ctrlrange="-1 2" forcerange="-0.5 0.5"/>
  <position name="servo" joint="elbow" kp="20" kv="2" inheritrange="0" ctrlrange="-1 1"/>
  <velocity name="speed" tendon="both" kv="3" gear="2"/>
  <general name="slow" joint="rail" dyntype="filter" dynprm="0.25" gainprm="7" biastype="affine"
           biasprm="1 -2 -3"/>
  <motor name="thruster" site="tip" gear="0 0 1 0 0 0.5"/>
</actuator></mujoco>"""


@pytest.fixture(scope="module")
def arm(tmp_path_factory: pytest.TempPathFactory) -> RobotFile:
    path = tmp_path_factory.mktemp("arm") / "arm.xml"
    path.write_text(ARM)
    return describe(path)


def test_joints_have_the_numbers_of_the_file(arm: RobotFile) -> None:
    """Angles of the file are in degrees; the axis is written with length 2."""
    shoulder, elbow = (arm.robot.bodies[k].joints[0] for k in (0, 1))
    assert shoulder.axis.tolist() == [0.0, 1.0, 0.0]
    assert shoulder.zero == pytest.approx(math.radians(30.0), rel=1e-15)
    assert shoulder.limits == pytest.approx((math.radians(-30.0), math.radians(120.0)), rel=1e-15)
    assert shoulder.rest == pytest.approx(math.radians(10.0), rel=1e-15)
    assert (shoulder.stiffness, shoulder.armature, shoulder.effort) == (4.0, 0.125, (-6.0, 12.0))
    assert (shoulder.damping, shoulder.friction, shoulder.speed) == (0.25, 0.5, math.inf)
    assert (elbow.damping, elbow.limits, elbow.effort) == (0.0, (-math.inf, math.inf), (-math.inf, math.inf))
    upper = arm.robot.bodies[0]
    full = [[0.02, 0.001, 0.002], [0.001, 0.03, 0.003], [0.002, 0.003, 0.04]]
    # MuJoCo stops its search for principal axes at an error of 1e-12
    assert upper.inertia == pytest.approx(np.array(full), abs=1e-12)
    assert arm.robot.gravity is not None
    assert arm.robot.gravity.tolist() == [0.0, 0.0, -1.62]
    assert [body.parent for body in arm.robot.bodies] == [-1, 0, -1]
    assert (arm.robot.name, arm.format) == ("arm", "MJCF")


def test_loops_have_the_frames_of_the_file(arm: RobotFile) -> None:
    pin, glue, rope = arm.robot.loops
    assert (pin.name, pin.kind, pin.first, pin.second) == ("pin", LoopKind.POINT, 1, 2)
    # in the pose of the file the frame of `lower` is at (0.5, 0, 1), that of `slider` at the origin
    assert pin.first_frame.position.tolist() == [0.25, 0.0, 0.125]
    assert pin.second_frame.position == pytest.approx([0.75, 0.0, 1.125], abs=1e-15)
    # the anchor of `lower` is at (1, 2, 3) of `slider`, and `lower` has half a turn about x in `slider`
    assert (glue.kind, glue.first, glue.second) == (LoopKind.WELD, 2, 1)
    assert glue.second_frame.position.tolist() == [0.5, 0.25, 0.0]
    assert glue.second_frame.rotation.tolist() == np.eye(3).tolist()
    assert glue.first_frame.position == pytest.approx([1.0, 2.0, 3.0], abs=1e-15)
    assert glue.first_frame.rotation == pytest.approx(np.diag([1.0, -1.0, -1.0]), abs=1e-15)
    # the tip is at (1, 0, 1), the end at (1, 0, 1) of a frame at the origin
    assert (rope.kind, rope.first, rope.second) == (LoopKind.ROD, 1, 2)
    assert rope.length == pytest.approx(0.0, abs=1e-15)
    assert "not described: equalities that are switched off (1)" in arm.notes


def test_loops_are_open_as_in_mujoco(arm: RobotFile) -> None:
    """Residuals of the first three rows of both loops: the distance of the points, in the world frame."""
    model = mujoco.MjModel.from_xml_string(ARM)
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_LIMIT
    data = mujoco.MjData(model)
    data.qpos = np.random.default_rng(2).normal(size=model.nq)
    mujoco.mj_forward(model, data)
    placements = pose_of_data(arm.robot, model, data.qpos).placements
    for number in (0, 1):
        loop = arm.robot.loops[number]
        first = placements[loop.first] @ loop.first_frame
        second = placements[loop.second] @ loop.second_frame
        rows = np.flatnonzero(
            (data.efc_id == number) & (data.efc_type == mujoco.mjtConstraint.mjCNSTR_EQUALITY)
        )
        assert first.position - second.position == pytest.approx(data.efc_pos[rows[:3]], abs=1e-14)


def test_couplings_have_the_polynomials_of_the_file(arm: RobotFile) -> None:
    found = {each.name: (each.follower, each.leader, each.powers) for each in arm.robot.couplings}
    assert found == {
        "cam": ("rail", "turn", (0.5, 0.0, 0.25)),
        "hold": ("turn", "", (0.125,)),
        # 2 shoulder - 3 elbow = 0
        "geared": ("shoulder", "elbow", (0.0, 1.5)),
    }


def test_drives_have_the_numbers_of_the_file(arm: RobotFile) -> None:
    motor, servo, speed, slow, thruster = arm.robot.drives
    assert (motor.name, dict(motor.gears), motor.gain) == ("motor", {"shoulder": -50.0}, 1.0)
    assert (motor.control_limits, motor.force_limits) == ((-1.0, 2.0), (-0.5, 0.5))
    assert (motor.stiffness, motor.damping, motor.constant, dict(motor.other)) == (0.0, 0.0, 0.0, {})
    assert (servo.gain, servo.stiffness, servo.damping) == (20.0, -20.0, -2.0)
    assert servo.force_limits == (-math.inf, math.inf)
    assert (dict(speed.gears), speed.gain, speed.damping) == ({"shoulder": 4.0, "elbow": -6.0}, 3.0, -3.0)
    assert (slow.gain, slow.constant, slow.stiffness, slow.damping) == (7.0, 1.0, -2.0, -3.0)
    assert (slow.other["dynamics"], slow.other["dynamics 1"]) == ("filter", 0.25)
    assert dict(thruster.gears) == {}
    other = dict(thruster.other)
    site = other.pop("site")
    assert other == {"transmission": "site", "gear 3": 1.0, "gear 6": 0.5}
    assert isinstance(site, FilePlace)
    assert (site.kind, arm.robot.bodies[site.body].name) == (PlaceKind.FRAME, "lower")
    # the site has the axes of its body
    np.testing.assert_array_equal(site.frame.position, (0.5, 0.0, 0.0))
    np.testing.assert_array_equal(site.frame.rotation, np.eye(3))


def test_lines_are_those_of_the_file(arm: RobotFile) -> None:
    lines = ARM.splitlines()
    for key, word in ((("body", "lower"), '<body name="lower"'), (("motor", "motor"), '<motor name="motor"')):
        assert word in lines[arm.lines[key].line - 1]


def test_defaults_includes_and_replicates_are_resolved(tmp_path: Path) -> None:
    """The included file is in a folder, includes another file, and a third file has keyframes only."""
    (tmp_path / "parts").mkdir()
    (tmp_path / "top.xml").write_text(
        '<mujoco><include file="parts/chain.xml"/><include file="parts/keys.xml"/></mujoco>'
    )
    (tmp_path / "parts/chain.xml").write_text(
        '<mujoco><worldbody><replicate count="3" offset="0.25 0 0"><body name="link">'
        '<include file="shapes.xml"/></body></replicate></worldbody></mujoco>'
    )
    (tmp_path / "parts/shapes.xml").write_text(
        '<mujoco>\n<joint name="j" axis="0 0 1"/><geom size="0.5" density="1"/></mujoco>'
    )
    (tmp_path / "parts/keys.xml").write_text('<mujoco><keyframe><key qpos="0 0 1"/></keyframe></mujoco>')
    described = describe(tmp_path / "top.xml")
    assert described.lines["joint", "j"] == SourceLine(os.path.realpath(tmp_path / "parts/shapes.xml"), 2)
    bodies = described.robot.bodies
    assert [body.name for body in bodies] == ["link0", "link1", "link2"]
    assert [body.placement.position[0] for body in bodies] == [0.0, 0.25, 0.5]
    assert [body.mass for body in bodies] == pytest.approx([math.pi / 6.0] * 3, rel=1e-14)


def test_meshes_are_loaded_only_for_masses(tmp_path: Path) -> None:
    """A corner of a cube of 1 m at 1000 kg/m^3; one of two bodies has an inertial instead."""
    (tmp_path / "corner.obj").write_text(
        "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n"
    )
    text = """<mujoco><asset><mesh name="a" file="corner.obj"/><mesh file="gone.obj"/></asset>
      <worldbody><body name="solid" pos="0.123 0 0"><joint/><geom type="mesh" mesh="a"/></body>
      <body name="listed"><joint/><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>
        <geom type="mesh" mesh="gone"/></body>{}</worldbody></mujoco>"""
    path = tmp_path / "model.xml"
    path.write_text(text.format(""))
    found = describe(path)
    assert [body.mass for body in found.robot.bodies] == pytest.approx([1000.0 / 6.0, 1.0], rel=1e-12)
    assert found.notes == ("meshes are loaded because they give masses to bodies: solid",)
    for variant in found.variants:
        assert variant.bodies[0].mass == found.robot.bodies[0].mass
        assert abs(variant.bodies[0].placement.position[0] - 0.123) == pytest.approx(5e-7, rel=1e-6)
    # a body whose mesh is missing
    path.write_text(text.format('<body name="lost"><joint/><geom type="mesh" mesh="gone"/></body>'))
    lost = describe(path)
    assert lost.missing_meshes == ("lost",)
    for each in lost.robots:
        assert each.bodies[2].mass == 0.0
        assert not np.any(each.bodies[2].inertia)
    assert lost.notes[1] == "masses count as 0 because meshes are missing, of bodies: lost"


DRAWN = """<mujoco><default><geom density="500"/><default class="drawn"><geom MASSLESS contype="0"/></default>
  </default><asset><mesh name="drawn" file="gone.obj"/></asset><worldbody><body name="trunk"><freejoint/>
  <geom class="drawn" type="mesh" mesh="drawn"/><geom type="box" size=".1 .2 .3"/></body>
  </worldbody></mujoco>"""


@pytest.mark.parametrize("massless", ['density="0"', 'mass="0"', 'density="7" mass="0.0"'])
def test_a_missing_mesh_without_mass_takes_none_from_its_body(tmp_path: Path, massless: str) -> None:
    """A box of 0.048 m^3 at 500 kg/m^3 is left."""
    path = tmp_path / "model.xml"
    path.write_text(DRAWN.replace("MASSLESS", massless))
    found = describe(path)
    assert found.robot.bodies[0].mass == pytest.approx(24.0, rel=1e-14)
    assert found.notes == ()
    # with a density of its own, or of the class above, the mesh counts
    path.write_text(DRAWN.replace("MASSLESS", "").replace('class="drawn" type', "type"))
    assert describe(path).notes == ("masses count as 0 because meshes are missing, of bodies: trunk",)


def test_a_missing_mesh_of_the_world_of_an_included_file_does_not_matter(tmp_path: Path) -> None:
    mesh = '<geom type="mesh" mesh="drawn"/>'
    text = DRAWN.replace("MASSLESS", "").replace('<geom class="drawn" type="mesh" mesh="drawn"/>', "")
    (tmp_path / "robot.xml").write_text(text.replace("<worldbody>", f"<worldbody>{mesh}"))
    path = tmp_path / "scene.xml"
    path.write_text('<mujoco><include file="robot.xml"/><worldbody><light/></worldbody></mujoco>')
    assert describe(path).robot.bodies[0].mass == pytest.approx(24.0, rel=1e-14)


def test_comments_with_two_hyphens_are_read_as_by_mujoco(tmp_path: Path) -> None:
    """XML forbids them, but MuJoCo does not, and public models have them; lines are those of the file."""
    path = tmp_path / "model.xml"
    path.write_text("<!-- arm -- of\n two -- links -->" + ARM)
    assert mujoco.MjSpec.from_file(str(path)).modelname == mujoco.MjSpec.from_string(ARM).modelname
    commented = describe(path)
    path.write_text("\n" + ARM)
    plain = describe(path)
    assert [body.mass for body in commented.robot.bodies] == [body.mass for body in plain.robot.bodies]
    assert commented.lines == plain.lines
    path.write_text(ARM + "<!-- no end")
    with pytest.raises(SourceError, match="unclosed token at '<!-- no end'"):
        describe(path)


def test_a_model_in_memory_is_described_without_variants() -> None:
    spec = mujoco.MjSpec.from_string(ARM)
    for source in (spec, mujoco.MjModel.from_xml_string(ARM)):
        found = describe(source)
        assert (found.variants, found.source, dict(found.lines)) == ((), "", {})
        assert [drive.name for drive in found.robot.drives] == ["motor", "servo", "speed", "slow", "thruster"]


def test_a_urdf_is_described_as_mujoco_reads_it(tmp_path: Path) -> None:
    """MuJoCo fixes the root link and merges links that fixed joints connect; a mesh is missing."""
    link = (
        '<link name="{0}"><inertial><origin xyz="0.1 0 0"/><mass value="{1}"/>'
        '<inertia ixx="0.5" ixy="0" ixz="0" iyy="0.5" iyz="0" izz="0.5"/></inertial>{2}</link>'
    )
    joint = '<joint name="{0}" type="{1}"><parent link="{2}"/><child link="{3}"/><axis xyz="0 0 1"/></joint>'
    mesh = '<{0}><geometry><mesh filename="package://gone/a.stl"/></geometry></{0}>'
    parts = [
        '<link name="base"/>',
        link.format("arm", 2, mesh.format("visual") + mesh.format("collision")),
        link.format("tool", 0.5, ""),
        joint.format("hinge", "continuous", "base", "arm"),
        joint.format("bolt", "fixed", "arm", "tool"),
    ]
    path = tmp_path / "arm.urdf"
    path.write_text(f'<robot name="arm">{"".join(parts)}</robot>')
    model = mujoco.MjModel.from_xml_string(
        path.read_text().replace(mesh.format("visual") + mesh.format("collision"), "")
    )
    found = describe(path)
    assert (found.format, len(found.variants)) == ("URDF", 16)
    (body,) = found.robot.bodies
    assert (body.name, body.mass, body.joints[0].name) == ("arm", 2.5, "hinge")
    assert body.center.tolist() == model.body_ipos[1].tolist()


def test_a_refused_file_raises(tmp_path: Path) -> None:
    path = tmp_path / "model.xml"
    path.write_text(ARM.replace('joint1="rail"', 'joint1="nowhere"'))
    with pytest.raises(SourceError, match="MuJoCo refuses it"):
        describe(path)
