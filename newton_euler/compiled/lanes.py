"""Runs of a compiled scene side by side, one in each lane of the processor's vector registers.

The method is the one of `newton_euler.compiled.run`, compiled for several runs at once
(`newton_euler.codegen.translate`): each lane has its own steps, error control and projection, and takes the
next run when it has made one. Results are those of one run after another, to the last bit. A run that needs
Python, in a singular configuration or to explain why it cannot go on, leaves its lane and is made by scalar
code.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from newton_euler.codegen.compile import lane_count
from newton_euler.compiled.callbacks import DenseCallbacks, vector_at
from newton_euler.compiled.equations import CompiledEquations
from newton_euler.compiled.outputs import Outputs
from newton_euler.compiled.run import (
    METHODS,
    Integrator,
    equations,
    load,
    marks,
    method_of,
    native_method,
    table_of,
)
from newton_euler.errors import NewtonEulerError
from newton_euler.integrators.options import Options
from newton_euler.integrators.status import Status
from newton_euler.integrators.stepper import COUNTS, LEAVE_LANE, STOP_ALL_RUNS, Count, Table
from newton_euler.model.trajectory import IntegrationError
from newton_euler.scalars import Array

LANE_METHODS = frozenset({"DOP853", "RK4", "Euler"})
"""Methods that make runs side by side; the matrices of Radau take other pivots in each."""

MAX_TABLE_BYTES = 4_000_000
"""Bytes that the states of the runs of a group may take, which fit into the cache of a core."""

MIN_GROUP, MAX_GROUP = 32, 1024
"""Runs of a group: at its end some lanes have none."""


def runs_in_lanes(code: CompiledEquations, integrator: str) -> bool:
    """True if runs are made side by side; those with knots or digital control go from instant to instant, one
    by one."""
    return integrator in LANE_METHODS and not code.piecewise and not code.scene.sampled


def load_lanes(code: CompiledEquations, integrator: str) -> None:
    """Make everything ready that runs need."""
    load(code, integrator)
    if runs_in_lanes(code, integrator):
        native_method(METHODS[integrator], in_lanes=True)
        names = ["derivative"] + ["position", "velocity"] * code.projects + ["rate"] * (integrator == "Euler")
        names += ["shares"] * (len(code.exchangeable.numbers) > 0)
        for name in names:
            code.function(name, in_lanes=True)


class LaneExit(DenseCallbacks):
    """Callbacks of native code in lanes: those that would go on in Python leave.

    Runs that leave, and those in which a callback raises an error, are made again by scalar code, which
    reports the error.
    """

    def __init__(self, code: CompiledEquations, counts: Array, stopped: Sequence[bool]) -> None:
        """All runs stop if `stopped` holds something; `counts` are (COUNTS, lanes)."""
        super().__init__(counts, stopped)
        self._size = code.size
        self.derivative = self.guarded(self._leave)

    def _leave(self, x: int, y: int, on: int) -> None:
        count = self.counts.shape[1]
        vector_at(y, (self._size + 1) * count).reshape(-1, count)[self._size, self._lanes(on)] = -1.0
        self._end(on)

    def _end(self, on: int) -> None:
        self.counts[Count.STOP_REQUEST, self._lanes(on)] = LEAVE_LANE

    def _lanes(self, on: int) -> list[int]:
        return [lane for lane in range(self.counts.shape[1]) if on >> lane & 1]

    def _pause(self, counts: int, wish: int, on: int) -> None:
        if self._stopped:
            self.counts[Count.STOP_REQUEST] = STOP_ALL_RUNS


class Runs(NamedTuple):
    """Runs of a scene, made and to be made.

    Attributes:
        starts: (runs, inputs) states with time and parameters.
        results: (runs, n, outputs), not numbers of runs that could not go on.
        counts: (runs, COUNTS), see `newton_euler.integrators.stepper`.
        errors: of those that could not begin or not go on, by number.
    """

    starts: Array
    results: Array
    counts: Array
    errors: dict[int, NewtonEulerError]


class SideBySide:
    """A method on a compiled scene over given times, ready for groups of runs; one thread at a time."""

    def __init__(
        self, code: CompiledEquations, times: Array, options: Options, stopped: Sequence[bool] = ()
    ) -> None:
        """Make everything ready; runs stop if `stopped`, which other threads may fill, holds something."""
        self._code, self._stopped = code, stopped
        self._alone = Integrator(code, times, options, stopped)
        self._group = min(max(MAX_TABLE_BYTES // (8 * len(times) * max(code.size, 1)), MIN_GROUP), MAX_GROUP)
        counts = np.zeros((COUNTS, lane_count()))
        python = LaneExit(code, counts, stopped)
        derivative = code.function("derivative", in_lanes=True)
        system = equations(code, python, derivative, marks(code, options.integrator))
        method = method_of(code, options, np.zeros((0, 0)), lane_count())
        integrate = METHODS[options.integrator]
        self._times = times.copy()
        self._states = np.zeros((self._group, len(times), code.size))
        native = native_method(integrate, in_lanes=True)
        self._run: Callable[[Table], None] = lambda table: native(integrate, system, table, method)

    def __call__(self, runs: Runs, numbers: Array) -> None:
        """Make some of the runs, given by their numbers."""
        for first in range(0, len(numbers), self._group):
            if self._stopped:
                return
            self._make(runs, numbers[first : first + self._group])

    def _make(self, runs: Runs, numbers: Array) -> None:
        ends, states = runs.starts[numbers], self._states[: len(numbers)]
        counts = np.zeros((len(numbers), COUNTS))
        self._run(table_of(self._code, self._times, ends, states, counts, lane_count()))
        outputs = Outputs(self._code, self._times, ends, states, numbers)
        outputs.write(runs.results)
        again = counts[:, Count.STATUS] != Status.DONE
        for k in np.flatnonzero(again | self._incomplete(runs.results, numbers)).tolist():
            if self._stopped:
                break
            number = int(numbers[k])
            try:
                if again[k]:
                    self._alone(runs.starts[number])
                    self._alone.outputs(runs.results[number])
                else:
                    outputs.complete(runs.results[number], k)
            except IntegrationError as error:
                runs.errors[number] = error
                runs.results[number] = np.nan
            if again[k]:
                counts[k] = self._alone.counts
        runs.counts[numbers] = counts

    def _incomplete(self, results: Array, numbers: Array) -> Array:
        """Find the runs (k,) whose results, those of these numbers (k,), need Python."""
        code = self._code
        if code.stabilization != "projection" or ("reactions" in code.scene.outputs and code.redundant):
            return np.ones(len(numbers), dtype=bool)
        first = np.min(numbers)
        around = results[first : np.max(numbers) + 1]  # no copy
        with np.errstate(all="ignore"):
            needed = ~np.isfinite(around.sum(axis=(1, 2)))
        if "reactions" in code.scene.outputs:
            place, _ = code.arrays["pivot_ratio"]
            needed |= ~(around[:, :, place] > 0.0).all(axis=(1, 2))
        return np.asarray(needed[numbers - first])
