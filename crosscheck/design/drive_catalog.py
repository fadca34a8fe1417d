"""Catalogs of drives: CSV files with a row for each combination of motor, gearbox and screw.

The header has names of columns, with a unit in brackets, such as `lead [mm]`; without a unit, numbers are in
SI units. Lines that begin with `#` are comments. Empty cells and missing columns have default values.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from typing import NamedTuple

from crosscheck.support.units import ANGLES, LENGTHS
from newton_euler.analysis.loads.drives import Drive, Screw
from newton_euler.analysis.loads.power_screws import (
    ENDS,
    Thread,
    buckling_force,
    critical_speed,
    usual_back_efficiency,
)
from newton_euler.errors import choices, listed, plain_number, quoted
from newton_euler.model.source_file import Row, SourceError, check_names, csv_rows, read_text

TORQUES = {"N m": 1.0, "N cm": 1e-2, "mN m": 1e-3}
SPEEDS = {"rad/s": 1.0, "rpm": 2.0 * math.pi / 60.0}
INERTIAS = {"kg m^2": 1.0, "kg cm^2": 1e-4, "g cm^2": 1e-7}
FORCES = {"N": 1.0, "kN": 1e3}
TORQUE_CONSTANTS = {"N m/A": 1.0, "mN m/A": 1e-3}
RESISTANCES = {"ohm": 1.0, "mohm": 1e-3}
DURATIONS = {"s": 1.0, "min": 60.0}
NO_UNIT: dict[str, float] = {}
"""Units of the columns and their sizes in SI units; the SI unit is the first."""

MAX_NUMBER, MIN_NUMBER = 1e9, 1e-12
"""Largest magnitude of a number of a catalog in SI units, and smallest one except 0."""

MAX_ROWS = 1000
"""Largest number of drives in a catalog."""

MAX_NAME_LENGTH = 40
"""Largest number of characters of the name of a drive."""

HEADING = re.compile(r"(?P<name>[^\[\]]*?)\s*(?:\[(?P<unit>[^\[\]]*)\])?")
"""Pattern of the heading of a column: a name and a unit in brackets."""


class NumberColumn(NamedTuple):
    """A column of numbers.

    Attributes:
        units: sizes of the units that the header may name.
        least, most: bounds in SI units.
        above_least: True if the lower bound itself is not allowed.
    """

    units: Mapping[str, float]
    least: float = 0.0
    most: float = MAX_NUMBER
    above_least: bool = False

    @property
    def needed(self) -> str:
        """Description of valid values."""
        unit = f" {next(iter(self.units))}" if self.units else ""
        least = f"above {self.least:g}" if self.above_least else f"{self.least:g} or more"
        return f"a number {least}, at most {self.most:.7g}{unit}"

    def allows(self, number: float) -> bool:
        """Return True for a number, in SI units, within the bounds."""
        if number != 0.0 and abs(number) < MIN_NUMBER:
            return False
        return (number > self.least if self.above_least else number >= self.least) and number <= self.most


def _positive(units: Mapping[str, float], most: float = MAX_NUMBER) -> NumberColumn:
    """Make a column of positive numbers."""
    return NumberColumn(units, most=most, above_least=True)


BACK_EFFICIENCY = NumberColumn(NO_UNIT, least=-1000.0, most=1.0)
"""Column of an efficiency of a stage that its load drives; negative for self-locking stages."""

NUMBER_COLUMNS: dict[str, NumberColumn] = {
    "rated_torque": _positive(TORQUES),
    "peak_torque": _positive(TORQUES),
    "rated_speed": _positive(SPEEDS),
    "friction_torque": NumberColumn(TORQUES),
    "motor_inertia": NumberColumn(INERTIAS),
    "motor_efficiency": _positive(NO_UNIT, most=1.0),
    "resistance": _positive(RESISTANCES),
    "torque_constant": _positive(TORQUE_CONSTANTS),
    "voltage": _positive({"V": 1.0}),
    "thermal_time": _positive(DURATIONS),
    "recovery": NumberColumn(NO_UNIT, most=1.0),
    "gear_ratio": _positive(NO_UNIT),
    "gear_efficiency": _positive(NO_UNIT, most=1.0),
    "gear_back_efficiency": BACK_EFFICIENCY,
    "gear_inertia": NumberColumn(INERTIAS),
    "gear_torque": _positive(TORQUES),
    "lead": _positive(LENGTHS),
    "screw_efficiency": _positive(NO_UNIT, most=1.0),
    "screw_back_efficiency": BACK_EFFICIENCY,
    "pitch_diameter": _positive(LENGTHS),
    "friction": NumberColumn(NO_UNIT, most=1.0),
    "flank_angle": NumberColumn(ANGLES, most=math.radians(60.0)),
    "collar_diameter": NumberColumn(LENGTHS),
    "collar_friction": NumberColumn(NO_UNIT, most=1.0),
    "screw_inertia": NumberColumn(INERTIAS),
    "screw_force": _positive(FORCES),
    "stroke": _positive(LENGTHS),
    "screw_length": _positive(LENGTHS),
    "root_diameter": _positive(LENGTHS),
}
"""Columns of numbers by name."""

NAME, SCREW_ENDS = "name", "screw_ends"
"""Columns of text: the name of the drive, and the supports of the screw, a name of `ENDS`."""

COLUMNS = (NAME, *NUMBER_COLUMNS, SCREW_ENDS)
"""Names of all columns."""

REQUIRED = (NAME, "rated_torque", "rated_speed")
"""Columns that each catalog has, without empty cells."""

SCREW_COLUMNS = COLUMNS[COLUMNS.index("lead") + 1 :]
"""Columns that only a drive with a lead may use."""

MOTOR_FIELDS = COLUMNS[COLUMNS.index("rated_torque") : COLUMNS.index("gear_back_efficiency")]
"""Columns that are attributes of `Drive`, with its default values."""


def read_catalog(path: str) -> tuple[Drive, ...]:
    """Read a catalog of drives.

    Raises:
        SourceError: naming the file, and the line and column at fault.
    """
    rows = csv_rows(path, read_text(path, limit="csv_size"), comments=True)
    if len(rows) < 2:
        raise SourceError(path, "has no drives; needed: a header and a row for each drive")
    if len(rows) > MAX_ROWS + 1:
        raise SourceError(path, f"has {len(rows) - 1} drives; needed: at most {MAX_ROWS}")
    names, sizes = _header(path, rows[0])
    drives: dict[str, Drive] = {}
    for row in rows[1:]:
        drive = _Reader(path, row, names, sizes).drive()
        if drive.name in drives:
            raise SourceError(path, f"line {row.line}: {NAME} is {drive.name!r} again; needed: unique names")
        drives[drive.name] = drive
    return tuple(drives.values())


def _header(path: str, row: Row) -> tuple[list[str], list[float]]:
    """Return the names of the columns, and the sizes of their units in SI units."""
    names, sizes = [], []
    for cell in row.cells:
        heading = HEADING.fullmatch(cell)
        name = heading["name"] if heading else cell
        if name not in COLUMNS:
            raise SourceError(
                path, f"line {row.line}: unknown column {quoted(cell)}; {choices(name, COLUMNS)}"
            )
        unit = heading["unit"] if heading else None
        units = NUMBER_COLUMNS[name].units if name in NUMBER_COLUMNS else NO_UNIT
        if unit is not None and unit not in units:
            needed = f"choose from: {listed(units)}" if units else "needed: none"
            raise SourceError(path, f"line {row.line}: column {name} has the unit {quoted(unit)}; {needed}")
        names.append(name)
        sizes.append(units[unit] if unit else 1.0)
    check_names(path, names, row.line)
    for name in REQUIRED:
        if name not in names:
            raise SourceError(path, f"line {row.line}: has no column {name}; needed: {listed(REQUIRED)}")
    return names, sizes


class _Reader:
    """Reads one row of a catalog.

    Attributes:
        texts: cells that are not empty, by the name of the column.
        numbers: numbers in SI units, by the name of the column.
    """

    def __init__(self, path: str, row: Row, names: list[str], sizes: list[float]) -> None:
        self._path, self._line = path, row.line
        if len(row.cells) != len(names):
            raise self._error(f"has {len(row.cells)} cells; needed: {len(names)}")
        filled = [
            (name, size, cell) for name, size, cell in zip(names, sizes, row.cells, strict=True) if cell
        ]
        self.texts = {name: cell for name, _, cell in filled}
        self.numbers = {
            name: self._number(name, size, cell) for name, size, cell in filled if name in NUMBER_COLUMNS
        }
        for name in REQUIRED:
            if name not in self.texts:
                raise self._error(f"{name} is missing; needed: a value in each row")
        if len(self.texts[NAME]) > MAX_NAME_LENGTH:
            raise self._error(
                f"{NAME} is {quoted(self.texts[NAME])}; needed: at most {MAX_NAME_LENGTH} characters"
            )

    def _error(self, problem: str) -> SourceError:
        """Make an error that names the file and the line."""
        return SourceError(self._path, f"line {self._line}: {problem}")

    def _number(self, name: str, size: float, cell: str) -> float:
        """Convert a cell to a number in SI units."""
        column = NUMBER_COLUMNS[name]
        try:
            number = size * plain_number(cell)
        except ValueError:
            number = math.nan
        if not column.allows(number):
            raise self._error(f"{name} is {quoted(cell)}; needed: {column.needed}")
        return number

    def drive(self) -> Drive:
        """Make the drive."""
        numbers = self.numbers
        if ("resistance" in numbers) != ("torque_constant" in numbers):
            raise self._error("resistance and torque_constant: one is missing; needed: both or none")
        if "voltage" in numbers and "resistance" not in numbers:
            raise self._error("voltage without resistance; needed: also resistance and torque_constant")
        if "motor_efficiency" in numbers and "resistance" in numbers:
            raise self._error("has motor_efficiency and resistance; needed: one of both")
        values = {name: numbers[name] for name in MOTOR_FIELDS if name in numbers}
        values.setdefault("peak_torque", numbers["rated_torque"])
        if values["peak_torque"] < values["rated_torque"]:
            raise self._error("peak_torque is below rated_torque; needed: rated_torque or more")
        gear = values.get("gear_efficiency", 1.0)
        back = numbers.get("gear_back_efficiency", usual_back_efficiency(gear))
        inertia, torque = numbers.get("gear_inertia", 0.0), numbers.get("gear_torque")
        return Drive(
            self.texts[NAME],
            **values,
            gear_back_efficiency=back,
            gear_inertia=inertia,
            gear_torque=torque,
            screw=self._screw(),
        )

    def _screw(self) -> Screw | None:
        """Make the screw; None without a lead."""
        numbers = self.numbers
        if "lead" not in numbers:
            for name in SCREW_COLUMNS:
                if name in self.texts:
                    raise self._error(f"has {name} without lead; needed: also lead, or none of a screw")
            return None
        efficiency, back_efficiency = self._screw_efficiencies()
        buckling = critical = None
        if "screw_length" in numbers:
            ends = ENDS[self._ends()]
            size = (self._root_diameter(), numbers["screw_length"])
            buckling, critical = buckling_force(*size, ends), critical_speed(*size, ends)
        elif SCREW_ENDS in self.texts:
            raise self._error(f"{SCREW_ENDS} without screw_length; needed: both or none")
        return Screw(
            numbers["lead"],
            efficiency,
            back_efficiency,
            inertia=numbers.get("screw_inertia", 0.0),
            max_force=numbers.get("screw_force"),
            stroke=numbers.get("stroke"),
            buckling_force=buckling,
            critical_speed=critical,
        )

    def _screw_efficiencies(self) -> tuple[float, float]:
        """Return efficiency and back efficiency of the screw, as given or from the friction of its thread."""
        numbers = self.numbers
        if "friction" in numbers:
            for name in ("screw_efficiency", "screw_back_efficiency"):
                if name in numbers:
                    raise self._error(f"has friction and {name}; needed: one of both")
            if "pitch_diameter" not in numbers:
                raise self._error("friction without pitch_diameter; needed: both")
            fields = {name: numbers[name] for name in Thread._fields if name in numbers}
            thread = Thread(**fields)
            if not thread.can_turn:
                raise self._error("no torque moves the screw; needed: a smaller lead or less friction")
            return thread.efficiency, thread.back_efficiency
        for name in ("flank_angle", "collar_diameter", "collar_friction"):
            if name in numbers:
                raise self._error(f"has {name} without friction; needed: also pitch_diameter and friction")
        if "screw_efficiency" not in numbers:
            raise self._error(
                "lead without friction; needed: pitch_diameter and friction, or screw_efficiency"
            )
        efficiency = numbers["screw_efficiency"]
        return efficiency, numbers.get("screw_back_efficiency", usual_back_efficiency(efficiency))

    def _ends(self) -> str:
        """Return the name of the supports of the screw."""
        name = self.texts.get(SCREW_ENDS, "supported")
        if name not in ENDS:
            raise self._error(f"{SCREW_ENDS} is {quoted(name)}; {choices(name, ENDS)}")
        return name

    def _root_diameter(self) -> float:
        """Return the root diameter, m: by default that of a square or trapezoidal thread with one start."""
        numbers = self.numbers
        if "root_diameter" in numbers:
            return numbers["root_diameter"]
        if "pitch_diameter" not in numbers:
            raise self._error("screw_length without root_diameter; needed: root_diameter or pitch_diameter")
        diameter = numbers["pitch_diameter"] - 0.5 * numbers["lead"]
        if diameter <= 0.0:
            raise self._error("pitch_diameter is below half of the lead; needed: root_diameter")
        return diameter
