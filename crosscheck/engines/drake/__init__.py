"""Drake as an engine: newton_euler's integrators with Drake's equations, evaluated by Python.

With the setting "solver", one of Drake's own solvers runs instead, see `crosscheck.engines.drake.solvers`.
Engines that do not run unless they are named are imported when they are named, so that this package imports
Drake at once.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from functools import partial
from typing import Any

from crosscheck.engines.adaptive import python_options
from crosscheck.engines.benchmarks import Benchmarks
from crosscheck.engines.drake.equations import DrakeSystem
from crosscheck.engines.drake.plant import NAME
from crosscheck.engines.drake.simulate import simulate
from crosscheck.engines.drake.solvers import simulate_with
from crosscheck.engines.engine import NO_SETTINGS, Engine, FixedSteps, Settings, without_forces
from crosscheck.engines.stress import StressSettings
from newton_euler.equations.system import System
from newton_euler.model.scene import Scene
from newton_euler.model.trajectory import StoppedError, Trajectory
from newton_euler.scalars import Array

LOOSER_TOLERANCE_FACTOR = 5.0
"""Factor on the tolerances of a refined run that is repeated because it stopped: accelerations of nearly
singular loops and of stiff machines may have too few accurate digits for `REFINED_RTOL`."""


def _simulate(scene: Scene, settings: Settings = NO_SETTINGS, /) -> Trajectory:
    """Simulate a scene with Drake; the setting "solver" selects a solver of Drake."""
    if "solver" in settings:
        return simulate_with(scene, **settings)
    return _first_run(scene, [dict(settings)] if settings else python_options(scene, refined=False))


def _first_run(scene: Scene, methods: Sequence[dict[str, Any]]) -> Trajectory:
    """Simulate a scene with Drake with the first options with which the run does not stop."""
    for method in methods[:-1]:
        with suppress(StoppedError):
            return simulate(scene, **method)
    return simulate(scene, **methods[-1])


def _refined(scene: Scene, in_full: bool = False) -> Trajectory:
    """Simulate a scene with Drake at refined tolerances, or at looser ones if that run stops."""
    methods = python_options(scene, refined=True)
    looser = {name: LOOSER_TOLERANCE_FACTOR * methods[-1][name] for name in ("rtol", "atol")}
    return _first_run(scene if in_full else without_forces(scene), [*methods, methods[-1] | looser])


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
    _refined,
    _systems,
    trajectory_error=1e-9,
    drift=1e-9,
    energy_error=1e-8,
    package="drake",
    label="Drake",
    min_version="1.51",
    refined_in_full=partial(_refined, in_full=True),
    # Python calls Drake some ten times per evaluation
    fixed_steps=FixedSteps("RK4", lambda step: {"integrator": "RK4", "step": step}, steps=10),
    at_tolerance=lambda rtol: {"rtol": rtol, "atol": 0.01 * rtol},
    with_moved_anchor=_with_moved_anchor,
    stress_settings=_stress_settings,
    benchmarks=_benchmarks,
)
