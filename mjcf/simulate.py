"""Scene in, Trajectory out, by MuJoCo's own time stepping."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from numbers import Real
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from mjcf.errors import DivergenceError
from mjcf.write import SOLIMP, TIMESTEP
from newton_euler.errors import OptionError, UnknownNameError
from newton_euler.scalars import Array
from newton_euler.scene import Scene
from newton_euler.simulate import trajectory_from
from newton_euler.trajectory import Trajectory

if TYPE_CHECKING:
    from mjcf.soft import SoftMuJoCo

INTEGRATORS = ("RK4", "Euler", "implicit", "implicitfast")
"""MuJoCo's integrators by the names that MJCF gives them."""


def simulate(
    scene: Scene,
    timestep: float | None = None,
    integrator: str = "RK4",
    solref: Sequence[float] | None = None,
) -> Trajectory:
    """Run a scene in MuJoCo, with soft constraints and native actuators.

    Reactions at an output are those of MuJoCo's forward dynamics in that state.

    Args:
        scene: what to run.
        timestep: s; must divide the time between outputs. If not given, the largest of at most 1 ms
            that does, and for a last output out of period the largest of at most that.
        integrator: one of `INTEGRATORS`.
        solref: of the loop closures: time constant (s) and damping ratio, (2 timestep, 1) if not
            given, which is as stiff as MuJoCo allows; or stiffness and damping, both negative.

    Raises:
        NewtonEulerError: for an unknown name or an impossible option; `MjcfError` for a scene that
            MuJoCo refuses, or a run that diverges.
    """
    steps = _steps_between(scene.times, timestep)
    largest = max(step.size for step in steps)
    if integrator not in INTEGRATORS:
        raise UnknownNameError("integrator", integrator, INTEGRATORS)
    stiffness = None if solref is None else _checked_solref(solref, largest)

    import mujoco

    from mjcf.soft import SoftMuJoCo

    system = SoftMuJoCo(scene)
    system.model.opt.integrator = getattr(mujoco.mjtIntegrator, f"mjINT_{integrator.upper()}")

    start = time.perf_counter()
    states = _run(system, steps, stiffness)
    wall_time = time.perf_counter() - start
    settings: dict[str, Any] = {
        "timestep": largest,
        "integrator": integrator,
        "solref": list(stiffness or _stiffest(largest)),
        "solimp": list(SOLIMP),
        "steps": sum(step.number for step in steps),
    }
    if steps[-1].size != largest:
        settings["last_timestep"] = steps[-1].size
    evaluations = []
    for (q, v), step in zip(states, [steps[0], *steps], strict=True):
        _use(system.model, step.size, stiffness)
        evaluations.append(system.evaluate(q, v))
    return trajectory_from(scene, "mujoco", settings, wall_time, evaluations)


class Steps(NamedTuple):
    """Equal steps from one output to the next."""

    number: int
    size: float
    """s"""


def _fitting(interval: float, largest: float) -> Steps:
    """The fewest steps of at most `largest` that make up an interval; of just that if it divides it."""
    number = max(1, int(np.ceil(interval / largest * (1.0 - 1e-9))))
    divides = abs(number * largest - interval) <= 1e-9 * interval
    return Steps(number, largest if divides else interval / number)


def _steps_between(times: Array, timestep: float | None) -> list[Steps]:
    """The steps between each output and the next; an explicit `timestep` (s) is taken or refused."""
    intervals = [float(interval) for interval in np.diff(times)]
    if timestep is None:
        regular = _fitting(intervals[0], TIMESTEP).size
        return [_fitting(interval, regular) for interval in intervals]
    is_number = isinstance(timestep, Real) and not isinstance(timestep, bool)
    if not is_number or not 0.0 < float(timestep) < np.inf:
        raise OptionError("timestep", timestep, "a positive number of seconds")
    steps = [_fitting(interval, float(timestep)) for interval in intervals]
    for step, interval in zip(steps, intervals, strict=True):
        if step.size != float(timestep):
            raise OptionError(
                "timestep",
                timestep,
                f"a divisor of the {interval:.9g} s between outputs, such as {step.size:.9g}",
            )
    return steps


def _stiffest(timestep: float) -> tuple[float, float]:
    """The stiffest solref that MuJoCo allows: a time constant of two steps, critical damping."""
    return 2.0 * timestep, 1.0


def _use(model: Any, timestep: float, solref: tuple[float, float] | None) -> None:
    """Give a model its step, and constraints as stiff as the step allows if no solref is given."""
    model.opt.timestep = timestep
    model.eq_solref[:] = solref or _stiffest(timestep)


def _checked_solref(solref: Sequence[float], timestep: float) -> tuple[float, float]:
    needed = (
        f"a time constant of two time steps ({2.0 * timestep:g} s) or more and a positive damping "
        "ratio, or two negative numbers (stiffness and damping)"
    )
    try:
        first, second = (float(value) for value in solref)
    except (TypeError, ValueError) as error:
        raise OptionError("solref", solref, needed) from error
    # MuJoCo would raise a shorter time constant to two time steps without a word
    lowest = 2.0 * timestep * (1.0 - 1e-12)
    standard = lowest <= first < np.inf and 0.0 < second < np.inf
    direct = -np.inf < first < 0.0 and -np.inf < second < 0.0
    if not (standard or direct):
        raise OptionError("solref", solref, needed)
    return first, second


def _run(
    system: SoftMuJoCo, steps: list[Steps], solref: tuple[float, float] | None
) -> list[tuple[Array, Array]]:
    """Tree coordinates and velocities at all outputs."""
    import mujoco

    model, data = system.model, system.data
    q, v = system.coordinates(system.scene.initial_state)
    system.place(q, v)
    rows = [(data.qpos.copy(), data.qvel.copy())]
    with _collected_warnings(data) as warnings:
        for number, size in steps:
            _use(model, size, solref)
            mujoco.mj_step(model, data, number)
            # a step checks the state that it starts from
            mujoco.mj_checkPos(model, data)
            mujoco.mj_checkVel(model, data)
            if warnings:  # after one MuJoCo starts again from its initial state
                raise DivergenceError(*warnings[0])
            rows.append((data.qpos.copy(), data.qvel.copy()))
    layout = system.layout
    return [(layout.to_qpos.T @ qpos, layout.to_qvel.T @ qvel) for qpos, qvel in rows]


@contextmanager
def _collected_warnings(data: Any) -> Iterator[list[tuple[float, str]]]:
    """MuJoCo's warnings with their times, instead of on the terminal and in a file of its own."""
    import mujoco

    collected: list[tuple[float, str]] = []
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(lambda message: collected.append((data.time, " ".join(message.split()))))
    try:
        yield collected
    finally:
        mujoco.set_mju_user_warning(before)
