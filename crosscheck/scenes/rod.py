"""The rod that scenes of any size are made of."""

from __future__ import annotations

import numpy as np

from newton_euler.model.mechanism import Body
from newton_euler.scalars import Array

MASS = 1.0
"""kg."""

LENGTH = 1.0
"""m."""

INERTIA = MASS * LENGTH**2 / 12.0
"""About the center of mass across the rod, kg m^2: that of a thin rod."""

AXIAL_INERTIA = 1e-3
"""About the rod itself, kg m^2: that of a solid one 9 cm thick. A line has none, and no rigid body can."""


def rod(name: str, start: Array, axis: Array) -> Body:
    """A rod from `start` (3,) m along a world axis, (3,) unit; its frame is parallel to the world."""
    along = np.outer(axis, axis)
    inertia = INERTIA * (np.eye(3) - along) + AXIAL_INERTIA * along
    return Body(name, MASS, start + 0.5 * LENGTH * axis, inertia)
