"""Level "model": masses, inertias and joints as each engine's own model has them.

A level is a group of checks; these checks compare the models of two engines, body by body and joint by joint.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from crosscheck.compare.check import ROUND_OFF, Check, both_values, reach
from crosscheck.compare.samples import Samples
from newton_euler.model.euler_parameters import angle_between
from newton_euler.model.joint_geometry import NOWHERE, JointGeometry
from newton_euler.scalars import Array


def model_checks(pair: tuple[str, str], first: Samples, second: Samples) -> Iterator[Check]:
    """Compare mass properties and frames of bodies, and kinds, axes and points of joints, of two engines.

    Args:
        pair: names of the two engines.
        first, second: equations of motion of the two engines at the same states, with the properties of their
            own models.
    """
    scene = first.states.scene
    a, b = first.mass_properties, second.mass_properties
    bodies, joints = scene.mechanism.body_names[1:], scene.mechanism.joint_names

    def check_largest(
        quantity: str,
        gap: Array,
        tolerance: float,
        names: Sequence[str],
        values: Sequence[tuple[Array, Array]] = (),
        unit: str = "",
    ) -> Check:
        """Make the check of the largest difference.

        Args:
            quantity, tolerance: attributes of the check.
            gap: (n,) differences of n bodies or joints.
            names: names of the bodies or joints.
            values: values of both engines for each name, which are the detail of a failing check.
            unit: unit of the values.
        """
        worst = int(np.argmax(gap))
        value, detail = float(gap[worst]), ""
        if values and value > tolerance:
            detail = both_values(pair, *values[worst], unit)
        return Check("model", quantity, pair, value, tolerance, names[worst], detail=detail)

    # Bodies, without the ground. Round-off of positions is relative to the largest coordinate (`reach`)
    mass = np.abs(a.mass - b.mass)[1:] / np.abs(a.mass[1:])
    inertia = np.abs(a.inertia - b.inertia)[1:].max(axis=(1, 2)) / np.abs(a.inertia[1:]).max(axis=(1, 2))
    center = np.abs(a.center_of_mass - b.center_of_mass)[1:].max(axis=1)
    length = ROUND_OFF * reach(scene, a.center_of_mass)
    masses, centers, inertias = (
        [(getattr(a, name)[k], getattr(b, name)[k]) for k in range(1, len(a.mass))]
        for name in ("mass", "center_of_mass", "inertia")
    )
    yield check_largest("mass, rel", mass, ROUND_OFF, bodies, masses, "kg")
    yield check_largest("center of mass, m", center, length, bodies, centers, "m")
    yield check_largest("inertia, rel", inertia, ROUND_OFF, bodies, inertias, "kg m^2")
    turned = angle_between(first.initial_orientations, second.initial_orientations)[1:]
    yield check_largest("body frame, rad", turned, ROUND_OFF, bodies)
    # Joints; an engine's model may lack a joint: then its geometry is None, and axes and points are NaN
    pairs = [(first.joints.get(joint), second.joints.get(joint)) for joint in joints]
    differ = np.array([_kinds_differ(*both) for both in pairs])  # 0 or 1
    yield check_largest("joint kinds, differing", differ, 0.5, joints)
    turned = np.array([_axis_angle(*both) for both in pairs])
    axes = [(x.axes, y.axes) if x and y else (NOWHERE, NOWHERE) for x, y in pairs]
    yield check_largest("joint axes, rad", turned, ROUND_OFF, joints, axes)
    points = [(x.points, y.points) if x and y else (NOWHERE, NOWHERE) for x, y in pairs]
    distances = np.array([_point_distance(*both) for both in pairs])
    yield check_largest("joint points, m", distances, length, joints, points, "m")


def _kinds_differ(a: JointGeometry | None, b: JointGeometry | None) -> float:
    """Return 1 if two joints allow different motions or if one of them is missing, else 0."""
    if a is None or b is None:
        return float(a is not b)
    return float(a.kinds != b.kinds)


def _axis_angle(a: JointGeometry | None, b: JointGeometry | None) -> float:
    """Return the largest angle between corresponding axes of two joints, rad; 0 if their kinds differ."""
    if a is None or b is None or a.kinds != b.kinds:
        return 0.0
    # chord = 2 sin(angle / 2) of unit vectors is accurate for small angles, unlike the arc cosine
    chords = np.linalg.norm(a.axes - b.axes, axis=1)
    return float(np.max(2.0 * np.arcsin(np.clip(0.5 * chords, 0.0, 1.0)), initial=0.0))


def _point_distance(a: JointGeometry | None, b: JointGeometry | None) -> float:
    """Return the largest distance between corresponding points of two joints, m; 0 if their kinds differ."""
    if a is None or b is None or a.kinds != b.kinds:
        return 0.0
    # points that an engine's model does not have are NaN
    return float(np.nanmax(np.linalg.norm(a.points - b.points, axis=1), initial=0.0))
