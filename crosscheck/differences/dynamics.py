"""Accelerations of robots as their files describe them, at many states at once.

In: descriptions of one structure, and states, as for `crosscheck.differences.joint_tree`. Out: accelerations.
Joint limits, dry friction and contacts do not act. `crosscheck.differences.motion` compares two robots by
them; no engine takes part. The equations are written in joint coordinates of the tree; see R. Featherstone,
Rigid Body Dynamics Algorithms, 2008, section 6.2.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from crosscheck.differences.joint_tree import Kinematics
from crosscheck.differences.loop_closure import ClosedTree
from crosscheck.differences.vectors import Equations, apply, cross, cross_force, cross_matrix, stacked
from newton_euler.reading.robot import Robot
from newton_euler.scalars import Array

MASSLESS = 1e-14
"""A coordinate whose inertia is below this part of the largest one moves no mass."""


SPRING_NUMBERS = ("stiffness", "damping", "rest")
"""Fields of a spring between points."""


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


class Dynamics(ClosedTree):
    """Equations of motion of robots that have the same structure and other numbers.

    Attributes:
        gears, gain: (robots, 1, drives, coordinates) force at each coordinate per force of a drive, and
            (robots, 1, drives) force of a drive per control.
    """

    def __init__(self, robots: Sequence[Robot], length: float) -> None:
        """Collect masses, springs, dampers and drives; no gravity acts on a robot whose gravity is None."""
        super().__init__(robots, length)
        gravity = [np.zeros(3) if r.gravity is None else r.gravity for r in robots]
        self._gravity = stacked([[[0.0, 0.0, 0.0, *g]] for g in gravity])
        self._armature = self.of_joints(robots, "armature")
        self._damping = self.of_joints(robots, "damping")
        self._stiffness = self.of_joints(robots, "stiffness")
        self._rest = self.of_joints(robots, "rest")
        self._mass = stacked([[b.mass for b in r.bodies] for r in robots])
        self._center = stacked([[b.center for b in r.bodies] for r in robots])
        self._inertia = stacked([[b.inertia for b in r.bodies] for r in robots])
        self._read_drives(robots)
        self._springs = [
            tuple(stacked([getattr(r.springs[k], field) for r in robots]) for field in SPRING_NUMBERS)
            for k in range(len(self.robot.springs))
        ]
        self._spring_points = [
            tuple(
                stacked([getattr(r.springs[k], side).position for r in robots])
                for side in ("first_frame", "second_frame")
            )
            for k in range(len(self.robot.springs))
        ]

    def _read_drives(self, robots: Sequence[Robot]) -> None:
        """Collect the laws of the drives, and their gears at the coordinates."""
        drives = range(len(self.robot.drives))
        gears = np.zeros((len(robots), 1, len(drives), self.size))
        for k, robot in enumerate(robots):
            for d, drive in enumerate(robot.drives):
                for name, gear in drive.gears.items():
                    if name in self.column:
                        gears[k, 0, d, self.column[name]] = gear
        self.gears = gears
        self.gain, self._drive_stiffness, self._drive_damping, self._drive_constant = (
            np.array([[getattr(r.drives[d], field) for d in drives] for r in robots]).reshape(
                len(robots), 1, -1
            )
            for field in ("gain", "stiffness", "damping", "constant")
        )

    def loads(self, coordinates: Array, velocities: Array) -> tuple[Array, Array]:
        """Return inertias and forces at the coordinates, without constraints and drives.

        Args:
            coordinates, velocities: (robots, states, coordinates).

        Returns:
            (robots, states, coordinates) inertia at each coordinate with the others held, and the force of
            gravity, velocity products, dampers and springs.
        """
        moving = self.kinematics(coordinates, velocities)
        mass, force = self._mass_and_force(moving)
        none = np.zeros((1, 1, len(self.robot.drives)))
        force = force + self._joint_forces(coordinates, velocities, none, np.zeros(coordinates.shape[1]))
        force = force + self._spring_forces(moving)
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
            jacobian = self.constraints_at(coordinates).jacobian
            equations = Equations(jacobian * self.scale)
            velocities = velocities - self.scale * equations.solution(apply(jacobian, velocities))
        moving = self.kinematics(coordinates, velocities)
        mass, force = self._mass_and_force(moving)
        force = force + self._joint_forces(coordinates, velocities, controls, driven)
        force = force + self._spring_forces(moving)
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
        momenta = apply(inertia[..., self.owner, :, :], columns)
        matrix = np.triu((columns @ np.swapaxes(momenta, -1, -2)) * self.moves[self.owner].T)
        matrix = matrix + np.swapaxes(np.triu(matrix, 1), -1, -2)
        np.einsum("...ii->...i", matrix)[...] += self._armature
        return matrix, -np.sum(columns * wrench[..., self.owner, :], axis=-1)

    def _joint_forces(self, coordinates: Array, velocities: Array, controls: Array, driven: Array) -> Array:
        """Return (robots, states, coordinates) forces of dampers, springs and drives."""
        force = -self._damping * velocities - self._stiffness * (coordinates - self._rest)
        drive = self.drive_forces(coordinates, velocities, controls)
        return force + np.einsum("...ij,...i->...j", self.gears, drive) * driven[:, None]

    def _spring_forces(self, moving: Kinematics) -> Array:
        """Return (robots, states, coordinates) forces of springs and dampers between points."""
        total = np.zeros((*moving.position.shape[:2], self.size))
        for spring, points, (stiffness, damping, rest) in zip(
            self.robot.springs, self._spring_points, self._springs, strict=True
        ):
            one, two = (
                self.frame_motion(body, point, np.eye(3), moving)
                for body, point in zip((spring.first, spring.second), points, strict=True)
            )
            line = two.point - one.point
            length = np.linalg.norm(line, axis=-1)
            along = line / np.maximum(length, np.finfo(float).tiny)[..., None]
            rate = np.sum(along * (two.velocity - one.velocity), axis=-1)
            extension = length - np.clip(length, rest[..., 0], rest[..., 1])
            tension = stiffness * extension + damping * rate
            row = np.einsum("...i,...ij->...j", along, two.point_rows - one.point_rows)
            total -= tension[..., None] * row
        return total

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


def _solved(mass: Array, force: Array) -> Array:
    """Return the accelerations (..., n) for mass matrices (..., n, n) and forces; parts without mass rest."""
    try:
        return np.asarray(np.linalg.solve(mass, force[..., None])[..., 0])
    except np.linalg.LinAlgError:  # several coordinates together move no mass
        return apply(np.linalg.pinv(mass, rcond=MASSLESS, hermitian=True), force)
