"""Statistics of a sweep: quantiles of kept outputs, rank correlations, and Sobol indices of parameters.

A sweep simulates one scene many times with sampled parameters. A kept output is a number or array that the
sweep stores of each run; its name is a variable of the stored dataset, and each of its elements is a scalar,
a `KeptNumber`. A first-order Sobol index is the fraction of the variance of a number that one parameter
explains alone; the reports name the index "share of variance".

`kept_numbers` reads the kept numbers, and `Analysis.effects` computes the effects of the parameters on one
of them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import zip_longest
from typing import Any

import numpy as np

from crosscheck.sweeps.plan import Parameters
from crosscheck.sweeps.results import SweepResults
from crosscheck.sweeps.sampling import SweepSamples
from crosscheck.sweeps.store import SWEEP_EXTRA
from newton_euler.optional_packages import optional_package
from newton_euler.scalars import Array

MAX_ANALYZED_NUMBERS = 2**25
"""Largest number of values (kept numbers times runs, 270 MB) that are analyzed. If a sweep has more, a sample
of its runs is analyzed."""

MAX_KEPT_NUMBERS = 200
"""Largest number of kept numbers of a run that are analyzed, divided equally among the kept outputs."""

MAX_SHARE_RUNS = 2**17
"""Largest number of runs from which Sobol indices are estimated by regression. The 95 % error of an index is
then about 0.005."""

MAX_SALTELLI_SAMPLES = 2**14
"""Largest number of base samples of Saltelli's design from which Sobol indices are estimated. The 95 % error
of an index is then about 0.01.

A base sample is a block of consecutive runs that vary one parameter at a time (A. Saltelli, Computer Physics
Communications 145, 2002).
"""

MAX_READ_NUMBERS = 2**20
"""Largest number of values that are read from the store at a time."""

QUANTILE_LEVELS = {"least": 0.0, "5 %": 0.05, "median": 0.5, "95 %": 0.95, "most": 1.0}
"""Probabilities of the reported quantiles, by name."""

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

SAME_SPREAD_RATIO = 1.1
"""Ratio of spreads (`KeptNumber.spread`) below which two numbers are considered to vary equally; such numbers
keep their order."""

MACHINE_EPSILON = float(np.finfo(float).eps)

MIN_VARIATION = 1e-9
"""Range of a number over all runs, relative to the magnitude of its variable, below which the number is
considered constant."""


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


@dataclass(frozen=True, eq=False)
class KeptNumber:
    """One number that is kept of each run: an element of a kept output.

    Attributes:
        variable: name of the kept output.
        index: index of the number in the kept output's array of a run; empty if that is a single number.
        index_labels: labels of the index along each dimension, for example the name of a joint.
        unit: unit of the values.
        values: (n,) values in the analyzed runs; NaN for failed runs.
        runs: (n,) indices of the analyzed runs in the sweep.
        typical_magnitude: median over runs of the largest magnitude in the kept output's array, in `unit`.
        depends_on_reactions: True if the number depends on constraint forces.
    """

    variable: str
    index: tuple[int, ...]
    index_labels: tuple[str, ...]
    unit: str
    values: Array
    runs: Array
    typical_magnitude: float = 0.0
    depends_on_reactions: bool = False

    @property
    def label(self) -> str:
        """Variable and index labels, as "peak:reaction_force slide_12"."""
        return " ".join([self.variable, *self.index_labels])

    @property
    def heading(self) -> str:
        """Label with unit."""
        return with_unit(self.label, self.unit)

    def scale(self, numbers: Array) -> float:
        """Return the magnitude to which relative errors of a run refer, in `unit`.

        It is the largest magnitude in the run, at least `typical_magnitude`, and at least 1 for lengths, m,
        angles, rad, times, s, and pure numbers.

        Args:
            numbers: the whole array of the kept output in that run.
        """
        lower_bound = max(self.typical_magnitude, 1.0 if self.unit in ("m", "rad", "1", "s") else 0.0)
        return float(np.max(np.abs(numbers), initial=lower_bound, where=np.isfinite(numbers)))

    @cached_property
    def quantiles(self) -> Array:
        """Quantiles at `QUANTILE_LEVELS` over the successful runs; NaN if all runs failed."""
        known = self.values[np.isfinite(self.values)]
        return (
            np.quantile(known, list(QUANTILE_LEVELS.values()))
            if len(known)
            else np.full(len(QUANTILE_LEVELS), np.nan)
        )

    @cached_property
    def deviation(self) -> float:
        """Standard deviation over the successful runs; 0 if all runs failed."""
        known = self.values[np.isfinite(self.values)]
        largest = float(np.max(np.abs(known), initial=0.0))
        # scaled, so that squares do not overflow
        return largest * float((known / largest).std()) if largest else 0.0

    @property
    def spread(self) -> float:
        """Difference between the 95 % and the 5 % quantile, robust against a few extreme runs."""
        return float(self.quantiles[3] - self.quantiles[1])

    @property
    def varies(self) -> bool:
        """False if the number is constant up to round-off."""
        low, high = self.quantiles[[0, -1]]
        return bool(high - low > MIN_VARIATION * max(abs(low), abs(high), self.typical_magnitude))

    def extreme(self, largest: bool) -> int:
        """Return the index of the run with the largest value, or of that with the smallest one."""
        return int(self.runs[np.nanargmax(self.values) if largest else np.nanargmin(self.values)])


def with_unit(label: str, unit: str) -> str:
    """Append a unit to a label, unless the unit is empty or "1"."""
    return f"{label}, {unit}" if unit not in ("", "1") else label


def sample_blocks(count: int, most: int, block: int = 1) -> Array:
    """Choose a sample of runs that is spread evenly over all runs.

    The runs are divided into at most `most` equal parts, and one block is drawn at random from each part. The
    random numbers are the same in each call.

    Args:
        count: number of runs.
        most: largest number of blocks in the sample.
        block: number of consecutive runs that stay together.

    Returns:
        (n,) indices of the sampled runs, ascending.
    """
    blocks = count // block
    parts = min(blocks, most)
    edges = np.arange(parts + 1) * blocks // parts
    chosen = np.random.default_rng(parts).integers(edges[:-1], edges[1:])
    return np.asarray((block * chosen[:, None] + np.arange(block)).ravel())


def analyzed(swept: SweepResults) -> Array:
    """Return the indices (n,) of the runs that are analyzed: all, or a sample if there are too many."""
    numbers_per_run = sum(len(_analyzed_indices(swept, each.name)) for each in swept.plan.kept)
    block = swept.plan.samples.block
    most_blocks = max(1, MAX_ANALYZED_NUMBERS // numbers_per_run // block)
    return sample_blocks(swept.plan.samples.runs, most_blocks, block)


def _analyzed_indices(swept: SweepResults, name: str) -> Array:
    """Return the flat indices of a kept output's array of a run that are analyzed, evenly spaced."""
    size = int(np.prod(swept.dataset[name].shape[1:]))
    most = max(1, MAX_KEPT_NUMBERS // len(swept.plan.kept))
    return np.linspace(0, size - 1, min(size, most)).round().astype(int)


def kept_numbers(swept: SweepResults) -> list[KeptNumber]:
    """Read the kept numbers that are analyzed, in the order of the plan's kept outputs."""
    found: list[KeptNumber] = []
    runs = analyzed(swept)
    for each in swept.plan.kept:
        variable = swept.dataset[each.name]  # an xarray DataArray (runs, ...)
        flat_indices = _analyzed_indices(swept, each.name)
        # read some runs at a time; each row of `rows` has the values of one number in all runs
        rows = np.empty((len(flat_indices), len(runs)))
        runs_per_read = max(1, MAX_READ_NUMBERS // int(np.prod(variable.shape[1:])))
        for first in range(0, len(runs), runs_per_read):
            part = swept.read(each.name, runs[first : first + runs_per_read])
            rows[:, first : first + len(part)] = part.reshape(len(part), -1)[:, flat_indices].T
        # the typical magnitude of the variable, over the runs that did not fail
        known = rows[:, np.isfinite(rows).any(axis=0)]
        largest = np.max(np.abs(known), axis=0, initial=0.0, where=np.isfinite(known))
        typical_magnitude = float(np.median(largest)) if len(largest) else 0.0
        for flat, values in zip(flat_indices, rows, strict=True):
            index = tuple(map(int, np.unravel_index(flat, variable.shape[1:])))
            found.append(
                KeptNumber(
                    variable=each.name,
                    index=index,
                    index_labels=tuple(
                        _label(variable, d, k) for d, k in zip(variable.dims[1:], index, strict=True)
                    ),
                    unit=each.unit,
                    values=values,
                    runs=runs,
                    typical_magnitude=typical_magnitude,
                    depends_on_reactions=each.depends_on_reactions,
                )
            )
    return found


def _label(variable: object, dimension: str, k: int) -> str:
    """Return the label of index k along a dimension, such as the name of a joint; times with their unit."""
    found = variable.coords[dimension].values[k]  # type: ignore[attr-defined]
    return f"{found:g} s" if dimension.startswith("time") else str(found)


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
            f"too few runs for shares of variance: {runs:,}; needed: {least:,} or more"
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


@np.errstate(all="ignore")  # spreads can be 0 or NaN
def most_varying(found: Sequence[KeptNumber]) -> list[KeptNumber]:
    """Sort numbers by spread: first the largest number of each variable, then the second largest, and so on.

    Numbers with similar spreads keep their order, so that additional runs of a sweep do not change the order.
    """
    of_variable: dict[str, list[KeptNumber]] = {}
    for scalar in found:
        of_variable.setdefault(scalar.variable, []).append(scalar)
    for name, members in of_variable.items():
        spreads = np.array([scalar.spread for scalar in members])
        largest = np.max(spreads, initial=0.0, where=np.isfinite(spreads))
        steps = np.floor(np.log(largest / spreads) / np.log(SAME_SPREAD_RATIO))
        of_variable[name] = [members[k] for k in np.argsort(steps, kind="stable")]
    return [scalar for place in zip_longest(*of_variable.values()) for scalar in place if scalar is not None]


def most_informative(found: Sequence[KeptNumber]) -> list[KeptNumber]:
    """Choose one number of each variable: the one that varies most."""
    varying = [scalar for scalar in found if scalar.varies]
    return most_varying(varying)[: len({scalar.variable for scalar in varying})]
