"""Robots and the same robots in the terms of another file: each body, joint, sense and zero is found."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from disguised_robots import (
    IN_PLACE,
    Disguise,
    chained,
    disguise,
    moved_body,
    random_body,
    random_robot,
    split,
    turned,
)

from crosscheck.differences.alignment import Alignment, align
from crosscheck.support.errors import CrosscheckError
from newton_euler.reading.robot import FileBody, FileJoint, FileLoop, JointKind, LoopKind, Placement, Robot

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


@pytest.mark.parametrize("seed", range(20))
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


@pytest.mark.parametrize("seed", range(20))
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


def quadruped(names: list[str]) -> Robot:
    """Return a robot with four legs that differ only by where they are: hip, thigh and shank each.

    Args:
        names: of the legs: left front, right front, left hind, right hind.
    """
    inertia = np.diag([0.1, 0.2, 0.25])
    free = FileJoint("root", JointKind.FREE, np.zeros(3), np.zeros(3))
    bodies = [FileBody("trunk", -1, IN_PLACE, (free,), 8.0, np.array([0.02, 0.0, 0.01]), inertia)]
    corners = [(0.2, 0.1), (0.2, -0.1), (-0.2, 0.1), (-0.2, -0.1)]
    axes = {"hip": [1.0, 0.0, 0.0], "thigh": [0.0, 1.0, 0.0], "shank": [0.0, 1.0, 0.0]}
    for leg, (x, y) in zip(names, corners, strict=True):
        out = np.sign(y)
        places = {"hip": [x, y, 0.0], "thigh": [0.0, 0.08 * out, 0.0], "shank": [0.0, 0.0, -0.2]}
        for part, axis in axes.items():
            joint = FileJoint(f"{leg}_{part}_j", JointKind.HINGE, np.array(axis), np.zeros(3))
            center = np.array([0.0, 0.02 * out, 0.0] if part == "hip" else [0.0, 0.0, -0.1])
            parent = 0 if part == "hip" else len(bodies) - 1
            place = Placement(np.array(places[part]), np.eye(3))
            bodies.append(FileBody(f"{leg}_{part}", parent, place, (joint,), 0.7, center, 0.01 * inertia))
    return Robot("quadruped", tuple(bodies))


@pytest.mark.parametrize("seed", range(6))
def test_equal_legs_are_told_apart_by_their_places(seed):
    rng = np.random.default_rng(seed)
    robot = quadruped(["LF", "RF", "LH", "RH"])
    disguised = disguise(robot, rng, frames=0.0, zeros=0.3)
    check_recovered(robot, disguised, align(robot, disguised.robot, {}))


def test_equal_legs_are_told_apart_by_words_of_their_names():
    """The second robot stands turned by 180 degrees; its center of mass is in the middle."""
    first = quadruped(["front_left", "front_right", "hind_left", "hind_right"])
    second = quadruped(["RR", "RL", "FR", "FL"])
    centered = [replace(k.bodies[0], center=np.zeros(3)) for k in (first, second)]
    first, second = (
        replace(robot, bodies=(trunk, *robot.bodies[1:]))
        for robot, trunk in zip((first, second), centered, strict=True)
    )
    alignment = align(first, second, {})
    legs = {first.bodies[k.first[0]].name: second.bodies[k.second[0]].name for k in alignment.bodies}
    expected = {"front_left": "FL", "front_right": "FR", "hind_left": "RL", "hind_right": "RR"}
    for one, two in expected.items():
        assert {legs[f"{one}_{part}"] for part in ("hip", "thigh", "shank")} == {
            f"{two}_{part}" for part in ("hip", "thigh", "shank")
        }


def changed(robot: Robot, index: int, **values: object) -> Robot:
    """Return a robot in which numbers of one body are others."""
    bodies = list(robot.bodies)
    bodies[index] = replace(bodies[index], **values)
    return replace(robot, bodies=tuple(bodies))


def with_axis(robot: Robot, index: int, axis: np.ndarray) -> Robot:
    """Return a robot in which the axis of one hinge is another one."""
    joint = replace(robot.bodies[index].joints[0], axis=axis)
    return changed(robot, index, joints=(joint,))


CHANGES = {
    "center": lambda robot: changed(robot, 3, center=robot.bodies[3].center + np.array([0.03, 0.0, -0.02])),
    "inertia turned": lambda robot: changed(
        robot, 3, inertia=turned(TURN, 0.7) @ robot.bodies[3].inertia @ turned(TURN, 0.7).T
    ),
    "inertia of the last link turned about its axis": lambda robot: changed(
        robot,
        5,
        inertia=turned(robot.bodies[5].joints[0].axis, 0.7)
        @ robot.bodies[5].inertia
        @ turned(robot.bodies[5].joints[0].axis, 0.7).T,
    ),
    "mass": lambda robot: changed(robot, 3, mass=1000.0),
    "origin": lambda robot: changed(
        robot,
        3,
        placement=Placement(robot.bodies[3].placement.position + 0.05, robot.bodies[3].placement.rotation),
    ),
    "axis a little": lambda robot: with_axis(robot, 3, turned(TURN, 0.05) @ robot.bodies[3].joints[0].axis),
    "axis": lambda robot: with_axis(robot, 3, turned(TURN, 1.2) @ robot.bodies[3].joints[0].axis),
    "orientation": lambda robot: changed(
        robot,
        3,
        placement=Placement(
            robot.bodies[3].placement.position, robot.bodies[3].placement.rotation @ turned(TURN, 0.3)
        ),
    ),
}
TURN = np.array([0.6, 0.0, 0.8])


@pytest.mark.parametrize("change", CHANGES)
def test_one_other_number_changes_no_frame_and_no_zero(change):
    """The robot with another number is compared with itself: that number must not become a turned frame."""
    robot = arm()
    second = CHANGES[change](robot)
    alignment = align(robot, second, {})
    assert [(k.first, k.second) for k in alignment.bodies] == [((k,), (k,)) for k in range(6)]
    for pair in alignment.bodies:
        np.testing.assert_allclose(pair.placement.position, 0.0, atol=EXACT)
        np.testing.assert_allclose(pair.placement.rotation, np.eye(3), atol=EXACT)
    assert {k.sense for k in alignment.joints} == {1}
    # a link that is turned against its parent is a small turn of its joint's zero and of its axis
    offsets = [k.offset for k in alignment.joints]
    assert offsets[:2] + offsets[3:] == [0.0] * 4
    assert abs(offsets[2]) < (0.3 if change == "orientation" else EXACT)


def test_a_hinge_of_the_other_sense():
    robot = arm()
    alignment = align(robot, with_axis(robot, 3, -robot.bodies[3].joints[0].axis), {})
    assert [k.sense for k in alignment.joints] == [1, 1, -1, 1, 1]
    # in the pose of the file, both robots have the coordinate of the file
    zero = robot.bodies[3].joints[0].zero
    assert [k.offset for k in alignment.joints] == pytest.approx([0.0, 0.0, 2 * zero, 0.0, 0.0], abs=EXACT)


def test_a_small_other_zero_is_found():
    robot = arm()
    joint = robot.bodies[3].joints[0]
    moved = moved_body(robot.bodies[3], [1e-3], np.eye(3))
    same_zero = replace(moved, joints=(replace(moved.joints[0], zero=joint.zero),))
    second = replace(robot, bodies=(*robot.bodies[:3], same_zero, *robot.bodies[4:]))
    alignment = align(robot, second, {})
    # the file's pose is 1 mrad further, and has the old coordinate
    assert [k.offset for k in alignment.joints] == pytest.approx([0.0, 0.0, -1e-3, 0.0, 0.0], abs=EXACT)


def test_a_branch_that_hangs_on_another_link():
    rng = np.random.default_rng(8)
    robot = arm()
    tool = random_body(rng, "tool", 5, (JointKind.HINGE,))
    first = replace(robot, bodies=(*robot.bodies, tool))
    second = replace(robot, bodies=(*robot.bodies, replace(tool, parent=2)))
    alignment = align(first, second, {})
    assert ((6,), (6,)) in {(k.first, k.second) for k in alignment.bodies}
    assert [(k.first, k.second, k.sense, k.offset) for k in alignment.joints if k.first[0] == 6] == [
        ((6, 0), (6, 0), 1, 0.0)
    ]


def test_two_joints_in_the_other_order():
    """Names say that roll and pitch follow each other the other way round."""
    robot = arm()
    names = ["base", "yaw", "roll", "pitch", "knee", "foot"]
    first = named(robot, names)
    order = [0, 1, 3, 2, 4, 5]
    bodies = [replace(first.bodies[k], parent=i - 1) for i, k in enumerate(order)]
    alignment = align(first, replace(first, bodies=tuple(bodies)), {})
    pairs = {(k.first[0], k.second[0]) for k in alignment.bodies}
    assert pairs == {(0, 0), (1, 1), (2, 3), (3, 2), (4, 4), (5, 5)}
    assert {(k.first[0], k.second[0], k.sense) for k in alignment.joints} == {
        (one, two, 1) for one, two in pairs - {(0, 0)}
    }


def named(robot: Robot, names: list[str]) -> Robot:
    """Return a robot with other names of the bodies; a joint has the name of its body."""
    bodies = [
        replace(body, name=name, joints=tuple(replace(k, name=f"{name}_joint") for k in body.joints))
        for body, name in zip(robot.bodies, names, strict=True)
    ]
    return replace(robot, bodies=tuple(bodies))


def four_bar(cut: str) -> Robot:
    """Return a four-bar linkage whose loop is cut at the joint of that name, `crank_pin` or `rocker_pin`."""
    y = np.array([0.0, 1.0, 0.0])

    def bar(name: str, parent: int, joint: str, at: list[float], length: float, mass: float) -> FileBody:
        center = np.array([length / 2, 0.0, 0.0])
        inertia = np.diag([1e-3, mass * length**2 / 12, mass * length**2 / 12])
        hinge = FileJoint(joint, JointKind.HINGE, y, np.zeros(3))
        return FileBody(name, parent, Placement(np.array(at), np.eye(3)), (hinge,), mass, center, inertia)

    # a parallelogram: crank and rocker along x in the pose of the file, the coupler beyond both
    crank = bar("crank", -1, "crank_axle", [0.0, 0.0, 0.0], 0.1, 0.3)
    rocker = bar("rocker", -1, "rocker_axle", [0.3, 0.0, 0.0], 0.2, 0.5)
    if cut == "rocker_pin":
        coupler = bar("coupler", 0, "crank_pin", [0.1, 0.0, 0.0], 0.4, 0.8)
        bodies, ends = (crank, coupler, rocker), (1, 2)
        frames = [[0.4, 0.0, 0.0], [0.2, 0.0, 0.0]]
    else:
        coupler = bar("coupler", 1, "rocker_pin", [-0.2, 0.0, 0.0], 0.4, 0.8)
        bodies, ends = (crank, rocker, coupler), (2, 0)
        frames = [[0.0, 0.0, 0.0], [0.1, 0.0, 0.0]]
    loop = FileLoop(cut, LoopKind.HINGE, *ends, *(Placement(np.array(frame), np.eye(3)) for frame in frames))
    return Robot("four-bar", bodies, loops=(loop,))


def test_loops_that_are_cut_at_other_joints():
    alignment = align(four_bar("rocker_pin"), four_bar("crank_pin"), {})
    assert {(k.first, k.second) for k in alignment.bodies} == {((0,), (0,)), ((1,), (2,)), ((2,), (1,))}
    assert {(k.first, k.second) for k in alignment.joints} == {((0, 0), (0, 0)), ((2, 0), (1, 0))}
    assert {(k.joint, k.loop, k.in_first) for k in alignment.loops} == {((1, 0), 0, True), ((2, 0), 0, False)}
    assert not alignment.first_joints + alignment.second_joints
    assert not alignment.first_bodies + alignment.second_bodies


def test_names_that_the_user_pairs_win():
    robot = quadruped(["LF", "RF", "LH", "RH"])
    pairs = {"LF_hip": "RF_hip", "RF_hip": "LF_hip"}
    alignment = align(robot, robot, pairs)
    found = {robot.bodies[k.first[0]].name: robot.bodies[k.second[0]].name for k in alignment.bodies}
    assert found["LF_hip"] == "RF_hip"
    assert found["RF_thigh"] == "LF_thigh"
    assert found["LH_shank"] == "LH_shank"
    assert ("LF_hip", "RF_hip") not in alignment.renamed
    by_joint = align(robot, robot, {"LF_thigh_j": "RF_thigh_j"})
    joints = {joint_name(robot, k.first): joint_name(robot, k.second) for k in by_joint.joints}
    assert joints["LF_thigh_j"] == "RF_thigh_j"


@pytest.mark.parametrize(
    ("names", "words"),
    [
        ({"LF_hipp": "LF_hip"}, ["first", "LF_hipp", "LF_hip,"]),
        ({"LF_hip": "LF_foot"}, ["second", "LF_foot"]),
        ({"LF_hip": "LF_hip_j"}, ["LF_hip_j", "two bodies or two joints"]),
        ({"LF_hip": "LH_hip", "RF_hip": "LH_hip"}, ["LH_hip"]),
    ],
    ids=["unknown in the first", "unknown in the second", "body and joint", "twice"],
)
def test_names_that_cannot_be_paired(names, words):
    robot = quadruped(["LF", "RF", "LH", "RH"])
    with pytest.raises(CrosscheckError) as error:
        align(robot, robot, names)
    assert all(word in str(error.value) for word in words)
    assert "\n" not in str(error.value)


def test_a_base_that_stands_elsewhere_in_the_world():
    """One number differs, the placement of the base; no frame is turned and no zero is elsewhere."""
    robot = arm()
    base = robot.bodies[0]
    half_turn = Placement(np.array([0.0, 0.3, 0.12]), turned(np.array([0.0, 0.0, 1.0]), np.pi))
    alignment = align(robot, changed(robot, 0, placement=half_turn @ base.placement), {})
    for pair in alignment.bodies:
        np.testing.assert_allclose(pair.placement.position, 0.0, atol=EXACT)
        np.testing.assert_allclose(pair.placement.rotation, np.eye(3), atol=EXACT)
    assert [k.offset for k in alignment.joints] == [0.0] * 5


def test_a_base_with_other_mass_in_another_frame():
    """Four fingers on a fixed palm tell its frame, whatever its mass and its center of mass are."""
    rng = np.random.default_rng(2)
    bodies = [arm(2).bodies[0]]
    for k in range(4):
        start = len(bodies)
        axis = rng.normal(size=3)
        rotation = turned(axis / np.linalg.norm(axis), rng.uniform(0.5, 2.0))
        place = Placement(rng.uniform(-0.1, 0.1, 3), rotation)
        first, second = named(arm(3), [f"finger{k}_{part}" for part in ("base", "link", "tip")]).bodies[1:]
        bodies += [
            replace(first, name=f"finger{k}", parent=0, placement=place),
            replace(second, name=f"tip{k}", parent=start),
        ]
    robot = Robot("hand", tuple(bodies))
    frame = Placement(np.array([0.03, -0.02, 0.05]), turned(np.array([0.6, 0.8, 0.0]), np.pi / 2))
    palm = replace(robot.bodies[0], mass=0.3, center=np.array([0.08, -0.05, 0.02]), inertia=1e-3 * np.eye(3))
    # the palm stays in the world, its fingers are given in the other frame
    fingers = [
        replace(body, placement=frame.inverse() @ body.placement) if body.parent == 0 else body
        for body in robot.bodies[1:]
    ]
    alignment = align(robot, replace(robot, bodies=(palm, *fingers)), {})
    (pair,) = (pair for pair in alignment.bodies if pair.first == (0,))
    np.testing.assert_allclose(pair.placement.rotation, frame.rotation, atol=EXACT)
    np.testing.assert_allclose(pair.placement.position, frame.position, atol=EXACT)
    assert [k.offset for k in alignment.joints] == pytest.approx([0.0] * 8, abs=EXACT)


def test_two_equal_arms_on_the_ground():
    """The arms face each other: half a turn of the world takes each one to the other."""
    one = arm(4)
    left = Placement(np.array([0.0, 0.5, 0.0]), np.eye(3))
    right = Placement(np.array([0.0, -0.5, 0.0]), turned(np.array([0.0, 0.0, 1.0]), np.pi))
    bodies = []
    for side, place in (("left", left), ("right", right)):
        start = len(bodies)
        own = named(one, [f"{side}_{body.name}" for body in one.bodies]).bodies
        own = (replace(own[0], placement=place), *own[1:])
        bodies += [replace(k, parent=k.parent + start if k.parent >= 0 else -1) for k in own]
    robot = Robot("two arms", tuple(bodies))
    for seed in range(8):
        disguised = disguise(robot, np.random.default_rng(seed), frames=0.0, zeros=0.5)
        alignment = align(robot, disguised.robot, {})
        joints = {joint_name(robot, k.first): joint_name(disguised.robot, k.second) for k in alignment.joints}
        assert joints == disguised.joints


@pytest.mark.parametrize("seed", range(4))
def test_equal_fingers_of_a_gripper_that_is_open(seed):
    """The fingers are equal, and the zeros of their slides are elsewhere: their frames tell them apart."""
    robot = arm(3)
    slide = FileJoint("slide", JointKind.SLIDE, np.array([0.0, 1.0, 0.0]), np.zeros(3))
    fingers = [
        FileBody(
            f"finger{k}",
            2,
            Placement(np.array([0.0, 0.02 * side, 0.1]), turned(np.array([0.0, 0.0, 1.0]), angle)),
            (replace(slide, name=f"slide{k}"),),
            0.1,
            np.array([0.0, 0.01, 0.02]),
            np.diag([1e-4, 2e-4, 2.5e-4]),
        )
        for k, (side, angle) in enumerate([(1, 0.0), (-1, np.pi)])
    ]
    robot = replace(robot, bodies=(*robot.bodies, *fingers))
    disguised = disguise(robot, np.random.default_rng(seed), frames=0.0)
    check_recovered(robot, disguised, align(robot, disguised.robot, {}))


def test_another_version_of_a_robot_in_other_frames():
    """Lengths and masses are others by some percent, and frames are turned: poses stay the same."""
    rng = np.random.default_rng(1)
    robot = arm()
    bodies = [
        replace(
            body,
            placement=Placement(body.placement.position * rng.uniform(0.95, 1.05), body.placement.rotation),
            mass=body.mass * rng.uniform(0.9, 1.1),
            center=body.center * rng.uniform(0.95, 1.05),
            inertia=body.inertia * rng.uniform(0.9, 1.1),
        )
        for body in robot.bodies
    ]
    disguised = disguise(replace(robot, bodies=tuple(bodies)), rng, zeros=0.0)
    alignment = align(robot, disguised.robot, {})
    joints = {joint_name(robot, k.first): k for k in alignment.joints}
    assert {name: joint_name(disguised.robot, k.second) for name, k in joints.items()} == disguised.joints
    assert {name: k.sense for name, k in joints.items()} == disguised.senses
    # in the pose of the file, coordinates correspond; lengths that differ by 5 % turn a link by less than 0.1
    errors = [disguised.offsets[name] - k.offset for name, k in joints.items()]
    assert errors == pytest.approx([0.0] * 5, abs=0.1)
