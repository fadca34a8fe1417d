"""Results of crosschecks, for tests of reports: given checks and runs of a scene that is not simulated."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from crosscheck.compare.check import Check
from crosscheck.compare.crosscheck import Crosscheck
from crosscheck.engines.registry import ENGINES
from crosscheck.loading.load import load_scene


def crosscheck_of(checks: Sequence[Check] = (), **more: Any) -> Crosscheck:
    """Return a crosscheck of the pendulum, 2 s long, in all engines, with the given checks and attributes."""
    scene, _ = load_scene("pendulum", {})
    attributes: dict[str, Any] = {
        "source": "pendulum",
        "options": {},
        "scene": replace(scene, duration=2.0),
        "engines": tuple(ENGINES.values()),
        "left_out": {},
        "trajectories": {},
        "checks": tuple(checks),
        "wall_time": 1.0,
    }
    return Crosscheck(**attributes | more)
