"""Report of `crosscheck importers`: what each engine's importer makes of one model file."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from crosscheck.compare.outcome import Outcome
from crosscheck.differences.difference import Standing
from crosscheck.differences.importers import ImporterComparison, ImportersComparison
from crosscheck.loading.importers import Failure, Importer, Reading
from crosscheck.report.diff import motion_text, sentence, short_table, tables
from crosscheck.report.table import Cell, Lines, Part, Report, Rows, Table, text_columns
from crosscheck.support.versions import versions

STANDINGS = {
    Standing.DIFFERENT: "differences",
    Standing.ROUNDING: "rounding",
    Standing.CONVENTION: "the same robot in other terms",
}
"""Titles of the tables of an importer."""


def report(comparison: ImportersComparison) -> Report:
    """Make the report of a comparison of importers."""
    version_of = versions()
    name = {importer: f"{importer} {version_of[importer.package]}" for importer in Importer}
    first: Rows = [[Importer.OWN, *_own_cells(comparison.own)]]
    first += [[name[each.reading.importer], *_cells(each)] for each in comparison.others]
    short: list[Part] = [Table("", text_columns("importer", "result", "what it reads"), first)]
    parts: list[Part] = []
    for each in comparison.others:
        if each.differences:
            short.append(short_table(name[each.reading.importer], each.differences, _sides(each)))
        if each.comparison:
            importer = each.reading.importer
            titles = {standing: f"{importer}: {title}" for standing, title in STANDINGS.items()}
            parts += tables(each.comparison, titles, (Importer.OWN, importer))
    short.append(Lines("", list(_notes(comparison))))
    outcome = comparison.outcome
    path = Path(comparison.source)
    title = f"{path.name}: the robot that each importer reads, against crosscheck's own reading"
    verdict = f"{outcome.value}: {_verdict(comparison)}"
    return Report(title, verdict, Cell(outcome.value, outcome.judged), parts, summary=short)


def _verdict(comparison: ImportersComparison) -> str:
    """Tell in one sentence which importers read the same robot as crosscheck."""
    if comparison.own.failure:
        return f"crosscheck does not read the file: {comparison.own.message}"
    words = {
        Outcome.SAME: "reads the same robot",
        Outcome.SAME_TO_ROUNDING: "reads the same robot to rounding",
        Outcome.DIFFERENT: "reads another robot",
        Failure.REFUSED: "refuses the file",
        Failure.NOT_DESCRIBED: "reads a model without meaning",
        Failure.CRASHED: "crashes",
    }
    return ", ".join(f"{each.reading.importer} {words[each.result]}" for each in comparison.others)


def _own_cells(own: Reading) -> list[str | Cell]:
    """Make the cells of crosscheck's own reading: failure or nothing, and the robot in numbers."""
    if own.file is None:
        return [Cell(own.failure or "", "fails"), own.message]
    bodies = own.file.robot.bodies
    joints, mass = sum(len(body.joints) for body in bodies), sum(body.mass for body in bodies)
    return ["", f"bodies: {len(bodies)}, joints: {joints}, mass: {mass:.6g} kg"]


def _cells(each: ImporterComparison) -> list[str | Cell]:
    """Make the cells of another importer: result, and the message or what differs in one sentence."""
    result = each.result
    if isinstance(result, Failure):
        return [Cell(result, "fails"), each.reading.message]
    return [Cell(result.value, result.judged), _words(each)]


def _words(each: ImporterComparison) -> str:
    """Tell in one sentence how an importer's reading differs from crosscheck's."""
    if each.comparison is None:
        return "not compared"
    if each.result is not Outcome.DIFFERENT:
        return motion_text(each.comparison, _sides(each))
    count = len(each.differences)
    what = f"{count} difference{'' if count == 1 else 's'}" if count else "only its documented limits"
    return f"{what}; {motion_text(each.comparison, _sides(each))}"


def _sides(each: ImporterComparison) -> tuple[str, str]:
    """Return what sentences call crosscheck's reading and the importer's."""
    return f"{Importer.OWN}'s reading", f"{each.reading.importer}'s"


def _notes(comparison: ImportersComparison) -> Iterator[str]:
    """Yield what importers leave out by their documentation, and notes about each reading."""
    for each in comparison.others:
        left_out = [f"{each.drives_left_out} actuators"] if each.drives_left_out else []
        left_out += [sentence(row, _sides(each)) for row in each.left_out]
        if left_out and each.limit:
            what = "; ".join(left_out)
            yield f"{each.reading.importer} leaves out, as documented ({each.limit.words}): {what}"
        if each.comparison:
            yield from (f"{each.reading.importer}: {note}" for note in each.comparison.motion.notes)
    names_of: dict[str, list[str]] = {}  # of importers, by note
    for reading in (comparison.own, *(each.reading for each in comparison.others)):
        for note in reading.file.notes if reading.file else ():
            names_of.setdefault(note, []).append(reading.importer)
    yield from (f"{' and '.join(names)}: {note}" for note, names in names_of.items())
