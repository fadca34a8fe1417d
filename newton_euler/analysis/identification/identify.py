"""Identification: fit parameters of a scene to measured motion, with uncertainties.

The fit (`fit.py`) minimizes the sum of squared residuals, each divided by the standard deviation of its noise
(`noise.py`). A column of measurements is one quantity at all measured times, as in a CSV file. The
derivatives of the residuals are parameter sensitivities (`newton_euler.analysis.sensitivity`). With J the
Jacobian of the scaled residuals at the solution, the covariance of the parameters is (J^T J)^-1. Combinations
of parameters in the null space of J are not identifiable. They are reported, and they keep their initial
values unless these are invalid.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Unpack

import numpy as np

from newton_euler.analysis.identification.fit import CONVERGED_STD, Fit
from newton_euler.analysis.identification.friction import frictions_of, sticking
from newton_euler.analysis.identification.measurements import Measurements, measurements_from_csv
from newton_euler.analysis.identification.missing_friction import (
    FitInputs,
    MissingFriction,
    missing_friction,
)
from newton_euler.analysis.identification.noise import MIN_PROBABILITY
from newton_euler.analysis.identification.residuals import Residuals
from newton_euler.analysis.sensitivity.sensitivities import checked_names
from newton_euler.analysis.sensitivity.tangent_run import tangent_options
from newton_euler.analysis.sensitivity.tangent_starts import components
from newton_euler.arguments import caller_level, checked
from newton_euler.compiled.formulations import check_formulation
from newton_euler.errors import (
    IdentificationWarning,
    MechanismError,
    NewtonEulerError,
    OptionError,
    quoted,
)
from newton_euler.integrators.options import FormulationName, StepControl
from newton_euler.model.scene import Scene
from newton_euler.model.source_file import SourceError, path_text
from newton_euler.runs.initial_coordinates import initial_numbers
from newton_euler.runs.variation import with_parameters
from newton_euler.scalars import Array, Floats

Given = Measurements | str | os.PathLike[str]
"""Measurements of one run, or the path of their CSV file."""

FACTOR_TOLERANCE = 0.02
"""Tolerance for describing a combination of parameters: a factor this close to 0 is not shown, and two
factors whose magnitudes differ by less than this fraction count as equal."""

MAX_CURVATURE = 0.2
"""Curvature (`Identification.curvature`) above which confidence ellipsoids are too small. Trials were made
with a four-bar and a solar tracker. The true parameters were outside the 95 % ellipsoid in a tenth of the
trials at this value, and in a third at 2."""


@dataclass(frozen=True, eq=False)
class Identification:
    """Result of `identify`: p parameters fitted to measurements, with uncertainties and warnings.

    Attributes:
        scene: the scene with the fitted parameters. If `point_on_first`, `point_on_second` or `length` of a
            joint is a parameter, this scene has another initial pose, at which its joint coordinates are zero
            (`newton_euler.with_parameters`). Coordinates of the measurements, and of `simulate_batch` with
            the fitted values, are zero at the initial pose of the given scene.
        parameters: names of the parameters.
        units: (p,) SI units; empty for pure numbers.
        before, values: (p,) initial and fitted values.
        covariance: (p, p) of the values. A parameter that is not identifiable has an infinite variance and
            covariances of NaN. A parameter at the edge of valid values has NaN. If the scene is wrong
            (`is_wrong`), all entries are NaN.
        noise: standard deviations of columns by name, for each run; given, or estimated from the residuals.
        misfits: root mean squares of the residuals of columns by name, in units of their noise.
        misfit: root of reduced chi-squared: root of (sum of squared residuals in units of the given noise,
            divided by the expected sum). About 1 if the scene can move as measured. NaN if no noise is
            given, or if there are not more numbers with given noise than the fit needs.
        degrees_of_freedom: degrees of freedom of the misfit as a chi-squared variable. If all noise is given:
            the number of measured numbers minus the number of identifiable combinations of parameters.
        probability: p-value: probability of this misfit or a larger one by chance alone. NaN without a
            misfit.
        residuals: measured minus computed, (n,) by column, for each run.
        unlike: columns without given noise that a constant fits better than the scene.
        in_degrees: columns of rad or rad/s that fit as degrees.
        undetermined: a line for each combination of parameters, and for each noise, that the data do not
            determine.
        at_bound: names of parameters at their smallest allowed values, such as a friction of 0. The residuals
            would be smaller below these values. The other parameters are fitted with these values.
        missing_friction: dry friction that the scene does not have and that would explain the residuals of a
            wrong scene; None if there is none.
        stopped: reason why the fit ended before it converged; empty if it converged.
        curvature: relative change of the derivatives two standard deviations away, root mean square. Above
            0.2 the covariance is valid for single parameters, not for all together.
        contradiction: a line on the coordinate or rate whose first measurement contradicts the start of its
            run, if no parameter moves the start; empty if there is none.
        evaluations: number of times that all runs were simulated, with derivatives.

    Examples:
        >>> scene = load("tracker")
        >>> run = simulate(with_parameters(scene, {"panel_7.mass": 0.95}))
        >>> height = run.position[:, 6, 2] + 1e-5 * np.random.default_rng(0).normal(size=len(run.time))
        >>> measured = Measurements(run.time, {"position.panel_7.z": height}, {"position.panel_7.z": 1e-5})
        >>> found: Identification = identify(scene, ["panel_7.mass"], measured)
        >>> print(found.values.round(2), found.standard_deviations.round(3))  # kg
        [0.95] [0.003]
    """

    scene: Scene
    parameters: tuple[str, ...]
    units: tuple[str, ...]
    before: Floats
    values: Floats
    covariance: Floats
    noise: tuple[dict[str, float], ...]
    misfits: dict[str, float]
    misfit: float
    degrees_of_freedom: float
    probability: float
    residuals: tuple[dict[str, Floats], ...]
    unlike: tuple[str, ...]
    in_degrees: tuple[str, ...]
    undetermined: tuple[str, ...]
    at_bound: tuple[str, ...]
    missing_friction: MissingFriction | None
    stopped: str
    curvature: float
    contradiction: str
    evaluations: int

    def __repr__(self) -> str:
        size = f"parameters: {len(self.parameters)}, misfit: {self.misfit:.3g}"
        return (
            f"<Identification of {quoted(self.scene.name)}: {size}, undetermined: {len(self.undetermined)}>"
        )

    @property
    def standard_deviations(self) -> Floats:
        """(p,) of the values; infinite if not identifiable, NaN at an edge or for a wrong scene."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def correlation(self) -> Floats:
        """(p, p) of the values; NaN where `covariance` is infinite or NaN."""
        deviations = self.standard_deviations
        with np.errstate(invalid="ignore"):
            return self.covariance / np.outer(deviations, deviations)

    def report(self) -> list[str]:
        """Return lines of text: a table of parameters, the misfit, doubts and notes."""
        widths = [max(map(len, column)) for column in zip(*self.table, strict=True)]
        lines = []
        for name, unit, *numbers in self.table:
            aligned = (number.rjust(width) for number, width in zip(numbers, widths[2:], strict=True))
            lines.append("  ".join([name.ljust(widths[0]), unit.ljust(widths[1]), *aligned]))
        return [*lines, self.fit, *self.doubts, *self.notes]

    @property
    def table(self) -> list[tuple[str, str, str, str, str]]:
        """Rows of text: headings; then name, unit, initial value, fitted value and standard deviation."""
        rows = [("parameter", "unit", "before", "fitted", "deviation")]
        for k, (name, unit) in enumerate(zip(self.parameters, self.units, strict=True)):
            deviation = self.standard_deviations[k]
            shown = f"{deviation:.2g}" if np.isfinite(deviation) else "-"
            if np.isnan(deviation) and not self.is_wrong:
                shown = "at edge"
            rows.append((name, unit, f"{self.before[k]:.6g}", f"{self.values[k]:.6g}", shown))
        return rows

    @property
    def fit(self) -> str:
        """One line of text on the misfit and its probability."""
        if np.isnan(self.probability):
            return "to test the scene, give the noise of columns, and more numbers than parameters"
        chance = f"{self.probability:.2g}" if self.probability >= 1e-6 else "< 1e-6"
        freedom = f"{round(self.degrees_of_freedom, 1):,.10g} degrees of freedom"
        return f"reduced chi-squared {self.misfit**2:.3g}, expected 1; p-value {chance}; {freedom}"

    @property
    def is_wrong(self) -> bool:
        """True if the given noise does not explain the difference from the measured motion."""
        return self.probability < MIN_PROBABILITY

    @property
    def doubts(self) -> list[str]:
        """Lines with reasons not to trust the values.

        A wrong scene, columns that do not fit or are in degrees, parameters that are not identifiable, and a
        fit that has not converged.
        """
        lines = []
        if self.is_wrong:
            worst = max(self.misfits, key=lambda name: self.misfits[name])
            lines = [
                "the scene cannot move as measured, or the noise is larger than given: "
                "do not trust these values",
                f"largest residuals: {worst}, {self.misfits[worst]:.3g} times its noise",
            ]
        if self.missing_friction:
            lines += self.missing_friction.report()
        lines += [f"{name}: a constant fits better than the scene" for name in self.unlike]
        lines += [f"{name} fits in degrees: add [deg] to its name?" for name in self.in_degrees]
        return [*lines, *self.undetermined, *[self.stopped] * bool(self.stopped)]

    @property
    def notes(self) -> list[str]:
        """Lines on measurements that contradict the start of a run, and on limits of the covariance."""
        lines = [self.contradiction] if self.contradiction else []
        for name, unit, value in zip(self.parameters, self.units, self.values, strict=True):
            if name in self.at_bound:
                smallest = f"{value:.3g} {unit}".rstrip()
                lines.append(f"{name} is at its smallest allowed value, {smallest}: smaller would fit better")
        if not self.is_wrong and self.curvature > MAX_CURVATURE:
            lines.append("the confidence region is curved: deviations hold for single parameters only")
        return lines


@checked
def identify(
    scene: Scene,
    parameters: Sequence[str],
    measurements: Given | Sequence[Given],
    formulation: FormulationName | None = None,
    **control: Unpack[StepControl],
) -> Identification:
    """Fit parameters of a scene to measured motion, beginning at the scene's own values.

    Args:
        scene: model of the measured mechanism.
        parameters: names, see `newton_euler.equations.parameters` and, for initial coordinates,
            `newton_euler.runs.initial_coordinates`. All numbers of an array are fitted.
        measurements: of one or several runs: CSV files, see `measurements_from_csv`, or `Measurements`.
        formulation: see `simulate`.
        control: step control of DOP853 with projection, see `simulate`; other methods have no derivatives.

    Raises:
        NewtonEulerError: for an unknown parameter or column, times beyond the scene's duration, fewer
            measured numbers than parameters, and runs that stop.

    Warns:
        IdentificationWarning: if the scene cannot move as measured, if combinations of parameters are not
            identifiable (the warning names them), or if the fit did not converge.

    Examples:
        >>> scene = load("slider_crank")
        >>> run = simulate(scene)
        >>> measured = Measurements(run.time, {"coordinate.guide": run.joint("guide").coordinates[:, 0]})
        >>> found = identify(with_parameters(scene, {"slider.mass": 1.8}), ["slider.mass"], measured)
        >>> print(f"{found.values[0]:.4f} kg")
        2.0000 kg
    """
    # parameters and measurements
    check_formulation(formulation)
    names = tuple(components(scene, checked_names(parameters)))
    runs = _runs(scene, names, measurements)
    count = sum(run.time.size * len(run.columns) for run in runs.values())
    without_noise = {name for run in runs.values() for name in run.columns if name not in run.noise}
    if count < len(names) + len(without_noise):
        more = ", and for the noise of each column that is not given" if without_noise else ""
        needed = f"at least {len(names) + len(without_noise)}, one for each that is fitted{more}"
        raise MechanismError("measurements", f"are {count} numbers", needed)
    # fit
    measured = Residuals(scene, names, runs, formulation, tangent_options(control))
    measured.code.warn()  # of nearly redundant constraints
    fit = Fit(scene, names, measured)
    # change of the parameters from their initial values, and its combinations that are not identifiable
    # (`weak`), in units of the typical magnitudes of the parameters (`fit.scale`)
    change, noise = fit.solve(), fit.noise
    _, weak, covariance = fit.split(change)
    values = fit.values(change)
    stopped = fit.if_not_converged if fit.next_step(change) > CONVERGED_STD else ""
    # covariance: infinite for combinations that are not identifiable, NaN for a wrong scene or at an edge of
    # valid values
    is_at_edge = fit.is_at_edge(change) if stopped else fit.is_held.tolist()
    is_not_identifiable = np.any(np.abs(weak) > FACTOR_TOLERANCE, axis=0) | bool(noise.undetermined)
    is_wrong, fitted = noise.probability < MIN_PROBABILITY, dict(zip(names, values.tolist(), strict=True))
    fitted_scene = with_parameters(scene, fitted)
    # dry friction of joints that stick, and friction that a wrong scene does not have
    stuck, missing = dict[str, list[str]](), None
    if is_wrong or frictions_of(scene, names):
        rates = measured.joint_rates(values)
        stuck = sticking(fitted_scene, names, rates)
        if is_wrong:
            inputs = FitInputs(scene, runs, formulation)
            missing = missing_friction(inputs, fitted, rates, noise.effective, noise.misfit)
    is_not_identifiable |= np.isin(names, [name for each in stuck.values() for name in each])
    for k in np.flatnonzero(is_not_identifiable | is_at_edge):
        covariance[k, :] = covariance[:, k] = np.nan
        covariance[k, k] = np.nan if is_at_edge[k] else np.inf
    if is_wrong:
        covariance[:] = np.nan
    of_stuck = [
        f"joint {joint} sticks in all runs: {' and '.join(each)} not identifiable"
        for joint, each in stuck.items()
    ]
    unknown_noise = [
        f"the noise of {name} is not identifiable from its residuals" for name in noise.undetermined
    ]
    residuals = fit.residuals(change)
    found = Identification(
        scene=fitted_scene,
        parameters=names,
        units=fit.units,
        before=fit.before,
        values=values,
        covariance=covariance * np.outer(fit.scale, fit.scale),
        noise=tuple(
            {name: float(deviations[0]) for name, deviations in run.items()}
            for run in measured.by_column(noise.deviations)
        ),
        misfits=_misfits(measured.by_column(residuals / noise.deviations)),
        misfit=noise.misfit,
        degrees_of_freedom=noise.freedom,
        probability=noise.probability,
        residuals=measured.by_column(-residuals),
        unlike=measured.unlike(residuals),
        in_degrees=fit.in_degrees(change),
        undetermined=(*_describe_weak(names, values, fit, weak), *of_stuck, *unknown_noise),
        missing_friction=missing,
        at_bound=tuple(np.array(names)[fit.is_held].tolist()),
        stopped=stopped,
        contradiction=measured.contradiction(values),
        curvature=fit.curvature(change),  # evaluated last: it moves to other values
        evaluations=measured.evaluations,
    )
    if found.doubts:
        doubts = "; ".join(found.doubts)
        warnings.warn(
            f"scene {quoted(scene.name)}: {doubts}", IdentificationWarning, stacklevel=caller_level()
        )
    return found


def _runs(scene: Scene, names: Sequence[str], given: Given | Sequence[Given]) -> dict[str, Measurements]:
    """Read and check the measurements of each run.

    Args:
        scene, names: the scene and the names of its fitted parameters.
        given: measurements of one run, or of several.

    Returns:
        Measurements by the name of their file, or by a text with the number of the run; for messages.
    """
    sources = list(given) if isinstance(given, list | tuple) else [given]
    if not sources:
        raise OptionError("measurements", given, "those of a run, or of several")
    runs: dict[str, Measurements] = {}
    for k, source in enumerate(sources):
        if isinstance(source, Measurements):
            where, run = f"measurements of run {k}" if len(sources) > 1 else "measurements", source
        elif isinstance(source, str | os.PathLike):
            where, run = path_text(source), measurements_from_csv(source)
        else:
            raise OptionError("measurements", f"{quoted(source)}", "Measurements, or the path of a CSV file")
        # `start` has the measured joint coordinates and rates at the start of the run
        try:
            initial_numbers(scene, run.start)  # raises an error for an unknown name
        except NewtonEulerError as error:
            raise SourceError(where, str(error)) from error
        if twice := [name for name in run.start if name in names]:
            raise MechanismError(where, f"give {quoted(twice[0])}, which is fitted", "one of the two")
        if run.time[-1] > scene.duration * (1.0 + 1e-12):
            problem = f"times go on to {run.time[-1]:.9g} s"
            longer = f"--set duration={run.time[-1]:g} (MJCF, URDF), or duration in a scene file"
            needed = f"at most the scene's duration, {scene.duration:g} s; longer: {longer}"
            raise MechanismError(where, problem, needed)
        if where in runs:
            raise OptionError("measurements", where, "each file once")
        runs[where] = run
    return runs


def _misfits(residuals: Sequence[Mapping[str, Floats]]) -> dict[str, float]:
    """Return the root mean square of each column over all runs.

    Args:
        residuals: for each run, residuals (n,) in units of their noise by name of the column.
    """
    by_name: dict[str, list[Floats]] = {}
    for run in residuals:
        for name, column in run.items():
            by_name.setdefault(name, []).append(column)
    return {name: float(np.sqrt(np.mean(np.concatenate(each) ** 2))) for name, each in by_name.items()}


def _describe_weak(names: Sequence[str], values: Array, fit: Fit, weak: Array) -> list[str]:
    """Describe the combinations of parameters that are not identifiable, one line each.

    Args:
        names, values: names and fitted values (p,) of the parameters.
        fit: gives scales, units and noise.
        weak: (d, p) combinations, in units of the scales (typical magnitudes) of the parameters.
    """
    lines = []
    # if given noise does not explain the residuals, the residuals count as noise
    is_explained = fit.noise.probability >= MIN_PROBABILITY
    what = "that was measured" if is_explained else "beyond these residuals"
    # combinations with the indices of their parameters; those of few parameters first
    combinations = [([k for k, x in enumerate(row) if abs(x) > FACTOR_TOLERANCE], row) for row in weak]
    for indices, row in sorted(combinations, key=lambda pair: (len(pair[0]), pair[0])):
        if len(indices) == 1:
            lines.append(f"{names[indices[0]]} is not identifiable")
            continue
        change = row * fit.scale
        if len(indices) == 2 and values[indices].all():
            # equal relative changes leave the quotient unchanged, opposite ones the product
            x, y = change[indices] / values[indices]
            if abs(abs(x) - abs(y)) < FACTOR_TOLERANCE * abs(x):
                operator = "/" if x * y > 0.0 else "*"
                lines.append(f"only {names[indices[0]]} {operator} {names[indices[1]]} is identifiable")
                continue
        # an example: changes of one percent of the scales
        changes = [f"{names[k]} {0.01 * change[k]:+.2g} {fit.units[k]}".rstrip() for k in indices]
        lines.append(f"not identifiable: {', '.join(changes)} together change nothing {what}")
    return lines
