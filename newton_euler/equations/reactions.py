"""Joint reactions: the force and torque that each joint exerts on its second body.

The reaction of a joint includes the forces of couplings and prescribed motions on its coordinates. It does
not include the forces of control laws, springs and armatures (rotor inertias).

If constraints are redundant, only the sum of the wrenches on each body, Phi_q^T lambda, is unique. Each form
of the equations returns the reactions of its minimum-norm multipliers. The Cartesian form has multipliers for
all joints. The joint-coordinate form has multipliers for couplings and loop-closing joints only; the
reactions of the other joints follow from them. The two results then differ, and both are right.

A coupling is a constraint between joint coordinates x_i, such as a gear: a sum of functions p_i(x_i) equals a
function of time. The derivatives p_i'(x_i) are its slopes. A prescribed motion is a coupling of a single
coordinate.
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
    """Wrenches of one or more constraint equations on the two bodies that they connect.

    Attributes:
        joint: number of the joint to which the constraint belongs.
        first, second: numbers of the bodies, 0 for the ground.
        on_first, on_second: (6,) force, N, and torque about the center of mass, N m, world frame.
    """

    joint: int
    first: int
    second: int
    on_first: Array
    on_second: Array


def _wrench(joint: int, first: int, second: int, jacobian: Jacobian, multipliers: Array) -> ConstraintWrench:
    """Compute the wrenches Phi_q^T lambda of multipliers lambda (k,) on two bodies.

    This is equation (17) of the paper cited in `newton_euler.equations.cartesian`.

    Args:
        joint, first, second: see `ConstraintWrench`.
        jacobian: Jacobian blocks (k, 3) of the constraints between the bodies.
        multipliers: (k,) lambda.
    """
    r_i, theta_i, r_j, theta_j = (block.T @ multipliers for block in jacobian)
    return ConstraintWrench(
        joint, first, second, np.concatenate([r_i, theta_i]), np.concatenate([r_j, theta_j])
    )


def constraint_wrenches(
    system: Formulation, frames: Sequence[Frame], coordinates: Mapping[Key, Measured], multipliers: Array
) -> Iterator[ConstraintWrench]:
    """Yield the wrenches of joints with multipliers, then of couplings.

    Args:
        system: the equations of motion.
        frames: pose and velocity of each body.
        coordinates: all joint coordinates of couplings, with elements of q among them, by key (name of the
            joint, index of the coordinate). Slopes depend on their values only.
        multipliers: (rows,) Lagrange multipliers of joints and couplings.
    """
    row, index = 0, system.mechanism.joint_index
    for e in system.constrained:
        own_multipliers = multipliers[row : row + e.count]
        row += e.count
        blocks = e.jacobian(frames[e.first], frames[e.second])
        yield _wrench(index(e.joint.name), e.first, e.second, blocks, own_multipliers)
    # a coupling acts on each of its coordinates with the multiplier times its slope; coordinates that are
    # elements of q (joints of a tree) have no wrench here. `between` has the other coordinates, which are
    # computed from the poses of two bodies
    for coupling, multiplier in zip(system.couplings, multipliers[row:], strict=True):
        for key, slope in coupling.measured_slopes(coordinates).items():
            if key in system.between:
                between = system.between[key]
                blocks = between.constraint.jacobian(frames[between.first], frames[between.second])
                force = np.array([slope * multiplier])
                yield _wrench(index(key[0]), between.first, between.second, blocks, force)


def _arms(system: Formulation, frames: Sequence[Frame]) -> list[Array]:
    """Compute the vector (3,) from each second body's center of mass to its joint point, world frame, m.

    `poses` are the initial poses, in which joint points are given; `frames` are the present poses.
    """
    return [
        frames[e.second].rotation @ system.poses[e.second].point_to_body(e.joint.point_on_second)
        for e in system.equations
    ]


def at_joint_points(
    system: Formulation, frames: Sequence[Frame], wrenches: Iterable[ConstraintWrench]
) -> tuple[Array, Array]:
    """Sum wrenches by joint and refer them to the joint points.

    Args:
        system: the equations of motion.
        frames: pose and velocity of each body.
        wrenches: wrenches of constraints.

    Returns:
        Forces, N, and torques, N m, on the second bodies at the joint points, (j, 3) each, world frame.
    """
    arms = _arms(system, frames)
    forces: list[Array] = [np.zeros(3)] * len(arms)
    torques = list(forces)
    for pair in wrenches:
        force = pair.on_second[:3]
        forces[pair.joint] = forces[pair.joint] + force
        torques[pair.joint] = torques[pair.joint] + pair.on_second[3:] - cross(arms[pair.joint], force)
    return np.array(forces), np.array(torques)


def tree_reactions(
    system: TreeKinematics,
    frames: Sequence[Frame],
    coordinates: Mapping[Key, Measured],
    needed: Sequence[Array],
    multipliers: Array,
    joint_forces: Iterable[tuple[Key, Scalar]],
    couples: Iterable[tuple[tuple[int, int], Array]],
) -> tuple[Array, Array]:
    """Compute the reactions of all joints in the joint-coordinate form.

    Loop-closing joints have multipliers. The reactions of the joints in the spanning tree, which connects all
    bodies without loops, follow from the Newton-Euler equations of the bodies, from the leaves to the ground.

    Args:
        system: the equations of motion.
        frames: pose and velocity of each body.
        coordinates: see `constraint_wrenches`.
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
    wrenches = list(constraint_wrenches(system, frames, coordinates, multipliers))
    for pair in wrenches:
        need[pair.first] = need[pair.first] - pair.on_first
        need[pair.second] = need[pair.second] - pair.on_second
    forces, torques = (list(rows) for rows in at_joint_points(system, frames, wrenches))
    for (name, coordinate), u in joint_forces:
        number = mechanism.joint_index(name)
        e = system.equations[number]
        blocks = e.coordinates[coordinate].jacobian(frames[e.first], frames[e.second])
        pair = _wrench(number, e.first, e.second, blocks, np.array([u]))
        need[pair.first] = need[pair.first] - pair.on_first
        need[pair.second] = need[pair.second] - pair.on_second
    for (first, second), torque in couples:
        couple = np.concatenate([np.zeros(3), torque])
        need[first], need[second] = need[first] + couple, need[second] - couple
    # from the leaves to the ground: each joint exerts what its child needs, and the opposite on its parent
    arms = _arms(system, frames)
    for joint in reversed(tree.joints):  # `joint.joint` is the number of the joint
        force, torque = need[joint.child][:3], need[joint.child][3:]
        center = frames[joint.child].position
        at_parent = torque + cross(center - frames[joint.parent].position, force)
        need[joint.parent] = need[joint.parent] + np.concatenate([force, at_parent])
        if joint.joint >= len(mechanism.joints):
            # a rod (constant distance of two points) only closes loops. A body that only rods hold gets an
            # additional free joint, which has no reaction
            continue
        # the reaction acts on the joint's second body, which is the child only if the joint is `forward`
        sign = 1.0 if joint.forward else -1.0
        point = frames[system.equations[joint.joint].second].position + arms[joint.joint]
        forces[joint.joint] = sign * force
        torques[joint.joint] = sign * (torque - cross(point - center, force))
    return np.array(forces), np.array(torques)
