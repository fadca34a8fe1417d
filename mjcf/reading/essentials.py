"""Reduce the text of an MJCF file to the elements that masses, joints, loops and drives depend on.

Meshes are most of a model's bytes, and often missing. A body with an `<inertial>` does not need its shapes.
`essential_texts` removes these shapes, the assets that no remaining shape needs, and sensors,
contacts and pictures. MuJoCo compiles what remains to the same bodies in a few milliseconds.
"""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from collections.abc import Callable, Container, Iterator
from pathlib import PurePosixPath
from typing import NamedTuple

from mjcf.reading.xml_scan import XmlTexts
from newton_euler.model.source_file import xml_tree

UNUSED = frozenset(
    ("visual", "statistic", "contact", "sensor", "custom", "light", "camera", "texture", "skin")
)
"""Tags of elements that change no mass, joint, loop, drive or keyframe, with all that is in them."""

SHAPES = ("geom", "collision")
"""Tags of shapes in an MJCF and a URDF."""

TEMPLATES = ("composite", "flexcomp")
"""Tags of elements that MuJoCo expands to bodies; shapes in them belong to these bodies."""

SHAPE_ASSETS = ("mesh", "hfield")
"""Tags of assets that shapes refer to, by an attribute of the same name."""

INHERITED = ("mesh", "mass", "density")
"""Attributes of shapes, or of the defaults of their classes, that tell whether a mesh has mass."""

NO_MASS = {"pos": "0 0 0", "mass": "1e-14", "diaginertia": "1e-14 1e-14 1e-14"}
"""Inertia of a body whose shapes are missing, the smallest that MuJoCo accepts for a moving body."""


class Essentials(NamedTuple):
    """Reduced texts of a file and of the files that it includes.

    Attributes:
        texts: the texts, the top file first, by the names with which they now include each other.
        loaded: names of bodies whose mass comes from meshes, which the texts refer to.
        missing: names of bodies whose mass comes from missing meshes; these bodies have `NO_MASS`.
    """

    texts: dict[str, str]
    loaded: tuple[str, ...]
    missing: tuple[str, ...]


def essential_texts(files: XmlTexts, shapes_of: Container[str | None] = frozenset()) -> Essentials:
    """Reduce the texts of a file and of the files that it includes.

    Args:
        files: the texts.
        shapes_of: names of bodies that keep their shapes although they have an `<inertial>`; "world" is the
            ground, and None stands for bodies without name.
    """
    roots = {path: xml_tree(text) for path, text in files.texts.items()}
    elements = [(path, each) for path, root in roots.items() for each in root.iter()]
    keeps_all = any(each.get("inertiafromgeom") == "true" for _, each in elements)
    # geoms that tendons wrap around
    wrapped = {str(each.get("geom")) for _, each in elements if each.tag == "geom" and "geom" in each.attrib}
    name_of = {path: f"{number}.xml" for number, path in enumerate(roots)}
    for path, element in elements:
        if (path, element.get("file", "")) in files.included and element.tag in ("include", "model"):
            element.set("file", name_of[files.included[path, element.get("file", "")]])
    _write_defaults(list(roots.values()))
    # shapes of the world have no mass; those of an attached model's world may belong to a body
    attaches = any(each.tag == "model" for _, each in elements)
    for number, root in enumerate(roots.values()):
        _reduce(root, False, attaches and number > 0, keeps_all, wrapped, shapes_of)
    loaded, missing = _reduce_assets(list(roots.values()), files.find_asset, shapes_of)
    _remove_empty({name_of[path]: root for path, root in roots.items()})
    texts = {name_of[path]: ET.tostring(root, encoding="unicode") for path, root in roots.items()}
    return Essentials(texts, tuple(loaded), tuple(missing))


def _write_defaults(roots: list[ET.Element]) -> None:
    """Write the meshes, and masses and densities of 0, that shapes get from their classes into the shapes."""
    of_class: dict[str, dict[str, str]] = {}

    def read_defaults(section: ET.Element, inherited: dict[str, str]) -> None:
        for geom in section.findall("geom"):
            inherited = inherited | {name: geom.attrib[name] for name in INHERITED if name in geom.attrib}
            geom.attrib.pop("mesh", None)
        of_class[section.get("class", "main")] = inherited
        for inner in section.findall("default"):
            read_defaults(inner, inherited)

    def write(element: ET.Element, childclass: str) -> None:
        childclass = element.get("childclass", childclass)
        for child in element:
            if child.tag == "geom":
                for name, value in of_class.get(child.get("class", childclass), {}).items():
                    # other numbers stay in the defaults, so that one number counts once
                    if name == "mesh" or _is_zero(value):
                        child.attrib.setdefault(name, value)
            elif child.tag not in ("default", "tendon"):
                write(child, childclass)

    for root in roots:
        for section in root.findall("default"):
            read_defaults(section, of_class.get("main", {}))
    if any(of_class.values()):
        for root in roots:
            write(root, "main")


def _is_massless(geom: ET.Element) -> bool:
    """Return whether a shape has no mass, by its mass, or else by its density."""
    return _is_zero(geom.get("mass", geom.get("density", "")))


def _is_zero(number: str) -> bool:
    """Return whether a text is the number 0."""
    return bool(re.fullmatch(r"\s*[+-]?(0+\.?0*|\.0+)(e[+-]?\d+)?\s*", number, re.IGNORECASE))


def _remove_empty(roots: dict[str, ET.Element]) -> None:
    """Remove the elements that include files without elements, which MuJoCo refuses.

    Args:
        roots: root elements by the name of the file; a file comes before those that it includes.
    """
    empty: set[str | None] = set()
    for name, root in reversed(roots.items()):
        for parent in list(root.iter()):
            for child in parent.findall("include"):
                if child.get("file") in empty:
                    parent.remove(child)
        if not len(root):
            empty.add(name)


def _reduce(
    element: ET.Element,
    removes_shapes: bool,
    world_has_mass: bool,
    keeps_all: bool,
    wrapped: set[str],
    shapes_of: Container[str | None],
) -> None:
    """Remove from an element what masses, joints, loops and drives do not depend on.

    Args:
        element: root element, or an element in it.
        removes_shapes: True if the shapes directly in the element do not matter.
        world_has_mass: True if the shapes of the world matter.
        keeps_all: True if all shapes matter, even those of bodies with an inertia.
        wrapped: names of shapes that stay.
        shapes_of: names of bodies whose shapes stay.
    """
    for child in list(element):
        if child.tag in UNUSED or (
            child.tag in SHAPES and removes_shapes and child.get("name") not in wrapped
        ):
            element.remove(child)
            continue
        removes = removes_shapes
        if child.tag in ("body", "link"):
            keeps = keeps_all or child.get("name") in shapes_of
            removes = child.find("inertial") is not None and not keeps
        elif child.tag == "worldbody":
            removes = not (world_has_mass or keeps_all or "world" in shapes_of)
        elif child.tag == "material":
            child.attrib.pop("texture", None)
            child[:] = ()
        if child.tag not in TEMPLATES:
            _reduce(child, removes, world_has_mass, keeps_all, wrapped, shapes_of)


def _reduce_assets(
    roots: list[ET.Element], find_asset: Callable[[str, str], str | None], shapes_of: Container[str | None]
) -> tuple[list[str], list[str]]:
    """Remove the assets that no shape needs, and shapes whose assets are missing.

    Args:
        roots: root elements of the files.
        find_asset: as in `XmlTexts`.
        shapes_of: names of bodies whose shapes stay although they have an inertia.

    Returns:
        Names of bodies whose mass depends on assets that exist, and that are missing.
    """
    geoms = [
        (parent.tag, geom) for root in roots for parent in root.iter() for geom in parent.findall("geom")
    ]
    bodies = [each for root in roots for each in root.iter("body")]
    # meshes without mass, such as those that are only drawn
    massless = {
        geom
        for body in bodies
        if body.get("name") not in shapes_of
        for _, geom in _own_shapes(body)
        if _is_massless(geom)
    }
    shapes = [geom for parent, geom in geoms if parent not in ("default", "spatial") and geom not in massless]
    templates = [geom for parent, geom in geoms if parent == "default"]
    # a shape may get its mesh from the defaults of its class
    needed = {geom.get(tag) for geom in (*shapes, *(templates if shapes else ())) for tag in SHAPE_ASSETS}
    missing: set[str] = set()
    assets = [(section, each) for root in roots for section in root.iter("asset") for each in section]
    for section, asset in assets:
        if asset.tag not in SHAPE_ASSETS:
            continue
        file = asset.get("file", "")
        name = asset.get("name") or PurePosixPath(file).stem
        path = find_asset(asset.tag, file) if file and name in needed else None
        if name not in needed or (file and path is None):
            section.remove(asset)
            missing.add(name)
        elif path is not None:
            # the reduced text has no folder
            asset.set("file", path)
    for compiler in (each for root in roots for each in root.iter("compiler")):
        compiler.attrib.pop("strippath", None)
    # bodies whose shapes are meshes
    loaded_bodies, missing_bodies = [], []
    for body in bodies:
        has_inertia = body.find("inertial") is not None
        own_shapes = list(_own_shapes(body))
        of_mesh = [(parent, geom) for parent, geom in own_shapes if "mesh" in geom.attrib]
        meshes = {geom.get("mesh") for _, geom in of_mesh if geom not in massless}
        for parent, geom in of_mesh:
            if geom in massless or geom.get("mesh") in missing:
                parent.remove(geom)
        if has_inertia:
            continue
        if meshes & missing:
            missing_bodies.append(body.get("name", ""))
            ET.SubElement(body, "inertial", NO_MASS)
        elif meshes:
            loaded_bodies.append(body.get("name", ""))
    return loaded_bodies, missing_bodies


def _own_shapes(body: ET.Element) -> Iterator[tuple[ET.Element, ET.Element]]:
    """Yield the geoms of a body but not of bodies in it, each after the element that it is in."""
    for child in list(body):
        if child.tag == "geom":
            yield body, child
        elif child.tag in ("frame", "replicate"):
            yield from _own_shapes(child)
