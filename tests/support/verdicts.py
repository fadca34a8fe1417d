"""Verdicts on runs of a scene, for the tests of what is compared."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from crosscheck.compare.check import Check
from crosscheck.compare.levels import compare
from crosscheck.engines.engine import Engine
from crosscheck.engines.registry import ENGINES
from newton_euler.model.scene import Scene

ALL = tuple(ENGINES.values())


def verdicts(scene: Scene, engines: Sequence[Engine] = ALL, states: int = 3) -> list[Check]:
    """All figures of the engines' runs and of their equations at some random states."""
    return compare(scene, engines, {engine.name: engine.simulate(scene) for engine in engines}, states)


def figure(rows: Iterable[Check], level: str, quantity: str, *between: str) -> Check:
    """The one figure of that name."""
    (row,) = (row for row in rows if (row.level, row.quantity, row.between) == (level, quantity, between))
    return row
