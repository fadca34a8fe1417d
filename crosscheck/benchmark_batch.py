"""Many runs of one scene: runs per second of newton_euler and MuJoCo, on one thread and on all cores.

Runs start from random consistent states. Each engine has the cheapest setting with which the scene's own
run reaches the wanted error; how far a sample of the runs is off is measured as well. newton_euler delivers
the poses of all bodies at all outputs. `mujoco.rollout` delivers MuJoCo's full physics state (time, qpos,
qvel) after every step, of which qpos at outputs is kept; poses are not worked out. States are made, and
turned into each engine's own, before.
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.table import Table

from crosscheck import benchmark_mujoco, benchmark_newton_euler, benchmark_reference
from crosscheck.benchmark import (
    Measurement,
    Model,
    Progress,
    machine,
    measure,
    pose_errors,
    steady,
    time_limit,
)
from crosscheck.benchmark_engines import JUDGED, poses_only
from crosscheck.benchmark_report import cheapest
from crosscheck.errors import CrosscheckError
from crosscheck.scenes import load
from newton_euler.assemble import random_states
from newton_euler.batch import Batch, simulate_batch
from newton_euler.errors import NewtonEulerError
from newton_euler.scalars import Array
from newton_euler.scene import Scene
from newton_euler.simulate import simulate
from newton_euler.state import State

REPEATS = 3
"""Of every batch; the median counts."""

SAMPLE = 50
"""Runs whose error is measured."""

RTOL = 1e-12
"""Of their reference, with atol = 0.01 rtol."""

MOST = 150_000_000
"""Bytes that the poses of one batch may hold; outputs are as rare as that needs."""

LIMIT = 10.0
"""s that MuJoCo's runs on one thread may take; it makes fewer runs than newton_euler where they would take
longer."""

SHARES = (0.5, *(number for number in benchmark_mujoco.STEPS if number <= 20))
"""MuJoCo's steps tried, in one of the scene's own output periods, however rare outputs are."""

DELIVERED = {
    JUDGED: "poses of all bodies at all outputs",
    "mujoco": "time, qpos and qvel after every step, of which qpos at outputs is kept",
}


@dataclass(frozen=True)
class Throughput:
    """One engine on some threads; times, s, are of all `runs` together."""

    threads: int
    runs: int
    times: tuple[float, ...]

    @property
    def rate(self) -> float:
        """Runs per second."""
        return self.runs / float(np.median(self.times))


@dataclass(frozen=True)
class Side:
    """One engine.

    Attributes:
        engine, setting: names.
        single_error, error: m or rad, of the scene's own run and the largest of the sample.
        setup: s, to turn the states of `throughputs[0].runs` runs into its own, and to load.
        failed: runs that could not go on.
        throughputs: by number of threads.
    """

    engine: str
    setting: str
    single_error: float
    error: float
    setup: float
    failed: int
    throughputs: tuple[Throughput, ...]


@dataclass(frozen=True)
class BatchBenchmark:
    """What was found; `uncertainty`, m or rad, is that of the sample's reference,
    and `unknown` of the sample have none."""

    source: str
    options: Mapping[str, str]
    machine: dict[str, Any]
    duration: float
    outputs: int
    error: float
    uncertainty: float
    sample: int
    unknown: int
    sides: tuple[Side, ...]


class _Own:
    """newton_euler with the options of a setting."""

    def __init__(self, scene: Scene, options: Mapping[str, Any], states: Sequence[State]) -> None:
        self._scene, self._options, self._states = scene, options, states
        self._first: Batch | None = None
        self.runs, self.setup = len(states), 0.0

    def run(self, threads: int) -> float:
        """s of all runs.

        Raises:
            CrosscheckError: if they are not what they were, to the last bit.
        """
        start = time.perf_counter()
        batch = simulate_batch(self._scene, self._states, threads=threads, **self._options)
        self.setup = time.perf_counter() - start - batch.wall_time
        if self._first is None:
            self._first = batch
        elif not identical(self._first, batch):
            raise CrosscheckError(f"newton_euler: {threads} threads change the results of a batch")
        return batch.wall_time

    @property
    def failed(self) -> int:
        assert self._first is not None
        return len(self._first.errors)

    def poses(self, sample: Sequence[int]) -> list[tuple[Array, Array]]:
        """Of a sample of the runs; raises `IntegrationError` for one that could not go on."""
        assert self._first is not None
        runs = [self._first[k] for k in sample]
        return [(run.position, run.quaternion) for run in runs]


class _MuJoCo:
    """`mujoco.rollout` with the options of a setting, on so many of the states as `LIMIT` has time for."""

    failed = 0

    def __init__(
        self, scene: Scene, options: Mapping[str, Any], states: Sequence[State], seconds: float
    ) -> None:
        from mjcf.tight import Rollout, compiled

        self.runs = min(len(states), max(SAMPLE, int(LIMIT / seconds)))
        start = time.perf_counter()
        system = compiled(scene)
        self._rollouts = {threads: Rollout(system, **options, threads=threads) for threads in thread_counts()}
        first = self._rollouts[1]
        self._starts = np.array([first.start(*system.coordinates(state)) for state in states[: self.runs]])
        self.setup = time.perf_counter() - start

    def run(self, threads: int) -> float:
        """s of all runs."""
        start = time.perf_counter()
        self._rollouts[threads](self._starts)
        return time.perf_counter() - start

    def poses(self, sample: Sequence[int]) -> list[tuple[Array, Array]]:
        """Of a sample of the runs."""
        rollout = self._rollouts[1]
        return [rollout.poses(qpos) for qpos in rollout(self._starts[list(sample)])]


def thread_counts() -> tuple[int, ...]:
    """One thread, and one a core."""
    return tuple(sorted({1, os.cpu_count() or 1}))


def identical(one: Batch, other: Batch) -> bool:
    """Whether two batches are equal to the last bit."""
    if len(one) != len(other) or one.errors.keys() != other.errors.keys():
        return False
    pairs = ((one[k], other[k]) for k in range(len(one)) if k not in one.errors)
    return all(
        np.array_equal(a.position, b.position) and np.array_equal(a.quaternion, b.quaternion)
        for a, b in pairs
    )


def rarer(scene: Scene, runs: int) -> Scene:
    """The scene with equal periods between outputs, at least its own, that keep a batch's poses small.

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
        CrosscheckError: for a scene that cannot be benchmarked, or an error that an engine cannot reach.
        NewtonEulerError: for a mechanism that hardly ever closes from nearby.
    """
    where = machine()
    given = poses_only(load(source, **options))
    scene = rarer(given, runs)
    settings = _cheapest_settings(scene, given.output_period, error, progress)
    progress(f"{runs} random states")
    states = random_states(scene, runs)
    (own_found, own_options), (found, rollout_options) = settings[JUDGED], settings["mujoco"]
    own = _Own(scene, own_options, states)
    other = _MuJoCo(scene, rollout_options, states, found.median)
    times: dict[tuple[Any, int], list[float]] = {}
    for turn in range(REPEATS):
        for engine in (own, other):
            for threads in thread_counts():
                progress(f"batch {turn + 1} of {REPEATS}: {threads} thread(s)")
                with steady():
                    times.setdefault((engine, threads), []).append(engine.run(threads))
    sample = np.linspace(0, other.runs - 1, min(SAMPLE, other.runs)).astype(int).tolist()
    progress(f"reference of {len(sample)} runs")
    exact, uncertainty = _references(scene, [states[k] for k in sample])
    known = [sample[k] for k in exact]
    sides = []
    for name, engine, single in ((JUDGED, own, own_found), ("mujoco", other, found)):
        errors = [max(pose_errors(*pair)) for pair in zip(engine.poses(known), exact.values(), strict=True)]
        rates = tuple(Throughput(n, engine.runs, tuple(times[engine, n])) for n in thread_counts())
        sides.append(Side(name, single.name, single.error, max(errors), engine.setup, engine.failed, rates))
    return BatchBenchmark(
        source,
        options,
        where,
        scene.duration,
        len(scene.times),
        error,
        uncertainty,
        len(known),
        len(sample) - len(known),
        tuple(sides),
    )


def _cheapest_settings(
    scene: Scene, period: float, error: float, progress: Progress
) -> dict[str, tuple[Measurement, Mapping[str, Any]]]:
    """The cheapest measured setting of each engine that reaches an error, and its options."""
    interval = float(scene.times[1] - scene.times[0])
    steps = sorted({max(1, round(interval / period * share)) for share in SHARES})
    models = {
        JUDGED: benchmark_newton_euler.models(scene),
        "mujoco": benchmark_mujoco.models(scene, steps),
    }
    against = benchmark_reference.reference(scene, progress)
    options: dict[tuple[str, str, str], Mapping[str, Any]] = {}

    def noted(engine: str, make: Callable[[], Model]) -> Callable[[], Model]:
        def made() -> Model:
            model = make()
            for ladder in model.ladders:
                for setting in ladder.settings:
                    options[engine, ladder.method, setting.name] = setting.options
            return model

        return made

    engines = {
        engine: {n: noted(engine, make) for n, make in ways.items()} for engine, ways in models.items()
    }
    measured = measure(engines, against.poses, REPEATS, progress)
    found = {}
    for engine in engines:
        best = cheapest(measured.measurements, engine, error, against.uncertainty)
        if best is None:
            raise CrosscheckError(f"{engine} does not reach an error of {error:g} on scene {scene.name!r}")
        found[engine] = best, options[engine, best.method, best.setting]
    return found


def _references(scene: Scene, states: Sequence[State]) -> tuple[dict[int, tuple[Array, Array]], float]:
    """Poses by Pinocchio at tight tolerances, by number of the state; largest difference to newton_euler's.

    A state has none from which one of them cannot go that tightly: its run passes a singular configuration.

    Raises:
        CrosscheckError: if none has any.
    """
    import urdf

    tight: dict[str, Any] = {"rtol": RTOL, "atol": 0.01 * RTOL}
    found: dict[int, tuple[Array, Array]] = {}
    uncertainty = 0.0
    for k, state in enumerate(states):
        started = replace(scene, initial_state=state)
        try:
            with time_limit(benchmark_reference.LIMIT):
                own, exact = simulate(started, **tight), urdf.simulate(started, **tight)
        except (NewtonEulerError, CrosscheckError) as error:
            reason = str(error)
            continue
        found[k] = exact.position, exact.quaternion
        uncertainty = max(uncertainty, *pose_errors((own.position, own.quaternion), found[k]))
    if not found:
        raise CrosscheckError(f"none of {len(states)} random runs has a reference; the last: {reason}")
    return found, uncertainty


# Report


def batch_table(result: BatchBenchmark) -> Table:
    """A line for each engine and number of threads; ratios are newton_euler's rate over the other's."""
    table = Table(box=SIMPLE_HEAD, pad_edge=False)
    table.add_column("engine")
    table.add_column("setting", overflow="fold")
    for head in (
        "error, one run",
        "error, sample",
        "threads",
        "runs",
        "runs per s",
        "scaling",
        "ratio",
        "setup, s",
    ):
        table.add_column(head, justify="right")
    own = {t.threads: t.rate for side in result.sides if side.engine == JUDGED for t in side.throughputs}
    for side in result.sides:
        for t in side.throughputs:
            table.add_row(
                side.engine,
                side.setting,
                f"{side.single_error:.1e}",
                f"{side.error:.1e}",
                str(t.threads),
                str(t.runs),
                f"{t.rate:.4g}",
                f"{t.rate / side.throughputs[0].rate:.2f}",
                "-" if side.engine == JUDGED else f"{own[t.threads] / t.rate:.3g}",
                f"{side.setup:.2f}",
            )
    return table


def batch_words(result: BatchBenchmark) -> list[str]:
    """What was run, and what each engine delivers."""
    where = result.machine
    period = result.duration / (result.outputs - 1)
    lines = [
        f"machine: {where['processor']}, {where['cores']} cores, load {where['load']}",
        f"runs of {result.duration:g} s from random consistent states, {result.outputs} outputs "
        f"{period:.3g} s apart",
        f"settings: the cheapest within {result.error:g} m and rad on the scene's own run",
        f"errors of {result.sample} of the runs; their reference is known to {result.uncertainty:.1e}; "
        f"{result.unknown} more have none at rtol {RTOL:g}",
        "newton_euler's results on all numbers of threads are equal to the last bit",
        "setup, not counted: states into each engine's own, loading",
    ]
    lines += [f"{side.engine} delivers {DELIVERED[side.engine]}" for side in result.sides]
    lines += [f"{s.engine}: {s.failed} runs could not go on" for s in result.sides if s.failed]
    lines += [
        f"{s.engine} is {s.error / result.error:.2g} times further off than wanted on the worst of the sample"
        for s in result.sides
        if s.error > result.error
    ]
    return lines


def batch_json(result: BatchBenchmark) -> str:
    """Everything measured, as JSON text."""
    content = asdict(result) | {"words": batch_words(result), "delivered": DELIVERED}
    for side, found in zip(content["sides"], result.sides, strict=True):
        for entry, throughput in zip(side["throughputs"], found.throughputs, strict=True):
            entry["rate"] = throughput.rate
    return json.dumps(content, indent=1, allow_nan=False) + "\n"
