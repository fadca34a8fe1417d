"""Scene in, Trajectory out, by Pinocchio."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Unpack

from newton_euler.arguments import checked
from newton_euler.errors import OptionError
from newton_euler.integrators.options import (
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
    """Run a scene with Pinocchio's accelerations under rigid closures.

    Args:
        scene: what to run; its URDF and loop file are made on the way.
        integrator: one of `newton_euler.integrators.options.INTEGRATORS`.
        stabilization: "projection" after each step, "baumgarte" (Pinocchio's own corrector gains) or "none".
        alpha: 1/s, of Baumgarte's gains K_D = 2 alpha, K_P = alpha^2; the paper's 10 if None.
        control: of steps, see `newton_euler.simulate`.

    Raises:
        NewtonEulerError: for an unknown name, an impossible option, or a run that cannot go on.
        UrdfError: for a mechanism that a URDF cannot hold.

    Examples:
        >>> urdf.simulate(load("pendulum"), rtol=1e-8)
        <Trajectory of pinocchio: 1001 outputs to 10 s, bodies: 2, joints: 1>
    """
    from urdf.dynamics import PinocchioSystem

    gain = baumgarte_alpha(stabilization, alpha)
    options = replace(Options.of(integrator, control), projection=stabilization == "projection")
    if options.rest:
        raise OptionError("rest", options.rest, "0: Pinocchio's runs make their steps at rest, too")
    settings: dict[str, Any] = {"stabilization": stabilization}
    if stabilization == "baumgarte":
        settings["alpha"] = gain
    system = PinocchioSystem(scene, gain)
    return run(system, "pinocchio", options, settings)
