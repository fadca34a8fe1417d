"""Report of `crosscheck regress`: verdict and tables for the terminal and Markdown, JSON and JUnit XML.

The input is a list of `Comparison`, one for each scene that was compared with its baseline (stored results).
A check of a quantity against the baseline fails if the quantity "moved". If nothing moved, the outcome is
"quiet". It is "quiet on a reduced model" if elements of the model file acted that are not simulated, and
"quiet of some engines" if an engine of the baseline is not installed. Costs and errors that fell are
improvements: "cheaper" or "more accurate". The level of a check is the name of a group of quantities.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import groupby
from pathlib import Path

from crosscheck.compare.activity import what_acted
from crosscheck.compare.outcome import Outcome, Verdict
from crosscheck.regress.baseline import OWN_RUN_GROUP
from crosscheck.regress.compare import MODEL_FILE, BaselineCheck, Comparison
from crosscheck.report import render
from crosscheck.report.chart import BarChart, Measure, log_chart
from crosscheck.report.table import Cell, Lines, Part, Report, Rows, Table, number_columns, text_columns

MAX_SHOWN_CHECKS = 12
"""Number of checks of a scene in its table of changes; the table of all checks has the others, too."""

GROUP_TITLES = {
    "relative": "joint coordinates",
    "cartesian": "body coordinates",
    OWN_RUN_GROUP: "your settings",
}
"""Names in tables of groups whose name in baseline files is not plain: coordinates of newton_euler's
equations, and the run with the settings of the model file."""

CHECK_COLUMNS = [*text_columns("quantity", "where"), *number_columns("was", "change", "change / tolerance")]
"""Columns of the tables of checks."""


def tables(comparisons: Sequence[Comparison]) -> Iterator[Table]:
    """Make tables of failed checks, lower costs and smaller errors for each scene that has any.

    Each table has at most `MAX_SHOWN_CHECKS` checks, and a line with the number of the others.
    """
    for comparison in comparisons:
        for title, checks in (
            ("what moved", comparison.moved),
            ("what is cheaper", comparison.cheaper),
            ("what is more accurate", comparison.more_accurate),
        ):
            if checks:
                rows = list(_short_rows(checks))
                hidden = len(rows) - MAX_SHOWN_CHECKS
                # a text instead of a list of cells is a line across all columns
                more = [f"and {hidden} more"] if hidden > 0 else []
                yield Table(f"{comparison.scene}: {title}", CHECK_COLUMNS, [*rows[:MAX_SHOWN_CHECKS], *more])


def quiet_versions(comparisons: Iterable[Comparison]) -> str:
    """Name the package versions that changed although nothing moved; "" if none changed.

    The line of a scene that moved has the versions of its own baseline.
    """
    stored: dict[tuple[str, str], set[str]] = {}
    for comparison in comparisons:
        if not comparison.moved:
            for name, (was, now) in comparison.changed_versions.items():
                stored.setdefault((name, now), set()).add(was)
    changed = [
        f"{name} {'several' if len(was) > 1 else next(iter(was))} -> {now}"
        for (name, now), was in stored.items()
    ]
    return f"versions that changed since the baseline: {', '.join(changed)}" if changed else ""


def _short_rows(checks: Sequence[BaselineCheck]) -> Iterator[list[str | Cell]]:
    """Yield a row for each check, and one row for consecutive checks of a group with the same problem."""
    for (level, problem), group in groupby(checks, key=lambda check: (check.level, check.problem)):
        alike = list(group)
        if problem and len(alike) > 1 and level != MODEL_FILE:
            yield [f"{_title(level)}: {len(alike)} quantities", Cell(problem, "fails"), "", "", ""]
        else:
            yield from (_row(check, f"{_title(level)}: ") for check in alike)


def _title(level: str) -> str:
    """Return the name of a group of quantities in tables: an engine, or words for what the group covers."""
    return GROUP_TITLES.get(level, level)


def _row(check: BaselineCheck, prefix: str = "") -> list[str | Cell]:
    """Format a check as a row of `CHECK_COLUMNS`, with a prefix before the name of the quantity.

    Pages show the origin of the tolerance (`check.reason`) when the mouse points at the last cell.
    """
    unit = f", {check.unit}" if check.unit else ""
    name = f"{prefix}{check.quantity}{unit}"
    better = "cheaper" if check.cheaper else "more accurate" if check.more_accurate else ""
    verdict: Verdict = "fails" if check.moved else "improved" if better else "holds"  # selects a color
    if check.was is None or check.now is None:  # an element of a file, or not comparable
        return [name, Cell(check.problem or "the same", verdict), "", "", ""]
    change = f"{check.now - check.was:+.2e}"
    ratio = Cell(f"{check.tolerance_ratio:.3g} {better}".rstrip(), verdict, about=check.reason)
    where = f"coordinate {check.where}" if check.where.isdecimal() else check.where
    return [name, where, f"{check.was:.9g}", change, ratio]


def outcome(comparisons: Sequence[Comparison]) -> Outcome:
    """Return the worst outcome of all scenes."""
    outcomes = {comparison.outcome for comparison in comparisons}
    for worst in (Outcome.MOVED, Outcome.QUIET_OF_SOME_ENGINES, Outcome.QUIET_ON_A_REDUCED_MODEL):
        if worst in outcomes:
            return worst
    return Outcome.QUIET


def verdict(comparisons: Sequence[Comparison], left_out: Mapping[str, str]) -> str:
    """Format the result of all scenes in one line.

    Args:
        comparisons: results of the scenes that were compared.
        left_out: reasons by name of the scenes that were not compared.
    """
    moved = [comparison.scene for comparison in comparisons if comparison.moved]
    notes = ""
    cheaper = [comparison.scene for comparison in comparisons if comparison.cheaper]
    more_accurate = [comparison.scene for comparison in comparisons if comparison.more_accurate]
    for word, names in (("cheaper", cheaper), ("more accurate", more_accurate)):
        notes += f"; {word}: {', '.join(names)}" if names else ""
    notes += f"; left out: {', '.join(left_out)}" if left_out else ""
    engines = dict.fromkeys(name for comparison in comparisons for name in comparison.not_measured)
    notes += f"; not measured: {', '.join(engines)}" if engines else ""
    if moved:
        return f"{Outcome.MOVED}: {len(moved)} of {len(comparisons)} scenes: {', '.join(moved)}{notes}"
    count = sum(len(comparison.checks) for comparison in comparisons)
    scenes = "1 scene" if len(comparisons) == 1 else f"{len(comparisons)} scenes"
    return f"{outcome(comparisons)}: all {count} checks of {scenes}{notes}"


def report(
    comparisons: Sequence[Comparison],
    recordings: Mapping[str, Path],
    left_out: Mapping[str, str],
    allow_reduced: bool = False,
) -> Report:
    """Make the report: verdicts, scenes that were left out, tables of changes, and tables of all checks.

    Args:
        comparisons: results of the scenes that were compared.
        recordings: Rerun recordings by name of the scene.
        left_out: reasons by name of the scenes that were not compared.
        allow_reduced: whether elements of a model file may act that are not simulated; otherwise each is a
        failure.
    """
    unsimulated: Verdict = "doubtful" if allow_reduced else "fails"
    lines: list[str] = []
    all_checks: list[Part] = []
    for comparison in comparisons:
        lines.append(comparison.verdict)
        if comparison.scene in recordings:
            lines.append(f"recording: {recordings[comparison.scene]}")
        rows: Rows = []
        for level in dict.fromkeys(check.level for check in comparison.checks):
            rows += [_title(level), *(_row(check) for check in comparison.checks if check.level == level)]
        for engine, reason in comparison.not_measured.items():
            rows += [engine, ["not measured", Cell(reason, "fails")]]
        if comparison.acting:
            rows.append("acts in the file, and is not simulated")
            for entry in comparison.acting:
                rows.append([what_acted(entry), Cell(f"from {entry.since:.4g} s on", unsimulated)])
        # folded: pages show the table on demand
        all_checks.append(Table(comparison.scene, CHECK_COLUMNS, rows, folded=True))
    lines += filter(None, [quiet_versions(comparisons)])
    lines += [f"{name}: left out: {why}" for name, why in left_out.items()]
    result = outcome(comparisons)
    return Report(
        title="crosscheck regress",
        verdict=verdict(comparisons, left_out),
        judged=Cell(result.value, result.judged),
        parts=[Lines("", lines), *tables(comparisons), *all_checks],
        wall_time=sum(comparison.wall_time for comparison in comparisons),
        charts=_chart(comparisons),
        next_steps=next_steps(comparisons) or ["Nothing moved: there is nothing to do."],
    )


def _chart(comparisons: Sequence[Comparison]) -> list[BarChart]:
    """Make the chart of the largest change of each scene, in % of its tolerance."""
    measures = []
    for comparison in comparisons:
        worst = max((check.tolerance_ratio for check in comparison.checks), default=0.0)
        percent = max(100.0 * worst, 0.1)  # smaller changes have equal bars
        verdict: Verdict = "fails" if comparison.moved else "holds"
        measures.append(Measure(comparison.scene, percent, f"{100.0 * worst:.3g} %", 100.0, verdict))
    measures.sort(key=lambda each: -each.value)
    caption = "Largest change of each scene, in % of its tolerance; the mark is the tolerance"
    return log_chart("Changes", caption, measures, "%")


def next_steps(comparisons: Sequence[Comparison]) -> list[str]:
    """List what the reader can do about moved values, missing engines and elements that act."""
    steps = []
    if moved := [comparison.scene for comparison in comparisons if comparison.moved]:
        only = f" and {', '.join(moved)} alone" if len(moved) < len(comparisons) else ""
        steps.append(
            f"If the change is intended, repeat the command with `--update REASON`{only}; else undo it."
        )
    if names := dict.fromkeys(name for comparison in comparisons for name in comparison.not_measured):
        steps.append(f"Install {', '.join(names)} to measure the rest of the baselines.")
    if any(comparison.acting for comparison in comparisons):
        steps.append("Accept elements that act and are not simulated with `--allow-reduced`, or avoid them.")
    improved = [each for each in comparisons if (each.cheaper or each.more_accurate) and not each.moved]
    if improved:
        steps.append("Store the improvement with `--update REASON`, so that a later loss shows.")
    return steps


def as_json(
    comparisons: Sequence[Comparison],
    recordings: Mapping[str, Path],
    files: Mapping[Path, bytes],
    left_out: Mapping[str, str],
    whole: Report,
    sources: Sequence[str],
) -> bytes:
    """Format regress.json: all checks, the report, and SHA-256 checksums of files.

    Args:
        sources: names or files of the models.
        comparisons, recordings, left_out: as in `report`.
        files: contents of the files that are written together with regress.json, by path.
        whole: the report that `report` made.
    """
    scenes = [
        comparison.summary()
        | {"recording": str(recordings[comparison.scene]) if comparison.scene in recordings else None}
        for comparison in comparisons
    ]
    content = {
        "models": [{"source": source} for source in sources],
        "quiet": not any(comparison.moved for comparison in comparisons),
        "outcome": outcome(comparisons).value,
        "cheaper": [comparison.scene for comparison in comparisons if comparison.cheaper],
        "more_accurate": [comparison.scene for comparison in comparisons if comparison.more_accurate],
        "left_out": dict(left_out),
        "verdict": verdict(comparisons, left_out),
        "scenes": scenes,
    }
    return render.as_json(content, whole, files)


def junit(whole: Report) -> str:
    """Format the report as JUnit XML: a suite per scene, a case per check and per element that acts."""
    all_checks = [part for part in whole.parts if part.folded]  # other tables repeat some of these rows
    return render.junit(replace(whole, parts=all_checks))
