"""Contract between methods of integration and the scenes that they integrate: records, counts and statuses.

Written for native code, see `newton_euler.codegen.native`; it runs as plain Python as well.

A state is a vector of n numbers y = (q, v), followed by the time, the flags of exchangeable constraint rows
and the scene's parameters. Callbacks read all of it; methods leave the parameters alone, and flags change
between steps. Methods make one run after another; several at once, one in each lane, if they are compiled for
that (`newton_euler.codegen.translate`). A derivative callback writes n rates and, in
place n, the pivot ratio of its elimination: a number that is not positive where the equations are too close
to singular to be trusted.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from math import pi, sqrt

from newton_euler.codegen.native import Callback, Record, Shared, Vector, native
from newton_euler.integrators.constraint_ratio import ConstraintRatio
from newton_euler.integrators.dense_projection import Closing
from newton_euler.integrators.row_exchange import RowExchange
from newton_euler.integrators.status import Status
from newton_euler.scalars import Array


class Count(IntEnum):
    """Places in the vector of counts of a run.

    Attributes:
        STEPS, EVALUATIONS, REJECTED, DENSE_CALLS: numbers of accepted steps, of evaluated rates, of rejected
            steps and of evaluations by the dense form.
        TIME_REACHED: s.
        STOP_REQUEST: 0, `STOP_ALL_RUNS` or `LEAVE_LANE`.
        ROWS_WRITTEN: rows of the table of states.
        SHORT_STEPS: consecutive steps below the fraction `SHORT_STEP_FRACTION` of the whole time.
        STATUS: how the run ended, a `Status`.
        ROUND_OFF_EXCESS: the largest error estimate, in units of the tolerance, of an accepted step whose
            estimate is explained by round-off.
    """

    STEPS = 0
    EVALUATIONS = 1
    REJECTED = 2
    DENSE_CALLS = 3
    TIME_REACHED = 4
    STOP_REQUEST = 5
    ROWS_WRITTEN = 6
    SHORT_STEPS = 7
    STATUS = 8
    ROUND_OFF_EXCESS = 9


COUNTS = len(Count)

STOP_ALL_RUNS, LEAVE_LANE = 1.0, 2.0
"""Values of `Count.STOP_REQUEST`: no more runs are made, or this run is left to other code."""

STEPS_PER_PAUSE = 64
"""Steps after which Python is given a chance to see that the user wants to stop."""

EPS = 2.3e-16
"""Distance of doubles near 1."""

SHORT_STEP_FRACTION, MAX_SHORT_STEPS = 1e-10, 1000
"""An adaptive method gets nowhere if so many steps in a row are below this share of the whole."""

HUGE = 1e300
"""A sum of rates that is not below it is not finite."""

ANGLE, QUATERNION, QUATERNION_WITH_RATES = 1.0, 2.0, 3.0
"""Marks of coordinates, in the vector `marks`: those that mean the same after a full revolution, and the
first of four Euler parameters, whose velocities are an angular velocity or their own rates at the same
places."""


@dataclass(frozen=True, eq=False)
class Equations(Record):
    """The equations of motion and constraints of a scene, as steppers call them.

    `position` writes the state after one Newton step, `velocity` one with its velocities projected; both
    write the squared residual at their argument in place n and their pivot ratio after it, and take several
    states side by side, one per lane. `closing` is for where their pivot ratio is too small.

    Attributes:
        n, nq: lengths of a state (q, v) and of q.
        inputs: length of a state with time and parameters.
        derivative, dense: rates and pivot ratio of a state, compiled, and by the dense form.
        loses_rank: 1 if constraints may become dependent in some configuration, else 0.
        ratio: pivot ratio of the constraints alone.
        projecting: 1 if states are kept on the constraints, else 0.
        tolerance: dimensionless residual below which projection has nothing to do.
        open_tolerance: dimensionless residual that a constraint may have after projection.
        lanes: number of states that `position` and `velocity` take; 1 if each lane has a run of its own.
        position, velocity: projection.
        closing: projection by the dense form.
        exchange: constraint rows among which a run chooses.
        projection_work: (inputs + n + 3, lanes) scratch.
        pause: asks whether the user wants to stop.
        marks: (n,) of angles and Euler parameters.
        groups: number of groups of coordinates and velocities that constraints connect.
        members: their places, see `newton_euler.compiled.constraint_groups.group_places`.
        counts: (COUNTS,) of the current run.
    """

    n: int
    nq: int
    inputs: int
    derivative: Callback
    dense: Callback
    loses_rank: int
    ratio: ConstraintRatio
    projecting: int
    tolerance: float
    open_tolerance: float
    lanes: int
    position: Callback
    velocity: Callback
    closing: Closing
    exchange: RowExchange
    projection_work: Vector
    pause: Callback
    marks: Shared
    groups: int
    members: Shared
    counts: Vector


@dataclass(frozen=True, eq=False)
class Table(Record):
    """Runs, and their states at the output times.

    Attributes:
        count: of output times.
        output_state_size: number of elements of a state that outputs need, nq or n; the others are anything.
        runs: their number.
        stride: from a run to the next that is made after it: 1, or the number of lanes.
        first: (1,) number of the first run.
        times: (count,) s.
        ends: (runs, inputs) states with time and parameters: where runs start, and, once they are made, end.
        states: (runs, count, n).
        tallies: (runs, COUNTS) of the runs that are made.
    """

    count: int
    output_state_size: int
    runs: int
    stride: int
    first: Vector
    times: Shared
    ends: Shared
    states: Shared
    tallies: Shared


def counted(counts: Array) -> dict[str, float]:
    """Return the counts of a run, (COUNTS,), that are of interest to users, by name.

    If round-off explains error estimates beyond the tolerance, "round_off" is the largest of them in units of
    the tolerance.
    """
    names = {
        "steps": Count.STEPS,
        "rejected": Count.REJECTED,
        "evaluations": Count.EVALUATIONS,
        "dense": Count.DENSE_CALLS,
    }
    found: dict[str, float] = {name: int(counts[place]) for name, place in names.items()}
    return found | (
        {"round_off": float(counts[Count.ROUND_OFF_EXCESS])} if counts[Count.ROUND_OFF_EXCESS] > 0.0 else {}
    )


@native
def stop_request(system: Equations) -> int:
    """Return the wish to stop, 0 if there is none; the user's is asked for every `STEPS_PER_PAUSE` steps."""
    counts = system.counts
    if int(counts[Count.STEPS] + counts[Count.REJECTED]) % STEPS_PER_PAUSE == STEPS_PER_PAUSE - 1:
        system.pause(counts, counts[Count.STOP_REQUEST :])
    return int(counts[Count.STOP_REQUEST])


@native
def before_step(system: Equations, table: Table, max_steps: int, h: float, now: Vector) -> Status:
    """Check that an adaptive method may take a step of size h, of at most `max_steps`."""
    counts = system.counts
    counts[Count.TIME_REACHED] = now[system.n]
    if counts[Count.STEPS] + counts[Count.REJECTED] >= max_steps:
        return Status.TOO_MANY_STEPS
    if stop_request(system) > 0:
        return Status.INTERRUPTED
    span = table.times[table.count - 1] - table.times[0]
    counts[Count.SHORT_STEPS] = counts[Count.SHORT_STEPS] + 1.0 if h < SHORT_STEP_FRACTION * span else 0.0
    if counts[Count.SHORT_STEPS] > MAX_SHORT_STEPS or h < 10.0 * EPS * max(abs(now[system.n]), h):
        return Status.STEP_TOO_SMALL
    return Status.DONE


@native
def start_run(system: Equations, table: Table, run: int, now: Vector) -> None:
    """Go to the start of a run."""
    start = table.ends[system.inputs * run :]
    for i in range(system.inputs):
        now[i] = start[i]
    for i in range(COUNTS):
        system.counts[i] = 0.0
    system.counts[Count.TIME_REACHED] = now[system.n]


@native
def finish_run(system: Equations, table: Table, run: int, status: int, now: Vector) -> int:
    """Write where and how a run ended; returns the number of the next one, if there is to be one."""
    end = table.ends[system.inputs * run :]
    tally = table.tallies[COUNTS * run :]
    counts = system.counts
    counts[Count.STATUS] = float(status)
    if counts[Count.STOP_REQUEST] > 0.0:
        counts[Count.STATUS] = float(Status.INTERRUPTED)
    elif status == Status.DONE:
        counts[Count.TIME_REACHED] = now[system.n]
    for i in range(system.inputs):
        end[i] = now[i]
    for i in range(COUNTS):
        tally[i] = counts[i]
    return table.runs if counts[Count.STOP_REQUEST] == STOP_ALL_RUNS else run + table.stride


@native
def write_row(system: Equations, states: Vector, row: int, state: Vector) -> None:
    """Write a state into a row of those of a run."""
    here = states[system.n * row :]
    for i in range(system.n):
        here[i] = state[i]
    system.counts[Count.ROWS_WRITTEN] = float(row + 1)


@native
def unwind_angles(system: Equations, x: Vector, before: Vector) -> None:
    """Take full revolutions off the marked angles; `before` moves along.

    An angle of many revolutions has fewer digits than its sine needs, and a tolerance relative to it would
    let steps grow with it.
    """
    for i in range(system.n):
        if system.marks[i] == ANGLE and abs(x[i]) > pi:
            revolution = 2.0 * pi if x[i] > 0.0 else -2.0 * pi
            x[i] -= revolution
            before[i] -= revolution


@native
def normalize_quaternions(system: Equations, x: Vector, before: Vector) -> None:
    """Give marked Euler parameters p norm 1, whatever a run does about its constraints.

    A norm n would scale rotations by n^2. It is one of coordinates, not of the mechanism: no drift that
    one would want to see. Rates become those of the same angular velocity of the body, 2 L pdot / n^2 at
    `before`, where they were taken (paper, equation 11); that may be x itself.
    """
    nq = system.nq
    for i in range(nq):
        if system.marks[i] >= QUATERNION:
            a = before[i]
            b = before[i + 1]
            c = before[i + 2]
            d = before[i + 3]
            square = a * a + b * b + c * c + d * d
            norm = sqrt(x[i] * x[i] + x[i + 1] * x[i + 1] + x[i + 2] * x[i + 2] + x[i + 3] * x[i + 3])
            for j in range(4):
                x[i + j] = x[i + j] / norm
            if system.marks[i] == QUATERNION_WITH_RATES:
                k = nq + i
                u = (a * x[k + 1] - b * x[k] - c * x[k + 3] + d * x[k + 2]) / square
                v = (a * x[k + 2] + b * x[k + 3] - c * x[k] - d * x[k + 1]) / square
                w = (a * x[k + 3] - b * x[k + 2] + c * x[k + 1] - d * x[k]) / square
                x[k] = -x[i + 1] * u - x[i + 2] * v - x[i + 3] * w
                x[k + 1] = x[i] * u - x[i + 3] * v + x[i + 2] * w
                x[k + 2] = x[i + 3] * u + x[i] * v - x[i + 1] * w
                x[k + 3] = x[i + 1] * v - x[i + 2] * u + x[i] * w
