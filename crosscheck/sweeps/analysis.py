"""Quantiles of what a sweep kept, and how each varied parameter bears on it: ranks, shares of variance."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import zip_longest
from typing import Any

import numpy as np

from crosscheck.sweeps.plan import Parameters
from crosscheck.sweeps.results import Results
from crosscheck.sweeps.sampling import Samples
from crosscheck.sweeps.store import SWEEP
from newton_euler.optional_packages import optional_package
from newton_euler.scalars import Array

MOST_NUMBERS = 2**25
"""That are analyzed, 270 MB: of more runs than these are in, a sample."""

MOST_SCALARS = 200
"""Numbers of a run that are analyzed: as many of each variable at most, evenly spread over its places."""

MOST_SHARED, MOST_BASE = 2**17, 2**14
"""Runs that shares are estimated from, and base samples of Saltelli's plan: to 0.5 % and to 1 %."""

BLOCK = 2**20
"""Numbers that are read at a time."""

LEVELS = {"least": 0.0, "5 %": 0.05, "median": 0.5, "95 %": 0.95, "most": 1.0}
"""Shares of the runs below quantiles, by their names."""

MOST_TERMS = 25
"""Of the polynomial that tells what a parameter explains."""

PER_TERM = 20
"""Runs for each term of a polynomial at least."""

LEAST_BASE = 64
"""Base samples of Saltelli's plan: of fewer its estimates are no better than guesses."""

LEAST_SHARED = 400
"""Runs of which a share is known to 10 %: of fewer there are no shares, but ranks."""

LEAST_RANKED = 4
"""Runs that the error of a rank correlation is estimated from."""

TWO_SIDED = 1.96
"""Standard errors that a 95 % interval has to either side."""

EXTREME = 0.1
"""Share of the runs with the smallest and the largest values of a parameter, whose means are compared."""

ALIKE = 1.1
"""Ratio of ranges below which numbers of a variable vary alike: which one more is a matter of the samples."""

EPSILON = float(np.finfo(float).eps)

CONSTANT = 1e-9
"""Range of a number, by the magnitude of its variable, below which it varies by errors of runs alone."""


@dataclass(frozen=True, eq=False)
class Effect:
    """The effect of one parameter, or of several that are correlated, on a number.

    Attributes:
        name: of the parameter.
        low, high: mean of the number where the parameter is among its lowest and its highest tenth; of
            several parameters, where their regression is.
        rank: Spearman's rank correlation; None of several parameters.
        rank_error: half of a 95 % interval of the rank.
        share: of the number's variance that is explained by the parameter alone (a first-order Sobol index);
            None of too few runs.
        error: half of a 95 % interval of the share.
        bounds: whether the share may be larger, as a polynomial of second order explains that much.
        total: share that the parameter takes part in; None but for Saltelli's plan.
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
        """The order of effects: the share, or the magnitude of the rank where there is none."""
        if self.share is None:
            return abs(self.rank or 0.0)
        return max(self.share, self.total or 0.0)


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
        usual: median over runs of the variable's largest magnitude, beside which a number is round-off.
        reacts: whether it depends on forces of constraints.
    """

    variable: str
    place: tuple[int, ...]
    names: tuple[str, ...]
    unit: str
    values: Array
    runs: Array
    usual: float = 0.0
    reacts: bool = False

    @property
    def label(self) -> str:
        """The variable and the place, as "peak:reaction_force slide_12"."""
        return " ".join([self.variable, *self.names])

    @property
    def heading(self) -> str:
        """The label with the unit."""
        return with_unit(self.label, self.unit)

    def scale(self, numbers: Array) -> float:
        """Return what errors in a run are shares of: the largest of its numbers of the variable.

        A usual run's at least, and of lengths, angles and times 1 SI unit.
        """
        least = max(self.usual, 1.0 if self.unit in ("m", "rad", "1", "s") else 0.0)
        return float(np.max(np.abs(numbers), initial=least, where=np.isfinite(numbers)))

    @cached_property
    def quantiles(self) -> Array:
        """Values below which the shares `LEVELS` of the runs lie; not a number if there are none."""
        known = self.values[np.isfinite(self.values)]
        return np.quantile(known, list(LEVELS.values())) if len(known) else np.full(len(LEVELS), np.nan)

    @cached_property
    def deviation(self) -> float:
        """Standard deviation of the runs that came to their end; 0 if there are none."""
        known = self.values[np.isfinite(self.values)]
        largest = float(np.max(np.abs(known), initial=0.0))
        return largest * float((known / largest).std()) if largest else 0.0  # whose squares may be too large

    @property
    def spread(self) -> float:
        """The range that 90 % of the runs are in, which a few extreme ones do not change."""
        return float(self.quantiles[3] - self.quantiles[1])

    @property
    def varies(self) -> bool:
        """False where all runs have the same number, but for round-off."""
        low, high = self.quantiles[[0, -1]]
        return bool(high - low > CONSTANT * max(abs(low), abs(high), self.usual))

    def extreme(self, largest: bool) -> int:
        """Return the run with the largest or the least value."""
        return int(self.runs[np.nanargmax(self.values) if largest else np.nanargmin(self.values)])


def with_unit(label: str, unit: str) -> str:
    """Put a unit after a label, if there is one."""
    return f"{label}, {unit}" if unit not in ("", "1") else label


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
    count = sum(len(_places(swept, each.name)) for each in swept.plan.kept)
    block = swept.plan.samples.block
    return thinned(swept.plan.samples.runs, max(1, MOST_NUMBERS // count // block), block)


def _places(swept: Results, name: str) -> Array:
    """Return the places of a variable that are analyzed, counted through its arrays."""
    size = int(np.prod(swept.dataset[name].shape[1:]))
    most = max(1, MOST_SCALARS // len(swept.plan.kept))
    return np.linspace(0, size - 1, min(size, most)).round().astype(int)


def scalars(swept: Results) -> list[Scalar]:
    """Return the numbers that are kept of each run, in the order in which they are asked for."""
    found: list[Scalar] = []
    runs = analyzed(swept)
    for each in swept.plan.kept:
        variable = swept.dataset[each.name]
        places = _places(swept, each.name)
        columns = np.empty((len(places), len(runs)))
        block = max(1, BLOCK // int(np.prod(variable.shape[1:])))
        for first in range(0, len(runs), block):
            part = swept.read(each.name, runs[first : first + block])
            columns[:, first : first + len(part)] = part.reshape(len(part), -1)[:, places].T
        known = columns[:, np.isfinite(columns).any(axis=0)]
        largest = np.max(np.abs(known), axis=0, initial=0.0, where=np.isfinite(known))
        usual = float(np.median(largest)) if len(largest) else 0.0
        for flat, values in zip(places, columns, strict=True):
            place = tuple(map(int, np.unravel_index(flat, variable.shape[1:])))
            names = tuple(_label(variable, d, k) for d, k in zip(variable.dims[1:], place, strict=True))
            found.append(Scalar(each.name, place, names, each.unit, values, runs, usual, each.reacts))
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
        most = MOST_SHARED if samples.block == 1 else MOST_BASE
        self._places = thinned(len(runs), most, samples.block)
        values = inputs(runs[self._places])
        self._inputs = [np.column_stack([values[name] for name in names]) for names, _ in samples.groups]

    @property
    def too_few(self) -> str:
        """The reason why there are no shares; empty if there are, as that of a single parameter: all."""
        block = self._samples.block
        if len(self.names) == 1:
            return ""
        runs, least = self._samples.runs, LEAST_BASE * block if block > 1 else LEAST_SHARED
        return f"too few runs for shares of variance: {runs:,}; at least {least:,}" if runs < least else ""

    def effects(self, scalar: Scalar) -> list[Effect]:
        """Return the effects on a number, the largest first; empty if it does not vary, or in three runs."""
        from scipy.stats import rankdata

        values = scalar.values[self._places]
        known = np.isfinite(values)
        y = values[known]
        # most runs of Saltelli's plan repeat numbers of others
        independent = 2 * len(y) // self._samples.block if self._samples.block > 1 else len(y)
        if not scalar.varies or independent < LEAST_RANKED or np.ptp(y) == 0.0:
            return []
        alone = len(self.names) == 1
        sobol = self._sobol(values) if self._samples.block > 1 and not alone else None
        found = []
        ranks = rankdata(y)
        for k, (name, inputs) in enumerate(zip(self.names, self._inputs, strict=True)):
            x, own = inputs[known, 0], y
            rank, share = dict[str, Any](), dict[str, Any]()
            if inputs.shape[1] > 1:
                x, own, share = _regression(inputs[known], y)
            elif np.ptp(x) > 0.0:
                of_x = rankdata(x)
                rank = _rank(float(np.corrcoef(of_x, ranks)[0, 1]), independent)
                share = {} if alone or sobol else _share(x, of_x, y)
            elif len(y) >= LEAST_SHARED:
                share = {"share": 0.0}
            shares: dict[str, Any] = {"share": 1.0} if alone else sobol[k] if sobol else share
            found.append(Effect(name, **_tenths(x, own), **rank, **shares))
        return sorted(found, key=lambda effect: -effect.size)

    def _sobol(self, y: Array) -> list[dict[str, Any]]:
        """Estimate Sobol indices from Saltelli's plan by SALib: first order, total, and the first's error.

        The runs of a base sample are of use together alone.
        """
        sobol = optional_package("SALib.analyze.sobol", SWEEP)
        whole = np.isfinite(y).reshape(-1, self._samples.block).all(axis=1)
        y = y[np.repeat(whole, self._samples.block)]
        if whole.sum() < LEAST_BASE or np.ptp(y) == 0.0:
            return [{}] * len(self.names)
        # numbers about zero, as the estimators of products need
        y = (y - y.mean()) / y.std()
        seed = self._samples.seed % (2**32 - 1) + 1  # of 0 it would make none
        size = len(self.names)
        problem = {"num_vars": size, "names": self.names, "bounds": [[0.0, 1.0]] * size}
        found = sobol.analyze(problem, y, calc_second_order=False, seed=seed)
        return [
            {"share": float(first), "total": float(total), "error": float(error)}
            for first, total, error in zip(found["S1"], found["ST"], found["S1_conf"], strict=True)
        ]


def _rank(rank: float, runs: int) -> dict[str, Any]:
    """Estimate the 95 % interval of a rank correlation (Bonett and Wright, Psychometrika 65, 2000)."""
    half = TWO_SIDED * np.sqrt((1.0 + 0.5 * rank**2) / (runs - LEAST_RANKED + 1))
    middle = np.arctanh(np.clip(rank, -1.0 + EPSILON, 1.0 - EPSILON))
    return {"rank": rank, "rank_error": float(0.5 * (np.tanh(middle + half) - np.tanh(middle - half)))}


def _share(x: Array, ranks: Array, y: Array) -> dict[str, Any]:
    """Estimate the share of the variance of y that x explains alone, from any runs: by a polynomial.

    Its terms are x, as trends are of values, and Legendre polynomials of the ranks of x, which a few runs far
    out do not bend; of few values as many as these. Those from the first on are taken that predict best, by
    generalized cross-validation (G. Golub et al., Technometrics 21, 1979).
    """
    n, values = len(y), len(np.unique(ranks))
    if n < LEAST_SHARED:
        return {}
    most = min(n // PER_TERM, MOST_TERMS, values)
    terms = np.polynomial.legendre.legvander((2.0 * ranks - 1.0) / n - 1.0, most - 1)
    terms[:, 1] = (x - x.mean()) / x.std()
    y = y - y.mean()
    triangle = np.asarray(np.linalg.qr(np.column_stack([terms, y]), mode="r"))
    # sums of squares that the first term, the first two and so on do not explain
    left = np.cumsum(triangle[::-1, -1] ** 2)[-2::-1]
    freedom = n - np.arange(1, most + 1)
    count = int(np.argmin(left / freedom**2)) + 1
    fitted = terms[:, :count] @ np.linalg.solve(triangle[:count, :count], triangle[:count, -1])
    share, error = _adjusted(y - fitted, y, count, most)
    if most < values:
        # of a step, or a bend, more terms add as much as the second half of these
        half, whole = (left / freedom)[[most // 2 - 1, -1]] / (left / freedom)[0]
        error += max(0.0, float(half - whole))
    return {"share": share, "error": error}


def _adjusted(residuals: Array, y: Array, coefficients: int, tried: int) -> tuple[float, float]:
    """Return the share of the variance of y (n,) that is not in the residuals, and its error.

    Coefficients that explain nothing take their part of the residuals, which is given back (adjusted R^2).
    The error is that of a ratio of two means over runs, whatever y is distributed as, and that of as many
    squares of noise as coefficients were tried.
    """
    n, squares, own = len(y), residuals**2, (y - y.mean()) ** 2
    unexplained = squares.sum() / own.sum()
    share = max(0.0, 1.0 - unexplained * (n - 1) / max(1, n - coefficients))
    variance = np.mean(((squares - unexplained * own) / own.mean()) ** 2) / n
    variance += 2.0 * (1.0 - share) ** 2 * (tried - 1) / n**2
    return float(share), float(TWO_SIDED * variance**0.5)


def _regression(x: Array, y: Array) -> tuple[Array, Array, dict[str, Any]]:
    """Fit y (n,) by a polynomial of second order in parameters x (n, k), or of first in few runs.

    Returns:
        Its values, y of the same runs, from all parts of those where these are too many for memory, and the
        share of the variance of y that it explains; none in fewer runs.
    """
    k = x.shape[1]
    count = 1 + k + k * (k + 1) // 2
    if PER_TERM * count > min(len(y), MOST_NUMBERS // count):
        count = 1 + k
    chosen = thinned(len(y), MOST_NUMBERS // count)
    x, y = x[chosen], y[chosen]
    x = x - x.mean(axis=0)
    x /= np.maximum(x.std(axis=0), np.finfo(float).tiny)
    terms = np.column_stack([np.ones(len(y)), x])
    if count > terms.shape[1]:
        terms = np.column_stack([terms, *(x[:, i] * x[:, j] for i in range(k) for j in range(i + 1))])
    solution, _, rank, _ = np.linalg.lstsq(terms, y, rcond=None)
    fitted = terms @ solution
    if len(y) < max(LEAST_SHARED, PER_TERM * rank):
        return fitted, y, {}
    share, error = _adjusted(y - fitted, y, int(rank), int(rank))
    return fitted, y, {"share": share, "error": error, "bounds": True}


def _tenths(x: Array, y: Array) -> dict[str, Any]:
    ordered = np.sort(x)
    count = max(1, int(EXTREME * len(x)))
    low, high = y[x <= ordered[count - 1]], y[x >= ordered[-count]]
    return {"low": float(low.mean()), "high": float(high.mean())}


@np.errstate(all="ignore")  # of ranges that vanish, or are not known
def most_varying(found: Sequence[Scalar]) -> list[Scalar]:
    """Sort numbers by their spreads: of each variable the one that varies most, then the next of each.

    Those that vary alike stay in their order, so that more runs, or others, choose the same.
    """
    of_variable: dict[str, list[Scalar]] = {}
    for scalar in found:
        of_variable.setdefault(scalar.variable, []).append(scalar)
    for name, members in of_variable.items():
        spreads = np.array([scalar.spread for scalar in members])
        largest = np.max(spreads, initial=0.0, where=np.isfinite(spreads))
        steps = np.floor(np.log(largest / spreads) / np.log(ALIKE))
        of_variable[name] = [members[k] for k in np.argsort(steps, kind="stable")]
    return [scalar for place in zip_longest(*of_variable.values()) for scalar in place if scalar is not None]


def telling(found: Sequence[Scalar]) -> list[Scalar]:
    """Choose one number for each variable: of those that vary the one that does so most."""
    varying = [scalar for scalar in found if scalar.varies]
    return most_varying(varying)[: len({scalar.variable for scalar in varying})]
