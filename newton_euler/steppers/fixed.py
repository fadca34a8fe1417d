"""Marches with fixed steps: classical Runge-Kutta of order 4 and semi-implicit Euler.

Written for native code, see `newton_euler.native`; it runs as plain Python as well. The time between
two outputs is divided into equal steps of at most the wanted size.
"""

from __future__ import annotations

from newton_euler.native import Callback, Vector, native
from newton_euler.steppers.march import (
    DONE,
    INTERRUPTED,
    REACHED,
    STEPS,
    begin,
    evaluate,
    interrupted,
    project,
    unwind,
)


@native
def divisions(span: float, step: float) -> int:
    """How many equal steps of at most `step` make up a span."""
    count = int(span / step * (1.0 - 1e-9))
    if float(count) < span / step * (1.0 - 1e-9):
        count += 1
    return count if count > 1 else 1


@native
def march_rk4(
    n: int,
    outputs: int,
    times: Vector,
    step: float,
    derivative: Callback,
    dense: Callback,
    projecting: int,
    tolerance: float,
    position: Callback,
    velocity: Callback,
    closing: Callback,
    pause: Callback,
    turning: Vector,
    now: Vector,
    at: Vector,
    k: Vector,
    total: Vector,
    table: Vector,
    counts: Vector,
) -> int:
    """Integrate `now` from times[0] and write the states at all times into the table (outputs, n).

    `now` and `at` are states with time and parameters; k and total (n + 2) are scratch.
    """
    status = begin(n, projecting, tolerance, position, velocity, closing, now, total, table)
    if status != DONE:
        return status
    for due in range(1, outputs):
        count = divisions(times[due] - times[due - 1], step)
        h = (times[due] - times[due - 1]) / count
        for j in range(count):
            counts[REACHED] = now[n]
            if interrupted(pause, counts) == 1:
                return INTERRUPTED
            for i in range(n + 1):
                at[i] = now[i]
                total[i] = 0.0
            for s in range(4):
                status = evaluate(n, derivative, dense, at, k, counts)
                if status != DONE:
                    return status
                weight = h / 6.0 if s == 0 or s == 3 else h / 3.0
                reach = h if s == 2 else 0.5 * h
                for i in range(n):
                    total[i] += weight * k[i]
                    at[i] = now[i] + reach * k[i]
                at[n] = now[n] + reach
            for i in range(n):
                now[i] += total[i]
            now[n] = times[due - 1] + (j + 1) * h
            unwind(n, turning, now, total)
            counts[STEPS] += 1.0
            if projecting == 1:
                status = project(n, tolerance, position, velocity, closing, now, total)
                if status != DONE:
                    return status
        for i in range(n):
            table[n * due + i] = now[i]
    counts[REACHED] = now[n]
    return DONE


@native
def march_euler(
    n: int,
    outputs: int,
    times: Vector,
    step: float,
    nq: int,
    rate: Callback,
    derivative: Callback,
    dense: Callback,
    projecting: int,
    tolerance: float,
    position: Callback,
    velocity: Callback,
    closing: Callback,
    pause: Callback,
    turning: Vector,
    now: Vector,
    k: Vector,
    table: Vector,
    counts: Vector,
) -> int:
    """As `march_rk4`: velocities first, then positions with the new velocities; k (n + 2) is scratch."""
    status = begin(n, projecting, tolerance, position, velocity, closing, now, k, table)
    if status != DONE:
        return status
    for due in range(1, outputs):
        count = divisions(times[due] - times[due - 1], step)
        h = (times[due] - times[due - 1]) / count
        for j in range(count):
            counts[REACHED] = now[n]
            if interrupted(pause, counts) == 1:
                return INTERRUPTED
            status = evaluate(n, derivative, dense, now, k, counts)
            if status != DONE:
                return status
            for i in range(nq, n):
                now[i] += h * k[i]
            rate(now, k)
            for i in range(nq):
                now[i] += h * k[i]
            now[n] = times[due - 1] + (j + 1) * h
            unwind(n, turning, now, k)
            counts[STEPS] += 1.0
            if projecting == 1:
                status = project(n, tolerance, position, velocity, closing, now, k)
                if status != DONE:
                    return status
        for i in range(n):
            table[n * due + i] = now[i]
    counts[REACHED] = now[n]
    return DONE
