"""Integration of equations of motion that Python evaluates, such as Pinocchio's.

This module integrates with fixed steps (RK4, semi-implicit Euler) in plain Python. Adaptive methods are
native code that calls Python, see `newton_euler.compiled.evaluated`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import pairwise

import numpy as np

from newton_euler.compiled.evaluated import integrate_adaptive
from newton_euler.equations.applied_forces import surroundings, with_likely_causes
from newton_euler.equations.system import System, at_time
from newton_euler.errors import NewtonEulerError
from newton_euler.integrators.options import ADAPTIVE, Options
from newton_euler.integrators.projection import project_position, project_velocity
from newton_euler.model.trajectory import IntegrationError
from newton_euler.scalars import Array


def integrate(
    system: System, q: Array, v: Array, times: Array, options: Options
) -> tuple[Array, dict[str, int], IntegrationError | None]:
    """Integrate the equations of motion of a system over given output times.

    A run stops early if steps become too small, if numbers are not finite, or if the equations or the
    constraints have no solution. The error has the time, the reason, and the fastest joint or largest force.

    Args:
        system: equations of motion.
        q: (nq,) initial coordinates.
        v: (nv,) initial velocities.
        times: (n,) s, output times; the first is the start.
        options: integrator and step control.

    Returns:
        States (q, v) at the output times reached, (rows, nq + nv); numbers of steps and evaluations; the
        error that stopped the run, None for a complete run.
    """
    if options.integrator in ADAPTIVE:
        return integrate_adaptive(system, q, v, times, options)
    evaluations = 0
    last_good = np.concatenate([q, v])  # last state with finite accelerations, for error messages

    def derivative(t: float, y: Array) -> Array:
        """Compute dq/dt and dv/dt at time t, s, and state y (nq + nv,)."""
        nonlocal evaluations, last_good
        evaluations += 1
        q, v = y[: system.nq], y[system.nq :]
        now = at_time(system, t)  # prescribed motions, control laws and forces may depend on the time
        try:
            rates = np.concatenate([now.rate(q, v), now.acceleration(q, v)])
        except (NewtonEulerError, np.linalg.LinAlgError) as error:
            raise IntegrationError(t, _with_causes(system, t, last_good, str(error))) from error
        if not np.isfinite(rates).all():
            raise IntegrationError(t, _with_causes(system, t, last_good, "accelerations are not finite"))
        last_good = y
        return rates

    def project(t: float, y: Array) -> Array:
        """Return state y (nq + nv,) moved onto the constraints at time t, s, with quaternions of norm 1."""
        now = at_time(system, t)
        if not options.projection:  # quaternions are normalized even without projection
            return np.concatenate([now.retract(y[: system.nq], np.zeros(system.nv)), y[system.nq :]])
        try:
            q = project_position(now, y[: system.nq])
            return np.concatenate([q, project_velocity(now, q, y[system.nq :])])
        except (NewtonEulerError, np.linalg.LinAlgError) as error:
            raise IntegrationError(t, f"projection fails: {error}") from error

    # step from output to output until the end or the first error
    steps, stopped = 0, None
    rows: list[Array] = []
    try:
        with np.errstate(all="ignore"):  # the loop checks that numbers are finite
            rows.append(project(float(times[0]), last_good))
            for steps_so_far, y in _fixed(system, derivative, project, rows[0], times, options):
                steps = steps_so_far
                if not np.all(np.isfinite(y)):
                    time = float(times[len(rows)])
                    reason = _with_causes(system, time, last_good, "the solution is not finite")
                    raise IntegrationError(time, reason)
                rows.append(y)
    except IntegrationError as error:
        stopped = error
    table = np.array(rows).reshape(len(rows), system.nq + system.nv)
    return table, {"steps": steps, "evaluations": evaluations}, stopped


def _with_causes(system: System, time: float, y: Array, reason: str) -> str:
    """Append the fastest joint and the largest force at a state y (nq + nv,) and time, s, to a reason."""
    state = system.state(y[: system.nq], y[system.nq :])
    force_inputs = surroundings(system.scene, state, time)  # quantities on which the forces depend
    return with_likely_causes(system.scene, state, reason, force_inputs)


Derivative = Callable[[float, Array], Array]
"""Function of time, s, and state (nq + nv,) that computes the time derivative of the state."""

Projection = Callable[[float, Array], Array]
"""Function of time, s, and state (nq + nv,) that moves the state onto the constraints."""


def _fixed(
    system: System, derivative: Derivative, project: Projection, y: Array, times: Array, options: Options
) -> Iterator[tuple[int, Array]]:
    """Integrate with equal steps between output times; yield (number of steps so far, state) at each of them.

    Args:
        system: equations of motion.
        derivative: computes the time derivative of a state.
        project: moves a state onto the constraints after each step.
        y: (nq + nv,) initial state.
        times: s, output times; nothing is yielded for the first one, the start.
        options: integrator and longest step.
    """
    advance = {"RK4": _rk4, "Euler": _semi_implicit_euler}[options.integrator]
    assert options.step is not None
    steps = 0
    for begin, end in pairwise(times):
        # the factor keeps round-off from adding a step if the interval is a whole number of steps
        count = max(1, int(np.ceil((end - begin) / options.step * (1.0 - 1e-9))))
        h = (end - begin) / count
        for k in range(count):
            moved = advance(system, derivative, begin + k * h, y, h)
            if not np.all(np.isfinite(moved)):
                reason = _with_causes(system, float(begin + k * h), y, "the solution is not finite")
                raise IntegrationError(float(begin + (k + 1) * h), reason)
            y = project(begin + (k + 1) * h, moved)
        steps += count
        yield steps, y


def _rk4(system: System, derivative: Derivative, t: float, y: Array, h: float) -> Array:
    """Return the state after a step of h, s, of the classical Runge-Kutta method of order 4.

    Args:
        system: not needed; the arguments are those of `_semi_implicit_euler`.
        derivative: computes the time derivative of a state.
        t: s, time at the start of the step.
        y: (nq + nv,) state at the start of the step.
        h: s, size of the step.
    """
    k1 = derivative(t, y)
    k2 = derivative(t + 0.5 * h, y + 0.5 * h * k1)
    k3 = derivative(t + 0.5 * h, y + 0.5 * h * k2)
    k4 = derivative(t + h, y + h * k3)
    return y + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)


def _semi_implicit_euler(system: System, derivative: Derivative, t: float, y: Array, h: float) -> Array:
    """Return the state after a step of semi-implicit Euler: velocities first, then coordinates.

    See `_rk4` for the arguments.
    """
    q = y[: system.nq]
    v = y[system.nq :] + h * derivative(t, y)[system.nq :]
    return np.concatenate([q + h * system.rate(q, v), v])  # dq/dt does not depend on the time
