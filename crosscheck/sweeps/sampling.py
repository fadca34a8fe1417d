"""Samples of the numbers that a sweep varies, each run's its own whatever it is drawn together with."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache
from hashlib import sha256
from math import prod
from typing import Literal, get_args

import numpy as np
from scipy.stats import qmc

from crosscheck.errors import CrosscheckError
from crosscheck.sweeps.distributions import Correlated, Distribution, Vary, parse
from newton_euler.errors import check_choice, is_count
from newton_euler.scalars import Array

SamplingName = Literal["random", "latin_hypercube", "sobol", "saltelli", "grid"]
"""Independent numbers; one in each of as many equal shares as there are runs; a sequence of low discrepancy,
scrambled; the plan from which Sobol indices are estimated; all combinations of values."""

SAMPLINGS: tuple[SamplingName, ...] = get_args(SamplingName)

EDGE = 2.0**-33
"""Distance of shares from 0 and 1 at least; of 10^9 runs one in ten would come nearer."""

MOST_RUNS = 2**32
"""The bits of Sobol's sequence."""

LARGEST_DESIGN = 2**26
"""Numbers of a plan that is made as a whole, 512 MB; others are made where they are needed."""

DIGESTED = 1024
"""Runs whose values are hashed."""

WHOLE = ("latin_hypercube", "saltelli")
"""Samplings whose plan is made as a whole."""

EXTENDED = ("random", "sobol", "saltelli")
"""Samplings whose first runs are the same if more follow."""

UNEXTENDED = {
    ("latin_hypercube", "runs"): " (a Latin hypercube of more runs is another one; random and sobol go on)",
    ("grid", "vary"): " (a grid of other values numbers its runs anew)",
}
"""Why others are not the same, by the part of the plan that differs."""


@dataclass(frozen=True, eq=False)
class Samples:
    """Values of parameters for any run of a sweep.

    Attributes:
        groups: names of parameters, one or several that are correlated, with their distribution.
        sampling: see `SamplingName`.
        runs: their number.
        seed: of all random numbers.
    """

    groups: tuple[tuple[tuple[str, ...], Distribution | Correlated], ...]
    sampling: SamplingName
    runs: int
    seed: int

    def __post_init__(self) -> None:
        check_choice("sampling", self.sampling, SAMPLINGS)
        if not is_count(self.runs) or self.runs > MOST_RUNS:
            raise CrosscheckError(f"runs is {self.runs!r:.100}; needed: a whole number, 1 to {MOST_RUNS}")
        if not is_count(self.seed + 1 if isinstance(self.seed, int) else None) or self.seed >= 2**63:
            raise CrosscheckError(f"seed is {self.seed!r:.100}; needed: a whole number, 0 or more")
        if self.sampling == "saltelli":
            base = 2 ** max(0, (self.runs // self.block).bit_length() - 1)
            if self.runs != self.block * base:
                near = f"{self.block * base} or {2 * self.block * base}"
                raise CrosscheckError(
                    f"saltelli takes a power of 2 times {self.block} runs: {near}, not {self.runs}"
                )
        if self.sampling in WHOLE and self.runs * len(self.names) > LARGEST_DESIGN:
            most = LARGEST_DESIGN // len(self.names)
            raise CrosscheckError(
                f"{self.sampling} is made as a whole, of {most} runs at most; sobol has no limit"
            )

    @property
    def names(self) -> tuple[str, ...]:
        """The parameters, in the order of values."""
        return tuple(name for names, _ in self.groups for name in names)

    @property
    def block(self) -> int:
        """The number of runs that are of use together alone: of a base sample of Saltelli's plan."""
        return len(self.groups) + 2 if self.sampling == "saltelli" else 1

    @property
    def grid(self) -> list[tuple[float, ...]]:
        """The values of each parameter of a full grid."""
        found = []
        for names, distribution in self.groups:
            levels = distribution.levels if isinstance(distribution, Distribution) else ()
            if not levels:
                needed = "values(...) or grid(...) of each parameter"
                raise CrosscheckError(
                    f"--sampling grid of {', '.join(names)}={distribution}; needed: {needed}"
                )
            found.append(levels)
        return found

    def values(self, first: int, last: int) -> Array:
        """Return the values (last - first, parameters) of the runs from `first` to before `last`."""
        if self.sampling == "grid":
            places = np.unravel_index(np.arange(first, last), [len(each) for each in self.grid])
            columns = [np.array(numbers)[k] for numbers, k in zip(self.grid, places, strict=True)]
            return np.stack(columns, axis=1)
        u = np.clip(self._shares(first, last), EDGE, 1.0 - EDGE)
        parts, start = [], 0
        for names, distribution in self.groups:
            own = u[:, start : start + len(names)]
            start += len(names)
            if isinstance(distribution, Correlated):
                parts.append(distribution.quantile(own))
            else:
                parts.append(distribution.quantile(own[:, 0])[:, None])
        return np.concatenate(parts, axis=1)

    def digest(self, runs: int) -> str:
        """Hash values of the first runs, of so many: other packages may draw others by the same seed."""
        return sha256(self.values(0, min(runs, DIGESTED)).tobytes()).hexdigest()[:16]

    def _shares(self, first: int, last: int) -> Array:
        """Return shares between 0 and 1 (last - first, parameters)."""
        count, size = last - first, len(self.names)
        if self.sampling == "random":
            blocks = -(-size // 4)  # a step of Philox's counter gives four numbers
            generator = np.random.Generator(np.random.Philox(key=self.seed).advance(first * blocks))
            return generator.random((count, 4 * blocks))[:, :size]
        if self.sampling == "sobol":
            sequence = qmc.Sobol(size, scramble=True, bits=32, seed=self.seed)
            if first:
                sequence.fast_forward(first)
            # SciPy warns of numbers of points that are no powers of 2
            return np.asarray(sequence.random(1 << (count - 1).bit_length())[:count])
        members = tuple(len(names) for names, _ in self.groups)
        return _whole(self.sampling, members, self.runs, self.seed)[first:last]

    @property
    def problem(self) -> dict[str, object]:
        """SALib's description of the parameters; those that are correlated are one group."""
        return _problem(tuple(len(names) for names, _ in self.groups))


def _problem(members: tuple[int, ...]) -> dict[str, object]:
    owners = [f"g{k}" for k, count in enumerate(members) for _ in range(count)]
    size = len(owners)
    names = [f"x{k}" for k in range(size)]
    return {"num_vars": size, "names": names, "bounds": [[0.0, 1.0]] * size, "groups": owners}


@lru_cache(maxsize=1)
def _whole(sampling: str, members: tuple[int, ...], runs: int, seed: int) -> Array:
    """Make all shares (runs, parameters) of a plan, kept for the chunks that follow."""
    if sampling == "latin_hypercube":
        return np.asarray(qmc.LatinHypercube(sum(members), seed=seed).random(runs))
    from SALib.sample import sobol

    base = runs // (len(members) + 2)
    return np.asarray(sobol.sample(_problem(members), base, calc_second_order=False, seed=seed))


def samples_of(vary: Vary, sampling: SamplingName, runs: int | None, seed: int) -> Samples:
    """Return the samples of a sweep; `runs` may be None for a full grid, which has as many as it has.

    Raises:
        CrosscheckError: for nothing that varies, a parameter that varies twice, an empty distribution, and
            numbers of runs that a plan cannot have.
    """
    check_choice("sampling", sampling, SAMPLINGS)
    runs = int(runs) if isinstance(runs, np.integer) else runs
    seed = int(seed) if isinstance(seed, np.integer) else seed
    groups: list[tuple[tuple[str, ...], Distribution | Correlated]] = []
    for key, given in vary.items():
        names = (key,) if isinstance(key, str) else tuple(key)
        groups.append((names, _distribution(names, given)))
    every = [name for names, _ in groups for name in names]
    if not every:
        raise CrosscheckError(
            "nothing varies; name a parameter and its distribution (--vary NAME=DISTRIBUTION)"
        )
    for name in every:
        if every.count(name) > 1:
            raise CrosscheckError(f"{name} varies twice; name it once")
    if sampling == "grid":
        size = prod(len(numbers) for numbers in Samples(tuple(groups), "grid", 1, 0).grid)
        if runs not in (None, size):
            raise CrosscheckError(f"the grid has {size} runs, not {runs}; leave the number of runs out")
        runs = size
    if runs is None:
        raise CrosscheckError(f"sampling {sampling} needs a number of runs (--runs N)")
    return Samples(tuple(groups), sampling, runs, seed)


def _distribution(names: tuple[str, ...], given: object) -> Distribution | Correlated:
    try:
        if isinstance(given, str):
            given = parse(given)
        elif not isinstance(given, Distribution | Correlated) and isinstance(given, Iterable):
            given = Distribution("values", tuple(given))
    except CrosscheckError as error:
        raise CrosscheckError(f"{', '.join(names)}={given!r:.200}: {error}") from None
    if not isinstance(given, Distribution | Correlated):
        raise CrosscheckError(f"{', '.join(names)}: {given!r:.100} is no distribution")
    count = len(given.distributions) if isinstance(given, Correlated) else 1
    if count != len(names):
        raise CrosscheckError(f"{', '.join(names)}: a distribution of {count} numbers, not of {len(names)}")
    return given
