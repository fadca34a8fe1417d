"""Comparison of whole runs: trajectories of each pair of engines, drift and energy balance of each engine.

In: the runs (simulations) of one scene in several engines. Out: checks at the levels "trajectories", "drift"
(violation of the joint constraints) and "energy". The tolerance of a check is the expected integration error
of the engines. If a check exceeds its tolerance, the engines are run again with a smaller step or tighter
tolerances (refined runs), and the tolerance is extended by the measured error. If the refined run does not
reduce the difference, the check is not judged: it can neither pass nor fail.

The levels of equations of motion compare reactions of joints. Runs of an engine without equations have checks
of reactions instead.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cache, partial
from itertools import combinations

import numpy as np

from crosscheck.compare.check import (
    CONSTRAINT_VIOLATION,
    ERROR_PER_CHANGE,
    NOISE_FACTOR,
    POSES,
    REACTIONS,
    ROUND_OFF,
    Check,
    chain_despite_errors,
    reach,
)
from crosscheck.compare.run_checks import RunChecks, Runs
from crosscheck.compare.run_differences import (
    Difference,
    ReactionDifferences,
    balances_apart,
    kinetic_energies_apart,
    largest_reaction,
    orientations_apart,
    positions_apart,
    reactions_apart,
    violations_apart,
)
from crosscheck.compare.samples import States
from crosscheck.engines.energy import energy_balance
from crosscheck.engines.engine import MAX_RELATIVE_ERROR, Engine
from newton_euler.equations.redundancy import mobility
from newton_euler.model.euler_parameters import angle_between
from newton_euler.model.scene import Scene
from newton_euler.model.trajectory import Trajectory, distance
from newton_euler.runs.assemble import initial_state
from newton_euler.scalars import Array


def measure_run_errors(scene: Scene, engines: Sequence[Engine], runs: Runs) -> dict[str, float]:
    """Compute the error of each engine's run: the largest deviation from a reference run, m or rad.

    The reference is the refined run of the first engine with rigid constraints. Partial runs are compared up
    to their ends.

    Args:
        scene: the scene.
        engines: engines that may provide the reference, outliers excluded.
        runs: runs whose errors are computed.

    Returns:
        Errors by engine; empty if no engine has rigid constraints.

    Raises:
        NewtonEulerError, CrosscheckError: if the reference run does not complete.
    """
    rigid = next((engine for engine in engines if engine.soft_constraints is None), None)
    if rigid is None or not runs:
        return {}
    reference = rigid.refined(scene)
    return {name: distance(run, reference.first(len(run.time))) for name, run in runs.items()}


def displacements(runs: Mapping[str, Trajectory]) -> dict[str, float]:
    """Return the largest displacement of any body from its start, m or rad, by engine."""
    largest = {}
    for name, run in runs.items():
        start = np.broadcast_to(run.quaternion[0], run.quaternion.shape)
        moved = np.linalg.norm(run.position - run.position[0], axis=-1)
        turned = angle_between(run.quaternion, start)
        largest[name] = float(np.max((moved, turned)))
    return largest


def nothing_moves_in_rigid_runs(
    scene: Scene, engines: Sequence[Engine], runs: Mapping[str, Trajectory]
) -> bool:
    """Return True if nothing moves in the runs of the engines with rigid constraints, see `nothing_moves`.

    Soft constraints yield a little even in a mechanism at rest. Engines with soft constraints count only if
    no other engine has a run.
    """
    engines_with_run = [engine for engine in engines if engine.name in runs]
    rigid = [engine for engine in engines_with_run if engine.soft_constraints is None]
    considered = rigid or engines_with_run
    return bool(considered) and nothing_moves({each.name: runs[each.name] for each in considered}, scene)


def nothing_moves(runs: Mapping[str, Trajectory], scene: Scene) -> bool:
    """Return True if all displacements in the runs, m or rad, are round-off.

    The round-off is relative to the mechanism's reach (its size or its largest coordinate), at least to 1.
    """
    reaches = {name: max(1.0, reach(scene, run.position)) for name, run in runs.items()}
    return all(
        displacement <= ROUND_OFF * reaches[name] for name, displacement in displacements(runs).items()
    )


def compare_runs(
    scene: Scene,
    engines: Sequence[Engine],
    runs: Runs,
    energy: float,
    differing: Collection[tuple[str, ...]] = (),
    without_equations: Collection[str] = (),
) -> Iterator[Check]:
    """Compare runs at the levels "trajectories", "drift" and "energy".

    Each engine has a fixed relative tolerance for its expected error. If a check exceeds that tolerance, the
    engine is run again, once, with a smaller step or tighter tolerances. The tolerance of the check is then
    extended by `ERROR_PER_CHANGE` times the change of the run. This assumes that refining reduces the error.
    The extension is at most the relative error `MAX_RELATIVE_ERROR`: a run with a larger error is too coarse
    to test a model. If the difference does not decrease in the refined run, and exceeds the fixed tolerances
    and round-off, the check is not judged.

    Tolerances of angles are relative to 1 rad. Those of lengths are relative to the mechanism's reach (its
    size or its largest coordinate in the runs), at least 1 m, as in the error control of integrators. Those
    of energies are relative to the run's kinetic energy or to `energy`, whichever is larger. Those of
    reactions are relative to the largest reaction of the run, or to `energy` per size of the mechanism.

    Args:
        scene: scene that was simulated.
        engines: engines that have a run.
        runs: runs by engine. Partial runs are compared up to their ends.
        energy: smallest unit of energy differences, J, such as weight times size of the mechanism.
        differing: pairs of engines that differ at an earlier level and are not compared.
        without_equations: names of engines without equations of motion, whose reactions are compared here.
    """
    bodies, joints, size = scene.mechanism.body_names, scene.mechanism.joint_names, scene.mechanism.size
    noise = _redundancy_noise(scene)
    checks = RunChecks(scene, runs, in_full=bool(without_equations))

    # The checks of each level

    def between_two(a: Engine, b: Engine, difference: Difference) -> Callable[[Runs], Array]:
        """Return a function that computes the difference of two engines from a set of runs."""
        return lambda some_runs: difference(some_runs[a.name], some_runs[b.name])

    def trajectories(a: Engine, b: Engine) -> Iterator[Check]:
        """Compare poses of two engines; a pair that fails is added to `differing_pairs`."""
        fixed = a.trajectory_error + b.trajectory_error + noise
        positions, orientations = POSES  # names of the quantities in checks, with their units
        for quantity, difference, unit in (
            (positions, positions_apart, checks.length_unit((a, b))),
            (orientations, orientations_apart, 1.0),
        ):
            compared_value = between_two(a, b, difference)
            check = checks.check(
                "trajectories", quantity, (a, b), compared_value, difference, fixed, unit, bodies
            )
            if not check.agrees:
                differing_pairs.add((a.name, b.name))
            yield check

    @cache
    def reaction_differences(engine: str) -> ReactionDifferences:
        """Return the functions that compute differences of reactions, with the poses of an engine's run."""
        return reactions_apart(scene, runs[engine])

    def reactions(a: Engine, b: Engine) -> Iterator[Check]:
        """Compare reactions of two engines that have some, unless their poses differ; see `trajectories`.

        Like kinetic energies, reactions depend on the squares of velocities, so that their errors are those
        of energies. Soft constraints have an error of their own. A check is not judged if the reactions of an
        engine change too much in a refined run, as they do near singular configurations.
        """
        has_reactions = all(runs[engine.name].reaction_force is not None for engine in (a, b))
        if not has_reactions or (a.name, b.name) in differing_pairs:
            return
        soft = sum(each.soft_constraints.force_error for each in (a, b) if each.soft_constraints)
        end = checks.shortest((a, b))
        largest = min(largest_reaction(runs[engine.name].first(end), size) for engine in (a, b))
        force_unit = max(energy / size, largest)
        units = force_unit, force_unit * size
        for quantity, difference, unit in zip(REACTIONS, reaction_differences(a.name), units, strict=True):
            check = checks.check(
                "trajectories",
                quantity,
                between=(a, b),
                compared_value=between_two(a, b, difference),
                difference=difference,
                fixed=a.energy_error + b.energy_error + noise + soft,
                unit=unit,
                names=joints,
                shown_unit=unit,
            )
            if not check.agrees:
                for engine in (a, b):
                    change = checks.change_if_refined(engine, difference)
                    if ERROR_PER_CHANGE * change > MAX_RELATIVE_ERROR * unit:
                        check = replace(check, judged=False, unconverged=engine.name, detail="")
            if not check.agrees:
                differing_pairs.add((a.name, b.name))
            yield check

    def drift(engine: Engine) -> Iterator[Check]:
        """Check the constraint violation of one engine."""
        if runs[engine.name].constraint_violation is not None:
            yield checks.check(
                "drift",
                CONSTRAINT_VIOLATION,
                between=(engine,),
                compared_value=partial(_violation, engine.name),
                difference=violations_apart,
                fixed=engine.drift + noise,
                unit=checks.length_unit((engine,)),
                names=joints,
            )

    def kinetic_energy(a: Engine, b: Engine) -> Iterator[Check]:
        """Compare kinetic energies of two engines, unless their trajectories differ."""
        kinetic = runs[a.name].kinetic_energy
        if kinetic is not None and (a.name, b.name) not in differing_pairs:
            unit = max(energy, float(np.max(kinetic[: len(runs[b.name].time)])))
            yield checks.check(
                "energy",
                "kinetic energy, rel",
                between=(a, b),
                compared_value=between_two(a, b, kinetic_energies_apart),
                difference=kinetic_energies_apart,
                fixed=a.energy_error + b.energy_error + noise,
                unit=unit,
                names=(),
                shown_unit=unit,
            )

    def energy_balance_error(engine: Engine) -> Iterator[Check]:
        """Check the energy balance of one engine."""
        balance = energy_balance(scene, runs[engine.name])
        if balance is not None:
            unit = max(energy, balance.scale)
            yield checks.check(
                "energy",
                "energy balance error, rel",
                between=(engine,),
                compared_value=partial(_balance_error, scene, engine.name),
                difference=balances_apart(scene),
                fixed=engine.energy_error + noise,
                unit=unit,
                names=(),
                shown_unit=unit,
            )

    # All checks, of pairs that do not differ at an earlier level
    differing_pairs = set(differing)
    pairs = [(a, b) for a, b in combinations(engines, 2) if (a.name, b.name) not in differing_pairs]
    yield from chain_despite_errors(
        [
            *(trajectories(a, b) for a, b in pairs),
            *(reactions(a, b) for a, b in pairs if {*without_equations} & {a.name, b.name}),
            *(drift(engine) for engine in engines),
            *(kinetic_energy(a, b) for a, b in pairs),
            *(energy_balance_error(engine) for engine in engines),
        ]
    )


def compare_runs_until(
    until: float,
    scene: Scene,
    engines: Sequence[Engine],
    runs: Runs,
    energy: float,
    differing: Collection[tuple[str, ...]] = (),
    without_equations: Collection[str] = (),
) -> Iterator[Check]:
    """Compare trajectories up to a time, with tolerances that are measured up to that time only.

    Used with the time from which elements of a model file would act that are not simulated, such as contacts.
    There are no checks if the time is before the second output, or after the last one.

    Args:
        until: time, s.
        scene, engines, runs, energy, differing, without_equations: see `compare_runs`.
    """
    count = int(np.searchsorted(scene.times, until, side="right"))
    if count < 2 or count == len(scene.times):
        return
    shorter = {name: run.first(count) for name, run in runs.items()}
    for check in compare_runs(scene, engines, shorter, energy, differing, without_equations):
        if check.level == "trajectories":
            quantity, _, unit = check.quantity.rpartition(", ")
            yield replace(check, quantity=f"{quantity} until {until:.4g} s, {unit}")


def _redundancy_noise(scene: Scene) -> float:
    """Return the relative difference of runs that nearly redundant constraints may cause; 0 without them.

    Each engine omits one of the nearly redundant equations, not always the same one. The difference is up to
    `NOISE_FACTOR` times their largest singular value. The constraints magnify the difference by their
    condition number, taken at the start.
    """
    residual = mobility(scene).residual  # largest singular value that is treated as redundant
    if residual == 0.0:
        return 0.0
    return min(NOISE_FACTOR * residual * States(scene, (initial_state(scene),)).condition, MAX_RELATIVE_ERROR)


def _violation(engine: str, runs: Runs) -> Array:
    """Return constraint violations (n, j) of the joints in an engine's run, m or rad."""
    violation = runs[engine].constraint_violation
    assert violation is not None
    return violation


def _balance_error(scene: Scene, engine: str, runs: Runs) -> Array:
    """Return absolute energy balance errors (n,) of an engine's run, J: change of energy minus work."""
    balance = energy_balance(scene, runs[engine])
    assert balance is not None
    return np.abs(balance.residual)
