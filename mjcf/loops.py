"""The equality constraints that close loops, as rigid-body mechanics sees them.

MuJoCo gives a constraint's rows efc_J; what a hard constraint needs beside them is Jdot v, and
what a reaction needs is the wrench that multipliers stand for. Both follow from the residuals of
MuJoCo's documentation (Computation, section Equality). With bodies 1 and 2 of a constraint,

    connect:  p1 - p2                                             (world frame)
    weld:     p1 - p2,  vec(conj(q2) q1)                          (halves share their frame)

where vec is the vector part of a quaternion. d/dt vec(conj(q2) q1) = 1/2 vec(conj(q2) w q1) with
w = omega1 - omega2, and once more,

    d2/dt2 = 1/2 vec(conj(q2) (alpha1 - alpha2) q1) + 1/4 vec(conj(q2) (w omega1 - omega2 w) q1).
"""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from newton_euler.euler_parameters import conjugate, product
from newton_euler.scalars import Array, cross


class Loop:
    """One equality constraint of a model, at the state that `data` holds.

    Attributes:
        name: the cut joint's.
        rows: which rows of MuJoCo's constraints are its own.
        bodies: MuJoCo's numbers of bodies 1 and 2.
        points: the constrained point as each of them has it, (3,) world, m.
    """

    def __init__(self, model: Any, data: Any, index: int) -> None:
        self.model, self.data = model, data
        equality = model.equality(index)
        self.name: str = equality.name
        self.rows = np.flatnonzero(np.asarray(data.efc_id) == index)
        self.bodies = (int(model.eq_obj1id[index]), int(model.eq_obj2id[index]))
        self.is_weld = model.eq_type[index] == mujoco.mjtEq.mjEQ_WELD
        parameters = model.eq_data[index]
        anchors = (
            (parameters[3:6], parameters[:3]) if self.is_weld else (parameters[:3], parameters[3:6])
        )
        self.points = tuple(
            data.xpos[body] + data.xmat[body].reshape(3, 3) @ anchor
            for body, anchor in zip(self.bodies, anchors, strict=True)
        )

    def _vector_part(self, between: Array) -> Array:
        """vec(conj(q2) between q1)."""
        q1, q2 = (self.data.xquat[body] for body in self.bodies)
        return product(conjugate(q2), product(between, q1))[1:]

    def _turning(self) -> Array:
        """(3, 3): what omega1 - omega2 is multiplied by in the rate of a weld's last three rows."""
        return np.array([0.5 * self._vector_part(unit) for unit in np.eye(4)[1:]]).T

    def velocity_product(self) -> Array:
        """Jdot v, one element for each row."""
        nv = self.model.nv
        linear, angular, spin = [], [], []
        for body, point in zip(self.bodies, self.points, strict=True):
            jacp_rate, jacr_rate, jacr = (np.zeros((3, nv)) for _ in range(3))
            mujoco.mj_jacDot(self.model, self.data, jacp_rate, jacr_rate, point, body)
            mujoco.mj_jac(self.model, self.data, None, jacr, point, body)
            linear.append(jacp_rate @ self.data.qvel)
            angular.append(jacr_rate @ self.data.qvel)
            spin.append(np.concatenate([[0.0], jacr @ self.data.qvel]))
        if not self.is_weld:
            return np.asarray(linear[0] - linear[1])
        relative = spin[0] - spin[1]
        quadratic = product(relative, spin[0]) - product(spin[1], relative)
        turning = self._turning() @ (angular[0] - angular[1]) + 0.25 * self._vector_part(quadratic)
        return np.concatenate([linear[0] - linear[1], turning])

    def wrench_on_first(self, multipliers: Array) -> tuple[Array, Array]:
        """Force and couple (3,) on body 1 at its point; body 2 has the opposite at its own."""
        force = multipliers[self.rows[:3]]
        couple = self._turning().T @ multipliers[self.rows[3:]] if self.is_weld else np.zeros(3)
        return force, couple

    def apply(self, multipliers: Array) -> None:
        """Add the constraint's wrenches to `data.xfrc_applied`, about the centres of mass."""
        force, couple = self.wrench_on_first(multipliers)
        for body, point, sign in zip(self.bodies, self.points, (1.0, -1.0), strict=True):
            torque = couple + cross(point - self.data.xipos[body], force)
            self.data.xfrc_applied[body] += sign * np.concatenate([force, torque])


def loops(model: Any, data: Any) -> list[Loop]:
    """All loops at the state that `data` holds; MuJoCo drops those between bodies that are fixed."""
    found = [Loop(model, data, index) for index in range(model.neq)]
    return [loop for loop in found if len(loop.rows)]
