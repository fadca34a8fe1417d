"""Places and inertia ellipsoids of the bodies of two robots in one pose, for a drawing of what differs.

In: two robot files, their `Alignment`, their common states and the rows of differences. Out: `Shapes`. Model
files are compared without their meshes: each body is drawn as the homogeneous ellipsoid with its mass, center
of mass and inertia, and with a line to its parent.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from crosscheck.differences.alignment import Alignment, JointKey
from crosscheck.differences.common_states import CommonStates
from crosscheck.differences.difference import Difference
from crosscheck.differences.links import composite, placed_masses
from newton_euler.reading.robot import Placement, Robot, RobotFile
from newton_euler.scalars import Array

SAME_PLACE = 1e-3
"""Distance relative to the size of the robot, and angle in rad, below which no displacement is visible."""


Vector = tuple[float, float, float]
"""Three numbers along the axes of the world."""


@dataclass(frozen=True)
class Shape:
    """Rigid body of a robot: bodies that are fixed to each other, in the pose of the first file.

    Attributes:
        name: name of the body next to the root.
        parent: index of the parent among the shapes of its robot; -1 for the ground.
        point: m in the world, a point of the joint to the parent, or the origin of a fixed body's frame.
        center: m in the world, center of mass.
        spread: m^2 in the world, matrix with the squares of the semi-axes of the ellipsoid as eigenvalues and
            the axes as eigenvectors; zeros for a body without mass.
        mass: kg.
        differs: whether a row is about the mass, the center of mass or the inertia of the body.
        joint_differs: whether a row is about the joint of the body, its drive, or a loop or coupling there.
        displaced: whether the body is at another place than its partner in the other file.
    """

    name: str
    parent: int
    point: Vector
    center: Vector
    spread: tuple[Vector, Vector, Vector]
    mass: float
    differs: bool
    joint_differs: bool
    displaced: bool


@dataclass(frozen=True)
class Mark:
    """Place of a row of the table of differences.

    Attributes:
        row: index of the row.
        point: (3,) m in the world.
    """

    row: int
    point: Vector


@dataclass(frozen=True)
class Shapes:
    """Rigid bodies of two robots in one pose.

    Attributes:
        first, second: bodies of each robot, parents before children.
        marks: places of rows that are about a body, a joint, a drive, a loop or a coupling.
    """

    first: tuple[Shape, ...]
    second: tuple[Shape, ...]
    marks: tuple[Mark, ...]


def shapes(
    files: tuple[RobotFile, RobotFile],
    alignment: Alignment,
    states: CommonStates | None,
    rows: Sequence[Difference],
) -> Shapes:
    """Describe the bodies of two robots for a drawing.

    Args:
        files: the robot files.
        alignment: their pairs of bodies and joints.
        states: their common states; None for robots without joints in common, which have their own poses.
        rows: true differences of the files.
    """
    robots = files[0].robot, files[1].robot
    poses = states.poses() if states else (robots[0].placements(), robots[1].placements())
    displaced = _displaced(poses, alignment)
    bodies: tuple[set[int], set[int]] = set(), set()
    joints: tuple[set[int], set[int]] = set(), set()
    marks = []
    for number, row in enumerate(rows):
        found = [_bodies_of(robot, row) for robot in robots]
        partners = _partners(alignment, row, found[0])
        found[1] = list(dict.fromkeys([*found[1], *partners]))
        for side, indices in enumerate(found):
            if not row.is_geometry:
                (bodies if row.is_of_body else joints)[side].update(indices)
        for side, indices in enumerate(found):
            if indices:
                body, pose = robots[side].bodies[indices[0]], poses[side][indices[0]]
                at = body.center if row.is_of_body else body.joint_point
                marks.append(Mark(number, _numbers(pose.point(at))))
                break
    first, second = (
        _shapes_of(
            robot,
            poses[side],
            [pair.first if side == 0 else pair.second for pair in alignment.bodies],
            (bodies[side], joints[side], displaced[side]),
        )
        for side, robot in enumerate(robots)
    )
    return Shapes(first, second, tuple(marks))


def _displaced(poses: tuple[list[Placement], list[Placement]], alignment: Alignment) -> tuple[set[int], ...]:
    """Return the bodies of both robots that are at other places than their partners."""
    origins = np.array([pose.position for pose in (*poses[0], *poses[1])])
    size = float(np.ptp(origins, axis=0).max(initial=0.0))
    found: tuple[set[int], set[int]] = set(), set()
    for pair in alignment.bodies:
        expected, pose = poses[0][pair.first[0]] @ pair.placement, poses[1][pair.second[0]]
        distance = float(np.linalg.norm(expected.position - pose.position))
        turn = float(np.linalg.norm(expected.rotation - pose.rotation))
        if distance > SAME_PLACE * size or turn > SAME_PLACE:
            found[0].update(pair.first)
            found[1].update(pair.second)
    return found


def _bodies_of(robot: Robot, row: Difference) -> list[int]:
    """Return the indices of bodies that a row is about, those of its first element first."""
    return list(dict.fromkeys(k for name in (row.element, *row.elements) for k in _bodies(robot, row, name)))


def _bodies(robot: Robot, row: Difference, name: str) -> Iterator[int]:
    """Yield the indices of bodies that have an element of a row: the bodies of a joint, a drive or a loop."""
    joints = {name}
    if row.is_of_body:
        yield from (k for k, body in enumerate(robot.bodies) if body.name == name)
        return
    match row.element_kind:
        case "loop" | "spring":
            for each in robot.loops if row.element_kind == "loop" else robot.springs:
                if robot.loop_name(each) == name:
                    yield from (end for end in (each.first, each.second) if end >= 0)
            return
        case "drive":
            joints = {joint for drive in robot.drives if drive.name == name for joint in drive.gears}
        case "coupling":
            joints = {coupling.follower for coupling in robot.couplings if coupling.name == name}
    for k, body in enumerate(robot.bodies):
        if any((joint.name or body.name) in joints for joint in body.joints):
            yield k


def _partners(alignment: Alignment, row: Difference, bodies: Sequence[int]) -> Iterator[int]:
    """Yield the bodies of the second robot that are partners of bodies, or whose joints are partners."""
    if row.is_of_body:
        yield from (pair.second[0] for pair in alignment.bodies if {*pair.first} & {*bodies})
    else:
        joints: list[tuple[JointKey, JointKey]] = [(pair.first, pair.second) for pair in alignment.joints]
        yield from (second for (first, _), (second, _) in joints if first in bodies)


def _shapes_of(
    robot: Robot,
    poses: Sequence[Placement],
    groups: Sequence[tuple[int, ...]],
    marked: tuple[set[int], set[int], set[int]],
) -> tuple[Shape, ...]:
    """Describe the rigid bodies of a robot.

    Args:
        robot: the robot.
        poses: of its bodies in the world.
        groups: indices of bodies that are rigid bodies together, parents first; others are alone.
        marked: indices of bodies that differ, whose joints differ, and that are displaced.
    """
    in_groups = {index for group in groups for index in group}
    alone = [(index,) for index in range(len(robot.bodies)) if index not in in_groups]
    ordered = sorted([*groups, *alone])
    number_of = {index: number for number, group in enumerate(ordered) for index in group}
    found = []
    for group in ordered:
        body, pose = robot.bodies[group[0]], poses[group[0]]
        mass, center, inertia = composite(placed_masses(robot, group, poses), pose.position)
        spread = np.zeros((3, 3))
        if mass > 0.0:
            # integral of r r^T over the mass; that of a homogeneous ellipsoid is its spread times mass / 5
            spread = 5.0 / mass * (0.5 * np.trace(inertia) * np.eye(3) - inertia)
        differs, joint_differs, displaced = (bool({*group} & indices) for indices in marked)
        shape = Shape(
            body.name,
            number_of.get(body.parent, -1),
            _numbers(pose.point(body.joint_point)),
            _numbers(center),
            (_numbers(spread[0]), _numbers(spread[1]), _numbers(spread[2])),
            float(mass),
            differs,
            joint_differs,
            displaced,
        )
        found.append(shape)
    return tuple(found)


def _numbers(values: Array) -> Vector:
    """Return an array (3,) as numbers."""
    x, y, z = values.tolist()
    return x, y, z
