"""Make the summary of a crosscheck, which the terminal shows in about 25 lines of 80 columns."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from crosscheck.compare.check import (
    CONSTRAINT_VIOLATION,
    FILE,
    OF_EQUATIONS,
    OF_RUNS,
    READING,
    REFERENCE,
    START,
    Check,
)
from crosscheck.compare.result import ComparisonResult
from crosscheck.report.log import log_lines
from crosscheck.report.own_run import own_run_lines
from crosscheck.report.table import Cell, Column, Lines, Part, Rows, Table, number_columns, seconds

MAX_NOTES, MAX_NOTES_IF_FAILING = 3, 1
"""Largest number of sentences below the tables; a failing verdict takes more lines itself."""


def summary(result: ComparisonResult, limits: Sequence[str], notes: Sequence[str]) -> list[Part]:
    """Make the parts of the summary: tables of levels and engines, limits of the verdict, notes, advice.

    Args:
        result: result of a crosscheck.
        limits: sentences that limit the verdict, all of which are shown.
        notes: further sentences, of which the first are shown.
    """
    parts: list[Part] = [log_lines(judgement) for judgement in result.logs.values()]
    parts += [own_run_lines(result.own_run)] if result.own_run else []
    parts.append(levels_table(result))
    if result.trajectories:
        parts.append(engines_table(result))
    most = MAX_NOTES_IF_FAILING if result.unfinished or result.differs else MAX_NOTES
    lines = [*limits, *notes[: max(0, most - len(limits))]]
    if lines:
        parts.append(Lines("", lines))
    if result.advice:
        parts.append(Lines("", [f"advice, {advice}" for advice in result.advice]))
    return parts


def judged_figures(result: ComparisonResult) -> list[Check]:
    """Return all checks that are judged, including those against reference values."""
    found = [row for row in result.checks if row.judged]
    for each in result.measured:
        place = f"{each.known.time:g} s"
        found.append(Check(REFERENCE, each.known.quantity, (each.engine,), each.value, each.tolerance, place))
    return found


def levels_table(result: ComparisonResult) -> Table:
    """Make a table with a row per level of checks.

    The columns are the number of passed or failed checks, a column per engine, and the check closest to
    failing. An engine's column has the value of its check closest to failing: a difference from the first
    engine or from the model file, or at levels that check each engine by itself the engine's own value.
    """
    first, *others = [engine.name for engine in result.engines]
    shown_engines = others or [first]
    found = judged_figures(result)
    rows: Rows = []
    for level in (READING, "model", START, *OF_EQUATIONS[1:], *OF_RUNS, REFERENCE):
        at_level = [row for row in found if row.level == level]
        if not at_level:
            continue
        failed = sum(not row.agrees for row in at_level)
        held = Cell(f"{len(at_level)} ok", "holds")
        if failed:
            held = Cell(f"{failed}/{len(at_level)} FAIL", "fails")
        of_each = [
            [row for row in at_level if name in row.between and {*row.between} <= {name, first, FILE}]
            for name in shown_engines
        ]
        rows.append([level.partition(" and ")[0], held, *map(_worst, of_each), nearest(at_level)])
    heads = [Column("worst of"), *number_columns("checks", *shown_engines)]
    return Table("", [*heads, Column("% of tolerance, where")], rows)


def _worst(rows: Sequence[Check]) -> Cell:
    """Make the cell of the check closest to failing; an empty cell if there are no checks."""
    if not rows:
        return Cell("")
    worst = max(rows, key=lambda row: row.tolerance_ratio)
    return Cell(f"{worst.value:.1e}", "" if worst.agrees else "fails")


def nearest(rows: Sequence[Check]) -> Cell:
    """Describe the check closest to failing, such as "12 % rocker, 0.5 s, positions".

    The number is the value in percent of the tolerance, or above 100 % a multiple of the tolerance ("3 x").
    """
    worst = max(rows, key=lambda row: row.tolerance_ratio)
    ratio, (quantity, _, unit) = worst.tolerance_ratio, worst.quantity.rpartition(", ")
    text = f"{100.0 * ratio:.0f} %" if ratio >= 0.01 else "<1 %"
    if ratio > 1.0:
        text = f"{ratio:.0f} x" if 10.0 <= ratio < 1e4 else f"{ratio:.1g} x"
    # all checks of equations are at random states
    where = worst.where.removeprefix("random ").replace(" at ", ", ")
    # the constraint violation is the only quantity of its level, so that its name is left out
    name = "" if worst.quantity == CONSTRAINT_VIOLATION else quantity or unit
    place = ", ".join(filter(None, [where, name]))
    about = worst.where.partition(" at ")[0]
    return Cell(f"{text:>4} {place}", "" if worst.agrees else "fails", about)


def engines_table(result: ComparisonResult) -> Table:
    """Make a table with a row per engine: run time, error and settings, or the time at which it stopped."""
    stopped = {stop.what: stop for stop in result.unfinished}
    rows: Rows = []
    for engine in result.engines:
        run, stop = result.trajectories.get(engine.name), stopped.get(engine.name)
        far = [f"{result.run_errors[engine.name]:.1e}" if engine.name in result.run_errors else ""]
        how = brief_settings(run.settings) if run else ""
        when = "" if stop is None or stop.time is None else f" at {stop.time:.3g} s"
        ended = Cell(f"STOPPED{when}", "fails") if stop else how
        took = seconds(run.wall_time) if run else ""
        rows.append([engine.name, took, *(far if result.run_errors else []), ended])
    heads = [Column(f"{result.scene.duration:g} s of motion"), *number_columns("run time")]
    heads += number_columns("error") if result.run_errors else []
    return Table("", [*heads, Column("settings", below=True)], rows)


def brief_settings(settings: Mapping[str, Any]) -> str:
    """Describe an engine's settings in a line: integrator, step or tolerance, and loop closure method."""
    words = [str(settings.get("integrator", ""))]
    if step := settings.get("timestep", settings.get("step")):
        words[0] += f" {seconds(step)}"
    if "rtol" in settings:
        words[0] += f" rtol {settings['rtol']:g}"
    if "solref" in settings:
        words.append(f"solref {settings['solref'][0]:g} s")
    if "stabilization" in settings:
        words.append(str(settings["stabilization"]))
    if "formulation" in settings:
        words.append(str(settings["formulation"]))
    return ", ".join(words)
