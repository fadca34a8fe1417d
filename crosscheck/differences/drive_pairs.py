"""Drives of two robots that act on the same joints, and controls that command the same."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

from crosscheck.differences.alignment import Alignment, JointPair
from crosscheck.differences.unnamed import is_numbered
from newton_euler.reading.robot import FileDrive, Robot


def drive_pairs(first: Robot, second: Robot, joints: Iterable[JointPair]) -> list[tuple[int, int]]:
    """Return pairs of drives that act on the same joints.

    Drives of no joint are pairs if their transmissions are of the same kind. Of several drives, those of the
    same name are a pair, then those of the same kind of law, then those with the most equal numbers.
    """
    partners = {second.joint(pair.second).name: first.joint(pair.first).name for pair in joints}
    free = list(range(len(second.drives)))
    pairs = []
    for index, drive in enumerate(first.drives):
        same = [
            other
            for other in free
            if {partners.get(name) for name in second.drives[other].gears} == {*drive.gears}
            and drive.other.get("transmission") == second.drives[other].other.get("transmission")
        ]
        if same:
            partner = min(same, key=lambda other: _unlikeness(drive, second.drives[other]))
            pairs.append((index, partner))
            free.remove(partner)
    return pairs


def _unlikeness(drive: FileDrive, other: FileDrive) -> tuple[bool, int, bool, bool, float]:
    """Return a key that sorts drives of the same joints by their likeness to a drive."""
    gears = zip(sorted(drive.gears.values()), sorted(other.gears.values()), strict=False)
    numbers = (
        drive.stiffness - other.stiffness,
        drive.damping - other.damping,
        *(one * drive.gain - two * other.gain for one, two in gears),
    )
    limits = (drive.control_limits != other.control_limits) + (drive.force_limits != other.force_limits)
    return (
        drive.name != other.name and not (is_numbered(drive) and is_numbered(other)),
        len({*drive.other.items()} ^ {*other.other.items()}) if not drive.gears else 0,
        bool(drive.stiffness) != bool(other.stiffness),
        bool(drive.damping) != bool(other.damping),
        sum(map(abs, numbers)) + limits,
    )


def is_meant(first: Robot, second: Robot, pair: JointPair) -> bool:
    """Return whether the limits of a joint show that its other sense or zero in the second file is meant.

    They do if they fit clearly better when they are mirrored, or shifted with the zero. Infinite limits, and
    symmetric ones of a reversed joint, show nothing.
    """
    limits, other = first.joint(pair.first).limits, second.joint(pair.second).limits
    converted = sorted(pair.sense * limit + pair.offset for limit in limits)
    error, error_as_written = (
        max(0.0 if one == two else abs(one - two) for one, two in zip(each, other, strict=True))
        for each in (converted, limits)
    )
    return error < 0.5 * error_as_written


class Control(NamedTuple):
    """Control of a drive of the second robot by that of the first: sense times it, plus shift."""

    sense: int = 1
    shift: float = 0.0


def control_of_second(
    first: Robot, second: Robot, alignment: Alignment, own: FileDrive, drive: FileDrive
) -> Control:
    """Return the control of a drive of the second robot that commands the same as that of the first.

    If a joint counts the other way, or from another zero, and its limits show that this is meant, controls
    count as the joint does. Otherwise, or if the gear makes up for it, equal numbers command the same.

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
        if not is_meant(first, second, pair):
            return Control()
        gear = drive.gears[second.joint(pair.second).name]
        shift += gear * pair.offset
        is_reversed |= sense * gear * drive.gain * own.gears[first.joint(pair.first).name] * own.gain < 0
    return Control(sense if is_reversed else 1, -drive.stiffness * shift / drive.gain)
