"""Read joint coordinates, body poses and inputs from the columns of a log, in SI units."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from crosscheck.logs.names import (
    COMPONENTS_OF,
    UNITS,
    Elements,
    FoundColumn,
    Origin,
    Target,
    identified,
    normalized,
    split_unit,
    stated,
    unknown_unit,
)
from crosscheck.logs.options import LogOptions
from crosscheck.logs.table import MIN_ROWS, LogTable
from crosscheck.support.units import TIME_UNITS
from newton_euler.errors import listed, quoted
from newton_euler.model.euler_parameters import continuous
from newton_euler.model.joint import Key
from newton_euler.scalars import Array

TIME_NAMES = ("time", "t", "timestamp", "sim_time", "simtime", "stamp", "clock")
"""Names of the column of times, without units."""

SECONDS_NAME = re.compile(r"(?:.*_)?(?:secs?|seconds)")

NANOSECONDS_NAME = re.compile(r"(?:.*_)?(?:nsecs?|nanosecs?|nanoseconds)")
"""Names of the two columns of a time stamp of ROS."""

MOTION_KINDS = ("coordinate", "position", "quaternion")
"""Kinds of columns by which a run has diverged if they end without numbers. Rates and inputs of the last row
are often unknown."""

MAX_NUMBER = 1e10
"""Largest absolute number of a run that has not diverged, in the unit of its column: `mjMAXVAL` of MuJoCo,
beyond which MuJoCo resets a run."""

MAX_NORM_ERROR = 0.02
"""Largest deviation of the norm of a quaternion from 1: numbers with two digits are still accepted."""


@dataclass(frozen=True, eq=False)
class Measured:
    """Numbers of one quantity with the names of their columns."""

    values: Array
    columns: tuple[str, ...]

    def at(self, rows: Array) -> Measured:
        """Return the numbers of chosen rows."""
        return Measured(self.values[rows], self.columns)


@dataclass
class FrameColumns:
    """Motion of one body frame: columns of the log, SI; None for what the log does not have.

    Attributes:
        position: (n, 3) m.
        quaternion: (n, 4), (w, x, y, z).
        linear_velocity: (n, 3) m/s, of the same point as the position.
        angular_velocity: (n, 3) rad/s, world frame.
        point: point of the body that the names of columns state; "" if they do not.
    """

    position: Measured | None = None
    quaternion: Measured | None = None
    linear_velocity: Measured | None = None
    angular_velocity: Measured | None = None
    point: Origin = ""


@dataclass(frozen=True, eq=False)
class LogData:
    """Numbers of a log by quantity, SI units, rows with all numbers only.

    Attributes:
        where: file or name of the run, for messages.
        time: (n,) times, s, from the zero of the log's clock; large ROS stamps count from the first second.
        coordinates: joint coordinates of the scene; angles are continuous.
        rates: rates of joint coordinates.
        frames: motion of body frames by name.
        inputs: controls by the name of an actuator of the file.
        forces: forces on joint coordinates, N or N m.
        without_unit: names of columns whose unit an option decides, by dimension, such as "angle".
        unused: names of columns that belong to no quantity.
        dropped: number of rows without some of the numbers.
        divergence: columns without finite numbers from some time on, in words; "" if there are none.
    """

    where: str
    time: Array
    coordinates: dict[Key, Measured]
    rates: dict[Key, Measured]
    frames: dict[str, FrameColumns]
    inputs: dict[str, Measured]
    forces: dict[Key, Measured]
    without_unit: dict[str, list[str]]
    unused: tuple[str, ...]
    dropped: int
    divergence: str

    def at(self, rows: Array) -> LogData:
        """Return the rows with the given numbers."""

        def chosen(given: Mapping[Any, Measured]) -> dict[Any, Measured]:
            """Return chosen rows of all quantities."""
            return {key: each.at(rows) for key, each in given.items()}

        frames = {}
        for name, frame in self.frames.items():
            parts = {part: value for part, value in vars(frame).items() if isinstance(value, Measured)}
            rows_of_parts: dict[str, Any] = chosen(parts)
            frames[name] = replace(frame, **rows_of_parts)
        return replace(
            self,
            time=self.time[rows],
            coordinates=chosen(self.coordinates),
            rates=chosen(self.rates),
            frames=frames,
            inputs=chosen(self.inputs),
            forces=chosen(self.forces),
        )

    def with_inputs_of(self, rows: Array) -> LogData:
        """Return the log with the inputs of other rows: of `rows[k]` in row k."""
        return replace(
            self,
            inputs={name: each.at(rows) for name, each in self.inputs.items()},
            forces={key: each.at(rows) for key, each in self.forces.items()},
        )


def read_columns(table: LogTable, elements: Elements, options: LogOptions) -> LogData:
    """Find the quantities of a log and convert them to SI units.

    Raises:
        SourceError: naming the column: missing or repeated columns, cells without numbers, and times that do
            not ascend, with the remedy.
    """
    found, unused = _found_columns(table, elements, options)
    if not found:
        problem = f"no column is a joint coordinate or a pose: {listed(table.columns):.300}"
        names = listed([*elements.coordinates, *elements.frames])
        needed = f"names of joints or bodies ({names:.300}), or --log-map COLUMN=coordinate.JOINT"
        raise table.error(f"{problem}; needed: {needed}")
    for each in found.values():
        if each.name in table.texts:
            problem = f"column {quoted(each.name)}: {table.texts[each.name]}; needed: a finite number"
            raise table.error(problem)
    time_names, time = _times(table, options)
    end, divergence = _divergence(table, found, time)
    # rows with all numbers; exports of several topics leave cells empty
    used = [np.isfinite(time), *(_has_numbers(table, each) for each in found.values())]
    complete = np.asarray(np.all(used, axis=0) & (np.arange(len(time)) < end))
    if np.sum(complete) < MIN_ROWS:
        fewest = min([*found.values()], key=lambda each: np.isfinite(table.columns[each.name]).sum())
        count = int(np.isfinite(table.columns[fewest.name]).sum())
        problem = f"column {quoted(fewest.name)} has {count} numbers in {len(time)} rows"
        raise table.error(f"{problem}; needed: rows with a number in every used column")
    time = time[complete]
    backward = np.flatnonzero(np.diff(time) <= 0.0)
    if len(backward):
        row = int(backward[0])
        problem = f"column {quoted(time_names)}: {time[row + 1]:.9g} s after {time[row]:.9g} s"
        needed = "ascending times; sort the rows, or remove repeated rows and all runs but one"
        raise table.error(f"{problem}, in {table.row(np.flatnonzero(complete)[row + 1])}; needed: {needed}")
    reader = _Reader(table, complete, options, found)
    data = LogData(
        table.where,
        time,
        *reader.coordinates(elements),
        reader.frames(),
        {each.target.element: reader.measured(each) for each in reader.of("input")},
        {elements.coordinates[each.target.element][0]: reader.measured(each) for each in reader.of("force")},
        reader.without_unit,
        tuple(name for name in unused if name not in time_names.split(" and ")),
        int(np.sum(~complete[:end])),
        divergence,
    )
    if options.inputs == "scene":
        data.inputs.clear()
        data.forces.clear()
    elif options.inputs == "before":  # the input of a row holds from the row before
        data = data.with_inputs_of(np.append(np.arange(1, len(data.time)), len(data.time) - 1))
    if not (data.coordinates or data.frames):
        problem = f"no column is a joint coordinate or a pose: {listed(table.columns):.300}"
        raise table.error(f"{problem}; needed: columns such as coordinate.JOINT, or --log-map")
    return data


def _divergence(table: LogTable, found: Mapping[Target, FoundColumn], time: Array) -> tuple[int, str]:
    """Find the row from which on columns have no numbers of a mechanism, as of a run that diverged.

    Cells without numbers at the end of a column count if they begin with a number that is too large. Empty
    cells there count for coordinates and poses if they are more in a row than anywhere before: exports of
    several topics have such cells between numbers.

    Returns:
        The index of that row, and columns and time before it in words; else the number of rows and "".
    """
    ends: dict[str, int] = {}
    for each in found.values():
        numbers = np.flatnonzero(_has_numbers(table, each))
        if not len(numbers) or (end := int(numbers[-1]) + 1) == len(time):
            continue
        longest = int(np.max(np.diff(numbers), initial=1)) - 1
        is_empty = each.target.kind in MOTION_KINDS and len(time) - end > longest
        if is_empty or not np.isnan(table.columns[each.name][end]):
            ends[each.name] = end
    if not ends:
        return len(time), ""
    end = min(ends.values())
    first, *others = [name for name, row in ends.items() if row == end]
    columns = (
        f"columns {quoted(first)} and {len(others)} more have" if others else f"column {quoted(first)} has"
    )
    cell = f"{table.columns[first][end]:.3g} in {table.row(end)}"
    before = time[:end]
    last = np.max(before, where=np.isfinite(before), initial=-np.inf)
    return end, f"{columns} no number below {MAX_NUMBER:g} after {last:.6g} s: {cell}"


def _has_numbers(table: LogTable, column: FoundColumn) -> Array:
    """Return True (n,) for the rows of a column with numbers that a run of a mechanism can have."""
    return np.asarray(np.abs(table.columns[column.name]) <= MAX_NUMBER)


class _Reader:
    """Converts the columns of a log to SI units, and collects columns whose unit an option decides."""

    def __init__(
        self, table: LogTable, rows: Array, options: LogOptions, found: Mapping[Target, FoundColumn]
    ) -> None:
        """Take a log.

        Args:
            table: the log.
            rows: (n,) True for the rows to use.
            options: statements on the log.
            found: columns by quantity.
        """
        self._table, self._rows, self._options, self._found = table, rows, options, found
        self.without_unit: dict[str, list[str]] = {}

    def of(self, kind: str) -> list[FoundColumn]:
        """Return the columns of a kind of quantity."""
        return [each for each in self._found.values() if each.target.kind == kind]

    def measured(self, column: FoundColumn, dimension: str = "") -> Measured:
        """Convert a column to SI units.

        Args:
            column: the column.
            dimension: "length" or "angle", also for their rates; "" for numbers that no option scales.
        """
        factor = 1.0
        if column.unit and column.unit not in UNITS:
            valid = [unit for unit, (of, _) in UNITS.items() if not dimension or of == dimension]
            problem = f"column {quoted(column.name)} has the unit {column.unit!r}"
            needed = f"{', '.join(valid)}; or --log-map COLUMN={column.target.text} for numbers in SI units"
            raise self._table.error(f"{problem}; needed: {needed}")
        if column.unit:
            of, factor = UNITS[column.unit]
            if dimension and of != dimension:
                problem = f"column {quoted(column.name)} has the unit {column.unit!r}, no unit of {dimension}"
                raise self._table.error(f"{problem}; needed: another unit, or --log-map for another quantity")
        elif dimension:
            self.without_unit.setdefault(dimension, []).append(column.name)
            factor = UNITS[getattr(self._options, dimension)][1]
        return Measured(factor * self._table.columns[column.name][self._rows], (column.name,))

    def coordinates(self, elements: Elements) -> tuple[dict[Key, Measured], dict[Key, Measured]]:
        """Return joint coordinates of the scene, and their rates."""
        values, rates = dict[Key, Measured](), dict[Key, Measured]()
        for kind, into in (("coordinate", values), ("rate", rates)):
            for column in self.of(kind):
                key, start = elements.coordinates[column.target.element]
                slides = elements.mechanism.is_slide(*key)
                measured = self.measured(column, "length" if slides else "angle")
                numbers = measured.values
                if kind == "coordinate":
                    numbers = numbers if slides else np.unwrap(numbers)
                    # coordinates of the scene are zero at its start, those of a file can be `start` there
                    numbers = numbers - (start if self._options.zero == "file" else 0.0)
                into[key] = Measured(numbers, measured.columns)
        return values, rates

    def frames(self) -> dict[str, FrameColumns]:
        """Return the motion of body frames.

        Raises:
            SourceError: for a vector or quaternion without all components, and for quaternions that are no
                rotations.
        """
        frames: dict[str, FrameColumns] = {}
        for kind, components in COMPONENTS_OF.items():
            for name in dict.fromkeys(each.target.element for each in self.of(kind)):
                columns = {
                    each.target.component: each for each in self.of(kind) if each.target.element == name
                }
                missing = [letter for k, letter in enumerate(components) if k not in columns]
                if missing:
                    have = next(iter(columns.values())).name
                    problem = f"column {kind}.{name}.{missing[0]} is missing beside {quoted(have)}"
                    needed = f"all of {', '.join(components)}, or --log-map COLUMN={kind}.{name}.{missing[0]}"
                    raise self._table.error(f"{problem}; needed: {needed}")
                frame = frames.setdefault(name, FrameColumns())
                parts = [columns[k] for k in range(len(components))]
                if kind == "quaternion":
                    measured = self._quaternion(parts)
                else:
                    dimension = "angle" if kind == "angular_velocity" else "length"
                    each = [self.measured(part, dimension) for part in parts]
                    numbers = np.stack([one.values for one in each], axis=1)
                    measured = Measured(numbers, tuple(one.columns[0] for one in each))
                setattr(frame, kind, measured)
                if kind == "position":
                    frame.point = parts[0].target.point
        return frames

    def _quaternion(self, parts: list[FoundColumn]) -> Measured:
        """Return quaternions (n, 4), normalized, w first, with continuous signs."""
        names = [part.name for part in parts]
        if self._options.quaternion != "names":
            # the order of the columns in the log counts, whatever their names are
            order = list(self._table.columns)
            names.sort(key=order.index)
            if self._options.quaternion == "xyzw":
                names = [names[3], *names[:3]]
        numbers = np.stack([self._table.columns[name][self._rows] for name in names], axis=1)
        norms = np.linalg.norm(numbers, axis=1)
        row = int(np.argmax(np.abs(norms - 1.0)))
        if abs(norms[row] - 1.0) > MAX_NORM_ERROR:
            where = self._table.row(np.flatnonzero(self._rows)[row])  # the log may have incomplete rows
            problem = f"columns {', '.join(map(quoted, names))} have norm {norms[row]:.3g} in {where}"
            raise self._table.error(f"{problem}; needed: quaternions of norm 1")
        numbers = numbers / norms[:, None]
        return Measured(continuous(numbers, numbers[0]), tuple(names))


def _times(table: LogTable, options: LogOptions) -> tuple[str, Array]:
    """Return the name of the column of times, or of two columns joined by " and ", and the times (n,), s."""
    mapped = [name for name, target in options.columns.items() if target == "time"]
    for name in mapped or table.columns:
        # the name without a unit in brackets, and its words without a unit at its end either (`time_ms`)
        core, unit, words = split_unit(name)
        if (unknown := unknown_unit(name)) and normalized(unknown[0]) in TIME_NAMES and not mapped:
            problem = f"column {quoted(name)} has the unit {unknown[1]!r}"
            raise table.error(f"{problem}; needed: {', '.join(TIME_UNITS)}")
        if mapped or normalized(core) in TIME_NAMES or "_".join(words) in TIME_NAMES:
            if name in table.texts:
                problem = f"column {quoted(name)}: {table.texts[name]}; needed: a finite number"
                raise table.error(problem)
            dimension, factor = UNITS[unit or options.time]
            if dimension != "time":
                raise table.error(
                    f"column {quoted(name)} has the unit {unit!r}; needed: {', '.join(TIME_UNITS)}"
                )
            return name, factor * table.columns[name]
    names = {name: normalized(name) for name in table.columns}
    seconds = [name for name, text in names.items() if SECONDS_NAME.fullmatch(text)]
    fractions = [name for name, text in names.items() if NANOSECONDS_NAME.fullmatch(text)]
    if seconds and fractions:
        whole = table.columns[seconds[0]]
        start = np.nanmin(whole)  # of large numbers, so that nanoseconds keep their digits
        stamp = (whole - start) + 1e-9 * table.columns[fractions[0]]
        return f"{seconds[0]} and {fractions[0]}", stamp if start > 1e6 else stamp + start
    problem = f"no column of times among {listed(table.columns):.300}"
    raise table.error(f"{problem}; needed: a column time, s, or --log-map COLUMN=time")


def _found_columns(
    table: LogTable, elements: Elements, options: LogOptions
) -> tuple[dict[Target, FoundColumn], list[str]]:
    """Find the column of each quantity.

    Returns:
        Columns by quantity, and the names of other columns.

    Raises:
        SourceError: for an unknown column or quantity in `LogOptions.columns`, and for two columns with equal
            claims to one quantity.
    """
    claims: dict[Target, list[FoundColumn]] = {}
    for name, text in options.columns.items():
        if name not in table.columns:
            raise table.error(f"has no column {quoted(name)}; needed: one of {listed(table.columns):.300}")
        if text != "time":
            column = stated(text, name, elements)
            if column is None:
                needed = (
                    "time, coordinate.JOINT, rate.JOINT, position.BODY.x, quaternion.BODY.w or input.NAME"
                )
                raise table.error(f"column {quoted(name)} has no quantity {quoted(text)}; needed: {needed}")
            claims.setdefault(column.target._replace(point=""), []).append(column)
    for name in table.columns:
        if name not in options.columns and (column := identified(name, elements)) is not None:
            claims.setdefault(column.target._replace(point=""), []).append(column)
    found: dict[Target, FoundColumn] = {}
    for key, columns in claims.items():
        # the column whose name fits best: it has the fewest words beside element and quantity
        columns.sort(key=lambda column: column.mismatch)
        if len(columns) > 1 and columns[0].mismatch == columns[1].mismatch:
            both = " and ".join(quoted(column.name) for column in columns[:2])
            needed = f"one of the two; --log-map COLUMN={key.text} chooses it"
            raise table.error(f"columns {both} are both {key.text}; needed: {needed}")
        found[key] = columns[0]
    used = {column.name for column in found.values()}
    return found, [name for name in table.columns if name not in used]
