"""The parts of a page. Text is escaped here, where it becomes HTML, and nowhere else."""

from __future__ import annotations

import base64
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from html import escape
from pathlib import Path
from statistics import median
from typing import Any, NamedTuple

from crosscheck.errors import CrosscheckError
from newton_euler.model.source_file import SourceError, read_content

STYLE = """
body { font: 15px/1.45 system-ui, sans-serif; max-width: 75rem; margin: 2rem auto; padding: 0 1rem; }
h2 { margin-top: 2.5rem; border-bottom: 1px solid #ccc; }
table { border-collapse: collapse; margin: 0.8rem 0; display: block; overflow-x: auto; }
th, td { padding: 0.15rem 0.7rem; text-align: left; vertical-align: top; border-bottom: 1px solid #eee; }
td.figure { font-family: ui-monospace, monospace; white-space: nowrap; }
th.level { background: #f4f4f4; }
.holds { color: #046b43; }
.fails { color: #b00020; font-weight: bold; }
.verdict { font-size: 1.15rem; padding: 0.6rem 1rem; border-left: 5px solid currentColor; }
figure { margin: 1rem 0; }
img { max-width: 100%; }
"""


PNG = b"\x89PNG\r\n\x1a\n"
"""What every PNG file begins with."""

MOST_NUMBERS = 9
"""That are listed; of more the median and the range are shown."""

Progress = Callable[[str], None]


class Markup(str):
    """Text that is HTML already."""


class Cell(NamedTuple):
    """A figure in a table: its text, how it is judged ("holds", "fails" or ""), and what it is about."""

    text: str
    judged: str = ""
    about: str = ""


def page(title: str, parts: Iterable[Markup]) -> str:
    """A whole page; nothing in it is fetched from anywhere."""
    policy = "default-src 'none'; img-src data:; style-src 'unsafe-inline'"
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        f'<meta http-equiv="Content-Security-Policy" content="{policy}">\n'
        f"<title>{escape(title)}</title>\n<style>{STYLE}</style>\n</head>\n<body>\n"
        + "\n".join(parts)
        + "\n</body>\n</html>\n"
    )


def heading(text: str, level: int = 2, anchor: str = "") -> Markup:
    named = f' id="{escape(anchor)}"' if anchor else ""
    return Markup(f"<h{level}{named}>{escape(text)}</h{level}>")


def paragraph(text: str, kind: str = "") -> Markup:
    return Markup(f'<p class="{escape(kind)}">{escape(text)}</p>')


def verdict(text: str, judged: Cell, wall_time: float | None) -> Markup:
    """What was found, in a line."""
    took = "" if wall_time is None else f" ({wall_time:.3g} s)"
    return paragraph(text + took, f"verdict {judged.judged}".strip())


def link(text: str, anchor: str) -> Markup:
    """To a heading of the same page."""
    return Markup(f'<a href="#{escape(anchor)}">{escape(text)}</a>')


def listing(lines: Iterable[str]) -> Markup:
    return Markup("<ul>" + "".join(f"<li>{escape(line)}</li>" for line in lines) + "</ul>")


def details(title: str, parts: Iterable[Markup]) -> Markup:
    """What is folded up at first."""
    return Markup(f"<details><summary>{escape(title)}</summary>{''.join(parts)}</details>")


def picture(png: bytes, caption: str) -> Markup:
    data = base64.b64encode(png).decode()
    text = escape(caption)
    image = f'<img alt="{text}" src="data:image/png;base64,{data}">'
    return Markup(f"<figure>{image}<figcaption>{text}</figcaption></figure>")


def pictures(folder: Path, pattern: str) -> Iterator[Markup]:
    """Files (PNG) of a folder; raises `CrosscheckError` for one that cannot be read."""
    for path in sorted(folder.glob(pattern)):
        try:
            content = read_content(path, "result_size")
        except SourceError as error:
            raise CrosscheckError(str(error)) from error
        if not content.startswith(PNG):
            raise CrosscheckError(f"{path}: is no PNG")
        yield picture(content, path.stem.replace("_", " "))


def table(head: Sequence[str], rows: Iterable[Sequence[str | Cell] | str]) -> Markup:
    """A table; a row that is one text is a heading over those after it."""
    lines = ["".join(f"<th>{_lines(name)}</th>" for name in head)]
    for row in rows:
        if isinstance(row, str):
            lines.append(f'<th class="level" colspan="{len(head)}">{escape(row)}</th>')
        else:
            lines.append("".join(_cell(cell) for cell in row))
    return Markup("<table>" + "".join(f"<tr>{line}</tr>" for line in lines) + "</table>")


def _cell(cell: str | Cell) -> str:
    if isinstance(cell, Cell):
        return f'<td class="figure {cell.judged}" title="{escape(cell.about)}">{escape(cell.text)}</td>'
    return f"<td>{cell if isinstance(cell, Markup) else _lines(cell)}</td>"


def _lines(text: str) -> str:
    return "<br>".join(escape(line) for line in text.split("\n"))


def values(content: Any) -> Markup:
    """Whatever JSON holds: objects and lists of objects as tables, everything in them alike."""
    if isinstance(content, Mapping):
        rows = [(str(key), _value(value)) for key, value in content.items()]
        return table(("", ""), rows) if rows else Markup("")
    if isinstance(content, list) and content and all(isinstance(entry, Mapping) for entry in content):
        head = list(dict.fromkeys(str(key) for entry in content for key in entry))
        return table(head, ([_value(entry.get(key)) for key in head] for entry in content))
    if isinstance(content, list) and any(isinstance(entry, Mapping | list) for entry in content):
        return Markup("".join(values(entry) for entry in content))
    return Markup(escape(_text(content)))


def _value(content: Any) -> str:
    return values(content) if isinstance(content, Mapping | list) else _text(content)


def _text(content: Any) -> str:
    """A value that is no object; numbers with as many digits as people read."""
    if content is None:
        return ""
    if isinstance(content, float):
        return f"{content:.6g}"
    if isinstance(content, list):
        if len(content) > MOST_NUMBERS and all(isinstance(entry, float) for entry in content):
            middle, least, most = (_text(of(content)) for of in (median, min, max))
            return f"{middle}, the median of {len(content)} from {least} to {most}"
        return ", ".join(_text(entry) for entry in content)
    return str(content)
