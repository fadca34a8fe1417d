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
    directions is not supported by the displaced joint, so it would accelerate the mechanism.

    In a mechanism without loops, the joint accelerates along R by |R| / (u^T M u). M is the mass matrix of
    all bodies. The body velocities u are those of a motion in which the joint yields along R at unit speed.
    Of all such motions, u has the least kinetic energy (Gauss's principle of least constraint).

    Torques are divided by, and angular velocities multiplied by, the length of the longest body.
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
        self._size = scene.mechanism.longest
        self._frames = [state.frames() for _, state in states]
        self._coordinates = [self._system.coordinates(state) for _, state in states]
        self._evaluations = [
            at_time(self._system, time).evaluate(*each)
            for (time, _), each in zip(states, self._coordinates, strict=True)
        ]
        self._is_tree = not (self._system.tree.cuts or self._system.couplings)
        self._inertia_cache: dict[int, tuple[Array, Array]] = {}

    @cached_property
    def lightest(self) -> float:
        """Smallest inertia of all bodies, kg: mass, or principal moment of inertia / longest body^2."""
        bodies = self._system.mechanism.bodies[1:]
        return min(
            min(body.mass, float(np.linalg.eigvalsh(body.inertia)[0]) / self._size**2) for body in bodies
        )

    def motion_change(self, displaced: JointEquations) -> tuple[float, float]:
        """Bound the distance, m, between the motions with the given and with a displaced joint.

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
        # Time^2 x force in each interval; distance = 1/2 x time^2 x force / inertia
        impulses = np.diff(times) ** 2 * np.minimum(norms[1:], norms[:-1])
        if not (self._is_tree and np.any(impulses)):
            return 0.0, upper
        k = int(np.argmax(impulses))
        lower = 0.5 * float(impulses[k]) / self._inertia(k, displaced, unsupported[k] / norms[k])
        return lower, upper

    def _unsupported(self, displaced: JointEquations) -> Array:
        """Compute the part (n, 6) of the reaction that the displaced joint cannot support at n times, N."""
        mechanism = self._system.mechanism
        number = mechanism.joint_index(displaced.joint.name)
        point = mechanism.joints[number].reaction_point
        arm = mechanism.bodies[displaced.second].pose.point_to_body(point)
        found = []
        for frames, evaluation in zip(self._frames, self._evaluations, strict=True):
            first, second = frames[displaced.first], frames[displaced.second]
            force = evaluation.reaction_force[number]
            torque = evaluation.reaction_torque[number] + np.cross(second.rotation @ arm, force)
            wrench = np.concatenate([force, torque / self._size])
            rows = displaced.jacobian(first, second)
            supported = np.concatenate([rows.r_second.T, rows.theta_second.T / self._size])
            found.append(wrench - supported @ np.linalg.lstsq(supported, wrench)[0])
        return np.array(found)

    def _inertia(self, k: int, displaced: JointEquations, direction: Array) -> float:
        """Compute u^T M u, kg: the inertia that an unsupported load accelerates, see the class.

        Args:
            k: number of the time.
            displaced: equations of the displaced joint.
            direction: (6,) unit vector of the load, in which the joint yields.
        """
        tree, frames = self._system.tree, self._frames[k]
        number = self._system.mechanism.joint_index(displaced.joint.name)
        kept = next(each for each in tree.joints if each.joint == number)
        others = np.delete(np.arange(tree.nv), np.arange(kept.v.start, kept.v.stop))
        motions, mass = self._inertias(k)
        # Body velocities if the joint yields at unit speed and all others are locked
        moving = np.any(motions[:, :, kept.v] != 0.0, axis=(1, 2))
        center = frames[displaced.second].position
        yielding = np.zeros((len(frames), 6))
        for body in np.flatnonzero(moving):
            turn = direction[3:] / self._size
            yielding[body, :3] = direction[:3] + np.cross(turn, frames[body].position - center)
            yielding[body, 3:] = turn
        momenta = self._momenta(k, yielding[:, :, None])[:, :, 0]
        # Minimize the kinetic energy over the velocities of the other joints
        coupling = np.einsum("bin,bi->n", motions, momenta)[others]
        response = np.linalg.solve(mass[np.ix_(others, others)], coupling)
        return float(np.sum(yielding * momenta) - coupling @ response)

    def body_effect(self, number: int, what: str, change: float, length: float, angle: float) -> float:
        """Return a lower bound on how far a relative change of a body's mass or inertia moves any body.

        The acceleration dv follows from M' dv = -J^T w. M' is the changed mass matrix, and w the wrench that
        the added inertia needs in the given motion. The bound is the distance after one interval between the
        times. It is 0 for mechanisms with loops, which have no such mass matrix.

        Args:
            number: number of the body.
            what: "mass" or "inertia".
            change: relative change, for example 0.1.
            length, angle: units of the result for positions, m, and orientations, rad.
        """
        times, found = [time for time, _ in self._states], 0.0
        for k in (len(times) - 2, 0) if self._is_tree and len(times) > 1 else ():
            ends = [self._acceleration(end, number, what, change) for end in (k, k + 1)]
            linear, angular = (min(accelerations) for accelerations in zip(*ends, strict=True))
            found = max(found, 0.5 * (times[k + 1] - times[k]) ** 2 * max(linear / length, angular / angle))
        return found

    def _acceleration(self, k: int, number: int, what: str, change: float) -> tuple[float, float]:
        """Compute the largest accelerations of any body caused by a change of one body at a time.

        Args:
            k: number of the time.
            number, what, change: see `body_effect`.

        Returns:
            Linear acceleration, m/s^2, and angular acceleration, rad/s^2.
        """
        body, frame = self._system.mechanism.bodies[number], self._frames[k][number]
        found = self._evaluations[k]
        motions, mass = self._inertias(k)
        linear, angular = motions[number, :3], motions[number, 3:]
        # Added mass matrix, and generalized force of the added inertia
        if what == "mass":
            added = change * body.mass * linear.T @ linear
            felt_acceleration = found.linear_acceleration[number] - self._system.scene.gravity
            force = -change * body.mass * linear.T @ felt_acceleration
        else:
            inertia = change * frame.rotation @ body.inertia @ frame.rotation.T
            added = angular.T @ inertia @ angular
            omega = found.state.angular_velocity[number]
            rate = inertia @ found.angular_acceleration[number] + np.cross(omega, inertia @ omega)
            force = -angular.T @ rate
        accelerations = motions @ np.linalg.solve(mass + added, force)
        return (
            float(np.max(np.linalg.norm(accelerations[:, :3], axis=1))),
            float(np.max(np.linalg.norm(accelerations[:, 3:], axis=1))),
        )

    def _inertias(self, k: int) -> tuple[Array, Array]:
        """Return body velocities (b, 6, nv) per joint velocity, and the mass matrix (nv, nv), at time k."""
        if k not in self._inertia_cache:
            transformation = self._system.velocity_transformation(self._coordinates[k][0])
            motions = transformation.reshape(-1, 6, self._system.nv)
            mass, _ = at_time(self._system, self._states[k][0]).mass_and_force(*self._coordinates[k])
            self._inertia_cache[k] = motions, mass
        return self._inertia_cache[k]

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
