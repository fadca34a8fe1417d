"""Rows of numbers for which the description of a robot has no model, in the terms of the files.

In: both robots with their `Robot.settings`. Out: a row for each that differs or that only one file has.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from crosscheck.differences.difference import Difference, Quantity, Value, difference, numbers
from crosscheck.differences.frames import CommonFrames, joint_name
from crosscheck.differences.places import place_rows
from crosscheck.differences.stack import distance
from newton_euler.reading.robot import FilePlace, RobotFile, Setting, SettingValue
from newton_euler.scalars import Array


def setting_rows(common: CommonFrames) -> Iterator[Difference]:
    """Yield a row for each element and number that differs; bodies and joints of other names are partners."""
    first, second = common.first.file, common.second.file
    names = _names_in_first(common)
    by_first = {
        key._replace(element=names.get((key.element_kind, key.element), key.element)): key
        for key in second.robot.settings
    }
    for key in dict.fromkeys((*first.robot.settings, *by_first)):
        values = first.robot.settings.get(key), second.robot.settings.get(by_first.get(key, key))
        name = key.element or first.robot.name or "model"
        if isinstance(values[0], FilePlace) and isinstance(values[1], FilePlace):
            places = _places(first, key), _places(second, by_first[key])
            yield from place_rows(common, (name, key.element_kind, key.name), places)
            continue
        sizes = 1.0, 0.0
        if isinstance(values[0], tuple) and isinstance(values[1], tuple):
            stacks = _numbers(first, key), _numbers(second, by_first[key])
            sizes = common.judge.compare(*stacks, _relative_distance)
        if sizes[0] and values[0] != values[1]:
            # What exerts no force may be beyond the format of the other file
            is_beyond = None in values and first.format != second.format and not key.exerts
            shown = _shown(values[0]), _shown(values[1])
            yield difference(
                name, key.element_kind, Quantity.SETTING, shown, sizes, key.name, convention=is_beyond
            )


def _names_in_first(common: CommonFrames) -> dict[tuple[str, str], str]:
    """Return the names of bodies and joints in the first file by their kind and name in the second."""
    first, second = common.first.file.robot, common.second.file.robot
    joints = {
        ("joint", joint_name(second, pair.second)): joint_name(first, pair.first)
        for pair in common.alignment.joints
    }
    bodies = {
        ("body", second.bodies[pair.second[0]].name): first.bodies[pair.first[0]].name
        for pair in common.alignment.bodies
        if len(pair.first) == len(pair.second) == 1
    }
    return joints | bodies


def _numbers(file: RobotFile, key: Setting) -> Array:
    """Return the numbers (V, n) of a setting in a file and its variants."""
    return np.array([robot.settings[key] for robot in file.robots], float)


def _places(file: RobotFile, key: Setting) -> list[FilePlace]:
    """Return the place of a setting in a file and its variants."""
    values = (robot.settings[key] for robot in file.robots)
    return [value for value in values if isinstance(value, FilePlace)]


def _relative_distance(reference: Array, values: Array) -> Array:
    """Return the distances (V,) of numbers (V, n) from numbers (1, n), relative to their size."""
    return distance(reference, values) / (float(np.linalg.norm(reference)) or 1.0)


def _shown(value: SettingValue | None) -> Value:
    """Return a value of a row: a single number as a number, and a place as its position, m."""
    if isinstance(value, FilePlace):
        return numbers(value.frame.position)
    return value[0] if isinstance(value, tuple) and len(value) == 1 else value
