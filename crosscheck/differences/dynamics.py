"""Accelerations of robots as their files describe them, at many states at once.

In: descriptions of one structure, `newton_euler.reading.robot.Robot`, such as a robot and the same robot with
other numbers, and states. Out: poses, constraint residuals and accelerations. Joint limits, dry friction and
contacts do not act. `crosscheck.differences.motion` compares two robots by them; no engine takes part.

The equations are written in joint coordinates of the tree. Twists (angular velocity, velocity of the point
that passes the origin of the world) and wrenches have components along the axes of the world; see
R. Featherstone, Rigid Body Dynamics Algorithms, 2008, sections 2.2 to 2.10 and 6.2. Arrays begin with the
axes (robots, states); the first one has length 1 where all robots have the same values.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from crosscheck.differences.vectors import (
    Equations,
    apply,
    cross,
    cross_force,
    cross_matrix,
    cross_motion,
    rotation_matrix,
    rotation_vector,
    stacked,
)
from newton_euler.reading.robot import FileJoint, JointKind, LoopKind, Robot
from newton_euler.scalars import Array

MAX_CLOSING_STEPS = 40
"""Gauss-Newton steps before loops count as not closed."""

MAX_CLOSING_STEP = 0.5
"""Largest change of a coordinate in a Gauss-Newton step, rad or lengths."""

LAST_STEP = 1e-7
"""Change of a coordinate, rad or lengths, at which Gauss-Newton steps end: the next one is its square."""

MASSLESS = 1e-14
"""A coordinate whose inertia is below this part of the largest one moves no mass."""

WIDTHS = {JointKind.HINGE: 1, JointKind.SLIDE: 1, JointKind.BALL: 3, JointKind.FREE: 6}
"""Number of coordinates of a joint of each kind."""


ROWS = {
    LoopKind.POINT: "m m m",
    LoopKind.WELD: "m m m rad rad rad",
    LoopKind.HINGE: "m m m rad rad",
    LoopKind.SLIDE: "rad rad rad m m",
    LoopKind.ROD: "m",
}
"""Units of the constraint equations of each kind of loop."""


class Kinematics(NamedTuple):
    """Poses and motions of all bodies; the last entry of the axis of bodies is the ground.

    Attributes:
        position: (robots, states, bodies + 1, 3) m, origin of the body's frame.
        rotation: (robots, states, bodies + 1, 3, 3) matrix from the body's axes to those of the world.
        columns: (robots, states, coordinates, 6) twist that a unit velocity of each coordinate gives to the
            bodies it moves.
        twist: (robots, states, bodies + 1, 6).
        bias: (robots, states, bodies + 1, 6) rate of the twist while coordinates have no acceleration.
    """

    position: Array
    rotation: Array
    columns: Array
    twist: Array
    bias: Array


class Constraints(NamedTuple):
    """Constraint equations of loops and couplings; lengths are in units of `Dynamics.length`.

    Attributes:
        residual: (robots, states, rows) error of each equation, rad or lengths.
        jacobian: (robots, states, rows, coordinates) derivative of the residual.
        bias: (robots, states, rows) second time derivative while coordinates have no acceleration.
    """

    residual: Array
    jacobian: Array
    bias: Array


class Accelerations(NamedTuple):
    """Accelerations of points of all bodies, components along the axes of the body.

    Attributes:
        linear: (robots, states, bodies, 3) m/s^2 of the point.
        angular: (robots, states, bodies, 3) rad/s^2.
        coordinates: (robots, states, coordinates) of the joint coordinates.
    """

    linear: Array
    angular: Array
    coordinates: Array


class Dynamics:
    """Equations of motion of robots that have the same structure and other numbers.

    Coordinates are those of the file for hinges and slides, and a rotation vector from the pose of the file
    for a ball. A free joint has the displacement and the rotation vector from the pose of the file, along
    the axes of the body's frame in that pose. Velocities of a ball or free joint have components along the
    axes of the moving body.

    Attributes:
        robot: the first of the robots.
        gears, gain: (robots, 1, drives, coordinates) force at each coordinate per force of a drive, and
            (robots, 1, drives) force of a drive per control.
        length: m, unit of lengths in constraint equations, about the size of the robot.
        at: slice of the coordinates of each joint, by indices of body and joint.
        size: number of coordinates.
        is_length: (coordinates,) whether a coordinate is a length, otherwise an angle.
        scale: (coordinates,) 1 for an angle, `length` for a displacement.
        zero: (robots, 1, coordinates) coordinates in the pose of the file.
        moves: (bodies + 1, coordinates) whether a coordinate moves a body.
        rows: name of the loop or coupling of each constraint equation, and the unit of its error, m or rad.
    """

    def __init__(self, robots: Sequence[Robot], length: float) -> None:
        """Collect the numbers of the robots.

        Args:
            robots: robots of one structure; gravity does not act on a robot whose gravity is None.
            length: m, unit of lengths in constraint equations.
        """
        self.robot = robots[0]
        self.length = length
        gravity = [np.zeros(3) if r.gravity is None else r.gravity for r in robots]
        self._gravity = stacked([[[0.0, 0.0, 0.0, *g]] for g in gravity])
        self._read_tree(robots)
        self._read_bodies(robots)
        self._read_constraints(robots)
        self._read_drives(robots)

    def _read_tree(self, robots: Sequence[Robot]) -> None:
        """Number the coordinates, and collect the numbers of joints."""
        bodies = self.robot.bodies
        self.at: dict[tuple[int, int], slice] = {}
        self.size = 0
        owner: list[int] = []
        is_length: list[bool] = []
        self.moves = np.zeros((len(bodies) + 1, sum(WIDTHS[j.kind] for b in bodies for j in b.joints)), bool)
        for index, body in enumerate(bodies):
            self.moves[index] = self.moves[body.parent]
            for number, joint in enumerate(body.joints):
                width = WIDTHS[joint.kind]
                self.at[index, number] = slice(self.size, self.size + width)
                self.moves[index, self.size : self.size + width] = True
                self.size += width
                owner += [index] * width
                is_length += [
                    joint.kind is JointKind.SLIDE or (joint.kind is JointKind.FREE and k < 3)
                    for k in range(width)
                ]
        self._owner = np.array(owner, int)
        self.is_length = np.array(is_length, bool)
        self.scale = np.where(self.is_length, self.length, 1.0)
        self.zero = self._of_joints(robots, "zero")
        self._armature = self._of_joints(robots, "armature")
        self._damping = self._of_joints(robots, "damping")
        self._stiffness = self._of_joints(robots, "stiffness")
        self._rest = self._of_joints(robots, "rest")
        self._axis = {key: stacked([r.bodies[key[0]].joints[key[1]].axis for r in robots]) for key in self.at}
        self._point = {
            key: stacked([r.bodies[key[0]].joints[key[1]].point for r in robots]) for key in self.at
        }

    def _of_joints(self, robots: Sequence[Robot], field: str) -> Array:
        """Return (robots, 1, coordinates) the number of a joint, for each of its coordinates."""
        rows = [
            [getattr(joint, field) for b in r.bodies for joint in b.joints for _ in range(WIDTHS[joint.kind])]
            for r in robots
        ]
        return np.array(rows, float).reshape(len(robots), 1, self.size)

    def _read_bodies(self, robots: Sequence[Robot]) -> None:
        """Collect placements, masses, centers and inertias; the ground has no mass."""
        self._offset = stacked([[b.placement.position for b in r.bodies] for r in robots])
        self._turn = stacked([[b.placement.rotation for b in r.bodies] for r in robots])
        self._mass = stacked([[b.mass for b in r.bodies] for r in robots])
        self._center = stacked([[b.center for b in r.bodies] for r in robots])
        self._inertia = stacked([[b.inertia for b in r.bodies] for r in robots])

    def _read_constraints(self, robots: Sequence[Robot]) -> None:
        """Collect the frames of loops, and the polynomials of couplings."""
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
        self._column = {
            joint.name: self.at[index, number].start
            for index, body in enumerate(self.robot.bodies)
            for number, joint in enumerate(body.joints)
            if WIDTHS[joint.kind] == 1
        }
        self._couplings = []
        self.rows = [(loop.name, unit) for loop in self.robot.loops for unit in ROWS[loop.kind].split()]
        for k, coupling in enumerate(self.robot.couplings):
            degree = max(len(r.couplings[k].powers) for r in robots)
            powers = [
                [*r.couplings[k].powers, *[0.0] * (degree - len(r.couplings[k].powers))] for r in robots
            ]
            leader = self._column[coupling.leader] if coupling.leader else None
            follows_length = self.is_length[self._column[coupling.follower]]
            self.rows.append((coupling.name, "m" if follows_length else "rad"))
            self._couplings.append((self._column[coupling.follower], leader, stacked(powers)))

    def _read_drives(self, robots: Sequence[Robot]) -> None:
        """Collect the laws of the drives, and their gears at the coordinates."""
        drives = range(len(self.robot.drives))
        gears = np.zeros((len(robots), 1, len(drives), self.size))
        for k, robot in enumerate(robots):
            for d, drive in enumerate(robot.drives):
                for name, gear in drive.gears.items():
                    if name in self._column:
                        gears[k, 0, d, self._column[name]] = gear
        self.gears = gears
        self.gain, self._drive_stiffness, self._drive_damping, self._drive_constant = (
            np.array([[getattr(r.drives[d], field) for d in drives] for r in robots]).reshape(
                len(robots), 1, -1
            )
            for field in ("gain", "stiffness", "damping", "constant")
        )

    def kinematics(self, coordinates: Array, velocities: Array) -> Kinematics:
        """Return the poses and motions of all bodies.

        Args:
            coordinates, velocities: (robots, states, coordinates).
        """
        states = coordinates.shape[1]
        robots = max(len(self._mass), len(coordinates))
        bodies = len(self.robot.bodies)
        position = np.zeros((robots, states, bodies + 1, 3))
        rotation = np.zeros((robots, states, bodies + 1, 3, 3))
        rotation[..., -1, :, :] = np.eye(3)
        columns = np.zeros((robots, states, self.size, 6))
        twist = np.zeros((robots, states, bodies + 1, 6))
        bias = np.zeros((robots, states, bodies + 1, 6))
        displacement = coordinates - self.zero
        for index, body in enumerate(self.robot.bodies):
            above = body.parent
            origin = position[..., above, :] + apply(rotation[..., above, :, :], self._offset[:, :, index])
            turn = rotation[..., above, :, :] @ self._turn[:, :, index]
            motion, rate = twist[..., above, :], bias[..., above, :]
            for number, joint in enumerate(body.joints):
                at = self.at[index, number]
                origin, turn, columns[..., at, :] = self._after_joint(
                    joint, (index, number), displacement[..., at], origin, turn
                )
                relative = np.einsum("...jk,...j->...k", columns[..., at, :], velocities[..., at])
                rate = rate + cross_motion(motion, relative)
                motion = motion + relative
            position[..., index, :], rotation[..., index, :, :] = origin, turn
            twist[..., index, :], bias[..., index, :] = motion, rate
        return Kinematics(position, rotation, columns, twist, bias)

    def _after_joint(
        self, joint: FileJoint, key: tuple[int, int], displacement: Array, origin: Array, turn: Array
    ) -> tuple[Array, Array, Array]:
        """Move a body by one of its joints.

        Args:
            joint: the joint.
            key: indices of its body and of the joint.
            displacement: (robots, states, coordinates of the joint) from the pose of the file.
            origin, turn: pose of the body before.

        Returns:
            the pose of the body, and (robots, states, coordinates of the joint, 6) twists by unit velocities.
        """
        axis, point = self._axis[key], self._point[key]
        if joint.kind is JointKind.SLIDE:
            direction = apply(turn, axis)
            column = np.concatenate([np.zeros(direction.shape), direction], axis=-1)
            return origin + direction * displacement, turn, column[..., None, :]
        if joint.kind is JointKind.FREE:
            origin = origin + apply(turn, displacement[..., :3])
            turn = turn @ rotation_matrix(displacement[..., 3:])
            axes = np.swapaxes(turn, -1, -2)
            translations = np.concatenate([np.zeros(axes.shape), axes], axis=-1)
            turns = np.concatenate([axes, cross(origin[..., None, :], axes)], axis=-1)
            return origin, turn, np.concatenate([translations, turns], axis=-2)
        anchor = origin + apply(turn, point)
        turn = turn @ rotation_matrix(axis * displacement if joint.kind is JointKind.HINGE else displacement)
        axes = apply(turn, axis)[..., None, :] if joint.kind is JointKind.HINGE else np.swapaxes(turn, -1, -2)
        column = np.concatenate([axes, cross(anchor[..., None, :], axes)], axis=-1)
        return anchor - apply(turn, point), turn, column

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
            self._frame_motion(loop.first, first_position, first_rotation, moving),
            self._frame_motion(loop.second, second_position, second_rotation, moving),
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

    def _frame_motion(self, body: int, position: Array, rotation: Array, moving: Kinematics) -> _FrameMotion:
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
        coordinates = coordinates + np.zeros((len(self._mass), 1, 1))
        if not self.rows:
            return coordinates, np.zeros(coordinates.shape[:2])
        found = self._constraints_at(coordinates)
        for _ in range(MAX_CLOSING_STEPS):
            step = -scale * Equations(found.jacobian * scale).solution(found.residual)
            largest = np.abs(step / self.scale).max(axis=-1)
            step *= np.minimum(1.0, MAX_CLOSING_STEP / np.maximum(largest, MAX_CLOSING_STEP))[..., None]
            coordinates = self.moved(coordinates, step)
            found = self._constraints_at(coordinates)
            if largest.max() < LAST_STEP:
                break
        return coordinates, np.abs(found.residual).max(axis=-1)

    def _constraints_at(self, coordinates: Array) -> Constraints:
        """Return the constraint equations of the robot at rest."""
        at_rest = np.zeros(coordinates.shape)
        return self.constraints(coordinates, at_rest, self.kinematics(coordinates, at_rest))

    def moved(self, coordinates: Array, step: Array) -> Array:
        """Return coordinates after a small motion, given as velocities during one second."""
        result = coordinates + step
        for (body, number), at in self.at.items():
            kind = self.robot.bodies[body].joints[number].kind
            if kind in (JointKind.BALL, JointKind.FREE):
                turn = slice(at.stop - 3, at.stop)
                before = rotation_matrix(coordinates[..., turn])
                result[..., turn] = rotation_vector(before @ rotation_matrix(step[..., turn]))
                if kind is JointKind.FREE:
                    place = slice(at.start, at.start + 3)
                    result[..., place] = coordinates[..., place] + apply(before, step[..., place])
        return result

    def admissible(self, coordinates: Array, velocities: Array, free: Array | None = None) -> Array:
        """Return the velocities nearest to the given ones that the constraints allow.

        Args:
            coordinates, velocities: (robots, states, coordinates).
            free: (coordinates,) whether each velocity may change; all if None.
        """
        if not self.rows:
            return velocities + np.zeros((len(self._mass), 1, 1))
        scale = self.scale if free is None else self.scale * free
        jacobian = self._constraints_at(coordinates).jacobian
        return velocities - scale * Equations(jacobian * scale).solution(apply(jacobian, velocities))

    def basis(self, coordinates: Array) -> Array:
        """Return (..., coordinates, coordinates) with a basis of the admissible velocities in some columns.

        The other columns are zero.
        """
        kernel = Equations(self._constraints_at(coordinates).jacobian * self.scale).kernel
        return self.scale[:, None] * kernel

    def loads(self, coordinates: Array, velocities: Array) -> tuple[Array, Array]:
        """Return inertias and forces at the coordinates, without constraints and drives.

        Args:
            coordinates, velocities: (robots, states, coordinates).

        Returns:
            (robots, states, coordinates) inertia at each coordinate with the others held, and the force of
            gravity, velocity products, dampers and springs.
        """
        mass, force = self._mass_and_force(self.kinematics(coordinates, velocities))
        none = np.zeros((1, 1, len(self.robot.drives)))
        force = force + self._joint_forces(coordinates, velocities, none, np.zeros(coordinates.shape[1]))
        return np.einsum("...ii->...i", mass), force

    def accelerations(
        self, coordinates: Array, velocities: Array, controls: Array, driven: Array, points: Array
    ) -> Accelerations:
        """Return the accelerations that the equations of motion give.

        The accelerations a minimize Gauss's function of constraint among all that the constraints allow: with
        the columns of N as basis of the admissible velocities and a_0 the least solution of the constraint
        equations, N^T M N y = N^T (f - M a_0) and a = a_0 + N y. Redundant constraints need no care.

        Args:
            coordinates: (robots, states, coordinates), which fulfill the constraints.
            velocities: (robots, states, coordinates); the nearest ones that the constraints allow are taken.
            controls: (robots, states, drives) controls of the drives.
            driven: (states,) whether the drives act.
            points: (robots, bodies, 3) m, in the frame of each body, whose acceleration is asked for.
        """
        if self.rows:
            jacobian = self._constraints_at(coordinates).jacobian
            equations = Equations(jacobian * self.scale)
            velocities = velocities - self.scale * equations.solution(apply(jacobian, velocities))
        moving = self.kinematics(coordinates, velocities)
        mass, force = self._mass_and_force(moving)
        force = force + self._joint_forces(coordinates, velocities, controls, driven)
        # a coordinate that moves no mass, as of a massless last link, has no acceleration of its own
        diagonal = np.einsum("...ii->...i", mass)
        largest = diagonal.max(axis=-1, initial=0.0, keepdims=True)
        idle = diagonal <= MASSLESS * largest
        force = np.where(idle, 0.0, force)
        diagonal += np.where(idle, np.maximum(largest, 1.0) * MASSLESS, 0.0)
        if not self.rows:
            found = _solved(mass, force)
        else:
            bias = self.constraints(coordinates, velocities, moving).bias
            start = -self.scale * equations.solution(bias)
            basis = self.scale[:, None] * equations.kernel
            reduced = np.swapaxes(basis, -1, -2) @ mass @ basis
            # columns of zeros pad the basis to the same width at all states
            np.einsum("...ii->...i", reduced)[...] += np.all(basis == 0.0, axis=-2)
            right = np.einsum("...ji,...j->...i", basis, force - apply(mass, start))
            found = start + apply(basis, _solved(reduced, right))
        return self._at_points(moving, found, points)

    def _mass_and_force(self, moving: Kinematics) -> tuple[Array, Array]:
        """Return the mass matrix and the force of gravity and of velocity products at the coordinates.

        Returns:
            (robots, states, coordinates, coordinates) and (robots, states, coordinates).
        """
        bodies = len(self.robot.bodies)
        turn = moving.rotation[..., :bodies, :, :]
        center = moving.position[..., :bodies, :] + apply(turn, self._center)
        inertia = np.zeros((*center.shape[:-1], 6, 6))
        mass = self._mass[..., None, None]
        tilde = cross_matrix(center)
        inertia[..., :3, :3] = turn @ self._inertia @ np.swapaxes(turn, -1, -2) - mass * (tilde @ tilde)
        inertia[..., :3, 3:] = mass * tilde
        inertia[..., 3:, :3] = -mass * tilde
        inertia[..., 3:, 3:] = mass * np.eye(3)
        twist = moving.twist[..., :bodies, :]
        wrench = apply(inertia, moving.bias[..., :bodies, :] - self._gravity)
        wrench = wrench + cross_force(twist, apply(inertia, twist))
        # what a coordinate moves: its body and all bodies that the body carries
        for index in range(bodies - 1, -1, -1):
            above = self.robot.bodies[index].parent
            if above >= 0:
                inertia[..., above, :, :] += inertia[..., index, :, :]
                wrench[..., above, :] += wrench[..., index, :]
        columns = moving.columns
        momenta = apply(inertia[..., self._owner, :, :], columns)
        matrix = np.triu((columns @ np.swapaxes(momenta, -1, -2)) * self.moves[self._owner].T)
        matrix = matrix + np.swapaxes(np.triu(matrix, 1), -1, -2)
        np.einsum("...ii->...i", matrix)[...] += self._armature
        return matrix, -np.sum(columns * wrench[..., self._owner, :], axis=-1)

    def _joint_forces(self, coordinates: Array, velocities: Array, controls: Array, driven: Array) -> Array:
        """Return (robots, states, coordinates) forces of dampers, springs and drives."""
        force = -self._damping * velocities - self._stiffness * (coordinates - self._rest)
        drive = self.drive_forces(coordinates, velocities, controls)
        return force + np.einsum("...ij,...i->...j", self.gears, drive) * driven[:, None]

    def drive_forces(self, coordinates: Array, velocities: Array, controls: Array) -> Array:
        """Return (robots, states, drives) forces of the drives, before their gears.

        Args:
            coordinates, velocities: (robots, states, coordinates).
            controls: (robots, states, drives).
        """
        extension, speed = apply(self.gears, coordinates), apply(self.gears, velocities)
        force = self.gain * controls + self._drive_constant
        return np.asarray(force + self._drive_stiffness * extension + self._drive_damping * speed)

    def _at_points(self, moving: Kinematics, found: Array, points: Array) -> Accelerations:
        """Return the accelerations of points of the bodies for accelerations of the coordinates."""
        bodies = len(self.robot.bodies)
        rate = moving.bias[..., :bodies, :] + np.einsum(
            "bj,...jk,...j->...bk", self.moves[:bodies].astype(float), moving.columns, found
        )
        turn = moving.rotation[..., :bodies, :, :]
        point = moving.position[..., :bodies, :] + apply(turn, points[:, None])
        angular, velocity = moving.twist[..., :bodies, :3], moving.twist[..., :bodies, 3:]
        linear = (
            rate[..., 3:] + cross(rate[..., :3], point) + cross(angular, velocity + cross(angular, point))
        )
        back = np.swapaxes(turn, -1, -2)
        return Accelerations(apply(back, linear), apply(back, rate[..., :3]), found)


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


def _solved(mass: Array, force: Array) -> Array:
    """Return the accelerations (..., n) for mass matrices (..., n, n) and forces; parts without mass rest."""
    try:
        return np.asarray(np.linalg.solve(mass, force[..., None])[..., 0])
    except np.linalg.LinAlgError:  # several coordinates together move no mass
        return apply(np.linalg.pinv(mass, rcond=MASSLESS, hermitian=True), force)


def size_of(robot: Robot) -> float:
    """Return the largest distance of bodies, joints and centers of mass from the first body, m; 1 if zero."""
    placements = robot.placements()
    points = [
        placement.position + placement.rotation @ point
        for placement, body in zip(placements, robot.bodies, strict=True)
        for point in (np.zeros(3), body.center, *(joint.point for joint in body.joints))
    ]
    return float(max(np.linalg.norm(point - placements[0].position) for point in points)) or 1.0
