"""Joints of two paths of links that play the same role, and how their coordinates differ.

In: links of two robots between two pairs of links, and the motions that make the links coincide. Out: pairs
of joints, and the sense and the offset of the second robot's coordinate.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from crosscheck.differences.links import Link
from newton_euler.reading.robot import JointKind, Placement
from newton_euler.scalars import Array

ROUND_OFF = 1e-12
"""Offset of a coordinate, rad or m, that rotation matrices cannot tell from zero."""


@dataclass(frozen=True)
class MatchedJoint:
    """Two joints that play the same role.

    Attributes:
        first, second: indices of the links whose joints they are.
        sense, offset: as in `crosscheck.differences.alignment.JointPair`.
    """

    first: int
    second: int
    sense: int
    offset: float


def joints_in_order(
    first: Sequence[Link], second: Sequence[Link], value: Callable[[Link, Link], float], *, keep_all: bool
) -> list[tuple[int, int]]:
    """Pair joints of two paths in the order of the paths; return pairs of positions.

    Args:
        first, second: links whose joints they are, from the parent outwards.
        value: value of a pair of joints; joints without a pair of positive value stay alone.
        keep_all: whether joints of the same kinds in the same order are paired whatever their value.
    """
    if keep_all and [k.kind for k in first] == [k.kind for k in second]:
        return [(k, k) for k in range(len(first))]
    # longest common subsequence of both paths from each position on, with values instead of lengths
    best: dict[tuple[int, int], tuple[float, list[tuple[int, int]]]] = {}
    for i in range(len(first), -1, -1):
        for k in range(len(second), -1, -1):
            options = [(0.0, list[tuple[int, int]]())]
            if i < len(first):
                options.append(best[i + 1, k])
            if k < len(second):
                options.append(best[i, k + 1])
            if i < len(first) and k < len(second):
                following, pairs = best[i + 1, k + 1]
                options.append((value(first[i], second[k]) + following, [(i, k), *pairs]))
            best[i, k] = max(options, key=lambda option: option[0])
    return best[0, 0][1]


def matched_joint(one: Link, two: Link, above: Placement, own: Placement) -> MatchedJoint:
    """Return a pair of joints with the sense and the offset of their coordinates.

    Args:
        one, two: links whose joints they are.
        above: motion that takes the second robot's parent link to its partner, in the poses of the files.
        own: motion that takes the second robot's link to its partner; it differs from the motion of the
            parent by the motion of the joint between the two poses.
    """
    assert one.joint is not None
    assert two.joint is not None
    both = (own.rotation + above.rotation) @ two.axis
    sense = -1 if float(one.axis @ both) < -1e-6 else 1  # below: perpendicular to the digits of files
    moved = own @ above.inverse()
    shift = 0.0
    if one.kind is JointKind.HINGE:
        shift = _angle_about(one.axis, moved.rotation)
    elif one.kind is JointKind.SLIDE:
        spot = above.point(two.point)
        shift = float(one.axis @ (moved.point(spot) - spot))
    offset = two.joint.zero - sense * one.joint.zero + sense * shift
    return MatchedJoint(one.index, two.index, sense, offset if abs(offset) > ROUND_OFF else 0.0)


def _angle_about(axis: Array, rotation: Array) -> float:
    """Return the angle, rad, of the rotation about a unit vector (3,) that is nearest to a matrix (3, 3)."""
    x, y, z = axis
    sine = (
        x * (rotation[2, 1] - rotation[1, 2])
        + y * (rotation[0, 2] - rotation[2, 0])
        + z * (rotation[1, 0] - rotation[0, 1])
    )
    cosine = float(np.trace(rotation)) - float(axis @ rotation @ axis)
    return math.atan2(float(sine), cosine)
