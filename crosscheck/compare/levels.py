"""Comparison of engines, level by level, from the model itself to whole runs.

Each `Check` compares one quantity of a pair of engines (or of one engine). Levels of equations use each
engine's rigid equations of motion at consistent states, so that a difference comes from the models; later
levels use runs. Relative differences are relative to the largest values over all states, since the values at
one state may be round-off: a mechanism at rest, in equilibrium or in free fall has nothing else.

A pair is compared up to the first level at which it differs; later levels would only repeat the difference.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import cache
from itertools import combinations, product

from crosscheck.compare.accelerations import acceleration_rows, softness_row
from crosscheck.compare.check import FILE, LEVELS, READING, Check, in_full
from crosscheck.compare.dynamics import dynamics_rows
from crosscheck.compare.kinematics import kinematics_rows
from crosscheck.compare.model import model_rows
from crosscheck.compare.momentum import momentum_row
from crosscheck.compare.runs import Runs, compare_runs, compare_runs_until
from crosscheck.compare.samples import Samples, States
from crosscheck.engines.engine import Engine
from newton_euler.errors import AssemblyError
from newton_euler.model.scene import Scene
from newton_euler.reading.excitation import random_states
from newton_euler.reading.import_report import ImportReport
from newton_euler.reading.verify import verify
from newton_euler.runs.assemble import initial_state

Level = Callable[[tuple[str, str], Samples, Samples], Iterator[Check]]

EQUATION_LEVELS: tuple[Level, ...] = (model_rows, kinematics_rows, dynamics_rows, acceleration_rows)
"""Functions of the levels before runs, in their order."""

EngineSamples = dict[str, list[Samples]]
"""The rigid systems of each engine at the same states, by the engine's name."""


def compare_pair(
    pair: tuple[str, str],
    first: Sequence[Samples],
    second: Sequence[Samples],
    levels: Sequence[Level] = EQUATION_LEVELS,
) -> Iterator[Check]:
    """Levels of equations of two engines, up to the first that disagrees.

    An engine with several rigid systems (formulations) enters with the one that is worst for
    its tolerance.
    """
    for level in levels:
        found: dict[str, Check] = {}
        for x, y in product(first, second):
            for row in level(pair, x, y):
                known = found.setdefault(row.quantity, row)
                if not row.tolerance_ratio <= known.tolerance_ratio:
                    found[row.quantity] = row
        yield from found.values()
        if not all(row.agrees for row in found.values()):
            return


def compare_equations(engines: Sequence[Engine], samples: EngineSamples) -> Iterator[Check]:
    """Levels of equations of every pair of engines and of the systems of each engine.

    Systems of one engine that part are compared with every other engine too, and have momentum balances of
    their own, which tells the one that is wrong. An engine with soft constraints has a row for what they do
    to its reactions at the first state, which is to be the initial one.
    """
    pairs = (
        compare_pair((a.name, b.name), samples[a.name], samples[b.name]) for a, b in combinations(engines, 2)
    )
    return in_full([*pairs, *(_within(engine, engines, samples) for engine in engines)])


def _within(engine: Engine, engines: Sequence[Engine], samples: EngineSamples) -> Iterator[Check]:
    """The systems of one engine against each other, and what tells more of them if they part."""
    parted = False
    for one, two in combinations(samples[engine.name], 2):
        for row in compare_pair((one.name, two.name), [one], [two]):
            parted |= not row.agrees
            yield row
    for one in samples[engine.name] if parted else ():
        yield momentum_row(one.name, one)
        for other in engines:
            if other is not engine:
                yield from compare_pair((one.name, other.name), [one], samples[other.name])
    rigid = samples[engine.name][0]
    if engine.evaluate_soft_constraints is not None and rigid.states.all[0] is initial_state(
        rigid.states.scene
    ):
        yield softness_row(engine.name, engine.evaluate_soft_constraints(rigid.states.scene), rigid)


def sampled(engines: Sequence[Engine], states: States) -> EngineSamples:
    """The engines' rigid systems at the states."""
    return {e.name: [Samples(system, states) for system in e.systems(states.scene)] for e in engines}


def compare(scene: Scene, engines: Sequence[Engine], runs: Runs, states: int) -> list[Check]:
    """All levels in their order; arguments as of `stages`."""
    rows: list[Check] = []
    for stage in stages(scene, engines, runs, states).values():
        rows += stage(rows)
    return in_order(rows)


def stages(
    scene: Scene, engines: Sequence[Engine], runs: Runs, states: int, until: float | None = None
) -> dict[str, Callable[[Sequence[Check]], Iterator[Check]]]:
    """Parts of the comparison by what they do, one after the other; each is given the rows of those before.

    Args:
        scene: what is compared.
        engines: those that can express it.
        runs: by engine, as far as they came.
        states: number of random consistent states for the levels that need no run.
        until: s, the time up to which runs are those of the file that the scene was read from; None if they
            are to the end, and for scenes that are not from a file.
    """
    start = States(scene, (initial_state(scene),))

    @cache
    def samples() -> EngineSamples:
        others = random_states(scene, states)
        # constraints that lose rank at the start do not determine its accelerations
        compared = others if others and start.is_singular else [*start.all, *others]
        return sampled(engines, States(scene, tuple(compared)))

    def equations(_: Sequence[Check]) -> Iterator[Check]:
        yield from compare_equations(engines, samples())

    def trajectories(rows: Sequence[Check]) -> Iterator[Check]:
        ran = [engine for engine in engines if engine.name in runs]
        try:
            energy = samples()[engines[0].name][0].states.energy
        except AssemblyError:
            energy = start.energy  # runs may be compared where random states cannot be had
        parted = {row.between for row in rows if not row.agrees}
        yield from compare_runs(scene, ran, runs, energy, parted)
        if until is not None:
            yield from compare_runs_until(until, scene, ran, runs, energy, parted)

    def momentum(_: Sequence[Check]) -> Iterator[Check]:
        yield from (momentum_row(engine.name, samples()[engine.name][0]) for engine in engines)

    return {
        "comparing equations": equations,
        "comparing runs": trajectories,
        "balancing momentum": momentum,
    }


def in_order(rows: Iterable[Check]) -> list[Check]:
    """Rows by their levels."""
    return sorted(rows, key=lambda row: LEVELS.index(row.level))


def reading_rows(engines: Sequence[Engine], report: ImportReport | None) -> Iterator[Check]:
    """Figures of `newton_euler.reading.verify` for each engine; none for a scene that is from no file.

    Of the scene as the file says and with controls at random the one that is worst for its tolerance.
    """
    if report is None:
        return
    for engine in engines:
        found: dict[str, Check] = {}
        for reference, scene in report.references:
            for quantity, value, tolerance, where in verify(reference, engine.systems(scene)[0]):
                row = Check(READING, quantity, (engine.name, FILE), value, tolerance, where)
                known = found.setdefault(quantity, row)
                if not row.tolerance_ratio <= known.tolerance_ratio:
                    found[quantity] = row
        yield from found.values()
