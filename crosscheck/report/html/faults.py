"""The sections of a page about planted faults."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from crosscheck.report.html import page
from crosscheck.report.html.page import Cell, Markup, Progress
from crosscheck.report.html.results import Headline, Results


class Counts(BaseModel):
    """See `crosscheck.studies.faults.report.Counts`."""

    title: str
    head: list[str]
    rows: list[list[str]]


class Faults(Results):
    """See `crosscheck.studies.faults.report.as_json`."""

    scene: str
    options: dict[str, str]
    engines: list[str]
    left_out: dict[str, str]
    verdict: str
    holds: bool
    wall_time: float
    versions: dict[str, str]
    tables: list[Counts]
    words: list[str]
    faults: list[dict[str, Any]]

    @property
    def headline(self) -> Headline:
        judged = Cell("FOUND", "holds") if self.holds else Cell("MISSED", "fails")
        return Headline(self.verdict, judged, self.wall_time)


def sections(found: Faults, path: Path, shares: Sequence[float], progress: Progress) -> Iterator[Markup]:
    """Tables of shares, what was missed and why, settings, and all faults."""
    yield page.heading("Planted faults", 3)
    yield page.verdict(*found.headline)
    for counts in found.tables:
        yield page.paragraph(counts.title)
        yield page.table(counts.head, counts.rows)
    yield page.listing(found.words)
    yield page.heading("Settings", 3)
    settings = {"scene": found.scene, "options": found.options, "planted in": found.engines}
    yield page.values(settings | {"engines left out": found.left_out, "versions": found.versions})
    yield page.details(f"all {len(found.faults)} faults", [page.values(found.faults)])
