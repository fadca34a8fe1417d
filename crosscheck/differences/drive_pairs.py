"""Drives of two robots that act on the same joints, and controls that command the same."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from crosscheck.differences.alignment import Alignment
from newton_euler.reading.robot import FileDrive, Robot

MAX_LIMIT_ERROR = 0.02
"""rad or m: largest error of limits that are meant to be mirrored or shifted with the zero of a joint."""


def drive_pairs(first: Robot, second: Robot, alignment: Alignment) -> list[tuple[int, int]]:
    """Return pairs of drives that act on the same joints; of several, those of the same name first."""
    partners = {second.joint(pair.second).name: first.joint(pair.first).name for pair in alignment.joints}
    free = list(range(len(second.drives)))
    pairs = []
    for index, drive in enumerate(first.drives):
        same = [
            other
            for other in free
            if {partners.get(name) for name in second.drives[other].gears} == {*drive.gears}
            and (drive.gears or second.drives[other].name == drive.name)
        ]
        if same:
            partner = min(same, key=lambda other: second.drives[other].name != drive.name)
            pairs.append((index, partner))
            free.remove(partner)
    return pairs


class Control(NamedTuple):
    """Control of a drive of the second robot by that of the first: sense times it, plus shift."""

    sense: int = 1
    shift: float = 0.0


def control_of_second(
    first: Robot, second: Robot, alignment: Alignment, own: FileDrive, drive: FileDrive
) -> Control:
    """Return the control of a drive of the second robot that commands the same as that of the first.

    If a joint counts the other way, or from another zero, and its limits do so too, the file means it:
    controls count as the joint does. If its limits do not, or the gear makes up for it, equal numbers command
    the same.

    Args:
        first, second: the robots.
        alignment: their pairs of bodies and joints.
        own, drive: drives of the first and the second robot on the same joints.
    """
    pairs = [pair for pair in alignment.joints if second.joint(pair.second).name in drive.gears]
    senses = {pair.sense for pair in pairs}
    if len(senses) != 1 or not drive.gain:
        return Control()
    sense, is_reversed, shift = senses.pop(), False, 0.0
    for pair in pairs:
        limits = first.joint(pair.first).limits
        other = second.joint(pair.second).limits
        expected = sorted(pair.sense * limit + pair.offset for limit in limits)
        if not np.allclose(expected, other, atol=MAX_LIMIT_ERROR):
            return Control()
        gear = drive.gears[second.joint(pair.second).name]
        shift += gear * pair.offset
        is_reversed |= sense * gear * drive.gain * own.gears[first.joint(pair.first).name] * own.gain < 0
    return Control(sense if is_reversed else 1, -drive.stiffness * shift / drive.gain)
