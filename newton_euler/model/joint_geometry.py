"""Geometry of the joints in an engine's model at the initial pose: motion kinds, axes and points.

The first checks of a comparison of engines use this geometry: each engine reads the joints back from its own
compiled model, and the results must equal those of the `Mechanism` from which the model was built. In MuJoCo
and Pinocchio the joints form a spanning tree. A joint of the tree is a sequence of elementary motions, each
with a kind, an axis and one point. Loops of the mechanism are closed by ball joints and rods outside of the
tree, with one point on each body. If a loop is closed by splitting a body into two halves
(`newton_euler.model.spanning_tree.weld_loops`), the weld between the halves is not listed as a joint.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from newton_euler.model.mechanism import Mechanism
from newton_euler.model.spanning_tree import TreeJoint, WeldedMechanism
from newton_euler.scalars import Array


class JointGeometry(NamedTuple):
    """A joint at the initial pose, world frame.

    A joint is a sequence of elementary motions (hinges, slides, balls) from its first body to its second
    body.
    """

    kinds: tuple[str, ...]
    """Kind of each elementary motion: "hinge", "slide" or "ball"; ("rod",) for a massless rod."""
    axes: Array
    """(n, 3) unit axes of the n hinges and slides, in order."""
    points: Array
    """(2 + h, 3) m: the joint points fixed in the first and in the second body, then a point on the axis of
    each of the h hinges. NaN for a point that the engine's model does not have; it is not compared.

    The joint point in the first body is the point of the first motion, that in the second body the point of
    the last motion: a point on the axis of a hinge, the center of a ball, or where the force of a slide acts.
    The joint points of a rod are its ends."""


NOWHERE = np.full(3, np.nan)
"""The point (3,) of `JointGeometry.points` that an engine's model does not have."""


def geometry_in_mechanism(mechanism: Mechanism) -> dict[str, JointGeometry]:
    """Return the geometry of all joints of a mechanism by joint name, as the mechanism describes them."""
    geometries = {}
    for joint in mechanism.joints:
        motions = joint.motions
        # a rod, which can only close a loop, has no elementary motions
        kinds = ("rod",) if joint.only_closes else tuple(motion.kind for motion in motions)
        axes = [motion.axis for motion in motions if motion.kind != "ball"]
        hinge_points = [
            point
            for motion, point in zip(motions, joint.motion_points, strict=True)
            if motion.kind == "hinge"
        ]
        points = np.array([joint.point, joint.point_on_second, *hinge_points])
        geometries[joint.name] = JointGeometry(kinds, np.reshape(axes, (-1, 3)), points)
    return geometries


def geometry_in_tree(
    welded: WeldedMechanism, read: Callable[[int], tuple[str, Array, Array]]
) -> dict[str, JointGeometry]:
    """Return the geometry of the joints in an engine's spanning tree by joint name.

    Args:
        welded: mechanism and spanning tree from which the engine's model was built.
        read: function that reads one elementary motion from the engine's model by the number of the motion in
            `SpanningTree.motions`. It returns the kind, the unit axis (3,) and the point (3,), m, of the
            motion of the child relative to the parent.
    """
    geometries, next_number = {}, 0
    for tree_joint in welded.tree.joints:
        numbers = range(next_number, next_number + len(tree_joint.motions))
        next_number = numbers.stop
        if tree_joint.joint >= len(welded.mechanism.joints):
            continue  # the free joint that the tree adds for a body that only rods hold
        motions = [read(number) for number in numbers]
        geometries[welded.tree.joint(tree_joint.joint).name] = _from_first_to_second(tree_joint, motions)
    return geometries


def _from_first_to_second(tree_joint: TreeJoint, motions: list[tuple[str, Array, Array]]) -> JointGeometry:
    """Build the geometry of a joint, ordered from its first to its second body, from the motions of its child
    body relative to its parent body.

    Args:
        tree_joint: the joint in the spanning tree. Its `forward` is False if the child is the joint's first
            body.
        motions: (kind, axis, point) of each elementary motion from parent to child, see `geometry_in_tree`.
    """
    sense = 1.0 if tree_joint.forward else -1.0
    ordered = motions if tree_joint.forward else motions[::-1]
    axes = [sense * axis for kind, axis, _ in ordered if kind != "ball"]
    hinge_points = [point for kind, _, point in ordered if kind == "hinge"]
    # The point of the last motion, the one next to the second body, is the joint point in the second body,
    # whether this body is the child or the parent. The engine has no separate joint point in the first body.
    # A rigid joint has no motions
    _, _, on_second = ordered[-1] if ordered else ("", NOWHERE, NOWHERE)
    points = np.array([NOWHERE, on_second, *hinge_points])
    return JointGeometry(tuple(kind for kind, _, _ in ordered), np.reshape(axes, (-1, 3)), points)


def loop_closing_geometry(kind: str, points: tuple[Array, Array]) -> JointGeometry:
    """Build the geometry of a joint that closes a loop.

    Args:
        kind: "ball" or "rod".
        points: joint point (3,) on the first and on the second body, m, world frame at the initial pose.
    """
    return JointGeometry((kind,), np.zeros((0, 3)), np.array(points))
