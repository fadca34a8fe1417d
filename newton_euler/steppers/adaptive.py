"""The march of DOP853 over output times: step-size control, projection, dense output.

Written for native code, see `newton_euler.native`; it runs as plain Python as well.
"""

from __future__ import annotations

from math import sqrt

from newton_euler.native import Callback, Vector, native
from newton_euler.steppers.dop853 import STAGES, error_norm, interpolate, prepare_dense, stage
from newton_euler.steppers.march import (
    DONE,
    INTERRUPTED,
    PATIENT,
    REACHED,
    REJECTED,
    SPACING,
    STEP_TOO_SMALL,
    STEPS,
    TINY,
    TOO_MANY_STEPS,
    begin,
    evaluate,
    interrupted,
    project,
)

SAFETY, SMALLEST, LARGEST = 0.9, 0.2, 10.0
"""Factors of the step-size control, as in scipy."""

EXPONENT = -1.0 / 8.0

NEAR = 1e-3
"""Health below which a configuration is near a singular one. Round-off in accelerations grows with its
power -3/2 there, and so does what off the constraints they are worth."""

HOP = 0.8
"""Factor for a step that comes near a singular configuration: another try, whose stages lie elsewhere."""

HOPS = 25
"""So many tries; a step is 1/250 of the first one then."""


@native
def first_step(
    n: int,
    span: float,
    rtol: float,
    atol: float,
    derivative: Callback,
    dense: Callback,
    now: Vector,
    at: Vector,
    k: Vector,
    counts: Vector,
) -> float:
    """A first step size (Hairer, Norsett, Wanner, section II.4); k holds the derivative at `now`."""
    d0 = 0.0
    d1 = 0.0
    for i in range(n):
        scale = atol + rtol * abs(now[i])
        d0 += (now[i] / scale) * (now[i] / scale)
        d1 += (k[i] / scale) * (k[i] / scale)
    d0 = sqrt(d0 / n)
    d1 = sqrt(d1 / n)
    h = min(1e-6 if d0 < 1e-5 or d1 < 1e-5 else 0.01 * d0 / d1, span)
    for i in range(n):
        at[i] = now[i] + h * k[i]
    at[n] = now[n] + h
    evaluate(n, derivative, dense, at, k[n + 1 :], counts)
    d2 = 0.0
    for i in range(n):
        scale = atol + rtol * abs(now[i])
        change = (k[n + 1 + i] - k[i]) / scale
        d2 += change * change
    d2 = sqrt(d2 / n) / h
    largest = max(d1, d2)
    wanted = max(1e-6, 1e-3 * h) if largest <= 1e-15 else (0.01 / largest) ** 0.125
    return min(min(100.0 * h, wanted), span)


@native
def march_dop853(
    n: int,
    outputs: int,
    times: Vector,
    rtol: float,
    atol: float,
    most: int,
    derivative: Callback,
    dense: Callback,
    projecting: int,
    tolerance: float,
    position: Callback,
    velocity: Callback,
    closing: Callback,
    pause: Callback,
    now: Vector,
    at: Vector,
    end: Vector,
    k: Vector,
    terms: Vector,
    table: Vector,
    counts: Vector,
) -> int:
    """Integrate `now` from times[0] and write the states at all times into the table (outputs, n).

    `now`, `at` and `end` are states with time and parameters; k (16, n + 1) and terms (7, n) are scratch.
    """
    status = begin(n, projecting, tolerance, position, velocity, closing, now, k, table)
    if status == DONE:
        status = evaluate(n, derivative, dense, now, k, counts)
    if status != DONE:
        return status
    stop = times[outputs - 1]
    h = first_step(n, stop - now[n], rtol, atol, derivative, dense, now, at, k, counts)
    due = 1
    growing = LARGEST
    hops = 0
    short = 0
    while due < outputs:
        counts[REACHED] = now[n]
        if counts[STEPS] + counts[REJECTED] >= most:
            return TOO_MANY_STEPS
        if interrupted(pause, counts) == 1:
            return INTERRUPTED
        if h < 10.0 * SPACING * max(abs(now[n]), h):
            return STEP_TOO_SMALL
        if now[n] + h > stop or stop - now[n] - h < 1e-3 * h:
            h = stop - now[n]
        short = short + 1 if h < TINY * (stop - times[0]) else 0
        if short > PATIENT:
            return STEP_TOO_SMALL
        health = k[n]
        for s in range(1, STAGES + 1):
            status = stage(n, s, h, derivative, dense, now, end if s == STAGES else at, k, counts)
            if status != DONE:
                break
            health = min(health, k[(n + 1) * s + n])
        error = 1e10
        if status == DONE:
            error = error_norm(n, h, rtol, atol, now, end, k)
        # noise is no reason for much smaller steps, and no step should begin where noise is worst
        last = k[(n + 1) * STAGES + n]
        if health < NEAR and hops < HOPS and (not error < 1.0 or (last < NEAR and k[n] >= NEAR)):
            counts[REJECTED] += 1.0
            hops += 1
            h = HOP * h
            continue
        if not error < 1.0:
            counts[REJECTED] += 1.0
            if status != DONE and h < 1e-10 * (stop - times[0]):
                return status
            h = h * max(SMALLEST, SAFETY * error**EXPONENT)
            growing = 1.0
            continue
        counts[STEPS] += 1.0
        hops = 0
        if times[due] <= now[n] + h:
            for s in range(STAGES + 1, 16):
                status = stage(n, s, h, derivative, dense, now, at, k, counts)
                if status != DONE:
                    return status
            prepare_dense(n, h, now, end, k, terms)
            while due < outputs and times[due] <= now[n] + h:
                interpolate(n, (times[due] - now[n]) / h, now, terms, at)
                at[n] = times[due]
                if projecting == 1:
                    status = project(n, tolerance, position, velocity, closing, at, k[(n + 1) * 13 :])
                    if status != DONE:
                        return status
                for i in range(n):
                    table[n * due + i] = at[i]
                due += 1
        for i in range(n):
            now[i] = end[i]
        now[n] = now[n] + h
        if projecting == 1:
            status = project(n, tolerance, position, velocity, closing, now, k[(n + 1) * 13 :])
            if status == DONE:
                status = evaluate(n, derivative, dense, now, k, counts)
            if status != DONE:
                return status
        else:
            for i in range(n + 1):
                k[i] = k[(n + 1) * STAGES + i]
        factor = LARGEST if error == 0.0 else min(growing, SAFETY * error**EXPONENT)
        h = h * max(SMALLEST, factor)
        growing = LARGEST
    counts[REACHED] = now[n]
    return DONE
