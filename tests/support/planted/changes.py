"""Changes that MJCF and URDF have in common: of bodies, joints and the whole robot.

Each function changes a `ModelText` at an element that it chooses at random, and returns the `Plant`: the rows
that a comparison of both files should have. It raises `NotApplicable` if no element fits.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable

import numpy as np

from crosscheck.differences.difference import Quantity
from newton_euler.reading.robot import Placement
from newton_euler.scalars import Array
from tests.support.planted.model_text import Inertial, ModelText
from tests.support.planted.plant import (
    Coordinate,
    Expected,
    NotApplicable,
    Plant,
    across,
    point_mass_inertia,
    turn,
)

Change = Callable[[ModelText, np.random.Generator], Plant]
"""Function that changes a file."""

COMMON: dict[str, Change] = {}
"""Changes of files of both formats by the name of their kind."""

MIN_APART = 0.2
"""Smallest relative difference of two principal moments that counts as distinct."""


def common(change: Change) -> Change:
    """Add a change to `COMMON`; its name without underscores is the kind."""
    COMMON[change.__name__.replace("_", " ")] = change
    return change


def chosen(random: np.random.Generator, names: Iterable[str]) -> str:
    """Return one of some names at random.

    Raises:
        NotApplicable: if there is none.
    """
    those = list(names)
    if not those:
        raise NotApplicable("no element fits")
    return those[int(random.integers(len(those)))]


def one(element: str, quantity: Quantity, size: float | None = None, cause: str = "") -> Plant:
    """Return a plant of one element and one row."""
    return Plant((Expected(element, quantity, size, cause),), touched=frozenset([element]))


def _heavy(file: ModelText) -> list[str]:
    """Return the moving bodies that are not tiny parts."""
    own = {body: file.inertial(body) for body in file.moving_bodies()}
    largest = max((each.mass for each in own.values()), default=0.0)
    return [
        body
        for body, each in own.items()
        if each.mass > 1e-3 * largest and np.linalg.eigvalsh(each.inertia)[0] > 0.0
    ]


def _stretched(file: ModelText) -> list[str]:
    """Return the heavy bodies whose three principal moments are distinct."""
    found = []
    for body in _heavy(file):
        low, middle, high = np.linalg.eigvalsh(file.inertial(body).inertia)
        if middle > (1.0 + MIN_APART) * low and high > (1.0 + MIN_APART) * middle:
            found.append(body)
    return found


def _products(matrix: Array) -> float:
    """Return the norm of the products of an inertia (3, 3) relative to the norm of the matrix."""
    return float(np.linalg.norm(matrix - np.diag(np.diag(matrix))) / np.linalg.norm(matrix))


def _with_inertia(file: ModelText, body: str, matrix: Array) -> float:
    """Replace the inertia (3, 3) of a body; return the relative change of the principal moments."""
    own = file.inertial(body)
    file.set_inertial(body, own._replace(inertia=matrix))
    before, after = np.linalg.eigvalsh(own.inertia), np.linalg.eigvalsh(matrix)
    return float(np.abs(after / before - 1.0).max())


# Bodies


@common
def mass(file: ModelText, random: np.random.Generator) -> Plant:
    """Make a body heavier by 10 %."""
    body = chosen(random, _heavy(file))
    file.set_mass(body, 1.1 * file.inertial(body).mass)
    return one(body, Quantity.MASS, 0.1)


@common
def center_of_mass(file: ModelText, random: np.random.Generator) -> Plant:
    """Move a center of mass by 1 cm."""
    body = chosen(random, _heavy(file))
    file.set_center(body, file.inertial(body).center + np.array([0.0, 0.01, 0.0]))
    return one(body, Quantity.CENTER, 0.01)


@common
def inertia(file: ModelText, random: np.random.Generator) -> Plant:
    """Make an inertia larger by 20 %."""
    body = chosen(random, _heavy(file))
    _with_inertia(file, body, 1.2 * file.inertial(body).inertia)
    return one(body, Quantity.INERTIA, 0.2)


@common
def axes_of_inertia(file: ModelText, random: np.random.Generator) -> Plant:
    """Turn the principal axes of an inertia by 0.3 rad."""
    body = chosen(random, _stretched(file))
    matrix = file.inertial(body).inertia
    rotation = turn(np.linalg.eigh(matrix)[1][:, 0], 0.3)
    _with_inertia(file, body, rotation @ matrix @ rotation.T)
    return one(body, Quantity.INERTIA_AXES, 0.3)


@common
def sign_of_products_of_inertia(file: ModelText, random: np.random.Generator) -> Plant:
    """Give the products of an inertia the other sign."""
    bodies = [body for body in _heavy(file) if _products(file.inertial(body).inertia) > 1e-2]
    body = chosen(random, bodies)
    matrix = file.inertial(body).inertia
    _with_inertia(file, body, 2.0 * np.diag(np.diag(matrix)) - matrix)
    return _of_inertia(body, "products of inertia have the other sign")


@common
def products_of_inertia_missing(file: ModelText, random: np.random.Generator) -> Plant:
    """Set the products of an inertia to zero."""
    bodies = [body for body in _heavy(file) if _products(file.inertial(body).inertia) > 1e-2]
    body = chosen(random, bodies)
    _with_inertia(file, body, np.diag(np.diag(file.inertial(body).inertia)))
    return _of_inertia(body, "products of inertia are missing")


@common
def moments_of_inertia_exchanged(file: ModelText, random: np.random.Generator) -> Plant:
    """Exchange ixx and iyy."""
    bodies = [body for body in _stretched(file) if _products(file.inertial(body).inertia) > 1e-2]
    body = chosen(random, bodies)
    matrix = file.inertial(body).inertia
    swapped = matrix + (matrix[1, 1] - matrix[0, 0]) * np.diag([1.0, -1.0, 0.0])
    if np.abs(swapped - matrix).max() < 0.05 * np.abs(matrix).max():
        raise NotApplicable("both moments are nearly equal")
    _with_inertia(file, body, swapped)
    return _of_inertia(body, "ixx and iyy are exchanged")


@common
def inertia_about_the_origin(file: ModelText, random: np.random.Generator) -> Plant:
    """State an inertia about the origin of the link instead of the center of mass."""
    bodies = []
    for body in _heavy(file):
        own = file.inertial(body)
        if own.mass * own.center @ own.center > 0.1 * np.trace(own.inertia):
            bodies.append(body)
    body = chosen(random, bodies)
    own = file.inertial(body)
    size = _with_inertia(file, body, own.inertia + point_mass_inertia(own.mass, own.center))
    return one(body, Quantity.INERTIA, size, "about the origin of the link")


@common
def orientation_of_inertia_lost(file: ModelText, random: np.random.Generator) -> Plant:
    """Write the principal moments without the orientation of the axes."""
    bodies = [body for body in _stretched(file) if _products(file.inertial(body).inertia) > 0.05]
    body = chosen(random, bodies)
    _with_inertia(file, body, np.diag(np.linalg.eigvalsh(file.inertial(body).inertia)))
    return Plant((Expected(body, Quantity.INERTIA_AXES),), touched=frozenset([body]))


def _of_inertia(body: str, cause: str) -> Plant:
    """Return a plant whose row is about the inertia or its axes, with a cause."""
    row = Expected(body, Quantity.INERTIA, None, cause, (Quantity.INERTIA_AXES,))
    return Plant((row,), touched=frozenset([body]))


@common
def mass_missing(file: ModelText, random: np.random.Generator) -> Plant:
    """Remove the mass of a body that carries others."""
    carriers = [body for body in _heavy(file) if any(child in _heavy(file) for child in file.children(body))]
    bodies = [body for body in carriers if len(file.joints_above(body)) == 1]
    if file.format == "MJCF":
        raise NotApplicable("MuJoCo refuses a moving body without mass")
    body = chosen(random, bodies)
    file.remove_inertial(body)
    return one(body, Quantity.MASS, 1.0)


@common
def part_added(file: ModelText, random: np.random.Generator) -> Plant:
    """Fix a part of a tenth of its mass to a body."""
    body = chosen(random, _heavy(file))
    own = file.inertial(body)
    file.add_fixed(
        body,
        "planted_part",
        np.array([0.02, 0.01, 0.0]),
        Inertial(0.1 * own.mass, np.zeros(3), 0.1 * own.inertia),
    )
    cause = "planted_part"
    return Plant((Expected("", Quantity.MASS, None, cause),), touched=frozenset([body, cause]))


@common
def massless_link_added(file: ModelText, random: np.random.Generator) -> Plant:
    """Fix a link without mass to a body, which changes nothing."""
    body = chosen(random, file.moving_bodies())
    file.add_fixed(body, "planted_frame", np.array([0.02, 0.01, 0.0]), None)
    return Plant(touched=frozenset([body]))


@common
def link_split(file: ModelText, random: np.random.Generator) -> Plant:
    """Split a body into two fixed bodies of 70 and 30 % of its mass, which changes nothing."""
    body = chosen(random, _heavy(file))
    own = file.inertial(body)
    # parts that lie above each other along the axis of the largest moment have the whole's moments
    offset = 0.05 * math.sqrt(np.linalg.eigvalsh(own.inertia)[0] / own.mass) * np.ones(3)
    masses = 0.7 * own.mass, 0.3 * own.mass
    centers = own.center - 0.3 * offset, own.center + 0.7 * offset
    apart = point_mass_inertia(0.21 * own.mass, offset)
    parts = [share * (own.inertia - apart) for share in (0.7, 0.3)]
    file.set_inertial(body, Inertial(masses[0], centers[0], parts[0]))
    file.add_fixed(body, "planted_part", centers[1], Inertial(masses[1], np.zeros(3), parts[1]))
    return Plant(touched=frozenset([body]))


@common
def links_fused(file: ModelText, random: np.random.Generator) -> Plant:
    """Give a body the mass of a body that is fixed to it, which changes nothing."""
    pairs = {}
    for body in file.moving_bodies():
        parent = file.parent(body)
        if parent and not file.joints_above(body) and file.has_inertial(parent) and file.is_moving(parent):
            pairs[body] = parent
    body = chosen(random, pairs)
    parent = pairs[body]
    own, base = file.inertial(body), file.inertial(parent)
    at = file.placement(body)
    center = at.position + at.rotation @ own.center
    total = own.mass + base.mass
    together = (own.mass * center + base.mass * base.center) / total
    inertia = base.inertia + point_mass_inertia(base.mass, base.center - together)
    inertia = inertia + at.rotation @ own.inertia @ at.rotation.T
    inertia = inertia + point_mass_inertia(own.mass, center - together)
    file.set_inertial(parent, Inertial(total, together, inertia))
    file.remove_inertial(body)
    return Plant(touched=frozenset([body, parent]))


@common
def branch_dropped(file: ModelText, random: np.random.Generator) -> Plant:
    """Remove the last link of a branch, with its joint and its drive."""
    ends = [body for body in file.hinges().values() if len(file.branch(body)) == 1 and body in _heavy(file)]
    body = chosen(random, ends)
    joint = file.joints_above(body)[0]
    rows = tuple(Expected(name, Quantity.PRESENCE) for name in (body, *file.remove_branch(body)))
    return Plant(rows, touched=frozenset([body, joint]), has_truth=False)


# Joints


def _with_child(file: ModelText) -> dict[str, str]:
    """Return the hinges that move a heavy body, with the body."""
    return {joint: body for joint, body in file.hinges().items() if body in _heavy(file)}


def _outside_loops(file: ModelText) -> dict[str, str]:
    """Return the hinges that move a heavy body and are in no loop whose points another place would move."""
    return {joint: body for joint, body in _with_child(file).items() if not file.is_in_loop(body)}


def _free_to_turn(file: ModelText) -> dict[str, str]:
    """Return the hinges with limits and without drives, springs or couplings that depend on their zero."""
    found = {}
    for joint, body in _outside_loops(file).items():
        try:
            if file.limits(joint) is not None and not file.is_servo_driven(joint):
                found[joint] = body
        except NotApplicable:
            continue
    return found


def _jointed(joint: str, body: str, row: Expected) -> Plant:
    """Return a plant of one row of a joint, which also touches its body."""
    return Plant((row,), touched=frozenset([joint, body]))


@common
def joint_origin(file: ModelText, random: np.random.Generator) -> Plant:
    """Move a joint by 1 cm across its axis."""
    hinges = _outside_loops(file)
    joint = chosen(random, hinges)
    placement = file.placement(hinges[joint])
    shift = 0.01 * across(file.axis(joint))
    file.set_position(hinges[joint], placement.position + placement.rotation @ shift)
    return _jointed(joint, hinges[joint], Expected(joint, Quantity.JOINT_ORIGIN, 0.01))


@common
def joint_axis(file: ModelText, random: np.random.Generator) -> Plant:
    """Tilt the axis of a joint by 0.1 rad."""
    hinges = _with_child(file)
    joint = chosen(random, hinges)
    axis = file.axis(joint)
    file.set_axis(joint, turn(across(axis), 0.1) @ axis)
    return _jointed(joint, hinges[joint], Expected(joint, Quantity.JOINT_AXIS, 0.1))


@common
def sign_of_axis(file: ModelText, random: np.random.Generator) -> Plant:
    """Reverse the axis of a joint, but not its limits and drives."""
    hinges = {joint: body for joint, body in _with_child(file).items() if not file.is_symmetric(joint)}
    joint = chosen(random, hinges)
    file.reverse_drives(joint)  # refuses joints with springs and couplings
    file.reverse_drives(joint)
    file.set_axis(joint, -file.axis(joint))
    row = Expected(joint, Quantity.SIGN, None, "limits not mirrored")
    return Plant(
        (row,),
        touched=frozenset([joint, hinges[joint]]),
        coordinates={joint: Coordinate(joint, sense=-1.0, offset=2.0 * file.zero(joint))},
    )


@common
def sign_with_limits(file: ModelText, random: np.random.Generator) -> Plant:
    """Reverse the axis of a joint, its limits and its drives, which changes nothing."""
    hinges = _with_child(file)
    joint = chosen(random, hinges)
    file.reverse_drives(joint)
    limits = file.limits(joint)
    file.set_axis(joint, -file.axis(joint))
    file.set_zero(joint, -file.zero(joint))
    if limits is not None:
        file.set_limits(joint, (-limits[1], -limits[0]))
    return Plant(
        conventions=(Quantity.SIGN,),
        touched=frozenset([joint, hinges[joint]]),
        coordinates={joint: Coordinate(joint, sense=-1.0)},
    )


def _turned(file: ModelText, joint: str, body: str, rotation: Array) -> None:
    """Turn the placement of a body about a point of its joint's axis, in its own frame (3, 3)."""
    point = file.point(joint)
    inside = Placement(point - rotation @ point, rotation)
    file.set_placement(body, file.placement(body) @ inside)


@common
def zero_of_joint(file: ModelText, random: np.random.Generator) -> Plant:
    """Turn a link about its joint by 0.3 rad and shift the limits, which changes nothing."""
    hinges = _free_to_turn(file)
    joint = chosen(random, hinges)
    low, high = file.limits(joint) or (0.0, 0.0)
    _turned(file, joint, hinges[joint], turn(file.axis(joint), 0.3))
    file.set_limits(joint, (low - 0.3, high - 0.3))
    return Plant(
        conventions=(Quantity.ZERO,),
        touched=frozenset([joint, hinges[joint]]),
        coordinates={joint: Coordinate(joint, offset=-0.3)},
    )


@common
def link_turned_about_its_axis(file: ModelText, random: np.random.Generator) -> Plant:
    """Turn a link about its joint by 0.3 rad and leave the limits."""
    hinges = _free_to_turn(file)
    joint = chosen(random, hinges)
    _turned(file, joint, hinges[joint], turn(file.axis(joint), 0.3))
    return _jointed(joint, hinges[joint], Expected(joint, Quantity.ZERO, 0.3, "limits not moved"))


@common
def link_turned(file: ModelText, random: np.random.Generator) -> Plant:
    """Turn a link at its parent by 3 degrees about a direction across its axis."""
    hinges = _outside_loops(file)
    joint = chosen(random, hinges)
    angle = math.radians(3.0)
    _turned(file, joint, hinges[joint], turn(across(file.axis(joint)), angle))
    words = "turned at its parent by 3 degrees"
    return _jointed(joint, hinges[joint], Expected(joint, Quantity.JOINT_AXIS, angle, words))


@common
def frame_turned(file: ModelText, random: np.random.Generator) -> Plant:
    """Turn the frame of a link by 1 rad, with all contents in the new frame, which changes nothing."""
    hinges = _with_child(file)
    body = chosen(random, hinges.values())
    file.set_frame(body, Placement(np.zeros(3), turn(np.array([1.0, 2.0, 3.0]), 1.0)))
    return Plant(conventions=(Quantity.FRAME,), touched=frozenset([body, *file.joints_above(body)]))


@common
def frame_moved(file: ModelText, random: np.random.Generator) -> Plant:
    """Move the frame of a link by 5 cm along its joint's axis, which changes nothing."""
    hinges = _with_child(file)
    joint = chosen(random, hinges)
    body = hinges[joint]
    file.set_frame(body, Placement(0.05 * file.axis(joint), np.eye(3)))
    return Plant(conventions=(Quantity.FRAME,), touched=frozenset([body, joint]))


def _number(
    file: ModelText,
    random: np.random.Generator,
    name: str,
    quantity: Quantity,
    size: float,
    joints: Iterable[str] | None = None,
) -> Plant:
    """Make a number of one of the joints larger by half, or give it a size if it is zero or infinite."""
    joint = chosen(random, _with_child(file) if joints is None else joints)
    value = file.number(joint, name)
    is_given = value and math.isfinite(value)
    file.set_number(joint, name, 1.5 * value if is_given else size)
    return one(joint, quantity, 0.5 if is_given else 1.0)


@common
def damping(file: ModelText, random: np.random.Generator) -> Plant:
    """Make the damping of a joint larger by 50 %, or give it 0.3 N m s/rad."""
    return _number(file, random, "damping", Quantity.DAMPING, 0.3)


@common
def dry_friction(file: ModelText, random: np.random.Generator) -> Plant:
    """Make the dry friction of a joint larger by 50 %, or give it 0.2 N m."""
    return _number(file, random, "friction", Quantity.FRICTION, 0.2)


@common
def effort_limit(file: ModelText, random: np.random.Generator) -> Plant:
    """Make the effort limit of a driven joint larger by 50 %, or give it 50 N m."""
    driven = [joint for joint in _with_child(file) if file.can_be_driven(joint)]
    return _number(file, random, "effort", Quantity.EFFORT, 50.0, driven)


@common
def limits(file: ModelText, random: np.random.Generator) -> Plant:
    """Raise the upper limit of a joint by 0.2 rad."""
    limits = {joint: file.limits(joint) for joint in _with_child(file)}
    joint = chosen(random, (name for name, each in limits.items() if each is not None))
    low, high = limits[joint] or (0.0, 0.0)
    file.set_limits(joint, (low, high + 0.2))
    return one(joint, Quantity.LIMITS, 0.2)


@common
def limits_in_degrees(file: ModelText, random: np.random.Generator) -> Plant:
    """Write all limits of hinges in degrees where radians are expected."""
    limits = {joint: file.limits(joint) for joint in file.hinges()}
    given = {joint: each for joint, each in limits.items() if each is not None and any(each)}
    if len(given) < 3:
        raise NotApplicable("fewer than three limits")
    for joint, (low, high) in given.items():
        file.set_limits(joint, (math.degrees(low), math.degrees(high)))
    return Plant((Expected("", Quantity.LIMITS, None, "rad against degrees"),))


@common
def damping_in_degrees(file: ModelText, random: np.random.Generator) -> Plant:
    """Write the damping of all hinges per degree where radians are expected."""
    damped = {joint: file.number(joint, "damping") for joint in file.hinges()}
    if sum(value > 0.0 for value in damped.values()) < 3:
        raise NotApplicable("fewer than three joints have damping")
    for joint, value in damped.items():
        if value:
            file.set_number(joint, "damping", math.degrees(value))
    return Plant((Expected("", Quantity.DAMPING, math.degrees(1.0) - 1.0, "rad against degrees"),))


# Robot


@common
def masses_rounded(file: ModelText, random: np.random.Generator) -> Plant:
    """Write all masses with two decimals."""
    masses = {body: file.inertial(body).mass for body in file.bodies() if file.has_inertial(body)}
    if (
        sum(abs(round(mass, 2) - mass) > 1e-3 * mass for mass in masses.values()) < 3
        or min(masses.values()) < 0.01
    ):
        raise NotApplicable("fewer than three masses have more decimals")
    for body, mass in masses.items():
        file.set_mass(body, round(mass, 2))
    return Plant((Expected("", Quantity.MASS, None, "rounded to 2 decimals in the second file"),))


@common
def masses_in_grams(file: ModelText, random: np.random.Generator) -> Plant:
    """Multiply all masses and inertias by 1000."""
    bodies = [body for body in file.bodies() if file.has_inertial(body)]
    if len(bodies) < 3:
        raise NotApplicable("the file states no masses")
    for body in bodies:
        own = file.inertial(body)
        file.set_inertial(body, own._replace(mass=1000.0 * own.mass, inertia=1000.0 * own.inertia))
    return Plant((Expected("", Quantity.MASS, 999.0, "times 1000 (kg against g"),))


@common
def lengths_in_millimeters(file: ModelText, random: np.random.Generator) -> Plant:
    """Multiply all lengths by 1000, and inertias by 1e6."""
    if not file.moving_bodies():
        raise NotApplicable("the file does not state all masses")
    for body in file.bodies():
        if file.parent(body) is not None:
            file.set_position(body, 1000.0 * file.placement(body).position)
        for joint in file.joints_above(body):
            if joint and np.any(file.point(joint)):
                file.set_point(joint, 1000.0 * file.point(joint))
        if file.has_inertial(body):
            own = file.inertial(body)
            scaled = own._replace(center=1000.0 * own.center, inertia=1e6 * own.inertia)
            file.set_inertial(body, scaled)
    file.scale_loops(1000.0)
    others = (Quantity.CENTER, Quantity.LOOP_POINT)
    return Plant((Expected("", Quantity.JOINT_ORIGIN, None, "times 1000 (m against mm", others),))


@common
def left_and_right_exchanged(file: ModelText, random: np.random.Generator) -> Plant:
    """Exchange the mass properties of a left and the same right link."""
    names = {*_heavy(file)}
    pairs = {}
    for left in names:
        for word, other in (("left", "right"), ("L", "R"), ("l", "r")):
            if left.startswith(word) or left.endswith(word):
                right = (
                    left.replace(word, other, 1) if left.startswith(word) else left.removesuffix(word) + other
                )
                if right in names and not _is_alike(file.inertial(left), file.inertial(right)):
                    pairs[left] = right
    left = chosen(random, sorted(pairs))
    return _exchange(file, left, pairs[left])


@common
def two_links_exchanged(file: ModelText, random: np.random.Generator) -> Plant:
    """Exchange the mass properties of two links."""
    bodies = _heavy(file)
    first = chosen(random, bodies)
    own = file.inertial(first)
    second = chosen(random, [other for other in bodies if not _is_alike(own, file.inertial(other))])
    return _exchange(file, first, second)


def _is_alike(one: Inertial, other: Inertial) -> bool:
    """Return whether masses differ by less than 5 % and centers by less than 5 mm."""
    return math.isclose(one.mass, other.mass, rel_tol=0.05) and math.dist(one.center, other.center) < 0.005


def _exchange(file: ModelText, first: str, second: str) -> Plant:
    """Exchange the mass properties of two bodies."""
    one, other = file.inertial(first), file.inertial(second)
    file.set_inertial(first, other)
    file.set_inertial(second, one)
    quantity = Quantity.CENTER if math.isclose(one.mass, other.mass, rel_tol=1e-9) else Quantity.MASS
    return Plant((Expected(first, quantity, None, "exchanged"),), touched=frozenset([first, second]))


@common
def joint_order(file: ModelText, random: np.random.Generator) -> Plant:
    """Write the branches of a body in the opposite order, which changes nothing."""
    parents = [body for body in file.bodies() if len(_jointed_children(file, body)) > 1]
    body = chosen(random, parents)
    file.reverse_order(_jointed_children(file, body))
    return Plant()


def _jointed_children(file: ModelText, body: str) -> list[str]:
    """Return the children of a body that joints move."""
    return [child for child in file.children(body) if file.joints_above(child)]


@common
def names_with_prefix(file: ModelText, random: np.random.Generator) -> Plant:
    """Put a word before the names of all bodies and joints, which changes nothing."""
    joints = [joint for body in file.bodies() for joint in file.joints_above(body)]
    names = {name: f"robot1_{name}" for name in (*file.bodies(), *filter(None, joints))}
    file.rename(names)
    return Plant(coordinates={joint: Coordinate(names[joint]) for joint in filter(None, joints)})


@common
def other_names(file: ModelText, random: np.random.Generator) -> Plant:
    """Number all bodies and joints instead of their names, which changes nothing."""
    joints = [joint for body in file.bodies() for joint in file.joints_above(body)]
    names = {name: f"part_{number}" for number, name in enumerate((*file.bodies(), *filter(None, joints)))}
    file.rename(names)
    return Plant(coordinates={joint: Coordinate(names[joint]) for joint in filter(None, joints)})
