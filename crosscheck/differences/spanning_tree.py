"""Robots whose loops are cut elsewhere: some joints become loops, and some loops become joints.

A robot with loops is a graph: bodies are its nodes, joints and loops its edges. A model file chooses a tree
of joints in this graph; loops are the other edges. In: a robot and the edges of another tree. Out: the same
mechanism with this tree. Bodies keep their frames, masses and names, joints their coordinates.
"""

from __future__ import annotations

from collections.abc import Callable, Container, Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from newton_euler.reading.robot import (
    IN_PLACE,
    FileBody,
    FileJoint,
    FileLoop,
    JointKind,
    LoopKind,
    Placement,
    Robot,
)
from newton_euler.scalars import Array

JOINT_OF_LOOP = {
    LoopKind.POINT: JointKind.BALL,
    LoopKind.HINGE: JointKind.HINGE,
    LoopKind.SLIDE: JointKind.SLIDE,
}
"""Kind of the joint that allows the same motion as a loop; a weld allows none, and no joint is like a rod."""

LOOP_OF_JOINT = {joint: loop for loop, joint in JOINT_OF_LOOP.items()}
"""Kind of the loop that allows the same motion as a joint."""


class Edge(NamedTuple):
    """Connection of two bodies by joints or by a loop.

    Attributes:
        ends: indices of both bodies, -1 for the ground: parent and child, or first and second body.
        loop: index of the loop in `Robot.loops`; -1 for the joints of the child, none if it is fixed.
    """

    ends: tuple[int, int]
    loop: int = -1


def edges(robot: Robot) -> list[Edge]:
    """Return the connections of a robot's bodies: joints, then loops; rods connect only points."""
    joints = [Edge((body.parent, index)) for index, body in enumerate(robot.bodies)]
    loops = [
        Edge((loop.first, loop.second), number)
        for number, loop in enumerate(robot.loops)
        if loop.kind is not LoopKind.ROD
    ]
    return [*joints, *loops]


def is_rigid(robot: Robot, edge: Edge) -> bool:
    """Return whether a connection allows no motion: a body without joints, or a weld."""
    if edge.loop >= 0:
        return robot.loops[edge.loop].kind is LoopKind.WELD
    return not robot.bodies[edge.ends[1]].joints


def is_free(robot: Robot, edge: Edge) -> bool:
    """Return whether an edge is a free joint, which does not hold the body."""
    joints = robot.bodies[edge.ends[1]].joints if edge.loop < 0 else ()
    return any(joint.kind is JointKind.FREE for joint in joints)


def spanning_tree(robot: Robot, rank: Callable[[Edge], int]) -> set[Edge]:
    """Return edges that connect all bodies to the ground without a loop; those of low rank first.

    J. B. Kruskal, On the shortest spanning subtree of a graph, 1956.
    """
    part = {index: index for index in range(-1, len(robot.bodies))}
    tree = set()
    for edge in sorted(edges(robot), key=rank):
        one, two = part[edge.ends[0]], part[edge.ends[1]]
        if one != two:
            tree.add(edge)
            part = {body: two if own == one else own for body, own in part.items()}
    return tree


def outward_edges(tree: set[Edge]) -> dict[int, Edge]:
    """Return the edge of a tree that connects each body to its parent; parents come before their children."""
    found: dict[int, Edge] = {}
    rest = set(tree)
    while rest:
        reached = {-1, *found}
        # the first body, in the order of the file, whose parent is known
        body, edge = min(
            (end, edge) for edge in rest for end in edge.ends if end not in reached and {*edge.ends} & reached
        )
        found[body] = edge
        rest.remove(edge)
    return found


def with_tree(robot: Robot, tree: set[Edge], axes: Mapping[int, Array], points: Container[Edge]) -> Robot:
    """Return a robot with another tree of joints. Its loops must be closed in the pose of the file.

    Args:
        robot: the robot.
        tree: edges that connect all bodies to the ground without a loop.
        axes: (3,) unit vector, in the frame of the second body, of loops at a point whose bodies only turn
            about this axis, by index of the loop. They become hinges.
        points: hinges outside of the tree that become loops at a point.
    """
    world = dict(enumerate(robot.placements())) | {-1: IN_PLACE}
    outward = outward_edges(tree)
    number = {body: position for position, body in enumerate(outward)} | {-1: -1}
    bodies = []
    for body, edge in outward.items():
        own, parent = robot.bodies[body], _other_end(edge, body)
        bodies.append(
            replace(
                own,
                parent=number[parent],
                placement=own.placement if parent == own.parent else world[parent].inverse() @ world[body],
                joints=_joints(robot, edge, body, world, axes),
            )
        )
    kept = [
        replace(loop, first=number[loop.first], second=number[loop.second])
        for index, loop in enumerate(robot.loops)
        if Edge((loop.first, loop.second), index) not in tree
    ]
    cut = [
        _loop(robot.bodies[edge.ends[1]], edge, world, number, is_point=edge in points)
        for edge in edges(robot)
        if edge.loop < 0 and edge not in tree
        if not is_free(robot, edge)
    ]
    springs = [
        replace(spring, first=number[spring.first], second=number[spring.second]) for spring in robot.springs
    ]
    return replace(robot, bodies=tuple(bodies), loops=(*kept, *cut), springs=tuple(springs))


def _other_end(edge: Edge, body: int) -> int:
    """Return the body at the other end of an edge."""
    return edge.ends[0] if edge.ends[1] == body else edge.ends[1]


def _joints(
    robot: Robot, edge: Edge, body: int, world: Mapping[int, Placement], axes: Mapping[int, Array]
) -> tuple[FileJoint, ...]:
    """Return the joints of an edge as joints of the body at its outer end, in the frame of this body."""
    if edge.loop < 0:
        joints = robot.bodies[edge.ends[1]].joints
        if body == edge.ends[1]:
            return joints
        # the former parent turns against its former child: by equal coordinates about the reversed axis
        into = world[body].inverse() @ world[edge.ends[1]]
        return tuple(
            replace(joint, axis=-into.rotation @ joint.axis, point=into.point(joint.point))
            for joint in reversed(joints)
        )
    loop = robot.loops[edge.loop]
    if loop.kind is LoopKind.WELD:
        return ()
    frame = loop.second_frame if body == loop.second else loop.first_frame
    kind, axis = JOINT_OF_LOOP[loop.kind], frame.rotation[:, 0]
    if edge.loop in axes:
        kind = JointKind.HINGE
        axis = world[body].rotation.T @ world[loop.second].rotation @ axes[edge.loop]
    elif kind is JointKind.BALL:
        axis = np.zeros(3)
    return (FileJoint(loop.name, kind, axis, frame.position),)


def _loop(
    body: FileBody,
    edge: Edge,
    world: Mapping[int, Placement],
    number: Mapping[int, int],
    is_point: bool,
) -> FileLoop:
    """Return the only joint of a body as a loop.

    Args:
        body: the body.
        edge: its edge.
        world: placement of each body in the world.
        number: index of each body in the robot of the loop.
        is_point: whether the loop leaves all rotations free.
    """
    (joint,) = body.joints
    parent, child = edge.ends
    frame = Placement(joint.point, _with_x_axis(joint.axis))
    in_parent = world[parent].inverse() @ world[child] @ frame
    kind = LoopKind.POINT if is_point else LOOP_OF_JOINT[joint.kind]
    return FileLoop(joint.name, kind, number[parent], number[child], in_parent, frame)


def _with_x_axis(axis: Array) -> Array:
    """Return a rotation matrix (3, 3) whose first column is a unit vector, or any matrix for zeros."""
    if not axis.any():
        return np.eye(3)
    other = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    other /= np.linalg.norm(other)
    return np.column_stack([axis, other, np.cross(axis, other)])
