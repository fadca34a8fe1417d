"""Wrenches of drives on joints, which reactions do not include, for equations of motion of other engines.

A drive is a force along a coordinate of a joint: of an actuator, a spring, a damper or a rotor. Engines
compute the wrench that each joint of a spanning tree transmits; the reaction of the joint is this wrench
minus that of its drives. Wrenches are (6,): force, N, and torque, N m, world frame.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from newton_euler.model.constraints import Frame
from newton_euler.model.hinge_angles import dual_axes
from newton_euler.model.mechanism import Mechanism
from newton_euler.model.parallel_hinges import ParallelHinges, driving_wrench
from newton_euler.model.spanning_tree import SpanningTree
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
        columns: (6, nv) joint Jacobian in the order of the tree: for each joint velocity, the
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
