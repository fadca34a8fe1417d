"""Tangents of a run: derivatives of its states along directions in the start state and the parameters.

Several tangents of one run are integrated together, each in one *lane* (element) of the processor's vector
registers. This module has their record, the stages of a step of DOP853, its dense output (interpolation
within the step), and the evaluation of results at output times. `newton_euler.integrators.tangent_steps`
takes the steps, and `newton_euler.analysis.sensitivity.tangent_run` prepares the record. An array (n, lanes)
has the n elements one after the other, each for all lanes: element i of a lane has the index lanes i + lane.

Functions marked `native` are compiled to machine code by `newton_euler.codegen`; they also run as plain
Python.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

from newton_euler.codegen.native import Callback, Record, Vector, native
from newton_euler.integrators.dop853_stages import advance, prepare_dense
from newton_euler.integrators.dop853_tableau import NODES


class TangentCount(IntEnum):
    """Indices into `Tangents.counts`.

    Attributes:
        SUBSTEPS: number of substeps taken; each step of the run is integrated in one or more substeps.
        STOP_REQUEST: not 0 if the user wants to stop.
        TIME_REACHED: time at the start of the present substep, s.
    """

    SUBSTEPS = 0
    STOP_REQUEST = 1
    TIME_REACHED = 2


@dataclass(frozen=True, eq=False)
class Tangents(Record):
    """The recorded steps of a run, and the tangents that are integrated along them, one in each lane.

    A state with time and parameters has n numbers (q, v), the time, flags of constraint rows (1 for a
    redundant row that is left out), and the parameters. A tangent with parameters has the derivatives of
    all these numbers along one direction.

    Attributes:
        n: length of a state.
        inputs: length of a state with time and parameters.
        known: length of a state with time and flags, as in `steps`.
        lanes: number of tangents that are integrated together.
        wide: number of lanes of `project` and of output functions, at least `lanes`. Output functions take
            tangents of several output times at once.
        count: number of recorded steps of the run.
        rows: number of output times.
        max_substeps: largest number of substeps.
        projecting: 1 if states are projected onto the constraints, else 0.
        places, speeds: coordinates are the first `places` elements of a state, velocities are the elements
            from index `speeds` on. The elements between them are the work of forces. The motion does not
            depend on this work, so its error is not controlled.
        tolerance: tolerance of the error of a substep, relative to the largest element of q and of v.
        floor: smallest pivot ratio (distance to a singular configuration) at which tangents are accurate.
        rates: writes (2 n + 1, lanes): rates of the state, rates of the tangents, and the pivot ratio.
        project: writes the tangents (n, wide) projected onto the linearized constraints.
        pause: sets `TangentCount.STOP_REQUEST` if the user wants to stop; called every
            `newton_euler.integrators.stepper.STEPS_PER_PAUSE` substeps.
        steps: (count, known + 1) state, time and flags at the start of each step, and its size, s.
        times: (rows,) output times, s.
        states: (rows, n) states of the run at the output times.
        flags: (rows, known - n - 1) flags of constraint rows at the output times.
        x: (2 inputs, lanes) state with time and parameters, then the tangent with parameters, at the start of
            a step.
        wide_x: (2 inputs, wide) state and tangent with parameters for `project` and output functions.
        at: (2 inputs, lanes) state and tangent with parameters at a stage of a step.
        k: (17, 2 n + 1, lanes) rates of the 16 stages as `rates` writes them, then one row of scratch.
        table: (rows, n, lanes) tangents at the output times.
        min_pivot_ratio: (1,) smallest pivot ratio so far.
        errors: (2, lanes) error of the last substep in units of the tolerance, and its norm in SI units.
        longer_errors: (lanes + 1,) norms in SI units of the errors of an earlier, longer substep, and its
            size, s. Errors that hardly fall in shorter substeps are round-off, see `noise`.
        noise: (lanes,) norm of the error per second, SI, that is round-off and does not fall with the step
            size.
        counts: (3,) counts of the integration, see `TangentCount`.
        found: (outputs, wide) scratch for the results of any function.
    """

    n: int
    inputs: int
    known: int
    lanes: int
    wide: int
    count: int
    rows: int
    max_substeps: int
    projecting: int
    places: int
    speeds: int
    tolerance: float
    floor: float
    rates: Callback
    project: Callback
    pause: Callback
    steps: Vector
    times: Vector
    states: Vector
    flags: Vector
    x: Vector
    wide_x: Vector
    at: Vector
    k: Vector
    table: Vector
    min_pivot_ratio: Vector
    errors: Vector
    longer_errors: Vector
    noise: Vector
    counts: Vector
    found: Vector


@native
def copy_state(count: int, lanes: int, state: Vector, x: Vector) -> None:
    """Copy the first `count` elements of a state into all lanes of x (inputs, lanes)."""
    for i in range(count):
        for lane in range(lanes):
            x[lanes * i + lane] = state[i]


@native
def project_tangents(tangents: Tangents) -> None:
    """Project the tangents in `x` onto the linearized constraints, if the run projects its states.

    If `project` has more lanes than there are tangents, the additional lanes repeat the last tangent.
    """
    if tangents.projecting == 1:
        lanes = tangents.lanes
        wide = tangents.wide
        direction = tangents.x[tangents.inputs * lanes :]
        for i in range(2 * tangents.inputs):
            for lane in range(wide):
                tangents.wide_x[wide * i + lane] = tangents.x[
                    lanes * i + (lane if lane < lanes else lanes - 1)
                ]
        tangents.project(tangents.wide_x, tangents.found)
        for i in range(tangents.n):
            for lane in range(lanes):
                direction[lanes * i + lane] = tangents.found[wide * i + lane]


@native
def tangent_stage(tangents: Tangents, s: int, t: float, h: float) -> None:
    """Evaluate stage s of DOP853: write state and tangents to `at`, and their rates to row s of k.

    Args:
        s: number of the stage, 0 to 15.
        t: time at the start of the step, s.
        h: size of the step, s.
    """
    lanes = tangents.lanes
    size = tangents.n * lanes
    row_length = 2 * size + lanes  # of k
    along = tangents.inputs * lanes  # index of the tangents in x and `at`
    at = tangents.at
    x = tangents.x
    k = tangents.k
    # the state, then the tangents
    if s > 0:
        advance(s, h, size, row_length, x, k, at)
        advance(s, h, size, row_length, x[along:], k[size:], at[along:])
    else:
        for i in range(size):
            at[i] = x[i]
            at[along + i] = x[along + i]
    for lane in range(lanes):
        at[size + lane] = t + NODES[s] * h
    tangents.rates(at, k[row_length * s :])
    tangents.min_pivot_ratio[0] = min(tangents.min_pivot_ratio[0], k[row_length * s + 2 * size])


@native
def prepare_terms(tangents: Tangents, h: float) -> None:
    """Compute the seven terms of the dense output of the tangents in a step of size h, s.

    The terms overwrite the rates of the tangents in the first seven rows of k. Row 16 of k must begin with
    the tangents at the end of the step.
    """
    size = tangents.n * tangents.lanes
    row_length = 2 * size + tangents.lanes
    k = tangents.k[size:]
    start = tangents.x[tangents.inputs * tangents.lanes :]
    end = tangents.k[row_length * 16 :]
    # the terms go to the memory of the rates, with rows of the same length
    prepare_dense(h, size, row_length, row_length, start, end, k, k)


@native
def interpolate_tangents(tangents: Tangents, theta: float, y: Vector) -> None:
    """Evaluate the dense output of the tangents within a step, after `prepare_terms`.

    Term j has the weight theta (1 - theta) theta ... with j + 1 factors.

    Args:
        theta: time as a fraction of the step, 0 to 1.
        y: (n, lanes) tangents, written.
    """
    size = tangents.n * tangents.lanes
    row_length = 2 * size + tangents.lanes  # of k
    terms = tangents.k[size:]
    start = tangents.x[tangents.inputs * tangents.lanes :]
    for i in range(size):
        total = 0.0
        weight = 1.0
        for j in range(7):
            weight = weight * (theta if j % 2 == 0 else 1.0 - theta)
            total += weight * terms[row_length * j + i]
        y[i] = start[i] + total


@native
def gather_outputs(tangents: Tangents, row: int, lane: int, used: int) -> None:
    """Fill the lanes of `wide_x` with states and tangents of consecutive outputs, for output functions.

    The lanes take the first `used` tangents of an output time, then those of the next output time. Lanes
    beyond the last output time repeat the last tangent.

    Args:
        row, lane: output time and tangent for the first lane.
        used: number of tangents of each output time.
    """
    n = tangents.n
    lanes = tangents.lanes
    wide = tangents.wide
    inputs = tangents.inputs
    wide_x = tangents.wide_x
    for place in range(wide):  # the lane of `wide_x`; `lane` is that of the tangent
        # state and tangent, then time and flags, whose tangents are 0, then parameters
        state = tangents.states[n * row :]
        tangent = tangents.table[n * lanes * row :]
        for i in range(n):
            wide_x[wide * i + place] = state[i]
            wide_x[wide * (inputs + i) + place] = tangent[lanes * i + lane]
        wide_x[wide * n + place] = tangents.times[row]
        wide_x[wide * (inputs + n) + place] = 0.0
        flags = tangents.flags[(tangents.known - n - 1) * row :]
        for i in range(tangents.known - n - 1):
            wide_x[wide * (n + 1 + i) + place] = flags[i]
            wide_x[wide * (inputs + n + 1 + i) + place] = 0.0
        for i in range(tangents.known, inputs):
            wide_x[wide * i + place] = tangents.x[lanes * i + lane]
            wide_x[wide * (inputs + i) + place] = tangents.x[lanes * (inputs + i) + lane]
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
    """Evaluate a function of the state and a tangent at all output times from `row` on.

    Args:
        row: index of the first output time.
        used: number of tangents to evaluate, from the first on.
        function: writes its results (outputs, wide) at states and tangents (2 inputs, wide).
        outputs: number of results of the function.
        column: first column of `results` to write; the tangents have one column each.
        columns: number of columns of `results`.
        results: (rows, outputs, columns) written; may be the table of tangents itself.
    """
    wide = tangents.wide
    lane = 0
    while row < tangents.rows:
        gather_outputs(tangents, row, lane, used)
        function(tangents.wide_x, tangents.found)
        for place in range(wide):
            if row < tangents.rows:
                result = results[outputs * columns * row + column + lane :]
                for j in range(outputs):
                    result[columns * j] = tangents.found[wide * j + place]
                lane += 1
                if lane == used:
                    row += 1
                    lane = 0
