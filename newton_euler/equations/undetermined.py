"""Joint reactions that redundant constraints leave undetermined.

If constraints are redundant, some combinations of reactions balance each other on every body. Any multiple of
such a combination can be added to a solution. Engines therefore give different reactions, and all are right
(J. Garcia de Jalon, M. D. Gutierrez-Lopez, Multibody dynamics with redundant constraints and singular mass
matrix, Multibody System Dynamics 30, 2013). The functions here compute these combinations, so that only the
determined part of reactions is compared.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from newton_euler.equations.cartesian import Cartesian
from newton_euler.equations.couplings import couplings, residuals
from newton_euler.equations.dense import RANK_TOLERANCE, orthonormal_null, orthonormal_range
from newton_euler.equations.redundancy import mobility
from newton_euler.model.constraints import Jacobian
from newton_euler.model.scene import Scene
from newton_euler.model.state import State
from newton_euler.scalars import Array


class ReactionPlace(NamedTuple):
    """Body and point on which the reaction of a joint acts.

    Attributes:
        joint: number of the joint.
        body: number of the body that the reaction acts on.
        arm: (3,) from the center of mass of the body to the joint point, world frame, m.
    """

    joint: int
    body: int
    arm: Array


def undetermined(scene: Scene, state: State) -> Array:
    """Compute combinations of joint reactions that balance each other on every body.

    Forces of couplings and prescribed motions on the coordinates of a joint are part of its reaction.

    Args:
        scene: the scene.
        state: poses and angles of the bodies.

    Returns:
        (6 j, r) orthonormal columns, one for each of r redundant constraints. Each of the j joints has a
        force, and a torque divided by the mechanism's size, both N, on its second body at the joint point,
        world frame.
    """
    mechanism, redundant = scene.mechanism, redundant_constraints(scene)
    if not redundant:
        return np.zeros((6 * len(mechanism.joints), 0))
    places = _places(scene, state)
    rank = _constraints(scene) - redundant
    columns = _columns(scene, state, places, len(places), mechanism.size)
    return _acting_on_nothing([columns], len(places), rank)


def redundant_constraints(scene: Scene) -> int:
    """Count the redundant constraints of all joints and couplings of a scene."""
    rank = 6 * (len(scene.mechanism.bodies) - 1) - mobility(scene).degrees_of_freedom
    return max(0, _constraints(scene) - rank)


def _constraints(scene: Scene) -> int:
    """Count the constraint equations of all joints and couplings of a scene."""
    return sum(equations.count for equations in scene.mechanism.equations) + len(couplings(scene))


def undetermined_in_both(
    first: Scene, second: Scene, joints: Mapping[str, str], states: tuple[State, State]
) -> Array:
    """Compute the undetermined reactions of two scenes with the same bodies and motion.

    The reactions of the scenes in their common joints can differ by combinations of these only.

    Args:
        first, second: the scenes.
        joints: name in the second scene of each common joint, by its name in the first scene.
        states: the same state twice, with the angles of the first and of the second scene.

    Returns:
        (6 j, r) orthonormal columns for the j joints of the first scene, in the units of `undetermined`.
    """
    # all joints that only one scene has share the number j, after those of the first scene
    state, other = states
    own, count, size = _places(first, state), len(first.mechanism.joints), first.mechanism.size
    others = {name: place._replace(joint=count) for name, place in _places(second, other).items()}
    others |= {other: own[name] for name, other in joints.items()}
    own |= {name: own[name]._replace(joint=count) for name in own.keys() - joints.keys()}
    columns = [_columns(first, state, own, count + 1, size), _columns(second, other, others, count + 1, size)]
    return _acting_on_nothing(columns, count)


def _places(scene: Scene, state: State) -> dict[str, ReactionPlace]:
    """Find where the reaction of each joint acts, by name: on the second body at the joint point."""
    found, frames = dict[str, ReactionPlace](), state.frames()
    for k, joint in enumerate(scene.mechanism.joints):
        body = scene.mechanism.body_index(joint.second)
        pose = scene.mechanism.bodies[body].pose
        found[joint.name] = ReactionPlace(
            k, body, frames[body].rotation @ pose.point_to_body(joint.reaction_point)
        )
    return found


class _Columns(NamedTuple):
    """Forces that unit multipliers of k constraints exert on b bodies and on joints.

    Attributes:
        rows: (k, 6 b) on the bodies; 0 on the ground, which supports any force.
        wrenches: (joints, 6, k) on the joints.
    """

    rows: Array
    wrenches: Array


def _acting_on_nothing(columns: Sequence[_Columns], joints: int, rank: int | None = None) -> Array:
    """Compute orthonormal reactions (6 j, r) of the first j joints whose sum on every body is zero.

    Args:
        columns: constraint forces of one or two scenes.
        joints: number j of joints.
        rank: rank of the constraint forces on the bodies; None for the numerical rank.
    """
    null = orthonormal_null(np.concatenate([part.rows for part in columns]).T, rank)
    wrenches = np.concatenate([part.wrenches[:joints].reshape(6 * joints, -1) for part in columns], axis=1)
    return orthonormal_range(wrenches @ null)


def _columns(
    scene: Scene, state: State, places: Mapping[str, ReactionPlace], count: int, size: float
) -> _Columns:
    """Collect the forces of all constraints of a scene.

    Args:
        scene, state: give the constraints.
        places: where the reaction of each joint acts, by name.
        count: number of joints; the last number may stand for several joints.
        size: size of the mechanism, m, which makes torques comparable with forces.
    """
    mechanism, frames = scene.mechanism, state.frames()
    rows = [np.zeros((0, 6 * len(frames)))]
    wrenches = [np.zeros((count, 6, 0))]

    def add(parts: list[tuple[str, int, int, Jacobian]], unit: Array) -> None:
        """Append the forces of k equations.

        Args:
            parts: for each joint coordinate in the equations: name of the joint, numbers of its bodies, and
                Jacobian blocks.
            unit: (k,) divisors that make the equations dimensionless.
        """
        row = np.zeros((len(unit), len(frames), 6))
        wrench = np.zeros((count, 6, len(unit)))
        for name, i, j, blocks in parts:
            place = places[name]
            for body, r, theta in (
                (i, blocks.r_first, blocks.theta_first),
                (j, blocks.r_second, blocks.theta_second),
            ):
                row[:, body] += np.hstack([r, theta / size])
                if body == place.body:
                    torque = theta - np.cross(place.arm, r)
                    wrench[place.joint] += np.hstack([r, torque / size]).T
        row[:, 0] = 0.0
        rows.append(row.reshape(len(unit), 6 * len(frames)) * size / unit[:, None])
        wrenches.append(wrench * size / unit)

    # joints
    for equations in mechanism.equations:
        i, j = equations.first, equations.second
        blocks = equations.jacobian(frames[i], frames[j])
        add([(equations.joint.name, i, j, blocks)], equations.units(size))
    # couplings and prescribed motions
    measured = Cartesian(scene).between
    coupled = couplings(scene)
    all_slopes = residuals(mechanism, coupled, frames, 0.0, state.angles).slopes
    for coupling, slopes in zip(coupled, all_slopes, strict=True):
        parts = []
        for key, slope in slopes.items():
            i, j = measured[key].first, measured[key].second
            blocks = measured[key].constraint.jacobian(frames[i], frames[j])
            parts.append((key[0], i, j, Jacobian(*(slope * block for block in blocks))))
        add(parts, np.array([size if coupling.is_length else 1.0]))
    return _Columns(np.concatenate(rows), np.concatenate(wrenches, axis=2))


def determined(force: Array, torque: Array, free: Sequence[Array], size: float) -> tuple[Array, Array]:
    """Remove the undetermined part from differences between reactions of two engines.

    Args:
        force, torque: (n, j, 3) differences at n states, N and N m.
        free: result of `undetermined` for each of the n states.
        size: size of the mechanism, m.

    Returns:
        Forces and torques (n, j, 3) without their undetermined part.
    """
    found = np.concatenate([force, torque / size], axis=2)
    for n, basis in enumerate(free):
        wrench = found[n].ravel()
        found[n] = (wrench - basis @ (basis.T @ wrench)).reshape(-1, 6)
    return found[..., :3], size * found[..., 3:]


def undetermined_joints(scene: Scene, state: State) -> tuple[int, list[str]]:
    """Count redundant constraints at a state, and name the joints whose reactions are not unique."""
    basis = undetermined(scene, state)
    parts = np.split(np.linalg.norm(basis, axis=1), len(scene.mechanism.joints))
    names = scene.mechanism.joint_names
    return basis.shape[1], [
        name for name, part in zip(names, parts, strict=True) if np.max(part) > RANK_TOLERANCE
    ]


def is_undetermined(scene: Scene) -> Array:
    """Find the components of reactions that are not unique in some configuration.

    Returns:
        (j, 2, 3) True for undetermined components of force (index 0) and torque (index 1), world frame.
    """
    found = np.zeros(6 * len(scene.mechanism.joints), dtype=bool)
    for state in mobility(scene).states:
        found |= np.linalg.norm(undetermined(scene, state), axis=1) > RANK_TOLERANCE
    return found.reshape(-1, 2, 3)


def redundancy_text(count: int, joints: str) -> str:
    """Format the number of redundant constraints and the names of their joints, for messages."""
    return f"{count} redundant constraint{'s'[: count - 1]} at joints {joints}"
