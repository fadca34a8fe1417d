"""One result on a page: the report of a command, with pictures of the files beside it.

In: a result file of a command, and the runs, recordings and pictures in the same folder. Out: a `PageEntry`,
which the template `page.html` shows in the order answer, pictures, what to do, details.
"""

from __future__ import annotations

import base64
import os
import shlex
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from crosscheck.own_run.allowed import OWN_RUN, REDUCED_RUN
from crosscheck.report import plots
from crosscheck.report.chart import BarChart
from crosscheck.report.diff_page import bar_charts
from crosscheck.report.result_files import CrosscheckFile, DiffFile, ErrorOverTime, ResultFile
from crosscheck.report.robot_view import RobotView, robot_views
from crosscheck.report.table import Part, Report, Table
from crosscheck.support.errors import CrosscheckError
from crosscheck.support.results import digest
from newton_euler.model.source_file import SourceError, read_content
from newton_euler.model.trajectory import load_arrays
from newton_euler.scalars import Array

RESULTS_TITLE, NOTES_TITLE = "Results", "Notes"
"""Titles of details without a title: of tables, and of sentences."""

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
        robots: pictures of two robots that are compared.
        views: pictures of the 3-D recordings.
        charts: bar charts.
        pictures: pictures that the command wrote, and plots of the errors of judged runs.
        plots: plots of all runs over time, which are among the details.
        missing: sentences on pictures that this machine cannot make; the page does not show them.
    """

    report: Report
    anchor: str = ""
    robots: list[RobotView] = field(default_factory=list)
    views: list[Picture] = field(default_factory=list)
    charts: list[BarChart] = field(default_factory=list)
    pictures: list[Picture] = field(default_factory=list)
    plots: list[Picture] = field(default_factory=list)
    missing: list[str] = field(default_factory=list)

    @property
    def has_pictures(self) -> bool:
        """True if there is a picture below the answer."""
        return bool(self.robots or self.views or self.charts or self.pictures)

    @property
    def details(self) -> list[tuple[str, list[Part]]]:
        """Parts that are shown on demand with their titles: those of the summary first, each part once.

        Parts without a title belong to the part before them. A table with the same title replaces the short
        one of the summary, and tables with filters replace all of its tables.
        """
        filtered = [part for part in self.report.parts if isinstance(part, Table) and part.has_filters]
        full = {part.title for part in self.report.parts if isinstance(part, Table)} - {""}
        summary = [
            part
            for part in self.report.summary
            if not (
                isinstance(part, Table)
                and (filtered or (part.title in full and part not in self.report.parts))
            )
        ]
        ordered = [*filtered, *summary, *self.report.parts]
        groups: list[list[Part]] = []
        for number, part in enumerate(ordered):
            if part in ordered[:number]:
                continue
            if part.title or not groups:
                groups.append([])
            groups[-1].append(part)
        return [(parts[0].title or _default_title(parts), parts) for parts in groups]

    @property
    def has_filters(self) -> bool:
        """True if a table has filters, which need the script."""
        return any(isinstance(part, Table) and part.has_filters for part in self.report.parts)

    @property
    def took(self) -> str:
        """Wall time of the command in a sentence, empty if it was not measured."""
        return "" if self.report.wall_time is None else f"The command took {self.report.wall_time:.3g} s."


def _default_title(parts: Sequence[Part]) -> str:
    """Return the title of parts without a title."""
    return RESULTS_TITLE if any(isinstance(part, Table) for part in parts) else NOTES_TITLE


def make_entry(file: Path, results: ResultFile, anchor: str, progress: Progress) -> PageEntry:
    """Make the entry of a result file, with pictures of the runs and recordings in the same folder.

    Args:
        file: path of the result file.
        results: content of the file.
        anchor: name by which the list of verdicts links to the entry; empty for no link.
        progress: shows a message to the user.

    Raises:
        CrosscheckError: for a run, recording or picture that is missing or differs from the original.
    """
    paths = [file.parent / name for name in results.files]
    views = [
        f"In the folder of the result, `crosscheck view {shlex.quote(path.name)}` shows the motion in 3-D."
        for path in paths
        if path.suffix == ".rrd"
    ]
    report = replace(results.report, next_steps=[*results.report.next_steps, *views])
    entry = PageEntry(report, anchor)
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
            entry.missing.append(f"the page has no 3-D pictures of {path.name}: {error}")
    # robots and bar charts
    if isinstance(results, DiffFile):
        entry.robots.extend(robot_views(results.shapes))
        entry.charts.extend(bar_charts(results.differences, results.motion))
    entry.charts.extend(report.charts)
    # pictures that the command wrote
    for path in (path for path in paths if path.suffix == ".png"):
        try:
            content = read_content(path, "result_size")  # at most as large as the limit of this name
        except SourceError as error:
            raise CrosscheckError(str(error)) from error
        caption = report.captions.get(path.name, path.stem.replace("_", " "))
        entry.pictures.append(Picture(content, caption))
    # plots of errors and runs over time
    if isinstance(results, CrosscheckFile):
        own = results.own_run
        judged = {OWN_RUN: own, REDUCED_RUN: own and own.without, **results.logs}
        for name, run in judged.items():
            if run is None or len(run.error_over_time.time) == 1:  # no motion was compared
                continue
            errors = run.error_over_time
            drawn = plots.run_errors(errors.time, errors.position, errors.rotation, name)
            entry.pictures.extend(Picture(content, caption) for content, caption in drawn)
    if runs:
        progress("plots")
        tolerances = {}
        if isinstance(results, CrosscheckFile):
            tolerances = {(check.quantity, *check.between): check.tolerance for check in results.checks}
        drawn = plots.pictures(runs, tolerances)
        entry.plots.extend(Picture(content, caption) for content, caption in drawn)
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
