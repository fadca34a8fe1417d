"""Likely mistakes of MJCF files beside those of bodies: inertias of meshes, and keyframes of another size."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import mujoco
import numpy as np

from newton_euler.reading.import_report import Finding
from newton_euler.scalars import Array

MAX_MESH_DIFFERENCE = 0.05
"""Relative difference of moments by mass or of volumes, above which a mesh's inertia is not its own."""

EQUAL = 0.01
"""Relative difference within which moments per mass are those of a hull, a surface or MuJoCo's old sum."""

KEY_SIZES = {"qpos": "nq", "qvel": "nv", "act": "na", "ctrl": "nu"}
"""Fields of keyframes and the sizes that they need."""


class Solid(NamedTuple):
    """Volume or area of a mesh, and principal moments (3,) per unit of it, m^2, ascending."""

    volume: float
    moments: Array


def mesh_findings(model: Any) -> Iterator[Finding]:
    """Bodies whose inertia is that of a mesh's hull or surface, and not of the mesh."""
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
        difference = _apart(found, own.moments)
        if own.volume <= 0.0 or difference <= EQUAL:
            continue
        name = model.body(body).name or str(body)
        for what, other in _others(points, triangles, _hull(model, mesh)):
            ratio = 1.0 if what == "surface" else other.volume / own.volume
            is_far = max(difference, abs(ratio - 1.0)) > MAX_MESH_DIFFERENCE
            if is_far and _apart(found, other.moments) <= EQUAL:
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
                    f"{percent:+.0f} % off that of the mesh itself{more}",
                    "masses and moments from density are those of another body",
                    'set inertia="exact" in the <mesh>, or give the body an <inertial>',
                )
                break


def _mesh(model: Any, number: int) -> tuple[Array, Array]:
    """Points (n, 3) and triangles (m, 3) of a mesh."""
    mesh = model.mesh(number)
    points = model.mesh_vert[mesh.vertadr[0] : mesh.vertadr[0] + mesh.vertnum[0]].astype(float)
    triangles = model.mesh_face[mesh.faceadr[0] : mesh.faceadr[0] + mesh.facenum[0]].astype(int)
    # points that several triangles have may be there several times
    _, first, same = np.unique(points, axis=0, return_index=True, return_inverse=True)
    return points[first], np.reshape(same, -1)[triangles]


def _is_closed(triangles: Array) -> bool:
    """True if each edge belongs to two triangles that run along it in opposite directions."""
    begin, end = triangles, np.roll(triangles, -1, axis=1)
    count = triangles.max(initial=0) + 1
    forward, backward = (np.sort(edges, axis=None) for edges in (begin * count + end, end * count + begin))
    return bool(np.all(forward[1:] != forward[:-1])) and np.array_equal(forward, backward)


def _solid(corners: Array, signed: bool) -> Solid:
    """The solid within triangles (m, 3, 3): tetrahedra from the surface's center, with signs or without."""
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
    """The shell of triangles (m, 3, 3), of the same mass by area everywhere."""
    edges = corners[:, 1:] - corners[:, :1]
    areas = 0.5 * np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1)
    sums = corners.sum(axis=1)
    seconds = np.einsum("kni,knj->kij", corners, corners) + np.einsum("ki,kj->kij", sums, sums)
    return _reduced(areas, sums / 3.0, seconds / 12.0)


def _reduced(weights: Array, centers: Array, seconds: Array) -> Solid:
    """Add parts up: weights (m,), their centers (m, 3) and mean second moments (m, 3, 3)."""
    whole = float(weights.sum())
    if not abs(whole) > 0.0:
        return Solid(0.0, np.ones(3))
    center = weights @ centers / whole
    second = np.einsum("k,kij->ij", weights, seconds) / whole - np.outer(center, center)
    return Solid(whole, np.linalg.eigvalsh(np.trace(second) * np.eye(3) - second))


def _hull(model: Any, number: int) -> Array:
    """Corners (m, 3, 3) of the triangles of a mesh's convex hull; none if MuJoCo has not needed it.

    MuJoCo works it out for collisions, and for an inertia that is to be the hull's. Its `mesh_graph` has the
    numbers of points and triangles, three arrays of points and edges, and the triangles.
    """
    start = int(model.mesh_graphadr[number])
    if start < 0:
        return np.zeros((0, 3, 3))
    count, faces = model.mesh_graph[start : start + 2].tolist()
    triangles = model.mesh_graph[start + 2 + 3 * (count + faces) :][: 3 * faces].reshape(-1, 3)
    points = model.mesh_vert[model.mesh_vertadr[number] :].astype(float)
    return np.asarray(points[triangles])


def _others(points: Array, triangles: Array, hull: Array) -> Iterator[tuple[str, Solid]]:
    """Solids that MuJoCo's other ways to find a mesh's inertia take for the mesh."""
    yield "volume without signs (legacy)", _solid(points[triangles], signed=False)
    yield "surface", _surface(points[triangles])
    if len(hull):
        yield "convex hull", _solid(hull, signed=False)


def _apart(one: Array, two: Array) -> float:
    return float(np.max(np.abs(one - two)) / max(float(np.max(np.abs(two))), 1e-300))


def key_findings(model: Any, sizes: Mapping[int, Mapping[str, int]]) -> Iterator[Finding]:
    """Keyframes with fewer numbers than the model has, which MuJoCo fills up with zeros.

    Args:
        model: compiled.
        sizes: by number of a keyframe, how many numbers its fields have in the file.
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
                    "MuJoCo fills the rest up, so the other joints start at 0",
                    f"give all {wanted} numbers; replicate and attach add joints",
                )
