"""Run scenes: `simulate` runs a scene once, `compile_scene` compiles it for many runs.

Both use this package's own equations in native code. `run` integrates any other system of equations, such as
Pinocchio's, in Python. All of them return a `Trajectory`.

A run is divided into intervals at the samples of digital controllers and at the knots of splines
(`newton_euler.runs.intervals`). Couplings are constraints between joint coordinates, such as gears.
"""

from __future__ import annotations

import copy
import time
import warnings
from collections import Counter
from collections.abc import Iterable, Sequence
from functools import cached_property, lru_cache
from typing import Any, NamedTuple, Unpack

import numpy as np

from newton_euler.arguments import caller_level, checked
from newton_euler.compiled.equations import CACHED_SCENES, CompiledEquations
from newton_euler.compiled.evaluated import integrate
from newton_euler.compiled.formulations import check_formulation
from newton_euler.compiled.outputs import named
from newton_euler.compiled.run import load_code
from newton_euler.equations.couplings import counted_angles, couplings
from newton_euler.equations.parameters import pieces
from newton_euler.equations.redundancy import NearlyRedundant, inherit_mobility, mobility
from newton_euler.equations.system import Observation, System, at_time
from newton_euler.errors import NearlyRedundantWarning, NewtonEulerError, OptionError, RoundOffWarning
from newton_euler.integrators.options import (
    RUN_ARGUMENTS,
    FormulationName,
    IntegratorName,
    Options,
    StabilizationName,
    StepControl,
    baumgarte_alpha,
)
from newton_euler.integrators.stepper import reported_counts
from newton_euler.model.euler_parameters import continuous
from newton_euler.model.mechanism import Mechanism
from newton_euler.model.scene import Scene
from newton_euler.model.state import State, stacked
from newton_euler.model.trajectory import (
    IntegrationError,
    StoppedError,
    Trajectory,
    UndeterminedStartError,
    check_finite,
)
from newton_euler.runs.assemble import coordinates_of, inherit_initial_state, initial_state
from newton_euler.runs.controllers import Controllers
from newton_euler.runs.intervals import integrate_intervals, intervals, with_held_values
from newton_euler.scalars import Array, unstacked

MAX_ROUND_OFF = 20.0
"""Largest error estimate caused by round-off, divided by the tolerance, for which a run does not warn.

Below this value, errors of chains of 20 and 40 links are as small as the tolerance makes them in other
scenes."""


@checked
def simulate(
    scene: Scene,
    formulation: FormulationName | None = None,
    integrator: IntegratorName = "DOP853",
    *,
    stabilization: StabilizationName = "projection",
    alpha: float | None = None,
    **control: Unpack[StepControl],
) -> Trajectory:
    """Run a scene with this package's own equations, in native code.

    Args:
        scene: a mechanism with its surroundings, start and duration.
        formulation: "relative" (joint coordinates) or "cartesian" (poses of all bodies). If None, joint
            coordinates, unless many closed loops share joint axes. The trajectory's settings name the
            formulation.
        integrator: "DOP853" (explicit, order 8) or "Radau" (implicit, order 5, for stiff scenes) with error
            control; "RK4" or "Euler" (semi-implicit) with fixed steps.
        stabilization: how loops stay closed: "projection" onto the constraints after each step, "baumgarte"
            (feedback of the constraint violation) or "none".
        alpha: 1/s, of Baumgarte's gains K_D = 2 alpha, K_P = alpha^2; 10 if None.
        control: options of the steps, see `StepControl`: rtol (1e-10) and atol (1e-12) of "DOP853" and
            "Radau", step (s) of "RK4" and "Euler", most_steps and rest.

    Raises:
        NewtonEulerError: for an unknown name, an impossible option, or a run that stops early; an
            `IntegrationError` has the trajectory so far as `partial`.

    Examples:
        >>> run = simulate(load("pendulum"), "cartesian", stabilization="baumgarte")
        >>> run.settings["formulation"], run.position.shape
        ('cartesian', (1001, 2, 3))
    """
    options = Options.of(integrator, control, ("formulation", *RUN_ARGUMENTS))
    check_formulation(formulation)
    compiled = _compiled(scene, formulation, stabilization, baumgarte_alpha(stabilization, alpha))
    compiled.warn()
    trajectory = compiled._run(options)
    warn_of_round_off(scene, options, [trajectory.settings])
    return trajectory


@lru_cache(maxsize=CACHED_SCENES)
def _compiled(scene: Scene, formulation: str | None, stabilization: str, alpha: float) -> CompiledScene:
    """Return the compiled scene; recent ones are kept, because scenes are immutable."""
    return CompiledScene(scene, formulation, stabilization, alpha)


@checked
def compile_scene(
    scene: Scene,
    formulation: FormulationName | None = None,
    stabilization: StabilizationName = "projection",
    alpha: float | None = None,
    parameters: Sequence[str] = (),
) -> CompiledScene:
    """Trace and compile a scene for many runs.

    Args:
        scene, formulation, stabilization, alpha: see `simulate`.
        parameters: names of numbers that vary from run to run, see `newton_euler.equations.parameters`. Give
            the values of a run by `compiled.with_scene(with_parameters(scene, values))`.

    Raises:
        NewtonEulerError: for an unknown name or an impossible option.

    Examples:
        >>> compiled = compile_scene(load("pendulum"))
        >>> compiled.simulate("RK4", step=0.001).settings["steps"]
        10000
    """
    check_formulation(formulation)
    compiled = CompiledScene(scene, formulation, stabilization, alpha, parameters)
    load_code(compiled, "DOP853")
    return compiled


class CompiledScene(CompiledEquations):
    """A scene in native code for many runs; see `compile_scene`."""

    @cached_property
    def start(self) -> Array:
        """Input vector x (inputs,) of the compiled functions at the scene's initial state."""
        (state,) = coordinates_of(self.system, [initial_state(self.scene)])
        return self._at(state)

    def _at(self, state: Array) -> Array:
        """Return the input vector x (inputs,) at a state (q, v) (size,) and the scene's own parameters."""
        return self.packed(state[: self.system.nq], state[self.system.nq :])

    def with_scene(self, scene: Scene) -> CompiledScene:
        """Return the same code for a scene that differs only in parameters, controllers and duration."""
        # computed before the copy, so that both objects share what does not depend on parameters
        _ = self._rank_decisions, self._scene_places, self.groups, self.loses_rank
        other = copy.copy(self)
        other.scene = scene
        if scene.initial_state is self.scene.initial_state:
            inherit_mobility(scene, self.scene)  # which constraints are redundant
            inherit_initial_state(scene, self.scene)
            state = self.start[: self.size]
        else:
            (state,) = coordinates_of(self.system, [initial_state(scene)])
        other.__dict__.update(start=other._at(state))  # overwrite the cached property
        return other

    def simulate(
        self,
        integrator: IntegratorName = "DOP853",
        times: Array | None = None,
        **control: Unpack[StepControl],
    ) -> Trajectory:
        """Run the scene; see `newton_euler.simulate` for errors and the other arguments.

        Args:
            integrator: "DOP853", "Radau", "RK4" or "Euler".
            times: (n,) s, output times, ascending from 0; those of the scene if None.
            control: options of the steps, see `StepControl`.
        """
        options = Options.of(integrator, control)
        self.warn()
        trajectory = self._run(options, times)
        warn_of_round_off(self.scene, options, [trajectory.settings])
        return trajectory

    def warn(self) -> None:
        """Warn if constraints are almost redundant."""
        warn_of(self.scene, self.nearly_redundant)

    def _run(self, options: Options, times: Array | None = None) -> Trajectory:
        """Run the scene without warnings; see `simulate` for arguments and errors."""
        options.check_steps(self.scene.duration)
        load_code(self, options.integrator)
        x = self.start.copy()
        # at a singular configuration several branches of motion meet
        if joint := mobility(self.scene).between_branches:
            raise UndeterminedStartError(
                0.0,
                f"the run starts at a singular configuration, where joint {joint!r} loses rank, and no "
                "motion has its velocities: they lie between the branches; start with velocities of one "
                "branch, or elsewhere",
            )
        results, counts, stopped, wall_time = integrate_intervals(self, x, options, times=times)
        arrays = named(self, results)
        settings = self.settings | options.as_settings() | reported_counts(counts)
        settings |= {"trace_time": self.trace_time, "compile_time": self.compile_time}
        if stopped is None:
            return native_trajectory(self.scene, settings, wall_time, arrays, times)
        if len(results):
            stopped.partial = native_trajectory(self.scene, settings, wall_time, arrays, times)
        raise stopped


def warn_of(scene: Scene, nearly: Iterable[NearlyRedundant]) -> None:
    """Warn of almost redundant constraints; the warning points to the line that called this package."""
    for constraint in nearly:
        text = f"scene {scene.name!r}: {constraint}"
        warnings.warn(text, NearlyRedundantWarning, stacklevel=caller_level())


def warn_of_round_off(scene: Scene, options: Options, runs: Iterable[dict[str, Any]]) -> None:
    """Warn if round-off exceeds the tolerance in one of several runs.

    Args:
        scene: the scene.
        options: gives the tolerances.
        runs: settings of the runs, see `Trajectory.settings`. The entry "round_off" is the largest error
            estimate caused by round-off, divided by the tolerance; it exists only for values above 1.
    """
    worst = max(runs, key=lambda settings: settings.get("round_off", 0.0), default={})
    if (excess := worst.get("round_off", 0.0)) > MAX_ROUND_OFF:
        warning = RoundOffWarning(scene.name, worst["formulation"], options.rtol, options.atol, excess)
        warnings.warn(warning, stacklevel=caller_level())


def native_trajectory(
    scene: Scene,
    settings: dict[str, Any],
    wall_time: float,
    arrays: dict[str, Array],
    times: Array | None = None,
) -> Trajectory:
    """Build the trajectory of a run in native code.

    Args:
        scene: the scene.
        settings: settings of the run.
        wall_time: s.
        arrays: outputs by name, (n, ...) each; modified.
        times: (n,) s, output times; those of the scene if None.
    """
    arrays.pop("pivot_ratio", None)  # shows singular states while outputs are computed
    if "violation" in scene.outputs:
        arrays["constraint_violation"] = _by_joint(scene, arrays["phi"])
    arrays.pop("phi", None)  # runs without projection have these residuals even if they are not asked for
    return _trajectory(scene, "newton_euler", settings, wall_time, arrays, times)


def _by_joint(scene: Scene, phi: Array) -> Array:
    """Find the largest residual of each joint.

    The residual of a coupling belongs to the joint that follows the others.

    Args:
        scene: the scene with j joints.
        phi: (n, k) residuals of joints, then couplings, at n states, m or rad.

    Returns:
        (n, j), m or rad.
    """
    mechanism = scene.mechanism
    owners = [k for k, equations in enumerate(mechanism.equations) for _ in range(equations.count)]
    owners += [mechanism.joint_index(coupling.joint) for coupling in couplings(scene)]
    residuals = np.ascontiguousarray(np.abs(phi).reshape(len(phi), len(owners)).T)
    violation = np.zeros((len(mechanism.joints), len(phi)))
    for owner, residual in zip(owners, residuals, strict=True):
        np.maximum(violation[owner], residual, out=violation[owner])
    return violation.T.copy()


def _residuals(mechanism: Mechanism, states: Sequence[State], coupling_residuals: Sequence[Array]) -> Array:
    """Compute the residuals of all joints at n states, and append the given residuals of couplings.

    Args:
        mechanism: the mechanism.
        states: n states.
        coupling_residuals: (c,) residuals of couplings at each state, m or rad.

    Returns:
        (n, k), m or rad.
    """
    # residuals of each joint between its first and second body, in all n states at once
    frames = stacked(states).frames()
    phis = [joint.phi(frames[joint.first], frames[joint.second]) for joint in mechanism.equations]
    return np.hstack(
        [unstacked(np.concatenate([np.zeros(0), *phis]), len(states)), np.array(coupling_residuals)]
    )


def run(system: System, engine: str, options: Options, settings: dict[str, Any]) -> Trajectory:
    """Integrate a system of equations that Python evaluates, over the duration of its scene.

    Args:
        system: equations of motion of an engine.
        engine: name of the engine.
        options: integrator and step control.
        settings: settings of the engine; those of the integrator and its counts are added.

    Raises:
        OptionError: for steps that are skipped at rest (`Options.rest`): runs of Python skip none.
        IntegrationError: for a run that stops early, with the trajectory so far.
    """
    if options.rest:
        raise OptionError("rest", options.rest, f"0: runs of {engine} do not skip steps at rest")
    found = integrate_scene(system, options)
    settings = settings | options.as_settings() | {"steps": found.steps, "evaluations": found.evaluations}
    return trajectory_of_states(system.scene, engine, settings, found)


class OutputState(NamedTuple):
    """State of a run at an output time.

    Attributes:
        system: equations that evaluate the state.
        time: s.
        q: (nq,) coordinates.
        v: (nv,) velocities.
    """

    system: System
    time: float
    q: Array
    v: Array


class IntegratedStates(NamedTuple):
    """States of a run before their evaluation.

    Attributes:
        outputs: states at the output times that the run reached.
        wall_time: duration of the integration, s.
        steps, evaluations: numbers of steps, and of evaluations of the equations.
        stopped: the error that ended the run early; None if it is complete.
    """

    outputs: list[OutputState]
    wall_time: float
    steps: int
    evaluations: int
    stopped: IntegrationError | None


def integrate_scene(system: System, options: Options) -> IntegratedStates:
    """Integrate a system of equations that Python evaluates, over the duration of its scene.

    Args:
        system: equations of motion of an engine.
        options: integrator and step control; `rest` is not used.
    """
    # the start
    scene = system.scene
    options.check_steps(scene.duration)
    q, v = system.coordinates(initial_state(scene))
    start = time.perf_counter()
    rows = list[OutputState]()
    counts = Counter(steps=0, evaluations=0)
    stopped: IntegrationError | None = None
    # values that are constant in an interval, by parameter name: coefficients of the polynomial pieces of
    # functions of time, and forces that sampled controllers hold
    held: dict[str, Any] = {}
    original, controllers = system, Controllers(scene) if scene.sampled else None
    # integrate interval by interval
    for interval in intervals(scene, scene.knots):
        held |= pieces(scene, interval.middle)
        if controllers and interval.due:  # laws whose controllers are called at the beginning
            readings = np.array(system.measure(q, v), dtype=float)
            try:
                held |= controllers.sample(interval.due, float(interval.times[0]), readings)
            except IntegrationError as error:
                stopped = error
                break
        system = with_held_values(original, held) if held else original
        table, counts_of_interval, stopped = integrate(system, q, v, interval.times, options)
        counts.update(counts_of_interval)
        for t, is_output, state in zip(interval.times, interval.is_output, table, strict=False):
            q, v = state[: system.nq], state[system.nq :]
            if is_output:
                rows.append(OutputState(system, t, q, v))
        if stopped:
            break
    wall_time = time.perf_counter() - start
    return IntegratedStates(rows, wall_time, counts["steps"], counts["evaluations"], stopped)


def trajectory_of_states(
    scene: Scene,
    engine: str,
    settings: dict[str, Any],
    found: IntegratedStates,
) -> Trajectory:
    """Evaluate the states of a run at the output times, and build its trajectory.

    A state that cannot be evaluated ends the trajectory, as a run does that stops there. For the other
    arguments and errors see `trajectory_from`.

    Args:
        scene, engine, settings: see `trajectory_from`.
        found: the states.
    """
    evaluations, coupling_residuals = list[Observation](), list[Array]()
    stopped = found.stopped
    for system, t, q, v in found.outputs:
        now = at_time(system, t)
        try:
            with np.errstate(all="ignore"):  # `trajectory_from` checks that numbers are finite
                evaluation = now.evaluate(q, v) if scene.needs_accelerations else now.observe(q, v)
                residuals = now.coupling_phi(q)
        except NewtonEulerError as error:
            stopped = stopped or IntegrationError(t, str(error))
            break
        evaluations.append(evaluation)
        coupling_residuals.append(residuals)
    return trajectory_from(scene, engine, settings, found.wall_time, evaluations, coupling_residuals, stopped)


def trajectory_from(
    scene: Scene,
    engine: str,
    settings: dict[str, Any],
    wall_time: float,
    evaluations: Sequence[Observation],
    coupling_residuals: list[Array],
    stopped: StoppedError | None = None,
) -> Trajectory:
    """Build the trajectory of a scene from an engine's evaluations at the output times.

    Args:
        scene: the scene.
        engine: name of the engine.
        settings: settings of the run.
        wall_time: s.
        evaluations: states, and accelerations if the scene needs them, at the output times reached.
        coupling_residuals: residuals (c,) of the couplings at each output time, m or rad.
        stopped: the error that ended the run early.

    Raises:
        IntegrationError: for numbers that are not finite, with the trajectory before them.
        StoppedError: `stopped`, with the trajectory of the evaluations.
    """
    # arrays of the outputs that the scene has
    states = [evaluation.state for evaluation in evaluations]
    sources: dict[str, tuple[Sequence[Any], tuple[str, ...]]] = {  # objects and their attributes, by output
        "velocities": (states, ("linear_velocity", "angular_velocity")),
        "reactions": (evaluations, ("reaction_force", "reaction_torque")),
        "actuation": (evaluations, ("actuator_force",)),
        "energy": (evaluations, ("kinetic_energy", "potential_energy")),
    }
    arrays: dict[str, Array] = {}
    for output, (objects, names) in sources.items():
        if output in scene.outputs:
            arrays |= {name: np.array([getattr(each, name) for each in objects]) for name in names}
    if scene.tracks_work and all(e.work is not None for e in evaluations):
        arrays["work"] = np.array([e.work for e in evaluations])
    if "violation" in scene.outputs and states:
        arrays["constraint_violation"] = _by_joint(
            scene, _residuals(scene.mechanism, states, coupling_residuals)
        )
    arrays["position"] = np.array([s.position for s in states])
    arrays["quaternion"] = np.array([s.quaternion for s in states])
    if states and states[0].angles:
        arrays["joint_angle"] = np.array([list(state.angles.values()) for state in states])
    # end the trajectory before the first number that is not finite
    try:
        check_finite(scene.times, arrays)
    except IntegrationError as error:
        stopped, rows = stopped or error, int(np.searchsorted(scene.times, error.time))
        arrays = {name: array[:rows] for name, array in arrays.items()}
    if stopped is None:
        return _trajectory(scene, engine, settings, wall_time, arrays)
    if len(arrays["position"]):
        stopped.partial = _trajectory(scene, engine, settings, wall_time, arrays)
    raise stopped


def _trajectory(
    scene: Scene,
    engine: str,
    settings: dict[str, Any],
    wall_time: float,
    arrays: dict[str, Array],
    times: Array | None = None,
) -> Trajectory:
    """Build a trajectory from arrays by name; make the signs of quaternions continuous in time.

    The output times are those of the scene unless others are given.

    The array "joint_angle" holds the angles whose full revolutions forces or couplings depend on.
    """
    labels, has_angles = scene.mechanism.coordinate_labels, "joint_angle" in arrays
    arrays["quaternion"] = continuous(arrays["quaternion"], initial_state(scene).quaternion)
    return Trajectory(
        engine=engine,
        settings=settings,
        wall_time=wall_time,
        time=(scene.times if times is None else times)[: len(arrays["position"])],
        body_names=scene.mechanism.body_names,
        joint_names=scene.mechanism.joint_names,
        angle_names=tuple(labels[key] for key in counted_angles(scene)) if has_angles else (),
        mechanism=scene.mechanism,
        **arrays,
    )
