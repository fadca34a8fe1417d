"""Place the bodies of a scene at the poses of the file's reference model."""

from __future__ import annotations

from functools import cached_property
from typing import NamedTuple

import numpy as np

from newton_euler.equations.system import System
from newton_euler.model.euler_parameters import from_rotation, product
from newton_euler.model.state import State
from newton_euler.reading.reference import ReferenceModel, Sample
from newton_euler.scalars import Array, cross, tilde


class SamplePlacement(NamedTuple):
    """Bodies of the scene, ground first, at the poses and velocities of a sample of the file."""

    sample: Sample
    state: State
    rest: State
    """The state without velocities."""
    transformation: Array
    """(6 b, nv) velocities of the bodies' centers of mass for velocities of the file."""
    of_parts: Array
    """(6 g, nv) velocities at the same points for each rigid group of the file that is part of a body."""
    drift: Array
    """(6 g,) accelerations of the groups for zero accelerations of the file's coordinates."""


class ScenePlacement:
    """Bodies of a scene at the poses of a reference model, for all samples of the model.

    A body moves from its initial pose as the group of its name in the file moves from the start. The choice
    of body frames therefore does not matter.

    Attributes:
        reference: model of the file.
        system: equations of motion of the scene.
        bodies: (g,) number of the scene's body of each rigid group.
        parts: for each of these bodies, the number of its first group.
        first: centers (g, 3), m, and rotations (g, 3, 3) of the groups at the start.
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
        """True if the file cuts bodies into halves; the first half gives the pose of the body."""
        return len(self.parts) < len(self.bodies)

    @property
    def limits(self) -> list[float]:
        """Tolerances of forces at the samples.

        The loop-closure error counts for halves of bodies, and for springs and rotors that the scene has on
        the other side of a gear.
        """
        sees = self.halved or self.mechanism.couplings
        return [
            sample.tolerance + (10.0 * sample.opening if sees else 0.0) for sample in self.reference.samples
        ]

    def of_parts(self, values: Array) -> Array:
        """Return dimensionless velocities or accelerations (6 g, ...) of groups, from bodies (6 b, ...)."""
        rows = np.arange(len(values)).reshape(-1, 6)[self.bodies].ravel()
        return np.asarray((values[rows].T / self.part_units).T)

    @cached_property
    def places(self) -> list[SamplePlacement]:
        """Placements at the samples."""
        return [self._place(sample) for sample in self.reference.samples]

    def _place(self, sample: Sample) -> SamplePlacement:
        bodies = self.mechanism.bodies
        found = sample.kinematics
        parts, drift = found.transformation.copy(), found.drift.copy()
        rest = State.initial(self.mechanism)
        centers, turns = self.first
        for k in reversed(range(len(parts))):  # in reverse, so that the first half sets the pose
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
        return SamplePlacement(sample, state, rest, whole, of_parts, drift.ravel())


def shifted(rows: Array, arm: Array) -> Array:
    """Move velocities (6, nv) of a body to a point at a distance `arm` (3,), m, from their own point."""
    moved = rows.copy()
    moved[:3] -= tilde(arm) @ rows[3:]
    return moved
