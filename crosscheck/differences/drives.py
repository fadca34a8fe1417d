"""Rows of the drives of two robots: gears, gains, springs, dampers and limits, as written or at joints."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from crosscheck.differences.connections import PairedJoint, only_in_one
from crosscheck.differences.difference import Difference, Quantity, Value, difference, numbers
from crosscheck.differences.drive_pairs import drive_pairs
from crosscheck.differences.frames import CommonFrames
from crosscheck.differences.places import place_rows
from crosscheck.differences.settings import Names, names_in_first
from crosscheck.differences.stack import relative
from crosscheck.differences.unnamed import is_numbered
from newton_euler.reading.robot import FilePlace, JointKind, Robot, RobotFile
from newton_euler.scalars import Array

DRIVE_LIMITS = {Quantity.CONTROL_LIMITS: "control_limits", Quantity.FORCE_LIMITS: "force_limits"}
"""Limits of a drive, with the names of their fields."""

DRIVE_NUMBERS = {
    Quantity.GAIN: "gain",
    Quantity.KP: "stiffness",
    Quantity.KV: "damping",
    Quantity.CONSTANT: "constant",
}
"""Numbers of a drive, with the names of their fields."""

NO_HINGE_OR_SLIDE = "a ball or a body"
"""What a drive without gears acts on, such as one at a site."""


def drive_rows(common: CommonFrames, joints: list[PairedJoint]) -> Iterator[Difference]:
    """Yield the rows of drives, paired by `drive_pairs`."""
    first, second = common.first.file.robot, common.second.file.robot
    by_second = {joint.second.name: joint for joint in joints}
    first_name = {joint.second.name: joint.first.name for joint in joints}
    paired = drive_pairs(first, second, [joint.pair for joint in joints])
    names = names_in_first(common, joints)
    for index, other_index in paired:
        yield from _paired_drive(common, index, other_index, by_second)
        yield from _rows_of_others(common, index, other_index, names)
    yield from _name_row(common, paired)
    known, known_others = {one for one, _ in paired}, {two for _, two in paired}
    alone = [drive for k, drive in enumerate(first.drives) if k not in known]
    others = [drive for k, drive in enumerate(second.drives) if k not in known_others]
    for drive in list(alone):
        namesake = next((other for other in others if other.name == drive.name), None)
        if namesake is not None:
            alone.remove(drive)
            others.remove(namesake)
            joints_of_both = (
                ", ".join(drive.gears) or NO_HINGE_OR_SLIDE,
                ", ".join(first_name.get(name, name) for name in namesake.gears) or NO_HINGE_OR_SLIDE,
            )
            words = "the drive acts on another joint"
            yield difference(drive.name, "drive", Quantity.TRANSMISSION, joints_of_both, (1.0, 0.0), words)
    for in_first, drives in ((True, alone), (False, others)):
        for drive in drives:
            yield only_in_one("drive", drive.name, f"on {', '.join(drive.gears) or 'a body'}", in_first)


def _name_row(common: CommonFrames, paired: Sequence[tuple[int, int]]) -> Iterator[Difference]:
    """Yield one row for all names that the second file gives to other drives than the first."""
    first, second = common.first.file.robot.drives, common.second.file.robot.drives
    others = {
        first[one].name: second[two].name
        for one, two in paired
        if first[one].name != second[two].name and not is_numbered(first[one])
    }
    exchanged = [name for name in others if name in others.values()]
    if exchanged:
        name = exchanged[0]
        words = "both files have these names, for other drives: what finds drives by name takes another"
        row = difference(name, "drive", Quantity.NAME, (name, others[name]), (1.0, 0.0), words)
        yield replace(row, elements=tuple(exchanged))


def _paired_drive(
    common: CommonFrames, index: int, other_index: int, by_second: Mapping[str, PairedJoint]
) -> Iterator[Difference]:
    """Yield the rows of two drives: as the files have them, or as forces on the joints if that is fewer."""
    as_written = [*_rows_as_written(common, index, other_index, by_second)]
    at_joints = [*_rows_at_joints(common, index, other_index, by_second)]
    counts = [sum(row.size > row.uncertainty for row in rows) for rows in (as_written, at_joints)]
    yield from at_joints if counts[1] < counts[0] else as_written


def _rows_of_others(common: CommonFrames, index: int, other_index: int, names: Names) -> Iterator[Difference]:
    """Yield the rows of what else the files say of two drives; `names` are those in the first file."""
    drive = common.first.file.robot.drives[index]
    other = common.second.file.robot.drives[other_index]
    for what in sorted({*drive.other, *other.other}):
        values = drive.other.get(what), other.other.get(what)
        if isinstance(values[1], str):
            values = values[0], names.get((what, values[1]), values[1])
        if isinstance(values[0], FilePlace) and isinstance(values[1], FilePlace):
            places = _places(common.first.file, index, what), _places(common.second.file, other_index, what)
            yield from place_rows(common, (drive.name, "drive", what), places)
        elif values[0] != values[1]:
            sizes = 1.0, 0.0
            if isinstance(values[0], float) and isinstance(values[1], float):
                sizes = common.judge.compare(np.array([values[0]]), np.array([values[1]]), relative)
            if sizes[0]:
                shown = [str(v.kind) if isinstance(v, FilePlace) else v for v in values]
                yield difference(drive.name, "drive", Quantity.SETTING, (shown[0], shown[1]), sizes, what)


def _places(file: RobotFile, index: int, name: str) -> list[FilePlace]:
    """Return a place of a drive in a file and its variants."""
    values = (robot.drives[index].other[name] for robot in file.robots)
    return [value for value in values if isinstance(value, FilePlace)]


def _numbers(robots: tuple[Robot, ...], index: int, field: str) -> Array:
    """Return a number (V,) or (V, 2) of a drive of a robot and its variants, by the name of its field."""
    return np.array([getattr(robot.drives[index], field) for robot in robots])


def _gears(robots: tuple[Robot, ...], index: int, joints: list[str]) -> Array:
    """Return the gears (V, n) of a drive on joints with given names."""
    return np.array([[robot.drives[index].gears[name] for name in joints] for robot in robots])


class _DriveNumbers(NamedTuple):
    """Numbers of a drive of both robots and whether it acts on slides."""

    robots: tuple[tuple[Robot, ...], tuple[Robot, ...]]
    gears: tuple[Array, Array]
    senses: Array
    slide: bool


def _drive_numbers(
    common: CommonFrames, index: int, other_index: int, by_second: Mapping[str, PairedJoint]
) -> _DriveNumbers:
    """Return the numbers of a pair of drives, joints in the order of the second file."""
    first, second = common.first.file, common.second.file
    robots = first.robots, second.robots
    names = list(second.robot.drives[other_index].gears)
    joints = [by_second[name] for name in names]
    gears = (
        _gears(robots[0], index, [joint.first.name for joint in joints]),
        _gears(robots[1], other_index, names),
    )
    senses = np.array([float(joint.sense) for joint in joints])
    return _DriveNumbers(robots, gears, senses, any(j.first.kind == JointKind.SLIDE for j in joints))


def _rows_as_written(
    common: CommonFrames, index: int, other_index: int, by_second: Mapping[str, PairedJoint]
) -> Iterator[Difference]:
    """Yield the rows of gears, gain, law and limits of two drives as the files have them.

    Where a joint counts the other way in the second file, controls do so too.
    """
    given = _drive_numbers(common, index, other_index, by_second)
    name = given.robots[0][0].drives[index].name
    if given.senses.size:
        sizes = common.judge.compare(*given.gears, relative)
        if sizes[0]:
            values = _short(given.gears[0][0]), _short(given.gears[1][0])
            yield difference(name, "drive", Quantity.GEAR, values, sizes)
    for quantity, field in DRIVE_NUMBERS.items():
        first = _numbers(given.robots[0], index, field)
        second = _numbers(given.robots[1], other_index, field)
        sign = 1.0 if quantity == Quantity.GAIN or quantity == Quantity.CONSTANT else -1.0
        sizes = common.judge.compare(first, second, relative)
        if sizes[0]:
            pair = sign * float(first[0]), sign * float(second[0])
            yield difference(name, "drive", quantity, pair, sizes, slide=given.slide)
    for quantity, field in DRIVE_LIMITS.items():
        first = _numbers(given.robots[0], index, field)
        second = _numbers(given.robots[1], other_index, field)
        yield from _limits_row(common, name, quantity, first, second, given.slide)


def _rows_at_joints(
    common: CommonFrames, index: int, other_index: int, by_second: Mapping[str, PairedJoint]
) -> Iterator[Difference]:
    """Yield the rows of the forces that two drives make at their joints, in the signs of the first file."""
    given = _drive_numbers(common, index, other_index, by_second)
    name = given.robots[0][0].drives[index].name
    if not given.senses.size:
        yield from _rows_as_written(common, index, other_index, by_second)
        return
    gears = given.gears[0], given.gears[1] * given.senses
    for quantity, field in DRIVE_NUMBERS.items():
        at_joints = []
        for robots, number, gear in zip(given.robots, (index, other_index), gears, strict=True):
            force = _numbers(robots, number, field)[:, None] * gear
            # Springs and dampers of a drive act through the gear on both sides
            if quantity in (Quantity.KP, Quantity.KV):
                force = -(force[:, :, None] * gear[:, None, :]).reshape(len(force), -1)
            at_joints.append(force)
        sizes = common.judge.compare(at_joints[0], at_joints[1], relative)
        if sizes[0]:
            values = _short(at_joints[0][0]), _short(at_joints[1][0])
            yield difference(name, "drive", quantity, values, sizes, slide=given.slide)
    for quantity, field in DRIVE_LIMITS.items():
        first = _numbers(given.robots[0], index, field)
        second = _numbers(given.robots[1], other_index, field)
        if quantity == Quantity.FORCE_LIMITS and given.senses.size == 1:
            first, second = (
                _times_gear(limits, gear) for limits, gear in zip((first, second), gears, strict=True)
            )
        yield from _limits_row(common, name, quantity, first, second, given.slide)


def _times_gear(limits: Array, gear: Array) -> Array:
    """Return limits (V, 2) of the force on a joint from limits of a drive's force and its gear (V, 1)."""
    forces: Array = np.sort(limits * np.where(gear == 0.0, 1.0, gear), axis=1)
    return forces


def _limits_row(
    common: CommonFrames, name: str, quantity: Quantity, first: Array, second: Array, slide: bool
) -> Iterator[Difference]:
    """Yield the row of limits (V, 2) of a drive."""
    sizes = common.judge.compare(first, second, relative)
    if sizes[0]:
        values = [numbers(limits[0]) if np.isfinite(limits[0]).any() else None for limits in (first, second)]
        yield difference(name, "drive", quantity, (values[0], values[1]), sizes, slide=slide)


def _short(values: Array) -> Value:
    """Return a single number as a number and several ones as a tuple."""
    return float(values[0]) if len(values) == 1 else numbers(values)
