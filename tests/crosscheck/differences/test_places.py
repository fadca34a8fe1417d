"""Sites of actuators and tendons in files whose bodies have other frames."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

import crosscheck
from crosscheck.compare.outcome import Outcome
from crosscheck.differences.difference import Quantity
from newton_euler.scalars import Array

ARM = """
<mujoco model="arm"><worldbody>
  <site name="start" pos="-0.1 0.05 0.2"/>
  <body name="upper" pos="0 0 0.1"><joint name="shoulder" axis="0 1 0"/>
    <inertial pos="0.1 0 0" mass="1" diaginertia="0.01 0.02 0.02"/>
    <geom name="roll" type="cylinder" size="0.03 0.1" pos="0.25 0 0.02" euler="90 0 0" contype="0"/>
    <geom name="knob" type="sphere" size="0.02" pos="0.1 0 0.03" contype="0"/>
    <site name="above" pos="0.25 0 0.1"/><site name="on" pos="0.05 0 0.08"/>
    <body name="fore" pos="0.3 0 0"><joint name="elbow" axis="0 1 0"/>
      <site name="tip" pos="0.1 0.02 0.05" euler="10 20 30"/><site name="end" pos="0.1 0 0.05"/>
      <inertial pos="0.1 0 0.02" mass="0.5" diaginertia="0.01 0.01 0.01"/>
      <body name="hand" pos="0.2 0 0"><joint name="wrist" type="ball" pos="0.01 0 0"/>
        <inertial pos="0.05 0 0" mass="0.25" diaginertia="0.001 0.001 0.001"/></body></body></body>
</worldbody>
<tendon><spatial name="cord" stiffness="50" frictionloss="0.1">
    <site site="start"/><geom geom="knob" sidesite="on"/><site site="on"/>
    <geom geom="roll" sidesite="above"/><site site="end"/></spatial></tendon>
<actuator><motor name="push" site="tip" gear="1 0 2 0 0.1 0"/>
  <motor name="pull" tendon="cord"/><motor name="near" site="tip" refsite="start" gear="0 1 0 0 0 0"/>
  <motor name="spin" joint="wrist" gear="0.1 0.2 -0.3"/>
  <motor name="tilt" jointinparent="wrist" gear="0.1 0.3 0"/></actuator></mujoco>"""
IDENTITY = np.array([1.0, 0.0, 0.0, 0.0])


def arm() -> mujoco.MjSpec:
    return mujoco.MjSpec.from_string(ARM)


def product(one: Array, two: Array) -> Array:
    """Return the product of two quaternions."""
    found = np.zeros(4)
    mujoco.mju_mulQuat(found, one, two)
    return found


def rotated(point: Array, quaternion: Array) -> Array:
    found = np.zeros(3)
    mujoco.mju_rotVecQuat(found, point, quaternion)
    return found


def with_other_frames(spec: mujoco.MjSpec) -> mujoco.MjSpec:
    """Return a model with the frame of each body turned and shifted, and the same robot otherwise."""
    random = np.random.default_rng(0)
    turns, shifts = {"world": IDENTITY}, {"world": np.zeros(3)}
    model = spec.compile()
    for body in spec.bodies[1:]:
        turn = random.normal(size=4)
        turns[body.name] = turn / np.linalg.norm(turn)
        shifts[body.name] = random.uniform(-0.2, 0.2, size=3)

    def moved(name: str, position: Array, quaternion: Array) -> tuple[Array, Array]:
        """Return a place of a body in its new frame."""
        back = turns[name] * (1.0, -1.0, -1.0, -1.0)
        return rotated(position - shifts[name], back), product(back, quaternion)

    for body in spec.bodies[1:]:
        number = model.body(body.name).id
        parent = model.body(model.body_parentid[number]).name
        for part, source in (
            *((site, model.site) for site in body.sites),
            *((geom, model.geom) for geom in body.geoms),
        ):
            of_model = source(part.name)
            part.pos, part.quat = moved(body.name, of_model.pos, of_model.quat)
            part.alt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT
        for joint in body.joints:
            joint.axis = moved(body.name, np.array(joint.axis) + shifts[body.name], IDENTITY)[0]
            joint.pos = moved(body.name, np.array(joint.pos), IDENTITY)[0]
        body.ipos, body.iquat = moved(body.name, model.body_ipos[number], model.body_iquat[number])
        frame = model.body_pos[number] + rotated(shifts[body.name], model.body_quat[number])
        turn = product(model.body_quat[number], turns[body.name])
        body.pos, body.quat = moved(parent, frame, turn)
    for drive in spec.actuators:
        if drive.name in ("spin", "tilt"):
            # MuJoCo takes both in the axes of the hand, that of "tilt" in those of its pose in the file
            torque = rotated(np.array(drive.gear[:3]), turns["hand"] * (1.0, -1.0, -1.0, -1.0))
            drive.gear = [*torque, 0.0, 0.0, 0.0]
    return spec


def accelerations(spec: mujoco.MjSpec) -> Array:
    """Return the accelerations of both hinges, and the size of that of the ball, with controls of 1."""
    model = spec.compile()
    data = mujoco.MjData(model)
    data.qpos[:2], data.qvel[:2], data.ctrl[:] = (0.3, 0.2), (1.0, -2.0), 1.0
    mujoco.mj_forward(model, data)
    return np.array([*data.qacc[:2], np.linalg.norm(data.qacc[2:])])


def test_bodies_with_other_frames_are_the_same_robot() -> None:
    first, second = arm(), with_other_frames(arm())
    np.testing.assert_allclose(accelerations(second), accelerations(first), rtol=1e-9)
    found = crosscheck.diff(first, second)
    assert [(row.element, row.quantity, row.cause) for row in found.differences] == []
    assert found.outcome is Outcome.SAME


@pytest.mark.parametrize(
    ("site", "element", "what"),
    [("above", "cord", "side site of shape 4"), ("end", "cord", "point 5"), ("start", "cord", "point 1")],
)
def test_a_moved_site_is_found_in_other_frames(site: str, element: str, what: str) -> None:
    spec = arm()
    moved = next(each for each in spec.sites if each.name == site)
    moved.pos[2] += 0.01
    second = with_other_frames(spec)
    rows = {row.cause: row for row in crosscheck.diff(arm(), second).differences}
    row = rows[what]
    assert (row.element, row.quantity, row.unit) == (element, Quantity.SETTING, "m")
    assert row.size == pytest.approx(0.01)


def test_a_turned_site_of_a_thruster_is_an_angle() -> None:
    spec = arm()
    tip = next(each for each in spec.sites if each.name == "tip")
    tip.alt.euler = (10.0, 20.0, 40.0)
    rows = crosscheck.diff(arm(), with_other_frames(spec)).differences
    assert {(row.element, row.cause, row.unit) for row in rows} == {("push", "site", "rad")}
    assert rows[0].size == pytest.approx(np.radians(10.0))


def test_the_axis_of_a_torque_on_a_ball_is_compared() -> None:
    spec = arm()
    drive = next(each for each in spec.actuators if each.name == "spin")
    drive.gear = (0.2, -0.1, -0.3, 0, 0, 0)
    (row,) = crosscheck.diff(arm(), with_other_frames(spec)).differences
    assert (row.element, row.cause, row.unit) == ("spin", "direction of the torque", "rad")


def test_a_site_on_another_body_is_a_difference() -> None:
    """The place in the world is the same in the pose of the file."""
    second = ARM.replace('<site name="end" pos="0.1 0 0.05"/>', "")
    second = second.replace(
        '<site name="on" pos="0.05 0 0.08"/>',
        '<site name="on" pos="0.05 0 0.08"/><site name="end" pos="0.4 0 0.05"/>',
    )
    (row,) = crosscheck.diff(arm(), mujoco.MjSpec.from_string(second)).differences
    assert (row.element, row.cause, row.first, row.second) == ("cord", "point 5", "fore", "upper")
