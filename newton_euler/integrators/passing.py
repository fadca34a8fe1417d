"""scipy's DOP853 through singular configurations, by the algorithm of `newton_euler.integrators.singular`."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.integrate import DOP853

from newton_euler.equations.redundancy import constraint_rank, rows_left_out, without
from newton_euler.equations.system import (
    System,
    at_time,
    constraint_rate,
    dimensionless_jacobian,
)
from newton_euler.errors import AssemblyError
from newton_euler.integrators.dense_projection import close, closing_of
from newton_euler.integrators.dop853 import (
    EXPONENT,
    LARGEST,
    SAFETY,
    Dop853,
    error_on_constraints,
)
from newton_euler.integrators.dop853_tableau import STAGES
from newton_euler.integrators.projection import worst_joint
from newton_euler.integrators.run import PythonCallback, native_method, vector_at
from newton_euler.integrators.singular import FAR, HOP, HOPS, NEAR, UNSAFE, crossing_factor
from newton_euler.model.mechanism import CLOSURE_TOLERANCE
from newton_euler.model.trajectory import IntegrationError
from newton_euler.scalars import Array

Rates = Callable[[float, Array], Array]


class PassingDOP853(DOP853):  # type: ignore[misc]  # scipy has no types
    """DOP853 that places its steps across singular configurations."""

    h_abs: float
    h_previous: float
    t: float
    t_bound: float

    def __init__(
        self,
        system: System,
        project: Rates,
        derivative: Rates,
        t: float,
        y: Array,
        end: float,
        near: tuple[float, float],
        **tolerances: float,
    ) -> None:
        """As scipy's, for the equations of a system, with its usual projection of a state at a time.

        `near` are rtol and atol next to singular configurations, see
        `newton_euler.integrators.options.Options.near`.
        """
        self._system, self._project, self._tolerances = system, project, near
        self._close = DenseProjection(system)
        self._rank = constraint_rank(system)
        self._best = 0.0
        self._ratio_at_end: float | None = None
        self._states: deque[Array] = deque(maxlen=STAGES)
        self._hops = 0
        self._near = False
        self._leaves = True
        self._growth = 0.0

        def watched(t: float, y: Array) -> Array:
            self._states.append(y)
            return derivative(t, y)

        super().__init__(watched, t, y, end, **tolerances)

    def _step_impl(self) -> Any:
        """Take a step; after one shortened for its place alone the next is as long as the error allows.

        scipy lets no step grow after one that was rejected, and steps that do not grow do not get across.
        """
        self._growth = LARGEST
        if self._ratio_at_end is None:
            self._ratio_at_start = self._pivot_ratio(self.y)
        else:  # projection has hardly moved it since
            self._ratio_at_start = self._ratio_at_end
        outcome = super()._step_impl()
        if outcome[0] and self._near:
            self.h_abs = max(self.h_abs, self.h_previous * self._growth)
        return outcome

    def _jacobian(self, y: Array) -> Array:
        jacobian = dimensionless_jacobian(self._system, y[: self._system.nq])
        return without(jacobian, rows_left_out(self._system))

    def _pivot_ratio(self, y: Array) -> float:
        """Return 1 at the best state so far; it falls with the square of the distance to a singular one.

        By the smallest singular value that is not zero where no configuration is singular.
        """
        if self._rank == 0 or not np.all(np.isfinite(y)):
            return 1.0
        values = np.linalg.svd(self._jacobian(y), compute_uv=False)
        found = float((values[self._rank - 1] / values[0]) ** 2)
        self._best = max(self._best, found)
        return found / self._best if self._best else 1.0

    def project(self, t: float, y: Array) -> Array:
        """Put a state of the last step on the constraints.

        Raises:
            IntegrationError: where it cannot be put there.
        """
        if not self._near:
            return self._project(t, y)
        return self._close(t, y)

    def _estimate_error_norm(self, k: Array, h: float, scale: Array) -> float:
        """Estimate the error of a step from `self.y` with the rates k (13, n) of its stages.

        Near a singular configuration it is made just so large that the step is shortened to where it fits.
        """
        error = float(super()._estimate_error_norm(k, h, scale))
        self._ratio_at_end = self._pivot_ratio(self._states[-1])
        self._near = False
        if min(self._ratio_at_start, self._ratio_at_end) < FAR:
            ratios = [self._pivot_ratio(y) for y in (self.y, *self._states)]
            self._near = min(ratios) < NEAR
            if self._near and self.t + h >= self.t_bound:
                self.t_bound = np.inf
        if not self._near:
            self._hops = 0
            return error
        self._leaves = self._leaves and ratios[0] < UNSAFE
        if min(ratios[1:]) < UNSAFE and not self._leaves:
            return _error_for(HOP)
        error = min(error, self._error_on_constraints(k, h))
        shorter = SAFETY * error**EXPONENT if error > 1.0 else 1.0
        factor = crossing_factor(ratios[0], ratios[9], ratios[STAGES], shorter)
        if 0.0 < factor < 1.0 and self._hops < HOPS:  # 0 from the singular configuration itself
            self._hops += 1
            return _error_for(factor)
        if error < 1.0:
            self._hops = 0
            self._growth = min(self._growth, SAFETY * error**EXPONENT if error > 0.0 else LARGEST)
        else:
            self._growth = 0.0
        return error

    def _error_on_constraints(self, k: Array, h: float) -> float:
        n = len(self.y)
        rows = np.zeros((STAGES + 4, n + 1))
        rows[: STAGES + 1, :n] = k
        end = np.append(self.y + h * (k[:STAGES].T @ self.B), self.t + h)
        method = Dop853(
            rtol=float(self.rtol),
            atol=float(self.atol),
            near_rtol=self._tolerances[0],
            near_atol=self._tolerances[1],
            most=0,
            rest=0.0,
            units=np.zeros(0),
            now=np.append(self.y, self.t),
            at=end.copy(),
            end=end,
            k=rows.ravel(),
            terms=np.zeros(0),
            room=0,
            steps=np.zeros(0),
            round_off=np.zeros(0),
            control=np.zeros(0),
        )
        closing = self._close.closing
        return float(native_method(error_on_constraints)(error_on_constraints, n, h, closing, method))


class DenseProjection:
    """Projection of equations that Python evaluates, next to singular configurations.

    Attributes:
        closing: the record of native code.
    """

    def __init__(self, system: System) -> None:
        self._system, self._now = system, system
        self._error: Exception | None = None
        self._kept = np.delete(np.arange(len(system.phi_units)), rows_left_out(system))
        k, nv = len(self._kept), system.nv
        self._size = system.nq + nv
        functions = PythonCallback(self._retract), PythonCallback(self._surface)
        places = [*range(k * nv)], [*range(nv * nv)]
        self.closing = closing_of(system.nq, system.velocity_units, self._size + 1, places, k, functions)
        self._results = 2 * k + k * nv + nv * nv

    def __call__(self, t: float, y: Array) -> Array:
        """Put a state at a time on the constraints.

        Raises:
            IntegrationError: where it cannot be put there.
        """
        found, self._error = np.empty(self._size + 1), None
        native_method(close)(close, self.closing, np.append(y, t), found)
        if not found[-1] > 0.0:
            q, v = y[: self._system.nq], y[self._system.nq :]
            joint, residual = worst_joint(self._system, self._system.state(q, v))
            error = self._error or AssemblyError(joint, residual, CLOSURE_TOLERANCE)
            raise IntegrationError(t, f"projection fails: {error}") from error
        return found[:-1]

    def _retract(self, x: int, y: int, on: int) -> None:
        self._write(x, y, self._system.nq, lambda q, step: self._now.retract(q, step))

    def _surface(self, x: int, y: int, on: int) -> None:
        self._write(x, y, self._results, self._evaluated)

    def _write(self, x: int, y: int, size: int, function: Callable[[Array, Array], Array]) -> None:
        """Write results (size,) at (q, v) into y, or numbers that are none if Python fails."""
        state, results = vector_at(x, self._size + 1).copy(), vector_at(y, size)
        try:
            self._now = at_time(self._system, state[-1])
            results[:] = function(state[: self._system.nq], state[self._system.nq : -1])
        except Exception as error:  # nothing may pass through native code
            self._error = error
            results[:] = np.nan

    def _evaluated(self, q: Array, v: Array) -> Array:
        """Evaluate Phi, dPhi/dt, Phi_q and M, dimensionless."""
        now, kept, units = self._now, self._kept, self._system.velocity_units
        phi_units = self._system.phi_units[kept]
        phi, rates = now.phi(q)[kept] / phi_units, constraint_rate(now, q, v)[kept] / phi_units
        jacobian = now.phi_jacobian(q)[kept] * units / phi_units[:, None]
        mass = now.mass_and_force(q, np.zeros(len(v)))[0] * np.outer(units, units)
        return np.concatenate([phi, rates, jacobian.ravel(), mass.ravel()])


def _error_for(factor: float) -> float:
    """Return the error for which scipy's step control takes a step that is shorter by a factor."""
    return float((SAFETY / factor) ** (DOP853.error_estimator_order + 1))
