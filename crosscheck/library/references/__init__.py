"""Figures of scenes that are known from elsewhere: closed forms, quadratures, published solutions.

A file for each scene of that name: where its figures come from, and for each of them the time (s), the
quantity as in the scene's `FIGURES`, the value (SI) and what it may be off. Options of the scene that a
figure holds for are listed where the scene has any; published values stand beside with their own digits.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib.resources import files
from typing import Any


@dataclass(frozen=True)
class Known:
    """One figure that is known.

    Attributes:
        time: s, an output time of the scene.
        quantity: its name among the scene's figures.
        unit: of the value.
        value, uncertainty: the figure and what it may be off.
        options: of the scene that it holds for.
        published: as printed by others, if it was.
    """

    time: float
    quantity: str
    unit: str
    value: float
    uncertainty: float
    options: Mapping[str, str | float] = field(default_factory=dict)
    published: str = ""


def known_figures(scene: str) -> tuple[Known, ...]:
    """All known figures of a scene of the library, under any options; none for a scene without a file."""
    file = files(__name__).joinpath(f"{scene}.json")
    if not file.is_file():
        return ()
    content: dict[str, Any] = json.loads(file.read_text(encoding="utf-8"))
    return tuple(Known(**figure) for figure in content["figures"])
