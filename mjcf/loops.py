"""Closed loops of MuJoCo's models, and motions of their bodies, at the states that `data` holds."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import mujoco
import numpy as np

from newton_euler.model.euler_parameters import conjugate, product
from newton_euler.scalars import Array, cross


def body_velocity(model: Any, data: Any, body: int) -> tuple[Array, Array]:
    """(3,) of the center of mass, m/s, and (3,) angular, rad/s, after `mj_fwdVelocity`."""
    out = np.zeros(6)
    mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_BODY, body, out, 0)
    return out[3:], out[:3]


def body_acceleration(model: Any, data: Any, body: int) -> tuple[Array, Array]:
    """(3,) of the center of mass, m/s^2, and (3,) angular, rad/s^2, after `mj_rnePostConstraint`."""
    out = np.zeros(6)
    mujoco.mj_objectAcceleration(model, data, mujoco.mjtObj.mjOBJ_BODY, body, out, 0)
    return out[3:] + model.opt.gravity, out[:3]  # without gravity it is what an accelerometer reads


class Loop:
    """One equality constraint of a model that closes a loop, at the state that `data` holds.

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
        self.rows = np.flatnonzero(np.asarray(data.efc_id) == index)
        self.kind = mujoco.mjtEq(model.eq_type[index])

    @cached_property
    def name(self) -> str:
        return self.model.equality(self.index).name

    @property
    def bodies(self) -> tuple[int, ...]:
        return self._ends[0]

    @property
    def points(self) -> tuple[Array, ...]:
        return self._ends[1]

    @cached_property
    def _ends(self) -> tuple[tuple[int, ...], tuple[Array, ...]]:
        model, data = self.model, self.data
        if self.kind != mujoco.mjtEq.mjEQ_TENDON:
            return ends(model, data, self.index)
        first = model.tendon_adr[model.eq_obj1id[self.index]]
        sites = model.wrap_objid[first : first + 2]
        return tuple(int(body) for body in model.site_bodyid[sites]), tuple(data.site_xpos[sites])

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


def ends(model: Any, data: Any, index: int) -> tuple[tuple[int, ...], tuple[Array, ...]]:
    """MuJoCo's bodies of a connect or weld, and its point as each of them has it, (3,) world."""
    first, second = int(model.eq_obj1id[index]), int(model.eq_obj2id[index])
    if model.eq_objtype[index] == mujoco.mjtObj.mjOBJ_SITE:
        bodies = int(model.site_bodyid[first]), int(model.site_bodyid[second])
        return bodies, (data.site_xpos[first].copy(), data.site_xpos[second].copy())
    anchors = model.eq_data[index][:3], model.eq_data[index][3:6]
    if model.eq_type[index] == mujoco.mjtEq.mjEQ_WELD:
        anchors = anchors[::-1]  # the anchor is in the second body's frame, its place in the first's next
    p, q = (
        data.xpos[body] + data.xmat[body].reshape(3, 3) @ anchor
        for body, anchor in zip((first, second), anchors, strict=True)
    )
    return (first, second), (p, q)


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
