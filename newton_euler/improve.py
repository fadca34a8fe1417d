"""Better code for what was compiled in a hurry, made while that is in use.

Both round alike, so when the exchange happens changes nothing but the time that a run takes.
"""

from __future__ import annotations

import os
import threading
from collections import deque
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from newton_euler.compile import NativeModule


MOST_WAITING = 24
"""Modules; of more scenes than that in a row the earliest keep the code that they have."""

PATIENCE = 60.0
"""s after which a hurry is taken to have ended in a way that nobody was told of."""


class _Improver:
    """A thread that improves one module after the other, as long as there are any.

    It is the only one, for LLVM's binding does one thing at a time, and gives way between two modules to what
    is compiled in a hurry. A process waits for it before it ends, so that the next one finds good code in
    the cache.
    """

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._working = threading.Lock()
        self._waiting: deque[NativeModule] = deque(maxlen=MOST_WAITING)
        self._hurries = 0
        self._thread: threading.Thread | None = None

    def add(self, modules: Iterable[NativeModule]) -> None:
        with self._changed:
            new = [module for module in modules if module.quick and module not in self._waiting]
            self._waiting.extendleft(reversed(new))  # what was asked for last is in use
            if self._waiting and self._thread is None:
                thread = threading.Thread(target=self._work, name="newton_euler compiler")
                thread.start()
                self._thread = thread

    @contextmanager
    def give_way(self) -> Iterator[None]:
        with self._changed:
            self._hurries += 1
        try:
            yield
        finally:
            with self._changed:
                self._hurries -= 1
                self._changed.notify_all()

    def finish(self) -> None:
        while True:
            with self._changed:
                thread = self._thread
            if thread is None:
                return
            thread.join()

    def before_fork(self) -> None:
        """Have nothing under way: a child would find locked what a thread holds that it does not have."""
        self._working.acquire()
        self._changed.acquire()

    def after_fork(self) -> None:
        self._changed.release()
        self._working.release()

    def _work(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: not self._hurries, PATIENCE)
                if not self._waiting:
                    self._thread = None
                    return
                module = self._waiting.popleft()
            with self._working, suppress(Exception):  # a run goes on with what it has
                module.improve()


_IMPROVER = _Improver()

improve = _IMPROVER.add
"""Have modules improved, in a thread of its own."""

giving_way = _IMPROVER.give_way
"""A context in which none is begun."""

finish_improving = _IMPROVER.finish
"""Wait until all modules are improved, as benchmarks do."""

if hasattr(os, "register_at_fork"):
    os.register_at_fork(
        before=_IMPROVER.before_fork,
        after_in_parent=_IMPROVER.after_fork,
        after_in_child=_IMPROVER.__init__,  # type: ignore[misc]  # without the thread that worked in the parent
    )
