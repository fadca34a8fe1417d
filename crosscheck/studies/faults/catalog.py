"""Catalog of the faults of a scene that are injected into an engine's model, one at a time."""

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
"""Relative sizes of faults. Lengths are relative to the mechanism's size; directions are in rad."""

MAX_FAULTS_OF_KIND, MAX_BODIES_FOR_ALL = 36, 8
"""Largest number of faults of one kind and size, and the largest number of bodies for which it holds.

If there are more faults of a kind, evenly spaced ones are taken. In larger mechanisms the number falls with
the square of the number of bodies, since more kinds reach it and each comparison takes longer.
"""

REFERENCE_GRAVITY = 9.81
"""m/s^2, gravity to which faults are relative in a scene without gravity."""

VALUE_FAULTS = {"stiffness": "gain", "damping": "damping", "target": "actuator reference"}
"""Kinds of faults in the values of controllers and joint springs, by the name of the value."""

SKEW_AXIS = np.array([1.0, 2.0, 3.0]) / np.sqrt(14.0)
"""Unit vector that is no principal axis; faulty inertias are rotated about it."""


@dataclass(frozen=True)
class Fault:
    """One fault.

    Attributes:
        kind: kind of fault, for example "mass" or "axis sign".
        element: body, joint or term at fault.
        detail: entry, direction or value at fault.
        size: relative size, see `FAULT_SIZES`; None for a fault without a size.
        inject: returns the scene with the fault.
        right: names of bodies, joints and terms that a correct diagnosis may name.
        near: further names that a diagnosis from motion alone may name: the bodies that a joint connects.
        shift: (3,) m, shift of the point that MuJoCo's model holds on the second body of a closure.
        hinge: name of the hinge whose velocity term is dropped from an engine's equations, see
            `velocity_terms`; `inject` changes nothing then.
    """

    kind: str
    element: str
    detail: str
    size: float | None
    inject: Injection
    right: frozenset[str]
    near: frozenset[str] = frozenset()
    shift: Array | None = None
    hinge: str | None = None

    @property
    def alike(self) -> tuple[str, str, str]:
        """Kind, element and detail: the same for faults that differ in size only."""
        return self.kind, self.element, self.detail

    @property
    def name(self) -> str:
        """Description of the fault for reports."""
        size = "" if self.size is None else f" by {self.size:g}"
        return " ".join(filter(None, (self.kind, "of", self.element, self.detail))) + size


def catalog(scene: Scene, sizes: Sequence[float] = FAULT_SIZES) -> list[Fault]:
    """List the faults of a scene: first those with a size, at each of the sizes, then those without."""
    most = most_of(len(scene.mechanism.bodies))
    of_sizes = [[*of_numbers(scene, size), *_of_forces(scene, size)] for size in sizes]
    mistakes = [*mistaken(scene), *_dropped_terms(scene)]
    return [fault for faults in (*of_sizes, mistakes) for fault in _spread(faults, most)]


def most_of(bodies: int) -> int:
    """Return the largest number of faults of a kind for a mechanism with this number of bodies."""
    return max(1, min(MAX_FAULTS_OF_KIND, MAX_FAULTS_OF_KIND * MAX_BODIES_FOR_ALL**2 // bodies**2))


def _spread(faults: list[Fault], most: int) -> list[Fault]:
    """Keep at most `most` evenly spaced faults of each kind."""
    kept = []
    for kind in dict.fromkeys(fault.kind for fault in faults):
        of_kind = [fault for fault in faults if fault.kind == kind]
        count = min(most, len(of_kind))
        kept += [of_kind[round(k)] for k in np.linspace(0, len(of_kind) - 1, count)]
    return kept


def of_numbers(scene: Scene, size: float) -> Iterator[Fault]:
    """Yield faults of a size in the numbers of bodies, joints and gravity."""
    yield from _of_bodies(scene, size)
    yield from _of_joints(scene, size)
    for detail, vector in _other_gravities(scene.gravity, size).items():
        yield Fault("gravity", "gravity", detail, size, injection.gravity(vector), frozenset({"gravity"}))


def mistaken(scene: Scene) -> Iterator[Fault]:
    """Yield faults without a size: bodies and joints that are confused with others, or missing."""
    yield from _body_mistakes(scene)
    yield from _joint_mistakes(scene)


def _of_bodies(scene: Scene, size: float) -> Iterator[Fault]:
    length = scene.mechanism.size
    for body in scene.mechanism.body_names[1:]:
        right = frozenset({body})
        yield Fault("mass", body, "", size, injection.mass(body, size), right)
        for label, axis in zip("xyz", np.eye(3), strict=True):
            shifted = injection.center_of_mass(body, size * length * axis)
            yield Fault("center of mass", body, label, size, shifted, right)
        for i in range(3):
            for j in range(i, 3):
                entry = injection.inertia_entry(body, i, j, size)
                yield Fault("inertia entry", body, "xyz"[i] + "xyz"[j], size, entry, right)
        yield Fault("frame of inertia", body, "", size, injection.inertia_frame(body, SKEW_AXIS, size), right)


def _of_joints(scene: Scene, size: float) -> Iterator[Fault]:
    length, cuts = scene.mechanism.size, SpanningTree(scene.mechanism).cuts
    for index, joint in enumerate(scene.mechanism.joints):
        right, near = frozenset({joint.name}), bodies_at(joint)
        for label, axis in zip("xyz", np.eye(3), strict=True):
            shift = size * length * axis
            moved = injection.joint_point(joint.name, shift)
            yield Fault("joint point", joint.name, label, size, moved, right, near)
            if index in cuts:
                opened = injection.closure_point(joint.name, shift)
                yield Fault("closure point", joint.name, label, size, opened, right, near, shift)
        for label, tilted in injection.tilted(joint, size).items():
            yield Fault("axis direction", joint.name, label, size, tilted, right, near)


def _of_forces(scene: Scene, size: float) -> Iterator[Fault]:
    for field in ("control", "forces"):
        for index, force in enumerate(getattr(scene, field)):
            if isinstance(force, OnBodies | HeldLaw):
                continue
            detail = "" if field == "control" else "spring of its ball" if force.on_ball else "spring"
            for name, kind in VALUE_FAULTS.items():
                value = getattr(force, name, None)
                if value or (name == "target" and value is not None):
                    if isinstance(value, TimeFunction):
                        value = scaled(value, 1.0 + size)
                    else:
                        value = (1.0 + size) * value if value else size * _unit(scene, force)
                    changed = injection.entry(field, index, **{name: value})
                    yield Fault(kind, force.joint, detail, size, changed, frozenset({force.joint}))
    for index, rotor in enumerate(scene.armatures):
        other = injection.entry("armatures", index, inertia=(1.0 + size) * rotor.inertia)
        joint = scene.mechanism.joint(rotor.joint)
        right = bodies_at(joint) | {rotor.joint}  # a body with more inertia moves in the same way
        detail = "of its ball" if rotor.on_ball else ""
        yield Fault("armature", rotor.joint, detail, size, other, right)


def _unit(scene: Scene, law: PD) -> float:
    """Return the length or angle to which the fault of a target of 0 is relative: the mechanism's size or 1
    rad."""
    joint = scene.mechanism.joint(law.joint)
    return scene.mechanism.size if joint.coordinate_kinds[law.coordinate] == "slide" else 1.0


def _other_gravities(gravity: Array, size: float) -> dict[str, Array]:
    strength = float(np.linalg.norm(gravity))
    if not strength:
        x, _, z = np.eye(3)
        return {label: size * REFERENCE_GRAVITY * axis for label, axis in (("x", x), ("z", z))}
    turns = zip("uw", perpendicular_pair(gravity / strength), strict=True)
    turned = {f"about {label}": injection.turned_about(axis, size) @ gravity for label, axis in turns}
    return {"strength": (1.0 + size) * gravity, **turned}


def bodies_at(joint: Joint) -> frozenset[str]:
    """Return the names of the two bodies that a joint connects."""
    return frozenset({joint.first, joint.second})


def _body_mistakes(scene: Scene) -> Iterator[Fault]:
    bodies = scene.mechanism.bodies
    for body in bodies[1:]:
        right = frozenset({body.name})
        yield Fault("quaternion order", body.name, "", None, injection.quaternion_order(body.name), right)
        yield Fault("missing body", body.name, "", None, injection.missing_body(body.name), right)
    for first, second in pairwise(bodies[1:]):
        swapped, right = injection.swapped_bodies(first, second), frozenset({first.name, second.name})
        yield Fault("swapped bodies", first.name, f"with {second.name}", None, swapped, right)


def _joint_mistakes(scene: Scene) -> Iterator[Fault]:
    cuts = SpanningTree(scene.mechanism).cuts
    for index, joint in enumerate(scene.mechanism.joints):
        fault = Fault("", joint.name, "", None, injection.missing_joint(joint.name), frozenset({joint.name}))
        fault = replace(fault, near=bodies_at(joint))
        for name in joint.axis_names:
            turned = injection.joint_axes(joint.name, {name: -getattr(joint, name)})
            yield replace(fault, kind="axis sign", detail=name, inject=turned)
        for kind, axes in other_kinds(scene, joint).items():
            other = injection.joint_kind(joint, kind, **axes)
            yield replace(fault, kind="joint type", detail=f"{joint.kind} as {kind}", inject=other)
        if index in cuts:
            yield replace(fault, kind="missing closure")


def _dropped_terms(scene: Scene) -> Iterator[Fault]:
    tree = SpanningTree(scene.mechanism)
    for kept in tree.joints:
        joint = tree.joint(kept.joint)
        if kept.motions and kept.motions[-1].kind == "hinge":
            right = frozenset({joint.name})
            term = Fault("velocity term", joint.name, "", None, injection.nothing, right, bodies_at(joint))
            yield replace(term, hinge=joint.name)


def other_kinds(scene: Scene, joint: Joint) -> dict[str, dict[str, Array]]:
    """Return the kind of joint that a joint is easily confused with, with its axes.

    The first coordinates of both kinds are the same.
    """
    names = {key[0] for coupling in couplings(scene) for key in coupling.factors}
    driven = {law.joint for law in scene.joint_forces} | {a.joint for a in scene.armatures} | names
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
        case "prismatic" | "translational":
            return {"cylindrical": {"axis": joint.axis}}  # type: ignore[attr-defined]
        case "cylindrical" if joint.name not in driven:
            return {"revolute": {"axis": joint.axis}}  # type: ignore[attr-defined]
        case "cylindrical":
            return {"prismatic": {"axis": joint.axis}}  # type: ignore[attr-defined]
    return {}
