"""One right-hand side of each engine: time, operations, peak memory.

Each engine is called in its cheapest way: newton_euler from a native loop, MuJoCo by `mj_forward` from
Python and by `mj_step` with its loop in C (which also integrates), Pinocchio from Python, the only way
there is, so a call of its binding is in its time. Ways take turns. Peak memory and loading are those of a
fresh process that loads the scene, makes the right-hand side without a compilation cache and calls it once;
Pinocchio's hold a second and a third model, in other units, that choose the regularization.
"""

from __future__ import annotations

import os
import resource
import sys
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from functools import partial
from itertools import repeat
from pathlib import Path
from typing import Any, NamedTuple

from crosscheck.report.table import Cell, Lines, Report, Rows, Table, figures, texts
from crosscheck.scenes import load
from crosscheck.studies.benchmark.ladders import JUDGED, poses_only
from crosscheck.studies.benchmark.timing import Progress, Timed, in_turns, machine
from crosscheck.workers import LostError, in_processes
from newton_euler.assemble import initial_state
from newton_euler.codegen.cache import CACHE_VARIABLE
from newton_euler.model.scene import Scene

BATCH = 1e-3
"""s that the calls which are timed together take, about."""

ROUNDS = 201
"""Batches of each right-hand side, fewer where they would take longer than `TOTAL`, 3 at least."""

TOTAL = 2.0
"""s for all batches of one right-hand side."""

PROBE_LIMIT = 120.0
"""s of processor time that loading in a fresh process may take."""

MEMORY_SHARE = 0.4
"""Of the machine's memory that the address space of that process may be."""


class RightHandSide(NamedTuple):
    """Ready to be called.

    Attributes:
        repeat: s that a number of calls takes.
        operations: floating-point operations of one, where they are known.
    """

    repeat: Callable[[int], float]
    operations: int | None


@dataclass(frozen=True)
class Timing(Timed):
    """One way to call an engine's right-hand side.

    Attributes:
        engine, way: names.
        operations: floating-point operations, where they are known.
        times: s a call, of each batch; none if it cannot run the scene.
        load: s to import, build and compile it in a fresh process, without a cache.
        memory: bytes, peak of that process.
        own_memory: bytes, by how much that is more than before it loaded the engine.
        reason: why it cannot run the scene.
    """

    engine: str
    way: str
    operations: int | None = None
    times: tuple[float, ...] = ()
    load: float = 0.0
    memory: int = 0
    own_memory: int = 0
    reason: str = ""


def _newton_euler(scene: Scene, formulation: str) -> RightHandSide:
    from newton_euler import compile_scene

    compiled = compile_scene(scene, formulation=formulation, stabilization="none")
    state = compiled.system.coordinates(initial_state(scene))
    return RightHandSide(lambda count: compiled.repeat(count, *state), compiled.operations["derivative"])


def _mj_forward(scene: Scene) -> RightHandSide:
    from mjcf.tight import forward

    return RightHandSide(partial(_loop, forward(scene)), None)


def _mj_step(scene: Scene) -> RightHandSide:
    from mjcf.tight import steps

    make = steps(scene)

    def timed(count: int) -> float:
        start = time.perf_counter()
        make(count)
        return time.perf_counter() - start

    return RightHandSide(timed, None)


def _pinocchio(scene: Scene, lcaba: tuple[float, int] | None) -> RightHandSide:
    from urdf.tight import equations_of

    return RightHandSide(partial(_loop, equations_of(scene, 0.0, lcaba).acceleration), None)


def _loop(call: Callable[[], object], count: int) -> float:
    start = time.perf_counter()
    for _ in repeat(None, count):
        call()
    return time.perf_counter() - start


Way = tuple[str, str]
"""An engine and how its right-hand side is called."""

WAYS: dict[Way, Callable[[Scene], RightHandSide]] = {
    ("newton_euler", "relative"): partial(_newton_euler, formulation="relative"),
    ("newton_euler", "cartesian"): partial(_newton_euler, formulation="cartesian"),
    ("mujoco", "mj_forward"): _mj_forward,
    ("mujoco", "mj_step, Euler, loop in C"): _mj_step,
    ("pinocchio", "constraintDynamics"): partial(_pinocchio, lcaba=None),
    ("pinocchio", "lcaba, mu 1e-06 x 1"): partial(_pinocchio, lcaba=(1e-6, 1)),
}


def time_right_hand_sides(
    source: str,
    options: Mapping[str, str],
    progress: Progress,
    ways: Iterable[Way] | None = None,
    limit: float = PROBE_LIMIT,
) -> list[Timing]:
    """Time one right-hand side of each engine at a scene's initial state, and measure its memory.

    Args:
        source: the name or the file of the scene.
        options: of the scene.
        progress: is told each stage.
        ways: out of `WAYS`; all of them if not given.
        limit: s that loading may take in a fresh process.

    Raises:
        CrosscheckError: for a scene that cannot be benchmarked.
    """
    scene = poses_only(load(source, **options))
    probes, ready = {}, {}
    for way in WAYS if ways is None else ways:
        progress(f"{way[0]}: {way[1]}")
        probes[way] = _probe(way, source, options, limit)
        if not probes[way].reason:
            ready[way] = WAYS[way](scene)
    times = dict(zip(ready, _times(list(ready.values()), progress), strict=True))
    return [replace(probe, times=times.get(way, ())) for way, probe in probes.items()]


def _times(sides: Sequence[RightHandSide], progress: Progress) -> list[tuple[float, ...]]:
    """Return the s per call of each right-hand side, in batches that take turns."""
    counts = [_batch(side.repeat) for side in sides]
    seconds = [side.repeat(count) for side, count in zip(sides, counts, strict=True)]
    rounds = [int(min(ROUNDS, max(3.0, TOTAL / s))) for s in seconds]
    calls = [partial(_call, side, count) for side, count in zip(sides, counts, strict=True)]
    return in_turns(calls, rounds, progress)


def _call(side: RightHandSide, count: int) -> float:
    return side.repeat(count) / count


def _batch(calls: Callable[[int], float]) -> int:
    """Estimate the number of calls that take about `BATCH`."""
    count = 1
    while (seconds := calls(count)) < 0.2 * BATCH:
        count *= 4
    return max(1, round(count * BATCH / seconds))


# Memory


def _probe(way: Way, source: str, options: Mapping[str, str], limit: float) -> Timing:
    """Load one right-hand side in a fresh process and call it once."""
    load_it = partial(probe, source=source, options=dict(options))
    (found,) = in_processes(load_it, [way], 1, lambda *_: None, lambda _: limit)
    return Timing(*way, reason=str(found)) if isinstance(found, LostError) else found


def probe(way: Way, source: str, options: Mapping[str, str]) -> Timing:
    """Measure loading in this process, without a cache, its memory limited; what goes wrong is the reason."""
    most = int(MEMORY_SHARE * os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))
    resource.setrlimit(resource.RLIMIT_AS, (most, most))
    os.environ[CACHE_VARIABLE] = ""
    try:
        scene = poses_only(load(source, **options))
        before = _peak_memory()
        start = time.perf_counter()
        side = WAYS[way](scene)
        side.repeat(1)
        seconds = time.perf_counter() - start
    except Exception as error:  # whatever an engine has against a scene belongs in the table
        return Timing(*way, reason=" ".join(str(error).split()) or type(error).__name__)
    peak = _peak_memory()
    return Timing(*way, side.operations, (), seconds, peak, peak - before)


def _peak_memory() -> int:
    """Bytes that this process has held at most.

    Linux hands ru_maxrss down from the process that started this one, so its own figure is preferred.
    """
    with suppress(OSError):
        for line in Path("/proc/self/status").read_text(encoding="utf-8").splitlines():
            if line.startswith("VmHWM:"):
                return int(line.split()[1]) * 1024
    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit


# Report


def fastest_other(timings: Iterable[Timing]) -> Timing | None:
    """The fastest right-hand side that is not newton_euler's."""
    others = [t for t in timings if t.engine != JUDGED and t.times]
    return min(others, key=lambda t: t.median, default=None)


def rhs_report(timings: Sequence[Timing]) -> Report:
    """Times, operations, memory and loading of each way to call an engine, and the ratios in words."""
    best = fastest_other(timings)
    rows: Rows = []
    for t in timings:
        if t.reason:
            rows.append([t.engine, t.way, *["-"] * 7])
            continue
        low, high = (1e6 * seconds for seconds in t.quartiles)
        rows.append(
            [
                t.engine,
                t.way,
                "-" if t.operations is None else str(t.operations),
                f"{t.median * 1e6:.4g}",
                f"{low:.4g} to {high:.4g}",
                "-" if best is None else f"{t.ratio(best):.3g}",
                f"{t.load:.2f}",
                f"{t.memory / 1e6:.0f}",
                f"{t.own_memory / 1e6:.0f}",
            ]
        )
    names = ("operations", "time, us", "quartiles, us", "ratio", "load, s", "peak, MB", "of which its own")
    table = Table("", [*texts("engine", "right-hand side"), *figures(*names)], rows)
    return Report("one right-hand side", "", Cell(""), [table, Lines("", _words(timings))])


def _words(timings: Sequence[Timing]) -> list[str]:
    """The ratios in words, and what cannot run the scene."""
    best = fastest_other(timings)
    lines = []
    for t in timings:
        if t.reason:
            lines.append(f"{t.engine} ({t.way}) cannot run the scene: {t.reason}")
        elif t.engine == JUDGED and best is not None:
            lines.append(
                f"{t.engine} ({t.way}) takes {t.ratio(best):.3g} times as long as {best.engine} ({best.way})"
            )
    return lines


def rhs_data(source: str, options: Mapping[str, str], timings: Sequence[Timing]) -> dict[str, Any]:
    """Everything measured, for JSON."""
    return {
        "source": source,
        "options": dict(options),
        "machine": machine(),
        "right_hand_sides": [asdict(t) for t in timings],
    }
