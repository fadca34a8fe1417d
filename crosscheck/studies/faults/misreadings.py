"""Catalog of the faults of a reading: a reader of model files makes one mistake.

Numbers of bodies and joints, and points of forces, have relative errors of 1e-1 and 1e-6. Strengths of forces
are doubled, halved, dropped, negated, or have a relative error of 1e-6. Joints are confused with other kinds
or read as rigid. Loops stay open or are closed at another point.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np

from crosscheck.studies.faults import injection
from crosscheck.studies.faults.catalog import SKEW_AXIS, Fault, bodies_at, mistaken, of_numbers
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

SMALL_SHIFT, LARGE_SHIFT = 1e-6, 0.1
"""Sizes of shifts, relative to the mechanism's size or in rad."""

PERMUTED_AXES = [1, 2, 0]
"""Order of the components of permuted vectors and inertias."""

EVERYTHING = "all bodies"

SHIFTED_ATTRIBUTES = ("rest", "target", "point", "point_on_first", "point_on_second")
"""Attributes of forces and controllers that are coordinates or points. They are shifted: no factor changes
0."""


def misreadings(scene: Scene) -> Iterator[Fault]:
    """Yield the faults of a reading that a scene can contain."""
    of_joints = [
        replace(fault, near=bodies_at(joint))
        for joint in scene.mechanism.joints
        for fault in _of_joint(scene, joint)
    ]
    numbers = *of_numbers(scene, SMALL_SHIFT), *of_numbers(scene, LARGE_SHIFT)
    for fault in (*numbers, *mistaken(scene), *of_joints):
        coupled = (c.name for c in scene.mechanism.couplings if fault.element in _joints_of(c))
        if fault.kind != "quaternion order":  # a reader is free to choose the frames of bodies
            yield replace(fault, right=fault.right.union(coupled))
    for field in ("control", "forces"):
        for index, force in enumerate(getattr(scene, field)):
            yield from _of_force(scene, field, index, force)
    for index, rotor in enumerate(scene.armatures):
        for what, factor in FACTORS.items():
            if factor > 0.0:
                other = injection.entry("armatures", index, inertia=factor * rotor.inertia)
                yield _fault("armature", rotor.joint, what, other)
        yield _fault("armature", rotor.joint, "dropped", injection.without("armatures", index))
        if isinstance(rotor, OnCoordinate):
            for k in _others(scene, rotor.joint, rotor.coordinate):
                moved = injection.entry("armatures", index, coordinate=k)
                yield _fault("armature", rotor.joint, f"on coordinate {k}", moved)
    for index, motion in enumerate(scene.motions):
        yield _fault("equality", motion.joint, "dropped", injection.without("motions", index))
    for index, coupling in enumerate(scene.mechanism.couplings):
        for what, changed in _other_couplings(scene, coupling):
            yield _fault("gear", coupling.name, what, injection.coupling(index, changed))
    if np.any(initial_state(scene).linear_velocity) or np.any(initial_state(scene).angular_velocity):
        for what, factor in FACTORS.items():
            yield _fault("velocity", EVERYTHING, what, _faster(factor))


def _joints_of(coupling: JointCoupling) -> set[str]:
    return {key[0] for key in coupling.factors()}


def _faster(factor: float) -> injection.Injection:
    def injected(scene: Scene) -> Scene:
        start = initial_state(scene)
        linear, angular = factor * start.linear_velocity, factor * start.angular_velocity
        return replace(scene, initial_state=replace(start, linear_velocity=linear, angular_velocity=angular))

    return injected


# Joints


def _of_joint(scene: Scene, joint: Joint) -> Iterator[Fault]:
    """Yield faults of a joint: wrong offsets and order of its hinges, a rigid joint, a missing joint."""
    name, offsets = joint.name, getattr(joint, "offsets", ())
    for k, offset in enumerate(offsets):
        for angle in (SMALL_SHIFT, LARGE_SHIFT):
            shift = angle * scene.mechanism.size * SKEW_AXIS
            moved = injection.row_of(joint, "offsets", k, lambda row, shift=shift: row + shift)  # type: ignore[misc]
            yield _fault("offset", name, f"{k} moved by {angle:g}", moved)
        for what, factor in FACTORS.items() if np.any(offset) else ():
            other = injection.row_of(joint, "offsets", k, lambda row, factor=factor: factor * row)  # type: ignore[misc]
            yield _fault("offset", name, f"{k} {what}", other)
    if isinstance(joint, Compound) and len(joint.hinges) > 1:
        turned = injection.joint_axes(name, {"hinges": joint.hinges[::-1]})
        yield _fault("axis", name, "hinges in the other order", turned)
    if not isinstance(joint, Fixed):
        yield _fault("joint", name, "read as rigid", _welded(joint))
    with suppress(NewtonEulerError):  # raised for a joint that alone connects a body
        injection.missing_joint(name)(_bare(scene, name))
        yield _fault("equality", name, "dropped", lambda s: injection.missing_joint(name)(_bare(s, name)))


def _bare(scene: Scene, joint: str) -> Scene:
    """Return the scene without forces, motions and couplings that act on a joint's coordinates."""

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


def _welded(joint: Joint) -> injection.Injection:
    return lambda scene: injection.joint_kind(joint, "fixed")(_bare(scene, joint.name))


# Forces, laws and couplings


def _of_force(scene: Scene, field: str, index: int, force: Law | Force) -> Iterator[Fault]:
    """Yield faults in the values, points and frames of a force or a controller."""
    for name in force.parameters:
        value = getattr(force, name)
        if isinstance(value, Mapping):
            continue  # gains on other coordinates do not occur in model files
        if name in SHIFTED_ATTRIBUTES and _is_slack(force):
            continue
        for what, factor in FACTORS.items() if np.any(value) else ():
            if factor >= 0.0 or isinstance(force, PD | Wrench):
                other = scaled(value, factor) if isinstance(value, TimeFunction) else factor * value
                yield _of_value(field, index, force, name, what, other)
        if isinstance(value, np.ndarray) and np.ptp(value):
            yield _of_value(field, index, force, name, "permuted", value[PERMUTED_AXES])
    if not _is_slack(force):
        for name in SHIFTED_ATTRIBUTES:
            for angle in (SMALL_SHIFT, LARGE_SHIFT) if hasattr(force, name) else ():
                value = getattr(force, name)
                if isinstance(value, TimeFunction):
                    continue  # functions of time do not occur in model files
                unit = scene.mechanism.size if _is_length(scene, force) else 1.0
                moved = value + angle * unit * (SKEW_AXIS if isinstance(value, np.ndarray) else 1.0)
                yield _of_value(field, index, force, name, f"moved by {angle:g}", moved)
    if isinstance(force, Wrench):
        other = "body" if force.frame == "world" else "world"
        yield _of_value(field, index, force, "frame", f"taken for that of the {other}", other)
    if isinstance(force, OnCoordinate):
        for k in _others(scene, force.joint, force.coordinate):
            yield _of_value(field, index, force, "coordinate", f"taken for {k}", k)
    yield _fault(type(force).__name__, _element(force), "dropped", injection.without(field, index))


def _is_slack(force: Law | Force) -> bool:
    """Return True if a force or controller has no stiffness, so that its rest position has no effect."""
    return isinstance(force, PD | JointSpring | BallSpring) and not force.stiffness


def _of_value(field: str, index: int, force: Law | Force, name: str, what: str, value: object) -> Fault:
    injected = injection.entry(field, index, **{name: value})
    return _fault(f"{name} of {type(force).__name__}", _element(force), what, injected)


def _is_length(scene: Scene, force: Law | Force) -> bool:
    if isinstance(force, OnCoordinate):
        joint = scene.mechanism.joint(force.joint)
        return joint.coordinate_kinds[force.coordinate] == "slide"
    return not force.on_ball


def _others(scene: Scene, joint: str, coordinate: int) -> Iterator[int]:
    """Yield the other coordinates of a joint."""
    kinds = scene.mechanism.joint(joint).coordinate_kinds
    yield from (k for k in range(len(kinds)) if k != coordinate)


def _element(force: Law | Force) -> str:
    return force.name if isinstance(force, OnBodies) else force.joint


def _other_couplings(scene: Scene, coupling: JointCoupling) -> Iterator[tuple[str, JointCoupling | None]]:
    """Yield a coupling with one changed factor (except the first), on another coordinate, and None for
    dropped."""
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


def _fault(kind: str, element: str, detail: str, inject: injection.Injection) -> Fault:
    return Fault(kind, element, detail, None, inject, frozenset({element}))
