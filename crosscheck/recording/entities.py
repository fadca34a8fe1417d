"""Entities of the 3-D view of a recording: bodies, names, joint points, reactions, tilt and wind over time.

Each function draws one kind of entity in the tree of `crosscheck.recording.log`, at the poses of one run.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import rerun as rr

from crosscheck.recording.plots import platforms, rotated
from crosscheck.recording.shapes import Style, drawn_points, log_shapes
from crosscheck.recording.stream import send_columns, send_pose
from newton_euler.model.mechanism import Mechanism
from newton_euler.model.trajectory import Trajectory
from newton_euler.model.wind import WindLoad
from newton_euler.scalars import Array

# colors are red, green and blue, from 0 to 255
GROUND_COLOR = (128, 128, 128)

PLAIN_COLOR = (220, 220, 220)
"""Color of joint points, labels and targets of controllers."""

WIND_COLOR = (86, 180, 233)

ARROW_COLOR = (240, 228, 66)
"""Color of reactions and of the vertical."""

DIRECTION_COLOR = (230, 159, 0)
"""Color of given directions, for example towards the sun."""

LONGEST_ARROW = 1.0
"""Length of the arrow of the largest reaction force, in multiples of the mechanism's size."""

MIN_VISIBLE_DISTANCE = 0.002
"""Smallest distance of a body in two engines that a user can see, in multiples of the mechanism's size."""


def heading(title: str, engines: list[str], distances: dict[str, float], hidden: list[str]) -> str:
    """Make the title of the 3-D view, which lists the engines that are solid, ghosts or hidden.

    Args:
        title: title of the recording.
        engines: all engines; the first is solid.
        distances: largest distance from the first engine, m, of each other engine and of the own run.
        hidden: engines (and the own run) whose distance is too small to be visible.
    """
    parts = [f"{engine} solid" for engine in engines[:1]]
    for name, distance in distances.items():
        if name not in hidden:
            parts.append(f"{name} ghost, up to {distance:.2g} m away")
    if hidden:
        within = max(distances[name] for name in hidden)
        parts.append(f"{', '.join(hidden)} hidden, within {within:.0e} m")
    return f"{title}: {'; '.join(parts)}"


def log_ground(recording: rr.RecordingStream, mechanism: Mechanism, run: Trajectory) -> None:
    """Draw the fixed body, which is body 0, in its pose in a run."""
    recording.log("/", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    log_shapes(recording, "/ground", mechanism, 0, Style(GROUND_COLOR))
    send_pose(recording, "/ground", run.time[:1], run.position[:1, 0], run.quaternion[:1, 0])


def log_bodies(
    recording: rr.RecordingStream, folder: Sequence[str], mechanism: Mechanism, run: Trajectory, style: Style
) -> None:
    """Draw the moving bodies of a run over time.

    Args:
        recording: recording to write to.
        folder: parts of the path below which each body is an entity by its name.
        mechanism: mechanism with the shapes and meshes of the bodies.
        run: run with the poses of all bodies or of some.
        style: color and look of the bodies.
    """
    for k, name in enumerate(run.body_names):
        body = mechanism.body_index(name)
        if body != 0:  # not the ground
            path = rr.new_entity_path([*folder, name])
            log_shapes(recording, path, mechanism, body, style)
            send_pose(recording, path, run.time, run.position[:, k], run.quaternion[:, k])


def log_labels(recording: rr.RecordingStream, mechanism: Mechanism, run: Trajectory) -> None:
    """Label bodies at their centers of mass, and the ground at its lowest point, below the other bodies."""
    ground_points = drawn_points(mechanism, 0, run)[0]  # at the first output
    lowest = ground_points[[np.argmin(ground_points[:, 2])]]
    for k, name in enumerate(mechanism.body_names):
        path = rr.new_entity_path(["labels", name])
        label = rr.Points3D(np.zeros(3), labels=name, colors=PLAIN_COLOR, radii=0.0)
        recording.log(path, label, static=True)
        position = lowest if k == 0 else run.position[:, k]
        count = len(position)  # 1 for the ground
        send_pose(recording, path, run.time[:count], position, run.quaternion[:count, k])


def log_tilt(
    recording: rr.RecordingStream, mechanism: Mechanism, run: Trajectory, directions: Mapping[str, Array]
) -> None:
    """Draw arrows from the center of mass of the platform, the body whose tilt is plotted.

    The arrows are the body's normal (its z axis), the vertical, and given directions.

    Args:
        recording: recording to write to.
        mechanism: the mechanism.
        run: run with the poses of the body.
        directions: unit vectors (n, 3), world frame, by name.
    """
    # platforms are bodies with three or more joints; the tilt of the last one is plotted
    body, size = platforms(mechanism)[-1], mechanism.size
    position, quaternion = run.position[:, body], run.quaternion[:, body]
    upright = np.broadcast_to([1.0, 0.0, 0.0, 0.0], quaternion.shape)
    # arrows along the z axis of an entity that is rotated like the body, or upright
    for name, orientation, length, color in (
        ("normal", quaternion, 0.6 * size, PLAIN_COLOR),
        ("vertical", upright, 0.9 * size, ARROW_COLOR),
    ):
        arrow = rr.Arrows3D(vectors=[0.0, 0.0, length], labels=name, colors=color, radii=0.02 * size)
        recording.log(f"/tilt/{name}", arrow, static=True)
        send_pose(recording, f"/tilt/{name}", run.time, position, orientation)
    for name, directions_over_time in directions.items():
        look = rr.Arrows3D.from_fields(labels=[name], colors=DIRECTION_COLOR, radii=0.02 * size)
        recording.log(f"/tilt/{name}", look, static=True)
        vectors, columns = 1.2 * size * directions_over_time, rr.Arrows3D.columns
        send_columns(recording, f"/tilt/{name}", run.time, columns, origins=position, vectors=vectors)


def log_wind(recording: rr.RecordingStream, mechanism: Mechanism, run: Trajectory, load: WindLoad) -> None:
    """Draw the wind velocity over time, as an arrow that ends in front of the plate that the wind acts on."""
    body = mechanism.body_index(load.body)
    arm = mechanism.bodies[body].pose.point_to_body(load.point)
    centers = run.position[:, body] + rotated(run.quaternion[:, body], arm)
    velocities = np.array([load.velocity(float(time)) for time in run.time])
    fastest = float(np.max(np.linalg.norm(velocities, axis=1)))
    vectors = LONGEST_ARROW * mechanism.size / (fastest or 1.0) * velocities
    path = rr.new_entity_path(["wind", load.name])
    look = rr.Arrows3D.from_fields(colors=WIND_COLOR, radii=0.01 * mechanism.size, labels=load.name)
    recording.log(path, look, static=True)
    # the arrow ends upwind of the plate, at half of the plate's diagonal from its center
    offset = 0.5 * np.linalg.norm(load.lengths) * load.direction / np.linalg.norm(load.direction)
    origins = centers - offset - vectors
    send_columns(recording, path, run.time, rr.Arrows3D.columns, origins=origins, vectors=vectors)


def reaction_arrow_scale(mechanism: Mechanism, trajectories: dict[str, Trajectory]) -> float | None:
    """Compute the length of reaction arrows, m per N; None if there are no reactions or all are zero."""
    forces = [run.reaction_force for run in trajectories.values() if run.reaction_force is not None]
    if not forces:
        return None
    largest = max(float(np.max(np.linalg.norm(force, axis=2), initial=0.0)) for force in forces)
    return LONGEST_ARROW * mechanism.size / largest if largest > 0.0 else None


def log_joints(
    recording: rr.RecordingStream,
    mechanism: Mechanism,
    engine: str,
    run: Trajectory,
    arrow_scale: float | None,
) -> None:
    """Draw joint points and reaction forces of an engine's run over time; `arrow_scale` is in m per N."""
    for j, joint in enumerate(mechanism.joints):
        second = mechanism.body_index(joint.second)
        arm = mechanism.reaction_arms[j]  # from the second body's center of mass to the joint point
        points = run.position[:, second] + rotated(run.quaternion[:, second], arm)
        path = rr.new_entity_path(["joints", engine, joint.name])
        look = rr.Points3D.from_fields(colors=PLAIN_COLOR, radii=0.03 * mechanism.size)
        recording.log(path, look, static=True)
        send_columns(recording, path, run.time, rr.Points3D.columns, positions=points)
        if run.reaction_force is not None and arrow_scale is not None:
            path = rr.new_entity_path(["reactions", engine, joint.name])
            arrow_look = rr.Arrows3D.from_fields(colors=ARROW_COLOR, radii=0.02 * mechanism.size)
            recording.log(path, arrow_look, static=True)
            vectors = arrow_scale * run.reaction_force[:, j]
            arrows = rr.Arrows3D.columns
            send_columns(recording, path, run.time, arrows, origins=points, vectors=vectors)
