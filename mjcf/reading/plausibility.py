"""Find likely mistakes in MJCF files: wrong inertias of meshes, and keyframes with too few numbers.

MuJoCo can compute the inertia of a body from its mesh in several ways (attribute `inertia` of `<mesh>`).
Without `inertia="exact"`, the result may belong to another solid, such as the convex hull. `mesh_findings`
computes the inertia of the mesh itself and of the alternatives, and reports a body whose inertia equals an
alternative. The findings are part of the import report.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import mujoco
import numpy as np

from newton_euler.reading.import_report import Finding, Mistake
from newton_euler.scalars import Array

MAX_MESH_DIFFERENCE = 0.05
"""Relative difference of principal moments per mass, or of volumes, from the mesh itself, above which the
inertia of an alternative solid is reported; smaller differences matter little."""

MAX_EQUAL_DIFFERENCE = 0.01
"""Relative difference of principal moments per mass up to which two solids count as equal: more than the
rounding of numbers in files, less than `MAX_MESH_DIFFERENCE`."""

KEY_SIZES = {"qpos": "nq", "qvel": "nv", "act": "na", "ctrl": "nu"}
"""Attribute of the model with the needed number of values, by field of a keyframe."""


class Solid(NamedTuple):
    """Size and inertia of a solid or surface.

    Attributes:
        volume: m^3; for a surface, its area, m^2.
        moments: (3,) principal moments of inertia per mass, m^2, in ascending order.
    """

    volume: float
    moments: Array


def mesh_findings(model: Any) -> Iterator[Finding]:
    """Yield bodies that have the inertia of the hull or surface of their mesh, instead of the mesh itself.

    Only bodies with one closed mesh are examined. `model` is a compiled `MjModel`.
    """
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
        # moments per mass of the mesh itself, and of the compiled body
        exact = _solid(points[triangles], signed=True)
        body_moments = np.sort(model.body_inertia[body]) / model.body_mass[body]
        difference = _difference(body_moments, exact.moments)
        if exact.volume <= 0.0 or difference <= MAX_EQUAL_DIFFERENCE:
            continue
        name = model.body(body).name or str(body)
        # look for the wrong solid, whose moments the body has
        for what, other in _alternative_solids(points, triangles, _hull(model, mesh)):
            volume_ratio = 1.0 if what == "surface" else other.volume / exact.volume
            is_wrong = max(difference, abs(volume_ratio - 1.0)) > MAX_MESH_DIFFERENCE
            if is_wrong and _difference(body_moments, other.moments) <= MAX_EQUAL_DIFFERENCE:
                deviations = body_moments / exact.moments - 1.0
                percent = 100.0 * deviations[int(np.argmax(np.abs(deviations)))]
                more = "" if what == "surface" else f", and the volume is {volume_ratio:.3g} times its"
                yield Finding(
                    name=Mistake.MESH_INERTIA,
                    element=f"body {name!r}",
                    what=f"its inertia is that of its mesh's {what}: a principal moment by mass is "
                    f"{percent:+.0f} % different from the mesh itself{more}",
                    consequence="mass and inertia from density belong to another shape",
                    remedy='set inertia="exact" in the <mesh>, or give the body an <inertial>',
                )
                break


def _mesh(model: Any, number: int) -> tuple[Array, Array]:
    """Return the distinct points (n, 3) of mesh `number`, and its triangles (m, 3) as indices of points."""
    mesh = model.mesh(number)
    points = model.mesh_vert[mesh.vertadr[0] : mesh.vertadr[0] + mesh.vertnum[0]].astype(float)
    triangles = model.mesh_face[mesh.faceadr[0] : mesh.faceadr[0] + mesh.facenum[0]].astype(int)
    # a mesh may store a point once for each of its triangles
    _, first, index_of_distinct = np.unique(points, axis=0, return_index=True, return_inverse=True)
    return points[first], np.reshape(index_of_distinct, -1)[triangles]


def _is_closed(triangles: Array) -> bool:
    """Return True if each edge belongs to exactly two triangles, which traverse it in opposite directions.

    Args:
        triangles: (m, 3) indices of points.
    """
    begin, end = triangles, np.roll(triangles, -1, axis=1)
    count = triangles.max(initial=0) + 1
    # one integer for each directed edge, in both directions
    forward, backward = (np.sort(edges, axis=None) for edges in (begin * count + end, end * count + begin))
    return bool(np.all(forward[1:] != forward[:-1])) and np.array_equal(forward, backward)


def _solid(corners: Array, signed: bool) -> Solid:
    """Return the solid inside triangles, from tetrahedra between each triangle and the center of the surface.

    Args:
        corners: (m, 3, 3) corners of the triangles, m.
        signed: True to subtract tetrahedra of triangles that face the center; False to add all of them.
    """
    edges = corners[:, 1:] - corners[:, :1]
    areas = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1)
    corners = corners - areas @ corners.mean(axis=1) / max(float(areas.sum()), 1e-300)
    volumes = np.linalg.det(corners) / 6.0
    if not signed:
        volumes = np.abs(volumes)
    # tetrahedron with corners 0, a, b, c and s = a + b + c: center s / 4, second moment per volume
    # (a a^T + b b^T + c c^T + s s^T) / 20
    sums = corners.sum(axis=1)
    second_moments = np.einsum("kni,knj->kij", corners, corners) + np.einsum("ki,kj->kij", sums, sums)
    return _combine(volumes, sums / 4.0, second_moments / 20.0)


def _surface(corners: Array) -> Solid:
    """Return the shell of m triangles with constant mass per area; corners are (m, 3, 3), m."""
    edges = corners[:, 1:] - corners[:, :1]
    areas = 0.5 * np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1)
    # triangle with corners a, b, c and s = a + b + c: center s / 3, second moment per area
    # (a a^T + b b^T + c c^T + s s^T) / 12
    sums = corners.sum(axis=1)
    second_moments = np.einsum("kni,knj->kij", corners, corners) + np.einsum("ki,kj->kij", sums, sums)
    return _combine(areas, sums / 3.0, second_moments / 12.0)


def _combine(weights: Array, centers: Array, second_moments: Array) -> Solid:
    """Combine parts to one solid.

    Args:
        weights: (m,) volumes or areas of the parts.
        centers: (m, 3) centers, m.
        second_moments: (m, 3, 3) integrals of x x^T per volume or area about the origin, m^2.
    """
    whole = float(weights.sum())
    if not abs(whole) > 0.0:
        return Solid(0.0, np.ones(3))
    center = weights @ centers / whole
    second = np.einsum("k,kij->ij", weights, second_moments) / whole - np.outer(center, center)
    # inertia per mass about the center: trace(S) 1 - S
    return Solid(whole, np.linalg.eigvalsh(np.trace(second) * np.eye(3) - second))


def _hull(model: Any, number: int) -> Array:
    """Return the corners (m, 3, 3) of the triangles of a mesh's convex hull, empty if MuJoCo has no hull.

    MuJoCo computes the hull for collisions and for inertias of the hull. For each hull, `mesh_graph` has the
    numbers p of points and t of triangles, and 3 (p + t) integers about edges. The 3 t indices of the corners
    of the triangles follow (MuJoCo's documentation, `mjModel.mesh_graph`).
    """
    start = int(model.mesh_graphadr[number])
    if start < 0:
        return np.zeros((0, 3, 3))
    point_count, triangle_count = model.mesh_graph[start : start + 2].tolist()
    first = start + 2 + 3 * (point_count + triangle_count)
    triangles = model.mesh_graph[first:][: 3 * triangle_count].reshape(-1, 3)
    points = model.mesh_vert[model.mesh_vertadr[number] :].astype(float)
    return np.asarray(points[triangles])


def _alternative_solids(points: Array, triangles: Array, hull: Array) -> Iterator[tuple[str, Solid]]:
    """Yield the solids, with names, whose inertias MuJoCo may use instead of the inertia of the mesh.

    Args:
        points: (n, 3) points of the mesh, m.
        triangles: (m, 3) indices of points.
        hull: (k, 3, 3) corners of the triangles of the convex hull, m; empty if MuJoCo has no hull.
    """
    yield "volume without signs (legacy)", _solid(points[triangles], signed=False)
    yield "surface", _surface(points[triangles])
    if len(hull):
        yield "convex hull", _solid(hull, signed=False)


def _difference(moments: Array, reference: Array) -> float:
    """Return the largest difference of moments (3,), relative to the largest moment of a reference (3,)."""
    return float(np.max(np.abs(moments - reference)) / max(float(np.max(np.abs(reference))), 1e-300))


def key_findings(model: Any, sizes: Mapping[int, Mapping[str, int]]) -> Iterator[Finding]:
    """Yield keyframes with fewer numbers than the model needs; MuJoCo sets the missing numbers to zero.

    The elements `<replicate>` and `<attach>` add joints, for which older keyframes have no numbers.

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
                    name=Mistake.SHORT_KEYFRAME,
                    element=f"keyframe {label!r}",
                    what=f"{name} has {count} numbers, the model {wanted}",
                    consequence="MuJoCo sets the other numbers to 0",
                    remedy=f"give all {wanted} numbers; replicate and attach add joints",
                )
