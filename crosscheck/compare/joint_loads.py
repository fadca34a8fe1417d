"""Loads of joints: how far motions part where a displaced joint does not carry them, or a body is heavier."""

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
    """Reactions of a scene's joints along a run.

    What a displaced joint does not carry of its reaction, a force of 6 components R, keeps the motion from
    being one of the changed scene. In a tree, whose reactions follow from its motion, it accelerates the
    joint along R by |R| / (u^T M u), with M of all bodies and u the motion of least kinetic energy in which
    the joint yields along R at unit speed and all others as they like (Gauss's principle of least
    constraint). Torques and angular velocities count at the longest body throughout.
    """

    def __init__(self, scene: Scene, states: Sequence[tuple[float, State]]) -> None:
        """`states` are those of a run at some times, s.

        Raises:
            NewtonEulerError: for a state without accelerations.
        """
        self._system, self._states = Relative(scene), states
        self._size = scene.mechanism.longest
        self._frames = [state.frames() for _, state in states]
        self._coordinates = [self._system.coordinates(state) for _, state in states]
        self._found = [
            at_time(self._system, time).evaluate(*each)
            for (time, _), each in zip(states, self._coordinates, strict=True)
        ]
        self._open = not (self._system.tree.cuts or self._system.couplings)
        self._moving: dict[int, tuple[Array, Array]] = {}

    @cached_property
    def lightest(self) -> float:
        """The least mass, kg, or principal moment of inertia of all bodies."""
        bodies = self._system.mechanism.bodies[1:]
        return min(
            min(body.mass, float(np.linalg.eigvalsh(body.inertia)[0]) / self._size**2) for body in bodies
        )

    def parting(self, displaced: JointEquations) -> tuple[float, float]:
        """Bound the distance, m, that a displaced joint makes the motion part by, at least and at most.

        At least from one of the times to the next; 0 in mechanisms with loops, where other joints may carry
        what this one does not. At most in the whole run, if the lightest body alone were accelerated.
        """
        left = self._not_carried(displaced)
        norms, times = np.linalg.norm(left, axis=1), np.array([time for time, _ in self._states])
        most = 0.5 * float(times[-1] ** 2 * np.max(norms)) / self.lightest
        held = np.diff(times) ** 2 * np.minimum(norms[1:], norms[:-1])
        if not (self._open and np.any(held)):
            return 0.0, most
        k = int(np.argmax(held))
        return 0.5 * float(held[k]) / self._inertia(k, displaced, left[k] / norms[k]), most

    def _not_carried(self, displaced: JointEquations) -> Array:
        """Compute (n, 6) what the displaced joint does not carry at each time, N."""
        mechanism = self._system.mechanism
        number = mechanism.joint_index(displaced.joint.name)
        point = mechanism.joints[number].reaction_point
        arm = mechanism.bodies[displaced.second].pose.point_to_body(point)
        found = []
        for frames, evaluation in zip(self._frames, self._found, strict=True):
            first, second = frames[displaced.first], frames[displaced.second]
            force = evaluation.reaction_force[number]
            torque = evaluation.reaction_torque[number] + np.cross(second.rotation @ arm, force)
            wrench = np.concatenate([force, torque / self._size])
            rows = displaced.jacobian(first, second)
            carried = np.concatenate([rows.r_second.T, rows.theta_second.T / self._size])
            found.append(wrench - carried @ np.linalg.lstsq(carried, wrench)[0])
        return np.array(found)

    def _inertia(self, k: int, displaced: JointEquations, direction: Array) -> float:
        """Compute u^T M u, kg, at a time for a direction (6,) of the displaced joint."""
        tree, frames = self._system.tree, self._frames[k]
        number = self._system.mechanism.joint_index(displaced.joint.name)
        kept = next(each for each in tree.joints if each.joint == number)
        others = np.delete(np.arange(tree.nv), np.arange(kept.v.start, kept.v.stop))
        motions, mass = self._inertias(k)
        moving = np.any(motions[:, :, kept.v] != 0.0, axis=(1, 2))
        center = frames[displaced.second].position
        yielding = np.zeros((len(frames), 6))
        for body in np.flatnonzero(moving):
            turn = direction[3:] / self._size
            yielding[body, :3] = direction[:3] + np.cross(turn, frames[body].position - center)
            yielding[body, 3:] = turn
        weighted = self._weighted(k, yielding[:, :, None])[:, :, 0]
        shared = np.einsum("bin,bi->n", motions, weighted)[others]
        answer = np.linalg.solve(mass[np.ix_(others, others)], shared)
        return float(np.sum(yielding * weighted) - shared @ answer)

    def share_of_body(self, number: int, what: str, change: float, length: float, angle: float) -> float:
        """Bound how far a relative change of a body's "mass" or "inertia" makes poses part, in these units.

        At least, from one of the times to the next, as `parting`: by M' dv = -J^T w, with the wrench w, and
        the mass matrix M', of the change. 0 in mechanisms with loops, which have no such M'.
        """
        times, found = [time for time, _ in self._states], 0.0
        for k in (len(times) - 2, 0) if self._open and len(times) > 1 else ():
            pair = [self._acceleration(at, number, what, change) for at in (k, k + 1)]
            linear, angular = (min(each[n] for each in pair) for n in (0, 1))
            found = max(found, 0.5 * (times[k + 1] - times[k]) ** 2 * max(linear / length, angular / angle))
        return found

    def _acceleration(self, k: int, number: int, what: str, change: float) -> tuple[float, float]:
        """Compute the largest accelerations, m/s^2 and rad/s^2, of all bodies by a changed body at a time."""
        body, frame, found = self._system.mechanism.bodies[number], self._frames[k][number], self._found[k]
        motions, mass = self._inertias(k)
        linear, angular = motions[number, :3], motions[number, 3:]
        if what == "mass":
            added = change * body.mass * linear.T @ linear
            free_fall = found.linear_acceleration[number] - self._system.scene.gravity
            push = -change * body.mass * linear.T @ free_fall
        else:
            inertia = change * frame.rotation @ body.inertia @ frame.rotation.T
            added = angular.T @ inertia @ angular
            omega = found.state.angular_velocity[number]
            rate = inertia @ found.angular_acceleration[number] + np.cross(omega, inertia @ omega)
            push = -angular.T @ rate
        moved = motions @ np.linalg.solve(mass + added, push)
        return (
            float(np.max(np.linalg.norm(moved[:, :3], axis=1))),
            float(np.max(np.linalg.norm(moved[:, 3:], axis=1))),
        )

    def _inertias(self, k: int) -> tuple[Array, Array]:
        """Compute body velocities (b, 6, nv) for each joint velocity, and the mass matrix (nv, nv)."""
        if k not in self._moving:
            transformation = self._system.velocity_transformation(self._coordinates[k][0])
            motions = transformation.reshape(-1, 6, self._system.nv)
            mass, _ = at_time(self._system, self._states[k][0]).mass_and_force(*self._coordinates[k])
            self._moving[k] = motions, mass
        return self._moving[k]

    def _weighted(self, k: int, motions: Array) -> Array:
        """Compute momenta (b, 6, n) of velocities (b, 6, n) at a time."""
        weighted = np.zeros_like(motions)
        for number, (body, frame) in enumerate(
            zip(self._system.mechanism.bodies, self._frames[k], strict=True)
        ):
            if number > 0:
                weighted[number, :3] = body.mass * motions[number, :3]
                inertia = frame.rotation @ body.inertia @ frame.rotation.T
                weighted[number, 3:] = inertia @ motions[number, 3:]
        return weighted
