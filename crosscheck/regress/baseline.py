"""Baseline files of `crosscheck regress`: the stored results that later runs of a scene are compared with.

A scene is a mechanism with its forces, inputs, initial state and duration. A baseline holds quantities of one
scene (masses, accelerations, trajectories, counts of steps) with the tolerance of each, the settings of their
measurement, and the history of its updates. The file is JSON with one quantity per line, so that a version
control system shows which quantity changed. A checksum at its end detects damaged files and lines lost in a
merge.
"""

from __future__ import annotations

import json
import os
from collections import Counter
from collections.abc import Iterable
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    SerializerFunctionWrapHandler,
    field_validator,
    model_serializer,
    model_validator,
)

from crosscheck.engines.engine import Engine
from crosscheck.engines.registry import NAME, RESERVED, SOLVER
from crosscheck.engines.versions import versions
from crosscheck.library.entries import Number, Quaternion, Vector
from crosscheck.support.checksum import with_checksum
from crosscheck.support.errors import CrosscheckError
from crosscheck.support.results import read_json
from newton_euler.errors import choices
from newton_euler.model.state import State
from newton_euler.scalars import Array

FIXED_GROUPS = ("model", "relative", "cartesian", "integrators", "own_run")
"""Names of the groups that are not engines."""


def _known_group(name: str) -> str:
    """Return the name of a group; raises `ValueError` for a name that no engine can have."""
    is_engine = NAME.fullmatch(name) and name not in {*RESERVED, SOLVER.name}
    if not is_engine and name not in FIXED_GROUPS:
        raise ValueError(f"{name!r} is no group; {choices(name, FIXED_GROUPS)}, or an engine")
    return name


GroupName = Annotated[str, AfterValidator(_known_group)]
"""Name of a group of quantities that are measured together, see `crosscheck.regress.measure`.

"model" has properties of the scene, such as masses. "relative" (joint coordinates) and "cartesian" (poses of
bodies) are the formulations of newton_euler, crosscheck's solver; "integrators" are its integrators other
than the default one. Other engines have a group of their name; they need not be installed."""

OPERATIONS_PREFIX = "operations of "
"""Start of the names of quantities that count arithmetic operations of compiled code."""

COUNT_SUFFIXES = (": steps", ": evaluations")
"""Ends of the names of quantities that count the work of an integrator."""

FILE_FORMAT = 4
"""Version of the file format that `read_baseline` accepts and `Baseline.text` writes."""

OWN_RUN_GROUP: GroupName = "own_run"
"""Group of the errors of the run that a model file's own engine makes with the settings of the file."""


class _Strict(BaseModel):
    """Base of all parts of a baseline file: a field that the class does not know is an error."""

    model_config = ConfigDict(extra="forbid")


class StoredQuantity(_Strict):
    """One measured quantity: a table of numbers in SI units, vectors in the world frame.

    Attributes:
        group: group of the quantity; a baseline has all quantities of a group, or none.
        name: name of the quantity, unique within its group, such as "start: reaction force".
        unit: unit of all numbers; empty for counts and ratios.
        rows, columns: labels of the table: names of bodies or joints, times, or components of vectors. A
            single number has one row and one column, whose labels are empty.
        value: (rows, columns) numbers.
        tolerance: (rows,) largest allowed change of the numbers of each row, in `unit`.
        reason: where the tolerance comes from; the file has no such field if it is empty, as for quantities
            whose tolerance is round-off and integration error.
    """

    group: GroupName
    name: str
    unit: str
    rows: list[str]
    columns: list[str]
    value: list[list[Number]]
    tolerance: list[Annotated[float, Field(ge=0.0, allow_inf_nan=False)]]
    reason: str = ""

    @model_serializer(mode="wrap")
    def _omit_empty_reason(self, serialize: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """Return the content of the file, without `reason` if it is empty."""
        content: dict[str, Any] = serialize(self)
        return content if self.reason else {name: content[name] for name in content if name != "reason"}

    @model_validator(mode="after")
    def _check_shape(self) -> StoredQuantity:
        """Refuse a table whose numbers do not match its labels."""
        if len(self.value) != len(self.rows) or any(len(row) != len(self.columns) for row in self.value):
            raise ValueError(f"value is not a table of {len(self.rows)} x {len(self.columns)} numbers")
        if len(self.tolerance) != len(self.rows):
            raise ValueError(f"tolerance has {len(self.tolerance)} numbers for {len(self.rows)} rows")
        return self

    @property
    def array(self) -> Array:
        """(rows, columns) numbers of the table."""
        return np.array(self.value, dtype=float).reshape(len(self.rows), len(self.columns))

    @property
    def over_time(self) -> bool:
        """True if the rows are times of a run, along which integration errors grow."""
        return self.name.endswith("over time")

    @property
    def is_cost(self) -> bool:
        """True for counts of operations, steps or evaluations: they may fall but not grow."""
        return self.name.startswith(OPERATIONS_PREFIX) or self.name.endswith(COUNT_SUFFIXES)

    @property
    def is_error(self) -> bool:
        """True for errors of the run with the settings of the file: they may fall but not grow."""
        return self.group == OWN_RUN_GROUP


class StoredState(_Strict):
    """State of all bodies of a mechanism in JSON, see `newton_euler.model.state.State`.

    Attributes:
        position: m, centers of mass in the world frame; body 0 is the ground.
        quaternion: (w, x, y, z), orientations.
        linear_velocity: m/s, in the world frame.
        angular_velocity: rad/s, in the world frame.
        angles: joint angles whose full revolutions count (for springs, for example) but do not show in poses:
            triples (joint name, number of its coordinate, angle in rad). The file has no such field if the
            list is empty.
    """

    position: list[Vector]
    quaternion: list[Quaternion]
    linear_velocity: list[Vector]
    angular_velocity: list[Vector]
    angles: list[tuple[str, int, Number]] = []

    @model_serializer(mode="wrap")
    def _omit_empty_angles(self, serialize: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """Return the content of the file, without `angles` if there are none."""
        content: dict[str, Any] = serialize(self)
        return content if self.angles else {name: content[name] for name in content if name != "angles"}

    @property
    def _arrays(self) -> dict[str, list[Any]]:
        """The four fields with one entry per body, by name."""
        return {name: getattr(self, name) for name in type(self).model_fields if name != "angles"}

    @model_validator(mode="after")
    def _check_count(self) -> StoredState:
        """Refuse fields that have different numbers of bodies."""
        if len({len(array) for array in self._arrays.values()}) > 1:
            raise ValueError("position, quaternion and velocities are of different numbers of bodies")
        return self

    @classmethod
    def of(cls, state: State) -> StoredState:
        """Convert a state to its form in JSON."""
        arrays = (array.tolist() for array in state.arrays)
        names = ("position", "quaternion", "linear_velocity", "angular_velocity")
        angles = [(*key, float(angle)) for key, angle in state.angles.items()]
        return cls(**dict(zip(names, arrays, strict=True)), angles=angles)

    def state(self) -> State:
        """Convert the form in JSON to a state."""
        angles = {(joint, number): angle for joint, number, angle in self.angles}
        arrays = {name: np.array(array, dtype=float) for name, array in self._arrays.items()}
        return State(**arrays, angles=angles)


class MeasurementPlan(_Strict):
    """Settings with which all quantities of a scene are measured.

    The settings are chosen once, for the baseline. Every comparison measures with the same settings.

    Attributes:
        rtol: relative tolerances of runs with error control: by formulation of newton_euler, for its default
            integrator, and for "Radau", the only other integrator with error control.
        step: s, step of runs with fixed steps.
        time: s, time of `state`.
        state: a state of the scene's own run at which all bodies that can move do move.
        own_run_until: s, times at which the comparison of the "own run" (with the settings of the model file)
            and the reference ends for each of `Mechanism.connected_bodies`, because its motion is chaotic or
            unstable; None for the whole run. Empty if no mechanism is chaotic, then the baseline has no such
            field.
    """

    rtol: dict[str, Annotated[float, Field(gt=0.0, lt=0.1)]]
    step: Annotated[float, Field(gt=0.0, allow_inf_nan=False)]
    time: Annotated[float, Field(ge=0.0, allow_inf_nan=False)]
    state: StoredState
    own_run_until: tuple[Annotated[float, Field(gt=0.0, allow_inf_nan=False)] | None, ...] = ()

    @model_serializer(mode="wrap")
    def _omit_unset_end(self, serialize: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """Return the content of the file, without `own_run_until` if it is empty."""
        content: dict[str, Any] = serialize(self)
        if not self.own_run_until:
            del content["own_run_until"]
        return content

    def tighter(self, factor: float) -> MeasurementPlan:
        """Return the plan with all relative tolerances multiplied by a factor."""
        return self.model_copy(update={"rtol": {name: factor * rtol for name, rtol in self.rtol.items()}})


class UpdateRecord(_Strict):
    """Entry of a baseline's history: one creation or update of the baseline.

    Attributes:
        date: such as "2026-01-31", in UTC.
        reason: why the baseline was updated, as the user wrote it.
        versions: versions of Python and of the packages that measured, by name.
    """

    date: str
    reason: Annotated[str, Field(min_length=1)]
    versions: dict[str, str]

    @classmethod
    def now(cls, reason: str, engines: Iterable[Engine]) -> UpdateRecord:
        """Return the record of an update today with the installed versions, also those of engines."""
        return cls(date=datetime.now(UTC).strftime("%Y-%m-%d"), reason=reason, versions=versions(engines))


class Baseline(_Strict):
    """Stored quantities of one scene, and how they were measured.

    Attributes:
        format: version of the file format, `FILE_FORMAT`.
        scene: name of the scene.
        options: options that the scene was loaded with, by name, as given on the command line.
        unsimulated: a line of text for each element of a model file (such as a contact or a joint limit) that
            no quantity covers because the element is not simulated; None for a scene that is not read from a
            model file.
        history: all updates of the baseline, the last one last.
        plan: settings of the measurement.
        left_out: groups without quantities, and the reason for each.
        quantities: all measured quantities, in the order of their groups.
        sha256: checksum of all other fields; empty until `text` is called.
    """

    format: int = FILE_FORMAT
    scene: str
    options: dict[str, str]
    unsimulated: list[str] | None = None
    history: Annotated[list[UpdateRecord], Field(min_length=1)]
    plan: MeasurementPlan
    left_out: dict[GroupName, str]
    quantities: Annotated[list[StoredQuantity], Field(min_length=1)]
    sha256: str = ""

    @field_validator("format")
    @classmethod
    def _check_format(cls, number: int) -> int:
        """Refuse files of another format."""
        if number != FILE_FORMAT:
            remedy = "delete the file and create it with --update REASON"
            raise ValueError(f"another version of crosscheck wrote the file; needed: {FILE_FORMAT}; {remedy}")
        return number

    @model_validator(mode="after")
    def _check_names(self) -> Baseline:
        """Refuse a group with two quantities of one name."""
        names = Counter((quantity.group, quantity.name) for quantity in self.quantities)
        for (group, name), count in names.items():
            if count > 1:
                raise ValueError(f"quantities: {name!r} of group {group!r} is given twice")
        return self

    @property
    def last_update(self) -> UpdateRecord:
        """Date, reason and versions of the update that measured the quantities."""
        return self.history[-1]

    @property
    def groups(self) -> list[GroupName]:
        """Groups that have quantities, in the order of the file."""
        return list(dict.fromkeys(quantity.group for quantity in self.quantities))

    @property
    def engines(self) -> list[str]:
        """Names of the engines besides newton_euler, also of those without quantities."""
        groups = dict.fromkeys([*self.groups, *self.left_out])
        return [group for group in groups if group not in FIXED_GROUPS]

    def find(self, group: str, name: str) -> StoredQuantity | None:
        """Return the quantity with a name in a group; None if the baseline has no such quantity."""
        matching = (each for each in self.quantities if (each.group, each.name) == (group, name))
        return next(matching, None)

    def text(self) -> str:
        """Format the JSON file: a line per field, and a line per entry of `unsimulated` and `quantities`."""
        parts = []
        for key, value in with_checksum(self.model_dump(mode="json")).items():
            text = json.dumps(value, allow_nan=False)
            if key in ("unsimulated", "quantities") and value:
                text = ",\n".join(f"  {json.dumps(entry, allow_nan=False)}" for entry in value)
                text = f"[\n{text}\n ]"
            parts.append(f" {json.dumps(key)}: {text}")
        return "{\n" + ",\n".join(parts) + "\n}\n"


def read_baseline(path: Path) -> Baseline:
    """Read a baseline file.

    Raises:
        CrosscheckError: if the file is missing, damaged or of another format; the message names the field.
    """
    if not os.path.lexists(path):
        raise CrosscheckError(f"no baseline {path}; create it with --update REASON")
    remedy = "restore the file, or delete it and create it with --update REASON"
    return read_json(path, Baseline, remedy=remedy)
