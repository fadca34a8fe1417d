"""Accelerations by Pinocchio's `constraintDynamics`, regularized for redundant closures, and by `aba`.

With J M^-1 J^T regularized by mu, each proximal iteration reduces the effect of mu along an eigenvector of
eigenvalue lambda by the factor mu / (mu + lambda) (Carpentier, Budhiraja and Mansard, "Proximal and Sparse
Resolution of Constrained Dynamic Equations", RSS 2021, section III).

mu is the same for rows in meters and in radians. The solver therefore has a copy of the model in units of the
mechanism's size and mass, which give both kinds of rows equal weight. In SI units, accelerations of a loop of
1 cm have an error of 1e-8.
"""

from __future__ import annotations

from math import sqrt
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from newton_euler.equations.dense import rank
from newton_euler.scalars import Array
from urdf.constraints import Closures
from urdf.model import ClosedLoopModel, CoordinateMap, mass_matrix

RELATIVE_MU = 1e-6
"""Regularization mu of redundant closures, relative to max(1, mean of the diagonal of J M^-1 J^T).

Units are the mechanism's size and mass. Iterations remove the effect of mu. With a smaller mu, forces that
cause no acceleration would grow with drift."""

MAX_EIGENVALUE_SHARE = 0.1
"""Largest mu relative to the smallest nonzero eigenvalue, so that a few iterations remove its effect."""

MIN_RELATIVE_MU = 1e-12
"""Smallest mu relative to the mean of the diagonal: computed zero eigenvalues are about 1e-15 of it."""

MAX_MEAN_RATIO = 1e8
"""Largest ratio of the mean of the diagonal of J M^-1 J^T to mu: the factorization then keeps eight digits.

The ratio is larger if a body with almost no inertia closes a loop, for example 1e-11 and 1e-4 kg m^2."""

PROXIMAL_ACCURACY = 1e-13
"""Relative change between iterations that ends the iterations."""

MAX_PROXIMAL_ITERATIONS = 30

FIRST_ITERATIONS, MAX_SETTLED_CHANGE = 8, 1e-11
"""Number of first iterations, and the change of multipliers in the last of them that ends the solution.

The change is relative to 1 plus the norm of the multipliers. Each iteration reduces the change by the same
factor, here at most 3 %. Multipliers that cause no acceleration continue to change by round-off."""

MAX_FINAL_CHANGE = 1e-6
"""Relative change in the last iteration above which the iterations have not converged.

The configuration is then near a singular one, or drift has made redundant closures contradict each other."""


class Units(NamedTuple):
    """Units in which a mechanism has size 1 and mass 1.

    Attributes:
        length: unit of length, m.
        mass: unit of mass, kg.
        q: (nq,) units of coordinates, m or 1.
        v: (nv,) units of velocities, m or 1.
    """

    length: float
    mass: float
    q: Array
    v: Array

    @property
    def moment(self) -> float:
        """Unit of moments of inertia, kg m^2."""
        return self.mass * self.length**2


class ConstraintDynamics:
    """Dimensionless accelerations of a model by `constraintDynamics`, in tree coordinates.

    Attributes:
        loses_digits: True if mu is so small that round-off is magnified by more than `MAX_MEAN_RATIO`.
    """

    def __init__(
        self, closed: ClosedLoopModel, map: CoordinateMap, units: Units, q: Array, count: int
    ) -> None:
        """Choose plain elimination for independent closures, or iterations for redundant ones.

        Pinocchio returns NaN for redundant closures without regularization.

        Args:
            closed: model and closures.
            map: map between tree coordinates and Pinocchio's.
            units: units of the copy of the model.
            q: (nq,) start.
            count: number of independent rows; fewer may be independent at the start.
        """
        self._closed, self._map, self._units = closed, map, units
        self._closures, self._data = Closures(closed, map, units.length), closed.model.createData()
        self._model, self._constraints = _in_units(closed, map, units)
        self._scaled_data = self._model.createData()
        self._constraint_data = pin.StdVec_RigidConstraintData(
            [constraint.createData() for constraint in self._constraints]
        )
        pin.initConstraintDynamics(self._model, self._scaled_data, self._constraints, self._constraint_data)
        jacobian = self._jacobian(q)
        self._redundant = len(jacobian) - min(rank(jacobian), count)
        plain = pin.ProximalSettings(0.0, PROXIMAL_ACCURACY, 0.0, 1)
        self._settings, ratio = self._regularized(q) if self._redundant else (plain, 0.0)
        self.loses_digits = ratio > MAX_MEAN_RATIO
        self._redundant = len(jacobian) - count

    def acceleration(self, q: Array, v: Array, force: Array) -> Array:
        """Compute accelerations (nv,) under generalized forces (nv,); NaN if no solution exists."""
        pin_q, pin_v = (
            self._map.q_to_pinocchio(q / self._units.q),
            self._map.v_to_pinocchio(v / self._units.v),
        )
        state, settings = (pin_q, pin_v, self._map.v_to_pinocchio(force)), self._settings
        if not len(self._constraints):  # `aba` needs n operations, `constraintDynamics` n^3
            return self._map.v_from_pinocchio(pin.aba(self._model, self._scaled_data, *state))
        if settings.mu:
            few = pin.ProximalSettings(0.0, PROXIMAL_ACCURACY, settings.mu, FIRST_ITERATIONS)
            found, multipliers = self._solved(state, few), self._scaled_data.lambda_c
            if few.relative_residual <= MAX_SETTLED_CHANGE * (1.0 + sqrt(multipliers @ multipliers)):
                return found
        found = self._solved(state, settings)
        if settings.mu and not settings.relative_residual <= MAX_FINAL_CHANGE:
            here, _ = self._regularized(q)
            # a smaller mu would magnify contradictions of closures
            if here.mu < MAX_EIGENVALUE_SHARE * settings.mu:
                return self._solved(state, here)
        return found

    def _solved(self, state: tuple[Array, Array, Array], settings: Any) -> Array:
        """Solve for accelerations at q, v and forces in Pinocchio's order."""
        closures = self._constraints, self._constraint_data
        found = pin.constraintDynamics(self._model, self._scaled_data, *state, *closures, settings)
        return self._map.v_from_pinocchio(found)

    def wrenches(self) -> list[Any]:
        """Wrenches on second bodies about the world's origin, SI units, of the accelerations found last."""
        force = self._units.mass * self._units.length
        scaled = [-data.oMc1.act(data.contact_force) for data in self._constraint_data]
        return [pin.Force(w.linear * force, w.angular * self._units.moment) for w in scaled]

    def _jacobian(self, q: Array) -> Array:
        """(k, nv) of the closures, dimensionless."""
        pin.computeJointJacobians(self._closed.model, self._data, self._map.q_to_pinocchio(q))
        pin.updateFramePlacements(self._closed.model, self._data)
        return self._closures.jacobian(self._data) * self._units.v / self._closures.units[:, None]

    def _regularized(self, q: Array) -> tuple[Any, float]:
        """Choose iterations for redundant closures at a configuration, see `regularized`."""
        scaled_q = self._map.q_to_pinocchio(q / self._units.q)
        mass = mass_matrix(self._model, self._scaled_data, self._map, scaled_q)
        return regularized(self._jacobian(q), mass, self._redundant)


def _in_units(closed: ClosedLoopModel, map: CoordinateMap, units: Units) -> tuple[Any, Any]:
    """Copy a model and its constraints, in other units; its frames stay as they are."""

    def placed(placement: Any) -> Any:
        return pin.SE3(placement.rotation, placement.translation / units.length)

    model, constraints = closed.model.copy(), pin.StdVec_RigidConstraintModel()
    model.gravity = pin.Motion(model.gravity.linear / units.length, np.zeros(3))
    model.armature = model.armature * map.v_to_pinocchio(units.v) ** 2 / units.moment
    for index, inertia in enumerate(closed.model.inertias):
        model.jointPlacements[index] = placed(model.jointPlacements[index])
        own = inertia.mass / units.mass, inertia.lever / units.length, inertia.inertia / units.moment
        model.inertias[index] = pin.Inertia(*own)
    for constraint in closed.constraints:
        scaled = pin.RigidConstraintModel(constraint)
        scaled.joint1_placement = placed(constraint.joint1_placement)
        scaled.joint2_placement = placed(constraint.joint2_placement)
        constraints.append(scaled)
    return model, constraints


def regularized(jacobian: Array, mass: Array, redundant: int) -> tuple[Any, float]:
    """Choose the settings of iterations.

    Args:
        jacobian: (k, nv) dimensionless Jacobian.
        mass: (nv, nv) dimensionless mass matrix.
        redundant: number of redundant rows.

    Returns:
        The settings of Pinocchio, and the mean of the diagonal of J M^-1 J^T divided by mu.
    """
    response = jacobian @ np.linalg.solve(mass, jacobian.T)
    mean = float(np.mean(np.diag(response)))
    nonzero = np.linalg.eigvalsh(response)[redundant:]
    weakest = float(nonzero[0]) if len(nonzero) else np.inf
    mu = min(RELATIVE_MU * max(mean, 1.0), max(MAX_EIGENVALUE_SHARE * weakest, MIN_RELATIVE_MU * mean))
    return pin.ProximalSettings(0.0, PROXIMAL_ACCURACY, mu, MAX_PROXIMAL_ITERATIONS), mean / mu
