"""Simulate a scene by Exudyn's implicit time integration with a fixed step.

Output times, samples of digital controllers and jumps of set-points divide the run. Exudyn's solver starts
anew at each sample and jump, with accelerations and multipliers that belong to the new forces. Reactions come
from the multipliers of Exudyn's solver.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Sequence
from numbers import Real
from typing import Any, NamedTuple

import numpy as np

from crosscheck.engines.exudyn.run import INTEGRATORS, IntegratorName, Output, Part, Run
from newton_euler.arguments import checked
from newton_euler.equations.system import Observation
from newton_euler.errors import OptionError, UnknownNameError
from newton_euler.integrators.options import MAX_FIXED_STEPS
from newton_euler.model.scene import Scene
from newton_euler.model.trajectory import StoppedError, Trajectory
from newton_euler.runs.intervals import Interval, intervals
from newton_euler.runs.simulate import trajectory_from
from newton_euler.scalars import Array

MAX_STEP = 1e-3
"""Default step, s."""


class Done(NamedTuple):
    """A run of Exudyn's solver whose outputs are not evaluated yet.

    Attributes:
        outputs: states at the output times that were reached.
        settings: settings of the run.
        wall_time: duration of the run, s.
        stopped: the error that ended the run early; None if the run is complete.
    """

    outputs: Sequence[Output]
    settings: dict[str, Any]
    wall_time: float
    stopped: StoppedError | None


@checked
def simulate(
    scene: Scene, integrator: IntegratorName = "generalized_alpha", step: float | None = None
) -> Trajectory:
    """Simulate a scene with a solver of Exudyn.

    Args:
        scene: the scene.
        integrator: one of `INTEGRATORS`.
        step: largest step, s. Steps are shorter where output times, samples and jumps need it. None means
            `MAX_STEP`.

    Raises:
        CannotExpressError: for a scene that Exudyn cannot express.
        NewtonEulerError: for an unknown integrator, an impossible step, or a run that stops early, with the
            trajectory so far.
    """
    done = run(scene, integrator, step)
    evaluations, coupling_residuals = list[Observation](), list[Array]()
    for output in done.outputs:
        equations = output.equations
        equations.scene, equations.time = output.scene, output.time
        if scene.needs_accelerations:
            evaluations.append(
                equations.evaluation(output.q, output.v, output.acceleration, output.multipliers)
            )
        else:
            evaluations.append(equations.observe(output.q, output.v))
        coupling_residuals.append(equations.coupling_phi(output.q))
    return trajectory_from(
        scene, "exudyn", done.settings, done.wall_time, evaluations, coupling_residuals, done.stopped
    )


def run(scene: Scene, integrator: IntegratorName, step: float | None) -> Done:
    """Run a solver of Exudyn without evaluating the outputs; arguments and errors as of `simulate`.

    An error that stops the run early is not raised, but an attribute of the result.
    """
    if integrator not in INTEGRATORS:
        raise UnknownNameError("integrator", integrator, INTEGRATORS)
    largest = _checked_step(scene, step)
    plan = [(interval, list(_parts(interval, largest))) for interval in intervals(scene, scene.jumps)]
    parts = [part for _, of_interval in plan for part in of_interval]
    settings = {
        "integrator": integrator,
        "step": max(part.step for part in parts),
        "steps": sum(part.steps * (len(part.times) - 1) for part in parts),
    }
    solver_run = Run(scene, integrator)
    start = time.perf_counter()
    stopped = solver_run.run(plan)
    return Done(solver_run.outputs, settings, time.perf_counter() - start, stopped)


def _checked_step(scene: Scene, step: float | None) -> float:
    """Return the largest step, s; raises `OptionError` for a step that is no time, or too short."""
    if step is None:
        return MAX_STEP
    is_number = isinstance(step, Real) and not isinstance(step, bool)
    if not is_number or not 0.0 < float(step) < np.inf:
        raise OptionError("step", step, "a positive number of seconds")
    if scene.duration / step > MAX_FIXED_STEPS:
        least = f"at least {scene.duration / MAX_FIXED_STEPS:.3g} s, {MAX_FIXED_STEPS} steps"
        raise OptionError("step", step, least)
    return float(step)


def _parts(interval: Interval, largest: float) -> Iterator[Part]:
    """Divide an interval into parts of equal steps of at most `largest`, s."""
    lengths = np.diff(interval.times)
    begin = 0
    for k in range(1, len(lengths) + 1):
        # the spacing of output times is equal but for round-off; the last one may be shorter
        if k < len(lengths) and abs(lengths[k] - lengths[begin]) <= 1e-9 * lengths[begin]:
            continue
        steps = max(1, math.ceil(float(lengths[begin]) / largest * (1.0 - 1e-9)))
        yield Part(interval.times[begin : k + 1], interval.is_output[begin + 1 : k + 1].tolist(), steps)
        begin = k
