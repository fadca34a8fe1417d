"""Integrators with fixed steps: classical Runge-Kutta of order 4 (RK4) and semi-implicit Euler.

`integrate_fixed` makes all runs of a `Table` and writes the states at the output times. The time between two
outputs is divided into equal steps of at most the requested size. After each step the state is projected onto
the constraints, unless the run does without projection.

A state consists of the coordinates q and the velocities v; its rates are the time derivatives. A *state with
time and parameters* is one vector with the state, the time, flags of constraint rows, and parameters of the
scene (`newton_euler.integrators.stepper`). A flag is 1 for a redundant row that is left out, 0 for a row in
use.

Each evaluation of the rates also gives the *pivot ratio*: the distance to a singular configuration, where
constraints become dependent; 1 far away, 0 in it.

Functions marked `native` are compiled to machine code by `newton_euler.codegen`; they also run as plain
Python.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

from newton_euler.codegen.native import Callback, Record, Vector, native
from newton_euler.integrators.options import FIXED
from newton_euler.integrators.projection import begin_run, finish_step, project
from newton_euler.integrators.row_exchange import exchange_rows
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
    copy_flags,
    finish_run,
    normalize_quaternions,
    start_run,
    stop_request,
    unwind_angles,
    write_row,
)
from newton_euler.integrators.switches import choose_branches

RK4 = FIXED.index("RK4")
"""Value of `FixedStep.number` for RK4."""


class Progress(IntEnum):
    """Indices into `FixedStep.control`.

    Attributes:
        NEXT_ROW: index of the output time that is written next.
        STEPS_TAKEN: number of steps taken since the last output.
    """

    NEXT_ROW = 0
    STEPS_TAKEN = 1


RK4_LIMIT = 2.785
"""Largest product of the Baumgarte gain alpha, 1/s, and the step, s, for which RK4 is stable (E. Hairer,
G. Wanner, Solving Ordinary Differential Equations II, second edition, Springer 1996, section IV.2)."""


@dataclass(frozen=True, eq=False)
class FixedStep(Record):
    """Options of an integrator with fixed steps and its working memory for one run.

    Attributes:
        number: index of the integrator in `newton_euler.integrators.options.FIXED`.
        step: largest size of a step, s.
        rate: function that writes the rates of the coordinates, qdot, of a state; only Euler calls it.
        now: state with time and parameters at the start of the step.
        at: state with time and parameters at a stage of the step.
        k: (4, n + 1) rates and pivot ratio of each stage.
        change: (n,) change of the state in a step of RK4, or the coordinates at the start of a step of Euler.
        control: (2,) progress between two outputs, see `Progress`.
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
    """Return the number of equal steps of at most `step`, s, into which a time `span`, s, is divided.

    A step may be longer by the factor 1 + 1e-9, because round-off must not add a step.
    """
    count = int(span / step * (1.0 - 1e-9))
    if float(count) < span / step * (1.0 - 1e-9):
        count += 1
    return count if count > 1 else 1


@native
def step_rk4(system: Equations, method: FixedStep, h: float, end: float, span: float) -> Status:
    """Take a step of classical Runge-Kutta and project the end; return a status.

    Args:
        h: size of the step, s.
        end: time at the end of the step, s.
        span: duration of the run, s.
    """
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
    # four stages: `change` sums up their rates, `at` becomes the state of the next stage
    pivot_ratio = NEAR_PIVOT_RATIO  # larger values do not matter
    for s in range(4):
        choose_branches(system.switches, at)
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
    # near a singular configuration the stages must not contradict each other. A step that begins below
    # UNSAFE_PIVOT_RATIO is exempt if the run projects, or if the step is the first. A first step at or below
    # DENSE_PIVOT_RATIO begins in the singular configuration itself; the run must be allowed to start there
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
    # angles within a revolution, unit quaternions, projection; 0: by sparse, not dense equations
    return finish_step(system, 0, now, change)


@native
def step_euler(system: Equations, method: FixedStep, h: float, end: float, span: float) -> Status:
    """Take a step of semi-implicit Euler: velocities first, then positions with the new velocities.

    Arguments and result are those of `step_rk4`. Near a singular configuration no check is needed: a method
    of order 1 has fewer digits than round-off destroys there.

    If velocities are rates of Euler parameters, the rates are adapted to the new Euler parameters, so that
    the angular velocity stays the same. Unchanged rates would no longer be tangential to the unit sphere, and
    their norm would grow. `newton_euler.integrators.options.FIXED` describes the error of this method for
    gyroscopic torques.
    """
    n = system.n
    nq = system.nq
    now = method.now
    k = method.k
    start = method.change
    choose_branches(system.switches, now)
    status = evaluate(system, now, k)
    if status == Status.DONE and system.counts[Count.STEPS] == 0.0 and not k[n] > DENSE_PIVOT_RATIO:
        # as for a run with projection: this method does not refuse a singular start without projection
        status = check_singular_start(system, span, 1, now, k)
    if status != Status.DONE:
        return status
    # velocities, then the rates of the coordinates with the new velocities
    for i in range(nq, n):
        now[i] += h * k[i]
    normalize_quaternions(system, now, now)
    method.rate(now, k)
    for i in range(nq):
        start[i] = now[i]
        now[i] += h * k[i]
    # unit norms of Euler parameters, whose rates in `now` belong to those in `start`; revolutions of angles;
    # projection, with 1 of the velocities too
    now[n] = end
    normalize_quaternions(system, now, start)
    unwind_angles(system, now, k)
    return project(system, 1, now) if system.projecting == 1 else Status.DONE


@native
def begin_fixed(system: Equations, states: Vector, method: FixedStep) -> Status:
    """Begin a run at the state `method.now`: project it and write the first output; return a status."""
    for i in range(system.inputs):
        method.at[i] = method.now[i]
    method.control[Progress.NEXT_ROW] = 1.0
    method.control[Progress.STEPS_TAKEN] = 0.0
    status = begin_run(system, states, method.now)
    copy_flags(system, method.now, method.at)
    return status


@native
def step_fixed(system: Equations, table: Table, states: Vector, method: FixedStep) -> Status:
    """Take one step towards the next output time, and write the output if it is reached; return a status.

    Args:
        states: (count, n) states of the run at the output times.
    """
    times = table.times
    counts = system.counts
    now = method.now
    due = int(method.control[Progress.NEXT_ROW])
    taken = int(method.control[Progress.STEPS_TAKEN])
    # equal steps between the last output and the next one
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
    # exchange a constraint row that is left out for one in use if necessary; write the output after the last
    # of the equal steps
    if exchange_rows(system.exchange, now) == 1:
        copy_flags(system, now, method.at)
    counts[Count.STEPS] += 1.0
    method.control[Progress.STEPS_TAKEN] = float(taken + 1)
    if taken + 1 == count:
        write_row(system, states, due, now)
        method.control[Progress.NEXT_ROW] = float(due + 1)
        method.control[Progress.STEPS_TAKEN] = 0.0
    return Status.DONE


@native
def integrate_fixed(system: Equations, table: Table, method: FixedStep) -> None:
    """Integrate all runs of the table, one after the other.

    Compiled code may make several runs at once, one in each lane of the processor's vector registers. Each
    lane starts its next run as soon as its run has ended. Therefore one loop takes single steps.
    """
    run = int(table.first[0])
    fresh = 1  # 1 if the run has not begun
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
