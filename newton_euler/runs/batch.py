"""Run one scene many times, with different initial states or parameters, on several threads.

The scene is compiled once, and the parameters are inputs of the compiled code. Native code releases Python's
interpreter lock, so that threads run in parallel. Where possible, each thread integrates several runs at
once, one in each lane of a vector register (`newton_euler.compiled.lanes`).
"""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache, partial
from queue import Empty, SimpleQueue
from typing import Annotated, Any, Unpack, overload

import numpy as np
from numpy.typing import ArrayLike

from newton_euler.arguments import UNCHECKED, checked
from newton_euler.compiled.equations import CACHED_SCENES
from newton_euler.compiled.lanes import Runs, SideBySide, load_lanes, runs_in_lanes
from newton_euler.compiled.outputs import named
from newton_euler.compiled.records import COMPILATION_LOCK
from newton_euler.equations.couplings import counted_angles
from newton_euler.errors import (
    MechanismError,
    NewtonEulerError,
    OptionError,
    UnknownNameError,
    is_count,
    quoted,
)
from newton_euler.integrators.options import (
    RUN_ARGUMENTS,
    FormulationName,
    IntegratorName,
    Options,
    StabilizationName,
    StepControl,
)
from newton_euler.integrators.stepper import COUNTS, reported_counts
from newton_euler.model.digital_control import Digital
from newton_euler.model.mechanism import Mechanism
from newton_euler.model.scene import Scene
from newton_euler.model.state import State
from newton_euler.model.trajectory import JointMotion, Trajectory, joint_motion
from newton_euler.runs.assemble import check_states, coordinates_of, initial_state
from newton_euler.runs.initial_coordinates import initial_numbers
from newton_euler.runs.intervals import integrate_intervals
from newton_euler.runs.simulate import CompiledScene, native_trajectory, warn_of_round_off
from newton_euler.runs.starts import assembly_of
from newton_euler.runs.variation import run_values
from newton_euler.scalars import Array, Floats

PIECES_PER_THREAD = 8
"""Number of pieces of work per thread; with small pieces all threads end at nearly the same time."""

MAX_THREADS = 4096
"""Largest number of threads. Each thread takes memory for its stack."""

MIN_PIECE_RUNS = 64
"""Smallest number of runs in a piece of work for lanes.

Small pieces waste time, because some lanes are idle while the last runs of a piece complete."""


@dataclass(frozen=True, eq=False)
class Batch(Sequence[Trajectory]):
    """Runs of one scene; `batch[k]` is the trajectory of run k, or raises the error that ended the run.

    `len(batch)` is the number of runs, and `batch[2:5]` a list of trajectories.

    Attributes:
        scene: the scene of all runs.
        settings: settings that all runs share, see `Trajectory`.
        wall_time: s, of all runs together.
        errors: errors by number of the run: invalid parameter values, or runs that stopped early.

    Examples:
        >>> batch = simulate_batch(load("pendulum"), parameters={"dumbbell.mass": [1.0, 2.0, -1.0]})
        >>> len(batch), list(batch.errors), batch.joint("pivot").coordinates.shape
        (3, [2], (3, 1001, 1))
    """

    scene: Scene
    settings: dict[str, Any]
    wall_time: float
    errors: dict[int, NewtonEulerError]
    _compiled: CompiledScene
    _runs: Runs

    def __len__(self) -> int:
        return len(self._runs.results)

    def __repr__(self) -> str:
        return f"<Batch of {self.scene.name!r}: runs: {len(self)}, errors: {len(self.errors)}>"

    @overload
    def __getitem__(self, run: int) -> Trajectory: ...
    @overload
    def __getitem__(self, run: slice) -> list[Trajectory]: ...
    def __getitem__(self, run: int | slice) -> Trajectory | list[Trajectory]:
        if isinstance(run, slice):
            return [self[k] for k in range(len(self))[run]]
        number = range(len(self))[run]
        if number in self.errors:
            raise self.errors[number]
        arrays = named(self._compiled, self._runs.results[number])
        settings = self.settings | reported_counts(self._runs.counts[number])
        trajectory = native_trajectory(self.scene, settings, self.wall_time / len(self), arrays)
        return replace(trajectory, mechanism=self._mechanism(number))

    @checked
    def stacked(self, name: str) -> Floats:
        """Return an array of all runs at all times, without a copy: `position` is (runs, n, b, 3).

        Values of runs that stopped early are NaN. The sign of quaternions may change between times, unlike in
        a trajectory.

        Raises:
            UnknownNameError: for an array that is no output of the scene.
        """
        arrays = self._compiled.arrays
        if name not in arrays:
            raise UnknownNameError("array", name, tuple(arrays))
        columns, shape = arrays[name]
        results = self._runs.results
        return results[:, :, columns].reshape(*results.shape[:2], *shape)

    @checked
    def joint(self, name: str) -> JointMotion:
        """Compute the k coordinates of a joint, (runs, n, k), and their rates, as `Trajectory.joint` does.

        Values of runs that stopped early are NaN. If the geometry varies, each run takes some milliseconds.

        Raises:
            UnknownNameError: for an unknown joint.
        """
        # arrays of all runs; velocities may not be among the outputs of the scene
        times, available = self.scene.times, self._compiled.arrays
        position, quaternion = self.stacked("position"), self.stacked("quaternion")
        velocities = [
            self.stacked(each) if each in available else None
            for each in ("linear_velocity", "angular_velocity")
        ]
        # angles of the joint with counted full revolutions, (runs, n), by coordinate number
        keys = enumerate(counted_angles(self.scene))
        angles = {
            number: self.stacked("joint_angle")[:, :, k] for k, (joint, number) in keys if joint == name
        }
        # one geometry for all runs
        if not self._compiled.kinematic:
            equations = self.scene.mechanism.joint_equations(name)
            return joint_motion(equations, times, angles, position, quaternion, *velocities)
        # a geometry for each run
        motions = []
        for run, mechanism in enumerate(self._mechanisms):
            equations = mechanism.joint_equations(name)
            run_velocities = [None if array is None else array[run] for array in velocities]
            run_angles = {number: array[run] for number, array in angles.items()}
            motion = joint_motion(
                equations, times, run_angles, position[run], quaternion[run], *run_velocities
            )
            motions.append(motion)
        coordinates = np.array([motion.coordinates for motion in motions])
        rates = None if velocities[0] is None else np.array([motion.rates for motion in motions])
        return JointMotion(motions[0].names, coordinates, rates)

    @cached_property
    def _mechanisms(self) -> list[Mechanism]:
        """The mechanism of each run, with the geometry of the run."""
        return [self._mechanism(run) for run in range(len(self))]

    def _mechanism(self, run: int) -> Mechanism:
        """Return the mechanism of a run, with the parameter values of the run."""
        return self._compiled.parametrized(self._runs.starts[run]).mechanism

    def __iter__(self) -> Iterator[Trajectory]:
        return (self[k] for k in range(len(self)))


@checked
def simulate_batch(
    scene: Scene,
    states: Annotated[Sequence[State] | None, UNCHECKED] = None,  # `make_batch` checks the states
    parameters: Mapping[str, Sequence[ArrayLike] | Floats] | None = None,
    threads: int | None = None,
    formulation: FormulationName | None = None,
    integrator: IntegratorName = "DOP853",
    stabilization: StabilizationName = "projection",
    alpha: float | None = None,
    **control: Unpack[StepControl],
) -> Batch:
    """Run a scene many times, from different states or with different parameters; compile it once.

    Results do not depend on the number of threads. A run from a state equals the run of `simulate` from this
    state. All outputs of all runs are kept in memory, 8 bytes per number: 0.7 MB per run of the example scene
    `tracker`. `crosscheck.sweep` keeps a few numbers of each run instead.

    Args:
        scene: the scene of all runs.
        states: initial states, one per run; the initial state of the scene for all runs if None.
        parameters: values, one per run, by name; see `newton_euler.equations.parameters`, and
            `newton_euler.runs.initial_coordinates` for initial coordinates.
        threads: number of threads, at most 4096; the number of processors if None.
        formulation, integrator, stabilization, alpha, control: see `newton_euler.simulate`.

    Raises:
        NewtonEulerError: for an unknown name, an impossible option, and values that no run could have. Errors
            of single runs are in `Batch.errors`.

    Examples:
        >>> batch = simulate_batch(load("pendulum"), parameters={"dumbbell.mass": [1.0, 2.0]})
        >>> len(batch), batch.stacked("position").shape
        (2, (2, 1001, 2, 3))
    """
    chosen = formulation, integrator, stabilization, alpha
    batch = make_batch(scene, states, parameters, threads, *chosen, **control)
    batch._compiled.warn()
    runs = (batch.settings | reported_counts(counts) for counts in batch._runs.counts)
    warn_of_round_off(scene, Options.of(integrator, control), runs)
    return batch


def make_batch(
    scene: Scene,
    states: Sequence[State] | None = None,
    parameters: Mapping[str, Sequence[ArrayLike] | Floats] | None = None,
    threads: int | None = None,
    formulation: FormulationName | None = None,
    integrator: IntegratorName = "DOP853",
    stabilization: StabilizationName = "projection",
    alpha: float | None = None,
    **control: Unpack[StepControl],
) -> Batch:
    """Run a scene many times like `simulate_batch`, without its warnings."""
    # check options, states and control laws
    options = Options.of(integrator, control, ("formulation", *RUN_ARGUMENTS))
    options.check_steps(scene.duration)
    parameters = dict(parameters or {})
    are_states = isinstance(states, list | tuple) and (
        not states or any(isinstance(each, State) for each in states)
    )
    if states is not None and not are_states:
        needed = "State objects, one per run; coordinates are parameters: {'start.JOINT': [0.1, 0.2]}"
        raise OptionError("states", quoted(states), needed)
    for controller in scene.sampled:
        if not isinstance(controller, Digital) or controller.law.uses_model:
            problem = "has a controller that calls Python, or knows the mechanism, at its instants"
            needed = "its law without sampling, or `simulate` run by run"
            raise MechanismError(f"joint {controller.joint!r}", problem, needed)
    # compile, and find room for the results
    workers = thread_count(threads)
    initial = initial_numbers(scene, parameters)
    names = tuple(name for name in parameters if name not in initial)
    with COMPILATION_LOCK:
        compiled = _compiled(scene, formulation, stabilization, alpha, names)
        load_lanes(compiled, integrator)
    count = _run_count(states, parameters)
    shape = (len(scene.times), compiled.function("output").outputs)
    try:
        results = np.empty((count, *shape))
        starts = np.tile(compiled.start, (count, 1))
    except MemoryError as error:
        megabytes = 8e-6 * math.prod(shape)
        needed = f"memory for {count * megabytes:.3g} MB, {megabytes:.3g} MB per run, or crosscheck.sweep"
        raise OptionError("states and parameters", f"{count} runs", needed) from error
    # set states and parameters, and run
    errors = _set_starts(starts, compiled, states, parameters)
    results[list(errors)] = np.nan  # runs that cannot start
    runs = Runs(starts, results, np.zeros((count, COUNTS)), errors)
    wall_time = _run_all(runs, compiled, options, workers)
    settings = compiled.settings | {"threads": workers} | options.as_settings()
    return Batch(scene, settings, wall_time, dict(sorted(runs.errors.items())), compiled, runs)


def _run_all(runs: Runs, compiled: CompiledScene, options: Options, workers: int) -> float:
    """Run all runs that have no error yet; write their results, counters and errors into `runs`.

    Args:
        runs: initial states and results.
        compiled: the compiled scene.
        options: integrator and step control.
        workers: number of threads.

    Returns:
        Wall time, s.
    """
    # divide the runs into pieces of work
    side_by_side = runs_in_lanes(compiled, options.integrator)
    numbers = np.setdiff1d(np.arange(len(runs.starts)), list(runs.errors))
    max_pieces = len(numbers) // MIN_PIECE_RUNS if side_by_side else len(numbers)
    waiting: SimpleQueue[Array] = SimpleQueue()
    for piece in np.array_split(numbers, max(min(PIECES_PER_THREAD * workers, max_pieces), workers)):
        waiting.put(piece)
    stopped: list[bool] = []  # not empty after an error or Ctrl-C: all threads stop

    def work() -> None:
        """Take pieces of work until none is left."""
        integrate: Callable[[Runs, Array], None] = partial(_run_one_by_one, compiled, options, stopped)
        if side_by_side:
            integrate = SideBySide(compiled, compiled.scene.times, options, stopped)
        with suppress(Empty):
            while not stopped:
                integrate(runs, waiting.get_nowait())

    start = time.perf_counter()
    with ThreadPoolExecutor(workers) as pool:
        try:
            for worker in as_completed([pool.submit(work) for _ in range(workers)]):
                worker.result()
        except BaseException:
            stopped.append(True)
            raise
    return time.perf_counter() - start


def _run_one_by_one(
    compiled: CompiledScene, options: Options, stopped: Sequence[bool], runs: Runs, numbers: Array
) -> None:
    """Integrate some of the runs, given by their numbers (k,), one after another.

    The runs are integrated interval by interval, between the samples of digital controllers and the jumps in
    derivatives of functions of time.

    Args:
        compiled: the compiled scene.
        options: integrator and step control.
        stopped: the work ends if this list is not empty.
        runs: initial states; receives results, counters and errors.
        numbers: numbers of the runs.
    """
    for k in numbers.tolist():
        if stopped:
            return
        native_run = integrate_intervals(compiled, runs.starts[k], options, stopped)
        if native_run.stopped:
            runs.errors[k] = native_run.stopped
            runs.results[k] = np.nan
        else:
            runs.results[k] = native_run.results
        runs.counts[k] = native_run.counts


@lru_cache(maxsize=CACHED_SCENES)
def _compiled(
    scene: Scene, formulation: str | None, stabilization: str, alpha: float | None, names: tuple[str, ...]
) -> CompiledScene:
    """Return the compiled scene for parameters by name.

    Recent scenes are kept, because LLVM does not free the memory of code that is no longer needed.
    """
    return CompiledScene(scene, formulation, stabilization, alpha, names)


def thread_count(threads: int | None = None) -> int:
    """Check a number of threads; if None, return the number of processors of this process.

    Raises:
        OptionError: for a number that is not whole, below 1 or above `MAX_THREADS`.
    """
    if threads is None:
        return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    if not is_count(threads) or threads > MAX_THREADS:
        raise OptionError("threads", threads, f"a whole number, 1 to {MAX_THREADS}")
    return int(threads)


def _run_count(states: Sequence[State] | None, parameters: Mapping[str, Any]) -> int:
    """Return the number of runs.

    Raises:
        OptionError: for states and parameter values of different lengths, or without elements.
    """
    by_name = dict(parameters) if states is None else {**parameters, "states": states}
    for name, values in by_name.items():
        if not len(values):
            raise OptionError(name, values, "one value per run, of one run or more")
    lengths = {name: len(values) for name, values in by_name.items()}
    if len(set(lengths.values())) != 1:
        raise OptionError("states and parameters", lengths, "one state or value per run, of one length")
    return next(iter(lengths.values()))


def _set_starts(
    starts: Array,
    compiled: CompiledScene,
    states: Sequence[State] | None,
    parameters: Mapping[str, Any],
) -> dict[int, NewtonEulerError]:
    """Write the initial states and parameters of all runs into the inputs of the compiled code.

    Args:
        starts: (runs, inputs), changed: coordinates q, velocities v, time, flags and parameters of each run.
        compiled: the compiled scene.
        states: initial states of the runs; the scene's initial state for all runs if None.
        parameters: values, one per run, by name.

    Returns:
        Errors by number of the run.
    """
    # check states and values; a run with an invalid state gets the scene's own, and an error
    scene = compiled.scene
    state_errors = check_states(scene, states or ())
    valid = [initial_state(scene) if k in state_errors else state for k, state in enumerate(states or ())]
    values = run_values(scene, parameters)
    for name, array in values.arrays.items():
        if name in compiled.parameters:
            place, flat = compiled.place(name), array.reshape(len(array), -1)
            starts[:, place : place + flat.shape[1]] = flat
    # close the loops with the parameters of each run, and write q and v, the first `size` inputs
    errors: dict[int, NewtonEulerError] = {**values.errors, **state_errors}
    assembly = assembly_of(scene, tuple(parameters))
    if assembly.is_needed:
        assembled, assembly_errors = assembly(values.arrays, valid or None)
        starts[:, : compiled.size] = assembly.starts(compiled, assembled)
        return {**assembly_errors, **errors}
    if valid:
        starts[:, : compiled.size] = coordinates_of(compiled.system, valid)
    return errors
