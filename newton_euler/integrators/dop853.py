"""DOP853: explicit Runge-Kutta integrator of order 8 with error control and interpolated outputs.

The method of Dormand and Prince with error estimates of orders 5 and 3 and dense output (interpolation within
the step) of order 7: E. Hairer, S. P. Norsett, G. Wanner, Solving Ordinary Differential Equations I, second
edition, Springer 1993, section II.5 (step) and II.6 (dense output). `integrate_dop853` makes all runs of a
`Table`. Each step adds three things to the book's method: projection onto the constraints, special treatment
of singular configurations (`newton_euler.integrators.singular`), and a check for round-off.

A state consists of the coordinates q and the velocities v; its rates are the time derivatives. A *state with
time and parameters* is one vector (inputs,): the state, the time, flags of redundant constraint rows (1 for a
row that is left out) and of branches of forces (`newton_euler.integrators.switches`), and parameters of the
scene (`newton_euler.integrators.stepper`). Each evaluation of
the rates also gives the *pivot ratio*: the distance to a singular configuration, where constraints become
dependent; 1 far away, 0 in it.

Functions marked `native` are compiled to machine code by `newton_euler.codegen`; they also run as plain
Python. Native code may integrate several runs at once, one in each lane of the vector registers. A `Vector`
has separate elements for each lane; all lanes share the elements of a `Shared` array.
"""

from __future__ import annotations

from math import sqrt

from newton_euler.codegen.native import Vector, native
from newton_euler.integrators.dense_projection import Closing, close
from newton_euler.integrators.dop853_stages import (
    ERROR_EXPONENT,
    FAILED_STEP_ERROR,
    MAX_STEP_FACTOR,
    MIN_STEP_FACTOR,
    SAFETY,
    Control,
    Dop853,
    error_norm,
    evaluate_stage,
    first_step,
    interpolate,
    store_step,
)
from newton_euler.integrators.dop853_switches import evaluate_dense, locate_switch, sample_step
from newton_euler.integrators.dop853_tableau import (
    ERROR_3,
    ERROR_5,
    STAGES,
)
from newton_euler.integrators.projection import (
    begin_adaptive,
    change_by_projection,
    finish_step,
    is_error_of_step,
    project_end,
    project_rows,
)
from newton_euler.integrators.round_off import (
    ROUGH_ERROR_RATIO,
    ROUND_OFF_MARGIN,
    STEPS_TO_NEXT_MEASUREMENT,
    measure_round_off,
)
from newton_euler.integrators.row_exchange import exchange_rows
from newton_euler.integrators.singular import (
    MAX_PLACEMENT_TRIES,
    NEAR_PIVOT_RATIO,
    UNSAFE_PIVOT_RATIO,
    UNSAFE_STEP_FACTOR,
    crossing_factor,
    evaluate,
)
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
    write_row,
)
from newton_euler.integrators.switches import (
    NO_SWITCH,
    SHORTEST_STEP_ULPS,
    end_step,
)


@native
def error_on_constraints(n: int, h: float, closing: Closing, method: Dop853) -> float:
    """Estimate the error of a step between projected states, for steps near a singular configuration.

    There the constraint forces have few correct digits. Their errors move the state off the constraints, and
    shorter steps do not help. So the end of the step and the two embedded solutions of lower order are
    projected first, and the projections are compared. Rows 13 to 15 of k receive the three projected states.

    Args:
        n: length of the state.
        h: size of the step, s.
        closing: projection near singular configurations (`newton_euler.integrators.dense_projection`).

    Returns:
        error in units of the tolerance, or `FAILED_STEP_ERROR` if a projection fails.
    """
    row = n + 1
    at = method.at
    end = method.end
    k = method.k
    # project the end of the step, and the solutions that differ from it by the estimates of orders 5 and 3;
    # element n of each result is positive if the projection succeeded
    close(closing, end, k[13 * row :])
    if not k[13 * row + n] > 0.0:
        return FAILED_STEP_ERROR
    at[n] = end[n]
    for i in range(n):
        five = 0.0
        for j in range(STAGES + 1):
            five += ERROR_5[j] * k[row * j + i]
        at[i] = end[i] + h * five
    close(closing, at, k[14 * row :])
    for i in range(n):
        three = 0.0
        for j in range(STAGES + 1):
            three += ERROR_3[j] * k[row * j + i]
        at[i] = end[i] + h * three
    close(closing, at, k[15 * row :])
    if not min(k[14 * row + n], k[15 * row + n]) > 0.0:
        return FAILED_STEP_ERROR
    # combine the differences of the projected states as `error_norm` does
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
def write_outputs(
    system: Equations, table: Table, states: Vector, method: Dop853, near: int, reach: float
) -> Status:
    """Write the states at the output times that an accepted step has reached; return a status.

    The additional stages of the dense output must have been evaluated.

    Args:
        states: (count, n) states of the run at the output times.
        near: 1 for a step near a singular configuration, whose outputs are projected by
            `newton_euler.integrators.dense_projection` (with full matrices, not sparse ones); else 0.
        reach: part of the step that counts, s, from its start.
    """
    n = system.n
    now = method.now
    times = table.times
    h = method.control[Control.STEP]
    # interpolate all output times within the step, then project these states together; projection with
    # full matrices and the state at the end of the run need velocities, too
    first_row = int(method.control[Control.NEXT_ROW])
    row = first_row
    while row < table.count and times[row] <= now[n] + reach:
        state = states[n * row :]
        count = n if near == 1 or method.control[Control.OVERSHOOTS_END] == 1.0 else table.output_state_size
        interpolate(count, n, (times[row] - now[n]) / h, method, state)
        normalize_quaternions(system, state, state)
        row += 1
    method.control[Control.NEXT_ROW] = float(row)
    return project_rows(system, table, states, first_row, row, near, method.at)


@native
def finish_at_rest(system: Equations, table: Table, states: Vector, method: Dop853) -> None:
    """End the run if all rates are below `method.rest`: write the present state to all remaining outputs.

    Args:
        states: (count, n) states of the run at the output times.
    """
    n = system.n
    largest = 0.0
    for i in range(system.n):
        largest = max(largest, abs(method.k[i]))
    if largest < method.rest:
        for row in range(int(method.control[Control.NEXT_ROW]), table.count):
            write_row(system, states, row, method.now)
        method.now[n] = table.times[table.count - 1]
        method.control[Control.NEXT_ROW] = float(table.count)


@native
def begin_dop853(system: Equations, table: Table, states: Vector, method: Dop853) -> Status:
    """Begin a run at the state `method.now`: project it, write the first output, choose the first step.

    The result is `Status.DONE` or the reason why the run cannot start.

    Args:
        states: (count, n) states of the run at the output times.
    """
    now = method.now
    for i in range(system.inputs):
        method.at[i] = now[i]
        method.end[i] = now[i]
        method.projected[i] = now[i]
    status = begin_adaptive(system, table, states, now, method.k)
    if status != Status.DONE:
        return status
    copy_flags(system, now, method.at)
    copy_flags(system, now, method.end)
    copy_flags(system, now, method.projected)
    for i in range(system.n):
        method.round_off[i] = 0.0
    method.control[Control.NEXT_ROW] = 1.0
    finish_at_rest(system, table, states, method)
    if method.control[Control.NEXT_ROW] < table.count:
        method.control[Control.STEP] = first_step(
            system, method, table.times[table.count - 1] - now[system.n]
        )
    method.control[Control.MAX_GROWTH] = MAX_STEP_FACTOR
    method.control[Control.PLACEMENT_TRIES] = 0.0
    method.control[Control.OVERSHOOTS_END] = 0.0
    method.control[Control.STARTS_SINGULAR] = 1.0
    method.control[Control.ROUND_OFF_MARK] = 0.0
    method.control[Control.PROJECTION_CHANGE] = HUGE
    method.control[Control.PROJECTION_NOISE] = 0.0
    return Status.DONE


@native
def step_dop853(system: Equations, table: Table, states: Vector, method: Dop853) -> Status:
    """Try a step (Hairer, Norsett, Wanner, sections II.4 to II.6); return a status.

    If the step is rejected, the state stays as it is and only the size of the next try changes. The status is
    `Status.DONE` for an accepted and for a rejected step. "Measure 3" to "measure 6" in comments are those of
    the list in `newton_euler.integrators.singular`.

    Args:
        states: (count, n) states of the run at the output times.
    """
    n = system.n
    row = n + 1
    now = method.now
    end = method.end
    k = method.k
    counts = system.counts
    control = method.control
    stop = table.times[table.count - 1]
    # step size: the last step ends with the run, unless steps may go beyond the end
    status = before_step(system, table, method.max_steps, control[Control.STEP], now)
    if status != Status.DONE:
        return status
    control[Control.UNCLIPPED_STEP] = control[Control.STEP]
    if (
        control[Control.OVERSHOOTS_END] == 0.0
        and stop - now[n] - control[Control.STEP] < 1e-3 * control[Control.STEP]
    ):
        control[Control.STEP] = stop - now[n]
    h = control[Control.STEP]
    # the other stages; the last one is evaluated at the end of the step, as the first of the next step
    pivot_ratio = HUGE
    for s in range(1, STAGES + 1):
        status = evaluate_stage(system, method, s, h, end if s == STAGES else method.at)
        if status != Status.DONE:
            break
        pivot_ratio = min(pivot_ratio, k[row * s + n])
    # reject a clipped step near a singular configuration: no step can end there, so the last step goes beyond
    # the end of the run, and the end is interpolated (measure 5)
    if system.projecting == 1 and pivot_ratio < NEAR_PIVOT_RATIO and control[Control.UNCLIPPED_STEP] > h:
        counts[Count.REJECTED] += 1.0
        control[Control.OVERSHOOTS_END] = 1.0
        control[Control.STEP] = control[Control.UNCLIPPED_STEP]
        return Status.DONE
    # reject a step with unsafe accelerations, once the run has left a singular start (measure 3)
    if k[n] >= UNSAFE_PIVOT_RATIO:
        control[Control.STARTS_SINGULAR] = 0.0
    if pivot_ratio < UNSAFE_PIVOT_RATIO and control[Control.STARTS_SINGULAR] == 0.0:
        counts[Count.REJECTED] += 1.0
        control[Control.STEP] = UNSAFE_STEP_FACTOR * h
        return Status.DONE
    # error estimate from the embedded formulas of orders 5 and 3
    pivot_ratio = min(pivot_ratio, k[n])
    error = FAILED_STEP_ERROR
    if status == Status.DONE:
        error = error_norm(system, h, 0.0, method)
        end[n] = now[n] + h
    excess = error  # error without regard to round-off
    # if the error estimate looks like round-off, measure the round-off of the rates and add it to the
    # tolerance: a shorter step would not reduce it (`newton_euler.integrators.round_off`)
    may_be_round_off = 0
    if control[Control.ERROR_RATIO] < ROUGH_ERROR_RATIO or (
        control[Control.ROUND_OFF_MARK] == 1.0 and error >= 1.0
    ):
        may_be_round_off = 1
    if may_be_round_off == 1 and control[Control.ROUND_OFF_MARK] < 0.0:
        may_be_round_off = 0
        control[Control.ROUND_OFF_MARK] = control[Control.ROUND_OFF_MARK] + 1.0
    if status == Status.DONE and may_be_round_off == 1 and pivot_ratio >= NEAR_PIVOT_RATIO:
        scratch = k[row * (STAGES + 1) :]
        if (
            measure_round_off(system, h, now, method.units, method.at, k, scratch, method.round_off)
            == Status.DONE
        ):
            error = min(error, error_norm(system, h, ROUND_OFF_MARGIN, method))
        if error < 0.5 * excess:
            control[Control.ROUND_OFF_MARK] = 1.0
        else:
            control[Control.ROUND_OFF_MARK] = (
                0.0 if control[Control.ROUND_OFF_MARK] == 1.0 else 0.0 - STEPS_TO_NEXT_MEASUREMENT
            )
    # near a singular configuration, the error is the error after projection (measure 6)
    near = 0
    if system.projecting == 1 and pivot_ratio < NEAR_PIVOT_RATIO and status == Status.DONE:
        near = 1
        error = min(error, error_on_constraints(n, h, system.closing, method))
    # and the step is shortened so that the singular configuration lies between two stages (measure 4); the
    # pivot ratios are those at the start, at stage 9 (0.6 of the step) and at the end
    if near == 1 and control[Control.PLACEMENT_TRIES] < MAX_PLACEMENT_TRIES:
        error_factor = SAFETY * error**ERROR_EXPONENT if error > 1.0 else 1.0
        placement_factor = crossing_factor(k[n], k[row * 9 + n], k[row * STAGES + n], error_factor)
        if placement_factor < 1.0:
            counts[Count.REJECTED] += 1.0
            control[Control.PLACEMENT_TRIES] += 1.0
            control[Control.STEP] = placement_factor * h
            return Status.DONE
    # reject the step for its error (section II.4); a step whose stages cannot be evaluated stops the run once
    # it is very short
    if not error < 1.0:
        counts[Count.REJECTED] += 1.0
        if status != Status.DONE and h < SHORT_STEP_FRACTION * (stop - table.times[0]):
            return status
        control[Control.STEP] = h * max(MIN_STEP_FACTOR, SAFETY * error**ERROR_EXPONENT)
        control[Control.MAX_GROWTH] = 1.0
        return Status.DONE
    # project the end; its change by projection is the part of the error that violates the constraints. A step
    # is rejected for a large change and for a projection that fails, which stops the run if the step is very
    # short. `method.at` receives the end before projection
    status = project_end(system, near, end, method.projected, method.at)
    projection_change = 0.0
    if status != Status.DONE:
        projection_change = FAILED_STEP_ERROR
    elif near == 0 and system.projecting == 1:
        projection_change = change_by_projection(
            system, method.at, method.projected, method.rtol, method.atol
        )
    if (
        status != Status.DONE
        or is_error_of_step(
            projection_change, control[Control.PROJECTION_CHANGE], control[Control.PROJECTION_NOISE]
        )
        == 1
    ):
        counts[Count.REJECTED] += 1.0
        if status != Status.DONE and h < SHORT_STEP_FRACTION * (stop - table.times[0]):
            return status
        control[Control.STEP] = h * max(MIN_STEP_FACTOR, SAFETY * projection_change**ERROR_EXPONENT)
        control[Control.MAX_GROWTH] = 1.0
        control[Control.PROJECTION_CHANGE] = projection_change
        return Status.DONE
    # accept the step: record, count and write the outputs that the step has passed
    control[Control.PROJECTION_CHANGE] = HUGE
    control[Control.PROJECTION_NOISE] = projection_change if projection_change >= 1.0 else 0.0
    # end the step where a branch of a force is left; `reach` is the part of the step that counts
    reach = h
    fraction = NO_SWITCH
    dense = 0
    if sample_step(system, system.switches, method) == 1:
        status = evaluate_dense(system, method)
        if status != Status.DONE:
            return status
        dense = 1
        fraction = locate_switch(system, system.switches, method)
        if stop - now[n] - fraction * h < SHORTEST_STEP_ULPS * EPS * abs(stop):
            fraction = NO_SWITCH  # the run ends with the branch
        if fraction <= 1.0:
            reach = fraction * h
    store_step(system, reach, method, int(counts[Count.STEPS]))
    counts[Count.STEPS] += 1.0
    if near == 0 and excess >= 1.0:
        counts[Count.ROUND_OFF_EXCESS] = max(counts[Count.ROUND_OFF_EXCESS], excess)
    control[Control.PLACEMENT_TRIES] = 0.0
    if table.times[int(control[Control.NEXT_ROW])] <= now[n] + reach:
        if dense == 0:
            status = evaluate_dense(system, method)
        if status == Status.DONE:
            status = write_outputs(system, table, states, method, near, reach)
        if status != Status.DONE:
            return status
    # move to the end of the step, or of the run if the step went beyond it: the interpolated last output,
    # which `finish_step` normalizes and projects
    if fraction <= 1.0:
        interpolate(n, n, fraction, method, method.projected)
    for i in range(n):
        now[i] = method.projected[i]
    now[n] = now[n] + reach
    if fraction <= 1.0:
        status = finish_step(system, near, now, end)
    if control[Control.OVERSHOOTS_END] == 1.0 and now[n] > stop:
        for i in range(n):
            now[i] = states[n * (table.count - 1) + i]
        now[n] = stop
        status = finish_step(system, near, now, end)
    # exchange constraint rows, and evaluate the rates if the state or the rows have changed
    changed = exchange_rows(system.exchange, now)
    if end_step(system.switches, fraction, now) == 1:
        changed = 1
    if changed == 1:
        copy_flags(system, now, method.at)
        copy_flags(system, now, end)
        copy_flags(system, now, method.projected)
    if status == Status.DONE and (system.projecting == 1 or changed == 1):
        status = evaluate(system, now, k)
    if status != Status.DONE:
        return status
    if system.projecting == 0 and changed == 0:
        for i in range(n + 1):
            k[i] = k[row * STAGES + i]
    # size of the next step (section II.4, equation 4.13)
    factor = (
        MAX_STEP_FACTOR if error == 0.0 else min(control[Control.MAX_GROWTH], SAFETY * error**ERROR_EXPONENT)
    )
    control[Control.STEP] = h * max(MIN_STEP_FACTOR, factor)
    if fraction <= 1.0 and stop > now[n]:
        control[Control.STEP] = first_step(system, method, stop - now[n])
    control[Control.MAX_GROWTH] = MAX_STEP_FACTOR
    finish_at_rest(system, table, states, method)
    return Status.DONE


@native
def integrate_dop853(system: Equations, table: Table, method: Dop853) -> None:
    """Integrate all runs of the table, one after the other.

    In compiled code, each lane starts its next run as soon as its run has ended. Therefore one loop takes
    single steps.
    """
    run = int(table.first[0])
    fresh = 1  # 1 if the run has not begun
    while run < table.runs:
        states = table.states[system.n * table.count * run :]
        status = Status.DONE
        if fresh == 1:
            start_run(system, table, run, method.now)
            status = begin_dop853(system, table, states, method)
            fresh = 0
        if status == Status.DONE and method.control[Control.NEXT_ROW] < table.count:
            status = step_dop853(system, table, states, method)
        if status != Status.DONE or method.control[Control.NEXT_ROW] >= table.count:
            run = finish_run(system, table, run, status, method.now)
            fresh = 1
