"""Python that native code calls: nothing is raised into native code, and interrupts end runs."""

from __future__ import annotations

import ctypes
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

import numpy as np

from newton_euler.codegen.compile import CALLBACK
from newton_euler.errors import NewtonEulerError
from newton_euler.integrators.stepper import STOP_ALL_RUNS, Count
from newton_euler.scalars import Array

EQUATION_ERRORS = (NewtonEulerError, np.linalg.LinAlgError)
"""Errors of the equations at a state; all others are mistakes of the program, or the user's wish to stop."""


class PythonCallback:
    """A Python function that native code calls, with addresses of x and y and the lanes that are on.

    Attributes:
        function: the function.
        address: of the native callback, valid as long as this object lives.
    """

    def __init__(self, function: Callable[[int, int, int], None]) -> None:
        self.function = function
        self._callback = CALLBACK(function)
        self.address = ctypes.c_void_p.from_buffer(self._callback).value


def vector_at(address: int, size: int) -> Array:
    """Return the doubles at an address as an array."""
    return np.ctypeslib.as_array((ctypes.c_double * size).from_address(address))


class Callbacks:
    """Python functions that native code calls in a run, what they raised, and interrupts.

    Attributes:
        counts: (COUNTS,) of the run, or (COUNTS, lanes) of as many, see `newton_euler.integrators.stepper`.
        pause: callback that asks whether the user wants to stop.
        error: error of the equations in the last call, for which the native method has an answer, such as a
            shorter step; None if the last call had none.
        fatal: what ended the run, None if nothing did.
    """

    def __init__(self, counts: Array, stopped: Sequence[bool] = ()) -> None:
        """A run stops if `stopped`, which other threads may fill, holds something."""
        self.counts, self._stopped, self._interrupted = counts, stopped, False
        self.error: Exception | None = None
        self.fatal: BaseException | None = None
        self.pause = PythonCallback(self._pause)

    def begin(self) -> None:
        """Forget what an earlier run left."""
        self.error = self.fatal = None

    def guarded(
        self, function: Callable[[int, int, int], None], failed: Callable[[int, int], None] | None = None
    ) -> PythonCallback:
        """Return a callback that keeps what the function raises.

        Args:
            function: gets the addresses of x and y and the lanes that are on.
            failed: marks the results at the address of y as those of a state without an answer, in the lanes
                that are on. Without it, any error ends the run.
        """

        def call(x: int, y: int, on: int) -> None:
            try:
                function(x, y, on)
                self.error = None
            except BaseException as error:
                if failed is not None and isinstance(error, EQUATION_ERRORS):
                    self.error = error
                else:
                    self.fatal = self.fatal or error
                    self._end(on)
                if failed is not None:
                    failed(y, on)
            if self._interrupted:
                self._end(on)

        return PythonCallback(call)

    def _end(self, on: int) -> None:
        """End the runs in the lanes that are on at their next step."""
        self.counts[Count.STOP_REQUEST] = STOP_ALL_RUNS

    def _pause(self, counts: int, wish: int, on: int) -> None:
        """Python runs signal handlers here, between two of its own instructions."""
        if self._interrupted or self._stopped:
            vector_at(wish, 1)[0] = STOP_ALL_RUNS

    @contextmanager
    def interruptible(self) -> Iterator[None]:
        """Turn an interrupt during native code into a wish to stop, and call its handler afterwards."""
        handler = signal.getsignal(signal.SIGINT)
        in_main = threading.current_thread() is threading.main_thread()  # which alone handles signals
        if not in_main or not callable(handler):
            yield
            return

        def note(number: int, frame: object) -> None:
            self._interrupted = True

        signal.signal(signal.SIGINT, note)
        try:
            yield
        finally:
            signal.signal(signal.SIGINT, handler)
            if self._interrupted:
                handler(signal.SIGINT, None)


class DenseCallbacks(Callbacks):
    """Callbacks with one for the dense form of the equations.

    Attributes:
        derivative: callback that writes n rates and 1.0, or anything and -1.0 if there are none.
    """

    derivative: PythonCallback


def raise_fatal(callbacks: Callbacks) -> None:
    """Raise what ended native code other than a run."""
    if callbacks.fatal is not None:
        raise callbacks.fatal
