"""Digits of the masses that bodies get from mesh files, by a few vertices of each mesh.

A mass from a mesh depends on numbers in the text: density, scale, position and orientation of the shape. To
read the meshes again for each variant of the text would take seconds. Instead, each mesh is replaced by the
hull of a few of its vertices; the relative change of the mass of the hull is that of the mesh.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Mapping
from dataclasses import replace
from itertools import product
from pathlib import PurePosixPath

import mujoco
import numpy as np

from mjcf.placements import rotation_of
from newton_euler.reading.robot import FileBody, Robot

DIRECTIONS = np.array([d for d in product((-1.0, 0.0, 1.0), repeat=3) if any(d)])
"""Directions in which the hull of a mesh has the farthest vertex."""


def with_hulls(texts: Mapping[str, str], model: mujoco.MjModel) -> dict[str, str]:
    """Return texts of MJCF files in which vertices take the place of mesh files.

    Args:
        texts: texts by name.
        model: their compiled model.
    """
    numbers = {model.mesh(number).name: number for number in range(model.nmesh)}
    found = {}
    for name, text in texts.items():
        root = ET.fromstring(text)
        for mesh in (each for section in root.iter("asset") for each in section.findall("mesh")):
            mesh_name = mesh.get("name") or PurePosixPath(mesh.get("file", "")).stem
            if "file" in mesh.attrib and mesh_name in numbers:
                mesh.attrib.pop("content_type", None)
                del mesh.attrib["file"]
                mesh.set("name", mesh_name)
                mesh.set("vertex", _hull(model, numbers[mesh_name]))
        found[name] = ET.tostring(root, encoding="unicode")
    return found


def _hull(model: mujoco.MjModel, number: int) -> str:
    """Return the outermost vertices of a mesh, m before its scale, with all digits."""
    start, count = int(model.mesh_vertadr[number]), int(model.mesh_vertnum[number])
    rotation = rotation_of(model.mesh_quat[number])
    # MuJoCo has moved the vertices to the principal axes of the mesh
    moved = model.mesh_vert[start : start + count] @ rotation.T + model.mesh_pos[number]
    vertices = moved / model.mesh_scale[number]
    outermost = np.unique(np.argmax(vertices @ DIRECTIONS.T, axis=0))
    return " ".join(map(repr, vertices[outermost].ravel().tolist()))


def with_mesh_masses(variant: Robot, robot: Robot, of_hulls: Robot) -> Robot:
    """Return a variant of a robot whose bodies have the masses of their meshes instead of those of hulls.

    Args:
        variant: robot with other last digits and with hulls for meshes.
        robot: the robot with its meshes.
        of_hulls: the robot with hulls. Bodies without meshes are the same in both.
    """
    bodies = zip(variant.bodies, robot.bodies, of_hulls.bodies, strict=True)
    return replace(variant, bodies=tuple(_with_mesh_mass(*each) for each in bodies))


def _with_mesh_mass(variant: FileBody, body: FileBody, of_hull: FileBody) -> FileBody:
    """Return a variant of a body with the mass of its meshes; for the arguments see `with_mesh_masses`."""
    size, size_of_hull = np.trace(body.inertia), np.trace(of_hull.inertia)
    if not (of_hull.mass > 0.0 and size_of_hull > 0.0):
        return variant
    return replace(
        variant,
        mass=body.mass * variant.mass / of_hull.mass,
        center=body.center + variant.center - of_hull.center,
        inertia=body.inertia + size / size_of_hull * (variant.inertia - of_hull.inertia),
    )
