"""Fields of result files (JSON) that the pages of `crosscheck report` need, and checks of their values."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from pydantic import BaseModel, field_validator, model_validator

from crosscheck.differences.difference import Difference
from crosscheck.differences.motion import Motion
from crosscheck.differences.shapes import Shapes
from crosscheck.report.table import Report


class CheckTolerance(BaseModel):
    """Tolerance of a check.

    Attributes:
        quantity: compared quantity, with its unit.
        between: one or two names of engines.
        tolerance: in the unit of the quantity.
    """

    quantity: str
    between: list[str]
    tolerance: float | None


class ResultFile(BaseModel):
    """The fields of a result file that a page needs.

    Attributes:
        report: tables and sentences.
        files: SHA-256, by name, of the runs (.npz), recordings (.rrd) and pictures (.png) in the same folder.
        sha256: SHA-256 of all other fields.
    """

    report: Report
    files: dict[str, str]
    sha256: str

    @field_validator("report")
    @classmethod
    def _check_wall_time(cls, report: Report) -> Report:
        """Raise `ValueError` for a wall time that is negative or not finite."""
        if report.wall_time is not None and not 0.0 <= report.wall_time < math.inf:
            raise ValueError("wall_time is no time in seconds")
        return report

    @field_validator("report")
    @classmethod
    def _check_charts(cls, report: Report) -> Report:
        """Raise `ValueError` for a bar or a mark that is not on the axis of its chart."""
        for chart in report.charts:
            for bar in chart.bars:
                if not all(0.0 <= place <= 100.0 for place in (bar.length, bar.mark or 0.0)):
                    raise ValueError(f"bar {bar.label!r:.100} is not from 0 to 100 % of its axis")
        return report

    @field_validator("files")
    @classmethod
    def _check_names(cls, files: dict[str, str]) -> dict[str, str]:
        """Raise `ValueError` for a name that is a path to another folder."""
        for name in files:
            if name != Path(name).name or "\0" in name:
                raise ValueError(f"{name!r:.100} is no name of a file")
        return files


class ErrorOverTime(BaseModel):
    """Errors of a run over time, largest over the bodies.

    Attributes:
        time: output times, s.
        position: errors of the centers of mass, m.
        rotation: errors of the orientations, rad.
    """

    time: list[float]
    position: list[float]
    rotation: list[float]

    @model_validator(mode="after")
    def _check_lengths(self) -> ErrorOverTime:
        """Raise `ValueError` unless there are times, and all lists have a number for each."""
        if {len(self.position), len(self.rotation)} != {len(self.time)}:
            raise ValueError("time, position and rotation are not equally long")
        if not self.time:
            raise ValueError("time is empty")
        return self


class JudgedRun(BaseModel):
    """The fields that a page needs of the judgement of a run: with the settings of a model file, or a log.

    Attributes:
        error_over_time: errors of the run.
        without: the run of the file without elements that act and are not simulated; None if there are none.
    """

    error_over_time: ErrorOverTime
    without: JudgedRun | None = None


class CrosscheckFile(ResultFile):
    """The fields of a crosscheck's result file that a page needs.

    Attributes:
        checks: checks whose tolerances are drawn in the plots.
        own_run: error of the run with the settings of the file, if it was judged.
        logs: errors of logs by name.
    """

    checks: list[CheckTolerance] = []
    own_run: JudgedRun | None = None
    logs: dict[str, JudgedRun] = {}


class DiffFile(ResultFile):
    """The fields that a page needs of the result file of `crosscheck diff`.

    Attributes:
        differences: all rows, true differences first.
        motion: comparison of the motions.
        shapes: bodies of both robots.
    """

    differences: list[Difference]
    motion: Motion
    shapes: Shapes

    @field_validator("shapes")
    @classmethod
    def _check_shapes(cls, shapes: Shapes) -> Shapes:
        """Raise `ValueError` for a number that is not finite and for a parent that is no body before."""
        for bodies in (shapes.first, shapes.second):
            for number, shape in enumerate(bodies):
                values = [*shape.point, *shape.center, *np.ravel(shape.spread), shape.mass]
                if not np.isfinite(values).all():
                    raise ValueError(f"body {number} has a number that is not finite")
                if not -1 <= shape.parent < number:
                    raise ValueError(f"parent of body {number} is no body before it")
        for mark in shapes.marks:
            if mark.row < 0 or not np.isfinite(mark.point).all():
                raise ValueError("a mark has a number that is not finite, or a negative row")
        return shapes
