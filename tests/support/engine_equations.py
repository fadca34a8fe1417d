"""Comparison of an engine's equations with newton_euler's, for tests of adapters."""

from __future__ import annotations

from crosscheck.compare.check import Check
from crosscheck.compare.levels import compare_pair
from crosscheck.compare.samples import Samples, States
from newton_euler.equations.relative import Relative
from newton_euler.equations.system import System
from newton_euler.model.scene import Scene
from newton_euler.reading.excitation import random_states
from newton_euler.runs.assemble import initial_state


def checks_of(scene: Scene, system: System, others: int = 2) -> list[Check]:
    """Checks of a system of equations against newton_euler's, at the start and at random states.

    A singular start is left out, unless there are no other states.
    """
    start = States(scene, (initial_state(scene),))
    random = random_states(scene, others) if others else []
    states = States(scene, tuple(random if random and start.is_singular else [*start.all, *random]))
    pair = ("newton_euler", system.name)
    return list(compare_pair(pair, [Samples(Relative(scene), states)], [Samples(system, states)]))


def failures(scene: Scene, system: System, others: int = 2) -> list[tuple[str, str]]:
    """Level and quantity of the checks that fail."""
    return [(check.level, check.quantity) for check in checks_of(scene, system, others) if not check.agrees]
