"""Recursive algorithms over a tree of bodies: inverse dynamics, mass matrix M and its factorization.

A tree connects bodies to the ground by joints without loops. Each joint velocity has an axis: the axis of a
hinge, the direction of a slide, or one of three axes of a ball. Velocities and axes are numbered from the
ground to the leaves: the axis before an axis, on the path from the ground, has a smaller number. Each axis
has a point: any point of a hinge's axis, the center of a ball, and a free choice for a slide. Spatial vectors
are about these points, in the world frame: a wrench (6,) is (force, torque), a motion (6,) is (linear,
angular). The recursions are those of R. Featherstone, Rigid Body Dynamics Algorithms, Springer 2008:

    rnea_backward   wrenches on bodies, projected onto velocities                       section 5.3
    crba            M, by composite rigid bodies                                        section 6.2
    factorize       M = L D L^T, leaves first, by articulated bodies                    section 7.3

The articulated body of an axis consists of all bodies beyond the axis, on the side away from the ground, with
all joints between them free to move. An axis s whose articulated body has the inertia I has the pivot
d = s^T U with U = I s, plus the armature (rotor inertia) of the axis. The inertia I - U U^T / d is passed to
the axis before. L and D are the same as if M was computed and eliminated, because the factor for an order of
elimination is unique. By articulated bodies, the factor and each product with L^-1 or L^-T take a constant
number of operations per axis. The operations of an elimination of M grow with the square of the number of
axes between an axis and the ground. Near the ground, however, eliminating M takes fewer operations, so that
`factorize` combines both.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from newton_euler.equations import sparse
from newton_euler.equations.sparse import SINGULAR_PIVOT_RATIO, Rows, add, add_symmetric
from newton_euler.scalars import Array, Scalar, cross, minimum, symmetric, tilde

MAX_JOINT_SPACE_DEPTH = 6
"""Depth of an axis, counted from the ground, up to which M is eliminated in joint coordinates.

Of the values 0 to 16, 6 gives the fewest operations for a solar tracker, chains of 20 rods and three public
humanoid models."""


class Axis(NamedTuple):
    """Axis of a joint velocity, world frame.

    Attributes:
        direction: (3,) unit vector.
        slides: True for a slide, False for a hinge and for the three axes of a ball.
        arm: (3,) vector to the point of this axis, m. It begins at the point of the axis before; for an axis
            next to the ground it begins at the ground's center of mass.
    """

    direction: Array
    slides: bool
    arm: Array

    def component(self, wrench: Array) -> Scalar:
        """Compute the component of a wrench (6,) along the axis, N or N m."""
        return self.direction @ (wrench[:3] if self.slides else wrench[3:])

    def motion(self, rate: Scalar) -> Array:
        """Compute the motion (6,) that a rate of the axis, m/s or rad/s, gives to the body beyond it."""
        velocity, zero = self.direction * rate, np.zeros(3)
        return np.concatenate([velocity, zero] if self.slides else [zero, velocity])


class SpatialInertia(NamedTuple):
    """Inertia of a rigid or articulated body about a point, world frame.

    An acceleration (a, alpha) needs the wrench (mass a + coupling^T alpha, coupling a + inertia alpha).

    Attributes:
        mass: (3, 3) kg; for an articulated body, the mass differs between directions.
        coupling: (3, 3) kg m.
        inertia: (3, 3) kg m^2.
    """

    mass: Array
    coupling: Array
    inertia: Array

    @classmethod
    def none(cls) -> SpatialInertia:
        """Return the inertia of no body: zeros."""
        return cls(np.zeros((3, 3)), np.zeros((3, 3)), np.zeros((3, 3)))

    @classmethod
    def of_body(cls, mass: Scalar, inertia: Array, lever: Array) -> SpatialInertia:
        """Compute the inertia of a rigid body.

        Args:
            mass: kg.
            inertia: (3, 3) about the center of mass, world frame, kg m^2.
            lever: (3,) from the point of the result to the center of mass, world frame, m.
        """
        return cls(mass * np.eye(3), np.zeros((3, 3)), inertia).moved(lever)

    def joined(self, other: SpatialInertia) -> SpatialInertia:
        """Return the sum with another inertia about the same point."""
        return SpatialInertia(*(a + b for a, b in zip(self, other, strict=True)))

    def moved(self, arm: Array) -> SpatialInertia:
        """Compute the inertia about another point, from which the arm (3,), m, leads to the present point."""
        across = tilde(arm)
        coupling = self.coupling + across @ self.mass
        turned = across @ coupling.T - self.coupling @ across
        return SpatialInertia(self.mass, coupling, self.inertia + symmetric(turned))

    def momentum(self, axis: Axis) -> Array:
        """Compute U = I s (6,) for an axis s through the point: the wrench for a unit acceleration along s.

        U is also the momentum for a unit rate.
        """
        if axis.slides:
            return np.concatenate([self.mass @ axis.direction, self.coupling @ axis.direction])
        return np.concatenate([self.coupling.T @ axis.direction, self.inertia @ axis.direction])

    def released(self, momentum: Array, gain: Array) -> SpatialInertia:
        """Compute the inertia I - U U^T / d with which an articulated body resists motion of the axis before.

        The body is free to move along its own axis s.

        Args:
            momentum: (6,) U = I s.
            gain: (6,) U / d.
        """
        linear, angular = momentum[:3], momentum[3:]
        return SpatialInertia(
            self.mass - symmetric(np.outer(linear, gain[:3])),
            self.coupling - np.outer(angular, gain[:3]),
            self.inertia - symmetric(np.outer(angular, gain[3:])),
        )


class Rotor(NamedTuple):
    """Armature (rotor inertia) of a joint coordinate x with d2x/dt2 = J vdot - gamma.

    A rotor adds inertia * J^T J to the mass matrix M.

    Attributes:
        inertia: kg m^2 or kg.
        jacobian: sparse row J over v.
        gamma: m/s^2 or rad/s^2.
    """

    inertia: Scalar
    jacobian: dict[int, Scalar]
    gamma: Scalar


def add_rotors(rows: Rows, rotors: Iterable[Rotor]) -> None:
    """Add the inertias of rotors to the sparse mass matrix M."""
    for rotor in rotors:
        for i, x in rotor.jacobian.items():
            for j, y in rotor.jacobian.items():
                if j <= i:
                    add_symmetric(rows, i, j, rotor.inertia * (x * y))


def moved_wrench(wrench: Array, arm: Array) -> Array:
    """Compute a wrench (6,) about another point, from which the arm (3,), m, leads to the present point."""
    return np.concatenate([wrench[:3], wrench[3:] + cross(arm, wrench[:3])])


@dataclass(frozen=True, eq=False)
class AxisTree:
    """Axes of all joint velocities of a tree of bodies.

    Attributes:
        axes: (nv,) axes; each one follows the axes between the ground and itself.
        before: (nv,) number of the axis before each axis on the path from the ground; -1 for an axis next to
            the ground.
    """

    axes: list[Axis]
    before: list[int]

    def on_paths(self, axes: Iterable[int]) -> list[int]:
        """Return the numbers of the given axes and of all axes between them and the ground, leaves first."""
        found: set[int] = set()
        for k in axes:
            while k >= 0 and k not in found:
                found.add(k)
                k = self.before[k]
        return sorted(found, reverse=True)

    def pass_on(self, wrenches: dict[int, Array], k: int) -> None:
        """Add the wrench (6,) on axis k to the wrench on the axis before, about the point of that axis."""
        before = self.before[k]
        if before >= 0:
            moved = moved_wrench(wrenches[k], self.axes[k].arm)
            wrenches[before] = wrenches[before] + moved if before in wrenches else moved

    def rnea_backward(self, wrenches: Mapping[int, Array]) -> dict[int, Scalar]:
        """Project wrenches onto the joint velocities: backward pass of recursive Newton-Euler inverse
        dynamics.

        Args:
            wrenches: (6,) by axis number: sum of the wrenches on the bodies for which this axis is the last
                axis that moves them, about the point of the axis.

        Returns:
            Force or torque along each axis, N or N m, by axis number.
        """
        carried, found = dict(wrenches), dict[int, Scalar]()
        for k in self.on_paths(wrenches):
            add(found, k, self.axes[k].component(carried[k]))
            self.pass_on(carried, k)
        return found

    def crba(self, inertias: Sequence[SpatialInertia], order: Iterable[int]) -> Rows:
        """Compute rows and columns of the mass matrix M (nv, nv) by the composite rigid body algorithm.

        Args:
            inertias: (nv,) for each axis: sum of the inertias of the bodies for which this axis is the last
                axis in `order` that moves them, about the point of the axis.
            order: numbers of the axes, leaves first. All axes between them and the ground must be included.

        Returns:
            Sparse rows of M.
        """
        composites, rows = list(inertias), [dict[int, Any]() for _ in self.axes]
        for k in order:
            # wrench for a unit acceleration of axis k; its components along the axes to the ground are
            # elements of M
            axis, other = self.axes[k], k
            wrench = composites[k].momentum(axis)
            add_symmetric(rows, k, k, axis.component(wrench))
            while (before := self.before[other]) >= 0:
                wrench, other = moved_wrench(wrench, self.axes[other].arm), before
                add_symmetric(rows, k, other, self.axes[other].component(wrench))
            # pass the composite inertia to the axis before
            if (before := self.before[k]) >= 0:
                composites[before] = composites[before].joined(composites[k].moved(axis.arm))
        return rows

    def factorize(
        self, inertias: Sequence[SpatialInertia], rotors: Sequence[Rotor], scales: Sequence[float] | None
    ) -> TreeFactor:
        """Factorize M = L D L^T, leaves first.

        Axes deeper than `MAX_JOINT_SPACE_DEPTH` are eliminated by articulated bodies. Two other kinds of axes
        are eliminated in joint coordinates, from elements of M: axes near the ground, because this takes
        fewer operations, and axes whose velocities a rotor couples to each other.

        Args:
            inertias: (nv,) for each axis: sum of the inertias of the bodies for which this axis is the last
                axis that moves them, about the point of the axis.
            rotors: rotors of all armatures.
            scales: (nv,) reference magnitudes of the pivots, see `newton_euler.equations.sparse`. If None,
                the pivots of articulated bodies are not part of the pivot ratio.
        """
        # which axes are eliminated in joint coordinates, and which by articulated bodies
        depths = list[int]()
        for before in self.before:
            depths.append(1 if before < 0 else depths[before] + 1)
        near = [k for k, depth in enumerate(depths) if depth <= MAX_JOINT_SPACE_DEPTH]
        coupled = [k for rotor in rotors if len(rotor.jacobian) > 1 for k in rotor.jacobian]
        in_joint_space = self.on_paths([*near, *coupled])
        deep = sorted(set(range(len(depths))).difference(in_joint_space), reverse=True)

        # articulated bodies; the rotor of a deep axis depends on this axis alone, and adds to its pivot
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

        # joint coordinates, with the articulated bodies of the deeper axes in place of composite bodies
        rows = self.crba(bodies, in_joint_space)
        add_rotors(rows, [rotor for rotor in rotors if not pivots.keys() & rotor.jacobian])
        factor = sparse.factorize(rows, in_joint_space, scales)
        pivot_ratio = factor.pivot_ratio
        for k, pivot in pivots.items():
            factor.pivots[k], factor.inverse_pivots[k] = pivot, 1.0 / pivot
            if scales is not None:
                pivot_ratio = minimum(pivot_ratio, pivot / scales[k] - SINGULAR_PIVOT_RATIO)
        return TreeFactor(self, gains, factor, pivot_ratio)


@dataclass(frozen=True, eq=False)
class TreeFactor:
    """Factorization M = L D L^T of the mass matrix of a tree.

    The class implements `newton_euler.equations.sparse.MassFactor`.

    Attributes:
        tree: the axes.
        gains: U / d (6,) of each axis that is eliminated by articulated bodies, by axis number.
        factor: D of all axes, and L of the axes that are eliminated in joint coordinates.
        pivot_ratio: smallest ratio of a pivot to its reference magnitude, minus `SINGULAR_PIVOT_RATIO`; not
            positive if M is singular.
    """

    tree: AxisTree
    gains: dict[int, Array]
    factor: sparse.Factor
    pivot_ratio: Scalar

    @property
    def pivots(self) -> list[Any]:
        """Pivots d (nv,) of all axes."""
        return self.factor.pivots

    def lower(self, right: dict[int, Any], wrenches: Mapping[int, Array] | None = None) -> dict[int, Any]:
        """Compute L^-1 b, or L^-1 (b - tau) with the projection tau of given wrenches onto the axes.

        Leaves first, the wrench on each axis is passed to the axis before. For an axis with an articulated
        body, x U / d is added: the wrench of the articulated body if the axis accelerates by x / d.

        Args:
            right: sparse vector b.
            wrenches: (6,) by axis number, see `AxisTree.rnea_backward`.
        """
        x, carried = dict(right), dict(wrenches or {})  # `carried`: wrench (6,) on each axis
        for k in self.tree.on_paths([*carried, *(k for k in x if k in self.gains)]):
            if k in carried:
                add(x, k, -self.tree.axes[k].component(carried[k]))
            if k in self.gains and k in x:
                wrench = self.gains[k] * x[k]
                carried[k] = carried[k] + wrench if k in carried else wrench
            if k in carried:
                self.tree.pass_on(carried, k)
        return self.factor.lower(x)

    def scaled(self, x: dict[int, Any]) -> dict[int, Any]:
        """Compute D^-1 x."""
        return self.factor.scaled(x)

    def upper(self, right: dict[int, Any]) -> dict[int, Any]:
        """Compute L^-T b for a sparse vector b, passing accelerations from the ground to the leaves."""
        x, motions = self.factor.upper(right), dict[int, Array]()  # motion (6,) of the body beyond each axis
        for k, (axis, before) in enumerate(zip(self.tree.axes, self.tree.before, strict=True)):
            terms = list[Array]()
            if before in motions:
                # the motion of the axis before, at the point of this axis
                linear, angular = motions[before][:3], motions[before][3:]
                terms.append(np.concatenate([linear + cross(angular, axis.arm), angular]))
                if k in self.gains:
                    add(x, k, -(self.gains[k] @ terms[0]))
            if k in x:
                terms.append(axis.motion(x[k]))
            if terms:
                motions[k] = sum(terms[1:], start=terms[0])
        return x
