"""Equations of couplings at a state: residuals in poses of bodies, and constraint rows of a spanning tree.

Couplings are gears, screws, polynomial couplings and prescribed motions of joint coordinates, see
`newton_euler.equations.couplings`. Angles count their full revolutions. A key (joint, number) names a joint
coordinate: a slide displacement or a hinge angle.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from newton_euler.equations.couplings import (
    Coupling,
    counted_angles,
    couplings,
    needed_coordinates,
    row_units,
)
from newton_euler.equations.revolutions import revolutions
from newton_euler.model.constraints import Frame
from newton_euler.model.joint import Key
from newton_euler.model.mechanism import Mechanism
from newton_euler.model.scene import Scene
from newton_euler.model.spanning_tree import SpanningTree
from newton_euler.model.state import State
from newton_euler.scalars import Array


class Residuals(NamedTuple):
    """Residuals of c couplings at given frames of the bodies.

    Attributes:
        phi: (c,) m or rad.
        rate: (c,) m/s or rad/s.
        slopes: for each coupling, the derivative of its residual with respect to each coordinate, by key.
    """

    phi: Array
    rate: Array
    slopes: list[dict[Key, float]]

    @property
    def sensitivity(self) -> Array:
        """Sum (c,) of the magnitudes of each coupling's slopes.

        The residual changes by this at most if each coordinate changes by 1 m or 1 rad.
        """
        return np.array([sum(map(abs, slopes.values())) for slopes in self.slopes])


def residuals(
    mechanism: Mechanism,
    couplings: Sequence[Coupling],
    frames: Sequence[Frame],
    time: float,
    known: Mapping[Key, float],
) -> Residuals:
    """Compute the residuals of couplings at given frames of the bodies.

    Args:
        mechanism: the mechanism to which the couplings belong.
        couplings: the couplings.
        frames: pose and velocity of each body, ground first.
        time: s.
        known: angles with their full revolutions, rad, by key; for other angles `revolutions` finds them.
    """
    x, rates = dict[Key, float](), dict[Key, float]()
    for key in {key for coupling in couplings for key in coupling.factors}:
        x[key], rates[key] = map(float, mechanism.measure(key, frames))
    angles = {key for key in x if not mechanism.is_slide(*key)}
    for key, angle in revolutions(couplings, x, angles, time, known).items():
        x[key] += angle
    phi = [c.value(x) - (c.function.value(time) if c.function else 0.0) for c in couplings]
    slopes = [c.slopes(x) for c in couplings]
    phi_rates = [
        sum(slope * rates[key] for key, slope in of_coupling.items()) + coupling.phi_t(time)
        for of_coupling, coupling in zip(slopes, couplings, strict=True)
    ]
    return Residuals(np.array(phi), np.array(phi_rates), slopes)


class TreeCouplings:
    """The couplings of a scene as equations in the coordinates q and velocities v of a spanning tree.

    A spanning tree connects all bodies by joints without loops. The tree must contain all coupled joints.
    This holds if only ball joints, rods and welds close loops, because these joints have no coordinates.
    Models for MuJoCo and Pinocchio have such trees.

    Attributes:
        couplings: the c couplings of the scene.
        units: (c,) divisors that make the equations dimensionless: the mechanism's size, m, for lengths, else
        1.
    """

    def __init__(self, scene: Scene, tree: SpanningTree) -> None:
        """Find the indices in q and v of the coordinates on which forces and couplings depend."""
        self.couplings = couplings(scene)
        self._angles = counted_angles(scene)
        self._on_q: dict[Key, int] = {}
        self._on_v: dict[Key, int] = {}
        self._nv = tree.nv
        for key in needed_coordinates(scene, self.couplings):
            place = tree.place(*key)
            assert place is not None
            self._on_q[key], self._on_v[key] = place
        self.units = row_units(equations=(), couplings=self.couplings, size=scene.mechanism.size)

    def _x(self, q: Array) -> dict[Key, Any]:
        """Return the joint coordinates that forces and couplings depend on, m or rad, by key, at q (nq,)."""
        return {key: q[place] for key, place in self._on_q.items()}

    def phi(self, q: Array, time: float) -> Array:
        """Compute the residuals (c,), m or rad, at q (nq,) and a time, s."""
        x = self._x(q)
        return np.array([coupling.value(x) for coupling in self.couplings]) - self.value(time)

    def jacobian(self, q: Array) -> Array:
        """Compute the Jacobian (c, nv) of the residuals with respect to the tree velocities."""
        rows, x = np.zeros((len(self.couplings), self._nv)), self._x(q)
        for row, coupling in zip(rows, self.couplings, strict=True):
            for key, slope in coupling.slopes(x).items():
                row[self._on_v[key]] = slope
        return rows

    def value(self, time: float) -> Array:
        """Compute the prescribed values f(t) (c,) of the couplings, m or rad; 0 without a function."""
        return np.array([c.function.value(time) if c.function else 0.0 for c in self.couplings])

    def rate(self, time: float) -> Array:
        """Compute the first time derivatives (c,) of `value`."""
        return np.array([c.function.rate(time) if c.function else 0.0 for c in self.couplings])

    def acceleration(self, time: float) -> Array:
        """Compute the second time derivatives (c,) of `value`."""
        return np.array([c.function.acceleration(time) if c.function else 0.0 for c in self.couplings])

    def gamma(self, q: Array, v: Array, time: float) -> Array:
        """Compute gamma (c,) of Phi_q dv/dt = gamma at q (nq,), v (nv,) and a time, s."""
        gamma, x = self.acceleration(time), self._x(q)
        rates = {key: v[place] for key, place in self._on_v.items()}
        for k, coupling in enumerate(self.couplings):
            gamma[k] -= coupling.curvature_term(x, rates)
        return gamma

    def turned(self, q: Array, state: State, time: float) -> Array:
        """Return q (nq,) with full revolutions added to its angles, so that the couplings hold.

        Args:
            q: tree coordinates with angles between -pi and pi.
            state: gives known angles with their revolutions; `revolutions` finds those of other angles.
            time: s.
        """
        x = {key: float(value) for key, value in self._x(q).items()}
        q = q.copy()
        for key, angle in revolutions(self.couplings, x, self._angles, time, state.angles).items():
            q[self._on_q[key]] += angle
        return q

    def angles(self, q: Array) -> dict[Key, float]:
        """Return the angles that forces and couplings depend on, rad, at q (nq,), for `State.angles`."""
        return {key: float(q[self._on_q[key]]) for key in self._angles}
