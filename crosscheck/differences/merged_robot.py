"""A robot with the numbers of another robot, in its own structure, frames, zeros and senses.

In: two robots and their `Alignment`. Out: a `Merged`, the first robot and the first robot with all numbers of
the second. `crosscheck.differences.effects` exchanges numbers between these two.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from crosscheck.differences.alignment import Alignment
from crosscheck.differences.drive_pairs import Control, control_of_second, drive_pairs
from crosscheck.differences.dynamics import Dynamics
from crosscheck.differences.links import mass_of_group
from crosscheck.differences.pose_transfer import carry_over
from newton_euler.reading.robot import (
    IN_PLACE,
    FileBody,
    FileCoupling,
    FileDrive,
    FileJoint,
    FileLoop,
    FileSpring,
    LoopKind,
    Placement,
    Robot,
)
from newton_euler.scalars import Array

Between = TypeVar("Between", FileLoop, FileSpring)
"""Element between two bodies."""


@dataclass(frozen=True, eq=False)
class Merged:
    """The first robot, and the first robot with all numbers of the second, in the same structure.

    Attributes:
        first: the first robot; the mass of bodies that are fixed to each other is at the first of them. It
            has a drive without gear for each drive that only the second robot has.
        second: the same robot with the numbers of the second robot, where that has them. It has no gear for
            each drive that only the first robot has.
        loops, couplings, springs: indices of those of the first robot that have a partner in the second.
        other_loops, other_couplings, other_springs: those that only the second robot has, between bodies and
            joints that have partners.
    """

    first: Robot
    second: Robot
    loops: frozenset[int]
    couplings: frozenset[int]
    springs: frozenset[int]
    other_loops: tuple[FileLoop, ...]
    other_couplings: tuple[FileCoupling, ...]
    other_springs: tuple[FileSpring, ...]


def _named(robot: Robot) -> Robot:
    """Return a robot whose loops, springs and couplings have the names that rows give them."""
    return replace(
        robot,
        loops=tuple(replace(loop, name=robot.loop_name(loop)) for loop in robot.loops),
        springs=tuple(replace(spring, name=robot.loop_name(spring)) for spring in robot.springs),
        couplings=tuple(replace(c, name=c.name or c.follower) for c in robot.couplings),
    )


def merged(first: Robot, second: Robot, alignment: Alignment) -> Merged:
    """Write the numbers of the second robot in the structure, frames, zeros and senses of the first.

    Args:
        first, second: robots, cut to their common part.
        alignment: their pairs of bodies and joints.
    """
    first, second = _named(first), _named(second)
    terms = _Terms(first, second, alignment)
    paired = dict(drive_pairs(first, second, alignment.joints))
    added = [terms.drive(drive, None) for k, drive in enumerate(second.drives) if k not in paired.values()]
    own = [*first.drives, *(replace(drive, gears={}) for drive in added)]
    other = [
        replace(terms.drive(second.drives[paired[k]], drive), name=drive.name)
        if k in paired
        else replace(drive, gears={})
        for k, drive in enumerate(first.drives)
    ]
    loops, other_loops = terms.between_bodies(first.loops, second.loops)
    springs, other_springs = terms.between_bodies(first.springs, second.springs)
    couplings, other_couplings = terms.couplings()
    return Merged(
        replace(first, bodies=terms.merged_bodies(), drives=tuple(own)),
        replace(
            first,
            bodies=terms.bodies(),
            loops=tuple(loops.get(k, loop) for k, loop in enumerate(first.loops)),
            couplings=tuple(couplings.get(k, coupling) for k, coupling in enumerate(first.couplings)),
            drives=(*other, *added),
            springs=tuple(springs.get(k, spring) for k, spring in enumerate(first.springs)),
            gravity=second.gravity,
        ),
        frozenset(loops),
        frozenset(couplings),
        frozenset(springs),
        tuple(other_loops),
        tuple(other_couplings),
        tuple(other_springs),
    )


def _kind(element: FileLoop | FileSpring) -> LoopKind | None:
    """Return the kind of a loop; None for a spring."""
    return element.kind if isinstance(element, FileLoop) else None


class _Terms:
    """Numbers of the second robot in terms of the first one."""

    def __init__(self, first: Robot, second: Robot, alignment: Alignment) -> None:
        self.one, self.two, self.alignment = first, second, alignment
        self.worlds = first.placements(), second.placements()
        self.pairs = {pair.first[0]: pair for pair in alignment.bodies}
        self.roots = {body: pair.first[0] for pair in alignment.bodies for body in pair.first}
        self.of_second = {body: pair for pair in alignment.bodies for body in pair.second}
        self.joints = {pair.first: pair for pair in alignment.joints}
        self.partners = {
            second.joint(p.second).name: (first.joint(p.first).name, p) for p in alignment.joints
        }
        self.posed = self._frames_in_pose_of_first()

    def _frames_in_pose_of_first(self) -> dict[int, Placement]:
        """Return where the first robot's frames are at the second robot's bodies, both in its pose."""
        dynamics, other = Dynamics([self.one], 1.0), Dynamics([self.two], 1.0)
        pose = dynamics.zero
        coordinates, rates = carry_over(self.alignment, dynamics, other, pose, np.zeros(pose.shape))
        moving = other.kinematics(coordinates, rates)
        return {
            root: Placement(moving.position[0, 0, p.second[0]], moving.rotation[0, 0, p.second[0]])
            @ p.placement.inverse()
            for root, p in self.pairs.items()
        }

    def merged_bodies(self) -> tuple[FileBody, ...]:
        """Return the first robot's bodies with the mass of each rigid group at its first body."""
        bodies = list(self.one.bodies)
        for pair in self.alignment.bodies:
            self._set_mass(bodies, pair.first, *mass_of_group(self.one, pair.first, self.worlds[0]))
        return tuple(bodies)

    @staticmethod
    def _set_mass(
        bodies: list[FileBody], group: Sequence[int], mass: float, center: Array, inertia: Array
    ) -> None:
        """Give the mass of a rigid group to its first body."""
        bodies[group[0]] = replace(bodies[group[0]], mass=mass, center=center, inertia=inertia)
        for index in group[1:]:
            bodies[index] = replace(bodies[index], mass=0.0, inertia=np.zeros((3, 3)))

    def bodies(self) -> tuple[FileBody, ...]:
        """Return bodies with the masses, places and joints of the second robot."""
        bodies = list(self.one.bodies)
        for pair in self.alignment.bodies:
            mass, center, inertia = mass_of_group(self.two, pair.second, self.worlds[1])
            place, turn = pair.placement
            self._set_mass(bodies, pair.first, mass, place + turn @ center, turn @ inertia @ turn.T)
            root = pair.first[0]
            bodies[root] = replace(
                bodies[root],
                placement=self._placement(root),
                joints=tuple(
                    self._joint(joint, (root, k)) for k, joint in enumerate(self.one.bodies[root].joints)
                ),
            )
        return tuple(bodies)

    def _placement(self, root: int) -> Placement:
        """Return the placement of a body in its parent by the numbers of the second robot."""
        body = self.one.bodies[root]
        carrier = self.roots.get(body.parent, -1)
        if carrier < 0 and not self._is_fixed(body.parent):
            return body.placement
        # the frame of the parent, which is fixed to its carrier: a body with partner, or the ground
        world = self.worlds[0]
        own = world[body.parent] if body.parent >= 0 else IN_PLACE
        parent = self.posed[carrier] @ world[carrier].inverse() @ own if carrier >= 0 else own
        return parent.inverse() @ self.posed[root]

    def _is_fixed(self, index: int) -> bool:
        """Return whether a body of the first robot is fixed to the ground."""
        while index >= 0 and not self.one.bodies[index].joints:
            index = self.one.bodies[index].parent
        return index < 0

    def _joint(self, joint: FileJoint, key: tuple[int, int]) -> FileJoint:
        """Return a joint with the numbers of its partner."""
        pair = self.joints.get(key)
        if pair is None:
            return joint
        partner = self.two.joint(pair.second)
        if partner.kind is not joint.kind:
            return joint
        changed = replace(
            joint,
            damping=partner.damping,
            armature=partner.armature,
            stiffness=partner.stiffness,
            rest=pair.sense * (partner.rest - pair.offset),
        )
        if pair.second[0] not in self.of_second:  # a massless link of a chain of joints has no partner
            return changed
        placement = self.of_second[pair.second[0]].placement
        return replace(
            changed,
            axis=pair.sense * placement.rotation @ partner.axis,
            point=placement.point(partner.point),
        )

    def drive(self, drive: FileDrive, own: FileDrive | None) -> FileDrive:
        """Return a drive of the second robot with gears and lengths at the first robot's joints.

        Args:
            drive: the drive.
            own: drive of the first robot on the same joints, whose controls it gets; None without one.
        """
        partners = {name: self.partners[name] for name in drive.gears if name in self.partners}
        control = control_of_second(self.one, self.two, self.alignment, own, drive) if own else Control()
        shift = sum(drive.gears[name] * pair.offset for name, (_, pair) in partners.items())
        constant = drive.constant + drive.stiffness * shift + drive.gain * control.shift
        # a control of the other sense is a gear of the other sense
        return replace(
            drive,
            gears={
                name: control.sense * pair.sense * drive.gears[other]
                for other, (name, pair) in partners.items()
            },
            constant=control.sense * constant,
        )

    def couplings(self) -> tuple[dict[int, FileCoupling], list[FileCoupling]]:
        """Return the second robot's couplings in terms of the first.

        Returns:
            those of the same joints as couplings of the first, by index there; and the others.
        """
        found: dict[int, FileCoupling] = {}
        others = []
        for coupling in self.two.couplings:
            follower, leader = self.partners.get(coupling.follower), self.partners.get(coupling.leader)
            if follower is None or (coupling.leader and leader is None):
                continue
            names = follower[0], leader[0] if leader else ""
            powers = self._powers(coupling, follower[1].second, leader[1].second if leader else None, names)
            is_backwards = any((own.leader, own.follower) == names for own in self.one.couplings)
            if is_backwards and len(powers) > 1 and powers[1] and not any(powers[2:]):
                names, powers = names[::-1], (-powers[0] / powers[1], 1.0 / powers[1])
            changed = FileCoupling(coupling.name, *names, powers)
            fits = [
                k
                for k, own in enumerate(self.one.couplings)
                if (own.follower, own.leader) == names and k not in found
            ]
            if fits:
                found[fits[0]] = changed
            else:
                others.append(changed)
        return found, others

    def _powers(
        self,
        coupling: FileCoupling,
        follower: tuple[int, int],
        leader: tuple[int, int] | None,
        names: tuple[str, str],
    ) -> tuple[float, ...]:
        """Return a polynomial between coordinates from the zeros of the first robot, with its senses."""
        polynomial = np.polynomial.Polynomial(coupling.powers)
        if leader is not None:
            sense, shift = self._zero_shift(leader, names[1])
            polynomial = polynomial(np.polynomial.Polynomial([shift, sense]))
        sense, shift = self._zero_shift(follower, names[0])
        return tuple(float(c) for c in (sense * (polynomial - shift)).coef)

    def _zero_shift(self, key: tuple[int, int], name: str) -> tuple[int, float]:
        """Return sense and shift of a coordinate from the zero, in the second robot, by that in the first."""
        pair = self.partners[self.two.joint(key).name][1]
        own = self.one.joint(pair.first)
        partner = self.two.joint(key)
        return pair.sense, pair.sense * own.zero + pair.offset - partner.zero

    def between_bodies(
        self, own_elements: Sequence[Between], elements: Sequence[Between]
    ) -> tuple[dict[int, Between], list[Between]]:
        """Return loops or springs of the second robot in terms of the first.

        Args:
            own_elements, elements: those of the first and of the second robot.

        Returns:
            those of the same kind and bodies as elements of the first, by index there; and the others.
        """
        found: dict[int, Between] = {}
        others = []
        for element in elements:
            first, second = self._end_in_first(element.first), self._end_in_first(element.second)
            if first is None or second is None:
                continue
            fits = [
                (own.name != element.name, k)
                for k, own in enumerate(own_elements)
                if k not in found and _kind(own) is _kind(element)
                if {self._end(own.first), self._end(own.second)} == {first, second}
            ]
            bodies = first, second
            if fits:
                own = own_elements[min(fits)[1]]
                bodies = own.first, own.second
            sides = [(element.first, element.first_frame), (element.second, element.second_frame)]
            if self._end(bodies[0]) != first:
                sides.reverse()
            changed = replace(
                element,
                first=bodies[0],
                second=bodies[1],
                first_frame=self._frame(bodies[0], *sides[0]),
                second_frame=self._frame(bodies[1], *sides[1]),
            )
            if fits:
                found[min(fits)[1]] = changed
            else:
                others.append(changed)
        return found, others

    def _end(self, body: int) -> int:
        """Return the first body of the rigid group of a body of the first robot; -1 for the ground."""
        return self.roots.get(body, body)

    def _end_in_first(self, body: int) -> int | None:
        """Return the body of the first robot to which a body of the second corresponds; None without one."""
        if body < 0:
            return -1
        return self.of_second[body].first[0] if body in self.of_second else None

    def _frame(self, own: int, other: int, frame: Placement) -> Placement:
        """Return a frame in a body of the second robot as one in the body of the first."""
        if own < 0:
            return frame
        pair = self.of_second[other]
        one, two = self.worlds
        in_group = two[pair.second[0]].inverse() @ two[other] @ frame
        return one[own].inverse() @ one[pair.first[0]] @ pair.placement @ in_group
