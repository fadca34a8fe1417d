"""Noise of measured columns: given, or estimated from the residuals of a fit.

The noise of a column is given with the measurements or unknown. The columns are divided into groups: group 0
has all columns with given noise, and each other group has the columns of one name with unknown noise.

A fit absorbs a part of the noise. Let J be the derivatives of residuals with respect to parameters, in units
of the noise. The residuals are the noise minus its projection H = J (J^T J)^-1 J^T on the range of J. For a
group g with n_g numbers, the expected sum of squared residuals is n_g - tr H_gg:

- Unknown noise is chosen so that the sum equals its expectation. If the fit is repeated with the new weights
  until the noise converges, this is restricted maximum likelihood (D. A. Harville, Journal of the American
  Statistical Association 72, 1977).
- In units of given noise, the sum of squared residuals is a sum of chi-squared variables of one degree of
  freedom, with weights 1 - h. The h are the eigenvalues of H_gg. A chi-squared distribution with the same
  first two moments replaces the sum (F. E. Satterthwaite, Biometrics Bulletin 2, 1946). This is exact if all
  noise is given.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from newton_euler.analysis.identification.measurements import Measurements
from newton_euler.scalars import Array

MIN_PROBABILITY = 1e-4
"""Probability of residuals as large as those of the fit, below which the scene counts as wrong. Residuals
that noise does not explain move parameters by many of their standard deviations."""

FIRST_NOISE = 1e-3
"""First estimate of unknown noise, divided by the standard deviation of the column. It is small so that
residuals outweigh the regularization, which would hold the parameters at bad initial values."""

MIN_NOISE = 1e-9
"""Smallest estimate of unknown noise, divided by the standard deviation of the column: the error of a
simulated run."""

MIN_LEFT_FRACTION = 1e-6
"""Degrees of freedom that the fit leaves in a group, divided by its numbers, below which the residuals do not
determine the noise."""

ROUGH_CHANGE = 0.1
"""Relative change of the noise from one fit to the next, below which the first stage of a fit, the
regularized fit of all parameters, is complete."""

FINAL_CHANGE = 0.01
"""Relative change of the noise from one fit to the next, below which the second stage of a fit, that of the
identifiable combinations of parameters, has converged."""


class Noise:
    """Standard deviations of measured columns.

    Attributes:
        unknown: (u,) names of the columns whose noise is not given in at least one run.
        levels: (1 + u,) one level for each group. The first is a factor of all given noise: 1 unless the
            scene is wrong. The others are standard deviations of the columns in `unknown`, SI.
        misfit: root of reduced chi-squared: root of (sum of squared residuals in units of the given noise,
            divided by the expected sum). NaN if the columns with given noise are too few to determine it.
        freedom: degrees of freedom of the misfit.
    """

    def __init__(self, runs: Sequence[Measurements]) -> None:
        """Divide the measured columns of all runs into groups, with first estimates of unknown noise."""
        self.misfit, self.freedom = math.nan, 0.0
        # columns without given noise, with the largest standard deviation of their numbers in a run
        spread: dict[str, float] = {}
        for run in runs:
            for name in (name for name in run.columns if name not in run.noise):
                spread[name] = max(spread.get(name, 0.0), float(np.std(run.columns[name])))
        self.unknown = tuple(spread)
        # for each of the n measured numbers: its group, and its noise in units of the level of the group
        columns = [(run, name) for run in runs for name in run.columns]
        sizes = [run.time.size for run, _ in columns]
        groups = [0 if name in run.noise else 1 + self.unknown.index(name) for run, name in columns]
        self._group = np.repeat(groups, sizes)
        self._unit = np.repeat([run.noise.get(name, 1.0) for run, name in columns], sizes)
        # for each group: level, smallest level, degrees of freedom that the fit leaves, ratio of the level to
        # the one before
        deviations = np.array([1.0, *(spread[name] or 1.0 for name in self.unknown)])
        self.levels, self._min_levels = FIRST_NOISE * deviations, MIN_NOISE * deviations
        self.levels[0] = 1.0
        self._left = np.bincount(self._group, minlength=len(self.levels)).astype(float)
        self._growth = np.ones(len(self.levels))

    @property
    def deviations(self) -> Array:
        """(n,) standard deviations of all measured numbers, given or estimated; SI."""
        return self._unit * np.where(self._group > 0, self.levels[self._group], 1.0)

    @property
    def effective(self) -> Array:
        """(n,) standard deviations by which the fit divides residuals, SI.

        They are `deviations`, except that given noise is enlarged if the scene is wrong.
        """
        return self._unit * self.levels[self._group]

    @property
    def probability(self) -> float:
        """Probability that noise alone gives this misfit or a larger one; NaN without a misfit."""
        from scipy.special import chdtrc

        return float(chdtrc(self.freedom, self.freedom * self.misfit**2))

    @property
    def undetermined(self) -> tuple[str, ...]:
        """Names of columns whose noise the residuals do not determine.

        The fit leaves less than one degree of freedom in the column, or the noise does not converge.
        """
        is_unknown = (self._left < 1.0) | (np.abs(self._growth - 1.0) > ROUGH_CHANGE)
        return tuple(name for name, each in zip(self.unknown, is_unknown[1:], strict=True) if each)

    def estimate(self, residuals: Array, fitted: Array) -> Array:
        """Estimate the levels from the residuals of a fit.

        Args:
            residuals: (n,) SI.
            fitted: (n, s) derivatives of the residuals, in units of the noise, with respect to the s
                identifiable combinations of parameters, in units of their standard deviations; the columns
                are orthonormal.

        Returns:
            (1 + u,) new levels, divided by the levels before.
        """
        squares, previous = (residuals / self.effective) ** 2, self.levels.copy()
        self.misfit, self.freedom = math.nan, 0.0
        for group in range(len(previous)):
            in_group = self._group == group
            # eigenvalues h of H_gg: the parts of the noise that the fit absorbs
            h = np.clip(np.linalg.eigvalsh(fitted[in_group].T @ fitted[in_group]), 0.0, 1.0)
            left = np.count_nonzero(in_group) - float(h.sum())  # n_g - tr H_gg
            self._left[group] = left
            if left <= MIN_LEFT_FRACTION * np.count_nonzero(in_group):
                continue
            level = previous[group] * math.sqrt(float(squares[in_group].sum()) / left)
            if group > 0:
                self.levels[group] = max(level, self._min_levels[group])
            else:
                # Satterthwaite: left^2 / (sum of squared weights), with n_g - len(h) weights of 1
                self.misfit, self.freedom = level, left**2 / (left - float(h @ (1.0 - h)))
                self.levels[group] = level if self.probability < MIN_PROBABILITY else 1.0
        self._growth = self.levels / previous
        return self._growth
