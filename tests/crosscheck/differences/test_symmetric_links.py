"""Links that look the same in several directions: what hangs on them tells how they are turned."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from crosscheck.differences.alignment import align
from crosscheck.differences.difference import Quantity, Standing
from crosscheck.differences.rows import differences
from newton_euler.reading.robot import FileBody, JointKind, Placement, Robot
from newton_euler.scalars import Array
from tests.support.file_robots import as_file, hinge, turn, with_frame

EXACT = 1e-9
"""Errors of offsets and frames, rad or m: round-off of 1e-16, grown along six links of about 0.1 to 1 m."""

ORIGIN = np.zeros(3)


def link(
    name: str,
    parent: int,
    position: list[float],
    axis: list[float],
    center: list[float],
    moments: list[float],
) -> FileBody:
    """Return a link of 2 kg whose inertia is along the axes of its frame."""
    placement = Placement(np.array(position), np.eye(3))
    return FileBody(
        name, parent, placement, (hinge(f"{name}_joint", axis),), 2.0, np.array(center), np.diag(moments)
    )


def arm() -> Robot:
    """Return an arm whose base and shoulder are bodies of revolution about the axis of the first joint."""
    base = FileBody("base", -1, Placement(ORIGIN, np.eye(3)), (), 4.0, ORIGIN, np.diag([4e-3, 4e-3, 7e-3]))
    return Robot(
        "arm",
        (
            base,
            link("shoulder", 0, [0, 0, 0.16], [0, 0, 1], [0, 0, 0], [1e-2, 1e-2, 6e-3]),
            link("upper", 1, [0, 0.14, 0], [0, 1, 0], [0.21, 0, 0], [1.5e-2, 0.13, 0.13]),
            link("fore", 2, [0.42, -0.13, 0], [0, 1, 0], [0.2, 0, 0], [4e-3, 3e-2, 3e-2]),
            link("wrist", 3, [0.39, 0, 0], [0, 1, 0], [0, 0.12, 0], [2e-3, 2e-3, 2.5e-3]),
            link("hand", 4, [0, 0.12, 0], [0, 0, 1], [0.03, 0, 0.1], [2e-3, 3e-3, 2.5e-3]),
        ),
    )


def turned(robot: Robot, index: int, rotation: Array) -> Robot:
    """Return a robot in which a body is turned at its parent."""
    bodies = list(robot.bodies)
    placement = bodies[index].placement
    bodies[index] = replace(
        bodies[index], placement=Placement(placement.position, rotation @ placement.rotation)
    )
    return replace(robot, bodies=tuple(bodies))


@pytest.mark.parametrize("angle", [math.pi, 0.5 * math.pi, 1.0])
def test_a_base_that_is_turned_about_the_first_axis(angle):
    """The frame of the shoulder stays in the world, and the frames of the arm are elsewhere."""
    robot = arm()
    second = turned(robot, 0, turn("z", angle))
    frames = {"shoulder": turn("z", -angle), "upper": turn("x", 1.2), "fore": turn("x", 1.2)}
    for name, rotation in frames.items():
        second = with_frame(second, name, Placement(ORIGIN, rotation))
    alignment = align(robot, second, {})
    assert [k.offset for k in alignment.joints] == pytest.approx([0.0] * 5, abs=EXACT)
    assert [k.sense for k in alignment.joints] == [1] * 5
    for pair in alignment.bodies:
        expected = frames.get(robot.bodies[pair.first[0]].name, np.eye(3))
        np.testing.assert_allclose(pair.placement.rotation, expected, atol=EXACT)


def test_half_a_turn_of_a_base_and_of_a_shoulder_is_no_difference():
    """The digits of the shoulder turn it by a bit more or less than half a turn, which is the same angle."""
    robot = turned(arm(), 1, turn("z", 0.3))
    second = with_frame(
        turned(robot, 0, turn("z", math.pi)), "shoulder", Placement(ORIGIN, turn("z", math.pi))
    )
    second = with_frame(second, "upper", Placement(ORIGIN, turn("x", 1.2)))
    files = as_file(robot), as_file(second)
    rows = differences(*files, align(files[0].robot, files[1].robot, {}), None)
    assert {row.quantity for row in rows if row.standing is Standing.CONVENTION} == {
        Quantity.BASE,
        Quantity.FRAME,
    }
    assert {row.standing for row in rows} <= {Standing.CONVENTION, Standing.ROUNDING}
    # six digits of angles of about 1
    assert max((row.size for row in rows if row.standing is Standing.ROUNDING), default=0.0) < 1e-5


@pytest.mark.parametrize("angle", [math.pi, 1.0])
def test_the_zero_of_a_joint_whose_links_look_the_same(angle):
    """The shoulder is turned about its axis at the base; its frame is elsewhere, as those of the arm are."""
    robot = arm()
    second = turned(robot, 1, turn("z", angle))
    frames = {"shoulder": turn("z", 0.3), "upper": turn("x", 1.2), "fore": turn("x", 1.2)}
    for name, rotation in frames.items():
        second = with_frame(second, name, Placement(ORIGIN, rotation))
    alignment = align(robot, second, {})
    assert [abs(k.offset) for k in alignment.joints] == pytest.approx([angle, 0.0, 0.0, 0.0, 0.0], abs=EXACT)
    assert [k.sense for k in alignment.joints] == [1] * 5


def test_an_own_frame_of_a_link_rather_than_another_axis_of_its_joint():
    """A finger that differs in mass, center and inertia, with a link frame turned by 180 degrees."""
    hand = FileBody("hand", -1, Placement(ORIGIN, np.eye(3)), (), 1.0, ORIGIN, 1e-3 * np.eye(3))

    def finger(rotation: Array, axis: list[float], mass: float, center: list[float], inertia: Array) -> Robot:
        joint = replace(hinge("slide", axis), kind=JointKind.SLIDE)
        placement = Placement(np.array([0, 0, 0.06]), rotation)
        body = FileBody("finger", 0, placement, (joint,), mass, np.array(center), inertia)
        return Robot("gripper", (hand, body))

    first = finger(np.eye(3), [0, -1, 0], 0.1, [0, 0.01, 0.02], np.diag([2e-4, 1e-4, 1e-4]))
    half_turn = np.diag([-1.0, -1.0, 1.0])
    second = finger(half_turn, [0, 1, 0], 0.015, [0, 0, 0], np.diag([2.4e-6, 2.4e-6, 7.5e-7]))
    rows = differences(as_file(first), as_file(second), align(first, second, {}), None)
    different = {row.quantity for row in rows if row.standing is Standing.DIFFERENT}
    assert different == {Quantity.MASS, Quantity.CENTER, Quantity.INERTIA}
