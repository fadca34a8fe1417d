"""The summary of a crosscheck: what is printed in about 25 lines of 80 columns unless more is asked for."""

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
from crosscheck.compare.crosscheck import Crosscheck
from crosscheck.report.own_run import own_run_lines
from crosscheck.report.table import Cell, Column, Lines, Part, Rows, Table, figures, seconds

MAX_NOTES, MAX_NOTES_IF_FAILING = 3, 1
"""Sentences below the tables. A verdict that fails takes more lines itself."""


def summary(result: Crosscheck, limits: Sequence[str], notes: Sequence[str]) -> list[Part]:
    """Make the tables of levels and engines, all that limits the verdict, the first notes, and all advice."""
    parts: list[Part] = [own_run_lines(result.own_run)] if result.own_run else []
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


def judged_figures(result: Crosscheck) -> list[Check]:
    """All figures with a tolerance, those against the reference among them."""
    found = [row for row in result.checks if row.judged]
    for each in result.measured:
        place = f"{each.known.time:g} s"
        found.append(Check(REFERENCE, each.known.quantity, (each.engine,), each.value, each.tolerance, place))
    return found


def levels_table(result: Crosscheck) -> Table:
    """Make a row per level: how many checks hold, each engine's worst, and the one nearest its tolerance.

    Beside an engine stands its worst difference from the first engine, or at levels of single engines its own
    figure. What is nearest its tolerance may be between any two.
    """
    first, *others = [engine.name for engine in result.engines]
    columns = others or [first]
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
            for name in columns
        ]
        rows.append([level.partition(" and ")[0], held, *map(_worst, of_each), nearest(at_level)])
    heads = [Column("worst of"), *figures("checks", *columns)]
    return Table("", [*heads, Column("% of tolerance, where")], rows)


def _worst(rows: Sequence[Check]) -> Cell:
    if not rows:
        return Cell("")
    worst = max(rows, key=lambda row: row.tolerance_ratio)
    return Cell(f"{worst.value:.1e}", "" if worst.agrees else "fails")


def nearest(rows: Sequence[Check]) -> Cell:
    """Word the check that is nearest its tolerance or exceeds it most."""
    worst = max(rows, key=lambda row: row.tolerance_ratio)
    share, (quantity, _, unit) = worst.tolerance_ratio, worst.quantity.rpartition(", ")
    text = f"{100.0 * share:.0f} %" if share >= 0.01 else "<1 %"
    if share > 1.0:
        text = f"{share:.0f} x" if 10.0 <= share < 1e4 else f"{share:.1g} x"
    # random as all states are at which equations are compared
    where = worst.where.removeprefix("random ").replace(" at ", ", ")
    words = "" if worst.quantity == CONSTRAINT_VIOLATION else quantity or unit  # drift is of little else
    place = ", ".join(filter(None, [where, words]))
    about = worst.where.partition(" at ")[0]
    return Cell(f"{text:>4} {place}", "" if worst.agrees else "fails", about)


def engines_table(result: Crosscheck) -> Table:
    """Make a row per engine: run time, distance from the finest run, method; or when it stopped."""
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
    heads = [Column(f"{result.scene.duration:g} s of motion"), *figures("run time")]
    heads += figures("error") if result.run_errors else []
    return Table("", [*heads, Column("settings", below=True)], rows)


def brief_settings(settings: Mapping[str, Any]) -> str:
    """Word an engine's method, its tolerance or step, and what keeps its loops closed."""
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
