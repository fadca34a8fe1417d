"""Interface between the integrators and the equations that they integrate, and steps that all of them share.

An integrator gets two records: `Equations` has the functions of a scene, `Table` has the runs and the output
times. The input of every function is one vector, a *state with time and parameters*: the n numbers (q, v),
the time, flags, and the parameters of the scene. A flag is 1 if a redundant constraint row is left out, or
if a switching function of a force is positive (`newton_euler.integrators.switches`). Flags may change between
steps. Parameters stay constant.

A derivative function writes the n rates (time derivatives of q and v) and, as element n, the *pivot ratio* of
its elimination. The pivot ratio measures the distance to a singular configuration, where constraints become
dependent: 1 far away, and 0 or less where the rates cannot be trusted.

A compiled integrator makes one run after another. It can also make several runs at once, each in one *lane*
of the processor's vector registers (`newton_euler.codegen.translate`). A `Vector` then has separate elements
for each lane; a `Shared` vector is the same for all lanes.

Functions marked `native` are compiled to machine code by `newton_euler.codegen`; they also run as plain
Python.
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
from newton_euler.integrators.switches import Switches
from newton_euler.scalars import Array


class Count(IntEnum):
    """Indices into the vector of counts of a run.

    Attributes:
        STEPS: number of accepted steps.
        EVALUATIONS: number of evaluations of the rates.
        REJECTED: number of rejected steps.
        DENSE_CALLS: number of evaluations of the rates by the dense, rank-revealing form.
        TIME_REACHED: time, s, that the run has reached.
        STOP_REQUEST: 0 for none, `STOP_ALL_RUNS` or `LEAVE_LANE`.
        ROWS_WRITTEN: number of output times whose states are written.
        SHORT_STEPS: number of consecutive steps shorter than `SHORT_STEP_FRACTION` of the run.
        STATUS: number of the `Status` with which the run ended.
        ROUND_OFF_EXCESS: largest error estimate of an accepted step, in units of the tolerance, that was
            accepted because round-off explains it; else 0.
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
"""Length of the vector of counts of a run."""

STOP_ALL_RUNS, LEAVE_LANE = 1.0, 2.0
"""Values of `Count.STOP_REQUEST`. `STOP_ALL_RUNS`: make no more runs. `LEAVE_LANE`: stop this run, because
the caller will repeat it alone, outside its lane."""

STEPS_PER_PAUSE = 64
"""Number of steps after which Python checks whether the user wants to interrupt the run."""

EPS = 2.3e-16
"""Relative spacing of double-precision numbers, rounded up."""

SHORT_STEP_FRACTION, MAX_SHORT_STEPS = 1e-10, 1000
"""An adaptive integrator stops with `Status.STEP_TOO_SMALL` after more than `MAX_SHORT_STEPS` consecutive
steps that are shorter than the fraction `SHORT_STEP_FRACTION` of the run."""

HUGE = 1e300
"""Substitute for infinity: a value that is not below it, NaN included, counts as not finite."""

ANGLE, QUATERNION, QUATERNION_WITH_RATES = 1.0, 2.0, 3.0
"""Values in `Equations.marks`. `ANGLE`: a coordinate with period 2 pi. `QUATERNION`: the first of four Euler
parameters (a unit quaternion w, x, y, z) whose velocities in v are an angular velocity.
`QUATERNION_WITH_RATES`: the first of four Euler parameters whose velocities in v are their time derivatives,
with the same indices."""


@dataclass(frozen=True, eq=False)
class Equations(Record):
    """The equations of motion and the constraints of a scene, as functions that integrators call.

    A `Callback` takes two vectors. It reads the first one, a state with time and parameters (inputs,) except
    for `pause`, and writes the second one.

    Attributes:
        n: length of a state (q, v).
        nq: length of the coordinates q.
        inputs: length of a state with time and parameters.
        flags: number of flags, which follow the time.
        derivative: writes the rates (n,) and the pivot ratio by the compiled sparse elimination.
        dense: writes rates and pivot ratio by a dense form, which determines ranks by singular values. It is
            slower and works in singular configurations.
        loses_rank: 1 if constraints may become dependent in some configuration, else 0.
        ratio: function for the pivot ratio of the constraints alone, without masses.
        projecting: 1 if states are projected onto the constraints after each step, else 0.
        tolerance: dimensionless constraint residual below which a state is not projected.
        open_tolerance: largest dimensionless residual that a constraint may have after projection.
        lanes: number of states that `position` and `velocity` take at once. If the integrator makes one run,
            the lanes project several output states of this run. If the lanes make different runs, it is 1.
        position: writes (n + 2, lanes): the state after one Newton step towards the constraints, the squared
            residual before the step, and the pivot ratio of the Newton step.
        velocity: writes (n + 2, lanes): the state with its velocities projected, the squared residual of the
            coordinates, and the pivot ratio.
        closing: projection by the dense form, for states at which `position` or `velocity` have too small
            pivot ratios.
        exchange: redundant constraint rows, which a run may exchange for each other.
        switches: switching functions of forces.
        projection_work: (inputs + n + 3, lanes) scratch of the projection.
        pause: reads the counts, and writes a value of `Count.STOP_REQUEST` if the user wants to stop.
        marks: (n,) `ANGLE`, `QUATERNION` or `QUATERNION_WITH_RATES`, and 0 for other elements of a state.
        groups: number of groups of coordinates and velocities that constraints connect. The change by a
            projection is measured in each group.
        members: for each group, the number of its coordinates, their indices in (q, v), the number of its
            velocities, and their indices.
        counts: (COUNTS,) counts of the current run, see `Count`.
    """

    n: int
    nq: int
    inputs: int
    flags: int
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
    switches: Switches
    projection_work: Vector
    pause: Callback
    marks: Shared
    groups: int
    members: Shared
    counts: Vector


@dataclass(frozen=True, eq=False)
class Table(Record):
    """The runs to make: their start states, and room for their states at the output times.

    Attributes:
        count: number of output times.
        output_state_size: nq if outputs need coordinates only, n if they need velocities too. Elements of the
            output states beyond this number may be undefined.
        runs: number of runs.
        stride: difference of the numbers of two successive runs in a lane: 1, or the number of lanes.
        first: (1,) number of the first run in a lane.
        times: (count,) output times, s, ascending; the first is the start and the last is the end of a run.
        ends: (runs, inputs) states with time and parameters: start states, which the integrator overwrites
            with the end states.
        states: (runs, count, n) states at the output times.
        tallies: (runs, COUNTS) counts of the completed runs, see `Count`.
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


def reported_counts(counts: Array) -> dict[str, float]:
    """Return the counts of a run, (COUNTS,), that are of interest to users, by name.

    The entry "round_off" exists only if steps were accepted although their error estimate exceeded the
    tolerance, because round-off explains it. Its value is the largest such estimate in units of the
    tolerance.
    """
    names = {
        "steps": Count.STEPS,
        "rejected": Count.REJECTED,
        "evaluations": Count.EVALUATIONS,
        "dense": Count.DENSE_CALLS,
    }
    by_name: dict[str, float] = {name: int(counts[index]) for name, index in names.items()}
    if counts[Count.ROUND_OFF_EXCESS] > 0.0:
        by_name["round_off"] = float(counts[Count.ROUND_OFF_EXCESS])
    return by_name


@native
def stop_request(system: Equations) -> int:
    """Return `Count.STOP_REQUEST`, which is 0 if the run need not stop.

    Every `STEPS_PER_PAUSE` steps `pause` checks whether the user has interrupted the run.
    """
    counts = system.counts
    if int(counts[Count.STEPS] + counts[Count.REJECTED]) % STEPS_PER_PAUSE == STEPS_PER_PAUSE - 1:
        system.pause(counts, counts[Count.STOP_REQUEST :])
    return int(counts[Count.STOP_REQUEST])


@native
def before_step(system: Equations, table: Table, max_steps: int, h: float, now: Vector) -> Status:
    """Check that an adaptive integrator may take another step; return `Status.DONE` or the reason to stop.

    Args:
        max_steps: largest number of steps of the run, rejected ones included.
        h: size of the step, s.
        now: state with time at the start of the step.
    """
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
    """Copy the start state of run number `run` into `now`, and set its counts to zero."""
    start = table.ends[system.inputs * run :]
    for i in range(system.inputs):
        now[i] = start[i]
    for i in range(COUNTS):
        system.counts[i] = 0.0
    system.counts[Count.TIME_REACHED] = now[system.n]


@native
def finish_run(system: Equations, table: Table, run: int, status: int, now: Vector) -> int:
    """Write the end state and the counts of a run into the table; return the number of the next run.

    The number is at least `table.runs` if no other run is to be made.

    Args:
        run: number of the run in the table.
        status: `Status` with which the run ended.
        now: state with time and parameters at the end.
    """
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
def copy_flags(system: Equations, source: Vector, x: Vector) -> None:
    """Copy the flags from `source` to x, both states with time and parameters."""
    for i in range(system.n + 1, system.n + 1 + system.flags):
        x[i] = source[i]


@native
def write_row(system: Equations, states: Vector, row: int, state: Vector) -> None:
    """Write a state (n,) into row number `row` of the states (count, n) of a run."""
    target = states[system.n * row :]
    for i in range(system.n):
        target[i] = state[i]
    system.counts[Count.ROWS_WRITTEN] = float(row + 1)


@native
def unwind_angles(system: Equations, x: Vector, other: Vector) -> None:
    """Bring marked angles of the state x back into -pi to pi by a full revolution.

    A large angle has too few digits after the decimal point for an accurate sine. A tolerance relative to the
    angle would also allow larger errors after many revolutions.

    Args:
        x: state (n,), changed.
        other: another state (n,) of the same run, whose angles change by the same revolution.
    """
    for i in range(system.n):
        if system.marks[i] == ANGLE and abs(x[i]) > pi:
            revolution = 2.0 * pi if x[i] > 0.0 else -2.0 * pi
            x[i] -= revolution
            other[i] -= revolution


@native
def normalize_quaternions(system: Equations, x: Vector, consistent: Vector) -> None:
    """Normalize the marked Euler parameters p = (w, x, y, z) of the state x.

    Euler parameters of norm r would scale vectors by r^2 instead of only rotating them. If the velocities are
    the rates pdot, they become the rates of the same angular velocity. In the body frame this is
    omega' = 2 L pdot / r^2, with the matrix L(p) of `newton_euler.model.euler_parameters.matrix_l`.

    Args:
        x: state (n,), changed.
        consistent: state (n,) with the Euler parameters to which the rates in x belong; may be x itself.
    """
    nq = system.nq
    for i in range(nq):
        if system.marks[i] >= QUATERNION:
            # norm of p in x, squared norm of p = (a, b, c, d) in `consistent`
            a = consistent[i]
            b = consistent[i + 1]
            c = consistent[i + 2]
            d = consistent[i + 3]
            square = a * a + b * b + c * c + d * d
            norm = sqrt(x[i] * x[i] + x[i + 1] * x[i + 1] + x[i + 2] * x[i + 2] + x[i + 3] * x[i + 3])
            for j in range(4):
                x[i + j] = x[i + j] / norm
            if system.marks[i] == QUATERNION_WITH_RATES:
                # (u, v, w) = omega' / 2 = L pdot / r^2, then the rates pdot = L^T omega' / 2 of the new p
                k = nq + i
                u = (a * x[k + 1] - b * x[k] - c * x[k + 3] + d * x[k + 2]) / square
                v = (a * x[k + 2] + b * x[k + 3] - c * x[k] - d * x[k + 1]) / square
                w = (a * x[k + 3] - b * x[k + 2] + c * x[k + 1] - d * x[k]) / square
                x[k] = -x[i + 1] * u - x[i + 2] * v - x[i + 3] * w
                x[k + 1] = x[i] * u - x[i + 3] * v + x[i + 2] * w
                x[k + 2] = x[i + 3] * u + x[i] * v - x[i + 1] * w
                x[k + 3] = x[i + 1] * v - x[i + 2] * u + x[i] * w
