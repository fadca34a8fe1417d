"""Equalities of an MJCF file whose softness `<default>` does not set.

MuJoCo gives an equality the `solref` and `solimp` of its own attributes, then of the default class that it
names, then of the top-level `<default>`. A change of the top-level `<default>` reaches the last ones only.
"""

from __future__ import annotations

import os

from newton_euler.model.source_file import SourceError, read_text, scan

EQUALITY_TAGS = ("connect", "weld")
"""Elements that are equalities wherever they are."""

COUPLED = {"joint": "joint1", "tendon": "tendon1", "flex": "flex"}
"""Elements that are equalities if they have an attribute, and this attribute."""

TOP_CLASS = "main"
"""MuJoCo's name of the top-level default class."""


def equalities_with_own_softness(path: str) -> tuple[str, ...]:
    """List the equalities of a file that has been compiled, such as "connect 'loop'" or "weld 2".

    Args:
        path: path of the file; included files are next to this file, or next to the file that includes them.
    """
    found: list[str] = []
    count = 0
    waiting = [path]

    def look(tag: str, attributes: dict[str, str], _: int) -> None:
        nonlocal count
        if tag == "include":
            homes = [os.path.dirname(path), os.path.dirname(waiting[0])]
            files = [os.path.join(home, attributes["file"]) for home in homes]
            waiting.extend([file for file in files if os.path.exists(file)][:1])
        if tag not in EQUALITY_TAGS and COUPLED.get(tag) not in attributes:
            return
        count += 1
        has_class = attributes.get("class", TOP_CLASS) != TOP_CLASS
        if has_class or "solref" in attributes or "solimp" in attributes:
            name = attributes.get("name")
            found.append(f"{tag} {name!r}" if name else f"{tag} {count}")

    while waiting:
        scan(waiting[0], read_text(waiting[0], "file_size", SourceError), None, look, SourceError)
        waiting.pop(0)
    return tuple(found)
