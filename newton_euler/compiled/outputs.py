"""Outputs: the arrays that a scene asks for, evaluated natively from the states of a run."""

from __future__ import annotations

import time
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from newton_euler.codegen.compile import NativeFunction
from newton_euler.codegen.native import Callback, Record, Vector, native
from newton_euler.codegen.native_functions import NativeFunctions
from newton_euler.compiled.equations import CompiledEquations
from newton_euler.equations.system import at_time
from newton_euler.errors import NewtonEulerError
from newton_euler.integrators.projection import check_still_closed
from newton_euler.model.trajectory import IntegrationError, check_finite
from newton_euler.scalars import Array


@dataclass(frozen=True, eq=False)
class Rows(Record):
    """A function of each state of some runs.

    Attributes:
        runs, count: number of runs, and of states of each.
        n, inputs: lengths of a state, and of one with time and parameters.
        m, lanes: numbers of results of the function and of states that it takes at once.
        function: of states.
        x: (runs, inputs) have the parameters.
        times, states: (count,) and (runs, count, n).
        places: (runs,) numbers of the runs among the results.
        given, found: (inputs, lanes) and (m, lanes), scratch.
    """

    runs: int
    count: int
    n: int
    inputs: int
    m: int
    lanes: int
    function: Callback
    x: Vector
    times: Vector
    states: Vector
    places: Vector
    given: Vector
    found: Vector


@native
def map_runs(rows: Rows, results: Vector) -> None:
    """Evaluate results (..., count, m), the function of each row of each run at its time."""
    size = rows.count * rows.m
    for run in range(rows.runs):
        states = rows.states[rows.count * rows.n * run :]
        map_rows(rows, rows.x[rows.inputs * run :], states, results[size * int(rows.places[run]) :])


@native
def map_rows(rows: Rows, x: Vector, states: Vector, results: Vector) -> None:
    """Evaluate results (count, m) of one run, several rows at once."""
    n = rows.n
    m = rows.m
    lanes = rows.lanes
    for i in range(n + 1, rows.inputs):
        for lane in range(lanes):
            rows.given[lanes * i + lane] = x[i]
    row = 0
    while row < rows.count:
        for lane in range(lanes):
            source = row + lane
            if source >= rows.count:
                source = rows.count - 1
            state = states[n * source :]
            taken = rows.given[lane:]
            for i in range(n):
                taken[lanes * i] = state[i]
            taken[lanes * n] = rows.times[source]
        rows.function(rows.given, rows.found)
        for lane in range(lanes):
            if row + lane < rows.count:
                result = results[m * (row + lane) :]
                made = rows.found[lane:]
                for j in range(m):
                    result[j] = made[lanes * j]
        row += lanes


@native
def repeat(count: int, function: Callback, x: Vector, y: Vector) -> None:
    """Evaluate the same function of the same x again and again, for benchmarks."""
    for _k in range(count):
        function(x, y)


@lru_cache
def loops() -> NativeFunctions:
    """Compile the loops over states, once."""
    return NativeFunctions([map_runs, repeat])


def at_rows(function: NativeFunction, x: Array) -> Array:
    """Evaluate a function of each row of x (n, inputs), by native loops: (n, outputs)."""
    results = np.empty((len(x), function.outputs))
    rows = Rows(
        runs=1,
        count=len(x),
        n=function.inputs - 1,
        inputs=function.inputs,
        m=function.outputs,
        lanes=function.lanes,
        function=function,
        x=np.zeros(function.inputs),
        times=np.ascontiguousarray(x[:, -1]),
        states=np.ascontiguousarray(x[:, :-1]),
        places=np.zeros(1),
        given=np.empty((function.inputs, function.lanes)),
        found=np.empty((function.outputs, function.lanes)),
    )
    loops().bind(map_runs, rows)(results)
    return results


class Outputs:
    """The arrays that a scene asks for at the output times of some runs, as often as one likes.

    Attributes:
        shape: of the results of one run, (n, outputs).
        write: writes the results of all runs into those (..., n, outputs) of some more.
    """

    def __init__(self, code: CompiledEquations, times: Array, x: Array, states: Array, places: Array) -> None:
        """Prepare the outputs of runs.

        Args:
            code: compiled equations of the scene.
            times: (n,) s, output times.
            x: (runs, inputs) inputs, which contain the parameters when the outputs are evaluated.
            states: (runs, n, size) states at the output times.
            places: (runs,) numbers of the runs among the results.
        """
        function = code.function("output")
        self._code, self._times, self._x, self._states = code, times, x, states
        self.shape = (len(times), function.outputs)
        given, found = (np.empty((size, function.lanes)) for size in (code.inputs, function.outputs))
        rows = Rows(
            runs=len(x),
            count=len(times),
            n=code.size,
            inputs=code.inputs,
            m=function.outputs,
            lanes=function.lanes,
            function=function,
            x=x,
            times=times,
            states=states,
            places=places.astype(float),
            given=given,
            found=found,
        )
        self.write = loops().bind(map_runs, rows)

    def __call__(self, results: Array, rows: int | None = None) -> dict[str, Array]:
        """Write the results (n, outputs) of the first run; returns views of them as `complete` does."""
        self.write(results)
        return self.complete(results[:rows])

    def complete(self, results: Array, run: int = 0) -> dict[str, Array]:
        """Complete the results (rows, outputs) of a run, which `write` has written; returns views by name.

        Reactions near singular or under redundant constraints come from the float form, which knows the
        smallest ones.

        Raises:
            IntegrationError: for results that no double holds, where that form fails, and where joints have
                come open.
        """
        arrays = named(self._code, results)
        if self._code.stabilization != "projection":
            check_still_closed(self._code.scene, self._times, arrays["phi"])
        if "reactions" in self._code.scene.outputs:
            self._recompute_singular_reactions(arrays, run)
        if not np.isfinite(results).all():
            check_finite(self._times, arrays)
        return arrays

    @np.errstate(all="ignore")  # what overflows fails
    def _recompute_singular_reactions(self, arrays: dict[str, Array], run: int) -> None:
        code, times, pivot_ratio = self._code, self._times, arrays["pivot_ratio"]
        open_rows = np.arange(len(pivot_ratio)) if code.redundant else np.flatnonzero(~(pivot_ratio > 0.0))
        if not len(open_rows):
            return
        system_of_run = code.float_system(self._x[run])  # parameters make equations of their own
        for row in open_rows:
            system, state = at_time(system_of_run, float(times[row])), self._states[run, row]
            try:
                evaluation = system.evaluate(state[: system.nq], state[system.nq :])
            except NewtonEulerError as error:
                raise IntegrationError(float(times[row]), str(error)) from error
            arrays["reaction_force"][row] = evaluation.reaction_force
            arrays["reaction_torque"][row] = evaluation.reaction_torque


def named(code: CompiledEquations, results: Array) -> dict[str, Array]:
    """Return views of results (n, outputs) by name."""
    return {
        name: results[:, place].reshape(len(results), *shape) for name, (place, shape) in code.arrays.items()
    }


def time_function(function: NativeFunction, x: Array, count: int) -> float:
    """Measure the time, s, of a native function called `count` times for the same x, in a native loop."""
    lanes = function.lanes
    y = np.empty((function.outputs, lanes))
    x = np.repeat(np.asarray(x, dtype=float)[:, None], lanes, axis=1)
    module = loops()
    start = time.perf_counter()
    module(repeat, -(-count // lanes), function, x, y)
    return time.perf_counter() - start
