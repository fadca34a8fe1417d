"""Write reports as text for the terminal, as Markdown, as JSON and as JUnit XML.

In: a `Report` of tables and sentences, see `crosscheck.report.table`. Out: texts. A part of a report that is
"folded" is shown on demand on HTML pages; the terminal and, by default, Markdown leave it out. Start reading
at `terminal`, `markdown`, `as_json` and `junit`.
"""

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

from crosscheck.compare.outcome import Verdict
from crosscheck.report.table import Cell, Lines, Part, Report, Rows, Table
from crosscheck.support.checksum import with_checksum

MIN_LINE_WIDTH = 40
"""Smallest width of lines, characters, even if the terminal is narrower."""

MAX_WORD_WIDTH = 32
"""Width, characters, up to which a word stays in one line."""

MAX_UNWRAPPED_TEXT = 20
"""Width, characters, up to which a text in a cell is never wrapped."""

GUTTER = 2
"""Space between columns, characters."""

INDENT = 2
"""Indentation of rows below a heading of rows, characters."""

MAX_UNWRAPPED_HEADING = 12
"""Width, characters, up to which the heading of a column of numbers is never wrapped."""

STYLES = {"": "", "holds": "green", "improved": "bold green", "doubtful": "yellow", "fails": "bold red"}
"""Terminal style of a cell or a sentence by its verdict; "improved" is a cost or error below the baseline."""

MARKDOWN_SYNTAX = re.compile(
    r"(?P<code>`[^`|\n]+`)|(?P<tag></?[A-Za-z][\w:.-]*(?: [^<>`|\n]*)?>)"
    r"|(?P<entity><|&(?=#?\w+;))|[\\`*\[\]|]|(?<!\w)_|_(?!\w)"
)
"""Code, tags such as `<joint>`, and characters that are syntax in Markdown; not underscores within a word.

A backslash before `<` is no escape in all dialects of Markdown, so that `<` becomes an entity.
"""

WORD_START, WORD_END = 120, 30
"""Numbers of characters that an error message shows of the beginning and of the end of a longer word."""

MAX_LINE = 600
"""Largest number of characters of an error message."""


def printable(text: str) -> str:
    """Escape all characters that are not printable, except line breaks.

    A name in a model file may contain escape sequences of terminals, or characters that reverse the writing
    direction.
    """
    if text.isprintable():
        return text
    # a no-break space is not printable in Python's sense, but harmless
    return "".join(c if c.isprintable() or c in "\n\u00a0" else repr(c)[1:-1] for c in text)


def shorten_words(line: str) -> str:
    """Shorten an error message: cut the middle of very long words, such as names, and of a long message."""
    words = [
        word if len(word) <= WORD_START + WORD_END else f"{word[:WORD_START]}...{word[-WORD_END:]}"
        for word in printable(line).split(" ")
    ]
    whole = " ".join(words)
    return whole if len(whole) <= MAX_LINE else f"{whole[: MAX_LINE // 2]} ... {whole[-MAX_LINE // 2 :]}"


def terminal(parts: Iterable[Part]) -> str:
    """Format the parts of a report that are not folded as text for standard output, in color if supported.

    The width is that of the terminal, or the environment variable COLUMNS, or 80 if there is neither.
    Sentences are wrapped at words. A file or a pipe without COLUMNS gets each sentence in one line.
    """
    console = Console()
    console.width = max(MIN_LINE_WIDTH, console.width)
    with console.capture() as capture:
        previous: Part | None = None
        for part in parts:
            if part.folded:
                continue
            if isinstance(previous, Lines) and (part.title or isinstance(part, Table)):
                console.print()
            previous = part
            if part.title:
                console.print(Text(wrapped(part.title), style="bold"), soft_wrap=True)
            if isinstance(part, Table):
                for block in _split_columns(part, console.width):
                    for drawn in _rich_tables(block, console.width):
                        console.print(drawn)
                    console.print()
            else:
                for number, line in enumerate(part.lines):
                    style = "" if number else STYLES[part.verdict]  # the verdict is of the first sentence
                    console.print(Text(wrapped(line), style=style), soft_wrap=True)
    return "".join(f"{line.rstrip()}\n" for line in capture.get().splitlines())


def wrapped(line: str, stream: TextIO | None = None) -> str:
    """Wrap a sentence at the width of the terminal; later lines are indented.

    Args:
        line: the sentence.
        stream: stream that the sentence is written to; standard output if None. For a file or a pipe, the
            sentence is not wrapped, so that it can be searched, unless the variable COLUMNS is set.
    """
    line, console = printable(line), Console(file=stream)
    if not _has_width(console):
        return line
    indent = " " * (len(line) - len(line.lstrip()) + 2)
    return textwrap.fill(
        line,
        max(MIN_LINE_WIDTH, console.width),
        subsequent_indent=indent,
        break_long_words=False,
        break_on_hyphens=False,
        replace_whitespace=False,
    )


def _has_width(console: Console) -> bool:
    """Return False for a file or a pipe, in which lines may have any length, unless COLUMNS is set."""
    return console.is_terminal or "COLUMNS" in os.environ


def _split_columns(table: Table, width: int) -> Iterator[Table]:
    """Split a table that is wider than `width` characters into several tables with some of its columns.

    Each table begins with the columns of text at the beginning of the original table.
    """
    min_widths = [_min_width(table, number) + GUTTER for number in range(len(table.columns))]
    # columns of text that all tables begin with: at least one column, and at most half of the width
    texts_first = takewhile(lambda number: not table.columns[number].numeric, range(1, len(min_widths)))
    repeated = [0, *takewhile(lambda number: sum(min_widths[: number + 1]) <= width / 2, texts_first)]
    # add further columns until the width is exceeded
    chosen = list(repeated)
    for number in range(len(repeated), len(min_widths)):
        has_others = len(chosen) > len(repeated)
        if has_others and sum(min_widths[k] for k in (*chosen, number)) - GUTTER > width:
            yield _select_columns(table, chosen)
            chosen = list(repeated)
        chosen.append(number)
    yield _select_columns(table, chosen)


def _column_lines(table: Table, number: int) -> list[tuple[str, int]]:
    """Return the lines of all cells of a column, the heading first, each with its indentation, characters.

    Rows of a table are lists of cells, or a text that is the heading of the rows below, which are indented.
    """
    column = table.columns[number]
    lines = [(line, 0) for line in column.heading.split("\n")]
    indent = INDENT if number == 0 and _has_headings(table) else 0
    for row in table.rows:
        if not isinstance(row, str) and number < len(row):
            lines += [(line, indent) for line in printable(_text(row[number])).split("\n")]
    return lines


def _has_headings(table: Table) -> bool:
    """Return True if the table has headings of rows."""
    return any(isinstance(row, str) for row in table.rows)


def _min_width(table: Table, number: int) -> int:
    """Compute the smallest width of a column, characters: numbers are not wrapped, long texts are."""
    column, lines = table.columns[number], _column_lines(table, number)
    if not column.numeric:
        widths = []
        for line, indent in lines:
            longest_word = max(map(len, line.split()), default=0)
            length = len(line) if len(line) <= MAX_UNWRAPPED_TEXT else longest_word
            widths.append(min(MAX_WORD_WIDTH, length) + indent)
        return max(widths)
    heading_lines = column.heading.split("\n")
    words = [len(word) for word in column.heading.split()]
    numbers = [len(line) + indent for line, indent in lines[len(heading_lines) :]]
    return max([*numbers, *words, *(min(MAX_UNWRAPPED_HEADING, len(line)) for line in heading_lines)])


def _column_widths(table: Table, width: int) -> list[int]:
    """Compute the width of each column, characters, in a table of at most `width` characters.

    Columns get their smallest width first. Columns of text share the rest equally; those that need least come
    first, so that others get what they do not need.
    """
    numbers = range(len(table.columns))
    widths = [_min_width(table, number) for number in numbers]
    room = width - sum(widths) - GUTTER * (len(widths) - 1)
    unwrapped = [max(len(line) + indent for line, indent in _column_lines(table, k)) for k in numbers]
    of_text = [number for number in numbers if not table.columns[number].numeric]
    for count, number in enumerate(sorted(of_text, key=lambda number: unwrapped[number] - widths[number])):
        more = max(0, min(unwrapped[number] - widths[number], room // (len(of_text) - count)))
        widths[number] += more
        room -= more
    return widths


def _select_columns(table: Table, numbers: Sequence[int]) -> Table:
    """Make a table of some columns of another table, given by their numbers."""
    if len(numbers) == len(table.columns):
        return table
    rows: Rows = [
        row if isinstance(row, str) else [row[k] if k < len(row) else "" for k in numbers]
        for row in table.rows
    ]
    return replace(table, columns=[table.columns[k] for k in numbers], rows=rows)


def _text(cell: str | Cell) -> str:
    """Return the text of a cell."""
    return cell if isinstance(cell, str) else cell.text


def _heading(table: Table, number: int) -> str:
    """Return the heading of a column; for a column of numbers, wrapped to the width of the column."""
    column = table.columns[number]
    if not column.numeric:
        return column.heading
    width = _min_width(table, number)
    return "\n".join(textwrap.fill(line, width) for line in column.heading.split("\n"))


def _rich_tables(table: Table, width: int) -> Iterator[RichTable | Text]:
    """Convert a table to tables of the package rich, at most `width` characters wide.

    Each table has the rows below a heading of rows, which is a text between the tables. Only the first table
    has the headings of the columns.
    """
    drawn = _empty_rich_table(table, width)
    drawn.show_header = any(column.heading for column in table.columns)
    indent = INDENT if _has_headings(table) else 0
    for row in table.rows:
        if isinstance(row, str):
            if drawn.rows or drawn.show_header:
                yield drawn
            if drawn.rows:
                yield Text()
            yield Text(textwrap.fill(printable(row), width), style="bold")
            drawn = _empty_rich_table(table, width)
        else:
            cells = [cell if isinstance(cell, Cell) else Cell(cell) for cell in row]
            shown = [Text(printable(cell.text), style=STYLES[cell.verdict]) for cell in cells]
            drawn.add_row(Padding(shown[0], (0, 0, 0, indent)), *shown[1:])
    yield drawn


def _empty_rich_table(table: Table, width: int) -> RichTable:
    """Return a table of the package rich with the columns of a table, without rows and header."""
    drawn = RichTable(box=SIMPLE_HEAD, pad_edge=False, show_edge=False, collapse_padding=True)
    drawn.show_header = False
    if not table.title:  # no rule below the headings
        drawn.box, drawn.padding = None, (0, GUTTER, 0, 0)
    column_widths = _column_widths(table, width)
    for number, (column, column_width) in enumerate(zip(table.columns, column_widths, strict=True)):
        drawn.add_column(
            Text(printable(_heading(table, number))),
            justify="right" if column.numeric else "left",
            no_wrap=column.numeric,
            overflow="fold",
            width=column_width,
        )
    return drawn


def markdown(report: Report, folded: bool = False, links: Mapping[str, str] | None = None) -> str:
    """Write a report as a Markdown document.

    Args:
        report: the report.
        folded: whether to include folded parts.
        links: addresses by names of bodies and joints. In a cell about one of these (`Cell.about`), the name
            becomes a link.
    """
    lines = [f"# {_escaped(report.title)}", ""] if report.title else []
    if report.verdict:
        lines += [f"**{_escaped(report.verdict)}**", ""]
    for part in report.parts:
        if folded or not part.folded:
            lines += [*_markdown(part, links), ""]
    return "\n".join(lines).rstrip() + "\n"


def _markdown(part: Part, links: Mapping[str, str] | None) -> Iterator[str]:
    """Yield the Markdown lines of one part of a report; `links` as of `markdown`."""
    if part.title:
        yield from (f"## {_escaped(part.title)}", "")
    if isinstance(part, Lines):
        for number, line in enumerate(part.lines):
            text = _escaped(line.strip())
            is_bold = not number and part.verdict in ("fails", "doubtful")
            yield f"- **{text}**" if is_bold else f"- {text}"
    else:
        yield from markdown_table(part, links)


def markdown_table(table: Table, links: Mapping[str, str] | None = None) -> Iterator[str]:
    """Yield the Markdown lines of a table, without its title; failing and doubtful cells are bold."""
    links = links or {}
    yield _markdown_row([column.heading for column in table.columns], links)
    yield "|" + "".join("---:|" if column.numeric else "---|" for column in table.columns)
    for row in table.rows:
        if isinstance(row, str):
            yield f"| **{_escaped(row)}** |" + " |" * (len(table.columns) - 1)
        else:
            yield _markdown_row(row, links)


def _markdown_row(cells: Iterable[str | Cell], links: Mapping[str, str]) -> str:
    """Write a row of a table in Markdown; `links` as of `markdown`."""
    texts = []
    for cell in (cell if isinstance(cell, Cell) else Cell(cell) for cell in cells):
        text = _escaped(cell.text)
        if cell.about in links:
            name = _escaped(cell.about)
            text = text.replace(name, f"[{name}]({links[cell.about]})", 1)
        texts.append(f"**{text}**" if text and cell.verdict in ("fails", "doubtful") else text)
    return f"| {' | '.join(texts)} |"


def _escaped(text: str) -> str:
    """Escape a text so that Markdown shows it unchanged; line breaks become commas, and tags become code."""

    def escape(found: re.Match[str]) -> str:
        match found.lastgroup:
            case "code":
                return found[0]
            case "tag":
                return f"`{found[0]}`"
            case "entity":
                return "&lt;" if found[0] == "<" else "&amp;"
            case _:
                return f"\\{found[0]}"

    return MARKDOWN_SYNTAX.sub(escape, printable(text)).replace("\n", ", ")


def as_json(content: Mapping[str, Any], report: Report, files: Mapping[Path, bytes] | None = None) -> bytes:
    """Make the content of a JSON result file.

    Args:
        content: results of the command.
        report: report on the results, for the HTML pages of `crosscheck report`.
        files: contents, by path, of runs, recordings and pictures that the command writes to the same folder.
            The JSON file has their SHA-256, by which a page detects files of other results.
    """
    digests = {path.name: hashlib.sha256(data).hexdigest() for path, data in (files or {}).items()}
    all_fields = _without_non_finite({**content, "report": asdict(report), "files": digests})
    # through JSON once, since the checksum is of the content as read: keys that are numbers become texts
    all_fields = json.loads(json.dumps(all_fields, allow_nan=False))
    return (json.dumps(with_checksum(all_fields), indent=1) + "\n").encode()


def _without_non_finite(value: object) -> Any:
    """Replace numbers that are not finite, which JSON does not have, by texts such as "nan"."""
    if isinstance(value, float):
        return value if abs(value) < float("inf") else repr(value)
    if isinstance(value, Mapping):
        return {name: _without_non_finite(entry) for name, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_without_non_finite(entry) for entry in value]
    return value


def junit(report: Report) -> str:
    """Write a report as JUnit XML, which CI servers show: a test suite per table, a test case per row.

    Tables without judged cells are left out. The cells of a failing row are the message of the failure, and
    also its text, as GitLab shows the text only. A doubtful row is a skipped test case; the cells of a row
    that has improved are the output of its test case.
    """
    root = ElementTree.Element(
        "testsuites", name=printable(report.title), time=f"{report.wall_time or 0.0:.3f}"
    )
    for part in report.parts:
        if isinstance(part, Lines):
            continue
        # rows with judged cells, each with the heading above
        rows = [(heading, row) for heading, row in part.sections() if any(cell.verdict for cell in row)]
        if not rows:
            continue
        results = [_junit_result(row) for _, row in rows]
        suite = ElementTree.SubElement(
            root,
            "testsuite",
            name=printable(part.title),
            tests=str(len(rows)),
            failures=str(results.count("failure")),
            errors="0",
            skipped=str(results.count("skipped")),
            time="0",
        )
        for (heading, row), result in zip(rows, results, strict=True):
            class_name = f"{part.title}.{heading}" if heading else part.title
            case = ElementTree.SubElement(
                suite, "testcase", classname=printable(class_name), name=printable(row[0].text), time="0"
            )
            message = printable(f"{heading}: {row[0].text}: {_row_text(part, row)}".removeprefix(": "))
            if result:
                attributes = {} if result == "system-out" else {"message": message}
                ElementTree.SubElement(case, result, attributes).text = message
    ElementTree.indent(root, " ")
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ElementTree.tostring(root, encoding="unicode") + "\n"


def _junit_result(row: Sequence[Cell]) -> str:
    """Return the name of the XML element with the result of a row's test case; "" if the row just passes."""
    verdicts = {cell.verdict for cell in row}
    elements: dict[Verdict, str] = {"fails": "failure", "doubtful": "skipped", "improved": "system-out"}
    return next((element for verdict, element in elements.items() if verdict in verdicts), "")


def _row_text(table: Table, row: Sequence[Cell]) -> str:
    """Describe a row in a line: all cells except the first, each with the heading of its column."""
    cells = zip(table.columns[1:], row[1:], strict=False)  # a row may be shorter than the table
    texts = [f"{column.heading} {cell.text}".strip() for column, cell in cells if cell.text]
    return ", ".join(texts).replace("\n", " ")
