"""Joint coordinates as functions of the coordinates of Exudyn's bodies, with their derivatives.

User functions of Exudyn use them: constraints between joint coordinates, and forces along joint coordinates.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from newton_euler.model.constraints import Frame
from newton_euler.model.euler_parameters import matrix_l, rotation
from newton_euler.model.joint import Key
from newton_euler.model.mechanism import Mechanism
from newton_euler.model.state import whole_revolutions
from newton_euler.scalars import Array

NODAL = 7
"""Number of coordinates of a body in Exudyn: position and Euler parameters (w, x, y, z)."""


class JointCoordinates:
    """Some joint coordinates as functions of the coordinates (7 n,) of the n bodies on which they depend.

    Attributes:
        bodies: numbers of these bodies, ascending, without the ground.
        size: 7 n.
    """

    def __init__(self, mechanism: Mechanism, keys: Iterable[Key], angles: Mapping[Key, float]) -> None:
        """Find the bodies.

        Args:
            mechanism: mechanism with the joints.
            keys: the joint coordinates.
            angles: hinge angles with their full revolutions at a close state, rad; the caller updates them.
        """
        self._angles, self._measures = angles, {}
        for joint, coordinate in dict.fromkeys(keys):
            equations = mechanism.joint_equations(joint)
            measure = equations.coordinates[coordinate]
            self._measures[joint, coordinate] = measure, equations.first, equations.second
        ends = {body for _, *both in self._measures.values() for body in both}
        self.bodies = sorted(ends - {0})
        self.size = NODAL * len(self.bodies)
        self._place = {body: NODAL * k for k, body in enumerate(self.bodies)}
        pose = mechanism.bodies[0].pose
        self._ground = Frame(pose.position, pose.rotation, np.zeros(3), np.zeros(3))

    def frames(self, q: Array) -> dict[int, Frame]:
        """Return the poses of the bodies, by number, for their coordinates (7 n,)."""
        frames = {0: self._ground}
        for body, k in self._place.items():
            p = q[k + 3 : k + NODAL]
            turn = rotation(p) / (p @ p)
            frames[body] = Frame(q[k : k + 3], turn, np.zeros(3), np.zeros(3))
        return frames

    def x(self, frames: Mapping[int, Frame]) -> dict[Key, float]:
        """Return the joint coordinates, m or rad with full revolutions, by key."""
        found = {}
        for key, (measure, first, second) in self._measures.items():
            x = float(measure.phi(frames[first], frames[second])[0])
            found[key] = x + (float(whole_revolutions(self._angles[key] - x)) if key in self._angles else 0.0)
        return found

    def rows(self, q: Array, frames: Mapping[int, Frame]) -> dict[Key, Array]:
        """Return the derivatives (7 n,) of each joint coordinate by the coordinates q (7 n,) of bodies."""
        rows = {}
        for key, (measure, first, second) in self._measures.items():
            of, row = measure.jacobian(frames[first], frames[second]), np.zeros(self.size)
            blocks = (first, of.r_first, of.theta_first), (second, of.r_second, of.theta_second)
            for body, by_position, by_rotation in blocks:
                if body:
                    k = self._place[body]
                    p = q[k + 3 : k + NODAL]
                    # body-frame rotations are 2 L(p) dp / |p|^2
                    by_body_rotation = by_rotation[0] @ frames[body].rotation
                    row[k : k + 3] = by_position[0]
                    row[k + 3 : k + NODAL] = (2.0 / (p @ p)) * (by_body_rotation @ matrix_l(p))
            rows[key] = row
        return rows

    def on_second(self, frames: Sequence[Frame]) -> dict[Key, Array]:
        """Return the force and torque (6,) on the joint's second body of a unit force along each coordinate.

        Args:
            frames: poses of all bodies, ground first.

        Returns:
            About the center of mass, world frame.
        """
        found = {}
        for key, (measure, first, second) in self._measures.items():
            of = measure.jacobian(frames[first], frames[second])
            found[key] = np.concatenate([of.r_second[0], of.theta_second[0]])
        return found
