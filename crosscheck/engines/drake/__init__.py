"""Drake as an engine: newton_euler's integrators with Drake's equations, evaluated by Python.

With the setting "solver", one of Drake's own solvers runs instead, see `crosscheck.engines.drake.solvers`.
Engines that do not run unless they are named are imported when they are named, so that this package imports
Drake at once.
"""

from __future__ import annotations

from functools import partial

from crosscheck.engines.adaptive import python_run, refined_python_run
from crosscheck.engines.benchmarks import Benchmarks
from crosscheck.engines.drake.equations import DrakeSystem
from crosscheck.engines.drake.plant import NAME
from crosscheck.engines.drake.simulate import simulate
from crosscheck.engines.drake.solvers import simulate_with
from crosscheck.engines.engine import NO_SETTINGS, Engine, FixedSteps, Integrators, Settings
from crosscheck.engines.stress import StressSettings
from newton_euler.equations.system import System
from newton_euler.model.scene import Scene
from newton_euler.model.trajectory import Trajectory
from newton_euler.scalars import Array


def _simulate(scene: Scene, settings: Settings = NO_SETTINGS, /) -> Trajectory:
    """Simulate a scene with Drake; the setting "solver" selects a solver of Drake."""
    if "solver" in settings:
        return simulate_with(scene, **settings)
    return python_run(simulate, scene, settings)


def _systems(scene: Scene) -> tuple[System, ...]:
    """Return Drake's equations of motion."""
    return (DrakeSystem(scene),)


def _with_moved_anchor(scene: Scene, joint: str, shift: Array) -> System:
    """Return Drake's equations with the anchor of a closing joint moved by a vector (3,), m."""
    return DrakeSystem(scene, shifts={joint: shift})


def _stress_settings() -> StressSettings:
    """Import the settings of stress tests."""
    from crosscheck.engines.drake.stress import STRESS

    return STRESS


def _benchmarks() -> Benchmarks:
    """Import the benchmarks."""
    from crosscheck.engines.drake.benchmark import BENCHMARKS

    return BENCHMARKS


# The same methods as newton_euler's, with equations evaluated in Python
ENGINE = Engine(
    NAME,
    _simulate,
    partial(refined_python_run, simulate),
    _systems,
    trajectory_error=1e-9,
    drift=1e-9,
    energy_error=1e-8,
    package="drake",
    label="Drake",
    refined_in_full=partial(refined_python_run, simulate, in_full=True),
    # Python calls Drake some ten times per evaluation
    fixed_steps=FixedSteps("RK4", lambda step: {"integrator": "RK4", "step": step}, steps=10),
    integrators=Integrators("DOP853", "Radau"),
    with_moved_anchor=_with_moved_anchor,
    stress_settings=_stress_settings,
    benchmarks=_benchmarks,
)
