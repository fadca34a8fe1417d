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
from newton_euler.model.mechanism import Mechanism
from newton_euler.model.scene import Scene

Side = Annotated[float, Between(0.02, 1.0, "m")]
"""Type of the options `panel_width` and `panel_height`."""

Mass = Annotated[float, Between(0.01, 50.0, "kg")]
"""Type of the option `panel_mass`."""

WIDTH, HEIGHT, MASS = 2.0 * PANEL[0], 2.0 * PANEL[1], float(MASSES[6])
"""Sides of the paper's panel, m, along the first and the second axis of its body frame, and its mass, kg."""


def with_panel(scene: Scene, width: float, height: float, mass: float) -> Scene:
    """Return a scene of the tracker with a panel of another size and mass.

    The panel becomes a uniform plate with its center of mass where it was. The paper's panel keeps the
    inertia of the paper, which is within 5 % that of such a plate.

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
    squares = half_sizes**2
    other = replace(
        panel,
        mass=mass,
        # about an axis, a box has the mass times the squares of both half sides across the axis, over 3
        inertia=np.diag(mass / 3.0 * (squares.sum() - squares)),
        shapes=(replace(plate, half_sizes=half_sizes), *arms),
        meshes=(solar_cells(panel.center_of_mass, panel.quaternion, (half_sizes[0], half_sizes[1])),),
    )
    bodies = [other if body is panel else body for body in scene.mechanism.bodies]
    return replace(scene, mechanism=Mechanism(bodies, scene.mechanism.joints))
