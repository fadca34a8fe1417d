"""Results of sweeps: made chunk by chunk wherever they run, and taken up where they ended."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from functools import cached_property, partial
from math import prod
from pathlib import Path
from typing import Any

import numpy as np

from crosscheck.support.errors import CrosscheckError
from crosscheck.support.files import check_writable
from crosscheck.support.time_limits import tidied_up
from crosscheck.sweeps.execute import Pace, Workers, in_any_order, probed
from crosscheck.sweeps.expressions import labels
from crosscheck.sweeps.plan import STOPPED, Chunk, Parameters, Plan, make_runs, run_all
from crosscheck.sweeps.store import BLOCK, ERROR, NAME, OF_TASKS, STATUS, Store, intact, store_runs
from crosscheck.sweeps.store_files import locked
from newton_euler.errors import NewtonEulerError
from newton_euler.runs.starts import assembly_of
from newton_euler.runs.variation import own_values, run_values
from newton_euler.scalars import Array

TASK = 1.0
"""s that a task takes about: its overhead is small beside it, and little is lost with one."""

OVERHEAD = 0.01
"""s of processor time that a Dask scheduler takes for a task, so that tasks for many workers are longer."""

PROBED = 64
"""Runs by which speed is told at most where a sweep has fewer: some are made again."""

TRIED = 1024
"""Runs that are tried together where the first cannot start."""

LARGEST_TASK, MOST_NUMBERS = 2**16, 2**22
"""Runs of a task, and numbers that are kept of them, 34 MB."""

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
        repaired: lines about files that were damaged, whose runs were made again.
    """

    plan: Plan
    dataset: Any
    store: Store
    made: int
    wall_time: float
    repaired: tuple[str, ...] = ()

    @property
    def path(self) -> Path | None:
        """Of the Zarr store; None in memory."""
        return self.store.path

    def inputs(self, runs: Array) -> Parameters:
        """Return the parameters of runs (n,)."""
        return {name: self.read(name, runs) for name in self.plan.samples.names}

    def read(self, name: str, where: Any) -> Array:
        """Return a part of a variable.

        Raises:
            CrosscheckError: for files that are damaged.
        """
        with intact(self.path, name):
            return np.asarray(self.dataset[name][where].values)

    @cached_property
    def stopped(self) -> Array:
        """The numbers of runs that could not go on."""
        parts = (
            first + np.flatnonzero(self.read(STATUS, slice(first, first + BLOCK)) == STOPPED)
            for first in range(0, self.plan.samples.runs, BLOCK)
        )
        return np.concatenate(list(parts))

    def reasons(self) -> Iterator[tuple[int, str]]:
        """Yield the runs that could not go on and why, of which there may be too many for memory."""
        for first in range(0, len(self.stopped), BLOCK):
            runs = self.stopped[first : first + BLOCK]
            yield from zip(runs.tolist(), map(str, self.read(ERROR, runs)), strict=True)


def results_of(plan: Plan, folder: Path | None, at: Workers, progress: Callable[[str], None]) -> Results:
    """Make the runs of a plan that are not in a folder yet; in memory if that is None.

    Raises:
        CrosscheckError: for a folder with another plan, or that another process works at, a disk that is
            full, and workers that fail.
        NewtonEulerError: for a scene that cannot be run.
    """
    path = None if folder is None else folder / NAME
    start, repaired = time.perf_counter(), list[str]()
    with tidied_up(), locked(path):
        if path is not None and path.exists():
            store = Store.checked(path)
            plan = store.resumed(plan)
            repaired = store.discard_damaged(plan)
        else:
            if path is not None:
                check_writable(path)
            progress("compiling")
            if run_all(plan, plan.parameters(0, 1)).errors[0]:
                _check_starts(plan, progress)
            plan = replace(plan, chunk=_task(plan, at, progress))
            store = Store.make(plan, path) if path else Store.in_memory(plan)
        made = _make(plan, store, store.missing(plan), at, progress)
        if lost := sum(last - first for first, last in store.missing(plan)):
            problem = f"{lost:,} of {plan.samples.runs:,} runs are not in {path}"
            raise CrosscheckError(f"{problem}; needed: a folder that all workers see")
    dataset = store.dataset()
    wall_time = time.perf_counter() - start
    return Results(plan, dataset.load() if path is None else dataset, store, made, wall_time, tuple(repaired))


def check_names(plan: Plan) -> None:
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


def _check_starts(plan: Plan, progress: Callable[[str], None]) -> None:
    """Raise `CrosscheckError` where no run can start: for values without sense, or loops that stay open."""
    runs, reason = plan.samples.runs, ""
    for first in range(0, runs, TRIED):
        last = min(first + TRIED, runs)
        values = run_values(plan.scene, plan.parameters(first, last))
        errors, assembly = dict(values.errors), assembly_of(plan.scene, plan.samples.names)
        if assembly.is_needed:
            errors = assembly(values.arrays)[1] | errors
        if len(errors) < last - first:
            return
        reason = reason or str(errors[0]).removeprefix("run 0: ")
        progress(f"none of the first {last:,} of {runs:,} runs can start: {reason}")
    guilty = (group for group in plan.samples.groups if any(repr(name) in reason for name in group[0]))
    where = next((f"--vary {', '.join(names)}={given}: " for names, given in guilty), "")
    raise CrosscheckError(f"{where}no run of {runs:,} can start: {reason}")


def _task(plan: Plan, at: Workers, progress: Callable[[str], None]) -> int:
    """Return how many runs take about as long as a task is to take: a power of 2, however few runs there are.

    So a sweep that goes on with more of them has tasks that are as long.
    """
    runs = plan.samples.runs

    def make(count: int) -> None:
        own = plan.parameters(0, min(count, runs))
        run_all(plan, {name: np.resize(values, count) for name, values in own.items()})

    progress("timing some runs")
    rate = probed(make, max(runs, PROBED))
    numbers = sum(prod(map(len, each.dimensions.values())) for each in plan.kept)
    largest = min(LARGEST_TASK, MOST_NUMBERS // numbers)
    about = max(1, min(int(max(TASK, OVERHEAD * at.count()) * rate), largest))
    return 1 << (about.bit_length() - 1)


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
        task = partial(store_runs, plan, store.path.absolute(), store.group.attrs.get(OF_TASKS))
    with closing(in_any_order(task, tasks, at, progress)) as results:
        for (first, last), chunk in results:
            if chunk is not None:
                store.write(first, chunk)
            pace.add(last - first)
    return made
