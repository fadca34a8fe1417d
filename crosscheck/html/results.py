"""Files of results, as commands write them, read and checked."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from pydantic import BaseModel, ValidationError

from crosscheck.errors import CrosscheckError
from crosscheck.html.page import Cell


class Headline(NamedTuple):
    """What was found, in a line: all that there is to know at first.

    Attributes:
        verdict: the line.
        judged: whether all is well, in a word; an empty cell where there is nothing to judge.
        wall_time: s, of everything; None where it was not measured.
    """

    verdict: str
    judged: Cell = Cell("")
    wall_time: float | None = None


class Results(BaseModel):
    """What a file holds."""

    @property
    def headline(self) -> Headline:
        raise NotImplementedError


Kind = TypeVar("Kind", bound=Results)


def read(path: Path, kind: type[Kind]) -> Kind:
    """The content of a file; raises `CrosscheckError` naming the file and the field at fault."""
    try:
        return kind.model_validate(_json(path))
    except ValidationError as error:
        first = error.errors()[0]
        field = ".".join(str(part) for part in first["loc"]) or "content"
        raise CrosscheckError(f"{path}: {field}: {first['msg'].removeprefix('Value error, ')}") from error


def _json(path: Path) -> Any:
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise CrosscheckError(f"cannot read {path}: {error.strerror}") from error
    except (ValueError, RecursionError) as error:
        raise CrosscheckError(f"{path} is not JSON: {error}") from error
