"""Methods with fixed steps: classical Runge-Kutta of order 4 (RK4) and semi-implicit Euler.

Written for native code, see `newton_euler.codegen.native`; it runs as plain Python as well. The time between
two outputs is divided into equal steps of at most the wanted size.
"""

from __future__ import annotations

from dataclasses import dataclass

from newton_euler.codegen.native import Callback, Record, Vector, native
from newton_euler.integrators.options import FIXED
from newton_euler.integrators.projection import begin, finish_step, project
from newton_euler.integrators.row_exchange import copy_flags, exchange_rows
from newton_euler.integrators.singular import (
    CONTRADICTION,
    DENSE_PIVOT_RATIO,
    NEAR,
    UNSAFE,
    contradiction,
    evaluate,
    leaving,
)
from newton_euler.integrators.stepper import (
    DONE,
    INTERRUPTED,
    REACHED,
    STEPS,
    STRAYING,
    Equations,
    Table,
    finish,
    interrupted,
    keep_norms,
    record,
    take,
    unwind,
)

RK4 = FIXED.index("RK4")

DUE, TAKEN = 0, 1
"""Places in the vector `control`."""

RK4_LIMIT = 2.785
"""Largest product of a gain alpha and a step of RK4 that is stable (E. Hairer, G. Wanner, Solving Ordinary
Differential Equations II, second edition, Springer 1996, section IV.2)."""


@dataclass(frozen=True, eq=False)
class FixedStep(Record):
    """The method and its state.

    Attributes:
        number: its place in `FIXED`.
        step: s, the largest.
        rate: qdot of a state, for Euler.
        now, at: states with time and parameters: where a step begins, of a stage.
        k: (4, n + 1) derivatives of the stages.
        change: (n,) change of the state in a step of RK4, and where one of Euler began.
        control: (2,) the row of the table that is due, and steps taken towards it.
    """

    number: int
    step: float
    rate: Callback
    now: Vector
    at: Vector
    k: Vector
    change: Vector
    control: Vector


@native
def divisions(span: float, step: float) -> int:
    """Count the equal steps of at most `step` that make up a span."""
    count = int(span / step * (1.0 - 1e-9))
    if float(count) < span / step * (1.0 - 1e-9):
        count += 1
    return count if count > 1 else 1


@native
def step_rk4(system: Equations, method: FixedStep, h: float, end: float, span: float) -> int:
    """Take a step of size h to the time `end` of a run of a span, all s; returns a status."""
    n = system.n
    row = n + 1
    now = method.now
    at = method.at
    k = method.k
    change = method.change
    for i in range(n):
        at[i] = now[i]
        change[i] = 0.0
    at[n] = now[n]
    pivot_ratio = NEAR
    for s in range(4):
        status = evaluate(system, at, k[row * s :])
        if status != DONE:
            return status
        pivot_ratio = min(pivot_ratio, k[row * s + n])
        weight = h / 6.0 if s == 0 or s == 3 else h / 3.0
        reach = h if s == 2 else 0.5 * h
        for i in range(n):
            change[i] += weight * k[row * s + i]
            at[i] = now[i] + reach * k[row * s + i]
        at[n] = now[n] + reach
    if pivot_ratio < NEAR:
        first = 1 if system.counts[STEPS] == 0.0 else 0
        if k[n] >= UNSAFE or (system.projecting == 0 and first == 0):
            if contradiction(system, h, now, k) > CONTRADICTION:
                return STRAYING
        elif first == 1 and not k[n] > DENSE_PIVOT_RATIO:
            status = leaving(system, span, system.projecting, now, k)
            if status != DONE:
                return status
    for i in range(n):
        now[i] += change[i]
    now[n] = end
    return finish_step(system, 0, now, change)


@native
def step_euler(system: Equations, method: FixedStep, h: float, end: float, span: float) -> int:
    """Take a step as `step_rk4` does: velocities first, then positions with the new velocities.

    Near a singular configuration it loses no digits that a method of order 1 would have.

    Rates of Euler parameters stand for an angular velocity, which is what goes on from step to step: left to
    point where they did, they would grow by half of their square times h^2 in a step. What gyroscopic
    torques add is the method's own, see `newton_euler.integrators.options.FIXED`.
    """
    n = system.n
    nq = system.nq
    now = method.now
    k = method.k
    begun = method.change
    status = evaluate(system, now, k)
    if status == DONE and system.counts[STEPS] == 0.0 and not k[n] > DENSE_PIVOT_RATIO:
        status = leaving(system, span, 1, now, k)
    if status != DONE:
        return status
    for i in range(nq, n):
        now[i] += h * k[i]
    keep_norms(system, now, now)
    method.rate(now, k)
    for i in range(nq):
        begun[i] = now[i]
        now[i] += h * k[i]
    now[n] = end
    keep_norms(system, now, begun)
    unwind(system, now, k)
    return project(system, 1, now) if system.projecting == 1 else DONE


@native
def begin_fixed(system: Equations, states: Vector, method: FixedStep) -> int:
    """Begin a run at `now`; returns a status."""
    for i in range(system.inputs):
        method.at[i] = method.now[i]
    method.control[DUE] = 1.0
    method.control[TAKEN] = 0.0
    status = begin(system, states, method.now)
    copy_flags(system.exchange, method.now, method.at)
    return status


@native
def step_fixed(system: Equations, table: Table, states: Vector, method: FixedStep) -> int:
    """Take a step towards the row that is due; returns a status."""
    times = table.times
    counts = system.counts
    now = method.now
    due = int(method.control[DUE])
    taken = int(method.control[TAKEN])
    count = divisions(times[due] - times[due - 1], method.step)
    h = (times[due] - times[due - 1]) / count
    counts[REACHED] = now[system.n]
    if interrupted(system) > 0:
        return INTERRUPTED
    end = times[due - 1] + (taken + 1) * h
    span = times[table.count - 1] - times[0]
    status = DONE
    if method.number == RK4:
        status = step_rk4(system, method, h, end, span)
    else:
        status = step_euler(system, method, h, end, span)
    if status != DONE:
        return status
    if exchange_rows(system.exchange, now) == 1:
        copy_flags(system.exchange, now, method.at)
    counts[STEPS] += 1.0
    method.control[TAKEN] = float(taken + 1)
    if taken + 1 == count:
        record(system, states, due, now)
        method.control[DUE] = float(due + 1)
        method.control[TAKEN] = 0.0
    return DONE


@native
def integrate_fixed(system: Equations, table: Table, method: FixedStep) -> None:
    """Make all runs of the table; a lane that has made one takes the next at once."""
    run = int(table.first[0])
    fresh = 1
    while run < table.runs:
        states = table.states[system.n * table.count * run :]
        status = DONE
        if fresh == 1:
            take(system, table, run, method.now)
            status = begin_fixed(system, states, method)
            fresh = 0
        if status == DONE and method.control[DUE] < table.count:
            status = step_fixed(system, table, states, method)
        if status != DONE or method.control[DUE] >= table.count:
            run = finish(system, table, run, status, method.now)
            fresh = 1
