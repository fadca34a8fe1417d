"""Tables of the pages on results: scripts write them, and plots find their numbers in them."""

from __future__ import annotations

import html
import re
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

RESULTS = Path(__file__).parents[2] / "docs" / "results"

TABLE = re.compile(r"^\|(?P<head>.*)\|\n\|[-:| ]+\|\n(?P<rows>(?:\|.*\n)+)", re.MULTILINE)

NUMBER = re.compile(r"[-+]?\d[\d,]*(?:\.\d+)?(?:e[-+]?\d+)?")


class PageTable(NamedTuple):
    """A table of a page: headings of the columns, and rows of cells."""

    heads: list[str]
    rows: list[list[str]]

    def column(self, head: str) -> list[str]:
        """Cells of the column with a heading."""
        return [row[self.heads.index(head)] for row in self.rows]


def page_table(page: str, *heads: str) -> PageTable:
    """Find the table of a page whose first columns have these headings.

    Raises:
        LookupError: if the page does not have exactly one such table.
    """
    tables = [
        PageTable(cells(found["head"]), [cells(row.strip("|")) for row in found["rows"].splitlines()])
        for found in TABLE.finditer((RESULTS / page).read_text())
    ]
    wanted = [table for table in tables if tuple(table.heads[: len(heads)]) == heads]
    if len(wanted) != 1:
        raise LookupError(f"{page} has {len(wanted)} tables that begin with {', '.join(heads)}; needed: one")
    return wanted[0]


def cells(row: str) -> list[str]:
    """Split a row of a Markdown table into its cells."""
    return [html.unescape(cell.strip().replace("`", "").replace("\\", "")) for cell in row.split("|")]


def numbers(text: str) -> list[float]:
    """Numbers of a text, in their order; commas separate thousands."""
    return [float(each.replace(",", "")) for each in NUMBER.findall(text)]


def replaced(page: str, name: str, lines: Iterable[str]) -> str:
    """Page with other lines between the comments `<!-- NAME -->` and `<!-- end of NAME -->`."""
    start, end = f"<!-- {name} -->", f"<!-- end of {name} -->"
    assert page.count(start) == page.count(end) == 1, f"the page has no place for {name!r}"
    text = "\n".join([start, "", *lines, "", end])
    return re.sub(f"{re.escape(start)}.*?{re.escape(end)}", lambda _: text, page, flags=re.DOTALL)
