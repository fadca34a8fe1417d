"""Differences of two model files at the lines of the files: as commands of GitHub workflows, and as SARIF.

In: a `FileComparison`. Out: texts. A GitHub workflow that prints the commands shows each difference beside
the changed line of a pull request. SARIF, the Static Analysis Results Interchange Format 2.1.0 of OASIS, is
read by GitHub code scanning, GitLab, Azure DevOps and editors.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any
from urllib.parse import quote

from crosscheck.compare.outcome import Outcome
from crosscheck.differences.alignment import Alignment
from crosscheck.differences.difference import Difference, Quantity
from crosscheck.differences.frames import joint_name
from crosscheck.differences.result import FileComparison
from crosscheck.report.diff import sentence, verdict
from crosscheck.report.diff_values import effect_text, size_text
from crosscheck.report.render import printable
from newton_euler.errors import DISTRIBUTION
from newton_euler.model.source_file import SourceLine
from newton_euler.reading.robot import Robot, RobotFile

MAX_COMMANDS = 10
"""Largest number of workflow commands; GitHub shows ten errors of a step."""

SARIF_SCHEMA = "https://docs.oasis-open.org/sarif/sarif/v2.1.0/errata01/os/schemas/sarif-schema-2.1.0.json"
"""Address of the JSON schema of SARIF 2.1.0."""

TAGS = {
    "body": ("body", "link"),
    "joint": ("joint", "freejoint"),
    "coupling": ("joint",),
    "spring": ("spatial",),
}
"""Tags of elements in MJCF and URDF files by the kind of a row; those of drives and loops are many."""

PART_TAGS = frozenset(
    {"body", "link", "joint", "freejoint", "site", "geom", "camera", "light", "spatial", "fixed"}
)
"""Tags of elements that are no drives, although a drive may have their name."""

MOTION = "motion"
"""Rule of a comparison whose motions differ although no number does."""


@dataclass(frozen=True)
class Annotation:
    """A difference at lines of files.

    Attributes:
        rule: quantity that differs, or `MOTION`.
        text: the difference in one sentence.
        lines: line of the element in the second and in the first file; files in the current folder, such as
            the checkout of a repository, come before others. Empty for models in memory.
        key: text that stays the same if other elements of the files change.
    """

    rule: str
    text: str
    lines: tuple[SourceLine, ...]
    key: str


def annotate(comparison: FileComparison) -> list[Annotation]:
    """Return the true differences of two files, the largest effect on motion first."""
    files = comparison.second, comparison.first
    partners = _partners(comparison.first.robot, comparison.second.robot, comparison.alignment)
    found = []
    for row in comparison.differences:
        kind = "body" if row.is_of_body else row.element_kind
        names = partners.get((kind, row.element), row.element), row.element
        is_there = row.second is not None, row.first is not None
        lines = [
            _line_of(file, row, name)
            for file, name, has_element in zip(files, names, is_there, strict=True)
            if file.source and (has_element or row.quantity is not Quantity.PRESENCE)
        ]
        key = f"{row.element_kind} {row.element} {row.quantity.value}"
        found.append(Annotation(row.quantity.value, _text(row), _in_checkout_first(lines), key))
    if not found and comparison.outcome is Outcome.DIFFERENT:
        lines = [SourceLine(file.source, 1) for file in files if file.source]
        found.append(Annotation(MOTION, verdict(comparison), _in_checkout_first(lines), MOTION))
    return found


def _partners(first: Robot, second: Robot, alignment: Alignment) -> dict[tuple[str, str], str]:
    """Return the names of bodies and joints in the second robot, by kind and name in the first."""
    partners = {}
    for joints in alignment.joints:
        partners["joint", joint_name(first, joints.first)] = joint_name(second, joints.second)
    for bodies in alignment.bodies:
        others = [second.bodies[index].name for index in bodies.second]
        for index in bodies.first:
            name = first.bodies[index].name
            partners["body", name] = name if name in others else others[0]
    return partners


def _line_of(file: RobotFile, row: Difference, name: str) -> SourceLine:
    """Return the line of the element of a row, that of its body for a joint without name, or else line 1.

    Args:
        file: the file.
        row: the row.
        name: name of the element in this file.
    """
    kind = "body" if row.is_of_body else row.element_kind
    for tag in TAGS.get(kind, ()):
        if (tag, name) in file.lines:
            return file.lines[tag, name]
    if kind == "joint":
        bodies = [body for body in file.robot.bodies if name in {joint.name for joint in body.joints}]
        names, tags = [body.name for body in bodies], {*TAGS["body"]}
    elif kind == "drive":
        names, tags = _names_of_drive(file.robot, name), {tag for tag, _ in file.lines} - PART_TAGS
    else:
        names, tags = [name], {tag for tag, _ in file.lines}
    found = (
        line for each in names for (tag, other), line in file.lines.items() if other == each and tag in tags
    )
    return next(found, SourceLine(file.source, 1))


def _names_of_drive(robot: Robot, name: str) -> list[str]:
    """Return the name of a drive, and those of what it acts on, by which a drive without name is found."""
    drives = [drive for drive in robot.drives if drive.name == name]
    targets = [target for drive in drives for target in (*drive.gears, *drive.other.values())]
    return [name, *(target for target in targets if isinstance(target, str))]


def _in_checkout_first(lines: list[SourceLine]) -> tuple[SourceLine, ...]:
    """Sort lines: those of files in the current folder first."""
    return tuple(sorted(lines, key=lambda line: _relative(line.path) is None))


def _relative(path: str) -> str | None:
    """Return a path relative to the current folder, with slashes; None for a file outside of the folder."""
    real = Path(os.path.realpath(path))
    folder = Path(os.path.realpath(os.curdir))
    return real.relative_to(folder).as_posix() if real.is_relative_to(folder) else None


def _text(row: Difference) -> str:
    """Describe a difference with its size and its effect on the motion."""
    size, effect = size_text(row), effect_text(row)
    text = printable(sentence(row)).replace("\n", " ")
    if size:
        text += f"; difference {size}"
    return f"{text}; change of accelerations {effect}" if effect else text


def workflow_commands(comparison: FileComparison) -> Iterator[str]:
    """Yield a command of GitHub workflows for each of the first differences.

    See "Workflow commands for GitHub Actions" in GitHub's documentation. A file outside of the current folder
    has no line in the pull request and is not named.
    """
    found = annotate(comparison)
    for annotation in found[:MAX_COMMANDS]:
        properties = {"title": "crosscheck diff"}
        path = _relative(annotation.lines[0].path) if annotation.lines else None
        if path is not None:
            properties = {"file": path, "line": str(annotation.lines[0].line), **properties}
        named = ",".join(f"{name}={_escaped_property(text)}" for name, text in properties.items())
        yield f"::error {named}::{_escaped(annotation.text)}"


def _escaped(text: str) -> str:
    """Escape a text of a workflow command."""
    return text.replace("%", "%25").replace("\r", "%0D").replace("\n", "%0A")


def _escaped_property(text: str) -> str:
    """Escape a property of a workflow command."""
    return _escaped(text).replace(":", "%3A").replace(",", "%2C")


def sarif(comparison: FileComparison) -> bytes:
    """Write the differences as a SARIF file: one result for each, one rule for each quantity."""
    found = annotate(comparison)
    rules = sorted({annotation.rule for annotation in found})
    results = [
        {
            "ruleId": annotation.rule,
            "ruleIndex": rules.index(annotation.rule),
            "level": "error",
            "message": {"text": annotation.text},
            "locations": [_location(line) for line in annotation.lines[:1]],
            "relatedLocations": [
                _location(line) | {"id": number, "message": {"text": "in the other file"}}
                for number, line in enumerate(annotation.lines[1:], start=1)
            ],
            "partialFingerprints": {"difference/v1": annotation.key},
        }
        for annotation in found
    ]
    driver = {
        "name": "crosscheck",
        "version": version(DISTRIBUTION),
        "rules": [{"id": rule, "shortDescription": {"text": f"{rule} differs"}} for rule in rules],
    }
    log = {
        "$schema": SARIF_SCHEMA,
        "version": "2.1.0",
        "runs": [{"tool": {"driver": driver}, "columnKind": "unicodeCodePoints", "results": results}],
    }
    return (json.dumps(log, indent=1) + "\n").encode()


def _location(line: SourceLine) -> dict[str, Any]:
    """Return a location of SARIF; files in the current folder have relative addresses, as GitHub needs."""
    relative = _relative(line.path)
    address = Path(os.path.realpath(line.path)).as_uri() if relative is None else quote(relative)
    return {
        "physicalLocation": {"artifactLocation": {"uri": address}, "region": {"startLine": line.line}},
    }
