"""Catalog of the faults that are injected into an engine's model of a scene, one at a time.

A study injects these faults and measures which ones crosscheck detects and locates. Faults with a size change
a number by a relative size, for example the mass of a body by 1e-3. Faults without a size are confusions,
such as a reversed axis, a missing body or another joint type.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from crosscheck.studies.faults import injection
from crosscheck.studies.faults.injection import Injection
from newton_euler.equations.couplings import couplings
from newton_euler.model.control import PD
from newton_euler.model.digital_control import HeldLaw
from newton_euler.model.elements import OnBodies
from newton_euler.model.joint import Joint, perpendicular_pair
from newton_euler.model.motions import TimeFunction, scaled
from newton_euler.model.scene import Scene
from newton_euler.model.spanning_tree import SpanningTree
from newton_euler.scalars import Array

FAULT_SIZES = (1e-1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6)
"""Relative sizes of faults. Shifts are relative to the mechanism's size; changes of direction are in rad."""

MAX_FAULTS_OF_KIND = 36
"""Largest number of faults of one kind and size in mechanisms of up to `MAX_BODIES_FOR_ALL` bodies; if there
are more, evenly spaced ones are taken."""

MAX_BODIES_FOR_ALL = 8
"""Number of bodies up to which `MAX_FAULTS_OF_KIND` holds.

In larger mechanisms the limit falls with the square of the number of bodies, since more kinds reach the limit
and each comparison takes longer.
"""

REFERENCE_GRAVITY = 9.81
"""Gravity, m/s^2, to which faults of gravity are relative in a scene without gravity."""

VALUE_FAULTS = {"stiffness": "gain", "damping": "damping", "target": "actuator reference"}
"""Kind of fault, by the attribute of a controller or joint spring that has the wrong value."""

SKEW_AXIS = np.array([1.0, 2.0, 3.0]) / np.sqrt(14.0)
"""Unit vector that is no principal axis; faulty inertias are rotated about it."""


@dataclass(frozen=True)
class Fault:
    """One fault that can be injected.

    Attributes:
        kind: kind of fault, for example "mass" or "axis sign".
        element: name of the body or joint at fault, or "gravity".
        detail: entry, direction or value at fault; may be empty.
        size: relative size, see `FAULT_SIZES`; None for a fault without a size.
        inject: function that takes the scene and returns the scene with the fault.
        expected: names of bodies or joints, or "gravity"; a correct diagnosis names one of them.
        neighbors: further names that are accepted of a diagnosis from motion alone: the bodies at a joint.
        closure_shift: for a wrong point of a loop-closing joint, the shift (3,) of the point on the second
            body, m, world frame; else None.
        hinge: for a dropped velocity term, see `_velocity_term_faults`, the name of the joint; else None. The
            fault is then in an engine's equations, and `inject` changes nothing.
    """

    kind: str
    element: str
    detail: str
    size: float | None
    inject: Injection
    expected: frozenset[str]
    neighbors: frozenset[str] = frozenset()
    closure_shift: Array | None = None
    hinge: str | None = None

    @property
    def identity(self) -> tuple[str, str, str]:
        """Kind, element and detail, which are equal for faults that differ in size only."""
        return self.kind, self.element, self.detail

    @property
    def name(self) -> str:
        """Description of the fault for reports."""
        size = "" if self.size is None else f" by {self.size:g}"
        return " ".join(filter(None, (self.kind, "of", self.element, self.detail))) + size


def catalog(scene: Scene, sizes: Sequence[float] = FAULT_SIZES) -> list[Fault]:
    """List the faults of a scene: the faults with a size, at each of `sizes`, then those without a size."""
    maximum = max_faults_of_kind(len(scene.mechanism.bodies))
    faults = list[Fault]()
    for size in sizes:
        of_size = [*number_faults(scene, size), *_force_faults(scene, size)]
        faults += _evenly_spaced(of_size, maximum)
    without_size = [*confusion_faults(scene), *_velocity_term_faults(scene)]
    return faults + _evenly_spaced(without_size, maximum)


def max_faults_of_kind(bodies: int) -> int:
    """Return the largest number of faults of one kind and size for a mechanism with this number of bodies."""
    return max(1, min(MAX_FAULTS_OF_KIND, MAX_FAULTS_OF_KIND * MAX_BODIES_FOR_ALL**2 // bodies**2))


def _evenly_spaced(faults: list[Fault], maximum: int) -> list[Fault]:
    """Keep at most `maximum` faults of each kind, evenly spaced in the list."""
    kept = []
    for kind in dict.fromkeys(fault.kind for fault in faults):
        of_kind = [fault for fault in faults if fault.kind == kind]
        count = min(maximum, len(of_kind))
        kept += [of_kind[round(k)] for k in np.linspace(0, len(of_kind) - 1, count)]
    return kept


def number_faults(scene: Scene, size: float) -> Iterator[Fault]:
    """Yield the faults of a size in the numbers of bodies and joints, and in gravity."""
    yield from _body_faults(scene, size)
    yield from _joint_faults(scene, size)
    for detail, vector in _faulty_gravities(scene.gravity, size).items():
        yield Fault("gravity", "gravity", detail, size, injection.gravity(vector), frozenset({"gravity"}))


def confusion_faults(scene: Scene) -> Iterator[Fault]:
    """Yield the faults without a size: bodies and joints that are missing or confused with others."""
    yield from _body_confusions(scene)
    yield from _joint_confusions(scene)


def _body_faults(scene: Scene, size: float) -> Iterator[Fault]:
    """Yield faults of a size in mass, center of mass and inertia of each body."""
    length = scene.mechanism.size
    for body in scene.mechanism.body_names[1:]:  # without the ground
        expected = frozenset({body})
        yield Fault("mass", body, "", size, injection.mass(body, size), expected)
        for label, axis in zip("xyz", np.eye(3), strict=True):
            shifted = injection.center_of_mass(body, size * length * axis)
            yield Fault("center of mass", body, label, size, shifted, expected)
        for i in range(3):
            for j in range(i, 3):
                entry = injection.inertia_entry(body, i, j, size)
                yield Fault("inertia entry", body, "xyz"[i] + "xyz"[j], size, entry, expected)
        yield Fault(
            "frame of inertia", body, "", size, injection.inertia_frame(body, SKEW_AXIS, size), expected
        )


def _joint_faults(scene: Scene, size: float) -> Iterator[Fault]:
    """Yield faults of a size in points and axes of each joint.

    A wrong point of a joint that closes a loop, on one of its bodies, opens the loop. A rod has another
    length then, and opens no loop.
    """
    length, cuts = scene.mechanism.size, _cuts(scene)
    for index, joint in enumerate(scene.mechanism.joints):
        expected, neighbors = frozenset({joint.name}), connected_bodies(joint)
        for label, axis in zip("xyz", np.eye(3), strict=True):
            shift = size * length * axis
            moved = injection.joint_point(joint.name, shift)
            yield Fault("joint point", joint.name, label, size, moved, expected, neighbors)
            if index in cuts:
                opened = injection.closure_point(joint.name, shift)
                yield Fault(
                    "closure point",
                    joint.name,
                    label,
                    size,
                    opened,
                    expected,
                    neighbors,
                    closure_shift=None if joint.only_closes else shift,
                )
        for label, tilted in injection.tilted_axes(joint, size).items():
            yield Fault("axis direction", joint.name, label, size, tilted, expected, neighbors)


def _force_faults(scene: Scene, size: float) -> Iterator[Fault]:
    """Yield faults of a size in the values of controllers, joint springs and armatures (rotor inertias).

    A spring or an armature acts on one coordinate of a joint (hinge or slide) or, if `on_ball`, on the ball
    of the joint: its three rotations, as in a spherical joint.
    """
    # Controllers and joint springs, but not forces on bodies and sampled controllers
    for field in ("control", "forces"):
        for index, force in enumerate(getattr(scene, field)):
            if isinstance(force, OnBodies | HeldLaw):
                continue
            detail = ""
            if field == "forces":
                detail = "spring of its ball" if force.on_ball else "spring"
            for name, kind in VALUE_FAULTS.items():
                value = getattr(force, name, None)
                # a stiffness or damping of 0 has no relative fault, a target of 0 has an absolute one
                if value or (name == "target" and value is not None):
                    if isinstance(value, TimeFunction):
                        value = scaled(value, 1.0 + size)
                    else:
                        value = (1.0 + size) * value if value else size * _target_unit(scene, force)
                    changed = injection.entry_values(field, index, **{name: value})
                    yield Fault(kind, force.joint, detail, size, changed, frozenset({force.joint}))
    # Armatures; a body at the joint with more inertia would move in the same way
    for index, armature in enumerate(scene.armatures):
        other = injection.entry_values("armatures", index, inertia=(1.0 + size) * armature.inertia)
        joint = scene.mechanism.joint(armature.joint)
        expected = connected_bodies(joint) | {armature.joint}
        detail = "of its ball" if armature.on_ball else ""
        yield Fault("armature", armature.joint, detail, size, other, expected)


def _target_unit(scene: Scene, law: PD) -> float:
    """Return the unit of a controller's target: the mechanism's size, m, for a slide, 1 rad for a hinge."""
    joint = scene.mechanism.joint(law.joint)
    return scene.mechanism.size if joint.coordinate_kinds[law.coordinate] == "slide" else 1.0


def _faulty_gravities(gravity: Array, size: float) -> dict[str, Array]:
    """Return vectors (3,) of gravity with another strength or direction, m/s^2, by description of the fault.

    If there is no gravity, the faults add a small one.
    """
    strength = float(np.linalg.norm(gravity))
    if not strength:
        x, _, z = np.eye(3)
        return {label: size * REFERENCE_GRAVITY * axis for label, axis in (("x", x), ("z", z))}
    # u and w: unit vectors perpendicular to gravity and to each other
    turns = zip("uw", perpendicular_pair(gravity / strength), strict=True)
    turned = {f"about {label}": injection.turned_about(axis, size) @ gravity for label, axis in turns}
    return {"strength": (1.0 + size) * gravity, **turned}


def _cuts(scene: Scene) -> tuple[int, ...]:
    """Return the indices of the joints that close loops.

    The spanning tree connects each body to the ground by one path of joints. The joints outside the tree
    close loops. The tree is that of the engines, in which balls with springs or rotors carry coordinates.
    """
    return SpanningTree(scene.mechanism, loaded=scene.loaded_balls).cuts


def connected_bodies(joint: Joint) -> frozenset[str]:
    """Return the names of the two bodies that a joint connects."""
    return frozenset({joint.first, joint.second})


def _body_confusions(scene: Scene) -> Iterator[Fault]:
    """Yield faults without a size of bodies: wrong order of the quaternion, missing, swapped."""
    bodies = scene.mechanism.bodies
    for body in bodies[1:]:  # without the ground
        expected = frozenset({body.name})
        yield Fault("quaternion order", body.name, "", None, injection.quaternion_order(body.name), expected)
        yield Fault("missing body", body.name, "", None, injection.missing_body(body.name), expected)
    for first, second in pairwise(bodies[1:]):
        swapped, expected = injection.swapped_bodies(first, second), frozenset({first.name, second.name})
        yield Fault("swapped bodies", first.name, f"with {second.name}", None, swapped, expected)


def _joint_confusions(scene: Scene) -> Iterator[Fault]:
    """Yield faults without a size of joints: reversed axis, another joint type, missing loop closure."""
    cuts = _cuts(scene)
    for index, joint in enumerate(scene.mechanism.joints):
        missing = Fault(
            "missing closure",
            joint.name,
            "",
            None,
            injection.missing_joint(joint.name),
            expected=frozenset({joint.name}),
            neighbors=connected_bodies(joint),
        )
        for name in joint.axis_names:
            turned = injection.joint_axes(joint.name, {name: -getattr(joint, name)})
            yield replace(missing, kind="axis sign", detail=name, inject=turned)
        for kind, axes in confused_kinds(scene, joint).items():
            other = injection.joint_kind(joint, kind, **axes)
            yield replace(missing, kind="joint type", detail=f"{joint.kind} as {kind}", inject=other)
        if index in cuts:  # joints of the spanning tree cannot be missing
            yield missing


def _velocity_term_faults(scene: Scene) -> Iterator[Fault]:
    """Yield a dropped velocity term for each joint of the spanning tree whose last motion is a hinge.

    The term is omega x axis v in the angular acceleration of the part after the hinge. omega is the angular
    velocity of the part before the hinge, v the rate about the axis. See
    `crosscheck.studies.faults.velocity_terms`.
    """
    tree = SpanningTree(scene.mechanism)
    for tree_joint in tree.joints:
        joint = tree.joint(tree_joint.joint)
        if tree_joint.motions and tree_joint.motions[-1].kind == "hinge":
            yield Fault(
                "velocity term",
                joint.name,
                "",
                None,
                injection.no_change,
                expected=frozenset({joint.name}),
                neighbors=connected_bodies(joint),
                hinge=joint.name,
            )


def confused_kinds(scene: Scene, joint: Joint) -> dict[str, dict[str, Array]]:
    """Return the kind of joint with which a joint is easily confused, and its axes; empty if there is none.

    The first coordinates of both kinds are the same, so that elements that act on them remain valid.
    """
    # Joints with elements that act on their coordinates; a coordinate is given as (joint, index)
    driven = {joint_name for coupling in couplings(scene) for joint_name, _ in coupling.factors}
    driven |= {law.joint for law in scene.joint_forces} | {a.joint for a in scene.armatures}
    driven |= scene.loaded_balls
    driven |= {motion.joint for motion in scene.motions}
    match joint.kind:
        case "revolute" if joint.name in driven:
            axis = joint.axis  # type: ignore[attr-defined]
            return {"universal": {"axis_on_first": axis, "axis_on_second": perpendicular_pair(axis)[0]}}
        case "revolute" | "universal" if joint.name not in driven:
            return {"spherical": {}}
        case "spherical" if joint.name not in driven:
            x, y, _ = np.eye(3)
            return {"universal": {"axis_on_first": x, "axis_on_second": y}}
        case "prismatic" | "translational":  # two names of the same joint
            return {"cylindrical": {"axis": joint.axis}}  # type: ignore[attr-defined]
        case "cylindrical" if joint.name not in driven:
            return {"revolute": {"axis": joint.axis}}  # type: ignore[attr-defined]
        case "cylindrical":
            return {"prismatic": {"axis": joint.axis}}  # type: ignore[attr-defined]
    return {}
