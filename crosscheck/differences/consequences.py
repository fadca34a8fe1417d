"""Numbers of loops and springs that follow from other numbers: both differ, and one row names them.

In: rows of single elements. Out: fewer rows. MuJoCo places the second point of a connect where the first one
is in the pose of the file, and takes lengths of tendons in this pose. One moved anchor or one moved joint
then changes several numbers. They follow if the opening of the loop in the pose of the first file, or the
length minus the distance of the points, is the same in both files.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Literal

import numpy as np

from crosscheck.differences.connections import End, Ends, ends_of_partners
from crosscheck.differences.difference import Difference, Quantity, Standing, numbers
from crosscheck.differences.frames import CommonFrames
from newton_euler.reading.robot import FileLoop, FileSpring, LoopKind, Robot
from newton_euler.scalars import Array

MAX_OPENING_CHANGE = 1e-3
"""Part of a difference by which the opening of a loop may change if the difference follows from others."""

PLACES_OF_JOINTS = (
    Quantity.JOINT_ORIGIN,
    Quantity.JOINT_AXIS,
    Quantity.JOINT_ORIENTATION,
    Quantity.ZERO,
)
"""Quantities of a joint that move what it carries."""

Elements = Literal["loops", "springs"]
"""Name, in `Robot`, of elements between two bodies."""


def with_consequences(common: CommonFrames, rows: Sequence[Difference]) -> list[Difference]:
    """Return rows without those that follow from others, which name them as `Difference.consequences`.

    Args:
        common: both robots.
        rows: rows of single elements.
    """
    found: list[Difference | None] = [*rows]
    robots = common.first.file.robot, common.second.file.robot
    elements: Elements
    for elements in ("loops", "springs"):
        for index, (other, *ends) in ends_of_partners(common, elements).items():
            pair = getattr(robots[0], elements)[index], getattr(robots[1], elements)[other]
            if _kind(pair[0]) is _kind(pair[1]) and _kind(pair[0]) is not LoopKind.SLIDE:
                _join(common, found, pair, (ends[0], ends[1]))
    return [row for row in found if row is not None]


def _join(
    common: CommonFrames,
    rows: list[Difference | None],
    pair: tuple[FileLoop | FileSpring, FileLoop | FileSpring],
    ends: tuple[Ends, Ends],
) -> None:
    """Join the row of a loop or a spring that follows from another row with that row.

    Args:
        common: both robots.
        rows: all rows; a row that follows becomes None.
        pair: the loop or the spring in both robots.
        ends: its ends in both robots.
    """
    robot = common.first.file.robot
    name = robot.loop_name(pair[0])
    different = {
        k: row for k, row in enumerate(rows) if row is not None and row.standing is Standing.DIFFERENT
    }
    own = {k: row for k, row in different.items() if row.element == name and row.element_kind != "joint"}
    points = [k for one, two in zip(*ends, strict=True) for k, row in own.items() if _is_of(row, one, two)]
    lengths = [k for k, row in own.items() if row.quantity in (Quantity.LOOP_LENGTH, Quantity.REST)]
    joints = _joints_between(robot, pair[0])
    moved = [
        k
        for k, row in different.items()
        if row.element_kind == "joint" and row.element in joints and row.quantity in PLACES_OF_JOINTS
    ]
    if _kind(pair[0]) in (LoopKind.ROD, None):
        following, causes, what = lengths, points or moved, "the length"
    elif _kind(pair[0]) is LoopKind.WELD:
        # MuJoCo takes the pose that a weld holds from the pose of the file
        held = (Quantity.LOOP_POINT, Quantity.LOOP_AXIS)
        following, causes, what = [k for k, row in own.items() if row.quantity in held], moved, "the pose"
    elif len(points) == 2:
        following, causes, what = points[1:], points[:1], "the point on the other body"
    else:
        following, causes, what = points, moved, "a point"
    if not following or not causes:
        return
    row, cause = different[following[-1]], max(causes, key=lambda k: different[k].size)
    openings = [_openings(common, *each) for each in zip(pair, ends, (0, 1), strict=True)]
    change = float(np.abs(openings[1] - openings[0]).max())
    if change <= row.uncertainty + MAX_OPENING_CHANGE * row.size:
        of = "" if cause in points else f" of {name}"
        named = rows[cause] or different[cause]
        parts = [part for part in named.cause.split("; ") if part]
        rows[cause] = replace(
            named,
            cause="; ".join(dict.fromkeys((*parts, f"{what}{of} follows"))),
            consequences=(*named.consequences, name),
        )
        for k in following:
            rows[k] = None


def _kind(element: FileLoop | FileSpring) -> LoopKind | None:
    """Return the kind of a loop; None for a spring."""
    return element.kind if isinstance(element, FileLoop) else None


def _is_of(row: Difference, end: End, other_end: End) -> bool:
    """Return whether a row is about the points of an end of a loop or a spring in both robots."""
    values = numbers(end.frame.position[0]), numbers(other_end.frame.position[0])
    return row.quantity in (Quantity.LOOP_POINT, Quantity.SPRING_POINT) and values == (row.first, row.second)


def _openings(common: CommonFrames, element: FileLoop | FileSpring, ends: Ends, side: int) -> Array:
    """Return how far a loop is open in the pose of the first file.

    Args:
        common: both robots.
        element: the loop or the spring.
        ends: its ends.
        side: 0 for the first robot, 1 for the second.

    Returns:
        vector (3,) from the first to the second point, m, in the frame of the first body; for a rod and a
        spring the length, or both lengths, minus the distance of the points.
    """
    bodies = [(common.frames[end.number].first, common.frames[end.number].second)[side] for end in ends]
    points = [body.point(end.frame.position)[0] for body, end in zip(bodies, ends, strict=True)]
    opening = points[1] - points[0]
    apart = float(np.linalg.norm(opening))
    if isinstance(element, FileSpring):
        return np.array(element.rest) - apart
    if element.kind is LoopKind.ROD:
        return np.array([element.length - apart])
    if element.kind is not LoopKind.WELD:
        return np.asarray(opening @ bodies[0].rotation[0])
    turns = [body.rotation[0] @ end.frame.rotation[0] for body, end in zip(bodies, ends, strict=True)]
    return np.concatenate([opening @ bodies[0].rotation[0], (turns[0].T @ turns[1]).ravel()])


def _joints_between(robot: Robot, element: FileLoop | FileSpring) -> set[str]:
    """Return the names of the joints on the ways from both bodies of a loop or a spring to a common body."""
    ways: list[list[int]] = []
    for end in (element.first, element.second):
        way, body = [], end
        while body >= 0:
            way.append(body)
            body = robot.bodies[body].parent
        ways.append(way)
    bodies = {*ways[0]} ^ {*ways[1]}
    return {joint.name for body in bodies for joint in robot.bodies[body].joints}
