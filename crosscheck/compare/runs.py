"""Comparison of whole runs: trajectories of each pair of engines, drift and energy balance of each engine.

In: the runs (simulations) of one scene in several engines. Out: checks at the levels "trajectories", "drift"
(violation of the joint constraints) and "energy". The tolerance of a check is the expected integration error
of the engines. If a check exceeds its tolerance, the engines are run again with a smaller step or tighter
tolerances (refined runs), and the tolerance is extended by the measured error. If the refined run does not
reduce the difference, the check is not judged: it can neither pass nor fail.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial, wraps
from itertools import combinations

import numpy as np

from crosscheck.compare.check import (
    CONSTRAINT_VIOLATION,
    ERROR_PER_CHANGE,
    NOISE_FACTOR,
    POSES,
    ROUND_OFF,
    Check,
    chain_despite_errors,
    reach,
)
from crosscheck.compare.samples import States
from crosscheck.engines.energy import energy_balance
from crosscheck.engines.engine import MAX_RELATIVE_ERROR, Engine
from crosscheck.support.errors import CrosscheckError
from newton_euler.equations.redundancy import mobility
from newton_euler.errors import NewtonEulerError
from newton_euler.model.euler_parameters import angle_between
from newton_euler.model.scene import Scene
from newton_euler.model.trajectory import StoppedError, Trajectory, distance
from newton_euler.runs.assemble import initial_state
from newton_euler.scalars import Array

Difference = Callable[[Trajectory, Trajectory], Array]
"""Function that returns the differences of one quantity in two runs: (n,) at n times, or (n, b or j) for b
bodies or j joints."""

Runs = Mapping[str, Trajectory]
"""Runs by the name of the engine."""

MAX_REMAINING_ERROR = 1.0 - 1.0 / ERROR_PER_CHANGE
"""Largest fraction of an error that may remain in a refined run. If more remains, the error exceeds
`ERROR_PER_CHANGE` times the change of the run."""


def _until_shorter_ends(difference: Difference) -> Difference:
    """Decorate a `Difference` so that it compares two runs up to the end of the shorter one."""

    @wraps(difference)
    def shortened(x: Trajectory, y: Trajectory) -> Array:
        end = min(len(x.time), len(y.time))
        return difference(x.first(end), y.first(end))

    return shortened


@_until_shorter_ends
def positions_apart(x: Trajectory, y: Trajectory) -> Array:
    """Return distances (n, b) between the positions of the bodies in two runs, m."""
    return np.asarray(np.linalg.norm(x.position - y.position, axis=2))


@_until_shorter_ends
def orientations_apart(x: Trajectory, y: Trajectory) -> Array:
    """Return angles (n, b) between the orientations of the bodies in two runs, rad."""
    return angle_between(x.quaternion, y.quaternion)


@_until_shorter_ends
def _violations_apart(x: Trajectory, y: Trajectory) -> Array:
    """Return differences (n, j) of the constraint violations of the joints in two runs, m or rad."""
    assert x.constraint_violation is not None
    assert y.constraint_violation is not None
    return np.abs(x.constraint_violation - y.constraint_violation)


@_until_shorter_ends
def _kinetic_energies_apart(x: Trajectory, y: Trajectory) -> Array:
    """Return differences (n,) of the kinetic energies of two runs, J."""
    assert x.kinetic_energy is not None
    assert y.kinetic_energy is not None
    return np.abs(x.kinetic_energy - y.kinetic_energy)


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
    of energies are relative to the run's kinetic energy or to `energy`, whichever is larger.

    Args:
        scene: scene that was simulated.
        engines: engines that have a run.
        runs: runs by engine. Partial runs are compared up to their ends.
        energy: smallest unit of energy differences, J, such as weight times size of the mechanism.
        differing: pairs of engines that differ at an earlier level and are not compared.
    """
    bodies, joints, times = scene.mechanism.body_names, scene.mechanism.joint_names, scene.times
    noise = _redundancy_noise(scene)
    # Refined runs, computed when a check first needs them
    refined_runs: dict[str, Trajectory] = {}
    not_refinable: set[str] = set()

    def length_unit(between: Sequence[Engine]) -> float:
        """Return the unit of lengths, m: the mechanism's reach until the shortest run of `between` ends.

        The run with the smallest reach counts: a diverging run must not extend the tolerances.
        """
        end = min(len(runs[engine.name].time) for engine in between)
        reaches = [reach(scene, run.first(end).position) for run in runs.values() if len(run.time) >= end]
        return max(1.0, min(reaches))

    def refine(engine: Engine) -> None:
        """Compute the refined run of an engine; it may be partial only if the run itself is."""
        try:
            refined_runs[engine.name] = engine.refined(scene)
        except StoppedError as error:
            if error.partial is None or len(runs[engine.name].time) == len(times):
                raise
            refined_runs[engine.name] = error.partial

    def change_if_refined(engine: Engine, difference: Difference) -> float:
        """Measure the largest difference between an engine's run and its refined run."""
        if engine.name not in refined_runs:
            refine(engine)
        return float(np.max(difference(runs[engine.name], refined_runs[engine.name])))

    def unconverged_engine(
        between: Sequence[Engine],
        compared_value: Callable[[Runs], Array],
        difference: Difference,
        floor: float,
    ) -> str:
        """Return the engine whose refined run does not reduce the value of a check; empty if none.

        Of the engines of the check, the one whose run changes most when refined is tested. The value is
        computed with the given run of the other engine first, which costs nothing, and then with its refined
        run, which has a smaller error. Each check is tested separately, since a run may converge in one
        quantity or towards one engine only.

        Args:
            between, compared_value, difference: see `make_check`.
            floor: value that is small enough in any case.
        """
        refined = [engine for engine in between if engine.name in refined_runs]
        name = max(refined, key=lambda engine: change_if_refined(engine, difference)).name

        def decreases(others: Runs) -> bool:
            """Return True if the refined run of the engine `name` reduces the value, given other runs."""
            before = float(np.max(compared_value({**others, name: runs[name]})))
            after = float(np.max(compared_value({**others, name: refined_runs[name]})))
            return after <= max(MAX_REMAINING_ERROR * before, floor)

        if decreases(runs):
            return ""
        for engine in between:
            if engine.name not in refined_runs and engine.name not in not_refinable:
                try:
                    refine(engine)
                except (NewtonEulerError, CrosscheckError):
                    not_refinable.add(engine.name)
        return "" if decreases({**runs, **refined_runs}) else name

    # One check: the largest difference, with a tolerance that is extended by measured errors if needed

    def make_check(
        level: str,
        quantity: str,
        between: Sequence[Engine],
        compared_value: Callable[[Runs], Array],
        difference: Difference,
        fixed: float,
        unit: float,
        shown_unit: float = 1.0,
    ) -> Check:
        """Make one check.

        Args:
            level, quantity: attributes of the check.
            between: one or two engines.
            compared_value: computes the compared value from a set of runs: (n,) at n times, or (n, b or j).
            difference: measures the change of the value between a run of an engine and its refined run.
            fixed: fixed tolerance, relative to `unit`.
            unit: unit of the tolerance, m, rad or J.
            shown_unit: unit in which value and tolerance are shown.
        """
        values = compared_value(runs)
        value, tolerance = float(np.max(values)), fixed * unit
        where = place_of_largest(values, joints if level == "drift" else bodies)
        # Extend the tolerance by measured errors, beginning with the fastest engine
        coarse: list[str] = []
        for engine in sorted(between, key=lambda engine: runs[engine.name].wall_time):
            if value <= tolerance:
                break
            change = change_if_refined(engine, difference)
            tolerance += min(ERROR_PER_CHANGE * change, MAX_RELATIVE_ERROR * unit)
            if ERROR_PER_CHANGE * change > MAX_RELATIVE_ERROR * unit:
                coarse.append(f"{engine.name}'s own run changes by {change / shown_unit:.2g} when refined")
        # A check that passes by the extension only is judged only if refining reduces the difference
        extended = fixed * unit < value <= tolerance
        floor = max(fixed, ROUND_OFF) * unit
        unconverged = unconverged_engine(between, compared_value, difference, floor) if extended else ""
        return Check(
            level,
            quantity,
            between=tuple(engine.name for engine in between),
            value=value / shown_unit,
            tolerance=tolerance / shown_unit,
            where=where,
            judged=not unconverged,
            unconverged=unconverged,
            detail="; ".join(coarse) if value > tolerance else "",
        )

    def place_of_largest(values: Array, names: Sequence[str]) -> str:
        """Return the time of the largest value, after the name of its body or joint if there is one."""
        if values.ndim == 1:
            return f"{times[int(np.argmax(values))]:.3g} s"
        n, k = divmod(int(np.argmax(values)), values.shape[1])
        return f"{names[k]} at {times[n]:.3g} s"

    # The checks of each level

    def between_two(a: Engine, b: Engine, difference: Difference) -> Callable[[Runs], Array]:
        """Return a function that computes the difference of two engines from a set of runs."""
        return lambda some_runs: difference(some_runs[a.name], some_runs[b.name])

    def trajectories(a: Engine, b: Engine) -> Iterator[Check]:
        """Compare poses of two engines; a pair that fails is added to `differing_pairs`."""
        fixed = a.trajectory_error + b.trajectory_error + noise
        positions, orientations = POSES  # names of the quantities in checks, with their units
        for quantity, difference, unit in (
            (positions, positions_apart, length_unit((a, b))),
            (orientations, orientations_apart, 1.0),
        ):
            compared_value = between_two(a, b, difference)
            check = make_check("trajectories", quantity, (a, b), compared_value, difference, fixed, unit)
            if not check.agrees:
                differing_pairs.add((a.name, b.name))
            yield check

    def drift(engine: Engine) -> Iterator[Check]:
        """Check the constraint violation of one engine."""
        if runs[engine.name].constraint_violation is not None:
            yield make_check(
                "drift",
                CONSTRAINT_VIOLATION,
                between=(engine,),
                compared_value=partial(_violation, engine.name),
                difference=_violations_apart,
                fixed=engine.drift + noise,
                unit=length_unit((engine,)),
            )

    def kinetic_energy(a: Engine, b: Engine) -> Iterator[Check]:
        """Compare kinetic energies of two engines, unless their trajectories differ."""
        kinetic = runs[a.name].kinetic_energy
        if kinetic is not None and (a.name, b.name) not in differing_pairs:
            unit = max(energy, float(np.max(kinetic[: len(runs[b.name].time)])))
            yield make_check(
                "energy",
                "kinetic energy, rel",
                between=(a, b),
                compared_value=between_two(a, b, _kinetic_energies_apart),
                difference=_kinetic_energies_apart,
                fixed=a.energy_error + b.energy_error + noise,
                unit=unit,
                shown_unit=unit,
            )

    def energy_balance_error(engine: Engine) -> Iterator[Check]:
        """Check the energy balance of one engine."""
        balance = energy_balance(scene, runs[engine.name])
        if balance is not None:
            unit = max(energy, balance.scale)
            yield make_check(
                "energy",
                "energy balance error, rel",
                between=(engine,),
                compared_value=partial(_balance_error, scene, engine.name),
                difference=_balances_apart(scene),
                fixed=engine.energy_error + noise,
                unit=unit,
                shown_unit=unit,
            )

    # All checks, of pairs that do not differ at an earlier level
    differing_pairs = set(differing)
    pairs = [(a, b) for a, b in combinations(engines, 2) if (a.name, b.name) not in differing_pairs]
    yield from chain_despite_errors(
        [
            *(trajectories(a, b) for a, b in pairs),
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
) -> Iterator[Check]:
    """Compare trajectories up to a time, with tolerances that are measured up to that time only.

    Used with the time from which elements of a model file would act that are not simulated, such as contacts.
    There are no checks if the time is before the second output, or after the last one.

    Args:
        until: time, s.
        scene, engines, runs, energy, differing: see `compare_runs`.
    """
    count = int(np.searchsorted(scene.times, until, side="right"))
    if count < 2 or count == len(scene.times):
        return
    shorter = {name: run.first(count) for name, run in runs.items()}
    for check in compare_runs(scene, engines, shorter, energy, differing):
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


def _balances_apart(scene: Scene) -> Difference:
    """Return a function that computes differences (n,) of the energy balance errors of two runs, J."""

    @_until_shorter_ends
    def difference(x: Trajectory, y: Trajectory) -> Array:
        first, second = energy_balance(scene, x), energy_balance(scene, y)
        assert first is not None
        assert second is not None
        return np.abs(first.residual - second.residual)

    return difference
