"""Forces of a scene for Pinocchio.

Control laws and springs of joints and balls are functions of tree coordinates. Point springs, wrenches and
wind act on frames of Pinocchio. All forces are computed here from the fields of the elements, so that a
mistake in newton_euler's force laws shows as a difference.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple, assert_never

import numpy as np
import pinocchio as pin

from newton_euler.model.balls import ends, spin_rate
from newton_euler.model.constraints import Frame
from newton_euler.model.control import PD, ComputedTorque, DeclaredLaw, DrivenLaws
from newton_euler.model.digital_control import HeldLaw, Law
from newton_euler.model.forces import BallArmature, BallSpring, JointSpring, PointSpring, Wrench
from newton_euler.model.joint import Key
from newton_euler.model.scene import Scene
from newton_euler.model.spanning_tree import SpanningTree
from newton_euler.model.wind import WindLoad
from newton_euler.reading.wrenches import wind_on_plate
from newton_euler.scalars import Array

ZERO = np.zeros(3)


class JointLaws:
    """Springs and control laws on joint coordinates, in the order of `Scene.joint_forces`.

    Springs and PD laws are evaluated together as f = u_0 - (K_p (x - x_0) + K_d dx/dt), with u_0 = 0 for
    springs. For laws that depend on time, x_0 is 0 and u_0 has the time-dependent part.
    """

    def __init__(self, laws: Sequence[Law | JointSpring], keys: Sequence[Key]) -> None:
        """Prepare laws; `keys` are their joint coordinates, then other coordinates that laws read."""
        self._places = {key: keys.index(key) for key in keys}
        self._stiffness, self._damping, self._rest, self._constant = np.zeros((4, len(laws)))
        self._is_spring = np.array([isinstance(law, JointSpring) for law in laws], dtype=bool)
        self._driven = DrivenLaws(laws)
        self._others = [k for k, law in enumerate(laws) if not isinstance(law, PD | JointSpring)]
        for k, law in enumerate(laws):
            if not isinstance(law, PD | JointSpring):
                continue
            self._stiffness[k], self._damping[k] = law.stiffness, law.damping
            if isinstance(law, JointSpring):
                self._rest[k] = law.rest
            elif not law.is_driven:
                self._rest[k], self._constant[k] = law.references(0.0)[law.key].value, law.feedforward_at(0.0)

    def force(
        self,
        laws: Sequence[Law | JointSpring],
        x: Array,
        rate: Array,
        time: float,
        model: Mapping[Key, float],
    ) -> Array:
        """Compute forces (a,), N or N m.

        Args:
            laws: laws with the present forces of sampled controllers.
            x: joint coordinates of `keys`, m or rad.
            rate: rates of these coordinates.
            time: s.
            model: model-based forces of laws, N or N m, by coordinate.
        """
        at, rates = x[: len(laws)], rate[: len(laws)]
        force = self._constant - (self._stiffness * (at - self._rest) + self._damping * rates)
        if len(self._driven.places):
            force[self._driven.places] += self._driven.at(laws, time)
        for k in self._others:
            law = laws[k]
            if isinstance(law, DeclaredLaw):
                force[k] = self._feedback(law, x, rate, time)
            elif isinstance(law, HeldLaw):
                force[k] = law.held
            elif not isinstance(law, JointSpring):  # no other kind: springs are summed up above
                assert_never(law)
        for key, known in model.items():
            force[self._places[key]] += known
        return force

    def _feedback(self, law: DeclaredLaw, x: Array, rate: Array, time: float) -> float:
        force = float(law.feedforward_at(time))
        for key, (k_p, k_d) in law.feedback.items():
            k, wanted = self._places[key], law.references(time)[key]
            force += k_p * (wanted.value - x[k]) + k_d * (wanted.rate - rate[k])
        return force

    def commands(self, laws: Sequence[Law], x: Array, rate: Array, time: float) -> list[float]:
        """Compute the accelerations, m/s^2 or rad/s^2, that computed-torque laws command, in order."""
        found = []
        for law in laws:
            if isinstance(law, ComputedTorque):
                k, wanted = self._places[law.key], law.references(time)[law.key]
                error, error_rate = wanted.value - x[k], wanted.rate - rate[k]
                found.append(wanted.acceleration + law.damping * error_rate + law.stiffness * error)
        return found

    def power(self, force: Array, rate: Array) -> float:
        """Compute the power, W, of control laws and dampers from the result of `force`."""
        rates = rate[: len(force)]
        return float(np.where(self._is_spring, -self._damping * rates, force) @ rates)

    def energy(self, x: Array) -> float:
        """Compute the energy of the springs, J, at joint coordinates x of `keys`."""
        stretch = (x[: len(self._rest)] - self._rest)[self._is_spring]
        return float(0.5 * self._stiffness[self._is_spring] @ (stretch * stretch))


class Push(NamedTuple):
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
    """Springs and dampers of balls, all of which are tree joints.

    Q is the rotation of the ball from the frame of the child to the parent, and the identity at the initial
    pose. E is the rotation of the second body relative to the first at rest. The deflection in the frame of
    the child is

        theta = Q^T log(Q E^T),  or  -log(Q^T E^T)  if the second body of the joint is the parent.
    """

    def __init__(self, scene: Scene, tree: SpanningTree) -> None:
        self._springs = [force for force in scene.forces if isinstance(force, BallSpring)]
        self._rests = [pin.exp3(spring.rest) for spring in self._springs]
        self._kept, places = [], []
        for spring in self._springs:
            index = scene.mechanism.joint_index(spring.joint)
            (kept,) = (kept for kept in tree.joints if kept.joint == index)
            self._kept.append(kept)
            places += [(on_q, on_v) for motion, on_q, on_v in kept.places if motion.kind == "ball"]
        self._on_q = [on_q for on_q, _ in places]
        self.on_v = np.array([range(tree.nv)[on_v] for _, on_v in places], dtype=int).reshape(-1, 3)
        self._damping = np.array([spring.damping for spring in self._springs])

    def __bool__(self) -> bool:
        return bool(self._springs)

    def _theta(self, k: int, q: Array) -> Array:
        """Return the rotation vector (3,) of ball number k from its rest, frame of the child."""
        turned = pin.Quaternion(*q[self._on_q[k]]).toRotationMatrix()
        if self._kept[k].forward:
            return np.asarray(turned.T @ pin.log3(turned @ self._rests[k].T))
        return np.asarray(-pin.log3(turned.T @ self._rests[k].T))

    def torques(self, q: Array, v: Array) -> Array:
        """Compute the torques (n, 3), N m, on the children, in their frames: generalized forces at `on_v`."""
        found = -self._damping[:, None] * v[self.on_v]
        for k, spring in enumerate(self._springs):
            if spring.stiffness:
                found[k] -= spring.stiffness * self._theta(k, q)
        return found

    def power(self, v: Array) -> float:
        """Compute the power of the dampers, W."""
        return -float(self._damping @ np.sum(v[self.on_v] ** 2, axis=1))

    def energy(self, q: Array) -> float:
        """Compute the energy of the springs, J."""
        thetas = [(spring.stiffness, self._theta(k, q)) for k, spring in enumerate(self._springs)]
        return sum(0.5 * stiffness * float(theta @ theta) for stiffness, theta in thetas)

    def wrenches(self, q: Array, v: Array, rotations: Sequence[Array]) -> Iterator[tuple[int, Any]]:
        """Yield numbers of bodies and wrenches on them, world frame; `rotations` are those of tree frames."""
        for kept, torque in zip(self._kept, self.torques(q, v), strict=True):
            wrench = pin.Force(ZERO, rotations[kept.child] @ torque)
            yield kept.child, wrench
            yield kept.parent, -wrench


class PointForces:
    """Point springs, wrenches and wind loads of a scene.

    Forces are computed from `data` after `pinocchio.updateFramePlacements`, with velocities.
    """

    def __init__(self, scene: Scene, model: Any, body_frames: list[int]) -> None:
        """Add frames at the points of forces to `model`, parallel to the `body_frames`."""
        self._model = model
        self._springs: list[tuple[PointSpring, tuple[int, int], tuple[int, int]]] = []
        self._wrenches: list[tuple[Wrench, int, int, Array, Array]] = []
        self._winds: list[tuple[int, int, int]] = []
        mechanism = scene.mechanism

        def added(name: str, body: int, point: Array, axes: Array | None = None) -> int:
            leading = body_frames[body]
            pose = mechanism.bodies[body].pose
            turned = np.eye(3) if axes is None else pose.rotation.T @ axes
            offset = pin.SE3(turned, pose.point_to_body(point))
            frame = model.frames[leading]
            placement = frame.placement * offset
            found = pin.Frame(name, frame.parentJoint, leading, placement, pin.FrameType.OP_FRAME)
            return int(model.addFrame(found))

        for number, force in enumerate(scene.forces):
            if isinstance(force, PointSpring):
                bodies = mechanism.body_index(force.first), mechanism.body_index(force.second)
                points = force.point_on_first, force.point_on_second
                first, second = (
                    added(f"spring {force.name} on {mechanism.body_names[body]}", body, point)
                    for body, point in zip(bodies, points, strict=True)
                )
                self._springs.append((force, bodies, (first, second)))
            elif isinstance(force, Wrench):
                body = mechanism.body_index(force.body)
                turn = mechanism.bodies[body].pose.vector_to_body
                frame = added(f"wrench {force.name}", body, force.point)
                self._wrenches.append((force, body, frame, turn(force.force), turn(force.torque)))
            elif isinstance(force, WindLoad):
                body = mechanism.body_index(force.body)
                frame = added(f"wind {force.name}", body, force.point, force.axes)
                self._winds.append((number, body, frame))
            elif not isinstance(force, JointSpring | BallSpring):  # see `JointLaws` and `BallForces`
                assert_never(force)

    def __bool__(self) -> bool:
        return bool(self._springs or self._wrenches or self._winds)

    def pushes(self, data: Any, scene: Scene, time: float) -> list[Push]:
        """Compute the forces and torques on bodies at a time, s, with the present wind of the scene."""
        winds = self._wind_pushes(data, scene, time)
        return [*self._spring_pushes(data), *self._wrench_pushes(data), *winds]

    def _spring_pushes(self, data: Any) -> list[Push]:
        found = []
        for spring, bodies, frames in self._springs:
            d, rate = self._line(data, frames)
            length = float(np.linalg.norm(d))
            stretch = spring.stiffness * (length - spring.rest_length)
            # a spring without rest length and damping may have zero length
            tension = stretch + spring.damping * float(d @ rate) / (length or 1.0)
            pull = tension * d / (length or 1.0)
            found += [Push(bodies[0], frames[0], pull, ZERO), Push(bodies[1], frames[1], -pull, ZERO)]
        return found

    def _wrench_pushes(self, data: Any) -> list[Push]:
        found = []
        for wrench, body, frame, force, torque in self._wrenches:
            turn = data.oMf[frame].rotation
            if wrench.frame == "body":
                found.append(Push(body, frame, turn @ force, turn @ torque))
            else:
                found.append(Push(body, frame, wrench.force, wrench.torque))
        return found

    def _wind_pushes(self, data: Any, scene: Scene, time: float) -> list[Push]:
        found = []
        for number, body, frame in self._winds:
            load = scene.forces[number]
            assert isinstance(load, WindLoad)
            axes = data.oMf[frame].rotation
            center = pin.getFrameVelocity(self._model, data, frame, pin.LOCAL).linear
            push, *moments = wind_on_plate(load, axes.T @ load.velocity(time) - center)
            found.append(Push(body, frame, push * axes[:, 2], axes[:, :2] @ moments))
        return found

    def wrenches(self, data: Any, scene: Scene, time: float) -> Iterator[tuple[int, Any]]:
        """Yield numbers of bodies and wrenches on them about the world's origin."""
        for push in self.pushes(data, scene, time):
            origin = pin.SE3(np.eye(3), data.oMf[push.frame].translation)
            yield push.body, origin.act(pin.Force(push.force, push.torque))

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
            d, rate = self._line(data, frames)
            power -= spring.damping * float(d @ rate) ** 2 / (float(d @ d) or 1.0)
        for push in (*self._wrench_pushes(data), *self._wind_pushes(data, scene, time)):
            velocity = self._velocity(data, push.frame)
            power += float(push.force @ velocity.linear + push.torque @ velocity.angular)
        return power

    def _line(self, data: Any, frames: tuple[int, int]) -> tuple[Array, Array]:
        """Return the vector (3,), m, from the first frame to the second, and its rate (3,), m/s."""
        first, second = (data.oMf[frame].translation for frame in frames)
        rates = [self._velocity(data, frame).linear for frame in frames]
        return second - first, rates[1] - rates[0]

    def _velocity(self, data: Any, frame: int) -> Any:
        return pin.getFrameVelocity(self._model, data, frame, pin.LOCAL_WORLD_ALIGNED)


class Rotors:
    """Rotor inertias of tree joints.

    Attributes:
        inertias: (nv,) rotor inertias, kg m^2 or kg.
        single: (nv,) rotor inertias of hinges and slides, 0 for balls.
    """

    def __init__(self, scene: Scene, tree: SpanningTree) -> None:
        self._balls: list[tuple[int, tuple[int, int], float]] = []
        self.single, of_balls = np.zeros((2, tree.nv))
        for armature in scene.armatures:
            if isinstance(armature, BallArmature):
                joint, place = scene.mechanism.joint_index(armature.joint), tree.ball_place(armature.joint)
                assert place is not None
                self._balls.append((joint, ends(scene.mechanism, armature.joint), armature.inertia))
                of_balls[place] = armature.inertia
            else:
                on = tree.place(*armature.key)
                assert on is not None
                self.single[on[1]] = armature.inertia
        self.inertias = self.single + of_balls

    def torques(self, frames: list[Frame], angular: Array) -> list[tuple[int, Array]]:
        """Return torques (3,), N m, of rotors of balls on second bodies, for angular accelerations (b, 3)."""
        return [(joint, -a * spin_rate(frames, angular, bodies)) for joint, bodies, a in self._balls]
