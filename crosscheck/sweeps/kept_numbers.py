"""Kept numbers of a sweep: their values in all runs, quantiles and spread, and those that vary most.

A sweep simulates one scene many times with sampled parameters. A kept output is a number or array that the
sweep stores of each run; its name is a variable of the stored dataset, and each of its elements is a scalar,
a `KeptNumber`. `kept_numbers` reads the kept numbers of all runs, or of a sample of the runs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import zip_longest

import numpy as np

from crosscheck.sweeps.results import SweepResults
from newton_euler.scalars import Array

MAX_ANALYZED_NUMBERS = 2**25
"""Largest number of values (kept numbers times runs, 270 MB) that are analyzed. If a sweep has more, a sample
of its runs is analyzed."""

MAX_KEPT_NUMBERS = 200
"""Largest number of kept numbers of a run that are analyzed, divided equally among the kept outputs."""

MAX_READ_NUMBERS = 2**20
"""Largest number of values that are read from the store at a time."""

QUANTILE_LEVELS = {"min": 0.0, "5 %": 0.05, "median": 0.5, "95 %": 0.95, "max": 1.0}
"""Probabilities of the reported quantiles, by name."""

SAME_SPREAD_RATIO = 1.1
"""Ratio of spreads (`KeptNumber.spread`) below which two numbers are considered to vary equally; such numbers
keep their order."""

MIN_VARIATION = 1e-9
"""Range of a number over all runs, relative to the magnitude of its variable, below which the number is
considered constant."""


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
        """Minimum, 5 %, median, 95 % and maximum (5,) over the successful runs; NaN if all runs failed."""
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
