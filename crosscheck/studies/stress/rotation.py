"""(i) Rotation by many turns, through pi and 2 pi, and at high speeds."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import numpy as np

from crosscheck.references import known_figures
from crosscheck.scenes import FIGURES, load
from crosscheck.studies.stress.cases import ANGLE, ENERGY, Bound, Case, Measured
from crosscheck.studies.stress.runs import (
    COMBINATIONS,
    ONE_EACH,
    TIGHT,
    Setting,
    mujoco,
    newton_euler,
    pinocchio,
    symmetric_top,
    top_error,
)
from newton_euler.integrators.compiled import FORMULATIONS
from newton_euler.model.control import PD
from newton_euler.model.joint_kinds import Revolute
from newton_euler.model.mechanism import Body, Mechanism
from newton_euler.model.scene import Scene

DIRECTION = np.array([0.3, -0.7, 1.1]) / np.linalg.norm([0.3, -0.7, 1.1])

SPEEDS = (1.0, 1e2, 1e3, 1e4)
"""rad/s, for 1 s."""

TURNS = (0.499, 0.5, 0.501, 1.0, 10.0, 1e3)

TORQUE = Bound("torque error", "rel", 1e-6, 1e-2, "no plot would show less; a turn miscounted is far more")
KNOWN = Bound("largest error", "SI", 1e-6, 1e-2, "no plot would show less; a hundredth can be seen")

FIXED: tuple[Setting, ...] = (
    *(newton_euler(form, integrator="Euler", step=step) for form in FORMULATIONS for step in (1e-3, 1e-4)),
    newton_euler("relative", integrator="RK4", step=1e-3),
    newton_euler("cartesian", integrator="RK4", step=1e-3),
    mujoco("Euler"),
    mujoco("implicitfast"),
    mujoco("RK4"),
)
"""Steps of a tenth or a hundredth of a radian at `FAST`."""

FAST = 100.0
"""rad/s."""

STIFFNESS, DAMPING = 100.0, 20.0
"""N m/rad and N m s/rad, critical for a moment of inertia of 1 kg m^2: x = X (1 - (1 + 10 t) exp(-10 t))."""


def cases(full: bool) -> Iterator[Case]:
    """Yield the cases of (i)."""
    tops = (*COMBINATIONS, newton_euler(integrator="Radau", rtol=1e-8, atol=1e-10)) if full else ONE_EACH[:2]
    slow = 0.1 if full else 0.02
    for speed in SPEEDS if full else SPEEDS[::3]:
        quick = (mujoco("RK4", 0.1 / speed),) if speed > 100.0 else ()
        for setting in (*tops, mujoco(), *quick, pinocchio()):
            duration = slow if setting.engine == "pinocchio" and speed > 1e3 else 1.0
            turns = speed * duration / (2.0 * np.pi)
            name = f"free symmetric top, {speed:g} rad/s, {turns:.3g} turns"
            yield Case(name, setting, ANGLE, partial(measure_top, speed, duration), limit=40.0)
    for setting in FIXED:
        yield Case(
            f"free symmetric top, {FAST:g} rad/s, 1 s, fixed steps", setting, ENERGY, measure_top_energy
        )
    for turns in TURNS if full else TURNS[1::2]:
        for setting in ONE_EACH:
            name = f"hinge turned {turns:g} times by PD, 3 s"
            yield Case(name, setting, TORQUE, partial(measure_hinge, turns))
    for setting in (*ONE_EACH, TIGHT):
        yield Case("heavy_top, 150 rad/s, known figures", setting, KNOWN, measure_heavy_top)


def measure_top(speed: float, duration: float, setting: Setting) -> Measured:
    """Orientation against the closed form."""
    scene = symmetric_top(1.0, 2.0, speed * DIRECTION, duration)
    run = setting.simulate(scene)
    return Measured(top_error(scene, run), f"{run.settings['steps']} steps")


def measure_top_energy(setting: Setting) -> Measured:
    """The energy, which nothing changes."""
    scene = symmetric_top(1.0, 2.0, FAST * DIRECTION, 1.0)
    run = setting.simulate(scene)
    energy = run.kinetic_energy
    assert energy is not None
    error = float(np.max(np.abs(energy / energy[0] - 1.0)))
    return Measured(error, f"orientation off by {top_error(scene, run):.1e} rad")


def driven_hinge(turns: float) -> Scene:
    """A wheel of 1 kg m^2 on a hinge, drawn to that many turns from rest."""
    wheel = Body("wheel", 1.0, np.zeros(3), np.diag([0.6, 0.6, 1.0]))
    hinge = Revolute("hinge", "ground", "wheel", np.zeros(3), axis=np.array([0.0, 0.0, 1.0]), actuated=True)
    law = PD("hinge", STIFFNESS, DAMPING, 2.0 * np.pi * turns)
    names = frozenset({"actuation", "velocities"})
    return Scene(
        "hinge", Mechanism([Body.ground(), wheel], [hinge]), 3.0, 0.05, control=(law,), outputs=names
    )


def measure_hinge(turns: float, setting: Setting) -> Measured:
    """The torque, by which one sees whether turns are counted, of the largest."""
    scene = driven_hinge(turns)
    run = setting.simulate(scene)
    assert run.actuator_force is not None
    target, t = 2.0 * np.pi * turns, scene.times
    torque = target * np.exp(-10.0 * t) * (STIFFNESS * (1.0 + 10.0 * t) - DAMPING * 100.0 * t)
    return Measured(float(np.max(np.abs(run.actuator_force[:, 0] - torque))) / (STIFFNESS * target))


def measure_heavy_top(setting: Setting) -> Measured:
    """The largest error of any figure that is known, lengths in m and so on."""
    run = setting.simulate(load("heavy_top"))
    errors = []
    for known in known_figures("heavy_top"):
        at = int(np.argmin(np.abs(run.time - known.time)))
        off = abs(float(FIGURES["heavy_top"][known.quantity](run)[at]) - known.value)
        errors.append((off, f"{known.quantity} at t = {known.time:g} s"))
    return Measured(*max(errors))
