"""Benchmarks of MuJoCo: integrators and constraint solvers at several steps, and batches by `mujoco.rollout`.

The time of a run is that of all steps, of kinematics at every output, and of copies of positions and
quaternions there. The steps from one output to the next run inside one call. `mujoco.rollout` returns the
full physics state (time, qpos, qvel) after every step; qpos at the output times is kept, and no poses are
computed.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from functools import partial
from timeit import Timer

import numpy as np

from crosscheck.engines.benchmarks import (
    Benchmarks,
    CompletedBatch,
    Ladder,
    Model,
    Models,
    Options,
    RightHandSide,
    Run,
    output_interval,
    step_ladder,
)
from mjcf.benchmark_kernels import Rollout, Stepper, compiled, forward, physics_states, steps
from mjcf.constraint_solver import SOLVERS
from newton_euler.model.scene import Scene
from newton_euler.model.state import State
from newton_euler.scalars import Array

STEPS_PER_OUTPUT = (1, 2, 3, 5, 7, 10, 20, 50, 100, 200)
"""Numbers of MuJoCo's steps from one output to the next; MuJoCo has outputs only at its steps."""

METHODS = (("RK4", 1.0), ("RK4", 0.6), ("implicitfast", 1.0), ("implicit", 1.0), ("Euler", 1.0))
"""MuJoCo's integrators, each with the damping ratio of the constraints, the second number of `solref`.

The time constant of the constraints, the first number of `solref`, is two steps, the stiffest stable value.
With the scene `tracker`, softer constraints, constraints with negative `solref` (stiffness and damping), and
other damping ratios were tried. A ratio of 0.6 makes RK4 a third more accurate at every step. Other
integrators depend on the ratio only at a step of 10 ms, where RK4 is faster.
"""


def ladders(interval: float, numbers: Sequence[int] = STEPS_PER_OUTPUT) -> list[Ladder]:
    """Make the ladders of MuJoCo's integrators.

    Args:
        interval: time between outputs, s.
        numbers: numbers of steps from one output to the next.
    """
    return [
        step_ladder(
            f"{integrator}, solref (2 steps, {ratio:g})",
            "number",
            interval,
            numbers,
            integrator=integrator,
            damping_ratio=ratio,
        )
        for integrator, ratio in METHODS
    ]


STEPS_OF_SOLVERS = (1, 5, 20, 100)
"""Numbers of steps from one output to the next with other constraint solvers than Newton's method. Their
errors are those of Newton's method at the same step unless they end before they converge."""


def solver_ladders(interval: float) -> list[Ladder]:
    """Make the ladders of RK4 with the constraint solvers CG and PGS; `ladders` have Newton's method.

    Args:
        interval: time between outputs, s.
    """
    return [
        step_ladder(
            f"RK4, {solver}, solref (2 steps, 1)",
            "number",
            interval,
            STEPS_OF_SOLVERS,
            integrator="RK4",
            damping_ratio=1.0,
            solver=solver,
        )
        for solver in SOLVERS
        if solver != "Newton"
    ]


def _models(scene: Scene) -> Models:
    """Return the function that loads a scene into MuJoCo."""
    return {"MJCF": partial(_load, scene)}


def _load(scene: Scene) -> Model:
    """Compile a scene for MuJoCo."""
    system = compiled(scene)
    outputs = intervals(scene.times)

    def run(options: Options) -> Run:
        stepper = Stepper(system, intervals=outputs, **options)
        stepper.reset()
        start = time.perf_counter()
        stepper.run()
        seconds = time.perf_counter() - start
        # one evaluation of the equations per stage of each step; only RK4 has several stages
        stages = 4 if options["integrator"] == "RK4" else 1
        return Run(seconds, stages * options["number"] * (len(scene.times) - 1), stepper.poses)

    interval = output_interval(scene)
    # other solvers make the same run of a scene without constraints
    of_solvers = solver_ladders(interval) if system.model.neq else []
    return Model(ladders(interval) + of_solvers, run)


def intervals(times: Array) -> list[tuple[int, float]]:
    """Return the intervals between output times (n,), s, as MuJoCo's stepper takes them.

    All intervals are equally long, except that the last one may be shorter.

    Returns:
        In order of time, pairs of a number of equal intervals and their length, s.
    """
    first, last = float(times[1] - times[0]), float(times[-1] - times[-2])
    if abs(first - last) <= 1e-9 * first:
        return [(len(times) - 1, first)]
    return [(len(times) - 2, first), (1, last)]


def _mj_forward(scene: Scene) -> RightHandSide:
    """Make MuJoCo's right-hand side, called from Python."""
    return RightHandSide(Timer(forward(scene)).timeit)


def _mj_step(scene: Scene) -> RightHandSide:
    """Make MuJoCo's steps with the Euler integrator, in a loop in C; a step evaluates the equations once."""
    take_steps = steps(scene)
    return RightHandSide(lambda count: Timer(partial(take_steps, count)).timeit(1))


class Batch:
    """`mujoco.rollout`, MuJoCo's function for batches. It writes the full physics state after every step."""

    name = "mujoco"
    delivers = "time, qpos and qvel after every step, of which qpos at outputs is kept"

    def __init__(self, scene: Scene, period: float) -> None:
        """Compile the scene for MuJoCo.

        Args:
            scene: the scene of the batch.
            period: output period of the benchmark of whole runs, s. The shortest step of that benchmark is
                also the shortest step of batches.
        """
        self._system = compiled(scene)
        self._interval = output_interval(scene)
        self._max_steps = max(1, round(self._interval / period * STEPS_PER_OUTPUT[-1]))

    def ladders(self) -> Iterator[Ladder]:
        """Yield the settings of each integrator: all numbers of steps per output interval."""
        yield from ladders(self._interval, range(1, self._max_steps + 1))

    def run(self, options: Options, states: Sequence[State], threads: int) -> CompletedBatch:
        """Simulate one run from each state."""
        # Setup
        start = time.perf_counter()
        rollout = Rollout(self._system, **options, threads=threads)
        coordinates = [self._system.coordinates(state) for state in states]
        starts = physics_states(self._system, *map(np.array, zip(*coordinates, strict=True)))
        # Simulation
        run_start = time.perf_counter()
        runs = rollout(starts)
        seconds = time.perf_counter() - run_start
        return CompletedBatch(
            seconds, setup=run_start - start, poses=lambda: [rollout.poses(qpos) for qpos in runs]
        )


BENCHMARKS = Benchmarks(
    models=_models,
    right_hand_sides={"mj_forward": _mj_forward, "mj_step Euler in C": _mj_step},
    batch=Batch,
)
