"""Methods with fixed steps: classical Runge-Kutta of order 4 (RK4) and semi-implicit Euler.

Written for native code, see `newton_euler.codegen.native`; it runs as plain Python as well. The time between
two outputs is divided into equal steps of at most the wanted size.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

from newton_euler.codegen.native import Callback, Record, Vector, native
from newton_euler.integrators.options import FIXED
from newton_euler.integrators.projection import begin_run, finish_step, project
from newton_euler.integrators.row_exchange import copy_flags, exchange_rows
from newton_euler.integrators.singular import (
    DENSE_PIVOT_RATIO,
    MAX_CONTRADICTION,
    NEAR_PIVOT_RATIO,
    UNSAFE_PIVOT_RATIO,
    check_singular_start,
    evaluate,
    stage_contradiction,
)
from newton_euler.integrators.status import Status
from newton_euler.integrators.stepper import (
    Count,
    Equations,
    Table,
    finish_run,
    normalize_quaternions,
    start_run,
    stop_request,
    unwind_angles,
    write_row,
)

RK4 = FIXED.index("RK4")


class Progress(IntEnum):
    """Places in the vector `control`: row of the table that is written next, and steps taken towards it."""

    NEXT_ROW = 0
    STEPS_TAKEN = 1


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
def step_rk4(system: Equations, method: FixedStep, h: float, end: float, span: float) -> Status:
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
    pivot_ratio = NEAR_PIVOT_RATIO
    for s in range(4):
        status = evaluate(system, at, k[row * s :])
        if status != Status.DONE:
            return status
        pivot_ratio = min(pivot_ratio, k[row * s + n])
        weight = h / 6.0 if s == 0 or s == 3 else h / 3.0
        reach = h if s == 2 else 0.5 * h
        for i in range(n):
            change[i] += weight * k[row * s + i]
            at[i] = now[i] + reach * k[row * s + i]
        at[n] = now[n] + reach
    if pivot_ratio < NEAR_PIVOT_RATIO:
        first = 1 if system.counts[Count.STEPS] == 0.0 else 0
        if k[n] >= UNSAFE_PIVOT_RATIO or (system.projecting == 0 and first == 0):
            if stage_contradiction(system, h, now, k) > MAX_CONTRADICTION:
                return Status.STRAYING
        elif first == 1 and not k[n] > DENSE_PIVOT_RATIO:
            status = check_singular_start(system, span, system.projecting, now, k)
            if status != Status.DONE:
                return status
    for i in range(n):
        now[i] += change[i]
    now[n] = end
    return finish_step(system, 0, now, change)


@native
def step_euler(system: Equations, method: FixedStep, h: float, end: float, span: float) -> Status:
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
    if status == Status.DONE and system.counts[Count.STEPS] == 0.0 and not k[n] > DENSE_PIVOT_RATIO:
        status = check_singular_start(system, span, 1, now, k)
    if status != Status.DONE:
        return status
    for i in range(nq, n):
        now[i] += h * k[i]
    normalize_quaternions(system, now, now)
    method.rate(now, k)
    for i in range(nq):
        begun[i] = now[i]
        now[i] += h * k[i]
    now[n] = end
    normalize_quaternions(system, now, begun)
    unwind_angles(system, now, k)
    return project(system, 1, now) if system.projecting == 1 else Status.DONE


@native
def begin_fixed(system: Equations, states: Vector, method: FixedStep) -> Status:
    """Begin a run at `now`; returns a status."""
    for i in range(system.inputs):
        method.at[i] = method.now[i]
    method.control[Progress.NEXT_ROW] = 1.0
    method.control[Progress.STEPS_TAKEN] = 0.0
    status = begin_run(system, states, method.now)
    copy_flags(system.exchange, method.now, method.at)
    return status


@native
def step_fixed(system: Equations, table: Table, states: Vector, method: FixedStep) -> Status:
    """Take a step towards the row that is due; returns a status."""
    times = table.times
    counts = system.counts
    now = method.now
    due = int(method.control[Progress.NEXT_ROW])
    taken = int(method.control[Progress.STEPS_TAKEN])
    count = divisions(times[due] - times[due - 1], method.step)
    h = (times[due] - times[due - 1]) / count
    counts[Count.TIME_REACHED] = now[system.n]
    if stop_request(system) > 0:
        return Status.INTERRUPTED
    end = times[due - 1] + (taken + 1) * h
    span = times[table.count - 1] - times[0]
    status = Status.DONE
    if method.number == RK4:
        status = step_rk4(system, method, h, end, span)
    else:
        status = step_euler(system, method, h, end, span)
    if status != Status.DONE:
        return status
    if exchange_rows(system.exchange, now) == 1:
        copy_flags(system.exchange, now, method.at)
    counts[Count.STEPS] += 1.0
    method.control[Progress.STEPS_TAKEN] = float(taken + 1)
    if taken + 1 == count:
        write_row(system, states, due, now)
        method.control[Progress.NEXT_ROW] = float(due + 1)
        method.control[Progress.STEPS_TAKEN] = 0.0
    return Status.DONE


@native
def integrate_fixed(system: Equations, table: Table, method: FixedStep) -> None:
    """Make all runs of the table; a lane that has made one takes the next at once."""
    run = int(table.first[0])
    fresh = 1
    while run < table.runs:
        states = table.states[system.n * table.count * run :]
        status = Status.DONE
        if fresh == 1:
            start_run(system, table, run, method.now)
            status = begin_fixed(system, states, method)
            fresh = 0
        if status == Status.DONE and method.control[Progress.NEXT_ROW] < table.count:
            status = step_fixed(system, table, states, method)
        if status != Status.DONE or method.control[Progress.NEXT_ROW] >= table.count:
            run = finish_run(system, table, run, status, method.now)
            fresh = 1
