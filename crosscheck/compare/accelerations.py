"""Level "accelerations and reactions": constrained accelerations, reactions in one form for all engines.

Reactions are force and torque on the second body, at the joint point, in the world frame. Where redundant
constraints leave them open they are compared as J^T lambda, what they do to bodies, see `reactions`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cache

import numpy as np

from crosscheck.compare.attribution import MIN_RESIDUAL_RATIO, Cause, dynamic_cause
from crosscheck.compare.check import EPSILON, Check, round_off
from crosscheck.compare.samples import RATE_ERROR, Samples
from newton_euler.equations.system import Evaluation
from newton_euler.equations.undetermined import determined
from newton_euler.scalars import Array

LEVEL = "accelerations and reactions"

SOFTNESS = 1e-2
"""Relative to the largest: MuJoCo caps solimp at 0.9999, so its constraint forces are off by the
order of 0.1 % however small the step, and by more where a mechanism is ill-conditioned; they are
shown beside the rigid ones."""


def acceleration_rows(pair: tuple[str, str], first: Samples, second: Samples) -> Iterator[Check]:
    """Accelerations of bodies and joints, and reactions of joints.

    Tolerances are round-off magnified by the condition of the constraints and of the mass matrix; reactions
    lose the constraints' condition once more. What fails is blamed on the body or term whose equations of
    motion are violated.
    """
    states = first.states
    constraints, masses = max(first.condition, second.condition), states.mass_condition
    yield Check(LEVEL, "condition of masses", pair, masses, 1.0 / EPSILON, "", judged=False)
    tolerance, looser = (
        round_off(condition * masses, states.noise) for condition in (constraints, constraints**2)
    )
    scales, mechanism = first.scales, states.scene.mechanism

    @cache
    def cause() -> Cause | None:
        return dynamic_cause(first, second)

    def row(quantity: str, gap: Array, tolerance: float, names: Sequence[str], moved: bool = False) -> Check:
        value, found = float(gap.max()), Cause(names[int(np.argmax(gap.max(axis=0)))])
        if not value <= tolerance and not moved:
            found = cause() or found
        return Check(LEVEL, quantity, pair, value, tolerance, found.where, detail=found.detail)

    def apart(name: str) -> Array:
        return np.asarray(np.linalg.norm(first.stack(name) - second.stack(name), axis=-1))

    linear = apart("linear_acceleration") / scales.acceleration
    angular = apart("angular_acceleration") * scales.size / scales.acceleration
    yield row("linear acceleration, rel", linear, tolerance, mechanism.body_names)
    yield row("angular acceleration, rel", angular, tolerance, mechanism.body_names)
    names = mechanism.joint_names
    yield row("joint acceleration, rel", _joint_gap(first, second), tolerance + RATE_ERROR, names)
    force, torque = (first.stack(name) - second.stack(name) for name in ("reaction_force", "reaction_torque"))
    force, torque = determined(force, torque, states.undetermined, scales.size)
    yield row("reaction force, rel", np.linalg.norm(force, axis=2) / scales.force, looser, names)
    gap = np.linalg.norm(torque, axis=2) / (scales.force * scales.size)
    moved = _is_another_point(torque, first.stack("reaction_force"))
    yield row("reaction torque, rel", gap, looser, names, moved)


def _joint_gap(first: Samples, second: Samples) -> Array:
    """Differences (n, j) of the accelerations of joints: of the second body relative to the first.

    They follow from the accelerations of each system's own coordinates. An angular one counts at the size.
    """
    mechanism, scales = first.states.scene.mechanism, first.scales
    ends = np.array([[mechanism.body_index(name) for name in (j.first, j.second)] for j in mechanism.joints])
    gaps = []
    pairs = zip(first.coordinate_accelerations, second.coordinate_accelerations, strict=True)
    for (one, two), unit in zip(pairs, (1.0, scales.size), strict=True):
        difference = (one - two)[:, ends[:, 1]] - (one - two)[:, ends[:, 0]]
        gaps.append(np.linalg.norm(difference, axis=2) * unit / scales.acceleration)
    return np.asarray(np.maximum(*gaps))


def _is_another_point(torque: Array, force: Array) -> bool:
    """True if differences of torques (n, j, 3) are those of one joint that is seen from another point.

    Then they are arms times forces (n, j, 3), perpendicular to the forces in every state.
    """
    largest = np.linalg.norm(torque, axis=2).max(axis=0)
    if np.sum(largest > MIN_RESIDUAL_RATIO * largest.max()) != 1:
        return False
    joint = int(np.argmax(largest))
    along = np.abs(np.sum(torque[:, joint] * force[:, joint], axis=1))
    return bool(
        np.all(along <= MIN_RESIDUAL_RATIO * largest[joint] * np.linalg.norm(force[:, joint], axis=1))
    )


def softness_row(name: str, soft: Evaluation, rigid: Samples) -> Check:
    """Compare reaction forces of an engine's soft constraints at the start."""
    states = rigid.states
    force = rigid.evaluations[0].reaction_force
    floor = states.energy / states.scene.mechanism.size
    gap = np.linalg.norm(soft.reaction_force - force, axis=1)
    gap = gap / max(floor, float(np.linalg.norm(force, axis=1).max()))
    return Check(
        LEVEL,
        "reaction force, rel",
        (f"{name} soft", f"{name} rigid"),
        float(gap.max()),
        SOFTNESS,
        states.scene.mechanism.joint_names[int(np.argmax(gap))],
        judged=False,
    )
