"""Benchmarks of newton_euler: formulations, stabilizations and integrators, and batches in vector registers.

The time of a run is that of the integration and of the positions and quaternions of all bodies
(`Trajectory.wall_time`). newton_euler simulates several runs at once, one in each lane (element) of the
processor's vector registers, or one run after another in scalar code.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from functools import partial
from itertools import product

import numpy as np

from crosscheck.engines.benchmarks import (
    ATOL_PER_RTOL,
    FINEST_DECADE,
    Benchmarks,
    CompletedBatch,
    Ladder,
    Model,
    Models,
    Options,
    Poses,
    RightHandSide,
    Run,
    output_interval,
    step_ladder,
    tolerance_ladder,
)
from newton_euler.compiled.formulations import FORMULATIONS
from newton_euler.compiled.lanes import load_lanes
from newton_euler.compiled.outputs import named, time_function
from newton_euler.compiled.run import Integrator, load_code
from newton_euler.integrators.options import STABILIZATIONS, FormulationName, StabilizationName
from newton_euler.integrators.options import Options as IntegratorOptions
from newton_euler.model.scene import Scene
from newton_euler.model.state import State
from newton_euler.model.trajectory import IntegrationError
from newton_euler.runs.batch import simulate_batch
from newton_euler.runs.simulate import compile_scene

FINEST_RADAU_DECADE = 9.5
"""Negative decimal logarithm of Radau's finest rtol, 3e-10. Radau has order 5, and would need too many steps
at finer tolerances."""

RADAU_VARIANT = ("relative", "projection")
"""Formulation and stabilization with which the integrator Radau runs.

In Cartesian coordinates, the Jacobian that Radau needs would compile for half a minute.
"""

TOLERANCES_PER_DECADE = 8
"""Number of newton_euler's tolerances per factor of ten, as dense as MuJoCo's steps."""


def adaptive_ladders(formulation: str, stabilization: str, per_decade: int = 2) -> list[Ladder]:
    """Make the ladders of newton_euler's integrators with error control, all from rtol 10^-2 on.

    Args:
        formulation: coordinates of the equations: "relative" (of joints) or "cartesian" (of bodies).
        stabilization: method that keeps constraint violations small.
        per_decade: number of tolerances per factor of ten.
    """
    prefix = f"{formulation}, {stabilization}"
    kinds = [("DOP853", FINEST_DECADE, ratio) for ratio in ATOL_PER_RTOL]
    if (formulation, stabilization) == RADAU_VARIANT:
        kinds.append(("Radau", FINEST_RADAU_DECADE, ATOL_PER_RTOL[1]))
    return [
        tolerance_ladder(
            f"{prefix}, {name}",
            coarsest=2.0,
            finest=finest,
            atol_per_rtol=ratio,
            per_decade=per_decade,
            integrator=name,
        )
        for name, finest, ratio in kinds
    ]


def _models(scene: Scene) -> Models:
    """Return functions that load a scene with each formulation and stabilization of newton_euler."""
    variants = product(FORMULATIONS, STABILIZATIONS)
    return {", ".join(variant): partial(_load, scene, *variant) for variant in variants}


def _load(scene: Scene, formulation: FormulationName, stabilization: StabilizationName) -> Model:
    """Compile a scene with one formulation and stabilization of newton_euler."""
    compiled = compile_scene(scene, formulation=formulation, stabilization=stabilization)
    # compile before runs are timed; Euler needs all functions that DOP853 and RK4 need, and one more
    load_code(compiled, "Euler")
    if (formulation, stabilization) == RADAU_VARIANT:
        load_code(compiled, "Radau")
    ladders, interval = adaptive_ladders(formulation, stabilization), output_interval(scene)
    for integrator in ("RK4", "Euler"):
        method, numbers = f"{formulation}, {stabilization}, {integrator}", (1, 2, 5, 10, 20, 50)
        ladders.append(step_ladder(method, "step", interval, numbers, integrator=integrator))

    def run(options: Options) -> Run:
        found = compiled.simulate(**options)
        return Run(found.wall_time, found.settings["evaluations"], lambda: (found.position, found.quaternion))

    return Model(ladders, run)


def _right_hand_side(scene: Scene, formulation: FormulationName) -> RightHandSide:
    """Make newton_euler's native right-hand side, which a native loop calls.

    Args:
        scene: the scene.
        formulation: coordinates of the equations: "relative" (of joints) or "cartesian" (of bodies).
    """
    compiled = compile_scene(scene, formulation=formulation, stabilization="none")
    call = partial(time_function, compiled.function("derivative"), compiled.start)
    return RightHandSide(call, compiled.operations["derivative"])


class Lanes:
    """newton_euler with several runs at once in vector registers.

    The settings are those of the integrators with error control; fixed steps are slower at every error. A
    formulation is a choice of coordinates (of joints or of bodies), a stabilization a method that keeps
    constraint violations small.
    """

    name = "newton_euler"
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


class Scalar(Lanes):
    """newton_euler's scalar code, which simulates one run after another."""

    name = "newton_euler, one by one"
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


BENCHMARKS = Benchmarks(
    models=_models,
    right_hand_sides={name: partial(_right_hand_side, formulation=name) for name in FORMULATIONS},
    batch=lambda scene, _: Lanes(scene),
    one_by_one=Scalar,
)
