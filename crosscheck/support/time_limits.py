"""Limits on processor time, with progress messages while a long computation runs.

`time_limit` interrupts a block of code after a number of seconds of processor time, as Ctrl-C would.
`limited` does the same with a limit that the user can set, and with messages for the user.
`signals_as_interrupts` lets a block clean up when the process is asked to terminate. `with_progress` shows
how many of a number of items are done.
"""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import TypeVar

from crosscheck.support.errors import CrosscheckError
from newton_euler.limits import limit, number_text, too_small

REPORT_AFTER_S = 5.0
"""Processor time, s, after which progress messages include the time used so far."""

CHECK_PERIOD_S = 0.5
"""Processor time, s, between two checks of the time used."""

SHORTER_RUN_ADVICE = "a run of a shorter duration, or of other engines (--engines), may end"
"""Advice in the error message of a run that exceeds its limit."""

Item = TypeVar("Item")


class TooLongError(CrosscheckError):
    """A computation used more processor time than its limit."""


@contextmanager
def time_limit(seconds: float, progress: Callable[[float], None] = lambda used: None) -> Iterator[None]:
    """Interrupt a block after a number of seconds of processor time, as Ctrl-C would.

    Works in the main thread only, and cannot be nested.

    Args:
        seconds: limit, s of processor time.
        progress: called with the processor time used, s, every `CHECK_PERIOD_S`.

    Raises:
        TooLongError: if the limit is exceeded. Native code that ignores interrupts completes first.
    """
    begin, is_exceeded = time.process_time(), False

    def check(number: int, frame: object) -> None:
        """Handle the signal of the timer: show the time used, or interrupt the block."""
        nonlocal is_exceeded
        used = time.process_time() - begin
        if used < seconds:
            progress(used)
            return
        is_exceeded = True
        # repeated at the next check: an interrupt that is raised while an object is freed gets lost
        signal.raise_signal(signal.SIGINT)

    previous_timer, previous_interrupt = signal.signal(signal.SIGPROF, check), signal.getsignal(signal.SIGINT)
    if previous_interrupt is signal.SIG_IGN:  # a shell starts background processes with SIGINT ignored
        signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        signal.setitimer(signal.ITIMER_PROF, min(CHECK_PERIOD_S, seconds), CHECK_PERIOD_S)
        try:
            yield
        finally:
            signal.setitimer(signal.ITIMER_PROF, 0.0)
            signal.signal(signal.SIGPROF, previous_timer)
            signal.signal(signal.SIGINT, previous_interrupt)
    except (KeyboardInterrupt, SystemError):  # CPython 3.11 raises SystemError if interrupted in `ast.parse`
        if is_exceeded:
            raise TooLongError(f"not finished after {number_text(seconds)} s of processor time") from None
        raise


@contextmanager
def limited(what: str, advice: str, progress: Callable[[str], None], name: str = "time") -> Iterator[None]:
    """Interrupt a block after a limit of processor time that the user can set, for example `--set time=600`.

    Outside of the main thread there is no limit, since Python interrupts the main thread only.

    Args:
        what: description of the block, such as "mujoco: 1 s of pendulum", for messages.
        advice: what the user can do if the limit is exceeded, for the error message.
        progress: shows a message to the user.
        name: name of the limit in `newton_euler.limits.LIMITS`; its unit is s of processor time.

    Raises:
        TooLongError: if the limit is exceeded.
    """
    progress(what)
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    allowed = limit(name)  # of processor time, so that waiting does not count

    def report(used: float) -> None:
        """Show the processor time used, s, if the block takes long."""
        if used > REPORT_AFTER_S:
            progress(f"{what}: {used:.0f} s so far, given up at {allowed:.0f}")

    try:
        with time_limit(allowed, report):
            yield
    except TooLongError:
        used = f"given up after {number_text(allowed)} s of processor time"
        how_to_raise = too_small(name)  # such as "to allow more: --set time=2400"
        raise TooLongError(f"{what}: {used}; {advice}; {how_to_raise}") from None


@contextmanager
def signals_as_interrupts() -> Iterator[None]:
    """Raise `KeyboardInterrupt` at SIGTERM and SIGHUP within a block, so that the block cleans up as at
    Ctrl-C.

    A signal that the process ignores, such as SIGHUP after `nohup`, remains ignored. Outside of such blocks
    the signals end the process at once: there is nothing to clean up, and Python would handle a signal only
    after native code has completed.
    """
    if threading.current_thread() is not threading.main_thread():  # only the main thread handles signals
        yield
        return
    handlers = {signal.SIGTERM: signal.default_int_handler, signal.SIGHUP: _interrupt_once}
    handled = [number for number in handlers if signal.getsignal(number) != signal.SIG_IGN]
    previous = {number: signal.signal(number, handlers[number]) for number in handled}
    try:
        yield
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)


def _interrupt_once(number: int, frame: object) -> None:
    """Raise `KeyboardInterrupt` at the first signal of this number, and ignore further ones.

    When a terminal closes, both the shell and the kernel may send SIGHUP.
    """
    signal.signal(number, signal.SIG_IGN)
    raise KeyboardInterrupt


def with_progress(items: Sequence[Item], progress: Callable[[str], None], what: str) -> Iterator[Item]:
    """Yield items one by one; before each, show its number, the time per item so far and the time left.

    Args:
        items: work to do, an item at a time.
        progress: shows a message to the user.
        what: what an item is, such as "run".
    """
    start = time.perf_counter()
    for done, item in enumerate(items):
        time_left = "unknown time"
        if done:
            per_item = (time.perf_counter() - start) / done
            time_left = f"{per_item:.2g} s each, {duration_text(per_item * (len(items) - done))}"
        progress(f"{what} {done + 1} of {len(items)}, {time_left} left")
        yield item


def duration_text(seconds: float) -> str:
    """Format a duration, given in s, as whole seconds, whole minutes or tenths of an hour."""
    if seconds < 90.0:
        return f"{seconds:.0f} s"
    minutes = seconds / 60.0
    return f"{minutes:.0f} min" if minutes < 90.0 else f"{minutes / 60.0:.1f} h"
