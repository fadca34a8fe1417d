"""Robots as model files describe them, changes of one thing, and other ways to write the same robot."""

from __future__ import annotations

import math
from dataclasses import fields, replace
from typing import Any

import numpy as np

from crosscheck.differences.alignment import Alignment, BodyPair, JointPair
from newton_euler.reading.robot import (
    IN_PLACE,
    FileBody,
    FileCoupling,
    FileDrive,
    FileJoint,
    FileLoop,
    JointKind,
    LoopKind,
    Placement,
    Robot,
    RobotFile,
)
from newton_euler.scalars import Array


def at(x: float, y: float, z: float) -> Placement:
    """Return a frame at a position, m, that is not turned."""
    return Placement(np.array([x, y, z], dtype=float), np.eye(3))


def turn(axis: str, angle: float) -> Array:
    """Return the rotation matrix by an angle, rad, about x, y or z."""
    sine, cosine = math.sin(angle), math.cos(angle)
    one, two = {"x": (1, 2), "y": (2, 0), "z": (0, 1)}[axis]
    rotation = np.eye(3)
    rotation[one, one] = rotation[two, two] = cosine
    rotation[one, two], rotation[two, one] = -sine, sine
    return rotation


def hinge(name: str, axis: list[float], **numbers: Any) -> FileJoint:
    """Return a hinge through the origin of its body; its effort is the same in both directions."""
    if "effort" in numbers:
        numbers["effort"] = (-numbers["effort"], numbers["effort"])
    return FileJoint(name, JointKind.HINGE, np.array(axis, dtype=float), np.zeros(3), **numbers)


def body(
    name: str,
    parent: int,
    position: list[float],
    joints: list[FileJoint],
    mass: float,
    center: list[float],
    rotation: Array | None = None,
    scale: float = 1.0,
) -> FileBody:
    """Return a body whose inertia has distinct moments and all products."""
    inertia = mass * scale * np.array([[2e-3, 3e-4, 1e-4], [3e-4, 3e-3, 2e-4], [1e-4, 2e-4, 4e-3]])
    placement = Placement(np.array(position), np.eye(3) if rotation is None else rotation)
    return FileBody(name, parent, placement, tuple(joints), mass, np.array(center), inertia)


def arm() -> Robot:
    """Return an arm on a fixed base: three hinges, a slide and a tool that is fixed to the last link."""
    slide = FileJoint("reach", JointKind.SLIDE, np.array([1.0, 0, 0]), np.zeros(3), limits=(0.0, 0.4))
    links = (
        body("base", -1, [0, 0, 0.1], [], 5.0, [0, 0, 0.05]),
        body(
            "upper",
            0,
            [0, 0, 0.2],
            [hinge("yaw", [0, 0, 1], limits=(-1, 2), damping=0.1, effort=50)],
            2.0,
            [0.01, 0.02, 0.1],
        ),
        body(
            "fore",
            1,
            [0, 0.1, 0.3],
            [hinge("lift", [0, 1, 0], limits=(-1.5, 1.2), damping=0.2, armature=0.02, effort=40)],
            1.5,
            [0.15, 0.01, 0.02],
            turn("x", 0.4),
        ),
        body(
            "wrist",
            2,
            [0.3, 0, 0.05],
            [hinge("bend", [0, 1, 0], limits=(-2, 2.5), damping=0.3, friction=0.5, effort=30)],
            0.8,
            [0.1, 0.02, 0.01],
        ),
        body("hand", 3, [0.2, 0.01, 0], [replace(slide, damping=2.0, speed=1.5)], 0.5, [0.03, 0.01, 0.02]),
        body("tool", 4, [0.05, 0, 0.01], [], 0.2, [0.01, 0.02, 0.03]),
    )
    drives = (
        FileDrive("yaw_servo", {"yaw": 1.0}, 100.0, -100.0, -5.0, control_limits=(-1, 2)),
        FileDrive("lift_motor", {"lift": 50.0}, 1.0, control_limits=(-1, 1)),
        FileDrive("bend_motor", {"bend": 20.0}, 1.0, control_limits=(-1, 1), force_limits=(-2, 2)),
    )
    return Robot("arm", links, drives=drives, gravity=np.array([0, 0, -9.81]))


def walker() -> Robot:
    """Return a floating trunk with two legs of three hinges, left and right mirrored."""
    links = [
        body(
            "trunk",
            -1,
            [0, 0, 0.6],
            [FileJoint("root", JointKind.FREE, np.zeros(3), np.zeros(3))],
            8.0,
            [0.01, 0, 0.05],
        )
    ]
    for side, sign in (("left", 1.0), ("right", -1.0)):
        start = len(links)
        outward = (-0.3, 0.7) if sign > 0 else (-0.7, 0.3)
        links += [
            body(
                f"{side}_hip",
                0,
                [0, sign * 0.1, 0],
                [hinge(f"{side}_hip_roll", [1, 0, 0], limits=outward, effort=80, armature=0.01)],
                1.2,
                [0.02, sign * 0.03, -0.02],
            ),
            body(
                f"{side}_thigh",
                start,
                [0, sign * 0.02, -0.05],
                [hinge(f"{side}_hip_pitch", [0, 1, 0], limits=(-1.57, 1.57), effort=80, armature=0.01)],
                2.5,
                [0.01, sign * 0.02, -0.12],
            ),
            body(
                f"{side}_shin",
                start + 1,
                [0.01, 0, -0.3],
                [hinge(f"{side}_knee", [0, 1, 0], limits=(0.0, 2.4), effort=50, armature=0.02)],
                1.7,
                [0.01, sign * 0.01, -0.1],
                turn("y", 0.3),
            ),
        ]
    mirror = np.diag([1.0, -1.0, 1.0])
    links = [
        replace(link, inertia=mirror @ link.inertia @ mirror) if link.name.startswith("right") else link
        for link in links
    ]
    drives = tuple(
        FileDrive(f"{joint.name}_motor", {joint.name: 1.0}, 1.0, control_limits=joint.effort)
        for link in links
        for joint in link.joints
        if joint.kind == JointKind.HINGE
    )
    return Robot("walker", tuple(links), drives=drives, gravity=np.array([0, 0, -9.81]))


def linkage() -> Robot:
    """Return a crank, a rod, a rocker that closes a loop, a ball pendulum and two coupled fingers."""
    pivot = hinge("pivot", [0, 1, 0], stiffness=3.0, rest=0.2)
    opening = hinge("open", [0, 0, 1], zero=0.1, limits=(0, 0.8))
    closing = hinge("close", [0, 0, 1], limits=(-0.8, 0))
    ball = FileJoint("swing", JointKind.BALL, np.zeros(3), np.array([0, 0, 0.1]))
    links = (
        body("crank", -1, [0, 0, 0], [hinge("drive", [0, 1, 0])], 0.4, [0.05, 0.01, 0.02]),
        body("rod", 0, [0.1, 0, 0], [hinge("pin", [0, 1, 0])], 0.9, [0.15, 0.02, 0.01], turn("y", -0.5)),
        body(
            "rocker",
            -1,
            [0.4, 0, 0],
            [pivot],
            0.6,
            [0.01, 0, 0.1],
        ),
        body("bob", 2, [0, 0, 0.2], [ball], 0.3, [0.01, 0.02, -0.05]),
        body(
            "finger",
            1,
            [0.1, 0.1, 0],
            [opening],
            0.1,
            [0.03, 0, 0],
        ),
        body("thumb", 1, [0.1, -0.1, 0], [closing], 0.12, [0.03, 0, 0]),
    )
    loops = (
        FileLoop(
            "pin_loop",
            LoopKind.POINT,
            1,
            2,
            Placement(np.array([0.3, 0, 0]), np.eye(3)),
            Placement(np.array([0.0, 0, 0.2]), np.eye(3)),
        ),
        FileLoop("tie", LoopKind.ROD, 0, 3, IN_PLACE, IN_PLACE, 0.45),
    )
    couplings = (FileCoupling("grip", "close", "open", (0.0, -1.0)),)
    drives = (
        FileDrive("crank_motor", {"drive": 2.0}, 3.0),
        FileDrive("grip_tendon", {"open": 0.5, "close": -0.5}, 10.0),
    )
    return Robot("linkage", links, loops, couplings, drives, np.array([0, 0, -9.81]))


# Changes of one thing


def with_body(robot: Robot, name: str, **changes: Any) -> Robot:
    """Return a robot in which fields of one body are replaced."""
    assert name in {each.name for each in robot.bodies}
    found = [replace(each, **changes) if each.name == name else each for each in robot.bodies]
    return replace(robot, bodies=tuple(found))


def with_joint(robot: Robot, name: str, **changes: Any) -> Robot:
    """Return a robot in which fields of one joint are replaced; an effort is that of both directions."""
    if "effort" in changes:
        changes["effort"] = (-changes["effort"], changes["effort"])
    bodies = [
        replace(link, joints=tuple(replace(j, **changes) if j.name == name else j for j in link.joints))
        for link in robot.bodies
    ]
    return replace(robot, bodies=tuple(bodies))


def with_every_joint(robot: Robot, **changes: Any) -> Robot:
    """Return a robot in which fields of all hinges and slides are replaced."""
    for link in robot.bodies:
        for joint in link.joints:
            if joint.kind in (JointKind.HINGE, JointKind.SLIDE):
                robot = with_joint(robot, joint.name, **changes)
    return robot


def with_drive(robot: Robot, name: str, **changes: Any) -> Robot:
    """Return a robot in which fields of one drive are replaced."""
    assert name in {each.name for each in robot.drives}
    drives = [replace(each, **changes) if each.name == name else each for each in robot.drives]
    return replace(robot, drives=tuple(drives))


def body_of(robot: Robot, name: str) -> FileBody:
    """Return a body by its name."""
    return next(each for each in robot.bodies if each.name == name)


def joint_of(robot: Robot, name: str) -> FileJoint:
    """Return a joint by its name."""
    return next(joint for link in robot.bodies for joint in link.joints if joint.name == name)


def moved(
    robot: Robot, name: str, position: list[float] | None = None, rotation: Array | None = None
) -> Robot:
    """Return a robot in which a body, with all that it carries, is moved and turned at its parent."""
    placement = body_of(robot, name).placement
    position = placement.position + np.array(position or [0.0, 0, 0])
    rotation = placement.rotation if rotation is None else rotation @ placement.rotation
    return with_body(robot, name, placement=Placement(position, rotation))


# Other ways to write the same robot


def with_frame(robot: Robot, name: str, frame: Placement) -> Robot:
    """Return the same robot with another frame of one body, given in the body's present frame."""
    index = next(i for i, each in enumerate(robot.bodies) if each.name == name)
    back = frame.inverse()
    bodies = []
    for i, link in enumerate(robot.bodies):
        if i == index:
            joints = tuple(
                replace(
                    joint,
                    axis=back.rotation @ joint.axis,
                    point=back.position + back.rotation @ joint.point,
                )
                for joint in link.joints
            )
            link = replace(
                link,
                placement=link.placement @ frame,
                joints=joints,
                center=back.position + back.rotation @ link.center,
                inertia=back.rotation @ link.inertia @ back.rotation.T,
            )
        elif link.parent == index:
            link = replace(link, placement=back @ link.placement)
        bodies.append(link)
    loops = [
        replace(
            loop,
            first_frame=back @ loop.first_frame if loop.first == index else loop.first_frame,
            second_frame=back @ loop.second_frame if loop.second == index else loop.second_frame,
        )
        for loop in robot.loops
    ]
    return replace(robot, bodies=tuple(bodies), loops=tuple(loops))


def with_sign(robot: Robot, name: str) -> Robot:
    """Return the same robot with a joint that counts the other way, its limits mirrored."""
    joint = joint_of(robot, name)
    low, high = joint.limits
    return with_joint(robot, name, axis=-joint.axis, zero=-joint.zero, limits=(-high, -low), rest=-joint.rest)


def with_zero(robot: Robot, name: str, shift: float) -> Robot:
    """Return the same robot with a joint whose coordinates are larger by a shift."""
    joint = joint_of(robot, name)
    low, high = joint.limits
    return with_joint(
        robot,
        name,
        zero=joint.zero + shift,
        limits=(low + shift, high + shift),
        rest=joint.rest + shift if joint.stiffness else joint.rest,
    )


def with_prefix(robot: Robot, prefix: str) -> Robot:
    """Return the same robot with a prefix before all names of bodies."""
    return replace(robot, bodies=tuple(replace(each, name=prefix + each.name) for each in robot.bodies))


# Files and alignments


def to_digits(robot: Robot, digits: int = 6, random: np.random.Generator | None = None) -> Robot:
    """Return a robot with all numbers rounded to some digits, or moved at random by half of the last one."""

    def number(value: float) -> float:
        if value == 0 or not math.isfinite(value) or value == round(value):
            return value
        if random is None:
            return float(f"{value:.{digits}g}")
        unit = 10.0 ** (math.floor(math.log10(abs(value))) - digits + 1)
        return value + 0.5 * unit * random.choice((-1, 1))

    def array(values: Array) -> Array:
        return np.array([number(each) for each in values.ravel()]).reshape(values.shape)

    def symmetric(values: Array) -> Array:
        upper = np.triu(array(values))
        return upper + np.triu(upper, 1).T

    def orthogonal(rotation: Array) -> Array:
        left, _, right = np.linalg.svd(array(rotation))
        return left @ right

    def of_joint(joint: FileJoint) -> FileJoint:
        changes = {
            field.name: number(value)
            for field in fields(joint)
            if isinstance(value := getattr(joint, field.name), float | int)
        }
        axis = array(joint.axis)
        return replace(
            joint,
            **changes,
            axis=axis / (np.linalg.norm(axis) or 1.0),
            point=array(joint.point),
            limits=tuple(map(number, joint.limits)),
        )

    def of_frame(frame: Placement) -> Placement:
        return Placement(array(frame.position), orthogonal(frame.rotation))

    bodies = tuple(
        replace(
            link,
            placement=of_frame(link.placement),
            joints=tuple(map(of_joint, link.joints)),
            mass=number(link.mass),
            center=array(link.center),
            inertia=symmetric(link.inertia),
        )
        for link in robot.bodies
    )
    loops = tuple(
        replace(
            loop,
            first_frame=of_frame(loop.first_frame),
            second_frame=of_frame(loop.second_frame),
            length=number(loop.length),
        )
        for loop in robot.loops
    )
    return replace(robot, bodies=bodies, loops=loops)


def as_file(robot: Robot, digits: int = 6, count: int = 16, format: str = "MJCF") -> RobotFile:
    """Return the file that has a robot's numbers with some digits, at most six, with its variants."""
    written = to_digits(robot, digits)
    random = np.random.default_rng(5)
    variants = tuple(to_digits(written, min(digits, 6), random) for _ in range(count))
    return RobotFile(written, variants, format=format)


def aligned(
    first: Robot,
    second: Robot,
    senses: dict[str, int] | None = None,
    offsets: dict[str, float] | None = None,
    placements: dict[str, Placement] | None = None,
    prefix: str = "",
) -> Alignment:
    """Return the alignment of two robots by names; bodies without joints are one with their parent.

    Args:
        first, second: the robots.
        senses, offsets: of joints that count the other way or from another zero.
        placements: of frames of the second robot's bodies in those of the first robot.
        prefix: what names of bodies have in the second robot only.
    """

    def groups(robot: Robot, prefix: str = "") -> dict[str, tuple[int, ...]]:
        roots: list[int] = []
        found: dict[int, list[int]] = {}
        for index, link in enumerate(robot.bodies):
            fixed = link.parent >= 0 and not link.joints
            roots.append(roots[link.parent] if fixed else index)
            found.setdefault(roots[index], []).append(index)
        return {robot.bodies[root].name.removeprefix(prefix): tuple(own) for root, own in found.items()}

    def keys(robot: Robot) -> dict[str, tuple[int, int]]:
        return {
            joint.name: (i, n) for i, link in enumerate(robot.bodies) for n, joint in enumerate(link.joints)
        }

    own, other = groups(first), groups(second, prefix)
    joints, other_joints = keys(first), keys(second)
    return Alignment(
        tuple(
            BodyPair(own[name], other[name], (placements or {}).get(name, IN_PLACE))
            for name in own
            if name in other
        ),
        tuple(
            JointPair(key, other_joints[name], (senses or {}).get(name, 1), (offsets or {}).get(name, 0.0))
            for name, key in joints.items()
            if name in other_joints
        ),
        tuple(i for name in own if name not in other for i in own[name]),
        tuple(i for name in other if name not in own for i in other[name]),
        tuple(key for name, key in joints.items() if name not in other_joints),
        tuple(key for name, key in other_joints.items() if name not in joints),
    )
