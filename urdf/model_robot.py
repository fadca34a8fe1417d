"""Describe the robot of a Pinocchio model in memory: bodies, joints and loops.

Pinocchio merges bodies that are fixed to each other into one, and keeps a frame and the inertia of each of
them. The description takes them apart again.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from typing import Any

import numpy as np
import pinocchio as pin

from newton_euler.errors import quoted
from newton_euler.reading.robot import (
    FileBody,
    FileJoint,
    FileLoop,
    JointKind,
    LoopKind,
    Placement,
    Robot,
    RobotFile,
)
from newton_euler.scalars import Array
from urdf.errors import IN_MEMORY
from urdf.reading.given import Given, UrdfInMemory
from urdf.reading.source import SourceError, finite_or_infinite

SINGLE_MOTION = re.compile(
    "JointModel(R|RUB|P)[XYZ]|JointModel(Revolute|RevoluteUnbounded|Prismatic)Unaligned"
)
"""Pattern of the names of Pinocchio's joints with one hinge or slide."""

COMPOUND_JOINTS = ("Universal", "Translation", "Planar", "SphericalZYX")
"""Names of Pinocchio's joints with several hinges and slides, which are in the order of the velocities."""

MIN_MASS_RATIO = 1e-14
"""Mass of a body without its parts, relative to the whole, below which the mass is the round-off of 0."""

LOOP_KINDS = {"3d": LoopKind.POINT, "6d": LoopKind.WELD}
"""Kind of a loop by its type, see `urdf.loops`."""


def describe_model(source: UrdfInMemory) -> RobotFile:
    """Describe the robot of a `pinocchio.Model`, alone or in a pair with its constraints.

    Raises:
        SourceError: for other types, unknown joints and unknown constraints.
    """
    model, constraints = source if isinstance(source, tuple) and len(source) == 2 else (source, ())
    if not isinstance(model, pin.Model):
        needed = "a path of a file, a pinocchio.Model or a pair of one and its constraints"
        raise SourceError(quoted(source, 200), f"cannot be described; needed: {needed}")
    description = _Description(model)
    return RobotFile(
        Robot(
            name=str(model.name),
            bodies=tuple(description.bodies),
            loops=tuple(description.loops(source)) if len(constraints) else (),
            gravity=np.array(model.gravity.linear),
        ),
        format=IN_MEMORY,
        notes=tuple(description.notes),
    )


class _Description:
    """Description of the bodies of a Pinocchio model.

    Attributes:
        bodies: bodies; first those that carry joints, in the order of Pinocchio's joints.
        notes: what the model has and the description has not, one sentence each.
    """

    def __init__(self, model: Any) -> None:
        self._model = model
        # Pinocchio's data of each joint at coordinates 0
        self._at_zero = [joint.createData() for joint in model.joints]
        neutral = pin.neutral(model)
        # of the universe, the first one, Pinocchio has no joint to evaluate
        for joint, data in zip(list(model.joints)[1:], self._at_zero[1:], strict=True):
            joint.calc(data, neutral)
        frames = list(model.frames)
        # frame and placement (in the frame of the joint) of the body that each joint moves
        self._names = [str(name) for name in model.names]
        self._placements = [pin.SE3.Identity() for _ in self._names]
        main_frames: dict[int, int] = {}
        for number, frame in enumerate(frames):
            is_main = frame.parentFrame == 0 or frames[frame.parentFrame].type == pin.FrameType.JOINT
            if frame.type == pin.FrameType.BODY and is_main and frame.parentJoint not in main_frames:
                main_frames[frame.parentJoint] = number
                self._names[frame.parentJoint] = str(frame.name)
                self._placements[frame.parentJoint] = frame.placement
        # inertia of each moving body without those of the bodies that are fixed to it
        inertias = list(model.inertias)
        fixed = [
            number
            for number, frame in enumerate(frames)
            if frame.type == pin.FrameType.BODY and number != main_frames.get(frame.parentJoint)
        ]
        own_inertias = {number: frames[frames[number].parentFrame].inertia for number in fixed}
        for number in fixed:
            joint_frame = frames[frames[number].parentFrame]
            part = joint_frame.placement.act(joint_frame.inertia)
            inertias[joint_frame.parentJoint] = _without(inertias[joint_frame.parentJoint], part)
        # bodies by joint; a body on the ground is there only if it has a frame
        self._body_of_joint = {0: -1}
        self.bodies: list[FileBody] = []
        self.notes: list[str] = []
        for joint in range(model.njoints):
            if joint == 0:
                if joint in main_frames:
                    self._body_of_joint[0] = 0
                    self._add(
                        self._names[0], -1, self._placements[0], self._placements[0].actInv(inertias[0]), ()
                    )
                continue
            parent = int(model.parents[joint])
            # a joint of several hinges and slides displaces its frame even if its coordinates are 0
            at_zero = model.jointPlacements[joint] * self._at_zero[joint].M
            placement = self._placements[parent].actInv(at_zero)
            self._body_of_joint[joint] = len(self.bodies)
            self._add(
                self._names[joint],
                self._body_of_joint[parent],
                placement * self._placements[joint],
                self._placements[joint].actInv(inertias[joint]),
                tuple(self._joints(joint)),
            )
        for number in fixed:
            frame = frames[number]
            placement = self._placements[frame.parentJoint].actInv(frame.placement)
            parent = self._body_of_joint[frame.parentJoint]
            self._add(str(frame.name), parent, placement, own_inertias[number], ())

    def _add(
        self, name: str, parent: int, placement: Any, inertia: Any, joints: tuple[FileJoint, ...]
    ) -> None:
        """Add a body; placement and inertia are `pinocchio.SE3` and `pinocchio.Inertia`."""
        if not (np.isfinite(inertia.matrix()).all() and np.isfinite(placement.homogeneous).all()):
            raise SourceError("pinocchio.Model", f"body {name!r} has numbers that are not finite")
        body = FileBody(
            name,
            parent,
            _placement(placement),
            joints,
            mass=float(inertia.mass),
            center=np.array(inertia.lever),
            inertia=np.array(inertia.inertia),
        )
        self.bodies.append(body)

    def _joints(self, number: int) -> Iterator[FileJoint]:
        """Yield the motions of joint `number`, from parent to child."""
        model = self._model
        joint, name = model.joints[number], str(model.names[number])
        kind = joint.shortname().removeprefix("JointModel")
        in_v = int(joint.idx_v)
        if kind in ("Spherical", "FreeFlyer"):
            ball = JointKind.BALL if kind == "Spherical" else JointKind.FREE
            point = self._placements[number].inverse().translation
            self._note_unequal(name, slice(in_v, in_v + int(joint.nv)))
            yield self._motion(name, ball, np.zeros(3), np.array(point), in_v, None)
            return
        parts = joint.extract().joints if kind == "Composite" else [joint]
        for part in parts:
            if not SINGLE_MOTION.fullmatch(part.shortname()) and kind not in COMPOUND_JOINTS:
                raise SourceError(
                    "pinocchio.Model", f"joint {name!r} is a {joint.shortname()}, which is unknown"
                )
        # velocity (6,) of the joint's frame per velocity of each coordinate: linear and angular, in the frame
        for k, column in enumerate(np.reshape(self._at_zero[number].S, (6, joint.nv)).T):
            velocity = self._placements[number].actInv(pin.Motion(column))
            is_hinge = bool(np.any(column[3:]))
            axis = velocity.angular if is_hinge else velocity.linear
            yield self._motion(
                name if joint.nv == 1 else f"{name}_{k + 1}",
                JointKind.HINGE if is_hinge else JointKind.SLIDE,
                np.array(axis),
                np.cross(axis, velocity.linear) if is_hinge else np.zeros(3),
                in_v + k,
                int(joint.idx_q) + k if joint.nq == joint.nv else None,
            )

    def _note_unequal(self, name: str, in_v: slice) -> None:
        """Note numbers of a ball or free joint that are not equal for all of its velocities.

        Args:
            name: name of the joint.
            in_v: its velocities.
        """
        for quantity in ("damping", "armature", "friction"):
            if np.ptp(getattr(self._model, quantity)[in_v]):
                self.notes.append(
                    f"{quantity} of joint {name!r} has several values: only the first is described"
                )

    def _motion(
        self, name: str, kind: JointKind, axis: Array, point: Array, in_v: int, in_q: int | None
    ) -> FileJoint:
        """Describe one motion of a joint.

        Args:
            name: name of the motion.
            kind: kind of the motion.
            axis: (3,) unit vector, in the frame of the body.
            point: (3,) m, in the frame of the body.
            in_v: index of the velocity.
            in_q: index of the coordinate; None if it has no limits.
        """
        model = self._model
        dry = max(model.friction[in_v], -model.lowerDryFrictionLimit[in_v], model.upperDryFrictionLimit[in_v])
        limits = (-math.inf, math.inf)
        if in_q is not None:
            ends = model.lowerPositionLimit[in_q], model.upperPositionLimit[in_q]
            limits = finite_or_infinite(ends[0]), finite_or_infinite(ends[1])
        return FileJoint(
            name,
            kind,
            axis,
            point,
            damping=float(model.damping[in_v]),
            armature=float(model.armature[in_v]),
            friction=float(dry),
            limits=limits,
            effort=(
                finite_or_infinite(model.lowerEffortLimit[in_v]),
                finite_or_infinite(model.upperEffortLimit[in_v]),
            ),
            speed=finite_or_infinite(model.upperVelocityLimit[in_v]),
        )

    def loops(self, source: UrdfInMemory) -> Iterator[FileLoop]:
        """Yield the loops that the constraints of a model close."""
        given = Given(source, None)
        model = given.closed_model.model
        for constraint, kind, pair in zip(
            given.constraints, given.loops.type, given.closed_model.frames, strict=True
        ):
            first, second = (model.frames[number] for number in pair)
            yield FileLoop(
                str(constraint.name),
                LOOP_KINDS[kind],
                first=self._body_of_joint[first.parentJoint],
                second=self._body_of_joint[second.parentJoint],
                first_frame=_placement(self._placements[first.parentJoint].actInv(first.placement)),
                second_frame=_placement(self._placements[second.parentJoint].actInv(second.placement)),
            )


def _without(whole: Any, part: Any) -> Any:
    """Return the `pinocchio.Inertia` of a body without one of its parts, which may have no inertia."""
    difference = whole.matrix() - part.matrix()
    mass = float(difference[0, 0])
    if not np.any(part.matrix()):
        return whole
    remainder = pin.Inertia.Zero()
    # assigned, since the constructor refuses negative moments, which files of models have
    remainder.inertia = difference[3:, 3:]
    if mass > MIN_MASS_RATIO * whole.mass:
        center = pin.unSkew(difference[3:, :3]) / mass
        remainder.mass, remainder.lever = mass, center
        remainder.inertia = difference[3:, 3:] + mass * pin.skewSquare(center, center)
    return remainder


def _placement(placement: Any) -> Placement:
    """Convert a `pinocchio.SE3`."""
    return Placement(np.array(placement.translation), np.array(placement.rotation))
