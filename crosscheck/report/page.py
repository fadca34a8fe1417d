"""`crosscheck report`: write the results of commands as one HTML page, with all pictures in the page.

Each command of crosscheck writes a result file (JSON) that contains a report: tables and sentences. The page
shows the reports of all result files in a folder, or in its subfolders. It also has plots of the runs and
pictures of the 3-D recordings in the same folders. The page is rendered from the templates next to this
module by jinja2, which escapes all texts.
"""

from __future__ import annotations

import base64
import hashlib
import os
import shlex
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from crosscheck.own_run.allowed import OWN_RUN
from crosscheck.report import plots
from crosscheck.report.diff_page import BarChart, bar_charts
from crosscheck.report.render import printable
from crosscheck.report.result_files import CrosscheckFile, DiffFile, ErrorOverTime, ResultFile
from crosscheck.report.robot_view import RobotView, robot_views
from crosscheck.report.table import Lines, Part, Report, Table
from crosscheck.support.errors import CrosscheckError
from crosscheck.support.files import check_writable, write_files
from crosscheck.support.results import digest, read_json
from newton_euler.model.source_file import SourceError, read_content
from newton_euler.model.trajectory import load_arrays
from newton_euler.scalars import Array

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
)
"""Names of result files that contain a report."""

SUBFOLDERS = ("*", "*/*")
"""Patterns of subfolders that are searched if a folder has no results itself, such as the folder of
`crosscheck run --all`."""

MAX_FOLDERS_IN_FULL = 30
"""Largest number of folders that a page shows in full; for more, the page only lists the verdicts. Each
folder takes a few seconds. The library of `crosscheck run --all` has fewer scenes."""

Progress = Callable[[str], None]
"""Function that shows a message to the user."""


@dataclass(frozen=True)
class Picture:
    """A picture (PNG) with its caption."""

    content: bytes
    caption: str

    @property
    def base64(self) -> str:
        """Content of the picture as text, which the page contains."""
        return base64.b64encode(self.content).decode()


@dataclass(frozen=True)
class PageEntry:
    """One result file, as the template `page.html` shows it.

    Attributes:
        report: tables and sentences.
        anchor: name by which the list of verdicts links to the entry; empty for no link.
        views: pictures of the 3-D recordings.
        speed: bar charts of run times.
        pictures: plots over time, and pictures that the command wrote.
        robots: pictures of two robots that are compared.
        bars: bar charts.
        remarks: sentences on pictures that could not be made.
    """

    report: Report
    anchor: str = ""
    views: list[Picture] = field(default_factory=list)
    speed: list[Picture] = field(default_factory=list)
    pictures: list[Picture] = field(default_factory=list)
    robots: list[RobotView] = field(default_factory=list)
    bars: list[BarChart] = field(default_factory=list)
    remarks: list[str] = field(default_factory=list)

    @property
    def open(self) -> list[Part]:
        """Parts that are always shown: the summary, or the parts that are not folded if there is none.

        Tables with filters replace the short tables of the summary.
        """
        filtered = [part for part in self.report.parts if isinstance(part, Table) and part.has_filters]
        if filtered:
            return [*filtered, *(part for part in self.report.summary if isinstance(part, Lines))]
        return self.report.summary or [part for part in self.report.parts if not part.folded]

    @property
    def folded(self) -> list[Part]:
        """Parts that are shown on demand: all parts that `open` does not have."""
        shown = self.open
        folded = self.report.parts if self.report.summary else [p for p in self.report.parts if p.folded]
        return [part for part in folded if part not in shown]

    @property
    def has_filters(self) -> bool:
        """True if a table has filters, which need the script."""
        return any(isinstance(part, Table) and part.has_filters for part in self.open)

    @property
    def took(self) -> str:
        """Wall time of the command in parentheses, empty if it was not measured."""
        return "" if self.report.wall_time is None else f" ({self.report.wall_time:.3g} s)"


def write_report(folder: Path, progress: Progress) -> Path:
    """Write the page of a result folder, or of a folder that contains result folders.

    The page is a single file that loads nothing from the network. If there are more than
    `MAX_FOLDERS_IN_FULL` folders, it lists their verdicts, and the commands that make a page of each.

    Args:
        folder: the folder; the page is written to `folder`/report.html.
        progress: shows a message to the user.

    Returns:
        The path of the page.

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
    index: list[dict[str, object]] = []
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
        entries.append(_make_entry(file, content, anchor, progress_of_entry))
    title = f"crosscheck: {folder.resolve().name}"
    text = rendered("page.html", title=title, index=index, entries=entries, most=MAX_FOLDERS_IN_FULL)
    write_files({path: text.encode()})
    return path


def rendered(template: str, **content: object) -> str:
    """Render an HTML template of this package with the given variables; all texts in them are escaped."""
    environment = Environment(
        loader=FileSystemLoader(Path(__file__).parent),
        autoescape=True,
        undefined=StrictUndefined,
        # `type`, since jinja2's own text, which is already escaped, is a subclass of str
        finalize=lambda value: printable(value) if type(value) is str else value,
        keep_trailing_newline=True,
    )
    # the only script that a page allows, which it recognizes by the checksum
    script = (Path(__file__).parent / "filter.js").read_text(encoding="utf-8")
    checksum = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    environment.globals |= {"script": Markup(script), "script_checksum": f"sha256-{checksum}"}
    return environment.get_template(template).render(**content)


def _results_in(folder: Path) -> list[Path]:
    """List the result files in a folder, in the order of `RESULTS`."""
    return [folder / name for name in RESULTS if (folder / name).is_file()]


def _with_count(progress: Progress, count: str) -> Progress:
    """Return a progress function that puts a count, such as "2 of 5 folders", before each message."""
    return lambda text: progress(f"{count}, {text}")


def _index_line(folder: Path, file: Path, report: Report) -> dict[str, object]:
    """Make the row of a result file in the list of verdicts: variables of the template."""
    _, verdict = report.headline  # without the words in capitals at the beginning, which are `judged`
    return {
        "name": file.parent.relative_to(folder).as_posix(),
        "judged": report.judged,
        "time": "" if report.wall_time is None else f"{report.wall_time:.1f}",
        "verdict": verdict or report.title,
        "command": f"crosscheck report {shlex.quote(str(file.parent))}",
    }


def _make_entry(file: Path, results: ResultFile, anchor: str, progress: Progress) -> PageEntry:
    """Make the entry of a result file, with pictures of the runs and recordings in the same folder.

    Args:
        file: path of the result file.
        results: content of the file.
        anchor: name by which the list of verdicts links to the entry; empty for no link.
        progress: shows a message to the user.

    Raises:
        CrosscheckError: for a run, recording or picture that is missing or differs from the original.
    """
    entry = PageEntry(results.report, anchor)
    paths = [file.parent / name for name in results.files]
    for path in paths:
        if not os.path.lexists(path):
            raise CrosscheckError(f"{path}: missing, {file.name} beside it was written with it; run it again")
        if results.files[path.name] != digest(path):
            raise CrosscheckError(f"{path}: is not the file that {file.name} beside it was written with")
    # pictures of the 3-D recordings at some times of the first log, which is on top, or of the first run
    runs = _read_runs(path for path in paths if path.suffix == ".npz")
    first = next(iter(runs.values()), None)
    times, log = [0.0] if first is None else key_times(first), ""
    if isinstance(results, CrosscheckFile) and results.logs:
        log = next(iter(results.logs))
        times = times_of_error(results.logs[log].error_over_time)
    for path in (path for path in paths if path.suffix == ".rrd"):
        progress(f"{path.stem}: pictures of the recording")
        try:
            entry.views.extend(_view_pictures(path, times, log))
        except CrosscheckError as error:
            entry.remarks.append(f"No picture of {path.stem}: {error}")
    # plots of errors, run times and runs
    if isinstance(results, CrosscheckFile):
        own = {OWN_RUN: results.own_run} if results.own_run is not None else {}
        for name, run in {**own, **results.logs}.items():
            errors = run.error_over_time
            drawn = plots.run_errors(errors.time, errors.position, errors.rotation, name)
            entry.pictures.extend(Picture(content, caption) for content, caption in drawn)
    if isinstance(results, DiffFile):
        entry.robots.extend(robot_views(results.shapes))
        entry.bars.extend(bar_charts(results.differences, results.motion))
    if runs:
        progress("plots")
        costs, tolerances = {}, {}
        if isinstance(results, CrosscheckFile):
            costs = {name: (cost.wall_time, cost.error) for name, cost in results.engines.items()}
            tolerances = {(check.quantity, *check.between): check.tolerance for check in results.checks}
        entry.speed.extend(Picture(content, caption) for content, caption in plots.speed(costs))
        drawn = plots.pictures(runs, tolerances)
        entry.pictures.extend(Picture(content, caption) for content, caption in drawn)
    # pictures that the command wrote
    for path in (path for path in paths if path.suffix == ".png"):
        try:
            content = read_content(path, "result_size")  # at most as large as the limit of this name
        except SourceError as error:
            raise CrosscheckError(str(error)) from error
        entry.pictures.append(Picture(content, path.stem.replace("_", " ")))
    return entry


def key_times(run: Mapping[str, Array]) -> list[float]:
    """Return three times, s: the start, the time of the pose farthest from both ends, and the end.

    Args:
        run: arrays of a run by name: "time" (n,), s, "position" (n, b, 3), m, and others.
    """
    time, position = run["time"], run["position"]
    start, end = position[0], position[-1]
    from_start, from_end = (np.linalg.norm(position - pose, axis=2).max(axis=1) for pose in (start, end))
    distance = np.minimum(from_start, from_end)
    middle = int(np.argmax(distance)) if distance.any() else len(time) // 2
    return [float(time[0]), float(time[middle]), float(time[-1])]


def times_of_error(errors: ErrorOverTime) -> list[float]:
    """Return three times, s, of a log: the start, the time of the largest error of positions, and the end."""
    return [errors.time[0], errors.time[int(np.argmax(errors.position))], errors.time[-1]]


def _view_pictures(recording: Path, times: Sequence[float], log: str) -> Iterator[Picture]:
    """Yield pictures of the mechanism in a recording, made by the Rerun viewer.

    Args:
        recording: path of the recording.
        times: times, s.
        log: name of the log whose view is on top in the recording; "" without logs.

    Raises:
        CrosscheckError: if the viewer does not run or shows nothing.
    """
    from crosscheck.recording.screenshot import MECHANISM, screenshots

    if not recording.is_file():  # reading a pipe could wait forever
        raise CrosscheckError(f"{recording}: not a regular file")
    for time, content in zip(times, screenshots(recording, times, MECHANISM), strict=True):
        what = f"log {log} (ghost) and its reference" if log else recording.stem
        yield Picture(content, f"{what} at {time:.4g} s")


def _read_runs(paths: Iterator[Path]) -> dict[str, dict[str, Array]]:
    """Read the arrays of runs, by engine and by name of the array; all runs must have equally many bodies."""
    runs: dict[str, dict[str, Array]] = {}
    for path in paths:
        arrays = load_arrays(path)
        for other in runs.values():
            if len(other["body_names"]) != len(arrays["body_names"]):
                raise CrosscheckError(f"{path}: body_names are not as many as those of other runs")
        runs[path.stem] = arrays
    return runs
