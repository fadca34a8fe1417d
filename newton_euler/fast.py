"""Runs of compiled scenes: no Python inside a step."""

from __future__ import annotations

import ctypes
from functools import lru_cache
from typing import Any

import numpy as np

from newton_euler.adaptive import march_dop853
from newton_euler.compiled import CompiledSystem
from newton_euler.errors import IntegrationError, NewtonEulerError
from newton_euler.fixed import map_rows, march_euler, march_rk4
from newton_euler.integrate import Options, Solution
from newton_euler.march import (
    COUNTS,
    DONE,
    EVALUATIONS,
    NOT_FINITE,
    OPEN,
    REACHED,
    SINGULAR,
    STEP_TOO_SMALL,
    STEPS,
    TOO_MANY_STEPS,
)
from newton_euler.native import NativeModuleOf
from newton_euler.scalars import Array
from newton_euler.stabilize import ROUND_OFF

MOST_STEPS = 10_000_000

REASONS = {
    NOT_FINITE: "the solution is not finite",
    SINGULAR: "the equations of motion are singular",
    TOO_MANY_STEPS: f"more than {MOST_STEPS} steps",
    STEP_TOO_SMALL: "steps have become too small for double precision; the problem may be stiff or singular",
    OPEN: "projection cannot close the joints",
}


@lru_cache
def steppers() -> NativeModuleOf:
    """The integrators, which no scene changes; compiled once."""
    return NativeModuleOf([march_dop853, march_rk4, march_euler, map_rows])


class DensePath:
    """Derivatives by the dense, rank-revealing float form, where the compiled form is near singular."""

    def __init__(self, compiled: CompiledSystem) -> None:
        self._system, self._size = compiled.system, compiled.size
        self.error: NewtonEulerError | None = None
        pointer = ctypes.POINTER(ctypes.c_double)
        self._callback = ctypes.CFUNCTYPE(None, pointer, pointer)(self._derivative)
        self.address = ctypes.cast(self._callback, ctypes.c_void_p).value

    def _derivative(self, x: Any, y: Any) -> None:
        state = np.ctypeslib.as_array(x, (self._size,))
        rates = np.ctypeslib.as_array(y, (self._size + 1,))
        q, v = state[: self._system.nq].copy(), state[self._system.nq :].copy()
        try:
            rates[:-1] = np.concatenate([self._system.rate(q, v), self._system.acceleration(q, v)])
            rates[-1] = 1.0
        except NewtonEulerError as error:
            self.error = error
            rates[-1] = -1.0


def march(compiled: CompiledSystem, q: Array, v: Array, times: Array, options: Options) -> Solution:
    """Integrate from q, v at times[0] and return the solution at all times.

    Raises:
        IntegrationError: with the time reached and the reason.
    """
    system, functions, n = compiled.system, compiled.functions, compiled.size
    dense = DensePath(compiled)
    now = np.concatenate([q, v, times[:1]])
    table, counts = np.empty((len(times), n)), np.zeros(COUNTS)
    projection = (
        int(options.projection),
        ROUND_OFF * system.mechanism.size,
        functions["position"],
        functions["velocity"],
    )
    common = (functions["derivative"], dense)
    if options.integrator == "DOP853":
        status = steppers()(
            march_dop853, n, len(times), times, options.rtol, options.atol, MOST_STEPS, *common, *projection,
            now, now.copy(), now.copy(), np.empty(16 * (n + 1) + 1), np.empty(7 * n), table, counts,
        )  # fmt: skip
    elif options.integrator == "RK4":
        status = steppers()(
            march_rk4, n, len(times), times, options.step, MOST_STEPS, *common, *projection,
            now, now.copy(), np.empty(n + 2), np.empty(n + 2), table, counts,
        )  # fmt: skip
    else:
        status = steppers()(
            march_euler, n, system.nq, len(times), times, options.step, MOST_STEPS, *common,
            functions["rate"], *projection, now, np.empty(n + 2), table, counts,
        )  # fmt: skip
    if status != DONE:
        reason = str(dense.error) if status == SINGULAR and dense.error else REASONS[status]
        raise IntegrationError(float(counts[REACHED]), reason)
    steps, evaluations = int(counts[STEPS]), int(counts[EVALUATIONS])
    return Solution(table[:, : system.nq], table[:, system.nq :], steps, evaluations)


def outputs(compiled: CompiledSystem, times: Array, solution: Solution) -> dict[str, Array]:
    """The arrays that the scene asks for at all times, by name."""
    places, program = compiled.output
    count = len(program.outputs)
    results = np.empty((len(times), count))
    rows = np.ascontiguousarray(np.hstack([solution.q, solution.v]))
    x = np.zeros(compiled.size + 1)
    steppers()(map_rows, len(times), compiled.size, count, compiled.functions["output"], x, rows, results)
    return {name: results[:, place].reshape(len(times), *shape) for name, (place, shape) in places.items()}
