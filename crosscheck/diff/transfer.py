"""Carry states and numbers of two aligned robots over from one to the other.

In: two robots and their `Alignment`. Out: the parts that both have; the state of the second robot in which
its bodies are where those of the first are; and the first robot with the numbers of the second.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from crosscheck.diff.alignment import Alignment
from crosscheck.diff.dynamics import Dynamics
from crosscheck.diff.vectors import cross, rotation_vector
from newton_euler.reading.robot import (
    FileBody,
    FileCoupling,
    FileDrive,
    FileJoint,
    FileLoop,
    JointKind,
    Placement,
    Robot,
)
from newton_euler.scalars import Array

SCALAR = (JointKind.HINGE, JointKind.SLIDE)
"""Joints with one coordinate, on which drives, springs and couplings act."""

GROUND = Placement(np.zeros(3), np.eye(3))
"""Placement of the ground in the world."""


@dataclass(frozen=True, eq=False)
class Cut:
    """Parts that are taken away from a robot, so that the rest has a partner in the other robot.

    Attributes:
        bodies: indices of bodies that lose their mass and their joints.
        base: index of the body whose free joint is taken away; -1 for none.
        base_placement: of that body in the world.
        without_drives: whether drives are taken away.
    """

    bodies: tuple[int, ...] = ()
    base: int = -1
    base_placement: Placement = GROUND
    without_drives: bool = False

    def of(self, robot: Robot, gravity: Array) -> Robot:
        """Return the robot without these parts.

        Args:
            robot: the robot, or the same robot with other numbers.
            gravity: (3,) m/s^2, for a robot without gravity of its own.
        """
        gone = {joint.name for index in self.bodies for joint in robot.bodies[index].joints}
        bodies = list(robot.bodies)
        for index in self.bodies:
            bodies[index] = replace(bodies[index], joints=(), mass=0.0, inertia=np.zeros((3, 3)))
        if self.base >= 0:
            bodies[self.base] = replace(bodies[self.base], joints=(), placement=self.base_placement)
        return replace(
            robot,
            bodies=tuple(bodies),
            loops=tuple(loop for loop in robot.loops if not {loop.first, loop.second} & {*self.bodies}),
            couplings=tuple(c for c in robot.couplings if not {c.follower, c.leader} & gone),
            drives=() if self.without_drives else robot.drives,
            gravity=gravity if robot.gravity is None else robot.gravity,
        )


def cuts(first: Robot, second: Robot, alignment: Alignment, without_drives: bool) -> tuple[Cut, Cut]:
    """Find what each robot has more than the other: a free base, and whole branches without partner.

    A branch stays if a loop connects it to a body that has a partner, since it may guide that body. If only
    one base is free, it is held where the other robot's base is.

    Args:
        first, second: the robots.
        alignment: their pairs of bodies and joints.
        without_drives: whether to take the drives away from both.
    """
    bases, placements = [-1, -1], [GROUND, GROUND]
    for pair in alignment.bodies if alignment.base else ():
        for side, (robot, body) in enumerate(((first, pair.first[0]), (second, pair.second[0]))):
            if any(joint.kind is JointKind.FREE for joint in robot.bodies[body].joints):
                bases[side] = body
                placements[side] = (
                    second.placements()[pair.second[0]] @ pair.placement.inverse()
                    if side == 0
                    else first.placements()[pair.first[0]] @ pair.placement
                )
    branches = _branches(first, alignment.first_bodies), _branches(second, alignment.second_bodies)
    one, two = (Cut(branches[side], bases[side], placements[side], without_drives) for side in (0, 1))
    return one, two


def _branches(robot: Robot, unpaired: Sequence[int]) -> tuple[int, ...]:
    """Return the bodies without partner that carry no body with partner, neither by joints nor by loops."""
    gone = set(unpaired)
    held = {loop.second for loop in robot.loops if loop.first not in gone}
    held |= {loop.first for loop in robot.loops if loop.second not in gone}
    for index in reversed(range(len(robot.bodies))):
        if index not in gone or index in held:
            gone.discard(index)
            held.add(robot.bodies[index].parent)
    return tuple(sorted(gone))


def is_paired(dynamics: Dynamics, joints: Sequence[tuple[int, int]]) -> Array:
    """Return (coordinates,) whether each coordinate belongs to joints, by indices of body and joint."""
    paired = np.zeros(dynamics.size, bool)
    for key in joints:
        if key in dynamics.at:
            paired[dynamics.at[key]] = True
    return paired


def carry_over(
    alignment: Alignment, first: Dynamics, second: Dynamics, coordinates: Array, velocities: Array
) -> tuple[Array, Array]:
    """Return the state of the second robot in which its joints are where those of the first are.

    Joints without partner are in the pose of the file and do not move.

    Args:
        alignment: pairs of bodies and joints.
        first, second: equations of each robot.
        coordinates, velocities: (robots, states, coordinates) of the first robot.

    Returns:
        (robots, states, coordinates of the second robot) coordinates and velocities.
    """
    found = second.zero[:1] + np.zeros((*coordinates.shape[:2], 1))
    rates = np.zeros(found.shape)
    placements = {pair.second[0]: (pair.first[0], pair.placement) for pair in alignment.bodies}
    turning = []
    for pair in alignment.joints:
        if pair.first not in first.at or pair.second not in second.at:
            continue
        at, to = first.at[pair.first], second.at[pair.second]
        if first.robot.bodies[pair.first[0]].joints[pair.first[1]].kind in SCALAR:
            found[..., to] = pair.sense * coordinates[..., at] + pair.offset
            rates[..., to] = pair.sense * velocities[..., at]
        elif pair.second[0] in placements:
            turning.append((pair, at, to))
    moving = first.kinematics(coordinates, velocities)
    for pair, at, to in sorted(turning, key=lambda each: each[0].second):
        # balls and free joints: move the body of the second robot from where it is to where it should be
        body, placement = placements[pair.second[0]]
        now = second.kinematics(found, rates)
        index = pair.second[0]
        back = np.swapaxes(now.rotation[..., index, :, :], -1, -2)
        turn = back @ moving.rotation[..., body, :, :] @ placement.rotation
        found[..., to.stop - 3 : to.stop] = rotation_vector(turn)
        angular = velocities[..., at.stop - 3 : at.stop]
        rates[..., to.stop - 3 : to.stop] = angular @ placement.rotation
        if to.stop - to.start == 6:
            goal = moving.position[..., body, :] + moving.rotation[..., body, :, :] @ placement.position
            found[..., to.start : to.start + 3] = (back @ (goal - now.position[..., index, :])[..., None])[
                ..., 0
            ]
            linear = velocities[..., at.start : at.start + 3] + cross(angular, placement.position)
            rates[..., to.start : to.start + 3] = linear @ placement.rotation
    return found, rates


def drive_pairs(first: Robot, second: Robot, alignment: Alignment) -> list[tuple[int, int]]:
    """Return pairs of drives that act on the same joints; of several, those of the same name first."""
    partners = {_name(second, pair.second): _name(first, pair.first) for pair in alignment.joints}
    free = list(range(len(second.drives)))
    pairs = []
    for index, drive in enumerate(first.drives):
        same = [
            other
            for other in free
            if {partners.get(name) for name in second.drives[other].gears} == {*drive.gears}
            and (drive.gears or second.drives[other].name == drive.name)
        ]
        if same:
            partner = min(same, key=lambda other: second.drives[other].name != drive.name)
            pairs.append((index, partner))
            free.remove(partner)
    return pairs


def _name(robot: Robot, key: tuple[int, int]) -> str:
    """Return the name of a joint by the indices of body and joint."""
    return robot.bodies[key[0]].joints[key[1]].name


@dataclass(frozen=True, eq=False)
class Merged:
    """The first robot, and the first robot with all numbers of the second, in the same structure.

    Attributes:
        first: the first robot; the mass of bodies that are fixed to each other is at the first of them. It
            has a drive without gear for each drive that only the second robot has.
        second: the same robot with the numbers of the second robot, where that has them, and with the loops
            and couplings that the second robot has of those of the first.
        drives: index of each drive, by name; the second robot's name is another key.
    """

    first: Robot
    second: Robot
    drives: dict[str, int]


def merged(first: Robot, second: Robot, alignment: Alignment) -> Merged:
    """Write the numbers of the second robot in the structure, frames, zeros and senses of the first.

    Args:
        first, second: robots, cut to their common part.
        alignment: their pairs of bodies and joints.
    """
    terms = _Terms(first, second, alignment)
    pairs = drive_pairs(first, second, alignment)
    paired = dict(pairs)
    new = [k for k in range(len(second.drives)) if k not in paired.values()]
    added = [terms.drive(second.drives[k]) for k in new]
    of_first = [*first.drives, *(replace(drive, gears={}) for drive in added)]
    of_second = [
        replace(terms.drive(second.drives[paired[k]]), name=drive.name)
        if k in paired
        else replace(drive, gears={})
        for k, drive in enumerate(first.drives)
    ]
    names = {second.drives[b].name: a for a, b in pairs}
    names |= {drive.name: k for k, drive in enumerate(of_first)}
    return Merged(
        replace(first, bodies=terms.merged_bodies(), drives=tuple(of_first)),
        replace(
            first,
            bodies=terms.bodies(),
            loops=terms.loops(),
            couplings=terms.couplings(),
            drives=(*of_second, *added),
            gravity=second.gravity,
        ),
        names,
    )


class _Terms:
    """Numbers of the second robot in terms of the first one."""

    def __init__(self, first: Robot, second: Robot, alignment: Alignment) -> None:
        self.one, self.two, self.alignment = first, second, alignment
        self.worlds = first.placements(), second.placements()
        self.pairs = {pair.first[0]: pair for pair in alignment.bodies}
        self.roots = {body: pair.first[0] for pair in alignment.bodies for body in pair.first}
        self.of_second = {body: pair for pair in alignment.bodies for body in pair.second}
        self.joints = {pair.first: pair for pair in alignment.joints}
        self.partners = {_name(second, p.second): (_name(first, p.first), p) for p in alignment.joints}
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
        own = world[body.parent] if body.parent >= 0 else GROUND
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
        if pair is None or pair.second[0] not in self.of_second:
            return joint
        partner = self.two.bodies[pair.second[0]].joints[pair.second[1]]
        placement = self.of_second[pair.second[0]].placement
        return replace(
            joint,
            axis=pair.sense * placement.rotation @ partner.axis,
            point=placement.position + placement.rotation @ partner.point,
            damping=partner.damping,
            armature=partner.armature,
            stiffness=partner.stiffness,
            rest=pair.sense * (partner.rest - pair.offset),
        )

    def drive(self, drive: FileDrive) -> FileDrive:
        """Return a drive of the second robot with gears and lengths at the first robot's joints."""
        gears, shift = {}, 0.0
        for name, gear in drive.gears.items():
            if name in self.partners:
                own, pair = self.partners[name]
                gears[own] = pair.sense * gear
                shift += gear * pair.offset
        return replace(drive, gears=gears, constant=drive.constant + drive.stiffness * shift)

    def couplings(self) -> tuple[FileCoupling, ...]:
        """Return the second robot's couplings of the same joints as those of the first, in its order."""
        found = {}
        for coupling in self.two.couplings:
            follower = self.partners.get(coupling.follower)
            leader = self.partners.get(coupling.leader)
            if follower is None or (coupling.leader and leader is None):
                continue
            names = (follower[0], leader[0] if leader else "")
            found[names] = self._powers(
                coupling, follower[1].second, leader[1].second if leader else None, names
            )
        return tuple(
            replace(own, powers=found[own.follower, own.leader])
            for own in self.one.couplings
            if (own.follower, own.leader) in found
        )

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
        pair = self.partners[_name(self.two, key)][1]
        own = self.one.bodies[pair.first[0]].joints[pair.first[1]]
        partner = self.two.bodies[key[0]].joints[key[1]]
        return pair.sense, pair.sense * own.zero + pair.offset - partner.zero

    def loops(self) -> tuple[FileLoop, ...]:
        """Return the second robot's loops between the same bodies as those of the first, in its order."""
        left = list(self.two.loops)
        found = []
        for own in self.one.loops:
            ends = self._end(own.first), self._end(own.second)
            fits = [
                loop
                for loop in left
                if loop.kind is own.kind
                and (self._end_in_first(loop.first), self._end_in_first(loop.second)) == ends
            ]
            named = [loop for loop in fits if loop.name == own.name] or fits
            if not named:
                continue
            left.remove(named[0])
            found.append(
                replace(
                    own,
                    first_frame=self._frame(own.first, named[0].first, named[0].first_frame),
                    second_frame=self._frame(own.second, named[0].second, named[0].second_frame),
                    length=named[0].length,
                )
            )
        return tuple(found)

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


def mass_of_group(
    robot: Robot, group: Sequence[int], world: Sequence[Placement]
) -> tuple[float, Array, Array]:
    """Return mass, center and inertia about the center of a rigid group, in the frame of its first body."""
    parts = []
    for index in group:
        body = robot.bodies[index]
        place, turn = world[group[0]].inverse() @ world[index]
        parts.append((body.mass, place + turn @ body.center, turn @ body.inertia @ turn.T))
    mass = sum(part[0] for part in parts)
    weights = [part[0] / mass for part in parts] if mass else [1.0 / len(parts) for _ in parts]
    center = np.asarray(sum(w * part[1] for w, part in zip(weights, parts, strict=True)))
    inertia = np.zeros((3, 3))
    for part_mass, part_center, part_inertia in parts:
        d = part_center - center
        inertia += part_inertia + part_mass * (d @ d * np.eye(3) - np.outer(d, d))
    return mass, center, inertia
