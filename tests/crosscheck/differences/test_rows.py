"""Rows of differences: planted changes are named with element, quantity, size and cause; rounding is none."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import combinations

import mujoco
import numpy as np
import pytest

from crosscheck.differences.alignment import Alignment, JointGroups, align
from crosscheck.differences.difference import Difference, Quantity, Standing, unit
from crosscheck.differences.rows import differences
from mjcf.robot import describe as describe_mjcf
from newton_euler.reading.robot import (
    FileCoupling,
    FileDrive,
    FileJoint,
    JointKind,
    LoopKind,
    Placement,
    Robot,
    RobotFile,
)
from tests.support.file_robots import (
    aligned,
    arm,
    as_file,
    at,
    body,
    body_of,
    hinge,
    joint_of,
    linkage,
    moved,
    to_digits,
    turn,
    walker,
    with_body,
    with_drive,
    with_every_joint,
    with_frame,
    with_joint,
    with_prefix,
    with_sign,
    with_zero,
)
from urdf.robot import describe

ROBOTS = {"arm": arm, "walker": walker, "linkage": linkage}


@dataclass(frozen=True)
class Row:
    """Row that is expected: element, quantity, size and a part of its cause; number of its elements."""

    element: str
    quantity: Quantity
    size: float
    cause: str = ""
    count: int = 1


@dataclass(frozen=True)
class Plant:
    """Change of a robot and the rows that it should give."""

    robot: str
    change: Callable[[Robot], Robot]
    rows: tuple[Row, ...]


def scaled_masses(robot: Robot, factor: float, inertias: bool = True) -> Robot:
    for each in robot.bodies:
        inertia = each.inertia * (factor if inertias else 1.0)
        robot = with_body(robot, each.name, mass=each.mass * factor, inertia=inertia)
    return robot


def scaled_lengths(robot: Robot, factor: float) -> Robot:
    for each in robot.bodies:
        placement = Placement(each.placement.position * factor, each.placement.rotation)
        robot = with_body(
            robot,
            each.name,
            placement=placement,
            center=each.center * factor,
            inertia=each.inertia * factor**2,
        )
    return robot


def exchanged(robot: Robot, one: str, other: str) -> Robot:
    """Return a robot in which two bodies have each other's mass properties."""
    first, second = body_of(robot, one), body_of(robot, other)
    robot = with_body(robot, one, mass=second.mass, center=second.center, inertia=second.inertia)
    return with_body(robot, other, mass=first.mass, center=first.center, inertia=first.inertia)


def with_inertia(name: str, change: Callable[[np.ndarray], np.ndarray]) -> Callable[[Robot], Robot]:
    return lambda robot: with_body(robot, name, inertia=change(body_of(robot, name).inertia))


def about_origin(robot: Robot, name: str) -> Robot:
    """Return a robot in which a body's inertia is about the origin of its frame."""
    link = body_of(robot, name)
    c = link.center
    shift = link.mass * ((c @ c) * np.eye(3) - np.outer(c, c))
    return with_body(robot, name, inertia=link.inertia + shift)


def without_rotation(inertia: np.ndarray) -> np.ndarray:
    return np.diag(np.linalg.eigvalsh(inertia))


def reversed_axis(robot: Robot, name: str) -> Robot:
    """Return a robot in which a joint's axis is reversed and its limits not mirrored."""
    return with_joint(robot, name, axis=-joint_of(robot, name).axis)


SIGNS_OF_PRODUCTS = 2 * np.eye(3) - 1
"""Factors of an inertia's elements that change the sign of its products only."""


Q = Quantity
PLANTS: dict[str, Plant] = {
    "mass": Plant("arm", lambda r: with_body(r, "fore", mass=1.6), (Row("fore", Q.MASS, 0.1 / 1.5),)),
    "mass by 1e-4": Plant(
        "arm",
        lambda r: with_body(r, "tool", mass=0.20002),
        (Row("tool", Q.MASS, 1e-4),),
    ),
    "fixed part moved": Plant(
        "arm", lambda r: moved(r, "tool", [0.01, 0, 0]), (Row("tool", Q.CENTER, 0.01),)
    ),
    "no mass": Plant(
        "walker", lambda r: with_body(r, "left_shin", mass=0.0), (Row("left_shin", Q.MASS, 1.0),)
    ),
    "center": Plant(
        "arm",
        lambda r: with_body(r, "fore", center=np.array([0.16, 0.01, 0.02])),
        (Row("fore", Q.CENTER, 0.01),),
    ),
    "center of the root": Plant(
        "walker",
        lambda r: with_body(r, "trunk", center=np.array([0.01, 0.001, 0.05])),
        (Row("trunk", Q.CENTER, 1e-3),),
    ),
    "inertia": Plant("arm", with_inertia("fore", lambda i: i * 1.1), (Row("fore", Q.INERTIA, 0.1),)),
    "inertia in g mm^2": Plant(
        "walker", with_inertia("left_hip", lambda i: i * 1e9), (Row("left_hip", Q.INERTIA, 1e9 - 1),)
    ),
    "inertia turned": Plant(
        "arm",
        with_inertia("fore", lambda i: turn("z", 0.3) @ i @ turn("z", 0.3).T),
        (Row("fore", Q.INERTIA_AXES, 0.3, "turned by"),),
    ),
    "rotation of the inertia lost": Plant(
        "walker",
        with_inertia("left_thigh", without_rotation),
        (Row("left_thigh", Q.INERTIA_AXES, 0.342, "rotation of the inertia is lost"),),
    ),
    "signs of products": Plant(
        "arm",
        with_inertia("wrist", lambda i: i * SIGNS_OF_PRODUCTS),
        (Row("wrist", Q.INERTIA, 0.00698, "products of inertia have the other sign"),),
    ),
    "products missing": Plant(
        "walker",
        with_inertia("trunk", lambda i: np.diag(np.diag(i))),
        (Row("trunk", Q.INERTIA, 0.0438, "products of inertia are missing"),),
    ),
    "moments exchanged": Plant(
        "arm",
        with_inertia("upper", lambda i: i + (i[1, 1] - i[0, 0]) * np.diag([1, -1, 0])),
        (Row("upper", Q.INERTIA, 0.00873, "ixx and iyy are exchanged"),),
    ),
    "inertia about the origin": Plant(
        "arm",
        lambda r: about_origin(r, "fore"),
        (Row("fore", Q.INERTIA, 7.55, "about the origin of the link"),),
    ),
    "origin": Plant("arm", lambda r: moved(r, "wrist", [0.01, 0, 0]), (Row("bend", Q.JOINT_ORIGIN, 0.01),)),
    "origin along the axis": Plant(
        "walker", lambda r: moved(r, "left_shin", [0, 2e-4, 0]), (Row("left_knee", Q.JOINT_ORIGIN, 2e-4),)
    ),
    "point of the joint": Plant(
        "walker",
        lambda r: with_joint(r, "left_knee", point=np.array([0.003, 0, 0])),
        (Row("left_knee", Q.JOINT_ORIGIN, 0.003),),
    ),
    "link turned, limits and rest not moved": Plant(
        "linkage",
        lambda r: moved(r, "rocker", rotation=turn("y", 0.1)),
        (Row("pivot", Q.ZERO, 0.1, "the joint counts from another zero, rest not moved"),),
    ),
    "center of the ball": Plant(
        "linkage",
        lambda r: with_joint(r, "swing", point=np.array([0, 0, 0.11])),
        (Row("swing", Q.JOINT_ORIGIN, 0.01),),
    ),
    "slide moved across": Plant(
        "arm", lambda r: moved(r, "hand", [0, 0.02, 0]), (Row("reach", Q.JOINT_ORIGIN, 0.02),)
    ),
    "slide turned about its axis": Plant(
        "arm", lambda r: moved(r, "hand", rotation=turn("x", 0.2)), (Row("reach", Q.JOINT_ORIENTATION, 0.2),)
    ),
    "link turned 3 degrees": Plant(
        "arm",
        lambda r: moved(r, "fore", rotation=turn("z", np.radians(3))),
        (Row("lift", Q.JOINT_AXIS, np.radians(3), "turned at its parent by 3 degrees"),),
    ),
    "link turned about its axis": Plant(
        "arm",
        lambda r: moved(r, "wrist", rotation=turn("y", 0.05)),
        (Row("bend", Q.ZERO, 0.05, "limits not moved"),),
    ),
    "link turned about a skew direction": Plant(
        "arm",
        lambda r: moved(r, "wrist", rotation=turn("x", 0.1) @ turn("y", 0.2)),
        (Row("bend", Q.JOINT_AXIS, 0.2236, "turned at its parent"),),
    ),
    "axis": Plant(
        "walker",
        lambda r: with_joint(r, "left_hip_roll", axis=np.array([np.cos(0.1), np.sin(0.1), 0])),
        (Row("left_hip_roll", Q.JOINT_AXIS, 0.1),),
    ),
    "damping": Plant("arm", lambda r: with_joint(r, "bend", damping=0.45), (Row("bend", Q.DAMPING, 0.5),)),
    "tiny damping": Plant(
        "arm", lambda r: with_joint(r, "lift", friction=1e-9), (Row("lift", Q.FRICTION, 1.0),)
    ),
    "armature": Plant(
        "walker", lambda r: with_joint(r, "right_knee", armature=0.03), (Row("right_knee", Q.ARMATURE, 0.5),)
    ),
    "friction": Plant("arm", lambda r: with_joint(r, "bend", friction=0.25), (Row("bend", Q.FRICTION, 0.5),)),
    "stiffness": Plant(
        "linkage", lambda r: with_joint(r, "pivot", stiffness=6.0), (Row("pivot", Q.STIFFNESS, 1.0),)
    ),
    "rest": Plant("linkage", lambda r: with_joint(r, "pivot", rest=0.3), (Row("pivot", Q.REST, 0.1),)),
    "limits": Plant(
        "arm", lambda r: with_joint(r, "lift", limits=(-1.5, 1.4)), (Row("lift", Q.LIMITS, 0.2),)
    ),
    "no limits": Plant(
        "arm", lambda r: with_joint(r, "yaw", limits=(-np.inf, np.inf)), (Row("yaw", Q.LIMITS, 1.0),)
    ),
    "effort": Plant("arm", lambda r: with_joint(r, "bend", effort=21.0), (Row("bend", Q.EFFORT, 0.3),)),
    "speed": Plant("arm", lambda r: with_joint(r, "reach", speed=3.0), (Row("reach", Q.SPEED, 1.0),)),
    "kind": Plant("arm", lambda r: with_joint(r, "lift", kind=JointKind.SLIDE), (Row("lift", Q.KIND, 1.0),)),
    "gear": Plant(
        "arm", lambda r: with_drive(r, "lift_motor", gears={"lift": -5.0}), (Row("lift_motor", Q.GEAR, 1.1),)
    ),
    "gain": Plant(
        "linkage", lambda r: with_drive(r, "crank_motor", gain=4.5), (Row("crank_motor", Q.GAIN, 0.5),)
    ),
    "gears of a tendon": Plant(
        "linkage",
        lambda r: with_drive(r, "grip_tendon", gears={"close": -0.75, "open": 0.5}),
        (Row("grip_tendon", Q.GEAR, 0.5),),
    ),
    "kp": Plant(
        "arm",
        lambda r: with_drive(r, "yaw_servo", gain=200.0, stiffness=-200.0),
        (Row("yaw_servo", Q.KP, 1.0),),
    ),
    "kv": Plant("arm", lambda r: with_drive(r, "yaw_servo", damping=-6.0), (Row("yaw_servo", Q.KV, 0.2),)),
    "constant force": Plant(
        "arm", lambda r: with_drive(r, "bend_motor", constant=0.5), (Row("bend_motor", Q.CONSTANT, 1.0),)
    ),
    "control limits": Plant(
        "arm",
        lambda r: with_drive(r, "bend_motor", control_limits=(-2, 2)),
        (Row("bend_motor", Q.CONTROL_LIMITS, 1.0),),
    ),
    "force limits": Plant(
        "arm",
        lambda r: with_drive(r, "bend_motor", force_limits=(-3, 3)),
        (Row("bend_motor", Q.FORCE_LIMITS, 0.5),),
    ),
    "activation": Plant(
        "arm",
        lambda r: with_drive(r, "bend_motor", other={"time constant": 0.1}),
        (Row("bend_motor", Q.SETTING, 1.0, "time constant"),),
    ),
    "drive dropped": Plant(
        "arm", lambda r: replace(r, drives=r.drives[1:]), (Row("yaw_servo", Q.PRESENCE, 1.0),)
    ),
    "drive added": Plant(
        "linkage",
        lambda r: replace(r, drives=(*r.drives, FileDrive("extra", {"pin": 1.0}, 1.0))),
        (Row("extra", Q.PRESENCE, 1.0),),
    ),
    "all drives dropped": Plant(
        "walker",
        lambda r: replace(r, drives=()),
        (Row("left_hip_roll_motor", Q.PRESENCE, 1.0, "", 6),),
    ),
    "loop point": Plant(
        "linkage",
        lambda r: replace(r, loops=(replace(r.loops[0], second_frame=at(0, 0, 0.195)), r.loops[1])),
        (Row("pin_loop", Q.LOOP_POINT, 0.005),),
    ),
    "loop length": Plant(
        "linkage",
        lambda r: replace(r, loops=(r.loops[0], replace(r.loops[1], length=0.46))),
        (Row("tie", Q.LOOP_LENGTH, 0.01),),
    ),
    "kind of loop": Plant(
        "linkage",
        lambda r: replace(r, loops=(replace(r.loops[0], kind=LoopKind.WELD), r.loops[1])),
        (Row("pin_loop", Q.KIND, 1.0),),
    ),
    "loop dropped": Plant(
        "linkage", lambda r: replace(r, loops=r.loops[1:]), (Row("pin_loop", Q.PRESENCE, 1.0),)
    ),
    "factor of a coupling": Plant(
        "linkage",
        lambda r: replace(r, couplings=(FileCoupling("grip", "close", "open", (0.0, 1.0)),)),
        (Row("grip", Q.COUPLING, 2.0),),
    ),
    "coupling dropped": Plant("linkage", lambda r: replace(r, couplings=()), (Row("grip", Q.PRESENCE, 1.0),)),
    "gravity": Plant(
        "arm", lambda r: replace(r, gravity=np.array([0, 0, -9.8])), (Row("arm", Q.GRAVITY, 0.01 / 9.81),)
    ),
    "body added": Plant(
        "walker",
        lambda r: replace(
            r, bodies=(*r.bodies, body("head", 0, [0, 0, 0.3], [hinge("neck", [0, 0, 1])], 2.0, [0, 0, 0.1]))
        ),
        (Row("head", Q.PRESENCE, 2 / 20.8, "", 2),),
    ),
    "tilted base": Plant(
        "arm",
        lambda r: moved(r, "base", rotation=turn("x", 0.1)),
        (Row("base", Q.BASE, 0.1, "turned against gravity"),),
    ),
    "part added": Plant(
        "arm",
        lambda r: replace(r, bodies=(*r.bodies, body("logo", 2, [0.1, 0, 0.1], [], 0.001, [0, 0, 0]))),
        (Row("fore", Q.MASS, 0.001 / 1.5, "logo (0.001 kg) only in the second robot"),),
    ),
    "masses in g": Plant(
        "arm",
        lambda r: scaled_masses(r, 1000.0),
        (Row("base", Q.MASS, 999.0, "6 masses and inertias times 1000 (kg against g", 6),),
    ),
    "masses in pounds, inertias not": Plant(
        "walker",
        lambda r: scaled_masses(r, 2.2046, inertias=False),
        (Row("trunk", Q.MASS, 1.2046, "7 masses times 2.2046 (kg against pounds)", 7),),
    ),
    "lengths in mm": Plant(
        "walker",
        lambda r: scaled_lengths(r, 1000.0),
        (Row("left_knee", Q.JOINT_ORIGIN, 299.9, "lengths times 1000", 13),),
    ),
    "left and right exchanged": Plant(
        "walker",
        lambda r: exchanged(r, "left_hip", "right_hip"),
        (Row("left_hip", Q.CENTER, 0.06, "exchanged: left_hip and right_hip", 2),),
    ),
    "two links exchanged": Plant(
        "arm",
        lambda r: exchanged(r, "upper", "wrist"),
        (Row("upper", Q.MASS, 0.6, "exchanged: upper and wrist", 2),),
    ),
    "damping in degrees": Plant(
        "arm",
        lambda r: with_joint(
            with_joint(with_joint(r, "yaw", damping=0.1 * 180 / np.pi), "lift", damping=0.2 * 180 / np.pi),
            "bend",
            damping=0.3 * 180 / np.pi,
        ),
        (
            Row(
                "yaw",
                Q.DAMPING,
                180 / np.pi - 1,
                "damping of 3 joints times 57.2958 (rad against degrees)",
                3,
            ),
        ),
    ),
    "no armature": Plant(
        "walker",
        lambda r: with_every_joint(r, armature=0.0),
        (
            Row(
                "left_hip_roll",
                Q.ARMATURE,
                1.0,
                "only in one robot",
                6,
            ),
        ),
    ),
    "no damping": Plant(
        "arm",
        lambda r: with_every_joint(r, damping=0.0),
        (Row("yaw", Q.DAMPING, 1.0, "only in one robot", 4),),
    ),
    "knees weaker": Plant(
        "walker",
        lambda r: with_joint(with_joint(r, "left_knee", effort=35.0), "right_knee", effort=35.0),
        (Row("left_knee", Q.EFFORT, 0.3, "the same at 2 joints", 2),),
    ),
    "limits wider on both sides": Plant(
        "walker",
        lambda r: with_joint(
            with_joint(r, "left_hip_roll", limits=(-0.4, 0.7)), "right_hip_roll", limits=(-0.7, 0.4)
        ),
        (Row("left_hip_roll", Q.LIMITS, 0.1, "the same at 2 joints", 2),),
    ),
}


def rows_of(first: Robot, second: Robot, alignment: Alignment | None = None) -> list[Difference]:
    """Return the true differences of two robots whose files have nine digits."""
    found = differences(as_file(first, 9), as_file(second, 9), alignment or aligned(first, second), None)
    return [row for row in found if row.standing is Standing.DIFFERENT]


def assert_named(found: list[Difference], expected: list[Row]) -> None:
    """Assert that the rows are the expected ones, in any order."""
    assert sorted((row.element, row.quantity) for row in found) == sorted(
        (row.element, row.quantity) for row in expected
    ), found
    by_key = {(row.element, row.quantity): row for row in found}
    for row in expected:
        own = by_key[row.element, row.quantity]
        # Sizes are given with two digits where they follow from an eigenvalue problem
        assert own.size == pytest.approx(row.size, rel=0.02)
        assert row.cause in own.cause
        assert len(own.elements) == row.count
        assert own.uncertainty < own.size


@pytest.mark.parametrize("name", PLANTS)
def test_a_planted_change_is_the_only_row(name):
    plant = PLANTS[name]
    robot = ROBOTS[plant.robot]()
    assert_named(rows_of(robot, plant.change(robot)), [*plant.rows])


def together() -> list[tuple[str, ...]]:
    """Return names of two and three changes of one robot whose elements are not the same."""
    alone = {
        "masses in g",
        "two links exchanged",
        "masses in pounds, inertias not",
        "lengths in mm",
        "no mass",
        "all drives dropped",
        "kind",
        "coupling dropped",
        "loop dropped",
        "no damping",
        "no armature",
        "damping in degrees",
        "drive added",
        "body added",
    }
    names = [name for name in PLANTS if name not in alone]
    random = np.random.default_rng(3)
    found = []
    for count in (2, 3):
        choices = [
            several
            for several in combinations(names, count)
            if len({PLANTS[name].robot for name in several}) == 1
            and len({row.element for name in several for row in PLANTS[name].rows})
            == sum(len({row.element for row in PLANTS[name].rows}) for name in several)
            and len({row.quantity for name in several for row in PLANTS[name].rows})
            == sum(len({row.quantity for row in PLANTS[name].rows}) for name in several)
        ]
        found += [choices[i] for i in random.choice(len(choices), 20, replace=False)]
    return found


@pytest.mark.parametrize("names", together(), ids=" and ".join)
def test_two_and_three_planted_changes_are_all_named(names):
    robot = changed = ROBOTS[PLANTS[names[0]].robot]()
    for name in names:
        changed = PLANTS[name].change(changed)
    assert_named(rows_of(robot, changed), [row for name in names for row in PLANTS[name].rows])


TURNED = Placement(np.array([0.01, 0.02, -0.03]), turn("x", 0.3) @ turn("z", 1.0))


@dataclass(frozen=True)
class Rewriting:
    """Another way to write one robot, with the alignment that tells it."""

    robot: str
    change: Callable[[Robot], Robot]
    senses: dict[str, int]
    offsets: dict[str, float]
    conventions: set[Quantity]
    prefix: str = ""


SAME = {
    "frame": Rewriting("arm", lambda r: with_frame(r, "fore", TURNED), {}, {}, {Q.FRAME}),
    "frame of the last link": Rewriting(
        "walker", lambda r: with_frame(r, "left_shin", TURNED), {}, {}, {Q.FRAME}
    ),
    "frame of the root": Rewriting("walker", lambda r: with_frame(r, "trunk", TURNED), {}, {}, {Q.FRAME}),
    "frames of all links": Rewriting(
        "linkage",
        lambda r: with_frame(with_frame(with_frame(r, "rod", TURNED), "bob", TURNED), "rocker", TURNED),
        {},
        {},
        {Q.FRAME},
    ),
    "sign": Rewriting("arm", lambda r: with_sign(r, "lift"), {"lift": -1}, {}, {Q.SIGN}),
    "sign of a slide": Rewriting("arm", lambda r: with_sign(r, "reach"), {"reach": -1}, {}, {Q.SIGN}),
    "zero": Rewriting("arm", lambda r: with_zero(r, "bend", 0.5), {}, {"bend": 0.5}, {Q.ZERO}),
    "zero of a slide": Rewriting("arm", lambda r: with_zero(r, "reach", 0.1), {}, {"reach": 0.1}, {Q.ZERO}),
    "zero and sign": Rewriting(
        "linkage",
        lambda r: with_zero(with_sign(r, "pivot"), "pivot", 0.2),
        {"pivot": -1},
        {"pivot": 0.2},
        {Q.ZERO, Q.SIGN},
    ),
    "names of bodies": Rewriting("walker", lambda r: with_prefix(r, "robot_"), {}, {}, set(), "robot_"),
    "place of the robot": Rewriting("arm", lambda r: moved(r, "base", [0, 0, 0.12]), {}, {}, {Q.BASE}),
    "place of a robot without base": Rewriting(
        "linkage", lambda r: moved(moved(r, "crank", [0, 0, 0.5]), "rocker", [0, 0, 0.5]), {}, {}, {Q.BASE}
    ),
    "gear of a drive in its gain": Rewriting(
        "arm", lambda r: with_drive(r, "lift_motor", gears={"lift": 1.0}, gain=50.0), {}, {}, set()
    ),
    "coupling the other way round": Rewriting(
        "linkage",
        lambda r: replace(r, couplings=(FileCoupling("grip", "open", "close", (0.0, -1.0)),)),
        {},
        {},
        set(),
    ),
}


@pytest.mark.parametrize("name", SAME)
def test_another_way_to_write_the_robot_is_no_difference(name):
    way = SAME[name]
    first = ROBOTS[way.robot]()
    second = way.change(first)
    alignment = aligned(first, second, way.senses, way.offsets, prefix=way.prefix)
    found = differences(as_file(first, 9), as_file(second, 9), alignment, None)
    assert not [row for row in found if row.standing is Standing.DIFFERENT]
    conventions = [row for row in found if row.standing is Standing.CONVENTION]
    assert {row.quantity for row in conventions} == way.conventions
    assert all(row.effect == 0.0 for row in conventions)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("robot", ROBOTS)
def test_rounding_to_six_digits_is_no_difference(robot, seed):
    first = ROBOTS[robot]()
    second = to_digits(first, 6, np.random.default_rng(seed))
    found = differences(as_file(first), as_file(second), aligned(first, second), None)
    assert {row.standing for row in found} == {Standing.ROUNDING}
    assert {Quantity.CENTER, Quantity.INERTIA} <= {row.quantity for row in found}


@pytest.mark.parametrize("robot", ROBOTS)
def test_a_copy_with_six_digits_and_other_frames_is_no_difference(robot):
    first = ROBOTS[robot]()
    second = first
    for each in first.bodies:
        second = with_frame(second, each.name, TURNED)
    second = to_digits(second)
    found = differences(as_file(first, 15), as_file(second), aligned(first, second), None)
    assert not [row for row in found if row.standing is Standing.DIFFERENT]


def test_a_tolerance_takes_the_place_of_the_digits():
    first = arm()
    second = with_body(first, "fore", mass=1.5 * 1.004)
    for tolerance, standing in ((0.005, Standing.ROUNDING), (0.003, Standing.DIFFERENT)):
        (row,) = differences(as_file(first), as_file(second), aligned(first, second), tolerance)
        assert row.standing is standing
        assert row.size == pytest.approx(0.004, rel=1e-6)
        assert row.uncertainty == tolerance


def test_models_in_memory_have_no_digits_to_lose():
    first = arm()
    second = with_body(first, "fore", mass=1.5 * (1 + 1e-9))
    (row,) = differences(RobotFile(first), RobotFile(second), aligned(first, second), None)
    assert row.standing is Standing.DIFFERENT
    assert row.size == pytest.approx(1e-9, rel=1e-6)


def test_digits_of_the_first_axis_do_not_tilt_a_base_whose_frame_is_turned(tmp_path):
    # The second base has its frame turned by 90 degrees. Half a turn, 3.14159 and -3.14159, leaves the axis
    # open by 5.3e-6 rad, twice the part of pi that is cut off
    base = """<robot name="{0}"><link name="base"><inertial><mass value="1"/><origin xyz="{1}"/>
        <inertia {2}/></inertial></link><link name="arm"><inertial><mass value="1"/>
        <origin xyz="0.1 0.02 0.03"/><inertia ixx="0.001" ixy="0.0001" ixz="0.0002" iyy="0.002" iyz="0.0003"
        izz="0.0025"/></inertial></link><joint name="pan" type="revolute"><parent link="base"/>
        <child link="arm"/><origin xyz="{3}" rpy="{4}"/><axis xyz="0 0 1"/>
        <limit lower="-1" upper="1" effort="1" velocity="1"/></joint></robot>"""
    files = []
    for name, center, inertia, origin, angles in (
        (
            "first",
            "0.0137179 -0.00052 0.0334843",
            'ixx="1.1e-4" iyy="1.4e-4" izz="1.3e-4" ixy="-4e-6" ixz="5e-6" iyz="1e-6"',
            "0.0388353 0 0.0624",
            "3.14159 0 -3.14159",
        ),
        (
            "second",
            "0.00052 0.0137179 0.0334843",
            'ixx="1.4e-4" iyy="1.1e-4" izz="1.3e-4" ixy="4e-6" ixz="-1e-6" iyz="5e-6"',
            "0 0.0388353 0.0624",
            "-3.14159 0 -1.5708",
        ),
    ):
        path = tmp_path / f"{name}.urdf"
        path.write_text(base.format(name, center, inertia, origin, angles), encoding="utf-8")
        files.append(describe(path))
    first, second = files
    found = differences(first, second, align(first.robot, second.robot, {}), None)
    assert Standing.DIFFERENT not in {row.standing for row in found}
    assert Quantity.BASE in {row.quantity for row in found if row.standing is Standing.CONVENTION}


def test_a_reversed_axis_whose_limits_are_not_mirrored_is_one_difference():
    first = arm()
    second = reversed_axis(first, "yaw")
    (row,) = rows_of(first, second, aligned(first, second, senses={"yaw": -1}))
    assert (row.element, row.quantity) == ("yaw", Quantity.SIGN)
    words = "the joint counts the other way, its drive pushes the other way, limits not mirrored"
    assert row.cause == words
    assert (row.size, row.standing) == (1.0, Standing.DIFFERENT)


def test_a_reversed_axis_with_symmetric_limits_differs_unless_its_gear_is_reversed():
    first = walker()
    second = reversed_axis(first, "left_hip_pitch")
    alignment = aligned(first, second, senses={"left_hip_pitch": -1})
    (row,) = differences(as_file(first), as_file(second), alignment, None)
    assert (row.element, row.quantity, row.standing) == ("left_hip_pitch", Quantity.SIGN, Standing.DIFFERENT)
    assert row.cause == "the joint counts the other way, its drive pushes the other way"
    with_gear = with_drive(second, "left_hip_pitch_motor", gears={"left_hip_pitch": -1.0})
    (row,) = differences(as_file(first), as_file(with_gear), alignment, None)
    assert (row.standing, row.cause) == (Standing.CONVENTION, "the joint counts the other way")


@pytest.mark.parametrize(
    ("limits", "standing"), [((-np.inf, np.inf), Standing.DIFFERENT), ((-1.0, 2.0), Standing.CONVENTION)]
)
def test_a_servo_at_another_zero_holds_another_position_unless_limits_show_that_it_is_meant(
    limits: tuple[float, float], standing: Standing
):
    first = with_joint(arm(), "yaw", limits=limits)
    second = with_zero(first, "yaw", 0.4)
    (row,) = differences(as_file(first), as_file(second), aligned(first, second, offsets={"yaw": 0.4}), None)
    assert (row.quantity, row.second, row.standing) == (Quantity.ZERO, pytest.approx(0.4), standing)


def test_a_file_with_few_decimals_is_one_difference():
    first = second = walker()
    for number, each in enumerate(first.bodies):
        center = each.center + 1e-4 * np.array([1.7, 2.3, -3.1]) * (number + 1)
        first = with_body(first, each.name, center=center)
        second = with_body(second, each.name, center=np.round(center, 3))
    (row,) = rows_of(first, second)
    assert row.quantity is Quantity.CENTER
    assert row.cause == "7 numbers are rounded to 3 decimals in the second file"
    assert row.size < 0.5e-3 * np.sqrt(3)


def test_masses_that_one_file_lacks_are_not_rounded():
    first = walker()
    for number, each in enumerate(first.bodies):
        first = with_body(first, each.name, mass=1e-4 * (number + 1))
    second = first
    for each in first.bodies:
        second = with_body(second, each.name, mass=0.0)
    assert not any("rounded" in row.cause for row in rows_of(first, second))


def test_a_moved_zero_without_moved_limits_is_one_difference():
    first = arm()
    second = with_joint(first, "bend", zero=0.5)
    (row,) = rows_of(first, second, aligned(first, second, offsets={"bend": 0.5}))
    assert (row.element, row.quantity, row.second) == ("bend", Quantity.ZERO, 0.5)
    assert row.cause == "the joint counts from another zero, limits not moved"


def test_a_link_that_is_turned_at_its_parent_is_not_hidden_by_the_last_digit_of_its_axis():
    """The axis in the frame of the link differs by 1e-7 rad, as an axis of "0 1 1e-7" does."""
    first = arm()
    fore = body_of(first, "fore")
    turned = Placement(fore.placement.position, fore.placement.rotation @ turn("x", 0.5))
    second = with_body(first, "fore", placement=turned)
    second = with_joint(second, "lift", axis=np.array([0.0, 1.0, 1e-7]))
    (axis,) = (row for row in rows_of(first, second) if row.quantity is Quantity.JOINT_AXIS)
    # the sum of both turns, the small one within its size
    assert axis.size == pytest.approx(0.5, abs=2e-7)
    assert axis.cause == "the link is turned at its parent by 28.65 degrees"


def test_values_are_in_the_frame_zero_and_sign_of_the_first_file():
    first = arm()
    second = with_zero(with_sign(with_frame(first, "fore", TURNED), "lift"), "lift", 0.4)
    second = with_joint(second, "lift", limits=(-1.2 + 0.4, 1.6 + 0.4))
    fore = body_of(second, "fore")
    second = with_body(second, "fore", center=fore.center + TURNED.rotation.T @ np.array([0.01, 0, 0]))
    alignment = aligned(first, second, {"lift": -1}, {"lift": 0.4}, {"fore": TURNED})
    center, limits = rows_of(first, second, alignment)
    assert (center.quantity, limits.quantity) == (Quantity.CENTER, Quantity.LIMITS)
    assert center.first == pytest.approx((0.15, 0.01, 0.02), abs=1e-8)
    assert center.second == pytest.approx((0.16, 0.01, 0.02), abs=1e-8)
    assert limits.first == pytest.approx((-1.5, 1.2))
    assert limits.second == pytest.approx((-1.6, 1.2))


def test_a_chain_of_links_without_mass_is_a_body_with_two_joints():
    universal = with_body(
        arm(), "fore", joints=(hinge("lift", [0, 1, 0], damping=0.1), hinge("twist", [1, 0, 0], damping=0.2))
    )
    fore = body_of(universal, "fore")
    carrier = replace(
        fore, name="carrier", joints=fore.joints[:1], mass=0.0, center=np.zeros(3), inertia=np.zeros((3, 3))
    )
    turning = replace(fore, parent=2, placement=at(0, 0, 0), joints=fore.joints[1:])
    later = tuple(replace(link, parent=link.parent + 1) for link in universal.bodies[3:])
    chain = replace(universal, bodies=(*universal.bodies[:2], carrier, turning, *later))
    assert not rows_of(universal, chain)
    changed = with_joint(chain, "twist", axis=np.array([np.cos(0.1), np.sin(0.1), 0]))
    (row,) = rows_of(universal, changed)
    assert (row.element, row.quantity) == ("twist", Quantity.JOINT_AXIS)
    assert row.size == pytest.approx(0.1)


def test_a_floating_base_that_the_other_file_fixes_is_one_row():
    first = walker()
    second = with_body(first, "trunk", joints=())
    alignment = replace(aligned(first, second), base="floating in the first, fixed in the second")
    (row,) = rows_of(first, second, alignment)
    assert (row.quantity, row.element_kind) == (Quantity.BASE, "model")
    assert (row.first, row.second) == ("floating", "fixed")


def test_a_file_without_drives_has_the_efforts_of_the_drives_of_the_other_file():
    first = with_every_joint(walker(), effort=np.inf)
    second = replace(walker(), drives=())
    (row,) = rows_of(first, second)
    assert (row.element_kind, row.quantity, len(row.elements)) == ("drive", Quantity.PRESENCE, 6)
    found = differences(as_file(first), as_file(second, format="URDF"), aligned(first, second), None)
    assert [each.cause for each in found] == ["URDF has none"]
    weaker = with_drive(first, "left_knee_motor", control_limits=(-35, 35))
    _, row = sorted(rows_of(weaker, second), key=lambda row: row.element_kind)
    assert (row.element, row.quantity, row.first, row.second) == ("left_knee", Quantity.EFFORT, 35.0, 50.0)


def test_an_effort_of_a_joint_that_nothing_drives_is_no_difference():
    """URDF requires an effort, and the MJCF has none at a passive joint."""
    first = replace(with_joint(walker(), "left_knee", effort=np.inf), drives=())
    files = as_file(first), as_file(replace(walker(), drives=()), format="URDF")
    (row,) = differences(*files, aligned(first, walker()), None)
    assert (row.element, row.quantity, row.standing) == ("left_knee", Quantity.EFFORT, Standing.CONVENTION)
    # both files state one: they differ
    first = replace(with_joint(walker(), "left_knee", effort=35.0), drives=())
    (row,) = differences(as_file(first), files[1], aligned(first, walker()), None)
    assert row.standing is Standing.DIFFERENT
    # controllers of two URDFs read the efforts
    first = replace(with_joint(walker(), "left_knee", effort=np.inf), drives=())
    (row,) = differences(as_file(first, format="URDF"), files[1], aligned(first, walker()), None)
    assert row.standing is Standing.DIFFERENT


def test_efforts_of_each_direction_are_compared_in_the_sense_of_the_first_file() -> None:
    text = """<mujoco><worldbody><body name="arm"><joint name="turn" axis="0 {0} 0"{1}/>
      <inertial pos="0.1 0 0" mass="1" diaginertia="1 1 1"/></body></worldbody></mujoco>"""
    texts = [
        text.format(axis, f' limited="true" range="{low} {high}" actuatorfrcrange="{efforts}"')
        for axis, low, high, efforts in (
            (1, -20, 40, "-10 20"), (1, -20, 40, "-20 20"), (-1, -40, 20, "-20 10")
        )
    ]  # fmt: skip
    first, both, reversed_joint = (describe_mjcf(mujoco.MjModel.from_xml_string(each)) for each in texts)
    (row,) = rows_of(first.robot, both.robot)
    assert (row.quantity, row.first, row.second) == (Quantity.EFFORT, (-10.0, 20.0), 20.0)
    pairs = align(first.robot, reversed_joint.robot, {})
    assert [pair.sense for pair in pairs.joints] == [-1]
    rows = differences(first, reversed_joint, pairs, None)
    assert Quantity.SIGN in {row.quantity for row in rows}
    assert not {Quantity.EFFORT, Quantity.LIMITS} & {row.quantity for row in rows}


def test_three_slides_and_a_ball_let_the_base_float_as_a_free_joint_does():
    first = walker()
    ball = FileJoint("turn", JointKind.BALL, np.zeros(3), np.zeros(3))
    slides = [FileJoint(f"move_{k}", JointKind.SLIDE, np.eye(3)[k], np.zeros(3)) for k in range(3)]

    def kinds(*joints):
        second = with_body(first, "trunk", joints=joints)
        pairs = aligned(with_body(first, "trunk", joints=()), with_body(second, "trunk", joints=()))
        groups = (JointGroups(((0, 0),), tuple((0, number) for number in range(len(joints)))),)
        return differences(as_file(first), as_file(second), replace(pairs, groups=groups), None)

    (row,) = kinds(*slides, ball)
    assert (row.quantity, row.standing, row.cause) == (
        Quantity.KIND,
        Standing.CONVENTION,
        "the body floats in both files",
    )
    # A slide twice, and a slide with damping, do not let the base float freely
    for held in ((slides[0], slides[0], slides[2]), (replace(slides[0], damping=1.0), *slides[1:])):
        (row,) = kinds(*held, ball)
        assert (row.quantity, row.standing) == (Quantity.KIND, Standing.DIFFERENT)


def test_lengths_in_millimeters_are_one_row_if_links_have_fixed_parts():
    # At three links, a part that is fixed at some distance from the frame of the link
    parts = [body(f"part_{k}", k, [0.03, 0.05, 0.02 * k], [], 0.3, [0.01, 0, 0.02]) for k in (1, 2, 3)]
    first = replace(walker(), bodies=(*walker().bodies, *parts))
    second = scaled_lengths(first, 1000.0)
    (row,) = rows_of(first, second, align(first, second, {}))
    assert "lengths times 1000 (m against mm)" in row.cause


def test_a_joint_with_another_parent_is_one_row():
    first = walker()
    shin = body_of(first, "left_shin")
    here, there = first.placements()[3], first.placements()[0]
    second = with_body(first, "left_shin", parent=0, placement=there.inverse() @ here)
    assert shin.parent == 2
    (row,) = rows_of(first, second)
    assert (row.element, row.quantity) == ("left_knee", Quantity.PARENT)
    assert (row.first, row.second) == ("left_thigh", "trunk")


def test_couplings_of_joints_that_a_reduced_robot_lacks_are_compared_by_their_names():
    coupling = FileCoupling("mimic", "gone", "lost", (0.0, 2.0))
    first = replace(arm(), couplings=(coupling,))
    assert not rows_of(first, first)
    (row,) = rows_of(first, replace(first, couplings=(replace(coupling, powers=(0.0, 2.5)),)))
    assert (row.element, row.quantity, row.size) == ("mimic", Quantity.COUPLING, 0.5)
    assert (row.first, row.second) == ((0.0, 2.0), (0.0, 2.5))


def test_every_quantity_has_a_unit():
    assert unit(Quantity.DAMPING) == "N m s/rad"
    assert unit(Quantity.DAMPING, slide=True) == "N s/m"
    assert {unit(quantity) for quantity in Quantity} >= {"kg", "m", "rad", "kg m^2", ""}


def test_thirty_bodies_take_less_than_three_tenths_of_a_second():
    bodies = [
        body(
            "link0",
            -1,
            [0, 0, 1],
            [FileJoint("root", JointKind.FREE, np.zeros(3), np.zeros(3))],
            3.0,
            [0, 0, 0.1],
        )
    ]
    for n in range(1, 30):
        joint = hinge(f"joint{n}", [0, 1, 0], limits=(-1.5, 1.5), damping=0.1, armature=0.01, effort=50)
        bodies.append(
            body(
                f"link{n}", (n - 1) // 2, [0.1, 0.02, 0.03], [joint], 1.0, [0.05, 0.01, 0.02], turn("x", 0.3)
            )
        )
    first = as_file(Robot("tree", tuple(bodies)), 9)
    second = as_file(to_digits(first.robot))
    alignment = aligned(first.robot, second.robot)
    start = time.process_time()
    found = differences(first, second, alignment, None)
    # 0.15 s on the slowest computer at hand
    assert time.process_time() - start < 0.3
    assert {row.standing for row in found} <= {Standing.ROUNDING}
