"""The bodies of a scene where a file's own model has them."""

from __future__ import annotations

from functools import cached_property
from typing import NamedTuple

import numpy as np

from newton_euler.equations.system import System
from newton_euler.model.euler_parameters import from_rotation, product
from newton_euler.model.state import State
from newton_euler.reading.reference import ReferenceModel, Sample
from newton_euler.scalars import Array, cross, tilde


class Place(NamedTuple):
    """The scene's bodies, ground first, where a sample of the file has them."""

    sample: Sample
    state: State
    rest: State
    """The same without velocities."""
    transformation: Array
    """(6 b, nv) of the bodies' centers of mass, for the file's velocities."""
    of_parts: Array
    """(6 g, nv) the same for each rigid group of the file that is a part of a body."""
    drift: Array
    """(6 g,) accelerations of the groups where those of the file's coordinates are zero."""


class Placed:
    """A file, equations of motion of a scene, and the scene's bodies where the file has them.

    A body moves from its initial pose as the file's group of its name moves from the start, so that frames of
    neither side matter.

    Attributes:
        reference, system: the two.
        bodies: (g,) the scene's body of each rigid group.
        parts: for each of these bodies its first group.
        first: (g, 3) and (g, 3, 3), centers and rotations of the groups at the start.
    """

    def __init__(self, reference: ReferenceModel, system: System) -> None:
        self.reference, self.system = reference, system
        self.scene, self.mechanism = system.scene, system.mechanism
        self.bodies = [self.mechanism.body_index(name) for name in reference.names]
        self.parts = {body: self.bodies.index(body) for body in self.bodies}
        self.part_units = np.tile(np.repeat([reference.size, 1.0], 3), len(self.bodies))
        found = reference.samples[0].kinematics
        self.first = found.position, found.rotation

    @property
    def halved(self) -> bool:
        """True if the file has halves of bodies, each posed by the first of them alone."""
        return len(self.parts) < len(self.bodies)

    @property
    def limits(self) -> list[float]:
        """Tolerances of forces at the samples.

        Halves, and springs and rotors that a scene has at the other end of a gear, see what is open.
        """
        sees = self.halved or self.mechanism.couplings
        return [
            sample.tolerance + (10.0 * sample.opening if sees else 0.0) for sample in self.reference.samples
        ]

    def of_parts(self, values: Array) -> Array:
        """(6 g, ...) dimensionless velocities or accelerations of groups, of (6 b, ...) of bodies."""
        rows = np.arange(len(values)).reshape(-1, 6)[self.bodies].ravel()
        return np.asarray((values[rows].T / self.part_units).T)

    @cached_property
    def places(self) -> list[Place]:
        """At the samples."""
        return [self._place(sample) for sample in self.reference.samples]

    def _place(self, sample: Sample) -> Place:
        bodies = self.mechanism.bodies
        found = sample.kinematics
        parts, drift = found.transformation.copy(), found.drift.copy()
        rest = State.initial(self.mechanism)
        centers, turns = self.first
        for k in reversed(range(len(parts))):  # of halves the first one tells the pose
            body, turn = self.bodies[k], found.rotation[k] @ turns[k].T
            arm = turn @ (bodies[body].center_of_mass - centers[k])
            rest.position[body] = found.position[k] + arm
            rest.quaternion[body] = product(from_rotation(turn), bodies[body].quaternion)
            parts[k] = shifted(parts[k], arm)
            omega = parts[k, 3:] @ sample.v
            drift[k, :3] += cross(drift[k, 3:], arm) + cross(omega, cross(omega, arm))
        rows = np.zeros((len(bodies), 6, len(sample.v)))
        rows[list(self.parts)] = parts[list(self.parts.values())]
        linear, angular = np.split(rows @ sample.v, 2, axis=1)
        state = State(rest.position, rest.quaternion, linear, angular)
        whole, of_parts = (each.reshape(-1, len(sample.v)) for each in (rows, parts))
        return Place(sample, state, rest, whole, of_parts, drift.ravel())


def shifted(rows: Array, arm: Array) -> Array:
    """Velocities (6, nv) of a body at a point that lies `arm` (3,) from the one that they are of."""
    moved = rows.copy()
    moved[:3] -= tilde(arm) @ rows[3:]
    return moved
