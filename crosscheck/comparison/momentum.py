"""Level 7, momentum: whether accelerations and reactions satisfy Newton's and Euler's equations of each body.

Masses, inertias and what acts on the bodies are the scene's, everything else is an engine's own answer, so
that neither another engine nor its own equations of motion are asked.
"""

from __future__ import annotations

import numpy as np

from crosscheck.comparison.figure import Figure, round_off
from crosscheck.comparison.samples import Samples, Scales
from newton_euler.equations.cartesian import Cartesian
from newton_euler.equations.sparse import to_array
from newton_euler.equations.system import Evaluation
from newton_euler.model.mechanism import Mechanism
from newton_euler.scalars import Array, cross


def momentum_row(name: str, samples: Samples) -> Figure:
    """The largest rate of momentum that no force accounts for, at any state; where is the body.

    Relative to the largest force, and as exact as reactions are.
    """
    gap = np.abs(momentum_residuals(samples)).max(axis=(0, 2))
    worst = int(np.argmax(gap))
    value = float(gap[worst]) / Scales(samples).force
    states = samples.states
    tolerance = round_off(samples.condition**2 * states.mass_condition, states.noise)
    body = samples.states.scene.mechanism.body_names[1 + worst]
    return Figure("energy", "momentum balance, rel", (name,), value, tolerance, body)


def momentum_residuals(samples: Samples) -> Array:
    """(n, b - 1, 6) of the bodies that move: N, world frame, and N m over the size, body frame."""
    equations = Cartesian(samples.states.scene)
    return np.array([_residual(equations, evaluation) for evaluation in samples.evaluations])


def _residual(equations: Cartesian, found: Evaluation) -> Array:
    """(b - 1, 6): m a - f of each body that moves, and J' domega' + omega' x J' omega' - n' over the size."""
    state, mechanism = found.state, equations.mechanism
    q, v = equations.coordinates(state)
    frames = state.frames()
    spins = [frame.rotation.T @ frame.angular_velocity for frame in frames]
    rates = [
        frame.rotation.T @ alpha for frame, alpha in zip(frames, found.angular_acceleration, strict=True)
    ]
    needed = np.array(
        [
            [*(body.mass * a), *(body.inertia @ rate + cross(spin, body.inertia @ spin))]
            for body, a, rate, spin in zip(
                mechanism.bodies, found.linear_acceleration, rates, spins, strict=True
            )
        ]
    )
    applied = equations.g(q, v).reshape(-1, 6)
    accelerations = np.hstack([found.linear_acceleration, rates])[1:].ravel()
    inertias, _, rows, gammas = equations.rotors(q, v)
    for inertia, row, gamma in zip(inertias, to_array(rows, accelerations.size), gammas, strict=True):
        applied = applied - (inertia * (row @ accelerations - gamma) * row).reshape(-1, 6)
    left = (needed - _reaction_wrenches(equations.mechanism, found))[1:] - applied
    left[:, 3:] /= mechanism.size
    return left


def _reaction_wrenches(mechanism: Mechanism, found: Evaluation) -> Array:
    """(b, 6) force, world, and torque about the centre of mass, body frame, by the joints on each body."""
    frames = found.state.frames()
    wrenches = np.zeros((len(frames), 6))
    for k, equations in enumerate(mechanism.equations):
        force, torque = found.reaction_force[k], found.reaction_torque[k]
        second = frames[equations.second]
        pose = mechanism.bodies[equations.second].pose
        arm = pose.point_to_body(equations.joint.reaction_point)
        point = second.position + second.rotation @ arm
        for body, sign in ((equations.first, -1.0), (equations.second, 1.0)):
            frame = frames[body]
            moment = torque + cross(point - frame.position, force)
            wrenches[body] += sign * np.concatenate([force, frame.rotation.T @ moment])
    return wrenches
