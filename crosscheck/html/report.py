"""A folder that crosscheck wrote, as a page."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

from crosscheck.errors import CrosscheckError
from crosscheck.files import check_writable
from crosscheck.html import measurements, page, run
from crosscheck.html.page import Cell, Markup
from crosscheck.html.summary import NAME, read_summary
from newton_euler.trajectory import atomic_file

PAGE = "report.html"

ALONE, AMONG_OTHERS = (0.0, 0.5, 1.0), (0.5,)
"""Shares of the duration at which a crosscheck's mechanism is shown."""


def write_report(folder: Path, progress: Callable[[str], None]) -> Path:
    """Write `PAGE` into a folder of `crosscheck run` or `bench`, or one that holds such folders.

    The page is one file, without anything to fetch; it appears whole or not at all.

    Raises:
        CrosscheckError: for a folder without results, a result that cannot be read, and a page that
            cannot be written.
        newton_euler.NewtonEulerError: for a run that cannot be read.
    """
    if not folder.is_dir():
        raise CrosscheckError(f"{folder} is no folder; needed: one that crosscheck run or bench wrote")
    path = folder / PAGE
    try:
        own = _has_results(folder)
        inner = [] if own else [f for f in sorted(folder.iterdir()) if f.is_dir() and _has_results(f)]
    except OSError as error:
        raise CrosscheckError(f"cannot read {folder}: {error.strerror}") from error
    if not (own or inner):
        raise CrosscheckError(
            f"nothing of crosscheck's in {folder}; needed: {NAME} or {', '.join(measurements.TITLES)}, "
            "there or in folders below"
        )
    check_writable(path)
    title = f"crosscheck: {folder.resolve().name}"
    parts = [page.heading(title, 1), *(_results(folder, ALONE, progress) if own else _index(inner, progress))]
    content = page.page(title, parts).encode()
    try:
        with atomic_file(path) as temporary:
            temporary.write_bytes(content)
    except OSError as error:
        raise CrosscheckError(f"cannot write {path}: {error.strerror}") from error
    return path


def _has_results(folder: Path) -> bool:
    return (folder / NAME).is_file() or bool(measurements.files(folder))


def _results(folder: Path, shares: tuple[float, ...], progress: Callable[[str], None]) -> Iterator[Markup]:
    """What one folder holds: a crosscheck, measurements, or both."""
    if (folder / NAME).is_file():
        yield from run.sections(folder, read_summary(folder), shares, progress)
    if measurements.files(folder):
        yield from measurements.sections(folder)


def _index(folders: list[Path], progress: Callable[[str], None]) -> Iterator[Markup]:
    """A line for each folder, and all of them below."""
    rows: list[tuple[str | Cell, ...]] = []
    for folder in folders:
        to = page.link(folder.name, f"folder-{folder.name}")
        if (folder / NAME).is_file():
            summary = read_summary(folder)
            judged = Cell("AGREE", "holds") if summary.agrees else Cell("FAILS", "fails")
            rows.append((to, judged, f"{summary.wall_time:.1f}", summary.verdict))
        else:
            rows.append((to, "", "", ", ".join(path.name for path in measurements.files(folder))))
    yield page.table(("", "", "time, s", "verdict"), rows)
    for folder in folders:
        yield page.heading(folder.name, anchor=f"folder-{folder.name}")
        yield from _results(folder, AMONG_OTHERS, progress)
