"""Catalog of misreadings: single mistakes that the code that reads MJCF and URDF files could make.

A study injects each mistake into a scene that was read from a file, and verifies the scene against the file.
Numbers of bodies and joints, and points of forces, have relative errors of 1e-1 and 1e-6. Strengths of forces
are doubled, halved, set to zero, negated, or have a relative error of 1e-6. Joints are confused with other
kinds or read as rigid. Loops stay open or are closed at another point. Each mistake is a `Fault`: a function
that makes the scene with the mistake, and the names of the elements that a correct diagnosis may name.

Two kinds of faults have short names: "equality" (after the MJCF element) is a missing joint or prescribed
motion, "gear" is a fault of any coupling.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np

from crosscheck.studies.faults import injection
from crosscheck.studies.faults.catalog import (
    SKEW_AXIS,
    Fault,
    confusion_faults,
    connected_bodies,
    number_faults,
)
from newton_euler.errors import NewtonEulerError
from newton_euler.model.compound_joint import Compound
from newton_euler.model.control import PD
from newton_euler.model.couplings import Gear, JointCoupling, LinearCoupling, PolynomialCoupling
from newton_euler.model.digital_control import Law
from newton_euler.model.elements import Named, OnCoordinate
from newton_euler.model.forces import BallSpring, Force, JointSpring, Wrench
from newton_euler.model.joint import Joint
from newton_euler.model.joint_kinds import Fixed
from newton_euler.model.motions import TimeFunction, scaled
from newton_euler.model.scene import Scene
from newton_euler.runs.assemble import initial_state

FACTORS = {"doubled": 2.0, "halved": 0.5, "dropped": 0.0, "negated": -1.0, "times 1 + 1e-6": 1.0 + 1e-6}
"""Factors of misread numbers, by description of the mistake."""

SMALL_ERROR, LARGE_ERROR = 1e-6, 0.1
"""Relative errors of numbers, shifts of points in sizes of the mechanism, and errors of angles, rad."""

PERMUTED_AXES = [1, 2, 0]
"""Order of the components of a vector that is read in a wrong order."""

ALL_BODIES = "all bodies"
"""Name of the element of a fault that is in all bodies, such as wrong initial velocities."""

SHIFTED_ATTRIBUTES = ("rest", "target", "point", "point_on_first", "point_on_second")
"""Attributes of forces and controllers that are coordinates or points. They are shifted as well as multiplied
by factors, since no factor changes 0."""


def misreadings(scene: Scene) -> Iterator[Fault]:
    """Yield all misreadings that are possible for a scene."""
    # Faults that do not depend on a reader, and faults of joints. If a joint is coupled to others, a correct
    # diagnosis may name the coupling. A diagnosis from the motion alone may name a neighbor, a body at the
    # joint.
    of_joints = [
        replace(fault, neighbors=connected_bodies(joint))
        for joint in scene.mechanism.joints
        for fault in _joint_faults(scene, joint)
    ]
    numbers = *number_faults(scene, SMALL_ERROR), *number_faults(scene, LARGE_ERROR)
    for fault in (*numbers, *confusion_faults(scene), *of_joints):
        couplings = (c.name for c in scene.mechanism.couplings if fault.element in _coupled_joints(c))
        if fault.kind != "quaternion order":  # a reader of files is free to choose the frames of bodies
            yield replace(fault, expected=fault.expected.union(couplings))
    # Controllers and forces
    for field in ("control", "forces"):
        for index, force in enumerate(getattr(scene, field)):
            yield from _force_faults(scene, field, index, force)
    # Armatures (rotor inertias)
    for index, armature in enumerate(scene.armatures):
        for what, factor in FACTORS.items():
            if factor > 0.0:
                other = injection.entry_values("armatures", index, inertia=factor * armature.inertia)
                yield _fault("armature", armature.joint, what, other)
        yield _fault("armature", armature.joint, "dropped", injection.missing_entry("armatures", index))
        if isinstance(armature, OnCoordinate):
            for k in _other_coordinates(scene, armature.joint, armature.coordinate):
                moved = injection.entry_values("armatures", index, coordinate=k)
                yield _fault("armature", armature.joint, f"on coordinate {k}", moved)
    # Prescribed motions, couplings and initial velocities
    for index, motion in enumerate(scene.motions):
        yield _fault("equality", motion.joint, "dropped", injection.missing_entry("motions", index))
    for index, coupling in enumerate(scene.mechanism.couplings):
        for what, changed in _faulty_couplings(scene, coupling):
            yield _fault("gear", coupling.name, what, injection.coupling(index, changed))
    if np.any(initial_state(scene).linear_velocity) or np.any(initial_state(scene).angular_velocity):
        for what, factor in FACTORS.items():
            yield _fault("velocity", ALL_BODIES, what, _scaled_velocities(factor))


def _coupled_joints(coupling: JointCoupling) -> set[str]:
    """Return the names of the joints whose coordinates a coupling relates."""
    return {key[0] for key in coupling.factors()}


def _scaled_velocities(factor: float) -> injection.Injection:
    """Multiply all initial velocities by a factor."""

    def injected(scene: Scene) -> Scene:
        start = initial_state(scene)
        linear, angular = factor * start.linear_velocity, factor * start.angular_velocity
        return replace(scene, initial_state=replace(start, linear_velocity=linear, angular_velocity=angular))

    return injected


# Joints


def _joint_faults(scene: Scene, joint: Joint) -> Iterator[Fault]:
    """Yield faults of a joint: wrong offsets or order of its hinges, read as rigid, missing.

    An offset is the vector (3,), m, between the axes of two successive hinges of a compound joint. Offsets
    are shifted along the unit vector `SKEW_AXIS`, which is parallel to no coordinate axis.
    """
    name, offsets = joint.name, getattr(joint, "offsets", ())
    for k, offset in enumerate(offsets):
        for relative_size in (SMALL_ERROR, LARGE_ERROR):
            shift = relative_size * scene.mechanism.size * SKEW_AXIS
            moved = injection.joint_row(joint, "offsets", k, lambda row, shift=shift: row + shift)  # type: ignore[misc]
            yield _fault("offset", name, f"{k} moved by {relative_size:g}", moved)
        for what, factor in FACTORS.items() if np.any(offset) else ():
            other = injection.joint_row(joint, "offsets", k, lambda row, factor=factor: factor * row)  # type: ignore[misc]
            yield _fault("offset", name, f"{k} {what}", other)
    if isinstance(joint, Compound) and len(joint.hinges) > 1:
        turned = injection.joint_axes(name, {"hinges": joint.hinges[::-1]})
        yield _fault("axis", name, "hinges in the other order", turned)
    if not isinstance(joint, Fixed):
        yield _fault("joint", name, "read as rigid", _read_as_rigid(joint))

    def without_joint(scene: Scene) -> Scene:
        """Return the scene without the joint and the elements that act on it."""
        return injection.missing_joint(name)(_without_joint_elements(scene, name))

    with suppress(NewtonEulerError):  # raised for a joint that is the only one of a body
        without_joint(scene)
        yield _fault("equality", name, "dropped", without_joint)


def _without_joint_elements(scene: Scene, joint: str) -> Scene:
    """Return the scene without the controllers, forces, armatures, motions and couplings of a joint."""

    def kept(entries: Any) -> Any:
        return tuple(entry for entry in entries if getattr(entry, "joint", None) != joint)

    mechanism = scene.mechanism
    couplings = [c for c in mechanism.couplings if joint not in _coupled_joints(c)]
    return replace(
        scene,
        mechanism=type(mechanism)(mechanism.bodies, mechanism.joints, couplings),
        initial_state=None,
        control=kept(scene.control),
        forces=kept(scene.forces),
        motions=kept(scene.motions),
        armatures=kept(scene.armatures),
    )


def _read_as_rigid(joint: Joint) -> injection.Injection:
    """Replace a joint by a fixed joint, and remove the elements that act on the joint's coordinates."""
    return lambda scene: injection.joint_kind(joint, "fixed")(_without_joint_elements(scene, joint.name))


# Forces, controllers and couplings


def _force_faults(scene: Scene, field: str, index: int, force: Law | Force) -> Iterator[Fault]:
    """Yield faults in the values, points and frames of a force or a controller.

    Args:
        scene: the scene.
        field: list of the scene that contains the element: "control" or "forces".
        index: index of the element in the list.
        force: the force or controller.
    """
    # Numbers that are multiplied by a factor, and vectors whose components are permuted. Springs and dampers
    # accept no negative numbers.
    for name in force.parameters:
        value = getattr(force, name)
        if isinstance(value, Mapping):
            continue  # gains on other coordinates do not occur in model files
        if name in SHIFTED_ATTRIBUTES and _has_no_stiffness(force):
            continue
        for what, factor in FACTORS.items() if np.any(value) else ():
            if factor >= 0.0 or isinstance(force, PD | Wrench):
                other = scaled(value, factor) if isinstance(value, TimeFunction) else factor * value
                yield _value_fault(field, index, force, name, what, other)
        if isinstance(value, np.ndarray) and np.ptp(value):
            yield _value_fault(field, index, force, name, "permuted", value[PERMUTED_AXES])
    # Points and coordinates that are shifted
    if not _has_no_stiffness(force):
        for name in SHIFTED_ATTRIBUTES:
            for shift in (SMALL_ERROR, LARGE_ERROR) if hasattr(force, name) else ():
                value = getattr(force, name)
                if isinstance(value, TimeFunction):
                    continue  # functions of time do not occur in model files
                unit = scene.mechanism.size if _is_length(scene, force) else 1.0
                moved = value + shift * unit * (SKEW_AXIS if isinstance(value, np.ndarray) else 1.0)
                yield _value_fault(field, index, force, name, f"moved by {shift:g}", moved)
    # The frame of a wrench, the coordinate of a joint, and a missing element
    if isinstance(force, Wrench):
        other = "body" if force.frame == "world" else "world"
        yield _value_fault(field, index, force, "frame", f"taken for that of the {other}", other)
    if isinstance(force, OnCoordinate):
        for k in _other_coordinates(scene, force.joint, force.coordinate):
            yield _value_fault(field, index, force, "coordinate", f"taken for {k}", k)
    yield _fault(type(force).__name__, _element_name(force), "dropped", injection.missing_entry(field, index))


def _has_no_stiffness(force: Law | Force) -> bool:
    """Return True for a spring or PD controller without stiffness, whose rest position has no effect."""
    return isinstance(force, PD | JointSpring | BallSpring) and not force.stiffness


def _value_fault(field: str, index: int, force: Law | Force, name: str, what: str, value: object) -> Fault:
    """Return the fault that an attribute of a force or controller has a wrong value.

    Args:
        field: list of the scene that contains the element: "control" or "forces".
        index: index of the element in the list.
        force: the element.
        name: name of the attribute.
        what: description of the mistake.
        value: the wrong value.
    """
    injected = injection.entry_values(field, index, **{name: value})
    return _fault(f"{name} of {type(force).__name__}", _element_name(force), what, injected)


def _is_length(scene: Scene, force: Law | Force) -> bool:
    """Return True if the rest position, target or point of an element is in m, not in rad."""
    if isinstance(force, OnCoordinate):
        joint = scene.mechanism.joint(force.joint)
        return joint.coordinate_kinds[force.coordinate] == "slide"
    return not force.on_ball


def _other_coordinates(scene: Scene, joint: str, coordinate: int) -> Iterator[int]:
    """Yield the other coordinates of a joint."""
    kinds = scene.mechanism.joint(joint).coordinate_kinds
    yield from (k for k in range(len(kinds)) if k != coordinate)


def _element_name(force: Law | Force) -> str:
    """Return the name of a force that has one, or of the joint on which a force or controller acts."""
    return force.name if isinstance(force, Named) else force.joint


def _faulty_couplings(scene: Scene, coupling: JointCoupling) -> Iterator[tuple[str, JointCoupling | None]]:
    """Yield faulty variants of a coupling, each with its description; None stands for no coupling.

    The variants have one wrong factor, or act on another coordinate of a joint.
    """
    yield "dropped", None
    factors = {what: factor for what, factor in FACTORS.items() if factor}
    if isinstance(coupling, PolynomialCoupling):
        for power, coefficient in enumerate(coupling.coefficients, start=1):
            for what, factor in factors.items() if coefficient else ():
                coefficients = [*coupling.coefficients]
                coefficients[power - 1] = factor * coefficient
                yield f"power {power} {what}", replace(coupling, coefficients=tuple(coefficients))
    if isinstance(coupling, Gear):
        for what, factor in factors.items():
            yield what, replace(coupling, ratio=factor * coupling.ratio)
    if isinstance(coupling, Gear | PolynomialCoupling):
        for k in _other_coordinates(scene, coupling.driver, coupling.driver_coordinate):
            if (coupling.driver, k) != (coupling.follower, coupling.follower_coordinate):
                yield f"driven by coordinate {k}", replace(coupling, driver_coordinate=k)
        return
    assert isinstance(coupling, LinearCoupling)
    # A linear coupling is a sum of terms that is 0. A wrong coefficient of the first term is equivalent to
    # wrong coefficients of all other terms.
    for n, (joint, coordinate, coefficient) in enumerate(coupling.terms):
        for what, factor in factors.items() if n else ():
            terms = [*coupling.terms]
            terms[n] = joint, coordinate, factor * coefficient
            yield f"term {n} {what}", replace(coupling, terms=tuple(terms))
        if len(coupling.terms) > 2:
            yield f"term {n} dropped", replace(coupling, terms=coupling.terms[:n] + coupling.terms[n + 1 :])


def _fault(kind: str, element: str, detail: str, inject: injection.Injection) -> Fault:
    """Return a fault without a size, which a correct diagnosis locates at `element`."""
    return Fault(kind, element, detail, size=None, inject=inject, expected=frozenset({element}))
