"""Momentum balance of one engine: residuals of Newton's and Euler's equations of each body.

Accelerations, reactions and actuator forces come from the engine. Masses, inertias and applied forces are
computed from the scene. The balance therefore tests an engine without another engine, and without the
engine's own equations of motion. The check belongs to the level "energy".
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
    """Make the check of the largest residual of the balance over all bodies and states.

    The residual is divided by the largest force. The tolerance is that of reactions.

    Args:
        name: name of the engine or formulation.
        samples: its equations at a number of states.
    """
    residuals = np.abs(momentum_residuals(samples)).max(axis=(0, 2))
    worst = int(np.argmax(residuals))
    value = float(residuals[worst]) / samples.scales.force
    states = samples.states
    tolerance = round_off(samples.condition**2 * states.mass_condition, states.noise)
    body = samples.states.scene.mechanism.body_names[1 + worst]
    return Check("energy", "momentum balance, rel", (name,), value, tolerance, body)


def momentum_residuals(samples: Samples) -> Array:
    """Compute residuals (n, b - 1, 6) of Newton's and Euler's equations of the moving bodies at n states, N.

    The first three are of forces, in the world frame. The last three are of torques divided by the
    mechanism's size, in the body frame.
    """
    scene = samples.states.scene
    return np.array([_residual(scene, evaluation) for evaluation in samples.evaluations])


def _residual(scene: Scene, found: Evaluation) -> Array:
    """Compute residuals (b - 1, 6) of the moving bodies at one state, N, as `momentum_residuals`.

    They are m a - f, and (J' domega'/dt + omega' x J' omega' - n') / size. Inertia J', angular velocity
    omega' and torque n' are in the body frame.
    """
    mechanism = scene.mechanism
    applied = Wrenches(mechanism, found.state)
    applied.add_forces(scene, found.actuator_force)
    applied.add_armatures(scene, found.linear_acceleration, found.angular_acceleration)
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
    """Sum the joint reactions on each body, (b, 6).

    Forces are in the world frame, N. Torques are about the center of mass, in the body frame, N m.
    """
    frames = found.state.frames()
    wrenches = np.zeros((len(frames), 6))
    for k, equations in enumerate(mechanism.equations):
        force, torque = found.reaction_force[k], found.reaction_torque[k]
        second = frames[equations.second]
        pose = mechanism.bodies[equations.second].pose
        # Reactions act on the second body at the joint point, and on the first body with the opposite sign
        arm = pose.point_to_body(equations.joint.reaction_point)
        point = second.position + second.rotation @ arm
        for body, sign in ((equations.first, -1.0), (equations.second, 1.0)):
            frame = frames[body]
            moment = torque + cross(point - frame.position, force)
            wrenches[body] += sign * np.concatenate([force, frame.rotation.T @ moment])
    return wrenches
