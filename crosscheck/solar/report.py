"""Report on a tracker's day, or on days at several places and dates: tables, plots and files."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from crosscheck.report.plots import own_style, png
from crosscheck.report.table import (
    Cell,
    Column,
    Lines,
    Part,
    Report,
    Rows,
    Table,
    number_columns,
    text_columns,
)
from crosscheck.solar.day import Day
from crosscheck.solar.energy import FACING, FIXED, ONE_AXIS, THIS
from crosscheck.support.files import write_files
from newton_euler.scalars import Array

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MAX_PRINTED_HOURS = 9
"""Largest number of rows of the table of a day in the terminal; the whole report is 25 lines long."""

SURVEYED = ("on sun\nh", "off\ndeg", "fixed\nkWh/m^2", "this\n%", "1 axis\n%", "facing\n%", "work\nmWh")
"""Headings of the columns of a survey, the table of several days."""

DAY_FILES = ("commands.csv", "day.png", "day.rrd")
"""Names of the files of one day: set-points, plot and recording."""

SURVEY_FILES = ("days.csv",)
"""Names of the files of several days."""


def hours(day: Day) -> Iterator[list[str | Cell]]:
    """Yield a table row for each whole hour in which the sun is up."""
    is_whole = (day.sun.times.minute == 0) & (day.sun.times.second == 0)
    for k in np.flatnonzero(is_whole & day.sun.is_up):
        yield [
            f"{day.sun.times[k]:%H:%M}",
            f"{np.degrees(day.sun.azimuth[k]):.1f}",
            f"{np.degrees(day.sun.elevation[k]):.1f}",
            *(f"{1e3 * values[k]:.2f}" for values in day.commands.values()),
            f"{np.degrees(np.arccos(np.clip(day.normals[k, 2], -1.0, 1.0))):.1f}",
            f"{np.degrees(day.errors[k]):.2f}",
            *([] if day.wind is None else [f"{day.wind[k]:.1f}"]),
        ]


def day_report(day: Day) -> Report:
    """Report on one day: positions of the sun, set-points, pointing error, irradiation and loads."""
    units = {"azimuth": "deg", "elevation": "deg"}
    units |= {name: "mm" if day.is_slide(name) else "mrad" for name in day.commands}
    units |= {"tilt": "deg", "off sun": "deg"} | ({} if day.wind is None else {"wind": "m/s"})
    columns = [
        *text_columns("time"),
        *(Column(f"{name}\n{unit}", numeric=True) for name, unit in units.items()),
    ]
    rows: Rows = list(hours(day))
    few = rows[:: -(-len(rows) // MAX_PRINTED_HOURS) or 1]
    tables = [Table("sun, set-points and panel", columns, chosen) for chosen in (rows, few)]
    light = Table(
        "clear sky over the day",
        [*text_columns("panel"), *number_columns("kWh/m^2", "of fixed, %")],
        [
            [name, f"{1e-3 * value:.3f}", f"{100.0 * value / day.light[FIXED]:.1f}"]
            for name, value in day.light.items()
        ],
    )
    assumed = Lines("assumptions", list(assumptions(day)))
    parts: list[Part] = [tables[0], light, loads_table(day), assumed]
    summary: list[Part] = [tables[1], light]
    where = f"{day.scene.name} on {day.sun.times[0]:%Y-%m-%d} at {day.place} ({day.sun.times.tz})"
    return Report(where, verdict(day), Cell("followed", "holds"), parts, day.run.wall_time, summary)


def loads_table(day: Day) -> Table:
    """Tabulate the largest static forces of actuators and joints over the day, and when they occur."""
    rows: Rows = []
    forces = np.abs(day.loads.actuator_force)
    kinds = [(f"actuator {name}", force) for name, force in zip(day.loads.actuators, forces.T, strict=True)]
    reactions = np.linalg.norm(day.loads.reaction_force, axis=2)
    kinds += [
        (f"joint {name}", force) for name, force in zip(day.loads.joint_names, reactions.T, strict=True)
    ]
    for name, force in kinds:
        k = int(np.argmax(force))
        rows.append([name, f"{force[k]:.3f}", f"{np.min(force):.3f}", f"{day.sun.times[k]:%H:%M}"])
    columns = [*text_columns("where"), *number_columns("largest, N", "least, N"), Column("largest at")]
    return Table("forces at rest over the day, weight alone", columns, rows)


def verdict(day: Day) -> str:
    """Report in one sentence how well the panel followed the sun."""
    faces = day.faces
    found = f"faces the sun for {day.hours(faces):.1f} h"
    if faces.any():
        found += f" to {np.degrees(np.max(day.errors[faces])):.2f} deg"
    low = day.hours(day.sun.is_up & ~faces & ~day.stowed)
    if low > 0.0:
        found += (
            f", and for {low:.1f} h points as close to it as a tilt of {day.tracking.most_tilt:g} deg allows"
        )
    if day.wind is not None:
        flat = day.hours(day.sun.is_up & day.stowed)
        found += f"; lies flat for {flat:.1f} h of daylight, in winds from {day.tracking.stow:g} m/s on"
    missed = int(np.sum(~day.poses.reached))
    if missed:
        found += (
            f"; {missed} set-points are out of reach, by up to {np.degrees(np.max(day.poses.angle)):.2f} deg"
        )
    forces = np.abs(day.loads.actuator_force).max()
    return f"{found}; actuators hold {forces:.3g} N at most and do {1e3 * day.work:.3g} mWh of work"


def assumptions(day: Day) -> Iterator[str]:
    """Yield the assumptions of the report, one sentence each."""
    yield "x is east, y north, z up; sun by NREL's algorithm, refraction at 12 degrees Celsius included"
    yield (
        f"set-points every {day.period:g} s, held by PD laws with the weight fed forward; tilt at most "
        f"{day.tracking.most_tilt:g} degrees; dead band {day.tracking.deadband:g} degrees"
    )
    wind = "no wind" if day.wind is None else "wind makes the panel lie flat and has no other effect"
    yield f"at night the panel waits in the position of the next morning; the base is fixed; {wind}"
    yield "clear sky (Ineichen, pvlib's turbidity), diffuse light of Hay and Davies, ground of albedo 0.2"
    yield "actuator work is positive work against weight in quasi-static motion; no recuperation, no friction"


def survey_report(days: Sequence[Day]) -> Report:
    """Report on days at several places or dates, one row per day."""
    names = (THIS, ONE_AXIS, FACING)
    columns = [
        *text_columns("place", "date"),
        *(Column(name, numeric=True) for name in SURVEYED),
    ]
    rows: Rows = [
        [
            str(day.place),
            f"{day.sun.times[0]:%Y-%m-%d}",
            f"{day.hours(day.faces):.1f}",
            f"{np.degrees(np.max(day.errors[day.faces], initial=0.0)):.2f}",
            f"{1e-3 * day.light[FIXED]:.2f}",
            *(f"{100.0 * day.light[name] / day.light[FIXED] - 100.0:+.1f}" for name in names),
            f"{1e3 * day.work:.2g}",
        ]
        for day in days
    ]
    gains = [100.0 * day.light[FACING] / day.light[FIXED] - 100.0 for day in days]
    parts: list[Part] = [
        Table("days of clear sky, gains over a panel fixed at the latitude's tilt", columns, rows),
        Lines("assumptions", list(assumptions(days[0]))),
    ]
    found = f"always facing the sun gains {min(gains):.0f} to {max(gains):.0f} % over a fixed panel"
    return Report(
        f"{days[0].scene.name} over {len(days)} days", found, Cell("followed", "holds"), parts, None, parts
    )


def table_of_commands(day: Day) -> bytes:
    """Return the set-points as CSV: times, sun, joint coordinates in m or rad, and the pointing error."""
    units = ("m" if day.is_slide(name) else "rad" for name in day.commands)
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(
        ["time", "seconds", "sun_azimuth_deg", "sun_elevation_deg"]
        + [f"{name}_{unit}" for name, unit in zip(day.commands, units, strict=True)]
        + ["off_sun_deg", "may_face_sun", "set_point_reached"]
        + ([] if day.wind is None else ["wind_m_per_s"])
    )
    for k, time in enumerate(day.sun.times):
        angles = np.degrees([day.sun.azimuth[k], day.sun.elevation[k]])
        commands = [f"{values[k]:.9g}" for values in day.commands.values()]
        off = f"{np.degrees(day.errors[k]):.6f}"
        writer.writerow(
            [
                time.isoformat(),
                f"{day.seconds[k]:g}",
                *(f"{angle:.6f}" for angle in angles),
                *commands,
                off,
                int(day.faces[k]),
                int(day.poses.reached[k]),
                *([] if day.wind is None else [f"{day.wind[k]:.6g}"]),
            ]
        )
    return text.getvalue().encode()


def files_of(folder: Path, several: bool) -> list[Path]:
    """Return the paths of the files of a day, or of several days."""
    return [folder / name for name in (SURVEY_FILES if several else DAY_FILES)]


def write_survey(report: Report, folder: Path) -> list[Path]:
    """Write the table of days as CSV; raises `CrosscheckError` naming the path that cannot be written."""
    (path,) = files_of(folder, several=True)
    table = next(part for part in report.parts if isinstance(part, Table))
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(" ".join(column.name.split()) for column in table.columns)
    writer.writerows([cell.text for cell in row] for _, row in table.sections())
    write_files({path: text.getvalue().encode()})
    return [path]


@own_style()
def picture(day: Day) -> Figure:
    """Plot the elevations of sun and panel, the set-points, and the irradiance over the day."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.0, 7.0), layout="constrained")
    figure.suptitle(f"{day.scene.name}, {day.sun.times[0]:%Y-%m-%d}, {day.place}")
    hour = day.seconds / 3600.0
    above, commands, light = figure.subplots(3, 1, sharex=True)

    def draw(ax: object, lines: dict[str, Array], label: str) -> None:
        """Plot lines (n,) by name over the time of day."""
        for name, values in lines.items():
            ax.plot(hour, values, label=name, linewidth=1.4)  # type: ignore[attr-defined]
        ax.set_ylabel(label)  # type: ignore[attr-defined]
        ax.grid(alpha=0.3)  # type: ignore[attr-defined]
        ax.legend(loc="upper right", fontsize="small")  # type: ignore[attr-defined]

    up = np.where(day.sun.is_up, np.degrees(day.sun.elevation), np.nan)
    off = np.where(day.sun.is_up, np.degrees(day.errors), np.nan)
    panel = np.degrees(np.arcsin(np.clip(day.normals[:, 2], -1.0, 1.0)))
    draw(above, {"sun's elevation": up, "normal's elevation": panel, "between both": off}, "deg")
    units = sorted({"mm" if day.is_slide(name) else "mrad" for name in day.commands})
    lines = {name: 1e3 * values for name, values in day.commands.items()}
    draw(commands, lines, f"set-points, {' and '.join(units)}")
    draw(light, dict(day.irradiance), "clear sky, W/m^2")
    light.set_xlabel("time of day, h")
    light.set_xlim(0.0, 24.0)
    return figure


def write(day: Day, report: Report, folder: Path) -> list[Path]:
    """Write the set-points, the plot and the recording: all files or none.

    Raises:
        CrosscheckError: naming the path that cannot be written.
    """
    from crosscheck.recording.log import log_run, recorded

    paths = files_of(folder, several=False)
    text = f"# {report.title}\n\n{report.verdict}\n"
    runs, directions = {"newton_euler": day.run}, {"sun": day.sun_seen}
    recording = recorded(log_run, day.scene, runs, text, report.title, directions=directions)
    contents = (table_of_commands(day), png(picture(day)), recording)
    write_files(dict(zip(paths, contents, strict=True)))
    return paths
