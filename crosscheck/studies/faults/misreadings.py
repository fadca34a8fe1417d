"""Faults of a reading: whatever a reader carries over, mistaken in one place.

Values of each element are doubled, halved, dropped, negated, a millionth more, and exchanged with those of
the next element of their kind; joints, offsets and points of forces are moved and tilted by a millionth and
by a tenth; joints are taken for others and for rigid; loops are left open or closed elsewhere.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np

from crosscheck.studies.faults import plant
from crosscheck.studies.faults.catalog import SKEW, Fault, bodies_at, other_kinds
from newton_euler.assemble import initial_state
from newton_euler.errors import NewtonEulerError
from newton_euler.model.compound_joint import Compound
from newton_euler.model.control import PD, Law, Sampled
from newton_euler.model.couplings import Gear, JointCoupling, LinearCoupling
from newton_euler.model.elements import OnBodies, OnCoordinate
from newton_euler.model.forces import Force, Wrench
from newton_euler.model.joint import Joint
from newton_euler.model.joint_kinds import Fixed
from newton_euler.model.mechanism import Body
from newton_euler.model.scene import Scene
from newton_euler.model.spanning_tree import SpanningTree
from newton_euler.scalars import Array

FACTORS = {"doubled": 2.0, "halved": 0.5, "dropped": 0.0, "negated": -1.0, "times 1 + 1e-6": 1.0 + 1e-6}

SMALL, LARGE = 1e-6, 0.1
"""rad, and sizes."""

ORDER = [1, 2, 0]
"""Of axes that vectors and inertias are permuted to."""

EVERYTHING = "all bodies"

PLACES = ("rest", "target", "point", "point_on_first", "point_on_second")
"""Attributes of forces and laws that are coordinates and points: to be moved, for no factor changes 0."""


def misreadings(scene: Scene) -> Iterator[Fault]:
    """All faults of a scene that was read; those that no scene can have are left out."""
    yield from _of_bodies(scene)
    for index, joint in enumerate(scene.mechanism.joints):
        for fault in _of_joint(scene, index, joint):
            yield replace(fault, near=bodies_at(joint))
    for field in ("control", "forces"):
        for index, force in enumerate(getattr(scene, field)):
            yield from _of_force(scene, field, index, force)
    for index, rotor in enumerate(scene.armatures):
        for what, factor in FACTORS.items():
            if factor > 0.0:
                other = plant.entry("armatures", index, inertia=factor * rotor.inertia)
                yield _fault("armature", rotor.joint, what, other)
        yield _fault("armature", rotor.joint, "dropped", plant.without("armatures", index))
        if isinstance(rotor, OnCoordinate):
            for k in _others(scene, rotor.joint, rotor.coordinate):
                moved = plant.entry("armatures", index, coordinate=k)
                yield _fault("armature", rotor.joint, f"on coordinate {k}", moved)
    for index, motion in enumerate(scene.motions):
        yield _fault("equality", motion.joint, "dropped", plant.without("motions", index))
    for index, coupling in enumerate(scene.mechanism.couplings):
        for what, changed in _other_couplings(scene, coupling):
            yield _fault("gear", coupling.name, what, plant.coupling(index, changed))
    if np.any(initial_state(scene).linear_velocity) or np.any(initial_state(scene).angular_velocity):
        for what, factor in FACTORS.items():
            yield _fault("velocity", EVERYTHING, what, _faster(factor))
    yield from _exchanged(scene)
    yield from _of_gravity(scene)


def _faster(factor: float) -> plant.Plant:
    def planted(scene: Scene) -> Scene:
        start = initial_state(scene)
        linear, angular = factor * start.linear_velocity, factor * start.angular_velocity
        return replace(scene, initial_state=replace(start, linear_velocity=linear, angular_velocity=angular))

    return planted


def _of_gravity(scene: Scene) -> Iterator[Fault]:
    if np.any(scene.gravity):
        for what, factor in FACTORS.items():
            yield _fault("gravity", "gravity", what, plant.gravity(factor * scene.gravity))
        for angle in (SMALL, LARGE):
            turned = plant.gravity(plant.turned_about(SKEW, angle) @ scene.gravity)
            yield _fault("gravity", "gravity", f"turned by {angle:g}", turned)


# Bodies


def _of_bodies(scene: Scene) -> Iterator[Fault]:
    bodies, size = scene.mechanism.body_names[1:], scene.mechanism.size
    for what, factor in FACTORS.items():
        share = factor if factor else plant.REMAINS
        if share < 0.0:
            continue  # no engine takes such
        for body in bodies:
            yield _fault("mass", body, what, plant.mass(body, share - 1.0))
            yield _fault("inertia", body, what, plant.change_bodies({body: _scaled("inertia", share)}))
        scaled = plant.change_bodies(dict.fromkeys(bodies, _scaled("mass", share)))
        yield _fault("mass", EVERYTHING, what, scaled)
    for body in bodies:
        yield _fault("inertia", body, "permuted", plant.change_bodies({body: _permuted}))
        for angle in (SMALL, LARGE):
            yield _fault("frame", body, f"turned by {angle:g}", plant.inertia_frame(body, SKEW, angle))
            shifted = plant.center_of_mass(body, angle * size * SKEW)
            yield _fault("center of mass", body, f"moved by {angle:g}", shifted)
    yield _fault("inertia", EVERYTHING, "permuted", plant.change_bodies(dict.fromkeys(bodies, _permuted)))
    for first, second in pairwise(scene.mechanism.bodies[1:]):
        right = frozenset({first.name, second.name})
        swapped = _fault("mass and inertia", first.name, "exchanged", plant.swapped_bodies(first, second))
        yield replace(swapped, right=right)


def _scaled(name: str, share: float) -> Callable[[Body], dict[str, Any]]:
    return lambda body: {name: share * getattr(body, name)}


def _permuted(body: Body) -> dict[str, Any]:
    return {"inertia": body.inertia[np.ix_(ORDER, ORDER)]}


# Joints


def _of_joint(scene: Scene, index: int, joint: Joint) -> Iterator[Fault]:
    size, name = scene.mechanism.size, joint.name
    coupled = (c.name for c in scene.mechanism.couplings if name in {key[0] for key in c.factors()})
    axis = replace(_fault("axis", name, "", _unchanged), right=frozenset({name, *coupled}))
    rows = [
        (each, k) for each in ("slides", "hinges", "offsets") for k in range(len(getattr(joint, each, ())))
    ]
    for angle in (SMALL, LARGE):
        for direction, tilted in plant.tilted(joint, angle).items():
            yield replace(axis, detail=f"tilted by {angle:g} {direction}", plant=tilted)
        for direction, shift in (
            ("", SKEW),
            *zip((" along x", " along y", " along z"), np.eye(3), strict=True),
        ):
            moved = plant.joint_point(name, angle * size * shift)
            yield _fault("joint point", name, f"moved by {angle:g}{direction}", moved)
        for each, k in rows:
            if each == "offsets":
                moved = plant.row_of(joint, each, k, _added(angle * size * SKEW))
                yield _fault("offset", name, f"{k} moved by {angle:g}", moved)
    for each in joint.axis_names:
        turned = plant.joint_axes(name, {each: -getattr(joint, each)})
        yield replace(axis, detail=f"{each} the other way", plant=turned)
    for each, k in rows:
        if each == "offsets":
            for what, factor in FACTORS.items():
                if np.any(getattr(joint, each)[k]):
                    yield _fault("offset", name, f"{k} {what}", plant.row_of(joint, each, k, _times(factor)))
        else:
            turned = plant.row_of(joint, each, k, _times(-1.0))
            yield replace(axis, detail=f"{each}[{k}] the other way", plant=turned)
    if isinstance(joint, Compound) and len(joint.hinges) > 1:
        turned = plant.joint_axes(name, {"hinges": joint.hinges[::-1]})
        yield replace(axis, detail="hinges in the other order", plant=turned)
    for kind, axes in other_kinds(scene, joint).items():
        yield _fault("joint type", name, f"{joint.kind} as {kind}", plant.joint_kind(joint, kind, **axes))
    if index in SpanningTree(scene.mechanism).cuts:
        for angle in (SMALL, LARGE):
            opened = plant.closure_point(name, angle * size * SKEW)
            yield _fault("equality", name, f"its second point moved by {angle:g}", opened)
    if not isinstance(joint, Fixed):
        yield _fault("joint", name, "read as rigid", _welded(joint))
    with suppress(NewtonEulerError):  # for a joint that is all that holds a body
        plant.missing_joint(name)(_bare(scene, name))
        yield _fault("equality", name, "dropped", lambda s: plant.missing_joint(name)(_bare(s, name)))


def _unchanged(scene: Scene) -> Scene:
    return scene


def _added(shift: Array) -> Callable[[Array], Array]:
    return lambda row: row + shift


def _times(factor: float) -> Callable[[Array], Array]:
    return lambda row: factor * row


def _bare(scene: Scene, joint: str) -> Scene:
    """The scene without anything that acts on a joint's coordinates."""

    def kept(entries: Any) -> Any:
        return tuple(entry for entry in entries if getattr(entry, "joint", None) != joint)

    mechanism = scene.mechanism
    couplings = [c for c in mechanism.couplings if joint not in {key[0] for key in c.factors()}]
    return replace(
        scene,
        mechanism=type(mechanism)(mechanism.bodies, mechanism.joints, couplings),
        initial_state=None,
        control=kept(scene.control),
        forces=kept(scene.forces),
        motions=kept(scene.motions),
        armatures=kept(scene.armatures),
    )


def _welded(joint: Joint) -> plant.Plant:
    return lambda scene: plant.joint_kind(joint, "fixed")(_bare(scene, joint.name))


# Forces, laws and couplings


def _of_force(scene: Scene, field: str, index: int, force: Law | Force) -> Iterator[Fault]:
    """Values, points and frames of a force or a law."""
    for name in force.parameters:
        value = getattr(force, name)
        if name in PLACES and _is_slack(force):
            continue
        for what, factor in FACTORS.items() if np.any(value) else ():
            if factor >= 0.0 or isinstance(force, PD | Wrench):
                yield _of_value(field, index, force, name, what, factor * value)
        if isinstance(value, np.ndarray) and np.ptp(value):
            yield _of_value(field, index, force, name, "permuted", value[ORDER])
    if not _is_slack(force):
        for name in PLACES:
            for angle in (SMALL, LARGE) if hasattr(force, name) else ():
                value = getattr(force, name)
                unit = scene.mechanism.size if _is_length(scene, force) else 1.0
                moved = value + angle * unit * (SKEW if isinstance(value, np.ndarray) else 1.0)
                yield _of_value(field, index, force, name, f"moved by {angle:g}", moved)
    if isinstance(force, Wrench):
        other = "body" if force.frame == "world" else "world"
        yield _of_value(field, index, force, "frame", f"taken for that of the {other}", other)
    if isinstance(force, OnCoordinate):
        for k in _others(scene, force.joint, force.coordinate):
            yield _of_value(field, index, force, "coordinate", f"taken for {k}", k)
    yield _fault(type(force).__name__, _element(force), "dropped", plant.without(field, index))


def _is_slack(force: Law | Force) -> bool:
    """True of a force or a law that rests anywhere."""
    return not isinstance(force, OnBodies | Sampled) and not force.stiffness


def _of_value(field: str, index: int, force: Law | Force, name: str, what: str, value: object) -> Fault:
    planted = plant.entry(field, index, **{name: value})
    return _fault(f"{name} of {type(force).__name__}", _element(force), what, planted)


def _is_length(scene: Scene, force: Law | Force) -> bool:
    if isinstance(force, OnCoordinate):
        joint = scene.mechanism.joint(force.joint)
        return joint.coordinate_kinds[force.coordinate] == "slide"
    return not force.on_ball


def _others(scene: Scene, joint: str, coordinate: int) -> Iterator[int]:
    """Coordinates of a joint beside one."""
    kinds = scene.mechanism.joint(joint).coordinate_kinds
    yield from (k for k in range(len(kinds)) if k != coordinate)


def _element(force: Law | Force) -> str:
    return force.name if isinstance(force, OnBodies) else force.joint


def _other_couplings(scene: Scene, coupling: JointCoupling) -> Iterator[tuple[str, JointCoupling | None]]:
    """A coupling with each of its factors but the first changed, on other coordinates, and none."""
    yield "dropped", None
    factors = {what: factor for what, factor in FACTORS.items() if factor}
    if isinstance(coupling, Gear):
        for what, factor in factors.items():
            yield what, replace(coupling, ratio=factor * coupling.ratio)
        for k in _others(scene, coupling.driver, coupling.driver_coordinate):
            if (coupling.driver, k) != (coupling.follower, coupling.follower_coordinate):
                yield f"driven by coordinate {k}", replace(coupling, driver_coordinate=k)
        return
    assert isinstance(coupling, LinearCoupling)
    for n, (joint, coordinate, own) in enumerate(coupling.terms):
        for what, factor in factors.items() if n else ():
            terms = [*coupling.terms]
            terms[n] = joint, coordinate, factor * own
            yield f"term {n} {what}", replace(coupling, terms=tuple(terms))
        if len(coupling.terms) > 2:
            yield f"term {n} dropped", replace(coupling, terms=coupling.terms[:n] + coupling.terms[n + 1 :])


def _exchanged(scene: Scene) -> Iterator[Fault]:
    """Values of neighbors of a kind, each with the other's."""
    for field in ("control", "forces", "armatures"):
        entries: tuple[Any, ...] = getattr(scene, field)
        for kind in dict.fromkeys(map(type, entries)):
            numbers = [k for k, entry in enumerate(entries) if type(entry) is kind]
            for i, j in pairwise(numbers):
                for name in getattr(entries[i], "parameters", ("inertia",)):
                    one, two = getattr(entries[i], name), getattr(entries[j], name, None)
                    slack = name in PLACES and _is_slack(entries[i]) and _is_slack(entries[j])
                    if two is None or slack or np.array_equal(one, two):
                        continue
                    elements = [_element(entry) for entry in (entries[i], entries[j])]
                    swapped = _both(
                        plant.entry(field, i, **{name: two}), plant.entry(field, j, **{name: one})
                    )
                    fault = _fault(
                        f"{name} of {kind.__name__}", elements[0], f"exchanged with {elements[1]}", swapped
                    )
                    yield replace(fault, right=frozenset(elements))


def _both(one: plant.Plant, two: plant.Plant) -> plant.Plant:
    return lambda scene: two(one(scene))


def _fault(kind: str, element: str, detail: str, planted: plant.Plant) -> Fault:
    return Fault(kind, element, detail, None, planted, frozenset({element}))
