"""Pinocchio as an engine: newton_euler's integrators with Pinocchio's equations, evaluated by Python."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from functools import partial
from typing import Any

from crosscheck.engines.adaptive import python_options
from crosscheck.engines.benchmarks import Benchmarks
from crosscheck.engines.engine import (
    NO_SETTINGS,
    Engine,
    FixedSteps,
    Importer,
    ImporterLimit,
    Settings,
    without_forces,
)
from crosscheck.engines.stress import StressSettings
from crosscheck.support.colors import GREEN
from newton_euler.equations.system import System
from newton_euler.model.scene import Scene
from newton_euler.model.trajectory import StoppedError, Trajectory
from newton_euler.reading.robot import RobotFile

LIMITS = {
    "URDF": ImporterLimit(
        frozenset({"coupling"}), "buildModelFromUrdf reads mimic joints as free ones unless mimic=True"
    ),
    "MJCF": ImporterLimit(
        frozenset({"drive", "coupling", "loop", "spring", "stiffness", "setting"}),
        "a pinocchio.Model has no actuators and springs, and of equalities its reader knows connect only",
    ),
}
"""Documented limits of Pinocchio's importers, by format."""

LOOSER_TOLERANCE_FACTOR = 5.0
"""Factor on the tolerances of a refined run in Python that is repeated because it stopped. Accelerations of
nearly singular loops and of stiff machines may have too few accurate digits for `REFINED_RTOL`."""


def _simulate(scene: Scene, settings: Settings = NO_SETTINGS, /) -> Trajectory:
    """Simulate a scene in Pinocchio."""
    return _first_run(scene, [dict(settings)] if settings else python_options(scene, refined=False))


def _first_run(scene: Scene, methods: Sequence[dict[str, Any]]) -> Trajectory:
    """Simulate a scene in Pinocchio with the first options with which the run does not stop."""
    import urdf

    for method in methods[:-1]:
        with suppress(StoppedError):
            return urdf.simulate(scene, **method)
    return urdf.simulate(scene, **methods[-1])


def _refined(scene: Scene, in_full: bool = False) -> Trajectory:
    """Simulate a scene in Pinocchio at refined tolerances, or at looser ones if that run stops."""
    methods = python_options(scene, refined=True)
    looser = {name: LOOSER_TOLERANCE_FACTOR * methods[-1][name] for name in ("rtol", "atol")}
    return _first_run(scene if in_full else without_forces(scene), [*methods, methods[-1] | looser])


def _systems(scene: Scene) -> tuple[System, ...]:
    """Return Pinocchio's equations of motion."""
    from urdf.dynamics import PinocchioSystem

    return (PinocchioSystem(scene),)


def _stress_settings() -> StressSettings:
    """Import the settings of stress tests."""
    from crosscheck.engines.pinocchio.stress import STRESS

    return STRESS


def _as_imported(path: str) -> RobotFile:
    """Describe the robot that Pinocchio reads in a file."""
    from urdf.importer import describe_as_imported

    return describe_as_imported(path)


def _benchmarks() -> Benchmarks:
    """Import the benchmarks."""
    from crosscheck.engines.pinocchio.benchmark import BENCHMARKS

    return BENCHMARKS


# Pinocchio uses the same methods as newton_euler, with equations evaluated in Python
ENGINE = Engine(
    "pinocchio",
    _simulate,
    _refined,
    _systems,
    trajectory_error=1e-9,
    drift=1e-9,
    energy_error=1e-8,
    package="pin",
    label="Pinocchio",
    color=GREEN,
    line=(":", 1.8),
    refined_in_full=partial(_refined, in_full=True),
    # Python calls Pinocchio four times per step
    fixed_steps=FixedSteps("RK4", lambda step: {"integrator": "RK4", "step": step}, steps=10),
    at_tolerance=lambda rtol: {"rtol": rtol, "atol": 0.01 * rtol},
    benchmarks=_benchmarks,
    importer=Importer(_as_imported, LIMITS),
    stress_settings=_stress_settings,
)
