"""Shapes of bodies. They carry no mass; viewers and model files draw them.

All coordinates are in the world at the mechanism's initial pose, meters, like those of joints.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from newton_euler.errors import MechanismError, set_arrays
from newton_euler.model.description import ArrayField, description

UNIT_TOLERANCE = 1e-9
"""How far from 1 the norm of a quaternion may be."""


@description
class Box:
    """A box of half sizes (3,) along the axes of a frame with the given center and quaternion w-x-y-z.

    Raises:
        MechanismError: naming the attribute at fault.
    """

    half_sizes: ArrayField
    center: ArrayField
    quaternion: ArrayField = (1.0, 0.0, 0.0, 0.0)  # type: ignore[assignment]

    def __post_init__(self) -> None:
        set_arrays(self, "box", half_sizes=(3,), center=(3,), quaternion=(4,))
        if np.any(self.half_sizes <= 0.0):
            raise MechanismError("box", f"half_sizes is {self.half_sizes.tolist()}", "three positive lengths")
        norm = float(np.linalg.norm(self.quaternion))
        if abs(norm - 1.0) > UNIT_TOLERANCE:
            raise MechanismError("box", f"quaternion has norm {norm:.9g}", "a unit quaternion, w-x-y-z")


@description
class Capsule:
    """A round bar of the given radius from `start` to `end`, (3,) each.

    Raises:
        MechanismError: naming the attribute at fault.
    """

    start: ArrayField
    end: ArrayField
    radius: float

    def __post_init__(self) -> None:
        set_arrays(self, "capsule", start=(3,), end=(3,), radius=())
        if self.radius <= 0.0:
            raise MechanismError("capsule", f"radius is {self.radius}", "a positive length")


Shape = Box | Capsule


@description
class Mesh:
    """Triangles between points.

    Attributes:
        vertices: (n, 3).
        triangles: (m, 3) rows of `vertices`, counterclockwise seen from outside.
        color: red, green, blue and opacity, from 0 to 1; None for the viewer's choice.

    Raises:
        MechanismError: naming the attribute at fault.
    """

    vertices: ArrayField
    triangles: NDArray[np.int32]
    color: tuple[float, float, float, float] | None = None

    def __post_init__(self) -> None:
        vertices, triangles = np.array(self.vertices, dtype=float), np.array(self.triangles, dtype=np.int32)
        if vertices.ndim != 2 or vertices.shape[1] != 3 or not np.all(np.isfinite(vertices)):
            raise MechanismError("mesh", f"vertices of shape {vertices.shape}", "(n, 3) finite numbers")
        if triangles.ndim != 2 or triangles.shape[1] != 3:
            raise MechanismError("mesh", f"triangles of shape {triangles.shape}", "(m, 3) rows of vertices")
        if triangles.size and not 0 <= triangles.min() <= triangles.max() < len(vertices):
            found = f"triangles name vertices {triangles.min()} to {triangles.max()}"
            raise MechanismError("mesh", found, f"0 to {len(vertices) - 1}")
        if self.color is not None and not all(0.0 <= part <= 1.0 for part in self.color):
            raise MechanismError("mesh", f"color is {self.color}", "four numbers from 0 to 1")
        for name, value in (("vertices", vertices), ("triangles", triangles)):
            value.flags.writeable = False
            object.__setattr__(self, name, value)
