"""Inertia of a spanning tree: its mass matrix M from composite bodies, and its factors from articulated ones.

Both go from the leaves to the ground, over generic scalars (Featherstone, Rigid Body Dynamics Algorithms,
2008, section 6.2, composite rigid bodies, and chapter 7, articulated bodies). M of n velocities in a row has
n^2 entries, and its elimination takes n^3 / 3 operations. Articulated bodies give the same pivots and
solutions in operations proportional to n, but more of them where few velocities move each body.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from newton_euler.equations.kinematics import Axis, Link
from newton_euler.equations.sparse import SINGULAR, Rows, add
from newton_euler.model.spanning_tree import SpanningTree
from newton_euler.scalars import Array, Scalar, cross, minimum, tilde

ARTICULATED = 130
"""Operations per axis that articulated bodies take beyond those that composite ones take, too."""

PAIR = 17
"""Operations for an entry of M; eliminating an axis below k others takes k^2 more."""


def is_deep(tree: SpanningTree) -> bool:
    """Test whether articulated bodies take fewer operations than composite ones."""
    above, composite = {0: 0}, 0  # velocities between the ground and a body
    for joint in tree.joints:
        first = above[joint.parent]
        above[joint.child] = first + joint.v.stop - joint.v.start
        composite += sum(k * (k + PAIR) for k in range(first, above[joint.child]))
    return composite > ARTICULATED * tree.nv


def symmetric(entry: Callable[[int, int], Scalar]) -> Array:
    """Compute a symmetric (3, 3) matrix from the entries of its upper triangle."""
    xx, xy, xz, yy, yz, zz = (entry(i, j) for i in range(3) for j in range(i, 3))
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


class RigidBody(NamedTuple):
    """Mass, kg, first moment of mass (3,), kg m, and inertia (3, 3), kg m^2, about a point."""

    mass: Scalar
    moment: Array
    inertia: Array

    def moved(self, d: Array) -> RigidBody:
        """Refer to the point from which the present one is at d (3,)."""
        h, (xx, xy, xz), (_, yy, yz), (_, _, zz) = self.moment, *self.inertia
        moment = h + self.mass * d
        x, y, z = d * (h + moment)
        xy = xy - (d[0] * moment[1] + h[0] * d[1])
        xz = xz - (d[0] * moment[2] + h[0] * d[2])
        yz = yz - (d[1] * moment[2] + h[1] * d[2])
        xx, yy, zz = xx + (y + z), yy + (x + z), zz + (x + y)
        return RigidBody(self.mass, moment, np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]))

    def joined(self, other: RigidBody) -> RigidBody:
        """Take another one about the same point into it."""
        return RigidBody(*(a + b for a, b in zip(self, other, strict=True)))

    def momenta(self, axis: Axis) -> tuple[Array, Array]:
        """Compute momentum and angular momentum (3,) at unit velocity of an axis through the point."""
        s = axis.direction
        if axis.turns:
            return cross(s, self.moment), self.inertia @ s
        return self.mass * s, cross(self.moment, s)


def mass_matrix(tree: SpanningTree, links: Sequence[Link], bodies: Sequence[RigidBody]) -> Rows:
    """Compute the nonzeros of M (nv, nv) from the bodies about their pivots.

    To an axis, the bodies beyond it are one rigid body. Its momenta at unit velocity, and those at unit
    velocities of all axes beyond, give a column of M.
    """
    none: tuple[list[int], Array, Array] = [], np.zeros((3, 0)), np.zeros((3, 0))
    composite, momenta = list(bodies), dict.fromkeys(range(len(bodies)), none)
    mass: Rows = [{} for _ in range(tree.nv)]
    for joint in reversed(tree.joints):
        body, (places, linear, angular) = composite[joint.child], momenta.pop(joint.child)
        link = links[joint.child]
        for axis in reversed(link.axes):
            body, angular = body.moved(axis.step), angular + cross(axis.step, linear)
            own = body.momenta(axis)
            places = [axis.place, *places]
            linear, angular = (np.column_stack(each) for each in zip(own, (linear, angular), strict=True))
            for j, entry in zip(places, axis.share(linear, angular), strict=True):
                add(mass[axis.place], j, entry)
                if j != axis.place:
                    add(mass[j], axis.place, entry)
        angular = angular + cross(link.offset, linear)
        composite[joint.parent] = composite[joint.parent].joined(body.moved(link.offset))
        siblings = momenta[joint.parent]
        momenta[joint.parent] = (
            siblings[0] + places,
            np.hstack([siblings[1], linear]),
            np.hstack([siblings[2], angular]),
        )
    return mass


class ArticulatedBody(NamedTuple):
    """Inertia about a point of a body that carries others on free axes.

    Attributes:
        linear: (3, 3) force for an acceleration of the point.
        coupling: (3, 3) force for an angular acceleration, its transpose torque for an acceleration.
        angular: (3, 3) torque for an angular acceleration.
    """

    linear: Array
    coupling: Array
    angular: Array

    @classmethod
    def rigid(cls, body: RigidBody) -> ArticulatedBody:
        """One that carries none."""
        return cls(body.mass * np.eye(3), -tilde(body.moment), body.inertia)

    def moved(self, d: Array) -> ArticulatedBody:
        """Refer to the point from which the present one is at d (3,)."""
        arm = tilde(d)
        coupling = self.coupling - self.linear @ arm
        one, other = arm @ coupling, arm @ self.coupling
        return ArticulatedBody(
            self.linear, coupling, symmetric(lambda i, j: self.angular[i, j] + (one[i, j] + other[j, i]))
        )

    def joined(self, other: ArticulatedBody) -> ArticulatedBody:
        """Take another one about the same point into it."""
        return ArticulatedBody(*(a + b for a, b in zip(self, other, strict=True)))

    def wrench(self, axis: Axis) -> tuple[Array, Array]:
        """Compute force and torque (3,) for a unit acceleration of an axis through the point."""
        s = axis.direction
        if axis.turns:
            return self.coupling @ s, self.angular @ s
        return self.linear @ s, s @ self.coupling

    def freed(self, force: Array, torque: Array, pivot_inverse: Scalar) -> ArticulatedBody:
        """Let the axis of this `wrench` move freely."""
        f, n = -pivot_inverse * force, -pivot_inverse * torque
        return ArticulatedBody(
            symmetric(lambda i, j: self.linear[i, j] + force[i] * f[j]),
            self.coupling + np.outer(force, n),
            symmetric(lambda i, j: self.angular[i, j] + torque[i] * n[j]),
        )


class TreeFactor:
    """L D L^T of a tree's M, axes eliminated from the leaves to the ground; L is applied, never formed.

    Attributes:
        pivots, pivot_ratio: as of `newton_euler.equations.sparse.Factor`.
    """

    def __init__(
        self,
        tree: SpanningTree,
        links: Sequence[Link],
        bodies: Sequence[RigidBody],
        rotors: Mapping[int, Scalar],
        scales: Sequence[float] | None,
    ) -> None:
        """Eliminate.

        Args:
            tree, links: the tree, and the kinematics of its bodies.
            bodies: about their pivots.
            rotors: what M has on its diagonal beyond the bodies, by place.
            scales: usual sizes of the pivots; None where these are unknown, and no ratio is asked for.
        """
        self._joints, self._links = tree.joints, links
        self.pivots: list[Any] = [0.0] * tree.nv
        self._inverse_pivots: list[Any] = [0.0] * tree.nv
        self._gains: dict[int, tuple[Array, Array]] = {}
        articulated = [ArticulatedBody.rigid(body) for body in bodies]
        self.pivot_ratio: Scalar = np.inf
        for joint in reversed(tree.joints):
            body = articulated[joint.child]
            for axis in reversed(links[joint.child].axes):
                body = body.moved(axis.step)
                wrench, k = body.wrench(axis), axis.place
                self.pivots[k] = pivot = axis.share(*wrench) + rotors.get(k, 0.0)
                self._inverse_pivots[k] = inverse = 1.0 / pivot
                self._gains[k] = wrench[0] * inverse, wrench[1] * inverse
                if scales is not None:
                    self.pivot_ratio = minimum(self.pivot_ratio, pivot / scales[k] - SINGULAR)
                body = body.freed(*wrench, inverse)
            moved = body.moved(links[joint.child].offset)
            articulated[joint.parent] = articulated[joint.parent].joined(moved)

    def lower(self, right: dict[int, Any]) -> dict[int, Any]:
        """Compute L^-1 b of a sparse b: forces on axes less those that axes beyond them hand on."""
        x = dict(right)
        wrenches: dict[int, tuple[Array, Array]] = {}
        for joint in reversed(self._joints):
            link = self._links[joint.child]
            if joint.child not in wrenches and not any(axis.place in x for axis in link.axes):
                continue
            force, torque = wrenches.pop(joint.child, (np.zeros(3), np.zeros(3)))
            for axis in reversed(link.axes):
                k, torque = axis.place, torque + cross(axis.step, force)
                add(x, k, -axis.share(force, torque))
                if k in x:
                    force, torque = force + self._gains[k][0] * x[k], torque + self._gains[k][1] * x[k]
            torque = torque + cross(link.offset, force)
            if joint.parent in wrenches:
                force, torque = force + wrenches[joint.parent][0], torque + wrenches[joint.parent][1]
            wrenches[joint.parent] = force, torque
        return x

    def scaled(self, x: dict[int, Any]) -> dict[int, Any]:
        """Compute D^-1 x."""
        return {k: value * self._inverse_pivots[k] for k, value in x.items()}

    def upper(self, right: dict[int, Any]) -> dict[int, Any]:
        """Compute L^-T b: accelerations of axes less those that follow from axes before them."""
        x = dict(right)
        zero = np.zeros(3)
        accelerations = {0: (zero, zero)}
        for joint in self._joints:
            link, (a, alpha) = self._links[joint.child], accelerations[joint.parent]
            a = a + cross(alpha, link.offset)
            for axis in link.axes:
                k = axis.place
                force, torque = self._gains[k]
                add(x, k, -(force @ a + torque @ alpha))
                if k in x:
                    share = axis.direction * x[k]
                    a, alpha = (a, alpha + share) if axis.turns else (a + share, alpha)
                a = a + cross(alpha, axis.step)
            accelerations[joint.child] = a, alpha
        return x
