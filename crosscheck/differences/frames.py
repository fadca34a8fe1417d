"""Two robots in one pose and in frames that mean the same in both, so that their numbers can be compared.

In: two robot files and their `Alignment`. Out: `CommonFrames`. Each body of the first robot keeps the frame
of its file. The second robot's body gets the frame in which most of its numbers agree with the first robot's:
the frame of its own file, that of the alignment, or the one that has the same place at the parent body.
A changed number therefore stays at its element, and a link frame that is only turned changes no number.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from crosscheck.differences.alignment import Alignment, JointPair
from crosscheck.differences.stack import (
    GROUND,
    JointKey,
    Judge,
    Line,
    Metric,
    Poses,
    Side,
    absolute,
    angle,
    distance,
    dot,
    matrix_distance,
    twist,
    wrapped,
)
from newton_euler.reading.robot import IN_PLACE, JointKind, Placement, Robot, RobotFile
from newton_euler.scalars import Array

IN_WORLD = -1
"""Number of the ground among the pairs of bodies."""

MIN_OFFSET = 1e-6
"""rad or m, smallest distance of two zeros that is reported."""

LOOP_ENDS = ("first", "second")
"""Names of the ends of a loop in `FileLoop`."""


@dataclass
class CommonFrame:
    """Frame of a pair of bodies.

    Attributes:
        first, second: the frame in the world, at the body of each robot.
        placement: of the frame of the second file in the common frame.
        slack_angle: rad, uncertainty of the frame's direction in the second robot.
        slack_shift: m, uncertainty of its origin.
    """

    first: Poses
    second: Poses
    placement: Placement
    slack_angle: float = 0.0
    slack_shift: float = 0.0


@dataclass(frozen=True)
class JointPlace:
    """Pair of joints between the same two pairs of bodies.

    Attributes:
        pair: the joints.
        kind: kind of both.
        parent, child: numbers of the pairs of bodies; `IN_WORLD` for the ground.
        alone: whether no other joint is between the two bodies.
    """

    pair: JointPair
    kind: JointKind
    parent: int
    child: int
    alone: bool


def common_frames(
    first: RobotFile, second: RobotFile, alignment: Alignment, tolerance: float | None
) -> CommonFrames:
    """Put both robots in the pose of the first file, and choose a common frame for each pair of bodies.

    Args:
        first, second: the files.
        alignment: pairs of their bodies and joints.
        tolerance: relative difference that counts as rounding; None for the digits of the files.
    """
    pose = {}
    for pair in alignment.joints:
        body, number = pair.first
        pose[pair.second] = pair.sense * first.robot.bodies[body].joints[number].zero + pair.offset
    side = Side(first, {})
    points = [line.point[0] for line in side.lines.values()]
    extent = float(np.ptp(points, axis=0).max()) if points else 0.0
    return CommonFrames(side, Side(second, pose), alignment, Judge(tolerance, extent or 1.0))


class CommonFrames:
    """Two robots in one pose, with a common frame for each pair of bodies.

    Attributes:
        first, second: the robots in the pose of the first file.
        judge: compares numbers.
        frames: frame of each pair of bodies, by its number, and of the ground.
        joints: pairs of joints between the same bodies.
        moved_joints: pairs of joints that connect other bodies, or are of another kind, in the second file.
    """

    def __init__(self, first: Side, second: Side, alignment: Alignment, judge: Judge) -> None:
        """Choose the frames.

        Args:
            first, second: both robots in the pose of the first file.
            alignment: pairs of bodies and joints.
            judge: compares numbers.
        """
        self.first, self.second, self.alignment, self.judge = first, second, alignment, judge
        self.first_of = {body: n for n, pair in enumerate(alignment.bodies) for body in pair.first}
        self.second_of = {body: n for n, pair in enumerate(alignment.bodies) for body in pair.second}
        self.joints: list[JointPlace] = []
        self.moved_joints: list[JointPair] = []
        self._place_joints()
        self._loop_points = list(self._points_of_loops())
        self.frames: dict[int, CommonFrame] = {IN_WORLD: CommonFrame(GROUND, GROUND, IN_PLACE)}
        for number in range(len(alignment.bodies)):
            if alignment.bodies[number].first and alignment.bodies[number].second:
                self._choose(number)
        self._choose_ground()

    def _place_joints(self) -> None:
        """Find the bodies that each pair of joints connects."""
        first, second = self.first.file.robot, self.second.file.robot
        first_children, second_children = _children(first), _children(second)
        places = []
        for pair in self.alignment.joints:
            (body, number), (other_body, other_number) = pair.first, pair.second
            kind = first.bodies[body].joints[number].kind
            other_kind = second.bodies[other_body].joints[other_number].kind
            ends = _above(first, self.first_of, body), _below(first_children, self.first_of, body)
            other_ends = (
                _above(second, self.second_of, other_body),
                _below(second_children, self.second_of, other_body),
            )
            if kind != other_kind or ends != other_ends or ends[1] is None:
                self.moved_joints.append(pair)
            else:
                places.append(JointPlace(pair, kind, ends[0], ends[1], alone=True))
        for place in places:
            between = [each for each in places if (each.parent, each.child) == (place.parent, place.child)]
            self.joints.append(replace(place, alone=len(between) == 1))

    def _points_of_loops(self) -> Iterator[tuple[int, Poses, Poses]]:
        """Yield the ends of loops that have one name and kind in both robots.

        Yields:
            Number of the pair of bodies at the end, and the frame of the end in the world of each robot.
        """
        others = {(loop.name, loop.kind): k for k, loop in enumerate(self.second.file.robot.loops)}
        for index, loop in enumerate(self.first.file.robot.loops):
            other = others.get((loop.name, loop.kind))
            if not loop.name or other is None:
                continue
            for end in LOOP_ENDS:
                body, frame = self.first.loop_end(index, end)
                number = self.first_of.get(body)
                for other_end in LOOP_ENDS:
                    other_body, other_frame = self.second.loop_end(other, other_end)
                    if number is not None and number == self.second_of.get(other_body):
                        yield number, frame, other_frame

    def parent(self, number: int) -> int:
        """Return the number of the pair of bodies that carries a pair, in the first robot."""
        return _above(self.first.file.robot, self.first_of, self.alignment.bodies[number].first[0])

    def is_fixed(self, number: int) -> bool:
        """Return whether a pair of bodies is fixed to the ground, or to an unpaired body, in both robots."""
        pair = self.alignment.bodies[number]
        return not any(
            side.file.robot.bodies[body].joints
            for side, body in ((self.first, pair.first[0]), (self.second, pair.second[0]))
        )

    def stands_still(self, number: int) -> bool:
        """Return whether no joint lets a pair of bodies move, in both robots."""
        pair = self.alignment.bodies[number]
        ends = (self.first.file.robot, pair.first[0]), (self.second.file.robot, pair.second[0])
        return not any(has_joint_above(robot, body) for robot, body in ends)

    def lines(self, pair: JointPair, number: int) -> tuple[Line, Line]:
        """Return the axis of a joint in both robots, in the common frame of a pair of bodies."""
        frame = self.frames[number]
        line = self.second.lines[pair.second].seen_from(frame.second)
        return self.first.lines[pair.first].seen_from(frame.first), Line(pair.sense * line.axis, line.point)

    def compare(self, number: int, first: Array, second: Array, metric: Metric) -> tuple[float, float]:
        """Return size and uncertainty of a difference of numbers in the frame of a pair of bodies.

        Args:
            number: of the pair of bodies.
            first, second: (V, ...) numbers of both robots.
            metric: distance of such numbers.
        """
        frame = self.frames[number]
        slack = 2.0 * frame.slack_angle
        if metric is distance:
            slack = frame.slack_shift + frame.slack_angle * float(np.linalg.norm(first[0]))
        return self.judge.compare(first, second, metric, slack)

    def body_name(self, number: int) -> str:
        """Return the name of a pair of bodies: that of the first robot's body next to the root."""
        return self.first.file.robot.bodies[self.alignment.bodies[number].first[0]].name

    def joint_name(self, pair: JointPair) -> str:
        """Return the name of a pair of joints in the first robot."""
        return joint_name(self.first.file.robot, pair.first)

    def numbers(self, pair: JointPair, name: str) -> tuple[Array, Array]:
        """Return a number of a joint in both robots, (V,) or (V, k), by the name of its field."""
        return self.first.number(pair.first, name), self.second.number(pair.second, name)

    def _choose(self, number: int) -> None:
        """Choose the frame of a pair of bodies in the second robot."""
        pair = self.alignment.bodies[number]
        first, world = self.first.world[pair.first[0]], self.second.world[pair.second[0]]
        above = self.frames.get(self.parent(number), self.frames[IN_WORLD])
        at_same_place = above.second @ above.first.inverse() @ first
        inside = at_same_place.inverse() @ world
        slack_angle, slack_shift = self._slack(first, world, above)
        candidates = [
            CommonFrame(first, world, IN_PLACE),
            *(
                CommonFrame(
                    first, world @ Poses.constant(placement.inverse()), placement, slack_angle, slack_shift
                )
                for placement in (pair.placement, Placement(inside.position[0], inside.rotation[0]))
            ),
        ]
        costs: list[tuple[int, int]] = []
        for candidate in candidates:
            self.frames[number] = candidate
            differ = sum(size > uncertainty for size, uncertainty in self._sizes(number))
            # Another frame is a difference of its own; if the numbers of differences are equal, it is more
            # likely than a joint with an axis in another direction
            costs.append((differ + bool(costs), self._count_turned_axes(number)))
            if costs[-1][0] <= 1:
                break
        self.frames[number] = candidates[costs.index(min(costs))]

    def _count_turned_axes(self, number: int) -> int:
        """Return the number of joints of a pair of bodies whose axes differ in direction."""
        places = [place for place in self.joints if number in (place.parent, place.child)]
        lines = [
            self.lines(place.pair, number)
            for place in places
            if place.kind in (JointKind.HINGE, JointKind.SLIDE)
        ]
        sizes = [self.compare(number, line.axis, other.axis, angle) for line, other in lines]
        return sum(size > uncertainty for size, uncertainty in sizes)

    def _slack(self, first: Poses, second: Poses, above: CommonFrame) -> tuple[float, float]:
        """Return the uncertainties, rad and m, of a frame that is found from its place at the parent body."""
        slack_angle, slack_shift = above.slack_angle, above.slack_shift
        for parent, child in ((above.first, first), (above.second, second)):
            inside = parent.inverse() @ child
            if len(inside.position) > 1:
                turn = np.linalg.norm(inside.rotation[1:] - inside.rotation[:1], axis=(1, 2)) / np.sqrt(2.0)
                slack_angle += 2.0 * float(turn.max())
                slack_shift += 2.0 * float(distance(inside.position[:1], inside.position[1:]).max())
                slack_shift += above.slack_angle * float(np.linalg.norm(inside.position[0]))
        return slack_angle, slack_shift

    def _sizes(self, number: int) -> Iterator[tuple[float, float]]:
        """Yield size and uncertainty of every difference that depends on the frame of a pair of bodies."""
        frame = self.frames[number]
        pair = self.alignment.bodies[number]
        first = self.first.mass_properties(pair.first, frame.first)
        second = self.second.mass_properties(pair.second, frame.second)
        if first.mass[0] and second.mass[0]:
            yield self.compare(number, first.center, second.center, distance)
            # A factor of the inertia does not depend on the frame
            scaled = second.inertia * _ratio(first.inertia, second.inertia)
            yield self.compare(number, first.inertia, scaled, matrix_distance)
        for place in self.joints:
            if number in (place.parent, place.child):
                yield from self._joint_sizes(place, number)
            if number == place.child and place.alone and place.kind in (JointKind.HINGE, JointKind.SLIDE):
                yield self._turn_size(place)
            if number == place.child and place.alone and place.kind == JointKind.HINGE:
                yield self._shift_size(place)
        for at, one, two in self._loop_points:
            if at == number:
                inside = frame.first.inverse() @ one, frame.second.inverse() @ two
                yield self.compare(number, inside[0].position, inside[1].position, distance)

    def _turn_size(self, place: JointPlace) -> tuple[float, float]:
        """Return the angle, rad, between zeros of a hinge, or of a slide about its axis; its uncertainty."""
        parent, child = self.frames.get(place.parent, self.frames[IN_WORLD]), self.frames[place.child]
        inside = parent.first.inverse() @ child.first, parent.second.inverse() @ child.second
        axis = self.lines(place.pair, place.child)[0].axis[0]
        turns = [twist(inside[0].rotation[0], each.rotation, axis) for each in inside]
        offset = place.pair.offset if place.kind == JointKind.HINGE else 0.0
        slack = 2.0 * (parent.slack_angle + child.slack_angle) + MIN_OFFSET
        turned = turns[1] - place.pair.sense * offset
        # half a turn to one side is half a turn to the other side
        turned -= turned[0] - wrapped(turned[0])
        return self.judge.compare(turns[0], turned, absolute, slack)

    def _shift_size(self, place: JointPlace) -> tuple[float, float]:
        """Return the shift, m, of a hinge's child along the axis, seen from the parent; its uncertainty."""
        parent, child = self.frames.get(place.parent, self.frames[IN_WORLD]), self.frames[place.child]
        inside = parent.first.inverse() @ child.first, parent.second.inverse() @ child.second
        line, other = self.lines(place.pair, place.child)
        point = line.point[0]
        axis = inside[0].rotation[0] @ line.axis[0]
        along = [
            dot(frame.point(each.nearest(point)), axis[None])
            for frame, each in zip(inside, (line, other), strict=True)
        ]
        slack = parent.slack_shift + child.slack_shift + MIN_OFFSET * self.judge.length
        return self.judge.compare(along[0], along[1], absolute, slack)

    def _joint_sizes(self, place: JointPlace, number: int) -> Iterator[tuple[float, float]]:
        """Yield size and uncertainty of the differences of a joint's axis in a pair's common frame."""
        if place.kind == JointKind.FREE:
            return
        line, other = self.lines(place.pair, number)
        point = line.point[0]
        if place.kind != JointKind.BALL:
            yield self.compare(number, line.axis, other.axis, angle)
        if place.kind == JointKind.HINGE:
            yield self.compare(number, line.nearest(point), other.nearest(point), distance)
        elif place.kind == JointKind.BALL:
            yield self.compare(number, line.point, other.point, distance)

    def _choose_ground(self) -> None:
        """Move the ground with the base if the whole second robot stands at another place in the world."""
        numbers = [n for n in self.frames if n != IN_WORLD and self.parent(n) == IN_WORLD]
        fixed = [n for n in numbers if self.is_fixed(n)]
        if not numbers:
            return
        base = self.frames[(fixed or numbers)[0]]
        ground = base.second @ base.first.inverse()
        placement = Placement(ground.position[0], ground.rotation[0]).inverse()
        slack_angle, slack_shift = self._slack(base.first, base.second, self.frames[IN_WORLD])
        level = CommonFrame(GROUND, GROUND, IN_PLACE)
        moved = CommonFrame(GROUND, Poses.constant(placement.inverse()), placement, slack_angle, slack_shift)
        if fixed:
            self.frames[IN_WORLD] = moved
        elif abs(placement.rotation[2, 2] - 1.0) < 1e-9:
            at_joints = [place for place in self.joints if place.parent == IN_WORLD]
            counts = []
            for frame in (level, moved):
                self.frames[IN_WORLD] = frame
                sizes = [size for place in at_joints for size in self._joint_sizes(place, IN_WORLD)]
                counts.append(sum(size > uncertainty for size, uncertainty in sizes))
            if counts[0] <= counts[1]:
                self.frames[IN_WORLD] = level


def _ratio(first: Array, second: Array) -> float:
    """Return the factor that gives the second matrix (V, 3, 3) the trace of the first one."""
    trace, other = float(np.trace(first[0])), float(np.trace(second[0]))
    return trace / other if other else 1.0


def joint_name(robot: Robot, key: JointKey) -> str:
    """Return the name of a joint, or that of its body for a joint without name."""
    body = robot.bodies[key[0]]
    return body.joints[key[1]].name or body.name


def _children(robot: Robot) -> list[list[int]]:
    """Return the indices of the children of each body."""
    children: list[list[int]] = [[] for _ in robot.bodies]
    for index, body in enumerate(robot.bodies):
        if body.parent >= 0:
            children[body.parent].append(index)
    return children


def has_joint_above(robot: Robot, body: int) -> bool:
    """Return whether a joint is between a body and the ground."""
    while body >= 0:
        if robot.bodies[body].joints:
            return True
        body = robot.bodies[body].parent
    return False


def _above(robot: Robot, number_of: Mapping[int, int], body: int) -> int:
    """Return the number of the pair that has the nearest ancestor of a body; `IN_WORLD` if none has."""
    ancestor = robot.bodies[body].parent
    while ancestor >= 0 and ancestor not in number_of:
        ancestor = robot.bodies[ancestor].parent
    return number_of.get(ancestor, IN_WORLD)


def _below(children: list[list[int]], number_of: Mapping[int, int], body: int) -> int | None:
    """Return the number of the pair that has a body or its nearest descendant; None if none has."""
    level = [body]
    while level:
        for index in level:
            if index in number_of:
                return number_of[index]
        level = [child for index in level for child in children[index]]
    return None
