"""Report of `crosscheck importers`: what each engine's importer makes of one model file."""

from __future__ import annotations

from collections.abc import Iterator
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from crosscheck.compare.outcome import Outcome
from crosscheck.differences.importers import ImporterComparison, ImportersComparison
from crosscheck.loading.importers import OWN, Failure, importers
from crosscheck.report.chart import Measure, linear_chart
from crosscheck.report.diff import long_table, motion_text, sentence, short_table
from crosscheck.report.table import Cell, Lines, Part, Report, Rows, Table, text_columns
from newton_euler.errors import DISTRIBUTION


def report(comparison: ImportersComparison) -> Report:
    """Make the report of a comparison of importers."""
    reference = comparison.reference
    rows: Rows = []
    if reference and reference.file:
        bodies = reference.file.robot.bodies
        joints, mass = sum(len(body.joints) for body in bodies), sum(body.mass for body in bodies)
        robot = f"bodies: {len(bodies)}, joints: {joints}, mass: {mass:.6g} kg"
        rows.append([_name(reference.importer), "", robot])
    rows += [[_name(each.reading.importer), *_cells(comparison, each)] for each in comparison.others]
    short: list[Part] = [Table("", text_columns("importer", "result", "what it reads"), rows)]
    parts: list[Part] = []
    for each in comparison.others:
        importer, sides = each.reading.importer, _sides(comparison, each)
        if each.differences:
            short.append(short_table(_name(importer), each.differences, sides))
        if each.comparison and each.comparison.rows and reference:
            names = reference.importer, importer
            parts.append(long_table(f"differences of {importer}", each.comparison, names))
    short.append(Lines("", list(_notes(comparison))))
    outcome = comparison.outcome
    title = f"{Path(comparison.source).name}: the robot that each importer reads"
    verdict = f"{outcome.value}: {_verdict(comparison)}"
    counts = [
        Measure(
            _name(each.reading.importer),
            len(each.differences),
            str(each.result),
            verdict="fails" if isinstance(each.result, Failure) else each.result.judged,
        )
        for each in comparison.others
    ]
    return Report(
        title,
        verdict,
        Cell(outcome.value, outcome.judged),
        parts,
        summary=short,
        charts=linear_chart("Differences", "Number of differences from the reference reading", counts),
        next_steps=_next_steps(comparison),
    )


def _next_steps(comparison: ImportersComparison) -> list[str]:
    """List what the reader can do about importers that read another robot, or none."""
    steps = []
    for each in comparison.others:
        name = each.reading.importer
        if each.result is Failure.NOT_INSTALLED:
            steps.append(f"Install {name} to compare it, too.")
        elif isinstance(each.result, Failure):
            steps.append(f"Change what {name} cannot read: {each.reading.message}.")
        elif each.differences:
            steps.append(f"Rewrite what {name} reads differently; its table lists the differences.")
    return steps or ["Use the file with any of these importers: they read the same robot."]


def _verdict(comparison: ImportersComparison) -> str:
    """Tell in one sentence which importers read the same robot as the reference."""
    words = {
        Outcome.SAME: "reads the same robot",
        Outcome.SAME_TO_ROUNDING: "reads the same robot up to rounding",
        Outcome.DIFFERENT: "reads another robot",
        Failure.REFUSED: "refuses the file",
        Failure.NOT_DESCRIBED: "reads a model that cannot be compared",
        Failure.CRASHED: "crashes",
        Failure.NOT_INSTALLED: "is not installed",
    }
    results = [f"{each.reading.importer} {words[each.result]}" for each in comparison.others]
    against = f"compared with {comparison.reference.importer}, " if comparison.reference else ""
    return against + ", ".join(results)


def _name(importer: str) -> str:
    """Name an importer with the version of its package, if that is installed."""
    try:
        package = importers()[importer].package if importer != OWN else DISTRIBUTION
        return f"{importer} {version(package)}"
    except PackageNotFoundError:
        return importer


def _cells(comparison: ImportersComparison, each: ImporterComparison) -> list[str | Cell]:
    """Make the cells of an importer: result, and its message or what differs in one sentence."""
    result = each.result
    if isinstance(result, Failure) or each.comparison is None:
        return [Cell(result, "fails"), each.reading.message]
    text = motion_text(each.comparison, _sides(comparison, each))
    if count := len(each.differences):
        text = f"{count} difference{'' if count == 1 else 's'}; {text}"
    elif result is Outcome.DIFFERENT:
        text = f"only what it ignores as documented; {text}"
    return [Cell(result.value, result.judged), text]


def _sides(comparison: ImportersComparison, each: ImporterComparison) -> tuple[str, str]:
    """Return what sentences call the reference reading and the importer's."""
    reference = comparison.reference.importer if comparison.reference else ""
    return f"{reference}'s reading", f"{each.reading.importer}'s"


def _notes(comparison: ImportersComparison) -> Iterator[str]:
    """Yield what each importer leaves out by its documentation, and notes about its reading."""
    for each in comparison.others:
        left_out = [f"{each.drives_left_out} actuators"] if each.drives_left_out else []
        left_out += [sentence(row, _sides(comparison, each)) for row in each.left_out]
        if left_out and each.limit:
            what = "; ".join(left_out)
            yield f"{each.reading.importer} ignores, as documented ({each.limit.words}): {what}"
        if each.comparison:
            yield from (f"{each.reading.importer}: {note}" for note in each.comparison.motion.notes)
        if each.reading.file:
            yield from (f"{each.reading.importer}: {note}" for note in each.reading.file.notes)
