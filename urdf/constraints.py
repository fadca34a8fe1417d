"""Residuals and Jacobians of constraints from Pinocchio's kinematics, for `urdf.dynamics`.

`Closures` close loops: points or frames on two bodies coincide. Pinocchio's `constraintDynamics` supports
them. `Rows` are rods, couplings and prescribed motions, which `constraintDynamics` does not support. With
points p1 and p2 of a rod of length L, d = p2 - p1 and l = |d|,

    Phi = l - L,    Phi_q = d^T (J2 - J1) / l
    Phi_q qddot + (d . (a2 - a1) + |dd/dt|^2 - (dl/dt)^2) / l = 0

with Jacobians J1 and J2 of the points and their accelerations a1 and a2 at qddot = 0. The residual of a
prescribed motion f(t) is Phi = x - f(t). Couplings are sums of polynomials p(x) of joint coordinates,

    Phi = sum p(x),    Phi_x = p'(x),    Phi_q qddot + sum p''(x) (dx/dt)^2 = 0

Tree coordinates q and tree velocities belong to the scene's spanning tree; Pinocchio has the same ones in
another order (`CoordinateMap`). Lagrange multipliers lambda exert the generalized forces Phi_q^T lambda.
"""

from __future__ import annotations

from math import perm
from typing import Any

import numpy as np
import pinocchio as pin

from newton_euler.equations.coupling_equations import TreeCouplings
from newton_euler.scalars import Array
from urdf.model import ClosedLoopModel, CoordinateMap


class Closures:
    """Rigid constraints of a model, with 3 or 6 rows each.

    The first three rows are the origin of the first frame minus the origin of the second, m, world frame. A
    weld also has the rotation vector from the first frame to the second, rad, in the first frame.

    Attributes:
        units: (k,) divisors that make the rows dimensionless: `length` for rows in m, 1 for angles.
        pairs: numbers of the two frames of each constraint, and True for a weld.
    """

    def __init__(self, closed: ClosedLoopModel, map: CoordinateMap, length: float) -> None:
        """Prepare the rows.

        Args:
            closed: Pinocchio's model with its loop closures.
            map: order of the joint coordinates in the scene's spanning tree and in Pinocchio's model.
            length: characteristic length of the mechanism, m.
        """
        self._model, self._map = closed.model, map
        is_weld = [constraint.type == pin.ContactType.CONTACT_6D for constraint in closed.constraints]
        self.pairs = list(zip(closed.frames, is_weld, strict=True))
        units_of_weld = np.repeat([length, 1.0], 3)
        units = [units_of_weld if weld else units_of_weld[:3] for weld in is_weld]
        self.units = np.concatenate([np.zeros(0), *units])

    def phi(self, data: Any) -> Array:
        """Return the residuals (k,), m or rad; `data` needs frame placements."""
        rows = [np.zeros(0)]
        for (first, second), is_weld in self.pairs:
            a, b = data.oMf[first], data.oMf[second]
            rows.append(a.translation - b.translation)
            if is_weld:
                rows.append(pin.log3(a.rotation.T @ b.rotation))
        return np.concatenate(rows)

    def jacobian(self, data: Any) -> Array:
        """Return the Jacobian (k, nv) in tree velocities; `data` needs joint Jacobians and placements."""
        rows = [np.zeros((0, self._model.nv))]
        for (first, second), is_weld in self.pairs:
            difference = frame_jacobian(self._model, data, first) - frame_jacobian(self._model, data, second)
            rows.append(difference[:3])
            if is_weld:
                a, b = data.oMf[first].rotation, data.oMf[second].rotation
                # d log3(R)/dt = Jlog3(R) omega, with the relative angular velocity omega in the second frame
                rows.append(-pin.Jlog3(a.T @ b) @ b.T @ difference[3:])
        return self._map.v_from_pinocchio(np.concatenate(rows))

    def gamma(self, data: Any) -> Array:
        """Return gamma (k,) of Phi_q qddot = gamma, for loops that are closed.

        `data` needs `forwardKinematics` at qddot = 0. For a weld, the rotation vector and its rate are zero,
        so that its second derivative is the difference of the angular accelerations.
        """
        rows = [np.zeros(0)]
        for (first, second), is_weld in self.pairs:
            a, b = (
                pin.getFrameClassicalAcceleration(self._model, data, frame, pin.LOCAL_WORLD_ALIGNED)
                for frame in (first, second)
            )
            rows.append(b.linear - a.linear)
            if is_weld:
                rows.append(data.oMf[second].rotation.T @ (a.angular - b.angular))
        return np.concatenate(rows)

    def wrenches(self, data: Any, multipliers: Array) -> list[Any]:
        """Return the `pinocchio.Force` of each constraint on the second body, about the world's origin.

        Args:
            data: `pinocchio.Data` with frame placements.
            multipliers: (k,) Lagrange multipliers.
        """
        wrenches, row = [], 0
        for (first, second), is_weld in self.pairs:
            b = data.oMf[second]
            force, torque = -multipliers[row : row + 3], np.zeros(3)
            if is_weld:
                # derivative of the rotation vector by the angular velocity of the second body
                rate_by_omega = pin.Jlog3(data.oMf[first].rotation.T @ b.rotation) @ b.rotation.T
                torque = rate_by_omega.T @ multipliers[row + 3 : row + 6]
            wrenches.append(pin.Force(force, torque + np.cross(b.translation, force)))
            row += 6 if is_weld else 3
        return wrenches


def frame_jacobian(model: Any, data: Any, frame: int) -> Array:
    """Return the Jacobian (6, nv) of the linear and angular velocity of a frame, world axes.

    Columns are in Pinocchio's order; `data` needs joint Jacobians and frame placements.
    """
    jacobian = pin.getFrameJacobian(model, data, frame, pin.LOCAL_WORLD_ALIGNED)
    return np.asarray(jacobian.reshape(6, -1))  # Pinocchio returns a single column as a vector


def power_sums(powers: Array, x: Array, derivative: int) -> Array:
    """Evaluate polynomials of coordinates, or their derivatives, by Horner's rule.

    Args:
        powers: (c, d, n) factors of the powers 1 to d of n coordinates, for c couplings.
        x: (n,) coordinates, m or rad.
        derivative: order of the derivative, 0, 1 or 2.

    Returns:
        (c, n) values; their sum over n is the value of the coupling.
    """
    total = np.zeros((len(powers), len(x)))
    for k in range(powers.shape[1], max(derivative, 1) - 1, -1):
        total = total * x + perm(k, derivative) * powers[:, k - 1]
    return total if derivative else total * x


class Rows:
    """Constraint rows that `constraintDynamics` does not support: rods, prescribed motions, screws, gears.

    Attributes:
        units: (r,) divisors that make the rows dimensionless: `length` for rows in m, 1 for angles.
    """

    def __init__(
        self,
        closed: ClosedLoopModel,
        map: CoordinateMap,
        couplings: TreeCouplings,
        length: float,
    ) -> None:
        """Prepare the rows: rods, prescribed motions, then screws, gears and other couplings.

        Args:
            closed: Pinocchio's model, with the rods and couplings of the loop file: the file next to the URDF
                that lists what a URDF cannot express.
            map: order of the joint coordinates in the scene's spanning tree and in Pinocchio's model.
            couplings: couplings of the scene, prescribed motions first.
            length: characteristic length of the mechanism, m.
        """
        self._model, self._rods, self._map, self._couplings = closed.model, closed.rods, map, couplings
        data = self._model.createData()
        pin.framesForwardKinematics(self._model, data, pin.neutral(self._model))
        self._lengths = [float(np.linalg.norm(self._line(data, rod))) for rod in self._rods]
        # the loop file has the couplings, the scene also has prescribed motions
        self._motion_count = len(couplings.couplings) - len(closed.couplings)
        # factors (c, d, nv) of the powers 1 to d of the coordinates in c couplings
        self._powers = map.v_from_pinocchio(closed.couplings)
        self.units = np.concatenate([np.full(len(self._rods), length), couplings.units])

    def phi(self, data: Any, q: Array, time: float) -> Array:
        """Return residuals (r,), m or rad; `data` needs `framesForwardKinematics` at q."""
        of_rods = [
            float(np.linalg.norm(self._line(data, rod))) - length
            for rod, length in zip(self._rods, self._lengths, strict=True)
        ]
        return np.concatenate([of_rods, self._couplings.phi(q, time)])

    def phi_t(self, time: float) -> Array:
        """Return the time derivative (r,) of `phi` at constant q: -df/dt of prescribed motions, else 0."""
        return np.concatenate([np.zeros(len(self._rods)), -self._couplings.rate(time)])

    def jacobian(self, data: Any, q: Array) -> Array:
        """Return the Jacobian (r, nv) in tree velocities.

        `data` needs `computeJointJacobians` and `updateFramePlacements` at tree coordinates q.
        """
        if not len(self.units):
            return np.zeros((0, self._model.nv))
        rows = []
        for rod in self._rods:
            first, second = (frame_jacobian(self._model, data, frame) for frame in rod)
            rate_of_length = self._direction(data, rod)[None] @ (second - first)[:3]
            rows.append(self._map.v_from_pinocchio(rate_of_length))
        if self._motion_count:
            rows.append(self._couplings.jacobian(q)[: self._motion_count])
        x = self._map.displacements(q)  # (nv,) coordinates of hinges and slides, 0 for balls
        return np.concatenate([*rows, power_sums(self._powers, x, derivative=1)])

    def gamma(self, data: Any, q: Array, v: Array, time: float) -> Array:
        """Return gamma (r,) of Phi_q qddot = gamma; `data` needs `forwardKinematics` at qddot = 0."""
        if not len(self.units):
            return np.zeros(0)
        model, axes = self._model, pin.LOCAL_WORLD_ALIGNED
        of_rods = []
        for rod in self._rods:
            v1, v2 = (pin.getFrameVelocity(model, data, frame, axes).linear for frame in rod)
            a1, a2 = (pin.getFrameClassicalAcceleration(model, data, frame, axes).linear for frame in rod)
            length, d_rate = np.linalg.norm(self._line(data, rod)), v2 - v1
            u = self._direction(data, rod)  # d / l; dl/dt = u . dd/dt
            of_rods.append(u @ (a2 - a1) + (d_rate @ d_rate - (u @ d_rate) ** 2) / length)
        # accelerations of prescribed motions, and -sum p''(x) (dx/dt)^2 of couplings
        of_couplings = self._couplings.acceleration(time)
        curvatures = power_sums(self._powers, self._map.displacements(q), derivative=2)
        of_couplings[self._motion_count :] -= curvatures @ v**2
        return np.concatenate([-np.array(of_rods), of_couplings])

    def rod_wrenches(self, data: Any, multipliers: Array) -> list[Any]:
        """Return the `pinocchio.Force` of each rod on its second body, about the world's origin.

        `multipliers` (r,) are the Lagrange multipliers, rods first.
        """
        wrenches = []
        for rod, multiplier in zip(self._rods, multipliers, strict=False):
            _, second = rod
            force = multiplier * self._direction(data, rod)
            wrenches.append(pin.Force(force, np.cross(data.oMf[second].translation, force)))
        return wrenches

    def motion_power(self, multipliers: Array, time: float) -> float:
        """Return the power of prescribed motions, W, for multipliers (r,) at a time, s."""
        return float(multipliers[len(self._rods) :] @ self._couplings.rate(time))

    def _line(self, data: Any, rod: tuple[int, int]) -> Array:
        """Return the vector (3,), m, world frame, from the first point of a rod to the second."""
        first, second = rod
        return np.asarray(data.oMf[second].translation - data.oMf[first].translation)

    def _direction(self, data: Any, rod: tuple[int, int]) -> Array:
        """Return the unit vector (3,) of a rod from its first point to the second."""
        d = self._line(data, rod)
        return np.asarray(d / np.linalg.norm(d))
