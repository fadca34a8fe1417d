"""Work that is given up after so much time; what takes long says meanwhile that it goes on."""

from __future__ import annotations

import _thread
import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from crosscheck.errors import CrosscheckError
from newton_euler.limits import limit, too_small

PATIENCE = 5.0
"""s after which it is told how long it has been."""

PERIOD = 0.5
"""s, between looks at the clock."""

SHORTER = "a run of a shorter duration, or of other engines (--engines), may end"
"""What to do about one that takes too long."""


class TooLongError(CrosscheckError):
    """Something that does not come to its end in reasonable time."""


@contextmanager
def heeding_interrupts() -> Iterator[None]:
    """Have interrupts come through in the main thread, where a shell has started it to ignore them."""
    before = signal.getsignal(signal.SIGINT)
    if before is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


@contextmanager
def time_limit(seconds: float) -> Iterator[None]:
    """Give up what takes more s of processor time, as an interrupt from the keyboard would.

    In the main thread only.

    Raises:
        CrosscheckError: if it does. Native code that looks at no interrupt runs on to its end first.
    """
    rung = []

    def ring(number: int, frame: object) -> None:
        rung.append(number)
        signal.raise_signal(signal.SIGINT)

    before = signal.signal(signal.SIGPROF, ring)
    try:
        with heeding_interrupts():
            signal.setitimer(signal.ITIMER_PROF, seconds)
            try:
                yield
            finally:
                signal.setitimer(signal.ITIMER_PROF, 0.0)
                signal.signal(signal.SIGPROF, before)
    except KeyboardInterrupt:
        if rung:
            raise CrosscheckError(f"not finished after {seconds:g} s of processor time") from None
        raise


@contextmanager
def limited(what: str, advice: str, progress: Callable[[str], None]) -> Iterator[None]:
    """Interrupt the block after the limit `time`; `progress` is told `what` it does, errors say `advice`.

    In the main thread only, which alone can be interrupted.

    Raises:
        TooLongError: then.
    """
    progress(what)
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    done, given_up, begin = threading.Event(), threading.Event(), time.process_time()
    most = limit("time")  # of processor time: a wait is no reason to give up

    def watch() -> None:
        while not done.wait(PERIOD):
            used = time.process_time() - begin
            if used > most:
                given_up.set()
                _thread.interrupt_main()
                return
            if used > PATIENCE:
                progress(f"{what}: {used:.0f} s so far, given up at {most:.0f}")

    watcher = threading.Thread(target=watch, daemon=True)
    try:
        with heeding_interrupts():
            watcher.start()
            try:
                yield
            finally:
                done.set()
                watcher.join()
    except KeyboardInterrupt:
        if not given_up.is_set():
            raise
        message = f"{what}: given up after {most:g} s of processor time; {advice}; {too_small('time')}"
        raise TooLongError(message) from None
