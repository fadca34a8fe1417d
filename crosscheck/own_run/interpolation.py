"""Runs at other times, at chosen outputs and of chosen bodies, to compare a log with a reference solution."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from newton_euler.model.trajectory import Trajectory
from newton_euler.scalars import Array

TIME_TOLERANCE = 1e-9
"""Largest difference of two equal output times, s: above round-off, below any time step."""

SAME_TIME = 1e-5
"""Largest distance of a time from an output, as a fraction of the output period, that is round-off."""


def interpolated(run: Trajectory, times: Array) -> Trajectory:
    """Return a run with velocities at other times, s, by cubic polynomials of poses and their rates.

    Energies and velocities are interpolated linearly; work and joint angles are left out. If all times are
    output times within `SAME_TIME`, the result has the numbers of these outputs instead.

    Args:
        run: a run from 0 s with evenly spaced outputs.
        times: (n,) within the run.
    """
    last = len(run.time) - 1
    spacing = float(run.time[1] - run.time[0])
    nearest = np.clip(np.rint(times / spacing), 0, last).astype(int)
    if np.all(np.abs(times - run.time[nearest]) <= SAME_TIME * spacing):
        return at_outputs(run, nearest)
    left = np.clip(np.searchsorted(run.time, times, side="right") - 1, 0, last - 1)
    h = run.time[left + 1] - run.time[left]
    s = (times - run.time[left]) / h

    def between(values: Array, slopes: Array | None = None) -> Array:
        """Interpolate values (n, ...), with their slopes if given."""
        shape = (-1,) + (1,) * (values.ndim - 1)
        x, step = s.reshape(shape), h.reshape(shape)
        if slopes is None:
            return np.asarray((1.0 - x) * values[left] + x * values[left + 1])
        ends = (1.0 + 2.0 * x) * (1.0 - x) ** 2 * values[left] + x**2 * (3.0 - 2.0 * x) * values[left + 1]
        rates = x * (1.0 - x) ** 2 * slopes[left] - x**2 * (1.0 - x) * slopes[left + 1]
        return np.asarray(ends + step * rates)

    assert run.linear_velocity is not None
    assert run.angular_velocity is not None
    quaternion = between(run.quaternion, quaternion_rates(run.quaternion, run.angular_velocity))
    changed: dict[str, Any] = {
        name: None if (values := getattr(run, name)) is None else between(values)
        for name in ("kinetic_energy", "potential_energy", "linear_velocity", "angular_velocity")
    }
    changed["position"] = between(run.position, run.linear_velocity)
    changed["quaternion"] = quaternion / np.linalg.norm(quaternion, axis=-1, keepdims=True)
    changed |= {"time": times, "work": None, "angle_names": (), "joint_angle": None}
    return replace(run, **changed)


def quaternion_rates(quaternion: Array, omega: Array) -> Array:
    """Return rates (..., 4) of quaternions (..., 4) at angular velocities (..., 3), rad/s, world frame."""
    e0, e = quaternion[..., :1], quaternion[..., 1:]
    scalar = -0.5 * np.sum(e * omega, axis=-1, keepdims=True)
    return np.concatenate([scalar, 0.5 * (e0 * omega + np.cross(omega, e))], axis=-1)


def at_outputs(run: Trajectory, outputs: Array) -> Trajectory:
    """Return a run at the outputs of these indices; arrays of names stay unchanged."""
    chosen: dict[str, Any] = {
        name: values[outputs] for name, values in run.arrays().items() if values.dtype.kind == "f"
    }
    return replace(run, **chosen)


def common_outputs(one: Trajectory, two: Trajectory) -> tuple[Trajectory, Trajectory]:
    """Return two runs at the output times that both have; times within `TIME_TOLERANCE` are equal."""
    last = len(two.time) - 1
    nearest = np.minimum(np.searchsorted(two.time, one.time - TIME_TOLERANCE), last)
    common = np.abs(two.time[nearest] - one.time) < TIME_TOLERANCE
    return at_outputs(one, np.flatnonzero(common)), at_outputs(two, nearest[common])


def of_bodies(run: Trajectory, names: Sequence[str]) -> Trajectory:
    """Return the poses of some bodies, with the energies of all."""
    places = [run.body_names.index(name) for name in names]
    return replace(
        run,
        body_names=tuple(names),
        position=run.position[:, places],
        quaternion=run.quaternion[:, places],
        linear_velocity=None,
        angular_velocity=None,
        mechanism=None,
    )


def without_energies(run: Trajectory) -> Trajectory:
    """Return a run without energies."""
    return replace(run, kinetic_energy=None, potential_energy=None)
