"""Radau IIA of order 5: implicit Runge-Kutta integrator for stiff equations of motion.

Source: E. Hairer, G. Wanner, Solving Ordinary Differential Equations II, second edition, Springer 1996,
section IV.8. A step has three stages. Newton's iteration solves for all stages together, a linear system of 3
n unknowns. A transformation by the eigenvectors of A^-1, the inverse of the method's coefficient matrix,
splits it into one real and one complex system of n unknowns. The Jacobian of the rates by the state is exact,
from automatic differentiation, unless Python evaluates the equations; then finite differences are accurate
enough. `integrate_radau` makes all runs of a `Table`.

A state consists of the coordinates q and the velocities v; its rates are the time derivatives. A *state with
time and parameters* is one vector of length `system.inputs`: the state, the time, flags of constraint rows (1
for a redundant row that is left out) and of branches of forces, and parameters of the scene. During a run,
rows that are left out may be exchanged for rows in use (`newton_euler.integrators.row_exchange`), and forces
may change to another branch (`newton_euler.integrators.switches`). Each evaluation of the rates also
gives the *pivot ratio*: the distance to a singular configuration, where constraints become dependent; 1 far
away, 0 in it.

Functions marked `native` are compiled to machine code by `newton_euler.codegen`; they also run as plain
Python.
"""

from __future__ import annotations

from newton_euler.codegen.native import Vector, native
from newton_euler.integrators.lu import zero_block
from newton_euler.integrators.projection import (
    begin_adaptive,
    change_by_projection,
    is_error_of_step,
    project_end,
    project_rows,
)
from newton_euler.integrators.radau_stages import (
    MAX_NEWTON_STEPS,
    MAX_STEP_FACTOR,
    MIN_STEP_FACTOR,
    NODES,
    Radau,
    error_of_step,
    error_within,
    factor_matrices,
    first_step,
    interpolate_radau,
    prepare_dense,
    solve_stages,
)
from newton_euler.integrators.row_exchange import exchange_rows
from newton_euler.integrators.singular import UNSAFE_PIVOT_RATIO, UNSAFE_STEP_FACTOR, evaluate
from newton_euler.integrators.status import Status
from newton_euler.integrators.stepper import (
    EPS,
    HUGE,
    SHORT_STEP_FRACTION,
    Count,
    Equations,
    Table,
    before_step,
    copy_flags,
    finish_run,
    normalize_quaternions,
    start_run,
)
from newton_euler.integrators.switches import (
    NO_SWITCH,
    SAMPLES,
    SHORTEST_STEP_ULPS,
    Switches,
    begin_search,
    change_branch,
    end_step,
    excess,
    located_switch,
    narrow_search,
    next_fraction,
    take_sample,
)

SWITCH_TOLERANCE = 1e-7
"""Part of a step that may lie beyond a switch of a force. The branch of the step is smooth there, too, and
the error of the velocities is proportional to the square of this part."""

MAX_SWITCH_PLACEMENTS = 8
"""Largest number of times that a step is shortened to end at a switch of a force."""


@native
def interpolate_step(system: Equations, method: Radau, h: float, fraction: float) -> None:
    """Interpolate the state and the time `method.at` at a fraction of a step of size h, s."""
    n = system.n
    interpolate_radau(n, n, fraction, method.now, method.terms, method.at)
    method.at[n] = method.now[n] + fraction * h


@native
def locate_switch(system: Equations, switches: Switches, method: Radau, h: float) -> float:
    """Return the fraction of a step at which a branch of a force is first left, or `NO_SWITCH`.

    Args:
        method: record whose `terms` are those of the step.
        h: size of the step, s.
    """
    if switches.count == 0:
        return NO_SWITCH
    for number in range(SAMPLES + 1):
        interpolate_step(system, method, h, float(number) / SAMPLES)
        take_sample(switches, number, method.at, method.now)
    begin_search(switches)
    fraction = next_fraction(switches)
    while fraction <= 1.0:
        interpolate_step(system, method, h, fraction)
        narrow_search(switches, fraction, excess(switches, method.at, method.now))
        fraction = next_fraction(switches)
    return located_switch(switches)


@native
def run_radau(system: Equations, table: Table, states: Vector, method: Radau) -> Status:
    """Integrate one run, and write its states at all output times; return a status.

    The steps follow Hairer, Wanner, section IV.8, with projection onto the constraints after each step.
    Titles in comments are those of subsections of IV.8.

    Args:
        states: (count, n) states of the run at the output times, written.
        method: record whose state `now` is the start of the run.
    """
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
    projected = method.projected
    unprojected = method.w  # scratch: the transformed stages are not used between two steps
    # start: project the state, evaluate its rates, choose the first step (volume I, section II.4)
    for i in range(system.inputs):
        at[i] = now[i]
        projected[i] = now[i]
    status = begin_adaptive(system, table, states, now, slope)
    if status != Status.DONE:
        return status
    copy_flags(system, now, at)
    copy_flags(system, now, projected)
    stop = times[table.count - 1]
    h = min(first_step(n, method), stop - now[n])
    method.jacobian(now, method.matrix)
    next_row = 1  # index of the next output time
    is_jacobian_current = 1  # 1 if the Jacobian is that of the present state
    is_factored = 0  # 1 if the LU factors are those of the present Jacobian and step size
    before_h = 0.0  # size of the step before, s; 0 if there is none
    before_error = 0.0  # error of the step before, in units of the tolerance
    # changes of states by projection, in units of the tolerance; a change that a shorter try does not reduce
    # is round-off, and is accepted
    change_before = HUGE  # change for which the last try of this step was rejected, if any
    change_noise = 0.0  # change in the step before if it was 1 or more, so round-off; else 0
    rejected = 0  # 1 if the last try of this step was rejected for its error
    m = 0  # size of the leading block of zeros of the Jacobian: rates of q that are elements of v
    placements = 0  # number of times that this step was shortened to end at a switch of a force
    for i in range(3 * n):
        z[i] = 0.0
    while next_row < table.count:
        # clip the last step to the end of the run
        status = before_step(system, table, method.max_steps, h, now)
        if status != Status.DONE:
            return status
        if now[n] + h > stop or stop - now[n] - h < 1e-3 * h:
            h = stop - now[n]
            is_factored = 0
        # factor the matrices of the linear systems, gamma/h - J and (alpha + i beta)/h - J
        if is_factored == 0:
            m = zero_block(n, method.matrix)
            if factor_matrices(n, m, h, method) == 1:
                counts[Count.REJECTED] += 1.0
                h = 0.5 * h
                continue
            is_factored = 1
        # predict the stages by the collocation polynomial of the step before ("Starting values")
        if before_h > 0.0:
            for s in range(3):
                interpolate_radau(n, n, 1.0 + NODES[s] * h / before_h, method.before, terms, at)
                for i in range(n):
                    z[n * s + i] = at[i] - now[i]
        else:
            for i in range(3 * n):
                z[i] = 0.0
        # solve for the stages by simplified Newton iterations
        newton_steps = solve_stages(system, method, m, h)
        pivot_ratio = min(min(f[n], f[2 * n + 1]), f[3 * n + 2])
        # reject a step with unsafe accelerations (measure 3 of `newton_euler.integrators.singular`)
        if newton_steps >= 0 and pivot_ratio < UNSAFE_PIVOT_RATIO and slope[n] >= UNSAFE_PIVOT_RATIO:
            counts[Count.REJECTED] += 1.0
            h = UNSAFE_STEP_FACTOR * h
            is_factored = 0
            continue
        # if Newton's iteration fails, try a new Jacobian, then half the step
        if newton_steps < 0:
            counts[Count.REJECTED] += 1.0
            if is_jacobian_current == 0:
                method.jacobian(now, method.matrix)
                is_jacobian_current = 1
            else:
                h = 0.5 * h
            is_factored = 0
            continue
        # error estimate of order 3; in the first step and after a rejection, a second estimate from a
        # corrected start, because stiff components exaggerate the first one ("Step size selection")
        convergence = change[3 * n]
        error = error_of_step(n, m, h, method, slope)
        if error > 1.0 and (rejected == 1 or counts[Count.STEPS] == 0.0):
            for i in range(n):
                at[i] = now[i] + change[i]
            at[n] = now[n]
            if evaluate(system, at, f) == Status.DONE:
                error = error_of_step(n, m, h, method, f)
        # outputs within the step need the error of the interpolation, too
        if before_h > 0.0 and times[next_row] < now[n] + h and error <= 1.0 and n > 0:
            error = max(error, error_within(n, h, before_h, method))
        # factor for the next step: by the error, and by the predictive controller of Gustafsson
        safety = 0.9 * (2.0 * MAX_NEWTON_STEPS + 1.0) / (2.0 * MAX_NEWTON_STEPS + newton_steps)
        factor = MAX_STEP_FACTOR
        if error > 0.0:
            factor = error**-0.25
            if before_h > 0.0 and before_error > 0.0 and error <= 1.0:
                factor = min(factor, factor * h / before_h * (before_error / error) ** 0.25)
        # reject the step for its error
        if not error <= 1.0:
            counts[Count.REJECTED] += 1.0
            h = h * max(MIN_STEP_FACTOR, safety * factor) if error < HUGE else MIN_STEP_FACTOR * h
            is_factored = 0
            rejected = 1
            continue
        # project the end; its change by projection is the part of the error that violates the constraints.
        # The argument 0 chooses the sparse form of projection, not the dense one for singular configurations
        for i in range(n):
            f[i] = now[i] + z[2 * n + i]
        f[n] = now[n] + h
        status = project_end(system, 0, f, projected, unprojected)
        projection_change = 0.0
        if status == Status.DONE and system.projecting == 1:
            projection_change = change_by_projection(system, unprojected, projected, rtol, atol)
        if status != Status.DONE or is_error_of_step(projection_change, change_before, change_noise) == 1:
            counts[Count.REJECTED] += 1.0
            if status != Status.DONE and h < SHORT_STEP_FRACTION * (stop - times[0]):
                return status
            h = h * (
                max(MIN_STEP_FACTOR, safety * projection_change**-0.25)
                if status == Status.DONE
                else MIN_STEP_FACTOR
            )
            change_before = projection_change if status == Status.DONE else HUGE
            is_factored = 0
            rejected = 1
            continue
        # repeat a step in which a branch of a force is left, so that the step ends there: its end is more
        # accurate than the interpolation within
        prepare_dense(n, z, terms)
        fraction = locate_switch(system, system.switches, method, h)
        if fraction < 1.0 - SWITCH_TOLERANCE and placements < MAX_SWITCH_PLACEMENTS:
            counts[Count.REJECTED] += 1.0
            placements += 1
            is_factored = 0
            before_h = 0.0  # `terms` are no longer those of the step before
            if fraction * h > SHORTEST_STEP_ULPS * EPS * max(abs(now[n]), h):
                h = fraction * h
                continue
            # the switch is at the start of the step
            change_branch(system.switches, now)
            copy_flags(system, now, at)
            copy_flags(system, now, projected)
            status = evaluate(system, now, slope)
            if status != Status.DONE:
                return status
            method.jacobian(now, method.matrix)
            is_jacobian_current = 1
            h = min(first_step(n, method), h)
            continue
        placements = 0
        # accept the step, and interpolate and project (again in the sparse form, 0) the outputs within it
        change_before = HUGE
        change_noise = projection_change if projection_change >= 1.0 else 0.0
        counts[Count.STEPS] += 1.0
        rejected = 0
        factor = min(MAX_STEP_FACTOR, max(MIN_STEP_FACTOR, safety * factor))
        first_row = next_row
        while next_row < table.count and times[next_row] <= now[n] + h:
            state = states[n * next_row :]
            interpolate_radau(table.output_state_size, n, (times[next_row] - now[n]) / h, now, terms, state)
            normalize_quaternions(system, state, state)
            next_row += 1
        status = project_rows(system, table, states, first_row, next_row, 0, at)
        if status != Status.DONE:
            return status
        # move to the end of the step; if an angle is reduced by a revolution, its start is reduced, too,
        # because the prediction of the next step continues the polynomial
        for i in range(n):
            revolution = unprojected[i] - (now[i] + z[2 * n + i])
            method.before[i] = now[i] + revolution
            now[i] = projected[i]
        now[n] = now[n] + h
        # exchange constraint rows, and evaluate the rates
        changed = exchange_rows(system.exchange, now)
        if end_step(system.switches, fraction, now) == 1:
            changed = 1
        if status == Status.DONE:
            status = evaluate(system, now, slope)
        if status != Status.DONE:
            return status
        # keep the Jacobian while Newton's iteration converges fast, and keep step size and factors if the
        # next step would be at most 20 % longer ("Step size selection")
        before_h = h
        before_error = max(error, 1e-2)  # the lower limit is that of the authors' code
        is_jacobian_current = 0
        if changed == 1:
            copy_flags(system, now, at)
            copy_flags(system, now, projected)
        if changed == 1 or (newton_steps > 2 and convergence > 1e-3):
            method.jacobian(now, method.matrix)
            is_jacobian_current = 1
            is_factored = 0
        if is_jacobian_current == 1 or factor > 1.2 or factor < 1.0:
            h = h * factor
            is_factored = 0
        # restart behind a switch
        if fraction <= 1.0:
            h = min(first_step(n, method), h)
            before_h = 0.0
            before_error = 0.0
    return Status.DONE


@native
def integrate_radau(system: Equations, table: Table, method: Radau) -> None:
    """Integrate all runs of the table, one after the other."""
    run = int(table.first[0])
    while run < table.runs:
        start_run(system, table, run, method.now)
        status = run_radau(system, table, table.states[system.n * table.count * run :], method)
        run = finish_run(system, table, run, status, method.now)
