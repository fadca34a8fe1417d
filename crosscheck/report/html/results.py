"""What files of results hold that a page is made of."""

from __future__ import annotations

from typing import NamedTuple

from pydantic import BaseModel

from crosscheck.report.html.page import Cell


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
