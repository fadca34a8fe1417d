"""Layout of a recording in the viewer."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from crosscheck.recording.plots import Plot
from crosscheck.recording.shapes import paths
from newton_euler.model.mechanism import Mechanism
from newton_euler.model.trajectory import Trajectory
from newton_euler.scalars import Array

TIME = "time"
"""The timeline of a recording."""

EYE_DIRECTION = np.array([0.35, -0.78, 0.72])
"""From the mechanism to the camera where it does not move in a plane."""

FLATNESS = 1e-4
"""Largest motion across a plane that is motion in it, as a share of the motion along it."""

HALF_ANGLE = np.radians(27.5)
"""Half of the angle that the camera sees from top to bottom."""

ASPECT, MARGIN = 1.3, 1.1
"""Width by height of what the camera sees at least, and its distance by the least that shows all."""

UPRIGHT = 0.9
"""Least share along z of a direction that is looked along with y upwards."""

FRAMES = 50
"""Outputs, about, that the camera is placed by."""

MOST_COLUMNS = 3
"""Plots side by side in one group."""


class Motion(NamedTuple):
    """Points (n, 3), m, that a mechanism is drawn between, and the normal (3,) if they move in a plane."""

    points: Array
    normal: Array | None


def blueprint(
    mechanism: Mechanism,
    run: Trajectory,
    plots: list[Plot],
    heading: str,
    hidden: Sequence[Sequence[str]],
) -> rrb.Blueprint:
    """The mechanism and the verdict at the left, two rows of plots over a timeline at the right.

    Args:
        run: what the camera is placed by.
        heading: of the 3-D view.
        hidden: parts of the paths of entities that are not shown at first.
    """
    motion = _motion(mechanism, run)
    scene_view = rrb.Spatial3DView(
        origin="/",
        contents=[f"+ /{kind}/**" for kind in ("ground", "mechanism", "joints", "reactions", "labels")],
        name=heading,
        overrides={rr.new_entity_path(path): rrb.EntityBehavior(visible=False) for path in hidden},
        eye_controls=_eye(motion),
        line_grid=_grid(motion),
    )
    verdict = rrb.TextDocumentView(origin="/verdict", name="Verdict")
    rows = [[plot for plot in plots if plot.judges is judges] for judges in (False, True)]
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Vertical(scene_view, verdict, row_shares=[1.0, 1.2]),
            rrb.Vertical(*(_row(row) for row in rows if row)),
            column_shares=[1.0, 1.2],
        ),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline=TIME, loop_mode="all"),
        auto_layout=False,
        auto_views=False,
    )


def _motion(mechanism: Mechanism, run: Trajectory) -> Motion:
    points, products = [], np.zeros((3, 3))
    for k in range(len(mechanism.bodies)):
        ways = paths(mechanism, k, run)[:: max(1, len(run.time) // FRAMES)]
        points.append(ways.reshape(-1, 3))
        moved = (ways - ways[0]).reshape(-1, 3)
        products += moved.T @ moved
    (across, along, most), axes = np.linalg.eigh(products)
    # motion along a line is in many planes
    planar = along > FLATNESS**2 * most and across <= FLATNESS**2 * along
    normal = axes[:, 0] * (1.0 if axes[:, 0] @ EYE_DIRECTION > 0.0 else -1.0)
    return Motion(np.concatenate(points), normal if planar else None)


def _eye(motion: Motion) -> rrb.EyeControls3D:
    """Place the camera so that all points are seen: face on if they move in a plane."""
    direction = EYE_DIRECTION / np.linalg.norm(EYE_DIRECTION) if motion.normal is None else motion.normal
    up = np.eye(3)[2 if abs(direction[2]) < UPRIGHT else 1]
    right = np.cross(up, direction)
    right /= np.linalg.norm(right)
    frame = np.array([right, np.cross(direction, right), direction])
    seen = motion.points @ frame.T
    low, high = seen.min(axis=0), seen.max(axis=0)
    x, y, z = (seen - 0.5 * (low + high)).T
    distance = MARGIN * np.max(z + np.maximum(np.abs(y), np.abs(x) / ASPECT) / np.tan(HALF_ANGLE))
    target = 0.5 * (low + high) @ frame
    return rrb.EyeControls3D(
        kind=rrb.Eye3DKind.Orbital,
        position=target + distance * direction,
        look_target=target,
        eye_up=up,
    )


def _grid(motion: Motion) -> rrb.LineGrid3D:
    """Lines on the floor, or in the plane of the motion, a round length apart."""
    reach = float(np.max(np.ptp(motion.points, axis=0)))
    normal = np.array([0.0, 0.0, 1.0]) if motion.normal is None else motion.normal
    behind = float(np.min(motion.points @ normal))
    plane = rr.components.Plane3D(normal, behind)
    return rrb.LineGrid3D(spacing=10.0 ** np.floor(np.log10(reach)), plane=plane)


def _row(plots: list[Plot]) -> rrb.Tabs:
    groups: dict[str, list[Plot]] = {}
    for plot in plots:
        groups.setdefault(plot.group, []).append(plot)
    return rrb.Tabs(*(_group(name, members) for name, members in groups.items()), active_tab=0)


def _group(name: str, plots: list[Plot]) -> rrb.Grid:
    """Plots side by side; engines have the same colors in all, so one legend is enough."""
    views = [
        rrb.TimeSeriesView(
            origin=rr.new_entity_path(["plots", *plot.path]),
            name=plot.title,
            plot_legend=rrb.PlotLegend(rrb.Corner2D.RightBottom, visible=plot is plots[0]),
        )
        for plot in plots
    ]
    return rrb.Grid(*views, grid_columns=min(len(views), MOST_COLUMNS), name=name)
