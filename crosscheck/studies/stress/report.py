"""Report of a stress test: numbers of cases that each engine passes, and the cases that do not pass.

Results of cases go in. A report for the terminal, `stress.json` and `stress.md` come out. A row of a table is
a topic or a case, a column is an engine.
"""

from __future__ import annotations

import platform
from collections.abc import Sequence
from pathlib import Path

from crosscheck.report import render
from crosscheck.report.table import (
    Cell,
    Column,
    Lines,
    Part,
    Report,
    Rows,
    Table,
    number_columns,
    text_columns,
)
from crosscheck.studies.stress.cases import PROCESSES, CaseResult
from crosscheck.studies.stress.topics import TOPICS
from crosscheck.support.files import write_files
from crosscheck.support.versions import versions

STRESS_FILES = ("stress.json", "stress.md")
"""Names of the files that `write` writes."""

FIRST_COLUMN = "newton_euler"
"""Engine of the first column of tables."""

LAST_COLUMN = "all"
"""Heading of the last column of tables, for cases that do not depend on the engine."""


def report(rows: Sequence[CaseResult], full: bool, wall_time: float) -> Report:
    """Make the report: numbers of passed cases by engine, and the cases that do not pass, by topic.

    Args:
        rows: results of all cases.
        full: True if all cases ran, False for the short form.
        wall_time: duration of the test, s.
    """
    form = "full" if full else "ci"
    made_with = ", ".join(f"{name} {number}" for name, number in versions().items())
    preface = (
        f"Made by `crosscheck stress --{form}` in {wall_time / 60.0:.1f} minutes on {PROCESSES} processes "
        f"({platform.machine()}; {made_with}). Each case measures one value of one engine at one setting. "
        "An engine survives within the bound, degrades within a wider bound, and fails beyond both. "
        "An engine refuses if it raises an error with a reason: correct for a case without an answer, "
        "a shortcoming otherwise. All cases, with values and reasons, are in stress.json."
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


def _bound(row: CaseResult) -> str:
    """Format the bound of a case with its reason."""
    bound = row.case.bound
    what = f"{bound.quantity} {bound}" if bound.has_answer else "cases without an answer"
    return f"{what}: {bound.reason}"


def _cases(title: str, rows: Sequence[CaseResult], engines: Sequence[str]) -> Table:
    """Tabulate cases: a row for each case that does not pass in every engine, and one row for the others."""
    heads = [*text_columns("case"), *number_columns(*engines), Column("not passed", below=True)]
    cells: Rows = []
    lost = dict.fromkeys(row.case.name for row in rows if not row.passes)
    for name in lost:
        of_case = [row for row in rows if row.case.name == name]
        failing = "; ".join(_failure_text(row) for row in of_case if not row.passes)
        cells.append([name, *(_passes(of_case, engine) for engine in engines), failing])
    if others := [row for row in rows if row.case.name not in lost]:
        count = len({row.case.name for row in others})
        cells.append([f"{count} others", *(_passes(others, engine) for engine in engines), ""])
    return Table(title, heads, cells, folded=True)


def _failure_text(row: CaseResult) -> str:
    """Format engine, setting, verdict and value of a case that does not pass."""
    setting, value = row.case.setting, "" if row.value is None else f" {row.value:.1e}"
    return f"{setting.engine}, {setting}: {row.verdict}{value}"


def _passes(rows: Sequence[CaseResult], engine: str) -> str:
    """Format the number of cases of an engine that pass; empty if the engine has no case."""
    passes = [row.passes for row in rows if row.case.setting.engine == engine]
    return f"{sum(passes)} of {len(passes)}" if passes else ""


def _engines(rows: Sequence[CaseResult]) -> list[str]:
    """List the engines of the cases in the order of columns: newton_euler, others by name, "all"."""
    found = {row.case.setting.engine for row in rows}
    return sorted(found, key=lambda name: (name == LAST_COLUMN, name != FIRST_COLUMN, name))


def counts(rows: Sequence[CaseResult]) -> dict[str, dict[str, str]]:
    """Return texts such as "3 of 4" (number of passed cases) by title of the topic and by engine."""
    table = {}
    for letter, (topic, _) in TOPICS.items():
        of_topic = [row for row in rows if row.case.topic == letter]
        if of_topic:
            table[f"({letter}) {topic}"] = {engine: _passes(of_topic, engine) for engine in _engines(rows)}
    return table


def _summary(rows: Sequence[CaseResult]) -> Table:
    """Tabulate the numbers of passed cases: a row for each topic, a column for each engine."""
    found = counts(rows)
    engines = [Column(engine, numeric=True) for engine in next(iter(found.values()), {})]
    lines: Rows = [[topic, *cells.values()] for topic, cells in found.items()]
    return Table("passed cases", [Column(""), *engines], lines)


def write(rows: Sequence[CaseResult], found: Report, full: bool, folder: Path) -> list[Path]:
    """Write stress.json and stress.md into a folder; return their paths.

    Args:
        rows: results of all cases.
        found: the report of these results.
        full: as for `report`.
        folder: folder of the files.

    Raises:
        CrosscheckError: naming the path that cannot be written.
    """
    paths = [folder / name for name in STRESS_FILES]
    data = {
        "form": "full" if full else "ci",
        "passed": counts(rows),
        "rows": [row.entry for row in rows],
    }
    contents = render.as_json(data, found), render.markdown(found, folded=True).encode()
    write_files(dict(zip(paths, contents, strict=True)))
    return paths
