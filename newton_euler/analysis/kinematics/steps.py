"""Steps between configurations: singular configurations that are passed on the way, and jumps.

`Configurations` are n vectors of joint coordinates of a `Chain`, a mechanism with chosen joint coordinates.
The tangent space at a configuration has the f dimensionless velocities that leave its loops closed, where f
is the number of degrees of freedom. An assembly branch is a set of configurations that the mechanism can
reach from each other without passing a singular configuration.
"""

from __future__ import annotations

import numpy as np

from newton_euler.analysis.kinematics.configurations import Configurations
from newton_euler.equations.dense import RANK_TOLERANCE
from newton_euler.scalars import Array

MAX_DEVIATION = 0.5
"""Largest deviation of a configuration from the end of a step along the tangent space, as a fraction of its
distance from the begin of the step. Configurations that jumped to another branch deviate more."""

MIN_COSINE = 0.5
"""Smallest cosine of the angles between the tangent spaces at both ends of a step."""

DEVIATION_ROUND_OFF = 1e-9
"""Deviation, rad or sizes of the mechanism, that is round-off."""


def crossing_signs(before: Configurations, after: Configurations) -> Array:
    """Return -1.0 (n, 2) where a singular configuration was crossed between two configurations, else 1.0.

    At a crossing the determinant of a Jacobian in the tangent space changes its sign: the Jacobian of the
    goals (first column), or of all chosen coordinates (second column). A Jacobian has a determinant only if
    it has as many rows as the mechanism has degrees of freedom; otherwise the sign is 1.0.

    Args:
        before, after: n configurations each.
    """
    chain = before.chain
    signs = np.ones((len(before), 2))
    # bases of the tangent spaces before and after may have different orientations
    projected = np.swapaxes(_projected_tangent(before, after), 1, 2)
    # Jacobians before and after: of the goals, and of all chosen coordinates (`keys`) if these are not the
    # same; the first `goal_count` of the chosen coordinates have goals
    goal_before, goal_after = (each.goal_errors(chain.goal_at(each))[1] for each in (before, after))
    pairs = [(goal_before, goal_after)]
    if chain.has_axis_goal or chain.goal_count < len(chain.keys):
        pairs.append((before.coordinate_jacobian, after.coordinate_jacobian))
    for column, (jacobian_before, jacobian_after) in enumerate(pairs):
        if jacobian_before.shape[1] == chain.freedoms:
            start = np.linalg.det(jacobian_before @ np.swapaxes(before.tangent, 1, 2))
            end = np.linalg.det(jacobian_after @ projected)
            crossed = (start * end < 0.0) & (np.abs(start) > RANK_TOLERANCE)
            signs[crossed, column] = -1.0
    return signs


def crosses_singular_loops(before: Configurations, after: Configurations) -> Array:
    """Return True (n,) where loops lost rank between two configurations, as where a four-bar linkage is flat.

    There the mechanism has more degrees of freedom and can change to another branch. A smooth path through
    such a configuration changes the sign of a singular value of the loops' Jacobian J. Then J^+(before)
    J(after) has an eigenvalue that is negative; on other short strides its eigenvalues are near 1, and 0 in
    the tangent space.

    Args:
        before, after: n configurations each, one stride apart.
    """
    tangent_projector = np.swapaxes(before.tangent, 1, 2) @ before.tangent
    change = before.loop_inverse @ after.loops + tangent_projector
    # all eigenvalues are within the Frobenius norm of the difference from the identity
    distance = np.linalg.norm(change - np.eye(change.shape[1]), axis=(1, 2))
    crossed = distance >= 1.0 - RANK_TOLERANCE
    eigenvalues = np.linalg.eigvals(change[crossed])
    crossed[crossed] = np.min(eigenvalues.real, axis=1, initial=1.0) < RANK_TOLERANCE
    return np.asarray(crossed)


def stays_on_branch(before: Configurations, after: Configurations, step: Array) -> Array:
    """Return True (n,) for configurations that continue others without a singular configuration or a jump.

    Arguments as of `continues`.
    """
    crossed = np.any(crossing_signs(before, after) < 0.0, axis=1) | crosses_singular_loops(before, after)
    return continues(before, after, step) & ~crossed


def continues(before: Configurations, after: Configurations, step: Array) -> Array:
    """Return True (n,) for configurations that continue others; others jumped, perhaps to another branch.

    The step has to explain the displacement, and the tangent space may turn little. A large turn would leave
    the signs of `crossing_signs` open.

    Args:
        before, after: n configurations each.
        step: (n, nv) dimensionless displacement of first order, in the tangent space of `before`.
    """
    if not before.phi.shape[1]:  # without loops there is a single branch
        return np.ones(len(before), dtype=bool)
    cosines = np.linalg.svd(_projected_tangent(before, after), compute_uv=False)
    turns_little = np.all(cosines > MIN_COSINE, axis=1)
    unexplained = distances(before.step_by(step), after)
    is_explained = unexplained <= MAX_DEVIATION * distances(before, after) + DEVIATION_ROUND_OFF
    return np.asarray(turns_little & is_explained)


def _projected_tangent(before: Configurations, after: Configurations) -> Array:
    """Project basis vectors of the tangent spaces of n configurations on the velocities that others allow.

    Where loops lose rank, more than f velocities leave the loops closed. The basis
    `Configurations.tangent` is then any f of them.

    Returns:
        (n, f, nv) the projected vectors. They have the orientation of `before.tangent`; their singular values
        are the cosines of the angles between both spaces.
    """
    return np.asarray(before.tangent - before.tangent @ after.loop_inverse @ after.loops)


def distances(configs: Configurations, others: Configurations) -> Array:
    """Compute the largest displacements (n,) of bodies, sizes of the mechanism or rad."""
    shift = np.linalg.norm(configs.position - others.position, axis=2) / configs.chain.scene.mechanism.size
    # |p - q| is 2 sin(angle / 4) for quaternions p and q; a quaternion and its negative are the same rotation
    quaternions = configs.quaternion, others.quaternion
    turns = [2.0 * np.linalg.norm(quaternions[0] + sign * quaternions[1], axis=2) for sign in (1.0, -1.0)]
    return np.asarray(np.max(np.maximum(shift, np.minimum(*turns)), axis=1))
