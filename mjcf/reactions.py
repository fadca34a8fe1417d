"""Compute joint reactions from the forces that MuJoCo transmits between bodies.

`mj_rnePostConstraint` computes `cfrc_int`, the force and torque that each body receives from its parent. The
reaction of a joint is this wrench minus the joint's drives: the forces of actuators, springs, dampers and
rotors on the joint's hinges, slides and ball. Wrenches in this module are (6,): force, then torque; only
MuJoCo's `cfrc_int` has the torque first.
"""

from __future__ import annotations

import mujoco
import numpy as np

from mjcf.loops import closes_loop, loops_with_rows
from mjcf.model import MujocoScene
from newton_euler.model.hinge_angles import dual_axes
from newton_euler.model.parallel_hinges import ParallelHinges, driving_wrench
from newton_euler.scalars import Array


class Reactions:
    """Reactions of a scene's joints at the state in MuJoCo's `data`, after `mj_rnePostConstraint`.

    The reaction of a joint in the tree of bodies is `cfrc_int` of the joint's child minus the joint's drives.
    The reaction of a ball or rod (a link of constant length) that closes a loop follows from the multipliers
    of its equality. At other joints that close a loop, a body is cut into halves, which a weld joins. The
    welded mechanism has the joints of the scene's mechanism, and then these welds.
    """

    def __init__(self, compiled: MujocoScene) -> None:
        """Prepare the numbers of bodies and joints of a compiled scene."""
        self._compiled, model, mechanism = compiled, compiled.model, compiled.welded.mechanism
        self._joint_count, self._law_count = len(compiled.mechanism.joints), len(compiled.scene.control)
        # joint of the mechanism for each equality that closes a loop by a ball or rod
        self._joint_of_equality = {
            index: mechanism.joint_index(model.equality(index).name)
            for index in range(model.neq)
            if closes_loop(model, index) and model.eq_type[index] != mujoco.mjtEq.mjEQ_WELD
        }
        # tree joints of the mechanism; the tree has additional free joints for bodies that only rods hold
        tree_joints = [each for each in compiled.tree.joints if each.joint < len(mechanism.joints)]
        self._tree_joints = np.array([each.joint for each in tree_joints], dtype=int)
        # reactions act on the second body: -1 if the child in the tree is the first body of the joint
        self._signs = np.array([1.0 if each.forward else -1.0 for each in tree_joints])[:, None]
        self._children = np.array([compiled.body_id[each.child] for each in tree_joints], dtype=int)
        second_bodies = [mechanism.equations[joint].second for joint in self._tree_joints]
        self._second_ids = np.array([compiled.body_id[body] for body in second_bodies], dtype=int)
        # joint points from the centers of mass of the second bodies, in body frames; MuJoCo's world body has
        # its origin at 0, not at the ground's center of mass
        arms = [
            mechanism.reaction_arms[joint] if body else mechanism.joints[joint].point_on_second
            for joint, body in zip(self._tree_joints, second_bodies, strict=True)
        ]
        self._arms = np.reshape(arms, (-1, 3, 1))
        # MuJoCo's joints by type
        types, bodies = model.jnt_type, model.jnt_bodyid
        self._balls = np.flatnonzero(types == mujoco.mjtJoint.mjJNT_BALL).tolist()
        self._slides = np.flatnonzero(types == mujoco.mjtJoint.mjJNT_SLIDE)
        self._hinges = np.flatnonzero(types == mujoco.mjtJoint.mjJNT_HINGE)
        # groups of several hinges, or several slides, of one body: for each size of a group an array
        # (groups, size) of MuJoCo's joints
        body_and_type = 4 * bodies + types  # MuJoCo has four types of joints
        counts = np.bincount(body_and_type)
        self._groups_by_size = [
            np.array([np.flatnonzero(body_and_type == value) for value in np.flatnonzero(counts == count)])
            for count in set(counts[counts > 1].tolist())
        ]
        # tree joints (index in `_tree_joints`, hinges of MuJoCo) that need special treatment
        self._hinges_after_slides: list[tuple[int, Array]] = []
        self._parallel_hinges: list[tuple[int, Array]] = []
        for number, child in enumerate(self._children):
            slides = self._slides[bodies[self._slides] == child]
            hinges = self._hinges[bodies[self._hinges] == child]
            # a joint of two hinges with parallel axes at the ends of a link
            if mechanism.joints[self._tree_joints[number]].kind == ParallelHinges.kind:
                self._parallel_hinges.append((number, hinges))
            elif len(slides) and len(hinges) > 1:
                self._hinges_after_slides.append((number, hinges))

    def evaluate(self) -> tuple[Array, Array]:
        """Return forces (j, 3), N, and torques (j, 3), N m, on the second bodies at the joint points.

        Vectors are in the world frame, in the order of the joints of the scene's mechanism.
        """
        compiled, model, data = self._compiled, self._compiled.model, self._compiled.data
        forces, torques = np.zeros((2, len(compiled.welded.mechanism.joints), 3))
        # joints that close loops
        for loop in loops_with_rows(model, data):
            if loop.index in self._joint_of_equality:
                forces[self._joint_of_equality[loop.index]] = loop.force_on_second()
        # tree joints: cfrc_int (torque, then force) is about the center of mass of the whole kinematic tree,
        # the subtree of its root body
        points = self._joint_points()
        drives = self._drive_wrenches(points)[self._children]
        transmitted = data.cfrc_int[self._children]
        force, torque = transmitted[:, 3:], transmitted[:, :3]
        arms = data.subtree_com[model.body_rootid[self._children]] - points
        forces[self._tree_joints] = self._signs * (force - drives[:, :3])
        torques[self._tree_joints] = self._signs * (torque + np.cross(arms, force) - drives[:, 3:])
        # without the welds
        return forces[: self._joint_count], torques[: self._joint_count]

    def _joint_points(self) -> Array:
        """Return the points (k, 3) of tree joints at which reactions are computed, m, world frame."""
        data = self._compiled.data
        arms = data.xmat[self._second_ids].reshape(-1, 3, 3) @ self._arms
        return np.asarray(data.xpos[self._second_ids] + arms[:, :, 0])

    def _drive_wrenches(self, points: Array) -> Array:
        """Return the wrench (nbody, 6) of all forces along a joint's motions on the child of each joint.

        These are the forces of actuators, springs, dampers, rotors, dry friction and stops.

        Wrenches are about the joint point, in the world frame. By newton_euler's definition of reactions, the
        drive of one of several hinges or slides does no work on the others: its torque or force is along a
        dual axis d_k, with d_k . a_m = 0 for the axes a_m of the others and d_k . a_k = 1. The force on a
        slide acts at the joint point; a torque cancels its work on hinges whose axes miss this point.

        Args:
            points: (k, 3) points of the tree joints, m, world frame.
        """
        model, data = self._compiled.model, self._compiled.data
        q_index, v_index = model.jnt_qposadr, model.jnt_dofadr
        # generalized force of each hinge and slide, N or N m; entries of balls are not used
        stretch = data.qpos[q_index] - model.qpos_spring[q_index]
        forces = -model.jnt_stiffness * stretch - model.dof_damping[v_index] * data.qvel[v_index]
        # inertia forces of the rotors (armatures)
        forces -= model.dof_armature[v_index] * data.qacc[v_index]
        forces += data.qfrc_applied[v_index]  # dry friction and stops
        # actuators of control laws come first; later ones apply external wrenches and wind, no drives
        count = self._law_count
        np.add.at(forces, model.actuator_trnid[:count, 0], data.actuator_force[:count])
        # balls
        wrenches = np.zeros((model.nbody, 6))
        for ball in self._balls:
            to_world = data.xmat[model.jnt_bodyid[ball]].reshape(3, 3)
            wrenches[model.jnt_bodyid[ball], 3:] += to_world @ self._ball_torque(ball)
        # slides and hinges along their dual axes; a single hinge or slide is its own dual
        duals = np.array(data.xaxis)
        for group in self._groups_by_size:
            duals[group] = dual_axes(duals[group])
        along_duals = forces[:, None] * duals
        np.add.at(wrenches[:, :3], model.jnt_bodyid[self._slides], along_duals[self._slides])
        np.add.at(wrenches[:, 3:], model.jnt_bodyid[self._hinges], along_duals[self._hinges])
        # hinges of a joint with slides: cancel the work of the slides' forces on the hinges
        for number, hinges in self._hinges_after_slides:
            axes, arms = data.xaxis[hinges], points[number] - data.xanchor[hinges]
            child = self._children[number]
            work = np.sum(np.cross(axes, arms) * wrenches[child, :3], axis=1)
            wrenches[child, 3:] -= work @ dual_axes(axes)
        # two parallel hinges of one joint: their torques are replaced by a force and a torque of equal power
        for number, hinges in self._parallel_hinges:
            axes, arms = data.xaxis[hinges], points[number] - data.xanchor[hinges]
            wrench = driving_wrench(axes, np.cross(axes, arms), forces[hinges])
            wrenches[self._children[number]] = np.concatenate(wrench)
        return wrenches

    def _ball_torque(self, ball: int) -> Array:
        """Return the torque (3,), N m, of a ball's spring, damper and rotor on the child, child frame."""
        model, data = self._compiled.model, self._compiled.data
        in_q = slice(model.jnt_qposadr[ball], model.jnt_qposadr[ball] + 4)
        in_v = slice(model.jnt_dofadr[ball], model.jnt_dofadr[ball] + 3)
        deflection = np.empty(3)  # rotation vector from the rest, rad
        mujoco.mju_subQuat(deflection, data.qpos[in_q], model.qpos_spring[in_q])
        torque = -model.jnt_stiffness[ball] * deflection - model.dof_damping[in_v] * data.qvel[in_v]
        return np.asarray(torque - model.dof_armature[in_v] * data.qacc[in_v])
