"""Momentum balance of one engine: residuals of Newton's and Euler's equations of each body.

Accelerations, reactions and actuator forces come from the engine. Masses, inertias and applied forces are
computed from the scene (the mechanism with its forces that the engine has to simulate). The balance therefore
tests an engine without another engine, and without the engine's own equations of motion. The check belongs to
the level (group of checks) "energy".
"""

from __future__ import annotations

import numpy as np

from crosscheck.compare.check import MOMENTUM_BALANCE, Check, round_off
from crosscheck.compare.samples import Samples
from newton_euler.equations.system import Evaluation
from newton_euler.model.mechanism import Mechanism
from newton_euler.model.scene import Scene
from newton_euler.reading.wrenches import Wrenches
from newton_euler.scalars import Array, cross


def momentum_check(name: str, samples: Samples) -> Check:
    """Make the check of the largest residual of the balance over all bodies and states.

    The residual is divided by `Scales.force`: the largest reaction or inertia force of any body at any of the
    states. The tolerance is that of reactions: round-off, times the square of the condition number of the
    constraint Jacobian, times the condition number of the mass matrix.

    Args:
        name: name of the engine or formulation (choice of coordinates).
        samples: equations of motion of the engine at a number of states.
    """
    residuals = np.abs(momentum_residuals(samples)).max(axis=(0, 2))  # of each moving body
    worst = int(np.argmax(residuals))
    value = float(residuals[worst]) / samples.scales.force
    states = samples.states
    # `noise`, the relative error of constraints that are nearly redundant or far from the origin, replaces
    # the round-off of the tolerance if it is larger
    tolerance = round_off(samples.condition**2 * states.mass_condition, states.noise)
    body = samples.states.scene.mechanism.body_names[1 + worst]  # without the ground
    return Check("energy", MOMENTUM_BALANCE, (name,), value, tolerance, where=body)


def momentum_residuals(samples: Samples) -> Array:
    """Compute residuals (n, b - 1, 6) of Newton's and Euler's equations of the moving bodies at n states, N.

    The first three residuals of a body are of forces, in the world frame. The last three are of torques about
    the center of mass, in the body frame, divided by the mechanism's size.
    """
    scene = samples.states.scene
    return np.array([_residuals(scene, evaluation) for evaluation in samples.evaluations])


def _residuals(scene: Scene, evaluation: Evaluation) -> Array:
    """Compute the residuals (b - 1, 6) of `momentum_residuals` at one state.

    The residuals of a body are m (a - g) - f and (J' domega'/dt + omega' x J' omega' - n') / size. The force
    f and the torque n' are the sums of applied loads and joint reactions. Inertia J', angular velocity omega'
    and torque n' are in the body frame.

    Args:
        scene: the scene.
        evaluation: an engine's accelerations, reactions and actuator forces at the state.
    """
    mechanism = scene.mechanism
    # Applied loads: forces (world frame) and torques (about the center of mass, world frame) on each body
    applied = Wrenches(mechanism, evaluation.state)
    applied.add_forces(scene, evaluation.actuator_force)
    applied.add_armatures(scene, evaluation.linear_acceleration, evaluation.angular_acceleration)
    reactions = _reaction_wrenches(mechanism, evaluation)
    residuals = []
    for k, (body, frame) in enumerate(zip(mechanism.bodies, applied.frames, strict=True)):
        spin, spin_rate, torque = (  # in the body frame
            frame.rotation.T @ vector
            for vector in (frame.angular_velocity, evaluation.angular_acceleration[k], applied.total[k, 3:])
        )
        force = body.mass * (evaluation.linear_acceleration[k] - scene.gravity) - applied.total[k, :3]
        moment = body.inertia @ spin_rate + cross(spin, body.inertia @ spin) - torque
        residuals.append(np.concatenate([force, moment]) - reactions[k])
    of_moving_bodies = np.array(residuals)[1:]
    of_moving_bodies[:, 3:] /= mechanism.size
    return of_moving_bodies


def _reaction_wrenches(mechanism: Mechanism, evaluation: Evaluation) -> Array:
    """Sum the joint reactions on each body, (b, 6).

    Forces are in the world frame, N. Torques are about the center of mass, in the body frame, N m.
    """
    frames = evaluation.state.frames()
    wrenches = np.zeros((len(frames), 6))
    for k, equations in enumerate(mechanism.equations):
        force, torque = evaluation.reaction_force[k], evaluation.reaction_torque[k]
        second = frames[equations.second]
        pose = mechanism.bodies[equations.second].pose
        # Reactions act on the second body at the joint point, and on the first body with the opposite sign
        arm = pose.point_to_body(equations.joint.point_on_second)
        point = second.position + second.rotation @ arm
        for body, sign in ((equations.first, -1.0), (equations.second, 1.0)):
            frame = frames[body]
            moment = torque + cross(point - frame.position, force)
            wrenches[body] += sign * np.concatenate([force, frame.rotation.T @ moment])
    return wrenches
