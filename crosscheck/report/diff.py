"""Report of `crosscheck diff`: what differs between two model files, and what it does to the motion."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import count
from pathlib import Path

from crosscheck.compare.outcome import Outcome, Verdict
from crosscheck.differences.common_states import PHASES
from crosscheck.differences.difference import Difference, Quantity, Side, Standing
from crosscheck.differences.motion import Likeness, Motion
from crosscheck.differences.result import FileComparison
from crosscheck.differences.rows import IF_FLOATING
from crosscheck.differences.run import Run
from crosscheck.own_run.allowed import length
from crosscheck.report.diff_values import change_text, effect_text, size_text, value_texts
from crosscheck.report.own_run import angle, percent
from crosscheck.report.table import (
    Cell,
    Column,
    Lines,
    Part,
    Report,
    Rows,
    Table,
    number_columns,
    text_columns,
)
from crosscheck.support.name_lists import first_names
from newton_euler.reading.robot import RobotFile

MAX_LISTED = 30
"""Largest number of rows of the short table of differences; all are in the long one."""

MAX_CONVENTIONS = 3
"""Largest number of conventions that the terminal names."""

MAX_HEADING = 24
"""Largest number of characters of a file name that is the heading of a column."""

GEOMETRY = "shapes: no effect on the compared motion, as contacts are not in it"
"""Title of the rows of shapes."""

Sides = tuple[str, str]
"""What sentences call the first and the second of two compared robots."""

FILES: Sides = ("the first file", "the second file")
"""The robots of two files."""

MIN_SHOWN_ROUNDING = 0.05
"""Fraction of a change of accelerations from which on the part that rounding can cause is printed."""


def report(comparison: FileComparison) -> Report:
    """Make the report of a comparison of two model files."""
    outcome = comparison.outcome
    different = comparison.differences
    short: list[Part] = []
    moving = [row for row in different if not row.is_geometry]
    of_shapes = different[len(moving) :]
    if moving:
        short.append(short_table("", moving, FILES))
    if of_shapes:
        short.append(_shapes_table(of_shapes))
    evidence = [evidence_text(row) for row in different if row.evidence]
    if evidence:
        short.append(Lines("evidence", evidence[:MAX_LISTED]))
    unlisted = sum(max(0, len(rows) - MAX_LISTED) for rows in (moving, of_shapes))
    short.append(Lines("", list(_notes(comparison, unlisted))))
    parts: list[Part] = [Lines("evidence", evidence)] if evidence else []
    if elements := list(_elements_of_rows(different)):
        parts.append(Lines("elements of rows that stand for several", elements))
    if comparison.rows:
        files = comparison.first, comparison.second
        # the shortest names that tell the files apart
        names = "first", "second"
        for candidates in ([file.format for file in files], _names(files)):
            are_short = all(0 < len(name) <= MAX_HEADING for name in candidates)
            if are_short and candidates[0] != candidates[1]:
                names = candidates[0], candidates[1]
        parts.append(long_table("differences", comparison, names))
    first, second = _titles(comparison)
    judged = Cell(outcome.value, outcome.judged)
    steps = [
        f"Decide which file is right in row {number}: {sentence(row, FILES)}."
        for number, row in enumerate(different[:3], start=1)
    ]
    steps = steps or ["Use either file: there is no difference that you have to decide."]
    title, result = f"{first} and {second}", verdict(comparison)
    return Report(title, result, judged, parts, summary=short, next_steps=steps)


def short_table(title: str, rows: Sequence[Difference], sides: Sides) -> Table:
    """Make the table of the largest differences for the terminal: effect, size, and a sentence.

    Args:
        title: title of the table.
        rows: differences, the largest effect first.
        sides: what the sentences call the two compared robots.
    """
    columns = [*number_columns("motion", "difference"), Column("what differs")]
    return Table(title, columns, [_short_row(row, sides) for row in rows[:MAX_LISTED]])


def _shapes_table(rows: Sequence[Difference]) -> Table:
    """Make the table of the first differences of shapes for the terminal: size, and a sentence."""
    columns = [*number_columns("difference"), Column("what differs")]
    return Table(GEOMETRY, columns, [_short_row(row, FILES)[1:] for row in rows[:MAX_LISTED]])


def verdict(comparison: FileComparison) -> str:
    """Format the result in one sentence."""
    different, motion = comparison.differences, comparison.motion
    rounded = comparison.of_standing(Standing.ROUNDING)
    words, without = comparison.outcome.value, _without(comparison)
    match comparison.outcome:
        case Outcome.UNFINISHED:
            equal = f"equal within {_allowance(comparison)}" if rounded else "equal"
            return f"{words}: all numbers are {equal}; motions were not compared"
        case Outcome.SAME if motion.likeness is Likeness.UNDECIDED:
            return f"{words}: all numbers are equal; motions were not compared"
        case Outcome.SAME:
            if comparison.of_standing(Standing.CONVENTION):
                return f"{words}: all motions{without} are equal; what differs does not change them"
            return f"{words}: all numbers and motions{without} are equal"
        case Outcome.SAME_TO_ROUNDING:
            total = sum(len(row.elements) for row in rounded)
            within = "their digits" if comparison.tolerance is None else "the tolerance"
            effect = max((row.effect or 0.0 for row in rounded), default=motion.change)
            numbers = _numbers_differ(total) if total else "numbers differ"
            change = f"accelerations{without} change by at most {percent(effect)}"
            return f"{words}: {numbers} within {within}; {change}"
        case _:
            count = _counted(len(different), "difference") + _of_shapes(different)
            return f"{words}: {count}; {motion_text(comparison, FILES)}"


def _of_shapes(rows: Sequence[Difference]) -> str:
    """Tell how many of some differences are those of shapes; "" if none is."""
    count = sum(row.is_geometry for row in rows)
    if not count:
        return ""
    return " of shapes" if count == len(rows) else f", {count} of them of shapes"


def _counted(count: int, noun: str, plural: str = "") -> str:
    """Return a number with its noun; `plural` if that is not the noun with an s."""
    return f"{count} {noun if count == 1 else plural or noun + 's'}"


def _numbers_differ(count: int, more: str = "") -> str:
    """Tell how many numbers differ; `more` comes before the noun."""
    return f"{_counted(count, more + 'number')} {'differs' if count == 1 else 'differ'}"


def _allowance(comparison: FileComparison) -> str:
    """Name what makes a difference count as rounding."""
    return "the digits of the files" if comparison.tolerance is None else "the tolerance"


def motion_text(comparison: FileComparison, sides: Sides) -> str:
    """Tell whether the robots move alike.

    Args:
        comparison: the comparison.
        sides: what the text calls the two compared robots.
    """
    motion = comparison.motion
    match motion.likeness:
        case Likeness.DIFFERENT:
            if motion.freedoms[0] != motion.freedoms[1]:
                first, second = motion.freedoms
                return f"{sides[0]} has {_counted(first, 'independent motion')}, {sides[1]} {second}"
            if any(gap.is_open for gap in motion.gaps):
                return f"poses of {sides[0]} do not fit {sides[1]}: {gap_text(motion)}"
            change = f"accelerations{_without(comparison)} at random states differ by"
            is_rounded = motion.uncertainty > MIN_SHOWN_ROUNDING * motion.change
            rounding = f", of which rounding can be {change_text(motion.uncertainty)}" if is_rounded else ""
            return f"{change} {change_text(motion.change)}, at {motion.body}, {motion.phase}{rounding}"
        case Likeness.EQUAL | Likeness.ROUNDING:
            states = comparison.states
            is_reduced = states is not None and any(cut.takes_motion for cut in states.cuts)
            text = "what both have moves alike" if is_reduced else "both move alike"
            text += _without(comparison)
            is_equal = motion.likeness is Likeness.EQUAL
            return text if is_equal else f"{text}, within {_allowance(comparison)}"
        case Likeness.UNDECIDED:
            return "motions were not compared"


def _without(comparison: FileComparison) -> str:
    """Name the forces, at most three, that are in no motion that was compared; "" without such forces."""
    names = comparison.unmodeled
    return f" without {first_names(names, 3)}" if names else ""


def gap_text(motion: Motion) -> str:
    """Tell which constraint of the second robot the poses of the first violate most."""
    gap = max(motion.gaps, key=lambda gap: (gap.is_open, gap.error))
    size = length(gap.error) if gap.unit == "m" else angle(gap.error)
    return f"constraint {gap.constraint!r} is violated by {size}"


def run_text(run: Run) -> str:
    """Tell how far apart the same body of both robots gets in a run from the same or the nearest start."""
    start = "the same start"
    if run.start_distance:
        start = (
            f"their own closed poses, {length(run.start_distance)} from each other, as no pose fits both, "
            "and displacements from there compared"
        )
    found = f"both robots simulated for {run.duration:.2g} s from {start}:"
    rounding = f"{length(run.uncertainty, 2)} that rounding can cause"
    if run.distance <= run.uncertainty:
        return f"{found} no body gets farther from its counterpart than the {rounding}"
    apart = f"{length(run.distance)} from its counterpart, at {run.time:.2g} s"
    return f"{found} {run.body} gets {apart}, beside the {rounding}"


def no_run_text(motion: Motion) -> str:
    """Tell why two robots cannot run from the same start."""
    why = f": {gap_text(motion)}" if motion.gaps else ""
    return f"not simulated: no pose fits both robots{why}"


def _titles(comparison: FileComparison) -> list[str]:
    """Name both files and their formats."""
    files = comparison.first, comparison.second
    names = [name or file.robot.name or "model" for name, file in zip(_names(files), files, strict=True)]
    return [
        f"{name} ({file.format})" if file.format else name for name, file in zip(names, files, strict=True)
    ]


def _names(files: tuple[RobotFile, RobotFile]) -> list[str]:
    """Return the names of two files, with folders that tell equal names apart; "" for models in memory."""
    paths = [Path(file.source) if file.source else Path() for file in files]
    for length_of_end in range(1, max(len(path.parts) for path in paths) + 1):
        ends = [path.parts[-length_of_end:] for path in paths]
        if ends[0] != ends[1]:
            return ["/".join(end if len(end) < 3 else (end[0], "...", end[-1])) for end in ends]
    return [path.name for path in paths]


def long_table(title: str, comparison: FileComparison, names: tuple[str, str]) -> Table:
    """Make the table of all rows, which numbers the true differences.

    Args:
        title: title of the table.
        comparison: the comparison.
        names: titles of the columns with the values of the first and the second robot.
    """
    columns = [*text_columns("", "element"), Column("quantity", choice=True), *text_columns(*names)]
    columns += number_columns("difference", "motion")
    found: Rows = []
    is_by_digits = comparison.tolerance is None
    allowed = "the digits of the files leave open" if is_by_digits else "the tolerance"
    numbers = (str(number) for number in count(1))
    for standing, is_geometry, words in (
        (Standing.DIFFERENT, False, f"different: by more than {allowed}"),
        (Standing.DIFFERENT, True, GEOMETRY),
        (Standing.ROUNDING, None, f"rounding: within {_allowance(comparison)}"),
        (Standing.CONVENTION, None, "no effect on the motion: other terms for the same robot, and settings"),
    ):
        rows = [row for row in comparison.of_standing(standing) if is_geometry in (None, row.is_geometry)]
        if rows:
            found.append(words)
            found.extend(_row(next(numbers) if standing is Standing.DIFFERENT else "", row) for row in rows)
    return Table(title, columns, found)


def _elements_of_rows(rows: Sequence[Difference]) -> Iterator[str]:
    """Yield the names of all elements of each row that stands for several, with the number of the row."""
    for number, row in enumerate(rows, start=1):
        if len(row.elements) > 1:
            yield f"{number}  {_quantity(row)}: {', '.join(row.elements)}"


def _short_row(row: Difference, sides: Sides) -> list[str | Cell]:
    """Make the cells of a difference for the terminal: effect, size, and a sentence."""
    return [effect_text(row), Cell(size_text(row), "fails"), Cell(sentence(row, sides), about=row.element)]


def sentence(row: Difference, sides: Sides = FILES) -> str:
    """Tell a difference with its values and its cause.

    Args:
        row: the difference.
        sides: what the sentence calls the two compared robots.
    """
    return _with_values(row, sides) + (f"; {row.cause}" if row.cause else "")


def _with_values(row: Difference, sides: Sides) -> str:
    """Tell a difference with both values."""
    text = what_differs(row)
    values = value_texts(row)
    if row.quantity is Quantity.PRESENCE:
        text += f" only in {sides[row.first is None]}"
        if row.element_kind == "body":
            text += f" ({values[row.first is None]} kg)"
    elif row.quantity is Quantity.GRAVITY:
        text += f": {values[0]} against {values[1]} {row.unit}"
    elif values[0] != values[1]:
        unit = f" {row.unit}" if row.unit else ""
        between = unit if row.second is None else ""  # the unit is that of the number before
        text += f": {values[0]}{between} against {values[1]}{'' if row.second is None else unit}"
    return text


def evidence_text(row: Difference) -> str:
    """Tell the evidence on which value of a difference is right."""
    files = {Side.FIRST: FILES[0], Side.SECOND: FILES[1], Side.NEITHER: "neither file"}
    texts = [f"speaks for {files[each.speaks_for]}: {each.text}" for each in row.evidence]
    return f"{what_differs(row)} {'; '.join(texts)}"


def _row(number: str, row: Difference) -> list[str | Cell]:
    """Make the cells of a difference for a page: number, element, what, both values, size and effect."""
    element = _element(row) + (f"\n{row.cause}" if row.cause else "")
    judged: Verdict = "fails" if row.standing is Standing.DIFFERENT else ""
    values = [
        text if value is None else f"{text} {row.unit}".strip()
        for value, text in zip((row.first, row.second), value_texts(row), strict=True)
    ]
    sizes = Cell(size_text(row), judged), effect_text(row)
    about = ", ".join(row.elements or (row.element,))
    return [number, Cell(element, about=about), _quantity(row), *values, *sizes]


def what_differs(row: Difference) -> str:
    """Name the quantity and the element of a difference, and the number of others with the same cause."""
    is_element = row.quantity is Quantity.PRESENCE and not row.is_geometry
    return f"{_quantity(row)} {'' if is_element else 'of '}{_element(row)}"


def _quantity(row: Difference) -> str:
    """Name the quantity of a difference, or the kind of the element if the element itself is in question."""
    is_whole = row.quantity is Quantity.PRESENCE or (row.is_geometry and row.quantity is Quantity.SHAPE)
    if is_whole:
        return row.element_kind
    return f"{row.quantity.value} of {row.element_kind}" if row.is_geometry else row.quantity.value


def _element(row: Difference) -> str:
    """Name the element of a difference, and the number of others with the same cause."""
    others = len(row.elements) - 1
    return row.element + (f" and {others} more" if others > 0 else "")


def _notes(comparison: FileComparison, unlisted: int) -> Iterator[str]:
    """Yield how bodies were paired, what was left out, and how many rows are not listed."""
    if unlisted > 0:
        yield f"{_counted(unlisted, 'more difference')}: --verbose lists all"
    alignment = comparison.alignment
    bodies = _counted(len(alignment.bodies), "body", "bodies")
    yield f"paired: {bodies} and {_counted(len(alignment.joints), 'joint')}"
    if comparison.motion.likeness is Likeness.DIFFERENT:
        yield (
            f"motion: RMS change of accelerations at {len(PHASES)} random states near the pose of the first "
            "file; other states can differ more"
        )
    if alignment.renamed:
        pairs = [f"{one} = {two}" for one, two in alignment.renamed]
        yield f"paired by structure, as names differ: {first_names(pairs, 3)}"
    yield from comparison.motion.notes
    if any(row.cause.endswith(IF_FLOATING) for row in comparison.differences):
        yield (
            "Neither URDF tells whether its base is fixed. If it is, --set-first base=fixed makes its mass a "
            "convention; base=free for both files lets it float."
        )
    if comparison.unmodeled:
        yield f"no compared motion has the forces of: {', '.join(comparison.unmodeled)}"
    if comparison.prescribed:
        yield (
            "not simulated, as prescribed motions are left out; to compare them, use `crosscheck loads` and "
            "`crosscheck run` for each file"
        )
    elif comparison.run:
        yield run_text(comparison.run)
    elif comparison.motion.likeness is not Likeness.UNDECIDED:
        yield no_run_text(comparison.motion)
    if conventions := comparison.of_standing(Standing.CONVENTION):
        shown = conventions[:MAX_CONVENTIONS]
        texts = [_with_values(row, FILES) + (f" ({row.cause})" if row.cause else "") for row in shown]
        others = len(conventions) - MAX_CONVENTIONS
        yield f"no effect on the motion: {'; '.join(texts)}{f' and {others} more' if others > 0 else ''}"
    rounded = comparison.of_standing(Standing.ROUNDING)
    if rounded and comparison.outcome is Outcome.DIFFERENT:
        total = sum(len(row.elements) for row in rounded)
        yield f"{_numbers_differ(total, 'more ')} within {_allowance(comparison)}"
    common = [note for note in comparison.first.notes if note in comparison.second.notes]
    yield from (f"note: both files: {note}" for note in common)
    for file, title in zip((comparison.first, comparison.second), _titles(comparison), strict=True):
        yield from (f"note: {title}: {note}" for note in file.notes if note not in common)
