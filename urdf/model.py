"""Build a Pinocchio model with loop closures from the text of a URDF and its loop file.

The loop file (`urdf.loops`) lists loop closures, couplings and types of joints that a URDF cannot describe.
Pinocchio orders the joints of each branch by name, and has quaternions (x, y, z, w). `CoordinateMap` converts
between Pinocchio's coordinates and those of newton_euler's spanning tree.
"""

from __future__ import annotations

from collections.abc import Container, Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from newton_euler.model.source_file import xml_tree
from newton_euler.model.spanning_tree import WeldedMechanism
from newton_euler.scalars import Array
from urdf.errors import LoopFileError, UrdfError
from urdf.loops import REVOLUTE, UNIVERSAL, Loops
from urdf.reading.planes import axes_of_plane, axis_vector, turned_planes
from urdf.reading.vocabulary import BaseName

HINGE_MODELS = {"X": pin.JointModelRX, "Y": pin.JointModelRY, "Z": pin.JointModelRZ}
"""Pinocchio's joint models of hinges, by axis."""

MAX_ROUNDED_COMPONENT = 1e-11
"""Component of a unit axis below which Pinocchio's parser may round to 0; the parser rounds below 1e-12."""

PINOCCHIO_GROUND = "universe"
"""Pinocchio's name of joint 0, to which the ground belongs."""


@dataclass(frozen=True, eq=False)
class ClosedLoopModel:
    """Pinocchio model with its loop closures.

    Attributes:
        model: `pinocchio.Model`.
        constraints: `pinocchio.StdVec_RigidConstraintModel`, one for each loop closure except rods. A closure
            by a hinge has two: points on its axis, 1 m apart, because Pinocchio has no hinge constraint.
        frames: numbers of the two frames of each constraint.
        rods: numbers of the two frames of each rod.
        couplings: (c, d, nv) factors of the powers 1 to d of the coordinates of hinges and slides, by index
            of the velocity, for each of c couplings. The sum of the factors times the powers is zero.
        urdf_joints: name of the joint in the URDF for each of Pinocchio's joints.
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
        alpha: parameter, 1/s, of Baumgarte's stabilization in every closure: K_D = 2 alpha, K_P = alpha^2.
        base: motion of the root link, one of `BASES`.
        keeps_axes: True to keep axes within 1e-12 of a coordinate axis, which Pinocchio's parser rounds to
            the coordinate axis.

    Raises:
        UrdfError: for text that is not a URDF.
        LoopFileError: for a frame or joint that the URDF does not have.
    """
    # parse the URDF, hold FIXED joints, and replace other joints by the types of the loop file
    try:
        root_joint = () if base == "fixed" else (pin.JointModelFreeFlyer(),)
        parsed = pin.buildModelFromXML(urdf, *root_joint)
    except ValueError as error:
        raise UrdfError(f"not a URDF: {error}") from error
    if list(parsed.names).count(PINOCCHIO_GROUND) > 1:
        raise UrdfError(
            f"a joint is named {PINOCCHIO_GROUND!r}, Pinocchio's name of the ground; rename the joint"
        )
    _check_joints(loops, "joint_name", loops.joint_name, list(parsed.names)[1:])
    types = dict(zip(loops.joint_name, loops.joint_type, strict=True))
    held = [parsed.getJointId(name) for name, kind in types.items() if kind == "FIXED"]
    if held:
        parsed = pin.buildReducedModel(parsed, held, pin.neutral(parsed))
    _check_joints(loops, "name_mot", loops.name_mot, list(parsed.names)[1:])  # joints with a motor
    planes = turned_planes(xml_tree(urdf)) if "planar" in urdf else {}
    model, urdf_joints = _rebuild(parsed, types, _rounded_axes(urdf) if keeps_axes else {}, planes)

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
        for frame_1, frame_2 in pairs:
            constraint = pin.RigidConstraintModel(
                pin.ContactType.CONTACT_6D if kind == "6d" else pin.ContactType.CONTACT_3D,
                model,
                model.frames[frame_1].parentJoint,
                model.frames[frame_1].placement,
                model.frames[frame_2].parentJoint,
                model.frames[frame_2].placement,
                pin.ReferenceFrame.LOCAL,
            )
            constraint.name = " ".join(pair)
            k_p, k_d = alpha * alpha, 2.0 * alpha
            constraint.setBaumgarteCorrectorParameters(pin.BaumgarteCorrectorParameters(k_p, k_d))
            constraints.append(constraint)
            frames.append((frame_1, frame_2))
    # couplings of hinges and slides
    velocity_index = {
        str(name): joint.idx_v for name, joint in zip(model.names, model.joints, strict=True) if joint.nv == 1
    }
    degree = max((len(factors) for coupling in loops.coupled for factors in coupling.values()), default=1)
    couplings = np.zeros((len(loops.coupled), degree, model.nv))
    for powers, coupling in zip(couplings, loops.coupled, strict=True):
        _check_joints(loops, "coupled", coupling, velocity_index)
        for name, factors in coupling.items():
            powers[: len(factors), velocity_index[name]] = factors
    return ClosedLoopModel(model, constraints, tuple(frames), tuple(rods), couplings, urdf_joints)


def _check_joints(loops: Loops, key: str, names: Iterable[str], known: Container[str]) -> None:
    """Raise `LoopFileError` for a name below `key` in the loop file that is not among the known joints."""
    for name in names:
        if name not in known:
            raise LoopFileError(loops.source, key, f"the URDF has no moving joint {name!r}")


def _frame(model: Any, name: str, loops: Loops) -> int:
    """Return the number of the frame of a link or joint; if both have the name, they must be in one place."""
    numbers_of_name = [number for number, frame in enumerate(model.frames) if frame.name == name]
    if not numbers_of_name:
        raise LoopFileError(loops.source, "closed_loop", f"the URDF has no link or joint {name!r}")
    first, *others = (model.frames[number] for number in numbers_of_name)
    for other in others:
        if other.parentJoint != first.parentJoint or not other.placement.isApprox(first.placement):
            problem = f"{name!r} is a link and a joint in different places; needed: one place"
            raise LoopFileError(loops.source, "closed_loop", problem)
    return numbers_of_name[0]


def _add_axis_frame(model: Any, frame: int) -> int:
    """Add a frame at a distance of 1 m along the x axis of a frame; return its number."""
    on_axis = pin.Frame(model.frames[frame])
    on_axis.name, on_axis.inertia = f"axis of {on_axis.name}", pin.Inertia.Zero()
    on_axis.placement = on_axis.placement * pin.SE3(np.eye(3), np.array([1.0, 0.0, 0.0]))
    return int(model.addFrame(on_axis, False))


def _rounded_axes(urdf: str) -> dict[str, Array]:
    """Return axes (3,) of a URDF that Pinocchio's parser may round, by joint name."""
    axes = {}
    for joint in xml_tree(urdf).findall("joint"):
        axis = axis_vector(joint)
        small = np.abs(axis) < MAX_ROUNDED_COMPONENT
        # nearly, but not exactly, along a coordinate axis
        if np.sum(small) == 2 and np.any(axis[small]):
            axes[str(joint.get("name"))] = axis / np.linalg.norm(axis)
    return axes


def _rebuild(
    parsed: Any, types: dict[str, str], axes: dict[str, Array], planes: dict[str, Array]
) -> tuple[Any, tuple[str, ...]]:
    """Copy a model with other types or axes of some joints.

    Args:
        parsed: `pinocchio.Model` that the parser has built.
        types: one of `urdf.loops.JOINT_TYPES` by name of the joint.
        axes: (3,) axis by name of the joint.
        planes: (3,) normal of the plane of a planar joint, by name of the joint.

    Returns:
        The model, and for each of its joints the name of the joint in the parsed model.
    """
    model = pin.Model()
    model.name = parsed.name
    # new number of each joint of the parsed model, and old name of each joint of the new model
    numbers, urdf_joints = [0], [PINOCCHIO_GROUND]
    for index in range(1, parsed.njoints):
        urdf_joint = name = str(parsed.names[index])
        parent, placement = numbers[parsed.parents[index]], parsed.jointPlacements[index]
        joint, kind = parsed.joints[index], types.get(name)
        if kind is None and name in axes:
            is_slide = joint.shortname().startswith("JointModelP")  # prismatic
            joint_model = pin.JointModelPrismaticUnaligned if is_slide else pin.JointModelRevoluteUnaligned
            joint = joint_model(axes[name])
        if kind == "SPHERICAL":
            joint = pin.JointModelSpherical()
        elif kind in UNIVERSAL:
            # two hinges; the second one carries the body
            first, second = tuple(UNIVERSAL[kind])  # two letters of axes
            parent = model.addJoint(parent, HINGE_MODELS[first](), placement, f"{urdf_joint}_{first}")
            urdf_joints.append(urdf_joint)
            joint, placement, name = HINGE_MODELS[second](), pin.SE3.Identity(), f"{urdf_joint}_{second}"
        elif kind is None and name in planes:
            # two slides in the plane, and a hinge across it that carries the body
            first_axis, second_axis, normal = axes_of_plane(planes[name])
            for letter, axis in (("x", first_axis), ("y", second_axis)):
                slide = pin.JointModelPrismaticUnaligned(axis)
                parent = model.addJoint(parent, slide, placement, f"{urdf_joint}_{letter}")
                urdf_joints.append(urdf_joint)
                placement = pin.SE3.Identity()
            joint, name = pin.JointModelRevoluteUnaligned(normal), f"{urdf_joint}_z"
        number = model.addJoint(parent, joint, placement, name)
        model.appendBodyToJoint(number, parsed.inertias[index], pin.SE3.Identity())
        numbers.append(number)
        urdf_joints.append(urdf_joint)
    model.inertias[0] = parsed.inertias[0]  # inertia of links that are fixed to the root
    for frame in list(parsed.frames)[1:]:
        frame.parentJoint = numbers[frame.parentJoint]
        model.addFrame(frame, False)  # the inertia of the joint already includes the frame
    return model, tuple(urdf_joints)


def link_inertia(model: Any, index: int) -> Any:
    """Return the `pinocchio.Inertia` of the link with frame number `index`, in the frame of the link.

    Pinocchio merges links that fixed joints connect. It adds their inertias to that of the moving joint, and
    also stores the inertia of each of them at the frame of its fixed joint.
    """
    link = model.frames[index]
    joint_frame = model.frames[link.parentFrame]
    if joint_frame.type == pin.FrameType.FIXED_JOINT:
        return joint_frame.inertia
    inertia = model.inertias[link.parentJoint]
    for frame in model.frames:
        is_fixed_joint = frame.type == pin.FrameType.FIXED_JOINT and frame.parentJoint == link.parentJoint
        if is_fixed_joint and frame.inertia.mass > 0.0:
            inertia = inertia - frame.placement.act(frame.inertia)
    return inertia


def mass_matrix(model: Any, data: Any, map: CoordinateMap, q: Array) -> Array:
    """Compute the mass matrix (nv, nv) in tree velocities, with the rotor inertias `model.armature`.

    Args:
        model: `pinocchio.Model`.
        data: `pinocchio.Data`, which is overwritten.
        map: map between tree coordinates and Pinocchio's.
        q: (nq,) Pinocchio's configuration.
    """
    upper = np.array(pin.crba(model, data, q))  # Pinocchio fills the upper triangle only
    mass = np.where(map.is_below_diagonal, upper.T, upper)
    return map.v_from_pinocchio(map.v_from_pinocchio(mass).T)


class CoordinateMap:
    """Map between coordinates of a mechanism's spanning tree and its Pinocchio model.

    The mechanism is welded: ball joints, rods and welds close its loops. At other joints a body was cut into
    two halves, which a weld holds together.

    Tree and model have the same coordinates and signs. Pinocchio has another order, and quaternions
    (x, y, z, w). Angular velocities of balls are in the frame of the child in both.

    Attributes:
        is_below_diagonal: (nv, nv) True below the diagonal of a mass matrix.
    """

    def __init__(self, model: Any, welded: WeldedMechanism) -> None:
        """Find the order of coordinates by the names of joints.

        Args:
            model: `pinocchio.Model` of the welded mechanism.
            welded: welded mechanism, whose spanning tree has the coordinates.
        """
        # index in the tree of each of Pinocchio's coordinates and velocities. The motions of the tree are the
        # hinges, slides and balls of its joints, from parent to child, with the names of Pinocchio's joints
        tree_q = np.zeros(model.nq, dtype=int)
        tree_v = np.zeros(model.nv, dtype=int)
        tree = welded.tree
        for name, (motion, in_q, in_v) in zip(tree.motion_names, tree.motions, strict=True):
            joint = model.joints[model.getJointId(name)]
            columns = np.arange(in_q.start, in_q.stop)
            if motion.kind == "ball":  # (w, x, y, z) to (x, y, z, w)
                columns = np.roll(columns, -1)
            tree_q[joint.idx_q : joint.idx_q + joint.nq] = columns
            tree_v[joint.idx_v : joint.idx_v + joint.nv] = np.arange(in_v.start, in_v.stop)
        # indices of hinges and slides in q and v of the tree
        single = [(in_q.start, in_v.start) for motion, in_q, in_v in tree.motions if motion.kind != "ball"]
        self._single_q, self._single_v = np.array(single, dtype=int).reshape(-1, 2).T
        self._tree_q, self._tree_v = tree_q, tree_v
        self._pinocchio_q, self._pinocchio_v = np.argsort(tree_q), np.argsort(tree_v)
        self.is_below_diagonal = np.tri(model.nv, k=-1, dtype=bool)

    def displacements(self, q: Array) -> Array:
        """Return coordinates of hinges and slides by velocity of the tree (nv,); 0 for balls."""
        x = np.zeros(len(self._tree_v))
        x[self._single_v] = q[self._single_q]
        return x

    def q_to_pinocchio(self, q: Array) -> Array:
        """Convert coordinates (nq,) of the tree to Pinocchio's."""
        return q.take(self._tree_q)

    def q_from_pinocchio(self, q: Array) -> Array:
        """Convert Pinocchio's coordinates (nq,) to the tree's."""
        return q.take(self._pinocchio_q)

    def v_to_pinocchio(self, v: Array) -> Array:
        """Convert velocities, accelerations or generalized forces (nv,) of the tree to Pinocchio's."""
        return v.take(self._tree_v)

    def v_from_pinocchio(self, v: Array) -> Array:
        """Convert Pinocchio's velocities, accelerations or Jacobian columns (..., nv) to the tree's."""
        return v.take(self._pinocchio_v, axis=-1)
