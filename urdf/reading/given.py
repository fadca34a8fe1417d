"""Check and copy a Pinocchio model in memory, with the constraints that close its loops.

`Given` converts the model to the form that `urdf.reader` has for a URDF and its loop file, the file that
lists loop closures. The import of both continues in the same way.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any, TypeAlias

import numpy as np
import pinocchio as pin

from newton_euler.errors import quoted, real_array
from newton_euler.limits import exceeded
from newton_euler.model.couplings import MAX_DEGREE
from newton_euler.scalars import Array
from urdf.loops import NO_LOOPS, closure_names
from urdf.model import PINOCCHIO_GROUND, ClosedLoopModel
from urdf.reading.source import JointProperties, SourceError, joint_limits

UrdfInMemory: TypeAlias = pin.Model | tuple[pin.Model, Sequence[pin.RigidConstraintModel]]
"""Model in memory, alone or with its constraints."""

KNOWN_JOINT_MODELS = (
    *(f"{kind}{axis}" for kind in ("R", "RUB", "P") for axis in "XYZ"),
    *("RevoluteUnaligned", "RevoluteUnboundedUnaligned", "PrismaticUnaligned", "Universal", "Translation"),
    *("Spherical", "SphericalZYX", "Planar", "FreeFlyer"),
)
"""Names of supported joint models, without the prefix `JointModel`."""

ANCHOR_TYPES = {
    "PointAnchorConstraintModel": pin.ContactType.CONTACT_3D,
    "FrameAnchorConstraintModel": pin.ContactType.CONTACT_6D,
}
"""Contact type of the rigid constraint that an anchor constraint is equivalent to, by class of the anchor."""

CLOSURE_TYPE_OF_CONTACT = {pin.ContactType.CONTACT_3D: "3d", pin.ContactType.CONTACT_6D: "6d"}
"""Type of closure in a loop file, by contact type."""

MAX_ROTATION_ERROR = 1e-9
"""Largest entry of R^T R - 1 of a placement, which allows rounded numbers in rotation matrices R."""


class Given:
    """Checked model in memory.

    Attributes:
        model: model of the user, which is not changed.
        constraints: constraints as `RigidConstraintModel`s.
        gains: Baumgarte's gains kp, 1/s^2, and kd, 1/s, of each constraint.
        source_name: kind and name of the model, for messages.
        name: name of the model.
        closed_model: copy of the model, with a frame at each end of each constraint.
        loops: equivalent content of a loop file.
        q: (nq,) Pinocchio's configuration to start from.
        name_of_q: name of `q` in reports.
        joints: properties of joints.
    """

    def __init__(self, given: object, q: Sequence[float] | Array | None) -> None:
        """Check and copy a model; raises `SourceError` for other types and unsupported models."""
        model, constraints = given if isinstance(given, tuple) and len(given) == 2 else (given, ())
        if not isinstance(model, pin.Model) or not isinstance(constraints, Iterable):
            needed = "a path of a file, a pinocchio.Model or a pair of one and its RigidConstraintModels"
            raise SourceError(quoted(given, 200), f"cannot be read; needed: {needed}")
        self.name = str(model.name)
        self.source_name = f"pinocchio.Model {self.name!r:.100}" if self.name else "pinocchio.Model"
        self.model = model
        # checks, and all constraints as `RigidConstraintModel`s
        self._check(model)
        constraints = list(constraints)
        self.constraints = [self._rigid(each, number) for number, each in enumerate(constraints)]
        self.gains = [_gains(each) for each in constraints]
        if problem := exceeded("closures", len(self.constraints)):
            raise SourceError(self.source_name, problem)
        # a copy of the model with frames at the ends of constraints
        copied, pairs = model.copy(), []
        kinds = tuple(CLOSURE_TYPE_OF_CONTACT[constraint.type] for constraint in self.constraints)
        self.loops = replace(NO_LOOPS, closed_loop=closure_names(model, self.constraints), type=kinds)
        for names, constraint in zip(self.loops.closed_loop, self.constraints, strict=True):
            joints = constraint.joint1_id, constraint.joint2_id
            placements = constraint.joint1_placement, constraint.joint2_placement
            pairs.append(_add_frames(copied, names, joints, placements))
        self.closed_model = ClosedLoopModel(
            copied,
            pin.StdVec_RigidConstraintModel(self.constraints),
            frames=tuple(pairs),
            # only loop files have rods, and couplings: polynomials of joint coordinates, (number, degree, nv)
            rods=(),
            couplings=np.zeros((0, MAX_DEGREE, copied.nv)),
            urdf_joints=(PINOCCHIO_GROUND, *(str(name) for name in list(copied.names)[1:])),
        )
        self.q, self.name_of_q = pin.neutral(model), "coordinates 0"
        if q is not None:
            self.q, self.name_of_q = self._configuration(model, q), "the given q"
        self._place_default_ends()
        self.joints = [self._properties(k) for k in range(1, copied.njoints)]

    def _check(self, model: Any) -> None:
        """Raise `SourceError` for a model that is too large, or has unknown joints or infinite numbers."""
        for name, count in (("bodies", model.njoints), ("velocities", model.nv)):
            if problem := exceeded(name, count):
                raise SourceError(self.source_name, problem)
        if model.nv == 0:
            raise SourceError(self.source_name, "no joint can move")
        for name, joint in list(zip(model.names, model.joints, strict=True))[1:]:
            kind = joint.shortname().removeprefix("JointModel")
            if kind not in KNOWN_JOINT_MODELS:
                problem = f"joint {name!r} is a {joint.shortname()}"
                raise SourceError(
                    self.source_name, f"{problem}; needed: one of {', '.join(KNOWN_JOINT_MODELS)}"
                )
        numbers = [model.gravity.linear, model.armature, model.damping]
        for inertia, pose in zip(model.inertias, model.jointPlacements, strict=True):
            numbers += [[inertia.mass], inertia.lever, inertia.inertia.ravel(), pose.homogeneous.ravel()]
        if not all(np.all(np.isfinite(each)) for each in numbers):
            raise SourceError(
                self.source_name,
                "it has numbers that are not finite; needed: finite gravity, inertias and placements",
            )

    def _rigid(self, given: Any, number: int) -> Any:
        """Check constraint number `number` of the user; return an equivalent `RigidConstraintModel`."""
        kind = type(given).__name__
        is_rigid = isinstance(given, pin.RigidConstraintModel)
        if not (is_rigid and given.type in CLOSURE_TYPE_OF_CONTACT) and kind not in ANCHOR_TYPES:
            anchors = ", ".join(ANCHOR_TYPES)
            needed = f"a RigidConstraintModel of type CONTACT_3D or CONTACT_6D, or one of {anchors}"
            raise SourceError(self.source_name, f"constraint {number} is a {kind}; needed: {needed}")
        placements = given.joint1_placement, given.joint2_placement
        for placement in placements:
            excess = np.abs(placement.rotation.T @ placement.rotation - np.eye(3))
            if not np.max(excess) <= MAX_ROTATION_ERROR or not np.all(np.isfinite(placement.translation)):
                problem = f"constraint {number} has a placement that is no rotation and finite translation"
                raise SourceError(self.source_name, problem)
        if is_rigid:
            offset = given.desired_contact_placement.homogeneous - np.eye(4)
        else:
            offset = given.desired_constraint_offset
        if np.any(offset):
            raise SourceError(self.source_name, f"constraint {number} has a desired offset; needed: none")
        rigid = pin.RigidConstraintModel(
            given.type if is_rigid else ANCHOR_TYPES[kind],
            self.model,
            int(given.joint1_id),
            given.joint1_placement,
            int(given.joint2_id),
            given.joint2_placement,
            pin.ReferenceFrame.LOCAL,
        )
        rigid.name = given.name
        return rigid

    def _configuration(self, model: Any, q: Sequence[float] | Array) -> Array:
        """Return the user's configuration (nq,) with quaternions of norm 1; raises `SourceError`."""
        try:
            configuration = real_array(q)
        except (TypeError, ValueError, OverflowError) as error:
            raise SourceError(self.source_name, f"q is {quoted(q)}; needed: {model.nq} numbers") from error
        if configuration.shape != (model.nq,) or not np.all(np.isfinite(configuration)):
            problem = f"q has shape {configuration.shape}, or numbers that are not finite"
            raise SourceError(self.source_name, f"{problem}; needed: {model.nq} finite numbers")
        return np.asarray(pin.normalize(model, configuration))

    def _place_default_ends(self) -> None:
        """Move the second end of each constraint to the world with default placement to the first end.

        Such a constraint holds a frame of the model where the frame is at the start.
        """
        model = self.closed_model.model
        data = model.createData()
        pin.framesForwardKinematics(model, data, self.q)
        for constraint, (first, second) in zip(self.constraints, self.closed_model.frames, strict=True):
            if constraint.joint2_id == 0 and constraint.joint2_placement.isIdentity(0.0):
                model.frames[second].placement = data.oMf[first]

    def _properties(self, number: int) -> JointProperties:
        """Return the properties of joint `number`; the largest values if the joint has several velocities."""
        model = self.closed_model.model
        joint, name = model.joints[number], str(model.names[number])
        in_v = slice(joint.idx_v, joint.idx_v + joint.nv)
        damping, friction, armature = (
            max((float(x) for x in values[in_v]), key=abs, default=0.0)
            for values in (model.damping, model.friction, model.armature)
        )
        dry_limits = (model.lowerDryFrictionLimit[in_v], model.upperDryFrictionLimit[in_v])
        friction = max([friction, *(float(x) for x in np.ravel(np.abs(dry_limits)))], key=abs)
        # rotor inertia reflected to the joint, for a warning: Pinocchio's dynamics use the armature instead
        reflected = model.rotorInertia[in_v] * model.rotorGearRatio[in_v] ** 2
        rotor = float(np.max(reflected, initial=0.0)) if not armature else 0.0
        limits = None
        if joint.nq == joint.nv == 1:
            low, high = (
                float(values[joint.idx_q]) for values in (model.lowerPositionLimit, model.upperPositionLimit)
            )
            speed = float(model.upperVelocityLimit[joint.idx_v])
            limits = joint_limits(low, high, speed)
        # prismatic; only limits have the unit, and JointModelPlanar has none
        is_slide = joint.shortname().startswith("JointModelP")
        unit = "m" if is_slide else "rad"
        return JointProperties(name, damping, friction, armature, limits, unit, rotor=rotor)


def _gains(constraint: Any) -> tuple[float, float]:
    """Return Baumgarte's gains kp, 1/s^2, and kd, 1/s, of a rigid constraint or an anchor."""
    is_rigid = isinstance(constraint, pin.RigidConstraintModel)
    gains = constraint.m_baumgarte_parameters if is_rigid else constraint.baumgarte_corrector_parameters
    return float(gains.Kp), float(gains.Kd)


def _add_frames(
    model: Any, names: Sequence[str], joints: Sequence[int], placements: Sequence[Any]
) -> tuple[int, int]:
    """Add two frames with given names, joints and placements to a model, and return their numbers."""
    first, second = (
        int(model.addFrame(pin.Frame(name, int(joint), placement, pin.FrameType.OP_FRAME), False))
        for name, joint, placement in zip(names, joints, placements, strict=True)
    )
    return first, second
