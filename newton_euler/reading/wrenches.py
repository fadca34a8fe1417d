"""Wrenches of a scene's force elements and armatures on its bodies, computed from the elements' attributes.

An armature is the inertia of a motor's rotor, which resists the acceleration of a joint coordinate, or the
relative angular acceleration in a ball joint. The equations of motion of newton_euler call methods of the
force elements, such as `PointSpring.wrenches`; this module computes the same forces independently. The checks
of imported MJCF and URDF files and of dynamics engines, such as MuJoCo, compare with these wrenches. The
checks therefore also find mistakes in the methods.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple, assert_never

import numpy as np

from newton_euler.model.control import DeclaredLaw
from newton_euler.model.digital_control import HeldLaw, Law
from newton_euler.model.forces import BallSpring, Force, JointSpring, PointSpring, Wrench
from newton_euler.model.mechanism import Mechanism
from newton_euler.model.motions import TimeFunction
from newton_euler.model.plate_flow import CALM_SPEED
from newton_euler.model.scene import Scene
from newton_euler.model.state import State
from newton_euler.model.switched_forces import ElasticGear, JointFriction, JointStop
from newton_euler.model.wind import WindLoad
from newton_euler.reading.switched_loads import switched_load
from newton_euler.scalars import Array, cross

ORIGIN = np.zeros(3)
"""Arm of a force at the center of mass."""


class CoordinateMotion(NamedTuple):
    """A joint coordinate x and its motion at one state of the mechanism.

    Attributes:
        first, second: indices of the joint's two bodies.
        jacobian: (12,) with dx/dt = jacobian @ (velocity and angular velocity of the first body, then of the
            second), world frame.
        value: x, rad or m from the initial pose, with full revolutions.
        rate: dx/dt, rad/s or m/s.
    """

    first: int
    second: int
    jacobian: Array
    value: float
    rate: float


class Stretch(NamedTuple):
    """The line between the two points of a spring.

    Attributes:
        arms: index of the first body and of the second body, each with the vector (3,) from its center of
            mass to the point, m, world frame.
        along: (3,) unit vector from the first point to the second one; zero if they coincide.
        length: distance of the points, m.
        rate: rate of the length, m/s.
    """

    arms: Sequence[tuple[int, Array]]
    along: Array
    length: float
    rate: float


class Wrenches:
    """Sums of wrenches on the b bodies of a mechanism at one state; forces are added one after the other.

    Attributes:
        mechanism: mechanism of the bodies.
        frames: poses and velocities of the bodies.
        time: s, of control laws and wind.
        total: (b, 6) forces and torques about the centers of mass, N and N m, world frame.
        magnitude: (b, 6) sums of the absolute values of the added wrenches; a scale for tolerances.
    """

    def __init__(self, mechanism: Mechanism, state: State, time: float = 0.0) -> None:
        self.mechanism, self.frames, self.time, self._state = mechanism, state.frames(), time, state
        self.total, self.magnitude = np.zeros((2, len(self.frames), 6))

    def _add(self, body: int, force: Array, torque: Array, arm: Array = ORIGIN) -> None:
        """Add a force and a torque to a body, world frame.

        Args:
            body: index of the body.
            force: (3,) N.
            torque: (3,) torque about the point at which the force acts, N m.
            arm: (3,) vector from the center of mass to this point, m.
        """
        self.total[body] += np.concatenate([force, torque + np.cross(arm, force)])
        # a force through a hinge has no moment about it, but the round-off of both of its terms
        terms = np.abs(arm[[1, 2, 0]] * force[[2, 0, 1]]) + np.abs(arm[[2, 0, 1]] * force[[1, 2, 0]])
        self.magnitude[body] += np.concatenate([np.abs(force), np.abs(torque) + terms])

    def _add_along(self, at: CoordinateMotion, force: float) -> None:
        """Add a generalized force, N or N m, along a joint coordinate to the joint's two bodies."""
        generalized = force * at.jacobian
        self._add(at.first, generalized[:3], generalized[3:6])
        self._add(at.second, generalized[6:9], generalized[9:])

    def _rotation_since_start(self, body: int) -> Array:
        """Return the rotation matrix (3, 3) from a body's initial orientation to its present one."""
        return np.asarray(self.frames[body].rotation @ self.mechanism.bodies[body].pose.rotation.T)

    def _lever_arm(self, body: int, point: Array) -> Array:
        """Return the vector (3,) from a body's center of mass to a point of the body, m, world frame.

        Args:
            body: index of the body.
            point: (3,) m, world frame, position of the point at the initial pose.
        """
        offset = point - self.mechanism.bodies[body].pose.position
        return np.asarray(self._rotation_since_start(body) @ offset)

    def add_forces(self, scene: Scene, control: Sequence[float] | Array = ()) -> None:
        """Add all forces of a scene except gravity.

        Args:
            scene: scene with the forces.
            control: force of each element of `scene.joint_forces` (control laws and joint springs), N or N m.
                Only the entries of laws that use a model of the mechanism (gravity compensation, computed
                torque) are read, because this class does not compute their forces.
        """
        for k, law in enumerate(scene.control):  # the first ones of `Scene.joint_forces`
            at = self._coordinate(*law.key)
            is_given = isinstance(law, DeclaredLaw) and law.uses_model
            self._add_along(at, control[k] if is_given else self._joint_force(law, at))
        for force in scene.forces:
            self.add_force(force)

    def add_force(self, force: Force) -> None:
        """Add the force of one element that is no control law."""
        match force:
            case JointSpring():
                at = self._coordinate(*force.key)
                self._add_along(at, self._joint_force(force, at))
            case JointFriction() | JointStop() | ElasticGear():
                motions = [self._coordinate(*key) for key in force.keys]
                load = switched_load(force, [at.value for at in motions], [at.rate for at in motions])
                for at, applied_force in zip(motions, load.forces, strict=True):
                    self._add_along(at, applied_force)
            case PointSpring():
                self._add_point_spring(force)
            case BallSpring():
                self._add_ball_spring(force)
            case Wrench():
                body = self.mechanism.body_index(force.body)
                rotation = self._rotation_since_start(body) if force.frame == "body" else np.eye(3)
                applied, torque = rotation @ force.force, rotation @ force.torque
                arm = self._lever_arm(body, force.point)
                self._add(body, applied, torque, arm)
            case WindLoad():
                self._add_wind(force)
            case _:
                assert_never(force)

    def _joint_force(self, law: Law | JointSpring, at: CoordinateMotion) -> float:
        """Compute the force of a control law or a joint spring along its coordinate, N or N m.

        Args:
            law: a spring; a sampled controller, whose force is held between samples (`HeldLaw`); or a law of
                feedforward and proportional-derivative feedback (`DeclaredLaw`).
            at: the joint coordinate along which the force acts.
        """
        if isinstance(law, JointSpring):
            return law.stiffness * (law.rest - at.value) - law.damping * at.rate
        if isinstance(law, HeldLaw):
            return law.held
        if not isinstance(law, DeclaredLaw):
            assert_never(law)
        force = float(law.feedforward_at(self.time))
        for key, (k_p, k_d) in law.feedback.items():
            reference, measured = law.references(self.time)[key], self._coordinate(*key)
            force += k_p * (reference.value - measured.value) + k_d * (reference.rate - measured.rate)
        return force

    def _coordinate(self, joint: str, coordinate: int) -> CoordinateMotion:
        """Evaluate a coordinate of a joint by the joint's name and the coordinate's index in the joint."""
        equations = self.mechanism.joint_equations(joint)
        # The coordinate is the residual phi of the constraint that would lock it at the initial pose
        locking = equations.coordinates[coordinate]
        first, second = self.frames[equations.first], self.frames[equations.second]
        jacobian = locking.jacobian(first, second)
        value, rate = locking.phi(first, second)[0], jacobian.rate(first, second)[0]
        value += self._state.revolutions((joint, coordinate), value)  # multiple of 2 pi; 0 for a slide
        rows = np.concatenate(jacobian, axis=1)
        return CoordinateMotion(equations.first, equations.second, rows[0], value, rate)

    def stretch(self, spring: PointSpring) -> Stretch:
        """Measure the line between the two points of a spring."""
        arms, positions, velocities = [], [], []
        for name, point in ((spring.first, spring.point_on_first), (spring.second, spring.point_on_second)):
            body = self.mechanism.body_index(name)
            frame, arm = self.frames[body], self._lever_arm(body, point)
            arms.append((body, arm))
            positions.append(frame.position + arm)
            velocities.append(frame.velocity + cross(frame.angular_velocity, arm))
        line = positions[1] - positions[0]
        length = float(np.linalg.norm(line))
        along = line / (length or 1.0)  # a spring without rest length and damping may have zero length
        return Stretch(arms, along, length, float(along @ (velocities[1] - velocities[0])))

    def _add_point_spring(self, spring: PointSpring) -> None:
        """Add the force of a spring and damper between points of two bodies, along the line between them."""
        at = self.stretch(spring)
        tension = spring.stiffness * (at.length - spring.rest_length) + spring.damping * at.rate
        on_first = tension * at.along
        for (body, arm), force in zip(at.arms, (on_first, -on_first), strict=True):
            self._add(body, force, np.zeros(3), arm)

    def _add_ball_spring(self, spring: BallSpring) -> None:
        """Add the torque of a rotational spring and damper between the two bodies of a ball joint."""
        from scipy.spatial.transform import Rotation

        equations = self.mechanism.joint_equations(spring.joint)
        first, second = equations.first, equations.second
        rest = Rotation.from_rotvec(spring.rest.copy()).as_matrix()  # SciPy refuses read-only arrays
        # Rotation vector theta from the rest orientation: in the first body's frame, then in the world frame
        first_rotation = self._rotation_since_start(first)
        between = first_rotation.T @ self._rotation_since_start(second) @ rest.T
        theta = first_rotation @ Rotation.from_matrix(between).as_rotvec()
        omega = self.frames[second].angular_velocity - self.frames[first].angular_velocity
        torque = -spring.stiffness * theta - spring.damping * omega
        self._add(first, np.zeros(3), -torque)
        self._add(second, np.zeros(3), torque)

    def wind(self, load: WindLoad) -> Array:
        """Compute the normal force (N) of the wind on a plate and its two moments (N m), (3,), see
        `wind_on_plate`."""
        body = self.mechanism.body_index(load.body)
        frame, axes = self.frames[body], self._rotation_since_start(body) @ load.axes
        plate_velocity = frame.velocity + np.cross(frame.angular_velocity, self._lever_arm(body, load.point))
        speed, upward = (
            each.value(self.time) if isinstance(each, TimeFunction) else each
            for each in (load.speed, load.vertical_speed)
        )
        wind_velocity = speed * load.direction / np.linalg.norm(load.direction) + [0.0, 0.0, upward]
        return wind_on_plate(load, axes.T @ (wind_velocity - plate_velocity))

    def _add_wind(self, load: WindLoad) -> None:
        """Add the wind load of a plate to the plate's body."""
        body = self.mechanism.body_index(load.body)
        # Columns of axes: unit vectors along the two sides of the plate and its normal, world frame
        axes, (normal_force, *moments) = self._rotation_since_start(body) @ load.axes, self.wind(load)
        force = normal_force * axes[:, 2]
        self._add(body, force, axes[:, :2] @ moments, self._lever_arm(body, load.point))

    def add_armatures(self, scene: Scene, linear: Array, angular: Array) -> None:
        """Add the reactions of a scene's armatures to accelerations of the bodies.

        Args:
            scene: scene with the armatures.
            linear: (b, 3) accelerations of the centers of mass, m/s^2, world frame.
            angular: (b, 3) angular accelerations, rad/s^2, world frame.
        """
        for armature in scene.armatures:
            equations = self.mechanism.joint_equations(armature.joint)
            i, j = equations.first, equations.second
            if armature.on_ball:
                # A rotor on a ball has the same inertia about all axes. It resists the rate of omega_j -
                # omega_i as seen from body j; omega_j x omega_i comes from this moving frame
                of_frame = np.cross(self.frames[j].angular_velocity, self.frames[i].angular_velocity)
                torque = -armature.inertia * (angular[j] - angular[i] + of_frame)
                self._add(i, np.zeros(3), -torque)
                self._add(j, np.zeros(3), torque)
                continue
            # d^2x/dt^2 = jacobian @ accelerations - gamma, where -gamma is the term quadratic in velocities
            _, coordinate = armature.key
            at = self._coordinate(armature.joint, coordinate)
            accelerations = np.concatenate([linear[i], angular[i], linear[j], angular[j]])
            gamma = equations.coordinates[coordinate].gamma(self.frames[i], self.frames[j])[0]
            self._add_along(at, -armature.inertia * (float(at.jacobian @ accelerations) - gamma))


def wind_on_plate(load: WindLoad, relative: Array) -> Array:
    """Compute force and moments of the wind on a flat plate from the angle of attack.

    The formulas and their sources are in the docstring of `WindLoad`. This function evaluates them
    independently of the class.

    Args:
        load: the plate.
        relative: (3,) m/s, wind velocity relative to the plate's center, along the sides and the normal.

    Returns:
        (3,) force along the normal, N, and moments about the two axes through the center parallel to the
        sides, N m.
    """
    # Scalars of Python: engines call this function in every evaluation of their equations of motion
    x, y, z = relative.tolist()
    length, width = (math.hypot(*side.tolist()) for side in (load.first_side, load.second_side))
    # The speed CALM_SPEED (m/s) is added in quadrature, so that the load is smooth at zero wind
    along, across = math.hypot(x, y, CALM_SPEED), math.hypot(z, CALM_SPEED)
    attack = math.atan2(across, along)
    sine, degrees = math.sin(attack), math.degrees(attack)
    # Chord along and span across the wind. Constants of all formulas are repeated here on purpose,
    # independently of newton_euler.model.plate_flow; angles are in degrees
    first, second = math.hypot(x, CALM_SPEED / math.sqrt(2.0)), math.hypot(y, CALM_SPEED / math.sqrt(2.0))
    ratio = math.hypot(length * second, width * first) / math.hypot(length * first, width * second)
    stall = 7.6 + 19.5 / (1.0 + (ratio / 1.09) ** 8) + 14.9 / (1.0 + (ratio / 3.18) ** 2)
    separated_part = 1.0 / (1.0 + math.exp((stall - degrees) / 2.4))
    # Attached flow: potential flow with McCormick's lift slope, and vortices (Khan and Nahon)
    slope = 2.0 * math.pi * ratio / (ratio + 2.0 * (ratio + 4.0) / (ratio + 2.0))
    potential = (1.0 - separated_part) * slope * sine * math.cos(attack)
    vortex = (1.0 - separated_part) * math.pi * sine**2
    # Separated flow: 1.98 (Khan and Nahon), 0.56 and 0.44 (Hoerner), 0.41 and 17 (Lindenburg)
    end_loss = 0.41 * (1.0 - math.exp(-17.0 * min(length, width) / max(length, width)))
    separated = separated_part * 1.98 * sine * (1.0 / (0.56 + 0.44 * sine) - end_loss)
    # Centers of pressure ahead of the plate's center, in chords: 0.25 and 0.42 behind the leading edge
    moment = 0.25 * potential + (0.5 - 0.42) * vortex + 0.175 * (1.0 - degrees / 90.0) * separated
    pressure = 0.5 * load.air_density * length * width * (along**2 + across**2) * z / across
    # Products of forces and positions of their centers along the two sides, against the wind
    on_first, on_second = -pressure * moment * length * x / along, -pressure * moment * width * y / along
    return np.array([pressure * (potential + vortex + separated), on_second, -on_first])
