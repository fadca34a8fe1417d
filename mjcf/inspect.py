"""Contents of a compiled model, for comparisons: joints, terms of the equations of motion, closures."""

from __future__ import annotations

import mujoco

from mjcf.loops import all_loops
from mjcf.rigid import RigidMuJoCo
from newton_euler.model.joint_geometry import JointGeometry, closing, in_tree
from newton_euler.scalars import Array


def joint_geometry(system: RigidMuJoCo) -> dict[str, JointGeometry]:
    """The joints of a compiled model at its initial pose."""
    model, data = system.model, system.data
    data.qpos[:] = model.qpos0
    mujoco.mj_fwdPosition(model, data)
    kinds = {
        int(mujoco.mjtJoint.mjJNT_HINGE): "hinge",
        int(mujoco.mjtJoint.mjJNT_SLIDE): "slide",
        int(mujoco.mjtJoint.mjJNT_BALL): "ball",
    }

    def read(name: str) -> tuple[str, Array, Array]:
        index = model.joint(name).id
        return kinds[int(model.jnt_type[index])], data.xaxis[index].copy(), data.xanchor[index].copy()

    found = in_tree(system.welded, read)
    for loop in all_loops(model, data):
        if loop.kind != mujoco.mjtEq.mjEQ_WELD:
            kind = "rod" if loop.kind == mujoco.mjtEq.mjEQ_TENDON else "ball"
            found[loop.name] = closing(kind, (loop.points[0].copy(), loop.points[1].copy()))
    return found


def mass_and_force(system: RigidMuJoCo, q: Array, v: Array) -> tuple[Array, Array]:
    """M (nv, nv) and f (nv,) of M vdot = f + J^T lambda in tree velocities, by MuJoCo."""
    system.state(q, v)
    return system.mass_and_force()


def move_anchor(system: RigidMuJoCo, joint: str, shift: Array) -> None:
    """Move the point of a closure on its second body, in a compiled model, by `shift` (3,), m, world."""
    model, data = system.model, system.data
    data.qpos[:] = model.qpos0
    mujoco.mj_kinematics(model, data)
    loop = model.equality(_closure(system, joint)).id
    welds = model.eq_type[loop] == mujoco.mjtEq.mjEQ_WELD
    turn = data.xmat[model.eq_obj2id[loop]].reshape(3, 3)
    anchor = slice(0, 3) if welds else slice(3, 6)
    model.eq_data[loop, anchor] += turn.T @ shift


def _closure(system: RigidMuJoCo, joint: str) -> str:
    """Name of the equality of a joint that a loop is cut at: its own, or that of the weld of its halves."""
    mechanism, welded = system.mechanism, system.welded.mechanism
    cut = welded.joints[mechanism.joint_index(joint)]
    for weld in welded.joints[len(mechanism.joints) :]:
        if weld.second in (cut.first, cut.second):
            return weld.name
    return joint
