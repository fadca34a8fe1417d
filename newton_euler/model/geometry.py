"""Shapes of bodies, and the inertia that they have if they are homogeneous solids.

Viewers and model files draw shapes; a body has their inertia only if it is made of them, see `Body.solid`.
All coordinates are in the world at the mechanism's initial pose, meters, like those of joints. Moments of
inertia of homogeneous solids are those of Meriam and Kraige, Engineering Mechanics: Dynamics, table D/4.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cached_property
from typing import NamedTuple

import numpy as np

from newton_euler.errors import MechanismError, finite_array, is_finite_number, quoted, real_array, set_arrays
from newton_euler.model.description import ArrayField, IndexField, description
from newton_euler.model.euler_parameters import rotation
from newton_euler.scalars import Floats

UNIT_TOLERANCE = 1e-9  # how far from 1 the norm of a quaternion may be


class Inertia(NamedTuple):
    """Mass properties of a rigid body, world axes.

    Attributes:
        mass: kg.
        center_of_mass: (3,) m.
        inertia: (3, 3) about the center of mass, kg m^2.
    """

    mass: float
    center_of_mass: Floats
    inertia: Floats

    def checked(self, shape: str) -> Inertia:
        """Return itself; raises `MechanismError` unless mass and moments are positive, and all is finite."""
        needed = "lengths and a density of a positive, finite"
        if not 0.0 < self.mass < math.inf:
            raise MechanismError(shape, f"mass is {self.mass:.6g} kg", f"{needed} mass")
        moments = [value if np.isfinite(self.inertia).all() else math.inf for value in np.diag(self.inertia)]
        for value in moments:
            if not 0.0 < value < math.inf:
                raise MechanismError(shape, f"moment of inertia is {value:.6g} kg m^2", f"{needed} one")
        if not np.all(np.isfinite(self.center_of_mass)):
            found = f"center of mass is {self.center_of_mass.tolist()}"
            raise MechanismError(shape, found, "a place that a double holds")
        return self

    def scaled(self, factor: float) -> Inertia:
        """Return the same of a body that is so many times as dense."""
        with np.errstate(all="ignore"):  # numbers are checked
            return Inertia(factor * self.mass, self.center_of_mass, factor * self.inertia).checked("solids")


def total(parts: Sequence[Inertia]) -> Inertia:
    """Add up the mass properties of parts that move together."""
    masses, centers = np.array([part.mass for part in parts]), [part.center_of_mass for part in parts]
    with np.errstate(all="ignore"):  # numbers are checked
        mass = float(masses.sum())
        center, inertia = masses @ centers / mass, np.zeros((3, 3))
        for part in parts:
            arm = part.center_of_mass - center
            inertia += part.inertia
            inertia += part.mass * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    return Inertia(mass, center, inertia).checked("solids")


def _check_radius(shape: str, radius: float) -> None:
    if radius <= 0.0:
        raise MechanismError(shape, f"radius is {radius}", "a positive length")


class Homogeneous:
    """A homogeneous solid."""

    @property
    def noun(self) -> str:
        """Its kind, in messages."""
        return type(self).__name__.lower()

    def inertia(self, density: float) -> Inertia:
        """Compute the mass properties of the solid of a density, kg/m^3.

        Raises:
            MechanismError: for a density that is not positive, and what doubles do not hold.
        """
        if not is_finite_number(density) or density <= 0.0:
            raise MechanismError(self.noun, f"density is {quoted(density)}", "a positive number of kg/m^3")
        with np.errstate(all="ignore"):  # numbers are checked
            return self._of_density(density).checked(self.noun)

    def _of_density(self, density: float) -> Inertia:
        """Compute the same of a density that is one."""
        raise NotImplementedError


@description
class Box(Homogeneous):
    """A box of half sizes (3,) along the axes of a frame with the given center and quaternion w-x-y-z.

    Raises:
        MechanismError: naming the attribute at fault.

    Examples:
        >>> round(Box([0.5, 0.1, 0.1], center=[0.0, 0.0, 1.0]).inertia(density=1000.0).mass, 6)
        40.0
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

    def _of_density(self, density: float) -> Inertia:
        mass = 8.0 * density * math.prod(self.half_sizes.tolist())
        squares, axes = self.half_sizes**2, rotation(self.quaternion)
        moments = mass / 3.0 * (squares.sum() - squares)
        return Inertia(mass, self.center, axes @ np.diag(moments) @ axes.T)


@description
class Sphere(Homogeneous):
    """A ball of the given center (3,) and radius.

    Raises:
        MechanismError: naming the attribute at fault.

    Examples:
        >>> round(Sphere([0.0, 0.0, 0.0], radius=0.1).inertia(density=1000.0).mass, 6)
        4.18879
    """

    center: ArrayField
    radius: float

    def __post_init__(self) -> None:
        set_arrays(self, "sphere", center=(3,), radius=())
        _check_radius("sphere", self.radius)

    def _of_density(self, density: float) -> Inertia:
        square = self.radius * self.radius
        mass = 4.0 / 3.0 * math.pi * density * square * self.radius
        return Inertia(mass, self.center, 0.4 * mass * square * np.eye(3))


@description
class _Bar(Homogeneous):
    """A round bar of the given radius from `start` to `end`, (3,) each."""

    start: ArrayField
    end: ArrayField
    radius: float

    def __post_init__(self) -> None:
        set_arrays(self, self.noun, start=(3,), end=(3,), radius=())
        _check_radius(self.noun, self.radius)

    @property
    def length(self) -> float:
        """Distance from `start` to `end`, m."""
        return math.dist(self.start, self.end)

    def _about(self, mass: float, axial: float, transverse: float) -> Inertia:
        """Mass properties with these moments of inertia, kg m^2, along and across the bar."""
        along = (self.end - self.start) / (self.length or 1.0)
        inertia = transverse * np.eye(3) + (axial - transverse) * np.outer(along, along)
        return Inertia(mass, 0.5 * (self.start + self.end), inertia)


@description
class Cylinder(_Bar):
    """A round bar of the given radius with flat ends at `start` and `end`, (3,) each.

    Raises:
        MechanismError: naming the attribute at fault.

    Examples:
        >>> rod = Cylinder([0.0, 0.0, 0.0], [1.0, 0.0, 0.0], radius=0.01)
        >>> round(rod.inertia(density=7800.0).mass, 6)
        2.450442
    """

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.length == 0.0:
            raise MechanismError("cylinder", "start and end are one point", "two ends")

    def _of_density(self, density: float) -> Inertia:
        square = self.radius * self.radius
        mass = math.pi * density * square * self.length
        return self._about(
            mass, 0.5 * mass * square, mass * (3.0 * square + self.length * self.length) / 12.0
        )


@description
class Capsule(_Bar):
    """A round bar of the given radius from `start` to `end`, (3,) each, with half a ball beyond each of them.

    Raises:
        MechanismError: naming the attribute at fault.

    Examples:
        >>> bar = Capsule([0.0, 0.0, 0.0], [1.0, 0.0, 0.0], radius=0.01)
        >>> round(bar.inertia(density=7800.0).mass, 6)
        2.483115
    """

    def _of_density(self, density: float) -> Inertia:
        square, length = self.radius * self.radius, self.length
        bar, ball = math.pi * density * square * length, 4.0 / 3.0 * math.pi * density * square * self.radius
        axial = (0.5 * bar + 0.4 * ball) * square
        transverse = bar * (3.0 * square + length * length) / 12.0
        transverse += ball * (0.4 * square + 0.25 * length * length + 0.375 * length * self.radius)
        return self._about(bar + ball, axial, transverse)


Shape = Box | Capsule | Cylinder | Sphere


@description
class Mesh(Homogeneous):
    """Triangles between points.

    Attributes:
        vertices: (n, 3).
        triangles: (m, 3) rows of `vertices`, counterclockwise seen from outside.
        color: red, green, blue and opacity, from 0 to 1; None for the viewer's choice.

    Raises:
        MechanismError: naming the attribute at fault.

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
        vertices, triangles = self._array("vertices"), self._array("triangles")
        if vertices.ndim != 2 or vertices.shape[1] != 3 or not np.all(np.isfinite(vertices)):
            raise MechanismError("mesh", f"vertices of shape {vertices.shape}", "(n, 3) finite numbers")
        if triangles.ndim != 2 or triangles.shape[1] != 3:
            raise MechanismError("mesh", f"triangles of shape {triangles.shape}", "(m, 3) rows of vertices")
        if np.any(triangles != np.floor(triangles)):
            raise MechanismError("mesh", "triangles has fractions", "whole numbers, rows of vertices")
        if triangles.size and not 0 <= triangles.min() <= triangles.max() < len(vertices):
            found = f"triangles name vertices {triangles.min():.12g} to {triangles.max():.12g}"
            raise MechanismError("mesh", found, f"0 to {len(vertices) - 1}")
        if self.color is not None:
            color = finite_array("mesh", "color", self.color, (4,))
            if np.any((color < 0.0) | (color > 1.0)):
                raise MechanismError("mesh", f"color is {self.color}", "four numbers from 0 to 1")
            object.__setattr__(self, "color", tuple(color.tolist()))
        for name, value in (("vertices", vertices), ("triangles", triangles.astype(np.int32))):
            value.flags.writeable = False
            object.__setattr__(self, name, value)

    @cached_property
    def bounds(self) -> tuple[Floats, Floats]:
        """Lowest and highest coordinates (3,) of the vertices, m."""
        return self.vertices.min(axis=0), self.vertices.max(axis=0)

    def _array(self, name: str) -> Floats:
        """Return an attribute as an array of numbers; raises `MechanismError`."""
        value = getattr(self, name)
        try:
            return real_array(value)
        except (TypeError, ValueError, OverflowError) as error:
            raise MechanismError("mesh", f"{name} is {quoted(value)}", "rows of three numbers") from error

    def _of_density(self, density: float) -> Inertia:
        """Compute the mass properties of the solid that the triangles enclose.

        By the divergence theorem integrals over the solid are sums of those over tetrahedra between an origin
        and the triangles, negative ones where a triangle is seen from inside. With a, b, c its corners and
        s = a + b + c, a tetrahedron has volume V = a . (b x c) / 6, first moment V s / 4 and second moments
        V (a a^T + b b^T + c c^T + s s^T) / 20 (Tonon, Explicit Exact Formulas for the 3-D Tetrahedron Inertia
        Tensor, J. Math. Stat. 1, 2004).

        Raises:
            MechanismError: for triangles that leave holes, or that are clockwise seen from outside.
        """
        self._check_closed()
        origin = self.vertices.mean(axis=0)  # near to the solid, so that little cancels
        corners = (self.vertices - origin)[self.triangles]
        volumes, sums = np.linalg.det(corners) / 6.0, corners.sum(axis=1)
        volume = float(volumes.sum())
        if not volume > 0.0:
            needed = "a positive volume, its triangles counterclockwise seen from outside"
            raise MechanismError("mesh", f"encloses {volume:.6g} m^3", needed)
        center = volumes @ sums / (4.0 * volume)
        second = np.einsum("n,nki,nkj", volumes, corners, corners) + np.einsum("n,ni,nj", volumes, sums, sums)
        second = second / 20.0 - volume * np.outer(center, center)
        inertia = density * (np.trace(second) * np.eye(3) - second)
        return Inertia(density * volume, origin + center, 0.5 * (inertia + inertia.T))

    def _check_closed(self) -> None:
        """Raise `MechanismError` unless triangles pass each edge as often one way as the other."""
        _, same = np.unique(self.vertices, axis=0, return_inverse=True)  # files repeat vertices
        rows = same.reshape(-1)[self.triangles]
        edges = np.concatenate([rows[:, [0, 1]], rows[:, [1, 2]], rows[:, [2, 0]]])
        ways = np.where(edges[:, 0] < edges[:, 1], 1, -1)
        _, number = np.unique(np.sort(edges, axis=1), axis=0, return_inverse=True)
        balance = np.bincount(number.reshape(-1), np.where(edges[:, 0] == edges[:, 1], 0, ways))
        if not len(edges) or np.any(balance):
            found = f"{np.count_nonzero(balance)} edges are not between two triangles of one orientation"
            raise MechanismError("mesh", found if len(edges) else "no triangles", "a closed surface")


Solid = Shape | Mesh  # shapes that have an inertia
