"""Processes that work for another one, and the end of them all."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def tidied_up() -> Iterator[None]:
    """A block that a request to end interrupts as Ctrl-C does, so that it tidies up behind itself.

    Elsewhere there is nothing to tidy up, and Python would hear of the request only after what runs in
    native code.
    """
    if threading.current_thread() is not threading.main_thread():  # the only one that hears of signals
        yield
        return
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def end_with_parent() -> None:
    """Have a process of `multiprocessing` end when its parent has, however that did; called at its start.

    Otherwise it would wait for work for ever. Interrupts, which a terminal sends to all, are the parent's.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()

    def watch() -> None:
        if parent is not None:
            parent.join()
            os.kill(os.getpid(), signal.SIGTERM)

    threading.Thread(target=watch, daemon=True).start()
