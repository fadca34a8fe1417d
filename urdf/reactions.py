"""Compute joint reactions from Pinocchio's inverse dynamics.

Wrenches are (6,): force and torque about the world's origin, N and N m, world frame.
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


def driven(tree: SpanningTree, columns: Array, points: Array, forces: Array) -> list[tuple[int, Array]]:
    """Return joints with the wrenches (6,) of their drives on the second bodies, about the joint points.

    The force on one of several hinges or slides of a joint does no work on the others.

    Args:
        tree: spanning tree that numbers the velocities.
        columns: (6, nv) Pinocchio's joint Jacobians in the order of the tree.
        points: (j, 3) joint points, m, world frame.
        forces: (nv,) forces on hinges and slides, N or N m.
    """
    found = []
    for kept in tree.joints:
        if not np.any(forces[kept.v]):
            continue
        # joints of one motion
        if len(kept.motions) == 1 and kept.motions[0].kind != "ball":
            wrench = np.zeros(6)
            part = slice(0, 3) if kept.motions[0].kind == "slide" else slice(3, 6)
            wrench[part] = forces[kept.v.start] * columns[part, kept.v.start]
            found.append((kept.joint, wrench if kept.forward else -wrench))
            continue
        slides, hinges = (
            [on_v.start for motion, _, on_v in kept.places if motion.kind == kind]
            for kind in ("slide", "hinge")
        )
        angular = columns[3:, hinges].T
        if tree.joint(kept.joint).kind == ParallelHinges.kind:
            rates = columns[:3, hinges].T + np.cross(angular, points[kept.joint])
            wrench = np.concatenate(driving_wrench(angular, rates, forces[hinges]))
            found.append((kept.joint, wrench if kept.forward else -wrench))
            continue
        # hinges in a row, after slides in a row: forces along dual axes
        duals = dual_axes(angular)
        wrench = np.concatenate([np.zeros(3), forces[hinges] @ duals])
        if slides:
            wrench[:3] = forces[slides] @ dual_axes(columns[:3, slides].T)
            at_origin = columns[:3, hinges].T
            wrench[3:] -= ((at_origin + np.cross(angular, points[kept.joint])) @ wrench[:3]) @ duals
        found.append((kept.joint, wrench if kept.forward else -wrench))
    return found


def joint_points(mechanism: Mechanism, frames: Sequence[Frame]) -> Array:
    """Return the joint points (j, 3) on the second bodies, m, world frame."""
    points = np.zeros((len(mechanism.joints), 3))
    for index, equations in enumerate(mechanism.equations):
        body = frames[equations.second]
        points[index] = body.position + body.rotation @ mechanism.reaction_arms[index]
    return points


def external_forces(model: Any, data: Any, wrenches: Iterable[tuple[int, Any]]) -> Any:
    """Collect external forces for `rnea`: on Pinocchio's joints, in their frames.

    Args:
        model, data: Pinocchio's, with joint placements.
        wrenches: frames, and what acts on what they are fixed to, about the world's origin.
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
    """Compute the wrench of each joint of the welded mechanism on its second body, forces included.

    Args:
        scene: scene with the gravity.
        welded: mechanism of the scene with cut loops.
        model: Pinocchio's model.
        data: Pinocchio's data after `rnea` with the wrenches below.
        closure_wrenches: (6,) for each loop closure, on its second body.
        applied: (6,) for each body of the welded mechanism, of ball springs, point springs and wrenches.
        frames: frames of the bodies.
        accelerations: (b, 6) linear and angular accelerations of the bodies.

    Returns:
        (joints, 6) wrenches.
    """
    joints, tree = welded.mechanism.joints, welded.tree
    wrenches = np.zeros((len(joints), 6))
    for cut, wrench in zip(tree.cuts, closure_wrenches, strict=True):
        wrenches[cut] = wrench
    # tree joints from the leaves to the root
    for kept in reversed(tree.joints):
        if kept.joint >= len(joints):
            continue  # joints of bodies that only rods hold
        if kept.motions:
            last = model.getJointId(motion_names(tree.joint(kept.joint), kept.forward)[-1])
            on_child = data.oMi[last].act(data.f[last]).vector
        else:
            # Pinocchio merges links of a fixed joint: use the balance of the child
            child = welded.mechanism.bodies[kept.child].name
            on_child = _needed_wrench(scene, welded, kept.child, frames, accelerations)
            on_child -= applied[kept.child]
            for index, joint in enumerate(joints):
                if index != kept.joint and child in (joint.first, joint.second):
                    on_child -= wrenches[index] if joint.second == child else -wrenches[index]
        wrenches[kept.joint] = on_child if kept.forward else -on_child
    return wrenches


def _needed_wrench(
    scene: Scene, welded: WeldedMechanism, index: int, frames: Sequence[Frame], accelerations: Array
) -> Array:
    """Compute the total wrench of all joints on a body by Newton's and Euler's equations."""
    body, whole = welded.mechanism.bodies[index], welded.origin[index]
    position, a, _, omega = frames[whole]
    inertia = a @ body.inertia @ a.T
    force = body.mass * (accelerations[whole, :3] - scene.gravity)
    torque = inertia @ accelerations[whole, 3:] + np.cross(omega, inertia @ omega)
    return np.concatenate([force, torque + np.cross(position, force)])


def reactions(wrenches: Array, points: Array, actuation: list[tuple[int, Array]]) -> tuple[Array, Array]:
    """Return forces and torques (j, 3) on the second bodies at the joint points, without drives.

    Args:
        wrenches: (j, 6) or more rows, see `joint_wrenches`.
        points: (j, 3) joint points, m, world frame.
        actuation: wrenches of drives, see `driven`.
    """
    forces = wrenches[: len(points), :3].copy()
    torques = wrenches[: len(points), 3:] - np.cross(points, forces)
    for joint, wrench in actuation:
        forces[joint] -= wrench[:3]
        torques[joint] -= wrench[3:]
    return forces, torques
