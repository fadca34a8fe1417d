"""State of a robot in which its bodies are where those of another robot are.

In: equations of two robots, their `Alignment`, and states of the first robot. Out: the coordinates and
velocities of the second robot.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from crosscheck.differences.alignment import Alignment
from crosscheck.differences.dynamics import Dynamics
from crosscheck.differences.joint_tree import SCALAR
from crosscheck.differences.vectors import Equations, apply, cross, rotation_vector
from newton_euler.scalars import Array

PLACE_WEIGHT = 1e-3
"""Weight of a place, in lengths of the robot, against an angle in rad, where joints cannot reach both."""

MAX_STEPS = 30
"""Gauss-Newton steps to move a body to a pose."""

SMALL_STEP = 1e-9
"""Change of a coordinate, rad or m, at which these steps end: the next one is about its square."""


def is_paired(dynamics: Dynamics, joints: Sequence[tuple[int, int]]) -> Array:
    """Return (coordinates,) whether each coordinate belongs to joints, by indices of body and joint."""
    paired = np.zeros(dynamics.size, bool)
    for key in joints:
        if key in dynamics.at:
            paired[dynamics.at[key]] = True
    return paired


def carry_over(
    alignment: Alignment, first: Dynamics, second: Dynamics, coordinates: Array, velocities: Array
) -> tuple[Array, Array]:
    """Return the state of the second robot in which its joints are where those of the first are.

    Joints without partner are in the pose of the file and do not move.

    Args:
        alignment: pairs of bodies and joints.
        first, second: equations of each robot.
        coordinates, velocities: (robots, states, coordinates) of the first robot.

    Returns:
        (robots, states, coordinates of the second robot) coordinates and velocities.
    """
    found = second.zero[:1] + np.zeros((*coordinates.shape[:2], 1))
    rates = np.zeros(found.shape)
    others = [(group.first, group.second) for group in alignment.groups]
    for pair in alignment.joints:
        if pair.first not in first.at or pair.second not in second.at:
            continue
        if first.robot.joint(pair.first).kind in SCALAR and second.robot.joint(pair.second).kind in SCALAR:
            at, to = first.at[pair.first], second.at[pair.second]
            found[..., to] = pair.sense * coordinates[..., at] + pair.offset
            rates[..., to] = pair.sense * velocities[..., at]
        else:
            others.append(((pair.first,), (pair.second,)))
    # balls, free joints, and groups of joints such as three hinges for a ball: move the body of the second
    # robot from where it is to where it should be, from the root outwards
    moving = first.kinematics(coordinates, velocities)
    placements = {(pair.first[0], pair.second[0]): pair.placement for pair in alignment.bodies}
    for own, other in sorted(others, key=lambda each: each[1]):
        bodies = own[-1][0], other[-1][0]
        columns = np.flatnonzero(is_paired(second, other))
        if bodies in placements and len(columns):
            goal = _Goal(
                moving.position[..., bodies[0], :]
                + moving.rotation[..., bodies[0], :, :] @ placements[bodies].position,
                moving.rotation[..., bodies[0], :, :] @ placements[bodies].rotation,
                moving.twist[..., bodies[0], :],
            )
            found, rates = _moved_to(goal, second, bodies[1], columns, found, rates)
    return found, rates


class _Goal(NamedTuple):
    """Pose and twist that a body should have, with the axes robots and states."""

    position: Array
    rotation: Array
    twist: Array


def _moved_to(
    goal: _Goal, robot: Dynamics, body: int, columns: Array, coordinates: Array, velocities: Array
) -> tuple[Array, Array]:
    """Return coordinates and velocities at which a body has a pose and a twist.

    Args:
        goal: pose and twist of the body.
        robot: equations of the robot.
        body: index of the body.
        columns: indices of the coordinates that move.
        coordinates, velocities: (robots, states, coordinates) before.
    """
    # a rotation counts more than a place that the joint cannot reach
    weights = np.repeat([1.0, PLACE_WEIGHT / robot.length], 3)
    scale = robot.scale[columns]
    for _ in range(MAX_STEPS):
        now = robot.kinematics(coordinates, np.zeros(coordinates.shape))
        turn, place = now.rotation[..., body, :, :], now.position[..., body, :]
        tilt = apply(turn, rotation_vector(np.swapaxes(turn, -1, -2) @ goal.rotation))
        error = np.concatenate([tilt, goal.position - place], axis=-1)
        twists = now.columns[..., columns, :]
        at_body = np.concatenate(
            [twists[..., :3], twists[..., 3:] + cross(twists[..., :3], place[..., None, :])], axis=-1
        )
        step = np.zeros(coordinates.shape)
        matrix = np.swapaxes(at_body * weights, -1, -2) * scale
        step[..., columns] = scale * Equations(matrix).solution(weights * error)
        coordinates = robot.moved(coordinates, step)
        if np.abs(step).max() < SMALL_STEP:
            break
    now = robot.kinematics(coordinates, velocities)
    missing = goal.twist - now.twist[..., body, :]
    # twists count at the body
    missing[..., 3:] += cross(missing[..., :3], now.position[..., body, :])
    velocities = velocities.copy()
    velocities[..., columns] += scale * Equations(matrix).solution(weights * missing)
    return coordinates, velocities
