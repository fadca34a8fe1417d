"""Batch benchmark: runs per second of engines at an error, on one thread and on all cores.

A batch is many runs of one scene. They start from random states that satisfy all constraints. For each engine
with batches (see `crosscheck.engines.benchmarks`), a sample of these runs selects the fastest setting whose
largest error is at most the given error. Generation of the states, and their conversion for each engine, is
not timed.

newton_euler simulates several runs at once in vector registers. One run in `SCALAR_SAMPLE_EVERY` is also
simulated by scalar code, which has bitwise identical results.

Errors are the largest distance, m, or angle, rad, between the poses of a run and its reference motion.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import product
from typing import NamedTuple

import numpy as np

from crosscheck.engines.benchmarks import BatchEngine, CompletedBatch, poses_only
from crosscheck.engines.engine import Engine
from crosscheck.engines.registry import SOLVER
from crosscheck.report.chart import BarChart, Measure, log_chart
from crosscheck.report.table import Lines, Part, Rows, Table, number_columns, text_columns
from crosscheck.studies.benchmark.batch_settings import TriedSetting, fastest_setting
from crosscheck.studies.benchmark.reference import batch_references
from crosscheck.studies.benchmark.timing import Progress, Timed, time_alternately
from crosscheck.support.errors import CrosscheckError, reason_of
from newton_euler.errors import NewtonEulerError
from newton_euler.model.scene import Scene
from newton_euler.model.state import State
from newton_euler.reading.excitation import random_states
from newton_euler.runs.batch import thread_count

BATCH_REPEATS = 5
"""Number of times that every batch is timed; engines and numbers of threads alternate."""

SAMPLE_RUNS = 20
"""Number of runs of the sample on which settings are chosen."""

MAX_POSE_BYTES = 150_000_000
"""Largest memory of the poses of one batch, bytes; larger batches have fewer outputs per run."""

SCALAR_SAMPLE_EVERY = 8
"""Scalar code simulates every 8th run of a batch, since it needs several times as long as vector code."""

TIME_LIMIT = 10.0
"""Longest duration of the batch of another engine on one thread, s; if all runs would take longer, the batch
has fewer runs."""


class Batch(NamedTuple):
    """A batch to simulate.

    Attributes:
        engine: the engine.
        setting: the fastest setting that reaches the error.
        states: initial state of each run.
    """

    engine: BatchEngine
    setting: TriedSetting
    states: Sequence[State]


# Rates


@dataclass(frozen=True)
class Rate(Timed):
    """Throughput of one engine on a number of threads; `Timed` has the median and spread of its `times`.

    Attributes:
        engine: name of the engine.
        delivers: description of the results that the engine computes.
        setting: name of the setting.
        error: largest error in the sample, m or rad.
        threads: number of threads.
        runs: number of runs of the batch.
        setup: time to load the scene and to convert the states of all runs for the engine, s.
        failed: number of runs that failed.
        times: duration of the batch in each repeat, s.
    """

    engine: str
    delivers: str
    setting: str
    error: float
    threads: int
    runs: int
    setup: float
    failed: int
    times: tuple[float, ...]

    @property
    def per_second(self) -> float:
        """Runs per second, from the median time."""
        return self.runs / self.median


@dataclass(frozen=True)
class BatchBenchmark:
    """Result of the batch benchmark.

    Attributes:
        duration: duration of each run, s.
        outputs: number of outputs of each run.
        error: largest allowed error of the settings, m and rad.
        uncertainty: largest uncertainty of the sample's reference motions, m or rad.
        sample: number of runs of the sample that have a reference motion.
        unknown: number of runs of the sample without a reference motion, which are ignored.
        rates: throughput of each engine and number of threads.
        missing: reason of each engine that cannot run the batch, by engine.
    """

    duration: float
    outputs: int
    error: float
    uncertainty: float
    sample: int
    unknown: int
    rates: tuple[Rate, ...]
    missing: dict[str, str]


def thread_counts() -> tuple[int, ...]:
    """Return the numbers of threads that are timed: one, and one per core."""
    return tuple(sorted({1, thread_count()}))


def with_fewer_outputs(scene: Scene, runs: int) -> Scene:
    """Return the scene with few enough outputs that the poses of a batch of `runs` fit into `MAX_POSE_BYTES`.

    Outputs stay equally spaced, and are never more frequent than in the given scene.

    Raises:
        CrosscheckError: if the poses of two outputs per run are too large.
    """
    # a pose has 7 numbers of 8 bytes
    outputs = MAX_POSE_BYTES // (runs * len(scene.mechanism.bodies) * 7 * 8)
    if outputs < 2:
        problem = f"poses of two outputs already take more than {MAX_POSE_BYTES:g} bytes"
        raise CrosscheckError(f"--batch {runs}: {problem}; give fewer runs")
    intervals = max(1, min(outputs - 1, int(scene.duration / scene.output_period + 1e-9)))
    return replace(scene, output_period=scene.duration / intervals)


def benchmark_batch(
    given: Scene, engines: Sequence[Engine], runs: int, error: float, progress: Progress
) -> BatchBenchmark:
    """Measure the throughput of newton_euler and of other engines at an error.

    Args:
        given: the scene, with its own outputs.
        engines: engines; those without batches are among the `missing` ones.
        runs: number of runs of a batch.
        error: largest allowed error of a run, m and rad.
        progress: called with the name of each stage.

    Raises:
        CrosscheckError: for a scene that cannot be benchmarked, or an error that newton_euler cannot reach.
        NewtonEulerError: if too few random states satisfy the constraints.
    """
    # Random states, and the reference motions of a sample of them; some states have no reference motion
    scene = with_fewer_outputs(poses_only(given), runs)
    progress(f"{runs} random states")
    states = random_states(scene, runs)
    sample = [states[k] for k in np.linspace(0, runs - 1, min(SAMPLE_RUNS, runs)).astype(int)]
    exact, uncertainty = batch_references(scene, sample, error, progress)
    known, poses = [sample[k] for k in exact], list(exact.values())
    # The fastest setting of each engine on the sample
    own = SOLVER.benchmarks()
    assert own.batch is not None
    assert own.one_by_one is not None
    lanes = own.batch(scene, given.output_period)
    lanes_setting = fastest_setting(lanes, known, poses, error, progress)
    batches = [Batch(lanes, lanes_setting, states)]
    missing: dict[str, str] = {}
    for engine in engines:
        if engine.name == SOLVER.name:
            continue
        try:
            if (make := engine.benchmarks().batch) is None:
                raise CrosscheckError("it has no batches")
            other = make(scene, given.output_period)
            setting = fastest_setting(other, known, poses, error, progress)
        except (NewtonEulerError, CrosscheckError) as reason:
            missing[engine.name] = reason_of(reason)
        else:
            max_runs = TIME_LIMIT * len(known) / setting.seconds
            batches.append(Batch(other, setting, states[: max(len(known), int(max_runs))]))
    # Times of the batches; engines and numbers of threads alternate
    cases = [*product(batches, thread_counts())]
    every = min(SCALAR_SAMPLE_EVERY, runs)
    cases.append((Batch(own.one_by_one(scene), lanes_setting, states[::every]), 1))
    first_batches: dict[str, CompletedBatch] = {}
    calls = [partial(_time_batch, batch, threads, first_batches) for batch, threads in cases]
    times_of_cases = time_alternately(calls, [BATCH_REPEATS] * len(calls), progress)
    # Results
    rates = []
    for (batch, threads), times in zip(cases, times_of_cases, strict=True):
        first = first_batches[batch.engine.name]
        rates.append(
            Rate(
                engine=batch.engine.name,
                delivers=batch.engine.delivers,
                setting=batch.setting.name,
                error=batch.setting.error,
                threads=threads,
                runs=len(batch.states),
                setup=first.setup,
                failed=first.failed,
                times=times,
            )
        )
    return BatchBenchmark(
        duration=scene.duration,
        outputs=len(scene.times),
        error=error,
        uncertainty=uncertainty,
        sample=len(known),
        unknown=len(sample) - len(known),
        rates=tuple(rates),
        missing=missing,
    )


def _time_batch(batch: Batch, threads: int, first_batches: dict[str, CompletedBatch]) -> float:
    """Simulate a batch and return its duration, s; keep the first batch of each engine in `first_batches`."""
    # Write to as much memory as a batch needs. A virtual machine reclaims memory that is free for some
    # seconds, and the time to get the memory back would be timed.
    np.ones(MAX_POSE_BYTES // 8)
    done = batch.engine.run(batch.setting.options, batch.states, threads)
    first_batches.setdefault(batch.engine.name, done)
    return done.seconds


# Report


def parts(result: BatchBenchmark) -> list[Part]:
    """Make the report: throughput by engine and number of threads.

    The column `scaling` is the throughput divided by that of the same engine on one thread. The column
    `ratio` is newton_euler's throughput in vector registers divided by that of the engine.
    """
    rates = {(rate.engine, rate.threads): rate.per_second for rate in result.rates}
    rows: Rows = []
    for rate in result.rates:
        scaling = rate.per_second / rates[rate.engine, 1]
        ratio = rates[SOLVER.name, rate.threads] / rate.per_second
        rows.append(
            [
                rate.engine,
                str(rate.threads),
                str(rate.runs),
                f"{rate.per_second:.4g}",
                rate.spread,
                f"{scaling:.2f}",
                "-" if rate.engine == SOLVER.name else f"{ratio:.3g}",
                f"{rate.setup:.2f}",
            ]
        )
    heads = number_columns("threads", "runs", "runs per s", "spread", "scaling", "ratio", "setup, s")
    table = Table(title="", columns=[*text_columns("engine"), *heads], rows=rows)
    period = result.duration / (result.outputs - 1)
    lines = [
        f"runs of {result.duration:g} s from random states, {result.outputs} outputs {period:.3g} s apart; "
        f"rates by the median of {BATCH_REPEATS} alternating repeats, without setup",
        f"settings: fastest whose error in {result.sample} sample runs is {result.error:g} m, rad or less; "
        f"reference known to {result.uncertainty:.1e}"
        + (f"; {result.unknown} more sample runs have no reference that good" if result.unknown else ""),
    ]
    for rate in result.rates:
        if rate.threads == 1:
            failed = f"; {rate.failed} runs failed" if rate.failed else ""
            made = f"{rate.setting} (error {rate.error:.1e}); delivers {rate.delivers}"
            lines.append(f"{rate.engine}: {made}{failed}")
    lines += [f"{name} is missing: {reason}" for name, reason in result.missing.items()]
    return [table, Lines(title="", lines=lines)]


def verdict(result: BatchBenchmark) -> str:
    """Report the highest throughput in one line."""
    best = max(result.rates, key=lambda rate: rate.per_second, default=None)
    if best is None:
        return "no engine can run the batch"
    threads = f"{best.threads} thread{'s' * (best.threads != 1)}"
    return f"the highest throughput is {best.per_second:.4g} runs per s, by {best.engine} on {threads}"


def charts(result: BatchBenchmark) -> list[BarChart]:
    """Make the chart of the throughput of each engine and number of threads."""
    rates = [
        Measure(f"{rate.engine}, {rate.threads} thread{'s' * (rate.threads != 1)}", rate.per_second, text)
        for rate in result.rates
        for text in [f"{rate.per_second:.4g} per s"]
    ]
    return log_chart("Throughput", f"Runs per second with an error of at most {result.error:g} m, rad", rates)
