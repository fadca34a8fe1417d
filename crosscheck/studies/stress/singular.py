"""(h) Singular configurations: through them, from them, and to the ends of travel."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from crosscheck.scenes import load
from crosscheck.studies.stress.cases import Bound, Case, Measured
from crosscheck.studies.stress.runs import (
    COMBINATIONS,
    GRAVITY,
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
from newton_euler.model.control import PD
from newton_euler.model.joint_kinds import Prismatic, Revolute, Spherical, Universal
from newton_euler.model.mechanism import Body, Mechanism
from newton_euler.model.motions import Polynomial, PrescribedMotion
from newton_euler.model.scene import Scene
from newton_euler.model.state import State

ANGLE = Bound(1e-6, 1e-2, "no plot would show less; half a degree can be seen")
POSITION = Bound(1e-6, 1e-2, "no plot would show less; a centimetre of 0.4 m of travel can be seen")
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

CRANK, ROD, CRANK_SPEED = 0.2, 0.7, 12.0
"""m, m and rad/s, of `centred_slider_crank`."""

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
                limit = 15.0 if full else 11.0
                made.append(
                    Case(
                        "h", what, setting.engine, str(setting), "angle error", "rad", ANGLE, run, limit=limit
                    )
                )
    for setting in SETTINGS if full else ONE_EACH:
        what = "slider-crank, 2 s, its crank driven through seven dead centres"
        run = partial(measure_dead_centre_passage, setting)
        made.append(
            Case("h", what, setting.engine, str(setting), "position error", "m", POSITION, run, limit=12.0)
        )
    for target in TARGETS:
        for setting in SETTINGS if full else ONE_EACH:
            what = f"tracker, 2 s, drawn to {target:+g} m, past its dead centres"
            run = partial(measure_dead_centre, target, setting)
            made.append(
                Case("h", what, setting.engine, str(setting), "energy error", "rel", ENERGY, run, limit=20.0)
            )
    return made


def centred_slider_crank() -> Scene:
    """A crank of 0.2 m at 12 rad/s about y, a rod of 0.7 m and a slider on x, outstretched at first.

    Crank and rod are in line twice a turn, where the slider comes to rest: dead centres for what drives
    the slider, and regular for what drives the crank.
    """
    x, y, z = np.eye(3)
    pin, wrist = CRANK * x, (CRANK + ROD) * x
    bodies = [
        Body.ground(),
        Body("crank", 1.0, 0.5 * pin, 0.01 * np.eye(3)),
        Body("rod", 2.0, 0.5 * (pin + wrist), 0.05 * np.eye(3)),
        Body("slider", 1.5, wrist, 0.01 * np.eye(3)),
    ]
    joints = [
        Revolute("pivot", "ground", "crank", np.zeros(3), axis=y),
        Spherical("ball", "crank", "rod", pin),
        Universal("wrist", "rod", "slider", wrist, axis_on_first=y, axis_on_second=z),
        Prismatic("guide", "ground", "slider", wrist, axis=x),
    ]
    motion = PrescribedMotion("pivot", Polynomial((0.0, CRANK_SPEED)))
    outputs = frozenset({"violation"})
    mechanism = Mechanism(bodies, joints)
    return Scene("slider_crank", mechanism, 2.0, 0.02, -GRAVITY * z, motions=(motion,), outputs=outputs)


def measure_dead_centre_passage(setting: Setting) -> Measured:
    """The slider against r cos a + sqrt(l^2 - r^2 sin^2 a), over seven dead centres."""
    scene = centred_slider_crank()
    run = setting.simulate(scene)
    angle = CRANK_SPEED * run.time
    wanted = CRANK * np.cos(angle) + np.sqrt(ROD**2 - (CRANK * np.sin(angle)) ** 2)
    error = float(np.max(np.abs(run.position[:, 3, 0] - wanted)))
    return Measured(error, f"drift {largest_drift(run):.1e} m or rad")


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
