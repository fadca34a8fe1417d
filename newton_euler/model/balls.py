"""Relative rotation and angular velocity of the two bodies of a ball joint.

Springs, dampers and rotors on ball joints use these functions.

A joint with a ball has no hinges that also turn the bodies, so the orientations of both bodies determine the
rotation of the ball.

Let theta be the rotation vector (axis times angle) of the second body relative to the first. It is zero at
the rest orientation of a spring. Let omega = omega_2 - omega_1 be the relative angular velocity. The rate of
|theta|^2 / 2 is theta . omega, because a rotation leaves its own rotation vector unchanged. Therefore
k |theta|^2 / 2 is the potential of the torque -k theta on the second body. Springs and rotors are isotropic:
the same about all axes.

The functions accept arrays of generic scalars: floats, or objects with the same operations, such as the
expressions of the code generator (`newton_euler.scalars`). Source of the formulas for rotation vectors: J.
Diebel, Representing Attitude, 2006, sections 5.6 and 7.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from newton_euler.model.constraints import Frame, Jacobian
from newton_euler.model.euler_parameters import rotation
from newton_euler.model.joint import Pose
from newton_euler.model.mechanism import Mechanism
from newton_euler.scalars import Array, arctan2, cos, cross, sin, sqrt

SQUARE_FLOOR = 1e-300
"""Number that is added to a squared length before its square root, so that the length is never 0. Quotients
by the length and their derivatives then have the correct limits at 0."""

SPIN = Jacobian(
    r_first=np.zeros((3, 3)), theta_first=-np.eye(3), r_second=np.zeros((3, 3)), theta_second=np.eye(3)
)
"""Jacobian of the relative angular velocity omega with respect to the velocities of the two bodies, world
frame."""


def joint_bodies(mechanism: Mechanism, joint: str) -> tuple[int, int]:
    """Return the indices of the first and the second body of a joint in `Mechanism.bodies`."""
    equations = mechanism.joint_equations(joint)
    return equations.first, equations.second


def rotation_from_rest(first: Pose, second: Pose, rest: Array, frames: tuple[Frame, Frame]) -> Array:
    """Compute theta (3,), rad, world frame: the rotation vector of the second body relative to the first.

    theta is zero at the rest orientation. Its magnitude is at most pi. At half a revolution, theta jumps to
    the opposite direction.

    Args:
        first, second: poses of the two body frames at the mechanism's initial pose.
        rest: (3,) rad, rotation vector of the second body relative to the first where theta is zero, counted
            from the initial pose, with world components at the initial pose.
        frames: present frames of the two bodies.
    """
    # Rotations since the initial pose: of the first body, and of the second body as seen from the first
    of_first = frames[0].rotation @ first.rotation.T
    relative = of_first.T @ (frames[1].rotation @ second.rotation.T)
    return np.asarray(of_first @ rotation_vector(relative @ rotation_by(rest).T))


def spin(first: Frame, second: Frame) -> Array:
    """Compute the angular velocity omega (3,), rad/s, of the second body relative to the first, world
    frame."""
    return np.asarray(second.angular_velocity - first.angular_velocity)


def spin_gamma(first: Frame, second: Frame) -> Array:
    """Compute gamma = omega_1 x omega_2, (3,), rad/s^2, world frame.

    With the angular accelerations alpha, d omega/dt = alpha_2 - alpha_1 - gamma. This rate of omega is the
    one that an observer fixed in one of the two bodies sees; both see the same rate.
    """
    return cross(first.angular_velocity, second.angular_velocity)


def spin_rate(frames: Sequence[Frame], angular: Array, bodies: tuple[int, int]) -> Array:
    """Compute d omega/dt (3,), rad/s^2, as seen from either body of a ball, world frame.

    Args:
        frames: present frames of all b bodies.
        angular: (b, 3) angular accelerations of all bodies, rad/s^2, world frame.
        bodies: indices of the first and the second body, see `joint_bodies`.
    """
    i, j = bodies
    return np.asarray(angular[j] - angular[i] - spin_gamma(frames[i], frames[j]))


def rotation_vector(matrix: Array) -> Array:
    """Compute the rotation vector (3,), rad, of a rotation matrix (3, 3); its derivative is exact at zero.

    The angle must be below half a revolution (pi). Close to pi the axis loses digits: its relative error
    grows as round-off divided by (pi - angle).
    """
    (_, b, c), (d, _, f), (g, h, _) = matrix
    sines = 0.5 * np.array([h - f, c - g, d - b])  # sine of the angle, times the unit axis
    sine = sqrt(sines @ sines + SQUARE_FLOOR)
    cosine = 0.5 * (matrix[0, 0] + matrix[1, 1] + matrix[2, 2] - 1.0)
    return np.asarray(sines * (arctan2(sine, cosine) / sine))


def quaternion_by(vector: Array) -> Array:
    """Compute the unit quaternion (4,), (w, x, y, z), of a rotation vector (3,), rad, of any length."""
    angle = sqrt(vector @ vector + SQUARE_FLOOR)
    half = 0.5 * angle
    return np.array([cos(half), *((sin(half) / angle) * vector)])


def rotation_by(vector: Array) -> Array:
    """Compute the rotation matrix (3, 3) of a rotation vector (3,), rad, of any length."""
    return rotation(quaternion_by(vector))
