"""Rows of weather files as text, with the format recognized from the content.

The formats are those of `crosscheck.solar.weather_files`. `table_of` finds the rows, so that
`crosscheck.solar.weather_files` can name the line and the column of an error.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from newton_euler.errors import listed
from newton_euler.model.source_file import SourceError

TMY3, EPW, NSRDB, PVGIS_TYPICAL, PVGIS_HOURLY = "TMY3", "EPW", "NSRDB", "PVGIS typical year", "PVGIS hourly"
"""Names of the formats."""

NEEDED = "a weather file: TMY3, EPW, CSV of NSRDB, or CSV or JSON of PVGIS (typical year or hourly)"
"""Description of the formats for messages."""

OPTIONAL = ("temp_air", "wind_speed")
"""Quantities that may be missing."""

EPW_COLUMNS = {"temp_air": 6, "ghi": 13, "dni": 14, "dhi": 15, "wind_speed": 21}
"""Position of each quantity in a row of an EPW file."""

EPW_HEADER_LINES = 8
"""Number of lines before the hours of an EPW file."""


@dataclass
class Table:
    """Rows of a weather file.

    Attributes:
        kind: name of the format.
        names: own name of each quantity in the file, by its name in pvlib.
        rows: name of each row in messages, such as "line 3".
        stamps: time stamp of each row as text.
        cells: text or number of each row by the own names of the quantities.
    """

    kind: str
    names: Mapping[str, str]
    rows: list[str] = field(default_factory=list)
    stamps: list[str] = field(default_factory=list)
    cells: list[Mapping[str, object]] = field(default_factory=list)


STAMPS = {
    TMY3: r"(?P<month>\d\d)/(?P<day>\d\d)/(?P<year>\d{4}) (?P<hour>\d\d):(?P<minute>\d\d)",
    EPW: r"(?P<year>\d{4}),(?P<month>\d+),(?P<day>\d+),(?P<hour>\d+)",
    NSRDB: r"(?P<year>\d{4}) (?P<month>\d+) (?P<day>\d+) (?P<hour>\d+) (?P<minute>\d+)",
    PVGIS_TYPICAL: r"(?P<year>\d{4})(?P<month>\d\d)(?P<day>\d\d):(?P<hour>\d\d)(?P<minute>\d\d)",
    PVGIS_HOURLY: r"(?P<year>\d{4})(?P<month>\d\d)(?P<day>\d\d):(?P<hour>\d\d)(?P<minute>\d\d)",
}
"""Pattern of time stamps by format."""

NAMES = {
    TMY3: {
        "ghi": "GHI (W/m^2)",
        "dni": "DNI (W/m^2)",
        "dhi": "DHI (W/m^2)",
        "temp_air": "Dry-bulb (C)",
        "wind_speed": "Wspd (m/s)",
    },
    EPW: {
        "ghi": "global horizontal radiation",
        "dni": "direct normal radiation",
        "dhi": "diffuse horizontal radiation",
        "temp_air": "dry bulb temperature",
        "wind_speed": "wind speed",
    },
    NSRDB: {
        "ghi": "GHI",
        "dni": "DNI",
        "dhi": "DHI",
        "temp_air": "Temperature",
        "wind_speed": "Wind Speed",
    },
    PVGIS_TYPICAL: {
        "ghi": "G(h)",
        "dni": "Gb(n)",
        "dhi": "Gd(h)",
        "temp_air": "T2m",
        "wind_speed": "WS10m",
    },
    PVGIS_HOURLY: {
        "poa_direct": "Gb(i)",
        "poa_sky_diffuse": "Gd(i)",
        "solar_elevation": "H_sun",
        "temp_air": "T2m",
        "wind_speed": "WS10m",
    },
}
"""Own names of the quantities by format, and by their names in pvlib."""


def table_of(where: str, text: str) -> Table:
    """Recognize the format of a file, and return its rows; raises `SourceError` for another format."""
    lines = text.split("\n")
    if text.lstrip().startswith("{"):
        return _json_table(where, text)
    if lines[0].startswith("LOCATION,"):
        return _epw_table(where, lines)
    if len(lines) > 1 and lines[1].startswith("Date (MM/DD/YYYY)"):
        return _csv_table(where, Table(TMY3, NAMES[TMY3]), lines, header=1, stamp_columns=2)
    if len(lines) > 2 and lines[0].startswith("Source,Location ID,"):
        return _csv_table(where, Table(NSRDB, NAMES[NSRDB]), lines, header=2, stamp_columns=5)
    if lines[0].startswith("Latitude (decimal degrees)"):
        kinds = {"time(UTC),": PVGIS_TYPICAL, "time,": PVGIS_HOURLY}  # by the first column of the header
        for number, line in enumerate(lines):
            for first, kind in kinds.items():
                if line.startswith(first):
                    return _csv_table(where, Table(kind, NAMES[kind]), lines, number, stamp_columns=1)
    raise SourceError(where, f"line 1: {lines[0].strip()!r:.60} begins no known format; needed: {NEEDED}")


def _csv_table(where: str, table: Table, lines: Sequence[str], header: int, stamp_columns: int) -> Table:
    """Add the rows of a CSV file to a table.

    Args:
        where: path of the file for messages.
        table: table without rows.
        lines: all lines of the file.
        header: index of the line with the names of columns; rows end at an empty line.
        stamp_columns: number of columns of the time stamp, which come first.
    """
    columns = [name.strip() for name in lines[header].split(",")]
    for name, own in table.names.items():
        if own not in columns and name not in OPTIONAL:
            hint = "; download it with radiation components" if table.kind == PVGIS_HOURLY else ""
            found = listed(columns[:12])
            raise SourceError(where, f"line {header + 1}: no column {own!r}, but {found:.120}{hint}")
    for number, line in enumerate(lines[header + 1 :], start=header + 2):
        if not line.strip():
            break
        cells = [cell.strip() for cell in line.split(",")]
        if len(cells) != len(columns):
            raise SourceError(where, f"line {number}: has {len(cells)} cells; needed: {len(columns)}")
        table.rows.append(f"line {number}")
        table.stamps.append(" ".join(cells[:stamp_columns]))
        table.cells.append(dict(zip(columns, cells, strict=True)))
    rest = len(table.rows) + header + 1
    if table.kind in (TMY3, NSRDB) and any(line.strip() for line in lines[rest:]):
        raise SourceError(where, f"line {rest + 1}: is empty; needed: a row for each hour")
    return table


def _epw_table(where: str, lines: Sequence[str]) -> Table:
    """Return the rows of an EPW file, whose columns have no names."""
    if len(lines) < EPW_HEADER_LINES or not lines[EPW_HEADER_LINES - 1].startswith("DATA PERIODS,1,1,"):
        needed = "'DATA PERIODS,1,1,...', one period of hours"
        raise SourceError(where, f"line {EPW_HEADER_LINES}: needed: {needed}")
    table = Table(EPW, NAMES[EPW])
    count = max(EPW_COLUMNS.values()) + 1
    for number, line in enumerate(lines[EPW_HEADER_LINES:], start=EPW_HEADER_LINES + 1):
        cells = [cell.strip() for cell in line.split(",")]
        if not line.strip() and not any(each.strip() for each in lines[number:]):
            break
        if len(cells) < count:
            raise SourceError(where, f"line {number}: has {len(cells)} cells; needed: {count} or more")
        table.rows.append(f"line {number}")
        table.stamps.append(",".join(cells[:4]))
        table.cells.append({NAMES[EPW][name]: cells[k] for name, k in EPW_COLUMNS.items()})
    return table


def _json_table(where: str, text: str) -> Table:
    """Return the rows of a JSON file of PVGIS."""
    try:
        content = json.loads(text)
        outputs = content["outputs"]
        key = next(key for key in ("tmy_hourly", "hourly") if key in outputs)
        rows, meta = outputs[key], content["meta"]
    except (ValueError, RecursionError, KeyError, TypeError, StopIteration) as error:
        raise SourceError(where, f"is JSON, but not of PVGIS; needed: {NEEDED}") from error
    kind, stamp = (PVGIS_TYPICAL, "time(UTC)") if key == "tmy_hourly" else (PVGIS_HOURLY, "time")
    table = Table(kind, NAMES[kind])
    if not isinstance(rows, list) or not isinstance(meta, dict):
        raise SourceError(where, f"outputs.{key} is no list of rows")
    for number, row in enumerate(rows):
        name = f"outputs.{key}[{number}]"
        if not isinstance(row, dict) or stamp not in row:
            raise SourceError(where, f"{name}: needed: a row with {stamp!r}")
        for quantity, own in table.names.items():
            if own not in row and quantity not in OPTIONAL:
                raise SourceError(where, f"{name}: has no {own!r}")
        table.rows.append(name)
        table.stamps.append(str(row[stamp]))
        table.cells.append(row)
    return table
