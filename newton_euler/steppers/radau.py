"""The march of Radau IIA of order 5 over output times, stiffly accurate, with the traced Jacobian.

E. Hairer, G. Wanner, Solving Ordinary Differential Equations II, second edition, Springer 1996, section
IV.8. The Jacobian need not be exact, so its health is not asked for. Written for native code, see
`newton_euler.native`; it runs as plain Python as well.
"""

from __future__ import annotations

from newton_euler.native import Callback, Vector, native
from newton_euler.steppers.collocation import (
    ERROR,
    NEWTON_STEPS,
    NODES,
    error_within,
    iterate,
    position_in,
    prepare,
    prepare_dense,
    scaled_norm,
)
from newton_euler.steppers.linear import solve_real, zero_block
from newton_euler.steppers.march import (
    DENSE_HEALTH,
    DONE,
    HOP,
    HUGE,
    INTERRUPTED,
    PATIENT,
    REACHED,
    REJECTED,
    SPACING,
    STEP_TOO_SMALL,
    STEPS,
    TINY,
    TOO_MANY_STEPS,
    UNSAFE,
    begin,
    evaluate,
    interrupted,
    keep_norms,
    leave,
    project,
    record_rows,
    unwind,
)

SMALLEST, FASTEST = 0.2, 10.0
"""Factors from one step size to the next."""


@native
def march_radau(
    n: int,
    outputs: int,
    times: Vector,
    rtol: float,
    atol: float,
    most: int,
    nq: int,
    kept: int,
    jacobian: Callback,
    derivative: Callback,
    dense: Callback,
    projecting: int,
    tolerance: float,
    inputs: int,
    lanes: int,
    position: Callback,
    velocity: Callback,
    closing: Callback,
    beside: Vector,
    pause: Callback,
    turning: Vector,
    now: Vector,
    at: Vector,
    slope: Vector,
    z: Vector,
    w: Vector,
    f: Vector,
    change: Vector,
    terms: Vector,
    matrices: Vector,
    pivots: Vector,
    table: Vector,
    counts: Vector,
) -> int:
    """Integrate `now` from times[0] and write the states at all times into the table (outputs, n).

    Of these states only the first `kept` elements, nq or n, are what outputs need; the others are anything.
    `now` and `at` are states with time and parameters. Scratch: slope (n + 2), z and terms (3, n),
    w (4, n), f (3, n + 1), change (3 n + 2), matrices (4, n, n), pivots (2, n).
    """
    status = begin(
        n, projecting, tolerance, inputs, lanes, position, velocity, closing, beside, now, table, counts
    )
    if status == DONE:
        status = evaluate(n, derivative, dense, now, slope, counts)
    stop = times[outputs - 1]
    if status == DONE and not slope[n] > DENSE_HEALTH:
        status = leave(n, nq, stop - now[n], projecting, now, slope)
    if status != DONE:
        return status
    d0 = scaled_norm(n, now, now, rtol, atol)
    d1 = scaled_norm(n, slope, now, rtol, atol)
    h = min(1e-6 if d0 < 1e-5 or d1 < 1e-5 else 0.01 * d0 / d1, stop - now[n])
    jacobian(now, matrices)
    whole = 1 if kept == n else 0
    due = 1
    fresh = 1
    factored = 0
    short = 0
    before_h = 0.0
    before_error = 0.0
    rejected = 0
    m = 0
    for i in range(3 * n):
        z[i] = 0.0
    while due < outputs:
        counts[REACHED] = now[n]
        if counts[STEPS] + counts[REJECTED] >= most:
            return TOO_MANY_STEPS
        if interrupted(pause, counts) == 1:
            return INTERRUPTED
        short = short + 1 if h < TINY * (stop - times[0]) else 0
        if short > PATIENT or h < 10.0 * SPACING * max(abs(now[n]), h):
            return STEP_TOO_SMALL
        if now[n] + h > stop or stop - now[n] - h < 1e-3 * h:
            h = stop - now[n]
            factored = 0
        if factored == 0:
            m = zero_block(n, matrices)
            singular = prepare(
                n, m, h, matrices, matrices[n * n :], matrices[2 * n * n :], matrices[3 * n * n :], pivots
            )
            if singular == 1:
                counts[REJECTED] += 1.0
                h = 0.5 * h
                continue
            factored = 1
        if before_h > 0.0:
            for s in range(3):
                position_in(n, n, 1.0 + NODES[s] * h / before_h, w[3 * n :], terms, at)
                for i in range(n):
                    z[n * s + i] = at[i] - now[i]
        else:
            for i in range(3 * n):
                z[i] = 0.0
        taken = iterate(
            n, m, h, rtol, atol, derivative, dense, now, at, z, w, f, change,
            matrices[n * n :], matrices[2 * n * n :], matrices[3 * n * n :], pivots, counts,
        )  # fmt: skip
        health = min(min(f[n], f[2 * n + 1]), f[3 * n + 2])
        if taken >= 0 and health < UNSAFE and slope[n] >= UNSAFE:
            counts[REJECTED] += 1.0
            h = HOP * h
            factored = 0
            continue
        if taken < 0:
            counts[REJECTED] += 1.0
            if fresh == 0:
                jacobian(now, matrices)
                fresh = 1
            else:
                h = 0.5 * h
            factored = 0
            continue
        for i in range(n):
            change[i] = slope[i] + (ERROR[0] * z[i] + ERROR[1] * z[n + i] + ERROR[2] * z[2 * n + i]) / h
        solve_real(n, m, matrices[n * n :], pivots, change)
        convergence = change[3 * n]
        for i in range(n):
            at[i] = max(abs(now[i]), abs(now[i] + z[2 * n + i]))
        error = scaled_norm(n, change, at, rtol, atol)
        if error > 1.0 and (rejected == 1 or counts[STEPS] == 0.0):
            for i in range(n):
                at[i] = now[i] + change[i]
            at[n] = now[n]
            if evaluate(n, derivative, dense, at, f, counts) == DONE:
                for i in range(n):
                    change[i] = f[i] + (ERROR[0] * z[i] + ERROR[1] * z[n + i] + ERROR[2] * z[2 * n + i]) / h
                solve_real(n, m, matrices[n * n :], pivots, change)
                for i in range(n):
                    at[i] = max(abs(now[i]), abs(now[i] + z[2 * n + i]))
                error = scaled_norm(n, change, at, rtol, atol)
        if before_h > 0.0 and times[due] < now[n] + h and error <= 1.0 and n > 0:
            error = max(error, error_within(n, h, before_h, rtol, atol, at, z, terms))
        safety = 0.9 * (2.0 * NEWTON_STEPS + 1.0) / (2.0 * NEWTON_STEPS + taken)
        factor = FASTEST
        if error > 0.0:
            factor = error**-0.25
            if before_h > 0.0 and before_error > 0.0 and error <= 1.0:
                factor = min(factor, factor * h / before_h * (before_error / error) ** 0.25)
        if not error <= 1.0:
            counts[REJECTED] += 1.0
            h = h * max(SMALLEST, safety * factor) if error < HUGE else 0.2 * h
            factored = 0
            rejected = 1
            continue
        counts[STEPS] += 1.0
        rejected = 0
        factor = min(FASTEST, max(SMALLEST, safety * factor))
        prepare_dense(n, z, terms)
        first = due
        while due < outputs and times[due] <= now[n] + h:
            state = table[n * due :]
            position_in(kept, n, (times[due] - now[n]) / h, now, terms, state)
            keep_norms(nq, turning, state, state)
            due += 1
        status = record_rows(
            n, first, due, projecting, 0, tolerance, whole, inputs, lanes, position, velocity, closing,
            beside, times, at, table, counts,
        )  # fmt: skip
        if status != DONE:
            return status
        for i in range(n):
            w[3 * n + i] = now[i]
            now[i] += z[2 * n + i]
        now[n] = now[n] + h
        unwind(n, turning, now, w[3 * n :])
        keep_norms(nq, turning, now, now)
        if projecting == 1:
            status = project(n, tolerance, 1, inputs, lanes, position, velocity, closing, beside, now)
            if status != DONE:
                return status
        status = evaluate(n, derivative, dense, now, slope, counts)
        if status != DONE:
            return status
        before_h = h
        before_error = max(error, 1e-2)
        fresh = 0
        if taken > 2 and convergence > 1e-3:
            jacobian(now, matrices)
            fresh = 1
            factored = 0
        if fresh == 1 or factor > 1.2 or factor < 1.0:
            h = h * factor
            factored = 0
    counts[REACHED] = now[n]
    return DONE
