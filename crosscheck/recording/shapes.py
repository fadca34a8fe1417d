"""Shapes of bodies in a recording."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any, NamedTuple, assert_never

import numpy as np
import rerun as rr

from crosscheck.recording.plots import rotated
from newton_euler.model.euler_parameters import conjugate, from_rotation, product, rotation
from newton_euler.model.geometry import Box, Capsule, Cylinder, Mesh, Shape, Sphere
from newton_euler.model.joint import Pose, perpendicular_pair
from newton_euler.model.mechanism import Mechanism
from newton_euler.model.trajectory import Trajectory
from newton_euler.scalars import Array

GHOST_OPACITY = 70
"""Opacity of ghosts, of 255."""


FRAME = 0.01
"""Radius of bars that stand in for the ground, in multiples of the mechanism's size."""


class Style(NamedTuple):
    """Look of one engine."""

    color: tuple[int, int, int]
    line_width: float = 0.0
    """Width of lines in points, so that lines of several engines on top of each other stay visible."""
    ghost: bool = False
    """Whether its bodies are drawn as translucent wireframes."""

    @property
    def fill(self) -> rr.components.FillMode:
        modes = rr.components.FillMode
        return modes.TransparentFillMajorWireframe if self.ghost else modes.Solid


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
    shapes = drawn_shapes(mechanism, body)
    boxes = [shape for shape in shapes if isinstance(shape, Box)]
    balls = [shape for shape in shapes if isinstance(shape, Sphere)]
    if boxes:
        drawn = rr.Boxes3D(
            half_sizes=[box.half_sizes for box in boxes],
            centers=[pose.point_to_body(box.center) for box in boxes],
            quaternions=[xyzw(product(back, box.quaternion)) for box in boxes],
            colors=style.color,
            fill_mode=style.fill,
        )
        recording.log(path, drawn, static=True)
    if balls:
        spheres = rr.Ellipsoids3D(
            radii=[ball.radius for ball in balls],
            centers=[pose.point_to_body(ball.center) for ball in balls],
            colors=style.color,
            fill_mode=style.fill,
        )
        recording.log(path, spheres, static=True)
    for kind in (Capsule, Cylinder):
        bars = [shape for shape in shapes if isinstance(shape, kind)]
        if bars:
            recording.log(path, _bars(bars, pose, style), static=True)
    for k, mesh in enumerate(meshes):
        recording.log(f"{path}/mesh_{k}", _mesh(mesh, pose, style), static=True)


def _bars(bars: Sequence[Capsule | Cylinder], pose: Pose, style: Style) -> rr.Capsules3D | rr.Cylinders3D:
    """Draw round bars of one kind in the frame of their body."""
    looks: dict[str, Any] = {
        "lengths": [bar.length for bar in bars],
        "radii": [bar.radius for bar in bars],
        "quaternions": [xyzw(_from_z(pose.vector_to_body(bar.end - bar.start))) for bar in bars],
        "colors": style.color,
        "fill_mode": style.fill,
    }
    if isinstance(bars[0], Capsule):
        return rr.Capsules3D(translations=[pose.point_to_body(bar.start) for bar in bars], **looks)
    return rr.Cylinders3D(centers=[pose.point_to_body(0.5 * (bar.start + bar.end)) for bar in bars], **looks)


def drawn_shapes(mechanism: Mechanism, body: int) -> tuple[Shape, ...]:
    """The shapes that are drawn of a body: bars stand in for them where it has no meshes either.

    Those of the ground go around its joints, so that loops are seen to close.
    """
    own = mechanism.bodies[body]
    if body == 0 and not (own.meshes or own.shapes):
        points = [mechanism.joints[k].point for k in mechanism.joints_at[0]]
        pairs = zip(points, [*points[1:], *points[:1]], strict=True)
        return tuple(Capsule(a, b, FRAME * mechanism.size) for a, b in pairs if np.any(a != b))
    return own.shapes if own.meshes else mechanism.shapes(body)


def paths(mechanism: Mechanism, body: int, run: Trajectory) -> Array:
    """(n, m, 3) m: where a run takes points that what is drawn of a body lies between."""
    pose = mechanism.bodies[body].pose
    signs = np.array(list(itertools.product((-1.0, 1.0), repeat=3)))
    drawn = drawn_shapes(mechanism, body)
    # the ground's center is nowhere in particular
    points = [] if body == 0 and (drawn or mechanism.bodies[body].meshes) else [pose.position[None]]
    for mesh in mechanism.bodies[body].meshes:
        low, high = mesh.bounds
        points.append(0.5 * (low + high) + signs * 0.5 * (high - low))
    for shape in drawn:
        if isinstance(shape, Sphere):
            points.append(shape.center + signs * shape.radius)
        elif isinstance(shape, Capsule | Cylinder):
            points.append(np.array([shape.start, shape.end]))
        elif isinstance(shape, Box):
            points.append(shape.center + (signs * shape.half_sizes) @ rotation(shape.quaternion).T)
        else:
            assert_never(shape)
    corners = (np.concatenate(points) - pose.position) @ pose.rotation
    return run.position[:, body, None] + rotated(run.quaternion[:, body, None], corners)


def _mesh(mesh: Mesh, pose: Pose, style: Style) -> rr.Mesh3D:
    """A mesh in the frame of its body, in its own color or as a ghost."""
    vertices = (mesh.vertices - pose.position) @ pose.rotation
    color = [*style.color, GHOST_OPACITY if style.ghost else 255]
    if mesh.color is not None and not style.ghost:
        color = [round(255 * part) for part in mesh.color]
    return rr.Mesh3D(
        vertex_positions=vertices,
        vertex_normals=_normals(vertices, mesh.triangles),
        triangle_indices=mesh.triangles,
        albedo_factor=color,
    )


def _normals(vertices: Array, triangles: Array) -> Array:
    """(n, 3) unit vectors out of a mesh at its vertices: means over the triangles there, by area."""
    corners = vertices[triangles]
    areas = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    sums = [np.bincount(triangles.ravel(), np.repeat(part, 3), len(vertices)) for part in areas.T]
    total = np.column_stack(sums)
    lengths = np.linalg.norm(total, axis=1, keepdims=True)
    return np.asarray(total / np.where(lengths > 0.0, lengths, 1.0))


def _from_z(vector: Array) -> Array:
    """A rotation (4,) that takes z to the direction of a vector; that of a zero vector is z."""
    length = float(np.linalg.norm(vector))
    axis = vector / length if length > 0.0 else np.array([0.0, 0.0, 1.0])
    return from_rotation(np.column_stack([*perpendicular_pair(axis), axis]))
