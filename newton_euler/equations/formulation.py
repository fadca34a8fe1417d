"""Base class of the two forms of the equations of motion: joint coordinates and Cartesian coordinates.

The class `Formulation` has what both forms share: couplings between joint coordinates, prescribed motions,
angles whose revolutions are counted (`newton_euler.equations.couplings`), work, energies and inverse
dynamics. The subclasses `newton_euler.equations.relative.Relative` and
`newton_euler.equations.cartesian.Cartesian` compute frames, mass matrix and constraint Jacobian. All methods
accept floats, or symbolic scalars when the equations are traced for compilation.

A key (joint, number) names a joint coordinate: a hinge angle or a slide displacement. Constraint residuals
are called Phi, their Jacobian Phi_q; gamma is the right side of Phi_q dv/dt = gamma.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from functools import cache, partial
from typing import Any, NamedTuple, TypeVar

import numpy as np

from newton_euler.equations import sparse
from newton_euler.equations.applied_forces import energies, power
from newton_euler.equations.couplings import (
    Measured,
    carried_angles,
    carried_rates,
    couplings,
    measured_coordinates,
    needed_coordinates,
    row_owners,
    row_units,
)
from newton_euler.equations.load_friction import HeldFriction, loaded_frictions, solve_frictions
from newton_euler.equations.revolutions import revolutions
from newton_euler.equations.sparse import Equations, Rows, RowsInUse, Solution, dot, sparse_vector, to_array
from newton_euler.equations.system import Evaluation, MassProperties, Observation, System
from newton_euler.model.constraints import Frame
from newton_euler.model.elements import Surroundings
from newton_euler.model.joint import JointEquations, Key, Pose
from newton_euler.model.joint_geometry import JointGeometry, geometry_in_mechanism
from newton_euler.model.scene import Scene
from newton_euler.model.state import State
from newton_euler.scalars import Array, Scalar, minimum

T = TypeVar("T")
MAX_REMEMBERED_STATES = 64
"""Number of most recent states whose kinematics a formulation keeps, so that they are computed once."""


class Servos(NamedTuple):
    """Data of inverse dynamics: joint coordinates with desired accelerations, and the actuators.

    `newton_euler.equations.servos.servos_of` checks that the actuators can cause any accelerations.

    Attributes:
        coordinates: (d,) keys of the coordinates z with desired accelerations, independent of each other.
        actuators: (a,) keys of the coordinates on which actuators act: z itself, or at least d others. In
            the second case z must determine the whole motion.
        rows: independent constraint rows, which the solution uses.
        scales: reference magnitudes of the pivots in the elimination of these rows, then of the additional
            rows that prescribe the accelerations of z; None if unknown. See `newton_euler.equations.sparse`.
    """

    coordinates: tuple[Key, ...]
    actuators: tuple[Key, ...]
    rows: RowsInUse
    scales: list[float] | None = None

    def with_flags(self, flags: Mapping[int, Scalar] | None) -> Servos:
        """Return a copy with flags by constraint row, 1 to omit the row; the same data without flags."""
        return self._replace(rows=self.rows._replace(flags=flags)) if flags else self


class Formulation(System):
    """A form of the equations of motion of a scene, over floats or symbolic scalars.

    q (nq,) holds the form's own coordinates, then the carried angles, then the work of forces if the scene
    tracks it. The own coordinates are those of a spanning tree or the poses of all bodies. A carried angle is
    the integral of an angle's rate, which counts revolutions. v (nv,) holds the velocities of the own
    coordinates.

    Attributes:
        name: "relative" for joint coordinates, "cartesian" for Cartesian coordinates.
        scene, mechanism: the scene and its mechanism.
        nq, nv: lengths of q and v.
        K_D, K_P: gains of Baumgarte's stabilization, 1/s and 1/s^2, which is in gamma; 0 without it.
        time: time of prescribed motions, s.
        poses: reference pose of each body, ground first, which defines the body frame.
        equations: constraint equations of all joints, in the body frames of `poses`.
        constrained: constraint equations of the joints that have Lagrange multipliers in this form.
        couplings: gears, screws and prescribed motions as constraint equations.
        rows: number of equations of `constrained` and of the couplings.
        places: indices in q and in v of each joint coordinate that forces, couplings and armatures depend on,
            by key; None for a coordinate that is not one of the own coordinates.
        between: joint coordinates without indices in `places`, which are measured between two bodies.
        angles: index in q of each angle whose revolutions are counted, by key.
        carried, work: slices of q with the carried angles and the work.
        in_use: constraint rows in use while the equations are evaluated over symbolic scalars; all other rows
            follow from them. None over floats.
        omitted: numbers of the rows of `phi` that solvers omit as redundant; None for the rows that
            `newton_euler.equations.redundancy.rows_left_out` selects.
        branches: flags of switched forces (dry friction, stops of joints) by identity, which integrators hold
            during a step; without flags the state decides.
        held_friction: given frictions that would grow with reactions, to compute the reactions of others;
            None to solve for them.
        phi_units: (k,) divisors that make the rows of `phi` dimensionless: the mechanism's size, m, for a row
            in meters, else 1.
        row_owners: (k,) name of the joint, coupling or body that each row of `phi` belongs to.
        inertias: (3, 3) of each body about its center of mass, in its body frame, kg m^2.
        velocity_units: (nv,) divisors that give all elements of v the unit 1/s: the mechanism's size, m, for
            linear velocities, else 1.
        coordinate_units: divisors that make the own coordinates dimensionless: the mechanism's size, m, for
            lengths, else 1.
        quaternions: slices of q with quaternions (w, x, y, z).
        model_control: list, shared by all copies of this object, with one
            `newton_euler.equations.model_control.ModelControl`, which computes the forces of control laws
            that use a model of the mechanism. The list is empty until these forces are needed.
    """

    name: str
    inertias: list[Array]
    velocity_units: Array
    coordinate_units: Array
    quaternions: list[slice]

    def __init__(
        self,
        scene: Scene,
        alpha: float,
        poses: list[Pose],
        equations: Sequence[JointEquations],
        constrained: Sequence[JointEquations],
        nq: int,
        nv: int,
    ) -> None:
        """Collect the constraints of joints and couplings, and lay out q.

        Args:
            scene: the scene.
            alpha: 1/s, Baumgarte's parameter; 0 for no stabilization.
            poses, equations, constrained: see the attributes of this class.
            nq, nv: numbers of the form's own coordinates and of their velocities.
        """
        # scene, Baumgarte's gains, constraint rows
        self.scene, self.mechanism = scene, scene.mechanism
        # eqs (30) and (31) with zeta = 1 of the paper cited in `newton_euler.equations.cartesian`
        self.K_D, self.K_P = 2.0 * alpha, alpha * alpha
        self.poses, self.equations, self.constrained = poses, equations, constrained
        self.time: Scalar = 0.0
        self.in_use: RowsInUse | None = None
        self.omitted: list[int] | None = None
        self.branches: Mapping[str, Iterable[Scalar]] = {}
        self.held_friction: HeldFriction | None = None
        self.couplings = couplings(scene)
        self.rows = sum(e.count for e in constrained) + len(self.couplings)
        self.phi_units = row_units(constrained, self.couplings, self.mechanism.size)
        self.row_owners = row_owners(constrained, self.couplings)
        # joint coordinates that forces, couplings and armatures (rotor inertias) depend on; armatures do not
        # depend on the number of revolutions
        needed = needed_coordinates(scene, self.couplings)
        rotors = (armature.key for armature in scene.armatures if not armature.on_ball)
        self.places = {key: self.place(key) for key in [*needed, *rotors]}
        not_own = {
            key: equations[self.mechanism.joint_index(key[0])]
            for key, place in self.places.items()
            if place is None
        }
        self.between = measured_coordinates(not_own, first_index=nq, counted=needed)
        # counted angles are own coordinates, or carried angles behind the own coordinates
        self.angles: dict[Key, int] = {}
        for key in needed:
            place = self.places[key]
            on_q = self.between[key].carried if place is None else place[0]
            if on_q is not None and not self.mechanism.is_slide(*key):
                self.angles[key] = on_q
        carried = sum(coordinate.carried is not None for coordinate in self.between.values())
        # layout of q: own coordinates, carried angles, work
        self.carried = slice(nq, nq + carried)
        self.work = slice(nq + carried, nq + carried + int(scene.tracks_work))
        self.nq, self.nv = self.work.stop, nv
        self._states: dict[Any, tuple[tuple[Array, Array], Any]] = {}
        self.model_control: list[Any] = []

    def unit(self, key: Key) -> float:
        """Return the unit of a joint coordinate: the mechanism's size, m, for a slide, 1 for an angle."""
        return self.mechanism.size if self.mechanism.is_slide(*key) else 1.0

    @property
    def uncounted_angles(self) -> list[int]:
        """Indices in q of own hinge angles whose full revolutions have no effect; none by default."""
        return []

    # Methods that the two forms implement

    def place(self, key: Key) -> tuple[int, int] | None:
        """Return the indices of a joint coordinate in q and in v; None if it is no own coordinate."""
        return None

    def frames(self, q: Array, v: Array) -> list[Frame]:
        """Compute the frames of all bodies, ground first."""
        raise NotImplementedError

    def orientations(self, q: Array, v: Array) -> list[Array]:
        """Compute the quaternions (4,), (w, x, y, z), of all bodies, ground first, continuous in q."""
        raise NotImplementedError

    def measured(self, q: Array, v: Array) -> Mapping[Key, Measured]:
        """Compute the joint coordinates that forces, couplings and armatures depend on, by key."""
        raise NotImplementedError

    def model_forces(self, q: Array, v: Array) -> Mapping[Key, Scalar]:
        """Compute the forces of control laws that use a model of the mechanism, by key, N or N m."""
        raise NotImplementedError

    def own_coordinates(self, state: State) -> tuple[Array, Array]:
        """Compute the form's own coordinates and velocities at a state."""
        raise NotImplementedError

    def own_rate(self, q: Array, v: Array) -> Array:
        """Compute the time derivatives of the form's own coordinates."""
        raise NotImplementedError

    def own_retract(self, q: Array, step: Array) -> Array:
        """Return the form's own coordinates moved by a small step (nv,), with quaternions of norm 1."""
        raise NotImplementedError

    def mass_and_force(self, q: Array, v: Array) -> tuple[Array, Array]:
        """Compute the mass matrix M and force f, see `newton_euler.equations.system.System`."""
        raise NotImplementedError

    def phi_and_jacobian(self, q: Array) -> tuple[Array, Rows]:
        """Compute the constraint residuals (k,) and the sparse rows of their Jacobian (k, nv)."""
        raise NotImplementedError

    def rows_of(self, relative: Collection[int]) -> list[int]:
        """Translate row numbers of the joint-coordinate form into row numbers of `phi` of this form.

        Args:
            relative: numbers of rows of loop-closing joints and couplings.

        Returns:
            Row numbers, ascending: the given rows, and all rows without a counterpart in the joint-coordinate
            form, such as those of the tree's joints.
        """
        raise NotImplementedError

    def closing_rows(self) -> list[int]:
        """Return the row number in `phi` of this form for each row of the joint-coordinate form."""
        raise NotImplementedError

    def mass_rows(self, q: Array) -> Rows:
        """Compute the sparse rows of the mass matrix (nv, nv)."""
        raise NotImplementedError

    def solve(self, q: Array, v: Array) -> tuple[Array, Array]:
        """Solve for dv/dt (nv,) and the Lagrange multipliers (rows,) with dense matrices, over floats."""
        raise NotImplementedError

    def sparse_equations(self, q: Array, v: Array, rows: RowsInUse) -> Equations:
        """Compute the linear equations that `sparse_solution` solves for accelerations and multipliers."""
        raise NotImplementedError

    def sparse_residuals(
        self, q: Array, v: Array, rows: RowsInUse, accelerations: Array, multipliers: Array
    ) -> tuple[Array, Array]:
        """Compute the residuals of given accelerations a and multipliers lambda in `sparse_equations`.

        Returns:
            M a - f - J^T lambda (n,), and J a + softness * lambda - gamma (k,). The softness of a row is 0,
            except for soft constraints (`newton_euler.equations.sparse.Equations`).
        """
        raise NotImplementedError

    def sparse_coordinates(self, q: Array, v: Array, keys: Sequence[Key]) -> tuple[Rows, Array]:
        """Compute sparse rows and gamma (k,) of d2x/dt2 = rows @ accelerations - gamma.

        Args:
            q, v: (nq,) and (nv,), the state.
            keys: keys of the k joint coordinates x, which must be keys of `measured`.

        Returns:
            Rows over the accelerations that are the unknowns of `sparse_equations`; gamma.
        """
        raise NotImplementedError

    def sparse_vdot(self, q: Array, v: Array, solution: Solution) -> Array:
        """Compute dv/dt (nv,) from a solution of `sparse_equations`."""
        raise NotImplementedError

    def body_accelerations(self, q: Array, v: Array, vdot: Array) -> tuple[Array, Array]:
        """Compute the linear and angular accelerations of all bodies, (b, 3) each, world frame."""
        raise NotImplementedError

    def reactions(
        self, q: Array, v: Array, vdot: Array, bodies: tuple[Array, Array], multipliers: Array
    ) -> tuple[Array, Array]:
        """Compute the reaction forces and torques of all joints at a solution.

        Args:
            q, v, vdot: (nq,), (nv,) and (nv,), the state and dv/dt.
            bodies: linear and angular accelerations of all bodies, (b, 3) each.
            multipliers: (rows,) Lagrange multipliers.

        Returns:
            Forces and torques on the second bodies at the joint points, (j, 3) each, world frame.
        """
        raise NotImplementedError

    # Coordinates

    def remembered(self, q: Array, v: Array, compute: Callable[[Array, Array], T]) -> T:
        """Return compute(q, v), or the result of an earlier call for one of the most recent states."""
        # the bytes of an array of symbolic scalars are the identities of these objects; the copies of q and v
        # keep the objects alive, so that no identity is used again
        state = (q.dtype, q.tobytes(), v.dtype, v.tobytes())
        known = self._states  # never changed but replaced, because other threads may be reading
        if state not in known:
            last = list(known.items())[1 - MAX_REMEMBERED_STATES :]
            self._states = known = dict([*last, (state, ((q.copy(), v.copy()), compute(q, v)))])
        found: T = known[state][1]
        return found

    def coordinates(self, state: State) -> tuple[Array, Array]:
        """Compute q (nq,) and v (nv,) of a state, with zero work.

        Counted angles have the full revolutions of `State.angles`. For an angle without an entry there, the
        couplings determine the revolutions; without couplings the angle is between -pi and pi.
        """
        q, v = self.own_coordinates(state)
        if self.nq == len(q) and not self.couplings and not state.angles:
            return q, v
        q = np.concatenate([q, np.zeros(self.nq - len(q))])
        q[self.carried] = carried_angles(self.between, self.frames(q, v))
        # add full revolutions to angles between -pi and pi
        x = {key: coordinate.x for key, coordinate in self.measured(q, v).items()}
        multiples = revolutions(self.couplings, x, self.angles, self.time, state.angles)
        for key, angle in multiples.items():
            q[self.angles[key]] += angle
        return q, v

    def coordinates_from(self, other: Formulation, q: Array) -> Array:
        """Convert coordinates of another scene of the same mechanism, in the same form, to this scene.

        The scenes may have different forces and couplings, and may therefore carry different angles.

        Args:
            other: equations of the other scene.
            q: coordinates of the other scene.

        Returns:
            q (nq,) of this scene, with zero work. Carried angles that the other scene does not count are 0,
            so that they are measured between -pi and pi.
        """
        carried = [key for key, coordinate in self.between.items() if coordinate.carried is not None]
        angles = [q[other.angles[key]] if key in other.angles else 0.0 for key in carried]
        return np.concatenate([q[: self.carried.start], angles, np.zeros(self.nq - self.work.start)])

    def rate(self, q: Array, v: Array) -> Array:
        """Compute dq/dt (nq,): rates of the own coordinates and of the carried angles, then the power, W."""
        own = self.own_rate(q, v)
        if self.nq == self.carried.start:
            return own
        work = [self.power(q, v)] if self.scene.tracks_work else []
        return np.concatenate([own, carried_rates(self.between, self.frames(q, v)), work])

    def retract(self, q: Array, step: Array) -> Array:
        """Return q moved by a small step (nv,), in the units of v times s; the work does not change.

        Quaternions keep norm 1. Carried angles change by their linear approximation.
        """
        own = self.own_retract(q, step)
        if self.nq == self.carried.start:
            return own
        angles = q[self.carried] + carried_rates(self.between, self.frames(q, step))
        return np.concatenate([own, angles, q[self.work]])

    def state(self, q: Array, v: Array) -> State:
        """Compute the poses and velocities of the bodies, and the counted angles."""
        frames = self.frames(q, v)
        return State(
            np.array([frame.position for frame in frames]),
            np.array(self.orientations(q, v)),
            np.array([frame.velocity for frame in frames]),
            np.array([frame.angular_velocity for frame in frames]),
            angles=self.counted(q, frames),
        )

    def counted(self, q: Array, frames: Sequence[Frame]) -> dict[Key, Scalar]:
        """Compute the angles whose revolutions are counted, rad, by key, at q and frames of all bodies."""
        found = {}
        for key, place in self.angles.items():
            angle = q[place] if self.places[key] is not None else self.between[key].value(q, frames)
            found[key] = float(angle) if isinstance(angle, np.floating) else angle
        return found

    def mass_properties(self) -> MassProperties:
        """Return the masses and inertias that the mechanism declares."""
        return MassProperties.of(self.mechanism)

    def joint_geometry(self) -> dict[str, JointGeometry]:
        """Return the joints that the mechanism declares, by name, at the initial pose."""
        return geometry_in_mechanism(self.mechanism)

    # Constraints

    def phi(self, q: Array) -> Array:
        """Compute the constraint residuals (k,), m or rad, which projection removes."""
        return self.phi_and_jacobian(q)[0]

    def phi_jacobian(self, q: Array) -> Array:
        """Compute the constraint Jacobian (k, nv): derivative of `phi` for a step of `retract`."""
        return to_array(self.phi_and_jacobian(q)[1], self.nv)

    def phi_t(self) -> Array:
        """Compute the partial derivative of `phi` with respect to time (k,); 0 without prescribed motions."""
        # `phi` has the rows of joints, then of couplings, then of other constraints: quaternion norms
        of_couplings = [coupling.phi_t(self.time) for coupling in self.couplings]
        joint_rows, other_rows = self.rows - len(of_couplings), len(self.phi_units) - self.rows
        return np.concatenate([np.zeros(joint_rows), of_couplings, np.zeros(other_rows)])

    def joint_phi(self, q: Array) -> Array:
        """Compute the residuals of all joints, tree joints included, then of all couplings, m or rad."""
        frames = self.frames(q, np.zeros(self.nv))
        phis = [e.phi(frames[e.first], frames[e.second]) for e in self.equations]
        return np.concatenate([*phis, self.coupling_phi(q)])

    def coupling_phi(self, q: Array) -> Array:
        """Compute the residuals (c,) of the couplings, m or rad."""
        measured = self.measured(q, np.zeros(self.nv))
        return np.concatenate([np.zeros(0), [c.phi(measured, self.time) for c in self.couplings]])

    def phi_rate(self, q: Array, v: Array) -> Array:
        """Compute dPhi/dt = Phi_q qdot + Phi_t (rows,), m/s or rad/s: joints with multipliers, then
        couplings.

        These are equations (5) and (7) of the paper cited in `newton_euler.equations.cartesian`.
        """
        frames, measured, rates = self.frames(q, v), self.measured(q, v), [np.zeros(0)]
        for e in self.constrained:
            first, second = frames[e.first], frames[e.second]
            rates.append(e.jacobian(first, second).rate(first, second))
        return np.concatenate([*rates, [c.rate(measured, self.time) for c in self.couplings]])

    # Forces on joint coordinates, and the power

    def measure(self, q: Array, v: Array) -> list[tuple[Scalar, Scalar]]:
        """Compute each joint coordinate that control laws act on or read, m or rad, and its rate."""
        measured = self.measured(q, v)
        return [(measured[key].x, measured[key].rate) for key in self.scene.sensed]

    def control_forces(self, q: Array, v: Array) -> list[Scalar]:
        """Compute the force of each control law, N or N m."""
        at = self.surroundings(q, v)
        return [law.at_joint(at) for law in self.scene.control]

    def coordinate_forces(self, q: Array, v: Array) -> Iterator[tuple[Key, Scalar]]:
        """Yield the forces on joint coordinates, N or N m, with the key of each: of control laws, then of
        other forces."""
        at = self.surroundings(q, v)
        for force in (*self.scene.control, *self.scene.forces):
            yield from zip(force.keys, force.along_coordinates(at), strict=True)

    def surroundings(self, q: Array, v: Array) -> Surroundings:
        """Compute the quantities that forces depend on: frames, joint coordinates, time."""
        frames, measured, model = self.frames(q, v), self.measured(q, v), partial(self.model_forces, q, v)
        friction = cache(partial(self.loaded_friction, q, v))  # several elements need the frictions
        return Surroundings(
            self.mechanism, self.poses, frames, measured, self.time, model, friction, self.branches
        )

    def loaded_friction(self, q: Array, v: Array, factor: float = 1.0) -> HeldFriction:
        """Compute the frictions that grow with reactions, N or N m, by identity of the element.

        Args:
            q, v: (nq,) and (nv,), the state.
            factor: of the load coefficients.
        """
        if self.held_friction is not None:
            return self.held_friction
        at, elements = self.surroundings(q, v), loaded_frictions(self.scene)
        joints = [self.mechanism.joint_index(element.joint) for element in elements]

        def reactions(held: HeldFriction) -> list[Array]:
            """Compute the reactions of the elements' joints for given frictions."""
            trial = copy.copy(self)
            trial.held_friction = held
            if self.in_use is None:
                evaluation = trial.evaluate(q, v)
            else:
                evaluation, _ = trial.sparse_evaluation(q, v, self.in_use)
            return [evaluation.reaction_force[joint] for joint in joints]

        slopes = {
            each.identity: factor * each.load_coefficient * each.saturated_speed(at) for each in elements
        }
        return solve_frictions(slopes, reactions)

    def switching(self, q: Array, v: Array) -> list[Scalar]:
        """Compute the switching functions of all switched forces, see
        `newton_euler.model.switched_forces`."""
        at = self.surroundings(q, v)
        return [value for force in self.scene.switched_forces for value in force.switching(at)]

    def energies(self, at: Surroundings) -> tuple[Scalar, Scalar]:
        """Compute the kinetic energy, J, and the potential energy, J; armatures and springs included."""
        kinetic, potential = energies(self.scene, list(at.frames), self.inertias)
        rotors = sum((armature.energy(at) for armature in self.scene.armatures), start=0.0)
        return kinetic + rotors, potential + sum((f.energy(at) for f in self.scene.forces), start=0.0)

    def power(self, q: Array, v: Array) -> Scalar:
        """Compute the power, W, of forces without potential energy and of prescribed motions.

        The power of prescribed motions is -lambda . Phi_t, with the Lagrange multipliers lambda.
        """
        total = power(self.scene, self.surroundings(q, v))
        if not self.scene.motions:
            return total
        if self.in_use is None:
            return total - self.phi_t()[: self.rows] @ self.solve(q, v)[1]
        multipliers = self.sparse_solution(q, v, self.in_use).multipliers
        return total - sum(rate * multipliers.get(k, 0.0) for k, rate in enumerate(self.phi_t()))

    # Solutions

    def sparse_solution(self, q: Array, v: Array, rows: RowsInUse) -> Solution:
        """Solve for accelerations and multipliers by sparse elimination.

        Args:
            q, v: (nq,) and (nv,), the state.
            rows: constraint rows to use; all other rows follow from them.
        """
        return sparse.solve_constrained(self.sparse_equations(q, v, rows))

    def servo_forces(
        self, q: Array, v: Array, servos: Servos, accelerations: Sequence[Scalar]
    ) -> tuple[Array, Scalar]:
        """Compute actuator forces for desired accelerations of joint coordinates z: inverse dynamics.

        Additional constraints J_z vdot = zddot + gamma_z prescribe the accelerations. Their multipliers tau
        are the required forces on z. If the actuators act on other coordinates x, their forces u must do the
        same work: (dx/dz)^T u = tau. Here dx/dz = J_x T, with the velocities T for unit rates of z: J T = 0
        and J_z T = I. If several u satisfy this, the one of least norm is chosen; for the norm, forces on
        slides are multiplied by the mechanism's size.

        Args:
            q, v: (nq,) and (nv,), the state.
            servos: the coordinates z and the actuators. The control laws of the scene must exert no force on
                them.
            accelerations: (d,) zddot, m/s^2 or rad/s^2.

        Returns:
            Forces (a,), N or N m, and the pivot ratio of the elimination
            (`newton_euler.equations.sparse.Factor`): not positive if the constraints on z depend on the other
            constraints, or if the actuators cannot cause the motion.
        """
        # equations of motion with the additional constraints
        coordinates, actuators = servos.coordinates, servos.actuators
        equations = self.sparse_equations(q, v, servos.rows)
        z_rows, gamma_z = self.sparse_coordinates(q, v, coordinates)
        gamma = np.concatenate([equations.gamma, gamma_z + np.array(accelerations)])
        equations = equations.extended(z_rows, gamma, servos.scales)
        numbers = range(len(gamma) - len(z_rows), len(gamma))  # of the additional rows
        solution = sparse.solve_constrained(equations)
        tau = np.array([solution.multipliers.get(number, 0.0) for number in numbers])
        if actuators == coordinates:
            return tau, solution.pivot_ratio
        # dimensionless (dx/dz)^T, row by row: solve for a unit rate of one coordinate z, without forces f
        # (`reduced_force` is L^-1 f with the factor L of the mass matrix)
        x_rows, _ = self.sparse_coordinates(q, v, actuators)
        z_units, x_units = (np.array([self.unit(key) for key in keys]) for keys in (coordinates, actuators))
        dx_dz: Rows = []
        for number, unit in zip(numbers, z_units, strict=True):
            rates = np.zeros(len(equations.gamma))
            rates[number] = unit
            tangent = sparse.solve_constrained(equations._replace(reduced_force={}, gamma=rates)).acceleration
            dx_dz.append(sparse_vector([dot(row, tangent) / x_units[k] for k, row in enumerate(x_rows)]))
        # actuator forces of least norm that do the same work
        scaled_forces, pivot_ratio = sparse.least_squares(dx_dz, tau * z_units)
        forces = np.array([scaled_forces.get(k, 0.0) / unit for k, unit in enumerate(x_units)])
        return forces, minimum(solution.pivot_ratio, pivot_ratio)

    def acceleration(self, q: Array, v: Array) -> Array:
        """Compute dv/dt (nv,) with dense matrices, over floats."""
        return self.solve(q, v)[0]

    def sparse_acceleration(self, q: Array, v: Array, rows: RowsInUse) -> tuple[Array, Scalar]:
        """Compute dv/dt (nv,) and the pivot ratio by sparse elimination.

        The pivot ratio is of order 1 far from singular states, and not positive at them.
        """
        solution = self.sparse_solution(q, v, rows)
        return self.sparse_vdot(q, v, solution), solution.pivot_ratio

    def observe(self, q: Array, v: Array) -> Observation:
        """Compute the poses, velocities and energies at a state."""
        kinetic, potential = self.energies(self.surroundings(q, v))
        return Observation(
            state=self.state(q, v),
            kinetic_energy=kinetic,
            potential_energy=potential,
            work=q[self.work][0] if self.scene.tracks_work else None,
        )

    def evaluate(self, q: Array, v: Array) -> Evaluation:
        """Compute the accelerations, reactions and energies at a state with dense matrices, over floats."""
        return self._evaluation(q, v, *self.solve(q, v))

    def sparse_evaluation(self, q: Array, v: Array, rows: RowsInUse) -> tuple[Evaluation, Scalar]:
        """Compute the accelerations, reactions and energies by sparse elimination, and the pivot ratio."""
        solution = self.sparse_solution(q, v, rows)
        multipliers = np.array([solution.multipliers.get(k, 0.0) for k in range(self.rows)])
        vdot = self.sparse_vdot(q, v, solution)
        return self._evaluation(q, v, vdot, multipliers), solution.pivot_ratio

    def _evaluation(self, q: Array, v: Array, vdot: Array, multipliers: Array) -> Evaluation:
        """Compute the evaluation of a state from its dv/dt (nv,) and multipliers (rows,)."""
        bodies = self.body_accelerations(q, v, vdot)
        forces, torques = self.reactions(q, v, vdot, bodies, multipliers)
        return Evaluation(
            **vars(self.observe(q, v)),
            linear_acceleration=bodies[0],
            angular_acceleration=bodies[1],
            reaction_force=forces,
            reaction_torque=torques,
            actuator_force=np.array(self.control_forces(q, v)),
        )
