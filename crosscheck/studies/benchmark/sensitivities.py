"""Cost of the derivatives of a run by parameters, in runs at the same tolerance.

The parameters are masses of bodies. The run alone and with its derivatives take turns, in processor time, all
compiled before.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from timeit import Timer

from crosscheck.report.table import Lines, Part, Rows, Table, figures
from crosscheck.studies.benchmark.ladders import poses_only
from crosscheck.studies.benchmark.timing import Progress, Timed, in_turns, shown
from newton_euler import compile_scene
from newton_euler.analysis.tangent_code import tangent_code
from newton_euler.analysis.tangent_run import FollowedRun, tangent_options
from newton_euler.analysis.tangent_starts import Starts, own_numbers
from newton_euler.model.scene import Scene
from newton_euler.sampling import integrate_intervals
from newton_euler.scalars import Array

COUNTS = (1, 2, 4, 8)
"""Numbers of parameters, as far as there are bodies."""

REPEATS = 21


@dataclass(frozen=True)
class Cost(Timed):
    """Times of a run with derivatives.

    Attributes:
        parameters: by how many; 0 for the run alone.
        operations: of its right-hand side.
        times: s of processor time, of the repeats.
    """

    parameters: int
    operations: int
    times: tuple[float, ...]


def time_sensitivities(scene: Scene, progress: Progress) -> list[Cost]:
    """Time runs of a scene at the default tolerance alone, the first one, and with derivatives."""
    scene, options = poses_only(scene), tangent_options({})
    masses = [f"{body.name}.mass" for body in scene.mechanism.bodies[1:]]
    plain = compile_scene(scene)
    calls = [_timed(lambda: integrate_intervals(plain, plain.start.copy(), options))]
    sizes = [(0, plain.operations["derivative"])]
    for count in COUNTS:
        if count > len(masses):
            continue
        progress(f"compiling derivatives, parameters: {count}")
        code = tangent_code(scene, masses[:count], None)
        run = FollowedRun(code, options, ["output"])
        start = Starts(code, masses[:count])(own_numbers(scene, masses[:count]))
        calls.append(_timed(partial(_followed, run, *start)))
        sizes.append((count, code.function(code.rates[0]).operations))
    for call in calls:
        call()
    times = in_turns(calls, [REPEATS] * len(calls), progress)
    return [Cost(*size, each) for size, each in zip(sizes, times, strict=True)]


def _followed(run: FollowedRun, start: Array, directions: Array) -> None:
    run(start.copy(), directions.copy())


def _timed(call: Callable[[], object]) -> Callable[[], float]:
    """Return a call that says what another takes, s of processor time."""
    return partial(Timer(call, timer=time.process_time).timeit, 1)


def parts(costs: Sequence[Cost]) -> list[Part]:
    """Times of runs with derivatives, and what each parameter costs."""
    alone = costs[0]
    rows: Rows = []
    for cost in costs:
        each = f"{(cost.ratio(alone) - 1.0) / cost.parameters:.2f}" if cost.parameters else "-"
        rows.append([str(cost.parameters), f"{cost.operations:,}", shown(cost.median), cost.spread, each])
    heads = figures("parameters", "operations", "time", "spread", "runs per parameter")
    words = "processor time of a run and its derivatives by masses of bodies, at the default tolerance"
    return [Table("", heads, rows), Lines("", [words])]
