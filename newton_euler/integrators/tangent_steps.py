"""Integrate the tangents of a run (derivatives of its states, forward sensitivities) along its recorded
steps.

The run is made first and records its steps. Then `integrate_tangents` repeats the steps of DOP853 with the
same sizes, for the states and several tangents together (internal numerical differentiation: H. G. Bock,
Randwertproblemmethoden zur Parameteridentifizierung in Systemen nichtlinearer Differentialgleichungen, Bonner
Mathematische Schriften 183, 1987). Each tangent is in one *lane* (element) of the processor's vector
registers. Arrays `x` and `at` have the state, time, flags of constraint rows and parameters. A flag is 1 for
a row that is left out as redundant. From index `inputs` on follows a tangent of the same layout. A row of `k`
has the rates of the n state numbers, those of the tangent, and the pivot ratio. Each number is stored for all
lanes.

Every few steps the tangents S are projected onto the linearized constraints, Phi_q S + Phi_p = 0
and its time derivative. Phi_q and Phi_p are the derivatives of the constraint residuals with respect to
coordinates and parameters.

A step that is short enough for a slow state may be too long for tangents that vibrate. So tangents have their
own error control (R. P. Dickinson, R. J. Gelinas, Journal of Computational Physics 21, 1976; R. Serban, A. C.
Hindmarsh, CVODES, ASME IDETC 2005). If the error estimate of the tangents (Hairer, Norsett, Wanner, Solving
Ordinary Differential Equations I, 1993, section II.5) exceeds their tolerance, the step is divided into
*substeps*.

Functions marked `native` are compiled to machine code by `newton_euler.codegen`; they also run as plain
Python.
"""

from __future__ import annotations

from functools import lru_cache
from math import sqrt

from newton_euler.codegen.native import Vector, native
from newton_euler.codegen.native_functions import NativeFunctions
from newton_euler.integrators.dop853_stages import (
    ERROR_EXPONENT,
    FAILED_STEP_ERROR,
    MAX_STEP_FACTOR,
    MIN_STEP_FACTOR,
    SAFETY,
)
from newton_euler.integrators.dop853_tableau import ERROR_3, ERROR_5, SECOND_NONZERO_OF_STEP, STAGES
from newton_euler.integrators.singular import NEAR_PIVOT_RATIO
from newton_euler.integrators.status import Status
from newton_euler.integrators.stepper import HUGE, STEPS_PER_PAUSE
from newton_euler.integrators.tangents import (
    TangentCount,
    Tangents,
    copy_state,
    evaluate_along,
    interpolate_tangents,
    prepare_terms,
    project_tangents,
    tangent_stage,
)

MAX_COMPARED_RATIO = 0.1
"""Largest ratio of the sizes of two substeps whose errors are compared to find the order of the error."""

CROSSING_DIP = 0.5
"""Ratio of the smallest to the largest pivot ratio of the stages of a step, below which the step passes a
singular configuration and is not only close to one. The pivot ratio measures the distance from a singular
configuration, where constraints become dependent (`newton_euler.integrators.singular`)."""

NOISE_MARGIN = 4.0
"""Safety factor of the measured noise (round-off error) of a tangent."""

STEPS_PER_PROJECTION = 4
"""Number of steps between two projections of the tangents onto the linearized constraints."""

SMALLEST_SCALE = 1e-300
"""Number that is added to error scales, so that a division by the scale of a zero tangent is finite."""


@native
def estimate_errors(tangents: Tangents, h: float) -> None:
    """Estimate the errors of the tangents in a substep of size h, s, from the rates of its stages; write
    `errors`.

    Rows 13 and 14 of k, which are free until dense output, receive the two embedded estimates of each
    element. The work of forces, which lies between coordinates and velocities in a state, is not controlled.
    """
    lanes = tangents.lanes
    size = tangents.n * lanes
    row = 2 * size + lanes
    k = tangents.k[size:]  # from here on, a row begins with the rates of the tangents
    fives = k[13 * row :]
    threes = k[14 * row :]
    end = tangents.at[tangents.inputs * lanes :]
    start = tangents.x[tangents.inputs * lanes :]
    # embedded formulas of orders 5 and 3 for each element
    for i in range(size):
        five = ERROR_5[0] * k[i]
        three = ERROR_3[0] * k[i]
        for j in range(SECOND_NONZERO_OF_STEP, STAGES):
            five += ERROR_5[j] * k[row * j + i]
            three += ERROR_3[j] * k[row * j + i]
        fives[i] = five
        threes[i] = three
    # norms of each lane: of coordinates and of velocities, in units of the largest of each
    for lane in range(lanes):
        place = 0.0
        fifth_place = 0.0
        third_place = 0.0
        for i in range(tangents.places):  # coordinates
            e = lanes * i + lane
            place = max(place, max(abs(start[e]), abs(end[e])))
            fifth_place += fives[e] * fives[e]
            third_place += threes[e] * threes[e]
        speed = 0.0
        fifth_speed = 0.0
        third_speed = 0.0
        for i in range(tangents.speeds, tangents.n):  # velocities
            e = lanes * i + lane
            speed = max(speed, max(abs(start[e]), abs(end[e])))
            fifth_speed += fives[e] * fives[e]
            third_speed += threes[e] * threes[e]
        # if only coordinates or only velocities of the tangent are near zero, the other gives the scale
        of_place = tangents.tolerance * max(place, h * speed) + SMALLEST_SCALE
        of_speed = tangents.tolerance * max(speed, place) + SMALLEST_SCALE
        fifth = fifth_place / of_place / of_place + fifth_speed / of_speed / of_speed
        third = third_place / of_place / of_place + third_speed / of_speed / of_speed
        # combined estimate of DOP853, and the norm in SI units for the comparison with substeps of other
        # sizes
        error = 0.0
        if fifth > 0.0 or third > 0.0:
            error = h * fifth / sqrt((fifth + 0.01 * third) * tangents.n)
        tangents.errors[lane] = error if error < FAILED_STEP_ERROR else FAILED_STEP_ERROR
        norm = h * sqrt(fifth_place + fifth_speed)
        tangents.errors[lanes + lane] = norm if norm < HUGE else HUGE


@native
def keep_longer_errors(tangents: Tangents, h: float) -> None:
    """Store the errors of a substep of size h, s, for the comparison with shorter substeps."""
    for lane in range(tangents.lanes):
        tangents.longer_errors[lane] = tangents.errors[tangents.lanes + lane]
    tangents.longer_errors[tangents.lanes] = h


@native
def find_noise(tangents: Tangents, h: float) -> None:
    """Detect tangents whose error is round-off, by comparing a substep of size h, s, with a longer one.

    If substeps become shorter, round-off falls at most with the first power of h. Errors of the method fall
    with the fifth power at least, and with h^12 if steps are so long that tangents explode. An error that
    falls by less than the third power counts as round-off.
    """
    lanes = tangents.lanes
    ratio = h / tangents.longer_errors[lanes]
    if ratio <= MAX_COMPARED_RATIO:
        for lane in range(lanes):
            error = tangents.errors[lanes + lane]
            if tangents.errors[lane] > 1.0 and error > ratio * ratio * ratio * tangents.longer_errors[lane]:
                tangents.noise[lane] = max(tangents.noise[lane], NOISE_MARGIN * error / h)
        keep_longer_errors(tangents, h)


@native
def worst_error(tangents: Tangents, h: float) -> float:
    """Return the largest error of a tangent in a substep of size h, s, in units of the tolerance.

    Errors that are round-off do not count.
    """
    worst = 0.0
    for lane in range(tangents.lanes):
        if not tangents.errors[tangents.lanes + lane] <= tangents.noise[lane] * h:
            worst = max(worst, tangents.errors[lane])
    return worst


@native
def passes_singular(tangents: Tangents) -> int:
    """Return 1 if the step with the rates k passes a singular configuration, else 0.

    The run has placed such a step so that no stage is too close to the singular configuration. Stages of
    substeps would be too close, so the step is not divided.
    """
    size = tangents.n * tangents.lanes
    row = 2 * size + tangents.lanes
    least = tangents.k[2 * size]  # pivot ratio of stage 0
    most = least
    for s in range(1, STAGES + 1):
        ratio = tangents.k[row * s + 2 * size]
        least = min(least, ratio)
        most = max(most, ratio)
    return 1 if least < NEAR_PIVOT_RATIO and least < CROSSING_DIP * most else 0


@native
def take_substep(tangents: Tangents, t: float, h: float) -> float:
    """Evaluate the stages of a substep, shortened until the error of the tangents is below the tolerance.

    Args:
        t: time at the start of the substep, s.
        h: largest size of the substep, s.

    Returns:
        size of the substep, s.
    """
    taken = 0
    shorter = 0
    while taken == 0:
        for s in range(shorter, STAGES + 1):  # stage 0 is the same for any size
            tangent_stage(tangents, s, t, h)
        estimate_errors(tangents, h)
        if shorter == 0:
            keep_longer_errors(tangents, h)
        find_noise(tangents, h)
        error = worst_error(tangents, h)
        if error > 1.0 and passes_singular(tangents) == 0:
            h = h * max(MIN_STEP_FACTOR, SAFETY * error**ERROR_EXPONENT)
            shorter = 1
        else:
            taken = 1
    return h


@native
def write_tangents(tangents: Tangents, t: float, h: float, due: int, stop: float) -> int:
    """Write the tangents at the output times that a substep has reached; return the index of the next one.

    The tangents are interpolated and not yet projected onto the linearized constraints.

    Args:
        t: time at the start of the substep, s.
        h: size of the substep, s.
        due: index of the next output time.
        stop: time at the end of the substep, s.
    """
    size = tangents.n * tangents.lanes
    count = tangents.known - tangents.n - 1  # number of flags of constraint rows
    if due < tangents.rows and tangents.times[due] <= stop:
        for s in range(STAGES + 1, 16):
            tangent_stage(tangents, s, t, h)
        prepare_terms(tangents, h)
        while due < tangents.rows and tangents.times[due] <= stop:
            interpolate_tangents(tangents, (tangents.times[due] - t) / h, tangents.table[size * due :])
            for i in range(count):
                tangents.flags[count * due + i] = tangents.x[tangents.lanes * (tangents.n + 1 + i)]
            due += 1
    return due


@native
def integrate_tangents(tangents: Tangents, last: Vector) -> Status:
    """Integrate the tangents through all steps of a run; return a status.

    The tangents at the output times go to `tangents.table`, those at the end of the run to `tangents.x`.

    Args:
        last: (known,) state with time and flags at the end of the run.
    """
    counts = tangents.counts
    counts[TangentCount.SUBSTEPS] = 0.0
    n = tangents.n
    known = tangents.known
    lanes = tangents.lanes
    size = n * lanes
    along = tangents.inputs * lanes
    x = tangents.x
    at = tangents.at
    end = tangents.k[(2 * size + lanes) * 16 :]  # scratch row after the 16 stages
    due = 0  # index of the next output time
    # each step of the run: the recorded state at its start, and the tangents, projected every few steps and
    # after a step that passes a singular configuration
    for number in range(tangents.count):
        step = tangents.steps[(known + 1) * number :]
        t = step[n]
        stop = t + step[known]
        h = step[known]
        copy_state(known, lanes, step, x)
        for i in range(lanes * (n + 1), lanes * known):
            at[i] = x[i]
        if number % STEPS_PER_PROJECTION == 0 or passes_singular(tangents) == 1:
            project_tangents(tangents)
        # the first row of the table
        if due == 0:
            for i in range(size):
                tangents.table[i] = x[along + i]
            for i in range(known - n - 1):
                tangents.flags[i] = step[n + 1 + i]
            due = 1
        # divide the step into substeps that keep the error of the tangents below the tolerance
        while t < stop:
            counts[TangentCount.SUBSTEPS] += 1.0
            counts[TangentCount.TIME_REACHED] = t
            if counts[TangentCount.SUBSTEPS] > tangents.max_substeps:
                return Status.TOO_MANY_STEPS
            if int(counts[TangentCount.SUBSTEPS]) % STEPS_PER_PAUSE == 0:
                tangents.pause(counts, counts[TangentCount.STOP_REQUEST :])
                if counts[TangentCount.STOP_REQUEST] > 0.0:
                    return Status.INTERRUPTED
            taken = take_substep(tangents, t, h)
            if tangents.min_pivot_ratio[0] < tangents.floor:  # too close for accurate tangents
                return Status.SINGULAR
            # the end of the substep, tangents before states, and outputs within it; dense output overwrites
            # `at`
            for i in range(size):
                end[i] = at[along + i]
                end[size + i] = at[i]
            reached = stop if taken >= stop - t else t + taken
            due = write_tangents(tangents, t, taken, due, reached)
            for i in range(size):
                x[along + i] = end[i]
            t = reached
            # if another substep follows: state at its start, and its size from the error of this substep
            if t < stop:
                for i in range(size):
                    x[i] = end[size + i]
                for lane in range(lanes):
                    x[size + lane] = t
                project_tangents(tangents)
                error = worst_error(tangents, taken)
                growth = SAFETY * error**ERROR_EXPONENT if error > 0.0 else MAX_STEP_FACTOR
                h = min(taken * min(MAX_STEP_FACTOR, max(MIN_STEP_FACTOR, growth)), stop - t)
            if t > tangents.times[tangents.rows - 1]:  # the run ends within its last step
                for i in range(size):
                    x[along + i] = tangents.table[size * (tangents.rows - 1) + i]
    # the end of the run
    copy_state(known, lanes, last, x)
    project_tangents(tangents)
    return Status.DONE


@lru_cache
def tangent_methods() -> NativeFunctions:
    """Return the compiled functions that integrate tangents and evaluate outputs; the first call compiles
    them."""
    return NativeFunctions([integrate_tangents, evaluate_along])
