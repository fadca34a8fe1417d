"""Description of a scene at another initial pose.

Descriptions have everything in the world at the initial pose, where joint coordinates are zero. At another
one points and axes are elsewhere, and what is counted from zero is less by what the coordinates are there.
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

COUNTED = ("rest", "force", "torque")
"""Attributes of forces that are counted from the initial pose, or are components there."""

TURNED = 1e-12  # elements of a rotation below which a body has not turned


@dataclass(frozen=True)
class FromZero:
    """A sampled controller that reads coordinates as they were counted before.

    Attributes:
        controller: what it was.
        zeros: of the coordinates that it reads, m or rad, where they are zero now.
    """

    controller: Controller
    zeros: tuple[float, ...]

    def __call__(self, time: float, x: Floats, x_rate: Floats) -> float:
        return self.controller(time, x + np.array(self.zeros), x_rate)


def described_at(scene: Scene, state: State) -> Scene:
    """Return the scene described at the poses of a state, from where it starts at rest.

    Joints may have numbers that nobody has checked (`newton_euler.model.joint.Joint.varied`) and be open at
    the scene's own initial pose; those of the new one are checked.

    Args:
        scene: what is described.
        state: poses of all bodies in which the joints are closed and coordinates meet their couplings.

    Raises:
        MechanismError: for what cannot be said there: marks of an encoder, values of a controller's model
            that are counted from the initial pose, and what acts along slides that turn with the first body.
    """
    mechanism, frames = scene.mechanism, state.frames()
    moves = [
        Move(frame.rotation @ body.pose.rotation.T, body.center_of_mass, frame.position)
        for body, frame in zip(mechanism.bodies, frames, strict=True)
    ]
    zeros = coordinates_at(mechanism, state)
    change = PoseChange(mechanism, moves, zeros)
    for equations in mechanism.equations:
        _check_slides(scene, equations, moves[equations.first])
    bodies = [mechanism.bodies[0]]
    for body, move, p in list(zip(mechanism.bodies, moves, state.quaternion, strict=True))[1:]:
        shapes = tuple(_moved(shape, move) for shape in body.shapes)
        meshes = tuple(_moved(mesh, move) for mesh in body.meshes)
        moved = replace(body, center_of_mass=move.end, quaternion=p, shapes=shapes, meshes=meshes)
        bodies.append(moved)
    joints = [_joint(equations, moves, frames) for equations in mechanism.equations]
    made = Mechanism(bodies, joints, [coupling.counted_from(zeros) for coupling in mechanism.couplings])
    motions = [replace(m, function=shifted(m.function, -zeros[m.key])) for m in scene.motions]
    return replace(
        scene,
        mechanism=made,
        control=tuple(_law(scene, law, zeros) for law in scene.control),
        forces=tuple(force.described_after(change) for force in scene.forces),
        motions=tuple(motions),
        initial_state=None,
    )


def coordinates_at(mechanism: Mechanism, state: State) -> dict[Key, float]:
    """Measure all joint coordinates in a state, m or rad, with the revolutions of `State.angles`."""
    found, frames = {}, state.frames()
    for key in mechanism.coordinate_labels:
        x = float(mechanism.measure(key, frames)[0])
        found[key] = x + float(state.revolutions(key, x))
    return found


def _check_slides(scene: Scene, equations: JointEquations, first: Move) -> None:
    """Raise `MechanismError` for slides of planes and free bodies that turn, if something acts along them."""
    joint = equations.joint
    if joint.kind not in ("planar", "free") or np.all(np.abs(first.turn - np.eye(3)) < TURNED):
        return
    coupled = [key for coupling in scene.mechanism.couplings for key in coupling.factors()]
    elements = (*scene.joint_forces, *scene.motions, *scene.armatures)
    if joint.name in {name for name, _ in (*coupled, *scene.sensed, *(each.key for each in elements))}:
        where = f"joint {joint.name!r}"
        raise MechanismError(where, "has slides that turn with its first body", "nothing that acts on them")


def _moved(shape: Any, move: Move) -> Any:
    """Return a shape or a mesh where its body comes to."""
    fields = {}
    for name in ("center", "start", "end", "vertices"):
        if hasattr(shape, name):
            fields[name] = move.point(getattr(shape, name))
    if hasattr(shape, "quaternion"):
        fields["quaternion"] = product(from_rotation(move.turn), shape.quaternion)
    return replace(shape, **fields)


def _joint(equations: JointEquations, moves: list[Move], frames: list[Frame]) -> Joint:
    """Return a joint where its bodies come to."""
    joint, first, second = equations.joint, moves[equations.first], moves[equations.second]
    fields: dict[str, Any] = {
        "point": first.point(joint.point),
        "point_on_second": second.point(joint.reaction_point),
    }
    for name in joint.axis_names:
        fields[name] = (second if name == "axis_on_second" else first).vector(getattr(joint, name))
    if isinstance(joint, ParallelHinges):
        fields["offset"] = joint.offset_between(fields["axis"], fields["point"], fields["point_on_second"])
    if isinstance(joint, Compound):
        fields["slides"] = first.vector(joint.slides)
        fields["hinges"] = axes = first.vector(joint.hinges)
        for coordinate in equations.coordinates:
            if isinstance(coordinate, HingeAngle):
                fields["hinges"] = axes = np.array(
                    coordinate.row.axes(frames[equations.first], frames[equations.second])
                )
        before, after = _links(joint.hinges), _links(axes)
        shares = zip(before, after, joint.offsets, strict=True)
        fields["offsets"] = [new @ np.linalg.solve(old, offset) for old, new, offset in shares]
    return replace(joint, **fields)


def _links(axes: Array) -> list[Array]:
    """Return a frame (3, 3) in each link between two hinges of a row."""
    return [np.column_stack([a, b, cross(a, b)]) for a, b in pairwise(axes)]


def _law(scene: Scene, law: Law, zeros: dict[Key, float]) -> Law:
    """Return a control law whose coordinates are counted from other zeros."""
    if isinstance(law, Sampled):
        return replace(law, controller=FromZero(law.controller, tuple(zeros[key] for key in scene.sensed)))
    if isinstance(law, Digital):
        if law.resolution > 0.0 and zeros[law.key] != 0.0:
            raise MechanismError(law.element, "has an encoder with marks", "a resolution of 0")
        low, high = law.stroke
        stroke = low - zeros[law.key], high - zeros[law.key]
        return replace(law, law=_declared(law.law, zeros), stroke=stroke)
    return _declared(law, zeros)


def _declared(law: Any, zeros: dict[Key, float]) -> Any:
    """Return a declared law whose coordinates are counted from other zeros."""
    fields: dict[str, Any] = {"target": _less(law.target, zeros[law.key])}
    if isinstance(law, StateFeedback):
        others = {key: law.targets.get(key, 0.0) for key in law.reads if key != law.key}
        fields["targets"] = {key: _less(target, zeros[key]) for key, target in others.items()}
    counted = isinstance(law, ComputedTorque) and [name for name in law.model if name.endswith(COUNTED)]
    if counted:
        needed = "a model without values that are counted from the initial pose"
        raise MechanismError(law.element, f"knows {counted[0]!r}", needed)
    return replace(law, **fields)


def _less(target: float | TimeFunction, zero: float) -> float | TimeFunction:
    return target - zero if isinstance(target, float) else shifted(target, -zero)
