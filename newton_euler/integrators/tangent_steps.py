"""Steps of tangents: those of a run once more, with error control of their own.

The steps of a run are taken once more, its states and several directions side by side, by the same stages of
the same sizes (internal numerical differentiation: H. G. Bock, Randwertproblemmethoden zur
Parameteridentifizierung in Systemen nichtlinearer Differentialgleichungen, Bonner Mathematische Schriften
183, 1987). So the run itself knows nothing of it. Every few steps the tangents are put on the linearized
constraints, Phi_q S + Phi_p = 0 and its rate, by steps of least length as states are.

What a state at rest, or a slow one, lets be a step may be far too long for its tangents, which vibrate
beside it. So they have error control of their own, as sensitivities need (R. P. Dickinson, R. J. Gelinas,
Journal of Computational Physics 21, 1976; R. Serban, A. C. Hindmarsh, CVODES, ASME IDETC 2005): a step in
which the embedded estimate of their error (Hairer, Norsett, Wanner, Solving Ordinary Differential Equations
I, 1993, section II.5) is beyond their tolerance is taken in parts.

Written for native code, see `newton_euler.codegen.native`; it runs as plain Python as well.
"""

from __future__ import annotations

from functools import lru_cache
from math import sqrt

from newton_euler.codegen.native import Vector, native
from newton_euler.codegen.native_functions import NativeFunctions
from newton_euler.integrators.dop853 import (
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
"""Ratio of the sizes of two parts that show of what order an error is."""

CROSSING_DIP = 0.5
"""Ratio of pivot ratios in a step that is not just anywhere near a singular configuration, but passes one."""

NOISE_MARGIN = 4.0
"""Noise that is expected, in units of the one found."""

STEPS_PER_PROJECTION = 4
"""Steps after which tangents are put on the linearized constraints, which they leave by errors of steps."""

SMALLEST_SCALE = 1e-300
"""Keeps ratios to nothing finite."""


@native
def estimate_errors(tangents: Tangents, h: float) -> None:
    """Estimate the errors of the tangents in a part of size h of a step, all its stages known.

    Rows 13 and 14 of k, of stages that only outputs need, get the two of each element.
    """
    lanes = tangents.lanes
    size = tangents.n * lanes
    row = 2 * size + lanes
    k = tangents.k[size:]
    fives = k[13 * row :]
    threes = k[14 * row :]
    end = tangents.at[tangents.inputs * lanes :]
    begun = tangents.x[tangents.inputs * lanes :]
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
        for i in range(tangents.places):
            e = lanes * i + lane
            place = max(place, max(abs(begun[e]), abs(end[e])))
            fifth_place += fives[e] * fives[e]
            third_place += threes[e] * threes[e]
        speed = 0.0
        fifth_speed = 0.0
        third_speed = 0.0
        for i in range(tangents.speeds, tangents.n):
            e = lanes * i + lane
            speed = max(speed, max(abs(begun[e]), abs(end[e])))
            fifth_speed += fives[e] * fives[e]
            third_speed += threes[e] * threes[e]
        # of the tangents that pass through zero, or begin there, in one of the two alone
        of_place = tangents.tolerance * max(place, h * speed) + SMALLEST_SCALE
        of_speed = tangents.tolerance * max(speed, place) + SMALLEST_SCALE
        fifth = fifth_place / of_place / of_place + fifth_speed / of_speed / of_speed
        third = third_place / of_place / of_place + third_speed / of_speed / of_speed
        # combined estimate, and the error in its own unit for the comparison with other lengths
        error = 0.0
        if fifth > 0.0 or third > 0.0:
            error = h * fifth / sqrt((fifth + 0.01 * third) * tangents.n)
        tangents.errors[lane] = error if error < FAILED_STEP_ERROR else FAILED_STEP_ERROR
        whole = h * sqrt(fifth_place + fifth_speed)
        tangents.errors[lanes + lane] = whole if whole < HUGE else HUGE


@native
def keep_tried(tangents: Tangents, h: float) -> None:
    """Keep the errors of a part of size h, to compare those of shorter ones with them."""
    for lane in range(tangents.lanes):
        tangents.tried[lane] = tangents.errors[tangents.lanes + lane]
    tangents.tried[tangents.lanes] = h


@native
def find_noise(tangents: Tangents, h: float) -> None:
    """Find the lanes whose errors fall with h as round-off does, at most with its first power.

    Errors of the method fall with the fifth power at least, and with h^12 where steps are so long that
    tangents explode; so the third tells them apart.
    """
    lanes = tangents.lanes
    ratio = h / tangents.tried[lanes]
    if ratio <= MAX_COMPARED_RATIO:
        for lane in range(lanes):
            error = tangents.errors[lanes + lane]
            if tangents.errors[lane] > 1.0 and error > ratio * ratio * ratio * tangents.tried[lane]:
                tangents.noise[lane] = max(tangents.noise[lane], NOISE_MARGIN * error / h)
        keep_tried(tangents, h)


@native
def worst_error(tangents: Tangents, h: float) -> float:
    """Return the largest error of a part of size h in units of the tolerance, except for noise."""
    worst = 0.0
    for lane in range(tangents.lanes):
        if not tangents.errors[tangents.lanes + lane] <= tangents.noise[lane] * h:
            worst = max(worst, tangents.errors[lane])
    return worst


@native
def passes_singular(tangents: Tangents) -> int:
    """Tell if the stages pass by a singular configuration: 1 or 0.

    The run has placed such a step so that no stage is too near; those of its parts would be.
    """
    size = tangents.n * tangents.lanes
    row = 2 * size + tangents.lanes
    least = tangents.k[2 * size]
    most = least
    for s in range(1, STAGES + 1):
        ratio = tangents.k[row * s + 2 * size]
        least = min(least, ratio)
        most = max(most, ratio)
    return 1 if least < NEAR_PIVOT_RATIO and least < CROSSING_DIP * most else 0


@native
def take_part(tangents: Tangents, t: float, h: float) -> float:
    """Take the stages from time t over a time h or, where tangents need it, a shorter one; returns it."""
    taken = 0
    shorter = 0
    while taken == 0:
        for s in range(shorter, STAGES + 1):  # the first is the same for any length
            tangent_stage(tangents, s, t, h)
        estimate_errors(tangents, h)
        if shorter == 0:
            keep_tried(tangents, h)
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
    """Write rows of the table from `due` on, until time `stop`, by a part of size h from t; returns the row
    that is due then. They are not on the linearized constraints yet."""
    size = tangents.n * tangents.lanes
    count = tangents.known - tangents.n - 1
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
def carry_tangents(tangents: Tangents, last: Vector) -> Status:
    """Carry the tangents through all steps, into the table, and to the state (n,) at the end of the last;
    returns a status."""
    counts = tangents.counts
    counts[TangentCount.PARTS] = 0.0
    n = tangents.n
    known = tangents.known
    lanes = tangents.lanes
    size = n * lanes
    along = tangents.inputs * lanes
    x = tangents.x
    at = tangents.at
    end = tangents.k[(2 * size + lanes) * 16 :]
    due = 0
    # each step of the run: its state, and the tangents projected every few steps
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
        # take the step in parts that keep the error of the tangents below the tolerance
        while t < stop:
            counts[TangentCount.PARTS] += 1.0
            counts[TangentCount.TIME_REACHED] = t
            if counts[TangentCount.PARTS] > tangents.max_parts:
                return Status.TOO_MANY_STEPS
            if int(counts[TangentCount.PARTS]) % STEPS_PER_PAUSE == 0:
                tangents.pause(counts, counts[TangentCount.STOP_REQUEST :])
                if counts[TangentCount.STOP_REQUEST] > 0.0:
                    return Status.INTERRUPTED
            taken = take_part(tangents, t, h)
            if tangents.least[0] < tangents.floor:
                return Status.SINGULAR
            # the end of the part, and outputs within it
            for i in range(size):
                end[i] = at[along + i]
                end[size + i] = at[i]
            reached = stop if taken >= stop - t else t + taken
            due = write_tangents(tangents, t, taken, due, reached)
            for i in range(size):
                x[along + i] = end[i]
            t = reached
            # another part follows: its state, and its length by the error of this one
            if t < stop:  # of the state, which is as exact as its step
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
    """Compile the loops over steps and outputs, once."""
    return NativeFunctions([carry_tangents, evaluate_along])
