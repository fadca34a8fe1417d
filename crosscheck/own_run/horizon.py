"""Times until which two runs of a motion can be compared: chaotic and unstable motions multiply any error.

Each mechanism, whose bodies are connected by joints without the ground, has its own time: a chaotic mechanism
beside others ends the comparison of its own bodies only.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from crosscheck.own_run.errors import MechanismMotion, MotionScale
from newton_euler.errors import NewtonEulerError
from newton_euler.model.euler_parameters import angle_between, from_rotation_vector, product
from newton_euler.model.scene import Scene
from newton_euler.model.state import State
from newton_euler.model.trajectory import Trajectory
from newton_euler.runs.assemble import assemble, initial_state
from newton_euler.runs.batch import simulate_batch
from newton_euler.scalars import Array

NUDGE = 1e-6
"""Change of the start: of positions in sizes of the mechanism, of rotations in rad, of velocities the same
per second. It is far above round-off and far below the motion."""

NUDGES = 3
"""Number of changed starts. A single one may by chance have a small part along the fastest growth."""

MAX_ERROR_GROWTH = 1000.0
"""Factor by which the motion may multiply a change of its start. Beyond it, even step errors of 0.001 % grow
to 1 %, so that a difference of two runs shows the instability of the motion rather than a faulty run."""


def comparable_until(scene: Scene, reference: Trajectory) -> tuple[float | None, ...]:
    """Find the times, s, from which on mechanisms multiply errors by more than `MAX_ERROR_GROWTH`.

    The scene is simulated again from `NUDGES` other starts, whose poses and velocities differ by `NUDGE` in
    random directions. A change of velocity v moves a free body by v t, which does not count as growth.

    Returns:
        The time of each of `Mechanism.connected_bodies`; None if the mechanism can be compared to the end, or
        if the growth is unknown because no changed motion can be simulated.
    """
    start = initial_state(scene)
    mechanisms = MotionScale.of(reference, scene.mechanism).mechanisms
    try:
        nudged = [_nudged(scene, start, mechanisms, seed) for seed in range(NUDGES)]
        batch = simulate_batch(scene, nudged)
    except NewtonEulerError:
        return (None,) * len(mechanisms)
    simulated = [(batch[run], nudged[run]) for run in range(NUDGES) if run not in batch.errors]
    until = []
    for bodies, mechanism in zip(scene.mechanism.connected_bodies, mechanisms, strict=True):
        group = list(bodies)
        found = [
            _first_growth(
                reference, other, group, mechanism.size, _speed(start, changed, group, mechanism.size)
            )
            for other, changed in simulated
        ]
        until.append(min((time for time in found if time is not None), default=None))
    return tuple(until)


def _nudged(scene: Scene, start: State, mechanisms: Sequence[MechanismMotion], seed: int) -> State:
    """Change a state by `NUDGE` in a random direction, and make it satisfy the constraints again.

    Raises:
        NewtonEulerError: if the constraints cannot be satisfied.
    """
    sizes = np.zeros((len(start.position), 1))  # of the mechanism of each body, m
    for bodies, mechanism in zip(scene.mechanism.connected_bodies, mechanisms, strict=True):
        sizes[list(bodies)] = mechanism.size
    # (4, b, 3) changes of the positions, rotations, velocities and angular velocities
    change = NUDGE * np.random.default_rng(seed).standard_normal((4, *start.position.shape))
    change[:, 0] = 0.0  # the ground stays
    turned = [product(from_rotation_vector(v), p) for v, p in zip(change[1], start.quaternion, strict=True)]
    return assemble(
        scene,
        replace(
            start,
            position=start.position + sizes * change[0],
            quaternion=np.array(turned),
            linear_velocity=start.linear_velocity + sizes * change[2],
            angular_velocity=start.angular_velocity + change[3],
        ),
    )


def _speed(start: State, nudged: State, bodies: list[int], size: float) -> float:
    """Return the largest change of a velocity of some bodies, in sizes, m, or rad per second."""
    linear = np.abs(nudged.linear_velocity - start.linear_velocity)[bodies]
    angular = np.abs(nudged.angular_velocity - start.angular_velocity)[bodies]
    return max(float(np.max(linear)) / size, float(np.max(angular)))


def _first_growth(
    reference: Trajectory, other: Trajectory, bodies: list[int], size: float, speed: float
) -> float | None:
    """Return the first time, s, at which some bodies are `MAX_ERROR_GROWTH` times farther apart in two runs
    than free bodies would be; None if there is none.

    Args:
        reference: run from the start of the scene.
        other: run from another start.
        bodies: indices of the bodies of one mechanism.
        size: size of the mechanism, m.
        speed: difference of the velocities at both starts, sizes or rad per second.
    """
    # (n,) distance of the two runs, in sizes or rad
    positions = np.linalg.norm(other.position[:, bodies] - reference.position[:, bodies], axis=2) / size
    angles = angle_between(other.quaternion[:, bodies], reference.quaternion[:, bodies])
    apart = np.max(np.maximum(positions, angles), axis=1)
    free: Array = apart[0] + speed * reference.time
    grown = np.flatnonzero(apart > MAX_ERROR_GROWTH * free)
    return float(reference.time[grown[0]]) if len(grown) else None
