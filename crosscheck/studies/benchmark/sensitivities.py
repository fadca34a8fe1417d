"""Benchmark of parameter sensitivities: their cost as a multiple of one run without sensitivities.

Sensitivities are derivatives of the motion with respect to parameters, which newton_euler integrates with the
motion. The parameters are masses of bodies, or one coordinate of a joint point. With a parameter of geometry,
a run also searches for singular configurations (with further degrees of freedom), where derivatives do not
exist. Runs with and without sensitivities alternate, at the same tolerance; their times are CPU times.
Compilation and the derivatives of initial states are not timed.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from timeit import Timer

from crosscheck.engines.benchmarks import poses_only
from crosscheck.report.chart import BarChart, Measure, linear_chart
from crosscheck.report.table import Lines, Part, Rows, Table, number_columns, text_columns
from crosscheck.studies.benchmark.timing import Progress, Timed, time_alternately, time_text
from newton_euler import compile_scene
from newton_euler.analysis.sensitivity.tangent_code import tangent_code
from newton_euler.analysis.sensitivity.tangent_run import TangentRun, tangent_options
from newton_euler.analysis.sensitivity.tangent_starts import Starts, own_numbers
from newton_euler.equations.parameter_names import parameter_names
from newton_euler.errors import SensitivityError
from newton_euler.model.scene import Scene
from newton_euler.runs.intervals import integrate_intervals
from newton_euler.scalars import Array

PARAMETER_COUNTS = (1, 2, 4, 8)
"""Numbers of parameters that are timed, up to the number of bodies."""

REPEATS = 21
"""Number of times that each run is timed."""


@dataclass(frozen=True)
class SensitivityCost(Timed):
    """Times of a run with sensitivities; `Timed` has the median and spread of its `times`.

    Attributes:
        parameters: number of parameters; 0 for the run without sensitivities.
        kind: "masses" or "joint points"; empty for the run without sensitivities.
        operations: number of floating-point operations in one evaluation of the time derivatives of the
            motion and of its sensitivities.
        times: CPU time of each repeat, s.
    """

    parameters: int
    kind: str
    operations: int
    times: tuple[float, ...]


def time_sensitivities(scene: Scene, progress: Progress) -> list[SensitivityCost]:
    """Time runs of a scene with and without sensitivities, at the default tolerance.

    Returns:
        The cost of the run without sensitivities, then of each run with sensitivities. Runs that come near a
        singular configuration are omitted.
    """
    # Parameters of each run; the poses of bodies are the only outputs
    scene, options = poses_only(scene), tangent_options({})
    masses = tuple(f"{body.name}.mass" for body in scene.mechanism.bodies[1:])
    points = [name for name in parameter_names(scene) if name.endswith(".point")]
    wanted = [("masses", masses[:count]) for count in PARAMETER_COUNTS if count <= len(masses)]
    wanted += [("joint points", (f"{name}.x",)) for name in points[-1:]]
    # The run without sensitivities
    plain = compile_scene(scene)
    calls = [_cpu_timer(lambda: integrate_intervals(plain, plain.start.copy(), options))]
    described = [(0, "", plain.operations["derivative"])]  # first three attributes of `SensitivityCost`
    # Runs with sensitivities: compile, and run once
    for kind, names in wanted:
        progress(f"compiling derivatives, parameters: {len(names)}")
        code = tangent_code(scene, names, formulation=None)  # in the scene's default coordinates
        run = TangentRun(code, options, programs=["output"])  # derivatives of the outputs
        try:
            # initial state for the scene's own parameter values, and its derivatives
            start = Starts(code, names)(own_numbers(scene, names))
            _run_with_sensitivities(run, *start)
        except SensitivityError:  # the run comes near a singular configuration
            continue
        calls.append(_cpu_timer(partial(_run_with_sensitivities, run, *start)))
        # operations of the program that runs try first
        described.append((len(names), kind, code.function(code.rates[0]).operation_count))
    # Time all runs alternately
    calls[0]()
    times = time_alternately(calls, [REPEATS] * len(calls), progress)
    return [SensitivityCost(*each, taken) for each, taken in zip(described, times, strict=True)]


def _run_with_sensitivities(run: TangentRun, start: Array, directions: Array) -> None:
    """Integrate the motion and its derivatives, from copies of the start, which the run overwrites.

    Args:
        run: compiled run of the motion and its derivatives.
        start: initial coordinates and velocities.
        directions: derivatives of the start with respect to the parameters.
    """
    run(start.copy(), directions.copy())


def _cpu_timer(call: Callable[[], object]) -> Callable[[], float]:
    """Return a function that runs `call` once and returns the CPU time, s."""
    return partial(Timer(call, timer=time.process_time).timeit, 1)


def parts(costs: Sequence[SensitivityCost]) -> list[Part]:
    """Make the report: times of the runs, and the cost of each parameter as a multiple of one plain run."""
    plain = costs[0]
    rows: Rows = []
    for cost in costs:
        each = f"{(cost.ratio(plain) - 1.0) / cost.parameters:.2f}" if cost.parameters else "-"
        by = f"{cost.kind}: {cost.parameters}" if cost.parameters else "run alone"
        rows.append([by, f"{cost.operations:,}", time_text(cost.median), cost.spread, each])
    heads = [*text_columns("by"), *number_columns("operations", "time", "spread", "runs per parameter")]
    note = "CPU time of a run with sensitivities at the default tolerance, without initial states"
    return [Table("", heads, rows), Lines("", [note])]


def verdict(costs: Sequence[SensitivityCost]) -> str:
    """Report the cost of a run with the most parameters in one line."""
    plain, *others = costs
    if not others:
        return "no run with derivatives: all come near a singular configuration"
    most = max(others, key=lambda cost: cost.parameters)
    return (
        f"a run with derivatives by {most.parameters} {most.kind} takes {most.ratio(plain):.3g} times as long"
    )


def charts(costs: Sequence[SensitivityCost]) -> list[BarChart]:
    """Make the chart of the times of the runs."""
    times = [
        Measure(f"{cost.kind}: {cost.parameters}" if cost.parameters else "run alone", cost.median, text)
        for cost in costs
        for text in [time_text(cost.median)]
    ]
    return linear_chart("Time of a run", "CPU time by number of parameters with derivatives", times)
