"""Equations of motion of a scene by Pinocchio, from the exported URDF and loop file of the scene.

A scene is a mechanism with its forces, control laws and initial state. The loop file lists what a URDF cannot
describe, such as closed loops. Springs, wind and control laws are not in the files; `urdf.forces` adds them.

Accelerations come from `pinocchio.constraintDynamics`, a sparse Cholesky factorization with rigid loop
closures (Carpentier, Budhiraja and Mansard, "Proximal and Sparse Resolution of Constrained Dynamic
Equations", RSS 2021). In the following cases, the linear system of accelerations and multipliers is solved
with Pinocchio's mass matrix, Jacobians and bias forces instead ("elimination" in this module):

- rods, couplings and prescribed motions, which `constraintDynamics` does not support;
- loop closures that are redundant up to the rounding of the file: `constraintDynamics` treats the rounding as
  constraints, and cannot omit rows;
- bodies with almost no inertia that close a loop, for which `constraintDynamics` loses digits.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from newton_euler.equations.coupling_equations import TreeCouplings
from newton_euler.equations.drives import drive_wrenches, joint_points
from newton_euler.equations.engine_solution import Redundancy, servo_forces, solve_rigidly, tree_rows
from newton_euler.equations.load_friction import EngineFriction, HeldFriction
from newton_euler.equations.model_control import EngineControl, roles
from newton_euler.equations.redundancy import constraint_rank, mobility
from newton_euler.equations.system import Evaluation, MassProperties, Observation
from newton_euler.errors import SingularityError
from newton_euler.model.constraints import Frame
from newton_euler.model.control import NO_FORCES
from newton_euler.model.euler_parameters import from_rotation
from newton_euler.model.joint import Key
from newton_euler.model.joint_geometry import JointGeometry
from newton_euler.model.joint_kinds import Rod
from newton_euler.model.scene import Scene
from newton_euler.model.spanning_tree import weld_loops
from newton_euler.model.state import State
from newton_euler.reading.switched_loads import SwitchedLoads
from newton_euler.runs.assemble import initial_state
from newton_euler.scalars import Array, Scalar
from urdf.constraints import Closures, Rows, frame_jacobian
from urdf.errors import UrdfError
from urdf.forces import BallForces, JointLaws, PointForces, Rotors
from urdf.initial_pose import joint_geometry, mass_properties
from urdf.loops import parse_loops
from urdf.model import CoordinateMap, build, mass_matrix
from urdf.proximal import ConstraintDynamics, Units
from urdf.reactions import external_forces, joint_wrenches, reactions
from urdf.write import closures, to_loops, to_urdf


class Solution(NamedTuple):
    """Accelerations and multipliers at a state.

    Attributes:
        acceleration: (nv,) dv/dt.
        of_closures: multipliers of the rows of loop closures by balls and welds; empty if
            `constraintDynamics` has solved, whose own data keep the forces of the closures.
        of_others: (r,) multipliers of the rows of rods, prescribed motions and couplings.
    """

    acceleration: Array
    of_closures: Array
    of_others: Array


class PinocchioSystem:
    """Equations of motion of a scene by Pinocchio, a `newton_euler.equations.system.System`.

    Loops are closed by a ball, a rod (a massless link with a ball at each end) or a weld only. At any other
    joint that closes a loop, a body is cut into two halves, which a weld joins: the welded mechanism. q (nq,)
    and v (nv,) are coordinates of the spanning tree of the welded mechanism, see
    `newton_euler.model.spanning_tree`: zero at the initial pose, quaternions (w, x, y, z). If the scene
    tracks the work of forces without potential, this work, J, is the last element of q. Constraint rows (k,)
    are those of loop closures by balls and welds, then those of rods, prescribed motions and couplings, see
    `urdf.constraints`.

    Attributes:
        scene: scene; a copy of this object may have another scene, with the present values of sampled
            controllers and jumping set-points.
        mechanism: mechanism of the scene.
        closed: Pinocchio's model with its loop closures, SI units.
        map: map between q, v and Pinocchio's coordinates.
        couplings: gears, screws and prescribed motions.
        quaternions: slices of the quaternions in q.
        time: time, s, of prescribed motions, control laws and wind.
        nq: number of coordinates, including the work.
        nv: number of velocities.
        phi_units: (k,) divisors that make the constraint rows dimensionless: the mechanism's size, m, or 1.
        velocity_units: (nv,) divisors of the velocities: the mechanism's size, m, or 1.
    """

    name = "pinocchio"

    def __init__(self, scene: Scene, alpha: float = 0.0) -> None:
        """Build Pinocchio's model.

        Args:
            scene: scene to evaluate.
            alpha: parameter, 1/s, of Baumgarte's gains K_D = 2 alpha, K_P = alpha^2; 0 for no stabilization.

        Raises:
            NameClashError: for a mechanism whose names clash in a URDF.
            UrdfError: for a mechanism that cannot move.
        """
        self.scene = scene
        self.mechanism = scene.mechanism
        # loaded: never close a loop by a ball with a spring, damper or armature
        self._welded = weld_loops(scene.mechanism, loaded=scene.loaded_balls)
        self._tree = self._welded.tree
        self.quaternions = self._tree.quaternions
        self.couplings = TreeCouplings(scene, self._tree)
        self.time = 0.0
        self.nq, self.nv = self._tree.nq + int(scene.tracks_work), self._tree.nv
        self._work = slice(self._tree.nq, self.nq)
        if self.nv == 0:  # Pinocchio's bindings crash on empty Jacobians
            raise UrdfError(f"scene {scene.name!r}: no joint can move; Pinocchio needs a moving joint")
        # the model, from the texts of URDF and loop file; `keeps_axes` prevents the rounding of hinge axes by
        # Pinocchio's parser
        text, loops = to_urdf(scene), parse_loops(to_loops(scene), f"{scene.name}.loops.yaml")
        self.closed = build(text, loops, alpha, keeps_axes=True)
        self._model = self.closed.model
        self._model.gravity = pin.Motion(scene.gravity, np.zeros(3))
        self.map = CoordinateMap(self._model, self._welded)
        names = self._welded.mechanism.body_names
        self._links = [self._model.getFrameId(name, pin.FrameType.BODY) for name in names]
        self._body_frames = self._add_body_frames()
        self._forces = PointForces(scene, self._model, self._body_frames)
        self._balls = BallForces(scene, self._tree)
        self._rotors = Rotors(scene, self._tree)
        self._model.armature = self.map.v_to_pinocchio(self._rotors.inertias)
        # data of kinematics, and of mass matrices and bias forces, which do not overwrite the first
        self._data, self._dynamic_data = self._model.createData(), self._model.createData()
        # units, constraints and control laws
        self.velocity_units, length = self._tree.velocity_units, self._tree.mechanism.size
        q_units = np.ones(self.nq)
        # elementary motions of the joints of the tree: slides, hinges and balls
        for motion, in_q, _ in self._tree.motions:
            q_units[in_q] = length if motion.kind == "slide" else 1.0
        mass = sum(body.mass for body in self.mechanism.bodies[1:])
        self._units = Units(length, mass, q_units, self.velocity_units)
        self._closures = Closures(self.closed, self.map, length)
        self._rows = Rows(self.closed, self.map, self.couplings, length)
        self.phi_units = np.concatenate([self._closures.units, self._rows.units])
        # joint coordinates that springs and laws act on, then other coordinates that laws measure; none of
        # these joints closes a loop
        actuated = [law.key for law in scene.joint_forces]
        keys = actuated + [key for key in scene.sensed if key not in actuated]  # (joint name, index)
        self._laws = JointLaws(scene.joint_forces, keys)
        indices = np.array([self._tree.place(*key) for key in keys], dtype=int).reshape(-1, 2)
        self._measured_q, self._measured_v = indices.T
        self._actuated_v = self._measured_v[: len(actuated)]
        self._sensed = [keys.index(key) for key in scene.sensed]
        # switched forces, and the indices in q and v of their coordinates
        self._switched = SwitchedLoads(scene)
        self.held_friction: HeldFriction | None = None
        self._friction = EngineFriction(scene, PinocchioSystem)
        switched = [self._tree.place(*key) for key in self._switched.keys]
        self._switched_q, self._switched_v = np.array(switched, dtype=int).reshape(-1, 2).T
        # inverse dynamics, if a control law uses a model of the mechanism (`roles` finds such laws)
        self._model_control = EngineControl(scene, PinocchioSystem) if roles(scene) else None
        self._alpha = alpha
        # choose between constraintDynamics and elimination. Elimination is needed for rows that
        # constraintDynamics does not have, for a mechanism whose independent rows change along the motion
        # (`exchangeable`), and for rows that are redundant up to rounding (`residual`): such rows contradict
        # each other when a run drifts from closed loops
        analysis = mobility(scene)
        needs_elimination = len(self._rows.units) > 0 or len(analysis.exchangeable) > 0
        self._eliminates = needs_elimination or analysis.residual > 0.0
        # states and results of the latest evaluation of actuators and springs, and of the latest elimination
        self._latest_actuation: tuple[Any, Array] = None, np.zeros(0)
        self._latest_solution: tuple[Any, Solution] | None = None
        self._latest_jacobian: tuple[bytes, Array] = b"", np.zeros((0, 0))
        if not self._eliminates:
            q, _ = self.coordinates(initial_state(scene))
            rank = constraint_rank(self)
            self._proximal = ConstraintDynamics(self.closed, self.map, self._units, q, rank)
            self._eliminates = self._proximal.loses_digits
        if self._eliminates:
            self._redundancy = Redundancy.of(self)
        self._needs_kinematics = bool(self._forces) or self._eliminates

    def _add_body_frames(self) -> list[int]:
        """Add a frame for each body, at the center of mass with orientation `Body.quaternion`.

        Returns:
            Numbers of the frames.
        """
        data = self._model.createData()
        pin.framesForwardKinematics(self._model, data, pin.neutral(self._model))
        numbers = []
        # the tree has additional halves of cut bodies at the end
        for body, rotation in zip(self.mechanism.bodies, self._tree.initial_rotations, strict=False):
            index = self._model.getFrameId(body.name, pin.FrameType.BODY)
            link = self._model.frames[index]
            center = body.center_of_mass - data.oMf[index].translation
            placement = link.placement * pin.SE3(rotation, center)
            frame = pin.Frame(f"{body.name}_body", link.parentJoint, index, placement, pin.FrameType.OP_FRAME)
            numbers.append(self._model.addFrame(frame))
        return numbers

    def mass_matrix(self, q: Array) -> Array:
        """Compute the mass matrix (nv, nv) with the inertias of rotors."""
        return mass_matrix(self._model, self._dynamic_data, self.map, self.map.q_to_pinocchio(q))

    def mass_and_force(self, q: Array, v: Array) -> tuple[Array, Array]:
        """Compute M (nv, nv) and f (nv,) of M dv/dt = f + J^T lambda, by Pinocchio.

        J is the constraint Jacobian; lambda are the multipliers of its rows.
        """
        pin_q, pin_v = self.map.q_to_pinocchio(q), self.map.v_to_pinocchio(v)
        bias = pin.nonLinearEffects(self._model, self._dynamic_data, pin_q, pin_v)
        return self.mass_matrix(q), self.generalized_force(q, v) - self.map.v_from_pinocchio(bias)

    # The interface of integrators, projection and assembly

    def coordinates(self, state: State) -> tuple[Array, Array]:
        """Return coordinates q (nq,) and velocities v (nv,) of a state; the work is zero."""
        q, v = self._tree.coordinates(self._welded.state(state))
        # poses give angles up to full revolutions; `turned` adds the revolutions that couplings need
        q = self.couplings.turned(q, state, self.time)
        return np.concatenate([q, np.zeros(self.nq - len(q))]), v

    def rate(self, q: Array, v: Array) -> Array:
        """Return dq/dt (nq,); the rate of the work is the power."""
        rates = self._tree.rate(q, v)
        return np.append(rates, self.power(q, v)) if self.scene.tracks_work else rates

    def power(self, q: Array, v: Array) -> float:
        """Compute the power of forces without potential, W."""
        _, rates = self._measured(q, v)
        power = self._laws.power(self.actuation(q, v), rates)
        if len(self._switched_v):
            forces, elastic = self._switched_loads(q, v)
            power += float((forces - elastic) @ v[self._switched_v])
        if self._balls:
            power += self._balls.power(v)
        if self._forces:
            self._compute_kinematics(q, v)
            power += self._forces.power(self._data, self.scene, self.time)
        if self.scene.motions:
            power += self._rows.motion_power(self._solve(q, v).of_others, self.time)
        return power

    def retract(self, q: Array, step: Array) -> Array:
        """Move q by a small step (nv,)."""
        return np.concatenate([self._tree.retract(q, step), q[self._work]])

    def measure(self, q: Array, v: Array) -> list[tuple[Scalar, Scalar]]:
        """Return coordinates, m or rad, and rates of `Scene.sensed`, the coordinates that laws measure."""
        x, rate = self._measured(q, v)
        return list(zip(x[self._sensed], rate[self._sensed], strict=True))

    def _measured(self, q: Array, v: Array) -> tuple[Array, Array]:
        """Return coordinates, m or rad, and their rates, on which forces act or that control laws measure.

        First are those of `Scene.joint_forces` (control laws and springs), then other measured coordinates.
        """
        return q[self._measured_q], v[self._measured_v]

    def actuation(self, q: Array, v: Array) -> Array:
        """Compute the forces on joint coordinates, N or N m, in the order of `Scene.joint_forces`.

        The latest forces are kept: the power and the accelerations of a state both need them.
        """
        state = self._key(q, v)
        if self._latest_actuation[0] != state:
            self._latest_actuation = state, self._actuation(q, v)
        return self._latest_actuation[1]

    def _switched_loads(self, q: Array, v: Array) -> tuple[Array, Array]:
        """Return the forces of switched forces, and their elastic parts, see `SwitchedLoads`."""
        friction = partial(self.loaded_friction, q, v)
        return self._switched.forces(q[self._switched_q], v[self._switched_v], friction)

    def loaded_friction(self, q: Array, v: Array, factor: float = 1.0) -> HeldFriction:
        """Compute the frictions that grow with reactions, see `System.loaded_friction`."""
        if self.held_friction is not None:
            return self.held_friction
        rates = v[self._switched_v[self._switched.loaded]].tolist()
        return self._friction.forces(self.scene, q, v, self.time, rates, factor)

    def _key(self, q: Array, v: Array) -> tuple[Any, ...]:
        """Return a key of a state for results that are kept, with the scene, the time and frictions."""
        held = None if self.held_friction is None else tuple(self.held_friction.items())
        return self.scene, self.time, held, q.tobytes(), v.tobytes()

    def _actuation(self, q: Array, v: Array) -> Array:
        """Compute the forces (a,) of `actuation`."""
        (x, rate), model_forces = self._measured(q, v), NO_FORCES
        if self._model_control:  # computed torque and gravity compensation
            accelerations = self._laws.commands(self.scene.control, x, rate, self.time)
            model_forces = self._model_control.forces(q[: self._tree.nq], v, self.time, accelerations)
        return self._laws.force(self.scene.joint_forces, x, rate, self.time, model_forces)

    def servo_forces(self, q: Array, v: Array, keys: Sequence[Key], accelerations: Array) -> Array:
        """Compute by inverse dynamics the forces on joint coordinates that cause given accelerations.

        Args:
            q: (nq,) tree coordinates.
            v: (nv,) tree velocities.
            keys: joint name and number of the coordinate of each force.
            accelerations: accelerations of these coordinates, m/s^2 or rad/s^2.

        Returns:
            Forces, N or N m.
        """
        mass_and_force = self.mass_and_force(q, v)
        self._compute_kinematics(q, v)
        gamma = self._gamma(q, v)
        rows_and_accelerations = tree_rows(self._tree, keys), accelerations
        return servo_forces(self, mass_and_force, (self._jacobian(q), gamma), keys, rows_and_accelerations)

    def _gamma(self, q: Array, v: Array) -> Array:
        """Return gamma (k,), the right side of J dv/dt = gamma, after `_compute_kinematics`."""
        return np.concatenate(
            [self._closures.gamma(self._data), self._rows.gamma(self._data, q, v, self.time)]
        )

    def _compute_kinematics(self, q: Array, v: Array) -> None:
        """Compute Pinocchio's joints, Jacobians and frames at a state, with zero joint accelerations."""
        pin_q, pin_v = self.map.q_to_pinocchio(q), self.map.v_to_pinocchio(v)
        pin.forwardKinematics(self._model, self._data, pin_q, pin_v, np.zeros(self.nv))
        pin.computeJointJacobians(self._model, self._data)
        pin.updateFramePlacements(self._model, self._data)

    def generalized_force(self, q: Array, v: Array) -> Array:
        """Compute the generalized forces (nv,) except gravity.

        If the scene has forces at points, or if elimination follows, the method also computes frames and
        joint Jacobians of this state in `_data`.
        """
        force = np.zeros(self.nv)
        np.add.at(force, self._actuated_v, self.actuation(q, v))
        if len(self._switched_v):
            np.add.at(force, self._switched_v, self._switched_loads(q, v)[0])
        if self._balls:
            force[self._balls.velocity_indices] += self._balls.torques(q, v)
        if self._needs_kinematics:
            self._compute_kinematics(q, v)
        if self._forces:
            applied = self._forces.applied_forces(self._data, self.scene, self.time)
            wrenches = np.array([(*each.force, *each.torque) for each in applied])
            jacobians = [frame_jacobian(self._model, self._data, each.frame) for each in applied]
            force += self.map.v_from_pinocchio(wrenches.ravel() @ np.concatenate(jacobians))
        return force

    def acceleration(self, q: Array, v: Array) -> Array:
        """Compute dv/dt (nv,); raises `SingularityError` if Pinocchio's result is not finite."""
        return self._solve(q, v).acceleration

    def _solve(self, q: Array, v: Array) -> Solution:
        """Solve for accelerations and multipliers, by `constraintDynamics` or by elimination."""
        if not self._eliminates:
            # forces and accelerations in units in which the mechanism has size 1 and mass 1; `moment` is the
            # unit of moments of inertia
            force = self.generalized_force(q, v) * self.velocity_units / self._units.moment
            acceleration = self._checked(self._proximal.acceleration(q, v, force))
            return Solution(self.velocity_units * acceleration, np.zeros(0), np.zeros(0))
        # keep the latest solution, which the power of prescribed motions also needs
        state = self._key(q, v)
        if self._latest_solution is None or self._latest_solution[0] != state:
            self._latest_solution = state, self._solve_by_elimination(q, v)
        _, solution = self._latest_solution
        return solution

    def _solve_by_elimination(self, q: Array, v: Array) -> Solution:
        """Solve the linear system of accelerations and multipliers."""
        mass, force = self.mass_and_force(q, v)  # also computes frames and joint Jacobians
        jacobian = self._jacobian(q)
        gamma = self._gamma(q, v)
        if self._alpha:
            # Baumgarte's stabilization: J dv/dt = gamma - K_D dPhi/dt - K_P Phi, K_D = 2 alpha, K_P = alpha^2
            gamma -= 2.0 * self._alpha * (jacobian @ v + self.phi_t()) + self._alpha**2 * self._phi(q)
        matrices = (mass, force), (jacobian, gamma)
        acceleration, multipliers = solve_rigidly(self, self._redundancy, *matrices)
        of_closures, of_others = np.split(multipliers, [len(self._closures.units)])
        return Solution(acceleration, of_closures, of_others)

    def _checked(self, acceleration: Array) -> Array:
        """Return accelerations (nv,), or raise `SingularityError` if they are not finite."""
        if not np.isfinite(acceleration).all():
            names = [self._welded.mechanism.joint_names[k] for k in self._tree.cuts]
            raise SingularityError(
                ", ".join(names) or None,
                "Pinocchio's constraintDynamics returned numbers that are not finite",
            )
        return acceleration

    def _closure_wrenches(self, solution: Solution) -> list[Any]:
        """Return the `pinocchio.Force` of each loop closure on its second body, about the world's origin.

        The order is that of `SpanningTree.cuts`, the joints that close loops.
        """
        if self._eliminates:
            wrenches = self._closures.wrenches(self._data, solution.of_closures)
        else:
            wrenches = self._proximal.wrenches()
        of_balls_and_welds = iter(wrenches)
        of_rods = iter(self._rows.rod_wrenches(self._data, solution.of_others))
        joints = [self._tree.joint(cut) for cut in self._tree.cuts]
        return [next(of_rods if isinstance(joint, Rod) else of_balls_and_welds) for joint in joints]

    def phi(self, q: Array) -> Array:
        """Return the residuals (k,) of all constraint rows, m or rad."""
        pin.framesForwardKinematics(self._model, self._data, self.map.q_to_pinocchio(q))
        return self._phi(q)

    def _phi(self, q: Array) -> Array:
        """Return the residuals (k,) at q, where the frames in `_data` are already placed."""
        return np.concatenate([self._closures.phi(self._data), self._rows.phi(self._data, q, self.time)])

    def coupling_phi(self, q: Array) -> Array:
        """Return the residuals (c,) of the c couplings, m or rad."""
        return self.couplings.phi(q, self.time)

    def phi_t(self) -> Array:
        """Return the partial derivative (k,) of `phi` with respect to time."""
        return np.concatenate([np.zeros(len(self._closures.units)), self._rows.phi_t(self.time)])

    def phi_jacobian(self, q: Array) -> Array:
        """Return the Jacobian J (k, nv) of `phi`: d phi = J step for q = retract(q, step).

        For a motion, d phi/dt = J v + phi_t.
        """
        if self._latest_jacobian[0] != q.tobytes():
            self._compute_jacobians(q)
            self._jacobian(q)
        return self._latest_jacobian[1]

    def _jacobian(self, q: Array) -> Array:
        """Return the constraint Jacobian (k, nv) at q, where frames and joint Jacobians are computed.

        The latest one is kept, since integrators ask for it after the accelerations at the same q.
        """
        jacobian = np.concatenate([self._closures.jacobian(self._data), self._rows.jacobian(self._data, q)])
        self._latest_jacobian = q.tobytes(), jacobian
        return jacobian

    def _compute_jacobians(self, q: Array) -> None:
        """Compute joint Jacobians and frame placements at q."""
        pin.computeJointJacobians(self._model, self._data, self.map.q_to_pinocchio(q))
        pin.updateFramePlacements(self._model, self._data)

    # Results for the bodies and joints of the scene

    def mass_properties(self) -> MassProperties:
        """Return masses and inertias of Pinocchio's model, with the halves of cut bodies combined."""
        return mass_properties(self.mechanism, self._model, self._welded)

    def joint_geometry(self) -> dict[str, JointGeometry]:
        """Return kinds, axes and points of the joints of the model at its initial pose, by name."""
        return joint_geometry(self.closed, self._welded)

    def state(self, q: Array, v: Array) -> State:
        """Return body poses and velocities by Pinocchio's forward kinematics."""
        pin.forwardKinematics(self._model, self._data, self.map.q_to_pinocchio(q), self.map.v_to_pinocchio(v))
        return self._state(self._frames(), q)

    def _frames(self) -> list[Frame]:
        """Return poses and velocities of the bodies, after forward kinematics with velocities."""
        pin.updateFramePlacements(self._model, self._data)
        poses = [self._data.oMf[frame].copy() for frame in self._body_frames]
        velocities = self._frame_motions(pin.getFrameVelocity)
        return [
            Frame(pose.translation, pose.rotation, velocity[:3], velocity[3:])
            for pose, velocity in zip(poses, velocities, strict=True)
        ]

    def _frame_motions(self, get: Any) -> Array:
        """Return linear and angular velocities or accelerations (b, 6) of bodies, world frame.

        `get` is Pinocchio's function for a frame, such as `pinocchio.getFrameVelocity`.
        """
        axes = pin.LOCAL_WORLD_ALIGNED
        return np.array([get(self._model, self._data, frame, axes).vector for frame in self._body_frames])

    def velocity_transformation(self, q: Array) -> Array:
        """Return the body Jacobian (6 b, nv): linear and angular velocity of each body per velocity v."""
        self._compute_jacobians(q)
        jacobians = [frame_jacobian(self._model, self._data, frame) for frame in self._body_frames]
        return self.map.v_from_pinocchio(np.concatenate(jacobians))

    def evaluate(self, q: Array, v: Array) -> Evaluation:
        """Compute accelerations, reactions and energies at a state.

        Raises:
            SingularityError: if Pinocchio's accelerations are not finite.
        """
        # accelerations, motion of the bodies, and wrenches of loop closures
        solution = self._solve(q, v)
        pin_q, pin_v = self.map.q_to_pinocchio(q), self.map.v_to_pinocchio(v)
        pin_a = self.map.v_to_pinocchio(solution.acceleration)
        pin.forwardKinematics(self._model, self._data, pin_q, pin_v, pin_a)
        frames = self._frames()
        closure_wrenches = self._closure_wrenches(solution)
        # external forces on links: closures, with the opposite wrench on the first body, and other forces
        wrenches_on_links = []
        for ends, wrench in zip(closures(self._welded), closure_wrenches, strict=True):
            for (link, _, _), sign in zip(ends, (-1.0, 1.0), strict=True):  # first body, second body
                wrenches_on_links.append((self._model.getFrameId(link, pin.FrameType.BODY), sign * wrench))
        accelerations = self._frame_motions(pin.getFrameClassicalAcceleration)
        applied = self._applied_wrenches(q, v)
        wrenches_on_links += zip(self._links, applied, strict=True)
        # inverse dynamics give the wrenches of tree joints
        external = external_forces(self._model, self._data, wrenches_on_links)
        pin.rnea(self._model, self._data, pin_q, pin_v, pin_a, external)
        wrenches = joint_wrenches(
            self.scene,
            self._welded,
            self._model,
            self._data,
            [wrench.vector for wrench in closure_wrenches],
            [wrench.vector for wrench in applied],
            frames,
            accelerations,
        )
        # reactions: wrenches without the drives, which are actuators, springs, rotors and switched forces
        actuation = self.actuation(q, v)
        pin.computeJointJacobians(self._model, self._data, pin_q)
        columns = self.map.v_from_pinocchio(np.reshape(self._data.J, (6, self.nv)))
        # `single`: inertias of rotors at hinges and slides; rotors at balls follow below
        drive_forces = -self._rotors.single * solution.acceleration
        np.add.at(drive_forces, self._actuated_v, actuation)
        switched_forces, *_ = self._switched_loads(q, v)
        np.add.at(drive_forces, self._switched_v, switched_forces)
        points = joint_points(self.mechanism, frames)
        drives = drive_wrenches(self._tree, columns, points, drive_forces)
        forces, torques = reactions(wrenches, points, drives)
        for joint, torque in self._rotors.torques(frames, accelerations[:, 3:]):
            torques[joint] -= torque
        return Evaluation(
            **vars(self._observation(self._state(frames, q), q, v)),
            linear_acceleration=accelerations[:, :3],
            angular_acceleration=accelerations[:, 3:],
            reaction_force=forces,
            reaction_torque=torques,
            actuator_force=actuation[: len(self.scene.control)],
        )

    def observe(self, q: Array, v: Array) -> Observation:
        """Return poses, velocities and energies by Pinocchio's forward kinematics."""
        return self._observation(self.state(q, v), q, v)

    def _observation(self, state: State, q: Array, v: Array) -> Observation:
        """Return a state and its energies, where the frames in `_data` are already placed."""
        # not pin.computeKineticEnergy, which includes armatures only in part
        kinetic = float(0.5 * v @ self.mass_matrix(q) @ v)
        # pin.computePotentialEnergy omits bodies that are fixed to the ground (Pinocchio's joint 0)
        potential = pin.computePotentialEnergy(self._model, self._data, self.map.q_to_pinocchio(q))
        root, (x, _) = self._model.inertias[0], self._measured(q, v)
        fixed = -root.mass * float(self.scene.gravity @ root.lever)
        springs = self._laws.energy(x) + self._balls.energy(q) + self._forces.energy(self._data)
        switched = self._switched.energy(q[self._switched_q])
        return Observation(
            state=state,
            kinetic_energy=kinetic,
            potential_energy=potential + fixed + springs + switched,
            work=q[self._work][0] if self.scene.tracks_work else None,
        )

    def _applied_wrenches(self, q: Array, v: Array) -> list[Any]:
        """Return the sum of the forces of balls and points on each body of the welded mechanism.

        The result has a `pinocchio.Force` about the world's origin for each body.
        """
        rotations = [self._data.oMf[link].rotation for link in self._links]
        sums = [pin.Force.Zero() for _ in self._links]
        of_points = self._forces.wrenches(self._data, self.scene, self.time)
        for body, wrench in (*self._balls.wrenches(q, v, rotations), *of_points):
            sums[body] += wrench
        return sums

    def _state(self, frames: Sequence[Frame], q: Array) -> State:
        """Return the state of bodies with these poses and velocities, at tree coordinates q."""
        return State(
            np.array([frame.position for frame in frames]),
            np.array([from_rotation(frame.rotation) for frame in frames]),
            np.array([frame.velocity for frame in frames]),
            np.array([frame.angular_velocity for frame in frames]),
            angles=self.couplings.angles(q),
        )
