"""Poses and motions of the bodies of robots as their files describe them, at many states at once.

In: descriptions of one structure, `newton_euler.reading.robot.Robot`, such as a robot and the same robot with
other numbers, and states. Out: poses, twists and their rates. Twists (angular velocity, velocity of the point
that passes the origin of the world) have components along the axes of the world; see R. Featherstone, Rigid
Body Dynamics Algorithms, 2008, sections 2.2 to 2.10. Arrays begin with the axes (robots, states); the first
one has length 1 where all robots have the same values.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from crosscheck.differences.vectors import (
    apply,
    cross,
    cross_motion,
    rotation_matrix,
    rotation_vector,
    stacked,
)
from newton_euler.reading.robot import JointKind, Robot
from newton_euler.scalars import Array

WIDTHS = {JointKind.HINGE: 1, JointKind.SLIDE: 1, JointKind.BALL: 3, JointKind.FREE: 6}
"""Number of coordinates of a joint of each kind."""

SCALAR = (JointKind.HINGE, JointKind.SLIDE)
"""Joints with one coordinate, on which drives, springs and couplings act."""


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


class JointTree:
    """Bodies of robots that have the same structure and other numbers, moved by the joints of their tree.

    Coordinates are those of the file for hinges and slides, and a rotation vector from the pose of the file
    for a ball. A free joint has the displacement and the rotation vector from the pose of the file, along
    the axes of the body's frame in that pose. Velocities of a ball or free joint have components along the
    axes of the moving body.

    Attributes:
        robot: the first of the robots.
        count: number of robots.
        length: m, unit of lengths in constraint equations, about the size of the robot.
        at: slice of the coordinates of each joint, by indices of body and joint.
        size: number of coordinates.
        is_length: (coordinates,) whether a coordinate is a length, otherwise an angle.
        scale: (coordinates,) 1 for an angle, `length` for a displacement.
        zero: (robots, 1, coordinates) coordinates in the pose of the file.
        owner: (coordinates,) index of the body of each coordinate.
        moves: (bodies + 1, coordinates) whether a coordinate moves a body.
    """

    def __init__(self, robots: Sequence[Robot], length: float) -> None:
        """Number the coordinates, and collect the numbers of joints and placements.

        Args:
            robots: robots of one structure.
            length: m, unit of lengths in constraint equations.
        """
        self.robot, self.count, self.length = robots[0], len(robots), length
        bodies = self.robot.bodies
        self.at: dict[tuple[int, int], slice] = {}
        self.size = 0
        owner: list[int] = []
        is_length: list[bool] = []
        self.moves = np.zeros((len(bodies) + 1, sum(WIDTHS[j.kind] for b in bodies for j in b.joints)), bool)
        # whether a coordinate, column, moves the body before another coordinate, row, does
        self._before = np.zeros((self.moves.shape[1], self.moves.shape[1]))
        for index, body in enumerate(bodies):
            self.moves[index] = self.moves[body.parent]
            for number, joint in enumerate(body.joints):
                width = WIDTHS[joint.kind]
                self.at[index, number] = slice(self.size, self.size + width)
                self._before[self.at[index, number]] = self.moves[index]
                self.moves[index, self.size : self.size + width] = True
                self.size += width
                owner += [index] * width
                is_length += [
                    joint.kind is JointKind.SLIDE or (joint.kind is JointKind.FREE and k < 3)
                    for k in range(width)
                ]
        self.owner = np.array(owner, int)
        self.is_length = np.array(is_length, bool)
        self.scale = np.where(self.is_length, self.length, 1.0)
        self.zero = self.of_joints(robots, "zero")
        self._axis = {key: stacked([r.joint(key).axis for r in robots]) for key in self.at}
        self._point = {key: stacked([r.joint(key).point for r in robots]) for key in self.at}
        self._offset = stacked([[b.placement.position for b in r.bodies] for r in robots])
        self._turn = stacked([[b.placement.rotation for b in r.bodies] for r in robots])

    def of_joints(self, robots: Sequence[Robot], field: str) -> Array:
        """Return (robots, 1, coordinates) the number of a joint, for each of its coordinates."""
        rows = [
            [getattr(joint, field) for b in r.bodies for joint in b.joints for _ in range(WIDTHS[joint.kind])]
            for r in robots
        ]
        return np.array(rows, float).reshape(len(robots), 1, self.size)

    def kinematics(self, coordinates: Array, velocities: Array) -> Kinematics:
        """Return the poses and motions of all bodies.

        Args:
            coordinates, velocities: (robots, states, coordinates).
        """
        states = coordinates.shape[1]
        robots = max(self.count, len(coordinates))
        bodies = len(self.robot.bodies)
        position = np.zeros((robots, states, bodies + 1, 3))
        rotation = np.zeros((robots, states, bodies + 1, 3, 3))
        rotation[..., -1, :, :] = np.eye(3)
        columns = np.zeros((robots, states, self.size, 6))
        displacement = coordinates - self.zero
        turns = self._hinge_turns(displacement)
        for index, body in enumerate(self.robot.bodies):
            above = body.parent
            origin = position[..., above, :] + apply(rotation[..., above, :, :], self._offset[:, :, index])
            turn = rotation[..., above, :, :] @ self._turn[:, :, index]
            for number in range(len(body.joints)):
                at = self.at[index, number]
                origin, turn, columns[..., at, :] = self._after_joint(
                    (index, number), displacement[..., at], turns, origin, turn
                )
            position[..., index, :], rotation[..., index, :, :] = origin, turn
        # twists of each coordinate add up along the tree; each is carried by those before it
        relative = columns * velocities[..., None]
        carried = cross_motion(self._before @ relative, relative)
        moves = self.moves.astype(float)
        return Kinematics(position, rotation, columns, moves @ relative, moves @ carried)

    def _hinge_turns(self, displacement: Array) -> dict[int, Array]:
        """Return (robots, states, 3, 3) the rotation by each hinge, by the index of its coordinate."""
        keys = [key for key in self.at if self.robot.joint(key).kind is JointKind.HINGE]
        if not keys:
            return {}
        axes = np.stack([self._axis[key] for key in keys], axis=-2)
        indices = [self.at[key].start for key in keys]
        turns = rotation_matrix(axes * displacement[..., indices, None])
        return {index: turns[..., number, :, :] for number, index in enumerate(indices)}

    def _after_joint(
        self,
        key: tuple[int, int],
        displacement: Array,
        hinge_turns: Mapping[int, Array],
        origin: Array,
        turn: Array,
    ) -> tuple[Array, Array, Array]:
        """Move a body by one of its joints.

        Args:
            key: indices of its body and of the joint.
            displacement: (robots, states, coordinates of the joint) from the pose of the file.
            hinge_turns: rotations by the hinges, by the index of their coordinate.
            origin, turn: pose of the body before.

        Returns:
            the pose of the body, and (robots, states, coordinates of the joint, 6) twists by unit velocities.
        """
        axis, point, kind = self._axis[key], self._point[key], self.robot.joint(key).kind
        if kind is JointKind.SLIDE:
            direction = apply(turn, axis)
            column = np.concatenate([np.zeros(direction.shape), direction], axis=-1)
            return origin + direction * displacement, turn, column[..., None, :]
        if kind is JointKind.FREE:
            origin = origin + apply(turn, displacement[..., :3])
            turn = turn @ rotation_matrix(displacement[..., 3:])
            axes = np.swapaxes(turn, -1, -2)
            translations = np.concatenate([np.zeros(axes.shape), axes], axis=-1)
            turns = np.concatenate([axes, cross(origin[..., None, :], axes)], axis=-1)
            return origin, turn, np.concatenate([translations, turns], axis=-2)
        anchor = origin + apply(turn, point)
        is_hinge = kind is JointKind.HINGE
        turn = turn @ (hinge_turns[self.at[key].start] if is_hinge else rotation_matrix(displacement))
        axes = apply(turn, axis)[..., None, :] if is_hinge else np.swapaxes(turn, -1, -2)
        column = np.concatenate([axes, cross(anchor[..., None, :], axes)], axis=-1)
        return anchor - apply(turn, point), turn, column

    def moved(self, coordinates: Array, step: Array) -> Array:
        """Return coordinates after a small motion, given as velocities during one second."""
        result = coordinates + step
        for (body, number), at in self.at.items():
            kind = self.robot.joint((body, number)).kind
            if kind in (JointKind.BALL, JointKind.FREE):
                turn = slice(at.stop - 3, at.stop)
                before = rotation_matrix(coordinates[..., turn])
                result[..., turn] = rotation_vector(before @ rotation_matrix(step[..., turn]))
                if kind is JointKind.FREE:
                    place = slice(at.start, at.start + 3)
                    result[..., place] = coordinates[..., place] + apply(before, step[..., place])
        return result


def size_of(robot: Robot) -> float:
    """Return the largest distance of bodies, joints and centers of mass from the first body, m; 1 if zero."""
    placements = robot.placements()
    points = [
        placement.point(point)
        for placement, body in zip(placements, robot.bodies, strict=True)
        for point in (np.zeros(3), body.center, *(joint.point for joint in body.joints))
    ]
    return float(max(np.linalg.norm(point - placements[0].position) for point in points)) or 1.0
