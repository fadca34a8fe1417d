"""The state of a mechanism in a form that belongs to no engine: body poses and velocities."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from newton_euler.model.constraints import Frame
from newton_euler.model.euler_parameters import rotation
from newton_euler.model.mechanism import Mechanism
from newton_euler.scalars import Array, Scalar

if TYPE_CHECKING:
    from newton_euler.model.scene import Scene


@dataclass(frozen=True, eq=False)
class State:
    """Poses and velocities of all b bodies, ground first; world frame, SI.

    Attributes:
        position: (b, 3) centres of mass, m.
        quaternion: (b, 4) w-x-y-z.
        linear_velocity: (b, 3) of the centres of mass, m/s.
        angular_velocity: (b, 3) rad/s.
    """

    position: Array
    quaternion: Array
    linear_velocity: Array
    angular_velocity: Array

    @classmethod
    def initial(cls, mechanism: Mechanism) -> State:
        """The mechanism's initial pose, at rest."""
        return cls(
            np.array([body.center_of_mass for body in mechanism.bodies]),
            np.array([body.quaternion for body in mechanism.bodies]),
            np.zeros((len(mechanism.bodies), 3)),
            np.zeros((len(mechanism.bodies), 3)),
        )

    def frames(self) -> list[Frame]:
        """One `Frame` for each body."""
        return [
            Frame(r, rotation(p), v, w)
            for r, p, v, w in zip(
                self.position,
                self.quaternion,
                self.linear_velocity,
                self.angular_velocity,
                strict=True,
            )
        ]


@dataclass(frozen=True, eq=False)
class Evaluation:
    """What the equations of motion say at one state; world frame, SI; b bodies, j joints.

    Attributes:
        state: poses and velocities as this engine's own kinematics give them.
        linear_acceleration, angular_acceleration: (b, 3) of the bodies.
        reaction_force, reaction_torque: (j, 3) on the second body, at its joint point. Not unique where
            constraints are redundant, see `newton_euler.equations.reactions`.
        actuator_force: (a,) N or N m along the actuated coordinates.
        kinetic_energy, potential_energy: J; potential energy is that of gravity, zero at the origin, and
            of springs, zero at rest.
        work: J, done since the start by what is not in the potential energy; None if it is not tracked.
    """

    state: State
    linear_acceleration: Array
    angular_acceleration: Array
    reaction_force: Array
    reaction_torque: Array
    actuator_force: Array
    kinetic_energy: float
    potential_energy: float
    work: float | None = None


@dataclass(frozen=True, eq=False)
class MassProperties:
    """Mass properties of all b bodies, world frame at the initial pose, SI.

    Attributes:
        mass: (b,) kg.
        center_of_mass: (b, 3) m.
        inertia: (b, 3, 3) about the centre of mass, kg m^2.
    """

    mass: Array
    center_of_mass: Array
    inertia: Array

    @classmethod
    def of(cls, mechanism: Mechanism) -> MassProperties:
        """Those that the mechanism states."""
        turns = [rotation(body.quaternion) for body in mechanism.bodies]
        return cls(
            np.array([body.mass for body in mechanism.bodies]),
            np.array([body.center_of_mass for body in mechanism.bodies]),
            np.array([a @ b.inertia @ a.T for a, b in zip(turns, mechanism.bodies, strict=True)]),
        )


def energies(scene: Scene, frames: list[Frame], inertias: list[Array]) -> tuple[Scalar, Scalar]:
    """Kinetic energy and the potential energy of gravity (zero at the world origin), J.

    `inertias` are in the bodies' frames that `frames` give the rotations of.
    """
    kinetic: Scalar = 0.0
    potential: Scalar = 0.0
    for body, frame, inertia in zip(scene.mechanism.bodies[1:], frames[1:], inertias[1:], strict=True):
        spin = frame.rotation.T @ frame.angular_velocity
        kinetic = (
            kinetic + 0.5 * body.mass * (frame.velocity @ frame.velocity) + 0.5 * (spin @ inertia @ spin)
        )
        potential = potential - body.mass * (scene.gravity @ frame.position)
    return kinetic, potential
