"""Rows of the constraints of two robots: loops between bodies, and couplings of joint coordinates."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Literal, NamedTuple

import numpy as np
from numpy.polynomial import Polynomial

from crosscheck.differences.alignment import JointPair
from crosscheck.differences.difference import Difference, Quantity, Value, difference, numbers
from crosscheck.differences.frames import IN_WORLD, LOOP_ENDS, CommonFrames
from crosscheck.differences.stack import Poses, absolute, angle, distance, turn_angle
from newton_euler.reading.robot import (
    FileJoint,
    FileLoop,
    FileSpring,
    LoopKind,
)


class PairedJoint(NamedTuple):
    """Joint of the first robot that has a partner in the second one.

    Attributes:
        pair: keys of the joints.
        first, second: the joints.
        sense: 1, or -1 if the joint counts the other way in the second robot.
        offset: coordinate in the second robot where that in the first one is zero.
    """

    pair: JointPair
    first: FileJoint
    second: FileJoint
    sense: int
    offset: float


def joint_partners(common: CommonFrames, zeros: Mapping[tuple[int, int], float]) -> list[PairedJoint]:
    """Return the joints of the first robot that have partners in the second one.

    Args:
        common: both robots.
        zeros: coordinate of each joint in the second file where that in the first file is zero, by the key
            of the joint in the first file.
    """
    # Joints of other kinds between the same bodies have one partner each if their numbers are equal
    regrouped = [
        JointPair(one, two, 1, 0.0)
        for group in common.alignment.groups
        if len(group.first) == len(group.second)
        for one, two in zip(group.first, group.second, strict=True)
    ]
    joints = []
    for pair in (*common.alignment.joints, *regrouped):
        first = common.first.file.robot.bodies[pair.first[0]].joints[pair.first[1]]
        second = common.second.file.robot.bodies[pair.second[0]].joints[pair.second[1]]
        joints.append(PairedJoint(pair, first, second, pair.sense, zeros.get(pair.first, pair.offset)))
    return joints


def only_in_one(kind: str, name: str, value: Value, in_first: bool) -> Difference:
    """Return the row of an element that only one file has."""
    values = (value, None) if in_first else (None, value)
    return difference(name, kind, Quantity.PRESENCE, values, (1.0, 0.0))


# Loops


class End(NamedTuple):
    """End of a loop or a spring.

    Attributes:
        number: of its pair of bodies.
        frame: (V, ...) its frame in the common frame of the pair.
    """

    number: int
    frame: Poses


Ends = tuple[End, End]
"""First and second end of a loop or a spring."""


def loop_rows(common: CommonFrames) -> Iterator[Difference]:
    """Yield the rows of constraints that close loops."""
    first, second = common.first.file.robot, common.second.file.robot
    partners = ends_of_partners(common, "loops")
    for index, loop in enumerate(first.loops):
        if index in partners:
            yield from _paired_loop(common, index, *partners[index])
        else:
            yield only_in_one("loop", first.loop_name(loop), str(loop.kind), in_first=True)
    paired = {other for other, _, _ in partners.values()}
    for other, loop in enumerate(second.loops):
        if other not in paired:
            yield only_in_one("loop", second.loop_name(loop), str(loop.kind), in_first=False)


def ends_of_partners(
    common: CommonFrames, elements: Literal["loops", "springs"]
) -> dict[int, tuple[int, Ends, Ends]]:
    """Pair loops or springs of both robots that connect the same bodies.

    Args:
        common: both robots.
        elements: name of the elements in `Robot`.

    Returns:
        index of the partner in the second robot, and ends of both in the same order, by index in the first.
    """
    first, second = (getattr(side.file.robot, elements) for side in (common.first, common.second))
    free = list(range(len(second)))
    partners = {}
    for index, own in enumerate(first):
        ends = _ends(common, elements, index, 0)
        best, nearest = None, (math.inf, 0.0)
        for other in free:
            rival, rival_ends = second[other], _ends(common, elements, other, 1)
            is_slide = isinstance(own, FileLoop) and own.kind == LoopKind.SLIDE
            if not is_slide and ends[0].number != rival_ends[0].number:
                rival_ends = rival_ends[::-1]
            if [end.number for end in ends] != [end.number for end in rival_ends]:
                continue
            apart = sum(
                math.dist(end.frame.position[0], other_end.frame.position[0])
                for end, other_end in zip(ends, rival_ends, strict=True)
            )
            # Same names first, then nearest points; MuJoCo and Pinocchio allow elements without names
            if own.name and rival.name == own.name:
                apart = -1.0
            value = round(apart, 9), _unlikeness(own, rival)
            if value < nearest:
                best, nearest = (other, ends, rival_ends), value
        if best is not None:
            free.remove(best[0])
            partners[index] = best
    return partners


def _unlikeness(own: FileLoop | FileSpring, rival: FileLoop | FileSpring) -> float:
    """Return how much the numbers of two loops or springs of the same bodies differ."""
    if isinstance(own, FileSpring) and isinstance(rival, FileSpring):
        return abs(own.stiffness - rival.stiffness) + abs(own.damping - rival.damping)
    return float(isinstance(own, FileLoop) and isinstance(rival, FileLoop) and own.kind != rival.kind)


def _ends(common: CommonFrames, elements: Literal["loops", "springs"], index: int, side: int) -> Ends:
    """Return both ends of a loop or spring of the first robot (side 0) or the second robot (side 1)."""
    source = (common.first, common.second)[side]
    number_of = (common.first_of, common.second_of)[side]
    ends = []
    for which in LOOP_ENDS:
        body, world = source.loop_end(index, which, elements)
        number = number_of.get(body, IN_WORLD)
        frame = common.frames.get(number, common.frames[IN_WORLD])
        at_body = (frame.first, frame.second)[side]
        ends.append(End(number, at_body.inverse() @ world))
    return ends[0], ends[1]


def _paired_loop(
    common: CommonFrames,
    index: int,
    other_index: int,
    ends: Ends,
    other_ends: Ends,
) -> Iterator[Difference]:
    """Yield the rows of two loops that play the same role, given by their indices in the two robots."""
    first, second = common.first.file, common.second.file
    loop, other = first.robot.loops[index], second.robot.loops[other_index]
    name = first.robot.loop_name(loop)
    if loop.kind != other.kind:
        yield difference(name, "loop", Quantity.KIND, (str(loop.kind), str(other.kind)), (1.0, 0.0))
        return
    if loop.kind == LoopKind.WELD:
        yield from _weld_rows(common, name, ends, other_ends)
        return
    yield from point_rows(common, (name, "loop", Quantity.LOOP_POINT), ends, other_ends)
    for end, other_end in zip(ends, other_ends, strict=True):
        if loop.kind in (LoopKind.HINGE, LoopKind.SLIDE):
            sizes = common.compare(
                end.number, end.frame.rotation[..., 0], other_end.frame.rotation[..., 0], angle
            )
            # A line has no direction
            sizes = min(sizes[0], math.pi - sizes[0]), sizes[1]
            if sizes[0] > 1e-9:
                values = numbers(end.frame.rotation[0, :, 0]), numbers(other_end.frame.rotation[0, :, 0])
                yield difference(name, "loop", Quantity.LOOP_AXIS, values, sizes)
    if loop.kind == LoopKind.ROD:
        lengths = [
            np.array([robot.loops[number].length for robot in file.robots])
            for file, number in ((first, index), (second, other_index))
        ]
        sizes = common.judge.compare(lengths[0], lengths[1], absolute)
        if sizes[0]:
            yield difference(name, "loop", Quantity.LOOP_LENGTH, (loop.length, other.length), sizes)


def _weld_rows(common: CommonFrames, name: str, ends: Ends, other_ends: Ends) -> Iterator[Difference]:
    """Yield the rows of the place and the turn that two welds hold; where a body is welded does not count."""
    held, other = (each[0].frame @ each[1].frame.inverse() for each in (ends, other_ends))
    point = ends[1].frame.position[:1]  # where the first robot is welded, in the second body
    points = held.point(point), other.point(point)
    # both bodies' frames are uncertain
    slack = max(common.frames[end.number].slack_angle + common.frames[end.number].slack_shift for end in ends)
    sizes = common.compare(ends[0].number, *points, distance)
    if sizes[0]:
        values = numbers(points[0][0]), numbers(points[1][0])
        yield difference(name, "loop", Quantity.LOOP_POINT, values, (sizes[0], sizes[1] + 2.0 * slack))
    sizes = common.compare(ends[0].number, held.rotation, other.rotation, turn_angle)
    if sizes[0]:
        words = f"the body is held turned by {math.degrees(sizes[0]):.4g} degrees"
        sizes = sizes[0], sizes[1] + 2.0 * slack
        yield difference(name, "loop", Quantity.LOOP_AXIS, (0.0, sizes[0]), sizes, words)


def point_rows(
    common: CommonFrames, about: tuple[str, str, Quantity], ends: Ends, other_ends: Ends
) -> Iterator[Difference]:
    """Yield the rows of the points of a loop or a spring.

    Args:
        common: both robots.
        about: name and kind of the element, and quantity of the rows.
        ends, other_ends: ends in both robots.
    """
    for end, other_end in zip(ends, other_ends, strict=True):
        points = end.frame.position, other_end.frame.position
        sizes = common.compare(end.number, *points, distance)
        if sizes[0]:
            yield difference(*about, (numbers(points[0][0]), numbers(points[1][0])), sizes)


# Couplings


def coupling_rows(common: CommonFrames, joints: list[PairedJoint]) -> Iterator[Difference]:
    """Yield the rows of couplings of joint coordinates."""
    first, second = common.first.file, common.second.file
    by_first = {joint.first.name: joint for joint in joints}
    other_name = {joint.first.name: joint.second.name for joint in joints}
    free = list(range(len(second.robot.couplings)))
    alone = []
    for index, coupling in enumerate(first.robot.couplings):
        # Joints that a reduced robot does not have keep their names
        ends = [other_name.get(name, name) for name in (coupling.follower, coupling.leader)]
        match = [
            other
            for other in free
            if {second.robot.couplings[other].follower, second.robot.couplings[other].leader} == set(ends)
        ]
        if not match:
            alone.append(coupling)
            continue
        free.remove(match[0])
        backwards = second.robot.couplings[match[0]].follower != ends[0]
        follower, leader = by_first.get(coupling.follower), by_first.get(coupling.leader)
        own = np.array([_padded(robot.couplings[index].powers) for robot in first.robots])
        other = np.array(
            [
                _padded(_in_first(robot.couplings[match[0]].powers, follower, leader, backwards))
                for robot in second.robots
            ]
        )
        # Zeros of both joints are part of the constant
        slack = sum(
            common.judge.compare(*common.numbers(joint.pair, "zero"), absolute)[1]
            for joint in (follower, leader)
            if joint is not None
        )
        sizes = common.judge.compare(own, other, absolute, slack)
        if sizes[0]:
            name = coupling.name or coupling.follower
            values = tuple(numbers(np.trim_zeros(np.round(powers[0], 12), "b")) for powers in (own, other))
            yield difference(name, "coupling", Quantity.COUPLING, (values[0], values[1]), sizes)
    others = [second.robot.couplings[other] for other in free]
    for in_first, couplings in ((True, alone), (False, others)):
        for coupling in couplings:
            name = coupling.name or coupling.follower
            yield only_in_one("coupling", name, coupling.powers, in_first)


def _padded(powers: tuple[float, ...]) -> list[float]:
    """Return the coefficients of at least eight powers."""
    return [*powers, *[0.0] * (8 - len(powers))]


def _in_first(
    powers: tuple[float, ...], follower: PairedJoint | None, leader: PairedJoint | None, backwards: bool
) -> tuple[float, ...]:
    """Return the powers of a coupling of the second robot in the zeros and signs of the first robot.

    Args:
        powers: of the coupling in the second file, from its zeros.
        follower, leader: joints of the coupling in the first file; None without joint.
        backwards: whether the second file has the two joints exchanged; only a line can be turned around.
    """
    if backwards:
        constant, slope = (*powers, 0.0, 0.0)[:2]
        if not slope or any(powers[2:]):
            return powers
        powers = (-constant / slope, 1.0 / slope)
    follows = Polynomial(powers)
    if leader is not None:
        # Leader's coordinate from its zero in the second file, by that from its zero in the first file
        shift = leader.sense * leader.first.zero + leader.offset - leader.second.zero
        follows = follows(Polynomial([shift, leader.sense]))
    if follower is not None:
        coordinate = follower.second.zero + follows - follower.offset
        follows = follower.sense * coordinate - follower.first.zero
    coefficients = np.asarray(follows.coef, dtype=float)
    return numbers(np.where(np.abs(coefficients) > 1e-15, coefficients, 0.0))
