"""(e) Stiff gains: control of the tracker's sliders with K_p and K_d up to 1e6."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache, partial

from crosscheck.scenes import load
from crosscheck.studies.stress.cases import Bound, Case, Curve, Measured
from crosscheck.studies.stress.runs import Setting, distance, lasting, mujoco, newton_euler, pinocchio
from newton_euler.model.control import PD
from newton_euler.model.scene import Scene
from newton_euler.model.trajectory import Trajectory

GAINS = ((50.0, 20.0), (1e4, 1e2), (1e6, 1e3), (1e6, 1e6), (1e2, 1e6), (1e6, 1e2))
"""K_p in N/m and K_d in N s/m: the paper's, then stiffer; the last one hardly damped."""

DURATION = 0.5
OUTPUT_PERIOD = 0.01

SHORTER = 0.1
"""s, long enough for what is stiff, if not in full."""

CLOSE = Bound(1e-5, 1e-3, "a hundredth of a millimetre on a machine of 0.1 m; a millimetre can be seen")

SETTINGS: tuple[Setting, ...] = (
    newton_euler("relative"),
    newton_euler("cartesian"),
    newton_euler("relative", "baumgarte"),
    newton_euler("relative", integrator="Radau", rtol=1e-6, atol=1e-9),
    newton_euler("relative", integrator="RK4", step=1e-3),
    newton_euler("relative", integrator="Euler", step=1e-3),
    mujoco("RK4"),
    mujoco("Euler"),
    mujoco("implicit"),
    mujoco("implicitfast"),
    pinocchio(),
    pinocchio(integrator="Radau", rtol=1e-6, atol=1e-9),
)


def cases(full: bool) -> list[Case]:
    """All of (e)."""
    duration = DURATION if full else SHORTER
    return [
        Case(
            "e",
            f"tracker, {duration:g} s, K_p {stiffness:g}, K_d {damping:g}",
            setting.engine,
            str(setting),
            "position error",
            "m",
            CLOSE,
            partial(measure, stiffness, damping, setting, duration),
            limit=9.0 if full else 5.0,
        )
        for stiffness, damping in (GAINS if full else GAINS[2:4])
        for setting in SETTINGS
    ]


def stiff_tracker(stiffness: float, damping: float, duration: float) -> Scene:
    """The tracker with these gains of both sliders, N/m and N s/m."""
    scene = load("tracker")
    control = tuple(
        PD(law.joint, stiffness, damping, law.target) for law in scene.control if isinstance(law, PD)
    )
    return lasting(replace(scene, control=control), duration, round(duration / OUTPUT_PERIOD))


@lru_cache
def _reference(stiffness: float, damping: float, duration: float) -> Trajectory:
    radau = newton_euler("relative", integrator="Radau", rtol=1e-8, atol=1e-11)
    return radau.simulate(stiff_tracker(stiffness, damping, duration))


def measure(stiffness: float, damping: float, setting: Setting, duration: float) -> Measured:
    """The largest distance from a run of Radau at rtol 1e-8, whose own error is far below the bound."""
    run = setting.simulate(stiff_tracker(stiffness, damping, duration))
    error = distance(run, _reference(stiffness, damping, duration))
    curve = Curve(
        "stiff control",
        "sqrt(K_p^2 + K_d^2)",
        "position error, m",
        f"{setting.engine}, {setting}",
        ((stiffness**2 + damping**2) ** 0.5,),
        (max(error, 1e-18),),
    )
    return Measured(error, f"{run.settings['steps']} steps", (curve,))
