"""Stages, error estimate and interpolation of a step of DOP853, and its working memory.

The method of Dormand and Prince with error estimates of orders 5 and 3 and dense output (interpolation within
the step) of order 7: E. Hairer, S. P. Norsett, G. Wanner, Solving Ordinary Differential Equations I, second
edition, Springer 1993, section II.5 (step) and II.6 (dense output). `newton_euler.integrators.dop853` makes
steps and runs of these parts, and explains a state, its rates, and a state with time and parameters.

Functions marked `native` are compiled to machine code by `newton_euler.codegen`; they also run as plain
Python.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from math import sqrt

from newton_euler.codegen.native import Record, Shared, Vector, native
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
from newton_euler.integrators.singular import (
    evaluate,
)
from newton_euler.integrators.status import Status
from newton_euler.integrators.stepper import (
    EPS,
    HUGE,
    Equations,
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
