"""Draw the run with the settings of a model file in a recording: a ghost, and its error over time.

The ghost is a transparent copy of the mechanism. The file's run has other output times than the engines. The
ghost is drawn at the times of the first engine's run: at the pose in that run, displaced by the error of the
file's run. The distance of the ghost is the error, without the motion from one output to the next.
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
"""Name of the run with the settings of the file, in the paths and legends of recordings."""

IDENTITY = np.array([1.0, 0.0, 0.0, 0.0])
"""Quaternion of no rotation."""


def displaced(first: Trajectory, judgement: Judgement) -> Trajectory:
    """Return an engine's run displaced by the error of the file's run, as far as both go.

    The error of a body is a displacement of its center of mass and a rotation. Both are interpolated linearly
    between the output times of the file's run.

    Args:
        first: run of an engine.
        judgement: the file's run and the reference solution at the same times.
    """
    run = judgement.run
    reference = judgement.reference.first(len(run.time))
    moved = run.position - reference.position
    turned = continuous(_product(run.quaternion, conjugate(reference.quaternion)), IDENTITY)
    count = int(np.searchsorted(first.time, run.time[-1] * (1.0 + 1e-12), side="right"))
    drawn = first.first(count)
    rotation = _interpolated(turned, run.time, drawn.time)
    rotation /= np.linalg.norm(rotation, axis=-1, keepdims=True)
    return replace(
        drawn,
        position=drawn.position + _interpolated(moved, run.time, drawn.time),
        quaternion=_product(rotation, drawn.quaternion),
    )


def error_plots(judgement: Judgement) -> Iterator[Plot]:
    """Plot the errors of positions and orientations of the file's run over time, largest over the bodies."""
    position, rotation = errors_over_time(judgement.run, judgement.reference)
    group = "error of your settings"
    for name, title, values in (
        ("position", "error of position [m]", position),
        ("rotation", "error of rotation [rad]", rotation),
    ):
        lines = {YOUR_SETTINGS: np.max(values, axis=1)}
        yield Plot(group, (YOUR_SETTINGS, name), title, lines, is_judged=True)


def _product(one: Array, two: Array) -> Array:
    """Return the products (..., 4) of quaternions (..., 4)."""
    return np.moveaxis(product(np.moveaxis(one, -1, 0), np.moveaxis(two, -1, 0)), 0, -1)


def _interpolated(values: Array, times: Array, at: Array) -> Array:
    """Interpolate values (n, ...) at times (n,), s, linearly at other times (m,), s: (m, ...)."""
    if len(times) == 1:
        return np.repeat(values, len(at), axis=0)
    right = np.clip(np.searchsorted(times, at), 1, len(times) - 1)
    weight = np.clip((at - times[right - 1]) / (times[right] - times[right - 1]), 0.0, 1.0)
    weight = weight.reshape(-1, *[1] * (values.ndim - 1))
    return np.asarray((1.0 - weight) * values[right - 1] + weight * values[right])
