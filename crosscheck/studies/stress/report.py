"""Report of a stress test: numbers of cases that each engine passes, and the cases that do not pass.

A case measures one value of one engine, such as MuJoCo, at one setting; a bound judges the
value. A case passes if the value is within the bound; a case without an answer passes if the engine raises an
error. A topic is a group of cases with a letter as its name. Results of cases go in. A report for the
terminal, `stress.json` and `stress.md` come out. A row of the first table is a topic, and a column is an
engine. Each topic has tables of its bounds, of its settings, and of the cases that do not pass.
"""

from __future__ import annotations

import platform
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from crosscheck.engines.engine import Engine
from crosscheck.engines.registry import SOLVER
from crosscheck.engines.versions import versions
from crosscheck.report import render
from crosscheck.report.chart import Measure, linear_chart
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

STRESS_FILES = ("stress.json", "stress.md")
"""Names of the files that `write` writes."""

FIRST_COLUMN = SOLVER.name
"""Engine of the first column of tables."""

LAST_COLUMN = "all"
"""Name of the engine, and heading of the last column, of cases that do not depend on the engine."""


def report(
    results: Sequence[CaseResult],
    letters: Sequence[str],
    full: bool,
    wall_time: float,
    engines: Sequence[Engine],
    left_out: Mapping[str, str],
) -> Report:
    """Make the report: numbers of passed cases by engine, and the cases that do not pass, by topic.

    Args:
        results: results of all cases.
        letters: letters of the topics.
        full: True if all cases ran, False for the short form.
        wall_time: duration of the test, s.
        engines: the engines.
        left_out: reasons by name of the engines that cannot be used.
    """
    form = "full" if full else "ci"
    made_with = ", ".join(f"{name} {number}" for name, number in versions(engines).items())
    preface = (
        f"Made by `crosscheck stress --{form}` in {wall_time / 60.0:.1f} minutes on {PROCESSES} processes "
        f"({platform.machine()}; {made_with}). Each case measures one value of one engine at one setting. "
        "An engine survives within the bound, degrades within a wider bound, and fails beyond both. "
        "An engine refuses if it raises an error with a reason: correct for a case without an answer, "
        "a shortcoming otherwise. All cases, with values and reasons, are in stress.json."
    )
    parts: list[Part] = [_summary(results), *_not_expressed(results)]
    without_cases = [
        f"{engine.name} has no cases in topic{'s' * (len(missing) > 1)} {', '.join(missing)}"
        for engine in engines
        if (missing := _topics_without_cases(results, letters, engine))
    ]
    if left_out or without_cases:
        parts.append(Lines("left out", [*left_out.values(), *without_cases]))
    parts.append(Lines("about", [preface], folded=True))
    for letter, topic in TOPICS.items():
        of_topic = [result for result in results if result.case.topic == letter]
        if of_topic:
            parts += [_bounds(letter, of_topic), _settings(f"({letter}) {topic.title}", of_topic)]
            parts += _not_passed(letter, of_topic)
    passes, expressed = (sum(getattr(each, name) for each in results) for name in ("passes", "expressed"))
    verdict = f"{passes} of {expressed} cases pass"
    if other := len(results) - expressed:
        verdict += f"; {other} not expressed"
    measures = []
    for name in _engines(results):
        cases = [each for each in results if each.case.setting.engine == name and each.expressed]
        count = sum(each.passes for each in cases)
        if cases:
            measures.append(Measure(name, 100.0 * count / len(cases), f"{count} of {len(cases)}"))
    return Report(
        "Stress",
        verdict,
        judged=Cell(""),
        parts=parts,
        wall_time=wall_time,
        charts=linear_chart(
            "Passed cases", "Cases that each engine passes; the axis ends at all of them", measures, end=100.0
        ),
        next_steps=[
            "Look for the topic of your model, such as mass ratios, before you choose an engine.",
            "The topics below list the cases that do not pass; `stress.json` has the reasons.",
        ],
    )


def _topics_without_cases(results: Sequence[CaseResult], letters: Sequence[str], engine: Engine) -> list[str]:
    """Return the letters of topics in which an engine has no cases, as it has no settings for them."""
    present = {result.case.topic for result in results if result.case.setting.engine == engine.name}
    return [letter for letter in letters if letter not in present]


def _not_expressed(results: Sequence[CaseResult]) -> Iterator[Table]:
    """Tabulate the cases that engines cannot express: a row for each engine and reason."""
    others = [result for result in results if not result.expressed]
    counts_of_reasons = Counter((result.case.setting.engine, result.reason) for result in others)
    if counts_of_reasons:
        rows: Rows = [[engine, str(n), reason] for (engine, reason), n in counts_of_reasons.items()]
        heads = [*text_columns("engine"), *number_columns("cases"), *text_columns("reason")]
        yield Table("not expressed", heads, rows)


def _bounds(letter: str, results: Sequence[CaseResult]) -> Table:
    """Tabulate the bounds of a topic: a row for each quantity and reason."""
    bounds = {result.case.bound for result in results}
    limits: dict[tuple[str, str], list[str]] = {}
    for bound in sorted(bounds, key=lambda bound: (not bound.has_answer, bound.survives)):
        unit = f", {bound.unit}" if bound.unit else ""
        quantity = f"{bound.quantity}{unit}" if bound.has_answer else "cases without an answer"
        limits.setdefault((quantity, bound.reason), []).append(str(bound) if bound.has_answer else "an error")
    rows: Rows = []
    for (quantity, reason), texts in limits.items():
        passes = texts[0] if texts[0] == texts[-1] else f"{texts[0]} to {texts[-1].split()[-1]}"
        rows.append([quantity, passes, reason])
    return Table(f"bounds of ({letter})", text_columns("quantity", "passes", "reason"), rows, folded=True)


def _settings(title: str, results: Sequence[CaseResult]) -> Table:
    """Tabulate the numbers of passed cases: a row for each setting of an engine."""
    settings: dict[tuple[str, str], list[CaseResult]] = {}
    for result in results:
        if result.expressed:
            setting = result.case.setting
            settings.setdefault((setting.engine, str(setting)), []).append(result)
    rows: Rows = [
        [engine, setting, _passes(settings[engine, setting], engine)]
        for engine in _engines(results)
        for name, setting in settings
        if name == engine
    ]
    return Table(title, [*text_columns("engine", "setting"), *number_columns("passed")], rows, folded=True)


def _not_passed(letter: str, results: Sequence[CaseResult]) -> Iterator[Table]:
    """Tabulate the cases that do not pass, one per row, if there are any."""
    rows: Rows = []
    names = list(dict.fromkeys(result.case.name for result in results))
    for result in sorted(results, key=lambda result: names.index(result.case.name)):
        if result.expressed and not result.passes:
            setting, value = result.case.setting, "" if result.value is None else f"{result.value:.1e}"
            rows.append([result.case.name, setting.engine, str(setting), result.verdict, value])
    if rows:
        heads = [*text_columns("case", "engine", "setting", "result"), *number_columns("value")]
        yield Table(f"not passed in ({letter})", heads, rows, folded=True)


def _passes(results: Sequence[CaseResult], engine: str) -> str:
    """Format the number of cases of an engine that pass; empty if the engine expresses no case."""
    of_engine = [result for result in results if result.case.setting.engine == engine]
    passes = [result.passes for result in of_engine if result.expressed]
    return f"{sum(passes)} of {len(passes)}" if passes else ""


def _engines(results: Sequence[CaseResult]) -> list[str]:
    """List the engines of the cases in the order of columns: newton_euler, others by name, "all"."""
    found = {result.case.setting.engine for result in results}
    return sorted(found, key=lambda name: (name == LAST_COLUMN, name != FIRST_COLUMN, name))


def counts(results: Sequence[CaseResult]) -> dict[str, dict[str, str]]:
    """Return texts such as "3 of 4" (number of passed cases) by title of the topic and by engine."""
    table = {}
    for letter, topic in TOPICS.items():
        of_topic = [result for result in results if result.case.topic == letter]
        if of_topic:
            title = f"({letter}) {topic.title}"
            table[title] = {engine: _passes(of_topic, engine) for engine in _engines(results)}
    return table


def _summary(results: Sequence[CaseResult]) -> Table:
    """Tabulate the numbers of passed cases: a row for each topic, a column for each engine."""
    counts_of_topics = counts(results)
    engines = [Column(engine, numeric=True) for engine in next(iter(counts_of_topics.values()), {})]
    rows: Rows = [[topic, *cells.values()] for topic, cells in counts_of_topics.items()]
    return Table("passed cases", [Column(""), *engines], rows)


def write(results: Sequence[CaseResult], found: Report, full: bool, folder: Path) -> list[Path]:
    """Write stress.json and stress.md into a folder; return their paths.

    Args:
        results: results of all cases.
        found: the report of these results.
        full: as for `report`.
        folder: folder of the files.

    Raises:
        CrosscheckError: naming the path that cannot be written.
    """
    paths = [folder / name for name in STRESS_FILES]
    data = {
        "form": "full" if full else "ci",
        "passed": counts(results),
        "rows": [result.entry for result in results],
    }
    contents = render.as_json(data, found), render.markdown(found, folded=True).encode()
    write_files(dict(zip(paths, contents, strict=True)))
    return paths
