"""Quantiles of what a sweep kept, and the shares that each varied parameter has in their variance."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.stats import rankdata

from crosscheck.sweeps.results import Results
from crosscheck.sweeps.sampling import Samples
from crosscheck.sweeps.store import missing
from newton_euler.scalars import Array

MOST_NUMBERS = 2**25
"""That are analyzed, 270 MB: of more runs than these are in, the first."""

MOST_SCALARS = 200
"""Numbers of a run that are analyzed, the first."""

MOST_SHARED = 2**17
"""Runs that shares are estimated from, the first: to half a per cent."""

BLOCK = 2**14
"""Runs that are read at a time."""

LEVELS = (0.0, 0.05, 0.5, 0.95, 1.0)
"""Of quantiles."""

MOST_BINS = 50
"""Of runs, by the values of a parameter."""

PER_BIN = 20
"""Runs in a bin at least."""

EXTREME = 0.1
"""Share of the runs with the smallest and the largest values of a parameter, whose means are compared."""

CONSTANT = 1e-9
"""Range of a number, by its magnitude, below which it varies by round-off alone."""


@dataclass(frozen=True, eq=False)
class Effect:
    """The effect of one parameter, or of several that are correlated, on a number.

    Attributes:
        name: of the parameter.
        share: of the number's variance that is explained by the parameter alone (a first-order Sobol index).
        total: share that the parameter takes part in; None but for Saltelli's plan.
        error: half of a 95 % interval of the share; None but for Saltelli's plan.
        rank: Spearman's rank correlation; None of several parameters.
        low, high: mean of the number where the parameter is among its lowest and its highest tenth.
    """

    name: str
    share: float
    total: float | None
    error: float | None
    rank: float | None
    low: float
    high: float


@dataclass(frozen=True, eq=False)
class Scalar:
    """A number that is kept of each run.

    Attributes:
        variable: name of the array that it is in.
        place: where in the array of a run.
        names: of that place along each dimension, as a joint's.
        unit: of its values.
        values: (runs,), not a number where a run could not go on.
    """

    variable: str
    place: tuple[int, ...]
    names: tuple[str, ...]
    unit: str
    values: Array

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
        return int(np.nanargmax(self.values) if largest else np.nanargmin(self.values))


def analyzed(swept: Results) -> int:
    """Return the number of runs that are analyzed, the first."""
    kept = [swept.dataset[each.name] for each in swept.plan.kept]
    count = min(MOST_SCALARS, sum(int(np.prod(variable.shape[1:])) for variable in kept))
    return min(swept.plan.samples.runs, MOST_NUMBERS // max(1, count))


def scalars(swept: Results) -> list[Scalar]:
    """Return the numbers that are kept of each run, in the order in which they are asked for."""
    found: list[Scalar] = []
    runs = analyzed(swept)
    for each in swept.plan.kept:
        variable = swept.dataset[each.name]
        places = list(np.ndindex(variable.shape[1:]))[: MOST_SCALARS - len(found)]
        columns = np.empty((len(places), runs))
        for first in range(0, runs, BLOCK):
            part = variable[first : min(first + BLOCK, runs)].values
            columns[:, first : first + len(part)] = part.reshape(len(part), -1)[:, : len(places)].T
        for place, values in zip(places, columns, strict=True):
            names = (_label(variable, d, k) for d, k in zip(variable.dims[1:], place, strict=True))
            found.append(Scalar(each.name, place, tuple(names), each.unit, values))
    return found


def _label(variable: object, dimension: str, place: int) -> str:
    found = variable.coords[dimension].values[place]  # type: ignore[attr-defined]
    return f"{found:g} s" if dimension.startswith("time") else str(found)


class Analysis:
    """The effects of what varied.

    Attributes:
        names: of parameters, or of several that are correlated, "a, b".
    """

    def __init__(self, samples: Samples) -> None:
        self._samples = samples
        self.names = [", ".join(names) for names, _ in self._samples.groups]
        inputs = self._samples.values(0, min(self._samples.runs, MOST_SHARED))
        places = {name: k for k, name in enumerate(self._samples.names)}
        self._inputs = [inputs[:, [places[name] for name in names]] for names, _ in self._samples.groups]

    def effects(self, scalar: Scalar) -> list[Effect]:
        """Return the effects on a number, the largest share first; empty if the number does not vary."""
        values = scalar.values[: len(self._inputs[0])]
        known = np.isfinite(values)
        if not scalar.varies or np.sum(known) < PER_BIN:
            return []
        y = values[known]
        shares: list[tuple[float, float | None, float | None]]
        if self._samples.sampling == "saltelli" and np.isfinite(scalar.values).sum() == self._samples.runs:
            shares = self._sobol(scalar.values)
        else:
            shares = [(max(_share(column[known], y) for column in x.T), None, None) for x in self._inputs]
        found = []
        ranks = rankdata(y)
        for name, x, (share, total, error) in zip(self.names, self._inputs, shares, strict=True):
            column = x[known, 0]
            alone = x.shape[1] == 1 and np.ptp(column) > 0.0
            rank = float(np.corrcoef(rankdata(column), ranks)[0, 1]) if alone else None
            found.append(Effect(name, share, total, error, rank, *_tenths(column, y)))
        return sorted(found, key=lambda effect: -max(effect.share, effect.total or 0.0))

    def _sobol(self, y: Array) -> list[tuple[float, float | None, float | None]]:
        """Estimate Sobol indices from Saltelli's plan by SALib: first order, total, and the first's error."""
        try:
            from SALib.analyze import sobol
        except ImportError as error:
            raise missing(error) from error
        # numbers about zero, as the estimators of products need
        y = (y - y.mean()) / y.std()
        seed = self._samples.seed % 2**32
        found = sobol.analyze(self._samples.problem, y, calc_second_order=False, seed=seed)
        rows = zip(found["S1"], found["ST"], found["S1_conf"], strict=True)
        return [(float(first), float(total), float(error)) for first, total, error in rows]


def _bins(x: Array) -> list[Array]:
    """Return runs in bins of as many each, by a parameter; those of equal values in the same."""
    values, members = np.unique(x, return_inverse=True)
    order = np.argsort(x, kind="stable")
    if len(values) <= MOST_BINS:
        edges = np.cumsum(np.bincount(members))[:-1]
    else:
        count = int(np.clip(len(x) // PER_BIN, 2, MOST_BINS))
        edges = np.linspace(0, len(x), count + 1).astype(int)[1:-1]
    return np.split(order, edges)


def _share(x: Array, y: Array) -> float:
    """Estimate the share of the variance of y that x explains alone, from any runs: of the means of bins.

    Of n runs in b bins the means of numbers that do not depend on x have a share of (b - 1)/(n - 1), which is
    taken off (the adjusted correlation ratio; E. Plischke, Reliability Engineering and System Safety 95,
    2010).
    """
    bins = _bins(x)
    n, b = len(y), len(bins)
    if b < 2 or n <= b:
        return 0.0
    means, counts = np.array([y[each].mean() for each in bins]), np.array([len(each) for each in bins])
    ratio = float(counts @ (means - y.mean()) ** 2 / np.sum((y - y.mean()) ** 2))
    return max(0.0, 1.0 - (1.0 - ratio) * (n - 1) / (n - b))


def _tenths(x: Array, y: Array) -> tuple[float, float]:
    order = np.argsort(x, kind="stable")
    count = max(1, int(EXTREME * len(x)))
    return float(y[order[:count]].mean()), float(y[order[-count:]].mean())


def telling(found: list[Scalar]) -> list[Scalar]:
    """Choose one number for each variable: of those that vary the one with the largest magnitude."""
    chosen: dict[str, Scalar] = {}
    for scalar in found:
        name = scalar.variable
        size = np.max(np.abs(scalar.quantiles))
        if scalar.varies and (name not in chosen or size > np.max(np.abs(chosen[name].quantiles))):
            chosen[name] = scalar
    return list(chosen.values())
