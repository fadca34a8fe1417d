"""Loops and couplings of robots as their files describe them: constraint equations, closed poses, velocities.

In: descriptions of one structure, and states, as for `crosscheck.differences.joint_tree`. Out: residuals,
Jacobians and biases of the constraint equations, and the nearest states that fulfill them.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from crosscheck.differences.joint_tree import WIDTHS, JointTree, Kinematics
from crosscheck.differences.vectors import Equations, apply, cross, rotation_vector, stacked
from newton_euler.reading.robot import LoopKind, Robot
from newton_euler.scalars import Array

MAX_CLOSING_STEPS = 40
"""Gauss-Newton steps before loops count as not closed."""

MAX_CLOSING_STEP = 0.5
"""Largest change of a coordinate in a Gauss-Newton step, rad or lengths."""

LAST_STEP = 1e-7
"""Change of a coordinate, rad or lengths, at which Gauss-Newton steps end: the next one is its square."""

ROWS = {
    LoopKind.POINT: "m m m",
    LoopKind.WELD: "m m m rad rad rad",
    LoopKind.HINGE: "m m m rad rad",
    LoopKind.SLIDE: "rad rad rad m m",
    LoopKind.ROD: "m",
}
"""Units of the constraint equations of each kind of loop."""


class Constraints(NamedTuple):
    """Constraint equations of loops and couplings; lengths are in units of `JointTree.length`.

    Attributes:
        residual: (robots, states, rows) error of each equation, rad or lengths.
        jacobian: (robots, states, rows, coordinates) derivative of the residual.
        bias: (robots, states, rows) second time derivative while coordinates have no acceleration.
    """

    residual: Array
    jacobian: Array
    bias: Array


class ClosedTree(JointTree):
    """Bodies of robots whose joints fulfill loops and couplings.

    Attributes:
        rows: name of the loop or coupling of each constraint equation, and the unit of its error, m or rad.
        column: index of the coordinate of each hinge and slide, by the name of the joint.
    """

    def __init__(self, robots: Sequence[Robot], length: float) -> None:
        """Collect the frames of loops, and the polynomials of couplings."""
        super().__init__(robots, length)
        loops = range(len(self.robot.loops))
        self._frames = [
            tuple(
                stacked([getattr(getattr(r.loops[k], side), part) for r in robots])
                for side in ("first_frame", "second_frame")
                for part in ("position", "rotation")
            )
            for k in loops
        ]
        self._rods = [stacked([r.loops[k].length for r in robots]) for k in loops]
        self.column = {
            joint.name: self.at[index, number].start
            for index, body in enumerate(self.robot.bodies)
            for number, joint in enumerate(body.joints)
            if WIDTHS[joint.kind] == 1
        }
        self._couplings = []
        self.rows = [
            (self.robot.loop_name(loop), unit)
            for loop in self.robot.loops
            for unit in ROWS[loop.kind].split()
        ]
        for k, coupling in enumerate(self.robot.couplings):
            degree = max(len(r.couplings[k].powers) for r in robots)
            powers = [
                [*r.couplings[k].powers, *[0.0] * (degree - len(r.couplings[k].powers))] for r in robots
            ]
            leader = self.column[coupling.leader] if coupling.leader else None
            follows_length = self.is_length[self.column[coupling.follower]]
            self.rows.append((coupling.name or coupling.follower, "m" if follows_length else "rad"))
            self._couplings.append((self.column[coupling.follower], leader, stacked(powers)))

    def constraints(self, coordinates: Array, velocities: Array, moving: Kinematics) -> Constraints:
        """Return the equations of loops and couplings.

        Args:
            coordinates, velocities: (robots, states, coordinates).
            moving: the kinematics there.
        """
        robots, states = moving.position.shape[:2]
        residuals, jacobians, biases = (
            [np.zeros((robots, states, 0))],
            [np.zeros((robots, states, 0, self.size))],
            [],
        )
        for k in range(len(self.robot.loops)):
            residual, jacobian, bias = self._loop(k, moving)
            residuals.append(residual)
            jacobians.append(jacobian)
            biases.append(bias)
        displacement = coordinates - self.zero
        for follower, leader, powers in self._couplings:
            led = displacement[..., leader] if leader is not None else np.zeros(1)
            speed = velocities[..., leader] if leader is not None else np.zeros(1)
            exponents = range(powers.shape[-1])
            value = sum(powers[..., i] * led**i for i in exponents)
            slope = sum(i * powers[..., i] * led ** (i - 1) for i in exponents if i > 0)
            curvature = sum(i * (i - 1) * powers[..., i] * led ** (i - 2) for i in exponents if i > 1)
            jacobian = np.zeros((robots, states, 1, self.size))
            jacobian[..., 0, follower] = 1.0
            if leader is not None:
                jacobian[..., 0, leader] = -slope
            unit = self.scale[follower]
            full = np.zeros((robots, states, 1))
            residuals.append(full + (displacement[..., follower] - value)[..., None] / unit)
            jacobians.append(jacobian / unit)
            biases.append(full - (curvature * speed**2)[..., None] / unit)
        return Constraints(
            np.concatenate(residuals, axis=-1),
            np.concatenate(jacobians, axis=-2),
            np.concatenate([residuals[0], *biases], axis=-1),
        )

    def _loop(self, k: int, moving: Kinematics) -> tuple[Array, Array, Array]:
        """Return residual, Jacobian and bias of a loop; see `Constraints`."""
        loop = self.robot.loops[k]
        first_position, first_rotation, second_position, second_rotation = self._frames[k]
        sides = [
            self.frame_motion(loop.first, first_position, first_rotation, moving),
            self.frame_motion(loop.second, second_position, second_rotation, moving),
        ]
        one, two = sides
        # distance of the points, d, and relative angular velocity, with their first and second derivatives
        d, d_rate, d_bias = (
            two.point - one.point,
            two.velocity - one.velocity,
            two.acceleration - one.acceleration,
        )
        d_rows, turn_rows = two.point_rows - one.point_rows, two.turn_rows - one.turn_rows
        tilt = apply(one.rotation, rotation_vector(np.swapaxes(one.rotation, -1, -2) @ two.rotation))
        turn_bias = two.angular_acceleration - one.angular_acceleration
        points = (d / self.length, d_rows / self.length, d_bias / self.length)
        turns = (tilt, turn_rows, turn_bias)
        if loop.kind is LoopKind.POINT:
            parts = [points]
        elif loop.kind is LoopKind.WELD:
            parts = [points, turns]
        elif loop.kind is LoopKind.ROD:
            distance = np.linalg.norm(d, axis=-1)
            along = d / distance[..., None]
            rate = np.sum(along * d_rate, axis=-1)
            bias = np.sum(along * d_bias, axis=-1) + (np.sum(d_rate**2, axis=-1) - rate**2) / distance
            row = np.einsum("...i,...ij->...j", along, d_rows)[..., None, :]
            parts = [
                (
                    (distance - self._rods[k])[..., None] / self.length,
                    row / self.length,
                    bias[..., None] / self.length,
                )
            ]
        elif loop.kind is LoopKind.HINGE:
            # the y and z axes of the first frame are perpendicular to the x axis of the second
            x, x_rate, x_bias = two.axis(0)
            parts = [points]
            for column in (1, 2):
                e, e_rate, e_bias = one.axis(column)
                row = np.einsum("...i,...ij->...j", cross(x, e), turn_rows)
                parts.append(_product_row(e, e_rate, e_bias, x, x_rate, x_bias, row))
        else:
            # the second point stays on the x axis of the first frame
            parts = [turns]
            for column in (1, 2):
                e, e_rate, e_bias = one.axis(column)
                row = np.einsum("...i,...ij->...j", e, d_rows) + np.einsum(
                    "...i,...ij->...j", cross(e, d), one.turn_rows
                )
                found = _product_row(e, e_rate, e_bias, d, d_rate, d_bias, row)
                parts.append((found[0] / self.length, found[1] / self.length, found[2] / self.length))
        residual, jacobian, bias = zip(*parts, strict=True)
        return np.concatenate(residual, -1), np.concatenate(jacobian, -2), np.concatenate(bias, -1)

    def frame_motion(self, body: int, position: Array, rotation: Array, moving: Kinematics) -> _FrameMotion:
        """Return the motion of a frame that is fixed in a body."""
        turn = moving.rotation[..., body, :, :]
        point = moving.position[..., body, :] + apply(turn, position)
        columns = moving.columns * self.moves[body][:, None]
        twist, bias = moving.twist[..., body, :], moving.bias[..., body, :]
        velocity = twist[..., 3:] + cross(twist[..., :3], point)
        return _FrameMotion(
            point,
            turn @ rotation,
            velocity,
            bias[..., 3:] + cross(bias[..., :3], point) + cross(twist[..., :3], velocity),
            twist[..., :3],
            bias[..., :3],
            np.swapaxes(columns[..., 3:] + cross(columns[..., :3], point[..., None, :]), -1, -2),
            np.swapaxes(columns[..., :3], -1, -2),
        )

    def closed(self, coordinates: Array, free: Array | None = None) -> tuple[Array, Array]:
        """Return coordinates that fulfill the constraints, and the largest residual that is left.

        Gauss-Newton steps of least size; the residual that is left is that of constraints in conflict.

        Args:
            coordinates: (robots, states, coordinates) to begin with.
            free: (coordinates,) whether each coordinate may change; all if None.

        Returns:
            (robots, states, coordinates), and (robots, states) rad or lengths.
        """
        scale = self.scale if free is None else self.scale * free
        coordinates = coordinates + np.zeros((self.count, 1, 1))
        if not self.rows:
            return coordinates, np.zeros(coordinates.shape[:2])
        found = self.constraints_at(coordinates)
        for _ in range(MAX_CLOSING_STEPS):
            step = -scale * Equations(found.jacobian * scale).solution(found.residual)
            largest = np.abs(step / self.scale).max(axis=-1)
            step *= np.minimum(1.0, MAX_CLOSING_STEP / np.maximum(largest, MAX_CLOSING_STEP))[..., None]
            coordinates = self.moved(coordinates, step)
            found = self.constraints_at(coordinates)
            if largest.max() < LAST_STEP:
                break
        return coordinates, np.abs(found.residual).max(axis=-1)

    def constraints_at(self, coordinates: Array) -> Constraints:
        """Return the constraint equations of the robot at rest."""
        at_rest = np.zeros(coordinates.shape)
        return self.constraints(coordinates, at_rest, self.kinematics(coordinates, at_rest))

    def admissible(self, coordinates: Array, velocities: Array, free: Array | None = None) -> Array:
        """Return the velocities nearest to the given ones that the constraints allow.

        Args:
            coordinates, velocities: (robots, states, coordinates).
            free: (coordinates,) whether each velocity may change; all if None.
        """
        if not self.rows:
            return velocities + np.zeros((self.count, 1, 1))
        scale = self.scale if free is None else self.scale * free
        jacobian = self.constraints_at(coordinates).jacobian
        return velocities - scale * Equations(jacobian * scale).solution(apply(jacobian, velocities))

    def basis(self, coordinates: Array) -> Array:
        """Return (..., coordinates, coordinates) with a basis of the admissible velocities in some columns.

        The other columns are zero.
        """
        kernel = Equations(self.constraints_at(coordinates).jacobian * self.scale).kernel
        return self.scale[:, None] * kernel


class _FrameMotion(NamedTuple):
    """Motion of a frame in a body: pose, velocities, accelerations at constant velocities, Jacobians."""

    point: Array
    rotation: Array
    velocity: Array
    acceleration: Array
    angular_velocity: Array
    angular_acceleration: Array
    point_rows: Array
    turn_rows: Array

    def axis(self, column: int) -> tuple[Array, Array, Array]:
        """Return an axis of the frame and its first and second time derivative."""
        axis = self.rotation[..., column]
        rate = cross(self.angular_velocity, axis)
        return axis, rate, cross(self.angular_acceleration, axis) + cross(self.angular_velocity, rate)


def _product_row(
    a: Array, a_rate: Array, a_bias: Array, b: Array, b_rate: Array, b_bias: Array, row: Array
) -> tuple[Array, Array, Array]:
    """Return the constraint that two vectors are perpendicular, with its Jacobian row and its bias."""
    bias = np.sum(a_bias * b + 2 * a_rate * b_rate + a * b_bias, axis=-1)
    return np.sum(a * b, axis=-1)[..., None], row[..., None, :], bias[..., None]
