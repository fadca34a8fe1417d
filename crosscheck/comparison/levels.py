"""Comparison of engines, level by level, from the model itself to whole runs.

Each `Row` is one figure for one pair of engines (or one engine), with the tolerance it is held to
and the body, joint, term or time where it is worst. Levels 1 to 4 use each engine's rigid equations of
motion at consistent states, so that a difference is one of the models; the later levels use runs.
Relative figures are relative to what the mechanism does at all of the states together, never to what
may be round-off: a mechanism at rest, in equilibrium or in free fall has nothing else.

A pair is compared up to the first level at which it parts. Later ones would only say so again.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from itertools import combinations, product

from crosscheck.comparison.accelerations import acceleration_rows, softness_row
from crosscheck.comparison.dynamics import dynamics_rows
from crosscheck.comparison.kinematics import kinematics_rows
from crosscheck.comparison.model import model_rows
from crosscheck.comparison.momentum import momentum_row
from crosscheck.comparison.rows import LEVELS, Row, not_compared
from crosscheck.comparison.runs import compare_runs
from crosscheck.comparison.samples import Samples, States
from crosscheck.engines import Engine
from newton_euler.assemble import random_states
from newton_euler.scene import Scene
from newton_euler.trajectory import Trajectory

__all__ = ["LEVELS", "Row", "compare", "compare_equations", "not_compared", "without_runs"]

Level = Callable[[tuple[str, str], Samples, Samples], Iterator[Row]]

EQUATION_LEVELS: tuple[Level, ...] = (model_rows, kinematics_rows, dynamics_rows, acceleration_rows)
"""Those before runs, in their order."""

EngineSamples = dict[str, list[Samples]]
"""The rigid systems of each engine at the same states, by the engine's name."""


def compare_pair(
    pair: tuple[str, str],
    first: Sequence[Samples],
    second: Sequence[Samples],
    levels: Sequence[Level] = EQUATION_LEVELS,
) -> Iterator[Row]:
    """Levels 1 to 4 of two engines, up to the first that disagrees.

    An engine with several rigid systems (formulations) enters with the one that is worst for
    its tolerance.
    """
    for level in levels:
        found: dict[str, Row] = {}
        for x, y in product(first, second):
            for row in level(pair, x, y):
                known = found.setdefault(row.quantity, row)
                if not row.value / row.tolerance <= known.value / known.tolerance:
                    found[row.quantity] = row
        yield from found.values()
        if not all(row.agrees for row in found.values()):
            return


def compare_equations(engines: Sequence[Engine], samples: EngineSamples) -> Iterator[Row]:
    """Levels 1 to 4 of every pair of engines and of the systems of each engine.

    An engine with soft constraints has a row for what they do to its reactions at the first state, which is
    to be the initial one.
    """
    for a, b in combinations(engines, 2):
        yield from compare_pair((a.name, b.name), samples[a.name], samples[b.name])
    for engine in engines:
        for one, two in combinations(samples[engine.name], 2):
            yield from compare_pair((one.name, two.name), [one], [two])
        if engine.soft_start is not None:
            rigid = samples[engine.name][0]
            yield softness_row(engine.name, engine.soft_start(rigid.states.scene), rigid)


def sampled(engines: Sequence[Engine], states: States) -> EngineSamples:
    """The engines' rigid systems at the states."""
    return {e.name: [Samples(system, states) for system in e.systems(states.scene)] for e in engines}


def compare(scene: Scene, engines: Sequence[Engine], runs: dict[str, Trajectory], states: int) -> list[Row]:
    """All levels; `states` is the number of random consistent states for those that need no run."""
    at = _states(scene, states)
    samples = sampled(engines, at)
    rows = list(compare_equations(engines, samples))
    parted = {row.between for row in rows if not row.agrees}
    rows += compare_runs(scene, engines, runs, at.energy, parted)
    rows += [momentum_row(engine.name, samples[engine.name][0]) for engine in engines]
    return sorted(rows, key=lambda row: LEVELS.index(row.level))


def without_runs(scene: Scene, engines: Sequence[Engine], states: int) -> list[Row]:
    """Levels 1 to 4, which need no run; arguments as of `compare`."""
    rows = compare_equations(engines, sampled(engines, _states(scene, states)))
    return sorted(rows, key=lambda row: LEVELS.index(row.level))


def _states(scene: Scene, states: int) -> States:
    """The initial state and random consistent ones."""
    return States(scene, (scene.initial_state, *random_states(scene, states)))
