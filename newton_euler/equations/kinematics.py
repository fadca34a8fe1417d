"""Forward kinematics of a scene in the coordinates of its spanning tree, and the constraints of its loops.

A spanning tree connects all bodies by joints without loops; the remaining joints close loops and are called
cut. The poses, velocities and accelerations of the bodies are computed from the ground to the leaves. Then
follow the residuals Phi of the loop-closing joints and their Jacobian. The coordinates q and velocities v are
those of the tree's joints. A joint is a series of elementary motions (hinges, slides, a ball); a ball has a
quaternion in q, and the relative angular velocity in v. Each element of v has an axis. Body frames are
parallel to the world at the initial pose. All functions accept floats, or symbolic scalars when the equations
are traced for compilation.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, assert_never

import numpy as np

from newton_euler.equations.articulated import Axis
from newton_euler.equations.couplings import Coupling, Measured
from newton_euler.equations.formulation import Formulation
from newton_euler.equations.sparse import Rows, add
from newton_euler.model.constraints import Frame, Jacobian
from newton_euler.model.euler_parameters import product, rotation
from newton_euler.model.joint import Key
from newton_euler.model.mechanism import Mechanism
from newton_euler.model.scene import Scene
from newton_euler.model.spanning_tree import SpanningTree, TreeJoint
from newton_euler.model.state import State
from newton_euler.scalars import Array, cos, cross, sin, tilde


@dataclass(frozen=True, eq=False)
class Link:
    """Kinematics of one body of the tree.

    Attributes:
        frame: pose and velocity of the center of mass and of the body frame, in the world frame.
        acceleration: (3,) of the center of mass, m/s^2, for the joint accelerations given to `tree_links`.
        angular_acceleration: (3,) rad/s^2, for the same joint accelerations.
        path: indices in v of the joint velocities that move the body, from the ground to the body.
        axes: axes of these velocities, in the same order.
        lever: (3,) from the point of the last axis to the center of mass, world frame, m.
        orientation: (4,) rotation since the initial pose as a quaternion (w, x, y, z), continuous in the
            joint coordinates.
    """

    frame: Frame
    acceleration: Array
    angular_acceleration: Array
    path: list[int]
    axes: list[Axis]
    lever: Array
    orientation: Array

    @cached_property
    def linear(self) -> Array:
        """Matrix (3, len(path)) from joint velocities to the velocity of the center of mass."""
        columns, lever = list[Array](), self.lever
        for axis in reversed(self.axes):
            columns.append(axis.direction if axis.slides else cross(axis.direction, lever))
            lever = axis.arm + lever  # from the point of the axis before to the center of mass
        return np.array(columns[::-1]).T if columns else np.zeros((3, 0))

    @cached_property
    def angular(self) -> Array:
        """Matrix (3, len(path)) from joint velocities to the angular velocity."""
        columns = [np.zeros(3) if axis.slides else axis.direction for axis in self.axes]
        return np.array(columns).T if columns else np.zeros((3, 0))


def rotation_about(axis: Array, angle: Array) -> Array:
    """Compute the rotation matrix (3, 3) of an angle, rad, about a unit axis (3,), by Rodrigues' formula."""
    k = tilde(axis)
    return np.eye(3) + sin(angle) * k + (1.0 - cos(angle)) * (k @ k)


def tree_links(mechanism: Mechanism, tree: SpanningTree, q: Array, v: Array, vdot: Array) -> list[Link]:
    """Compute the kinematics of all bodies, ground first.

    Args:
        mechanism: bodies and joints.
        tree: spanning tree of the mechanism.
        q: (nq,) coordinates of the tree.
        v: (nv,) velocities of the tree.
        vdot: (nv,) accelerations of the tree.
    """
    ground = mechanism.bodies[0]
    zero = np.zeros(3)
    frame = Frame(ground.center_of_mass, np.eye(3), zero, zero)
    root = Link(
        frame=frame,
        acceleration=zero,
        angular_acceleration=zero,
        path=[],
        axes=[],
        lever=zero,
        orientation=np.array([1.0, 0.0, 0.0, 0.0]),
    )
    links: dict[int, Link] = {0: root}
    for joint in tree.joints:
        motion = q[joint.q], v[joint.v], vdot[joint.v]
        links[joint.child] = _child(mechanism, tree, joint, links[joint.parent], *motion)
    return [links[k] for k in range(len(mechanism.bodies))]


def _child(
    mechanism: Mechanism, tree: SpanningTree, joint: TreeJoint, parent: Link, q: Array, v: Array, vdot: Array
) -> Link:
    """Compute the kinematics of a joint's child from those of its parent.

    A point and a frame travel from the parent's center of mass through all elementary motions of the joint to
    the child's center of mass. Their position, velocity and acceleration are updated on the way.

    Args:
        mechanism, tree: the bodies and the spanning tree.
        joint: the joint of the tree, with its elementary motions and the point of each.
        parent: kinematics of the parent.
        q, v, vdot: coordinates of this joint, their velocities and accelerations.
    """
    # of the traveling point r and frame a: position, rotation, velocity, angular velocity, accelerations
    r, a, velocity, omega = parent.frame
    acceleration, alpha = parent.acceleration, parent.angular_acceleration
    orientation = parent.orientation
    # sections of the path of the point, world frame: from the last axis before the joint to its first motion,
    # from each motion to the next, and from the last motion to the child's center of mass
    sections = [parent.lever]

    def move(s: Array) -> None:
        """Move the point by a vector s (3,), world frame, that is fixed in the present frame."""
        nonlocal r, velocity, acceleration
        velocity_change = cross(omega, s)
        r, sections[-1] = r + s, sections[-1] + s
        velocity = velocity + velocity_change
        acceleration = acceleration + cross(alpha, s) + cross(omega, velocity_change)

    # from the parent's center of mass to the first motion's point. Points are in the world at the initial
    # pose; they are those of the joint's second body. `gap` is the vector to them from the points of the
    # joint's first body, which is the parent if the joint is `forward`, else the child
    reached = joint.points[0] if joint.motions else tree.joint(joint.joint).point_on_second
    gap = tree.joint(joint.joint).point_gap
    move(a @ (reached - (gap if joint.forward else 0.0) - mechanism.bodies[joint.parent].center_of_mass))
    # motion by motion; iq and iv are the indices of the motion in q and v of this joint
    directions: list[tuple[Array, bool]] = []  # (direction, True for a slide) of each axis
    iq = iv = 0
    for motion, point in zip(joint.motions, joint.points, strict=True):
        if np.any(point != reached):
            move(a @ (point - reached))
            reached = point
        sections.append(np.zeros(3))
        if motion.kind == "slide":
            axis = a @ motion.axis
            coriolis = 2.0 * cross(omega, axis * v[iv])
            move(axis * q[iq])
            velocity = velocity + axis * v[iv]
            acceleration = acceleration + coriolis + axis * vdot[iv]
            directions.append((axis, True))
            iq, iv = iq + 1, iv + 1
        elif motion.kind == "hinge":
            axis = a @ motion.axis
            alpha = alpha + cross(omega, axis * v[iv]) + axis * vdot[iv]
            omega = omega + axis * v[iv]
            a = a @ rotation_about(motion.axis, q[iq])
            half = 0.5 * q[iq]
            orientation = product(orientation, np.array([cos(half), *(sin(half) * motion.axis)]))
            directions.append((axis, False))
            iq, iv = iq + 1, iv + 1
        elif motion.kind == "ball":
            a = a @ rotation(q[iq : iq + 4])
            orientation = product(orientation, q[iq : iq + 4])
            relative = a @ v[iv : iv + 3]
            alpha = alpha + cross(omega, relative) + a @ vdot[iv : iv + 3]
            omega = omega + relative
            # three axes through one point: those of the child's frame, in which v is given
            directions.extend((a[:, k], False) for k in range(3))
            sections.extend([np.zeros(3), np.zeros(3)])
            iq, iv = iq + 4, iv + 3
        else:
            assert_never(motion.kind)
    # from the last motion's point to the child's center of mass
    move(a @ (mechanism.bodies[joint.child].center_of_mass - (reached - (0.0 if joint.forward else gap))))

    # arms: vectors from the point of each axis to the next, and from the last one to the center of mass. The
    # point of a slide is free; it is chosen at the point of the next axis or at the center of mass, so that
    # the arm to a slide includes the section after the slide. `arms` is filled from the child to the parent
    arms, arm = list[Array](), sections[-1]
    for (_, slides), section in zip(reversed(directions), reversed(sections[:-1]), strict=True):
        arms.append(np.zeros(3) if slides else arm)
        arm = section + arm if slides else section
    arms = [*arms, arm][::-1]
    axes = [Axis(*direction, arm) for direction, arm in zip(directions, arms[:-1], strict=True)]
    path = parent.path + list(range(joint.v.start, joint.v.stop))
    return Link(
        frame=Frame(r, a, velocity, omega),
        acceleration=acceleration,
        angular_acceleration=alpha,
        path=path,
        axes=parent.axes + axes,
        lever=arms[-1],
        orientation=orientation,
    )


def drift(jacobian: Jacobian, first: Link, second: Link) -> Array:
    """Compute the part of the second time derivative of constraints that comes from body accelerations.

    Args:
        jacobian: Jacobian blocks (k, 3) of the constraints between two bodies.
        first, second: kinematics of the bodies.

    Returns:
        Phi_r a + Phi_theta alpha (k,), with the accelerations a and alpha of the links. For links at zero
        joint accelerations, this is the velocity-dependent part.
    """
    return np.asarray(
        jacobian.r_first @ first.acceleration
        + jacobian.theta_first @ first.angular_acceleration
        + jacobian.r_second @ second.acceleration
        + jacobian.theta_second @ second.angular_acceleration
    )


class TreeKinematics(Formulation):
    """Kinematics and constraints of a scene in the coordinates q and velocities v of a spanning tree.

    Attributes:
        tree: the spanning tree; the joints outside the tree close loops and are `constrained`.

    Methods `own_` are about the tree's coordinates and velocities only. The base class appends angles of
    loop-closing joints, and the work of the forces, to q. A key (joint, number) names a joint coordinate.
    """

    def __init__(self, scene: Scene, alpha: float = 0.0) -> None:
        """Build the spanning tree of a scene, with the loop-closing joints as constraints.

        Args:
            scene: the scene.
            alpha: 1/s, Baumgarte's parameter for the loops; 0 for no stabilization.
        """
        self.tree = tree = SpanningTree(scene.mechanism)
        equations = [tree.equations(k) for k in range(len(scene.mechanism.joints))]
        closures = [equations[k] for k in tree.cuts]
        super().__init__(scene, alpha, tree.poses, equations, constrained=closures, nq=tree.nq, nv=tree.nv)
        # inertias in the tree's body frames, which are parallel to the world at the initial pose
        self.inertias = [
            a0 @ body.inertia @ a0.T
            for a0, body in zip(tree.initial_rotations, self.mechanism.bodies, strict=True)
        ]
        self.velocity_units, self.coordinate_units = tree.velocity_units, tree.coordinate_units
        self.quaternions = tree.quaternions

    @property
    def uncounted_angles(self) -> list[int]:
        """Indices in q of the hinge angles whose full revolutions have no effect.

        Revolutions have an effect, and are counted, if forces or couplings depend on the angle.
        """
        counted = set(self.angles.values())  # indices in q
        hinges = [on_q.start for motion, on_q, _ in self.tree.motions if motion.kind == "hinge"]
        return [place for place in hinges if place not in counted]

    # Bodies

    def links(self, q: Array, v: Array) -> list[Link]:
        """Compute the kinematics of all bodies, ground first, at zero joint accelerations.

        Results for recent states are kept.
        """
        vdot = np.zeros(self.nv)
        return self.remembered(q, v, lambda q, v: tree_links(self.mechanism, self.tree, q, v, vdot))

    def frames(self, q: Array, v: Array) -> list[Frame]:
        """Compute pose and velocity of all bodies, ground first."""
        return [link.frame for link in self.links(q, v)]

    def orientations(self, q: Array, v: Array) -> list[Array]:
        """Compute the quaternions (4,), (w, x, y, z), of all bodies, ground first, continuous in q."""
        bodies = zip(self.links(q, v), self.mechanism.bodies, strict=True)
        return [product(link.orientation, body.quaternion) for link, body in bodies]

    def velocity_transformation(self, q: Array) -> Array:
        """Compute the matrix (6 b, nv) from v to the linear and angular velocity of bodies 0, 1, ..."""
        links = self.links(q, np.zeros(self.nv))
        rows = np.zeros((len(links), 6, self.nv))
        for body, link in enumerate(links):
            rows[body][:, link.path] = np.concatenate([link.linear, link.angular])
        return rows.reshape(6 * len(links), self.nv)

    def project(self, jacobian: Jacobian, first: Link, second: Link) -> Rows:
        """Convert a Jacobian between two bodies to sparse rows over joint velocities: Phi_r V + Phi_theta W.

        V and W are the matrices from joint velocities to velocities and angular velocities of the bodies. A
        joint that moves both bodies moves them as one rigid body. Its entry is nonzero only if the residual
        depends on the orientation of this body. For example, the residual of a ball joint whose points do not
        coincide has world components, which turn.

        Args:
            jacobian: Jacobian blocks (k, 3) of constraints between the bodies.
            first, second: kinematics of the bodies.
        """
        r_i, theta_i, r_j, theta_j = jacobian
        rows: Rows = [{} for _ in r_i]
        # joints that move both bodies are at the beginning of both paths
        shared = sum(i == j for i, j in zip(first.path, second.path, strict=False))
        as_one = theta_i + theta_j - r_j @ tilde(second.frame.position - first.frame.position)
        own = slice(shared, None)
        for path, block in (
            (first.path[:shared], as_one @ first.angular[:, :shared]),
            (first.path[own], r_i @ first.linear[:, own] + theta_i @ first.angular[:, own]),
            (second.path[own], r_j @ second.linear[:, own] + theta_j @ second.angular[:, own]),
        ):
            for row, entries in zip(rows, block, strict=True):
                for k, entry in zip(path, entries, strict=True):
                    add(row, k, entry)
        return rows

    # Coordinates

    def place(self, key: Key) -> tuple[int, int] | None:
        """Return the indices of a joint coordinate in q and in v; None for a loop-closing joint."""
        return self.tree.place(*key)

    def own_coordinates(self, state: State) -> tuple[Array, Array]:
        """Compute q and v of the spanning tree at a state."""
        return self.tree.coordinates(state)

    def own_rate(self, q: Array, v: Array) -> Array:
        """Compute dq/dt of the spanning tree."""
        return self.tree.rate(q, v)

    def own_retract(self, q: Array, step: Array) -> Array:
        """Return q of the spanning tree moved by a small step (nv,), with quaternions of norm 1."""
        return self.tree.retract(q, step)

    def measured(self, q: Array, v: Array) -> dict[Key, Measured]:
        """Compute the joint coordinates that forces, couplings and armatures (rotor inertias) depend on.

        Returns:
            By key: coordinate x, rate, sparse row of the Jacobian over v, and gamma, with
            d2x/dt2 = row . vdot - gamma. Coordinates of the tree are elements of q; those of loop-closing
            joints are measured between two bodies.
        """
        links, frames = self.links(q, v), self.frames(q, v)
        found = {}
        for key, place in self.places.items():
            if place is not None:
                found[key] = Measured(q[place[0]], v[place[1]], {place[1]: 1.0}, 0.0)
            else:
                between = self.between[key]
                x, rate, jacobian, gamma = between.measure(q, frames)
                first, second = links[between.first], links[between.second]
                row = self.project(jacobian, first, second)[0]
                found[key] = Measured(x, rate, row, gamma - drift(jacobian, first, second)[0])
        return found

    # Constraints

    def phi_and_jacobian(self, q: Array) -> tuple[Array, Rows]:
        """Compute the residuals Phi (k,) of loop closures and couplings, and the sparse rows of J (k, nv)."""
        v = np.zeros(self.nv)
        links, phis, rows = self.links(q, v), [np.zeros(0)], list[dict[int, Any]]()
        for closure in self.constrained:
            first, second = links[closure.first], links[closure.second]
            blocks = closure.jacobian(first.frame, second.frame)
            phis.append(closure.phi(first.frame, second.frame))
            rows.extend(self.project(blocks, first, second))
        measured = self.measured(q, v)
        for coupling in self.couplings:
            phis.append(np.array([coupling.phi(measured, self.time)]))
            rows.append(self.coupled_row(coupling, measured))
        return np.concatenate(phis), rows

    def coupled_row(self, coupling: Coupling, measured: Mapping[Key, Measured]) -> dict[int, Any]:
        """Compute the sparse row of the constraint Jacobian that belongs to a coupling."""
        row: dict[int, Any] = {}
        for key, slope in coupling.measured_slopes(measured).items():
            for k, entry in measured[key].jacobian.items():
                add(row, k, slope * entry)
        return row

    def rows_of(self, relative: Collection[int]) -> list[int]:
        """Return the given row numbers in ascending order.

        Row numbers count the rows in joint coordinates; only the Cartesian formulation translates them.
        """
        return sorted(relative)

    def closing_rows(self) -> list[int]:
        """Return all row numbers: each row here closes a loop or belongs to a coupling."""
        return list(range(len(self.phi_units)))

    def row_scales(self, q: Array) -> Array:
        """Compute the natural magnitude (k,) of each dimensionless row of the Jacobian, for rank decisions.

        A row of a loop is the difference of the motions of two bodies. Its magnitude is the largest motion
        that one joint gives to one of these bodies. A row in which the two motions cancel, as redundant rows
        do, is then small relative to its magnitude. The magnitude of a coupling's row is the root of the sum
        of squares of its coordinates' magnitudes times their slopes (derivatives of the coupling with respect
        to the coordinates). A row without any motion has magnitude 1.
        """
        links = self.links(q, np.zeros(self.nv))
        scales: list[float] = []
        for closure in self.constrained:
            blocks = closure.jacobian(links[closure.first].frame, links[closure.second].frame)
            reach = self._reach(blocks, links[closure.first], links[closure.second])
            scales.extend(x or 1.0 for x in reach / closure.units(self.mechanism.size))
        measured = self.measured(q, np.zeros(self.nv))
        for coupling, unit in zip(self.couplings, self.phi_units[len(scales) :], strict=True):
            parts = [
                slope * self._coordinate_reach(key, links) / unit
                for key, slope in coupling.measured_slopes(measured).items()
            ]
            scales.append(float(np.linalg.norm(parts)) or 1.0)
        return np.array(scales)

    def _reach(self, blocks: Jacobian, first: Link, second: Link) -> Array:
        """Compute the largest rate (k,), m/s or rad/s, that one unit velocity gives to each constraint row.

        The motions of the two bodies are examined separately. A joint that moves both bodies is ignored.

        Args:
            blocks: Jacobian blocks (k, 3) of the constraints.
            first, second: kinematics of the bodies.
        """
        r_i, theta_i, r_j, theta_j = (np.linalg.norm(block, axis=1) for block in blocks)
        largest = np.zeros(len(r_i))
        for link, other, r, theta in ((first, second, r_i, theta_i), (second, first, r_j, theta_j)):
            # places in the path of the joint velocities that move this body only
            only = [n for n, k in enumerate(link.path) if k not in other.path]
            units = self.velocity_units[[link.path[n] for n in only]]
            linear = np.linalg.norm(link.linear[:, only], axis=0) * units
            angular = np.linalg.norm(link.angular[:, only], axis=0) * units
            rates = np.outer(r, linear) + np.outer(theta, angular)  # (k, joint velocities)
            largest = np.maximum(largest, np.max(rates, axis=1, initial=0.0))
        return largest

    def _coordinate_reach(self, key: Key, links: Sequence[Link]) -> float:
        """Compute the largest rate of a joint coordinate that one unit velocity causes, m/s or rad/s.

        If no joint moves the two bodies relative to each other, the result is the unit of the coordinate.
        """
        place = self.places[key]
        if place is not None:
            return float(self.velocity_units[place[1]])
        between = self.between[key]
        first, second = links[between.first], links[between.second]
        blocks = between.constraint.jacobian(first.frame, second.frame)
        unit = self.mechanism.size if between.constraint.is_length else 1.0
        return float(self._reach(blocks, first, second)[0]) or unit
