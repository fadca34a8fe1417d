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
from typing import Any, Literal, NamedTuple, get_args

import exudyn as exu
import numpy as np

from crosscheck.engines.exudyn.running import RunningSystem
from newton_euler.arguments import checked
from newton_euler.equations.applied_forces import surroundings, with_likely_causes
from newton_euler.equations.parameters import pieces, with_values
from newton_euler.equations.redundancy import dependent_rows
from newton_euler.equations.system import Observation
from newton_euler.errors import OptionError, UnknownNameError
from newton_euler.integrators.options import MAX_FIXED_STEPS
from newton_euler.model.scene import Scene
from newton_euler.model.trajectory import IntegrationError, StoppedError, Trajectory
from newton_euler.runs.assemble import initial_state
from newton_euler.runs.controllers import Controllers
from newton_euler.runs.intervals import Interval, intervals
from newton_euler.runs.simulate import trajectory_from
from newton_euler.scalars import Array

IntegratorName = Literal["generalized_alpha", "trapezoidal"]
"""Names of the integrators: generalized-alpha with constraints of positions (index 3), and the implicit
trapezoidal rule with constraints of velocities (index 2)."""

INTEGRATORS: tuple[IntegratorName, ...] = get_args(IntegratorName)

MAX_STEP = 1e-3
"""Default step, s."""

SPECTRAL_RADIUS = 0.7
"""Spectral radius of generalized-alpha at infinite frequency, below 1 for constraints of positions.

Multipliers oscillate after a jump of forces, by a factor of this size per step. With 0.7 the oscillation has
decayed after some ten steps; errors of the motion are a fifth larger than with 0.9."""


class Output(NamedTuple):
    """State at an output time.

    Attributes:
        scene: scene with the forces of sampled controllers and the set-points from this time on.
        time: s.
        q: (nq,) coordinates.
        v: (nv,) velocities.
        acceleration: (nv,) dv/dt.
        multipliers: (k,) multipliers of M dv/dt = f + J^T multipliers.
    """

    scene: Scene
    time: float
    q: Array
    v: Array
    acceleration: Array
    multipliers: Array


class Part(NamedTuple):
    """Steps of one size from one stop of an interval to another.

    Attributes:
        times: (n,) s, the stops: begin, output times inside, and end.
        is_output: (n - 1,) for each stop but the first, whether it is an output.
        steps: number of steps between two stops.
    """

    times: Array
    is_output: Sequence[bool]
    steps: int


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
    if integrator not in INTEGRATORS:
        raise UnknownNameError("integrator", integrator, INTEGRATORS)
    largest = _checked_step(scene, step)
    equations = RunningSystem(scene)
    if left_out := dependent_rows(equations):
        equations = RunningSystem(scene, left_out)
    plan = [(interval, list(_parts(interval, largest))) for interval in intervals(scene, scene.jumps)]
    start = time.perf_counter()
    run = _Run(equations, integrator)
    stopped = run.run(plan)
    wall_time = time.perf_counter() - start
    sizes = [float(part.times[1] - part.times[0]) / part.steps for _, of in plan for part in of]
    settings = {
        "integrator": integrator,
        "step": max(sizes),
        "steps": sum(part.steps * (len(part.times) - 1) for _, of in plan for part in of),
    }
    evaluations, coupling_residuals = list[Observation](), list[Array]()
    for output in run.outputs:
        equations.scene, equations.time = output.scene, output.time
        if scene.needs_accelerations:
            evaluations.append(equations.evaluation(*output[2:]))
        else:
            evaluations.append(equations.observe(output.q, output.v))
        coupling_residuals.append(equations.coupling_phi(output.q))
    return trajectory_from(scene, "exudyn", settings, wall_time, evaluations, coupling_residuals, stopped)


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


class _Run:
    """A run of Exudyn: its present state, and the outputs so far.

    Attributes:
        outputs: the outputs.
    """

    def __init__(self, equations: RunningSystem, integrator: IntegratorName) -> None:
        self._equations, self._integrator, self.outputs = equations, integrator, list[Output]()
        self._scene, self._mbs = equations.scene, equations.model.mbs
        self._q, self._v = equations.coordinates(initial_state(equations.scene))
        self._time, self._power = 0.0, 0.0

    def run(self, plan: Sequence[tuple[Interval, Sequence[Part]]]) -> StoppedError | None:
        """Run all intervals; returns the error that stopped the run, or None."""
        equations, held = self._equations, dict[str, Any]()
        controllers = Controllers(self._scene) if self._scene.sampled else None
        for interval, parts in plan:
            equations.time = self._time = float(interval.times[0])
            held |= pieces(self._scene, interval.middle, include_smooth=False)
            if controllers and interval.due:
                readings = np.array(equations.measure(self._q, self._v), dtype=float)
                try:
                    held |= controllers.sample(interval.due, self._time, readings)
                except IntegrationError as error:
                    return error
            if held:
                equations.scene = with_values(self._scene, held)
            acceleration, multipliers = equations.solve(self._q, self._v)
            if interval.is_output[0]:
                self.outputs.append(
                    Output(equations.scene, self._time, self._q, self._v, acceleration, multipliers)
                )
            for part in parts:
                if stopped := self._advance(part, acceleration, multipliers):
                    return stopped
                last = self._present()
                self._q, self._v, acceleration, multipliers = last[2:]
        return None

    def _advance(self, part: Part, acceleration: Array, multipliers: Array) -> IntegrationError | None:
        """Run a part; returns the error that stopped it, or None."""
        equations = self._equations
        equations.time = float(part.times[0])
        equations.start(self._q, self._v, acceleration, multipliers)
        if equations.scene.tracks_work:
            self._power = equations.power(multipliers)
        step = float(part.times[1] - part.times[0]) / part.steps

        def record(_mbs: Any, now: float) -> bool:
            """Update angles and work after a step, and store the state at an output time."""
            count = round((now - float(part.times[0])) / step)
            if count == 0:  # Exudyn also calls before the first step
                return True
            equations.follow_angles()
            if equations.scene.tracks_work:
                equations.time = now
                power = equations.power(equations.read_multipliers())
                self._q[-1] += 0.5 * (now - self._time) * (self._power + power)
                self._power = power
            self._time = now
            if count % part.steps == 0 and part.is_output[count // part.steps - 1]:
                self.outputs.append(self._present(float(part.times[count // part.steps])))
            return True

        self._q = self._q.copy()  # its work is changed
        self._mbs.SetPostStepUserFunction(record)
        settings = self._settings(part)
        kinds = exu.DynamicSolverType
        kind = kinds.GeneralizedAlpha if self._integrator == "generalized_alpha" else kinds.TrapezoidalIndex2
        try:
            self._mbs.SolveDynamic(settings, solverType=kind)
        except Exception as error:  # Exudyn raises its own and plain exceptions
            return self._stopped(error)
        return None

    def _present(self, now: float | None = None) -> Output:
        """Return the present state of Exudyn's system."""
        q, v, acceleration = self._equations.read_state(self._q)
        multipliers = self._equations.read_multipliers()
        return Output(
            self._equations.scene, self._time if now is None else now, q, v, acceleration, multipliers
        )

    def _settings(self, part: Part) -> Any:
        """Return Exudyn's settings of a part."""
        settings = exu.SimulationSettings()
        settings.solution.file.write = False
        settings.linearSolver.solverType = exu.LinearSolverType.EigenSparse
        integration = settings.timeIntegration
        integration.startTime, integration.endTime = float(part.times[0]), float(part.times[-1])
        integration.numberOfSteps = part.steps * (len(part.times) - 1)
        integration.adaptiveStep = False
        integration.verboseMode = 0
        integration.generalizedAlpha.spectralRadius = SPECTRAL_RADIUS
        # initial accelerations are given: Exudyn's own leave out functions of time in constraints
        integration.generalizedAlpha.computeInitialAccelerations = False
        integration.generalizedAlpha.resetAccelerations = False
        integration.newton.relativeTolerance = 1e-10
        integration.newton.absoluteTolerance = 1e-12
        # Python evaluates equations of coordinates, of which full Newton steps need fewer
        integration.newton.useModifiedNewton = not self._equations.model.equations
        return settings

    def _stopped(self, error: Exception) -> IntegrationError:
        """Return the error of a run that Exudyn has stopped."""
        scene, last = self._equations.scene, self.outputs[-1]
        self._equations.time = last.time
        state = self._equations.state(last.q, last.v)
        at = surroundings(scene, state, last.time)
        reason = (
            f"Exudyn: {str(error).strip().splitlines()[0] if str(error).strip() else type(error).__name__}"
        )
        return IntegrationError(self._time, with_likely_causes(scene, state, reason, at))
