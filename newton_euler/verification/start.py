"""Start of a scene against the start that a file states, next to which its loops are closed."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from newton_euler.assemble import initial_state
from newton_euler.equations.dense import least_squares
from newton_euler.scalars import Array
from newton_euler.verification.figure import Figure, figure
from newton_euler.verification.original import ROUND_OFF
from newton_euler.verification.placed import Placed
from newton_euler.verification.quantities import Freedom

TIMES = 10.0
"""Offsets of loops, times the condition, by which closed starts may differ: each reader weighs rows that
contradict each other its own way."""


def start_figures(placed: Placed) -> Iterator[Figure]:
    """Loops of the file, pose and velocities at the scene's start."""
    original, place = placed.original, placed.places[0]
    free, limit = place.sample.freedom, place.sample.tolerance
    closest, opened = original.open
    of_rows, of_motions = _components(opened.jacobian)
    offsets = np.zeros(len(of_rows) + len(of_motions))
    np.maximum.at(offsets, of_rows, np.abs(closest.residual))
    limits = limit + TIMES * offsets * free.condition
    if len(of_rows):
        gaps, names = np.abs(opened.residual), opened.owners
        yield figure("loops open at the start, sizes or rad", gaps, limits[of_rows], names)
    away = np.abs(original.difference(original.closest, original.start)) / original.units
    yield figure("start, sizes or rad", away, limits[of_motions], original.motions)
    state = initial_state(placed.scene)
    reached = placed.of_parts(np.hstack([state.linear_velocity, state.angular_velocity]).ravel())
    rows = place.of_parts / placed.part_units[:, None] * original.units
    own = least_squares(rows, reached)
    stated = original.stated[1] / original.units
    wanted = _nearest(stated, rows, free, original.units)
    scale = max(1.0, float(np.max(np.abs(stated), initial=0.0)))
    yield figure(
        "velocities at the start, rel",
        np.abs(own - wanted) / scale,
        place.sample.tolerance_of_motion,
        original.motions,
    )


def _components(jacobian: Array) -> tuple[Array, Array]:
    """Label the connected component of each row (k,) and each velocity (nv,) of constraints (k, nv)."""
    from scipy.sparse.csgraph import connected_components

    count, total = len(jacobian), sum(jacobian.shape)
    graph = np.zeros((total, total))
    graph[:count, count:] = np.abs(jacobian) > ROUND_OFF
    _, labels = connected_components(graph, directed=False)
    return labels[:count], labels[count:]


def _nearest(stated: Array, rows: Array, free: Freedom, units: Array) -> Array:
    """Velocities (nv,) that constraints let be, at which bodies move nearest to those that are stated."""
    basis = free.basis * units[free.rows] / units[:, None]
    metric = np.tile(np.repeat([1.0, 0.5], 3), len(rows) // 6)[:, None] * rows  # Euler parameters turn half
    return np.asarray(basis @ least_squares(metric @ basis, metric @ stated))
