"""Constraint errors and Jacobians from Pinocchio's kinematics: closures, rods, couplings and motions.

`constraintDynamics` supports closures, but not rods, couplings and prescribed motions. With points p1 and p2
of a rod, d = p2 - p1 and l = |d|,

    Phi = l - L,    Phi_q = d^T (J2 - J1) / l
    Phi_q qddot + (d . (a2 - a1) + |dd/dt|^2 - (dl/dt)^2) / l = 0

with accelerations a1 and a2 of the points at qddot = 0. Motions are linear in q. Couplings are sums of
polynomials p(x) of joint coordinates,

    Phi = sum p(x),    Phi_x = p'(x),    Phi_q qddot + sum p''(x) (dx/dt)^2 = 0
"""

from __future__ import annotations

from math import perm
from typing import Any

import numpy as np
import pinocchio as pin

from newton_euler.equations.couplings import TreeCouplings
from newton_euler.scalars import Array
from urdf.model import ClosedLoopModel, CoordinateMap


class Closures:
    """Rigid constraints of a model, with 3 or 6 rows each.

    The rows are the first origin minus the second, m, world frame. A weld also has the rotation vector from
    the first frame to the second, rad.

    Attributes:
        units: (k,) units of the rows: `length` (m) for lengths, 1 for angles.
        pairs: frames of each constraint, and True for a weld.
    """

    def __init__(self, closed: ClosedLoopModel, map: CoordinateMap, length: float) -> None:
        self._model, self._map = closed.model, map
        welds = [constraint.type == pin.ContactType.CONTACT_6D for constraint in closed.constraints]
        self.pairs = list(zip(closed.frames, welds, strict=True))
        of_weld = np.repeat([length, 1.0], 3)
        units = [of_weld if weld else of_weld[:3] for weld in welds]
        self.units = np.concatenate([np.zeros(0), *units])

    def phi(self, data: Any) -> Array:
        """Return the constraint errors (k,); `data` needs frame placements."""
        rows = [np.zeros(0)]
        for (first, second), weld in self.pairs:
            a, b = data.oMf[first], data.oMf[second]
            rows.append(a.translation - b.translation)
            if weld:
                rows.append(pin.log3(a.rotation.T @ b.rotation))
        return np.concatenate(rows)

    def jacobian(self, data: Any) -> Array:
        """Return the Jacobian (k, nv) in tree velocities; `data` needs joint Jacobians and placements."""
        rows = [np.zeros((0, self._model.nv))]
        for (first, second), weld in self.pairs:
            difference = frame_jacobian(self._model, data, first) - frame_jacobian(self._model, data, second)
            rows.append(difference[:3])
            if weld:
                a, b = data.oMf[first].rotation, data.oMf[second].rotation
                rows.append(-pin.Jlog3(a.T @ b) @ b.T @ difference[3:])
        return self._map.v_from_pinocchio(np.concatenate(rows))

    def gamma(self, data: Any) -> Array:
        """Return gamma (k,) of Phi_q qddot = gamma for closed loops.

        `data` needs `forwardKinematics` at qddot = 0.
        """
        rows = [np.zeros(0)]
        for (first, second), weld in self.pairs:
            of = (self._model, data)
            a, b = (
                pin.getFrameClassicalAcceleration(*of, k, pin.LOCAL_WORLD_ALIGNED) for k in (first, second)
            )
            rows.append(b.linear - a.linear)
            if weld:
                rows.append(data.oMf[second].rotation.T @ (a.angular - b.angular))
        return np.concatenate(rows)

    def wrenches(self, data: Any, multipliers: Array) -> list[Any]:
        """Return the wrenches of multipliers (k,) on second bodies about the world's origin."""
        found, start = [], 0
        for (first, second), weld in self.pairs:
            b = data.oMf[second]
            force, torque = -multipliers[start : start + 3], np.zeros(3)
            if weld:
                turned = pin.Jlog3(data.oMf[first].rotation.T @ b.rotation) @ b.rotation.T
                torque = turned.T @ multipliers[start + 3 : start + 6]
            found.append(pin.Force(force, torque + np.cross(b.translation, force)))
            start += 6 if weld else 3
        return found


def frame_jacobian(model: Any, data: Any, frame: int) -> Array:
    """Return the Jacobian (6, nv) of a frame's linear and angular velocity, world axes, Pinocchio's order."""
    jacobian = pin.getFrameJacobian(model, data, frame, pin.LOCAL_WORLD_ALIGNED)
    return np.reshape(jacobian, (6, model.nv))  # Pinocchio returns a single column as a vector


def power_sums(powers: Array, x: Array, derivative: int) -> Array:
    """Evaluate polynomials (c, n) of coordinates x (n,), or their derivatives, by Horner's rule.

    Args:
        powers: (c, d, n) factors of the powers 1 to d.
        x: coordinates, m or rad.
        derivative: order, 0, 1 or 2.
    """
    total = np.zeros((len(powers), len(x)))
    for k in range(powers.shape[1], max(derivative, 1) - 1, -1):
        total = total * x + perm(k, derivative) * powers[:, k - 1]
    return total if derivative else total * x


class Rows:
    """Constraint rows that `constraintDynamics` does not support: rods, prescribed motions, screws, gears.

    Attributes:
        units: (r,) units of the rows: `length` (m) for lengths, 1 for angles.
    """

    def __init__(
        self,
        closed: ClosedLoopModel,
        map: CoordinateMap,
        couplings: TreeCouplings,
        length: float,
    ) -> None:
        self._model, self._rods, self._map, self._couplings = closed.model, closed.rods, map, couplings
        data = self._model.createData()
        pin.framesForwardKinematics(self._model, data, pin.neutral(self._model))
        self._lengths = [float(np.linalg.norm(self._line(data, rod))) for rod in self._rods]
        # couplings come from the loop file, motions from the scene
        self._motions = len(couplings.couplings) - len(closed.couplings)
        self._powers = map.v_from_pinocchio(closed.couplings)  # (c, d, nv)
        self.units = np.concatenate([np.full(len(self._rods), length), couplings.units])

    def phi(self, data: Any, q: Array, time: float) -> Array:
        """Return constraint errors (r,), m or rad; `data` needs `framesForwardKinematics` at q."""
        open_by = [
            float(np.linalg.norm(self._line(data, rod))) - length
            for rod, length in zip(self._rods, self._lengths, strict=True)
        ]
        return np.concatenate([open_by, self._couplings.phi(q, time)])

    def phi_t(self, time: float) -> Array:
        """Return the partial derivative (r,) of `phi` with respect to time."""
        return np.concatenate([np.zeros(len(self._rods)), -self._couplings.rate(time)])

    def jacobian(self, data: Any, q: Array) -> Array:
        """Return the Jacobian (r, nv) in tree velocities.

        `data` needs `computeJointJacobians` and `updateFramePlacements` at tree coordinates q.
        """
        rows = []
        for rod in self._rods:
            first, second = (frame_jacobian(self._model, data, frame) for frame in rod)
            line = self._direction(data, rod)[None] @ (second - first)[:3]
            rows.append(self._map.v_from_pinocchio(line))
        if self._motions:
            rows.append(self._couplings.jacobian(q)[: self._motions])
        return np.concatenate([*rows, power_sums(self._powers, self._map.displacements(q), 1)])

    def gamma(self, data: Any, q: Array, v: Array, time: float) -> Array:
        """Return gamma (r,) of Phi_q qddot = gamma; `data` needs `forwardKinematics` at qddot = 0."""
        model, aligned = self._model, pin.LOCAL_WORLD_ALIGNED
        products = []
        for rod in self._rods:
            v1, v2 = (pin.getFrameVelocity(model, data, frame, aligned).linear for frame in rod)
            a1, a2 = (pin.getFrameClassicalAcceleration(model, data, frame, aligned).linear for frame in rod)
            length, rate = np.linalg.norm(self._line(data, rod)), v2 - v1
            u = self._direction(data, rod)
            products.append(u @ (a2 - a1) + (rate @ rate - (u @ rate) ** 2) / length)
        asked = self._couplings.acceleration(time)
        asked[self._motions :] -= power_sums(self._powers, self._map.displacements(q), 2) @ v**2
        return np.concatenate([-np.array(products), asked])

    def rod_wrenches(self, data: Any, multipliers: Array) -> list[Any]:
        """Compute wrenches of rods on their second bodies, about the world's origin."""
        wrenches = []
        for rod, multiplier in zip(self._rods, multipliers, strict=False):
            force = multiplier * self._direction(data, rod)
            wrenches.append(pin.Force(force, np.cross(data.oMf[rod[1]].translation, force)))
        return wrenches

    def motion_power(self, multipliers: Array, time: float) -> float:
        """Return the power of prescribed motions, W."""
        return float(multipliers[len(self._rods) :] @ self._couplings.rate(time))

    def _line(self, data: Any, rod: tuple[int, int]) -> Array:
        """Return the vector (3,), m, from the first point to the second."""
        return np.asarray(data.oMf[rod[1]].translation - data.oMf[rod[0]].translation)

    def _direction(self, data: Any, rod: tuple[int, int]) -> Array:
        d = self._line(data, rod)
        return np.asarray(d / np.linalg.norm(d))
