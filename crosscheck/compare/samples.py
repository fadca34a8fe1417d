"""Systems at consistent states: what the levels before runs compare, each worked out when first asked for."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from crosscheck.compare.check import EPSILON
from crosscheck.compare.energy import RANDOM_RATE, energy_scale
from crosscheck.support.errors import CrosscheckError
from newton_euler.equations.dense import numerical_rank, orthonormal_range, rank, singular_values
from newton_euler.equations.redundancy import constraint_rank, mobility, rows_left_out, with_zero_rows
from newton_euler.equations.relative import Relative
from newton_euler.equations.system import Evaluation, MassProperties, System, dimensionless_jacobian
from newton_euler.equations.undetermined import undetermined
from newton_euler.model.joint_geometry import JointGeometry
from newton_euler.model.scene import Scene
from newton_euler.model.state import State
from newton_euler.scalars import Array


@contextmanager
def solved(system: System, what: str) -> Iterator[None]:
    """Linear algebra of what a system gives.

    Raises:
        CrosscheckError: naming the system, for numbers that are not finite and what LAPACK gives up.
    """
    try:
        yield
    except np.linalg.LinAlgError as error:
        raise CrosscheckError(f"{system.name}: {what} cannot be worked out: {error}") from error


@dataclass(frozen=True, eq=False)
class States:
    """Consistent states of a scene, the initial one first.

    Attributes:
        scene: the description that engines are compared on.
        all: the states.
    """

    scene: Scene
    all: tuple[State, ...]

    @cached_property
    def units(self) -> Array:
        """(6 b,) see `body_units`: the scene's for all systems."""
        return body_units(self.scene)

    @cached_property
    def _system(self) -> Relative:
        return Relative(self.scene)

    @cached_property
    def _coordinates(self) -> list[tuple[Array, Array]]:
        return [self._system.coordinates(state) for state in self.all]

    @cached_property
    def _admissible(self) -> list[tuple[Array, float]]:
        with solved(self._system, "independent velocities"):
            return [admissible_basis(self._system, q, self.units) for q, _ in self._coordinates]

    @property
    def bases(self) -> list[Array]:
        """(6 b, d) for each state: the independent velocities of "dynamics", see `admissible_basis`."""
        return [basis for basis, _ in self._admissible]

    @property
    def condition(self) -> float:
        """The largest of all states, of the scene's independent constraints."""
        return max(condition for _, condition in self._admissible)

    @property
    def is_singular(self) -> bool:
        """True if constraints lose rank at the first state: nothing determines all accelerations there."""
        q, _ = self._coordinates[0]
        with solved(self._system, "the rank of constraints"):
            return rank(dimensionless_jacobian(self._system, q)) < constraint_rank(self._system)

    @cached_property
    def opening(self) -> float:
        """See `_opening`: a state may be given with fewer digits than engines work with."""
        return _opening(self._system, self._coordinates)

    @cached_property
    def mass_condition(self) -> float:
        """The largest of all states, of the tree's mass matrix with unit diagonal.

        Factorizing it loses as many digits as after the best choice of units (N. J. Higham, Accuracy and
        Stability of Numerical Algorithms, 2nd ed., 2002, section 10.1.1).
        """
        with solved(self._system, "the condition of the mass matrix"):
            return max(_equilibrated(self._system.mass_and_force(q, v)[0]) for q, v in self._coordinates)

    @property
    def redundancy(self) -> float:
        """The largest singular value of the scene's constraints that was taken as redundant."""
        return mobility(self.scene).residual

    @cached_property
    def noise(self) -> float:
        """Relative noise of constraints: `redundancy`, or round-off of coordinates far from the origin."""
        distance = max(float(np.max(np.abs(state.position))) for state in self.all)
        return max(self.redundancy, EPSILON * distance / self.scene.mechanism.size)

    @cached_property
    def undetermined(self) -> list[Array]:
        """Undetermined reactions at each state, see `newton_euler.equations.undetermined`."""
        with solved(self._system, "reactions that nothing determines"):
            return [undetermined(self.scene, state) for state in self.all]

    @cached_property
    def energy(self) -> float:
        """J, see `energy_scale`."""
        return energy_scale(self.scene, list(self.all))

    def name(self, index: int) -> str:
        """Name a state for people."""
        return "the initial state" if index == 0 else f"random state {index}"


@dataclass(frozen=True, eq=False)
class Samples:
    """One system at a number of states."""

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
        """(b, 4) of the bodies' frames where all coordinates are zero, by the system's own kinematics."""
        mechanism = self.system.mechanism
        q, v = self.system.coordinates(State.initial(mechanism))
        return self.system.state(q, v).quaternion

    @cached_property
    def coordinates(self) -> list[tuple[Array, Array]]:
        """q and v at each state."""
        return [self.system.coordinates(state) for state in self.states.all]

    @cached_property
    def motions(self) -> list[State]:
        """Poses and velocities at each state, by the system's own kinematics."""
        return [self.system.state(q, v) for q, v in self.coordinates]

    @property
    def closes(self) -> bool:
        """True if the system has constraints in addition to its choice of coordinates."""
        return len(self.system.phi_units) > 0

    @cached_property
    def opening(self) -> float:
        """See `_opening`."""
        return _opening(self.system, self.coordinates)

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
        """Linear and angular accelerations (n, b, 3) of all bodies by the accelerations of the coordinates.

        They are the rates of the body velocities that the system's own kinematics gives along its velocities
        and its accelerations, by central differences of fourth order: those of `evaluations` come from the
        equations of bodies and hold whatever the accelerations of the coordinates are.
        """
        found = []
        for (q, v), state, vdot in zip(self.coordinates, self.motions, self.accelerations, strict=True):
            size = self.states.scene.mechanism.size
            speeds = [np.abs(state.linear_velocity).max() / size, np.abs(state.angular_velocity).max()]
            step = RATE_STEP / max(RANDOM_RATE, *speeds)
            rates = np.zeros((2, len(state.linear_velocity), 3))
            for factor, weight in RATE_STENCIL:
                at = factor * step
                moved = self.system.state(self.system.retract(q, at * v), v + at * vdot)
                rates += weight / step * np.array([moved.linear_velocity, moved.angular_velocity])
            found.append(rates)
        linear, angular = np.moveaxis(np.array(found), 1, 0)
        return linear, angular

    @cached_property
    def _bases(self) -> list[tuple[Array, float]]:
        with solved(self.system, "independent velocities"):
            return [admissible_basis(self.system, q, self.states.units) for q, _ in self.coordinates]

    @property
    def bases(self) -> list[Array]:
        """(6 b, d) at each state, see `admissible_basis`."""
        return [basis for basis, _ in self._bases]

    @cached_property
    def condition(self) -> float:
        """Largest condition number of the constraints over all states."""
        return max(condition for _, condition in self._bases)

    @cached_property
    def free_motions(self) -> list[tuple[Array, Array]]:
        """Inertia (d, d) and force (d,) at each state, see `free_motion`, for the bases of the states."""
        found = zip(self.coordinates, self.evaluations, self.accelerations, self.states.bases, strict=True)
        with solved(self.system, "effective inertia and force"):
            return [
                free_motion(self.system, q, v, evaluation, vdot, basis, self.states.units)
                for (q, v), evaluation, vdot, basis in found
            ]

    def stack(self, name: str) -> Array:
        """(n, bodies or joints, ...) array of that name, of the motions or else of the evaluations."""
        if name not in self._stacks:
            sources = self.motions if hasattr(self.motions[0], name) else self.evaluations
            self._stacks[name] = np.array([getattr(source, name) for source in sources])
        return self._stacks[name]

    @cached_property
    def _stacks(self) -> dict[str, Array]:
        """Arrays by name."""
        return {}

    @cached_property
    def scales(self) -> Scales:
        """Scales of differences from these samples."""
        return Scales(self)


RATE_STEP = 1e-3
"""rad, or sizes of the mechanism, that bodies move between the points of `RATE_STENCIL`."""

RATE_STENCIL = ((-2.0, 1.0 / 12.0), (-1.0, -2.0 / 3.0), (1.0, 2.0 / 3.0), (2.0, -1.0 / 12.0))
"""Steps and weights of the central difference of fourth order."""

RATE_ERROR = 1e-9
"""Relative error of these accelerations: truncation is of the order of `RATE_STEP`^4, round-off of 1e-16 over
`RATE_STEP`; both a thousand times over."""


def body_units(scene: Scene) -> Array:
    """(6 b,) units of body velocities: sizes a second and radians a second."""
    size = scene.mechanism.size
    return np.tile([size, size, size, 1.0, 1.0, 1.0], len(scene.mechanism.bodies))


def admissible_basis(system: System, q: Array, units: Array) -> tuple[Array, float]:
    """Orthonormal (6 b, d) body velocities that the constraints leave free, and their condition.

    Velocities are divided by `body_units`, so that all rows are in 1/s. The projector onto them
    is the constraint Jacobian in a form that depends on no choice of coordinates or rows. The condition is
    that of the independent constraint rows, 1 without constraints.
    """
    jacobian = with_zero_rows(dimensionless_jacobian(system, q), rows_left_out(system))
    transformation = system.velocity_transformation(q) * system.velocity_units / units[:, None]
    if not jacobian.size:
        return orthonormal_range(transformation), 1.0
    _, values, directions = singular_values(jacobian, full=True)
    count = numerical_rank(values)
    basis = orthonormal_range(transformation @ directions[count:].T)
    return basis, float(values[0] / values[count - 1]) if count else 1.0


def free_motion(
    system: System, q: Array, v: Array, evaluation: Evaluation, vdot: Array, basis: Array, units: Array
) -> tuple[Array, Array]:
    """Inertia (d, d), kg m^2, and force (d,), N m, that independent velocities see.

    With the columns W of `basis` as velocities of all bodies, V = U W y with the units U of
    `body_units`, the equations of motion M vdot = f + J^T lambda become

        (Y^T M Y) dy/dt = Y^T (f - M v_p),   T Y = U W,   J Y = 0

    where T is the system's velocity transformation and v_p is any acceleration of its coordinates under
    which the bodies accelerate across W alone, as the constraints make them at this velocity. Both sides
    are the same for all coordinates (J. Garcia de Jalon, E. Bayo, Kinematic and Dynamic Simulation of
    Multibody Systems, 1994, section 5.2), and hold nothing that was solved for.
    """
    transformation = system.velocity_transformation(q) * system.velocity_units / units[:, None]
    mass, force = system.mass_and_force(q, v)
    mass = mass * system.velocity_units
    accelerations = np.hstack([evaluation.linear_acceleration, evaluation.angular_acceleration]).ravel()
    along = basis.T @ (accelerations / units)
    if len(mass) < system.nv:  # Cartesian: T qddot are the accelerations, because Gdot pdot = 0
        motion = _least_squares(transformation, np.column_stack([basis, accelerations / units]))
        velocities, acceleration = motion[:, :-1], motion[:, -1]
        onto = _on_wrenches(evaluation.state, units[:, None] * basis)
    else:
        jacobian = dimensionless_jacobian(system, q)
        rows = np.concatenate([transformation, jacobian])  # T is silent on halves of bodies
        right = np.concatenate([basis, np.zeros((len(jacobian), basis.shape[1]))])
        velocities = _least_squares(rows, right)
        acceleration = vdot / system.velocity_units
        onto = system.velocity_units[:, None] * velocities
    across = acceleration - velocities @ along
    return onto.T @ mass @ velocities, onto.T @ (force - mass @ across)


def _opening(system: System, coordinates: list[tuple[Array, Array]]) -> float:
    """Measure a system's own constraint residuals at some states, in sizes or rad."""
    units = system.phi_units
    return max(float(np.max(np.abs(system.phi(q)) / units, initial=0.0)) for q, _ in coordinates)


def _least_squares(matrix: Array, right: Array) -> Array:
    if not (np.isfinite(matrix).all() and np.isfinite(right).all()):
        raise np.linalg.LinAlgError("a matrix is not finite")  # LAPACK might go on for ever
    return np.asarray(np.linalg.lstsq(matrix, right)[0])


def _equilibrated(mass: Array) -> float:
    """Condition of a mass matrix scaled to a unit diagonal."""
    if not len(mass):
        return 1.0
    if not np.isfinite(mass).all() or not np.all(np.diag(mass) > 0.0):
        raise np.linalg.LinAlgError("its diagonal is not finite and positive")
    scale = 1.0 / np.sqrt(np.diag(mass))
    return float(np.linalg.cond(mass * np.outer(scale, scale)))


def _on_wrenches(state: State, velocities: Array) -> Array:
    """Velocities of all bodies (6 b, d) against forces, world, and torques, body, of those that move."""
    turned = velocities.reshape(len(state.position), 6, -1).copy()
    for body, frame in zip(turned, state.frames(), strict=True):
        body[3:] = frame.rotation.T @ body[3:]
    return turned[1:].reshape(-1, velocities.shape[1])


class Scales:
    """Scales of differences at a number of states: the largest values there, with physical floors.

    Angular quantities count at the mechanism's size, so that a ball's torque, which vanishes, is held
    against its force.
    """

    def __init__(self, samples: Samples) -> None:
        self._samples = samples
        self._scene = samples.states.scene
        self.size = self._scene.mechanism.size

    def _norms(self, name: str) -> Array:
        return np.asarray(np.linalg.norm(self._samples.stack(name), axis=-1))

    @cached_property
    def velocity(self) -> float:
        """m/s, at least the size at `RANDOM_RATE`."""
        rates = [self._norms("linear_velocity"), self.size * self._norms("angular_velocity")]
        return float(np.max(rates, initial=self.size * RANDOM_RATE))

    @cached_property
    def acceleration(self) -> float:
        """m/s^2, at least gravity and the centripetal one of the velocity at the size."""
        floor = max(float(np.linalg.norm(self._scene.gravity)), self.velocity**2 / self.size)
        rates = [self._norms("linear_acceleration"), self.size * self._norms("angular_acceleration")]
        return float(np.max(rates, initial=floor))

    @cached_property
    def force(self) -> float:
        """N, at least the largest inertia force and the energy of `energy_scale` over the size."""
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
