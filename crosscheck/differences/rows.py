"""Differing numbers of two robot files in the terms of the first file, one row for one cause.

In: two `RobotFile`s and their `Alignment`. Out: rows of type `Difference`.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from crosscheck.differences.alignment import Alignment
from crosscheck.differences.bodies import body_rows
from crosscheck.differences.causes import merged_rows, with_causes
from crosscheck.differences.connections import coupling_rows, joint_partners, loop_rows
from crosscheck.differences.consequences import with_consequences
from crosscheck.differences.difference import Difference, Quantity, Standing, Value, difference, numbers
from crosscheck.differences.drives import drive_rows
from crosscheck.differences.frames import IN_WORLD, CommonFrames, common_frames, has_joint_above, joint_name
from crosscheck.differences.joint_causes import with_joint_causes
from crosscheck.differences.joint_order import with_joint_order
from crosscheck.differences.joints import joint_rows, moved_joint_row, regrouped_rows
from crosscheck.differences.moved_bodies import with_moved_bodies
from crosscheck.differences.settings import setting_rows
from crosscheck.differences.springs import spring_rows
from crosscheck.differences.stack import Side, angle, distance
from crosscheck.differences.starts import CHANGES_RUN, start_rows
from crosscheck.differences.transmissions import transmission_rows
from crosscheck.differences.vectors import rotation_vector
from newton_euler.reading.robot import IN_PLACE, JointKind, LoopKind, Robot, RobotFile
from newton_euler.scalars import Array

__all__ = ["Difference", "Quantity", "Standing", "differences"]

EARTH = (0.0, 0.0, -9.81)
"""m/s^2, gravity that engines take for a file without gravity."""

MASS_QUANTITIES = (Quantity.MASS, Quantity.CENTER, Quantity.INERTIA, Quantity.INERTIA_AXES)
"""Quantities of a body that have no effect if the body stands still."""

IF_FLOATING = "matters only if the base floats"
"""Cause of rows about masses that have no effect while the base is held."""

MIN_TURN = 1e-6
"""rad, and fraction of the robot's length: smallest motion of a frame that is reported."""


def differences(
    first: RobotFile, second: RobotFile, alignment: Alignment, tolerance: float | None
) -> list[Difference]:
    """Return what differs between two robot files, one row for one cause.

    Args:
        first, second: the files.
        alignment: pairs of their bodies and joints.
        tolerance: relative difference that counts as rounding, instead of the digits of the files; None for
            the digits.

    Returns:
        True differences, then differences within the digits of the files, then conventions.
    """
    common = common_frames(first, second, alignment, tolerance)
    zeros: dict[tuple[int, int], float] = {}
    rows = [
        *_presence_rows(common),
        *_name_row(common),
        *_model_rows(common),
        *(row for number in common.frames if number != IN_WORLD for row in body_rows(common, number)),
        *(row for place in common.joints for row in joint_rows(common, place, zeros)),
        *(moved_joint_row(common, pair) for pair in common.moved_joints),
        *regrouped_rows(common),
        *loop_rows(common),
    ]
    joints = joint_partners(common, zeros)
    rows += [
        *coupling_rows(common, joints),
        *drive_rows(common, joints),
        *spring_rows(common),
        *transmission_rows(common, joints),
        *start_rows(common, joints),
        *setting_rows(common, joints),
    ]
    rows = [*_with_missing_meshes(rows, common)]
    at_rest = {
        first.robot.bodies[body].name
        for number in range(len(alignment.bodies))
        if common.stands_still(number)
        for body in alignment.bodies[number].first
    }
    fixed_alone = {
        file.robot.bodies[body].name
        for file, bodies in ((first, alignment.first_bodies), (second, alignment.second_bodies))
        for body in bodies
        if not has_joint_above(file.robot, body)
    }
    rows = with_moved_bodies(common, with_joint_causes(with_joint_order(common, rows)))
    rows = with_consequences(common, rows)
    has_ground = first.has_ground or second.has_ground
    return [
        _without_effect(row, at_rest, fixed_alone, has_ground)
        for row in with_causes(rows, first, second, tolerance)
    ]


def _with_missing_meshes(rows: list[Difference], common: CommonFrames) -> Iterator[Difference]:
    """Yield rows, of which one is about all bodies that have no mass because a mesh is missing."""
    first, second = common.first.file, common.second.file
    partners = {
        common.body_name(number): {second.robot.bodies[body].name for body in pair.second}
        for number, pair in enumerate(common.alignment.bodies)
    }
    of_meshes = []
    for row in rows:
        names = {row.element}, partners.get(row.element, set())
        values = row.first, row.second
        if row.quantity is Quantity.MASS and any(
            value == 0.0 and not own.isdisjoint(file.missing_meshes)
            for value, own, file in zip(values, names, (first, second), strict=True)
        ):
            of_meshes.append(row)
        else:
            yield row
    if of_meshes:
        yield merged_rows(of_meshes, "mesh missing: no mass")


def _without_effect(
    row: Difference, at_rest: set[str], fixed_alone: set[str], has_ground: bool
) -> Difference:
    """Return a row about masses that stand still with words for why it has no effect on the motion.

    It is no true difference if the files tell that the base is fixed. Otherwise the base may float.

    Args:
        row: the row.
        at_rest: names of bodies that stand still in both files.
        fixed_alone: names of bodies that only one file has, fixed to the base.
        has_ground: whether one of the files tells that the base is fixed.
    """
    is_mass = row.quantity in MASS_QUANTITIES and {*row.elements} <= at_rest
    is_fixed = row.quantity is Quantity.PRESENCE and {*row.elements} <= fixed_alone
    if row.standing is not Standing.DIFFERENT or row.element_kind != "body" or not (is_mass or is_fixed):
        return row
    words = "the base is fixed" if is_mass else "fixed to the ground"
    if not has_ground:
        words = IF_FLOATING
    cause = f"{row.cause}; {words}" if row.cause else words
    return replace(row, cause=cause, effect=0.0, convention=has_ground)


def _presence_rows(common: CommonFrames) -> Iterator[Difference]:
    """Yield a row for each body, with its joints, and each joint that only one file has."""
    alignment = common.alignment
    sides = (
        (common.first.file.robot, alignment.first_bodies, alignment.first_joints),
        (common.second.file.robot, alignment.second_bodies, alignment.second_joints),
    )
    for side, (robot, bodies, joints) in enumerate(sides):
        total = sum(body.mass for body in robot.bodies) or 1.0

        def values(value: Value, side: int = side) -> tuple[Value, Value]:
            """Return the value of an element that only this file has, as values of both files."""
            return (None, value) if side else (value, None)

        own: dict[int, list[str]] = {index: [] for index in bodies}
        for body, number in joints:
            kind = robot.bodies[body].joints[number].kind
            name = joint_name(robot, (body, number))
            if body in own:
                own[body].append(name)
            elif not (alignment.base and kind == JointKind.FREE):
                # The free joint of a base that the other file fixes is a difference of the base
                yield difference(name, "joint", Quantity.PRESENCE, values(str(kind)), (1.0, 0.0))
        for index, names in own.items():
            body_mass = robot.bodies[index].mass
            if body_mass or names:
                row = difference(
                    robot.bodies[index].name,
                    "body",
                    Quantity.PRESENCE,
                    values(body_mass),
                    (body_mass / total if body_mass else 1.0, 0.0),
                )
                yield replace(row, unit="kg", elements=tuple(dict.fromkeys((row.element, *names))))


def _name_row(common: CommonFrames) -> Iterator[Difference]:
    """Yield one row for all names that the second file gives to other bodies or joints than the first."""
    others = dict(common.alignment.renamed)
    exchanged = [name for name in others if name in others.values()]
    if exchanged:
        name = exchanged[0]
        joints = {joint.name for body in common.first.file.robot.bodies for joint in body.joints}
        words = "both files have these names, for other elements: what finds elements by name takes another"
        kind = "joint" if name in joints else "body"
        row = difference(name, kind, Quantity.NAME, (name, others[name]), (1.0, 0.0), words)
        yield replace(row, elements=tuple(exchanged))


def _model_rows(common: CommonFrames) -> Iterator[Difference]:
    """Yield the rows of the whole model: gravity, base, place in the world, and frames of links."""
    robots = common.first.file.robot, common.second.file.robot
    name = robots[0].name or "model"
    given = [robot.gravity for robot in robots]
    gravities = [np.asarray(EARTH if each is None else each)[None] for each in given]
    sizes = common.judge.compare(gravities[0], gravities[1], _relative_distance)
    if sizes[0]:
        values = [None if each is None else numbers(each) for each in given]
        yield difference(name, "model", Quantity.GRAVITY, (values[0], values[1]), sizes)
    if common.alignment.base:
        # "floating in the first, fixed in the second"
        held, _, other = common.alignment.base.partition(" in the first, ")
        values_of_base = held, other.removesuffix(" in the second")
        is_welded = _is_welded(common.first, held) or _is_welded(common.second, values_of_base[1])
        words = "a weld to the ground holds the base" if is_welded and "fixed" in values_of_base else ""
        row = difference(name, "model", Quantity.BASE, values_of_base, (1.0, 0.0), words)
        yield replace(row, convention=bool(words), effect=0.0 if words else None)
    yield from _run_rows(name, *robots)
    yield from _world_row(common, gravities[0])
    yield from _frame_row(common)


def _is_welded(side: Side, held: str) -> bool:
    """Return whether a robot has a floating base that a weld holds to the ground in the pose of the file."""
    robot, placements = side.file.robot, side.file.robot.placements()
    for loop in robot.loops if held == "floating" else ():
        frames = [
            (placements[body] if body >= 0 else IN_PLACE) @ frame
            for body, frame in ((loop.first, loop.first_frame), (loop.second, loop.second_frame))
        ]
        bodies = [body for body in (loop.first, loop.second) if body >= 0]
        is_base = len(bodies) == 1 and any(j.kind is JointKind.FREE for j in robot.bodies[bodies[0]].joints)
        gap = [one - two for one, two in zip(*frames, strict=True)]
        if loop.kind is LoopKind.WELD and is_base and all(np.abs(g).max() < MIN_TURN for g in gap):
            return True
    return False


def _run_rows(name: str, first: Robot, second: Robot) -> Iterator[Difference]:
    """Yield rows of the settings of runs, which do not change the robot; `name` is that of the model."""
    if first.time_step and second.time_step and first.time_step != second.time_step:
        values, size = (first.time_step, second.time_step), abs(second.time_step / first.time_step - 1.0)
        yield difference(name, "model", Quantity.TIME_STEP, values, (size, 0.0), CHANGES_RUN, convention=True)
    if first.integrator and second.integrator and first.integrator != second.integrator:
        names = first.integrator, second.integrator
        yield difference(name, "model", Quantity.INTEGRATOR, names, (1.0, 0.0), CHANGES_RUN, convention=True)


def _world_row(common: CommonFrames, gravity: Array) -> Iterator[Difference]:
    """Yield a row if the whole second robot stands at another place, or is turned against gravity (1, 3)."""
    frame = common.frames[IN_WORLD]
    placement = frame.placement
    turn, shift = _turn(placement.rotation), float(np.linalg.norm(placement.position))
    tilt = float(angle(gravity, gravity @ placement.rotation.T)[0])
    bases = [number for number in common.frames if number != IN_WORLD]
    if not bases or not _is_moved(common, IN_WORLD):
        return
    name = common.body_name(bases[0])
    # Digits of the axes that the base carries leave its direction open
    lines = [
        common.lines(place.pair, bases[0])
        for place in common.joints
        if place.parent == bases[0] and place.kind in (JointKind.HINGE, JointKind.SLIDE)
    ]
    at_base = [common.compare(bases[0], one.axis, other.axis, angle)[1] for one, other in lines]
    uncertainty = max(MIN_TURN, frame.slack_angle, min(at_base, default=0.0))
    if tilt > uncertainty:
        words = f"the whole robot is turned against gravity by {math.degrees(tilt):.4g} degrees"
        row = difference(name, "body", Quantity.BASE, (0.0, tilt), (tilt, 0.0), words)
        yield replace(row, unit="rad")
        return
    words = "the whole robot stands at another place in the world"
    is_shifted = shift > MIN_TURN * common.judge.length + frame.slack_shift
    size = shift if is_shifted else turn
    row = difference(name, "body", Quantity.BASE, (0.0, size), (size, 0.0), words, convention=True)
    yield replace(row, unit="m" if is_shifted else "rad")


def _frame_row(common: CommonFrames) -> Iterator[Difference]:
    """Yield one row for all links whose frames the second file has elsewhere."""
    turns, shifts = {}, {}
    for number, frame in common.frames.items():
        turn, shift = _turn(frame.placement.rotation), float(np.linalg.norm(frame.placement.position))
        if number != IN_WORLD and _is_moved(common, number):
            name = common.body_name(number)
            turns[name], shifts[name] = turn, shift
    if turns:
        is_turned = max(turns.values()) > MIN_TURN
        sizes = turns if is_turned else shifts
        name = max(sizes, key=sizes.__getitem__)
        words = "frames of links turned or moved; the links are the same"
        values = 0.0, sizes[name]
        row = difference(name, "body", Quantity.FRAME, values, (sizes[name], 0.0), words, convention=True)
        yield replace(row, unit="rad" if is_turned else "m", elements=tuple(turns))


def _is_moved(common: CommonFrames, number: int) -> bool:
    """Return whether a pair's frame in the second file is elsewhere by more than rounding."""
    frame = common.frames[number]
    return (
        _turn(frame.placement.rotation) > max(MIN_TURN, frame.slack_angle)
        or float(np.linalg.norm(frame.placement.position))
        > MIN_TURN * common.judge.length + frame.slack_shift
    )


def _relative_distance(reference: Array, values: Array) -> Array:
    """Return the distances (V,) of vectors (V, 3) from a vector (1, 3), relative to its length."""
    return distance(reference, values) / (float(np.linalg.norm(reference)) or 1.0)


def _turn(rotation: Array) -> float:
    """Return the angle, rad, of a rotation (3, 3)."""
    return float(np.linalg.norm(rotation_vector(rotation)))
