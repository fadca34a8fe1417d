"""Measure points, angles and velocities of bodies in a run, for comparison with reference values.

A run is a `Trajectory`: poses and velocities of all bodies at n output times.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from newton_euler.model.euler_parameters import rotations
from newton_euler.model.trajectory import Trajectory
from newton_euler.scalars import Array

Quantity = Callable[[Trajectory], Array]
"""Function that measures a scalar quantity of a run: (n,) values at its output times, SI."""

Quantities = Mapping[str, Quantity]
"""Quantities by the names that files of reference values give them."""


def position(run: Trajectory, body: str, offset: Array) -> Array:
    """Return world positions (n, 3), m, of a point of a body.

    Args:
        run: the run.
        body: name of the body.
        offset: vector to the point from the center of mass (3,), body frame, m.
    """
    index = run.body_names.index(body)
    return np.asarray(run.position[:, index] + rotations(run.quaternion[:, index]) @ offset)


def velocity(run: Trajectory, body: str, offset: Array) -> Array:
    """Return world velocities (n, 3), m/s, of a point of a body; arguments as of `position`."""
    assert run.linear_velocity is not None
    assert run.angular_velocity is not None
    index = run.body_names.index(body)
    arm = rotations(run.quaternion[:, index]) @ offset
    return np.asarray(run.linear_velocity[:, index] + np.cross(run.angular_velocity[:, index], arm))


def angular_velocity(run: Trajectory, body: str) -> Array:
    """Return angular velocities (n, 3) of a body, world frame, rad/s."""
    assert run.angular_velocity is not None
    return run.angular_velocity[:, run.body_names.index(body)]


def spin(run: Trajectory, body: str) -> Array:
    """Return angular velocities (n, 3) of a body, body frame, rad/s."""
    rotation = rotations(run.quaternion[:, run.body_names.index(body)])
    return np.einsum("nij,ni->nj", rotation, angular_velocity(run, body))


def quaternion(run: Trajectory, body: str) -> Array:
    """Return orientations (n, 4) of a body, (w, x, y, z); a run has signs that are continuous over time."""
    return run.quaternion[:, run.body_names.index(body)]


def angle(run: Trajectory, body: str, axis: Array) -> Array:
    """Return the rotation angle (n,) of a body about a fixed axis, rad, with revolutions.

    The body starts parallel to the world, turns about this axis only, and by less than pi between outputs.

    Args:
        run: the run.
        body: name of the body.
        axis: unit vector (3,), world frame.
    """
    p = quaternion(run, body)
    return np.asarray(2.0 * np.unwrap(np.arctan2(p[:, 1:] @ axis, p[:, 0])))


def components(names: tuple[str, ...], vector: Callable[[Trajectory], Array]) -> dict[str, Quantity]:
    """Split the function of a vector into one quantity for each component.

    Args:
        names: names of the components.
        vector: function that measures an array (n, len(names)) of a run.
    """

    def component(k: int) -> Quantity:
        """Return the function that measures column k."""
        return lambda run: vector(run)[:, k]

    return {name: component(k) for k, name in enumerate(names)}
