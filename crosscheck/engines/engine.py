"""Registry of the engines: how each one simulates a scene, and how accurate its runs are expected to be."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from typing import Any, Final

import numpy as np

from crosscheck.compare.check import UNRESOLVED
from crosscheck.library import REFERENCE_QUANTITIES
from crosscheck.support.errors import CrosscheckError
from newton_euler.equations.system import Evaluation, System
from newton_euler.errors import NewtonEulerError, choices
from newton_euler.integrators.fixed_step import RK4_LIMIT
from newton_euler.model.scene import Scene
from newton_euler.model.trajectory import StoppedError, Trajectory, distance
from newton_euler.runs.assemble import initial_state

REFINED_RTOL, REFINED_ATOL = 1e-12, 1e-14
"""Tolerances of refined runs, a hundredth of the default ones. DOP853 accepts no rtol below 2.2e-14."""

EXACT_RTOL, EXACT_ATOL = 1e-13, 1e-15
"""Tolerances of runs for reference values of twelve digits; tighter ones only add round-off."""

MIN_MUJOCO_STEPS = 500
"""Smallest number of steps of a run in MuJoCo. Steps of 1 ms are too long for a machine that reaches 1000
rad/s after 50 ms."""

MAX_HALVINGS = 4
"""Largest number of halvings of MuJoCo's step if a run diverges. After them `IMPLICIT`, a method of order 1,
runs at the smallest step."""

MAX_RK4_STEPS = 100_000
"""Largest number of steps of MuJoCo's RK4 that stability or accuracy may ask for; they take some seconds. If
the stability of stiff dampers, which are explicit in RK4, asks for more, `IMPLICIT` is used instead."""

IMPLICIT: Final = "implicitfast"

NATIVE_STEP_BUDGET, PYTHON_STEP_BUDGET = 100_000, 60
"""Largest numbers of steps that DOP853 may need for stability; beyond them Radau runs instead, see
`crosscheck.engines.stiffness`. In native code so many steps take some seconds. If Python evaluates the
equations, so many steps (or one per output, if there are more outputs) cost about as much as Radau. DOP853
took 4 to 7 times as many steps on damped trackers and servo-driven arms, with 13 evaluations each. Radau took
500 to 900 steps for a second of an arm's motion, with 7 evaluations each."""

NATIVE_MAX_STEPS, PYTHON_MAX_STEPS = 200_000, 10_000
"""Largest numbers of steps of an adaptive run, which otherwise could last for hours."""

STIFF_RTOL, STIFF_ATOL = 1e-8, 1e-10
"""Tolerances of Radau. Since its order is 5, tolerances a hundred times tighter need ten times as many
steps."""

STIFF_REFINEMENT = 0.1
"""Factor on the tolerances of Radau in refined runs."""

LOOSER_TOLERANCE_FACTOR = 5.0
"""Factor on the tolerances if a refined run in Python stops: accelerations of nearly singular loops and of
stiff machines have too few digits for tighter tolerances."""


@dataclass(frozen=True)
class Engine:
    """An engine.

    Attributes:
        name: name in files and options.
        simulate: simulates a scene at crosscheck's default settings for the engine.
        refined: simulates a scene at half the step or a hundredth of the tolerance. The change measures
            errors that exceed the three expected errors below.
        systems: returns the equations of motion with rigid constraints, for the levels before trajectories.
        trajectory_error: expected error of a run, relative to the mechanism's reach and in rad.
        drift: expected constraint violation of a run, relative to the mechanism's reach and in rad.
        energy_error: expected energy balance error, relative to the largest energy.
        package: name of the engine's package, whose version is recorded.
        exact: simulates a scene as accurately as possible, for reference values; `refined` if None.
        evaluate_soft_constraints: evaluates the initial state with the engine's soft constraints; None if its
            constraints are rigid.
        refined_in_full: as `refined`, but always with reactions and actuator forces; `refined` if None.
    """

    name: str
    simulate: Callable[[Scene], Trajectory]
    refined: Callable[[Scene], Trajectory]
    systems: Callable[[Scene], tuple[System, ...]]
    trajectory_error: float
    drift: float
    energy_error: float
    package: str
    exact: Callable[[Scene], Trajectory] | None = None
    evaluate_soft_constraints: Callable[[Scene], Evaluation] | None = None
    refined_in_full: Callable[[Scene], Trajectory] | None = None


def native_method(scene: Scene, refined: bool) -> dict[str, Any]:
    """Choose integrator, tolerances and largest number of steps for runs in native code."""
    return {"most_steps": NATIVE_MAX_STEPS} | _by_stiffness(scene, NATIVE_STEP_BUDGET, refined)


def python_method(scene: Scene, refined: bool) -> dict[str, Any]:
    """Choose integrator, tolerances and largest number of steps for runs whose equations Python evaluates."""
    steps = max(PYTHON_STEP_BUDGET, len(scene.times))
    return {"most_steps": PYTHON_MAX_STEPS} | _by_stiffness(scene, steps, refined)


def _by_stiffness(scene: Scene, stability_steps: int, refined: bool) -> dict[str, Any]:
    """Choose Radau if the stability of DOP853 needs more than `stability_steps` steps, and the tolerances."""
    from crosscheck.engines.stiffness import explicit_steps

    if explicit_steps(scene) > stability_steps:
        share = STIFF_REFINEMENT if refined else 1.0
        return {"integrator": "Radau", "rtol": share * STIFF_RTOL, "atol": share * STIFF_ATOL}
    return {"rtol": REFINED_RTOL, "atol": REFINED_ATOL} if refined else {}


@lru_cache(maxsize=1)
def native_run(scene: Scene) -> Trajectory:
    """Simulate a scene in newton_euler; the last run is cached, since several comparisons use it."""
    from newton_euler import simulate

    return simulate(scene, **native_method(scene, refined=False))


@lru_cache(maxsize=1)
def native_refined(scene: Scene) -> Trajectory:
    """Simulate a scene in newton_euler at refined tolerances; the last run is cached."""
    from newton_euler import simulate

    return simulate(scene, **native_method(scene, refined=True))


def _newton_euler_exact(scene: Scene) -> Trajectory:
    from newton_euler import simulate

    return simulate(scene, rtol=EXACT_RTOL, atol=EXACT_ATOL)


def _newton_euler_systems(scene: Scene) -> tuple[System, ...]:
    from newton_euler.compiled.formulations import FORMULATIONS, formulate

    return tuple(formulate(scene, name) for name in FORMULATIONS)


def _way(scene: Scene) -> Trajectory | None:
    """Return newton_euler's run, or its part before it stopped: the expected path of other engines."""
    try:
        return native_run(scene)
    except StoppedError as error:
        return error.partial
    except NewtonEulerError:
        return None


@lru_cache(maxsize=1)
def _mujoco_run(scene: Scene) -> Trajectory:
    """Simulate a scene in MuJoCo, at the default step divided by a whole number.

    The step gives at least `MIN_MUJOCO_STEPS`, is stable in RK4, and does not diverge. If the run is still
    far from newton_euler's, the step is halved: RK4 is too coarse for fast machines, and loops with very
    different masses are soft.

    Raises:
        DivergenceError: with the step that RK4 would need, if all steps diverge.
    """
    import mjcf
    from crosscheck.engines.stiffness import is_stable_in_rk4, modes_of_run
    from mjcf.errors import DivergenceError
    from mjcf.simulate import default_timestep

    # The candidate steps
    step = default_timestep(scene)
    step /= max(1.0, np.ceil(MIN_MUJOCO_STEPS * step / scene.duration * (1.0 - 1e-9)))
    way = _way(scene)
    modes = modes_of_run(scene, way)
    halvings = max(MAX_HALVINGS, int(np.log2(max(1.0, MAX_RK4_STEPS * step / scene.duration))))
    steps = [step * 0.5**k for k in range(halvings + 1)]
    # The first stable step at which RK4 does not diverge; else the implicit method
    for tried in [each for each in steps if is_stable_in_rk4(modes, each)][: MAX_HALVINGS + 1]:
        with suppress(DivergenceError):
            return _resolved(scene, mjcf.simulate(scene, timestep=tried), way)
    try:
        return mjcf.simulate(scene, timestep=steps[MAX_HALVINGS], integrator=IMPLICIT)
    except DivergenceError as error:
        # Explain a divergence by the fastest decay of the motions
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


def _resolved(scene: Scene, run: Trajectory, way: Trajectory | None) -> Trajectory:
    """Halve the step of MuJoCo's RK4 while the run is far from `way` and each half changes it as much."""
    import mjcf
    from mjcf.errors import DivergenceError

    if way is None or len(way.time) != len(run.time):
        return run
    size = scene.mechanism.size
    while distance(run, way, length=size) > UNRESOLVED:
        half = 0.5 * run.settings["timestep"]
        if scene.duration > half * MAX_RK4_STEPS:
            break
        try:
            finer = mjcf.simulate(scene, timestep=half)
        except DivergenceError:
            break
        change, run = distance(run, finer, length=size), finer
        if change < UNRESOLVED:
            break
    return run


def _mujoco_refined(scene: Scene, in_full: bool = False) -> Trajectory:
    import mjcf

    settings = _mujoco_run(scene).settings
    step, integrator = 0.5 * settings["timestep"], settings["integrator"]
    wanted = scene if in_full else _motion_of(scene)
    return mjcf.simulate(wanted, timestep=step, integrator=integrator)


def _motion_of(scene: Scene) -> Scene:
    """Return the scene without reactions and actuator forces, which refined runs need for reference values
    only."""
    if scene.name in REFERENCE_QUANTITIES:
        return scene
    return replace(scene, outputs=scene.outputs - {"reactions", "actuation"})


def _mujoco_systems(scene: Scene) -> tuple[System, ...]:
    from mjcf.rigid import RigidMuJoCo

    return (RigidMuJoCo(scene),)


def _mujoco_soft(scene: Scene) -> Evaluation:
    from mjcf.soft import SoftMuJoCo

    soft = SoftMuJoCo(scene)
    return soft.evaluate(*soft.coordinates(initial_state(scene)))


def _pinocchio_run(scene: Scene) -> Trajectory:
    import urdf

    return urdf.simulate(scene, **python_method(scene, refined=False))


def _pinocchio_refined(scene: Scene, in_full: bool = False) -> Trajectory:
    import urdf

    wanted = scene if in_full else _motion_of(scene)
    method = python_method(scene, refined=True)
    try:
        return urdf.simulate(wanted, **method)
    except StoppedError:
        looser = {name: LOOSER_TOLERANCE_FACTOR * method[name] for name in ("rtol", "atol")}
        return urdf.simulate(wanted, **(method | looser))


def _pinocchio_systems(scene: Scene) -> tuple[System, ...]:
    from urdf.dynamics import PinocchioSystem

    return (PinocchioSystem(scene),)


ENGINES: dict[str, Engine] = {
    engine.name: engine
    for engine in (
        # DOP853 at rtol 1e-10 or Radau, projected onto the constraints after each step
        Engine(
            "newton_euler",
            native_run,
            native_refined,
            _newton_euler_systems,
            trajectory_error=1e-9,
            drift=1e-13,
            energy_error=1e-8,
            package="numpy",
            exact=_newton_euler_exact,
        ),
        # RK4 at a fixed step; its constraints are springs with a time constant of two steps, and what
        # that does to a run depends on the mechanism
        Engine(
            "mujoco",
            _mujoco_run,
            _mujoco_refined,
            _mujoco_systems,
            trajectory_error=1e-9,
            drift=1e-9,
            energy_error=1e-8,
            package="mujoco",
            evaluate_soft_constraints=_mujoco_soft,
            refined_in_full=partial(_mujoco_refined, in_full=True),
        ),
        # as newton_euler, from Python
        Engine(
            "pinocchio",
            _pinocchio_run,
            _pinocchio_refined,
            _pinocchio_systems,
            trajectory_error=1e-9,
            drift=1e-9,
            energy_error=1e-8,
            package="pin",
            refined_in_full=partial(_pinocchio_refined, in_full=True),
        ),
    )
}


def choose(names: list[str]) -> list[Engine]:
    """Return engines by name, in the given order; raises `CrosscheckError` for unknown or repeated names."""
    if not names:
        raise CrosscheckError(f"no engine named; choose from: {', '.join(ENGINES)}")
    for name in names:
        if name not in ENGINES:
            raise CrosscheckError(f"unknown engine {name!r}; {choices(name, ENGINES)}")
        if names.count(name) > 1:
            raise CrosscheckError(f"engine {name!r} is named {names.count(name)} times")
    return [ENGINES[name] for name in names]
