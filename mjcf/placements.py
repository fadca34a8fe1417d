"""Placements of MuJoCo's elements, and sites as places of a model file."""

from __future__ import annotations

import mujoco
import numpy as np

from newton_euler.reading.robot import FilePlace, PlaceKind, Placement
from newton_euler.scalars import Array


def rotation_of(quaternion: Array) -> Array:
    """Return the rotation matrix (3, 3) of a quaternion (w, x, y, z)."""
    matrix = np.zeros(9)
    mujoco.mju_quat2Mat(matrix, quaternion)
    return matrix.reshape(3, 3)


def site_placement(model: mujoco.MjModel, number: int) -> Placement:
    """Return the placement of a site in the frame of its body."""
    return Placement(model.site_pos[number].copy(), rotation_of(model.site_quat[number]))


def site_place(model: mujoco.MjModel, number: int, kind: PlaceKind) -> FilePlace:
    """Return a site as a place; `kind` is what counts of its frame."""
    return FilePlace(kind, int(model.site_bodyid[number]) - 1, site_placement(model, number))
