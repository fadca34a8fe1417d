"""The equations of motion of a scene by Pinocchio, from its URDF and loop file.

Accelerations are those of `pinocchio.constraintDynamics`: rigid closures by the sparse Cholesky
factorisation of Carpentier, Budhiraja and Mansard, "Proximal and Sparse Resolution of Constrained
Dynamic Equations", RSS 2021.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin

from newton_euler.errors import SingularityError
from newton_euler.euler_parameters import from_rotation
from newton_euler.scalars import Array, Scalar
from newton_euler.scene import Scene
from newton_euler.solve import rank
from newton_euler.state import Evaluation, MassProperties, State
from newton_euler.tree import weld_loops
from urdf.errors import UrdfError
from urdf.loops import parse_loops
from urdf.model import CoordinateMap, build, link_inertia
from urdf.reactions import Actuator, joint_wrenches, reactions
from urdf.write import to_loops, to_urdf

PROXIMAL_MU = 1e-6
"""Regularisation of redundant closures against the mean of the diagonal of J M^-1 J^T, in units of the
mechanism's size and mass, or against 1 if that is larger. Iterations take its effect out again; a
smaller one lets forces that no acceleration sees grow with drift."""

PROXIMAL_ACCURACY = 1e-13
"""Relative change between iterations at which they end."""

PROXIMAL_ITERATIONS = 30


class PinocchioSystem:
    """A scene in Pinocchio: a `newton_euler.system.System`.

    q (nq,) and v (nv,) are coordinates of the spanning tree of the welded mechanism, as in
    `newton_euler.tree`: zero at the initial pose, quaternions w-x-y-z.

    Accelerations are worked out in units of the mechanism's size and mass, so that rows in metres and
    rows in radians weigh alike in the regularisation of redundant closures.

    Attributes:
        closed: the Pinocchio model and its closures, SI units.
        map: between q, v and Pinocchio's.
    """

    name = "pinocchio"

    def __init__(self, scene: Scene, alpha: float = 0.0) -> None:
        """Baumgarte gains of the closures are K_D = 2 alpha, K_P = alpha^2; none for alpha = 0.

        Raises:
            NameClashError: for a mechanism whose names clash in a URDF.
        """
        self.scene = scene
        self.mechanism = scene.mechanism
        self._welded = weld_loops(scene.mechanism)
        self._tree = self._welded.tree
        self.nq, self.nv = self._tree.nq, self._tree.nv
        if self.nv == 0:  # its bindings crash on empty Jacobians
            raise UrdfError(f"scene {scene.name!r}: no joint can move; needed by Pinocchio: one that can")
        text, loops = to_urdf(scene), parse_loops(to_loops(scene), f"{scene.name}.loops.yaml")
        self.closed = build(text, loops, alpha)
        self._model = self.closed.model
        self._model.gravity = pin.Motion(scene.gravity, np.zeros(3))
        self.map = CoordinateMap(self._model, self._welded)
        self._bodies = self._add_body_frames()
        self._data = self._model.createData()
        self._length = self._tree.mechanism.size
        self._mass = sum(body.mass for body in self.mechanism.bodies[1:])
        self.velocity_units = self._tree.velocity_units
        self.phi_units = np.concatenate([np.zeros(0), *(self._units(c) for c in self.closed.constraints)])
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
        self._actuators = [self._actuator(law.joint, law.coordinate) for law in scene.control]
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

    def _actuator(self, joint: str, coordinate: int) -> Actuator:
        """What a control law drives; only balls are ever cut, so the tree has it."""
        index = self.mechanism.joint_index(joint)
        place = self._tree.place(joint, coordinate)
        assert place is not None
        (forward,) = (kept.forward for kept in self._tree.joints if kept.joint == index)
        kinds = [m.kind for m in self.mechanism.joints[index].motions if m.kind != "ball"]
        return Actuator(index, kinds[coordinate] == "slide", 1.0 if forward else -1.0, *place)

    def _proximal_settings(self) -> Any:
        """Plain elimination for independent closures, iterations for redundant ones.

        Pinocchio returns NaN for redundant closures without regularisation.
        """
        q, _ = self.coordinates(self.scene.initial_state)
        jacobian = self.phi_jacobian(q) * self.velocity_units / self.phi_units[:, None]
        if rank(jacobian) == len(jacobian):
            return pin.ProximalSettings(0.0, PROXIMAL_ACCURACY, 0.0, 1)
        # Pinocchio fills only the upper half
        upper = np.triu(
            pin.crba(self._scaled.model, self._scaled_data, self.map.q_to_pinocchio(q / self._q_units))
        )
        mass = self.map.v_from_pinocchio(self.map.v_from_pinocchio(upper + np.triu(upper, 1).T).T)
        mean = np.mean(np.sum(jacobian.T * np.linalg.solve(mass, jacobian.T), axis=0))
        mu = PROXIMAL_MU * max(mean, 1.0)
        return pin.ProximalSettings(0.0, PROXIMAL_ACCURACY, mu, PROXIMAL_ITERATIONS)

    def _units(self, closure: Any) -> Array:
        """(3,) or (6,) what makes a closure's rows dimensionless."""
        units = np.repeat([self._length, 1.0], 3)
        return units if closure.type == pin.ContactType.CONTACT_6D else units[:3]

    # What integrators, projection and assembly ask for

    def coordinates(self, state: State) -> tuple[Array, Array]:
        """q and v of a state."""
        return self._tree.coordinates(self._welded.state(state))

    def rate(self, q: Array, v: Array) -> Array:
        """qdot (nq,)."""
        return self._tree.rate(q, v)

    def retract(self, q: Array, step: Array) -> Array:
        """q moved by a small step (nv,)."""
        return self._tree.retract(q, step)

    def measure(self, q: Array, v: Array) -> list[tuple[Scalar, Scalar]]:
        """Coordinate (m or rad) and rate of each control law."""
        return [(q[actuator.on_q], v[actuator.on_v]) for actuator in self._actuators]

    def actuation(self, q: Array, v: Array) -> Array:
        """Actuator forces (a,), N or N m, in the order of the scene's control laws."""
        laws = zip(self.scene.control, self.measure(q, v), strict=True)
        return np.array([law.force(*seen) for law, seen in laws])

    def acceleration(self, q: Array, v: Array) -> Array:
        """vdot (nv,); raises `SingularityError` where Pinocchio has no finite answer."""
        force = np.zeros(self.nv)
        for actuator, u in zip(self._actuators, self.actuation(q, v), strict=True):
            force[actuator.on_v] += u
        acceleration = pin.constraintDynamics(
            self._scaled.model,
            self._scaled_data,
            self.map.q_to_pinocchio(q / self._q_units),
            self.map.v_to_pinocchio(v / self.velocity_units),
            self.map.v_to_pinocchio(force * self.velocity_units / (self._mass * self._length**2)),
            self._scaled.constraints,
            self._constraint_data,
            self._proximal,
        )
        if not np.all(np.isfinite(acceleration)):
            names = [self._welded.mechanism.joint_names[k] for k in self._tree.cuts]
            raise SingularityError(
                ", ".join(names) or self.mechanism.joint_names[0],
                "Pinocchio's constraintDynamics returned numbers that are not finite",
            )
        return self.velocity_units * self.map.v_from_pinocchio(acceleration)

    def _closure_wrenches(self) -> list[Any]:
        """What the closures do to their second bodies, about the world's origin, SI units."""
        wrenches = [-data.oMc1.act(data.contact_force) for data in self._constraint_data]
        force = self._mass * self._length
        return [pin.Force(w.linear * force, w.angular * force * self._length) for w in wrenches]

    def phi(self, q: Array) -> Array:
        """Residuals (k,) of the closures by Pinocchio's frame placements.

        First origin less second, world frame, m; for a weld also the rotation vector that takes the
        first frame to the second, rad.
        """
        pin.framesForwardKinematics(self._model, self._data, self.map.q_to_pinocchio(q))
        rows = [np.zeros(0)]
        for (first, second), constraint in self._closures():
            a, b = self._data.oMf[first], self._data.oMf[second]
            rows.append(a.translation - b.translation)
            if constraint.type == pin.ContactType.CONTACT_6D:
                rows.append(pin.log3(a.rotation.T @ b.rotation))
        return np.concatenate(rows)

    def phi_jacobian(self, q: Array) -> Array:
        """Derivative (k, nv) of `phi` along `retract`, and of its rate by v."""
        pin.computeJointJacobians(self._model, self._data, self.map.q_to_pinocchio(q))
        pin.updateFramePlacements(self._model, self._data)
        rows = [np.zeros((0, self.nv))]
        for (first, second), constraint in self._closures():
            difference = self._frame_jacobian(first) - self._frame_jacobian(second)
            rows.append(difference[:3])
            if constraint.type == pin.ContactType.CONTACT_6D:
                a, b = self._data.oMf[first].rotation, self._data.oMf[second].rotation
                rows.append(-pin.Jlog3(a.T @ b) @ b.T @ difference[3:])
        return self.map.v_from_pinocchio(np.concatenate(rows))

    def _closures(self) -> Any:
        return zip(self.closed.frames, self.closed.constraints, strict=True)

    def _frame_jacobian(self, frame: int) -> Array:
        """(6, nv) in Pinocchio's order: velocity of the frame's origin, angular velocity; world."""
        jacobian = pin.getFrameJacobian(self._model, self._data, frame, pin.LOCAL_WORLD_ALIGNED)
        return np.reshape(jacobian, (6, self.nv))  # a single column comes as a vector

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
        pin.computeJointJacobians(self._model, self._data, self.map.q_to_pinocchio(q))
        pin.updateFramePlacements(self._model, self._data)
        rows = np.concatenate([self._frame_jacobian(frame) for frame in self._bodies])
        return self.map.v_from_pinocchio(rows)

    def evaluate(self, q: Array, v: Array) -> Evaluation:
        """Accelerations, reactions and energies at a state.

        Raises:
            SingularityError: where Pinocchio has no finite accelerations.
        """
        qddot = self.acceleration(q, v)
        closure_wrenches = self._closure_wrenches()
        pin_q, pin_v = self.map.q_to_pinocchio(q), self.map.v_to_pinocchio(v)
        pin_a = self.map.v_to_pinocchio(qddot)
        pin.forwardKinematics(self._model, self._data, pin_q, pin_v, pin_a)
        state = self._state()
        accelerations = self._frame_motions(pin.getFrameClassicalAcceleration)
        external = self._external(closure_wrenches)
        pin.rnea(self._model, self._data, pin_q, pin_v, pin_a, external)
        wrenches = joint_wrenches(
            self.scene,
            self._welded,
            self._model,
            self._data,
            [wrench.vector for wrench in closure_wrenches],
            state,
            accelerations,
        )
        actuation = self.actuation(q, v)
        pin.computeJointJacobians(self._model, self._data, pin_q)
        forces, torques = reactions(self.scene, wrenches, state, self._driven(actuation))
        kinetic = pin.computeKineticEnergy(self._model, self._data, pin_q, pin_v)
        potential = pin.computePotentialEnergy(self._model, self._data, pin_q)
        return Evaluation(
            state,
            accelerations[:, :3],
            accelerations[:, 3:],
            forces,
            torques,
            actuation,
            kinetic,
            potential + self._fixed_energy(),
        )

    def _external(self, closure_wrenches: list[Any]) -> Any:
        """Forces on Pinocchio's joints, in their frames, from world wrenches on the second bodies."""
        external = pin.StdVec_Force([pin.Force.Zero() for _ in range(self._model.njoints)])
        for constraint, wrench in zip(self.closed.constraints, closure_wrenches, strict=True):
            for joint, force in ((constraint.joint2_id, wrench), (constraint.joint1_id, -wrench)):
                external[joint] += self._data.oMi[joint].actInv(force)
        return external

    def _driven(self, actuation: Array) -> list[tuple[Actuator, float, Array]]:
        """Actuators with their forces and their axes in the world, out of Pinocchio's Jacobians."""
        columns = self.map.v_from_pinocchio(np.reshape(self._data.J, (6, self.nv)))
        return [
            (
                actuator,
                u,
                columns[:3, actuator.on_v] if actuator.slides else columns[3:, actuator.on_v],
            )
            for actuator, u in zip(self._actuators, actuation, strict=True)
        ]

    def _fixed_energy(self) -> float:
        """Potential energy of bodies that fixed joints hold to the ground; Pinocchio leaves it out."""
        fixed = self._model.inertias[0]
        return -fixed.mass * float(self.scene.gravity @ fixed.lever)
