"""Level "kinematics": poses, velocities, loop-closure errors and constraint Jacobians of two engines.

A level is a group of checks; these checks compare two engines at the same states, all of which satisfy the
constraints of the mechanism.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache

import numpy as np

from crosscheck.compare.attribution import kinematic_cause
from crosscheck.compare.check import MACHINE_EPSILON, Check, reach, round_off
from crosscheck.compare.samples import Samples
from newton_euler.model.euler_parameters import angle_between
from newton_euler.scalars import Array


def kinematics_checks(pair: tuple[str, str], first: Samples, second: Samples) -> Iterator[Check]:
    """Compare poses, velocities, loop-closure errors and constraint Jacobians of two engines.

    Tolerances are the relative error of the constraints times their condition number. This error is
    round-off, or `redundancy` (largest singular value of nearly redundant constraints, treated as zero) if
    that is larger; `noise` also has the round-off of coordinates far from the origin. Relative values are
    divided by the mechanism's size (lengths) or the largest velocity. A failing check is attributed to the
    joint whose constraints are violated, or to a body.

    Args:
        pair: names of the two engines.
        first, second: equations of the two engines at the same states.
    """
    scene = first.states.scene
    bodies = scene.mechanism.body_names
    condition = max(first.condition, second.condition)
    rel_tolerance = round_off(condition, first.states.noise)

    @cache
    def cause() -> str | None:
        """Find the joint or body that failing checks are attributed to, once for all checks."""
        return kinematic_cause(first, second)

    def check_largest(quantity: str, gap: Array, tolerance: float = rel_tolerance) -> Check:
        """Make the check of the largest of the differences `gap` (n states, b bodies)."""
        value, where = float(gap.max()), bodies[int(np.argmax(gap.max(axis=0)))]
        if not value <= tolerance:
            where = cause() or where
        return Check("kinematics", quantity, pair, value, tolerance, where)

    def difference(name: str) -> Array:
        """Compute norms of the differences of a vector quantity, (n states, b bodies)."""
        return np.asarray(np.linalg.norm(first.stack(name) - second.stack(name), axis=-1))

    # The condition number, for information
    yield Check(
        "kinematics", "condition of constraints", pair, condition, 1.0 / MACHINE_EPSILON, "", judged=False
    )
    # Poses
    largest_coordinate = reach(scene, first.stack("position"))  # m, at least the size of the mechanism
    length = round_off(condition, first.states.redundancy) * largest_coordinate
    yield check_largest("positions, m", difference("position"), length)
    turned = angle_between(first.stack("quaternion"), second.stack("quaternion"))
    yield check_largest("orientations, rad", turned)
    # Residuals of the engines' own constraints; the tolerance includes the residuals of the given states,
    # which may have few digits
    if first.has_constraints or second.has_constraints:
        error = max(first.closure_error, second.closure_error)
        tolerance = rel_tolerance + condition * first.states.closure_error
        where = "" if error <= tolerance else cause() or ""
        yield Check("kinematics", "loop-closure error, rel", pair, error, tolerance, where)
    # Constraint Jacobians, as projectors (6 b, 6 b) onto the velocities that the constraints allow, which do
    # not depend on coordinates; the difference of a body is the largest one in its six rows
    projector = np.array([a @ a.T - b @ b.T for a, b in zip(first.bases, second.bases, strict=True)])
    gap = np.abs(projector).max(axis=2).reshape(-1, len(bodies), 6).max(axis=2)
    yield check_largest("constraint Jacobian", gap)
    # Velocities
    scales = first.scales
    yield check_largest("linear velocity, rel", difference("linear_velocity") / scales.velocity)
    angular = difference("angular_velocity") * scales.size / scales.velocity
    yield check_largest("angular velocity, rel", angular)
