"""Outputs of a scene (poses, velocities, reactions, energies, ...), computed from the states of a run.

A native loop evaluates the compiled function `output` of the scene at each state. Python then completes what
native code cannot compute: joint reactions at singular states and under redundant constraints. Python also
checks for open joints and infinite numbers. A lane is one element of a vector register; a function with
several lanes evaluates one state in each lane per call.

The decorator `native` marks Python functions that are translated to machine code. They see arrays as flat,
row by row, and a slice `a[k:]` is the array from element k on.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from newton_euler.codegen.compile import NativeFunction
from newton_euler.codegen.native import Callback, Record, Vector, native
from newton_euler.codegen.native_functions import NativeFunctions
from newton_euler.compiled.equations import CompiledEquations
from newton_euler.equations.formulation import Formulation
from newton_euler.equations.system import at_time
from newton_euler.errors import NewtonEulerError
from newton_euler.integrators.projection import check_still_closed
from newton_euler.model.trajectory import IntegrationError, check_finite
from newton_euler.scalars import Array, Stack, stacked_rows, unstacked

REACTION_BLOCK = 64
"""Number of states at which Python computes reactions at once.

The matrices of all these states are in memory together: 265 MB for 60 bodies in Cartesian coordinates."""


@dataclass(frozen=True, eq=False)
class StateTable(Record):
    """States of some runs, and a function that native loops evaluate at each of them.

    Attributes:
        runs: number of runs.
        count: number of states of each run.
        state_size: length of a state (q, v).
        inputs: length of a vector x: a state, the time, flags and parameters. A flag is 1 for a redundant
            constraint row that the run leaves out, else 0.
        outputs: number of results of the function.
        lanes: number of states that the function takes per call.
        function: writes the results y (outputs, lanes) for x (inputs, lanes).
        x: (runs, inputs) gives the flags and parameters of each run.
        times: (count,) s, times of the states.
        states: (runs, count, state_size).
        result_numbers: (runs,) for each run here, its index in the array of results, which may have more
            runs.
        x_block, y_block: (inputs, lanes) and (outputs, lanes) scratch for one call of the function.
    """

    runs: int
    count: int
    state_size: int
    inputs: int
    outputs: int
    lanes: int
    function: Callback
    x: Vector
    times: Vector
    states: Vector
    result_numbers: Vector
    x_block: Vector
    y_block: Vector


@native
def map_runs(table: StateTable, results: Vector) -> None:
    """Evaluate the function at all states of all runs.

    Args:
        table: the states and the function.
        results: (all runs, count, outputs), written at the indices `table.result_numbers`.
    """
    size = table.count * table.outputs
    for run in range(table.runs):
        states = table.states[table.count * table.state_size * run :]
        number = int(table.result_numbers[run])
        map_states(table, table.x[table.inputs * run :], states, results[size * number :])


@native
def map_states(table: StateTable, x: Vector, states: Vector, results: Vector) -> None:
    """Evaluate the function at all states of one run.

    Args:
        table: the function and the times.
        x: (inputs,) gives the flags and parameters.
        states: (count, state_size).
        results: (count, outputs), written.
    """
    state_size = table.state_size
    outputs = table.outputs
    lanes = table.lanes
    # flags and parameters, the same in all lanes
    for i in range(state_size + 1, table.inputs):
        for lane in range(lanes):
            table.x_block[lanes * i + lane] = x[i]
    row = 0
    while row < table.count:
        # states and times of the next rows, one row in each lane; spare lanes repeat the last row
        for lane in range(lanes):
            source = row + lane
            if source >= table.count:
                source = table.count - 1
            state = states[state_size * source :]
            input_of_lane = table.x_block[lane:]
            for i in range(state_size):
                input_of_lane[lanes * i] = state[i]
            input_of_lane[lanes * state_size] = table.times[source]
        # evaluate, and copy the results of each lane to its row
        table.function(table.x_block, table.y_block)
        for lane in range(lanes):
            if row + lane < table.count:
                result = results[outputs * (row + lane) :]
                output_of_lane = table.y_block[lane:]
                for j in range(outputs):
                    result[j] = output_of_lane[lanes * j]
        row += lanes


@native
def repeat(count: int, function: Callback, x: Vector, y: Vector) -> None:
    """Evaluate a function of the same x `count` times, for benchmarks; y receives the results."""
    for _k in range(count):
        function(x, y)


@lru_cache
def loops() -> NativeFunctions:
    """Compile the native loops over states, once per process."""
    return NativeFunctions([map_runs, repeat])


def at_rows(function: NativeFunction, x: Array) -> Array:
    """Evaluate a native function at each row of x (n, inputs) by a native loop.

    Returns:
        (n, outputs) results.
    """
    results = np.empty((len(x), function.outputs))
    # a single run whose "state" is all but the last input, and whose "time" is the last input
    table = StateTable(
        runs=1,
        count=len(x),
        state_size=function.inputs - 1,
        inputs=function.inputs,
        outputs=function.outputs,
        lanes=function.lanes,
        function=function,
        x=np.zeros(function.inputs),
        times=np.ascontiguousarray(x[:, -1]),
        states=np.ascontiguousarray(x[:, :-1]),
        result_numbers=np.zeros(1),
        x_block=np.empty((function.inputs, function.lanes)),
        y_block=np.empty((function.outputs, function.lanes)),
    )
    loops().bind(map_runs, table)(results)
    return results


class Outputs:
    """Output arrays of some runs of a scene at their output times.

    The object holds references to arrays of states and parameters. After new runs have filled these arrays,
    the outputs can be evaluated again.

    Attributes:
        shape: (n, outputs), shape of the results of one run.
        write: native function that writes the results of all runs into an array (all runs, n, outputs), at
            the indices `result_numbers`.
    """

    def __init__(
        self, code: CompiledEquations, times: Array, x: Array, states: Array, result_numbers: Array
    ) -> None:
        """Prepare the outputs of runs.

        Args:
            code: compiled equations of the scene.
            times: (n,) s, output times.
            x: (runs, inputs) vectors with the flags and parameters of each run.
            states: (runs, n, state_size) states at the output times.
            result_numbers: (runs,) indices of the runs in the array that `write` writes to.
        """
        function = code.function("output")
        self._code, self._times, self._x, self._states = code, times, x, states
        self.shape = (len(times), function.outputs)
        table = StateTable(
            runs=len(x),
            count=len(times),
            state_size=code.size,
            inputs=code.inputs,
            outputs=function.outputs,
            lanes=function.lanes,
            function=function,
            x=x,
            times=times,
            states=states,
            result_numbers=result_numbers.astype(float),
            x_block=np.empty((code.inputs, function.lanes)),
            y_block=np.empty((function.outputs, function.lanes)),
        )
        self.write = loops().bind(map_runs, table)

    def __call__(self, results: Array, rows: int | None = None) -> dict[str, Array]:
        """Evaluate the outputs of a single run.

        Args:
            results: (n, outputs), written.
            rows: number of output times that the run reached; all if None.

        Returns:
            Views of the first rows of the results by name.

        Raises:
            IntegrationError: see `complete`.
        """
        self.write(results)
        return self.complete(results[:rows])

    def complete(self, results: Array, run: int = 0) -> dict[str, Array]:
        """Check the results of a run that `write` has written, and complete its joint reactions.

        At singular states and under redundant constraints, Python computes the reactions again, with
        minimum norm.

        Args:
            results: (rows, outputs) of the run.
            run: index of the run in `states`.

        Returns:
            Views of the results by name.

        Raises:
            IntegrationError: for a number that is not finite, a state without reactions, or a joint that has
                opened during a run without projection.
        """
        arrays = named(self._code, results)
        if self._code.stabilization != "projection":
            check_still_closed(self._code.scene, self._times, arrays["phi"])
        if "reactions" in self._code.scene.outputs:
            self._recompute_singular_reactions(arrays, run)
        if not np.isfinite(results).all():
            check_finite(self._times, arrays)
        return arrays

    @np.errstate(all="ignore")  # numbers that overflow are reported by the caller
    def _recompute_singular_reactions(self, arrays: dict[str, Array], run: int) -> None:
        """Overwrite reactions at singular states, or at all states if constraints are redundant.

        Args:
            arrays: outputs of the run by name. `pivot_ratio` is the smallest pivot of the elimination of
                constraints, relative to its usual magnitude; it is not positive at a singular state.
            run: index of the run in `states`.
        """
        code, times, pivot_ratio = self._code, self._times, arrays["pivot_ratio"]
        rows = np.arange(len(pivot_ratio)) if code.redundant else np.flatnonzero(~(pivot_ratio > 0.0))
        if not len(rows):
            return
        system = code.float_system(self._x[run])  # the equations with the parameters of this run

        def recompute(rows: Array) -> None:
            """Overwrite the reactions in some rows; raise `IntegrationError` for the first that has none."""
            try:
                found = minimum_norm_reactions(system, times[rows], self._states[run, rows])
            except NewtonEulerError as error:
                if len(rows) == 1:
                    raise IntegrationError(float(times[rows[0]]), str(error)) from error
                for row in rows:
                    recompute(np.array([row]))
            else:
                arrays["reaction_force"][rows], arrays["reaction_torque"][rows] = found

        for start in range(0, len(rows), REACTION_BLOCK):
            recompute(rows[start : start + REACTION_BLOCK])


def minimum_norm_reactions(system: Formulation, times: Array, states: Array) -> tuple[Array, Array]:
    """Compute the reactions of minimum-norm multipliers by dense linear algebra, at several states at once.

    Args:
        system: the equations of motion.
        times: (n,) s.
        states: (n, nq + nv).

    Returns:
        Forces and torques on the second bodies of the j joints, (n, j, 3) each; see `Formulation.reactions`.
    """
    count, time, state = len(times), times[0], states[0]
    if count > 1:  # each number is a `Stack`
        time, state = Stack(times), stacked_rows(states)
    system, q, v = at_time(system, time), state[: system.nq], state[system.nq :]
    vdot, multipliers = system.solve(q, v)
    found = system.reactions(q, v, vdot, system.body_accelerations(q, v, vdot), multipliers)
    forces, torques = (unstacked(each.ravel(), count).reshape(count, *each.shape) for each in found)
    return forces, torques


def named(code: CompiledEquations, results: Array) -> dict[str, Array]:
    """Return views of the results of a scene's outputs, (n, outputs), by name, each (n, ...)."""
    return {
        name: results[:, place].reshape(len(results), *shape) for name, (place, shape) in code.arrays.items()
    }


def time_function(function: NativeFunction, x: Array, count: int) -> float:
    """Measure the wall time of a native function, s.

    Args:
        function: the function.
        x: (inputs,) its argument, the same in all lanes.
        count: number of evaluations; a call evaluates as many states as the function has lanes.
    """
    lanes = function.lanes
    y = np.empty((function.outputs, lanes))
    x = np.repeat(np.asarray(x, dtype=float)[:, None], lanes, axis=1)
    module = loops()
    start = time.perf_counter()
    module(repeat, -(-count // lanes), function, x, y)  # rounded up
    return time.perf_counter() - start
