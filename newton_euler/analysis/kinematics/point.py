"""Motion of a point fixed in a body: its positions, the directions in which it moves, and its conditioning.

Configurations are n vectors of joint coordinates of a mechanism; the tangent space at a configuration has the
f velocities that leave its loops closed (`newton_euler.analysis.kinematics.configurations`).
"""

from __future__ import annotations

import numpy as np

from newton_euler.analysis.kinematics.configurations import Configurations
from newton_euler.errors import MechanismError, finite_array, quoted
from newton_euler.model.description import ArrayField, description
from newton_euler.model.euler_parameters import rotations
from newton_euler.model.mechanism import Mechanism
from newton_euler.scalars import Array

RATE_STEP = 1e-3
"""Dimensionless step h of the central differences of order 4 that give velocities of a point: the errors
h^4 / 30 and (round-off / h) are about equal."""

CHUNK = 10_000
"""Number of configurations whose differences are computed at once; each takes some kB of memory."""

MAX_DISTANCE = 1e6
"""Largest coordinate of a point, sizes of the mechanism; its motion has too few digits if it is farther."""

DIRECTION_TOLERANCE = 1e-9
"""Part of the largest velocity of a point below which a direction has no motion: a point of a planar
mechanism stays in its plane up to round-off."""


@description
class Point:
    """A point fixed in a body, such as the tip of an excavator's bucket.

    Attributes:
        body: name of the body, not the ground.
        point: (3,) m, world at the initial pose, in which bodies and joints are described; the point moves
            with the body.

    Raises:
        MechanismError: for a point that is not three finite numbers.

    Examples:
        >>> tip = Point("dumbbell", [-1.0, 0.0, 0.0])
        >>> poses = solve_poses(load("pendulum"), {"pivot": [0.0, np.pi / 2]})
        >>> print(poses.positions(tip).round(3) + 0.0)  # m, before and after a quarter of a turn
        [[-1.  0.  0.]
         [ 0. -1.  0.]]
    """

    body: str
    point: ArrayField

    def __post_init__(self) -> None:
        point = finite_array(f"point of body {quoted(self.body)}", "point", self.point, (3,))
        object.__setattr__(self, "point", point)


def body_index(mechanism: Mechanism, point: Point) -> int:
    """Return the index of the body of a point.

    Raises:
        UnknownNameError: for an unknown body.
        MechanismError: for the ground, and for a point too far from its body.
    """
    index = mechanism.body_index(point.body)
    if index == 0:
        raise MechanismError("point", f"body is the ground, {quoted(point.body)}", "a body that moves")
    farthest = MAX_DISTANCE * mechanism.size
    if np.max(np.abs(point.point)) > farthest:
        needed = f"{farthest:.3g} m at most, {MAX_DISTANCE:g} sizes of the mechanism"
        raise MechanismError(
            f"point of body {quoted(point.body)}", f"point is {point.point.tolist()}", needed
        )
    return index


def positions(configs: Configurations, point: Point) -> Array:
    """Compute world positions (n, 3), m, of a point of a body."""
    mechanism = configs.chain.scene.mechanism
    index = body_index(mechanism, point)
    arm = mechanism.bodies[index].pose.point_to_body(point.point)
    return np.asarray(configs.position[:, index] + rotations(configs.quaternion[:, index]) @ arm)


def rates(configs: Configurations, point: Point) -> Array:
    """Compute velocities (n, 3, f) of a point, m, for unit motions along the basis of the tangent space."""
    found = np.zeros((len(configs), 3, configs.chain.freedoms))
    for begin in range(0, len(configs), CHUNK):
        rows = slice(begin, begin + CHUNK)
        here = configs[rows]
        for k in range(configs.chain.freedoms):
            # central differences of order 4; loops that open by h^2 do not change them
            for count, weight in ((1.0, 8.0), (2.0, -1.0)):
                step = count * RATE_STEP * here.tangent[:, k]
                ends = (positions(here.step_by(sign * step), point) for sign in (1.0, -1.0))
                found[rows, :, k] += weight * np.subtract(*ends) / (12.0 * RATE_STEP)
    return found


def directions(velocities: Array) -> Array:
    """Find the directions in which a point moves: orthonormal rows (r, 3), r at most 3.

    If world axes span these directions, as in a mechanism that moves in a coordinate plane, the rows are
    these axes. Otherwise the rows of a plane are a horizontal direction, and that of steepest ascent.

    Args:
        velocities: (n, 3, f) velocities of the point at n poses.
    """
    vectors = np.swapaxes(velocities, 1, 2).reshape(-1, 3)
    _, stretches, basis = np.linalg.svd(vectors, full_matrices=False)
    basis = basis[stretches > DIRECTION_TOLERANCE * np.max(stretches, initial=0.0)]
    in_space = np.linalg.norm(basis, axis=0)  # of each world axis, the part in the span of the basis
    if np.all((in_space < DIRECTION_TOLERANCE) | (in_space > 1.0 - DIRECTION_TOLERANCE)):
        return np.eye(3)[in_space > 0.5]
    if len(basis) == 2:
        horizontal = np.cross(np.cross(*basis), [0.0, 0.0, 1.0])
        horizontal *= np.sign(horizontal[np.argmax(np.abs(horizontal))]) / np.linalg.norm(horizontal)
        upward = np.cross(horizontal, np.cross(*basis))
        return np.stack([horizontal, upward * np.sign(upward[2])])
    largest = np.take_along_axis(basis, np.argmax(np.abs(basis), axis=1)[:, None], axis=1)
    return np.asarray(basis * np.sign(largest))


def conditioning(velocities: Array, coordinate_rates: Array, dimensions: int) -> Array:
    """Compute the conditioning (n,) of a point's velocity with respect to the rates of coordinates.

    The conditioning is the smallest singular value of the Jacobian divided by the largest: 1 if equal efforts
    move the point equally fast in all directions, 0 if some direction has no motion. C. Gosselin, J. Angeles,
    "A Global Performance Index for the Kinematic Optimization of Robotic Manipulators", Journal of Mechanical
    Design 113(3), 1991.

    Args:
        velocities: (n, 3, f) velocities of the point for unit motions along the basis of the tangent space.
        coordinate_rates: (n, f, f) dimensionless rates of the coordinates for the same motions.
        dimensions: number of directions in which the point moves.
    """
    jacobian = velocities @ np.linalg.pinv(coordinate_rates, DIRECTION_TOLERANCE)
    values = np.linalg.svd(jacobian, compute_uv=False)
    last = max(1, min(dimensions, values.shape[1])) - 1
    largest = values[:, 0]
    return np.divide(values[:, last], largest, out=np.zeros_like(largest), where=largest > 0.0)
