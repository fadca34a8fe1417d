"""Write the results of `crosscheck stress` into `docs/results/stress.md`, each topic folded.

    python tests/support/stress_page.py FOLDER/stress.md

The argument is the Markdown file that `crosscheck stress --full` writes. Its table of passed cases comes
first; bounds and cases of a topic are below one line, which opens when a reader selects it.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from pathlib import Path

from crosscheck.studies.models import write

PAGE = Path(__file__).parents[2] / "docs" / "results" / "stress.md"

SECTION = re.compile(r"^## (.*)\n", re.MULTILINE)


def page_lines(results: str) -> Iterator[str]:
    """Yield the lines of the page for the text of `stress.md`."""
    parts = SECTION.split(results.replace("\\`", "`"))
    sections = dict(zip(parts[1::2], (text.strip() for text in parts[2::2]), strict=True))
    verdict = re.search(r"\*\*.*\*\*", parts[0])
    assert verdict is not None, "the file has no verdict"
    yield f"{verdict[0]}\n"
    yield sections.pop("passed cases")
    yield '\nTable: passed cases of each engine; "all" are cases of crosscheck itself.\n'
    yield from folded("Machine, versions and meaning of the results", sections.pop("about"))
    for name, text in sections.items():
        if not name.startswith("bounds of "):
            bounds = sections[f"bounds of {name[:3]}"]
            yield from folded(name, f"{bounds}\n\n{text}\n\nTable: passed cases, and the others with values.")


def folded(summary: str, text: str) -> Iterator[str]:
    """Yield the lines of a text below one line."""
    yield f'<details markdown="1">\n<summary>{summary}</summary>\n\n{text}\n\n</details>\n'


if __name__ == "__main__":
    write(PAGE, [*page_lines(Path(sys.argv[1]).read_text())])
