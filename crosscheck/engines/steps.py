"""Choice of the fixed step of an engine's default run: halves of a step, until the run is accurate enough."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from crosscheck.engines.energy import energy_balance, energy_change, min_energy_scale
from crosscheck.engines.engine import MAX_RELATIVE_ERROR
from crosscheck.support.errors import CrosscheckError
from newton_euler.errors import NewtonEulerError
from newton_euler.model.scene import Scene
from newton_euler.model.trajectory import Trajectory, distance
from newton_euler.runs.assemble import initial_state

MIN_WORK = 1e-5
"""Smallest work, relative to the energy of a run, that is to be accurate. For less work, a run with a fixed
step would need too many steps."""


def halve_until_accurate(
    scene: Scene,
    run: Trajectory,
    expected: Trajectory | None,
    step: float,
    max_steps: int,
    simulate: Callable[[float], Trajectory],
) -> Trajectory:
    """Halve the step of a run while the run is far from the expected run and halving changes the run.

    Args:
        scene: the scene.
        run: the engine's run.
        expected: newton_euler's run. If there is none, or a partial one, `run` is returned unchanged.
        step: step of the run, s.
        max_steps: largest number of steps of a run.
        simulate: simulates the scene at a step, s.
    """
    if expected is None or len(expected.time) != len(run.time):
        return run
    while _relative_deviation(scene, run, expected) > MAX_RELATIVE_ERROR:
        step *= 0.5
        if scene.duration > step * max_steps:
            break
        try:
            finer = simulate(step)
        except (NewtonEulerError, CrosscheckError):  # the coarser run is complete, and is kept
            break
        change, run = _relative_deviation(scene, run, finer), finer
        if change < MAX_RELATIVE_ERROR:
            break
    return run


def _relative_deviation(scene: Scene, run: Trajectory, other: Trajectory) -> float:
    """Return the largest difference of two runs in poses, kinetic energy, and balance and change of energy.

    Distances are relative to the mechanism's size, angles to 1 rad, and energies to the energy of the run
    `other` or of the mechanism, whichever is larger. The change of the energy is relative to the work that
    causes it, such as the loss in a damper. Energies count only if both runs have them.
    """
    deviations = [distance(run, other, length=scene.mechanism.size)]
    balance, other_balance = energy_balance(scene, run), energy_balance(scene, other)
    if balance is not None and other_balance is not None:
        assert run.kinetic_energy is not None
        assert other.kinetic_energy is not None
        unit = max(min_energy_scale(scene, [initial_state(scene)]), other_balance.scale)
        deviations.append(float(np.max(np.abs(balance.residual - other_balance.residual))) / unit)
        deviations.append(float(np.max(np.abs(run.kinetic_energy - other.kinetic_energy))) / unit)
        work = 0.0 if other.work is None else float(np.max(np.abs(other.work)))
        if work > MIN_WORK * unit:
            changes = energy_change(run), energy_change(other)
            deviations.append(float(np.max(np.abs(np.subtract(*changes)))) / work)
    return max(deviations)
