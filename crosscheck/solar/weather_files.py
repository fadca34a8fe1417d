"""Weather files: typical years (TMY3, EPW, PVGIS), years of NSRDB, and hourly years of PVGIS, read by pvlib.

The format is recognized from the content of a file. Rows are checked before pvlib reads the file, so that
errors name the line and the column.

Irradiances belong to times other than their time stamps. The sun is computed at these times:

- TMY3: a row has averages over the hour before its stamp (Wilcox and Marion, Users Manual for TMY3 Data Sets,
  NREL/TP-581-43156, 2008, section 2); the middle is half an hour before the stamp.
- EPW: hour 1 of a row is the hour from 0:00 to 1:00 (EnergyPlus, Auxiliary Programs, "EPW CSV Format").
- NSRDB (CSV of the PSM models, also typical years): the stamp is the time of the satellite image, or the
  middle of the hour.
- PVGIS, typical year: the header has the time of the satellite image after the stamp, 0.5 h for averages of
  reanalysis ("Irradiance Time Offset"). Files from before 2025 lack the header.
- PVGIS as EPW: the same offset is in a comment, counted from the end of the hour. Hours are UTC, although the
  header has another zone.
- PVGIS, hourly: the stamp is the time of the satellite image, or the middle of the hour.
"""

from __future__ import annotations

import io
import re
from collections.abc import Mapping
from datetime import datetime
from typing import TYPE_CHECKING, Any

import numpy as np

from crosscheck.solar.place import SUN, Place, sun_over
from crosscheck.solar.weather import Weather, localized
from crosscheck.solar.weather_tables import (
    EPW,
    NSRDB,
    OPTIONAL,
    PVGIS_HOURLY,
    PVGIS_TYPICAL,
    STAMPS,
    TMY3,
    Table,
    table_of,
)
from crosscheck.support.errors import CrosscheckError
from newton_euler.errors import plain_number
from newton_euler.model.source_file import SourceError, path_text, read_content
from newton_euler.optional_packages import optional_package
from newton_euler.scalars import Array

if TYPE_CHECKING:
    import pandas as pd

RANGES = {
    "ghi": (-1.0, 1600.0),
    "dni": (-1.0, 1600.0),
    "dhi": (-1.0, 1600.0),
    "poa_direct": (-1.0, 1600.0),
    "poa_sky_diffuse": (-1.0, 1600.0),
    "solar_elevation": (-90.0, 90.0),
    "temp_air": (-90.0, 70.0),
    "wind_speed": (0.0, 98.0),
}
"""Valid range of each quantity by its name in pvlib: W/m^2, degrees, degrees Celsius, m/s. Formats mark
missing values by numbers outside, such as -9900, 99.9 and 9999."""

HOURS_OF_YEARS = (8760, 8784)
"""Number of hours of a year, and of a leap year."""

END_OF_FEBRUARY_28 = 59 * 24
"""Hours from the beginning of a year to the end of February 28."""

MAX_CLOSURE_ERROR = 0.04
"""Largest mean deviation of GHI from DNI cos(zenith) + DHI, relative to the mean of GHI, for a zone that is
not searched. Files of TMY3 and PVGIS have 0.002, and 0.02 more for each quarter of an hour."""

SHIFTS = np.arange(-12.0, 12.5, 0.5)
"""Errors of the time zone that are searched, h."""


def read_weather(path: str, year: int | None = None, zone: str | None = None) -> Weather:
    """Read a weather file; the module's docstring has the formats.

    Args:
        path: the file.
        year: calendar year, for an hourly file with several; None for a typical year or the only year.
        zone: time zone of the file's times that replaces the zone of its header; None to use the header.

    Raises:
        SourceError: naming the file, and the line or the column, for a file that cannot be read, another
            format, missing columns, rows or values, and a time zone that does not fit the irradiance.
        CrosscheckError: for an invalid year or zone.
        MissingPackageError: if pvlib is not installed.
    """
    where = path_text(path)
    pd = optional_package("pandas", SUN)
    # headers are ASCII; other bytes are in names of places only
    text = read_content(path, "csv_size").decode("latin-1").removeprefix("\xef\xbb\xbf").replace("\r\n", "\n")
    table = table_of(where, text)
    numbers = _checked_numbers(where, table)
    step = _check_stamps(where, table)
    try:
        data, meta = _read_with_pvlib(table.kind, text)
    except Exception as error:  # pvlib raises errors of many kinds for files of other forms
        raise SourceError(where, f"pvlib cannot read it as {table.kind}: {error}") from error
    try:
        place, stamps, offset, notes = _place_and_times(where, text, table.kind, data, meta)
    except (CrosscheckError, AttributeError, KeyError, TypeError, ValueError) as error:
        raise SourceError(where, f"header: {error}") from error
    if zone is not None:
        stamps = localized(stamps.tz_localize(None), zone)
    times = stamps + pd.Timedelta(hours=offset)
    if table.kind == TMY3:  # pvlib moves the midnight after February 28 of a leap year to that before March 1
        leap_day = (times.month == 2) & (times.day == 29)
        times = times - pd.to_timedelta(np.where(leap_day, 24.0, 0.0), unit="h")
    # for hourly files, rows of one year
    chosen = _rows_of_year(where, table.kind, stamps, year)
    values = {name: np.asarray(data[name], dtype=float)[chosen] for name in table.names if name in data}
    for name in OPTIONAL:  # numbers outside of the range mean that the value is missing
        if name in values:
            values[name] = numbers[name][chosen]
    weather = Weather(
        place=place,
        source=f"{table.kind} file {where}"
        + (f", {stamps.year[chosen[0]]}" if table.kind == PVGIS_HOURLY else ""),
        times=times[chosen],
        step=step,
        **_irradiance(values),
        temperature=_known(values.get("temp_air")),
        wind=_known(values.get("wind_speed")),
        rows=tuple(table.rows[k] for k in chosen),
        notes=tuple(notes),
    )
    _check_zone(where, weather)
    return weather


def _read_with_pvlib(kind: str, text: str) -> tuple[Any, Mapping[str, Any]]:
    """Read the content of a file of a format with pvlib; return the data frame and the metadata."""
    tools = optional_package("pvlib", SUN).iotools
    stream = io.StringIO(text)
    if kind == TMY3:
        return tools.read_tmy3(stream)
    if kind == EPW:
        return tools.read_epw(stream)
    if kind == NSRDB:
        return tools.read_nsrdb_psm4(stream)
    form = "json" if text.lstrip().startswith("{") else "csv"
    if kind == PVGIS_HOURLY:
        return tools.read_pvgis_hourly(stream, form)
    # the reader of this CSV needs bytes
    return tools.read_pvgis_tmy(io.BytesIO(text.encode("latin-1")) if form == "csv" else stream, form)


def _known(values: Array | None) -> Array | None:
    """Return values (n,), or None if all of them are missing."""
    return None if values is None or np.isnan(values).all() else values


def _irradiance(values: Mapping[str, Array]) -> dict[str, Array]:
    """Return DNI, GHI and DHI (n,), W/m^2, from columns of a file by their names in pvlib."""
    if "ghi" in values:
        return {name: np.maximum(values[name], 0.0) for name in ("dni", "ghi", "dhi")}
    # a horizontal plane: GHI is the sum, DNI follows from the elevation of the sun
    direct, dhi = (np.maximum(values[name], 0.0) for name in ("poa_direct", "poa_sky_diffuse"))
    zenith = 90.0 - values["solar_elevation"]
    dni = optional_package("pvlib", SUN).irradiance.dni(direct + dhi, dhi, zenith)
    return {"dni": np.nan_to_num(np.asarray(dni)), "ghi": direct + dhi, "dhi": dhi}


# Checks


def _checked_numbers(where: str, table: Table) -> dict[str, Array]:
    """Convert the columns to numbers (n,), with NaN for missing temperatures and winds.

    Raises:
        SourceError: naming the row and the column of a cell that is no number or out of range.
    """
    numbers = {}
    for name, own in table.names.items():
        if name in OPTIONAL and (not table.cells or own not in table.cells[0]):
            continue
        values, (low, high) = np.full(len(table.rows), np.nan), RANGES[name]
        for k, row in enumerate(table.cells):
            cell = row.get(own)
            try:
                number = plain_number(str(cell))
            except ValueError as error:
                if name in OPTIONAL and cell in ("", None):
                    continue
                problem = f"{own} is {cell!r:.60}; needed: a number"
                raise SourceError(where, f"{table.rows[k]}: {problem}") from error
            if low <= number <= high:
                values[k] = number
            elif name not in OPTIONAL:
                problem = f"{own} is {number:g}; needed: {low:g} to {high:g}"
                raise SourceError(where, f"{table.rows[k]}: {problem}")
        numbers[name] = values
    return numbers


def _check_stamps(where: str, table: Table) -> float:
    """Check the time stamps, and return the time between rows: 1 h, or less for NSRDB.

    Months of a typical year are from several years; February 29 may be missing.

    Raises:
        SourceError: for a row that is not one step after the row before, and for missing rows.
    """
    pattern, hours = re.compile(STAMPS[table.kind]), list[float]()
    for name, stamp in zip(table.rows, table.stamps, strict=True):
        found = pattern.fullmatch(stamp)
        parts = {} if found is None else {key: int(text) for key, text in found.groupdict().items()}
        try:
            # in a leap year, so that February 29 is a date
            day = datetime(2000, parts["month"], parts["day"])
        except (KeyError, ValueError) as error:
            raise SourceError(where, f"{name}: {stamp!r:.60} is no time stamp of {table.kind}") from error
        hours.append(24.0 * (day.timetuple().tm_yday - 1) + parts["hour"] + parts.get("minute", 0) / 60.0)
    steps = np.diff(hours) % HOURS_OF_YEARS[1]
    usual = float(np.median(steps)) if table.kind == NSRDB and len(steps) else 1.0
    # after February 28: 24 h more, before a time stamp of March 1
    ends = np.asarray(hours[:-1]) - END_OF_FEBRUARY_28
    skips_leap_day = (ends >= -usual) & (ends <= 0.0) & (np.abs(steps - usual - 24.0) < 1e-9)
    for k in np.flatnonzero((np.abs(steps - usual) > 1e-9) & ~skips_leap_day)[:1]:
        place = f"{steps[k]:g} h after" if steps[k] < HOURS_OF_YEARS[1] / 2 else "before"
        problem = f"{table.stamps[k + 1]} is {place} the row before; needed: {usual:g} h after"
        raise SourceError(where, f"{table.rows[k + 1]}: {problem}")
    if table.kind != PVGIS_HOURLY and round(len(hours) * usual, 3) not in HOURS_OF_YEARS:
        problem = f"has {len(hours)} rows {usual:g} h apart"
        raise SourceError(where, f"{problem}; needed: the {HOURS_OF_YEARS[0]} hours of a year")
    return usual


def _rows_of_year(where: str, kind: str, stamps: pd.DatetimeIndex, year: int | None) -> Array:
    """Return the indices of the rows of a year; all rows of a file that has one year."""
    if kind != PVGIS_HOURLY:
        if year is not None:
            raise CrosscheckError(
                f"--year {year}: {where} is a {kind} file, which has one year; leave out --year"
            )
        return np.arange(len(stamps))
    years = sorted(set(stamps.year))
    if year is None and len(years) > 1:
        raise CrosscheckError(f"{where} has the years {years[0]} to {years[-1]}; choose one with --year")
    chosen = years[0] if year is None else year
    rows = np.flatnonzero(stamps.year == chosen)
    leap = chosen % 4 == 0 and (chosen % 100 != 0 or chosen % 400 == 0)
    needed = HOURS_OF_YEARS[int(leap)]
    if len(rows) != needed:
        raise SourceError(where, f"has {len(rows)} rows of {chosen}; needed: {needed}, all hours")
    return rows


def _place_and_times(
    where: str, text: str, kind: str, data: Any, meta: Mapping[str, Any]
) -> tuple[Place, Any, float, list[str]]:
    """Return the place, the time stamps with their zone, the time of irradiances after a stamp, h, and notes.

    Raises:
        SourceError: for irradiance on a plane that is not horizontal.
        CrosscheckError: for a place off the globe.
    """
    notes: list[str] = []
    header = meta["inputs"] if kind.startswith("PVGIS") else meta
    header = header.get("location", header)  # of JSON
    names = ("latitude", "longitude", "elevation" if kind.startswith("PVGIS") else "altitude")
    place = Place(*(float(header[name]) for name in names))
    if kind == TMY3:
        return place, data.index, -0.5, ["irradiances are averages over the hour before the time stamp"]
    if kind == NSRDB:
        return place, data.index, 0.0, ["irradiances are those at the time stamp"]
    if kind == EPW:  # pvlib's index is the beginning of the hour
        found = re.search(r"Irradiance Time Offset \(h\): *(-?[\d.]+)", text)
        if found is None:
            return place, data.index, 0.5, ["irradiances are averages over the hour"]
        notes.append(
            f"EPW of PVGIS: hours are UTC, irradiance {1.0 + float(found[1]):.2f} h after their begin"
        )
        return place, localized(data.index.tz_localize(None), "UTC"), 1.0 + float(found[1]), notes
    if kind == PVGIS_TYPICAL:
        offset = header.get("irradiance_time_offset", header.get("irradiance time offset"))
        if offset is None:
            notes.append("the header has no irradiance time offset: the sun is taken at the time stamps")
        else:
            notes.append(f"irradiances are those {float(offset):.2f} h after the time stamp")
        return place, data.index, float(offset or 0.0), notes
    _check_horizontal(where, meta["inputs"])
    return place, data.index, 0.0, ["irradiances are those at the time stamp"]


def _check_horizontal(where: str, inputs: Mapping[str, Any]) -> None:
    """Raise `SourceError` unless an hourly file of PVGIS is of a horizontal plane.

    Args:
        where: path of the file for messages.
        inputs: metadata of the file: texts of a CSV such as "0 deg.", or the nested inputs of a JSON.
    """
    slope: Any = inputs.get("Slope")
    if slope is None:
        fixed = inputs.get("mounting_system", {}).get("fixed", {})
        slope = fixed.get("slope", {}).get("value")
    text = str(slope).split(" ")[0]
    if text not in ("0", "0.0"):
        found = "none" if slope is None else str(slope).strip()
        raise SourceError(
            where, f"slope of the plane is {found:.40}; needed: 0 deg., a fixed horizontal plane"
        )


def _check_zone(where: str, weather: Weather) -> None:
    """Raise `SourceError` if GHI is not DNI cos(zenith) + DHI, but would be in another time zone."""
    pd = optional_package("pandas", SUN)
    light = np.flatnonzero(weather.ghi > 0.0)
    if not light.size:
        raise SourceError(where, "the irradiance is 0 in all hours")

    def error(rows: Array, shift: float) -> float:
        """Compute the mean deviation for some rows and a shift, h, relative to the mean of GHI."""
        sun = sun_over(weather.place, weather.times[rows] + pd.Timedelta(hours=shift))
        beam = weather.dni[rows] * np.maximum(np.sin(sun.elevation), 0.0)
        deviation = np.abs(weather.ghi[rows] - beam - weather.dhi[rows])
        return float(deviation.sum() / weather.ghi[rows].sum())

    given = error(light, 0.0)
    if given <= MAX_CLOSURE_ERROR:
        return
    some = light[:: max(1, len(light) // 300)]
    errors = [error(some, shift) for shift in SHIFTS]
    best = int(np.argmin(errors))
    if errors[best] < 0.5 * given:
        zone = weather.times.tz.utcoffset(weather.times[0].to_pydatetime()).total_seconds() / 3600.0
        fits = zone - SHIFTS[best]
        sign, hours = "-" if fits < 0.0 else "+", abs(fits)
        name = f"UTC{sign}{int(hours):02d}:{round(60.0 * (hours % 1.0)):02d}"
        problem = (
            f"GHI is not DNI cos(zenith) + DHI (mean error {100.0 * given:.0f} %) in the zone UTC{zone:+g}"
        )
        raise SourceError(where, f"{problem}; --zone {name} fits ({100.0 * errors[best]:.1f} %)")
