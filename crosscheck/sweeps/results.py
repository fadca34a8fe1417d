"""Results of sweeps: made chunk by chunk wherever they run, and taken up where they ended."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import groupby
from math import prod
from pathlib import Path
from typing import Any

import numpy as np

from crosscheck.errors import CrosscheckError
from crosscheck.files import check_writable
from crosscheck.limit import tidied_up
from crosscheck.sweeps.execute import Pace, Workers, in_any_order, probed
from crosscheck.sweeps.expressions import labels
from crosscheck.sweeps.plan import STOPPED, Chunk, Parameters, Plan, make_runs, run_all
from crosscheck.sweeps.store import BLOCK, ERROR, NAME, STATUS, Store, store_runs
from newton_euler.errors import NewtonEulerError
from newton_euler.model.scene import Scene
from newton_euler.scalars import Array
from newton_euler.variation import own_values

TASK = 1.0
"""s that a task takes about: its overhead is small beside it, and little is lost with one."""

OVERHEAD = 0.01
"""s of processor time that a Dask scheduler takes for a task, so that tasks for many workers are longer."""

LARGEST_TASK, MOST_NUMBERS = 2**16, 2**22
"""Runs of a task, and numbers that are kept of them, 34 MB."""

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
        task = 0
        if path is not None and path.exists():
            store = Store.at(path)
            plan = store.resumed(plan)
        else:
            if path is not None:
                check_writable(path)
            task = _task(plan, at, progress)
            plan = replace(plan, chunk=task)
            store = Store.make(plan, path) if path else Store.in_memory(plan)
        if left := store.missing(plan):
            task = task or _task(plan, at, progress)
        made = _make(plan, store, list(_tasks(plan, left, task)), at, progress)
        if lost := store.missing(plan):
            problem = f"{len(lost)} of {plan.chunks} chunks of runs are not in {path}"
            raise CrosscheckError(f"{problem}; needed: a folder that all workers see")
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
            hint = f" (vectors by components, as {VECTORS}; starts as start.JOINT)"
            raise CrosscheckError(f"--vary {name}: {error}{hint}") from error
        if shape:
            parts = {(3,): "xyz", (3, 3): ("xx", "xy")}.get(shape, ())
            example = " or ".join(f"{name}.{part}" for part in parts)
            raise CrosscheckError(f"--vary {name}: it has {np.prod(shape)} numbers; name one, {example}")


def _task(plan: Plan, at: Workers, progress: Callable[[str], None]) -> int:
    """Return how many runs take about as long as a task is to take: a power of 2."""
    runs = plan.samples.runs
    progress("timing some runs")
    rate = probed(lambda count: run_all(plan, plan.parameters(0, count)), runs)
    workers = max(1, at.count())
    most = -(-runs // (TASKS_PER_WORKER * workers))
    numbers = sum(prod(map(len, each.dimensions.values())) for each in plan.kept)
    largest = min(LARGEST_TASK, MOST_NUMBERS // numbers)
    about = max(1, min(int(max(TASK, OVERHEAD * workers) * rate), most, largest))
    return 1 << (about.bit_length() - 1)


def _tasks(plan: Plan, left: Sequence[int], runs: int) -> Iterator[tuple[int, int]]:
    """Yield the first run of each task and the first after it: of chunks in a row, so many runs or fewer.

    Chunks are short where a sweep began with few runs.
    """
    most = max(1, runs // plan.chunk)
    for _, group in groupby(enumerate(left), key=lambda pair: pair[1] - pair[0]):
        chunks = [k for _, k in group]
        for start in range(0, len(chunks), most):
            part = chunks[start : start + most]
            yield plan.bounds(part[0])[0], plan.bounds(part[-1])[1]


def _make(
    plan: Plan, store: Store, tasks: Sequence[tuple[int, int]], at: Workers, progress: Callable[[str], None]
) -> int:
    """Make and write runs; returns how many these are."""
    made = sum(last - first for first, last in tasks)
    pace = Pace(plan.samples.runs, plan.samples.runs - made, progress)
    if tasks:
        progress(f"runs to make: {made:,}, workers: {at.count()}")
    task: Callable[[tuple[int, int]], Chunk | None] = partial(make_runs, plan)
    if store.path is not None:
        task = partial(store_runs, plan, store.path.absolute())
    with closing(in_any_order(task, tasks, at)) as results:
        for (first, last), chunk in results:
            if chunk is not None:
                store.write(first, chunk)
            pace.add(last - first)
    return made
