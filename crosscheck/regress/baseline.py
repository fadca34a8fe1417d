"""Baselines: what a scene's figures were, how far each may move, and who changed them why.

A file is JSON, one figure a line, so that a change of a baseline can be read line by line. A checksum ends
the file: a damaged tolerance or a figure that was lost in a merge would otherwise never be noticed.
"""

from __future__ import annotations

import json
import os
from collections import Counter
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    SerializerFunctionWrapHandler,
    field_validator,
    model_serializer,
    model_validator,
)

from crosscheck.library.entries import Number, Quaternion, Vector
from crosscheck.support.checksum import with_checksum
from crosscheck.support.errors import CrosscheckError
from crosscheck.support.results import read_json
from crosscheck.support.versions import versions
from newton_euler.model.state import State
from newton_euler.scalars import Array

GroupName = Literal["model", "relative", "cartesian", "integrators", "mujoco", "pinocchio"]
"""Name of a group of key figures, see `crosscheck.regress.measure.GROUPS`."""

OPERATIONS = "operations of "
"""Start of the names of checks that count arithmetic operations of compiled code."""

COUNTED = (": steps", ": evaluations")
"""Ends of the names of checks that count the work of an integrator."""


FORMAT = 3
"""Format number of the files that this version writes and reads."""


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid")


class StoredFigure(_Strict):
    """One figure: a table of numbers, SI, world frame.

    Attributes:
        group: what measures it; one group fails or succeeds as a whole.
        name, unit: of the quantity.
        rows, columns: names of bodies, joints, times or components; one empty name for a single number.
        value: a row for each of `rows`.
        tolerance: how far the numbers of each row may move.
    """

    group: GroupName
    name: str
    unit: str
    rows: list[str]
    columns: list[str]
    value: list[list[Number]]
    tolerance: list[Annotated[float, Field(ge=0.0, allow_inf_nan=False)]]

    @model_validator(mode="after")
    def _check_shape(self) -> StoredFigure:
        if len(self.value) != len(self.rows) or any(len(row) != len(self.columns) for row in self.value):
            raise ValueError(f"value is not a table of {len(self.rows)} x {len(self.columns)} numbers")
        if len(self.tolerance) != len(self.rows):
            raise ValueError(f"tolerance has {len(self.tolerance)} numbers for {len(self.rows)} rows")
        return self

    @property
    def array(self) -> Array:
        """(rows, columns)."""
        return np.array(self.value, dtype=float).reshape(len(self.rows), len(self.columns))

    @property
    def over_time(self) -> bool:
        """True if rows are times, along which errors grow; otherwise all rows have one error."""
        return self.name.endswith("over time")

    @property
    def is_cost(self) -> bool:
        """True if the number is a cost (operations, steps, evaluations), which may fall but not grow."""
        return self.name.startswith(OPERATIONS) or self.name.endswith(COUNTED)


class StoredState(_Strict):
    """A state of all bodies, as `newton_euler.model.state.State`."""

    position: list[Vector]
    quaternion: list[Quaternion]
    linear_velocity: list[Vector]
    angular_velocity: list[Vector]
    angles: list[tuple[str, int, Number]] = []
    """Joints, numbers of their coordinates, and rad with revolutions; files leave an empty list out."""

    @model_serializer(mode="wrap")
    def _content(self, serialize: SerializerFunctionWrapHandler) -> dict[str, Any]:
        found: dict[str, Any] = serialize(self)
        return found if self.angles else {name: found[name] for name in found if name != "angles"}

    @property
    def _arrays(self) -> dict[str, list[Any]]:
        return {name: getattr(self, name) for name in type(self).model_fields if name != "angles"}

    @model_validator(mode="after")
    def _check_count(self) -> StoredState:
        if len({len(array) for array in self._arrays.values()}) > 1:
            raise ValueError("position, quaternion and velocities are of different numbers of bodies")
        return self

    @classmethod
    def of(cls, state: State) -> StoredState:
        arrays = (array.tolist() for array in state.arrays)
        names = ("position", "quaternion", "linear_velocity", "angular_velocity")
        angles = [(*key, float(angle)) for key, angle in state.angles.items()]
        return cls(**dict(zip(names, arrays, strict=True)), angles=angles)

    def state(self) -> State:
        angles = {(joint, number): angle for joint, number, angle in self.angles}
        arrays = {name: np.array(array, dtype=float) for name, array in self._arrays.items()}
        return State(**arrays, angles=angles)


class Plan(_Strict):
    """Settings of the measurement of figures; chosen when the baseline is made, the same ever after.

    Attributes:
        rtol: of the runs in each formulation of newton_euler, and of Radau.
        step: s, of methods with fixed steps.
        time: s, of `state`.
        state: one that the scene passes through, with all that moves moving.
    """

    rtol: dict[str, Annotated[float, Field(gt=0.0, lt=0.1)]]
    step: Annotated[float, Field(gt=0.0, allow_inf_nan=False)]
    time: Annotated[float, Field(ge=0.0, allow_inf_nan=False)]
    state: StoredState

    def tighter(self, factor: float) -> Plan:
        """Return the plan with the tolerances of error control multiplied by a factor."""
        return self.model_copy(update={"rtol": {name: factor * rtol for name, rtol in self.rtol.items()}})


class Record(_Strict):
    """One time that the baseline was made."""

    date: str
    reason: Annotated[str, Field(min_length=1)]
    versions: dict[str, str]

    @classmethod
    def now(cls, reason: str) -> Record:
        return cls(date=datetime.now(UTC).strftime("%Y-%m-%d"), reason=reason, versions=versions())


class Baseline(_Strict):
    """A scene's figures.

    Attributes:
        format: of the file; another number is another meaning of its fields.
        scene: its name.
        options: of the scene, as they were set.
        unsimulated: lines on what of a model file is in no figure.
        history: every time that the file was made; the last made what is in it.
        left_out: groups that have no figures here, and why.
        sha256: of all other fields of the file; empty until the file is written.
    """

    format: int = FORMAT
    scene: str
    options: dict[str, str]
    unsimulated: list[str] | None = None
    history: Annotated[list[Record], Field(min_length=1)]
    plan: Plan
    left_out: dict[GroupName, str]
    figures: Annotated[list[StoredFigure], Field(min_length=1)]
    sha256: str = ""

    @field_validator("format")
    @classmethod
    def _check_format(cls, number: int) -> int:
        if number != FORMAT:
            remedy = "delete the file and make it by --update REASON"
            raise ValueError(f"another version of crosscheck made the file; needed: {FORMAT}; {remedy}")
        return number

    @model_validator(mode="after")
    def _check_names(self) -> Baseline:
        names = Counter((figure.group, figure.name) for figure in self.figures)
        for (group, name), count in names.items():
            if count > 1:
                raise ValueError(f"figure {name!r} of {group!r} is there twice")
        return self

    @property
    def made(self) -> Record:
        """Return when and why the figures were last made."""
        return self.history[-1]

    @property
    def groups(self) -> list[GroupName]:
        """Groups that have figures, in their order."""
        return list(dict.fromkeys(figure.group for figure in self.figures))

    def figure(self, group: str, name: str) -> StoredFigure | None:
        found = (figure for figure in self.figures if (figure.group, figure.name) == (group, name))
        return next(found, None)

    def text(self) -> str:
        """The content of the file: a line for each field, and for each entry of the long ones."""
        parts = []
        for key, value in with_checksum(self.model_dump(mode="json")).items():
            text = json.dumps(value, allow_nan=False)
            if key in ("unsimulated", "figures") and value:
                text = ",\n".join(f"  {json.dumps(entry, allow_nan=False)}" for entry in value)
                text = f"[\n{text}\n ]"
            parts.append(f" {json.dumps(key)}: {text}")
        return "{\n" + ",\n".join(parts) + "\n}\n"


def read(path: Path) -> Baseline:
    """Read a baseline; raises `CrosscheckError` naming the file and the field at fault."""
    if not os.path.lexists(path):
        raise CrosscheckError(f"no baseline {path}; make it by --update REASON")
    return read_json(path, Baseline, "restore the file, or delete it and make it by --update REASON")
