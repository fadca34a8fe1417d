"""Shapes of bodies (box, sphere, cylinder, capsule, mesh) and their mass properties as homogeneous solids.

Viewers draw the shapes, and exported model files contain them. A shape determines the mass and inertia of a
body only if the body is constructed by `Body.solid`. All coordinates are in m, world frame, at the
mechanism's initial pose. Moments of inertia of homogeneous solids are those of Meriam and Kraige, Engineering
Mechanics: Dynamics, table D/4. The decorator `description` makes frozen dataclasses. Their array fields
(`ArrayField`, `IndexField`) accept anything that NumPy converts to an array.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cached_property
from typing import NamedTuple

import numpy as np

from newton_euler.errors import (
    MechanismError,
    finite_array,
    is_finite_number,
    quoted,
    real_array,
    set_finite_arrays,
)
from newton_euler.model.description import ArrayField, IndexField, description
from newton_euler.model.euler_parameters import rotation
from newton_euler.scalars import Floats

UNIT_TOLERANCE = 1e-9
"""Largest allowed difference of the norm of a quaternion from 1."""


class Inertia(NamedTuple):
    """Mass properties of a rigid body or of a part of one, world frame at the initial pose.

    Attributes:
        mass: kg.
        center_of_mass: (3,) m.
        inertia: (3, 3) inertia tensor about the center of mass, kg m^2.
    """

    mass: float
    center_of_mass: Floats
    inertia: Floats

    def checked(self, shape: str) -> Inertia:
        """Return these mass properties if they are valid.

        Args:
            shape: name of the kind of shape, such as "box", for the error message.

        Raises:
            MechanismError: unless mass and moments of inertia are positive and all numbers are finite.
        """
        if not 0.0 < self.mass < math.inf:
            needed = "lengths and a density that give a positive, finite mass"
            raise MechanismError(shape, f"mass is {self.mass:.6g} kg", needed)
        # A number that is not finite anywhere in the tensor makes all its moments invalid
        is_finite = np.isfinite(self.inertia).all()
        for moment in np.diag(self.inertia) if is_finite else [math.inf]:
            if not 0.0 < moment < math.inf:
                needed = "lengths and a density that give positive, finite moments"
                raise MechanismError(shape, f"moment of inertia is {moment:.6g} kg m^2", needed)
        if not np.all(np.isfinite(self.center_of_mass)):
            problem = f"center of mass is {self.center_of_mass.tolist()}"
            raise MechanismError(shape, problem, "finite coordinates")
        return self

    def scaled(self, factor: float) -> Inertia:
        """Return the mass properties of the same body with its density multiplied by a factor."""
        with np.errstate(all="ignore"):  # `checked` refuses what overflows
            return Inertia(factor * self.mass, self.center_of_mass, factor * self.inertia).checked("solids")


def total_inertia(parts: Sequence[Inertia]) -> Inertia:
    """Combine the mass properties of parts of one rigid body, with the parallel axis theorem for the
    inertia."""
    masses, centers = np.array([part.mass for part in parts]), [part.center_of_mass for part in parts]
    with np.errstate(all="ignore"):  # `checked` refuses what overflows
        mass = float(masses.sum())
        center, inertia = masses @ centers / mass, np.zeros((3, 3))
        for part in parts:
            arm = part.center_of_mass - center
            inertia += part.inertia
            inertia += part.mass * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    return Inertia(mass, center, inertia).checked("solids")


def _check_radius(shape: str, radius: float) -> None:
    """Raise `MechanismError` unless a finite radius, m, is positive; `shape` is its name in the message."""
    if radius <= 0.0:
        raise MechanismError(shape, f"radius is {radius}", "a positive length")


class Homogeneous:
    """Base class of shapes that have mass properties as a homogeneous solid."""

    @property
    def noun(self) -> str:
        """Name of the kind of shape in error messages."""
        return type(self).__name__.lower()

    def inertia(self, density: float) -> Inertia:
        """Compute the mass properties of the solid for a density in kg/m^3.

        Raises:
            MechanismError: for a density that is not positive, and for results that overflow.
        """
        if not is_finite_number(density) or density <= 0.0:
            raise MechanismError(self.noun, f"density is {quoted(density)}", "a positive number of kg/m^3")
        with np.errstate(all="ignore"):  # `checked` refuses what overflows
            return self._mass_properties(density).checked(self.noun)

    def _mass_properties(self, density: float) -> Inertia:
        """Compute the mass properties for a valid density, kg/m^3, without checks of the result."""
        raise NotImplementedError


@description
class Box(Homogeneous):
    """A box with any orientation.

    Attributes:
        half_sizes: (3,) half of the edge lengths, m.
        center: (3,) m, world frame at the initial pose.
        quaternion: (4,) orientation of the edges, (w, x, y, z), world frame at the initial pose.

    Raises:
        MechanismError: naming the invalid attribute.

    Examples:
        >>> round(Box([0.5, 0.1, 0.1], center=[0.0, 0.0, 1.0]).inertia(density=1000.0).mass, 6)
        40.0
    """

    half_sizes: ArrayField
    center: ArrayField
    quaternion: ArrayField = (1.0, 0.0, 0.0, 0.0)  # type: ignore[assignment]

    def __post_init__(self) -> None:
        set_finite_arrays(self, "box", half_sizes=(3,), center=(3,), quaternion=(4,))
        if np.any(self.half_sizes <= 0.0):
            raise MechanismError("box", f"half_sizes is {self.half_sizes.tolist()}", "three positive lengths")
        norm = float(np.linalg.norm(self.quaternion))
        if abs(norm - 1.0) > UNIT_TOLERANCE:
            raise MechanismError("box", f"quaternion has norm {norm:.9g}", "a unit quaternion, w-x-y-z")

    def _mass_properties(self, density: float) -> Inertia:
        mass = 8.0 * density * math.prod(self.half_sizes.tolist())
        squares, axes = self.half_sizes**2, rotation(self.quaternion)
        moments = mass / 3.0 * (squares.sum() - squares)
        return Inertia(mass, self.center, axes @ np.diag(moments) @ axes.T)


@description
class Sphere(Homogeneous):
    """A solid sphere.

    Attributes:
        center: (3,) m, world frame at the initial pose.
        radius: m.

    Raises:
        MechanismError: naming the invalid attribute.

    Examples:
        >>> round(Sphere([0.0, 0.0, 0.0], radius=0.1).inertia(density=1000.0).mass, 6)
        4.18879
    """

    center: ArrayField
    radius: float

    def __post_init__(self) -> None:
        set_finite_arrays(self, "sphere", center=(3,), radius=())  # () converts to a float
        _check_radius("sphere", self.radius)

    def _mass_properties(self, density: float) -> Inertia:
        square = self.radius * self.radius
        mass = 4.0 / 3.0 * math.pi * density * square * self.radius
        return Inertia(mass, self.center, 0.4 * mass * square * np.eye(3))


@description
class _Bar(Homogeneous):
    """Base class of round bars.

    Attributes:
        start, end: (3,) points on the axis of the bar, m: the ends of its cylindrical part.
        radius: m.
    """

    start: ArrayField
    end: ArrayField
    radius: float

    def __post_init__(self) -> None:
        set_finite_arrays(self, self.noun, start=(3,), end=(3,), radius=())
        _check_radius(self.noun, self.radius)

    @property
    def length(self) -> float:
        """Distance from `start` to `end`, m."""
        return math.dist(self.start, self.end)

    def _axisymmetric(self, mass: float, axial: float, transverse: float) -> Inertia:
        """Return the mass properties of the bar.

        Args:
            mass: kg.
            axial: moment of inertia about the axis of the bar, kg m^2.
            transverse: moment of inertia about an axis through the center of mass perpendicular to the axis
                of the bar, kg m^2.
        """
        along = (self.end - self.start) / (self.length or 1.0)  # zeros for a capsule that is a sphere
        inertia = transverse * np.eye(3) + (axial - transverse) * np.outer(along, along)
        return Inertia(mass, 0.5 * (self.start + self.end), inertia)


@description
class Cylinder(_Bar):
    """A round bar with flat ends.

    Attributes:
        start, end: (3,) centers of the two end faces, m, world frame at the initial pose.
        radius: m.

    Raises:
        MechanismError: naming the invalid attribute.

    Examples:
        >>> rod = Cylinder([0.0, 0.0, 0.0], [1.0, 0.0, 0.0], radius=0.01)
        >>> round(rod.inertia(density=7800.0).mass, 6)
        2.450442
    """

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.length == 0.0:
            raise MechanismError("cylinder", "start and end are one point", "two ends")

    def _mass_properties(self, density: float) -> Inertia:
        square = self.radius * self.radius
        mass = math.pi * density * square * self.length
        transverse = mass * (3.0 * square + self.length * self.length) / 12.0
        return self._axisymmetric(mass, 0.5 * mass * square, transverse)


@description
class Capsule(_Bar):
    """A round bar with a hemisphere at each end.

    Attributes:
        start, end: (3,) centers of the two hemispheres, m, world frame at the initial pose.
        radius: m.

    Raises:
        MechanismError: naming the invalid attribute.

    Examples:
        >>> bar = Capsule([0.0, 0.0, 0.0], [1.0, 0.0, 0.0], radius=0.01)
        >>> round(bar.inertia(density=7800.0).mass, 6)
        2.483115
    """

    def _mass_properties(self, density: float) -> Inertia:
        square, length = self.radius * self.radius, self.length
        # masses of the cylinder between the centers, and of the two hemispheres together
        bar, ball = math.pi * density * square * length, 4.0 / 3.0 * math.pi * density * square * self.radius
        axial = (0.5 * bar + 0.4 * ball) * square
        transverse = bar * (3.0 * square + length * length) / 12.0
        # parallel axis theorem; the center of mass of a hemisphere is 3/8 of the radius beyond its center
        transverse += ball * (0.4 * square + 0.25 * length * length + 0.375 * length * self.radius)
        return self._axisymmetric(bar + ball, axial, transverse)


Shape = Box | Capsule | Cylinder | Sphere
"""Shapes that a few numbers describe, as opposed to meshes; MJCF and URDF have shapes of the same kinds."""


@description
class Mesh(Homogeneous):
    """A surface of triangles.

    Attributes:
        vertices: (n, 3) corner points, m, world frame at the initial pose.
        triangles: (m, 3) indices of three `vertices` for each triangle, counterclockwise as seen from the
            outer side.
        color: red, green, blue and opacity, from 0 to 1; None if the viewer chooses.

    Raises:
        MechanismError: naming the invalid attribute.

    Examples:
        >>> faces = [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]
        >>> tetrahedron = Mesh([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], faces)
        >>> round(tetrahedron.inertia(density=6000.0).mass, 6)
        1000.0
    """

    vertices: ArrayField
    triangles: IndexField
    color: tuple[float, float, float, float] | None = None

    def __post_init__(self) -> None:
        # Check the shapes and ranges of the arrays
        vertices, triangles = self._array("vertices"), self._array("triangles")
        if vertices.ndim != 2 or vertices.shape[1] != 3 or not np.all(np.isfinite(vertices)):
            raise MechanismError("mesh", f"vertices of shape {vertices.shape}", "(n, 3) finite numbers")
        if triangles.ndim != 2 or triangles.shape[1] != 3:
            raise MechanismError("mesh", f"triangles of shape {triangles.shape}", "(m, 3) rows of vertices")
        if np.any(triangles != np.floor(triangles)):
            raise MechanismError("mesh", "triangles has fractions", "whole numbers, rows of vertices")
        if triangles.size and not 0 <= triangles.min() <= triangles.max() < len(vertices):
            problem = f"triangles name vertices {triangles.min():.12g} to {triangles.max():.12g}"
            raise MechanismError("mesh", problem, f"0 to {len(vertices) - 1}")
        if self.color is not None:
            color = finite_array("mesh", "color", self.color, (4,))
            if np.any((color < 0.0) | (color > 1.0)):
                raise MechanismError("mesh", f"color is {self.color}", "four numbers from 0 to 1")
            object.__setattr__(self, "color", tuple(color.tolist()))

        # Store read-only arrays
        for name, value in (("vertices", vertices), ("triangles", triangles.astype(np.int32))):
            value.flags.writeable = False
            object.__setattr__(self, name, value)

    @cached_property
    def bounds(self) -> tuple[Floats, Floats]:
        """Smallest and largest coordinates (3,) of the vertices, m: the corners of the bounding box."""
        return self.vertices.min(axis=0), self.vertices.max(axis=0)

    def _array(self, name: str) -> Floats:
        """Convert an attribute to an array of floats; raises `MechanismError` for anything but numbers."""
        value = getattr(self, name)
        try:
            return real_array(value)
        except (TypeError, ValueError, OverflowError) as error:
            raise MechanismError("mesh", f"{name} is {quoted(value)}", "rows of three numbers") from error

    def _mass_properties(self, density: float) -> Inertia:
        """Compute the mass properties of the solid that the triangles enclose.

        By the divergence theorem, an integral over the solid is the sum of integrals over tetrahedra between
        an origin and the triangles. A tetrahedron counts as negative if the origin is on the outer side of
        its triangle. With corners a, b, c of the triangle and s = a + b + c, a tetrahedron has the volume V =
        a . (b x c) / 6, the first moment V s / 4, and the second moments V (a a^T + b b^T + c c^T + s s^T) /
        20. Source: Tonon, Explicit Exact Formulas for the 3-D Tetrahedron Inertia Tensor, J. Math. Stat. 1,
        2004.

        Raises:
            MechanismError: for triangles that do not enclose a solid, or that are clockwise as seen from the
                outer side.
        """
        self._check_closed()
        # The origin of the tetrahedra is near the solid, to limit the cancellation of digits
        origin = self.vertices.mean(axis=0)
        corners = (self.vertices - origin)[self.triangles]
        volumes, sums = np.linalg.det(corners) / 6.0, corners.sum(axis=1)
        volume = float(volumes.sum())
        if not volume > 0.0:
            needed = "a positive volume, its triangles counterclockwise seen from outside"
            raise MechanismError("mesh", f"encloses {volume:.6g} m^3", needed)
        center = volumes @ sums / (4.0 * volume)
        # Sum the second moments about the origin (n: triangles, k: corners), then refer them to the center
        second = np.einsum("n,nki,nkj", volumes, corners, corners) + np.einsum("n,ni,nj", volumes, sums, sums)
        second = second / 20.0 - volume * np.outer(center, center)
        inertia = density * (np.trace(second) * np.eye(3) - second)
        return Inertia(density * volume, origin + center, 0.5 * (inertia + inertia.T))

    def _check_closed(self) -> None:
        """Raise `MechanismError` unless the surface is closed and consistently oriented.

        On such a surface the triangles pass each edge equally often in both directions.
        """
        # Give vertices at the same place the same number, because mesh files repeat vertices
        _, unique_vertex = np.unique(self.vertices, axis=0, return_inverse=True)
        corners = unique_vertex.reshape(-1)[self.triangles]

        # Sum the directions (1 or -1) in which triangles pass each edge; edges between two vertices at the
        # same place do not count
        edges = np.concatenate([corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [2, 0]]])
        direction = np.where(edges[:, 0] < edges[:, 1], 1, -1)
        _, edge = np.unique(np.sort(edges, axis=1), axis=0, return_inverse=True)
        balance = np.bincount(edge.reshape(-1), np.where(edges[:, 0] == edges[:, 1], 0, direction))
        if not len(edges) or np.any(balance):
            problem = f"{np.count_nonzero(balance)} edges are not between two triangles of one orientation"
            raise MechanismError("mesh", problem if len(edges) else "no triangles", "a closed surface")


Solid = Shape | Mesh
"""Shapes that have mass properties; a mesh only if it is closed."""
