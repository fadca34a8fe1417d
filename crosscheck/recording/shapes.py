"""Draw the bodies of a mechanism in a Rerun recording: meshes, boxes, spheres, capsules and cylinders.

A recording shows the runs of several engines (simulators): solid bodies of the first engine, and transparent
ones, "ghosts", of the others. Shapes and meshes of a mechanism are given at its initial pose, in the world
frame; Rerun needs them in the frame of the body.
"""

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
"""Opacity of the meshes of ghosts, from 0 to 255."""

GROUND_BAR_RADIUS = 0.01
"""Radius of the bars that are drawn for a ground without shapes, in multiples of the mechanism's size."""


class Style(NamedTuple):
    """Look of an engine's bodies and lines.

    Attributes:
        color: red, green and blue, from 0 to 255.
        line_width: width of lines in plots, points; it differs between engines, so that all of several
            coinciding lines are visible.
        ghost: whether bodies are drawn as transparent wireframes.
    """

    color: tuple[int, int, int]
    line_width: float = 0.0
    ghost: bool = False

    @property
    def fill(self) -> rr.components.FillMode:
        """Rerun's mode of drawing shapes: transparent for ghosts, solid otherwise."""
        modes = rr.components.FillMode
        return modes.TransparentFillMajorWireframe if self.ghost else modes.Solid


def xyzw(quaternion: Array) -> Array:
    """Convert quaternions (..., 4) from the order (w, x, y, z) to Rerun's order (x, y, z, w)."""
    return quaternion[..., [1, 2, 3, 0]]


def log_shapes(
    recording: rr.RecordingStream, path: str, mechanism: Mechanism, body: int, style: Style
) -> None:
    """Draw the meshes and shapes of a body in the body frame.

    Args:
        recording: recording to write to.
        path: path of the entity that has the body's pose over time.
        mechanism: the mechanism.
        body: number of the body.
        style: color and look.
    """
    pose = mechanism.bodies[body].pose  # at the initial pose of the mechanism
    world_to_body = conjugate(mechanism.bodies[body].quaternion)
    meshes = mechanism.bodies[body].meshes
    shapes = drawn_shapes(mechanism, body)
    boxes = [shape for shape in shapes if isinstance(shape, Box)]
    balls = [shape for shape in shapes if isinstance(shape, Sphere)]
    if boxes:
        cuboids = rr.Boxes3D(
            half_sizes=[box.half_sizes for box in boxes],
            centers=[pose.point_to_body(box.center) for box in boxes],
            quaternions=[xyzw(product(world_to_body, box.quaternion)) for box in boxes],
            colors=style.color,
            fill_mode=style.fill,
        )
        recording.log(path, cuboids, static=True)
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
    """Convert capsules, or cylinders, to Rerun's shapes in the frame of a body with this initial pose.

    Rerun's capsules extend from a point along the z axis, its cylinders have their center there.
    """
    looks: dict[str, Any] = {
        "lengths": [bar.length for bar in bars],
        "radii": [bar.radius for bar in bars],
        "quaternions": [xyzw(_rotation_from_z(pose.vector_to_body(bar.end - bar.start))) for bar in bars],
        "colors": style.color,
        "fill_mode": style.fill,
    }
    if isinstance(bars[0], Capsule):
        return rr.Capsules3D(translations=[pose.point_to_body(bar.start) for bar in bars], **looks)
    return rr.Cylinders3D(centers=[pose.point_to_body(0.5 * (bar.start + bar.end)) for bar in bars], **looks)


def drawn_shapes(mechanism: Mechanism, body: int) -> tuple[Shape, ...]:
    """Return the shapes to draw of a body, m, in the initial pose, world frame.

    A body without meshes and shapes is drawn as bars between its joints. The bars of the ground connect its
    joints in a ring, so that kinematic loops look closed.
    """
    drawn = mechanism.bodies[body]
    if body == 0 and not (drawn.meshes or drawn.shapes):
        points = [mechanism.joints[k].point for k in mechanism.joints_at[0]]
        pairs = zip(points, [*points[1:], *points[:1]], strict=True)
        return tuple(Capsule(a, b, GROUND_BAR_RADIUS * mechanism.size) for a, b in pairs if np.any(a != b))
    return drawn.shapes if drawn.meshes else mechanism.shapes(body)


def drawn_points(mechanism: Mechanism, body: int, run: Trajectory) -> Array:
    """Compute the positions of m points that outline what is drawn of a body, at the n outputs of a run.

    The points are corners of boxes around meshes, boxes and spheres, and the ends of the axes of bars.

    Args:
        mechanism: the mechanism.
        body: number of the body.
        run: run with the poses of the body.

    Returns:
        Array (n, m, 3), m, world frame.
    """
    pose = mechanism.bodies[body].pose
    signs = np.array(list(itertools.product((-1.0, 1.0), repeat=3)))  # of the corners of a box
    drawn = drawn_shapes(mechanism, body)
    # the center of mass is one of the points, except for a visible ground, which has no center of mass
    is_visible_ground = body == 0 and bool(drawn or mechanism.bodies[body].meshes)
    points = [] if is_visible_ground else [pose.position[None]]
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
    # from the initial pose to the body frame, and from there to the poses of the run
    corners = (np.concatenate(points) - pose.position) @ pose.rotation
    k = run.body_names.index(mechanism.body_names[body])
    return run.position[:, k, None] + rotated(run.quaternion[:, k, None], corners)


def largest_distance(mechanism: Mechanism, first: Trajectory, other: Trajectory) -> float:
    """Compute the largest distance, m, of any point of a drawn body in two runs at the same time.

    Args:
        mechanism: the mechanism.
        first: run with all bodies.
        other: run with all bodies or some, at the same output times; either run may end early.
    """
    n = min(len(first.time), len(other.time))
    differences = (
        drawn_points(mechanism, body, first)[:n] - drawn_points(mechanism, body, other)[:n]
        for body in map(mechanism.body_index, other.body_names)
    )
    return max(float(np.max(np.linalg.norm(difference, axis=2))) for difference in differences)


def _mesh(mesh: Mesh, pose: Pose, style: Style) -> rr.Mesh3D:
    """Convert a mesh to the frame of a body with this initial pose; ghosts get the engine's color."""
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
    """Compute the normals of a mesh at its vertices, by which the viewer shades the mesh.

    Args:
        vertices: (n, 3), m.
        triangles: (t, 3) numbers of the vertices of each triangle.

    Returns:
        Unit vectors (n, 3): means of the normals of the adjacent triangles, weighted by area.
    """
    corners = vertices[triangles]
    # the length of this product is twice the area of the triangle
    areas = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    # for each component, add the vector of a triangle to its three vertices
    sums = [np.bincount(triangles.ravel(), np.repeat(part, 3), len(vertices)) for part in areas.T]
    total = np.column_stack(sums)
    lengths = np.linalg.norm(total, axis=1, keepdims=True)
    return np.asarray(total / np.where(lengths > 0.0, lengths, 1.0))


def _rotation_from_z(vector: Array) -> Array:
    """Compute the quaternion (4,) of a rotation from the z axis to the direction of a vector (3,).

    The rotation of the zero vector is that of z itself.
    """
    length = float(np.linalg.norm(vector))
    axis = vector / length if length > 0.0 else np.array([0.0, 0.0, 1.0])
    return from_rotation(np.column_stack([*perpendicular_pair(axis), axis]))
