"""Describe a scene at another initial pose.

A scene gives all points and axes in the world frame at the mechanism's initial pose, where all joint
coordinates are zero. `described_at` returns an equivalent scene whose initial pose is another closed pose of
the mechanism: points and axes move with their bodies, and targets, motions and rest values of joint
coordinates are counted from the new zeros. `newton_euler.runs.variation` uses it for dimensions that change
the pose.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np

from newton_euler.errors import MechanismError
from newton_euler.model.compound_joint import Compound
from newton_euler.model.constraints import Frame
from newton_euler.model.control import ComputedTorque, StateFeedback
from newton_euler.model.digital_control import Controller, Digital, Law, Sampled
from newton_euler.model.elements import Move, PoseChange
from newton_euler.model.euler_parameters import from_rotation, product
from newton_euler.model.hinge_angles import HingeAngle
from newton_euler.model.joint import Joint, JointEquations, Key
from newton_euler.model.mechanism import Mechanism
from newton_euler.model.motions import TimeFunction, shifted
from newton_euler.model.parallel_hinges import ParallelHinges
from newton_euler.model.scene import Scene
from newton_euler.model.state import State
from newton_euler.scalars import Array, Floats, cross

POSE_DEPENDENT = ("rest", "force", "torque")
"""Attributes of forces whose values are counted from the initial pose, or are vector components at the
initial pose. The names of their parameters, such as `hinge.spring.rest`, end with these words."""

ROTATION_TOLERANCE = 1e-12
"""Largest element of (rotation matrix - identity) for which a body counts as not rotated: round-off."""


@dataclass(frozen=True)
class ShiftedController:
    """Sampled controller of a scene after the change of its initial pose.

    The user's controller still receives joint coordinates that are counted from the old initial pose.

    Attributes:
        controller: the user's controller.
        zeros: coordinates that the controller reads at the new initial pose, m or rad, counted from the old
            pose.
    """

    controller: Controller
    zeros: tuple[float, ...]

    def __call__(self, time: float, x: Floats, x_rate: Floats) -> float:
        return self.controller(time, x + np.array(self.zeros), x_rate)


def described_at(scene: Scene, state: State) -> Scene:
    """Return an equivalent scene whose initial pose is that of a state, and which starts there at rest.

    The joints of the given scene may be unchecked variations (`newton_euler.model.joint.Joint.varied`) that
    are open at its own initial pose. The constructor checks the joints of the returned scene.

    Args:
        scene: the scene.
        state: poses of all bodies in which joint constraints and couplings are satisfied.

    Raises:
        MechanismError: for what cannot be described at the new pose: an encoder resolution, parameters of a
            controller's model that depend on the initial pose, and forces along slides of planar or free
            joints whose first body has rotated.
    """
    # Compute the displacements of the bodies, and the joint coordinates at the new pose
    mechanism, frames = scene.mechanism, state.frames()
    moves = [
        Move(
            turn=frame.rotation @ body.pose.rotation.T,
            start=body.center_of_mass,
            end=frame.position,
        )
        for body, frame in zip(mechanism.bodies, frames, strict=True)
    ]
    zeros = coordinates_at(mechanism, state)
    change = PoseChange(mechanism, moves, zeros)
    for equations in mechanism.equations:
        _check_slides(scene, equations, moves[equations.first])

    # The mechanism at the new pose; body 0 is the ground, which stays where it is
    bodies = [mechanism.bodies[0]]
    for body, move, p in list(zip(mechanism.bodies, moves, state.quaternion, strict=True))[1:]:
        shapes = tuple(_moved(shape, move) for shape in body.shapes)
        meshes = tuple(_moved(mesh, move) for mesh in body.meshes)
        moved = replace(body, center_of_mass=move.end, quaternion=p, shapes=shapes, meshes=meshes)
        bodies.append(moved)
    joints = [_moved_joint(equations, moves, frames) for equations in mechanism.equations]
    couplings = [coupling.counted_from(zeros) for coupling in mechanism.couplings]
    moved_mechanism = Mechanism(bodies, joints, couplings)

    # Control laws, forces and motions counted from the new pose
    motions = [replace(m, function=shifted(m.function, -zeros[m.key])) for m in scene.motions]
    return replace(
        scene,
        mechanism=moved_mechanism,
        control=tuple(_shifted_law(scene, law, zeros) for law in scene.control),
        forces=tuple(force.described_after(change) for force in scene.forces),
        motions=tuple(motions),
        initial_state=None,
    )


def coordinates_at(mechanism: Mechanism, state: State) -> dict[Key, float]:
    """Measure all joint coordinates in a state, m or rad; angles include the full revolutions of
    `State.angles`."""
    coordinates, frames = {}, state.frames()
    for key in mechanism.coordinate_labels:
        x = float(mechanism.measure(key, frames)[0])
        coordinates[key] = x + float(state.revolutions(key, x))  # plus a multiple of 2 pi
    return coordinates


def _check_slides(scene: Scene, equations: JointEquations, first: Move) -> None:
    """Raise `MechanismError` if something acts on a planar or free joint whose first body has rotated.

    The slide directions of these joints follow from the world axes at the initial pose, so that they cannot
    rotate.

    Args:
        scene: the scene at the old initial pose.
        equations: the joint.
        first: displacement of the joint's first body.
    """
    joint = equations.joint
    if joint.kind not in ("planar", "free") or np.all(np.abs(first.turn - np.eye(3)) < ROTATION_TOLERANCE):
        return
    coupled = [key for coupling in scene.mechanism.couplings for key in coupling.factors()]
    moved = [each.key for each in (*scene.motions, *scene.armatures)]
    if joint.name in {name for name, _ in (*coupled, *scene.sensed, *scene.loaded_coordinates, *moved)}:
        where = f"joint {joint.name!r}"
        raise MechanismError(where, "has slides that turn with its first body", "nothing that acts on them")


def _moved(shape: Any, move: Move) -> Any:
    """Return a shape or a mesh after the displacement of its body."""
    fields = {}
    for name in ("center", "start", "end", "vertices"):
        if hasattr(shape, name):
            fields[name] = move.point(getattr(shape, name))
    if hasattr(shape, "quaternion"):
        fields["quaternion"] = product(from_rotation(move.turn), shape.quaternion)
    return replace(shape, **fields)


def _moved_joint(equations: JointEquations, moves: list[Move], frames: list[Frame]) -> Joint:
    """Return a joint described at the new initial pose.

    Args:
        equations: the joint at the old initial pose.
        moves: displacements of all bodies.
        frames: frames of all bodies at the new pose.
    """
    joint, first, second = equations.joint, moves[equations.first], moves[equations.second]
    fields: dict[str, Any] = {
        "point": first.point(joint.point),
        "point_on_second": second.point(joint.point_on_second),
    }
    for name in joint.axis_names:
        fields[name] = (second if name == "axis_on_second" else first).vector(getattr(joint, name))
    if isinstance(joint, ParallelHinges):
        fields["offset"] = joint.offset_between(fields["axis"], fields["point"], fields["point_on_second"])
    if isinstance(joint, Compound):
        fields["slides"] = first.vector(joint.slides)
        fields["hinges"] = axes = first.vector(joint.hinges)
        # Two or three hinges have a row of axes, which follow from the frames of both bodies
        for coordinate in equations.coordinates:
            if isinstance(coordinate, HingeAngle):
                fields["hinges"] = axes = np.array(
                    coordinate.row.axes(frames[equations.first], frames[equations.second])
                )
        # Offsets are constant in the links between the hinges, whose frames follow from the axes
        old_frames, new_frames = _link_frames(joint.hinges), _link_frames(axes)
        links = zip(old_frames, new_frames, joint.offsets, strict=True)
        fields["offsets"] = [new @ np.linalg.solve(old, offset) for old, new, offset in links]
    return replace(joint, **fields)


def _link_frames(axes: Array) -> list[Array]:
    """Return the matrix (3, 3) of the columns a, b and a x b for each two neighboring hinge axes a and b."""
    return [np.column_stack([a, b, cross(a, b)]) for a, b in pairwise(axes)]


def _shifted_law(scene: Scene, law: Law, zeros: dict[Key, float]) -> Law:
    """Return a control law whose joint coordinates are counted from the new initial pose.

    Args:
        scene: the scene at the old initial pose.
        law: one of its control laws.
        zeros: joint coordinates at the new initial pose, m or rad, counted from the old pose.
    """
    if isinstance(law, Sampled):
        read_zeros = tuple(zeros[key] for key in scene.sensed)
        return replace(law, controller=ShiftedController(law.controller, read_zeros))
    if isinstance(law, Digital):
        if law.resolution > 0.0 and zeros[law.key] != 0.0:
            raise MechanismError(law.element, "has an encoder with marks", "a resolution of 0")
        low, high = law.stroke  # limits of the set-point, counted from the old pose
        stroke = low - zeros[law.key], high - zeros[law.key]
        return replace(law, law=_shifted_declared_law(law.law, zeros), stroke=stroke)
    return _shifted_declared_law(law, zeros)


def _shifted_declared_law(law: Any, zeros: dict[Key, float]) -> Any:
    """Return a declared law, such as PD, whose targets are counted from the new initial pose, see
    `_shifted_law`."""
    fields: dict[str, Any] = {"target": _shifted_target(law.target, zeros[law.key])}
    if isinstance(law, StateFeedback):
        others = {key: law.targets.get(key, 0.0) for key in law.reads if key != law.key}
        fields["targets"] = {key: _shifted_target(target, zeros[key]) for key, target in others.items()}
    if isinstance(law, ComputedTorque):  # `model`: parameters that its inverse dynamics knows differently
        for name in law.model:
            if name.endswith(POSE_DEPENDENT):
                needed = "a model without values that are counted from the initial pose"
                raise MechanismError(law.element, f"knows {name!r}", needed)
    return replace(law, **fields)


def _shifted_target(target: float | TimeFunction, zero: float) -> float | TimeFunction:
    """Return a target, m or rad, minus the coordinate `zero`, m or rad, of the new initial pose."""
    return target - zero if isinstance(target, float) else shifted(target, -zero)
