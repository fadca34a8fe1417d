"""The report of a stress run: cases, and how many each engine passes."""

from __future__ import annotations

import platform
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from importlib.metadata import version
from pathlib import Path

from crosscheck.files import check_writable, write_files
from crosscheck.report import render
from crosscheck.report.table import (
    Cell,
    Column,
    Lines,
    Part,
    Report,
    Rows,
    Table,
    Verdict,
    entries,
    figures,
    texts,
)
from crosscheck.studies.stress.cases import PROCESSES, Row
from crosscheck.studies.stress.topics import TOPICS

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
    """Cases that each engine passes, and all cases by topic."""
    form = "full" if full else "CI"
    versions = {name: version(name) for name in PACKAGES}
    named = ", ".join(f"{name} {number}" for name, number in versions.items())
    preface = (
        f"Made by `crosscheck stress --{'full' if full else 'ci'}` in {wall_time / 60.0:.1f} minutes on "
        f"{PROCESSES} processes ({platform.machine()}; {named}). The {form} form has {len(rows)} cases. "
        "Each case measures one figure of one engine at one setting: within its bound the engine survives, "
        "up to a second and laxer one it degrades, beyond that it fails. It refuses when it stops with "
        "a stated reason, which is right where there is no answer and a shortcoming where there is one. "
        "What fails is listed like what passes."
    )
    parts: list[Part] = [_summary(rows), Lines("about", [preface], folded=True)]
    for letter, (topic, _) in TOPICS.items():
        of_topic = [row for row in rows if row.topic == letter]
        if of_topic:
            parts.append(Lines(f"bounds of ({letter})", list(_bounds(of_topic)), folded=True))
            parts.append(_cases(f"({letter}) {topic}", of_topic))
    parts.append(entries("versions", versions, folded=True))
    passes = sum(row.passes for row in rows)
    return Report("Stress", f"{passes} of {len(rows)} cases pass", Cell(""), parts, wall_time)


def _cases(title: str, rows: Sequence[Row]) -> Table:
    """A row per case."""
    heads = [
        *texts("case", "engine", "setting", "measured"),
        *figures("figure", "bound"),
        Column("verdict"),
        Column("", brief=True),
    ]
    return Table(
        title,
        heads,
        [
            [
                row.name,
                row.engine,
                row.setting,
                f"{row.quantity}, {row.unit}" if row.unit else row.quantity,
                _figure(row),
                row.bound,
                Cell(row.verdict, "holds" if row.passes else JUDGED[row.verdict]),
                row.reason,
            ]
            for row in rows
        ],
    )


def _figure(row: Row) -> str:
    return "" if row.figure is None else f"{row.figure:.1e}"


def counts(rows: Sequence[Row]) -> dict[str, dict[str, str]]:
    """By topic and engine, how many of the cases pass: "3 of 4"."""
    engines = sorted({row.engine for row in rows}, key=lambda name: (name == ALL, name != OWN, name))
    table = {}
    for letter, (topic, _) in TOPICS.items():
        cells = {}
        for engine in engines:
            passes = [row.passes for row in rows if (row.topic, row.engine) == (letter, engine)]
            cells[engine] = f"{sum(passes)} of {len(passes)}" if passes else ""
        if any(cells.values()):
            table[f"({letter}) {topic}"] = cells
    return table


def _summary(rows: Sequence[Row]) -> Table:
    found = counts(rows)
    engines = [Column(engine, numeric=True) for engine in next(iter(found.values()), {})]
    lines: Rows = [[topic, *cells.values()] for topic, cells in found.items()]
    return Table("cases that survive, and refusals where they are right", [Column(""), *engines], lines)


def _bounds(rows: Sequence[Row]) -> Iterator[str]:
    """The bounds of a topic with their reasons."""
    reasons = dict.fromkeys((row.quantity, row.bound, row.bound_reason) for row in rows)
    for quantity, bound, reason in reasons:
        what = "cases without an answer" if bound == "refusal" else f"{quantity} {bound}"
        yield f"{what}: {reason}"


def check_folder(folder: Path) -> None:
    """Raise `CrosscheckError` before a run whose report could not be written after it."""
    check_writable(folder / "stress.json", folder / "stress.md")


def write(rows: Sequence[Row], found: Report, full: bool, folder: Path) -> list[Path]:
    """Write stress.json and stress.md into a folder.

    Raises:
        CrosscheckError: naming the path that cannot be written.
    """
    results = {
        "form": "full" if full else "ci",
        "passed": counts(rows),
        "rows": [asdict(row) for row in rows],
    }
    files = {
        folder / "stress.json": render.as_json(results, found),
        folder / "stress.md": render.markdown(found, folded=True).encode(),
    }
    write_files(files)
    return list(files)
