"""The figures of a crosscheck as tables for the terminal and as markdown."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.table import Table
from rich.text import Text

from crosscheck.advice.measured import distance
from crosscheck.comparison.known_figures import Measured
from crosscheck.comparison.levels import Row, not_compared
from crosscheck.comparison.reactions import undetermined_joints
from crosscheck.comparison.rows import FILE, NOT_NEARER
from crosscheck.comparison.runs import displacements
from crosscheck.comparison.samples import admissible_basis, body_units
from crosscheck.model_files.read import report_lines
from crosscheck.run import Crosscheck
from crosscheck.stiffness import explicit_steps, fastest_decay
from newton_euler.assemble import initial_state
from newton_euler.equations.redundancy import mobility
from newton_euler.equations.relative import Relative
from newton_euler.integrators.stabilize import RK4_LIMIT
from newton_euler.model.scene import Scene
from newton_euler.verification.import_report import ImportReport

MOST_NAMED = 12
"""Elements in one line."""

IMPLICIT = ("Radau", "implicitfast")
"""Integrators that engines take for stiff scenes by themselves."""


def terminal_tables(result: Crosscheck) -> Iterator[Table]:
    """Figures of engines against a model file, of pairs of engines, of each by itself, and of its systems."""
    titles = {
        "file": f"each engine against {result.title} as its file's own reader has it",
        "pairs": f"{result.title}: {result.scene.description}",
        "single": "each engine by itself",
        "within": "two equations of motion of one engine",
    }
    engines = {engine.name for engine in result.engines}
    for part, title in titles.items():
        rows = [row for row in result.rows if _part(row, engines) == part]
        if rows:
            yield _table(title, rows)
    if result.measured:
        yield _measured_table(result.measured)


def _measured_table(measured: Sequence[Measured]) -> Table:
    """A line for each known figure: the value of the first engine, the reference, a cell for each engine."""
    columns = list(dict.fromkeys(found.engine for found in measured))
    title = Text("figures against the reference", style="bold")
    table = Table(title=title, title_justify="left", box=SIMPLE_HEAD, pad_edge=False)
    table.add_column("")
    table.add_column("time, s", justify="right")
    for name in (f"value, {columns[0]}", "reference", *columns):
        table.add_column(name, justify="right", no_wrap=True)
    for known in dict.fromkeys(id(found.known) for found in measured):
        cells = {found.engine: found for found in measured if id(found.known) == known}
        first = cells[columns[0]]
        table.add_row(
            f"{first.known.quantity}, {first.known.unit}",
            f"{first.known.time:g}",
            f"{first.value:.12g}",
            f"{first.known.value:.12g}",
            *(judged(cells[name].difference, cells[name].allowed, cells[name].agrees) for name in columns),
        )
    return table


def _part(row: Row, engines: set[str]) -> str:
    if len(row.between) == 1:
        return "single"
    if FILE in row.between:
        return "file"
    return "pairs" if set(row.between) <= engines else "within"


def _table(title: str, rows: list[Row]) -> Table:
    """A line for each quantity, a column for each pair or engine, a section for each level."""
    columns = list(dict.fromkeys(row.between for row in rows))
    heading = Text(title, style="bold")
    table = Table(title=heading, title_justify="left", box=SIMPLE_HEAD, pad_edge=False)
    table.add_column("")
    for between in columns:
        table.add_column("\n".join(between), justify="right", no_wrap=True)
    for level in dict.fromkeys(row.level for row in rows):
        table.add_section()
        table.add_row(Text(level, style="bold"))
        at_level = [row for row in rows if row.level == level]
        for quantity in dict.fromkeys(row.quantity for row in at_level):
            cells = {row.between: _cell(row) for row in at_level if row.quantity == quantity}
            table.add_row(f"  {quantity}", *(cells.get(between, "") for between in columns))
    return table


def _cell(row: Row) -> Text:
    if row.informs:
        return Text(f"{row.value:.1e}{' not judged' if row.unsettled else ''}")
    return judged(row.value, row.tolerance, row.agrees)


def judged(value: float, allowed: float, agrees: bool) -> Text:
    """A figure beside what it may be at most."""
    text = f"{value:.1e} {'<' if value <= allowed else '>'} {allowed:.0e}"
    return Text(text, style="green" if agrees else "bold red")


def settings_lines(result: Crosscheck) -> Iterator[str]:
    """What each engine ran with and how long, or why it did not run; reactions not unique; advice."""
    for name, run in result.runs.items():
        settings = ", ".join(f"{key} {_short(value)}" for key, value in run.settings.items())
        yield f"{name}: {settings}; {run.wall_time:.2g} s"
    yield from (f"not finished, {stop}" for stop in result.unfinished)
    for name, reason in result.left_out.items():
        yield f"{name}: left out: {reason}"
    implicit = [name for name, run in result.runs.items() if run.settings.get("integrator") in IMPLICIT]
    if implicit:
        rate, steps = fastest_decay(result.scene), explicit_steps(result.scene)
        fixed = f" and RK4 a step of {RK4_LIMIT / rate:.2g} s" if "mujoco" in implicit and rate else ""
        yield (
            f"stiff: motions die out at {rate:.2g} 1/s at the start, for which DOP853 would need {steps:.0f} "
            f"steps{fixed} to be stable; an implicit method in {', '.join(implicit)}"
        )
    if result.mapping and result.runs:
        yield _start_line(result)
        yield from _activity_lines(result.mapping)
    if result.rests:
        yield _rest_line(result)
    count, joints = undetermined_joints(result.scene, initial_state(result.scene))
    if count:
        rows = "a redundant row" if count == 1 else f"{count} redundant rows"
        yield f"reactions not unique: {rows} at joints {', '.join(joints)}; each engine has its own"
    yield from redundancy_lines(result.scene)
    if result.coverage and result.coverage.untested:
        names = [covered.element for covered in result.coverage.untested]
        more = f" and {len(names) - MOST_NAMED} more" if len(names) > MOST_NAMED else ""
        yield f"untested by the motion, 10 % more would not show: {', '.join(names[:MOST_NAMED])}{more}"
    yield from not_compared(result.rows)
    yield from (f"advice, {advice}" for advice in result.advice)


def redundancy_lines(scene: Scene) -> Iterator[str]:
    """Constraints that are almost redundant, how they are taken, and what takes them otherwise."""
    decided = mobility(scene)
    for weak in decided.nearly:
        if weak.taken == "redundant":
            other = "redundancy_tolerance=0 takes it literally"
        else:
            other = f"redundancy_tolerance={2.0 * weak.singular_value:.0e} takes it as redundant"
        yield f"nearly redundant, {weak}; {other}"
    if decided.nearly and decided.degrees_of_freedom == 0:
        yield "the mechanism has no degree of freedom"


def _activity_lines(mapping: ImportReport) -> Iterator[str]:
    """Which of the limits, contacts and dry friction that were left out did nothing in the run."""
    watched = {number: mapping.entries[number] for number in mapping.watches}
    inactive = [entry for entry in watched.values() if entry.fate == "inactive"]
    for entry in watched.values():
        if entry.fate != "inactive":
            yield f"active, and left out: {entry.element}: {entry.how}"
    if inactive:
        texts = "; ".join(f"{entry.element}: {entry.how}" for entry in inactive)
        yield f"inactive in this run, {len(inactive)} of {len(watched)} watched: {texts}"


def _start_line(result: Crosscheck) -> str:
    """What each engine starts from: the same pose, closed as far as its own run says at its first output."""
    names = list(result.runs)
    runs = list(result.runs.values())
    apart = max((distance(runs[0], run, at=0) for run in runs[1:]), default=0.0)
    gaps = ", ".join(
        f"{name} {np.max(run.constraint_violation[0]):.1e}"
        for name, run in zip(names, runs, strict=True)
        if run.constraint_violation is not None
    )
    same = f"the same pose to {apart:.1e} (m, rad); " if len(runs) > 1 else ""
    return f"start: {same}joints open there by at most (m, rad): {gaps}"


def _rest_line(result: Crosscheck) -> str:
    """That nothing moves, why as far as the constraints tell, and what that leaves untested."""
    moved = ", ".join(f"{name} {far:.1e}" for name, far in displacements(result.runs).items())
    system = Relative(result.scene)
    q, _ = system.coordinates(initial_state(result.scene))
    basis, _ = admissible_basis(system, q, body_units(result.scene))
    why = "it starts at rest in equilibrium" if basis.shape[1] else "the mechanism has no freedom"
    return (
        f"nothing moves: {why}, bodies get from where they start by at most (m, rad): {moved}; "
        "trajectories and energies test nothing here, and no advice is drawn from them"
    )


def _short(value: object) -> object:
    """A setting with as many digits as people read."""
    return f"{value:.3g}" if isinstance(value, float) else value


def markdown(result: Crosscheck) -> str:
    """The verdict, the settings of the engines and all figures, a line each."""
    lines = [f"# {result.title}", "", f"**{result.verdict}**", ""]
    lines += [f"- {line}" for line in settings_lines(result)]
    if result.mapping:
        lines += [
            "",
            "## carried over from the file",
            "",
            *(f"- {line}" for line in report_lines(result.mapping)),
        ]
    level = ""
    for row in result.rows:
        if row.level != level:
            level = row.level
            lines += [
                "",
                f"## {level}",
                "",
                "| figure | between | value | at most | verdict | worst at |",
                "|---|---|---|---|---|---|",
            ]
        verdict = "for information" if row.informs else "holds" if row.agrees else "**FAILS**"
        if row.unsettled:
            verdict = f"not judged: {row.unsettled} is {NOT_NEARER}"
        lines.append(
            f"| {row.quantity} | {', '.join(row.between)} | {row.value:.1e} | {row.tolerance:.0e} "
            f"| {verdict} | {row.where} |"
        )
    if result.measured:
        lines += [
            "",
            "## against the reference",
            "",
            "| figure | time, s | engine | value | reference | difference | allowed | verdict |",
            "|---|---|---|---|---|---|---|---|",
        ]
    for found in result.measured:
        known = found.known
        lines.append(
            f"| {known.quantity}, {known.unit} | {known.time:g} | {found.engine} | {found.value:.15g} "
            f"| {known.value:.15g} | {found.difference:.1e} | {found.allowed:.1e} "
            f"| {'holds' if found.agrees else '**FAILS**'} |"
        )
    return "\n".join(lines) + "\n"
