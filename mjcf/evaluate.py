"""MuJoCo's evaluation of a state, once accelerations and multipliers are known, and its closed loops.

Shared by rigid and soft constraints: the same reactions follow from either's accelerations.
"""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from mjcf.model import CompiledScene, body_acceleration, body_velocity
from newton_euler.equations.system import Evaluation
from newton_euler.model.euler_parameters import conjugate, product
from newton_euler.model.hinge_angles import dual_axes
from newton_euler.scalars import Array, cross


def mass_and_force(model: mujoco.MjModel, data: mujoco.MjData) -> tuple[Array, Array]:
    """M (nv, nv) and f (nv,) of M qacc = f + J^T lambda, with positions and velocities worked out."""
    mujoco.mj_fwdActuation(model, data)
    mass = np.empty((model.nv, model.nv))
    mujoco.mj_fullM(model, data, mass)
    return mass, data.qfrc_passive + data.qfrc_actuator - data.qfrc_bias


def evaluation(compiled: CompiledScene, acceleration: Array, multipliers: Array) -> Evaluation:
    """Everything about the state that `compiled.data` holds.

    Args:
        compiled: with positions, velocities and actuation worked out.
        acceleration: (nv,) MuJoCo's qacc.
        multipliers: (nefc,) forces of MuJoCo's constraint rows.
    """
    model, data = compiled.model, compiled.data
    data.qacc[:] = acceleration
    data.efc_force[:] = multipliers
    data.xfrc_applied[:] = motor_wrenches(compiled)  # MuJoCo would leave them out of its balances
    mujoco.mj_rnePostConstraint(model, data)
    data.xfrc_applied[:] = 0.0
    linear, angular = body_accelerations(compiled)
    force, torque = reactions(compiled)
    return Evaluation(
        **vars(compiled.observation()),
        linear_acceleration=linear,
        angular_acceleration=angular,
        reaction_force=force,
        reaction_torque=torque,
        actuator_force=np.array(data.actuator_force[: len(compiled.scene.control)]),
    )


def constraint_jacobian(model: Any, data: Any) -> Array:
    """(nefc, nv) MuJoCo's efc_J, for velocities qvel, whether it is stored dense or sparse."""
    columns = np.zeros((model.nv, data.nefc))
    for column, unit in zip(columns, np.eye(model.nv), strict=True):
        mujoco.mj_mulJacVec(model, data, column, unit)
    return columns.T


def body_accelerations(compiled: CompiledScene) -> tuple[Array, Array]:
    """(b, 3) of the centers of mass and (b, 3) angular, once they are known."""
    count = len(compiled.mechanism.bodies)
    linear, angular = np.zeros((2, count, 3))
    for k, index in enumerate(compiled.body_id[1:count], start=1):
        linear[k], angular[k] = body_acceleration(compiled.model, compiled.data, index)
    return linear, angular


def reactions(compiled: CompiledScene) -> tuple[Array, Array]:
    """(j, 3) forces and torques on the second bodies at the joint points, once forces are known.

    A joint in the tree carries cfrc_int of its child less what its actuators and springs do; a cut
    ball or rod carries its multipliers. Welds hold no joint of the original mechanism.
    """
    model, data, mechanism = compiled.model, compiled.data, compiled.welded.mechanism
    count = len(compiled.mechanism.joints)
    forces, torques = np.zeros((len(mechanism.joints), 3)), np.zeros((len(mechanism.joints), 3))
    for loop in loops(model, data):
        if loop.kind != mujoco.mjtEq.mjEQ_WELD:
            forces[mechanism.joint_index(loop.name)] = loop.force_on_second()
    applied = joint_wrenches(compiled)
    for kept in compiled.tree.joints:
        if kept.joint >= len(mechanism.joints):
            continue  # bodies that only rods hold
        child = compiled.body_id[kept.child]
        sign = 1.0 if kept.forward else -1.0
        force, torque = data.cfrc_int[child, 3:], data.cfrc_int[child, :3]
        arm = data.subtree_com[model.body_rootid[child]] - compiled.joint_point(kept.joint)
        u_force, u_torque = applied[child, :3], applied[child, 3:]
        forces[kept.joint] = sign * (force - u_force)
        torques[kept.joint] = sign * (torque + cross(arm, force) - u_torque)
    return forces[:count], torques[:count]


def joint_wrenches(compiled: CompiledScene) -> Array:
    """(nbody, 6) force and torque on each of MuJoCo's bodies by what drives the joint above it.

    That is its actuators, springs and rotors. Of several hinges or slides, each is driven so that no work
    is done on the others: what pushes a slide has no torque about the joint point where all hinges meet.
    """
    model, data = compiled.model, compiled.data
    places, velocities = model.jnt_qposadr, model.jnt_dofadr
    balls = np.flatnonzero(model.jnt_type == mujoco.mjtJoint.mjJNT_BALL)
    stretch = data.qpos[places] - model.qpos_spring[places]
    forces = -model.jnt_stiffness * stretch - model.dof_damping[velocities] * data.qvel[velocities]
    # MuJoCo's balances of bodies know nothing of armatures
    forces -= model.dof_armature[velocities] * data.qacc[velocities]
    laws = len(compiled.scene.control)
    np.add.at(forces, model.actuator_trnid[:laws, 0], data.actuator_force[:laws])
    wrenches = np.zeros((model.nbody, 6))
    for ball in balls.tolist():
        turn = data.xmat[model.jnt_bodyid[ball]].reshape(3, 3)
        wrenches[model.jnt_bodyid[ball], 3:] += turn @ _ball_torque(model, data, ball)
    duals = np.array(data.xaxis)  # one alone of its kind is of length 1, and its own
    kinds = 4 * model.jnt_bodyid + model.jnt_type
    for kind in np.flatnonzero(np.bincount(kinds) > 1):
        together = np.flatnonzero(kinds == kind)
        duals[together] = dual_axes(data.xaxis[together])
    pushes = forces[:, None] * duals
    slides, hinges = (
        model.jnt_type == kind for kind in (mujoco.mjtJoint.mjJNT_SLIDE, mujoco.mjtJoint.mjJNT_HINGE)
    )
    np.add.at(wrenches[:, :3], model.jnt_bodyid[slides], pushes[slides])
    np.add.at(wrenches[:, 3:], model.jnt_bodyid[hinges], pushes[hinges])
    for kept in compiled.tree.joints:
        child = compiled.body_id[kept.child]
        if not np.any(push := wrenches[child, :3]):
            continue
        together = np.flatnonzero(hinges & (model.jnt_bodyid == child))
        if len(together) > 1:
            axes, arms = data.xaxis[together], compiled.joint_point(kept.joint) - data.xanchor[together]
            work = np.sum(np.cross(axes, arms) * push, axis=1)
            wrenches[child, 3:] -= work @ dual_axes(axes)
    return wrenches


def _ball_torque(model: mujoco.MjModel, data: mujoco.MjData, ball: int) -> Array:
    """(3,) N m on the child of a ball by its spring, damper and rotor, in the child's frame."""
    on_q = slice(model.jnt_qposadr[ball], model.jnt_qposadr[ball] + 4)
    on_v = slice(model.jnt_dofadr[ball], model.jnt_dofadr[ball] + 3)
    turned = np.empty(3)
    mujoco.mju_subQuat(turned, data.qpos[on_q], model.qpos_spring[on_q])
    torque = -model.jnt_stiffness[ball] * turned - model.dof_damping[on_v] * data.qvel[on_v]
    return np.asarray(torque - model.dof_armature[on_v] * data.qacc[on_v])


def motor_wrenches(compiled: CompiledScene) -> Array:
    """(nbody, 6) force, and torque about the center of mass, by motors on sites; world frame."""
    model, data = compiled.model, compiled.data
    wrenches = np.zeros((model.nbody, 6))
    for motor in range(len(compiled.scene.control), model.nu):
        site, reference = model.actuator_trnid[motor]
        frame = data.site_xmat[site if reference < 0 else reference].reshape(3, 3)
        force, torque = data.actuator_force[motor] * model.actuator_gear[motor].reshape(2, 3) @ frame.T
        body = model.site_bodyid[site]
        arm = data.site_xpos[site] - data.xipos[body]
        wrenches[body] += np.concatenate([force, torque + cross(arm, force)])
    return wrenches


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
        self.name: str = model.equality(index).name
        self.rows = np.flatnonzero(np.asarray(data.efc_id) == index)
        self.kind = mujoco.mjtEq(model.eq_type[index])
        if self.kind == mujoco.mjtEq.mjEQ_TENDON:
            first = model.tendon_adr[model.eq_obj1id[index]]
            sites = model.wrap_objid[first : first + 2]
            self.bodies = tuple(int(body) for body in model.site_bodyid[sites])
            self.points = tuple(data.site_xpos[sites])
            return
        self.bodies, self.points = ends(model, data, index)

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
