"""Shapes of a model file in the terms of the file: what touches other bodies, and what is drawn.

Readers of file formats make them for `crosscheck diff --geometry`, beside the description of the robot in
`newton_euler.reading.robot`, which has no shapes.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import NamedTuple

import numpy as np

from newton_euler.reading.robot import Placement
from newton_euler.scalars import Array

GROUND = "world"
"""Name of the ground as the body of a shape."""


class Role(StrEnum):
    """Purpose of a shape."""

    COLLISION = "collision"
    """The shape can touch other shapes."""
    VISUAL = "visual"
    """The shape is only drawn."""


@dataclass(frozen=True, eq=False)
class FileShape:
    """Shape of a body.

    Attributes:
        body: name of the body as `crosscheck diff` shows it, or `GROUND`.
        role: its purpose.
        kind: "box", "sphere", "cylinder", "capsule", "ellipsoid", "plane", "height field" or "mesh".
        placement: of the shape's frame in the frame of the body. Cylinders and capsules are along z.
        size: m, the sides of a box; radius of a sphere, and length of a cylinder or of the cylindrical part
            of a capsule; semi-axes of an ellipsoid; half sides, height and depth of a height field; empty for
            planes and meshes.
        vertices: (n, 3) m, scaled vertices of a mesh in the shape's frame; None for a mesh that is not read.
        scale: (3,) factors from the mesh file to `vertices`.
        contact: numbers that decide whether and how the shape touches others, by name, such as "condim".
    """

    body: str
    role: Role
    kind: str
    placement: Placement
    size: Array
    vertices: Array | None = None
    scale: Array = field(default_factory=lambda: np.ones(3))
    contact: Mapping[str, tuple[float, ...]] = field(default_factory=dict)


class FileShapes(NamedTuple):
    """Shapes of a model file.

    Attributes:
        shapes: shapes as they are written.
        variants: the same shapes read from texts whose numbers are changed within their digits, as in
            `newton_euler.reading.robot.RobotFile`; without vertices.
        notes: what could not be read, one sentence each.
    """

    shapes: tuple[FileShape, ...]
    variants: tuple[tuple[FileShape, ...], ...] = ()
    notes: tuple[str, ...] = ()


def note_of_meshes(missing: list[str]) -> tuple[str, ...]:
    """Return one note about mesh files that cannot be read; none without such files."""
    names = [*dict.fromkeys(missing)]
    if not names:
        return ()
    more = f" and {len(names) - 2} more" if names[2:] else ""
    return (f"meshes are compared by place only, as files cannot be read: {', '.join(names[:2])}{more}",)
