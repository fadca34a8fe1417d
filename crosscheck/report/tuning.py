"""Report of `crosscheck tune`: found settings, their error and cost, and the text to paste into the file.

`crosscheck tune` searches the cheapest settings (time step, integrator, solver) of a model file's engine with
which the error of a run is below a target. The error is relative to the extent of the motion.

If the motion of a mechanism is chaotic or unstable, its comparison with the reference solution ends early, at
a time in `SettingsSearch.scale`. `SettingsSearch.events` are elements of the file that act in the run and
that the reference does not simulate, such as contacts.
"""

from __future__ import annotations

from collections.abc import Iterator

from crosscheck.compare.outcome import Verdict
from crosscheck.own_run.tune import SettingsSearch, Tried
from crosscheck.report.chart import Measure, log_chart
from crosscheck.report.own_run import chaos_text, percent, size, unsimulated_text
from crosscheck.report.table import Cell, Column, Lines, Part, Report, Rows, Table, number_columns


def report(name: str, tuning: SettingsSearch) -> Report:
    """Make the report of a search for settings.

    Args:
        name: name of the model.
        tuning: result of the search.
    """
    found = tuning.found  # settings that reach the target; None if none do
    parts: list[Part] = [_table(tuning), Lines("", list(_notes(tuning)))]
    if found is not None and found.changes:
        parts.append(Lines("paste into the model", found.fragment.splitlines()))
    title = f"{name}: settings of {tuning.engine} for an error of {percent(tuning.target)} of the motion"
    judged = Cell("", "holds" if found else "fails")
    # the report is short: its summary, which the terminal always shows, has all parts
    errors = [
        Measure(
            label,
            100.0 * tried.error.relative,
            "diverged" if tried.stopped else percent(tried.error.relative),
            100.0 * tuning.target,
            "holds" if tried.reaches(tuning.target) else "fails",
        )
        for label, tried in [
            ("your settings", tuning.own),
            *((_settings(each), each) for each in tuning.tradeoff),
        ]
    ]
    caption = "Error of each run in % of the motion, from cheap to accurate; the mark is your target"
    return Report(
        title,
        _verdict(tuning),
        judged,
        parts,
        summary=parts,
        charts=log_chart("Errors", caption, errors, "%"),
        next_steps=_next_steps(tuning),
    )


def _next_steps(tuning: SettingsSearch) -> list[str]:
    """List what the reader can do with the settings."""
    if tuning.found is None:
        return ["Allow a larger error with `--error`, or a shorter run with `--set duration=SECONDS`."]
    if not tuning.found.changes:
        return ["Keep your settings: no cheaper ones reach the error."]
    return [
        "Paste the text below, under `paste into the model`, into your file.",
        "Then run `crosscheck run` with the changed file to confirm the error.",
    ]


def _verdict(tuning: SettingsSearch) -> str:
    """Format the found settings; if there are none, the smallest error of all tried settings."""
    found = tuning.found
    if found is None:
        best = min(tuning.tradeoff, key=lambda tried: tried.error.relative, default=None)
        reached = "every run diverged" if best is None else f"the smallest error is {_error(best)}"
        return f"NOT REACHED: {reached}, of {tuning.runs} runs"
    return f"REACHED: {_settings(found)}: {_error(found)}, {_cost(found, tuning.own)}"


def _settings(tried: Tried) -> str:
    """Format settings by their differences from those of the file."""
    return tried.text or "the settings of the file"


def _error(tried: Tried) -> str:
    """Format the error of a run as a part of the motion, and as a length, or an angle if that dominates."""
    error = tried.error
    if tried.stopped:
        return "diverged"
    return f"{size(error, by_position=error.stated_by_position)}, {percent(error.relative)} of the motion"


def _cost(tried: Tried, of_file: Tried) -> str:
    """Format the cost of settings (evaluations of the equations of motion) relative to those of the file."""
    ratio = tried.evaluations / of_file.evaluations
    if ratio == 1.0:
        return "the same number of evaluations as your settings"
    return f"{ratio:.3g} times the evaluations of your settings"


def _table(tuning: SettingsSearch) -> Table:
    """Make the table of the file's settings, and of settings with smaller errors than all cheaper ones."""

    def row(settings: str, tried: Tried) -> list[str | Cell]:
        verdict: Verdict = "holds" if tried.reaches(tuning.target) else ""
        error = "diverged" if tried.stopped else percent(tried.error.relative).removesuffix(" %")
        evaluations = f"{tried.evaluations / tuning.own.evaluations:.3g}"
        # relative to the settings of the file; None if the run was not timed
        run_time = "" if tried.run_time is None else f"{tried.run_time:.2g}"
        return [settings, Cell(error, verdict), evaluations, run_time]

    columns = [Column("settings"), *number_columns("error, %", "evaluations", "run time")]
    rows: Rows = [row(f"yours: {tuning.settings}", tuning.own)]
    rows += [row(_settings(tried), tried) for tried in tuning.tradeoff]
    return Table(
        "your settings, then others from cheap to accurate; costs are relative to yours", columns, rows
    )


def _notes(tuning: SettingsSearch) -> Iterator[str]:
    """Yield how the settings were found, and the limits of the result."""
    yield (
        f"{tuning.runs} runs, the cheapest settings first, by evaluations of the equations of motion; errors "
        "are relative to the motion"
    )
    if tuning.events:
        yield f"note: the error is without {unsimulated_text(tuning.events)}"
    if chaos := chaos_text(tuning.scale):
        yield f"note: {chaos}, and no run with other steps can match"
