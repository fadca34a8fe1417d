"""Sample the parameters that a sweep varies: values of all varied parameters for each run.

A sweep simulates one scene many times; the user gives a distribution for each varied parameter. A sampling
chooses numbers u between 0 and 1 for each run and parameter, and the values are the quantiles of the
distributions at u. The values of a run do not depend on which other runs are executed, in which order, or by
which process.
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
"""Independent random numbers; Latin hypercube; scrambled Sobol sequence (quasi-random numbers); Saltelli's
design, whose runs estimate Sobol indices (fractions of variance that parameters explain); full factorial
grid."""

SAMPLINGS: tuple[SamplingName, ...] = get_args(SamplingName)
"""Names of all samplings."""

MIN_PROBABILITY = 2.0**-33
"""Smallest distance of probabilities from 0 and 1, where many quantiles are infinite. A closer number occurs
with a probability of about 0.2 in 10^9 random numbers."""

MAX_RUNS = 2**32
"""Largest number of runs: the number of points of a Sobol sequence of `SOBOL_BITS` bits."""

SOBOL_BITS, SALTELLI_BITS = 32, 30
"""Bits of the coordinates of Sobol sequences: for the sampling "sobol", and in Saltelli's design.

A sequence of n bits has 2^n points. A base sample of Saltelli's design has one point and at least 3 runs, so
that `MAX_RUNS` contains at most 2^30 base samples.
"""

MAX_SOBOL_DIMENSION = 21_201
"""Largest dimension of the Sobol sequence in SciPy; Saltelli's design needs two dimensions per parameter."""

MAX_HYPERCUBE_NUMBERS = 2**26
"""Largest size (runs times parameters, 512 MB) of a Latin hypercube, which is generated as a whole."""

HASHED_RUNS = 1024
"""Largest number of runs whose values enter the hash of samples."""

EXTENSIBLE_SAMPLINGS = ("random", "sobol", "saltelli")
"""Samplings to which runs can be added: the first runs stay the same."""

NOT_EXTENSIBLE_REASONS = {
    (
        "latin_hypercube",
        "runs",
    ): " (a Latin hypercube of more runs is a different one; random and sobol can grow)",
    ("grid", "vary"): " (a grid of other values numbers its runs differently)",
}
"""Reasons why runs cannot be added to a stored sweep, as ends of an error message. The keys are a sampling
and what differs from the stored sweep: the number of runs, or a distribution ("vary")."""


@dataclass(frozen=True, eq=False)
class SweepSamples:
    """Values of the varied parameters for each run of a sweep.

    Attributes:
        groups: pairs of the names of parameters (several if they are correlated) and their distribution.
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
        # `is_count` accepts whole numbers from 1, a seed may also be 0
        if not is_count(self.seed + 1 if isinstance(self.seed, int) else None) or self.seed >= 2**63:
            raise CrosscheckError(f"seed is {quoted(self.seed)}; needed: a whole number, 0 or more")
        if self.sampling == "saltelli":
            # the largest power of 2 of base samples that the runs suffice for
            base_samples = 2 ** max(0, (self.runs // self.block).bit_length() - 1)
            if self.runs != self.block * base_samples:
                near = f"{self.block * base_samples} or {2 * self.block * base_samples}"
                raise CrosscheckError(
                    f"saltelli takes a power of 2 times {self.block} runs: {near}, not {self.runs}"
                )
        dimensions_per_parameter = {"sobol": 1, "saltelli": 2}.get(self.sampling, 0)
        if dimensions_per_parameter * len(self.names) > MAX_SOBOL_DIMENSION:
            most = MAX_SOBOL_DIMENSION // dimensions_per_parameter
            problem = f"{self.sampling} takes {most} parameters at most"
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
        """Number of consecutive runs that belong together: 1, or those of a base sample of Saltelli's design.

        A base sample is a point A, A with one parameter (or group) of another point B in turn, and B.
        """
        return len(self.groups) + 2 if self.sampling == "saltelli" else 1

    @property
    def grid(self) -> list[tuple[float, ...]]:
        """Values of each parameter in a full factorial grid.

        Raises:
            CrosscheckError: for a distribution that is not discrete.
        """
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
        """Return the parameter values (last - first, parameters) of runs `first` to `last` - 1."""
        if self.sampling == "grid":
            indices = np.unravel_index(np.arange(first, last), [len(each) for each in self.grid])
            columns = [np.array(numbers)[k] for numbers, k in zip(self.grid, indices, strict=True)]
            return np.stack(columns, axis=1)
        u = np.clip(self._probabilities(first, last), MIN_PROBABILITY, 1.0 - MIN_PROBABILITY)
        parts, start = [], 0
        for names, distribution in self.groups:
            u_of_group = u[:, start : start + len(names)]
            start += len(names)
            if isinstance(distribution, Correlated):
                parts.append(distribution.quantile(u_of_group))
            else:
                parts.append(distribution.quantile(u_of_group[:, 0])[:, None])
        return np.concatenate(parts, axis=1)

    def digest(self, runs: int) -> str:
        """Hash the values of the first runs, since other versions of packages may draw others for a seed."""
        return sha256(self.values(0, min(runs, HASHED_RUNS)).tobytes()).hexdigest()[:16]

    def _probabilities(self, first: int, last: int) -> Array:
        """Return the probabilities u (last - first, parameters) of runs `first` to `last` - 1."""
        count, size = last - first, len(self.names)
        if self.sampling == "random":
            # Philox is a generator with a counter. A step of the counter gives four numbers. All runs take
            # the same number of steps.
            steps = -(-size // 4)  # rounded up
            generator = np.random.Generator(np.random.Philox(key=self.seed).advance(first * steps))
            return generator.random((count, 4 * steps))[:, :size]
        if self.sampling == "sobol":
            return _sobol(size, self.seed, SOBOL_BITS, first, last)
        if self.sampling == "saltelli":
            return self._saltelli(first, last)
        with HYPERCUBE_LOCK:
            return _latin_hypercube(size, self.runs, self.seed)[first:last]

    def _saltelli(self, first: int, last: int) -> Array:
        """Return the probabilities u (last - first, parameters) of Saltelli's design.

        The runs of each base sample are a point A, then for each parameter A with that parameter of another
        point B, and B (A. Saltelli, Computer Physics Communications 145, 2002). Correlated parameters count
        as one parameter.
        """
        block, size = self.block, len(self.names)
        first_base, end_base = first // block, -(-last // block)  # base samples that contain the runs
        points = _sobol(2 * size, self.seed, SALTELLI_BITS, first_base, end_base)
        a, b = np.split(points, 2, axis=1)
        group = np.repeat(np.arange(len(self.groups)), [len(names) for names, _ in self.groups])
        mixed = [np.where(group == k, b, a) for k in range(len(self.groups))]
        rows = np.stack([a, *mixed, b], axis=1).reshape(-1, size)
        return rows[first - first_base * block : last - first_base * block]


THREAD_SEQUENCE = threading.local()
"""Sobol sequence of each thread: `key` has the arguments with which `sequence` was made."""


def _sobol(size: int, seed: int, bits: int, first: int, last: int) -> Array:
    """Return points `first` to `last` - 1 of a scrambled Sobol sequence, (last - first, size).

    SciPy generates the points one after another. Therefore each thread keeps its sequence for the next call,
    which usually asks for later points.

    Args:
        size: dimension of the points.
        seed: seed of the scrambling.
        bits: number of bits of the coordinates; the sequence has 2^bits points.
        first, last: range of the points.
    """
    from scipy.stats import qmc

    key = size, seed, bits
    if getattr(THREAD_SEQUENCE, "key", None) != key or THREAD_SEQUENCE.sequence.num_generated > first:
        THREAD_SEQUENCE.sequence = qmc.Sobol(size, scramble=True, bits=bits, seed=seed)
        THREAD_SEQUENCE.key = key
    sequence, count = THREAD_SEQUENCE.sequence, last - first
    if sequence.num_generated < first:
        sequence.fast_forward(first - sequence.num_generated)
    # SciPy warns if the first draw of a sequence is not of a power of 2 points: draw as many, use `count`
    drawn = count if first else 1 << (count - 1).bit_length()
    return np.asarray(sequence.random(drawn)[:count])


HYPERCUBE_LOCK = threading.Lock()
"""Lock during the generation of a Latin hypercube, so that all threads use the same array."""


@lru_cache(maxsize=1)
def _latin_hypercube(size: int, runs: int, seed: int) -> Array:
    """Return the probabilities u (runs, size) of a Latin hypercube; the last result is cached."""
    from scipy.stats import qmc

    return np.asarray(qmc.LatinHypercube(size, seed=seed).random(runs))


def samples_of(vary: Vary, sampling: SamplingName, runs: int | None, seed: int) -> SweepSamples:
    """Make the samples of a sweep.

    Args:
        vary: distributions by name of the parameter, or by names of correlated parameters.
        sampling: see `SamplingName`.
        runs: number of runs; None for a full grid, whose size follows from its values.
        seed: seed of all random numbers.

    Raises:
        CrosscheckError: if no parameter is given, a parameter is given twice, or a distribution or the number
            of runs is invalid.
    """
    check_choice("sampling", sampling, SAMPLINGS)
    runs = int(runs) if isinstance(runs, np.integer) else runs
    seed = int(seed) if isinstance(seed, np.integer) else seed
    groups: list[tuple[tuple[str, ...], Distribution | Correlated]] = []
    for key, given in vary.items():
        names = (key,) if isinstance(key, str) else tuple(key)
        groups.append((names, _distribution(names, given)))
    all_names = [name for names, _ in groups for name in names]
    if not all_names:
        raise CrosscheckError(
            "nothing varies; name a parameter and its distribution (--vary NAME=DISTRIBUTION)"
        )
    for name, times in Counter(all_names).items():
        if times > 1:
            raise CrosscheckError(f"{name} varies twice; name it once")
    if sampling == "grid":
        of_grid = SweepSamples(tuple(groups), "grid", runs=1, seed=0)  # its grid does not depend on these
        size = prod(len(numbers) for numbers in of_grid.grid)
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
