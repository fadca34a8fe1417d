"""Execute the runs of a sweep: choose the size of tasks, run them, store the results, resume after an
interruption.

A sweep simulates one scene many times with varied parameters; its `SweepPlan` defines all runs and the
outputs that are kept of each run. A task is a range of consecutive runs that one worker executes and that are
stored together, as one chunk. `results_of` is the entry point.
"""

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
from crosscheck.support.time_limits import signals_as_interrupts
from crosscheck.sweeps.execute import Pace, Workers, probed, run_tasks
from crosscheck.sweeps.expressions import labels
from crosscheck.sweeps.plan import RUN_FAILED, Chunk, Parameters, SweepPlan, make_runs, run_all
from crosscheck.sweeps.store import (
    ERROR,
    STATUS,
    STATUS_RUNS,
    STORE_ID,
    STORE_NAME,
    Store,
    intact,
    store_runs,
)
from crosscheck.sweeps.store_files import locked
from newton_euler.errors import NewtonEulerError
from newton_euler.runs.starts import assembly_of
from newton_euler.runs.variation import own_values, run_values
from newton_euler.scalars import Array

TASK_DURATION_S = 1.0
"""Duration of a task, s: long compared with its overhead, and little work is lost if a task is lost."""

SCHEDULER_TIME_PER_TASK_S = 0.01
"""CPU time of a Dask scheduler per task, s. The scheduler serves all workers, so that tasks are longer if
there are more than 100 workers."""

MIN_TIMED_RUNS = 64
"""Smallest number of runs that the estimate of speed may execute; smaller sweeps repeat their runs for it."""

START_CHECK_RUNS = 1024
"""Number of runs whose initial states are checked together if the first run fails."""

MAX_TASK_RUNS = 2**16
"""Largest number of runs of a task."""

MAX_TASK_NUMBERS = 2**22
"""Largest number of values that are kept of all runs of a task (34 MB)."""

TIME_DIMENSION = re.compile(r"time\d*")
"""Pattern of the names of time dimensions of kept outputs: "time", "time1", and so on."""

COMPONENT_EXAMPLES = "BODY.center_of_mass.x, BODY.inertia.xy, JOINT.point.z"
"""Examples of parameters that are single numbers."""


@dataclass(frozen=True, eq=False)
class SweepResults:
    """Runs of a sweep.

    Attributes:
        plan: the plan of the sweep.
        dataset: xarray Dataset of varied parameters and kept outputs by run; on disk if the store has a path.
        store: the store of the dataset.
        executed: number of runs that were executed now; all others were stored before.
        wall_time: duration of the execution, s.
        repaired: lines about damaged files whose runs were repeated.
    """

    plan: SweepPlan
    dataset: Any
    store: Store
    executed: int
    wall_time: float
    repaired: tuple[str, ...] = ()

    @property
    def path(self) -> Path | None:
        """Path of the Zarr store; None in memory."""
        return self.store.path

    def inputs(self, runs: Array) -> Parameters:
        """Return the parameters of runs (n,)."""
        return {name: self.read(name, runs) for name in self.plan.samples.names}

    def read(self, name: str, where: Any) -> Array:
        """Return the values of a variable.

        Args:
            name: name of the variable.
            where: index of a run, slice of runs, or array of indices of runs.

        Raises:
            CrosscheckError: for damaged files.
        """
        with intact(self.path, name):
            return np.asarray(self.dataset[name][where].values)

    @cached_property
    def failed_runs(self) -> Array:
        """Indices of the failed runs; the status is read in blocks that fit into memory."""
        parts = (
            first + np.flatnonzero(self.read(STATUS, slice(first, first + STATUS_RUNS)) == RUN_FAILED)
            for first in range(0, self.plan.samples.runs, STATUS_RUNS)
        )
        return np.concatenate(list(parts))

    def reasons(self) -> Iterator[tuple[int, str]]:
        """Yield index and reason of each failed run; reasons are read in blocks that fit into memory."""
        for first in range(0, len(self.failed_runs), STATUS_RUNS):
            runs = self.failed_runs[first : first + STATUS_RUNS]
            yield from zip(runs.tolist(), map(str, self.read(ERROR, runs)), strict=True)


def results_of(
    plan: SweepPlan, folder: Path | None, pool: Workers, progress: Callable[[str], None]
) -> SweepResults:
    """Execute all runs of a plan that are not stored yet, and return all runs.

    Args:
        plan: the plan.
        folder: folder of the store; None for results in memory.
        pool: workers that execute the runs.
        progress: called with messages, such as the number of completed runs.

    Raises:
        CrosscheckError: for a folder with another plan, a folder in use by another process, a full disk, and
            workers that fail.
        NewtonEulerError: for a scene that cannot be simulated.
    """
    path = None if folder is None else folder / STORE_NAME
    start, repaired = time.perf_counter(), list[str]()
    with signals_as_interrupts(), locked(path):
        # Open the store of an interrupted sweep, or make one after a test of the first run. If the first run
        # fails, some other run must at least be able to start
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
            plan = replace(plan, chunk=_task_size(plan, pool, progress))
            store = Store.make(plan, path) if path else Store.in_memory(plan)
        # Execute the missing runs, and verify that workers on other machines wrote to the same store
        executed = _execute(plan, store, store.missing(plan), pool, progress)
        if lost := sum(last - first for first, last in store.missing(plan)):
            problem = f"{lost:,} of {plan.samples.runs:,} runs are missing in {path}"
            raise CrosscheckError(f"{problem}; needed: a folder that all workers can access")
    dataset = store.dataset()
    return SweepResults(
        plan=plan,
        dataset=dataset.load() if path is None else dataset,
        store=store,
        executed=executed,
        wall_time=time.perf_counter() - start,
        repaired=tuple(repaired),
    )


def check_names(plan: SweepPlan) -> None:
    """Check the names of kept outputs and of varied parameters.

    Raises:
        CrosscheckError: for a kept output with the name of another variable or dimension of the store, and
            for a varied parameter that is unknown or not a single number.
    """
    dimensions = labels(plan.scene)  # labels of bodies, joints, ... by name of the dimension
    taken = {*plan.samples.names, STATUS, ERROR, "run", *dimensions}
    for each in plan.kept:
        if each.name in taken or TIME_DIMENSION.fullmatch(each.name):
            raise CrosscheckError(f"{each.name!r} is the name of another variable; choose another name")
    for name in plan.samples.names:
        try:
            shape = own_values(plan.scene, [name])[name].shape
        except NewtonEulerError as error:
            hint = f" (vectors by components, as {COMPONENT_EXAMPLES}; starts as start.JOINT)"
            raise CrosscheckError(f"--vary {name}: {error}{hint}") from error
        if shape:
            parts = {(3,): "xyz", (3, 3): ("xx", "xy")}.get(shape, ())
            example = " or ".join(f"{name}.{part}" for part in parts)
            raise CrosscheckError(f"--vary {name}: it has {np.prod(shape)} numbers; name one, {example}")


def _check_starts(plan: SweepPlan, progress: Callable[[str], None]) -> None:
    """Raise `CrosscheckError` if no run can start, because of invalid values or loops that cannot be
    closed."""
    runs, reason = plan.samples.runs, ""
    for first in range(0, runs, START_CHECK_RUNS):
        last = min(first + START_CHECK_RUNS, runs)
        # reasons of runs that cannot start, by index within these runs
        values = run_values(plan.scene, plan.parameters(first, last))
        errors = dict(values.errors)
        # parameters of geometry or of the start open the loops of the mechanism: close them (assembly)
        assembly = assembly_of(plan.scene, plan.samples.names)
        if assembly.is_needed:
            _, assembly_errors = assembly(values.arrays)
            errors = assembly_errors | errors
        if len(errors) < last - first:
            return
        reason = reason or str(errors[0]).removeprefix("run 0: ")
        progress(f"none of the first {last:,} of {runs:,} runs can start: {reason}")
    # name the parameters that the reason quotes
    where = ""
    for names, distribution in plan.samples.groups:
        if any(repr(name) in reason for name in names):
            where = f"--vary {', '.join(names)}={distribution}: "
            break
    raise CrosscheckError(f"{where}no run of {runs:,} can start: {reason}")


def _task_size(plan: SweepPlan, pool: Workers, progress: Callable[[str], None]) -> int:
    """Choose the number of runs of a task so that a task takes about `TASK_DURATION_S`.

    The number is a power of 2 and does not depend on the number of runs of the sweep, so that runs can be
    added to the sweep later.
    """
    runs = plan.samples.runs

    def make(count: int) -> None:
        """Execute `count` runs; if the sweep has fewer, repeat them."""
        parameters = plan.parameters(0, min(count, runs))
        run_all(plan, {name: np.resize(values, count) for name, values in parameters.items()})

    progress("timing some runs")
    runs_per_second = probed(make, max(runs, MIN_TIMED_RUNS))
    numbers_per_run = sum(prod(map(len, each.dimensions.values())) for each in plan.kept)
    largest = min(MAX_TASK_RUNS, MAX_TASK_NUMBERS // numbers_per_run)
    duration = max(TASK_DURATION_S, SCHEDULER_TIME_PER_TASK_S * pool.count())
    wanted = max(1, min(int(duration * runs_per_second), largest))
    return 1 << (wanted.bit_length() - 1)  # the largest power of 2 that is not above it


def _execute(
    plan: SweepPlan,
    store: Store,
    tasks: Sequence[tuple[int, int]],
    pool: Workers,
    progress: Callable[[str], None],
) -> int:
    """Execute and store runs.

    Workers write to a store on disk themselves; this process writes to a store in memory.

    Args:
        plan: the plan of the sweep.
        store: the store of the results.
        tasks: ranges of runs: index of the first run, and one more than the index of the last run.
        pool: workers that execute the tasks.
        progress: receives messages.

    Returns:
        Number of executed runs.
    """
    count = sum(last - first for first, last in tasks)
    pace = Pace(plan.samples.runs, plan.samples.runs - count, progress)
    if tasks:
        progress(f"runs to execute: {count:,}, workers: {pool.count()}")
    task: Callable[[tuple[int, int]], Chunk | None] = partial(make_runs, plan)
    if store.path is not None:
        # by the identifier, workers of an earlier process find out that their store has been replaced
        task = partial(store_runs, plan, store.path.absolute(), store.group.attrs.get(STORE_ID))
    with closing(run_tasks(task, tasks, pool, progress)) as results:
        for (first, last), chunk in results:
            if chunk is not None:
                store.write(first, chunk)
            pace.add(last - first)
    return count
