"""Draw the "own run" of a model file in a recording for the Rerun viewer: a ghost, and its error over time.

The own run is the run that the file's engine (such as MuJoCo for an MJCF) makes with the settings of the
file. Its error is the difference from a reference solution at the same times. The ghost is a transparent copy
of the mechanism. The own run has other output times than the runs of the compared engines. The ghost is
therefore drawn at the times of the first engine's run: at the pose in that run, displaced by the error of the
own run. The distance of the ghost from the first engine's bodies is the error.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from crosscheck.own_run.errors import errors_over_time
from crosscheck.own_run.judge import Judgement
from crosscheck.recording.plots import Plot
from newton_euler.model.euler_parameters import conjugate, continuous, product
from newton_euler.model.trajectory import Trajectory
from newton_euler.scalars import Array

YOUR_SETTINGS = "your_settings"
"""Name of the own run in recordings: in legends, and in the paths of their entities."""

IDENTITY = np.array([1.0, 0.0, 0.0, 0.0])
"""Quaternion of no rotation."""


def displaced(first: Trajectory, judgement: Judgement) -> Trajectory:
    """Return an engine's run displaced by the error of the own run, until the first of both runs ends.

    The error of a body is a displacement of its center of mass and a rotation. Both are interpolated linearly
    between the output times of the own run.

    Args:
        first: run of an engine.
        judgement: the own run and the reference solution at the same times.
    """
    run = judgement.run
    reference = judgement.reference.first(len(run.time))
    position_error = run.position - reference.position
    # quaternions of the rotations from the reference to the run, without jumps of sign
    rotation_error = continuous(_product(run.quaternion, conjugate(reference.quaternion)), IDENTITY)
    # outputs of the engine until the own run ends; 1 + 1e-12 allows for round-off of the last time
    count = int(np.searchsorted(first.time, run.time[-1] * (1.0 + 1e-12), side="right"))
    drawn = first.first(count)
    rotation = _interpolated(rotation_error, run.time, drawn.time)
    rotation /= np.linalg.norm(rotation, axis=-1, keepdims=True)
    return replace(
        drawn,
        position=drawn.position + _interpolated(position_error, run.time, drawn.time),
        quaternion=_product(rotation, drawn.quaternion),
    )


def error_plots(judgement: Judgement, group: str, path: tuple[str, ...]) -> Iterator[Plot]:
    """Plot the errors of positions and orientations of a judged run over time, largest over the bodies.

    Args:
        judgement: the run, such as the own run, and the reference solution at the same times.
        group: name of the group of plots.
        path: path of the plots; its last part is the name of the lines.
    """
    position, rotation = errors_over_time(judgement.run, judgement.reference)
    for name, title, values in (
        ("position", "error of position [m]", position),
        ("rotation", "error of rotation [rad]", rotation),
    ):
        lines = {path[-1]: np.max(values, axis=1)}
        # `is_judged`: an error, which is plotted even if constant, rather than a quantity of the motion
        yield Plot(group, path=(*path, name), title=title, lines=lines, is_judged=True)


def _product(one: Array, two: Array) -> Array:
    """Return the products (..., 4) of quaternions (..., 4)."""
    return np.moveaxis(product(np.moveaxis(one, -1, 0), np.moveaxis(two, -1, 0)), 0, -1)


def _interpolated(values: Array, times: Array, new_times: Array) -> Array:
    """Interpolate values (n, ...) at times (n,), s, linearly to new times (m,), s; returns (m, ...)."""
    if len(times) == 1:
        return np.repeat(values, len(new_times), axis=0)
    right = np.clip(np.searchsorted(times, new_times), 1, len(times) - 1)
    weight = np.clip((new_times - times[right - 1]) / (times[right] - times[right - 1]), 0.0, 1.0)
    weight = weight.reshape(-1, *[1] * (values.ndim - 1))
    return np.asarray((1.0 - weight) * values[right - 1] + weight * values[right])
