"""Scene in, Trajectory out."""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from newton_euler.cartesian import Cartesian
from newton_euler.errors import UnknownNameError
from newton_euler.euler_parameters import continuous
from newton_euler.integrate import Options, Solution, integrate
from newton_euler.relative import Relative
from newton_euler.scalars import Array
from newton_euler.scene import Scene
from newton_euler.stabilize import PAPER_ALPHA, baumgarte_alpha, joint_violations
from newton_euler.state import Evaluation
from newton_euler.system import System
from newton_euler.trajectory import Trajectory

FORMULATIONS: dict[str, type[Relative] | type[Cartesian]] = {
    "relative": Relative,
    "cartesian": Cartesian,
}


COMPILED = ("DOP853", "RK4", "Euler")
"""Integrators that run in native code; Radau runs through scipy."""


def formulate(scene: Scene, formulation: str = "relative", alpha: float = 0.0) -> Relative | Cartesian:
    """Equations of motion of a scene in one of the `FORMULATIONS`; alpha is Baumgarte's, 1/s."""
    if formulation not in FORMULATIONS:
        raise UnknownNameError("formulation", formulation, tuple(FORMULATIONS))
    return FORMULATIONS[formulation](scene, alpha)


def simulate(
    scene: Scene,
    formulation: str = "relative",
    integrator: str = "DOP853",
    rtol: float = 1e-10,
    atol: float = 1e-12,
    step: float | None = None,
    stabilization: str = "projection",
    alpha: float = PAPER_ALPHA,
) -> Trajectory:
    """Run a scene with this package's own equations.

    Args:
        scene: what to run.
        formulation: "relative" (joint coordinates) or "cartesian" (the paper's equation 21).
        integrator: "DOP853", "Radau", "RK4" or "Euler" (semi-implicit).
        rtol, atol: error control of the first two.
        step: s, of the last two.
        stabilization: "projection", "baumgarte" or "none".
        alpha: 1/s, of Baumgarte's gains K_D = 2 alpha, K_P = alpha^2.

    Raises:
        NewtonEulerError: for an unknown name, an impossible option, or a run that cannot go on.
    """
    system = formulate(scene, formulation, baumgarte_alpha(stabilization, alpha))
    settings: dict[str, Any] = {"formulation": formulation, "stabilization": stabilization}
    if stabilization == "baumgarte":
        settings["alpha"] = alpha
    options = Options(integrator, rtol, atol, step, stabilization == "projection")
    if integrator not in COMPILED:
        return run(system, "newton_euler", options, settings)

    from newton_euler.compiled import CompiledSystem
    from newton_euler.fast import march, outputs

    start = time.perf_counter()
    compiled = CompiledSystem(system)
    compiled.load()
    settings["compile_time"] = time.perf_counter() - start
    q, v = system.coordinates(scene.initial_state)
    start = time.perf_counter()
    solution = march(compiled, q, v, scene.times, options)
    wall_time = time.perf_counter() - start
    arrays = outputs(compiled, scene.times, solution)
    if "violation" in scene.outputs:
        arrays["constraint_violation"] = _by_joint(scene, arrays.pop("phi"))
    settings |= _used(options, solution)
    return _trajectory(scene, "newton_euler", settings, wall_time, arrays)


def _by_joint(scene: Scene, phi: Array) -> Array:
    """(n, j) largest residual of each joint out of all residuals (n, k)."""
    ends = np.cumsum([equations.count for equations in scene.mechanism.equations])
    parts = np.split(np.abs(phi), ends[:-1], axis=1)
    return np.stack([np.max(part, axis=1, initial=0.0) for part in parts], axis=1)


def _used(options: Options, solution: Solution) -> dict[str, Any]:
    """What a run was asked for and what it took."""
    chosen = {"step": options.step} if options.step else {"rtol": options.rtol, "atol": options.atol}
    counts = {"steps": solution.steps, "evaluations": solution.evaluations}
    return {"integrator": options.integrator} | chosen | counts


def run(system: System, engine: str, options: Options, settings: dict[str, Any]) -> Trajectory:
    """Integrate any system of equations over its scene.

    `settings` describes the system; the integrator's options and counts are added to it.
    """
    scene = system.scene
    q, v = system.coordinates(scene.initial_state)
    start = time.perf_counter()
    solution = integrate(system, q, v, scene.times, options)
    wall_time = time.perf_counter() - start
    evaluations = [system.evaluate(*row) for row in zip(solution.q, solution.v, strict=True)]
    return trajectory_from(scene, engine, settings | _used(options, solution), wall_time, evaluations)


def trajectory_from(
    scene: Scene, engine: str, settings: dict[str, Any], wall_time: float, evaluations: list[Evaluation]
) -> Trajectory:
    """The trajectory of a scene from an engine's evaluations at the output times."""
    mechanism = scene.mechanism
    states = [evaluation.state for evaluation in evaluations]
    optional: dict[str, dict[str, Any]] = {
        "velocities": {
            "linear_velocity": [s.linear_velocity for s in states],
            "angular_velocity": [s.angular_velocity for s in states],
        },
        "reactions": {
            "reaction_force": [e.reaction_force for e in evaluations],
            "reaction_torque": [e.reaction_torque for e in evaluations],
        },
        "actuation": {"actuator_force": [e.actuator_force for e in evaluations]},
        "energy": {
            "kinetic_energy": [e.kinetic_energy for e in evaluations],
            "potential_energy": [e.potential_energy for e in evaluations],
        },
    }
    arrays = {
        name: np.array(rows)
        for output, columns in optional.items()
        if output in scene.outputs
        for name, rows in columns.items()
    }
    if "violation" in scene.outputs:
        arrays["constraint_violation"] = np.array([joint_violations(mechanism, s) for s in states])
    arrays["position"] = np.array([s.position for s in states])
    arrays["quaternion"] = np.array([s.quaternion for s in states])
    return _trajectory(scene, engine, settings, wall_time, arrays)


def _trajectory(
    scene: Scene, engine: str, settings: dict[str, Any], wall_time: float, arrays: dict[str, Array]
) -> Trajectory:
    arrays["quaternion"] = continuous(arrays["quaternion"], scene.initial_state.quaternion)
    return Trajectory(
        engine=engine,
        settings=settings,
        wall_time=wall_time,
        time=scene.times,
        body_names=scene.mechanism.body_names,
        joint_names=scene.mechanism.joint_names,
        **arrays,
    )
