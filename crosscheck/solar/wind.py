"""Wind speeds over a day, from a number or a CSV, to find when the panel of a solar tracker must lie flat."""

from __future__ import annotations

import numpy as np

from crosscheck.support.errors import CrosscheckError
from newton_euler.errors import listed, plain_number
from newton_euler.model.source_file import TimeTable, csv_rows, read_text
from newton_euler.scalars import Array

WIND_COLUMNS = ("time", "speed")
"""Names of the columns of a CSV of wind speeds."""

NEEDED_COLUMNS = "columns time, s since midnight, and speed, m/s, separated by commas"
"""Description of these columns for error messages."""


def wind_over_day(given: str, seconds: Array) -> Array:
    """Return the wind speed (n,), m/s, at times of a day.

    Args:
        given: a number, or the path of a CSV with the columns `time`, s since midnight, and `speed`, m/s.
            Speeds between rows are interpolated linearly.
        seconds: (n,) s since midnight, ascending, from the beginning to the end of the day.

    Raises:
        CrosscheckError: for a negative number, other columns, and times that do not cover `seconds`.
        SourceError: naming the file and line, for a file that cannot be read or is too large, cells that are
            not numbers, negative speeds, and times that do not ascend.
    """
    try:
        speed = plain_number(given)
    except ValueError:
        return _read(given, seconds)
    if speed < 0.0:
        raise CrosscheckError(f"--wind is {given}; needed: a number of m/s, 0 or more, or the path of a CSV")
    return np.full(len(seconds), speed)


def _read(path: str, seconds: Array) -> Array:
    """Read wind speeds (n,), m/s, from a CSV and interpolate them at times (n,), s; raises the same errors as
    `wind_over_day`."""
    rows = csv_rows(path, read_text(path, limit="csv_size"))
    header = [cell.lower() for cell in rows[0].cells] if rows else []
    if sorted(header) != sorted(WIND_COLUMNS) or not rows[1:]:
        found = listed(header) if rows[1:] else "no rows"
        raise CrosscheckError(f"{path}: has {found:.200}; needed: {NEEDED_COLUMNS}")
    table = TimeTable.of(path, header, rows[1:])
    time, speed = (table.columns[name] for name in WIND_COLUMNS)
    table.refuse(speed < 0.0, "speed", speed, "0 m/s or more")
    if time[0] > seconds[0] or time[-1] < seconds[-1]:
        span = f"speeds from {time[0]:g} to {time[-1]:g} s"
        raise CrosscheckError(f"{path}: {span}; needed: the whole day, {seconds[0]:g} to {seconds[-1]:g} s")
    return np.interp(seconds, time, speed)
