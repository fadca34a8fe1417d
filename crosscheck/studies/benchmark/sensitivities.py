"""Cost of parameter sensitivities, as a multiple of one run at the same tolerance.

The parameters are masses of bodies, or one coordinate of a joint point. A parameter of geometry adds the
search for singular configurations to the run. Runs with and without sensitivities alternate; their times are
CPU times. Compilation and the derivatives of initial states are not timed.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from timeit import Timer

from crosscheck.report.table import Lines, Part, Rows, Table, number_columns, text_columns
from crosscheck.studies.benchmark.ladders import poses_only
from crosscheck.studies.benchmark.timing import Progress, Timed, in_turns, shown
from newton_euler import compile_scene
from newton_euler.analysis.sensitivity.tangent_code import tangent_code
from newton_euler.analysis.sensitivity.tangent_run import FollowedRun, tangent_options
from newton_euler.analysis.sensitivity.tangent_starts import Starts, own_numbers
from newton_euler.equations.parameters import parameter_names
from newton_euler.errors import SensitivityError
from newton_euler.model.scene import Scene
from newton_euler.runs.intervals import integrate_intervals
from newton_euler.scalars import Array

PARAMETER_COUNTS = (1, 2, 4, 8)
"""Numbers of parameters that are timed, up to the number of bodies."""

REPEATS = 21


@dataclass(frozen=True)
class SensitivityCost(Timed):
    """Times of a run with sensitivities.

    Attributes:
        parameters: number of parameters; 0 for the run without sensitivities.
        kind: "masses" or "joint points"; empty for the run without sensitivities.
        operations: number of operations of the right-hand side.
        times: s, CPU time of each repeat.
    """

    parameters: int
    kind: str
    operations: int
    times: tuple[float, ...]


def time_sensitivities(scene: Scene, progress: Progress) -> list[SensitivityCost]:
    """Time runs of a scene at the default tolerance.

    Returns:
        The cost of the run without sensitivities first, then with sensitivities.
    """
    scene, options = poses_only(scene), tangent_options({})
    masses = tuple(f"{body.name}.mass" for body in scene.mechanism.bodies[1:])
    plain = compile_scene(scene)
    points = [name for name in parameter_names(scene) if name.endswith(".point")]
    wanted = [("masses", masses[:count]) for count in PARAMETER_COUNTS if count <= len(masses)]
    wanted += [("joint points", (f"{name}.x",)) for name in points[-1:]]
    calls = [_timed(lambda: integrate_intervals(plain, plain.start.copy(), options))]
    made = [(0, "", plain.operations["derivative"])]
    for kind, names in wanted:
        progress(f"compiling derivatives, parameters: {len(names)}")
        code = tangent_code(scene, names, None)
        run = FollowedRun(code, options, ["output"])
        try:
            start = Starts(code, names)(own_numbers(scene, names))
            _followed(run, *start)
        except (
            SensitivityError
        ):  # the run comes near a singular configuration, where derivatives do not exist
            continue
        calls.append(_timed(partial(_followed, run, *start)))
        made.append((len(names), kind, code.function(code.rates[0]).operation_count))
    calls[0]()
    times = in_turns(calls, [REPEATS] * len(calls), progress)
    return [SensitivityCost(*each, taken) for each, taken in zip(made, times, strict=True)]


def _followed(run: FollowedRun, start: Array, directions: Array) -> None:
    run(start.copy(), directions.copy())


def _timed(call: Callable[[], object]) -> Callable[[], float]:
    """Return a function that makes a call and returns its CPU time, s."""
    return partial(Timer(call, timer=time.process_time).timeit, 1)


def parts(costs: Sequence[SensitivityCost]) -> list[Part]:
    """Make the report: times of runs with sensitivities, and the cost of each parameter in runs."""
    alone = costs[0]
    rows: Rows = []
    for cost in costs:
        each = f"{(cost.ratio(alone) - 1.0) / cost.parameters:.2f}" if cost.parameters else "-"
        by = f"{cost.kind}: {cost.parameters}" if cost.parameters else "run alone"
        rows.append([by, f"{cost.operations:,}", shown(cost.median), cost.spread, each])
    heads = [*text_columns("by"), *number_columns("operations", "time", "spread", "runs per parameter")]
    words = "CPU time of a run with sensitivities at the default tolerance, without initial states"
    return [Table("", heads, rows), Lines("", [words])]
