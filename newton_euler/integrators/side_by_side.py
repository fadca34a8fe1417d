"""Runs of a compiled scene side by side, one in each lane of the processor's vector registers.

The method is the one of `newton_euler.integrators.run`, compiled for several runs at once
(`newton_euler.codegen.lanes`): each lane has its own steps, error control and projection, and takes the next
run when it has made one. Results are those of one run after another, to the last bit. A run that needs
Python, in a singular configuration or to explain why it cannot go on, leaves its lane and is made by scalar
code.
"""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from newton_euler.codegen.compile import CALLBACK
from newton_euler.codegen.trigonometry import LANES
from newton_euler.integrators import stepper as m
from newton_euler.integrators.compiled import Code
from newton_euler.integrators.options import Options
from newton_euler.integrators.outputs import Outputs
from newton_euler.integrators.run import (
    METHODS,
    Integrator,
    equations,
    load,
    marks,
    method_of,
    most_steps,
    native_method,
    runs,
    vector_at,
)
from newton_euler.model.trajectory import IntegrationError
from newton_euler.scalars import Array

IN_LANES = frozenset({"DOP853", "RK4", "Euler"})
"""Methods that make runs side by side; the matrices of Radau take other pivots in each."""

TABLE = 4_000_000
"""Bytes that the states of the runs of a group may take, which fit into the cache of a core."""

LEAST, MOST = 4 * LANES, 1024
"""Runs of a group: at its end some lanes have none."""


def load_lanes(code: Code, integrator: str) -> None:
    """Make everything ready that runs need."""
    load(code, integrator)
    if integrator in IN_LANES:
        native_method(METHODS[integrator], in_lanes=True)
        names = ["derivative"] + ["position", "velocity"] * code.projects + ["rate"] * (integrator == "Euler")
        for name in names:
            code.function(name, in_lanes=True)


class Departure:
    """Callbacks of native code in lanes: those that would go on in Python leave.

    Attributes:
        derivative, closing, pause: addresses of native callbacks.
    """

    def __init__(self, code: Code, counts: Array, stopped: Sequence[bool]) -> None:
        """Of runs with these counts (COUNTS, LANES), that all stop if `stopped` holds something."""
        self._size, self._counts, self._stopped = code.size, counts, stopped
        self._callbacks = CALLBACK(self._leave), CALLBACK(self._pause)  # alive as long as this object
        leave, self.pause = (ctypes.c_void_p.from_buffer(each).value for each in self._callbacks)
        self.derivative = self.closing = leave

    def _leave(self, x: int, y: int, on: int) -> None:
        found = vector_at(y, (self._size + 1) * LANES).reshape(-1, LANES)
        lanes = [lane for lane in range(LANES) if on >> lane & 1]
        found[self._size, lanes] = -1.0
        self._counts[m.WISH, lanes] = m.LEAVE

    def _pause(self, counts: int, wish: int, on: int) -> None:
        if self._stopped:
            self._counts[m.WISH] = m.STOP


class Group(NamedTuple):
    """Runs that were made side by side.

    Attributes:
        results: (runs, n, outputs), valid until the next group is made; not numbers of runs that could not
            go on.
        counts: of each run, by name.
        errors: of those that could not go on, by number in the group.
    """

    results: Array
    counts: list[dict[str, int]]
    errors: dict[int, IntegrationError]


class SideBySide:
    """A method on a compiled scene over given times, ready for groups of runs; one thread at a time.

    Attributes:
        group: the number of runs of a group, at most.
        shape: of the results of one run, (n, outputs).
    """

    def __init__(
        self, code: Code, times: Array, options: Options, stopped: Sequence[bool] = (), most: int = MOST
    ) -> None:
        """Make everything ready for groups of at most so many runs, which stop if `stopped`, which other
        threads may fill, holds something."""
        self._code, self._options, self._stopped = code, options, stopped
        self._alone = Integrator(code, times, options, stopped)
        fitting = TABLE // (8 * len(times) * max(code.size, 1))
        self.group = min(max(fitting, LEAST), MOST, max(most, 1))
        counts = np.zeros((m.COUNTS, LANES))
        python = Departure(code, counts, stopped)
        derivative = code.function("derivative", in_lanes=True)
        self._system = equations(code, python, derivative, marks(code, options.integrator), counts)
        self._method = method_of(code, options, most_steps(options), np.zeros((0, 0)), LANES)
        self._times = times.copy()
        self._states = np.zeros((self.group, len(times), code.size))
        self.shape = self._alone.outputs.shape
        self._results = np.empty((self.group, *self.shape))
        self._keep = python

    def __call__(self, x: Array) -> Group:
        """Make runs from x (runs, inputs), at most as many as a group has."""
        code, count = self._code, len(x)
        ends, states, tallies = x.copy(), self._states[:count], np.zeros((count, m.COUNTS))
        table = runs(code, self._times, ends, states, tallies, LANES)
        integrate = METHODS[self._options.integrator]
        native_method(integrate, in_lanes=True).bind(integrate, self._system, table, self._method)()
        outputs = Outputs(code, self._times, ends, states)
        results = self._results[:count]
        outputs.write(results)
        again = tallies[:, m.STATUS] != m.DONE
        counts = [m.counted(tally) for tally in tallies]
        errors: dict[int, IntegrationError] = {}
        for k in np.flatnonzero(again | self._unsettled(results)).tolist():
            if self._stopped:
                break
            try:
                if again[k]:
                    self._alone(x[k])
                    self._alone.outputs(results[k])
                else:
                    outputs.settle(results[k], k)
            except IntegrationError as error:
                errors[k] = error
                results[k] = np.nan
            if again[k]:
                counts[k] = self._alone.counted
        return Group(results, counts, errors)

    def _unsettled(self, results: Array) -> Array:
        """Find the runs (runs,) whose results (runs, n, outputs) need Python."""
        code = self._code
        if code.stabilization != "projection" or ("reactions" in code.scene.outputs and code.redundant):
            return np.ones(len(results), dtype=bool)
        needed = ~np.isfinite(results).all(axis=(1, 2))
        if "reactions" in code.scene.outputs:
            place, _ = code.arrays["pivot_ratio"]
            needed |= ~(results[:, :, place] > 0.0).all(axis=(1, 2))
        return np.asarray(needed)
