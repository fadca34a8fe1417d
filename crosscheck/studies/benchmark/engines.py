"""Engines that run many states of one scene: newton_euler's batches and `mujoco.rollout`.

Each has ways to run a batch, and each of these has settings, ever finer. Only the runs themselves are timed:
what turns states into an engine's own, and what works out poses for comparison, is apart.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from itertools import product
from typing import Any, NamedTuple, Protocol

import numpy as np

from crosscheck.studies.benchmark.ladders import JUDGED, METHODS, SHARES, STEPS, STIFF
from newton_euler.batch import Batch, simulate_batch
from newton_euler.integrators.compiled import FORMULATIONS, STABILIZATIONS
from newton_euler.integrators.run import load
from newton_euler.model.scene import Scene
from newton_euler.model.state import State
from newton_euler.scalars import Array
from newton_euler.simulate import compile_scene

Options = Mapping[str, Any]
Poses = tuple[Array, Array]


class Method(NamedTuple):
    """A way to run a batch; `setting` names and makes the n-th of its settings, 1 to `most`, ever finer."""

    setting: Callable[[int], tuple[str, Options]]
    most: int


class Done(NamedTuple):
    """A batch that was run.

    Attributes:
        seconds: what it took.
        processor: s of processor time where that can be told from loading, else `seconds`; settings are
            chosen by it, so that others' load does not decide between them.
        setup: s that it took before to turn states into the engine's own, and to load.
        poses: works out those of each run; raises what ended one of them.
        batch: of newton_euler.
    """

    seconds: float
    processor: float
    setup: float
    poses: Callable[[], list[Poses]]
    batch: Batch | None = None


class Engine(Protocol):
    """One engine on the states of one scene; `delivers` says what a run's time includes."""

    name: str
    delivers: str

    def methods(self) -> Iterator[Method]:
        """Yield all ways to run a batch."""

    def run(self, options: Options, states: Sequence[State], threads: int) -> Done:
        """Run a batch."""


class Own:
    """newton_euler: its adaptive methods. Fixed steps could only favor MuJoCo."""

    name = JUDGED
    delivers = "poses of all bodies at all outputs"

    def __init__(self, scene: Scene) -> None:
        self._scene = scene

    def methods(self) -> Iterator[Method]:
        for how in product(FORMULATIONS, STABILIZATIONS):
            self._compile(*how, "DOP853")
            for share in SHARES:
                yield Method(partial(self._setting, *how, "DOP853", share), 27)
            if how == STIFF:
                self._compile(*how, "Radau")
                yield Method(partial(self._setting, *how, "Radau", SHARES[1]), 19)

    def _compile(self, formulation: str, stabilization: str, integrator: str) -> None:
        """Fill the cache of native code: compiling does not count to the time that a sample may take."""
        compiled = compile_scene(self._scene, formulation=formulation, stabilization=stabilization)
        load(compiled, integrator)

    def _setting(
        self, formulation: str, stabilization: str, integrator: str, share: float, n: int
    ) -> tuple[str, Options]:
        """Return the setting of the n-th half decade of rtol."""
        rtol = 10.0 ** (-n / 2)
        options = {"formulation": formulation, "stabilization": stabilization, "integrator": integrator}
        name = f"{formulation}, {stabilization}, {integrator}, atol = {share:g} rtol, rtol {rtol:.0e}"
        return name, {**options, "rtol": rtol, "atol": share * rtol}

    def run(self, options: Options, states: Sequence[State], threads: int) -> Done:
        start = time.perf_counter()
        batch = simulate_batch(self._scene, states, threads=threads, **options)
        setup = time.perf_counter() - start - batch.wall_time
        seconds = batch.wall_time
        return Done(seconds, seconds, setup, lambda: [(r.position, r.quaternion) for r in batch], batch)


class MuJoCo:
    """`mujoco.rollout`, which writes the full physics state after every step."""

    name = "mujoco"
    delivers = "time, qpos and qvel after every step, of which qpos at outputs is kept"

    def __init__(self, scene: Scene, period: float) -> None:
        """Steps are no shorter than in the ladder of runs with outputs of this period, s."""
        from mjcf.tight import compiled

        self._system = compiled(scene)
        self._interval = float(scene.times[1] - scene.times[0])
        self._most = max(1, round(self._interval / period * STEPS[-1]))

    def methods(self) -> Iterator[Method]:
        for integrator, ratio in METHODS:
            yield Method(partial(self._setting, integrator, ratio), self._most)

    def _setting(self, integrator: str, ratio: float, n: int) -> tuple[str, Options]:
        name = f"{integrator}, solref (2 steps, {ratio:g}), step {self._interval / n:.3g} s"
        return name, {"integrator": integrator, "damping_ratio": ratio, "number": n}

    def run(self, options: Options, states: Sequence[State], threads: int) -> Done:
        from mjcf.tight import Rollout, physics_states

        start = time.perf_counter()
        rollout = Rollout(self._system, **options, threads=threads)
        coordinates = [self._system.coordinates(state) for state in states]
        starts = physics_states(self._system, *map(np.array, zip(*coordinates, strict=True)))
        begun, used = time.perf_counter(), time.process_time()
        runs = rollout(starts)
        seconds, processor = time.perf_counter() - begun, time.process_time() - used
        return Done(seconds, processor, begun - start, lambda: [rollout.poses(qpos) for qpos in runs])
