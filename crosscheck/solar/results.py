"""Result files of `crosscheck sun`: set-points as CSV, summary as JSON, plots, and the recording of a day."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from crosscheck.engines.registry import SOLVER
from crosscheck.report.plots import own_style, png
from crosscheck.report.render import as_json
from crosscheck.report.table import Report, Table
from crosscheck.solar.day import Day
from crosscheck.solar.energy import THIS
from crosscheck.solar.obstacles import Cause
from crosscheck.solar.reach import Reach, reach_csv, reach_picture
from crosscheck.solar.tables import largest_at
from crosscheck.support.files import write_files
from newton_euler.analysis.loads.motion_files import motions_csv
from newton_euler.scalars import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def write_day(
    day: Day,
    report: Report,
    paths: Sequence[Path],
    source: str,
    options: Mapping[str, str],
    reach: Reach | None = None,
) -> list[Path]:
    """Write the summary, the set-points, the motion, the plots and the recording of a day: all files or none.

    Args:
        day: the day.
        report: the report on it.
        paths: paths of the files, in the order of `crosscheck.solar.report.DAY_FILES`, then `REACH_FILES`.
        source: name or file of the scene.
        options: options of the scene.
        reach: positions of the sun over the year, or None.

    Raises:
        CrosscheckError: naming the path that cannot be written.
    """
    from crosscheck.recording.log import log_run
    from crosscheck.recording.stream import recorded

    summary, table, motion, plots, recording, *reach_paths = paths
    text = f"# {report.title}\n\n{report.verdict}\n"
    # `sun_seen` has unit vectors (n, 3) to the sun, in the horizontal plane at night
    runs, directions = {SOLVER.name: day.run}, {"sun": day.sun_seen}
    pictures = {
        plots: png(picture(day)),
        recording: recorded(log_run, day.scene, runs, text, report.title, directions=directions),
    }
    motions = motions_csv(day.motions).encode()
    tables = {table: table_of_set_points(day), motion: motions}
    if reach:
        tables[reach_paths[0]], pictures[reach_paths[1]] = reach_csv(reach), png(reach_picture(reach))
    content = {"source": source, "options": dict(options), **summary_of(day)}
    write_files(
        {
            summary: as_json(content, report, pictures),
            **tables,
            **pictures,
        }
    )
    return list(paths)


def write_survey(
    days: Sequence[Day], report: Report, paths: Sequence[Path], source: str, options: Mapping[str, str]
) -> list[Path]:
    """Write the summaries and the table of several days; arguments and errors as of `write_day`."""
    summary, rows = paths
    table = next(part for part in report.parts if isinstance(part, Table))
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(" ".join(column.name.split()) for column in table.columns)
    writer.writerows([cell.text for cell in row] for _heading, row in table.sections())
    content = {"source": source, "options": dict(options), "days": [summary_of(day) for day in days]}
    write_files({summary: as_json(content, report), rows: text.getvalue().encode()})
    return list(paths)


def summary_of(day: Day) -> dict[str, Any]:
    """Return the main numbers of a day for a JSON file, in SI units; light in W h/m^2, energy in J."""
    actuators = {}
    for name, actuator in day.actuators.items():
        largest: dict[str, Any] = {"unit": actuator.unit}
        for kind, forces in (("holding", actuator.holding), ("moving", actuator.moving)):
            k = largest_at(forces)
            if k is not None:
                largest[kind] = {"force": float(forces[k]), "time": day.sun.times[k].isoformat()}
        speed, power = (float(np.max(np.abs(values))) for values in (actuator.speed, actuator.power))
        actuators[name] = {**largest, "speed": speed, "power": power, "energy": actuator.energy}
    errors = {"total": day.errors, **day.error_parts}
    causes = day.faced.wanted_checks.cause
    return {
        "scene": day.scene.name,
        "date": f"{day.sun.times[0]:%Y-%m-%d}",
        "zone": str(day.sun.times.tz),
        "latitude": day.place.latitude,
        "longitude": day.place.longitude,
        "altitude": day.place.altitude,
        "base_rotation": day.base.rotation_at_rest().tolist(),
        "period": day.period,
        "hours_facing_sun": day.hours(day.faces),
        "largest_error": {
            cause: float(np.max(values[day.faces], initial=0.0)) for cause, values in errors.items()
        },
        "actuators": actuators,
        "blocked_hours": {cause.text: day.hours(causes == cause) for cause in Cause if cause != Cause.FREE},
        "min_clearance": float(np.min(day.faced.checks.clearance)),
        "min_to_singular": float(np.min(day.faced.checks.to_singular)),
        "lost_irradiation": day.lost_light,
        "irradiation": day.light,
    }


def table_of_set_points(day: Day) -> bytes:
    """Return the set-points as CSV, one row each.

    The columns are time and sun, wanted and faced normal (east, north, up), joint coordinates in m or rad,
    forces that hold the previous set-point and largest forces on the way to the next one, clearance and
    distance from singular configurations, pointing error, irradiance on the panel, and the wind speed if
    there is wind. Empty cells are unknown: no force at rest while a move lasts, no clearance without shapes.
    """
    checks, causes = day.faced.checks, day.faced.wanted_checks.cause
    columns: dict[str, Sequence[str] | Array] = {
        "time": [time.isoformat() for time in day.sun.times],
        "seconds": day.seconds,
        "sun_azimuth_deg": np.degrees(day.sun.azimuth),
        "sun_elevation_deg": np.degrees(day.sun.elevation),
    }
    for name, normals in (("wanted", day.wanted), ("faced", day.faced.directions)):
        names = (f"{name}_x", f"{name}_y", f"{name}_z")
        columns |= dict(zip(names, day.in_world(normals).T, strict=True))
    for name, values in day.set_points.items():
        columns[f"{name}_{'m' if day.is_slide(name) else 'rad'}"] = values
    for name, actuator in day.actuators.items():
        unit = actuator.unit.replace(" ", "_")
        columns[f"{name}_holding_{unit}"] = actuator.holding
        columns[f"{name}_moving_{unit}"] = actuator.moving
    columns |= {
        "clearance_m": np.where(np.isfinite(checks.clearance), checks.clearance, np.nan),
        "to_singular": checks.to_singular,
        "blocked": [Cause(cause).text if cause else "" for cause in causes],
        "off_sun_deg": np.degrees(day.errors),
        "may_face_sun": day.faces.astype(int),
        "set_point_reached": day.poses.reached.astype(int),
        "irradiance_W_per_m2": day.irradiance[THIS],
    }
    if day.wind is not None:
        columns["wind_m_per_s"] = day.wind
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows([_cell(value) for value in row] for row in zip(*columns.values(), strict=True))
    return text.getvalue().encode()


def _cell(value: Any) -> str:
    """Format a number for a CSV; empty for NaN. Texts stay as they are."""
    if isinstance(value, str):
        return value
    return "" if np.isnan(value) else f"{value:.9g}"


@own_style()
def picture(day: Day) -> Figure:
    """Plot elevations, causes of the pointing error, set-points, forces of actuators, and irradiance."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.0, 11.0), layout="constrained")
    figure.suptitle(f"{day.scene.name}, {day.sun.times[0]:%Y-%m-%d}, {day.place}")
    hour = day.seconds / 3600.0
    angle_plot, error_plot, set_point_plot, force_plot, light_plot = figure.subplots(5, 1, sharex=True)

    def draw(ax: Axes, lines: Mapping[str, Array], label: str) -> None:
        """Plot lines (n,) by name over the time of day."""
        for name, values in lines.items():
            ax.plot(hour, values, label=name, linewidth=1.4)
        ax.set_ylabel(label)
        ax.grid(alpha=0.3)
        ax.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), frameon=False, fontsize="small")

    up = day.sun.is_up
    normal_elevation = np.degrees(np.arcsin(np.clip(day.in_world(day.normals)[:, 2], -1.0, 1.0)))
    sun_elevation = np.where(up, np.degrees(day.sun.elevation), np.nan)
    draw(angle_plot, {"sun's elevation": sun_elevation, "normal's elevation": normal_elevation}, "deg")
    errors = {"total": day.errors, **day.error_parts}
    shown = {name: np.where(up, np.degrees(values), np.nan) for name, values in errors.items()}
    draw(error_plot, {name: e for name, e in shown.items() if np.nanmax(e) > 1e-3}, "pointing error, deg")
    scales = {name: day.scale(name) for name in day.set_points}
    units = sorted({unit for _, unit in scales.values()})
    lines = {name: scales[name][0] * values for name, values in day.set_points.items()}
    draw(set_point_plot, lines, f"set-points, {' and '.join(units)}")
    forces: dict[str, Array] = {}
    for name, actuator in day.actuators.items():
        forces |= {f"{name} at rest": actuator.holding, f"{name} in motion": actuator.moving}
    force_units = sorted({actuator.unit for actuator in day.actuators.values()})
    draw(force_plot, forces, f"forces, {' and '.join(force_units)}")
    draw(light_plot, day.irradiance, "clear sky, W/m^2")
    light_plot.set_xlabel("time of day, h")
    light_plot.set_xlim(0.0, 24.0)
    return figure
