"""Outputs: the arrays that a scene asks for, evaluated natively from the states of a run."""

from __future__ import annotations

import time
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from newton_euler.codegen.compile import NativeFunction
from newton_euler.codegen.native import Callback, Record, Vector, native
from newton_euler.codegen.native_functions import NativeFunctions
from newton_euler.equations.system import at_time
from newton_euler.errors import NewtonEulerError
from newton_euler.integrators.compiled import Code
from newton_euler.integrators.projection import check_still_closed
from newton_euler.model.trajectory import IntegrationError, check_finite
from newton_euler.scalars import Array


@dataclass(frozen=True, eq=False)
class Rows(Record):
    """A function of each state of a table.

    Attributes:
        count: of states.
        n, inputs: lengths of a state, and of one with time and parameters.
        m, lanes: numbers of results of the function and of states that it takes at once.
        function: of states.
        x: (inputs,) has the parameters.
        times, states: (count,) and (count, n).
        given, found: (inputs, lanes) and (m, lanes), scratch.
    """

    count: int
    n: int
    inputs: int
    m: int
    lanes: int
    function: Callback
    x: Vector
    times: Vector
    states: Vector
    given: Vector
    found: Vector


@native
def map_rows(rows: Rows, results: Vector) -> None:
    """Evaluate results (count, m), the function of each row at its time, several rows at once."""
    n = rows.n
    m = rows.m
    lanes = rows.lanes
    for i in range(n + 1, rows.inputs):
        for lane in range(lanes):
            rows.given[lanes * i + lane] = rows.x[i]
    row = 0
    while row < rows.count:
        for lane in range(lanes):
            source = row + lane
            if source >= rows.count:
                source = rows.count - 1
            state = rows.states[n * source :]
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
    return NativeFunctions([map_rows, repeat])


def at_rows(function: NativeFunction, x: Array) -> Array:
    """Evaluate a function of each row of x (n, inputs), by native loops: (n, outputs)."""
    results = np.empty((len(x), function.outputs))
    rows = Rows(
        count=len(x),
        n=function.inputs - 1,
        inputs=function.inputs,
        m=function.outputs,
        lanes=function.lanes,
        function=function,
        x=np.zeros(function.inputs),
        times=np.ascontiguousarray(x[:, -1]),
        states=np.ascontiguousarray(x[:, :-1]),
        given=np.empty((function.inputs, function.lanes)),
        found=np.empty((function.outputs, function.lanes)),
    )
    loops().bind(map_rows, rows)(results)
    return results


class Outputs:
    """The arrays that a scene asks for at the output times, for as many runs as one likes.

    Attributes:
        shape: of the results of one run, (n, outputs).
    """

    def __init__(self, code: Code, times: Array, x: Array, table: Array) -> None:
        """Of the states `table` (n, size) at `times` (n,) with the parameters in x (inputs,), by then."""
        function = code.function("output")
        self._code, self._times, self._x, self._table = code, times, x, table
        self.shape = (len(times), function.outputs)
        given, found = (np.empty((size, function.lanes)) for size in (code.inputs, function.outputs))
        rows = Rows(
            count=len(times),
            n=code.size,
            inputs=code.inputs,
            m=function.outputs,
            lanes=function.lanes,
            function=function,
            x=x,
            times=times,
            states=table,
            given=given,
            found=found,
        )
        self._write = loops().bind(map_rows, rows)

    def __call__(self, results: Array, rows: int | None = None) -> dict[str, Array]:
        """Write the results (n, outputs); returns views of them, of the first `rows` if given, by name.

        Reactions near singular or under redundant constraints come from the float form, which knows the
        smallest ones.

        Raises:
            IntegrationError: for results that no double holds, where that form fails, and where joints have
                come open.
        """
        self._write(results)
        results = results[:rows]
        arrays = named(self._code, results)
        if self._code.stabilization != "projection":
            check_still_closed(self._code.scene, self._times, arrays["phi"])
        if "reactions" in self._code.scene.outputs:
            self._settle_reactions(arrays)
        if not np.isfinite(results).all():
            check_finite(self._times, arrays)
        return arrays

    def _settle_reactions(self, arrays: dict[str, Array]) -> None:
        code, times, pivot_ratio = self._code, self._times, arrays["pivot_ratio"]
        for row in range(len(pivot_ratio)) if code.redundant else np.flatnonzero(~(pivot_ratio > 0.0)):
            system, state = at_time(code.float_system(self._x), float(times[row])), self._table[row]
            try:
                evaluation = system.evaluate(state[: system.nq], state[system.nq :])
            except NewtonEulerError as error:
                raise IntegrationError(float(times[row]), str(error)) from error
            arrays["reaction_force"][row] = evaluation.reaction_force
            arrays["reaction_torque"][row] = evaluation.reaction_torque


def named(code: Code, results: Array) -> dict[str, Array]:
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
