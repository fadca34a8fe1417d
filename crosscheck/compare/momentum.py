"""Momentum balance, a check at the level "energy": Newton's and Euler's equations of each body.

Masses, inertias and what acts on the bodies are the scene's, by its numbers. Everything else is an engine's
own answer, so that neither another engine nor its own equations of motion are asked.
"""

from __future__ import annotations

import numpy as np

from crosscheck.compare.check import Check, round_off
from crosscheck.compare.samples import Samples
from newton_euler.equations.system import Evaluation
from newton_euler.model.mechanism import Mechanism
from newton_euler.model.scene import Scene
from newton_euler.reading.wrenches import Wrenches
from newton_euler.scalars import Array, cross


def momentum_row(name: str, samples: Samples) -> Check:
    """The largest rate of momentum that no force accounts for, at any state; where is the body.

    Relative to the largest force, and as exact as reactions are.
    """
    gap = np.abs(momentum_residuals(samples)).max(axis=(0, 2))
    worst = int(np.argmax(gap))
    value = float(gap[worst]) / samples.scales.force
    states = samples.states
    tolerance = round_off(samples.condition**2 * states.mass_condition, states.noise)
    body = samples.states.scene.mechanism.body_names[1 + worst]
    return Check("energy", "momentum balance, rel", (name,), value, tolerance, body)


def momentum_residuals(samples: Samples) -> Array:
    """(n, b - 1, 6) of the bodies that move: N, world frame, and N m over the size, body frame."""
    scene = samples.states.scene
    return np.array([_residual(scene, evaluation) for evaluation in samples.evaluations])


def _residual(scene: Scene, found: Evaluation) -> Array:
    """(b - 1, 6): m a - f of each body that moves, and J' domega' + omega' x J' omega' - n' over the size."""
    mechanism = scene.mechanism
    applied = Wrenches(mechanism, found.state)
    applied.add_forces(scene, found.actuator_force)
    applied.add_rotors(scene, found.linear_acceleration, found.angular_acceleration)
    reactions = _reaction_wrenches(mechanism, found)
    left = []
    for k, (body, frame) in enumerate(zip(mechanism.bodies, applied.frames, strict=True)):
        spin, rate, torque = (
            frame.rotation.T @ vector
            for vector in (frame.angular_velocity, found.angular_acceleration[k], applied.total[k, 3:])
        )
        force = body.mass * (found.linear_acceleration[k] - scene.gravity) - applied.total[k, :3]
        moment = body.inertia @ rate + cross(spin, body.inertia @ spin) - torque
        left.append(np.concatenate([force, moment]) - reactions[k])
    balance = np.array(left)[1:]
    balance[:, 3:] /= mechanism.size
    return balance


def _reaction_wrenches(mechanism: Mechanism, found: Evaluation) -> Array:
    """(b, 6) force, world, and torque about the center of mass, body frame, by the joints on each body."""
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
