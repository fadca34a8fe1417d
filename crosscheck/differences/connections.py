"""Rows of the elements that connect bodies and joints of two robots: loops, couplings and drives."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import NamedTuple

import numpy as np
from numpy.polynomial import Polynomial

from crosscheck.differences.alignment import JointPair
from crosscheck.differences.difference import Difference, Quantity, Value, difference, numbers
from crosscheck.differences.frames import IN_WORLD, CommonFrames
from crosscheck.differences.short_angles import is_turn_by_short_pi
from crosscheck.differences.stack import Poses, absolute, angle, distance, relative
from newton_euler.reading.robot import (
    FileDrive,
    FileJoint,
    FileLoop,
    JointKind,
    LoopKind,
    Robot,
)
from newton_euler.scalars import Array

DRIVE_LIMITS = {Quantity.CONTROL_LIMITS: "control_limits", Quantity.FORCE_LIMITS: "force_limits"}
"""Limits of a drive, with the names of their fields."""

DRIVE_NUMBERS = {
    Quantity.GAIN: "gain",
    Quantity.KP: "stiffness",
    Quantity.KV: "damping",
    Quantity.CONSTANT: "constant",
}
"""Numbers of a drive, with the names of their fields."""


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


def connection_rows(common: CommonFrames, zeros: Mapping[tuple[int, int], float]) -> Iterator[Difference]:
    """Yield the rows of loops, couplings and drives.

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
    yield from _loop_rows(common)
    yield from _coupling_rows(common, joints)
    yield from _drive_rows(common, joints)


def _only_in_one(kind: str, name: str, value: Value, in_first: bool) -> Difference:
    """Return the row of an element that only one file has."""
    values = (value, None) if in_first else (None, value)
    return difference(name, kind, Quantity.PRESENCE, values, (1.0, 0.0))


# Loops


class _LoopEnd(NamedTuple):
    """End of a loop: number of its pair of bodies, and its frame (V, ...) in the common frame of the pair."""

    number: int
    frame: Poses


def _loop_rows(common: CommonFrames) -> Iterator[Difference]:
    """Yield the rows of constraints that close loops."""
    first, second = common.first.file.robot, common.second.file.robot
    free = list(range(len(second.loops)))
    alone = []
    for index, loop in enumerate(first.loops):
        ends = _loop_ends(common, index, 0)
        best, nearest = None, math.inf
        for other in free:
            rival, rival_ends = second.loops[other], _loop_ends(common, other, 1)
            if loop.kind != LoopKind.SLIDE and ends[0].number != rival_ends[0].number:
                rival_ends = rival_ends[::-1]
            if [end.number for end in ends] != [end.number for end in rival_ends]:
                continue
            apart = sum(
                math.dist(end.frame.position[0], other_end.frame.position[0])
                for end, other_end in zip(ends, rival_ends, strict=True)
            )
            # Same names first, then nearest points; MuJoCo and Pinocchio allow loops without names
            if loop.name and rival.name == loop.name:
                apart = -1.0
            if apart < nearest:
                best, nearest, best_ends = other, apart, rival_ends
        if best is None:
            alone.append(loop)
            continue
        free.remove(best)
        yield from _paired_loop(common, index, best, ends, best_ends)
    others = [second.loops[other] for other in free]
    for robot, loops in ((first, alone), (second, others)):
        for loop in loops:
            yield _only_in_one("loop", loop_name(robot, loop), str(loop.kind), robot is first)


def loop_name(robot: Robot, loop: FileLoop) -> str:
    """Return the name of a loop, or those of its bodies for a loop without name."""
    bodies = [robot.bodies[body].name if body >= 0 else "the ground" for body in (loop.first, loop.second)]
    return loop.name or " and ".join(bodies)


def _loop_ends(common: CommonFrames, index: int, side: int) -> tuple[_LoopEnd, _LoopEnd]:
    """Return both ends of a loop of the first robot (side 0) or the second robot (side 1)."""
    source = (common.first, common.second)[side]
    number_of = (common.first_of, common.second_of)[side]
    robots = (source.file.robot, *source.file.variants)
    ends = []
    for which in ("first", "second"):
        body = getattr(robots[0].loops[index], which)
        given = [getattr(robot.loops[index], f"{which}_frame") for robot in robots]
        inside = Poses(np.array([f.rotation for f in given]), np.array([f.position for f in given]))
        number = number_of.get(body, IN_WORLD)
        frame = common.frames.get(number, common.frames[IN_WORLD])
        at_body = (frame.first, frame.second)[side]
        world = source.world[body] @ inside if body >= 0 else inside
        ends.append(_LoopEnd(number, at_body.inverse() @ world))
    return ends[0], ends[1]


def _paired_loop(
    common: CommonFrames,
    index: int,
    other_index: int,
    ends: tuple[_LoopEnd, _LoopEnd],
    other_ends: tuple[_LoopEnd, _LoopEnd],
) -> Iterator[Difference]:
    """Yield the rows of two loops that play the same role, given by their indices in the two robots."""
    first, second = common.first.file, common.second.file
    loop, other = first.robot.loops[index], second.robot.loops[other_index]
    name = loop_name(first.robot, loop)
    if loop.kind != other.kind:
        yield difference(name, "loop", Quantity.KIND, (str(loop.kind), str(other.kind)), (1.0, 0.0))
        return
    for end, other_end in zip(ends, other_ends, strict=True):
        points = end.frame.position, other_end.frame.position
        sizes = common.compare(end.number, *points, distance)
        if sizes[0]:
            values = numbers(points[0][0]), numbers(points[1][0])
            yield difference(name, "loop", Quantity.LOOP_POINT, values, sizes)
        if loop.kind in (LoopKind.HINGE, LoopKind.SLIDE):
            sizes = common.compare(
                end.number, end.frame.rotation[..., 0], other_end.frame.rotation[..., 0], angle
            )
            # A line has no direction
            sizes = min(sizes[0], math.pi - sizes[0]), sizes[1]
            if sizes[0] > 1e-9:
                values = numbers(end.frame.rotation[0, :, 0]), numbers(other_end.frame.rotation[0, :, 0])
                if is_turn_by_short_pi(*sizes):
                    sizes = sizes[0], max(sizes)
                yield difference(name, "loop", Quantity.LOOP_AXIS, values, sizes)
    if loop.kind == LoopKind.ROD:
        lengths = [
            np.array([robot.loops[number].length for robot in (file.robot, *file.variants)])
            for file, number in ((first, index), (second, other_index))
        ]
        sizes = common.judge.compare(lengths[0], lengths[1], absolute)
        if sizes[0]:
            yield difference(name, "loop", Quantity.LOOP_LENGTH, (loop.length, other.length), sizes)


# Couplings


def _coupling_rows(common: CommonFrames, joints: list[PairedJoint]) -> Iterator[Difference]:
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
        own = np.array([_padded(robot.couplings[index].powers) for robot in (first.robot, *first.variants)])
        other = np.array(
            [
                _padded(_in_first(robot.couplings[match[0]].powers, follower, leader, backwards))
                for robot in (second.robot, *second.variants)
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
            yield _only_in_one("coupling", name, coupling.powers, in_first)


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


# Drives


def _drive_rows(common: CommonFrames, joints: list[PairedJoint]) -> Iterator[Difference]:
    """Yield the rows of drives, paired by their joints and then by their names."""
    first, second = common.first.file.robot, common.second.file.robot
    by_second = {joint.second.name: joint for joint in joints}
    first_name = {joint.second.name: joint.first.name for joint in joints}
    free = list(range(len(second.drives)))
    alone = []
    for index, drive in enumerate(first.drives):
        acts_on = set(drive.gears)
        rivals = [
            other
            for other in free
            if {first_name.get(joint, "") for joint in second.drives[other].gears} == acts_on
            and (acts_on or second.drives[other].name == drive.name)
        ]
        # Drives of one joint: the same name, then the same kind of law
        rivals.sort(key=lambda other: _unlikeness(drive, second.drives[other]))
        if not rivals:
            alone.append(drive)
            continue
        free.remove(rivals[0])
        yield from _paired_drive(common, index, rivals[0], by_second)
    others = [second.drives[other] for other in free]
    for drive in list(alone):
        namesake = next((other for other in others if other.name == drive.name and drive.name), None)
        if namesake is not None:
            alone.remove(drive)
            others.remove(namesake)
            joints_of_both = (
                ", ".join(drive.gears),
                ", ".join(first_name.get(name, name) for name in namesake.gears),
            )
            words = "the drive acts on another joint"
            yield difference(drive.name, "drive", Quantity.TRANSMISSION, joints_of_both, (1.0, 0.0), words)
    for in_first, drives in ((True, alone), (False, others)):
        for drive in drives:
            name = drive.name or ", ".join(drive.gears)
            yield _only_in_one("drive", name, f"on {', '.join(drive.gears) or 'a body'}", in_first)


def _unlikeness(drive: FileDrive, other: FileDrive) -> tuple[bool, bool, bool]:
    """Return a key that sorts drives of one joint by their likeness to a drive."""
    return (
        drive.name != other.name,
        bool(drive.stiffness) != bool(other.stiffness),
        bool(drive.damping) != bool(other.damping),
    )


def _paired_drive(
    common: CommonFrames, index: int, other_index: int, by_second: Mapping[str, PairedJoint]
) -> Iterator[Difference]:
    """Yield the rows of two drives: as the files have them, or as forces on the joints if that is fewer."""
    as_written = [*_rows_as_written(common, index, other_index, by_second)]
    at_joints = [*_rows_at_joints(common, index, other_index, by_second)]
    counts = [sum(row.size > row.uncertainty for row in rows) for rows in (as_written, at_joints)]
    yield from at_joints if counts[1] < counts[0] else as_written
    drive = common.first.file.robot.drives[index]
    other = common.second.file.robot.drives[other_index]
    for name in sorted({*drive.other, *other.other}):
        values = drive.other.get(name), other.other.get(name)
        if values[0] != values[1]:
            sizes = 1.0, 0.0
            if isinstance(values[0], float) and isinstance(values[1], float):
                sizes = common.judge.compare(np.array([values[0]]), np.array([values[1]]), relative)
            if sizes[0]:
                yield difference(drive.name, "drive", Quantity.SETTING, values, sizes, name)


def _numbers(robots: tuple[Robot, ...], index: int, field: str) -> Array:
    """Return a number (V,) or (V, 2) of a drive of a robot and its variants, by the name of its field."""
    return np.array([getattr(robot.drives[index], field) for robot in robots])


def _gears(robots: tuple[Robot, ...], index: int, joints: list[str]) -> Array:
    """Return the gears (V, n) of a drive on joints with given names."""
    return np.array([[robot.drives[index].gears[name] for name in joints] for robot in robots])


class _DriveNumbers(NamedTuple):
    """Numbers of a drive of both robots and whether it acts on slides."""

    robots: tuple[tuple[Robot, ...], tuple[Robot, ...]]
    gears: tuple[Array, Array]
    senses: Array
    slide: bool


def _drive_numbers(
    common: CommonFrames, index: int, other_index: int, by_second: Mapping[str, PairedJoint]
) -> _DriveNumbers:
    """Return the numbers of a pair of drives, joints in the order of the second file."""
    first, second = common.first.file, common.second.file
    robots = (first.robot, *first.variants), (second.robot, *second.variants)
    names = list(second.robot.drives[other_index].gears)
    joints = [by_second[name] for name in names]
    gears = (
        _gears(robots[0], index, [joint.first.name for joint in joints]),
        _gears(robots[1], other_index, names),
    )
    senses = np.array([float(joint.sense) for joint in joints])
    return _DriveNumbers(robots, gears, senses, any(j.first.kind == JointKind.SLIDE for j in joints))


def _rows_as_written(
    common: CommonFrames, index: int, other_index: int, by_second: Mapping[str, PairedJoint]
) -> Iterator[Difference]:
    """Yield the rows of gears, gain, law and limits of two drives as the files have them.

    Where a joint counts the other way in the second file, controls do so too.
    """
    given = _drive_numbers(common, index, other_index, by_second)
    name = given.robots[0][0].drives[index].name
    if given.senses.size:
        sizes = common.judge.compare(*given.gears, relative)
        if sizes[0]:
            values = _short(given.gears[0][0]), _short(given.gears[1][0])
            yield difference(name, "drive", Quantity.GEAR, values, sizes)
    for quantity, field in DRIVE_NUMBERS.items():
        first = _numbers(given.robots[0], index, field)
        second = _numbers(given.robots[1], other_index, field)
        sign = 1.0 if quantity == Quantity.GAIN or quantity == Quantity.CONSTANT else -1.0
        sizes = common.judge.compare(first, second, relative)
        if sizes[0]:
            pair = sign * float(first[0]), sign * float(second[0])
            yield difference(name, "drive", quantity, pair, sizes, slide=given.slide)
    for quantity, field in DRIVE_LIMITS.items():
        first = _numbers(given.robots[0], index, field)
        second = _numbers(given.robots[1], other_index, field)
        yield from _limits_row(common, name, quantity, first, second, given.slide)


def _rows_at_joints(
    common: CommonFrames, index: int, other_index: int, by_second: Mapping[str, PairedJoint]
) -> Iterator[Difference]:
    """Yield the rows of the forces that two drives make at their joints, in the signs of the first file."""
    given = _drive_numbers(common, index, other_index, by_second)
    name = given.robots[0][0].drives[index].name
    if not given.senses.size:
        yield from _rows_as_written(common, index, other_index, by_second)
        return
    gears = given.gears[0], given.gears[1] * given.senses
    for quantity, field in DRIVE_NUMBERS.items():
        at_joints = []
        for robots, number, gear in zip(given.robots, (index, other_index), gears, strict=True):
            force = _numbers(robots, number, field)[:, None] * gear
            # Springs and dampers of a drive act through the gear on both sides
            if quantity in (Quantity.KP, Quantity.KV):
                force = -(force[:, :, None] * gear[:, None, :]).reshape(len(force), -1)
            at_joints.append(force)
        sizes = common.judge.compare(at_joints[0], at_joints[1], relative)
        if sizes[0]:
            values = _short(at_joints[0][0]), _short(at_joints[1][0])
            yield difference(name, "drive", quantity, values, sizes, slide=given.slide)
    for quantity, field in DRIVE_LIMITS.items():
        first = _numbers(given.robots[0], index, field)
        second = _numbers(given.robots[1], other_index, field)
        if quantity == Quantity.FORCE_LIMITS and given.senses.size == 1:
            first, second = (
                _times_gear(limits, gear) for limits, gear in zip((first, second), gears, strict=True)
            )
        yield from _limits_row(common, name, quantity, first, second, given.slide)


def _times_gear(limits: Array, gear: Array) -> Array:
    """Return limits (V, 2) of the force on a joint from limits of a drive's force and its gear (V, 1)."""
    forces: Array = np.sort(limits * np.where(gear == 0.0, 1.0, gear), axis=1)
    return forces


def _limits_row(
    common: CommonFrames, name: str, quantity: Quantity, first: Array, second: Array, slide: bool
) -> Iterator[Difference]:
    """Yield the row of limits (V, 2) of a drive."""
    sizes = common.judge.compare(first, second, relative)
    if sizes[0]:
        values = [numbers(limits[0]) if np.isfinite(limits[0]).any() else None for limits in (first, second)]
        yield difference(name, "drive", quantity, (values[0], values[1]), sizes, slide=slide)


def _short(values: Array) -> Value:
    """Return a single number as a number and several ones as a tuple."""
    return float(values[0]) if len(values) == 1 else numbers(values)
