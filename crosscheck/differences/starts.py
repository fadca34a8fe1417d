"""Rows of the named starts of runs, such as keyframes. They change the run, and not the robot."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import count

import numpy as np

from crosscheck.differences.connections import PairedJoint
from crosscheck.differences.difference import Difference, Quantity, difference
from crosscheck.differences.frames import CommonFrames
from crosscheck.differences.joint_tree import SCALAR
from crosscheck.differences.stack import absolute
from newton_euler.reading.robot import JointKind, Robot, RobotFile
from newton_euler.scalars import Array

CHANGES_RUN = "changes the run, not the robot"
"""Cause of rows about the runs that a file asks for."""


def start_rows(common: CommonFrames, joints: Sequence[PairedJoint]) -> Iterator[Difference]:
    """Yield a row for each coordinate of a start whose value differs by more than its digits leave open.

    Starts of equal names are compared, and starts without names in their order. They are compared at hinges
    and slides that have partners.

    Args:
        common: both robots.
        joints: pairs of joints.
    """
    one, two = common.first.file, common.second.file
    single = [
        joint for joint in joints if joint.first.kind == joint.second.kind and joint.first.kind in SCALAR
    ]
    names, other_names = _start_names(one.robot), _start_names(two.robot)
    for name in (each for each in names if each in other_names):
        first, second = names.index(name), other_names.index(name)
        words = f"keyframe {name!r} {CHANGES_RUN}"  # a number has no quotation marks
        # joints that have no name in a file are in none of its starts
        known, others = one.robot.starts[first].coordinates, two.robot.starts[second].coordinates
        for joint in (each for each in single if each.first.name in known and each.second.name in others):
            element, slide = joint.first.name, joint.first.kind == JointKind.SLIDE
            for quantity, field, offset in (
                (Quantity.START, "coordinates", joint.offset),
                (Quantity.START_SPEED, "velocities", 0.0),
            ):
                own = _numbers(one, first, field, element)
                other = joint.sense * (_numbers(two, second, field, joint.second.name) - offset)
                sizes = common.judge.compare(own, other, absolute)
                if sizes[0] > sizes[1]:
                    values = float(own[0]), float(other[0])
                    yield difference(
                        element, "joint", quantity, values, sizes, words, slide=slide, convention=True
                    )


def _start_names(robot: Robot) -> list[str | int]:
    """Return the name of each start of a robot, or its number among those without names, from 0."""
    numbers = count()
    return [start.name or next(numbers) for start in robot.starts]


def _numbers(file: RobotFile, start: int, field: str, joint: str) -> Array:
    """Return the coordinate or velocity (V,) of a joint at a start of a robot and its variants."""
    return np.array([getattr(robot.starts[start], field)[joint] for robot in file.robots])
