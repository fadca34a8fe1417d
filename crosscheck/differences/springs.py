"""Rows of the springs and dampers between points of two robots."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from crosscheck.differences.connections import ends_of_partners, only_in_one, point_rows
from crosscheck.differences.difference import Difference, Quantity, Value, difference, numbers
from crosscheck.differences.frames import CommonFrames
from crosscheck.differences.stack import absolute, relative

SPRING_NUMBERS = {
    Quantity.STIFFNESS: ("stiffness", relative),
    Quantity.DAMPING: ("damping", relative),
    Quantity.REST: ("rest", absolute),
}
"""Numbers of a spring, with the names of their fields, and how they are compared."""


def spring_rows(common: CommonFrames) -> Iterator[Difference]:
    """Yield the rows of springs and dampers between points."""
    first, second = common.first.file, common.second.file
    partners = ends_of_partners(common, "springs")
    for index, spring in enumerate(first.robot.springs):
        name = first.robot.loop_name(spring)
        if index not in partners:
            yield only_in_one("spring", name, spring.stiffness, in_first=True)
            continue
        other_index, ends, other_ends = partners[index]
        yield from point_rows(common, (name, "spring", Quantity.SPRING_POINT), ends, other_ends)
        for quantity, (field, metric) in SPRING_NUMBERS.items():
            values = [
                np.array([getattr(robot.springs[number], field) for robot in file.robots])
                for file, number in ((first, index), (second, other_index))
            ]
            sizes = common.judge.compare(values[0], values[1], metric)
            if sizes[0]:
                shown = _shown(values[0][0]), _shown(values[1][0])
                yield difference(name, "spring", quantity, shown, sizes, slide=True)
    paired = {other for other, _, _ in partners.values()}
    for other, spring in enumerate(second.robot.springs):
        if other not in paired:
            name = second.robot.loop_name(spring)
            yield only_in_one("spring", name, spring.stiffness, in_first=False)


def _shown(value: np.ndarray) -> Value:
    """Return a number, or two equal ones, as a number, and a range as a tuple."""
    unique = np.unique(value)
    return float(unique[0]) if len(unique) == 1 else numbers(value)
