"""`crosscheck report`: write the results of commands as one HTML page, with all pictures in the page.

Each command of crosscheck writes a result file (JSON) that contains a report: tables and sentences. The page
shows the reports of all result files in a folder, or in its subfolders. It also has plots of the runs and
pictures of the 3-D recordings in the same folders. All results have the same order: the answer, pictures,
what the reader can do, and details that are folded.
"""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

from crosscheck.compare.outcome import Verdict
from crosscheck.report.entry import Progress, make_entry
from crosscheck.report.result_files import CrosscheckFile, DiffFile, ResultFile
from crosscheck.report.table import Cell, Report
from crosscheck.report.template import rendered
from crosscheck.support.errors import CrosscheckError
from crosscheck.support.files import check_writable, write_files
from crosscheck.support.results import read_json

PAGE = "report.html"
"""Name of the page."""

RESULT_KINDS: dict[str, type[ResultFile]] = {"summary.json": CrosscheckFile, "diff.json": DiffFile}
"""Result files whose pages have more than those of other commands, and the fields that they need."""

RESULTS = (
    "summary.json",
    "regress.json",
    "faults.json",
    "stress.json",
    "bench.json",
    "rhs.json",
    "batch.json",
    "sensitivities.json",
    "sweep.json",
    "loads.json",
    "drives.json",
    "sun.json",
    "year.json",
    "modes.json",
    "controllers.json",
    "workspace.json",
    "identify.json",
    "tune.json",
    "diff.json",
    "importers.json",
    "engine_check.json",
)
"""Names of result files that contain a report."""

SUBFOLDERS = ("*", "*/*")
"""Patterns of subfolders that are searched if a folder has no results itself, such as the folder of
`crosscheck run --all`."""

MAX_FOLDERS_IN_FULL = 30
"""Largest number of folders that a page shows in full; for more, the page only lists the verdicts. Each
folder takes a few seconds. The library of `crosscheck run --all` has fewer scenes."""

MAX_LISTED = 6
"""Largest number of results that the answer of a page of several results names."""


class IndexLine(NamedTuple):
    """Row of the list of verdicts.

    Attributes:
        name: path of the folder, below the folder of the page.
        judged: the result in one word.
        time: wall time of the command, s; empty if it was not measured.
        verdict: the result in one sentence.
        command: command that writes the page of the folder.
    """

    name: str
    judged: Cell
    time: str
    verdict: str
    command: str


class WrittenPage(NamedTuple):
    """A page that was written.

    Attributes:
        path: path of the page.
        missing: sentences on pictures that this machine cannot make.
    """

    path: Path
    missing: list[str]


def write_report(folder: Path, progress: Progress) -> WrittenPage:
    """Write the page of a result folder, or of a folder that contains result folders.

    The page is a single file that loads nothing from the network. If there are more than
    `MAX_FOLDERS_IN_FULL` folders, it lists their verdicts, and the commands that make a page of each.

    Args:
        folder: the folder; the page is written to `folder`/report.html.
        progress: shows a message to the user.

    Returns:
        The path of the page, and what it does not show.

    Raises:
        CrosscheckError: for a folder without results, a result that cannot be read, and a page that
            cannot be written.
        newton_euler.NewtonEulerError: for a run that cannot be read.
    """
    if not folder.is_dir():
        raise CrosscheckError(f"{folder} is no folder; needed: one that a command of crosscheck wrote")
    path = folder / PAGE

    # find the result files: in the folder, or else in its subfolders
    try:
        in_folder = _results_in(folder)
        in_subfolders: list[Path] = []
        if not in_folder:
            subfolders = [subfolder for pattern in SUBFOLDERS for subfolder in folder.glob(pattern)]
            in_subfolders = sorted(file for subfolder in subfolders for file in _results_in(subfolder))
    except OSError as error:
        raise CrosscheckError(f"cannot read {folder}: {error.strerror}") from error
    if not (in_folder or in_subfolders):
        raise CrosscheckError(
            f"nothing of crosscheck's in {folder}; needed, there or at most two folders below: "
            f"{', '.join(RESULTS)}, as run, regress, faults, stress, bench, sweep, loads, drives, modes, "
            "controllers, workspace, sun, year, identify, tune, diff and importers write them"
        )
    check_writable(path)

    # read them
    contents = {
        file: read_json(file, RESULT_KINDS.get(file.name, ResultFile)) for file in in_folder or in_subfolders
    }
    parents = list(dict.fromkeys(file.parent for file in contents))
    # make the list of verdicts, and an entry with pictures for each file unless there are too many folders
    index: list[IndexLine] = []
    if in_subfolders:
        index = [_index_line(folder, file, content.report) for file, content in contents.items()]
    entries = []
    for file, content in contents.items() if len(parents) <= MAX_FOLDERS_IN_FULL else ():
        progress_of_entry, anchor = progress, ""
        if in_subfolders:
            number = parents.index(file.parent) + 1
            progress_of_entry = _with_count(progress, f"{number} of {len(parents)} folders")
            # the list links to the first entry of each folder
            if file == next(other for other in contents if other.parent == file.parent):
                anchor = file.parent.relative_to(folder).as_posix()
        entries.append(make_entry(file, content, anchor, progress_of_entry))
    title = f"crosscheck: {folder.resolve().name}"
    overall = _overall(index, has_entries=bool(entries)) if index else None
    text = rendered("page.html", title=title, overall=overall, index=index, entries=entries)
    write_files({path: text.encode()})
    return WrittenPage(path, [sentence for entry in entries for sentence in entry.missing])


def _overall(index: Sequence[IndexLine], has_entries: bool) -> Report:
    """Make the answer of a page of several results: how many of them fail, and which.

    Args:
        index: the list of verdicts.
        has_entries: whether the page also shows each result in full.
    """
    failing, doubtful = (
        [line for line in index if line.judged.verdict == verdict] for verdict in ("fails", "doubtful")
    )
    count = f"{len(index)} result{'s' * (len(index) != 1)}"
    texts = [
        f"{len(lines)} of {count} {what}: {_names(lines)}"
        for lines, what in ((failing, "failed"), (doubtful, "passed with limitations"))
        if lines
    ]
    worst: Verdict = "fails" if failing else "doubtful" if doubtful else "holds"
    steps = [f"Begin with `{_names(failing or doubtful, 1)}`."] if texts else []
    if not has_entries:
        steps.append(
            f"A page shows up to {MAX_FOLDERS_IN_FULL} folders in full. To write the page of one folder, run "
            "its command in the list."
        )
    sentence = "; ".join(texts) or f"none of {count} failed"
    return Report("", sentence, Cell("", worst), [], next_steps=steps)


def _names(lines: Sequence[IndexLine], most: int = MAX_LISTED) -> str:
    """List the names of the first results, and the number of the others."""
    names = list(dict.fromkeys(line.name for line in lines))
    more = f" and {len(names) - most} more" if len(names) > most > 1 else ""
    return ", ".join(names[:most]) + more


def _results_in(folder: Path) -> list[Path]:
    """List the result files in a folder, in the order of `RESULTS`."""
    return [folder / name for name in RESULTS if (folder / name).is_file()]


def _with_count(progress: Progress, count: str) -> Progress:
    """Return a progress function that puts a count, such as "2 of 5 folders", before each message."""
    return lambda text: progress(f"{count}, {text}")


def _index_line(folder: Path, file: Path, report: Report) -> IndexLine:
    """Make the row of a result file in the list of verdicts."""
    word, verdict = report.headline  # the words in capitals at its beginning, which are often `judged`, too
    return IndexLine(
        name=file.parent.relative_to(folder).as_posix(),
        judged=replace(report.judged, text=report.judged.text or word),
        time="" if report.wall_time is None else f"{report.wall_time:.1f}",
        verdict=verdict or report.title,
        command=f"crosscheck report {shlex.quote(str(file.parent))}",
    )
