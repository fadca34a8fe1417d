"""The closures of a model by Pinocchio's frames, as projection and assembly see them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin

from newton_euler.scalars import Array
from urdf.model import ClosedLoopModel, CoordinateMap


class Closures:
    """Residuals of the rigid constraints of a model, 3 rows of each or 6.

    Of each: first origin less second, world frame, m; for a weld also the rotation vector that takes the
    first frame to the second, rad.

    Attributes:
        units: (k,) what makes the rows dimensionless: `length` (m) for lengths, 1 for angles.
        pairs: frames of each constraint, and whether it is a weld.
    """

    def __init__(self, closed: ClosedLoopModel, map: CoordinateMap, length: float) -> None:
        self._model, self._map = closed.model, map
        welds = [constraint.type == pin.ContactType.CONTACT_6D for constraint in closed.constraints]
        self.pairs = list(zip(closed.frames, welds, strict=True))
        of_weld = np.repeat([length, 1.0], 3)
        units = [of_weld if weld else of_weld[:3] for weld in welds]
        self.units = np.concatenate([np.zeros(0), *units])

    def phi(self, data: Any) -> Array:
        """Residuals (k,); of data with frame placements."""
        rows = [np.zeros(0)]
        for (first, second), weld in self.pairs:
            a, b = data.oMf[first], data.oMf[second]
            rows.append(a.translation - b.translation)
            if weld:
                rows.append(pin.log3(a.rotation.T @ b.rotation))
        return np.concatenate(rows)

    def jacobian(self, data: Any) -> Array:
        """(k, nv) in tree velocities; of data with joint Jacobians and frame placements."""
        rows = [np.zeros((0, self._model.nv))]
        for (first, second), weld in self.pairs:
            difference = frame_jacobian(self._model, data, first) - frame_jacobian(self._model, data, second)
            rows.append(difference[:3])
            if weld:
                a, b = data.oMf[first].rotation, data.oMf[second].rotation
                rows.append(-pin.Jlog3(a.T @ b) @ b.T @ difference[3:])
        return self._map.v_from_pinocchio(np.concatenate(rows))

    def gamma(self, data: Any) -> Array:
        """(k,) right side of Phi_q qddot = gamma where they are closed; of data after `forwardKinematics` at
        qddot = 0."""
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
        """Wrenches of multipliers (k,) on second bodies about the world's origin; of data with placements."""
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
    """(6, nv) in Pinocchio's order: velocity of the frame's origin, angular velocity; world."""
    jacobian = pin.getFrameJacobian(model, data, frame, pin.LOCAL_WORLD_ALIGNED)
    return np.reshape(jacobian, (6, model.nv))  # a single column comes as a vector
