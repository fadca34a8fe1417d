"""Level "accelerations and reactions": accelerations under rigid constraints, and joint reactions.

The checks compare two engines at the same states. A reaction is the force and the torque of a joint on its
second body, at the joint point, in the world frame. Redundant constraints leave some combinations of
reactions undetermined; these combinations are removed before reactions are compared (`determined`).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cache

import numpy as np

from crosscheck.compare.attribution import MIN_RESIDUAL_RATIO, Cause, dynamic_cause
from crosscheck.compare.check import MACHINE_EPSILON, Check, round_off
from crosscheck.compare.samples import RATE_ERROR, Samples
from newton_euler.equations.system import Evaluation
from newton_euler.equations.undetermined import determined
from newton_euler.scalars import Array

LEVEL = "accelerations and reactions"
"""Name of the level in checks."""

SOFTNESS = 1e-2
"""Expected error of reaction forces of soft constraints, relative to the largest force. MuJoCo limits solimp
to
0.9999, which causes errors of about 0.1 % at any step, and larger errors in ill-conditioned mechanisms."""


def acceleration_rows(pair: tuple[str, str], first: Samples, second: Samples) -> Iterator[Check]:
    """Compare accelerations of bodies and joints, and reactions of joints, of two engines.

    Tolerances are round-off times the condition numbers of the constraints and of the mass matrix. For
    reactions, the condition number of the constraints is squared. A failing check is attributed to the body,
    joint or term whose equations of motion are violated.

    Args:
        pair: names of the two engines.
        first, second: their equations at the same states.
    """
    # Tolerances and scales
    states = first.states
    constraint_condition = max(first.condition, second.condition)
    mass_condition = states.mass_condition
    yield Check(LEVEL, "condition of masses", pair, mass_condition, 1.0 / MACHINE_EPSILON, "", judged=False)
    tolerance, reaction_tolerance = (
        round_off(condition * mass_condition, states.noise)
        for condition in (constraint_condition, constraint_condition**2)
    )
    scales, mechanism = first.scales, states.scene.mechanism

    @cache
    def cause() -> Cause | None:
        return dynamic_cause(first, second)

    def row(
        quantity: str, gap: Array, tolerance: float, names: Sequence[str], attribute: bool = True
    ) -> Check:
        """Make the check of the largest of the differences `gap` (n states, bodies or joints)."""
        value, found = float(gap.max()), Cause(names[int(np.argmax(gap.max(axis=0)))])
        if not value <= tolerance and attribute:
            found = cause() or found
        return Check(LEVEL, quantity, pair, value, tolerance, found.where, detail=found.detail)

    def difference(name: str) -> Array:
        """Norms of the differences of a vector quantity, (n states, bodies)."""
        return np.asarray(np.linalg.norm(first.stack(name) - second.stack(name), axis=-1))

    # Accelerations
    linear = difference("linear_acceleration") / scales.acceleration
    angular = difference("angular_acceleration") * scales.size / scales.acceleration
    yield row("linear acceleration, rel", linear, tolerance, mechanism.body_names)
    yield row("angular acceleration, rel", angular, tolerance, mechanism.body_names)
    names = mechanism.joint_names
    joints = _joint_acceleration_differences(first, second)
    yield row("joint acceleration, rel", joints, tolerance + RATE_ERROR, names)
    # Reactions
    force, torque = (first.stack(name) - second.stack(name) for name in ("reaction_force", "reaction_torque"))
    force, torque = determined(force, torque, states.undetermined, scales.size)
    yield row("reaction force, rel", np.linalg.norm(force, axis=2) / scales.force, reaction_tolerance, names)
    gap = np.linalg.norm(torque, axis=2) / (scales.force * scales.size)
    # A shifted joint point does not violate equations of motion: the joint itself is the cause
    shifted = _is_shifted_joint_point(torque, first.stack("reaction_force"))
    yield row("reaction torque, rel", gap, reaction_tolerance, names, attribute=not shifted)


def _joint_acceleration_differences(first: Samples, second: Samples) -> Array:
    """Compute relative differences (n, j) of joint accelerations of two engines at n states.

    A joint acceleration is the acceleration of the joint's second body relative to its first body. The
    accelerations follow from those of each engine's coordinates, see `Samples.coordinate_accelerations`.
    Angular accelerations are multiplied by the mechanism's size.
    """
    mechanism, scales = first.states.scene.mechanism, first.scales
    first_bodies = [mechanism.body_index(joint.first) for joint in mechanism.joints]
    second_bodies = [mechanism.body_index(joint.second) for joint in mechanism.joints]
    gaps = []
    # First the linear, then the angular accelerations
    pairs = zip(first.coordinate_accelerations, second.coordinate_accelerations, strict=True)
    for (one, two), unit in zip(pairs, (1.0, scales.size), strict=True):
        difference = (one - two)[:, second_bodies] - (one - two)[:, first_bodies]
        gaps.append(np.linalg.norm(difference, axis=2) * unit / scales.acceleration)
    return np.asarray(np.maximum(*gaps))


def _is_shifted_joint_point(torque: Array, force: Array) -> bool:
    """Return True if torque differences come from another point of one joint.

    A reaction about another point has a torque that differs by arm x force. The differences are then those of
    a single joint, and perpendicular to the reaction force in every state.

    Args:
        torque: (n, j, 3) differences of the reaction torques of j joints at n states, N m.
        force: (n, j, 3) reaction forces, N.
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
    """Compare reaction forces at the initial state between soft and rigid constraints of one engine.

    Args:
        name: name of the engine.
        soft: evaluation of the initial state with the engine's soft constraints.
        rigid: the engine's equations with rigid constraints; the first state is the initial state.
    """
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
