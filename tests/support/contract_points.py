"""Write the points of the contract into `docs/reference/engine_contract.md`.

`python tests/support/contract_points.py` writes the page. The page has the docstrings of the points; a test
compares the page with them.
"""

from __future__ import annotations

from pathlib import Path

from crosscheck.studies.conformance.check import POINTS, explained

PAGE = Path(__file__).parents[2] / "docs" / "reference" / "engine_contract.md"

BEGIN, END = "<!-- points: begin -->\n", "<!-- points: end -->"
"""Lines around the points on the page."""


def sections() -> str:
    """Return a section of Markdown for each point."""
    return "".join(
        f"### {point}\n\n{asked}\n\n- **Why**: {why}\n- **Failure**: {failure}\n\n"
        for point, (asked, why, failure) in ((point, explained(point)) for point in POINTS)
    )


def sections_of_page() -> str:
    """Return the sections of the page."""
    return PAGE.read_text().partition(BEGIN)[2].partition(END)[0]


if __name__ == "__main__":
    before, _, rest = PAGE.read_text().partition(BEGIN)
    PAGE.write_text(before + BEGIN + sections() + END + rest.partition(END)[2])
