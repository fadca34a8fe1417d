"""Scene of the arm of a hydraulic excavator of the 20-ton class: boom, stick and bucket, moved by three
hydraulic cylinders.

The boom turns on the machine, the stick on the boom, the bucket on the stick. The bucket cylinder moves the
bucket through a four-bar linkage of rocker and link. A pair of boom cylinders is one cylinder here, in the
plane of symmetry. Dimensions and masses are typical of excavators of 20 t, chosen here; they are not those of
one machine. The joint structure is that of A. J. Koivo, M. Thoma, E. Kocaoglan, J. Andrade-Cetto, "Modeling
and Control of Excavator Dynamics during Digging Operation", Journal of Aerospace Engineering 9(1), 1996, with
cylinders and bucket linkage as bodies of their own.

The mechanism moves in the vertical plane of x (forwards) and z (up). The origin is on the ground, on the axis
about which the upper structure swings. Angles in the plane are from x to z.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Annotated, NamedTuple

import numpy as np

from crosscheck.library.options import Between
from newton_euler.model.control import PD
from newton_euler.model.forces import Wrench
from newton_euler.model.geometry import Capsule, Inertia, Shape, total_inertia
from newton_euler.model.joint import Joint
from newton_euler.model.joint_kinds import PointOnLine, Prismatic, Revolute
from newton_euler.model.mechanism import Body, Mechanism
from newton_euler.model.scene import Scene
from newton_euler.model.smooth_functions import Polynomial
from newton_euler.scalars import Array

X, Y, Z = np.eye(3)

DURATION = 3.0
"""Duration of the digging motion, s."""


class Link(NamedTuple):
    """A rigid link of the arm, in its own plane frame: x from its first pin to its second, z to its left.

    Attributes:
        mass: kg.
        center: (x, z) of the center of mass, m.
        radius_of_gyration: of the rotation about y, m.
        points: (x, z) of pins and corners by name, m.
    """

    mass: float
    center: tuple[float, float]
    radius_of_gyration: float
    points: dict[str, tuple[float, float]]


LINKS = {
    "boom": Link(
        1500.0,
        (2.65, 0.45),
        1.65,
        {"stick": (5.70, 0.0), "boom_rod": (2.20, 0.65), "bend": (2.60, 0.62), "stick_barrel": (3.00, 1.00)},
    ),
    "stick": Link(
        750.0,
        (0.95, 0.12),
        0.95,
        {
            "bucket": (2.90, 0.0),
            "stick_rod": (-0.77, 0.36),
            "bucket_barrel": (0.35, 0.58),
            "rocker": (2.46, 0.02),
        },
    ),
    "bucket": Link(800.0, (0.62, 0.22), 0.50, {"tip": (1.50, 0.0), "link": (-0.10, 0.44)}),
    "rocker": Link(80.0, (0.31, 0.0), 0.22, {"link": (0.62, 0.0)}),
    "link": Link(60.0, (0.29, 0.0), 0.21, {"bucket": (0.58, 0.0)}),
}
"""Links of the arm. Points have the names of the bodies that are joined there, and are given from the pin
that joins the link to the body before it: of the boom to the machine, of the link to the rocker."""

BOOM_FOOT, BOOM_CYLINDER_FOOT = (0.10, 1.70), (0.55, 1.10)
"""Pins (x, z) of the boom and of its cylinder on the machine, m."""

BOOM_ANGLE, STICK_ANGLE, BUCKET_ANGLE = np.radians((15.0, -40.0, -70.0))
"""Initial angles of boom, stick and bucket against the horizontal, rad."""


class HydraulicCylinder(NamedTuple):
    """A hydraulic cylinder: barrel and rod.

    Attributes:
        barrel_mass, rod_mass: kg.
        closed_length: distance of both pins with the rod retracted, m.
        stroke: m.
        radii: outer radii of barrel and rod, m.
        stiffness, damping: gains of its PD controller, N/m and N s/m.
        feedforward: forces that hold the arm at rest at the initial pose, against the weight of the arm, N,
            per kg of soil, N/kg, and per N of digging force; rounded.
        extension: displacement of the set-point in the digging motion, m.
    """

    barrel_mass: float
    rod_mass: float
    closed_length: float
    stroke: float
    radii: tuple[float, float]
    stiffness: float
    damping: float
    feedforward: tuple[float, float, float]
    extension: float


CYLINDERS = {
    "boom": HydraulicCylinder(
        230.0, 170.0, 1.68, 1.18, (0.075, 0.043), 8e7, 6e6, (250.50e3, 110.80, -6.173), 0.25
    ),
    "stick": HydraulicCylinder(
        170.0, 120.0, 2.20, 1.42, (0.085, 0.050), 2e7, 8e5, (-38.33e3, -32.57, 4.855), 0.70
    ),
    "bucket": HydraulicCylinder(
        100.0, 70.0, 1.63, 1.04, (0.075, 0.043), 1e7, 1.2e5, (-8.143e3, -10.83, 3.177), 0.45
    ),
}
"""Cylinders by the link that they move. The boom has two, which are one here, with their masses and gains
together."""

SOIL_CENTER, SOIL_RADIUS_OF_GYRATION = (0.70, 0.30), 0.35
"""Center of mass (x, z) of soil in the bucket, plane frame of the bucket, and its radius of gyration, m."""


def excavator(
    soil: Annotated[float, Between(0.0, 3000.0, "kg")] = 0.0,
    digging_force: Annotated[float, Between(0.0, 150e3, "N")] = 50e3,
) -> Scene:
    """Return the arm of a 20 t excavator that digs for 3 s; gravity along -z, three degrees of freedom.

    PD controllers move the three cylinders from rest to rest. The bodies are five
    links, and barrel and rod of each cylinder. Four planar loops would have three redundant constraints each
    if all pins were hinges. Therefore the rods and the link end in pins that move freely along y and tilt, as
    spherical bearings with axial play do: `PointOnLine`, two equations. No constraint is redundant, and all
    reactions are unique.

    Args:
        soil: mass of soil in the bucket, constant.
        digging_force: resistance of the ground at the tip of the bucket, perpendicular to the line from the
            bucket's pin to the tip, against the curl of the bucket.
    """
    frames = _initial_frames()
    pins = {
        (name, pin): frames[name].point(xz) for name, link in LINKS.items() for pin, xz in link.points.items()
    }
    bodies = [
        Body.ground(),
        *(_link(name, frames[name], soil if name == "bucket" else 0.0) for name in LINKS),
    ]
    joints: list[Joint] = [
        Revolute("boom_pin", "ground", "boom", frames["boom"].origin, axis=-Y),
        Revolute("stick_pin", "boom", "stick", frames["stick"].origin, axis=-Y),
        Revolute("bucket_pin", "stick", "bucket", frames["bucket"].origin, axis=-Y),
        Revolute("rocker_pin", "stick", "rocker", frames["rocker"].origin, axis=-Y),
        Revolute("link_pin", "rocker", "link", frames["link"].origin, axis=-Y),
        PointOnLine("link_end", "bucket", "link", pins["bucket", "link"], axis=Y),
    ]
    # cylinders: body with the barrel, its pin, body with the rod, its pin
    ends = {
        "boom": ("ground", _in_world(BOOM_CYLINDER_FOOT), "boom", pins["boom", "boom_rod"]),
        "stick": ("boom", pins["boom", "stick_barrel"], "stick", pins["stick", "stick_rod"]),
        "bucket": ("stick", pins["stick", "bucket_barrel"], "rocker", pins["rocker", "link"]),
    }
    for name, (first, foot, second, head) in ends.items():
        barrel, rod = f"{name}_barrel", f"{name}_rod"
        bodies += _barrel_and_rod(name, foot, head)
        joints += [
            Revolute(f"{barrel}_pin", first, barrel, foot, axis=-Y),
            Prismatic(f"{name}_cylinder", barrel, rod, foot, axis=head - foot, actuated=True),
            PointOnLine(f"{rod}_pin", second, rod, head, axis=Y),
        ]
    resistance = Wrench(
        "digging_force",
        "bucket",
        pins["bucket", "tip"],
        force=digging_force * frames["bucket"].left,
        frame="body",
    )
    return Scene(
        "excavator",
        Mechanism(bodies, joints),
        duration=DURATION,
        output_period=0.02,
        gravity=-9.81 * Z,
        control=tuple(
            PD(
                f"{name}_cylinder",
                cylinder.stiffness,
                cylinder.damping,
                _rest_to_rest(cylinder.extension),
                feedforward=float(np.dot(cylinder.feedforward, (1.0, soil, digging_force))),
            )
            for name, cylinder in CYLINDERS.items()
        ),
        forces=(resistance,) if digging_force else (),
        description="arm of a 20 t excavator digging, three cylinders and a bucket linkage, four loops",
    )


def _rest_to_rest(displacement: float) -> Polynomial:
    """Return the polynomial of degree 5 that moves from 0 to a displacement, m, with rest at both ends."""
    powers = ((3, 10.0), (4, -15.0), (5, 6.0))  # of time / duration, with their coefficients
    return Polynomial((0.0, 0.0, 0.0, *(c * displacement / DURATION**k for k, c in powers)))


class Frame(NamedTuple):
    """The plane frame of a link at the initial pose.

    Attributes:
        origin: (3,) m, world.
        along, left: (3,) unit vectors of its x and z, world.
    """

    origin: Array
    along: Array
    left: Array

    def point(self, xz: tuple[float, float]) -> Array:
        """Return the world position (3,), m, of a point with given coordinates in the frame."""
        return self.origin + xz[0] * self.along + xz[1] * self.left


def _in_world(xz: tuple[float, float]) -> Array:
    """Return the point (3,), m, in the plane of motion."""
    return xz[0] * X + xz[1] * Z


def _frame(origin: Array, along: Array) -> Frame:
    """Return the frame with its x along a vector (3,) in the plane of motion."""
    along = along / np.linalg.norm(along)
    return Frame(origin, along, np.cross(along, Y))


def _initial_frames() -> dict[str, Frame]:
    """Return the frames of all links at the initial pose."""
    angles = {"boom": BOOM_ANGLE, "stick": STICK_ANGLE, "bucket": BUCKET_ANGLE}
    along = {name: np.cos(angle) * X + np.sin(angle) * Z for name, angle in angles.items()}
    boom = _frame(_in_world(BOOM_FOOT), along["boom"])
    stick = _frame(boom.point(LINKS["boom"].points["stick"]), along["stick"])
    bucket = _frame(stick.point(LINKS["stick"].points["bucket"]), along["bucket"])
    # the rocker ends where circles about its pin and about the link's pin on the bucket intersect, above both
    start, end = stick.point(LINKS["stick"].points["rocker"]), bucket.point(LINKS["bucket"].points["link"])
    rocker_length, link_length = LINKS["rocker"].points["link"][0], LINKS["link"].points["bucket"][0]
    between = _frame(start, end - start)
    distance = float(np.linalg.norm(end - start))
    x = (distance**2 + rocker_length**2 - link_length**2) / (2.0 * distance)
    joint = between.point((x, np.sqrt(rocker_length**2 - x**2)))
    return {
        "boom": boom,
        "stick": stick,
        "bucket": bucket,
        "rocker": _frame(start, joint - start),
        "link": _frame(joint, end - joint),
    }


def _link(name: str, frame: Frame, soil: float) -> Body:
    """Return a link of the arm, with a mass of soil, kg."""
    link = LINKS[name]
    parts = [_solid(link.mass, frame.point(link.center), link.radius_of_gyration)]
    if soil:
        parts.append(_solid(soil, frame.point(SOIL_CENTER), SOIL_RADIUS_OF_GYRATION))
    whole = total_inertia(parts)
    return Body(name, whole.mass, whole.center_of_mass, whole.inertia, shapes=_shapes(name, frame))


def _solid(mass: float, center: Array, radius_of_gyration: float) -> Inertia:
    """Return mass properties with one radius of gyration, m, about all axes; only y matters."""
    return Inertia(mass, center, mass * radius_of_gyration**2 * np.eye(3))


OUTLINES: dict[str, tuple[tuple[tuple[str, ...], tuple[float, ...], float], ...]] = {
    "boom": ((("", "bend", "stick"), (0.0,), 0.20),),
    "stick": ((("stick_rod", "", "bucket"), (0.0,), 0.12),),
    "bucket": ((("", "link"), (0.0,), 0.06), (("", "tip"), (-0.4, 0.0, 0.4), 0.06)),
    "rocker": ((("", "link"), (-0.30, 0.30), 0.03),),
    "link": ((("", "bucket"), (-0.20, 0.20), 0.03),),
}
"""Capsules of the links: points by name ("" for the first pin), distances from the plane of symmetry, and
radius, m. Rocker and link are pairs of plates, so that parts that meet at a pin do not overlap."""


def _shapes(name: str, frame: Frame) -> tuple[Shape, ...]:
    """Return the shapes of a link for pictures and clearances."""
    shapes = []
    for pins, sides, radius in OUTLINES[name]:
        points = [frame.point(LINKS[name].points.get(pin, (0.0, 0.0))) for pin in pins]
        for side in sides:
            for start, end in pairwise(points):
                shapes.append(Capsule(start + side * Y, end + side * Y, radius))
    return tuple(shapes)


def _barrel_and_rod(name: str, foot: Array, head: Array) -> list[Body]:
    """Return both parts of a cylinder between its pins (3,), m, at the initial pose."""
    cylinder = CYLINDERS[name]
    along = (head - foot) / np.linalg.norm(head - foot)
    length = cylinder.stroke + 0.5 * (cylinder.closed_length - cylinder.stroke)  # of each part
    sides = (-0.4, 0.4) if name == "boom" else (0.0,)  # the pair of boom cylinders is beside the boom
    bodies = []
    for part, mass, end, direction, radius in (
        ("barrel", cylinder.barrel_mass, foot, along, cylinder.radii[0]),
        ("rod", cylinder.rod_mass, head, -along, cylinder.radii[1]),
    ):
        bars = tuple(Capsule(end + side * Y, end + length * direction + side * Y, radius) for side in sides)
        center = end + 0.5 * length * direction
        across = mass * (length**2 / 12.0 + 0.25 * radius**2)
        axial = 0.5 * mass * radius**2
        inertia = across * np.eye(3) + (axial - across) * np.outer(along, along)
        bodies.append(Body(f"{name}_{part}", mass, center, inertia, shapes=bars))
    return bodies
