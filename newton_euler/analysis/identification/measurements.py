"""Measured motion: columns of numbers over time, from a CSV file or from arrays.

Columns are in SI or the units of `UNITS`, vectors in the world frame. Names of columns are:

- `coordinate.JOINT` and `rate.JOINT`: joint coordinate, m or rad from the initial pose, and its rate. A joint
  of several coordinates has `coordinate.JOINT.0`, `coordinate.JOINT.1`.
- as in `Trajectory.to_dataframe`: `position.BODY.x` (m, the center of mass), `quaternion.BODY.w`,
  `linear_velocity.BODY.x`, `angular_velocity.BODY.x`, `reaction_force.JOINT.x`, `reaction_torque.JOINT.x`,
  `actuator_force.0` (index of the control law), `kinetic_energy`, `potential_energy`, `work`.
"""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from newton_euler.arguments import checked
from newton_euler.errors import (
    MechanismError,
    UnknownNameError,
    is_finite_number,
    listed,
    nearest,
    quoted,
    real_array,
)
from newton_euler.model.mechanism import Mechanism
from newton_euler.model.scene import Scene
from newton_euler.model.source_file import (
    Row,
    SourceError,
    TimeTable,
    check_names,
    csv_rows,
    path_text,
    read_text,
    row_numbers,
)
from newton_euler.model.trajectory import QUANTITIES, column_names
from newton_euler.runs.initial_coordinates import RATE_SUFFIX, START_PREFIX
from newton_euler.scalars import Array, Floats

NOISE = "noise"
"""Entry of the time column that marks the row of standard deviations."""

START = "start"
"""Entry of the time column that marks the row of joint coordinates and rates at the start."""

UNITS = {unit: (unit, 1.0) for unit in ("s", "m", "rad", "m/s", "rad/s", "N", "N m", "J", "1")} | {
    "ms": ("s", 1e-3),
    "mm": ("m", 1e-3),
    "mm/s": ("m/s", 1e-3),
    "deg": ("rad", np.pi / 180.0),
    "deg/s": ("rad/s", np.pi / 180.0),
}
"""Accepted units of columns, each with its SI unit and the factor to the SI unit."""

HEADING = re.compile(r"(.*?)\s*(?:\[([^]]*)\])?")
"""Pattern of the heading of a column: name, and unit in brackets if there is one."""


@dataclass(frozen=True, eq=False)
class Measurements:
    """Columns of numbers measured in one run of a scene.

    Attributes:
        time: (n,) s from the start of the run, ascending.
        columns: (n,) each, by name, such as "coordinate.pivot" or "position.rod.x".
        noise: standard deviations of columns, by name, in the units of the columns. The noise of columns
            without an entry is unknown.
        start: coordinates and rates at the start of the run, SI, by the names `start.JOINT` and
            `start.JOINT.rate`. Coordinates that are not given start as near to the scene's initial state as
            the loops allow.
        units: units of columns with their noise, and of the time, by name: "s", "ms", "m", "mm", "rad",
            "deg", "m/s", "mm/s", "rad/s", "deg/s", "N", "N m", "J" or "1". Columns without an entry are in
            SI. All numbers are converted to SI.

    Raises:
        MechanismError: naming the time or column: times that do not ascend, numbers that are not finite or
            not one for each time, and unknown units.

    Examples:
        >>> run = simulate(load("pendulum"))
        >>> angle = run.joint("pivot").coordinates[:, 0]
        >>> Measurements(run.time, {"coordinate.pivot": angle}, {"coordinate.pivot": 1e-3})
        <Measurements: 1001 times to 10 s, columns: 1>
    """

    time: Floats
    columns: Mapping[str, Floats]
    noise: Mapping[str, float] = field(default_factory=dict)
    start: Mapping[str, float] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for what in ("columns", "noise", "start", "units"):
            if not isinstance(given := getattr(self, what), Mapping):
                raise MechanismError("measurements", f"{what} is {quoted(given)}", "a mapping of names")
        # times
        factors = {name: _factor(name, unit) for name, unit in self.units.items()}
        if UNITS[self.units.get("time", "s")][0] != "s":
            raise MechanismError("measurements", f"unit of time is {self.units['time']!r}", "s or ms")
        time = _numbers("time", self.time, factors.get("time", 1.0))
        if len(time) < 2 or time[0] < 0.0 or np.any(np.diff(time) <= 0.0):
            raise MechanismError("measurements", "have no times in ascending order", "two or more, from 0 on")
        object.__setattr__(self, "time", time)
        # columns
        if not self.columns:
            raise MechanismError("measurements", "columns are {}", "columns by name")
        columns = {
            name: _numbers(f"column {quoted(name)}", column, factors.get(name, 1.0))
            for name, column in self.columns.items()
        }
        for name, column in columns.items():
            if len(column) != len(time):
                problem = f"column {quoted(name)} has {len(column)} numbers"
                raise MechanismError("measurements", problem, f"{len(time)}, one for each time")
        object.__setattr__(self, "columns", columns)
        # noise, units and start
        for name, deviation in self.noise.items():
            if name not in columns:
                raise MechanismError("measurements", f"have noise of {quoted(name)}", "columns alone")
            if not is_finite_number(deviation) or deviation <= 0.0:
                problem = f"noise of {quoted(name)} is {quoted(deviation)}"
                raise MechanismError("measurements", problem, "a positive number")
        noise = {name: float(level) * factors.get(name, 1.0) for name, level in self.noise.items()}
        object.__setattr__(self, "noise", noise)
        for name in self.units:
            if name not in columns and name != "time":
                raise MechanismError("measurements", f"have a unit of {quoted(name)}", "columns alone")
        object.__setattr__(self, "units", {name: UNITS[unit][0] for name, unit in self.units.items()})
        for name, number in self.start.items():
            if not isinstance(name, str) or not name.startswith(START_PREFIX) or not is_finite_number(number):
                problem = f"start with {quoted(name)} = {quoted(number)}"
                raise MechanismError("measurements", problem, f"finite numbers by {START_PREFIX}JOINT")

    def __repr__(self) -> str:
        return f"<Measurements: {len(self.time)} times to {self.time[-1]:g} s, columns: {len(self.columns)}>"


def _factor(name: str, unit: object) -> float:
    """Return the factor from the unit of a column to SI.

    Raises:
        MechanismError: for a unit that is not in `UNITS`; names the column.
    """
    if not isinstance(unit, str) or unit not in UNITS:
        raise MechanismError("measurements", f"unit of {quoted(name)} is {quoted(unit)}", ", ".join(UNITS))
    return UNITS[unit][1]


def _numbers(what: str, given: object, factor: float) -> Floats:
    """Convert numbers (n,) to a read-only array, times a factor.

    Args:
        what: name of the quantity, for messages.
        given: the numbers.
        factor: factor to SI.

    Raises:
        MechanismError: for anything but finite numbers.
    """
    try:
        array = real_array(given)
    except (TypeError, ValueError, OverflowError):
        array = np.zeros(0)
    if array.ndim != 1 or not len(array) or not np.isfinite(array).all():
        raise MechanismError("measurements", f"{what} is {quoted(given)}", "finite numbers in a row")
    array *= factor
    array.flags.writeable = False
    return array


@checked
def measurements_from_csv(path: str | os.PathLike[str]) -> Measurements:
    """Read measurements of one run.

    The first line names the columns: `time`, s from the start of the run, and columns such as
    `coordinate.pivot` or `position.rod.x`. A unit that is not SI follows in brackets, as in
    `coordinate.pivot [deg]`. A line with `noise` in place of a time has the standard deviations of columns. A
    line with `start` has the joint coordinates and rates at the start of the run. Unknown cells are empty.

    Raises:
        SourceError: naming the file and the line: missing cells, cells without a number, times that do not
            ascend, too few rows, or two columns with one name.

    Examples:
        >>> rows = ["time,coordinate.pivot", "noise,0.001", "0.0,0.0", "0.1,0.0473"]
        >>> _ = open("swing.csv", "w").write("\\n".join(rows))
        >>> measurements_from_csv("swing.csv").noise
        {'coordinate.pivot': 0.001}
    """
    where = path_text(path)
    rows = csv_rows(where, read_text(path, limit="csv_size"))
    header, units = _headings(rows[0].cells if rows else [])
    if "time" not in header or len(header) < 2:
        names = listed(header) or "no columns"
        needed = "a column time, and at least one of measurements"
        raise SourceError(where, f"line 1 has {names:.200}; needed: {needed}")
    check_names(where, header)
    # rows of measurements, and rows of noise and start by the name of the column
    time_column, data = header.index("time"), list[Row]()
    special_rows: dict[str, dict[str, float]] = {NOISE: {}, START: {}}
    for line, cells in rows[1:]:
        if len(cells) == len(header) and cells[time_column].lower() in special_rows:
            given = {name: cell for name, cell in zip(header, cells, strict=True) if cell and name != "time"}
            values = row_numbers(where, list(given), Row(line, list(given.values())))
            special_rows[cells[time_column].lower()] |= dict(zip(given, values, strict=True))
        else:
            data.append(Row(line, cells))
    if len(data) < 2:
        raise SourceError(where, f"has {len(data)} rows of measurements; needed: 2 or more")
    table = TimeTable.of(where, header, data)
    columns = dict(table.columns)
    time = columns.pop("time")
    table.refuse(time < 0.0, "time", time, needed="times from 0 on")
    try:
        start = {}
        for name, number in special_rows[START].items():
            if not (initial := initial_name(name)):
                problem = f"the start is given by column {quoted(name)}; needed: coordinates and rates"
                raise SourceError(where, problem)
            start[initial] = number * _factor(name, units.get(name, "1"))
        return Measurements(time, columns, noise=special_rows[NOISE], start=start, units=units)
    except MechanismError as error:
        raise SourceError(where, f"{error.problem}; needed: {error.needed}") from error


def _headings(cells: list[str]) -> tuple[list[str], dict[str, str]]:
    """Return the names of columns in the first line, and the units in brackets by name."""
    matches = [HEADING.fullmatch(cell) for cell in cells]
    pairs = [
        (match[1], match[2]) if match else (cell, None) for cell, match in zip(cells, matches, strict=True)
    ]
    return [name for name, _ in pairs], {name: unit for name, unit in pairs if unit is not None}


def initial_name(column: str) -> str:
    """Return the name of the initial coordinate or rate that a column measures; empty for other columns."""
    kind, _, joint = column.partition(".")
    return {"coordinate": f"{START_PREFIX}{joint}", "rate": f"{START_PREFIX}{joint}{RATE_SUFFIX}"}.get(
        kind, ""
    )


def column_places(
    mechanism: Mechanism, layout: Mapping[str, tuple[int, int, tuple[int, ...]]]
) -> dict[str, tuple[str, int]]:
    """Find all columns that can be measured, by name: their compiled program, and index in its results.

    The compiled programs are functions of a state of the mechanism: "coordinates" returns all joint
    coordinates, then their rates; "output" returns the arrays of a trajectory at one time.

    Args:
        mechanism: gives names of bodies, joints and coordinates.
        layout: layout of the results of the program "output": for each quantity, first index, end and shape.
    """
    labels = list(mechanism.coordinate_labels.values())
    places = {f"coordinate.{label}": ("coordinates", k) for k, label in enumerate(labels)}
    places |= {f"rate.{label}": ("coordinates", len(labels) + k) for k, label in enumerate(labels)}
    # names along dimensions b (bodies) and j (joints) of a trajectory's arrays
    names = {"b": mechanism.body_names, "j": mechanism.joint_names}
    for name, (start, _, shape) in layout.items():
        if name in QUANTITIES:
            columns = column_names(name, shape, names)
            places |= {column: ("output", start + k) for k, column in enumerate(columns)}
    return places


class Column(NamedTuple):
    """A measured column and the computed quantity that it is compared with.

    Attributes:
        program: name of the compiled program that computes the quantity, "coordinates" or "output".
        value_place: index of the quantity in the results of the program.
        derivative_place: index of its derivatives in the results of the program with derivatives.
        unit: SI unit.
        quaternion_body: number of the body if the column is a component of the body's quaternion; else -1.
    """

    program: str
    value_place: int
    derivative_place: int
    unit: str
    quaternion_body: int


Places = Mapping[str, tuple[str, int]]
"""Program and index in its results of each column, by name; see `column_places`."""


def column_of(scene: Scene, name: str, values: Places, derivatives: Places) -> Column:
    """Find the computed quantity of a measured column.

    Args:
        scene: scene of the run.
        name: name of the column.
        values, derivatives: places of all columns in the results, and in their derivatives.

    Raises:
        UnknownNameError: for an unknown column.
    """
    if name not in derivatives:
        raise UnknownNameError("column", name, nearest(name, derivatives), proposed=True)
    kind, _, rest = name.partition(".")
    mechanism, body = scene.mechanism, -1
    unit = QUANTITIES[kind].unit if kind in QUANTITIES else ""
    if kind in ("coordinate", "rate"):
        key = next(key for key, label in mechanism.coordinate_labels.items() if label == rest)
        unit = ("m" if mechanism.is_slide(*key) else "rad") + ("/s" if kind == "rate" else "")
    elif kind == "actuator_force":
        unit = "N" if mechanism.is_slide(*scene.control[int(rest)].key) else "N m"
    elif kind == "quaternion":
        body = mechanism.body_index(rest.rpartition(".")[0])
    program, value_place = values[name]
    _, derivative_place = derivatives[name]
    return Column(program, value_place, derivative_place, unit, quaternion_body=body)


def compared(
    values: Array, derivatives: Array, run: Measurements, columns: list[Column]
) -> tuple[Array, Array]:
    """Compare computed with measured columns.

    Residuals of angles are at most half a revolution. A quaternion and its negative are the same orientation:
    computed quaternions get the sign that is nearer to the measured ones.

    Args:
        values: (n, m) computed columns, SI; changed.
        derivatives: (n, m, p) their derivatives with respect to parameters; changed.
        run: the measurements.
        columns: the m columns.

    Returns:
        Residuals (n, m), computed minus measured, and their derivatives (n, m, p).
    """
    measured = np.stack(list(run.columns.values()), axis=1)
    # signs of quaternions; not all components need to be measured
    bodies = np.array([column.quaternion_body for column in columns])
    for body in np.unique(bodies[bodies >= 0]):
        components = bodies == body
        products = np.sum(values[:, components] * measured[:, components], axis=1)
        signs = np.where(products < 0.0, -1.0, 1.0)
        values[:, components] *= signs[:, None]
        derivatives[:, components] *= signs[:, None, None]
    # residuals without full revolutions of angles
    residuals = values - measured
    is_angle = np.array([column.unit == "rad" for column in columns])
    residuals[:, is_angle] -= 2.0 * np.pi * np.round(residuals[:, is_angle] / (2.0 * np.pi))
    return residuals, derivatives
