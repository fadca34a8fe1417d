"""Write the table of points of the contract into `docs/reference/engine_contract.md`.

`python tests/support/contract_table.py` writes the page. The table has the docstrings of the points; a test
compares the page with them.
"""

from __future__ import annotations

from pathlib import Path

from crosscheck.studies.conformance.check import POINTS, explained

PAGE = Path(__file__).parents[2] / "docs" / "reference" / "engine_contract.md"

BEGIN, END = "<!-- points: begin -->\n", "<!-- points: end -->"
"""Lines around the table of the page."""


def table() -> str:
    """Return the table in Markdown."""
    rows = (f"| `{point}` | {' | '.join(explained(point))} |" for point in POINTS)
    return "\n".join(
        ["| point | what is asked | why | what a failure means |", "|---|---|---|---|", *rows, ""]
    )


def table_of_page() -> str:
    """Return the table of the page."""
    return PAGE.read_text().partition(BEGIN)[2].partition(END)[0]


if __name__ == "__main__":
    before, _, rest = PAGE.read_text().partition(BEGIN)
    PAGE.write_text(before + BEGIN + table() + END + rest.partition(END)[2])
