"""Return bodies and joints of a Pinocchio model with closed loops at its initial pose."""

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
    """Return masses and inertias of Pinocchio's model, with the halves of cut bodies combined."""
    data = model.createData()
    pin.framesForwardKinematics(model, data, pin.neutral(model))
    found = MassProperties.of(mechanism)  # keeps the values of the ground, which has no inertia in a URDF
    names = welded.mechanism.body_names
    for body in range(1, len(mechanism.bodies)):
        total = pin.Inertia.Zero()
        for name, whole in zip(names, welded.origin, strict=True):
            if whole == body:
                index = model.getFrameId(name, pin.FrameType.BODY)
                total += data.oMf[index].act(link_inertia(model, index))
        found.mass[body] = total.mass
        found.center_of_mass[body] = total.lever
        found.inertia[body] = total.inertia
    return found


def joint_geometry(closed: ClosedLoopModel, welded: WeldedMechanism) -> dict[str, JointGeometry]:
    """Return geometry of the joints of the model, by name."""
    model, data = closed.model, closed.model.createData()
    pin.computeJointJacobians(model, data, pin.neutral(model))
    pin.updateFramePlacements(model, data)
    columns = np.reshape(data.J, (6, model.nv))

    def read(name: str) -> tuple[str, Array, Array]:
        index = model.getJointId(name)
        joint, point = model.joints[index], data.oMi[index].translation.copy()
        if joint.nv == 3:
            return "ball", NOWHERE, point
        linear, angular = columns[:3, joint.idx_v], columns[3:, joint.idx_v]
        return ("hinge", angular, point) if np.any(angular) else ("slide", linear, point)

    found = geometry_in_tree(welded, read)
    constraints, rods = iter(closed.constraints), iter(closed.rods)
    for cut in welded.tree.cuts:
        joint = welded.tree.joint(cut)
        if joint.only_closes:
            first, second = (data.oMf[frame].translation.copy() for frame in next(rods))
            found[joint.name] = loop_closing_geometry("rod", (first, second))
            continue
        constraint = next(constraints)
        ends = (
            data.oMi[constraint.joint1_id].act(constraint.joint1_placement).translation,
            data.oMi[constraint.joint2_id].act(constraint.joint2_placement).translation,
        )
        if constraint.type == pin.ContactType.CONTACT_3D:
            found[joint.name] = loop_closing_geometry("ball", ends)
    return found
