"""Simulate a scene with Pinocchio's accelerations and newton_euler's integrators.

A scene is a mechanism with its forces, control laws and initial state. `urdf.dynamics` has the accelerations.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Unpack

from newton_euler.arguments import checked
from newton_euler.integrators.options import (
    RUN_ARGUMENTS,
    IntegratorName,
    Options,
    StabilizationName,
    StepControl,
    baumgarte_alpha,
)
from newton_euler.model.scene import Scene
from newton_euler.model.trajectory import Trajectory
from newton_euler.runs.simulate import run


@checked
def simulate(
    scene: Scene,
    integrator: IntegratorName = "DOP853",
    *,
    stabilization: StabilizationName = "projection",
    alpha: float | None = None,
    **control: Unpack[StepControl],
) -> Trajectory:
    """Simulate a scene with Pinocchio's accelerations under rigid loop closures.

    Args:
        scene: scene to simulate, passed to Pinocchio as URDF and loop file.
        integrator: "DOP853", "Radau", "RK4" or "Euler", as of `newton_euler.simulate`.
        stabilization: how loops stay closed: "projection" onto the constraints after each step, "baumgarte"
            (Pinocchio's corrector gains) or "none".
        alpha: parameter, 1/s, of Baumgarte's gains K_D = 2 alpha, K_P = alpha^2; None for 10.
        control: options of the steps, see `StepControl`.

    Raises:
        NewtonEulerError: for an unknown name, an impossible option, or a run that stops early.
        UrdfError: for a mechanism that a URDF cannot represent.

    Examples:
        >>> urdf.simulate(load("pendulum"), rtol=1e-8)
        <Trajectory of pinocchio: 1001 outputs to 10 s, bodies: 2, joints: 1>
    """
    from urdf.dynamics import PinocchioSystem

    alpha = baumgarte_alpha(stabilization, alpha)  # 0 without Baumgarte stabilization
    projection = stabilization == "projection"
    options = replace(Options.of(integrator, control, RUN_ARGUMENTS), projection=projection)
    settings: dict[str, Any] = {"stabilization": stabilization}  # to be stored in the trajectory
    if stabilization == "baumgarte":
        settings["alpha"] = alpha
    system = PinocchioSystem(scene, alpha)
    return run(system, "pinocchio", options, settings)
