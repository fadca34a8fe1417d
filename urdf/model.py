"""Build a Pinocchio model with rigid constraints from a URDF and its loop file.

Pinocchio orders joints by name along each branch and has quaternions (x, y, z, w). `CoordinateMap` converts
to and from the coordinates of `newton_euler`.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Container, Iterable
from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np
import pinocchio as pin

from newton_euler.model.spanning_tree import WeldedMechanism, motion_names
from newton_euler.scalars import Array
from urdf.errors import LoopFileError, UrdfError
from urdf.loops import REVOLUTE, UNIVERSAL, Loops

HINGE_MODELS = {"X": pin.JointModelRX, "Y": pin.JointModelRY, "Z": pin.JointModelRZ}

BaseName = Literal["fixed", "free"]
"""Root link of a URDF: fixed to the ground, or free."""

BASES: tuple[BaseName, ...] = get_args(BaseName)

MAX_ROUNDED_COMPONENT = 1e-11
"""Component of a unit axis that Pinocchio's parser may round to 0; the parser rounds below 1e-12."""

PINOCCHIO_GROUND = "universe"
"""Pinocchio's name of the root joint."""


@dataclass(frozen=True, eq=False)
class ClosedLoopModel:
    """Pinocchio model with its loop closures.

    Attributes:
        model: `pinocchio.Model`.
        constraints: `pinocchio.StdVec_RigidConstraintModel`, one for each loop closure except rods. A hinge
            has two: points on its axis, 1 m apart, because Pinocchio has no hinge constraint.
        frames: numbers of the two frames of each constraint.
        rods: numbers of the two frames of each rod.
        couplings: (c, d, nv) factors of the powers 1 to d of the coordinates of hinges and slides, by number
            of the velocity. The sum of the products is zero.
        urdf_joints: name of the joint of the URDF for each joint of Pinocchio.
    """

    model: Any
    constraints: Any
    frames: tuple[tuple[int, int], ...]
    rods: tuple[tuple[int, int], ...]
    couplings: Array
    urdf_joints: tuple[str, ...]


def build(
    urdf: str,
    loops: Loops,
    alpha: float = 0.0,
    base: BaseName = "fixed",
    keeps_axes: bool = False,
) -> ClosedLoopModel:
    """Build the model of a URDF text and its loops.

    Args:
        urdf: URDF text, SI units.
        loops: content of the loop file.
        alpha: 1/s, of Baumgarte's gains K_D = 2 alpha, K_P = alpha^2 in every closure.
        base: one of `BASES`.
        keeps_axes: True to keep axes within 1e-12 of a coordinate axis, which Pinocchio's parser rounds.

    Raises:
        UrdfError: for text that is not a URDF.
        LoopFileError: for a frame or joint that the URDF does not have.
    """
    # parse the URDF, and replace joints by the types of the loop file
    try:
        root = () if base == "fixed" else (pin.JointModelFreeFlyer(),)
        placeholder = pin.buildModelFromXML(urdf, *root)
    except ValueError as error:
        raise UrdfError(f"not a URDF: {error}") from error
    if list(placeholder.names).count(PINOCCHIO_GROUND) > 1:
        raise UrdfError(
            f"a joint is named {PINOCCHIO_GROUND!r}, Pinocchio's name of the ground; rename the joint"
        )
    _check_joints(loops, "joint_name", loops.joint_name, list(placeholder.names)[1:])
    types = dict(zip(loops.joint_name, loops.joint_type, strict=True))
    held = [placeholder.getJointId(name) for name, kind in types.items() if kind == "FIXED"]
    if held:
        placeholder = pin.buildReducedModel(placeholder, held, pin.neutral(placeholder))
    _check_joints(loops, "name_mot", loops.name_mot, list(placeholder.names)[1:])
    model, urdf_joints = _rebuilt(placeholder, types, _rounded_axes(urdf) if keeps_axes else {})

    # loop closures
    constraints = pin.StdVec_RigidConstraintModel()
    frames, rods = [], []
    for pair, kind in zip(loops.closed_loop, loops.type, strict=True):
        first, second = (_frame(model, name, loops) for name in pair)
        if kind == "rod":
            rods.append((first, second))
            continue
        pairs = [(first, second)]
        if kind == REVOLUTE:
            pairs.append((_add_axis_frame(model, first), _add_axis_frame(model, second)))
        for one, two in pairs:
            constraint = pin.RigidConstraintModel(
                pin.ContactType.CONTACT_6D if kind == "6d" else pin.ContactType.CONTACT_3D,
                model,
                model.frames[one].parentJoint,
                model.frames[one].placement,
                model.frames[two].parentJoint,
                model.frames[two].placement,
                pin.ReferenceFrame.LOCAL,
            )
            constraint.name = " ".join(pair)
            constraint.setBaumgarteCorrectorParameters(
                pin.BaumgarteCorrectorParameters(alpha * alpha, 2.0 * alpha)
            )
            constraints.append(constraint)
            frames.append((one, two))
    # couplings of hinges and slides
    single = {str(n): j.idx_v for n, j in zip(model.names, model.joints, strict=True) if j.nv == 1}
    degree = max((len(factors) for coupling in loops.coupled for factors in coupling.values()), default=1)
    couplings = np.zeros((len(loops.coupled), degree, model.nv))
    for rows, coupling in zip(couplings, loops.coupled, strict=True):
        _check_joints(loops, "coupled", coupling, single)
        for name, factors in coupling.items():
            rows[: len(factors), single[name]] = factors
    return ClosedLoopModel(model, constraints, tuple(frames), tuple(rods), couplings, urdf_joints)


def _check_joints(loops: Loops, key: str, names: Iterable[str], known: Container[str]) -> None:
    for name in names:
        if name not in known:
            raise LoopFileError(loops.source, key, f"the URDF has no moving joint {name!r}")


def _frame(model: Any, name: str, loops: Loops) -> int:
    """Return the number of the frame of a link or joint, like Pinocchio's `getFrameId`."""
    found = [number for number, frame in enumerate(model.frames) if frame.name == name]
    if not found:
        raise LoopFileError(loops.source, "closed_loop", f"the URDF has no link or joint {name!r}")
    first, *others = (model.frames[number] for number in found)
    for other in others:
        if other.parentJoint != first.parentJoint or not other.placement.isApprox(first.placement):
            problem = f"{name!r} is a link and a joint in different places; needed: one place"
            raise LoopFileError(loops.source, "closed_loop", problem)
    return found[0]


def _add_axis_frame(model: Any, frame: int) -> int:
    """Add a frame at a distance of 1 m along the x axis of a frame; return its number."""
    beside = pin.Frame(model.frames[frame])
    beside.name, beside.inertia = f"axis of {beside.name}", pin.Inertia.Zero()
    beside.placement = beside.placement * pin.SE3(np.eye(3), np.array([1.0, 0.0, 0.0]))
    return int(model.addFrame(beside, False))


def _rounded_axes(urdf: str) -> dict[str, Array]:
    """Return axes (3,) of a URDF that Pinocchio's parser may round, by joint name."""
    found = {}
    for joint in ET.fromstring(urdf).findall("joint"):
        element = joint.find("axis")
        if element is not None:
            axis = np.array([float(x) for x in element.get("xyz", "").split()])
            small = np.abs(axis) < MAX_ROUNDED_COMPONENT
            if np.sum(small) == 2 and np.any(axis[small]):
                found[str(joint.get("name"))] = axis / np.linalg.norm(axis)
    return found


def _rebuilt(placeholder: Any, types: dict[str, str], axes: dict[str, Array]) -> tuple[Any, tuple[str, ...]]:
    """Rebuild a model with other types or axes of some joints.

    Returns:
        The model, and for each of its joints the name of the joint in the placeholder.
    """
    model = pin.Model()
    model.name = placeholder.name
    numbers, owners = [0], [PINOCCHIO_GROUND]
    for index in range(1, placeholder.njoints):
        owner = name = str(placeholder.names[index])
        parent, placement = numbers[placeholder.parents[index]], placeholder.jointPlacements[index]
        joint, kind = placeholder.joints[index], types.get(name)
        if kind is None and name in axes:
            slides = joint.shortname().startswith("JointModelP")
            joint = (pin.JointModelPrismaticUnaligned if slides else pin.JointModelRevoluteUnaligned)(
                axes[name]
            )
        if kind == "SPHERICAL":
            joint = pin.JointModelSpherical()
        elif kind in UNIVERSAL:
            first, second = UNIVERSAL[kind][0], UNIVERSAL[kind][1]
            parent = model.addJoint(parent, HINGE_MODELS[first](), placement, f"{owner}_{first}")
            owners.append(owner)
            joint, placement, name = HINGE_MODELS[second](), pin.SE3.Identity(), f"{owner}_{second}"
        added = model.addJoint(parent, joint, placement, name)
        model.appendBodyToJoint(added, placeholder.inertias[index], pin.SE3.Identity())
        numbers.append(added)
        owners.append(owner)
    model.inertias[0] = placeholder.inertias[0]  # inertia of links that are fixed to the root
    for frame in list(placeholder.frames)[1:]:
        frame.parentJoint = numbers[frame.parentJoint]
        model.addFrame(frame, False)  # the inertia of the joint already includes the frame
    return model, tuple(owners)


def link_inertia(model: Any, index: int) -> Any:
    """Return the `pinocchio.Inertia` of the link with frame number `index`, in the frame.

    Pinocchio adds the inertias of links that fixed joints connect, and keeps the parts at the fixed joints.
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


def mass_matrix(model: Any, data: Any, map: CoordinateMap, q: Array) -> Array:
    """Compute the mass matrix (nv, nv) in tree velocities, armature included, at Pinocchio's q (nq,)."""
    upper = np.array(pin.crba(model, data, q))  # Pinocchio fills the upper triangle only
    mass = np.where(map.below, upper.T, upper)
    return map.v_from_pinocchio(map.v_from_pinocchio(mass).T)


class CoordinateMap:
    """Map between coordinates of a mechanism's spanning tree and its Pinocchio model.

    Both have the same coordinates and signs. Pinocchio has another order, and quaternions (x, y, z, w).
    Angular velocities of balls are in the frame of the child in both.

    Attributes:
        below: (nv, nv) True below the diagonal of a mass matrix.
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
        single = [(on_q.start, on_v.start) for motion, on_q, on_v in tree.motions if motion.kind != "ball"]
        self._single_q, self._single_v = np.array(single, dtype=int).reshape(-1, 2).T
        self._order_q, self._order_v = order_q, order_v
        self._place_q, self._place_v = np.argsort(order_q), np.argsort(order_v)
        self.below = np.tri(model.nv, k=-1, dtype=bool)

    def displacements(self, q: Array) -> Array:
        """Return coordinates (nv,) of hinges and slides by number of the velocity; 0 for balls."""
        found = np.zeros(len(self._order_v))
        found[self._single_v] = q[self._single_q]
        return found

    def q_to_pinocchio(self, q: Array) -> Array:
        """Convert coordinates (nq,) of the tree to Pinocchio's."""
        return q.take(self._order_q)

    def q_from_pinocchio(self, q: Array) -> Array:
        """Convert Pinocchio's coordinates (nq,) to the tree's."""
        return q.take(self._place_q)

    def v_to_pinocchio(self, v: Array) -> Array:
        """Convert velocities, accelerations or generalized forces (nv,) of the tree to Pinocchio's."""
        return v.take(self._order_v)

    def v_from_pinocchio(self, v: Array) -> Array:
        """Convert Pinocchio's velocities, accelerations or Jacobian columns (..., nv) to the tree's."""
        return v.take(self._place_v, axis=-1)
