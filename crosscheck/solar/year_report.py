"""Report on a year of a solar tracker: irradiation by month, what keeps it from the sun, and files.

A `Year` has the irradiance on the panel of the tracker (`THIS`) and on other panels, in the n intervals of
the weather.
"""

from __future__ import annotations

import csv
import io
from calendar import month_abbr
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from crosscheck.report.chart import Measure, linear_chart
from crosscheck.report.plots import own_style, png
from crosscheck.report.render import as_json
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
from crosscheck.solar.energy import FACING, FIXED, FLAT, ONE_AXIS, THIS
from crosscheck.solar.year import FLAT_ON_BASE, Limit, Year
from crosscheck.support.files import write_files
from newton_euler.scalars import Array

if TYPE_CHECKING:
    from matplotlib.figure import Figure

YEAR_FILES = ("year.json", "months.csv", "hours.csv", "year.png")
"""Names of the files of a year: report with all sums, irradiation by month and by interval, and plot."""

HEADINGS = {
    THIS: "this\ntracker",
    FLAT: "flat",
    FIXED: "tilted by\nlatitude",
    ONE_AXIS: "one\naxis",
    FACING: "facing\nthe sun",
    FLAT_ON_BASE: "flat on\nbase",
}
"""Headings of the columns of panels in the table of months."""


def year_report(year: Year) -> Report:
    """Report on one year: irradiation by month, limits, set-points and assumptions."""
    assumption_lines = Lines("assumptions", list(assumptions(year)))
    summary: list[Part] = [_months_table(year), _limits_table(year)]
    if year.strokes:
        summary.append(_strokes_table(year))
    if year.notes:
        summary.append(Lines("", list(year.notes)))
    title = f"{year.scene.name} over a year at {year.weather.place}: {year.weather.source}"
    light = [Measure(name, value, f"{value:.0f} kWh/m^2") for name, value in year.light.items()]
    return Report(
        title,
        verdict(year),
        Cell(""),
        [*summary, assumption_lines],
        summary=summary,
        charts=linear_chart("Light on the panel", "Irradiation of the year, in kWh/m^2", light),
        captions={"year.png": "Irradiation by month, and hours of each limit"},
        next_steps=_next_steps(year),
    )


def _next_steps(year: Year) -> list[str]:
    """List what the reader can do with the year: the limit that costs most light comes first."""
    texts = limit_texts(year)
    lost = {limit: year.lost_by(limit) for limit in texts if limit not in (Limit.NONE, Limit.DOWN)}
    worst = max(lost, key=lambda limit: lost[limit])
    steps = ["Compare the gain with the price of the mechanism and its drives."]
    if lost[worst] > 0.0:
        steps.insert(0, f"Improve first what costs most light: {texts[worst]}, {lost[worst]:.1f} kWh/m^2.")
    return steps


def verdict(year: Year) -> str:
    """Report in one sentence the irradiation of the year."""
    light = year.light
    gain, part = 100.0 * light[THIS] / light[FIXED] - 100.0, 100.0 * light[THIS] / light[FACING]
    daylight = len(year.limits) * year.weather.step - year.hours(Limit.DOWN)
    text = (
        f"{light[THIS]:.0f} kWh/m^2 on the panel: {abs(gain):.1f} % {'more' if gain >= 0.0 else 'less'} than "
        f"tilted by the latitude, {part:.1f} % of facing the sun always; faces the sun for "
        f"{year.hours(Limit.NONE):.0f} of {daylight:.0f} h of daylight"
    )
    if electric := year.electric:
        gain = 100.0 * electric[THIS] / electric[FIXED] - 100.0
        text += (
            f"; {electric[THIS]:.0f} kWh of direct current, {abs(gain):.1f} % "
            f"{'more' if gain >= 0.0 else 'less'} than tilted by the latitude"
        )
    return text


def _months_table(year: Year) -> Table:
    """Tabulate the irradiation of each month and of the year, and the electric energy of a module.

    The column of the electric energy is of this tracker. The last row is of the same module on each panel.
    """
    columns = [Column("month"), *(Column(HEADINGS[name], numeric=True) for name in year.light)]
    electric = None if year.power is None else year.monthly(year.power)
    if electric is not None:
        columns.append(Column("electric\nkWh", numeric=True))
    rows: Rows = []
    for k in range(12):
        cells = [f"{values[k]:.1f}" for values in year.by_month.values()]
        rows.append([month_abbr[k + 1], *cells, *([] if electric is None else [f"{electric[k]:.1f}"])])
    total = [f"{value:.1f}" for value in year.light.values()]
    rows.append(["year", *total, *([] if electric is None else [f"{np.sum(electric):.1f}"])])
    percent = [f"{100.0 * value / year.light[FIXED]:.1f}" for value in year.light.values()]
    rows.append(["of fixed, %", *percent, *([] if electric is None else [""])])
    if year.electric:
        rows.append(["electric, kWh", *(f"{energy:.1f}" for energy in year.electric.values()), ""])
    return Table("irradiation, kWh/m^2", columns, rows)


def limit_texts(year: Year) -> dict[Limit, str]:
    """Return the text of each limit for the report, with its number."""
    deadband = year.tracking.deadband
    return {
        Limit.NONE: f"none, within {deadband:g} deg" if deadband else "none, faces the sun",
        Limit.TILT: f"largest tilt, {year.tracking.max_tilt:g} deg",
        Limit.SHADOW: f"shadow on the next row, {year.tracking.pitch:g} lengths away",
        Limit.REACH: "out of reach of the mechanism",
        Limit.COLLISION: f"bodies closer than {1e3 * year.tracking.clearance:g} mm",
        Limit.SINGULAR: "nearly singular",
        Limit.STROKE: "end of a stroke",
        Limit.WIND: f"wind of {year.tracking.stow:g} m/s or more",
        Limit.DOWN: "sun below the horizon",
    }


def _limits_table(year: Year) -> Table:
    """Tabulate the hours with each limit, and the irradiation lost by it."""
    columns = [*text_columns("limit"), *number_columns("h", "kWh/m^2 lost", "% lost")]
    rows: Rows = []
    for limit, text in limit_texts(year).items():
        hours, lost = year.hours(limit), year.lost_by(limit)
        if hours > 0.0 and (limit != Limit.DOWN or round(lost, 1) != 0.0):
            percent = 100.0 * lost / year.light[FACING]
            # adding 0 removes the sign of -0.0
            rows.append([text, f"{hours:.0f}", *(f"{round(each, 1) + 0.0:.1f}" for each in (lost, percent))])
    return Table("what keeps the panel from the sun", columns, rows)


def _strokes_table(year: Year) -> Table:
    """Tabulate the range of the set-points of each joint from the initial pose: mm, or degrees."""
    rows: Rows = []
    for joint, (low, high) in year.strokes.items():
        is_slide = _is_slide(year, joint)
        factor, unit = (1e3, "mm") if is_slide else (float(np.degrees(1.0)), "deg")
        rows.append(
            [joint, *(f"{round(factor * value, 2) + 0.0:.2f}" for value in (low, high, high - low)), unit]
        )
    columns = [*text_columns("joint"), *number_columns("from", "to", "range"), Column("unit")]
    return Table("set-points from the initial pose", columns, rows)


def _is_slide(year: Year, label: str) -> bool:
    """Return True for the label of a joint coordinate in m, False for one in rad."""
    mechanism = year.scene.mechanism
    return next(
        mechanism.is_slide(*key) for key, name in mechanism.coordinate_labels.items() if name == label
    )


def assumptions(year: Year) -> Iterator[str]:
    """Yield the assumptions of the report, one sentence each."""
    weather = year.weather
    yield from weather.notes
    yield f"the sun stands still in each interval of {weather.step:g} h, at its place by NREL's algorithm"
    yield "diffuse light of Hay and Davies, ground of albedo 0.2; no shade of the horizon or of other rows"
    yield "poses at rest: the motion between set-points and the energy of the actuators are not computed"
    yield "a panel under clouds receives more if it lies flat: losses may be negative"
    yield "the panel at one axis turns up to 60 degrees about a horizontal axis from north to south"
    if year.module is not None:
        heat = "" if year.module.temperature_coefficient else "; the module stays at 25 degrees Celsius"
        yield f"direct current by PVWatts, without losses by reflection, dirt, wires and inverter{heat}"


def _csv(header: Iterable[str], rows: Iterable[Iterable[str]]) -> bytes:
    """Return a CSV file."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(header)
    writer.writerows(rows)
    return text.getvalue().encode()


def months_csv(year: Year) -> bytes:
    """Return the irradiation of the months as CSV, kWh/m^2, and the electric energy, kWh."""
    columns: dict[str, Array] = {
        f"{name.replace(',', '')} kWh/m^2": values for name, values in year.by_month.items()
    }
    if year.power is not None:
        columns["electric kWh"] = year.monthly(year.power)
    rows = ([str(k + 1), *(f"{values[k]:.6g}" for values in columns.values())] for k in range(12))
    return _csv(["month", *columns], rows)


def hours_csv(year: Year) -> bytes:
    """Return the intervals with light as CSV: weather, sun, panel, irradiances and set-points."""
    lit, weather = np.flatnonzero(year.lit), year.weather
    azimuth, tilt = np.arctan2(*year.normals[:, :2].T), np.arccos(np.clip(year.normals[:, 2], -1.0, 1.0))
    columns: dict[str, Array | None] = {
        "sun_azimuth_deg": np.degrees(year.sun.azimuth),
        "sun_elevation_deg": np.degrees(year.sun.elevation),
        "dni_W_per_m2": weather.dni,
        "ghi_W_per_m2": weather.ghi,
        "dhi_W_per_m2": weather.dhi,
        "air_deg_C": weather.temperature,
        "wind_m_per_s": weather.wind,
        "normal_azimuth_deg": np.degrees(azimuth) % 360.0,
        "normal_tilt_deg": np.degrees(tilt),
        "off_sun_deg": np.degrees(year.off_sun),
        **{
            f"{name.replace(',', '').replace(' ', '_')}_W_per_m2": power
            for name, power in year.irradiance.items()
        },
        "electric_W": year.power,
    }
    for joint, values in year.coordinates.items():
        columns[f"{joint}_{'m' if _is_slide(year, joint) else 'rad'}"] = values
    known = {name: values[lit] for name, values in columns.items() if values is not None}
    times = [time.isoformat() for time in weather.times[lit]]
    limits = [Limit(value).name.lower() for value in year.limits[lit]]
    numbers = ([f"{value:.7g}" for value in row] for row in np.column_stack(list(known.values())))
    rows = ([time, limit, *row] for time, limit, row in zip(times, limits, numbers, strict=True))
    return _csv(["time", "limit", *known], rows)


@own_style()
def picture(year: Year) -> Figure:
    """Plot the irradiation of each month on all panels, and the hours of daylight by limit."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.0, 6.0), layout="constrained")
    figure.suptitle(f"{year.scene.name}, {year.weather.place}")
    month_plot, limit_plot = figure.subplots(2, 1)
    months, width = np.arange(1, 13), 0.8 / len(year.by_month)
    for k, (name, values) in enumerate(year.by_month.items()):
        month_plot.bar(months + (k - 0.5 * (len(year.by_month) - 1)) * width, values, width, label=name)
    month_plot.set_ylabel("irradiation, kWh/m^2")
    month_plot.legend(fontsize="small", ncols=3)
    bottom = np.zeros(12)
    for limit, text in limit_texts(year).items():
        if limit != Limit.DOWN and year.hours(limit) > 0.0:
            count = np.bincount(year.weather.months - 1, weights=year.limits == limit, minlength=12)
            limit_plot.bar(months, count * year.weather.step, 0.8, bottom, label=text)
            bottom += count * year.weather.step
    limit_plot.set_ylabel("daylight, h, by limit")
    limit_plot.legend(fontsize="small")
    for plot in (month_plot, limit_plot):
        plot.set_ylim(top=1.3 * plot.get_ylim()[1])  # space for the legend
        plot.set_axisbelow(True)
        plot.set_xticks(months, list(month_abbr)[1:])
        plot.grid(alpha=0.3, axis="y")
    return figure


def write_year(
    year: Year, report: Report, folder: Path, source: str, options: Mapping[str, Any]
) -> list[Path]:
    """Write the files of a year, all of them or none, and return their paths.

    Args:
        year: the year.
        report: the report on it.
        folder: folder for the files.
        source: name or file of the scene.
        options: options of the scene.

    Raises:
        CrosscheckError: naming the path that cannot be written.
    """
    results, months, hours, plot = paths = [folder / name for name in YEAR_FILES]
    weather = year.weather
    content = {
        "scene": year.scene.name,
        "source": source,
        "options": dict(options),
        "weather": weather.source,
        "latitude": weather.place.latitude,
        "longitude": weather.place.longitude,
        "irradiation": year.light,  # kWh/m^2
        "hours": {limit.name.lower(): year.hours(limit) for limit in Limit},
        "lost": {limit.name.lower(): year.lost_by(limit) for limit in Limit},  # kWh/m^2
        "strokes": year.strokes,  # m or rad
        "electric": year.electric,  # kWh, by panel
    }
    picture_content = {plot: png(picture(year))}
    write_files(
        {
            results: as_json(content, report, picture_content),
            months: months_csv(year),
            hours: hours_csv(year),
            **picture_content,
        }
    )
    return paths
