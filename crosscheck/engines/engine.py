"""The engines that are compared, what each contributes, and how exact each is expected to be."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from typing import Any, Final

import numpy as np

from crosscheck.compare.check import UNRESOLVED
from crosscheck.library import FIGURES
from crosscheck.support.errors import CrosscheckError
from newton_euler.equations.system import Evaluation, System
from newton_euler.errors import NewtonEulerError, choices
from newton_euler.integrators.fixed_step import RK4_LIMIT
from newton_euler.model.scene import Scene
from newton_euler.model.trajectory import StoppedError, Trajectory, distance
from newton_euler.runs.assemble import initial_state

REFINED_RTOL, REFINED_ATOL = 1e-12, 1e-14
"""A hundredth of what runs have by default; DOP853's own limit is near 2e-14."""

EXACT_RTOL, EXACT_ATOL = 1e-13, 1e-15
"""For figures of twelve digits; round-off takes over below."""

STEPS = 500
"""Of a run in MuJoCo, at least, whatever its duration: steps of 1 ms are long for a machine that is at 1000
rad/s after 50 of them."""

HALVINGS = 4
"""Of MuJoCo's step where a run diverges. Then `IMPLICIT` is taken, of order 1, at the smallest of these."""

RK4_STEPS = 100_000
"""Largest number of steps of MuJoCo's RK4 that stability or accuracy may ask for; they take some seconds. If
the stability of stiff dampers, which are explicit in RK4, asks for more, `IMPLICIT` is used instead."""

IMPLICIT: Final = "implicitfast"

NATIVE_STABILITY_STEPS, PYTHON_STABILITY_STEPS = 100_000, 60
"""Largest numbers of steps of DOP853 for stability alone; above them Radau runs instead, see
`crosscheck.engines.stiffness`. In native code so many take some seconds. Where Python evaluates the
equations, so
many (or one for each output of the run, if these are more) cost about as much as Radau: DOP853 made 4 to 7
times as many on damped trackers and servo-driven arms, at 13 evaluations each, Radau 500 to 900 for a second
of an arm's motion, at 7."""

NATIVE_MAX_STEPS, PYTHON_MAX_STEPS = 200_000, 10_000
"""Steps of an adaptive method after which a run is given up, so that it does not last for hours."""

STIFF_RTOL, STIFF_ATOL = 1e-8, 1e-10
"""Of Radau, a method of order 5: a hundred times tighter it would need ten times as many steps."""

STIFF_REFINEMENT = 0.1
"""Of these, in refined runs."""

LESS_REFINED = 5.0
"""Factor on the tolerances of a refined run in Python that stops: accelerations of nearly singular loops and
of stiff machines hold no more digits."""


@dataclass(frozen=True)
class Engine:
    """One engine.

    Attributes:
        name: as in files and options.
        simulate: runs a scene at this engine's default settings.
        refined: runs a scene at half the step or a hundredth of the tolerance, to measure errors that
            exceed the three below.
        systems: its rigid equations of motion, for the levels before trajectories.
        trajectory_error: share of the mechanism's reach, and rad, that its own run may be off.
        drift: share of the mechanism's reach, or rad, that its joints may be open during a run.
        energy_error: by what share of the largest energy its balance may be off.
        package: name of the package that does the work, for the record of versions.
        exact: runs a scene at its most exact, for checks that are known to many digits; `refined` if None.
        soft_start: the initial state under its own constraints where they are not rigid.
        refined_in_full: as `refined`, with reactions and forces of actuators, which that may leave out;
            `refined` if None.
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
    soft_start: Callable[[Scene], Evaluation] | None = None
    refined_in_full: Callable[[Scene], Trajectory] | None = None


def native_method(scene: Scene, refined: bool) -> dict[str, Any]:
    """Choose the method, tolerances and largest number of steps for newton_euler's runs."""
    return {"most_steps": NATIVE_MAX_STEPS} | _by_stiffness(scene, NATIVE_STABILITY_STEPS, refined)


def python_method(scene: Scene, refined: bool) -> dict[str, Any]:
    """Choose the same for runs whose equations Python evaluates."""
    steps = max(PYTHON_STABILITY_STEPS, len(scene.times))
    return {"most_steps": PYTHON_MAX_STEPS} | _by_stiffness(scene, steps, refined)


def _by_stiffness(scene: Scene, stability_steps: int, refined: bool) -> dict[str, Any]:
    """Choose Radau for a scene in which stability costs DOP853 more steps than these, and tolerances."""
    from crosscheck.engines.stiffness import explicit_steps

    if explicit_steps(scene) > stability_steps:
        share = STIFF_REFINEMENT if refined else 1.0
        return {"integrator": "Radau", "rtol": share * STIFF_RTOL, "atol": share * STIFF_ATOL}
    return {"rtol": REFINED_RTOL, "atol": REFINED_ATOL} if refined else {}


@lru_cache(maxsize=1)
def native_run(scene: Scene) -> Trajectory:
    """newton_euler's run, made once for all that it is compared with."""
    from newton_euler import simulate

    return simulate(scene, **native_method(scene, refined=False))


@lru_cache(maxsize=1)
def native_refined(scene: Scene) -> Trajectory:
    """newton_euler's finer run, made once as well."""
    from newton_euler import simulate

    return simulate(scene, **native_method(scene, refined=True))


def _newton_euler_exact(scene: Scene) -> Trajectory:
    from newton_euler import simulate

    return simulate(scene, rtol=EXACT_RTOL, atol=EXACT_ATOL)


def _newton_euler_systems(scene: Scene) -> tuple[System, ...]:
    from newton_euler.compiled.formulations import FORMULATIONS, formulate

    return tuple(formulate(scene, name) for name in FORMULATIONS)


def _way(scene: Scene) -> Trajectory | None:
    """newton_euler's run as far as it comes: where other engines will come by."""
    try:
        return native_run(scene)
    except StoppedError as error:
        return error.partial
    except NewtonEulerError:
        return None


@lru_cache(maxsize=1)
def _mujoco_run(scene: Scene) -> Trajectory:
    """Run MuJoCo at its default step or a whole part of it: `STEPS` at least, stable, and without divergence.

    If the run is far from newton_euler's, the step is halved while that changes MuJoCo's run as much.
    Fast machines are beyond the accuracy of RK4 at the default step, and loops of very different masses soft.
    """
    import mjcf
    from crosscheck.engines.stiffness import is_stable_in_rk4, modes_of_run
    from mjcf.errors import DivergenceError
    from mjcf.simulate import default_timestep

    step = default_timestep(scene)
    step /= max(1.0, np.ceil(STEPS * step / scene.duration * (1.0 - 1e-9)))
    way = _way(scene)
    modes = modes_of_run(scene, way)
    halvings = max(HALVINGS, int(np.log2(max(1.0, RK4_STEPS * step / scene.duration))))
    steps = [step * 0.5**k for k in range(halvings + 1)]
    for tried in [each for each in steps if is_stable_in_rk4(modes, each)][: HALVINGS + 1]:
        with suppress(DivergenceError):
            return _resolved(scene, mjcf.simulate(scene, timestep=tried), way)
    try:
        return mjcf.simulate(scene, timestep=steps[HALVINGS], integrator=IMPLICIT)
    except DivergenceError as error:
        rate = max(0.0, -float(np.min(modes.real, initial=0.0)))
        if RK4_LIMIT / steps[-1] >= rate:
            raise
        stiff = (
            f"motions decay at up to {rate:.2g} 1/s, for which RK4 needs steps below {RK4_LIMIT / rate:.2g} s"
        )
        alone = f"{IMPLICIT} at {steps[HALVINGS]:.2g} s leaves the forces of constraints explicit"
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
        if scene.duration > half * RK4_STEPS:
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
    """The scene without the outputs that finer runs are asked for only where checks of a scene are known."""
    if scene.name in FIGURES:
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
        looser = {name: LESS_REFINED * method[name] for name in ("rtol", "atol")}
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
            soft_start=_mujoco_soft,
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
    """Engines by name, in the order given; raises `CrosscheckError` for unknown or repeated names."""
    if not names:
        raise CrosscheckError(f"no engine named; choose from: {', '.join(ENGINES)}")
    for name in names:
        if name not in ENGINES:
            raise CrosscheckError(f"unknown engine {name!r}; {choices(name, ENGINES)}")
        if names.count(name) > 1:
            raise CrosscheckError(f"engine {name!r} is named {names.count(name)} times")
    return [ENGINES[name] for name in names]
