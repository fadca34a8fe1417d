"""Joints as each engine's own model has them at the initial pose: kinds, axes and points.

What is read is the engine's model and not the description that it was made from. Joints in a tree have one
point, in the child, and axes; those that close a loop are balls and rods and have a point on each body.
Where a body is halved to close a loop, the joint is in the tree and the weld of the halves is no joint.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from newton_euler.model.mechanism import Mechanism
from newton_euler.model.spanning_tree import TreeJoint, WeldedMechanism, motion_names
from newton_euler.scalars import Array


class JointGeometry(NamedTuple):
    """A joint at the initial pose, world frame."""

    kinds: tuple[str, ...]
    """ "hinge", "slide" or "ball" for each motion from the first body to the second, or "rod"."""
    axes: Array
    """(n, 3) unit axes of the hinges and slides."""
    points: Array
    """(2 + h, 3) joint point on the first body and on the second, then on each of h hinges, m; NaN where a
    model has none."""


NOWHERE = np.full(3, np.nan)


def stated(mechanism: Mechanism) -> dict[str, JointGeometry]:
    """The joints as a mechanism has them."""
    found = {}
    for joint in mechanism.joints:
        motions = joint.motions
        kinds = ("rod",) if joint.only_closes else tuple(motion.kind for motion in motions)
        axes = [motion.axis for motion in motions if motion.kind != "ball"]
        hinges = [
            point
            for motion, point in zip(motions, joint.motion_points, strict=True)
            if motion.kind == "hinge"
        ]
        points = np.array([joint.point, joint.reaction_point, *hinges])
        found[joint.name] = JointGeometry(kinds, np.reshape(axes, (-1, 3)), points)
    return found


def in_tree(
    welded: WeldedMechanism, read: Callable[[str], tuple[str, Array, Array]]
) -> dict[str, JointGeometry]:
    """Joints that a tree keeps; `read` gives kind, axis and point of a motion by its name."""
    found = {}
    for kept in welded.tree.joints:
        if kept.joint >= len(welded.mechanism.joints):
            continue  # of a body that only rods hold
        joint = welded.tree.joint(kept.joint)
        motions = [read(name) for name in motion_names(joint, kept.forward)]
        found[joint.name] = _from_first(kept, motions)
    return found


def _from_first(kept: TreeJoint, motions: list[tuple[str, Array, Array]]) -> JointGeometry:
    """Convert motions of the child relative to the parent into the order and sense of the joint."""
    sense = 1.0 if kept.forward else -1.0
    ordered = motions if kept.forward else motions[::-1]
    axes = [sense * axis for kind, axis, _ in ordered if kind != "ball"]
    hinges = [point for kind, _, point in ordered if kind == "hinge"]
    points = np.array([NOWHERE, ordered[-1][2] if ordered else NOWHERE, *hinges])
    return JointGeometry(tuple(kind for kind, _, _ in ordered), np.reshape(axes, (-1, 3)), points)


def closing(kind: str, points: tuple[Array, Array]) -> JointGeometry:
    return JointGeometry((kind,), np.zeros((0, 3)), np.array(points))
