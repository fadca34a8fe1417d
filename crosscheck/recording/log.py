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
    /logs/NAME/reference/BODY, /logs/NAME/log/BODY  shapes and poses of the reference of a log, a run that
                                 another simulator wrote, and of the log, in a 3-D view of their own
    /labels/BODY                 name of the body, at its position in the first engine's run
    /tilt/normal, /tilt/vertical  the axis whose tilt is plotted, and the vertical, in the first engine's run
    /wind/NAME                   wind velocity, as an arrow upwind of the plate, in the first engine's run
    /plots/QUANTITY/.../ENGINE   scalars over time, see `crosscheck.recording.plots`; also `target` and
                                 `ENGINE_tolerance`
    /verdict                     the verdict and the tables of the crosscheck, as text
    /worst                       the check closest to failing of each level (group of checks, from the model
                                 to whole runs), as text at its time
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
import rerun as rr

from crosscheck.engines.palette import palette
from crosscheck.own_run.allowed import OWN_RUN, REDUCED_RUN
from crosscheck.own_run.judge import Judgement
from crosscheck.recording.blueprint import blueprint, send_layout
from crosscheck.recording.entities import (
    MIN_VISIBLE_DISTANCE,
    PLAIN_COLOR,
    heading,
    log_bodies,
    log_ground,
    log_joints,
    log_labels,
    log_tilt,
    log_wind,
    reaction_arrow_scale,
)
from crosscheck.recording.logged_runs import logged_runs
from crosscheck.recording.mesh_budget import engines_with_meshes, without_meshes
from crosscheck.recording.own_run import YOUR_SETTINGS, displaced, error_plots
from crosscheck.recording.plots import Plot, Tolerances, plots
from crosscheck.recording.shapes import Style, largest_distance
from crosscheck.recording.stream import log_text, send_columns
from crosscheck.support.colors import rgb
from newton_euler.model.mechanism import Mechanism
from newton_euler.model.motions import TimeFunction
from newton_euler.model.scene import Scene
from newton_euler.model.state import State
from newton_euler.model.trajectory import Trajectory
from newton_euler.model.wind import WindLoad
from newton_euler.scalars import Array

if TYPE_CHECKING:  # most recordings have no logs
    from crosscheck.logs.judge import LogJudgement

LINE_WIDTH = 1.5
"""Width of the thinnest lines of engines in plots, points."""

MAX_LABELS = 8
"""Largest number of bodies for which their names are shown at first."""


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
    logs: Mapping[str, LogJudgement] | None = None,
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
        logs: judgements of logs, by name. Each has its own 3-D view, in which the log is a ghost beside its
            reference; its error is plotted.
    """
    # what to draw: plots, and which engines deviate visibly from the first
    mechanism = scene.mechanism
    engines, logged = list(trajectories), logged_runs(logs or {})
    styles = _styles(engines)
    shown_plots = plots(scene, trajectories, tolerances or {})
    arrow_scale = reaction_arrow_scale(mechanism, trajectories)
    first = next(iter(trajectories.values()), None) or _initial_pose(mechanism)
    output_times = {engine: run.time for engine, run in trajectories.items()}
    drawn, ghosts = dict(trajectories), engines[1:]
    if own_run is not None and engines:
        # the first engine's run, displaced by the error of the own run
        shown_run = own_run.shown
        drawn[YOUR_SETTINGS] = displaced(first, shown_run)
        ghosts = [*ghosts, YOUR_SETTINGS]
        color = rgb(palette([YOUR_SETTINGS])[YOUR_SETTINGS])
        styles[YOUR_SETTINGS] = Style(color, LINE_WIDTH, ghost=True)
        group = f"error of {OWN_RUN if shown_run is own_run else REDUCED_RUN}"
        shown_plots = [*error_plots(shown_run, group, (YOUR_SETTINGS,)), *shown_plots]
        output_times[YOUR_SETTINGS] = shown_run.run.time
    distances = {name: largest_distance(mechanism, first, drawn[name]) for name in ghosts}
    visible = MIN_VISIBLE_DISTANCE * mechanism.size
    hidden_ghosts = [name for name, distance in distances.items() if distance <= visible]

    # layout and text
    hidden = [["mechanism", name] for name in hidden_ghosts] + [["joints", name] for name in engines[1:]]
    hidden.append(["reactions"])
    if len(mechanism.bodies) > MAX_LABELS:
        hidden += [["labels"], ["tilt"]]
    main_heading = heading(title, engines, distances, hidden_ghosts)
    end = max(float(run.time[-1]) for run in (first, *(log.run for log in logged)))
    views = [log.view() for log in logged]
    all_plots = [*(plot for log in logged for plot in log.plots), *shown_plots]
    layout = blueprint(mechanism, first, all_plots, main_heading, hidden, bool(moments), end, views)
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
    in_logs = [f"{log.name}: {part}" for log in logged for part in ("reference", "log")]
    meshed, bare = engines_with_meshes(mechanism, [*drawn, *in_logs]), without_meshes(mechanism)
    log_ground(recording, mechanism if meshed or not engines else bare, first)
    for name, run in drawn.items():
        shown_mechanism = mechanism if name in meshed else bare
        log_bodies(recording, ["mechanism", name], shown_mechanism, run, styles[name])
    for engine, run in trajectories.items():
        log_joints(recording, mechanism, engine, run, arrow_scale)
    log_labels(recording, mechanism, first)
    if any(plot.path[0] == "tilt" for plot in shown_plots):
        log_tilt(recording, mechanism, first, directions or {})
    for force in scene.forces:
        if isinstance(force, WindLoad):
            log_wind(recording, mechanism, first, force)

    for log in logged:
        log.draw(recording, has_meshes=f"{log.name}: log" in meshed)
        for plot in log.plots:
            look = Style(log.color, LINE_WIDTH)
            _log_plot(recording, plot, {log.name: log.run.time}, {log.name: look})
    for plot in shown_plots:
        _log_plot(recording, plot, output_times, styles)


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
