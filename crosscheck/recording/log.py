"""A run of several engines as a Rerun recording.

Entities:
    /ground                      shapes of the fixed body, once
    /ground/mesh_K               its meshes
    /mechanism/ENGINE/BODY       shapes, and the body's pose over time
    /mechanism/ENGINE/BODY/mesh_K  its meshes
    /joints/ENGINE/JOINT         joint point on the second body over time
    /reactions/ENGINE/JOINT      constraint force on the second body over time
    /labels/BODY                 name of the body where the first engine has it
    /tilt/normal, /tilt/vertical  the axis whose tilt is plotted, on the first engine's body
    /wind/NAME                   an arrow upwind of the plate on the first engine's body, longest where the
                                 wind is fastest
    /plots/QUANTITY/.../ENGINE   scalars over time, see `crosscheck.recording.plots`; also `target` and
                                 `ENGINE_tolerance`
    /verdict                     the tables, as text
    /worst                       a line at each time at which a level of the runs is worst

Poses and arrows are for the eye and hold single precision; the scalars hold double precision.
Rerun's quaternions are x-y-z-w; `crosscheck.recording.shapes.xyzw` turns them round.

Recordings of one scene have one application id, so that a viewer that opens several lays them out alike
and switches between them, and each run has a recording id of its own.
"""

from __future__ import annotations

import os
import uuid
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import rerun as rr
from rerun import bindings

from crosscheck.recording.blueprint import TIME, blueprint, send_layout
from crosscheck.recording.mesh_budget import engines_with_meshes, without_meshes
from crosscheck.recording.plots import Plot, Tolerances, platforms, plots, rotated
from crosscheck.recording.shapes import Style, log_shapes, paths, xyzw
from crosscheck.support.palette import palette, rgb
from newton_euler.model.mechanism import Mechanism
from newton_euler.model.motions import TimeFunction
from newton_euler.model.scene import Scene
from newton_euler.model.state import State
from newton_euler.model.trajectory import Trajectory
from newton_euler.model.wind import WindLoad
from newton_euler.scalars import Array

GROUND_COLOR = (128, 128, 128)
PLAIN_COLOR = (220, 220, 220)
"""Color of joint points, labels and targets."""

WIND_COLOR = (86, 180, 233)

ARROW_COLOR = (240, 228, 66)
"""Color of reactions and of the vertical."""

DIRECTION_COLOR = (230, 159, 0)
"""Color of given directions, for example towards the sun."""

PIXEL = 0.002
"""Difference that is seen, in multiples of the mechanism's size."""

LINE_WIDTH = 1.5
"""Width of the thinnest lines in plots, points."""

LONGEST_ARROW = 1.0
"""Length of the largest reaction, in multiples of the mechanism's size."""

MOST_LABELS = 8
"""Bodies whose names are shown at first."""

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
    tolerances: Tolerances | None = None,
    moments: Sequence[tuple[float, str]] = (),
    directions: Mapping[str, Array] | None = None,
) -> None:
    """Log all there is to see of a run, and how the viewer lays it out.

    The first engine is solid. Those that part from it are ghosts; the others are hidden, as they would only
    cover it.

    Args:
        scene: what was run.
        trajectories: by engine, at the same output times as far as they came; the first is the one that the
            others are compared with.
        verdict: Markdown.
        title: of the recording, to tell it from others of the scene.
        tolerances: of differences and of drift, drawn beside them.
        moments: times, s, and what is worst there.
        directions: unit vectors (n, 3) in the world by name, drawn beside the axis whose tilt is plotted.
    """
    mechanism = scene.mechanism
    engines = list(trajectories)
    styles = _styles(engines)
    shown = plots(scene, trajectories, tolerances or {})
    arrow_scale = _arrow_scale(mechanism, trajectories)
    first = next(iter(trajectories.values()), None) or _at_rest(mechanism)
    apart = {engine: _apart(mechanism, first, trajectories[engine]) for engine in engines[1:]}
    near = [engine for engine, distance in apart.items() if distance <= PIXEL * mechanism.size]
    hidden = [["mechanism", engine] for engine in near] + [["joints", engine] for engine in engines[1:]]
    hidden += [["reactions"]] + [["labels"], ["tilt"]] * (len(mechanism.bodies) > MOST_LABELS)
    layout = blueprint(mechanism, first, shown, _heading(title, engines, apart, near), hidden, bool(moments))
    send_layout(recording, layout)
    recording.send_recording_name(title)
    text = f"{verdict}\nHidden engines, labels and reactions: eye icons of the blueprint panel, left.\n"
    if moments:
        text += "Bodies and joints in the table are links; times to click are behind the other tab.\n"
    if arrow_scale is not None:
        text += f"Of reactions 1 N is {arrow_scale:.2g} m long.\n"
    log_text(recording, "/verdict", text)
    if moments:
        times, lines = zip(*moments, strict=True)
        send_columns(recording, "/worst", np.array(times), rr.TextLog.columns, text=lines)
    meshed, bare = engines_with_meshes(mechanism, engines), without_meshes(mechanism)
    log_ground(recording, mechanism if meshed or not engines else bare, first)
    for engine, run in trajectories.items():
        drawn = mechanism if engine in meshed else bare
        log_bodies(recording, ["mechanism", engine], drawn, run, styles[engine])
        _log_joints(recording, mechanism, engine, run, arrow_scale)
    _log_labels(recording, mechanism, first)
    if any(plot.path[0] == "tilt" for plot in shown):
        _log_tilt(recording, mechanism, first, directions or {})
    for force in scene.forces:
        if isinstance(force, WindLoad):
            _log_wind(recording, mechanism, first, force)
    outputs = {engine: run.time for engine, run in trajectories.items()}
    for plot in shown:
        _log_plot(recording, plot, outputs, styles)


def recorded(log: Callable[..., None], scene: Scene, *args: Any, **more: Any) -> bytes:
    """Return the content of an .rrd of a scene that `log`, such as `log_run`, logs to with arguments.

    Rerun starts two threads for each recording. They end, and its memory is freed, after these steps alone:
    disconnect, drop all references to it, clean up.
    """
    recording = new_recording(scene)
    try:
        memory = recording.memory_recording()
        log(recording, scene, *args, **more)
        return bytes(memory.drain_as_bytes())
    finally:
        recording.disconnect()
        memory = None
        del recording
        bindings.flush_and_cleanup_orphaned_recordings()


def _styles(engines: list[str]) -> dict[str, Style]:
    """Choose styles: the first engine's bodies are solid, those of the others ghosts.

    The viewer draws lines in the order of their names. Each is thinner than the one before it, so that lines
    that coincide all show.
    """
    thinnest_first = sorted(engines, reverse=True)
    return {
        engine: Style(rgb(color), LINE_WIDTH + 2.0 * thinnest_first.index(engine), engine != engines[0])
        for engine, color in palette(engines).items()
    }


def _at_rest(mechanism: Mechanism) -> Trajectory:
    """Stand in for the run of a scene that no engine came anywhere with."""
    start, names = State.initial(mechanism), (mechanism.body_names, mechanism.joint_names)
    return Trajectory("", {}, 0.0, np.zeros(1), *names, start.position[None], start.quaternion[None])


def _apart(mechanism: Mechanism, first: Trajectory, other: Trajectory) -> float:
    """The largest distance, m, between what is drawn of two runs at any output."""
    n = min(len(first.time), len(other.time))
    ways = (
        paths(mechanism, body, first)[:n] - paths(mechanism, body, other)[:n]
        for body in range(len(mechanism.bodies))
    )
    return max(float(np.max(np.linalg.norm(way, axis=2))) for way in ways)


def _heading(title: str, engines: list[str], apart: dict[str, float], near: list[str]) -> str:
    """Say which engines the 3-D view shows."""
    parts = [f"{engine} solid" for engine in engines[:1]]
    parts += [f"{engine} ghost, up to {apart[engine]:.2g} m away" for engine in apart if engine not in near]
    if near:
        within = max(apart[engine] for engine in near)
        parts.append(f"{', '.join(near)} hidden, within {within:.0e} m")
    return f"{title}: {'; '.join(parts)}"


def send_columns(
    recording: rr.RecordingStream,
    path: str,
    time: Array,
    columns: Callable[..., Any],
    **values: Array | Sequence[str],
) -> None:
    """Log values, (n, ...) each, at times (n,), s."""
    nanoseconds = np.round(time * 1e9).astype("timedelta64[ns]")
    recording.send_columns(path, [rr.TimeColumn(TIME, duration=nanoseconds)], columns(**values))


def send_pose(
    recording: rr.RecordingStream, path: str, time: Array, position: Array, quaternion: Array
) -> None:
    """Log poses (n, 3) and (n, 4) at times (n,), s."""
    pose = rr.Transform3D.columns
    send_columns(recording, path, time, pose, translation=position, quaternion=xyzw(quaternion))


def log_text(recording: rr.RecordingStream, path: str, text: str) -> None:
    """Log Markdown."""
    recording.log(path, rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN), static=True)


def log_ground(recording: rr.RecordingStream, mechanism: Mechanism, run: Trajectory) -> None:
    """Draw the fixed body where a run has it."""
    recording.log("/", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    log_shapes(recording, "/ground", mechanism, 0, Style(GROUND_COLOR))
    send_pose(recording, "/ground", run.time[:1], run.position[:1, 0], run.quaternion[:1, 0])


def log_bodies(
    recording: rr.RecordingStream, folder: Sequence[str], mechanism: Mechanism, run: Trajectory, style: Style
) -> None:
    """Draw the moving bodies of a run over time; the parts of their paths are those of `folder` and names."""
    for k in range(1, len(mechanism.bodies)):
        path = rr.new_entity_path([*folder, mechanism.body_names[k]])
        log_shapes(recording, path, mechanism, k, style)
        send_pose(recording, path, run.time, run.position[:, k], run.quaternion[:, k])


def _log_labels(recording: rr.RecordingStream, mechanism: Mechanism, run: Trajectory) -> None:
    """Label bodies at their centers of mass; the ground, which others stand on, at its lowest point."""
    ground = paths(mechanism, 0, run)[0]
    for k, name in enumerate(mechanism.body_names):
        path = rr.new_entity_path(["labels", name])
        label = rr.Points3D(np.zeros(3), labels=name, colors=PLAIN_COLOR, radii=0.0)
        recording.log(path, label, static=True)
        position = run.position[:, k] if k else ground[[np.argmin(ground[:, 2])]]
        send_pose(recording, path, run.time[: len(position)], position, run.quaternion[: len(position), k])


def _log_tilt(
    recording: rr.RecordingStream, mechanism: Mechanism, run: Trajectory, directions: Mapping[str, Array]
) -> None:
    """Draw the axis whose tilt is plotted, the vertical and given directions, from the center of mass."""
    body, size = platforms(mechanism)[-1], mechanism.size
    position, quaternion = run.position[:, body], run.quaternion[:, body]
    upright = np.broadcast_to([1.0, 0.0, 0.0, 0.0], quaternion.shape)
    for name, turn, length, color in (
        ("normal", quaternion, 0.6 * size, PLAIN_COLOR),
        ("vertical", upright, 0.9 * size, ARROW_COLOR),
    ):
        arrow = rr.Arrows3D(vectors=[0.0, 0.0, length], labels=name, colors=color, radii=0.02 * size)
        recording.log(f"/tilt/{name}", arrow, static=True)
        send_pose(recording, f"/tilt/{name}", run.time, position, turn)
    for name, vectors in directions.items():
        look = rr.Arrows3D.from_fields(labels=[name], colors=DIRECTION_COLOR, radii=0.02 * size)
        recording.log(f"/tilt/{name}", look, static=True)
        ends = {"origins": position, "vectors": 1.2 * size * vectors}
        send_columns(recording, f"/tilt/{name}", run.time, rr.Arrows3D.columns, **ends)


def _log_wind(recording: rr.RecordingStream, mechanism: Mechanism, run: Trajectory, load: WindLoad) -> None:
    """Draw the velocity of wind as an arrow towards the center of the plate, upwind of it."""
    body = mechanism.body_index(load.body)
    arm = mechanism.bodies[body].pose.point_to_body(load.point)
    centers = run.position[:, body] + rotated(run.quaternion[:, body], arm)
    velocities = np.array([load.velocity(float(time)) for time in run.time])
    fastest = float(np.max(np.linalg.norm(velocities, axis=1)))
    vectors = LONGEST_ARROW * mechanism.size / (fastest or 1.0) * velocities
    path = rr.new_entity_path(["wind", load.name])
    look = rr.Arrows3D.from_fields(colors=WIND_COLOR, radii=0.01 * mechanism.size, labels=load.name)
    recording.log(path, look, static=True)
    before = 0.5 * np.linalg.norm(load.lengths) * load.direction / np.linalg.norm(load.direction)
    send_columns(
        recording, path, run.time, rr.Arrows3D.columns, origins=centers - before - vectors, vectors=vectors
    )


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
        arm = mechanism.reaction_arms[j]
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


def _log_plot(
    recording: rr.RecordingStream,
    plot: Plot,
    times: dict[str, Array],
    styles: dict[str, Style],
) -> None:
    def log(name: str, look: rr.SeriesLines, time: Array, values: Array) -> None:
        path = rr.new_entity_path(["plots", *plot.path, name])
        recording.log(path, look, static=True)
        send_columns(recording, path, time, rr.Scalars.columns, scalars=values)

    for engine, values in plot.lines.items():
        style = styles[engine]
        width = LINE_WIDTH if plot.judges else style.line_width
        look = rr.SeriesLines(colors=style.color, names=engine, widths=width)
        # a difference of two runs ends with the shorter
        time = times[engine][: len(values)] if plot.judges else times[engine]
        log(engine, look, time, values)
        if engine in plot.tolerances:
            look = rr.SeriesLines(colors=style.color, names=engine, widths=0.5 * LINE_WIDTH)
            log(f"{engine}_tolerance", look, time[[0, -1]], np.full(2, plot.tolerances[engine]))
    if plot.target is not None:
        time = max(times.values(), key=len)
        look = rr.SeriesLines(colors=PLAIN_COLOR, names="target", widths=0.5 * LINE_WIDTH)
        if isinstance(plot.target, TimeFunction):
            log("target", look, time, np.array([plot.target.value(float(t)) for t in time]))
        else:
            log("target", look, time[[0, -1]], np.full(2, plot.target))
