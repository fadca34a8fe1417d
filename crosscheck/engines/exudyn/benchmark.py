"""Benchmarks of Exudyn: its implicit integrators with steps from coarse to fine.

The time of a run is that of all steps, with a call of Python after each of them that copies the state at
outputs. Forces that Exudyn does not have, such as wind, are evaluated by Python and are part of the time.
"""

from __future__ import annotations

from functools import partial

from crosscheck.engines.benchmarks import (
    Benchmarks,
    Model,
    Models,
    Options,
    Run,
    output_interval,
    poses_only,
    step_ladder,
)
from crosscheck.engines.exudyn.limits import limits
from crosscheck.engines.exudyn.run import INTEGRATORS
from crosscheck.engines.exudyn.simulate import simulate
from crosscheck.engines.limits import require_expressed
from newton_euler.model.scene import Scene

STEPS_PER_OUTPUT = (1, 2, 3, 5, 7, 10, 20, 50, 100)
"""Numbers of steps from one output to the next."""


def _models(scene: Scene) -> Models:
    """Return the function that prepares a scene for Exudyn, by the name of its coordinates."""
    return {"Euler parameters": partial(_load, scene)}


def _load(scene: Scene) -> Model:
    """Prepare a scene for Exudyn.

    Raises:
        CannotExpressError: for a scene with limits.
    """
    require_expressed("exudyn", limits(scene))
    scene = poses_only(scene)

    def run(options: Options) -> Run:
        trajectory = simulate(scene, **options)
        # the equations are solved once per step
        steps = trajectory.settings["steps"]
        return Run(trajectory.wall_time, steps, lambda: (trajectory.position, trajectory.quaternion))

    ladders = [
        step_ladder(integrator, "step", output_interval(scene), STEPS_PER_OUTPUT, integrator=integrator)
        for integrator in INTEGRATORS
    ]
    return Model(ladders, run)


BENCHMARKS = Benchmarks(models=_models)
