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

from newton_euler.equations.couplings import Coupling
from newton_euler.model.constraints import Frame
from newton_euler.model.euler_parameters import matrix_l, rotation
from newton_euler.model.joint import Key
from newton_euler.model.mechanism import Mechanism
from newton_euler.model.state import whole_revolutions
from newton_euler.scalars import Array

NODAL = 7
"""Number of coordinates of a body in Exudyn: position and Euler parameters (w, x, y, z)."""


class CoordinateEquation:
    """A sum of polynomials of joint coordinates that equals a function of time, or the coordinate of a rotor.

    The methods `phi` and `jacobian` are user functions of Exudyn.

    Attributes:
        coupling: the equation.
        bodies: numbers of the moving bodies in the equation, ascending.
        rotor: True if the equation subtracts the coordinate of a rotor, which follows those of the bodies.
    """

    def __init__(
        self, coupling: Coupling, mechanism: Mechanism, angles: Mapping[Key, float], rotor: bool = False
    ) -> None:
        """Find the bodies of an equation.

        Args:
            coupling: the equation.
            mechanism: mechanism with the joints.
            angles: hinge angles with their full revolutions at a close state, rad; the caller updates them.
            rotor: see `CoordinateEquation`.
        """
        self.coupling, self.rotor, self._angles = coupling, rotor, angles
        self._measures = {}
        for key in coupling.factors:
            equations = mechanism.joint_equations(key[0])
            self._measures[key] = equations.coordinates[key[1]], equations.first, equations.second
        ends = {body for _, *both in self._measures.values() for body in both}
        self.bodies = sorted(ends - {0})
        self._place = {body: NODAL * k for k, body in enumerate(self.bodies)}
        pose = mechanism.bodies[0].pose
        self._ground = Frame(pose.position, pose.rotation, np.zeros(3), np.zeros(3))

    def _frames(self, q: Array) -> dict[int, Frame]:
        """Return the poses of the bodies, by number, for their coordinates (7 n,)."""
        frames = {0: self._ground}
        for body, k in self._place.items():
            p = q[k + 3 : k + NODAL]
            turn = rotation(p) / (p @ p)
            frames[body] = Frame(q[k : k + 3], turn, np.zeros(3), np.zeros(3))
        return frames

    def wrenches_on_second(self, frames: Sequence[Frame], multiplier: float) -> Iterator[tuple[str, Array]]:
        """Yield what the force of the equation is on the second body of each joint in it.

        Args:
            frames: poses of all bodies, ground first.
            multiplier: force of the equation, N or N m.

        Yields:
            Name of the joint; force and torque (6,) about the center of mass, world frame.
        """
        for key, slope in self.coupling.slopes(self._x(dict(enumerate(frames)))).items():
            measure, first, second = self._measures[key]
            of = measure.jacobian(frames[first], frames[second])
            yield key[0], multiplier * slope * np.concatenate([of.r_second[0], of.theta_second[0]])

    def _x(self, frames: Mapping[int, Frame]) -> dict[Key, float]:
        """Return the joint coordinates, m or rad with full revolutions, by key."""
        found = {}
        for key, (measure, first, second) in self._measures.items():
            x = float(measure.phi(frames[first], frames[second])[0])
            found[key] = x + (float(whole_revolutions(self._angles[key] - x)) if key in self._angles else 0.0)
        return found

    def _row(self, q: Array) -> Array:
        """Return the derivatives (7 n,) of the equation with respect to the coordinates of the bodies."""
        frames, row = self._frames(q), np.zeros(NODAL * len(self.bodies))
        for key, slope in self.coupling.slopes(self._x(frames)).items():
            measure, first, second = self._measures[key]
            of = measure.jacobian(frames[first], frames[second])
            blocks = (first, of.r_first, of.theta_first), (second, of.r_second, of.theta_second)
            for body, by_position, by_rotation in blocks:
                if body:
                    k = self._place[body]
                    p = q[k + 3 : k + NODAL]
                    # body-frame rotations are 2 L(p) dp / |p|^2
                    by_body_rotation = by_rotation[0] @ frames[body].rotation
                    row[k : k + 3] += slope * by_position[0]
                    row[k + 3 : k + NODAL] += slope * (2.0 / (p @ p)) * (by_body_rotation @ matrix_l(p))
        return row

    def phi(self, _mbs: Any, time: float, _item: int, q: Array, rates: Array, of_rates: bool) -> list[float]:
        """Return the residual of the equation, or its rate if `of_rates`.

        Args:
            time: s.
            q: (n,) coordinates of the bodies, then of the second marker.
            rates: (n,) their rates.
            of_rates: True for the rate.
        """
        q, size = np.asarray(q), NODAL * len(self.bodies)
        function = self.coupling.function
        if of_rates:
            rates = np.asarray(rates)
            rate = float(self._row(q) @ rates[:size]) - (function.rate(time) if function else 0.0)
            return [rate - rates[size] if self.rotor else rate]
        value = self.coupling.value(self._x(self._frames(q))) - (function.value(time) if function else 0.0)
        return [value - q[size] if self.rotor else value]

    def jacobian(
        self, _mbs: Any, _time: float, _item: int, q: Array, _rates: Array, _of_rates: bool
    ) -> Array:
        """Return the Jacobian (1, n) of the equation, see `phi`."""
        q = np.asarray(q)
        row, size = np.zeros((1, len(q))), NODAL * len(self.bodies)
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
