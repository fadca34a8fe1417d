"""Rigid motions that bring points, directions or principal axes of inertia together.

`registration.py` tries the motions to make a link of one robot coincide with its partner in another robot.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from crosscheck.differences.vectors import rotation_matrix
from newton_euler.reading.robot import Placement
from newton_euler.scalars import Array

MIN_ANGLE = 1e-3
"""Smallest sine of the angle of two axes whose common normal is computed, above the digits of files."""


def length(vector: Array) -> float:
    """Return the length of a vector; faster than `numpy.linalg.norm` for a single one."""
    return math.sqrt(float(vector @ vector))


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
    rotation = rotation_matrix(angle * axis)
    return Placement(point - rotation @ point, rotation)


def rotation_between(first: Array, second: Array) -> Array:
    """Return the smallest rotation that takes a unit vector (3,) to another one."""
    normal = np.cross(first, second)
    sine, cosine = length(normal), float(first @ second)
    if sine < 1e-12:  # round-off: parallel
        if cosine > 0:
            return np.eye(3)
        normal = np.cross(first, np.eye(3)[int(np.argmin(abs(first)))])
        return rotation_matrix(math.pi / length(normal) * normal)
    return rotation_matrix(math.atan2(sine, cosine) / sine * normal)


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


def common_normal(arm: Array, axis: Array, other: Array) -> Array:
    """Return the vector from an axis to another one along their common normal.

    Args:
        arm: (3,) m, from a point of the axis to a point of the other one.
        axis, other: (3,) directions.
    """
    normal = np.cross(axis, other)
    sine = length(normal)
    if sine < MIN_ANGLE:
        return arm - (arm @ axis) * axis
    return normal * (float(arm @ normal) / sine**2)
