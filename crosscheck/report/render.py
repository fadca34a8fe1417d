"""Reports as text for the terminal, Markdown, JSON and JUnit XML."""

from __future__ import annotations

import hashlib
import json
import os
import re
import textwrap
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, replace
from itertools import takewhile
from pathlib import Path
from typing import Any, TextIO
from xml.etree import ElementTree

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.padding import Padding
from rich.table import Table as RichTable
from rich.text import Text

from crosscheck.report.table import Cell, Lines, Part, Report, Rows, Table
from crosscheck.support.checksum import with_checksum

NARROWEST = 40
"""Characters of lines, however narrow a terminal is said to be."""

LONGEST = 32
"""Characters of words that are not folded."""

LEAST = 20
"""Characters of texts that are neither wrapped nor cut to fit another column beside them."""

GUTTER = 2
"""Characters between columns."""

INDENT = 2
"""Characters that rows below a heading are indented by."""

HEAD = 12
"""Characters of headings that are not wrapped to the width of the figures below."""

STYLES = {"": "", "holds": "green", "improved": "bold green", "doubtful": "yellow", "fails": "bold red"}
"""Terminal style of each verdict."""

MARKED = re.compile(r"[\\`*\[\]<|]|(?<!\w)_|_(?!\w)")
"""Characters that Markdown would take for its own; underscores within a word it does not."""


MAX_VALUE, VALUE_END = 120, 30
"""Characters of a value in an error line without blanks, and of its end that is shown if it is longer."""

MAX_LINE = 600
"""Characters of an error line."""


def printable(text: str) -> str:
    """Escape all characters but line breaks that are not shown as themselves.

    A name in a file may hold escape sequences of terminals, or characters that turn others round.
    """
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() or c in "\n\u00a0" else repr(c)[1:-1] for c in text)


def shortened_values(line: str) -> str:
    """Cut long values in the middle, as names of thousands of letters, and then what is too long a line."""
    words = [
        word if len(word) <= MAX_VALUE + VALUE_END else f"{word[:MAX_VALUE]}...{word[-VALUE_END:]}"
        for word in printable(line).split(" ")
    ]
    whole = " ".join(words)
    return whole if len(whole) <= MAX_LINE else f"{whole[: MAX_LINE // 2]} ... {whole[-MAX_LINE // 2 :]}"


def terminal(parts: Iterable[Part]) -> str:
    """Parts that are not folded, in color where standard output has it.

    Tables are as wide as the terminal, COLUMNS, or 80 where there is neither. Sentences wrap there at words;
    in files and pipes without COLUMNS each is one line.
    """
    console = Console()
    console.width = max(NARROWEST, console.width)
    with console.capture() as capture:
        before: Part | None = None
        for part in parts:
            if part.folded:
                continue
            if part.title and isinstance(before, Lines):
                console.print()
            before = part
            if part.title:
                console.print(Text(wrapped(part.title), style="bold"), soft_wrap=True)
            if isinstance(part, Table):
                for block in _blocks(part, console.width):
                    console.print(_rich_table(block, console.width))
                    console.print()
            else:
                for line in part.lines:
                    console.print(Text(wrapped(line)), soft_wrap=True)
    return "".join(f"{line.rstrip()}\n" for line in capture.get().splitlines())


def wrapped(line: str, stream: TextIO | None = None) -> str:
    """A sentence in lines of the terminal's width, the later ones indented.

    Args:
        stream: what it is written to; standard output if None. One that is no terminal, as a file that is
            searched later, gets the sentence as it is, unless COLUMNS is set.
    """
    line, console = printable(line), Console(file=stream)
    if not _has_width(console):
        return line
    indent = " " * (len(line) - len(line.lstrip()) + 2)
    return textwrap.fill(
        line,
        max(NARROWEST, console.width),
        subsequent_indent=indent,
        break_long_words=False,
        break_on_hyphens=False,
        replace_whitespace=False,
    )


def _has_width(console: Console) -> bool:
    """False for files and pipes, whose lines may be as long as they are."""
    return console.is_terminal or "COLUMNS" in os.environ


def _blocks(table: Table, width: int) -> Iterator[Table]:
    """A table, or where it is too wide several, each with the columns of text that it begins with."""
    least = [_least(table, number) + GUTTER for number in range(len(table.columns))]
    keys = list(takewhile(lambda number: not table.columns[number].numeric, range(len(least)))) or [0]
    if sum(least[number] for number in keys) > width / 2:
        keys = keys[:1]
    chosen = list(keys)
    for number in range(len(keys), len(least)):
        if len(chosen) > len(keys) and sum(least[k] for k in (*chosen, number)) - GUTTER > width:
            yield _of_columns(table, chosen)
            chosen = list(keys)
        chosen.append(number)
    yield _of_columns(table, chosen)


def _lines(table: Table, number: int) -> list[tuple[str, int]]:
    """Lines of the texts of a column, and the characters that each is indented by."""
    column = table.columns[number]
    found = [(line, 0) for line in column.heading.split("\n")]
    sections = number == 0 and any(isinstance(row, str) for row in table.rows)
    for row in table.rows:
        if isinstance(row, str):
            found += [(printable(row), 0)] if number == 0 else []
        elif number < len(row):
            lines = printable(_text(row[number])).split("\n")
            found += [(line, INDENT if sections else 0) for line in lines]
    return found


def _least(table: Table, number: int) -> int:
    """Characters that a column needs: figures as they are, texts as far as they do not wrap."""
    column, lines = table.columns[number], _lines(table, number)
    if not column.numeric:
        short = (
            (len(line) if len(line) <= LEAST else max(map(len, line.split()), default=0), indent)
            for line, indent in lines
        )
        return max(min(LONGEST, length) + indent for length, indent in short)
    heads = column.heading.split("\n")
    words = [len(word) for word in column.heading.split()]
    figures = [len(line) + indent for line, indent in lines[len(heads) :]]
    return max([*figures, *words, *(min(HEAD, len(line)) for line in heads)])


def _widths(table: Table, width: int) -> list[int]:
    """Characters of each column in a terminal; texts that wrap share what the least widths leave."""
    numbers = range(len(table.columns))
    widths = [_least(table, number) for number in numbers]
    room = width - sum(widths) - GUTTER * (len(widths) - 1)
    whole = [max(len(line) + indent for line, indent in _lines(table, number)) for number in numbers]
    wrapping = [number for number in numbers if not table.columns[number].numeric]
    for count, number in enumerate(sorted(wrapping, key=lambda number: whole[number] - widths[number])):
        more = max(0, min(whole[number] - widths[number], room // (len(wrapping) - count)))
        widths[number] += more
        room -= more
    return widths


def _of_columns(table: Table, numbers: Sequence[int]) -> Table:
    """A table of some columns of another."""
    if len(numbers) == len(table.columns):
        return table
    rows: Rows = [
        row if isinstance(row, str) else [row[k] if k < len(row) else "" for k in numbers]
        for row in table.rows
    ]
    return replace(table, columns=[table.columns[k] for k in numbers], rows=rows)


def _text(cell: str | Cell) -> str:
    return cell if isinstance(cell, str) else cell.text


def _heading(table: Table, number: int) -> str:
    """The heading of a column, in lines as wide as its figures."""
    column = table.columns[number]
    if not column.numeric:
        return column.heading
    width = _least(table, number)
    return "\n".join(textwrap.fill(line, width) for line in column.heading.split("\n"))


def _rich_table(table: Table, width: int) -> RichTable:
    drawn = RichTable(box=SIMPLE_HEAD, pad_edge=False, show_edge=False, collapse_padding=True)
    if not table.title:
        drawn.box, drawn.padding = None, (0, GUTTER, 0, 0)
    drawn.show_header = any(column.heading for column in table.columns)
    for number, (column, each) in enumerate(zip(table.columns, _widths(table, width), strict=True)):
        drawn.add_column(
            Text(printable(_heading(table, number))),
            justify="right" if column.numeric else "left",
            no_wrap=column.numeric,
            overflow="fold",
            width=each,
        )
    indent = INDENT if any(isinstance(row, str) for row in table.rows) else 0
    for row in table.rows:
        if isinstance(row, str):
            drawn.add_section()
            drawn.add_row(Text(printable(row), style="bold"))
        else:
            cells = [cell if isinstance(cell, Cell) else Cell(cell) for cell in row]
            shown = [Text(printable(cell.text), style=STYLES[cell.verdict]) for cell in cells]
            drawn.add_row(Padding(shown[0], (0, 0, 0, indent)), *shown[1:])
    return drawn


def markdown(report: Report, folded: bool = False, links: Mapping[str, str] | None = None) -> str:
    """A document; its folded parts only if they are asked for, its heading if the report has a title.

    Args:
        links: addresses of bodies and joints by name, for cells that are about one.
    """
    lines = [f"# {_escaped(report.title)}", ""] if report.title else []
    if report.verdict:
        lines += [f"**{_escaped(report.verdict)}**", ""]
    for part in report.parts:
        if folded or not part.folded:
            lines += [*_markdown(part, links), ""]
    return "\n".join(lines).rstrip() + "\n"


def _markdown(part: Part, links: Mapping[str, str] | None) -> Iterator[str]:
    if part.title:
        yield from (f"## {_escaped(part.title)}", "")
    if isinstance(part, Lines):
        yield from (f"- {_escaped(line.strip())}" for line in part.lines)
    else:
        yield from markdown_table(part, links)


def markdown_table(table: Table, links: Mapping[str, str] | None = None) -> Iterator[str]:
    """The lines of a table alone; what fails is bold."""
    links = links or {}
    yield _markdown_row([column.heading for column in table.columns], links)
    yield "|" + "".join("---:|" if column.numeric else "---|" for column in table.columns)
    for row in table.rows:
        if isinstance(row, str):
            yield f"| **{_escaped(row)}** |" + " |" * (len(table.columns) - 1)
        else:
            yield _markdown_row(row, links)


def _markdown_row(cells: Iterable[str | Cell], links: Mapping[str, str]) -> str:
    texts = []
    for cell in (cell if isinstance(cell, Cell) else Cell(cell) for cell in cells):
        text = _escaped(cell.text)
        if cell.about in links:
            name = _escaped(cell.about)
            text = text.replace(name, f"[{name}]({links[cell.about]})", 1)
        texts.append(f"**{text}**" if cell.verdict in ("fails", "doubtful") else text)
    return f"| {' | '.join(texts)} |"


def _escaped(text: str) -> str:
    """Text that Markdown shows as it is."""
    return MARKED.sub(r"\\\g<0>", printable(text)).replace("\n", ", ")


def as_json(content: Mapping[str, Any], report: Report, files: Mapping[Path, bytes] | None = None) -> bytes:
    """Results as JSON: data, the report on them, SHA-256 of files beside them that pages show, a checksum."""
    digests = {path.name: hashlib.sha256(held).hexdigest() for path, held in (files or {}).items()}
    whole = _finite({**content, "report": asdict(report), "files": digests})
    # as a reader finds it: keys that are numbers here are texts there
    whole = json.loads(json.dumps(whole, allow_nan=False))
    return (json.dumps(with_checksum(whole), indent=1) + "\n").encode()


def _finite(value: object) -> Any:
    """JSON has no numbers that are not finite; such a figure is its text."""
    if isinstance(value, float):
        return value if abs(value) < float("inf") else repr(value)
    if isinstance(value, Mapping):
        return {name: _finite(entry) for name, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(entry) for entry in value]
    return value


def junit(report: Report) -> str:
    """JUnit XML: a suite per table with judged cells, a case per row.

    A row that fails has its cells as the failure's message, a row that improved has them as its output.
    """
    root = ElementTree.Element(
        "testsuites", name=printable(report.title), time=f"{report.wall_time or 0.0:.3f}"
    )
    for part in report.parts:
        if isinstance(part, Lines):
            continue
        rows = [(head, row) for head, row in part.sections() if any(cell.verdict for cell in row)]
        failed = sum(any(cell.verdict == "fails" for cell in row) for _, row in rows)
        if not rows:
            continue
        suite = ElementTree.SubElement(
            root,
            "testsuite",
            name=printable(part.title),
            tests=str(len(rows)),
            failures=str(failed),
            errors="0",
            time="0",
        )
        for heading, row in rows:
            owner = f"{part.title}.{heading}" if heading else part.title
            case = ElementTree.SubElement(
                suite, "testcase", classname=printable(owner), name=printable(row[0].text), time="0"
            )
            message = printable(f"{heading}: {row[0].text}: {_worded(part, row)}".removeprefix(": "))
            verdicts = {cell.verdict for cell in row}
            if "improved" in verdicts:
                ElementTree.SubElement(case, "system-out").text = message
            if "fails" in verdicts:
                failure = ElementTree.SubElement(case, "failure", message=message)
                failure.text = printable(report.verdict)
    ElementTree.indent(root, " ")
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ElementTree.tostring(root, encoding="unicode") + "\n"


def _worded(table: Table, row: Sequence[Cell]) -> str:
    """The cells of a row but the first, each with its heading."""
    named = zip(table.columns[1:], row[1:], strict=False)
    return ", ".join(f"{column.heading} {cell.text}".strip() for column, cell in named if cell.text)
