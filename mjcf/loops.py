"""The equality constraints that close loops, as rigid-body mechanics sees them.

MuJoCo gives a constraint's rows efc_J; what a hard constraint needs beside them is Jdot v, the second
rate of the residuals at qacc = 0. It follows from the residuals of MuJoCo's documentation
(Computation, section Equality). With bodies 1 and 2 of a constraint,

    connect:  p1 - p2                                             (world frame)
    weld:     p1 - p2,  vec(conj(q2) q1)                          (halves share their frame)
    tendon:   |p2 - p1| - its length at the initial pose          (of a rod)

where vec is the vector part of a quaternion. d/dt vec(conj(q2) q1) = 1/2 vec(conj(q2) w q1) with
w = omega1 - omega2, and once more,

    d2/dt2 = 1/2 vec(conj(q2) (alpha1 - alpha2) q1) + 1/4 vec(conj(q2) (w omega1 - omega2 w) q1).

With d = p2 - p1 and its length l, d2l/dt2 = (d . d2d/dt2 + |dd/dt|^2 - (dl/dt)^2) / l.
"""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from mjcf.motion import body_acceleration, body_velocity
from newton_euler.model.euler_parameters import conjugate, product
from newton_euler.scalars import Array, cross


class Loop:
    """One equality constraint of a model that closes a loop, at the state that `data` holds.

    Attributes:
        index: MuJoCo's number of the equality.
        name: the cut joint's.
        kind: `mjtEq`.
        rows: which rows of MuJoCo's constraints are its own.
        bodies: MuJoCo's numbers of bodies 1 and 2.
        points: the constrained point as each of them has it, (3,) world, m.
    """

    def __init__(self, model: Any, data: Any, index: int) -> None:
        self.model, self.data, self.index = model, data, index
        self.name: str = model.equality(index).name
        self.rows = np.flatnonzero(np.asarray(data.efc_id) == index)
        self.kind = mujoco.mjtEq(model.eq_type[index])
        if self.kind == mujoco.mjtEq.mjEQ_TENDON:
            first = model.tendon_adr[model.eq_obj1id[index]]
            sites = model.wrap_objid[first : first + 2]
            self.bodies = tuple(int(body) for body in model.site_bodyid[sites])
            self.points = tuple(data.site_xpos[sites])
            return
        self.bodies = (int(model.eq_obj1id[index]), int(model.eq_obj2id[index]))
        parameters = model.eq_data[index]
        anchors = parameters[:3], parameters[3:6]
        if self.kind == mujoco.mjtEq.mjEQ_WELD:
            anchors = anchors[::-1]
        self.points = tuple(
            data.xpos[body] + data.xmat[body].reshape(3, 3) @ anchor
            for body, anchor in zip(self.bodies, anchors, strict=True)
        )

    def force_on_second(self) -> Array:
        """(3,) N, what a ball or a rod does to its second body, once multipliers are known."""
        multipliers = np.asarray(self.data.efc_force[self.rows])
        if self.kind == mujoco.mjtEq.mjEQ_TENDON:
            d = self.points[1] - self.points[0]
            return np.asarray(np.sum(multipliers) * d / np.linalg.norm(d))
        return -multipliers

    def velocity_product(self) -> Array:
        """Jdot v, one element for each row, from the accelerations that `data` holds for qacc = 0.

        Not by `mj_jacDot`: it is wrong for a ball whose body has slides after it.
        """
        velocity, linear, angular, spin = [], [], [], []
        for body, point in zip(self.bodies, self.points, strict=True):
            acceleration, alpha = body_acceleration(self.model, self.data, body)
            v, omega = body_velocity(self.model, self.data, body)
            arm = point - self.data.xipos[body]
            velocity.append(v + cross(omega, arm))
            linear.append(acceleration + cross(alpha, arm) + cross(omega, cross(omega, arm)))
            angular.append(alpha)
            spin.append(np.concatenate([[0.0], omega]))
        if self.kind == mujoco.mjtEq.mjEQ_CONNECT:
            return np.asarray(linear[0] - linear[1])
        if self.kind == mujoco.mjtEq.mjEQ_TENDON:
            d, rate = self.points[1] - self.points[0], velocity[1] - velocity[0]
            length = np.linalg.norm(d)
            along = d @ rate / length
            return np.array([(d @ (linear[1] - linear[0]) + rate @ rate - along * along) / length])
        relative = spin[0] - spin[1]
        turning = 0.5 * np.concatenate([[0.0], angular[0] - angular[1]])
        turning += 0.25 * (product(relative, spin[0]) - product(spin[1], relative))
        q1, q2 = (self.data.xquat[body] for body in self.bodies)
        turned = product(conjugate(q2), product(turning, q1))[1:]
        return np.concatenate([linear[0] - linear[1], turned])


def closes(model: Any, index: int) -> bool:
    """True if an equality closes a loop; others couple joint coordinates, through a tendon if several."""
    kind = model.eq_type[index]
    if kind == mujoco.mjtEq.mjEQ_TENDON:
        first = model.wrap_type[model.tendon_adr[model.eq_obj1id[index]]]
        return bool(first != mujoco.mjtWrap.mjWRAP_JOINT)
    return bool(kind != mujoco.mjtEq.mjEQ_JOINT)


def all_loops(model: Any, data: Any) -> list[Loop]:
    """All active loops at the state that `data` holds, whether MuJoCo has rows for them or not."""
    closing = [index for index in np.flatnonzero(data.eq_active).tolist() if closes(model, index)]
    return [Loop(model, data, index) for index in closing]


def loops(model: Any, data: Any) -> list[Loop]:
    """Those with rows: MuJoCo drops what cannot open, such as a ball on the axis of the only hinge."""
    return [loop for loop in all_loops(model, data) if len(loop.rows)]
