"""Rows of places that are no joint, loop or spring, such as sites of actuators and of tendons.

In: places of two files, each in the frame of its body. Out: rows in the common frame of both bodies, so that
the frames of the files do not matter.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from typing import NamedTuple, assert_never

import numpy as np

from crosscheck.differences.difference import Difference, Quantity, Value, difference, numbers
from crosscheck.differences.frames import IN_WORLD, CommonFrames
from crosscheck.differences.stack import Line, Poses, Side, angle, distance, turn_angle
from newton_euler.reading.robot import FilePlace, PlaceKind
from newton_euler.scalars import Array


class _Size(NamedTuple):
    """Difference of two places: both values, size and uncertainty, and unit."""

    values: tuple[Value, Value]
    sizes: tuple[float, float]
    unit: str


def place_rows(
    common: CommonFrames, about: tuple[str, str, str], places: tuple[Sequence[FilePlace], Sequence[FilePlace]]
) -> Iterator[Difference]:
    """Yield the row of a place that both files have, if it differs.

    Args:
        common: both robots.
        about: name and kind of the element, and what the place is.
        places: the place in each file and its variants.
    """
    name, kind, what = about
    row = partial(difference, name, kind, Quantity.SETTING)
    pairs = common.first_of, common.second_of
    bodies = [those[0].body for those in places]
    ends = [IN_WORLD if body < 0 else of.get(body) for of, body in zip(pairs, bodies, strict=True)]
    sides = common.first, common.second
    if ends[0] is None or ends[0] != ends[1]:
        first, second = (_body_name(side, body) for side, body in zip(sides, bodies, strict=True))
        words = what if None not in ends else f"{what}: not compared, on a body that only one file has"
        yield row((first, second), (1.0, 0.0), words)
        return
    frame = common.frames[ends[0]]
    one, two = (
        at_body.inverse() @ _in_world(side, those)
        for at_body, side, those in zip((frame.first, frame.second), sides, places, strict=True)
    )
    kinds = places[0][0].kind, places[1][0].kind
    if kinds[0] is not kinds[1]:
        yield row((str(kinds[0]), str(kinds[1])), (1.0, 0.0), what)
        return
    differing = [each for each in _sizes(common, ends[0], kinds[0], one, two) if each.sizes[0]]
    if differing:
        largest = max(differing, key=lambda each: each.sizes[0] > each.sizes[1])  # rather than rounding
        yield replace(row(largest.values, largest.sizes, what), unit=largest.unit)


def _sizes(common: CommonFrames, number: int, kind: PlaceKind, one: Poses, two: Poses) -> Iterator[_Size]:
    """Yield the differences of what counts of two frames (V, ...) in the common frame of a pair of bodies."""
    compare: Callable[..., tuple[float, float]] = partial(common.compare, number)
    axes = one.rotation[..., 2], two.rotation[..., 2]
    match kind:
        case PlaceKind.POINT:
            yield _of_points(compare, one.position, two.position)
        case PlaceKind.LINE:
            point = one.position[0]
            lines = (Line(axis, pose.position) for axis, pose in zip(axes, (one, two), strict=True))
            yield _of_points(compare, *(line.nearest(point) for line in lines))
            sizes = compare(*axes, _angle_of_lines)
            yield _Size((numbers(axes[0][0]), numbers(axes[1][0])), sizes, "rad")
        case PlaceKind.DIRECTION:
            sizes = compare(*axes, angle)
            yield _Size((numbers(axes[0][0]), numbers(axes[1][0])), sizes, "rad")
        case PlaceKind.FRAME:
            yield _of_points(compare, one.position, two.position)
            sizes = compare(one.rotation, two.rotation, turn_angle)
            yield _Size((0.0, sizes[0]), sizes, "rad")
        case _:
            assert_never(kind)


def _of_points(compare: Callable[..., tuple[float, float]], one: Array, two: Array) -> _Size:
    """Return the difference of two points (V, 3), m."""
    return _Size((numbers(one[0]), numbers(two[0])), compare(one, two, distance), "m")


def _in_world(side: Side, places: Sequence[FilePlace]) -> Poses:
    """Return where a place of a file and its variants is in the world."""
    inside = Poses.of([place.frame for place in places])
    body = places[0].body
    return side.world[body] @ inside if body >= 0 else inside


def _body_name(side: Side, body: int) -> str:
    """Return the name of a body of a file."""
    return side.file.robot.bodies[body].name if body >= 0 else "the ground"


def _angle_of_lines(reference: Array, values: Array) -> Array:
    """Return the angles (V,), rad, between lines along unit vectors (V, 3), which have no direction."""
    angles = angle(reference, values)
    return np.minimum(angles, math.pi - angles)
