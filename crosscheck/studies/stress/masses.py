"""(f) Masses that are far apart, and inertias that a rigid body can only just have."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from crosscheck.scenes import load
from crosscheck.studies.stress.cases import Bound, Case, Curve, Measured
from crosscheck.studies.stress.runs import (
    ONE_EACH,
    Setting,
    energy_errors,
    lasting,
    mujoco,
    newton_euler,
    parallelogram_error,
    symmetric_top,
    top_error,
)
from newton_euler.model.mechanism import Body, Mechanism
from newton_euler.model.scene import Scene

RATIOS = (1e-8, 1e-4, 1.0, 1e4, 1e8)
"""Mass of the coupler by the mass of the bars; of the last rod of a chain by that of the first."""

SETTINGS = (
    *ONE_EACH,
    newton_euler("relative", "baumgarte"),
    newton_euler("cartesian", "baumgarte"),
    mujoco("implicitfast"),
)

ANGLE = Bound(1e-6, 1e-2, "no plot would show less; half a degree can be seen")
ENERGY = Bound(1e-6, 1e-2, "no plot would show less; more than a hundredth is another motion")

INERTIAS = {
    "thin rod, A = 1e-8 C": (1e-8, 1.0),
    "thin rod, A = 1e-4 C": (1e-4, 1.0),
    "plate, A + B = C": (2.0, 1.0),
    "plate, A + B = C (1 + 1e-9)": (2.0 - 1e-9, 1.0),
}
"""Axial and transverse moments, kg m^2."""

SPIN = np.array([0.3, -0.7, 1.1])
"""rad/s."""


def cases(full: bool) -> list[Case]:
    """All of (f)."""
    made = []
    for ratio in RATIOS if full else (1e-8, 1.0, 1e8):
        for setting in SETTINGS if full else ONE_EACH:
            for name, quantity, unit, bound, measure in (
                ("four_bar N = 1, 0.5 s, coupler/bar", "angle error", "rad", ANGLE, measure_loop),
                ("chain of 2, 2 s, last/first", "energy error", "rel", ENERGY, measure_chain),
            ):
                what = f"{name} = {ratio:.0e}"
                run = partial(measure, ratio, setting)
                made.append(
                    Case("f", what, setting.engine, str(setting), quantity, unit, bound, run, limit=20.0)
                )
    duration = 10.0 if full else 2.0
    for name in INERTIAS:
        for setting in ONE_EACH:
            run = partial(measure_inertia, name, setting, duration)
            what = f"free top, {duration:g} s, {name}"
            made.append(Case("f", what, setting.engine, str(setting), "angle error", "rad", ANGLE, run))
    return made


def _heavier(body: Body, factor: float) -> Body:
    return replace(body, mass=body.mass * factor, inertia=body.inertia * factor)


def _changed(scene: Scene, factors: dict[str, float]) -> Scene:
    """The scene with the mass and inertia of some bodies times a factor."""
    bodies = [_heavier(body, factors.get(body.name, 1.0)) for body in scene.mechanism.bodies]
    return replace(scene, mechanism=Mechanism(bodies, scene.mechanism.joints))


def measure_loop(ratio: float, setting: Setting) -> Measured:
    """A window of four bars, which never lie flat in this time, against its closed motion."""
    scene = lasting(_changed(load("four_bar", N=1), {"coupler_0": ratio}), 0.5, 10)
    error = parallelogram_error(scene, setting.simulate(scene))
    return Measured(error, curves=(_curve("window of four bars", "angle error, rad", ratio, error, setting),))


def measure_chain(ratio: float, setting: Setting) -> Measured:
    """Two rods in a row, falling."""
    chain = load("chain", N=2)
    last = chain.mechanism.body_names[-1]
    scene = lasting(_changed(chain, {last: ratio}), 2.0, 20, "energy", "velocities")
    error = float(np.max(energy_errors(scene, setting.simulate(scene))))
    return Measured(error, curves=(_curve("chain of two", "energy error, rel", ratio, error, setting),))


def _curve(title: str, y_label: str, ratio: float, error: float, setting: Setting) -> Curve:
    label = f"{setting.engine}, {setting}"
    return Curve(f"mass ratio, {title}", "mass ratio", y_label, label, (ratio,), (max(error, 1e-18),))


def measure_inertia(name: str, setting: Setting, duration: float) -> Measured:
    """A free symmetric top against its closed form."""
    scene = symmetric_top(*INERTIAS[name], SPIN, duration)
    return Measured(top_error(scene, setting.simulate(scene)))
