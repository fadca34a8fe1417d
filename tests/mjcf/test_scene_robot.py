"""Described scenes move and weigh as the MJCF that a scene is exported to, in plain MuJoCo."""

from __future__ import annotations

import math
from dataclasses import replace

import elements
import mujoco
import numpy as np
import pytest
from mechanisms import bolted, pendulum, seven_hinges
from robot_dynamics import mass_matrix, pose

import mjcf
from crosscheck.library import load
from newton_euler.model.armatures import Armature
from newton_euler.model.control import PD
from newton_euler.model.forces import JointSpring
from newton_euler.model.joint_kinds import Prismatic
from newton_euler.model.scene import Scene
from newton_euler.model.switched_forces import JointFriction, JointStop
from newton_euler.reading.robot import JointKind, LoopKind
from newton_euler.reading.scene_robot import describe


def is_exported_alike(scene: Scene) -> bool:
    """MJCF has no hinges and slides that close loops, and exported free joints have other coordinates."""
    robot = describe(scene).robot
    has_free = any(joint.kind == JointKind.FREE for body in robot.bodies for joint in body.joints)
    return not has_free and not {loop.kind for loop in robot.loops} & {LoopKind.HINGE, LoopKind.SLIDE}


SCENES = elements.ELEMENTS | {"four_bar": load("four_bar"), "tracker": load("tracker")}
SCENES = {name: scene for name, scene in SCENES.items() if is_exported_alike(scene)}
ROUND_OFF = 1e-9
"""Largest error relative to the largest entry: MuJoCo's principal axes are exact to 1e-12, times 1e3."""


@pytest.mark.parametrize("scene", SCENES.values(), ids=SCENES.keys())
def test_bodies_move_as_in_mujoco(scene: Scene) -> None:
    """The exported file has the same tree and the same zeros."""
    model = mujoco.MjModel.from_xml_string(mjcf.to_xml(scene))
    data = mujoco.MjData(model)
    robot = describe(scene).robot
    random = np.random.default_rng(1)
    mujoco.mj_integratePos(model, data.qpos, random.normal(size=model.nv), 1.0)
    mujoco.mj_forward(model, data)
    coordinates = {}
    columns: list[int] = []  # MuJoCo's index of each velocity of the robot
    for number, body in enumerate(robot.bodies):
        for k, joint in enumerate(body.joints):
            found = model.joint(joint.name)
            coordinates[number, k] = data.qpos[found.qposadr[0] :][: 4 if joint.kind == JointKind.BALL else 1]
            first = int(found.dofadr[0])
            columns += range(first, first + (3 if joint.kind == JointKind.BALL else 1))
    at = pose(robot, coordinates)
    for body, placed in zip(robot.bodies, at.placements, strict=True):
        assert placed.position == pytest.approx(data.xipos[model.body(body.name).id], abs=ROUND_OFF)
    expected = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, expected)
    assert len(columns) == model.nv
    assert mass_matrix(robot, at) == pytest.approx(
        expected[np.ix_(columns, columns)], abs=ROUND_OFF * np.max(expected)
    )


def test_loops_have_the_points_and_axes_of_the_scene() -> None:
    """Ends of a loop coincide in the initial pose; the x axes are the axis of the joint in the scene."""
    for scene, kind in (
        (seven_hinges(), LoopKind.HINGE),
        (bolted(Prismatic, axis=[0, 1, 0]), LoopKind.SLIDE),
    ):
        robot = describe(scene).robot
        placements = robot.placements()
        loops = [loop for loop in robot.loops if loop.kind == kind]
        assert loops
        for loop in loops:
            joint = scene.mechanism.joint(loop.name)
            ends = (loop.first, loop.first_frame), (loop.second, loop.second_frame)
            for body, frame in ends:
                end = placements[body] @ frame if body >= 0 else frame
                assert end.position == pytest.approx(joint.point, abs=1e-12)
                assert end.rotation[:, 0] == pytest.approx(joint.axis, abs=1e-12)  # type: ignore[attr-defined]


def test_a_body_on_rods_is_free() -> None:
    (plate,) = describe(elements.JOINTS["rods only"]).robot.bodies
    assert [joint.kind for joint in plate.joints] == [JointKind.FREE]
    body = elements.JOINTS["rods only"].mechanism.body(plate.name)
    assert plate.placement.position.tolist() == list(body.center_of_mass)
    assert (plate.center.tolist(), plate.inertia.tolist()) == (
        [0.0, 0.0, 0.0],
        np.array(body.inertia).tolist(),
    )


def test_a_cut_body_has_two_halves() -> None:
    """Descriptions have no word for a loop that closes at a universal joint."""
    scene = elements.JOINTS["gear, cut"]
    robot = describe(scene).robot
    assert [loop.kind for loop in robot.loops] == [LoopKind.WELD]
    total = sum(body.mass for body in scene.mechanism.bodies[1:])
    assert sum(body.mass for body in robot.bodies) == pytest.approx(total, rel=1e-14)
    assert len(robot.couplings) == len(scene.mechanism.couplings)


def test_joints_and_drives_have_the_numbers_of_the_scene() -> None:
    plain = pendulum()
    name = plain.mechanism.joints[0].name
    mechanism = plain.mechanism
    scene = replace(
        plain,
        mechanism=mechanism.__class__(
            mechanism.bodies, [replace(mechanism.joints[0], actuated=True)], mechanism.couplings
        ),
        forces=[
            JointSpring(name, 8.0, 0.25, rest=0.2),
            JointFriction(name, 0.5, stribeck=0.1),
            JointStop(name, "high", 0.75, 1e4),
        ],
        armatures=[Armature(name, 0.125)],
        control=[PD(name, 30.0, 4.0, target=0.1, feedforward=1.5)],
    )
    found = describe(scene)
    (joint,) = found.robot.bodies[0].joints
    assert (joint.stiffness, joint.damping, joint.rest, joint.armature) == (8.0, 0.25, 0.2, 0.125)
    assert (joint.friction, joint.limits) == (0.5, (-math.inf, 0.75))
    (drive,) = found.robot.drives
    assert (dict(drive.gears), drive.gain, drive.stiffness) == ({name: 1.0}, 30.0, -30.0)
    assert (drive.damping, drive.constant) == (-4.0, 1.5)
    assert found.robot.gravity is not None
    assert found.robot.gravity.tolist() == list(scene.gravity)
    assert (found.format, found.variants) == ("scene file", ())
    (note,) = found.notes  # softness of friction and stops
    assert "friction" in note


def test_couplings_have_the_polynomials_of_the_scene() -> None:
    couplings = {each.name: each for each in describe(elements.JOINTS["gears"]).robot.couplings}
    for gear in elements.JOINTS["gears"].mechanism.couplings:
        described = couplings[gear.name]
        (follower, _), (driver, factor) = gear.factors().items()
        assert (described.follower, described.leader) == (follower[0], driver[0])
        assert described.powers == (0.0, -factor)
    screws = describe(elements.JOINTS["screw"]).robot.couplings
    pitches = {
        joint.name: joint.pitch
        for joint in elements.JOINTS["screw"].mechanism.joints
        if hasattr(joint, "pitch")
    }
    assert {screw.name: screw.powers for screw in screws} == {
        name: (0.0, pitch) for name, pitch in pitches.items()
    }
