"""Functions that make scenes with a single fault, such as a wrong mass or a missing joint.

A function such as `mass("rod", 1e-3)` does not change a scene. It returns an `Injection`: a function that
takes a scene and returns the scene with the fault. Vectors of bodies and joints are in the world frame at the
initial pose, except where a body frame is mentioned. A joint has a `point` on its first body and
`point_on_second` on its second body.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Any

import numpy as np

from newton_euler.model.compound_joint import Compound
from newton_euler.model.couplings import JointCoupling
from newton_euler.model.euler_parameters import from_rotation_vector, rotation
from newton_euler.model.joint import Joint, perpendicular_pair
from newton_euler.model.joint_kinds import JOINT_KINDS
from newton_euler.model.mechanism import Body, Mechanism
from newton_euler.model.scene import Scene
from newton_euler.scalars import Array

Injection = Callable[[Scene], Scene]
"""Function that takes a scene and returns the scene with a fault."""

MISSING_BODY_FRACTION = 1e-6
"""Fraction of mass and inertia that a missing body keeps, since no engine accepts a body without mass."""


def no_change(scene: Scene) -> Scene:
    """Return the scene unchanged; for faults in an engine's equations."""
    return scene


def with_mechanism(scene: Scene, bodies: Iterable[Body], joints: Iterable[Joint]) -> Scene:
    """Return the scene with other bodies and joints; the initial state is computed again."""
    mechanism = Mechanism(bodies, joints, scene.mechanism.couplings)
    return replace(scene, mechanism=mechanism, initial_state=None)


def change_bodies(change: dict[str, Callable[[Body], dict[str, Any]]]) -> Injection:
    """Replace attributes of bodies. Unphysical inertias are allowed, since a wrong entry can cause them.

    Args:
        change: for each body to change, by name, a function that returns the new values of its attributes.
    """

    def inject(scene: Scene) -> Scene:
        bodies = [
            replace(body, allow_unrealisable_inertia=True, **change[body.name](body))
            if body.name in change
            else body
            for body in scene.mechanism.bodies
        ]
        return with_mechanism(scene, bodies, scene.mechanism.joints)

    return inject


def change_joint(name: str, change: Callable[[Joint], Joint]) -> Injection:
    """Replace a joint, given by name, by the result of `change`."""

    def inject(scene: Scene) -> Scene:
        joints = [change(joint) if joint.name == name else joint for joint in scene.mechanism.joints]
        return with_mechanism(scene, scene.mechanism.bodies, joints)

    return inject


def mass(body: str, size: float) -> Injection:
    """Multiply the mass of a body by 1 + size."""
    return change_bodies({body: lambda b: {"mass": (1.0 + size) * b.mass}})


def center_of_mass(body: str, shift: Array) -> Injection:
    """Shift the center of mass of a body by `shift` (3,), m."""
    return change_bodies({body: lambda b: {"center_of_mass": b.center_of_mass + shift}})


def inertia_entry(body: str, i: int, j: int, size: float) -> Injection:
    """Add size * sqrt(J_ii J_jj) to the entries J_ij and J_ji of a body's inertia matrix."""

    def changed(b: Body) -> dict[str, Any]:
        inertia = np.array(b.inertia)
        entry = inertia[i, j] + size * np.sqrt(inertia[i, i] * inertia[j, j])
        inertia[i, j] = inertia[j, i] = entry
        return {"inertia": inertia}

    return change_bodies({body: changed})


def inertia_frame(body: str, axis: Array, angle: float) -> Injection:
    """Rotate the inertia of a body about a unit axis (3,) of the body frame by an angle, rad."""
    turn = turned_about(axis, angle)

    def changed(b: Body) -> dict[str, Any]:
        inertia = turn @ b.inertia @ turn.T
        return {"inertia": 0.5 * (inertia + inertia.T)}

    return change_bodies({body: changed})


def quaternion_order(body: str) -> Injection:
    """Misread the quaternion of a body: (w, x, y, z) as (x, y, z, w)."""
    return change_bodies({body: lambda b: {"quaternion": np.roll(b.quaternion, 1)}})


def missing_body(body: str) -> Injection:
    """Remove almost all mass and inertia of a body."""
    return change_bodies(
        {
            body: lambda b: {
                "mass": MISSING_BODY_FRACTION * b.mass,
                "inertia": MISSING_BODY_FRACTION * b.inertia,
            }
        }
    )


def swapped_bodies(first: Body, second: Body) -> Injection:
    """Exchange mass and inertia of two bodies."""

    def values_of(other: Body) -> Callable[[Body], dict[str, Any]]:
        return lambda _: {"mass": other.mass, "inertia": other.inertia}

    return change_bodies({first.name: values_of(second), second.name: values_of(first)})


def joint_point(joint: str, shift: Array) -> Injection:
    """Shift the points of a joint on both bodies by `shift` (3,), m, so that they still coincide at first."""
    return change_joint(
        joint, lambda j: replace(j, point=j.point + shift, point_on_second=j.point_on_second + shift)
    )


def closure_point(joint: str, shift: Array) -> Injection:
    """Shift the point of a joint on the second body only, by `shift` (3,), m, which opens the loop."""
    return change_joint(joint, lambda j: replace(j, point_on_second=j.point_on_second + shift))


def joint_axes(joint: str, axes: dict[str, Array]) -> Injection:
    """Replace axes (3,) or points (3,) of a joint; the keys of `axes` are names of the joint's attributes."""
    return change_joint(joint, lambda j: replace(j, **axes))  # type: ignore[arg-type]


def joint_row(joint: Joint, name: str, number: int, change: Callable[[Array], Array]) -> Injection:
    """Replace one row of an array of a joint by the result of `change`.

    Args:
        joint: the joint.
        name: name of the array: "slides", "hinges" or "offsets". With an offset, the point on the second body
            moves too, so that the joint still closes.
        number: index of the row.
        change: function of the row (3,) that returns the new row.
    """

    def changed(j: Joint) -> Joint:
        rows = np.array(getattr(j, name))
        new_row = change(rows[number])
        shift = new_row - rows[number] if name == "offsets" else np.zeros(3)
        rows[number] = new_row
        return replace(j, **{name: rows, "point_on_second": j.point_on_second + shift})  # type: ignore[arg-type]

    return change_joint(joint.name, changed)


def joint_kind(joint: Joint, kind: str, **axes: Array) -> Injection:
    """Replace a joint by one of another kind at the same points, with the given axes."""
    other = JOINT_KINDS[kind](
        joint.name,
        joint.first,
        joint.second,
        joint.point,
        point_on_second=joint.point_on_second,
        actuated=joint.actuated,
        **axes,
    )
    return change_joint(joint.name, lambda _: other)


def missing_joint(joint: str) -> Injection:
    """Remove a joint that closes a loop."""

    def inject(scene: Scene) -> Scene:
        joints = [kept for kept in scene.mechanism.joints if kept.name != joint]
        return with_mechanism(scene, scene.mechanism.bodies, joints)

    return inject


def gravity(vector: Array) -> Injection:
    """Replace gravity by a vector (3,), m/s^2, in the world frame."""
    return lambda scene: replace(scene, gravity=vector)


def entry_values(field: str, index: int, **values: Any) -> Injection:
    """Replace attributes of one element in a list of the scene.

    Args:
        field: name of the list: "control", "forces", "armatures" or "motions".
        index: index of the element in the list.
        **values: new values of the element's attributes.
    """

    def inject(scene: Scene) -> Scene:
        entries = list(getattr(scene, field))
        entries[index] = replace(entries[index], **values)
        changed: Any = {field: tuple(entries)} | ({"initial_state": None} if field == "motions" else {})
        return replace(scene, **changed)

    return inject


def missing_entry(field: str, index: int) -> Injection:
    """Remove one element from a list of the scene; arguments are as for `entry_values`."""

    def inject(scene: Scene) -> Scene:
        entries = getattr(scene, field)
        changed: Any = {field: (*entries[:index], *entries[index + 1 :]), "initial_state": None}
        return replace(scene, **changed)

    return inject


def coupling(index: int, other: JointCoupling | None) -> Injection:
    """Replace the coupling with an index by another one, or remove the coupling if `other` is None."""

    def inject(scene: Scene) -> Scene:
        mechanism, couplings = scene.mechanism, list(scene.mechanism.couplings)
        couplings[index : index + 1] = [] if other is None else [other]
        changed = Mechanism(mechanism.bodies, mechanism.joints, couplings)
        return replace(scene, mechanism=changed, initial_state=None)

    return inject


def turned_about(axis: Array, angle: float) -> Array:
    """Return the rotation matrix (3, 3) about a unit axis (3,) by an angle, rad."""
    return rotation(from_rotation_vector(angle * axis))


def tilted_axes(joint: Joint, angle: float) -> dict[str, Injection]:
    """Return injections that tilt the axes of a joint by an angle, rad, by description of the tilt.

    - Joint with one axis: the axis is tilted about two perpendicular directions across it. The point on the
      second body, which may lie on the axis, is rotated too.
    - Universal joint: its axes have to stay perpendicular. Each axis is tilted about the other one, and both
      axes about their common normal.
    - Compound joint: each slide and each hinge is tilted about two perpendicular directions across it.
    """
    # Compound joint
    names = joint.axis_names
    if isinstance(joint, Compound):
        found: dict[str, Injection] = {}
        for name in ("slides", "hinges"):
            for k, axis in enumerate(getattr(joint, name)):
                for label, about in zip("uw", perpendicular_pair(axis), strict=True):
                    tilt = turned_about(about, angle).__matmul__
                    found[f"{name}[{k}] about {label}"] = joint_row(joint, name, k, tilt)
        return found
    # Joint with one axis, and joint without an axis
    axes = [np.asarray(getattr(joint, name)) for name in names]
    if len(axes) == 1:
        across = zip("uw", perpendicular_pair(axes[0]), strict=True)
        turns = {f"about {label}": turned_about(about, angle) for label, about in across}
        return {label: _turned_axes(joint, turn, names) for label, turn in turns.items()}
    if not axes:
        return {}
    # Universal joint
    a, b = axes
    return {
        f"{names[0]} about the other": _turned_axes(joint, turned_about(b, angle), names[:1]),
        f"{names[1]} about the other": _turned_axes(joint, turned_about(a, angle), names[1:]),
        "both about their normal": _turned_axes(joint, turned_about(np.cross(a, b), angle), names),
    }


def _turned_axes(joint: Joint, turn: Array, names: Iterable[str]) -> Injection:
    """Rotate axes of a joint, and its point on the second body about its point on the first body.

    Args:
        joint: the joint.
        turn: rotation matrix (3, 3).
        names: names of the axes to rotate.
    """
    axes = {name: turn @ getattr(joint, name) for name in names}
    second = joint.point + turn @ (joint.point_on_second - joint.point)
    return joint_axes(joint.name, {**axes, "point_on_second": second})
