"""The interface of equations of motion, which integrators, projection and comparison use.

The two forms of this package's equations implement `System` (`newton_euler.equations.relative` and
`newton_euler.equations.cartesian`). So do the models of other engines, which give accelerations under rigid
constraints. The state of a system is (q, v): coordinates q (nq,) and velocities v (nv,). Constraint residuals
are called Phi; Phi is zero if all loops are closed. The mechanism's size is a typical length, m.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol, TypedDict, TypeVar

import numpy as np

from newton_euler.model.euler_parameters import rotation
from newton_euler.model.joint_geometry import JointGeometry
from newton_euler.model.mechanism import Mechanism
from newton_euler.model.scene import Scene
from newton_euler.model.state import State
from newton_euler.scalars import Array, Scalar


class Energies(TypedDict):
    """Energies and work of an `Observation`, by name, J."""

    kinetic_energy: float
    potential_energy: float
    work: float | None


@dataclass(frozen=True, eq=False, kw_only=True)
class Observation:
    """Poses, velocities and energies of one state, computed by an engine; SI units.

    Attributes:
        state: poses and velocities of the bodies, by the kinematics of this engine.
        kinetic_energy: J.
        potential_energy: J, of gravity (zero at the world origin) and of springs (zero if relaxed).
        work: J, work of all forces without potential energy since the start of the run; None if it is not
            tracked.
    """

    state: State
    kinetic_energy: float
    potential_energy: float
    work: float | None = None


@dataclass(frozen=True, eq=False, kw_only=True)
class Evaluation(Observation):
    """Solution of the equations of motion at one state of a scene with b bodies, j joints and a control laws.

    Vectors are in the world frame. If constraints are redundant, reactions are not unique.

    Attributes:
        linear_acceleration: (b, 3) m/s^2, of the centers of mass.
        angular_acceleration: (b, 3) rad/s^2.
        reaction_force: (j, 3) N, on the second body of each joint.
        reaction_torque: (j, 3) N m, on the second body, about its joint point.
        actuator_force: (a,) N or N m, along the actuated joint coordinates.
    """

    linear_acceleration: Array
    angular_acceleration: Array
    reaction_force: Array
    reaction_torque: Array
    actuator_force: Array


@dataclass(frozen=True, eq=False)
class MassProperties:
    """Mass properties of all b bodies, ground first, in the world frame at the initial pose.

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
        """Collect the mass properties that the bodies of a mechanism declare."""
        bodies = mechanism.bodies
        rotations = [rotation(body.quaternion) for body in bodies]
        return cls(
            mass=np.array([body.mass for body in bodies]),
            center_of_mass=np.array([body.center_of_mass for body in bodies]),
            inertia=np.array([a @ body.inertia @ a.T for a, body in zip(rotations, bodies, strict=True)]),
        )


class System(Protocol):
    """Equations of motion with constraints: dq/dt = rate(q, v), dv/dt = acceleration(q, v)."""

    name: str
    """Name of the form of the equations, or of the engine."""
    scene: Scene
    mechanism: Mechanism
    time: Scalar
    """Time, s, at which prescribed motions, control laws and wind are evaluated."""
    nq: int
    """Length of q."""
    nv: int
    """Length of v."""
    phi_units: Array
    """(k,) divisors that make residuals `phi` dimensionless: the mechanism's size, m, for lengths, else 1."""
    velocity_units: Array
    """(nv,) divisors that give velocities the unit 1/s: the mechanism's size, m, for linear ones, else 1."""
    quaternions: list[slice]
    """Slices of q with the quaternions (w, x, y, z)."""

    def mass_properties(self) -> MassProperties:
        """Return the mass properties of the bodies as the model of this engine has them."""

    def joint_geometry(self) -> dict[str, JointGeometry]:
        """Return the joints at the initial pose, by name, as the model of this engine has them.

        A model adds a free joint for a body that only rods (constant distances) connect with others; these
        joints are not included.
        """

    def coordinates(self, state: State) -> tuple[Array, Array]:
        """Compute q (nq,) and v (nv,) of a state."""

    def state(self, q: Array, v: Array) -> State:
        """Compute the poses and velocities of the bodies by the kinematics of this engine."""

    def measure(self, q: Array, v: Array) -> list[tuple[Scalar, Scalar]]:
        """Compute each joint coordinate of `Scene.sensed`, which controllers read, and its rate; m or rad."""

    def rate(self, q: Array, v: Array) -> Array:
        """Compute dq/dt (nq,)."""

    def acceleration(self, q: Array, v: Array) -> Array:
        """Compute dv/dt (nv,)."""

    def loaded_friction(self, q: Array, v: Array, factor: float = 1.0) -> Mapping[str, Scalar]:
        """Compute the frictions that grow with reactions, N or N m, by identity of the element.

        Args:
            q, v: (nq,) and (nv,), the state.
            factor: of the load coefficients.
        """

    def mass_and_force(self, q: Array, v: Array) -> tuple[Array, Array]:
        """Compute the mass matrix M and the force f of M dv/dt = f + constraint forces.

        The force f contains gravity, velocity terms and applied forces.

        Returns:
            The matrix M of shape (nv, nv) and the force f of shape (nv,) for joint coordinates. The Cartesian
                form with n moving bodies has M of shape (6 n, 7 n) and f of shape (6 n,). A body then has six
                rows, a force in the world frame and a torque in the body frame, and seven rates in dv/dt.
        """

    def phi(self, q: Array) -> Array:
        """Compute the constraint residuals Phi (k,), m or rad, which projection removes."""

    def phi_t(self) -> Array:
        """Compute the partial derivative of `phi` with respect to time (k,); 0 without prescribed motions."""

    def coupling_phi(self, q: Array) -> Array:
        """Compute the residuals (c,) of all couplings between joint coordinates, m or rad."""

    def phi_jacobian(self, q: Array) -> Array:
        """Compute the constraint Jacobian (k, nv): derivative of `phi` for a step of `retract`."""

    def retract(self, q: Array, step: Array) -> Array:
        """Return q moved by a small step (nv,), which has the units of v times s; quaternions keep norm 1."""

    def observe(self, q: Array, v: Array) -> Observation:
        """Compute poses, velocities and energies."""

    def evaluate(self, q: Array, v: Array) -> Evaluation:
        """Compute accelerations, reactions and energies."""

    def velocity_transformation(self, q: Array) -> Array:
        """Compute the Jacobian (6 b, nv) of the velocities of bodies 0, 1, ... with respect to v.

        Each body has six rows, world frame: velocity of the center of mass, then angular velocity.
        """


S = TypeVar("S", bound=System)


def at_time(system: S, time: Scalar) -> S:
    """Return a copy of a system that is evaluated at a time, s."""
    changed = copy.copy(system)
    changed.time = time
    return changed


def dimensionless_jacobian(system: System, q: Array) -> Array:
    """Compute the constraint Jacobian (k, nv) in dimensionless form, for its rank and condition number."""
    return np.asarray(system.phi_jacobian(q) * system.velocity_units / system.phi_units[:, None])


def constraint_rate(system: System, q: Array, v: Array) -> Array:
    """Compute the rate of the constraint residuals (k,), m/s or rad/s: Phi_q v + Phi_t."""
    return rate_of_phi(system, system.phi_jacobian(q), v)


def rate_of_phi(system: System, jacobian: Array, v: Array) -> Array:
    """Compute the rate of the constraint residuals (k,) from the constraint Jacobian Phi_q (k, nv)."""
    return np.asarray(jacobian @ v + system.phi_t())


def fastest_joint(mechanism: Mechanism, state: State) -> str:
    """Find the joint whose two bodies have the largest relative velocity.

    Linear velocities are divided by the mechanism's size, to compare them with angular velocities.
    """
    with np.errstate(all="ignore"):
        motion = np.hstack([state.linear_velocity / mechanism.size, state.angular_velocity])
        # one item of `equations` per joint; `first` and `second` are the indices of its bodies
        speeds = [np.max(np.abs(motion[joint.second] - motion[joint.first])) for joint in mechanism.equations]
    return mechanism.joint_names[int(np.argmax(np.nan_to_num(speeds, nan=np.inf)))]
