"""Find likely mistakes of MJCF files: inertias of meshes, and keyframes with too few numbers."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import mujoco
import numpy as np

from newton_euler.reading.import_report import Finding
from newton_euler.scalars import Array

MAX_MESH_DIFFERENCE = 0.05
"""Relative difference of moments per mass, or of volumes, above which an inertia is wrong."""

MAX_EQUAL_DIFFERENCE = 0.01
"""Relative difference of moments per mass below which two solids are the same."""

KEY_SIZES = {"qpos": "nq", "qvel": "nv", "act": "na", "ctrl": "nu"}
"""Fields of keyframes, and the attribute of the model with their size."""


class Solid(NamedTuple):
    """Volume, m^3, or area, m^2, of a mesh, and principal moments (3,) per mass, m^2, ascending."""

    volume: float
    moments: Array


def mesh_findings(model: Any) -> Iterator[Finding]:
    """Find bodies with the inertia of the hull or surface of their mesh, instead of the mesh."""
    for body in range(1, model.nbody):
        first, count = int(model.body_geomadr[body]), int(model.body_geomnum[body])
        geoms = [g for g in range(first, first + count) if model.geom_type[g] == mujoco.mjtGeom.mjGEOM_MESH]
        meshes = {int(model.geom_dataid[g]) for g in geoms}
        if len(meshes) != 1 or not model.body_mass[body] > 0.0:
            continue
        mesh = meshes.pop()
        points, triangles = _mesh(model, mesh)
        if not _is_closed(triangles):
            continue
        own = _solid(points[triangles], signed=True)
        found = np.sort(model.body_inertia[body]) / model.body_mass[body]
        difference = _difference(found, own.moments)
        if own.volume <= 0.0 or difference <= MAX_EQUAL_DIFFERENCE:
            continue
        name = model.body(body).name or str(body)
        # the wrong solid with the moments of the body
        for what, other in _alternative_solids(points, triangles, _hull(model, mesh)):
            ratio = 1.0 if what == "surface" else other.volume / own.volume
            is_far = max(difference, abs(ratio - 1.0)) > MAX_MESH_DIFFERENCE
            if is_far and _difference(found, other.moments) <= MAX_EQUAL_DIFFERENCE:
                most = int(np.argmax(np.abs(found / own.moments - 1.0)))
                percent = 100.0 * (found[most] / own.moments[most] - 1.0)
                more = (
                    ""
                    if what == "surface"
                    else f", and the volume is {other.volume / own.volume:.3g} times its"
                )
                yield Finding(
                    "mesh-inertia",
                    f"body {name!r}",
                    f"its inertia is that of its mesh's {what}: a principal moment by mass is "
                    f"{percent:+.0f} % different from the mesh itself{more}",
                    "mass and inertia from density belong to another shape",
                    'set inertia="exact" in the <mesh>, or give the body an <inertial>',
                )
                break


def _mesh(model: Any, number: int) -> tuple[Array, Array]:
    """Return points (n, 3) and triangles (m, 3) of a mesh, with each point once."""
    mesh = model.mesh(number)
    points = model.mesh_vert[mesh.vertadr[0] : mesh.vertadr[0] + mesh.vertnum[0]].astype(float)
    triangles = model.mesh_face[mesh.faceadr[0] : mesh.faceadr[0] + mesh.facenum[0]].astype(int)
    # a mesh may repeat points of several triangles
    _, first, same = np.unique(points, axis=0, return_index=True, return_inverse=True)
    return points[first], np.reshape(same, -1)[triangles]


def _is_closed(triangles: Array) -> bool:
    """True if each edge belongs to two triangles that run along it in opposite directions."""
    begin, end = triangles, np.roll(triangles, -1, axis=1)
    count = triangles.max(initial=0) + 1
    forward, backward = (np.sort(edges, axis=None) for edges in (begin * count + end, end * count + begin))
    return bool(np.all(forward[1:] != forward[:-1])) and np.array_equal(forward, backward)


def _solid(corners: Array, signed: bool) -> Solid:
    """Return the solid inside triangles (m, 3, 3), by signed or unsigned tetrahedra from their center."""
    edges = corners[:, 1:] - corners[:, :1]
    areas = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1)
    corners = corners - areas @ corners.mean(axis=1) / max(float(areas.sum()), 1e-300)
    volumes = np.linalg.det(corners) / 6.0
    if not signed:
        volumes = np.abs(volumes)
    sums = corners.sum(axis=1)
    seconds = np.einsum("kni,knj->kij", corners, corners) + np.einsum("ki,kj->kij", sums, sums)
    return _reduced(volumes, sums / 4.0, seconds / 20.0)


def _surface(corners: Array) -> Solid:
    """Return the shell of triangles (m, 3, 3) with constant mass per area."""
    edges = corners[:, 1:] - corners[:, :1]
    areas = 0.5 * np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1)
    sums = corners.sum(axis=1)
    seconds = np.einsum("kni,knj->kij", corners, corners) + np.einsum("ki,kj->kij", sums, sums)
    return _reduced(areas, sums / 3.0, seconds / 12.0)


def _reduced(weights: Array, centers: Array, seconds: Array) -> Solid:
    """Add parts with weights (m,), centers (m, 3) and second moments (m, 3, 3) to a solid."""
    whole = float(weights.sum())
    if not abs(whole) > 0.0:
        return Solid(0.0, np.ones(3))
    center = weights @ centers / whole
    second = np.einsum("k,kij->ij", weights, seconds) / whole - np.outer(center, center)
    return Solid(whole, np.linalg.eigvalsh(np.trace(second) * np.eye(3) - second))


def _hull(model: Any, number: int) -> Array:
    """Return the corners (m, 3, 3) of the triangles of a mesh's convex hull, empty if MuJoCo has no hull.

    MuJoCo computes the hull for collisions and for inertias of the hull. Its `mesh_graph` has the numbers of
    points and triangles, three arrays of points and edges, and the triangles.
    """
    start = int(model.mesh_graphadr[number])
    if start < 0:
        return np.zeros((0, 3, 3))
    count, faces = model.mesh_graph[start : start + 2].tolist()
    triangles = model.mesh_graph[start + 2 + 3 * (count + faces) :][: 3 * faces].reshape(-1, 3)
    points = model.mesh_vert[model.mesh_vertadr[number] :].astype(float)
    return np.asarray(points[triangles])


def _alternative_solids(points: Array, triangles: Array, hull: Array) -> Iterator[tuple[str, Solid]]:
    """Yield the solids of MuJoCo's other methods for the inertia of a mesh."""
    yield "volume without signs (legacy)", _solid(points[triangles], signed=False)
    yield "surface", _surface(points[triangles])
    if len(hull):
        yield "convex hull", _solid(hull, signed=False)


def _difference(one: Array, two: Array) -> float:
    return float(np.max(np.abs(one - two)) / max(float(np.max(np.abs(two))), 1e-300))


def key_findings(model: Any, sizes: Mapping[int, Mapping[str, int]]) -> Iterator[Finding]:
    """Find keyframes with fewer numbers than the model needs; MuJoCo sets the others to zero.

    Args:
        model: compiled model.
        sizes: by number of the keyframe, numbers of values of its fields in the file.
    """
    for key, fields in sizes.items():
        for name, needed in KEY_SIZES.items():
            count, wanted = fields.get(name), int(getattr(model, needed))
            if count is not None and count < wanted:
                label = model.key(key).name or str(key)
                yield Finding(
                    "short-keyframe",
                    f"keyframe {label!r}",
                    f"{name} has {count} numbers, the model {wanted}",
                    "MuJoCo sets the other numbers to 0",
                    f"give all {wanted} numbers; replicate and attach add joints",
                )
