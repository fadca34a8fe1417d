"""Draw a workspace: maps over two joint coordinates, and maps of the positions that a point reaches."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from crosscheck.design.workspace_map import WorkspaceMap
from crosscheck.report.plots import own_style, png
from crosscheck.support.colors import BLUE, OTHER_COLORS, VERMILION
from newton_euler.scalars import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SINGULAR_COLOR, EDGE_COLOR = VERMILION, BLUE
"""Colors of singular configurations, and of the edges of collisions; no engine is drawn."""

COLLISION_COLOR = OTHER_COLORS[0]
"""Color of positions at which bodies collide, which the color map of the values does not have."""

COLORS = "cividis"
"""Color map of all values."""

PANEL_WIDTH, PANEL_HEIGHT = 5.2, 4.6
"""Size of one map with its color bar, inches."""

MAX_COLUMNS = 3
"""Largest number of maps in one row."""

MAP_AREA = 260.0**2
"""Area of a map without labels and color bar, square points, for the size of its dots."""

SINGULAR = {
    (True, False): "singular configurations, of all branches",
    (False, True): "singular configurations next to reached ones",
    (True, True): "singular configurations: of all branches (left), next to reached ones (positions)",
}
"""Label of singular configurations, by whether they are drawn over coordinates and at positions."""

CONDITIONING = "conditioning of the point (1 best, 0 singular)"
TO_SINGULAR = "distance from singular configurations"
"""Titles of maps."""


class PositionMap(NamedTuple):
    """A map of the positions of a point in two directions.

    Attributes:
        title: quantity that the colors show.
        values: (n,) quantity at each reached pose.
        across, up: indices in `WorkspaceMap.moves` of the directions.
    """

    title: str
    values: Array
    across: int
    up: int


@own_style()
def picture(found: WorkspaceMap) -> bytes | None:
    """Draw the workspace as a PNG; None for one coordinate without a point, and a point on a line.

    Over two joint coordinates: the distance from singular configurations and the elevation of the axis. Dots
    mark singular configurations, hatched regions collisions. For a point, its positions in the plane of its
    motion or, in space, in the planes of two world axes each.
    """
    from matplotlib.figure import Figure

    space = found.space
    coordinate_maps = []
    if len(space.grid) == 2:
        coordinate_maps.append((TO_SINGULAR, space.driving))
        if space.elevation is not None:
            coordinate_maps.append(("elevation of the axis, deg", np.degrees(space.elevation)))
    position_maps = _position_maps(found)
    count = len(coordinate_maps) + len(position_maps)
    if not count or not len(space.poses):
        return None
    # one row, or one for each kind of map
    rows = 1 if count <= MAX_COLUMNS else 2
    columns = count if rows == 1 else max(len(coordinate_maps), len(position_maps))
    figure = Figure(figsize=(PANEL_WIDTH * columns, PANEL_HEIGHT * rows), layout="constrained")
    for k, (title, values) in enumerate(coordinate_maps):
        ax = figure.add_subplot(rows, columns, 1 + k)
        _draw_over_coordinates(ax, figure, found, title, values)
    first = 1 + (columns if rows == 2 else len(coordinate_maps))
    for k, each in enumerate(position_maps):
        _draw_positions(figure.add_subplot(rows, columns, first + k), figure, found, each)
    _add_legend(figure, found, bool(coordinate_maps), bool(position_maps))
    return png(figure, dpi=110)


def _position_maps(found: WorkspaceMap) -> list[PositionMap]:
    """List the maps of the point's positions; none without a point, and for a point on a line."""
    space = found.space
    if found.moves is None or len(found.moves) < 2:
        return []
    quantities = [] if found.conditioning is None else [(CONDITIONING, found.conditioning)]
    if len(space.grid) != 2:  # a map over two coordinates shows it already
        quantities.append((TO_SINGULAR, space.driving[space.reachable]))
    if len(found.moves) == 3:
        return [PositionMap(*quantities[0], *pair) for pair in ((0, 1), (0, 2), (1, 2))]
    return [PositionMap(*each, 0, 1) for each in quantities]


def _draw_over_coordinates(ax: Axes, figure: Figure, found: WorkspaceMap, title: str, values: Array) -> None:
    """Draw values (n_1, n_2) over both joint coordinates."""
    space = found.space
    (first, x), (second, y) = space.grid.items()
    figure.colorbar(ax.contourf(x, y, values.T, 16, cmap=COLORS), ax=ax)
    curves = (found.singular.coordinates[name] for name in (first, second))
    ax.plot(*curves, linestyle="", marker=".", markersize=2.0, color=SINGULAR_COLOR)
    if found.collides.any():
        # clearances over the whole grid, NaN at points that are not reachable
        clearance = np.full(space.reachable.shape, np.nan)
        clearance[space.reachable] = found.clearance
        ax.contourf(x, y, clearance.T, [-np.inf, 0.0], colors="none", hatches=["////"])
        ax.contour(x, y, clearance.T, [0.0], colors=[EDGE_COLOR], linewidths=2.0)
    ax.set(title=title, xlim=(x[0], x[-1]), ylim=(y[0], y[-1]))
    ax.set(xlabel=found.quantity(first), ylabel=found.quantity(second))


def _draw_positions(ax: Axes, figure: Figure, found: WorkspaceMap, drawn: PositionMap) -> None:
    """Draw the positions of the point as dots; of several poses at a place, the largest value is on top.

    Colors of the conditioning are from 0 to 1.
    """
    across, up = (found.place[:, k] for k in (drawn.across, drawn.up))
    diameter = float(np.clip(1.4 * np.sqrt(MAP_AREA / max(len(across), 1)), 1.5, 14.0))  # points
    free = ~found.collides
    if found.collides.any():
        ax.scatter(across[~free], up[~free], s=diameter**2, color=COLLISION_COLOR, linewidths=0.0)
    order = np.flatnonzero(free)[np.argsort(drawn.values[free])]
    ends = (0.0, 1.0) if drawn.title == CONDITIONING else (None, None)
    dots = ax.scatter(
        across[order],
        up[order],
        c=drawn.values[order],
        s=diameter**2,
        cmap=COLORS,
        vmin=ends[0],
        vmax=ends[1],
        linewidths=0.0,
    )
    figure.colorbar(dots, ax=ax)
    x, y = (found.singular_place[:, k] for k in (drawn.across, drawn.up))
    ax.plot(x, y, linestyle="", marker=".", markersize=2.0, color=SINGULAR_COLOR)
    names = found.move_names
    ax.set(title=drawn.title, xlabel=f"{names[drawn.across]}, m", ylabel=f"{names[drawn.up]}, m")
    ax.set_axisbelow(True)
    ax.margins(0.08)  # dots at the edge are whole
    ax.set_aspect("equal", adjustable="datalim")
    ax.grid(alpha=0.3)


def _add_legend(figure: Figure, found: WorkspaceMap, over_coordinates: bool, of_positions: bool) -> None:
    """Add the legend of the marks that are drawn."""
    from matplotlib.artist import Artist
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    marks: list[Artist] = []
    at_positions = of_positions and len(found.singular_place) > 0
    if over_coordinates or at_positions:
        label = SINGULAR[over_coordinates, at_positions]
        marks.append(Line2D([], [], linestyle="", marker=".", color=SINGULAR_COLOR, label=label))
    if found.collides.any():
        if over_coordinates:
            marks.append(Patch(facecolor="none", edgecolor=EDGE_COLOR, hatch="////", label="bodies collide"))
        if of_positions:
            marks.append(Patch(facecolor=COLLISION_COLOR, label="reached with colliding bodies only"))
    labels: Sequence[str] = [str(mark.get_label()) for mark in marks]
    if marks:
        figure.legend(marks, labels, loc="outside lower center", ncols=len(marks), frameon=False)
