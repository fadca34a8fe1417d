"""Write the results of `crosscheck stress` into the tables of `docs/results/stress.md`.

    python tests/support/stress_page.py FOLDER/stress.md

The argument is the Markdown file that `crosscheck stress --full` writes. The page has comments around the
place of the summary and of each topic, such as `<!-- topic a -->` and `<!-- end of topic a -->`.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from pathlib import Path

from page_tables import RESULTS, replaced

PAGE = RESULTS / "stress.md"

SECTION = re.compile(r"^## (.*)\n", re.MULTILINE)

TOPIC = re.compile(r"\((\w)\) .*")


def tables(results: str) -> Iterator[tuple[str, list[str]]]:
    """Yield the names of places in the page, and their lines, for the text of `stress.md`."""
    parts = SECTION.split(results)
    sections = dict(zip(parts[1::2], (text.strip() for text in parts[2::2]), strict=True))
    verdict = re.search(r"\*\*(.*)\*\*", parts[0])
    assert verdict is not None, "the file has no verdict"
    caption = "passed cases of each engine by topic; the column `all` has cases of crosscheck itself"
    yield "summary", [sections["passed cases"], "", f"Table: {caption} ({verdict[1]})."]
    yield "origin", [sections["about"].removeprefix("- ").partition(" Each case measures")[0]]
    for title, text in sections.items():
        if topic := TOPIC.fullmatch(title):
            letter = topic[1]
            lines = [sections[f"bounds of ({letter})"], "", f"Table: {title}: bounds of cases that pass.", ""]
            lines += [text, "", f"Table: {title}: passed cases of each engine and setting."]
            if others := sections.get(f"not passed in ({letter})"):
                lines += ["", others, "", f"Table: {title}: cases that do not pass, with their values."]
            yield f"topic {letter}", lines


if __name__ == "__main__":
    page = PAGE.read_text()
    for place, lines in tables(Path(sys.argv[1]).read_text()):
        page = replaced(page, place, lines)
    PAGE.write_text(page)
