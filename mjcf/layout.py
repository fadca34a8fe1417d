"""Layout: numbers, names and measures that MuJoCo has for what a spanning tree knows.

Hinges and slides are the same numbers in both. Two things differ. MuJoCo numbers bodies, and with
them coordinates, depth first. And a ball turns in the child's own body frame, while the tree turns
it in a frame parallel to the world at the initial pose; with A0 the orientation of the child at
the initial pose, R(qpos) = A0^T R(q) A0, so vector parts and angular velocities differ by A0^T.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from newton_euler.model.joint import Joint
from newton_euler.model.spanning_tree import SpanningTree, TreeJoint, motion_names


def ball_name(joint: Joint) -> str:
    """MJCF name of a joint's ball."""
    names = zip(motion_names(joint), joint.motions, strict=True)
    return next(name for name, motion in names if motion.kind == "ball")


class Layout:
    """Indices and maps between a tree and its MuJoCo model.

    Attributes:
        order: the tree's joints, depth first; child number k of this list is MuJoCo body k + 1.
        body_id: MuJoCo body of each of the tree's bodies; the ground is the world body 0.
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
        """The tree's joints that hang on a body, in the order of its MJCF."""
        return self._children.get(body, [])


def number(value: float) -> str:
    """The shortest text that reads back as the same float."""
    return repr(float(value) + 0.0).removesuffix(".0")  # + 0.0 turns -0.0 into 0.0


def numbers(values: Iterable[float]) -> str:
    """Several, with spaces between."""
    return " ".join(number(value) for value in values)


def element_name(model: Any, kind: str, index: int) -> str:
    """Name of an element of a compiled model in reports: of its kind, and by its number if it has no name."""
    return f"{kind} {getattr(model, kind)(index).name or index!r}"
