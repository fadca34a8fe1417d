"""Time until which two runs of a motion can be compared: chaotic and unstable motions multiply any error."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from newton_euler.errors import NewtonEulerError
from newton_euler.model.euler_parameters import angle_between, from_rotation_vector, product
from newton_euler.model.scene import Scene
from newton_euler.model.state import State
from newton_euler.model.trajectory import Trajectory
from newton_euler.runs.assemble import assemble, initial_state
from newton_euler.runs.batch import simulate_batch
from newton_euler.scalars import Array

NUDGE = 1e-6
"""Change of the start: of positions in sizes, of rotations in rad, of velocities the same per second. It is
far above round-off and far below the motion."""

NUDGES = 3
"""Number of changed starts. A single one may by chance have a small part along the fastest growth."""

MAX_ERROR_GROWTH = 1000.0
"""Factor by which the motion may multiply a change of its start. Beyond it, even step errors of 0.001 % grow
to 1 %, so that a difference of two runs shows the instability of the motion rather than a faulty run."""


def comparable_until(scene: Scene, reference: Trajectory) -> float | None:
    """Find the time, s, from which on a motion multiplies errors by more than `MAX_ERROR_GROWTH`.

    The scene is simulated again from `NUDGES` other starts, whose poses and velocities differ by `NUDGE` in
    random directions. A change of velocity v moves a free body by v t, which does not count as growth.

    Returns:
        The time; None if the motion can be compared to its end, or if the growth is unknown because no
        changed motion can be simulated.
    """
    start = initial_state(scene)
    try:
        nudged = [_nudged(scene, start, seed) for seed in range(NUDGES)]
        batch = simulate_batch(scene, nudged)
    except NewtonEulerError:
        return None
    until = [
        _first_growth(scene, reference, batch[run], nudged[run])
        for run in range(NUDGES)
        if run not in batch.errors
    ]
    return min((time for time in until if time is not None), default=None)


def _nudged(scene: Scene, start: State, seed: int) -> State:
    """Change a state by `NUDGE` in a random direction, and make it satisfy the constraints again.

    Raises:
        NewtonEulerError: if the constraints cannot be satisfied.
    """
    size = scene.mechanism.size
    # (4, b, 3) changes of the positions, rotations, velocities and angular velocities
    change = NUDGE * np.random.default_rng(seed).standard_normal((4, *start.position.shape))
    change[:, 0] = 0.0  # the ground stays
    turned = [product(from_rotation_vector(v), p) for v, p in zip(change[1], start.quaternion, strict=True)]
    return assemble(
        scene,
        replace(
            start,
            position=start.position + size * change[0],
            quaternion=np.array(turned),
            linear_velocity=start.linear_velocity + size * change[2],
            angular_velocity=start.angular_velocity + change[3],
        ),
    )


def _first_growth(scene: Scene, reference: Trajectory, other: Trajectory, nudged: State) -> float | None:
    """Return the first time, s, at which two runs are `MAX_ERROR_GROWTH` times farther apart than two free
    bodies would be; None if there is none.

    Args:
        scene: scene of both runs.
        reference: run from the start of the scene.
        other: run from another start.
        nudged: the other start.
    """
    size = scene.mechanism.size
    start = initial_state(scene)
    # (n,) distance of the two runs, in sizes or rad
    positions = np.linalg.norm(other.position - reference.position, axis=2) / size
    apart = np.max(np.maximum(positions, angle_between(other.quaternion, reference.quaternion)), axis=1)
    speed = max(
        float(np.max(np.abs(nudged.linear_velocity - start.linear_velocity))) / size,
        float(np.max(np.abs(nudged.angular_velocity - start.angular_velocity))),
    )
    free: Array = apart[0] + speed * reference.time
    grown = np.flatnonzero(apart > MAX_ERROR_GROWTH * free)
    return float(reference.time[grown[0]]) if len(grown) else None
