"""Tangents of runs: derivatives along directions of the start and of the parameters, step by step.

The steps of a run are taken once more, its states and several directions side by side, by the same stages of
the same sizes (internal numerical differentiation: H. G. Bock, Randwertproblemmethoden zur
Parameteridentifizierung in Systemen nichtlinearer Differentialgleichungen, Bonner Mathematische Schriften
183, 1987). So the run itself knows nothing of it. After each step the tangents are put on the linearized
constraints, Phi_q S + Phi_p = 0 and its rate, by steps of least length as states are.

What a state at rest, or a slow one, lets be a step may be far too long for its tangents, which vibrate
beside it. So they have error control of their own, as sensitivities need (R. P. Dickinson, R. J. Gelinas,
Journal of Computational Physics 21, 1976; R. Serban, A. C. Hindmarsh, CVODES, ASME IDETC 2005): a step in
which the embedded estimate of their error (Hairer, Norsett, Wanner, Solving Ordinary Differential Equations
I, 1993, section II.5) is beyond their tolerance is taken in parts.

Written for native code, see `newton_euler.codegen.native`; it runs as plain Python as well.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from math import sqrt

from newton_euler.codegen.native import Callback, Record, Vector, native
from newton_euler.codegen.native_functions import NativeFunctions
from newton_euler.integrators.dop853 import (
    EXPONENT,
    FAILED,
    LARGEST,
    SAFETY,
    SMALLEST,
    advance,
    prepare_dense,
)
from newton_euler.integrators.dop853_tableau import (
    ERROR_3,
    ERROR_5,
    NODES,
    SECOND_OF_STEP,
    STAGES,
)
from newton_euler.integrators.singular import NEAR
from newton_euler.integrators.stepper import DONE, HUGE, INTERRUPTED, PATIENCE, SINGULAR, TOO_MANY_STEPS

TENTH = 0.1
"""Ratio of the sizes of two parts that show of what order an error is."""

HALF = 0.5
"""Ratio of pivot ratios in a step that is not just anywhere near a singular configuration, but passes one."""

NOISY = 4.0
"""Noise that is expected, in units of the one found."""

TINY = 1e-300
"""Keeps ratios to nothing finite."""

PARTS, WISH, REACHED = 0, 1, 2
"""Places in the vector `counts`."""


@dataclass(frozen=True, eq=False)
class Tangents(Record):
    """Steps of a run, and directions beside its states, one in each lane.

    Attributes:
        n, inputs: lengths of a state, and of one with time and parameters.
        lanes: number of directions.
        wide: lanes of `settled` and of outputs, as many or more: these take several output times at once.
        count, rows: numbers of steps and of output times.
        most: the largest number of parts that steps are taken in.
        projecting: 1 if states are kept on the constraints, else 0.
        places, speeds: (q, v) are the elements up to `places` and from `speeds` on; between is work done,
            which nothing depends on, and whose error is not looked at.
        tolerance: of errors of a part of a step, in units of the largest of q and of v in each lane.
        floor: pivot ratio below which rates are not known well enough.
        rates: of a state and of a direction, with the pivot ratio behind them.
        settled: directions on the linearized constraints.
        pause: lets Python stop the run: asked for every `PATIENCE` parts.
        steps: (count, n + 2) states, times and sizes of steps.
        times, states: (rows,) s, and (rows, n) of the run.
        x: (2 inputs, lanes) state with time and parameters, then the direction in each lane.
        beside: (2 inputs, wide) the same, for `settled` and outputs.
        at: the same, of a stage.
        k: (17, 2 n + 1, lanes) rates of the stages, then scratch.
        table: (rows, n, lanes) tangents at the output times.
        least: (1,) the least pivot ratio.
        errors: (2, lanes) of the last part in units of the tolerance, and in their own.
        tried: (lanes + 1,) the errors of a longer part, and its size, s.
        noise: (lanes,) error per second that no division makes less.
        counts: (3,) parts taken, the wish to stop, and the time reached, s.
        found: (outputs, wide) scratch for the outputs of any function.
    """

    n: int
    inputs: int
    lanes: int
    wide: int
    count: int
    rows: int
    most: int
    projecting: int
    places: int
    speeds: int
    tolerance: float
    floor: float
    rates: Callback
    settled: Callback
    pause: Callback
    steps: Vector
    times: Vector
    states: Vector
    x: Vector
    beside: Vector
    at: Vector
    k: Vector
    table: Vector
    least: Vector
    errors: Vector
    tried: Vector
    noise: Vector
    counts: Vector
    found: Vector


@native
def put(count: int, lanes: int, state: Vector, x: Vector) -> None:
    """Copy `count` elements of a state into all lanes of x."""
    for i in range(count):
        for lane in range(lanes):
            x[lanes * i + lane] = state[i]


@native
def settle(tangents: Tangents) -> None:
    """Put the tangents beside the state x on the linearized constraints."""
    if tangents.projecting == 1:
        lanes = tangents.lanes
        wide = tangents.wide
        direction = tangents.x[tangents.inputs * lanes :]
        for i in range(2 * tangents.inputs):
            for lane in range(wide):
                tangents.beside[wide * i + lane] = tangents.x[
                    lanes * i + (lane if lane < lanes else lanes - 1)
                ]
        tangents.settled(tangents.beside, tangents.found)
        for i in range(tangents.n):
            for lane in range(lanes):
                direction[lanes * i + lane] = tangents.found[wide * i + lane]


@native
def tangent_stage(tangents: Tangents, s: int, t: float, h: float) -> None:
    """Evaluate stage s of a step of size h from time t: state and tangents in `at`, rates in row s of k."""
    lanes = tangents.lanes
    size = tangents.n * lanes
    row = 2 * size + lanes
    along = tangents.inputs * lanes
    at = tangents.at
    x = tangents.x
    k = tangents.k
    if s > 0:
        advance(s, h, size, row, x, k, at)
        advance(s, h, size, row, x[along:], k[size:], at[along:])
    else:
        for i in range(size):
            at[i] = x[i]
            at[along + i] = x[along + i]
    for lane in range(lanes):
        at[size + lane] = t + NODES[s] * h
    tangents.rates(at, k[row * s :])
    tangents.least[0] = min(tangents.least[0], k[row * s + 2 * size])


@native
def prepare_terms(tangents: Tangents, h: float) -> None:
    """Work out the terms of the dense output of a step of size h, as those of states are, in place of the
    tangents' rates of the first seven stages; row 16 of k begins with the tangents at its end."""
    size = tangents.n * tangents.lanes
    row = 2 * size + tangents.lanes
    k = tangents.k[size:]
    begun = tangents.x[tangents.inputs * tangents.lanes :]
    prepare_dense(h, size, row, row, begun, tangents.k[row * 16 :], k, k)


@native
def interpolate_tangents(tangents: Tangents, share: float, y: Vector) -> None:
    """Interpolate tangents (n, lanes) at a share (0 to 1) of a step, its terms known."""
    size = tangents.n * tangents.lanes
    row = 2 * size + tangents.lanes
    terms = tangents.k[size:]
    begun = tangents.x[tangents.inputs * tangents.lanes :]
    for i in range(size):
        total = 0.0
        weight = 1.0
        for j in range(7):
            weight = weight * (share if j % 2 == 0 else 1.0 - share)
            total += weight * terms[row * j + i]
        y[i] = begun[i] + total


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
    for i in range(size):
        five = ERROR_5[0] * k[i]
        three = ERROR_3[0] * k[i]
        for j in range(SECOND_OF_STEP, STAGES):
            five += ERROR_5[j] * k[row * j + i]
            three += ERROR_3[j] * k[row * j + i]
        fives[i] = five
        threes[i] = three
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
        of_place = tangents.tolerance * max(place, h * speed) + TINY
        of_speed = tangents.tolerance * max(speed, place) + TINY
        fifth = fifth_place / of_place / of_place + fifth_speed / of_speed / of_speed
        third = third_place / of_place / of_place + third_speed / of_speed / of_speed
        error = 0.0
        if fifth > 0.0 or third > 0.0:
            error = h * fifth / sqrt((fifth + 0.01 * third) * tangents.n)
        tangents.errors[lane] = error if error < FAILED else FAILED
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
    if ratio <= TENTH:
        for lane in range(lanes):
            error = tangents.errors[lanes + lane]
            if tangents.errors[lane] > 1.0 and error > ratio * ratio * ratio * tangents.tried[lane]:
                tangents.noise[lane] = max(tangents.noise[lane], NOISY * error / h)
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
    return 1 if least < NEAR and least < HALF * most else 0


@native
def take_part(tangents: Tangents, t: float, h: float) -> float:
    """Take the stages from time t over a time h or, where tangents need it, a shorter one; returns it."""
    taken = 0
    shorter = 0
    while taken == 0:
        for s in range(STAGES + 1):
            tangent_stage(tangents, s, t, h)
        estimate_errors(tangents, h)
        if shorter == 0:
            keep_tried(tangents, h)
        find_noise(tangents, h)
        error = worst_error(tangents, h)
        if error > 1.0 and passes_singular(tangents) == 0:
            h = h * max(SMALLEST, SAFETY * error**EXPONENT)
            shorter = 1
        else:
            taken = 1
    return h


@native
def write_tangents(tangents: Tangents, t: float, h: float, due: int, stop: float) -> int:
    """Write rows of the table from `due` on, until time `stop`, by a part of size h from t; returns the row
    that is due then. They are not on the linearized constraints yet."""
    size = tangents.n * tangents.lanes
    if due < tangents.rows and tangents.times[due] <= stop:
        for s in range(STAGES + 1, 16):
            tangent_stage(tangents, s, t, h)
        prepare_terms(tangents, h)
        while due < tangents.rows and tangents.times[due] <= stop:
            interpolate_tangents(tangents, (tangents.times[due] - t) / h, tangents.table[size * due :])
            due += 1
    return due


@native
def follow(tangents: Tangents, last: Vector) -> int:
    """Carry the tangents through all steps, into the table, and to the state (n,) at the end of the last;
    returns a status."""
    counts = tangents.counts
    counts[PARTS] = 0.0
    n = tangents.n
    lanes = tangents.lanes
    size = n * lanes
    along = tangents.inputs * lanes
    x = tangents.x
    at = tangents.at
    end = tangents.k[(2 * size + lanes) * 16 :]
    due = 0
    for number in range(tangents.count):
        step = tangents.steps[(n + 2) * number :]
        t = step[n]
        stop = t + step[n + 1]
        h = step[n + 1]
        put(n + 1, lanes, step, x)
        settle(tangents)
        if due == 0:
            for i in range(size):
                tangents.table[i] = x[along + i]
            due = 1
        while t < stop:
            counts[PARTS] += 1.0
            counts[REACHED] = t
            if counts[PARTS] > tangents.most:
                return TOO_MANY_STEPS
            if int(counts[PARTS]) % PATIENCE == 0:
                tangents.pause(counts, counts[WISH:])
                if counts[WISH] > 0.0:
                    return INTERRUPTED
            taken = take_part(tangents, t, h)
            if tangents.least[0] < tangents.floor:
                return SINGULAR
            for i in range(size):
                end[i] = at[along + i]
                end[size + i] = at[i]
            reached = stop if taken >= stop - t else t + taken
            due = write_tangents(tangents, t, taken, due, reached)
            for i in range(size):
                x[along + i] = end[i]
            t = reached
            if t < stop:  # of the state, which is as exact as its step
                for i in range(size):
                    x[i] = end[size + i]
                for lane in range(lanes):
                    x[size + lane] = t
                settle(tangents)
                error = worst_error(tangents, taken)
                growth = SAFETY * error**EXPONENT if error > 0.0 else LARGEST
                h = min(taken * min(LARGEST, max(SMALLEST, growth)), stop - t)
    put(n + 1, lanes, last, x)
    settle(tangents)
    return DONE


@native
def gather(tangents: Tangents, row: int, lane: int, used: int) -> None:
    """Set `beside` to tangents at output times from one on, `used` of each; after the last to that again."""
    n = tangents.n
    lanes = tangents.lanes
    wide = tangents.wide
    inputs = tangents.inputs
    beside = tangents.beside
    for place in range(wide):
        state = tangents.states[n * row :]
        tangent = tangents.table[n * lanes * row :]
        for i in range(n):
            beside[wide * i + place] = state[i]
            beside[wide * (inputs + i) + place] = tangent[lanes * i + lane]
        beside[wide * n + place] = tangents.times[row]
        beside[wide * (inputs + n) + place] = 0.0
        for i in range(n + 1, inputs):
            beside[wide * i + place] = tangents.x[lanes * i + lane]
            beside[wide * (inputs + i) + place] = tangents.x[lanes * (inputs + i) + lane]
        if lane < used - 1:
            lane += 1
        elif row < tangents.rows - 1:
            row += 1
            lane = 0


@native
def evaluate_along(
    tangents: Tangents,
    row: int,
    used: int,
    function: Callback,
    outputs: int,
    column: int,
    columns: int,
    results: Vector,
) -> None:
    """Evaluate a function of states and of the first `used` tangents at the output times from `row` on.

    Results (rows, outputs, columns) get those of the tangents in the columns from `column` on; they may be
    the table of tangents itself.
    """
    wide = tangents.wide
    lane = 0
    while row < tangents.rows:
        gather(tangents, row, lane, used)
        function(tangents.beside, tangents.found)
        for place in range(wide):
            if row < tangents.rows:
                result = results[outputs * columns * row + column + lane :]
                for j in range(outputs):
                    result[columns * j] = tangents.found[wide * j + place]
                lane += 1
                if lane == used:
                    row += 1
                    lane = 0


@lru_cache
def methods() -> NativeFunctions:
    """Compile the loops over steps and outputs, once."""
    return NativeFunctions([follow, evaluate_along])
