"""Rows of the transmissions of two URDFs: reductions, offsets, hardware interfaces, joints and actuators.

In: both robots with their `Robot.transmissions`. They have no effect on the compared motion; controllers read
them. A file of another format has no transmissions, and lacks nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from crosscheck.differences.connections import PairedJoint, only_in_one
from crosscheck.differences.difference import Difference, Quantity, Value, difference
from crosscheck.differences.frames import CommonFrames, joint_name
from crosscheck.differences.stack import absolute, relative
from newton_euler.reading.robot import FileTransmission, JointKind, Robot, TransmissionEnd

Number = Callable[[FileTransmission], float | str]
"""Function that returns a number of a transmission; a text if the file has no number there."""


def transmission_rows(common: CommonFrames, joints: Sequence[PairedJoint]) -> Iterator[Difference]:
    """Yield the rows of transmissions, paired by their joints, then by their names.

    Args:
        common: both robots.
        joints: pairs of joints.
    """
    first, second = common.first.file, common.second.file
    partners = {joint.second.name: joint.first.name for joint in joints}
    slides = {joint.first.name for joint in joints if joint.first.kind == JointKind.SLIDE}
    pairs = _pairs(first.robot, second.robot, partners)
    for one, two in pairs:
        yield from _paired_rows(common, (one, two), partners, slides)
    paired = [{one for one, _ in pairs}, {two for _, two in pairs}]
    sides = (first.robot, common.alignment.first_joints), (second.robot, common.alignment.second_joints)
    for side, (robot, alone) in enumerate(sides):
        own_joints = {joint_name(robot, key) for key in alone}
        for number, each in enumerate(robot.transmissions):
            names = [joint.name for joint in each.joints]
            # a joint that only one file has is a row, with its transmission
            if number in paired[side] or (names and own_joints.issuperset(names)):
                continue
            row = only_in_one("transmission", _name(each), f"on {', '.join(names)}", in_first=not side)
            other = (second, first)[side].format
            yield row if other == "URDF" else replace(row, convention=True, cause=f"{other} has none")


def _name(transmission: FileTransmission) -> str:
    """Return the name of a transmission, or those of its joints if it has none."""
    return transmission.name or f"of {', '.join(joint.name for joint in transmission.joints)}"


def _pairs(first: Robot, second: Robot, partners: dict[str, str]) -> list[tuple[int, int]]:
    """Return the indices of transmissions on the same joints, then of those with the same name.

    Args:
        first, second: the robots.
        partners: names of joints in the first robot by those in the second.
    """
    free = list(range(len(second.transmissions)))
    found: list[tuple[int, int]] = []
    left = []
    for index, own in enumerate(first.transmissions):
        joints = {joint.name for joint in own.joints}
        same = [
            k
            for k in free
            if {partners.get(joint.name, joint.name) for joint in second.transmissions[k].joints} == joints
            and (joints or second.transmissions[k].name == own.name)
        ]
        if same:
            found.append((index, min(same, key=lambda k: second.transmissions[k].name != own.name)))
            free.remove(found[-1][1])
        elif own.name:
            left.append(index)
    for index in left:
        name = first.transmissions[index].name
        if namesakes := [k for k in free if second.transmissions[k].name == name]:
            found.append((index, namesakes[0]))
            free.remove(namesakes[0])
    return found


def _paired_rows(
    common: CommonFrames, pair: tuple[int, int], partners: dict[str, str], slides: set[str]
) -> Iterator[Difference]:
    """Yield the rows of two transmissions.

    Args:
        common: both robots.
        pair: their indices.
        partners: names of joints in the first robot by those in the second.
        slides: names, in the first robot, of joints that slide.
    """
    robots = common.first.file.robot, common.second.file.robot
    own, other = (robot.transmissions[index] for robot, index in zip(robots, pair, strict=True))
    names = [joint.name for joint in own.joints]
    others = [partners.get(joint.name, joint.name) for joint in other.joints]
    if own.kind != other.kind:
        values = own.kind or None, other.kind or None
        yield difference(_name(own), "transmission", Quantity.KIND, values, (1.0, 0.0))
    if sorted(names) != sorted(others):
        values = ", ".join(names), ", ".join(others)
        yield difference(_name(own), "transmission", Quantity.TRANSMISSION_JOINTS, values, (1.0, 0.0))
        return

    def rows(
        element: str, quantity: Quantity, numbers: tuple[Number, Number], place: str
    ) -> Iterator[Difference]:
        """Yield the row of a number of a joint, at a place in the transmission."""
        values = numbers[0](own), numbers[1](other)
        sizes = float(values[0] != values[1]), 0.0
        if not any(isinstance(value, str) for value in values):
            stacks = [
                np.array([number(robot.transmissions[index]) for robot in file.robots], float)
                for file, number, index in zip(
                    (common.first.file, common.second.file), numbers, pair, strict=True
                )
            ]
            metric = absolute if quantity is Quantity.TRANSMISSION_OFFSET else relative
            sizes = common.judge.compare(stacks[0], stacks[1], metric)
        if sizes[0]:
            yield difference(element, "joint", quantity, values, sizes, place, slide=element in slides)

    whole = ", ".join(names) or _name(own)
    reductions: tuple[Number, Number] = (lambda each: each.reduction), (lambda each: each.reduction)
    yield from rows(whole, Quantity.REDUCTION, reductions, "")
    for number, name in enumerate(names):
        at = number, others.index(name)
        ends = own.joints[at[0]], other.joints[at[1]]
        yield from rows(name, Quantity.REDUCTION, _numbers("joints", "reduction", at), "at the joint")
        yield from rows(name, Quantity.TRANSMISSION_OFFSET, _numbers("joints", "offset", at), "")
        if ends[0].interfaces != ends[1].interfaces:
            interfaces = _listed(ends[0].interfaces), _listed(ends[1].interfaces)
            yield difference(name, "joint", Quantity.HARDWARE_INTERFACE, interfaces, (1.0, 0.0))
    counts = len(own.actuators), len(other.actuators)
    for number in range(min(counts)):
        element = names[number] if number < len(names) else whole
        numbers = _numbers("actuators", "reduction", (number, number))
        yield from rows(element, Quantity.REDUCTION, numbers, "at the actuator")
        numbers = _numbers("actuators", "offset", (number, number))
        yield from rows(element, Quantity.TRANSMISSION_OFFSET, numbers, "at the actuator")
    yield from _actuator_row(robots, whole, own, other)


def _numbers(ends: str, field: str, at: tuple[int, int]) -> tuple[Number, Number]:
    """Return functions that return a number of an end of the first and of the second transmission.

    Args:
        ends: field of the transmission, "joints" or "actuators".
        field: of the end.
        at: indices of the end in both transmissions.
    """

    def number(index: int) -> Number:
        return lambda each: getattr(getattr(each, ends)[index], field)

    return number(at[0]), number(at[1])


def _actuator_row(
    robots: tuple[Robot, Robot], joints: str, own: FileTransmission, other: FileTransmission
) -> Iterator[Difference]:
    """Yield the row of actuators with other names: a convention unless the names are of other actuators.

    Args:
        robots: both robots.
        joints: names of the joints that the transmissions drive.
        own, other: the transmissions.
    """
    values = _listed(_names(own.actuators)), _listed(_names(other.actuators))
    if values[0] == values[1]:
        return
    known, others = (
        {name for each in robot.transmissions for name in _names(each.actuators)} for robot in robots
    )
    is_used = any(name in others for name in _names(own.actuators)) or any(
        name in known for name in _names(other.actuators)
    )
    is_name = len(own.actuators) == len(other.actuators) and not is_used
    words = "another name" if is_name else ""
    yield difference(joints, "joint", Quantity.ACTUATOR, values, (1.0, 0.0), words, convention=is_name)


def _names(ends: Sequence[TransmissionEnd]) -> list[str]:
    """Return the names of ends of a transmission."""
    return [end.name for end in ends]


def _listed(names: Sequence[str]) -> Value:
    """Return names as a value of a row; None without names."""
    return ", ".join(names) or None
