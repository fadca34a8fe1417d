"""Comparison of engines, level by level, from the model itself to whole runs.

In: a scene, the engines and their runs. Out: checks. Each `Check` compares one quantity of a pair of engines,
or tests one engine. The first four levels use each engine's equations of motion with rigid constraints, at
states that satisfy the constraints; a difference there comes from the models. The later levels use runs.

Relative differences are relative to the largest value over all states, since the value at a single state may
be round-off: at rest, in equilibrium and in free fall many quantities vanish.

A pair is compared up to the first level at which it differs; later levels would only repeat the difference.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import cache
from itertools import combinations, product

from crosscheck.compare.accelerations import acceleration_rows, softness_row
from crosscheck.compare.check import FILE, LEVELS, READING, Check, chain_despite_errors
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
"""Function that yields the checks of a level for two systems, given their names and samples."""

EQUATION_LEVELS: tuple[Level, ...] = (model_rows, kinematics_rows, dynamics_rows, acceleration_rows)
"""Functions of the four levels that compare equations, in their order."""

EngineSamples = dict[str, list[Samples]]
"""Equations of motion of each engine (one `Samples` per formulation) at the same states, by engine name."""


def compare_pair(
    pair: tuple[str, str],
    first: Sequence[Samples],
    second: Sequence[Samples],
    levels: Sequence[Level] = EQUATION_LEVELS,
) -> Iterator[Check]:
    """Compare the equations of two engines, up to the first level at which they differ.

    Args:
        pair: names of the two engines, for the checks.
        first, second: equations of the two engines, one item per formulation. If there are several, a check
            shows the formulations that are closest to failing.
        levels: functions of the levels, in their order.
    """
    for level in levels:
        worst: dict[str, Check] = {}
        for one, two in product(first, second):
            for row in level(pair, one, two):
                _keep_worst(worst, row)
        yield from worst.values()
        if not all(row.agrees for row in worst.values()):
            return


def _keep_worst(worst: dict[str, Check], row: Check) -> None:
    """Put a check into `worst`, by quantity, unless that has one closer to failing; NaN counts as failing."""
    known = worst.setdefault(row.quantity, row)
    if not row.tolerance_ratio <= known.tolerance_ratio:
        worst[row.quantity] = row


def compare_equations(engines: Sequence[Engine], samples: EngineSamples) -> Iterator[Check]:
    """Compare the equations of every pair of engines, and the formulations of each engine with each other.

    Formulations that differ are also compared with every other engine, and each gets a check of its momentum
    balance, so that the diagnosis can find the wrong one. An engine with soft constraints gets a check of
    their effect on its reactions, if the first state is the initial state of the scene.
    """
    pairs = (
        compare_pair((a.name, b.name), samples[a.name], samples[b.name]) for a, b in combinations(engines, 2)
    )
    return chain_despite_errors(
        [*pairs, *(_compare_formulations(engine, engines, samples) for engine in engines)]
    )


def _compare_formulations(
    engine: Engine, engines: Sequence[Engine], samples: EngineSamples
) -> Iterator[Check]:
    """Compare the formulations of one engine with each other; see `compare_equations`."""
    differ = False
    for one, two in combinations(samples[engine.name], 2):
        for row in compare_pair((one.name, two.name), [one], [two]):
            differ |= not row.agrees
            yield row
    if differ:
        for formulation in samples[engine.name]:
            yield momentum_row(formulation.name, formulation)
            for other in engines:
                if other is not engine:
                    pair = (formulation.name, other.name)
                    yield from compare_pair(pair, [formulation], samples[other.name])
    # The effect of soft constraints
    rigid = samples[engine.name][0]
    if engine.evaluate_soft_constraints is not None and rigid.states.all[0] is initial_state(
        rigid.states.scene
    ):
        yield softness_row(engine.name, engine.evaluate_soft_constraints(rigid.states.scene), rigid)


def sampled(engines: Sequence[Engine], states: States) -> EngineSamples:
    """Return the equations of motion of all engines at some states."""
    return {
        engine.name: [Samples(system, states) for system in engine.systems(states.scene)]
        for engine in engines
    }


def compare(scene: Scene, engines: Sequence[Engine], runs: Runs, states: int) -> list[Check]:
    """Return the checks of all levels in the order of levels. The arguments are those of `stages`."""
    rows: list[Check] = []
    for stage in stages(scene, engines, runs, states).values():
        rows += stage(rows)
    return in_order(rows)


def stages(
    scene: Scene, engines: Sequence[Engine], runs: Runs, states: int, until: float | None = None
) -> dict[str, Callable[[Sequence[Check]], Iterator[Check]]]:
    """Return the stages of the comparison, by a text for progress messages, in the order of execution.

    Each stage is a function that yields checks. Its argument is all checks of the stages before.

    Args:
        scene: scene that is compared.
        engines: engines that can represent the scene.
        runs: run of each engine; partial if the engine stopped.
        states: number of random states at which equations are compared.
        until: time, s, at which the first element of the model file that is not simulated (such as a contact)
            would act. Runs are then also compared up to this time. None if no such element acts.
    """
    start = States(scene, (initial_state(scene),))

    @cache
    def samples() -> EngineSamples:
        """Evaluate the equations once, for all stages."""
        others = random_states(scene, states)
        # Leave out a singular initial state, at which the constraints do not determine accelerations
        compared = others if others and start.is_singular else [*start.all, *others]
        return sampled(engines, States(scene, tuple(compared)))

    def equations(_: Sequence[Check]) -> Iterator[Check]:
        yield from compare_equations(engines, samples())

    def trajectories(rows: Sequence[Check]) -> Iterator[Check]:
        engines_with_run = [engine for engine in engines if engine.name in runs]
        try:
            energy = samples()[engines[0].name][0].states.energy
        except AssemblyError:  # no random states could be found; runs can be compared without
            energy = start.energy
        differing = {row.between for row in rows if not row.agrees}
        yield from compare_runs(scene, engines_with_run, runs, energy, differing)
        if until is not None:
            yield from compare_runs_until(until, scene, engines_with_run, runs, energy, differing)

    def momentum(_: Sequence[Check]) -> Iterator[Check]:
        yield from (momentum_row(engine.name, samples()[engine.name][0]) for engine in engines)

    return {
        "comparing equations": equations,
        "comparing runs": trajectories,
        "balancing momentum": momentum,
    }


def in_order(rows: Iterable[Check]) -> list[Check]:
    """Sort checks by level; within a level they keep their order."""
    return sorted(rows, key=lambda row: LEVELS.index(row.level))


def reading_rows(engines: Sequence[Engine], report: ImportReport | None) -> Iterator[Check]:
    """Compare each engine's equations with the model file that the scene was imported from.

    The report has reference models of the file, computed by MuJoCo or Pinocchio: one with the controls of the
    file, and one with random controls. Of the two, a check shows the one closer to failing.

    Args:
        engines: engines that can represent the scene.
        report: import report; None for a scene that is not from a model file, which has no such checks.
    """
    if report is None:
        return
    for engine in engines:
        worst: dict[str, Check] = {}
        for reference, scene in report.references:
            for quantity, value, tolerance, where in verify(reference, engine.systems(scene)[0]):
                _keep_worst(worst, Check(READING, quantity, (engine.name, FILE), value, tolerance, where))
        yield from worst.values()
