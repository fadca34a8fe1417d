"""Rows of joints: origin, axis, zero, sign and numbers, in frames, zero and sign of the first file."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from operator import attrgetter
from typing import assert_never

import numpy as np

from crosscheck.differences.alignment import JointPair
from crosscheck.differences.causes import LACKING
from crosscheck.differences.difference import Difference, Quantity, Value, difference, numbers
from crosscheck.differences.drive_pairs import is_meant
from crosscheck.differences.frames import MIN_OFFSET, CommonFrames, JointPlace, joint_name
from crosscheck.differences.stack import (
    JointKey,
    Metric,
    absolute,
    angle,
    distance,
    dot,
    relative,
    twist,
    wrapped,
)
from newton_euler.reading.robot import FileDrive, JointKind, Robot, RobotFile
from newton_euler.scalars import Array

JOINT_NUMBERS: dict[Quantity, str] = {
    Quantity.DAMPING: "damping",
    Quantity.ARMATURE: "armature",
    Quantity.FRICTION: "friction",
    Quantity.STIFFNESS: "stiffness",
    Quantity.SPEED: "speed",
}
"""Numbers of a joint that do not depend on frames, zeros and signs, with the names of their fields."""


def joint_rows(common: CommonFrames, place: JointPlace, zeros: dict[JointKey, float]) -> Iterator[Difference]:
    """Yield the rows of a pair of joints between the same bodies.

    Args:
        common: both robots.
        place: the joints and their bodies.
        zeros: takes the coordinate of the joint in the second file where that in the first file is zero.
    """
    pair, name = place.pair, common.joint_name(place.pair)
    slide = place.kind == JointKind.SLIDE
    match place.kind:
        case JointKind.HINGE | JointKind.SLIDE:
            joint = _AxisJoint(common, place)
            yield from joint.rows()
            zeros[pair.first] = joint.offset
            yield from _coordinate_rows(common, pair, name, joint.offset, slide)
        case JointKind.BALL:
            yield from _ball_rows(common, place, name)
        case JointKind.FREE:
            pass
        case _:
            assert_never(place.kind)
    for quantity, field in JOINT_NUMBERS.items():
        first, second = common.numbers(pair, field)
        sizes = common.judge.compare(first, second, relative)
        if sizes[0]:
            values = _finite(first[0]), _finite(second[0])
            yield difference(name, "joint", quantity, values, sizes, slide=slide)
    efforts = _efforts(common, pair)
    sizes = common.judge.compare(*efforts, relative)
    if sizes[0]:
        shown = _effort_shown(efforts[0][0]), _effort_shown(efforts[1][0])
        is_idle = any(
            shown[k] is None and _has_no_drive(side.file, key)
            for k, (side, key) in enumerate(((common.first, pair.first), (common.second, pair.second)))
        )
        words = "nothing drives the joint" if is_idle else ""
        yield difference(name, "joint", Quantity.EFFORT, shown, sizes, words, slide=slide, convention=is_idle)


def regrouped_rows(common: CommonFrames) -> Iterator[Difference]:
    """Yield the rows of joints of other kinds between the same bodies, such as a ball and three hinges.

    A joint may also be a loop of the other file, which then cuts the mechanism elsewhere.
    """
    first, second = common.first.file.robot, common.second.file.robot
    for group in common.alignment.groups:
        kinds = [
            " and ".join(str(robot.bodies[body].joints[number].kind) for body, number in keys)
            for robot, keys in ((first, group.first), (second, group.second))
        ]
        names = tuple(joint_name(first, key) for key in group.first)
        both_free = _is_free(first, group.first) and _is_free(second, group.second)
        words = "the body floats in both files" if both_free else ""
        row = difference(
            names[0], "joint", Quantity.KIND, (kinds[0], kinds[1]), (1.0, 0.0), words, convention=both_free
        )
        yield replace(row, elements=names)
    for pair in common.alignment.loops:
        robot, other = (first, second) if pair.in_first else (second, first)
        body, number = pair.joint
        joint, loop = (
            str(robot.bodies[body].joints[number].kind),
            f"loop of kind {other.loops[pair.loop].kind}",
        )
        values = (joint, loop) if pair.in_first else (loop, joint)
        yield difference(joint_name(robot, pair.joint), "joint", Quantity.KIND, values, (1.0, 0.0))


def _is_free(robot: Robot, keys: tuple[JointKey, ...]) -> bool:
    """Return whether joints leave all freedoms between two bodies: a free joint, or three slides and a ball.

    Joints with damping, springs, armature, dry friction or limits do not.
    """
    joints = [robot.bodies[body].joints[number] for body, number in keys]
    slides = [joint.axis for joint in joints if joint.kind == JointKind.SLIDE]
    kinds = {joint.kind for joint in joints}
    free = kinds == {JointKind.FREE}
    floats = kinds == {JointKind.SLIDE, JointKind.BALL} and np.linalg.matrix_rank(slides, tol=0.1) == 3
    return (free or floats) and not any(
        joint.damping
        or joint.stiffness
        or joint.armature
        or joint.friction
        or np.isfinite(joint.limits).any()
        for joint in joints
    )


def moved_joint_row(common: CommonFrames, pair: JointPair) -> Difference:
    """Return the row of a pair of joints that are of other kinds or connect other bodies."""
    name = common.joint_name(pair)
    sides = (common.first.file.robot, pair.first), (common.second.file.robot, pair.second)
    kinds, parents = [], []
    for robot, (body, number) in sides:
        parent = robot.bodies[body].parent
        kinds.append(str(robot.bodies[body].joints[number].kind))
        parents.append(robot.bodies[parent].name if parent >= 0 else "the ground")
    if kinds[0] != kinds[1]:
        return difference(name, "joint", Quantity.KIND, (kinds[0], kinds[1]), (1.0, 0.0))
    return difference(name, "joint", Quantity.PARENT, (parents[0], parents[1]), (1.0, 0.0))


def _effort_shown(effort: Array) -> Value:
    """Return the largest effort if it is that of both directions, both efforts if not, None without limit."""
    low, high = effort.tolist()
    return _finite(high) if low == -high else (low, high)


def _efforts(common: CommonFrames, pair: JointPair) -> tuple[Array, Array]:
    """Return the efforts (V, 2) of a joint in both files, in the sense of the first file.

    If one file has no drives, the efforts of the drives count.

    Args:
        common: both robots.
        pair: the joints.
    """
    first, second = common.numbers(pair, "effort")
    second = (pair.sense * second)[:, :: pair.sense]
    robots = common.first.file.robot, common.second.file.robot
    if bool(robots[0].drives) == bool(robots[1].drives):
        return first, second
    efforts = []
    for robot, (body, number), effort in zip(robots, (pair.first, pair.second), (first, second), strict=True):
        name = robot.bodies[body].joints[number].name
        limits = [
            _largest_force(drive) * abs(drive.gears[name]) for drive in robot.drives if name in drive.gears
        ]
        largest = sum(limits) if limits else math.inf
        efforts.append(np.clip(effort, -largest, largest))
    return efforts[0], efforts[1]


def _has_no_drive(file: RobotFile, key: JointKey) -> bool:
    """Return whether a file that can have drives has none at a joint: a limit of effort limits nothing."""
    name = file.robot.joint(key).name
    can_have_drives = Quantity.PRESENCE not in LACKING.get(file.format, ())
    return can_have_drives and not any(name in drive.gears for drive in file.robot.drives)


def _largest_force(drive: FileDrive) -> float:
    """Return the largest force of a drive, N or N m."""
    forces = [max(map(abs, drive.force_limits))]
    if not drive.stiffness and not drive.damping:
        forces.append(abs(drive.gain) * max(map(abs, drive.control_limits)))
    return min(forces)


class _AxisJoint:
    """Hinge or slide of both robots.

    Attributes:
        offset: coordinate in the second file where the coordinate in the first file is zero, rad or m.
    """

    def __init__(self, common: CommonFrames, place: JointPlace) -> None:
        """Express the joint's axis in the common frames of parent and child."""
        self.common, self.place = common, place
        self.name = common.joint_name(place.pair)
        self.slide = place.kind == JointKind.SLIDE
        self.at_parent = common.lines(place.pair, place.parent)
        self.at_child = common.lines(place.pair, place.child)
        parent, child = common.frames[place.parent], common.frames[place.child]
        self.child_in_parent = (parent.first.inverse() @ child.first, parent.second.inverse() @ child.second)
        self.offset = place.pair.offset

    def rows(self) -> Iterator[Difference]:
        """Yield the rows of the axis, the origin, the zero and the sign, and set the offset."""
        at_child, at_parent = self._points()
        axis = self.at_parent[0].axis[0]
        along = [dot(points - at_parent[0][0], axis[None]) for points in at_parent]
        if self.slide:
            # A shift along the axis is another zero of a slide
            at_parent = [
                points - shift[:, None] * axis for points, shift in zip(at_parent, along, strict=True)
            ]
        yield from self._direction_row()
        yield from self._origin_row(at_child, at_parent)
        if self.place.alone:
            yield from self._zero_rows(along)
        pair, robots = self.place.pair, (self.common.first.file.robot, self.common.second.file.robot)
        meant = is_meant(*robots, pair)
        if self.offset:
            words = "the joint counts from another zero"
            # a servo whose controls are not meant to count from the other zero holds another position
            holds = not meant and self._products(attrgetter("stiffness")) > 0.0
            words += ", its servo holds another position" if holds else ""
            sizes = abs(self.offset), 0.0
            yield self._row(Quantity.ZERO, (0.0, self.offset), sizes, words, convention=not holds)
        if pair.sense < 0:
            words = "the joint counts the other way"
            pushes = self._products(attrgetter("gain")) > 0.0
            words += ", its drive pushes the other way" if pushes else ""
            yield self._row(Quantity.SIGN, (1.0, -1.0), (1.0, 0.0), words, convention=meant or not pushes)

    def _products(self, of: Callable[[FileDrive], float]) -> float:
        """Return the product over both robots of a drive's number times its gear, summed over drives."""
        product = 1.0
        sides = (self.common.first, self.place.pair.first), (self.common.second, self.place.pair.second)
        for side, key in sides:
            robot = side.file.robot
            name = robot.joint(key).name
            product *= sum(drive.gears.get(name, 0.0) * of(drive) for drive in robot.drives)
        return product

    def _points(self) -> tuple[list[Array], list[Array]]:
        """Return the point of the joint at the child and at the parent, (V, 3) for each robot.

        The point of an axis is free along it: both robots get the points of the child that are nearest to the
        first robot's point. A slide's axis has no place; its point is any point of the child.
        """
        center = self.at_child[0].point[0]
        if self.slide:
            at_child = [np.broadcast_to(center, line.point.shape) for line in self.at_child]
        else:
            at_child = [line.nearest(center) for line in self.at_child]
        if self.place.alone:
            return at_child, [
                frame.point(points) for frame, points in zip(self.child_in_parent, at_child, strict=True)
            ]
        start = self.at_parent[0].point[0]
        return at_child, [line.nearest(start) for line in self.at_parent]

    def _direction_row(self) -> Iterator[Difference]:
        """Yield the row of the axis, in the frame of the child, or of the parent if only that differs."""
        lines, words = self.at_child, ""
        sizes = self._at_child(lines[0].axis, lines[1].axis, angle)
        at_parent = self._at_parent(self.at_parent[0].axis, self.at_parent[1].axis, angle)
        if not sizes[0] or (at_parent[0] > at_parent[1] and _is_hidden(sizes, at_parent)):
            lines, sizes = self.at_parent, at_parent
            words = f"the link is turned at its parent by {math.degrees(sizes[0]):.4g} degrees"
        if sizes[0]:
            axes = numbers(lines[0].axis[0]), numbers(lines[1].axis[0])
            yield self._row(Quantity.JOINT_AXIS, axes, sizes, words)

    def _origin_row(self, at_child: list[Array], at_parent: list[Array]) -> Iterator[Difference]:
        """Yield the row of the joint's point, at the parent, or at the child if only that differs."""
        points, sizes = at_parent, self._at_parent(at_parent[0], at_parent[1], distance)
        sizes_at_child = self._at_child(at_child[0], at_child[1], distance)
        words = ""
        if sizes_at_child[0] > sizes_at_child[1] and _is_hidden(sizes, sizes_at_child):
            points, sizes, words = at_child, sizes_at_child, "in the frame of the moved link"
        if sizes[0]:
            yield self._row(
                Quantity.JOINT_ORIGIN, (numbers(points[0][0]), numbers(points[1][0])), sizes, words
            )

    def _zero_rows(self, along: list[Array]) -> Iterator[Difference]:
        """Correct the offset by the place of the child in the parent, and yield rows of rounding."""
        reference = self.child_in_parent[0].rotation[0]
        axis = self.at_child[0].axis[0]
        turns = [twist(reference, frame.rotation, axis) for frame in self.child_in_parent]
        change, sizes = turns, self._at_parent(turns[0], turns[1], absolute)
        if self.slide:
            if sizes[0]:
                yield self._row(Quantity.JOINT_ORIENTATION, (0.0, float(turns[1][0])), sizes)
            change, sizes = along, self._at_parent(along[0], along[1], absolute)
        if sizes[0] > sizes[1]:
            self.offset -= self.place.pair.sense * float(change[1][0])
            self.offset = self.offset if self.slide else float(wrapped(np.array(self.offset)))
        elif sizes[0]:
            yield self._row(Quantity.ZERO, (0.0, float(change[1][0])), sizes)
        zeros = self.common.numbers(self.place.pair, "zero")
        open_offset = self.common.judge.compare(zeros[0], zeros[1], absolute)[1]
        # both robots are posed so that the offset does not show
        unposed = change[1] - self.place.pair.sense * self.offset
        open_offset += self._at_parent(change[0], unposed, absolute)[1]
        if abs(self.offset) <= max(open_offset, MIN_OFFSET):
            if abs(self.offset) > MIN_OFFSET and not sizes[0]:
                yield self._row(Quantity.ZERO, (0.0, self.offset), (abs(self.offset), open_offset))
            self.offset = 0.0

    def _at_child(self, first: Array, second: Array, metric: Metric) -> tuple[float, float]:
        """Return size and uncertainty of a difference in the frame of the child."""
        return self.common.compare(self.place.child, first, second, metric)

    def _at_parent(self, first: Array, second: Array, metric: Metric) -> tuple[float, float]:
        """Return size and uncertainty of a difference that depends on the frames of parent and child."""
        parent, child = (self.common.frames[number] for number in (self.place.parent, self.place.child))
        lever = float(np.linalg.norm(first[0])) if metric is distance else 1.0
        slack = 2.0 * (parent.slack_angle + child.slack_angle) * lever
        return self.common.judge.compare(
            first, second, metric, slack + parent.slack_shift + child.slack_shift
        )

    def _row(
        self,
        quantity: Quantity,
        values: tuple[Value, Value],
        sizes: tuple[float, float],
        cause: str = "",
        convention: bool = False,
    ) -> Difference:
        """Return a row of the joint."""
        return difference(self.name, "joint", quantity, values, sizes, cause, self.slide, convention)


def _is_hidden(sizes: tuple[float, float], others: tuple[float, float]) -> bool:
    """Return whether a difference of an axis is rounding, or a thousandth of the difference at another body.

    Args:
        sizes: difference in the frame of one body, and its uncertainty.
        others: difference in the frame of the other body that the joint connects, and its uncertainty.
    """
    return sizes[0] <= max(sizes[1], 1e-3 * others[0])


def _ball_rows(common: CommonFrames, place: JointPlace, name: str) -> Iterator[Difference]:
    """Yield the rows of the limits of a ball joint and of its center, at the child if only that differs."""
    yield from _limits_row(common, name, *common.numbers(place.pair, "limits"), slide=False)
    for number, words in ((place.parent, ""), (place.child, "in the frame of the moved link")):
        line, other = common.lines(place.pair, number)
        sizes = common.compare(number, line.point, other.point, distance)
        if sizes[0]:
            values = numbers(line.point[0]), numbers(other.point[0])
            yield difference(name, "joint", Quantity.JOINT_ORIGIN, values, sizes, words)
            if sizes[0] > sizes[1]:
                return


def _coordinate_rows(
    common: CommonFrames, pair: JointPair, name: str, offset: float, slide: bool
) -> Iterator[Difference]:
    """Yield the rows of limits and of the rest of the spring, in the zero and sign of the first file.

    Args:
        common: both robots.
        pair: the joints.
        name: of the joint.
        offset: coordinate in the second file where that in the first file is zero.
        slide: whether the joint slides.
    """
    limits, other = common.numbers(pair, "limits")
    # Mirroring exchanges the lower and the upper limit
    other = (pair.sense * (other - offset))[:, :: pair.sense]
    yield from _limits_row(common, name, limits, other, slide)
    springs = common.numbers(pair, "stiffness")
    if springs[0][0] and springs[1][0]:
        rest, other = common.numbers(pair, "rest")
        other = pair.sense * (other - offset)
        sizes = common.judge.compare(rest, other, absolute)
        if sizes[0]:
            yield difference(
                name, "joint", Quantity.REST, (float(rest[0]), float(other[0])), sizes, slide=slide
            )


def _limits_row(
    common: CommonFrames, name: str, first: Array, second: Array, slide: bool
) -> Iterator[Difference]:
    """Yield the row of the smallest and largest coordinates (V, 2) of a joint, as in the first file."""
    sizes = common.judge.compare(first, second, absolute)
    if sizes[0]:
        values = [numbers(each[0]) if np.isfinite(each[0]).any() else None for each in (first, second)]
        yield difference(name, "joint", Quantity.LIMITS, (values[0], values[1]), sizes, slide=slide)


def _finite(value: float) -> float | None:
    """Return a number, or None for a limit that is infinite."""
    return float(value) if math.isfinite(value) else None
