"""Simulate a scene with Drake's accelerations and newton_euler's integrators."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal, Unpack, get_args

from crosscheck.engines.drake.equations import DrakeSystem
from crosscheck.engines.drake.plant import NAME
from newton_euler.arguments import checked
from newton_euler.errors import check_choice
from newton_euler.integrators.options import IntegratorName, Options, StepControl
from newton_euler.model.scene import Scene
from newton_euler.model.trajectory import Trajectory
from newton_euler.runs.simulate import run

StabilizationName = Literal["projection", "none"]
"""How loops stay closed: by projection onto the constraints after each step, or not at all."""


@checked
def simulate(
    scene: Scene,
    integrator: IntegratorName = "DOP853",
    *,
    stabilization: StabilizationName = "projection",
    **control: Unpack[StepControl],
) -> Trajectory:
    """Simulate a scene with Drake's accelerations under rigid loop closures.

    Args:
        scene: the scene.
        integrator: one of `newton_euler.integrators.options.INTEGRATORS`.
        stabilization: "projection" or "none".
        control: options of the steps, see `newton_euler.simulate`.

    Raises:
        NewtonEulerError: for an unknown name, an impossible option, or a run that stops early, with the
            trajectory so far.
    """
    check_choice("stabilization", stabilization, get_args(StabilizationName))
    options = replace(Options.of(integrator, control), projection=stabilization == "projection")
    return run(DrakeSystem(scene), NAME, options, {"stabilization": stabilization})
