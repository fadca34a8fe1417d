"""Loop closures of a MuJoCo model: points, forces and second derivatives of equality constraints.

In MuJoCo, `connect`, `weld` and `tendon` equalities close the loops of a mechanism; equalities of joints
couple coordinates instead. Such a tendon between two sites is a rod, a massless link of constant length.
"""

from __future__ import annotations

from functools import cached_property
from typing import Any

import mujoco
import numpy as np

from newton_euler.model.euler_parameters import conjugate, product
from newton_euler.scalars import Array, cross


def body_velocity(model: Any, data: Any, body: int) -> tuple[Array, Array]:
    """Return the velocity (3,) of a body's center of mass, m/s, and its angular velocity (3,), rad/s.

    Vectors are in the world frame. `data` needs `mj_fwdVelocity`.
    """
    angular_and_linear = np.zeros(6)
    mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_BODY, body, angular_and_linear, 0)
    return angular_and_linear[3:], angular_and_linear[:3]


def body_acceleration(model: Any, data: Any, body: int) -> tuple[Array, Array]:
    """Return the acceleration (3,) of a body's center of mass, m/s^2, and its angular acceleration (3,).

    The angular acceleration is in rad/s^2, and vectors are in the world frame. `data` needs
    `mj_rnePostConstraint`. MuJoCo returns the acceleration that an accelerometer measures, without gravity.
    """
    angular_and_linear = np.zeros(6)
    mujoco.mj_objectAcceleration(model, data, mujoco.mjtObj.mjOBJ_BODY, body, angular_and_linear, 0)
    return angular_and_linear[3:] + model.opt.gravity, angular_and_linear[:3]


def fixed_tendon_weights(model: Any, tendon: int) -> dict[int, float] | None:
    """Return the weight of each of MuJoCo's joints in a fixed tendon, by number; None for other tendons.

    The length of a fixed tendon is the weighted sum of the joint coordinates.
    """
    rows = slice(int(model.tendon_adr[tendon]), int(model.tendon_adr[tendon] + model.tendon_num[tendon]))
    if np.any(model.wrap_type[rows] != mujoco.mjtWrap.mjWRAP_JOINT):
        return None
    weights: dict[int, float] = {}
    for joint, weight in zip(model.wrap_objid[rows], model.wrap_prm[rows], strict=True):
        weights[int(joint)] = weights.get(int(joint), 0.0) + float(weight)
    return weights


class Loop:
    """Equality constraint that closes a loop, at the state in `data`.

    All constraint rows in `data` must be those of equalities, none of limits, contacts or dry friction.

    MuJoCo computes the constraint Jacobian J = efc_J. A rigid constraint also needs Jdot v, the second time
    derivative of the residuals at qacc = 0. Jdot v follows from the residuals of MuJoCo's documentation
    (Computation, section Equality), which are, for the points p1, p2 on bodies 1 and 2 of a constraint,

        connect:  p1 - p2                                             (world frame)
        weld:     p1 - p2,  vec(conj(q2) q1)                          (of bodies with coinciding frames)
        tendon:   |p2 - p1| - its length at the initial pose

    where vec is the vector part of a quaternion. With w = omega1 - omega2, the first derivative is
    d/dt vec(conj(q2) q1) = 1/2 vec(conj(q2) w q1), and the second derivative is

        d2/dt2 = 1/2 vec(conj(q2) (alpha1 - alpha2) q1) + 1/4 vec(conj(q2) (w omega1 - omega2 w) q1).

    With d = p2 - p1 and its length l, d2l/dt2 = (d . d2d/dt2 + |dd/dt|^2 - (dl/dt)^2) / l.

    Attributes:
        index: MuJoCo's number of the equality.
        name: name of the equality. In an exported mechanism, joint and equality have the same name.
        kind: type of the equality, `mjtEq`.
        rows: numbers of the equality's constraint rows in `data`.
        bodies: MuJoCo's numbers of bodies 1 and 2.
        points: constrained points (3,) on bodies 1 and 2, m, world frame.
    """

    def __init__(self, model: Any, data: Any, index: int) -> None:
        """Take an `MjModel`, its `MjData`, and the number of an equality that closes a loop."""
        self.model, self.data, self.index = model, data, index
        self.rows = np.flatnonzero(np.asarray(data.efc_id) == index)
        self.kind = mujoco.mjtEq(model.eq_type[index])

    @cached_property
    def name(self) -> str:
        """Name of the equality; in an exported mechanism, the name of the joint that closes the loop."""
        return self.model.equality(self.index).name

    @property
    def bodies(self) -> tuple[int, ...]:
        """MuJoCo's numbers of bodies 1 and 2."""
        return self._ends[0]

    @property
    def points(self) -> tuple[Array, ...]:
        """Constrained points (3,) on bodies 1 and 2, m, world frame."""
        return self._ends[1]

    @cached_property
    def _ends(self) -> tuple[tuple[int, ...], tuple[Array, ...]]:
        """Numbers of both bodies, and the constrained point on each of them."""
        model, data = self.model, self.data
        if self.kind != mujoco.mjtEq.mjEQ_TENDON:
            return closure_ends(model, data, self.index)
        first = model.tendon_adr[model.eq_obj1id[self.index]]
        sites = model.wrap_objid[first : first + 2]
        return tuple(int(body) for body in model.site_bodyid[sites]), tuple(data.site_xpos[sites])

    def force_on_second(self) -> Array:
        """Return the force (3,), N, world frame, on the second body of a connect or tendon.

        The force follows from the multipliers in `data.efc_force`.
        """
        multipliers = np.asarray(self.data.efc_force[self.rows])
        if self.kind == mujoco.mjtEq.mjEQ_TENDON:
            d = self.points[1] - self.points[0]
            return np.asarray(np.sum(multipliers) * d / np.linalg.norm(d))
        return -multipliers

    def velocity_product(self) -> Array:
        """Return Jdot v, one element for each row of the constraint, m/s^2 or 1/s^2.

        `data` needs the accelerations of `mj_rnePostConstraint` for qacc = 0. `mj_jacDot` is not used because
        it is wrong for a ball that a slide of the same body follows.
        """
        # motion of the constrained point on each body; omegas as quaternions (0, omega)
        point_velocities, point_accelerations, angular_accelerations, omegas = [], [], [], []
        for body, point in zip(self.bodies, self.points, strict=True):
            acceleration, alpha = body_acceleration(self.model, self.data, body)
            velocity, omega = body_velocity(self.model, self.data, body)
            arm = point - self.data.xipos[body]
            point_velocities.append(velocity + cross(omega, arm))
            point_accelerations.append(acceleration + cross(alpha, arm) + cross(omega, cross(omega, arm)))
            angular_accelerations.append(alpha)
            omegas.append(np.concatenate([[0.0], omega]))
        if self.kind == mujoco.mjtEq.mjEQ_CONNECT:
            return np.asarray(point_accelerations[0] - point_accelerations[1])
        if self.kind == mujoco.mjtEq.mjEQ_TENDON:
            d, d_rate = self.points[1] - self.points[0], point_velocities[1] - point_velocities[0]
            length = np.linalg.norm(d)
            length_rate = d @ d_rate / length
            d_acceleration = point_accelerations[1] - point_accelerations[0]
            return np.array([(d @ d_acceleration + d_rate @ d_rate - length_rate * length_rate) / length])
        # weld: second derivative of vec(conj(q2) q1), see the docstring of the class
        w = omegas[0] - omegas[1]
        inner = 0.5 * np.concatenate([[0.0], angular_accelerations[0] - angular_accelerations[1]])
        inner += 0.25 * (product(w, omegas[0]) - product(omegas[1], w))
        q1, q2 = (self.data.xquat[body] for body in self.bodies)
        rotational = product(conjugate(q2), product(inner, q1))[1:]
        return np.concatenate([point_accelerations[0] - point_accelerations[1], rotational])


def closure_ends(model: Any, data: Any, index: int) -> tuple[tuple[int, ...], tuple[Array, ...]]:
    """Return the two bodies of a connect or weld, and the constrained point (3,) on each of them.

    Bodies are MuJoCo's numbers. Points are in m, world frame.
    """
    first, second = int(model.eq_obj1id[index]), int(model.eq_obj2id[index])
    if model.eq_objtype[index] == mujoco.mjtObj.mjOBJ_SITE:
        bodies = int(model.site_bodyid[first]), int(model.site_bodyid[second])
        return bodies, (data.site_xpos[first].copy(), data.site_xpos[second].copy())
    # eq_data of a connect: anchor in body 1, anchor in body 2; of a weld: anchor in body 2, anchor in body 1
    anchors = model.eq_data[index][:3], model.eq_data[index][3:6]
    if model.eq_type[index] == mujoco.mjtEq.mjEQ_WELD:
        anchors = anchors[::-1]
    point_on_first, point_on_second = (
        data.xpos[body] + data.xmat[body].reshape(3, 3) @ anchor
        for body, anchor in zip((first, second), anchors, strict=True)
    )
    return (first, second), (point_on_first, point_on_second)


def closes_loop(model: Any, index: int) -> bool:
    """Return True if equality number `index` closes a loop; other equalities couple joint coordinates.

    An equality of a fixed tendon, a weighted sum of joint coordinates, is such a coupling.
    """
    kind = model.eq_type[index]
    if kind == mujoco.mjtEq.mjEQ_TENDON:
        wrap_type = model.wrap_type[model.tendon_adr[model.eq_obj1id[index]]]
        return bool(wrap_type != mujoco.mjtWrap.mjWRAP_JOINT)
    return bool(kind != mujoco.mjtEq.mjEQ_JOINT)


def active_loops(model: Any, data: Any) -> list[Loop]:
    """Return a `Loop` for each active equality that closes a loop, at the state in `data`."""
    indices = [index for index in np.flatnonzero(data.eq_active).tolist() if closes_loop(model, index)]
    return [Loop(model, data, index) for index in indices]


def loops_with_rows(model: Any, data: Any) -> list[Loop]:
    """Return the active loops that have constraint rows in `data`.

    MuJoCo drops rows of zeros: those of a loop that no motion can open, such as a ball on the axis of the
    only hinge.
    """
    return [loop for loop in active_loops(model, data) if len(loop.rows)]
