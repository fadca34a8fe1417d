"""Accelerations by Pinocchio's `constraintDynamics`, also for redundant closures, and by `aba` without loops.

If constraint rows are redundant, J M^-1 J^T is singular. Pinocchio then adds a regularization mu to its
diagonal, and removes the effect of mu by proximal iterations. Each iteration reduces the effect along an
eigenvector of eigenvalue lambda by the factor mu / (mu + lambda). Source: Carpentier, Budhiraja and Mansard,
"Proximal and Sparse Resolution of Constrained Dynamic Equations", RSS 2021, section III.

mu is the same for rows in meters and in radians. The solver therefore has a copy of the model in units of the
mechanism's size and mass, which give both kinds of rows equal weight. In SI units, accelerations of a loop of
1 cm would have a relative error of 1e-8.
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

Units are the mechanism's size and mass. Iterations remove the effect of mu. With a smaller mu, constraint
forces that cause no acceleration would grow when a run drifts from closed loops."""

MAX_EIGENVALUE_FRACTION = 0.1
"""Largest mu relative to the smallest nonzero eigenvalue of J M^-1 J^T: few iterations remove its effect."""

MIN_RELATIVE_MU = 1e-12
"""Smallest mu relative to the mean of the diagonal of J M^-1 J^T. Eigenvalues that are zero are computed as
about 1e-15 of the mean."""

MAX_MEAN_RATIO = 1e8
"""Largest ratio of the mean of the diagonal of J M^-1 J^T to mu: the factorization then keeps eight digits.

The ratio is larger if a body with almost no inertia closes a loop, for example 1e-11 and 1e-4 kg m^2."""

PROXIMAL_ACCURACY = 1e-13
"""Dimensionless change of the multipliers between iterations at which Pinocchio ends the iterations.

The change is the largest one of a multiplier, Pinocchio's `relative_residual`, which is not divided by the
multiplier."""

MAX_PROXIMAL_ITERATIONS = 30
"""Largest number of proximal iterations."""

FIRST_ITERATIONS = 8
"""Number of iterations after which the change of the multipliers is examined."""

MAX_SETTLED_CHANGE = 1e-11
"""Change of the multipliers in the last of `FIRST_ITERATIONS` below which no further iterations are needed.

The change is relative to 1 plus the norm of the multipliers. It falls so far in `FIRST_ITERATIONS` only if
each iteration reduces it to a few percent. Multipliers that cause no acceleration continue to change by
round-off, and their change may not fall to `PROXIMAL_ACCURACY`."""

MAX_FINAL_CHANGE = 1e-6
"""Dimensionless change of the multipliers in the last iteration above which they have not converged.

Iterations fail near a singular configuration, and if the loops have drifted open, so that redundant closures
contradict each other."""


class Units(NamedTuple):
    """Units in which a mechanism has size 1 and mass 1; the unit of time is 1 s.

    Attributes:
        length: unit of length, the mechanism's size, m.
        mass: unit of mass, the mechanism's mass, kg.
        q: (nq,) units of coordinates: `length` for slides, else 1.
        v: (nv,) units of velocities: `length` for slides, else 1.
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
    """Dimensionless accelerations of a model by `constraintDynamics`.

    Tree coordinates are the joint coordinates of the scene's spanning tree.

    Attributes:
        loses_digits: True if mu is so small that round-off is magnified by more than `MAX_MEAN_RATIO`.
    """

    def __init__(
        self, closed: ClosedLoopModel, map: CoordinateMap, units: Units, q: Array, count: int
    ) -> None:
        """Choose proximal iterations if closures are redundant, or a single solution if they are independent.

        Pinocchio returns NaN for redundant closures without regularization.

        Args:
            closed: Pinocchio's model with its loop closures.
            map: order of coordinates and velocities in the tree and in Pinocchio's model. Signs are the same,
                so that it also maps forces.
            units: units of the copy of the model.
            q: (nq,) tree coordinates at the start.
            count: number of independent rows at regular configurations; fewer may be independent at the
                start.
        """
        self._closed, self._map, self._units = closed, map, units
        self._closures, self._data = Closures(closed, map, units.length), closed.model.createData()
        self._model, self._constraints = _in_units(closed, map, units)
        self._scaled_data = self._model.createData()
        self._constraint_data = pin.StdVec_RigidConstraintData(
            [constraint.createData() for constraint in self._constraints]
        )
        pin.initConstraintDynamics(self._model, self._scaled_data, self._constraints, self._constraint_data)
        # choose mu for the number of redundant rows at the start; later choices use the number at regular
        # configurations
        jacobian = self._jacobian(q)
        self._redundant_count = len(jacobian) - min(rank(jacobian), count)
        if self._redundant_count:
            self._settings, mean_ratio = self._regularized(q)
        else:
            self._settings, mean_ratio = _settings(mu=0.0, iterations=1), 0.0
        self.loses_digits = mean_ratio > MAX_MEAN_RATIO
        self._redundant_count = len(jacobian) - count

    def acceleration(self, q: Array, v: Array, force: Array) -> Array:
        """Compute dimensionless accelerations (nv,); NaN if no solution exists.

        Args:
            q: (nq,) tree coordinates, SI units.
            v: (nv,) tree velocities, SI units.
            force: (nv,) dimensionless generalized forces.
        """
        pin_q = self._map.q_to_pinocchio(q / self._units.q)
        pin_v = self._map.v_to_pinocchio(v / self._units.v)
        state, settings = (pin_q, pin_v, self._map.v_to_pinocchio(force)), self._settings
        if not len(self._constraints):  # `aba` needs n operations, `constraintDynamics` n^3
            return self._map.v_from_pinocchio(pin.aba(self._model, self._scaled_data, *state))
        # redundant closures: try a few iterations first
        if settings.mu:
            few = _settings(settings.mu, FIRST_ITERATIONS)
            acceleration, multipliers = self._solve(state, few), self._scaled_data.lambda_c
            if few.relative_residual <= MAX_SETTLED_CHANGE * (1.0 + sqrt(multipliers @ multipliers)):
                return acceleration
        acceleration = self._solve(state, settings)
        # if the iterations do not converge, choose mu for this configuration; a mu that is only slightly
        # smaller would magnify contradictions of closures, so require a factor of 10
        if settings.mu and not settings.relative_residual <= MAX_FINAL_CHANGE:
            settings_here, _ = self._regularized(q)
            if settings_here.mu < MAX_EIGENVALUE_FRACTION * settings.mu:
                return self._solve(state, settings_here)
        return acceleration

    def _solve(self, state: tuple[Array, Array, Array], settings: Any) -> Array:
        """Return accelerations (nv,), tree order, for a state (q, v, forces) in Pinocchio's order.

        `settings` are `pinocchio.ProximalSettings`; their `relative_residual` is set.
        """
        closures = self._constraints, self._constraint_data
        accelerations = pin.constraintDynamics(self._model, self._scaled_data, *state, *closures, settings)
        return self._map.v_from_pinocchio(accelerations)

    def wrenches(self) -> list[Any]:
        """Return the `pinocchio.Force` of each closure on its second body, for the latest accelerations.

        Forces are about the world's origin, in SI units.
        """
        force = self._units.mass * self._units.length  # unit of forces, N
        # Pinocchio's contact force acts on the first body, in the frame of the constraint
        scaled = [-data.oMc1.act(data.contact_force) for data in self._constraint_data]
        return [pin.Force(w.linear * force, w.angular * self._units.moment) for w in scaled]

    def _jacobian(self, q: Array) -> Array:
        """Return the dimensionless Jacobian (k, nv) of the closures."""
        pin.computeJointJacobians(self._closed.model, self._data, self._map.q_to_pinocchio(q))
        pin.updateFramePlacements(self._closed.model, self._data)
        return self._closures.jacobian(self._data) * self._units.v / self._closures.units[:, None]

    def _regularized(self, q: Array) -> tuple[Any, float]:
        """Choose the settings of the iterations at tree coordinates q (nq,), SI units, see `regularized`."""
        scaled_q = self._map.q_to_pinocchio(q / self._units.q)
        mass = mass_matrix(self._model, self._scaled_data, self._map, scaled_q)
        return regularized(self._jacobian(q), mass, self._redundant_count)


def _in_units(closed: ClosedLoopModel, map: CoordinateMap, units: Units) -> tuple[Any, Any]:
    """Return a copy of a model and of its constraints in other units; frames stay in SI, and are not used."""

    def placed(placement: Any) -> Any:
        """Return a placement with its translation in the unit of length."""
        return pin.SE3(placement.rotation, placement.translation / units.length)

    model, constraints = closed.model.copy(), pin.StdVec_RigidConstraintModel()
    model.gravity = pin.Motion(model.gravity.linear / units.length, np.zeros(3))
    model.armature = model.armature * map.v_to_pinocchio(units.v) ** 2 / units.moment
    for index, inertia in enumerate(closed.model.inertias):
        model.jointPlacements[index] = placed(model.jointPlacements[index])
        model.inertias[index] = pin.Inertia(
            inertia.mass / units.mass, inertia.lever / units.length, inertia.inertia / units.moment
        )
    for constraint in closed.constraints:
        scaled = pin.RigidConstraintModel(constraint)
        scaled.joint1_placement = placed(constraint.joint1_placement)
        scaled.joint2_placement = placed(constraint.joint2_placement)
        constraints.append(scaled)
    return model, constraints


def regularized(jacobian: Array, mass: Array, redundant: int) -> tuple[Any, float]:
    """Choose the regularization mu of the proximal iterations.

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
    # not larger than the smallest nonzero eigenvalue allows, but above the round-off of zero eigenvalues
    mu = min(RELATIVE_MU * max(mean, 1.0), max(MAX_EIGENVALUE_FRACTION * weakest, MIN_RELATIVE_MU * mean))
    return _settings(mu, MAX_PROXIMAL_ITERATIONS), mean / mu


def _settings(mu: float, iterations: int) -> Any:
    """Return `pinocchio.ProximalSettings`: end at a relative change of `PROXIMAL_ACCURACY`.

    Args:
        mu: regularization.
        iterations: largest number of iterations.
    """
    absolute_accuracy = 0.0
    return pin.ProximalSettings(absolute_accuracy, PROXIMAL_ACCURACY, mu, iterations)
