"""Directions nearest to the sun that the face of a tracker with one degree of freedom can have."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from crosscheck.solar.place import Sun
from newton_euler import Axis, Scene, solve_poses
from newton_euler.equations.redundancy import mobility

MIN_ELEVATION = 1e-9
"""Least elevation, rad, of a direction by day: the rules of tracking take lower ones for night."""


def aim_of(scene: Scene, axis: Axis, sun: Sun) -> Sun:
    """Return the directions that the face of a tracker is to have, as positions of a sun.

    They are those of the sun itself, unless the mechanism has one degree of freedom. Rules of tracking then
    apply to the direction that is nearest to the sun. For an axis that is horizontal, these are the rules of
    rows that turn about it.

    Args:
        scene: the tracker.
        axis: normal of the face as an axis of a body.
        sun: positions of the sun.
    """
    up = np.flatnonzero(sun.is_up)
    if mobility(scene).degrees_of_freedom != 1 or not len(up):
        return sun
    poses = solve_poses(
        scene, axis=axis, towards=sun.direction[up], measure=[law.key for law in scene.control]
    )
    assert poses.direction is not None
    x, y, z = poses.direction.T
    azimuth, elevation = sun.azimuth.copy(), sun.elevation.copy()
    azimuth[up] = np.arctan2(x, y)
    elevation[up] = np.maximum(np.arctan2(z, np.hypot(x, y)), MIN_ELEVATION)
    return replace(sun, azimuth=azimuth, elevation=elevation)
