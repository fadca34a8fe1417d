"""Map the workspace of a scene over joint coordinates: reachable poses, singular poses and clearances.

The input is a grid of values of some joint coordinates. `workspace_map.measure` solves the pose at each point
of the grid; the results are tables, a CSV, a JSON file and a picture. A mechanism with loops can be assembled
in several ways (branches) for the same coordinates; the grid is solved on the branch of the initial pose. In
a singular pose the mechanism cannot be driven by these coordinates; the distance from singular poses is a
dimensionless number, 0 at a singular pose. A clearance is the smallest distance between bodies.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from crosscheck.design.coordinates import coordinate_of
from crosscheck.design.workspace_map import MAX_POINTS, WORLD_AXES, WorkspaceMap, measure
from crosscheck.design.workspace_plots import picture
from crosscheck.report.chart import Measure, linear_chart
from crosscheck.report.render import as_json
from crosscheck.report.table import Cell, Column, Lines, Part, Report, Rows, Table, number_columns
from crosscheck.support.errors import CrosscheckError
from crosscheck.support.files import write_files
from mjcf.clearance import pair_names
from newton_euler import Axis, Point, Scene
from newton_euler.errors import is_count, plain_number
from newton_euler.model.joint import Key
from newton_euler.scalars import Array

__all__ = ["WORKSPACE_FILES", "axis_of", "measure", "point_of", "range_of", "report", "write"]

DEFAULT_POINTS = 61
"""Number of values of each coordinate, unless the user gives it."""

WORKSPACE_FILES = "workspace.json", "workspace.png", "workspace.csv"
"""Names of the files that `write` can write."""

ONE_BRANCH = "every pose is reached from the initial pose without passing a singular configuration"
"""Statement on the branch of all results, if it holds; `newton_euler.workspace` leaves out poses that the
coordinates cannot drive the mechanism to."""


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
    return coordinate_of(scene.mechanism, name), np.linspace(low, high, count)


def axis_of(text: str) -> Axis:
    """Parse an axis BODY=X,Y,Z of a body frame.

    Raises:
        CrosscheckError: if the text has another form.
    """
    return Axis(*_body_and_vector("--axis", text))


def point_of(text: str) -> Point:
    """Parse a point BODY=X,Y,Z of a body, m, world at the initial pose.

    Raises:
        CrosscheckError: if the text has another form.
    """
    body, components = _body_and_vector("--point", text)
    if len(components) != 3:
        raise CrosscheckError(f"--point {text!r} is not of the form BODY=X,Y,Z, in m")
    return Point(body, components)


def _body_and_vector(option: str, text: str) -> tuple[str, Any]:
    """Split a text BODY=X,Y,Z into the name of the body and numbers."""
    body, _, components = text.partition("=")
    try:
        return body, [plain_number(each) for each in components.split(",")]
    except ValueError:
        raise CrosscheckError(f"{option} {text!r} is not of the form BODY=X,Y,Z") from None


def report(found: WorkspaceMap) -> Report:
    """Make the report on a workspace: ranges of all quantities, and extreme positions of the point."""
    names = ", ".join(found.labels.values())
    reached, total = len(found.clearance), found.space.reachable.size
    verdict, judged = f"{reached} of {total} points are reachable", Cell("")
    if warning := _unusable_warning(found):
        verdict, judged = warning, Cell("", verdict="doubtful")
    parts: list[Part] = [_ranges(found)]
    if found.point is not None and len(found.place):
        parts.append(_extremes(found))
    if beyond := int(np.sum(found.space.poses.beyond)):
        text = f"{beyond} of {reached} poses are reached through a singular configuration of the loops"
        advice = "there the mechanism can change to another branch; column 'beyond singular' of the CSV"
        parts.append(Lines("", [text, advice], verdict="doubtful"))
    elif reached:
        parts.append(Lines("", [ONE_BRANCH]))
    if found.left_out:
        text = f"overlap in the initial pose, so never examined: {pair_names(found.left_out)}"
        parts.append(Lines("", [text], verdict="doubtful"))
    usable = int(np.sum(~found.collides))
    counts = [Measure("reachable", reached, f"{reached} of {total}")]
    if found.has_shapes:
        counts.append(Measure("without collision", usable, f"{usable} of {total}"))
    chart = linear_chart("Points", "Points of the grid of coordinates", counts, end=total)
    return Report(
        f"{found.scene.name}: workspace over {names}",
        verdict,
        judged,
        parts,
        summary=parts,
        charts=chart,
        captions={"workspace.png": "Map of the workspace over the varied coordinates"},
        next_steps=_next_steps(found),
    )


def _next_steps(found: WorkspaceMap) -> list[str]:
    """List what the reader can do with the workspace."""
    if not len(found.clearance):
        return ["Choose smaller ranges with `--vary`; they are relative to the initial pose, in m and rad."]
    steps = []
    if found.collides.any():
        steps.append("Limit the strokes to points without collision: `workspace.csv` has each clearance.")
    if np.any(found.space.poses.beyond):
        steps.append("Stay before the singular configuration: `beyond singular` marks the points behind it.")
    return [*steps, "Keep a distance from singular configurations: drives lose their effect there."]


def _unusable_warning(found: WorkspaceMap) -> str:
    """Report in a sentence that no point is reachable, or that bodies collide at all of them; else ""."""
    if not len(found.clearance):
        points = f"none of {found.space.reachable.size} points is reachable on the branch of the initial pose"
        return f"{points}; --vary takes m and rad relative to that pose"
    if found.collides.all():
        return f"bodies collide at all {len(found.clearance)} reachable points"
    return ""


def _ranges(found: WorkspaceMap) -> Table:
    """Tabulate the ranges of all quantities over the reachable points, and over those without collision."""
    space = found.space
    # columns: their names, and (n,) True for their points
    chosen = {"reachable": np.ones(len(found.clearance), dtype=bool)}
    if found.has_shapes:
        chosen["without collision"] = ~found.collides
    total = space.reachable.size
    rows: Rows = [["points", *(f"{int(np.sum(which))} of {total}" for which in chosen.values())]]

    def add(name: str, values: Array, digits: int, minimum_only: bool = False) -> None:
        """Add a row with the range of values (n,), or with the smallest ones."""
        row: list[str | Cell] = [name]
        for which in chosen.values():
            part = values[which]
            ends = [np.min(part), np.max(part)][: 1 if minimum_only else 2] if len(part) else []
            row.append(" .. ".join(_fixed(end, digits) for end in ends) or "-")
        rows.append(row)

    # `poses` has reachable points only, the other arrays of the workspace have all points of the grid
    for name, values in space.poses.coordinates.items():
        add(found.quantity(name), values, digits=4)
    for name, values in zip(found.move_names, found.place.T, strict=True):
        add(f"{name}, m", values, digits=4)
    for name, angles in (("elevation, deg", space.elevation), ("azimuth, deg", space.azimuth)):
        if angles is not None:
            add(name, np.degrees(angles[space.reachable]), digits=1)
    if found.conditioning is not None:
        add("minimum conditioning", found.conditioning, digits=3, minimum_only=True)
    add("minimum distance from singular", space.driving[space.reachable], digits=3, minimum_only=True)
    if found.has_shapes:
        add("minimum clearance, mm", 1e3 * found.clearance, digits=1, minimum_only=True)
    return Table("", [Column("quantity"), *number_columns(*chosen)], rows)


def _fixed(value: float, digits: int) -> str:
    """Format a number with some digits after the decimal point, without a minus sign of zero."""
    return f"{round(float(value), digits) + 0.0:.{digits}f}"


def _extreme_rows(found: WorkspaceMap) -> list[tuple[str, int]]:
    """List the extreme positions of the point: a text, and the index of the reachable pose.

    Poses in which bodies collide do not count, unless bodies collide in all of them.
    """
    allowed = np.flatnonzero(~found.collides)
    if not len(allowed):
        allowed = np.arange(len(found.place))
    rows = []
    for name, values in zip(found.move_names, found.place[allowed].T, strict=True):
        rows.append((f"minimum {name}", int(allowed[np.argmin(values)])))
        rows.append((f"maximum {name}", int(allowed[np.argmax(values)])))
    return rows


def _extremes(found: WorkspaceMap) -> Table:
    """Tabulate the extreme positions of the point, with the coordinates of their poses."""
    space = found.space
    columns = [
        Column("position"),
        *(Column(f"{name}\nm", numeric=True) for name in found.move_names),
        *(Column(f"{label}\n{found.unit(name)}", numeric=True) for name, label in found.labels.items()),
    ]
    rows: Rows = []
    for text, k in _extreme_rows(found):
        values = [*found.place[k], *(each[k] for each in space.poses.coordinates.values())]
        rows.append([text, *(_fixed(value, 4) for value in values)])
    return Table("", columns, rows)


def write(
    found: WorkspaceMap, whole: Report, folder: Path, source: str, options: Mapping[str, str]
) -> list[Path]:
    """Write `workspace.csv`, `workspace.json` and, if the workspace can be drawn, `workspace.png`.

    Args:
        found: the workspace.
        whole: report on it, for the page of `crosscheck report`.
        folder: folder of the files.
        source: name or file of the model.
        options: options of the model.

    Returns:
        Paths of the files.
    """
    table, results, drawing = (folder / name for name in ("workspace.csv", "workspace.json", "workspace.png"))
    drawn = picture(found)
    pictures = {} if drawn is None else {drawing: drawn}
    content = {"source": source, "options": dict(options), **_data(found)}
    write_files({table: _csv(found).encode(), results: as_json(content, whole, pictures), **pictures})
    return [table, results, *pictures]


def _data(found: WorkspaceMap) -> dict[str, Any]:
    """Return the results for the JSON file; the CSV has the single poses."""
    space = found.space
    quantities = {
        name: {"min": float(np.min(values)), "max": float(np.max(values))}
        for name, values in _columns(found).items()
        if len(values)
    }
    return {
        "scene": found.scene.name,
        "vary": [
            {
                "coordinate": found.labels[name],
                "unit": found.unit(name),
                "low": float(values[0]),
                "high": float(values[-1]),
                "points": len(values),
            }
            for name, values in space.grid.items()
        ],
        "axis": None if found.axis is None else {"body": found.axis.body, "axis": found.axis.axis.tolist()},
        "point": (
            None if found.point is None else {"body": found.point.body, "point": found.point.point.tolist()}
        ),
        "branch": "initial pose",
        "beyond_singular": int(np.sum(space.poses.beyond)),
        "points": space.reachable.size,
        "reachable": len(found.clearance),
        "without_collision": int(np.sum(~found.collides)) if found.has_shapes else None,
        "overlapping_in_the_initial_pose": sorted(map(sorted, found.left_out)),
        "ranges": quantities,
        "extremes": [
            {
                "position": text,
                **{f"{name}, m": float(x) for name, x in zip(found.move_names, found.place[k], strict=True)},
                "coordinates": {
                    found.labels[name]: float(values[k]) for name, values in space.poses.coordinates.items()
                },
            }
            for text, k in (_extreme_rows(found) if len(found.place) else ())
        ],
    }


def _columns(found: WorkspaceMap) -> dict[str, Array]:
    """Return the quantities (n,) at the reachable points, by name with unit."""
    space = found.space
    quantities = {found.quantity(name): values for name, values in space.poses.coordinates.items()}
    if space.position is not None:
        for name, values in zip(WORLD_AXES, space.position[space.reachable].T, strict=True):
            quantities[f"{name}, m"] = values
    for name, angles in (("elevation, deg", space.elevation), ("azimuth, deg", space.azimuth)):
        if angles is not None:
            quantities[name] = np.degrees(angles[space.reachable])
    # `driving` is the distance from poses that the coordinates do not determine; `pointing` the distance from
    # poses in which a motion of the coordinates does not turn the axis
    quantities["distance from singular"] = space.driving[space.reachable]
    if space.pointing is not None:
        quantities["distance from singular, axis"] = space.pointing[space.reachable]
    if found.conditioning is not None:
        quantities["conditioning"] = found.conditioning
    if found.has_shapes:
        quantities["clearance, m"] = found.clearance
    quantities["beyond singular"] = space.poses.beyond.astype(float)
    return quantities


def _csv(found: WorkspaceMap) -> str:
    """Return the CSV, with one row for each reachable point."""
    quantities, text = _columns(found), io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(quantities)
    writer.writerows([f"{value:.9g}" for value in row] for row in np.stack(list(quantities.values()), axis=1))
    return text.getvalue()
