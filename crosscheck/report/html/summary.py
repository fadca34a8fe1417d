"""`summary.json` as `crosscheck run` writes it, checked."""

from __future__ import annotations

from typing import Any

from pydantic import BaseModel, Field

from crosscheck.report.html.page import Cell
from crosscheck.report.html.results import Headline, Results


class Figure(BaseModel):
    """A compared figure, see `crosscheck.comparison.levels.Row`."""

    level: str
    quantity: str
    between: list[str]
    value: float
    tolerance: float
    where: str
    informs: bool
    unsettled: str = ""
    agrees: bool


class KnownFigure(BaseModel):
    """A figure that is known from elsewhere, see `crosscheck.comparison.known_figures.Measured`."""

    engine: str
    quantity: str
    unit: str
    time: float
    value: float
    reference: float
    difference: float
    allowed: float
    agrees: bool


class EngineRun(BaseModel):
    """How an engine ran."""

    settings: dict[str, Any]
    wall_time: float | None


class Unfinished(BaseModel):
    """What did not come to its end, see `crosscheck.each_run.Stop`."""

    what: str
    reason: str
    time: float | None


class Mapped(BaseModel):
    """What became of an element of a model file."""

    element: str
    fate: str
    how: str


class Advice(BaseModel):
    """See `crosscheck.advice`."""

    topic: str
    text: str


class Model(BaseModel):
    """One of two that were compared, see `crosscheck.against.compare.Model`."""

    name: str
    source: str
    options: dict[str, Any]
    mapping: list[Mapped] | None
    start: list[str] | None


class Summary(Results):
    """See `crosscheck.run.Crosscheck.summary`, and `crosscheck.against.compare.Against.summary`."""

    scene: str
    source: str
    options: dict[str, Any]
    agrees: bool
    verdict: str
    wall_time: float
    versions: dict[str, str]
    unfinished: list[Unfinished] = Field(default_factory=list)
    engines: dict[str, EngineRun]
    left_out: dict[str, str]
    mapping: list[Mapped] | None
    start: list[str] | None
    figures: list[Figure]
    known_figures: list[KnownFigure]
    files: dict[str, str]
    advice: list[Advice] = Field(default_factory=list)
    models: list[Model] | None = Field(None, min_length=2, max_length=2)
    notes: list[str] = Field(default_factory=list)

    @property
    def headline(self) -> Headline:
        judged = Cell("AGREE", "holds") if self.agrees else Cell("FAILS", "fails")
        return Headline(self.verdict, judged, self.wall_time)
