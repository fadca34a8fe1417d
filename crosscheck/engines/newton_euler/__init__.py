"""newton_euler as an engine: this project's own solver, with compiled equations and adaptive steps."""

from __future__ import annotations

from crosscheck.engines.adaptive import native_refined, native_run
from crosscheck.engines.benchmarks import Benchmarks
from crosscheck.engines.engine import NO_SETTINGS, Engine, FixedSteps, Integrators, Settings
from crosscheck.engines.stress import StressSettings
from newton_euler.equations.system import System
from newton_euler.errors import DISTRIBUTION
from newton_euler.model.scene import Scene
from newton_euler.model.trajectory import Trajectory

EXACT_RTOL, EXACT_ATOL = 1e-13, 1e-15
"""Tolerances of runs for reference values of twelve digits; tighter ones only add round-off."""


def _simulate(scene: Scene, settings: Settings = NO_SETTINGS, /) -> Trajectory:
    """Simulate a scene in newton_euler."""
    from newton_euler import simulate

    return simulate(scene, **settings) if settings else native_run(scene)


def _systems(scene: Scene) -> tuple[System, ...]:
    """Return newton_euler's equations of motion in all formulations."""
    from newton_euler.compiled.formulations import FORMULATIONS, formulate

    return tuple(formulate(scene, name) for name in FORMULATIONS)


def _stress_settings() -> StressSettings:
    """Import the settings of stress tests."""
    from crosscheck.engines.newton_euler.stress import STRESS

    return STRESS


def _benchmarks() -> Benchmarks:
    """Import the benchmarks."""
    from crosscheck.engines.newton_euler.benchmark import BENCHMARKS

    return BENCHMARKS


# DOP853 at rtol 1e-10 or Radau, projected onto the constraints after each step
ENGINE = Engine(
    "newton_euler",
    _simulate,
    native_refined,
    _systems,
    trajectory_error=1e-9,
    drift=1e-13,
    energy_error=1e-8,
    package=DISTRIBUTION,
    integrators=Integrators("DOP853", "Radau"),
    exact={"rtol": EXACT_RTOL, "atol": EXACT_ATOL},
    fixed_steps=FixedSteps("RK4", lambda step: {"integrator": "RK4", "step": step}, steps=40),
    benchmarks=_benchmarks,
    stress_settings=_stress_settings,
)
