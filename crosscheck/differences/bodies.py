"""Rows of the mass properties of bodies: mass, center of mass and inertia, in the frame of the first file."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations

from crosscheck.differences.difference import Difference, Quantity, difference, numbers
from crosscheck.differences.frames import CommonFrames
from crosscheck.differences.inertias import axes_angle, inertia_cause, moments
from crosscheck.differences.stack import MassProperties, Poses, Side, distance, matrix_distance, relative

CLEAR_TURN = 0.01
"""Smallest turn of the axes of an inertia, rad, that is reported in addition to other moments."""

MAX_PARTS = 10
"""Largest number of parts of one body whose choices are tried."""


def body_rows(common: CommonFrames, number: int) -> list[Difference]:
    """Return the rows of a pair of bodies that may consist of several parts fixed to each other.

    If both files have the same parts, the rows are those of parts, unless the mass is the same and the whole
    body needs fewer rows: if several parts stand elsewhere, the center of mass of the body is one row. If
    parts that only one file has explain the rows, one row remains.

    Args:
        common: both robots.
        number: of the pair of bodies.
    """
    first = _properties(common, number, common.first)
    second = _properties(common, number, common.second)
    rows = [*_mass_rows(common, number, common.body_name(number), first, second)]
    true_rows = [row for row in rows if row.size > row.uncertainty]
    if not true_rows:
        return rows
    if parts := _parts_in_one_file(common, number):
        return [replace(true_rows[0], cause=parts)]
    rows_of_parts = _rows_of_parts(common, number)
    needed = sum(row.size > row.uncertainty for row in rows_of_parts)
    is_whole_moved = needed > len(true_rows) and true_rows[0].quantity != Quantity.MASS
    return rows if is_whole_moved else rows_of_parts or rows


def _rows_of_parts(common: CommonFrames, number: int) -> list[Difference]:
    """Return the rows of the parts of a pair of bodies; none if the files do not have the same parts."""
    pair = common.alignment.bodies[number]
    robots = common.first.file.robot, common.second.file.robot
    parts, others = (
        {robot.bodies[body].name: body for body in bodies}
        for robot, bodies in zip(robots, (pair.first, pair.second), strict=True)
    )
    if len(parts) == 1 or parts.keys() != others.keys():
        return []
    return [
        row
        for name in parts
        for row in _mass_rows(
            common,
            number,
            name,
            *_properties_of_parts(common, number, parts[name], others[name]),
        )
    ]


def _properties_of_parts(
    common: CommonFrames, number: int, part: int, other: int
) -> tuple[MassProperties, MassProperties]:
    """Return the mass properties of a part of a pair's bodies in both robots, in the frame of the first part.

    In the second robot, this frame is at the same place in the common frame of the pair.
    """
    frame = common.frames[number]
    inside = frame.first.inverse() @ common.first.world[part]
    at_same_place = Poses(inside.rotation[:1], inside.position[:1])
    return (
        common.first.mass_properties((part,), frame.first @ at_same_place),
        common.second.mass_properties((other,), frame.second @ at_same_place),
    )


def _properties(
    common: CommonFrames, number: int, side: Side, bodies: tuple[int, ...] | None = None
) -> MassProperties:
    """Return the mass properties of a pair's bodies in one robot, all or some, in the common frame."""
    pair, frame = common.alignment.bodies[number], common.frames[number]
    if side is common.first:
        return side.mass_properties(bodies or pair.first, frame.first)
    return side.mass_properties(bodies or pair.second, frame.second)


def _mass_rows(
    common: CommonFrames, number: int, name: str, first: MassProperties, second: MassProperties
) -> Iterator[Difference]:
    """Yield the rows of mass, center of mass and inertia of a pair of bodies or of parts, with their name."""
    sizes = common.judge.compare(first.mass, second.mass, relative)
    if sizes[0]:
        values = float(first.mass[0]), float(second.mass[0])
        yield difference(name, "body", Quantity.MASS, values, sizes)
    if not (first.mass[0] and second.mass[0]):
        return
    sizes = common.compare(number, first.center, second.center, distance)
    if sizes[0]:
        centers = numbers(first.center[0]), numbers(second.center[0])
        yield difference(name, "body", Quantity.CENTER, centers, sizes)
    sizes = common.compare(number, first.inertia, second.inertia, matrix_distance)
    if sizes[0]:
        yield from _inertia_rows(common, name, first, second, sizes)


def _inertia_rows(
    common: CommonFrames,
    name: str,
    first: MassProperties,
    second: MassProperties,
    sizes: tuple[float, float],
) -> Iterator[Difference]:
    """Yield the rows of principal moments and axes of two inertias that differ.

    Args:
        common: both robots.
        name: of the body.
        first, second: mass properties in the common frame.
        sizes: relative difference of the matrices, and its uncertainty.
    """
    values = numbers(moments(first.inertia)[0]), numbers(moments(second.inertia)[0])
    if sizes[0] <= sizes[1]:
        yield difference(name, "body", Quantity.INERTIA, values, sizes)
        return
    cause = inertia_cause(first, second, max(sizes[1], 1e-6))
    change = common.judge.compare(moments(first.inertia), moments(second.inertia), relative)
    turn = axes_angle(first.inertia, second.inertia, common.judge)
    moments_differ, axes_differ = change[0] > change[1], turn[0] > turn[1]
    words = f"axes of the inertia turned by {math.degrees(turn[0]):.4g} degrees"
    if moments_differ:
        cause = cause or (words if axes_differ and turn[0] > CLEAR_TURN else "")
        yield difference(name, "body", Quantity.INERTIA, values, change, cause)
    elif axes_differ:
        yield difference(name, "body", Quantity.INERTIA_AXES, (0.0, turn[0]), turn, cause or words)
    else:
        # Axes of nearly equal moments are turned
        yield difference(name, "body", Quantity.INERTIA, values, sizes, cause)


def _parts_in_one_file(common: CommonFrames, number: int) -> str:
    """Return words for parts of a body that only one file has and without which both files agree; else ""."""
    pair = common.alignment.bodies[number]
    sides = ((common.first, pair.first, "first"), (common.second, pair.second, "second"))
    for (side, bodies, where), (other_side, other_bodies, _) in (sides, sides[::-1]):
        robot = side.file.robot
        known = {other_side.file.robot.bodies[body].name for body in other_bodies}
        unknown = [
            body for body in bodies[1:] if robot.bodies[body].mass and robot.bodies[body].name not in known
        ]
        other = _properties(common, number, other_side)
        surplus = _properties(common, number, side).mass[0] - other.mass[0]
        for extra in _with_sum(unknown, [robot.bodies[body].mass for body in unknown], surplus):
            kept = tuple(body for body in bodies if body not in extra)
            own = _properties(common, number, side, kept)
            sizes = (
                common.judge.compare(own.mass, other.mass, relative),
                common.compare(number, own.center, other.center, distance),
                common.compare(number, own.inertia, other.inertia, matrix_distance),
            )
            if all(size <= uncertainty for size, uncertainty in sizes):
                parts = ", ".join(f"{robot.bodies[b].name} ({robot.bodies[b].mass:.4g} kg)" for b in extra)
                return f"{parts} only in the {where} robot"
    return ""


def _with_sum(bodies: list[int], masses: list[float], total: float) -> Iterator[tuple[int, ...]]:
    """Yield choices of bodies whose masses, kg, add up to a total, fewest bodies first."""
    if len(bodies) > MAX_PARTS:
        bodies, masses = [], []
    for count in range(1, len(bodies) + 1):
        for chosen in combinations(range(len(bodies)), count):
            if math.isclose(sum(masses[index] for index in chosen), total, rel_tol=1e-3):
                yield tuple(bodies[index] for index in chosen)
