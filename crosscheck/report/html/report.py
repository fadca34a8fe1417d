"""A folder that crosscheck wrote, as a page."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from crosscheck.errors import CrosscheckError
from crosscheck.files import check_writable
from crosscheck.report.html import bench, faults, page, regress, run, stress
from crosscheck.report.html.page import Cell, Markup, Progress
from crosscheck.report.html.results import Results
from crosscheck.report.html.summary import Summary
from crosscheck.report.output import tidied_up
from crosscheck.results import read_json
from newton_euler.model.trajectory import atomic_file

PAGE = "report.html"

ALONE, AMONG_OTHERS = (0.0, 0.5, 1.0), (0.5,)
"""Shares of the duration at which a recording is shown."""

BELOW = ("*", "*/*")
"""Where folders with results are looked for in one without: the folders of `crosscheck run --all`, those of
all scenes that were benchmarked, all that is in the usual folder for output."""

MOST_IN_FULL = 15
"""Folders on one page, a few seconds each; of more there is an index alone. All scenes of the library fit."""

Sections = Callable[[Any, Path, Sequence[float], Progress], Iterator[Markup]]

KINDS: dict[str, tuple[type[Results], Sections]] = {
    "summary.json": (Summary, run.sections),
    "regress.json": (regress.Regress, regress.sections),
    "faults.json": (faults.Faults, faults.sections),
    "stress.json": (stress.Stress, stress.sections),
    **{name: (kind, bench.sections) for name, kind in bench.KINDS.items()},
}
"""By the name of the file that holds results: what is in it, and what a page shows of it."""


class Read(NamedTuple):
    """A file of results with its content."""

    path: Path
    content: Results

    def sections(self, shares: Sequence[float], progress: Progress) -> Iterator[Markup]:
        return KINDS[self.path.name][1](self.content, self.path, shares, progress)


def write_report(folder: Path, progress: Progress) -> Path:
    """Write `PAGE` into a folder that a command wrote results to, or one that holds such folders.

    The page is one file, without anything to fetch; it appears whole or not at all. Of more than
    `MOST_IN_FULL` folders it holds the verdicts and names what writes the pages of each.

    Raises:
        CrosscheckError: for a folder without results, a result that cannot be read, and a page that
            cannot be written.
        newton_euler.NewtonEulerError: for a run that cannot be read.
    """
    if not folder.is_dir():
        raise CrosscheckError(f"{folder} is no folder; needed: one that a command of crosscheck wrote")
    path = folder / PAGE
    try:
        own = _files(folder)
        below = [] if own else sorted(file for p in BELOW for f in folder.glob(p) for file in _files(f))
    except OSError as error:
        raise CrosscheckError(f"cannot read {folder}: {error.strerror}") from error
    if not (own or below):
        raise CrosscheckError(
            f"nothing of crosscheck's in {folder}; needed, there or at most two folders below: "
            f"{', '.join(KINDS)}, as run, regress, faults, stress and bench write them"
        )
    check_writable(path)
    found = [Read(file, read_json(file, KINDS[file.name][0])) for file in own or below]
    title = f"crosscheck: {folder.resolve().name}"
    parts = _all(found, ALONE, progress) if own else _index(folder, found, progress)
    content = page.page(title, [page.heading(title, 1), *parts]).encode()
    try:
        with tidied_up(), atomic_file(path) as temporary:
            temporary.write_bytes(content)
    except OSError as error:
        raise CrosscheckError(f"cannot write {path}: {error.strerror}") from error
    return path


def _files(folder: Path) -> list[Path]:
    """The files with results in a folder."""
    return [folder / name for name in KINDS if (folder / name).is_file()]


def _all(found: Iterable[Read], shares: Sequence[float], progress: Progress) -> Iterator[Markup]:
    for each in found:
        yield from each.sections(shares, progress)


def _index(folder: Path, found: Sequence[Read], progress: Progress) -> Iterator[Markup]:
    """A line for each file, and all of them below, those of a folder together, if these are few."""
    inner = list(dict.fromkeys(path.parent for path, _ in found))
    in_full = len(inner) <= MOST_IN_FULL
    rows: list[tuple[str | Cell, ...]] = []
    for path, content in found:
        name = path.parent.relative_to(folder).as_posix()
        verdict, judged, wall_time = content.headline
        took = "" if wall_time is None else f"{wall_time:.1f}"
        line = (page.link(name, f"folder-{name}") if in_full else name, judged, took, verdict or path.name)
        rows.append(line if in_full else (*line, f"crosscheck report {shlex.quote(str(path.parent))}"))
    head = ("", "", "time, s", "verdict")
    yield page.table(head if in_full else (*head, "for its page"), rows)
    if not in_full:
        yield page.paragraph(f"{len(inner)} folders; up to {MOST_IN_FULL} are shown in full on one page.")
        return
    for number, part in enumerate(inner, 1):
        name = part.relative_to(folder).as_posix()
        yield page.heading(name, anchor=f"folder-{name}")
        there = (each for each in found if each.path.parent == part)
        yield from _all(there, AMONG_OTHERS, _counted(progress, f"{number} of {len(inner)} folders"))


def _counted(progress: Progress, count: str) -> Progress:
    return lambda text: progress(f"{count}, {text}")
