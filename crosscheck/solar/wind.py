"""Speeds of the wind over a day, in which a tracker stows: a number, or samples in a CSV."""

from __future__ import annotations

import io
import os

import numpy as np

from crosscheck.errors import CrosscheckError
from crosscheck.solar.place import SUN
from newton_euler.errors import plain_number
from newton_euler.model.source_file import read_text
from newton_euler.optional_packages import optional_package
from newton_euler.scalars import Array

COLUMNS = ("time", "speed")

NEEDED = "columns time, s since midnight, and speed, m/s, with commas between them"


def wind_over_day(given: str, seconds: Array) -> Array:
    """Return the speed of the wind (n,), m/s, at times of a day.

    Args:
        given: a number, or the path of a CSV with the columns `time`, s since midnight, and `speed`, m/s;
            between its rows speeds are interpolated linearly.
        seconds: (n,) since midnight.

    Raises:
        CrosscheckError: for a negative number, and naming the file, and the line, the first being 1, for what
            is no number, times that do not ascend or that leave a part of the day out.
        NewtonEulerError: for a file that cannot be read.
    """
    try:
        speed = plain_number(given)
    except ValueError:
        return _read(given, seconds)
    if not 0.0 <= speed < np.inf:
        raise CrosscheckError(f"--wind is {given}; needed: a number of m/s, 0 or more, or the path of a CSV")
    return np.full(len(seconds), speed)


def _read(path: str, seconds: Array) -> Array:
    pd = optional_package("pandas", SUN)
    text = read_text(os.fspath(path), "csv_size")
    try:
        table = pd.read_csv(io.StringIO(text), skipinitialspace=True, skip_blank_lines=False)
    except ValueError as error:  # of pandas' parser
        raise CrosscheckError(f"{path}: {' '.join(str(error).split())}; needed: {NEEDED}") from error
    table.columns = [str(name).strip().lower() for name in table.columns]
    if sorted(table.columns) != sorted(COLUMNS) or not len(table):
        found = ", ".join(table.columns) if len(table) else "no rows"
        raise CrosscheckError(f"{path}: has {found:.200}; needed: {NEEDED}")
    time, speed = (pd.to_numeric(table[name], errors="coerce").to_numpy(dtype=float) for name in COLUMNS)
    ascends = np.append(True, np.diff(time) > 0.0)
    for wrong, what in (
        (~np.isfinite(time), "time is no number"),
        (~(np.isfinite(speed) & (speed >= 0.0)), "speed is no number of m/s, 0 or more"),
        (~ascends, "time is not after the one before"),
    ):
        for row in np.flatnonzero(wrong)[:1]:
            raise CrosscheckError(f"{path}: line {row + 2}: {what}")
    if time[0] > seconds[0] or time[-1] < seconds[-1]:
        span = f"speeds from {time[0]:g} to {time[-1]:g} s"
        raise CrosscheckError(f"{path}: {span}; needed: the whole day, {seconds[0]:g} to {seconds[-1]:g} s")
    return np.interp(seconds, time, speed)
