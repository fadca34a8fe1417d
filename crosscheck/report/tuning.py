"""Report of `crosscheck tune`: found settings, their error and cost, and the text to paste into the file.

`crosscheck tune` searches the cheapest settings (time step, integrator, solver) of a model file's engine with
which the error of a run is below a target, such as 0.1 % of the motion or 1 mm.

If the motion of a mechanism is chaotic or unstable, its comparison with the reference solution ends early, at
a time in `SettingsSearch.scale`. `SettingsSearch.events` are elements of the file that act in the run and
that the reference does not simulate, such as contacts.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

from crosscheck.compare.outcome import Verdict
from crosscheck.own_run.allowed import AllowedError, ErrorKind, elements_text, in_unit
from crosscheck.own_run.errors import Band
from crosscheck.own_run.tune import SettingsSearch, Tried
from crosscheck.report.chart import Measure, log_chart
from crosscheck.report.own_run import (
    chaos_text,
    needs_texts,
    percent,
    sizes,
    stiffer_limits_text,
    unsimulated_text,
)
from crosscheck.report.table import Cell, Column, Lines, Part, Report, Rows, Table, number_columns
from crosscheck.support.name_lists import first_names

MIN_GROWTH = 1.1
"""Smallest ratio of an error with the found settings and with those of the file that is reported."""

BAR_UNITS = {
    ErrorKind.RELATIVE: (0.01, "%"),
    ErrorKind.POSITION: (1e-3, "mm"),
    ErrorKind.ROTATION: (math.radians(1.0), "deg"),
    ErrorKind.OPENING: (1e-3, "mm"),
    ErrorKind.LOOP_ANGLE: (math.radians(1.0), "deg"),
    ErrorKind.ENERGY: (0.01, "%"),
}
"""Unit of the bars of the chart: its size in SI units, and its name, by the kind of error."""


def report(name: str, tuning: SettingsSearch) -> Report:
    """Make the report of a search for settings.

    Args:
        name: name of the model.
        tuning: result of the search.
    """
    found = tuning.found  # settings that reach the target; None if none do
    parts: list[Part] = [_table(tuning), Lines("", list(_notes(tuning)))]
    if found is not None and found.changes:
        parts.append(Lines(f"paste into {tuning.settings_place}", found.fragment.splitlines()))
    target = tuning.target
    title = f"{name}: settings of {tuning.engine} for an error of {target.text}"
    judged = Cell("", "holds" if found else "fails")
    # the report is short: its summary, which the terminal always shows, has all parts
    scale, unit = BAR_UNITS[target.kind]
    errors = [
        Measure(
            label,
            tried.measured(target) / scale,
            "diverged" if tried.stopped else in_unit(tried.measured(target), target.kind),
            target.largest / scale,
            "holds" if tried.reaches(target) else "fails",
        )
        for label, tried in [
            ("your settings", tuning.own),
            *((_settings(each), each) for each in tuning.tradeoff),
        ]
    ]
    of_what = "in % of the motion" if target.kind is ErrorKind.RELATIVE else f"({target.kind}, {unit})"
    caption = f"Error of each run {of_what}, from cheap to accurate; the mark is your target"
    return Report(
        title,
        _verdict(tuning),
        judged,
        parts,
        summary=parts,
        charts=log_chart("Errors", caption, errors, unit),
        next_steps=_next_steps(tuning),
    )


def _next_steps(tuning: SettingsSearch) -> list[str]:
    """List what the reader can do with the settings."""
    if tuning.found is None and tuning.has_converged:
        return ["Find the rest of the error: `crosscheck run` lists its causes."]
    if tuning.found is None:
        return ["Allow a larger error with `--error`, or a shorter run with `--set duration=SECONDS`."]
    if not tuning.found.changes:
        return ["Keep your settings: no cheaper ones reach the error."]
    return [
        f"Paste the text below into {tuning.settings_place}.",
        "Then run `crosscheck run` with the changed file to confirm the error.",
    ]


def _verdict(tuning: SettingsSearch) -> str:
    """Format the found settings; if there are none, the smallest error of all tried settings, and why."""
    found, target = tuning.found, tuning.target
    # the verdict is on the run of the file as it stands, or names what the run is without
    which = ""
    if tuning.until is not None:
        which = f" until {tuning.until:.3g} s"
    elif tuning.events:
        which = f" without {elements_text(tuning.events)}"
    if found is None:
        best = min(tuning.tradeoff, key=lambda tried: tried.measured(target), default=None)
        reached = "every run diverged" if best is None else f"the smallest error is {_error(best, target)}"
        reason = "; smaller steps do not reduce it" if tuning.has_converged else ""
        if tuning.has_converged and tuning.approximated:
            names = first_names(tuning.approximated, most=1)
            reason += f", because {names} as forces differ from constraints"
            if tuning.stiffer_limits:
                reason += f"; {stiffer_limits_text(tuning.stiffer_limits)}"
        return f"NOT REACHED{which}: {reached}, of {tuning.runs} runs{reason}"
    return f"REACHED{which}: {_settings(found)}: {_error(found, target)}, {_cost(found, tuning.own)}"


def _settings(tried: Tried) -> str:
    """Format settings by their differences from those of the file."""
    return tried.text or "the settings of the file"


def _error(tried: Tried, target: AllowedError) -> str:
    """Format the error of a run as a length, an angle or both, and as a part of the motion."""
    error = tried.error
    if tried.stopped:
        return "diverged"
    found = f"{sizes(error)}, {percent(error.relative)} of the motion"
    of_target = in_unit(tried.measured(target), target.kind)
    if target.kind is ErrorKind.RELATIVE or of_target in found:
        return found
    return f"{target.kind} {of_target} ({found})"


def _cost(tried: Tried, of_file: Tried) -> str:
    """Format the cost of settings (evaluations of the equations of motion) relative to those of the file."""
    ratio = tried.evaluations / of_file.evaluations
    if ratio == 1.0:
        return "the same number of evaluations as your settings"
    return f"{ratio:.3g} times the evaluations of your settings"


def _table(tuning: SettingsSearch) -> Table:
    """Make the table of the file's settings, and of settings with smaller errors than all cheaper ones."""

    target = tuning.target

    def row(settings: str, tried: Tried) -> list[str | Cell]:
        verdict: Verdict = "holds" if tried.reaches(target) else ""
        value = in_unit(tried.measured(target), target.kind)
        if target.kind is ErrorKind.RELATIVE:
            value = percent(tried.error.relative).removesuffix(" %")
        error = "diverged" if tried.stopped else value
        evaluations = f"{tried.evaluations / tuning.own.evaluations:.3g}"
        # relative to the settings of the file; None if the run was not timed
        run_time = "" if tried.run_time is None else f"{tried.run_time:.2g}"
        return [settings, Cell(error, verdict), evaluations, run_time]

    name = "error, %" if target.kind is ErrorKind.RELATIVE else f"error ({target.kind})"
    columns = [Column("settings"), *number_columns(name, "evaluations", "run time")]
    rows: Rows = [row(f"yours: {tuning.settings}", tuning.own)]
    rows += [row(_settings(tried), tried) for tried in tuning.tradeoff]
    return Table(
        "your settings, then others from cheap to accurate; costs are relative to yours", columns, rows
    )


def _notes(tuning: SettingsSearch) -> Iterator[str]:
    """Yield how the settings were found, and the limits of the result."""
    yield f"{tuning.runs} runs, the cheapest settings first, by evaluations of the equations of motion"
    if tuning.events and tuning.until is not None:
        yield f"note: compared until then: {unsimulated_text(tuning.events)}"
    elif tuning.events:
        yield f"note: all runs are without {unsimulated_text(tuning.events)}"
    yield from (f"note: {text}" for text in needs_texts(tuning.needs))
    if (found := tuning.found) is not None:
        yield from (f"note: {text}" for text in _warnings(tuning, found))
    if chaos := chaos_text(tuning.scale):
        yield f"note: {chaos}, and no run with other steps can match"


def _warnings(tuning: SettingsSearch, found: Tried) -> Iterator[str]:
    """Warn of an error that is large for the motion, and of other errors that become larger."""
    if tuning.target.kind is not ErrorKind.RELATIVE and found.error.band is Band.WRONG:
        share = percent(found.error.relative)
        yield f"{share} of the motion is much: `crosscheck run` reports {Band.WRONG} BY from 1 % on"
    if tuning.own.stopped:
        return
    larger = []
    for kind in (ErrorKind.OPENING, ErrorKind.LOOP_ANGLE, ErrorKind.ENERGY):
        own, new = (kind.measured_in(each.error, each.loop_error) for each in (tuning.own, found))
        if new > MIN_GROWTH * own:
            larger.append(f"{kind} {in_unit(new, kind)}, yours {in_unit(own, kind)}")
    if larger:
        yield f"larger errors than with your settings: {'; '.join(larger)}"
