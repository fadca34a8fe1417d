"""Numbers of a robot file as arrays: the robot as written first and its variants after it; their distances.

The variants are the robot with its numbers changed within the digits of the file. The first axis of every
array, of length V, counts the robot and its variants, so that one evaluation serves all of them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from crosscheck.differences.vectors import apply, rotation_matrix
from newton_euler.reading.robot import JointKind, Placement, RobotFile
from newton_euler.scalars import Array

JointKey = tuple[int, int]
"""Index of a body in `Robot.bodies` and index of a joint in `FileBody.joints`."""

ROUND_OFF = 1e-11
"""Relative difference of equal numbers that were computed in two ways; also rad."""


def dot(first: Array, second: Array) -> Array:
    """Return the scalar products (V,) of two stacks of vectors (V, n)."""
    product: Array = (first * second).sum(axis=-1)
    return product


class Poses(NamedTuple):
    """Stack of placements of one frame in another, for a robot and its variants.

    Attributes:
        rotation: (V, 3, 3).
        position: (V, 3) m.
    """

    rotation: Array
    position: Array

    def __matmul__(self, inner: Poses) -> Poses:
        """Return where a frame inside this frame is in the other frame."""
        return Poses(self.rotation @ inner.rotation, self.point(inner.position))

    def inverse(self) -> Poses:
        """Return where the other frame is in this frame."""
        back = np.swapaxes(self.rotation, -1, -2)
        return Poses(back, -apply(back, self.position))

    def point(self, point: Array) -> Array:
        """Return points (V, 3) of this frame in the other frame."""
        return self.position + apply(self.rotation, point)

    @classmethod
    def of(cls, placements: Sequence[Placement]) -> Poses:
        """Return the stack of the placements of a robot and its variants."""
        return cls(
            np.array([each.rotation for each in placements]), np.array([each.position for each in placements])
        )

    @classmethod
    def constant(cls, placement: Placement) -> Poses:
        """Return a stack of one placement, which broadcasts against others."""
        return cls(np.asarray(placement.rotation)[None], np.asarray(placement.position)[None])


GROUND = Poses(np.eye(3)[None], np.zeros((1, 3)))
"""Frame of the world in itself."""


class Line(NamedTuple):
    """Axis of a joint: direction (V, 3), a unit vector, and a point (V, 3) m, in one frame."""

    axis: Array
    point: Array

    def seen_from(self, frame: Poses) -> Line:
        """Return the line in a frame that is given in the line's present frame."""
        inside = frame.inverse()
        return Line(apply(inside.rotation, self.axis), inside.point(self.point))

    def nearest(self, point: Array) -> Array:
        """Return the points (V, 3) of the line that are nearest to a point (3,)."""
        along = dot(point - self.point, self.axis)
        nearest: Array = self.point + along[..., None] * self.axis
        return nearest


class MassProperties(NamedTuple):
    """Mass (V,) kg, center of mass (V, 3) m and inertia (V, 3, 3) kg m^2 about it, in one frame."""

    mass: Array
    center: Array
    inertia: Array


class Side:
    """One of two robot files, in a pose that is common to both.

    Attributes:
        file: the robot and its variants.
        world: placement of every body in the world.
        lines: axis of every joint in the world.
    """

    def __init__(self, file: RobotFile, coordinates: Mapping[JointKey, float]) -> None:
        """Pose the robot and its variants.

        Args:
            file: the robot and its variants, which have equal bodies and joints.
            coordinates: coordinates of hinges and slides, rad or m; others stay as in the pose of the file.
        """
        self.file = file
        self._robots = file.robots
        self.world: list[Poses] = []
        self.lines: dict[JointKey, Line] = {}
        for index, body in enumerate(file.robot.bodies):
            bodies = [robot.bodies[index] for robot in self._robots]
            placement = Poses.of([each.placement for each in bodies])
            pose = (self.world[body.parent] if body.parent >= 0 else GROUND) @ placement
            for number, joint in enumerate(body.joints):
                axis = np.array([each.joints[number].axis for each in bodies])
                point = np.array([each.joints[number].point for each in bodies])
                self.lines[index, number] = Line(apply(pose.rotation, axis), pose.point(point))
                displacement = coordinates.get((index, number), joint.zero) - joint.zero
                if displacement:
                    pose = pose @ _moved(joint.kind, axis, point, displacement)
            self.world.append(pose)

    def number(self, key: JointKey, name: str) -> Array:
        """Return a number of a joint, (V,) or (V, k), by the name of its field."""
        body, joint = key
        return np.array([getattr(robot.bodies[body].joints[joint], name) for robot in self._robots])

    def loop_end(
        self, index: int, end: str, elements: Literal["loops", "springs"] = "loops"
    ) -> tuple[int, Poses]:
        """Return one end of a loop or a spring.

        Args:
            index: of the loop or spring.
            end: "first" or "second".
            elements: name of the elements in `Robot`.

        Returns:
            Index of the body, -1 for the ground, and its frame in the world.
        """
        body = int(getattr(getattr(self.file.robot, elements)[index], end))
        given = [getattr(getattr(robot, elements)[index], f"{end}_frame") for robot in self._robots]
        inside = Poses.of(given)
        return body, self.world[body] @ inside if body >= 0 else inside

    def mass_properties(self, bodies: tuple[int, ...], frame: Poses) -> MassProperties:
        """Return the mass properties of bodies that are fixed to each other, in a frame of the world."""
        masses, centers, inertias = [], [], []
        inside = frame.inverse()
        for index in bodies:
            parts = [robot.bodies[index] for robot in self._robots]
            pose = inside @ self.world[index]
            masses.append(np.array([part.mass for part in parts]))
            centers.append(pose.point(np.array([part.center for part in parts])))
            rotated = pose.rotation @ np.array([part.inertia for part in parts])
            inertias.append(rotated @ np.swapaxes(pose.rotation, -1, -2))
        mass = np.sum(masses, axis=0)
        if len(bodies) == 1 or not mass[0]:
            return MassProperties(mass, centers[0], np.sum(inertias, axis=0))
        center = sum(m[:, None] * c for m, c in zip(masses, centers, strict=True)) / mass[:, None]
        inertia = sum(
            own + about_other_point(m, c - center)
            for own, m, c in zip(inertias, masses, centers, strict=True)
        )
        return MassProperties(mass, center, np.asarray(inertia))


def about_other_point(mass: Array, offset: Array) -> Array:
    """Return the inertia (V, 3, 3) of point masses (V,) at offsets (V, 3)."""
    outer = offset[..., :, None] * offset[..., None, :]
    inertia: Array = mass[..., None, None] * (dot(offset, offset)[..., None, None] * np.eye(3) - outer)
    return inertia


def twist(reference: Array, rotations: Array, axis: Array) -> Array:
    """Return the turns (V,), rad, about an axis (3,) from a rotation (3, 3) to rotations (V, 3, 3).

    The axis is in the turned frame. A turn of the axis itself is left out. The first turn is from -pi to pi,
    and the others are within pi of it, so that variants of half a turn are near each other.
    """
    turns = reference.T @ rotations
    twice_sine = np.stack(
        [
            turns[:, 2, 1] - turns[:, 1, 2],
            turns[:, 0, 2] - turns[:, 2, 0],
            turns[:, 1, 0] - turns[:, 0, 1],
        ],
        axis=-1,
    )
    # Of the plane across the axis: trace 2 c cos(twist), antisymmetric part 2 c sin(twist), c > 0
    trace = np.trace(turns, axis1=1, axis2=2) - (turns @ axis) @ axis
    turns_about_axis = np.arctan2(twice_sine @ axis, trace)
    return turns_about_axis[0] + wrapped(turns_about_axis - turns_about_axis[0])


def wrapped(angle: Array) -> Array:
    """Return angles, rad, less the full turns nearest to them."""
    rest: Array = angle - 2.0 * math.pi * np.round(angle / (2.0 * math.pi))
    return rest


def _moved(kind: JointKind, axis: Array, point: Array, displacement: float) -> Poses:
    """Return the motion of a body by a joint whose coordinate changes, in the frame of the body."""
    if kind == JointKind.SLIDE:
        return Poses(np.broadcast_to(np.eye(3), (len(axis), 3, 3)), displacement * axis)
    rotation = rotation_matrix(displacement * axis)
    return Poses(rotation, point - apply(rotation, point))


Metric = Callable[[Array, Array], Array]
"""Distances (V,) of numbers (V, ...) from one reference (1, ...)."""


def relative(reference: Array, values: Array) -> Array:
    """Return the largest relative difference of numbers (V,) or (V, k); infinite and zero ones count 1."""
    finite = np.isfinite(reference) & np.isfinite(values) & (reference != 0.0)
    both = np.broadcast_to(finite, values.shape)
    change = np.where(both, values, 1.0) - np.where(finite, reference, 1.0)
    ratio = np.abs(change) / np.where(finite, np.abs(reference), 1.0)
    ratio = np.where(both, ratio, np.where(values == reference, 0.0, 1.0))
    largest: Array = ratio.reshape(len(ratio), -1).max(axis=1)
    return largest


def absolute(reference: Array, values: Array) -> Array:
    """Return the largest difference of numbers (V,) or (V, k); infinite against finite counts 1."""
    finite = np.isfinite(reference) & np.isfinite(values)
    change = np.where(finite, values, 1.0) - np.where(finite, reference, 0.0)
    change = np.where(finite, np.abs(change), np.where(values == reference, 0.0, 1.0))
    largest: Array = change.reshape(len(change), -1).max(axis=1)
    return largest


def distance(reference: Array, values: Array) -> Array:
    """Return the distances, m, of points (V, 3) from a point (1, 3)."""
    length: Array = np.linalg.norm(values - reference, axis=-1)
    return length


def angle(reference: Array, values: Array) -> Array:
    """Return the angles, rad, between vectors (V, 3) and a vector (1, 3)."""
    return np.arctan2(np.linalg.norm(np.cross(reference, values), axis=-1), dot(reference, values))


def turn_angle(reference: Array, values: Array) -> Array:
    """Return the angles (V,), rad, of the rotations from one matrix (1, 3, 3) to others (V, 3, 3)."""
    chord = np.linalg.norm(values - reference, axis=(-2, -1)) / math.sqrt(8.0)
    return np.asarray(2.0 * np.arcsin(np.minimum(chord, 1.0)))


def matrix_distance(reference: Array, values: Array) -> Array:
    """Return the norms of the differences of matrices (V, 3, 3) from a matrix, relative to its norm."""
    norm = np.linalg.norm(reference) or 1.0
    change: Array = np.linalg.norm(values - reference, axis=(-2, -1)) / norm
    return change


@dataclass(frozen=True)
class Judge:
    """Sizes of differences, and the part of them that the digits of the files leave open.

    Attributes:
        tolerance: relative difference that counts as none, instead of the digits of the files; None for
            the digits. For lengths it is multiplied with `length`.
        length: m, a length of the robot.
    """

    tolerance: float | None
    length: float

    def compare(self, first: Array, second: Array, metric: Metric, slack: float = 0.0) -> tuple[float, float]:
        """Return size and uncertainty of a difference.

        Args:
            first, second: (V, ...) numbers of both files.
            metric: distance of such numbers.
            slack: uncertainty beyond that of the numbers, such as that of a frame.
        """
        size = float(metric(first[:1], second[:1])[0])
        unit = self.length if metric is distance else 1.0
        if size <= ROUND_OFF * unit:
            return 0.0, 0.0
        if self.tolerance is not None:
            return size, self.tolerance * unit
        return size, self._spread(first, metric) + self._spread(second, metric) + slack + ROUND_OFF * unit

    @staticmethod
    def _spread(values: Array, metric: Metric) -> float:
        """Return twice the largest distance of the variants from the robot as written.

        The variants are a random sample, whose largest distance is below the largest possible one.
        """
        return 2.0 * float(metric(values[:1], values[1:]).max()) if len(values) > 1 else 0.0
