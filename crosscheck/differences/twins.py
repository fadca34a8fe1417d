"""Evidence by the other side of a robot: twins, such as `left_foot` and `right_foot`, are mirror images.

If both sides are alike in one file and not in the other, this speaks for the first of these files.
"""

from __future__ import annotations

import math
from collections.abc import Hashable, Iterator, Sequence
from typing import TypeVar

import numpy as np

from crosscheck.differences.alignment import Alignment
from crosscheck.differences.difference import Difference, Evidence, Quantity, Side
from crosscheck.differences.element_names import words_of
from crosscheck.differences.links import composite, placed_masses
from newton_euler.reading.robot import Placement, Robot
from newton_euler.scalars import Array

MAX_GAP = 0.1
"""Largest difference of twins in the file that evidence speaks for, relative to that in the other file."""

GAPS = (0.5, 2.0)
"""Difference of twins in the other file, as a fraction of the difference of both files, that counts."""

BODY_QUANTITIES = (Quantity.MASS, Quantity.CENTER, Quantity.INERTIA, Quantity.INERTIA_AXES)
"""Quantities of a body that are those of a mirror image on the other side of a robot."""

JOINT_FIELDS = {
    Quantity.DAMPING: "damping",
    Quantity.ARMATURE: "armature",
    Quantity.FRICTION: "friction",
    Quantity.STIFFNESS: "stiffness",
    Quantity.EFFORT: "effort",
    Quantity.SPEED: "speed",
    Quantity.LIMITS: "limits",
}
"""Numbers of a joint that are equal on both sides of a robot, with the names of their fields."""


Key = TypeVar("Key", bound=Hashable)


class Twins:
    """Bodies and joints on the left and on the right side of two robots, by the words of their names."""

    def __init__(self, robots: tuple[Robot, Robot], alignment: Alignment) -> None:
        """Find the twins, and the plane between both sides in the pose of each file."""
        self._robots = robots
        self._partner = {pair.first: pair.second for pair in alignment.joints}
        self._frames = robots[0].placements(), robots[1].placements()
        self._twin_bodies = [
            _twins({k: body.name for k, body in enumerate(robot.bodies)}) for robot in robots
        ]
        self._twin_joints = [
            _twins(
                {
                    (k, j): joint.name
                    for k, body in enumerate(robot.bodies)
                    for j, joint in enumerate(body.joints)
                }
            )
            for robot in robots
        ]
        self._mirrors = [self._mirror(side) for side in (0, 1)]

    def evidence(
        self, row: Difference, bodies: tuple[tuple[int, ...], tuple[int, ...]] | None
    ) -> Iterator[Evidence]:
        """Yield evidence on a true difference.

        Args:
            row: the difference.
            bodies: indices of the bodies that the row is about, in each robot; None for another element.
        """
        if bodies is not None and row.quantity in BODY_QUANTITIES:
            found = self._bodies(row, bodies)
        elif row.element_kind == "joint" and row.quantity in JOINT_FIELDS:
            found = self._joints(row)
        else:
            return
        if found is None:
            return
        other_name, between, gaps = found
        sides = Side.FIRST, Side.SECOND
        for side, gap, other_gap in zip(sides, gaps, gaps[::-1], strict=True):
            is_asymmetric = 0.0 < GAPS[0] * between < other_gap < GAPS[1] * between
            if is_asymmetric and gap <= MAX_GAP * other_gap:
                both = f"{row.element} and {other_name}"
                yield Evidence(side, f"{both} are alike in this file, and not in the other")

    def _bodies(
        self, row: Difference, bodies: tuple[tuple[int, ...], tuple[int, ...]]
    ) -> tuple[str, float, list[float]] | None:
        """Return the name of a twin body, the difference of the files, and that of the twins in each file."""
        gaps, measures = [], []
        for side, own in enumerate(bodies):
            twins = tuple(self._twin_bodies[side].get(k, -1) for k in own)
            if min(twins) < 0:
                return None
            measure, other = self._measure(row.quantity, side, own), self._measure(row.quantity, side, twins)
            mirror = self._mirrors[side]
            if row.quantity is Quantity.CENTER:
                other = mirror @ other
            elif row.quantity is Quantity.INERTIA_AXES:
                other = mirror @ other @ mirror
            measures.append(measure)
            gaps.append(float(np.linalg.norm(measure - other)))
        between = float(np.linalg.norm(measures[0] - measures[1]))
        if row.quantity is Quantity.CENTER:
            between = row.size
        elif row.quantity is Quantity.INERTIA_AXES:
            # estimate of the change by a turn about a principal axis, which is the largest from 45 degrees on
            between = (
                float(np.ptp(np.linalg.eigvalsh(measures[0]))) * min(1.0, 2.0 * row.size) / math.sqrt(2.0)
            )
        names = self._robots[0].bodies
        return names[self._twin_bodies[0][bodies[0][0]]].name, between, gaps

    def _measure(self, quantity: Quantity, side: int, bodies: tuple[int, ...]) -> Array:
        """Return a number of bodies that are fixed to each other, along the axes of the world.

        That is the mass, the principal moments, the inertia (3, 3) for its axes, or the center of mass from
        the joint.
        """
        robot, frames = self._robots[side], self._frames[side]
        parts = placed_masses(robot, bodies, frames)
        mass, center, inertia = composite(parts, parts[0][1])
        match quantity:
            case Quantity.MASS:
                return np.array([mass])
            case Quantity.INERTIA:
                return np.asarray(np.linalg.eigvalsh(inertia))
            case Quantity.INERTIA_AXES:
                return inertia
        return center - _point(robot, frames, bodies[0])

    def _joints(self, row: Difference) -> tuple[str, float, list[float]] | None:
        """Return the name of a twin joint, the difference of the files, and those of the twins."""
        first = self._robots[0]
        keys = [key for key in self._partner if first.joint(key).name == row.element]
        if not keys:
            return None
        gaps, measures = [], []
        for side, key in enumerate((keys[0], self._partner[keys[0]])):
            twin = self._twin_joints[side].get(key)
            if twin is None:
                return None
            own, other = (
                np.atleast_1d(np.array(getattr(self._robots[side].joint(each), JOINT_FIELDS[row.quantity])))
                for each in (key, twin)
            )
            # a file without such a number has it nowhere
            if not np.isfinite([own, other]).all() or not own.any():
                return None
            # limits are equal, or mirrored if the axes are
            is_range = row.quantity in (Quantity.LIMITS, Quantity.EFFORT)
            versions = [other, -other[::-1]] if is_range else [other]
            measures.append(own)
            gaps.append(min(float(np.linalg.norm(own - version)) for version in versions))
        name = first.joint(self._twin_joints[0][keys[0]]).name
        between = (
            row.size if row.quantity is Quantity.LIMITS else float(np.linalg.norm(measures[0] - measures[1]))
        )
        return name, between, gaps

    def _mirror(self, side: int) -> Array:
        """Return the reflection (3, 3) along the axis of the world on which twins are apart."""
        robot, frames = self._robots[side], self._frames[side]
        apart = [
            np.abs(_point(robot, frames, k) - _point(robot, frames, twin))
            for k, twin in self._twin_bodies[side].items()
        ]
        normal = int(np.argmax(np.sum(apart, axis=0))) if apart else 0
        return np.diag(np.where(np.arange(3) == normal, -1.0, 1.0))


def _twins(names: dict[Key, str]) -> dict[Key, Key]:
    """Return the key of the only element with the same words for the other side, by the key of an element."""
    by_words: dict[frozenset[str], list[Key]] = {}
    for key, name in names.items():
        by_words.setdefault(words_of(name), []).append(key)
    both = frozenset({"left", "right"})
    found = {}
    for words, keys in by_words.items():
        others = by_words.get(words ^ both, []) if len(words & both) == 1 else []
        if len(keys) == len(others) == 1:
            found[keys[0]] = others[0]
    return found


def _point(robot: Robot, frames: Sequence[Placement], body: int) -> Array:
    """Return a point (3,) of a body's joint in the world, or the origin of a fixed body's frame."""
    return frames[body].point(robot.bodies[body].joint_point)
