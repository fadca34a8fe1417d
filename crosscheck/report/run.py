"""The report of a crosscheck: figures, settings, advice."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from crosscheck.compare.activity import acted
from crosscheck.compare.check import FILE, Check, not_compared, unconverged_reason
from crosscheck.compare.coverage import Coverage
from crosscheck.compare.crosscheck import Crosscheck
from crosscheck.compare.reference_values import ReferenceCheck
from crosscheck.compare.runs import displacements
from crosscheck.compare.samples import admissible_basis, body_units
from crosscheck.compare.two_models.compare import TwoModelComparison
from crosscheck.engines.stiffness import explicit_steps, fastest_decay
from crosscheck.loading.model_files import fates_line, report_lines
from crosscheck.report.own_run import own_run_lines
from crosscheck.report.summary import summary
from crosscheck.report.table import (
    Cell,
    Column,
    Lines,
    Part,
    Report,
    Rows,
    Table,
    entries,
    figures,
    judged,
    texts,
)
from newton_euler.equations.redundancy import mobility
from newton_euler.equations.relative import Relative
from newton_euler.equations.undetermined import redundancy_text, undetermined_joints
from newton_euler.integrators.fixed_step import RK4_LIMIT
from newton_euler.model.scene import Scene
from newton_euler.model.trajectory import distance
from newton_euler.reading.import_report import ImportReport
from newton_euler.runs.assemble import initial_state

MOST_NAMED = 12
"""Elements in one line."""

ALL_LISTED = "all in summary.json and on the page of `crosscheck report`"
"""Text on where all untested elements are listed."""

SAME_CODE = "as all engines call the same code"
"""Why controllers are untested, whatever the motion."""

MOST_ACTING_LINES = 3
"""Elements that act and are not simulated, a line each; more are named in one line."""

START_DIGITS = 1e-5
"""Share of the mechanism's size, or rad, that the digits of a file may leave its loops open at the start."""

IMPLICIT = ("Radau", "implicitfast")
"""Integrators that engines take for stiff scenes by themselves."""


def report(result: Crosscheck) -> Report:
    """All that a crosscheck found."""
    limits, others = list(limiting(result)), list(notes(result))
    said = [*limits, *others]
    parts: list[Part] = [own_run_lines(result.own_run)] if result.own_run else []
    parts.extend(tables(result))
    parts.append(Lines("", [*said, *(f"advice, {advice}" for advice in result.advice)]))
    parts.append(entries("settings and run times", dict(_settings(result))))
    if result.coverage and result.coverage.untested:
        parts.append(_untested_table(result.coverage))
    for title, mapping in _mappings(result):
        parts.append(Lines(f"carried over from {title}", list(report_lines(mapping)), folded=True))
    named = ("scene", "source", "options", "models", "left_out", "versions")
    found = result.summary()
    parts.append(
        entries("scene and versions", {name: found[name] for name in named if found.get(name)}, folded=True)
    )
    title = ": ".join(filter(None, [result.title, result.scene.description]))
    brief = summary(result, limits, others)
    return Report(title, result.verdict, judged_word(result), parts, result.wall_time, brief)


def _mappings(result: Crosscheck) -> Iterator[tuple[str, ImportReport]]:
    """Import reports of the model files, each after its file's title."""
    models = result.models if isinstance(result, TwoModelComparison) else []
    if result.mapping and not models:
        yield "the file", result.mapping
    yield from ((f"the file of {model.name}", model.mapping) for model in models if model.mapping)


def judged_word(result: Crosscheck) -> Cell:
    """The verdict in one word."""
    return Cell(result.outcome.value, result.outcome.judged)


def _untested_table(found: Coverage) -> Table:
    """A row per element that the motion does not test, with how much of a change of it shows."""
    rows: Rows = [
        [each.element, SAME_CODE if each.shared else f"{each.effect:.1e}"] for each in found.untested
    ]
    title = "untested by the motion: 10 % more of these does not show"
    return Table(title, [Column("element"), *figures("effect (detectable above 1)")], rows, folded=True)


def tables(result: Crosscheck) -> Iterator[Table]:
    """Figures of engines against a model file, of pairs of engines, of each by itself, and of its systems."""
    titles = {
        "file": f"each engine against {result.title} as its file's own reader has it",
        "pairs": "engines compared",
        "single": "each engine by itself",
        "within": "two equations of motion of one engine",
    }
    engines = {engine.name for engine in result.engines}
    for part, title in titles.items():
        rows = [row for row in result.checks if _part(row, engines) == part]
        if rows:
            yield _table(title, rows)
    if result.measured:
        yield _measured_table(result.measured)
    failed = [row for row in result.checks if not row.agrees]
    if len(failed) > 1:
        yield Table(
            "where they part",
            texts("level", "quantity", "between", "worst at"),
            [[row.level, row.quantity, ", ".join(row.between), row.place] for row in failed],
        )


def _part(row: Check, engines: set[str]) -> str:
    if len(row.between) == 1:
        return "single"
    if FILE in row.between:
        return "file"
    return "pairs" if set(row.between) <= engines else "within"


def _table(title: str, rows: list[Check]) -> Table:
    """A row per quantity, a column per pair or engine, a section per level."""
    columns = list(dict.fromkeys(row.between for row in rows))
    lines: Rows = []
    for level in dict.fromkeys(row.level for row in rows):
        lines.append(level)
        at_level = [row for row in rows if row.level == level]
        for quantity in dict.fromkeys(row.quantity for row in at_level):
            cells = {row.between: _cell(row) for row in at_level if row.quantity == quantity}
            lines.append([quantity, *(cells.get(between, "") for between in columns)])
    heads = [Column("\n".join(between), numeric=True) for between in columns]
    return Table(title, [Column(""), *heads], lines)


def _cell(row: Check) -> Cell:
    about = f"worst at {row.where}"
    if row.unconverged:
        return Cell(f"{row.value:.1e} not judged", "", f"{unconverged_reason([row.unconverged])}; {about}")
    if not row.judged:
        return Cell(f"{row.value:.1e}", "", about)
    return judged(row.value, row.tolerance, row.agrees, about)


def _measured_table(measured: Sequence[ReferenceCheck]) -> Table:
    """A section per time, a row per reference value: first engine's value, reference, a cell per engine."""
    columns = list(dict.fromkeys(found.engine for found in measured))
    rows: Rows = []
    for time in dict.fromkeys(found.known.time for found in measured):
        rows.append(f"at {time:g} s")
        now = [found for found in measured if found.known.time == time]
        for known in dict.fromkeys(id(found.known) for found in now):
            cells = {found.engine: found for found in now if id(found.known) == known}
            first = cells[columns[0]]
            label = f"{first.known.quantity}, {first.known.unit}"
            values = [f"{first.result:.12g}", f"{first.known.value:.12g}"]
            mine = [cells[name] for name in columns]
            rows.append([label, *values, *(judged(each.value, each.tolerance, each.agrees) for each in mine)])
    heads = [Column(f"value,\n{columns[0]}", numeric=True), *figures("reference")]
    heads += [Column(name, numeric=True) for name in columns]
    return Table("reference values", [Column(""), *heads], rows)


def _settings(result: Crosscheck) -> Iterator[tuple[str, str]]:
    """Each engine with its settings and run time."""
    for name, run in result.trajectories.items():
        settings = ", ".join(f"{key} {_short(value)}" for key, value in run.settings.items())
        yield name, f"{settings}; {run.wall_time:.2g} s"


def limiting(result: Crosscheck) -> Iterator[str]:
    """Word what limits the verdict, a line each: stopped parts, another start, what was not simulated."""
    yield from result.notes
    if result.singular:
        yield str(result.singular)
    for _, read in _mappings(result):
        yield from (f"finding, {finding}" for finding in read.findings)
    if isinstance(result, TwoModelComparison):
        for model in result.models:
            lines = moved_start_lines(model.mapping, model.scene) if model.mapping else ()
            yield from (f"{model.name}: {line}" for line in lines)
        return
    mapping = result.mapping
    if mapping is None:
        return
    yield from moved_start_lines(mapping, result.scene)
    acting = mapping.acting
    for entry in acting[:MOST_ACTING_LINES]:
        yield f"active, and left out: {entry.element}: {'; '.join(filter(None, [entry.seen, entry.how]))}"
    if more := [acted(entry) for entry in acting[MOST_ACTING_LINES:]]:
        yield f"active, and left out, too: {_named(more)}"
    if result.until and any(line.startswith("excited") for line in mapping.start):
        yield (
            f"the excitation may be the cause of what acts from {result.until:.4g} s on; "
            "--set excitation=off runs the file without it"
        )
    if unknown := [entry for entry in mapping.entries if not entry.examined]:
        yield "not examined whether they act: " + "; ".join(f"{e.element}: {e.how}" for e in unknown)


def moved_start_lines(mapping: ImportReport, scene: Scene) -> Iterator[str]:
    """Word how far the start is from the file's, if constraints change it by more than the file's digits."""
    changed = mapping.changed_velocities
    if changed and changed.share > START_DIGITS:
        yield (
            f"the start is not the file's: velocities of {changed.start} do not fit the constraints; they "
            f"are changed by up to {changed.linear:.3g} m/s and {changed.angular:.3g} rad/s"
        )
    moved = mapping.moved
    if moved is None:
        return
    share = max(moved.displacement / scene.mechanism.size, abs(moved.joint_motion))
    if share > START_DIGITS:
        yield (
            f"the start is not the file's: {moved.loop} is open by {moved.open:.3g} m or rad in the file; "
            f"closing the loops moved body {moved.body!r} by {moved.displacement:.3g} m and joint "
            f"{moved.joint!r} by {moved.joint_motion:.3g} m or rad"
        )


def notes(result: Crosscheck) -> Iterator[str]:
    """Word all else that is to be known beside the figures, a line each, the most important first."""
    mapping, scene = result.mapping, result.scene
    if result.nothing_moves:
        yield _rest_line(result)
    yield from redundancy_lines(scene)
    impossible = [body.name for body in scene.mechanism.bodies if body.allow_unrealisable_inertia]
    if impossible and mapping is None:  # a finding of a file has the numbers
        broken = "two principal moments together less than the third"
        yield f"inertia that no mass has, {broken}: {', '.join(impossible)}"
    yield from not_compared(result.checks)
    untested = result.coverage.untested if result.coverage else ()
    for why, shared in ((SAME_CODE, True), ("by the motion, 10 % more would not show", False)):
        if names := [covered.element for covered in untested if covered.shared == shared]:
            listed = f", {ALL_LISTED}" if len(names) > MOST_NAMED else ""
            yield f"untested {why}: {_named(names)}{listed}"
    for title, read in _mappings(result):
        yield f"{title}: {fates_line(read)}"
        yield from sorted(read.start, key=lambda line: not line.startswith("excited"))
    yield from undetermined_lines(scene)
    runs = result.trajectories.items()
    implicit = [name for name, run in runs if run.settings.get("integrator") in IMPLICIT]
    if implicit:
        rate, steps = fastest_decay(scene), explicit_steps(scene)
        fixed = f", RK4 steps of {RK4_LIMIT / rate:.2g} s" if "mujoco" in implicit and rate else ""
        needed = f"DOP853 would need {steps:.0f} steps{fixed}"
        yield f"stiff: fastest decay {rate:.2g} 1/s at the start; {needed}; implicit: {', '.join(implicit)}"
    if mapping and result.trajectories:
        yield _start_line(result)
        yield from _inactive_lines(mapping)


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


def undetermined_lines(scene: Scene) -> Iterator[str]:
    """Joints whose reactions the equations of motion do not determine at the start, a line if any."""
    count, joints = undetermined_joints(scene, initial_state(scene))
    if count:
        yield f"reactions not unique: {redundancy_text(count, _named(joints))}"


def _inactive_lines(mapping: ImportReport) -> Iterator[str]:
    """Word which elements were left out and watched, and did nothing in the run."""
    entries = [mapping.entries[number] for number in mapping.watches]
    idle = [f"{entry.element}: {entry.account}" for entry in entries if entry.fate == "inactive"]
    if idle:
        yield f"inactive in this run, {len(idle)} of {len(entries)} watched: {'; '.join(idle)}"


def _start_line(result: Crosscheck) -> str:
    """Word the start of each engine: the same pose, closed as far as its own run says at its first output."""
    names = list(result.trajectories)
    runs = list(result.trajectories.values())
    apart = max((distance(runs[0], run, at=0) for run in runs[1:]), default=0.0)
    residuals = ", ".join(
        f"{name} {np.max(run.constraint_violation[0]):.1e}"
        for name, run in zip(names, runs, strict=True)
        if run.constraint_violation is not None
    )
    same = f"same pose to {apart:.1e} (m, rad); " if len(runs) > 1 else ""
    return f"start: {same}largest residual of joints (m, rad): {residuals}"


def _rest_line(result: Crosscheck) -> str:
    """Report that nothing moves, the reason if the constraints show one, and what remains untested."""
    moved = ", ".join(f"{name} {far:.1e}" for name, far in displacements(result.trajectories).items())
    system = Relative(result.scene)
    q, _ = system.coordinates(initial_state(result.scene))
    basis, _ = admissible_basis(system, q, body_units(result.scene))
    why = "it starts at rest in equilibrium" if basis.shape[1] else "the mechanism has no freedom"
    return f"nothing moves, as {why}; runs test nothing; largest displacement (m, rad): {moved}"


def _named(names: Sequence[str]) -> str:
    """The first names of a list, and how many more there are."""
    more = f" and {len(names) - MOST_NAMED} more" if len(names) > MOST_NAMED else ""
    return ", ".join(names[:MOST_NAMED]) + more


def _short(value: object) -> object:
    """A setting with as many digits as people read."""
    return f"{value:.3g}" if isinstance(value, float) else value
