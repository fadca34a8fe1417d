"""Robot descriptions of compiled MuJoCo models, and MuJoCo's coordinates of their states."""

from __future__ import annotations

import mujoco
import numpy as np

from newton_euler.reading.robot import (
    FileBody,
    FileCoupling,
    FileDrive,
    FileJoint,
    FileLoop,
    JointKind,
    LoopKind,
    Placement,
    Robot,
)
from newton_euler.scalars import Array

KINDS = (JointKind.FREE, JointKind.BALL, JointKind.SLIDE, JointKind.HINGE)
"""Joint kinds in the order of MuJoCo's numbers."""


def robot_of(model: mujoco.MjModel) -> Robot:
    """Describe a compiled model with connects, joint couplings, and actuators of single joints."""
    connects = [k for k in range(model.neq) if model.eq_type[k] == mujoco.mjtEq.mjEQ_CONNECT]
    couplings = [k for k in range(model.neq) if model.eq_type[k] == mujoco.mjtEq.mjEQ_JOINT]
    return Robot(
        "model",
        tuple(_body(model, index) for index in range(1, model.nbody)),
        loops=tuple(_connect(model, k) for k in connects),
        couplings=tuple(
            FileCoupling(
                model.eq(k).name,
                model.joint(model.eq_obj1id[k]).name,
                model.joint(model.eq_obj2id[k]).name if model.eq_obj2id[k] >= 0 else "",
                tuple(model.eq_data[k, :5]),
            )
            for k in couplings
        ),
        drives=tuple(
            FileDrive(
                model.actuator(k).name,
                {model.joint(model.actuator_trnid[k, 0]).name: float(model.actuator_gear[k, 0])},
                gain=float(model.actuator_gainprm[k, 0]),
                constant=float(model.actuator_biasprm[k, 0]),
                stiffness=float(model.actuator_biasprm[k, 1]),
                damping=float(model.actuator_biasprm[k, 2]),
            )
            for k in range(model.nu)
        ),
        gravity=model.opt.gravity.copy(),
    )


def _matrix(quaternion: Array) -> Array:
    matrix = np.zeros(9)
    mujoco.mju_quat2Mat(matrix, quaternion)
    return matrix.reshape(3, 3)


def _body(model: mujoco.MjModel, index: int) -> FileBody:
    axes = _matrix(model.body_iquat[index])
    first, count = model.body_jntadr[index], model.body_jntnum[index]
    return FileBody(
        model.body(index).name,
        int(model.body_parentid[index]) - 1,
        Placement(model.body_pos[index].copy(), _matrix(model.body_quat[index])),
        tuple(_joint(model, k) for k in range(first, first + count)),
        float(model.body_mass[index]),
        model.body_ipos[index].copy(),
        axes @ np.diag(model.body_inertia[index]) @ axes.T,
    )


def _joint(model: mujoco.MjModel, k: int) -> FileJoint:
    kind = KINDS[model.jnt_type[k]]
    scalar = kind in (JointKind.HINGE, JointKind.SLIDE)
    at, dof = model.jnt_qposadr[k], model.jnt_dofadr[k]
    return FileJoint(
        model.joint(k).name,
        kind,
        model.jnt_axis[k].copy() if scalar else np.zeros(3),
        model.jnt_pos[k].copy(),
        zero=float(model.qpos0[at]) if scalar else 0.0,
        damping=float(model.dof_damping[dof, 0] if model.dof_damping.ndim > 1 else model.dof_damping[dof]),
        armature=float(model.dof_armature[dof]),
        stiffness=float(
            model.jnt_stiffness[k, 0] if model.jnt_stiffness.ndim > 1 else model.jnt_stiffness[k]
        ),
        rest=float(model.qpos_spring[at]) if scalar else 0.0,
        limits=tuple(model.jnt_range[k]) if model.jnt_limited[k] else (-np.inf, np.inf),
    )


def _connect(model: mujoco.MjModel, k: int) -> FileLoop:
    ends = (int(model.eq_obj1id[k]), int(model.eq_obj2id[k]))
    if model.eq_objtype[k] == mujoco.mjtObj.mjOBJ_SITE:
        bodies = [int(model.site_bodyid[end]) for end in ends]
        points = [model.site_pos[end].copy() for end in ends]
    else:
        bodies, points = list(ends), [model.eq_data[k, :3].copy(), model.eq_data[k, 3:6].copy()]
    first, second = (Placement(point, np.eye(3)) for point in points)
    return FileLoop(model.eq(k).name, LoopKind.POINT, bodies[0] - 1, bodies[1] - 1, first, second)


def to_mujoco(
    model: mujoco.MjModel, robot: Robot, coordinates: Array, velocities: Array
) -> tuple[Array, Array]:
    """Return qpos and qvel of coordinates and velocities in the order of `differences.dynamics`."""
    qpos, qvel = model.qpos0.copy(), np.zeros(model.nv)
    start, joint = 0, 0
    for body in robot.bodies:
        for described in body.joints:
            at, dof = model.jnt_qposadr[joint], model.jnt_dofadr[joint]
            joint += 1
            if described.kind in (JointKind.HINGE, JointKind.SLIDE):
                qpos[at], qvel[dof] = coordinates[start], velocities[start]
                start += 1
                continue
            if described.kind is JointKind.FREE:
                place = body.placement.position + body.placement.rotation @ coordinates[start : start + 3]
                qpos[at : at + 3] = place
                at, start = at + 3, start + 3
            quaternion, turn = np.zeros(4), coordinates[start : start + 3]
            mujoco.mju_axisAngle2Quat(quaternion, turn / (np.linalg.norm(turn) or 1.0), np.linalg.norm(turn))
            if described.kind is JointKind.FREE:
                mujoco.mju_mulQuat(
                    quaternion, model.body_quat[1 + robot.bodies.index(body)], quaternion.copy()
                )
                qvel[dof : dof + 3] = _matrix(quaternion) @ velocities[start - 3 : start]
                dof += 3
            qpos[at : at + 4], qvel[dof : dof + 3] = quaternion, velocities[start : start + 3]
            start += 3
    return qpos, qvel
