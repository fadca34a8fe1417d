"""Scene in, Trajectory out, by MuJoCo's own time stepping."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import numpy as np

from mjcf.errors import DivergenceError, OptionError
from mjcf.write import SOLIMP, TIMESTEP
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
    timestep: float = TIMESTEP,
    integrator: str = "RK4",
    solref: Sequence[float] | None = None,
) -> Trajectory:
    """Run a scene in MuJoCo, with soft constraints and native actuators.

    Reactions at an output are those of MuJoCo's forward dynamics in that state.

    Args:
        scene: what to run.
        timestep: s; must divide the time between outputs.
        integrator: one of `INTEGRATORS`.
        solref: of the loop closures: time constant (s) and damping ratio, (2 timestep, 1) if not
            given, which is as stiff as MuJoCo allows; or stiffness and damping, both negative.

    Raises:
        MjcfError: for an impossible option, a scene that MuJoCo refuses, or a run that diverges.
    """
    counts = _steps_between(scene.times, timestep)
    if integrator not in INTEGRATORS:
        raise OptionError("integrator", integrator, INTEGRATORS)
    stiffness = (2.0 * timestep, 1.0) if solref is None else _checked_solref(solref, timestep)

    import mujoco

    from mjcf.soft import SoftMuJoCo

    system = SoftMuJoCo(scene)
    options = system.model.opt
    options.timestep = timestep
    options.integrator = getattr(mujoco.mjtIntegrator, f"mjINT_{integrator.upper()}")
    system.model.eq_solref[:] = stiffness

    start = time.perf_counter()
    states = _run(system, counts)
    wall_time = time.perf_counter() - start
    settings = {
        "timestep": timestep,
        "integrator": integrator,
        "solref": list(stiffness),
        "solimp": list(SOLIMP),
        "steps": sum(counts),
    }
    evaluations = [system.evaluate(q, v) for q, v in states]
    return trajectory_from(scene, "mujoco", settings, wall_time, evaluations)


def _steps_between(times: Array, timestep: float) -> list[int]:
    """How many steps lie between one output and the next."""
    if not isinstance(timestep, int | float) or not 0.0 < timestep < np.inf:
        raise OptionError("timestep", timestep, "a positive number of seconds")
    counts = []
    for interval in np.diff(times):
        count = round(interval / timestep)
        if abs(count * timestep - interval) > 1e-9 * interval:
            fitting = interval / np.ceil(interval / timestep)
            raise OptionError(
                "timestep",
                timestep,
                f"a divisor of the {interval:.9g} s between outputs, such as {fitting:.9g}",
            )
        counts.append(count)
    return counts


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


def _run(system: SoftMuJoCo, counts: list[int]) -> list[tuple[Array, Array]]:
    """Tree coordinates and velocities at all outputs."""
    import mujoco

    model, data = system.model, system.data
    q, v = system.coordinates(system.scene.initial_state)
    system.place(q, v)
    rows = [(data.qpos.copy(), data.qvel.copy())]
    with _collected_warnings(data) as warnings:
        for count in counts:
            mujoco.mj_step(model, data, count)
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
