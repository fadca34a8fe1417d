"""Level "kinematics": poses, velocities, loop-closure errors and constraint Jacobians of two engines.

The checks compare two engines at the same states, all of which satisfy the constraints of the scene.
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


def kinematics_rows(pair: tuple[str, str], first: Samples, second: Samples) -> Iterator[Check]:
    """Compare poses, velocities, loop-closure errors and constraint Jacobians of two engines.

    Tolerances are round-off times the condition number of the constraints. A failing check is attributed to
    the joint whose constraints are violated.

    Args:
        pair: names of the two engines.
        first, second: their equations at the same states.
    """
    scene = first.states.scene
    bodies = scene.mechanism.body_names
    condition = max(first.condition, second.condition)
    rel_tolerance = round_off(condition, first.states.noise)

    @cache
    def cause() -> str | None:
        return kinematic_cause(first, second)

    def row(quantity: str, gap: Array, tolerance: float = rel_tolerance) -> Check:
        """Make the check of the largest of the differences `gap` (n states, b bodies)."""
        value, worst = float(gap.max()), bodies[int(np.argmax(gap.max(axis=0)))]
        if not value <= tolerance:
            worst = cause() or worst
        return Check("kinematics", quantity, pair, value, tolerance, worst)

    def difference(name: str) -> Array:
        """Norms of the differences of a vector quantity, (n states, b bodies)."""
        return np.asarray(np.linalg.norm(first.stack(name) - second.stack(name), axis=-1))

    yield Check(
        "kinematics", "condition of constraints", pair, condition, 1.0 / MACHINE_EPSILON, "", judged=False
    )
    # Poses
    length = round_off(condition, first.states.redundancy) * reach(scene, first.stack("position"))
    yield row("positions, m", difference("position"), length)
    yield row("orientations, rad", angle_between(first.stack("quaternion"), second.stack("quaternion")))
    # Residuals of the engines' own constraints; those of the given states, which have few digits, are allowed
    if first.has_constraints or second.has_constraints:
        error = max(first.closure_error, second.closure_error)
        tolerance = rel_tolerance + condition * first.states.closure_error
        where = "" if error <= tolerance else cause() or ""
        yield Check("kinematics", "loop-closure error, rel", pair, error, tolerance, where)
    # Constraint Jacobians, as projectors onto the velocities that they allow: independent of coordinates
    projector = np.array([a @ a.T - b @ b.T for a, b in zip(first.bases, second.bases, strict=True)])
    yield row("constraint Jacobian", np.abs(projector).max(axis=2).reshape(-1, len(bodies), 6).max(axis=2))
    # Velocities
    scales = first.scales
    yield row("linear velocity, rel", difference("linear_velocity") / scales.velocity)
    yield row("angular velocity, rel", difference("angular_velocity") * scales.size / scales.velocity)
