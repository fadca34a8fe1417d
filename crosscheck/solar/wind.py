"""Wind of a day: speeds from a number or a CSV, and the load on the panel of a solar tracker."""

from __future__ import annotations

import numpy as np

from crosscheck.support.errors import CrosscheckError
from newton_euler import Axis
from newton_euler.errors import listed, plain_number
from newton_euler.model.euler_parameters import rotation
from newton_euler.model.geometry import Box
from newton_euler.model.scene import Scene
from newton_euler.model.source_file import TimeTable, csv_rows, read_text
from newton_euler.model.splines import Steps
from newton_euler.model.wind import WindLoad
from newton_euler.scalars import Array

WIND_COLUMNS = ("time", "speed")
"""Names of the columns of a CSV of wind speeds."""

NEEDED_COLUMNS = "columns time, s since midnight, and speed, m/s, separated by commas"
"""Description of these columns for error messages."""


WIND = "wind_of_the_day"
"""Name of the wind load on the panel."""

SAME_DIRECTION = 1e-6
"""Largest sine of the angle between the normal of a panel and an edge of its box that counts as parallel."""


LEVEL = np.eye(3)
"""Rotation of a base that is level, with x to the east."""


def panel_box(scene: Scene, axis: Axis) -> tuple[Box, Array] | None:
    """Find the box that is the panel: of the face's body, with two edges across the normal.

    Args:
        scene: the tracker.
        axis: the panel's normal as an axis of a body.

    Returns:
        The box of the largest area, and two sides (2, 3), m, world frame at the initial pose; None without
        such a box.
    """
    body = scene.mechanism.body(axis.body)
    normal = body.pose.rotation @ axis.axis
    found: list[tuple[Box, Array]] = []
    for shape in body.shapes:
        if isinstance(shape, Box):
            edges = rotation(shape.quaternion)  # columns
            across = [k for k in range(3) if abs(edges[:, k] @ normal) < SAME_DIRECTION]
            if len(across) == 2:
                found.append((shape, np.stack([2.0 * shape.half_sizes[k] * edges[:, k] for k in across])))
    return max(found, key=lambda panel: np.prod(np.linalg.norm(panel[1], axis=1)), default=None)


def wind_on_panel(
    scene: Scene,
    axis: Axis,
    times: Array,
    speeds: Array,
    blows_from: float,
    upward: float = 0.0,
    rotation_of_base: Array = LEVEL,
) -> WindLoad | None:
    """Return the load of the wind on the panel; None if the size of the panel is not known.

    Args:
        scene: the tracker.
        axis: the panel's normal as an axis of a body.
        times: (n,) s.
        speeds: (n,) m/s; each one lasts until the next time.
        blows_from: direction that the wind comes from, degrees from north to the east.
        upward: upward speed as a fraction of `speeds`, in addition, such as that of a gust. A panel that lies
            flat has a load by this speed only.
        rotation_of_base: (3, 3), from the axes of the scene to east, north and up.
    """
    if (panel := panel_box(scene, axis)) is None:
        return None
    box, sides = panel
    from_north = np.radians(blows_from)
    blows = np.array([-np.sin(from_north), -np.cos(from_north), upward])
    return WindLoad(
        WIND,
        axis.body,
        box.center,
        first_side=sides[0],
        second_side=sides[1],
        direction=rotation_of_base.T @ blows,
        speed=Steps(times, speeds * float(np.linalg.norm(blows))),
    )


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
