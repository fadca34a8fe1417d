"""The report of a stress run: how many cases each engine passes, and all cases."""

from __future__ import annotations

import platform
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path

from crosscheck.files import write_files
from crosscheck.report import render
from crosscheck.report.table import Cell, Column, Lines, Part, Report, Rows, Table, Verdict, figures, texts
from crosscheck.studies.stress.cases import PROCESSES, Row
from crosscheck.studies.stress.topics import TOPICS

FILES = ("stress.json", "stress.md")

JUDGED: dict[str, Verdict] = {
    "survives": "holds",
    "degrades": "doubtful",
    "fails": "fails",
    "refuses": "fails",
}
"""Of a case whose verdict is not what one would want."""

OWN, ALL = "newton_euler", "all"
"""The first column, and the last: what all engines share."""

PACKAGES = ("numpy", "scipy", "mujoco", "pin")


def report(rows: Sequence[Row], full: bool, wall_time: float) -> Report:
    """Cases that each engine passes, and on demand all cases by topic."""
    form = "full" if full else "ci"
    versions = ", ".join(f"{name} {version(name)}" for name in PACKAGES)
    preface = (
        f"Made by `crosscheck stress --{form}` in {wall_time / 60.0:.1f} minutes on {PROCESSES} processes "
        f"({platform.machine()}; {versions}). Each case measures one figure of one engine at one setting: "
        "within its bound the engine survives, up to a laxer one it degrades, beyond that it fails. "
        "It refuses when it stops with a stated reason, which is right where there is no answer and a "
        "shortcoming where there is one. What fails is listed like what passes."
    )
    parts: list[Part] = [_summary(rows), Lines("about", [preface], folded=True)]
    for letter, (topic, _) in TOPICS.items():
        of_topic = [row for row in rows if row.case.topic == letter]
        if of_topic:
            bounds = dict.fromkeys(map(_bound, of_topic))
            parts.append(Lines(f"bounds of ({letter})", list(bounds), folded=True))
            parts.append(_cases(f"({letter}) {topic}", of_topic))
    passes = sum(row.passes for row in rows)
    return Report("Stress", f"{passes} of {len(rows)} cases pass", Cell(""), parts, wall_time)


def _bound(row: Row) -> str:
    """A bound with its reason."""
    bound = row.case.bound
    what = f"{bound.quantity} {bound}" if bound.has_answer else "cases without an answer"
    return f"{what}: {bound.reason}"


def _cases(title: str, rows: Sequence[Row]) -> Table:
    """A row per case."""
    heads = [
        *texts("case", "engine", "setting", "measured"),
        *figures("figure", "bound"),
        Column("verdict"),
        Column("", brief=True),
    ]
    cells: Rows = [
        [
            row.case.name,
            row.case.setting.engine,
            str(row.case.setting),
            ", ".join(filter(None, (row.case.bound.quantity, row.case.bound.unit))),
            "" if row.figure is None else f"{row.figure:.1e}",
            str(row.case.bound),
            Cell(row.verdict, "holds" if row.passes else JUDGED[row.verdict]),
            row.reason,
        ]
        for row in rows
    ]
    return Table(title, heads, cells, folded=True)


def counts(rows: Sequence[Row]) -> dict[str, dict[str, str]]:
    """By topic and engine, how many of the cases pass: "3 of 4"."""
    found = {row.case.setting.engine for row in rows}
    engines = sorted(found, key=lambda name: (name == ALL, name != OWN, name))
    table = {}
    for letter, (topic, _) in TOPICS.items():
        of_topic = [row for row in rows if row.case.topic == letter]
        cells = {}
        for engine in engines:
            passes = [row.passes for row in of_topic if row.case.setting.engine == engine]
            cells[engine] = f"{sum(passes)} of {len(passes)}" if passes else ""
        if of_topic:
            table[f"({letter}) {topic}"] = cells
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
