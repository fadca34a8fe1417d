"""Python processes that work for this one: started without the current folder, ended with their parent."""

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
from crosscheck.support.time_limits import tidied_up

Task = TypeVar("Task")
Result = TypeVar("Result")


SAFE_PATH = "PYTHONSAFEPATH"
"""Environment variable by which Python does not look for modules in the current folder."""


@contextmanager
def safe_path() -> Iterator[None]:
    """Keep Python processes that start in the block, by whatever library, from the current folder's modules.

    `python -c` and `python -m` look for modules there first. A file `socket.py` that came with a model would
    run in place of Python's own.
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


class LostError(CrosscheckError):
    """A process ended before its task was done."""


def in_processes(
    function: Callable[[Task], Result],
    tasks: Sequence[Task],
    processes: int,
    done: Callable[[int, Task], None],
    limit: Callable[[Task], float] = lambda task: 0.0,
) -> list[Result | LostError]:
    """Apply a function to tasks in processes of their own, and return the results in the order of the tasks.

    Args:
        function: of a module, which raises nothing.
        tasks: begun in this order.
        processes: how many at a time.
        done: told how many tasks are done, and the last of them.
        limit: s of processor time after which a task's process is ended, native code or not; 0 for none.
    """
    # fresh processes: a fork would share the threads that libraries have started
    context = multiprocessing.get_context("spawn")
    results = dict[int, Result | LostError]()
    with tidied_up(), safe_path():
        pool = ProcessPool(min(processes, len(tasks)) or 1, initializer=_end_with_parent, context=context)
        try:
            running: dict[Future[Result], int] = {
                pool.schedule(_run, (function, task, limit(task))): k for k, task in enumerate(tasks)
            }
            for future in as_completed(running):
                number = running[future]
                try:
                    results[number] = future.result()
                except ProcessExpired as error:
                    results[number] = LostError(_end(error.exitcode, limit(tasks[number])))
                done(len(results), tasks[number])
        finally:
            for process in multiprocessing.active_children():
                process.kill()  # before the pool takes locks from those that are just starting
            pool.stop()  # type: ignore[no-untyped-call]
            pool.join()
    return [results[k] for k in range(len(tasks))]


def _end(status: int, limit: float) -> str:
    if status == -signal.SIGPROF:
        return f"not done after {limit:g} s of processor time"
    return f"the process ended, {status}"


def _run(function: Callable[[Task], Result], task: Task, limit: float) -> Result:
    """Apply the function; the timer's signal ends the process."""
    signal.setitimer(signal.ITIMER_PROF, limit)
    try:
        return function(task)
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)


def _end_with_parent() -> None:
    """Have this process end when its parent has, however that did.

    Otherwise it would wait for work for ever. Interrupts, which a terminal sends to all, are the parent's.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()

    def watch() -> None:
        if parent is not None:
            parent.join()
            os.kill(os.getpid(), signal.SIGTERM)

    threading.Thread(target=watch, daemon=True).start()
