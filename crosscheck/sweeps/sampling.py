"""Sample the parameters that a sweep varies: values of all varied parameters for each run.

The values of a run do not depend on which other runs are executed, in which order, or by which process.
"""

from __future__ import annotations

import threading
from collections import Counter
from dataclasses import dataclass
from functools import lru_cache
from hashlib import sha256
from math import prod
from typing import Literal, get_args

import numpy as np

from crosscheck.support.errors import CrosscheckError
from crosscheck.sweeps.distributions import Correlated, Distribution, Vary, parse
from newton_euler.errors import check_choice, is_count, items_of, quoted
from newton_euler.scalars import Array

SamplingName = Literal["random", "latin_hypercube", "sobol", "saltelli", "grid"]
"""Independent random numbers; Latin hypercube; scrambled Sobol sequence; Saltelli's design for Sobol indices;
full factorial grid."""

SAMPLINGS: tuple[SamplingName, ...] = get_args(SamplingName)
"""Names of all samplings."""

MIN_PROBABILITY = 2.0**-33
"""Smallest distance of probabilities from 0 and 1. Of 10^9 runs, one in ten would come closer."""

MAX_RUNS = 2**32
"""Largest number of runs, from the bits of the Sobol sequence."""

MAX_SOBOL_COLUMNS = 21_201
"""Largest dimension of the Sobol sequence in SciPy; Saltelli's design needs two dimensions per parameter."""

MAX_HYPERCUBE_NUMBERS = 2**26
"""Largest size (runs times parameters, 512 MB) of a Latin hypercube, which is generated as a whole."""

HASHED_RUNS = 1024
"""Number of runs whose values enter the digest of samples."""

EXTENSIBLE_SAMPLINGS = ("random", "sobol", "saltelli")
"""Samplings to which runs can be added: the first runs stay the same."""

NOT_EXTENSIBLE_REASONS = {
    (
        "latin_hypercube",
        "runs",
    ): " (a Latin hypercube of more runs is a different one; random and sobol can grow)",
    ("grid", "vary"): " (a grid of other values numbers its runs differently)",
}
"""Reasons why runs cannot be added, by sampling and by the part of the plan that differs."""


@dataclass(frozen=True, eq=False)
class SweepSamples:
    """Values of the varied parameters for each run of a sweep.

    Attributes:
        groups: names of parameters (several if they are correlated), with their distribution.
        sampling: see `SamplingName`.
        runs: number of runs.
        seed: seed of all random numbers.
    """

    groups: tuple[tuple[tuple[str, ...], Distribution | Correlated], ...]
    sampling: SamplingName
    runs: int
    seed: int

    def __post_init__(self) -> None:
        check_choice("sampling", self.sampling, SAMPLINGS)
        if not is_count(self.runs) or self.runs > MAX_RUNS:
            raise CrosscheckError(f"runs is {quoted(self.runs)}; needed: a whole number, 1 to {MAX_RUNS}")
        if not is_count(self.seed + 1 if isinstance(self.seed, int) else None) or self.seed >= 2**63:
            raise CrosscheckError(f"seed is {quoted(self.seed)}; needed: a whole number, 0 or more")
        if self.sampling == "saltelli":
            base = 2 ** max(0, (self.runs // self.block).bit_length() - 1)
            if self.runs != self.block * base:
                near = f"{self.block * base} or {2 * self.block * base}"
                raise CrosscheckError(
                    f"saltelli takes a power of 2 times {self.block} runs: {near}, not {self.runs}"
                )
        columns = {"sobol": 1, "saltelli": 2}.get(self.sampling, 0)
        if columns * len(self.names) > MAX_SOBOL_COLUMNS:
            problem = f"{self.sampling} takes {MAX_SOBOL_COLUMNS // columns} parameters at most"
            raise CrosscheckError(f"{problem}, not {len(self.names)}; random has no limit")
        if self.sampling == "latin_hypercube" and self.runs * len(self.names) > MAX_HYPERCUBE_NUMBERS:
            most = MAX_HYPERCUBE_NUMBERS // len(self.names)
            raise CrosscheckError(
                f"latin_hypercube is made as a whole, of {most} runs at most; sobol has no limit"
            )

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters, in the order of `values`."""
        return tuple(name for names, _ in self.groups for name in names)

    @property
    def block(self) -> int:
        """Number of runs that belong together: those of a base sample in Saltelli's design, else 1."""
        return len(self.groups) + 2 if self.sampling == "saltelli" else 1

    @property
    def grid(self) -> list[tuple[float, ...]]:
        """Values of each parameter of a full grid."""
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
        u = np.clip(self._probabilities(first, last), MIN_PROBABILITY, 1.0 - MIN_PROBABILITY)
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
        """Hash the values of the first runs: other versions of packages may draw other values for a seed."""
        return sha256(self.values(0, min(runs, HASHED_RUNS)).tobytes()).hexdigest()[:16]

    def _probabilities(self, first: int, last: int) -> Array:
        """Return the probabilities (last - first, parameters), between 0 and 1, whose quantiles are the
        values."""
        count, size = last - first, len(self.names)
        if self.sampling == "random":
            blocks = -(-size // 4)  # a step of Philox's counter gives four numbers
            generator = np.random.Generator(np.random.Philox(key=self.seed).advance(first * blocks))
            return generator.random((count, 4 * blocks))[:, :size]
        if self.sampling == "sobol":
            return _sobol(size, self.seed, 32, first, last)
        if self.sampling == "saltelli":
            return self._saltelli(first, last)
        with DESIGN_LOCK:
            return _latin_hypercube(size, self.runs, self.seed)[first:last]

    def _saltelli(self, first: int, last: int) -> Array:
        """Return probabilities of Saltelli's design: for each base sample A, A with one parameter of B, and
        B.

        Correlated parameters count as one (A. Saltelli, Computer Physics Communications 145, 2002).
        """
        block, size = self.block, len(self.names)
        base = first // block
        a, b = np.split(_sobol(2 * size, self.seed, 30, base, -(-last // block)), 2, axis=1)
        group = np.repeat(np.arange(len(self.groups)), [len(names) for names, _ in self.groups])
        mixed = [np.where(group == k, b, a) for k in range(len(self.groups))]
        rows = np.stack([a, *mixed, b], axis=1).reshape(-1, size)
        return rows[first - base * block : last - base * block]


THREAD_SEQUENCE = threading.local()
"""Sobol sequence of each thread."""


def _sobol(size: int, seed: int, bits: int, first: int, last: int) -> Array:
    """Return points (last - first, size) of a scrambled Sobol sequence.

    SciPy must generate all earlier points. Therefore each thread keeps its sequence: tasks come in ascending
    order.
    """
    from scipy.stats import qmc

    key = size, seed, bits
    if getattr(THREAD_SEQUENCE, "key", None) != key or THREAD_SEQUENCE.sequence.num_generated > first:
        THREAD_SEQUENCE.key, THREAD_SEQUENCE.sequence = (
            key,
            qmc.Sobol(size, scramble=True, bits=bits, seed=seed),
        )
    sequence, count = THREAD_SEQUENCE.sequence, last - first
    if sequence.num_generated < first:
        sequence.fast_forward(first - sequence.num_generated)
    # SciPy warns if the number of first points is not a power of 2
    drawn = count if first else 1 << (count - 1).bit_length()
    return np.asarray(sequence.random(drawn)[:count])


DESIGN_LOCK = threading.Lock()
"""Lock during the generation of a Latin hypercube, so that threads share one."""


@lru_cache(maxsize=1)
def _latin_hypercube(size: int, runs: int, seed: int) -> Array:
    """Generate all probabilities (runs, size), cached for the following chunks."""
    from scipy.stats import qmc

    return np.asarray(qmc.LatinHypercube(size, seed=seed).random(runs))


def samples_of(vary: Vary, sampling: SamplingName, runs: int | None, seed: int) -> SweepSamples:
    """Make the samples of a sweep.

    Args:
        vary: distributions by parameter.
        sampling: see `SamplingName`.
        runs: number of runs; None for a full grid, whose size follows from its values.
        seed: seed of all random numbers.

    Raises:
        CrosscheckError: for no parameter, a parameter that varies twice, an invalid distribution, and an
            invalid number of runs.
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
    for name, times in Counter(every).items():
        if times > 1:
            raise CrosscheckError(f"{name} varies twice; name it once")
    if sampling == "grid":
        size = prod(len(numbers) for numbers in SweepSamples(tuple(groups), "grid", 1, 0).grid)
        if runs not in (None, size):
            raise CrosscheckError(f"the grid has {size} runs, not {runs}; leave the number of runs out")
        runs = size
    if runs is None:
        raise CrosscheckError(f"sampling {sampling} needs a number of runs (--runs N)")
    return SweepSamples(tuple(groups), sampling, runs, seed)


def _distribution(names: tuple[str, ...], given: object) -> Distribution | Correlated:
    """Convert a text, or a list of numbers, to the distribution of one or several parameters.

    Raises:
        CrosscheckError: for an invalid distribution, or one of another number of parameters.
    """
    try:
        if isinstance(given, str):
            given = parse(given)
        elif (numbers := items_of(given)) is not None:
            given = Distribution("values", numbers)
    except CrosscheckError as error:
        raise CrosscheckError(f"{', '.join(names)}={quoted(given, 200)}: {error}") from None
    if not isinstance(given, Distribution | Correlated):
        raise CrosscheckError(f"{', '.join(names)}: {quoted(given)} is no distribution")
    count = len(given.distributions) if isinstance(given, Correlated) else 1
    if count != len(names):
        raise CrosscheckError(f"{', '.join(names)}: a distribution of {count} numbers, not of {len(names)}")
    return given
