"""Check the XML text of an MJCF file, and its references to other files, before MuJoCo parses it.

A file may be hostile: it can expand to millions of elements, or refer to files outside of its folder.
`XmlScan` checks a file and all files that it refers to; `read_texts` returns the texts of the XML files.

The limits are in the table of `newton_euler.limits`, such as "file_size"; users change them by `--set`.
`exceeded(name, value)` returns a message, or "" if the value is within the limit.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

from mjcf.errors import MjcfError
from newton_euler.limits import MB, exceeded
from newton_euler.model import source_file
from newton_euler.model.source_file import NON_FINITE_WORDS, read_xml, scan

FOLDER_ATTRIBUTES = ("meshdir", "texturedir", "assetdir")
"""Attributes of `<compiler>` with folders of assets."""

ASSET_ELEMENTS = ("mesh", "texture", "hfield", "skin", "flexcomp", "composite")
"""Elements with files that MuJoCo reads: attributes `file`, `fileright` and so on."""


# fmt: off
FREE_TEXT = frozenset((
    "name", "class", "childclass", "model", "prefix", "file", "content_type", "meshdir", "texturedir",
    "assetdir", "body", "body1", "body2", "joint", "joint1", "joint2", "jointinparent", "geom", "geom1",
    "geom2", "site", "site1", "site2", "refsite", "sidesite", "cranksite", "slidersite", "tendon",
    "tendon1", "tendon2", "actuator", "mesh", "material", "texture", "hfield", "flex", "skin", "key",
    "camera", "target", "parent", "objname", "reftype", "refname", "instance", "plugin", "data",
))
# fmt: on
"""Attributes with names and other text, in which the words `inf` and `nan` are not numbers."""

KEY_FIELDS = ("qpos", "qvel", "act", "ctrl")
"""Attributes of keyframes with one number for each coordinate, velocity, activation or control."""


class SourceError(source_file.SourceError, MjcfError):
    """File that is not a usable model. The message has the file, the place in the file and the problem."""


class XmlTexts(NamedTuple):
    """Texts of an MJCF file and of the files that it includes.

    Attributes:
        texts: the texts by real path, the top file first.
        included: real path of each included file, by that of the including file and the attribute `file`.
        find_asset: returns the path of an asset from its tag and its attribute `file`; None if it is missing.
    """

    texts: dict[str, str]
    included: dict[tuple[str, str], str]
    find_asset: Callable[[str, str], str | None]


def read_texts(path: str, root: str | None = None) -> XmlTexts:
    """Read and check an MJCF file and the files that it includes, but not its meshes and textures.

    Args:
        path: path of the file. One that ends with `.urdf` may be a URDF, which MuJoCo reads too.
        root: folder that must contain all files, or None, see `XmlScan`.

    Raises:
        SourceError: for a file that cannot be read, that is not MJCF, or that includes a file outside of its
            folder.
    """
    checked_file = XmlScan(path, root, root_tag=None if path.lower().endswith(".urdf") else "mujoco")
    checked_file.scan_texts()
    return XmlTexts(checked_file.texts, checked_file.included, checked_file.find_asset)


@dataclass(frozen=True)
class _Reference:
    """Reference of an XML file to another file.

    Attributes:
        where: path of the XML file.
        line: line in the XML file; 0 if it is not known.
        element: tag of the element that refers to the file.
        target: path of the referenced file, as the XML file has it.
    """

    where: str
    line: int
    element: str
    target: str

    def refused(self, problem: str) -> SourceError:
        """Return the error for this reference, with its line, element and path."""
        line = f"line {self.line}: " if self.line else ""
        return SourceError(self.where, f"{line}{self.element} file {self.target!r:.200} {problem}")

    def within(self, root: str, folder: str) -> str:
        """Return the real path of the referenced file; raises `SourceError` for a path outside the root.

        Args:
            root: folder that must contain the file.
            folder: folder that the target is relative to.
        """
        path = os.path.realpath(os.path.join(folder, self.target))
        if os.path.commonpath((root, path)) != root:
            around = os.path.commonpath((root, path))  # smallest root that allows it
            raise self.refused(f"leads outside of {root!r}; if you trust the file: --set root={around}")
        if "\\" in self.target:
            raise self.refused("holds a backslash; needed: / between folders")
        return path


class XmlScan:
    """Check of an MJCF file and of the files that it includes or refers to, without building a tree of XML.

    Attributes:
        asset_bytes: total size of all files other than XML that MuJoCo may read.
        keyframe_sizes: for each keyframe, the number of values by field ("qpos", "ctrl", ...).
        texts: texts of the XML files by real path, the top file first.
        included: real path of each included file, by that of the including file and the attribute `file`.
    """

    def __init__(self, path: str, root: str | None, root_tag: str | None = "mujoco") -> None:
        """Prepare the check of the file `path`.

        Args:
            path: path of the file.
            root: folder that must contain all files, or None.
            root_tag: required tag of the file's root element; None allows any tag.
        """
        self._top_file, self._root_tag = path, root_tag
        self.texts: dict[str, str] = {}
        self.included: dict[tuple[str, str], str] = {}
        self._home = os.path.dirname(os.path.realpath(path))
        # without a root, included files must be in the folder of the file; assets may also be in neighboring
        # folders, unless the parent folder is the root of the disk
        parent = os.path.dirname(self._home)
        parent = self._home if parent == os.path.dirname(parent) else parent
        root = None if root is None else os.path.realpath(root)
        self._include_root, self._asset_root = root or self._home, root or parent
        # folders of all XML files, and the folders in `<compiler>` by attribute
        self._homes = [self._home]
        self._folders: dict[str, list[str]] = {name: [] for name in FOLDER_ATTRIBUTES}
        self._assets: list[_Reference] = []
        self.keyframe_sizes: list[dict[str, int]] = []
        self._files = self._bytes = 0  # number and total size of XML files
        self._sizes: dict[str, int] = {}  # bytes by path of asset

    @property
    def asset_bytes(self) -> int:
        """Total size of all assets, bytes."""
        return sum(self._sizes.values())

    def run(self) -> None:
        """Check all files; raises `SourceError` for the first problem."""
        self.scan_texts()
        # `<compiler>` may follow the assets, so that folders are known at the end
        for reference in self._assets:
            self._check_asset(reference)

    def scan_texts(self) -> None:
        """Check the XML files only; raises `SourceError` for the first problem."""
        self._scan_file(self._top_file, ())

    def _scan_file(self, path: str, including: tuple[str, ...]) -> None:
        """Check an XML file and the files that it includes.

        Args:
            path: path of the file.
            including: real paths of the files that include this file, the top file first.
        """
        real_path = os.path.realpath(path)
        if real_path in including:
            problem = f"{os.path.basename(path)!r} includes itself, through {including[-1]!r}"
            raise SourceError(self._top_file, problem)
        self._files += 1
        if problem := exceeded("files", self._files):
            raise SourceError(self._top_file, f"includes too many files: {problem}")
        included: list[_Reference] = []

        def check_element(tag: str, attributes: dict[str, str], line: int) -> None:
            """Check the attributes of an element, and store its references to files."""
            counts: dict[str, int] = {}
            if tag == "key":
                self.keyframe_sizes.append(counts)
            for name, value in attributes.items():
                if name not in FREE_TEXT and any(
                    token.lower().lstrip("+-") in NON_FINITE_WORDS for token in value.split()
                ):
                    raise SourceError(path, f"line {line}: <{tag}> has {name}={value!r:.100}, not finite")
                if tag == "compiler" and name in FOLDER_ATTRIBUTES:
                    _Reference(path, line, f"compiler {name}", value or ".").within(
                        self._asset_root, self._home
                    )
                    self._folders[name].append(value)
                if tag == "key" and name in KEY_FIELDS:
                    counts[name] = len(value.split())
                if name == "file" and tag in ("include", "model"):
                    included.append(_Reference(path, line, tag, value))
                elif name.startswith("file") and tag in ASSET_ELEMENTS:
                    self._assets.append(_Reference(path, line, tag, value))

        text = read_xml(path, SourceError, before=self._bytes)
        self._bytes += len(text)
        self.texts[real_path] = text
        # the root element of an included file can have any tag
        root_tag = None if including else self._root_tag
        scan(path, text, root_tag, check_element, SourceError)
        for reference in included:
            found = self._find_included(reference, os.path.dirname(real_path))
            self.included[real_path, reference.target] = os.path.realpath(found)
            self._scan_file(found, (*including, real_path))

    def _find_included(self, reference: _Reference, including_folder: str) -> str:
        """Return the path of an included file: relative to the top file, or to the including file."""
        root = self._include_root if reference.element == "include" else self._asset_root
        for home in (self._home, including_folder):
            path = reference.within(root, home)
            if os.path.exists(path):
                if os.path.dirname(path) not in self._homes:  # MuJoCo searches assets in all of these folders
                    self._homes.append(os.path.dirname(path))
                return os.path.join(home, reference.target)
        raise reference.refused("does not exist")

    def find_asset(self, element: str, target: str) -> str | None:
        """Return the path of an asset, or None if it does not exist; raises `SourceError` outside the root.

        Args:
            element: tag of the asset.
            target: path of the file, as the element has it.
        """
        paths = self._asset_paths(_Reference(self._top_file, 0, element, target))
        return next((path for path in paths if os.path.isfile(path)), None)

    def _asset_paths(self, reference: _Reference) -> list[str]:
        """Return paths of an asset in all folders that MuJoCo may search, with and without its folder."""
        name = "texturedir" if reference.element == "texture" else "meshdir"
        folders = [*self._folders[name], *self._folders["assetdir"]] or [""]
        # with the attribute `strippath`, MuJoCo removes the path
        stripped = replace(reference, target=os.path.basename(reference.target))
        return [
            file.within(self._asset_root, os.path.join(home, folder))
            for home in self._homes
            for folder in folders
            for file in (reference, stripped)
        ]

    def _check_asset(self, reference: _Reference) -> None:
        """Check that an asset exists, is a file, and is not too large, wherever MuJoCo may search it."""
        existing = [path for path in self._asset_paths(reference) if os.path.exists(path)]
        if not existing:
            raise reference.refused("does not exist")
        for path in existing:
            if not os.path.isfile(path):  # MuJoCo would wait for a pipe
                raise reference.refused("is not a regular file")
            self._sizes[path] = os.path.getsize(path)
            if problem := exceeded("asset_size", self._sizes[path] / MB):
                raise reference.refused(f"is too large: {problem}")
