"""Points of the shapes of bodies of an MJCF file, whose convex hulls tell where the mass of a body can be."""

from __future__ import annotations

from collections.abc import Collection
from contextlib import suppress

import mujoco
import numpy as np

from mjcf.errors import collected_warnings
from mjcf.placements import rotation_of
from mjcf.reading.essentials import essential_texts
from mjcf.reading.xml_scan import read_texts
from mjcf.robot import compiled
from newton_euler.reading.hulls import box_points, capsule_points, ellipsoid_points, rim_points
from newton_euler.scalars import Array


def shape_points(path: str, bodies: Collection[str]) -> dict[str, Array]:
    """Return points (n, 3), m, of the shapes of bodies, in the frame of each body; none of missing meshes.

    Only the meshes of these bodies are read.

    Args:
        path: path of the file.
        bodies: names of the bodies.

    Raises:
        SourceError: for a file that cannot be read.
    """
    texts = essential_texts(read_texts(path), shapes_of=frozenset(bodies)).texts
    found: dict[str, list[Array]] = {name: [] for name in bodies}
    with collected_warnings(), suppress(ValueError, mujoco.FatalError):  # for example of a broken mesh file
        model = compiled(texts, is_variant=True)
        for geom in range(model.ngeom):
            name = model.body(model.geom_bodyid[geom]).name
            points = _points(model, geom)
            if name in found and len(points):
                found[name].append(model.geom_pos[geom] + points @ rotation_of(model.geom_quat[geom]).T)
    return {name: np.concatenate(parts) for name, parts in found.items() if parts}


def _points(model: mujoco.MjModel, geom: int) -> Array:
    """Return points (n, 3) of a geom in its own frame; none of planes and height fields."""
    kinds, size = mujoco.mjtGeom, model.geom_size[geom]
    match kinds(model.geom_type[geom]):
        case kinds.mjGEOM_MESH:
            mesh = model.mesh(model.geom_dataid[geom])
            return np.array(model.mesh_vert[mesh.vertadr[0] : mesh.vertadr[0] + mesh.vertnum[0]], dtype=float)
        case kinds.mjGEOM_BOX:
            return box_points(size)
        case kinds.mjGEOM_SPHERE:
            return ellipsoid_points(np.full(3, size[0]))
        case kinds.mjGEOM_ELLIPSOID:
            return ellipsoid_points(size)
        case kinds.mjGEOM_CAPSULE:
            return capsule_points(size[0], size[1])
        case kinds.mjGEOM_CYLINDER:
            return rim_points(np.array([0, 0, -size[1]]), np.array([0, 0, size[1]]), size[0])
    return np.zeros((0, 3))
