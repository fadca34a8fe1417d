"""Comparison of whole runs: trajectories of each pair of engines, drift and energy balance of each engine.

In: the runs of the engines. Out: checks at the levels "trajectories", "drift" and "energy". The tolerance of
a check is the expected integration error of the engines. If a check exceeds it, the engines are run again
with a smaller step or tighter tolerances (refined runs), and the tolerance is extended by the measured error.
If the refined run does not reduce the difference, the check is not judged.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial, wraps
from itertools import combinations

import numpy as np

from crosscheck.compare.check import (
    CONSTRAINT_VIOLATION,
    NOISE,
    OWN_ERROR,
    POSES,
    ROUND_OFF,
    Check,
    in_full,
    reach,
)
from crosscheck.compare.energy import energy_balance
from crosscheck.compare.samples import States
from crosscheck.engines.engine import UNRESOLVED, Engine
from crosscheck.support.errors import CrosscheckError
from newton_euler.equations.redundancy import mobility
from newton_euler.errors import NewtonEulerError
from newton_euler.model.euler_parameters import angle_between
from newton_euler.model.scene import Scene
from newton_euler.model.trajectory import StoppedError, Trajectory, distance
from newton_euler.runs.assemble import initial_state
from newton_euler.scalars import Array

Gap = Callable[[Trajectory, Trajectory], Array]
"""Function that returns the differences of two runs: (n,) at n times, or (n, b or j) for bodies or joints."""

Runs = Mapping[str, Trajectory]
"""Runs by the name of the engine."""

MAX_REMAINING_ERROR = 1.0 - 1.0 / OWN_ERROR
"""Largest fraction of an error that may remain in a refined run. If more remains, the error exceeds
`OWN_ERROR` times the change of the run."""


def _until_shorter_ends(difference: Gap) -> Gap:
    """Decorate a `Gap` so that it compares two runs up to the end of the shorter one."""

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
    rigid = next((engine for engine in engines if engine.evaluate_soft_constraints is None), None)
    if rigid is None or not runs:
        return {}
    finest = rigid.refined(scene)
    return {name: distance(run, finest.first(len(run.time))) for name, run in runs.items()}


def displacements(runs: Mapping[str, Trajectory]) -> dict[str, float]:
    """Return the largest displacement of any body from its start, m or rad, by engine."""
    found = {}
    for name, run in runs.items():
        start = np.broadcast_to(run.quaternion[0], run.quaternion.shape)
        gaps = np.linalg.norm(run.position - run.position[0], axis=-1), angle_between(run.quaternion, start)
        found[name] = float(np.max(gaps))
    return found


def nothing_moves_in_rigid_runs(
    scene: Scene, engines: Sequence[Engine], runs: Mapping[str, Trajectory]
) -> bool:
    """Return True if nothing moves in the runs, see `nothing_moves`.

    Engines with soft constraints are ignored if there are others, since soft constraints yield a little in a
    mechanism at rest.
    """
    engines_with_run = [engine for engine in engines if engine.name in runs]
    rigid = [engine for engine in engines_with_run if engine.evaluate_soft_constraints is None]
    considered = rigid or engines_with_run
    return bool(considered) and nothing_moves({each.name: runs[each.name] for each in considered}, scene)


def nothing_moves(runs: Mapping[str, Trajectory], scene: Scene) -> bool:
    """Return True if all displacements in runs are round-off, relative to reach (at least 1 m) or 1 rad."""
    reaches = {name: max(1.0, reach(scene, run.position)) for name, run in runs.items()}
    return all(far <= ROUND_OFF * reaches[name] for name, far in displacements(runs).items())


def compare_runs(
    scene: Scene,
    engines: Sequence[Engine],
    runs: Runs,
    energy: float,
    differing: Collection[tuple[str, ...]] = (),
) -> Iterator[Check]:
    """Compare runs at the levels "trajectories", "drift" and "energy".

    Each engine has a fixed relative tolerance for its expected error. If a check exceeds that, the engine is
    run again, once, with a smaller step or tighter tolerances, and its tolerance is extended by `OWN_ERROR`
    times the change. This assumes that refining reduces the error. If the difference does not decrease in the
    refined run, and exceeds the fixed tolerances and round-off, the check is not judged.

    Tolerances of angles are relative to 1 rad. Those of lengths are relative to the mechanism's reach in the
    runs, at least 1 m, as in the error control of integrators. Those of energies are relative to the larger
    of the run's kinetic energy and `energy`.

    Args:
        scene: scene that was simulated.
        engines: engines that have a run.
        runs: runs by engine. Partial runs are compared up to their ends.
        energy: smallest unit of energy differences, J.
        differing: pairs of engines that differ at an earlier level and are not compared.
    """
    # Refined runs, computed when a check first needs them
    bodies, joints, times = scene.mechanism.body_names, scene.mechanism.joint_names, scene.times
    noise = _noise(scene)
    refined_runs: dict[str, Trajectory] = {}
    not_refinable: set[str] = set()

    def length(between: Sequence[Engine]) -> float:
        """Return the unit of lengths, m: the mechanism's reach until the shorter of some runs ends.

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

    def own_change(engine: Engine, difference: Gap) -> float:
        """Measure the largest difference between an engine's run and its refined run."""
        if engine.name not in refined_runs:
            refine(engine)
        return float(np.max(difference(runs[engine.name], refined_runs[engine.name])))

    def unconverged_engine(
        between: Sequence[Engine], gap: Callable[[Runs], Array], difference: Gap, floor: float
    ) -> str:
        """Return the engine whose refined run does not reduce the difference of a check; empty if none.

        The difference is computed with the given runs of the other engines first, which costs nothing, and
        then with their refined runs, in which their own errors are smaller. Each check is tested separately,
        since a run may converge in one quantity or towards one engine only.

        Args:
            between, gap, difference: see `row`.
            floor: difference that is small enough in any case.
        """
        refined = [engine for engine in between if engine.name in refined_runs]
        name = max(refined, key=lambda engine: own_change(engine, difference)).name

        def decreases(others: Runs) -> bool:
            before, after = (float(np.max(gap({**others, name: own[name]}))) for own in (runs, refined_runs))
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

    def row(
        level: str,
        quantity: str,
        between: Sequence[Engine],
        gap: Callable[[Runs], Array],
        difference: Gap,
        fixed: float,
        unit: float,
        shown_unit: float = 1.0,
    ) -> Check:
        """Make one check.

        Args:
            level, quantity: attributes of the check.
            between: one or two engines.
            gap: computes the compared value at all times from a set of runs.
            difference: measures the change of the value between a run of an engine and its refined run.
            fixed: fixed tolerance, relative to `unit`.
            unit: unit of the tolerance, m, rad or J.
            shown_unit: unit in which value and tolerance are shown.
        """
        gaps = gap(runs)
        value, tolerance = float(np.max(gaps)), fixed * unit
        where = worst(gaps, joints if level == "drift" else bodies)
        # Extend the tolerance by measured errors, beginning with the fastest engine
        coarse: list[str] = []
        for engine in sorted(between, key=lambda engine: runs[engine.name].wall_time):
            if value <= tolerance:
                break
            change = own_change(engine, difference)
            tolerance += min(OWN_ERROR * change, UNRESOLVED * unit)
            if OWN_ERROR * change > UNRESOLVED * unit:
                coarse.append(f"{engine.name}'s own run changes by {change / shown_unit:.2g} when refined")
        # A check that passes by the extension only is judged only if refining reduces the difference
        extended = fixed * unit < value <= tolerance
        floor = max(fixed, ROUND_OFF) * unit
        name = unconverged_engine(between, gap, difference, floor) if extended else ""
        names = tuple(engine.name for engine in between)
        return Check(
            level,
            quantity,
            names,
            value / shown_unit,
            tolerance / shown_unit,
            where,
            judged=not name,
            unconverged=name,
            detail="; ".join(coarse) if value > tolerance else "",
        )

    def worst(gaps: Array, names: Sequence[str]) -> str:
        """Return the time of the largest value, after the name of its body or joint if there is one."""
        if gaps.ndim == 1:
            return f"{times[int(np.argmax(gaps))]:.3g} s"
        n, k = divmod(int(np.argmax(gaps)), gaps.shape[1])
        return f"{names[k]} at {times[n]:.3g} s"

    # The checks of each level

    def between_two(a: Engine, b: Engine, difference: Gap) -> Callable[[Runs], Array]:
        """Return a function that computes the difference of two engines from a set of runs."""
        return lambda some_runs: difference(some_runs[a.name], some_runs[b.name])

    def trajectories(a: Engine, b: Engine) -> Iterator[Check]:
        """Compare poses of two engines; a pair that fails is added to `differing_pairs`."""
        fixed = a.trajectory_error + b.trajectory_error + noise
        for quantity, difference, unit in (
            (POSES[0], positions_apart, length((a, b))),
            (POSES[1], orientations_apart, 1.0),
        ):
            gap = between_two(a, b, difference)
            found = row("trajectories", quantity, (a, b), gap, difference, fixed, unit)
            if not found.agrees:
                differing_pairs.add((a.name, b.name))
            yield found

    def drift(engine: Engine) -> Iterator[Check]:
        """Check the constraint violation of one engine."""
        if runs[engine.name].constraint_violation is not None:
            violation, unit = partial(_violation, engine.name), length((engine,))
            fixed = engine.drift + noise
            yield row("drift", CONSTRAINT_VIOLATION, (engine,), violation, _violations_apart, fixed, unit)

    def kinetic_energy(a: Engine, b: Engine) -> Iterator[Check]:
        """Compare kinetic energies of two engines, unless their trajectories differ."""
        kinetic = runs[a.name].kinetic_energy
        if kinetic is not None and (a.name, b.name) not in differing_pairs:
            unit = max(energy, float(np.max(kinetic[: len(runs[b.name].time)])))
            fixed, gap = a.energy_error + b.energy_error + noise, between_two(a, b, _kinetic_energies_apart)
            quantity = "kinetic energy, rel"
            yield row("energy", quantity, (a, b), gap, _kinetic_energies_apart, fixed, unit, unit)

    def energy_balance_error(engine: Engine) -> Iterator[Check]:
        """Check the energy balance of one engine."""
        balance = energy_balance(scene, runs[engine.name])
        if balance is not None:
            unit, difference = max(energy, balance.exchanged), _balances_apart(scene)
            gap, fixed = partial(_residual, scene, engine.name), engine.energy_error + noise
            yield row("energy", "energy balance error, rel", (engine,), gap, difference, fixed, unit, unit)

    # All checks, of pairs that do not differ at an earlier level
    differing_pairs = set(differing)
    pairs = [(a, b) for a, b in combinations(engines, 2) if (a.name, b.name) not in differing_pairs]
    yield from in_full(
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

    Elements of a model file that are not simulated, such as contacts, would act from that time on. There are
    no checks if the time is before the second output, or after the last one.

    Args:
        until: time, s.
        scene, engines, runs, energy, differing: see `compare_runs`.
    """
    count = int(np.searchsorted(scene.times, until, side="right"))
    if count < 2 or count == len(scene.times):
        return
    shorter = {name: run.first(count) for name, run in runs.items()}
    for row in compare_runs(scene, engines, shorter, energy, differing):
        if row.level == "trajectories":
            quantity, _, unit = row.quantity.rpartition(", ")
            yield replace(row, quantity=f"{quantity} until {until:.4g} s, {unit}")


def _noise(scene: Scene) -> float:
    """Return the relative difference of runs that nearly redundant constraints may cause; 0 without them."""
    residual = mobility(scene).residual
    if residual == 0.0:
        return 0.0
    return min(NOISE * residual * States(scene, (initial_state(scene),)).condition, UNRESOLVED)


def _violation(engine: str, runs: Runs) -> Array:
    """Return constraint violations (n, j) of the joints in an engine's run, m or rad."""
    violation = runs[engine].constraint_violation
    assert violation is not None
    return violation


def _residual(scene: Scene, engine: str, runs: Runs) -> Array:
    """Return absolute energy balance errors (n,) of an engine's run, J."""
    balance = energy_balance(scene, runs[engine])
    assert balance is not None
    return np.abs(balance.residual)


def _balances_apart(scene: Scene) -> Gap:
    """Return a function that computes differences (n,) of the energy balances of two runs, J."""

    @_until_shorter_ends
    def difference(x: Trajectory, y: Trajectory) -> Array:
        first, second = energy_balance(scene, x), energy_balance(scene, y)
        assert first is not None
        assert second is not None
        return np.abs(first.residual - second.residual)

    return difference
