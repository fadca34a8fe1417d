"""Reference values of library scenes: closed forms, quadratures and published solutions.

The folder has one JSON file per scene with the source of its reference values. Each entry of the list
`values` in a file is a `ReferenceValue`.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib.resources import files
from typing import Any


@dataclass(frozen=True)
class ReferenceValue:
    """Value of a quantity of a scene at one time, from a source other than a simulation of the scene.

    Attributes:
        time: s, an output time of the scene.
        quantity: name of the quantity in the scene's `REFERENCE_QUANTITIES`.
        unit: SI unit of the value.
        value, uncertainty: value, and largest error that its source may have.
        options: options of the scene for which the value holds.
        published: the value as it is printed in a publication; empty if there is none.
    """

    time: float
    quantity: str
    unit: str
    value: float
    uncertainty: float
    options: Mapping[str, str | float] = field(default_factory=dict)
    published: str = ""


def reference_values(scene: str) -> tuple[ReferenceValue, ...]:
    """Read all reference values of a library scene, for all of its options; empty for a scene without a
    file."""
    file = files(__name__).joinpath(f"{scene}.json")
    if not file.is_file():
        return ()
    content: dict[str, Any] = json.loads(file.read_text(encoding="utf-8"))
    return tuple(ReferenceValue(**entry) for entry in content["values"])
