"""Layout of a recording in the Rerun viewer (in Rerun's terms: a blueprint).

A recording shows the motion of one mechanism in several engines (simulators), and the checks that compare the
engines. `blueprint` arranges the 3-D view, the verdict of the checks and the plots. `scene_view` places the
camera so that the whole motion of a mechanism is visible.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from crosscheck.recording.plots import Plot
from crosscheck.recording.shapes import drawn_points
from newton_euler.model.mechanism import Mechanism
from newton_euler.model.trajectory import Trajectory

Y, Z = np.eye(3)[1:]
"""Unit vectors of the world frame; z is up."""

TIME = "time"
"""Name of the timeline of all recordings; times are in s."""

EYE_DIRECTION = np.array([0.35, -0.78, 0.72])
"""Direction from the mechanism to the camera, world frame, for motions that are not planar."""

PLANAR_RATIO = 1e-4
"""Largest ratio of the motion across a plane to the motion along it for which a motion counts as planar."""

HALF_FIELD_OF_VIEW = np.radians(27.5)
"""Half of the camera's vertical field of view, rad."""

MIN_ASPECT_RATIO = 1.3
"""Smallest ratio of width to height of the 3-D view."""

MARGIN = 1.1
"""Distance of the camera, divided by the smallest distance from which the whole motion is visible."""

LOWER_ROW_HEIGHT = 1.4
"""Height of the lower row (verdict, and plots of differences by which engines are judged), divided by the
height of the upper row."""

MAX_COLUMNS = 3
"""Largest number of plots side by side in one group."""

MIN_PLAYBACK_S, MAX_PLAYBACK_S = 4.0, 60.0
"""Shortest and longest time, s, in which the viewer plays a recording, however long the motion is."""


class Layout(rrb.Blueprint):  # type: ignore[misc]  # Rerun is untyped here
    """A Rerun blueprint that keeps the stream to which Rerun writes the blueprint.

    Rerun drops this stream without closing it, so that two threads would continue to run.
    `send_layout` closes the stream.
    """

    stream: rr.RecordingStream | None = None

    def _log_to_stream(self, stream: rr.RecordingStream) -> None:
        """Keep the stream, and write the blueprint to it; overrides a method of Rerun."""
        self.stream = stream
        super()._log_to_stream(stream)


def send_layout(recording: rr.RecordingStream, layout: Layout) -> None:
    """Add a layout to a recording, and close the stream that Rerun wrote the layout to."""
    # makes the layout active; otherwise a viewer in a browser would choose its own layout
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
    end: float,
    log_views: Sequence[rrb.Spatial3DView] = (),
) -> Layout:
    """Make the layout of a run: mechanism and verdict at the left, two rows of plots at the right.

    Args:
        mechanism: mechanism that the 3-D view shows.
        run: run whose motion the camera is placed for.
        plots: plots to show; plots that engines are judged by are in the lower row.
        heading: title of the 3-D view.
        hidden: entities that are not shown at first, each as the parts of its path.
        moments: whether to show, in a tab behind the verdict, the text log of the times at which checks are
            closest to failing. The user can click these times; a text document cannot link to times.
        end: end of the time axes, s.
        log_views: 3-D views of logs, which other simulators wrote, in tabs before the view of the engines.
    """
    contents = ["+ /**", "- /logs/**", "- /plots/**", "- /verdict", "- /worst"]
    overrides = {rr.new_entity_path(path): rrb.EntityBehavior(visible=False) for path in hidden}
    mechanism_view: rrb.View | rrb.Container = scene_view(
        mechanism, run, heading, contents, overrides=overrides
    )
    if log_views:
        mechanism_view = rrb.Tabs(*log_views, mechanism_view, active_tab=0)
    texts: list[rrb.View] = [rrb.TextDocumentView(origin="/verdict", name="Verdict")]
    if moments:
        columns = rrb.TextLogColumns(timeline_columns=[TIME], text_log_columns=["body"])
        texts.append(rrb.TextLogView(origin="/worst", name="Worst moments: click a time", columns=columns))
    # two rows of plots: quantities of the motion, and differences by which engines are judged
    rows = [[plot for plot in plots if plot.is_judged is is_judged] for is_judged in (False, True)]
    plot_rows = [_tabs_of_groups(row, end) for row in rows if row]
    row_heights = [1.0, LOWER_ROW_HEIGHT]
    return make_layout(
        rrb.Horizontal(
            rrb.Vertical(mechanism_view, rrb.Tabs(*texts, active_tab=0), row_shares=row_heights),
            rrb.Vertical(*plot_rows, row_shares=row_heights[: len(plot_rows)]),
            column_shares=[1.0, 1.2],
        ),
        end,
    )


def make_layout(views: rrb.Container, duration: float = MIN_PLAYBACK_S) -> Layout:
    """Make a layout that shows some views, with all panels of the viewer collapsed, and plays in a loop.

    Args:
        views: container of views.
        duration: duration of the motion, s. A motion of milliseconds is played in slow motion, a motion of
            hours in fast motion, see `MIN_PLAYBACK_S` and `MAX_PLAYBACK_S`.
    """
    playback = min(max(duration, MIN_PLAYBACK_S), MAX_PLAYBACK_S)
    return Layout(
        views,
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline=TIME, playback_speed=duration / playback, loop_mode="all"),
        auto_layout=False,
        auto_views=False,
    )


def scene_view(
    mechanism: Mechanism, run: Trajectory, name: str, contents: Sequence[str], **more: Any
) -> rrb.Spatial3DView:
    """Make a 3-D view whose camera sees the whole run, with a grid behind it.

    If the motion is planar, the camera looks at its plane from the front, and the grid is in the plane.
    Otherwise the camera is in the direction `EYE_DIRECTION` from the motion, and the grid is horizontal.

    Args:
        mechanism: mechanism that is shown.
        run: run whose motion the camera is placed for.
        name: title of the view.
        contents: Rerun's expressions that select the entities to show.
        more: further arguments of Rerun's `Spatial3DView`.
    """
    # points (m, 3) that the camera must see: moving bodies at all times, and the nearby part of the ground,
    # up to one characteristic length of the mechanism (`size`, m) outside their bounding box
    points_of_bodies = [drawn_points(mechanism, k, run) for k in range(len(mechanism.bodies))]
    moving = np.concatenate([each.reshape(-1, 3) for each in points_of_bodies[1:]])
    ground = points_of_bodies[0][0]
    nearby = np.clip(ground, moving.min(axis=0) - mechanism.size, moving.max(axis=0) + mechanism.size)
    points = np.concatenate([moving, nearby])

    # principal axes of the displacements from the start, with sums of squared displacements along each axis,
    # smallest first
    moved = np.concatenate([(each - each[0]).reshape(-1, 3) for each in points_of_bodies])
    (smallest, middle, largest), axes = np.linalg.eigh(moved.T @ moved)

    # view direction (towards the camera), normal of the grid, and the direction that is up in the view
    direction, grid_normal, up = EYE_DIRECTION / np.linalg.norm(EYE_DIRECTION), Z, Z
    is_line = middle <= PLANAR_RATIO**2 * largest  # many planes contain a line
    if not is_line and smallest <= PLANAR_RATIO**2 * middle:  # the motion is planar
        direction = grid_normal = axes[:, 0] * np.sign(axes[:, 0] @ EYE_DIRECTION)
        up = Y if abs(direction[2]) > abs(direction[1]) else Z

    # in the frame of the camera (right, up, towards it), the distance from which all points are visible
    right = np.cross(up, direction) / np.linalg.norm(np.cross(up, direction))
    frame = np.array([right, np.cross(direction, right), direction])
    low, high = (points @ frame.T).min(axis=0), (points @ frame.T).max(axis=0)
    center = 0.5 * (low + high)
    x, y, z = (points @ frame.T - center).T
    half_heights = np.maximum(np.abs(y), np.abs(x) / MIN_ASPECT_RATIO)  # of views that contain each point
    distance = MARGIN * np.max(z + half_heights / np.tan(HALF_FIELD_OF_VIEW))
    target = center @ frame
    eye = rrb.EyeControls3D(
        kind=rrb.Eye3DKind.Orbital, position=target + distance * direction, look_target=target, eye_up=up
    )
    # lines of the grid are 1, 10, 100, ... m apart (or 0.1, ...), by the size of the motion
    plane = rr.components.Plane3D(grid_normal, float(np.min(points @ grid_normal)))
    grid = rrb.LineGrid3D(spacing=10.0 ** np.floor(np.log10(np.max(high - low))), plane=plane)
    return rrb.Spatial3DView(
        origin="/", contents=contents, name=name, eye_controls=eye, line_grid=grid, **more
    )


def _tabs_of_groups(plots: list[Plot], end: float) -> rrb.Tabs:
    """Make a row of the layout: a tab for each group of plots, whose time axis ends at `end`, s."""
    groups: dict[str, list[Plot]] = {}
    for plot in plots:
        groups.setdefault(plot.group, []).append(plot)
    return rrb.Tabs(*(_group(name, members, end) for name, members in groups.items()), active_tab=0)


def _group(name: str, plots: list[Plot], end: float) -> rrb.Grid:
    """Show the plots of one group side by side, over times from 0 to `end`, s.

    Only the first plot has a legend, since engines have the same colors in all plots.
    """
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
    return rrb.Grid(*views, grid_columns=min(len(views), MAX_COLUMNS), name=name)
