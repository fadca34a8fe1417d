"""Least-squares fit of parameters of a scene to measured motion.

Residuals are computed minus measured numbers; each is divided by the standard deviation of its measurement
noise. A fit has two steps. Each uses the trust-region method of scipy, and is repeated with the noise
estimated from its residuals until the noise converges (`newton_euler.analysis.identification.noise`):

1. A regularized fit of all parameters. A change of a parameter by its scale, a typical magnitude, costs as
   much as a residual of one standard deviation of the noise. Combinations of parameters without information
   in the data therefore keep their values, and steps are bounded. If a parameter grows beyond its scale, the
   scale is enlarged, because the initial value may be far too small.
2. A fit of the identifiable combinations, whose effect exceeds the noise, without regularization. The other
   combinations return to their initial values.

Parameters such as a friction or a damping have a smallest allowed value. If the residuals of a fit would
become smaller below this value, the parameter is held at the value, and the other parameters are fitted again
(an active-set method; J. Nocedal, S. J. Wright, Numerical Optimization, second edition, Springer 2006,
section 16.5).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from newton_euler.analysis.identification.friction import frictions_of
from newton_euler.analysis.identification.noise import FINAL_CHANGE, ROUGH_CHANGE, Noise
from newton_euler.analysis.identification.residuals import Residuals
from newton_euler.analysis.sensitivity.tangent_starts import own_numbers
from newton_euler.equations.parameter_names import places
from newton_euler.equations.parameters import own_value
from newton_euler.errors import NewtonEulerError
from newton_euler.model.scene import Scene
from newton_euler.runs.initial_coordinates import initial_numbers
from newton_euler.runs.variation import units_of
from newton_euler.scalars import Array

UNDETERMINED_STD = 1.0
"""Standard deviation of a combination of parameters, in units of their scales, from which on the combination
is not identifiable."""

RANK_TOL = 1e-7
"""Singular value of the Jacobian, divided by the largest, below which the singular value is round-off and its
combination of parameters is not identifiable."""

CONVERGED_STD = 0.1
"""Length of the next Gauss-Newton step, in standard deviations of the parameters (`Fit.next_step`), up to
which a fit counts as converged."""

REPEATED_STD = 0.01
"""Length of the next Gauss-Newton step, in standard deviations of the parameters, above which the second step
of a fit is repeated."""

ROUND_OFF_CHANGE = 1e-12
"""Change of a parameter, in units of its scale, below which the change is round-off."""

STEP_ROUND_OFF = 1e-8
"""Largest component of a Gauss-Newton step, in units of scales, below which the step is noise of simulations
with a relative tolerance of 1e-10."""

EDGE_DISTANCE = 1e-6
"""Distance from an invalid value, in units of the scale, within which a parameter counts as at the edge of
its valid values. An example of an invalid value is a length with which loops cannot close."""

BOUND_STD = 0.01
"""Distance from the smallest allowed value, in standard deviations, up to which a parameter may be held at
this value. It is held if the next Gauss-Newton step beyond the value is longer than the same distance."""

MAX_GROWTH = 2.0
"""Largest ratio of a parameter to its scale; beyond, the scale is enlarged."""

MAX_FITS = 8
"""Largest number of fits, each with the noise or the scales estimated from the fit before."""

MAX_EVALUATIONS = 200
"""Largest number of evaluations of the residuals in one fit."""

TOLERANCES = {"xtol": 1e-9, "ftol": 1e-10, "gtol": 1e-12}
"""Tolerances of the parameters, the sum of squares and the gradient, see `scipy.optimize.least_squares`."""

INVALID_FACTOR = 1e3
"""Residual that stands for invalid parameter values, divided by the largest residual at the beginning."""


class Fit:
    """Least-squares fit of p parameters of a scene to n measured numbers.

    A *change* (p,) is the difference of the parameters from their initial values, in units of their scales.

    Attributes:
        before: (p,) initial values of the parameters, those of the scene.
        scale: (p,) typical magnitudes of the parameters.
        units: (p,) units of the parameters.
        smallest: (p,) smallest allowed values; -infinity for parameters without one.
        is_held: (p,) True for parameters that are held at their smallest values.
        noise: noise of the measurements. `noise.effective` (n,) has the standard deviations that divide the
            residuals, SI: estimated, or given and enlarged if the scene does not explain the residuals.
        if_not_converged: message to use if `next_step` shows that the last fit has not converged.
    """

    def __init__(self, scene: Scene, names: tuple[str, ...], residuals: Residuals) -> None:
        """Prepare a fit.

        Args:
            scene: scene with the initial values.
            names: (p,) names of the parameters.
            residuals: function that simulates and compares; it has the measured runs.
        """
        self._evaluate, self.noise = residuals, Noise(residuals.runs)
        self.before, self.scale, self.units = _scales(scene, names)
        self.smallest = _smallest_values(scene, names, self.scale)
        self.is_held = np.zeros(len(names), dtype=bool)
        self.if_not_converged = ""
        self._invalid_text = ""  # error of the last invalid parameter values in the current fit
        # measured columns of angles that may be in degrees instead of rad, found before the fit
        self._degree_columns: set[str] = set()

    def solve(self) -> Array:
        """Return the change (p,) with the least sum of squared residuals."""
        # 1. all parameters, regularized; again from the initial values if the noise turns out to be larger
        change, initial_scale = np.zeros(len(self.before)), self.scale
        self._degree_columns = self._evaluate.like_degrees(self.residuals(change))
        for _ in range(MAX_FITS):
            change = self._fit_regularized(change)
            growth = self._estimate_noise(change)  # ratios of the new noise to the one before
            if np.abs(growth - 1.0).max() < ROUGH_CHANGE:
                break
            if growth.max() > 1.0 + ROUGH_CHANGE:
                change, self.scale = np.zeros(len(change)), initial_scale
        # 2. identifiable combinations only
        for _ in range(MAX_FITS):
            change, is_same = self._hold(change)
            change = self._fit_identifiable(self._project(change))
            growth = self._estimate_noise(change)
            if is_same and np.abs(growth - 1.0).max() < FINAL_CHANGE:
                break
        return change

    def split(self, change: Array) -> Split:
        """Divide the space of parameters at a change (p,), see `split`.

        Parameters that are held have zeros in all directions, and NaN in the covariance.
        """
        free = np.flatnonzero(~self.is_held)
        if len(free) == len(change):
            return split(self.jacobian(change))
        part = split(self.jacobian(change)[:, free])
        covariance = np.full((len(change), len(change)), np.nan)
        covariance[np.ix_(free, free)] = part.covariance
        strong, weak = (
            np.insert(each, np.flatnonzero(self.is_held) - np.arange(self.is_held.sum()), 0.0, axis=1)
            for each in (part.strong, part.weak)
        )
        return Split(strong, weak, covariance)

    def _hold(self, change: Array) -> tuple[Array, bool]:
        """Choose the parameters that are held at their smallest values.

        Args:
            change: (p,) change at which the choice is made.

        Returns:
            The change (p,) with these parameters at their smallest values, and True if the choice has not
            changed.
        """
        jacobian, bounds = self.jacobian(change), self._bounds
        deviations = np.minimum(np.sqrt(np.diag(split(jacobian).covariance)), UNDETERMINED_STD)
        # steps of the parameters towards the smallest values, in standard deviations
        steps = (jacobian.T @ self._weighted(change)) * deviations
        is_held = (change - bounds < BOUND_STD * deviations) & (steps > BOUND_STD)
        is_held |= self.is_held & (steps > -BOUND_STD)
        is_same, self.is_held = bool(np.all(is_held == self.is_held)), is_held
        return np.where(is_held, bounds, change), is_same

    @property
    def _bounds(self) -> Array:
        """(p,) smallest allowed changes, in units of scales."""
        return (self.smallest - self.before) / self.scale

    def _estimate_noise(self, change: Array) -> Array:
        """Estimate the noise from the residuals after a change (p,).

        Returns:
            For each group of columns (see `Noise.levels`), the new noise divided by the noise before.
        """
        jacobian = self.jacobian(change)
        # derivatives with respect to identifiable combinations show how much of the noise the fit absorbs
        fitted = jacobian @ self.split(change).strong.T
        return self.noise.estimate(self.residuals(change), fitted)

    def _fit_regularized(self, change: Array) -> Array:
        """Return the change (p,) of the regularized fit; enlarge scales that parameters exceed."""
        for _ in range(MAX_FITS):
            change = self._minimize(change, np.eye(len(change)), 1.0, self._bounds)
            larger = np.maximum(self.scale, np.abs(self.values(change)))
            if np.all(larger <= MAX_GROWTH * self.scale):
                break
            change, self.scale = change * self.scale / larger, larger
        return change

    def _project(self, change: Array) -> Array:
        """Project a change (p,) on the identifiable directions.

        The result is the change itself if the projected parameter values are invalid.
        """
        strong, weak, _ = self.split(change)
        if not len(weak):
            return change
        directions = strong / np.linalg.norm(strong, axis=1)[:, None]
        part = np.where(self.is_held, change, (directions @ change) @ directions)
        try:
            self._evaluate(self.values(part))
        except NewtonEulerError:
            return change
        return part

    def _fit_identifiable(self, change: Array) -> Array:
        """Return the change (p,) with the least squares, varying identifiable combinations only.

        The fit is repeated with new directions until the next step is small or no longer halves.
        """
        previous, step = np.inf, self.next_step(change)
        while REPEATED_STD < step < 0.5 * previous:
            strong, weak, _ = self.split(change)
            directions, smallest = strong.T / np.linalg.norm(strong, axis=1), None
            if not len(weak) and np.isfinite(self.smallest).any():
                # single parameters as directions, because these can be bounded
                directions = np.eye(len(change))[:, ~self.is_held]
                smallest = self._bounds[~self.is_held]
            change = self._minimize(change, directions, 0.0, smallest)
            previous, step = step, self.next_step(change)
        return change

    def _minimize(self, initial: Array, basis: Array, regularization: float, smallest: Array | None) -> Array:
        """Minimize the sum of squared residuals, and of the squared change times a weight, over a subspace.

        Args:
            initial: (p,) change to begin with.
            basis: (p, k) directions in which the change may vary.
            regularization: square root of the weight of the change; 0 for no regularization.
            smallest: (k,) smallest allowed changes along the directions, which are then single parameters;
                None for directions that are not bounded.
        """
        from scipy.optimize import least_squares

        if not basis.size:
            return initial
        self._invalid_text = ""
        lower = np.full(basis.shape[1], -np.inf)
        if smallest is not None:
            initial = np.maximum(initial, np.where(self.is_held, initial, self._bounds))
            lower = 1.0 + smallest - initial @ basis
        initial_residuals = np.concatenate([self._weighted(initial), regularization * initial])
        penalty = INVALID_FACTOR * max(1.0, float(np.abs(initial_residuals).max()))

        def change_of(z: Array) -> Array:
            """Return the change (p,) for coordinates z (k,) in the subspace.

            z begins at 1, because the tolerances of `least_squares` are relative to z.
            """
            return np.asarray(initial + basis @ (z - 1.0))

        def residuals(z: Array) -> Array:
            """Compute weighted residuals, then the regularization; large numbers for invalid values."""
            change = change_of(z)
            try:
                return np.concatenate([self._weighted(change), regularization * change])
            except NewtonEulerError as error:
                self._invalid_text = f"further values are impossible: {error}"
                return np.full(len(initial_residuals), penalty)

        def jacobian(z: Array) -> Array:
            """Compute the derivatives of `residuals` with respect to z."""
            return np.vstack([self.jacobian(change_of(z)) @ basis, regularization * basis])

        begin, bounds = np.ones(len(lower)), (lower, np.inf)
        solved = least_squares(residuals, begin, jacobian, bounds, max_nfev=MAX_EVALUATIONS, **TOLERANCES)
        is_limit = solved.status == 0
        reason = f"{MAX_EVALUATIONS} evaluations are used up" if is_limit else "steps are too small"
        self.if_not_converged = f"the fit has not converged: {self._invalid_text or reason}"
        return change_of(solved.x)

    def next_step(self, change: Array) -> float:
        """Compute the length of the next Gauss-Newton step in identifiable directions.

        Args:
            change: (p,) change from which the step starts.

        Returns:
            The length in standard deviations; 0 for a step that is round-off.
        """
        jacobian = self.jacobian(change)
        strong = self.split(change).strong
        # minus the step, along directions whose lengths are standard deviations
        deviations = strong @ (jacobian.T @ self._weighted(change))
        if np.abs(strong.T @ deviations).max(initial=0.0) < STEP_ROUND_OFF:
            return 0.0
        return float(np.linalg.norm(deviations))

    def is_at_edge(self, change: Array) -> list[bool]:
        """Return True for each parameter whose slightly larger or smaller value is invalid.

        Args:
            change: (p,) change at which the parameters are examined.
        """
        steps = EDGE_DISTANCE * np.eye(len(change))
        return [
            bool(is_held)
            or not all(self._evaluate.can_start(self.values(change + signed)) for signed in (step, -step))
            for step, is_held in zip(steps, self.is_held, strict=True)
        ]

    def curvature(self, change: Array) -> float:
        """Compute how much derivatives change at a distance of two standard deviations from a change (p,).

        The result is the relative change, as root mean square over the identifiable combinations (D. M. Bates
        and D. G. Watts, Journal of the Royal Statistical Society B 42, 1980). It is infinite if values at
        this distance are invalid.
        """
        jacobian = self.jacobian(change)
        strong = self.split(change).strong
        try:
            changes = [(self.jacobian(change + 2.0 * each) - jacobian) @ strong.T for each in strong]
        except NewtonEulerError:
            return np.inf
        norms = [np.linalg.norm(each, 2) for each in changes]
        return float(np.sqrt(np.mean(np.square(norms)))) if norms else 0.0

    def in_degrees(self, change: Array) -> tuple[str, ...]:
        """Return the names of measured columns that fit as degrees instead of rad, after a change (p,).

        Columns whose numbers the scene explains as rad are not among them.
        """
        residuals = self.residuals(change)
        suspected = self._degree_columns | self._evaluate.like_degrees(residuals)
        return tuple(sorted(suspected & self._evaluate.unexplained(residuals)))

    def values(self, change: Array) -> Array:
        """Return the parameters (p,), SI, after a change."""
        values = self.before + np.where(np.abs(change) > ROUND_OFF_CHANGE, change, 0.0) * self.scale
        return np.where(np.abs(values - self.smallest) < ROUND_OFF_CHANGE * self.scale, self.smallest, values)

    def residuals(self, change: Array) -> Array:
        """Compute the residuals (n,), computed minus measured, SI, after a change (p,)."""
        return self._evaluate(self.values(change)).residuals

    def jacobian(self, change: Array) -> Array:
        """Compute the derivatives (n, p) of the weighted residuals with respect to the change."""
        return self._evaluate(self.values(change)).jacobian * self.scale / self.noise.effective[:, None]

    def _weighted(self, change: Array) -> Array:
        """Compute the weighted residuals (n,): each divided by the standard deviation of its noise."""
        return self.residuals(change) / self.noise.effective


def _scales(scene: Scene, names: Sequence[str]) -> tuple[Array, Array, tuple[str, ...]]:
    """Return the initial values (p,) of parameters, their typical magnitudes (p,), and their units.

    The typical magnitude is the absolute initial value; for an element of an array of one unit, it is the
    largest absolute value in the array. For a value of 0 it is the size of the mechanism, m, for a length,
    and 1 for other parameters.
    """
    # the scene's own numbers are those before the fit
    before, units = own_numbers(scene, names), tuple(units_of(scene, names).values())
    initial = np.isin(names, list(initial_numbers(scene, names)))  # initial coordinates and rates of joints
    before[initial & (np.abs(before) < ROUND_OFF_CHANGE)] = 0.0
    scale = np.abs(before)
    for k, (name, unit) in enumerate(zip(names, units, strict=True)):
        if unit and not initial[k]:
            # the scene's value of the whole attribute, such as a point, to which the number belongs
            (place,) = places(scene, [name]).values()
            scale[k] = np.abs(own_value(scene, place.owner)).max()
        if scale[k] == 0.0:
            scale[k] = scene.mechanism.size if unit == "m" else 1.0
    return before, scale, units


def _smallest_values(scene: Scene, names: Sequence[str], scale: Array) -> Array:
    """Return the smallest allowed values (p,) of parameters, -infinity for parameters without one.

    Args:
        scene, names: the scene and the names of the parameters.
        scale: (p,) typical magnitudes. A parameter that must be positive is at least `EDGE_DISTANCE` of it;
            a Stribeck speed is at least the transition speed, below which friction is viscous.
    """
    smallest, initial = np.full(len(names), -np.inf), initial_numbers(scene, names)
    for k, name in enumerate(names):
        if name not in initial:
            (place,) = places(scene, [name]).values()
            smallest[k] = EDGE_DISTANCE * scale[k] if place.field.positive else place.field.least
    for name, friction in frictions_of(scene, names).items():
        if name == f"{friction.prefix}.stribeck_speed":
            smallest[names.index(name)] = min(friction.stribeck_speed, friction.transition_speed)
    return smallest


class Split(NamedTuple):
    """The space of p parameters, in units of their scales, divided by identifiability.

    Attributes:
        strong: (s, p) orthogonal identifiable directions; the length of each is its standard deviation.
        weak: (p - s, p) a basis of the directions that are not identifiable, with many zeros.
        covariance: (p, p) of all parameters; variances that round-off makes infinite are cut off.
    """

    strong: Array
    weak: Array
    covariance: Array


def split(jacobian: Array) -> Split:
    """Divide the space of parameters into identifiable directions and others, by singular values.

    Args:
        jacobian: (n, p) derivatives of the weighted residuals with respect to parameters in units of scales.
    """
    # the standard deviation of a right singular vector is 1 / singular value
    _, values, right = np.linalg.svd(jacobian, full_matrices=False)
    smallest = RANK_TOL * values.max(initial=0.0)
    is_strong = (values > smallest) & (values * UNDETERMINED_STD > 1.0)
    weak = right[~is_strong]
    scaled = right / np.maximum(values, smallest or 1.0)[:, None]
    return Split(scaled[is_strong], _sparse_basis(weak) if len(weak) else weak, scaled.T @ scaled)


def _sparse_basis(rows: Array) -> Array:
    """Return a basis (d, p) of the row space of `rows` (d, p) with many zeros.

    Each row of the basis has a column in which all other rows are 0.
    """
    from scipy.linalg import qr

    _, _, order = qr(rows, mode="economic", pivoting=True)
    reduced = np.linalg.solve(rows[:, order[: len(rows)]], rows)
    return np.asarray(reduced / np.abs(reduced).max(axis=1)[:, None])
