"""Compute joint reactions from MuJoCo's balances of forces on bodies."""

from __future__ import annotations

import mujoco
import numpy as np

from mjcf.loops import closes_loop, loops_with_rows
from mjcf.model import CompiledScene
from newton_euler.model.hinge_angles import dual_axes
from newton_euler.model.parallel_hinges import ParallelHinges, driving_wrench
from newton_euler.scalars import Array


class Reactions:
    """Reactions of a scene's joints at the state in MuJoCo's `data`, after `mj_rnePostConstraint`.

    A joint of the tree carries cfrc_int of its child minus the forces of its actuators, springs and rotors. A
    ball or rod that closes a loop carries its multipliers. Welds belong to no joint of the mechanism.
    """

    def __init__(self, compiled: CompiledScene) -> None:
        self._compiled, model, mechanism = compiled, compiled.model, compiled.welded.mechanism
        self._count, self._laws = len(compiled.mechanism.joints), len(compiled.scene.control)
        self._cuts = {
            index: mechanism.joint_index(model.equality(index).name)
            for index in range(model.neq)
            if closes_loop(model, index) and model.eq_type[index] != mujoco.mjtEq.mjEQ_WELD
        }
        # other tree joints belong to bodies that only rods hold
        kept = [kept for kept in compiled.tree.joints if kept.joint < len(mechanism.joints)]
        self._kept = np.array([each.joint for each in kept], dtype=int)
        self._signs = np.array([1.0 if each.forward else -1.0 for each in kept])[:, None]
        self._children = np.array([compiled.body_id[each.child] for each in kept], dtype=int)
        seconds = [mechanism.equations[joint].second for joint in self._kept]
        self._seconds = np.array([compiled.body_id[second] for second in seconds], dtype=int)
        # the origin of the world body differs from the ground's center of mass
        arms = [
            mechanism.reaction_arms[joint] if second else mechanism.joints[joint].reaction_point
            for joint, second in zip(self._kept, seconds, strict=True)
        ]
        self._arms = np.reshape(arms, (-1, 3, 1))
        of_type, bodies = model.jnt_type, model.jnt_bodyid
        self._balls = np.flatnonzero(of_type == mujoco.mjtJoint.mjJNT_BALL).tolist()
        self._slides = np.flatnonzero(of_type == mujoco.mjtJoint.mjJNT_SLIDE)
        self._hinges = np.flatnonzero(of_type == mujoco.mjtJoint.mjJNT_HINGE)
        kinds = 4 * bodies + of_type
        counts = np.bincount(kinds)
        self._in_row = [
            np.array([np.flatnonzero(kinds == kind) for kind in np.flatnonzero(counts == count)])
            for count in set(counts[counts > 1].tolist())
        ]
        self._beyond_slides: list[tuple[int, Array]] = []
        self._parallel: list[tuple[int, Array]] = []
        for number, child in enumerate(self._children):
            slides, hinges = (found[bodies[found] == child] for found in (self._slides, self._hinges))
            if mechanism.joints[self._kept[number]].kind == ParallelHinges.kind:
                self._parallel.append((number, hinges))
            elif len(slides) and len(hinges) > 1:
                self._beyond_slides.append((number, hinges))

    def now(self) -> tuple[Array, Array]:
        """Return forces (j, 3), N, and torques (j, 3), N m, on the second bodies at the joint points."""
        compiled, model, data = self._compiled, self._compiled.model, self._compiled.data
        forces, torques = np.zeros((2, len(compiled.welded.mechanism.joints), 3))
        for loop in loops_with_rows(model, data):
            if loop.index in self._cuts:
                forces[self._cuts[loop.index]] = loop.force_on_second()
        points = self._points()
        applied = self._drives(points)[self._children]
        on_child = data.cfrc_int[self._children]
        force, torque = on_child[:, 3:], on_child[:, :3]
        arms = data.subtree_com[model.body_rootid[self._children]] - points
        forces[self._kept] = self._signs * (force - applied[:, :3])
        torques[self._kept] = self._signs * (torque + np.cross(arms, force) - applied[:, 3:])
        return forces[: self._count], torques[: self._count]

    def _points(self) -> Array:
        """Return the joint points (k, 3) of the reactions of tree joints, m, world frame."""
        data = self._compiled.data
        turned = data.xmat[self._seconds].reshape(-1, 3, 3) @ self._arms
        return np.asarray(data.xpos[self._seconds] + turned[:, :, 0])

    def _drives(self, points: Array) -> Array:
        """Return forces and torques (nbody, 6) of actuators, springs and rotors of the joint above each body.

        The force on one of several hinges or slides does no work on the others. The force on a slide has no
        torque about the joint point, where all hinges meet.
        """
        model, data = self._compiled.model, self._compiled.data
        places, velocities = model.jnt_qposadr, model.jnt_dofadr
        # generalized force of each hinge and slide
        stretch = data.qpos[places] - model.qpos_spring[places]
        forces = -model.jnt_stiffness * stretch - model.dof_damping[velocities] * data.qvel[velocities]
        # MuJoCo's balances of bodies do not include armatures
        forces -= model.dof_armature[velocities] * data.qacc[velocities]
        laws = self._laws
        np.add.at(forces, model.actuator_trnid[:laws, 0], data.actuator_force[:laws])
        # wrenches of balls, then of slides and hinges along the dual axes of their row
        wrenches = np.zeros((model.nbody, 6))
        for ball in self._balls:
            turn = data.xmat[model.jnt_bodyid[ball]].reshape(3, 3)
            wrenches[model.jnt_bodyid[ball], 3:] += turn @ self._ball_torque(ball)
        duals = np.array(data.xaxis)  # a single hinge or slide is its own dual
        for row in self._in_row:
            duals[row] = dual_axes(duals[row])
        pushes = forces[:, None] * duals
        np.add.at(wrenches[:, :3], model.jnt_bodyid[self._slides], pushes[self._slides])
        np.add.at(wrenches[:, 3:], model.jnt_bodyid[self._hinges], pushes[self._hinges])
        # hinges of a joint with slides: cancel the work of the slides' forces on the hinges
        for number, hinges in self._beyond_slides:
            axes, arms, child = (
                data.xaxis[hinges],
                points[number] - data.xanchor[hinges],
                self._children[number],
            )
            work = np.sum(np.cross(axes, arms) * wrenches[child, :3], axis=1)
            wrenches[child, 3:] -= work @ dual_axes(axes)
        for number, hinges in self._parallel:
            axes, arms = data.xaxis[hinges], points[number] - data.xanchor[hinges]
            wrench = driving_wrench(axes, np.cross(axes, arms), forces[hinges])
            wrenches[self._children[number]] = np.concatenate(wrench)
        return wrenches

    def _ball_torque(self, ball: int) -> Array:
        """Return the torque (3,), N m, of a ball's spring, damper and rotor on the child, child frame."""
        model, data = self._compiled.model, self._compiled.data
        on_q = slice(model.jnt_qposadr[ball], model.jnt_qposadr[ball] + 4)
        on_v = slice(model.jnt_dofadr[ball], model.jnt_dofadr[ball] + 3)
        turned = np.empty(3)
        mujoco.mju_subQuat(turned, data.qpos[on_q], model.qpos_spring[on_q])
        torque = -model.jnt_stiffness[ball] * turned - model.dof_damping[on_v] * data.qvel[on_v]
        return np.asarray(torque - model.dof_armature[on_v] * data.qacc[on_v])
