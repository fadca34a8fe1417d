"""The report of scenes against their baselines."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from crosscheck.compare.activity import what_acted
from crosscheck.regress.compare import Checked, Comparison
from crosscheck.report import render
from crosscheck.report.outcome import Outcome
from crosscheck.report.table import Cell, Lines, Part, Report, Rows, Table, Verdict, figures, texts

MOST_LINES = 12
"""Figures of a scene in tables of what moved; the table of all figures has the rest."""

COLUMNS = [*texts("figure", "where"), *figures("was", "moved by", "tolerances")]

CHEAPER = "cheaper"
"""Added to the tolerances by which a cost fell."""


def tables(found: Sequence[Comparison]) -> Iterator[Table]:
    """Make a table of what moved and one of what became cheaper for each scene that has any.

    Each table holds the first figures and the number of the others.
    """
    for comparison in found:
        for title, chosen in (("what moved", comparison.moved), ("what is cheaper", comparison.cheaper)):
            if chosen:
                rest = [f"and {len(chosen) - MOST_LINES} more"] if len(chosen) > MOST_LINES else []
                rows = [_row(figure, f"{figure.level}: ") for figure in chosen[:MOST_LINES]]
                yield Table(f"{comparison.scene}: {title}", COLUMNS, [*rows, *rest])


def _row(figure: Checked, group: str = "") -> list[str | Cell]:
    """Cells of `COLUMNS`."""
    unit = f", {figure.unit}" if figure.unit else ""
    name = f"{group}{figure.quantity}{unit}"
    verdict: Verdict = "fails" if figure.moved else "improved" if figure.cheaper else "holds"
    if figure.was is None or figure.now is None:
        return [name, Cell(figure.problem or "the same", verdict), "", "", ""]
    change = f"{figure.now - figure.was:+.2e}"
    share = f"{figure.tolerance_ratio:.3g} {CHEAPER}" if figure.cheaper else f"{figure.tolerance_ratio:.3g}"
    return [name, figure.where, f"{figure.was:.9g}", change, Cell(share, verdict)]


def outcome(found: Sequence[Comparison]) -> Outcome:
    """Return the outcome for all scenes."""
    each = {comparison.outcome for comparison in found}
    for worst in (Outcome.MOVED, Outcome.QUIET_ON_A_REDUCED_MODEL):
        if worst in each:
            return worst
    return Outcome.QUIET


def verdict(found: Sequence[Comparison], left_out: Mapping[str, str]) -> str:
    """Word the result of all scenes in one line."""
    moved = [comparison.scene for comparison in found if comparison.moved]
    cheaper = [comparison.scene for comparison in found if comparison.cheaper]
    count = sum(len(comparison.checked) for comparison in found)
    improved = f"; cheaper: {', '.join(cheaper)}" if cheaper else ""
    improved += f"; left out: {', '.join(left_out)}" if left_out else ""
    if moved:
        return f"{Outcome.MOVED}: {len(moved)} of {len(found)} scenes: {', '.join(moved)}{improved}"
    scenes = "1 scene" if len(found) == 1 else f"{len(found)} scenes"
    return f"{outcome(found)}: all {count} figures of {scenes}{improved}"


def report(
    found: Sequence[Comparison],
    recordings: Mapping[str, Path],
    left_out: Mapping[str, str],
    allow_reduced: bool = False,
) -> Report:
    """Report verdicts, scenes that are left out and why, what moved or became cheaper, and all figures.

    Args:
        found: the comparisons.
        recordings: files by scene.
        left_out: reasons by the name of the scene that is not compared.
        allow_reduced: whether elements that act and are not simulated are no failures.
    """
    acts: Verdict = "doubtful" if allow_reduced else "fails"
    lines: list[str] = []
    every: list[Part] = []
    for each in found:
        lines.append(each.verdict)
        if each.scene in recordings:
            lines.append(f"recording: {recordings[each.scene]}")
        rows: Rows = []
        for group in dict.fromkeys(figure.level for figure in each.checked):
            rows += [group, *(_row(figure) for figure in each.checked if figure.level == group)]
        if each.acting:
            rows.append("acts in the file, and is not simulated")
            rows += [[what_acted(entry), Cell(f"from {entry.since:.4g} s on", acts)] for entry in each.acting]
        every.append(Table(each.scene, COLUMNS, rows, folded=True))
    lines += [f"{name}: left out: {why}" for name, why in left_out.items()]
    word = Cell(outcome(found).value, outcome(found).judged)
    parts = [Lines("", lines), *tables(found), *every]
    return Report(
        "crosscheck regress", verdict(found, left_out), word, parts, sum(each.wall_time for each in found)
    )


def as_json(
    found: Sequence[Comparison],
    recordings: Mapping[str, Path],
    files: Mapping[Path, bytes],
    left_out: Mapping[str, str],
    whole: Report,
) -> bytes:
    """Everything that was compared, with SHA-256 of the files beside it."""
    scenes = [
        each.summary() | {"recording": str(recordings[each.scene]) if each.scene in recordings else None}
        for each in found
    ]
    quiet = not any(comparison.moved for comparison in found)
    cheaper = [comparison.scene for comparison in found if comparison.cheaper]
    content = {
        "quiet": quiet,
        "outcome": outcome(found).value,
        "cheaper": cheaper,
        "left_out": dict(left_out),
        "verdict": verdict(found, left_out),
        "scenes": scenes,
    }
    return render.as_json(content, whole, files)


def junit(whole: Report) -> str:
    """JUnit XML of a report: a suite per scene, a case per figure and per element that acts."""
    return render.junit(replace(whole, parts=[part for part in whole.parts if part.folded]))
