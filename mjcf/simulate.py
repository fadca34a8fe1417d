"""Simulate a scene by MuJoCo's own time stepping."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import replace
from numbers import Real
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, get_args

import numpy as np

from mjcf.errors import DivergenceError, collected_warnings
from mjcf.write import SOLIMP, TIMESTEP
from newton_euler.arguments import checked
from newton_euler.equations.applied_forces import surroundings, with_likely_causes
from newton_euler.equations.parameters import pieces
from newton_euler.errors import OptionError, UnknownNameError
from newton_euler.integrators.options import MAX_FIXED_STEPS
from newton_euler.model.scene import Scene
from newton_euler.model.trajectory import IntegrationError, StoppedError, Trajectory
from newton_euler.runs.assemble import initial_state
from newton_euler.runs.controllers import Controllers
from newton_euler.runs.intervals import Interval, intervals, with_held_values
from newton_euler.runs.simulate import trajectory_from
from newton_euler.scalars import Array

if TYPE_CHECKING:
    from mjcf.soft import SoftMuJoCo

MIN_TIMESTEP = 1e-6
"""Smallest time step, s, that is chosen to divide several periods."""

IntegratorName = Literal["RK4", "Euler", "implicit", "implicitfast"]
"""Names of MuJoCo's integrators in MJCF."""

INTEGRATORS: tuple[IntegratorName, ...] = get_args(IntegratorName)


@checked
def simulate(
    scene: Scene,
    timestep: float | None = None,
    integrator: IntegratorName = "RK4",
    solref: Sequence[float] | None = None,
) -> Trajectory:
    """Simulate a scene in MuJoCo, with soft constraints and native actuators, springs and tendons.

    Reactions at an output come from MuJoCo's forward dynamics at that state. If the scene tracks work, the
    work is done by the forces that the steps apply, see `mjcf.soft`.

    Args:
        scene: scene to simulate.
        timestep: s, a divisor of the output period and of the periods of sampled controllers. None means the
            largest divisor up to 1 ms; a shorter last output interval has shorter steps.
        integrator: one of `INTEGRATORS`.
        solref: stiffness of loop closures, couplings and prescribed motions: time constant (s) and damping
            ratio, or stiffness and damping as negative numbers. None means (2 timestep, 1), the stiffest
            constraints that MuJoCo allows.

    Raises:
        NewtonEulerError: for an unknown integrator, an impossible option or a controller that fails.
        MjcfError: for a scene that MuJoCo refuses, or a run that diverges.

    Examples:
        >>> mjcf.simulate(load("pendulum"), timestep=0.001)
        <Trajectory of mujoco: 1001 outputs to 10 s, bodies: 2, joints: 1>
    """
    # steps of all intervals, and options
    wanted = _step(scene, timestep)
    plan = [
        (interval, [_fitting(float(length), wanted) for length in np.diff(interval.times)])
        for interval in intervals(scene, scene.jumps)
    ]
    steps = [step for _, between in plan for step in between]
    largest = max(step.size for step in steps)
    if integrator not in INTEGRATORS:
        raise UnknownNameError("integrator", integrator, INTEGRATORS)
    stiffness = None if solref is None else _checked_solref(solref, largest)

    from mjcf.soft import SoftMuJoCo, stiffest

    system = SoftMuJoCo(scene)
    system.use_integrator(integrator)

    # the run, then the evaluation of its outputs
    start = time.perf_counter()
    states, stopped = _run(system, plan, stiffness)
    wall_time = time.perf_counter() - start
    settings: dict[str, Any] = {
        "timestep": largest,
        "integrator": integrator,
        "solref": list(stiffness or stiffest(largest)),
        "solimp": list(SOLIMP),
        "steps": sum(step.number for step in steps),
    }
    if steps[-1].size != largest:
        settings["last_timestep"] = steps[-1].size
    evaluations, coupled = [], []
    for (system, q, v, size, work), now in zip(states, scene.times, strict=stopped is None):
        system.use_step(size, stiffness)
        system.time = float(now)
        seen = system.evaluate(q, v) if scene.needs_accelerations else system.observe(q, v)
        evaluations.append(replace(seen, work=work))
        coupled.append(system.coupling_phi(q))
    return trajectory_from(scene, "mujoco", settings, wall_time, evaluations, coupled, stopped)


class Steps(NamedTuple):
    """Number and size of the equal steps of one interval."""

    number: int
    size: float
    """Step, s."""


def _fitting(interval: float, largest: float) -> Steps:
    """Divide an interval into the fewest equal steps of at most `largest`, s."""
    number = max(1, int(np.ceil(interval / largest * (1.0 - 1e-9))))
    divides = abs(number * largest - interval) <= 1e-9 * interval
    return Steps(number, largest if divides else interval / number)


def _common_divisor(first: float, second: float) -> float:
    """Return the largest common divisor by Euclid's algorithm; round-off if there is none."""
    round_off = 1e-9 * max(first, second)
    while second > round_off:
        first, second = second, abs(math.remainder(first, second))
    return first


def default_timestep(scene: Scene) -> float:
    """Return the default time step of `simulate` for a scene, s."""
    return _step(scene, None)


def _step(scene: Scene, timestep: float | None) -> float:
    """Return the time step, s: the given `timestep` if it divides all intervals, or the default."""
    repeated = [law for law in scene.sampled if law.period < scene.duration]
    lengths = [scene.output_period] if scene.output_period < scene.duration else []
    lengths += [law.period for law in repeated]
    common = lengths[0] if lengths else scene.duration
    for law in repeated:
        common = _common_divisor(common, law.period)
        if common < min(MIN_TIMESTEP, *lengths) * (1.0 - 1e-9):
            needed = f"a common divisor of at least {MIN_TIMESTEP:g} s with "
            needed += f"the output period of {scene.output_period:.9g} s and other periods"
            raise OptionError(f"period of joint {law.joint!r}", law.period, needed)
    # the default, or checks of a given step
    if timestep is None:
        return _fitting(common, TIMESTEP).size
    is_number = isinstance(timestep, Real) and not isinstance(timestep, bool)
    if not is_number or not 0.0 < float(timestep) < np.inf:
        raise OptionError("timestep", timestep, "a positive number of seconds")
    step = float(timestep)
    if scene.duration / step > MAX_FIXED_STEPS:
        least = f"at least {scene.duration / MAX_FIXED_STEPS:.3g} s, {MAX_FIXED_STEPS} steps"
        raise OptionError("timestep", timestep, least)
    wanted = [(float(interval), "between outputs") for interval in np.diff(scene.times)]
    wanted += [(law.period, f"period of joint {law.joint!r}") for law in repeated]
    for length, what in wanted:
        if _fitting(length, step).size != step:
            fitting = _fitting(_common_divisor(common, length), step).size
            needed = f"a divisor of the {length:.9g} s {what}, such as {fitting:.9g}"
            raise OptionError("timestep", timestep, needed)
    return step


def _checked_solref(solref: Sequence[float], timestep: float) -> tuple[float, float]:
    needed = (
        f"a time constant of two time steps ({2.0 * timestep:g} s) or more and a positive damping "
        "ratio, or two negative numbers (stiffness and damping)"
    )
    try:
        first, second = (float(value) for value in solref)
    except (TypeError, ValueError) as error:
        raise OptionError("solref", solref, needed) from error
    # MuJoCo silently raises a shorter time constant to two time steps
    lowest = 2.0 * timestep * (1.0 - 1e-12)
    standard = lowest <= first < np.inf and 0.0 < second < np.inf
    direct = -np.inf < first < 0.0 and -np.inf < second < 0.0
    if not (standard or direct):
        raise OptionError("solref", solref, needed)
    return first, second


class Output(NamedTuple):
    """State at an output time.

    Attributes:
        system: scene with the controls after the output time.
        q: (nq,) tree coordinates.
        v: (nv,) tree velocities.
        step: s, time step before the output.
        work: J, since the start; None if the scene does not track work.
    """

    system: SoftMuJoCo
    q: Array
    v: Array
    step: float
    work: float | None


def _run(
    system: SoftMuJoCo, plan: list[tuple[Interval, list[Steps]]], solref: tuple[float, float] | None
) -> tuple[list[Output], StoppedError | None]:
    """Run the plan; return the states at the outputs reached, and the error that stopped the run, if any."""
    import mujoco

    model, data, layout = system.model, system.data, system.layout
    q, v = system.coordinates(initial_state(system.scene))
    system.place(q, v)
    size = plan[0][1][0].size
    work = 0.0 if system.scene.tracks_work else None
    rows: list[Output] = []
    controllers = Controllers(system.scene)

    def record() -> None:
        rows.append(Output(system, layout.to_qpos.T @ data.qpos, layout.to_qvel.T @ data.qvel, size, work))

    given, held = system, dict[str, Any]()
    with collected_warnings(data) as warnings:
        for interval, steps in plan:
            held |= pieces(given.scene, interval.middle, smooth=False)
            # controls and set-points of the interval
            if interval.due:
                try:
                    readings = np.array([*system.readings(data).values()])
                    held |= controllers.sample(interval.due, float(interval.times[0]), readings)
                except IntegrationError as error:
                    return rows, error
            if held:
                system = with_held_values(given, held)
                system.actuate()
            if interval.wanted[0]:
                record()
            # steps to the outputs of the interval
            with system.following():
                for (number, size), wanted in zip(steps, interval.wanted[1:], strict=True):
                    system.use_step(size, solref)
                    if work is None:
                        mujoco.mj_step(model, data, number)
                    else:
                        work += system.step_with_work(number, warnings)
                    # each step checks the state before the step
                    mujoco.mj_checkPos(model, data)
                    mujoco.mj_checkVel(model, data)
                    if warnings:  # MuJoCo resets a diverged run to its initial state
                        return rows, _divergence(*next(iter(warnings.items())), rows)
                    if wanted:
                        record()
    return rows, None


def _divergence(warning: str, time: float, rows: Sequence[Output]) -> DivergenceError:
    """Make the error of a diverged run, with the fastest joint and the largest force at the last output.

    Only the first sentence of MuJoCo's warning is kept.
    """
    system, q, v = rows[-1][:3]
    state = system.state(q, v)
    at = surroundings(system.scene, state, time)
    return DivergenceError(time, with_likely_causes(system.scene, state, warning.partition(". ")[0], at))
