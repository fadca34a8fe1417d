"""Faults of a reading: whatever a reader carries over, mistaken in one place.

Numbers of bodies and joints, and points of forces, are off by a tenth and by a millionth, as they are in an
engine's model; what acts is doubled, halved, dropped, negated and a millionth more; joints are taken for
others and for rigid; loops are left open or closed elsewhere.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np

from crosscheck.studies.faults import plant
from crosscheck.studies.faults.catalog import SKEW, Fault, bodies_at, mistaken, of_numbers
from newton_euler.errors import NewtonEulerError
from newton_euler.model.compound_joint import Compound
from newton_euler.model.control import PD
from newton_euler.model.couplings import Gear, JointCoupling, LinearCoupling, PolynomialCoupling
from newton_euler.model.digital_control import Law
from newton_euler.model.elements import OnBodies, OnCoordinate
from newton_euler.model.forces import BallSpring, Force, JointSpring, Wrench
from newton_euler.model.joint import Joint
from newton_euler.model.joint_kinds import Fixed
from newton_euler.model.motions import TimeFunction, scaled
from newton_euler.model.scene import Scene
from newton_euler.runs.assemble import initial_state

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
    of_joints = [
        replace(fault, near=bodies_at(joint))
        for joint in scene.mechanism.joints
        for fault in _of_joint(scene, joint)
    ]
    numbers = *of_numbers(scene, SMALL), *of_numbers(scene, LARGE)
    for fault in (*numbers, *mistaken(scene), *of_joints):
        coupled = (c.name for c in scene.mechanism.couplings if fault.element in _joints_of(c))
        if fault.kind != "quaternion order":  # frames of bodies are the reader's own choice
            yield replace(fault, right=fault.right.union(coupled))
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


def _joints_of(coupling: JointCoupling) -> set[str]:
    return {key[0] for key in coupling.factors()}


def _faster(factor: float) -> plant.Plant:
    def planted(scene: Scene) -> Scene:
        start = initial_state(scene)
        linear, angular = factor * start.linear_velocity, factor * start.angular_velocity
        return replace(scene, initial_state=replace(start, linear_velocity=linear, angular_velocity=angular))

    return planted


# Joints


def _of_joint(scene: Scene, joint: Joint) -> Iterator[Fault]:
    """Joints that are rigid or missing, and hinges in a row whose axes do not meet."""
    name, offsets = joint.name, getattr(joint, "offsets", ())
    for k, offset in enumerate(offsets):
        for angle in (SMALL, LARGE):
            shift = angle * scene.mechanism.size * SKEW
            moved = plant.row_of(joint, "offsets", k, lambda row, shift=shift: row + shift)  # type: ignore[misc]
            yield _fault("offset", name, f"{k} moved by {angle:g}", moved)
        for what, factor in FACTORS.items() if np.any(offset) else ():
            other = plant.row_of(joint, "offsets", k, lambda row, factor=factor: factor * row)  # type: ignore[misc]
            yield _fault("offset", name, f"{k} {what}", other)
    if isinstance(joint, Compound) and len(joint.hinges) > 1:
        turned = plant.joint_axes(name, {"hinges": joint.hinges[::-1]})
        yield _fault("axis", name, "hinges in the other order", turned)
    if not isinstance(joint, Fixed):
        yield _fault("joint", name, "read as rigid", _welded(joint))
    with suppress(NewtonEulerError):  # for a joint that is all that holds a body
        plant.missing_joint(name)(_bare(scene, name))
        yield _fault("equality", name, "dropped", lambda s: plant.missing_joint(name)(_bare(s, name)))


def _bare(scene: Scene, joint: str) -> Scene:
    """The scene without anything that acts on a joint's coordinates."""

    def kept(entries: Any) -> Any:
        return tuple(entry for entry in entries if getattr(entry, "joint", None) != joint)

    mechanism = scene.mechanism
    couplings = [c for c in mechanism.couplings if joint not in _joints_of(c)]
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
        if isinstance(value, Mapping):
            continue  # files have no gains of other coordinates
        if name in PLACES and _is_slack(force):
            continue
        for what, factor in FACTORS.items() if np.any(value) else ():
            if factor >= 0.0 or isinstance(force, PD | Wrench):
                other = scaled(value, factor) if isinstance(value, TimeFunction) else factor * value
                yield _of_value(field, index, force, name, what, other)
        if isinstance(value, np.ndarray) and np.ptp(value):
            yield _of_value(field, index, force, name, "permuted", value[ORDER])
    if not _is_slack(force):
        for name in PLACES:
            for angle in (SMALL, LARGE) if hasattr(force, name) else ():
                value = getattr(force, name)
                if isinstance(value, TimeFunction):
                    continue  # files have none
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
    return isinstance(force, PD | JointSpring | BallSpring) and not force.stiffness


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
    if isinstance(coupling, PolynomialCoupling):
        for power, own in enumerate(coupling.coefficients, start=1):
            for what, factor in factors.items() if own else ():
                coefficients = [*coupling.coefficients]
                coefficients[power - 1] = factor * own
                yield f"power {power} {what}", replace(coupling, coefficients=tuple(coefficients))
    if isinstance(coupling, Gear):
        for what, factor in factors.items():
            yield what, replace(coupling, ratio=factor * coupling.ratio)
    if isinstance(coupling, Gear | PolynomialCoupling):
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


def _fault(kind: str, element: str, detail: str, planted: plant.Plant) -> Fault:
    return Fault(kind, element, detail, None, planted, frozenset({element}))
