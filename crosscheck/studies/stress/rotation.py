"""Stress cases (i): rotation through pi and 2 pi, by many turns, and at high speeds."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import numpy as np

from crosscheck.library import REFERENCE_QUANTITIES, load
from crosscheck.library.references import reference_values
from crosscheck.studies.stress.cases import ANGLE_BOUND, ENERGY_BOUND, Bound, Case, Measurement, of_run
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
from newton_euler.compiled.formulations import FORMULATIONS
from newton_euler.model.control import PD
from newton_euler.model.joint_kinds import Revolute
from newton_euler.model.mechanism import Body, Mechanism
from newton_euler.model.scene import OutputName, Scene
from newton_euler.model.trajectory import Trajectory

SPIN_DIRECTION = np.array([0.3, -0.7, 1.1]) / np.linalg.norm([0.3, -0.7, 1.1])

SPIN_SPEEDS = (1.0, 1e2, 1e3, 1e4)
"""rad/s, angular speeds of free tops, for 1 s."""

HINGE_TURNS = (0.499, 0.5, 0.501, 1.0, 10.0, 1e3)

TORQUE_BOUND = Bound(
    "torque error", "rel", 1e-6, 1e-2, "1e-6 is invisible in a plot; a miscounted turn gives far more"
)
REFERENCE_BOUND = Bound("largest error", "SI", 1e-6, 1e-2, "1e-6 is invisible in a plot; 1 % is visible")

FIXED_STEP_SETTINGS: tuple[Setting, ...] = (
    *(newton_euler(form, integrator="Euler", step=step) for form in FORMULATIONS for step in (1e-3, 1e-4)),
    newton_euler("relative", integrator="RK4", step=1e-3),
    newton_euler("cartesian", integrator="RK4", step=1e-3),
    mujoco("Euler"),
    mujoco("implicitfast"),
    mujoco("RK4"),
)
"""Fixed steps of 0.1 or 0.01 rad at `FIXED_STEP_SPEED`."""

FIXED_STEP_SPEED = 100.0
"""rad/s."""

HINGE_STIFFNESS, HINGE_DAMPING = 100.0, 20.0
"""N m/rad and N m s/rad, critical damping of 1 kg m^2: x = X (1 - (1 + 10 t) exp(-10 t))."""


def cases(full: bool) -> Iterator[Case]:
    """Yield the cases of (i)."""
    tops = (*COMBINATIONS, newton_euler(integrator="Radau", rtol=1e-8, atol=1e-10)) if full else ONE_EACH[:2]
    slow = 0.1 if full else 0.02
    for speed in SPIN_SPEEDS if full else SPIN_SPEEDS[::3]:
        quick = (mujoco("RK4", 0.1 / speed),) if speed > 100.0 else ()
        for setting in (*tops, mujoco(), *quick, pinocchio()):
            duration = slow if setting.engine == "pinocchio" and speed > 1e3 else 1.0
            turns = speed * duration / (2.0 * np.pi)
            name = f"free symmetric top, {speed:g} rad/s, {turns:.3g} turns"
            yield Case(
                name, setting, ANGLE_BOUND, partial(of_run, top(speed, duration), orientation), limit=40.0
            )
    for setting in FIXED_STEP_SETTINGS:
        name = f"free symmetric top, {FIXED_STEP_SPEED:g} rad/s, 1 s, fixed steps"
        yield Case(name, setting, ENERGY_BOUND, partial(of_run, top(FIXED_STEP_SPEED, 1.0), kinetic_energy))
    for turns in HINGE_TURNS if full else HINGE_TURNS[1::2]:
        for setting in ONE_EACH:
            name = f"hinge turned {turns:g} times by PD, 3 s"
            yield Case(name, setting, TORQUE_BOUND, partial(of_run, driven_hinge(turns), torque_of_hinge))
    for setting in (*ONE_EACH, TIGHT):
        measure = partial(of_run, load("heavy_top"), reference_error)
        yield Case("heavy_top, 150 rad/s, reference values", setting, REFERENCE_BOUND, measure)


def top(speed: float, duration: float) -> Scene:
    """Return a free symmetric top with moments of inertia of 1 (axial) and 2 kg m^2 (transverse)."""
    return symmetric_top(1.0, 2.0, speed * SPIN_DIRECTION, duration)


def orientation(scene: Scene, run: Trajectory) -> Measurement:
    """Measure the error of the orientation relative to the closed form."""
    return Measurement(top_error(scene, run), f"{run.settings['steps']} steps")


def kinetic_energy(scene: Scene, run: Trajectory) -> Measurement:
    """Measure the relative change of the kinetic energy, which is constant."""
    energy = run.kinetic_energy
    assert energy is not None
    error = float(np.max(np.abs(energy / energy[0] - 1.0)))
    return Measurement(error, f"orientation error {top_error(scene, run):.1e} rad")


def driven_hinge(turns: float) -> Scene:
    """Return a wheel of 1 kg m^2 on a hinge, driven from rest to a number of turns by PD control."""
    wheel = Body("wheel", 1.0, np.zeros(3), np.diag([0.6, 0.6, 1.0]))
    hinge = Revolute("hinge", "ground", "wheel", np.zeros(3), axis=np.array([0.0, 0.0, 1.0]), actuated=True)
    law = PD("hinge", HINGE_STIFFNESS, HINGE_DAMPING, 2.0 * np.pi * turns)
    names: frozenset[OutputName] = frozenset({"actuation", "velocities"})
    return Scene(
        "hinge", Mechanism([Body.ground(), wheel], [hinge]), 3.0, 0.05, control=(law,), outputs=names
    )


def torque_of_hinge(scene: Scene, run: Trajectory) -> float:
    """Measure the error of the actuator torque, relative to the largest; it shows whether turns are
    counted."""
    assert run.actuator_force is not None
    (law,) = scene.control
    assert isinstance(law, PD)
    assert isinstance(law.target, float)
    t = scene.times
    torque = law.target * np.exp(-10.0 * t) * (HINGE_STIFFNESS * (1.0 + 10.0 * t) - HINGE_DAMPING * 100.0 * t)
    return float(np.max(np.abs(run.actuator_force[:, 0] - torque))) / (HINGE_STIFFNESS * law.target)


def reference_error(scene: Scene, run: Trajectory) -> Measurement:
    """Measure the largest error of the heavy top's reference values, SI."""
    errors = []
    for known in reference_values("heavy_top"):
        at = int(np.argmin(np.abs(run.time - known.time)))
        off = abs(float(REFERENCE_QUANTITIES["heavy_top"][known.quantity](run)[at]) - known.value)
        errors.append((off, f"{known.quantity} at t = {known.time:g} s"))
    return Measurement(*max(errors))
