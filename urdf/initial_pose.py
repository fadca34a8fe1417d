"""Read the bodies and joints back from the Pinocchio model of an exported scene, at its initial pose.

`urdf.dynamics` builds the model from the scene's URDF and loop file (closed loops, which a URDF cannot
describe). crosscheck compares the results with the scene, to find errors of the URDF export and of
Pinocchio's parser. The export splits joints into hinges, slides and balls. In the initial pose, Pinocchio's
configuration is neutral. All results are in the world frame.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin

from newton_euler.equations.system import MassProperties
from newton_euler.model.joint_geometry import NOWHERE, JointGeometry, geometry_in_tree, loop_closing_geometry
from newton_euler.model.mechanism import Mechanism
from newton_euler.model.spanning_tree import WeldedMechanism
from newton_euler.scalars import Array
from urdf.model import ClosedLoopModel, link_inertia


def mass_properties(mechanism: Mechanism, model: Any, welded: WeldedMechanism) -> MassProperties:
    """Return masses and inertias of Pinocchio's model, with the halves of cut bodies combined.

    Args:
        mechanism: mechanism of the scene; the ground, which has no inertia in a URDF, keeps its values.
        model: `pinocchio.Model` of the welded mechanism.
        welded: mechanism in which a body is cut into halves at each loop that Pinocchio closes by a weld.
    """
    data = model.createData()
    pin.framesForwardKinematics(model, data, pin.neutral(model))
    # start from the declared values, which remain for the ground; overwrite all others
    properties = MassProperties.of(mechanism)
    names = welded.mechanism.body_names
    for body in range(1, len(mechanism.bodies)):
        total = pin.Inertia.Zero()
        # `origin` has, for each body of the welded mechanism, the body of the scene that it is a part of
        for name, whole in zip(names, welded.origin, strict=True):
            if whole == body:
                index = model.getFrameId(name, pin.FrameType.BODY)
                total += data.oMf[index].act(link_inertia(model, index))
        properties.mass[body] = total.mass
        properties.center_of_mass[body] = total.lever
        properties.inertia[body] = total.inertia
    return properties


def joint_geometry(closed_model: ClosedLoopModel, welded: WeldedMechanism) -> dict[str, JointGeometry]:
    """Return kinds, axes and points of the joints of a Pinocchio model, by name.

    Args:
        closed_model: Pinocchio's model with its loop closures.
        welded: welded mechanism that the model was built from.
    """
    model, data = closed_model.model, closed_model.model.createData()
    pin.computeJointJacobians(model, data, pin.neutral(model))
    pin.updateFramePlacements(model, data)
    columns = np.reshape(data.J, (6, model.nv))  # linear and angular velocity per joint velocity

    names = welded.tree.motion_names

    def read(number: int) -> tuple[str, Array, Array]:
        """Return kind, axis (3,) and point (3,), m, world frame, of a joint of the tree."""
        index = model.getJointId(names[number])
        joint, point = model.joints[index], data.oMi[index].translation.copy()
        if joint.nv == 3:  # a ball, which has no axis
            return "ball", NOWHERE, point
        linear, angular = columns[:3, joint.idx_v], columns[3:, joint.idx_v]
        return ("hinge", angular, point) if np.any(angular) else ("slide", linear, point)

    geometry = geometry_in_tree(welded, read)
    # joints that close loops: rods (joints that keep the distance of two points, `only_closes`), balls and
    # welds. Welds join halves of cut bodies, and are no joints of the scene
    constraints, rods = iter(closed_model.constraints), iter(closed_model.rods)
    for cut in welded.tree.cuts:
        joint = welded.tree.joint(cut)
        if joint.only_closes:
            first, second = (data.oMf[frame].translation.copy() for frame in next(rods))
            geometry[joint.name] = loop_closing_geometry("rod", (first, second))
            continue
        constraint = next(constraints)
        ends = (
            data.oMi[constraint.joint1_id].act(constraint.joint1_placement).translation,
            data.oMi[constraint.joint2_id].act(constraint.joint2_placement).translation,
        )
        if constraint.type == pin.ContactType.CONTACT_3D:
            geometry[joint.name] = loop_closing_geometry("ball", ends)
    return geometry
