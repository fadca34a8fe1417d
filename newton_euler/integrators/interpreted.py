"""Integration of equations of motion that Python evaluates, as Pinocchio's are: scipy's methods and fixed
steps."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import pairwise

import numpy as np

from newton_euler.equations.applied_forces import blamed, surroundings
from newton_euler.equations.redundancy import mobility
from newton_euler.equations.system import System, at_time
from newton_euler.errors import NewtonEulerError
from newton_euler.integrators.options import ADAPTIVE, Options
from newton_euler.integrators.projection import project_position, project_velocity
from newton_euler.model.trajectory import IntegrationError
from newton_euler.scalars import Array

NUDGE = 1e-8
"""Relative difference of coordinates and velocities, absolute (m, rad) for those below 1, for the
Jacobian."""

MOST_STEPS = 50_000
"""Steps after which an adaptive method gives up, if a run does not say."""

TINY, PATIENT = 1e-10, 50
"""Share of the whole, and number of steps below it, none longer in between, that do not grow, after which an
adaptive method gives up, as where a linkage locks. After a start, or a singular configuration, each is longer
than the one before."""


def integrate(
    system: System, q: Array, v: Array, times: Array, options: Options
) -> tuple[Array, dict[str, int], IntegrationError | None]:
    """Integrate from q, v at times[0]: (q, v) at all times, or at those before it had to stop, (n, nq + nv).

    Counts of the run and the error that stopped it, None if none did, come with them.

    It stops, with the time, the reason and the joint or force that it is about, for steps that shrink to
    nothing, numbers that are not finite, and equations or constraints that cannot be solved.
    """
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
            method = _adaptive if options.integrator in ADAPTIVE else _fixed
            for step, y in method(system, derivative, project, rows[0], times, options):
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


def _adaptive(
    system: System, derivative: Derivative, project: Projection, y: Array, times: Array, options: Options
) -> Iterator[tuple[int, Array]]:
    """Yield (steps so far, y) at times[1:], from the steps' dense output."""
    from scipy.integrate import DOP853, Radau

    from newton_euler.integrators.passing import PassingDOP853

    def jacobian(t: float, y: Array) -> Array:
        """By one-sided differences: scipy's own nudge grows without end for what nothing depends on."""
        at = derivative(t, y)
        nudges = NUDGE * np.maximum(1.0, np.abs(y))
        columns = [(derivative(t, y + np.eye(1, len(y), k)[0] * h) - at) / h for k, h in enumerate(nudges)]
        return np.array(columns).T

    given = {"rtol": options.rtol, "atol": options.atol}
    if options.integrator == "Radau":
        solver = Radau(derivative, times[0], y, times[-1], jac=jacobian, **given)
    elif options.projection:
        near = options.near(mobility(system.scene).residual, system.mechanism.size)
        solver = PassingDOP853(system, project, derivative, times[0], y, times[-1], near, **given)
        project = solver.project
    else:
        solver = DOP853(derivative, times[0], y, times[-1], **given)
    steps, due, tiny, last = 0, 1, 0, 0.0
    while due < len(times):
        try:
            message = solver.step()
        except ValueError as error:  # scipy's, of a Jacobian that is not finite
            raise IntegrationError(
                float(solver.t), _with_blame(system, solver.t, solver.y, str(error))
            ) from error
        if solver.status == "failed":
            raise IntegrationError(float(solver.t), _with_blame(system, solver.t, solver.y, str(message)))
        steps += 1
        if solver.step_size >= TINY * (times[-1] - times[0]):
            tiny = 0
        elif solver.step_size <= last:
            tiny += 1
        last = solver.step_size
        if tiny > PATIENT:
            reason = _with_blame(system, solver.t, solver.y, "steps have become too small")
            raise IntegrationError(float(solver.t), reason)
        most = options.most_steps or MOST_STEPS
        if steps > most:
            reason = f"more than {most} steps of {options.integrator}; for stiff equations use Radau"
            raise IntegrationError(float(solver.t), _with_blame(system, solver.t, solver.y, reason))
        if times[due] <= solver.t:
            dense = solver.dense_output()
            while due < len(times) and times[due] <= solver.t:
                yield steps, project(times[due], dense(times[due]))
                due += 1
        solver.y = project(solver.t, solver.y)
        if options.projection:
            solver.f = derivative(solver.t, solver.y)


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
