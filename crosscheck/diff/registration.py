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

from crosscheck.diff.links import Link, composite
from crosscheck.diff.tree_match import LOCATED, agreement, assignment
from newton_euler.reading.robot import JointKind, Placement
from newton_euler.scalars import Array

CONVENTION_BONUS = 0.6
"""Value of an equal frame, and of an equal pose; less than the value 1 of one number of the link."""

MARGIN = 0.02
"""Value by which another explanation must be better than equal frames, and than equal poses."""

SUBTREE_WEIGHT = 0.3
"""Weight of the value of matched subtrees beside the value of equal numbers of their joints."""

POINT_WEIGHT = 0.3
"""Value of an equal point of an axis, beside 1 for the axis: files put it anywhere on the axis."""

SEPARATE = 1e-3
"""Smallest distance, relative to the robot's size, or angle in rad, from which an angle is computed."""


@dataclass(frozen=True, eq=False)
class Rigid:
    """A rigid body of a robot, in the world and in the pose of its file.

    Attributes:
        frame: frame of its first body.
        joint: link with the joint that holds the body; None without one, or if that of the partner is of
            another kind.
        mass, center, inertia: as in `Link`.
        branches: links whose joints connect them to the body.
    """

    frame: Placement
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
    """

    motion: Placement
    same_pose: bool


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
    frame = min((link for link in links if link.bodies), key=lambda link: link.bodies[0], default=links[-1])
    return Rigid(frame.frame, joint, mass, center, inertia, branches)


def register(
    first: Rigid,
    second: Rigid,
    above: Placement,
    size: float,
    likeness: Likeness,
    extra: Sequence[Placement] = (),
) -> Registered:
    """Find the motion that takes a link of the second robot to its partner in the first robot.

    Args:
        first, second: the link and its partner.
        above: motion of the parent of the link.
        size: typical length of the robots, m.
        likeness: value of matched subtrees; tells branches apart.
        extra: more motions to try.
    """
    comparison = _Comparison(first, second, size, likeness)
    by_frame = first.frame @ second.frame.inverse()
    frame_value, pose_value = comparison.value(by_frame), comparison.value(above)
    same = comparison.convention(by_frame, above)
    frame_total = frame_value + CONVENTION_BONUS * (1.0 + same)
    pose_total = pose_value + CONVENTION_BONUS * (1.0 + same)
    best, best_total = by_frame, frame_total
    if pose_total > frame_total + MARGIN:
        best, best_total = above, pose_total
    if max(frame_value, pose_value) < comparison.largest - MARGIN:
        others: list[tuple[float, int, Placement]] = []
        for number, motion in enumerate(comparison.candidates(above, by_frame, extra)):
            total = comparison.value(motion) + CONVENTION_BONUS * (
                comparison.convention(motion, above) + comparison.convention(motion, by_frame)
            )
            others.append((total, -number, motion))
        if others:
            total, _, motion = max(others, key=lambda other: other[:2])
            if total > best_total + MARGIN:
                best, best_total = motion, total
    value = comparison.value(best)
    return Registered(best, pose_value > value - MARGIN and comparison.convention(best, above) > 0.9)


class _Comparison:
    """Numbers of a link and of its partner that can be equal.

    Attributes:
        first, second: the link and its partner.
        size: typical length of the robots, m.
        largest: value if all numbers are equal.
    """

    def __init__(self, first: Rigid, second: Rigid, size: float, likeness: Likeness) -> None:
        """Collect the numbers."""
        self.first, self.second, self.size = first, second, size
        self._likeness = likeness
        self._values = {
            (one.index, two.index): max(0.0, likeness(one, two))
            for one in first.branches
            for two in second.branches
        }
        self._by_index = ({k.index: k for k in first.branches}, {k.index: k for k in second.branches})
        self._has_mass = first.mass > 0 and second.mass > 0
        self._inertia_scale = float(np.linalg.norm(first.inertia)) or 1.0
        self._likely = self._assigned(lambda one, two: self._values[one, two])
        self._joint = (first.joint, second.joint) if first.joint and second.joint else None
        self.largest = 2.0 * self._has_mass + sum(
            SUBTREE_WEIGHT * self._values[one.index, two.index] + _largest(one, two)
            for one, two in self._likely
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
            center = motion.position + motion.rotation @ self.second.center
            found += agreement(_norm(center - self.first.center) / self.size)
            inertia = motion.rotation @ self.second.inertia @ motion.rotation.T
            difference = (inertia - self.first.inertia).ravel()
            found += agreement(_norm(difference) / self._inertia_scale)
        if self._joint:
            found += line_value(*self._joint, motion, self.size)
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
        return found + sum(lines[pair] for pair in assignment(*indices, lambda a, b: lines[a, b]))

    def convention(self, one: Placement, two: Placement) -> float:
        """Return 1 if two motions take the second link to one place, less if they take it to similar ones."""
        # the trace of the product of both rotations is 1 + 2 cos(angle); the norm has digits at small angles
        angle = _norm((one.rotation - two.rotation).ravel()) / math.sqrt(2.0)
        origin = self.second.frame.position
        apart = one.rotation @ origin + one.position - two.rotation @ origin - two.position
        return 1.0 if max(angle, _norm(apart) / self.size) < 3e-5 else 0.0  # rad, above digits of files

    def candidates(
        self, above: Placement, by_frame: Placement, extra: Sequence[Placement]
    ) -> Iterator[Placement]:
        """Yield motions by which numbers of both links become equal."""
        yield from extra
        if self._has_mass:
            for turn in principal_rotations(self.first.inertia, self.second.inertia):
                yield Placement(self.first.center - turn @ self.second.center, turn)
                if self._joint and self._joint[0].kind == self._joint[1].kind != JointKind.SLIDE:
                    yield Placement(self._joint[0].point - turn @ self._joint[1].point, turn)
        if self._joint and self._joint[0].axis.any() and self._joint[1].axis.any():
            yield from self._about_axis(above, by_frame)
        else:
            yield from self._by_lines()

    def _about_axis(self, above: Placement, by_frame: Placement) -> Iterator[Placement]:
        """Yield motions that put the joint's axis on that of the partner and turn or shift along it."""
        assert self._joint is not None
        one, two = self._joint
        for base in (above, by_frame):
            aligned = base.rotation @ two.axis
            for sense in (1.0, -1.0) if abs(float(aligned @ one.axis)) < 0.999 else (0.0,):
                turn = rotation_between(aligned, sense * one.axis) if sense else np.eye(3)
                rotation = turn @ base.rotation
                at = base.position + base.rotation @ two.point
                along = one.axis * float((at - one.point) @ one.axis)
                point = one.point + along if one.kind in LOCATED and sense else at
                start = Placement(point - rotation @ two.point, rotation)
                yield start
                yield from self._turned(start) if one.kind is JointKind.HINGE else self._shifted(start)

    def _turned(self, start: Placement) -> Iterator[Placement]:
        """Yield rotations about the hinge after a motion, by which another number becomes equal."""
        assert self._joint is not None
        joint = self._joint[0]
        angles: list[float | None] = []
        if self._has_mass:
            here = start.position + start.rotation @ self.second.center - joint.point
            angles.append(self._angle(joint.axis, self.first.center - joint.point, here, self.size))
        for one, two in self._likely:
            if one.axis.any() and two.axis.any():
                angle = self._angle(joint.axis, one.axis, start.rotation @ two.axis, 1.0)
                angles += [angle, angle + math.pi] if angle is not None else []
            here = start.position + start.rotation @ two.point - joint.point
            angles.append(self._angle(joint.axis, one.point - joint.point, here, self.size))
            # a point of the axis is free along the axis: the common normal of both axes has a direction
            if one.axis.any() and two.axis.any():
                there = start.rotation @ two.axis
                normals = (
                    _perpendicular(one.point - joint.point, joint.axis, one.axis),
                    _perpendicular(here, joint.axis, there),
                )
                angles.append(self._angle(joint.axis, *normals, self.size))
        for angle in angles:
            if angle is None:
                continue
            turned = about_line(joint.axis, joint.point, angle) @ start
            yield turned
            if self._has_mass:  # both frames may be elsewhere along the axis
                center = turned.position + turned.rotation @ self.second.center
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
        if self._joint and self._joint[0].kind in LOCATED:
            one.append(self._joint[0].point)
            two.append(self._joint[1].point)
        axes = [(a.axis, b.axis) for a, b in self._likely if a.axis.any() and b.axis.any()]
        if len(one) > 1:
            yield fitted(np.array(one), np.array(two), axes=())
            yield fitted(np.array(one), np.array(two), axes=axes)

    def _angle(self, axis: Array, first: Array, second: Array, scale: float) -> float | None:
        """Return the angle about an axis from a vector to another one; None if one is along the axis."""
        one, two = first - (first @ axis) * axis, second - (second @ axis) * axis
        if min(_norm(one), _norm(two)) < SEPARATE * scale:
            return None
        return math.atan2(float(axis @ np.cross(two, one)), float(one @ two))


def line_value(one: Link, two: Link, motion: Placement, size: float) -> float:
    """Return how many numbers of two joints are equal if the second one is moved: direction and place."""
    if one.kind != two.kind or one.kind in (None, JointKind.FREE):
        return 0.0
    found = 0.0
    point = motion.position + motion.rotation @ two.point - one.point
    if one.axis.any():
        found += agreement(_norm(one.axis - _signed(motion.rotation @ two.axis, one.axis)))
    if one.kind in LOCATED:
        found += agreement(_norm(point - (point @ one.axis) * one.axis) / size)
    return found + POINT_WEIGHT * agreement(_norm(point) / size)


def _largest(one: Link, two: Link) -> float:
    """Return the value of `line_value` if all numbers are equal; a point on the axis may differ."""
    if one.kind != two.kind or one.kind in (None, JointKind.FREE):
        return 0.0
    return float(one.axis.any()) + (one.kind in LOCATED)


def principal_rotations(first: Array, second: Array) -> list[Array]:
    """Return the four rotations that take the principal axes of an inertia to those of another one."""
    one, two = np.linalg.eigh(first)[1], np.linalg.eigh(second)[1]
    found = []
    for x, y in ((1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)):
        turn = (one * np.array([x, y, 1.0])) @ two.T
        if np.linalg.det(turn) < 0:
            turn = (one * np.array([x, y, -1.0])) @ two.T
        found.append(turn)
    return found


def about_line(axis: Array, point: Array, angle: float) -> Placement:
    """Return the motion that turns by an angle, rad, about a line of direction (3,) through a point (3,)."""
    rotation = rotation_about(axis, angle)
    return Placement(point - rotation @ point, rotation)


def rotation_about(axis: Array, angle: float) -> Array:
    """Return the rotation matrix about a unit vector (3,) by an angle, rad (Rodrigues)."""
    x, y, z = axis
    skew = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + math.sin(angle) * skew + (1.0 - math.cos(angle)) * (skew @ skew)


def rotation_between(first: Array, second: Array) -> Array:
    """Return the smallest rotation that takes a unit vector (3,) to another one."""
    normal = np.cross(first, second)
    sine, cosine = _norm(normal), float(first @ second)
    if sine < 1e-12:  # round-off: parallel
        if cosine > 0:
            return np.eye(3)
        normal = np.cross(first, np.eye(3)[int(np.argmin(abs(first)))])
        return rotation_about(normal / _norm(normal), math.pi)
    return rotation_about(normal / sine, math.atan2(sine, cosine))


def fitted(first: Array, second: Array, axes: Sequence[tuple[Array, Array]]) -> Placement:
    """Return the motion that takes points (n, 3) to others with the smallest squares of distances (Kabsch).

    Args:
        first, second: the points of the first robot, and those of the second, which move.
        axes: pairs of directions, each of which counts like one more point at the mean distance.
    """
    one, two = first.mean(axis=0), second.mean(axis=0)
    covariance = (first - one).T @ (second - two)
    weight = float(np.trace((first - one).T @ (first - one))) / len(first)
    for direction, other in axes:
        covariance = covariance + weight * np.outer(direction, other)
    left, _, right = np.linalg.svd(covariance)
    flip = np.array([1.0, 1.0, np.sign(np.linalg.det(left @ right))])
    rotation = (left * flip) @ right
    return Placement(one - rotation @ two, rotation)


def _perpendicular(arm: Array, axis: Array, other: Array) -> Array:
    """Return the vector from an axis to another one along their common normal.

    Args:
        arm: (3,) m, from a point of the axis to a point of the other one.
        axis, other: (3,) directions.
    """
    normal = np.cross(axis, other)
    length = _norm(normal)
    if length < SEPARATE:
        return arm - (arm @ axis) * axis
    return normal * (float(arm @ normal) / length**2)


def _signed(axis: Array, like: Array) -> Array:
    """Return a direction or its opposite, whichever is nearer to another direction."""
    return axis if float(axis @ like) >= 0 else -axis


def _norm(vector: Array) -> float:
    return math.sqrt(float(vector @ vector))
