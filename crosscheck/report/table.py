"""Tables and reports, independent of the format that they are written in.

Commands make them of their results; `crosscheck.report.render` writes them as text for a terminal, Markdown,
JSON and JUnit XML, and `crosscheck.report.page` as HTML.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

Verdict = Literal["", "holds", "improved", "doubtful", "fails"]
"""Judgment of a cell; empty for a cell without one."""


@dataclass(frozen=True)
class Cell:
    """One entry of a table.

    Attributes:
        text: the entry.
        verdict: how it is judged.
        about: body, joint or time that it is of, shown on demand.
    """

    text: str
    verdict: Verdict = ""
    about: str = ""


@dataclass(frozen=True)
class Column:
    """A column of a table.

    Attributes:
        name: may have several lines.
        unit: of all its figures.
        numeric: whether it holds figures, aligned at the right and never wrapped.
        below: whether pages put it, if it is the last one, below the others on narrow screens.
    """

    name: str
    unit: str = ""
    numeric: bool = False
    below: bool = False

    @property
    def heading(self) -> str:
        return f"{self.name}, {self.unit}" if self.unit else self.name


Rows = list[list[str | Cell] | str]
"""Rows of cells, or one text that heads the rows after it."""


@dataclass(frozen=True)
class Table:
    """Rows of cells under columns.

    Attributes:
        title: of the table; one without is drawn without a rule.
        columns: as many as the longest row has cells.
        rows: see `Rows`.
        folded: whether pages show it on demand and the terminal not at all.
    """

    title: str
    columns: list[Column]
    rows: Rows
    folded: bool = False

    def sections(self) -> Iterator[tuple[str, list[Cell]]]:
        """Rows of cells, each with the text that heads it."""
        heading = ""
        for row in self.rows:
            if isinstance(row, str):
                heading = row
            else:
                yield heading, [cell if isinstance(cell, Cell) else Cell(cell) for cell in row]


@dataclass(frozen=True)
class Lines:
    """Sentences, one per line; `folded` as of a `Table`."""

    title: str
    lines: list[str]
    folded: bool = False


Part = Table | Lines


@dataclass(frozen=True)
class Report:
    """Results of one command.

    Attributes:
        title: what was done to what.
        verdict: the results in one line.
        judged: the verdict in one word.
        parts: tables and sentences, in order.
        wall_time: s; None if it was not measured.
        summary: what the terminal shows of the parts unless all are asked for.
    """

    title: str
    verdict: str
    judged: Cell
    parts: list[Part]
    wall_time: float | None = None
    summary: list[Part] = field(default_factory=list)

    @property
    def headline(self) -> tuple[str, str]:
        """The word in capitals that the verdict begins with, empty if there is none, and what follows it."""
        word, _, found = self.verdict.partition(": ")
        return (word, found) if word.isupper() else ("", self.verdict)


def texts(*names: str) -> list[Column]:
    """Columns of text."""
    return [Column(name) for name in names]


def figures(*names: str) -> list[Column]:
    """Columns of figures; a unit follows the last comma of a name."""
    pairs = [name.rpartition(", ") for name in names]
    return [Column(name or unit, unit if name else "", True) for name, _, unit in pairs]


def judged(value: float, allowed: float, agrees: bool, about: str = "") -> Cell:
    """A figure beside the largest value that it may have."""
    text = f"{value:.1e} {'<' if value <= allowed else '>'} {allowed:.0e}"
    return Cell(text, "holds" if agrees else "fails", about)


def entries(title: str, content: Mapping[str, Any], folded: bool = False) -> Table:
    """A table of names and values."""
    rows: Rows = [[name, _text(value)] for name, value in content.items()]
    return Table(title, texts("", ""), rows, folded)


def _text(value: object) -> str:
    """A value of JSON; numbers with as many digits as people read."""
    if isinstance(value, Mapping):
        return "\n".join(f"{name}: {_text(entry)}" for name, entry in value.items())
    if isinstance(value, list | tuple):
        return ", ".join(map(_text, value))
    if value is None:
        return ""
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def seconds(value: float) -> str:
    """Word a duration, s, in seconds or milliseconds."""
    return f"{value:.3g} s" if value >= 1.0 else f"{1e3 * value:.3g} ms"
