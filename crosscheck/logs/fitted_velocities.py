"""Fit the velocities at the start of a log that has none.

A run of newton_euler with the fitted velocities passes through the first rows of the log.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from crosscheck.engines.adaptive import newton_euler_options
from crosscheck.own_run.interpolation import interpolated
from newton_euler.equations.relative import Relative
from newton_euler.errors import NewtonEulerError
from newton_euler.model.euler_parameters import conjugate, product
from newton_euler.model.scene import Scene
from newton_euler.model.state import State
from newton_euler.runs.batch import simulate_batch
from newton_euler.scalars import Array

GAUSS_NEWTON_STEPS = 2
"""Number of steps of the fit. The motion of a few rows is nearly linear in the velocities of the start."""

PERIODS_PER_ROW = 10
"""Number of output periods of a run between two rows; poses are interpolated between outputs."""

CHANGE = 1e-5
"""Change of poses for derivatives with respect to velocities, rad or a fraction of the mechanism's size."""

RANK_TOLERANCE = 1e-6
"""Ratio of a singular value to the largest one, or to 1 for small constraint Jacobians, below which the value
counts as zero."""


def free_motions(system: Relative, q: Array) -> Array:
    """Return the velocities that constraints leave free at coordinates q, as columns (nv, f)."""
    units = system.velocity_units  # the mechanism's size, m, for linear velocities, else 1
    _, values, basis = np.linalg.svd(system.phi_jacobian(q) * units, full_matrices=True)
    rank = int(np.sum(values > RANK_TOLERANCE * max(1.0, float(np.max(values, initial=0.0)))))
    return np.asarray(basis[rank:].T * units[:, None])


def fitted_velocities(
    scene: Scene, state: State, times: Array, position: Array, quaternion: Array, bodies: list[int]
) -> State:
    """Change the velocities of a state so that a run from the state fits logged poses in the least squares.

    Args:
        scene: the scene.
        state: consistent state at time 0 with estimated velocities.
        times: (n,) times of the first rows, s, from 0 on.
        position, quaternion: (n, k, 3), m, and (n, k, 4), (w, x, y, z), poses of k bodies at these times.
        bodies: indices of the k bodies.

    Returns:
        The state with fitted velocities; the given state if there is no run from it.
    """
    size = scene.mechanism.size
    system = Relative(scene)
    q, v = system.coordinates(state)
    # velocities of the start that the constraints leave free
    free = free_motions(system, q)
    if not free.shape[1]:
        return state
    periods = PERIODS_PER_ROW * (len(times) - 1)
    short = replace(
        scene,
        initial_state=state,
        duration=float(times[-1]),
        output_period=float(times[-1]) / periods,
        outputs=frozenset({"velocities"}),  # for the interpolation of poses
    )
    change = CHANGE / float(times[-1])

    def residuals(rates: list[Array]) -> list[Array]:
        """Return differences of poses between the log and runs with these initial velocities (nv,).

        Distances are divided by the mechanism's size; rotations are in rad.
        """
        batch = simulate_batch(
            short, [system.state(q, each) for each in rates], **newton_euler_options(short)
        )
        if batch.errors:
            raise next(iter(batch.errors.values()))
        found = []
        for k in range(len(batch)):
            run = interpolated(batch[k], times)
            gap = (run.position[:, bodies] - position) / size
            turn = np.moveaxis(
                product(
                    np.moveaxis(run.quaternion[:, bodies], -1, 0), np.moveaxis(conjugate(quaternion), -1, 0)
                ),
                0,
                -1,
            )
            turn = 2.0 * turn[..., 1:] * np.where(turn[..., :1] < 0.0, -1.0, 1.0)
            found.append(np.concatenate([gap.ravel(), turn.ravel()]))
        return found

    try:
        for _ in range(GAUSS_NEWTON_STEPS):
            now, *changed = residuals([v, *(v + change * column for column in free.T)])
            slopes = np.stack([(each - now) / change for each in changed], axis=1)
            steps, *_ = np.linalg.lstsq(slopes, -now, rcond=RANK_TOLERANCE)
            v = v + free @ steps
        return system.state(q, v)
    except NewtonEulerError:
        return state
