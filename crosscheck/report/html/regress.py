"""The sections of a page about scenes against their baselines."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from crosscheck.errors import CrosscheckError
from crosscheck.regress.compare import Checked
from crosscheck.report.html import drawing, page
from crosscheck.report.html.page import Cell, Markup, Progress
from crosscheck.report.html.results import Headline, Results


class Comparison(BaseModel):
    """See `crosscheck.regress.compare.Comparison.summary`."""

    scene: str
    quiet: bool
    verdict: str
    wall_time: float
    baseline: dict[str, Any]
    versions: dict[str, str]
    figures: list[Checked]
    recording: str | None


class Regress(Results):
    """See `crosscheck.regress.report.as_json`."""

    quiet: bool
    verdict: str
    scenes: list[Comparison]

    @property
    def headline(self) -> Headline:
        return Headline(self.verdict, _judged(self.quiet), sum(scene.wall_time for scene in self.scenes))


def _judged(quiet: bool) -> Cell:
    return Cell("QUIET", "holds") if quiet else Cell("MOVED", "fails")


def sections(found: Regress, path: Path, shares: Sequence[float], progress: Progress) -> Iterator[Markup]:
    """A line for each scene; what moved, with pictures of the recording; all figures; settings."""
    yield page.heading("Against the baselines", 3)
    yield page.verdict(*found.headline)
    yield page.table(
        ("scene", "", "time, s", "verdict"),
        ((s.scene, _judged(s.quiet), f"{s.wall_time:.1f}", s.verdict) for s in found.scenes),
    )
    for scene in found.scenes:
        moved = [figure for figure in scene.figures if figure.moved]
        if moved:
            yield page.heading(f"{scene.scene}: what moved", 3)
            yield _figures(moved)
            yield from _pictures(path.parent, scene, shares, progress)
    for scene in found.scenes:
        yield page.details(f"{scene.scene}: all {len(scene.figures)} figures", [_figures(scene.figures)])
    yield page.heading("Settings", 3)
    yield page.table(
        ("scene", "baseline", "versions now"),
        ((s.scene, page.values(s.baseline), page.values(s.versions)) for s in found.scenes),
    )


def _figures(figures: Sequence[Checked]) -> Markup:
    return page.table(
        ("figure", "where", "was", "now", "bands"),
        (
            (
                f"{figure.group}: {figure.name}" + (f", {figure.unit}" if figure.unit else ""),
                figure.problem or figure.where,
                _number(figure.was, ".9g"),
                _number(figure.now, ".9g"),
                Cell(f"{figure.bands:.3g}", "fails" if figure.moved else ""),
            )
            for figure in figures
        ),
    )


def _number(value: float | None, form: str) -> Cell:
    return Cell("" if value is None else format(value, form))


def _pictures(
    folder: Path, scene: Comparison, shares: Sequence[float], progress: Progress
) -> Iterator[Markup]:
    """Of the recording, which is looked for beside the results wherever those were made."""
    if scene.recording is None:
        return
    progress(f"{scene.scene}: pictures of the recording")
    try:
        recording = folder / Path(scene.recording).name
        for content, caption in drawing.views(recording, "newton_euler", shares):
            yield page.picture(content, f"{scene.scene}: {caption}")
    except CrosscheckError as error:
        yield page.paragraph(f"No picture of {scene.scene}: {error}")
