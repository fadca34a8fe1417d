"""The report of scenes against their baselines."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from crosscheck.regress.compare import Checked, Comparison
from crosscheck.report import render
from crosscheck.report.table import Cell, Lines, Part, Report, Rows, Table, figures, texts
from crosscheck.results import digest

MOST_LINES = 15
"""Figures of a scene in tables of what moved; the table of all figures has the rest."""

COLUMNS = [*texts("figure", "where"), *figures("was", "now", "moved by", "tolerances")]


def tables(found: Sequence[Comparison]) -> Iterator[Table]:
    """A table per scene that moved: its first figures, and how many more moved."""
    for comparison in found:
        moved = comparison.moved
        if moved:
            rest = [f"and {len(moved) - MOST_LINES} more"] if len(moved) > MOST_LINES else []
            rows = [_row(figure, f"{figure.level}: ") for figure in moved[:MOST_LINES]]
            yield Table(f"{comparison.scene}: what moved", COLUMNS, [*rows, *rest])


def _row(figure: Checked, group: str = "") -> list[str | Cell]:
    """Cells of `COLUMNS`."""
    unit = f", {figure.unit}" if figure.unit else ""
    name = f"{group}{figure.quantity}{unit}"
    if figure.was is None or figure.now is None:
        return [name, Cell(figure.problem, "fails"), "", "", "", ""]
    bands = Cell(f"{figure.tolerances:.3g}", "fails" if figure.moved else "holds")
    change = f"{figure.now - figure.was:+.2e}"
    return [name, figure.where, f"{figure.was:.9g}", f"{figure.now:.9g}", change, bands]


def _all_figures(comparison: Comparison) -> Table:
    rows: Rows = []
    for group in dict.fromkeys(figure.level for figure in comparison.checked):
        rows += [group, *(_row(figure) for figure in comparison.checked if figure.level == group)]
    return Table(comparison.scene, COLUMNS, rows, folded=True)


def verdict(found: Sequence[Comparison]) -> str:
    """One line for all scenes."""
    moved = [comparison.scene for comparison in found if comparison.moved]
    figures = sum(len(comparison.checked) for comparison in found)
    if moved:
        return f"MOVED: {len(moved)} of {len(found)} scenes: {', '.join(moved)}"
    scenes = "1 scene" if len(found) == 1 else f"{len(found)} scenes"
    return f"QUIET: all {figures} figures of {scenes}"


def report(found: Sequence[Comparison], recordings: dict[str, Path]) -> Report:
    """Verdicts, the figures that moved, all figures, and what the baselines were made with."""
    lines = []
    for comparison in found:
        lines.append(comparison.verdict)
        if comparison.scene in recordings:
            lines.append(f"recording: {recordings[comparison.scene]}")
    versions = Table(
        "versions",
        texts("scene", "baseline", "its versions", "versions now"),
        [
            [
                each.scene,
                f"{each.made.date} ({each.made.reason})",
                _named(each.made.versions),
                _named(each.now),
            ]
            for each in found
        ],
        folded=True,
    )
    parts: list[Part] = [Lines("", lines), *tables(found), *map(_all_figures, found), versions]
    moved = any(comparison.moved for comparison in found)
    word = Cell("MOVED", "fails") if moved else Cell("QUIET", "holds")
    wall_time = sum(comparison.wall_time for comparison in found)
    return Report("crosscheck regress", verdict(found), word, parts, wall_time)


def _named(versions: dict[str, str]) -> str:
    return ", ".join(f"{name} {version}" for name, version in versions.items())


def markdown(found: Sequence[Comparison], recordings: dict[str, Path]) -> str:
    """The verdicts, and the figures that moved, for example for a summary on GitHub."""
    return render.markdown(report(found, recordings))


def as_json(found: Sequence[Comparison], recordings: dict[str, Path], folder: Path) -> bytes:
    """Everything that was compared, for a file in a folder, whose recordings a page shows."""
    scenes = [
        comparison.summary()
        | {"recording": str(path) if (path := recordings.get(comparison.scene)) else None}
        for comparison in found
    ]
    quiet = not any(comparison.moved for comparison in found)
    content = {"quiet": quiet, "verdict": verdict(found), "scenes": scenes}
    beside = [path for path in recordings.values() if path.parent.resolve() == folder.resolve()]
    return render.as_json(content, report(found, recordings), {path.name: digest(path) for path in beside})


def junit(found: Sequence[Comparison]) -> str:
    """JUnit XML: a suite per scene, a case per figure."""
    complete = report(found, {})
    every = [part for part in complete.parts if part.folded]
    return render.junit(Report(complete.title, complete.verdict, complete.judged, every, complete.wall_time))
