"""Residuals (computed minus measured motion), and their derivatives with respect to parameters of a scene.

`Residuals` simulates the measured runs with given parameter values and compares the results with the measured
columns, such as "coordinate.hinge", "rate.hinge" or "reaction_force.hinge.x". It also finds columns that are
likely wrong: in degrees, worse than a constant, or in contradiction to the start of the run.
"""

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
from newton_euler.analysis.sensitivity.tangent_run import TangentResults, TangentRun
from newton_euler.analysis.sensitivity.tangent_starts import Starts
from newton_euler.compiled.equations import CACHED_SCENES
from newton_euler.equations.undetermined import is_undetermined, redundancy_text, undetermined_joints
from newton_euler.errors import MechanismError, NewtonEulerError, UnknownNameError
from newton_euler.integrators.options import FormulationName, Options
from newton_euler.model.joint import Key
from newton_euler.model.scene import OUTPUTS, Scene
from newton_euler.model.source_file import SourceError
from newton_euler.model.trajectory import QUANTITIES
from newton_euler.runs.assemble import initial_state
from newton_euler.scalars import Array, Floats

REACTIONS = "reaction_force", "reaction_torque"
"""Outputs that are not unique if constraints are redundant."""

AXIS_NAMES = "x", "y", "z"
"""Suffixes of the names of columns with components along the world's axes."""

MAX_DEGREES_RESIDUAL = 0.1
"""Largest residual of an angle after conversion from degrees, divided by the residual before, for which the
measured numbers count as degrees. Without other errors the ratio is 1 / 57.3."""

MAX_EXPLAINED = 0.5
"""Largest residual of an angle, divided by the angle, for which the scene explains the measured motion. A
scene that stays at rest leaves a ratio of 1."""

WORSE_THAN_CONSTANT = 1.5
"""Residual of a column, divided by the column's standard deviation, above which a constant fits better than
the scene. The threshold exceeds 1, the ratio of the best constant."""

CONSTANT_STD = 1e-9
"""Smallest standard deviation of a column, as a fraction of (1 + largest number), SI. A column with less
counts as constant."""

CONTRADICTION_STD = 6.0
"""Distance of a measured first row from the start of the run, in standard deviations of the noise, that is no
coincidence: its probability is 1e-9."""


RATE_SAMPLES = 1000
"""Number of parts of a run, up to the last measured time, in which mean rates of joints are computed."""


class ResidualValues(NamedTuple):
    """Residuals and their derivatives with respect to p parameters, SI.

    Attributes:
        residuals: (n,) computed minus measured.
        jacobian: (n, p).
    """

    residuals: Array
    jacobian: Array


class AngleFit(NamedTuple):
    """Root mean squares of a measured column with unit rad or rad/s, to test whether it is in degrees.

    Attributes:
        residual: root mean square of the residuals.
        as_degrees: the same if the measured numbers are converted from degrees.
        size: root mean square of the measured numbers converted from degrees; for angles at most 1, because
            residuals are within half a revolution.
    """

    residual: float
    as_degrees: float
    size: float


class Residuals:
    """Residuals of n measured numbers as a function of p parameters of a scene.

    The n numbers are ordered run by run, and within a run column by column.

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
            scene, names: the scene and the names of its p parameters.
            runs: measurements by the name of their file or run; the names are used in messages.
            formulation, options: formulation and step control of the simulated runs.

        Raises:
            SourceError: for an unknown column, a column that is not unique, or a wrong unit.
        """
        self.runs, self.evaluations, self._options = list(runs.values()), 0, options
        # beginnings of messages: the name of the run if there are several
        self._prefixes = [f"{where}: " * (len(runs) > 1) for where in runs]
        # code with the outputs that the measured columns need
        kinds = {name.split(".")[0] for run in self.runs for name in run.columns}
        outputs = {QUANTITIES[kind].output for kind in kinds if kind in QUANTITIES}
        outputs |= {"velocities"} if "rate" in kinds else set()
        self.code = code = tangent_code(_with_outputs(scene, frozenset(outputs)), names, formulation)
        # places of the columns in the results, and in the derivatives of the results, which compiled programs
        # compute: "coordinates", or "output" for other quantities. ALONG ends the names of programs that also
        # return derivatives
        layouts = (code.function(name).layout for name in ("output", "output" + ALONG))
        places = [column_places(scene.mechanism, layout) for layout in layouts]
        self._columns = [_columns(scene, where, run, places) for where, run in runs.items()]
        # for each run: function for the start, and function that simulates with derivatives
        self._models = []
        for run, columns in zip(self.runs, self._columns, strict=True):
            programs = sorted({column.program for column in columns})
            self._models.append((Starts(code, names, run.start), TangentRun(code, options, programs)))
        # parameter values of the last evaluation, as bytes, and its result
        self._last: tuple[bytes, ResidualValues] | None = None

    def __call__(self, values: Array) -> ResidualValues:
        """Compute residuals for parameter values (p,), SI; the last result is stored and reused.

        Raises:
            NewtonEulerError: for invalid values, and for runs that stop.
        """
        if self._last is None or self._last[0] != values.tobytes():
            self.evaluations += 1
            by_run = [self._of_run(k, values) for k in range(len(self.runs))]
            all_runs = ResidualValues(*(np.concatenate(arrays) for arrays in zip(*by_run, strict=True)))
            self._last = values.tobytes(), all_runs
        return self._last[1]

    def _of_run(self, k: int, values: Array) -> ResidualValues:
        """Simulate run k with parameter values (p,), and compare the result with the measurements."""
        run, columns, (starts, simulate) = self.runs[k], self._columns[k], self._models[k]
        # x has the initial state and the parameters, directions (inputs, p) are its derivatives
        x, directions = starts(values)
        computed, derivatives = _selected(simulate(x, directions, run.time), columns)
        residuals, jacobian = compared(computed, derivatives, run, columns)
        if not (np.isfinite(residuals).all() and np.isfinite(jacobian).all()):
            raise MechanismError("measurements", "have no finite derivatives", "other columns")
        return ResidualValues(residuals.T.ravel(), jacobian.swapaxes(0, 1).reshape(residuals.size, -1))

    def can_start(self, values: Array) -> bool:
        """Return True if parameter values (p,) are valid for the scene and for the starts of all runs."""
        try:
            for starts, _ in self._models:
                starts(values)
        except NewtonEulerError:
            return False
        return True

    def joint_rates(self, values: Array) -> dict[Key, Array]:
        """Simulate all runs with parameter values (p,), and compute rates of joint coordinates, SI.

        Returns:
            (k,) for each joint coordinate: mean rates in `RATE_SAMPLES` parts of equal length of each run.
        """
        mechanism, parts = self.code.scene.mechanism, []
        keys = list(mechanism.coordinate_labels)
        for run, (starts, _) in zip(self.runs, self._models, strict=True):
            times = np.linspace(0.0, run.time[-1], 1 + RATE_SAMPLES)
            found = TangentRun(self.code, self._options, ["coordinates"])(*starts(values), times)
            # the program returns coordinates, their rates, and the derivatives of both
            changes = np.diff(found.derivatives["coordinates"][:, : len(keys), 0], axis=0)
            is_angle = [not mechanism.is_slide(*key) for key in keys]
            changes[:, is_angle] -= 2.0 * np.pi * np.round(changes[:, is_angle] / (2.0 * np.pi))
            parts.append(changes / times[1])
        return dict(zip(keys, np.concatenate(parts).T, strict=True))

    def by_column(self, numbers: Array) -> tuple[dict[str, Floats], ...]:
        """Split numbers (n,) into columns: for each run, the numbers of each column by name."""
        sizes = [run.time.size for run in self.runs for _ in run.columns]
        columns = iter(np.split(numbers, np.cumsum(sizes)[:-1]))
        return tuple({name: next(columns) for name in run.columns} for run in self.runs)

    def like_degrees(self, residuals: Array) -> set[str]:
        """Return the names of columns whose residuals nearly vanish if their numbers are degrees."""
        return {
            name
            for name, angle in self._angles(residuals)
            if angle.as_degrees < min(MAX_DEGREES_RESIDUAL * angle.residual, MAX_EXPLAINED * angle.size)
        }

    def unexplained(self, residuals: Array) -> set[str]:
        """Return the names of columns of rad or rad/s whose motion the scene does not explain."""
        return {
            name for name, angle in self._angles(residuals) if angle.residual > MAX_EXPLAINED * angle.size
        }

    def unlike(self, residuals: Array) -> tuple[str, ...]:
        """Return the names of columns without given noise that a constant fits better than the scene."""
        names: dict[str, None] = {}  # an ordered set: several runs may have a column of this name
        for run, by_name in zip(self.runs, self.by_column(residuals), strict=True):
            for name, measured in run.columns.items():
                deviation = max(np.std(measured), CONSTANT_STD * (1.0 + np.abs(measured).max()))
                if name not in run.noise and _rms(by_name[name]) > WORSE_THAN_CONSTANT * deviation:
                    names[name] = None
        return tuple(names)

    def contradiction(self, values: Array) -> str:
        """Describe the measured coordinate or rate that contradicts the start of its run most.

        Only initial coordinates and rates that no parameter moves are compared, relative to their noise. The
        text is empty if all deviations are below `CONTRADICTION_STD`.

        Args:
            values: (p,) values of the parameters.
        """
        # deviation of each measured initial coordinate, in standard deviations, by a line of text
        evaluated, deviations = self(values), dict[str, float]()
        largest_derivatives = self.by_column(np.abs(evaluated.jacobian).max(axis=1))
        for k, residuals in enumerate(self.by_column(evaluated.residuals)):
            run = self.runs[k]
            for (name, measured), column in zip(run.columns.items(), self._columns[k], strict=True):
                initial = initial_name(name)
                # skip other columns, runs measured from a later time, and starts that a parameter moves
                if not initial or run.time[0] > 0.0 or largest_derivatives[k][name][0] > 0.0:
                    continue
                start, first = measured[0] + residuals[name][0], measured[0]
                if column.unit == "rad":
                    start -= 2.0 * np.pi * np.round(start / (2.0 * np.pi))
                line = (
                    f"{name} starts at {start:.6g} {column.unit}, held, but is {first:.6g} in the first row"
                )
                # the line "start" of the file has the initial coordinates, which are held: no parameter
                # moves them
                advice = "is the line start right?" if initial in run.start else f"fit {initial}?"
                noise = run.noise.get(name, _estimated_noise(measured))
                deviations[f"{self._prefixes[k]}{line}: {advice}"] = abs(residuals[name][0]) / noise
        worst = max(deviations, key=lambda line: deviations[line], default="")
        return worst if worst and deviations[worst] > CONTRADICTION_STD else ""

    def _angles(self, residuals: Array) -> Iterator[tuple[str, AngleFit]]:
        """Yield names of columns of rad or rad/s, for each run, with a test whether they are in degrees."""
        for run, columns, by_name in zip(self.runs, self._columns, self.by_column(residuals), strict=True):
            for (name, measured), column in zip(run.columns.items(), columns, strict=True):
                if column.unit not in ("rad", "rad/s"):
                    continue
                # residuals if the measured numbers are converted from degrees
                converted = np.deg2rad(measured)
                as_degrees, size = by_name[name] + measured - converted, _rms(converted)
                if column.unit == "rad":
                    as_degrees -= 2.0 * np.pi * np.round(as_degrees / (2.0 * np.pi))
                    size = min(size, 1.0)
                yield name, AngleFit(_rms(by_name[name]), _rms(as_degrees), size)


@lru_cache(maxsize=CACHED_SCENES)
def _with_outputs(scene: Scene, wanted: frozenset[str | None]) -> Scene:
    """Return the scene with other outputs; the same object each time, so that its compiled code is reused."""
    return replace(scene, outputs=frozenset(output for output in OUTPUTS if output in wanted))


def _estimated_noise(measured: Array) -> float:
    """Estimate the noise of a column (n,) from its fourth differences, which smooth motion barely changes."""
    if len(measured) < 5:
        return np.inf
    # squares of the binomial coefficients 1, 4, 6, 4, 1 add up to 70
    return max(_rms(np.diff(measured, 4)) / 70.0**0.5, CONSTANT_STD * (1.0 + float(np.abs(measured).max())))


def _rms(values: Array) -> float:
    """Return the root mean square."""
    return float(np.sqrt(np.mean(values**2)))


def _selected(run: TangentResults, columns: list[Column]) -> tuple[Array, Array]:
    """Return the m computed columns (n, m) of a simulated run and their derivatives (n, m, p)."""
    values, derivatives = [], []
    for column in columns:
        results = run.derivatives[column.program]
        if column.program == "coordinates":
            # this program returns the coordinates (the same for each parameter), then their derivatives
            count = results.shape[1] // 2
            values.append(results[:, column.value_place, 0])
            derivatives.append(results[:, count + column.derivative_place])
        else:
            values.append(run.results[:, column.value_place])
            derivatives.append(results[:, column.derivative_place])
    return np.stack(values, axis=1), np.stack(derivatives, axis=1)


def _columns(scene: Scene, where: str, run: Measurements, places: Sequence[Places]) -> list[Column]:
    """Find the computed quantity of each measured column of a run.

    Args:
        scene: scene of the run.
        where: name of the run, for messages.
        run: the measurements.
        places: places of all columns in the results, and in the derivatives.

    Raises:
        SourceError: for a column that cannot be compared.
    """
    columns = []
    for name in run.columns:
        if reason := _not_unique(scene, name):
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


def _not_unique(scene: Scene, name: str) -> str:
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
