"""Part of a robot that has a partner in another robot.

In: two robots and their `Alignment`. Out: a `Cut` of each robot, which takes away what only this robot has: a
free base, branches without partner, and joints in a group of bodies that is rigid in the other robot.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from crosscheck.differences.alignment import Alignment, JointKey
from newton_euler.reading.robot import IN_PLACE, JointKind, Placement, Robot
from newton_euler.scalars import Array


@dataclass(frozen=True, eq=False)
class Cut:
    """Parts that are taken away from a robot, so that the rest has a partner in the other robot.

    Attributes:
        bodies: indices of bodies that lose their mass and their joints.
        held: indices of bodies that lose their joints, since these are fixed in the other robot.
        base: index of the body whose free joint is taken away; -1 for none.
        base_placement: of that body in the world.
        without_drives: whether drives are taken away.
    """

    bodies: tuple[int, ...] = ()
    held: tuple[int, ...] = ()
    base: int = -1
    base_placement: Placement = IN_PLACE
    without_drives: bool = False

    @property
    def takes_motion(self) -> bool:
        """True if the robot loses moving parts; drives are none."""
        return bool(self.bodies or self.held) or self.base >= 0

    def of(self, robot: Robot, gravity: Array) -> Robot:
        """Return the robot without these parts.

        Args:
            robot: the robot, or the same robot with other numbers.
            gravity: (3,) m/s^2, for a robot without gravity of its own.
        """
        gone = {joint.name for index in (*self.bodies, *self.held) for joint in robot.bodies[index].joints}
        bodies = list(robot.bodies)
        for index in self.bodies:
            bodies[index] = replace(bodies[index], joints=(), mass=0.0, inertia=np.zeros((3, 3)))
        for index in self.held:
            bodies[index] = replace(bodies[index], joints=())
        if self.base >= 0:
            bodies[self.base] = replace(bodies[self.base], joints=(), placement=self.base_placement)
        return replace(
            robot,
            bodies=tuple(bodies),
            loops=tuple(loop for loop in robot.loops if not {loop.first, loop.second} & {*self.bodies}),
            springs=tuple(k for k in robot.springs if not {k.first, k.second} & {*self.bodies}),
            couplings=tuple(c for c in robot.couplings if not {c.follower, c.leader} & gone),
            drives=() if self.without_drives else robot.drives,
            gravity=gravity if robot.gravity is None else robot.gravity,
        )


def cuts(first: Robot, second: Robot, alignment: Alignment, without_drives: bool) -> tuple[Cut, Cut]:
    """Find what each robot has more than the other: a free base, and whole branches without partner.

    A branch stays if a loop or a coupling connects it to a body that has a partner, since it may guide that
    body. If only one base is free, it is held where the other robot's base is.

    Args:
        first, second: the robots.
        alignment: their pairs of bodies and joints.
        without_drives: whether to take the drives away from both.
    """
    branches = _branches(first, alignment.first_bodies), _branches(second, alignment.second_bodies)
    joints = paired_joints(alignment)
    bases, placements = [-1, -1], [IN_PLACE, IN_PLACE]
    for side, robot in enumerate((first, second)):
        for index, body in enumerate(robot.bodies):
            is_free = any(joint.kind is JointKind.FREE for joint in body.joints)
            if is_free and (index, 0) not in joints[side] and index not in branches[side]:
                bases[side], placements[side] = index, body.placement
    for pair in alignment.bodies:
        if pair.first[0] == bases[0]:
            placements[0] = second.placements()[pair.second[0]] @ pair.placement.inverse()
        if pair.second[0] == bases[1]:
            placements[1] = first.placements()[pair.first[0]] @ pair.placement
    held = (
        _held(first, [pair.first for pair in alignment.bodies]),
        _held(second, [pair.second for pair in alignment.bodies]),
    )
    one, two = (
        Cut(branches[side], held[side], bases[side], placements[side], without_drives) for side in (0, 1)
    )
    return one, two


def _held(robot: Robot, groups: Sequence[tuple[int, ...]]) -> tuple[int, ...]:
    """Return the bodies that a joint moves within a group, which is rigid in the other robot."""
    return tuple(body for group in groups for body in group[1:] if robot.bodies[body].joints)


def _branches(robot: Robot, unpaired: Sequence[int]) -> tuple[int, ...]:
    """Return the bodies without partner that no joint, loop or coupling ties to bodies with partner."""
    of_joint = {joint.name: index for index, body in enumerate(robot.bodies) for joint in body.joints}
    ties = [(loop.first, loop.second) for loop in robot.loops]
    coupled = [c for c in robot.couplings if {c.follower, c.leader} <= of_joint.keys()]
    ties += [(of_joint[c.follower], of_joint[c.leader]) for c in coupled]
    gone, before = set(unpaired), -1
    while len(gone) != before:
        before = len(gone)
        held = {body for tie in ties if not gone.issuperset(tie) for body in tie}
        for index in reversed(range(len(robot.bodies))):
            if index not in gone or index in held:
                gone.discard(index)
                held.add(robot.bodies[index].parent)
    return tuple(sorted(gone))


def paired_joints(alignment: Alignment) -> tuple[list[JointKey], list[JointKey]]:
    """Return the joints of both robots that have partners, one by one or in groups."""
    first = [pair.first for pair in alignment.joints]
    second = [pair.second for pair in alignment.joints]
    for group in alignment.groups:
        first += group.first
        second += group.second
    return first, second
