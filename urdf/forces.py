"""Forces of a scene (a mechanism with forces and control laws) for Pinocchio's equations of motion.

Control laws and springs of joints and balls are functions of the coordinates of the mechanism's spanning
tree. Point springs, wrenches and wind act on frames of Pinocchio's model. All forces are computed here from
the attributes of the elements, and not by the methods that newton_euler's equations use. A mistake in those
methods therefore shows as a difference between the engines. `Rotors` has the inertias of motors' rotors.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple, assert_never

import numpy as np
import pinocchio as pin

from newton_euler.model.armatures import BallArmature
from newton_euler.model.balls import joint_bodies, spin_rate
from newton_euler.model.constraints import Frame
from newton_euler.model.control import PD, ComputedTorque, DeclaredLaw, TimeDependentPD
from newton_euler.model.digital_control import HeldLaw, Law
from newton_euler.model.forces import BallSpring, JointSpring, PointSpring, Wrench
from newton_euler.model.joint import Key
from newton_euler.model.scene import Scene
from newton_euler.model.spanning_tree import SpanningTree
from newton_euler.model.switched_forces import ElasticGear, JointFriction, JointStop
from newton_euler.model.wind import WindLoad
from newton_euler.reading.wrenches import wind_on_plate
from newton_euler.scalars import Array

ZERO = np.zeros(3)
"""Force or torque of zero."""


class JointLaws:
    """Springs and control laws on joint coordinates, in the order of `Scene.joint_forces`.

    Springs and PD laws are evaluated together as f = u_0 - (K_p (x - x_0) + K_d dx/dt), with u_0 = 0 for
    springs. For PD laws that depend on time, x_0 is 0 and u_0 is the time-dependent part. The a laws act on
    the first a of the given joint coordinates.
    """

    def __init__(self, laws: Sequence[Law | JointSpring], keys: Sequence[Key]) -> None:
        """Prepare the laws.

        Args:
            laws: springs and control laws.
            keys: joint coordinate of each law, then other coordinates that laws measure. A key is a joint and
                the number of its coordinate.
        """
        self._index_of_key = {key: keys.index(key) for key in keys}
        self._stiffness, self._damping, self._rest, self._constant = np.zeros((4, len(laws)))
        self._is_spring = np.array([isinstance(law, JointSpring) for law in laws], dtype=bool)
        self._driven = TimeDependentPD(laws)  # time-dependent part of the PD laws `_driven.law_indices`
        self._other_laws = [k for k, law in enumerate(laws) if not isinstance(law, PD | JointSpring)]
        for k, law in enumerate(laws):
            if not isinstance(law, PD | JointSpring):
                continue
            self._stiffness[k], self._damping[k] = law.stiffness, law.damping
            if isinstance(law, JointSpring):
                self._rest[k] = law.rest
            elif not law.depends_on_time:
                self._rest[k], self._constant[k] = law.references(0.0)[law.key].value, law.feedforward_at(0.0)

    def force(
        self,
        laws: Sequence[Law | JointSpring],
        x: Array,
        rate: Array,
        time: float,
        model: Mapping[Key, float],
    ) -> Array:
        """Compute the forces (a,), N or N m, of all laws.

        Args:
            laws: laws with the present forces of sampled controllers.
            x: coordinates of the `keys` of the constructor, m or rad.
            rate: rates of these coordinates.
            time: s.
            model: forces that laws compute from a model of the mechanism (computed torque, gravity
                compensation), N or N m, by coordinate.
        """
        x_of_laws, rate_of_laws = x[: len(laws)], rate[: len(laws)]
        force = self._constant - (self._stiffness * (x_of_laws - self._rest) + self._damping * rate_of_laws)
        if len(self._driven.law_indices):
            force[self._driven.law_indices] += self._driven.forces_at(laws, time)
        for k in self._other_laws:
            law = laws[k]
            if isinstance(law, DeclaredLaw):  # state feedback or computed torque
                force[k] = self._feedback_force(law, x, rate, time)
            elif isinstance(law, HeldLaw):  # a sampled controller
                force[k] = law.held
            elif not isinstance(law, JointSpring):  # springs are evaluated above
                assert_never(law)
        for key, model_force in model.items():
            force[self._index_of_key[key]] += model_force
        return force

    def _feedback_force(self, law: DeclaredLaw, x: Array, rate: Array, time: float) -> float:
        """Return feedforward plus feedback of a law, N or N m; for the arguments see `force`."""
        force, references = float(law.feedforward_at(time)), law.references(time)
        for key, (k_p, k_d) in law.feedback.items():
            k, reference = self._index_of_key[key], references[key]
            force += k_p * (reference.value - x[k]) + k_d * (reference.rate - rate[k])
        return force

    def commands(self, laws: Sequence[Law], x: Array, rate: Array, time: float) -> list[float]:
        """Return the acceleration, m/s^2 or rad/s^2, that each computed-torque law commands.

        For the arguments see `force`.
        """
        accelerations = []
        for law in laws:
            if isinstance(law, ComputedTorque):
                k, reference = self._index_of_key[law.key], law.references(time)[law.key]
                error, error_rate = reference.value - x[k], reference.rate - rate[k]
                accelerations.append(
                    reference.acceleration + law.damping * error_rate + law.stiffness * error
                )
        return accelerations

    def power(self, force: Array, rate: Array) -> float:
        """Compute the power, W, of control laws and dampers; springs have an energy instead.

        Args:
            force: (a,) result of the method `force`.
            rate: rates of the coordinates of the constructor's `keys`.
        """
        rates = rate[: len(force)]
        return float(np.where(self._is_spring, -self._damping * rates, force) @ rates)

    def energy(self, x: Array) -> float:
        """Compute the energy of the springs, J, at joint coordinates x, those of the constructor's `keys`."""
        stretch = (x[: len(self._rest)] - self._rest)[self._is_spring]
        return float(0.5 * self._stiffness[self._is_spring] @ (stretch * stretch))


class AppliedForce(NamedTuple):
    """Force and torque on a body at the origin of a frame, world axes.

    Attributes:
        body: number of the body.
        frame: Pinocchio's number of the frame.
        force: (3,) N.
        torque: (3,) N m.
    """

    body: int
    frame: int
    force: Array
    torque: Array


class BallForces:
    """Springs and dampers of balls, all of which are joints of the spanning tree.

    Q is the rotation of the ball from the frame of the child to the parent, and the identity at the initial
    pose. E is the rotation of the second body relative to the first where the spring is at rest. The
    deflection, a rotation vector in the frame of the child, is

        theta = Q^T log(Q E^T),  or  -log(Q^T E^T)  if the second body of the joint is the parent.

    Attributes:
        velocity_indices: (n, 3) indices of the balls' angular velocities in v.
    """

    def __init__(self, scene: Scene, tree: SpanningTree) -> None:
        """Find the ball springs of a scene, and their coordinates in a spanning tree."""
        self._springs = [force for force in scene.forces if isinstance(force, BallSpring)]
        self._rests = [pin.exp3(spring.rest) for spring in self._springs]  # E
        self._tree_joints, slices = [], []
        for spring in self._springs:
            index = scene.mechanism.joint_index(spring.joint)
            (tree_joint,) = (each for each in tree.joints if each.joint == index)
            self._tree_joints.append(tree_joint)
            # slices of the ball's quaternion (w, x, y, z) in q and of its angular velocity in v
            slices += [(in_q, in_v) for motion, in_q, in_v in tree_joint.places if motion.kind == "ball"]
        self._in_q = [in_q for in_q, _ in slices]
        indices = [range(tree.nv)[in_v] for _, in_v in slices]
        self.velocity_indices = np.array(indices, dtype=int).reshape(-1, 3)
        self._damping = np.array([spring.damping for spring in self._springs])

    def __bool__(self) -> bool:
        """Return True if the scene has ball springs."""
        return bool(self._springs)

    def _deflection(self, k: int, q: Array) -> Array:
        """Return theta (3,) of ball number `k`: the rotation vector from its rest, rad, child frame."""
        rotation = pin.Quaternion(*q[self._in_q[k]]).toRotationMatrix()  # Q
        if self._tree_joints[k].forward:  # the second body of the joint is the child
            return np.asarray(rotation.T @ pin.log3(rotation @ self._rests[k].T))
        return np.asarray(-pin.log3(rotation.T @ self._rests[k].T))

    def torques(self, q: Array, v: Array) -> Array:
        """Compute the torques (n, 3), N m, on the children, in the frames of the children.

        The torques are the generalized forces at `velocity_indices`.
        """
        torques = -self._damping[:, None] * v[self.velocity_indices]
        for k, spring in enumerate(self._springs):
            if spring.stiffness:
                torques[k] -= spring.stiffness * self._deflection(k, q)
        return torques

    def power(self, v: Array) -> float:
        """Compute the power of the dampers, W."""
        return -float(self._damping @ np.sum(v[self.velocity_indices] ** 2, axis=1))

    def energy(self, q: Array) -> float:
        """Compute the energy of the springs, J."""
        thetas = [(spring.stiffness, self._deflection(k, q)) for k, spring in enumerate(self._springs)]
        return sum(0.5 * stiffness * float(theta @ theta) for stiffness, theta in thetas)

    def wrenches(self, q: Array, v: Array, rotations: Sequence[Array]) -> Iterator[tuple[int, Any]]:
        """Yield the number of a body and the `pinocchio.Force` on it, world frame, for both bodies of a ball.

        Args:
            q: (nq,) tree coordinates.
            v: (nv,) tree velocities.
            rotations: (3, 3) rotation to the world of each body's frame in the tree.
        """
        for tree_joint, torque in zip(self._tree_joints, self.torques(q, v), strict=True):
            wrench = pin.Force(ZERO, rotations[tree_joint.child] @ torque)
            yield tree_joint.child, wrench
            yield tree_joint.parent, -wrench


class PointForces:
    """Point springs, wrenches and wind loads of a scene.

    Methods take a `pinocchio.Data` with frame placements and velocities.
    """

    def __init__(self, scene: Scene, model: Any, body_frames: list[int]) -> None:
        """Add a frame to Pinocchio's model at each point on which a force acts.

        Args:
            scene: scene with the forces.
            model: `pinocchio.Model`, which gets the frames.
            body_frames: number of the frame of each body. The axes of a new frame are parallel to those of
                the body's frame, except for wind, where they are the axes of the plate.
        """
        self._model = model
        # spring, numbers of its two bodies, and of the frames at its ends
        self._springs: list[tuple[PointSpring, tuple[int, int], tuple[int, int]]] = []
        # wrench, numbers of its body and frame, and force and torque in the frame of the body
        self._wrenches: list[tuple[Wrench, int, int, Array, Array]] = []
        # index of the wind load in `scene.forces`, and numbers of its body and frame
        self._winds: list[tuple[int, int, int]] = []
        mechanism = scene.mechanism

        def add_frame(name: str, body: int, point: Array, axes: Array | None = None) -> int:
            """Add a frame at a point (3,) on a body; return its number.

            `point`, m, and the columns of `axes` (3, 3) are in the world frame at the initial pose.
            """
            body_frame = body_frames[body]
            pose = mechanism.bodies[body].pose
            rotation = np.eye(3) if axes is None else pose.rotation.T @ axes
            offset = pin.SE3(rotation, pose.point_to_body(point))
            frame = model.frames[body_frame]
            placement = frame.placement * offset
            new_frame = pin.Frame(name, frame.parentJoint, body_frame, placement, pin.FrameType.OP_FRAME)
            return int(model.addFrame(new_frame))

        for number, force in enumerate(scene.forces):
            if isinstance(force, PointSpring):
                bodies = mechanism.body_index(force.first), mechanism.body_index(force.second)
                points = force.point_on_first, force.point_on_second
                first, second = (
                    add_frame(f"spring {force.name} on {mechanism.body_names[body]}", body, point)
                    for body, point in zip(bodies, points, strict=True)
                )
                self._springs.append((force, bodies, (first, second)))
            elif isinstance(force, Wrench):
                body = mechanism.body_index(force.body)
                turn = mechanism.bodies[body].pose.vector_to_body
                frame = add_frame(f"wrench {force.name}", body, force.point)
                self._wrenches.append((force, body, frame, turn(force.force), turn(force.torque)))
            elif isinstance(force, WindLoad):
                body = mechanism.body_index(force.body)
                frame = add_frame(f"wind {force.name}", body, force.point, force.axes)
                self._winds.append((number, body, frame))
            # `JointLaws`, `BallForces` and `SwitchedLoads` have the forces at joints
            elif not isinstance(force, JointSpring | BallSpring | JointFriction | JointStop | ElasticGear):
                assert_never(force)

    def __bool__(self) -> bool:
        """Return True if the scene has point springs, wrenches or wind loads."""
        return bool(self._springs or self._wrenches or self._winds)

    def applied_forces(self, data: Any, scene: Scene, time: float) -> list[AppliedForce]:
        """Compute the forces and torques on bodies at a time, s.

        If a wind speed is a step function of time, a run replaces it between its steps by its present value:
        `scene` has this value, the scene of the constructor the function.
        """
        winds = self._wind_forces(data, scene, time)
        return [*self._spring_forces(data), *self._wrench_forces(data), *winds]

    def _spring_forces(self, data: Any) -> list[AppliedForce]:
        """Return the forces of point springs and their dampers on both bodies."""
        forces = []
        for spring, bodies, frames in self._springs:
            d, d_rate = self._line(data, frames)
            length = float(np.linalg.norm(d))
            spring_force = spring.stiffness * (length - spring.rest_length)
            # a spring without rest length and damping may have zero length
            tension = spring_force + spring.damping * float(d @ d_rate) / (length or 1.0)
            on_first = tension * d / (length or 1.0)
            forces.append(AppliedForce(bodies[0], frames[0], on_first, ZERO))
            forces.append(AppliedForce(bodies[1], frames[1], -on_first, ZERO))
        return forces

    def _wrench_forces(self, data: Any) -> list[AppliedForce]:
        """Return the constant forces and torques of wrenches, in the axes of the world or of their body."""
        forces = []
        for wrench, body, frame, force, torque in self._wrenches:
            to_world = data.oMf[frame].rotation
            if wrench.frame == "body":
                forces.append(AppliedForce(body, frame, to_world @ force, to_world @ torque))
            else:
                forces.append(AppliedForce(body, frame, wrench.force, wrench.torque))
        return forces

    def _wind_forces(self, data: Any, scene: Scene, time: float) -> list[AppliedForce]:
        """Return the forces and torques of wind on plates at a time, s."""
        forces = []
        for number, body, frame in self._winds:
            load = scene.forces[number]
            assert isinstance(load, WindLoad)
            # axes of the plate: two sides, then the normal
            axes = data.oMf[frame].rotation
            plate_velocity = pin.getFrameVelocity(self._model, data, frame, pin.LOCAL).linear
            relative_wind = axes.T @ load.velocity(time) - plate_velocity
            # moments about both sides
            normal_force, *moments = wind_on_plate(load, relative_wind)
            forces.append(AppliedForce(body, frame, normal_force * axes[:, 2], axes[:, :2] @ moments))
        return forces

    def wrenches(self, data: Any, scene: Scene, time: float) -> Iterator[tuple[int, Any]]:
        """Yield the number of a body and the `pinocchio.Force` on the body, about the world's origin."""
        for applied in self.applied_forces(data, scene, time):
            to_origin = pin.SE3(np.eye(3), data.oMf[applied.frame].translation)
            yield applied.body, to_origin.act(pin.Force(applied.force, applied.torque))

    def energy(self, data: Any) -> float:
        """Compute the energy of the springs, J."""
        lines = [(spring, np.linalg.norm(self._line(data, frames)[0])) for spring, _, frames in self._springs]
        return sum(
            0.5 * spring.stiffness * (float(length) - spring.rest_length) ** 2 for spring, length in lines
        )

    def power(self, data: Any, scene: Scene, time: float) -> float:
        """Compute the power of dampers, wrenches and wind, W."""
        power = 0.0
        for spring, _, frames in self._springs:
            d, d_rate = self._line(data, frames)
            power -= spring.damping * float(d @ d_rate) ** 2 / (float(d @ d) or 1.0)
        for applied in (*self._wrench_forces(data), *self._wind_forces(data, scene, time)):
            velocity = self._velocity(data, applied.frame)
            power += float(applied.force @ velocity.linear + applied.torque @ velocity.angular)
        return power

    def _line(self, data: Any, frames: tuple[int, int]) -> tuple[Array, Array]:
        """Return the vector (3,), m, from the first frame to the second, and its rate (3,), m/s."""
        first, second = (data.oMf[frame].translation for frame in frames)
        rates = [self._velocity(data, frame).linear for frame in frames]
        return second - first, rates[1] - rates[0]

    def _velocity(self, data: Any, frame: int) -> Any:
        """Return the `pinocchio.Motion` of a frame, world axes."""
        return pin.getFrameVelocity(self._model, data, frame, pin.LOCAL_WORLD_ALIGNED)


class Rotors:
    """Armatures (rotor inertias) of joints of the spanning tree.

    Attributes:
        inertias: (nv,) rotor inertias by velocity of the tree, kg m^2 or kg.
        single: (nv,) rotor inertias of hinges and slides, 0 for balls.
    """

    def __init__(self, scene: Scene, tree: SpanningTree) -> None:
        """Find the armatures of a scene, and the velocities of a spanning tree to which they belong."""
        # number of the joint, numbers of its bodies, and rotor inertia of each ball
        self._balls: list[tuple[int, tuple[int, int], float]] = []
        self.single, of_balls = np.zeros((2, tree.nv))
        for armature in scene.armatures:
            if isinstance(armature, BallArmature):
                joint, place = scene.mechanism.joint_index(armature.joint), tree.ball_place(armature.joint)
                assert place is not None
                self._balls.append((joint, joint_bodies(scene.mechanism, armature.joint), armature.inertia))
                of_balls[place] = armature.inertia
            else:
                indices = tree.place(*armature.key)
                assert indices is not None
                _, v_index = indices
                self.single[v_index] = armature.inertia
        self.inertias = self.single + of_balls

    def torques(self, frames: list[Frame], angular: Array) -> list[tuple[int, Array]]:
        """Return the number of each ball's joint and the torque of its rotor on the second body.

        The torque (3,), N m, world frame, is -inertia times d omega/dt, where omega is the angular velocity
        of the second body relative to the first.

        Args:
            frames: poses and velocities of the bodies.
            angular: (b, 3) angular accelerations of the bodies, rad/s^2, world frame.
        """
        return [
            (joint, -inertia * spin_rate(frames, angular, bodies)) for joint, bodies, inertia in self._balls
        ]
