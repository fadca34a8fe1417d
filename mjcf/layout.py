"""Layout of a spanning tree in MuJoCo: numbers of bodies, coordinates and velocities.

Hinges and slides have the same coordinates in both. Two things differ:

- MuJoCo numbers bodies and coordinates depth first.
- A ball turns in the body frame of the child. In the tree a ball turns in a frame that is parallel to the
  world at the initial pose. With the orientation A0 of the child at the initial pose,
  R(qpos) = A0^T R(q) A0, so that vector parts and angular velocities differ by A0^T.
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
    """Numbers and linear maps between a spanning tree and its MuJoCo model.

    Attributes:
        order: joints of the tree, depth first; the child of joint k is MuJoCo's body k + 1.
        body_id: number of MuJoCo's body for each body of the tree; the ground is the world body 0.
        to_qpos: (nq, nq) orthogonal: qpos = to_qpos @ q.
        to_qvel: (nv, nv) orthogonal: qvel = to_qvel @ v.
    """

    def __init__(self, tree: SpanningTree) -> None:
        self.order: list[TreeJoint] = []
        self.body_id = [0] * len(tree.mechanism.bodies)
        self.to_qpos, self.to_qvel = np.zeros((tree.nq, tree.nq)), np.zeros((tree.nv, tree.nv))
        self._children: dict[int, list[TreeJoint]] = {}
        for kept in tree.joints:
            self._children.setdefault(kept.parent, []).append(kept)
        pending = self.children(0)[::-1]
        qpos = qvel = 0
        while pending:
            kept = pending.pop()
            self.order.append(kept)
            self.body_id[kept.child] = len(self.order)
            pending.extend(self.children(kept.child)[::-1])
            q, v = kept.q.start, kept.v.start
            for motion in kept.motions:
                if motion.kind == "ball":
                    into_body = tree.initial_rotations[kept.child].T
                    self.to_qpos[qpos, q] = 1.0
                    self.to_qpos[qpos + 1 : qpos + 4, q + 1 : q + 4] = into_body
                    self.to_qvel[qvel : qvel + 3, v : v + 3] = into_body
                    qpos, qvel, q, v = qpos + 4, qvel + 3, q + 4, v + 3
                else:
                    self.to_qpos[qpos, q] = 1.0
                    self.to_qvel[qvel, v] = 1.0
                    qpos, qvel, q, v = qpos + 1, qvel + 1, q + 1, v + 1

    def children(self, body: int) -> list[TreeJoint]:
        """Return the joints whose parent is a body, in the order of the MJCF file."""
        return self._children.get(body, [])


def number(value: float) -> str:
    """Return the shortest text that parses to the same float."""
    return repr(float(value) + 0.0).removesuffix(".0")  # + 0.0 turns -0.0 into 0.0


def numbers(values: Iterable[float]) -> str:
    """Return the texts of several numbers, separated by spaces."""
    return " ".join(number(value) for value in values)


def element_name(model: Any, kind: str, index: int) -> str:
    """Return the kind and name of an element of a compiled model; unnamed elements have their number."""
    return f"{kind} {getattr(model, kind)(index).name or index!r}"
