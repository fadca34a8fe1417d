"""Python functions that native integrators call back, with safe handling of exceptions and Ctrl-C.

An exception must not pass through native code. A callback therefore stores the exception and asks the native
integrator to stop. Ctrl-C (SIGINT) during native code is stored in the same way, and handled after native
code has returned.
"""

from __future__ import annotations

import ctypes
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

import numpy as np

from newton_euler.codegen.compile import C_FUNCTION
from newton_euler.errors import NewtonEulerError
from newton_euler.integrators.stepper import STOP_ALL_RUNS, Count
from newton_euler.scalars import Array

EQUATION_ERRORS = (NewtonEulerError, np.linalg.LinAlgError)
"""Exceptions that the equations of motion raise at a state without a solution, such as a singular one.

Every other exception is a programming error or an interrupt, and ends the run."""


class PythonCallback:
    """A Python function that native code can call through an address.

    Attributes:
        function: called with the addresses of an input vector x and a result vector y (doubles), and a bit
            mask of the active lanes. A lane is one of several runs that native code integrates side by side.
        address: address of the native callback, valid as long as this object lives.
    """

    def __init__(self, function: Callable[[int, int, int], None]) -> None:
        self.function = function
        self._callback = C_FUNCTION(function)
        self.address = ctypes.c_void_p.from_buffer(self._callback).value


def vector_at(address: int, size: int) -> Array:
    """Return the doubles at a memory address as an array (size,) that shares this memory."""
    return np.ctypeslib.as_array((ctypes.c_double * size).from_address(address))


class Callbacks:
    """Callbacks of one native run, with the exceptions that they raised and the interrupts of the user.

    Attributes:
        counts: (c,) the c counters of the run, or (c, lanes) of several runs; their indices are the members
            of `newton_euler.integrators.stepper.Count`. The counter `STOP_REQUEST` asks native code to stop.
        pause: callback by which native code asks whether the user wants to stop.
        error: exception that the equations raised in the last call, else None. The integrator can recover,
            for example by a shorter step.
        fatal: exception that ended the run, else None.
    """

    def __init__(self, counts: Array, stopped: Sequence[bool] = ()) -> None:
        """Store the counters and prepare the `pause` callback.

        Args:
            counts: see the attributes of this class.
            stopped: a list that other threads may append to; the run stops if the list is not empty.
        """
        self.counts, self._stopped, self._interrupted = counts, stopped, False
        self.error: Exception | None = None
        self.fatal: BaseException | None = None
        self.pause = PythonCallback(self._pause)

    def begin(self) -> None:
        """Clear the exceptions of an earlier run."""
        self.error = self.fatal = None

    def guarded(
        self, function: Callable[[int, int, int], None], failed: Callable[[int, int], None] | None = None
    ) -> PythonCallback:
        """Wrap a function in a callback that stores exceptions instead of raising them.

        Args:
            function: called with the addresses of x and y and the bit mask of the active lanes.
            failed: called with the address of y and the mask after an exception; marks the results of the
                active lanes as invalid. If None, any exception ends the run.
        """

        def call(x: int, y: int, on: int) -> None:
            """Call the function; store an exception, mark the results and stop the run if it is fatal."""
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
        """Ask native code to end the run at its next step.

        A subclass for runs in lanes ends only the runs of the active lanes (bit mask `on`).
        """
        self.counts[Count.STOP_REQUEST] = STOP_ALL_RUNS

    def _pause(self, counts: int, request: int, on: int) -> None:
        """Request a stop if the user has pressed Ctrl-C or another thread has asked for one.

        Python runs pending signal handlers while this function executes.

        Args:
            counts: address of the counters of the run, not needed here.
            request: address of the counter `STOP_REQUEST`.
            on: bit mask of the active lanes, not needed here.
        """
        if self._interrupted or self._stopped:
            vector_at(request, 1)[0] = STOP_ALL_RUNS

    @contextmanager
    def interruptible(self) -> Iterator[None]:
        """Turn Ctrl-C during native code into a stop request, and call the usual handler afterwards."""
        handler = signal.getsignal(signal.SIGINT)
        in_main = threading.current_thread() is threading.main_thread()  # only this thread handles signals
        if not in_main or not callable(handler):
            yield
            return

        def note(number: int, frame: object) -> None:
            """Remember that the user has pressed Ctrl-C."""
            self._interrupted = True

        signal.signal(signal.SIGINT, note)
        try:
            yield
        finally:
            signal.signal(signal.SIGINT, handler)
            if self._interrupted:
                handler(signal.SIGINT, None)


class DenseCallbacks(Callbacks):
    """Callbacks of runs whose compiled equations fall back to Python near singular configurations.

    Attributes:
        derivative: callback that solves the equations of motion by dense linear algebra. The callback writes
            the n rates of a state followed by 1.0, or by -1.0 if the equations have no solution.
    """

    derivative: PythonCallback


def raise_fatal(callbacks: Callbacks) -> None:
    """Raise the fatal exception that a callback stored during a native call, if there is one."""
    if callbacks.fatal is not None:
        raise callbacks.fatal
