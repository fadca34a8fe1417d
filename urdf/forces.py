"""Forces of a scene as Pinocchio's side has them: laws of joint coordinates, and, by Pinocchio's frames,
springs of balls, springs between points and wrenches; rotors.

All are worked out here from their numbers, so that a mistake in newton_euler's own laws is its own alone.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from newton_euler.equations.balls import ends, spin_rate
from newton_euler.model.constraints import Frame
from newton_euler.model.control import PD, Law
from newton_euler.model.forces import BallArmature, BallSpring, JointSpring, PointSpring, Wrench
from newton_euler.model.scene import Scene
from newton_euler.model.spanning_tree import SpanningTree
from newton_euler.scalars import Array, Scalar
from urdf.reactions import Actuator, actuator


def force_on_joint(law: Law | JointSpring, x: Scalar, rate: Scalar, time: float) -> Scalar:
    """Compute the force, N or N m, on a joint coordinate x (m or rad), at its rate and a time in s."""
    if isinstance(law, JointSpring):
        return -(law.stiffness * (x - law.rest) + law.damping * rate)
    if isinstance(law, PD):
        return law.feedforward_at(time) - (law.stiffness * (x - law.target) + law.damping * rate)
    return law.held


def power_on_joint(law: Law | JointSpring, x: Scalar, rate: Scalar, time: float) -> Scalar:
    """Compute its power, W; of a spring that of its damper alone."""
    if isinstance(law, JointSpring):
        return -law.damping * (rate * rate)
    return force_on_joint(law, x, rate, time) * rate


def energy_at_joint(spring: JointSpring, x: Scalar) -> Scalar:
    """Compute the energy of a spring, J, at its joint coordinate x (m or rad)."""
    return 0.5 * spring.stiffness * ((x - spring.rest) * (x - spring.rest))


class Push(NamedTuple):
    """A force and a torque on a frame's body, at the frame's origin; world frame.

    Attributes:
        body: number of the body.
        frame: Pinocchio's number of the frame.
        force, torque: (3,) N and N m.
    """

    body: int
    frame: int
    force: Array
    torque: Array


class PointForces:
    """The springs of balls, the springs between points and the wrenches of a scene.

    They are worked out from `data` as `pinocchio.updateFramePlacements` leaves it, velocities included.
    """

    def __init__(self, scene: Scene, model: Any, body_frames: list[int]) -> None:
        """Add frames at their points to `model`, turned as the bodies, whose own are `body_frames`."""
        self._model, self._bodies = model, len(body_frames)
        self._balls: list[tuple[BallSpring, tuple[int, int], tuple[int, int], Any]] = []
        self._springs: list[tuple[PointSpring, tuple[int, int], tuple[int, int]]] = []
        self._wrenches: list[tuple[Wrench, int, int, Array, Array]] = []
        mechanism = scene.mechanism

        def added(name: str, body: int, point: Array) -> int:
            leading = body_frames[body]
            offset = pin.SE3(np.eye(3), mechanism.bodies[body].pose.point_to_body(point))
            frame = model.frames[leading]
            placement = frame.placement * offset
            found = pin.Frame(name, frame.parentJoint, leading, placement, pin.FrameType.OP_FRAME)
            return int(model.addFrame(found))

        for force in scene.forces:
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
            elif isinstance(force, BallSpring):
                i, j = ends(mechanism, force.joint)
                # the second body's frame in the first's where the spring rests
                a_i, a_j = (mechanism.bodies[k].pose.rotation for k in (i, j))
                rest = a_i.T @ pin.exp3(force.rest) @ a_j
                self._balls.append((force, (i, j), (body_frames[i], body_frames[j]), rest))

    def __bool__(self) -> bool:
        return bool(self._balls or self._springs or self._wrenches)

    def pushes(self, data: Any) -> list[Push]:
        """What they do to the bodies."""
        return [*self._ball_pushes(data), *self._spring_pushes(data), *self._wrench_pushes(data)]

    def _ball_pushes(self, data: Any) -> list[Push]:
        found = []
        for spring, (i, j), frames, rest in self._balls:
            turned, spin = self._turned(data, frames, rest), self._spin(data, frames)
            torque = -(spring.stiffness * turned + spring.damping * spin)
            found.append(Push(i, frames[0], np.zeros(3), -torque))
            found.append(Push(j, frames[1], np.zeros(3), torque))
        return found

    def _spring_pushes(self, data: Any) -> list[Push]:
        found = []
        for spring, bodies, frames in self._springs:
            d, rate = self._line(data, frames)
            length = float(np.linalg.norm(d))
            stretch = spring.stiffness * (length - spring.rest_length)
            # a spring without rest length and damping may be of no length
            tension = stretch + spring.damping * float(d @ rate) / (length or 1.0)
            pull = tension * d / (length or 1.0)
            found.append(Push(bodies[0], frames[0], pull, np.zeros(3)))
            found.append(Push(bodies[1], frames[1], -pull, np.zeros(3)))
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

    def wrenches(self, data: Any) -> list[Any]:
        """What they do to each body of the scene, about the world's origin."""
        found = [pin.Force.Zero() for _ in range(self._bodies)]
        for push in self.pushes(data):
            origin = pin.SE3(np.eye(3), data.oMf[push.frame].translation)
            found[push.body] += origin.act(pin.Force(push.force, push.torque))
        return found

    def energy(self, data: Any) -> float:
        """Energy of the springs, J."""
        turned = 0.0
        for spring, _, frames, rest in self._balls:
            theta = self._turned(data, frames, rest)
            turned += 0.5 * spring.stiffness * float(theta @ theta)
        stretched = (
            (spring, float(np.linalg.norm(self._line(data, frames)[0])))
            for spring, _, frames in self._springs
        )
        return turned + sum(
            0.5 * spring.stiffness * (length - spring.rest_length) ** 2 for spring, length in stretched
        )

    def power(self, data: Any) -> float:
        """Power of dampers and wrenches, W."""
        power = 0.0
        for ball, _, frames, _ in self._balls:
            spin = self._spin(data, frames)
            power -= ball.damping * float(spin @ spin)
        for spring, _, frames in self._springs:
            d, rate = self._line(data, frames)
            power -= spring.damping * float(d @ rate) ** 2 / (float(d @ d) or 1.0)
        for push in self._wrench_pushes(data):
            velocity = self._velocity(data, push.frame)
            power += float(push.force @ velocity.linear + push.torque @ velocity.angular)
        return power

    def _line(self, data: Any, frames: tuple[int, int]) -> tuple[Array, Array]:
        """(3,) m, from the first frame's origin to the second's, and its rate (3,)."""
        first, second = (data.oMf[frame].translation for frame in frames)
        rates = [self._velocity(data, frame).linear for frame in frames]
        return second - first, rates[1] - rates[0]

    def _turned(self, data: Any, frames: tuple[int, int], rest: Array) -> Array:
        """(3,) rotation vector of the second frame against the first from `rest` (3, 3), world frame."""
        first, second = (data.oMf[frame].rotation for frame in frames)
        return np.asarray(first @ pin.log3(first.T @ second @ rest.T))

    def _spin(self, data: Any, frames: tuple[int, int]) -> Array:
        """(3,) angular velocity of the second frame against the first, world frame."""
        first, second = (self._velocity(data, frame).angular for frame in frames)
        return np.asarray(second - first)

    def _velocity(self, data: Any, frame: int) -> Any:
        return pin.getFrameVelocity(self._model, data, frame, pin.LOCAL_WORLD_ALIGNED)


class Rotors:
    """Rotor inertias on velocities of a tree, which has all joints that bear some.

    Attributes:
        inertias: (nv,) kg m^2 or kg.
    """

    def __init__(self, scene: Scene, tree: SpanningTree) -> None:
        self._single: list[tuple[Actuator, float]] = []
        self._balls: list[tuple[int, tuple[int, int], float]] = []
        self.inertias = np.zeros(tree.nv)
        for armature in scene.armatures:
            if isinstance(armature, BallArmature):
                joint, place = scene.mechanism.joint_index(armature.joint), tree.ball_place(armature.joint)
                assert place is not None
                self._balls.append((joint, ends(scene.mechanism, armature.joint), armature.inertia))
                self.inertias[place] = armature.inertia
            else:
                on = actuator(scene.mechanism, tree, *armature.key)
                self._single.append((on, armature.inertia))
                self.inertias[on.on_v] = armature.inertia

    def forces(self, vdot: Array) -> list[tuple[Actuator, float]]:
        """What those of hinges and slides drive, and the force, N or N m, at accelerations (nv,)."""
        return [(on, -inertia * vdot[on.on_v]) for on, inertia in self._single]

    def torques(self, frames: list[Frame], angular: Array) -> list[tuple[int, Array]]:
        """By joint (3,) N m of those of balls on its second body, at angular accelerations (b, 3)."""
        return [(joint, -a * spin_rate(frames, angular, bodies)) for joint, bodies, a in self._balls]
