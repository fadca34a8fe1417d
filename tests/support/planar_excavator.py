"""The arm of the library's `excavator` by plane trigonometry, an independent source of poses and forces.

Points and directions are components (x, z) in the plane of motion. Poses are analytic functions of the three
displacements of the cylinders, m from the initial pose, so that complex steps differentiate them without
truncation (W. Squire, G. Trapp, SIAM Review 40(1), 1998).
"""

from __future__ import annotations

import numpy as np
from finite_difference import derivative

from crosscheck.library.excavator import (
    BOOM_ANGLE,
    BOOM_CYLINDER_FOOT,
    BOOM_FOOT,
    BUCKET_ANGLE,
    CYLINDERS,
    LINKS,
    STICK_ANGLE,
)

SLIDES = ("boom_cylinder", "stick_cylinder", "bucket_cylinder")
GRAVITY = 9.81
COMPLEX_STEP = 1e-40


def vector(x, z):
    return np.array([x, z])


def turned(direction, xz):
    """The vector with components xz in a frame whose x axis is the unit vector `direction`."""
    (c, s), (x, z) = direction, xz
    return vector(c * x - s * z, s * x + c * z)


def apex(start, end, first, second):
    """The third corner of a triangle, left of the line from start to end, by its distances from both."""
    span = end - start
    squared = span @ span
    x = (squared + first**2 - second**2) / (2.0 * squared)
    return start + turned(span, (x, np.sqrt(first**2 / squared - x**2)))


def direction_with(origin, point, of_point):
    """Direction of a frame at `origin` in which `point` has the components `of_point`."""
    (a, b), (x, z) = point - origin, of_point
    scale = x * x + z * z
    return vector((a * x + b * z) / scale, (b * x - a * z) / scale)


def unit(angle):
    return vector(np.cos(angle), np.sin(angle))


def directions(lengths):
    """Origin and direction of each link, and both ends of each cylinder, for the lengths of the cylinders."""
    point = {name: {pin: np.array(xz) for pin, xz in link.points.items()} for name, link in LINKS.items()}
    foot, cylinder_foot = np.array(BOOM_FOOT), np.array(BOOM_CYLINDER_FOOT)
    frames, ends = {}, {}
    # the boom: the pin of the rod is left of the line from the boom's pin to the cylinder's foot
    rod = point["boom"]["boom_rod"]
    head = apex(foot, cylinder_foot, np.sqrt(rod @ rod), lengths["boom"])
    frames["boom"] = foot, direction_with(foot, head, rod)
    ends["boom"] = cylinder_foot, head
    on_boom = {pin: foot + turned(frames["boom"][1], xz) for pin, xz in point["boom"].items()}
    # the stick
    rod = point["stick"]["stick_rod"]
    origin, barrel = on_boom["stick"], on_boom["stick_barrel"]
    head = apex(barrel, origin, lengths["stick"], np.sqrt(rod @ rod))
    frames["stick"] = origin, direction_with(origin, head, rod)
    ends["stick"] = barrel, head
    on_stick = {pin: origin + turned(frames["stick"][1], xz) for pin, xz in point["stick"].items()}
    # rocker, link and bucket
    rocker, link = point["rocker"]["link"], point["link"]["bucket"]
    barrel, pivot = on_stick["bucket_barrel"], on_stick["rocker"]
    head = apex(barrel, pivot, lengths["bucket"], rocker[0])
    frames["rocker"] = pivot, direction_with(pivot, head, rocker)
    ends["bucket"] = barrel, head
    arm = point["bucket"]["link"]
    origin = on_stick["bucket"]
    end = apex(head, origin, link[0], np.sqrt(arm @ arm))
    frames["link"] = head, direction_with(head, end, link)
    frames["bucket"] = origin, direction_with(origin, end, arm)
    return frames, ends


def initial_lengths():
    """Lengths of the cylinders at the initial pose, m, from the angles of boom, stick and bucket."""
    point = {name: {pin: np.array(xz) for pin, xz in link.points.items()} for name, link in LINKS.items()}
    boom, stick, bucket = unit(BOOM_ANGLE), unit(STICK_ANGLE), unit(BUCKET_ANGLE)
    stick_pin = np.array(BOOM_FOOT) + turned(boom, point["boom"]["stick"])
    pivot = stick_pin + turned(stick, point["stick"]["rocker"])
    end = stick_pin + turned(stick, point["stick"]["bucket"]) + turned(bucket, point["bucket"]["link"])
    joint = apex(pivot, end, point["rocker"]["link"][0], point["link"]["bucket"][0])
    spans = {
        "boom": np.array(BOOM_FOOT) + turned(boom, point["boom"]["boom_rod"]) - np.array(BOOM_CYLINDER_FOOT),
        "stick": turned(boom, point["boom"]["stick"] - point["boom"]["stick_barrel"])
        + turned(stick, point["stick"]["stick_rod"]),
        "bucket": joint - stick_pin - turned(stick, point["stick"]["bucket_barrel"]),
    }
    return {name: np.linalg.norm(span) for name, span in spans.items()}


LENGTHS = initial_lengths()


def frames_of(displacements):
    """Origin and direction of each link, and both ends of each cylinder, for displacements (3,), m."""
    return directions({name: LENGTHS[name] + d for name, d in zip(CYLINDERS, displacements, strict=True)})


def tip(displacements):
    """The tip of the bucket (2,), m."""
    origin, along = frames_of(displacements)[0]["bucket"]
    return origin + turned(along, LINKS["bucket"].points["tip"])


def bodies(displacements):
    """Centers of mass (n, 2) and directions (n, 2) of all masses."""
    frames, ends = frames_of(displacements)
    rows = [(origin + turned(along, LINKS[name].center), along) for name, (origin, along) in frames.items()]
    origin, along = frames["bucket"]
    rows.append((origin + turned(along, (0.70, 0.30)), along))  # of soil
    for name, (foot, head) in ends.items():
        span = head - foot
        along = span / np.sqrt(span @ span)
        half = 0.25 * (CYLINDERS[name].closed_length + CYLINDERS[name].stroke)
        rows += [(foot + half * along, along), (head - half * along, along)]
    centers, alongs = zip(*rows, strict=True)
    return np.array(centers), np.array(alongs)


def masses(soil):
    """Masses (n,), kg, and moments of inertia (n,) about y, kg m^2, in the order of `bodies`."""
    found = [(LINKS[name].mass, LINKS[name].radius_of_gyration ** 2) for name in ("boom", "stick", "rocker")]
    found += [(LINKS[name].mass, LINKS[name].radius_of_gyration ** 2) for name in ("link", "bucket")]
    found.append((soil, 0.35**2))
    for each in CYLINDERS.values():
        length = 0.5 * (each.closed_length + each.stroke)
        for mass, radius in zip((each.barrel_mass, each.rod_mass), each.radii, strict=True):
            found.append((mass, length**2 / 12.0 + radius**2 / 4.0))
    mass, squared_radius = np.array(found).T
    return mass, mass * squared_radius


def motion(displacements, rates):
    """Velocities (n, 2) and angular velocities (n,) of all masses."""
    center, along = bodies(np.asarray(displacements) + 1j * COMPLEX_STEP * np.asarray(rates))
    velocity, turning = center.imag / COMPLEX_STEP, along.imag / COMPLEX_STEP
    return velocity, along.real[:, 0] * turning[:, 1] - along.real[:, 1] * turning[:, 0]


def acceleration(displacements, rates, accelerations):
    """Accelerations (n, 2) and angular accelerations (n,): finite differences of `motion`."""
    d, v, a = map(np.asarray, (displacements, rates, accelerations))
    by_time = derivative(lambda t: np.column_stack(motion(d + t * v + 0.5 * t * t * a, v + t * a)))
    return by_time[:, :2], by_time[:, 2]


REST = (0.0, 0.0, 0.0)


def cylinder_forces(displacements, rates=REST, accelerations=REST, soil=0.0, digging_force=0.0):
    """Forces (3,) of the cylinders, N, by the principle of virtual power (d'Alembert)."""
    mass, moment = masses(soil)
    linear, angular = acceleration(displacements, rates, accelerations)
    inertia = mass[:, None] * (linear + vector(0.0, GRAVITY))
    along = frames_of(displacements)[0]["bucket"][1]
    resistance = digging_force * turned(along, (0.0, 1.0))
    forces = []
    for k in range(3):
        velocity, turning = motion(displacements, np.eye(3)[k])
        moved = np.asarray(displacements) + 1j * COMPLEX_STEP * np.eye(3)[k]
        tip_velocity = tip(moved).imag / COMPLEX_STEP
        power = np.sum(inertia * velocity) + np.sum(moment * angular * turning)
        forces.append(power - resistance @ tip_velocity)
    return np.array(forces)


def kinetic_energy(displacements, rates):
    """Kinetic energy without soil, J."""
    mass, moment = masses(0.0)
    velocity, turning = motion(displacements, rates)
    return 0.5 * (np.sum(mass[:, None] * velocity**2) + np.sum(moment * turning**2))
