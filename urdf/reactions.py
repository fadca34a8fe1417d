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
from newton_euler.model.scene import Scene
from newton_euler.model.spanning_tree import WeldedMechanism, motion_names
from newton_euler.scalars import Array


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
        drives: numbers of joints, and wrenches of their drives, which are subtracted, see
            `newton_euler.equations.drives`.
    """
    forces = wrenches[: len(points), :3].copy()
    torques = wrenches[: len(points), 3:] - np.cross(points, forces)
    for joint, wrench in drives:
        forces[joint] -= wrench[:3]
        torques[joint] -= wrench[3:]
    return forces, torques
