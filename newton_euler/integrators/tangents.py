"""Tangents of runs: derivatives along directions of the start and of the parameters, step by step.

The steps of a run are taken once more, its states and several directions side by side, by the same stages of
the same sizes (internal numerical differentiation: H. G. Bock, Randwertproblemmethoden zur
Parameteridentifizierung in Systemen nichtlinearer Differentialgleichungen, Bonner Mathematische Schriften
183, 1987). So the run itself knows nothing of it. After each step the tangents are put on the linearized
constraints, Phi_q S + Phi_p = 0 and its rate, by steps of least length as states are.

Written for native code, see `newton_euler.codegen.native`; it runs as plain Python as well.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

from newton_euler.codegen.native import Callback, Record, Vector, native
from newton_euler.codegen.native_functions import NativeFunctions
from newton_euler.integrators.dop853_tableau import COUPLING, DENSE, NODES, SECOND, SECOND_OF_STEP, STAGES


@dataclass(frozen=True, eq=False)
class Tangents(Record):
    """Steps of a run, and directions beside its states, one in each lane.

    Attributes:
        n, inputs: lengths of a state, and of one with time and parameters.
        lanes: number of directions.
        count, rows: numbers of steps and of output times.
        projecting: 1 if states are kept on the constraints, else 0.
        rates: of a state and of a direction, with the pivot ratio behind them.
        settled: directions on the linearized constraints.
        steps: (count, n + 2) states, times and sizes of steps.
        times, states: (rows,) s, and (rows, n) of the run.
        x: (2 inputs, lanes) state with time and parameters, then the direction in each lane.
        at: the same, of a stage.
        k: (17, 2 n + 1, lanes) rates of the stages, then scratch.
        table: (rows, n, lanes) tangents at the output times.
        least: (1,) the least pivot ratio.
        found: (outputs, lanes) scratch for the outputs of any function.
    """

    n: int
    inputs: int
    lanes: int
    count: int
    rows: int
    projecting: int
    rates: Callback
    settled: Callback
    steps: Vector
    times: Vector
    states: Vector
    x: Vector
    at: Vector
    k: Vector
    table: Vector
    least: Vector
    found: Vector


@native
def put(count: int, lanes: int, state: Vector, x: Vector) -> None:
    """Copy `count` elements of a state into all lanes of x."""
    for i in range(count):
        for lane in range(lanes):
            x[lanes * i + lane] = state[i]


@native
def settle(tangents: Tangents, x: Vector) -> None:
    """Put the tangents beside a state on the linearized constraints; x is (2 inputs, lanes)."""
    if tangents.projecting == 1:
        size = tangents.n * tangents.lanes
        direction = x[tangents.inputs * tangents.lanes :]
        tangents.settled(x, tangents.k)
        for i in range(size):
            direction[i] = tangents.k[i]


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
    weights = COUPLING[16 * s :]
    second = int(SECOND[s])
    for i in range(size):
        change = 0.0
        turn = 0.0
        if s > 0:
            change = weights[0] * k[i]
            turn = weights[0] * k[size + i]
        for j in range(second, s):
            change += weights[j] * k[row * j + i]
            turn += weights[j] * k[row * j + size + i]
        at[i] = x[i] + h * change
        at[along + i] = x[along + i] + h * turn
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
    end = tangents.k[row * 16 :]
    begun = tangents.x[tangents.inputs * tangents.lanes :]
    for i in range(size):
        change = end[i] - begun[i]
        first = h * k[i] - change
        second = 2.0 * change - h * (k[row * STAGES + i] + k[i])
        third = DENSE[0] * k[i]
        fourth = DENSE[16] * k[i]
        fifth = DENSE[32] * k[i]
        sixth = DENSE[48] * k[i]
        for j in range(SECOND_OF_STEP, 16):
            third += DENSE[j] * k[row * j + i]
            fourth += DENSE[16 + j] * k[row * j + i]
            fifth += DENSE[32 + j] * k[row * j + i]
            sixth += DENSE[48 + j] * k[row * j + i]
        k[i] = change
        k[row + i] = first
        k[2 * row + i] = second
        k[3 * row + i] = h * third
        k[4 * row + i] = h * fourth
        k[5 * row + i] = h * fifth
        k[6 * row + i] = h * sixth


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
def follow(tangents: Tangents, last: Vector) -> None:
    """Carry the tangents through all steps, into the table, and to the state (n,) at the end of the last."""
    n = tangents.n
    lanes = tangents.lanes
    size = n * lanes
    row = 2 * size + lanes
    along = tangents.inputs * lanes
    x = tangents.x
    at = tangents.at
    k = tangents.k
    table = tangents.table
    due = 0
    for number in range(tangents.count):
        step = tangents.steps[(n + 2) * number :]
        t = step[n]
        h = step[n + 1]
        put(n + 1, lanes, step, x)
        settle(tangents, x)
        if due == 0:
            for i in range(size):
                table[i] = x[along + i]
            due = 1
        for s in range(STAGES + 1):
            tangent_stage(tangents, s, t, h)
        end = k[row * 16 :]
        for i in range(size):
            end[i] = at[along + i]
        if due < tangents.rows and tangents.times[due] <= t + h:
            for s in range(STAGES + 1, 16):
                tangent_stage(tangents, s, t, h)
            prepare_terms(tangents, h)
            first = due
            while due < tangents.rows and tangents.times[due] <= t + h:
                interpolate_tangents(tangents, (tangents.times[due] - t) / h, table[size * due :])
                due += 1
            for late in range(first, due):  # the stages are no longer needed
                put(n, lanes, tangents.states[n * late :], at)
                for lane in range(lanes):
                    at[size + lane] = tangents.times[late]
                for i in range(size):
                    at[along + i] = table[size * late + i]
                settle(tangents, at)
                for i in range(size):
                    table[size * late + i] = at[along + i]
        for i in range(size):
            x[along + i] = end[i]
    put(n + 1, lanes, last, x)
    settle(tangents, x)


@native
def evaluate_along(
    tangents: Tangents, function: Callback, outputs: int, first: int, columns: int, results: Vector
) -> None:
    """Evaluate a function of states and tangents at all output times.

    Results (rows, outputs, columns) get those of the lanes in the columns from `first` on.
    """
    n = tangents.n
    lanes = tangents.lanes
    size = n * lanes
    along = tangents.inputs * lanes
    at = tangents.at
    for row in range(tangents.rows):
        put(n, lanes, tangents.states[n * row :], at)
        for lane in range(lanes):
            at[size + lane] = tangents.times[row]
        for i in range(size):
            at[along + i] = tangents.table[size * row + i]
        function(at, tangents.found)
        result = results[outputs * columns * row + first :]
        for j in range(outputs):
            for lane in range(lanes if first + lanes < columns else columns - first):
                result[columns * j + lane] = tangents.found[lanes * j + lane]


@lru_cache
def methods() -> NativeFunctions:
    """Compile the loops over steps and outputs, once."""
    return NativeFunctions([follow, evaluate_along])
