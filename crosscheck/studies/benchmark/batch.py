"""Many runs of one scene: runs per second of newton_euler and MuJoCo, on one thread and on all cores.

Runs start from random consistent states. Each engine has the setting that runs a sample of these very states
in the least time with none of them further off than the wanted error. newton_euler delivers the poses of all
bodies at all outputs. `mujoco.rollout` delivers MuJoCo's full physics state (time, qpos, qvel) after every
step, of which qpos at outputs is kept; poses are not worked out. States are made, and turned into each
engine's own, before.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from crosscheck.errors import CrosscheckError
from crosscheck.report.table import Cell, Lines, Report, Rows, Table, figures, texts
from crosscheck.scenes import load
from crosscheck.studies.benchmark.batch_engines import RTOL, Choice, MuJoCo, Own, bare, cheapest, references
from crosscheck.studies.benchmark.engines import JUDGED, poses_only
from crosscheck.studies.benchmark.work_precision import Progress, machine, steady
from newton_euler.exercise import random_states
from newton_euler.model.scene import Scene

REPEATS = 5
"""Of every batch, engines and numbers of threads taking turns; the quickest counts, as others' load only
ever adds."""

SAMPLE = 20
"""Runs that settings are chosen on."""

MOST = 150_000_000
"""Bytes that the poses of one batch may hold; outputs are as rare as that needs."""

LIMIT = 10.0
"""s that MuJoCo's runs on one thread may take; it makes fewer runs than newton_euler where they would take
longer."""


@dataclass(frozen=True)
class Throughput:
    """One engine on some threads; times, s, are of all `runs` together."""

    threads: int
    runs: int
    times: tuple[float, ...]

    @property
    def rate(self) -> float:
        """Runs per second of the quickest repeat."""
        return self.runs / min(self.times)

    @property
    def spread(self) -> float:
        """How much longer the slowest repeat took than the quickest, as a share of it."""
        return max(self.times) / min(self.times) - 1.0


@dataclass(frozen=True)
class Side:
    """One engine.

    Attributes:
        engine, setting: names.
        error: m or rad, the largest of the sample.
        delivers: what a run's time includes.
        setup: s, to turn the states of `throughputs[0].runs` runs into its own, and to load.
        failed: runs that could not go on.
        throughputs: by number of threads.
    """

    engine: str
    setting: str
    error: float
    delivers: str
    setup: float
    failed: int
    throughputs: tuple[Throughput, ...]


@dataclass(frozen=True)
class BatchBenchmark:
    """What was found; `uncertainty`, m or rad, is that of the sample's reference, and `unknown` of the sample
    have none. `bare` are bare right-hand sides, no runs."""

    source: str
    options: Mapping[str, str]
    machine: dict[str, Any]
    duration: float
    outputs: int
    error: float
    uncertainty: float
    sample: int
    unknown: int
    bare: tuple[Throughput, ...]
    sides: tuple[Side, ...]


def thread_counts() -> tuple[int, ...]:
    """One thread, and one a core."""
    return tuple(sorted({1, os.cpu_count() or 1}))


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
    progress(f"{runs} random states")
    states = random_states(scene, runs)
    sample = [states[k] for k in np.linspace(0, runs - 1, min(SAMPLE, runs)).astype(int)]
    progress(f"reference of {len(sample)} runs")
    exact, uncertainty = references(scene, sample)
    if uncertainty > error:
        raise CrosscheckError(f"--error {error:g}: the reference is known to {uncertainty:.1e} only")
    known, poses = [sample[k] for k in exact], list(exact.values())
    own, other = Own(scene), MuJoCo(scene, given.output_period)
    choices = {engine.name: cheapest(engine, known, poses, error, progress) for engine in (own, other)}
    most = LIMIT * len(known) / choices[other.name].seconds
    shares = {own.name: states, other.name: states[: max(len(known), int(most))]}
    times = _in_turns(scene, (own, other), choices, shares, progress)
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
        _throughputs(times, BARE, 1),
        tuple(
            Side(
                engine.name,
                choices[engine.name].name,
                choices[engine.name].error,
                engine.delivers,
                engine.setup,
                engine.failed,
                _throughputs(times, engine.name, len(shares[engine.name])),
            )
            for engine in (own, other)
        ),
    )


BARE = "right-hand sides"

Times = dict[tuple[str, int], list[float]]


def _in_turns(
    scene: Scene,
    engines: tuple[Own | MuJoCo, ...],
    choices: Mapping[str, Choice],
    states: Mapping[str, Any],
    progress: Progress,
) -> Times:
    """Times of the repeats, s, by engine and number of threads."""
    times: Times = {}
    calls = bare(scene)
    for turn in range(REPEATS):
        for threads in thread_counts():
            progress(f"batch {turn + 1} of {REPEATS}: {threads} thread(s)")
            with steady():
                times.setdefault((BARE, threads), []).append(calls(threads))
                for engine in engines:
                    name = engine.name
                    seconds = engine.run(choices[name].options, states[name], threads)
                    times.setdefault((name, threads), []).append(seconds)
    return times


def _throughputs(times: Times, name: str, runs: int) -> tuple[Throughput, ...]:
    return tuple(Throughput(n, runs, tuple(times[name, n])) for n in thread_counts())


# Report


def batch_report(result: BatchBenchmark) -> Report:
    """Rates by engine and number of threads; ratios are newton_euler's rate over the other's."""
    own = {t.threads: t.rate for side in result.sides if side.engine == JUDGED for t in side.throughputs}
    rows: Rows = [
        [
            side.engine,
            side.setting,
            f"{side.error:.1e}",
            str(t.threads),
            str(t.runs),
            f"{t.rate:.4g}",
            f"{t.spread:.0%}",
            f"{t.rate / side.throughputs[0].rate:.2f}",
            "-" if side.engine == JUDGED else f"{own[t.threads] / t.rate:.3g}",
            f"{side.setup:.2f}",
        ]
        for side in result.sides
        for t in side.throughputs
    ]
    names = ("error", "threads", "runs", "runs per s", "spread", "scaling", "ratio", "setup, s")
    table = Table("", [*texts("engine", "setting"), *figures(*names)], rows)
    return Report("many runs", "", Cell(""), [table, Lines("", _words(result))])


def _words(result: BatchBenchmark) -> list[str]:
    """What was run, and what each engine delivers."""
    where = result.machine
    period = result.duration / (result.outputs - 1)
    allowed = ", ".join(f"{t.rate / result.bare[0].rate:.2f} on {t.threads}" for t in result.bare[1:])
    lines = [
        f"machine: {where['processor']}, {where['cores']} cores, load {where['load']}",
        f"runs of {result.duration:g} s from random consistent states, {result.outputs} outputs "
        f"{period:.3g} s apart",
        f"settings: the cheapest with no run of a sample of {result.sample} off by more than "
        f"{result.error:g} m or rad; error: the largest of that sample",
        f"the sample's reference is known to {result.uncertainty:.1e}; {result.unknown} more of these runs "
        f"have none at rtol {RTOL:g}",
        f"rates are of the quickest of {REPEATS} repeats in turns, spread: how much longer the slowest took",
        "newton_euler's results on all numbers of threads are equal to the last bit",
        "setup, not counted: states into each engine's own, loading",
    ]
    if allowed:
        lines.insert(5, f"scaling of right-hand sides alone, what the machine allows: {allowed} threads")
    lines += [f"{side.engine} delivers {side.delivers}" for side in result.sides]
    lines += [f"{s.engine}: {s.failed} runs could not go on" for s in result.sides if s.failed]
    return lines


def batch_data(result: BatchBenchmark) -> dict[str, Any]:
    """Everything measured, for JSON."""
    content = asdict(result)
    for side, found in zip(content["sides"], result.sides, strict=True):
        for entry, throughput in zip(side["throughputs"], found.throughputs, strict=True):
            entry["rate"] = throughput.rate
    return content
