"""Marches of compiled scenes: native steppers with the scene's native functions, no Python inside a step."""

from __future__ import annotations

import ctypes
import time
from collections.abc import Callable
from functools import lru_cache

import numpy as np

from newton_euler.compile import NativeFunction
from newton_euler.compiled import Code, Formulation
from newton_euler.errors import IntegrationError, NewtonEulerError
from newton_euler.integrate import Options
from newton_euler.native import NativeModuleOf
from newton_euler.scalars import Array
from newton_euler.stabilize import ROUND_OFF, project_position, project_velocity, worst_joint
from newton_euler.steppers import march as m
from newton_euler.steppers.adaptive import march_dop853
from newton_euler.steppers.fixed import march_euler, march_rk4
from newton_euler.steppers.march import map_rows, repeat
from newton_euler.steppers.radau import march_radau

MOST_STEPS = 10_000_000
"""Steps after which a run is taken to be getting nowhere; some ten seconds of the tracker's."""

MARCHES: dict[str, Callable[..., int]] = {
    "DOP853": march_dop853,
    "Radau": march_radau,
    "RK4": march_rk4,
    "Euler": march_euler,
}


@lru_cache
def stepper(integrator: str) -> NativeModuleOf:
    """An integrator, which no scene changes; compiled once."""
    return NativeModuleOf([MARCHES[integrator]])


@lru_cache
def loops() -> NativeModuleOf:
    """Loops over states."""
    return NativeModuleOf([map_rows, repeat])


def load(code: Code, integrator: str) -> None:
    """Have everything ready for a run."""
    code.load(integrator)
    for module in (stepper(integrator), loops()):
        assert module


class DensePath:
    """The dense, rank-revealing float form, for states where the compiled form is near singular.

    Attributes:
        derivative, closing: addresses of native callbacks.
        error: what that form raised last, if it did.
    """

    def __init__(self, code: Code) -> None:
        self._code = code
        self.error: NewtonEulerError | None = None
        kind = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_void_p)
        self._callbacks = (kind(self._derivative), kind(self._closing))  # alive as long as this object
        self.derivative, self.closing = (
            ctypes.cast(callback, ctypes.c_void_p).value for callback in self._callbacks
        )

    def _derivative(self, x: int, y: int) -> None:
        self._guarded(x, y, lambda system, q, v: [system.rate(q, v), system.acceleration(q, v)])

    def _closing(self, x: int, y: int) -> None:
        def project(system: Formulation, q: Array, v: Array) -> list[Array]:
            q = project_position(system, q)
            return [q, project_velocity(system, q, v)]

        self._guarded(x, y, project)

    def _guarded(self, x: int, y: int, function: Callable[[Formulation, Array, Array], list[Array]]) -> None:
        """Write n results and 1.0, or anything and -1.0 if the float form fails too."""
        code = self._code
        state, results = _vector(x, code.inputs).copy(), _vector(y, code.size + 1)
        system = code.float_system(state)
        try:
            with np.errstate(all="ignore"):  # the march checks what comes back
                found = function(system, state[: system.nq], state[system.nq : code.size])
        except NewtonEulerError as error:
            self.error = error
            results[-1] = -1.0
        else:
            results[:-1] = np.concatenate(found)
            results[-1] = 1.0


def _vector(address: int, size: int) -> Array:
    """The doubles at an address."""
    return np.ctypeslib.as_array((ctypes.c_double * size).from_address(address))


def march(code: Code, x: Array, times: Array, options: Options) -> tuple[Array, dict[str, int]]:
    """Integrate from times[0] and return the states (n, size) at all times, and the counts.

    `x` (inputs,) is the state with time and parameters; it ends up at the last time.

    Raises:
        IntegrationError: with the time reached, the reason and the joint.
    """
    n, nq = code.size, code.system.nq
    dense = DensePath(code)
    derivative = code.function("derivative")
    position, velocity = (code.function("position"), code.function("velocity")) if code.projects else (0, 0)
    table, counts = np.empty((len(times), n)), np.zeros(m.COUNTS)
    scene = (
        derivative, dense.derivative, int(code.projects), ROUND_OFF, position, velocity, dense.closing,
    )  # fmt: skip
    outputs = (n, len(times), times)
    module = stepper(options.integrator)
    if options.integrator == "DOP853":
        status = module(
            march_dop853, *outputs, options.rtol, options.atol, MOST_STEPS, *scene,
            x, x.copy(), x.copy(), np.empty(16 * (n + 1) + 1), np.empty(7 * n), table, counts,
        )  # fmt: skip
    elif options.integrator == "Radau":
        status = module(
            march_radau, *outputs, options.rtol, options.atol, MOST_STEPS, code.function("jacobian"), *scene,
            x, x.copy(), np.empty(n + 2), np.empty(3 * n), np.empty(4 * n), np.empty(3 * n + 3),
            np.empty(3 * n + 2), np.empty(3 * n), np.empty(4 * n * n), np.empty(2 * n), table, counts,
        )  # fmt: skip
    elif options.integrator == "RK4":
        status = module(
            march_rk4, *outputs, options.step, MOST_STEPS, *scene,
            x, x.copy(), np.empty(n + 2), np.empty(n + 2), table, counts,
        )  # fmt: skip
    else:
        status = module(
            march_euler, *outputs, nq, options.step, MOST_STEPS, code.function("rate"), *scene,
            x, np.empty(n + 2), table, counts,
        )  # fmt: skip
    if status != m.DONE:
        raise _failure(code, status, x, counts, dense.error)
    names = {"steps": m.STEPS, "rejected": m.REJECTED, "evaluations": m.EVALUATIONS, "dense": m.DENSE_CALLS}
    return table, {name: int(counts[place]) for name, place in names.items()}


def _failure(
    code: Code, status: int, x: Array, counts: Array, error: NewtonEulerError | None
) -> IntegrationError:
    """What to say of a march that could not go on; x is the last state that it reached."""
    system, reached = code.float_system(x), float(counts[m.REACHED])
    q, v = x[: system.nq], x[system.nq : code.size]
    if error is not None and status in (m.SINGULAR, m.OPEN):
        return IntegrationError(reached, str(error))
    if status == m.OPEN:
        joint, gap = worst_joint(system, system.state(q, v))
        reason = f"projection cannot close joint {joint!r}, which is open by {gap:.3g} (m or rad)"
        return IntegrationError(reached, reason)
    reasons = {
        m.NOT_FINITE: "the solution is not finite",
        m.SINGULAR: "the equations of motion are singular",
        m.TOO_MANY_STEPS: f"more than {MOST_STEPS} steps; for stiff equations use Radau",
        m.STEP_TOO_SMALL: "steps have become too small for double precision",
    }
    return IntegrationError(reached, f"{reasons[status]}; fastest at joint {system.fastest_joint(q, v)!r}")


def outputs(code: Code, x: Array, times: Array, table: Array) -> dict[str, Array]:
    """The arrays that the scene asks for, by name, of the states (n, size) at these times.

    `x` (inputs,) holds the parameters. Reactions near singular or under redundant constraints come
    from the float form, which knows the smallest ones.
    """
    function = code.function("output")
    results = np.empty((len(times), function.outputs))
    given = (x.copy(), times, np.ascontiguousarray(table), results)
    loops()(map_rows, len(times), code.size, function.outputs, function, *given)
    arrays = {
        name: results[:, place].reshape(len(times), *shape) for name, (place, shape) in code.places.items()
    }
    healthy = arrays.pop("health") > 0.0
    if "reactions" in code.scene.outputs and (code.redundant or not np.all(healthy)):
        system = code.float_system(x)
        for row in range(len(times)) if code.redundant else np.flatnonzero(~healthy):
            evaluation = system.evaluate(table[row, : system.nq], table[row, system.nq :])
            arrays["reaction_force"][row] = evaluation.reaction_force
            arrays["reaction_torque"][row] = evaluation.reaction_torque
    return arrays


def time_function(function: NativeFunction, x: Array, count: int) -> float:
    """s that `count` calls of a native function take, made by native code."""
    y = np.empty(function.outputs)
    x = np.ascontiguousarray(x, dtype=float)
    module = loops()
    start = time.perf_counter()
    module(repeat, count, function, x, y)
    return time.perf_counter() - start
