"""Joint reactions: the force and torque that each joint exerts on its second body.

The reaction of a joint includes the forces of couplings and prescribed motions on its coordinates. It does
not include the forces of control laws and springs.

If constraints are redundant, only the sum of the wrenches on each body, J^T lambda, is unique. Each form of
the equations returns the reactions of its minimum-norm multipliers. The Cartesian form has multipliers for
all joints. The joint-coordinate form has multipliers for couplings and loop-closing joints only; the
reactions of the other joints follow from them. The two results then differ, and both are right.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from newton_euler.equations.couplings import Measured
from newton_euler.equations.formulation import Formulation
from newton_euler.equations.kinematics import TreeKinematics
from newton_euler.model.constraints import Frame, Jacobian
from newton_euler.model.joint import Key
from newton_euler.scalars import Array, Scalar, cross


class ConstraintWrench(NamedTuple):
    """Wrenches of a constraint on its two bodies.

    Attributes:
        joint: number of the joint.
        first, second: numbers of the bodies.
        on_first, on_second: (6,) force, N, and torque about the center of mass, N m, world frame.
    """

    joint: int
    first: int
    second: int
    on_first: Array
    on_second: Array


def _push(joint: int, first: int, second: int, jacobian: Jacobian, multipliers: Array) -> ConstraintWrench:
    """Compute the wrenches Phi_q^T lambda of multipliers (k,), from the Jacobian between two bodies.

    This is equation (17) of the paper cited in `newton_euler.equations.cartesian`.
    """
    r_i, theta_i, r_j, theta_j = (block.T @ multipliers for block in jacobian)
    return ConstraintWrench(
        joint, first, second, np.concatenate([r_i, theta_i]), np.concatenate([r_j, theta_j])
    )


def constraint_wrenches(
    system: Formulation, frames: Sequence[Frame], measured: Mapping[Key, Measured], multipliers: Array
) -> Iterator[ConstraintWrench]:
    """Yield the wrenches of joints with multipliers, then of couplings between bodies.

    Args:
        system: the equations of motion.
        frames: pose and velocity of each body.
        measured: joint coordinates that couplings act on.
        multipliers: (rows,) Lagrange multipliers of joints and couplings.
    """
    row, index = 0, system.mechanism.joint_index
    for e in system.constrained:
        share = multipliers[row : row + e.count]
        row += e.count
        blocks = e.jacobian(frames[e.first], frames[e.second])
        yield _push(index(e.joint.name), e.first, e.second, blocks, share)
    for number, coupling in enumerate(system.couplings, start=row):
        for key, slope in coupling.seen_slopes(measured).items():
            if key in system.between:
                between = system.between[key]
                blocks = between.constraint.jacobian(frames[between.first], frames[between.second])
                share = np.array([slope * multipliers[number]])
                yield _push(index(key[0]), between.first, between.second, blocks, share)


def _arms(system: Formulation, frames: Sequence[Frame]) -> list[Array]:
    """Compute the vector (3,) from each second body's center of mass to its joint point, world frame, m."""
    return [
        frames[e.second].rotation @ system.poses[e.second].point_to_body(e.joint.reaction_point)
        for e in system.equations
    ]


def at_joint_points(
    system: Formulation, frames: Sequence[Frame], found: Iterable[ConstraintWrench]
) -> tuple[Array, Array]:
    """Sum wrenches by joint and refer them to the joint points.

    Args:
        system: the equations of motion.
        frames: pose and velocity of each body.
        found: wrenches of constraints.

    Returns:
        Forces, N, and torques, N m, on the second bodies at the joint points, (j, 3) each, world frame.
    """
    arms = _arms(system, frames)
    forces: list[Array] = [np.zeros(3)] * len(arms)
    torques = list(forces)
    for push in found:
        force = push.on_second[:3]
        forces[push.joint] = forces[push.joint] + force
        torques[push.joint] = torques[push.joint] + push.on_second[3:] - cross(arms[push.joint], force)
    return np.array(forces), np.array(torques)


def tree_reactions(
    system: TreeKinematics,
    frames: Sequence[Frame],
    measured: Mapping[Key, Measured],
    needed: Sequence[Array],
    multipliers: Array,
    joint_forces: Iterable[tuple[Key, Scalar]],
    couples: Iterable[tuple[tuple[int, int], Array]],
) -> tuple[Array, Array]:
    """Compute the reactions of all joints in the joint-coordinate form.

    Loop-closing joints have multipliers. The reactions of the tree's joints follow from the Newton-Euler
    equations of the bodies, from the leaves to the ground.

    Args:
        system: the equations of motion.
        frames: pose and velocity of each body.
        measured: joint coordinates that couplings act on.
        needed: (6,) for each body: force, N, and torque about the center of mass, N m, world frame, that
            joints, joint forces and armatures must supply together.
        multipliers: (k,) Lagrange multipliers of loop closures and couplings.
        joint_forces: force of each control law, spring or armature (rotor inertia) on a joint coordinate, N
            or N m, with the key of the coordinate.
        couples: for each armature on a ball joint: numbers of both bodies, and the torque (3,) on the second
            one, N m, world frame.

    Returns:
        Forces, N, and torques, N m, on the second bodies at the joint points, (j, 3) each, world frame.
    """
    # wrenches of multipliers, joint forces and armatures reduce what the tree's joints must supply
    mechanism, tree, need = system.mechanism, system.tree, list(needed)
    found = list(constraint_wrenches(system, frames, measured, multipliers))
    for push in found:
        need[push.first] = need[push.first] - push.on_first
        need[push.second] = need[push.second] - push.on_second
    forces, torques = (list(rows) for rows in at_joint_points(system, frames, found))
    for (name, coordinate), u in joint_forces:
        number = mechanism.joint_index(name)
        e = system.equations[number]
        blocks = e.coordinates[coordinate].jacobian(frames[e.first], frames[e.second])
        push = _push(number, e.first, e.second, blocks, np.array([u]))
        need[push.first] = need[push.first] - push.on_first
        need[push.second] = need[push.second] - push.on_second
    for (first, second), torque in couples:
        couple = np.concatenate([np.zeros(3), torque])
        need[first], need[second] = need[first] + couple, need[second] - couple
    # from the leaves to the ground: each joint carries what its child needs
    arms = _arms(system, frames)
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
