"""Compute joint reactions from Pinocchio's inverse dynamics (`rnea`).

`rnea` returns the wrench that each joint of the spanning tree transmits. The reaction of a joint is this
wrench minus the joint's drives: the forces of actuators, springs, dampers and rotors on the joint's hinges
and slides. Wrenches are (6,): force, N, and torque, N m, about the world's origin unless stated otherwise,
world frame.

Pinocchio closes loops only with ball joints, rods (two points at a fixed distance) and welds. The *welded
mechanism* of a scene closes its loops with these alone: if a loop would close at another joint, a body is cut
into two halves, and a weld holds them together.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
import pinocchio as pin

from newton_euler.model.constraints import Frame
from newton_euler.model.hinge_angles import dual_axes
from newton_euler.model.mechanism import Mechanism
from newton_euler.model.parallel_hinges import ParallelHinges, driving_wrench
from newton_euler.model.scene import Scene
from newton_euler.model.spanning_tree import SpanningTree, WeldedMechanism, motion_names
from newton_euler.scalars import Array


def drive_wrenches(
    tree: SpanningTree, columns: Array, points: Array, forces: Array
) -> list[tuple[int, Array]]:
    """Return the number of each driven joint with the wrench (6,) of its drives on the second body.

    The wrench is about the joint point. By newton_euler's definition of reactions, the drive of one of
    several hinges or slides of a joint does no work on the others: its torque or force is along a dual axis
    d_k, with d_k . a_m = 0 for the axes a_m of the others and d_k . a_k = 1.

    Args:
        tree: spanning tree that numbers the velocities.
        columns: (6, nv) Pinocchio's joint Jacobian in the order of the tree: for each joint velocity, the
            velocity of the child's material point at the world's origin, and the angular velocity.
        points: (j, 3) joint points, m, world frame.
        forces: (nv,) forces on hinges and slides, N or N m.
    """
    wrenches = []
    for tree_joint in tree.joints:
        if not np.any(forces[tree_joint.v]):
            continue
        point = points[tree_joint.joint]
        slides = [in_v.start for motion, _, in_v in tree_joint.places if motion.kind == "slide"]
        hinges = [in_v.start for motion, _, in_v in tree_joint.places if motion.kind == "hinge"]
        axes = columns[3:, hinges].T
        if len(tree_joint.motions) == 1 and tree_joint.motions[0].kind != "ball":
            # a single hinge or slide
            wrench = np.zeros(6)
            part = slice(0, 3) if slides else slice(3, 6)
            wrench[part] = forces[tree_joint.v.start] * columns[part, tree_joint.v.start]
        elif tree.joint(tree_joint.joint).kind == ParallelHinges.kind:
            # two hinges with parallel axes at the ends of a link
            velocities_at_point = columns[:3, hinges].T + np.cross(axes, point)
            wrench = np.concatenate(driving_wrench(axes, velocities_at_point, forces[hinges]))
        else:
            # several motions: slides, then hinges
            duals = dual_axes(axes)
            wrench = np.concatenate([np.zeros(3), forces[hinges] @ duals])
            if slides:
                wrench[:3] = forces[slides] @ dual_axes(columns[:3, slides].T)
                # cancel the work of the slides' forces on the hinges
                velocities_at_point = columns[:3, hinges].T + np.cross(axes, point)
                wrench[3:] -= (velocities_at_point @ wrench[:3]) @ duals
        # `forward`: the child in the tree is the second body of the joint
        wrenches.append((tree_joint.joint, wrench if tree_joint.forward else -wrench))
    return wrenches


def joint_points(mechanism: Mechanism, frames: Sequence[Frame]) -> Array:
    """Return the points (j, 3) of joints on their second bodies, m, world frame.

    `frames` are the poses and velocities of the bodies.
    """
    points = np.zeros((len(mechanism.joints), 3))
    for index, equations in enumerate(mechanism.equations):
        body = frames[equations.second]
        points[index] = body.position + body.rotation @ mechanism.reaction_arms[index]
    return points


def external_forces(model: Any, data: Any, wrenches: Iterable[tuple[int, Any]]) -> Any:
    """Sum the external forces of `rnea`: a `pinocchio.Force` for each joint, in the frame of the joint.

    Args:
        model: `pinocchio.Model`.
        data: `pinocchio.Data` with joint placements.
        wrenches: number of a frame, and `pinocchio.Force` about the world's origin on the body of the frame.
    """
    external = pin.StdVec_Force([pin.Force.Zero() for _ in range(model.njoints)])
    for frame, wrench in wrenches:
        joint = model.frames[frame].parentJoint
        external[joint] += data.oMi[joint].actInv(wrench)
    return external


def joint_wrenches(
    scene: Scene,
    welded: WeldedMechanism,
    model: Any,
    data: Any,
    closure_wrenches: list[Array],
    applied: list[Array],
    frames: Sequence[Frame],
    accelerations: Array,
) -> Array:
    """Compute the wrench of each joint of the welded mechanism on its second body, drives included.

    Args:
        scene: scene with the gravity.
        welded: welded mechanism of the scene, with its spanning tree.
        model: Pinocchio's model.
        data: Pinocchio's data after `rnea` with the wrenches below.
        closure_wrenches: (6,) wrench of each loop closure on its second body.
        applied: (6,) sum of the forces of ball springs (on ball joints), point springs (between points of two
            bodies), wrenches and wind on each body of the welded mechanism.
        frames: poses and velocities of the scene's bodies.
        accelerations: (b, 6) linear and angular accelerations of the scene's bodies.

    Returns:
        (j, 6) wrenches of the j joints of the welded mechanism.
    """
    joints, tree = welded.mechanism.joints, welded.tree
    wrenches = np.zeros((len(joints), 6))
    for cut, wrench in zip(tree.cuts, closure_wrenches, strict=True):
        wrenches[cut] = wrench
    # tree joints from the leaves to the root
    for tree_joint in reversed(tree.joints):
        if tree_joint.joint >= len(joints):
            continue  # a free joint that the tree adds for a body that only rods connect to others
        if tree_joint.motions:
            # the last of Pinocchio's joints for the motions of this joint; it carries the child
            last = model.getJointId(motion_names(tree.joint(tree_joint.joint), tree_joint.forward)[-1])
            on_child = data.oMi[last].act(data.f[last]).vector
        else:
            # Pinocchio merges links of a fixed joint: use the balance of forces of the child. The wrenches
            # of the child's other joints are known: they close loops, or are nearer to the leaves.
            child = welded.mechanism.bodies[tree_joint.child].name
            on_child = _nongravity_wrench(scene, welded, tree_joint.child, frames, accelerations)
            on_child -= applied[tree_joint.child]
            for index, joint in enumerate(joints):
                if index != tree_joint.joint and child in (joint.first, joint.second):
                    on_child -= wrenches[index] if joint.second == child else -wrenches[index]
        wrenches[tree_joint.joint] = on_child if tree_joint.forward else -on_child
    return wrenches


def _nongravity_wrench(
    scene: Scene, welded: WeldedMechanism, index: int, frames: Sequence[Frame], accelerations: Array
) -> Array:
    """Compute the sum (6,) of all wrenches on body `index` except its weight, by the Newton-Euler equations.

    A half of a cut body moves with the body of the scene that it was cut from. For the arguments see
    `joint_wrenches`.
    """
    body, scene_body = welded.mechanism.bodies[index], welded.origin[index]
    position, rotation, _, omega = frames[scene_body]
    inertia = rotation @ body.inertia @ rotation.T
    force = body.mass * (accelerations[scene_body, :3] - scene.gravity)
    torque = inertia @ accelerations[scene_body, 3:] + np.cross(omega, inertia @ omega)
    return np.concatenate([force, torque + np.cross(position, force)])


def reactions(wrenches: Array, points: Array, drives: list[tuple[int, Array]]) -> tuple[Array, Array]:
    """Return forces (j, 3), N, and torques (j, 3), N m, on the second bodies at the joint points.

    Args:
        wrenches: wrench (6,) of each joint of the scene, then of added welds, see `joint_wrenches`.
        points: (j, 3) points of the scene's joints, m, world frame.
        drives: numbers of joints, and wrenches of their drives, which are subtracted, see `drive_wrenches`.
    """
    forces = wrenches[: len(points), :3].copy()
    torques = wrenches[: len(points), 3:] - np.cross(points, forces)
    for joint, wrench in drives:
        forces[joint] -= wrench[:3]
        torques[joint] -= wrench[3:]
    return forces, torques
