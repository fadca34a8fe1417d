"""Identification: parameters of a scene fitted to measured motion.

The sum of squared residuals, each in units of its noise, is made least by scipy's trust-region method with
the derivatives of `newton_euler.analysis.sensitivity`. With J their Jacobian at the end, the covariance of
the parameters is (J^T J)^-1. Combinations of parameters that the data say nothing about are in the null space
of J; they stay as they were, and are named.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple, Unpack

import numpy as np

from newton_euler.analysis.measurements import (
    Column,
    Measurements,
    column_of,
    column_places,
    compared,
    measurements_from_csv,
)
from newton_euler.analysis.sensitivity import checked_names
from newton_euler.analysis.tangent_run import (
    ALONG,
    Followed,
    FollowedRun,
    Starts,
    components,
    own_numbers,
    tangent_code,
)
from newton_euler.errors import (
    MechanismError,
    NewtonEulerError,
    OptionError,
    UndeterminedWarning,
    check_type,
)
from newton_euler.integrators.compiled import check_formulation
from newton_euler.integrators.options import FormulationName, Options, StepControl
from newton_euler.model.scene import OUTPUTS, OutputName, Scene
from newton_euler.scalars import Array, Floats
from newton_euler.variation import with_parameters

Given = Measurements | str | os.PathLike[str]

WEAK = 1.0
"""Standard deviation of a combination of parameters, as a share of their values, from which on it is not
determined."""

LOST = 1e-7
"""Singular value of the Jacobian, as a share of the largest, below which there are no digits left of it."""

NOTHING = 1e-12
"""Below which a coordinate of a start is round-off, m or rad."""

SIMPLE = 0.02
"""Share by which a factor of a combination may differ from 0, 1 or -1 to be taken for it."""

REFITS = 2
"""Fits after the first one where noise is not known, each with that of the last one's residuals."""

CONVERGED = {"xtol": 1e-9, "ftol": 1e-10, "gtol": 1e-12}
"""Of shares, of the sum of squares, and of its slope."""

SETTLED = 0.1
"""Standard deviations by which a further step would move parameters at most where a fit has converged."""

MOST_EVALUATIONS = 200
"""Of a fit."""

FAR = 1e3
"""Stands for residuals of numbers that make no sense, times those at the beginning."""

OF_OUTPUTS: dict[str, OutputName] = {
    "linear_velocity": "velocities",
    "angular_velocity": "velocities",
    "reaction_force": "reactions",
    "reaction_torque": "reactions",
    "actuator_force": "actuation",
    "kinetic_energy": "energy",
    "potential_energy": "energy",
}
"""What a scene has to ask for so that a column can be computed."""


@dataclass(frozen=True, eq=False)
class Identification:
    """Parameters fitted to measurements, p numbers.

    Attributes:
        scene: with these parameters.
        parameters: their names.
        before, values: (p,) as they were, and as they are fitted.
        covariance: (p, p) of the values; infinite on the diagonal for those that are not determined.
        noise: standard deviations of columns by name, those that were given, or else of the residuals.
        misfit: root of the mean square of all residuals, in units of the noise: about 1 if the scene can move
            as was measured and the noise is known.
        residuals: measured less computed, for each run by column, (n,) each.
        undetermined: a line for each combination of parameters that the data do not determine.
        stopped: why the fit ended before the sum of squares was least; empty if it is.
        evaluations: runs of all measurements, with derivatives.

    Examples:
        >>> scene = load("tracker")
        >>> run = simulate(with_parameters(scene, {"panel_7.mass": 0.95}))
        >>> height = run.position[:, 6, 2] + 1e-5 * np.random.default_rng(0).normal(size=len(run.time))
        >>> measured = Measurements(run.time, {"position.panel_7.z": height}, {"position.panel_7.z": 1e-5})
        >>> def mass(found: Identification) -> float:
        ...     return float(found.values[0])
        >>> print(f"{mass(identify(scene, ['panel_7.mass'], measured)):.2f} kg")
        0.95 kg
    """

    scene: Scene
    parameters: tuple[str, ...]
    before: Floats
    values: Floats
    covariance: Floats
    noise: dict[str, float]
    misfit: float
    residuals: tuple[dict[str, Floats], ...]
    undetermined: tuple[str, ...]
    stopped: str
    evaluations: int

    def __repr__(self) -> str:
        size = f"parameters: {len(self.parameters)}, misfit: {self.misfit:.3g}"
        return f"<Identification of {self.scene.name!r}: {size}, undetermined: {len(self.undetermined)}>"

    @property
    def standard_deviations(self) -> Floats:
        """(p,) of the values; infinite for those that are not determined."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def correlation(self) -> Floats:
        """(p, p) of the values; not a number for those that are not determined."""
        deviations = self.standard_deviations
        with np.errstate(invalid="ignore"):
            return self.covariance / np.outer(deviations, deviations)

    def report(self) -> list[str]:
        """Write a table of parameters, a line each, and what is not determined."""
        rows: list[tuple[str, ...]] = [("parameter", "before", "fitted", "deviation")]
        for k, name in enumerate(self.parameters):
            rows.append((name, *(f"{x[k]:.6g}" for x in (self.before, self.values)), self.deviation(k)))
        widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
        lines = []
        for name, *figures in rows:
            shown = (figure.rjust(width) for figure, width in zip(figures, widths[1:], strict=True))
            lines.append("  ".join([name.ljust(widths[0]), *shown]))
        return [*lines, *self.doubts]

    @property
    def doubts(self) -> list[str]:
        """Lines on what is not determined, and why the fit ended if not at the least sum of squares."""
        return [*self.undetermined, *[self.stopped] * bool(self.stopped)]

    def deviation(self, number: int) -> str:
        """Return the standard deviation of a value as text."""
        deviation = self.standard_deviations[number]
        return f"{deviation:.2g}" if np.isfinite(deviation) else "-"


def identify(
    scene: Scene,
    parameters: Sequence[str],
    measurements: Given | Sequence[Given],
    formulation: FormulationName | None = None,
    **control: Unpack[StepControl],
) -> Identification:
    """Fit parameters of a scene to measured motion, from the scene's own values on.

    Args:
        scene: what was measured.
        parameters: names as of `sensitivities`; all numbers of those that are arrays are fitted.
        measurements: of a run, or of several: CSV files, see `measurements_from_csv`, or `Measurements`.
        formulation: as of `simulate`.
        control: of steps, as of `simulate`.

    Raises:
        NewtonEulerError: for an unknown parameter or column, times beyond the scene, fewer numbers measured
            than are fitted, and runs that cannot go on.

    Warns:
        UndeterminedWarning: naming the combinations of parameters that the data do not determine, and for
            a fit that ended before the sum of squares was least.

    Examples:
        >>> scene = load("slider_crank")
        >>> run = simulate(scene)
        >>> measured = Measurements(run.time, {"coordinate.guide": run.joint("guide").coordinates[:, 0]})
        >>> found = identify(with_parameters(scene, {"slider.mass": 1.8}), ["slider.mass"], measured)
        >>> print(f"{found.values[0]:.4f} kg")
        2.0000 kg
    """
    from scipy.optimize import least_squares

    check_type("scene", scene, Scene)
    check_formulation(formulation)
    names = components(scene, checked_names(parameters))
    runs = _runs(scene, measurements)
    count = sum(len(run.time) * len(run.columns) for run in runs)
    if count < len(names):
        needed = f"at least {len(names)}, one for each that is fitted"
        raise MechanismError("measurements", f"are {count} numbers", needed)
    fit = _Fit(scene, names, runs, formulation, Options.of("DOP853", control))
    before = own_numbers(scene, names)
    before[np.abs(before) < NOTHING] = 0.0
    scale = np.where(before == 0.0, 1.0, np.abs(before))
    shares, known = before / scale, fit.noise_is_known
    for _ in range(1 if known else 1 + REFITS):
        fit.begin(shares, scale)
        solved = least_squares(
            fit.residuals, shares, fit.jacobian, method="trf", max_nfev=MOST_EVALUATIONS, **CONVERGED
        )
        shares = solved.x
        if not known:
            fit.take_noise(shares)
    residuals, jacobian = fit.residuals(shares), fit.jacobian(shares)
    strong, weak = _split(jacobian)
    covariance = strong.T @ strong
    covariance[np.diag_indices(len(names))] += np.where(np.any(np.abs(weak) > SIMPLE, axis=0), np.inf, 0.0)
    stopped = ""
    if np.linalg.norm(strong @ (jacobian.T @ residuals)) > SETTLED:
        stopped = f"residuals are not the least: {fit.refused or f'{solved.nfev} evaluations are over'}"
    undetermined = tuple(_lines(names, before, weak))
    values = shares * scale
    found = Identification(
        scene=with_parameters(scene, dict(zip(names, values.tolist(), strict=True))),
        parameters=names,
        before=before,
        values=values,
        covariance=covariance * np.outer(scale, scale),
        noise=fit.noise,
        misfit=float(np.sqrt(residuals @ residuals / max(1, count - len(names) + len(weak)))),
        residuals=tuple(fit.apart(shares)),
        undetermined=undetermined,
        stopped=stopped,
        evaluations=fit.evaluations,
    )
    if found.doubts:
        warnings.warn(f"scene {scene.name!r}: {'; '.join(found.doubts)}", UndeterminedWarning, stacklevel=2)
    return found


def _runs(scene: Scene, given: Given | Sequence[Given]) -> list[Measurements]:
    """Return the measurements of each run."""
    each = list(given) if isinstance(given, list | tuple) else [given]
    if not each:
        raise OptionError("measurements", given, "those of a run, or of several")
    runs = []
    for one in each:
        run = one if isinstance(one, Measurements) else measurements_from_csv(one)  # type: ignore[arg-type]
        if run.time[-1] > scene.duration * (1.0 + 1e-12):
            problem = f"go on to {run.time[-1]:.9g} s"
            raise MechanismError("measurements", problem, f"times up to the scene's {scene.duration:g} s")
        runs.append(run)
    return runs


class _Evaluated(NamedTuple):
    """All runs at the same numbers: residuals (n, m) of each, and their derivatives (n, m, p)."""

    residuals: list[Array]
    jacobians: list[Array]


class _Fit:
    """Residuals of measurements and their derivatives by p numbers of a scene."""

    def __init__(
        self,
        scene: Scene,
        names: tuple[str, ...],
        runs: list[Measurements],
        formulation: FormulationName | None,
        options: Options,
    ) -> None:
        self._runs, self.evaluations, self.refused = runs, 0, ""
        wanted = {OF_OUTPUTS.get(name.split(".")[0]) for run in runs for name in run.columns}
        asked = replace(scene, outputs=frozenset(output for output in OUTPUTS if output in wanted))
        code = tangent_code(asked, names, formulation)
        layouts = (code.function(name).layout for name in ("output", "output" + ALONG))
        places = [column_places(scene.mechanism, layout) for layout in layouts]
        self._columns = [[column_of(scene, name, *places) for name in run.columns] for run in runs]
        self._models = []
        for run, columns in zip(runs, self._columns, strict=True):
            programs = sorted({column.program for column in columns})
            held = {name: number for name, number in run.start.items() if name not in names}
            self._models.append((Starts(code, names, held), FollowedRun(code, options, programs)))
        self.noise = {name: level for run in runs for name, level in run.noise.items()}
        self.noise_is_known = all(name in run.noise for run in runs for name in run.columns)
        for run in runs:
            for name, column in run.columns.items():
                self.noise.setdefault(name, float(np.std(column)) or 1.0)
        self._known: tuple[bytes, _Evaluated] | None = None
        self._scale, self._far = np.ones(len(names)), np.inf

    def begin(self, shares: Array, scale: Array) -> None:
        """Begin a fit of numbers (p,) that are shares of a scale; raises what their runs raise."""
        self._scale, self._known = scale, None
        self._far = FAR * max(1.0, float(np.abs(self._weighted(self._evaluated(shares).residuals)).max()))

    def take_noise(self, shares: Array) -> None:
        """Take the residuals of each column that has no noise of its own for it."""
        squares: dict[str, list[Array]] = {}
        for run, residuals in zip(self._runs, self._evaluated(shares).residuals, strict=True):
            for name, column in zip(run.columns, residuals.T, strict=True):
                if name not in run.noise:
                    squares.setdefault(name, []).append(column**2)
        for name, found in squares.items():
            least = 1e-12 * max(1.0, self.noise[name])
            self.noise[name] = max(least, float(np.sqrt(np.mean(np.concatenate(found)))))

    def residuals(self, shares: Array) -> Array:
        """Compute all residuals in units of their noise; far ones for numbers that make no sense."""
        try:
            found = self._weighted(self._evaluated(shares).residuals)
        except NewtonEulerError as error:
            self.refused = f"beyond is what the scene cannot be: {str(error).removeprefix('run 0: ')}"
            count = sum(len(run.time) * len(run.columns) for run in self._runs)
            return np.full(count, self._far)
        return found

    def jacobian(self, shares: Array) -> Array:
        """Compute the derivatives of all residuals by the shares."""
        return self._weighted(self._evaluated(shares).jacobians) * self._scale

    def apart(self, shares: Array) -> list[dict[str, Floats]]:
        """Return measured less computed, by column for each run."""
        found = self._evaluated(shares).residuals
        pairs = zip(self._runs, found, strict=True)
        return [dict(zip(run.columns, -each.T, strict=True)) for run, each in pairs]

    def _weighted(self, tables: list[Array]) -> Array:
        parts = []
        for run, table in zip(self._runs, tables, strict=True):
            weights = np.array([1.0 / run.noise.get(name, self.noise[name]) for name in run.columns])
            weighted = table * weights.reshape(-1, *[1] * (table.ndim - 2))
            parts.append(weighted.reshape(table.shape[0] * table.shape[1], *table.shape[2:]))
        return np.concatenate(parts)

    def _evaluated(self, shares: Array) -> _Evaluated:
        """Run all at these shares, computed less measured; that of the last call if they are the same."""
        if self._known is None or self._known[0] != shares.tobytes():
            self.evaluations += 1
            found = _Evaluated([], [])
            for run, columns, (starts, followed) in zip(self._runs, self._columns, self._models, strict=True):
                x, directions = starts(shares * self._scale)
                values, derivatives = _selected(followed(x, directions, run.time), columns)
                residuals, jacobian = compared(values, derivatives, run, columns)
                if not (np.isfinite(residuals).all() and np.isfinite(jacobian).all()):
                    raise MechanismError("measurements", "have no finite derivatives", "other columns")
                found.residuals.append(residuals)
                found.jacobians.append(jacobian)
            self._known = shares.tobytes(), found
        return self._known[1]


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


def _split(jacobian: Array) -> tuple[Array, Array]:
    """Split the space of parameters in what the data determine and what they do not.

    Returns:
        Orthogonal directions of the one, each of the length of its standard deviation, and a basis (d, p) of
        the other with as many zeros as can be had.
    """
    _, values, right = np.linalg.svd(jacobian, full_matrices=False)
    known = (values > LOST * values[0]) & (values * WEAK > 1.0)
    weak = right[~known]
    return right[known] / values[known, None], _sparse_basis(weak) if len(weak) else weak


def _sparse_basis(rows: Array) -> Array:
    """Return a basis of the space of rows (d, p), each of which has a place where all others are 0."""
    from scipy.linalg import qr

    _, _, order = qr(rows, mode="economic", pivoting=True)
    reduced = np.linalg.solve(rows[:, order[: len(rows)]], rows)
    return np.asarray(reduced / np.abs(reduced).max(axis=1)[:, None])


def _lines(names: Sequence[str], before: Array, weak: Array) -> list[str]:
    """Say what the data do not determine."""
    lines = []
    for row in weak:
        parts = [(k, x) for k, x in enumerate(row) if abs(x) > SIMPLE]
        if len(parts) == 1:
            lines.append(f"{names[parts[0][0]]} is not determined")
            continue
        (a, x), (b, y) = parts[:2]
        if len(parts) == 2 and abs(abs(x) - abs(y)) < SIMPLE and before[a] and before[b]:
            sign = "/" if x * y * before[a] * before[b] > 0.0 else "*"
            lines.append(f"only {names[a]} {sign} {names[b]} is determined")
            continue
        changes = []
        for k, x in parts:  # by a hundredth of the largest
            change = f"{x * np.sign(before[k]):+.2g} %" if before[k] else f"{0.01 * x:+.2g}"
            changes.append(f"{names[k]} {change}")
        lines.append(f"not determined: {', '.join(changes)} together change nothing that was measured")
    return lines
