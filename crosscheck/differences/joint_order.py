"""Joints of one body whose order, or whose axes, are exchanged in the other file: one row.

In: rows of single elements. Out: fewer rows. Joints of one body are paired by their order. If the two axes of
a universal joint are exchanged, then all numbers of both joints are.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np

from crosscheck.differences.difference import Difference, Quantity, Standing, Value
from crosscheck.differences.frames import CommonFrames
from crosscheck.differences.stack import angle

MAX_TILT = 1e-4
"""rad, largest angle between an axis and that of the other joint with which it is exchanged."""

JointRows = dict[Quantity, Difference]
"""Rows of one joint."""


def with_joint_order(common: CommonFrames, rows: Sequence[Difference]) -> list[Difference]:
    """Return rows in which two joints of one body that are exchanged are one row.

    Args:
        common: both robots.
        rows: rows of single elements.
    """
    dropped: set[int] = set()
    joined: dict[int, Difference] = {}
    exchanged: set[str] = set()
    names_row = next((row for row in rows if row.quantity is Quantity.NAME), None)
    for names in _neighbors(common):
        one, two = (
            {row.quantity: row for row in rows if row.element_kind == "joint" and row.elements == (name,)}
            for name in names
        )
        if not _have_exchanged_axes(one, two):
            continue
        exchanged |= {*names}
        is_order = names_row is not None and {*names} <= {*names_row.elements}
        what = "the order of the joints is" if is_order else "the axes are"
        axis = one[Quantity.JOINT_AXIS]
        joined[id(axis)] = replace(axis, elements=names, cause=f"{what} exchanged")
        dropped.add(id(two[Quantity.JOINT_AXIS]))
        for own, other in ((one, two), (two, one)):
            dropped |= {id(row) for row in _explained(own, other)}
        if is_order:
            dropped |= {
                id(row)
                for row in rows
                if row.quantity is Quantity.TRANSMISSION and {row.first, row.second} == {*names}
            }
    if names_row is not None and {*names_row.elements} <= exchanged:
        dropped.add(id(names_row))
    return [joined.get(id(row), row) for row in rows if id(row) not in dropped]


def _neighbors(common: CommonFrames) -> Iterator[tuple[str, str]]:
    """Yield the names, in the first robot, of two joints that are at one body in both robots."""
    for one, two in combinations(common.alignment.joints, 2):
        if one.first[0] == two.first[0] and one.second[0] == two.second[0]:
            yield common.joint_name(one), common.joint_name(two)


def _have_exchanged_axes(one: JointRows, two: JointRows) -> bool:
    """Return whether each of two joints has, in the second file, axis and direction of the other one."""
    rows = [own.get(Quantity.JOINT_AXIS) for own in (one, two)]
    if any(row is None or row.standing is not Standing.DIFFERENT for row in rows):
        return False
    first, second = (_axes(own) for own in (one, two))
    pairs = (first[0], second[1]), (second[0], first[1])
    return all(angle(np.array(own, float), np.array(other, float)) < MAX_TILT for own, other in pairs)


def _axes(rows: JointRows) -> tuple[Value, Value]:
    """Return the axes of a joint in both files, that of the second in the direction of its file."""
    row = rows[Quantity.JOINT_AXIS]
    return row.first, _in_file(row, rows)


def _in_file(row: Difference, rows: JointRows) -> Value:
    """Return the value of the second file in the sense of that file; rows have that of the first file."""
    if Quantity.SIGN not in rows or not isinstance(row.second, tuple):
        return row.second
    reversed_values = tuple(-number for number in row.second)
    return reversed_values[::-1] if row.quantity is Quantity.LIMITS else reversed_values


def _explained(own: JointRows, other: JointRows) -> Iterator[Difference]:
    """Yield the rows of a joint that say that it has the numbers of another joint.

    The sense of a pair of joints whose axes are exchanged means nothing.
    """
    if Quantity.SIGN in own:
        yield own[Quantity.SIGN]
    for quantity in (own.keys() & other.keys()) - {Quantity.SIGN, Quantity.JOINT_AXIS}:
        rows = own[quantity], other[quantity]
        values = _in_file(rows[0], own), _in_file(rows[1], other)
        if rows[0].first == values[1] and rows[1].first == values[0]:
            yield rows[0]
