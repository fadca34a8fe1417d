"""Two robots whose loops are cut at the same joints, if their files cut them at other joints.

In: two robot files and a first `Alignment`. Out: `SameCuts`, the robots with equal trees of joints. A body in
halves that a weld holds together becomes one rigid body. Joints with drives, couplings, springs, dampers,
armature or dry friction in either file stay joints, since loops have none of these.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from crosscheck.differences.alignment import Alignment, BodyPair, JointPair
from crosscheck.differences.common_states import closed_states, common_states
from crosscheck.differences.difference import Difference, Quantity, difference
from crosscheck.differences.dynamics import Dynamics
from crosscheck.differences.joint_tree import size_of
from crosscheck.differences.motion import Likeness, compare_motions
from crosscheck.differences.spanning_tree import (
    LOOP_OF_JOINT,
    Edge,
    edges,
    is_free,
    is_rigid,
    outward_edges,
    spanning_tree,
    with_tree,
)
from newton_euler.reading.robot import IN_PLACE, JointKind, LoopKind, Robot, RobotFile
from newton_euler.scalars import Array

MAX_GAP = 1e-4
"""Largest error, rad or lengths of the robot, of a loop that a joint can replace, in the pose of the file."""

MAX_TILT = 1e-4
"""rad, largest angle between the axes about which two bodies turn in several states, if it is one axis."""

UNSTATED = (
    Quantity.SIGN,
    Quantity.ZERO,
    Quantity.JOINT_AXIS,
    Quantity.LIMITS,
    Quantity.EFFORT,
    Quantity.SPEED,
)
"""Quantities of a joint that a loop at its place does not state."""


@dataclass(frozen=True, eq=False)
class SameCuts:
    """Two robots whose loops are cut at the same joints.

    Attributes:
        first, second: the files, with equal trees of joints.
        names: of the loops of both files.
        joints: names, in each robot, of joints that are loops in its file.
    """

    first: RobotFile
    second: RobotFile
    names: tuple[tuple[str, ...], tuple[str, ...]]
    joints: tuple[frozenset[str], frozenset[str]]

    def row(self) -> Difference:
        """Return the row that tells where both files cut the loops."""
        cuts = ", ".join(self.names[0]), ", ".join(self.names[1])
        words = "the files cut the same loops at other joints"
        return difference(
            self.names[0][0], "loop", Quantity.LOOP_CUT, cuts, (1.0, 0.0), words, convention=True
        )

    def judged(self, rows: Sequence[Difference], alignment: Alignment) -> Iterator[Difference]:
        """Yield rows; those of numbers that a loop does not state are conventions.

        Args:
            rows: differences of the two robots.
            alignment: pairs of their bodies and joints.
        """
        first, second = self.first.robot, self.second.robot
        names = {
            first.joint(pair.first).name
            for pair in alignment.joints
            if first.joint(pair.first).name in self.joints[0]
            or second.joint(pair.second).name in self.joints[1]
        }
        for row in rows:
            is_unstated = (
                row.element_kind == "joint" and row.quantity in UNSTATED and {*row.elements} <= names
            )
            if is_unstated and not row.convention:
                words = "one file has a loop at this joint, and does not state it"
                row = replace(row, convention=True, effect=0.0, cause=words)
            yield row


def with_same_cuts(first: RobotFile, second: RobotFile, alignment: Alignment) -> SameCuts | None:
    """Cut the loops of two robots at the same joints; None if they are, or if that is not possible.

    Args:
        first, second: the files.
        alignment: pairs of their bodies; those of equal names need none.
    """
    if not (first.robot.loops and second.robot.loops):
        return None
    one, two = _graphs(first.robot, second.robot, alignment)
    if one.keys(one.loops) == two.keys(two.loops) and one.welds == two.welds:
        return None
    kept = one.keys(one.needed_joints) | two.keys(two.needed_joints)
    first_tree = one.tree(kept, set())
    second_tree = two.tree(kept, one.keys(first_tree))
    if one.cuts(first_tree) != two.cuts(second_tree):
        return None
    recut = (
        _recut(first, first_tree, one.within(two.keys(two.points))),
        _recut(second, second_tree, two.within(one.keys(one.points))),
    )
    if recut[0] is None or recut[1] is None:
        return None
    return SameCuts(
        recut[0],
        recut[1],
        (one.loop_names(one.loops), two.loop_names(two.loops)),
        (frozenset(one.loop_names(first_tree)), frozenset(two.loop_names(second_tree))),
    )


Key = frozenset[int]
"""Numbers of the two rigid parts that an edge connects; one number if both bodies belong to one part."""


@dataclass(frozen=True, eq=False)
class _Graph:
    """Bodies of a robot as parts of a graph, whose edges are joints and loops.

    Attributes:
        robot: the robot.
        part: number of the rigid part of each body and of the ground, -1. Equal parts of two robots have
            equal numbers.
    """

    robot: Robot
    part: Mapping[int, int]

    def key(self, edge: Edge) -> Key:
        """Return the parts that an edge connects."""
        return frozenset(self.part[end] for end in edge.ends)

    def keys(self, some: Iterable[Edge]) -> set[Key]:
        """Return the parts that some edges connect."""
        return {self.key(edge) for edge in some}

    def within(self, keys: set[Key]) -> list[Edge]:
        """Return the edges that connect given parts."""
        return [edge for edge in edges(self.robot) if self.key(edge) in keys]

    @property
    def loops(self) -> list[Edge]:
        """Loops that connect two bodies, without rods."""
        return [edge for edge in edges(self.robot) if edge.loop >= 0]

    @property
    def points(self) -> list[Edge]:
        """Loops at a point."""
        return [edge for edge in self.loops if self.robot.loops[edge.loop].kind is LoopKind.POINT]

    @property
    def welds(self) -> set[frozenset[str]]:
        """Names of the bodies that each weld connects."""
        return {
            frozenset(self.robot.bodies[end].name if end >= 0 else "" for end in edge.ends)
            for edge in self.loops
            if is_rigid(self.robot, edge)
        }

    @property
    def needed_joints(self) -> list[Edge]:
        """Joints that cannot be loops."""
        return [edge for edge in edges(self.robot) if edge.loop < 0 and not _can_be_loop(self.robot, edge)]

    def loop_names(self, some: Iterable[Edge]) -> tuple[str, ...]:
        """Return the names of those of some edges that are loops."""
        return tuple(self.robot.loop_name(self.robot.loops[edge.loop]) for edge in some if edge.loop >= 0)

    def tree(self, kept: set[Key], wanted: set[Key]) -> set[Edge]:
        """Return a tree of joints.

        Args:
            kept: parts whose connection has to be a joint.
            wanted: parts whose connection should be a joint.
        """

        def rank(edge: Edge) -> int:
            """Return a small number for an edge that should be in the tree."""
            key = self.key(edge)
            wishes = is_rigid(self.robot, edge), key in kept, key in wanted, edge.loop < 0, True
            return wishes.index(True)

        return spanning_tree(self.robot, rank)

    def cuts(self, tree: set[Edge]) -> set[Key]:
        """Return the parts whose connection is a loop if a tree has the joints."""
        return self.keys(
            edge for edge in edges(self.robot) if edge not in tree and not is_free(self.robot, edge)
        )


def _graphs(first: Robot, second: Robot, alignment: Alignment) -> tuple[_Graph, _Graph]:
    """Number the rigid parts of two robots.

    Bodies of equal names are equal; others are if they have no namesake and are paired.
    """
    count = len(first.bodies) + 1
    # bodies and ground of the first robot, then those of the second
    part = list(range(count + len(second.bodies) + 1))

    def join(one: int, two: int) -> None:
        """Give the bodies of two parts the same number."""
        part[:] = [part[one] if own == part[two] else own for own in part]

    for robot, shift in ((first, 0), (second, count)):
        ground = shift + len(robot.bodies)
        for edge in edges(robot):
            if is_rigid(robot, edge):
                join(*(shift + end if end >= 0 else ground for end in edge.ends))
    join(len(first.bodies), count + len(second.bodies))
    named = {body.name: index for index, body in enumerate(second.bodies) if body.name}
    for index, body in enumerate(first.bodies):
        if body.name in named:
            join(index, count + named[body.name])
    names = {body.name for body in first.bodies}
    for pair in alignment.bodies:
        has_namesake = any(first.bodies[k].name in named for k in pair.first)
        if not has_namesake and not any(second.bodies[k].name in names & named.keys() for k in pair.second):
            join(pair.first[0], count + pair.second[0])
    return (
        _Graph(first, dict(enumerate(part[: count - 1])) | {-1: part[count - 1]}),
        _Graph(second, dict(enumerate(part[count:-1])) | {-1: part[-1]}),
    )


def _can_be_loop(robot: Robot, edge: Edge) -> bool:
    """Return whether the joints of an edge are one joint on which nothing acts."""
    joints = robot.bodies[edge.ends[1]].joints
    if len(joints) != 1 or joints[0].kind not in (*LOOP_OF_JOINT, JointKind.FREE):
        return False
    joint = joints[0]
    used = {name for drive in robot.drives for name in drive.gears}
    used |= {name for coupling in robot.couplings for name in (coupling.follower, coupling.leader)}
    acts = joint.damping or joint.stiffness or joint.armature or joint.friction
    return not acts and joint.name not in used


def _recut(file: RobotFile, tree: set[Edge], as_points: Sequence[Edge]) -> RobotFile | None:
    """Return a file whose robot and variants have another tree of joints; None if they move otherwise.

    Args:
        file: the file.
        tree: edges of the tree.
        as_points: edges that should be loops at a point, where that leaves the motion as it is.
    """
    robot = file.robot
    if tree == {edge for edge in edges(robot) if edge.loop < 0}:
        return file
    robots = Dynamics(file.robots, size_of(robot))
    if np.abs(robots.constraints_at(robots.zero).residual).max() > MAX_GAP:
        return None
    joined = [e.loop for e in tree if e.loop >= 0 and robot.loops[e.loop].kind is LoopKind.POINT]
    axes = _axes(robots, joined)
    named = [
        replace(each, loops=tuple(replace(loop, name=robot.loop_name(loop)) for loop in each.loops))
        for each in file.robots
    ]
    for points in (as_points, ()):
        nominal, *variants = (
            with_tree(each, tree, {loop: axis[k] for loop, axis in axes.items()}, points)
            for k, each in enumerate(named)
        )
        found = replace(file, robot=nominal, variants=tuple(variants))
        motion = compare_motions(common_states(file, found, _same_bodies(robot, tree)))
        if motion.likeness in (Likeness.EQUAL, Likeness.ROUNDING):
            return found
    return None


def _axes(robots: Dynamics, loops: Sequence[int]) -> dict[int, Array]:
    """Return (robots, 3) unit vectors about which the bodies of loops at a point turn, by index of the loop.

    A loop at a point allows any rotation; the rest of a planar mechanism may leave that about one axis. Loops
    whose bodies turn about several axes are left out.

    Args:
        robots: a robot and its variants.
        loops: indices of loops.
    """
    if not loops:
        return {}
    random = np.random.default_rng(0)
    coordinates, is_closed = closed_states(robots, random)
    if not is_closed:
        return {}
    velocities = robots.admissible(coordinates, robots.scale * random.normal(size=coordinates.shape))
    moving = robots.kinematics(coordinates, velocities)
    found = {}
    for number in loops:
        loop = robots.robot.loops[number]
        turning = moving.twist[..., loop.second, :3] - moving.twist[..., loop.first, :3]
        rates = np.einsum("...ji,...j->...i", moving.rotation[..., loop.second, :, :], turning)
        _, sizes, directions = np.linalg.svd(rates, full_matrices=False)
        if (sizes[:, 1] < MAX_TILT * sizes[:, 0]).all():
            axis = directions[:, 0]
            largest = np.argmax(np.abs(axis[0]))
            found[number] = axis * np.sign(axis[:, largest, None])
    return found


def _same_bodies(robot: Robot, tree: set[Edge]) -> Alignment:
    """Return the pairs of bodies and joints of a robot and the same robot with another tree of joints."""
    outward = outward_edges(tree)
    at = {body: number for number, body in enumerate(outward)}
    joints = []
    for body, edge in outward.items():
        count = len(robot.bodies[edge.ends[1]].joints) if edge.loop < 0 else 0
        is_reversed = body != edge.ends[1]
        for k in range(count):
            place = count - 1 - k if is_reversed else k
            joints.append(JointPair((edge.ends[1], k), (at[body], place), 1, 0.0))
    return Alignment(
        tuple(BodyPair((k,), (at[k],), IN_PLACE) for k in range(len(robot.bodies))), tuple(joints)
    )
