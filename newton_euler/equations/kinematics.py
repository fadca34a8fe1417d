"""Kinematics of a scene in the coordinates of its spanning tree, over generic scalars.

Body by body from the ground to the leaves; then the constraints of the loops, Phi and their Jacobian. Body
frames are those of the tree: parallel to the world at the initial pose.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from newton_euler.equations.couplings import Coupling
from newton_euler.equations.formulation import Formulation
from newton_euler.equations.joint_coordinates import Measured
from newton_euler.equations.sparse import Rows, add
from newton_euler.model.constraints import Frame, Jacobian
from newton_euler.model.euler_parameters import product, rotation
from newton_euler.model.joint import Key
from newton_euler.model.mechanism import Mechanism
from newton_euler.model.scene import Scene
from newton_euler.model.spanning_tree import SpanningTree, TreeJoint
from newton_euler.model.state import State
from newton_euler.scalars import Array, cos, cross, sin, tilde


class Axis(NamedTuple):
    """The share of one joint velocity in the motion of a body, world frame.

    Attributes:
        place: of the velocity in v.
        turns: True for an angular velocity about the axis, False for a velocity along it.
        direction: (3,) unit vector.
        point: (3,) of the axis.
        step: (3,) from there to the point of the next axis, the last of its joint being the link's `pivot`.
    """

    place: int
    turns: bool
    direction: Array
    point: Array
    step: Array


class Pivot(NamedTuple):
    """The point of a body that its joint guides: (3,) position, velocity, and acceleration at qddot = 0."""

    position: Array
    velocity: Array
    acceleration: Array

    def moved(self, s: Array, omega: Array, alpha: Array) -> Pivot:
        """Go to the point at s (3,) of a body with this angular velocity and acceleration (3,)."""
        position, velocity, acceleration = self
        turning = cross(omega, s)
        acceleration = acceleration + cross(alpha, s) + cross(omega, turning)
        return Pivot(position + s, velocity + turning, acceleration)


@dataclass(frozen=True, eq=False)
class Link:
    """Kinematics of one body of the tree.

    Attributes:
        frame: pose and velocity; the rotation is that of the body's tree frame.
        acceleration, angular_acceleration: (3,) at qddot = 0: the velocity-product part.
        orientation: (4,) the rotation as Euler parameters, continuous in the joint coordinates.
        pivot: of the body.
        offset: (3,) from the parent's pivot to the joint's first axis.
        arm: (3,) from the pivot to the center of mass.
        axes: of the joint, in order.
        moved_by: the axes of all joints between the ground and the body.
    """

    frame: Frame
    acceleration: Array
    angular_acceleration: Array
    orientation: Array
    pivot: Pivot
    offset: Array
    arm: Array
    axes: list[Axis]
    moved_by: list[Axis]

    @cached_property
    def path(self) -> list[int]:
        """Indices of the joint velocities that move the body."""
        return [axis.place for axis in self.moved_by]

    @cached_property
    def linear(self) -> Array:
        """(3, len(path)) velocity transformation of the center of mass: v = linear @ qdot[path]."""
        along = _columns([np.zeros(3) if axis.turns else axis.direction for axis in self.moved_by])
        points = _columns([axis.point for axis in self.moved_by])
        return cross(self.angular, self.frame.position[:, None] - points) + along

    @cached_property
    def angular(self) -> Array:
        """(3, len(path)) velocity transformation of the rotation: omega = angular @ qdot[path]."""
        return _columns([axis.direction if axis.turns else np.zeros(3) for axis in self.moved_by])


def _columns(vectors: list[Array]) -> Array:
    return np.array(vectors).T if vectors else np.zeros((3, 0))


def rotation_about(axis: Array, angle: Array) -> Array:
    """Compute the rotation (3, 3) about a constant unit axis (Rodrigues)."""
    k = tilde(axis)
    return np.eye(3) + sin(angle) * k + (1.0 - cos(angle)) * (k @ k)


def pivot_points(mechanism: Mechanism, tree: SpanningTree) -> list[Array]:
    """Compute where the bodies' pivots (3,) are at the initial pose, the centers of those without an axis."""
    points = [body.center_of_mass for body in mechanism.bodies]
    for joint in tree.joints:
        points[joint.child] = joint.points[-1] if joint.points else points[joint.child]
    return points


def tree_links(mechanism: Mechanism, tree: SpanningTree, q: Array, v: Array) -> list[Link]:
    """Compute the kinematics of all bodies, ground first, at q (nq,) and v (nv,)."""
    ground = mechanism.bodies[0].center_of_mass
    zero = np.zeros(3)
    frame = Frame(ground, np.eye(3), zero, zero)
    none = np.array([1.0, 0.0, 0.0, 0.0])
    links = {0: Link(frame, zero, zero, none, Pivot(ground, zero, zero), zero, zero, [], [])}
    pivots = pivot_points(mechanism, tree)
    for joint in tree.joints:
        pivot = pivots[joint.child]
        points = [*joint.points, pivot]
        offset = points[0] - pivots[joint.parent]
        steps = [after - before for before, after in pairwise(points)]
        arm = mechanism.bodies[joint.child].center_of_mass - pivot
        links[joint.child] = _child(joint, links[joint.parent], offset, steps, arm, q[joint.q], v[joint.v])
    return [links[k] for k in range(len(mechanism.bodies))]


def _child(
    joint: TreeJoint, parent: Link, offset: Array, steps: list[Array], arm: Array, q: Array, v: Array
) -> Link:
    """Compute the kinematics of a joint's child, axis by axis from its parent.

    `offset`, `steps` between points and `arm` are those of `Link` and `Axis` at the initial pose.
    """
    a, omega = parent.frame.rotation, parent.frame.angular_velocity
    alpha, orientation = parent.angular_acceleration, parent.orientation
    offset = a @ offset
    pivot = parent.pivot.moved(offset, omega, alpha)
    axes: list[Axis] = []
    iq, iv = 0, joint.v.start
    for motion, between in zip(joint.motions, steps, strict=True):
        if motion.kind == "slide":
            direction, rate = a @ motion.axis, v[iv - joint.v.start]
            coriolis = 2.0 * cross(omega, direction * rate)
            step = a @ between + direction * q[iq]
            axes.append(Axis(iv, False, direction, pivot.position, step))
            r, velocity, acceleration = pivot.moved(step, omega, alpha)
            pivot = Pivot(r, velocity + direction * rate, acceleration + coriolis)
            iq, iv = iq + 1, iv + 1
            continue
        if motion.kind == "hinge":
            directions = [a @ motion.axis]
            relative = directions[0] * v[iv - joint.v.start]
            a = a @ rotation_about(motion.axis, q[iq])
            half = 0.5 * q[iq]
            orientation = product(orientation, np.array([cos(half), *(sin(half) * motion.axis)]))
            iq += 1
        else:
            a = a @ rotation(q[iq : iq + 4])
            orientation = product(orientation, q[iq : iq + 4])
            directions = list(a.T)
            relative = a @ v[iv - joint.v.start : iv - joint.v.start + 3]
            iq += 4
        alpha = alpha + cross(omega, relative)
        omega = omega + relative
        step = a @ between
        for k, direction in enumerate(directions, start=1):
            last = k == len(directions)
            axes.append(Axis(iv, True, direction, pivot.position, step if last else np.zeros(3)))
            iv += 1
        pivot = pivot.moved(step, omega, alpha)
    arm = a @ arm
    center = pivot.moved(arm, omega, alpha)
    frame = Frame(center.position, a, center.velocity, omega)
    moved_by = parent.moved_by + axes
    return Link(frame, center.acceleration, alpha, orientation, pivot, offset, arm, axes, moved_by)


def drift(jacobian: Jacobian, first: Link, second: Link) -> Array:
    """Compute Phi_r a0 + Phi_theta alpha0 (k,), the second rate of constraints at qddot = 0."""
    return np.asarray(
        jacobian.r_first @ first.acceleration
        + jacobian.theta_first @ first.angular_acceleration
        + jacobian.r_second @ second.acceleration
        + jacobian.theta_second @ second.angular_acceleration
    )


class TreeKinematics(Formulation):
    """Kinematics of a scene: q (nq,) and v (nv,) are those of a spanning tree.

    Attributes:
        tree: the spanning tree; the joints that it cuts are `constrained`.
    """

    def __init__(self, scene: Scene, alpha: float = 0.0) -> None:
        """`alpha`, 1/s, gives Baumgarte's gains of the loops; none for 0."""
        self.tree = tree = SpanningTree(scene.mechanism)
        equations = [tree.equations(k) for k in range(len(scene.mechanism.joints))]
        closures = [equations[k] for k in tree.cuts]
        super().__init__(scene, alpha, tree.poses, equations, closures, tree.nq, tree.nv)
        self.inertias = [
            a0 @ body.inertia @ a0.T
            for a0, body in zip(tree.initial_rotations, self.mechanism.bodies, strict=True)
        ]
        self.masses = [body.mass for body in self.mechanism.bodies]
        self.pivot_points = pivot_points(self.mechanism, tree)
        self.pivot_inertias = [
            inertia + body.mass * (s @ s * np.eye(3) - np.outer(s, s))
            for body, inertia, s in zip(
                self.mechanism.bodies,
                self.inertias,
                [b.center_of_mass - x for b, x in zip(self.mechanism.bodies, self.pivot_points, strict=True)],
                strict=True,
            )
        ]
        self.velocity_units = tree.velocity_units
        self.quaternions = [on_q for motion, on_q, _ in tree.motions if motion.kind == "ball"]

    @property
    def uncounted_angles(self) -> list[int]:
        """Places in q of angles of hinges whose revolutions nothing counts."""
        counted = set(self.angles.values())
        hinges = [on_q.start for motion, on_q, _ in self.tree.motions if motion.kind == "hinge"]
        return [place for place in hinges if place not in counted]

    # Bodies

    def links(self, q: Array, v: Array) -> list[Link]:
        """Compute the kinematics of all bodies, ground first."""
        return self.remembered(q, v, lambda q, v: tree_links(self.mechanism, self.tree, q, v))

    def frames(self, q: Array, v: Array) -> list[Frame]:
        """Compute the frames of all bodies, ground first."""
        return [link.frame for link in self.links(q, v)]

    def orientations(self, q: Array, v: Array) -> list[Array]:
        """Compute Euler parameters (4,) of all bodies, ground first, continuous in q."""
        bodies = zip(self.links(q, v), self.mechanism.bodies, strict=True)
        return [product(link.orientation, body.quaternion) for link, body in bodies]

    def velocity_transformation(self, q: Array) -> Array:
        """Compute v and omega of body 0, 1, ... for each joint velocity, (6 b, nv)."""
        links = self.links(q, np.zeros(self.nv))
        rows = np.zeros((len(links), 6, self.nv))
        for body, link in enumerate(links):
            rows[body][:, link.path] = np.concatenate([link.linear, link.angular])
        return rows.reshape(6 * len(links), self.nv)

    def project(self, jacobian: Jacobian, first: Link, second: Link) -> Rows:
        """Project a Jacobian between two bodies onto joint velocities: J = Phi_r V + Phi_theta W."""
        r_i, theta_i, r_j, theta_j = jacobian
        rows: Rows = [{} for _ in r_i]
        for link, block in (
            (first, r_i @ first.linear + theta_i @ first.angular),
            (second, r_j @ second.linear + theta_j @ second.angular),
        ):
            for row, entries in zip(rows, block, strict=True):
                for k, entry in zip(link.path, entries, strict=True):
                    add(row, k, entry)
        return rows

    # Coordinates

    def place(self, key: Key) -> tuple[int, int] | None:
        """Find where a joint coordinate is in q and in v; None if the tree cuts its joint."""
        return self.tree.place(*key)

    def own_coordinates(self, state: State) -> tuple[Array, Array]:
        """Compute the joint coordinates and velocities of the tree in a state."""
        return self.tree.coordinates(state)

    def own_rate(self, q: Array, v: Array) -> Array:
        """Compute the rates of the joint coordinates of the tree."""
        return self.tree.rate(q, v)

    def own_retract(self, q: Array, step: Array) -> Array:
        """Move the joint coordinates of the tree by a small step (nv,); quaternions come out with norm 1."""
        return self.tree.retract(q, step)

    def measured(self, q: Array, v: Array) -> dict[Key, Measured]:
        """Compute the joint coordinates that something acts on, their Jacobians as rows over v."""
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
        """Compute Phi (k,) of loop closures and couplings, and the nonzeros of J (k, nv)."""
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
        """Compute the nonzeros of a coupling's row of J."""
        row: dict[int, Any] = {}
        for key, factor in coupling.factors.items():
            for k, entry in measured[key].jacobian.items():
                add(row, k, factor * entry)
        return row

    def joint_phi(self, q: Array) -> Array:
        """Compute the residuals of all joints, kept ones included, and of the couplings."""
        frames, measured = self.frames(q, np.zeros(self.nv)), self.measured(q, np.zeros(self.nv))
        phis = [e.phi(frames[e.first], frames[e.second]) for e in self.equations]
        coupled = [coupling.phi(measured, self.time) for coupling in self.couplings]
        return np.concatenate([np.zeros(0), *phis, coupled])

    def rows_of(self, relative: Collection[int]) -> list[int]:
        """Select rows of `phi`: these."""
        return sorted(relative)

    def row_scales(self, q: Array) -> Array:
        """Compute natural magnitudes (k,) of the dimensionless rows of the Jacobian, to decide on their rank.

        A row of a loop is the difference of the motions that its two branches give to the bodies that it
        joins. Its magnitude is the largest of these contributions, so that a row in which they cancel counts
        as small; that of a coupling is its own length.
        """
        links = self.links(q, np.zeros(self.nv))
        scales: list[float] = []
        for closure in self.constrained:
            first, second = links[closure.first], links[closure.second]
            r_i, theta_i, r_j, theta_j = (
                np.linalg.norm(block, axis=1) for block in closure.jacobian(first.frame, second.frame)
            )
            largest = np.zeros(closure.count)
            for link, other, r, theta in ((first, second, r_i, theta_i), (second, first, r_j, theta_j)):
                own = [n for n, k in enumerate(link.path) if k not in other.path]
                units = self.velocity_units[[link.path[n] for n in own]]
                linear = np.linalg.norm(link.linear[:, own], axis=0) * units
                angular = np.linalg.norm(link.angular[:, own], axis=0) * units
                share = np.outer(r, linear) + np.outer(theta, angular)
                largest = np.maximum(largest, np.max(share, axis=1, initial=0.0))
            scales.extend(largest / closure.units(self.mechanism.size))
        measured = self.measured(q, np.zeros(self.nv))
        for coupling, unit in zip(self.couplings, self.phi_units[len(scales) :], strict=True):
            row = self.coupled_row(coupling, measured)
            scales.append(
                float(np.sqrt(sum((x * self.velocity_units[k] / unit) ** 2 for k, x in row.items())))
            )
        return np.array([scale or 1.0 for scale in scales])
