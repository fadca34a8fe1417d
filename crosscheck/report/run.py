"""Make the report of a crosscheck: the checks as tables, and sentences on the limits of the verdict.

A crosscheck runs one scene (a mechanism with its forces, inputs and initial state) in several engines and
compares the runs. In: the result, an `EngineComparison`. Out: a `Report` for the terminal and for pages, and
JUnit XML for CI.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from operator import ne

import numpy as np

from crosscheck.compare.activity import acted
from crosscheck.compare.allowed_motions import admissible_basis, body_units
from crosscheck.compare.check import FILE, LEVELS_OF_EQUATIONS, Check, not_compared, unconverged_reason
from crosscheck.compare.coverage import Coverage
from crosscheck.compare.note import Note
from crosscheck.compare.outcome import Verdict
from crosscheck.compare.reference_values import ReferenceCheck
from crosscheck.compare.result import EngineComparison
from crosscheck.compare.runs import displacements
from crosscheck.engines.stiffness import explicit_steps, fastest_decay
from crosscheck.library.model_files import fates_line, report_lines
from crosscheck.own_run.allowed import OWN_RUN
from crosscheck.own_run.judge import Judgement
from crosscheck.report import render
from crosscheck.report.own_run import own_run_cases
from crosscheck.report.run_page import charts, next_steps
from crosscheck.report.summary import are_loops_closed, are_velocities_changed, judged_runs, summary
from crosscheck.report.table import (
    Cell,
    Column,
    Lines,
    Part,
    Report,
    Rows,
    Table,
    checked_cell,
    name_value_table,
    number_columns,
    text_columns,
)
from crosscheck.support.name_lists import first_names
from newton_euler.equations.redundancy import mobility
from newton_euler.equations.relative import Relative
from newton_euler.equations.undetermined import redundancy_text, undetermined_joints
from newton_euler.integrators.fixed_step import RK4_LIMIT
from newton_euler.model.scene import Scene
from newton_euler.model.trajectory import distance
from newton_euler.reading.import_report import ImportReport
from newton_euler.runs.assemble import initial_state

MAX_NAMES = 12
"""Largest number of names in one sentence."""

ALL_LISTED = "all in summary.json and on the page of `crosscheck report`"
"""End of a sentence on untested elements that does not name all of them."""

SAME_CODE = "as all engines call the same code"
"""Reason why controllers in Python code are untested by every motion."""

MAX_ACTING_LINES = 3
"""Largest number of lines on elements that act and are not simulated; one more line names the others."""


def report(result: EngineComparison) -> Report:
    """Make the report of a comparison: a full one, and a summary that the terminal shows."""
    limits, other_notes = list(verdict_limits(result)), list(notes(result))
    advice = [f"{Note.ADVICE}, {advice}" for advice in result.advice]
    parts: list[Part] = [*judged_runs(result), *tables(result), _participation_table(result)]
    parts.append(Lines("", [*limits, *other_notes, *advice]))
    parts.append(name_value_table("settings and run times", dict(_settings(result))))
    if result.coverage and result.coverage.untested:
        parts.append(_untested_table(result.coverage))
    if result.mapping:
        parts.append(Lines("carried over from the file", list(report_lines(result.mapping)), folded=True))
    names = ("scene", "source", "options", "left_out", "versions")
    values = result.summary()
    shown = {name: values[name] for name in names if values.get(name)}
    parts.append(name_value_table("scene and versions", shown, folded=True))
    return Report(
        title=": ".join(filter(None, [result.title, result.scene.description])),
        verdict=result.verdict,
        judged=outcome_cell(result),
        parts=parts,
        wall_time=result.wall_time,
        summary=summary(result, limits, other_notes),
        charts=charts(result),
        next_steps=next_steps(result),
    )


def junit(result: EngineComparison, whole: Report, name: str, allow_reduced: bool) -> str:
    """Write a comparison as JUnit XML: test cases for the outcome, for the file's own run, and for checks.

    The test case of the outcome fails exactly if `crosscheck run` has another exit status than 0.

    Args:
        result: the comparison.
        whole: the report that `report` made.
        name: name of the results, with which the names of all suites begin. CI servers merge the files of
            several models, and drop a test case if another one has the same suite and name.
        allow_reduced: whether agreement on a reduced model counts as agreement.
    """
    judged: Verdict = "holds" if result.outcome.passes(allow_reduced) else "fails"
    rows: Rows = [["outcome", Cell(result.verdict, judged)]]
    runs: dict[str, Judgement | None] = {OWN_RUN: result.own_run, **result.logs}
    for run, judgement in runs.items():
        limits = result.limits_of(run)
        # limits of errors that the run does not determine
        is_limited = run in result.limited_runs
        unjudged = [each for each in result.allowed_errors if is_limited and each not in limits]
        cases = own_run_cases(judgement, limits) if limits or not unjudged else []
        rows += [run, *cases, *own_run_cases(None, unjudged)]
    parts = [Table("verdict", text_columns("", ""), rows), *whole.parts]
    named = [replace(part, title=f"{name}: {part.title}") for part in parts]
    return render.junit(replace(whole, parts=named))


def outcome_cell(result: EngineComparison) -> Cell:
    """Make the cell with the verdict in one word, such as AGREE."""
    return Cell(result.outcome.value, result.outcome.judged)


def _participation_table(result: EngineComparison) -> Table:
    """Make a table of the number of judged checks that each engine takes part in, and levels without it."""
    rows: Rows = [
        [name, str(part.with_engines), str(part.with_file), str(part.alone), ", ".join(part.no_part_in)]
        for name, part in result.participation.items()
    ]
    columns = [
        Column(""),
        *number_columns("with other\nengines", "with the\nfile", "by itself"),
        Column("no part in", below=True),
    ]
    return Table("number of checks of each engine", columns, rows)


def _untested_table(coverage: Coverage) -> Table:
    """Make a table of the elements that the motion does not test.

    The effect of an element is the change of the motion if a parameter of the element grows by 10 %, divided
    by the smallest change that the checks detect.
    """
    rows: Rows = [
        [each.element, SAME_CODE if each.shared else f"{each.effect:.1e}"] for each in coverage.untested
    ]
    title = "untested by the motion: 10 % more of these changes no pose"
    columns = [Column("element"), *number_columns("effect (detectable above 1)")]
    return Table(title, columns, rows, folded=True)


def tables(result: EngineComparison) -> Iterator[Table]:
    """Yield the tables of checks.

    The first tables are of engines against the model file, of pairs of engines, and of each engine by itself.
    The next one is of the two formulations of the equations in newton_euler (joint and Cartesian
    coordinates). Tables of reference values and of failed checks follow.
    """
    titles = {
        "file": f"each engine against {result.title} as its file's own reader has it",
        "pairs": "engines compared",
        "single": "each engine by itself",
        "within": "two equations of motion of one engine",
    }
    engines = {engine.name for engine in result.engines}
    for kind, title in titles.items():
        checks = [check for check in result.checks if _kind_of(check, engines) == kind]
        if checks:
            yield _checks_table(title, checks)
    if result.reference_checks:
        yield _reference_table(result.reference_checks)
    failed = [check for check in result.checks if not check.agrees]
    if len(failed) > 1:
        yield Table(
            "where they part",
            text_columns("level", "quantity", "between", "worst at"),
            [[check.level, check.quantity, ", ".join(check.between), check.place] for check in failed],
        )


def _kind_of(check: Check, engines: set[str]) -> str:
    """Return the table of a check: "single", "file", "pairs" of engines, or "within" one engine."""
    if len(check.between) == 1:
        return "single"
    if FILE in check.between:
        return "file"
    return "pairs" if set(check.between) <= engines else "within"


def _checks_table(title: str, checks: list[Check]) -> Table:
    """Make a table of checks: a section per level, a row per quantity, a column per engine or pair.

    A level is a group of checks, such as "dynamics" or "trajectories".
    """
    columns = list(dict.fromkeys(check.between for check in checks))
    rows: Rows = []
    for level in dict.fromkeys(check.level for check in checks):
        rows.append(level)
        at_level = [check for check in checks if check.level == level]
        for quantity in dict.fromkeys(check.quantity for check in at_level):
            cells = {check.between: _cell(check) for check in at_level if check.quantity == quantity}
            rows.append([quantity, *(cells.get(between, "") for between in columns)])
    headings = [Column("\n".join(between), numeric=True) for between in columns]
    return Table(title, [Column(""), *headings], rows)


def _cell(check: Check) -> Cell:
    """Make the cell of a check: its value, and its tolerance if the check is judged."""
    about = f"worst at {check.where}"
    if check.unconverged:  # name of the engine whose error does not decrease in a refined run
        reason = unconverged_reason([check.unconverged])
        return Cell(f"{check.value:.1e} not judged", about=f"{reason}; {about}")
    if not check.judged:
        return Cell(f"{check.value:.1e}", about=about)
    return checked_cell(check.value, check.tolerance, check.agrees, about)


def _reference_table(checks: Sequence[ReferenceCheck]) -> Table:
    """Make the table of reference values: known results, such as those of a publication.

    There is a section per time and a row per reference value: the first engine's value, the reference, and
    the error of each engine.
    """
    engines = list(dict.fromkeys(check.engine for check in checks))
    rows: Rows = []
    for time in dict.fromkeys(check.known.time for check in checks):
        rows.append(f"at {time:g} s")
        at_time = [check for check in checks if check.known.time == time]
        # checks of one reference value have the same object in `known`
        for known in dict.fromkeys(id(check.known) for check in at_time):
            by_engine = {check.engine: check for check in at_time if id(check.known) == known}
            first = by_engine[engines[0]]
            label = f"{first.known.quantity}, {first.known.unit}"
            values = [f"{first.result:.12g}", f"{first.known.value:.12g}"]
            of_value = [by_engine[name] for name in engines]
            errors = [checked_cell(check.value, check.tolerance, check.agrees) for check in of_value]
            rows.append([label, *values, *errors])
    headings = [Column(f"value,\n{engines[0]}", numeric=True), *number_columns("reference")]
    headings += [Column(name, numeric=True) for name in engines]
    return Table("reference values", [Column(""), *headings], rows)


def _settings(result: EngineComparison) -> Iterator[tuple[str, str]]:
    """Yield the name of each engine, and its settings and run time in a line."""
    for name, run in result.trajectories.items():
        settings = ", ".join(f"{key} {_rounded(value)}" for key, value in run.settings.items())
        yield name, f"{settings}; {run.wall_time:.2g} s"


def verdict_limits(result: EngineComparison) -> Iterator[str]:
    """Yield sentences that limit the verdict.

    They report analyses that did not complete, likely mistakes in the file, and a start that differs from the
    file's. They also name elements that would have acted in the run but are not simulated.
    """
    yield from result.notes
    if result.singular:
        yield str(result.singular)
    if result.mapping:
        yield from (f"{Note.FINDING}, {finding}" for finding in result.mapping.findings)
        yield from moved_start_lines(result.mapping, result.scene)
        yield from _reduction_lines(result.mapping)


def _reduction_lines(mapping: ImportReport) -> Iterator[str]:
    """Yield sentences on elements of the file that are not simulated and act, or may act."""
    acting = mapping.acting
    # `how`: reason why the element is left out; `seen`: observation in the run
    for entry in acting[:MAX_ACTING_LINES]:
        yield f"{Note.ACTIVE}: {entry.element}: {'; '.join(filter(None, [entry.seen, entry.how]))}"
    if more := [acted(entry) for entry in acting[MAX_ACTING_LINES:]]:
        yield f"{Note.ACTIVE}, too: {first_names(more, MAX_NAMES)}"
    # Excitation: start velocities and sines for actuators, which the reader adds to a file at rest
    if acting and acting[0].since and mapping.excitation:
        yield (
            f"{Note.EXCITATION_ACTS} of what acts from {acting[0].since:.4g} s on; "
            "--set excitation=off runs the file without it"
        )
    if unknown := [entry for entry in mapping.entries if not entry.examined]:
        yield f"{Note.NOT_EXAMINED}: {'; '.join(f'{e.element}: {e.how}' for e in unknown)}"


def moved_start_lines(mapping: ImportReport, scene: Scene) -> Iterator[str]:
    """Yield sentences on how much the start was changed to satisfy the constraints, if noticeably.

    Args:
        mapping: import report of the model file.
        scene: the scene.
    """
    changed = mapping.changed_velocities
    if changed and are_velocities_changed(mapping):
        yield (
            f"{Note.START_MOVED}: velocities of {changed.start} do not fit the constraints; they "
            f"are changed by up to {changed.linear:.3g} m/s and {changed.angular:.3g} rad/s"
        )
    moved = mapping.moved
    if moved and are_loops_closed(mapping, scene):
        yield (
            f"{Note.START_MOVED}: {moved.loop} is open by {moved.open:.3g} m or rad in the file; "
            f"closing the loops moved body {moved.body!r} by {moved.displacement:.3g} m and joint "
            f"{moved.joint!r} by {moved.joint_motion:.3g} m or rad"
        )


def notes(result: EngineComparison) -> Iterator[str]:
    """Yield further sentences on a crosscheck that do not limit its verdict, the most important first."""
    scene = result.scene
    if result.nothing_moves:
        yield _rest_line(result)
    yield from redundancy_lines(scene)
    # impossible inertias; those of a model file are findings, which `verdict_limits` reports with numbers
    impossible = [body.name for body in scene.mechanism.bodies if body.allow_unrealisable_inertia]
    if impossible and not result.mapping:
        broken = "two principal moments together less than the third"
        yield f"{Note.IMPOSSIBLE_INERTIA}, {broken}: {', '.join(impossible)}"

    # what was not compared or tested
    if result.by_runs_only and result.trajectories:
        yield f"{Note.BY_RUNS_ONLY}, not by equations of motion: {', '.join(result.by_runs_only)}"
    yield from not_compared(result.checks)
    yield from _untested_lines(result)

    # the model file, and the start
    mapping = result.mapping
    if mapping:
        yield f"{Note.FILE}: {fates_line(mapping)}"  # numbers of elements imported exactly, left out ...
        # lines about the initial state, the one about the excitation first
        yield from sorted(mapping.start, key=partial(ne, mapping.excitation))
    yield from undetermined_lines(scene)

    # stiffness: why an engine chose an implicit integrator
    implicit = {
        engine.name: engine.integrators
        for engine in result.engines
        if engine.integrators
        and engine.name in result.trajectories
        and result.trajectories[engine.name].settings.get("integrator") == engine.integrators.implicit
    }
    if implicit:
        has_fixed_steps = any(each.explicit == "RK4" for each in implicit.values())
        rate, steps = fastest_decay(scene), explicit_steps(scene)
        fixed = f", RK4 steps of {RK4_LIMIT / rate:.2g} s" if has_fixed_steps and rate else ""
        needed = f"DOP853 would need {steps:.0f} steps{fixed}"
        solved = f"implicit: {', '.join(implicit)}"
        yield f"{Note.STIFF}: fastest decay {rate:.2g} 1/s at the start; {needed}; {solved}"

    if mapping and result.trajectories:
        yield _start_line(result)
        yield from _inactive_lines(mapping)


def _untested_lines(result: EngineComparison) -> Iterator[str]:
    """Yield sentences on elements that the motion does not test, and on what is compared instead."""
    if not result.coverage:
        return
    untested = result.coverage.untested
    changes = "as all poses are prescribed" if result.coverage.is_prescribed else "10 % more changes no pose"
    if any(check.level == LEVELS_OF_EQUATIONS[-1] and check.judged for check in result.checks):
        changes += "; accelerations and reactions are compared at random states"
    for note, shared in ((Note.UNTESTED_CODE, True), (f"{Note.UNTESTED}, {changes}", False)):
        if names := [covered.element for covered in untested if covered.shared == shared]:
            listed = f", {ALL_LISTED}" if len(names) > MAX_NAMES else ""
            yield f"{note}: {first_names(names, MAX_NAMES)}{listed}"


def redundancy_lines(scene: Scene) -> Iterator[str]:
    """Yield a sentence for each nearly redundant constraint, with the option that changes its treatment."""
    analysis = mobility(scene)
    for constraint in analysis.nearly:
        if constraint.taken == "redundant":
            option = "redundancy_tolerance=0 takes it literally"
        else:
            option = f"redundancy_tolerance={2.0 * constraint.singular_value:.0e} takes it as redundant"
        yield f"{Note.NEARLY_REDUNDANT}, {constraint}; {option}"
    if analysis.nearly and analysis.degrees_of_freedom == 0:
        yield f"{Note.NO_FREEDOM}: the constraints hold the mechanism in place"


def undetermined_lines(scene: Scene) -> Iterator[str]:
    """Yield a sentence on joints whose reactions are not unique at the start, if there are any."""
    count, joints = undetermined_joints(scene, initial_state(scene))
    if count:
        yield f"{Note.NOT_UNIQUE}: {redundancy_text(count, first_names(joints, MAX_NAMES))}"


def _inactive_lines(mapping: ImportReport) -> Iterator[str]:
    """Yield a sentence on elements that are not simulated and, as the run shows, would not have acted."""
    entries = [mapping.entries[number] for number in mapping.watches]  # those that a run can judge
    idle = [f"{entry.element}: {entry.account}" for entry in entries if entry.fate == "inactive"]
    if idle:
        yield f"{Note.INACTIVE}, {len(idle)} of {len(entries)} watched: {'; '.join(idle)}"


def _start_line(result: EngineComparison) -> str:
    """Report that all engines start in the same pose, and the constraint violation of each at the start."""
    names = list(result.trajectories)
    runs = list(result.trajectories.values())
    apart = max((distance(runs[0], run, at=0) for run in runs[1:]), default=0.0)
    residuals = ", ".join(
        f"{name} {np.max(run.constraint_violation[0]):.1e}"
        for name, run in zip(names, runs, strict=True)
        if run.constraint_violation is not None
    )
    same = f"same pose to {apart:.1e} (m, rad); " if len(runs) > 1 else ""
    return f"{Note.START}: {same}largest residual of joints (m, rad): {residuals}"


def _rest_line(result: EngineComparison) -> str:
    """Report that nothing moves, the reason if the constraints show one, and what remains untested."""
    largest = displacements(result.trajectories).items()
    moved = ", ".join(f"{name} {displacement:.1e}" for name, displacement in largest)
    # the velocities that the constraints allow are the columns of the basis
    system = Relative(result.scene)
    q, _ = system.coordinates(initial_state(result.scene))
    basis, _ = admissible_basis(system, q, body_units(result.scene))
    why = "it starts at rest in equilibrium" if basis.shape[1] else "the mechanism has no freedom"
    return f"{Note.NOTHING_MOVES}, as {why}; runs test nothing; largest displacement (m, rad): {moved}"


def _rounded(value: object) -> object:
    """Round a number among the settings to 3 digits, as text; return other values unchanged."""
    return f"{value:.3g}" if isinstance(value, float) else value
