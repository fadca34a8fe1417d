"""Find the equalities of an MJCF file whose softness the top-level `<default>` does not set.

An equality takes `solref` and `solimp` from its own attributes, else from the default class that it names,
else from the top-level `<default>`. Settings that `crosscheck tune` proposes as a top-level `<default>` have
no effect on equalities of the first two kinds; a comment in the proposal names these equalities.
"""

from __future__ import annotations

import os

from newton_euler.model.source_file import SourceError, read_xml, scan

EQUALITY_TAGS = ("connect", "weld")
"""Tags that only equalities have."""

EQUALITY_ATTRIBUTES = {"joint": "joint1", "tendon": "tendon1", "flex": "flex"}
"""Other tags of equalities, and the attribute by which an equality differs from elements of the same tag."""

TOP_CLASS = "main"
"""MuJoCo's name of the top-level default class."""


def equalities_with_own_softness(path: str) -> tuple[str, ...]:
    """List the equalities that set their own softness or name a default class.

    Args:
        path: path of a file that has been compiled; included files are next to this file, or next to the file
            that includes them.

    Returns:
        Tag and name of each equality, such as "connect 'loop'"; without a name, tag and number among all
        equalities in the order of reading, such as "weld 2".
    """
    found: list[str] = []
    count = 0
    pending_files = [path]

    def check_element(tag: str, attributes: dict[str, str], _line: int) -> None:
        """Count an equality and test its attributes; remember the file of an <include>."""
        nonlocal count
        if tag == "include":
            homes = [os.path.dirname(path), os.path.dirname(pending_files[0])]
            files = [os.path.join(home, attributes["file"]) for home in homes]
            pending_files.extend([file for file in files if os.path.exists(file)][:1])
        if tag not in EQUALITY_TAGS and EQUALITY_ATTRIBUTES.get(tag) not in attributes:
            return
        count += 1
        has_class = attributes.get("class", TOP_CLASS) != TOP_CLASS
        if has_class or "solref" in attributes or "solimp" in attributes:
            name = attributes.get("name")
            found.append(f"{tag} {name!r}" if name else f"{tag} {count}")

    while pending_files:
        file = pending_files[0]
        text = read_xml(file, SourceError)
        any_root = None  # included files have any root element
        scan(file, text, any_root, check_element, SourceError)
        pending_files.pop(0)
    return tuple(found)
