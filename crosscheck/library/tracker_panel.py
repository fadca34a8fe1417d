"""Panel of the solar tracker: size and mass, which are options of scenes.

The paper's panel (`crosscheck.library.tracker`) is a plate of 0.14 m by 0.11 m with a mass of 0.89 kg.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated

import numpy as np

from crosscheck.library.options import Between
from crosscheck.library.tracker import MASSES, PANEL, solar_cells
from newton_euler.model.geometry import Box
from newton_euler.model.mechanism import Body, Mechanism
from newton_euler.model.scene import Scene
from newton_euler.scalars import Array

Side = Annotated[float, Between(0.02, 1.0, "m")]
"""Type of the options `panel_width` and `panel_height`."""

Mass = Annotated[float, Between(0.01, 50.0, "kg")]
"""Type of the option `panel_mass`."""

WIDTH, HEIGHT, MASS = 2.0 * PANEL[0], 2.0 * PANEL[1], float(MASSES[6])
"""Sides of the paper's panel, m, along the first and the second axis of its body frame, and its mass, kg."""


def with_panel(scene: Scene, width: float, height: float, mass: float) -> Scene:
    """Return a scene of the tracker with a panel of another size and mass.

    The center of mass stays where it was. A panel of another mass alone has the paper's inertia, times the
    ratio of the masses. The paper's inertia is not that of a uniform plate: a moment in the plane is 35 %
    more, the other 17 % less, and there is a product of inertia. A larger panel has the inertia of a uniform
    plate plus this difference, which does not grow with the sides. On a smaller panel the difference shrinks
    with the sides, so that the inertia is possible for all sizes.

    Args:
        scene: the tracker.
        width, height: sides, m, along the first and the second axis of the panel's body frame.
        mass: kg.
    """
    if (width, height, mass) == (WIDTH, HEIGHT, MASS):
        return scene
    panel = scene.mechanism.body("panel_7")
    plate, *arms = panel.shapes
    assert isinstance(plate, Box)
    half_sizes = np.array([0.5 * width, 0.5 * height, plate.half_sizes[2]])
    other = replace(
        panel,
        mass=mass,
        inertia=_inertia(panel, plate, half_sizes, mass),
        shapes=(replace(plate, half_sizes=half_sizes), *arms),
        meshes=(solar_cells(panel.center_of_mass, panel.quaternion, (half_sizes[0], half_sizes[1])),),
    )
    bodies = [other if body is panel else body for body in scene.mechanism.bodies]
    return replace(scene, mechanism=Mechanism(bodies, scene.mechanism.joints))


def _inertia(panel: Body, plate: Box, half_sizes: Array, mass: float) -> Array:
    """Compute the inertia (3, 3), kg m^2, of a panel of another size and mass about its center of mass.

    Args:
        panel: the paper's panel.
        plate: its shape.
        half_sizes: (3,) half sides of the other panel, m.
        mass: mass of the other panel, kg.
    """
    # second moments of mass, int r r^T dm: those of a box are the mass times the squares of the half sides,
    # over 3, and every positive definite matrix is possible
    paper = 0.5 * np.trace(panel.inertia) * np.eye(3) - panel.inertia
    difference = paper / panel.mass - np.diag(plate.half_sizes**2 / 3.0)
    shrink = np.diag(np.minimum(half_sizes / plate.half_sizes, 1.0))
    moments = mass * (np.diag(half_sizes**2 / 3.0) + shrink @ difference @ shrink)
    return np.trace(moments) * np.eye(3) - moments
