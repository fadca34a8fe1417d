"""The protocol of equations of motion, for integrators, projection and comparison.

Both formulations of this package are such systems, and so are other engines' models once they are
asked for accelerations under rigid constraints.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass
from typing import Protocol, TypeVar

import numpy as np

from newton_euler.model.euler_parameters import rotation
from newton_euler.model.joint_geometry import JointGeometry
from newton_euler.model.mechanism import Mechanism
from newton_euler.model.scene import Scene
from newton_euler.model.state import State
from newton_euler.scalars import Array, Scalar


@dataclass(frozen=True, eq=False, kw_only=True)
class Observation:
    """Poses, velocities and energies of one state in an engine; SI units.

    Attributes:
        state: poses and velocities as this engine's own kinematics give them.
        kinetic_energy, potential_energy: J; potential energy is that of gravity, zero at the origin, and
            of springs, zero at rest.
        work: J, done since the start by forces without potential energy; None if it is not tracked.
    """

    state: State
    kinetic_energy: float
    potential_energy: float
    work: float | None = None


@dataclass(frozen=True, eq=False, kw_only=True)
class Evaluation(Observation):
    """Solution of the equations of motion at one state; world frame, SI; b bodies, j joints.

    Attributes:
        linear_acceleration, angular_acceleration: (b, 3) of the bodies.
        reaction_force, reaction_torque: (j, 3) on the second body, at its joint point. Not unique where
            constraints are redundant, see `newton_euler.equations.reactions`.
        actuator_force: (a,) N or N m along the actuated coordinates.
    """

    linear_acceleration: Array
    angular_acceleration: Array
    reaction_force: Array
    reaction_torque: Array
    actuator_force: Array


@dataclass(frozen=True, eq=False)
class MassProperties:
    """Mass properties of all b bodies, world frame at the initial pose, SI.

    Attributes:
        mass: (b,) kg.
        center_of_mass: (b, 3) m.
        inertia: (b, 3, 3) about the center of mass, kg m^2.
    """

    mass: Array
    center_of_mass: Array
    inertia: Array

    @classmethod
    def of(cls, mechanism: Mechanism) -> MassProperties:
        """Return the mass properties that the mechanism states."""
        turns = [rotation(body.quaternion) for body in mechanism.bodies]
        return cls(
            np.array([body.mass for body in mechanism.bodies]),
            np.array([body.center_of_mass for body in mechanism.bodies]),
            np.array([a @ b.inertia @ a.T for a, b in zip(turns, mechanism.bodies, strict=True)]),
        )


class System(Protocol):
    """Second-order equations with constraints: qdot = rate(q, v), vdot = acceleration(q, v)."""

    name: str
    scene: Scene
    mechanism: Mechanism
    time: Scalar
    """Time of prescribed motions, control laws and wind, s."""
    nq: int
    nv: int
    phi_units: Array
    """(k,) units of the rows of `phi`: the mechanism's size for meters, 1 for radians."""
    velocity_units: Array
    """(nv,) units of velocities."""
    quaternions: list[slice]
    """Places of Euler parameters in q."""

    def mass_properties(self) -> MassProperties:
        """Return the mass properties of the bodies in this system's own model."""

    def joint_geometry(self) -> dict[str, JointGeometry]:
        """Return the joints of this system's own model at the initial pose, by name.

        Joints that a model adds for bodies that only rods hold are left out.
        """

    def coordinates(self, state: State) -> tuple[Array, Array]:
        """Compute q (nq,) and v (nv,) of a state."""

    def state(self, q: Array, v: Array) -> State:
        """Compute body poses and velocities by this system's own kinematics."""

    def measure(self, q: Array, v: Array) -> list[tuple[Scalar, Scalar]]:
        """Compute the coordinates (m or rad) and rates of `Scene.sensed`."""

    def rate(self, q: Array, v: Array) -> Array:
        """Compute qdot (nq,)."""

    def acceleration(self, q: Array, v: Array) -> Array:
        """Compute vdot (nv,)."""

    def mass_and_force(self, q: Array, v: Array) -> tuple[Array, Array]:
        """Compute M and f of M vdot = f + reactions; f has gravity, velocity terms and applied forces.

        (nv, nv) and (nv,) for coordinates of a tree; (6 n, 7 n) and (6 n,) for the Cartesian form of n moving
        bodies, whose rows are forces in the world and torques in the body.
        """

    def phi(self, q: Array) -> Array:
        """Compute the constraint residuals (k,) that projection removes."""

    def phi_t(self) -> Array:
        """Compute the partial derivative (k,) of `phi` by time, which prescribed motions have."""

    def coupling_phi(self, q: Array) -> Array:
        """Compute residuals (c,) of all couplings, m or rad."""

    def phi_jacobian(self, q: Array) -> Array:
        """Compute the derivative (k, nv) of `phi` along `retract`, and of its rate by v."""

    def retract(self, q: Array, step: Array) -> Array:
        """Move q by a small step (nv,)."""

    def observe(self, q: Array, v: Array) -> Observation:
        """Compute poses, velocities and energies."""

    def evaluate(self, q: Array, v: Array) -> Evaluation:
        """Compute accelerations, reactions and energies."""

    def velocity_transformation(self, q: Array) -> Array:
        """Compute v and omega of body 0, 1, ... for each velocity, (6 b, nv)."""


S = TypeVar("S", bound=System)


def at_time(system: S, time: float) -> S:
    """Copy a system to a time in s."""
    changed = copy.copy(system)
    changed.time = time
    return changed


def dimensionless_jacobian(system: System, q: Array) -> Array:
    """Compute the dimensionless `phi_jacobian` (k, nv), for ranks and condition numbers."""
    return np.asarray(system.phi_jacobian(q) * system.velocity_units / system.phi_units[:, None])


def constraint_rate(system: System, q: Array, v: Array) -> Array:
    """Compute dPhi/dt (k,) = Phi_q qdot + Phi_t."""
    return rate_of_phi(system, system.phi_jacobian(q), v)


def rate_of_phi(system: System, jacobian: Array, v: Array) -> Array:
    """Compute dPhi/dt (k,) from Phi_q (k, nv)."""
    return np.asarray(jacobian @ v + system.phi_t())


def fastest_joint(mechanism: Mechanism, state: State) -> str:
    """Find the joint whose bodies have the largest relative velocity, in mechanism sizes and rad per s."""
    with np.errstate(all="ignore"):
        motion = np.hstack([state.linear_velocity / mechanism.size, state.angular_velocity])
        speeds = [np.max(np.abs(motion[e.second] - motion[e.first])) for e in mechanism.equations]
    return mechanism.joint_names[int(np.argmax(np.nan_to_num(speeds, nan=np.inf)))]
