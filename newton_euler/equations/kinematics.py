"""Kinematics of a spanning tree over generic scalars, from the ground to the leaves."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from newton_euler.model.constraints import Frame
from newton_euler.model.euler_parameters import product, rotation
from newton_euler.model.mechanism import Mechanism
from newton_euler.model.spanning_tree import SpanningTree, TreeJoint
from newton_euler.scalars import Array, cos, cross, sin, tilde


@dataclass(frozen=True, eq=False)
class Link:
    """Kinematics of one body of the tree.

    Attributes:
        frame: pose and velocity; the rotation is that of the body's tree frame.
        acceleration, angular_acceleration: (3,) at qddot = 0: the velocity-product part.
        path: indices of the joint velocities that move the body.
        linear, angular: (3, len(path)) velocity transformation: v = linear @ qdot[path].
        orientation: (4,) the rotation as Euler parameters, continuous in the joint coordinates.
    """

    frame: Frame
    acceleration: Array
    angular_acceleration: Array
    path: list[int]
    linear: Array
    angular: Array
    orientation: Array


def turn(axis: Array, angle: Array) -> Array:
    """Rotation (3, 3) about a constant unit axis (Rodrigues)."""
    k = tilde(axis)
    return np.eye(3) + sin(angle) * k + (1.0 - cos(angle)) * (k @ k)


def tree_links(mechanism: Mechanism, tree: SpanningTree, q: Array, v: Array) -> list[Link]:
    """Kinematics of all bodies, ground first, at joint coordinates q (nq,) and velocities v (nv,)."""
    ground = mechanism.bodies[0]
    zero = np.zeros(3)
    frame, none = Frame(ground.center_of_mass, np.eye(3), zero, zero), np.zeros((3, 0))
    root = Link(frame, zero, zero, [], none, none, np.array([1.0, 0.0, 0.0, 0.0]))
    links: dict[int, Link] = {0: root}
    for joint in tree.joints:
        links[joint.child] = _child(mechanism, tree, joint, links[joint.parent], q[joint.q], v[joint.v])
    return [links[k] for k in range(len(mechanism.bodies))]


def _child(
    mechanism: Mechanism, tree: SpanningTree, joint: TreeJoint, parent: Link, q: Array, v: Array
) -> Link:
    """Kinematics of a joint's child, motion by motion from its parent."""
    r, a, velocity, omega = parent.frame
    acceleration, alpha = parent.acceleration, parent.angular_acceleration
    orientation = parent.orientation

    def move(s: Array) -> None:
        """Go from the present point to the one at s, fixed in the present frame."""
        nonlocal r, velocity, acceleration
        turning = cross(omega, s)
        r = r + s
        velocity = velocity + turning
        acceleration = acceleration + cross(alpha, s) + cross(omega, turning)

    here = joint.points[0] if joint.motions else tree.joint(joint.joint).reaction_point
    move(a @ (here - mechanism.bodies[joint.parent].center_of_mass))
    columns: list[tuple[Array, Array | None]] = []  # an axis, and the point it turns about
    iq = iv = 0
    for motion, point in zip(joint.motions, joint.points, strict=True):
        if np.any(point != here):
            move(a @ (point - here))
            here = point
        if motion.kind == "slide":
            axis = a @ motion.axis
            coriolis = 2.0 * cross(omega, axis * v[iv])
            move(axis * q[iq])
            velocity = velocity + axis * v[iv]
            acceleration = acceleration + coriolis
            columns.append((axis, None))
            iq, iv = iq + 1, iv + 1
        elif motion.kind == "hinge":
            axis = a @ motion.axis
            alpha = alpha + cross(omega, axis * v[iv])
            omega = omega + axis * v[iv]
            a = a @ turn(motion.axis, q[iq])
            half = 0.5 * q[iq]
            orientation = product(orientation, np.array([cos(half), *(sin(half) * motion.axis)]))
            columns.append((axis, r))
            iq, iv = iq + 1, iv + 1
        else:
            a = a @ rotation(q[iq : iq + 4])
            orientation = product(orientation, q[iq : iq + 4])
            relative = a @ v[iv : iv + 3]
            alpha = alpha + cross(omega, relative)
            omega = omega + relative
            columns.extend((a[:, k], r) for k in range(3))
            iq, iv = iq + 4, iv + 3
    move(a @ (mechanism.bodies[joint.child].center_of_mass - here))

    arm = r - parent.frame.position
    angular = list(parent.angular.T)
    linear = [
        column + cross(spin, arm) for column, spin in zip(parent.linear.T, parent.angular.T, strict=True)
    ]
    for axis, center in columns:
        angular.append(np.zeros(3) if center is None else axis)
        linear.append(axis if center is None else cross(axis, r - center))
    path = parent.path + list(range(joint.v.start, joint.v.stop))
    stack = (lambda rows: np.array(rows).T) if path else (lambda rows: np.zeros((3, 0)))
    frame = Frame(r, a, velocity, omega)
    return Link(frame, acceleration, alpha, path, stack(linear), stack(angular), orientation)
