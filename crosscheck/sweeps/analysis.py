"""Quantiles of what a sweep kept, and the shares that each varied parameter has in their variance."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.stats import rankdata

from crosscheck.sweeps.plan import Parameters
from crosscheck.sweeps.results import Results
from crosscheck.sweeps.sampling import Samples
from crosscheck.sweeps.store import missing
from newton_euler.scalars import Array

MOST_NUMBERS = 2**25
"""That are analyzed, 270 MB: of more runs than these are in, a sample."""

MOST_SCALARS = 200
"""Numbers of a run that are analyzed, the first."""

MOST_SHARED = 2**17
"""Runs that shares are estimated from, of Saltelli's plan its base samples: to half a per cent."""

BLOCK = 2**14
"""Runs that are read at a time."""

LEVELS = (0.0, 0.05, 0.5, 0.95, 1.0)
"""Of quantiles."""

MOST_BINS = 50
"""Of runs, by the values of a parameter."""

PER_BIN = 20
"""Runs in a bin at least, and for each coefficient of a regression."""

LEAST_BASE = 64
"""Base samples of Saltelli's plan: of fewer its estimates are no better than guesses."""

EXTREME = 0.1
"""Share of the runs with the smallest and the largest values of a parameter, whose means are compared."""

CONSTANT = 1e-9
"""Range of a number, by its magnitude, below which it varies by round-off alone."""


@dataclass(frozen=True, eq=False)
class Effect:
    """The effect of one parameter, or of several that are correlated, on a number.

    Attributes:
        name: of the parameter.
        share: of the number's variance that is explained by the parameter alone (a first-order Sobol index);
            None of too few runs.
        total: share that the parameter takes part in; None but for Saltelli's plan.
        error: half of a 95 % interval of the share; None but for Saltelli's plan.
        rank: Spearman's rank correlation; None of several parameters.
        low, high: mean of the number where the parameter is among its lowest and its highest tenth; of
            several parameters, where their regression is.
    """

    name: str
    share: float | None
    total: float | None
    error: float | None
    rank: float | None
    low: float
    high: float

    @property
    def size(self) -> float:
        """The share by which parameters are ordered: the larger of both, 0 if there is none."""
        return max(self.share or 0.0, self.total or 0.0)


@dataclass(frozen=True, eq=False)
class Scalar:
    """A number that is kept of each run.

    Attributes:
        variable: name of the array that it is in.
        place: where in the array of a run.
        names: of that place along each dimension, as a joint's.
        unit: of its values.
        values: (n,) of the runs that are analyzed, not a number where one could not go on.
        runs: (n,) the numbers of these runs.
    """

    variable: str
    place: tuple[int, ...]
    names: tuple[str, ...]
    unit: str
    values: Array
    runs: Array

    @property
    def label(self) -> str:
        """The variable and the place, as "peak:reaction_force slide_12"."""
        return " ".join([self.variable, *self.names])

    @cached_property
    def quantiles(self) -> Array:
        """Values below which the shares `LEVELS` of the runs lie; not a number if there are none."""
        known = self.values[np.isfinite(self.values)]
        return np.quantile(known, LEVELS) if len(known) else np.full(len(LEVELS), np.nan)

    @property
    def spread(self) -> float:
        """Distance of the outer quantiles but the extremes."""
        return float(self.quantiles[-2] - self.quantiles[1])

    @property
    def varies(self) -> bool:
        """False where all runs have the same number, but for round-off."""
        low, high = self.quantiles[[0, -1]]
        return bool(high - low > CONSTANT * max(abs(low), abs(high)))

    def extreme(self, largest: bool) -> int:
        """Return the run with the largest or the least value."""
        return int(self.runs[np.nanargmax(self.values) if largest else np.nanargmin(self.values)])


def thinned(count: int, most: int, block: int = 1) -> Array:
    """Choose blocks of consecutive runs, one at random from each of `most` parts of as many; all if so few.

    Returns:
        Numbers of runs, in their order.
    """
    blocks = count // block
    parts = min(blocks, most)
    edges = np.arange(parts + 1) * blocks // parts
    chosen = np.random.default_rng(parts).integers(edges[:-1], edges[1:])
    return np.asarray((block * chosen[:, None] + np.arange(block)).ravel())


def analyzed(swept: Results) -> Array:
    """Return the numbers of the runs that are analyzed."""
    kept = [swept.dataset[each.name] for each in swept.plan.kept]
    count = min(MOST_SCALARS, sum(int(np.prod(variable.shape[1:])) for variable in kept))
    block = swept.plan.samples.block
    return thinned(swept.plan.samples.runs, max(1, MOST_NUMBERS // max(1, count) // block), block)


def scalars(swept: Results) -> list[Scalar]:
    """Return the numbers that are kept of each run, in the order in which they are asked for."""
    found: list[Scalar] = []
    runs = analyzed(swept)
    for each in swept.plan.kept:
        variable = swept.dataset[each.name]
        places = list(np.ndindex(variable.shape[1:]))[: MOST_SCALARS - len(found)]
        columns = np.empty((len(places), len(runs)))
        for first in range(0, len(runs), BLOCK):
            part = variable[runs[first : first + BLOCK]].values
            columns[:, first : first + len(part)] = part.reshape(len(part), -1)[:, : len(places)].T
        for place, values in zip(places, columns, strict=True):
            names = (_label(variable, d, k) for d, k in zip(variable.dims[1:], place, strict=True))
            found.append(Scalar(each.name, place, tuple(names), each.unit, values, runs))
    return found


def _label(variable: object, dimension: str, place: int) -> str:
    found = variable.coords[dimension].values[place]  # type: ignore[attr-defined]
    return f"{found:g} s" if dimension.startswith("time") else str(found)


class Analysis:
    """The effects of what varied.

    Attributes:
        names: of parameters, or of several that are correlated, "a, b".
    """

    def __init__(self, samples: Samples, runs: Array, inputs: Callable[[Array], Parameters]) -> None:
        """Take the runs (n,) that are analyzed, and a function that returns the parameters of runs."""
        self._samples = samples
        self.names = [", ".join(names) for names, _ in samples.groups]
        self._places = thinned(len(runs), MOST_SHARED, samples.block)
        values = inputs(runs[self._places])
        self._inputs = [np.column_stack([values[name] for name in names]) for names, _ in samples.groups]

    def effects(self, scalar: Scalar) -> list[Effect]:
        """Return the effects on a number, the largest share first; empty if the number does not vary."""
        values = scalar.values[self._places]
        known = np.isfinite(values)
        y = values[known]
        if not scalar.varies or len(y) < PER_BIN or np.ptp(y) == 0.0:
            return []
        sobol = self._sobol(values) if self._samples.block > 1 else None
        found = []
        ranks = rankdata(y)
        for k, (name, inputs) in enumerate(zip(self.names, self._inputs, strict=True)):
            x, rank = inputs[known, 0], None
            if inputs.shape[1] > 1:
                x, share = _regression(inputs[known], y)
            else:
                share = _share(x, y)
                if np.ptp(x) > 0.0:
                    rank = float(np.corrcoef(rankdata(x), ranks)[0, 1])
            shares = sobol[k] if sobol else (share, None, None)
            found.append(Effect(name, *shares, rank, *_tenths(x, y)))
        return sorted(found, key=lambda effect: -effect.size)

    def _sobol(self, y: Array) -> list[tuple[float | None, float | None, float | None]]:
        """Estimate Sobol indices from Saltelli's plan by SALib: first order, total, and the first's error.

        The runs of a base sample are of use together alone.
        """
        try:
            from SALib.analyze import sobol
        except ImportError as error:
            raise missing(error) from error
        whole = np.isfinite(y).reshape(-1, self._samples.block).all(axis=1)
        y = y[np.repeat(whole, self._samples.block)]
        if whole.sum() < LEAST_BASE or np.ptp(y) == 0.0:
            return [(None, None, None)] * len(self.names)
        # numbers about zero, as the estimators of products need
        y = (y - y.mean()) / y.std()
        seed = self._samples.seed % 2**32
        found = sobol.analyze(self._samples.problem, y, calc_second_order=False, seed=seed)
        rows = zip(found["S1"], found["ST"], found["S1_conf"], strict=True)
        return [(float(first), float(total), float(error)) for first, total, error in rows]


def _bins(x: Array) -> Array:
    """Return the bin of each run by a parameter: as many runs in each, those of equal values in the same."""
    values, members, counts = np.unique(x, return_inverse=True, return_counts=True)
    if len(values) > MOST_BINS:
        bins = int(np.clip(len(x) // PER_BIN, 2, MOST_BINS))
        members = ((np.cumsum(counts) - 1) * bins // len(x))[members]
    return members


def _share(x: Array, y: Array) -> float:
    """Estimate the share of the variance of y that x explains alone, from any runs: of the means of bins.

    Of n runs in b bins the means of numbers that do not depend on x have a share of (b - 1)/(n - 1), which is
    taken off (the adjusted correlation ratio; E. Plischke, Reliability Engineering and System Safety 95,
    2010).
    """
    bins = _bins(x)
    counts, excesses = np.bincount(bins), np.bincount(bins, y - y.mean())
    there = counts > 0
    return _adjusted(float(np.sum(excesses[there] ** 2 / counts[there])), y, int(there.sum()))


def _adjusted(explained: float, y: Array, coefficients: int) -> float:
    n = len(y)
    if n <= coefficients:
        return 0.0
    unexplained = 1.0 - explained / float(np.sum((y - y.mean()) ** 2))
    return max(0.0, 1.0 - unexplained * (n - 1) / (n - coefficients))


def _regression(x: Array, y: Array) -> tuple[Array, float | None]:
    """Fit y (n,) by a polynomial of second order in parameters x (n, k), or of first in few runs or many.

    Returns:
        Its values (n,), and the share of the variance of y that it explains, as of bins; None in fewer runs.
    """
    n, k = x.shape
    x = x - x.mean(axis=0)
    x /= np.maximum(x.std(axis=0), np.finfo(float).tiny)
    terms = np.column_stack([np.ones(n), x])
    count = 1 + k + k * (k + 1) // 2
    if PER_BIN * count <= n <= MOST_NUMBERS // count:
        terms = np.column_stack([terms, *(x[:, i] * x[:, j] for i in range(k) for j in range(i + 1))])
    solution, _, rank, _ = np.linalg.lstsq(terms, y, rcond=None)
    fitted = terms @ solution
    share = _adjusted(float(np.sum((fitted - y.mean()) ** 2)), y, int(rank))
    return fitted, share if PER_BIN * rank <= n else None


def _tenths(x: Array, y: Array) -> tuple[float, float]:
    ordered = np.sort(x)
    count = max(1, int(EXTREME * len(x)))
    return float(y[x <= ordered[count - 1]].mean()), float(y[x >= ordered[-count]].mean())


def telling(found: list[Scalar]) -> list[Scalar]:
    """Choose one number for each variable: of those that vary the one with the largest magnitude."""
    chosen: dict[str, Scalar] = {}
    for scalar in found:
        name = scalar.variable
        size = np.max(np.abs(scalar.quantiles))
        if scalar.varies and (name not in chosen or size > np.max(np.abs(chosen[name].quantiles))):
            chosen[name] = scalar
    return list(chosen.values())
