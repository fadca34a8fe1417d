"""The engines of a benchmark, each in its cheapest ways: ladders of settings from the coarsest to the finest.

A run's time is what it takes to have the poses of all bodies at all outputs, as the engine has them:

- newton_euler: `Trajectory.wall_time`, the integration and positions and quaternions of all bodies.
- MuJoCo, see `mjcf.tight`: all steps, its kinematics at every output and copies of the positions and
  quaternions of its bodies then. Steps from one output to the next run inside one call.
- Pinocchio, see `urdf.tight`: the integration, forward kinematics at every output and a copy of translations
  and rotation matrices of all joints then.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

from crosscheck.errors import CrosscheckError
from newton_euler import compile_scene
from newton_euler.integrators.compiled import FORMULATIONS, STABILIZATIONS
from newton_euler.integrators.run import load
from newton_euler.model.scene import Scene
from newton_euler.scalars import Array
from newton_euler.simulate import CompiledScene

if TYPE_CHECKING:
    from urdf.tight import Equations, Kinematics

TIGHTEST = 3e-14
"""Tightest rtol; the limit of DOP853, scipy's and newton_euler's, is 2.2e-14."""


class Run(NamedTuple):
    """One timed run.

    Attributes:
        seconds: what it took, by its own clock.
        evaluations: of the equations of motion.
        poses: works out positions (n, b, 3), m, and quaternions (n, b, 4) of the bodies, ground
            first, at the output times; not timed.
    """

    seconds: float
    evaluations: int
    poses: Callable[[], tuple[Array, Array]]


class Setting(NamedTuple):
    """One way to run a scene; `run` raises an exception that says why if it cannot."""

    name: str
    run: Callable[[], Run]


class Ladder(NamedTuple):
    """Settings of one method, from the coarsest to the finest."""

    method: str
    settings: tuple[Setting, ...]


class Model(NamedTuple):
    """A scene as loaded by an engine: its methods, and a remark about the loading."""

    ladders: tuple[Ladder, ...]
    remark: str


Models = Mapping[str, Callable[[], Model]]
"""How an engine loads a scene in each of the ways it knows, by name."""


def poses_only(scene: Scene) -> Scene:
    """Return the scene without outputs but the poses of its bodies.

    Raises:
        CrosscheckError: for a scene with a sampled controller, whose Python all engines would wait for.
    """
    if scene.sampled:
        raise CrosscheckError(
            f"scene {scene.name!r} has a sampled controller; bench needs native control laws"
        )
    return dataclasses.replace(scene, outputs=frozenset())


def intervals(times: Array) -> list[tuple[int, float]]:
    """Count equal intervals, s, between outputs, and then the last if it is shorter."""
    first, last = float(times[1] - times[0]), float(times[-1] - times[-2])
    if abs(first - last) <= 1e-9 * first:
        return [(len(times) - 1, first)]
    return [(len(times) - 2, first), (1, last)]


def _steps(scene: Scene, numbers: Iterable[int]) -> Iterator[tuple[int, float, str]]:
    """Yield numbers of fixed steps from one output to the next, the steps, s, and their names."""
    for number in numbers:
        step = float(scene.times[1] - scene.times[0]) / number
        yield number, step, f"step {step:.3g} s"


def _tolerances(powers: Iterable[int]) -> Iterator[tuple[float, str]]:
    """Yield rtol at half decades, with their names."""
    for rtol in (base * 10.0**-power for power in powers for base in (1.0, 0.3)):
        if rtol >= TIGHTEST:
            yield rtol, f"rtol {rtol:.0e}"


# newton_euler

SHARES = (1.0, 1e-2)
"""atol, in units of rtol."""

STIFF = ("relative", "projection")
"""What Radau runs. The Jacobian of Cartesian coordinates would take half a minute to compile."""


def _newton_euler(scene: Scene) -> Models:
    """Return a model for each formulation and stabilization."""
    return {
        f"{formulation}, {stabilization}": partial(_load_own, scene, formulation, stabilization)
        for formulation in FORMULATIONS
        for stabilization in STABILIZATIONS
    }


def _load_own(scene: Scene, formulation: str, stabilization: str) -> Model:
    compiled = compile_scene(scene, formulation=formulation, stabilization=stabilization)
    load(compiled, "Euler")
    adaptive = [("DOP853", range(2, 14), share) for share in SHARES]
    if (formulation, stabilization) == STIFF:
        load(compiled, "Radau")
        adaptive.append(("Radau", range(2, 10), SHARES[1]))
    prefix = f"{formulation}, {stabilization}"
    ladders = []
    for integrator, powers, share in adaptive:
        settings = [
            Setting(name, partial(_run_own, compiled, integrator, rtol=rtol, atol=share * rtol))
            for rtol, name in _tolerances(powers)
        ]
        ladders.append(Ladder(f"{prefix}, {integrator}, atol = {share:g} rtol", tuple(settings)))
    for integrator in ("RK4", "Euler"):
        settings = [
            Setting(name, partial(_run_own, compiled, integrator, step=step))
            for _, step, name in _steps(scene, (1, 2, 5, 10, 20, 50))
        ]
        ladders.append(Ladder(f"{prefix}, {integrator}", tuple(settings)))
    source = "loaded from the cache" if compiled.from_cache else "compiled"
    remark = f"traced {compiled.trace_time:.2f} s, {source} {compiled.compile_time:.2f} s"
    return Model(tuple(ladders), remark)


def _run_own(compiled: CompiledScene, integrator: str, **options: Any) -> Run:
    found = compiled.simulate(integrator, **options)
    return Run(found.wall_time, found.settings["evaluations"], lambda: (found.position, found.quaternion))


# MuJoCo

STEPS = (1, 2, 3, 5, 7, 10, 20, 50, 100, 200)
"""MuJoCo's steps from one output to the next. It has no outputs between its steps."""

METHODS = (("RK4", 1.0), ("RK4", 0.6), ("implicitfast", 1.0), ("implicit", 1.0), ("Euler", 1.0))
"""Integrators, and the constraints' damping ratio with the stiffest time constant, two steps.

Of softer, direct (negative) and less damped constraints on the tracker, a ratio of 0.6 makes RK4 most
exact, at every step: by a third. The others hardly depend on it, and RK4 is cheaper than they are at the one
step (10 ms) where they do."""


def _mujoco(scene: Scene) -> Models:
    return {"MJCF": partial(_load_mujoco, scene)}


def _load_mujoco(scene: Scene) -> Model:
    from mjcf.tight import Stepper, compiled

    system = compiled(scene)
    ladders = []
    for integrator, ratio in METHODS:
        settings = []
        for number, _, name in _steps(scene, STEPS):
            stepper = Stepper(system, integrator, intervals(scene.times), number, ratio)
            evaluations = (4 if integrator == "RK4" else 1) * number * (len(scene.times) - 1)
            settings.append(Setting(name, partial(_run_mujoco, stepper, evaluations)))
        ladders.append(Ladder(f"{integrator}, solref (2 steps, {ratio:g})", tuple(settings)))
    return Model(tuple(ladders), "MJCF written and compiled")


def _run_mujoco(stepper: Any, evaluations: int) -> Run:
    stepper.reset()
    start = time.perf_counter()
    stepper.run()
    return Run(time.perf_counter() - start, evaluations, stepper.poses)


# Pinocchio

ALPHAS = (0.0, 3.0, 10.0)
"""1/s, of Baumgarte's gains. On the tracker 30 is no better than 10, and 100 is stiff."""


def _pinocchio(scene: Scene) -> Models:
    """Return a model for each Baumgarte gain.

    Its accelerations are those of `constraintDynamics`: those of `lcaba` are no smoother than 1e-9, and
    methods with error control stall on the noise.
    """
    return {
        f"constraintDynamics, alpha {alpha:g}": partial(_load_pinocchio, scene, alpha) for alpha in ALPHAS
    }


def _load_pinocchio(scene: Scene, alpha: float) -> Model:
    from urdf.tight import Kinematics, equations_of

    equations, ladders = equations_of(scene, alpha, None), []
    kinematics = Kinematics(equations)
    for share in SHARES:
        settings = [
            Setting(name, partial(_run_pinocchio, equations, kinematics, rtol, share * rtol))
            for rtol, name in _tolerances(range(1, 14))
        ]
        method = f"constraintDynamics, alpha {alpha:g}, LSODA, atol = {share:g} rtol"
        ladders.append(Ladder(method, tuple(settings)))
    return Model(tuple(ladders), "URDF written and read, model built")


def _run_pinocchio(equations: Equations, kinematics: Kinematics, rtol: float, atol: float) -> Run:
    from urdf.tight import lsoda

    start = time.perf_counter()
    rows, evaluations = lsoda(equations, rtol, atol)
    placements = kinematics(rows)
    seconds = time.perf_counter() - start
    return Run(seconds, evaluations, partial(kinematics.poses, placements))


ENGINES: dict[str, Callable[[Scene], Models]] = {
    "newton_euler": _newton_euler,
    "mujoco": _mujoco,
    "pinocchio": _pinocchio,
}

JUDGED = "newton_euler"
"""The engine that the others are compared with."""
