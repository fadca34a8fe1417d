"""Level "kinematics": poses, velocities and constraint Jacobians at consistent states."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache

import numpy as np

from crosscheck.compare.attribution import kinematic_cause
from crosscheck.compare.check import EPSILON, Check, reach, round_off
from crosscheck.compare.samples import Samples
from newton_euler.model.euler_parameters import angle_between
from newton_euler.scalars import Array


def kinematics_rows(pair: tuple[str, str], first: Samples, second: Samples) -> Iterator[Check]:
    """Poses, closures, velocities and constraint Jacobians; what fails is blamed on the joint that it opens.

    Tolerances are round-off magnified by the condition of the constraints, which velocities and the
    directions that are free come from.
    """
    scene = first.states.scene
    bodies = scene.mechanism.body_names
    condition = max(first.condition, second.condition)
    share = round_off(condition, first.states.noise)

    @cache
    def cause() -> str | None:
        return kinematic_cause(first, second)

    def row(quantity: str, gap: Array, tolerance: float = share) -> Check:
        value, worst = float(gap.max()), bodies[int(np.argmax(gap.max(axis=0)))]
        if not value <= tolerance:
            worst = cause() or worst
        return Check("kinematics", quantity, pair, value, tolerance, worst)

    def apart(name: str) -> Array:
        return np.asarray(np.linalg.norm(first.stack(name) - second.stack(name), axis=-1))

    yield Check("kinematics", "condition of constraints", pair, condition, 1.0 / EPSILON, "", judged=False)
    length = round_off(condition, first.states.redundancy) * reach(scene, first.stack("position"))
    yield row("positions, m", apart("position"), length)
    yield row("orientations, rad", angle_between(first.stack("quaternion"), second.stack("quaternion")))
    if first.closes or second.closes:
        opening, allowed = max(first.opening, second.opening), share + condition * first.states.opening
        where = "" if opening <= allowed else cause() or ""
        yield Check("kinematics", "loop-closure error, rel", pair, opening, allowed, where)
    projector = np.array([a @ a.T - b @ b.T for a, b in zip(first.bases, second.bases, strict=True)])
    yield row("constraint Jacobian", np.abs(projector).max(axis=2).reshape(-1, len(bodies), 6).max(axis=2))
    scales = first.scales
    yield row("linear velocity, rel", apart("linear_velocity") / scales.velocity)
    yield row("angular velocity, rel", apart("angular_velocity") * scales.size / scales.velocity)
