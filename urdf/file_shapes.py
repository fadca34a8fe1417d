"""Shapes of a URDF's links, for collisions and drawn ones, for a comparison of files."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path
from typing import NamedTuple

import numpy as np

from newton_euler.model.geometry import Mesh
from newton_euler.model.source_file import read_xml, xml_tree
from newton_euler.reading.digits import VARIANTS, NumbersOfText
from newton_euler.reading.file_shapes import FileShape, FileShapes, Role, note_of_meshes
from newton_euler.scalars import Array
from urdf.reading.source import SourceError, parsed
from urdf.reading.visuals import UnusableShape, mesh_file, read_meshes, shape_numbers
from urdf.robot import ANGLES, NUMBERS, origin_of

SIZES = {
    "box": (("size", 3),),
    "sphere": (("radius", 1),),
    "cylinder": (("radius", 1), ("length", 1)),
    "capsule": (("radius", 1), ("length", 1)),
}
"""Attributes of a shape and their count of numbers, by the tag of the shape."""

SHAPE_NUMBERS = NUMBERS | {"size", "radius", "length", "scale"}
"""Names of attributes with numbers, those of shapes included."""

MESHES_AT_ONCE = 8
"""Number of mesh files that one process reads, whose time is limited."""


class _Element(NamedTuple):
    """Element of a shape in a URDF.

    Attributes:
        link: name of the link.
        role: purpose of the shape.
        element: XML element.
        kind: tag of its geometry; "" without geometry.
    """

    link: str
    role: Role
    element: ET.Element
    kind: str


def file_shapes(path: str) -> FileShapes:
    """Read the shapes of a URDF, and the vertices of their meshes.

    Args:
        path: path of the file.

    Raises:
        SourceError: for a file that cannot be read or that is no URDF.
    """
    text = read_xml(path, SourceError)
    elements = _elements(parsed(path, text))
    vertices, missing = _vertices(path, elements)
    shapes: list[FileShape] = []
    problems = []
    readable = []
    for number, each in enumerate(elements):
        try:
            shapes.append(_shape(each, vertices.get(number)))
            readable.append(number)
        except UnusableShape as error:
            problems.append(f"{each.role} of link {each.link!r} is not compared: {error}")
    numbers = NumbersOfText(text, SHAPE_NUMBERS.__contains__, is_angle=lambda _, name: name in ANGLES)
    random = np.random.default_rng(0)
    variants = []
    for _ in range(VARIANTS):
        changed = _elements(xml_tree(numbers.variant(random)))
        variants.append(tuple(_shape(changed[number], None) for number in readable))
    return FileShapes(tuple(shapes), tuple(variants), (*note_of_meshes(missing), *problems))


def _elements(root: ET.Element) -> list[_Element]:
    """Return the elements of shapes, those of one link together."""
    found = []
    for link in root.findall("link"):
        for role in Role:
            for element in link.findall(role):
                kinds = [child.tag for child in element.findall("geometry/*")]
                found.append(_Element(str(link.get("name")), role, element, kinds[0] if kinds else ""))
    return found


def _vertices(path: str, elements: list[_Element]) -> tuple[dict[int, Array], list[str]]:
    """Read the meshes of shapes.

    Returns:
        Scaled vertices (n, 3) of each mesh, by the number of its element; and names of files that cannot be
        read.
    """
    files: dict[int, tuple[Path, Array]] = {}
    missing = []
    for number, each in enumerate(elements):
        if each.kind == "mesh":
            try:
                files[number] = mesh_file(Path(path), each.element)
            except UnusableShape:
                missing += [name.rpartition("/")[2] for name in _mesh_names(each)]
    paths = list(dict.fromkeys(file for file, _ in files.values()))
    meshes: dict[Path, Mesh | None] = {}
    for start in range(0, len(paths), MESHES_AT_ONCE):
        meshes |= read_meshes(paths[start : start + MESHES_AT_ONCE])
    for file in [file for file, mesh in meshes.items() if mesh is None]:
        meshes |= read_meshes([file])  # the time may have been too short for all
    missing += [file.name for file, mesh in meshes.items() if mesh is None]
    found = {}
    for number, (file, scale) in files.items():
        mesh = meshes[file]
        if mesh is not None:
            found[number] = np.asarray(scale * mesh.vertices)
    return found, missing


def _mesh_names(element: _Element) -> list[str]:
    """Return the name of the mesh file of a shape, as the file has it."""
    return [mesh.get("filename", "") for mesh in element.element.findall("geometry/mesh")]


def _shape(element: _Element, vertices: Array | None) -> FileShape:
    """Describe a shape; raises `UnusableShape` for an unknown geometry and for invalid numbers.

    Args:
        element: element of the shape.
        vertices: (n, 3) m, of a mesh that has been read.
    """
    geometry = element.element.find(f"geometry/{element.kind}") if element.kind else None
    if geometry is None or element.kind not in (*SIZES, "mesh"):
        raise UnusableShape(f"its geometry is {element.kind or 'missing'}")
    size, scale = np.zeros(0), np.ones(3)
    if element.kind != "mesh":
        size = np.concatenate([shape_numbers(geometry, *each) for each in SIZES[element.kind]])
    elif geometry.get("scale"):
        scale = shape_numbers(geometry, "scale", 3)
    return FileShape(
        body=element.link,
        role=element.role,
        kind=element.kind,
        placement=origin_of(element.element),
        size=size,
        vertices=vertices,
        scale=scale,
    )
