"""A run of several engines as a Rerun recording.

Entities:
    /ground                      shapes of the fixed body, once
    /ground/mesh_K               its meshes
    /mechanism/ENGINE/BODY       shapes, and the body's pose over time
    /mechanism/ENGINE/BODY/mesh_K  its meshes
    /joints/ENGINE/JOINT         joint point on the second body over time
    /reactions/ENGINE/JOINT      constraint force on the second body over time
    /plots/QUANTITY/.../ENGINE   scalars over time, see `crosscheck.recording.plots`
    /verdict                     the tables, as text

Poses and arrows are for the eye and hold single precision; the scalars hold double precision.
Rerun's quaternions are x-y-z-w; `crosscheck.recording.shapes.xyzw` turns them round.

Recordings of one scene have one application id, so that a viewer that opens several lays them out alike
and switches between them, and each run has a recording id of its own.
"""

from __future__ import annotations

import os
import uuid
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr

from crosscheck.files import write_files
from crosscheck.recording.blueprint import blueprint
from crosscheck.recording.plots import Plot, plots, rotated
from crosscheck.recording.shapes import Style, log_shapes, xyzw
from newton_euler.model.mechanism import Mechanism
from newton_euler.model.scene import Scene
from newton_euler.model.trajectory import Trajectory
from newton_euler.scalars import Array

COLORS = ((230, 159, 0), (86, 180, 233), (204, 121, 167), (0, 158, 115))
"""One color an engine: M. Okabe and K. Ito, Color Universal Design, 2008."""

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


TIME = "time"
"""The timeline of a recording."""

SWITCH = "RERUN"
"""Environment variable that turns off logging; a recording that is asked for is made all the same."""


def application_id(scene: Scene) -> str:
    """Return the identifier that recordings of a scene have in common."""
    return f"crosscheck_{scene.name}"


def new_recording(scene: Scene) -> rr.RecordingStream:
    """A recording with an id of its own, that nothing is logged to yet."""
    rr.set_strict_mode(True)
    chosen = os.environ.pop(SWITCH, None)
    try:
        return rr.RecordingStream(application_id(scene), recording_id=uuid.uuid4())
    finally:
        if chosen is not None:
            os.environ[SWITCH] = chosen


def log_run(
    recording: rr.RecordingStream,
    scene: Scene,
    trajectories: dict[str, Trajectory],
    verdict: str,
    title: str,
) -> None:
    """Log all there is to see of a run, and how the viewer lays it out.

    Args:
        scene: what was run.
        trajectories: by engine, at the same output times as far as they came; the first is the one that the
            others are compared with.
        verdict: Markdown.
        title: of the recording, to tell it from others of the scene.
    """
    mechanism = scene.mechanism
    styles = _styles(list(trajectories), mechanism.size)
    shown = plots(scene, trajectories)
    arrow_scale = _arrow_scale(mechanism, trajectories)
    heading = title if arrow_scale is None else f"{title} (reactions: 1 N is {arrow_scale:.2g} m)"
    layout = blueprint(mechanism, list(trajectories), shown, heading, TIME)
    recording.send_blueprint(layout, make_active=False)
    recording.send_recording_name(title)
    recording.log("/", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    recording.log("/verdict", rr.TextDocument(verdict, media_type=rr.MediaType.MARKDOWN), static=True)
    _log_ground(recording, mechanism)
    for engine, run in trajectories.items():
        _log_bodies(recording, mechanism, engine, run, styles[engine])
        _log_joints(recording, mechanism, engine, run, arrow_scale)
    times = {engine: run.time for engine, run in trajectories.items()}
    for plot in shown:
        _log_plot(recording, plot, times, styles)


def recorded(
    scene: Scene,
    trajectories: dict[str, Trajectory],
    verdict: str,
    title: str,
) -> bytes:
    """The content of an .rrd; arguments as of `log_run`."""
    recording = new_recording(scene)
    memory = recording.memory_recording()
    log_run(recording, scene, trajectories, verdict, title)
    return bytes(memory.drain_as_bytes())


def write_recording(
    path: str | os.PathLike[str],
    scene: Scene,
    trajectories: dict[str, Trajectory],
    verdict: str,
    title: str | None = None,
) -> None:
    """Write an .rrd; the file appears whole or not at all. Arguments as of `log_run`.

    Args:
        title: the scene's name if None.

    Raises:
        CrosscheckError: if the file cannot be written to its end.
    """
    # in memory first: Rerun's own writer would wait for ever on a disk that is full
    content = recorded(scene, trajectories, verdict, title or scene.name)
    write_files({Path(path): content})


def _styles(engines: list[str], size: float) -> dict[str, Style]:
    """Choose styles by which engines that agree can still be told apart.

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


def _send(
    recording: rr.RecordingStream,
    path: str,
    time: Array,
    columns: Callable[..., Any],
    **values: Array,
) -> None:
    """Log values, (n, ...) each, at times (n,), s."""
    nanoseconds = np.round(time * 1e9).astype("timedelta64[ns]")
    recording.send_columns(path, [rr.TimeColumn(TIME, duration=nanoseconds)], columns(**values))


def _log_ground(recording: rr.RecordingStream, mechanism: Mechanism) -> None:
    body = mechanism.bodies[0]
    quaternion = rr.Quaternion(xyzw=xyzw(body.quaternion))
    pose = rr.Transform3D(translation=body.center_of_mass, quaternion=quaternion)
    recording.log("/ground", pose, static=True)
    style = Style(GROUND_COLOR, 0.0, rr.components.FillMode.Solid, 0, 0.0)
    log_shapes(recording, "/ground", mechanism, 0, style)


def _log_bodies(
    recording: rr.RecordingStream,
    mechanism: Mechanism,
    engine: str,
    run: Trajectory,
    style: Style,
) -> None:
    for k in range(1, len(mechanism.bodies)):
        path = rr.new_entity_path(["mechanism", engine, mechanism.body_names[k]])
        log_shapes(recording, path, mechanism, k, style)
        position, quaternion = run.position[:, k], xyzw(run.quaternion[:, k])
        pose = rr.Transform3D.columns
        _send(recording, path, run.time, pose, translation=position, quaternion=quaternion)


def _arrow_scale(mechanism: Mechanism, trajectories: dict[str, Trajectory]) -> float | None:
    """Meters a newton; None without reactions."""
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
    for j, joint in enumerate(mechanism.joints):
        second = mechanism.body_index(joint.second)
        arm = mechanism.bodies[second].pose.point_to_body(joint.reaction_point)
        points = run.position[:, second] + rotated(run.quaternion[:, second], arm)
        path = rr.new_entity_path(["joints", engine, joint.name])
        look = rr.Points3D.from_fields(colors=JOINT_COLOR, radii=0.07 * mechanism.size)
        recording.log(path, look, static=True)
        _send(recording, path, run.time, rr.Points3D.columns, positions=points)
        if run.reaction_force is not None and arrow_scale is not None:
            path = rr.new_entity_path(["reactions", engine, joint.name])
            arrow_look = rr.Arrows3D.from_fields(colors=REACTION_COLOR, radii=0.02 * mechanism.size)
            recording.log(path, arrow_look, static=True)
            vectors = arrow_scale * run.reaction_force[:, j]
            arrows = rr.Arrows3D.columns
            _send(recording, path, run.time, arrows, origins=points, vectors=vectors)


def _log_plot(
    recording: rr.RecordingStream,
    plot: Plot,
    times: dict[str, Array],
    styles: dict[str, Style],
) -> None:
    for engine, values in plot.lines.items():
        path = rr.new_entity_path(["plots", *plot.path, engine])
        style = styles[engine]
        width = style.line_width if plot.lines_coincide else LINE_WIDTH
        line = rr.SeriesLines(colors=style.color, names=engine, widths=width)
        recording.log(path, line, static=True)
        time = times[engine][: len(values)] if plot.compares else times[engine]
        _send(recording, path, time, rr.Scalars.columns, scalars=values)
