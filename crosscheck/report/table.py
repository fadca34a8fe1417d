"""Tables and reports, independent of the format in which they are written.

Commands make a `Report` of their results. `crosscheck.report.render` writes reports as text for a terminal,
Markdown, JSON and JUnit XML, and `crosscheck.report.page` as HTML.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

from crosscheck.compare.outcome import Verdict
from crosscheck.report.chart import BarChart
from crosscheck.support.units import SECONDS_AND_MS, quantity_text


@dataclass(frozen=True)
class Cell:
    """One cell of a table.

    Attributes:
        text: text of the cell.
        verdict: judgment, such as "holds" or "fails", which selects the color of the cell; "" for none.
        about: body, joint or time that the cell is about, or an explanation; pages show it when the mouse
            points at the cell.
    """

    text: str
    verdict: Verdict = ""
    about: str = ""


@dataclass(frozen=True)
class Column:
    """A column of a table.

    Attributes:
        name: name, which may have several lines.
        unit: unit of all numbers in the column.
        numeric: whether the column has numbers, which are aligned at the right and never wrapped.
        below: for the last column: whether pages move it below the other columns on narrow screens.
        choice: whether pages let the user choose the rows with one of the texts in the column.
    """

    name: str
    unit: str = ""
    numeric: bool = False
    below: bool = False
    choice: bool = False

    @property
    def heading(self) -> str:
        """Name and unit."""
        return f"{self.name}, {self.unit}" if self.unit else self.name


Rows = list[list[str | Cell] | str]
"""Rows of a table: each is a list of cells, or a text that is the heading of the rows after it."""


@dataclass(frozen=True)
class Table:
    """Rows of cells under columns.

    Attributes:
        title: title of the table; a table without one is printed without a rule below its headings.
        columns: columns, as many as the longest row has cells.
        rows: rows of cells, and headings of rows.
        folded: whether pages show the table on demand, and the terminal does not show it.
    """

    title: str
    columns: list[Column]
    rows: Rows
    folded: bool = False

    @property
    def has_filters(self) -> bool:
        """True if pages have filters for the rows."""
        return any(column.choice for column in self.columns)

    def sections(self) -> Iterator[tuple[str, list[Cell]]]:
        """Yield the rows of cells, each with the heading that it stands below."""
        heading = ""
        for row in self.rows:
            if isinstance(row, str):
                heading = row
            else:
                yield heading, [cell if isinstance(cell, Cell) else Cell(cell) for cell in row]


@dataclass(frozen=True)
class Lines:
    """Sentences, one per line.

    Attributes:
        title: title of the sentences; may be empty.
        lines: the sentences.
        folded: whether pages show the sentences on demand, and the terminal does not show them.
        verdict: judgment of the first sentence, which selects its color as in a `Cell`.
    """

    title: str
    lines: list[str]
    folded: bool = False
    verdict: Verdict = ""


Part = Table | Lines
"""Part of a report."""


@dataclass(frozen=True)
class Report:
    """Results of one command.

    Attributes:
        title: the command and the model.
        verdict: the result in one sentence; not a judgment like `Cell.verdict`.
        judged: the result in one word such as "AGREE", with its judgment.
        parts: tables and sentences, in order; the terminal shows them with `--verbose`.
        wall_time: run time of the command, s; None if it was not measured.
        summary: short tables and sentences, which the terminal always shows last. Pages show them on demand,
            before the `parts` that are not among them.
        charts: bar charts, which pages show below the verdict.
        captions: caption of each picture (PNG) that the command wrote, by the name of the file.
        next_steps: what the reader can do with the result, a sentence each, in which commands and names of
            files are between backticks; pages show them below the pictures.
    """

    title: str
    verdict: str
    judged: Cell
    parts: list[Part]
    wall_time: float | None = None
    summary: list[Part] = field(default_factory=list)
    charts: list[BarChart] = field(default_factory=list)
    captions: dict[str, str] = field(default_factory=dict)
    next_steps: list[str] = field(default_factory=list)

    @property
    def headline(self) -> tuple[str, str]:
        """Verdict, split into the words in capitals at its beginning ("" if there are none) and the rest."""
        words, _, rest = self.verdict.partition(": ")
        return (words, rest) if words.isupper() else ("", self.verdict)

    @property
    def answer(self) -> tuple[str, str]:
        """Verdict for pages: the word of the result in capitals ("" if there is none), and a sentence."""
        word, sentence = self.headline
        return word or self.judged.text.upper(), sentence

    @property
    def judgments(self) -> list[tuple[Verdict, str]]:
        """Judged sentences of the summary with their judgments, such as the error of the file's settings."""
        lines = [part for part in self.summary if isinstance(part, Lines) and part.verdict]
        return [(part.verdict, part.lines[0]) for part in lines]


def text_columns(*names: str) -> list[Column]:
    """Make columns of text with these names."""
    return [Column(name) for name in names]


def number_columns(*names: str) -> list[Column]:
    """Make columns of numbers with these names; a unit follows the last comma of a name, as in "time, s"."""
    columns = []
    for name in names:
        before, comma, after = name.rpartition(", ")
        if comma:
            columns.append(Column(before, unit=after, numeric=True))
        else:
            columns.append(Column(name, numeric=True))
    return columns


def checked_cell(value: float, allowed: float, agrees: bool, about: str = "") -> Cell:
    """Make the cell of a value and its tolerance, such as "1.2e-09 < 1e-06".

    Args:
        value: the value.
        allowed: its tolerance.
        agrees: whether the check passes; also True for a check that is not judged, whatever its value is.
        about: body, joint or time of the value.
    """
    text = f"{value:.1e} {'<' if value <= allowed else '>'} {allowed:.0e}"
    return Cell(text, "holds" if agrees else "fails", about)


def name_value_table(title: str, content: Mapping[str, Any], folded: bool = False) -> Table:
    """Make a table with a row for each name and its value; columns have no headings."""
    rows: Rows = [[name, _text(value)] for name, value in content.items()]
    return Table(title, text_columns("", ""), rows, folded)


def _text(value: object) -> str:
    """Format a value of JSON as text, numbers with 6 digits."""
    if isinstance(value, Mapping):
        return "\n".join(f"{name}: {_text(entry)}" for name, entry in value.items())
    if isinstance(value, list | tuple):
        return ", ".join(map(_text, value))
    if value is None:
        return ""
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def seconds(value: float) -> str:
    """Format a duration, given in s, in seconds or milliseconds."""
    return quantity_text(value, SECONDS_AND_MS)
