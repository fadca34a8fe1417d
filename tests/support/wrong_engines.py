"""Engines with a planted fault."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from crosscheck.engines.engine import Engine
from newton_euler.model.scene import Scene


def taking(engine: Engine, change: Callable[[Scene], Scene]) -> Engine:
    """Return the engine with runs, refined runs and equations of a changed scene instead of the given one."""
    soft = engine.soft_constraints
    return replace(
        engine,
        simulate=lambda scene: engine.simulate(change(scene)),
        refined=lambda scene: engine.refined(change(scene)),
        systems=lambda scene: engine.systems(change(scene)),
        soft_constraints=soft and soft._replace(evaluate=lambda scene: soft.evaluate(change(scene))),
    )
