"""Tangents of runs: derivatives along directions of the start and of the parameters, beside its states.

Stages of steps, states and several directions side by side, and what is evaluated of both at output times;
`newton_euler.integrators.tangent_steps` takes the steps.

Written for native code, see `newton_euler.codegen.native`; it runs as plain Python as well.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

from newton_euler.codegen.native import Callback, Record, Vector, native
from newton_euler.integrators.dop853 import advance, prepare_dense
from newton_euler.integrators.dop853_tableau import NODES


class TangentCount(IntEnum):
    """Places in the vector `counts`: parts taken, the request to stop, and the time reached, s."""

    PARTS = 0
    STOP_REQUEST = 1
    TIME_REACHED = 2


@dataclass(frozen=True, eq=False)
class Tangents(Record):
    """Steps of a run, and directions beside its states, one in each lane.

    Attributes:
        n, inputs: lengths of a state, and of one with time, flags and parameters.
        known: length of a state with time and flags, which steps have.
        lanes: number of directions.
        wide: lanes of `project` and of outputs, as many or more: these take several output times at once.
        count, rows: numbers of steps and of output times.
        max_parts: the largest number of parts that steps are taken in.
        projecting: 1 if states are kept on the constraints, else 0.
        places, speeds: (q, v) are the elements up to `places` and from `speeds` on; between is work done,
            which nothing depends on, and whose error is not looked at.
        tolerance: of errors of a part of a step, in units of the largest of q and of v in each lane.
        floor: pivot ratio below which rates are not known well enough.
        rates: of a state and of a direction, with the pivot ratio behind them.
        project: directions on the linearized constraints.
        pause: lets Python stop the run: asked for every `PATIENCE` parts.
        steps: (count, known + 1) states, times, flags and sizes of steps.
        times, states: (rows,) s, and (rows, n) of the run.
        flags: (rows, known - n - 1) of the steps in which the output times are.
        x: (2 inputs, lanes) state with time and parameters, then the direction in each lane.
        wide_x: (2 inputs, wide) the same, for `project` and outputs.
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
    known: int
    lanes: int
    wide: int
    count: int
    rows: int
    max_parts: int
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
    least: Vector
    errors: Vector
    tried: Vector
    noise: Vector
    counts: Vector
    found: Vector


@native
def copy_state(count: int, lanes: int, state: Vector, x: Vector) -> None:
    """Copy `count` elements of a state into all lanes of x."""
    for i in range(count):
        for lane in range(lanes):
            x[lanes * i + lane] = state[i]


@native
def project_tangents(tangents: Tangents) -> None:
    """Put the tangents beside the state x on the linearized constraints."""
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
def gather_outputs(tangents: Tangents, row: int, lane: int, used: int) -> None:
    """Set `wide_x` to tangents at output times from one on, `used` of each; after the last to that again."""
    n = tangents.n
    lanes = tangents.lanes
    wide = tangents.wide
    inputs = tangents.inputs
    wide_x = tangents.wide_x
    for place in range(wide):
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
    """Evaluate a function of states and of the first `used` tangents at the output times from `row` on.

    Results (rows, outputs, columns) get those of the tangents in the columns from `column` on; they may be
    the table of tangents itself.
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
