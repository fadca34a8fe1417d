"""Shapes of bodies as URDF visuals, for the eye only: in nanometers, through roll, pitch and yaw."""

from __future__ import annotations

import math
from collections.abc import Iterable
from xml.etree.ElementTree import Element, SubElement

import numpy as np

from newton_euler.model.euler_parameters import rotation
from newton_euler.model.geometry import Box, Shape
from newton_euler.scalars import Array

COLORS = {
    "grey": (0.6, 0.6, 0.6),
    "orange": (0.9, 0.6, 0.0),
    "sky_blue": (0.35, 0.7, 0.9),
    "bluish_green": (0.0, 0.6, 0.5),
    "yellow": (0.95, 0.9, 0.25),
    "blue": (0.0, 0.45, 0.7),
    "vermilion": (0.8, 0.4, 0.0),
    "reddish_purple": (0.8, 0.6, 0.7),
}
"""Colors that everybody can tell apart (Okabe and Ito, Color Universal Design, 2008)."""


def numbers(values: Iterable[float]) -> str:
    """Numbers as a URDF attribute: the shortest text that reads back as the same doubles."""
    return " ".join(repr(float(value) + 0.0) for value in values)  # + 0.0 turns -0.0 into 0.0


def _rounded(values: Iterable[float]) -> str:
    return numbers(round(float(value), 9) for value in values)


def color(index: int) -> str:
    """The material of body number `index`."""
    return list(COLORS)[index % len(COLORS)]


def add_materials(robot: Element) -> None:
    """Define all `COLORS` as materials."""
    for name, rgb in COLORS.items():
        material = SubElement(robot, "material", name=name)
        SubElement(material, "color", rgba=numbers((*rgb, 1.0)))


def add_visual(link: Element, shape: Shape, origin: Array, material: str) -> None:
    """Draw a shape on a link whose frame is parallel to the world with its origin at `origin` (3,).

    A capsule becomes a cylinder, which is what URDF has.
    """
    visual = SubElement(link, "visual")
    if isinstance(shape, Box):
        center, rpy = shape.center, roll_pitch_yaw(rotation(shape.quaternion))
    else:
        center, rpy = 0.5 * (shape.start + shape.end), _along(shape.end - shape.start)
    SubElement(visual, "origin", xyz=_rounded(center - origin), rpy=_rounded(rpy))
    geometry = SubElement(visual, "geometry")
    if isinstance(shape, Box):
        SubElement(geometry, "box", size=_rounded(2.0 * shape.half_sizes))
    else:
        length = float(np.linalg.norm(shape.end - shape.start))
        SubElement(geometry, "cylinder", radius=_rounded([shape.radius]), length=_rounded([length]))
    SubElement(visual, "material", name=material)


def roll_pitch_yaw(matrix: Array) -> tuple[float, float, float]:
    """Angles of R = R_z(yaw) R_y(pitch) R_x(roll) for a (3, 3) rotation; roll is 0 at pitch 90 deg."""
    cosine = math.hypot(matrix[0, 0], matrix[1, 0])
    pitch = math.atan2(-matrix[2, 0], cosine)
    if cosine < 1e-12:
        return 0.0, pitch, math.atan2(-matrix[0, 1], matrix[1, 1])
    return (
        math.atan2(matrix[2, 1], matrix[2, 2]),
        pitch,
        math.atan2(matrix[1, 0], matrix[0, 0]),
    )


def _along(direction: Array) -> tuple[float, float, float]:
    """Roll, pitch and yaw that turn z to a direction (3,)."""
    x, y, z = direction
    return 0.0, math.atan2(math.hypot(x, y), z), math.atan2(y, x)
