"""Find the setting with which an engine simulates a batch fastest at a given error.

A setting is a method of an engine with its step or tolerance. Each is tried on a sample of the runs of a
batch. Errors are the largest distance, m, or angle, rad, between the poses of a run and its reference motion.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from typing import NamedTuple

from crosscheck.engines.benchmarks import BatchEngine, Ladder, Options, Poses
from crosscheck.studies.benchmark.reference import pose_errors
from crosscheck.studies.benchmark.timing import Progress
from crosscheck.studies.bisection import smallest
from crosscheck.support.errors import CrosscheckError
from crosscheck.support.time_limits import time_limit
from newton_euler.codegen.compile import garbage_collection_off
from newton_euler.errors import NewtonEulerError
from newton_euler.model.state import State

SAMPLE_TIME_LIMIT = 20.0
"""Longest duration of the sample at one setting, s; slower settings are given up."""

SAMPLE_TRIES = 2
"""Number of times that the sample is timed at a setting that reaches the error; the shorter time counts."""


class TriedSetting(NamedTuple):
    """A setting with which the sample was simulated.

    Attributes:
        name: name of the setting.
        options: options of the setting.
        error: largest error in the sample, m or rad; infinite if a run failed.
        seconds: duration of the whole sample, s.
    """

    name: str
    options: Options
    error: float
    seconds: float


def fastest_setting(
    engine: BatchEngine, states: Sequence[State], exact: Sequence[Poses], error: float, progress: Progress
) -> TriedSetting:
    """Find the fastest setting of an engine whose largest error over the states is at most `error`.

    Args:
        engine: the engine.
        states: initial states of the sample.
        exact: reference poses of each run of the sample.
        error: the largest allowed error, m and rad.
        progress: called with the name of each method.

    Raises:
        CrosscheckError: if no setting reaches the error.
    """
    tried: list[TriedSetting] = []
    reaching: list[TriedSetting] = []
    for ladder in engine.ladders():
        progress(f"{len(states)} runs of {engine.name}: {ladder.method}")
        # settings that take longer than the fastest one that reaches the error need not be tried
        longest = min((choice.seconds for choice in reaching), default=SAMPLE_TIME_LIMIT)

        def ends_search(n: int, ladder: Ladder = ladder, longest: float = longest) -> bool:
            """Try the n-th setting that the ladder allows.

            Returns:
                True if the setting is accurate enough or too slow, as all finer settings are.
            """
            number = ladder.numbers[n - 1]  # a larger number has a smaller step or tolerance
            tried.append(_try_setting(engine, *ladder.setting(number), states, exact, error))
            return tried[-1].error <= error or tried[-1].seconds > longest

        # find the smallest n by doubling and bisection; `tried` records all settings on the way
        smallest(ends_search, len(ladder.numbers))
        reaching = [choice for choice in tried if choice.error <= error]
    if not reaching:
        smallest_error = min(choice.error for choice in tried)
        reason = f"does not reach an error of {error:g} on all {len(states)} runs in {SAMPLE_TIME_LIMIT:g} s"
        raise CrosscheckError(f"{engine.name} {reason}; its smallest error is {smallest_error:.1e}")
    return min(reaching, key=lambda choice: choice.seconds)


def _try_setting(
    engine: BatchEngine,
    name: str,
    options: Options,
    states: Sequence[State],
    exact: Sequence[Poses],
    error: float,
) -> TriedSetting:
    """Simulate the sample at a setting, `SAMPLE_TRIES` times if the setting reaches the error.

    Arguments other than the name and the options of the setting are those of `fastest_setting`.
    """
    seconds, largest_error = math.inf, math.inf
    for _ in range(SAMPLE_TRIES):
        start = time.perf_counter()
        try:
            with garbage_collection_off(), time_limit(SAMPLE_TIME_LIMIT):
                done = engine.run(options, states, threads=1)
            # errors in position, m, and orientation, rad, of each run
            errors = [pose_errors(*pair) for pair in zip(done.poses(), exact, strict=True)]
            largest_error = max(max(each) for each in errors)
        except (NewtonEulerError, CrosscheckError):
            return TriedSetting(name, options, math.inf, time.perf_counter() - start)
        seconds = min(seconds, done.seconds)
        if not largest_error <= error:
            break
    return TriedSetting(name, options, largest_error, seconds)
