"""Many runs of one scene: runs per second of newton_euler and MuJoCo, on one thread and on all cores.

newton_euler's runs are side by side in the lanes of vector registers; as many as `ALONE` says are also made
one by one by scalar code, on one thread, with the same results to the last bit.

Runs start from random consistent states. Each engine has the setting that runs a sample of these very states
in the least time with none of them further off than the wanted error. newton_euler delivers the poses of all
bodies at all outputs. `mujoco.rollout` delivers MuJoCo's full physics state (time, qpos, qvel) after every
step, of which qpos at outputs is kept; poses are not worked out. States are made, and turned into each
engine's own, before.
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

from crosscheck.report.table import Lines, Part, Rows, Table, figures, texts
from crosscheck.studies.benchmark.ladders import (
    JUDGED,
    STEPS,
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
from newton_euler.codegen.compile import uncollected
from newton_euler.compiled.formulations import FORMULATIONS
from newton_euler.compiled.lanes import load_lanes
from newton_euler.compiled.outputs import named
from newton_euler.compiled.run import Integrator
from newton_euler.errors import NewtonEulerError
from newton_euler.integrators.options import STABILIZATIONS
from newton_euler.integrators.options import Options as OfMethod
from newton_euler.model.scene import Scene
from newton_euler.model.state import State
from newton_euler.model.trajectory import IntegrationError
from newton_euler.reading.excitation import random_states
from newton_euler.runs.batch import simulate_batch, thread_count
from newton_euler.runs.simulate import compile_scene

REPEATS = 5
"""Of every batch, engines and numbers of threads taking turns."""

SAMPLE = 20
"""Runs that settings are chosen on."""

MOST = 150_000_000
"""Bytes that the poses of one batch may hold; outputs are as rare as that needs."""

LIMIT = 10.0
"""s that MuJoCo's runs on one thread may take; it makes fewer runs than newton_euler where they would take
longer."""

ALONE = 8
"""Runs of a batch for each one that is made by scalar code."""

LONGEST = 20.0
"""s that a sample may take: settings that are slower are not tried."""

PER_DECADE = 8
"""Tolerances of newton_euler: MuJoCo's steps are as close to each other."""

TRIES = 2
"""How often a sample is run at a setting that reaches the error; the quicker counts."""


# Engines


class Done(NamedTuple):
    """A batch that was run.

    Attributes:
        seconds: what it took.
        setup: s that it took before to turn states into the engine's own, and to load.
        poses: works out those of each run; raises what ended one of them.
        failed: runs that could not go on.
    """

    seconds: float
    setup: float
    poses: Callable[[], list[Poses]]
    failed: int = 0


class Engine(Protocol):
    """One engine on the states of one scene.

    Attributes:
        delivers: what is included in the time of a run.
    """

    name: str
    delivers: str

    def ladders(self) -> Iterator[Ladder]:
        """Yield all methods that run a batch."""

    def run(self, options: Options, states: Sequence[State], threads: int) -> Done:
        """Run a batch."""


class Own:
    """newton_euler: its adaptive methods. Fixed steps could only favor MuJoCo."""

    name = JUDGED
    delivers = "poses of all bodies at all outputs"

    def __init__(self, scene: Scene) -> None:
        self._scene = scene

    def ladders(self) -> Iterator[Ladder]:
        for formulation, stabilization in product(FORMULATIONS, STABILIZATIONS):
            compiled = compile_scene(self._scene, formulation, stabilization)
            how = {"formulation": formulation, "stabilization": stabilization}
            for ladder in adaptive_ladders(formulation, stabilization, PER_DECADE):
                load_lanes(compiled, ladder.common["integrator"])  # compiling is no time of a sample's
                yield ladder._replace(common=ladder.common | how)

    def run(self, options: Options, states: Sequence[State], threads: int) -> Done:
        start = time.perf_counter()
        batch = simulate_batch(self._scene, states, threads=threads, **options)
        setup = time.perf_counter() - start - batch.wall_time
        failed = len(batch.errors)
        return Done(batch.wall_time, setup, lambda: [(r.position, r.quaternion) for r in batch], failed)


class Scalar(Own):
    """newton_euler's scalar code, which makes one run after another."""

    name = f"{JUDGED}, one by one"
    delivers = "the same, by scalar code"

    def run(self, options: Options, states: Sequence[State], threads: int) -> Done:
        start = time.perf_counter()
        how = {name: options[name] for name in ("formulation", "stabilization")}
        compiled = compile_scene(self._scene, **how)
        chosen = OfMethod(**{name: value for name, value in options.items() if name not in how})
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

        return Done(seconds, begun - start, poses, failed)


class MuJoCo:
    """`mujoco.rollout`, which writes the full physics state after every step."""

    name = "mujoco"
    delivers = "time, qpos and qvel after every step, of which qpos at outputs is kept"

    def __init__(self, scene: Scene, period: float) -> None:
        """Steps are no shorter than in the ladder of runs with outputs of this period, s."""
        from mjcf.benchmark_kernels import compiled

        self._system = compiled(scene)
        self._interval = output_interval(scene)
        self._most = max(1, round(self._interval / period * STEPS[-1]))

    def ladders(self) -> Iterator[Ladder]:
        yield from mujoco_ladders(self._interval, range(1, self._most + 1))

    def run(self, options: Options, states: Sequence[State], threads: int) -> Done:
        from mjcf.benchmark_kernels import Rollout, physics_states

        start = time.perf_counter()
        rollout = Rollout(self._system, **options, threads=threads)
        coordinates = [self._system.coordinates(state) for state in states]
        starts = physics_states(self._system, *map(np.array, zip(*coordinates, strict=True)))
        begun = time.perf_counter()
        runs = rollout(starts)
        seconds = time.perf_counter() - begun
        return Done(seconds, begun - start, lambda: [rollout.poses(qpos) for qpos in runs])


# Settings


class Choice(NamedTuple):
    """A setting tried on a sample: the largest error (m or rad), and the time of the whole sample, s."""

    name: str
    options: Options
    error: float
    seconds: float


def cheapest(
    engine: Engine, states: Sequence[State], exact: Sequence[Poses], error: float, progress: Progress
) -> Choice:
    """Find the setting that runs these states in the least time, none of them further off than `error`.

    Raises:
        CrosscheckError: if no setting reaches the error.
    """
    tried: list[Choice] = []
    reaching: list[Choice] = []
    for ladder in engine.ladders():
        progress(f"{len(states)} runs of {engine.name}: {ladder.method}")
        # a method is left where it takes longer than another that reaches the error
        longest = min((choice.seconds for choice in reaching), default=LONGEST)

        def suffices(n: int, ladder: Ladder = ladder, longest: float = longest) -> bool:
            number = ladder.numbers[n - 1]
            tried.append(_try(engine, *ladder.setting(number), states, exact, error))
            return tried[-1].error <= error or tried[-1].seconds > longest

        smallest(suffices, len(ladder.numbers))
        reaching = [choice for choice in tried if choice.error <= error]
    if not reaching:
        least = min(choice.error for choice in tried)
        reason = f"does not reach an error of {error:g} on all of {len(states)} runs in {LONGEST:g} s"
        raise CrosscheckError(f"{engine.name} {reason}; the least is {least:.1e}")
    return min(reaching, key=lambda choice: choice.seconds)


def _try(
    engine: Engine, name: str, options: Options, states: Sequence[State], exact: Sequence[Poses], error: float
) -> Choice:
    """Run a sample at a setting; its error is infinite if a run cannot go on."""
    seconds, worst = math.inf, math.inf
    for _ in range(TRIES):
        start = time.perf_counter()
        try:
            with uncollected(), time_limit(LONGEST):
                done = engine.run(options, states, threads=1)
            worst = max(max(pose_errors(*pair)) for pair in zip(done.poses(), exact, strict=True))
        except (NewtonEulerError, CrosscheckError):
            return Choice(name, options, math.inf, time.perf_counter() - start)
        seconds = min(seconds, done.seconds)
        if not worst <= error:
            break
    return Choice(name, options, worst, seconds)


# Rates


@dataclass(frozen=True)
class Rate(Timed):
    """One engine on some threads.

    Attributes:
        engine, delivers, setting: names, see `Engine` and `Choice`.
        error: m or rad, the largest of the sample.
        threads, runs: how many.
        setup: s, to turn the states of as many runs into the engine's own, and to load.
        failed: runs that could not go on.
        times: s, of all runs together.
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
        return self.runs / self.median


@dataclass(frozen=True)
class BatchBenchmark:
    """Rates of all engines.

    Attributes:
        duration, outputs: s and number of outputs of each run.
        error: m or rad, what settings had to reach.
        uncertainty: m or rad, of the sample's reference.
        sample, unknown: runs of the sample with and without a reference.
        missing: engines that take no part, and why.
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
    """One thread, and one per core."""
    return tuple(sorted({1, thread_count()}))


def rarer(scene: Scene, runs: int) -> Scene:
    """Return the scene with equal periods between outputs, at least its own, that keep a batch's poses small.

    Raises:
        CrosscheckError: where even the last poses alone are too many.
    """
    outputs = MOST // (runs * len(scene.mechanism.bodies) * 7 * 8)
    if outputs < 2:
        raise CrosscheckError(f"--batch {runs}: poses of two outputs already take more than {MOST:g} bytes")
    number = max(1, min(outputs - 1, int(scene.duration / scene.output_period + 1e-9)))
    return replace(scene, output_period=scene.duration / number)


def benchmark_batch(given: Scene, runs: int, error: float, progress: Progress) -> BatchBenchmark:
    """Measure the throughput of all engines at an error; `progress` is told each stage.

    Raises:
        CrosscheckError: for a scene that cannot be benchmarked, and an error that newton_euler cannot reach.
        NewtonEulerError: for a mechanism that hardly ever closes from nearby.
    """
    scene = rarer(poses_only(given), runs)
    progress(f"{runs} random states")
    states = random_states(scene, runs)
    sample = [states[k] for k in np.linspace(0, runs - 1, min(SAMPLE, runs)).astype(int)]
    exact, uncertainty = batch_references(scene, sample, error, progress)
    known, poses = [sample[k] for k in exact], list(exact.values())
    own = Own(scene)
    choice = cheapest(own, known, poses, error, progress)
    shares: list[tuple[Engine, Choice, Sequence[State]]] = [(own, choice, states)]
    missing: dict[str, str] = {}
    try:
        other = MuJoCo(scene, given.output_period)
        found = cheapest(other, known, poses, error, progress)
    except (NewtonEulerError, CrosscheckError) as reason:
        missing[MuJoCo.name] = reason_of(reason)
    else:
        most = LIMIT * len(known) / found.seconds
        shares.append((other, found, states[: max(len(known), int(most))]))
    cases = [*product(shares, thread_counts())]
    cases.append(((Scalar(scene), choice, states[:: min(ALONE, runs)]), 1))
    firsts: dict[str, Done] = {}
    calls = [partial(_timed, *case, threads, firsts) for case, threads in cases]
    rates = []
    for ((engine, chosen, share), threads), times in zip(
        cases, in_turns(calls, [REPEATS] * len(calls), progress), strict=True
    ):
        first = firsts[engine.name]
        of_sample = engine.name, engine.delivers, chosen.name, chosen.error
        rates.append(Rate(*of_sample, threads, len(share), first.setup, first.failed, times))
    unknown = len(sample) - len(known)
    made = scene.duration, len(scene.times), error, uncertainty, len(known), unknown
    return BatchBenchmark(*made, tuple(rates), missing)


def _timed(
    engine: Engine, choice: Choice, states: Sequence[State], threads: int, firsts: dict[str, Done]
) -> float:
    """Return the s of a batch, and keep the first of each engine."""
    np.ones(
        MOST // 8
    )  # a virtual machine takes back what is free for seconds, and would give it anew meanwhile
    done = engine.run(choice.options, states, threads)
    firsts.setdefault(engine.name, done)
    return done.seconds


# Report


def parts(result: BatchBenchmark) -> list[Part]:
    """Return the rates by engine and number of threads; ratios are newton_euler's rate side by side over the
    other's."""
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
    heads = figures("threads", "runs", "runs per s", "spread", "scaling", "ratio", "setup, s")
    table = Table("", [*texts("engine"), *heads], rows)
    period = result.duration / (result.outputs - 1)
    lines = [
        f"runs of {result.duration:g} s from random states, {result.outputs} outputs {period:.3g} s apart; "
        f"rates by the median of {REPEATS} repeats in turns; setup is not counted",
        f"settings: the cheapest with none of {result.sample} runs off by more than {result.error:g} m, rad; "
        f"reference known to {result.uncertainty:.1e}"
        + (f"; {result.unknown} more runs have none known as well as that" if result.unknown else ""),
    ]
    for rate in result.rates:
        if rate.threads == 1:
            failed = f"; {rate.failed} runs could not go on" if rate.failed else ""
            made = f"{rate.setting} (error {rate.error:.1e}); delivers {rate.delivers}"
            lines.append(f"{rate.engine}: {made}{failed}")
    lines += [f"{name} takes no part: {reason}" for name, reason in result.missing.items()]
    return [table, Lines("", lines)]
