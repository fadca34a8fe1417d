"""Positions of the sun over a year that the face of a tracker can reach, beside those that it cannot.

Each position is that of one hour of the year with the sun above the horizon. The tracker's own limits decide:
clearances between bodies, the distance from singular configurations, and the reach of the mechanism
(`crosscheck.solar.obstacles`). The largest tilt of the rules of tracking is shown beside them.
"""

from __future__ import annotations

import csv
import io
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from crosscheck.engines.palette import palette
from crosscheck.report.plots import own_style
from crosscheck.report.table import Rows, Table, number_columns, text_columns
from crosscheck.solar.geared import Geared
from crosscheck.solar.obstacles import Cause, Obstacles
from crosscheck.solar.place import SUN, Place, Sun, angles, sun_over
from crosscheck.solar.tracking import Tracking
from newton_euler import Axis, Scene
from newton_euler.optional_packages import optional_package
from newton_euler.scalars import Array

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FACED = 1e-6
"""Largest angle, rad, between the sun and a face that counts as facing it."""


@dataclass(frozen=True, eq=False)
class Reach:
    """Positions of the sun over a year, one for each of the n hours in which it is up.

    Attributes:
        place: place of the tracker.
        year: the year.
        sun: the positions.
        cause: (n,) `Cause` for which the face cannot have the direction of the sun, or `Cause.FREE`.
        off: (n,) rad, angle between the sun and the face in its pose; more than 0 for mechanisms with one
            degree of freedom; NaN where the face is blocked.
        max_tilt: degrees, largest tilt of the rules of tracking.
    """

    place: Place
    year: int
    sun: Sun
    cause: Array
    off: Array
    max_tilt: float

    @property
    def is_within_tilt(self) -> Array:
        """(n,) True where the tilt towards the sun is at most the largest one."""
        return np.asarray(np.degrees(self.sun.elevation) >= 90.0 - self.max_tilt)

    def name(self, cause: Cause) -> str:
        """Return the name of directions with a cause, in tables and plots."""
        if cause != Cause.FREE:
            return cause.text
        return "can be faced" if np.nanmax(self.off) < FACED else "faced as nearly as one axis allows"


def reach_over_year(scene: Scene, axis: Axis, place: Place, year: int, tracking: Tracking) -> Reach:
    """Find which positions of the sun over a year a face can reach.

    Args:
        scene: the tracker; x is east, y north, z up.
        axis: normal of the face as an axis of a body.
        place: place of the tracker.
        year: the year, from its first hour in universal time.
        tracking: gives the clearance, the distance from singular configurations and the largest tilt.

    Raises:
        newton_euler.NewtonEulerError: for a scene whose poses cannot be solved.
    """
    pd = optional_package("pandas", SUN)
    hours = pd.date_range(f"{year}-01-01", f"{year + 1}-01-01", freq="h", inclusive="left", tz="UTC")
    every = sun_over(place, hours)
    up = every.is_up
    sun = Sun(every.times[up], every.azimuth[up], every.elevation[up])
    geared = Geared.of(scene)
    obstacles = Obstacles(geared.planned, axis, tracking, geared.keys)
    poses, checks = obstacles.facing(sun.direction)
    assert poses.direction is not None
    off = angles(poses.direction, sun.direction)
    is_free = checks.cause == Cause.FREE
    return Reach(place, year, sun, checks.cause, np.where(is_free, off, np.nan), tracking.max_tilt)


def reach_table(reach: Reach) -> Table:
    """Tabulate the hours of daylight of a year by what the face can reach."""
    rows: Rows = []
    within, total = reach.is_within_tilt, len(reach.cause)
    for cause in Cause:
        which = reach.cause == cause
        if which.any():
            share = 100.0 * np.sum(which) / total
            off = (
                "" if np.isnan(reach.off[which]).all() else f"{np.degrees(np.nanmean(reach.off[which])):.1f}"
            )
            rows.append(
                [reach.name(cause), f"{np.sum(which)}", f"{share:.1f}", f"{np.sum(which & within)}", off]
            )
    columns = [
        *text_columns("sun's direction"),
        *number_columns("hours", "% of\ndaylight", f"hours to\n{reach.max_tilt:g} deg tilt", "off sun\ndeg"),
    ]
    return Table(f"directions of the sun over {reach.year} that the face can reach", columns, rows)


def reach_csv(reach: Reach) -> bytes:
    """Return the positions as CSV, one row for each hour of daylight."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["time", "sun_azimuth_deg", "tilt_deg", "blocked", "off_sun_deg"])
    azimuth, tilt = np.degrees(reach.sun.azimuth), 90.0 - np.degrees(reach.sun.elevation)
    for k, time in enumerate(reach.sun.times):
        blocked = Cause(reach.cause[k]).text if reach.cause[k] else ""
        off = "" if np.isnan(reach.off[k]) else f"{np.degrees(reach.off[k]):.6f}"
        writer.writerow([time.isoformat(), f"{azimuth[k]:.6f}", f"{tilt[k]:.6f}", blocked, off])
    return text.getvalue().encode()


@own_style()
def reach_picture(reach: Reach) -> Figure:
    """Plot the positions of the sun by azimuth and tilt, with one color for each cause."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.0, 4.4), layout="constrained")
    ax = figure.add_subplot()
    azimuth, tilt = np.degrees(reach.sun.azimuth) % 360.0, 90.0 - np.degrees(reach.sun.elevation)
    colors = palette([cause.text for cause in Cause])
    for cause in Cause:
        which = reach.cause == cause
        if which.any():
            color, label = colors[cause.text], reach.name(cause)
            ax.plot(azimuth[which], tilt[which], ".", markersize=3.0, color=color, label=label)
    ax.axhline(reach.max_tilt, color="black", linewidth=1.0, label=f"largest tilt, {reach.max_tilt:g} deg")
    ax.set(xlabel="azimuth of the sun, degrees from north to the east", ylabel="tilt towards the sun, deg")
    ax.set(xlim=(0.0, 360.0), ylim=(90.0, 0.0), title=f"the sun over {reach.year} at {reach.place}")
    ax.grid(alpha=0.3)
    figure.legend(loc="outside lower center", ncols=3, frameon=False, markerscale=3.0)
    return figure
