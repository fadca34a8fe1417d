"""Record the runs of several engines for the Rerun viewer.

Engines are simulators that simulated the same scene (a mechanism with its forces and initial state). A
recording is a tree of entities. An entity is a path with data: constant ones, or values over time. In the
paths below, ENGINE, BODY, JOINT, QUANTITY and NAME stand for names, K for a number:

    /ground                      shapes of the fixed body, once
    /ground/mesh_K               meshes of the fixed body
    /mechanism/ENGINE/BODY       shapes, and the body's pose over time
    /mechanism/ENGINE/BODY/mesh_K  the body's meshes
    /joints/ENGINE/JOINT         joint point, on the joint's second body, over time
    /reactions/ENGINE/JOINT      constraint force on the joint's second body over time
    /mechanism/your_settings/BODY  shapes and pose in the "own run", which the model file's engine makes with
                                 the settings of the file; meshes as for engines
    /labels/BODY                 name of the body, at its position in the first engine's run
    /tilt/normal, /tilt/vertical  the axis whose tilt is plotted, and the vertical, in the first engine's run
    /wind/NAME                   wind velocity, as an arrow upwind of the plate, in the first engine's run
    /plots/QUANTITY/.../ENGINE   scalars over time, see `crosscheck.recording.plots`; also `target` and
                                 `ENGINE_tolerance`
    /verdict                     the verdict and the tables of the crosscheck, as text
    /worst                       the check closest to failing of each level (group of checks, from the model
                                 to whole runs), as text at its time

Poses and arrows are stored in single precision, scalars in double precision. Rerun's quaternions have the
order (x, y, z, w); `crosscheck.recording.shapes.xyzw` converts them.

All recordings of a scene have the same application id, and each has a different recording id. A viewer that
opens several recordings of a scene shows them in the same layout, and the user can switch between them.
"""

from __future__ import annotations

import os
import uuid
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import rerun as rr
from rerun import bindings

from crosscheck.own_run.judge import Judgement
from crosscheck.recording.blueprint import TIME, blueprint, send_layout
from crosscheck.recording.mesh_budget import engines_with_meshes, without_meshes
from crosscheck.recording.own_run import YOUR_SETTINGS, displaced, error_plots
from crosscheck.recording.plots import Plot, Tolerances, platforms, plots, rotated
from crosscheck.recording.shapes import Style, drawn_points, log_shapes, xyzw
from crosscheck.support.palette import palette, rgb
from newton_euler.model.mechanism import Mechanism
from newton_euler.model.motions import TimeFunction
from newton_euler.model.scene import Scene
from newton_euler.model.state import State
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

MIN_VISIBLE_DISTANCE = 0.002
"""Smallest distance of a body in two engines that a user can see, in multiples of the mechanism's size."""

LINE_WIDTH = 1.5
"""Width of the thinnest lines of engines in plots, points."""

LONGEST_ARROW = 1.0
"""Length of the arrow of the largest reaction force, in multiples of the mechanism's size."""

MAX_LABELS = 8
"""Largest number of bodies for which their names are shown at first."""

RERUN_SWITCH = "RERUN"
"""Environment variable by which users turn off Rerun's logging; it has no effect on these recordings."""


def application_id(scene: Scene) -> str:
    """Return the application id that all recordings of a scene share."""
    return f"crosscheck_{scene.name}"


def new_recording(scene: Scene) -> rr.RecordingStream:
    """Make an empty recording of a scene, with a new recording id."""
    rr.set_strict_mode(True)  # errors raise instead of printing a warning
    users_switch = os.environ.pop(RERUN_SWITCH, None)
    try:
        return rr.RecordingStream(application_id(scene), recording_id=uuid.uuid4())
    finally:
        if users_switch is not None:
            os.environ[RERUN_SWITCH] = users_switch


def log_run(
    recording: rr.RecordingStream,
    scene: Scene,
    trajectories: dict[str, Trajectory],
    verdict: str,
    title: str,
    tolerances: Tolerances | None = None,
    moments: Sequence[tuple[float, str]] = (),
    directions: Mapping[str, Array] | None = None,
    own_run: Judgement | None = None,
) -> None:
    """Record the runs of all engines, plots, the verdict and the layout of the viewer.

    The first engine's bodies are solid. Another engine's bodies are transparent ghosts if they visibly
    deviate from the first engine's, and hidden otherwise.

    Args:
        recording: recording to write to.
        scene: the scene that the engines simulated.
        trajectories: run of each engine, by name. All have the same output times, up to where each run ends.
            The other engines are compared with the first.
        verdict: text to show, Markdown.
        title: name of the recording, which distinguishes it from other recordings of the scene.
        tolerances: tolerances of the differences and of the constraint violations, for the plots.
        moments: pairs of a time, s, and a text on the check that is closest to failing there.
        directions: further unit vectors (n, 3), world frame, by name, to draw with the axis whose tilt is
            plotted.
        own_run: judgement of the own run, which is drawn as a further ghost; its error is plotted.
    """
    # what to draw: plots, and which engines deviate visibly from the first
    mechanism = scene.mechanism
    engines = list(trajectories)
    styles = _styles(engines)
    shown_plots = plots(scene, trajectories, tolerances or {})
    arrow_scale = _arrow_scale(mechanism, trajectories)
    first = next(iter(trajectories.values()), None) or _initial_pose(mechanism)
    output_times = {engine: run.time for engine, run in trajectories.items()}
    drawn, ghosts = dict(trajectories), engines[1:]
    if own_run is not None and engines:
        # the first engine's run, displaced by the error of the own run
        drawn[YOUR_SETTINGS] = displaced(first, own_run)
        ghosts = [*ghosts, YOUR_SETTINGS]
        color = rgb(palette([YOUR_SETTINGS])[YOUR_SETTINGS])
        styles[YOUR_SETTINGS] = Style(color, LINE_WIDTH, ghost=True)
        shown_plots = [*error_plots(own_run), *shown_plots]
        output_times[YOUR_SETTINGS] = own_run.run.time
    distances = {name: _largest_distance(mechanism, first, drawn[name]) for name in ghosts}
    visible = MIN_VISIBLE_DISTANCE * mechanism.size
    hidden_ghosts = [name for name, distance in distances.items() if distance <= visible]

    # layout and text
    hidden = [["mechanism", name] for name in hidden_ghosts] + [["joints", name] for name in engines[1:]]
    hidden.append(["reactions"])
    if len(mechanism.bodies) > MAX_LABELS:
        hidden += [["labels"], ["tilt"]]
    heading = _heading(title, engines, distances, hidden_ghosts)
    layout = blueprint(mechanism, first, shown_plots, heading, hidden, moments=bool(moments))
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

    # 3-D view; meshes only for as many engines as the size limit of recordings allows
    meshed, bare = engines_with_meshes(mechanism, list(drawn)), without_meshes(mechanism)
    log_ground(recording, mechanism if meshed or not engines else bare, first)
    for name, run in drawn.items():
        shown_mechanism = mechanism if name in meshed else bare
        log_bodies(recording, ["mechanism", name], shown_mechanism, run, styles[name])
    for engine, run in trajectories.items():
        _log_joints(recording, mechanism, engine, run, arrow_scale)
    _log_labels(recording, mechanism, first)
    if any(plot.path[0] == "tilt" for plot in shown_plots):
        _log_tilt(recording, mechanism, first, directions or {})
    for force in scene.forces:
        if isinstance(force, WindLoad):
            _log_wind(recording, mechanism, first, force)

    for plot in shown_plots:
        _log_plot(recording, plot, output_times, styles)


def recorded(log: Callable[..., None], scene: Scene, *args: Any, **more: Any) -> bytes:
    """Make a recording of a scene, and return the content of its file (.rrd).

    Args:
        log: function that writes to the recording, such as `log_run`; called with the recording, the scene
            and the further arguments.
        scene: the scene.
        args, more: further arguments of `log`.
    """
    # Rerun starts two threads for each recording. Only the three steps in `finally` end the threads and free
    # the memory: disconnect, drop all references to the recording, clean up.
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
    """Choose the style of each engine: the first engine's bodies are solid, those of the others ghosts.

    The viewer draws lines in the alphabetical order of their names. Each line is thinner than the previous
    one, so that all of several coinciding lines are visible.
    """
    thinnest_first = sorted(engines, reverse=True)
    return {
        engine: Style(
            rgb(color),
            line_width=LINE_WIDTH + 2.0 * thinnest_first.index(engine),
            ghost=engine != engines[0],
        )
        for engine, color in palette(engines).items()
    }


def _initial_pose(mechanism: Mechanism) -> Trajectory:
    """Make a trajectory of one output, the initial pose, to draw if no engine has a run."""
    start = State.initial(mechanism)
    return Trajectory(
        engine="",
        settings={},
        wall_time=0.0,
        time=np.zeros(1),
        body_names=mechanism.body_names,
        joint_names=mechanism.joint_names,
        position=start.position[None],
        quaternion=start.quaternion[None],
    )


def _largest_distance(mechanism: Mechanism, first: Trajectory, other: Trajectory) -> float:
    """Compute the largest distance, m, of any point of a drawn body in two runs at the same time."""
    n = min(len(first.time), len(other.time))
    differences = (
        drawn_points(mechanism, body, first)[:n] - drawn_points(mechanism, body, other)[:n]
        for body in range(len(mechanism.bodies))
    )
    return max(float(np.max(np.linalg.norm(difference, axis=2))) for difference in differences)


def _heading(title: str, engines: list[str], distances: dict[str, float], hidden: list[str]) -> str:
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


def send_columns(
    recording: rr.RecordingStream,
    path: str,
    time: Array,
    columns: Callable[..., Any],
    **values: Array | Sequence[str],
) -> None:
    """Record values over time.

    Args:
        recording: recording to write to.
        path: path of the entity.
        time: times (n,), s.
        columns: Rerun's function for this kind of entity, such as `rr.Scalars.columns`.
        values: arguments of that function, each of length n.
    """
    nanoseconds = np.round(time * 1e9).astype("timedelta64[ns]")
    recording.send_columns(path, [rr.TimeColumn(TIME, duration=nanoseconds)], columns(**values))


def send_pose(
    recording: rr.RecordingStream, path: str, time: Array, position: Array, quaternion: Array
) -> None:
    """Record positions (n, 3), m, and quaternions (n, 4), (w, x, y, z), of an entity at times (n,), s."""
    pose = rr.Transform3D.columns
    send_columns(recording, path, time, pose, translation=position, quaternion=xyzw(quaternion))


def log_text(recording: rr.RecordingStream, path: str, text: str) -> None:
    """Record a text, Markdown, that does not change over time."""
    recording.log(path, rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN), static=True)


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
        run: run with the poses of the bodies.
        style: color and look of the bodies.
    """
    for k in range(1, len(mechanism.bodies)):
        path = rr.new_entity_path([*folder, mechanism.body_names[k]])
        log_shapes(recording, path, mechanism, k, style)
        send_pose(recording, path, run.time, run.position[:, k], run.quaternion[:, k])


def _log_labels(recording: rr.RecordingStream, mechanism: Mechanism, run: Trajectory) -> None:
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


def _log_tilt(
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


def _log_wind(recording: rr.RecordingStream, mechanism: Mechanism, run: Trajectory, load: WindLoad) -> None:
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


def _arrow_scale(mechanism: Mechanism, trajectories: dict[str, Trajectory]) -> float | None:
    """Compute the length of reaction arrows, m per N; None if there are no reactions or all are zero."""
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


def _log_plot(
    recording: rr.RecordingStream,
    plot: Plot,
    times: dict[str, Array],
    styles: dict[str, Style],
) -> None:
    """Record the lines of a plot: a line per engine, its tolerance, and the target of a controller.

    If `plot.is_judged`, the lines are differences or constraint violations, by which engines are judged.
    Otherwise the lines are a quantity of the motion, and coincide if the engines agree.

    Args:
        recording: recording to write to.
        plot: the plot.
        times: output times (n,), s, by engine.
        styles: styles by engine.
    """

    def log(name: str, look: rr.SeriesLines, time: Array, values: Array) -> None:
        path = rr.new_entity_path(["plots", *plot.path, name])
        recording.log(path, look, static=True)
        send_columns(recording, path, time, rr.Scalars.columns, scalars=values)

    for engine, values in plot.lines.items():
        style = styles[engine]
        width = LINE_WIDTH if plot.is_judged else style.line_width
        look = rr.SeriesLines(colors=style.color, names=engine, widths=width)
        # a difference of two runs ends with the shorter run
        time = times[engine][: len(values)] if plot.is_judged else times[engine]
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
