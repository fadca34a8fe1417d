"""Wrenches of a scene's forces and rotors on its bodies, computed from the fields of the elements.

The module does not use the methods of force elements that newton_euler's equations use. A mistake in these
methods is therefore not attributed to a file or to another engine.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import assert_never

import numpy as np

from newton_euler.model.control import DeclaredLaw
from newton_euler.model.digital_control import HeldLaw, Law
from newton_euler.model.forces import BallSpring, JointSpring, PointSpring, Wrench
from newton_euler.model.mechanism import Mechanism
from newton_euler.model.motions import TimeFunction
from newton_euler.model.scene import Scene
from newton_euler.model.state import State
from newton_euler.model.wind import CALM, WindLoad
from newton_euler.scalars import Array


class Wrenches:
    """Sums of wrenches on bodies.

    Attributes:
        mechanism: mechanism of the bodies.
        frames: poses and velocities of the bodies.
        total: (b, 6) forces and torques about the centers of mass, N and N m, world frame.
        magnitude: (b, 6) sums of the absolute values.
    """

    def __init__(self, mechanism: Mechanism, state: State) -> None:
        self.mechanism, self.frames, self._state = mechanism, state.frames(), state
        self.total, self.magnitude = np.zeros((2, len(self.frames), 6))

    def _add(self, body: int, force: Array, torque: Array) -> None:
        wrench = np.concatenate([force, torque])
        self.total[body] += wrench
        self.magnitude[body] += np.abs(wrench)

    def _turn(self, body: int) -> Array:
        """Return the rotation (3, 3) of a body since the initial pose."""
        return np.asarray(self.frames[body].rotation @ self.mechanism.bodies[body].pose.rotation.T)

    def _arm(self, body: int, point: Array) -> Array:
        """Return (3,) m from the center of mass to a point given at the initial pose."""
        return np.asarray(self._turn(body) @ (point - self.mechanism.bodies[body].pose.position))

    def add_forces(self, scene: Scene, control: Sequence[float] | Array = ()) -> None:
        """Add all forces of a scene except gravity, at time 0.

        Args:
            scene: scene with the forces.
            control: forces of all control laws, used for laws that evaluate a model of the mechanism.
        """
        for k, law in enumerate(scene.joint_forces):
            first, second, rows, x, rate = self._coordinate(*law.key)
            known = isinstance(law, DeclaredLaw) and law.uses_model
            push = (control[k] if known else self._law(law, x, rate)) * rows
            self._add(first, push[:3], push[3:6])
            self._add(second, push[6:9], push[9:])
        for force in scene.forces:
            match force:
                case JointSpring():
                    pass  # one of `Scene.joint_forces`
                case PointSpring():
                    self._add_point_spring(force)
                case BallSpring():
                    self._add_ball_spring(force)
                case Wrench():
                    body = self.mechanism.body_index(force.body)
                    turn = self._turn(body) if force.frame == "body" else np.eye(3)
                    pull, torque = turn @ force.force, turn @ force.torque
                    self._add(body, pull, torque + np.cross(self._arm(body, force.point), pull))
                case WindLoad():
                    self._add_wind(force)
                case _:
                    assert_never(force)

    def _law(self, law: Law | JointSpring, x: float, rate: float) -> float:
        """Compute the force of a law on a joint coordinate, N or N m, at time 0."""
        if isinstance(law, JointSpring):
            return law.stiffness * (law.rest - x) - law.damping * rate
        if isinstance(law, HeldLaw):
            return law.held
        if not isinstance(law, DeclaredLaw):
            assert_never(law)
        force = float(law.feedforward_at(0.0))
        for key, (k_p, k_d) in law.feedback.items():
            wanted, (*_, x, rate) = law.references(0.0)[key], self._coordinate(*key)
            force += k_p * (wanted.value - x) + k_d * (wanted.rate - rate)
        return force

    def _coordinate(self, joint: str, coordinate: int) -> tuple[int, int, Array, float, float]:
        """Return the bodies of a joint, the Jacobian (12,) of a coordinate, its value and its rate."""
        equations = self.mechanism.joint_equations(joint)
        constraint = equations.coordinates[coordinate]
        first, second = self.frames[equations.first], self.frames[equations.second]
        jacobian = constraint.jacobian(first, second)
        x, rate = constraint.phi(first, second)[0], jacobian.rate(first, second)[0]
        x += self._state.revolutions((joint, coordinate), x)
        return equations.first, equations.second, np.concatenate(jacobian, axis=1)[0], x, rate

    def _add_point_spring(self, spring: PointSpring) -> None:
        ends = [self.mechanism.body_index(name) for name in (spring.first, spring.second)]
        points = spring.point_on_first, spring.point_on_second
        arms = [self._arm(body, point) for body, point in zip(ends, points, strict=True)]
        (place, velocity), (other, other_velocity) = (
            (frame.position + arm, frame.velocity + np.cross(frame.angular_velocity, arm))
            for frame, arm in zip((self.frames[body] for body in ends), arms, strict=True)
        )
        line = other - place
        length = float(np.linalg.norm(line))
        along = line / (length or 1.0)  # a spring without rest length and damping may have zero length
        stretch_rate = float(along @ (other_velocity - velocity))
        pull = (spring.stiffness * (length - spring.rest_length) + spring.damping * stretch_rate) * along
        for body, arm, force in zip(ends, arms, (pull, -pull), strict=True):
            self._add(body, force, np.cross(arm, force))

    def _add_ball_spring(self, spring: BallSpring) -> None:
        from scipy.spatial.transform import Rotation

        equations = self.mechanism.joint_equations(spring.joint)
        first, second = equations.first, equations.second
        rest = Rotation.from_rotvec(spring.rest.copy()).as_matrix()  # SciPy refuses read-only arrays
        between = self._turn(first).T @ self._turn(second) @ rest.T
        theta = self._turn(first) @ Rotation.from_matrix(between).as_rotvec()
        omega = self.frames[second].angular_velocity - self.frames[first].angular_velocity
        torque = -spring.stiffness * theta - spring.damping * omega
        self._add(first, np.zeros(3), -torque)
        self._add(second, np.zeros(3), torque)

    def wind(self, load: WindLoad) -> Array:
        """Compute force and moments of the wind on a plate at time 0, see `wind_on_plate`."""
        body = self.mechanism.body_index(load.body)
        frame, axes = self.frames[body], self._turn(body) @ load.axes
        center = frame.velocity + np.cross(frame.angular_velocity, self._arm(body, load.point))
        speed = load.speed.value(0.0) if isinstance(load.speed, TimeFunction) else load.speed
        blowing = speed * load.direction / np.linalg.norm(load.direction)
        return wind_on_plate(load, axes.T @ (blowing - center))

    def _add_wind(self, load: WindLoad) -> None:
        body = self.mechanism.body_index(load.body)
        axes, (push, *moments) = self._turn(body) @ load.axes, self.wind(load)
        force = push * axes[:, 2]
        torque = axes[:, :2] @ moments + np.cross(self._arm(body, load.point), force)
        self._add(body, force, torque)

    def add_rotors(self, scene: Scene, linear: Array, angular: Array) -> None:
        """Add the wrenches of a scene's armatures at accelerations (b, 3) each, m/s^2 and rad/s^2."""
        for armature in scene.armatures:
            equations = self.mechanism.joint_equations(armature.joint)
            i, j = equations.first, equations.second
            if armature.on_ball:
                turning = np.cross(self.frames[j].angular_velocity, self.frames[i].angular_velocity)
                torque = -armature.inertia * (angular[j] - angular[i] + turning)
                self._add(i, np.zeros(3), -torque)
                self._add(j, np.zeros(3), torque)
                continue
            _, coordinate = armature.key
            *_, rows, _, _ = self._coordinate(armature.joint, coordinate)
            rates = np.concatenate([linear[i], angular[i], linear[j], angular[j]])
            gamma = equations.coordinates[coordinate].gamma(self.frames[i], self.frames[j])[0]
            push = -armature.inertia * (float(rows @ rates) - gamma) * rows
            self._add(i, push[:3], push[3:6])
            self._add(j, push[6:9], push[9:])


def wind_on_plate(load: WindLoad, relative: Array) -> Array:
    """Compute force and moments of the wind on a plate from its angle of attack, see `WindLoad`.

    Args:
        load: the plate.
        relative: (3,) m/s, wind velocity relative to the plate's center, along the sides and the normal.

    Returns:
        (3,) force along the normal, N, and moments about the two sides through the center, N m.
    """
    x, y, z = relative
    along, across = np.hypot(np.hypot(x, y), CALM), np.hypot(z, CALM)
    attack = np.arctan2(across, along)
    aspect = max(load.lengths) / min(load.lengths)
    finite = 1.0 / (0.56 + 0.44 * np.sin(attack)) - 0.41 * (1.0 - np.exp(-17.0 / aspect))
    coefficient = 1.98 * np.sin(attack) * finite * z / across
    push = 0.5 * load.air_density * load.area * (along**2 + across**2) * coefficient
    ahead = -0.175 * (1.0 - 2.0 * attack / np.pi) * load.lengths * np.array([x, y]) / along
    return np.array([push, ahead[1] * push, -ahead[0] * push])
