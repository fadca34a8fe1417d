"""Scene in, Trajectory out, by Pinocchio."""

from __future__ import annotations

from typing import Any

from newton_euler.errors import check_type
from newton_euler.integrators.compiled import PAPER_ALPHA, baumgarte_alpha
from newton_euler.integrators.options import IntegratorName, Options, StabilizationName
from newton_euler.model.scene import Scene
from newton_euler.model.trajectory import Trajectory
from newton_euler.simulate import run


def simulate(
    scene: Scene,
    integrator: IntegratorName = "DOP853",
    rtol: float = 1e-10,
    atol: float = 1e-12,
    step: float | None = None,
    stabilization: StabilizationName = "projection",
    alpha: float = PAPER_ALPHA,
    most_steps: int | None = None,
) -> Trajectory:
    """Run a scene with Pinocchio's accelerations under rigid closures.

    Args:
        scene: what to run; its URDF and loop file are made on the way.
        integrator: one of `newton_euler.integrators.options.INTEGRATORS`.
        rtol: relative error control of adaptive integrators.
        atol: absolute error control, see `newton_euler.integrators.options.Options`.
        step: s, of those with fixed steps.
        stabilization: "projection" after each step, "baumgarte" (Pinocchio's own corrector gains) or "none".
        alpha: 1/s, of Baumgarte's gains K_D = 2 alpha, K_P = alpha^2.
        most_steps: after which an adaptive method gives up; see `newton_euler.integrators.options.Options`.

    Raises:
        NewtonEulerError: for an unknown name, an impossible option, or a run that cannot go on.
        UrdfError: for a mechanism that a URDF cannot hold.

    Examples:
        >>> urdf.simulate(load("pendulum"), rtol=1e-8)
        <Trajectory of pinocchio: 1001 outputs to 10 s, bodies: 2, joints: 1>
    """
    check_type("scene", scene, Scene)
    from urdf.dynamics import PinocchioSystem

    system = PinocchioSystem(scene, baumgarte_alpha(stabilization, alpha))
    settings: dict[str, Any] = {"stabilization": stabilization}
    if stabilization == "baumgarte":
        settings["alpha"] = alpha
    projected = stabilization == "projection"
    options = Options(integrator, rtol, atol, step, most_steps, projection=projected)
    return run(system, "pinocchio", options, settings)
