"""Workspace of a mechanism over chosen joint coordinates, and the singular configurations that bound it.

`Configurations` are n vectors of joint coordinates; a `Chain` is the mechanism with its chosen coordinates.
The tangent space at a configuration has the f velocities that leave its loops closed, where f is the number
of degrees of freedom. `Configurations.phi` are the residuals of the loops. An assembly branch is a set of
configurations that the mechanism can reach from each other without passing a singular configuration.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any

import numpy as np

from newton_euler.analysis.kinematics.configurations import Axis, Chain, Configurations, Goal, products
from newton_euler.analysis.kinematics.continuation import (
    DIFFERENCE_STEP,
    MAX_RESIDUAL,
    RANDOM_STEPS,
    follow,
    largest,
    moved_closed,
    newton,
    random_coordinates,
)
from newton_euler.analysis.kinematics.point import Point, body_index, conditioning, directions, rates
from newton_euler.analysis.kinematics.poses import (
    Poses,
    chain_of,
    coordinate_values,
    goals_of,
    needed_goals,
    poses_of,
)
from newton_euler.arguments import Range, checked
from newton_euler.errors import OptionError
from newton_euler.model.joint import Key
from newton_euler.model.scene import Scene
from newton_euler.model.state import State
from newton_euler.scalars import Array

MAX_POSES = 1_000_000
"""Largest number of points of a grid, or of random configurations. Each pose takes some kB of memory."""

SINGULAR_STEPS = 30
"""Number of Newton's steps from a closed configuration to a singular one."""

MIN_SQUARED_SLOPE = 1e-9
"""Smallest squared slope of the determinant by which a Newton step is divided."""


@dataclass(frozen=True, eq=False)
class Workspace:
    """Poses on a grid of joint coordinates, on one assembly branch.

    Attributes:
        grid: values (n_1,), (n_2,), ... of each coordinate, m or rad.
        reachable: (n_1, n_2, ...) True where there is a pose of the branch.
        poses: poses at the reachable points of the grid, in the order of `numpy.flatnonzero(reachable)`.
            `Poses.beyond` is True for poses whose path from the start passes a configuration in which loops
            lose rank: there the mechanism can change to another branch. No path passes a configuration in
            which the coordinates do not determine the motion.
        driving: (n_1, n_2, ...) `Poses.independence` of the coordinates: a dimensionless measure of the
            distance to singular configurations, in which the coordinates do not determine the motion. 0 at
            such a configuration; NaN at points that are not reachable.
        pointing: the same for the axis, 0 where some motions do not turn the axis; None without an axis.
        elevation, azimuth: (n_1, n_2, ...) rad, angle of the axis above the plane of the world's x and y, and
            angle in this plane from x to y; NaN at points that are not reachable; None without an axis.
        position: (n_1, n_2, ..., 3) m, world position of the point; NaN at points of the grid that are not
            reachable; None without a point.
        conditioning: (n_1, n_2, ...) conditioning of the velocity of the point with respect to the rates of
            the coordinates, dimensionless: the smallest singular value of the Jacobian, divided by the
            largest. 0 where a direction has no motion, 1 where the point moves alike in all directions.
            Slides count in sizes of the mechanism, angles in rad. NaN and None as for `position`.
        directions: (r, 3) orthonormal directions in which the point moves anywhere on the grid: the world
            axes x and z for a point that moves in their plane. None without a point.

    Examples:
        >>> found: Workspace = workspace(load("slider_crank"), {"pivot": np.linspace(-3.0, 3.0, 7)})
        >>> found.reachable.all(), found.driving.shape
        (np.True_, (7,))
    """

    grid: Mapping[str | Key, Array]
    reachable: Array
    poses: Poses
    driving: Array
    pointing: Array | None
    elevation: Array | None
    azimuth: Array | None
    position: Array | None = None
    conditioning: Array | None = None
    directions: Array | None = None

    def __repr__(self) -> str:
        names = ", ".join(map(str, self.grid))
        return f"<Workspace over {names}: {np.sum(self.reachable)} of {self.reachable.size} reachable>"


@checked
def workspace(
    scene: Scene,
    grid: Mapping[str | Key, Any],
    axis: Axis | None = None,
    start: State | None = None,
    point: Point | None = None,
) -> Workspace:
    """Map the poses of a mechanism over a grid of joint coordinates.

    Singular configurations in which the coordinates do not determine the motion bound the reachable part of
    the grid (second kind of C. Gosselin, J. Angeles, IEEE Transactions on Robotics and Automation 6(3),
    1990).

    Args:
        scene: gives the mechanism and the start.
        grid: values of each coordinate, m or rad from the initial pose, by name of the joint, or by (name,
            number) for joints of several coordinates. There must be as many coordinates as degrees of
            freedom, and at most 1,000,000 points. They replace prescribed motions of the scene; other
            motions hold their values at time 0.
        axis: axis of a body, whose directions are mapped.
        start: pose on the assembly branch that is mapped; the scene's initial state if None.
        point: point of a body, whose positions are mapped.

    Raises:
        OptionError: for more or fewer coordinates.
        UnknownNameError: for an unknown joint or body.
        MechanismError: for values that are not finite, and for a point of the ground.

    Examples:
        >>> heights, normal = np.linspace(-0.02, 0.05, 8), Axis("panel_7", [0, 0, 1])
        >>> found = workspace(load("tracker"), {"slide_12": heights, "slide_13": heights}, normal)
        >>> print(found.reachable.sum(), found.driving[4, 4].round(3))
        49 0.561
        >>> tip, ends = Point("bucket", [8.34, 0.0, -0.1]), np.array([-0.3, 0.5])
        >>> cylinders = "boom_cylinder", "stick_cylinder", "bucket_cylinder"
        >>> reach = workspace(load("excavator"), {name: ends for name in cylinders}, point=tip)
        >>> print(reach.directions, np.max(reach.poses.positions(tip)[:, 0]).round(2))
        [[1. 0. 0.]
         [0. 0. 1.]] 9.2
    """
    # all points of the grid, as goals: coordinates only, without a direction for the axis (`towards`) and
    # without other coordinates to return (`measure`)
    axis_values = {name: np.atleast_1d(coordinate_values(scene, name, given)) for name, given in grid.items()}
    if (points := math.prod(map(len, axis_values.values()))) > MAX_POSES:
        raise OptionError("grid", f"{points} points", f"at most {MAX_POSES}")
    mesh = np.meshgrid(*axis_values.values(), indexing="ij") if axis_values else []
    coordinates = dict(zip(axis_values, (each.ravel() for each in mesh), strict=True))
    if point is not None:
        body_index(scene.mechanism, point)  # check the name of the body first
    chain, names, goal = goals_of(scene, coordinates, axis, towards=None, measure=(), start=start)
    _check_count(chain)
    # poses of the reachable points
    configs, reached, beyond = follow(chain.at(chain.start[None]), goal)
    every = np.ones(int(np.sum(reached)), dtype=bool)
    solved = configs[reached]
    poses = poses_of(solved, goal[reached], names, reached=every, beyond=beyond[reached])

    def on_grid(values: Array) -> Array:
        """Put values (n, ...) of the reachable points on the grid; NaN elsewhere."""
        filled = np.full((len(reached), *values.shape[1:]), np.nan)
        filled[reached] = values
        return filled.reshape(mesh[0].shape + values.shape[1:])

    pointing = elevation = azimuth = None
    if poses.direction is not None and axis is not None:
        x, y, z = poses.direction.T
        pointing = on_grid(poses.independence([axis]))
        elevation, azimuth = on_grid(np.arcsin(np.clip(z, -1.0, 1.0))), on_grid(np.arctan2(y, x))
    position = condition = moves = None
    if point is not None:
        velocities, coordinate_rates = (
            rates(solved, point),
            solved.coordinate_jacobian @ np.swapaxes(solved.tangent, 1, 2),
        )
        moves = directions(velocities)
        position = on_grid(poses.positions(point))
        condition = on_grid(conditioning(velocities, coordinate_rates, len(moves)))
    return Workspace(
        grid=axis_values,
        reachable=reached.reshape(mesh[0].shape),
        poses=poses,
        driving=on_grid(poses.independence(names)),
        pointing=pointing,
        elevation=elevation,
        azimuth=azimuth,
        position=position,
        conditioning=condition,
        directions=moves,
    )


@checked
def singular_poses(
    scene: Scene,
    coordinates: Sequence[str | Key],
    count: Annotated[int, Range(1, MAX_POSES)] = 1000,
    axis: Axis | None = None,
) -> Poses:
    """Find configurations of any branch in which joint coordinates do not determine the motion.

    Newton's method starts at random closed configurations and moves along the steepest change of the
    determinant of the coordinates' Jacobian.

    Args:
        scene: gives the mechanism.
        coordinates: joint coordinates, as many as degrees of freedom, by name of the joint, or by (name,
            number) for joints of several coordinates.
        count: number of random configurations, 1 to 1,000,000.
        axis: axis of a body, whose directions are returned, too.

    Returns:
        The singular poses found, fewer than `count`. Their `coordinates` are points of singular curves.

    Raises:
        OptionError: for more or fewer coordinates, and for an impossible count.
        UnknownNameError: for an unknown joint.

    Examples:
        >>> # dead centers of the slider: both ends of its stroke, on either side of the crank
        >>> ends = singular_poses(load("slider_crank"), ["guide"], 50).coordinates["guide"]
        >>> print(np.unique(ends.round(6)))
        [-0.49016  -0.384952 -0.015048  0.09016 ]
    """
    # prescribed motions of the chosen coordinates are left out, so that the coordinates can move
    keys = [scene.mechanism.coordinate(name) for name in coordinates]
    moving = replace(scene, motions=tuple(motion for motion in scene.motions if motion.key not in keys))
    chain = chain_of(moving, coordinates, goal_count=0, axis=axis, has_axis_goal=False, start=None)
    _check_count(chain)
    # random closed configurations
    q = random_coordinates(chain, count, np.random.default_rng(0))
    configs, closed = newton(chain.at(q), _no_goals(count), RANDOM_STEPS)
    # `values` of configurations are results of the chain's compiled function: coordinates, residuals, poses
    configs, singular_results = configs[closed], [np.zeros((0, chain.function.outputs))]
    # Newton's steps to a determinant of zero
    for _ in range(SINGULAR_STEPS):
        determinant, slope = _determinant(configs)
        is_singular = (np.abs(determinant) < MAX_RESIDUAL) & (largest(configs.phi) < MAX_RESIDUAL)
        singular_results.append(configs.values[is_singular])
        configs, determinant, slope = configs[~is_singular], determinant[~is_singular], slope[~is_singular]
        squared_slope = np.maximum(np.sum(slope**2, axis=1, keepdims=True), MIN_SQUARED_SLOPE)
        along = -determinant[:, None] * slope / squared_slope
        configs = moved_closed(configs, products(np.swapaxes(configs.tangent, 1, 2), along))
    singular = Configurations(chain, np.concatenate(singular_results))
    every = np.ones(len(singular), dtype=bool)  # without a start, no pose is beyond a singular configuration
    return poses_of(singular, _no_goals(len(singular)), tuple(coordinates), reached=every, beyond=~every)


def _check_count(chain: Chain) -> None:
    """Raise `OptionError` unless the chosen coordinates are as many as degrees of freedom."""
    if len(chain.keys) != chain.freedoms:
        raise OptionError("number of coordinates", len(chain.keys), needed_goals(chain))


def _no_goals(count: int) -> Goal:
    """Return empty goals for a number of configurations."""
    return Goal(np.zeros((count, 0)), np.zeros((count, 0)))


def _determinant(configs: Configurations) -> tuple[Array, Array]:
    """Compute the determinant (n,) of the chosen coordinates' Jacobian in the tangent space, and its slope.

    The slope (n, f) along the basis vectors of the tangent space is a central difference. The basis of
    another configuration may have the other orientation, which changes the sign of the determinant.
    `configs.driving` (n, f, nv) is the Jacobian of the chosen coordinates with respect to the nv velocities,
    and `configs.tangent` (n, f, nv) has the basis vectors as rows.
    """
    determinant, columns = np.linalg.det(configs.coordinate_jacobian @ np.swapaxes(configs.tangent, 1, 2)), []
    for k in range(configs.chain.freedoms):
        ends = []  # determinants on both sides
        for sign in (1.0, -1.0):
            other = configs.step_by(sign * DIFFERENCE_STEP * configs.tangent[:, k])
            orientation = np.sign(np.linalg.det(other.tangent @ np.swapaxes(configs.tangent, 1, 2)))
            ends.append(
                orientation * np.linalg.det(other.coordinate_jacobian @ np.swapaxes(other.tangent, 1, 2))
            )
        columns.append((ends[0] - ends[1]) / (2.0 * DIFFERENCE_STEP))
    return determinant, np.stack(columns, axis=1)
