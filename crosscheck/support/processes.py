"""Run tasks in several Python processes, which end when the main process ends.

The processes do not import modules from the current folder, since its files may come from someone else.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, as_completed
from contextlib import contextmanager
from typing import TypeVar

from pebble import ProcessExpired, ProcessPool

from crosscheck.support.errors import CrosscheckError
from crosscheck.support.time_limits import signals_as_interrupts

Task = TypeVar("Task")
Result = TypeVar("Result")

SAFE_PATH = "PYTHONSAFEPATH"
"""Environment variable that makes Python ignore modules in the current folder."""


@contextmanager
def safe_path() -> Iterator[None]:
    """Set `PYTHONSAFEPATH` within a block, for all Python processes that start there.

    Without it, `python -c` and `python -m` look for modules in the current folder first. A file `socket.py`
    that came with a model would then run in place of Python's own.
    """
    before = os.environ.get(SAFE_PATH)
    os.environ[SAFE_PATH] = "1"
    try:
        yield
    finally:
        if before is None:
            del os.environ[SAFE_PATH]
        else:
            os.environ[SAFE_PATH] = before


class ProcessLostError(CrosscheckError):
    """The process of a task ended, by a crash or a time limit, before the task was done."""


def run_in_processes(
    function: Callable[[Task], Result],
    tasks: Sequence[Task],
    processes: int,
    done: Callable[[int, Task], None],
    limit: Callable[[Task], float] = lambda task: 0.0,
) -> list[Result | ProcessLostError]:
    """Apply a function to each task in other processes, and return the results in the order of the tasks.

    Args:
        function: a function of a module (so that it can be pickled), which raises no exceptions.
        tasks: arguments of the function, started in this order.
        processes: largest number of processes at a time.
        done: called after each task with the number of finished tasks and the task that finished last.
        limit: returns the processor time, s, after which the process of a task is ended; 0 for no limit.

    Returns:
        The result of each task, or the error if its process ended too early.
    """
    # "spawn" starts fresh processes: a forked one would inherit locks that threads of libraries hold
    context = multiprocessing.get_context("spawn")
    results = dict[int, Result | ProcessLostError]()
    # SIGTERM and SIGHUP raise KeyboardInterrupt, as Ctrl-C does, so that `finally` ends the processes
    with signals_as_interrupts(), safe_path():
        workers = min(processes, len(tasks)) or 1
        pool = ProcessPool(workers, initializer=_end_with_parent, context=context)
        try:
            task_numbers: dict[Future[Result], int] = {
                pool.schedule(_run_limited, (function, task, limit(task))): k for k, task in enumerate(tasks)
            }
            for future in as_completed(task_numbers):
                number = task_numbers[future]
                try:
                    results[number] = future.result()
                except ProcessExpired as error:
                    results[number] = ProcessLostError(_end_text(error.exitcode, limit(tasks[number])))
                done(len(results), tasks[number])
        finally:
            for process in multiprocessing.active_children():
                process.kill()  # so that `stop` need not wait for locks that starting processes hold
            pool.stop()  # type: ignore[no-untyped-call]
            pool.join()
    return [results[k] for k in range(len(tasks))]


def _end_text(status: int, limit: float) -> str:
    """Describe why a process ended, by its exit status and its limit of processor time, s."""
    if status == -signal.SIGPROF:  # ended by the timer of `_run_limited`
        return f"not done after {limit:g} s of processor time"
    return f"the process ended, {status}"


def _run_limited(function: Callable[[Task], Result], task: Task, limit: float) -> Result:
    """Apply a function to a task; after `limit` s of processor time, a timer's signal ends the process."""
    signal.setitimer(signal.ITIMER_PROF, limit)
    try:
        return function(task)
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)


def _end_with_parent() -> None:
    """Watch the parent process, and end this process when the parent has ended for whatever reason.

    Without this, the process would wait for work forever. Ctrl-C, which a terminal sends to all processes,
    is ignored: the parent handles it.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()

    def watch() -> None:
        if parent is not None:
            parent.join()
            os.kill(os.getpid(), signal.SIGTERM)

    threading.Thread(target=watch, daemon=True).start()
