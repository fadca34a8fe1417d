"""MuJoCo in its cheapest ways, for benchmarks; see `mjcf.tight`.

The time of a run is all steps, MuJoCo's kinematics at every output and copies of the positions and
quaternions of its bodies then. Steps from one output to the next run inside one call.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from crosscheck.studies.benchmark.work_precision import Ladder, Model, Models, Run, Setting, intervals
from newton_euler.model.scene import Scene

if TYPE_CHECKING:
    from mjcf.tight import Stepper

STEPS = (1, 2, 3, 5, 7, 10, 20, 50, 100, 200)
"""Steps from one output to the next. MuJoCo has no outputs between its steps."""

METHODS = (("RK4", 1.0), ("RK4", 0.6), ("implicitfast", 1.0), ("implicit", 1.0), ("Euler", 1.0))
"""Integrators, and the constraints' damping ratio with the stiffest time constant, two steps.

Of softer, direct (negative) and less damped constraints on the tracker, a ratio of 0.6 makes RK4 most
exact, at every step: by a third. The others hardly depend on it, and RK4 is cheaper than they are at the one
step (10 ms) where they do."""

EVALUATIONS = {"RK4": 4}
"""Of the forward dynamics a step, where it is not one."""


def models(scene: Scene, steps: Sequence[int] = STEPS) -> Models:
    """The one model that a scene has in MuJoCo, with so many steps from one output to the next."""
    return {"MJCF": lambda: _load(scene, steps)}


def _load(scene: Scene, steps: Sequence[int]) -> Model:
    from mjcf.tight import Stepper, compiled

    system = compiled(scene)
    ladders = []
    for integrator, ratio in METHODS:
        settings = []
        for number in steps:
            step = float(scene.times[1] - scene.times[0]) / number
            stepper = Stepper(system, integrator, intervals(scene.times), number, ratio)
            evaluations = EVALUATIONS.get(integrator, 1) * number * (len(scene.times) - 1)
            options = {"integrator": integrator, "number": number, "damping_ratio": ratio}
            settings.append(Setting(f"step {step:.3g} s", _runner(stepper, evaluations), options))
        ladders.append(Ladder(f"{integrator}, solref (2 steps, {ratio:g})", tuple(settings)))
    return Model(tuple(ladders), "MJCF written and compiled")


def _runner(stepper: Stepper, evaluations: int) -> Callable[[], Run]:
    def run() -> Run:
        stepper.reset()
        start = time.perf_counter()
        stepper.run()
        seconds = time.perf_counter() - start
        return Run(seconds, evaluations, stepper.poses)

    return run
