"""`summary.json` as `crosscheck run` writes it, checked."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ValidationError

from crosscheck.errors import CrosscheckError

NAME = "summary.json"


class Figure(BaseModel):
    """A compared figure, see `crosscheck.comparison.levels.Row`."""

    level: str
    quantity: str
    between: list[str]
    value: float
    tolerance: float
    where: str
    informs: bool
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
    wall_time: float


class Mapped(BaseModel):
    """What became of an element of a model file."""

    element: str
    fate: str
    how: str


class Advice(BaseModel):
    """See `crosscheck.advice`."""

    topic: str
    text: str


class Summary(BaseModel):
    """See `crosscheck.run.Crosscheck.summary`."""

    scene: str
    source: str
    options: dict[str, Any]
    agrees: bool
    verdict: str
    wall_time: float
    versions: dict[str, str]
    engines: dict[str, EngineRun]
    left_out: dict[str, str]
    mapping: list[Mapped] | None
    start: list[str] | None
    figures: list[Figure]
    known_figures: list[KnownFigure]
    advice: list[Advice] = []


def read_json(path: Path) -> Any:
    """The content of a JSON file; raises `CrosscheckError`."""
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise CrosscheckError(f"cannot read {path}: {error.strerror}") from error
    except (ValueError, RecursionError) as error:
        raise CrosscheckError(f"{path} is not JSON: {error}") from error


def read_summary(folder: Path) -> Summary:
    """The summary of a crosscheck; raises `CrosscheckError` naming the file and the field."""
    path = folder / NAME
    try:
        return Summary.model_validate(read_json(path))
    except ValidationError as error:
        first = error.errors()[0]
        field = ".".join(str(part) for part in first["loc"]) or "content"
        raise CrosscheckError(f"{path}: {field}: {first['msg']}") from error
