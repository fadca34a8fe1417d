"""Layout of a recording in the viewer."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from crosscheck.recording.plots import Plot
from crosscheck.recording.shapes import paths
from newton_euler.model.mechanism import Mechanism
from newton_euler.model.trajectory import Trajectory

Y, Z = np.eye(3)[1:]

TIME = "time"
"""The timeline of a recording."""

EYE_DIRECTION = np.array([0.35, -0.78, 0.72])
"""Direction from the mechanism to the camera, for motions that are not planar."""

FLATNESS = 1e-4
"""Largest motion across a plane that is motion in it, as a share of the motion along it."""

HALF_ANGLE = np.radians(27.5)
"""Half of the angle that the camera sees from top to bottom."""

ASPECT, MARGIN = 1.3, 1.1
"""Width by height of what the camera sees at least, and its distance by the least that shows all."""

LOWER = 1.4
"""Height of the verdict and of what engines are judged by, by that of the mechanism and its motion."""

MOST_COLUMNS = 3
"""Plots side by side in one group."""


QUICKEST, SLOWEST = 4.0, 60.0
"""s that a recording is played, if the motion takes less or more."""


class Layout(rrb.Blueprint):  # type: ignore[misc]  # Rerun is untyped here
    """A blueprint that keeps the stream to which Rerun writes it.

    Rerun drops that stream without closing it, and two of its threads would stay behind.
    """

    stream: rr.RecordingStream | None = None

    def _log_to_stream(self, stream: rr.RecordingStream) -> None:
        self.stream = stream
        super()._log_to_stream(stream)


def send_layout(recording: rr.RecordingStream, layout: Layout) -> None:
    """Lay out a recording, and close the stream that the layout was written to."""
    # active, or a viewer in a browser would choose its own layout
    recording.send_blueprint(layout)
    if layout.stream is not None:
        layout.stream.disconnect()
        layout.stream = None


def blueprint(
    mechanism: Mechanism,
    run: Trajectory,
    plots: list[Plot],
    heading: str,
    hidden: Sequence[Sequence[str]],
    moments: bool,
) -> Layout:
    """The mechanism and the verdict at the left, two rows of plots over a timeline at the right.

    Args:
        run: what the camera is placed by.
        heading: of the 3-D view.
        hidden: parts of the paths of entities that are not shown at first.
        moments: whether there is a log of the worst ones, in a tab behind the verdict: its times can be
            clicked, and links to times, beside those to entities, do not exist in text.
    """
    contents = ["+ /**", "- /plots/**", "- /verdict", "- /worst"]
    overrides = {rr.new_entity_path(path): rrb.EntityBehavior(visible=False) for path in hidden}
    drawn = scene_view(mechanism, run, heading, contents, overrides=overrides)
    texts: list[rrb.View] = [rrb.TextDocumentView(origin="/verdict", name="Verdict")]
    if moments:
        columns = rrb.TextLogColumns(timeline_columns=[TIME], text_log_columns=["body"])
        texts.append(rrb.TextLogView(origin="/worst", name="Worst moments: click a time", columns=columns))
    rows = [[plot for plot in plots if plot.judges is judges] for judges in (False, True)]
    end = float(run.time[-1])
    plotted = [_row(row, end) for row in rows if row]
    return laid_out(
        rrb.Horizontal(
            rrb.Vertical(drawn, rrb.Tabs(*texts, active_tab=0), row_shares=[1.0, LOWER]),
            rrb.Vertical(*plotted, row_shares=[1.0, LOWER][: len(plotted)]),
            column_shares=[1.0, 1.2],
        ),
        end,
    )


def laid_out(views: rrb.Container, duration: float = QUICKEST) -> Layout:
    """Show these views with all panels out of the way, over and over again.

    Days are played in a minute, milliseconds in seconds.
    """
    shown = min(max(duration, QUICKEST), SLOWEST)
    return Layout(
        views,
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline=TIME, playback_speed=duration / shown, loop_mode="all"),
        auto_layout=False,
        auto_views=False,
    )


def scene_view(
    mechanism: Mechanism, run: Trajectory, name: str, contents: Sequence[str], **more: Any
) -> rrb.Spatial3DView:
    """Show entities in 3-D; `more` as of Rerun's view.

    The camera is placed so that all of a run is seen, face on if it is in a plane, and a grid behind it.
    """
    ways = [paths(mechanism, k, run) for k in range(len(mechanism.bodies))]
    moving = np.concatenate([way.reshape(-1, 3) for way in ways[1:]])
    # of a wide floor what is near
    near = np.clip(ways[0][0], moving.min(axis=0) - mechanism.size, moving.max(axis=0) + mechanism.size)
    points = np.concatenate([moving, near])
    moved = np.concatenate([(way - way[0]).reshape(-1, 3) for way in ways])
    (across, along, most), axes = np.linalg.eigh(moved.T @ moved)
    direction, floor, up = EYE_DIRECTION / np.linalg.norm(EYE_DIRECTION), Z, Z
    # motion along a line is in many planes
    if along > FLATNESS**2 * most and across <= FLATNESS**2 * along:
        direction = floor = axes[:, 0] * np.sign(axes[:, 0] @ EYE_DIRECTION)
        up = Y if abs(direction[2]) > abs(direction[1]) else Z
    right = np.cross(up, direction) / np.linalg.norm(np.cross(up, direction))
    frame = np.array([right, np.cross(direction, right), direction])
    low, high = (points @ frame.T).min(axis=0), (points @ frame.T).max(axis=0)
    x, y, z = (points @ frame.T - 0.5 * (low + high)).T
    distance = MARGIN * np.max(z + np.maximum(np.abs(y), np.abs(x) / ASPECT) / np.tan(HALF_ANGLE))
    target = 0.5 * (low + high) @ frame
    eye = rrb.EyeControls3D(
        kind=rrb.Eye3DKind.Orbital, position=target + distance * direction, look_target=target, eye_up=up
    )
    plane = rr.components.Plane3D(floor, float(np.min(points @ floor)))
    grid = rrb.LineGrid3D(spacing=10.0 ** np.floor(np.log10(np.max(high - low))), plane=plane)
    return rrb.Spatial3DView(
        origin="/", contents=contents, name=name, eye_controls=eye, line_grid=grid, **more
    )


def _row(plots: list[Plot], end: float) -> rrb.Tabs:
    groups: dict[str, list[Plot]] = {}
    for plot in plots:
        groups.setdefault(plot.group, []).append(plot)
    return rrb.Tabs(*(_group(name, members, end) for name, members in groups.items()), active_tab=0)


def _group(name: str, plots: list[Plot], end: float) -> rrb.Grid:
    """Plots side by side, of all times to the end, s; engines have the same colors in all, so one legend is
    enough."""
    bounds = (rr.TimeRangeBoundary.absolute(seconds=seconds) for seconds in (0.0, end))
    axis = rrb.TimeAxis(view_range=rr.TimeRange(*bounds))
    views = [
        rrb.TimeSeriesView(
            origin=rr.new_entity_path(["plots", *plot.path]),
            name=plot.title,
            axis_x=axis,
            plot_legend=rrb.PlotLegend(rrb.Corner2D.RightBottom, visible=plot is plots[0]),
        )
        for plot in plots
    ]
    return rrb.Grid(*views, grid_columns=min(len(views), MOST_COLUMNS), name=name)
