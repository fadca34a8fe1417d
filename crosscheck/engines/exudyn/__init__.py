"""Exudyn as an engine: generalized-alpha at a step that is chosen for the scene.

Bodies have Euler parameters, and joints are algebraic equations. The registry imports this package when the
engine is named, so that it imports Exudyn at once.
"""

from __future__ import annotations

from contextlib import suppress
from functools import lru_cache, partial

from crosscheck.engines.adaptive import expected_run
from crosscheck.engines.benchmarks import Benchmarks
from crosscheck.engines.engine import NO_SETTINGS, Engine, FixedSteps, Settings, without_forces
from crosscheck.engines.exudyn.equations import ExudynSystem
from crosscheck.engines.exudyn.limits import limits
from crosscheck.engines.exudyn.run import StepError
from crosscheck.engines.exudyn.simulate import MAX_STEP, simulate
from crosscheck.engines.steps import halve_until_accurate
from crosscheck.engines.stress import StressSettings
from newton_euler.equations.model_control import roles
from newton_euler.equations.system import System
from newton_euler.model.scene import Scene
from newton_euler.model.trajectory import Trajectory
from newton_euler.scalars import Array

MODEL_LAW_STEP = 5e-3
"""First step, s, of default runs with laws that use a model of the mechanism, whose forces take some tens of
milliseconds per step."""

MIN_STEPS = 500
"""Smallest number of steps of a default run, for short runs of fast machines."""

MAX_HALVINGS = 4
"""Largest number of halvings of the first step if runs stop within a step, for example because Newton's
method does not converge."""

MAX_STEPS = 50_000
"""Largest number of steps of a default run, which take half a minute."""


@lru_cache(maxsize=1)
def _run(scene: Scene) -> Trajectory:
    """Simulate a scene with generalized-alpha.

    The first step is `MAX_STEP` or `MODEL_LAW_STEP`, or shorter for at least `MIN_STEPS` steps. The step is
    halved while the run stops within a step, and while it is far from newton_euler's run and halving changes
    it.

    Raises:
        StepError: if runs with all steps stop within a step; the error is that of the shortest step.
        IntegrationError: if a run stops for another reason, such as a controller that fails.
    """
    step = min(MODEL_LAW_STEP if roles(scene) else MAX_STEP, scene.duration / MIN_STEPS)
    at_step = partial(_at_step, scene)
    for halvings in range(MAX_HALVINGS):
        with suppress(StepError):
            chosen = step * 0.5**halvings
            return halve_until_accurate(
                scene, at_step(chosen), expected_run(scene), chosen, MAX_STEPS, at_step
            )
    return at_step(step * 0.5**MAX_HALVINGS)


def _at_step(scene: Scene, step: float) -> Trajectory:
    """Simulate a scene with generalized-alpha at a step, s."""
    return simulate(scene, step=step)


def _simulate(scene: Scene, settings: Settings = NO_SETTINGS, /) -> Trajectory:
    """Simulate a scene in Exudyn."""
    return simulate(scene, **settings) if settings else _run(scene)


def _refined(scene: Scene, in_full: bool = False) -> Trajectory:
    """Simulate a scene with half the step of the default run.

    Args:
        scene: the scene.
        in_full: True to compute all outputs of the scene; False to omit reactions and actuator forces.
    """
    step = 0.5 * _run(scene).settings["step"]
    return _at_step(scene if in_full else without_forces(scene), step)


def _systems(scene: Scene) -> tuple[System, ...]:
    """Return Exudyn's equations of motion."""
    return (ExudynSystem(scene),)


def _with_moved_anchor(scene: Scene, joint: str, shift: Array) -> System:
    """Return the equations with the point of a joint in its second body moved by a vector (3,), m."""
    return ExudynSystem(scene, shifts={joint: shift})


def _stress_settings() -> StressSettings:
    """Import the settings of stress tests."""
    from crosscheck.engines.exudyn.stress import STRESS

    return STRESS


def _benchmarks() -> Benchmarks:
    """Import the benchmarks."""
    from crosscheck.engines.exudyn.benchmark import BENCHMARKS

    return BENCHMARKS


# Generalized-alpha is of order 2: the errors of runs are measured by refined runs. Newton's iteration ends at
# 1e-12, so that constraints hold to about 1e-10
ENGINE = Engine(
    "exudyn",
    _simulate,
    _refined,
    _systems,
    limits=limits,
    trajectory_error=1e-9,
    drift=1e-9,
    energy_error=1e-8,
    package="exudyn",
    label="Exudyn",
    refined_in_full=partial(_refined, in_full=True),
    fixed_steps=FixedSteps("generalized_alpha", lambda step: {"step": step}, steps=40),
    with_moved_anchor=_with_moved_anchor,
    benchmarks=_benchmarks,
    stress_settings=_stress_settings,
)
