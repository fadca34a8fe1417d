"""Levels 5 to 7: trajectories of each pair of engines, drift and energy balance of each engine.

What an engine's run may be off is measured by refining its step or tolerance.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from itertools import combinations

import numpy as np

from crosscheck.comparison.energy import energy_balance
from crosscheck.comparison.rows import OWN_ERROR, ROUND_OFF, UNRESOLVED, Row, reach
from crosscheck.engines import Engine
from newton_euler.euler_parameters import angle_between
from newton_euler.scalars import Array
from newton_euler.scene import Scene
from newton_euler.trajectory import Trajectory

Gap = Callable[[Trajectory, Trajectory], Array]
"""How far two runs are apart, (n,) at all times or (n, bodies or joints)."""


def _positions_apart(x: Trajectory, y: Trajectory) -> Array:
    return np.asarray(np.linalg.norm(x.position - y.position, axis=2))


def _orientations_apart(x: Trajectory, y: Trajectory) -> Array:
    return angle_between(x.quaternion, y.quaternion)


def _violations_apart(x: Trajectory, y: Trajectory) -> Array:
    assert x.constraint_violation is not None
    assert y.constraint_violation is not None
    return np.abs(x.constraint_violation - y.constraint_violation)


def _kinetic_energies_apart(x: Trajectory, y: Trajectory) -> Array:
    assert x.kinetic_energy is not None
    assert y.kinetic_energy is not None
    return np.abs(x.kinetic_energy - y.kinetic_energy)


def displacements(runs: Mapping[str, Trajectory]) -> dict[str, float]:
    """By engine how far any body gets from where its run starts, m and rad."""
    found = {}
    for name, run in runs.items():
        start = np.broadcast_to(run.quaternion[0], run.quaternion.shape)
        gaps = np.linalg.norm(run.position - run.position[0], axis=-1), angle_between(run.quaternion, start)
        found[name] = float(np.max(gaps))
    return found


def rests(scene: Scene, engines: Sequence[Engine], runs: Mapping[str, Trajectory]) -> bool:
    """Whether in no run of a rigid engine anything moves but by round-off of the reach, or of 1 m and 1 rad.

    Soft constraints give way a little even so: engines that have them are asked if there are no others.
    """
    asked = [engine for engine in engines if engine.soft_start is None] or engines
    moved = displacements(runs)
    reaches = {engine.name: max(1.0, reach(scene, runs[engine.name].position)) for engine in asked}
    return all(moved[name] <= ROUND_OFF * length for name, length in reaches.items())


def compare_runs(
    scene: Scene,
    engines: Sequence[Engine],
    runs: dict[str, Trajectory],
    energy: float,
    parted: Collection[tuple[str, ...]] = (),
) -> Iterator[Row]:
    """Levels 5 to 7, those of pairs that part at an earlier level or have `parted` left out.

    An engine may be off by its fixed share. Where a figure exceeds that, the engine is run again, once,
    more finely, and may be off by what that shows as well: how far errors grow depends on the
    mechanism. Shares are of 1 rad for angles. For lengths they are of the mechanism's reach in the
    runs, but of 1 m at least: error control is relative to large coordinates and absolute for small
    ones. Energies are relative to the larger of the run's own and `energy`, J.
    """
    bodies, joints, times = scene.mechanism.body_names, scene.mechanism.joint_names, scene.times
    length = max(1.0, *(reach(scene, run.position) for run in runs.values()))
    finer: dict[str, Trajectory] = {}

    def allowed(value: float, fixed: float, between: Sequence[Engine], apart: Gap, unit: float) -> float:
        """`fixed` shares of a unit, and own errors while the value exceeds that, quickest engine first."""
        for engine in sorted(between, key=lambda engine: runs[engine.name].wall_time):
            if value <= fixed:
                break
            if engine.name not in finer:
                finer[engine.name] = engine.refined(scene)
            own = float(np.max(apart(runs[engine.name], finer[engine.name]))) / unit
            fixed += min(OWN_ERROR * own, UNRESOLVED)
        return fixed

    def worst(gap: Array, names: Sequence[str]) -> str:
        n, k = divmod(int(np.argmax(gap)), gap.shape[1])
        return f"{names[k]} at {times[n]:.3g} s"

    together = [(a, b) for a, b in combinations(engines, 2) if (a.name, b.name) not in parted]
    still = []
    for a, b in together:
        agree = True
        for quantity, apart, unit in (
            ("positions, m", _positions_apart, length),
            ("orientations, rad", _orientations_apart, 1.0),
        ):
            gap = apart(runs[a.name], runs[b.name])
            fixed = a.trajectory_error + b.trajectory_error
            tolerance = unit * allowed(float(gap.max()) / unit, fixed, (a, b), apart, unit)
            where = worst(gap, bodies)
            row = Row("trajectories", quantity, (a.name, b.name), float(gap.max()), tolerance, where)
            agree = agree and row.agrees
            yield row
        if agree:
            still.append((a, b))
    for engine in engines:
        violation = runs[engine.name].constraint_violation
        if violation is not None:
            value, where = float(violation.max()), worst(violation, joints)
            tolerance = length * allowed(value / length, engine.drift, (engine,), _violations_apart, length)
            yield Row("drift", "open joints, m or rad", (engine.name,), value, tolerance, where)
    for a, b in still:
        kinetic = runs[a.name].kinetic_energy
        if kinetic is not None:
            unit = max(energy, float(np.max(kinetic)))
            gap = _kinetic_energies_apart(runs[a.name], runs[b.name]) / unit
            value, where = float(gap.max()), f"{times[int(np.argmax(gap))]:.3g} s"
            fixed = a.energy_error + b.energy_error
            tolerance = allowed(value, fixed, (a, b), _kinetic_energies_apart, unit)
            yield Row("energy", "kinetic energy, rel", (a.name, b.name), value, tolerance, where)
    for engine in engines:
        balance = energy_balance(scene, runs[engine.name])
        if balance is not None:
            unit = max(energy, balance.exchanged)
            gap = np.abs(balance.residual) / unit
            value, where = float(gap.max()), f"{times[int(np.argmax(gap))]:.3g} s"
            tolerance = allowed(value, engine.energy_error, (engine,), _residuals_apart(scene), unit)
            yield Row("energy", "energy less work, rel", (engine.name,), value, tolerance, where)


def _residuals_apart(scene: Scene) -> Gap:
    def apart(x: Trajectory, y: Trajectory) -> Array:
        first, second = energy_balance(scene, x), energy_balance(scene, y)
        assert first is not None
        assert second is not None
        return np.abs(first.residual - second.residual)

    return apart
