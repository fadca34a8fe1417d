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

from dataclasses import dataclass
from enum import IntEnum
from math import sqrt

from newton_euler.codegen.native import Record, Shared, Vector, native
from newton_euler.integrators.dense_projection import Closing, close
from newton_euler.integrators.dop853_tableau import (
    COUPLING,
    DENSE,
    ERROR_3,
    ERROR_5,
    NODES,
    SECOND_NONZERO,
    SECOND_NONZERO_OF_STEP,
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
    MAX_ROOT_STEPS,
    NO_SWITCH,
    SAMPLES,
    SHORTEST_STEP_ULPS,
    Search,
    Switches,
    begin_search,
    change_branch,
    excess,
    first_positive_sample,
    locate_maximum,
    may_switch,
    narrow_search,
    next_fraction,
    take_sample,
)

MIN_FIRST_STEP_ULPS = 1e3
"""Smallest first step, in units of the spacing of double-precision numbers near the start time."""

SAFETY, MIN_STEP_FACTOR, MAX_STEP_FACTOR = 0.9, 0.2, 10.0
"""Step-size control: safety factor, and the smallest and largest ratio of a step to the one before it. The
values are those of SciPy."""

ERROR_EXPONENT = -1.0 / 8.0
"""Exponent of the error estimate in the step-size control: -1 / order."""


class Control(IntEnum):
    """Indices into `Dop853.control`, the variables of the step control that a run keeps between steps.

    Attributes:
        STEP: size of the next step, s.
        MAX_GROWTH: largest allowed ratio of the step after the next one to the next one.
        PLACEMENT_TRIES: number of times that this step was shortened so that a singular configuration lies
            between two of its stages.
        NEXT_ROW: index of the output time that is written next.
        UNCLIPPED_STEP: size of the step, s, before it was shortened to end with the run.
        OVERSHOOTS_END: 1 if the last step may go beyond the end of the run, else 0.
        STARTS_SINGULAR: 1 until the run has left a singular configuration in which it started, then 0.
        ERROR_RATIO: ratio of the squared error estimates of orders 3 and 5 of the last step.
        ROUND_OFF_MARK: 1 if round-off dominated the error estimate in the last measurement, 0 if not. If
            negative, minus the number of steps with suspicious error estimates to skip before the next
            measurement.
        PROJECTION_CHANGE: change of the state by projection, in units of the tolerance, if the last try of
            this step was rejected for this change; else `HUGE`.
        PROJECTION_NOISE: change of the state by projection in the last accepted step, in units of the
            tolerance, if it was 1 or more; else 0.
    """

    STEP = 0
    MAX_GROWTH = 1
    PLACEMENT_TRIES = 2
    NEXT_ROW = 3
    UNCLIPPED_STEP = 4
    OVERSHOOTS_END = 5
    STARTS_SINGULAR = 6
    ERROR_RATIO = 7
    ROUND_OFF_MARK = 8
    PROJECTION_CHANGE = 9
    PROJECTION_NOISE = 10


CONTROLS = len(Control)
"""Length of the vector `Dop853.control`."""

FAILED_STEP_ERROR = 1e10
"""Error, in units of the tolerance, of a step that could not be evaluated or projected: it is rejected."""


@dataclass(frozen=True, eq=False)
class Dop853(Record):
    """Options of DOP853 and its working memory for one run.

    Attributes:
        rtol, atol: relative and absolute tolerance of the error of a step, for each component.
        near_rtol, near_atol: the same near a singular configuration; they may be larger.
        max_steps: largest number of steps of a run.
        rest: threshold of all rates, SI, below which the mechanism counts as at rest until the end of the
            run; 0 turns this off.
        units: (n,) natural magnitudes of the state, SI. An element that is smaller than its natural magnitude
            is assumed to have the round-off of this magnitude.
        now: state with time and parameters at the start of the step.
        at: state with time and parameters at a stage of the step.
        end: state with time and parameters at the end of the step.
        projected: the end of the step after projection onto the constraints.
        k: (16, n + 1) rates and pivot ratio of each stage. Stage 12 is at the end of the step; stages 13 to
            15 are for dense output only, and their rows are scratch before.
        terms: (7, n) coefficients of the dense output.
        room: number of steps, from the first step on, that are stored in `steps`; 0 for none.
        steps: (room, n + 2 + flags) state, time and flags at the start of each stored step, and its size, s.
        round_off: (n,) round-off of the rates, SI, as measured so far.
        control: (CONTROLS,) variables of the step control, see `Control`.
    """

    rtol: float
    atol: float
    near_rtol: float
    near_atol: float
    max_steps: int
    rest: float
    units: Shared
    now: Vector
    at: Vector
    end: Vector
    projected: Vector
    k: Vector
    terms: Vector
    room: int
    steps: Vector
    round_off: Vector
    control: Vector


@native
def store_step(system: Equations, h: float, method: Dop853, number: int) -> None:
    """Store the start and the size of step number `number`, if there is room for it.

    Args:
        h: size of the step, s.
        number: number of the step in the run, from 0.
    """
    count = system.n + 1 + system.flags  # length of a state with time and flags
    if number < method.room:
        stored = method.steps[(count + 1) * number :]
        for i in range(count):
            stored[i] = method.now[i]
        stored[count] = h


@native
def advance(s: int, h: float, count: int, row: int, x: Vector, k: Vector, at: Vector) -> None:
    """Compute the state of stage s from the rates of the earlier stages.

    Args:
        s: number of the stage, 1 to 15.
        h: size of the step, s.
        count: length of the state.
        row: length of a row of k.
        x: (count,) state at the start of the step.
        k: rates of the earlier stages, one stage in each row.
        at: (count,) state of the stage, written.
    """
    # the nonzero weights are those of stage 0 and of the stages from `second` on
    weights = COUPLING[16 * s :]
    second = int(SECOND_NONZERO[s])
    part = (count + 3) // 4
    # sums for four elements of the state at a time, one of each quarter: additions within a sum have to wait
    # for each other, those of different sums do not. Where a quarter has no element left, i0 is repeated
    for i0 in range(part):
        i1 = i0 + part if i0 + part < count else i0
        i2 = i0 + 2 * part if i0 + 2 * part < count else i0
        i3 = i0 + 3 * part if i0 + 3 * part < count else i0
        # "0.0 +" starts every sum at zero, so that a product -0.0 gives the sum 0.0
        change0 = 0.0 + weights[0] * k[i0]
        change1 = 0.0 + weights[0] * k[i1]
        change2 = 0.0 + weights[0] * k[i2]
        change3 = 0.0 + weights[0] * k[i3]
        for j in range(second, s):
            change0 += weights[j] * k[row * j + i0]
            change1 += weights[j] * k[row * j + i1]
            change2 += weights[j] * k[row * j + i2]
            change3 += weights[j] * k[row * j + i3]
        # the state is added last, because adding small changes to it one by one would lose digits
        at[i0] = x[i0] + h * change0
        at[i1] = x[i1] + h * change1
        at[i2] = x[i2] + h * change2
        at[i3] = x[i3] + h * change3


@native
def evaluate_stage(system: Equations, method: Dop853, s: int, h: float, at: Vector) -> Status:
    """Evaluate stage s of a step of size h, s: write its state to `at` and its rates to row s of k."""
    n = system.n
    row = n + 1
    advance(s, h, n, row, method.now, method.k, at)
    at[n] = method.now[n] + NODES[s] * h
    return evaluate(system, at, method.k[row * s :])


@native
def error_norm(system: Equations, h: float, margin: float, method: Dop853) -> float:
    """Estimate the error of a step (II.5): the root mean square of the components in units of their scales.

    The scale of a component is its tolerance, plus `margin` times the change over the step that round-off of
    its rate causes. The function also writes `Control.ERROR_RATIO`.

    Args:
        h: size of the step, s; the rates of all stages are in `method.k`.
        margin: factor of the round-off, 0 to ignore it.
    """
    row = system.n + 1
    now = method.now
    end = method.end
    k = method.k
    fifth = 0.0
    third = 0.0
    for i in range(system.n):
        scale = method.atol + method.rtol * max(abs(now[i]), abs(end[i]))
        scale += margin * h * method.round_off[i]
        five = 0.0 + ERROR_5[0] * k[i]
        three = 0.0 + ERROR_3[0] * k[i]
        for j in range(SECOND_NONZERO_OF_STEP, STAGES):
            five += ERROR_5[j] * k[row * j + i]
            three += ERROR_3[j] * k[row * j + i]
        fifth += (five / scale) * (five / scale)
        third += (three / scale) * (three / scale)
    if fifth == 0.0 and third == 0.0:
        method.control[Control.ERROR_RATIO] = HUGE
        return 0.0
    method.control[Control.ERROR_RATIO] = third / fifth if fifth > 0.0 else HUGE
    return h * fifth / sqrt((fifth + 0.01 * third) * system.n)


@native
def prepare_dense(
    h: float, count: int, row: int, stride: int, start: Vector, end: Vector, k: Vector, terms: Vector
) -> None:
    """Compute the seven terms of the dense output of a step (II.6) from the rates of all sixteen stages.

    Args:
        h: size of the step, s.
        count: length of the state.
        row: length of a row of k.
        stride: distance between two terms in `terms`.
        start, end: (count,) states at the start and at the end of the step.
        k: rates of the stages, one stage in each row.
        terms: the seven terms, written; may be the same memory as k.
    """
    for i in range(count):
        change = end[i] - start[i]
        first = h * k[i] - change
        second = 2.0 * change - h * (k[row * STAGES + i] + k[i])
        third = 0.0 + DENSE[0] * k[i]
        fourth = 0.0 + DENSE[16] * k[i]
        fifth = 0.0 + DENSE[32] * k[i]
        sixth = 0.0 + DENSE[48] * k[i]
        for j in range(SECOND_NONZERO_OF_STEP, 16):
            third += DENSE[j] * k[row * j + i]
            fourth += DENSE[16 + j] * k[row * j + i]
            fifth += DENSE[32 + j] * k[row * j + i]
            sixth += DENSE[48 + j] * k[row * j + i]
        terms[i] = change
        terms[stride + i] = first
        terms[2 * stride + i] = second
        terms[3 * stride + i] = h * third
        terms[4 * stride + i] = h * fourth
        terms[5 * stride + i] = h * fifth
        terms[6 * stride + i] = h * sixth


@native
def interpolate(count: int, n: int, theta: float, method: Dop853, y: Vector) -> None:
    """Evaluate the dense output (II.6) within a step from the coefficients `method.terms`.

    The polynomial is evaluated with products of theta and 1 - theta, as in the book.

    Args:
        count: number of elements to interpolate, the first ones of the state.
        n: length of the state.
        theta: time in the step, as a fraction 0 to 1.
        y: (n,) the interpolated state, written.
    """
    terms = method.terms
    left = 1.0 - theta
    w1 = theta * left
    w2 = theta * w1
    w3 = left * w2
    w4 = theta * w3
    w5 = left * w4
    w6 = theta * w5
    for i in range(count):
        low = theta * terms[i] + w1 * terms[n + i] + w2 * terms[2 * n + i] + w3 * terms[3 * n + i]
        high = w4 * terms[4 * n + i] + w5 * terms[5 * n + i] + w6 * terms[6 * n + i]
        y[i] = method.now[i] + (low + high)


@native
def first_step(system: Equations, method: Dop853, span: float) -> float:
    """Choose the size of the first step, s (Hairer, Norsett, Wanner, section II.4, "Starting step size").

    Row 0 of `method.k` holds the rates at the start. Names and numbers are those of the book's algorithm.

    Args:
        span: duration of the run, s, the largest possible step.
    """
    n = system.n
    now = method.now
    at = method.at
    k = method.k
    # guess from the norms of the state (d0) and of its rates (d1)
    d0 = 0.0
    d1 = 0.0
    for i in range(n):
        scale = method.atol + method.rtol * abs(now[i])
        d0 += (now[i] / scale) * (now[i] / scale)
        d1 += (k[i] / scale) * (k[i] / scale)
    d0 = sqrt(d0 / n)
    d1 = sqrt(d1 / n)
    h = min(1e-6 if d0 < 1e-5 or d1 < 1e-5 else 0.01 * d0 / d1, span)
    # a state near zero gives too small a guess: the step must at least change the time
    h = max(h, min(MIN_FIRST_STEP_ULPS * EPS * abs(now[n]), span))
    # second derivative (d2) from one explicit Euler step
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
    # step for which the error of order 8 is a hundredth of the tolerance
    largest = max(d1, d2)
    wanted = max(1e-6, 1e-3 * h) if largest <= 1e-15 else (0.01 / largest) ** 0.125
    return min(min(100.0 * h, wanted), span)


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
def evaluate_dense(system: Equations, method: Dop853) -> Status:
    """Evaluate the three additional stages of the dense output of a step and its terms; return a status."""
    n = system.n
    h = method.control[Control.STEP]
    for s in range(STAGES + 1, 16):
        status = evaluate_stage(system, method, s, h, method.at)
        if status != Status.DONE:
            return status
    prepare_dense(h, n, n + 1, n, method.now, method.end, method.k, method.terms)
    return Status.DONE


@native
def excess_within(system: Equations, method: Dop853, fraction: float) -> float:
    """Return the excess (`newton_euler.integrators.switches`) at a fraction of the step, by dense output."""
    n = system.n
    interpolate(n, n, fraction, method, method.at)
    method.at[n] = method.now[n] + fraction * method.control[Control.STEP]
    return excess(system.switches, method.at, method.now)


@native
def sample_step(system: Equations, switches: Switches, method: Dop853) -> int:
    """Sample the signed switching functions over a step; return 1 if some branch may be left, else 0.

    Between its ends the step is interpolated by the cubic Hermite polynomial, which needs no other rates than
    those at the ends.
    """
    n = system.n
    now = method.now
    end = method.end
    at = method.at
    rates_at_end = method.k[(n + 1) * STAGES :]
    h = method.control[Control.STEP]
    if switches.count == 0:
        return 0
    take_sample(switches, 0, now, now)
    for number in range(1, SAMPLES):
        x = float(number) / SAMPLES
        for i in range(n):
            # change minus the linear one, at the start and at the end
            bend = h * method.k[i] - (end[i] - now[i])
            other = h * rates_at_end[i] - (end[i] - now[i])
            at[i] = now[i] + x * (end[i] - now[i]) + x * (1.0 - x) * ((1.0 - x) * bend - x * other)
        at[n] = now[n] + x * h
        take_sample(switches, number, at, now)
    take_sample(switches, SAMPLES, end, now)
    if first_positive_sample(switches) <= 1.0:
        return 1
    for i in range(switches.count):
        for number in range(1, SAMPLES):
            if locate_maximum(switches, i, number) <= 1.0:
                return 1
    return 0


@native
def locate_switch(system: Equations, switches: Switches, method: Dop853) -> float:
    """Return the fraction of an accepted step at which a branch of a force is first left, or `NO_SWITCH`.

    The additional stages of the dense output must have been evaluated.
    """
    # the first fraction known to be beyond a switch, and its excess
    high = NO_SWITCH
    high_value = 0.0
    low = 0.0
    for number in range(1, SAMPLES + 1):
        if high > 1.0:
            value = excess_within(system, method, float(number) / SAMPLES)
            if value > 0.0:
                high = float(number) / SAMPLES
                high_value = value
                low = (float(number) - 1.0) / SAMPLES
    for i in range(switches.count):
        for number in range(1, SAMPLES):
            fraction = locate_maximum(switches, i, number)
            if fraction < high:
                value = excess_within(system, method, fraction)
                if value > 0.0:
                    high = fraction
                    high_value = value
                    low = 0.0
    if high > 1.0:
        return NO_SWITCH
    begin_search(switches, low, high, high_value)
    located = 0
    tries = 0
    while located == 0 and tries < MAX_ROOT_STEPS:
        fraction = next_fraction(switches)
        located = narrow_search(switches, fraction, excess_within(system, method, fraction))
        tries += 1
    return switches.search[Search.HIGH] if may_switch(switches) == 1 else NO_SWITCH


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
    if near == 0 and sample_step(system, system.switches, method) == 1:
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
        status = finish_step(system, 0, now, end)
        change_branch(system.switches, now)
    if control[Control.OVERSHOOTS_END] == 1.0 and now[n] > stop:
        for i in range(n):
            now[i] = states[n * (table.count - 1) + i]
        now[n] = stop
        status = finish_step(system, near, now, end)
    # exchange constraint rows, and evaluate the rates if the state or the rows have changed
    changed = exchange_rows(system.exchange, now)
    if fraction <= 1.0:
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
