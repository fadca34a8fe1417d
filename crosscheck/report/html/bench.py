"""The sections of a page about a benchmark."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from pydantic import ConfigDict, Field

from crosscheck.report.html import page
from crosscheck.report.html.page import Markup, Progress
from crosscheck.report.html.results import Headline, Results

TITLES = {
    "bench.json": "Run time against error",
    "rhs.json": "One right-hand side",
    "batch.json": "Many runs",
    "scaling.json": "Right-hand sides over size",
}
"""Of the files that a benchmark writes."""

PICTURES = {"bench.json": "work_precision.png", "scaling.json": "scaling.png"}

MAIN = ("table", "right_hand_sides", "sides", "sizes")
"""Entries that hold what was asked for."""

SETTINGS = ("scene", "source", "options", "duration", "outputs", "error", "reference", "machine")


class Bench(Results):
    """What all benchmarks have measured; other entries of each are its own."""

    model_config = ConfigDict(extra="allow")

    source: str
    options: dict[str, Any]
    machine: dict[str, Any]
    answer: str = ""
    words: list[str] = Field(default_factory=list)

    @property
    def headline(self) -> Headline:
        return Headline(self.answer)

    @property
    def entries(self) -> Mapping[str, Any]:
        return {name: value for name, value in self if name not in ("answer", "words")}


class WorkPrecision(Bench):
    """See `crosscheck.studies.benchmark.report.as_json`."""

    scene: str
    duration: float
    outputs: int
    reference: dict[str, Any]
    answer: str
    table: list[dict[str, Any]]
    loadings: list[dict[str, Any]]
    settings: list[dict[str, Any]]


class RightHandSides(Bench):
    """See `crosscheck.studies.benchmark.rhs.rhs_json`."""

    right_hand_sides: list[dict[str, Any]]
    words: list[str]


class Batch(Bench):
    """See `crosscheck.studies.benchmark.batch.BatchBenchmark`."""

    duration: float
    outputs: int
    error: float
    sides: list[dict[str, Any]]
    words: list[str]


class Scaling(Bench):
    """See `crosscheck.studies.benchmark.scaling.scaling_json`."""

    sizes: dict[str, list[dict[str, Any]]]
    words: list[str]


KINDS: dict[str, type[Bench]] = {
    "bench.json": WorkPrecision,
    "rhs.json": RightHandSides,
    "batch.json": Batch,
    "scaling.json": Scaling,
}
"""Of the same files."""


def sections(found: Bench, path: Path, shares: Sequence[float], progress: Progress) -> Iterator[Markup]:
    """What was found in words, a picture, the main table, settings, and all other figures."""
    yield page.heading(TITLES[path.name], 3)
    yield page.listing([*found.answer.splitlines(), *found.words])
    if path.name in PICTURES:
        yield from page.pictures(path.parent, PICTURES[path.name])
    parts = {name: page.values(value) for name, value in found.entries.items()}
    yield from (part for name, part in parts.items() if name in MAIN)
    yield page.heading("Settings", 3)
    yield page.table(("", ""), ((name, parts[name]) for name in SETTINGS if name in parts))
    for name, part in parts.items():
        if name not in (*MAIN, *SETTINGS):
            yield page.details(name.replace("_", " "), [part])
