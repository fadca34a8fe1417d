"""Noise of measured columns: given, or estimated from the residuals of a fit.

A fit absorbs a part of the noise. Let J be the derivatives of residuals with respect to parameters, in units
of the noise. The residuals are the noise minus its projection H = J (J^T J)^-1 J^T on the range of J. For a
part g of the columns with n_g numbers, the expected sum of squared residuals is n_g - tr H_gg:

- Noise that is not given is chosen so that the sum equals its expectation. Repeated with the new weights,
  this is restricted maximum likelihood (D. A. Harville, Journal of the American Statistical Association 72,
  1977).
- The squared residuals in units of given noise are a sum of chi-squared variables of one degree of freedom
  with weights 1 - h, where h are the eigenvalues of H_gg. A chi-squared distribution with the same first two
  moments replaces it (F. E. Satterthwaite, Biometrics Bulletin 2, 1946); exact if all noise is given.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from newton_euler.analysis.identification.measurements import Measurements
from newton_euler.scalars import Array

MIN_PROBABILITY = 1e-4
"""Probability of residuals as large as those of the fit, below which the scene is taken as wrong. Residuals
that noise does not explain move parameters by many of their standard deviations."""

FIRST_NOISE, MIN_NOISE = 1e-3, 1e-9
"""Noise that is not given, divided by the column's standard deviation: the first estimate, small enough to
correct bad initial values, and the least, the error of a run itself."""

MIN_LEFT_FRACTION = 1e-6
"""Fraction of a column's numbers left by the fit, below which residuals do not determine its noise."""

ROUGH_CHANGE, FINAL_CHANGE = 0.1, 0.01
"""Relative change of the noise from one fit to the next at which it has converged: first and second step."""


class Noise:
    """Standard deviations of measured columns.

    Attributes:
        unknown: (u,) names of the columns whose noise is not given in some run.
        levels: (1 + u,) factor of the given noise, 1 unless the scene is wrong; then unknown noise, SI.
        misfit: reduced chi: root of the squared residuals in units of the given noise, divided by their
            expectation. Not a number if the columns with given noise are too few to determine it.
        freedom: degrees of freedom of the misfit.
    """

    def __init__(self, runs: Sequence[Measurements]) -> None:
        self.misfit, self.freedom = math.nan, 0.0
        spread: dict[str, float] = {}
        for run in runs:
            for name in (name for name in run.columns if name not in run.noise):
                spread[name] = max(spread.get(name, 0.0), float(np.std(run.columns[name])))
        self.unknown = tuple(spread)
        columns = [(run, name) for run in runs for name in run.columns]
        sizes = [run.time.size for run, _ in columns]
        parts = [0 if name in run.noise else 1 + self.unknown.index(name) for run, name in columns]
        self._part = np.repeat(parts, sizes)
        self._unit = np.repeat([run.noise.get(name, 1.0) for run, name in columns], sizes)
        deviations = np.array([1.0, *(spread[name] or 1.0 for name in self.unknown)])
        self.levels, self._least = FIRST_NOISE * deviations, MIN_NOISE * deviations
        self.levels[0] = 1.0
        self._left = np.bincount(self._part, minlength=len(self.levels)).astype(float)
        self._growth = np.ones(len(self.levels))

    @property
    def deviations(self) -> Array:
        """(n,) standard deviations of all numbers, given or estimated."""
        return self._unit * np.where(self._part > 0, self.levels[self._part], 1.0)

    @property
    def effective(self) -> Array:
        """(n,) standard deviations that divide residuals; given noise is enlarged if the scene is wrong."""
        return self._unit * self.levels[self._part]

    @property
    def probability(self) -> float:
        """Probability that noise alone gives this misfit or a larger one; not a number without a misfit."""
        from scipy.special import chdtrc

        return float(chdtrc(self.freedom, self.freedom * self.misfit**2))

    @property
    def undetermined(self) -> tuple[str, ...]:
        """Names of columns whose noise the residuals do not determine.

        The fit leaves less than one of their numbers, or the noise does not converge.
        """
        is_open = (self._left < 1.0) | (np.abs(self._growth - 1.0) > ROUGH_CHANGE)
        return tuple(name for name, each in zip(self.unknown, is_open[1:], strict=True) if each)

    def estimate(self, residuals: Array, fitted: Array) -> Array:
        """Estimate the levels from the residuals of a fit; return their growth factors.

        Args:
            residuals: (n,) SI.
            fitted: (n, s) derivatives with respect to the fitted orthogonal combinations, each divided by its
                standard deviation, in units of the noise.
        """
        squares, before = (residuals / self.effective) ** 2, self.levels.copy()
        self.misfit, self.freedom = math.nan, 0.0
        for part in range(len(before)):
            own = self._part == part
            shares = np.clip(np.linalg.eigvalsh(fitted[own].T @ fitted[own]), 0.0, 1.0)
            left = np.count_nonzero(own) - float(shares.sum())
            self._left[part] = left
            if left <= MIN_LEFT_FRACTION * np.count_nonzero(own):
                continue
            level = before[part] * math.sqrt(float(squares[own].sum()) / left)
            if part > 0:
                self.levels[part] = max(level, self._least[part])
            else:
                self.misfit, self.freedom = level, left**2 / (left - float(shares @ (1.0 - shares)))
                self.levels[part] = level if self.probability < MIN_PROBABILITY else 1.0
        self._growth = self.levels / before
        return self._growth
