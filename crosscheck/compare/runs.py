"""Levels of runs: trajectories of each pair of engines, drift and energy balance of each engine.

What an engine's run may be off is measured by refining its step or tolerance.
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
    UNRESOLVED,
    Check,
    in_full,
    reach,
)
from crosscheck.compare.energy import energy_balance
from crosscheck.compare.samples import States
from crosscheck.engines.engine import Engine
from crosscheck.support.errors import CrosscheckError
from newton_euler.equations.redundancy import mobility
from newton_euler.errors import NewtonEulerError
from newton_euler.model.euler_parameters import angle_between
from newton_euler.model.scene import Scene
from newton_euler.model.trajectory import StoppedError, Trajectory, distance
from newton_euler.runs.assemble import initial_state
from newton_euler.scalars import Array

Gap = Callable[[Trajectory, Trajectory], Array]
"""Distance between two runs, (n,) at all times or (n, bodies or joints)."""

Runs = Mapping[str, Trajectory]
"""Runs by engine."""

MAX_REMAINING_ERROR = 1.0 - 1.0 / OWN_ERROR
"""Largest fraction of an error that may remain in a refined run. If more remains, the error exceeds
`OWN_ERROR` times the change of the run."""


def _together(apart: Gap) -> Gap:
    """A gap of two runs until the shorter one ends."""

    @wraps(apart)
    def gap(x: Trajectory, y: Trajectory) -> Array:
        end = min(len(x.time), len(y.time))
        return apart(x.first(end), y.first(end))

    return gap


@_together
def positions_apart(x: Trajectory, y: Trajectory) -> Array:
    return np.asarray(np.linalg.norm(x.position - y.position, axis=2))


@_together
def orientations_apart(x: Trajectory, y: Trajectory) -> Array:
    return angle_between(x.quaternion, y.quaternion)


@_together
def _violations_apart(x: Trajectory, y: Trajectory) -> Array:
    assert x.constraint_violation is not None
    assert y.constraint_violation is not None
    return np.abs(x.constraint_violation - y.constraint_violation)


@_together
def _kinetic_energies_apart(x: Trajectory, y: Trajectory) -> Array:
    assert x.kinetic_energy is not None
    assert y.kinetic_energy is not None
    return np.abs(x.kinetic_energy - y.kinetic_energy)


def measure_run_errors(scene: Scene, engines: Sequence[Engine], runs: Runs) -> dict[str, float]:
    """Compute by engine how far its run, as far as it came, is from the finest: m and rad, the larger.

    The finest is the refined run of the first engine with rigid constraints; without one there are none.

    Args:
        engines: those whose run may be taken for right.

    Raises:
        NewtonEulerError, CrosscheckError: where that run does not come to its end.
    """
    rigid = next((engine for engine in engines if engine.evaluate_soft_constraints is None), None)
    if rigid is None or not runs:
        return {}
    finest = rigid.refined(scene)
    return {name: distance(run, finest.first(len(run.time))) for name, run in runs.items()}


def displacements(runs: Mapping[str, Trajectory]) -> dict[str, float]:
    """Return the largest displacement of a body from its start by engine, m and rad."""
    found = {}
    for name, run in runs.items():
        start = np.broadcast_to(run.quaternion[0], run.quaternion.shape)
        gaps = np.linalg.norm(run.position - run.position[0], axis=-1), angle_between(run.quaternion, start)
        found[name] = float(np.max(gaps))
    return found


def nothing_moves_in_rigid_runs(
    scene: Scene, engines: Sequence[Engine], runs: Mapping[str, Trajectory]
) -> bool:
    """True if in no run of a rigid engine anything moves but by round-off of the reach, or of 1 m and 1 rad.

    Soft constraints give way a little even so: engines that have them are asked if there are no others.
    """
    ran = [engine for engine in engines if engine.name in runs]
    asked = [engine for engine in ran if engine.evaluate_soft_constraints is None] or ran
    return bool(asked) and nothing_moves({engine.name: runs[engine.name] for engine in asked}, scene)


def nothing_moves(runs: Mapping[str, Trajectory], scene: Scene) -> bool:
    """Return True if nothing moves in runs but by round-off of the reach, or of 1 m and 1 rad."""
    reaches = {name: max(1.0, reach(scene, run.position)) for name, run in runs.items()}
    return all(far <= ROUND_OFF * reaches[name] for name, far in displacements(runs).items())


def compare_runs(
    scene: Scene,
    engines: Sequence[Engine],
    runs: Runs,
    energy: float,
    parted: Collection[tuple[str, ...]] = (),
) -> Iterator[Check]:
    """Levels of runs, those of pairs that part at an earlier level or have `parted` left out.

    Runs that stopped are compared as far as they came, with finer ones as far as those come.

    An engine may be off by its fixed share. Where a check exceeds that, the engine is run again, once,
    more finely, and may be off by what that shows as well: how far errors grow depends on the
    mechanism. Shares are of 1 rad for angles. For lengths they are of the mechanism's reach in the
    runs, but of 1 m at least: error control is relative to large coordinates and absolute for small
    ones. Energies are relative to the larger of the run's own and `energy`, J.

    What that shows holds of a run whose error falls then. Where it does not, and is not down to what engines
    may be off anyway or to round-off, the check is not judged.
    """
    # Refined runs are made when a check first needs them, and kept for the others
    bodies, joints, times = scene.mechanism.body_names, scene.mechanism.joint_names, scene.times
    noise = _noise(scene)
    finer: dict[str, Trajectory] = {}
    unable: set[str] = set()

    def length(between: Sequence[Engine]) -> float:
        """The reach of the mechanism, m, until the shorter of some runs ends.

        Of the run in which it is smallest: what flies off would excuse itself and all others.
        """
        end = min(len(runs[engine.name].time) for engine in between)
        reaches = [reach(scene, run.first(end).position) for run in runs.values() if len(run.time) >= end]
        return max(1.0, min(reaches))

    def refine(engine: Engine) -> None:
        try:
            finer[engine.name] = engine.refined(scene)
        except StoppedError as error:
            if error.partial is None or len(runs[engine.name].time) == len(times):
                raise
            finer[engine.name] = error.partial

    def own_change(engine: Engine, apart: Gap) -> float:
        """Measure an engine's run against its finer one."""
        if engine.name not in finer:
            refine(engine)
        return float(np.max(apart(runs[engine.name], finer[engine.name])))

    def unconverged_engine(
        between: Sequence[Engine], gap: Callable[[Runs], Array], apart: Gap, least: float
    ) -> str:
        """The engine whose finer run excuses a check without being nearer to the others'; empty if none.

        Nearer to their runs as they are, which costs nothing, or to their finer ones, in which their own
        errors hide nothing; or at `least`. Each figure is asked by itself: an engine may be no nearer to one
        and nearer to another, or in one quantity only.
        """
        used = [engine for engine in between if engine.name in finer]
        name = max(used, key=lambda engine: own_change(engine, apart)).name

        def falls(others: Runs) -> bool:
            before, after = (float(np.max(gap({**others, name: of[name]}))) for of in (runs, finer))
            return after <= max(MAX_REMAINING_ERROR * before, least)

        if falls(runs):
            return ""
        for engine in between:
            if engine.name not in finer and engine.name not in unable:
                try:
                    refine(engine)
                except (NewtonEulerError, CrosscheckError):
                    unable.add(engine.name)
        return "" if falls({**runs, **finer}) else name

    # One check: the largest gap, with the tolerance extended by measured errors while the gap exceeds it

    def row(
        level: str,
        quantity: str,
        between: Sequence[Engine],
        gap: Callable[[Runs], Array],
        apart: Gap,
        fixed: float,
        unit: float,
        shown: float = 1.0,
    ) -> Check:
        """The largest of a gap and what it may be: `fixed` shares of the unit, and own errors while it
        exceeds that, quickest engine first; shown in multiples of `shown`."""
        gaps = gap(runs)
        value, tolerance = float(np.max(gaps)), fixed * unit
        where = worst(gaps, joints if level == "drift" else bodies)
        coarse: list[str] = []
        for engine in sorted(between, key=lambda engine: runs[engine.name].wall_time):
            if value <= tolerance:
                break
            change = own_change(engine, apart)
            tolerance += min(OWN_ERROR * change, UNRESOLVED * unit)
            if OWN_ERROR * change > UNRESOLVED * unit:
                coarse.append(f"{engine.name}'s own run changes by {change / shown:.2g} when refined")
        excused = fixed * unit < value <= tolerance
        name = unconverged_engine(between, gap, apart, max(fixed, ROUND_OFF) * unit) if excused else ""
        names = tuple(engine.name for engine in between)
        return Check(
            level,
            quantity,
            names,
            value / shown,
            tolerance / shown,
            where,
            judged=not name,
            unconverged=name,
            detail="; ".join(coarse) if value > tolerance else "",
        )

    def worst(gaps: Array, names: Sequence[str]) -> str:
        if gaps.ndim == 1:
            return f"{times[int(np.argmax(gaps))]:.3g} s"
        n, k = divmod(int(np.argmax(gaps)), gaps.shape[1])
        return f"{names[k]} at {times[n]:.3g} s"

    # The checks of each level

    def between_two(a: Engine, b: Engine, apart: Gap) -> Callable[[Runs], Array]:
        return lambda of: apart(of[a.name], of[b.name])

    def trajectories(a: Engine, b: Engine) -> Iterator[Check]:
        fixed = a.trajectory_error + b.trajectory_error + noise
        for quantity, apart, unit in (
            (POSES[0], positions_apart, length((a, b))),
            (POSES[1], orientations_apart, 1.0),
        ):
            found = row("trajectories", quantity, (a, b), between_two(a, b, apart), apart, fixed, unit)
            if not found.agrees:
                away.add((a.name, b.name))
            yield found

    def drift(engine: Engine) -> Iterator[Check]:
        if runs[engine.name].constraint_violation is not None:
            violation, unit = partial(_violation, engine.name), length((engine,))
            fixed = engine.drift + noise
            yield row("drift", CONSTRAINT_VIOLATION, (engine,), violation, _violations_apart, fixed, unit)

    def kinetic_energy(a: Engine, b: Engine) -> Iterator[Check]:
        kinetic = runs[a.name].kinetic_energy
        if kinetic is not None and (a.name, b.name) not in away:
            unit = max(energy, float(np.max(kinetic[: len(runs[b.name].time)])))
            fixed, gap = a.energy_error + b.energy_error + noise, between_two(a, b, _kinetic_energies_apart)
            quantity = "kinetic energy, rel"
            yield row("energy", quantity, (a, b), gap, _kinetic_energies_apart, fixed, unit, unit)

    def energy_less_work(engine: Engine) -> Iterator[Check]:
        balance = energy_balance(scene, runs[engine.name])
        if balance is not None:
            unit, apart = max(energy, balance.exchanged), _residuals_apart(scene)
            gap, fixed = partial(_residual, scene, engine.name), engine.energy_error + noise
            yield row("energy", "energy balance error, rel", (engine,), gap, apart, fixed, unit, unit)

    # All checks, of pairs that have not differed before
    away = set(parted)
    together = [(a, b) for a, b in combinations(engines, 2) if (a.name, b.name) not in away]
    yield from in_full(
        [
            *(trajectories(a, b) for a, b in together),
            *(drift(engine) for engine in engines),
            *(kinetic_energy(a, b) for a, b in together),
            *(energy_less_work(engine) for engine in engines),
        ]
    )


def compare_runs_until(
    until: float,
    scene: Scene,
    engines: Sequence[Engine],
    runs: Runs,
    energy: float,
    parted: Collection[tuple[str, ...]] = (),
) -> Iterator[Check]:
    """Compare trajectories up to a time, s, as `compare_runs` does over whole runs.

    Errors of whole runs excuse nothing there. There are no figures if only the start is before that time.
    """
    count = int(np.searchsorted(scene.times, until, side="right"))
    if count < 2 or count == len(scene.times):
        return
    shorter = {name: run.first(count) for name, run in runs.items()}
    for row in compare_runs(scene, engines, shorter, energy, parted):
        if row.level == "trajectories":
            quantity, _, unit = row.quantity.rpartition(", ")
            yield replace(row, quantity=f"{quantity} until {until:.4g} s, {unit}")


def _noise(scene: Scene) -> float:
    """Share by which nearly redundant constraints may put runs apart, as they may equations of motion."""
    residual = mobility(scene).residual
    if residual == 0.0:
        return 0.0
    return min(NOISE * residual * States(scene, (initial_state(scene),)).condition, UNRESOLVED)


def _violation(engine: str, runs: Runs) -> Array:
    violation = runs[engine].constraint_violation
    assert violation is not None
    return violation


def _residual(scene: Scene, engine: str, runs: Runs) -> Array:
    balance = energy_balance(scene, runs[engine])
    assert balance is not None
    return np.abs(balance.residual)


def _residuals_apart(scene: Scene) -> Gap:
    @_together
    def apart(x: Trajectory, y: Trajectory) -> Array:
        first, second = energy_balance(scene, x), energy_balance(scene, y)
        assert first is not None
        assert second is not None
        return np.abs(first.residual - second.residual)

    return apart
