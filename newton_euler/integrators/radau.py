"""The march of Radau IIA of order 5 over output times, stiffly accurate, with the traced Jacobian.

E. Hairer, G. Wanner, Solving Ordinary Differential Equations II, second edition, Springer 1996, section
IV.8. The Jacobian need not be exact, so its health is not asked for. Written for native code, see
`newton_euler.codegen.native`; it runs as plain Python as well.
"""

from __future__ import annotations

from newton_euler.codegen.native import native
from newton_euler.integrators.collocation import (
    ERROR,
    NEWTON_STEPS,
    NODES,
    Radau,
    error_within,
    iterate,
    position_in,
    prepare,
    prepare_dense,
    scaled_norm,
)
from newton_euler.integrators.linear import solve_real, zero_block
from newton_euler.integrators.march import (
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
    Equations,
    Table,
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
def march_radau(system: Equations, table: Table, method: Radau) -> int:
    """Integrate `now` from the first time on and write the states at all times into the table."""
    n = system.n
    now = method.now
    at = method.at
    slope = method.slope
    z = method.z
    f = method.f
    change = method.change
    terms = method.terms
    times = table.times
    counts = system.counts
    rtol = method.rtol
    atol = method.atol
    status = begin(system, table, now)
    if status == DONE:
        status = evaluate(system, now, slope)
    stop = times[table.count - 1]
    if status == DONE and not slope[n] > DENSE_HEALTH:
        status = leave(system, stop - now[n], system.projecting, now, slope)
    if status != DONE:
        return status
    d0 = scaled_norm(n, now, now, rtol, atol)
    d1 = scaled_norm(n, slope, now, rtol, atol)
    h = min(1e-6 if d0 < 1e-5 or d1 < 1e-5 else 0.01 * d0 / d1, stop - now[n])
    method.jacobian(now, method.matrix)
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
    while due < table.count:
        counts[REACHED] = now[n]
        if counts[STEPS] + counts[REJECTED] >= method.most:
            return TOO_MANY_STEPS
        if interrupted(system) == 1:
            return INTERRUPTED
        short = short + 1 if h < TINY * (stop - times[0]) else 0
        if short > PATIENT or h < 10.0 * SPACING * max(abs(now[n]), h):
            return STEP_TOO_SMALL
        if now[n] + h > stop or stop - now[n] - h < 1e-3 * h:
            h = stop - now[n]
            factored = 0
        if factored == 0:
            m = zero_block(n, method.matrix)
            if prepare(n, m, h, method) == 1:
                counts[REJECTED] += 1.0
                h = 0.5 * h
                continue
            factored = 1
        if before_h > 0.0:
            for s in range(3):
                position_in(n, n, 1.0 + NODES[s] * h / before_h, method.before, terms, at)
                for i in range(n):
                    z[n * s + i] = at[i] - now[i]
        else:
            for i in range(3 * n):
                z[i] = 0.0
        taken = iterate(system, method, m, h)
        health = min(min(f[n], f[2 * n + 1]), f[3 * n + 2])
        if taken >= 0 and health < UNSAFE and slope[n] >= UNSAFE:
            counts[REJECTED] += 1.0
            h = HOP * h
            factored = 0
            continue
        if taken < 0:
            counts[REJECTED] += 1.0
            if fresh == 0:
                method.jacobian(now, method.matrix)
                fresh = 1
            else:
                h = 0.5 * h
            factored = 0
            continue
        for i in range(n):
            change[i] = slope[i] + (ERROR[0] * z[i] + ERROR[1] * z[n + i] + ERROR[2] * z[2 * n + i]) / h
        solve_real(n, m, method.real, method.pivots, change)
        convergence = change[3 * n]
        for i in range(n):
            at[i] = max(abs(now[i]), abs(now[i] + z[2 * n + i]))
        error = scaled_norm(n, change, at, rtol, atol)
        if error > 1.0 and (rejected == 1 or counts[STEPS] == 0.0):
            for i in range(n):
                at[i] = now[i] + change[i]
            at[n] = now[n]
            if evaluate(system, at, f) == DONE:
                for i in range(n):
                    change[i] = f[i] + (ERROR[0] * z[i] + ERROR[1] * z[n + i] + ERROR[2] * z[2 * n + i]) / h
                solve_real(n, m, method.real, method.pivots, change)
                for i in range(n):
                    at[i] = max(abs(now[i]), abs(now[i] + z[2 * n + i]))
                error = scaled_norm(n, change, at, rtol, atol)
        if before_h > 0.0 and times[due] < now[n] + h and error <= 1.0 and n > 0:
            error = max(error, error_within(n, h, before_h, method))
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
        while due < table.count and times[due] <= now[n] + h:
            state = table.states[n * due :]
            position_in(table.kept, n, (times[due] - now[n]) / h, now, terms, state)
            keep_norms(system, state, state)
            due += 1
        status = record_rows(system, table, first, due, 0, at)
        if status != DONE:
            return status
        for i in range(n):
            method.before[i] = now[i]
            now[i] += z[2 * n + i]
        now[n] = now[n] + h
        unwind(system, now, method.before)
        keep_norms(system, now, now)
        if system.projecting == 1:
            status = project(system, 1, now)
            if status != DONE:
                return status
        status = evaluate(system, now, slope)
        if status != DONE:
            return status
        before_h = h
        before_error = max(error, 1e-2)
        fresh = 0
        if taken > 2 and convergence > 1e-3:
            method.jacobian(now, method.matrix)
            fresh = 1
            factored = 0
        if fresh == 1 or factor > 1.2 or factor < 1.0:
            h = h * factor
            factored = 0
    counts[REACHED] = now[n]
    return DONE
