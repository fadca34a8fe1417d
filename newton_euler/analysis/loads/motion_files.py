"""Force and motion of actuators in CSV files, which any tool can write: `read_motions`, `motions_csv`.

The column `time` has s. The other columns have the name of an actuator, a point and a quantity: `force`,
`position` and `speed` of a slide in N, m and m/s, or `torque`, `angle` and `rate` of a hinge in N m, rad and
rad/s. The last one of each is optional. If there is one actuator, its name and the point may be missing.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from newton_euler.analysis.loads.actuator_motions import ActuatorMotion
from newton_euler.errors import listed, quoted
from newton_euler.model.source_file import (
    MAX_MODEL_NUMBER,
    SourceError,
    TimeTable,
    check_names,
    csv_rows,
    read_text,
)

SLIDE, HINGE = ("force", "position", "speed"), ("torque", "angle", "rate")
"""Quantities of a slide and of a hinge: force, coordinate, and rate of the coordinate."""

NEEDED = "time, NAME.force and NAME.position of each slide, NAME.torque and NAME.angle of each hinge"
"""Description of the columns for error messages."""

UNNAMED = "actuator"
"""Name of the actuator whose columns have none."""


def is_motion_file(source: str) -> bool:
    """Return True if the name of a scene or file is that of a CSV."""
    return Path(source).suffix.lower() == ".csv"


def read_motions(path: str) -> tuple[ActuatorMotion, ...]:
    """Read the motions of actuators from a CSV.

    A speed that is missing is the derivative of the position, by central differences.

    Raises:
        SourceError: naming the file and the line or column at fault.
    """
    rows = csv_rows(path, read_text(path, limit="csv_size"), comments=True)
    if not rows or "time" not in rows[0].cells:
        raise SourceError(path, f"has no column time; needed: {NEEDED}")
    header = rows[0].cells
    check_names(path, header, rows[0].line)
    if len(rows) < 3:
        raise SourceError(path, f"has {len(rows) - 1} rows; needed: 2 times or more")
    table = TimeTable.of(path, header, rows[1:])
    for name, values in table.columns.items():
        needed = f"a number up to {MAX_MODEL_NUMBER:g}"
        table.refuse(np.abs(values) > MAX_MODEL_NUMBER, name, values, needed)
    # the quantities of each actuator
    quantities: dict[str, list[str]] = {}
    for column in header:
        if column != "time":
            actuator, _, quantity = column.rpartition(".")
            if quantity not in (*SLIDE, *HINGE):
                raise SourceError(path, f"line {rows[0].line}: column {quoted(column)}; needed: {NEEDED}")
            quantities.setdefault(actuator, []).append(quantity)
    if not quantities:
        raise SourceError(path, f"has no actuators; needed: {NEEDED}")
    return tuple(_motion(path, table, actuator, names) for actuator, names in quantities.items())


def _motion(path: str, table: TimeTable, actuator: str, names: Sequence[str]) -> ActuatorMotion:
    """Take the motion of an actuator, with columns of some quantities, from a table."""
    kind = next((kind for kind in (SLIDE, HINGE) if {*kind[:2]} <= {*names} <= {*kind}), None)
    if kind is None:
        found = listed(names)
        raise SourceError(path, f"actuator {quoted(actuator or UNNAMED)} has {found}; needed: {NEEDED}")
    prefix = f"{actuator}." if actuator else ""
    columns = [table.columns.get(f"{prefix}{quantity}") for quantity in kind]
    force, position, speed = columns
    assert force is not None
    assert position is not None
    time = table.columns["time"]
    if speed is None:
        speed = np.gradient(position, time)
    return ActuatorMotion(actuator or UNNAMED, kind is SLIDE, time, force, position, speed)


def motions_csv(motions: Sequence[ActuatorMotion]) -> str:
    """Return the motions of actuators, all with the same times, as a CSV that `read_motions` reads."""
    columns = {"time": motions[0].time}
    for motion in motions:
        kind = SLIDE if motion.is_slide else HINGE
        values = (motion.force, motion.position, motion.speed)
        columns |= {f"{motion.name}.{quantity}": each for quantity, each in zip(kind, values, strict=True)}
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows(np.stack(list(columns.values()), axis=1).tolist())
    return text.getvalue()
