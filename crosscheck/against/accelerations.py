"""The level of constrained accelerations, and reactions of the joints that both models have."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from crosscheck.against.align import Aligned
from crosscheck.against.worst import worst_row
from crosscheck.comparison.reactions import determined, undetermined_in_both
from crosscheck.comparison.rows import EPSILON, Row, round_off
from crosscheck.comparison.samples import Samples, Scales
from newton_euler.model.euler_parameters import rotations
from newton_euler.model.mechanism import Mechanism
from newton_euler.scalars import Array

LEVEL = "accelerations and reactions"


def acceleration_rows(
    pair: tuple[str, str], aligned: Aligned, first: Samples, second: Samples
) -> Iterator[Row]:
    """Accelerations of bodies, and reactions on the first model's second bodies at its joint points.

    Reactions are compared as far as the equations of motion determine them whichever model's constraints
    carry them. Tolerances are those between engines, see `comparison.accelerations`.
    """
    states = first.states
    constraints, masses = max(first.condition, second.condition), states.mass_condition
    yield Row(LEVEL, "condition of masses", pair, masses, 1.0 / EPSILON, "", informs=True)
    tolerance, looser = (
        round_off(condition * masses, states.noise) for condition in (constraints, constraints**2)
    )
    scales, mechanism = Scales(first), states.scene.mechanism

    for quantity, name, unit in (
        ("linear acceleration, rel", "linear_acceleration", 1.0),
        ("angular acceleration, rel", "angular_acceleration", scales.size),
    ):
        gap = np.linalg.norm(first.stack(name) - second.stack(name), axis=-1) * unit / scales.acceleration
        yield worst_row(LEVEL, quantity, pair, gap, tolerance, mechanism.body_names)
    if not aligned.joints:
        return
    force, torque = (first.stack(name) for name in ("reaction_force", "reaction_torque"))
    motions = second.stack("position"), second.stack("quaternion")
    others = reactions_in_first(
        aligned, *motions, second.stack("reaction_force"), second.stack("reaction_torque")
    )
    both = np.array([name in aligned.joints for name in mechanism.joint_names])[:, None]
    force, torque = (np.where(both, x - y, 0.0) for x, y in zip((force, torque), others, strict=True))
    assert aligned.second is not None
    free = [undetermined_in_both(states.scene, aligned.second, aligned.joints, state) for state in states.all]
    force, torque = determined(force, torque, free, scales.size)
    names = mechanism.joint_names
    for quantity, vector, unit in (
        ("reaction force, rel", force, scales.force),
        ("reaction torque, rel", torque, scales.force * scales.size),
    ):
        yield worst_row(LEVEL, quantity, pair, np.linalg.norm(vector, axis=2) / unit, looser, names)


def reactions_in_first(
    aligned: Aligned, position: Array, quaternion: Array, force: Array, torque: Array
) -> tuple[Array, Array]:
    """Reactions of the second model's joints as the first model has them: on its second body, at its point.

    Args:
        position, quaternion: (n, b, 3) and (n, b, 4) of the second model's bodies.
        force, torque: (n, k, 3) of its k joints, N and N m.

    Returns:
        (n, j, 3) both for the j joints of the first; 0 at those that it has alone.
    """
    assert aligned.second is not None
    a, b = aligned.first.mechanism, aligned.second.mechanism
    forces, torques = np.zeros((2, len(force), len(a.joints), 3))

    def seen(mechanism: Mechanism, body: str, point: Array) -> Array:
        k = mechanism.body_index(body)
        return np.asarray(
            position[:, k] + rotations(quaternion[:, k]) @ mechanism.bodies[k].pose.point_to_body(point)
        )

    for name, other in aligned.joints.items():
        j, k = a.joint_index(name), b.joint_index(other)
        one, two = a.joints[j], b.joints[k]
        sign = 1.0 if one.second == two.second else -1.0
        there, here = (seen(m, joint.second, joint.reaction_point) for m, joint in ((b, two), (a, one)))
        forces[:, j] = sign * force[:, k]
        torques[:, j] = sign * torque[:, k] + np.cross(there - here, forces[:, j])
    return forces, torques
