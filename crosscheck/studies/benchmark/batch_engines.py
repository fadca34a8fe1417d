"""Engines of the batch benchmark: simulate many runs of one scene at once, with the options of a setting.

A setting is a method with its step or tolerance; the settings of a method form a ladder, from coarse to fine.
newton_euler computes the poses of all bodies at all output times. It simulates several runs at once, one in
each lane (element) of the processor's vector registers, or one run after another in scalar code.
`mujoco.rollout` returns MuJoCo's full physics state (time, qpos, qvel) after every step; qpos at the output
times is kept, and no poses are computed.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from itertools import product
from typing import NamedTuple, Protocol

import numpy as np

from crosscheck.studies.benchmark.ladders import (
    BASELINE_ENGINE,
    STEPS_PER_OUTPUT,
    Ladder,
    Options,
    Poses,
    adaptive_ladders,
    mujoco_ladders,
    output_interval,
)
from newton_euler.compiled.formulations import FORMULATIONS
from newton_euler.compiled.lanes import load_lanes
from newton_euler.compiled.outputs import named
from newton_euler.compiled.run import Integrator
from newton_euler.integrators.options import STABILIZATIONS
from newton_euler.integrators.options import Options as IntegratorOptions
from newton_euler.model.scene import Scene
from newton_euler.model.state import State
from newton_euler.model.trajectory import IntegrationError
from newton_euler.runs.batch import simulate_batch
from newton_euler.runs.simulate import compile_scene

TOLERANCES_PER_DECADE = 8
"""Number of newton_euler's tolerances per factor of ten, as dense as MuJoCo's steps."""


class CompletedBatch(NamedTuple):
    """A batch that was simulated.

    Attributes:
        seconds: duration of the simulation, s.
        setup: duration before the simulation of loading the scene and converting states for the engine, s.
        poses: computes the poses of each run, positions and quaternions of all bodies at all output times;
            raises the error of a run that failed.
        failed: number of runs that failed.
    """

    seconds: float
    setup: float
    poses: Callable[[], list[Poses]]
    failed: int = 0


class Engine(Protocol):
    """An engine that simulates batches of one scene.

    Attributes:
        name: name of the engine.
        delivers: description of the results whose computation is included in the time.
    """

    name: str
    delivers: str

    def ladders(self) -> Iterator[Ladder]:
        """Yield a ladder for each method: its settings, numbered from coarse to fine."""

    def run(self, options: Options, states: Sequence[State], threads: int) -> CompletedBatch:
        """Simulate one run from each state, with the options of a setting, on a number of threads."""


class NewtonEulerBatch:
    """newton_euler with several runs at once in vector registers.

    The settings are those of the integrators with error control; fixed steps are slower at every error. A
    formulation is a choice of coordinates (of joints or of bodies), a stabilization a method that keeps
    constraint violations small.
    """

    name = BASELINE_ENGINE
    delivers = "poses of all bodies at all outputs"

    def __init__(self, scene: Scene) -> None:
        self._scene = scene

    def ladders(self) -> Iterator[Ladder]:
        """Yield the settings of each formulation, stabilization and integrator; compile their code."""
        for formulation, stabilization in product(FORMULATIONS, STABILIZATIONS):
            compiled = compile_scene(self._scene, formulation, stabilization)
            equations = {"formulation": formulation, "stabilization": stabilization}
            for ladder in adaptive_ladders(formulation, stabilization, TOLERANCES_PER_DECADE):
                load_lanes(compiled, ladder.common["integrator"])  # compile before a sample is timed
                # `common` has the options that all settings of the ladder share
                yield ladder._replace(common=ladder.common | equations)

    def run(self, options: Options, states: Sequence[State], threads: int) -> CompletedBatch:
        """Simulate one run from each state."""
        start = time.perf_counter()
        batch = simulate_batch(self._scene, states, threads=threads, **options)
        return CompletedBatch(
            seconds=batch.wall_time,
            setup=time.perf_counter() - start - batch.wall_time,
            poses=lambda: [(run.position, run.quaternion) for run in batch],
            failed=len(batch.errors),
        )


class NewtonEulerScalar(NewtonEulerBatch):
    """newton_euler's scalar code, which simulates one run after another."""

    name = f"{BASELINE_ENGINE}, one by one"
    delivers = "the same, by scalar code"

    def run(self, options: Options, states: Sequence[State], threads: int) -> CompletedBatch:
        """Simulate one run from each state on one thread; `threads` is not used."""
        # Setup: compile the scene, and convert the states to its coordinates
        start = time.perf_counter()
        equations = {name: options[name] for name in ("formulation", "stabilization")}
        compiled = compile_scene(self._scene, **equations)
        chosen = IntegratorOptions(
            **{name: value for name, value in options.items() if name not in equations}
        )
        # an input vector x has coordinates and velocities, `compiled.size` numbers, then the time and more
        starts = np.tile(compiled.start, (len(states), 1))
        for x, state in zip(starts, states, strict=True):
            x[: compiled.size] = np.concatenate(compiled.system.coordinates(state))
        integrator = Integrator(compiled, self._scene.times, chosen)
        results, failed = np.empty((len(states), *integrator.outputs.shape)), 0
        # Simulation: integrate from x, then compute the outputs of the run
        run_start = time.perf_counter()
        for x, result in zip(starts, results, strict=True):
            try:
                integrator(x)
                integrator.outputs(result)
            except IntegrationError:
                failed += 1
        seconds = time.perf_counter() - run_start

        def poses() -> list[Poses]:
            """Return the poses of all runs; `named` divides the flat outputs of a run into arrays by name."""
            arrays = [named(compiled, result) for result in results]
            return [(each["position"], each["quaternion"]) for each in arrays]

        return CompletedBatch(seconds, setup=run_start - start, poses=poses, failed=failed)


class MuJoCoRollout:
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
        from mjcf.benchmark_kernels import compiled

        self._system = compiled(scene)
        self._interval = output_interval(scene)
        self._max_steps = max(1, round(self._interval / period * STEPS_PER_OUTPUT[-1]))

    def ladders(self) -> Iterator[Ladder]:
        """Yield the settings of each integrator: all numbers of steps per output interval."""
        yield from mujoco_ladders(self._interval, range(1, self._max_steps + 1))

    def run(self, options: Options, states: Sequence[State], threads: int) -> CompletedBatch:
        """Simulate one run from each state."""
        from mjcf.benchmark_kernels import Rollout, physics_states

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
