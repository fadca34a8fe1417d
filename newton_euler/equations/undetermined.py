"""Joint reactions that redundant constraints leave undetermined.

If constraints are redundant, some combinations of reactions balance each other on every body. Any multiple of
such a combination can be added to a solution. Engines therefore give different reactions, and all are right
(J. Garcia de Jalon, M. D. Gutierrez-Lopez, Multibody dynamics with redundant constraints and singular mass
matrix, Multibody System Dynamics 30, 2013). The functions here compute these combinations, so that only the
determined part of reactions is compared. The reaction of a joint is its force and torque on its second body.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from newton_euler.equations.cartesian import Cartesian
from newton_euler.equations.coupling_equations import residuals
from newton_euler.equations.couplings import couplings
from newton_euler.equations.dense import RANK_TOLERANCE, orthonormal_null, orthonormal_range
from newton_euler.equations.load_friction import loaded_frictions
from newton_euler.equations.redundancy import mobility
from newton_euler.errors import MechanismError
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
        state: poses of the bodies, and hinge angles with their full revolutions.

    Returns:
        (6 j, r) orthonormal columns, one for each of r redundant constraints. Each of the j joints has a
        force, and a torque divided by the mechanism's size, both N, on its second body at the joint point,
        world frame.
    """
    mechanism, redundant = scene.mechanism, redundant_constraints(scene)
    if not redundant:
        return np.zeros((6 * len(mechanism.joints), 0))
    rank = _constraint_count(scene) - redundant
    forces = _constraint_forces(scene, state)
    # multipliers without effect on any body, and the reactions that they make
    null = orthonormal_null(forces.on_bodies.T, rank)
    return orthonormal_range(forces.reactions.reshape(6 * len(mechanism.joints), -1) @ null)


def redundant_constraints(scene: Scene) -> int:
    """Count the redundant constraints of all joints, couplings and prescribed motions of a scene."""
    rank = 6 * (len(scene.mechanism.bodies) - 1) - mobility(scene).degrees_of_freedom
    return max(0, _constraint_count(scene) - rank)


def _constraint_count(scene: Scene) -> int:
    """Count the constraint equations of all joints, couplings and prescribed motions of a scene."""
    # `couplings` lists prescribed motions, too
    return sum(equations.count for equations in scene.mechanism.equations) + len(couplings(scene))


def _places(scene: Scene, state: State) -> dict[str, ReactionPlace]:
    """Find where the reaction of each joint acts: on the second body at the joint point; by joint name."""
    found, frames = dict[str, ReactionPlace](), state.frames()
    for k, joint in enumerate(scene.mechanism.joints):
        body = scene.mechanism.body_index(joint.second)
        pose = scene.mechanism.bodies[body].pose
        arm = frames[body].rotation @ pose.point_to_body(joint.point_on_second)
        found[joint.name] = ReactionPlace(joint=k, body=body, arm=arm)
    return found


class _ConstraintForces(NamedTuple):
    """Forces of k constraints with unit multipliers, on b bodies and as reactions of joints.

    Wrenches are (force, torque divided by the mechanism's size), world frame.

    Attributes:
        on_bodies: (k, 6 b) wrenches about the centers of mass; 0 on the ground, which supports any force.
        reactions: (joints, 6, k) wrenches on the second bodies at the joint points.
    """

    on_bodies: Array
    reactions: Array


def _constraint_forces(scene: Scene, state: State) -> _ConstraintForces:
    """Collect the forces of all constraints of a scene for unit multipliers.

    Args:
        scene, state: give the constraints and their Jacobian.
    """
    mechanism, frames = scene.mechanism, state.frames()
    places, count = _places(scene, state), len(mechanism.joints)
    size = mechanism.size  # makes torques comparable with forces
    on_bodies = [np.zeros((0, 6 * len(frames)))]
    reactions = [np.zeros((count, 6, 0))]

    def add(parts: list[tuple[str, int, int, Jacobian]], unit: Array) -> None:
        """Append the forces of k equations.

        Args:
            parts: terms of the equations: name of the joint, numbers of its bodies, and Jacobian blocks
                (k, 3). The equations of a joint have one part; a coupling has one for each coordinate.
            unit: (k,) divisors that make the equations dimensionless.
        """
        body_wrench = np.zeros((len(unit), len(frames), 6))
        reaction = np.zeros((count, 6, len(unit)))
        for name, i, j, blocks in parts:
            place = places[name]
            for body, r, theta in (
                (i, blocks.r_first, blocks.theta_first),
                (j, blocks.r_second, blocks.theta_second),
            ):
                body_wrench[:, body] += np.hstack([r, theta / size])
                if body == place.body:
                    torque = theta - np.cross(place.arm, r)
                    reaction[place.joint] += np.hstack([r, torque / size]).T
        body_wrench[:, 0] = 0.0
        on_bodies.append(body_wrench.reshape(len(unit), 6 * len(frames)) * size / unit[:, None])
        reactions.append(reaction * size / unit)

    # joints
    for equations in mechanism.equations:
        i, j = equations.first, equations.second
        blocks = equations.jacobian(frames[i], frames[j])
        add([(equations.joint.name, i, j, blocks)], equations.units(size))
    # couplings and prescribed motions. The Cartesian form of the equations of motion measures each coupled
    # joint coordinate between two bodies
    measured = Cartesian(scene).between  # by key (joint, number of the coordinate)
    coupled = couplings(scene)
    # derivatives of each coupling with respect to its coordinates; they do not depend on time. Angles in
    # `state.angles` are known with their full revolutions
    all_slopes = residuals(mechanism, coupled, frames, time=0.0, known=state.angles).slopes
    for coupling, slopes in zip(coupled, all_slopes, strict=True):
        parts = []
        for (joint, number), slope in slopes.items():
            coordinate = measured[joint, number]
            i, j = coordinate.first, coordinate.second
            blocks = coordinate.constraint.jacobian(frames[i], frames[j])
            parts.append((joint, i, j, Jacobian(*(slope * block for block in blocks))))
        add(parts, np.array([size if coupling.is_length else 1.0]))
    return _ConstraintForces(np.concatenate(on_bodies), np.concatenate(reactions, axis=2))


def determined(force: Array, torque: Array, bases: Sequence[Array], size: float) -> tuple[Array, Array]:
    """Remove the undetermined part from differences between reactions of two engines.

    Args:
        force, torque: (n, j, 3) differences at n states, N and N m.
        bases: result of `undetermined` for each of the n states.
        size: size of the mechanism, m.

    Returns:
        Forces and torques (n, j, 3) without their undetermined part.
    """
    wrenches = np.concatenate([force, torque / size], axis=2)
    for n, basis in enumerate(bases):
        wrench = wrenches[n].ravel()
        wrenches[n] = (wrench - basis @ (basis.T @ wrench)).reshape(-1, 6)
    return wrenches[..., :3], size * wrenches[..., 3:]


def undetermined_joints(scene: Scene, state: State) -> tuple[int, list[str]]:
    """Count redundant constraints, and list the names of joints whose reactions are not unique at a state."""
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
    plural = "s" if count > 1 else ""
    return f"{count} redundant constraint{plural} at joints {joints}"


def check_loaded_frictions(scene: Scene) -> None:
    """Raise `MechanismError` for friction that grows with an undetermined reaction."""
    elements = loaded_frictions(scene)
    if not elements:
        return
    undetermined = is_undetermined(scene)
    for element in elements:
        force, _torque = undetermined[scene.mechanism.joint_index(element.joint)]
        if np.any(force):
            raise MechanismError(
                element.element,
                "grows with a reaction that redundant constraints leave undetermined",
                "load_coefficient 0, or joints without redundant constraints",
            )
