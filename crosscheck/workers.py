"""Processes that work for another one: they end with it."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading


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
