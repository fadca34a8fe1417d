"""Many runs of one scene: runs per second of newton_euler and MuJoCo, on one thread and on all cores.

Runs start from random consistent states. Each engine has the setting that runs a sample of these very states
in the least time with none of them further off than the wanted error. newton_euler delivers the poses of all
bodies at all outputs. `mujoco.rollout` delivers MuJoCo's full physics state (time, qpos, qvel) after every
step, of which qpos at outputs is kept; poses are not worked out. States are made, and turned into each
engine's own, before.
"""

from __future__ import annotations

import math
import os
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from itertools import product
from typing import Any, NamedTuple

import numpy as np

from crosscheck.errors import CrosscheckError
from crosscheck.limit import time_limit
from crosscheck.report.table import Cell, Lines, Report, Rows, Table, figures, texts
from crosscheck.scenes import load as load_scene
from crosscheck.studies.benchmark import reference
from crosscheck.studies.benchmark.engines import Done, Engine, Method, MuJoCo, Options, Own, Poses
from crosscheck.studies.benchmark.ladders import JUDGED, poses_only
from crosscheck.studies.benchmark.reference import pose_errors
from crosscheck.studies.benchmark.timing import Progress, Timed, in_turns, machine, machine_line, steady
from crosscheck.studies.bisection import smallest
from newton_euler.batch import Batch
from newton_euler.errors import NewtonEulerError
from newton_euler.exercise import random_states
from newton_euler.model.scene import Scene
from newton_euler.model.state import State
from newton_euler.simulate import simulate
from urdf import simulate as simulate_pinocchio

REPEATS = 5
"""Of every batch, engines and numbers of threads taking turns."""

SAMPLE = 20
"""Runs that settings are chosen on."""

MOST = 150_000_000
"""Bytes that the poses of one batch may hold; outputs are as rare as that needs."""

LIMIT = 10.0
"""s that MuJoCo's runs on one thread may take; it makes fewer runs than newton_euler where they would take
longer."""

RTOL = 1e-12
"""Of the sample's reference, with atol = 0.01 rtol."""

LONGEST = 20.0
"""s that a sample may take: settings that are slower are not tried."""

TRIES = 2
"""How often a sample is run at a setting that reaches the error; the quicker counts."""


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
    for method in engine.methods():
        # a method is left where it takes longer than another that reaches the error
        longest = min((choice.seconds for choice in reaching), default=LONGEST)

        def suffices(n: int, method: Method = method, longest: float = longest) -> bool:
            name, options = method.setting(n)
            progress(f"{len(states)} runs of {engine.name}: {name}")
            tried.append(_try(engine, name, options, states, exact, error))
            return tried[-1].error <= error or tried[-1].seconds > longest

        smallest(suffices, method.most)
        reaching = [choice for choice in tried if choice.error <= error]
    if not reaching:
        least = min(choice.error for choice in tried)
        reason = f"does not reach an error of {error:g} on all of {len(states)} runs"
        raise CrosscheckError(f"{engine.name} {reason}; the least is {least:.1e}")
    return min(reaching, key=lambda choice: choice.seconds)


def _try(
    engine: Engine,
    name: str,
    options: Options,
    states: Sequence[State],
    exact: Sequence[Poses],
    error: float,
) -> Choice:
    """Run a sample at a setting; its error is infinite if a run cannot go on."""
    seconds, worst = math.inf, math.inf
    for _ in range(TRIES):
        start = time.perf_counter()
        try:
            with steady(), time_limit(LONGEST):
                done = engine.run(options, states, threads=1)
            worst = max(max(pose_errors(*pair)) for pair in zip(done.poses(), exact, strict=True))
        except (NewtonEulerError, CrosscheckError):
            return Choice(name, options, math.inf, time.perf_counter() - start)
        seconds = min(seconds, done.processor)
        if not worst <= error:
            break
    return Choice(name, options, worst, seconds)


def references(scene: Scene, states: Sequence[State]) -> tuple[dict[int, Poses], float]:
    """Return Pinocchio's poses at tight tolerances by number of the state, and how far newton_euler's differ.

    A state has none from which one of them cannot go that tightly: its run passes a singular configuration.

    Raises:
        CrosscheckError: if none has any.
    """
    tight: dict[str, Any] = {"rtol": RTOL, "atol": 0.01 * RTOL}
    found: dict[int, Poses] = {}
    uncertainty = 0.0
    for k, state in enumerate(states):
        started = replace(scene, initial_state=state)
        try:
            with time_limit(reference.LIMIT):
                own, exact = simulate(started, **tight), simulate_pinocchio(started, **tight)
        except (NewtonEulerError, CrosscheckError) as error:
            reason = str(error)
            continue
        found[k] = exact.position, exact.quaternion
        uncertainty = max(uncertainty, *pose_errors((own.position, own.quaternion), found[k]))
    if not found:
        raise CrosscheckError(f"none of {len(states)} random runs has a reference; the last: {reason}")
    return found, uncertainty


# Rates


@dataclass(frozen=True)
class Rate(Timed):
    """One engine on some threads.

    Attributes:
        engine, setting: names.
        error: m or rad, the largest of the sample.
        threads, runs: how many.
        setup: s, to turn the states of as many runs into the engine's own, and to load.
        failed: runs that could not go on.
        times: s, of all runs together.
    """

    engine: str
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

    @property
    def spread(self) -> float:
        """The difference between the quartiles of the times, as a share of their median."""
        low, high = self.quartiles
        return (high - low) / self.median


@dataclass(frozen=True)
class BatchBenchmark:
    """Rates of both engines.

    Attributes:
        source, options: of the scene.
        machine: what it ran on.
        duration, outputs: s and number of outputs of each run.
        error: m or rad, what settings had to reach.
        uncertainty: m or rad, of the sample's reference.
        sample, unknown: runs of the sample with and without a reference.
    """

    source: str
    options: Mapping[str, str]
    machine: dict[str, Any]
    duration: float
    outputs: int
    error: float
    uncertainty: float
    sample: int
    unknown: int
    rates: tuple[Rate, ...]


def thread_counts() -> tuple[int, ...]:
    """One thread, and one per core."""
    return tuple(sorted({1, os.cpu_count() or 1}))


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


def benchmark_batch(
    source: str, options: Mapping[str, str], runs: int, error: float, progress: Progress
) -> BatchBenchmark:
    """Measure the throughput of both engines at an error; `progress` is told each stage.

    Raises:
        CrosscheckError: for a scene that cannot be benchmarked, an error that an engine cannot reach, or
            threads that change newton_euler's results.
        NewtonEulerError: for a mechanism that hardly ever closes from nearby.
    """
    where = machine()
    given = poses_only(load_scene(source, **options))
    scene = rarer(given, runs)
    progress(f"{runs} random states")
    states = random_states(scene, runs)
    sample = [states[k] for k in np.linspace(0, runs - 1, min(SAMPLE, runs)).astype(int)]
    progress(f"reference of {len(sample)} runs")
    exact, uncertainty = references(scene, sample)
    if uncertainty > error:
        raise CrosscheckError(f"--error {error:g}: the reference is known to {uncertainty:.1e} only")
    known, poses = [sample[k] for k in exact], list(exact.values())
    engines: tuple[Engine, ...] = Own(scene), MuJoCo(scene, given.output_period)
    choices = [cheapest(engine, known, poses, error, progress) for engine in engines]
    most = LIMIT * len(known) / choices[1].seconds
    shares = [states, states[: max(len(known), int(most))]]
    cases = [*product(zip(engines, choices, shares, strict=True), thread_counts())]
    firsts: dict[str, Done] = {}
    calls = [partial(_timed, *case, threads, firsts) for case, threads in cases]
    times = in_turns(calls, [REPEATS] * len(calls), progress)
    rates = []
    for ((engine, choice, own), threads), row in zip(cases, times, strict=True):
        first = firsts[engine.name]
        failed = len(first.batch.errors) if first.batch is not None else 0
        rates.append(
            Rate(engine.name, choice.name, choice.error, threads, len(own), first.setup, failed, row)
        )
    return BatchBenchmark(
        source=source,
        options=options,
        machine=where,
        duration=scene.duration,
        outputs=len(scene.times),
        error=error,
        uncertainty=uncertainty,
        sample=len(known),
        unknown=len(sample) - len(known),
        rates=tuple(rates),
    )


def _timed(
    engine: Engine, choice: Choice, states: Sequence[State], threads: int, firsts: dict[str, Done]
) -> float:
    """Return the s of a batch, and keep the first of each engine."""
    done = engine.run(choice.options, states, threads)
    first = firsts.setdefault(engine.name, done)
    if first.batch is not None and done.batch is not None and not identical(first.batch, done.batch):
        raise CrosscheckError(f"{engine.name}: {threads} threads change the results of a batch")
    return done.seconds


def identical(one: Batch, other: Batch) -> bool:
    """True if two batches are equal to the last bit."""
    return one.errors.keys() == other.errors.keys() and all(
        np.array_equal(one.stacked(name), other.stacked(name), equal_nan=True)
        for name in ("position", "quaternion")
    )


# Report


def batch_report(result: BatchBenchmark) -> Report:
    """Return the rates by engine and number of threads; ratios are newton_euler's rate over the other's."""
    rates = {(rate.engine, rate.threads): rate.per_second for rate in result.rates}
    rows: Rows = [
        [
            rate.engine,
            rate.setting,
            f"{rate.error:.1e}",
            str(rate.threads),
            str(rate.runs),
            f"{rate.per_second:.4g}",
            f"{rate.spread:.0%}",
            f"{rate.per_second / rates[rate.engine, 1]:.2f}",
            "-" if rate.engine == JUDGED else f"{rates[JUDGED, rate.threads] / rate.per_second:.3g}",
            f"{rate.setup:.2f}",
        ]
        for rate in result.rates
    ]
    names = ("error", "threads", "runs", "runs per s", "spread", "scaling", "ratio", "setup, s")
    table = Table("", [*texts("engine", "setting"), *figures(*names)], rows)
    period = result.duration / (result.outputs - 1)
    lines = [
        machine_line(result.machine),
        f"runs of {result.duration:g} s from random consistent states, {result.outputs} outputs "
        f"{period:.3g} s apart",
        f"settings: the cheapest with no run of a sample of {result.sample} off by more than "
        f"{result.error:g} m or rad; error: the largest of that sample",
        f"the sample's reference is known to {result.uncertainty:.1e}; {result.unknown} more of these runs "
        f"have none at rtol {RTOL:g}",
        f"rates are of the median of {REPEATS} repeats in turns; spread: between the quartiles of the times",
        "newton_euler's results on all numbers of threads are equal to the last bit",
        "setup, not counted: states into each engine's own, loading",
        *(f"{engine.name} delivers {engine.delivers}" for engine in (Own, MuJoCo)),
        *(
            f"{rate.engine}: {rate.failed} runs could not go on"
            for rate in result.rates
            if rate.failed and rate.threads == 1
        ),
    ]
    return Report("many runs", "", Cell(""), [table, Lines("", lines)])


def batch_data(result: BatchBenchmark) -> dict[str, Any]:
    """Return everything measured, for JSON."""
    rates = [asdict(rate) | {"rate": rate.per_second} for rate in result.rates]
    return asdict(result) | {"rates": rates}
