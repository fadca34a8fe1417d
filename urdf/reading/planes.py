"""Planes of the planar joints of a URDF: the format defines the axis of a joint as the normal of its plane.

Pinocchio's parser ignores the axis, and takes the plane across z of the joint's frame. `turned_planes` finds
the joints for which this is another plane.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET

import numpy as np

from newton_euler.scalars import Array
from urdf.errors import UrdfError


def turned_planes(root: ET.Element) -> dict[str, Array]:
    """Return the unit normals (3,) of planar joints whose plane is not across z, by name of the joint.

    Args:
        root: root element of a URDF.

    Raises:
        UrdfError: for a normal without direction.
    """
    normals = {}
    for joint in root.findall("joint"):
        if joint.get("type") != "planar":
            continue
        axis = axis_vector(joint)
        if not np.any(axis):
            raise UrdfError(f"joint {joint.get('name')!r}: its axis is 0 0 0; needed: a direction")
        if np.any(axis[:2]) or axis[2] < 0.0:
            normals[str(joint.get("name"))] = axis / np.linalg.norm(axis)
    return normals


def axis_vector(joint: ET.Element) -> Array:
    """Return the axis (3,) of a joint as the file has it, of any length; x without the element `<axis>`."""
    element = joint.find("axis")
    text = "1 0 0" if element is None else element.get("xyz", "0 0 0")
    return np.array([float(number) for number in text.split()])


def axes_of_plane(normal: Array) -> Array:
    """Return two axes of a plane and its unit normal (3,) as rows (3, 3): x, y, z, by the shortest turn."""
    x, y, z = normal
    if z < -1.0 + 1e-12:
        return np.diag([1.0, -1.0, -1.0])  # half a turn about x
    turn = 1.0 / (1.0 + z)
    first = 1.0 - turn * x * x, -turn * x * y, -x
    second = -turn * x * y, 1.0 - turn * y * y, -y
    return np.array([first, second, normal])
