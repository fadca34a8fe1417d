"""Registry of the engines: how each one simulates a scene, and how accurate its runs are expected to be.

An `Engine` bundles the functions of one simulator; `ENGINES` has newton_euler, MuJoCo and Pinocchio by name.
newton_euler is this project's own solver. A scene is a mechanism with its forces, inputs, initial state,
duration and outputs. This file also chooses the settings of each run: integrator, tolerances and step.
newton_euler and Pinocchio are integrated with adaptive steps (DOP853, or Radau for stiff scenes), MuJoCo with
a fixed step. "Native" means that the equations are compiled; in Pinocchio, Python evaluates the equations.

A refined run has half the step or tighter tolerances: a hundredth of the default ones for DOP853, a tenth for
Radau. Its difference from the default run measures the integration error.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from typing import Any, Final

import numpy as np

from crosscheck.engines.energy import energy_balance, min_energy_scale
from crosscheck.library import REFERENCE_QUANTITIES
from crosscheck.support.errors import CrosscheckError
from newton_euler.equations.system import Evaluation, System
from newton_euler.errors import NewtonEulerError, choices
from newton_euler.integrators.fixed_step import RK4_LIMIT
from newton_euler.model.scene import Scene
from newton_euler.model.trajectory import StoppedError, Trajectory, distance
from newton_euler.runs.assemble import initial_state

MAX_RELATIVE_ERROR = 1e-2
"""Largest error of a run that comparisons accept, relative to the mechanism's reach (its size or its largest
coordinate), 1 rad or the energy. A run with a larger error has too coarse steps to test a model."""

FORCE_OUTPUTS = frozenset({"reactions", "actuation"})
"""Outputs that comparisons need of runs, but not of refined runs."""

REFINED_RTOL, REFINED_ATOL = 1e-12, 1e-14
"""Tolerances of refined runs with DOP853, a hundredth of the default ones. DOP853 accepts no rtol below
2.2e-14."""

EXACT_RTOL, EXACT_ATOL = 1e-13, 1e-15
"""Tolerances of runs for reference values of twelve digits; tighter ones only add round-off."""

MIN_MUJOCO_STEPS = 500
"""Smallest number of steps of a run in MuJoCo, for short runs of fast machines: the default step of 1 ms is
too long for a machine that reaches 1000 rad/s after 50 ms."""

MAX_HALVINGS = 4
"""Largest number of halvings of the longest step at which MuJoCo's RK4 is stable, if runs diverge. If all of
them diverge, or no step is stable, `IMPLICIT` is used at the longest step halved this number of times."""

MAX_RK4_STEPS = 100_000
"""Largest number of steps of MuJoCo's RK4, which take some seconds. If stability would require more steps,
for example because of stiff dampers, `IMPLICIT` is used instead."""

IMPLICIT: Final = "implicitfast"
"""Name of MuJoCo's implicit integrator, a method of order 1."""

NATIVE_STEP_BUDGET = 100_000
"""Largest number of steps that DOP853 may need for stability in native code, which take some seconds. If it
needs more, Radau is used, see `crosscheck.engines.stiffness`."""

PYTHON_STEP_BUDGET = 60
"""Largest number of steps that DOP853 may need for stability if Python evaluates the equations; the number of
outputs is used instead if that is larger.

At this limit, DOP853 costs about as much as Radau: on damped solar trackers and servo-driven arms, DOP853
took 4 to 7 times as many steps as stability requires, with 13 evaluations each. Radau took 500 to 900 steps
for a second of an arm's motion, with 7 evaluations each."""

RADAU_SHARE = 0.25
"""Largest number of evaluations of Radau in Python, as a fraction of those that DOP853 needs.

Radau needs 0.11 to 0.24 of them on the governor and on servo-driven arms. It needs 4.6 times as many on a
walker with stiff springs, whose oscillations both methods have to follow."""

RADAU_EVALUATIONS = 7
"""Number of evaluations per step of Radau in Python: two or three Newton iterations of three stages each."""

MIN_RADAU_STEPS = 500
"""Smallest number of steps that Radau is allowed in Python; if it were fewer, Radau is not tried.

Radau took 508 to 867 steps for a second of the motion of servo-driven arms, a humanoid and a hand, 220 of
them at the start, where its steps are short."""

NATIVE_MAX_STEPS, PYTHON_MAX_STEPS = 200_000, 10_000
"""Largest numbers of steps of adaptive runs in native code and in Python, so that none lasts for hours."""

STIFF_RTOL, STIFF_ATOL = 1e-8, 1e-10
"""Tolerances of Radau. A hundred times tighter tolerances need about ten times as many steps."""

STIFF_REFINEMENT = 0.1
"""Factor on the tolerances of Radau in refined runs."""

LOOSER_TOLERANCE_FACTOR = 5.0
"""Factor on the tolerances of a refined run in Python that is repeated because it stopped. Accelerations of
nearly singular loops and of stiff machines may have too few accurate digits for `REFINED_RTOL`."""


@dataclass(frozen=True)
class Engine:
    """A simulator, with the functions that comparisons need and its expected errors.

    Attributes:
        name: name in files and options.
        simulate: simulates a scene with crosscheck's default settings for the engine.
        refined: simulates a scene with half the step or tighter tolerances.
        systems: returns the engine's equations of motion with rigid constraints, one per formulation (choice
            of coordinates).
        trajectory_error: expected error of poses, relative to the mechanism's reach (positions) or in rad.
        drift: expected constraint violation, relative to the mechanism's reach (lengths) or in rad.
        energy_error: expected energy balance error, relative to the largest energy.
        package: name of the engine's Python package, whose version is recorded.
        exact: simulates a scene as accurately as possible, for reference values; `refined` is used if None.
        evaluate_soft_constraints: evaluates the initial state with the engine's soft constraints; None if its
            constraints are rigid.
        refined_in_full: as `refined`, but always with reactions and actuator forces; `refined` is used if
            None.
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


def newton_euler_options(scene: Scene, refined: bool = False) -> dict[str, Any]:
    """Choose the options of `newton_euler.simulate` for a scene: integrator, tolerances and number of steps.

    Args:
        scene: the scene.
        refined: True for a refined run, with tighter tolerances than the default ones.
    """
    is_stiff = _needs_radau(scene, NATIVE_STEP_BUDGET)
    return {"most_steps": NATIVE_MAX_STEPS} | (_radau(refined) if is_stiff else _dop853(refined))


def python_options(scene: Scene, refined: bool) -> list[dict[str, Any]]:
    """Choose the same options as `newton_euler_options` for runs whose equations are evaluated in Python.

    Returns:
        Options to try in order: later ones if a run with the earlier ones stops.
    """
    explicit = {"most_steps": PYTHON_MAX_STEPS} | _dop853(refined)
    if not _needs_radau(scene, max(PYTHON_STEP_BUDGET, len(scene.times))):
        return [explicit]
    # Radau first; DOP853 if Radau takes too many steps, and newton_euler shows that DOP853 does not
    expected = _expected_run(scene)
    settings = {} if expected is None else expected.settings
    if settings.get("integrator") != "DOP853" or settings["steps"] > PYTHON_MAX_STEPS:
        return [{"most_steps": PYTHON_MAX_STEPS} | _radau(refined)]
    steps = int(RADAU_SHARE * settings["evaluations"] / RADAU_EVALUATIONS)
    if steps < MIN_RADAU_STEPS:
        return [explicit]
    return [{"most_steps": min(PYTHON_MAX_STEPS, steps)} | _radau(refined), explicit]


def _needs_radau(scene: Scene, max_steps: int) -> bool:
    """Return True if DOP853 needs more steps for stability than `max_steps`."""
    from crosscheck.engines.stiffness import explicit_steps

    return explicit_steps(scene) > max_steps


def _radau(refined: bool) -> dict[str, Any]:
    """Return the options of a run with Radau."""
    factor = STIFF_REFINEMENT if refined else 1.0
    return {"integrator": "Radau", "rtol": factor * STIFF_RTOL, "atol": factor * STIFF_ATOL}


def _dop853(refined: bool) -> dict[str, Any]:
    """Return the options of a run with DOP853."""
    return {"rtol": REFINED_RTOL, "atol": REFINED_ATOL} if refined else {}


@lru_cache(maxsize=1)
def native_run(scene: Scene) -> Trajectory:
    """Simulate a scene in newton_euler with default settings; the last run is cached for other uses."""
    from newton_euler import simulate

    return simulate(scene, **newton_euler_options(scene))


@lru_cache(maxsize=1)
def native_refined(scene: Scene) -> Trajectory:
    """Simulate a scene in newton_euler at refined tolerances; the last run is cached."""
    from newton_euler import simulate

    return simulate(scene, **newton_euler_options(scene, refined=True))


def _newton_euler_exact(scene: Scene) -> Trajectory:
    """Simulate a scene in newton_euler at the tightest useful tolerances."""
    from newton_euler import simulate

    return simulate(scene, rtol=EXACT_RTOL, atol=EXACT_ATOL)


def _newton_euler_systems(scene: Scene) -> tuple[System, ...]:
    """Return newton_euler's equations of motion in all formulations."""
    from newton_euler.compiled.formulations import FORMULATIONS, formulate

    return tuple(formulate(scene, name) for name in FORMULATIONS)


def _expected_run(scene: Scene) -> Trajectory | None:
    """Return newton_euler's run, by which settings of the other engines are chosen.

    The run is partial if it stopped, and None if it failed.
    """
    try:
        return native_run(scene)
    except StoppedError as error:
        return error.partial
    except NewtonEulerError:
        return None


@lru_cache(maxsize=1)
def _mujoco_run(scene: Scene) -> Trajectory:
    """Simulate a scene in MuJoCo, at the default step divided by a whole number.

    The step is short enough for at least `MIN_MUJOCO_STEPS` steps, for a stable RK4, and for a run that does
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
    step /= max(1.0, np.ceil(MIN_MUJOCO_STEPS * step / scene.duration * (1.0 - 1e-9)))
    expected = _expected_run(scene)
    modes = modes_of_run(scene, expected)  # eigenvalues, 1/s
    halvings = max(MAX_HALVINGS, int(np.log2(max(1.0, MAX_RK4_STEPS * step / scene.duration))))
    steps = [step * 0.5**k for k in range(halvings + 1)]
    # RK4 with the longest stable step at which it does not diverge; else the implicit method
    stable_steps = [each for each in steps if is_stable_in_rk4(modes, each)]
    for stable_step in stable_steps[: MAX_HALVINGS + 1]:
        with suppress(DivergenceError):
            return _halve_until_accurate(scene, mjcf.simulate(scene, timestep=stable_step), expected)
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


def _halve_until_accurate(scene: Scene, run: Trajectory, expected: Trajectory | None) -> Trajectory:
    """Halve the step of MuJoCo's RK4 while the run is far from the expected run and halving changes the run.

    Args:
        scene: the scene.
        run: MuJoCo's run.
        expected: newton_euler's run. If there is none, or a partial one, `run` is returned unchanged.
    """
    import mjcf
    from mjcf.errors import DivergenceError

    if expected is None or len(expected.time) != len(run.time):
        return run
    while _relative_deviation(scene, run, expected) > MAX_RELATIVE_ERROR:
        half = 0.5 * run.settings["timestep"]
        if scene.duration > half * MAX_RK4_STEPS:
            break
        try:
            finer = mjcf.simulate(scene, timestep=half)
        except DivergenceError:
            break
        change, run = _relative_deviation(scene, run, finer), finer
        if change < MAX_RELATIVE_ERROR:
            break
    return run


def _relative_deviation(scene: Scene, run: Trajectory, other: Trajectory) -> float:
    """Return the largest difference of two runs in poses, kinetic energy and energy balance.

    Distances are relative to the mechanism's size, angles to 1 rad, and energies to the energy of the run
    `other` or of the mechanism, whichever is larger. Energies count only if both runs have them.
    """
    deviations = [distance(run, other, length=scene.mechanism.size)]
    balance, other_balance = energy_balance(scene, run), energy_balance(scene, other)
    if balance is not None and other_balance is not None:
        assert run.kinetic_energy is not None
        assert other.kinetic_energy is not None
        unit = max(min_energy_scale(scene, [initial_state(scene)]), other_balance.scale)
        deviations.append(float(np.max(np.abs(balance.residual - other_balance.residual))) / unit)
        deviations.append(float(np.max(np.abs(run.kinetic_energy - other.kinetic_energy))) / unit)
    return max(deviations)


def _mujoco_refined(scene: Scene, in_full: bool = False) -> Trajectory:
    """Simulate a scene in MuJoCo with half the step.

    Args:
        scene: the scene.
        in_full: True to compute all outputs of the scene; False to omit reactions and actuator forces.
    """
    import mjcf

    settings = _mujoco_run(scene).settings
    step, integrator = 0.5 * settings["timestep"], settings["integrator"]
    wanted = scene if in_full else _without_forces(scene)
    return mjcf.simulate(wanted, timestep=step, integrator=integrator)


def _without_forces(scene: Scene) -> Scene:
    """Return the scene without the outputs of reactions and actuator forces.

    Comparisons do not need these outputs in refined runs, except for scenes of the library with reference
    values, which are returned unchanged.
    """
    if scene.name in REFERENCE_QUANTITIES:
        return scene
    return replace(scene, outputs=scene.outputs - FORCE_OUTPUTS)


def _mujoco_systems(scene: Scene) -> tuple[System, ...]:
    """Return MuJoCo's equations of motion with rigid constraints."""
    from mjcf.rigid import RigidMuJoCo

    return (RigidMuJoCo(scene),)


def _mujoco_soft(scene: Scene) -> Evaluation:
    """Evaluate the initial state of a scene with MuJoCo's soft constraints."""
    from mjcf.soft import SoftMuJoCo

    soft = SoftMuJoCo(scene)
    return soft.evaluate(*soft.coordinates(initial_state(scene)))


def _pinocchio_run(scene: Scene) -> Trajectory:
    """Simulate a scene in Pinocchio with default settings."""
    return _pinocchio(scene, python_options(scene, refined=False))


def _pinocchio(scene: Scene, methods: Sequence[dict[str, Any]]) -> Trajectory:
    """Simulate a scene in Pinocchio with the first options with which the run does not stop."""
    import urdf

    for method in methods[:-1]:
        with suppress(StoppedError):
            return urdf.simulate(scene, **method)
    return urdf.simulate(scene, **methods[-1])


def _pinocchio_refined(scene: Scene, in_full: bool = False) -> Trajectory:
    """Simulate a scene in Pinocchio at refined tolerances, or at looser ones if that run stops."""
    methods = python_options(scene, refined=True)
    looser = {name: LOOSER_TOLERANCE_FACTOR * methods[-1][name] for name in ("rtol", "atol")}
    return _pinocchio(scene if in_full else _without_forces(scene), [*methods, methods[-1] | looser])


def _pinocchio_systems(scene: Scene) -> tuple[System, ...]:
    """Return Pinocchio's equations of motion."""
    from urdf.dynamics import PinocchioSystem

    return (PinocchioSystem(scene),)


# The expected errors below are those of well-conditioned mechanisms; refined runs measure larger errors
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
            package="numpy",  # newton_euler has the version of crosscheck itself
            exact=_newton_euler_exact,
        ),
        # RK4 at a fixed step; MuJoCo's constraints are springs with a time constant of two steps, whose
        # effect on a run depends on the mechanism
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
        # Pinocchio uses the same methods as newton_euler, with equations evaluated in Python
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
"""All engines, by name."""


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
