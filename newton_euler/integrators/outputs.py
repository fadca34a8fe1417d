"""What a scene asks for, worked out from the states of a march."""

from __future__ import annotations

import time
from functools import lru_cache

import numpy as np

from newton_euler.codegen.compile import NativeFunction
from newton_euler.codegen.native_functions import NativeFunctions
from newton_euler.compiled import Code
from newton_euler.equations.system import at_time
from newton_euler.errors import NewtonEulerError
from newton_euler.integrators import march as m
from newton_euler.integrators.stabilize import check_still_closed
from newton_euler.model.trajectory import IntegrationError, check_finite
from newton_euler.scalars import Array


@lru_cache
def loops() -> NativeFunctions:
    """Loops over states."""
    return NativeFunctions([m.map_rows, m.repeat])


class Outputs:
    """The arrays that a scene asks for at the times of a march, for as many runs of it as one likes.

    Attributes:
        shape: of the results of one run, (n, outputs).
    """

    def __init__(self, code: Code, times: Array, x: Array, table: Array) -> None:
        """Of the states `table` (n, size) at `times` (n,) with the parameters in x (inputs,), by then."""
        function = code.function("output")
        self._code, self._times, self._x, self._table = code, times, x, table
        self.shape = (len(times), function.outputs)
        given, found = (np.empty((size, function.lanes)) for size in (code.inputs, function.outputs))
        rows = m.Rows(
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
        self._write = loops().bind(m.map_rows, rows)

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
        code, times, health = self._code, self._times, arrays["health"]
        for row in range(len(health)) if code.redundant else np.flatnonzero(~(health > 0.0)):
            system, state = at_time(code.float_system(self._x), float(times[row])), self._table[row]
            try:
                evaluation = system.evaluate(state[: system.nq], state[system.nq :])
            except NewtonEulerError as error:
                raise IntegrationError(float(times[row]), str(error)) from error
            arrays["reaction_force"][row] = evaluation.reaction_force
            arrays["reaction_torque"][row] = evaluation.reaction_torque


def named(code: Code, results: Array) -> dict[str, Array]:
    """Views of results (n, outputs) by name."""
    return {
        name: results[:, place].reshape(len(results), *shape) for name, (place, shape) in code.arrays.items()
    }


def time_function(function: NativeFunction, x: Array, count: int) -> float:
    """s that a native function takes for `count` times the same x, in a native loop."""
    lanes = function.lanes
    y = np.empty((function.outputs, lanes))
    x = np.repeat(np.asarray(x, dtype=float)[:, None], lanes, axis=1)
    module = loops()
    start = time.perf_counter()
    module(m.repeat, -(-count // lanes), function, x, y)
    return time.perf_counter() - start
