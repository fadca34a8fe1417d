"""Evidence by the shapes of bodies: density, place of the center of mass, and size of the inertia.

Shapes are read only for large differences, and only those of the bodies concerned. The convex hull of a
body's shapes stands for its volume, since meshes overlap and are seldom closed.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from crosscheck.differences.difference import Difference, Evidence, Quantity, Side
from crosscheck.differences.links import composite, placed_masses, relative_frames
from newton_euler.errors import NewtonEulerError
from newton_euler.reading.hulls import Hull, convex_hull
from newton_euler.reading.robot import RobotFile
from newton_euler.scalars import Array

MIN_RATIO = 2.0
"""Smallest ratio of masses, and of radii of gyration, of which shapes can tell the right one."""

MIN_SHIFT = 0.01
"""Smallest distance of centers of mass, m, of which shapes can tell the right one."""

DENSITIES = (20.0, 50.0, 5_000.0, 20_000.0)
"""kg/m^3, densities of a convex hull: below the first and above the last one implausible, since metals are
lighter; between the others plausible."""

GYRATIONS = (0.5, 0.6, 1.6, 2.0)
"""Radii of gyration relative to that of the homogeneous hull, with the same meanings."""

MARGIN = 0.1
"""Part of the diagonal of a box by which a center of mass is clearly outside."""

MIN_LENGTH = 0.02
"""Longest side, m, of shapes below which they are a marker and not the shape of the body."""

MAX_BODIES = 12
"""Largest number of rows for which shapes are read, the first ones."""

Bodies = tuple[tuple[int, ...], tuple[int, ...]]
"""Indices, in each robot, of bodies that are fixed to each other."""


@dataclass(frozen=True, eq=False)
class Solid:
    """Bodies of one robot that are fixed to each other.

    Attributes:
        mass: kg.
        center: (3,) m, center of mass, in the frame of the first body.
        gyration: m, radius of gyration.
        hull: convex hull of the shapes in the same frame; None without shapes.
    """

    mass: float
    center: Array
    gyration: float
    hull: Hull | None = None


def shape_evidence(
    files: tuple[RobotFile, RobotFile], rows: Sequence[tuple[Difference, Bodies | None]]
) -> list[tuple[Evidence, ...]]:
    """Return the evidence on each of some true differences.

    Args:
        files: both files.
        rows: the differences and the bodies that they are about; None for other elements.
    """
    asked: dict[int, Bodies] = {}
    for number, (row, bodies) in enumerate(rows):
        if bodies is not None and len(asked) < MAX_BODIES:
            first, second = (_solid(file, own, {}) for file, own in zip(files, bodies, strict=True))
            if _is_large(row, first, second):
                asked[number] = bodies
    points = [
        _points(file, {k for bodies in asked.values() for k in bodies[side]})
        for side, file in enumerate(files)
    ]
    found: list[tuple[Evidence, ...]] = [()] * len(rows)
    for number, bodies in asked.items():
        first, second = (_solid(*each) for each in zip(files, bodies, points, strict=True))
        found[number] = tuple(_evidence(rows[number][0], first, second))
    return found


def _is_large(row: Difference, first: Solid, second: Solid) -> bool:
    """Return whether a difference is so large that shapes can tell which value is right."""
    match row.quantity:
        case Quantity.MASS:
            pair = first.mass, second.mass
        case Quantity.INERTIA:
            pair = first.gyration, second.gyration
        case _:
            return row.quantity is Quantity.CENTER and row.size > MIN_SHIFT
    return max(pair) > MIN_RATIO * min(pair) > 0.0


def _points(file: RobotFile, bodies: set[int]) -> dict[int, Array]:
    """Return points (n, 3) of the shapes of bodies of a file, in the frames of the bodies."""
    names = {file.robot.bodies[k].name: k for k in bodies}
    if not names or not file.source or not Path(file.source).is_file():
        return {}
    with suppress(NewtonEulerError):
        if file.format == "URDF":
            from urdf.shape_points import shape_points as of_urdf

            found = of_urdf(file.source, names)
        else:
            from mjcf.shape_points import shape_points as of_mjcf

            found = of_mjcf(file.source, names)
        return {names[name]: points for name, points in found.items()}
    return {}


def _solid(file: RobotFile, bodies: tuple[int, ...], points: dict[int, Array]) -> Solid:
    """Return bodies that are fixed to each other as one solid.

    Args:
        file: file of the bodies.
        bodies: their indices.
        points: points of their shapes, by index of the body.
    """
    frames = relative_frames(bodies, file.robot.placements())
    mass, center, inertia = composite(placed_masses(file.robot, bodies, frames), np.zeros(3))
    corners = [frames[k].position + points[k] @ frames[k].rotation.T for k in bodies if k in points]
    gyration = float(np.sqrt(max(0.0, 0.5 * np.trace(inertia)) / mass)) if mass > 0.0 else 0.0
    return Solid(mass, center, gyration, convex_hull(np.concatenate(corners)) if corners else None)


def _evidence(row: Difference, first: Solid, second: Solid) -> Iterator[Evidence]:
    """Yield the evidence on one difference."""
    hull = first.hull or second.hull
    if hull is None or max(hull.high - hull.low) < MIN_LENGTH:
        return
    match row.quantity:
        case Quantity.MASS:
            densities = first.mass / hull.volume, second.mass / hull.volume
            text = f"{densities[0]:.0f} against {densities[1]:.0f} kg/m^3 in the hull of its shapes"
            yield from _of_plausible(densities, DENSITIES, text)
        case Quantity.INERTIA:
            ratios = first.gyration / hull.gyration, second.gyration / hull.gyration
            text = f"radii of gyration of {first.gyration:.3g} against {second.gyration:.3g} m"
            homogeneous = f"the homogeneous hull of its shapes has {hull.gyration:.3g} m"
            yield from _of_plausible(ratios, GYRATIONS, f"{text}; {homogeneous}")
        case Quantity.CENTER:
            values = np.array([row.first, row.second], dtype=float)
            # both values of a row are in one frame; that of the hull may be another one
            if first.hull is None or not np.allclose(first.center, values[0], atol=1e-9):
                return
            outside = [_outside(hull, value) for value in values]
            limit = MARGIN * float(np.linalg.norm(hull.high - hull.low))
            if min(outside) == 0.0 and max(outside) > limit:
                text = f"the other value is {1e3 * max(outside):.3g} mm outside the box around its shapes"
                yield Evidence(Side.FIRST if outside[0] == 0.0 else Side.SECOND, text)


def _of_plausible(
    values: tuple[float, float], limits: tuple[float, float, float, float], text: str
) -> Iterator[Evidence]:
    """Yield evidence if one of two values, first and second, is plausible and the other one implausible."""
    for side, value, other in zip((Side.FIRST, Side.SECOND), values, values[::-1], strict=True):
        if limits[1] <= value <= limits[2] and not limits[0] <= other <= limits[3]:
            yield Evidence(side, text)


def _outside(hull: Hull, point: Array) -> float:
    """Return the distance, m, of a point (3,) from the box around a hull; 0 inside."""
    return float(np.linalg.norm(np.maximum(0.0, np.maximum(hull.low - point, point - hull.high))))
