"""Rows of numbers for which the description of a robot has no model, in the terms of the files.

In: both robots with their `Robot.settings`. Out: a row for each that differs or that only one file has.
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from crosscheck.differences.connections import PairedJoint
from crosscheck.differences.difference import Difference, Quantity, Value, difference, numbers
from crosscheck.differences.frames import CommonFrames
from crosscheck.differences.places import place_rows
from crosscheck.differences.stack import distance
from newton_euler.reading.robot import FilePlace, Robot, Setting, SettingValue
from newton_euler.scalars import Array

Settings = Mapping[Setting, SettingValue]
"""Numbers and words of a robot, see `Robot.settings`."""

Names = Mapping[tuple[str, str], str]
"""Names of elements of the first robot, by their kind and their name in the second robot."""

LIKE = 1e-3
"""Difference of equal numbers of two tendons, relative, in m or rad; finds partners of those without name."""

LENGTHS = ("range", "springlength")
"""Numbers that are lengths of a tendon."""


def setting_rows(common: CommonFrames, joints: Sequence[PairedJoint]) -> Iterator[Difference]:
    """Yield a row for each element and number that differs; elements of other names may be partners.

    Args:
        common: both robots.
        joints: pairs of joints.
    """
    first, second = common.first.file, common.second.file
    names = names_in_first(common, joints)
    stacks = (
        [robot.settings for robot in first.robots],
        [_in_first(robot, names, joints) for robot in second.robots],
    )
    for key in dict.fromkeys((*stacks[0][0], *stacks[1][0])):
        values = stacks[0][0].get(key), stacks[1][0].get(key)
        name = key.element or first.robot.name or "model"
        if isinstance(values[0], FilePlace) and isinstance(values[1], FilePlace):
            places = _places(stacks[0], key), _places(stacks[1], key)
            yield from place_rows(common, (name, key.element_kind, key.words), places)
            continue
        sizes = 1.0, 0.0
        if isinstance(values[0], tuple) and isinstance(values[1], tuple):
            one, two = (np.array([settings[key] for settings in stack], float) for stack in stacks)
            sizes = common.judge.compare(one, two, _relative_distance)
        if sizes[0] and values[0] != values[1]:
            # What exerts no force may be beyond the format of the other file
            is_beyond = None in values and first.format != second.format and not key.exerts
            shown = _shown(values[0]), _shown(values[1])
            yield difference(
                name, key.element_kind, Quantity.SETTING, shown, sizes, key.words, convention=is_beyond
            )


def names_in_first(common: CommonFrames, joints: Sequence[PairedJoint]) -> Names:
    """Return the names of bodies, joints, tendons and equalities in the first file.

    Args:
        common: both robots.
        joints: pairs of joints.
    """
    first, second = common.first.file.robot, common.second.file.robot
    names = {("joint", joint.second.name): joint.first.name for joint in joints}
    names |= {
        ("body", second.bodies[pair.second[0]].name): first.bodies[pair.first[0]].name
        for pair in common.alignment.bodies
        if len(pair.first) == len(pair.second) == 1
    }
    # equalities refer to tendons
    for kind in ("tendon", "equality"):
        names |= _partners(common, kind, first.settings, _in_first(second, names, joints))
    return names


def _partners(common: CommonFrames, kind: str, first: Settings, second: Settings) -> Names:
    """Pair tendons or equalities: by their names, then those with the most equal numbers.

    Args:
        common: both robots.
        kind: kind of the elements.
        first, second: numbers of both robots, with names, senses and zeros of the first.
    """
    one, two = _by_element(kind, first), _by_element(kind, second)
    number = re.compile(rf"{kind} \d")  # name of an element that has none in its file
    found = {(kind, name): name for name in one.keys() & two.keys() if not number.match(name)}
    alone = [name for name in one if (kind, name) not in found]
    others = [name for name in two if (kind, name) not in found]
    likeness = {(a, b): _likeness(common, one[a], two[b]) for a in alone for b in others}
    for a, b in sorted(likeness, key=lambda names: -likeness[names]):
        if likeness[a, b] > 0.0 and a in alone and b in others:
            found[kind, b] = a
            alone.remove(a)
            others.remove(b)
    for b in (b for b in others if b in one):
        found[kind, b] = f"{b} of the second file"  # another element that has the same number
    return found


def _by_element(kind: str, settings: Settings) -> dict[str, dict[Setting, SettingValue]]:
    """Return the numbers of each element of a kind, under keys without its name."""
    found: dict[str, dict[Setting, SettingValue]] = defaultdict(dict)
    for key, value in settings.items():
        if key.element_kind == kind:
            found[key.element][key._replace(element="")] = value
    return found


def _likeness(common: CommonFrames, one: Settings, two: Settings) -> float:
    """Return the part of the numbers of two elements that are equal; 0 if no joint, point or name is."""
    equal = [key for key in one.keys() & two.keys() if _are_like(common, one[key], two[key])]
    if not any(key.joint or isinstance(one[key], FilePlace | str) for key in equal):
        return 0.0
    return len(equal) / len(one.keys() | two.keys())


def _are_like(common: CommonFrames, value: SettingValue, other: SettingValue) -> bool:
    """Return whether two values are about equal."""
    if isinstance(value, FilePlace) and isinstance(other, FilePlace):
        rows = place_rows(common, ("", "", ""), ([value], [other]))
        return all(row.size < LIKE for row in rows)
    if isinstance(value, tuple) and isinstance(other, tuple):
        return bool(np.allclose(value, other, rtol=LIKE))
    return value == other


def _in_first(robot: Robot, names: Names, joints: Sequence[PairedJoint]) -> Settings:
    """Return the settings of the second robot with names, senses and zeros of the first.

    Args:
        robot: the second robot, or a variant of it.
        names: names in the first robot.
        joints: pairs of joints.
    """
    partners = {joint.second.name: joint for joint in joints}
    lengths: dict[str, float] = defaultdict(float)  # of fixed tendons where the first robot's are zero
    for key, value in robot.settings.items():
        if key.joint in partners and isinstance(value, tuple):
            lengths[key.element] += value[0] * partners[key.joint].offset
    found: dict[Setting, SettingValue] = {}
    for key, value in robot.settings.items():
        joint = names.get(("joint", key.joint), key.joint)
        element = names.get((key.element_kind, key.element), key.element)
        if isinstance(value, str):
            value = names.get((key.name.split()[-1], value), value)  # such as the first tendon of an equality
        elif isinstance(value, tuple) and key.joint in partners:
            value = (partners[key.joint].sense * value[0],)
        elif isinstance(value, tuple) and key.element_kind == "tendon" and key.name in LENGTHS:
            value = tuple(number - lengths[key.element] for number in value)
        found[key._replace(element=element, joint=joint)] = value
    return found


def _places(stack: Sequence[Settings], key: Setting) -> list[FilePlace]:
    """Return the place of a setting in a file and its variants."""
    values = (settings[key] for settings in stack)
    return [value for value in values if isinstance(value, FilePlace)]


def _relative_distance(reference: Array, values: Array) -> Array:
    """Return the distances (V,) of numbers (V, n) from numbers (1, n), relative to their size."""
    return distance(reference, values) / (float(np.linalg.norm(reference)) or 1.0)


def _shown(value: SettingValue | None) -> Value:
    """Return a value of a row: a single number as a number, and a place as its position, m."""
    if isinstance(value, FilePlace):
        return numbers(value.frame.position)
    return value[0] if isinstance(value, tuple) and len(value) == 1 else value
