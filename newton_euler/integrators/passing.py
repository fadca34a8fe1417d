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
from newton_euler.errors import NewtonEulerError
from newton_euler.integrators.dop853 import (
    EXPONENT,
    LARGEST,
    SAFETY,
    STAGES,
    Dop853,
    error_on_constraints,
)
from newton_euler.integrators.projection import Surface, close_by
from newton_euler.integrators.singular import FAR, HOP, HOPS, NEAR, UNSAFE, crossing_factor
from newton_euler.model.trajectory import IntegrationError
from newton_euler.scalars import Array

Rates = Callable[[float, Array], Array]


class PassingDOP853(DOP853):  # type: ignore[misc]  # scipy has no types
    """DOP853 that places its steps across singular configurations."""

    h_abs: float
    h_previous: float

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
        self._rank = constraint_rank(system)
        self._best = 0.0
        self._ratio_at_end: float | None = None
        self._states: deque[Array] = deque(maxlen=STAGES)
        self._hops = 0
        self._near = False
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
        try:
            return close_densely(self._system, t, y)
        except NewtonEulerError as error:
            raise IntegrationError(t, f"projection fails: {error}") from error

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
        if not self._near:
            self._hops = 0
            return error
        if min(ratios[1:]) < UNSAFE <= ratios[0]:
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
            now=np.append(self.y, self.t),
            at=end.copy(),
            end=end,
            k=rows.ravel(),
            terms=np.zeros(0),
            room=0,
            steps=np.zeros(0),
            control=np.zeros(0),
        )
        return error_on_constraints(n, h, self._closing, method)

    def _closing(self, x: Array, y: Array) -> None:
        """Project near a singular configuration, in the form that native methods call."""
        n = len(x) - 1
        try:
            y[:n] = close_densely(self._system, x[n], x[:n])
            y[n] = 1.0
        except NewtonEulerError:
            y[n] = -1.0


def close_densely(system: System, t: float, y: Array) -> Array:
    """Put a state at a time on the constraints as `close_by` does, for equations of a tree."""
    now, unused = at_time(system, t), rows_left_out(system)

    def surface(y: Array) -> Surface:
        q, v = y[: system.nq], y[system.nq :]
        parts = (now.phi(q), constraint_rate(now, q, v), now.phi_jacobian(q))
        phi, opens, jacobian = (without(part, unused) for part in parts)
        return Surface(phi, opens, jacobian, now.mass_and_force(q, np.zeros(system.nv))[0])

    return close_by(surface, now, y)


def _error_for(factor: float) -> float:
    """Return the error for which scipy's step control takes a step that is shorter by a factor."""
    return float((SAFETY / factor) ** (DOP853.error_estimator_order + 1))
