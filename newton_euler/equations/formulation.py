"""Coordinates and outputs that the Cartesian and the joint-coordinate form of the equations of motion share.

Extensions of the paper, the same in both forms: couplings, prescribed motions and angles whose revolutions
are counted (`newton_euler.equations.couplings`), and the work of what has no potential energy.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple, TypeVar

import numpy as np

from newton_euler.equations import sparse
from newton_euler.equations.applied_forces import energies, power
from newton_euler.equations.couplings import (
    Measured,
    carried_angles,
    carried_rates,
    coordinates,
    couplings,
    needed_coordinates,
    revolutions,
    row_owners,
    row_units,
)
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
REMEMBERED = 64  # states whose kinematics are kept


class Servos(NamedTuple):
    """Actuators, and the joint coordinates that get wanted accelerations by the actuators."""

    coordinates: tuple[Key, ...]
    """(d,) coordinates z, independent of each other."""
    actuators: tuple[Key, ...]
    """(a,) coordinates of the actuators: z, or at least d others if z determines the whole motion."""
    rows: RowsInUse
    """Constraint rows in use."""
    scales: list[float] | None = None
    """Usual sizes of the pivots of these rows and of those of the coordinates; None where unknown."""

    def with_flags(self, flags: Mapping[int, Scalar] | None) -> Servos:
        """Return the same with other constraint rows left out, if there are flags of rows."""
        return self._replace(rows=self.rows._replace(flags=flags)) if flags else self


class Formulation(System):
    """A form of the equations of motion of a scene, over floats or generic scalars.

    q (nq,) holds the form's own coordinates, the carried angles, and the work if the scene tracks it; v (nv,)
    holds the velocities of its own coordinates.

    Attributes:
        K_D, K_P: Baumgarte's gains, 1/s and 1/s^2.
        time: time of prescribed motions, s.
        equations: of all joints, in body frames of the reference `poses`.
        constrained: of the joints that have multipliers in this form.
        rows: number of equations of these joints and of the couplings.
        between: joint coordinates that are measured between two bodies.
        angles: places in q of the angles whose revolutions are counted.
        carried, work: where in q the carried angles and the work are.
        in_use: constraint rows that imply all others, over generic scalars; None in floats.
        omitted: rows of `phi` to leave out; None for those that `newton_euler.equations.redundancy` selects.
        phi_units, row_owners: of the rows of `phi`, what makes them dimensionless, and the joint, coupling or
            body that each belongs to.
        quaternions: where in q there are Euler parameters.
    """

    name: str
    inertias: list[Array]
    """(3, 3) of each body about its center of mass, in the frame of its reference pose, kg m^2."""
    velocity_units: Array
    coordinate_units: Array
    """Units of the coordinates of bodies or of the tree: the mechanism's size, m, for lengths, else 1."""
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
        """`nq` counts the form's own coordinates; `alpha` is in 1/s, 0 for no stabilization."""
        self.scene, self.mechanism = scene, scene.mechanism
        self.K_D, self.K_P = 2.0 * alpha, alpha * alpha  # Appendix B, eqs (30) and (31) with zeta = 1
        self.poses, self.equations, self.constrained = poses, equations, constrained
        self.time: Scalar = 0.0
        self.in_use: RowsInUse | None = None
        self.omitted: list[int] | None = None
        self.couplings = couplings(scene)
        self.rows = sum(e.count for e in constrained) + len(self.couplings)
        self.phi_units = row_units(constrained, self.couplings, self.mechanism.size)
        self.row_owners = row_owners(constrained, self.couplings)
        counted = needed_coordinates(scene, self.couplings)
        rotors = (armature.key for armature in scene.armatures if not armature.on_ball)
        self.places = {key: self.place(key) for key in [*counted, *rotors]}
        cut = {
            key: equations[self.mechanism.joint_index(key[0])]
            for key, place in self.places.items()
            if place is None
        }
        self.between = coordinates(cut, nq, counted)
        self.angles: dict[Key, int] = {}
        for key in counted:
            place = self.places[key]
            on_q = self.between[key].carried if place is None else place[0]
            if on_q is not None and not self.mechanism.is_slide(*key):
                self.angles[key] = on_q
        carried = sum(coordinate.carried is not None for coordinate in self.between.values())
        self.carried = slice(nq, nq + carried)
        self.work = slice(nq + carried, nq + carried + int(scene.tracks_work))
        self.nq, self.nv = self.work.stop, nv
        self._states: dict[Any, tuple[tuple[Array, Array], Any]] = {}
        self.model_control: list[Any] = []  # one `newton_euler.equations.model_control.ModelControl` at most

    def unit(self, key: Key) -> float:
        """Return the unit of a joint coordinate: the mechanism's size, m, for a slide, 1 for an angle."""
        return self.mechanism.size if self.mechanism.is_slide(*key) else 1.0

    @property
    def uncounted_angles(self) -> list[int]:
        """Places in q of angles whose revolutions nothing counts."""
        return []

    # The two forms define

    def place(self, key: Key) -> tuple[int, int] | None:
        """Find where a joint coordinate is in q and in v; None if it is none of the form's own."""
        return None

    def frames(self, q: Array, v: Array) -> list[Frame]:
        """Compute the frames of all bodies, ground first."""
        raise NotImplementedError

    def orientations(self, q: Array, v: Array) -> list[Array]:
        """Compute Euler parameters (4,) of all bodies, ground first, continuous in q."""
        raise NotImplementedError

    def measured(self, q: Array, v: Array) -> Mapping[Key, Measured]:
        """Compute the joint coordinates that something acts on."""
        raise NotImplementedError

    def model_forces(self, q: Array, v: Array) -> Mapping[Key, Scalar]:
        """Compute the forces that control laws get of a model of the mechanism, N or N m."""
        raise NotImplementedError

    def own_coordinates(self, state: State) -> tuple[Array, Array]:
        """Compute the form's own coordinates and velocities in a state."""
        raise NotImplementedError

    def own_rate(self, q: Array, v: Array) -> Array:
        """Compute the rates of the form's own coordinates."""
        raise NotImplementedError

    def own_retract(self, q: Array, step: Array) -> Array:
        """Move the form's own coordinates by a small step (nv,); quaternions come out with norm 1."""
        raise NotImplementedError

    def mass_and_force(self, q: Array, v: Array) -> tuple[Array, Array]:
        """Compute M and f, see `newton_euler.equations.system.System`."""
        raise NotImplementedError

    def phi_and_jacobian(self, q: Array) -> tuple[Array, Rows]:
        """Compute the residuals (k,) and the nonzeros of their Jacobian (k, nv)."""
        raise NotImplementedError

    def rows_of(self, relative: Collection[int]) -> list[int]:
        """Select rows of `phi`: these of the joint-coordinate form, and all of joints that its tree keeps."""
        raise NotImplementedError

    def closing_rows(self) -> list[int]:
        """Return the row of `phi` for each row of the joint-coordinate form."""
        raise NotImplementedError

    def mass_rows(self, q: Array) -> Rows:
        """Compute the nonzeros of the mass matrix (nv, nv), over generic scalars."""
        raise NotImplementedError

    def solve(self, q: Array, v: Array) -> tuple[Array, Array]:
        """Solve for vdot (nv,) and lambda (rows,) with dense matrices."""
        raise NotImplementedError

    def sparse_equations(self, q: Array, v: Array, rows: RowsInUse) -> Equations:
        """Compute the equations that `sparse_solution` solves for the form's own accelerations."""
        raise NotImplementedError

    def sparse_residuals(
        self, q: Array, v: Array, rows: RowsInUse, accelerations: Array, multipliers: Array
    ) -> tuple[Array, Array]:
        """Compute M a - f - J^T lambda (n,) and J a + softness lambda - gamma (k,) of `sparse_equations`."""
        raise NotImplementedError

    def sparse_coordinates(self, q: Array, v: Array, keys: Sequence[Key]) -> tuple[Rows, Array]:
        """Compute rows and gamma (k,) of d2x/dt2 = rows @ accelerations - gamma for joint coordinates.

        The accelerations are those of `sparse_equations`; something has to act on each coordinate.
        """
        raise NotImplementedError

    def sparse_vdot(self, q: Array, v: Array, solution: Solution) -> Array:
        """Compute vdot (nv,) from a sparse solution."""
        raise NotImplementedError

    def body_accelerations(self, q: Array, v: Array, vdot: Array) -> tuple[Array, Array]:
        """Compute linear and angular accelerations (b, 3) of all bodies."""
        raise NotImplementedError

    def reactions(
        self, q: Array, v: Array, vdot: Array, bodies: tuple[Array, Array], multipliers: Array
    ) -> tuple[Array, Array]:
        """Compute forces and torques (j, 3) of joints from accelerations `bodies` of all bodies."""
        raise NotImplementedError

    # Coordinates

    def remembered(self, q: Array, v: Array, compute: Callable[[Array, Array], T]) -> T:
        """Return compute(q, v), or the result of an earlier call for one of the last `REMEMBERED` states."""
        # over generic scalars the bytes tell which objects they are, which the copies keep alive
        state = (q.dtype, q.tobytes(), v.dtype, v.tobytes())
        known = self._states  # is replaced, never changed: other threads may be reading
        if state not in known:
            last = list(known.items())[1 - REMEMBERED :]
            self._states = known = dict([*last, (state, ((q.copy(), v.copy()), compute(q, v)))])
        found: T = known[state][1]
        return found

    def coordinates(self, state: State) -> tuple[Array, Array]:
        """Compute q and v of a state; no work done.

        Counted angles are in the revolution of `State.angles`, else in the one that couplings ask for, else
        within half a revolution.
        """
        q, v = self.own_coordinates(state)
        if self.nq == len(q) and not self.couplings and not state.angles:
            return q, v
        q = np.concatenate([q, np.zeros(self.nq - len(q))])
        q[self.carried] = carried_angles(self.between, self.frames(q, v))
        x = {key: seen.x for key, seen in self.measured(q, v).items()}
        turned = revolutions(self.couplings, x, self.angles, self.time, state.angles)
        for key, angle in turned.items():
            q[self.angles[key]] += angle
        return q, v

    def coordinates_from(self, other: Formulation, q: Array) -> Array:
        """Return q (nq,) at the configuration that another scene of the mechanism has in the same form.

        Angles that the other scene does not count are within half a revolution; no work is done.
        """
        counted = [key for key, coordinate in self.between.items() if coordinate.carried is not None]
        angles = [q[other.angles[key]] if key in other.angles else 0.0 for key in counted]
        return np.concatenate([q[: self.carried.start], angles, np.zeros(self.nq - self.work.start)])

    def rate(self, q: Array, v: Array) -> Array:
        """Compute qdot (nq,): the own coordinates' rates, those of the carried angles, and the power."""
        own = self.own_rate(q, v)
        if self.nq == self.carried.start:
            return own
        work = [self.power(q, v)] if self.scene.tracks_work else []
        return np.concatenate([own, carried_rates(self.between, self.frames(q, v)), work])

    def retract(self, q: Array, step: Array) -> Array:
        """Move q by a small step (nv,); quaternions come out with norm 1, carried angles follow."""
        own = self.own_retract(q, step)
        if self.nq == self.carried.start:
            return own
        angles = q[self.carried] + carried_rates(self.between, self.frames(q, step))
        return np.concatenate([own, angles, q[self.work]])

    def state(self, q: Array, v: Array) -> State:
        """Compute body poses and velocities."""
        frames = self.frames(q, v)
        return State(
            np.array([frame.position for frame in frames]),
            np.array(self.orientations(q, v)),
            np.array([frame.velocity for frame in frames]),
            np.array([frame.angular_velocity for frame in frames]),
            angles=self.counted(q, frames),
        )

    def counted(self, q: Array, frames: Sequence[Frame]) -> dict[Key, Scalar]:
        """Compute the angles whose revolutions are counted, rad, where the bodies have these frames."""
        found = {}
        for key, place in self.angles.items():
            angle = q[place] if self.places[key] is not None else self.between[key].value(q, frames)
            found[key] = float(angle) if isinstance(angle, np.floating) else angle
        return found

    def mass_properties(self) -> MassProperties:
        """Return the masses and inertias that the mechanism states."""
        return MassProperties.of(self.mechanism)

    def joint_geometry(self) -> dict[str, JointGeometry]:
        """Return the joints that the mechanism states."""
        return geometry_in_mechanism(self.mechanism)

    # Constraints

    def phi(self, q: Array) -> Array:
        """Compute the residuals (k,) that projection removes."""
        return self.phi_and_jacobian(q)[0]

    def phi_jacobian(self, q: Array) -> Array:
        """Compute the derivative (k, nv) of `phi` along `retract`, and of the rate of `phi` by v."""
        return to_array(self.phi_and_jacobian(q)[1], self.nv)

    def phi_t(self) -> Array:
        prescribed = [coupling.phi_t(self.time) for coupling in self.couplings]
        before, after = self.rows - len(prescribed), len(self.phi_units) - self.rows
        return np.concatenate([np.zeros(before), prescribed, np.zeros(after)])

    def joint_phi(self, q: Array) -> Array:
        """Compute the residuals of all joints, then of all couplings, m or rad."""
        frames = self.frames(q, np.zeros(self.nv))
        phis = [e.phi(frames[e.first], frames[e.second]) for e in self.equations]
        return np.concatenate([*phis, self.coupling_phi(q)])

    def coupling_phi(self, q: Array) -> Array:
        """Compute the residuals (c,) of the couplings, m or rad."""
        measured = self.measured(q, np.zeros(self.nv))
        return np.concatenate([np.zeros(0), [c.phi(measured, self.time) for c in self.couplings]])

    def phi_rate(self, q: Array, v: Array) -> Array:
        """Compute Phi_q qdot + Phi_t (rows,), eqs (5) and (7): joints with multipliers, then couplings."""
        frames, measured, rates = self.frames(q, v), self.measured(q, v), [np.zeros(0)]
        for e in self.constrained:
            first, second = frames[e.first], frames[e.second]
            rates.append(e.jacobian(first, second).rate(first, second))
        return np.concatenate([*rates, [c.rate(measured, self.time) for c in self.couplings]])

    # Forces on joint coordinates, and the power

    def measure(self, q: Array, v: Array) -> list[tuple[Scalar, Scalar]]:
        """Compute the coordinates (m or rad) that control laws act on or read, and their rates."""
        measured = self.measured(q, v)
        return [measured[key][:2] for key in self.scene.sensed]

    def joint_forces(self, q: Array, v: Array) -> Iterator[Scalar]:
        """Compute the forces of control laws and of springs on joint coordinates, N or N m."""
        at = self.seen(q, v)
        for law in self.scene.joint_forces:
            yield law.at_joint(at)

    def seen(self, q: Array, v: Array) -> Surroundings:
        """Compute what the forces depend on."""
        frames, measured, model = self.frames(q, v), self.measured(q, v), partial(self.model_forces, q, v)
        return Surroundings(self.mechanism, self.poses, frames, measured, self.time, model)

    def energies(self, at: Surroundings) -> tuple[Scalar, Scalar]:
        """Compute the kinetic and the potential energy, J."""
        kinetic, potential = energies(self.scene, list(at.frames), self.inertias)
        rotors = sum((armature.energy(at) for armature in self.scene.armatures), start=0.0)
        return kinetic + rotors, potential + sum((f.energy(at) for f in self.scene.forces), start=0.0)

    def power(self, q: Array, v: Array) -> Scalar:
        """Compute the power, W, of what has no potential energy; that of constraints is -lambda . Phi_t."""
        total = power(self.scene, self.seen(q, v))
        if not self.scene.motions:
            return total
        if self.in_use is None:
            return total - self.phi_t()[: self.rows] @ self.solve(q, v)[1]
        multipliers = self.sparse_solution(q, v, self.in_use).multipliers
        return total - sum(rate * multipliers.get(k, 0.0) for k, rate in enumerate(self.phi_t()))

    # Solutions

    def sparse_solution(self, q: Array, v: Array, rows: RowsInUse) -> Solution:
        """Solve by sparse elimination; `rows` of `phi` are used, the others must follow from them."""
        return sparse.solve_constrained(self.sparse_equations(q, v, rows))

    def servo_forces(
        self, q: Array, v: Array, servos: Servos, accelerations: Sequence[Scalar]
    ) -> tuple[Array, Scalar]:
        """Compute forces of actuators for wanted accelerations of joint coordinates, over generic scalars.

        Further constraints J_z vdot = zddot + gamma_z give the accelerations the wanted values. Their
        multipliers tau are the forces on z that this takes: those of the actuators, if these act on z. Else
        the actuators' forces u are to do the same work, (dx/dz)^T u = tau, with dx/dz from
        J T = 0, J_z T = I, dx/dz = J_x T. If that leaves a choice, u is the shortest one in N m, forces on
        slides times the mechanism's size.

        Args:
            q, v: (nq,) and (nv,).
            servos: of a scene whose control laws leave `servos.coordinates` and `servos.actuators` alone.
            accelerations: (d,) zddot, m/s^2 or rad/s^2.

        Returns:
            Forces (a,), N or N m, and the pivot ratio of the elimination: not positive where the coordinates
            do not determine the motion, or the actuators cannot make it.
        """
        coordinates, actuators = servos.coordinates, servos.actuators
        equations = self.sparse_equations(q, v, servos.rows)
        wanted, gamma = self.sparse_coordinates(q, v, coordinates)
        gamma = np.concatenate([equations.gamma, gamma + np.array(accelerations)])
        equations = equations.extended(wanted, gamma, servos.scales)
        places = range(len(gamma) - len(wanted), len(gamma))
        solution = sparse.solve_constrained(equations)
        forces = np.array([solution.multipliers.get(place, 0.0) for place in places])
        if actuators == coordinates:
            return forces, solution.pivot_ratio
        acting, _ = self.sparse_coordinates(q, v, actuators)
        units, on = (np.array([self.unit(key) for key in keys]) for keys in (coordinates, actuators))
        shares: Rows = []
        for place, unit in zip(places, units, strict=True):
            only = np.zeros(len(equations.gamma))
            only[place] = unit
            tangent = sparse.solve_constrained(equations._replace(free={}, gamma=only)).acceleration
            shares.append(sparse_vector([dot(row, tangent) / on[k] for k, row in enumerate(acting)]))
        found, pivot_ratio = sparse.least_squares(shares, forces * units)
        forces = np.array([found.get(k, 0.0) / unit for k, unit in enumerate(on)])
        return forces, minimum(solution.pivot_ratio, pivot_ratio)

    def acceleration(self, q: Array, v: Array) -> Array:
        """Compute vdot (nv,)."""
        return self.solve(q, v)[0]

    def sparse_acceleration(self, q: Array, v: Array, rows: RowsInUse) -> tuple[Array, Scalar]:
        """Compute vdot (nv,) and the pivot ratio of the elimination, over generic scalars."""
        solution = self.sparse_solution(q, v, rows)
        return self.sparse_vdot(q, v, solution), solution.pivot_ratio

    def observe(self, q: Array, v: Array) -> Observation:
        """Compute poses, velocities and energies."""
        kinetic, potential = self.energies(self.seen(q, v))
        return Observation(
            state=self.state(q, v),
            kinetic_energy=kinetic,
            potential_energy=potential,
            work=q[self.work][0] if self.scene.tracks_work else None,
        )

    def evaluate(self, q: Array, v: Array) -> Evaluation:
        """Compute accelerations, reactions and energies."""
        return self._evaluation(q, v, *self.solve(q, v))

    def sparse_evaluation(self, q: Array, v: Array, rows: RowsInUse) -> tuple[Evaluation, Scalar]:
        """Evaluate by sparse elimination over generic scalars; return the pivot ratio, too."""
        solution = self.sparse_solution(q, v, rows)
        multipliers = np.array([solution.multipliers.get(k, 0.0) for k in range(self.rows)])
        vdot = self.sparse_vdot(q, v, solution)
        return self._evaluation(q, v, vdot, multipliers), solution.pivot_ratio

    def _evaluation(self, q: Array, v: Array, vdot: Array, multipliers: Array) -> Evaluation:
        bodies = self.body_accelerations(q, v, vdot)
        forces, torques = self.reactions(q, v, vdot, bodies, multipliers)
        return Evaluation(
            **vars(self.observe(q, v)),
            linear_acceleration=bodies[0],
            angular_acceleration=bodies[1],
            reaction_force=forces,
            reaction_torque=torques,
            actuator_force=np.array(list(self.joint_forces(q, v))[: len(self.scene.control)]),
        )
