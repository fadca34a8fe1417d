"""Projection onto the constraints, and the drift that is left without it.

A state is projected after each step: coordinates by Newton's steps of least length, then velocities (E.
Eich-Soellner, C. Fuehrer, Numerical Methods in Multibody Dynamics, Teubner 1998, chapter 5). There are three
forms:

- native, on the compiled `position` and `velocity` of `Equations`; several rows of outputs side by side;
- in Python, for any `System`: `project_position`, `project_velocity`;
- next to a singular configuration: `newton_euler.integrators.dense_projection`.
"""

from __future__ import annotations

from math import sqrt

import numpy as np

from newton_euler.codegen.native import Vector, native
from newton_euler.equations.couplings import couplings, residuals, row_owners, row_units
from newton_euler.equations.dense import largest, minimum_norm
from newton_euler.equations.redundancy import constraint_rank, loosely_closed, rows_left_out, without
from newton_euler.equations.system import System, rate_of_phi
from newton_euler.errors import AssemblyError
from newton_euler.integrators.dense_projection import RESIDUAL_ROUND_OFF, close
from newton_euler.integrators.row_exchange import exchange_rows
from newton_euler.integrators.singular import DENSE_PIVOT_RATIO, check_singular_start, evaluate
from newton_euler.integrators.status import Status
from newton_euler.integrators.stepper import (
    HUGE,
    Count,
    Equations,
    Table,
    normalize_quaternions,
    unwind_angles,
    write_row,
)
from newton_euler.model.mechanism import CLOSURE_TOLERANCE, Mechanism
from newton_euler.model.scene import Scene
from newton_euler.model.state import State
from newton_euler.model.trajectory import IntegrationError
from newton_euler.scalars import Array

MAX_NATIVE_ITERATIONS = 10
"""Newton's steps in native code, which begins near the constraints."""

MAX_LANE_ITERATIONS = 3
"""Largest number of iterations for states in lanes, which dense output has placed close to the
constraints."""

MAX_ITERATIONS = 20
"""Largest number of iterations in Python, where mechanisms are assembled too."""

MIN_PIVOT = 1e-10
"""Pivot ratio of the least-squares problem above which its corrections are more than magnified round-off."""

QUADRATIC_RATE = 1e-4
"""A residual r leaves one of r^2 times a number that grows with the root of 1 / pivot ratio; a hundred such
are allowed for."""

MIN_SHRINK = 0.5
"""Factor by which projection has to change a shorter step less than the longer one before it. The change
falls with a high power of the step; what does not fall is round-off."""

MAX_NOISE_GROWTH = 2.0
"""Factor by which the round-off in the change by projection may grow from one step to the next."""

MAX_DRIFT = 1e-2
"""Lengths of the mechanism's longest body, or rad, by which a joint may drift without projection before what
runs on is another mechanism: a hundredth can be seen."""


@native
def project_densely(system: Equations, x: Vector, scratch: Vector) -> Status:
    """Project as `project` does, by the dense form; `scratch` is (n + 1,)."""
    close(system.closing, x, scratch)
    if not scratch[system.n] > 0.0:
        return Status.OPEN
    for i in range(system.n):
        x[i] = scratch[i]
    return Status.DONE


@native
def copy_to_lanes(inputs: int, lanes: int, x: Vector, given: Vector) -> None:
    """Copy x (inputs,) into all lanes of `given` (inputs, lanes)."""
    for i in range(inputs):
        for lane in range(lanes):
            given[lanes * i + lane] = x[i]


@native
def project(system: Equations, with_velocities: int, x: Vector) -> Status:
    """Put a state on the constraints, positions first, velocities if wanted (1 or 0); returns a status.

    After `MAX_NATIVE_ITERATIONS` the residual is found once more, for what the last one left is what counts.
    x (inputs,) is a state with time and parameters.
    """
    n = system.n
    lanes = system.lanes
    found = system.projection_work[lanes * system.inputs :]
    left = HUGE
    # positions: Newton's iteration
    for step in range(MAX_NATIVE_ITERATIONS + 1):
        copy_to_lanes(system.inputs, lanes, x, system.projection_work)
        system.position(system.projection_work, found)
        if not found[lanes * (n + 1)] > MIN_PIVOT:
            return project_densely(system, x, found)
        before = left
        left = found[lanes * n]
        # at round-off, or at an end
        if (
            left < system.tolerance * system.tolerance
            or left >= 0.25 * before
            or step == MAX_NATIVE_ITERATIONS
        ):
            break
        for i in range(n):
            x[i] = found[lanes * i]
        if left * left < QUADRATIC_RATE * found[lanes * (n + 1)] * system.tolerance * system.tolerance:
            left = 0.0  # so the next one would find
            break
    # velocities: one linear least-norm problem
    if with_velocities == 1:
        copy_to_lanes(system.inputs, lanes, x, system.projection_work)
        system.velocity(system.projection_work, found)
        left = found[lanes * n]
        if left < HUGE and not found[lanes * (n + 1)] > MIN_PIVOT:
            return project_densely(system, x, found)
    # check the residual of positions that is left
    if not left < HUGE:
        return Status.NOT_FINITE
    if left > system.open_tolerance * system.open_tolerance:
        return Status.OPEN
    if with_velocities == 1:
        for i in range(n):
            x[i] = found[lanes * i]
    return Status.DONE


@native
def project_side_by_side(system: Equations, with_velocities: int) -> int:
    """Project a state in each lane of `work`, each as `project` does; 1 if a few steps did for all of them,
    else 0."""
    n = system.n
    lanes = system.lanes
    work = system.projection_work
    found = work[lanes * system.inputs :]
    before = found[lanes * (n + 2) :]  # squared residual, 0 where nothing is left to do
    # positions: at most a few steps of Newton's iteration in all lanes; give up if one lane needs more
    for lane in range(lanes):
        before[lane] = HUGE
    unsettled = lanes
    for _step in range(MAX_LANE_ITERATIONS):
        system.position(work, found)
        unsettled = 0
        for lane in range(lanes):
            if before[lane] > 0.0:
                left = found[lanes * n + lane]
                pivot_ratio = found[lanes * (n + 1) + lane]
                if not pivot_ratio > MIN_PIVOT or left >= 0.25 * before[lane]:
                    return 0
                before[lane] = left
                if left < system.tolerance * system.tolerance:
                    before[lane] = 0.0
                else:
                    for i in range(n):
                        work[lanes * i + lane] = found[lanes * i + lane]
                    if left * left < QUADRATIC_RATE * pivot_ratio * system.tolerance * system.tolerance:
                        before[lane] = 0.0
                    else:
                        unsettled += 1
        if unsettled == 0:
            break
    if unsettled > 0:
        return 0
    # velocities
    if with_velocities == 1:
        system.velocity(work, found)
        for lane in range(lanes):
            left = found[lanes * n + lane]
            if (
                not left <= system.open_tolerance * system.open_tolerance
                or not found[lanes * (n + 1) + lane] > MIN_PIVOT
            ):
                return 0
        for i in range(lanes * n):
            work[i] = found[i]
    return 1


@native
def project_rows(
    system: Equations, table: Table, states: Vector, first: int, end: int, near: int, x: Vector
) -> Status:
    """Put rows `first` to `end` of the states of a run on the constraints, if wanted; returns a status.

    Near a singular configuration (`near` is 1) they are by the dense form. x has the parameters; the rest of
    it is scratch.
    """
    n = system.n
    lanes = system.lanes
    work = system.projection_work
    with_velocities = 1 if table.output_state_size == n else 0
    row = first
    while system.projecting == 1 and row < end:
        # project as many rows as there are lanes side by side
        together = 0
        if lanes > 1 and near == 0:
            for lane in range(lanes):
                source = row + lane if row + lane < end else end - 1
                for i in range(n):
                    work[lanes * i + lane] = states[n * source + i]
                work[lanes * n + lane] = table.times[source]
                for i in range(n + 1, system.inputs):
                    work[lanes * i + lane] = x[i]
            together = project_side_by_side(system, with_velocities)
        # take the results, or project row by row if that failed
        for lane in range(lanes if row + lanes < end else end - row):
            state = states[n * row :]
            if together == 1:
                for i in range(n):
                    state[i] = work[lanes * i + lane]
            else:
                for i in range(n):
                    x[i] = state[i]
                x[n] = table.times[row]
                status = Status.DONE
                if near == 1:
                    status = project_densely(system, x, work)
                else:
                    status = project(system, with_velocities, x)
                if status != Status.DONE:
                    return status
                for i in range(n):
                    state[i] = x[i]
            row += 1
            system.counts[Count.ROWS_WRITTEN] = float(row)
    system.counts[Count.ROWS_WRITTEN] = float(end)
    return Status.DONE


@native
def begin_run(system: Equations, states: Vector, now: Vector) -> Status:
    """Put the first state of a run on the constraints if wanted, and into its states; returns a status.

    The rows in use are chosen for it.
    """
    exchange_rows(system.exchange, now)
    if system.projecting == 1:
        status = project(system, 1, now)
        if status != Status.DONE:
            return status
    write_row(system, states, 0, now)
    return Status.DONE


@native
def begin_adaptive(system: Equations, table: Table, states: Vector, now: Vector, rates: Vector) -> Status:
    """Begin, and evaluate the rates (n + 1) of the first state; returns a status."""
    status = begin_run(system, states, now)
    if status == Status.DONE:
        status = evaluate(system, now, rates)
    if status == Status.DONE and not rates[system.n] > DENSE_PIVOT_RATIO:
        span = table.times[table.count - 1] - now[system.n]
        status = check_singular_start(system, span, system.projecting, now, rates)
    return status


@native
def finish_step(system: Equations, near: int, now: Vector, carried: Vector) -> Status:
    """Complete a step: angles within half a revolution, norms 1, on the constraints; returns a status.

    Near a singular configuration (`near` is 1) projection is by the dense form. `carried` moves with angles.
    """
    unwind_angles(system, now, carried)
    normalize_quaternions(system, now, now)
    if system.projecting == 0:
        return Status.DONE
    if near == 1:
        return project_densely(system, now, system.projection_work)
    return project(system, 1, now)


@native
def project_end(system: Equations, near: int, end: Vector, projected: Vector, unprojected: Vector) -> Status:
    """Complete a step that may still be rejected; returns a status.

    Args:
        near: 1 near a singular configuration, where projection is by the dense form, else 0.
        end: state (n,) where the step ends, and the time.
        projected: state with time and parameters, which becomes the completed end.
        unprojected: (n,) becomes the end, with its angles in the revolutions of `projected`.
    """
    for i in range(system.n):
        projected[i] = end[i]
        unprojected[i] = end[i]
    projected[system.n] = end[system.n]
    return finish_step(system, near, projected, unprojected)


@native
def change_by_projection(
    system: Equations, unprojected: Vector, projected: Vector, rtol: float, atol: float
) -> float:
    """Compute how far projection moved a state (n,): root mean square in units of the tolerance.

    The change is the part of a step's error that opens the constraints. The error estimate of a step cannot
    see the change. Coordinates and velocities are measured by their norms, not one by one: projection spreads
    the change over all of them, those that are near zero included. Each group that constraints connect is
    measured by itself, and the largest change counts.
    """
    largest_change = 0.0
    place = 0
    for _group in range(system.groups):
        total = 0.0
        counted = 0
        for _part in range(2):
            count = int(system.members[place])
            change = 0.0
            size = 0.0
            for j in range(count):
                i = int(system.members[place + 1 + j])
                change += (projected[i] - unprojected[i]) * (projected[i] - unprojected[i])
                size += projected[i] * projected[i]
            if count > 0:
                scale = atol + rtol * sqrt(size / count)
                total += change / (scale * scale)
            place += count + 1
            counted += count
        largest_change = max(largest_change, total / counted)
    return sqrt(largest_change)


@native
def is_error_of_step(moved: float, before: float, noise: float) -> int:
    """Return 1 if a step has to be rejected for the change by projection, else 0.

    Far from the origin, round-off of the constraints can exceed the tolerance. Shorter steps do not reduce
    round-off, so a change that does not shrink with the step is accepted, and so are changes of about this
    size in the steps that follow.

    Args:
        moved: change of this step, in tolerances.
        before: change of the longer step that was rejected just before; `HUGE` if there was none.
        noise: change of the step accepted last if it was 1 or more, else 0.
    """
    return 1 if moved >= 1.0 and moved >= MAX_NOISE_GROWTH * noise and moved < MIN_SHRINK * before else 0


@np.errstate(invalid="ignore")  # of hinges in a row, which do not reach every orientation
def project_position(system: System, q: Array) -> Array:
    """Find the coordinates near q that meet phi(q) = 0 to round-off, by Newton's steps of least length.

    Nearly redundant constraints stay open as far as the others leave them.

    Raises:
        AssemblyError: if the independent constraints stay open by more than `CLOSURE_TOLERANCE`, or nearly
            redundant ones by more than the scene's tolerance.
    """
    at = best = system.retract(q, np.zeros(system.nv))
    if not len(system.phi_units):
        return best
    unused = rows_left_out(system)
    worse, least = 0, np.inf
    for _ in range(MAX_ITERATIONS + 1):
        phi, jacobian = system.phi(at), without(system.phi_jacobian(at), unused)
        open_by = largest(without(phi, unused))
        worse = 0 if open_by < least else worse + 1
        if worse == 0:
            best, least = at, open_by
        if not np.isfinite(phi).all() or least < RESIDUAL_ROUND_OFF * system.mechanism.size or worse == 2:
            break
        step = minimum_norm(
            jacobian, without(phi, unused), system.phi_units, system.velocity_units, constraint_rank(system)
        )
        at = system.retract(at, -step)
    _check_closed(system, best, system.phi(best))
    return best


def _check_closed(system: System, q: Array, phi: Array) -> None:
    """Raise `AssemblyError` for residuals (k,) at q beyond `CLOSURE_TOLERANCE`, or noise of rows left out."""
    unused = rows_left_out(system)
    noise = largest(phi[unused] / system.phi_units[unused])
    loose = loosely_closed(system.scene.redundancy_tolerance)
    if not (largest(without(phi, unused)) <= CLOSURE_TOLERANCE and noise <= loose):
        joint, residual = worst_joint(system, system.state(q, np.zeros(system.nv)))
        raise AssemblyError(joint, residual, CLOSURE_TOLERANCE)


def project_velocity(system: System, q: Array, v: Array) -> Array:
    """Find the velocities nearest to v that meet the constraints' rate, Phi_q v + Phi_t = 0."""
    if not len(system.phi_units):
        return v
    unused = rows_left_out(system)
    jacobian = system.phi_jacobian(q)
    excess = without(rate_of_phi(system, jacobian, v), unused)
    units = system.phi_units, system.velocity_units
    step = minimum_norm(without(jacobian, unused), excess, *units, constraint_rank(system))
    return np.asarray(v - step)


def joint_violations(mechanism: Mechanism, state: State) -> Array:
    """Evaluate the largest residual (j,) of each joint's equations in a state, m or rad."""
    frames = state.frames()
    return np.array([largest(e.phi(frames[e.first], frames[e.second])) for e in mechanism.equations])


def check_still_closed(scene: Scene, times: Array, phi: Array) -> None:
    """Raise `IntegrationError` at the first of times (n,) with a residual (n, k) of more than `MAX_DRIFT`.

    Residuals are those of all joints, then of couplings. Where the first are larger than that, as of a start
    that nobody has checked, twice as much is allowed: gains may still close it. Nothing is known of the steps
    between the times, which are those of outputs: a joint that closes again by the next one passes.
    """
    coupled, mechanism = couplings(scene), scene.mechanism
    drifts = np.abs(phi) / row_units(mechanism.equations, coupled, mechanism.longest)
    largest_drift = np.max(drifts, axis=1, initial=0.0)
    start = float(largest_drift[0])
    wide = np.flatnonzero(largest_drift > (MAX_DRIFT if start <= MAX_DRIFT else 2.0 * start))
    if not wide.size:
        return
    row = int(wide[0])
    worst = int(np.argmax(drifts[row]))
    owner = row_owners(mechanism.equations, coupled)[worst]
    drift = abs(float(phi[row, worst]))
    reason = f"joint {owner!r} drifted by {drift:.3g} (m or rad); use stabilization='projection'"
    raise IntegrationError(float(times[row]), reason)


def worst_joint(system: System, state: State) -> tuple[str, float]:
    """Find the joint or gear with the largest residual: its name and that residual, m or rad."""
    coupled = couplings(system.scene)
    phi = residuals(system.mechanism, coupled, state.frames(), system.time, state.angles).phi
    violations = np.concatenate([joint_violations(system.mechanism, state), np.abs(phi)])
    worst = int(np.argmax(violations))
    names = (*system.mechanism.joint_names, *(coupling.name for coupling in coupled))
    return names[worst], float(violations[worst])
