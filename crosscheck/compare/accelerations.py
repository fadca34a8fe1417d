"""Level "accelerations and reactions": accelerations under rigid constraints, and joint reactions.

A level is a group of checks; these checks compare two engines at the same states of a mechanism. A reaction
is the force and the torque of a joint on its second body, at the joint point, in the world frame. Redundant
constraints leave some combinations of reactions undetermined; these combinations are removed before reactions
are compared (`determined`).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cache

import numpy as np

from crosscheck.compare.attribution import MIN_RESIDUAL_RATIO, Cause, dynamic_cause
from crosscheck.compare.check import MACHINE_EPSILON, REACTIONS, Check, round_off
from crosscheck.compare.samples import RATE_ERROR, Samples
from crosscheck.engines.engine import SoftConstraints
from newton_euler.equations.undetermined import determined
from newton_euler.scalars import Array

LEVEL = "accelerations and reactions"
"""Name of the level in checks."""


def acceleration_checks(pair: tuple[str, str], first: Samples, second: Samples) -> Iterator[Check]:
    """Compare accelerations of bodies and joints, and reactions of joints, of two engines.

    Tolerances are the round-off, or the relative error of the constraints (`noise`) if that is larger, times
    the condition numbers of the constraints and of the mass matrix. For reactions, the condition number of
    the constraints is squared. A failing check is attributed to the body, the joint or gravity: the element
    whose equations of motion are violated.

    Args:
        pair: names of the two engines.
        first, second: equations of the two engines at the same states.
    """
    states = first.states
    # Tolerances
    constraint_condition = max(first.condition, second.condition)
    mass_condition = states.mass_condition
    acceleration_tolerance = round_off(constraint_condition * mass_condition, states.noise)
    reaction_tolerance = round_off(constraint_condition**2 * mass_condition, states.noise)
    # The condition number, for information
    yield Check(
        LEVEL,
        "condition of masses",
        pair,
        value=mass_condition,
        tolerance=1.0 / MACHINE_EPSILON,
        where="",
        judged=False,
    )
    # Units that differences are divided by: largest acceleration, m/s^2, largest force, N, and size, m
    scales, mechanism = first.scales, states.scene.mechanism

    @cache
    def cause() -> Cause | None:
        """Find the element that failing checks are attributed to, once for all checks."""
        return dynamic_cause(first, second)

    def check_largest(
        quantity: str, gap: Array, tolerance: float, names: Sequence[str], attribute: bool = True
    ) -> Check:
        """Make the check of the largest difference.

        Args:
            quantity, tolerance: attributes of the check.
            gap: differences (n, b or j) of b bodies or j joints at n states.
            names: names of the bodies or joints.
            attribute: True to attribute a failing check to `cause`, False to the body or joint itself.
        """
        value, place = float(gap.max()), Cause(names[int(np.argmax(gap.max(axis=0)))])
        if not value <= tolerance and attribute:
            place = cause() or place
        return Check(LEVEL, quantity, pair, value, tolerance, place.where, detail=place.detail)

    def difference(name: str) -> Array:
        """Compute norms of the differences of a vector quantity, (n states, bodies)."""
        return np.asarray(np.linalg.norm(first.stack(name) - second.stack(name), axis=-1))

    # Accelerations
    linear = difference("linear_acceleration") / scales.acceleration
    angular = difference("angular_acceleration") * scales.size / scales.acceleration
    bodies, joints = mechanism.body_names, mechanism.joint_names
    yield check_largest("linear acceleration, rel", linear, acceleration_tolerance, bodies)
    yield check_largest("angular acceleration, rel", angular, acceleration_tolerance, bodies)
    gap = _joint_acceleration_differences(first, second)  # by finite differences, hence `RATE_ERROR`
    yield check_largest("joint acceleration, rel", gap, acceleration_tolerance + RATE_ERROR, joints)
    # Reactions
    force, torque = (first.stack(name) - second.stack(name) for name in ("reaction_force", "reaction_torque"))
    force, torque = determined(force, torque, states.undetermined, scales.size)
    gap = np.linalg.norm(force, axis=2) / scales.force
    force_name, torque_name = REACTIONS
    yield check_largest(force_name, gap, reaction_tolerance, joints)
    gap = np.linalg.norm(torque, axis=2) / (scales.force * scales.size)
    # A shifted joint point does not violate equations of motion: the joint itself is the cause
    shifted = _is_shifted_joint_point(torque, first.stack("reaction_force"))
    yield check_largest(torque_name, gap, reaction_tolerance, joints, attribute=not shifted)


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
    # First the linear, then the angular accelerations (n, b, 3) of both engines
    pairs = zip(first.coordinate_accelerations, second.coordinate_accelerations, strict=True)
    for (of_first, of_second), unit in zip(pairs, (1.0, scales.size), strict=True):
        gap = of_first - of_second
        difference = gap[:, second_bodies] - gap[:, first_bodies]
        gaps.append(np.linalg.norm(difference, axis=2) * unit / scales.acceleration)
    return np.asarray(np.maximum(*gaps))


def _is_shifted_joint_point(torque: Array, force: Array) -> bool:
    """Return True if the differences of reaction torques come from a shifted point of one joint.

    The torque of a reaction about another point differs by arm x force. If a single point is shifted, only
    the torques of this joint differ, perpendicularly to its reaction force in every state. Differences up to
    `MIN_RESIDUAL_RATIO` of the largest count as zero.

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


def softness_check(name: str, constraints: SoftConstraints, rigid: Samples) -> Check:
    """Compare reaction forces at the initial state between soft and rigid constraints of one engine.

    The check is for information: it is not judged.

    Args:
        name: name of the engine.
        constraints: the engine's soft constraints.
        rigid: the engine's equations with rigid constraints; the first state is the initial state.
    """
    states = rigid.states
    force = rigid.evaluations[0].reaction_force
    # differences are divided by the largest force, N, or by this lower bound if all forces are nearly zero
    smallest_unit = states.energy / states.scene.mechanism.size
    soft = constraints.evaluate(states.scene)
    gap = np.linalg.norm(soft.reaction_force - force, axis=1)
    gap = gap / max(smallest_unit, float(np.linalg.norm(force, axis=1).max()))
    return Check(
        LEVEL,
        REACTIONS[0],
        between=(f"{name} soft", f"{name} rigid"),
        value=float(gap.max()),
        tolerance=constraints.force_error,
        where=states.scene.mechanism.joint_names[int(np.argmax(gap))],
        judged=False,
    )
