"""Shapes of bodies in a recording."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import rerun as rr

from newton_euler.model.euler_parameters import conjugate, from_rotation, product
from newton_euler.model.geometry import Box, Capsule, Mesh
from newton_euler.model.joint import Pose, perpendicular_pair
from newton_euler.model.mechanism import Mechanism
from newton_euler.scalars import Array

HULL_OPACITY = 70
"""Of 255, of meshes of engines after the first."""


class Style(NamedTuple):
    """Color and line width of one engine."""

    color: tuple[int, int, int]
    line_width: float
    """Of its lines where those of other engines lie under or over them, points."""
    fill: rr.components.FillMode
    rank: int
    """0 for the first engine."""
    shell: float
    """m, by which its shapes are grown."""


def xyzw(quaternion: Array) -> Array:
    """Rerun's order of w-x-y-z quaternions (..., 4)."""
    return quaternion[..., [1, 2, 3, 0]]


def log_shapes(
    recording: rr.RecordingStream, path: str, mechanism: Mechanism, body: int, style: Style
) -> None:
    """Draw a body in its own frame: its meshes and shapes if it has meshes, its shapes otherwise."""
    pose = mechanism.bodies[body].pose
    back = conjugate(mechanism.bodies[body].quaternion)
    meshes = mechanism.bodies[body].meshes
    shapes = mechanism.bodies[body].shapes if meshes else mechanism.shapes(body)
    boxes = [shape for shape in shapes if isinstance(shape, Box)]
    bars = [shape for shape in shapes if isinstance(shape, Capsule)]
    if boxes:
        drawn = rr.Boxes3D(
            half_sizes=[box.half_sizes + style.shell for box in boxes],
            centers=[pose.point_to_body(box.center) for box in boxes],
            quaternions=[xyzw(product(back, box.quaternion)) for box in boxes],
            colors=style.color,
            fill_mode=style.fill,
        )
        recording.log(path, drawn, static=True)
    if bars:
        starts = [pose.point_to_body(bar.start) for bar in bars]
        ends = [pose.point_to_body(bar.end) for bar in bars]
        pairs = list(zip(starts, ends, strict=True))
        capsules = rr.Capsules3D(
            lengths=[float(np.linalg.norm(end - start)) for start, end in pairs],
            radii=[bar.radius + style.shell for bar in bars],
            translations=starts,
            quaternions=[xyzw(_from_z(end - start)) for start, end in pairs],
            colors=style.color,
            fill_mode=style.fill,
        )
        recording.log(path, capsules, static=True)
    for k, mesh in enumerate(meshes):
        recording.log(f"{path}/mesh_{k}", _mesh(mesh, pose, style), static=True)


def _mesh(mesh: Mesh, pose: Pose, style: Style) -> rr.Mesh3D:
    """A mesh in the frame of its body: as it is for the first engine, a hull around it for the others."""
    vertices = (mesh.vertices - pose.position) @ pose.rotation
    normals = _normals(vertices, mesh.triangles)
    color = [*style.color, 255 if style.rank == 0 else HULL_OPACITY]
    if style.rank == 0 and mesh.color is not None:
        color = [round(255 * part) for part in mesh.color]
    return rr.Mesh3D(
        vertex_positions=vertices + style.shell * normals,
        vertex_normals=normals,
        triangle_indices=mesh.triangles,
        albedo_factor=color,
    )


def _normals(vertices: Array, triangles: Array) -> Array:
    """(n, 3) unit vectors out of a mesh at its vertices: means over the triangles there, by area."""
    corners = vertices[triangles]
    areas = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    total = np.zeros_like(vertices)
    for corner in range(3):
        np.add.at(total, triangles[:, corner], areas)
    lengths = np.linalg.norm(total, axis=1, keepdims=True)
    return np.asarray(total / np.where(lengths > 0.0, lengths, 1.0))


def _from_z(vector: Array) -> Array:
    """A rotation (4,) that takes z to the direction of a vector; that of a zero vector is z."""
    length = float(np.linalg.norm(vector))
    axis = vector / length if length > 0.0 else np.array([0.0, 0.0, 1.0])
    return from_rotation(np.column_stack([*perpendicular_pair(axis), axis]))
