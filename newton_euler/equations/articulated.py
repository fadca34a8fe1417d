"""Recursions over the axes of a tree of bodies: inverse dynamics, the mass matrix M and its factor.

Each joint velocity of the tree has an axis. Velocities are numbered from the ground to the leaves. Each axis
has a point, which lies on the axis of a hinge. Spatial vectors are about these points, in the world frame: a
wrench (6,) is (force, torque), a motion (6,) is (linear, angular). The recursions are those of
R. Featherstone, Rigid Body Dynamics Algorithms, Springer 2008:

    rnea_backward   wrenches on bodies, projected onto velocities                       section 5.3
    crba            M, by composite rigid bodies                                        section 6.2
    factorize       M = L D L^T, leaves first, by articulated bodies                    section 7.3

In articulated bodies all joints beyond an axis are free to move. An axis s whose articulated body has the
inertia I has the pivot d = s . U with U = I s, and the inertia I - U U^T / d goes to the axis before. L and D
are those of an elimination of M in joint coordinates, since the factor for an order of elimination is unique.
M itself is not computed. The factor takes a constant number of operations per axis, and so does each product
with L^-1 or L^-T. An elimination of M takes a number that grows with the square of the axes before.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from newton_euler.equations import sparse
from newton_euler.equations.sparse import SINGULAR, Rows, add, add_symmetric
from newton_euler.scalars import Array, Scalar, cross, minimum, symmetric, tilde

MAX_JOINT_SPACE_DEPTH = 6
"""Number of an axis, counted from the ground, up to which M is eliminated in joint coordinates.

Of 0 to 16, 6 has the fewest operations for the tracker, chains of 20 rods and three public humanoids."""


class Axis(NamedTuple):
    """Axis of a joint velocity, world frame.

    Attributes:
        direction: (3,) unit vector.
        slides: True for a slide, False for a hinge and for the three axes of a ball.
        arm: (3,) to the point of this axis, m; from the point of the axis before, or from the ground's center
            of mass.
    """

    direction: Array
    slides: bool
    arm: Array

    def component(self, wrench: Array) -> Scalar:
        """Compute the component of a wrench (6,) along the axis, N or N m."""
        return self.direction @ (wrench[:3] if self.slides else wrench[3:])

    def motion(self, rate: Scalar) -> Array:
        """Compute the motion (6,) of the body beyond for a rate of the axis."""
        own, none = self.direction * rate, np.zeros(3)
        return np.concatenate([own, none] if self.slides else [none, own])


class SpatialInertia(NamedTuple):
    """Inertia of a rigid or articulated body about a point, (3, 3) each.

    An acceleration (a, alpha) takes the wrench (mass a + coupling^T alpha, coupling a + inertia alpha).
    """

    mass: Array
    coupling: Array
    inertia: Array

    @classmethod
    def none(cls) -> SpatialInertia:
        """Return the inertia of nothing."""
        return cls(np.zeros((3, 3)), np.zeros((3, 3)), np.zeros((3, 3)))

    @classmethod
    def of_body(cls, mass: Scalar, inertia: Array, lever: Array) -> SpatialInertia:
        """Compute the inertia of a rigid body.

        Args:
            mass: kg.
            inertia: (3, 3) about the center of mass, world frame, kg m^2.
            lever: (3,) from the point to the center of mass, world frame, m.
        """
        return cls(mass * np.eye(3), np.zeros((3, 3)), inertia).moved(lever)

    def joined(self, other: SpatialInertia) -> SpatialInertia:
        """Add an inertia about the same point."""
        return SpatialInertia(*(a + b for a, b in zip(self, other, strict=True)))

    def moved(self, arm: Array) -> SpatialInertia:
        """Compute the inertia about another point; the arm (3,) leads from there to the present point."""
        across = tilde(arm)
        coupling = self.coupling + across @ self.mass
        turned = across @ coupling.T - self.coupling @ across
        return SpatialInertia(self.mass, coupling, self.inertia + symmetric(turned))

    def momentum(self, axis: Axis) -> Array:
        """Compute the wrench (6,) that gives a unit acceleration along an axis through the point."""
        if axis.slides:
            return np.concatenate([self.mass @ axis.direction, self.coupling @ axis.direction])
        return np.concatenate([self.coupling.T @ axis.direction, self.inertia @ axis.direction])

    def released(self, momentum: Array, gain: Array) -> SpatialInertia:
        """Compute I - U U^T / d, felt through a free axis, for U (6,) and U / d (6,)."""
        linear, angular = momentum[:3], momentum[3:]
        return SpatialInertia(
            self.mass - symmetric(np.outer(linear, gain[:3])),
            self.coupling - np.outer(angular, gain[:3]),
            self.inertia - symmetric(np.outer(angular, gain[3:])),
        )


class Rotor(NamedTuple):
    """Armature of a joint coordinate x with d2x/dt2 = J vdot - gamma; adds inertia * J^T J to M."""

    inertia: Scalar
    jacobian: dict[int, Scalar]
    gamma: Scalar


def add_rotors(rows: Rows, rotors: Iterable[Rotor]) -> None:
    """Add the inertias of rotors to M."""
    for rotor in rotors:
        for i, x in rotor.jacobian.items():
            for j, y in rotor.jacobian.items():
                if j <= i:
                    add_symmetric(rows, i, j, rotor.inertia * (x * y))


def moved_wrench(wrench: Array, arm: Array) -> Array:
    """Compute a wrench (6,) about another point; the arm (3,) leads from there to the present point."""
    return np.concatenate([wrench[:3], wrench[3:] + cross(arm, wrench[:3])])


@dataclass(frozen=True, eq=False)
class AxisTree:
    """Axes of a tree.

    Attributes:
        axes: (nv,) axes, each after those between the ground and itself.
        before: (nv,) number of the axis before each, -1 for the ground.
    """

    axes: list[Axis]
    before: list[int]

    def on_paths(self, beyond: Iterable[int]) -> list[int]:
        """Return these axes and all between them and the ground, leaves first."""
        found: set[int] = set()
        for k in beyond:
            while k >= 0 and k not in found:
                found.add(k)
                k = self.before[k]
        return sorted(found, reverse=True)

    def pass_on(self, wrenches: dict[int, Array], k: int) -> None:
        """Add the wrench (6,) on axis k to that on the axis before."""
        before = self.before[k]
        if before >= 0:
            moved = moved_wrench(wrenches[k], self.axes[k].arm)
            wrenches[before] = wrenches[before] + moved if before in wrenches else moved

    def rnea_backward(self, wrenches: Mapping[int, Array]) -> dict[int, Scalar]:
        """Project wrenches onto velocities, N or N m.

        Args:
            wrenches: (6,) by axis: the sum for the bodies that this axis, and none beyond, moves.
        """
        carried, found = dict(wrenches), dict[int, Scalar]()
        for k in self.on_paths(wrenches):
            add(found, k, self.axes[k].component(carried[k]))
            self.pass_on(carried, k)
        return found

    def crba(self, inertias: Sequence[SpatialInertia], order: Iterable[int]) -> Rows:
        """Compute the nonzeros of M (nv, nv) in the rows and columns of some axes.

        Args:
            inertias: (nv,) for each axis, of the bodies that it, and none beyond in the order, moves.
            order: the axes, leaves first; all between them and the ground are among them.
        """
        composites, rows = list(inertias), [dict[int, Any]() for _ in self.axes]
        for k in order:
            axis, place = self.axes[k], k
            wrench = composites[k].momentum(axis)
            add_symmetric(rows, k, k, axis.component(wrench))
            while (before := self.before[place]) >= 0:
                wrench, place = moved_wrench(wrench, self.axes[place].arm), before
                add_symmetric(rows, k, place, self.axes[place].component(wrench))
            if (before := self.before[k]) >= 0:
                composites[before] = composites[before].joined(composites[k].moved(axis.arm))
        return rows

    def factorize(
        self, inertias: Sequence[SpatialInertia], rotors: Sequence[Rotor], scales: Sequence[float] | None
    ) -> TreeFactor:
        """Factorize M, leaves first.

        Articulated bodies eliminate the axes deeper than `MAX_JOINT_SPACE_DEPTH`. The axes near the ground,
        where joint coordinates take fewer operations, and the axes that a rotor couples are eliminated in
        joint coordinates.

        Args:
            inertias: (nv,) for each axis, of the bodies that it, and none beyond, moves.
            rotors: all rotors.
            scales: (nv,) usual sizes of the pivots; if None, pivots of articulated bodies have no ratio.
        """
        # which axes are eliminated how
        depths = list[int]()
        for before in self.before:
            depths.append(1 if before < 0 else depths[before] + 1)
        near = [k for k, depth in enumerate(depths) if depth <= MAX_JOINT_SPACE_DEPTH]
        coupled = [k for rotor in rotors if len(rotor.jacobian) > 1 for k in rotor.jacobian]
        in_joint_space = self.on_paths([*near, *coupled])
        deep = sorted(set(range(len(depths))).difference(in_joint_space), reverse=True)

        # articulated bodies: a rotor here turns with one axis, and adds to the axis' pivot
        armature: dict[int, Scalar] = {}
        for rotor in rotors:
            for k, x in rotor.jacobian.items():
                add(armature, k, rotor.inertia * (x * x))
        bodies, gains, pivots = list(inertias), dict[int, Array](), dict[int, Scalar]()
        for k in deep:
            axis, before = self.axes[k], self.before[k]
            momentum = bodies[k].momentum(axis)
            pivots[k] = axis.component(momentum) + armature.get(k, 0.0)
            gains[k] = momentum * (1.0 / pivots[k])
            bodies[before] = bodies[before].joined(bodies[k].released(momentum, gains[k]).moved(axis.arm))

        # joint coordinates: what is deeper moves as articulated bodies
        rows = self.crba(bodies, in_joint_space)
        add_rotors(rows, [rotor for rotor in rotors if not deep or not pivots.keys() & rotor.jacobian])
        factor = sparse.factorize(rows, in_joint_space, scales)
        pivot_ratio = factor.pivot_ratio
        for k, pivot in pivots.items():
            factor.pivots[k], factor.inverse_pivots[k] = pivot, 1.0 / pivot
            if scales is not None:
                pivot_ratio = minimum(pivot_ratio, pivot / scales[k] - SINGULAR)
        return TreeFactor(self, gains, factor, pivot_ratio)


@dataclass(frozen=True, eq=False)
class TreeFactor:
    """L D L^T of the mass matrix of a tree, a `newton_euler.equations.sparse.MassFactor`.

    Attributes:
        tree: the axes.
        gains: U / d (6,) of the axes that articulated bodies eliminate.
        factor: D of all axes, and L of the other axes.
        pivot_ratio: as of `newton_euler.equations.sparse.Factor`.
    """

    tree: AxisTree
    gains: dict[int, Array]
    factor: sparse.Factor
    pivot_ratio: Scalar

    @property
    def pivots(self) -> list[Any]:
        """(nv,) pivots d."""
        return self.factor.pivots

    def lower(self, right: dict[int, Any], wrenches: Mapping[int, Array] | None = None) -> dict[int, Any]:
        """Compute L^-1 b for a sparse b, from which the wrenches of `rnea_backward` are subtracted, if given.

        The wrenches on each axis go to the axis before, together with those that its free motion takes.
        """
        x, carried = dict(right), dict(wrenches or {})
        for k in self.tree.on_paths([*carried, *(k for k in x if k in self.gains)]):
            if k in carried:
                add(x, k, -self.tree.axes[k].component(carried[k]))
            if k in self.gains and k in x:
                push = self.gains[k] * x[k]
                carried[k] = carried[k] + push if k in carried else push
            if k in carried:
                self.tree.pass_on(carried, k)
        return self.factor.lower(x)

    def scaled(self, x: dict[int, Any]) -> dict[int, Any]:
        """Compute D^-1 x."""
        return self.factor.scaled(x)

    def upper(self, right: dict[int, Any]) -> dict[int, Any]:
        """Compute L^-T b for a sparse b, ground first: accelerations go from axis to axis."""
        x, moving = self.factor.upper(right), dict[int, Array]()
        for k, (axis, before) in enumerate(zip(self.tree.axes, self.tree.before, strict=True)):
            motions = list[Array]()
            if before in moving:
                linear, angular = moving[before][:3], moving[before][3:]
                motions.append(np.concatenate([linear + cross(angular, axis.arm), angular]))
                if k in self.gains:
                    add(x, k, -(self.gains[k] @ motions[0]))
            if k in x:
                motions.append(axis.motion(x[k]))
            if motions:
                moving[k] = sum(motions[1:], start=motions[0])
        return x
