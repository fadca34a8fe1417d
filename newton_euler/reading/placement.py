"""Place the bodies of an imported scene at the poses of the file's reference model.

A reference model is the model file as an independent parser compiles it. Its samples are states
(configuration and velocities) at which scene and file are compared. The first sample is the start, at which
the bodies have the initial poses of the scene. The file has *rigid groups*: links that fixed joints hold
together. A group is one body of the scene, or a part of a body if the file cuts bodies at loops.
"""

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
    """The b bodies of a scene, ground first, at the poses and velocities of a sample of the file.

    Attributes:
        sample: state of the file's reference model, with nv velocities.
        state: poses and velocities of the scene's bodies.
        rest: the same poses with all velocities zero.
        transformation: (6 b, nv) Jacobian of the bodies' linear (at the center of mass) and angular
            velocities with respect to the velocities of the file.
        group_transformation: (6 g, nv) the same for each of the file's g rigid groups. The linear velocity of
            a group is taken at the center of mass of its body.
        group_drift: (6 g,) accelerations of the groups, at the same points, at zero accelerations of the
            file's coordinates.
    """

    sample: Sample
    state: State
    rest: State
    transformation: Array
    group_transformation: Array
    group_drift: Array


class ScenePlacement:
    """Bodies of a scene at the poses of a reference model, for all samples of the model.

    A body moves from its initial pose as the group of the same name in the file moves from the start. The
    choice of body frames therefore does not matter.

    Attributes:
        reference: model of the file.
        system: equations of motion of the scene.
        scene, mechanism: the scene and its mechanism.
        body_of_group: (g,) index of the scene's body of each rigid group.
        first_groups: index of the first group of each of these bodies, by index of the body.
        group_units: (6 g,) scales of velocities: size of the model for linear, 1 for angular velocities.
        start_frames: centers of mass (g, 3), m, and rotations (g, 3, 3) of the groups at the start.
    """

    def __init__(self, reference: ReferenceModel, system: System) -> None:
        self.reference, self.system = reference, system
        self.scene, self.mechanism = system.scene, system.mechanism
        self.body_of_group = [self.mechanism.body_index(name) for name in reference.names]
        self.first_groups = {body: self.body_of_group.index(body) for body in self.body_of_group}
        self.group_units = np.tile(np.repeat([reference.size, 1.0], 3), len(self.body_of_group))
        found = reference.samples[0].kinematics
        self.start_frames = found.position, found.rotation

    @property
    def has_cut_bodies(self) -> bool:
        """True if the file cuts bodies into two halves at a loop; the first half gives the body's pose."""
        return len(self.first_groups) < len(self.body_of_group)

    @property
    def force_tolerances(self) -> list[float]:
        """Relative tolerance of forces at each sample.

        The tolerance includes ten times the loop-closure error (rad, or divided by the model's size) if the
        file cuts bodies into halves, whose poses may differ by the error. It also does if the scene has
        couplings: a spring or an armature of the file may be on one side of a gear, and that of the scene on
        the other side.
        """
        includes_closure = bool(self.has_cut_bodies or self.mechanism.couplings)
        return [
            sample.tolerance + (10.0 * sample.closure_error if includes_closure else 0.0)
            for sample in self.reference.samples
        ]

    def group_rows(self, values: Array) -> Array:
        """Return the velocities or accelerations (6 g, ...) of the groups' bodies, divided by `group_units`.

        Args:
            values: (6 b, ...) velocities or accelerations of the scene's bodies, SI.
        """
        rows = np.arange(len(values)).reshape(-1, 6)[self.body_of_group].ravel()
        return np.asarray((values[rows].T / self.group_units).T)

    @cached_property
    def placements(self) -> list[SamplePlacement]:
        """Placements at all samples of the reference model."""
        return [self._place(sample) for sample in self.reference.samples]

    def _place(self, sample: Sample) -> SamplePlacement:
        """Place the bodies at one sample."""
        bodies, nv = self.mechanism.bodies, len(sample.v)
        found = sample.kinematics
        groups, drift = found.transformation.copy(), found.drift.copy()
        rest = State.initial(self.mechanism)
        start_centers, start_rotations = self.start_frames
        for k in reversed(range(len(groups))):  # in reverse, so that the first half sets the pose
            # `turn`: rotation of the group, and with it of the body, since the start
            body, turn = self.body_of_group[k], found.rotation[k] @ start_rotations[k].T
            arm = turn @ (bodies[body].center_of_mass - start_centers[k])
            rest.position[body] = found.position[k] + arm
            rest.quaternion[body] = product(from_rotation(turn), bodies[body].quaternion)
            # Velocities and accelerations at the body's center of mass
            groups[k] = shifted_to(groups[k], arm)
            omega = groups[k, 3:] @ sample.v
            drift[k, :3] += cross(drift[k, 3:], arm) + cross(omega, cross(omega, arm))
        rows = np.zeros((len(bodies), 6, nv))
        rows[list(self.first_groups)] = groups[list(self.first_groups.values())]
        linear, angular = np.split(rows @ sample.v, 2, axis=1)
        return SamplePlacement(
            sample,
            state=State(rest.position, rest.quaternion, linear, angular),
            rest=rest,
            transformation=rows.reshape(-1, nv),
            group_transformation=groups.reshape(-1, nv),
            group_drift=drift.ravel(),
        )


def shifted_to(rows: Array, arm: Array) -> Array:
    """Return the velocity Jacobian (6, nv) of a body at another point of the body.

    Args:
        rows: (6, nv) Jacobian of linear and angular velocity, world frame.
        arm: (3,) m, vector from the present point to the other point.
    """
    shifted = rows.copy()
    shifted[:3] -= tilde(arm) @ rows[3:]
    return shifted
