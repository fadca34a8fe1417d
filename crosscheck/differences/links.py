"""A robot of a model file as a tree of rigid links, each of which one joint connects to its parent link.

In: a `newton_euler.reading.robot.Robot`. Out: a `LinkTree`. Bodies that are fixed to each other are one
link, and all bodies that are fixed to the ground are the first link. A body with several joints is preceded
by links without mass. Positions and directions are along the axes of the world, in the pose of the file.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from newton_euler.reading.robot import IN_PLACE, FileJoint, JointKind, Placement, Robot
from newton_euler.scalars import Array

MASSLESS_FRACTION = 1e-6
"""Fraction of the robot's mass below which a link with one joint and one child only transmits the motion."""


@dataclass(eq=False)
class Link:
    """Rigid link of a robot in the pose of its file.

    Attributes:
        index: position in `LinkTree.links`; parents come before their children.
        parent: index of the parent link; -1 for the ground.
        key: index of the body, and of the joint in the body, of the joint to the parent; None for the ground.
        joint: joint to the parent; None for the ground.
        bodies: indices in `Robot.bodies` of the bodies that are fixed to each other; empty for the link
            between two joints of one body.
        names: names of the bodies.
        frame: frame in the world of the first body.
        axis: (3,) direction of the joint's axis; zeros for the ground, balls and free joints.
        point: (3,) m, point of the joint.
        mass: kg.
        center: (3,) m, center of mass; the origin of the frame if the mass is zero.
        inertia: (3, 3) kg m^2, about the center of mass.
        children: indices of the child links.
    """

    index: int
    parent: int
    key: tuple[int, int] | None
    joint: FileJoint | None
    bodies: tuple[int, ...]
    names: tuple[str, ...]
    frame: Placement
    axis: Array
    point: Array
    mass: float
    center: Array
    inertia: Array
    children: list[int] = field(default_factory=list)

    @property
    def kind(self) -> JointKind | None:
        """Motion of the joint to the parent; None for the ground."""
        return self.joint.kind if self.joint else None


class LinkTree:
    """Rigid links of a robot.

    Only a link that has a mass, no child or several children is a node of the tree that is matched. A link
    without mass between two joints belongs to the path from its node to the parent node.

    Attributes:
        robot: the robot.
        links: links; the first one is the ground with all bodies that are fixed to it.
        link_of: index of the link of each body.
        frame_of: frame of each body in the world.
        nodes: indices of the links that are nodes.
        branches: indices of the child nodes of each node, by the index of its link.
        size: typical distance of joints and centers of mass from each other, m.
    """

    def __init__(self, robot: Robot) -> None:
        """Join the bodies of a robot that are fixed to each other."""
        self.robot = robot
        self.links: list[Link] = []
        self.link_of: list[int] = []
        self.frame_of = robot.placements()
        self._collect()
        self.branches: dict[int, list[int]] = {}
        massless = MASSLESS_FRACTION * sum(link.mass for link in self.links)
        passing = {k.index for k in self.links[1:] if k.mass <= massless and len(k.children) == 1}
        self.nodes = [link.index for link in self.links if link.index not in passing]
        for node in self.nodes:
            self.branches[node] = []
            above = self.links[node].parent
            while above in passing:
                above = self.links[above].parent
            if above >= 0:
                self.branches[above].append(node)
        spots = [link.point for link in self.links[1:]] + [
            link.center for link in self.links if link.mass > 0
        ]
        spread = np.std(spots, axis=0) if spots else np.zeros(3)
        self.size = math.sqrt(float(spread @ spread)) or 1.0

    def _collect(self) -> None:
        """Make the links of all bodies."""
        members: list[list[int]] = [[]]
        joints: list[tuple[int, int] | None] = [None]
        parents = [-1]
        for index, body in enumerate(self.robot.bodies):
            above = self.link_of[body.parent] if body.parent >= 0 else 0
            for number in range(len(body.joints)):
                members.append([])
                joints.append((index, number))
                parents.append(above)
                above = len(members) - 1
            self.link_of.append(above)
            members[above].append(index)
        for bodies, key, parent in zip(members, joints, parents, strict=True):
            self.links.append(self._link(parent, key, tuple(bodies)))
            if parent >= 0:
                self.links[parent].children.append(self.links[-1].index)

    def _link(self, parent: int, key: tuple[int, int] | None, bodies: tuple[int, ...]) -> Link:
        """Make one link of bodies that are fixed to each other."""
        frames = self.frame_of
        names = tuple(self.robot.bodies[index].name for index in bodies)
        frame = frames[bodies[0]] if bodies else frames[key[0]] if key else IN_PLACE
        joint, axis, point = None, np.zeros(3), frame.position
        if key is not None:
            own = frames[key[0]]
            joint = self.robot.bodies[key[0]].joints[key[1]]
            axis, point = own.rotation @ joint.axis, own.point(joint.point)
        mass, center, inertia = composite(placed_masses(self.robot, bodies, frames), frame.position)
        return Link(
            len(self.links), parent, key, joint, bodies, names, frame, axis, point, mass, center, inertia
        )

    def key(self, index: int) -> tuple[int, int]:
        """Return the index of the body, and of the joint in the body, of the joint of a link."""
        key = self.links[index].key
        assert key is not None
        return key

    def path(self, node: int, ancestor: int) -> list[Link]:
        """Return the links from below an ancestor down to a link."""
        found = []
        while node != ancestor and node >= 0:
            found.append(self.links[node])
            node = self.links[node].parent
        return found[::-1]

    def below(self, index: int) -> list[Link]:
        """Return a link and all links that hang on it."""
        found = [self.links[index]]
        for link in found:
            found.extend(self.links[child] for child in link.children)
        return found


def composite(parts: Sequence[tuple[float, Array, Array]], without_mass: Array) -> tuple[float, Array, Array]:
    """Return mass, center of mass and inertia about the center of bodies that are fixed to each other.

    Args:
        parts: mass, center (3,) and inertia (3, 3) about the center of each body, along common axes.
        without_mass: (3,) center of mass that is returned if no body has mass.
    """
    mass = sum(part[0] for part in parts)
    if mass <= 0:
        return 0.0, without_mass, sum((part[2] for part in parts), np.zeros((3, 3)))
    center = sum((part[0] * part[1] for part in parts), np.zeros(3)) / mass
    inertia = np.zeros((3, 3))
    for own_mass, own_center, own_inertia in parts:
        arm = own_center - center
        inertia += own_inertia + own_mass * ((arm @ arm) * np.eye(3) - np.outer(arm, arm))
    return mass, center, inertia


def placed_masses(
    robot: Robot, bodies: Sequence[int], frames: Mapping[int, Placement] | Sequence[Placement]
) -> list[tuple[float, Array, Array]]:
    """Return mass, center (3,) and inertia (3, 3) about the center of each of some bodies, for `composite`.

    Args:
        robot: the robot.
        bodies: indices of the bodies.
        frames: placement of each body's frame, by its index, in the frame of the result.
    """
    return [
        (each.mass, frame.point(each.center), frame.rotation @ each.inertia @ frame.rotation.T)
        for each, frame in ((robot.bodies[index], frames[index]) for index in bodies)
    ]


def relative_frames(group: Sequence[int], world: Sequence[Placement]) -> dict[int, Placement]:
    """Return the placements of bodies in the frame of the first of them, by index.

    Args:
        group: indices of the bodies.
        world: placements of all bodies of the robot in the world.
    """
    to_first = world[group[0]].inverse()
    return {index: to_first @ world[index] for index in group}


def mass_of_group(
    robot: Robot, group: Sequence[int], world: Sequence[Placement]
) -> tuple[float, Array, Array]:
    """Return mass, center and inertia about the center of a rigid group, in the frame of its first body."""
    parts = placed_masses(robot, group, relative_frames(group, world))
    # without mass, the mean of the centers
    return composite(parts, np.mean([center for _, center, _ in parts], axis=0))
