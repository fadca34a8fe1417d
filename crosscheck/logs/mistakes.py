"""Find out whether a log is read wrongly: other readings that reduce its error by a large factor.

The error of a log is its deviation from the reference: a simulation of the scene from the start of the log.
The readings of `crosscheck.logs.other_readings` are tried one after the other. A `Mistake` names the columns
and the option that selects the other reading, a `Mismatch` a coordinate that contradicts logged poses.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from crosscheck.logs.columns import LogData
from crosscheck.logs.options import LogOptions
from crosscheck.logs.other_readings import (
    OtherReading,
    coordinate_columns,
    offset_option,
    other_readings,
    readings_of_elements,
)
from crosscheck.logs.poses import body_poses, coordinates_in_poses, joint_errors, logged_quantities
from crosscheck.logs.reading import ComparedLog, LogReading
from crosscheck.own_run.errors import OFF_BELOW, RunError, run_error
from crosscheck.own_run.interpolation import at_outputs, without_energies
from newton_euler.errors import NewtonEulerError, quoted
from newton_euler.model.joint import Key
from newton_euler.scalars import Array

MISTAKE_FACTOR = 10.0
"""Factor by which another reading of a log must reduce the error to be reported. Right readings of logs with
a wrong order, unit or time reduce the error a hundred times and more."""

MAX_SEARCH_S = 20.0
"""Processor time, s, after which no further reading of a log is tried."""

MAX_MISTAKES = 3
"""Largest number of wrong readings of one log that are searched."""

DELAYS = 81
"""Number of delays that are tried at once in the search for an offset of times."""

DELAY_ROUNDS = 4
"""Number of times that the search for a delay is repeated around the best one."""

MAX_DELAY = 0.25
"""Largest delay that is searched, as a fraction of the duration of the log."""

MIN_MOTION = 1e-9
"""Motion, sizes of the mechanism and rad, that counts as round-off: files often have nine digits or more."""

WHOLE_ROWS = 0.1
"""Distance of a delay from a whole number of rows, in rows, below which the delay is that number of rows."""


@dataclass(frozen=True)
class Mistake:
    """Another reading of a log with a much smaller error.

    Attributes:
        columns: columns that are read wrongly.
        what: the other reading, such as "order x, y, z, w".
        option: option that selects the other reading, such as "--log-set quaternion=xyzw"; "" for none.
        before: error of the first reading; None if that reading fits no state of the model.
        after: error of the other reading.
    """

    columns: tuple[str, ...]
    what: str
    option: str
    before: RunError | None
    after: RunError

    @property
    def text(self) -> str:
        """One line: columns, other reading, both errors, and the option to give."""
        first, *others = self.columns
        columns = f"columns {quoted(first)} and {len(others)} more" if others else f"column {quoted(first)}"
        after = f"an error of {_percent(self.after.relative)} of the motion"
        instead = "while the log as read fits no state of the model"
        if self.before is not None:
            instead = f"instead of {_percent(self.before.relative)}"
        remedy = f"; give {self.option}" if self.option else ""
        return f"{columns}: {self.what}: {after} {instead}{remedy}"


@dataclass(frozen=True)
class Mismatch:
    """A logged joint coordinate that differs from the one between the logged poses of the joint's bodies.

    Attributes:
        columns: the column of the coordinate.
        what: the coordinate and the largest difference in words.
        option: option with which the coordinate fits the poses; "" if none is known.
    """

    columns: tuple[str, ...]
    what: str
    option: str

    @property
    def text(self) -> str:
        """One line: the column, the difference, and the option to give."""
        remedy = f"; give {self.option}" if self.option else ""
        return f"column {quoted(self.columns[0])}: {self.what}{remedy}"


def find_mistakes(
    reading: LogReading, options: LogOptions, data: LogData, compared: ComparedLog | None
) -> tuple[Mistake, ...]:
    """Search readings that reduce the error by `MISTAKE_FACTOR`, one after the other.

    Args:
        reading: the log.
        options: options of the user.
        data: numbers of the log with these options.
        compared: the log and its reference with these options; None if the log fits no state.
    """
    found: list[Mistake] = []
    fits_no_state = compared is None
    end = time.process_time() + MAX_SEARCH_S
    while len(found) < MAX_MISTAKES and (compared is None or compared.error.relative > OFF_BELOW):
        before = None if compared is None else compared.error
        # the most frequent readings, and unless one of them fits, those of single elements
        best: tuple[ComparedLog, OtherReading] | None = None
        for others in (other_readings, readings_of_elements):
            best = _best_reading(reading, options, others(reading, options, data), end, best)
            if best is not None and best[0].error.relative < OFF_BELOW:
                break
        if best is None or (
            before is not None and best[0].error.relative * MISTAKE_FACTOR >= before.relative
        ):
            break
        # search further mistakes in addition to this one
        compared, other = best
        found.append(Mistake(other.columns, other.what, other.option, before, compared.error))
        options = other.options
        data = reading.data(options)
    if fits_no_state and (compared is None or compared.error.relative >= OFF_BELOW):
        return ()  # there is no first error that another reading reduces
    if compared is not None and compared.error.relative > OFF_BELOW:
        found.extend(_delay(compared))
    return tuple(found)


def _best_reading(
    reading: LogReading,
    options: LogOptions,
    others: Iterator[OtherReading],
    end: float,
    best: tuple[ComparedLog, OtherReading] | None,
) -> tuple[ComparedLog, OtherReading] | None:
    """Return the reading with the smallest error among others and the best one so far; None for none.

    Args:
        reading: the log.
        options: options of the present reading.
        others: other readings.
        end: processor time, s, after which no further reading is tried.
        best: the best other reading so far, and the log read so.
    """
    for other in others:
        if time.process_time() > end:
            break
        try:
            tried = reading.compared(other.options)
        except NewtonEulerError:
            continue
        if other.options.time != options.time and (
            tried.error.relative >= OFF_BELOW or not _explains_motion(tried)
        ):
            continue  # in a much shorter time little moves, whatever the log has
        if best is None or tried.error.relative < best[0].error.relative:
            best = tried, other
    return best


def find_mismatches(reading: LogReading, options: LogOptions, compared: ComparedLog) -> tuple[Mismatch, ...]:
    """Compare logged joint coordinates with those that follow from logged poses.

    A coordinate of a joint between two bodies with logged poses has no effect on the error of the log.

    Args:
        reading: the log.
        options: options of the user.
        compared: the log and its reference with these options.
    """
    mechanism, scale = reading.scene.mechanism, compared.motion_scale
    quantities = logged_quantities(compared.data)
    poses = body_poses(reading.elements, quantities, compared.points or "frame")
    # poses that violate joints have no exact coordinates
    violations = joint_errors(mechanism, poses)
    violation = max(
        float(np.max(violations.openings, initial=0.0)) / scale.length,
        float(np.max(violations.angles, initial=0.0)) / scale.angle,
    )
    allowed = max(OFF_BELOW, MISTAKE_FACTOR * violation)
    in_poses, found = coordinates_in_poses(mechanism, poses), list[Mismatch]()
    columns = dict(coordinate_columns(reading, compared.data))

    def difference(key: Key, values: Array) -> float:
        """Return the largest difference of a coordinate from that of the poses, m or rad."""
        gaps = values - in_poses[key]
        if not mechanism.is_slide(*key):
            gaps = np.arctan2(np.sin(gaps), np.cos(gaps))
        return float(np.max(np.abs(gaps)))

    for key, measured in compared.data.coordinates.items():
        slides = mechanism.is_slide(*key)
        extent = scale.length if slides else scale.angle
        if key not in in_poses or difference(key, measured.values) <= allowed * extent:
            continue
        (name,) = measured.columns
        option = ""
        for unit in ("mm", "cm", "m") if slides else ("deg", "rad"):
            text = f"{columns[name]} [{unit}]"
            other = reading.compared_rows(replace(options, columns={**options.columns, name: text}))
            if difference(key, other.coordinates[key].values) <= allowed * extent:
                option = f"--log-map '{name}={text}'"
        gap = difference(key, measured.values)
        by = f"{gap:.3g} m" if slides else f"{np.degrees(gap):.3g} deg"
        label = quoted(reading.elements.labels[key])
        what = f"differs by up to {by} from the coordinate of joint {label} in the logged poses"
        found.append(Mismatch((name,), what, option))
    return tuple(found)


def _explains_motion(compared: ComparedLog) -> bool:
    """Return True if a reference moves much farther than the error of the log, and than round-off."""
    error, size = compared.error, compared.scene.mechanism.size
    mechanisms = compared.motion_scale.mechanisms
    motion = max(each.length for each in mechanisms) / size + max(each.angle for each in mechanisms)
    error_of_log = error.largest_position / size + error.largest_rotation
    return motion > MISTAKE_FACTOR * max(error_of_log, MIN_MOTION)


def _delay(compared: ComparedLog) -> Iterator[Mistake]:
    """Yield the delay of a log behind its reference, if one reduces the error by `MISTAKE_FACTOR`."""
    # grids of delays, each finer and around the best delay of the one before
    run, duration = compared.run, float(compared.run.time[-1])
    best, reach = 0.0, MAX_DELAY * duration
    error = compared.error
    for _ in range(DELAY_ROUNDS):
        for delay in best + np.linspace(-reach, reach, DELAYS):
            times = run.time - delay
            inside = (times >= 0.0) & (times <= compared.reference.time[-1])
            inside[0] = False  # the reference starts there, whatever its time is
            if np.sum(inside) < 3:
                continue
            # without energies, which `relative` does not contain
            earlier = replace(at_outputs(run, np.flatnonzero(inside)), time=times[inside])
            # interpolation takes the time of an output of the reference that is close
            reference = replace(compared.reference_at(times[inside]), time=times[inside])
            delayed = run_error(without_energies(earlier), without_energies(reference), compared.motion_scale)
            if delayed.relative < error.relative:
                error, best = delayed, float(delay)
        reach *= 4.0 / DELAYS
    if error.relative * MISTAKE_FACTOR >= compared.error.relative:
        return
    # a delay of nearly a whole number of rows is that number of rows
    spacing = float(np.median(np.diff(run.time)))
    if abs(best - spacing * round(best / spacing)) < WHOLE_ROWS * spacing:
        best = spacing * round(best / spacing)
    if best > 0.0:
        option = offset_option(float(compared.data.time[0]) + best)
        yield Mistake(("time",), f"times {best:.4g} s earlier", option, compared.error, error)
    else:
        what = f"times {-best:.4g} s later, or without the first row"
        yield Mistake(("time",), what, "", compared.error, error)


def _percent(value: float) -> str:
    """Write a ratio in percent with two digits."""
    return f"{100.0 * value:.0f} %" if value >= 0.1 else f"{100.0 * value:.2g} %"
