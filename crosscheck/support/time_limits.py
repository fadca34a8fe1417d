"""Work that is given up after so much processor time; what takes long says meanwhile that it goes on."""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import TypeVar

from crosscheck.support.errors import CrosscheckError
from newton_euler.limits import limit, number_text, too_small

PATIENCE = 5.0
"""s after which it is told how long it has been."""

PERIOD = 0.5
"""s of processor time between looks at it."""

SHORTER = "a run of a shorter duration, or of other engines (--engines), may end"
"""Advice on a run that takes too long."""


Item = TypeVar("Item")


class TooLongError(CrosscheckError):
    """Something that does not come to its end in reasonable time."""


@contextmanager
def time_limit(seconds: float, progress: Callable[[float], None] = lambda used: None) -> Iterator[None]:
    """Give up what takes more s of processor time, as an interrupt from the keyboard would.

    In the main thread only, and not inside itself. `progress` is told the s used every `PERIOD`.

    Raises:
        TooLongError: if it does. Native code that looks at no interrupt runs on to its end first.
    """
    begin, over = time.process_time(), []

    def look(number: int, frame: object) -> None:
        used = time.process_time() - begin
        if used < seconds:
            progress(used)
            return
        over.append(used)
        signal.raise_signal(signal.SIGINT)  # and again, as one is lost where an object is freed

    at_work, at_interrupt = signal.signal(signal.SIGPROF, look), signal.getsignal(signal.SIGINT)
    if at_interrupt is signal.SIG_IGN:  # as a shell starts what runs in its background
        signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        signal.setitimer(signal.ITIMER_PROF, min(PERIOD, seconds), PERIOD)
        try:
            yield
        finally:
            signal.setitimer(signal.ITIMER_PROF, 0.0)
            signal.signal(signal.SIGPROF, at_work)
            signal.signal(signal.SIGINT, at_interrupt)
    except (KeyboardInterrupt, SystemError):  # what CPython 3.11 makes of an interrupt while `ast` parses
        if over:
            raise TooLongError(f"not finished after {number_text(seconds)} s of processor time") from None
        raise


@contextmanager
def limited(what: str, advice: str, progress: Callable[[str], None], name: str = "time") -> Iterator[None]:
    """Interrupt the block after a limit; `progress` is told `what` it does, errors say `advice`.

    Args:
        name: of the limit, s of processor time.

    Outside of the main thread, which alone can be interrupted, there is no limit.

    Raises:
        TooLongError: then.
    """
    progress(what)
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    most = limit(name)  # of processor time: a wait is no reason to give up

    def tell(used: float) -> None:
        if used > PATIENCE:
            progress(f"{what}: {used:.0f} s so far, given up at {most:.0f}")

    try:
        with time_limit(most, tell):
            yield
    except TooLongError:
        message = (
            f"{what}: given up after {number_text(most)} s of processor time; {advice}; {too_small(name)}"
        )
        raise TooLongError(message) from None


@contextmanager
def tidied_up() -> Iterator[None]:
    """Let a request to end, or the end of the terminal, interrupt a block as Ctrl-C does: it tidies up.

    A signal that this process ignores, such as a hangup after `nohup`, remains ignored. Elsewhere there is
    nothing to tidy up, and Python would hear of the request only after what runs in native code.
    """
    if threading.current_thread() is not threading.main_thread():  # the only one that hears of signals
        yield
        return
    handlers = {signal.SIGTERM: signal.default_int_handler, signal.SIGHUP: _hung_up}
    heard = [number for number in handlers if signal.getsignal(number) != signal.SIG_IGN]
    before = {number: signal.signal(number, handlers[number]) for number in heard}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _hung_up(number: int, frame: object) -> None:
    """Raise `KeyboardInterrupt` once: both the shell and the kernel may send the signal."""
    signal.signal(number, signal.SIG_IGN)
    raise KeyboardInterrupt


def paced(items: Sequence[Item], progress: Callable[[str], None], what: str) -> Iterator[Item]:
    """Yield work to do one after another; `progress` is told the number, the rate and the time left."""
    start = time.perf_counter()
    for count, item in enumerate(items):
        each = (time.perf_counter() - start) / max(1, count)
        left = f"{each:.2g} s each, {span(each * (len(items) - count))}" if count else "unknown time"
        progress(f"{what} {count + 1} of {len(items)}, {left} left")
        yield item


def span(seconds: float) -> str:
    """Word a time that something takes."""
    if seconds < 90.0:
        return f"{seconds:.0f} s"
    minutes = seconds / 60.0
    return f"{minutes:.0f} min" if minutes < 90.0 else f"{minutes / 60.0:.1f} h"
