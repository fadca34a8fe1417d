"""The equality constraints that close loops, as rigid-body mechanics sees them.

MuJoCo gives a constraint's rows efc_J; what a hard constraint needs beside them is Jdot v, the second
rate of the residuals at qacc = 0. It follows from the residuals of MuJoCo's documentation
(Computation, section Equality). With bodies 1 and 2 of a constraint,

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

from mjcf.motion import body_acceleration, body_velocity
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
        anchors = (parameters[3:6], parameters[:3]) if self.is_weld else (parameters[:3], parameters[3:6])
        self.points = tuple(
            data.xpos[body] + data.xmat[body].reshape(3, 3) @ anchor
            for body, anchor in zip(self.bodies, anchors, strict=True)
        )

    def velocity_product(self) -> Array:
        """Jdot v, one element for each row, from the accelerations that `data` holds for qacc = 0.

        Not by `mj_jacDot`: it is wrong for a ball whose body has slides after it.
        """
        linear, angular, spin = [], [], []
        for body, point in zip(self.bodies, self.points, strict=True):
            acceleration, alpha = body_acceleration(self.model, self.data, body)
            omega = body_velocity(self.model, self.data, body)[1]
            arm = point - self.data.xipos[body]
            linear.append(acceleration + cross(alpha, arm) + cross(omega, cross(omega, arm)))
            angular.append(alpha)
            spin.append(np.concatenate([[0.0], omega]))
        if not self.is_weld:
            return np.asarray(linear[0] - linear[1])
        relative = spin[0] - spin[1]
        turning = 0.5 * np.concatenate([[0.0], angular[0] - angular[1]])
        turning += 0.25 * (product(relative, spin[0]) - product(spin[1], relative))
        q1, q2 = (self.data.xquat[body] for body in self.bodies)
        turned = product(conjugate(q2), product(turning, q1))[1:]
        return np.concatenate([linear[0] - linear[1], turned])


def loops(model: Any, data: Any) -> list[Loop]:
    """All loops at the state that `data` holds; MuJoCo drops those between bodies that are fixed."""
    found = [Loop(model, data, index) for index in range(model.neq)]
    return [loop for loop in found if len(loop.rows)]
