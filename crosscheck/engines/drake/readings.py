"""Masses, inertias and joints as Drake's plant has them, for comparison with those of other engines."""

from __future__ import annotations

import numpy as np

from crosscheck.engines.drake.placed import PlacedPlant
from newton_euler.equations.system import MassProperties
from newton_euler.model.joint_geometry import NOWHERE, JointGeometry, geometry_in_tree, loop_closing_geometry
from newton_euler.model.mechanism import Mechanism
from newton_euler.scalars import Array

KINDS = {"revolute": "hinge", "prismatic": "slide", "ball_rpy": "ball"}
"""Kind of motion of each type of Drake's joints."""


def mass_properties(mechanism: Mechanism, placed: PlacedPlant) -> MassProperties:
    """Return the mass properties of the plant at the initial pose, with the halves of cut bodies combined.

    Args:
        mechanism: mechanism of the scene.
        placed: the plant at the initial pose.
    """
    plant, welded, found = placed.plant, placed.built.welded, MassProperties.of(mechanism)
    for body in range(1, len(mechanism.bodies)):
        parts = [k for k, whole in enumerate(welded.origin) if whole == body]
        indices = [placed.built.bodies[part].index() for part in parts]
        total = plant.CalcSpatialInertia(placed.context, plant.world_frame(), indices)
        found.mass[body], found.center_of_mass[body] = total.get_mass(), total.get_com()
        about_center = total.Shift(total.get_com()).CalcRotationalInertia()
        found.inertia[body] = about_center.CopyToFullMatrix3()
    return found


def joint_geometry(placed: PlacedPlant) -> dict[str, JointGeometry]:
    """Return the joints by name, as the plant has them at the initial pose."""

    def read(number: int) -> tuple[str, Array, Array]:
        """Return kind, axis and point of a joint of Drake."""
        joint = placed.built.motions[number]
        point, turn = placed.pose(joint.frame_on_child())
        kind = KINDS[joint.type_name()]
        if kind == "ball":
            return kind, NOWHERE, point
        axis = joint.revolute_axis() if kind == "hinge" else joint.translation_axis()
        return kind, turn @ axis, point

    geometry = geometry_in_tree(placed.built.welded, read)
    for loop in placed.built.anchors:
        if loop.kind != "weld":
            (first, _), (second, _) = placed.pose(loop.first), placed.pose(loop.second)
            name = placed.built.welded.mechanism.joints[loop.joint].name
            geometry[name] = loop_closing_geometry(loop.kind, (np.array(first), np.array(second)))
    return geometry
