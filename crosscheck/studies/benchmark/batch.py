"""Batch benchmark: runs per second of newton_euler and MuJoCo at an error, on one thread and on all cores.

The runs start from random consistent states. For each engine a sample of these states selects the fastest
setting whose largest error is below the wanted one. newton_euler delivers the poses of all bodies at all
outputs. `mujoco.rollout` delivers MuJoCo's full physics state (time, qpos, qvel) after every step; qpos at
the outputs is kept, and no poses are computed. Making the states, and converting them for each engine, is not
timed.

newton_euler simulates several runs at once, one in each lane of the vector registers. One run of every
`SCALAR_SAMPLE_EVERY` is also simulated alone by scalar code, with bitwise identical results.
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
    JUDGED,
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
from crosscheck.studies.benchmark.timing import Progress, Timed, in_turns
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
"""Number of runs on which settings are chosen."""

MAX_POSE_BYTES = 150_000_000
"""Bytes, largest memory of the poses of one batch; larger batches have fewer outputs per run."""

MUJOCO_TIME_LIMIT = 10.0
"""s, longest time of MuJoCo's runs on one thread; if all runs would take longer, MuJoCo makes fewer of
them."""

SCALAR_SAMPLE_EVERY = 8
"""Number of runs of a batch for each run that scalar code repeats."""

SAMPLE_TIME_LIMIT = 20.0
"""s, longest time of a sample; slower settings are not tried."""

TOLERANCES_PER_DECADE = 8
"""Density of newton_euler's tolerances, as dense as MuJoCo's steps."""

SAMPLE_TRIES = 2
"""Number of times that a sample is timed at a setting that reaches the error; the shorter time counts."""


# Engines


class CompletedBatch(NamedTuple):
    """A batch that was simulated.

    Attributes:
        seconds: s, time of the simulation.
        setup: s, time before it to load the scene and to convert states for the engine.
        poses: computes the poses of each run; raises the error of a run that failed.
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
        delivers: the results whose computation is included in the time.
    """

    name: str
    delivers: str

    def ladders(self) -> Iterator[Ladder]:
        """Yield the settings of each method."""

    def run(self, options: Options, states: Sequence[State], threads: int) -> CompletedBatch:
        """Simulate one run from each state."""


class NewtonEulerBatch:
    """newton_euler in lanes, with its adaptive methods. Its fixed steps are slower at every error."""

    name = JUDGED
    delivers = "poses of all bodies at all outputs"

    def __init__(self, scene: Scene) -> None:
        self._scene = scene

    def ladders(self) -> Iterator[Ladder]:
        for formulation, stabilization in product(FORMULATIONS, STABILIZATIONS):
            compiled = compile_scene(self._scene, formulation, stabilization)
            how = {"formulation": formulation, "stabilization": stabilization}
            for ladder in adaptive_ladders(formulation, stabilization, TOLERANCES_PER_DECADE):
                load_lanes(compiled, ladder.common["integrator"])  # compile before a sample is timed
                yield ladder._replace(common=ladder.common | how)

    def run(self, options: Options, states: Sequence[State], threads: int) -> CompletedBatch:
        start = time.perf_counter()
        batch = simulate_batch(self._scene, states, threads=threads, **options)
        setup = time.perf_counter() - start - batch.wall_time
        failed = len(batch.errors)
        return CompletedBatch(
            batch.wall_time, setup, lambda: [(r.position, r.quaternion) for r in batch], failed
        )


class NewtonEulerScalar(NewtonEulerBatch):
    """newton_euler's scalar code, which simulates one run after another."""

    name = f"{JUDGED}, one by one"
    delivers = "the same, by scalar code"

    def run(self, options: Options, states: Sequence[State], threads: int) -> CompletedBatch:
        start = time.perf_counter()
        how = {name: options[name] for name in ("formulation", "stabilization")}
        compiled = compile_scene(self._scene, **how)
        chosen = IntegratorOptions(**{name: value for name, value in options.items() if name not in how})
        starts = np.tile(compiled.start, (len(states), 1))
        for x, state in zip(starts, states, strict=True):
            x[: compiled.size] = np.concatenate(compiled.system.coordinates(state))
        integrator = Integrator(compiled, self._scene.times, chosen)
        results, failed = np.empty((len(states), *integrator.outputs.shape)), 0
        begun = time.perf_counter()
        for x, result in zip(starts, results, strict=True):
            try:
                integrator(x)
                integrator.outputs(result)
            except IntegrationError:
                failed += 1
        seconds = time.perf_counter() - begun

        def poses() -> list[Poses]:
            arrays = [named(compiled, result) for result in results]
            return [(each["position"], each["quaternion"]) for each in arrays]

        return CompletedBatch(seconds, begun - start, poses, failed)


class MuJoCoRollout:
    """`mujoco.rollout`, which writes the full physics state after every step."""

    name = "mujoco"
    delivers = "time, qpos and qvel after every step, of which qpos at outputs is kept"

    def __init__(self, scene: Scene, period: float) -> None:
        """Compile the scene for MuJoCo.

        Args:
            scene: the scene of the batch.
            period: s, output period of the benchmark of whole runs, whose shortest step limits steps here.
        """
        from mjcf.benchmark_kernels import compiled

        self._system = compiled(scene)
        self._interval = output_interval(scene)
        self._most = max(1, round(self._interval / period * STEPS_PER_OUTPUT[-1]))

    def ladders(self) -> Iterator[Ladder]:
        yield from mujoco_ladders(self._interval, range(1, self._most + 1))

    def run(self, options: Options, states: Sequence[State], threads: int) -> CompletedBatch:
        from mjcf.benchmark_kernels import Rollout, physics_states

        start = time.perf_counter()
        rollout = Rollout(self._system, **options, threads=threads)
        coordinates = [self._system.coordinates(state) for state in states]
        starts = physics_states(self._system, *map(np.array, zip(*coordinates, strict=True)))
        begun = time.perf_counter()
        runs = rollout(starts)
        seconds = time.perf_counter() - begun
        return CompletedBatch(seconds, begun - start, lambda: [rollout.poses(qpos) for qpos in runs])


# Settings


class TriedSetting(NamedTuple):
    """A setting that was tried on the sample.

    Attributes:
        name, options: the setting.
        error: m or rad, largest error of the sample; infinite if a run failed.
        seconds: s, time of the whole sample.
    """

    name: str
    options: Options
    error: float
    seconds: float


def cheapest(
    engine: Engine, states: Sequence[State], exact: Sequence[Poses], error: float, progress: Progress
) -> TriedSetting:
    """Find the fastest setting of an engine whose largest error over the states is at most `error`.

    Args:
        engine: the engine.
        states: initial states of the sample.
        exact: reference poses of the sample.
        error: m or rad.
        progress: called with the name of each stage.

    Raises:
        CrosscheckError: if no setting reaches the error.
    """
    tried: list[TriedSetting] = []
    reaching: list[TriedSetting] = []
    for ladder in engine.ladders():
        progress(f"{len(states)} runs of {engine.name}: {ladder.method}")
        # stop a method when it takes longer than another method that reaches the error
        longest = min((choice.seconds for choice in reaching), default=SAMPLE_TIME_LIMIT)

        def suffices(n: int, ladder: Ladder = ladder, longest: float = longest) -> bool:
            number = ladder.numbers[n - 1]
            tried.append(_try(engine, *ladder.setting(number), states, exact, error))
            return tried[-1].error <= error or tried[-1].seconds > longest

        smallest(suffices, len(ladder.numbers))
        reaching = [choice for choice in tried if choice.error <= error]
    if not reaching:
        least = min(choice.error for choice in tried)
        reason = f"does not reach an error of {error:g} on all {len(states)} runs in {SAMPLE_TIME_LIMIT:g} s"
        raise CrosscheckError(f"{engine.name} {reason}; its smallest error is {least:.1e}")
    return min(reaching, key=lambda choice: choice.seconds)


def _try(
    engine: Engine, name: str, options: Options, states: Sequence[State], exact: Sequence[Poses], error: float
) -> TriedSetting:
    """Simulate a sample at a setting."""
    seconds, worst = math.inf, math.inf
    for _ in range(SAMPLE_TRIES):
        start = time.perf_counter()
        try:
            with garbage_collection_off(), time_limit(SAMPLE_TIME_LIMIT):
                done = engine.run(options, states, threads=1)
            worst = max(max(pose_errors(*pair)) for pair in zip(done.poses(), exact, strict=True))
        except (NewtonEulerError, CrosscheckError):
            return TriedSetting(name, options, math.inf, time.perf_counter() - start)
        seconds = min(seconds, done.seconds)
        if not worst <= error:
            break
    return TriedSetting(name, options, worst, seconds)


# Rates


@dataclass(frozen=True)
class Rate(Timed):
    """Throughput of one engine on a number of threads.

    Attributes:
        engine, delivers, setting: names, see `Engine` and `TriedSetting`.
        error: m or rad, largest error of the sample.
        threads, runs: number of threads and of runs.
        setup: s, time to load the scene and to convert the states of all runs for the engine.
        failed: number of runs that failed.
        times: s, time of all runs together, at each repetition.
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
        """1/s, runs per second by the median time."""
        return self.runs / self.median


@dataclass(frozen=True)
class BatchBenchmark:
    """Result of the batch benchmark.

    Attributes:
        duration, outputs: s, and number of outputs of each run.
        error: m or rad, error that settings had to reach.
        uncertainty: m or rad, of the reference motions of the sample.
        sample, unknown: runs of the sample with and without a reference motion.
        rates: throughput of each engine and number of threads.
        missing: reason by engine that could not take part.
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


def rarer(scene: Scene, runs: int) -> Scene:
    """Return the scene with so few outputs that the poses of a batch fit into `MAX_POSE_BYTES`.

    Outputs stay equally spaced, and are never more frequent than the scene's own.

    Raises:
        CrosscheckError: if the poses of two outputs per run are too large.
    """
    outputs = MAX_POSE_BYTES // (runs * len(scene.mechanism.bodies) * 7 * 8)
    if outputs < 2:
        problem = f"poses of two outputs already take more than {MAX_POSE_BYTES:g} bytes"
        raise CrosscheckError(f"--batch {runs}: {problem}; give fewer runs")
    number = max(1, min(outputs - 1, int(scene.duration / scene.output_period + 1e-9)))
    return replace(scene, output_period=scene.duration / number)


def benchmark_batch(given: Scene, runs: int, error: float, progress: Progress) -> BatchBenchmark:
    """Measure the throughput of all engines at an error.

    Args:
        given: the scene.
        runs: number of runs of a batch.
        error: m or rad, largest error of a run.
        progress: called with the name of each stage.

    Raises:
        CrosscheckError: for a scene that cannot be benchmarked, and an error that newton_euler cannot reach.
        NewtonEulerError: if too few random configurations can be closed.
    """
    # Random states, and the reference motions of a sample of them
    scene = rarer(poses_only(given), runs)
    progress(f"{runs} random states")
    states = random_states(scene, runs)
    sample = [states[k] for k in np.linspace(0, runs - 1, min(SAMPLE_RUNS, runs)).astype(int)]
    exact, uncertainty = batch_references(scene, sample, error, progress)
    known, poses = [sample[k] for k in exact], list(exact.values())
    # The fastest setting of each engine on the sample
    own = NewtonEulerBatch(scene)
    choice = cheapest(own, known, poses, error, progress)
    batches: list[tuple[Engine, TriedSetting, Sequence[State]]] = [(own, choice, states)]
    missing: dict[str, str] = {}
    try:
        other = MuJoCoRollout(scene, given.output_period)
        found = cheapest(other, known, poses, error, progress)
    except (NewtonEulerError, CrosscheckError) as reason:
        missing[MuJoCoRollout.name] = reason_of(reason)
    else:
        most = MUJOCO_TIME_LIMIT * len(known) / found.seconds
        batches.append((other, found, states[: max(len(known), int(most))]))
    # Times of the batches, engines and threads alternating
    cases = [*product(batches, thread_counts())]
    cases.append(((NewtonEulerScalar(scene), choice, states[:: min(SCALAR_SAMPLE_EVERY, runs)]), 1))
    firsts: dict[str, CompletedBatch] = {}
    calls = [partial(_timed, *case, threads, firsts) for case, threads in cases]
    rates = []
    for ((engine, chosen, share), threads), times in zip(
        cases, in_turns(calls, [BATCH_REPEATS] * len(calls), progress), strict=True
    ):
        first = firsts[engine.name]
        of_sample = engine.name, engine.delivers, chosen.name, chosen.error
        rates.append(Rate(*of_sample, threads, len(share), first.setup, first.failed, times))
    unknown = len(sample) - len(known)
    made = scene.duration, len(scene.times), error, uncertainty, len(known), unknown
    return BatchBenchmark(*made, tuple(rates), missing)


def _timed(
    engine: Engine,
    choice: TriedSetting,
    states: Sequence[State],
    threads: int,
    firsts: dict[str, CompletedBatch],
) -> float:
    """Return the time of a batch, s, and keep the first batch of each engine in `firsts`."""
    # Touch as much memory as a batch needs: a virtual machine reclaims memory that is free for some seconds,
    # and returning it would be timed.
    np.ones(MAX_POSE_BYTES // 8)
    done = engine.run(choice.options, states, threads)
    firsts.setdefault(engine.name, done)
    return done.seconds


# Report


def parts(result: BatchBenchmark) -> list[Part]:
    """Make the report: throughput by engine and number of threads.

    The column `ratio` is newton_euler's throughput in lanes divided by that of the engine.
    """
    rates = {(rate.engine, rate.threads): rate.per_second for rate in result.rates}
    rows: Rows = [
        [
            rate.engine,
            str(rate.threads),
            str(rate.runs),
            f"{rate.per_second:.4g}",
            rate.spread,
            f"{rate.per_second / rates[rate.engine, 1]:.2f}",
            "-" if rate.engine == JUDGED else f"{rates[JUDGED, rate.threads] / rate.per_second:.3g}",
            f"{rate.setup:.2f}",
        ]
        for rate in result.rates
    ]
    heads = number_columns("threads", "runs", "runs per s", "spread", "scaling", "ratio", "setup, s")
    table = Table("", [*text_columns("engine"), *heads], rows)
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
    return [table, Lines("", lines)]
