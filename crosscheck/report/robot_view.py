"""Draw the bodies of two robots as ellipsoids, seen from several directions.

In: `crosscheck.differences.shapes.Shapes`. Out: a `RobotView` for each direction, in the units of an SVG
picture: x to the right, y down. The template `diff.html` writes the picture. The projection is parallel, so
that ellipsoids become ellipses.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from crosscheck.differences.shapes import Mark, Shape, Shapes
from newton_euler.scalars import Array

WIDTH, MAX_HEIGHT, MARGIN = 360.0, 420.0, 34.0
"""Width and largest height of a picture, and space around the robots, in which the marks stand."""

DIRECTIONS = (("from the front, right and above", -50.0, 25.0), ("front", 0.0, 0.0), ("right", -90.0, 0.0))
"""Name of each view, and the direction from the robot to the viewer: the angle from x to y, and the angle
above the ground, degrees. Robots look along x in most files; z points up."""

MAX_MARKS = 12
"""Largest number of rows that are marked in a picture."""

MARK_DISTANCE = 19.0
"""Smallest vertical distance of two marks."""

MAX_RADIUS = 0.5
"""Largest semi-axis of an ellipsoid that a picture makes room for, relative to the size of the robot."""

MIN_RADIUS = 0.8
"""Smallest semi-axis of an ellipse that is drawn; a thin body stays visible."""


class Ellipse(NamedTuple):
    """An ellipse: kind ("both", "first" or "second"), center, semi-axes, angle in degrees, and its title."""

    kind: str
    x: float
    y: float
    rx: float
    ry: float
    angle: float
    title: str


class Segment(NamedTuple):
    """A line between two points; for the kind see `Ellipse`."""

    kind: str
    x1: float
    y1: float
    x2: float
    y2: float


class Dot(NamedTuple):
    """A point of a joint; for the kind see `Ellipse`."""

    kind: str
    x: float
    y: float


class Label(NamedTuple):
    """The number of a row of the table beside the picture, with a line to a point of the picture."""

    row: int
    x: float
    y: float
    x_at: float
    y_at: float


@dataclass(frozen=True)
class RobotView:
    """Picture of two robots from one direction.

    Attributes:
        title: the direction in words.
        width, height: size of the picture.
        ellipses: bodies, those behind others first.
        segments: lines from bodies to their parents.
        dots: joints.
        labels: numbers of rows of the table of differences, from 1.
    """

    title: str
    width: float
    height: float
    ellipses: list[Ellipse]
    segments: list[Segment]
    dots: list[Dot]
    labels: list[Label]


class _Camera:
    """Parallel projection from the world to a picture.

    Attributes:
        height: of the picture.
    """

    def __init__(self, shapes: Sequence[Shape], azimuth: float, elevation: float) -> None:
        """Fit the picture to the bodies; for the angles see `DIRECTIONS`."""
        a, e = math.radians(azimuth), math.radians(elevation)
        right = np.array([-math.sin(a), math.cos(a), 0.0])
        self._to_viewer = np.array([math.cos(e) * math.cos(a), math.cos(e) * math.sin(a), math.sin(e)])
        self._axes = np.array([right, -np.cross(self._to_viewer, right)])  # right and down
        points = np.array([point for shape in shapes for point in (shape.point, shape.center)]) @ self._axes.T
        radii = np.array(
            [np.sqrt(np.maximum(np.diag(self._spread(shape)), 0.0)) for shape in shapes for _ in range(2)]
        )
        size = float(np.ptp(points, axis=0).max())
        radii = np.minimum(radii, MAX_RADIUS * size) if size else radii
        low, high = (points - radii).min(axis=0), (points + radii).max(axis=0)
        extent = np.maximum(high - low, 1e-9)
        room = np.array([WIDTH, MAX_HEIGHT]) - 2.0 * MARGIN
        self._scale = float(np.min(room / extent))
        self.height = float(extent[1] * self._scale + 2.0 * MARGIN)
        self._shift = np.array([WIDTH, self.height]) / 2.0 - self._scale * (low + high) / 2.0

    def _spread(self, shape: Shape) -> Array:
        """Return the projected spread (2, 2), m^2, of a body."""
        spread: Array = self._axes @ np.array(shape.spread) @ self._axes.T
        return spread

    def place(self, point: Sequence[float]) -> tuple[float, float]:
        """Return the place of a point of the world in the picture."""
        x, y = self._scale * (self._axes @ np.array(point)) + self._shift
        return round(float(x), 1), round(float(y), 1)

    def nearness(self, shape: Shape) -> float:
        """Return the distance of a body towards the viewer, m."""
        return float(self._to_viewer @ np.array(shape.center))

    def ellipse(self, kind: str, shape: Shape, title: str) -> Ellipse:
        """Return the projected ellipsoid of a body."""
        values, axes = np.linalg.eigh(self._spread(shape))
        radii = np.maximum(self._scale * np.sqrt(np.maximum(values, 0.0)), MIN_RADIUS)
        angle = math.degrees(math.atan2(axes[1, 1], axes[0, 1]))
        rx, ry = (round(float(radius), 1) for radius in radii[::-1])
        return Ellipse(kind, *self.place(shape.center), rx, ry, round(angle, 1), title)


def robot_views(shapes: Shapes) -> list[RobotView]:
    """Draw two robots from each direction.

    Bodies of the first robot are drawn, and bodies of the second one where they differ: in mass, center of
    mass, inertia or place.
    """
    ghosts = [shape.differs or shape.displaced for shape in shapes.second]
    shown = [
        *shapes.first,
        *(shape for shape, is_shown in zip(shapes.second, ghosts, strict=True) if is_shown),
    ]
    if not shown:
        return []
    views = []
    for title, azimuth, elevation in DIRECTIONS:
        camera = _Camera(shown, azimuth, elevation)
        layers = [
            ("first", shapes.first, [True] * len(shapes.first)),
            ("second", shapes.second, ghosts),
        ]
        ellipses, segments, dots = [], [], []
        for file, bodies, are_shown in layers:
            drawn = [shape for shape, is_shown in zip(bodies, are_shown, strict=True) if is_shown]
            for shape in sorted(drawn, key=camera.nearness):
                if shape.mass > 0.0:
                    kind = file if shape.differs or shape.displaced else "both"
                    text = f"{shape.name}: {shape.mass:.6g} kg"
                    ellipses.append(
                        camera.ellipse(kind, shape, text if kind == "both" else f"{text}, {file} file")
                    )
            for shape in drawn:
                kind = "second" if file == "second" else "both"
                if shape.parent >= 0:
                    ends = camera.place(bodies[shape.parent].point), camera.place(shape.point)
                    segments.append(Segment(kind, *ends[0], *ends[1]))
                dots.append(
                    Dot(
                        "first" if shape.joint_differs and file == "first" else kind,
                        *camera.place(shape.point),
                    )
                )
        labels = list(_labels(shapes.marks[:MAX_MARKS], camera))
        views.append(RobotView(title, WIDTH, round(camera.height, 1), ellipses, segments, dots, labels))
    return views


def _labels(marks: Sequence[Mark], camera: _Camera) -> Iterator[Label]:
    """Yield the numbers of rows at the left and right side of the picture, at the height of their points."""
    places = [(mark.row + 1, *camera.place(mark.point)) for mark in marks]
    half = WIDTH / 2.0
    for x, of_side in (
        (MARGIN / 2.0, [place for place in places if place[1] < half]),
        (WIDTH - MARGIN / 2.0, [place for place in places if place[1] >= half]),
    ):
        # from top to bottom, each below the one before; then all up by what the last one is too low
        bottom = camera.height - MARK_DISTANCE / 2.0
        heights: list[float] = []
        of_side.sort(key=lambda place: place[2])
        for _, _, y in of_side:
            heights.append(max(y, heights[-1] + MARK_DISTANCE if heights else MARK_DISTANCE / 2.0))
        for index in reversed(range(len(heights))):
            heights[index] = min(heights[index], bottom)
            bottom = heights[index] - MARK_DISTANCE
        for (row, x_at, y_at), y in zip(of_side, heights, strict=True):
            yield Label(row, x, round(y, 1), x_at, y_at)
