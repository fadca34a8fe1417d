"""Map the workspace of a scene over joint coordinates: reachable poses, singular poses and clearances.

The input is a grid of values of some joint coordinates. `measure` solves the pose at each point of the grid;
the results are a table, a CSV and, for two coordinates, a picture. A mechanism with loops can be assembled in
several ways (branches) for the same coordinates; the grid is solved on the branch of the initial pose. In a
singular pose the mechanism cannot be driven by these coordinates; the distance from singular poses is a
dimensionless number, 0 at a singular pose. A clearance is the smallest distance between bodies.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np

from crosscheck.report.output import record
from crosscheck.report.plots import own_style, png
from crosscheck.report.table import Cell, Column, Rows, Table, number_columns
from crosscheck.support.errors import CrosscheckError
from crosscheck.support.files import write_files
from crosscheck.support.palette import ENGINE_COLORS
from mjcf.clearance import clearances
from newton_euler import Axis, Poses, Scene, Workspace, singular_poses, workspace
from newton_euler.errors import is_count, plain_number
from newton_euler.model.joint import Key
from newton_euler.scalars import Array

DEFAULT_POINTS = 61
"""Number of values of each coordinate, unless the user gives it."""

MAX_POINTS = 1_000_000
"""Largest number of points of the grid."""

SINGULAR_SEARCHES = 4000
"""Number of random configurations from which singular poses are searched."""

WORKSPACE_FILES = "workspace.json", "workspace.png", "workspace.csv"
"""Names of the files that `write` can write."""


class WorkspaceMap(NamedTuple):
    """Workspace of a scene.

    Attributes:
        scene: the scene.
        space: reachable poses over a grid of joint coordinates.
        singular: singular poses of all assembly branches.
        clearance: (n,) m, smallest distance between bodies at each reachable pose; negative if bodies
            collide, infinite if bodies have no shapes.
    """

    scene: Scene
    space: Workspace
    singular: Poses
    clearance: Array


def range_of(scene: Scene, text: str) -> tuple[str | Key, Array]:
    """Parse a range JOINT=LOW:HIGH[:POINTS] of a joint coordinate, m or rad from the initial pose.

    JOINT.K names coordinate K of a joint with several coordinates.

    Returns:
        The coordinate, and its values (points,).

    Raises:
        CrosscheckError: if the text has another form, or the range is empty.
    """
    name, _, limits = text.partition("=")
    parts = limits.split(":")
    try:
        low, high, count = *map(plain_number, parts[:2]), int(parts[2]) if len(parts) == 3 else DEFAULT_POINTS
    except ValueError:
        low, high, count = 0.0, 0.0, 0  # an empty range, which is refused below
    if len(parts) not in (2, 3) or not low < high or not is_count(count) or not 2 <= count <= MAX_POINTS:
        raise CrosscheckError(f"--vary {text!r} is not of the form JOINT=LOW:HIGH[:POINTS], in m or rad")
    joint, _, number = name.rpartition(".")
    is_key = name not in scene.mechanism.joint_names and number.isdecimal()
    return (joint, int(number)) if is_key else name, np.linspace(low, high, count)


def axis_of(text: str) -> Axis:
    """Parse an axis BODY=X,Y,Z of a body frame.

    Raises:
        CrosscheckError: if the text has another form.
    """
    body, _, components = text.partition("=")
    try:
        return Axis(body, [plain_number(each) for each in components.split(",")])
    except ValueError:
        raise CrosscheckError(f"--axis {text!r} is not of the form BODY=X,Y,Z") from None


def measure(
    scene: Scene, grid: Mapping[str | Key, Array], axis: Axis | None, progress: Callable[[str], None]
) -> WorkspaceMap:
    """Map the workspace of a scene.

    Args:
        scene: the scene.
        grid: values of each varied joint coordinate, m or rad.
        axis: axis fixed in a body, whose direction is computed; None for no axis. Its elevation is the angle
            above the world's xy plane, its azimuth the angle in this plane from x to y.
        progress: called with the name of each stage.

    Raises:
        CrosscheckError: for a grid with too many points.
    """
    if np.prod([float(len(values)) for values in grid.values()]) > MAX_POINTS:
        raise CrosscheckError(f"--vary asks for more than {MAX_POINTS} points; give fewer, LOW:HIGH:POINTS")
    progress("solving poses")
    space = workspace(scene, grid, axis)
    progress("searching singular configurations")
    singular = singular_poses(scene, list(grid), SINGULAR_SEARCHES)
    progress("measuring clearances")
    poses = space.poses
    return WorkspaceMap(scene, space, singular, clearances(scene.mechanism, poses.position, poses.quaternion))


def table(found: WorkspaceMap) -> Table:
    """Tabulate the ranges of all quantities over the reachable points, and over those without collision."""
    space = found.space
    without_collision = found.clearance > 0.0
    rows: Rows = [_row(found, "reachable", np.ones(len(without_collision), dtype=bool))]
    has_shapes = bool(np.isfinite(found.clearance).any())
    if has_shapes:
        rows.append(_row(found, "without collision", without_collision))
    columns = [
        Column("points"),
        Column("number", numeric=True),
        *(Column(f"{name}\n{_unit(found, name)}", numeric=True) for name in space.grid),
    ]
    if space.elevation is not None:
        columns += number_columns("elevation\ndeg", "azimuth\ndeg")
    columns += number_columns("least to\nsingular")
    if has_shapes:
        columns += number_columns("clearance\nmm")
    return Table("", columns, rows)


def unusable_warning(found: WorkspaceMap) -> str:
    """Report in a sentence that no point is reachable, or that bodies collide at all of them; else ""."""
    if not len(found.clearance):
        points = f"none of {found.space.reachable.size} points is reachable on the branch of the initial pose"
        return f"{points}; --vary takes m and rad relative to that pose"
    if not np.any(found.clearance > 0.0):
        return f"bodies collide at all {len(found.clearance)} reachable points"
    return ""


def _row(found: WorkspaceMap, name: str, which: Array) -> list[str | Cell]:
    """Make a row of `table`.

    Args:
        found: the workspace, with n reachable points.
        name: text in the first column.
        which: (n,) True for the points of the row.
    """
    # Ranges of the coordinates, and of elevation and azimuth of the axis in degrees. `poses` has reachable
    # points only, the other arrays of the workspace have all points of the grid
    space = found.space
    total = space.reachable.size
    row: list[str | Cell] = [name, f"{int(np.sum(which))} of {total}"]
    quantities = list(space.poses.coordinates.values())
    if space.elevation is not None and space.azimuth is not None:
        quantities += [np.degrees(values[space.reachable]) for values in (space.elevation, space.azimuth)]
    digits = [4] * len(space.grid) + [1, 1]  # after the decimal point
    for values, count in zip(quantities, digits, strict=False):
        chosen = values[which]
        ends = [np.min(chosen), np.max(chosen)] if len(chosen) else []
        # + 0.0 avoids "-0"
        row.append(" .. ".join(f"{round(float(end), count) + 0.0:.{count}f}" for end in ends) or "-")
    # The smallest distance from singular poses, and the smallest clearance in mm
    distances = space.driving[space.reachable][which]
    row.append(f"{np.min(distances):.3f}" if len(distances) else "-")
    if np.isfinite(found.clearance).any():
        row.append(f"{1e3 * np.min(found.clearance[which]):.1f}" if which.any() else "-")
    return row


def _unit(found: WorkspaceMap, name: str | Key) -> str:
    """Return the unit of a joint coordinate."""
    return "m" if found.scene.mechanism.is_slide(*found.scene.mechanism.coordinate(name)) else "rad"


def write(found: WorkspaceMap, folder: Path, source: str, options: Mapping[str, str]) -> list[Path]:
    """Write `workspace.csv`, and `workspace.png` if the workspace has two coordinates.

    Args:
        found: the workspace.
        folder: folder of the files. The file `workspace.json` is written there too, and records the model.
        source: name or file of the model.
        options: options of the model.

    Returns:
        Paths of the CSV and of the picture.
    """
    files = {folder / "workspace.csv": _csv(found).encode()}
    if len(found.space.grid) == 2:
        files[folder / "workspace.png"] = _picture(found)
    write_files({folder / "workspace.json": record(source, options), **files})
    return list(files)


def _csv(found: WorkspaceMap) -> str:
    """Return the CSV, with one row for each reachable point."""
    space = found.space
    quantities = {f"{name}, {_unit(found, name)}": values for name, values in space.poses.coordinates.items()}
    for name, values in (("elevation, deg", space.elevation), ("azimuth, deg", space.azimuth)):
        if values is not None:
            quantities[name] = np.degrees(values[space.reachable])
    # `driving` is the distance from poses that the coordinates do not determine; `pointing` the distance from
    # poses in which a motion of the coordinates does not turn the axis
    quantities["distance from singular"] = space.driving[space.reachable]
    if space.pointing is not None:
        quantities["distance from singular, axis"] = space.pointing[space.reachable]
    if np.isfinite(found.clearance).any():
        quantities["clearance, m"] = found.clearance
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(quantities)
    writer.writerows([f"{value:.9g}" for value in row] for row in np.stack(list(quantities.values()), axis=1))
    return text.getvalue()


@own_style()
def _picture(found: WorkspaceMap) -> bytes:
    """Draw a map of the distance from singular configurations, and one of the elevation of the axis.

    Dots mark singular configurations, and hatched regions collisions.
    """
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    space = found.space
    (first, x), (second, y) = space.grid.items()
    maps = [("distance from singular configurations", space.driving)]
    if space.elevation is not None:
        maps.append(("elevation of the axis, deg", np.degrees(space.elevation)))
    figure = Figure(figsize=(5.2 * len(maps), 4.6), layout="constrained")
    # two colors of the palette; no engine is drawn
    dot, edge = ENGINE_COLORS["mujoco"], ENGINE_COLORS["newton_euler"]
    # clearances over the whole grid, NaN at points that are not reachable
    clearance = np.full(space.reachable.shape, np.nan)
    clearance[space.reachable] = found.clearance
    collide = bool(np.nanmin(clearance, initial=np.inf) < 0.0)
    for k, (title, values) in enumerate(maps):
        ax = figure.add_subplot(1, len(maps), k + 1)
        figure.colorbar(ax.contourf(x, y, values.T, 16, cmap="cividis"), ax=ax)
        curves = (found.singular.coordinates[name] for name in (first, second))
        ax.plot(*curves, linestyle="", marker=".", markersize=2.0, color=dot)
        if collide:
            ax.contourf(x, y, clearance.T, [-np.inf, 0.0], colors="none", hatches=["////"])
            ax.contour(x, y, clearance.T, [0.0], colors=[edge], linewidths=2.0)
        ax.set(title=title, xlim=(x[0], x[-1]), ylim=(y[0], y[-1]))
        ax.set(xlabel=f"{first}, {_unit(found, first)}", ylabel=f"{second}, {_unit(found, second)}")
    dots = Line2D(
        [], [], linestyle="", marker=".", color=dot, label="singular configurations, of all branches"
    )
    hatched = Patch(facecolor="none", edgecolor=edge, hatch="////", label="bodies collide")
    named = [dots, hatched] if collide else [dots]
    figure.legend(handles=named, loc="outside lower center", ncols=2, frameon=False)
    return png(figure, dpi=110)
