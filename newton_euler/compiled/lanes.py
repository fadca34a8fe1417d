"""Integrate several runs of a compiled scene at once, one in each lane of the processor's vector registers.

A lane is one element of a vector register, such as one of four doubles. The integrator is the same as in
`newton_euler.compiled.run`, compiled for several runs (`newton_euler.codegen.translate`). Each lane has its
own steps, error control and projection, and takes the next run when its run is complete. Results are bitwise
equal to single runs. A run that needs Python, near a singular configuration or for an error message, leaves
its lane; scalar code repeats it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from newton_euler.codegen.compile import lane_count
from newton_euler.compiled.callbacks import DenseCallbacks, vector_at
from newton_euler.compiled.equations import CompiledEquations
from newton_euler.compiled.outputs import Outputs
from newton_euler.compiled.records import equations, marks, method_of, table_of
from newton_euler.compiled.run import METHODS, Integrator, load_code, native_method, needed
from newton_euler.errors import NewtonEulerError
from newton_euler.integrators.options import FIXED, Options
from newton_euler.integrators.status import Status
from newton_euler.integrators.stepper import COUNTS, LEAVE_LANE, STOP_ALL_RUNS, Count, Table
from newton_euler.model.trajectory import IntegrationError
from newton_euler.scalars import Array

LANE_METHODS = frozenset({"DOP853", *FIXED})
"""Integrators that run in lanes. Radau does not: its linear solver chooses different pivots in each run."""

MAX_TABLE_BYTES = 4_000_000
"""Memory for the states of a group of runs, bytes; the value fits into the cache of a processor core.

A group is a number of runs that one call of native code integrates."""

MIN_GROUP, MAX_GROUP = 32, 1024
"""Smallest and largest number of runs in a group. Small groups waste time, because some lanes are idle while
the last runs of a group complete."""


def runs_in_lanes(code: CompiledEquations, integrator: str) -> bool:
    """Return True if runs of a scene with an integrator are integrated in lanes.

    Runs with splines or other piecewise functions of time restart at the knots of the functions, and runs
    with digital controllers (`scene.sampled`) at their samples. Such runs are integrated one by one.
    """
    return integrator in LANE_METHODS and not code.piecewise and not code.scene.sampled


def load_lanes(code: CompiledEquations, integrator: str) -> None:
    """Compile or load all functions that single runs and runs in lanes need."""
    load_code(code, integrator)
    if runs_in_lanes(code, integrator):
        native_method(METHODS[integrator], in_lanes=True)
        for name in needed(code, integrator):
            if name != "output":  # outputs are computed after the runs, by the same function as for one run
                code.function(name, in_lanes=True)


class LaneExit(DenseCallbacks):
    """Callbacks of native code in lanes: a run whose equations would need Python leaves its lane.

    Scalar code repeats such runs, and runs in which a callback raises an error, and reports the error.
    """

    def __init__(self, code: CompiledEquations, counts: Array, stopped: Sequence[bool]) -> None:
        """Prepare the callbacks.

        Args:
            code: compiled equations of the scene.
            counts: (COUNTS, lanes) counters of the runs, see `newton_euler.integrators.stepper.Count`.
            stopped: a list that other threads may append to; all runs stop if the list is not empty.
        """
        super().__init__(counts, stopped)
        self._size = code.size
        self.derivative = self.guarded(self._leave)

    def _leave(self, x: int, y: int, on: int) -> None:
        """Mark the rates as missing in the active lanes (bit mask `on`), and make their runs leave.

        The memory at address y has the rates (size, lanes), then a row with 1.0 for lanes whose rates exist
        and -1.0 for others.
        """
        count = self.counts.shape[1]
        vector_at(y, (self._size + 1) * count).reshape(-1, count)[self._size, self._lanes(on)] = -1.0
        self._end(on)

    def _end(self, on: int) -> None:
        """Ask the runs of the active lanes (bit mask `on`) to leave."""
        self.counts[Count.STOP_REQUEST, self._lanes(on)] = LEAVE_LANE

    def _lanes(self, on: int) -> list[int]:
        """Return the numbers of the active lanes from their bit mask."""
        return [lane for lane in range(self.counts.shape[1]) if on >> lane & 1]

    def _pause(self, counts: int, request: int, on: int) -> None:
        """Stop all runs if another thread has asked for it; native code calls this function regularly."""
        if self._stopped:
            self.counts[Count.STOP_REQUEST] = STOP_ALL_RUNS


class Runs(NamedTuple):
    """Many runs of a scene: their starts, and their results once they are integrated.

    Attributes:
        starts: (runs, inputs) initial states with time, flags (1 for a redundant constraint row that is left
            out) and parameters.
        results: (runs, n, outputs) at the n output times; NaN for runs that stopped early.
        counts: (runs, COUNTS) counters, see `newton_euler.integrators.stepper.Count`.
        errors: errors of runs that could not start or stopped early, by number of the run.
    """

    starts: Array
    results: Array
    counts: Array
    errors: dict[int, NewtonEulerError]


class SideBySide:
    """An integrator in lanes for runs of a compiled scene over given output times.

    Calling the object integrates some of the runs. Each thread needs its own object.
    """

    def __init__(
        self, code: CompiledEquations, times: Array, options: Options, stopped: Sequence[bool] = ()
    ) -> None:
        """Bind the compiled equations to the integrator and allocate its memory.

        Args:
            code: compiled equations of the scene.
            times: (n,) s, output times.
            options: integrator and step control.
            stopped: a list that other threads may append to; all runs stop if the list is not empty.
        """
        # a scalar integrator for runs that leave their lanes, and the number of runs in a group
        self._code, self._stopped = code, stopped
        self._alone = Integrator(code, times, options, stopped)
        bytes_of_run = 8 * len(times) * max(code.size, 1)
        self._group = min(max(MAX_TABLE_BYTES // bytes_of_run, MIN_GROUP), MAX_GROUP)
        # the integrator in lanes
        counts = np.zeros((COUNTS, lane_count()))
        python = LaneExit(code, counts, stopped)
        derivative = code.function("derivative", in_lanes=True)
        # marks: angles and quaternions that the integrator wraps or normalizes after each step
        system = equations(code, python, derivative, marks(code, options.integrator))
        # steps: no room, so that no steps of the runs are recorded
        method = method_of(code, options, steps=np.zeros((0, 0)), lanes=lane_count())
        integrate = METHODS[options.integrator]
        self._times = times.copy()
        self._states = np.zeros((self._group, len(times), code.size))
        native = native_method(integrate, in_lanes=True)
        self._run: Callable[[Table], None] = lambda table: native(integrate, system, table, method)

    def __call__(self, runs: Runs, numbers: Array) -> None:
        """Integrate some of the runs, given by their numbers (k,), and write their results into `runs`."""
        for first in range(0, len(numbers), self._group):
            if self._stopped:
                return
            self._run_group(runs, numbers[first : first + self._group])

    def _run_group(self, runs: Runs, numbers: Array) -> None:
        """Integrate a group of runs, given by their numbers (k,), and write their results into `runs`."""
        # integrate in lanes and evaluate the outputs; `ends` has the start states, which the integrator
        # overwrites with the end states
        ends, states = runs.starts[numbers], self._states[: len(numbers)]
        counts = np.zeros((len(numbers), COUNTS))
        self._run(table_of(self._code, self._times, ends, states, counts, lane_count()))
        outputs = Outputs(self._code, self._times, ends, states, numbers)
        outputs.write(runs.results)
        # repeat runs that left their lanes; complete outputs that need Python
        repeated = counts[:, Count.STATUS] != Status.DONE
        for k in np.flatnonzero(repeated | self._incomplete(runs.results, numbers)).tolist():
            if self._stopped:
                break
            number = int(numbers[k])
            try:
                if repeated[k]:
                    self._alone(runs.starts[number])
                    self._alone.outputs(runs.results[number])
                else:
                    outputs.complete(runs.results[number], run=k)
            except IntegrationError as error:
                runs.errors[number] = error
                runs.results[number] = np.nan
            if repeated[k]:
                counts[k] = self._alone.counts
        runs.counts[numbers] = counts

    def _incomplete(self, results: Array, numbers: Array) -> Array:
        """Find the runs whose outputs Python must check or complete.

        These are all runs without projection, whose joints may have opened; all runs with reactions under
        redundant constraints; runs near singular configurations; runs with numbers that are not finite.

        Args:
            results: (runs, n, outputs) results of all runs.
            numbers: (k,) numbers of the examined runs.

        Returns:
            (k,) True for runs that need Python.
        """
        code = self._code
        if code.stabilization != "projection" or ("reactions" in code.scene.outputs and code.redundant):
            return np.ones(len(numbers), dtype=bool)
        # examine a slice of consecutive runs, because a selection by `numbers` would copy the results
        first = np.min(numbers)
        examined = results[first : np.max(numbers) + 1]
        with np.errstate(all="ignore"):
            needs_python = ~np.isfinite(examined.sum(axis=(1, 2)))
        if "reactions" in code.scene.outputs:
            pivot_ratio, _ = code.arrays["pivot_ratio"]  # slice; the ratio is at most 0 at singular states
            needs_python |= ~(examined[:, :, pivot_ratio] > 0.0).all(axis=(1, 2))
        return np.asarray(needs_python[numbers - first])
