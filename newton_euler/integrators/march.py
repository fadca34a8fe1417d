"""What all steppers share: guarded evaluation of the derivative, projection, and statuses.

Written for native code, see `newton_euler.codegen.native`; it runs as plain Python as well.

A state is a vector of n numbers y = (q, v), followed by the time and the scene's parameters, which
callbacks read and steppers leave alone. A derivative callback writes n rates and, in place n, its
health: a number that is not positive where the equations are too close to singular to be trusted.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import pi, sqrt

from newton_euler.codegen.native import Callback, Record, Vector, native

DONE, NOT_FINITE, SINGULAR, TOO_MANY_STEPS = 0, 1, 2, 3
STEP_TOO_SMALL, OPEN, INTERRUPTED, STRAYING = 4, 5, 6, 7
UNDETERMINED, UNPROJECTED = 8, 9
"""Statuses: how a march ended."""

STEPS, EVALUATIONS, REJECTED, DENSE_CALLS, REACHED, WISH, WRITTEN = 0, 1, 2, 3, 4, 5, 6
"""Places in the vector of counts; REACHED is the time, WISH is 1 to stop, WRITTEN are rows of the table."""

COUNTS = 7

PATIENCE = 64
"""Steps after which Python is given a chance to see that the user wants to stop."""

SPACING = 2.3e-16
"""Of doubles near 1."""

TINY, PATIENT = 1e-10, 1000
"""An adaptive march gets nowhere if so many steps in a row are below this share of the whole."""

HUGE = 1e300
HALF_TURN = pi

ANGLE, QUATERNION, QUATERNION_WITH_RATES = 1.0, 2.0, 3.0
"""Marks of coordinates, in the vector `turning`: those that mean the same after a full turn, and the first
of four Euler parameters, whose velocities are an angular velocity or their own rates at the same places."""

NEWTON_STEPS = 10

FEW_STEPS = 3
"""Of Newton's method for several states side by side, from where dense output has put them."""

NEAR = 1e-3
"""Health below which a configuration is near a singular one. Health falls with the square of the distance
there, and round-off in accelerations grows with the cube of its inverse."""

UNSAFE = 1e-8
"""Health of the equations of motion below which accelerations may be so wrong that a run would leave a
singular configuration on another branch. Only a run that starts there takes steps through it."""

HOP = 0.8
"""Factor for a step with a stage where accelerations are unsafe; the next one has its stages elsewhere."""

LEAVING = 1e-4
"""rad or m, within which accelerations are unsafe; what leaves slower than they would make it is at rest."""

STAYS = 1e-9
"""rad or m, by which a run may move from where it begins and still be said to stay there."""

DENSE_HEALTH = 1e-12
"""Health of what the dense path made of an unhealthy configuration; one that is singular has no more. Great
mass ratios alone leave more."""

SURE = 1e-10
"""Health of the least-squares problem above which its corrections are more than magnified round-off."""

SQUARING = 1e-4
"""Of Newton's method: a residual r leaves one of r^2 times a number that grows with the root of 1 / health; a
hundred such are allowed for."""

OPEN_TOLERANCE = 1e-9
"""Sizes of the mechanism, or rad, that a constraint may stay open after projection."""


@dataclass(frozen=True, eq=False)
class Equations(Record):
    """The equations of motion and constraints of a scene, as steppers call them.

    `position` writes the state after one Newton step, `velocity` one with its velocities projected; both
    write the residual they found, squared, in place n and their health after it, and take several states side
    by side, a lane each. `closing` does all of it where they are not healthy enough; it writes a number above
    0 in place n if it could.

    Attributes:
        n, nq: lengths of a state (q, v) and of q.
        inputs: length of a state with time and parameters.
        derivative, dense: rates and health of a state, compiled, and by the dense path.
        projecting: 1 if states are kept on the constraints, else 0.
        tolerance: residual below which constraints are closed, dimensionless.
        lanes: how many states `position` and `velocity` take.
        position, velocity, closing: projection.
        beside: (inputs + n + 2, lanes) scratch.
        pause: asks whether the user wants to stop.
        turning: (n,) marks of angles and Euler parameters.
        counts: (COUNTS,) what a run takes.
    """

    n: int
    nq: int
    inputs: int
    derivative: Callback
    dense: Callback
    projecting: int
    tolerance: float
    lanes: int
    position: Callback
    velocity: Callback
    closing: Callback
    beside: Vector
    pause: Callback
    turning: Vector
    counts: Vector


@dataclass(frozen=True, eq=False)
class Table(Record):
    """Where the states of a run are written.

    Attributes:
        count: of output times.
        kept: how many elements of a state outputs need, nq or n; the others are anything.
        times: (count,) s.
        states: (count, n).
    """

    count: int
    kept: int
    times: Vector
    states: Vector


@native
def evaluate(system: Equations, x: Vector, y: Vector) -> int:
    """y = derivative(x), by the dense path where the fast one calls itself unhealthy; returns a status."""
    system.derivative(x, y)
    system.counts[EVALUATIONS] += 1.0
    if not y[system.n] > 0.0:
        system.dense(x, y)
        system.counts[DENSE_CALLS] += 1.0
        if not y[system.n] > 0.0:
            return SINGULAR
        y[system.n] = DENSE_HEALTH
    size = 0.0
    for i in range(system.n):
        size += abs(y[i])
    if not size < HUGE:
        return NOT_FINITE
    return DONE


@native
def project_densely(system: Equations, x: Vector, scratch: Vector) -> int:
    """`project` by the dense path."""
    system.closing(x, scratch)
    if not scratch[system.n] > 0.0:
        return OPEN
    for i in range(system.n):
        x[i] = scratch[i]
    return DONE


@native
def spread(inputs: int, lanes: int, x: Vector, given: Vector) -> None:
    """The same x (inputs,) in all lanes of `given` (inputs, lanes)."""
    for i in range(inputs):
        for lane in range(lanes):
            given[lanes * i + lane] = x[i]


@native
def project(system: Equations, with_velocities: int, x: Vector) -> int:
    """Put a state on the constraints, positions first, velocities if wanted (1 or 0); returns a status.

    After `NEWTON_STEPS` the residual is found once more, for what the last one left is what counts.
    x (inputs,) is a state with time and parameters.
    """
    n = system.n
    lanes = system.lanes
    found = system.beside[lanes * system.inputs :]
    left = HUGE
    for step in range(NEWTON_STEPS + 1):
        spread(system.inputs, lanes, x, system.beside)
        system.position(system.beside, found)
        if not found[lanes * (n + 1)] > SURE:
            return project_densely(system, x, found)
        before = left
        left = found[lanes * n]
        # at round-off, or at an end
        if left < system.tolerance * system.tolerance or left >= 0.25 * before or step == NEWTON_STEPS:
            break
        for i in range(n):
            x[i] = found[lanes * i]
        if left * left < SQUARING * found[lanes * (n + 1)] * system.tolerance * system.tolerance:
            left = 0.0  # so the next one would find
            break
    if with_velocities == 1:
        spread(system.inputs, lanes, x, system.beside)
        system.velocity(system.beside, found)
        left = found[lanes * n]
        if left < HUGE and not found[lanes * (n + 1)] > SURE:
            return project_densely(system, x, found)
    if not left < HUGE:
        return NOT_FINITE
    if left > OPEN_TOLERANCE * OPEN_TOLERANCE:
        return OPEN
    if with_velocities == 1:
        for i in range(n):
            x[i] = found[lanes * i]
    return DONE


@native
def project_side_by_side(system: Equations, with_velocities: int) -> int:
    """`project` of a state in each lane of `beside`; 1 if a few steps did for all of them, else 0."""
    n = system.n
    lanes = system.lanes
    beside = system.beside
    found = beside[lanes * system.inputs :]
    settled = 0
    for _step in range(FEW_STEPS):
        settled = 0
        system.position(beside, found)
        for lane in range(lanes):
            left = found[lanes * n + lane]
            health = found[lanes * (n + 1) + lane]
            if not health > SURE:
                return 0
            if left < system.tolerance * system.tolerance:
                settled += 1
            else:
                for i in range(n):
                    beside[lanes * i + lane] = found[lanes * i + lane]
                if left * left < SQUARING * health * system.tolerance * system.tolerance:
                    settled += 1
        if settled == lanes:
            break
    if settled < lanes:
        return 0
    if with_velocities == 1:
        system.velocity(beside, found)
        for lane in range(lanes):
            left = found[lanes * n + lane]
            if not left <= OPEN_TOLERANCE * OPEN_TOLERANCE or not found[lanes * (n + 1) + lane] > SURE:
                return 0
        for i in range(lanes * n):
            beside[i] = found[i]
    return 1


@native
def record_rows(system: Equations, table: Table, first: int, end: int, near: int, x: Vector) -> int:
    """Put rows `first` to `end` of a table of states on the constraints, if wanted; returns a status.

    Near a singular configuration (`near` is 1) they are by the dense path. x has the parameters; the rest of
    it is scratch.
    """
    n = system.n
    lanes = system.lanes
    beside = system.beside
    with_velocities = 1 if table.kept == n else 0
    row = first
    while system.projecting == 1 and row < end:
        together = 0
        if near == 0 and lanes > 1:
            for lane in range(lanes):
                source = row + lane if row + lane < end else end - 1
                for i in range(n):
                    beside[lanes * i + lane] = table.states[n * source + i]
                beside[lanes * n + lane] = table.times[source]
                for i in range(n + 1, system.inputs):
                    beside[lanes * i + lane] = x[i]
            together = project_side_by_side(system, with_velocities)
        for lane in range(lanes if row + lanes < end else end - row):
            state = table.states[n * row :]
            if together == 1:
                for i in range(n):
                    state[i] = beside[lanes * i + lane]
            else:
                for i in range(n):
                    x[i] = state[i]
                x[n] = table.times[row]
                status = DONE
                if near == 1:
                    status = project_densely(system, x, beside)
                else:
                    status = project(system, with_velocities, x)
                if status != DONE:
                    return status
                for i in range(n):
                    state[i] = x[i]
            row += 1
            system.counts[WRITTEN] = float(row)
    system.counts[WRITTEN] = float(end)
    return DONE


@native
def unwind(system: Equations, x: Vector, before: Vector) -> None:
    """Take full turns off the angles that `turning` marks; `before` moves along.

    An angle of many turns has fewer digits than its sine needs, and a tolerance relative to it would let
    steps grow with it.
    """
    for i in range(system.n):
        if system.turning[i] == ANGLE and abs(x[i]) > HALF_TURN:
            turn = 2.0 * HALF_TURN if x[i] > 0.0 else -2.0 * HALF_TURN
            x[i] -= turn
            before[i] -= turn


@native
def keep_norms(system: Equations, x: Vector, before: Vector) -> None:
    """Give the Euler parameters p that `turning` marks norm 1, whatever a run does about its constraints.

    A norm n would scale rotations by n^2. It is one of coordinates, not of the mechanism: no drift that
    one would want to see. Rates become those of the same angular velocity of the body, 2 L pdot / n^2 at
    `before`, where they were taken (paper, equation 11); that may be x itself.
    """
    nq = system.nq
    for i in range(nq):
        if system.turning[i] >= QUATERNION:
            a = before[i]
            b = before[i + 1]
            c = before[i + 2]
            d = before[i + 3]
            square = a * a + b * b + c * c + d * d
            norm = sqrt(x[i] * x[i] + x[i + 1] * x[i + 1] + x[i + 2] * x[i + 2] + x[i + 3] * x[i + 3])
            for j in range(4):
                x[i + j] = x[i + j] / norm
            if system.turning[i] == QUATERNION_WITH_RATES:
                k = nq + i
                u = (a * x[k + 1] - b * x[k] - c * x[k + 3] + d * x[k + 2]) / square
                v = (a * x[k + 2] + b * x[k + 3] - c * x[k] - d * x[k + 1]) / square
                w = (a * x[k + 3] - b * x[k + 2] + c * x[k + 1] - d * x[k]) / square
                x[k] = -x[i + 1] * u - x[i + 2] * v - x[i + 3] * w
                x[k + 1] = x[i] * u - x[i + 3] * v + x[i + 2] * w
                x[k + 2] = x[i + 3] * u + x[i] * v - x[i + 1] * w
                x[k + 3] = -x[i + 2] * u + x[i + 1] * v + x[i] * w


@native
def interrupted(system: Equations) -> int:
    """1 if the user wants to stop, which is asked now and then, else 0."""
    counts = system.counts
    if int(counts[STEPS] + counts[REJECTED]) % PATIENCE == PATIENCE - 1:
        system.pause(counts, counts[WISH:])
    return int(counts[WISH])


@native
def record(system: Equations, table: Table, row: int, state: Vector) -> None:
    """Write a state into a row of the table."""
    for i in range(system.n):
        table.states[system.n * row + i] = state[i]
    system.counts[WRITTEN] = float(row + 1)


@native
def begin(system: Equations, table: Table, now: Vector) -> int:
    """Put the first state on the constraints if wanted, and into the table; returns a status."""
    if system.projecting == 1:
        status = project(system, 1, now)
        if status != DONE:
            return status
    record(system, table, 0, now)
    return DONE


@native
def leave(system: Equations, span: float, projecting: int, now: Vector, rates: Vector) -> int:
    """Whether a run of a span (s) may begin where it is singular, with its rates (n + 1) there; a status.

    Velocities say on which branch it goes on, and projection keeps it there. From rest the branch is not
    determined, unless nothing pulls and it stays.
    """
    speed = 0.0
    push = 0.0
    for i in range(system.nq, system.n):
        speed += abs(now[i])
        push += abs(rates[i])
    if push * span * span < STAYS and speed * span < STAYS:
        return DONE
    if speed * speed < LEAVING * push:
        return UNDETERMINED
    return DONE if projecting == 1 else UNPROJECTED


@dataclass(frozen=True, eq=False)
class Rows(Record):
    """A function of each state of a table.

    Attributes:
        count: of states.
        n, inputs: lengths of a state, and of one with time and parameters.
        m, lanes: how many results the function writes, and how many states it takes at once.
        function: of states.
        x: (inputs,) has the parameters.
        times, states: (count,) and (count, n).
        given, found: (inputs, lanes) and (m, lanes), scratch.
    """

    count: int
    n: int
    inputs: int
    m: int
    lanes: int
    function: Callback
    x: Vector
    times: Vector
    states: Vector
    given: Vector
    found: Vector


@native
def map_rows(rows: Rows, results: Vector) -> None:
    """results (count, m) = function of each row at its time, several rows at once."""
    n = rows.n
    m = rows.m
    lanes = rows.lanes
    for i in range(n + 1, rows.inputs):
        for lane in range(lanes):
            rows.given[lanes * i + lane] = rows.x[i]
    row = 0
    while row < rows.count:
        for lane in range(lanes):
            source = row + lane
            if source >= rows.count:
                source = rows.count - 1
            state = rows.states[n * source :]
            taken = rows.given[lane:]
            for i in range(n):
                taken[lanes * i] = state[i]
            taken[lanes * n] = rows.times[source]
        rows.function(rows.given, rows.found)
        for lane in range(lanes):
            if row + lane < rows.count:
                result = results[m * (row + lane) :]
                made = rows.found[lane:]
                for j in range(m):
                    result[j] = made[lanes * j]
        row += lanes


@native
def repeat(count: int, function: Callback, x: Vector, y: Vector) -> None:
    """The same function of the same x again and again, for benchmarks."""
    for _k in range(count):
        function(x, y)
