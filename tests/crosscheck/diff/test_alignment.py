"""Robots and the same robots in the terms of another file: each body, joint, sense and zero is found."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from disguised_robots import Disguise, chained, disguise, random_body, random_robot, split

from crosscheck.diff.alignment import Alignment, align
from newton_euler.reading.robot import FileJoint, JointKind, Robot

EXACT = 1e-9
"""Errors of offsets and frames, rad or m. Round-off of 1e-16 grows by ratios of lengths, of about 1e3 at most
(a center 1 mm beside an axis tells its angle), and along chains of ten bodies."""


def joint_name(robot: Robot, key: tuple[int, int]) -> str:
    """Return the name of a joint of a robot."""
    return robot.bodies[key[0]].joints[key[1]].name


def check_recovered(first: Robot, disguised: Disguise, alignment: Alignment) -> None:
    """Check that all is found that a disguise changed."""
    second = disguised.robot
    names = {first.bodies[k.first[0]].name: second.bodies[k.second[0]].name for k in alignment.bodies}
    assert names == disguised.bodies
    joints = {joint_name(first, k.first): k for k in alignment.joints}
    assert {name: joint_name(second, k.second) for name, k in joints.items()} == disguised.joints
    assert {name: k.sense for name, k in joints.items()} == disguised.senses
    for name, found in joints.items():
        assert found.offset == pytest.approx(disguised.offsets[name], abs=EXACT), name
    for pair in alignment.bodies:
        frame = disguised.frames[first.bodies[pair.first[0]].name]
        np.testing.assert_allclose(pair.placement.position, frame.position, atol=EXACT)
        np.testing.assert_allclose(pair.placement.rotation, frame.rotation, atol=EXACT)
    assert not alignment.first_bodies + alignment.second_bodies
    assert not alignment.first_joints + alignment.second_joints
    assert alignment.base == ""
    assert (alignment.groups, alignment.loops) == ((), ())


@pytest.mark.parametrize("seed", range(30))
@pytest.mark.parametrize(
    "changes",
    [
        {"frames": 0.0, "zeros": 0.0},
        {"frames": 1.0, "zeros": 0.0},
        {"frames": 0.0, "zeros": 1.0},
        {"frames": 0.5, "zeros": 0.5},
        {"frames": 1.0, "zeros": 1.0},
    ],
    ids=["names", "frames", "zeros", "half", "all"],
)
def test_a_disguised_robot_is_recognized(seed, changes):
    rng = np.random.default_rng(seed)
    robot = random_robot(rng, int(rng.integers(2, 12)), floating=bool(rng.integers(2)))
    disguised = disguise(robot, rng, **changes)
    check_recovered(robot, disguised, align(robot, disguised.robot, {}))


@pytest.mark.parametrize("seed", range(30))
def test_bodies_that_are_split_and_joints_of_one_body_in_a_chain(seed):
    rng = np.random.default_rng(100 + seed)
    robot = random_robot(rng, int(rng.integers(4, 10)), floating=False)
    disguised = disguise(robot, rng, frames=0.5, zeros=0.0)
    halves = {name: f"{name}_part" for name in list(disguised.bodies)[1:4]}
    second = disguised.robot
    for name, part in halves.items():
        second = split(second, disguised.bodies[name], part, rng)
    second = chained(second)
    alignment = align(robot, second, {})
    for pair in alignment.bodies:
        name = robot.bodies[pair.first[0]].name
        parts = [second.bodies[k].name for k in pair.second]
        assert parts[0] == disguised.bodies[name]
        assert parts[1:] == ([halves[name]] if name in halves else [])
        frame = disguised.frames[name]
        np.testing.assert_allclose(pair.placement.position, frame.position, atol=EXACT)
        np.testing.assert_allclose(pair.placement.rotation, frame.rotation, atol=EXACT)
    joints = {joint_name(robot, k.first): joint_name(second, k.second) for k in alignment.joints}
    assert joints == disguised.joints
    assert {k.sense for k in alignment.joints} <= {1, -1}
    # the links without mass between two joints of one body
    assert all(second.bodies[k].mass == 0 for k in alignment.second_bodies)
    assert len(alignment.second_bodies) == sum(max(0, len(body.joints) - 1) for body in robot.bodies)
    assert not alignment.first_bodies


def arm(bodies: int = 6, seed: int = 5) -> Robot:
    """Return a robot without branches and multiple joints."""
    rng = np.random.default_rng(seed)
    made = [random_body(rng, "base", -1, ())]
    made += [random_body(rng, f"link{k}", k - 1, (JointKind.HINGE,)) for k in range(1, bodies)]
    return Robot("arm", tuple(made))


@pytest.mark.parametrize("first_floats", [True, False])
def test_a_floating_and_a_fixed_base(first_floats):
    rng = np.random.default_rng(3)
    fixed = random_robot(rng, 8, floating=False)
    free = FileJoint("root", JointKind.FREE, np.zeros(3), np.zeros(3))
    floating = replace(fixed, bodies=(replace(fixed.bodies[0], joints=(free,)), *fixed.bodies[1:]))
    robots = (floating, fixed) if first_floats else (fixed, floating)
    alignment = align(*robots, {})
    assert [(k.first, k.second) for k in alignment.bodies] == [((k,), (k,)) for k in range(8)]
    assert alignment.base == (
        "floating in the first, fixed in the second"
        if first_floats
        else "fixed in the first, floating in the second"
    )
    alone = alignment.first_joints, alignment.second_joints
    assert alone == ((((0, 0),), ()) if first_floats else ((), ((0, 0),)))


def test_a_branch_that_only_one_robot_has():
    rng = np.random.default_rng(7)
    robot = arm()
    fingers = [random_body(rng, name, 5, (JointKind.SLIDE,)) for name in ("left", "right")]
    disguised = disguise(robot, rng)
    with_gripper = replace(robot, bodies=(*robot.bodies, *fingers))
    alignment = align(with_gripper, disguised.robot, {})
    assert len(alignment.bodies) == 6
    assert (alignment.first_bodies, alignment.second_bodies) == ((6, 7), ())
    assert (alignment.first_joints, alignment.second_joints) == (((6, 0), (7, 0)), ())
    swapped = align(disguised.robot, with_gripper, {})
    assert swapped.second_bodies == (6, 7)


@pytest.mark.parametrize("where", [1, 3, 5])
def test_a_link_that_is_added_in_between(where):
    """The link holds the rest of the arm by a joint of its own."""
    rng = np.random.default_rng(11)
    robot = arm()
    new = random_body(rng, "new", where - 1, (JointKind.HINGE,))
    rest = [replace(body, parent=body.parent + 1) for body in robot.bodies[where:]]
    longer = replace(robot, bodies=(*robot.bodies[:where], new, *rest))
    alignment = align(robot, longer, {})
    assert alignment.second_bodies == (where,)
    assert alignment.second_joints == ((where, 0),)
    assert [longer.bodies[k.second[0]].name for k in alignment.bodies] == [k.name for k in robot.bodies]
    assert len(alignment.joints) == 5


@pytest.mark.parametrize("names", [True, False])
@pytest.mark.parametrize("where", [1, 2, 4, 5])
def test_a_joint_that_is_fixed_in_one_robot(where, names):
    robot = arm()
    stiff = replace(
        robot,
        bodies=tuple(
            replace(body, joints=() if k == where else body.joints) for k, body in enumerate(robot.bodies)
        ),
    )
    disguised = disguise(stiff, np.random.default_rng(2), names=names, zeros=0.0, order=False)
    for one, two, first in ((robot, disguised.robot, True), (disguised.robot, robot, False)):
        alignment = align(one, two, {})
        parts = {k.first for k in alignment.bodies} & {k.second for k in alignment.bodies}
        assert (where - 1, where) in parts
        assert len(alignment.bodies) == 5
        assert not alignment.first_bodies + alignment.second_bodies
        assert alignment.first_joints == (((where, 0),) if first else ())
        assert alignment.second_joints == (() if first else ((where, 0),))
        assert [k.offset for k in alignment.joints] == [0.0] * 4


def test_a_ball_for_three_hinges_with_links_without_mass():
    robot = arm(4)
    axes = np.eye(3)
    hinges = tuple(
        FileJoint(f"wrist_{name}", JointKind.HINGE, axis, np.zeros(3))
        for name, axis in zip("xyz", axes, strict=True)
    )
    ball = FileJoint("wrist", JointKind.BALL, np.zeros(3), np.zeros(3))
    bodies = robot.bodies[:2]
    last = robot.bodies[3]
    one = replace(robot, bodies=(*bodies, replace(robot.bodies[2], joints=(ball,)), last))
    two = chained(replace(robot, bodies=(*bodies, replace(robot.bodies[2], joints=hinges), last)))
    alignment = align(one, two, {})
    assert [(k.first, k.second) for k in alignment.bodies] == [
        ((0,), (0,)),
        ((1,), (1,)),
        ((2,), (4,)),
        ((3,), (5,)),
    ]
    assert [(k.first, k.second) for k in alignment.groups] == [(((2, 0),), ((2, 0), (3, 0), (4, 0)))]
    assert len(alignment.joints) == 2
    assert not alignment.first_joints + alignment.second_joints
