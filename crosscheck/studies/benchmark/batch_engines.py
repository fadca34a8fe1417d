"""The two engines that run many states of one scene, and the cheapest setting of each on a sample of them."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import numpy as np

from crosscheck.errors import CrosscheckError
from crosscheck.limit import time_limit
from crosscheck.studies.benchmark import mujoco as benchmark_mujoco
from crosscheck.studies.benchmark import newton_euler as benchmark_newton_euler
from crosscheck.studies.benchmark import reference as benchmark_reference
from crosscheck.studies.benchmark.work_precision import Progress, pose_errors, steady
from newton_euler import compile_scene
from newton_euler.batch import Batch, simulate_batch
from newton_euler.conversion import coordinates
from newton_euler.errors import NewtonEulerError
from newton_euler.model.scene import Scene
from newton_euler.model.state import State
from newton_euler.scalars import Array
from newton_euler.simulate import simulate

if TYPE_CHECKING:
    from mjcf.soft import SoftMuJoCo

RTOL = 1e-12
"""Of the sample's reference, with atol = 0.01 rtol."""

LONGEST = 20.0
"""s that a sample may take: settings that are slower are not tried."""

TURNS = 2
"""How often a sample is run at a setting that reaches the error; the quicker counts."""

SHARES = (0.5, *benchmark_mujoco.STEPS)
"""MuJoCo's steps tried, in one of the scene's own output periods, however rare outputs are."""

CALLS = 200_000
"""Right-hand sides that show what the machine's threads can do."""

Options = Mapping[str, Any]
Poses = tuple[Array, Array]


class Choice(NamedTuple):
    """A setting tried on a sample: the largest error (m or rad), and the time of the whole sample, s."""

    name: str
    options: Options
    error: float
    seconds: float


class Engine(Protocol):
    """One engine on the states of one scene."""

    name: str

    def ladders(self) -> Iterator[list[tuple[str, Options]]]:
        """Named settings of each method, from the coarsest to the finest."""

    def between(self, coarse: Options, fine: Options) -> tuple[str, Options] | None:
        """A named setting between two of a ladder, if there is one."""

    def sample(self, options: Options, states: Sequence[State]) -> tuple[float, Callable[[], list[Poses]]]:
        """s that some runs take on one thread, and their poses, which may raise what ended one of them."""


class Own:
    """newton_euler. A run's time includes the poses of all bodies at all outputs."""

    name = "newton_euler"
    delivers = "poses of all bodies at all outputs"

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        self._first: Batch | None = None
        self.setup = 0.0

    def ladders(self) -> Iterator[list[tuple[str, Options]]]:
        for load in benchmark_newton_euler.models(self._scene).values():
            for ladder in load().ladders:
                if "rtol" in ladder.settings[0].options:  # without fixed steps, which can only favour MuJoCo
                    yield [
                        (f"{ladder.method}, {setting.name}", setting.options) for setting in ladder.settings
                    ]

    def between(self, coarse: Options, fine: Options) -> tuple[str, Options] | None:
        return None  # half decades of rtol are close enough

    def sample(self, options: Options, states: Sequence[State]) -> tuple[float, Callable[[], list[Poses]]]:
        batch = simulate_batch(self._scene, states, threads=1, **options)
        return batch.wall_time, lambda: [(run.position, run.quaternion) for run in batch]

    def run(self, options: Options, states: Sequence[State], threads: int) -> float:
        """s of all runs.

        Raises:
            CrosscheckError: if they are not what they were, to the last bit.
        """
        start = time.perf_counter()
        batch = simulate_batch(self._scene, states, threads=threads, **options)
        self.setup = time.perf_counter() - start - batch.wall_time
        if self._first is None:
            self._first = batch
        elif not identical(self._first, batch):
            raise CrosscheckError(f"newton_euler: {threads} threads change the results of a batch")
        return batch.wall_time

    @property
    def failed(self) -> int:
        """Runs that could not go on."""
        assert self._first is not None
        return len(self._first.errors)


class MuJoCo:
    """`mujoco.rollout`, which writes the full physics state after every step."""

    name = "mujoco"
    delivers = "time, qpos and qvel after every step, of which qpos at outputs is kept"
    failed = 0

    def __init__(self, scene: Scene, period: float) -> None:
        """Steps are tried in shares of `period`, s."""
        self._scene = scene
        self._interval = float(scene.times[1] - scene.times[0])
        self._numbers = sorted({max(1, round(self._interval / period * share)) for share in SHARES})
        self._starts = np.empty((0, 0))
        self.setup = 0.0

    @cached_property
    def _system(self) -> SoftMuJoCo:
        from mjcf.tight import compiled

        return compiled(self._scene)

    def ladders(self) -> Iterator[list[tuple[str, Options]]]:
        for integrator, ratio in benchmark_mujoco.METHODS:
            method = {"integrator": integrator, "damping_ratio": ratio}
            yield [self._named({**method, "number": number}) for number in self._numbers]

    def between(self, coarse: Options, fine: Options) -> tuple[str, Options] | None:
        number = (coarse["number"] + fine["number"]) // 2
        return None if number == coarse["number"] else self._named({**fine, "number": number})

    def _named(self, options: Options) -> tuple[str, Options]:
        step = self._interval / options["number"]
        solref = f"solref (2 steps, {options['damping_ratio']:g})"
        return f"{options['integrator']}, {solref}, step {step:.3g} s", options

    def sample(self, options: Options, states: Sequence[State]) -> tuple[float, Callable[[], list[Poses]]]:
        from mjcf.tight import Rollout, physics_states

        rollout = Rollout(self._system, **options, threads=1)
        starts = physics_states(self._system, *coordinates(self._system, states))
        start = time.process_time()  # on one thread; others' load must not decide between settings
        runs = rollout(starts)
        return time.process_time() - start, lambda: [rollout.poses(qpos) for qpos in runs]

    def run(self, options: Options, states: Sequence[State], threads: int) -> float:
        """s of all runs."""
        from mjcf.tight import Rollout, physics_states

        rollout = Rollout(self._system, **options, threads=threads)
        if len(self._starts) != len(states):
            start = time.perf_counter()
            self._starts = physics_states(self._system, *coordinates(self._system, states))
            self.setup = time.perf_counter() - start
        start = time.perf_counter()
        rollout(self._starts)
        return time.perf_counter() - start


def identical(one: Batch, other: Batch) -> bool:
    """Whether two batches are equal to the last bit."""
    return one.errors.keys() == other.errors.keys() and all(
        np.array_equal(one.stacked(name), other.stacked(name), equal_nan=True)
        for name in ("position", "quaternion")
    )


def cheapest(
    engine: Engine, states: Sequence[State], exact: Sequence[Poses], error: float, progress: Progress
) -> Choice:
    """The setting that runs these states in the least time, none of them further off than `error`.

    A ladder is left where it reaches the error, or takes longer than another that did.

    Raises:
        CrosscheckError: if no setting reaches the error.
    """
    best: Choice | None = None
    least = math.inf

    def tried(name: str, options: Options) -> Choice:
        nonlocal least
        progress(f"{len(states)} runs of {engine.name}: {name}")
        found = _tried(engine, name, options, states, exact, error)
        least = min(least, found.error)
        return found

    for ladder in engine.ladders():
        coarse: Options | None = None
        for setting in ladder:
            found = tried(*setting)
            if found.error <= error:
                while coarse and (middle := engine.between(coarse, found.options)):
                    finer = tried(*middle)
                    if finer.error <= error:
                        found = finer
                    else:
                        coarse = finer.options
                if best is None or found.seconds < best.seconds:
                    best = found
                break
            if found.seconds > (LONGEST if best is None else best.seconds):
                break
            coarse = found.options
    if best is None:
        reason = f"does not reach an error of {error:g} on all of {len(states)} runs"
        raise CrosscheckError(f"{engine.name} {reason}; the least is {least:.1e}")
    return best


def _tried(
    engine: Engine,
    name: str,
    options: Options,
    states: Sequence[State],
    exact: Sequence[Poses],
    error: float,
) -> Choice:
    """What a setting makes of a sample; its error is infinite if a run cannot go on."""
    seconds, worst = math.inf, math.inf
    for _ in range(TURNS):
        start = time.perf_counter()
        try:
            with steady(), time_limit(LONGEST):
                taken, poses = engine.sample(options, states)
            worst = max(max(pose_errors(*pair)) for pair in zip(poses(), exact, strict=True))
        except (NewtonEulerError, CrosscheckError):
            return Choice(name, options, math.inf, time.perf_counter() - start)
        seconds = min(seconds, taken)
        if not worst <= error:
            break
    return Choice(name, options, worst, seconds)


def references(scene: Scene, states: Sequence[State]) -> tuple[dict[int, Poses], float]:
    """Poses by Pinocchio at tight tolerances, by number of the state; largest difference to newton_euler's.

    A state has none from which one of them cannot go that tightly: its run passes a singular configuration.

    Raises:
        CrosscheckError: if none has any.
    """
    import urdf

    tight: dict[str, Any] = {"rtol": RTOL, "atol": 0.01 * RTOL}
    found: dict[int, Poses] = {}
    uncertainty = 0.0
    for k, state in enumerate(states):
        started = replace(scene, initial_state=state)
        try:
            with time_limit(benchmark_reference.LIMIT):
                own, exact = simulate(started, **tight), urdf.simulate(started, **tight)
        except (NewtonEulerError, CrosscheckError) as error:
            reason = str(error)
            continue
        found[k] = exact.position, exact.quaternion
        uncertainty = max(uncertainty, *pose_errors((own.position, own.quaternion), found[k]))
    if not found:
        raise CrosscheckError(f"none of {len(states)} random runs has a reference; the last: {reason}")
    return found, uncertainty


def bare(scene: Scene) -> Callable[[int], float]:
    """s of `CALLS` right-hand sides shared by some threads, in native code throughout.

    Nothing is shared but the code: how much sooner two threads are done is what the machine allows.
    """
    compiled = compile_scene(scene)
    q, v = compiled.start[: compiled.system.nq], compiled.start[compiled.system.nq : compiled.size]

    def run(threads: int) -> float:
        with ThreadPoolExecutor(threads) as pool:
            start = time.perf_counter()
            list(pool.map(lambda _: compiled.repeat(CALLS // threads, q, v), range(threads)))
            return time.perf_counter() - start

    return run
