"""A URDF file, checked before any parser expands it."""

from __future__ import annotations

import math
import os
import stat
import xml.etree.ElementTree as ET
from collections import Counter
from pathlib import Path
from xml.parsers import expat

import numpy as np

from urdf.errors import UrdfError

MAXIMUM_BYTES = 10_000_000

MAXIMUM_DEPTH = 50
"""Of nested elements; a URDF has a handful."""

LARGEST = 1e15
"""Of any number of a model, so that squares and triple products stay finite and keep digits."""

NUMBERS = {
    "origin": ("xyz", "rpy"),
    "axis": ("xyz",),
    "mass": ("value",),
    "inertia": ("ixx", "ixy", "ixz", "iyy", "iyz", "izz"),
    "limit": ("lower", "upper", "effort", "velocity"),
    "dynamics": ("damping", "friction"),
    "mimic": ("multiplier", "offset"),
}
"""Attributes that hold numbers, by element."""

JOINT_TYPES = ("revolute", "continuous", "prismatic", "fixed", "floating", "planar")


class SourceError(UrdfError):
    """A file that is no usable model: names the file and what is wrong where."""

    def __init__(self, path: str, problem: str) -> None:
        self.path = path
        self.problem = problem
        super().__init__(f"{path}: {problem}")


def read_text(path: str | os.PathLike[str]) -> str:
    """The text of a regular file of reasonable size; raises `SourceError`."""
    where = os.fspath(path)
    try:
        status = Path(path).stat()
        if not stat.S_ISREG(status.st_mode):  # a pipe would keep its reader waiting
            raise SourceError(where, "not a regular file")
        if status.st_size > MAXIMUM_BYTES:
            raise SourceError(where, f"larger than {MAXIMUM_BYTES} bytes")
        return Path(path).read_text(encoding="utf-8-sig")
    except OSError as error:
        raise SourceError(where, f"cannot be read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise SourceError(where, "not a UTF-8 text file") from error
    except ValueError as error:
        raise SourceError(repr(where), f"cannot be read: {error}") from error


def parsed(path: str, text: str) -> ET.Element:
    """The root of a URDF with names and numbers that can be.

    Raises:
        SourceError: naming the line or the element at fault.
    """
    _scan(path, text)
    root = ET.fromstring(text)
    if root.tag != "robot":
        raise SourceError(path, f"root element is <{root.tag:.100}>, not <robot>")
    for what in ("link", "joint"):
        names = [element.get("name") for element in root.findall(what)]
        if not all(names):
            raise SourceError(path, f"a {what} without a name")
        for name, count in Counter(names).items():
            if count > 1:
                raise SourceError(path, f"{what} {name!r}: {count} of that name")
    links = {link.get("name") for link in root.findall("link")}
    if not links:
        raise SourceError(path, "no links")
    for joint in root.findall("joint"):
        _check_joint(path, joint, links)
    for element in (*root.findall("link"), *root.findall("joint")):
        where = f"{element.tag} {element.get('name')!r}"
        for part in element.iter():
            for name in NUMBERS.get(part.tag, ()):
                if name in part.attrib:
                    _check_numbers(f"{where}: <{part.tag}>", path, name, part.attrib[name])
    return root


def check_inertias(path: str, root: ET.Element) -> None:
    """Raise `SourceError` for the first negative moment of inertia; Pinocchio's own error has no name."""
    for link in root.findall("link"):
        element = link.find("inertial/inertia")
        if element is None:
            continue
        xx, xy, xz, yy, yz, zz = (float(element.get(name, "0")) for name in NUMBERS["inertia"])
        moments = np.linalg.eigvalsh([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        if moments[0] < 0.0:
            text = ", ".join(f"{moment:.6g}" for moment in moments)
            problem = f"link {link.get('name')!r}: principal moments of inertia are {text} kg m^2"
            raise SourceError(path, f"{problem}; needed: none below 0")


def _scan(path: str, text: str) -> None:
    """Raise `SourceError` unless a text is well-formed XML without a document type."""
    parser = expat.ParserCreate()
    depth = 0

    def begin(tag: str, attributes: dict[str, str]) -> None:
        nonlocal depth
        depth += 1
        if depth > MAXIMUM_DEPTH:
            problem = f"line {parser.CurrentLineNumber}: more than {MAXIMUM_DEPTH} nested elements"
            raise SourceError(path, problem)

    def end(tag: str) -> None:
        nonlocal depth
        depth -= 1

    def refuse(*_: object) -> None:
        raise SourceError(path, f"line {parser.CurrentLineNumber}: a document type declaration, refused")

    parser.StartElementHandler, parser.EndElementHandler = begin, end
    parser.StartDoctypeDeclHandler = parser.EntityDeclHandler = refuse
    try:
        parser.Parse(text, True)
    except expat.ExpatError as error:
        problem = expat.errors.messages[error.code]
        raise SourceError(path, f"not XML: line {error.lineno}: {problem}") from error


def _check_joint(path: str, joint: ET.Element, links: set[str | None]) -> None:
    where = f"joint {joint.get('name')!r}"
    if joint.get("type") not in JOINT_TYPES:
        problem = f"{where}: unknown type {joint.get('type')!r:.100}; choose from: {', '.join(JOINT_TYPES)}"
        raise SourceError(path, problem)
    for end in ("parent", "child"):
        element = joint.find(end)
        link = None if element is None else element.get("link")
        if link not in links:
            raise SourceError(path, f"{where}: {end} link {link!r:.100} does not exist")


def _check_numbers(where: str, path: str, name: str, value: str) -> None:
    wanted = 3 if name in ("xyz", "rpy") else 1
    if len(value.split()) != wanted:
        raise SourceError(path, f"{where} has {name}={value!r:.100}; needed: {wanted} numbers")
    for token in value.split():
        try:
            number = float(token)
        except ValueError:
            number = math.nan
        # limits are not looked at, and are often as good as infinite
        if math.isnan(number) or (abs(number) > LARGEST and "<limit>" not in where):
            raise SourceError(path, f"{where} has {name}={value!r:.100}; needed: finite numbers")
