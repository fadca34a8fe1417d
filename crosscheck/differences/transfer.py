"""Carry states and numbers of two aligned robots over from one to the other.

In: two robots and their `Alignment`. Out: the parts that both have; the state of the second robot in which
its bodies are where those of the first are; and the first robot with the numbers of the second.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from crosscheck.differences.alignment import Alignment, JointKey
from crosscheck.differences.connections import loop_name
from crosscheck.differences.dynamics import Dynamics
from crosscheck.differences.links import composite
from crosscheck.differences.vectors import Equations, apply, cross, rotation_vector
from newton_euler.reading.robot import (
    IN_PLACE,
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

MAX_LIMIT_ERROR = 0.02
"""rad or m: largest error of limits that are meant to be mirrored or shifted with the zero of a joint."""

PLACE_WEIGHT = 1e-3
"""Weight of a place, in lengths of the robot, against an angle in rad, where joints cannot reach both."""

MAX_STEPS = 30
"""Gauss-Newton steps to move a body to a pose."""

SMALL_STEP = 1e-9
"""Change of a coordinate, rad or m, at which these steps end: the next one is about its square."""


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


def paired_joints(alignment: Alignment) -> tuple[list[JointKey], list[JointKey]]:
    """Return the joints of both robots that have partners, one by one or in groups."""
    first = [pair.first for pair in alignment.joints]
    second = [pair.second for pair in alignment.joints]
    for group in alignment.groups:
        first += group.first
        second += group.second
    return first, second


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
    others = [(group.first, group.second) for group in alignment.groups]
    for pair in alignment.joints:
        if pair.first not in first.at or pair.second not in second.at:
            continue
        kinds = (
            first.robot.bodies[pair.first[0]].joints[pair.first[1]].kind,
            second.robot.bodies[pair.second[0]].joints[pair.second[1]].kind,
        )
        if kinds[0] in SCALAR and kinds[1] in SCALAR:
            at, to = first.at[pair.first], second.at[pair.second]
            found[..., to] = pair.sense * coordinates[..., at] + pair.offset
            rates[..., to] = pair.sense * velocities[..., at]
        else:
            others.append(((pair.first,), (pair.second,)))
    # balls, free joints, and groups of joints such as three hinges for a ball: move the body of the second
    # robot from where it is to where it should be, from the root outwards
    moving = first.kinematics(coordinates, velocities)
    placements = {(pair.first[0], pair.second[0]): pair.placement for pair in alignment.bodies}
    for own, other in sorted(others, key=lambda each: each[1]):
        bodies = own[-1][0], other[-1][0]
        columns = np.flatnonzero(is_paired(second, other))
        if bodies in placements and len(columns):
            goal = _Goal(
                moving.position[..., bodies[0], :]
                + moving.rotation[..., bodies[0], :, :] @ placements[bodies].position,
                moving.rotation[..., bodies[0], :, :] @ placements[bodies].rotation,
                moving.twist[..., bodies[0], :],
            )
            found, rates = _moved_to(goal, second, bodies[1], columns, found, rates)
    return found, rates


class _Goal(NamedTuple):
    """Pose and twist that a body should have, with the axes robots and states."""

    position: Array
    rotation: Array
    twist: Array


def _moved_to(
    goal: _Goal, robot: Dynamics, body: int, columns: Array, coordinates: Array, velocities: Array
) -> tuple[Array, Array]:
    """Return coordinates and velocities at which a body has a pose and a twist.

    Args:
        goal: pose and twist of the body.
        robot: equations of the robot.
        body: index of the body.
        columns: indices of the coordinates that move.
        coordinates, velocities: (robots, states, coordinates) before.
    """
    # a rotation counts more than a place that the joint cannot reach
    weights = np.repeat([1.0, PLACE_WEIGHT / robot.length], 3)
    scale = robot.scale[columns]
    for _ in range(MAX_STEPS):
        now = robot.kinematics(coordinates, np.zeros(coordinates.shape))
        turn, place = now.rotation[..., body, :, :], now.position[..., body, :]
        tilt = apply(turn, rotation_vector(np.swapaxes(turn, -1, -2) @ goal.rotation))
        error = np.concatenate([tilt, goal.position - place], axis=-1)
        twists = now.columns[..., columns, :]
        at_body = np.concatenate(
            [twists[..., :3], twists[..., 3:] + cross(twists[..., :3], place[..., None, :])], axis=-1
        )
        step = np.zeros(coordinates.shape)
        matrix = np.swapaxes(at_body * weights, -1, -2) * scale
        step[..., columns] = scale * Equations(matrix).solution(weights * error)
        coordinates = robot.moved(coordinates, step)
        if np.abs(step).max() < SMALL_STEP:
            break
    now = robot.kinematics(coordinates, velocities)
    missing = goal.twist - now.twist[..., body, :]
    # twists count at the body
    missing[..., 3:] += cross(missing[..., :3], now.position[..., body, :])
    velocities = velocities.copy()
    velocities[..., columns] += scale * Equations(matrix).solution(weights * missing)
    return coordinates, velocities


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


class Control(NamedTuple):
    """Control of a drive of the second robot by that of the first: sense times it, plus shift."""

    sense: int = 1
    shift: float = 0.0


def control_of_second(
    first: Robot, second: Robot, alignment: Alignment, own: FileDrive, drive: FileDrive
) -> Control:
    """Return the control of a drive of the second robot that commands the same as that of the first.

    If a joint counts the other way, or from another zero, and its limits do so too, the file means it:
    controls count as the joint does. If its limits do not, or the gear makes up for it, equal numbers command
    the same.

    Args:
        first, second: the robots.
        alignment: their pairs of bodies and joints.
        own, drive: drives of the first and the second robot on the same joints.
    """
    pairs = [pair for pair in alignment.joints if _name(second, pair.second) in drive.gears]
    senses = {pair.sense for pair in pairs}
    if len(senses) != 1 or not drive.gain:
        return Control()
    sense, is_reversed, shift = senses.pop(), False, 0.0
    for pair in pairs:
        limits = first.bodies[pair.first[0]].joints[pair.first[1]].limits
        other = second.bodies[pair.second[0]].joints[pair.second[1]].limits
        expected = sorted(pair.sense * limit + pair.offset for limit in limits)
        if not np.allclose(expected, other, atol=MAX_LIMIT_ERROR):
            return Control()
        gear = drive.gears[_name(second, pair.second)]
        shift += gear * pair.offset
        is_reversed |= sense * gear * drive.gain * own.gears[_name(first, pair.first)] * own.gain < 0
    return Control(sense if is_reversed else 1, -drive.stiffness * shift / drive.gain)


def _name(robot: Robot, key: tuple[int, int]) -> str:
    """Return the name of a joint by the indices of body and joint."""
    return robot.bodies[key[0]].joints[key[1]].name


@dataclass(frozen=True, eq=False)
class Merged:
    """The first robot, and the first robot with all numbers of the second, in the same structure.

    Attributes:
        first: the first robot; the mass of bodies that are fixed to each other is at the first of them. It
            has a drive without gear for each drive that only the second robot has.
        second: the same robot with the numbers of the second robot, where that has them. It has no gear for
            each drive that only the first robot has.
        loops, couplings: indices of those of the first robot that have a partner in the second.
        other_loops, other_couplings: those that only the second robot has, between bodies and joints that
            have partners.
    """

    first: Robot
    second: Robot
    loops: frozenset[int]
    couplings: frozenset[int]
    other_loops: tuple[FileLoop, ...]
    other_couplings: tuple[FileCoupling, ...]


def _named(robot: Robot) -> Robot:
    """Return a robot whose loops, couplings and drives have the names that rows of differences give them."""
    return replace(
        robot,
        loops=tuple(replace(loop, name=loop_name(robot, loop)) for loop in robot.loops),
        couplings=tuple(replace(c, name=c.name or c.follower) for c in robot.couplings),
        drives=tuple(replace(drive, name=drive.name or ", ".join(drive.gears)) for drive in robot.drives),
    )


def merged(first: Robot, second: Robot, alignment: Alignment) -> Merged:
    """Write the numbers of the second robot in the structure, frames, zeros and senses of the first.

    Args:
        first, second: robots, cut to their common part.
        alignment: their pairs of bodies and joints.
    """
    first, second = _named(first), _named(second)
    terms = _Terms(first, second, alignment)
    paired = dict(drive_pairs(first, second, alignment))
    added = [terms.drive(drive, None) for k, drive in enumerate(second.drives) if k not in paired.values()]
    own = [*first.drives, *(replace(drive, gears={}) for drive in added)]
    other = [
        replace(terms.drive(second.drives[paired[k]], drive), name=drive.name)
        if k in paired
        else replace(drive, gears={})
        for k, drive in enumerate(first.drives)
    ]
    loops, other_loops = terms.loops()
    couplings, other_couplings = terms.couplings()
    return Merged(
        replace(first, bodies=terms.merged_bodies(), drives=tuple(own)),
        replace(
            first,
            bodies=terms.bodies(),
            loops=tuple(loops.get(k, loop) for k, loop in enumerate(first.loops)),
            couplings=tuple(couplings.get(k, coupling) for k, coupling in enumerate(first.couplings)),
            drives=(*other, *added),
            gravity=second.gravity,
        ),
        frozenset(loops),
        frozenset(couplings),
        tuple(other_loops),
        tuple(other_couplings),
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
        if pair is None or pair.second[0] not in self.of_second:
            return joint
        partner = self.two.bodies[pair.second[0]].joints[pair.second[1]]
        if partner.kind is not joint.kind:
            return joint
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
        pair = self.partners[_name(self.two, key)][1]
        own = self.one.bodies[pair.first[0]].joints[pair.first[1]]
        partner = self.two.bodies[key[0]].joints[key[1]]
        return pair.sense, pair.sense * own.zero + pair.offset - partner.zero

    def loops(self) -> tuple[dict[int, FileLoop], list[FileLoop]]:
        """Return the second robot's loops in terms of the first.

        Returns:
            those of the same kind and bodies as loops of the first, by index there; and the others.
        """
        found: dict[int, FileLoop] = {}
        others = []
        for loop in self.two.loops:
            first, second = self._end_in_first(loop.first), self._end_in_first(loop.second)
            if first is None or second is None:
                continue
            fits = [
                (own.name != loop.name, k)
                for k, own in enumerate(self.one.loops)
                if own.kind is loop.kind and k not in found
                if {self._end(own.first), self._end(own.second)} == {first, second}
            ]
            bodies = first, second
            if fits:
                own = self.one.loops[min(fits)[1]]
                bodies = own.first, own.second
            sides = [(loop.first, loop.first_frame), (loop.second, loop.second_frame)]
            if self._end(bodies[0]) != first:
                sides.reverse()
            changed = replace(
                loop,
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


def mass_of_group(
    robot: Robot, group: Sequence[int], world: Sequence[Placement]
) -> tuple[float, Array, Array]:
    """Return mass, center and inertia about the center of a rigid group, in the frame of its first body."""
    parts = []
    for index in group:
        body = robot.bodies[index]
        place, turn = world[group[0]].inverse() @ world[index]
        parts.append((body.mass, place + turn @ body.center, turn @ body.inertia @ turn.T))
    # without mass, the mean of the centers
    return composite(parts, np.mean([center for _, center, _ in parts], axis=0))
