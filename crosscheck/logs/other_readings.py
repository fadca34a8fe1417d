"""Other readings of a log that users often mean: orders of quaternions, units, points, zeros and times.

A reading is a set of `LogOptions`, by which columns of numbers become joint coordinates, poses and inputs.
`other_readings` yields the readings that differ from a present one in one statement.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from itertools import combinations
from typing import NamedTuple

import numpy as np

from crosscheck.logs.columns import LogData, Measured
from crosscheck.logs.inputs import is_time_dependent
from crosscheck.logs.names import COMPONENTS_OF, split_unit
from crosscheck.logs.options import LogOptions
from crosscheck.logs.poses import body_poses, joint_errors, logged_quantities
from crosscheck.logs.reading import LogReading
from newton_euler.errors import quoted
from newton_euler.model.source_file import SourceError

REST = 1e-3
"""Largest motion of a log, divided by its whole motion, that counts as rest at its start."""

OFFSET_DECIMALS = 9
"""Number of decimals of an offset in s: those of `TIME_TOLERANCE`, within which a row is at the offset."""

MAX_VIOLATION, VIOLATION_FACTOR = 1e-2, 0.5
"""Largest violation of joints, sizes of the mechanism or rad, in readings of single elements that are tried;
and the same as a fraction of the violation in the present reading. It takes no simulation."""

MAX_EXCHANGED = 6
"""Largest number of joint coordinates, or of frames on bodies, of which pairs are exchanged: there are 15
pairs, and each one needs a simulation."""


class OtherReading(NamedTuple):
    """Another reading of a log.

    Attributes:
        options: options that select it.
        columns: columns that it concerns.
        what: the reading in words, such as "unit deg".
        option: the option that differs, as on the command line.
    """

    options: LogOptions
    columns: tuple[str, ...]
    what: str
    option: str


def other_readings(reading: LogReading, options: LogOptions, data: LogData) -> Iterator[OtherReading]:
    """Yield readings that differ from the present one in one option.

    Args:
        reading: the log.
        options: options of the present reading.
        data: numbers of the log with these options.
    """
    # order of quaternions
    quaternions = [frame.quaternion for frame in data.frames.values() if frame.quaternion is not None]
    if quaternions:
        columns = tuple(name for each in quaternions for name in each.columns)
        for order in ("xyzw", "wxyz"):
            if order != options.quaternion:
                other = replace(options, quaternion=order)
                what = f"order {', '.join(order)} of the columns"
                yield OtherReading(other, columns, what, f"--log-set quaternion={order}")
    # units of all angles, of all lengths, and of single angles
    angles = data.without_unit.get("angle", [])
    if angles:
        unit = "deg" if options.angle == "rad" else "rad"
        other = replace(options, angle=unit)  # type: ignore[arg-type]
        yield OtherReading(other, tuple(angles), f"unit {unit}", f"--log-set angle={unit}")
    for unit in ("mm", "cm", "m"):
        if (lengths := data.without_unit.get("length", [])) and unit != options.length:
            other = replace(options, length=unit)  # type: ignore[arg-type]
            yield OtherReading(other, tuple(lengths), f"unit {unit}", f"--log-set length={unit}")
    if len(angles) > 1 and options.angle == "rad":
        for name, quantity in dict(coordinate_columns(reading, data)).items():
            if name in angles:
                other = replace(options, columns={**options.columns, name: f"{quantity} [deg]"})
                yield OtherReading(other, (name,), "unit deg", f"--log-map '{name}={quantity} [deg]'")
    # points of bodies, and zeros of coordinates
    positions = [frame.position for frame in data.frames.values() if frame.position is not None]
    if positions:
        columns = tuple(name for each in positions for name in each.columns)
        for point, words in (("center", "centers of mass"), ("frame", "origins of body frames")):
            if point != options.position:
                other = replace(options, position=point)  # type: ignore[arg-type]
                yield OtherReading(other, columns, words, f"--log-set position={point}")
    # `zero`: logged coordinates are zero at the zero pose of the model "file", or at the scene's "start".
    # Without a model file there are no names in the file (`reading.names`), and the start is the only zero
    if data.coordinates and reading.names is not None and options.zero == "file":
        columns = tuple(name for each in data.coordinates.values() for name in each.columns)
        other = replace(options, zero="start")
        yield OtherReading(other, columns, "coordinates from the start of the file", "--log-set zero=start")
    # steps that logged inputs belong to
    if (data.inputs or data.forces) and options.inputs == "log":
        columns = tuple(
            name for each in (*data.inputs.values(), *data.forces.values()) for name in each.columns
        )
        what = "inputs of the step before each row"
        yield OtherReading(replace(options, inputs="before"), columns, what, "--log-set inputs=before")
    # unit of times, and time zero of the scene
    if options.time == "s":
        for unit in ("ms", "us", "ns"):
            other = replace(options, time=unit)  # type: ignore[arg-type]
            yield OtherReading(other, ("time",), f"unit {unit}", f"--log-set time={unit}")
    first = float(data.time[0])
    if options.offset is None and (row := _last_row_at_rest(data)) > 0:
        motion = float(data.time[row])
        other = replace(options, offset=motion)
        what = f"times {motion - first:.4g} s earlier, as nothing moves before"
        yield OtherReading(other, ("time",), what, offset_option(motion))
    if options.offset is None and first != 0.0 and is_time_dependent(reading.scene):
        other = replace(options, offset=first)
        what = f"time {first:.6g} s as time zero"
        yield OtherReading(other, ("time",), what, offset_option(first))


def offset_option(time: float) -> str:
    """Return the option for an offset of a time, s; a time that is round-off, such as 0.3 - 3 * 0.1, is 0."""
    return f"--log-set offset={round(time, OFFSET_DECIMALS) + 0.0:.9g}"  # + 0.0: no sign of zero


def readings_of_elements(reading: LogReading, options: LogOptions, data: LogData) -> Iterator[OtherReading]:
    """Yield readings of single bodies, and of two exchanged elements, with which the joints fit together.

    Args:
        reading: the log.
        options: options of the present reading.
        data: numbers of the log with these options.
    """
    largest = max(MAX_VIOLATION, VIOLATION_FACTOR * _violation(reading, options))
    for other in (
        *_readings_of_single_bodies(reading, options, data),
        *_exchanged(reading, options, data),
    ):
        try:
            if _violation(reading, other.options) <= largest:
                yield other
        except SourceError:
            continue


def _violation(reading: LogReading, options: LogOptions) -> float:
    """Return the largest violation of joints between known bodies in a log, sizes of the mechanism or rad."""
    mechanism, quantities = reading.scene.mechanism, logged_quantities(reading.data(options))
    errors = joint_errors(mechanism, body_poses(reading.elements, quantities, options.position or "frame"))
    openings = float(np.max(errors.openings, initial=0.0)) / mechanism.size
    return max(openings, float(np.max(errors.angles, initial=0.0)))


def _readings_of_single_bodies(
    reading: LogReading, options: LogOptions, data: LogData
) -> Iterator[OtherReading]:
    """Yield readings with another order or unit of one body: a log can have several sources."""
    if not 1 < len(data.frames) <= MAX_EXCHANGED:
        return
    order = list(reading.table.columns)
    for name, frame in data.frames.items():
        if frame.quaternion is not None and options.quaternion == "names":
            names = sorted(frame.quaternion.columns, key=order.index)
            for letters in ("xyzw", "wxyz"):
                if tuple(names[letters.index(c)] for c in "wxyz") != frame.quaternion.columns:
                    quaternion = {
                        column: f"quaternion.{name}.{c}" for column, c in zip(names, letters, strict=True)
                    }
                    yield _mapped(options, quaternion, f"order {', '.join(letters)} of the columns")
        for unit in ("mm", "cm") if options.length == "m" else ():
            lengths: dict[str, str] = {}
            for kind, rate in (("position", ""), ("linear_velocity", "/s")):
                measured: Measured | None = getattr(frame, kind)
                if measured and set(measured.columns) <= set(data.without_unit.get("length", ())):
                    columns = zip(measured.columns, "xyz", strict=True)
                    lengths |= {column: f"{kind}.{name}.{c} [{unit}{rate}]" for column, c in columns}
            if lengths:
                yield _mapped(options, lengths, f"unit {unit}")


def _exchanged(reading: LogReading, options: LogOptions, data: LogData) -> Iterator[OtherReading]:
    """Yield readings with exchanged columns of two joint coordinates, or of two frames on bodies."""
    # columns of each element by quantity, such as "rate.{}"
    bodies: dict[str, dict[str, str]] = {}
    for name, frame in data.frames.items():
        bodies[name] = {
            f"{kind}.{{}}.{c}": column
            for kind, components in COMPONENTS_OF.items()
            if (measured := getattr(frame, kind)) is not None
            for column, c in zip(measured.columns, components, strict=True)
        }
    joints: dict[str, dict[str, str]] = {}
    texts = dict(coordinate_columns(reading, data))
    for key, coordinate in data.coordinates.items():
        columns = {"coordinate.{}": coordinate.columns[0]}
        if key in data.rates:
            columns["rate.{}"] = data.rates[key].columns[0]
        joints[texts[coordinate.columns[0]].removeprefix("coordinate.")] = columns
    for kind, elements in (("joints", joints), ("bodies", bodies)):
        if len(elements) > MAX_EXCHANGED:
            continue
        for first, second in combinations(elements, 2):
            if elements[first].keys() != elements[second].keys():
                continue
            exchanged: dict[str, str] = {}
            for own, other in ((first, second), (second, first)):
                for text, column in elements[own].items():
                    # the unit in the name, or in the statement of the user
                    given = options.columns.get(column, column)
                    unit = split_unit(given, words=given == column)[1]
                    exchanged[column] = text.format(other) + (f" [{unit}]" if unit else "")
            found = _mapped(options, exchanged, f"{kind} {quoted(first)} and {quoted(second)} exchanged")
            # the options of many columns are longer than the advice to exchange the names
            yield found if kind == "joints" else found._replace(option="")


def _mapped(options: LogOptions, columns: Mapping[str, str], what: str) -> OtherReading:
    """Return the reading with other quantities of some columns.

    Args:
        options: options of the present reading.
        columns: quantity by the name of a column, as in `LogOptions.columns`.
        what: the reading in words.
    """
    option = " ".join(f"--log-map '{name}={text}'" for name, text in columns.items())
    other = replace(options, columns={**options.columns, **columns})
    return OtherReading(other, tuple(columns), what, option)


def _last_row_at_rest(data: LogData) -> int:
    """Return the last of the rows at the start of a log in which nothing moves, see `REST`."""
    kinds = (
        [each.values for each in data.coordinates.values()],
        [frame.position.values for frame in data.frames.values() if frame.position],
        [frame.quaternion.values for frame in data.frames.values() if frame.quaternion],
    )
    moves = np.zeros(len(data.time), dtype=bool)
    for values in filter(None, kinds):
        columns = np.column_stack(values)
        moved = np.max(np.abs(columns - columns[0]), axis=1)
        moves |= moved > REST * np.max(moved)
    return max(0, int(np.argmax(moves)) - 1)  # 0 also if nothing moves in any row


def coordinate_columns(reading: LogReading, data: LogData) -> Iterator[tuple[str, str]]:
    """Yield the column of each joint coordinate, and the quantity as `LogOptions.columns` names it."""
    # a coordinate may have several names, of the scene and of the model file
    for key, measured in data.coordinates.items():
        for name, (named_key, _) in reading.elements.coordinates.items():
            if named_key == key:
                yield measured.columns[0], f"coordinate.{name}"
