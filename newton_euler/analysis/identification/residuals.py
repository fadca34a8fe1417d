"""Residuals of measured motion, and their derivatives with respect to numbers of a scene."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from newton_euler.analysis.identification.measurements import (
    Column,
    Measurements,
    Places,
    column_of,
    column_places,
    compared,
    initial_name,
)
from newton_euler.analysis.sensitivity.tangent_code import ALONG, tangent_code
from newton_euler.analysis.sensitivity.tangent_run import Followed, FollowedRun
from newton_euler.analysis.sensitivity.tangent_starts import Starts
from newton_euler.compiled.equations import CACHED_SCENES
from newton_euler.equations.undetermined import is_undetermined, redundancy_text, undetermined_joints
from newton_euler.errors import MechanismError, NewtonEulerError, UnknownNameError
from newton_euler.integrators.options import FormulationName, Options
from newton_euler.model.scene import OUTPUTS, Scene
from newton_euler.model.source_file import SourceError
from newton_euler.model.trajectory import QUANTITIES
from newton_euler.runs.assemble import initial_state
from newton_euler.scalars import Array, Floats

REACTIONS = "reaction_force", "reaction_torque"
"""Outputs that are not unique if constraints are redundant."""

AXIS_NAMES = "x", "y", "z"

MAX_DEGREES_RESIDUAL = 0.1
"""Largest residual of an angle after conversion from degrees, divided by the residual before, for which its
numbers are taken as degrees. Without other errors the ratio is 1 / 57.3."""

MAX_EXPLAINED = 0.5
"""Largest residual of an angle, divided by the angle, for which the scene explains its motion. A scene at
rest explains nothing."""

WORSE_THAN_CONSTANT = 1.5
"""Residual of a column, in its standard deviations, from which on a constant fits better than the scene."""

CONSTANT_STD = 1e-9
"""Standard deviation of a constant column, SI, and divided by its largest number."""

CONTRADICTION_STD = 6.0
"""Distance of the first row from the start, in standard deviations of the noise, that is no coincidence: its
probability is 1e-9."""


class ResidualValues(NamedTuple):
    """Residuals (n,), computed minus measured, and their derivatives (n, p)."""

    residuals: Array
    jacobian: Array


class AngleFit(NamedTuple):
    """Root mean squares of a column of rad or rad/s.

    Attributes:
        left: of the residuals.
        as_degrees: of the residuals if the measured numbers are degrees.
        size: of the measured numbers converted from degrees; for angles at most 1, because residuals are
            within half a revolution.
    """

    left: float
    as_degrees: float
    size: float


class Residuals:
    """Residuals of n measured numbers as a function of p numbers of a scene; run by run, column by column.

    Attributes:
        runs: measurements of each run.
        code: compiled scene with derivatives.
        evaluations: number of evaluations of all runs so far.
    """

    def __init__(
        self,
        scene: Scene,
        names: tuple[str, ...],
        runs: Mapping[str, Measurements],
        formulation: FormulationName | None,
        options: Options,
    ) -> None:
        """Compile a scene for its measured runs.

        Args:
            scene, names: the scene and the names of its p numbers.
            runs: measurements by the name of their file or run, for errors.
            formulation, options: of the runs.

        Raises:
            SourceError: for an unknown column, a column that is not unique, or a wrong unit.
        """
        self.runs, self.evaluations = list(runs.values()), 0
        self._where = [f"{where}: " * (len(runs) > 1) for where in runs]
        kinds = {name.split(".")[0] for run in self.runs for name in run.columns}
        wanted = {QUANTITIES[kind].output for kind in kinds if kind in QUANTITIES}
        wanted |= {"velocities"} if "rate" in kinds else set()
        self.code = code = tangent_code(_asking(scene, frozenset(wanted)), names, formulation)
        layouts = (code.function(name).layout for name in ("output", "output" + ALONG))
        places = [column_places(scene.mechanism, layout) for layout in layouts]
        self._columns = [_columns(scene, where, run, places) for where, run in runs.items()]
        self._models = []
        for run, columns in zip(self.runs, self._columns, strict=True):
            programs = sorted({column.program for column in columns})
            self._models.append((Starts(code, names, run.start), FollowedRun(code, options, programs)))
        self._known: tuple[bytes, ResidualValues] | None = None

    def __call__(self, values: Array) -> ResidualValues:
        """Compute residuals for values (p,); the last result is kept."""
        if self._known is None or self._known[0] != values.tobytes():
            self.evaluations += 1
            found = [self._of_run(k, values) for k in range(len(self.runs))]
            together = ResidualValues(*(np.concatenate(parts) for parts in zip(*found, strict=True)))
            self._known = values.tobytes(), together
        return self._known[1]

    def _of_run(self, k: int, values: Array) -> ResidualValues:
        run, columns, (starts, followed) = self.runs[k], self._columns[k], self._models[k]
        x, directions = starts(values)
        computed, derivatives = _selected(followed(x, directions, run.time), columns)
        residuals, jacobian = compared(computed, derivatives, run, columns)
        if not (np.isfinite(residuals).all() and np.isfinite(jacobian).all()):
            raise MechanismError("measurements", "have no finite derivatives", "other columns")
        return ResidualValues(residuals.T.ravel(), jacobian.swapaxes(0, 1).reshape(residuals.size, -1))

    def can_start(self, values: Array) -> bool:
        """True if the scene can have these values (p,) at the starts of all runs."""
        try:
            for starts, _ in self._models:
                starts(values)
        except NewtonEulerError:
            return False
        return True

    def by_column(self, numbers: Array) -> tuple[dict[str, Floats], ...]:
        """Split numbers (n,) by the names of columns, for each run."""
        sizes = [run.time.size for run in self.runs for _ in run.columns]
        parts = iter(np.split(numbers, np.cumsum(sizes)[:-1]))
        return tuple({name: next(parts) for name in run.columns} for run in self.runs)

    def like_degrees(self, residuals: Array) -> set[str]:
        """Return the names of columns whose residuals nearly vanish if their numbers are degrees."""
        return {
            name
            for name, angle in self._angles(residuals)
            if angle.as_degrees < min(MAX_DEGREES_RESIDUAL * angle.left, MAX_EXPLAINED * angle.size)
        }

    def unexplained(self, residuals: Array) -> set[str]:
        """Return the names of columns of rad or rad/s whose motion the scene does not explain."""
        return {name for name, angle in self._angles(residuals) if angle.left > MAX_EXPLAINED * angle.size}

    def unlike(self, residuals: Array) -> tuple[str, ...]:
        """Return the names of columns without given noise that a constant fits better than the scene."""
        found = {
            name: None
            for run, left in zip(self.runs, self.by_column(residuals), strict=True)
            for name, column in run.columns.items()
            if name not in run.noise
            and _rms(left[name])
            > WORSE_THAN_CONSTANT * max(np.std(column), CONSTANT_STD * (1.0 + np.abs(column).max()))
        }
        return tuple(found)

    def contradiction(self, values: Array) -> str:
        """Describe the measured coordinate or rate that contradicts the start most, relative to its noise.

        Only initial coordinates that no parameter moves are compared. Empty if all are nearer than
        `CONTRADICTION_STD`.

        Args:
            values: (p,) of the parameters.
        """
        # initial coordinates in the first row that no parameter moves
        found, away = self(values), dict[str, float]()
        moved = self.by_column(np.abs(found.jacobian).max(axis=1))
        for k, left in enumerate(self.by_column(found.residuals)):
            run = self.runs[k]
            for (name, measured), column in zip(run.columns.items(), self._columns[k], strict=True):
                begun = initial_name(name)
                if not begun or run.time[0] > 0.0 or moved[k][name][0] > 0.0:
                    continue
                own, first = measured[0] + left[name][0], measured[0]
                if column.unit == "rad":
                    own -= 2.0 * np.pi * np.round(own / (2.0 * np.pi))
                line = f"{name} starts at {own:.6g} {column.unit}, held, but is {first:.6g} in the first row"
                mend = "is the line start right?" if begun in run.start else f"fit {begun}?"
                noise = run.noise.get(name, _scatter(measured))
                away[f"{self._where[k]}{line}: {mend}"] = abs(left[name][0]) / noise
        worst = max(away, key=lambda line: away[line], default="")
        return worst if worst and away[worst] > CONTRADICTION_STD else ""

    def _angles(self, residuals: Array) -> Iterator[tuple[str, AngleFit]]:
        """Yield the columns of rad or rad/s of each run with their names."""
        for run, columns, left in zip(self.runs, self._columns, self.by_column(residuals), strict=True):
            for (name, measured), column in zip(run.columns.items(), columns, strict=True):
                if column.unit not in ("rad", "rad/s"):
                    continue
                converted = np.deg2rad(measured)
                as_degrees, size = left[name] + measured - converted, _rms(converted)
                if column.unit == "rad":
                    as_degrees -= 2.0 * np.pi * np.round(as_degrees / (2.0 * np.pi))
                    size = min(size, 1.0)
                yield name, AngleFit(_rms(left[name]), _rms(as_degrees), size)


@lru_cache(maxsize=CACHED_SCENES)
def _asking(scene: Scene, wanted: frozenset[str | None]) -> Scene:
    """Return the scene with other outputs; the same object each time, so that its code is found again."""
    return replace(scene, outputs=frozenset(output for output in OUTPUTS if output in wanted))


def _scatter(measured: Array) -> float:
    """Estimate the noise of a column (n,) from its fourth differences, which smooth motion barely changes."""
    if len(measured) < 5:
        return np.inf
    # squares of the binomial coefficients 1, 4, 6, 4, 1 add up to 70
    return max(_rms(np.diff(measured, 4)) / 70.0**0.5, CONSTANT_STD * (1.0 + float(np.abs(measured).max())))


def _rms(values: Array) -> float:
    """Return the root mean square."""
    return float(np.sqrt(np.mean(values**2)))


def _selected(followed: Followed, columns: list[Column]) -> tuple[Array, Array]:
    """Return the columns (n, m) of a run and their derivatives (n, m, p)."""
    values, derivatives = [], []
    for column in columns:
        along = followed.derivatives[column.program]
        if column.program == "coordinates":
            count = along.shape[1] // 2
            values.append(along[:, column.of_value, 0])
            derivatives.append(along[:, count + column.of_derivative])
        else:
            values.append(followed.results[:, column.of_value])
            derivatives.append(along[:, column.of_derivative])
    return np.stack(values, axis=1), np.stack(derivatives, axis=1)


def _columns(scene: Scene, where: str, run: Measurements, places: Sequence[Places]) -> list[Column]:
    """Find the columns of a run; raises `SourceError` for a column that cannot be compared."""
    columns = []
    for name in run.columns:
        if reason := _undetermined(scene, name):
            raise SourceError(where, f"column {name!r:.100}: {reason}; needed: other columns")
        try:
            column = column_of(scene, name, *places)
        except UnknownNameError as error:
            raise SourceError(where, str(error)) from error
        unit = run.units.get(name, column.unit)
        if unit != column.unit:
            raise SourceError(where, f"column {name!r:.100} is in {unit}; needed: a unit of {column.unit}")
        columns.append(column)
    return columns


def _undetermined(scene: Scene, name: str) -> str:
    """Return the reason why a measured reaction is not unique; empty if it is unique."""
    kind, _, rest = name.partition(".")
    joint, _, axis = rest.rpartition(".")
    if kind not in REACTIONS or joint not in scene.mechanism.joint_names or axis not in AXIS_NAMES:
        return ""
    number = scene.mechanism.joint_index(joint)
    if not is_undetermined(scene)[number, REACTIONS.index(kind), AXIS_NAMES.index(axis)]:
        return ""
    count, joints = undetermined_joints(scene, initial_state(scene))
    return f"reactions of joint {joint!r} are not unique, {redundancy_text(count, ', '.join(joints))}"
