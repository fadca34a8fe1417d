"""Sweeps: many runs of a scene, made, reduced and kept, from the first call to the results."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Unpack

import numpy as np

from crosscheck.errors import CrosscheckError
from crosscheck.files import check_writable
from crosscheck.limit import tidied_up
from crosscheck.load import load_scene
from crosscheck.sweeps.distributions import Vary
from crosscheck.sweeps.execute import Pace, Workers, in_any_order, probed, workers
from crosscheck.sweeps.plan import STOPPED, Plan, run_all, run_chunk
from crosscheck.sweeps.reductions import Keep, reductions
from crosscheck.sweeps.sampling import SamplingName, samples_of
from crosscheck.sweeps.store import ERROR, NAME, STATUS, Store, libraries, store_chunk
from newton_euler.integrators.options import IntegratorName, StepControl
from newton_euler.model.scene import Scene

if TYPE_CHECKING:
    from distributed import Client

    from crosscheck.load import Model

TASK = 1.0
"""s that a task takes about: its overhead is small beside it, and little is lost with one."""

LARGEST_CHUNK = 2**16
"""Runs of a task."""

TASKS_PER_WORKER = 4
"""At least, if there are runs enough: so that all have work to the end."""


class Execution(StepControl, total=False):
    """Options of `sweep`: a method and its steps, as of `newton_euler.simulate`, and where it runs."""

    integrator: IntegratorName
    threads: int | None
    executor: Executor | None
    cluster: Client | str | None
    progress: Callable[[str], None]


@dataclass(frozen=True, eq=False)
class Sweep:
    """The results of a sweep.

    Attributes:
        plan: all that its runs depend on.
        dataset: an xarray Dataset of what varied and what was kept, by runs; on disk where there is a path.
        path: of its Zarr store; None in memory.
        made: runs that were made now; the others were there.
        wall_time: s that they took.
    """

    plan: Plan
    dataset: Any
    path: Path | None
    made: int
    wall_time: float

    def __repr__(self) -> str:
        samples, names = self.plan.samples, ", ".join(each.name for each in self.plan.kept)
        varied = f"{len(samples.names)} varied by {samples.sampling}"
        return f"<Sweep of {self.scene.name!r}: {samples.runs} runs, {varied}; kept: {names}>"

    @property
    def scene(self) -> Scene:
        """The scene with its nominal values."""
        return self.plan.scene

    @property
    def errors(self) -> dict[int, str]:
        """Why runs could not go on, by their number."""
        stopped = np.flatnonzero(self.dataset[STATUS].values == STOPPED)
        return {int(run): str(self.dataset[ERROR][run].values) for run in stopped}


def sweep(
    scene: Model,
    vary: Vary,
    runs: int | None = None,
    keep: Keep = (),
    *,
    sampling: SamplingName = "random",
    seed: int = 0,
    output: str | os.PathLike[str] | None = None,
    **options: Unpack[Execution],
) -> Sweep:
    """Run a scene many times with parameters from distributions, and keep chosen numbers of each run.

    Args:
        scene: as of `check`.
        vary: distributions by the names of parameters, see `newton_euler.equations.parameters`: texts such as
            "normal(14, 0.5)", numbers, or a `Distribution`.
        runs: their number; None for all combinations of a grid.
        keep: reductions, as "peak:reaction_force, final:panel_7.quaternion".
        sampling: "random", "latin_hypercube", "sobol", "saltelli" (for Sobol indices) or "grid".
        seed: of all random numbers.
        output: folder on disk; a sweep that was interrupted goes on there. In memory if None.
        options: `threads`, `executor` (of concurrent.futures) or `cluster` (a Dask client or an address), on
            which it runs; `progress`, which is told how far it is; `integrator`, `rtol`, `atol`, `step` as of
            `newton_euler.simulate`.

    Raises:
        CrosscheckError, NewtonEulerError: for an unknown name, an impossible plan, a folder with another one,
            a cluster that does not answer and a disk that is full.

    Examples:
        >>> swept = sweep("pendulum", {"dumbbell.mass": "normal(1, 0.1)"}, 8, "peak:reaction_force")
        >>> swept
        <Sweep of 'pendulum': 8 runs, 1 varied by random; kept: peak:reaction_force>
        >>> swept.dataset["peak:reaction_force"].dims
        ('run', 'joint')
    """
    libraries()
    loaded, _ = load_scene(scene, {})
    places = {name: options.pop(name, None) for name in ("threads", "executor", "cluster")}  # type: ignore[misc]
    progress = options.pop("progress", lambda stage: None)
    kept = reductions(keep, loaded)
    texts = tuple(each.text if each.name == each.text else f"{each.name}={each.text}" for each in kept)
    plan = Plan(loaded, samples_of(vary, sampling, runs, seed), texts, dict(options), 1)
    _check_names(plan)
    path = None if output is None else Path(output) / NAME
    start = time.perf_counter()
    with workers(**places) as at, tidied_up():
        progress("compiling")
        run_all(plan, plan.parameters(0, 1))
        store, plan = _opened(plan, path, at)
        made = _make(plan, store, at, progress)
    dataset = store.dataset()
    return Sweep(plan, dataset.load() if path is None else dataset, path, made, time.perf_counter() - start)


def _check_names(plan: Plan) -> None:
    """Raise `CrosscheckError` for a thing that is kept by the name of another one."""
    taken = {
        *plan.samples.names,
        STATUS,
        ERROR,
        "run",
        "time",
        "body",
        "joint",
        "actuator",
        "axis",
        "component",
    }
    for each in plan.kept:
        if each.name in taken:
            raise CrosscheckError(f"{each.name!r} is the name of something else; keep it by another one")


def _opened(plan: Plan, path: Path | None, at: Workers) -> tuple[Store, Plan]:
    """Open the store of a sweep, or make one; returns it and the plan with its chunks."""
    if path is not None:
        if path.exists():
            store = Store.at(path)
            store.tidy()
            return store, store.check_same(plan)
        check_writable(path)
    runs = plan.samples.runs
    rate = probed(lambda count: run_all(plan, plan.parameters(0, count)), runs)
    most = -(-runs // (TASKS_PER_WORKER * at.count()))
    about = max(1, min(int(TASK * rate), most, LARGEST_CHUNK))
    plan = replace(plan, chunk=1 << (about.bit_length() - 1))
    return Store.make(plan, path) if path else Store.in_memory(plan), plan


def _make(plan: Plan, store: Store, at: Workers, progress: Callable[[str], None]) -> int:
    """Make the chunks that are not there; returns how many runs these are."""
    left = store.missing(plan)
    counts = {k: last - first for k in left for first, last in [plan.bounds(k)]}
    pace = Pace(plan.samples.runs, plan.samples.runs - sum(counts.values()), progress)
    if store.path is not None:
        for k, _ in in_any_order(partial(store_chunk, plan, store.path.absolute()), left, at):
            pace.add(counts[k])
    else:
        for k, chunk in in_any_order(partial(run_chunk, plan), left, at):
            store.write(plan, k, chunk)
            pace.add(counts[k])
    return pace.made
