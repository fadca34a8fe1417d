"""Bounds on how far a change of one joint or one body moves a mechanism, from the joint reactions of a run.

The coverage analysis (`coverage.py`) uses the bounds to decide without a simulation whether a run would show
that a joint is displaced, or that a body is heavier.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np

from newton_euler.equations.relative import Relative
from newton_euler.equations.system import at_time
from newton_euler.model.joint import JointEquations
from newton_euler.model.scene import Scene
from newton_euler.model.state import State
from newton_euler.scalars import Array


class JointLoads:
    """Joint reactions of a scene along a run, and bounds on the effect of changes.

    A displaced joint has other constraint directions. The part R (6,) of the reaction outside of these
    directions is not supported by the displaced joint, so R would accelerate the mechanism.

    In a mechanism without loops, the joint accelerates along R by |R| / (u^T M u). M is the mass matrix of
    all bodies. The body velocities u are those of a motion in which the joint yields along R at unit speed.
    Of all such motions, u has the least kinetic energy (Gauss's principle of least constraint).

    In R and in motions of the joint, torques are divided by, and angular velocities multiplied by, the length
    of the longest body.
    """

    def __init__(self, scene: Scene, states: Sequence[tuple[float, State]]) -> None:
        """Evaluate the scene at some states of a run.

        Args:
            scene: the scene.
            states: times, s, and states of the run, in order of time.

        Raises:
            NewtonEulerError: for a state at which accelerations cannot be computed.
        """
        self._system, self._states = Relative(scene), states
        self._longest = scene.mechanism.largest_extent  # length of the longest body, m
        self._frames = [state.frames() for _, state in states]
        self._coordinates = [self._system.coordinates(state) for _, state in states]
        self._evaluations = [
            at_time(self._system, time).evaluate(q, v)
            for (time, _), (q, v) in zip(states, self._coordinates, strict=True)
        ]
        # Without loop-closing joints and couplings of joint coordinates
        self._is_tree = not (self._system.tree.cuts or self._system.couplings)
        self._motions_and_mass_cache: dict[int, tuple[Array, Array]] = {}  # by number of the time

    @cached_property
    def lightest(self) -> float:
        """Smallest inertia of all bodies, kg: mass, or principal moment of inertia / longest body^2."""
        bodies = self._system.mechanism.bodies[1:]
        return min(
            min(body.mass, float(np.linalg.eigvalsh(body.inertia)[0]) / self._longest**2) for body in bodies
        )

    def motion_change(self, displaced: JointEquations) -> tuple[float, float]:
        """Bound the distance, m, between the motions with the joint of the scene and with a displaced joint.

        Args:
            displaced: equations of the displaced joint.

        Returns:
            A lower and an upper bound. The lower bound is the distance after one interval between the times;
            it is 0 for mechanisms with loops, where other joints may support the load. The upper bound holds
            for the whole run; it assumes that the lightest body alone is accelerated.
        """
        unsupported = self._unsupported(displaced)
        norms, times = np.linalg.norm(unsupported, axis=1), np.array([time for time, _ in self._states])
        upper = 0.5 * float(times[-1] ** 2 * np.max(norms)) / self.lightest
        # distance = 1/2 x time^2 x force / inertia, with the smaller force at the ends of each interval
        time2_forces = np.diff(times) ** 2 * np.minimum(norms[1:], norms[:-1])
        if not (self._is_tree and np.any(time2_forces)):
            return 0.0, upper
        k = int(np.argmax(time2_forces))
        direction = unsupported[k] / norms[k]
        lower = 0.5 * float(time2_forces[k]) / self._yielding_inertia(k, displaced, direction)
        return lower, upper

    def _unsupported(self, displaced: JointEquations) -> Array:
        """Compute the part (n, 6) of the reaction that the displaced joint cannot support at n times, N."""
        mechanism = self._system.mechanism
        number = mechanism.joint_index(displaced.joint.name)
        point = mechanism.joints[number].point_on_second
        # vector from the center of mass of the second body to its joint point, body frame; `point` and `pose`
        # are in the world at the initial pose
        arm = mechanism.bodies[displaced.second].pose.point_to_body(point)
        unsupported = []
        for frames, evaluation in zip(self._frames, self._evaluations, strict=True):
            # The reaction on the second body, about the center of mass of this body
            first, second = frames[displaced.first], frames[displaced.second]
            force = evaluation.reaction_force[number]
            torque = evaluation.reaction_torque[number] + np.cross(second.rotation @ arm, force)
            wrench = np.concatenate([force, torque / self._longest])
            # Its projection onto the constraint directions of the displaced joint is supported
            jacobian = displaced.jacobian(first, second)
            directions = np.concatenate([jacobian.r_second.T, jacobian.theta_second.T / self._longest])
            unsupported.append(wrench - directions @ np.linalg.lstsq(directions, wrench)[0])
        return np.array(unsupported)

    def _yielding_inertia(self, k: int, displaced: JointEquations, direction: Array) -> float:
        """Compute u^T M u, kg: the inertia that an unsupported load accelerates, see the class.

        Args:
            k: number of the time.
            displaced: equations of the displaced joint.
            direction: (6,) unit vector of the load, in which the joint yields.
        """
        tree, frames = self._system.tree, self._frames[k]
        number = self._system.mechanism.joint_index(displaced.joint.name)
        # Slice of the joint's velocities; records of the spanning tree refer to joints by number (`joint`)
        own = next(each.v for each in tree.joints if each.joint == number)
        others = np.delete(np.arange(tree.nv), np.arange(own.start, own.stop))
        motions, mass = self._motions_and_mass(k)
        # Body velocities if the joint yields at unit speed and all others are locked
        moving = np.any(motions[:, :, own] != 0.0, axis=(1, 2))
        center = frames[displaced.second].position
        yielding = np.zeros((len(frames), 6))
        for body in np.flatnonzero(moving):
            turn = direction[3:] / self._longest
            yielding[body, :3] = direction[:3] + np.cross(turn, frames[body].position - center)
            yielding[body, 3:] = turn
        momenta = self._momenta(k, yielding[:, :, None])[:, :, 0]
        # Minimize the kinetic energy over the velocities of the other joints
        coupling = np.einsum("bin,bi->n", motions, momenta)[others]
        response = np.linalg.solve(mass[np.ix_(others, others)], coupling)
        return float(np.sum(yielding * momenta) - coupling @ response)

    def body_effect(self, number: int, what: str, change: float, length: float, angle: float) -> float:
        """Return a lower bound on how far a relative change of a body's mass or inertia moves any body.

        The change dv of the joint accelerations follows from M' dv = -J^T w. M' is the changed mass matrix, w
        the wrench that the added inertia needs in the given motion, and J maps joint velocities to those of
        the body. The bound is the distance after the first or the last interval between the times. It is 0
        for mechanisms with loops, whose joint velocities are not independent.

        Args:
            number: number of the body.
            what: "mass" or "inertia".
            change: relative change, for example 0.1.
            length, angle: units of the result for positions, m, and orientations, rad.
        """
        if not self._is_tree or len(self._states) < 2:
            return 0.0
        times, bound = [time for time, _ in self._states], 0.0
        for k in (len(times) - 2, 0):
            at_ends = [self._acceleration_change(end, number, what, change) for end in (k, k + 1)]
            linear, angular = (min(accelerations) for accelerations in zip(*at_ends, strict=True))
            bound = max(bound, 0.5 * (times[k + 1] - times[k]) ** 2 * max(linear / length, angular / angle))
        return bound

    def _acceleration_change(self, k: int, number: int, what: str, change: float) -> tuple[float, float]:
        """Compute the largest accelerations of any body that a change of one body adds, at one time.

        Args:
            k: number of the time.
            number, what, change: see `body_effect`.

        Returns:
            Linear acceleration, m/s^2, and angular acceleration, rad/s^2.
        """
        body, frame = self._system.mechanism.bodies[number], self._frames[k][number]
        evaluation = self._evaluations[k]
        motions, mass = self._motions_and_mass(k)
        linear, angular = motions[number, :3], motions[number, 3:]  # J of this body
        # Added mass matrix M' - M, and generalized force -J^T w of the added inertia
        if what == "mass":
            added = change * body.mass * linear.T @ linear
            acceleration_and_weight = evaluation.linear_acceleration[number] - self._system.scene.gravity
            force = -change * body.mass * linear.T @ acceleration_and_weight
        else:
            inertia = change * frame.rotation @ body.inertia @ frame.rotation.T
            added = angular.T @ inertia @ angular
            omega = evaluation.state.angular_velocity[number]
            torque = inertia @ evaluation.angular_acceleration[number] + np.cross(omega, inertia @ omega)
            force = -angular.T @ torque
        accelerations = motions @ np.linalg.solve(mass + added, force)
        return (
            float(np.max(np.linalg.norm(accelerations[:, :3], axis=1))),
            float(np.max(np.linalg.norm(accelerations[:, 3:], axis=1))),
        )

    def _motions_and_mass(self, k: int) -> tuple[Array, Array]:
        """Return body velocities (b, 6, nv) per joint velocity, and the mass matrix (nv, nv), at time k."""
        if k not in self._motions_and_mass_cache:
            (time, _), (q, v) = self._states[k], self._coordinates[k]
            motions = self._system.velocity_transformation(q).reshape(-1, 6, self._system.nv)
            mass, _ = at_time(self._system, time).mass_and_force(q, v)
            self._motions_and_mass_cache[k] = motions, mass
        return self._motions_and_mass_cache[k]

    def _momenta(self, k: int, motions: Array) -> Array:
        """Compute momenta (b, 6, n) of b bodies for n body velocities (b, 6, n), at time k."""
        momenta = np.zeros_like(motions)
        for number, (body, frame) in enumerate(
            zip(self._system.mechanism.bodies, self._frames[k], strict=True)
        ):
            if number > 0:
                momenta[number, :3] = body.mass * motions[number, :3]
                inertia = frame.rotation @ body.inertia @ frame.rotation.T
                momenta[number, 3:] = inertia @ motions[number, 3:]
        return momenta
