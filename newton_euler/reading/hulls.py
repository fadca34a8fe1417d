"""Convex hulls of the shapes of a body, which limit where its mass can be.

The readers of model files give points of shapes, such as the vertices of meshes. A hull also exists where a
mesh is not closed or where a body has several shapes that overlap.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from newton_euler.model.geometry import Mesh
from newton_euler.scalars import Array


@dataclass(frozen=True, eq=False)
class Hull:
    """Convex hull of points.

    Attributes:
        volume: m^3.
        center: (3,) m, center of mass of the homogeneous solid.
        gyration: m, radius of gyration of the homogeneous solid: root mean square distance from its center.
        low, high: (3,) m, corners of the box around the points.
    """

    volume: float
    center: Array
    gyration: float
    low: Array
    high: Array


def convex_hull(points: Array) -> Hull | None:
    """Return the convex hull of points (n, 3), m; None for points in one plane."""
    from scipy.spatial import ConvexHull, QhullError

    try:
        found = ConvexHull(points)
    except (QhullError, ValueError):
        return None
    # corners of each triangle counterclockwise, as seen from outside
    corners = points[found.simplices]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    is_reversed = np.einsum("ni,ni->n", normals, found.equations[:, :3]) < 0.0
    triangles = np.where(is_reversed[:, None], found.simplices[:, ::-1], found.simplices)
    solid = Mesh(points, triangles).inertia(1.0)
    # the trace of the inertia is twice the sum of m r^2
    gyration = float(np.sqrt(0.5 * np.trace(solid.inertia) / solid.mass))
    return Hull(solid.mass, solid.center_of_mass, gyration, points.min(axis=0), points.max(axis=0))


def box_points(half_sizes: Array) -> Array:
    """Return the corners (8, 3) of a box with half of its sides (3,), m, around the origin."""
    return np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * half_sizes


def ellipsoid_points(semi_axes: Array) -> Array:
    """Return points (n, 3) of an ellipsoid with semi-axes (3,), m, or of a ball, around the origin."""
    heights = np.sin(np.linspace(-0.5 * np.pi, 0.5 * np.pi, 18))
    circles = [np.sqrt(1.0 - z**2) * _circle() + [0.0, 0.0, z] for z in heights]
    return np.concatenate(circles) * semi_axes


def rim_points(start: Array, end: Array, radius: float) -> Array:
    """Return points (n, 3) of the rims of a cylinder between two points (3,); lengths in m."""
    axis = (end - start) / np.linalg.norm(end - start)
    # two directions across the axis: the rows of the singular vectors that the axis has no part in
    across = np.linalg.svd(axis[None])[2][1:]
    circle = radius * _circle()[:, :2] @ across
    return np.concatenate([start + circle, end + circle])


def capsule_points(radius: float, half_length: float) -> Array:
    """Return points (n, 3) of a capsule along z, the centers of whose ends are at -`half_length` and +, m."""
    ball = ellipsoid_points(np.full(3, radius))
    return np.concatenate([ball + np.array([0.0, 0.0, z]) for z in (-half_length, half_length)])


def _circle() -> Array:
    """Return points (36, 3) of the unit circle in the plane z = 0."""
    angles = np.linspace(0.0, 2.0 * np.pi, 36, endpoint=False)
    return np.column_stack([np.cos(angles), np.sin(angles), np.zeros(36)])
