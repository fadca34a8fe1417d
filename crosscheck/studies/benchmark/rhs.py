"""Benchmark of one right-hand side: time, number of operations and loading time of each engine.

A right-hand side evaluates accelerations from coordinates and velocities, once. Each engine is called by its
fastest interface. newton_euler is called in a native loop. MuJoCo is called by `mj_forward` from Python, and
by `mj_step` with a loop in C, which also integrates. Pinocchio has an interface to Python only, so that its
time includes a call from Python. All interfaces are timed alternately.

The loading time is that of a fresh process: it imports MuJoCo, Pinocchio or the compiler LLVM, makes the
right-hand side without a compilation cache, and calls it once. The import of newton_euler itself is not
included, because scenes need it. Loading Pinocchio includes the choice of a regularization for redundant
constraints, by dimensionless copies of the model.
"""

from __future__ import annotations

import os
import resource
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial

from crosscheck.engines.benchmarks import RightHandSide, poses_only
from crosscheck.engines.engine import Engine
from crosscheck.engines.registry import SOLVER, choose
from crosscheck.report.chart import BarChart, Measure, log_chart
from crosscheck.report.table import Lines, Part, Rows, Table, number_columns, text_columns
from crosscheck.studies.benchmark.timing import Progress, Timed, time_alternately
from crosscheck.support.errors import reason_of
from crosscheck.support.processes import ProcessLostError, run_in_processes
from newton_euler.codegen.cache import CACHE_VARIABLE
from newton_euler.model.scene import Scene

BATCH_DURATION = 1e-3
"""Approximate duration, s, of a batch of calls; the calls of a batch are timed together."""

MAX_BATCHES = 201
"""Number of batches of each right-hand side; fewer (at least 3) if all would exceed `MAX_TOTAL_TIME`."""

MAX_TOTAL_TIME = 2.0
"""Longest duration, s, of all batches of one right-hand side."""

LOADING_TIME_LIMIT = 180.0
"""Largest CPU time, s, of loading in a fresh process."""

MEMORY_FRACTION = 0.4
"""Largest address space of the loading process, as a fraction of the machine's memory."""


@dataclass(frozen=True)
class Timing(Timed):
    """Times of one interface to an engine's right-hand side; `Timed` has their median and spread.

    Attributes:
        way: the interface: engine and function, a key of `right_hand_sides`.
        operations: number of floating-point operations in one call; None if it is unknown.
        times: mean duration of a call in each batch, s; empty if the engine cannot run the scene.
        load: loading time, s.
        reason: reason why the engine cannot run the scene; else empty.
    """

    way: str
    operations: int | None = None
    times: tuple[float, ...] = ()
    load: float = 0.0
    reason: str = ""

    @property
    def is_baseline(self) -> bool:
        """True for interfaces to newton_euler, with which the other engines are compared."""
        return self.way.split(" ")[0] == SOLVER.name


def right_hand_sides(engines: Sequence[Engine]) -> dict[str, Callable[[Scene], RightHandSide]]:
    """Return functions that make a right-hand side, by engine and interface, such as "mujoco mj_forward"."""
    return {
        f"{engine.name} {interface}": make
        for engine in engines
        for interface, make in engine.benchmarks().right_hand_sides.items()
    }


def time_right_hand_sides(
    scene: Scene, engines: Sequence[Engine], progress: Progress, ways: Iterable[str] | None = None
) -> list[Timing]:
    """Time one right-hand side of each engine at a scene's initial state, and its loading.

    Args:
        scene: the scene, without controllers that are Python functions.
        engines: the engines.
        progress: called with the name of each stage.
        ways: names of interfaces, keys of `right_hand_sides`; all of them if None.

    Raises:
        CrosscheckError: for a scene that cannot be benchmarked.
    """
    # Request no outputs but poses: others, such as the energy, would make the equations longer
    scene = poses_only(scene)
    # Measure the loading time of each interface in a separate process, and load the interface here
    timings, sides = {}, {}
    makers = right_hand_sides(engines)
    for way in makers if ways is None else ways:
        progress(f"loading {way}")
        (found,) = run_in_processes(
            partial(measure_loading, scene),
            tasks=[way],
            processes=1,
            done=lambda *_: None,
            limit=lambda _: LOADING_TIME_LIMIT,
        )
        timings[way] = Timing(way, reason=str(found)) if isinstance(found, ProcessLostError) else found
        if not timings[way].reason:
            sides[way] = makers[way](scene)
    # Time one call of each interface
    times = dict(zip(sides, _times(list(sides.values()), progress), strict=True))
    return [replace(timing, times=times.get(way, ())) for way, timing in timings.items()]


def _times(sides: Sequence[RightHandSide], progress: Progress) -> list[tuple[float, ...]]:
    """Return the durations of a call, s, of each right-hand side in all its batches, which alternate."""
    counts = [_calls_per_batch(side.repeat) for side in sides]
    batch_seconds = [side.repeat(count) for side, count in zip(sides, counts, strict=True)]
    batches = [int(min(MAX_BATCHES, max(3.0, MAX_TOTAL_TIME / seconds))) for seconds in batch_seconds]
    calls = [partial(_time_per_call, side, count) for side, count in zip(sides, counts, strict=True)]
    return time_alternately(calls, batches, progress)


def _time_per_call(side: RightHandSide, count: int) -> float:
    """Make a number of calls; return the mean duration of a call, s."""
    return side.repeat(count) / count


def _calls_per_batch(repeat: Callable[[int], float]) -> int:
    """Estimate the number of calls that take about `BATCH_DURATION`, from the shortest of three times.

    The first time may include compilation, and another program may interrupt a call. A time that is too long
    would lead to batches of few calls, with the processor's caches full of another engine's data.
    """
    count = 1
    while (seconds := min(repeat(count) for _ in range(3))) < 0.2 * BATCH_DURATION:
        count *= 4
    return max(1, round(count * BATCH_DURATION / seconds))


def measure_loading(scene: Scene, way: str) -> Timing:
    """Measure the loading time of one interface in this process, without a compilation cache.

    The import of the engine's package is part of it. The memory of the process is limited. An error becomes
    the `reason` of the result.
    """
    max_bytes = int(MEMORY_FRACTION * os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))
    resource.setrlimit(resource.RLIMIT_AS, (max_bytes, max_bytes))
    os.environ[CACHE_VARIABLE] = ""
    try:
        engines = choose([way.split(" ")[0]])
        start = time.perf_counter()
        side = right_hand_sides(engines)[way](scene)
        side.repeat(1)
        seconds = time.perf_counter() - start
    except Exception as error:  # the table reports any error of an engine
        return Timing(way, reason=reason_of(error))
    return Timing(way, side.operations, load=seconds)


# Report


def fastest_other(timings: Iterable[Timing]) -> Timing | None:
    """Return the fastest right-hand side that is not newton_euler's; None if no other engine can run."""
    others = [t for t in timings if not t.is_baseline and t.times]
    return min(others, key=lambda t: t.median, default=None)


def parts(timings: Sequence[Timing]) -> list[Part]:
    """Make the report: time, operations and loading time of each right-hand side.

    The column `ratio` is the time divided by that of the fastest right-hand side of another engine.
    """
    fastest = fastest_other(timings)
    rows: Rows = []
    for t in timings:
        cells = ["-"] * 5
        if not t.reason:
            cells = [
                "-" if t.operations is None else str(t.operations),
                f"{t.median * 1e6:.3g}",
                t.spread,
                "-" if fastest is None else f"{t.ratio(fastest):.3g}",
                f"{t.load:.2f}",
            ]
        rows.append([t.way, *cells])
    heads = number_columns("operations", "time, us", "spread", "ratio", "load, s")
    notes = [] if fastest is None else [f"ratio: to {fastest.way}, the fastest of the others"]
    notes.append("load: in a fresh process, without a cache")
    notes += [f"{t.way} cannot run the scene: {t.reason}" for t in timings if t.reason]
    return [Table("", [*text_columns("right-hand side"), *heads], rows), Lines("", notes)]


def verdict(timings: Sequence[Timing]) -> str:
    """Report the fastest right-hand side in one line."""
    fastest = min((t for t in timings if not t.reason), key=lambda t: t.median, default=None)
    if fastest is None:
        return "no engine can run the scene"
    return f"the fastest evaluation takes {1e6 * fastest.median:.3g} us, by {fastest.way}"


def charts(timings: Sequence[Timing]) -> list[BarChart]:
    """Make the chart of the time of each right-hand side."""
    times = [Measure(t.way, 1e6 * t.median, f"{1e6 * t.median:.3g} us") for t in timings if not t.reason]
    return log_chart("Time of one evaluation", "Median time of one call", times, "us")
