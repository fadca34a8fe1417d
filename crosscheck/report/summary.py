"""Make the summary of a crosscheck, which the terminal shows in about 25 lines of 80 columns.

A crosscheck simulates one model in several engines (simulators) and compares them by checks: values with
tolerances, grouped in levels from the model to whole runs. In: the result. Out: parts of a report, with a
table of the levels and a table of the engines.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from crosscheck.compare.check import (
    CONSTRAINT_VIOLATION,
    FILE,
    LEVELS,
    REFERENCE,
    Check,
)
from crosscheck.compare.note import Note
from crosscheck.compare.result import EngineComparison
from crosscheck.own_run.allowed import OWN_RUN
from crosscheck.report.line_name import LineName
from crosscheck.report.log import log_lines
from crosscheck.report.own_run import own_run_lines
from crosscheck.report.table import Cell, Column, Lines, Part, Rows, Table, number_columns, seconds
from newton_euler.model.scene import Scene
from newton_euler.reading.import_report import ImportReport

MAX_NOTES, MAX_NOTES_IF_FAILING = 3, 1
"""Largest number of sentences below the tables; a failing verdict takes more lines itself."""

NO_PART = "-"
"""Text of a cell for an engine that takes part in no check of the level."""

START_DIGITS = 1e-5
"""Largest change of the start, rad or multiples of the mechanism's size, that is not reported: numbers in
model files have about five digits, so that kinematic loops do not close exactly."""


def summary(result: EngineComparison, limits: Sequence[str], notes: Sequence[str]) -> list[Part]:
    """Make the parts of the summary: tables of levels and engines, limits of the verdict, notes, advice.

    Args:
        result: result of a crosscheck.
        limits: sentences that limit the verdict, all of which are shown.
        notes: further sentences, of which the first are shown.
    """
    parts: list[Part] = [*judged_runs(result), levels_table(result)]
    if result.trajectories:
        parts.append(engines_table(result))
    max_notes = MAX_NOTES_IF_FAILING if result.unfinished or result.differs else MAX_NOTES
    lines = [*limits, *notes[: max(0, max_notes - len(limits))]]
    if lines:
        parts.append(Lines("", lines))
    if result.advice:
        parts.append(Lines("", [f"{Note.ADVICE}, {advice}" for advice in result.advice]))
    return parts


def judged_runs(result: EngineComparison) -> list[Part]:
    """Format the judgements of other simulators' logs, and of the run with the settings of the model file."""
    parts: list[Part] = [
        log_lines(judgement, result.limits_of(name)) for name, judgement in result.logs.items()
    ]
    if result.own_run:
        # the line of the import report (`mapping`) on inputs and velocities that the file does not have
        excitation = result.mapping.excitation if result.mapping else ""
        changes = _start_changes(result.mapping, result.scene) if result.mapping else []
        own_run = own_run_lines(result.own_run, excitation, result.limits_of(OWN_RUN), changes)
        if result.logs and result.allowed_errors:
            own_run[0].lines.append(LineName.NOTE.line("--max-error limits the logs, not this run"))
        parts += own_run
    return parts


def _start_changes(mapping: ImportReport, scene: Scene) -> list[str]:
    """List the changes of the file's start that satisfy the constraints."""
    changes = ["loops closed"] if are_loops_closed(mapping, scene) else []
    if are_velocities_changed(mapping):
        changes.append("velocities changed to fit the constraints")
    return changes


def are_velocities_changed(mapping: ImportReport) -> bool:
    """Return True if velocities of the file's start were changed noticeably to satisfy the constraints."""
    changed = mapping.changed_velocities
    return changed is not None and changed.share > START_DIGITS


def are_loops_closed(mapping: ImportReport, scene: Scene) -> bool:
    """Return True if the file's start was moved noticeably to close the loops."""
    moved = mapping.moved
    if moved is None:
        return False
    return max(moved.displacement / scene.mechanism.size, abs(moved.joint_motion)) > START_DIGITS


def judged_checks(result: EngineComparison) -> list[Check]:
    """Return all checks that are judged, including those against reference values."""
    checks = [check for check in result.checks if check.judged]
    for each in result.reference_checks:
        where = f"{each.known.time:g} s"  # without the engine
        quantity = each.known.quantity
        checks.append(Check(REFERENCE, quantity, (each.engine,), each.value, each.tolerance, where))
    return checks


def levels_table(result: EngineComparison) -> Table:
    """Make a table with a row per level of checks.

    The columns are the number of passed or failed checks, a column per engine, and the check closest to
    failing. An engine's column has the value of its check closest to failing: a difference from the first
    engine that is compared by equations or from the model file, or at levels that check each engine by itself
    the engine's own value. `NO_PART` stands for an engine without a check at the level.
    """
    names = [engine.name for engine in result.engines]
    first = next((name for name in names if name not in result.by_runs_only), names[0])
    shown_engines = [name for name in names if name != first] or [first]
    checks = judged_checks(result)
    rows: Rows = []
    for level in (*LEVELS, REFERENCE):
        at_level = [check for check in checks if check.level == level]
        if not at_level:
            continue
        failed = sum(not check.agrees for check in at_level)
        count = Cell(f"{len(at_level)} ok", "holds")
        if failed:
            count = Cell(f"{failed}/{len(at_level)} FAIL", "fails")
        of_each_engine = [
            NO_PART
            if level in result.participation[name].no_part_in
            else _worst_value([check for check in at_level if _is_shown(check, name, first)])
            for name in shown_engines
        ]
        # "accelerations and reactions" is shown as "accelerations"
        short_level = level.partition(" and ")[0]
        rows.append([short_level, count, *of_each_engine, nearest(at_level)])
    headings = [Column("worst of"), *number_columns("checks", *shown_engines)]
    return Table("", [*headings, Column("% of tolerance, where", below=True)], rows)


def _is_shown(check: Check, name: str, first: str) -> bool:
    """Return True if a check compares an engine with the first one or with the file, or is of it alone."""
    return name in check.between and {*check.between} <= {name, first, FILE}


def _worst_value(checks: Sequence[Check]) -> Cell:
    """Make the cell with the value of the check closest to failing; empty if there are no checks."""
    if not checks:
        return Cell("")
    worst = max(checks, key=lambda check: check.tolerance_ratio)
    return Cell(f"{worst.value:.1e}", "" if worst.agrees else "fails")


def nearest(checks: Sequence[Check]) -> Cell:
    """Describe the check closest to failing, such as "12 % rocker, 0.5 s, positions".

    The number is the value in percent of the tolerance, or above 100 % a multiple of the tolerance ("3 x").
    """
    worst = max(checks, key=lambda check: check.tolerance_ratio)
    ratio = worst.tolerance_ratio
    quantity, _, unit = worst.quantity.rpartition(", ")  # a quantity without a unit becomes `unit`
    text = f"{100.0 * ratio:.0f} %" if ratio >= 0.01 else "<1 %"
    if ratio > 1.0:
        text = f"{ratio:.0f} x" if 10.0 <= ratio < 1e4 else f"{ratio:.1g} x"
    # all checks of equations are at random states
    where = worst.where.removeprefix("random ").replace(" at ", ", ")
    # the constraint violation is the only quantity of its level, so that its name is left out
    name = "" if worst.quantity == CONSTRAINT_VIOLATION else quantity or unit
    place = ", ".join(filter(None, [where, name]))
    about = worst.where.partition(" at ")[0]  # the body or joint, without the time
    return Cell(f"{text:>4} {place}", "" if worst.agrees else "fails", about=about)


def engines_table(result: EngineComparison) -> Table:
    """Make a table with a row per engine: run time, error and settings, or the time at which it stopped.

    The error is the largest deviation from a reference run, m or rad.
    """
    stopped = {stop.what: stop for stop in result.unfinished}
    errors = result.run_errors
    rows: Rows = []
    for engine in result.engines:
        run, stop = result.trajectories.get(engine.name), stopped.get(engine.name)
        error = f"{errors[engine.name]:.1e}" if engine.name in errors else ""
        settings = brief_settings(run.settings) if run else ""
        when = "" if stop is None or stop.time is None else f" at {stop.time:.3g} s"
        settings_or_stop = Cell(f"STOPPED{when}", "fails") if stop else settings
        run_time = seconds(run.wall_time) if run else ""
        rows.append([engine.name, run_time, *([error] if errors else []), settings_or_stop])
    headings = [Column(f"{result.scene.duration:g} s of motion"), *number_columns("run time")]
    headings += number_columns("error") if errors else []
    return Table("", [*headings, Column("settings", below=True)], rows)


def brief_settings(settings: Mapping[str, Any]) -> str:
    """Describe an engine's settings in a line: integrator, step or tolerance, and loop closure method."""
    integrator = str(settings.get("integrator", ""))
    if step := settings.get("timestep", settings.get("step")):
        integrator += f" {seconds(step)}"
    if "rtol" in settings:
        integrator += f" rtol {settings['rtol']:g}"
    texts = [integrator]
    if "solref" in settings:  # MuJoCo's time constant and damping ratio of constraints
        texts.append(f"solref {settings['solref'][0]:g} s")
    if "stabilization" in settings:
        texts.append(str(settings["stabilization"]))
    if "formulation" in settings:
        texts.append(str(settings["formulation"]))
    return ", ".join(texts)
