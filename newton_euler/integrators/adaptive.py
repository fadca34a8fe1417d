"""The march of DOP853 over output times: step-size control, projection, dense output.

Written for native code, see `newton_euler.codegen.native`; it runs as plain Python as well.
"""

from __future__ import annotations

from math import sqrt

from newton_euler.codegen.native import Callback, Vector, native
from newton_euler.integrators.dop853 import (
    ERROR_3,
    ERROR_5,
    NODES,
    STAGES,
    Dop853,
    error_norm,
    interpolate,
    prepare_dense,
    stage,
)
from newton_euler.integrators.march import (
    DENSE_HEALTH,
    DONE,
    HOP,
    HUGE,
    INTERRUPTED,
    NEAR,
    PATIENT,
    REACHED,
    REJECTED,
    SPACING,
    STEP_TOO_SMALL,
    STEPS,
    TINY,
    TOO_MANY_STEPS,
    UNSAFE,
    Equations,
    Table,
    begin,
    evaluate,
    interrupted,
    keep_norms,
    leave,
    project,
    project_densely,
    record_rows,
    unwind,
)

SAFETY, SMALLEST, LARGEST = 0.9, 0.2, 10.0
"""Factors of the step-size control, as in scipy."""

EXPONENT = -1.0 / 8.0

GAP, LEAST, MOST = 0.4667, 0.38, 0.55
"""Where in a step a singular configuration is to be passed: half way between the two stages that are
farthest apart, at 1/3 and 3/5, and how much earlier or later will do."""

HOPS = 12
"""Tries to place a step so; after them its error alone decides."""

NOWHERE = 1e9


@native
def crossing(n: int, k: Vector) -> float:
    """Where a step of 12 stages passes or will pass a singular configuration, in units of its length.

    The root of the health is a distance: what it is at both ends, 0 and 1, tells where it vanishes,
    within the step or beyond it, and the stage at 3/5 which of the two. NOWHERE if neither fits.
    """
    row = n + 1
    first = sqrt(max(k[n], 0.0))
    last = sqrt(max(k[row * STAGES + n], 0.0))
    middle = sqrt(max(k[row * 9 + n], 0.0))
    node = NODES[9]
    within = first / (first + last)
    gap_within = abs(abs(within - node) * (first + last) - middle)
    if first <= last:
        return within if gap_within < 0.2 * (first + last) else NOWHERE
    beyond = first / (first - last)
    gap_beyond = abs((beyond - node) * (first - last) - middle)
    if min(gap_within, gap_beyond) > 0.2 * (first + last):
        return NOWHERE
    return within if gap_within < gap_beyond else beyond


@native
def crossing_factor(n: int, k: Vector, error: float) -> float:
    """Factor for a step near a singular configuration that has it pass in the widest gap between two stages.

    1 if it does, or if that configuration is no concern of a step that its error makes shorter anyway.
    """
    where = crossing(n, k)
    shorter = SAFETY * error**EXPONENT if error > 1.0 else 1.0
    if where < LEAST or (where <= MOST and shorter < 1.0 and where <= GAP * shorter):
        return where / GAP
    if where > MOST * shorter and where < 1.0 + GAP:
        return where - GAP * shorter
    return 1.0


@native
def first_step(system: Equations, method: Dop853, span: float) -> float:
    """A first step size (Hairer, Norsett, Wanner, section II.4); k holds the derivative at `now`."""
    n = system.n
    now = method.now
    at = method.at
    k = method.k
    d0 = 0.0
    d1 = 0.0
    for i in range(n):
        scale = method.atol + method.rtol * abs(now[i])
        d0 += (now[i] / scale) * (now[i] / scale)
        d1 += (k[i] / scale) * (k[i] / scale)
    d0 = sqrt(d0 / n)
    d1 = sqrt(d1 / n)
    h = min(1e-6 if d0 < 1e-5 or d1 < 1e-5 else 0.01 * d0 / d1, span)
    for i in range(n):
        at[i] = now[i] + h * k[i]
    at[n] = now[n] + h
    evaluate(system, at, k[n + 1 :])
    d2 = 0.0
    for i in range(n):
        scale = method.atol + method.rtol * abs(now[i])
        change = (k[n + 1 + i] - k[i]) / scale
        d2 += change * change
    d2 = sqrt(d2 / n) / h
    largest = max(d1, d2)
    wanted = max(1e-6, 1e-3 * h) if largest <= 1e-15 else (0.01 / largest) ** 0.125
    return min(min(100.0 * h, wanted), span)


@native
def error_on_constraints(n: int, h: float, closing: Callback, method: Dop853) -> float:
    """The norm of the error of what a step is worth after projection; the projected end in row 13 of k.

    Near a singular configuration multipliers have few digits. What they add to a state in vain is off
    the constraints, and no step is short enough for it not to matter.
    """
    row = n + 1
    at = method.at
    end = method.end
    k = method.k
    closing(end, k[13 * row :])
    if not k[13 * row + n] > 0.0:
        return 1e10
    at[n] = end[n]
    for i in range(n):
        five = 0.0
        for j in range(STAGES + 1):
            five += ERROR_5[j] * k[row * j + i]
        at[i] = end[i] + h * five
    closing(at, k[14 * row :])
    for i in range(n):
        three = 0.0
        for j in range(STAGES + 1):
            three += ERROR_3[j] * k[row * j + i]
        at[i] = end[i] + h * three
    closing(at, k[15 * row :])
    if not min(k[14 * row + n], k[15 * row + n]) > 0.0:
        return 1e10
    fifth = 0.0
    third = 0.0
    for i in range(n):
        scale = method.near_atol + method.near_rtol * max(abs(method.now[i]), abs(end[i]))
        five = (k[14 * row + i] - k[13 * row + i]) / scale
        three = (k[15 * row + i] - k[13 * row + i]) / scale
        fifth += five * five
        third += three * three
    if fifth == 0.0 and third == 0.0:
        return 0.0
    return fifth / sqrt((fifth + 0.01 * third) * n)


@native
def march_dop853(system: Equations, table: Table, method: Dop853) -> int:
    """Integrate `now` from the first time on and write the states at all times into the table."""
    n = system.n
    now = method.now
    at = method.at
    end = method.end
    k = method.k
    times = table.times
    counts = system.counts
    status = begin(system, table, now)
    if status == DONE:
        status = evaluate(system, now, k)
    stop = times[table.count - 1]
    if status == DONE and not k[n] > DENSE_HEALTH:
        status = leave(system, stop - now[n], system.projecting, now, k)
    if status != DONE:
        return status
    h = first_step(system, method, stop - now[n])
    due = 1
    growing = LARGEST
    hops = 0
    short = 0
    while due < table.count:
        counts[REACHED] = now[n]
        if counts[STEPS] + counts[REJECTED] >= method.most:
            return TOO_MANY_STEPS
        if interrupted(system) == 1:
            return INTERRUPTED
        if h < 10.0 * SPACING * max(abs(now[n]), h):
            return STEP_TOO_SMALL
        if now[n] + h > stop or stop - now[n] - h < 1e-3 * h:
            h = stop - now[n]
        short = short + 1 if h < TINY * (stop - times[0]) else 0
        if short > PATIENT:
            return STEP_TOO_SMALL
        health = HUGE
        for s in range(1, STAGES + 1):
            status = stage(system, method, s, h, end if s == STAGES else at)
            if status != DONE:
                break
            health = min(health, k[(n + 1) * s + n])
        if health < UNSAFE and k[n] >= UNSAFE:
            counts[REJECTED] += 1.0
            h = HOP * h
            continue
        health = min(health, k[n])
        error = 1e10
        if status == DONE:
            error = error_norm(n, h, method)
            end[n] = now[n] + h
        near = 0
        if system.projecting == 1 and health < NEAR and status == DONE:
            near = 1
            error = min(error, error_on_constraints(n, h, system.closing, method))
        if near == 1 and hops < HOPS:
            wanted = crossing_factor(n, k, error)
            if wanted < 1.0:
                counts[REJECTED] += 1.0
                hops += 1
                h = wanted * h
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
                status = stage(system, method, s, h, at)
                if status != DONE:
                    return status
            prepare_dense(n, h, method)
            first = due
            while due < table.count and times[due] <= now[n] + h:
                state = table.states[n * due :]
                interpolate(n if near == 1 else table.kept, n, (times[due] - now[n]) / h, method, state)
                keep_norms(system, state, state)
                due += 1
            status = record_rows(system, table, first, due, near, at)
            if status != DONE:
                return status
        for i in range(n):
            now[i] = end[i]
        now[n] = now[n] + h
        unwind(system, now, end)
        keep_norms(system, now, now)
        if system.projecting == 1:
            scratch = k[(n + 1) * 13 :]
            status = project_densely(system, now, scratch) if near == 1 else project(system, 1, now)
            if status == DONE:
                status = evaluate(system, now, k)
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
