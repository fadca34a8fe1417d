"""Find settings that reduce the error of a model file's run. Every remedy is measured by a run.

In: the file with its reference solution, and the judged run, which has the file's own engine (such as
MuJoCo), time step, integrator and solver. Out: at most two remedies: the most accurate settings that cost no
more than those of the file, and the cheapest settings that reach the error `TARGET`. Settings are of one
*kind* if they differ only in the time step and in values that follow from it.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from typing import Any

import numpy as np

from crosscheck.own_run.comparison import Comparison, MeasuredSettings
from crosscheck.own_run.errors import ACCURATE_BELOW, RunError
from newton_euler.reading.file_run import FileRun

TARGET = ACCURATE_BELOW
"""Relative error that remedies aim at."""

MIN_GAIN = 0.5
"""Largest error of a remedy, as a fraction of the error of the file's settings."""

KINDS_REFINED = 2
"""Number of kinds of settings that are tried at smaller steps."""

MAX_COST = 40.0
"""Largest number of evaluations of a remedy, as a multiple of those of the judged run."""


@dataclass(frozen=True)
class MeasuredRemedy(MeasuredSettings):
    """Settings that were tried, with the error and the cost of their run.

    Attributes:
        evaluations: evaluations of the equations of motion, as a multiple of those of the file's settings.
        run_time: measured run time, as a multiple of the run time of the file's settings; the multiple of
            the evaluations if the run of the file diverged.
    """

    evaluations: float
    run_time: float


@dataclass(frozen=True)
class FoundRemedies:
    """Result of a search for settings with a smaller error.

    Attributes:
        remedies: settings with at most `MIN_GAIN` of the error, at most two; empty if no tried settings have.
        smallest: smallest error of all tried settings if there are no remedies; None if there are some, or if
            no run with other settings completes.
    """

    remedies: tuple[MeasuredRemedy, ...]
    smallest: RunError | None


@dataclass(frozen=True)
class _Trial:
    """Settings of a completed run, and the divisor of the file's time step in them."""

    divisor: float
    settings: Any  # `newton_euler.reading.file_run.Settings` of the file's engine
    remedy: MeasuredRemedy

    def timed(self, compared: Comparison, own: FileRun) -> _Trial:
        """Return the trial with the shortest run time of several runs.

        Args:
            compared: the file with its reference.
            own: the fastest run with the settings of the file.
        """
        run_time = compared.relative_run_time(self.settings, compared.fastest(self.settings), own)
        return replace(self, remedy=replace(self.remedy, run_time=run_time))


def find_remedies(compared: Comparison, run: FileRun, error: RunError) -> FoundRemedies:
    """Try other settings than those of the file.

    Args:
        compared: the file with its reference.
        run: the judged run.
        error: error of the judged run.

    Returns:
        Settings with at most `MIN_GAIN` of the error: the most accurate ones of similar cost, and the
        cheapest ones that reach `TARGET`, or else the most accurate ones of all. If the judged run diverged,
        its error counts as the whole motion; if no settings of similar cost complete, the cheapest settings
        that complete come first.
    """
    # every kind of settings at the time step of the file, or the first ones that complete at smaller steps
    same_step = ((1.0, settings) for settings in compared.simulation.alternatives(1))
    trials = list(_completed(compared, run, same_step))
    if not trials:
        trials = list(islice(_completed(compared, run, _smaller_steps(compared)), KINDS_REFINED))
    # the most accurate kinds at smaller steps
    trials.sort(key=lambda trial: trial.remedy.error.relative)
    for trial in tuple(trials[:KINDS_REFINED]):
        trials.extend(_refined(compared, run, trial))
    own_error = 1.0 if run.stopped else error.relative
    better = [
        each for each in trials if each.remedy.changes and each.remedy.error.relative < MIN_GAIN * own_error
    ]
    chosen = list(_chosen(better, bool(run.stopped)))
    if chosen and not run.stopped:  # more accurate run times; without them, those of evaluations remain
        own = compared.fastest(compared.simulation.settings)
        chosen = [each.timed(compared, own) for each in chosen]
    errors = [each.remedy.error for each in trials]
    smallest = min(errors, key=lambda each: each.relative, default=None)
    return FoundRemedies(tuple(each.remedy for each in chosen), None if chosen else smallest)


def _completed(compared: Comparison, run: FileRun, kinds: Iterable[tuple[float, Any]]) -> Iterator[_Trial]:
    """Run settings and yield those that complete.

    Args:
        compared, run: see `find_remedies`.
        kinds: divisors of the file's time step, and settings.
    """
    simulation = compared.simulation
    own = compared.run_once(simulation.settings)  # reduced and timed like the other runs
    for divisor, settings in kinds:
        tried = compared.run_once(settings)
        if tried.stopped or not compared.is_comparable(tried):
            continue
        evaluations = simulation.evaluations(settings) / simulation.evaluations(simulation.settings)
        run_time = compared.relative_run_time(settings, tried, own)
        # the fields of `MeasuredSettings`: changes, fragment (text for the file), error
        measured = compared.measured(settings, tried)
        remedy = MeasuredRemedy(*measured, evaluations=evaluations, run_time=run_time)
        yield _Trial(divisor, settings, remedy)


def _smaller_steps(compared: Comparison) -> list[tuple[float, Any]]:
    """List divisors of the time step and all kinds of settings at these, the fewest evaluations first."""
    simulation = compared.simulation
    divisors = [2**k for k in range(1, int(np.log2(MAX_COST)) + 1)]
    kinds = [(float(n), settings) for n in divisors for settings in simulation.alternatives(n)]
    # without those that need more evaluations than their engine can do in a run
    affordable = [pair for pair in kinds if compared.affords(pair[1])]
    return sorted(affordable, key=lambda pair: simulation.evaluations(pair[1]))


def _refined(compared: Comparison, run: FileRun, trial: _Trial) -> Iterator[_Trial]:
    """Halve the time step of settings until they reach `TARGET` or cost too much; yield all that complete."""
    error, factor = trial.remedy.error, 2.0
    while error.relative > TARGET and factor * trial.remedy.evaluations <= MAX_COST:
        divisor = factor * trial.divisor
        settings = compared.simulation.at_divisor(trial.settings, divisor)
        if not compared.affords(settings):
            return
        for finer in _completed(compared, run, [(divisor, settings)]):
            yield finer
            error = finer.remedy.error
        factor *= 2.0


def _chosen(better: Sequence[_Trial], diverged: bool) -> Iterator[_Trial]:
    """Yield the remedies to report, see `find_remedies`.

    Args:
        better: trials with a smaller error than the judged run.
        diverged: whether the judged run diverged.
    """

    def by_error(trial: _Trial) -> float:
        return trial.remedy.error.relative

    def by_cost(trial: _Trial) -> tuple[float, float]:
        return trial.remedy.evaluations, trial.remedy.error.relative

    cheap = min((each for each in better if each.remedy.evaluations <= 1.0), key=by_error, default=None)
    if cheap is None and diverged:
        cheap = min(better, key=by_cost, default=None)
    accurate = min(
        (each for each in better if each.remedy.error.relative <= TARGET), key=by_cost, default=None
    )
    if accurate is None:
        accurate = min(better, key=by_error, default=None)
    if cheap is not None:
        yield cheap
    if accurate is not None and accurate is not cheap:
        yield accurate
