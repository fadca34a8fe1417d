"""Integration of equations of motion that Python evaluates, as Pinocchio's are.

Adaptive methods are native, see `newton_euler.compiled.evaluated`; fixed steps are Python.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import pairwise

import numpy as np

from newton_euler.compiled.evaluated import integrate_adaptive
from newton_euler.equations.applied_forces import blamed, surroundings
from newton_euler.equations.system import System, at_time
from newton_euler.errors import NewtonEulerError
from newton_euler.integrators.options import ADAPTIVE, Options
from newton_euler.integrators.projection import project_position, project_velocity
from newton_euler.model.trajectory import IntegrationError
from newton_euler.scalars import Array


def integrate(
    system: System, q: Array, v: Array, times: Array, options: Options
) -> tuple[Array, dict[str, int], IntegrationError | None]:
    """Integrate from q, v at times[0]: (q, v) at all times, or at those before it had to stop, (n, nq + nv).

    Counts of the run and the error that stopped it, None if none did, come with them.

    It stops, with the time, the reason and the joint or force that it is about, for steps that shrink to
    nothing, numbers that are not finite, and equations or constraints that cannot be solved.
    """
    if options.integrator in ADAPTIVE:
        return integrate_adaptive(system, q, v, times, options)
    evaluations = 0
    good = np.concatenate([q, v])  # where accelerations were finite last

    def derivative(t: float, y: Array) -> Array:
        nonlocal evaluations, good
        evaluations += 1
        q, v = y[: system.nq], y[system.nq :]
        now = at_time(system, t)
        try:
            rates = np.concatenate([now.rate(q, v), now.acceleration(q, v)])
        except (NewtonEulerError, np.linalg.LinAlgError) as error:
            raise IntegrationError(t, _with_blame(system, t, good, str(error))) from error
        if not np.isfinite(rates).all():
            raise IntegrationError(t, _with_blame(system, t, good, "accelerations are not finite"))
        good = y
        return rates

    def project(t: float, y: Array) -> Array:
        now = at_time(system, t)
        if not options.projection:  # a norm of Euler parameters is none of the mechanism's constraints
            return np.concatenate([now.retract(y[: system.nq], np.zeros(system.nv)), y[system.nq :]])
        try:
            q = project_position(now, y[: system.nq])
            return np.concatenate([q, project_velocity(now, q, y[system.nq :])])
        except (NewtonEulerError, np.linalg.LinAlgError) as error:
            raise IntegrationError(t, f"projection fails: {error}") from error

    steps, stopped = 0, None
    rows: list[Array] = []
    try:
        with np.errstate(all="ignore"):  # numbers are checked
            rows.append(project(float(times[0]), good))
            for step, y in _fixed(system, derivative, project, rows[0], times, options):
                steps = step
                if not np.all(np.isfinite(y)):
                    reason = _with_blame(system, float(times[len(rows)]), good, "the solution is not finite")
                    raise IntegrationError(float(times[len(rows)]), reason)
                rows.append(y)
    except IntegrationError as error:
        stopped = error
    table = np.array(rows).reshape(len(rows), system.nq + system.nv)
    return table, {"steps": steps, "evaluations": evaluations}, stopped


def _with_blame(system: System, time: float, y: Array, reason: str) -> str:
    """Add the joint that moves fastest and the largest force at a time in s to a reason."""
    state = system.state(y[: system.nq], y[system.nq :])
    return blamed(system.scene, state, reason, surroundings(system.scene, state, time))


Derivative = Callable[[float, Array], Array]
Projection = Callable[[float, Array], Array]


def _fixed(
    system: System, derivative: Derivative, project: Projection, y: Array, times: Array, options: Options
) -> Iterator[tuple[int, Array]]:
    """Yield (steps so far, y) at times[1:], in equal steps between outputs."""
    advance = {"RK4": _rk4, "Euler": _semi_implicit_euler}[options.integrator]
    assert options.step is not None
    steps = 0
    for begin, end in pairwise(times):
        count = max(1, int(np.ceil((end - begin) / options.step * (1.0 - 1e-9))))
        h = (end - begin) / count
        for k in range(count):
            moved = advance(system, derivative, begin + k * h, y, h)
            if not np.all(np.isfinite(moved)):
                reason = _with_blame(system, float(begin + k * h), y, "the solution is not finite")
                raise IntegrationError(float(begin + (k + 1) * h), reason)
            y = project(begin + (k + 1) * h, moved)
        steps += count
        yield steps, y


def _rk4(system: System, derivative: Derivative, t: float, y: Array, h: float) -> Array:
    k1 = derivative(t, y)
    k2 = derivative(t + 0.5 * h, y + 0.5 * h * k1)
    k3 = derivative(t + 0.5 * h, y + 0.5 * h * k2)
    k4 = derivative(t + h, y + h * k3)
    return y + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)


def _semi_implicit_euler(system: System, derivative: Derivative, t: float, y: Array, h: float) -> Array:
    q = y[: system.nq]
    v = y[system.nq :] + h * derivative(t, y)[system.nq :]
    return np.concatenate([q + h * system.rate(q, v), v])
