"""URDF and loop file -> Pinocchio model with rigid constraints.

Pinocchio orders joints by name along each branch and writes quaternions x-y-z-w; `CoordinateMap`
is the one place where that meets the coordinates of `newton_euler`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from newton_euler.scalars import Array
from newton_euler.tree import WeldedMechanism, motion_names
from urdf.errors import LoopFileError, UrdfError
from urdf.loops import Loops

GROUND = "universe"
"""Pinocchio's name of the joint that everything hangs on."""


@dataclass(frozen=True, eq=False)
class ClosedLoopModel:
    """A Pinocchio model and what closes its loops.

    Attributes:
        model: `pinocchio.Model`.
        constraints: `pinocchio.StdVec_RigidConstraintModel`, one for each pair of `closed_loop` that is no
            rod.
        frames: indices of those pairs of frames.
        rods: indices of the pairs of frames that are rods.
        couplings: (c, nv) the equations couplings @ v = 0.
    """

    model: Any
    constraints: Any
    frames: tuple[tuple[int, int], ...]
    rods: tuple[tuple[int, int], ...]
    couplings: Array


def build(
    urdf: str, loops: Loops, alpha: float = 0.0, length: float = 1.0, mass: float = 1.0
) -> ClosedLoopModel:
    """Build the model of a URDF text and its loops.

    Args:
        urdf: URDF text, SI units.
        loops: what the loop file says.
        alpha: 1/s, of Baumgarte's gains K_D = 2 alpha, K_P = alpha^2 in every closure.
        length, mass: the model's units, m and kg.

    Raises:
        UrdfError: for text that is not a URDF.
        LoopFileError: for a frame or joint that the URDF does not have.
    """
    try:
        placeholder = pin.buildModelFromXML(urdf)
    except ValueError as error:
        raise UrdfError(f"not a URDF: {error}") from error
    if list(placeholder.names).count(GROUND) > 1:
        raise UrdfError(f"a joint is named {GROUND!r}, which is Pinocchio's own name of the ground")
    coupled = [name for coupling in loops.coupled for name in coupling]
    named = (("joint_name", loops.joint_name), ("name_mot", loops.name_mot), ("coupled", coupled))
    for key, names in named:
        for name in names:
            if name not in list(placeholder.names)[1:]:
                raise LoopFileError(loops.source, key, f"the URDF has no moving joint {name!r}")
    model = _rebuilt(placeholder, loops.joint_name, length, mass)

    constraints = pin.StdVec_RigidConstraintModel()
    frames, rods = [], []
    for pair, kind in zip(loops.closed_loop, loops.type, strict=True):
        for name in pair:
            if not model.existFrame(name, pin.FrameType.BODY):
                raise LoopFileError(loops.source, "closed_loop", f"the URDF has no link {name!r}")
        first, second = (model.getFrameId(name, pin.FrameType.BODY) for name in pair)
        if kind == "rod":
            rods.append((first, second))
            continue
        constraint = pin.RigidConstraintModel(
            pin.ContactType.CONTACT_3D if kind == "3d" else pin.ContactType.CONTACT_6D,
            model,
            model.frames[first].parentJoint,
            model.frames[first].placement,
            model.frames[second].parentJoint,
            model.frames[second].placement,
            pin.ReferenceFrame.LOCAL,
        )
        constraint.name = " ".join(pair)
        constraint.setBaumgarteCorrectorParameters(
            pin.BaumgarteCorrectorParameters(alpha * alpha, 2.0 * alpha)
        )
        constraints.append(constraint)
        frames.append((first, second))
    couplings = np.zeros((len(loops.coupled), model.nv))
    for row, coupling in zip(couplings, loops.coupled, strict=True):
        for name, factor in coupling.items():
            row[model.joints[model.getJointId(name)].idx_v] = factor
    return ClosedLoopModel(model, constraints, tuple(frames), tuple(rods), couplings)


def _rebuilt(placeholder: Any, balls: tuple[str, ...], length: float, mass: float) -> Any:
    """The same model with ball joints where the named joints are, in units of a length and a mass."""

    def placed(placement: Any) -> Any:
        return pin.SE3(placement.rotation, placement.translation / length)

    def weighed(inertia: Any) -> Any:
        return pin.Inertia(inertia.mass / mass, inertia.lever / length, inertia.inertia / (mass * length**2))

    model = pin.Model()
    model.name = placeholder.name
    for index in range(1, placeholder.njoints):
        name = placeholder.names[index]
        joint = pin.JointModelSpherical() if name in balls else placeholder.joints[index]
        placement = placed(placeholder.jointPlacements[index])
        added = model.addJoint(placeholder.parents[index], joint, placement, name)
        model.appendBodyToJoint(added, weighed(placeholder.inertias[index]), pin.SE3.Identity())
    model.inertias[0] = weighed(placeholder.inertias[0])  # of links that are fixed to the root
    for frame in list(placeholder.frames)[1:]:
        frame.placement, frame.inertia = placed(frame.placement), weighed(frame.inertia)
        model.addFrame(frame, False)  # its inertia is in that of its joint already
    return model


def link_inertia(model: Any, index: int) -> Any:
    """The `pinocchio.Inertia` of the link with frame number `index`, in that frame.

    Pinocchio adds up what fixed joints hold together and keeps the parts with the fixed joints.
    """
    link = model.frames[index]
    leading = model.frames[link.parentFrame]
    if leading.type == pin.FrameType.FIXED_JOINT:
        return leading.inertia
    inertia = model.inertias[link.parentJoint]
    for frame in model.frames:
        held = frame.type == pin.FrameType.FIXED_JOINT and frame.parentJoint == link.parentJoint
        if held and frame.inertia.mass > 0.0:
            inertia = inertia - frame.placement.act(frame.inertia)
    return inertia


class CoordinateMap:
    """Between coordinates of a mechanism's spanning tree and those of its Pinocchio model.

    Both measure the same motions and count the same way; Pinocchio's stand in another order, and
    its quaternions are x-y-z-w. Angular velocities of balls are in the child's frame in both.
    """

    def __init__(self, model: Any, welded: WeldedMechanism) -> None:
        order_q = np.zeros(model.nq, dtype=int)
        order_v = np.zeros(model.nv, dtype=int)
        tree = welded.tree
        names = [name for kept in tree.joints for name in motion_names(tree.joint(kept.joint), kept.forward)]
        for name, (motion, on_q, on_v) in zip(names, tree.motions, strict=True):
            joint = model.joints[model.getJointId(name)]
            columns = np.arange(on_q.start, on_q.stop)
            if motion.kind == "ball":
                columns = np.roll(columns, -1)
            order_q[joint.idx_q : joint.idx_q + joint.nq] = columns
            order_v[joint.idx_v : joint.idx_v + joint.nv] = np.arange(on_v.start, on_v.stop)
        self._order_q, self._order_v = order_q, order_v
        self._place_v = np.argsort(order_v)

    def q_to_pinocchio(self, q: Array) -> Array:
        """Pinocchio's coordinates (nq,) of the tree's."""
        return q[self._order_q]

    def v_to_pinocchio(self, v: Array) -> Array:
        """Pinocchio's velocities, accelerations or generalized forces (nv,) of the tree's."""
        return v[self._order_v]

    def v_from_pinocchio(self, v: Array) -> Array:
        """The tree's velocities, accelerations or Jacobian columns (..., nv) of Pinocchio's."""
        return v[..., self._place_v]
