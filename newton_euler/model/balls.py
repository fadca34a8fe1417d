"""Relative rotation of the two bodies of a ball joint, for springs, dampers and rotors on balls.

Joints with a ball have no hinge beside it, so that the two bodies determine its rotation. With theta the
rotation vector of the second body against the first, from the rest position, and omega = omega_2 - omega_1,
the rate of |theta|^2 / 2 is theta . omega (theta is its own image under the rotation that it stands for), so
that k |theta|^2 / 2 is the potential of the torque -k theta on the second body. Both springs and rotors are
the same about all axes, and so no frame is preferred.

All over generic scalars (J. Diebel, Representing Attitude, 2006, sections 5.6 and 7, for rotation vectors).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from newton_euler.model.constraints import Frame, Jacobian
from newton_euler.model.euler_parameters import rotation
from newton_euler.model.joint import Pose
from newton_euler.model.mechanism import Mechanism
from newton_euler.scalars import Array, arctan2, cos, cross, sin, sqrt

TINY = 1e-300  # added to squares so that no angle is zero; quotients by it and their derivatives stay right
SPIN = Jacobian(np.zeros((3, 3)), -np.eye(3), np.zeros((3, 3)), np.eye(3))  # Jacobian of omega, world frame


def ends(mechanism: Mechanism, joint: str) -> tuple[int, int]:
    """Find the numbers of the two bodies of a joint."""
    equations = mechanism.joint_equations(joint)
    return equations.first, equations.second


def rotation_between(first: Pose, second: Pose, rest: Array, frames: tuple[Frame, Frame]) -> Array:
    """Compute theta (3,) rad, world frame; right below half a revolution, where it jumps to the other side.

    Args:
        first, second: reference poses of the frames at the initial pose.
        rest: (3,) rotation vector of the second body against the first where theta is zero, from the
            initial pose, in the world's axes there.
        frames: of the two bodies.
    """
    into_world = frames[0].rotation @ first.rotation.T
    turned = into_world.T @ (frames[1].rotation @ second.rotation.T)
    return np.asarray(into_world @ rotation_vector(turned @ rotation_by(rest).T))


def spin(first: Frame, second: Frame) -> Array:
    """Compute omega (3,) rad/s, world frame."""
    return np.asarray(second.angular_velocity - first.angular_velocity)


def spin_gamma(first: Frame, second: Frame) -> Array:
    """Compute gamma (3,) of d omega/dt = `SPIN` . accelerations - gamma, relative to either body."""
    return cross(first.angular_velocity, second.angular_velocity)


def spin_rate(frames: Sequence[Frame], angular: Array, bodies: tuple[int, int]) -> Array:
    """Compute d omega/dt (3,) relative to either body, world frame, from angular accelerations (b, 3)."""
    i, j = bodies
    return np.asarray(angular[j] - angular[i] - spin_gamma(frames[i], frames[j]))


def rotation_vector(matrix: Array) -> Array:
    """Compute the rotation vector (3,), rad, of a rotation matrix (3, 3), with the right derivative at zero.

    The angle is below half a revolution; near that the axis loses digits in proportion to the distance.
    """
    (_, b, c), (d, _, f), (g, h, _) = matrix
    sines = 0.5 * np.array([h - f, c - g, d - b])
    sine = sqrt(sines @ sines + TINY)
    cosine = 0.5 * (matrix[0, 0] + matrix[1, 1] + matrix[2, 2] - 1.0)
    return np.asarray(sines * (arctan2(sine, cosine) / sine))


def quaternion_by(vector: Array) -> Array:
    """Compute the unit quaternion (4,) w-x-y-z of a rotation vector (3,), rad, of any angle."""
    angle = sqrt(vector @ vector + TINY)
    half = 0.5 * angle
    return np.array([cos(half), *((sin(half) / angle) * vector)])


def rotation_by(vector: Array) -> Array:
    """Compute the rotation matrix (3, 3) of a rotation vector (3,), rad, of any angle."""
    return rotation(quaternion_by(vector))
