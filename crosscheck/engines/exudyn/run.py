"""A run of Exudyn's solver: steps from stop to stop, outputs, the work of forces, and why a run stops.

Exudyn's solvers need independent constraint equations. If those in use lose their independence on the way,
the run resumes with a model of other ones, see `crosscheck.engines.exudyn.running.IndependentRows`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal, NamedTuple, get_args

import exudyn as exu
import numpy as np

from crosscheck.engines.exudyn.calls import exudyn_calls
from crosscheck.engines.exudyn.running import IndependentRows, RunningSystem
from newton_euler.equations.applied_forces import surroundings, with_likely_causes
from newton_euler.equations.parameters import pieces, with_values
from newton_euler.errors import SingularityError
from newton_euler.model.scene import Scene
from newton_euler.model.trajectory import IntegrationError, StoppedError
from newton_euler.runs.assemble import initial_state
from newton_euler.runs.controllers import Controllers
from newton_euler.runs.intervals import Interval
from newton_euler.scalars import Array

IntegratorName = Literal["generalized_alpha", "trapezoidal"]
"""Names of the integrators: generalized-alpha with constraints of positions (index 3), and the implicit
trapezoidal rule with constraints of velocities (index 2)."""

INTEGRATORS: tuple[IntegratorName, ...] = get_args(IntegratorName)

SPECTRAL_RADIUS = 0.7
"""Spectral radius of generalized-alpha at infinite frequency, below 1 for constraints of positions.

Multipliers oscillate after a jump of forces, by a factor of this size per step. With 0.7 the oscillation has
decayed after some ten steps; errors of the motion are a fifth larger than with 0.9."""

STEPS_BETWEEN_CHECKS = 10
"""Largest number of steps between two checks of the independence of the constraint rows in use."""


class StepError(IntegrationError):
    """A run of Exudyn's solver that stops within a step, and that a shorter step may complete."""


class Output(NamedTuple):
    """State at an output time.

    Attributes:
        equations: equations with the constraint rows of the multipliers.
        scene: scene with the forces of sampled controllers and the set-points from this time on.
        time: s.
        q: (nq,) coordinates.
        v: (nv,) velocities.
        acceleration: (nv,) dv/dt.
        multipliers: (k,) multipliers of M dv/dt = f + J^T multipliers.
    """

    equations: RunningSystem
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

    @property
    def step(self) -> float:
        """Step, s."""
        return float(self.times[1] - self.times[0]) / self.steps

    def with_stops(self, most: int) -> Part:
        """Return the part with further stops, at most `most` steps from one to the next."""
        between = next(n for n in range(1, self.steps + 1) if self.steps % n == 0 and self.steps <= n * most)
        if between == 1:
            return self
        fractions = np.arange(between) / between
        times = (self.times[:-1, None] + np.diff(self.times)[:, None] * fractions).ravel()
        is_output = [k % between == 0 and self.is_output[k // between - 1] for k in range(1, len(times) + 1)]
        return Part(np.append(times, self.times[-1]), is_output, self.steps // between)

    def after(self, stops: int) -> Part:
        """Return the rest of the part after a number of stops."""
        return self._replace(times=self.times[stops:], is_output=self.is_output[stops:])


def integrals(times: Array, values: Array) -> Array:
    """Integrate values (n,) at times (n,), s, from the first time to each of them.

    The trapezoidal rule is corrected by the slopes of the values, which makes the error of order 4.
    """
    steps = np.diff(times)
    slopes = np.gradient(values, times, edge_order=2) if len(times) > 2 else np.zeros(len(times))
    of_steps = 0.5 * steps * (values[:-1] + values[1:]) - steps**2 / 12.0 * np.diff(slopes)
    return np.concatenate([[0.0], np.cumsum(of_steps)])


def _text(error: Exception) -> str:
    """Describe an exception in one line, with the name of its class if the message alone may be obscure."""
    text = (str(error).strip().splitlines() or ["no reason"])[0]
    return text if isinstance(error, SingularityError) else f"{type(error).__name__}: {text}"


class Run:
    """A run of Exudyn: its present state, and the outputs so far.

    Attributes:
        outputs: the outputs.
    """

    def __init__(self, scene: Scene, integrator: IntegratorName) -> None:
        """Place the model at the initial state of a scene."""
        self._scene, self._integrator, self.outputs = scene, integrator, list[Output]()
        self._rows = IndependentRows(scene)
        self._equations = RunningSystem(scene, self._rows.left_out)
        self._q, self._v = self._equations.coordinates(initial_state(scene))
        self._time = 0.0

    def run(self, plan: Sequence[tuple[Interval, Sequence[Part]]]) -> StoppedError | None:
        """Run all intervals; returns the error that stopped the run, or None."""
        held = dict[str, Any]()
        controllers = Controllers(self._scene) if self._scene.sampled else None
        try:
            for interval, parts in plan:
                self._equations.time = self._time = float(interval.times[0])
                held |= pieces(self._scene, interval.middle, include_smooth=False)
                if controllers and interval.due:
                    readings = np.array(self._equations.measure(self._q, self._v), dtype=float)
                    held |= controllers.sample(interval.due, self._time, readings)
                if held:
                    self._equations.scene = with_values(self._scene, held)
                self._start(is_output=bool(interval.is_output[0]))
                for part in parts:
                    self._complete(part)
        except StoppedError as error:
            return error
        return None

    def _start(self, is_output: bool) -> None:
        """Find accelerations and multipliers of the present state, and store an output there if it is one."""
        try:
            self._acceleration, self._multipliers = self._equations.solve(self._q, self._v)
        except (SingularityError, ArithmeticError) as error:
            if self._time:
                raise StepError(self._time, self._reason(_text(error), "use a shorter step")) from error
            reason = self._reason(_text(error), "start from another state")
            raise IntegrationError(self._time, reason) from error
        except Exception as error:
            raise self._unexpected(error) from error
        if is_output:
            self.outputs.append(self._present(self._time))

    def _complete(self, part: Part) -> None:
        """Run a part, with other constraint rows as soon as those in use become dependent.

        Raises:
            IntegrationError: if Exudyn cannot continue.
        """
        if self._rows.left_out:
            part = part.with_stops(STEPS_BETWEEN_CHECKS)
        while len(part.times) > 1:
            reached, has_other_rows = self._advance(part)
            part = part.after(reached)
            if has_other_rows:
                held, self._equations = self._equations.scene, RunningSystem(self._scene, self._rows.left_out)
                self._equations.scene, self._equations.time = held, self._time
                self._start(is_output=False)

    def _advance(self, part: Part) -> tuple[int, bool]:
        """Run a part, or its beginning if the constraint rows in use lose their independence.

        Returns:
            Number of stops that were reached, and whether other constraint rows were chosen at the last one.

        Raises:
            IntegrationError: if Exudyn cannot continue.
        """
        equations, begin, step = self._equations, float(part.times[0]), part.step
        equations.time = begin
        equations.start(self._q, self._v, self._acceleration, self._multipliers)
        tracks_work, first = equations.scene.tracks_work, len(self.outputs)
        powers = [(begin, equations.power(self._multipliers))] if tracks_work else []
        reached, has_other_rows = 0, False

        def record(_mbs: Any, now: float) -> bool:
            """Follow angles and power after a step, store the state at a stop; False ends the part."""
            nonlocal reached, has_other_rows
            count = round((now - begin) / step)
            if count == 0:  # Exudyn also calls before the first step
                return True
            equations.follow_angles()
            equations.time = self._time = now
            if tracks_work:
                powers.append((now, equations.power(equations.read_multipliers())))
            if count % part.steps:
                return True
            reached = count // part.steps
            self._read()
            if part.is_output[reached - 1]:
                self.outputs.append(self._present(float(part.times[reached])))
            has_other_rows = self._rows.exchange(self._q)
            return not has_other_rows

        equations.model.mbs.SetPostStepUserFunction(record)
        solver, settings = exu.MainSolverImplicitSecondOrder(), self._settings(part)
        try:
            with exudyn_calls():
                solver.SolveSystem(equations.model.mbs, settings)
        except exu.SolverError as error:
            raise self._failed(solver, step) from error
        except (SingularityError, ArithmeticError) as error:  # at an iterate that may be far from the motion
            remedy = f"use a step shorter than {step:.3g} s"
            raise StepError(self._time, self._reason(_text(error), remedy)) from error
        except Exception as error:
            raise self._unexpected(error) from error
        finally:
            self._add_work(powers, first)
        if reached < len(part.times) - 1 and not has_other_rows:
            raise self._failed(solver, step)
        return reached, has_other_rows

    def _read(self) -> None:
        """Read the state that Exudyn's solver has reached."""
        self._q, self._v, self._acceleration = self._equations.read_state(self._q)
        self._multipliers = self._equations.read_multipliers()

    def _present(self, now: float) -> Output:
        """Return the present state as an output at a time, s."""
        return Output(
            self._equations,
            self._equations.scene,
            now,
            self._q,
            self._v,
            self._acceleration,
            self._multipliers,
        )

    def _add_work(self, powers: Sequence[tuple[float, float]], first: int) -> None:
        """Add the work since the start of a part to the state and to the outputs from number `first` on.

        Args:
            powers: times, s, and powers, W, at the start and after each step.
            first: number of the first output after the start of the part.
        """
        if not powers:
            return
        times, values = np.array(powers).T
        work = self._q[-1] + integrals(times, values)
        for k in range(first, len(self.outputs)):
            output = self.outputs[k]
            at = int(np.argmin(np.abs(times - output.time)))
            self.outputs[k] = output._replace(q=np.append(output.q[:-1], work[at]))
        self._q = np.append(self._q[:-1], work[-1])

    def _settings(self, part: Part) -> Any:
        """Return Exudyn's settings of a part."""
        settings, kinds = exu.SimulationSettings(), exu.DynamicSolverType
        settings.solution.file.write = False
        settings.linearSolver.solverType = exu.LinearSolverType.EigenSparse
        integration = settings.timeIntegration
        integration.startTime, integration.endTime = float(part.times[0]), float(part.times[-1])
        integration.numberOfSteps = part.steps * (len(part.times) - 1)
        integration.adaptiveStep = False
        integration.verboseMode = 0
        alpha, is_alpha = integration.generalizedAlpha, self._integrator == "generalized_alpha"
        integration.solverType = kinds.GeneralizedAlpha if is_alpha else kinds.TrapezoidalIndex2
        alpha.useNewmark = alpha.useIndex2Constraints = not is_alpha
        alpha.spectralRadius = SPECTRAL_RADIUS
        # initial accelerations are given: Exudyn's own leave out functions of time in constraints
        alpha.computeInitialAccelerations = False
        alpha.resetAccelerations = False
        integration.newton.relativeTolerance = 1e-10
        integration.newton.absoluteTolerance = 1e-12
        # Python evaluates equations of coordinates, of which full Newton steps need fewer
        integration.newton.useModifiedNewton = not self._equations.model.equations
        return settings

    def _failed(self, solver: Any, step: float) -> StepError:
        """Return the error of a run whose equations Exudyn's solver could not solve at a step, s."""
        is_singular = solver.conv.linearSolverFailed
        what = "equations are singular" if is_singular else "Newton iteration did not converge"
        reason = f"Exudyn's {what} at a step of {step:.3g} s ({solver.GetErrorString()})"
        remedy = f"use a step shorter than {step:.3g} s"
        if is_singular:
            remedy += ", or start farther from the singular state"
        return StepError(self._time, self._reason(reason, remedy))

    def _unexpected(self, error: Exception) -> IntegrationError:
        """Return the error of a run that stops by an exception of a Python function or of Exudyn."""
        remedy = "this is an error of Exudyn or of its adapter, unless a class of yours raises it"
        return IntegrationError(self._time, self._reason(_text(error), remedy))

    def _reason(self, reason: str, remedy: str) -> str:
        """Return why a run stops at the present time, with likely causes and a remedy."""
        scene, equations = self._equations.scene, self._equations
        equations.time = self._time
        state = equations.state(self._q, self._v)
        at = surroundings(scene, state, self._time)
        return f"{with_likely_causes(scene, state, reason, at)}; {remedy}"
