"""Pinocchio's `constraintDynamics`, regularized where closures are redundant; `aba` of open trees.

With J M^-1 J^T regularized by mu, each proximal iteration leaves mu / (mu + lambda) of its effect along
an eigenvector of eigenvalue lambda (Carpentier, Budhiraja and Mansard, "Proximal and Sparse Resolution of
Constrained Dynamic Equations", RSS 2021, section III).

mu is the same for rows in meters and rows in radians. It has a copy of the model in units of the mechanism's
size and mass, in which they weigh alike: in SI units accelerations of a loop of 1 cm are off by 1e-8.
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

MU = 1e-6
"""Regularization of redundant closures against the mean of the diagonal of J M^-1 J^T, in units of the
mechanism's size and mass, or against 1 if that is larger. Iterations take its effect out again; a
smaller one lets forces that no acceleration sees grow with drift."""

SHARE = 0.1
"""Of the smallest eigenvalue that is not zero, at most: a few iterations then leave nothing."""

LEAST = 1e-12
"""Of that mean, at least: zero eigenvalues come out as 1e-15 of it."""

MAX_MEAN_RATIO = 1e8
"""Largest ratio of the mean of the diagonal of J M^-1 J^T to mu: its factorization then keeps eight digits.
The ratio is larger if bodies of next to no inertia close a loop, such as 1e-11 beside 1e-4 kg m^2."""

ACCURACY = 1e-13
"""Relative change between iterations at which they end."""

ITERATIONS = 30

FEW, SETTLED = 8, 1e-11
"""Iterations after the last of which a change of multipliers below this, relative to them or to 1 if they are
smaller, ends them: each leaves the same share of the change before, at most 3 % then. Multipliers that no
acceleration sees go on to change by round-off in each."""

CONVERGED = 1e-6
"""Relative change in the last iteration above which something keeps them from an end: a configuration that is
near a singular one, or redundant closures that contradict each other because they have drifted open."""


class Units(NamedTuple):
    """The units in which a mechanism has size 1 and mass 1.

    Attributes:
        length: m.
        mass: kg.
        q: (nq,) of coordinates, m or 1.
        v: (nv,) of velocities, m or 1.
    """

    length: float
    mass: float
    q: Array
    v: Array

    @property
    def moment(self) -> float:
        """kg m^2; of generalized forces of hinges at accelerations in these units."""
        return self.mass * self.length**2


class ConstraintDynamics:
    """Accelerations of a model by `constraintDynamics`, in tree coordinates and dimensionless.

    Attributes:
        loses_digits: whether mu is so small that round-off is magnified by more than `MAX_MEAN_RATIO`.
    """

    def __init__(
        self, closed: ClosedLoopModel, map: CoordinateMap, units: Units, q: Array, count: int
    ) -> None:
        """Choose plain elimination for independent closures, iterations for redundant ones, at a start q.

        Pinocchio returns NaN for redundant closures without regularization. `count` of their rows are
        independent, at the start maybe fewer.
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
        plain = pin.ProximalSettings(0.0, ACCURACY, 0.0, 1)
        self._settings, ratio = self._regularized(q) if self._redundant else (plain, 0.0)
        self.loses_digits = ratio > MAX_MEAN_RATIO
        self._redundant = len(jacobian) - count

    def acceleration(self, q: Array, v: Array, force: Array) -> Array:
        """Compute accelerations (nv,) under generalized forces (nv,), NaN if there are none."""
        pin_q, pin_v = (
            self._map.q_to_pinocchio(q / self._units.q),
            self._map.v_to_pinocchio(v / self._units.v),
        )
        state, settings = (pin_q, pin_v, self._map.v_to_pinocchio(force)), self._settings
        if not len(self._constraints):  # for which `constraintDynamics` takes n^3 operations
            return self._map.v_from_pinocchio(pin.aba(self._model, self._scaled_data, *state))
        if settings.mu:
            few = pin.ProximalSettings(0.0, ACCURACY, settings.mu, FEW)
            found, multipliers = self._solved(state, few), self._scaled_data.lambda_c
            if few.relative_residual <= SETTLED * (1.0 + sqrt(multipliers @ multipliers)):
                return found
        found = self._solved(state, settings)
        if settings.mu and not settings.relative_residual <= CONVERGED:
            here, _ = self._regularized(q)
            # not for closures that contradict each other: less of it would magnify that
            if here.mu < SHARE * settings.mu:
                return self._solved(state, here)
        return found

    def _solved(self, state: tuple[Array, Array, Array], settings: Any) -> Array:
        """Solve at q, v and forces in Pinocchio's order."""
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
    """Choose iterations for a dimensionless Jacobian (k, nv) and a mass matrix (nv, nv).

    `redundant` is the number of rows that follow from the others.

    Returns:
        The settings of Pinocchio, and the mean of the diagonal of J M^-1 J^T in units of their mu.
    """
    response = jacobian @ np.linalg.solve(mass, jacobian.T)
    mean = float(np.mean(np.diag(response)))
    nonzero = np.linalg.eigvalsh(response)[redundant:]
    weakest = float(nonzero[0]) if len(nonzero) else np.inf
    mu = min(MU * max(mean, 1.0), max(SHARE * weakest, LEAST * mean))
    return pin.ProximalSettings(0.0, ACCURACY, mu, ITERATIONS), mean / mu
