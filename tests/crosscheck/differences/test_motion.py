"""Whether two described robots move alike: the same robot in other words, and planted changes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
from mujoco_robots import to_mujoco
from paired_robots import pairs_by_name
from test_dynamics import TREE

import crosscheck
from crosscheck.differences.alignment import align
from crosscheck.differences.common_states import PHASES, STATES, CommonStates, Phase, common_states
from crosscheck.differences.motion import Likeness, Motion, compare_motions
from crosscheck.differences.vectors import rotation_matrix
from mjcf.robot import describe
from newton_euler.reading.robot import FileBody, FileJoint, JointKind, Placement, Robot, RobotFile
from newton_euler.scalars import Array

PARALLELOGRAM = """
<mujoco><default><joint axis="0 1 0"/><geom type="capsule" size="0.008" density="2700"/></default>
  <worldbody>
    <body name="a"><joint name="ja"/><geom fromto="0 0 0 0 0 0.2"/>
      <body name="b" pos="0 0 0.2"><joint name="jb"/>
        <geom fromto="0 0 0 0.5 0 0"/></body></body>
    <body name="c" pos="0.5 0 0"><joint name="jc"/>
      <geom fromto="0 0 0 0 0 0.2"/></body>
  </worldbody><equality>EQUALITY</equality></mujoco>"""
LOOP = '<connect name="loop" body1="b" body2="c" anchor="0.5 0 0"/>'
COUPLINGS = """<joint name="one" joint1="jb" joint2="ja" polycoef="0 -1 0 0 0"/>
  <joint name="two" joint1="jc" joint2="ja" polycoef="0 FACTOR 0 0 0"/>"""

ARM = """
<mujoco><worldbody><body name="upper"><joint name="shoulder" axis="0 1 0"/>
    <geom type="capsule" fromto="0 0 0 .3 0 0" size=".02" mass="1"/>
  <body name="fore" pos=".3 0 0"><joint name="elbow" axis="0 1 0"/>
    <geom type="capsule" fromto="0 0 0 .2 0 0" size=".02" mass=".5"/></body></body></worldbody>
<actuator><motor name="m" joint="shoulder" gear="50"/>
  <position name="p" joint="elbow" kp="30" kv="2"/></actuator>
</mujoco>"""


def of_text(text: str) -> RobotFile:
    return describe(mujoco.MjModel.from_xml_string(text))


def compared(first: RobotFile, second: RobotFile, flipped: tuple[str, ...] = ()) -> Motion:
    return compare_motions(common_states(first, second, pairs_by_name(first.robot, second.robot, flipped)))


def in_other_frames(robot: Robot, seed: int, gear: int) -> Robot:
    """Return the same robot with other frames of its bodies, and the other sense of hinges and slides.

    Args:
        robot: the robot.
        seed: of the frames.
        gear: factor of the gears: -1 if controls keep their sense, 1 if they count as the joints do.
    """
    random = np.random.default_rng(seed)
    bodies: list[FileBody] = []
    frames: list[Placement] = []
    for body in robot.bodies:
        frame = Placement(0.1 * random.normal(size=3), rotation_matrix(random.normal(size=3)))
        frames.append(frame)
        back = frame.inverse()
        above = frames[body.parent].inverse() if body.parent >= 0 else Placement(np.zeros(3), np.eye(3))
        joints = tuple(
            replace(
                joint,
                axis=-back.rotation @ joint.axis,
                point=back.position + back.rotation @ joint.point,
                rest=-joint.rest,
                zero=-joint.zero,
            )
            for joint in body.joints
        )
        bodies.append(
            replace(
                body,
                placement=above @ body.placement @ frame,
                joints=joints,
                center=back.position + back.rotation @ body.center,
                inertia=back.rotation @ body.inertia @ back.rotation.T,
            )
        )
    loops = tuple(
        replace(
            loop,
            first_frame=frames[loop.first].inverse() @ loop.first_frame,
            second_frame=frames[loop.second].inverse() @ loop.second_frame,
        )
        for loop in robot.loops
    )
    drives = tuple(
        replace(drive, gears={k: gear * g for k, g in drive.gears.items()}) for drive in robot.drives
    )
    return replace(robot, bodies=tuple(bodies), loops=loops, drives=drives)


def test_round_off_of_a_balanced_wheel_is_no_difference() -> None:
    """Neither gravity nor rotation accelerates a wheel about its axis of inertia, whatever its mount is."""
    wheel = """<mujoco><worldbody><body name="mount" euler="{0}" pos="0.1 -0.2 0.3"><body name="wheel"
      euler="{1}"><joint name="turn"/><inertial pos="0 0 0" mass="0.3" diaginertia="1 1 1.5"/></body></body>
      </worldbody></mujoco>"""
    first = of_text(wheel.format("10 20 30", "40 -50 60"))
    found = compared(first, RobotFile(in_other_frames(first.robot, 0, 1), format="MJCF"))
    assert found.likeness is Likeness.EQUAL
    # round-off of accelerations, 1e-15 m/s^2, relative to `NO_ACCELERATION`
    assert found.change < 1e-8


def test_reversed_joints_without_limits_whose_gears_are_not_reversed_move_otherwise() -> None:
    first = of_text(TREE)
    second = RobotFile(in_other_frames(first.robot, 0, 1), format="MJCF")
    found = compared(first, second, ("a1", "a2", "l1"))
    assert (found.likeness, found.phase) == (Likeness.DIFFERENT, Phase.DRIVEN)


def test_frames_and_senses_do_not_change_the_motion() -> None:
    first = of_text(TREE)
    second = RobotFile(in_other_frames(first.robot, 0, -1), format="MJCF")
    found = compared(first, second, ("a1", "a2", "l1"))
    assert found.likeness is Likeness.EQUAL
    assert found.freedoms == (12, 12)
    # round-off of inertias about the world's origin, times the condition of the mass matrix
    assert found.change < 1e-11
    assert len(found.bodies) == 4


def test_change_is_that_of_mujoco() -> None:
    first = of_text(TREE)
    changed = of_text(TREE.replace('mass=".3"', 'mass=".33"'))
    found = compared(first, changed)
    assert found.likeness is Likeness.DIFFERENT
    states = CommonStates(first, changed, pairs_by_name(first.robot, changed.robot))
    accelerations = []
    for text in (TREE, TREE.replace('mass=".3"', 'mass=".33"')):
        model = mujoco.MjModel.from_xml_string(text)
        data = mujoco.MjData(model)
        rows = []
        for k, phase in enumerate(PHASES):
            data.qpos[:], data.qvel[:] = to_mujoco(
                model, first.robot, states.coordinates[0, k], states.velocities[0, k]
            )
            data.ctrl[:] = states.controls[0, k]
            driven = phase is Phase.DRIVEN
            model.opt.disableflags = 0 if driven else mujoco.mjtDisableBit.mjDSBL_ACTUATION
            mujoco.mj_forward(model, data)
            mujoco.mj_rnePostConstraint(model, data)
            rows.append([_of_mujoco(model, data, body) for body in range(1, model.nbody)])
        accelerations.append(np.array(rows).reshape(len(Phase), STATES, model.nbody - 1, 6))
    one, two = accelerations
    size = [np.sqrt(np.mean(np.sum(each**2, axis=-1), axis=1)) for each in (one, two, two - one)]
    expected = (size[2] / np.maximum(size[0], size[1])).max(axis=0)
    # differences of accelerations of 1 part in 1e3 to 1e1, with round-off of 1e-12
    assert [body.change for body in found.bodies] == pytest.approx(expected, rel=1e-7)


def _of_mujoco(model: mujoco.MjModel, data: mujoco.MjData, body: int) -> Array:
    """Return the acceleration of the center of mass, and the angular one times the radius of gyration."""
    found = np.zeros(6)
    mujoco.mj_objectAcceleration(model, data, mujoco.mjtObj.mjOBJ_BODY, body, found, 0)
    radius = np.sqrt(np.sum(model.body_inertia[body]) / 2 / (0.3 if body == 4 else model.body_mass[body]))
    return np.concatenate([found[3:] + model.opt.gravity, radius * found[:3]])


@pytest.mark.parametrize("order", [1, -1])
def test_loop_and_couplings_of_the_same_motion(order: int) -> None:
    """A parallelogram, closed by a loop or by two gears that keep its bars parallel."""
    files = [
        of_text(PARALLELOGRAM.replace("EQUALITY", text)) for text in (LOOP, COUPLINGS.replace("FACTOR", "1"))
    ]
    found = compared(*files[::order])
    assert found.likeness is Likeness.EQUAL
    assert found.freedoms == (1, 1)
    # round-off at states that are not singular
    assert found.change < 1e-12
    assert max(gap.error for gap in found.gaps) < 1e-12


def test_other_coupling_allows_other_poses() -> None:
    files = [
        of_text(PARALLELOGRAM.replace("EQUALITY", text)) for text in (LOOP, COUPLINGS.replace("FACTOR", "-1"))
    ]
    found = compared(*files)
    assert found.likeness is Likeness.DIFFERENT
    errors = {gap.constraint: gap.error for gap in found.gaps}
    assert errors["one"] < 1e-12
    # the bars turn by up to 0.6 rad; c is off by twice its angle
    assert 0.3 < errors["two"] < 1.3
    assert {gap.unit for gap in found.gaps} == {"rad"}


def test_a_loop_that_is_open_in_poses_of_the_first_file_leaves_as_many_motions(tmp_path: Path) -> None:
    """The whole loop turns with a body: its open points move apart, which is no constraint."""
    text = """<mujoco><worldbody><body><joint axis="1 0 0"/><geom size="0.1"/>
      <body name="crank" pos="0 0 0.2"><joint axis="0 1 0"/><geom size="0.05" pos="0 0 0.1"/>
        <body name="coupler" pos="0 0 0.2"><joint axis="0 1 0"/><geom size="0.05" pos="0.15 0 0"/></body>
      </body><body name="rocker" pos="0.3 0 0.1"><joint axis="0 1 0"/><geom size="0.05" pos="0 0 0.1"/></body>
    </body></worldbody>
    <equality><connect body1="coupler" body2="rocker" anchor="{} 0 0"/></equality></mujoco>"""
    paths = [tmp_path / "first.xml", tmp_path / "second.xml"]
    for path, anchor in zip(paths, ("0.3", "0.32"), strict=True):
        path.write_text(text.format(anchor))
    assert crosscheck.diff(*map(str, paths)).motion.freedoms == (2, 2)


def test_missing_loop_shows_as_freedoms() -> None:
    found = compared(
        of_text(PARALLELOGRAM.replace("EQUALITY", LOOP)), of_text(PARALLELOGRAM.replace("EQUALITY", ""))
    )
    assert found.freedoms == (1, 3)
    assert found.likeness is Likeness.DIFFERENT


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ('gear="50"', 'gear="-5"'),
        ('<motor name="m" joint="shoulder" gear="50"/>', ""),
        ('kp="30"', 'kp="20"'),
    ],
)
def test_drives(before: str, after: str) -> None:
    found = compared(of_text(ARM), of_text(ARM.replace(before, after)))
    assert found.likeness is Likeness.DIFFERENT
    assert found.phase is Phase.DRIVEN
    assert found.change > 0.1


@pytest.mark.parametrize(("limits", "is_meant"), [("-120 30", True), ("-30 120", False)])
def test_flipped_axis_of_a_driven_joint(limits: str, is_meant: bool) -> None:
    """If the limits are not mirrored, the drive pushes the other way."""
    text = ARM.replace('<joint name="shoulder"', '<joint name="shoulder" range="-30 120"')
    flipped = ARM.replace('"shoulder" axis="0 1 0"', f'"shoulder" axis="0 -1 0" range="{limits}"')
    found = compared(of_text(text), of_text(flipped), ("shoulder",))
    if is_meant:
        assert found.likeness is Likeness.EQUAL
    else:
        assert found.phase is Phase.DRIVEN
        assert found.change > 0.5
    without = [RobotFile(replace(of_text(each).robot, drives=()), format="MJCF") for each in (text, flipped)]
    assert compared(*without, ("shoulder",)).likeness is Likeness.EQUAL


def test_drives_do_not_act_if_one_format_has_none() -> None:
    first = of_text(ARM)
    second = RobotFile(replace(first.robot, drives=(), gravity=None), format="URDF")
    found = compared(first, second)
    assert found.likeness is Likeness.EQUAL
    assert found.notes == ("Drives do not act in the compared motions: one of the formats has none.",)


def test_branch_without_partner_is_left_out() -> None:
    """The leg and its drive are only in one file; the rest moves as if the other file had no leg."""
    leg = TREE[TREE.index('<body name="leg"') : TREE.index("</body></worldbody>")]
    servo = TREE[TREE.index("<position") : TREE.index("</actuator>")]
    first, second = of_text(TREE), of_text(TREE.replace(leg, "").replace(servo, ""))
    for files, which in (((first, second), "first"), ((second, first), "second")):
        found = compared(*files)
        assert found.likeness is Likeness.EQUAL
        assert found.notes == (f"Only in the {which} file, and left out: leg.",)


def test_free_base_is_held_where_the_fixed_one_is() -> None:
    text = (
        TREE.replace('<freejoint name="free"/>', "")
        .replace('euler="10 20 30"', 'euler="30 0 50"')
        .replace('pos="0 0.1 1"', "")
    )
    for files in ((TREE, text), (text, TREE)):
        found = compared(*(of_text(each) for each in files))
        assert found.likeness is Likeness.EQUAL
        assert found.notes == ("Both bases are held to compare: floating in one, fixed in the other.",)
        assert found.freedoms == (6, 6)


SHOULDER = """
<mujoco><worldbody><body name="chest" pos="0 0 1"><joint name="lift" type="slide" axis="0 0 1"/>
    <geom type="box" size=".1 .05 .2"/>
  <body name="upper" pos=".1 .2 0">JOINTS<geom type="capsule" fromto="0 0 0 .3 .05 0" size=".02"/>
  <body name="fore" pos=".3 0 0"><joint name="elbow" axis="0 1 0"/>
    <geom type="capsule" fromto="0 0 0 .2 0 0" size=".02"/></body></body></body></worldbody></mujoco>"""
BALL = '<joint name="ball" type="ball"/>'
HINGES = '<joint name="x" axis="1 0 0"/><joint name="y" axis="0 1 0"/><joint name="z" axis="0 0 1"/>'


@pytest.mark.parametrize("joints", [(BALL, HINGES), (HINGES, BALL)])
def test_ball_and_three_hinges(joints: tuple[str, str]) -> None:
    first, second = (of_text(SHOULDER.replace("JOINTS", each)) for each in joints)
    alignment = align(first.robot, second.robot, {})
    assert len(alignment.groups) == 1
    found = compare_motions(common_states(first, second, alignment))
    assert found.likeness is Likeness.EQUAL
    assert found.freedoms == (5, 5)


def test_joint_that_is_fixed_in_one_file_is_held() -> None:
    text = SHOULDER.replace("JOINTS", HINGES)
    fixed = text.replace('<joint name="elbow" axis="0 1 0"/>', "")
    for files, where in (((text, fixed), "first"), ((fixed, text), "second")):
        first, second = (of_text(each) for each in files)
        found = compare_motions(common_states(first, second, align(first.robot, second.robot, {})))
        assert found.likeness is Likeness.EQUAL
        assert found.notes == (f"Only in the {where} file, and held: elbow.",)


FOUR_BAR = """
<mujoco><default><joint axis="0 1 0"/><geom type="capsule" size="0.01"/></default><worldbody>
  <body name="a"><joint name="ja"/><geom fromto="0 0 0 0.05 0 0.2"/>
    <body name="b" pos="0.05 0 0.2"><joint name="jb"/><geom fromto="0 0 0 0.5 0 0.1"/>INNER</body></body>
  OUTER</worldbody><equality>LOOP</equality></mujoco>"""


def test_loop_is_cut_at_another_joint() -> None:
    """The third bar hangs on the ground in one file, and on the second bar in the other."""
    on_ground = """<body name="c" pos="0.5 0 0"><joint name="jc"/><geom fromto="0 0 0 0.05 0 0.3"/></body>"""
    on_bar = (
        """<body name="c" pos="0.5 0 0.1"><joint name="jbc"/><geom fromto="0 0 0 -0.05 0 -0.3"/></body>"""
    )
    loops = (
        '<connect body1="b" body2="c" anchor="0.5 0 0.1"/>',
        '<connect body1="c" body2="world" anchor="-0.05 0 -0.3"/>',
    )
    texts = (
        FOUR_BAR.replace("INNER", "").replace("OUTER", on_ground).replace("LOOP", loops[0]),
        FOUR_BAR.replace("INNER", on_bar).replace("OUTER", "").replace("LOOP", loops[1]),
    )
    for order in (1, -1):
        first, second = (of_text(text) for text in texts[::order])
        found = compare_motions(common_states(first, second, align(first.robot, second.robot, {})))
        assert found.likeness is Likeness.EQUAL
        assert found.freedoms == (1, 1)


def pendulum(mass: float, armature: float = 0.05) -> Robot:
    """Describe a point mass on a rod of 0.5 m, whose drive has a rotor."""
    hinge = FileJoint("hinge", JointKind.HINGE, np.array([0.0, 1.0, 0.0]), np.zeros(3), armature=armature)
    place = Placement(np.zeros(3), np.eye(3))
    body = FileBody("rod", -1, place, (hinge,), mass, np.array([0.5, 0.0, 0.0]), np.zeros((3, 3)))
    return Robot("pendulum", (body,), gravity=np.array([0.0, 0.0, -9.81]))


def test_heavier_pendulum_by_hand() -> None:
    """At rest the angular acceleration is m g l cos(angle) / (m l^2 + armature)."""
    found = compared(RobotFile(pendulum(1.0)), RobotFile(pendulum(1.1)))
    one, two = (mass * 0.5 / (mass * 0.25 + 0.05) for mass in (1.0, 1.1))
    assert found.phase is Phase.REST
    assert found.change == pytest.approx((two - one) / two, rel=1e-12)


def test_digits_explain_small_changes() -> None:
    """A mass of 1.1 kg is written as 1.1 with two digits in a file of variants 1.05 and 1.15."""
    first = RobotFile(pendulum(1.0), variants=(pendulum(1.05), pendulum(0.95)))
    near, far = (compared(first, RobotFile(pendulum(mass))) for mass in (1.08, 1.5))
    assert near.likeness is Likeness.ROUNDING
    assert near.change < near.uncertainty
    assert far.likeness is Likeness.DIFFERENT


def test_robots_without_common_joints() -> None:
    first, second = RobotFile(pendulum(1.0)), RobotFile(replace(pendulum(1.0), bodies=()))
    nothing = replace(pairs_by_name(first.robot, first.robot), bodies=(), joints=())
    assert compare_motions(common_states(first, second, nothing)).likeness is Likeness.UNDECIDED
