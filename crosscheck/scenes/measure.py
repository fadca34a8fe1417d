"""Points and angles of bodies over the output times of a run, for figures of scenes."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from newton_euler.model.euler_parameters import rotations
from newton_euler.model.trajectory import Trajectory
from newton_euler.scalars import Array

Quantity = Callable[[Trajectory], Array]
"""A measured quantity (n,) at the output times of a run; SI."""

Quantities = Mapping[str, Quantity]
"""Quantities by the names that reference files give them."""


def position(run: Trajectory, body: str, offset: Array) -> Array:
    """(n, 3) m, world: the point that lies at `offset` (3,) m from the center of mass in the body frame."""
    index = run.body_names.index(body)
    return np.asarray(run.position[:, index] + rotations(run.quaternion[:, index]) @ offset)


def velocity(run: Trajectory, body: str, offset: Array) -> Array:
    """(n, 3) m/s, world: of the same point."""
    assert run.linear_velocity is not None
    assert run.angular_velocity is not None
    index = run.body_names.index(body)
    arm = rotations(run.quaternion[:, index]) @ offset
    return np.asarray(run.linear_velocity[:, index] + np.cross(run.angular_velocity[:, index], arm))


def angular_velocity(run: Trajectory, body: str) -> Array:
    """(n, 3) rad/s, world."""
    assert run.angular_velocity is not None
    return run.angular_velocity[:, run.body_names.index(body)]


def spin(run: Trajectory, body: str) -> Array:
    """(n, 3) rad/s: angular velocity in the body frame."""
    turns = rotations(run.quaternion[:, run.body_names.index(body)])
    return np.einsum("nij,ni->nj", turns, angular_velocity(run, body))


def quaternion(run: Trajectory, body: str) -> Array:
    """(n, 4) w-x-y-z, continuous in sign."""
    return run.quaternion[:, run.body_names.index(body)]


def angle(run: Trajectory, body: str, axis: Array) -> Array:
    """(n,) rad, whole turns counted: how far a body has turned about a fixed axis, (3,) unit.

    For a body whose frame is parallel to the world at first, and that turns about this axis only, less
    than pi between two outputs.
    """
    p = quaternion(run, body)
    return np.asarray(2.0 * np.unwrap(np.arctan2(p[:, 1:] @ axis, p[:, 0])))


def components(names: tuple[str, ...], vector: Quantity) -> dict[str, Quantity]:
    """One figure for each component of a measured (n, len(names)) array."""

    def component(k: int) -> Quantity:
        return lambda run: vector(run)[:, k]

    return {name: component(k) for k, name in enumerate(names)}
