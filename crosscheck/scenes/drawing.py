"""Meshes for viewers: what turns about an axis, arrows, and tiles."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np

from newton_euler.model.geometry import Mesh
from newton_euler.model.joint import perpendicular_pair
from newton_euler.scalars import Array

SIDES = 32
"""Of what stands for something round."""

Color = tuple[float, float, float, float]


def revolved(
    profile: Sequence[tuple[float, float]],
    base: Array,
    axis: Array,
    color: Color | None = None,
    label: str = "",
) -> Mesh:
    """Make a surface of revolution, sharp at the corners of its profile.

    Args:
        profile: radii and heights above the base, m, from the top down; radius 0 at both ends closes it.
        base: (3,) a point of the axis, m.
        axis: (3,) unit vector.
        label: shown at the top.
    """
    angles = np.linspace(0.0, 2.0 * np.pi, SIDES, endpoint=False)
    x, y = perpendicular_pair(axis)
    around = np.outer(np.cos(angles), x) + np.outer(np.sin(angles), y)
    here = np.arange(SIDES)
    there = np.roll(here, -1)
    vertices, triangles = [], []
    for number, ends in enumerate(itertools.pairwise(profile)):
        vertices += [base + height * axis + radius * around for radius, height in ends]
        upper = 2 * SIDES * number
        lower = upper + SIDES
        triangles += [
            np.column_stack([lower + here, lower + there, upper + there]),
            np.column_stack([lower + here, upper + there, upper + here]),
        ]
    return Mesh(np.concatenate(vertices), np.concatenate(triangles), color, label)


def disc(radius: float, thickness: float, center: Array, axis: Array) -> Mesh:
    """Make a disc across a unit vector (3,)."""
    half = 0.5 * thickness
    return revolved([(0.0, half), (radius, half), (radius, -half), (0.0, -half)], center, axis)


def arrow(start: Array, direction: Array, length: float, color: Color, label: str) -> Mesh:
    """Make an arrow along a unit vector (3,), with its label at the tip."""
    radius, head = 0.02 * length, 0.8 * length
    profile = [(0.0, length), (3.0 * radius, head), (radius, head), (radius, 0.0), (0.0, 0.0)]
    return revolved(profile, start, direction, color, label)


def tiles(
    half_sizes: tuple[float, float], counts: tuple[int, int], center: Array, rotation: Array, color: Color
) -> Mesh:
    """Make squares in rows and columns, a tenth of their width apart, across the third axis of a rotation."""
    x, y = (
        half * ((2.0 * np.arange(count)[:, None] + 1.0 + np.array([-0.9, 0.9])) / count - 1.0)
        for half, count in zip(half_sizes, counts, strict=True)
    )
    flat = [
        [x[i, a], y[j, b], 0.0]
        for i in range(counts[0])
        for j in range(counts[1])
        for a, b in ((0, 0), (1, 0), (1, 1), (0, 1))
    ]
    first = 4 * np.arange(counts[0] * counts[1])[:, None]
    triangles = np.concatenate([first + corner for corner in ([0, 1, 2], [0, 2, 3])])
    return Mesh(center + np.array(flat) @ rotation.T, triangles, color)
