"""Equations of motion of a scene by Exudyn, with rigid constraints.

The coordinates q are position and quaternion (w, x, y, z) of each moving body, the coordinate of each rotor,
the hinge angles with full revolutions on which forces and couplings depend, and the work, J, if the scene
tracks it. The velocities v are the velocity of the center of mass, world frame, and the angular velocity,
body frame, of each body, then the rates of the rotors. With T = d(nodal rates)/dv, Exudyn's matrices M, f and
C_q of its nodal coordinates give

    mass matrix T^T M T,    force T^T f,    Jacobian J = C_q T,    gamma = -d(J v)/dt at constant v,

because M Tdot v = 0: Tdot v is a multiple of the Euler parameters p, which M maps to zero. Exudyn's C_q is
tangential (C_q p = 0), although its residuals depend on the norm of p. Therefore gamma is a difference of C_q
along a motion with unit Euler parameters, and not of residuals along a line.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Any

import exudyn as exu
import numpy as np

from crosscheck.engines.exudyn.calls import exudyn_calls
from crosscheck.engines.exudyn.coordinates import NODAL
from crosscheck.engines.exudyn.forces import AppliedForces, applied_forces, motions_of
from crosscheck.engines.exudyn.limits import limits
from crosscheck.engines.exudyn.model import build
from crosscheck.engines.exudyn.model_laws import ModelLaws
from crosscheck.engines.exudyn.readings import joint_geometry, mass_properties, weights
from crosscheck.engines.limits import require_expressed
from newton_euler.equations.articulated import moved_wrench
from newton_euler.equations.coupling_equations import residuals
from newton_euler.equations.couplings import counted_angles, couplings
from newton_euler.equations.drives import joint_points
from newton_euler.equations.engine_solution import Redundancy, solve_rigidly
from newton_euler.equations.revolutions import revolutions
from newton_euler.equations.system import Energies, Evaluation, MassProperties, Observation
from newton_euler.model.constraints import Frame
from newton_euler.model.euler_parameters import (
    from_rotation,
    from_rotation_vector,
    matrix_l,
    product,
    rotation,
)
from newton_euler.model.joint_geometry import JointGeometry
from newton_euler.model.scene import Scene
from newton_euler.model.state import State, whole_revolutions
from newton_euler.scalars import Array, Scalar

FIRST_DERIVATIVE = tuple(
    (sign * point, sign * weight)
    for point, weight in ((1.0, 4.0 / 5.0), (2.0, -1.0 / 5.0), (3.0, 4.0 / 105.0), (4.0, -1.0 / 280.0))
    for sign in (1.0, -1.0)
)
"""Points and weights of the central first derivative of order 8."""

MOTION_STEP = 0.002
"""Largest motion between two points of `FIRST_DERIVATIVE`, mechanism sizes or rad. Round-off is about 1e-13,
and the truncation error is smaller for rods longer than 2 % of the mechanism's size."""


class ExudynSystem:
    """Equations of a scene by Exudyn, a `newton_euler.equations.system.System`.

    Attributes:
        model: the system of Exudyn.
        solver: solver of Exudyn, which computes matrices and residuals.
        count, rotors: numbers of moving bodies and of rotors.
        nodal_size: number of Exudyn's coordinates, which are the first elements of q.
        reference: (nodal size,) reference coordinates.
        angles: keys of the hinge angles in q.
        angle_places: their place in q.
        row_numbers: numbers of the constraint equations (k,) among Exudyn's algebraic equations.
    """

    name = "exudyn"

    def __init__(
        self,
        scene: Scene,
        left_out: Collection[int] = (),
        shifts: Mapping[str, Array] | None = None,
        divided: bool = False,
    ) -> None:
        """Build the model, see `build`.

        Raises:
            CannotExpressError: for a scene with limits.
        """
        require_expressed(self.name, limits(scene))
        self.scene, self.mechanism, self.time = scene, scene.mechanism, 0.0
        with exudyn_calls():
            self.model = build(scene, left_out, shifts, divided)
        settings = exu.SimulationSettings()
        settings.solution.file.write = False
        settings.timeIntegration.verboseMode = 0
        # the matrices do not need them, and redundant constraints make their equations singular
        settings.timeIntegration.generalizedAlpha.computeInitialAccelerations = False
        self.solver: Any = exu.MainSolverImplicitSecondOrder()
        with exudyn_calls():
            self.solver.InitializeSolver(self.model.mbs, settings)
        size, self.angles = self.mechanism.size, counted_angles(scene)
        self.count, self.rotors = len(self.mechanism.bodies) - 1, len(scene.armatures)
        self.nodal_size = NODAL * self.count + self.rotors
        self.nq = self.nodal_size + len(self.angles) + int(scene.tracks_work)
        self.nv = 6 * self.count + self.rotors
        self.quaternions = [slice(NODAL * k + 3, NODAL * k + 7) for k in range(self.count)]
        self.angle_places = slice(self.nodal_size, self.nodal_size + len(self.angles))
        self.phi_units = np.array([row.unit for row in self.model.rows])
        of_rotors = [size if self.mechanism.is_slide(*each.key) else 1.0 for each in scene.armatures]
        self.velocity_units = np.concatenate(
            [np.tile([size, size, size, 1.0, 1.0, 1.0], self.count), of_rotors]
        )
        self.reference = self.model.reference
        self.row_numbers = [row.equation for row in self.model.rows]
        self._couplings = couplings(scene)
        self._redundancy: Redundancy | None = None
        self.model.wrenches = lambda time: self._applied(time).on_bodies
        self.model.given = lambda time: self._applied(time).given
        self._laws = ModelLaws(scene, ExudynSystem)
        self._last: tuple[Any, AppliedForces | None] = None, None

    # Exudyn's quantities at nodal coordinates and velocities

    def place(self, q: Array, v: Array) -> None:
        """Set Exudyn's system to coordinates q (nq,) and velocities v (nv,), and to the time."""
        nodal, data = q[: self.nodal_size], self.model.mbs.systemData
        self.model.scene = self.scene
        self.set_angles(dict(zip(self.angles, q[self.angle_places].tolist(), strict=True)))
        data.SetTime(self.time)
        data.SetODE2Coordinates(nodal - self.reference)
        data.SetODE2Coordinates_t(self.nodal_rates(nodal) @ v)

    def set_angles(self, angles: Mapping[tuple[str, int], float]) -> None:
        """Tell the model hinge angles with their full revolutions, rad."""
        self.model.angles.update(angles)
        hinges = [each.key for each in self.model.connectors.values() if each.node is not None]
        if hinges:
            self.model.mbs.systemData.SetDataCoordinates([self.model.angles[key] for key in hinges])

    def nodal_rates(self, q: Array) -> Array:
        """Return T (nodal size, nv): rates of Exudyn's coordinates per velocity."""
        matrix = np.zeros((self.nodal_size, self.nv))
        for k, quaternion in enumerate(self.quaternions):
            matrix[NODAL * k : NODAL * k + 3, 6 * k : 6 * k + 3] = np.eye(3)
            matrix[quaternion, 6 * k + 3 : 6 * k + 6] = 0.5 * matrix_l(q[quaternion]).T
        matrix[NODAL * self.count :, 6 * self.count :] = np.eye(self.rotors)
        return matrix

    def _constraint_matrix(self) -> Array:
        """Return Exudyn's C_q (k, nodal size) at the present state."""
        size = self.nodal_size
        total = size + self.solver.GetAEsize()
        self.solver.SetSystemJacobian(np.zeros((total, total)))  # the call below adds to it
        with exudyn_calls():
            self.solver.ComputeJacobianAE(
                self.model.mbs, scalarFactor_ODE2=1.0, scalarFactor_ODE2_t=0.0, velocityLevel=False
            )
        return np.array(self.solver.GetSystemJacobian())[size:, :size][self.row_numbers]

    def _mass_matrix(self) -> Array:
        """Return Exudyn's mass matrix of its nodal coordinates at the present state."""
        with exudyn_calls():
            self.solver.ComputeMassMatrix(self.model.mbs)
        return np.array(self.solver.GetSystemMassMatrix())[: self.nodal_size, : self.nodal_size]

    def _applied(self, time: float) -> AppliedForces:
        """Return the applied forces at the present state and a time, s; those of the last state are kept."""
        data = self.model.mbs.systemData
        coordinates, rates = np.array(data.GetODE2Coordinates()), np.array(data.GetODE2Coordinates_t())
        key = time, self.model.scene, coordinates.tobytes(), rates.tobytes()
        known, forces = self._last
        if forces is None or known != key:
            scene, state = self.model.scene, self.present_state()
            given = self._laws.forces(scene, state, time)
            forces = applied_forces(scene, state, time, self.model.native, given)
            self._last = key, forces
        return forces

    def present_state(self) -> State:
        """Return poses and velocities of Exudyn's bodies at the present state of its system."""
        kinds, found = exu.OutputVariableType, State.initial(self.mechanism)
        read = self.model.mbs.GetObjectOutputBody
        for k, body in enumerate(self.model.bodies[1:], start=1):
            position, turn, velocity, spin = (
                read(body, kind, [0.0, 0.0, 0.0])
                for kind in (kinds.Position, kinds.RotationMatrix, kinds.Velocity, kinds.AngularVelocity)
            )
            found.position[k], found.quaternion[k] = position, from_rotation(np.reshape(turn, (3, 3)))
            found.linear_velocity[k], found.angular_velocity[k] = velocity, spin
        return State(*found.arrays, angles={key: self.model.angles[key] for key in self.angles})

    # `System`

    def mass_properties(self) -> MassProperties:
        """Return the mass properties of Exudyn's bodies at the initial pose."""
        return mass_properties(self.model)

    def joint_geometry(self) -> dict[str, JointGeometry]:
        """Return the joints as Exudyn's markers have them at the initial pose."""
        self.place(*self.coordinates(State.initial(self.mechanism)))
        return joint_geometry(self.model)

    def coordinates(self, state: State) -> tuple[Array, Array]:
        """Return q (nq,) and v (nv,) of a state; the work is zero."""
        frames, q, v = state.frames(), np.zeros(self.nq), np.zeros(self.nv)
        keys = {*self.angles, *(each.key for each in self.scene.armatures)}
        measured = {key: tuple(map(float, self.mechanism.measure(key, frames))) for key in keys}
        x = {key: value for key, (value, _) in measured.items()}
        hinges = {key for key in keys if not self.mechanism.is_slide(*key)}
        coupled = {key for coupling in self._couplings for key in coupling.factors}
        x |= {key: float(self.mechanism.measure(key, frames)[0]) for key in coupled - keys}
        for key, turns in revolutions(self._couplings, x, hinges, self.time, state.angles).items():
            x[key] += turns
        for k, quaternion in enumerate(self.quaternions):
            q[NODAL * k : NODAL * k + 3], q[quaternion] = state.position[k + 1], state.quaternion[k + 1]
            v[6 * k : 6 * k + 3] = state.linear_velocity[k + 1]
            v[6 * k + 3 : 6 * k + 6] = frames[k + 1].rotation.T @ frames[k + 1].angular_velocity
        for k, armature in enumerate(self.scene.armatures):
            q[NODAL * self.count + k], v[6 * self.count + k] = x[armature.key], measured[armature.key][1]
        q[self.angle_places] = [x[key] for key in self.angles]
        return q, v

    def state(self, q: Array, v: Array) -> State:
        """Return poses and velocities by Exudyn's bodies."""
        self.place(q, v)
        return self.present_state()

    def measure(self, q: Array, v: Array) -> list[tuple[Scalar, Scalar]]:
        """Return the coordinates that controllers read, and their rates."""
        motions = motions_of(self.scene, self.state(q, v))
        return [motions[key] for key in self.scene.sensed]

    def rate(self, q: Array, v: Array) -> Array:
        """Return dq/dt (nq,)."""
        state = self.state(q, v)
        frames = state.frames()
        rates = [float(self.mechanism.measure(key, frames)[1]) for key in self.angles]
        power = []
        if self.scene.tracks_work:
            multipliers = self.solve(q, v)[1] if self.scene.motions else np.zeros(len(self.row_numbers))
            self.place(q, v)
            power.append(self.power(multipliers))
        return np.concatenate([self.nodal_rates(q) @ v, rates, power])

    def power(self, multipliers: Array) -> float:
        """Return the power of forces without potential energy and of prescribed motions, W.

        Args:
            multipliers: (k,) multipliers of the constraints at the present state of Exudyn's system.
        """
        of_motions = float(multipliers @ self.phi_t()) if self.scene.motions else 0.0
        return self._applied(self.time).power - of_motions

    def retract(self, q: Array, step: Array) -> Array:
        """Move q by a small step (nv,); quaternions keep norm 1."""
        moved = q.copy()
        moved[: self.nodal_size] += self.nodal_rates(q) @ step
        for place in self.quaternions:
            moved[place] /= np.linalg.norm(moved[place])
        self._follow(q, moved)
        return moved

    def _follow(self, q: Array, moved: Array) -> None:
        """Set the angles of coordinates `moved` (nq,), which are close to q (nq,), by the poses."""
        if not self.angles:
            return
        frames = self.state(moved, np.zeros(self.nv)).frames()
        for key, place in zip(self.angles, range(self.angle_places.start, self.nq), strict=False):
            x = float(self.mechanism.measure(key, frames)[0])
            moved[place] = x + whole_revolutions(q[place] - x)

    def phi(self, q: Array) -> Array:
        """Return the residuals (k,) of joints, couplings and rotors."""
        self.place(q, np.zeros(self.nv))
        with exudyn_calls():
            self.solver.ComputeAlgebraicEquations(self.model.mbs)
        return np.array(self.solver.GetSystemResidual())[self.nodal_size :][self.row_numbers]

    def _of_couplings(self, values: list[float]) -> Array:
        """Return values of `Model.equations` as rows (k,), with zeros for the joints."""
        found = np.zeros(len(self.row_numbers))
        found[len(found) - len(values) :] = values
        return found

    def phi_t(self) -> Array:
        """Return the partial derivative (k,) of `phi` with respect to time."""
        return self._of_couplings([each.coupling.phi_t(self.time) for each in self.model.equations])

    def coupling_phi(self, q: Array) -> Array:
        """Return the residuals (c,) of couplings and prescribed motions."""
        frames = self.state(q, np.zeros(self.nv)).frames()
        known = dict(zip(self.angles, q[self.angle_places].tolist(), strict=True))
        return residuals(self.mechanism, self._couplings, frames, self.time, known).phi

    def phi_jacobian(self, q: Array) -> Array:
        """Return the constraint Jacobian (k, nv)."""
        self.place(q, np.zeros(self.nv))
        return self._constraint_matrix() @ self.nodal_rates(q)

    def velocity_transformation(self, q: Array) -> Array:
        """Return the Jacobian (6 b, nv) of the body velocities."""
        matrix = np.zeros((6 * (self.count + 1), self.nv))
        for k, place in enumerate(self.quaternions):
            first = 6 * (k + 1)
            matrix[first : first + 3, 6 * k : 6 * k + 3] = np.eye(3)
            matrix[first + 3 : first + 6, 6 * k + 3 : 6 * k + 6] = rotation(q[place])
        return matrix

    def mass_and_force(self, q: Array, v: Array) -> tuple[Array, Array]:
        """Return M (nv, nv) and f (nv,)."""
        self.place(q, v)
        to_rates = self.nodal_rates(q)
        with exudyn_calls():
            self.solver.ComputeODE2RHS(self.model.mbs)
        force = to_rates.T @ np.array(self.solver.GetSystemResidual())[: self.nodal_size]
        return to_rates.T @ self._mass_matrix() @ to_rates, force

    def acceleration(self, q: Array, v: Array) -> Array:
        """Return dv/dt (nv,)."""
        return self.solve(q, v)[0]

    def loaded_friction(self, q: Array, v: Array, factor: float = 1.0) -> Mapping[str, Scalar]:
        """Return no frictions: those that grow with reactions are limits."""
        return {}

    def solve(self, q: Array, v: Array) -> tuple[Array, Array]:
        """Return dv/dt (nv,) and multipliers (k,)."""
        if self._redundancy is None:
            self._redundancy = Redundancy.of(self)
        mass_and_force, rows = self.mass_and_force(q, v), (self.phi_jacobian(q), self.gamma(q, v))
        return solve_rigidly(self, self._redundancy, mass_and_force, rows)

    def gamma(self, q: Array, v: Array) -> Array:
        """Return gamma (k,): minus the rate of J v along the motion at constant v, and what motions add."""
        functions = [each.coupling.function for each in self.model.equations]
        of_motions = [function.acceleration(self.time) if function else 0.0 for function in functions]
        if not np.any(v):
            return self._of_couplings(of_motions)
        step = MOTION_STEP / float(np.max(np.abs(v) / self.velocity_units))
        rate = np.zeros(len(self.row_numbers))
        for point, weight in FIRST_DERIVATIVE:
            rate += weight / step * (self.phi_jacobian(self._moved(q, v, point * step)) @ v)
        return self._of_couplings(of_motions) - rate

    def _moved(self, q: Array, v: Array, time: float) -> Array:
        """Return q after a time, s, at constant v: straight lines, and rotations about axes of the bodies."""
        moved = q.copy()
        for k, place in enumerate(self.quaternions):
            moved[NODAL * k : NODAL * k + 3] += time * v[6 * k : 6 * k + 3]
            moved[place] = product(q[place], from_rotation_vector(time * v[6 * k + 3 : 6 * k + 6]))
        moved[NODAL * self.count : self.nodal_size] += time * v[6 * self.count :]
        self._follow(q, moved)
        return moved

    def _energies(self, q: Array, v: Array) -> Energies:
        """Return the energies at the present state of Exudyn's system, which is q and v."""
        rates = self.nodal_rates(q) @ v
        positions = np.reshape(q[: NODAL * self.count], (-1, NODAL))[:, :3]
        return {
            "kinetic_energy": 0.5 * float(rates @ self._mass_matrix() @ rates),
            "potential_energy": self._applied(self.time).energy
            - float(np.sum(weights(self.model) * positions)),
            "work": float(q[-1]) if self.scene.tracks_work else None,
        }

    def observe(self, q: Array, v: Array) -> Observation:
        """Return poses, velocities and energies."""
        state = self.state(q, v)
        return Observation(state=state, **self._energies(q, v))

    def evaluate(self, q: Array, v: Array) -> Evaluation:
        """Return accelerations, reactions and energies; reactions are Exudyn's C_q^T times multipliers."""
        return self.evaluation(q, v, *self.solve(q, v))

    def evaluation(self, q: Array, v: Array, acceleration: Array, multipliers: Array) -> Evaluation:
        """Return accelerations of bodies and reactions.

        Args:
            q, v: (nq,) and (nv,), the state.
            acceleration: (nv,) dv/dt.
            multipliers: (k,) of M dv/dt = f + J^T multipliers.
        """
        jacobian = self.phi_jacobian(q)
        state = self.state(q, v)
        frames = state.frames()
        linear, angular = np.zeros((2, len(frames), 3))
        for k in range(self.count):
            of_body = acceleration[6 * k : 6 * k + 6]
            linear[k + 1], angular[k + 1] = of_body[:3], frames[k + 1].rotation @ of_body[3:]
        reaction = self._reactions(frames, jacobian, multipliers)
        return Evaluation(
            state=state,
            **self._energies(q, v),
            linear_acceleration=linear,
            angular_acceleration=angular,
            reaction_force=reaction[:, :3],
            reaction_torque=reaction[:, 3:],
            actuator_force=self._applied(self.time).control,
        )

    def _reactions(self, frames: Sequence[Frame], jacobian: Array, multipliers: Array) -> Array:
        """Return the force and torque (j, 6) of each joint on its second body, about its point, world frame.

        A joint also transmits the forces of couplings and prescribed motions along its coordinates.
        """
        mechanism, points = self.mechanism, joint_points(self.mechanism, frames)
        found = np.zeros((len(mechanism.joints), 6))
        for index, equations in enumerate(mechanism.equations):
            rows = [k for k, row in enumerate(self.model.rows) if row.joint == index]
            # the wrench on the second body, or minus that on the first body if the second is the ground
            body, sign = (equations.second, 1.0) if equations.second else (equations.first, -1.0)
            on_body = sign * (jacobian[rows, 6 * (body - 1) : 6 * body].T @ multipliers[rows])
            on_body[3:] = frames[body].rotation @ on_body[3:]
            found[index] = moved_wrench(on_body, frames[body].position - points[index])
        of_equations = multipliers[len(multipliers) - len(self.model.equations) :].tolist()
        for coupling, multiplier in zip(self.model.equations, of_equations, strict=True):
            if not coupling.rotor:
                for joint, wrench in coupling.wrenches_on_second(frames, multiplier):
                    index = mechanism.joint_index(joint)
                    second = frames[mechanism.equations[index].second]
                    found[index] += moved_wrench(wrench, second.position - points[index])
        return found
