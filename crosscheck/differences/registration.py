"""Motions that make a link of a second robot coincide with its partner in a first robot.

Two files may put the frame of a link, the zero of its joint, or both elsewhere, and they may really differ.
`register` compares explanations: equal frames, equal poses, and motions by which joint axes, centers of mass
or principal axes coincide. It returns the one that leaves the fewest numbers different.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from crosscheck.differences.links import Link, composite
from crosscheck.differences.rigid_motions import (
    about_line,
    common_normal,
    fitted,
    length,
    principal_rotations,
    rotation_between,
)
from crosscheck.differences.tree_match import LOCATED, agreement, assignment
from newton_euler.reading.robot import JointKind, Placement
from newton_euler.scalars import Array

CONVENTION_BONUS = 0.6
"""Value of an equal frame, and of an equal pose; less than the value 1 of one number of the link."""

MARGIN = 0.02
"""Value by which another explanation must be better than equal frames, and than equal poses."""

SUBTREE_WEIGHT = 0.3
"""Weight of the value of matched subtrees; equal numbers of their joints have the weight 1."""

POINT_WEIGHT = 0.3
"""Value of an equal point of an axis; an equal axis has the value 1, and files put points anywhere on it."""

SEPARATE = 1e-3
"""Smallest distance, relative to the robot's size, or angle in rad, from which an angle is computed."""

MIN_COSINE = 0.1
"""Smallest cosine of the angle of two axes at a parent that tells whether they count the same way."""


@dataclass(frozen=True, eq=False)
class Rigid:
    """A rigid body of a robot, in the world and in the pose of its file.

    Attributes:
        frame: frame of its first body; None between two joints of one body.
        joint: link with the joint that holds the body; None without one, or if that of the partner is of
            another kind.
        mass, center, inertia: as in `Link`.
        branches: links whose joints connect them to the body.
    """

    frame: Placement | None
    joint: Link | None
    mass: float
    center: Array
    inertia: Array
    branches: tuple[Link, ...]


class Registered(NamedTuple):
    """Result of `register`.

    Attributes:
        motion: takes the second robot's link to the first robot's, both in the pose of the file.
        same_pose: whether the motion of the parent explains the numbers as well.
        value: of the equal numbers of the link, and of an equal frame and an equal pose.
    """

    motion: Placement
    same_pose: bool
    value: float


Further = Callable[[Placement], float]
"""Value of the links that follow in both robots, if a motion takes a link to its partner."""

Likeness = Callable[[Link, Link], float]
"""Value of a match of all that hangs on a link of the first robot and on one of the second."""


def rigid(links: Sequence[Link], all_links: Sequence[Link], joint: Link | None) -> Rigid:
    """Return links that are fixed to each other as one rigid body.

    Args:
        links: the links; the frame is that of the first one that has a body, parents first.
        all_links: all links of the robot.
        joint: link with the joint that holds the body.
    """
    parts = [(link.mass, link.center, link.inertia) for link in links]
    mass, center, inertia = composite(parts, links[-1].center)
    own = {link.index for link in links}
    branches = tuple(all_links[child] for link in links for child in link.children if child not in own)
    framed = [link for link in links if link.bodies or link.joint is None]
    frame = min(framed, key=lambda link: link.bodies).frame if framed else None
    return Rigid(frame, joint, mass, center, inertia, branches)


def register(
    first: Rigid,
    second: Rigid,
    above: Placement,
    size: float,
    likeness: Likeness,
    extra: Sequence[Placement] = (),
    further: Further | None = None,
    *,
    pose_first: bool = False,
) -> Registered:
    """Find the motion that takes a link of the second robot to its partner in the first robot.

    Args:
        first, second: the link and its partner.
        above: motion of the parent of the link.
        size: typical length of the robots, m.
        likeness: value of matched subtrees; tells branches apart.
        extra: more motions to try.
        further: value of what follows; None if numbers of the link suffice.
        pose_first: whether an equal pose is preferred to equal frames if both explain the same.
    """
    comparison = _Comparison(first, second, size, likeness, above)
    by_frame, pose = comparison.by_frame, above
    explained = comparison.same_pose(by_frame) == 1.0 and further is None
    if explained and comparison.value(by_frame) > comparison.largest - MARGIN:
        return Registered(by_frame, same_pose=True, value=comparison.total(by_frame))
    if comparison.located:
        # a joint at another place moves what it holds, but turns nothing
        moved = comparison.joint_points_equal(above.rotation)
        if comparison.value(moved) > comparison.value(pose) + MARGIN:
            pose = moved
    totals = [comparison.total(motion) + (further(motion) if further else 0.0) for motion in (by_frame, pose)]
    if totals[1] > totals[0] + (-MARGIN if pose_first else MARGIN):
        best, best_total = pose, totals[1]
    else:
        best, best_total = by_frame, totals[0]
    if further or comparison.value(best) < comparison.largest - MARGIN:
        others = [*extra, *comparison.candidates()]
        if further:
            # what follows is compared only for the best explanations, since that costs more
            others = comparison.best_of(others)
        scores = [comparison.total(motion) + (further(motion) if further else 0.0) for motion in others]
        if scores and max(scores) > best_total + MARGIN:
            best_total = max(scores)
            best = others[scores.index(best_total)]
    pose_equal = comparison.value(pose) > comparison.value(best) - MARGIN
    return Registered(best, pose_equal and comparison.same_pose(best) == 1.0, best_total)


class _Comparison:
    """Numbers of a link and of its partner that can be equal.

    Attributes:
        first, second: the link and its partner.
        size: typical length of the robots, m.
        above: motion of the parent.
        by_frame: motion that makes the frames equal; that of the parent if a frame is missing.
        located: whether both are held by a joint whose place matters.
        largest: value if all numbers are equal.
    """

    def __init__(
        self, first: Rigid, second: Rigid, size: float, likeness: Likeness, above: Placement
    ) -> None:
        """Collect the numbers."""
        self.first, self.second, self.size, self.above = first, second, size, above
        self._origin = second.frame.position if second.frame else second.center
        self._framed = first.frame is not None and second.frame is not None
        self.by_frame = above
        if first.frame is not None and second.frame is not None:
            self.by_frame = first.frame @ second.frame.inverse()
        values = {
            (one.index, two.index): likeness(one, two) for one in first.branches for two in second.branches
        }
        self._values = {pair: value for pair, value in values.items() if value > 0}
        self._by_index = ({k.index: k for k in first.branches}, {k.index: k for k in second.branches})
        self._has_mass = first.mass > 0 and second.mass > 0
        self._inertia_scale = float(np.linalg.norm(first.inertia)) or 1.0
        self._likely = self._assigned(lambda one, two: self._values.get((one, two), 0.0))
        self._joint = (first.joint, second.joint) if first.joint and second.joint else None
        self.located = self._joint is not None and self._joint[0].kind in LOCATED
        self._slides = (
            self._joint is not None and self._joint[0].kind is self._joint[1].kind is JointKind.SLIDE
        )
        self.largest = (
            2.0 * self._has_mass
            + self._slides
            + sum(
                SUBTREE_WEIGHT * self._values[one.index, two.index] + _largest(one, two)
                for one, two in self._likely
            )
        )
        if self._joint:
            self.largest += _largest(*self._joint)

    def _assigned(self, value: Callable[[int, int], float]) -> list[tuple[Link, Link]]:
        """Assign the branches to each other."""
        indices = [k.index for k in self.first.branches], [k.index for k in self.second.branches]
        return [(self._by_index[0][a], self._by_index[1][b]) for a, b in assignment(*indices, value)]

    def value(self, motion: Placement) -> float:
        """Return how many numbers are equal after a motion of the second link; a similar one counts less."""
        found = 0.0
        if self._has_mass:
            center = motion.point(self.second.center)
            found += agreement(length(center - self.first.center) / self.size)
            inertia = motion.rotation @ self.second.inertia @ motion.rotation.T
            difference = (inertia - self.first.inertia).ravel()
            found += agreement(length(difference) / self._inertia_scale)
        if self._joint:
            found += line_value(*self._joint, motion, self.size, self.above)
            found += agreement(self._off_slide(motion)) if self._slides else 0.0
        if not self._values:
            return found
        lines = {
            pair: SUBTREE_WEIGHT * value
            + line_value(self._by_index[0][pair[0]], self._by_index[1][pair[1]], motion, self.size)
            for pair, value in self._values.items()
        }
        if len(lines) == 1:
            return found + next(iter(lines.values()))
        indices = [k.index for k in self.first.branches], [k.index for k in self.second.branches]
        return found + sum(lines[pair] for pair in assignment(*indices, lambda a, b: lines.get((a, b), 0.0)))

    def total(self, motion: Placement) -> float:
        """Return the value of a motion, with that of an equal frame and of an equal pose."""
        return self.value(motion) + CONVENTION_BONUS * (self.same_frame(motion) + self.same_pose(motion))

    def best_of(self, motions: Sequence[Placement]) -> list[Placement]:
        """Return the motions that leave the fewest numbers different, each one once.

        A point of an axis is free along the axis: motions that differ in such points alone count as equal.
        """
        values = [self.value(motion) for motion in motions]
        least = max(values, default=0.0) - POINT_WEIGHT - MARGIN
        found: list[Placement] = []
        for value, motion in sorted(zip(values, motions, strict=True), key=lambda each: -each[0]):
            known = (max(self._turn(motion, each), self._shift(motion, each)) for each in found)
            if value > least and min(known, default=1.0) > SEPARATE:
                found.append(motion)
        return found

    def same_frame(self, motion: Placement) -> float:
        """Return 1 if a motion makes the frames equal, up to 0.3 if it makes them similar."""
        if not self._framed:
            return 0.0
        return _sameness(max(self._turn(motion, self.by_frame), self._shift(motion, self.by_frame)))

    def same_pose(self, motion: Placement) -> float:
        """Return 1 if a motion leaves the joint where the parent's motion does, up to 0.3 if nearly."""
        turn = self._turn(motion, self.above)
        return _sameness(turn if self.located else max(turn, self._shift(motion, self.above)))

    def _off_slide(self, motion: Placement) -> float:
        """Return how far a motion takes the link off its slide at the parent, rad or relative to the size."""
        assert self._joint is not None
        axis = self.above.rotation @ self._joint[1].axis
        apart = motion.point(self._origin) - self.above.point(self._origin)
        return max(self._turn(motion, self.above), length(apart - (apart @ axis) * axis) / self.size)

    def _turn(self, one: Placement, two: Placement) -> float:
        """Return the angle between two motions, rad; exact for small angles."""
        return length((one.rotation - two.rotation).ravel()) / math.sqrt(2.0)

    def _shift(self, one: Placement, two: Placement) -> float:
        """Return how far apart two motions take the origin of the second link, relative to the size."""
        apart = one.rotation @ self._origin + one.position - two.rotation @ self._origin - two.position
        return length(apart) / self.size

    def joint_points_equal(self, rotation: Array) -> Placement:
        """Return the motion with a rotation that makes the points of the joints equal."""
        assert self._joint is not None
        return Placement(self._joint[0].point - rotation @ self._joint[1].point, rotation)

    def candidates(self) -> Iterator[Placement]:
        """Yield motions by which numbers of both links become equal."""
        if self._has_mass:
            for turn in principal_rotations(self.first.inertia, self.second.inertia):
                yield Placement(self.first.center - turn @ self.second.center, turn)
                if self.located:
                    yield self.joint_points_equal(turn)
        if self._joint and self._joint[0].axis.any() and self._joint[1].axis.any():
            yield from self._about_axis()
        else:
            yield from self._by_lines()

    def _about_axis(self) -> Iterator[Placement]:
        """Yield motions that put the joint's axis on that of the partner and turn or shift along it."""
        assert self._joint is not None
        one, two = self._joint
        for base in (self.above, self.by_frame):
            aligned = base.rotation @ two.axis
            for sense in (1.0, -1.0) if abs(float(aligned @ one.axis)) < 0.999 else (0.0,):
                turn = rotation_between(aligned, sense * one.axis) if sense else np.eye(3)
                rotation = turn @ base.rotation
                at = base.point(two.point)
                along = one.axis * float((at - one.point) @ one.axis)
                point = one.point + along if one.kind in LOCATED and sense else at
                start = Placement(point - rotation @ two.point, rotation)
                yield start
                if self.located:
                    yield self.joint_points_equal(rotation)
                yield from self._turned(start) if one.kind is JointKind.HINGE else self._shifted(start)

    def _turned(self, start: Placement) -> Iterator[Placement]:
        """Yield rotations about the hinge after a motion, by which another number becomes equal."""
        assert self._joint is not None
        joint = self._joint[0]
        angles: list[float | None] = []
        if self._has_mass:
            here = start.point(self.second.center) - joint.point
            angles.append(self._angle(joint.axis, self.first.center - joint.point, here, self.size))
        for one, two in self._likely:
            if one.axis.any() and two.axis.any():
                angle = self._angle(joint.axis, one.axis, start.rotation @ two.axis, 1.0)
                angles += [angle, angle + math.pi] if angle is not None else []
            here = start.point(two.point) - joint.point
            angles.append(self._angle(joint.axis, one.point - joint.point, here, self.size))
            # a point of the axis is free along the axis: the common normal of both axes has a direction
            if one.axis.any() and two.axis.any():
                there = start.rotation @ two.axis
                normals = (
                    common_normal(one.point - joint.point, joint.axis, one.axis),
                    common_normal(here, joint.axis, there),
                )
                angles.append(self._angle(joint.axis, *normals, self.size))
        for angle in angles:
            if angle is None:
                continue
            turned = about_line(joint.axis, joint.point, angle) @ start
            yield turned
            if self._has_mass:  # both frames may be elsewhere along the axis
                center = turned.point(self.second.center)
                along = joint.axis * float((self.first.center - center) @ joint.axis)
                yield Placement(turned.position + along, turned.rotation)

    def _shifted(self, start: Placement) -> Iterator[Placement]:
        """Yield translations after a motion, by which another number becomes equal."""
        points = [(one.point, two.point) for one, two in self._likely]
        if self._has_mass:
            points.append((self.first.center, self.second.center))
        for one, two in points:
            yield Placement(one - start.rotation @ two, start.rotation)

    def _by_lines(self) -> Iterator[Placement]:
        """Yield motions that bring the likely pairs of branches together."""
        one = [k.point for k, _ in self._likely]
        two = [k.point for _, k in self._likely]
        if self._has_mass:
            one.append(self.first.center)
            two.append(self.second.center)
        if self._joint and self.located:
            one.append(self._joint[0].point)
            two.append(self._joint[1].point)
        axes = [(a.axis, b.axis) for a, b in self._likely if a.axis.any() and b.axis.any()]
        if len(one) > 1:
            yield fitted(np.array(one), np.array(two), axes=())
            yield fitted(np.array(one), np.array(two), axes=axes)
        branches = len(self._likely)
        if branches > 1 and len(one) > branches:
            # the mass may differ, and the joints may be where they were
            yield fitted(np.array(one[:branches]), np.array(two[:branches]), axes=axes)

    def _angle(self, axis: Array, first: Array, second: Array, scale: float) -> float | None:
        """Return the angle about an axis from a vector to another one; None if one is along the axis."""
        one, two = first - (first @ axis) * axis, second - (second @ axis) * axis
        if min(length(one), length(two)) < SEPARATE * scale:
            return None
        return math.atan2(float(axis @ np.cross(two, one)), float(one @ two))


def _sameness(difference: float) -> float:
    """Return 1 for a difference, rad or relative, below the digits of files, up to 0.3 for a larger one."""
    return 1.0 if difference < 3e-5 else 0.3 / (1.0 + (difference / 0.5) ** 2)


def line_value(one: Link, two: Link, motion: Placement, size: float, above: Placement | None = None) -> float:
    """Return how many numbers of two joints are equal if the second one is moved: direction and place.

    Args:
        one, two: links whose joints they are.
        motion: of the second joint.
        size: typical length of the robots, m.
        above: motion of the parent of the second link, which decides whether the joints count the other way;
            None if `motion` decides.
    """
    if one.kind != two.kind or one.kind in (None, JointKind.FREE):
        return 0.0
    found = 0.0
    point = motion.point(two.point) - one.point
    if one.axis.any():
        moved = motion.rotation @ two.axis
        at_parent = above.rotation @ two.axis if above else moved
        clear = abs(float(at_parent @ one.axis)) > MIN_COSINE
        sense = math.copysign(1.0, float((at_parent if clear else moved) @ one.axis))
        found += agreement(length(one.axis - sense * moved))
    if one.kind in LOCATED:
        found += agreement(length(point - (point @ one.axis) * one.axis) / size)
    return found + POINT_WEIGHT * agreement(length(point) / size)


def _largest(one: Link, two: Link) -> float:
    """Return the value of `line_value` if all numbers are equal; a point on the axis may differ."""
    if one.kind != two.kind or one.kind in (None, JointKind.FREE):
        return 0.0
    return float(one.axis.any()) + (one.kind in LOCATED)


def looks_same_after_half_turn(link: Rigid, size: float) -> bool:
    """Return whether half a turn about the hinge of a rigid body changes none of its numbers.

    Args:
        link: the body.
        size: typical length of the robot, m.
    """
    if link.joint is None or link.joint.kind is not JointKind.HINGE:
        return False
    half_turn = about_line(link.joint.axis, link.joint.point, math.pi)
    turned = half_turn.rotation @ link.inertia @ half_turn.rotation.T
    differences = [
        length(half_turn.point(link.center) - link.center) / size,
        length((turned - link.inertia).ravel()) / (length(link.inertia.ravel()) or 1.0),
    ]
    return max(differences) < SEPARATE and all(
        line_value(branch, branch, half_turn, size) > _largest(branch, branch) - MARGIN
        for branch in link.branches
    )
