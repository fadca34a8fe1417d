"""Simulate a scene by MuJoCo's own time stepping, with a fixed step that divides all intervals.

A scene is a mechanism with its forces, control laws and initial state. Output times, samples of digital
controllers, and jumps of set-points divide the run into intervals. Each interval has a whole number of equal
steps.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from numbers import Real
from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple, get_args

import numpy as np

from mjcf.constraint_solver import (
    ITERATIONS,
    MAX_ITERATIONS,
    SOLVERS,
    TOLERANCE,
    ConstraintSolver,
    SolverName,
)
from mjcf.errors import DivergenceError, collected_warnings
from mjcf.write import SOLIMP, TIMESTEP
from newton_euler.arguments import Range, checked
from newton_euler.equations.applied_forces import surroundings, with_likely_causes
from newton_euler.equations.load_friction import jam
from newton_euler.equations.parameters import pieces
from newton_euler.errors import OptionError, check_choice
from newton_euler.integrators.options import MAX_FIXED_STEPS
from newton_euler.model.scene import Scene
from newton_euler.model.trajectory import IntegrationError, StoppedError, Trajectory
from newton_euler.runs.assemble import initial_state
from newton_euler.runs.controllers import Controllers
from newton_euler.runs.intervals import Interval, intervals, with_held_values
from newton_euler.runs.simulate import trajectory_from
from newton_euler.scalars import Array

if TYPE_CHECKING:
    from mjcf.mjx import MjxSteps
    from mjcf.soft import SoftMuJoCo

MIN_COMMON_DIVISOR = 1e-6
"""Smallest common divisor, s, of the output period and the periods of controllers; the time step divides it.
"""

IntegratorName = Literal["RK4", "Euler", "implicit", "implicitfast"]
"""Names of MuJoCo's integrators in MJCF."""

INTEGRATORS: tuple[IntegratorName, ...] = get_args(IntegratorName)

BackendName = Literal["C", "MJX"]
"""Names of implementations of MuJoCo's steps: the library in C, and MJX in JAX."""

BACKENDS: tuple[BackendName, ...] = get_args(BackendName)


@checked
def simulate(
    scene: Scene,
    timestep: float | None = None,
    integrator: IntegratorName = "RK4",
    solref: Sequence[float] | None = None,
    solver: SolverName = "Newton",
    iterations: Annotated[int, Range(1, MAX_ITERATIONS)] = ITERATIONS,
    tolerance: Annotated[float, Range(0.0)] = TOLERANCE,
    backend: BackendName = "C",
) -> Trajectory:
    """Simulate a scene in MuJoCo, with soft constraints and native actuators, springs and tendons.

    Reactions at an output come from MuJoCo's forward dynamics at that state. If the scene tracks the work of
    forces without potential, the work is that of the forces that the steps apply.

    Args:
        scene: scene to simulate.
        timestep: s, a divisor of the output period and of the periods of sampled controllers. None means the
            largest divisor up to 1 ms; a shorter last output interval has shorter steps.
        integrator: MuJoCo's "RK4", "Euler", "implicit" or "implicitfast".
        solref: stiffness of loop closures, couplings and prescribed motions: time constant (s) and damping
            ratio, or stiffness and damping as negative numbers. None means (2 timestep, 1), the stiffest
            constraints that MuJoCo allows.
        solver: iteration for the forces of the soft constraints: "Newton", "CG" (conjugate gradients) or
            "PGS" (projected Gauss-Seidel).
        iterations: largest number of iterations of the solver in one evaluation.
        tolerance: relative improvement at which the solver ends its iteration.
        backend: implementation that takes the steps: "C", or "MJX" in JAX. Outputs are evaluated in C.
            Commands of crosscheck take "C", as MJX compiles each model for up to a minute. Loop constraints
            of MJX 3.17 have other reference accelerations: those of the moving tracker differ by up to 3 %.

    Raises:
        NewtonEulerError: for an unknown integrator or solver, an impossible option, or a controller that
            fails.
        MjcfError: for a scene that MuJoCo or MJX refuses, or a run that diverges.
        MissingPackageError: for "MJX" if it is not installed.
        UnusablePackageError: for "MJX" in versions that are too old, or do not match.

    Examples:
        >>> mjcf.simulate(load("pendulum"), timestep=0.001)
        <Trajectory of mujoco: 1001 outputs to 10 s, bodies: 2, joints: 1>
    """
    # intervals in which controls do not jump, each with its parts between output times; each part has a
    # number of equal steps
    largest_allowed = _chosen_timestep(scene, timestep)
    plan = [
        (interval, [_equal_steps(float(length), largest_allowed) for length in np.diff(interval.times)])
        for interval in intervals(scene, scene.jumps)
    ]
    steps = [step for _, interval_steps in plan for step in interval_steps]
    largest = max(step.size for step in steps)
    # options
    check_choice("integrator", integrator, INTEGRATORS)
    check_choice("solver", solver, SOLVERS)
    check_choice("backend", backend, BACKENDS)
    checked_solref = None if solref is None else _checked_solref(solref, largest)

    from mjcf.soft import SoftMuJoCo, stiffest_solref

    system = SoftMuJoCo(scene)
    system.use_integrator(integrator)
    constraint_solver = ConstraintSolver(solver, int(iterations), float(tolerance))
    constraint_solver.apply(system.model)

    mjx_steps = None
    if backend == "MJX":
        from mjcf.mjx import MjxSteps, check_options

        check_options(integrator, solver)
        mjx_steps = MjxSteps(system)

    # the run, then the evaluation of its outputs
    start = time.perf_counter()
    outputs, stopped = _run(system, plan, checked_solref, mjx_steps)
    wall_time = time.perf_counter() - start
    settings: dict[str, Any] = {
        "timestep": largest,
        "integrator": integrator,
        "solref": list(checked_solref or stiffest_solref(largest)),
        "solimp": list(SOLIMP),
        "solver": constraint_solver.name,
        "iterations": constraint_solver.iterations,
        "tolerance": constraint_solver.tolerance,
        "backend": backend,
        "steps": sum(step.number for step in steps),
    }
    if steps[-1].size != largest:
        settings["last_timestep"] = steps[-1].size
    evaluations, coupling_residuals = [], []
    for output, now in zip(outputs, scene.times, strict=stopped is None):  # fewer outputs if stopped
        at_output, q, v = output.system, output.q, output.v
        at_output.use_step(output.step, checked_solref)  # the softness of constraints depends on the step
        at_output.time = float(now)
        evaluation = at_output.evaluate(q, v) if scene.needs_accelerations else at_output.observe(q, v)
        evaluations.append(replace(evaluation, work=output.work))
        coupling_residuals.append(at_output.coupling_phi(q))
    return trajectory_from(scene, "mujoco", settings, wall_time, evaluations, coupling_residuals, stopped)


class Steps(NamedTuple):
    """Equal time steps of a part of an interval.

    Attributes:
        number: number of steps.
        size: s.
    """

    number: int
    size: float


def _equal_steps(interval: float, largest: float) -> Steps:
    """Divide an interval, s, into the fewest equal steps of at most `largest`, s.

    If `largest` divides the interval to round-off (1e-9), the size of the steps is `largest` itself.
    """
    number = max(1, int(np.ceil(interval / largest * (1.0 - 1e-9))))
    divides = abs(number * largest - interval) <= 1e-9 * interval
    return Steps(number, largest if divides else interval / number)


def _common_divisor(first: float, second: float) -> float:
    """Return the largest common divisor of two lengths, s, by Euclid's algorithm.

    Lengths without a common divisor have a result near round-off.
    """
    round_off = 1e-9 * max(first, second)
    while second > round_off:
        first, second = second, abs(math.remainder(first, second))
    return first


def default_timestep(scene: Scene) -> float:
    """Return the default time step of `simulate` for a scene, s."""
    return _chosen_timestep(scene, None)


def _chosen_timestep(scene: Scene, timestep: float | None) -> float:
    """Return the time step, s: `timestep` if it divides all intervals, or the default if it is None.

    Raises:
        OptionError: for a time step that is no divisor, or leads to too many steps, and for periods without
            common divisor.
    """
    # common divisor of the output period and the periods of sampled controllers, which hold their force
    # between samples
    sampled_laws = [law for law in scene.sampled if law.period < scene.duration]
    periods = [scene.output_period] if scene.output_period < scene.duration else []
    periods += [law.period for law in sampled_laws]
    common = periods[0] if periods else scene.duration
    for law in sampled_laws:
        common = _common_divisor(common, law.period)
        if common < min(MIN_COMMON_DIVISOR, *periods) * (1.0 - 1e-9):
            needed = f"a common divisor of at least {MIN_COMMON_DIVISOR:g} s with "
            needed += f"the output period of {scene.output_period:.9g} s and other periods"
            raise OptionError(f"period of joint {law.joint!r}", law.period, needed)
    # the default
    if timestep is None:
        return _equal_steps(common, TIMESTEP).size
    # checks of a given step
    is_number = isinstance(timestep, Real) and not isinstance(timestep, bool)
    if not is_number or not 0.0 < float(timestep) < np.inf:
        raise OptionError("timestep", timestep, "a positive number of seconds")
    step = float(timestep)
    if scene.duration / step > MAX_FIXED_STEPS:
        least = f"at least {scene.duration / MAX_FIXED_STEPS:.3g} s, {MAX_FIXED_STEPS} steps"
        raise OptionError("timestep", timestep, least)
    # lengths that the step must divide, and their names in the message
    lengths = [(float(interval), "between outputs") for interval in np.diff(scene.times)]
    lengths += [(law.period, f"period of joint {law.joint!r}") for law in sampled_laws]
    for length, what in lengths:
        if _equal_steps(length, step).size != step:
            divisor = _equal_steps(_common_divisor(common, length), step).size
            needed = f"a divisor of the {length:.9g} s {what}, such as {divisor:.9g}"
            raise OptionError("timestep", timestep, needed)
    return step


def _checked_solref(solref: Sequence[float], timestep: float) -> tuple[float, float]:
    """Return `solref` as two numbers; raises `OptionError` for values that MuJoCo does not apply exactly."""
    needed = (
        f"a time constant of two time steps ({2.0 * timestep:g} s) or more and a positive damping "
        "ratio, or two negative numbers (stiffness and damping)"
    )
    try:
        first, second = (float(value) for value in solref)
    except (TypeError, ValueError) as error:
        raise OptionError("solref", solref, needed) from error
    # time constant and damping ratio; MuJoCo silently raises a shorter time constant to two time steps
    min_time_constant = 2.0 * timestep * (1.0 - 1e-12)
    is_standard = min_time_constant <= first < np.inf and 0.0 < second < np.inf
    # stiffness and damping, as negative numbers
    is_direct = -np.inf < first < 0.0 and -np.inf < second < 0.0
    if not (is_standard or is_direct):
        raise OptionError("solref", solref, needed)
    return first, second


class Output(NamedTuple):
    """State at an output time.

    Attributes:
        system: compiled scene; set-points that jump, and forces of sampled controllers, have their values
            right after the output time.
        q: (nq,) tree coordinates.
        v: (nv,) tree velocities.
        step: time step before the output, s.
        work: work of forces without potential since the start, J; None if the scene does not track work.
    """

    system: SoftMuJoCo
    q: Array
    v: Array
    step: float
    work: float | None


def _run(
    system: SoftMuJoCo,
    plan: list[tuple[Interval, list[Steps]]],
    solref: tuple[float, float] | None,
    mjx_steps: MjxSteps | None,
) -> tuple[list[Output], StoppedError | None]:
    """Run all intervals.

    Args:
        system: compiled scene.
        plan: intervals with their steps, see `simulate`.
        solref: see `simulate`.
        mjx_steps: takes the steps by MJX; None if they are taken in C.

    Returns:
        The outputs reached, and the error that stopped the run, or None.
    """
    import mujoco

    # initial state; `layout` maps between tree coordinates and qpos, qvel
    model, data, layout = system.model, system.data, system.layout
    q, v = system.coordinates(initial_state(system.scene))
    system.set_state(q, v)
    _, first_steps = plan[0]
    step_size = first_steps[0].size
    work = 0.0 if system.scene.tracks_work else None
    outputs: list[Output] = []
    controllers = Controllers(system.scene)

    def record() -> None:
        """Store the present state of MuJoCo as an output."""
        q, v = layout.to_qpos.T @ data.qpos, layout.to_qvel.T @ data.qvel
        outputs.append(Output(system, q, v, step_size, work))

    # values of the scene that change between intervals, by name: the present pieces of set-points that jump,
    # and the forces of sampled controllers
    original, held_values = system, dict[str, Any]()
    with collected_warnings(data) as warnings:
        for interval, steps in plan:
            held_values |= pieces(original.scene, interval.middle, include_smooth=False)
            if interval.due:  # controllers that take a sample at the beginning of the interval
                try:
                    readings = np.array([*system.readings(data).values()])
                    held_values |= controllers.sample(interval.due, float(interval.times[0]), readings)
                except IntegrationError as error:
                    return outputs, error
            if held_values:
                system = with_held_values(original, held_values)  # a copy that shares `model` and `data`
                system.set_controls()
            if interval.is_output[0]:
                record()
            # steps to each time of the interval; `wanted` is True for output times, except at the end, where
            # the next interval records the output. In the context, MuJoCo calls back for controls, wind and
            # motions that depend on time.
            with system.following():
                for (number, step_size), wanted in zip(steps, interval.is_output[1:], strict=True):
                    system.use_step(step_size, solref)
                    if mjx_steps is not None:
                        mjx_steps.advance(number)
                    elif work is None:
                        mujoco.mj_step(model, data, number)
                    else:
                        work += system.step_with_work(number, warnings)
                    # MuJoCo checks only the state before each step
                    mujoco.mj_checkPos(model, data)
                    mujoco.mj_checkVel(model, data)
                    if warnings:  # MuJoCo resets a diverged run to its initial state
                        warning, time_of_warning = next(iter(warnings.items()))
                        return outputs, _divergence(warning, time_of_warning, outputs)
                    if wanted:
                        record()
    return outputs, None


def _divergence(warning: str, time: float, outputs: Sequence[Output]) -> DivergenceError:
    """Return the error of a diverged run, with the fastest joint and the largest force at the last output.

    Frictions that have jammed are the reason, if there are any.

    Args:
        warning: MuJoCo's warning, of which only the first sentence is kept.
        time: s, when MuJoCo warned.
        outputs: outputs of the run; the first is at the start.
    """
    last = outputs[-1]
    scene, state = last.system.scene, last.system.state(last.q, last.v)
    friction = partial(last.system.loaded_friction, last.q, last.v)
    force_inputs = surroundings(scene, state, time)._replace(friction=friction)
    reason = jam(scene, friction, [last.q, last.v]) or warning.partition(". ")[0]
    return DivergenceError(time, with_likely_causes(scene, state, reason, force_inputs))
