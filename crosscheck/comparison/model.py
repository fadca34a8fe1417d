"""Level "model": the engines' own models, body by body and joint by joint."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from crosscheck.comparison.figure import ROUND_OFF, Figure, reach
from crosscheck.comparison.samples import Samples
from newton_euler.model.euler_parameters import angle_between
from newton_euler.model.joint_geometry import JointGeometry
from newton_euler.scalars import Array


def model_rows(pair: tuple[str, str], first: Samples, second: Samples) -> Iterator[Figure]:
    """Masses, centers of mass, inertias and frames of bodies; kinds, axes and points of joints."""
    scene = first.states.scene
    a, b = first.mass_properties, second.mass_properties
    names = scene.mechanism.body_names[1:]

    def row(quantity: str, gap: Array, tolerance: float, names: Sequence[str]) -> Figure:
        worst = int(np.argmax(gap))
        return Figure("model", quantity, pair, float(gap[worst]), tolerance, names[worst])

    mass = np.abs(a.mass - b.mass)[1:] / np.abs(a.mass[1:])
    inertia = np.abs(a.inertia - b.inertia)[1:].max(axis=(1, 2)) / np.abs(a.inertia[1:]).max(axis=(1, 2))
    center = np.abs(a.center_of_mass - b.center_of_mass)[1:].max(axis=1)
    length = ROUND_OFF * reach(scene, a.center_of_mass)
    yield row("mass, rel", mass, ROUND_OFF, names)
    yield row("center of mass, m", center, length, names)
    yield row("inertia, rel", inertia, ROUND_OFF, names)
    turned = angle_between(first.initial_orientations, second.initial_orientations)[1:]
    yield row("body frame, rad", turned, ROUND_OFF, names)
    joints = scene.mechanism.joint_names
    pairs = [(first.joints.get(joint), second.joints.get(joint)) for joint in joints]
    yield row("joint kinds, differing", np.array([_differs(*both) for both in pairs]), 0.5, joints)
    yield row("joint axes, rad", np.array([_turned(*both) for both in pairs]), ROUND_OFF, joints)
    yield row("joint points, m", np.array([_apart(*both) for both in pairs]), length, joints)


def _differs(a: JointGeometry | None, b: JointGeometry | None) -> float:
    """1 where two joints allow other motions or one of them is missing, else 0."""
    if a is None or b is None:
        return float(a is not b)
    return float(a.kinds != b.kinds)


def _turned(a: JointGeometry | None, b: JointGeometry | None) -> float:
    """The largest angle between axes of the same motion, rad."""
    if a is None or b is None or a.kinds != b.kinds:
        return 0.0
    # of unit vectors, exact to round-off where they are close: chord = 2 sin(angle / 2)
    chords = np.linalg.norm(a.axes - b.axes, axis=1)
    return float(np.max(2.0 * np.arcsin(np.clip(0.5 * chords, 0.0, 1.0)), initial=0.0))


def _apart(a: JointGeometry | None, b: JointGeometry | None) -> float:
    """The largest distance between points that both have, m."""
    if a is None or b is None or a.kinds != b.kinds:
        return 0.0
    return float(np.nanmax(np.linalg.norm(a.points - b.points, axis=1), initial=0.0))
