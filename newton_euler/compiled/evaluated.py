"""Integration of equations of motion that Python evaluates, such as Pinocchio's.

The integrator is native code, and calls back into Python for accelerations and for projection onto the
constraints. Constraints become dependent in a singular configuration. The pivot ratio of a state measures the
distance from it. Here the ratio is (smallest singular value of the constraint Jacobian / largest one)^2,
divided by the largest such number in the sample configurations of
`newton_euler.equations.redundancy.Mobility`.

Constraint rows that are redundant but for rounded numbers of a model file are left out. The others, also
exactly redundant ones, are the rows in use.
"""

from __future__ import annotations

import copy
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from newton_euler.compiled.callbacks import Callbacks, PythonCallback, vector_at
from newton_euler.compiled.constraint_groups import constraint_groups, group_places
from newton_euler.compiled.equations import OPEN_TOLERANCE
from newton_euler.compiled.failures import least_independent, near_singular
from newton_euler.compiled.records import dop853_of, fixed_step_of, radau_of
from newton_euler.compiled.run import METHODS, native_method
from newton_euler.equations.applied_forces import (
    surroundings,
    too_many_or_small_steps,
    with_likely_causes,
)
from newton_euler.equations.cartesian import Cartesian
from newton_euler.equations.dense import singular_values
from newton_euler.equations.load_friction import jam
from newton_euler.equations.redundancy import constraint_rank, mobility, rows_left_out
from newton_euler.equations.relative import Relative
from newton_euler.equations.system import System, at_time, rate_of_phi
from newton_euler.errors import AssemblyError
from newton_euler.integrators.constraint_ratio import no_ratio
from newton_euler.integrators.dense_projection import RESIDUAL_ROUND_OFF, closing_of
from newton_euler.integrators.options import FIXED, Options
from newton_euler.integrators.projection import worst_joint
from newton_euler.integrators.row_exchange import no_exchange
from newton_euler.integrators.singular import DENSE_PIVOT_RATIO, NEAR_PIVOT_RATIO
from newton_euler.integrators.status import Status
from newton_euler.integrators.stepper import (
    COUNTS,
    QUATERNION,
    QUATERNION_WITH_RATES,
    Count,
    Equations,
    Table,
)
from newton_euler.integrators.switches import no_switches
from newton_euler.model.mechanism import CLOSURE_TOLERANCE
from newton_euler.model.trajectory import IntegrationError
from newton_euler.scalars import Array

JACOBIAN_STEP = 1e-8
"""Step of the difference quotients for the Jacobian, relative to the magnitude of each coordinate or
velocity.

The step is absolute (m or rad, or per s) for magnitudes below 1."""

MAX_EVALUATED_STEPS = 50_000
"""Number of steps at which a run stops, if its option `most_steps` is not set."""


def integrate(
    system: System, q: Array, v: Array, times: Array, options: Options
) -> tuple[Array, dict[str, int], IntegrationError | None]:
    """Integrate the equations of motion of a system over given output times.

    A run stops early if steps become too small, if numbers are not finite, or if the equations or the
    constraints have no solution. The error has the time, the reason, and the fastest joint or largest force.

    Args:
        system: equations of motion that Python evaluates.
        q: (nq,) initial coordinates.
        v: (nv,) initial velocities.
        times: (n,) s, output times; the first is the start.
        options: integrator and step control.

    Returns:
        States (q, v) at the output times reached, (rows, nq + nv); numbers of steps and evaluations; the
        error that stopped the run, None for a complete run.
    """
    # one run with a table of its states at the output times
    evaluated = EvaluatedSystem(system, options)
    n, start = system.nq + system.nv, np.concatenate([q, v, times[:1]])
    states = np.zeros((len(times), n))
    table = Table(
        count=len(times),
        output_state_size=n,
        runs=1,
        stride=1,  # the numbers of successive runs differ by 1
        first=np.zeros(1),
        times=np.array(times, dtype=float),
        ends=start[None],
        states=states,
        tallies=np.zeros((1, COUNTS)),
    )
    # the integrator and its work arrays
    max_steps = options.most_steps or MAX_EVALUATED_STEPS
    method: Any
    if options.integrator in FIXED:
        rate = evaluated.callback(system.nq, evaluated.rate) if options.integrator == "Euler" else None
        method = fixed_step_of(n=n, inputs=n + 1, options=options, rate=rate)
    elif options.integrator == "Radau":
        jacobian = evaluated.callback(n * n, evaluated.jacobian)
        method = radau_of(n=n, inputs=n + 1, options=options, max_steps=max_steps, jacobian=jacobian)
    else:
        # the residual of almost redundant rows widens the tolerances near a singular configuration
        near = options.near_singular(mobility(system.scene).residual, system.mechanism.size)
        units = np.zeros(n)  # m or rad: a smaller coordinate has the round-off of this magnitude
        units[: system.nq] = min(1.0, system.mechanism.size)
        method = dop853_of(n=n, inputs=n + 1, options=options, near=near, max_steps=max_steps, units=units)
    # integrate
    integrate = METHODS[options.integrator]
    with evaluated.interruptible(), np.errstate(all="ignore"):  # the integrator rejects infinite numbers
        native_method(integrate)(integrate, evaluated.equations, table, method)
    found = {"steps": int(evaluated.counts[Count.STEPS]), "evaluations": evaluated.evaluations}
    last = start[:-1]  # the integrator has overwritten `start` with the end of the run
    stopped = evaluated.failure(last, max_steps)
    return states[: int(evaluated.counts[Count.ROWS_WRITTEN])], found, stopped


class EvaluatedSystem(Callbacks):
    """Equations of motion in Python, wrapped in callbacks for a native integrator.

    Attributes:
        equations: record of callbacks and sizes that the native integrator reads.
        evaluations: number of evaluations of the accelerations so far.
    """

    def __init__(self, system: System, options: Options) -> None:
        """Select the constraint rows in use and wrap the equations.

        Args:
            system: equations of motion; the callbacks work on a copy.
            options: integrator and stabilization.
        """
        super().__init__(np.zeros(COUNTS))
        self._system = copy.copy(system)  # a copy, because callbacks change its time
        # constraint rows in use, and whether the run must watch for singular configurations
        self._kept = np.delete(np.arange(len(system.phi_units)), rows_left_out(system))
        self._phi_units = system.phi_units[self._kept]
        self._rank = constraint_rank(system)
        self._options = options
        self.evaluations = 0
        self._reference_ratio = 0.0
        # DOP853 alone avoids steps that end at a singular configuration, where a run could continue on
        # another branch of the motion; without projection it does not look for singular configurations
        watches = options.integrator == "DOP853" and options.projection and self._rank > 0
        if watches:
            self._reference_ratio = self._largest_ratio()
        # marks of the first elements of quaternions, which the integrator normalizes
        n, nq, nv, rows = system.nq + system.nv, system.nq, system.nv, len(self._kept)
        marks = np.zeros(n)
        # the Cartesian form has rates of quaternions as velocities, the other systems angular velocities
        mark = QUATERNION_WITH_RATES if isinstance(system, Cartesian) else QUATERNION
        marks[[place.start for place in system.quaternions]] = mark
        # the record for the native integrator; the change by projection is measured for each group of
        # coordinates and velocities that constraints connect
        groups = constraint_groups(system) if options.projection and rows > 0 else np.zeros(0)
        derivative = self.callback(n + 1, self._derivative)
        self.equations = Equations(
            n=n,
            nq=nq,
            inputs=n + 1,
            flags=0,
            derivative=derivative,
            dense=derivative,  # there is no second form to fall back to
            loses_rank=int(watches),
            ratio=no_ratio(),  # the pivot ratios of `derivative` do not depend on masses
            projecting=int(options.projection and rows > 0),
            tolerance=RESIDUAL_ROUND_OFF,
            open_tolerance=OPEN_TOLERANCE,
            lanes=1,
            position=self.callback(n + 2, self._position),
            velocity=self.callback(n + 2, self._velocity),
            closing=closing_of(  # projection with dense matrices near singular configurations
                nq=nq,
                units=system.velocity_units,
                inputs=n + 1,
                places=([*range(rows * nv)], [*range(nv * nv)]),  # all elements of Phi_q and M
                constraints=rows,
                functions=(
                    self.callback(nq, self._system.retract),
                    self.callback(2 * rows + rows * nv + nv * nv, self._surface),
                ),
            ),
            exchange=no_exchange(n + 1),
            switches=no_switches(),
            projection_work=np.zeros(2 * n + 4),
            pause=self.pause,
            marks=marks,
            groups=int(groups.max(initial=0.0)),
            members=group_places(groups, nq),
            counts=self.counts,
        )

    def callback(self, size: int, function: Callable[[Array, Array], Array]) -> PythonCallback:
        """Wrap a function of (q, v) for native code.

        Args:
            size: length of the result.
            function: computes the result (size,) from q (nq,) and v (nv,). If it raises an error of the
                equations, the result is NaN, and -1.0 in its last element.
        """
        system, inputs = self._system, self._system.nq + self._system.nv + 1

        # `on` is native code's bit mask of active runs, not needed for a single run
        def call(x: int, y: int, on: int) -> None:
            """Evaluate the function at the state and time at address x; write the result to address y."""
            state = vector_at(x, inputs).copy()
            system.time = float(state[-1])
            vector_at(y, size)[:] = function(state[: system.nq], state[system.nq : -1])

        def failed(y: int, on: int) -> None:
            """Mark the result at address y as missing."""
            results = vector_at(y, size)
            results[:] = np.nan
            results[-1] = -1.0

        return self.guarded(call, failed)

    def rate(self, q: Array, v: Array) -> Array:
        """Compute dq/dt (nq,)."""
        return self._system.rate(q, v)

    def _rates(self, q: Array, v: Array) -> Array:
        """Compute dq/dt and dv/dt, one vector (n,)."""
        self.evaluations += 1
        return np.concatenate([self._system.rate(q, v), self._system.acceleration(q, v)])

    def _derivative(self, q: Array, v: Array) -> Array:
        """Compute dq/dt and dv/dt, followed by the pivot ratio, one vector (n + 1,)."""
        rates, ratio = self._rates(q, v), 1.0
        if self._reference_ratio > 0.0:
            # above `DENSE_PIVOT_RATIO`, by which the integrator knows a singular state: these equations have
            # no second form to evaluate there
            ratio = max(self._ratio(self._jacobian(q)) / self._reference_ratio, 2.0 * DENSE_PIVOT_RATIO)
        return np.append(rates, ratio)

    def jacobian(self, q: Array, v: Array) -> Array:
        """Compute the Jacobian of (dq/dt, dv/dt) with respect to (q, v) by one-sided differences.

        Returns:
            The Jacobian, row by row, (n * n,).
        """
        rates, y = self._rates(q, v), np.concatenate([q, v])
        columns = np.empty((len(y), len(y)))
        for k, h in enumerate(JACOBIAN_STEP * np.maximum(1.0, np.abs(y))):
            moved = y.copy()
            moved[k] += h
            columns[k] = (self._rates(moved[: len(q)], moved[len(q) :]) - rates) / h
        return columns.T.ravel()

    def _jacobian(self, q: Array) -> Array:
        """Compute the dimensionless Jacobian (k, nv) of the constraint rows in use at q (nq,)."""
        rows = self._system.phi_jacobian(q)[self._kept]
        return np.asarray(rows * self._system.velocity_units / self._phi_units[:, None])

    def _largest_ratio(self) -> float:
        """Compute the largest ratio, see `_ratio`, in the sample configurations of the scene."""
        system = self._system
        states = mobility(system.scene).states
        return max((self._ratio(self._jacobian(system.coordinates(each)[0])) for each in states), default=0.0)

    def _ratio(self, jacobian: Array) -> float:
        """Compute the squared ratio of the smallest to the largest singular value of a Jacobian (k, nv).

        Singular values beyond the rank of the constraints are ignored.
        """
        values = np.linalg.svd(jacobian, compute_uv=False)
        return float((values[self._rank - 1] / values[0]) ** 2)

    def _position(self, q: Array, v: Array) -> Array:
        """Take one Newton step from q onto the constraints.

        Returns:
            New q, v, squared dimensionless residual before the step, pivot ratio; one vector (n + 2,).
        """
        phi = self._system.phi(q)[self._kept] / self._phi_units
        residual = float(phi @ phi)
        if residual < RESIDUAL_ROUND_OFF**2:
            return np.concatenate([q, v, [residual, 1.0]])
        step, ratio = self._least_step(self._jacobian(q), phi)
        return np.concatenate([self._system.retract(q, -step), v, [residual, ratio]])

    def _velocity(self, q: Array, v: Array) -> Array:
        """Project the velocities v onto those that keep the constraints closed.

        Returns:
            q, new v, squared dimensionless residual at q, pivot ratio; one vector (n + 2,).
        """
        phi = self._system.phi(q)[self._kept] / self._phi_units
        rows = self._system.phi_jacobian(q)
        excess = rate_of_phi(self._system, rows, v)[self._kept] / self._phi_units
        jacobian = rows[self._kept] * self._system.velocity_units / self._phi_units[:, None]
        step, ratio = self._least_step(jacobian, excess)
        return np.concatenate([q, v - step, [float(phi @ phi), ratio]])

    def _least_step(self, jacobian: Array, residual: Array) -> tuple[Array, float]:
        """Compute the shortest step that changes the constraints by a given residual, by singular values.

        Args:
            jacobian: (k, nv) dimensionless Jacobian of the constraint rows in use.
            residual: (k,) dimensionless residuals, or their rates.

        Returns:
            The step (nv,), m or rad, or per s; the squared ratio of the smallest to the largest singular
            value.
        """
        if self._rank == 0:
            return np.zeros(len(jacobian.T)), 1.0
        u, s, vt = singular_values(jacobian)
        u, s, vt = u[:, : self._rank], s[: self._rank], vt[: self._rank]
        step = self._system.velocity_units * (vt.T @ (u.T @ residual / s))
        return step, float((s[-1] / s[0]) ** 2)

    def _surface(self, q: Array, v: Array) -> Array:
        """Evaluate what dense projection near a singular configuration needs, all dimensionless.

        Returns:
            Constraint residuals Phi (k,), their rates dPhi/dt (k,), the constraint Jacobian Phi_q (k, nv) and
            the mass matrix M (nv, nv); one vector.
        """
        system, units = self._system, self._system.velocity_units
        phi, rows = system.phi(q)[self._kept] / self._phi_units, system.phi_jacobian(q)
        rates = rate_of_phi(system, rows, v)[self._kept] / self._phi_units
        jacobian = rows[self._kept] * units / self._phi_units[:, None]
        mass = system.mass_and_force(q, np.zeros(len(v)))[0] * np.outer(units, units)
        return np.concatenate([phi, rates, jacobian.ravel(), mass.ravel()])

    def _is_near_singular(self, q: Array) -> bool:
        """Return True if the pivot ratio at q (nq,) is that of a configuration near a singular one."""
        if self._rank == 0 or not np.isfinite(q).all():
            return False
        return self._ratio(self._jacobian(q)) < NEAR_PIVOT_RATIO * self._largest_ratio()

    def failure(self, last: Array, max_steps: int) -> IntegrationError | None:
        """Explain why a run ended early; return None for a complete run.

        Args:
            last: (n,) the last state (q, v).
            max_steps: number of steps at which the run stops.

        Raises:
            KeyboardInterrupt: if the user interrupted the run.
            BaseException: a programming error in the equations.
        """
        status, error = Status(int(self.counts[Count.STATUS])), self.error
        if status == Status.DONE:
            return None
        if status == Status.INTERRUPTED:
            raise self.fatal or KeyboardInterrupt  # an exception in a callback also interrupts the run
        system, time = self._system, float(self.counts[Count.TIME_REACHED])
        system.time = time
        state = system.state(last[: system.nq], last[system.nq :])
        if status == Status.OPEN:
            joint, residual = worst_joint(system, state)
            reason = f"projection fails: {error or AssemblyError(joint, residual, CLOSURE_TOLERANCE)}"
            return IntegrationError(time, reason)
        reason = status.message.format(max_steps=max_steps)
        if status == Status.SINGULAR:
            reason = str(error)
        with np.errstate(all="ignore"):  # a run may have ended because its numbers are not finite
            friction = partial(system.loaded_friction, last[: system.nq], last[system.nq :])
            around = surroundings(system.scene, state, time)._replace(friction=friction)
            if jammed := jam(system.scene, friction, [last]):
                reason = jammed
            elif status in (Status.TOO_MANY_STEPS, Status.STEP_TOO_SMALL):
                if self._is_near_singular(last[: system.nq]):
                    # the joint is found in joint coordinates, whose constraint rows have names of joints
                    relative = at_time(Relative(system.scene), time)
                    rows = sorted({*range(len(relative.phi_units))} - {*rows_left_out(relative)})
                    q, _ = relative.coordinates(state)
                    joint, value = least_independent(relative, q, rows, constraint_rank(relative))
                    reason = near_singular(reason, joint, value, self._options)
                else:
                    reason = too_many_or_small_steps(reason, system.scene, around, self._options.integrator)
            return IntegrationError(time, with_likely_causes(system.scene, state, reason, around))
