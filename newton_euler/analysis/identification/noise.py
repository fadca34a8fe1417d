"""Noise of measured columns: given, or estimated from the residuals of a fit.

A fit takes a share of the noise: with the derivatives J of residuals by parameters, in units of the noise,
residuals are the noise less its projection H = J (J^T J)^-1 J^T on what parameters can do. The squares of the
residuals of a part g of the columns, n_g numbers, are expected to be n_g - tr H_gg, each part less its own
share:

- Noise that is not given is such that they are. Repeated with the weights that follow from it, it is that of
  restricted maximum likelihood (D. A. Harville, Journal of the American Statistical Association 72, 1977).
- Squares of residuals in units of given noise are a sum of chi squared of one degree of freedom, weighted
  with 1 - h by the eigenvalues h of H_gg. By its first two moments it is distributed as chi squared of other
  degrees of freedom (F. E. Satterthwaite, Biometrics Bulletin 2, 1946), exactly if all noise is given.
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
        unknown: (u,) names of the columns whose noise is not given, the same in all runs that do not give it.
        levels: (1 + u,) given noise in units of what was given, 1 unless the scene is wrong, and unknown
            noise, SI.
        misfit: root of the squares of residuals in units of the given noise, by what they are expected to be;
            not a number if residuals of columns with given noise do not tell.
        freedom: degrees of freedom of these squares.
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
        """(n,) of all numbers, given or estimated."""
        return self._unit * np.where(self._part > 0, self.levels[self._part], 1.0)

    @property
    def effective(self) -> Array:
        """(n,) that residuals are weighted by; given noise is as large as these if the scene is wrong."""
        return self._unit * self.levels[self._part]

    @property
    def probability(self) -> float:
        """That of a misfit as large or larger by chance alone; not a number if there is none."""
        from scipy.special import chdtrc

        return float(chdtrc(self.freedom, self.freedom * self.misfit**2))

    @property
    def undetermined(self) -> tuple[str, ...]:
        """Names of columns whose noise residuals do not tell.

        A fit leaves less than one of their numbers, or the noise differs from fit to fit.
        """
        is_open = (self._left < 1.0) | (np.abs(self._growth - 1.0) > ROUGH_CHANGE)
        return tuple(name for name, each in zip(self.unknown, is_open[1:], strict=True) if each)

    def estimate(self, residuals: Array, fitted: Array) -> Array:
        """Estimate levels from the residuals of a fit; returns by how much they have grown.

        Args:
            residuals: (n,) SI.
            fitted: (n, s) derivatives by what was fitted, orthogonal combinations by their standard
                deviations, in units of the noise.
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
