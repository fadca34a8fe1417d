"""Execute tasks in parallel: on threads, an executor of concurrent.futures, or a Dask cluster.

A sweep simulates one scene many times with varied parameters; each of its tasks executes a range of these
runs. `workers` opens the place of execution, `run_tasks` executes tasks there, `probed` estimates the speed
of runs, and `Pace` reports progress.
"""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import (
    FIRST_COMPLETED,
    BrokenExecutor,
    CancelledError,
    Executor,
    Future,
    ThreadPoolExecutor,
    wait,
)
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeVar

from crosscheck.support.errors import CrosscheckError
from crosscheck.support.processes import safe_path
from crosscheck.support.time_limits import duration_text
from crosscheck.sweeps.store import HOW_TO_RESUME, SWEEP_EXTRA
from newton_euler.errors import OptionError
from newton_euler.optional_packages import optional_package
from newton_euler.runs.batch import thread_count

if TYPE_CHECKING:
    from distributed import Client

Item = TypeVar("Item")
Result = TypeVar("Result")

TASKS_PER_WORKER = 2
"""Number of submitted tasks per worker: a worker need not wait for its next task, and a crash loses few
tasks."""

RECOUNT_PERIOD_S = 2.0
"""Time between two counts of the workers, s; each count is a request to the scheduler."""

ASSUMED_WORKERS = 32
"""Number of workers that is assumed of an executor that does not report the number."""

MIN_PROBE_S = 0.05
"""Shortest duration, s, of runs from which the speed of runs is estimated."""

NO_REPEAT_ABOVE_S = 1.0
"""Duration of a single run, s, above which the measurement of its speed is not repeated."""

CONNECT_TIMEOUT_S = 10.0
"""Longest time, s, that a cluster may need to answer."""

NO_WORKERS = f"the cluster has no workers yet: waiting; press Ctrl-C to stop, {HOW_TO_RESUME}"
"""Message to the user while tasks wait for the first worker."""

DASK_LOGS = ("distributed.client", "distributed.protocol.core", "distributed.comm")
"""Names of Dask's loggers that print errors which Dask raises as well."""


@dataclass(frozen=True)
class Workers:
    """Place where tasks are executed.

    Attributes:
        executor: executor to which tasks are submitted.
        count: function that returns the current number of workers.
    """

    executor: Executor
    count: Callable[[], int]


@contextmanager
def workers(
    threads: int | None = None, executor: Executor | None = None, cluster: Client | str | None = None
) -> Iterator[Workers]:
    """Open workers: threads of this process, an executor, or a Dask cluster; at most one argument is given.

    Args:
        threads: number of threads; one per processor if no argument is given.
        executor: an executor of concurrent.futures, which stays open.
        cluster: a Dask client, or the address of a Dask scheduler.

    Raises:
        CrosscheckError: for more than one argument, and for a cluster that does not answer.
        OptionError: for an invalid number of threads, executor or cluster.
    """
    given = {"threads": threads, "executor": executor, "cluster": cluster}
    named = [name for name, value in given.items() if value is not None]
    if len(named) > 1:
        raise CrosscheckError(f"{' and '.join(named)} are different places to run at; choose one")
    if cluster is not None:
        with _client(cluster) as client:
            # without `pure=False` Dask would hash the arguments of each task
            client_executor = client.get_executor(pure=False)
            yield Workers(client_executor, lambda: sum(client.ncores().values()))
    elif executor is not None:
        if not isinstance(executor, Executor):
            raise OptionError("executor", executor, "one of concurrent.futures")
        count = getattr(executor, "_max_workers", ASSUMED_WORKERS)
        # an executor starts its processes with the first task; `safe_path` hides the current folder from them
        with safe_path():
            yield Workers(executor, lambda: count)
    else:
        count = thread_count(threads)
        with ThreadPoolExecutor(count) as pool:
            yield Workers(pool, lambda: count)


@contextmanager
def _client(cluster: Client | str) -> Iterator[Client]:
    """Yield a given client, or connect to a given address and close that connection at the end."""
    distributed = optional_package("distributed", SWEEP_EXTRA)
    if isinstance(cluster, distributed.Client):
        yield cluster
        return
    if not isinstance(cluster, str):
        raise OptionError("cluster", cluster, "a Client of Dask or an address such as tcp://10.0.0.1:8786")
    # errors are raised; Dask's logs on standard error would repeat them
    logs = [logging.getLogger(name) for name in DASK_LOGS]
    levels = [log.level for log in logs]
    for log in logs:
        log.setLevel(logging.CRITICAL + 1)  # above the level of every message
    try:
        with _connected(cluster) as client:
            yield client
    finally:
        for log, level in zip(logs, levels, strict=True):
            log.setLevel(level)


def _connected(address: str) -> Client:
    """Connect to a Dask scheduler.

    Args:
        address: address of the scheduler, such as tcp://10.0.0.1:8786.

    Raises:
        CrosscheckError: if no scheduler answers.
    """
    import dask
    import distributed

    try:
        # a security loader (a function that makes Dask's credentials) works for clients only: skip the check
        if not dask.config.get("distributed.client.security-loader", None):
            # in a separate thread, since a notebook already has an event loop
            with ThreadPoolExecutor(1) as thread:
                thread.submit(asyncio.run, _check_scheduler(address)).result()
        return distributed.Client(address, timeout=CONNECT_TIMEOUT_S, set_as_default=False)
    except Exception as error:  # Dask raises many kinds of errors for an answer of another program
        reason = " ".join(str(error).split()) or "it does not answer"
        raise CrosscheckError(f"cannot reach a scheduler of Dask at {address}: {reason}"[:300]) from error


async def _check_scheduler(address: str) -> None:
    """Raise an error unless a Dask scheduler listens at the address.

    A client would wait forever for the answer of another program.
    """
    from distributed import Security, rpc

    secured = Security().get_connection_args("client")
    async with asyncio.timeout(2.0 * CONNECT_TIMEOUT_S):  # for the connection and then for its answer
        async with rpc(address, timeout=CONNECT_TIMEOUT_S, connection_args=secured) as listener:
            kind = (await listener.identity())["type"]
    if kind != "Scheduler":
        raise OSError(f"a {kind} listens there")


def run_tasks(
    task: Callable[[Item], Result],
    items: Iterable[Item],
    pool: Workers,
    progress: Callable[[str], None] = lambda stage: None,
) -> Generator[tuple[Item, Result]]:
    """Execute a task for each item, and yield items and results in order of completion.

    At most `TASKS_PER_WORKER` tasks per worker are submitted at a time. If the generator is closed, running
    tasks complete, and waiting tasks are canceled. If the cluster has no workers yet, the function reports
    that to `progress` and waits.

    Args:
        task: function of an item; it must be picklable for processes and clusters.
        items: items, taken as tasks complete.
        pool: place of execution.
        progress: receives messages.

    Raises:
        CrosscheckError: if a task fails, or if its process or the cluster is lost.
    """
    remaining, count, last_count_time = iter(items), 1, -RECOUNT_PERIOD_S
    running: dict[Future[Result], Item] = {}
    try:
        while True:
            # count the workers from time to time, as those of a cluster come and go
            if time.perf_counter() - last_count_time > RECOUNT_PERIOD_S:
                previous_count, count, last_count_time = count, pool.count(), time.perf_counter()
                if previous_count and not count:
                    progress(NO_WORKERS)
            # submit tasks for idle workers, then yield the results of tasks that completed
            tasks_to_submit = TASKS_PER_WORKER * max(1, count) - len(running)
            for _, item in zip(range(tasks_to_submit), remaining, strict=False):
                running[pool.executor.submit(task, item)] = item
            if not running:
                return
            for future in wait(running, RECOUNT_PERIOD_S, FIRST_COMPLETED).done:
                yield running.pop(future), _result(future)
    except BrokenExecutor as error:
        raise CrosscheckError(f"a process of the executor died; {HOW_TO_RESUME}") from error
    except (OSError, CancelledError) as error:  # the scheduler does not answer any more
        raise CrosscheckError(f"the cluster was lost; {HOW_TO_RESUME}") from error
    finally:
        for future in running:
            future.cancel()


def _result(future: Future[Result]) -> Result:
    """Return the result of a completed task.

    Raises:
        CrosscheckError: for an error in the task.
        BrokenExecutor, CancelledError: for the loss of a worker.
    """
    try:
        return future.result()
    except (CrosscheckError, BrokenExecutor, CancelledError):
        raise
    except Exception as error:
        reason = " ".join(f"{type(error).__name__}: {error}".split())
        raise CrosscheckError(f"a worker failed: {reason:.300}; {HOW_TO_RESUME}") from error


class Pace:
    """Counter of completed runs that reports their number, runs per second, and the remaining time."""

    def __init__(self, runs: int, stored: int, progress: Callable[[str], None]) -> None:
        """Start to count.

        Args:
            runs: number of runs of the sweep.
            stored: number of runs that were stored before.
            progress: receives messages.
        """
        self._runs, self._stored, self._progress = runs, stored, progress
        self._executed, self._start = 0, time.perf_counter()
        if stored:
            progress(f"{stored:,} of {runs:,} runs are stored already")

    def add(self, runs: int) -> None:
        """Count further completed runs, and report to `progress`."""
        self._executed += runs
        rate = self._executed / max(time.perf_counter() - self._start, 1e-9)
        stored = self._stored + self._executed
        remaining = duration_text((self._runs - stored) / rate)
        self._progress(f"{stored:,} of {self._runs:,} runs, {rate:,.0f} per s, {remaining} left")


def probed(make: Callable[[int], Any], runs: int) -> float:
    """Estimate the runs per second of one worker from as few runs as possible.

    The number of runs grows until they take `MIN_PROBE_S`. The last measurement is repeated, since it can
    include compilation; the shorter time counts. A single run of more than `NO_REPEAT_ABOVE_S` is not
    repeated.

    Args:
        make: function that executes a number of runs.
        runs: largest number of runs to execute.
    """
    count = 1
    while True:
        seconds = _time(make, count)
        if seconds >= MIN_PROBE_S and (count > 1 or seconds < NO_REPEAT_ABOVE_S):
            seconds = min(seconds, _time(make, count))
        if seconds >= MIN_PROBE_S or count == runs:
            return count / max(seconds, 1e-3)  # a shorter time is too uncertain for a rate
        count = min(4 * count, runs)


def _time(make: Callable[[int], Any], count: int) -> float:
    """Return the time of `count` runs, s."""
    start = time.perf_counter()
    make(count)
    return time.perf_counter() - start
