"""Equations between joint coordinates as constraints of Exudyn: gears, screws, motions and rotor inertias.

Exudyn's bodies have Euler parameters, so that a joint coordinate is a function of the coordinates of two
bodies. `ObjectConnectorCoordinateVector` makes an equation of such functions a constraint: Python evaluates
the equation and its Jacobian; Exudyn adds the constraint forces and solves. An `ObjectGenericODE2` without
mass collects the coordinates of all bodies in the equation.

A rotor inertia (armature) is a mass with one coordinate y, and the equation is y = x with the joint
coordinate x.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from crosscheck.engines.exudyn.coordinates import JointCoordinates
from newton_euler.equations.couplings import Coupling
from newton_euler.model.constraints import Frame
from newton_euler.model.joint import Key
from newton_euler.model.mechanism import Mechanism
from newton_euler.scalars import Array


class CoordinateEquation:
    """A sum of polynomials of joint coordinates that equals a function of time, or the coordinate of a rotor.

    The methods `phi` and `jacobian` are user functions of Exudyn.

    Attributes:
        coupling: the equation.
        coordinates: the joint coordinates in it.
        rotor: True if the equation subtracts the coordinate of a rotor, which follows those of the bodies.
    """

    def __init__(
        self, coupling: Coupling, mechanism: Mechanism, angles: Mapping[Key, float], rotor: bool = False
    ) -> None:
        """Find the bodies of an equation; `angles` are those of `JointCoordinates`."""
        self.coupling, self.rotor = coupling, rotor
        self.coordinates = JointCoordinates(mechanism, coupling.factors, angles)

    def wrenches_on_second(self, frames: Sequence[Frame], multiplier: float) -> Iterator[tuple[str, Array]]:
        """Yield what the force of the equation is on the second body of each joint in it.

        Args:
            frames: poses of all bodies, ground first.
            multiplier: force of the equation, N or N m.

        Yields:
            Name of the joint; force and torque (6,) about the center of mass, world frame.
        """
        slopes = self.coupling.slopes(self.coordinates.x(dict(enumerate(frames))))
        for key, wrench in self.coordinates.on_second(frames).items():
            yield key[0], multiplier * slopes[key] * wrench

    def _row(self, q: Array) -> Array:
        """Return the derivatives of the equation with respect to the coordinates of the bodies."""
        frames = self.coordinates.frames(q)
        slopes, rows = self.coupling.slopes(self.coordinates.x(frames)), self.coordinates.rows(q, frames)
        return np.asarray(sum(slopes[key] * row for key, row in rows.items()))

    def phi(self, _mbs: Any, time: float, _item: int, q: Array, rates: Array, of_rates: bool) -> list[float]:
        """Return the residual of the equation, or its rate if `of_rates`.

        Args:
            time: s.
            q: (n,) coordinates of the bodies, then of the second marker.
            rates: (n,) their rates.
            of_rates: True for the rate.
        """
        q, size = np.asarray(q), self.coordinates.size
        function = self.coupling.function
        if of_rates:
            rates = np.asarray(rates)
            rate = float(self._row(q) @ rates[:size]) - (function.rate(time) if function else 0.0)
            return [rate - rates[size] if self.rotor else rate]
        x = self.coordinates.x(self.coordinates.frames(q))
        value = self.coupling.value(x) - (function.value(time) if function else 0.0)
        return [value - q[size] if self.rotor else value]

    def jacobian(
        self, _mbs: Any, _time: float, _item: int, q: Array, _rates: Array, _of_rates: bool
    ) -> Array:
        """Return the Jacobian (1, n) of the equation, see `phi`."""
        q, size = np.asarray(q), self.coordinates.size
        row = np.zeros((1, len(q)))
        row[0, :size] = self._row(q)
        if self.rotor:
            row[0, size] = -1.0
        return row


def rotor_equations(scene_armatures: Sequence[Any], mechanism: Mechanism) -> list[Coupling]:
    """Return the joint coordinate of each rotor inertia on a hinge or slide, as a sum with a single term."""
    return [
        Coupling(
            "armature at joint",
            armature.joint,
            armature.joint,
            {armature.key: 1.0},
            function=None,
            is_length=mechanism.is_slide(*armature.key),
        )
        for armature in scene_armatures
    ]
