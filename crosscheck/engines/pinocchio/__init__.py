"""Pinocchio as an engine: newton_euler's integrators with Pinocchio's equations, evaluated by Python."""

from __future__ import annotations

from functools import partial

from crosscheck.engines.adaptive import python_run, refined_python_run
from crosscheck.engines.benchmarks import Benchmarks
from crosscheck.engines.engine import (
    NO_SETTINGS,
    Engine,
    FixedSteps,
    Importer,
    ImporterLimit,
    Integrators,
    Settings,
)
from crosscheck.engines.stress import StressSettings
from newton_euler.equations.system import System
from newton_euler.model.scene import Scene
from newton_euler.model.trajectory import Trajectory
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


def _simulate(scene: Scene, settings: Settings = NO_SETTINGS, /) -> Trajectory:
    """Simulate a scene in Pinocchio."""
    import urdf

    return python_run(urdf.simulate, scene, settings)


def _refined(scene: Scene, in_full: bool = False) -> Trajectory:
    """Simulate a scene in Pinocchio at refined tolerances."""
    import urdf

    return refined_python_run(urdf.simulate, scene, in_full)


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
    refined_in_full=partial(_refined, in_full=True),
    # Python calls Pinocchio four times per step
    fixed_steps=FixedSteps("RK4", lambda step: {"integrator": "RK4", "step": step}, steps=10),
    integrators=Integrators("DOP853", "Radau"),
    at_tolerance=lambda rtol: {"rtol": rtol, "atol": 0.01 * rtol},
    benchmarks=_benchmarks,
    importer=Importer(_as_imported, LIMITS),
    stress_settings=_stress_settings,
)
