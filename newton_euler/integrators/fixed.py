"""Marches with fixed steps: classical Runge-Kutta of order 4 and semi-implicit Euler.

Written for native code, see `newton_euler.codegen.native`; it runs as plain Python as well. The time between
two outputs is divided into equal steps of at most the wanted size.
"""

from __future__ import annotations

from dataclasses import dataclass

from newton_euler.codegen.native import Callback, Record, Vector, native
from newton_euler.integrators.march import (
    DENSE_HEALTH,
    DONE,
    INTERRUPTED,
    NEAR,
    REACHED,
    STEPS,
    STRAYING,
    UNSAFE,
    Equations,
    Table,
    begin,
    evaluate,
    interrupted,
    keep_norms,
    leave,
    project,
    record,
    unwind,
)

CONTRADICTION = 1e-3
"""Share of the velocities by which accelerations within a step may contradict each other near a singular
configuration. Chosen from runs of a parallelogram of bars without projection: those that went over to another
branch had k3 - k2 of 8e-3 or more somewhere, good ones mostly less than 1e-3: some good ones are refused.
Steps that pass with no stage near by are not looked at: without projection they open joints, and
`newton_euler.integrators.stabilize.check_still_closed` then refuses the run at its next output."""


@native
def divisions(span: float, step: float) -> int:
    """How many equal steps of at most `step` make up a span."""
    count = int(span / step * (1.0 - 1e-9))
    if float(count) < span / step * (1.0 - 1e-9):
        count += 1
    return count if count > 1 else 1


@native
def contradiction(n: int, nq: int, h: float, now: Vector, k: Vector) -> float:
    """How far the four stages k (4, n + 1) of a step of size h contradict each other, as a share of speeds.

    Two combinations of accelerations are looked at that are of order h^2, h^3 in velocities, of a smooth
    motion. Near a singular configuration, where multipliers lose their digits, they are noise, and where a
    motion goes over to another branch they are as large as the velocities.
    """
    row = n + 1
    gap = 0.0
    speed = 0.0
    for i in range(nq, n):
        gap += abs(k[2 * row + i] - k[row + i])
        gap += abs(k[i] - k[row + i] - k[2 * row + i] + k[3 * row + i])
        speed += abs(now[i]) + h * abs(k[i])
    return h * gap / speed if speed > 0.0 else 0.0


@dataclass(frozen=True, eq=False)
class RungeKutta4(Record):
    """The method and its state.

    Attributes:
        step: s, the largest.
        now, at: states with time and parameters: where a step begins, of a stage.
        k: (4, n + 1) derivatives of the stages.
        total: (n,) change of the state in a step.
    """

    step: float
    now: Vector
    at: Vector
    k: Vector
    total: Vector


@native
def march_rk4(system: Equations, table: Table, method: RungeKutta4) -> int:
    """Integrate `now` from the first time on and write the states at all times into the table."""
    n = system.n
    now = method.now
    at = method.at
    k = method.k
    total = method.total
    times = table.times
    counts = system.counts
    row = n + 1
    status = begin(system, table, now)
    if status != DONE:
        return status
    for due in range(1, table.count):
        count = divisions(times[due] - times[due - 1], method.step)
        h = (times[due] - times[due - 1]) / count
        for j in range(count):
            counts[REACHED] = now[n]
            if interrupted(system) == 1:
                return INTERRUPTED
            for i in range(n):
                at[i] = now[i]
                total[i] = 0.0
            at[n] = now[n]
            health = NEAR
            for s in range(4):
                status = evaluate(system, at, k[row * s :])
                if status != DONE:
                    return status
                health = min(health, k[row * s + n])
                weight = h / 6.0 if s == 0 or s == 3 else h / 3.0
                reach = h if s == 2 else 0.5 * h
                for i in range(n):
                    total[i] += weight * k[row * s + i]
                    at[i] = now[i] + reach * k[row * s + i]
                at[n] = now[n] + reach
            if health < NEAR:
                if k[n] >= UNSAFE or (system.projecting == 0 and counts[STEPS] > 0.0):
                    if contradiction(n, system.nq, h, now, k) > CONTRADICTION:
                        return STRAYING
                elif counts[STEPS] == 0.0 and not k[n] > DENSE_HEALTH:
                    status = leave(system, times[table.count - 1] - times[0], system.projecting, now, k)
                    if status != DONE:
                        return status
            for i in range(n):
                now[i] += total[i]
            now[n] = times[due - 1] + (j + 1) * h
            unwind(system, now, total)
            keep_norms(system, now, now)
            counts[STEPS] += 1.0
            if system.projecting == 1:
                status = project(system, 1, now)
                if status != DONE:
                    return status
        record(system, table, due, now)
    counts[REACHED] = now[n]
    return DONE


@dataclass(frozen=True, eq=False)
class SemiImplicitEuler(Record):
    """The method and its state.

    Attributes:
        step: s, the largest.
        rate: qdot of a state.
        now: state with time and parameters.
        k: (n + 1) derivative.
        last: (n,) where a step began.
    """

    step: float
    rate: Callback
    now: Vector
    k: Vector
    last: Vector


@native
def march_euler(system: Equations, table: Table, method: SemiImplicitEuler) -> int:
    """As `march_rk4`: velocities first, then positions with the new velocities.

    Near a singular configuration it loses no digits that a method of order 1 would have.

    Rates of Euler parameters stand for an angular velocity, which is what goes on from step to step: left to
    point where they did, they would grow by half of their square times h^2 in a step. What gyroscopic
    torques add is the method's own, see `newton_euler.integrators.integrate.FIXED`.
    """
    n = system.n
    nq = system.nq
    now = method.now
    k = method.k
    last = method.last
    times = table.times
    counts = system.counts
    status = begin(system, table, now)
    if status != DONE:
        return status
    for due in range(1, table.count):
        count = divisions(times[due] - times[due - 1], method.step)
        h = (times[due] - times[due - 1]) / count
        for j in range(count):
            counts[REACHED] = now[n]
            if interrupted(system) == 1:
                return INTERRUPTED
            status = evaluate(system, now, k)
            if status != DONE:
                return status
            if counts[STEPS] == 0.0 and not k[n] > DENSE_HEALTH:
                status = leave(system, times[table.count - 1] - times[0], 1, now, k)
                if status != DONE:
                    return status
            for i in range(nq, n):
                now[i] += h * k[i]
            keep_norms(system, now, now)
            method.rate(now, k)
            for i in range(nq):
                last[i] = now[i]
                now[i] += h * k[i]
            now[n] = times[due - 1] + (j + 1) * h
            keep_norms(system, now, last)
            unwind(system, now, k)
            counts[STEPS] += 1.0
            if system.projecting == 1:
                status = project(system, 1, now)
                if status != DONE:
                    return status
        record(system, table, due, now)
    counts[REACHED] = now[n]
    return DONE
