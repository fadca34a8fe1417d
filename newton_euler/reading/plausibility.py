"""Find likely mistakes in an imported model file, such as an inertia in wrong units.

Each rule compares mass properties of a body with the geometry of the body, with the mechanism, or with the
*twin* of the body: the body on the other side, such as `right_arm` for `left_arm`. The limits of the rules
were chosen so that no intended value in public robot models is a finding.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import assert_never

import numpy as np

from newton_euler.errors import listed
from newton_euler.model.euler_parameters import rotation
from newton_euler.model.geometry import Box, Capsule, Cylinder, Mesh, Shape, Sphere
from newton_euler.model.mechanism import REALISABLE_TOLERANCE, Body, Mechanism
from newton_euler.reading.import_report import Finding, Mistake
from newton_euler.scalars import Array

MAX_GYRATION = 2.0
"""Largest radius of gyration, divided by the extent of the body (largest distance of geometry and joints from
the center of mass). All mass inside the extent gives at most 1; the file may have geometry for a part of the
body only."""

MIN_GYRATION = 0.005
"""Smallest radius of gyration, divided by half the longest side of the geometry; a thin bar has 0.6."""

MAX_GYRATION_OF_MECHANISM = 2.0
"""Largest radius of gyration, divided by the size of the mechanism, for bodies without geometry."""

MAX_CENTER_DISTANCE = 3.0
"""Largest distance of a center of mass from the box around geometry and joints, in diagonals of the box."""

MAX_DENSITY = 30_000.0
"""Largest density in the box around the geometry, kg/m^3; the densest metal has 22,600."""

MIN_MASS_SHARE = 1e-6
"""Smallest mass, as a fraction of the heaviest body."""

MAX_TWIN_DIFFERENCE = 0.02
"""Largest relative difference of masses, moments of inertia and centers of mass of twins."""

UNIT_FACTORS = {1e-3: "g m^2 or kg m mm", 1e-6: "kg mm^2", 1e-9: "g mm^2", 1e3: "t m^2", 1e6: "kg km^2"}
"""Units of inertia that a file may have by mistake, by their factor to kg m^2."""

SIDES = (("left", "right"), ("Left", "Right"), ("LEFT", "RIGHT"), ("l", "r"), ("L", "R"))
"""Words for the two sides in names. Single letters count only between underscores or at an end."""

MAX_LISTED_FINDINGS = 3
"""Largest number of findings of one kind that are listed separately."""

MIN_GEOMETRY_LENGTH = 0.02
"""Longest side of the geometry, m, below which the geometry is a marker and not the shape of the body."""


def findings(mechanism: Mechanism) -> Iterator[Finding]:
    """Yield likely mistakes in the bodies of an imported mechanism."""
    bodies = [MeasuredBody.of(mechanism, k) for k in range(1, len(mechanism.bodies))]
    heaviest = max(bodies, key=lambda each: each.body.mass)
    found = [finding for each in bodies for rule in RULES for finding in rule(each, mechanism)]
    found += [finding for each in bodies for finding in light_body(each, heaviest)]
    yield from grouped([*found, *unlike_twins(bodies)])


def grouped(found: Sequence[Finding]) -> Iterator[Finding]:
    """Yield the first `MAX_LISTED_FINDINGS` findings of each kind, and one that sums up the others."""
    for name in dict.fromkeys(finding.name for finding in found):
        of_kind = [finding for finding in found if finding.name == name]
        yield from of_kind[:MAX_LISTED_FINDINGS]
        if others := of_kind[MAX_LISTED_FINDINGS:]:
            element = f"{len(others)} more like {of_kind[MAX_LISTED_FINDINGS - 1].element}"
            yield replace(others[0], element=element, what=listed(finding.element for finding in others))


@dataclass(frozen=True)
class MeasuredBody:
    """Body with the quantities that the rules compare.

    Attributes:
        body: body of the scene.
        gyration: radius of gyration, root mean square distance of the mass from its center, m.
        box: lowest and highest corner (2, 3) around the geometry, m, world frame; None without geometry.
        extent: largest distance of geometry and joints from the center of mass, m.
        joints: (n, 3) points of the body's joints, m, world frame.
    """

    body: Body
    gyration: float
    box: Array | None
    extent: float
    joints: Array

    @classmethod
    def of(cls, mechanism: Mechanism, index: int) -> MeasuredBody:
        """Measure the body of a mechanism with an index."""
        body = mechanism.bodies[index]
        # The trace of the inertia tensor is twice the sum of m r^2
        gyration = (
            float(np.sqrt(max(0.0, 0.5 * np.trace(body.inertia)) / body.mass)) if body.mass > 0.0 else 0.0
        )
        # Joint points on this body; `point` is fixed in the first body, `point_on_second` in the second
        ends = [
            point
            for joint in mechanism.joints
            for name, point in ((joint.first, joint.point), (joint.second, joint.point_on_second))
            if name == body.name and joint.kind != "free"
        ]
        joints = np.reshape(ends, (-1, 3))
        corners = [corner for shape in (*body.shapes, *body.meshes) for corner in corners_of(shape)]
        box = np.array([np.min(corners, axis=0), np.max(corners, axis=0)]) if corners else None
        points = np.reshape([*corners, *joints], (-1, 3)) - body.center_of_mass
        extent = float(np.max(np.linalg.norm(points, axis=1), initial=0.0))
        return cls(body, gyration, box, extent, joints)

    @property
    def element(self) -> str:
        """Kind and name of the body, such as "body 'hip'", for findings."""
        return f"body {self.body.name!r}"

    @property
    def moments(self) -> Array:
        """(3,) principal moments of inertia, ascending, kg m^2."""
        return np.linalg.eigvalsh(0.5 * (self.body.inertia + self.body.inertia.T))


def corners_of(shape: Shape | Mesh) -> list[Array]:
    """Return points (3,), m, world frame, with the same bounding box as a shape; for a cylinder, the bounding
    box of the capsule with the same ends."""
    if isinstance(shape, Mesh):
        return [np.min(shape.vertices, axis=0), np.max(shape.vertices, axis=0)]
    if isinstance(shape, Box):
        reach = np.abs(rotation(np.asarray(shape.quaternion))) @ np.asarray(shape.half_sizes)
        return [shape.center - reach, shape.center + reach]
    if isinstance(shape, Sphere):
        return [shape.center - shape.radius, shape.center + shape.radius]
    if not isinstance(shape, Capsule | Cylinder):
        assert_never(shape)
    ends = [np.asarray(shape.start), np.asarray(shape.end)]
    return [end + sign * shape.radius for end in ends for sign in (-1.0, 1.0)]


def impossible_inertia(each: MeasuredBody, mechanism: Mechanism) -> Iterator[Finding]:
    """Find principal moments that violate the triangle inequality."""
    a, b, c = each.moments
    if a + b < c * (1.0 - REALISABLE_TOLERANCE):
        yield Finding(
            name=Mistake.IMPOSSIBLE_INERTIA,
            element=each.element,
            what=f"principal moments {a:.3g}, {b:.3g} and {c:.3g} kg m^2: {a:.3g} + {b:.3g} < {c:.3g}",
            consequence="no rigid body has this inertia, and its rotation is not physical",
            remedy="recompute the inertia about the center of mass",
        )


def large_inertia(each: MeasuredBody, mechanism: Mechanism) -> Iterator[Finding]:
    """Find an inertia that needs mass far outside the body."""
    has_geometry = each.box is not None
    extent = each.extent if has_geometry else max(mechanism.size, each.extent)
    limit = MAX_GYRATION if has_geometry else MAX_GYRATION_OF_MECHANISM
    if extent > 0.0 and each.gyration > limit * extent:
        where = "its geometry and joints reach" if has_geometry else "the mechanism reaches"
        what = f"a radius of gyration of {each.gyration:.3g} m, where {where} {extent:.3g} m"
        if np.array_equal(each.moments, np.ones(3)):
            what = f"an inertia of 1 kg m^2 about all axes, the value of a placeholder: {what}"
        slowness = (each.gyration / extent) ** 2
        yield Finding(
            name=Mistake.INERTIA_TOO_LARGE,
            element=each.element,
            what=what,
            consequence=f"it turns {slowness:.3g} times as slowly as a body of that size, or slower",
            remedy=_unit_advice(each, extent),
        )


def small_inertia(each: MeasuredBody, mechanism: Mechanism) -> Iterator[Finding]:
    """Find an inertia that needs all mass in one point of the body."""
    if each.box is None:
        return
    extent = 0.5 * float(np.max(each.box[1] - each.box[0]))
    if 0.0 < each.gyration < MIN_GYRATION * extent:
        yield Finding(
            name=Mistake.INERTIA_TOO_SMALL,
            element=each.element,
            what=f"a radius of gyration of {each.gyration:.3g} m, "
            f"where its geometry is {2.0 * extent:.3g} m long",
            consequence="it turns much too fast, and simulations need tiny steps",
            remedy=_unit_advice(each, extent),
        )


def _unit_advice(each: MeasuredBody, extent: float) -> str:
    """Propose the unit in which the inertia would be plausible.

    Args:
        each: the body.
        extent: length of the body from its center, m; the plausible radius of gyration is 0.4 times as long.
    """
    wanted = (0.4 * extent / each.gyration) ** 2  # factor from the file's inertia to the plausible one
    factor = min(UNIT_FACTORS, key=lambda one: abs(np.log(one / wanted)))
    if abs(np.log10(factor / wanted)) > 1.0:  # no unit is within a factor of 10
        return "check the units of its inertia and of its mass: kg m^2 and kg"
    return f"if the inertia is in {UNIT_FACTORS[factor]}, multiply it by {factor:g}"


def distant_center(each: MeasuredBody, mechanism: Mechanism) -> Iterator[Finding]:
    """Find a center of mass far outside the box around geometry and joints."""
    if each.box is None:
        return
    low, high = (f([*each.box, *each.joints], axis=0) for f in (np.min, np.max))
    diagonal = float(np.linalg.norm(high - low))
    center = each.body.center_of_mass
    distance = float(np.linalg.norm(np.maximum(0.0, np.maximum(low - center, center - high))))
    if distance > MAX_CENTER_DISTANCE * diagonal > 0.0:
        yield Finding(
            name=Mistake.CENTER_OUTSIDE,
            element=each.element,
            what=f"its center of mass is {distance:.3g} m from its geometry and joints, "
            f"{diagonal:.3g} m large",
            consequence="gravity and inertia act far from the body",
            remedy="check the origin of its inertial and its units: m",
        )


def dense_body(each: MeasuredBody, mechanism: Mechanism) -> Iterator[Finding]:
    """Find a mass that no material has in the volume of the geometry."""
    if each.box is None:
        return
    sides = each.box[1] - each.box[0]
    volume = float(np.prod(sides))
    joints_from_middle = each.joints - 0.5 * (each.box[0] + each.box[1])
    is_partial = np.any(np.abs(joints_from_middle) > 2.0 * sides)  # geometry covers a part of the body only
    if (
        volume > 0.0
        and float(np.max(sides)) > MIN_GEOMETRY_LENGTH
        and not is_partial
        and each.body.mass > MAX_DENSITY * volume
    ):
        yield Finding(
            name=Mistake.MASS_TOO_LARGE,
            element=each.element,
            what=f"{each.body.mass:.3g} kg in a box of {volume:.3g} m^3 around its geometry: "
            f"{each.body.mass / volume:.3g} kg/m^3",
            consequence="it is denser than any metal",
            remedy="check the units of its mass (kg, not g) and of its geometry (m, not mm)",
        )


def light_body(each: MeasuredBody, heaviest: MeasuredBody) -> Iterator[Finding]:
    """Find a mass that is negligible compared with the heaviest body."""
    mass, most = each.body.mass, heaviest.body.mass
    if 0.0 < mass < MIN_MASS_SHARE * most:
        yield Finding(
            name=Mistake.MASS_TOO_SMALL,
            element=each.element,
            what=f"{mass:.3g} kg, {mass / most:.1g} of the {most:.3g} kg of {heaviest.element}",
            consequence="motions lose digits, and small steps are needed",
            remedy="give it its mass, or fix it to its neighbor",
        )


RULES = (impossible_inertia, large_inertia, small_inertia, distant_center, dense_body)
"""Rules that compare one body with its geometry and with the mechanism."""


def twin_name(name: str, names: Collection[str] = ()) -> str:
    """Return the name of the body on the other side; "" if the name has no side, or both sides.

    Args:
        name: name of a body.
        names: names of all bodies. Single letters are no sides if others take their place, as in `link_s`,
            `link_l`, `link_u` and `link_r` of an arm.
    """
    if len(re.findall("left|right", name, re.IGNORECASE)) > 1:
        return ""
    for one, other in SIDES:
        for side, opposite in ((one, other), (other, one)):
            if len(side) > 1:
                if found := re.search(f"{side}([LR](?![a-z])|)", name):
                    # a letter behind the side changes, too: the left motor of the left leg mirrors `rightR`
                    mirrored = opposite + {"L": "R", "R": "L", "": ""}[found[1]]
                    return name[: found.start()] + mirrored + name[found.end() :]
            elif found := re.fullmatch(rf"(.*_|){side}(_.*|)", name):
                alike = rf"{re.escape(found[1])}[^{side}{opposite}\W]{re.escape(found[2])}"
                is_series = any(re.fullmatch(alike, each) for each in names)
                return "" if is_series else f"{found[1]}{opposite}{found[2]}"
    # legs of quadrupeds: FL, FR (front), RL, RR (rear), HL, HR (hind)
    if found := re.fullmatch(r"([FRH])([LR])(_.*|)", name):
        return found[1] + {"L": "R", "R": "L"}[found[2]] + found[3]
    return ""


def unlike_twins(bodies: list[MeasuredBody]) -> Iterator[Finding]:
    """Find twins, by their names, that differ in mass, principal moments or center of mass.

    Centers of mass are compared if the joints of both twins are mirror images in the plane of symmetry.
    """
    by_name = {each.body.name: each for each in bodies}
    pairs = [  # each pair once
        (each, by_name[other])
        for each in bodies
        if (other := twin_name(each.body.name, by_name)) in by_name and each.body.name < other
    ]
    reflection, plane = _symmetry_plane(pairs)
    for one, two in pairs:
        problem = _twin_difference(one, two, reflection, plane)
        remedy = "mirror one side again: signs of y or of the products of inertia are the usual mistake"
        if _have_other_masses(one, two):  # which no reflection causes
            remedy = "give both the same mass, unless one side carries something, such as a tool"
        if problem:
            yield Finding(
                name=Mistake.TWINS_DIFFER,
                element=f"bodies {one.body.name!r} and {two.body.name!r}",
                what=problem,
                consequence="the two sides move differently",
                remedy=remedy,
            )


def _symmetry_plane(pairs: list[tuple[MeasuredBody, MeasuredBody]]) -> tuple[Array, float]:
    """Find the plane of symmetry of most pairs of twins, perpendicular to x, y or z.

    Returns:
        The reflection matrix (3, 3), the identity if no pair is symmetric; and the coordinate of the plane
        along its normal, m.
    """
    # The first joints of the twins of each pair; the plane is half-way between most of them
    joints = [(one.joints[0], two.joints[0]) for one, two in pairs if len(one.joints) and len(two.joints)]
    most, best_reflection, best_plane = 0, np.eye(3), 0.0
    for axis in range(3):
        if not joints:
            continue
        reflection = np.eye(3)
        reflection[axis, axis] = -1.0
        plane = float(np.median([0.5 * (p + q)[axis] for p, q in joints]))
        count = sum(_is_mirrored(p, q, reflection, plane, axis) for p, q in joints)
        if count > most:
            most, best_reflection, best_plane = count, reflection, plane
    return best_reflection, best_plane


def _is_mirrored(p: Array, q: Array, reflection: Array, plane: float, axis: int) -> bool:
    """Return True if point q (3,) is the mirror image of point p (3,); False for points in the plane of
    symmetry.

    Args:
        p, q: points, m, world frame.
        reflection: (3, 3) reflection matrix.
        plane: coordinate of the plane of symmetry along its normal, m.
        axis: index of the coordinate axis (x, y or z) that is the normal of the plane.
    """
    shift = 2.0 * plane * np.eye(3)[axis]
    distance = abs(p[axis] - q[axis])
    gap = float(np.linalg.norm(reflection @ p + shift - q))
    return distance > 0.0 and gap < MAX_TWIN_DIFFERENCE * distance


def _twin_difference(one: MeasuredBody, two: MeasuredBody, reflection: Array, plane: float) -> str:
    """Describe the first difference of two twins; "" if they are equal or cannot be compared.

    Args:
        one, two: the twins.
        reflection, plane: plane of symmetry, see `_symmetry_plane`.
    """
    # Compare masses and principal moments
    if _have_other_masses(one, two):
        return f"masses of {one.body.mass:.4g} and {two.body.mass:.4g} kg"
    largest = float(max(one.moments[2], two.moments[2]))
    if np.max(np.abs(one.moments - two.moments)) > MAX_TWIN_DIFFERENCE * largest:
        texts = (", ".join(f"{x:.4g}" for x in each.moments) for each in (one, two))
        return f"principal moments of {' and '.join(texts)} kg m^2"
    # Compare centers of mass, from the first joint of each body, if all joints are mirror images
    axes = np.flatnonzero(np.diag(reflection) < 0.0)
    if not (len(axes) and len(one.joints) and len(two.joints)):
        return ""
    axis = int(axes[0])
    joints = [*zip(one.joints, two.joints, strict=False)]
    if len(one.joints) != len(two.joints) or not all(
        _is_mirrored(p, q, reflection, plane, axis) for p, q in joints
    ):
        return ""
    p, q = joints[0]
    arms = reflection @ (one.body.center_of_mass - p), two.body.center_of_mass - q
    size = max(one.gyration, two.gyration, float(np.linalg.norm(arms[0])))
    gap = arms[1] - arms[0]
    worst = int(np.argmax(np.abs(gap)))
    # Differences of centers of mass and of products of inertia may be 5 times as large as those of masses
    if abs(gap[worst]) > 5.0 * MAX_TWIN_DIFFERENCE * size and not _is_same_part(one, two, size):
        name = "xyz"[worst]
        return f"centers of mass whose {name}, mirrored, are {arms[0][worst]:.4g} and {arms[1][worst]:.4g} m"
    return ""


def _have_other_masses(one: MeasuredBody, two: MeasuredBody) -> bool:
    """Return True if the masses of two twins differ."""
    masses = one.body.mass, two.body.mass
    return abs(masses[0] - masses[1]) > MAX_TWIN_DIFFERENCE * max(masses)


def _is_same_part(one: MeasuredBody, two: MeasuredBody, size: float) -> bool:
    """Return True if the same part, not its mirror image, is used on both sides: moved, or rotated by half a
    turn about x, y or z.

    Args:
        one, two: the twins.
        size: length, m, that scales differences of centers of mass.
    """
    # Centers of mass from the first joint, and inertias along the axes of the world
    first, second = (each.body.center_of_mass - each.joints[0] for each in (one, two))
    rotations = [rotation(np.asarray(each.body.quaternion)) for each in (one, two)]
    inertias = [
        matrix @ each.body.inertia @ matrix.T for matrix, each in zip(rotations, (one, two), strict=True)
    ]
    # The inertia of a rotated part differs from that of a mirrored part only in its products of inertia
    largest = float(np.max(one.moments))
    products = inertias[0] - np.diag(np.diag(inertias[0]))
    has_products = np.max(np.abs(products)) > 5.0 * MAX_TWIN_DIFFERENCE * largest
    not_turned = (1, 1, 1)  # diagonal of the rotation matrix: no rotation, then half turns about x, y and z
    for signs in (not_turned, (1, -1, -1), (-1, 1, -1), (-1, -1, 1)):
        half_turn = np.diag(np.array(signs, dtype=float))
        has_same_center = float(np.max(np.abs(half_turn @ first - second))) < 5.0 * MAX_TWIN_DIFFERENCE * size
        gap = float(np.max(np.abs(half_turn @ inertias[0] @ half_turn - inertias[1])))
        has_same_inertia = gap < 5.0 * MAX_TWIN_DIFFERENCE * largest
        if has_same_center and has_same_inertia and (has_products or signs == not_turned):
            return True
    return False
