"""Benchmarks of Exudyn: its implicit integrators with steps from coarse to fine.

The time of a run is that of all steps, with a call of Python after each of them that copies the state at
outputs. Forces that Exudyn does not have, such as wind, are evaluated by Python and are part of the time.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from crosscheck.engines.benchmarks import (
    Benchmarks,
    Model,
    Models,
    Options,
    Poses,
    Run,
    output_interval,
    poses_only,
    step_ladder,
)
from crosscheck.engines.exudyn.limits import limits
from crosscheck.engines.exudyn.run import INTEGRATORS
from crosscheck.engines.exudyn.simulate import run as solve
from crosscheck.engines.limits import require_expressed
from newton_euler.model.scene import Scene

STEPS_PER_OUTPUT = (1, 2, 5, 10, 20, 50, 100)
"""Numbers of steps from one output to the next. With outputs every 10 ms they give errors from above 1e-3 to
about 1e-6 m or rad, or to the time limit of a run."""


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
        done = solve(scene, **options)
        if done.stopped:
            raise done.stopped

        def poses() -> Poses:
            states = [output.equations.state(output.q, output.v) for output in done.outputs]
            return np.array([s.position for s in states]), np.array([s.quaternion for s in states])

        # the equations are solved once per step
        return Run(done.wall_time, done.settings["steps"], poses)

    ladders = [
        step_ladder(integrator, "step", output_interval(scene), STEPS_PER_OUTPUT, integrator=integrator)
        for integrator in INTEGRATORS
    ]
    return Model(ladders, run)


BENCHMARKS = Benchmarks(models=_models)
