"""The sections of a page about what engines survive."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from crosscheck.report.html import page
from crosscheck.report.html.page import Cell, Markup, Progress
from crosscheck.report.html.results import Headline, Results
from crosscheck.studies.stress.topics import Row


class Stress(Results):
    """See `crosscheck.studies.stress.report.as_json`."""

    form: str
    wall_time: float
    versions: dict[str, str]
    passed: dict[str, dict[str, str]]
    rows: list[Row]

    @property
    def headline(self) -> Headline:
        passes = sum(row.passes for row in self.rows)
        return Headline(f"{passes} of {len(self.rows)} cases pass", wall_time=self.wall_time)


def sections(found: Stress, path: Path, shares: Sequence[float], progress: Progress) -> Iterator[Markup]:
    """How many cases each engine passes, pictures, all cases by topic, settings."""
    yield page.heading("What each engine survives", 3)
    yield page.verdict(*found.headline)
    engines = list(dict.fromkeys(name for cells in found.passed.values() for name in cells))
    yield page.table(
        ["", *engines],
        ([topic, *(cells.get(name, "") for name in engines)] for topic, cells in found.passed.items()),
    )
    yield from page.pictures(path.parent, "stress_*.png")
    for topic in found.passed:
        rows = [row for row in found.rows if topic.startswith(f"({row.topic})")]
        yield page.details(f"{topic}: {len(rows)} cases", [_cases(rows)])
    yield page.heading("Settings", 3)
    yield page.values({"form": found.form, "versions": found.versions})


def _cases(rows: Sequence[Row]) -> Markup:
    return page.table(
        ("case", "engine", "setting", "measured", "figure", "bound", "", ""),
        (
            (
                row.name,
                row.engine,
                row.setting,
                f"{row.quantity}, {row.unit}" if row.unit else row.quantity,
                Cell("" if row.figure is None else f"{row.figure:.1e}"),
                Cell(row.bound),
                Cell(row.verdict, "holds" if row.passes else "fails"),
                row.reason,
            )
            for row in rows
        ),
    )
