"""Sensitivity analysis of a sweep: rank correlations and Sobol indices of its parameters.

A sweep simulates one scene many times with sampled parameters, and keeps some numbers of each run.
`Analysis.effects` computes the effects of the parameters on one of these numbers. A first-order Sobol index
is the fraction of the variance of a number that one parameter explains alone; the reports name the index
"share of variance".
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from crosscheck.sweeps.kept_numbers import MAX_ANALYZED_NUMBERS, KeptNumber, sample_blocks
from crosscheck.sweeps.plan import Parameters
from crosscheck.sweeps.sampling import SweepSamples
from crosscheck.sweeps.store import SWEEP_EXTRA
from newton_euler.optional_packages import optional_package
from newton_euler.scalars import Array

MAX_SHARE_RUNS = 2**17
"""Largest number of runs from which Sobol indices are estimated by regression. The 95 % error of an index is
then about 0.005."""

MAX_SALTELLI_SAMPLES = 2**14
"""Largest number of base samples of Saltelli's design from which Sobol indices are estimated. The 95 % error
of an index is then about 0.01.

A base sample is a block of consecutive runs that vary one parameter at a time (A. Saltelli, Computer Physics
Communications 145, 2002).
"""

MAX_POLYNOMIAL_TERMS = 25
"""Largest number of terms of the polynomial that estimates a first-order Sobol index."""

RUNS_PER_TERM = 20
"""Smallest number of runs for each term of the polynomial."""

MIN_SALTELLI_SAMPLES = 64
"""Smallest number of base samples of Saltelli's design for a usable estimate."""

MIN_SHARE_RUNS = 400
"""Smallest number of runs for Sobol indices by regression; their 95 % error is then about 0.1. With fewer
runs only rank correlations are reported."""

MIN_RANK_RUNS = 4
"""Smallest number of runs for the error of a rank correlation, whose variance has the divisor n - 3."""

NORMAL_QUANTILE_95 = 1.96
"""Half width of a 95 % confidence interval in standard errors."""

TAIL_FRACTION = 0.1
"""Fraction of the runs with the smallest (or largest) values of a parameter.

The tornado chart shows the means of a number over these runs.
"""

MACHINE_EPSILON = float(np.finfo(float).eps)


@dataclass(frozen=True, eq=False)
class Effect:
    """Effect of one parameter, or of a group of correlated parameters, on a kept number.

    Attributes:
        name: name of the parameter, or names of the group as "a, b".
        low, high: means of the number over the runs with the lowest and highest tenth of the parameter. For a
            group, over the runs with the lowest and highest tenth of the group's regression.
        rank: Spearman's rank correlation; None for a group and for a constant parameter.
        rank_error: half width of the 95 % confidence interval of the rank.
        share: first-order Sobol index: fraction of the variance explained by the parameter alone; None if
            there are too few runs.
        error: half width of the 95 % confidence interval of the share.
        bounds: True if the share of a group is a lower bound, estimated by a linear or quadratic regression.
        total: total-effect Sobol index: fraction of the variance that the parameter explains alone and
            together with others. Only from Saltelli's design, else None.
    """

    name: str
    low: float
    high: float
    rank: float | None = None
    rank_error: float = 0.0
    share: float | None = None
    error: float = 0.0
    bounds: bool = False
    total: float | None = None

    @property
    def size(self) -> float:
        """Magnitude of the effect for sorting: Sobol index, or absolute rank without one."""
        if self.share is None:
            return abs(self.rank or 0.0)
        return max(self.share, self.total or 0.0)


class Analysis:
    """Sensitivity analysis of a sweep: the effects of its parameters on kept numbers.

    Attributes:
        names: names of the parameters; correlated parameters form one group, named "a, b".
    """

    def __init__(self, samples: SweepSamples, runs: Array, inputs: Callable[[Array], Parameters]) -> None:
        """Read the parameters of the analyzed runs, or of a sample if there are too many runs.

        Args:
            samples: values of the varied parameters in all runs, and how they were drawn. Its `block` is 1,
                or the number of runs of a base sample in Saltelli's design.
            runs: (n,) indices of the analyzed runs in the sweep.
            inputs: function that returns the parameters of given runs.
        """
        self._samples = samples
        self.names = [", ".join(names) for names, _distribution in samples.groups]
        most = MAX_SHARE_RUNS if samples.block == 1 else MAX_SALTELLI_SAMPLES
        self._used = sample_blocks(len(runs), most, samples.block)  # indices into the analyzed runs
        values = inputs(runs[self._used])
        # of each group of parameters, the values (n, parameters of the group)
        self._inputs = [
            np.column_stack([values[name] for name in names]) for names, _distribution in samples.groups
        ]

    @property
    def too_few(self) -> str:
        """Reason why the sweep has too few runs for Sobol indices; empty if it has enough.

        It is empty for a single parameter as well, whose index is 1.
        """
        block = self._samples.block
        if len(self.names) == 1:
            return ""
        runs, least = self._samples.runs, MIN_SALTELLI_SAMPLES * block if block > 1 else MIN_SHARE_RUNS
        return (
            f"no Sobol indices (shares of variance): {runs:,} runs; needed: --runs {least} or more"
            if runs < least
            else ""
        )

    def effects(self, scalar: KeptNumber) -> list[Effect]:
        """Return the effects of all parameters on a kept number, the largest first.

        The list is empty if the number is constant or if there are too few runs for rank correlations.
        """
        from scipy.stats import rankdata

        values = scalar.values[self._used]
        known = np.isfinite(values)
        y = values[known]
        # number of independent runs: two of each base sample, since its others combine their values
        independent = 2 * len(y) // self._samples.block if self._samples.block > 1 else len(y)
        if not scalar.varies or independent < MIN_RANK_RUNS or np.ptp(y) == 0.0:
            return []
        alone = len(self.names) == 1
        sobol = self._sobol(values) if self._samples.block > 1 and not alone else None
        found = []
        ranks = rankdata(y)
        for k, (name, inputs) in enumerate(zip(self.names, self._inputs, strict=True)):
            x, y_of_x = inputs[known, 0], y  # the tail means of y are taken over tails of x
            # attributes of the `Effect`: rank correlation; Sobol index by regression
            rank, estimate = dict[str, Any](), dict[str, Any]()
            if inputs.shape[1] > 1:  # a group of correlated parameters: x is its fitted value
                x, y_of_x, estimate = _regression(inputs[known], y)
            elif np.ptp(x) > 0.0:
                ranks_of_x = rankdata(x)
                rank = _rank_interval(float(np.corrcoef(ranks_of_x, ranks)[0, 1]), independent)
                estimate = {} if alone or sobol else _first_order_index(x, ranks_of_x, y)
            elif len(y) >= MIN_SHARE_RUNS:  # the parameter is constant
                estimate = {"share": 0.0}
            # a single parameter explains everything; Saltelli's design is better than a regression
            share: dict[str, Any] = {"share": 1.0} if alone else sobol[k] if sobol else estimate
            found.append(Effect(name, **_tail_means(x, y_of_x), **rank, **share))
        return sorted(found, key=lambda effect: -effect.size)

    def _sobol(self, y: Array) -> list[dict[str, Any]]:
        """Estimate first-order and total-effect Sobol indices from Saltelli's design by SALib.

        If a run of a base sample failed, the whole base sample is left out.

        Args:
            y: (n,) values of the number in whole base samples; NaN for failed runs.

        Returns:
            For each parameter or group, the attributes `share`, `total` and `error` of an `Effect`; empty
            for too few base samples.
        """
        sobol = optional_package("SALib.analyze.sobol", SWEEP_EXTRA)
        whole = np.isfinite(y).reshape(-1, self._samples.block).all(axis=1)
        y = y[np.repeat(whole, self._samples.block)]
        if whole.sum() < MIN_SALTELLI_SAMPLES or np.ptp(y) == 0.0:
            return [{}] * len(self.names)
        # the estimators use products, so that values must be centered
        y = (y - y.mean()) / y.std()
        seed = self._samples.seed % (2**32 - 1) + 1  # SALib ignores the seed 0
        size = len(self.names)
        problem = {"num_vars": size, "names": self.names, "bounds": [[0.0, 1.0]] * size}
        found = sobol.analyze(problem, y, calc_second_order=False, seed=seed)
        return [
            {"share": float(first), "total": float(total), "error": float(error)}
            for first, total, error in zip(found["S1"], found["ST"], found["S1_conf"], strict=True)
        ]


def _rank_interval(rank: float, runs: int) -> dict[str, Any]:
    """Estimate the 95 % interval of a rank correlation (Bonett and Wright, Psychometrika 65, 2000).

    Returns:
        The attributes `rank` and `rank_error` of an `Effect`.
    """
    # Fisher's z = artanh(rank) is nearly normal with the variance (1 + rank^2 / 2) / (n - 3)
    half = NORMAL_QUANTILE_95 * np.sqrt((1.0 + 0.5 * rank**2) / (runs - MIN_RANK_RUNS + 1))
    middle = np.arctanh(np.clip(rank, -1.0 + MACHINE_EPSILON, 1.0 - MACHINE_EPSILON))
    return {"rank": rank, "rank_error": float(0.5 * (np.tanh(middle + half) - np.tanh(middle - half)))}


def _first_order_index(x: Array, ranks: Array, y: Array) -> dict[str, Any]:
    """Estimate the first-order Sobol index of x (n,) on y (n,) from any runs, by a polynomial regression.

    The terms are x itself and Legendre polynomials of the ranks of x, which are robust against outliers. The
    number of terms minimizes generalized cross-validation (G. Golub et al., Technometrics 21, 1979).

    Args:
        x: (n,) values of the parameter.
        ranks: (n,) ranks of x.
        y: (n,) values of the number.

    Returns:
        The attributes `share` and `error` of an `Effect`; empty for too few runs.
    """
    n, distinct_values = len(y), len(np.unique(ranks))
    if n < MIN_SHARE_RUNS:
        return {}
    most = min(n // RUNS_PER_TERM, MAX_POLYNOMIAL_TERMS, distinct_values)
    terms = np.polynomial.legendre.legvander((2.0 * ranks - 1.0) / n - 1.0, most - 1)
    terms[:, 1] = (x - x.mean()) / x.std()
    y = y - y.mean()
    # R of [terms, y] = Q R: its last column has the components of y along the orthogonalized terms
    triangle = np.asarray(np.linalg.qr(np.column_stack([terms, y]), mode="r"))
    # sums of squared residuals after a fit by the first term, the first two terms, and so on
    remaining = np.cumsum(triangle[::-1, -1] ** 2)[-2::-1]
    freedom = n - np.arange(1, most + 1)  # degrees of freedom of the residuals
    count = int(np.argmin(remaining / freedom**2)) + 1
    fitted = terms[:, :count] @ np.linalg.solve(triangle[:count, :count], triangle[:count, -1])
    share, error = _adjusted_r_squared(y - fitted, y, count, most)
    if most < distinct_values:
        # truncation of the polynomial: if y has a step or a kink, further terms would explain about as much
        # as the second half of the terms did
        half, whole = (remaining / freedom)[[most // 2 - 1, -1]] / (remaining / freedom)[0]
        error += max(0.0, float(half - whole))
    return {"share": share, "error": error}


def _adjusted_r_squared(residuals: Array, y: Array, coefficients: int, tried: int) -> tuple[float, float]:
    """Return the adjusted coefficient of determination R^2 of a regression, and its 95 % error.

    1 - R^2 is a ratio of two means over runs, whose variance follows by linearization, for any distribution
    of y. The variance from the choice of the coefficients, 2 (1 - R^2)^2 (tried - 1) / n^2, is added.

    Args:
        residuals: (n,) y minus fitted values.
        y: (n,) values.
        coefficients: number of coefficients of the regression.
        tried: number of coefficients of the largest regression that was tried.
    """
    n, squares, squares_of_y = len(y), residuals**2, (y - y.mean()) ** 2
    unexplained = squares.sum() / squares_of_y.sum()
    share = max(0.0, 1.0 - unexplained * (n - 1) / max(1, n - coefficients))
    variance = np.mean(((squares - unexplained * squares_of_y) / squares_of_y.mean()) ** 2) / n
    variance += 2.0 * (1.0 - share) ** 2 * (tried - 1) / n**2
    return float(share), float(NORMAL_QUANTILE_95 * variance**0.5)


def _regression(x: Array, y: Array) -> tuple[Array, Array, dict[str, Any]]:
    """Fit y (n,) by a quadratic polynomial of parameters x (n, k); by a linear one if there are few runs.

    Returns:
        Fitted values and y of the same runs: a sample if all runs do not fit into memory. Then the attributes
        `share`, `error` and `bounds` of an `Effect`; empty for too few runs.
    """
    k = x.shape[1]
    count = 1 + k + k * (k + 1) // 2  # number of coefficients
    if RUNS_PER_TERM * count > min(len(y), MAX_ANALYZED_NUMBERS // count):
        count = 1 + k
    chosen = sample_blocks(len(y), MAX_ANALYZED_NUMBERS // count)
    x, y = x[chosen], y[chosen]
    x = x - x.mean(axis=0)
    x /= np.maximum(x.std(axis=0), np.finfo(float).tiny)
    terms = np.column_stack([np.ones(len(y)), x])
    if count > terms.shape[1]:
        terms = np.column_stack([terms, *(x[:, i] * x[:, j] for i in range(k) for j in range(i + 1))])
    solution, _, rank, _ = np.linalg.lstsq(terms, y, rcond=None)
    fitted = terms @ solution
    if len(y) < max(MIN_SHARE_RUNS, RUNS_PER_TERM * rank):
        return fitted, y, {}
    share, error = _adjusted_r_squared(y - fitted, y, int(rank), int(rank))
    return fitted, y, {"share": share, "error": error, "bounds": True}


def _tail_means(x: Array, y: Array) -> dict[str, Any]:
    """Return the means of y (n,) over the runs with the lowest and with the highest tenth of x (n,)."""
    ordered = np.sort(x)
    count = max(1, int(TAIL_FRACTION * len(x)))
    low, high = y[x <= ordered[count - 1]], y[x >= ordered[-count]]
    return {"low": float(low.mean()), "high": float(high.mean())}
