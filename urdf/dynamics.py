"""The equations of motion of a scene by Pinocchio, from its URDF and loop file.

Accelerations are those of `pinocchio.constraintDynamics`: rigid closures by the sparse Cholesky
factorisation of Carpentier, Budhiraja and Mansard, "Proximal and Sparse Resolution of Constrained
Dynamic Equations", RSS 2021. Its iterations take noise of redundant closures for constraints, and cannot
leave rows out: where there is such noise, the closures that are kept are eliminated with Pinocchio's own mass
matrix, Jacobians and bias forces.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pinocchio as pin

from newton_euler.assemble import initial_state
from newton_euler.equations.couplings import TreeCouplings
from newton_euler.equations.dense import rank
from newton_euler.equations.redundancy import constraint_rank, loop_rank, mobility, rows_left_out
from newton_euler.equations.system import Evaluation, MassProperties
from newton_euler.errors import SingularityError
from newton_euler.integrators.projection import joint_residuals
from newton_euler.model.euler_parameters import from_rotation
from newton_euler.model.forces import JointSpring
from newton_euler.model.joint_kinds import Rod
from newton_euler.model.scene import Scene
from newton_euler.model.spanning_tree import weld_loops
from newton_euler.model.state import State
from newton_euler.scalars import Array, Scalar
from urdf.closures import Closures, frame_jacobian
from urdf.errors import UrdfError
from urdf.forces import PointForces, energy_at_joint, force_on_joint, power_on_joint
from urdf.loops import parse_loops
from urdf.model import CoordinateMap, build, link_inertia
from urdf.proximal import SHARE, converged, plain, regularised
from urdf.reactions import (
    actuator,
    driven,
    external_forces,
    joint_points,
    joint_wrenches,
    reactions,
)
from urdf.rotors import Rotors
from urdf.rows import Rows, solve
from urdf.write import closures, to_loops, to_urdf


class PinocchioSystem:
    """A scene in Pinocchio: a `newton_euler.equations.system.System`.

    q (nq,) and v (nv,) are coordinates of the spanning tree of the welded mechanism, as in
    `newton_euler.model.spanning_tree`: zero at the initial pose, quaternions w-x-y-z. The work, if the scene
    tracks it, comes last in q. What Pinocchio's closures leave out, see `urdf.rows`.

    Accelerations are worked out in units of the mechanism's size and mass, so that rows in metres and
    rows in radians weigh alike in the regularisation of redundant closures.

    Attributes:
        closed: the Pinocchio model and its closures, SI units.
        map: between q, v and Pinocchio's.
        time: s, at which prescribed motions are looked at.
        armature: (nv,) the scene's rotors, in Pinocchio's order, SI units.
    """

    name = "pinocchio"

    def __init__(self, scene: Scene, alpha: float = 0.0) -> None:
        """Baumgarte gains of the closures are K_D = 2 alpha, K_P = alpha^2; none for alpha = 0.

        Raises:
            NameClashError: for a mechanism whose names clash in a URDF.
        """
        self.scene = scene
        self.mechanism = scene.mechanism
        self._welded = weld_loops(scene.mechanism, loaded=scene.loaded_balls)
        self._tree = self._welded.tree
        self._couplings = TreeCouplings(scene, self._tree)
        self.time = 0.0
        self.nq, self.nv = self._tree.nq + int(scene.tracks_work), self._tree.nv
        self._work = slice(self._tree.nq, self.nq)
        if self.nv == 0:  # its bindings crash on empty Jacobians
            raise UrdfError(f"scene {scene.name!r}: no joint can move; needed by Pinocchio: one that can")
        text, loops = to_urdf(scene), parse_loops(to_loops(scene), f"{scene.name}.loops.yaml")
        self.closed = build(text, loops, alpha)
        self._model = self.closed.model
        self._model.gravity = pin.Motion(scene.gravity, np.zeros(3))
        self.map = CoordinateMap(self._model, self._welded)
        self._bodies = self._add_body_frames()
        self._forces = PointForces(scene, self._model, self._bodies)
        self._data = self._model.createData()
        self._length = self._tree.mechanism.size
        self._mass = sum(body.mass for body in self.mechanism.bodies[1:])
        self.velocity_units = self._tree.velocity_units
        self._q_units = np.ones(self.nq)
        for motion, on_q, _ in self._tree.motions:
            self._q_units[on_q] = self._length if motion.kind == "slide" else 1.0
        self._scaled = build(text, loops, alpha, self._length, self._mass)
        self._scaled.model.gravity = pin.Motion(scene.gravity / self._length, np.zeros(3))
        self._scaled_data = self._scaled.model.createData()
        self._constraint_data = pin.StdVec_RigidConstraintData(
            [constraint.createData() for constraint in self._scaled.constraints]
        )
        pin.initConstraintDynamics(
            self._scaled.model, self._scaled_data, self._scaled.constraints, self._constraint_data
        )
        self._closures = Closures(self.closed, self.map, self._length)
        self._rows = Rows(self.closed, self.map, self._couplings, self._length, alpha)
        self.phi_units = np.concatenate([self._closures.units, self._rows.units])
        self._set_armatures()
        self._actuators = [
            actuator(scene.mechanism, self._tree, law.joint, law.coordinate) for law in scene.joint_forces
        ]
        self._actuated_q = np.array([place.on_q for place in self._actuators], dtype=int)
        self._actuated_v = np.array([place.on_v for place in self._actuators], dtype=int)
        self._alpha = alpha
        self._noisy = mobility(scene).residual > 0.0
        self._proximal = self._proximal_settings()

    def _add_body_frames(self) -> list[int]:
        """Add the frames of the bodies: at the centre of mass, turned by `Body.quaternion`."""
        data = self._model.createData()
        pin.framesForwardKinematics(self._model, data, pin.neutral(self._model))
        added = []
        for body, rotation in zip(self.mechanism.bodies, self._tree.initial_rotations, strict=False):
            index = self._model.getFrameId(body.name, pin.FrameType.BODY)
            link = self._model.frames[index]
            center = body.center_of_mass - data.oMf[index].translation
            placement = link.placement * pin.SE3(rotation, center)
            frame = pin.Frame(f"{body.name}_body", link.parentJoint, index, placement, pin.FrameType.OP_FRAME)
            added.append(self._model.addFrame(frame))
        return added

    def _set_armatures(self) -> None:
        """Give the model of the accelerations the scene's rotors; a URDF has none.

        Not the other one: Pinocchio's kinetic energy has them only in part.
        """
        self._rotors = Rotors(self.scene, self._tree)
        inertias = self._rotors.inertias
        units = self._mass * self._length**2 / self.velocity_units**2
        self.armature = self.map.v_to_pinocchio(inertias)
        self._scaled.model.armature = self.map.v_to_pinocchio(inertias / units)

    def _proximal_settings(self) -> Any:
        """Plain elimination for independent closures, iterations for redundant ones.

        Pinocchio returns NaN for redundant closures without regularisation.
        """
        q, _ = self.coordinates(initial_state(self.scene))
        self._place(q)
        jacobian = self._dimensionless()
        rods = {joint.name for joint in self.mechanism.joints if isinstance(joint, Rod)}
        closures = loop_rank(self, rods)
        self._rows_rank = constraint_rank(self) - closures
        self._redundant = len(jacobian) - min(rank(jacobian), closures)
        if not self._redundant:
            return plain()
        settings = self._regularised(q)
        self._redundant = len(jacobian) - closures  # the start may be singular, where more are
        return settings

    def _dimensionless(self) -> Array:
        """(k, nv) Jacobian of the closures where Pinocchio's frames are."""
        return self._closures.jacobian(self._data) * self.velocity_units / self._closures.units[:, None]

    def _regularised(self, q: Array) -> Any:
        """Iterations for redundant closures, as the configuration asks for them."""
        self._place(q)
        return regularised(self._dimensionless(), self._mass_matrix(q), self._redundant)

    def _mass_matrix(self, q: Array) -> Array:
        """(nv, nv) in units of the mechanism's size and mass."""
        # Pinocchio fills only the upper half
        upper = np.triu(
            pin.crba(self._scaled.model, self._scaled_data, self.map.q_to_pinocchio(q / self._q_units))
        )
        mass: Array = self.map.v_from_pinocchio(self.map.v_from_pinocchio(upper + np.triu(upper, 1).T).T)
        return mass

    # What integrators, projection and assembly ask for

    def coordinates(self, state: State) -> tuple[Array, Array]:
        """q and v of a state."""
        q, v = self._tree.coordinates(self._welded.state(state))
        q = self._couplings.turned(q, self.time)
        return np.concatenate([q, np.zeros(self.nq - len(q))]), v

    def rate(self, q: Array, v: Array) -> Array:
        """qdot (nq,)."""
        rates = self._tree.rate(q, v)
        return np.append(rates, self.power(q, v)) if self.scene.tracks_work else rates

    def power(self, q: Array, v: Array) -> float:
        """Power of what is not in the potential energy, W."""
        laws = zip(self.scene.joint_forces, self._measured(q, v), strict=True)
        power = float(sum(power_on_joint(law, *seen, self.time) for law, seen in laws))
        if self._forces:
            self._move(q, v)
            power += self._forces.power(self._data)
        if self.scene.motions:
            power += self._rows.motion_power(self._solve(q, v)[1], self.time)
        return power

    def retract(self, q: Array, step: Array) -> Array:
        """q moved by a small step (nv,)."""
        return np.concatenate([self._tree.retract(q, step), q[self._work]])

    def measure(self, q: Array, v: Array) -> list[tuple[Scalar, Scalar]]:
        """Coordinate (m or rad) and rate of each control law."""
        return self._measured(q, v)[: len(self.scene.control)]

    def _measured(self, q: Array, v: Array) -> list[tuple[Scalar, Scalar]]:
        """The same of `Scene.joint_forces`, as Python's numbers, whose arithmetic is quicker than NumPy's."""
        return list(zip(q[self._actuated_q].tolist(), v[self._actuated_v].tolist(), strict=True))

    def actuation(self, q: Array, v: Array) -> Array:
        """Forces on joint coordinates, N or N m, in the order of `Scene.joint_forces`."""
        laws = zip(self.scene.joint_forces, self._measured(q, v), strict=True)
        return np.array([force_on_joint(law, *seen, self.time) for law, seen in laws])

    def _move(self, q: Array, v: Array) -> None:
        """Give Pinocchio's joints and frames a state."""
        pin_q, pin_v = self.map.q_to_pinocchio(q), self.map.v_to_pinocchio(v)
        pin.forwardKinematics(self._model, self._data, pin_q, pin_v)
        pin.updateFramePlacements(self._model, self._data)

    def generalized_force(self, q: Array, v: Array) -> Array:
        """(nv,) of all forces but gravity."""
        force = np.zeros(self.nv)
        np.add.at(force, self._actuated_v, self.actuation(q, v))
        if self._forces:
            self._move(q, v)
            pin.computeJointJacobians(self._model, self._data)
            for push in self._forces.pushes(self._data):
                wrench = np.concatenate([push.force, push.torque])
                force += self.map.v_from_pinocchio(
                    wrench @ frame_jacobian(self._model, self._data, push.frame)
                )
        return force

    def acceleration(self, q: Array, v: Array) -> Array:
        """vdot (nv,); raises `SingularityError` where Pinocchio has no finite answer."""
        return self._solve(q, v)[0]

    def _solve(self, q: Array, v: Array) -> tuple[Array, Array]:
        """vdot (nv,) and the multipliers (r,) of `Rows`; those of closures stay with Pinocchio."""
        unit = self._mass * self._length**2  # of generalized forces
        force = self.generalized_force(q, v) * self.velocity_units / unit
        if self._noisy:
            acceleration, multipliers = self._eliminate(q, v, force)
            multipliers = multipliers * unit / self.phi_units
            self._multipliers = multipliers[: len(self._closures.units)]
            return self.velocity_units * acceleration, multipliers[len(self._closures.units) :]
        rows, gamma = self._rows.equations(self._data, q, v, self.time)
        units = self._rows.units
        acceleration, multipliers = solve(
            self._iterating(q, v),
            force,
            rows * self.velocity_units / units[:, None],
            gamma / units,
            self._rows_rank,
        )
        return self.velocity_units * acceleration, multipliers * unit / units

    def _iterating(self, q: Array, v: Array) -> Callable[[Array], Array]:
        """Accelerations (nv,) of a generalized force (nv,) by `constraintDynamics`, all dimensionless."""
        scaled_q = self.map.q_to_pinocchio(q / self._q_units)
        scaled_v = self.map.v_to_pinocchio(v / self.velocity_units)

        settings = self._proximal

        def solved(force: Array) -> Array:
            acceleration = pin.constraintDynamics(
                self._scaled.model,
                self._scaled_data,
                scaled_q,
                scaled_v,
                self.map.v_to_pinocchio(force),
                self._scaled.constraints,
                self._constraint_data,
                settings,
            )
            self._check(acceleration)
            return self.map.v_from_pinocchio(acceleration)

        def respond(force: Array) -> Array:
            nonlocal settings
            acceleration = solved(force)
            if settings is self._proximal and not converged(settings):
                here = self._regularised(q)
                # not for closures that contradict each other: less of it would magnify that
                if here.mu < SHARE * settings.mu:
                    settings = here
                    return solved(force)
            return acceleration

        return respond

    def _eliminate(self, q: Array, v: Array, force: Array) -> tuple[Array, Array]:
        """Accelerations (nv,) and multipliers (k,) of constraints but for those redundant up to noise.

        `force` (nv,) and results are dimensionless.
        """
        units = self.phi_units
        used = np.setdiff1d(np.arange(len(units)), rows_left_out(self))
        scaled_q = self.map.q_to_pinocchio(q / self._q_units)
        scaled_v = self.map.v_to_pinocchio(v / self.velocity_units)
        model, data = self._scaled.model, self._scaled_data
        bias = self.map.v_from_pinocchio(pin.nonLinearEffects(model, data, scaled_q, scaled_v))
        mass = self._mass_matrix(q)
        of = (self.map.q_to_pinocchio(q), self.map.v_to_pinocchio(v), np.zeros(self.nv))
        pin.forwardKinematics(self._model, self._data, *of)
        pin.computeJointJacobians(self._model, self._data)
        pin.updateFramePlacements(self._model, self._data)
        loops = self._closures.jacobian(self._data)
        drift = 2.0 * self._alpha * (loops @ v) + self._alpha**2 * self._closures.phi(self._data)
        rows, gamma = self._rows.equations(self._data, q, v, self.time)
        gamma = (np.concatenate([self._closures.gamma(self._data) - drift, gamma]) / units)[used]
        jacobian = (np.concatenate([loops, rows]) * self.velocity_units / units[:, None])[used]
        matrix = np.block([[mass, -jacobian.T], [jacobian, np.zeros((len(used), len(used)))]])
        try:
            found = np.linalg.solve(matrix, np.concatenate([force - bias, gamma]))
        except np.linalg.LinAlgError:
            found = np.full(len(matrix), np.nan)
        self._check(found)
        multipliers = np.zeros(len(units))
        multipliers[used] = found[self.nv :]
        return found[: self.nv], multipliers

    def _check(self, acceleration: Array) -> None:
        if not np.all(np.isfinite(acceleration)):
            names = [self._welded.mechanism.joint_names[k] for k in self._tree.cuts]
            raise SingularityError(
                ", ".join(names) or self.mechanism.joint_names[0],
                "Pinocchio's constraintDynamics returned numbers that are not finite",
            )

    def _closure_wrenches(self, multipliers: Array) -> list[Any]:
        """What cuts do to their second bodies, about the world's origin, SI units, in the tree's order."""
        if self._noisy:
            wrenches = self._closures.wrenches(self._data, self._multipliers)
        else:
            force = self._mass * self._length
            scaled = [-data.oMc1.act(data.contact_force) for data in self._constraint_data]
            wrenches = [pin.Force(w.linear * force, w.angular * force * self._length) for w in scaled]
        closures = iter(wrenches)
        rods = iter(self._rows.rod_wrenches(self._data, multipliers))
        joints = [self._tree.joint(cut) for cut in self._tree.cuts]
        return [next(rods if isinstance(joint, Rod) else closures) for joint in joints]

    def phi(self, q: Array) -> Array:
        """Residuals (k,) of the closures, then of `Rows`."""
        pin.framesForwardKinematics(self._model, self._data, self.map.q_to_pinocchio(q))
        return np.concatenate([self._closures.phi(self._data), self._rows.phi(self._data, q, self.time)])

    def joint_phi(self, q: Array) -> Array:
        """Residuals of all joints' equations, then of the couplings, m or rad."""
        joints = joint_residuals(self.mechanism, self.state(q, np.zeros(self.nv)))
        return np.concatenate([joints, self._couplings.phi(q, self.time)])

    def phi_t(self) -> Array:
        """Partial derivative (k,) of `phi` by time."""
        return np.concatenate([np.zeros(len(self._closures.units)), self._rows.phi_t(self.time)])

    def phi_jacobian(self, q: Array) -> Array:
        """Derivative (k, nv) of `phi` along `retract`, and of its rate by v."""
        self._place(q)
        return np.concatenate([self._closures.jacobian(self._data), self._rows.jacobian(self._data)])

    def _place(self, q: Array) -> None:
        """Joint Jacobians and frame placements at q."""
        pin.computeJointJacobians(self._model, self._data, self.map.q_to_pinocchio(q))
        pin.updateFramePlacements(self._model, self._data)

    # Between Pinocchio and what everybody understands

    def mass_properties(self) -> MassProperties:
        """What the bodies weigh in Pinocchio's model; halves of a body are put together."""
        pin.framesForwardKinematics(self._model, self._data, pin.neutral(self._model))
        found = MassProperties.of(self.mechanism)  # of the ground, which has no inertia in a URDF
        names = self._welded.mechanism.body_names
        for body in range(1, len(self.mechanism.bodies)):
            total = pin.Inertia.Zero()
            for name, whole in zip(names, self._welded.origin, strict=True):
                if whole == body:
                    index = self._model.getFrameId(name, pin.FrameType.BODY)
                    total += self._data.oMf[index].act(link_inertia(self._model, index))
            found.mass[body] = total.mass
            found.center_of_mass[body] = total.lever
            found.inertia[body] = total.inertia
        return found

    def state(self, q: Array, v: Array) -> State:
        """Body poses and velocities by Pinocchio's forward kinematics."""
        pin.forwardKinematics(self._model, self._data, self.map.q_to_pinocchio(q), self.map.v_to_pinocchio(v))
        return self._state()

    def _state(self) -> State:
        """The state that the last forward kinematics left."""
        pin.updateFramePlacements(self._model, self._data)
        poses = [self._data.oMf[frame] for frame in self._bodies]
        velocities = self._frame_motions(pin.getFrameVelocity)
        return State(
            np.array([pose.translation for pose in poses]),
            np.array([from_rotation(pose.rotation) for pose in poses]),
            velocities[:, :3],
            velocities[:, 3:],
        )

    def _frame_motions(self, of: Any) -> Array:
        """(b, 6) linear and angular velocities or accelerations of the bodies, world frame."""
        return np.array(
            [of(self._model, self._data, frame, pin.LOCAL_WORLD_ALIGNED).vector for frame in self._bodies]
        )

    def velocity_transformation(self, q: Array) -> Array:
        """(6 b, nv): v and omega of body 0, 1, ... for each velocity, by Pinocchio's Jacobians."""
        self._place(q)
        rows = np.concatenate([frame_jacobian(self._model, self._data, frame) for frame in self._bodies])
        return self.map.v_from_pinocchio(rows)

    def evaluate(self, q: Array, v: Array) -> Evaluation:
        """Accelerations, reactions and energies at a state.

        Raises:
            SingularityError: where Pinocchio has no finite accelerations.
        """
        qddot, multipliers = self._solve(q, v)
        pin_q, pin_v = self.map.q_to_pinocchio(q), self.map.v_to_pinocchio(v)
        pin_a = self.map.v_to_pinocchio(qddot)
        pin.forwardKinematics(self._model, self._data, pin_q, pin_v, pin_a)
        state = self._state()
        closure_wrenches = self._closure_wrenches(multipliers)
        cut_wrenches = [
            (self._model.getFrameId(name, pin.FrameType.BODY), sign * wrench)
            for pair, wrench in zip(closures(self._welded), closure_wrenches, strict=True)
            for (name, _, _), sign in zip(pair, (-1.0, 1.0), strict=True)
        ]
        accelerations = self._frame_motions(pin.getFrameClassicalAcceleration)
        applied = self._forces.wrenches(self._data)
        cut_wrenches += zip(self._bodies, applied, strict=True)
        external = external_forces(self._model, self._data, cut_wrenches)
        pin.rnea(self._model, self._data, pin_q, pin_v, pin_a, external)
        wrenches = joint_wrenches(
            self.scene,
            self._welded,
            self._model,
            self._data,
            [wrench.vector for wrench in closure_wrenches],
            [wrench.vector for wrench in applied],
            state,
            accelerations,
        )
        actuation = self.actuation(q, v)
        pin.computeJointJacobians(self._model, self._data, pin_q)
        columns = self.map.v_from_pinocchio(np.reshape(self._data.J, (6, self.nv)))
        forces_on = list(zip(self._actuators, actuation, strict=True))
        forces_on += self._rotors.forces(qddot)
        points = joint_points(self.scene, state)
        forces, torques = reactions(wrenches, points, driven(self._tree, columns, points, forces_on))
        for joint, torque in self._rotors.torques(state.frames(), accelerations[:, 3:]):
            torques[joint] -= torque
        kinetic = pin.computeKineticEnergy(self._model, self._data, pin_q, pin_v) + self._rotors.energy(v)
        potential = pin.computePotentialEnergy(self._model, self._data, pin_q)
        return Evaluation(
            state,
            accelerations[:, :3],
            accelerations[:, 3:],
            forces,
            torques,
            actuation[: len(self.scene.control)],
            kinetic,
            potential + self._fixed_energy() + self._springs_energy(q, v),
            q[self._work][0] if self.scene.tracks_work else None,
        )

    def _springs_energy(self, q: Array, v: Array) -> float:
        """Energy of all springs, J."""
        laws = zip(self.scene.joint_forces, self._measured(q, v), strict=True)
        turned = sum(energy_at_joint(law, x) for law, (x, _) in laws if isinstance(law, JointSpring))
        return float(turned) + self._forces.energy(self._data)

    def _fixed_energy(self) -> float:
        """Potential energy of bodies that fixed joints hold to the ground; Pinocchio leaves it out."""
        fixed = self._model.inertias[0]
        return -fixed.mass * float(self.scene.gravity @ fixed.lever)
