"""Comparison of engines, level by level, from the model itself to whole runs.

In: a scene (a mechanism with its forces and initial state), the engines and their runs (simulations). Out:
checks. Each `Check` compares one quantity of a pair of engines with its tolerance, or tests one engine; a
level is a group of checks. The levels of equations use each engine's equations of motion with rigid
constraints, at states that satisfy the constraints; a difference there comes from the models. The later
levels use runs; only their check of the momentum balance uses the equations.

Relative differences are relative to the largest value over all states, since the value at a single state may
be round-off: at rest, in equilibrium and in free fall many quantities vanish.

A pair is compared up to the first level at which it differs; later levels would only repeat the difference.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from functools import cache
from itertools import combinations, product

from crosscheck.compare.accelerations import acceleration_checks, softness_check
from crosscheck.compare.check import FILE, LEVELS, READING, Check, chain_despite_errors
from crosscheck.compare.dynamics import dynamics_checks
from crosscheck.compare.kinematics import kinematics_checks
from crosscheck.compare.model import model_checks
from crosscheck.compare.momentum import momentum_check
from crosscheck.compare.run_checks import Runs
from crosscheck.compare.runs import compare_runs, compare_runs_until
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

EQUATION_LEVELS: tuple[Level, ...] = (model_checks, kinematics_checks, dynamics_checks, acceleration_checks)
"""Functions of the levels that compare equations, in their order."""

EngineSamples = dict[str, list[Samples]]
"""Equations of motion of each engine at the same states, by engine name: one `Samples` per formulation
(choice of coordinates). Only newton_euler, this project's solver, has several formulations."""


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
        worst: dict[str, Check] = {}  # by quantity
        for one, two in product(first, second):
            for check in level(pair, one, two):
                _keep_worst(worst, check)
        yield from worst.values()
        if not all(check.agrees for check in worst.values()):
            return


def _keep_worst(worst: dict[str, Check], check: Check) -> None:
    """Put a check into `worst`, unless `worst` has a check of this quantity that is closer to failing.

    A check of NaN counts as failing.
    """
    known = worst.setdefault(check.quantity, check)
    if not check.tolerance_ratio <= known.tolerance_ratio:
        worst[check.quantity] = check


def compare_equations(engines: Sequence[Engine], samples: EngineSamples) -> Iterator[Check]:
    """Compare the equations of every pair of engines, and the formulations of each engine with each other.

    Formulations that differ are also compared with every other engine, and each gets a check of its momentum
    balance, so that `crosscheck.compare.outlier` can find the wrong one. An engine with soft constraints
    gets a check of their effect on its reactions, if the first state is the initial state of the scene.
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
    """Yield the checks of `compare_equations` on one engine: of its formulations and soft constraints.

    Args:
        engine: the engine.
        engines: all engines, with which formulations that differ from each other are compared.
        samples: equations of all engines.
    """
    differ = False
    for one, two in combinations(samples[engine.name], 2):
        for check in compare_pair((one.name, two.name), [one], [two]):
            differ |= not check.agrees
            yield check
    if differ:
        for formulation in samples[engine.name]:
            yield momentum_check(formulation.name, formulation)
            for other in engines:
                if other is not engine:
                    pair = (formulation.name, other.name)
                    yield from compare_pair(pair, [formulation], samples[other.name])
    if not samples[engine.name]:  # an engine without equations is compared by its runs only
        return
    # The effect of soft constraints at the initial state, a single object per scene. A singular initial state
    # is not among the states
    rigid = samples[engine.name][0]
    scene = rigid.states.scene
    if engine.soft_constraints is not None and rigid.states.all[0] is initial_state(scene):
        yield softness_check(engine.name, engine.soft_constraints, rigid)


def sample_engines(engines: Sequence[Engine], states: States) -> EngineSamples:
    """Return the equations of motion of all engines at some states."""
    return {
        engine.name: [Samples(system, states) for system in engine.systems(states.scene)]
        for engine in engines
    }


def compare(scene: Scene, engines: Sequence[Engine], runs: Runs, states: int) -> list[Check]:
    """Return the checks of all levels in the order of levels. The arguments are those of `stages`."""
    checks: list[Check] = []
    for stage in stages(scene, engines, runs, states).values():
        checks += stage(checks)
    return in_order(checks)


def stages(
    scene: Scene, engines: Sequence[Engine], runs: Runs, states: int, until: float | None = None
) -> dict[str, Callable[[Sequence[Check]], Iterator[Check]]]:
    """Return the stages of the comparison, by a text for progress messages, in the order of execution.

    A stage is a function that yields checks. The argument of a stage is all checks of the stages before.

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
        """Return the equations at the initial state and at random states, the same for all stages."""
        others = random_states(scene, states)
        # Leave out a singular initial state, at which the constraints do not determine accelerations
        compared = others if others and start.is_singular else [*start.all, *others]
        return sample_engines(engines, States(scene, tuple(compared)))

    def equations(_: Sequence[Check]) -> Iterator[Check]:
        yield from compare_equations(engines, samples())

    def trajectories(checks: Sequence[Check]) -> Iterator[Check]:
        engines_with_run = [engine for engine in engines if engine.name in runs]
        # Smallest unit, J, of energy differences. It depends on the states only, which all engines share
        energy_unit, without_equations = start.energy, list[str]()
        with suppress(AssemblyError):  # no random states could be found; runs can be compared without them
            energy_unit = next((each[0].states.energy for each in samples().values() if each), energy_unit)
            without_equations = [name for name, of_engine in samples().items() if not of_engine]
        differing = {check.between for check in checks if not check.agrees}
        compared = scene, engines_with_run, runs, energy_unit, differing, without_equations
        yield from compare_runs(*compared)
        if until is not None:
            yield from compare_runs_until(until, *compared)

    def momentum(_: Sequence[Check]) -> Iterator[Check]:
        yield from (momentum_check(name, of_engine[0]) for name, of_engine in samples().items() if of_engine)

    return {
        "comparing equations": equations,
        "comparing runs": trajectories,
        "balancing momentum": momentum,
    }


def in_order(checks: Iterable[Check]) -> list[Check]:
    """Sort checks by level; within a level they keep their order."""
    return sorted(checks, key=lambda check: LEVELS.index(check.level))


def reading_checks(engines: Sequence[Engine], report: ImportReport | None) -> Iterator[Check]:
    """Compare each engine's equations with the model file that the scene was imported from.

    The report has reference models of the file, computed by MuJoCo or Pinocchio: one with the actuator inputs
    of the file, and one with random inputs. Of the two, a check shows the one closer to failing.

    Args:
        engines: engines that can represent the scene.
        report: import report; None for a scene that is not from a model file, which has no such checks.
    """
    if report is None:
        return
    for engine in engines:
        worst: dict[str, Check] = {}
        for reference, scene in report.references:
            for system in engine.systems(scene)[:1]:  # equations in the first formulation, if it has any
                for quantity, value, tolerance, where in verify(reference, system):
                    check = Check(READING, quantity, (engine.name, FILE), value, tolerance, where)
                    _keep_worst(worst, check)
        yield from worst.values()
