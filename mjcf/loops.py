"""Loop closures of a MuJoCo model, and motions of its bodies, at the state in `data`."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import mujoco
import numpy as np

from newton_euler.model.euler_parameters import conjugate, product
from newton_euler.scalars import Array, cross


def body_velocity(model: Any, data: Any, body: int) -> tuple[Array, Array]:
    """Return the velocity (3,) of the center of mass, m/s, and the angular velocity (3,), rad/s.

    Call `mj_fwdVelocity` first.
    """
    out = np.zeros(6)
    mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_BODY, body, out, 0)
    return out[3:], out[:3]


def body_acceleration(model: Any, data: Any, body: int) -> tuple[Array, Array]:
    """Return the acceleration (3,) of the center of mass, m/s^2, and the angular one (3,), rad/s^2.

    Call `mj_rnePostConstraint` first.
    """
    out = np.zeros(6)
    mujoco.mj_objectAcceleration(model, data, mujoco.mjtObj.mjOBJ_BODY, body, out, 0)
    return out[3:] + model.opt.gravity, out[:3]  # MuJoCo reports what an accelerometer measures


class Loop:
    """Equality constraint that closes a loop, at the state in `data`.

    MuJoCo computes the rows efc_J of a constraint. A hard constraint also needs Jdot v, the second rate of
    the residuals at qacc = 0, which follows from the residuals of MuJoCo's documentation (Computation,
    section Equality). With bodies 1 and 2 of a constraint,

        connect:  p1 - p2                                             (world frame)
        weld:     p1 - p2,  vec(conj(q2) q1)                          (halves share their frame)
        tendon:   |p2 - p1| - its length at the initial pose          (of a rod)

    where vec is the vector part of a quaternion. With w = omega1 - omega2, the first rate is
    d/dt vec(conj(q2) q1) = 1/2 vec(conj(q2) w q1), and the second rate is

        d2/dt2 = 1/2 vec(conj(q2) (alpha1 - alpha2) q1) + 1/4 vec(conj(q2) (w omega1 - omega2 w) q1).

    With d = p2 - p1 and its length l, d2l/dt2 = (d . d2d/dt2 + |dd/dt|^2 - (dl/dt)^2) / l.

    Attributes:
        index: MuJoCo's number of the equality.
        name: name of the joint that closes the loop.
        kind: `mjtEq`.
        rows: numbers of the constraint rows.
        bodies: MuJoCo's numbers of bodies 1 and 2.
        points: constrained points (3,) on bodies 1 and 2, m, world frame.
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
            return closure_ends(model, data, self.index)
        first = model.tendon_adr[model.eq_obj1id[self.index]]
        sites = model.wrap_objid[first : first + 2]
        return tuple(int(body) for body in model.site_bodyid[sites]), tuple(data.site_xpos[sites])

    def force_on_second(self) -> Array:
        """Return the force (3,), N, of a ball or rod on its second body, for the multipliers in `data`."""
        multipliers = np.asarray(self.data.efc_force[self.rows])
        if self.kind == mujoco.mjtEq.mjEQ_TENDON:
            d = self.points[1] - self.points[0]
            return np.asarray(np.sum(multipliers) * d / np.linalg.norm(d))
        return -multipliers

    def velocity_product(self) -> Array:
        """Return Jdot v, one element for each row, from the accelerations in `data` for qacc = 0.

        `mj_jacDot` is not used because it is wrong for a ball on a body with slides after the ball.
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


def closure_ends(model: Any, data: Any, index: int) -> tuple[tuple[int, ...], tuple[Array, ...]]:
    """Return the two bodies of a connect or weld, and its point (3,) on each of them, m, world frame."""
    first, second = int(model.eq_obj1id[index]), int(model.eq_obj2id[index])
    if model.eq_objtype[index] == mujoco.mjtObj.mjOBJ_SITE:
        bodies = int(model.site_bodyid[first]), int(model.site_bodyid[second])
        return bodies, (data.site_xpos[first].copy(), data.site_xpos[second].copy())
    anchors = model.eq_data[index][:3], model.eq_data[index][3:6]
    if model.eq_type[index] == mujoco.mjtEq.mjEQ_WELD:
        anchors = anchors[::-1]  # a weld stores the anchor in the frame of the second body first
    p, q = (
        data.xpos[body] + data.xmat[body].reshape(3, 3) @ anchor
        for body, anchor in zip((first, second), anchors, strict=True)
    )
    return (first, second), (p, q)


def closes_loop(model: Any, index: int) -> bool:
    """True if an equality closes a loop; all other equalities couple joint coordinates."""
    kind = model.eq_type[index]
    if kind == mujoco.mjtEq.mjEQ_TENDON:
        first = model.wrap_type[model.tendon_adr[model.eq_obj1id[index]]]
        return bool(first != mujoco.mjtWrap.mjWRAP_JOINT)
    return bool(kind != mujoco.mjtEq.mjEQ_JOINT)


def active_loops(model: Any, data: Any) -> list[Loop]:
    """Return all active loops at the state in `data`, with or without constraint rows."""
    closing = [index for index in np.flatnonzero(data.eq_active).tolist() if closes_loop(model, index)]
    return [Loop(model, data, index) for index in closing]


def loops_with_rows(model: Any, data: Any) -> list[Loop]:
    """Return the active loops with constraint rows.

    MuJoCo drops loops that cannot open, such as a ball on the axis of the only hinge.
    """
    return [loop for loop in active_loops(model, data) if len(loop.rows)]
