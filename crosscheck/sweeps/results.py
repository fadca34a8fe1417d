"""Results of sweeps: made chunk by chunk wherever they run, and taken up where they ended."""

from __future__ import annotations

import re
import time
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np

from crosscheck.errors import CrosscheckError
from crosscheck.files import check_writable
from crosscheck.limit import tidied_up
from crosscheck.sweeps.execute import Pace, Workers, in_any_order, probed
from crosscheck.sweeps.expressions import labels
from crosscheck.sweeps.plan import STOPPED, Parameters, Plan, run_all, run_chunk
from crosscheck.sweeps.store import ERROR, NAME, STATUS, Store, store_chunk
from newton_euler.errors import NewtonEulerError
from newton_euler.model.scene import Scene
from newton_euler.scalars import Array
from newton_euler.variation import own_values

TASK = 1.0
"""s that a task takes about: its overhead is small beside it, and little is lost with one."""

OVERHEAD = 0.01
"""s of processor time that a Dask scheduler takes for a task, so that tasks for many workers are longer."""

LARGEST_CHUNK = 2**16
"""Runs of a task."""

BLOCK = 2**20
"""Runs whose status is read at a time."""

TASKS_PER_WORKER = 4
"""At least, if there are runs enough: so that all have work to the end."""


TIMES = re.compile(r"time\d*")
"""Names of the times of what is kept at some."""

VECTORS = "BODY.center_of_mass.x, BODY.inertia.xy, JOINT.point.z"
"""Examples of numbers that vary alone."""


@dataclass(frozen=True, eq=False)
class Results:
    """The runs of a sweep.

    Attributes:
        plan: all that its runs depend on.
        dataset: an xarray Dataset of what varied and what was kept, by runs; on disk where there is a path.
        store: that holds it.
        made: runs that were made now; the others were there.
        wall_time: s that they took.
    """

    plan: Plan
    dataset: Any
    store: Store
    made: int
    wall_time: float

    @property
    def path(self) -> Path | None:
        """Of the Zarr store; None in memory."""
        return self.store.path

    @property
    def scene(self) -> Scene:
        """The scene with its nominal values."""
        return self.plan.scene

    def inputs(self, runs: Array) -> Parameters:
        """Return the parameters of runs (n,)."""
        return {name: self.dataset[name][runs].values for name in self.plan.samples.names}

    @cached_property
    def errors(self) -> dict[int, str]:
        """Why runs could not go on, by their number."""
        found: dict[int, str] = {}
        for first in range(0, self.plan.samples.runs, BLOCK):
            status = self.dataset[STATUS][first : first + BLOCK].values
            stopped = first + np.flatnonzero(status == STOPPED)
            if len(stopped):
                reasons = self.dataset[ERROR][stopped].values
                found |= {int(run): str(reason) for run, reason in zip(stopped, reasons, strict=True)}
        return found


def results_of(plan: Plan, folder: Path | None, at: Workers, progress: Callable[[str], None]) -> Results:
    """Make the runs of a plan that are not in a folder yet; in memory if that is None.

    Raises:
        CrosscheckError: for a folder with another plan, a disk that is full, and workers that fail.
        NewtonEulerError: for a scene that cannot be run, and an unknown parameter.
    """
    _check_names(plan)
    path = None if folder is None else folder / NAME
    start = time.perf_counter()
    with tidied_up():
        progress("compiling")
        run_all(plan, plan.parameters(0, 1))
        store, plan = _opened(plan, path, at, progress)
        made = _make(plan, store, at, progress)
    dataset = store.dataset()
    wall_time = time.perf_counter() - start
    return Results(plan, dataset.load() if path is None else dataset, store, made, wall_time)


def _check_names(plan: Plan) -> None:
    """Raise `CrosscheckError` for names that are taken, and for parameters that are no number."""
    taken = {*plan.samples.names, STATUS, ERROR, "run", *labels(plan.scene)}
    for each in plan.kept:
        if each.name in taken or TIMES.fullmatch(each.name):
            raise CrosscheckError(f"{each.name!r} is the name of something else; keep it by another one")
    for name in plan.samples.names:
        try:
            shape = own_values(plan.scene, [name])[name].shape
        except NewtonEulerError as error:
            hint = f"; vectors by components, as {VECTORS}; starts as start.JOINT"
            raise CrosscheckError(f"--vary {name}: {error}{hint}") from error
        if shape:
            parts = {(3,): "xyz", (3, 3): ("xx", "xy")}.get(shape, ())
            example = " or ".join(f"{name}.{part}" for part in parts)
            raise CrosscheckError(f"--vary {name}: it has {np.prod(shape)} numbers; name one, {example}")


def _opened(
    plan: Plan, path: Path | None, at: Workers, progress: Callable[[str], None]
) -> tuple[Store, Plan]:
    """Open the store of a sweep, or make one; returns it and the plan with its chunks."""
    if path is not None:
        if path.exists():
            store = Store.at(path)
            store.tidy()
            return store, store.check_same(plan)
        check_writable(path)
    runs = plan.samples.runs
    progress("timing some runs")
    rate = probed(lambda count: run_all(plan, plan.parameters(0, count)), runs)
    most = -(-runs // (TASKS_PER_WORKER * at.count()))
    task = max(TASK, OVERHEAD * at.count())
    about = max(1, min(int(task * rate), most, LARGEST_CHUNK))
    plan = replace(plan, chunk=1 << (about.bit_length() - 1))
    return Store.make(plan, path) if path else Store.in_memory(plan), plan


def _make(plan: Plan, store: Store, at: Workers, progress: Callable[[str], None]) -> int:
    """Make the chunks that are not there; returns how many runs these are."""
    left = store.missing(plan)
    counts = {k: last - first for k in left for first, last in [plan.bounds(k)]}
    pace = Pace(plan.samples.runs, plan.samples.runs - sum(counts.values()), progress)
    if store.path is not None:
        written = partial(store_chunk, plan, store.path.absolute())
        with closing(in_any_order(written, left, at)) as there:
            for k, _ in there:
                pace.add(counts[k])
    else:
        with closing(in_any_order(partial(run_chunk, plan), left, at)) as made:
            for k, chunk in made:
                store.write(plan, k, chunk)
                pace.add(counts[k])
    return pace.made
