"""What moved: as a table for the terminal, markdown, JSON and JUnit XML."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from xml.etree import ElementTree

from rich.box import SIMPLE_HEAD
from rich.table import Table
from rich.text import Text

from crosscheck.regress.compare import Checked, Comparison

MOST_LINES = 15
"""Of a scene in tables; what moved first is what to look at, and JSON and JUnit have the rest."""

HEADS = ("figure", "where", "was", "now", "moved by", "bands")


def tables(found: Sequence[Comparison]) -> Iterator[Table]:
    """A table for each scene that moved."""
    for comparison in found:
        if comparison.moved:
            yield _table(comparison)


def _table(comparison: Comparison) -> Table:
    title = Text(f"{comparison.scene}: what moved", style="bold")
    table = Table(title=title, title_justify="left", box=SIMPLE_HEAD, pad_edge=False)
    for head in HEADS[:2]:
        table.add_column(head)
    for head in HEADS[2:]:
        table.add_column(head, justify="right", no_wrap=True)
    for figure in comparison.moved[:MOST_LINES]:
        table.add_row(*(Text(cell) for cell in _cells(figure)))
    rest = len(comparison.moved) - MOST_LINES
    if rest > 0:
        table.add_row(f"and {rest} more")
    return table


def _cells(figure: Checked) -> tuple[str, ...]:
    """As `HEADS` says."""
    unit = f", {figure.unit}" if figure.unit else ""
    name = f"{figure.group}: {figure.name}{unit}"
    if figure.was is None or figure.now is None:
        return name, figure.problem, "", "", "", ""
    bands = f"{figure.bands:.3g}"
    was, now = f"{figure.was:.9g}", f"{figure.now:.9g}"
    return name, figure.where, was, now, f"{figure.now - figure.was:+.2e}", bands


def verdict(found: Sequence[Comparison]) -> str:
    """One line for all scenes."""
    moved = [comparison.scene for comparison in found if comparison.moved]
    figures = sum(len(comparison.checked) for comparison in found)
    if moved:
        return f"MOVED: {len(moved)} of {len(found)} scenes: {', '.join(moved)}"
    scenes = "1 scene" if len(found) == 1 else f"{len(found)} scenes"
    return f"QUIET: all {figures} figures of {scenes}"


def markdown(found: Sequence[Comparison], recordings: dict[str, Path]) -> str:
    """The verdicts, and the figures that moved, for example for a summary on GitHub."""
    lines = [f"## crosscheck regress: {_escaped(verdict(found))}", ""]
    for comparison in found:
        lines.append(f"- {_escaped(comparison.verdict)}")
        if comparison.scene in recordings:
            lines.append(f"  - recording: `{recordings[comparison.scene]}`")
    for comparison in found:
        if comparison.moved:
            lines += ["", f"### {_escaped(comparison.scene)}", "", "| " + " | ".join(HEADS) + " |"]
            lines.append("|---|---|---:|---:|---:|---:|")
            for figure in comparison.moved[:MOST_LINES]:
                lines.append("| " + " | ".join(_escaped(cell) for cell in _cells(figure)) + " |")
            rest = len(comparison.moved) - MOST_LINES
            if rest > 0:
                lines += ["", f"and {rest} more"]
    return "\n".join(lines) + "\n"


def _escaped(text: str) -> str:
    """Text that markdown shows as it is."""
    for character in "\\`*_[]<>|":
        text = text.replace(character, f"\\{character}")
    return text.replace("\n", " ")


def as_json(found: Sequence[Comparison], recordings: dict[str, Path]) -> str:
    """Everything that was compared."""
    scenes = [
        comparison.summary()
        | {"recording": str(path) if (path := recordings.get(comparison.scene)) else None}
        for comparison in found
    ]
    quiet = not any(comparison.moved for comparison in found)
    content = {"quiet": quiet, "verdict": verdict(found), "scenes": scenes}
    return json.dumps(content, indent=1, allow_nan=False) + "\n"


def junit(found: Sequence[Comparison]) -> str:
    """JUnit XML: a suite for each scene, a case for each figure."""
    root = ElementTree.Element("testsuites", name="crosscheck regress")
    for comparison in found:
        suite = ElementTree.SubElement(
            root,
            "testsuite",
            name=_legal(comparison.scene),
            tests=str(len(comparison.checked)),
            failures=str(len(comparison.moved)),
            errors="0",
            time=f"{comparison.wall_time:.3f}",
        )
        for figure in comparison.checked:
            case = ElementTree.SubElement(
                suite,
                "testcase",
                classname=_legal(f"{comparison.scene}.{figure.group}"),
                name=_legal(figure.name),
                time="0",
            )
            if figure.moved:
                name, where, was, now, moved, bands = _cells(figure)
                said = f"{where}: was {was}, is {now}: {moved}, {bands} bands" if was else where
                failure = ElementTree.SubElement(case, "failure", message=_legal(f"{name}: {said}"))
                failure.text = _legal(comparison.verdict)
    ElementTree.indent(root, " ")
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ElementTree.tostring(root, encoding="unicode") + "\n"


def _legal(text: str) -> str:
    """Text without the characters that XML cannot hold in any form."""
    return re.sub("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]", "?", text)
