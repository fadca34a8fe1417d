"""Geoms that MuJoCo's own viewer shows: which they are, and the meshes among them."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import mujoco
import numpy as np

from newton_euler.model.geometry import Mesh
from newton_euler.scalars import Array

FIRST_HIDDEN_GROUP = 3
"""Geom groups from here on are not shown at first; models keep shapes for collisions there."""

UNSET_COLOR = (0.5, 0.5, 0.5, 1.0)
"""What a geom has whose color is that of its material."""


def visible_geoms(model: Any, bodies: Array) -> Iterator[int]:
    """The geoms of some of MuJoCo's bodies that can be seen."""
    for geom in np.flatnonzero(np.isin(model.geom_bodyid, bodies)):
        if model.geom_group[geom] < FIRST_HIDDEN_GROUP and _color(model, int(geom))[3] > 0.0:
            yield int(geom)


def meshes(model: Any, data: Any, bodies: Array) -> tuple[Mesh, ...]:
    """The meshes that some of MuJoCo's bodies show, in the world where `data` has them."""
    found = []
    for geom in visible_geoms(model, bodies):
        if model.geom_type[geom] != mujoco.mjtGeom.mjGEOM_MESH:
            continue
        mesh = model.mesh(model.geom_dataid[geom])
        points = model.mesh_vert[mesh.vertadr[0] : mesh.vertadr[0] + mesh.vertnum[0]]
        triangles = model.mesh_face[mesh.faceadr[0] : mesh.faceadr[0] + mesh.facenum[0]]
        vertices = data.geom_xpos[geom] + points @ data.geom_xmat[geom].reshape(3, 3).T
        found.append(Mesh(vertices, triangles, _color(model, geom)))
    return tuple(found)


def _color(model: Any, geom: int) -> tuple[float, float, float, float]:
    """Of the geom, or of its material if it has none of its own."""
    material, color = model.geom_matid[geom], model.geom_rgba[geom]
    if material >= 0 and np.allclose(color, UNSET_COLOR):
        color = model.mat_rgba[material]
    red, green, blue, opacity = np.clip(color, 0.0, 1.0).tolist()
    return red, green, blue, opacity
