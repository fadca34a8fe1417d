"""The report of a stress run: how many cases each engine passes, and which do not."""

from __future__ import annotations

import platform
from collections.abc import Sequence
from pathlib import Path

from crosscheck.report import render
from crosscheck.report.table import Cell, Column, Lines, Part, Report, Rows, Table, figures, texts
from crosscheck.studies.stress.cases import PROCESSES, Row
from crosscheck.studies.stress.topics import TOPICS
from crosscheck.support.files import write_files
from crosscheck.support.versions import versions

FILES = ("stress.json", "stress.md")

OWN, ALL = "newton_euler", "all"
"""The first column, and the last: what all engines share."""


def report(rows: Sequence[Row], full: bool, wall_time: float) -> Report:
    """Cases that each engine passes, and on demand by topic what does not pass."""
    form = "full" if full else "ci"
    made_with = ", ".join(f"{name} {number}" for name, number in versions().items())
    preface = (
        f"Made by `crosscheck stress --{form}` in {wall_time / 60.0:.1f} minutes on {PROCESSES} processes "
        f"({platform.machine()}; {made_with}). Each case measures one figure of one engine at one setting: "
        "within its bound the engine survives, up to a laxer one it degrades, beyond that it fails. "
        "It refuses when it stops with a stated reason, which is right where there is no answer and a "
        "shortcoming where there is one. All cases, with figures and reasons, are in stress.json."
    )
    parts: list[Part] = [_summary(rows), Lines("about", [preface], folded=True)]
    for letter, (topic, _) in TOPICS.items():
        of_topic = [row for row in rows if row.case.topic == letter]
        if of_topic:
            bounds = dict.fromkeys(map(_bound, of_topic))
            parts.append(Lines(f"bounds of ({letter})", list(bounds), folded=True))
            parts.append(_cases(f"({letter}) {topic}", of_topic, _engines(of_topic)))
    passes = sum(row.passes for row in rows)
    return Report("Stress", f"{passes} of {len(rows)} cases pass", Cell(""), parts, wall_time)


def _bound(row: Row) -> str:
    """A bound with its reason."""
    bound = row.case.bound
    what = f"{bound.quantity} {bound}" if bound.has_answer else "cases without an answer"
    return f"{what}: {bound.reason}"


def _cases(title: str, rows: Sequence[Row], engines: Sequence[str]) -> Table:
    """Make a row per case of which something does not pass, and one row of all others."""
    heads = [*texts("case"), *figures(*engines), Column("what does not pass", below=True)]
    cells: Rows = []
    lost = dict.fromkeys(row.case.name for row in rows if not row.passes)
    for name in lost:
        of_case = [row for row in rows if row.case.name == name]
        failing = "; ".join(_worded(row) for row in of_case if not row.passes)
        cells.append([name, *(_passes(of_case, engine) for engine in engines), failing])
    if others := [row for row in rows if row.case.name not in lost]:
        count = len({row.case.name for row in others})
        cells.append([f"{count} others", *(_passes(others, engine) for engine in engines), ""])
    return Table(title, heads, cells, folded=True)


def _worded(row: Row) -> str:
    """Word a case that does not pass: engine, setting, verdict and figure."""
    setting, figure = row.case.setting, "" if row.figure is None else f" {row.figure:.1e}"
    return f"{setting.engine}, {setting}: {row.verdict}{figure}"


def _passes(rows: Sequence[Row], engine: str) -> str:
    """Word how many cases of an engine pass; nothing if there are none."""
    passes = [row.passes for row in rows if row.case.setting.engine == engine]
    return f"{sum(passes)} of {len(passes)}" if passes else ""


def _engines(rows: Sequence[Row]) -> list[str]:
    found = {row.case.setting.engine for row in rows}
    return sorted(found, key=lambda name: (name == ALL, name != OWN, name))


def counts(rows: Sequence[Row]) -> dict[str, dict[str, str]]:
    """By topic and engine, how many of the cases pass: "3 of 4"."""
    table = {}
    for letter, (topic, _) in TOPICS.items():
        of_topic = [row for row in rows if row.case.topic == letter]
        if of_topic:
            table[f"({letter}) {topic}"] = {engine: _passes(of_topic, engine) for engine in _engines(rows)}
    return table


def _summary(rows: Sequence[Row]) -> Table:
    found = counts(rows)
    engines = [Column(engine, numeric=True) for engine in next(iter(found.values()), {})]
    lines: Rows = [[topic, *cells.values()] for topic, cells in found.items()]
    return Table("cases that survive, and refusals where they are right", [Column(""), *engines], lines)


def write(rows: Sequence[Row], found: Report, full: bool, folder: Path) -> list[Path]:
    """Write stress.json and stress.md into a folder.

    Raises:
        CrosscheckError: naming the path that cannot be written.
    """
    paths = [folder / name for name in FILES]
    data = {
        "form": "full" if full else "ci",
        "passed": counts(rows),
        "rows": [row.entry for row in rows],
    }
    contents = render.as_json(data, found), render.markdown(found, folded=True).encode()
    write_files(dict(zip(paths, contents, strict=True)))
    return paths
