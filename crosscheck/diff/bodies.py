"""Rows of the mass properties of bodies: mass, center of mass and inertia, in the frame of the first file."""

from __future__ import annotations

import math
from collections.abc import Iterator

from crosscheck.diff.difference import Difference, Quantity, difference, numbers
from crosscheck.diff.frames import CommonFrames
from crosscheck.diff.inertias import axes_angle, inertia_cause, moments
from crosscheck.diff.short_angles import is_turn_by_short_pi
from crosscheck.diff.stack import MassProperties, Side, distance, matrix_distance, relative


def body_rows(common: CommonFrames, number: int) -> Iterator[Difference]:
    """Yield the rows of a pair of bodies; one row if parts that only one file has explain all of them.

    Args:
        common: both robots.
        number: of the pair of bodies.
    """
    first = _properties(common, number, common.first)
    second = _properties(common, number, common.second)
    rows = [*_mass_rows(common, number, first, second)]
    true_rows = [row for row in rows if row.size > row.uncertainty]
    parts = _parts_in_one_file(common, number) if true_rows else ""
    if not parts:
        yield from rows
        return
    main = true_rows[0]
    yield difference(
        main.element, "body", main.quantity, (main.first, main.second), (main.size, main.uncertainty), parts
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
    common: CommonFrames, number: int, first: MassProperties, second: MassProperties
) -> Iterator[Difference]:
    """Yield the rows of mass, center of mass and inertia of a pair of bodies."""
    name = common.body_name(number)
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
    if moments_differ:
        yield difference(name, "body", Quantity.INERTIA, values, change, cause)
    if axes_differ and not (moments_differ and cause):
        if is_turn_by_short_pi(*turn):
            turn = turn[0], turn[0]
        words = cause or f"axes of the inertia turned by {math.degrees(turn[0]):.4g} degrees"
        yield difference(name, "body", Quantity.INERTIA_AXES, (0.0, turn[0]), turn, words)
    elif not moments_differ:
        # Axes of nearly equal moments are turned
        yield difference(name, "body", Quantity.INERTIA, values, sizes, cause)


def _parts_in_one_file(common: CommonFrames, number: int) -> str:
    """Return words for parts of a body that only one file has and without which both files agree; else ""."""
    pair = common.alignment.bodies[number]
    sides = ((common.first, pair.first, "first"), (common.second, pair.second, "second"))
    for (side, bodies, where), (other_side, other_bodies, _) in (sides, sides[::-1]):
        robot = side.file.robot
        known = {other_side.file.robot.bodies[body].name for body in other_bodies}
        kept = tuple(body for body in bodies if robot.bodies[body].name in known or body == bodies[0])
        extra = [robot.bodies[body] for body in bodies if body not in kept and robot.bodies[body].mass]
        if not extra:
            continue
        own, other = _properties(common, number, side, kept), _properties(common, number, other_side)
        sizes = (
            common.judge.compare(own.mass, other.mass, relative),
            common.compare(number, own.center, other.center, distance),
            common.compare(number, own.inertia, other.inertia, matrix_distance),
        )
        if all(size <= uncertainty for size, uncertainty in sizes):
            parts = ", ".join(f"{part.name} ({part.mass:.4g} kg)" for part in extra)
            return f"{parts} only in the {where} file"
    return ""
