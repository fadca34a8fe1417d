"""Equations of motion of an engine at given states, in forms that can be compared between engines.

`States` are states of a scene that satisfy the constraints, with properties of the scene's constraints and
masses there, computed by newton_euler (this project's solver). `Samples` is one system (the equations of
motion of an engine, in one formulation, that is, choice of coordinates) at these states: poses, velocities,
accelerations, reactions, and the equations projected onto the velocities that the constraints allow. The
comparison of two engines uses the samples of both. All attributes are computed when they are first used.

"Size" is the characteristic length of the mechanism, m: the largest distance of joint points and centers of
mass from their mean. Shapes: b bodies (body 0 is the ground), j joints, n states, d degrees
of freedom, nv velocities of a system.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from crosscheck.compare.allowed_motions import admissible_basis, body_units, free_motion
from crosscheck.compare.check import MACHINE_EPSILON
from crosscheck.engines.energy import RANDOM_RATE, min_energy_scale
from crosscheck.support.errors import CrosscheckError
from newton_euler.equations.dense import rank
from newton_euler.equations.redundancy import constraint_rank, mobility
from newton_euler.equations.relative import Relative
from newton_euler.equations.system import Evaluation, MassProperties, System, dimensionless_jacobian
from newton_euler.equations.undetermined import undetermined
from newton_euler.model.joint_geometry import JointGeometry
from newton_euler.model.scene import Scene
from newton_euler.model.state import State
from newton_euler.scalars import Array


@contextmanager
def solved(system: System, what: str) -> Iterator[None]:
    """Convert an error of linear algebra in the block into a `CrosscheckError` that names the system.

    Args:
        system: system whose equations are solved.
        what: result that cannot be computed, for the message.

    Raises:
        CrosscheckError: for a matrix that is not finite, or that LAPACK cannot decompose.
    """
    try:
        yield
    except np.linalg.LinAlgError as error:
        raise CrosscheckError(f"{system.name}: {what} cannot be computed: {error}") from error


@dataclass(frozen=True, eq=False)
class States:
    """States of a scene that satisfy its constraints, and newton_euler's constraints at these states.

    Attributes:
        scene: scene that engines are compared on.
        all: the states; the first one is the initial state unless that is singular.
    """

    scene: Scene
    all: tuple[State, ...]

    @cached_property
    def units(self) -> Array:
        """(6 b,) units of body velocities, see `body_units`."""
        return body_units(self.scene)

    @cached_property
    def _system(self) -> Relative:
        """newton_euler's equations of motion in joint coordinates."""
        return Relative(self.scene)

    @cached_property
    def _coordinates(self) -> list[tuple[Array, Array]]:
        """Coordinates q and velocities v of `_system` at each state."""
        return [self._system.coordinates(state) for state in self.all]

    @cached_property
    def _admissible(self) -> list[tuple[Array, float]]:
        """Basis of the allowed body velocities and condition number of the constraints at each state, see
        `admissible_basis`."""
        with solved(self._system, "independent velocities"):
            return [admissible_basis(self._system, q, self.units) for q, _ in self._coordinates]

    @property
    def bases(self) -> list[Array]:
        """(6 b, d) at each state: basis of the body velocities that the constraints allow."""
        return [basis for basis, _ in self._admissible]

    @property
    def condition(self) -> float:
        """Largest condition number of the scene's independent constraints over all states."""
        return max(condition for _, condition in self._admissible)

    @property
    def is_singular(self) -> bool:
        """True if the constraints lose rank at the first state: accelerations are not unique there."""
        q, _ = self._coordinates[0]
        with solved(self._system, "the rank of constraints"):
            return rank(dimensionless_jacobian(self._system, q)) < constraint_rank(self._system)

    @cached_property
    def closure_error(self) -> float:
        """Largest constraint residual of the states, sizes or rad; not 0 for states given with few digits."""
        return _closure_error(self._system, self._coordinates)

    @cached_property
    def mass_condition(self) -> float:
        """Largest condition number of the mass matrix in joint coordinates over all states.

        The matrix is scaled to a unit diagonal, so that the number does not depend on units (N. J. Higham,
        Accuracy and Stability of Numerical Algorithms, 2nd ed., 2002, section 10.1.1).
        """
        with solved(self._system, "the condition of the mass matrix"):
            masses = (self._system.mass_and_force(q, v)[0] for q, v in self._coordinates)
            return max(_scaled_condition(mass) for mass in masses)

    @property
    def redundancy(self) -> float:
        """Largest singular value of the dimensionless constraint Jacobian that is treated as zero: 0 unless
        constraints are nearly redundant."""
        return mobility(self.scene).residual

    @cached_property
    def noise(self) -> float:
        """Relative error of constraints: `redundancy`, or the round-off of coordinates far from the origin if
        that is larger."""
        distance = max(float(np.max(np.abs(state.position))) for state in self.all)
        return max(self.redundancy, MACHINE_EPSILON * distance / self.scene.mechanism.size)

    @cached_property
    def undetermined(self) -> list[Array]:
        """(6 j, r) at each state: basis of the r combinations of joint reactions that redundant constraints
        leave undetermined."""
        with solved(self._system, "undetermined reactions"):
            return [undetermined(self.scene, state) for state in self.all]

    @cached_property
    def energy(self) -> float:
        """Lower bound, J, of the units that energy differences are divided by, see `min_energy_scale`."""
        return min_energy_scale(self.scene, list(self.all))

    def name(self, index: int) -> str:
        """Name the state with an index, for messages; the first one counts as the initial state."""
        return "the initial state" if index == 0 else f"random state {index}"


@dataclass(frozen=True, eq=False)
class Samples:
    """Equations of motion of one engine at a number of states.

    Attributes:
        system: the equations, with rigid constraints also for MuJoCo, whose runs have soft constraints.
        states: the states.
    """

    system: System
    states: States

    @property
    def name(self) -> str:
        """Name of the system."""
        return self.system.name

    @cached_property
    def mass_properties(self) -> MassProperties:
        """Mass properties of the system's own model."""
        return self.system.mass_properties()

    @cached_property
    def joints(self) -> dict[str, JointGeometry]:
        """Joint geometry of the system's own model."""
        return self.system.joint_geometry()

    @cached_property
    def initial_orientations(self) -> Array:
        """(b, 4) quaternions (w, x, y, z) of bodies at the initial pose, by the system's own kinematics."""
        mechanism = self.system.mechanism
        q, v = self.system.coordinates(State.initial(mechanism))
        return self.system.state(q, v).quaternion

    @cached_property
    def coordinates(self) -> list[tuple[Array, Array]]:
        """Coordinates q and velocities v (nv,) of the system at each state."""
        return [self.system.coordinates(state) for state in self.states.all]

    @cached_property
    def motions(self) -> list[State]:
        """Poses and velocities at each state, by the system's own kinematics."""
        return [self.system.state(q, v) for q, v in self.coordinates]

    @property
    def has_constraints(self) -> bool:
        """True if the system has constraint equations, for example of loops cut open by joint coordinates."""
        return len(self.system.phi_units) > 0

    @cached_property
    def closure_error(self) -> float:
        """Largest constraint residual of the system over all states, sizes of the mechanism or rad."""
        return _closure_error(self.system, self.coordinates)

    @cached_property
    def evaluations(self) -> list[Evaluation]:
        """Accelerations and reactions at each state."""
        with solved(self.system, "accelerations"):
            return [self.system.evaluate(q, v) for q, v in self.coordinates]

    @cached_property
    def accelerations(self) -> list[Array]:
        """Accelerations (nv,) of the system's velocities at each state."""
        with solved(self.system, "accelerations"):
            return [np.asarray(self.system.acceleration(q, v)) for q, v in self.coordinates]

    @cached_property
    def coordinate_accelerations(self) -> tuple[Array, Array]:
        """Linear and angular accelerations (n, b, 3) of all bodies that follow from coordinate accelerations.

        The body velocities are differentiated along the motion of the coordinates, by central differences of
        fourth order. The accelerations in `evaluations` come from the equations of bodies instead, so they
        would not show an error in the coordinate accelerations.
        """
        all_rates = []  # (2, b, 3) at each state: linear and angular accelerations
        for (q, v), state, vdot in zip(self.coordinates, self.motions, self.accelerations, strict=True):
            # A time step in which bodies move by at most `RATE_STEP`, also at the usual rate of random states
            size = self.states.scene.mechanism.size
            speeds = [np.abs(state.linear_velocity).max() / size, np.abs(state.angular_velocity).max()]
            step = RATE_STEP / max(RANDOM_RATE, *speeds)
            rates = np.zeros((2, len(state.linear_velocity), 3))
            for factor, weight in RATE_STENCIL:
                time = factor * step
                moved = self.system.state(self.system.retract(q, time * v), v + time * vdot)
                rates += weight / step * np.array([moved.linear_velocity, moved.angular_velocity])
            all_rates.append(rates)
        linear, angular = np.moveaxis(np.array(all_rates), 1, 0)
        return linear, angular

    @cached_property
    def _admissible(self) -> list[tuple[Array, float]]:
        """Basis of the allowed body velocities and condition number of the constraints at each state, see
        `admissible_basis`."""
        with solved(self.system, "independent velocities"):
            return [admissible_basis(self.system, q, self.states.units) for q, _ in self.coordinates]

    @property
    def bases(self) -> list[Array]:
        """(6 b, d) at each state: basis of the body velocities that the system's constraints allow."""
        return [basis for basis, _ in self._admissible]

    @cached_property
    def condition(self) -> float:
        """Largest condition number of the constraints over all states."""
        return max(condition for _, condition in self._admissible)

    @cached_property
    def free_motions(self) -> list[tuple[Array, Array]]:
        """Effective inertia (d, d) and force (d,) at each state, see `free_motion`.

        The basis is that of the scene's constraints (`States.bases`), so that engines can be compared.
        """
        by_state = zip(self.coordinates, self.evaluations, self.accelerations, self.states.bases, strict=True)
        with solved(self.system, "effective inertia and force"):
            return [
                free_motion(self.system, q, v, evaluation, vdot, basis, self.states.units)
                for (q, v), evaluation, vdot, basis in by_state
            ]

    def stack(self, name: str) -> Array:
        """Return a quantity at all states as one array (n, ...), such as (n, b, 3) for a vector of bodies.

        Args:
            name: name of an attribute of `State` (taken from `motions`) or of `Evaluation`.
        """
        if name not in self._stacks:
            sources = self.motions if hasattr(self.motions[0], name) else self.evaluations
            self._stacks[name] = np.array([getattr(source, name) for source in sources])
        return self._stacks[name]

    @cached_property
    def _stacks(self) -> dict[str, Array]:
        """Arrays that `stack` has built, by name."""
        return {}

    @cached_property
    def scales(self) -> Scales:
        """Units that differences from these samples are divided by."""
        return Scales(self)


RATE_STEP = 1e-3
"""Largest displacement of bodies between two points of `RATE_STENCIL`, sizes of the mechanism or rad."""

RATE_STENCIL = ((-2.0, 1.0 / 12.0), (-1.0, -2.0 / 3.0), (1.0, 2.0 / 3.0), (2.0, -1.0 / 12.0))
"""Points (in time steps) and weights of the central difference of fourth order for a first derivative."""

RATE_ERROR = 1e-9
"""Tolerance of `Samples.coordinate_accelerations`, relative. Their truncation error is about `RATE_STEP`^4 =
1e-12, and their round-off about 1e-16 / `RATE_STEP` = 1e-13; the tolerance is a thousand times larger."""


def _closure_error(system: System, coordinates: list[tuple[Array, Array]]) -> float:
    """Compute a system's largest constraint residual at some states, sizes of the mechanism or rad."""
    units = system.phi_units
    return max(float(np.max(np.abs(system.phi(q)) / units, initial=0.0)) for q, _ in coordinates)


def _scaled_condition(mass: Array) -> float:
    """Compute the condition number of a mass matrix (nv, nv) after scaling it to a unit diagonal."""
    if not len(mass):
        return 1.0
    if not np.isfinite(mass).all() or not np.all(np.diag(mass) > 0.0):
        raise np.linalg.LinAlgError("its diagonal is not finite and positive")
    scale = 1.0 / np.sqrt(np.diag(mass))
    return float(np.linalg.cond(mass * np.outer(scale, scale)))


class Scales:
    """Units that relative differences are divided by: the largest values at all states, with lower bounds.

    The unit of an angular quantity is that of the linear quantity divided by the mechanism's size (times the
    size for torques). The torque of a ball joint, for example, which is zero, is compared relative to the
    largest force.
    """

    def __init__(self, samples: Samples) -> None:
        self._samples = samples
        self._scene = samples.states.scene
        self.size = self._scene.mechanism.size

    def _norms(self, name: str) -> Array:
        """Compute norms (n, b or j) of a vector quantity at all states, see `Samples.stack`."""
        return np.asarray(np.linalg.norm(self._samples.stack(name), axis=-1))

    @cached_property
    def velocity(self) -> float:
        """Unit of velocities, m/s; at least the size times `RANDOM_RATE`, the rate of random states, 1/s."""
        rates = [self._norms("linear_velocity"), self.size * self._norms("angular_velocity")]
        return float(np.max(rates, initial=self.size * RANDOM_RATE))

    @cached_property
    def acceleration(self) -> float:
        """Unit of accelerations, m/s^2; at least gravity, and velocity^2 / size."""
        floor = max(float(np.linalg.norm(self._scene.gravity)), self.velocity**2 / self.size)
        rates = [self._norms("linear_acceleration"), self.size * self._norms("angular_acceleration")]
        return float(np.max(rates, initial=floor))

    @cached_property
    def force(self) -> float:
        """Unit of forces, N; at least the largest inertia force, and `States.energy` divided by the size."""
        bodies = self._scene.mechanism.bodies
        mass = np.array([body.mass for body in bodies])
        moment = np.array([np.linalg.norm(body.inertia, ord=2) for body in bodies])
        inertia = [
            mass * self._norms("linear_acceleration"),
            moment * self._norms("angular_acceleration") / self.size,
        ]
        floor = max(float(np.max(inertia)), self._samples.states.energy / self.size)
        forces = [self._norms("reaction_force"), self._norms("reaction_torque") / self.size]
        return float(np.max(forces, initial=floor))
