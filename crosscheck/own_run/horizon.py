"""Time until which two runs of a motion can be compared: chaotic and unstable motions multiply any error."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from newton_euler.errors import NewtonEulerError
from newton_euler.model.euler_parameters import angle_between
from newton_euler.model.scene import Scene
from newton_euler.model.state import State
from newton_euler.model.trajectory import Trajectory
from newton_euler.runs.assemble import assemble, initial_state
from newton_euler.runs.simulate import simulate

NUDGE = 1e-6
"""Change of the start velocities, sizes/s and rad/s: far above round-off, far below the motion."""

MAX_ERROR_GROWTH = 1000.0
"""Factor by which the motion may multiply a change of its start. Beyond it, even step errors of 0.001 % grow
to 1 %, so that a difference of two runs shows the instability of the motion rather than a faulty run."""


def comparable_until(scene: Scene, reference: Trajectory) -> float | None:
    """Find the time, s, from which on a motion multiplies errors by more than `MAX_ERROR_GROWTH`.

    The scene is simulated a second time with start velocities that differ by `NUDGE` in a random direction. A
    change of velocity v moves a free body by v t, which does not count as growth.

    Returns:
        The time; None if the motion can be compared to its end, or if the growth is unknown because the
        changed motion cannot be simulated.
    """
    size = scene.mechanism.size
    start = initial_state(scene)
    draw = np.random.default_rng(0).standard_normal
    linear = start.linear_velocity + NUDGE * size * draw(start.linear_velocity.shape)
    angular = start.angular_velocity + NUDGE * draw(start.angular_velocity.shape)
    linear[0], angular[0] = 0.0, 0.0
    try:
        nudged: State = assemble(scene, replace(start, linear_velocity=linear, angular_velocity=angular))
        other = simulate(replace(scene, initial_state=nudged))
    except NewtonEulerError:
        return None
    apart = np.maximum(
        np.max(np.linalg.norm(other.position - reference.position, axis=2), axis=1) / size,
        np.max(angle_between(other.quaternion, reference.quaternion), axis=1),
    )
    # change of the velocities that is left after `assemble` made them satisfy the constraints
    change = max(
        float(np.max(np.abs(nudged.linear_velocity - start.linear_velocity))) / size,
        float(np.max(np.abs(nudged.angular_velocity - start.angular_velocity))),
    )
    if not change:
        return None
    # the time since the start is at least about one output period, so that it is not 0 at the start
    growth = apart / (change * np.maximum(reference.time, reference.time[-1] / len(reference.time)))
    grown = np.flatnonzero(growth > MAX_ERROR_GROWTH)
    return float(reference.time[grown[0]]) if len(grown) else None
