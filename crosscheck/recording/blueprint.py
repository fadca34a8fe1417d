"""Layout of a recording in the viewer."""

from __future__ import annotations

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from crosscheck.recording.plots import Plot
from newton_euler.model.mechanism import Mechanism

EYE_DIRECTION = np.array([0.5, -0.72, 0.5])
"""From the mechanism to the camera."""

EYE_DISTANCE = 3.1
"""Distance of the camera in multiples of the mechanism's size."""

MESH_DISTANCE = 2.0
"""Least distance of the camera in multiples of how far meshes reach."""

MOST_COLUMNS = 4
"""Plots side by side in one group."""


def blueprint(
    mechanism: Mechanism, engines: list[str], plots: list[Plot], title: str, timeline: str
) -> rrb.Blueprint:
    """The mechanism and the verdict at the left, rows of plots over a timeline at the right.

    Joint points and reactions are shown for the first engine; those of the others can be switched
    on in the viewer.
    """
    hidden = {
        rr.new_entity_path([kind, engine]): rrb.EntityBehavior(visible=False)
        for kind in ("joints", "reactions")
        for engine in engines[1:]
    }
    scene_view = rrb.Spatial3DView(
        origin="/",
        contents=["+ /ground/**", "+ /mechanism/**", "+ /joints/**", "+ /reactions/**"],
        name=title,
        overrides=hidden,
        eye_controls=_eye(mechanism),
    )
    verdict = rrb.TextDocumentView(origin="/verdict", name="Verdict")
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Vertical(scene_view, verdict, row_shares=[2.0, 1.0]),
            rrb.Vertical(*(_row(plots, row) for row in sorted({plot.row for plot in plots}))),
            column_shares=[1.0, 1.2],
        ),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline=timeline, loop_mode="all"),
        auto_layout=False,
        auto_views=False,
    )


def _eye(mechanism: Mechanism) -> rrb.EyeControls3D:
    points = [body.center_of_mass for body in mechanism.bodies[1:]]
    points += [joint.point for joint in mechanism.joints]
    target = np.mean(points, axis=0)
    corners = [mesh.vertices - target for body in mechanism.bodies[1:] for mesh in body.meshes]
    reach = max((float(np.max(np.linalg.norm(arms, axis=1), initial=0.0)) for arms in corners), default=0.0)
    distance = max(EYE_DISTANCE * mechanism.size, MESH_DISTANCE * reach)
    direction = EYE_DIRECTION / np.linalg.norm(EYE_DIRECTION)
    return rrb.EyeControls3D(
        kind=rrb.Eye3DKind.Orbital,
        position=target + distance * direction,
        look_target=target,
        eye_up=[0.0, 0.0, 1.0],
    )


def _row(plots: list[Plot], row: int) -> rrb.Tabs:
    groups: dict[str, list[Plot]] = {}
    for plot in plots:
        if plot.row == row:
            groups.setdefault(plot.group, []).append(plot)
    return rrb.Tabs(*(_group(name, members) for name, members in groups.items()), active_tab=0)


def _group(name: str, plots: list[Plot]) -> rrb.Grid:
    """Plots side by side; engines have the same colors in all, so one legend is enough."""
    corner = rrb.Corner2D.RightBottom if plots[0].lines_coincide else rrb.Corner2D.RightTop
    views = [
        rrb.TimeSeriesView(
            origin=rr.new_entity_path(["plots", *plot.path]),
            name=plot.title,
            plot_legend=rrb.PlotLegend(corner, visible=plot is plots[0]),
        )
        for plot in plots
    ]
    return rrb.Grid(*views, grid_columns=min(len(views), MOST_COLUMNS), name=name)
