"""Workspace of a mechanism over chosen joint coordinates, and the singular configurations that bound it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np

from newton_euler.analysis.kinematics.configurations import Axis, Chain, Configurations, Goal, products
from newton_euler.analysis.kinematics.continuation import (
    DIFFERENCE_STEP,
    MAX_RESIDUAL,
    MIN_CURVATURE,
    RANDOM_STEPS,
    follow,
    largest,
    moved_closed,
    newton,
    random_coordinates,
)
from newton_euler.analysis.kinematics.poses import Poses, chain_of, coordinate_values, goals_of, poses_of
from newton_euler.arguments import Range, checked
from newton_euler.errors import OptionError
from newton_euler.model.joint import Key
from newton_euler.model.scene import Scene
from newton_euler.model.state import State
from newton_euler.scalars import Array

MAX_POSES = 1_000_000
"""Number of points of a grid, or of random configurations. Each pose takes some kB of memory."""

SINGULAR_STEPS = 30
"""Number of Newton's steps from a closed configuration to a singular one."""


@dataclass(frozen=True, eq=False)
class Workspace:
    """Poses on a grid of joint coordinates, on one assembly branch.

    Attributes:
        grid: values (n_1,), (n_2,), ... of each coordinate, m or rad.
        reachable: (n_1, n_2, ...) True where there is a pose of the branch.
        poses: those of the reachable points of the grid, in the order of `numpy.flatnonzero(reachable)`.
        driving: (n_1, n_2, ...) distance to singular configurations in which the coordinates do not
            determine the motion: `Poses.independence` of these, 0 at one; not a number out of reach.
        pointing: the same of the axis, in which some motions do not turn it; None without an axis.
        elevation, azimuth: (n_1, n_2, ...) of the axis above the plane of the world's x and y, and in this
            plane from x to y, rad; not a number out of reach; None without an axis.

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

    def __repr__(self) -> str:
        names = ", ".join(map(str, self.grid))
        return f"<Workspace over {names}: {np.sum(self.reachable)} of {self.reachable.size} reachable>"


@checked
def workspace(
    scene: Scene, grid: Mapping[str | Key, Any], axis: Axis | None = None, start: State | None = None
) -> Workspace:
    """Map the poses of a mechanism over a grid of joint coordinates.

    Singular configurations are classified by C. Gosselin, J. Angeles, IEEE Transactions on Robotics and
    Automation 6(3), 1990: singular configurations of the second kind bound the reachable part of the grid.

    Args:
        scene: gives the mechanism and the start.
        grid: values of each coordinate, as of `solve_poses`; as many coordinates as degrees of freedom, and
            at most `MAX_POSES` points.
        axis: of a body, whose directions are mapped.
        start: pose on the assembly branch that is mapped; the scene's own if None.

    Raises:
        OptionError: for more or fewer coordinates.
        UnknownNameError: for an unknown joint or body.
        MechanismError: for values that are no finite numbers.

    Examples:
        >>> heights, normal = np.linspace(-0.02, 0.05, 8), Axis("panel_7", [0, 0, 1])
        >>> found = workspace(load("tracker"), {"slide_12": heights, "slide_13": heights}, normal)
        >>> print(found.reachable.sum(), found.driving[4, 4].round(3))
        49 0.561
    """
    single = {name: np.atleast_1d(coordinate_values(scene, name, given)) for name, given in grid.items()}
    if (points := math.prod(map(len, single.values()))) > MAX_POSES:
        raise OptionError("grid", f"{points} points", f"at most {MAX_POSES}")
    mesh = np.meshgrid(*single.values(), indexing="ij") if single else []
    flat = dict(zip(single, (each.ravel() for each in mesh), strict=True))
    chain, names, goal = goals_of(scene, flat, axis, None, (), start)
    _check_count(chain)
    at, reached = follow(chain.at(chain.start[None]), goal)
    count = int(np.sum(reached))
    poses = poses_of(at[reached], goal[reached], names, np.ones(count, bool), np.zeros(count, bool))

    def spread(values: Array) -> Array:
        """Put values of the reachable points on the grid; not a number elsewhere."""
        filled = np.full(len(reached), np.nan)
        filled[reached] = values
        return filled.reshape(mesh[0].shape)

    pointing = elevation = azimuth = None
    if poses.direction is not None and axis is not None:
        x, y, z = poses.direction.T
        pointing = spread(poses.independence([axis]))
        elevation, azimuth = spread(np.arcsin(np.clip(z, -1.0, 1.0))), spread(np.arctan2(y, x))
    driving = spread(poses.independence(names))
    return Workspace(single, reached.reshape(mesh[0].shape), poses, driving, pointing, elevation, azimuth)


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
        coordinates: joint coordinates, as many as degrees of freedom.
        count: number of random configurations, 1 to `MAX_POSES`.
        axis: of a body, whose directions are asked for.

    Returns:
        The singular poses found, fewer than `count`. Their `coordinates` are points of singular curves.

    Raises:
        OptionError: for more or fewer coordinates, and for an impossible count.
        UnknownNameError: for an unknown joint.

    Examples:
        >>> ends = singular_poses(load("slider_crank"), ["guide"], 50).coordinates["guide"]
        >>> print(np.unique(ends.round(6)))
        [-0.49016  -0.384952 -0.015048  0.09016 ]
    """
    chain = chain_of(scene, coordinates, 0, axis, False, None)
    _check_count(chain)
    # random closed configurations
    q = random_coordinates(chain, count, np.random.default_rng(0))
    at, closed = newton(chain.at(q), _no_goals(count), RANDOM_STEPS)
    at, met = at[closed], [np.zeros((0, chain.function.outputs))]
    # Newton's steps to a determinant of zero
    for _ in range(SINGULAR_STEPS):
        value, slope = _determinant(at)
        is_singular = (np.abs(value) < MAX_RESIDUAL) & (largest(at.phi) < MAX_RESIDUAL)
        met.append(at.values[is_singular])
        at, value, slope = at[~is_singular], value[~is_singular], slope[~is_singular]
        along = -value[:, None] * slope / np.maximum(np.sum(slope**2, axis=1, keepdims=True), MIN_CURVATURE)
        at = moved_closed(at, products(np.swapaxes(at.tangent, 1, 2), along))
    found = Configurations(chain, np.concatenate(met))
    every = np.ones(len(found), dtype=bool)
    return poses_of(found, _no_goals(len(found)), tuple(coordinates), every, ~every)


def _check_count(chain: Chain) -> None:
    """Raise `OptionError` unless the chosen coordinates are as many as degrees of freedom."""
    if len(chain.keys) != chain.freedoms:
        needed = f"as many as degrees of freedom, {chain.freedoms}"
        raise OptionError("number of coordinates", len(chain.keys), needed)


def _no_goals(count: int) -> Goal:
    """Return empty goals for a number of configurations."""
    return Goal(np.zeros((count, 0)), np.zeros((count, 0)))


def _determinant(at: Configurations) -> tuple[Array, Array]:
    """Compute the determinant (n,) of the chosen coordinates' Jacobian in the tangent space, and its slope.

    The slope (n, f) along the tangents is a central difference.
    """
    value, columns = np.linalg.det(at.driving @ np.swapaxes(at.tangent, 1, 2)), []
    for k in range(at.chain.freedoms):
        ends = []
        for sign in (1.0, -1.0):
            other = at.step_by(sign * DIFFERENCE_STEP * at.tangent[:, k])
            turned = np.sign(np.linalg.det(other.tangent @ np.swapaxes(at.tangent, 1, 2)))
            ends.append(turned * np.linalg.det(other.driving @ np.swapaxes(other.tangent, 1, 2)))
        columns.append((ends[0] - ends[1]) / (2.0 * DIFFERENCE_STEP))
    return value, np.stack(columns, axis=1)
