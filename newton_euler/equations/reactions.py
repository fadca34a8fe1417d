"""Reactions of joints: the wrenches (force, torque) that they put on their second bodies.

What couplings and prescribed motions put on a joint's coordinates is part of its reaction; what
control laws and springs put there is not.

Where constraints are redundant only the sum of what joints do to each body, J^T lambda, is unique. Of the
reactions that add up to it a formulation gives those of its smallest dimensionless multipliers: Cartesian
coordinates have multipliers of all joints, joint coordinates of couplings and of joints that close loops
alone, and what the tree's joints bear follows from those. Both are right, and differ.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from newton_euler.equations.applied_forces import body_wrenches
from newton_euler.equations.couplings import Coupling
from newton_euler.equations.joint_coordinates import Coordinate
from newton_euler.model.constraints import Frame, Jacobian
from newton_euler.model.joint import JointEquations, Key
from newton_euler.model.mechanism import Mechanism
from newton_euler.scalars import Array, Scalar, cross

if TYPE_CHECKING:
    from newton_euler.equations.kinematics import Link
    from newton_euler.equations.relative import Relative


class Push(NamedTuple):
    """What one constraint does to its two bodies: (6,) force and torque about the centre of mass, world."""

    joint: int
    first: int
    second: int
    on_first: Array
    on_second: Array


def _push(joint: int, first: int, second: int, jacobian: Jacobian, share: Array) -> Push:
    """Phi_q^T lambda, eq. (17)."""
    r_i, theta_i, r_j, theta_j = (block.T @ share for block in jacobian)
    return Push(joint, first, second, np.concatenate([r_i, theta_i]), np.concatenate([r_j, theta_j]))


def pushes(
    mechanism: Mechanism,
    equations: Sequence[JointEquations],
    couplings: Sequence[Coupling],
    measured: Mapping[Key, Coordinate],
    frames: Sequence[Frame],
    multipliers: Array,
) -> Iterator[Push]:
    """What the multipliers of joints and then couplings do, coordinates that are not `measured` left out."""
    row = 0
    for e in equations:
        share = multipliers[row : row + e.count]
        row += e.count
        blocks = e.jacobian(frames[e.first], frames[e.second])
        yield _push(mechanism.joint_index(e.joint.name), e.first, e.second, blocks, share)
    for number, coupling in enumerate(couplings, start=row):
        for key, factor in coupling.factors.items():
            if key in measured:
                first, second = measured[key].first, measured[key].second
                blocks = measured[key].constraint.jacobian(frames[first], frames[second])
                share = np.array([factor * multipliers[number]])
                yield _push(mechanism.joint_index(key[0]), first, second, blocks, share)


def at_joint_points(
    mechanism: Mechanism, arms: Sequence[Array], found: Iterator[Push]
) -> tuple[Array, Array]:
    """Forces and torques (j, 3) about the joint points on the second bodies.

    `arms` are (3,) from the second bodies' centres of mass to the joint points, world frame.
    """
    forces: list[Array] = [np.zeros(3)] * len(mechanism.joints)
    torques = list(forces)
    for push in found:
        force = push.on_second[:3]
        forces[push.joint] = forces[push.joint] + force
        torques[push.joint] = torques[push.joint] + push.on_second[3:] - cross(arms[push.joint], force)
    return np.array(forces), np.array(torques)


def tree_reactions(
    system: Relative,
    links: list[Link],
    linear: Array,
    angular: Array,
    multipliers: Array,
    joint_forces: Sequence[tuple[Key, Scalar]],
    spun: Sequence[tuple[tuple[int, int], Array]],
) -> tuple[Array, Array]:
    """Forces and torques (j, 3) about the joint points on the second bodies.

    Joints that the tree cuts have multipliers. Kept joints follow from the bodies' Newton-Euler
    equations, from the leaves to the ground: each carries what its child needs and nothing else
    supplies.

    Args:
        system: the equations of motion.
        links: kinematics of all bodies.
        linear, angular: (b, 3) accelerations.
        multipliers: (k,) of the loop closures and couplings.
        joint_forces: N or N m on joint coordinates, of control laws, springs and rotors.
        spun: by rotors of balls, their first and second bodies and (3,) N m on the second, world frame.
    """
    mechanism, tree = system.mechanism, system.tree
    frames = [link.frame for link in links]
    wrenches = body_wrenches(system.scene, tree.poses, frames)
    need = [
        np.concatenate(system.inertial_wrench(body, link, linear[body], angular[body])) - wrenches[body]
        for body, link in enumerate(links)
    ]  # about each centre of mass
    found = list(pushes(mechanism, system.closures, system.couplings, system.between, frames, multipliers))
    for push in found:
        need[push.first] = need[push.first] - push.on_first
        need[push.second] = need[push.second] - push.on_second
    arms = []
    for number, joint in enumerate(mechanism.joints):
        second = tree.equations(number).second
        s = joint.reaction_point - mechanism.bodies[second].center_of_mass
        arms.append(frames[second].rotation @ s)
    forces, torques = (list(rows) for rows in at_joint_points(mechanism, arms, iter(found)))
    for (name, coordinate), u in joint_forces:
        number = mechanism.joint_index(name)
        e = tree.equations(number)
        blocks = e.coordinates[coordinate].jacobian(frames[e.first], frames[e.second])
        push = _push(number, e.first, e.second, blocks, np.array([u]))
        need[e.first] = need[e.first] - push.on_first
        need[e.second] = need[e.second] - push.on_second
    for (first, second), torque in spun:
        couple = np.concatenate([np.zeros(3), torque])
        need[first], need[second] = need[first] + couple, need[second] - couple
    for kept in reversed(tree.joints):
        force, torque = need[kept.child][:3], need[kept.child][3:]
        center = frames[kept.child].position
        carried = torque + cross(center - frames[kept.parent].position, force)
        need[kept.parent] = need[kept.parent] + np.concatenate([force, carried])
        if kept.joint >= len(mechanism.joints):
            continue  # a body that floats
        sign = 1.0 if kept.forward else -1.0
        point = frames[tree.equations(kept.joint).second].position + arms[kept.joint]
        forces[kept.joint] = sign * force
        torques[kept.joint] = sign * (torque - cross(point - center, force))
    return np.array(forces), np.array(torques)
