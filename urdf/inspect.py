"""Contents of a Pinocchio model, for comparisons: joints and the terms of the equations of motion."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from newton_euler.model.joint_geometry import NOWHERE, JointGeometry, closing, in_tree
from newton_euler.model.spanning_tree import weld_loops
from newton_euler.scalars import Array
from urdf.dynamics import PinocchioSystem


def joint_geometry(system: PinocchioSystem) -> dict[str, JointGeometry]:
    """The joints of a model at its initial pose."""
    closed, welded = system.closed, weld_loops(system.mechanism, loaded=system.scene.loaded_balls)
    model = closed.model
    data = model.createData()
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

    found = in_tree(welded, read)
    constraints, rods = iter(closed.constraints), iter(closed.rods)
    for cut in welded.tree.cuts:
        joint = welded.tree.joint(cut)
        if joint.only_closes:
            first, second = (data.oMf[frame].translation.copy() for frame in next(rods))
            found[joint.name] = closing("rod", (first, second))
            continue
        constraint = next(constraints)
        ends = (
            data.oMi[constraint.joint1_id].act(constraint.joint1_placement).translation,
            data.oMi[constraint.joint2_id].act(constraint.joint2_placement).translation,
        )
        if constraint.type == pin.ContactType.CONTACT_3D:
            found[joint.name] = closing("ball", ends)
    return found


def mass_and_force(system: PinocchioSystem, q: Array, v: Array) -> tuple[Array, Array]:
    """M (nv, nv) and f (nv,) of M vdot = f + J^T lambda in tree velocities, by Pinocchio."""
    model, to_tree = system.closed.model, system.map.v_from_pinocchio
    bias = pin.nonLinearEffects(
        model, model.createData(), system.map.q_to_pinocchio(q), system.map.v_to_pinocchio(v)
    )
    return system.mass_matrix(q), system.generalized_force(q, v) - to_tree(bias)
