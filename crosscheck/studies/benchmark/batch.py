"""Batch benchmark: runs per second of newton_euler and MuJoCo at an error, on one thread and on all cores.

A batch is many runs of one scene. They start from random states that satisfy all constraints. For each
engine, a sample of these runs selects the fastest setting whose largest error is at most the given error. A
setting is a method with its step or tolerance. newton_euler computes the poses of all bodies at all output
times. `mujoco.rollout` returns MuJoCo's full physics state (time, qpos, qvel) after every step; qpos at the
output times is kept, and no poses are computed. Generation of the states, and their conversion for each
engine, is not timed.

newton_euler simulates several runs at once, one in each lane (element) of the processor's vector registers.
One run in `SCALAR_SAMPLE_EVERY` is also simulated by scalar code, which has bitwise identical results.

Errors are the largest distance, m, or angle, rad, between the poses of a run and its reference motion.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import product
from typing import NamedTuple, Protocol

import numpy as np

from crosscheck.report.table import Lines, Part, Rows, Table, number_columns, text_columns
from crosscheck.studies.benchmark.ladders import (
    BASELINE_ENGINE,
    STEPS_PER_OUTPUT,
    Ladder,
    Options,
    Poses,
    adaptive_ladders,
    mujoco_ladders,
    output_interval,
    poses_only,
)
from crosscheck.studies.benchmark.reference import batch_references, pose_errors
from crosscheck.studies.benchmark.timing import Progress, Timed, time_alternately
from crosscheck.studies.bisection import smallest
from crosscheck.support.errors import CrosscheckError, reason_of
from crosscheck.support.time_limits import time_limit
from newton_euler.codegen.compile import garbage_collection_off
from newton_euler.compiled.formulations import FORMULATIONS
from newton_euler.compiled.lanes import load_lanes
from newton_euler.compiled.outputs import named
from newton_euler.compiled.run import Integrator
from newton_euler.errors import NewtonEulerError
from newton_euler.integrators.options import STABILIZATIONS
from newton_euler.integrators.options import Options as IntegratorOptions
from newton_euler.model.scene import Scene
from newton_euler.model.state import State
from newton_euler.model.trajectory import IntegrationError
from newton_euler.reading.excitation import random_states
from newton_euler.runs.batch import simulate_batch, thread_count
from newton_euler.runs.simulate import compile_scene

BATCH_REPEATS = 5
"""Number of times that every batch is timed; engines and numbers of threads alternate."""

SAMPLE_RUNS = 20
"""Number of runs of the sample on which settings are chosen."""

MAX_POSE_BYTES = 150_000_000
"""Largest memory of the poses of one batch, bytes; larger batches have fewer outputs per run."""

MUJOCO_TIME_LIMIT = 10.0
"""Longest duration of MuJoCo's batch on one thread, s; if all runs would take longer, the batch has fewer
runs."""

SCALAR_SAMPLE_EVERY = 8
"""Scalar code simulates every 8th run of a batch, since it needs several times as long as vector code."""

SAMPLE_TIME_LIMIT = 20.0
"""Longest duration of the sample at one setting, s; slower settings are given up."""

TOLERANCES_PER_DECADE = 8
"""Number of newton_euler's tolerances per factor of ten, as dense as MuJoCo's steps."""

SAMPLE_TRIES = 2
"""Number of times that the sample is timed at a setting that reaches the error; the shorter time counts."""


# Engines


class CompletedBatch(NamedTuple):
    """A batch that was simulated.

    Attributes:
        seconds: duration of the simulation, s.
        setup: duration before the simulation of loading the scene and converting states for the engine, s.
        poses: computes the poses of each run, positions and quaternions of all bodies at all output times;
            raises the error of a run that failed.
        failed: number of runs that failed.
    """

    seconds: float
    setup: float
    poses: Callable[[], list[Poses]]
    failed: int = 0


class Engine(Protocol):
    """An engine that simulates batches of one scene.

    Attributes:
        name: name of the engine.
        delivers: description of the results whose computation is included in the time.
    """

    name: str
    delivers: str

    def ladders(self) -> Iterator[Ladder]:
        """Yield a ladder for each method: its settings, numbered from coarse to fine."""

    def run(self, options: Options, states: Sequence[State], threads: int) -> CompletedBatch:
        """Simulate one run from each state, with the options of a setting, on a number of threads."""


class NewtonEulerBatch:
    """newton_euler with several runs at once in vector registers.

    The settings are those of the integrators with error control; fixed steps are slower at every error. A
    formulation is a choice of coordinates (of joints or of bodies), a stabilization a method that keeps
    constraint violations small.
    """

    name = BASELINE_ENGINE
    delivers = "poses of all bodies at all outputs"

    def __init__(self, scene: Scene) -> None:
        self._scene = scene

    def ladders(self) -> Iterator[Ladder]:
        """Yield the settings of each formulation, stabilization and integrator; compile their code."""
        for formulation, stabilization in product(FORMULATIONS, STABILIZATIONS):
            compiled = compile_scene(self._scene, formulation, stabilization)
            equations = {"formulation": formulation, "stabilization": stabilization}
            for ladder in adaptive_ladders(formulation, stabilization, TOLERANCES_PER_DECADE):
                load_lanes(compiled, ladder.common["integrator"])  # compile before a sample is timed
                # `common` has the options that all settings of the ladder share
                yield ladder._replace(common=ladder.common | equations)

    def run(self, options: Options, states: Sequence[State], threads: int) -> CompletedBatch:
        """Simulate one run from each state."""
        start = time.perf_counter()
        batch = simulate_batch(self._scene, states, threads=threads, **options)
        return CompletedBatch(
            seconds=batch.wall_time,
            setup=time.perf_counter() - start - batch.wall_time,
            poses=lambda: [(run.position, run.quaternion) for run in batch],
            failed=len(batch.errors),
        )


class NewtonEulerScalar(NewtonEulerBatch):
    """newton_euler's scalar code, which simulates one run after another."""

    name = f"{BASELINE_ENGINE}, one by one"
    delivers = "the same, by scalar code"

    def run(self, options: Options, states: Sequence[State], threads: int) -> CompletedBatch:
        """Simulate one run from each state on one thread; `threads` is not used."""
        # Setup: compile the scene, and convert the states to its coordinates
        start = time.perf_counter()
        equations = {name: options[name] for name in ("formulation", "stabilization")}
        compiled = compile_scene(self._scene, **equations)
        chosen = IntegratorOptions(
            **{name: value for name, value in options.items() if name not in equations}
        )
        # an input vector x has coordinates and velocities, `compiled.size` numbers, then the time and more
        starts = np.tile(compiled.start, (len(states), 1))
        for x, state in zip(starts, states, strict=True):
            x[: compiled.size] = np.concatenate(compiled.system.coordinates(state))
        integrator = Integrator(compiled, self._scene.times, chosen)
        results, failed = np.empty((len(states), *integrator.outputs.shape)), 0
        # Simulation: integrate from x, then compute the outputs of the run
        run_start = time.perf_counter()
        for x, result in zip(starts, results, strict=True):
            try:
                integrator(x)
                integrator.outputs(result)
            except IntegrationError:
                failed += 1
        seconds = time.perf_counter() - run_start

        def poses() -> list[Poses]:
            """Return the poses of all runs; `named` divides the flat outputs of a run into arrays by name."""
            arrays = [named(compiled, result) for result in results]
            return [(each["position"], each["quaternion"]) for each in arrays]

        return CompletedBatch(seconds, setup=run_start - start, poses=poses, failed=failed)


class MuJoCoRollout:
    """`mujoco.rollout`, MuJoCo's function for batches. It writes the full physics state after every step."""

    name = "mujoco"
    delivers = "time, qpos and qvel after every step, of which qpos at outputs is kept"

    def __init__(self, scene: Scene, period: float) -> None:
        """Compile the scene for MuJoCo.

        Args:
            scene: the scene of the batch.
            period: output period of the benchmark of whole runs, s. The shortest step of that benchmark is
                also the shortest step of batches.
        """
        from mjcf.benchmark_kernels import compiled

        self._system = compiled(scene)
        self._interval = output_interval(scene)
        self._max_steps = max(1, round(self._interval / period * STEPS_PER_OUTPUT[-1]))

    def ladders(self) -> Iterator[Ladder]:
        """Yield the settings of each integrator: all numbers of steps per output interval."""
        yield from mujoco_ladders(self._interval, range(1, self._max_steps + 1))

    def run(self, options: Options, states: Sequence[State], threads: int) -> CompletedBatch:
        """Simulate one run from each state."""
        from mjcf.benchmark_kernels import Rollout, physics_states

        # Setup
        start = time.perf_counter()
        rollout = Rollout(self._system, **options, threads=threads)
        coordinates = [self._system.coordinates(state) for state in states]
        starts = physics_states(self._system, *map(np.array, zip(*coordinates, strict=True)))
        # Simulation
        run_start = time.perf_counter()
        runs = rollout(starts)
        seconds = time.perf_counter() - run_start
        return CompletedBatch(
            seconds, setup=run_start - start, poses=lambda: [rollout.poses(qpos) for qpos in runs]
        )


# Settings


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


class Batch(NamedTuple):
    """A batch to simulate.

    Attributes:
        engine: the engine.
        setting: the fastest setting that reaches the error.
        states: initial state of each run.
    """

    engine: Engine
    setting: TriedSetting
    states: Sequence[State]


def fastest_setting(
    engine: Engine, states: Sequence[State], exact: Sequence[Poses], error: float, progress: Progress
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
    engine: Engine, name: str, options: Options, states: Sequence[State], exact: Sequence[Poses], error: float
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


def benchmark_batch(given: Scene, runs: int, error: float, progress: Progress) -> BatchBenchmark:
    """Measure the throughput of all engines at an error.

    Args:
        given: the scene, with its own outputs.
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
    lanes = NewtonEulerBatch(scene)
    lanes_setting = fastest_setting(lanes, known, poses, error, progress)
    batches = [Batch(lanes, lanes_setting, states)]
    missing: dict[str, str] = {}
    try:
        rollout = MuJoCoRollout(scene, given.output_period)
        rollout_setting = fastest_setting(rollout, known, poses, error, progress)
    except (NewtonEulerError, CrosscheckError) as reason:
        missing[MuJoCoRollout.name] = reason_of(reason)
    else:
        max_runs = MUJOCO_TIME_LIMIT * len(known) / rollout_setting.seconds
        batches.append(Batch(rollout, rollout_setting, states[: max(len(known), int(max_runs))]))
    # Times of the batches; engines and numbers of threads alternate
    cases = [*product(batches, thread_counts())]
    every = min(SCALAR_SAMPLE_EVERY, runs)
    cases.append((Batch(NewtonEulerScalar(scene), lanes_setting, states[::every]), 1))
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
        ratio = rates[BASELINE_ENGINE, rate.threads] / rate.per_second
        rows.append(
            [
                rate.engine,
                str(rate.threads),
                str(rate.runs),
                f"{rate.per_second:.4g}",
                rate.spread,
                f"{scaling:.2f}",
                "-" if rate.engine == BASELINE_ENGINE else f"{ratio:.3g}",
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
