"""Points of the shapes of links of a URDF, whose convex hulls tell where the mass of a link can be."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from newton_euler.model.euler_parameters import rotation
from newton_euler.model.geometry import Box, Cylinder, Mesh, Shape, Sphere
from newton_euler.model.source_file import read_xml
from newton_euler.reading.hulls import box_points, ellipsoid_points, rim_points
from newton_euler.scalars import Array
from urdf.reading.source import SourceError, parsed
from urdf.reading.visuals import link_shapes


def shape_points(path: str, bodies: Collection[str]) -> dict[str, Array]:
    """Return points (n, 3), m, of the shapes of links, in the frame of each link; none of missing meshes.

    Only the meshes of these links are read.

    Args:
        path: path of the file.
        bodies: names of the links.

    Raises:
        SourceError: for a file that cannot be read.
    """
    root = parsed(path, read_xml(path, SourceError))
    shapes = link_shapes(path, root, bodies)
    return {name: np.concatenate([*map(_points, those)]) for name, those in shapes.items() if those}


def _points(shape: Shape | Mesh) -> Array:
    """Return points (n, 3) of a shape: corners, or points of a round surface."""
    match shape:
        case Mesh():
            return np.array(shape.vertices)
        case Box():
            matrix = rotation(np.asarray(shape.quaternion))
            return shape.center + box_points(np.asarray(shape.half_sizes)) @ matrix.T
        case Sphere():
            return shape.center + ellipsoid_points(np.full(3, shape.radius))
        case Cylinder():
            return rim_points(np.asarray(shape.start), np.asarray(shape.end), shape.radius)
    raise AssertionError(shape)  # a URDF has no other shapes
