"""MuJoCo as an engine: RK4 at a fixed step, or an implicit method for stiff scenes, with soft constraints.

The step is chosen for each scene by the eigenvalues of its motions and by newton_euler's run.
"""

from __future__ import annotations

from contextlib import suppress
from functools import lru_cache, partial
from typing import Final

import numpy as np

from crosscheck.engines.adaptive import expected_run
from crosscheck.engines.benchmarks import Benchmarks
from crosscheck.engines.engine import (
    NO_SETTINGS,
    Engine,
    FixedSteps,
    Importer,
    ImporterLimit,
    Integrators,
    Settings,
    SoftConstraints,
    without_forces,
)
from crosscheck.engines.steps import halve_until_accurate
from crosscheck.engines.stress import StressSettings
from newton_euler.equations.system import Evaluation, System
from newton_euler.integrators.fixed_step import RK4_LIMIT
from newton_euler.model.scene import Scene
from newton_euler.model.trajectory import Trajectory
from newton_euler.reading.robot import RobotFile
from newton_euler.runs.assemble import initial_state
from newton_euler.scalars import Array

MIN_STEPS = 500
"""Smallest number of steps of a run in MuJoCo, for short runs of fast machines: the default step of 1 ms is
too long for a machine that reaches 1000 rad/s after 50 ms."""

MAX_HALVINGS = 4
"""Largest number of halvings of the longest step at which MuJoCo's RK4 is stable, if runs diverge. If all of
them diverge, or no step is stable, `IMPLICIT` is used at the longest step halved this number of times."""

MAX_RK4_STEPS = 100_000
"""Largest number of steps of MuJoCo's RK4, which take some seconds. If stability would require more steps,
for example because of stiff dampers, `IMPLICIT` is used instead."""

SOLVER_TOLERANCE = 1e-8
"""Relative improvement below which MuJoCo's iteration for the forces of its soft (spring-like) constraints
ends; MuJoCo's default."""

FORCE_ERROR = 1e-2
"""Expected error of reaction forces of runs, relative to the largest force. MuJoCo limits solimp to 0.9999,
which causes errors of about 0.1 % at any step, and larger errors in ill-conditioned mechanisms."""

SMALLEST_RESISTED = 1e-7
"""Smallest singular value s of a nearly redundant constraint that affects a run.

MuJoCo's constraints (1 - impedance = 1e-4, time constant 2e-3 s) resist the motion that such a constraint
nearly allows. The stiffness k, divided by the inertia, is s^2 / (1e-4 (2e-3 s)^2) = 2.5e-5 1/s^2. Within
t = 20 s it changes the motion by k t^2 = 1 %."""

LIMITS = {
    "URDF": ImporterLimit(
        frozenset({"speed", "ground"}),
        "an MjModel has no limits of speed, and links fixed to the ground become the world, without mass",
    )
}
"""Documented limits of MuJoCo's importer, by format."""

IMPLICIT: Final = "implicitfast"
"""Name of MuJoCo's implicit integrator, a method of order 1."""


@lru_cache(maxsize=1)
def _run(scene: Scene) -> Trajectory:
    """Simulate a scene in MuJoCo, at the default step divided by a whole number.

    The step is short enough for at least `MIN_STEPS` steps, for a stable RK4, and for a run that does
    not diverge. If the run is still far from newton_euler's in its poses or energies, the step is halved
    further: RK4 is inaccurate for fast machines and after steps of a control, and the soft constraints of
    loops with very different masses yield too much.

    Raises:
        DivergenceError: if the runs with all steps diverge; the message names the step that RK4 would need.
    """
    import mjcf
    from crosscheck.engines.stiffness import is_stable_in_rk4, modes_of_run
    from mjcf.errors import DivergenceError
    from mjcf.simulate import default_timestep

    # The candidate steps: the default step divided by a whole number, and its halves. The factor 1 - 1e-9
    # keeps round-off from raising the result of `ceil`
    step = default_timestep(scene)
    step /= max(1.0, np.ceil(MIN_STEPS * step / scene.duration * (1.0 - 1e-9)))
    expected = expected_run(scene)
    modes = modes_of_run(scene, expected)  # eigenvalues, 1/s
    halvings = max(MAX_HALVINGS, int(np.log2(max(1.0, MAX_RK4_STEPS * step / scene.duration))))
    steps = [step * 0.5**k for k in range(halvings + 1)]
    # RK4 with the longest stable step at which it does not diverge; else the implicit method
    stable_steps = [each for each in steps if is_stable_in_rk4(modes, each)]
    for stable_step in stable_steps[: MAX_HALVINGS + 1]:
        with suppress(DivergenceError):
            run = _rk4(scene, stable_step)
            at_step = partial(_rk4, scene)
            return halve_until_accurate(scene, run, expected, stable_step, MAX_RK4_STEPS, at_step)
    try:
        return mjcf.simulate(scene, timestep=steps[MAX_HALVINGS], integrator=IMPLICIT)
    except DivergenceError as error:
        # Explain the divergence by the fastest decay of the motions, if that is too fast for RK4
        rate = max(0.0, -float(np.min(modes.real, initial=0.0)))
        if RK4_LIMIT / steps[-1] >= rate:
            raise
        stiff = (
            f"motions decay at up to {rate:.2g} 1/s, for which RK4 needs steps below {RK4_LIMIT / rate:.2g} s"
        )
        alone = f"{IMPLICIT} at {steps[MAX_HALVINGS]:.2g} s leaves the forces of constraints explicit"
        cause = DivergenceError(error.time, f"{error.reason}; {stiff}, and {alone}")
        cause.partial = error.partial
        raise cause from error


def _rk4(scene: Scene, timestep: float) -> Trajectory:
    """Simulate a scene in MuJoCo by RK4 at a step, s."""
    import mjcf

    return mjcf.simulate(scene, timestep=timestep)


def _refined(scene: Scene, in_full: bool = False) -> Trajectory:
    """Simulate a scene in MuJoCo with half the step.

    Args:
        scene: the scene.
        in_full: True to compute all outputs of the scene; False to omit reactions and actuator forces.
    """
    import mjcf

    settings = _run(scene).settings
    step, integrator = 0.5 * settings["timestep"], settings["integrator"]
    wanted = scene if in_full else without_forces(scene)
    return mjcf.simulate(wanted, timestep=step, integrator=integrator)


def _systems(scene: Scene) -> tuple[System, ...]:
    """Return MuJoCo's equations of motion with rigid constraints."""
    from mjcf.rigid import RigidMuJoCo

    return (RigidMuJoCo(scene),)


def _soft_evaluation(scene: Scene) -> Evaluation:
    """Evaluate the initial state of a scene with MuJoCo's soft constraints."""
    from mjcf.soft import SoftMuJoCo

    soft = SoftMuJoCo(scene)
    return soft.evaluate(*soft.coordinates(initial_state(scene)))


def _simulate(scene: Scene, settings: Settings = NO_SETTINGS, /) -> Trajectory:
    """Simulate a scene in MuJoCo."""
    import mjcf

    return mjcf.simulate(scene, **settings) if settings else _run(scene)


def _with_moved_anchor(scene: Scene, joint: str, shift: Array) -> System:
    """Return MuJoCo's equations with the anchor of a loop-closing joint moved by a vector (3,), m."""
    from mjcf.rigid import RigidMuJoCo

    system = RigidMuJoCo(scene)
    system.move_anchor(joint, shift)
    return system


def _stress_settings() -> StressSettings:
    """Import the settings of stress tests."""
    from crosscheck.engines.mujoco.stress import STRESS

    return STRESS


def _as_imported(path: str) -> RobotFile:
    """Describe the robot that MuJoCo reads in a file."""
    from mjcf.importer import describe_as_imported

    return describe_as_imported(path)


def _benchmarks() -> Benchmarks:
    """Import the benchmarks."""
    from crosscheck.engines.mujoco.benchmark import BENCHMARKS

    return BENCHMARKS


# RK4 at a fixed step; MuJoCo's constraints are springs with a time constant of two steps, whose
# effect on a run depends on the mechanism
ENGINE = Engine(
    "mujoco",
    _simulate,
    _refined,
    _systems,
    trajectory_error=1e-9,
    drift=1e-9,
    energy_error=1e-8,
    package="mujoco",
    label="MuJoCo",
    integrators=Integrators("RK4", "implicitfast"),
    soft_constraints=SoftConstraints(_soft_evaluation, SOLVER_TOLERANCE, FORCE_ERROR, SMALLEST_RESISTED),
    refined_in_full=partial(_refined, in_full=True),
    fixed_steps=FixedSteps("RK4", lambda step: {"integrator": "RK4", "timestep": step}, steps=40),
    with_moved_anchor=_with_moved_anchor,
    benchmarks=_benchmarks,
    importer=Importer(_as_imported, LIMITS),
    stress_settings=_stress_settings,
)
