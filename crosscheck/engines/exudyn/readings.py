"""Masses, inertias and joints as Exudyn's system has them, for comparison with those of other engines."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import exudyn as exu
import numpy as np

from newton_euler.equations.system import MassProperties
from newton_euler.model.compound_joint import Compound
from newton_euler.model.euler_parameters import rotation
from newton_euler.model.joint import Joint
from newton_euler.model.joint_geometry import NOWHERE, JointGeometry
from newton_euler.scalars import Array

if TYPE_CHECKING:
    from crosscheck.engines.exudyn.model import Model


def mass_properties(model: Model) -> MassProperties:
    """Return the mass properties of Exudyn's bodies at the initial pose."""
    bodies, found = model.scene.mechanism.bodies, MassProperties.of(model.scene.mechanism)
    for k, body in enumerate(model.bodies[1:], start=1):
        read = model.mbs.GetObject(body)
        xx, yy, zz, yz, xz, xy = read["inertia"]
        turn = rotation(bodies[k].quaternion)
        inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        found.mass[k], found.inertia[k] = read["mass"], turn @ inertia @ turn.T
        found.center_of_mass[k] = model.mbs.GetNode(model.nodes[k - 1])["referenceCoordinates"][:3]
    return found


def weights(model: Model) -> Array:
    """Return the force of gravity (b - 1, 3), N, world frame, on each of Exudyn's moving bodies."""
    read = model.mbs
    pairs = zip(model.bodies[1:], model.weights, strict=True)
    forces = [read.GetObject(body)["mass"] * read.GetLoad(load)["loadVector"] for body, load in pairs]
    return np.reshape(forces, (-1, 3))


def joint_geometry(model: Model) -> dict[str, JointGeometry]:
    """Return the joints, by name, as the markers have them at the present pose, which is the initial one."""
    joints = zip(model.scene.mechanism.joints, model.objects, strict=True)
    return {joint.name: _geometry(model.mbs, joint, objects) for joint, objects in joints}


def _geometry(mbs: Any, joint: Joint, objects: list[Any]) -> JointGeometry:
    """Return the geometry of a joint.

    Motions that no marker describes, such as those of a ball or of three slides, have the axes of the scene.
    """
    kinds = ("rod",) if joint.only_closes else tuple(motion.kind for motion in joint.motions)
    described = np.reshape([motion.axis for motion in joint.motions if motion.kind != "ball"], (-1, 3))
    hinges = [
        point
        for motion, point in zip(joint.motions, joint.motion_points, strict=True)
        if motion.kind == "hinge"
    ]
    if not objects:  # a free joint has no markers
        return JointGeometry(kinds, described, np.array([NOWHERE, NOWHERE, *hinges]))
    first, second = (_marker(mbs, marker) for marker in mbs.GetObject(objects[0])["markerNumbers"])
    points = [first[:3, 3], second[:3, 3], *[second[:3, 3]] * len(hinges)]
    if isinstance(joint, Compound):
        return JointGeometry(kinds, described, np.array(points))
    if joint.kind == "universal":
        axes = [first[:3, 0], second[:3, 1]]
    elif joint.kind == "planar":
        axes = [first[:3, 0], first[:3, 1], first[:3, 2]]
    else:
        axes = [first[:3, 2]] * len(described)
    return JointGeometry(kinds, np.reshape(axes, (-1, 3)), np.array(points))


def _marker(mbs: Any, number: object) -> Array:
    """Return the transform (4, 4) of a marker in the world at the present pose."""
    kinds, transform = exu.OutputVariableType, np.eye(4)
    transform[:3, 3] = mbs.GetMarkerOutput(number, kinds.Position)
    transform[:3, :3] = np.reshape(mbs.GetMarkerOutput(number, kinds.RotationMatrix), (3, 3))
    return transform
