"""Execution of a sweep's chunks: on threads, by any executor of concurrent.futures, on a Dask cluster."""

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
from crosscheck.support.time_limits import span
from crosscheck.sweeps.store import KEPT_GOES_ON, SWEEP
from newton_euler.errors import OptionError
from newton_euler.optional_packages import optional_package
from newton_euler.runs.batch import thread_count

if TYPE_CHECKING:
    from distributed import Client

Item = TypeVar("Item")
Result = TypeVar("Result")

AHEAD = 2
"""Tasks per worker that are given out: the next is there when one ends, and few are lost with a worker."""

COUNT_AFTER = 2.0
"""s after which workers are counted again: a scheduler has other things to answer."""

USUAL_WORKERS = 32
"""Of an executor that does not say how many it has."""

PROBE, LONG = 0.05, 1.0
"""s that runs take by which their speed is told, and that one takes which is not made again for that."""

PATIENCE = 10.0
"""s for a cluster to answer."""

NO_WORKERS = f"the cluster has no workers: waiting for some; Ctrl-C ends, {KEPT_GOES_ON}"

LOGS, SILENT = ("distributed.client", "distributed.protocol.core", "distributed.comm"), logging.CRITICAL + 1
"""Logs of Dask that repeat what is raised, and a level above all of theirs."""


@dataclass(frozen=True)
class Workers:
    """An executor of tasks, and what is known of it.

    Attributes:
        executor: of tasks.
        count: returns the number of workers at the moment.
    """

    executor: Executor
    count: Callable[[], int]


@contextmanager
def workers(
    threads: int | None = None, executor: Executor | None = None, cluster: Client | str | None = None
) -> Iterator[Workers]:
    """Open workers: threads of this process, as many as it has processors unless told otherwise.

    Args:
        threads: their number.
        executor: to use instead, which stays open.
        cluster: a Dask client or the address of a scheduler to use instead.

    Raises:
        CrosscheckError: for more than one of them, and a cluster that does not answer.
        OptionError: for an impossible number of threads.
    """
    given = {"threads": threads, "executor": executor, "cluster": cluster}
    named = [name for name, value in given.items() if value is not None]
    if len(named) > 1:
        raise CrosscheckError(f"{' and '.join(named)} are different places to run at; choose one")
    if cluster is not None:
        with _client(cluster) as client:
            # what is sent along says all; a key made of it would be made anew for each task
            of_client = client.get_executor(pure=False)
            yield Workers(of_client, lambda: sum(client.ncores().values()))
    elif executor is not None:
        if not isinstance(executor, Executor):
            raise OptionError("executor", executor, "one of concurrent.futures")
        count = getattr(executor, "_max_workers", USUAL_WORKERS)
        with safe_path():  # processes start when they get their first task
            yield Workers(executor, lambda: count)
    else:
        count = thread_count(threads)
        with ThreadPoolExecutor(count) as pool:
            yield Workers(pool, lambda: count)


@contextmanager
def _client(cluster: Client | str) -> Iterator[Client]:
    """Return the client itself, or connect one to an address and close it in the end."""
    distributed = optional_package("distributed", SWEEP)
    if isinstance(cluster, distributed.Client):
        yield cluster
        return
    if not isinstance(cluster, str):
        raise OptionError("cluster", cluster, "a Client of Dask or an address such as tcp://10.0.0.1:8786")
    # what goes wrong is raised; its log on standard error would be a second voice
    logs = [logging.getLogger(name) for name in LOGS]
    levels = [log.level for log in logs]
    for log in logs:
        log.setLevel(SILENT)
    try:
        with _connected(cluster) as client:
            yield client
    finally:
        for log, level in zip(logs, levels, strict=True):
            log.setLevel(level)


def _connected(address: str) -> Client:
    """Connect to a scheduler."""
    import dask
    import distributed

    try:
        if not dask.config.get("distributed.client.security-loader", None):  # which the client alone calls
            # in a thread of its own: a notebook has an event loop already
            with ThreadPoolExecutor(1) as thread:
                thread.submit(asyncio.run, _check_scheduler(address)).result()
        return distributed.Client(address, timeout=PATIENCE, set_as_default=False)
    except Exception as error:  # whatever Dask makes of an answer that is none of Dask's
        reason = " ".join(str(error).split()) or "it does not answer"
        raise CrosscheckError(f"cannot reach a scheduler of Dask at {address}: {reason}"[:300]) from error


async def _check_scheduler(address: str) -> None:
    """Raise an error where something else than a scheduler listens: a client would wait for it for ever."""
    from distributed import Security, rpc

    secured = Security().get_connection_args("client")
    async with asyncio.timeout(2.0 * PATIENCE):  # half of it for the connection itself
        async with rpc(address, timeout=PATIENCE, connection_args=secured) as listener:
            kind = (await listener.identity())["type"]
    if kind != "Scheduler":
        raise OSError(f"a {kind} listens there")


def in_any_order(
    task: Callable[[Item], Result],
    items: Iterable[Item],
    at: Workers,
    progress: Callable[[str], None] = lambda stage: None,
) -> Generator[tuple[Item, Result]]:
    """Execute a task for each item; yields items and results as they come.

    No more than `AHEAD` tasks per worker are given out at a time, so that a million of them are no burden.
    What is running when this is left ends; what is waiting is not begun. While there are no workers, as
    before a queue lets them start, it waits for them, which `progress` is told.

    Raises:
        CrosscheckError: of a task, and where processes that make them are lost again and again.
    """
    left, count, counted = iter(items), 1, -COUNT_AFTER
    running: dict[Future[Result], Item] = {}
    try:
        while True:
            if time.perf_counter() - counted > COUNT_AFTER:
                before, count, counted = count, at.count(), time.perf_counter()
                if before and not count:
                    progress(NO_WORKERS)
            room = AHEAD * max(1, count) - len(running)
            for _, item in zip(range(room), left, strict=False):
                running[at.executor.submit(task, item)] = item
            if not running:
                return
            for future in wait(running, COUNT_AFTER, FIRST_COMPLETED).done:
                yield running.pop(future), _result(future)
    except BrokenExecutor as error:
        raise CrosscheckError(f"a process of the executor died; {KEPT_GOES_ON}") from error
    except (OSError, CancelledError) as error:  # of a scheduler that does not answer any more
        raise CrosscheckError(f"the cluster was lost; {KEPT_GOES_ON}") from error
    finally:
        for future in running:
            future.cancel()


def _result(future: Future[Result]) -> Result:
    try:
        return future.result()
    except (CrosscheckError, BrokenExecutor, CancelledError):
        raise
    except Exception as error:
        reason = " ".join(f"{type(error).__name__}: {error}".split())
        raise CrosscheckError(f"a worker failed: {reason:.300}; {KEPT_GOES_ON}") from error


class Pace:
    """Counts runs, and says how fast they come and how long the others take."""

    def __init__(self, runs: int, there: int, progress: Callable[[str], None]) -> None:
        self._runs, self._there, self._progress = runs, there, progress
        self._made, self._start = 0, time.perf_counter()
        if there:
            progress(f"{there:,} of {runs:,} runs were there")

    def add(self, runs: int) -> None:
        """Count runs that were made, and tell."""
        self._made += runs
        rate = self._made / max(time.perf_counter() - self._start, 1e-9)
        there = self._there + self._made
        left = span((self._runs - there) / rate)
        self._progress(f"{there:,} of {self._runs:,} runs, {rate:,.0f} per s, {left} left")


def probed(make: Callable[[int], Any], runs: int) -> float:
    """Measure the runs per second of one worker with as few as tell it.

    What seems to tell it is measured again, for code may have been compiled within: but for single long runs,
    of which one has been made before.
    """
    count = 1
    while True:
        taken = _time(make, count)
        if taken >= PROBE and (count > 1 or taken < LONG):
            taken = min(taken, _time(make, count))
        if taken >= PROBE or count == runs:
            return count / max(taken, 1e-3)
        count = min(4 * count, runs)


def _time(make: Callable[[int], Any], count: int) -> float:
    start = time.perf_counter()
    make(count)
    return time.perf_counter() - start
