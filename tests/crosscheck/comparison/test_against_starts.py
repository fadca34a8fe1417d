"""Two models that start elsewhere: laid over each other by what their bodies carry."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from test_against import FAULT, ROUND_OFF, compared, first_failing
from test_two_ways import DURATION, PERIOD, states_of, whole

import mjcf.read
from crosscheck.comparison.figure import START
from crosscheck.studies.faults import plant
from crosscheck.studies.faults.plant import Plant
from newton_euler import Mechanism, Scene
from newton_euler.model.euler_parameters import from_rotation, from_rotation_vector, rotation


def elsewhere(index: int) -> Scene:
    """The four-bar linkage as others might state it: at a later pose of its run, in other body frames."""
    scene, found, *_ = whole()
    mechanism, state = scene.mechanism, states_of(found)[index]
    frames, rng = state.frames(), np.random.default_rng(1)
    bodies = [mechanism.bodies[0]]
    for body, frame in zip(mechanism.bodies[1:], frames[1:], strict=True):
        turn = rotation(from_rotation_vector(rng.standard_normal(3)))
        inertia = turn.T @ body.inertia @ turn
        quaternion = from_rotation(frame.rotation @ turn)
        bodies.append(
            replace(
                body,
                center_of_mass=frame.position,
                inertia=0.5 * (inertia + inertia.T),
                quaternion=quaternion,
            )
        )
    joints = []
    for joint in mechanism.joints:
        k = mechanism.body_index(joint.second)
        arm = mechanism.bodies[k].pose.point_to_body(joint.reaction_point)
        joints.append(
            replace(joint, point=frames[k].position + frames[k].rotation @ arm, point_on_second=None)
        )
    return Scene("elsewhere", Mechanism(bodies, joints), DURATION, PERIOD, scene.gravity)


@pytest.mark.parametrize(
    ("fault", "quantity", "where"),
    [
        (plant.mass("coupler", FAULT), "mass", "coupler"),
        (plant.center_of_mass("coupler", np.array([0.0, FAULT, 0.0])), "center of mass", "coupler"),
        (plant.center_of_mass("crank", np.array([0.0, 0.0, FAULT])), "center of mass", "crank"),
        (plant.inertia_entry("rocker", 0, 1, FAULT), "inertia", "rocker"),
    ],
)
def test_models_are_compared_whatever_pose_and_frames_they_are_stated_in(
    fault: Plant, quantity: str, where: str
) -> None:
    """By what their bodies carry: the fault is found where it is, not at every body that starts elsewhere."""
    result = compared(whole()[0], fault(elsewhere(5)))
    assert first_failing(result) == ("model", quantity, where)
    assert result.notes[0].startswith("starts differ: positions, m: 2.")


@pytest.mark.parametrize(
    ("fault", "places"),
    [
        (plant.joint_point("b", np.array([FAULT, 0.0, 0.0])), ("b", "crank", "coupler")),
        (plant.change_joint("d", lambda d: replace(d, axis=[FAULT, 1.0, 0.0])), ("d", "rocker")),
    ],
)
def test_joints_of_other_poses_and_frames_are_found_there_or_at_their_bodies(
    fault: Plant, places: tuple[str, ...]
) -> None:
    """Joint points are what bodies are laid over each other by."""
    level, _, where = first_failing(compared(whole()[0], fault(elsewhere(5))))
    assert level == "model"
    assert where in places


def test_one_model_from_another_start_differs_there_only() -> None:
    scene, found, *_ = whole()
    for other in (elsewhere(5), replace(scene, initial_state=states_of(found)[5])):
        result = compared(scene, other)
        assert first_failing(result) == (START, "positions", "coupler")
        assert all(row.value < ROUND_OFF for row in result.rows if row.level == "model")


STACKS = {
    "hinge": '<joint name="h" axis="0 1 0"/>',
    "slide": '<joint name="s" type="slide" axis="1 0 0"/>',
    "ball": '<joint name="b" type="ball"/>',
    "cylindrical": '<joint name="s" type="slide" axis="0 1 0"/><joint name="h" axis="0 1 0"/>',
    "planar": '<joint name="s" type="slide" axis="1 0 0"/><joint name="t" type="slide" axis="0 0 1"/>'
    '<joint name="h" axis="0 1 0"/>',
    "table": '<joint name="s" type="slide" axis="1 0 0"/><joint name="t" type="slide" axis="0 0 1"/>'
    '<joint name="h" axis="0 0 1"/>',
    "pin in slot": '<joint name="s" type="slide" axis="1 0 0"/><joint name="h" axis="0 1 0"/>',
    "universal": '<joint name="h" axis="1 0 0"/><joint name="i" axis="0 1 0"/>',
    "three hinges": '<joint name="h" axis="1 0 0"/><joint name="i" axis="0 1 0"/>'
    '<joint name="j" axis="0 0 1"/>',
    "universal in slot": '<joint name="s" type="slide" axis="0 0 1"/><joint name="h" axis="1 0 0"/>'
    '<joint name="i" axis="0 1 0"/>',
    "ball in slot": '<joint name="s" type="slide" axis="1 0 0"/><joint name="b" type="ball"/>',
}
"""Joints of one body, from its parent on."""

BALLS = {0.3: "0.9 0.1 0.3 0.2", -0.8: "0.8 -0.3 0.1 0.4"}
"""Quaternions beside other coordinates."""


def stacked(joints: list[str]) -> str:
    """An arm, a body on it by these joints, and two keyframes of which nothing is zero."""
    poses = []
    for x, ball in BALLS.items():
        own = (ball if "ball" in joint else f"{x / (1.0 + k)}" for k, joint in enumerate(joints))
        poses.append(" ".join([f"{0.4 * x}", *own]))
    return f"""<mujoco><compiler angle="radian"/><worldbody><body name="arm"><joint name="a" axis="0 1 0"/>
    <inertial pos="0.02 0 0.05" mass="0.3" diaginertia="2e-3 2.1e-3 1e-4"/><body name="pin" pos="0 0 0.1">
    {"".join(joints)}<inertial pos="0.05 0.01 0.03" mass="0.5"
    fullinertia="3e-3 4e-3 3.5e-3 1e-4 2e-4 1.5e-4"/></body></body></worldbody>
    <keyframe><key name="k0" qpos="{poses[0]}"/><key name="k1" qpos="{poses[1]}"/></keyframe></mujoco>"""


@pytest.mark.parametrize(
    ("kind", "backwards"),
    [
        *((kind, False) for kind in STACKS),
        *((kind, True) for kind in STACKS if STACKS[kind].count("<joint") > 1),
    ],
)
def test_another_keyframe_of_one_file_is_another_start(tmp_path: Path, kind: str, backwards: bool) -> None:
    """Only a motion's axis that the others do not turn in a body is that body's."""
    joints = re.findall("<joint[^>]*>", STACKS[kind])
    model = tmp_path / "model.xml"
    model.write_text(stacked(joints[::-1] if backwards else joints))
    first, second = (mjcf.read.read(model, key).scene for key in ("k0", "k1"))
    result = compared(first, second)
    assert first_failing(result)[0] == START
    figures = [row for row in result.rows if row.level == "model" and not row.informs]
    assert all(row.value < ROUND_OFF for row in figures)
