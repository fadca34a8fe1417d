"""A run of several engines as a Rerun recording.

Entities:
    /ground                      shapes of the fixed body, once
    /mechanism/ENGINE/BODY       shapes, and the body's pose over time
    /mechanism/ENGINE/BODY/normal  an arrow across the panel
    /joints/ENGINE/JOINT         joint point on the second body over time
    /reactions/ENGINE/JOINT      constraint force on the second body over time
    /plots/QUANTITY/.../ENGINE   scalars over time, see `rerun_plots`
    /verdict                     the tables, as text

Poses and arrows are for the eye and hold single precision; the scalars hold double precision.
Rerun's quaternions are x-y-z-w; they are turned round in this module and nowhere else.
"""

from __future__ import annotations

import os
import uuid
from typing import NamedTuple

import numpy as np
import rerun as rr

from crosscheck.recording.blueprint import blueprint
from crosscheck.recording.plots import Plot, panel, plots, rotated
from newton_euler.euler_parameters import conjugate, from_rotation, product
from newton_euler.joints import perpendicular_pair
from newton_euler.mechanism import Mechanism
from newton_euler.scalars import Array
from newton_euler.scene import Scene
from newton_euler.shapes import Box, Capsule
from newton_euler.trajectory import Trajectory, atomic_file

APPLICATION = "crosscheck"

COLORS = ((230, 159, 0), (86, 180, 233), (204, 121, 167), (0, 158, 115))
"""One colour an engine: M. Okabe and K. Ito, Color Universal Design, 2008."""

GROUND_COLOR = (128, 128, 128)
JOINT_COLOR = (240, 240, 240)
REACTION_COLOR = (240, 228, 66)

SHELL = 0.012
"""By how much of the mechanism's size each engine's shapes are larger than those of the engine before
it. Engines that agree would otherwise hide each other."""

LINE_WIDTH = 1.5
"""Width of the thinnest lines in plots, points."""

LONGEST_ARROW = 1.0
"""Length of the largest reaction, in multiples of the mechanism's size."""


class Style(NamedTuple):
    """How one engine is drawn."""

    color: tuple[int, int, int]
    line_width: float
    """Of its lines where those of other engines lie under or over them, points."""
    fill: rr.components.FillMode
    rank: int
    """0 for the first engine."""
    shell: float
    """m, by which its shapes are grown."""


def write_recording(
    path: str | os.PathLike[str], scene: Scene, trajectories: dict[str, Trajectory], verdict: str
) -> None:
    """Write an .rrd; the file appears whole or not at all.

    Args:
        scene: what was run.
        trajectories: by engine, at the same output times; the first is the one that the others are
            compared with.
        verdict: Markdown.

    Raises:
        OSError: if the file cannot be written to its end.
    """
    rr.set_strict_mode(True)
    mechanism = scene.mechanism
    styles = _styles(list(trajectories), mechanism.size)
    shown = plots(scene, trajectories)
    arrow_scale = _arrow_scale(mechanism, trajectories)
    title = scene.name if arrow_scale is None else f"{scene.name} (reactions: 1 N is {arrow_scale:.2g} m)"
    layout = blueprint(mechanism, list(trajectories), shown, title)
    recording = rr.RecordingStream(APPLICATION, recording_id=uuid.uuid4())
    # in memory first: the writer's own thread would wait for ever on a disk that is full
    memory = recording.memory_recording()
    recording.send_blueprint(layout, make_active=False)
    recording.send_recording_name(scene.name)
    recording.log("/", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    recording.log("/verdict", rr.TextDocument(verdict, media_type=rr.MediaType.MARKDOWN), static=True)
    _log_ground(recording, mechanism)
    for engine, run in trajectories.items():
        _log_bodies(recording, mechanism, engine, run, styles[engine])
        _log_joints(recording, mechanism, engine, run, arrow_scale)
    times = {engine: _time_column(run.time) for engine, run in trajectories.items()}
    for plot in shown:
        _log_plot(recording, plot, times, styles)
    with atomic_file(path) as temporary:
        temporary.write_bytes(memory.drain_as_bytes())


def _styles(engines: list[str], size: float) -> dict[str, Style]:
    """How the engines are drawn so that those that agree can still be told apart.

    The first is solid and the others are wireframes around it. The viewer draws lines in the order
    of their names, so each is thinner than the one before it in that order.
    """
    solid, wires = rr.components.FillMode.Solid, rr.components.FillMode.MajorWireframe
    thinnest_first = sorted(engines, reverse=True)
    return {
        engine: Style(
            color=COLORS[k % len(COLORS)],
            line_width=LINE_WIDTH + 2.0 * thinnest_first.index(engine),
            fill=solid if k == 0 else wires,
            rank=k,
            shell=SHELL * k * size,
        )
        for k, engine in enumerate(engines)
    }


def _time_column(time: Array) -> rr.TimeColumn:
    return rr.TimeColumn("time", duration=np.round(time * 1e9).astype("timedelta64[ns]"))


def _xyzw(quaternion: Array) -> Array:
    """Rerun's order of w-x-y-z quaternions (..., 4)."""
    return quaternion[..., [1, 2, 3, 0]]


def _log_ground(recording: rr.RecordingStream, mechanism: Mechanism) -> None:
    body = mechanism.bodies[0]
    quaternion = rr.Quaternion(xyzw=_xyzw(body.quaternion))
    pose = rr.Transform3D(translation=body.center_of_mass, quaternion=quaternion)
    recording.log("/ground", pose, static=True)
    style = Style(GROUND_COLOR, 0.0, rr.components.FillMode.Solid, 0, 0.0)
    _log_shapes(recording, "/ground", mechanism, 0, style)


def _log_bodies(
    recording: rr.RecordingStream, mechanism: Mechanism, engine: str, run: Trajectory, style: Style
) -> None:
    time = _time_column(run.time)
    for k in range(1, len(mechanism.bodies)):
        path = rr.new_entity_path(["mechanism", engine, mechanism.body_names[k]])
        _log_shapes(recording, path, mechanism, k, style)
        pose = rr.Transform3D.columns(translation=run.position[:, k], quaternion=_xyzw(run.quaternion[:, k]))
        recording.send_columns(path, [time], pose)
    found = panel(mechanism)
    if found is not None:
        body, box = found
        path = rr.new_entity_path(["mechanism", engine, mechanism.body_names[body]])
        _log_normal(recording, path, mechanism, body, box, style)


def _log_shapes(
    recording: rr.RecordingStream, path: str, mechanism: Mechanism, body: int, style: Style
) -> None:
    """Shapes in the frame of their body."""
    pose = mechanism.bodies[body].pose
    back = conjugate(mechanism.bodies[body].quaternion)
    boxes = [shape for shape in mechanism.shapes(body) if isinstance(shape, Box)]
    bars = [shape for shape in mechanism.shapes(body) if isinstance(shape, Capsule)]
    if boxes:
        drawn = rr.Boxes3D(
            half_sizes=[box.half_sizes + style.shell for box in boxes],
            centers=[pose.point_to_body(box.center) for box in boxes],
            quaternions=[_xyzw(product(back, box.quaternion)) for box in boxes],
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
            quaternions=[_xyzw(_from_z(end - start)) for start, end in pairs],
            colors=style.color,
            fill_mode=style.fill,
        )
        recording.log(path, capsules, static=True)


def _from_z(vector: Array) -> Array:
    """A rotation (4,) that takes z to the direction of a vector; that of a zero vector is z."""
    length = float(np.linalg.norm(vector))
    axis = vector / length if length > 0.0 else np.array([0.0, 0.0, 1.0])
    return from_rotation(np.column_stack([*perpendicular_pair(axis), axis]))


def _log_normal(
    recording: rr.RecordingStream,
    path: str,
    mechanism: Mechanism,
    body: int,
    box: Box,
    style: Style,
) -> None:
    pose = mechanism.bodies[body].pose
    thin = np.zeros(3)
    thin[int(np.argmin(box.half_sizes))] = 1.0
    normal = pose.vector_to_body(rotated(box.quaternion, thin))
    # each engine's arrow is longer and thinner than that of the engine before it
    arrow = rr.Arrows3D(
        origins=pose.point_to_body(box.center),
        vectors=normal * float(np.max(box.half_sizes)) * (0.4 + 0.2 * style.rank),
        radii=0.03 * mechanism.size / (1.0 + style.rank),
        colors=style.color,
    )
    recording.log(f"{path}/normal", arrow, static=True)


def _arrow_scale(mechanism: Mechanism, trajectories: dict[str, Trajectory]) -> float | None:
    """Metres a newton; None without reactions."""
    forces = [run.reaction_force for run in trajectories.values() if run.reaction_force is not None]
    if not forces:
        return None
    largest = max(float(np.max(np.linalg.norm(force, axis=2), initial=0.0)) for force in forces)
    return LONGEST_ARROW * mechanism.size / largest if largest > 0.0 else None


def _log_joints(
    recording: rr.RecordingStream,
    mechanism: Mechanism,
    engine: str,
    run: Trajectory,
    arrow_scale: float | None,
) -> None:
    time = _time_column(run.time)
    for j, joint in enumerate(mechanism.joints):
        second = mechanism.body_index(joint.second)
        arm = mechanism.bodies[second].pose.point_to_body(joint.reaction_point)
        points = run.position[:, second] + rotated(run.quaternion[:, second], arm)
        path = rr.new_entity_path(["joints", engine, joint.name])
        look = rr.Points3D.from_fields(colors=JOINT_COLOR, radii=0.07 * mechanism.size)
        recording.log(path, look, static=True)
        recording.send_columns(path, [time], rr.Points3D.columns(positions=points))
        if run.reaction_force is not None and arrow_scale is not None:
            path = rr.new_entity_path(["reactions", engine, joint.name])
            arrow_look = rr.Arrows3D.from_fields(colors=REACTION_COLOR, radii=0.02 * mechanism.size)
            recording.log(path, arrow_look, static=True)
            arrows = rr.Arrows3D.columns(origins=points, vectors=arrow_scale * run.reaction_force[:, j])
            recording.send_columns(path, [time], arrows)


def _log_plot(
    recording: rr.RecordingStream,
    plot: Plot,
    times: dict[str, rr.TimeColumn],
    styles: dict[str, Style],
) -> None:
    for engine, values in plot.lines.items():
        path = rr.new_entity_path(["plots", *plot.path, engine])
        style = styles[engine]
        width = style.line_width if plot.lines_coincide else LINE_WIDTH
        line = rr.SeriesLines(colors=style.color, names=engine, widths=width)
        recording.log(path, line, static=True)
        recording.send_columns(path, [times[engine]], rr.Scalars.columns(scalars=values))
