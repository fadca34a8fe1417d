"""One right-hand side of each engine: time, operations, loading.

Each engine is called in its cheapest way: newton_euler from a native loop, MuJoCo by `mj_forward` from
Python and by `mj_step` with its loop in C (which also integrates), Pinocchio from Python, the only way
there is, so a call of its binding is in its time. Ways take turns. Loading is that of a fresh process that
makes the right-hand side without a compilation cache and calls it once; Pinocchio's makes two more models, in
other units, that choose the regularization.
"""

from __future__ import annotations

import os
import resource
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from timeit import Timer
from typing import NamedTuple

from crosscheck.report.table import Lines, Part, Rows, Table, number_columns, text_columns
from crosscheck.studies.benchmark.ladders import JUDGED, poses_only
from crosscheck.studies.benchmark.timing import Progress, Timed, in_turns
from crosscheck.support.errors import reason_of
from crosscheck.support.processes import ProcessLostError, run_in_processes
from newton_euler import compile_scene
from newton_euler.codegen.cache import CACHE_VARIABLE
from newton_euler.compiled.outputs import time_function
from newton_euler.integrators.options import FormulationName
from newton_euler.model.scene import Scene

BATCH = 1e-3
"""s that the calls which are timed together take, about."""

ROUNDS = 201
"""Batches of each right-hand side, fewer where they would take longer than `TOTAL`, 3 at least."""

TOTAL = 2.0
"""s for all batches of one right-hand side."""

LIMIT = 180.0
"""s of processor time that loading in a fresh process may take."""

MEMORY_SHARE = 0.4
"""Largest address space of the loading process, as a fraction of the machine's memory."""


class RightHandSide(NamedTuple):
    """Ready to be called.

    Attributes:
        repeat: s that a number of calls takes.
        operations: floating-point operations of one, where they are known.
    """

    repeat: Callable[[int], float]
    operations: int | None = None


@dataclass(frozen=True)
class Timing(Timed):
    """One way to call an engine's right-hand side.

    Attributes:
        way: the engine and how it is called.
        operations: floating-point operations, where they are known.
        times: s per call, of each batch; none if it cannot run the scene.
        load: s to import, build and compile it in a fresh process, without a cache.
        reason: why it cannot run the scene.
    """

    way: str
    operations: int | None = None
    times: tuple[float, ...] = ()
    load: float = 0.0
    reason: str = ""

    @property
    def judged(self) -> bool:
        """True of newton_euler's."""
        return self.way.startswith(JUDGED)


def _newton_euler(scene: Scene, formulation: FormulationName) -> RightHandSide:
    compiled = compile_scene(scene, formulation=formulation, stabilization="none")
    call = partial(time_function, compiled.function("derivative"), compiled.start)
    return RightHandSide(call, compiled.operations["derivative"])


def _mj_forward(scene: Scene) -> RightHandSide:
    from mjcf.benchmark_kernels import forward

    return RightHandSide(Timer(forward(scene)).timeit)


def _mj_step(scene: Scene) -> RightHandSide:
    from mjcf.benchmark_kernels import steps

    call = steps(scene)
    return RightHandSide(lambda count: Timer(partial(call, count)).timeit(1))


def _pinocchio(scene: Scene, lcaba: tuple[float, int] | None) -> RightHandSide:
    from urdf.benchmark_kernels import equations_of

    return RightHandSide(Timer(equations_of(scene, 0.0, lcaba).acceleration).timeit)


def _aba(scene: Scene) -> RightHandSide:
    from urdf.benchmark_kernels import articulated_bodies

    return RightHandSide(Timer(articulated_bodies(scene)).timeit)


WAYS: dict[str, Callable[[Scene], RightHandSide]] = {
    "newton_euler relative": partial(_newton_euler, formulation="relative"),
    "newton_euler cartesian": partial(_newton_euler, formulation="cartesian"),
    "mujoco mj_forward": _mj_forward,
    "mujoco mj_step Euler in C": _mj_step,
    "pinocchio aba": _aba,
    "pinocchio constraintDynamics": partial(_pinocchio, lcaba=None),
    "pinocchio lcaba, mu 1e-6": partial(_pinocchio, lcaba=(1e-6, 1)),
}
"""Right-hand sides by engine and how it is called."""


def time_right_hand_sides(
    scene: Scene, progress: Progress, ways: Iterable[str] | None = None
) -> list[Timing]:
    """Time one right-hand side of each engine at a scene's initial state, and its loading.

    Args:
        scene: loaded, with native control laws.
        progress: is told each stage.
        ways: out of `WAYS`; all of them if not given.

    Raises:
        CrosscheckError: for a scene that cannot be benchmarked.
    """
    scene = poses_only(scene)
    probes, ready = {}, {}
    for way in WAYS if ways is None else ways:
        progress(f"loading {way}")
        (found,) = run_in_processes(partial(probe, scene), [way], 1, lambda *_: None, lambda _: LIMIT)
        probes[way] = Timing(way, reason=str(found)) if isinstance(found, ProcessLostError) else found
        if not probes[way].reason:
            ready[way] = WAYS[way](scene)
    times = dict(zip(ready, _times(list(ready.values()), progress), strict=True))
    return [replace(probe, times=times.get(way, ())) for way, probe in probes.items()]


def _times(sides: Sequence[RightHandSide], progress: Progress) -> list[tuple[float, ...]]:
    """Return the s per call of each right-hand side, in batches that take turns."""
    counts = [_batch(side.repeat) for side in sides]
    seconds = [side.repeat(count) for side, count in zip(sides, counts, strict=True)]
    rounds = [int(min(ROUNDS, max(3.0, TOTAL / s))) for s in seconds]
    calls = [partial(_per_call, side, count) for side, count in zip(sides, counts, strict=True)]
    return in_turns(calls, rounds, progress)


def _per_call(side: RightHandSide, count: int) -> float:
    return side.repeat(count) / count


def _batch(calls: Callable[[int], float]) -> int:
    """Estimate the number of calls that take about `BATCH`, from the shortest of three times.

    The first call compiles, and an interrupted one would leave batches of a few calls with cold caches.
    """
    count = 1
    while (seconds := min(calls(count) for _ in range(3))) < 0.2 * BATCH:
        count *= 4
    return max(1, round(count * BATCH / seconds))


def probe(scene: Scene, way: str) -> Timing:
    """Measure loading in this process, without a cache, its memory limited; what goes wrong is the reason."""
    most = int(MEMORY_SHARE * os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))
    resource.setrlimit(resource.RLIMIT_AS, (most, most))
    os.environ[CACHE_VARIABLE] = ""
    try:
        start = time.perf_counter()
        side = WAYS[way](scene)
        side.repeat(1)
        seconds = time.perf_counter() - start
    except Exception as error:  # whatever an engine has against a scene belongs in the table
        return Timing(way, reason=reason_of(error))
    return Timing(way, side.operations, load=seconds)


# Report


def fastest_other(timings: Iterable[Timing]) -> Timing | None:
    """The fastest right-hand side that is not newton_euler's."""
    others = [t for t in timings if not t.judged and t.times]
    return min(others, key=lambda t: t.median, default=None)


def parts(timings: Sequence[Timing]) -> list[Part]:
    """Times, operations and loading of each way to call an engine."""
    best = fastest_other(timings)
    rows: Rows = []
    for t in timings:
        cells = ["-"] * 5
        if not t.reason:
            cells = [
                "-" if t.operations is None else str(t.operations),
                f"{t.median * 1e6:.3g}",
                t.spread,
                "-" if best is None else f"{t.ratio(best):.3g}",
                f"{t.load:.2f}",
            ]
        rows.append([t.way, *cells])
    heads = number_columns("operations", "time, us", "spread", "ratio", "load, s")
    words = [] if best is None else [f"ratio: to {best.way}, the fastest of the others"]
    words.append("load: in a fresh process, without a cache")
    words += [f"{t.way} cannot run the scene: {t.reason}" for t in timings if t.reason]
    return [Table("", [*text_columns("right-hand side"), *heads], rows), Lines("", words)]
