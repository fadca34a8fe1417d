"""Maps between newton_euler's spanning tree of a mechanism and its MuJoCo model, and texts of MJCF numbers.

The spanning tree has the joints that carry coordinates q and velocities v; other joints close loops. A joint
consists of elementary motions: hinges, slides and balls, each of which is a joint in MuJoCo. Hinges and
slides have the same coordinates in the tree and in MuJoCo, but two things differ:

- MuJoCo numbers bodies and coordinates depth first.
- The quaternion and the angular velocity of a ball are relative to the body frame of the child in MuJoCo. In
  the tree they are relative to a frame that is parallel to the world at the initial pose. With the rotation
  A0 from the body frame to the world at the initial pose, R(qpos) = A0^T R(q) A0. The vector parts of
  quaternions and the angular velocities therefore differ by the factor A0^T.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from newton_euler.model.joint import Joint
from newton_euler.model.spanning_tree import SpanningTree, TreeJoint, motion_names


def ball_name(joint: Joint) -> str:
    """Return the MJCF name of the ball of a joint."""
    names = zip(motion_names(joint), joint.motions, strict=True)
    return next(name for name, motion in names if motion.kind == "ball")


class Layout:
    """Body numbers and linear maps between a spanning tree and its MuJoCo model.

    Attributes:
        order: joints of the tree, depth first; the child body of `order[k]` is MuJoCo's body k + 1.
        body_id: MuJoCo's number of each body of the mechanism; the ground is the world body 0.
        to_qpos: (nq, nq) orthogonal matrix of qpos = to_qpos @ q.
        to_qvel: (nv, nv) orthogonal matrix of qvel = to_qvel @ v.
    """

    def __init__(self, tree: SpanningTree) -> None:
        """Number the bodies of a spanning tree as MuJoCo does, and build both maps."""
        self.order: list[TreeJoint] = []
        self.body_id = [0] * len(tree.mechanism.bodies)
        self.to_qpos, self.to_qvel = np.zeros((tree.nq, tree.nq)), np.zeros((tree.nv, tree.nv))
        self._children: dict[int, list[TreeJoint]] = {}
        for joint in tree.joints:
            self._children.setdefault(joint.parent, []).append(joint)
        # depth first, with the next indices in qpos and qvel
        pending = self.children(0)[::-1]
        qpos = qvel = 0
        while pending:
            joint = pending.pop()
            self.order.append(joint)
            self.body_id[joint.child] = len(self.order)
            pending.extend(self.children(joint.child)[::-1])
            q, v = joint.q.start, joint.v.start
            for motion in joint.motions:
                if motion.kind == "ball":
                    world_to_body = tree.initial_rotations[joint.child].T  # A0^T
                    self.to_qpos[qpos, q] = 1.0
                    self.to_qpos[qpos + 1 : qpos + 4, q + 1 : q + 4] = world_to_body
                    self.to_qvel[qvel : qvel + 3, v : v + 3] = world_to_body
                    qpos, qvel, q, v = qpos + 4, qvel + 3, q + 4, v + 3
                else:
                    self.to_qpos[qpos, q] = 1.0
                    self.to_qvel[qvel, v] = 1.0
                    qpos, qvel, q, v = qpos + 1, qvel + 1, q + 1, v + 1

    def children(self, body: int) -> list[TreeJoint]:
        """Return the joints whose parent is the body with a number, in the order of the MJCF file."""
        return self._children.get(body, [])


def number(value: float) -> str:
    """Return the shortest text of an MJCF attribute that parses to the same float."""
    return repr(float(value) + 0.0).removesuffix(".0")  # + 0.0 turns -0.0 into 0.0


def numbers(values: Iterable[float]) -> str:
    """Return the texts of several numbers, separated by spaces."""
    return " ".join(number(value) for value in values)


def element_name(model: Any, kind: str, index: int) -> str:
    """Return kind and name of an element of an `MjModel`, such as "joint hip"; its number if unnamed."""
    return f"{kind} {getattr(model, kind)(index).name or index!r}"
