"""(h) Singular configurations: through them, from them, and to the ends of travel."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from crosscheck.scenes import load
from crosscheck.stress.runs import (
    COMBINATIONS,
    ONE_EACH,
    Setting,
    energy_errors,
    largest_drift,
    lasting,
    mujoco,
    newton_euler,
    parallelogram_error,
    pinocchio,
)
from crosscheck.stress.topics import Bound, Case, Measured
from newton_euler.control import PD
from newton_euler.scene import Scene
from newton_euler.state import State

ANGLE = Bound(1e-6, 1e-2, "no plot would show less; half a degree can be seen")
ENERGY = Bound(1e-6, 1e-2, "no plot would show less; more than a hundredth is another motion")

WINDOWS = (1, 2, 10)

FLAT_SPEED = 4.0
"""Of the bars where they start flat, rad/s."""

SETTINGS: tuple[Setting, ...] = (
    *COMBINATIONS,
    newton_euler("relative", integrator="Radau", rtol=1e-8, atol=1e-10),
    newton_euler("relative", integrator="RK4", step=1e-3),
    mujoco("RK4"),
    mujoco("implicitfast"),
    pinocchio(),
    pinocchio(stabilization="projection"),
)

TARGETS = (-0.2, 0.2)
"""m from the initial pose; the sliders travel less than half as far."""


def cases(full: bool) -> list[Case]:
    """All of (h)."""
    made = []
    for windows in WINDOWS if full else WINDOWS[:2]:
        for setting in SETTINGS if full and windows < 10 else ONE_EACH:
            for name, measure in (
                ("four_bar N = {}, 5 s, through flat bars", measure_passing),
                ("four_bar N = {}, 2 s, from flat bars", measure_starting),
            ):
                what = name.format(windows)
                run = partial(measure, windows, setting)
                limit = 12.0 if full else 8.0
                made.append(
                    Case(
                        "h", what, setting.engine, str(setting), "angle error", "rad", ANGLE, run, limit=limit
                    )
                )
    for target in TARGETS:
        for setting in SETTINGS if full else ONE_EACH:
            what = f"tracker, 2 s, drawn to {target:+g} m, past its dead centres"
            run = partial(measure_dead_centre, target, setting)
            made.append(
                Case("h", what, setting.engine, str(setting), "energy error", "rel", ENERGY, run, limit=20.0)
            )
    return made


def measure_passing(windows: int, setting: Setting) -> Measured:
    """Against the closed motion, over about six passages."""
    scene = lasting(load("four_bar", N=windows), 5.0, 100, "violation")
    run = setting.simulate(scene)
    return Measured(parallelogram_error(scene, run), f"drift {largest_drift(run):.1e} m or rad")


def measure_starting(windows: int, setting: Setting) -> Measured:
    """The same from bars that lie flat to the right and move down."""
    scene = from_flat(lasting(load("four_bar", N=windows), 2.0, 50, "violation"), windows)
    run = setting.simulate(scene)
    return Measured(parallelogram_error(scene, run), f"drift {largest_drift(run):.1e} m or rad")


def from_flat(scene: Scene, windows: int) -> Scene:
    """Windows of four bars whose bars lie flat at first."""
    x, y, z = np.eye(3)
    state = State.initial(scene.mechanism)
    bars, couplers = slice(1, windows + 2), slice(windows + 2, None)
    state.position[bars] += 0.5 * (x - y)
    state.quaternion[bars] = [np.sqrt(0.5), 0.0, 0.0, -np.sqrt(0.5)]
    state.position[couplers] += x - y
    state.linear_velocity[bars] = -0.5 * FLAT_SPEED * y
    state.angular_velocity[bars] = -FLAT_SPEED * z
    state.linear_velocity[couplers] = -FLAT_SPEED * y
    return replace(scene, initial_state=state)


def measure_dead_centre(target: float, setting: Setting) -> Measured:
    """Both sliders are drawn further than the mechanism reaches; it swings to and fro at its ends."""
    scene = load("tracker")
    control = tuple(replace(law, target=target) for law in scene.control if isinstance(law, PD))
    scene = lasting(replace(scene, control=control), 2.0, 100, "violation", "energy", "velocities")
    run = setting.simulate(scene)
    travel = run.position[:, 1:3, 2] - run.position[0, 1:3, 2]
    note = f"sliders travel {travel.min():+.3f} to {travel.max():+.3f} m; drift {largest_drift(run):.1e}"
    return Measured(float(np.max(energy_errors(scene, run))), note)
