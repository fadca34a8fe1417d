"""Least-squares fit of numbers of a scene to measured motion.

A fit has two steps. Each uses the trust-region method of scipy, and is repeated with the noise estimated from
its residuals until the noise converges (`newton_euler.analysis.identification.noise`):

1. A regularized fit of all numbers. A change of a number by its scale costs as much as a residual of one
   standard deviation. Combinations without information in the data keep their values, and steps are bounded.
   If a number grows beyond its scale, its scale grows, too: the initial value may be far too small.
2. A fit of the identifiable combinations, whose effect exceeds the noise, without regularization. The other
   combinations return to their initial values.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from newton_euler.analysis.identification.noise import FINAL_CHANGE, ROUGH_CHANGE, Noise
from newton_euler.analysis.identification.residuals import Residuals
from newton_euler.analysis.sensitivity.tangent_starts import own_numbers
from newton_euler.equations.parameters import own_value, places
from newton_euler.errors import NewtonEulerError
from newton_euler.model.scene import Scene
from newton_euler.runs.initial_coordinates import initial_numbers
from newton_euler.runs.variation import units_of
from newton_euler.scalars import Array

UNDETERMINED_STD = 1.0
"""Standard deviation of a combination of parameters, in units of their scales, from which on the combination
is not identifiable."""

RANK_TOL = 1e-7
"""Singular value of the Jacobian, divided by the largest, below which a combination has no digits left."""

CONVERGED_STD = 0.1
"""Largest further step, in standard deviations, of a fit that counts as converged."""

REPEATED_STD = 0.01
"""Further step, in standard deviations, above which the second step of a fit is repeated."""

ROUND_OFF_CHANGE = 1e-12
"""Change of a number below which it is round-off, in units of its scale."""

SLOPE_ROUND_OFF = 1e-8
"""Further step, in units of scales, that runs with a tolerance of 1e-10 do not distinguish from none."""

EDGE_DISTANCE = 1e-6
"""Distance from an impossible value, in units of the scale, at which a number counts as at the edge."""

MAX_GROWTH = 2.0
"""Factor by which a number may exceed its scale."""

MAX_FITS = 8
"""Number of fits, each with the noise or the scales estimated by the one before."""

MAX_EVALUATIONS = 200
"""Number of evaluations of one fit."""

TOLERANCES = {"xtol": 1e-9, "ftol": 1e-10, "gtol": 1e-12}
"""Relative tolerances of the change, the sum of squares and the slope, see `scipy.optimize.least_squares`."""

INVALID_FACTOR = 1e3
"""Residuals of impossible numbers, divided by the largest residual at the beginning of the fit."""


class Fit:
    """Numbers of a scene with the least sum of squared residuals, each divided by its noise.

    A change (p,) of the numbers is in units of their scales.

    Attributes:
        before, scale: (p,) the scene's own numbers, and large changes of them.
        units: (p,) units of the numbers.
        noise: noise of the measurements.
        stopped: reason why the last fit ended; empty before the first fit.
    """

    def __init__(self, scene: Scene, names: tuple[str, ...], residuals: Residuals) -> None:
        self._runs, self.noise = residuals, Noise(residuals.runs)
        self.before, self.scale, self.units = _scales(scene, names)
        self.stopped, self._refused = "", ""
        self._suspected: set[str] = set()

    def solve(self) -> Array:
        """Return the change (p,) with the least squares of residuals."""
        # 1. all numbers, regularized; again from the start if the noise turns out to be larger
        change, scale = np.zeros(len(self.before)), self.scale
        self._suspected = self._runs.like_degrees(self.residuals(change))
        for _ in range(MAX_FITS):
            change = self._pulled(change)
            growth = self._estimate_noise(change)
            if np.abs(growth - 1.0).max() < ROUGH_CHANGE:
                break
            if growth.max() > 1.0 + ROUGH_CHANGE:
                change, self.scale = np.zeros(len(change)), scale
        # 2. identifiable combinations only
        for _ in range(MAX_FITS):
            change = self._free(self._determined(change))
            if np.abs(self._estimate_noise(change) - 1.0).max() < FINAL_CHANGE:
                break
        return change

    def _estimate_noise(self, change: Array) -> Array:
        """Estimate the noise from the residuals; return the growth factors of its levels."""
        jacobian = self.jacobian(change)
        return self.noise.estimate(self.residuals(change), jacobian @ split(jacobian).strong.T)

    def _pulled(self, change: Array) -> Array:
        """Return the change (p,) of the regularized fit; enlarge scales that numbers exceed."""
        for _ in range(MAX_FITS):
            change = self._least(change, np.eye(len(change)), pull=1.0)
            larger = np.maximum(self.scale, np.abs(self.values(change)))
            if np.all(larger <= MAX_GROWTH * self.scale):
                break
            change, self.scale = change * self.scale / larger, larger
        return change

    def _determined(self, change: Array) -> Array:
        """Return the identifiable part of a change (p,), or the change if the scene cannot have this part."""
        strong, weak, _ = split(self.jacobian(change))
        if not len(weak):
            return change
        directions = strong / np.linalg.norm(strong, axis=1)[:, None]
        part = np.asarray((directions @ change) @ directions)
        try:
            self._runs(self.values(part))
        except NewtonEulerError:
            return change
        return part

    def _free(self, change: Array) -> Array:
        """Return the change (p,) with the least squares of residuals, varying identifiable combinations."""
        unsettled = np.inf
        while REPEATED_STD < (now := self.unsettled(change)) < 0.5 * unsettled:
            unsettled = now
            strong = split(self.jacobian(change)).strong
            change = self._least(change, strong.T / np.linalg.norm(strong, axis=1), pull=0.0)
        return change

    def _least(self, begin: Array, basis: Array, pull: float) -> Array:
        """Minimize the squares of residuals, and of the whole change times `pull`, over a subspace.

        Args:
            begin: (p,) change to start from.
            basis: (p, k) directions of further changes.
            pull: weight of the regularization; 0 for none.
        """
        from scipy.optimize import least_squares

        def changed(z: Array) -> Array:
            return np.asarray(begin + basis @ (z - 1.0))  # z begins at 1: tolerances are relative to z

        def residuals(z: Array) -> Array:
            change = changed(z)
            try:
                return np.concatenate([self._weighted(change), pull * change])
            except NewtonEulerError as error:
                self._refused = f"further values are impossible: {error}"
                return np.full(len(first), far)

        def jacobian(z: Array) -> Array:
            return np.vstack([self.jacobian(changed(z)) @ basis, pull * basis])

        if not basis.size:
            return begin
        self._refused = ""
        first = np.concatenate([self._weighted(begin), pull * begin])
        far = INVALID_FACTOR * max(1.0, float(np.abs(first).max()))
        solved = least_squares(
            residuals, np.ones(basis.shape[1]), jacobian, max_nfev=MAX_EVALUATIONS, **TOLERANCES
        )
        over = f"{MAX_EVALUATIONS} evaluations are used up" if solved.status == 0 else "steps are too small"
        self.stopped = f"the fit has not converged: {self._refused or over}"
        return changed(solved.x)

    def unsettled(self, change: Array) -> float:
        """Compute the length of a further step of identifiable combinations, in standard deviations.

        0 for a step that is round-off.
        """
        jacobian = self.jacobian(change)
        strong = split(jacobian).strong
        deviations = strong @ (jacobian.T @ self._weighted(change))
        if np.abs(strong.T @ deviations).max() < SLOPE_ROUND_OFF:
            return 0.0
        return float(np.linalg.norm(deviations))

    def is_at_edge(self, change: Array) -> list[bool]:
        """True for each number if the scene cannot have a slightly larger or smaller value."""
        steps = EDGE_DISTANCE * np.eye(len(change))
        return [
            not all(self._runs.can_start(self.values(change + near)) for near in (step, -step))
            for step in steps
        ]

    def curvature(self, change: Array) -> float:
        """Compute the relative change of derivatives at a distance of two standard deviations.

        Root mean square over the identifiable combinations (D. M. Bates and D. G. Watts, Journal of the Royal
        Statistical Society B 42, 1980); infinite if the scene cannot have these values.
        """
        jacobian = self.jacobian(change)
        strong = split(jacobian).strong
        try:
            changes = [(self.jacobian(change + 2.0 * each) - jacobian) @ strong.T for each in strong]
        except NewtonEulerError:
            return np.inf
        norms = [np.linalg.norm(each, 2) for each in changes]
        return float(np.sqrt(np.mean(np.square(norms)))) if norms else 0.0

    def in_degrees(self, change: Array) -> tuple[str, ...]:
        """Return the names of columns that fit as degrees instead of rad, after the fit or before it."""
        residuals = self.residuals(change)
        suspected = self._suspected | self._runs.like_degrees(residuals)
        return tuple(sorted(suspected & self._runs.unexplained(residuals)))

    def values(self, change: Array) -> Array:
        """Return the numbers (p,) after a change."""
        return self.before + np.where(np.abs(change) > ROUND_OFF_CHANGE, change, 0.0) * self.scale

    def residuals(self, change: Array) -> Array:
        """Compute the residuals (n,), SI."""
        return self._runs(self.values(change)).residuals

    def jacobian(self, change: Array) -> Array:
        """Compute the derivatives (n, p) of residuals in units of their noise by the change."""
        return self._runs(self.values(change)).jacobian * self.scale / self.noise.effective[:, None]

    def _weighted(self, change: Array) -> Array:
        """Compute the residuals (n,) in units of their noise."""
        return self.residuals(change) / self.noise.effective


def _scales(scene: Scene, names: Sequence[str]) -> tuple[Array, Array, tuple[str, ...]]:
    """Return the scene's own values (p,) of numbers, large changes of them (p,), and their units.

    A change by the own value is large; in an array of one unit, by the largest value of the array. If the
    value is 0, a change by the mechanism's size is large for a length, m, else a change by 1.
    """
    before, units = own_numbers(scene, names), tuple(units_of(scene, names).values())
    initial = np.isin(names, list(initial_numbers(scene, names)))
    before[initial & (np.abs(before) < ROUND_OFF_CHANGE)] = 0.0
    scale = np.abs(before)
    for k, (name, unit) in enumerate(zip(names, units, strict=True)):
        if unit and not initial[k]:
            (place,) = places(scene, [name]).values()
            scale[k] = np.abs(own_value(scene, place.owner)).max()
        if scale[k] == 0.0:
            scale[k] = scene.mechanism.size if unit == "m" else 1.0
    return before, scale, units


class Split(NamedTuple):
    """The space of parameters, in units of their scales, divided by identifiability.

    Attributes:
        strong: (s, p) orthogonal identifiable directions, each as long as its standard deviation.
        weak: (p - s, p) a basis of the directions that are not identifiable, with many zeros.
        covariance: (p, p) of all parameters.
    """

    strong: Array
    weak: Array
    covariance: Array


def split(jacobian: Array) -> Split:
    """Divide the space of parameters into identifiable directions and others.

    Args:
        jacobian: (n, p) of residuals in units of their noise, by parameters in units of their scales.
    """
    _, values, right = np.linalg.svd(jacobian, full_matrices=False)
    least = RANK_TOL * values[0]
    known = (values > least) & (values * UNDETERMINED_STD > 1.0)
    weak = right[~known]
    every = right / np.maximum(values, least or 1.0)[:, None]
    return Split(every[known], _sparse_basis(weak) if len(weak) else weak, every.T @ every)


def _sparse_basis(rows: Array) -> Array:
    """Return a basis of the space of rows (d, p); each row has a column in which all others are 0."""
    from scipy.linalg import qr

    _, _, order = qr(rows, mode="economic", pivoting=True)
    reduced = np.linalg.solve(rows[:, order[: len(rows)]], rows)
    return np.asarray(reduced / np.abs(reduced).max(axis=1)[:, None])
