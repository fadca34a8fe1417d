"""Directions nearest to the sun that a face can have which turns about one axis only."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from crosscheck.solar.place import Sun
from newton_euler import Axis, Scene, solve_poses
from newton_euler.equations.redundancy import mobility

MIN_ELEVATION = 1e-9
"""Least elevation, rad, of a direction by day: the rules of tracking take lower ones for night."""


TRIED = np.array([[0.0, 0.0, 1.0], [0.3, 0.0, 1.0], [0.0, 0.3, 1.0], [-0.3, -0.3, 1.0]])
"""Directions, of any length, of the poses in which the turns of the face are examined."""

MIN_TURN = 1e-6
"""Smallest rate of the face about a second axis, per unit motion of the mechanism, that is no round-off."""


def turns_about_one_axis(scene: Scene, axis: Axis) -> bool:
    """Return True if the face of a mechanism can only turn in a plane, for example the bucket of an arm.

    This holds for mechanisms with one degree of freedom, and for planar ones with several.
    """
    if mobility(scene).degrees_of_freedom == 1:
        return True
    poses = solve_poses(scene, axis=axis, towards=TRIED, measure=[law.key for law in scene.control])
    return bool(np.max(poses.independence([axis])) < MIN_TURN)


def aim_of(scene: Scene, axis: Axis, sun: Sun) -> Sun:
    """Return the directions that the face of a tracker is to have, as positions of a sun.

    They are those of the sun itself, unless the face turns about one axis only. Rules of tracking then
    apply to the direction that is nearest to the sun. For an axis that is horizontal, these are the rules of
    rows that turn about it.

    Args:
        scene: the tracker.
        axis: normal of the face as an axis of a body.
        sun: positions of the sun.
    """
    up = np.flatnonzero(sun.is_up)
    if not len(up) or not turns_about_one_axis(scene, axis):
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
