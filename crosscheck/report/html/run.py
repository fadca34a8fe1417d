"""The sections of a page about one crosscheck."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from crosscheck.comparison.rows import NOT_NEARER
from crosscheck.errors import CrosscheckError
from crosscheck.report.html import drawing, page, plots
from crosscheck.report.html.page import Cell, Markup, Progress
from crosscheck.report.html.summary import Figure, Mapped, Summary
from crosscheck.results import digest
from newton_euler.model.trajectory import load_arrays
from newton_euler.scalars import Array

PLAIN_NAME = re.compile(r"[A-Za-z0-9_\-]+")

PARTS = {
    "pairs": "Engines against each other",
    "single": "Each engine by itself",
    "within": "Two equations of motion of one engine",
}


def sections(summary: Summary, path: Path, shares: Sequence[float], progress: Progress) -> Iterator[Markup]:
    """Verdict, tables, pictures and settings; pictures of the mechanism at `shares` of the duration."""
    yield page.verdict(*summary.headline)
    if summary.notes:
        yield page.listing(summary.notes)
    if summary.unfinished:
        yield page.heading("Not finished", 3)
        yield page.table(
            ("", "up to, s", "why"),
            ((s.what, "" if s.time is None else f"{s.time:.6g}", s.reason) for s in summary.unfinished),
        )
    if summary.advice:
        yield page.heading("Advice", 3)
        yield page.table(("", ""), ((piece.topic, piece.text) for piece in summary.advice))
    yield from _figures(summary)
    yield from _known_figures(summary)
    yield from _pictures(path.parent, summary, shares, progress)
    yield page.heading("Settings", 3)
    yield from _settings(summary)
    if summary.models is None:
        yield from _mapping("the model file", summary.mapping, summary.start)
        return
    for model in summary.models:
        yield page.heading(f"Model {model.name}", 3)
        yield page.table(("", ""), [("source", model.source), ("options", _options(model.options))])
        yield from _mapping(model.name, model.mapping, model.start)


def _judged(value: float, allowed: float, agrees: bool, about: str) -> Cell:
    text = f"{value:.1e} {'<' if value <= allowed else '>'} {allowed:.0e}"
    return Cell(text, "holds" if agrees else "fails", about)


def _figures(summary: Summary) -> Iterator[Markup]:
    """A table for each part: a line for each quantity by level, a column for each pair or engine."""
    engines = set(summary.engines)

    def part(figure: Figure) -> str:
        if len(figure.between) == 1:
            return "single"
        return "pairs" if set(figure.between) <= engines else "within"

    for name, title in PARTS.items():
        figures = [figure for figure in summary.figures if part(figure) == name]
        if not figures:
            continue
        yield page.heading(title, 3)
        columns = list(dict.fromkeys(tuple(figure.between) for figure in figures))
        rows: list[Sequence[str | Cell] | str] = []
        for level in dict.fromkeys(figure.level for figure in figures):
            rows.append(level)
            at_level = [figure for figure in figures if figure.level == level]
            for quantity in dict.fromkeys(figure.quantity for figure in at_level):
                cells = {tuple(f.between): _cell(f) for f in at_level if f.quantity == quantity}
                rows.append([quantity, *(cells.get(between, "") for between in columns)])
        yield page.table(["", *("\n".join(between) for between in columns)], rows)
    failed = [figure for figure in summary.figures if not figure.agrees and not figure.informs]
    if failed:
        yield page.heading("Where they part", 3)
        yield page.table(
            ("level", "figure", "between", "value", "worst at"),
            ((f.level, f.quantity, ", ".join(f.between), _cell(f), f.where) for f in failed),
        )


def _cell(figure: Figure) -> Cell:
    about = f"worst at {figure.where}"
    if figure.unsettled:
        return Cell(f"{figure.value:.1e} not judged", "", f"{figure.unsettled} is {NOT_NEARER}, {about}")
    if figure.informs:
        return Cell(f"{figure.value:.1e}", "", about)
    return _judged(figure.value, figure.tolerance, figure.agrees, about)


def _known_figures(summary: Summary) -> Iterator[Markup]:
    if not summary.known_figures:
        return
    yield page.heading("Against the reference", 3)
    yield page.table(
        ("figure", "time, s", "engine", "value", "reference", "difference"),
        (
            (
                f"{known.quantity}, {known.unit}",
                f"{known.time:g}",
                known.engine,
                Cell(f"{known.value:.12g}"),
                Cell(f"{known.reference:.12g}"),
                _judged(known.difference, known.allowed, known.agrees, ""),
            )
            for known in summary.known_figures
        ),
    )


def _pictures(
    folder: Path, summary: Summary, shares: Sequence[float], progress: Progress
) -> Iterator[Markup]:
    yield page.heading("Runs", 3)
    runs = _runs(folder, summary)
    if not runs:
        yield page.paragraph("The runs are not in the folder, so there is nothing to draw.")
        return
    recording = folder / f"{summary.scene}.rrd"
    if PLAIN_NAME.fullmatch(summary.scene) and recording.is_file():
        _check_own(recording, summary)
        progress(f"{summary.scene}: pictures of the recording")
        try:
            for content, caption in drawing.views(recording, next(iter(runs)), shares):
                yield page.picture(content, caption)
        except CrosscheckError as error:
            yield page.paragraph(f"No picture of the mechanism: {error}")
    progress(f"{summary.scene}: plots")
    for content, caption in plots.pictures(runs):
        yield page.picture(content, caption)


def _runs(folder: Path, summary: Summary) -> dict[str, dict[str, Array]]:
    """The arrays of the runs that the folder has, in the order of the engines."""
    found: dict[str, dict[str, Array]] = {}
    for engine in summary.engines:
        path = folder / f"{engine}.npz"
        if not PLAIN_NAME.fullmatch(engine) or not path.is_file():
            continue
        _check_own(path, summary)
        arrays = load_arrays(path)
        for other in found.values():
            if len(other["body_names"]) != len(arrays["body_names"]):
                raise CrosscheckError(f"{path}: body_names are not as many as those of other runs")
        found[engine] = arrays
    return found


def _check_own(path: Path, summary: Summary) -> None:
    """Raise `CrosscheckError` for a file that is not the one that was written with the summary."""
    if summary.files.get(path.name) != digest(path):
        raise CrosscheckError(f"{path}: is not the file that summary.json beside it was written with")


def _settings(summary: Summary) -> Iterator[Markup]:
    yield page.table(
        ("", ""),
        [
            ("scene", summary.scene),
            ("source", summary.source),
            ("options", _options(summary.options)),
        ],
    )
    yield page.table(
        ("engine", "time, s", "settings"),
        (
            (name, "" if run.wall_time is None else f"{run.wall_time:.3g}", page.values(run.settings))
            for name, run in summary.engines.items()
        ),
    )
    if summary.left_out:
        yield page.table(("engine left out", "why"), summary.left_out.items())
    yield page.table(("package", "version"), summary.versions.items())


def _options(options: Mapping[str, Any]) -> str:
    return ", ".join(f"{name}={value}" for name, value in options.items()) or "none set"


def _mapping(file: str, mapping: Sequence[Mapped] | None, start: Sequence[str] | None) -> Iterator[Markup]:
    """What became of the elements of a model file, and where the run starts."""
    if mapping is not None:
        yield page.heading(f"What became of {file}", 3)
        for fate in dict.fromkeys(entry.fate for entry in reversed(mapping)):
            entries = [(entry.element, entry.how) for entry in mapping if entry.fate == fate]
            yield page.details(f"{fate}: {len(entries)}", [page.table(("element", "how"), entries)])
    if start:
        yield page.heading("Start", 3)
        yield page.listing(start)
