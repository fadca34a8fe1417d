"""Projection of states onto the constraints, and a check of the constraint violation without projection.

Integration errors open closed loops a little in each step. Projection closes them again: it moves the
coordinates by Newton steps of least length, then changes the velocities by a least-norm correction
(E. Eich-Soellner, C. Fuehrer, Numerical Methods in Multibody Dynamics, Teubner 1998, chapter 5). There are
three forms:

- `project` and `project_rows` in native code, by the compiled functions `Equations.position` and
  `Equations.velocity`;
- `project_position` and `project_velocity` in Python, for any `System` (equations of motion);
- the dense form, `newton_euler.integrators.dense_projection`, which native code uses near a singular
  configuration, where constraints become dependent.

The native functions take a *state with time and parameters*: one vector (inputs,) with the n coordinates and
velocities, the time, flags of constraint rows, and parameters of the scene
(`newton_euler.integrators.stepper`).

Functions marked `native` are compiled to machine code by `newton_euler.codegen`; they also run as plain
Python.
"""

from __future__ import annotations

from math import sqrt

import numpy as np

from newton_euler.codegen.native import Vector, native
from newton_euler.equations.coupling_equations import residuals
from newton_euler.equations.couplings import couplings, row_owners, row_units
from newton_euler.equations.dense import largest, minimum_norm
from newton_euler.equations.redundancy import constraint_rank, loose_tolerance, rows_left_out, with_zero_rows
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
from newton_euler.integrators.switches import choose_branches
from newton_euler.model.mechanism import CLOSURE_TOLERANCE, Mechanism
from newton_euler.model.scene import Scene
from newton_euler.model.state import State
from newton_euler.model.trajectory import IntegrationError
from newton_euler.scalars import Array

MAX_NATIVE_ITERATIONS = 10
"""Largest number of Newton steps in native code, which starts close to the constraints."""

MAX_LANE_ITERATIONS = 3
"""Largest number of Newton steps for interpolated outputs, which are very close to the constraints. They are
projected together, one state in each lane (element) of the processor's vector registers."""

MAX_ITERATIONS = 20
"""Largest number of Newton steps in Python, which also assembles mechanisms from rough initial positions."""

MIN_PIVOT = 1e-10
"""Smallest pivot ratio of the least-squares problem of a Newton step for which the step is accurate. Below
it, the dense form projects.

The pivot ratio is the smallest ratio of a pivot to its reference magnitude
(`newton_euler.equations.sparse`): 1 far from singular configurations, 0 in them."""

QUADRATIC_RATE = 1e-4
"""Factor that decides whether a Newton step is the last one.

The step reduces a dimensionless residual r to about r^2 / sqrt(pivot ratio). If 100 times this number is
below the tolerance, the residual after the step is not evaluated. The squares of both sides are compared,
so that the factor is 1 / 100^2."""

MIN_SHRINK = 0.5
"""If a rejected step is repeated with a shorter size, projection has to change the state by less than this
fraction of its change in the rejected step. A true error falls with a high power of the step size; round-off
does not."""

MAX_NOISE_GROWTH = 2.0
"""Largest factor by which the round-off in the change by projection may grow from one step to the next."""

MAX_DRIFT = 1e-2
"""Largest constraint violation of a joint without projection, in lengths of the longest body or in rad. A
larger violation is visible: the motion is no longer one of the mechanism."""


@native
def project_densely(system: Equations, x: Vector, scratch: Vector) -> Status:
    """Project coordinates and velocities of a state by the dense form; return `DONE` or `OPEN`.

    Args:
        system: the equations, whose `closing` has the data of the dense form.
        x: state with time and parameters (inputs,); changed only if the projection succeeds.
        scratch: (n + 1,) working memory, for the projected state and 1.0 for success or -1.0 for failure.
    """
    close(system.closing, x, scratch)
    if not scratch[system.n] > 0.0:
        return Status.OPEN
    for i in range(system.n):
        x[i] = scratch[i]
    return Status.DONE


@native
def copy_to_lanes(inputs: int, lanes: int, x: Vector, given: Vector) -> None:
    """Copy a state x (inputs,) into all lanes of `given` (inputs, lanes)."""
    for i in range(inputs):
        for lane in range(lanes):
            given[lanes * i + lane] = x[i]


@native
def project(system: Equations, with_velocities: int, x: Vector) -> Status:
    """Project one state onto the constraints, coordinates first, then velocities; return a status.

    Args:
        system: the equations. Residuals below `tolerance` need no step; a residual above `open_tolerance`
            after the last step is a failure (`OPEN`). Both are dimensionless.
        with_velocities: 1 to project velocities too, 0 for coordinates only.
        x: state with time and parameters (inputs,), changed.
    """
    n = system.n
    lanes = system.lanes
    # (n + 2, lanes) results of `position` and `velocity`: state, squared residual, pivot ratio
    results = system.projection_work[lanes * system.inputs :]
    squared_residual = HUGE
    # positions: Newton's iteration; the last round only evaluates the residual after the step before
    for step in range(MAX_NATIVE_ITERATIONS + 1):
        copy_to_lanes(system.inputs, lanes, x, system.projection_work)
        system.position(system.projection_work, results)
        if not results[lanes * (n + 1)] > MIN_PIVOT:
            return project_densely(system, x, results)
        previous = squared_residual
        squared_residual = results[lanes * n]
        # stop at round-off, if the residual does not halve any more, or after the last step
        if (
            squared_residual < system.tolerance * system.tolerance
            or squared_residual >= 0.25 * previous
            or step == MAX_NATIVE_ITERATIONS
        ):
            break
        for i in range(n):
            x[i] = results[lanes * i]
        if (
            squared_residual * squared_residual
            < QUADRATIC_RATE * results[lanes * (n + 1)] * system.tolerance * system.tolerance
        ):
            squared_residual = 0.0  # the quadratic convergence makes the next residual negligible
            break
    # velocities: one linear least-norm problem
    if with_velocities == 1:
        copy_to_lanes(system.inputs, lanes, x, system.projection_work)
        system.velocity(system.projection_work, results)
        squared_residual = results[lanes * n]
        if squared_residual < HUGE and not results[lanes * (n + 1)] > MIN_PIVOT:
            return project_densely(system, x, results)
    # check the remaining residual of positions
    if not squared_residual < HUGE:
        return Status.NOT_FINITE
    if squared_residual > system.open_tolerance * system.open_tolerance:
        return Status.OPEN
    if with_velocities == 1:
        for i in range(n):
            x[i] = results[lanes * i]
    return Status.DONE


@native
def project_side_by_side(system: Equations, with_velocities: int) -> int:
    """Project one state in each lane of `projection_work`; return 1 for success, 0 if a lane does not
    converge.

    Each lane computes the same as `project`. If the return value is 0, the caller projects each state alone.

    Args:
        with_velocities: 1 to project velocities too, 0 for coordinates only.
    """
    n = system.n
    lanes = system.lanes
    work = system.projection_work
    results = work[lanes * system.inputs :]
    previous = results[lanes * (n + 2) :]  # squared residual of each lane, 0 if the lane has converged
    # positions: at most a few steps of Newton's iteration in all lanes; give up if one lane needs more
    for lane in range(lanes):
        previous[lane] = HUGE
    unconverged = lanes
    for _step in range(MAX_LANE_ITERATIONS):
        system.position(work, results)
        unconverged = 0
        for lane in range(lanes):
            if previous[lane] > 0.0:
                squared_residual = results[lanes * n + lane]
                pivot_ratio = results[lanes * (n + 1) + lane]
                if not pivot_ratio > MIN_PIVOT or squared_residual >= 0.25 * previous[lane]:
                    return 0
                previous[lane] = squared_residual
                if squared_residual < system.tolerance * system.tolerance:
                    previous[lane] = 0.0
                else:
                    for i in range(n):
                        work[lanes * i + lane] = results[lanes * i + lane]
                    if (
                        squared_residual * squared_residual
                        < QUADRATIC_RATE * pivot_ratio * system.tolerance * system.tolerance
                    ):
                        previous[lane] = 0.0
                    else:
                        unconverged += 1
        if unconverged == 0:
            break
    if unconverged > 0:
        return 0
    # velocities
    if with_velocities == 1:
        system.velocity(work, results)
        for lane in range(lanes):
            squared_residual = results[lanes * n + lane]
            if (
                not squared_residual <= system.open_tolerance * system.open_tolerance
                or not results[lanes * (n + 1) + lane] > MIN_PIVOT
            ):
                return 0
        for i in range(lanes * n):
            work[i] = results[i]
    return 1


@native
def project_rows(
    system: Equations, table: Table, states: Vector, first: int, end: int, near: int, x: Vector
) -> Status:
    """Project the output states of a run, if the run projects; return a status.

    Args:
        table: output times, and `output_state_size`: n, or nq if outputs need coordinates only.
        states: (count, n) states of the run at the output times.
        first, end: the rows to project are `first` to `end` - 1.
        near: 1 near a singular configuration, where the dense form projects; else 0.
        x: state with time and parameters (inputs,) that gives flags and parameters; the state and the time
            are overwritten.
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
        # take the results, or project row by row if the projection side by side has failed
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
    """Prepare the start of a run: choose constraint rows, project, and write the first output.

    Args:
        states: (count, n) states of the run at the output times.
        now: state with time and parameters at the start, changed.
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
    """Prepare the start of a run of DOP853 or Radau, and check that it may start there; return a status.

    Args:
        states: (count, n) states of the run at the output times.
        now: state with time and parameters at the start, changed.
        rates: (n + 1,) rates (time derivatives) and pivot ratio at the start, written.
    """
    status = begin_run(system, states, now)
    if status == Status.DONE:
        choose_branches(system.switches, now)
        status = evaluate(system, now, rates)
    if status == Status.DONE and not rates[system.n] > DENSE_PIVOT_RATIO:
        span = table.times[table.count - 1] - now[system.n]
        status = check_singular_start(system, span, system.projecting, now, rates)
    return status


@native
def finish_step(system: Equations, near: int, now: Vector, other: Vector) -> Status:
    """Complete a step: unwind angles, normalize Euler parameters and project the state; return a status.

    To unwind an angle is to bring it back between -pi and pi by a full revolution.

    Args:
        near: 1 near a singular configuration, where the dense form projects; else 0.
        now: state with time and parameters at the end of the step, changed.
        other: (n,) another state, whose angles change by the same full revolutions.
    """
    unwind_angles(system, now, other)
    normalize_quaternions(system, now, now)
    if system.projecting == 0:
        return Status.DONE
    if near == 1:
        return project_densely(system, now, system.projection_work)
    return project(system, 1, now)


@native
def project_end(system: Equations, near: int, end: Vector, projected: Vector, unprojected: Vector) -> Status:
    """Complete a step that may still be rejected, without changing its start; return a status.

    Args:
        near: 1 near a singular configuration, where the dense form projects; else 0.
        end: (n + 1,) state and time at the end of the step, before projection.
        projected: state with time and parameters, written: the end after projection.
        unprojected: (n,) written: the end before projection, with angles in the same revolution as
            `projected`.
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
    """Compute the change of a state by projection: root mean square in units of the tolerance.

    This change is the part of a step's error that violates the constraints. Coordinates and velocities are
    measured by their norms, not one by one, because projection spreads the change over all of them, also over
    those near zero. Each group of coordinates and velocities that constraints connect is measured separately,
    and the largest result counts.

    Args:
        unprojected, projected: (n,) states before and after projection.
        rtol, atol: relative and absolute tolerance of a step.
    """
    largest_change = 0.0
    # `members` lists for each group: count of coordinates, their indices, count of velocities, their indices
    place = 0
    for _group in range(system.groups):
        squared_sum = 0.0
        elements = 0
        for _part in range(2):  # coordinates, then velocities
            count = int(system.members[place])
            change = 0.0  # sum of squares of the changes
            size = 0.0  # sum of squares of the elements
            for j in range(count):
                i = int(system.members[place + 1 + j])
                change += (projected[i] - unprojected[i]) * (projected[i] - unprojected[i])
                size += projected[i] * projected[i]
            if count > 0:
                scale = atol + rtol * sqrt(size / count)
                squared_sum += change / (scale * scale)
            place += count + 1
            elements += count
        largest_change = max(largest_change, squared_sum / elements)
    return sqrt(largest_change)


@native
def is_error_of_step(change: float, change_before: float, noise: float) -> int:
    """Return 1 if a step has to be rejected because projection changed its end too much, else 0.

    If bodies are far from the origin, round-off of the constraints can exceed the tolerance. Shorter steps do
    not reduce round-off. So a change that does not shrink with the step is accepted. Changes of about this
    size are then accepted in the following steps, too.

    Args:
        change: change of this step by projection, in units of the tolerance.
        change_before: change of the longer try of this step that was rejected just before; `HUGE` if there
            was none.
        noise: change of the last accepted step by projection if it was 1 or more, else 0.
    """
    return (
        1
        if change >= 1.0 and change >= MAX_NOISE_GROWTH * noise and change < MIN_SHRINK * change_before
        else 0
    )


@np.errstate(invalid="ignore")  # angles of several hinges in a row are NaN for orientations out of reach
def project_position(system: System, q: Array) -> Array:
    """Find the coordinates nearest to q that satisfy phi(q) = 0, by Newton steps of least length.

    Only independent constraints are solved. Exactly redundant ones are then satisfied, too. Almost redundant
    ones, whose rows of the Jacobian are dependent only up to a tolerance, keep a small residual.

    Args:
        q: (nq,) coordinates to start from.

    Raises:
        AssemblyError: if an independent constraint keeps a residual of more than `CLOSURE_TOLERANCE`, or an
            almost redundant one more than `newton_euler.equations.redundancy.loose_tolerance`.
    """
    at = best = system.retract(q, np.zeros(system.nv))
    if not len(system.phi_units):
        return best
    left_out = rows_left_out(system)  # almost redundant rows, which are replaced by zeros
    # iterate until the residual is at round-off, or has not improved twice in a row
    rounds_without_gain, least_residual = 0, np.inf
    for _ in range(MAX_ITERATIONS + 1):
        phi, jacobian = system.phi(at), with_zero_rows(system.phi_jacobian(at), left_out)
        residual = largest(with_zero_rows(phi, left_out))
        rounds_without_gain = 0 if residual < least_residual else rounds_without_gain + 1
        if rounds_without_gain == 0:
            best, least_residual = at, residual
        if (
            not np.isfinite(phi).all()
            or least_residual < RESIDUAL_ROUND_OFF * system.mechanism.size
            or rounds_without_gain == 2
        ):
            break
        step = minimum_norm(
            jacobian,
            with_zero_rows(phi, left_out),
            row_units=system.phi_units,
            column_units=system.velocity_units,
            max_rank=constraint_rank(system),
        )
        at = system.retract(at, -step)
    _check_closed(system, best, system.phi(best))
    return best


def _check_closed(system: System, q: Array, phi: Array) -> None:
    """Raise `AssemblyError` if residuals are too large; `project_position` states the limits.

    Args:
        q: (nq,) coordinates.
        phi: (k,) residuals of all constraints at q, m or rad.
    """
    left_out = rows_left_out(system)
    noise = largest(phi[left_out] / system.phi_units[left_out])
    loose = loose_tolerance(system.scene.redundancy_tolerance)
    if not (largest(with_zero_rows(phi, left_out)) <= CLOSURE_TOLERANCE and noise <= loose):
        joint, residual = worst_joint(system, system.state(q, np.zeros(system.nv)))
        raise AssemblyError(joint, residual, CLOSURE_TOLERANCE)


def project_velocity(system: System, q: Array, v: Array) -> Array:
    """Find the velocities nearest to v that satisfy the constraints' time derivative, Phi_q v + Phi_t = 0.

    Args:
        q: (nq,) coordinates.
        v: (nv,) velocities.
    """
    if not len(system.phi_units):
        return v
    left_out = rows_left_out(system)  # almost redundant rows, which are replaced by zeros
    jacobian = system.phi_jacobian(q)
    correction = minimum_norm(
        with_zero_rows(jacobian, left_out),
        with_zero_rows(rate_of_phi(system, jacobian, v), left_out),
        row_units=system.phi_units,
        column_units=system.velocity_units,
        max_rank=constraint_rank(system),
    )
    return np.asarray(v - correction)


def joint_violations(mechanism: Mechanism, state: State) -> Array:
    """Compute the constraint violations (j,) of all j joints: the largest residual of each, m or rad."""
    frames = state.frames()
    return np.array([largest(e.phi(frames[e.first], frames[e.second])) for e in mechanism.equations])


def check_still_closed(scene: Scene, times: Array, phi: Array) -> None:
    """Raise `IntegrationError` if a joint has drifted open by more than `MAX_DRIFT` at an output time.

    If a run starts with a larger violation, twice the initial violation is allowed, because Baumgarte
    stabilization (feedback of the violation) may still reduce it. A violation that disappears between two
    output times is not detected.

    Args:
        scene: the scene of the run.
        times: (n,) output times, s.
        phi: (n, k) residuals of all joints, then of couplings, m or rad.
    """
    coupled, mechanism = couplings(scene), scene.mechanism
    drifts = np.abs(phi) / row_units(mechanism.equations, coupled, mechanism.largest_extent)
    largest_drift = np.max(drifts, axis=1, initial=0.0)
    start = float(largest_drift[0])
    violations = np.flatnonzero(largest_drift > (MAX_DRIFT if start <= MAX_DRIFT else 2.0 * start))
    if not violations.size:
        return
    row = int(violations[0])
    worst = int(np.argmax(drifts[row]))
    owner = row_owners(mechanism.equations, coupled)[worst]
    drift = abs(float(phi[row, worst]))
    reason = f"joint {owner!r} drifted by {drift:.3g} (m or rad); use stabilization='projection'"
    raise IntegrationError(float(times[row]), reason)


def worst_joint(system: System, state: State) -> tuple[str, float]:
    """Return the name of the joint or coupling with the largest residual, and the residual, m or rad."""
    coupled = couplings(system.scene)
    phi = residuals(system.mechanism, coupled, state.frames(), system.time, state.angles).phi
    violations = np.concatenate([joint_violations(system.mechanism, state), np.abs(phi)])
    worst = int(np.argmax(violations))
    names = (*system.mechanism.joint_names, *(coupling.name for coupling in coupled))
    return names[worst], float(violations[worst])
