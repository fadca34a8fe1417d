"""A scene as a `MultibodyPlant` of Drake.

Loops are closed by a ball, a rod (two points at a fixed distance) or a weld. At any other joint that closes a
loop, a body is cut into two halves, which a weld holds together (`newton_euler.model.spanning_tree`). Each
body of this welded mechanism is a `RigidBody`, whose frame has its origin at the center of mass and is
parallel to the world at the initial pose. Each hinge, slide and ball of a joint in the tree is a joint of
Drake; several motions of one joint are connected by massless bodies. Rotors on hinges and slides are
`JointActuator`s, whose inertia Drake adds to the mass matrix. Springs on joint coordinates, and springs with
a rest length between points, are force elements of Drake.

Facts about Drake 1.51 on which this module depends:

- A massless body between two joints is accepted; a massless body at the end of a chain is not.
- `BallRpyJoint` has angles (roll, pitch, yaw) as coordinates, and the angular velocity in the frame of the
  parent as velocity. Mass matrix and bias are therefore regular at any orientation; the rates of the angles
  are not at a pitch of 90 degrees.
- `SpatialInertia` refuses inertias that break A + B >= C, unless `skip_validity_check` is set.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from pydrake.math import RigidTransform
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import (
    BallRpyJoint,
    FixedOffsetFrame,
    LinearSpringDamper,
    PrismaticJoint,
    PrismaticSpring,
    RevoluteJoint,
    RevoluteSpring,
    SpatialInertia,
    UnitInertia,
    WeldJoint,
)

from newton_euler.model.forces import JointSpring, PointSpring
from newton_euler.model.joint_kinds import Rod
from newton_euler.model.mechanism import Body
from newton_euler.model.scene import Scene
from newton_euler.model.spanning_tree import TreeJoint, WeldedMechanism
from newton_euler.scalars import Array

NAME = "drake"
"""Name of the engine."""


class Anchors(NamedTuple):
    """Frames of the plant that a joint which closes a loop holds together.

    Attributes:
        joint: number of the joint in the welded mechanism.
        kind: "ball", "weld" or "rod".
        first, second: frames at the joint points of both bodies.
        length: m, of a rod; else 0.
    """

    joint: int
    kind: str
    first: Any
    second: Any
    length: float


class Plant(NamedTuple):
    """A plant before it is finalized.

    Attributes:
        plant: the `MultibodyPlant`.
        welded: the welded mechanism that it models.
        bodies: `RigidBody` of each body of the welded mechanism, the world first.
        motions: Drake's joint of each elementary motion, in the order of `SpanningTree.motions`.
        last: for each joint of the tree, Drake's joint that carries the child.
        anchors: frames of the joints that close loops, in the order of `SpanningTree.cuts`.
        springs: springs of the scene that are force elements of the plant.
    """

    plant: Any
    welded: WeldedMechanism
    bodies: list[Any]
    motions: list[Any]
    last: list[Any]
    anchors: list[Anchors]
    springs: list[object]


def build(
    scene: Scene, welded: WeldedMechanism, step: float = 0.0, shifts: Mapping[str, Array] | None = None
) -> Plant:
    """Build a plant, without constraints for its loops.

    Args:
        scene: the scene.
        welded: its welded mechanism.
        step: s, of Drake's discrete solver; 0 for a continuous plant.
        shifts: vectors (3,), m, world frame at the initial pose, by which the anchors of closing joints on
            their second bodies are moved, by joint name.
    """
    plant = MultibodyPlant(step)
    plant.mutable_gravity_field().set_gravity_vector(scene.gravity)
    bodies = [plant.world_body()]
    for body, rotation in zip(welded.mechanism.bodies[1:], welded.tree.initial_rotations[1:], strict=True):
        bodies.append(plant.AddRigidBody(body.name, _inertia(body, rotation)))
    motions: list[Any] = []
    last = [_add_joint(plant, welded, tree_joint, bodies, motions) for tree_joint in welded.tree.joints]
    anchors = [_anchors(plant, welded, cut, bodies, shifts or {}) for cut in welded.tree.cuts]
    built = Plant(plant, welded, bodies, motions, last, anchors, [])
    _add_rotors(scene, built)
    _add_springs(scene, built)
    return built


def _inertia(body: Body, rotation: Array) -> Any:
    """Return the inertia of a body about its center of mass, in axes of the world at the initial pose."""
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = rotation @ body.inertia @ rotation.T / body.mass
    unit = UnitInertia(xx, yy, zz, xy, xz, yz)
    return SpatialInertia(body.mass, np.zeros(3), unit, skip_validity_check=True)


def _origin(welded: WeldedMechanism, body: int) -> Array:
    """Return the origin (3,) of the frame of a body of the plant at the initial pose, m."""
    return welded.mechanism.bodies[body].center_of_mass if body else np.zeros(3)


def _frame(plant: Any, name: str, body: Any, offset: Array) -> Any:
    """Add a frame at an offset (3,), m, from the origin of a body, parallel to the frame of the body."""
    return plant.AddFrame(FixedOffsetFrame(name, body.body_frame(), RigidTransform(offset)))


def _add_joint(
    plant: Any, welded: WeldedMechanism, tree_joint: TreeJoint, bodies: list[Any], motions: list[Any]
) -> Any:
    """Add Drake's joints of a joint of the tree, and return the last one.

    `motions` is extended by the joints of the elementary motions.
    """
    joint = welded.tree.joint(tree_joint.joint)
    parent, origin = bodies[tree_joint.parent], _origin(welded, tree_joint.parent)
    child, child_origin = bodies[tree_joint.child], _origin(welded, tree_joint.child)
    if not tree_joint.motions:
        frame = _frame(plant, f"{joint.name} on parent", parent, child_origin - origin)
        return plant.AddJoint(WeldJoint(joint.name, frame, child.body_frame(), RigidTransform()))
    for k, (motion, point) in enumerate(zip(tree_joint.motions, tree_joint.points, strict=True), start=1):
        is_last = k == len(tree_joint.motions)
        # the number makes the name unique: joints `a` with two motions, and `a_1`, may be side by side
        name = f"{joint.name} ({len(motions)})"
        # a massless body between two motions has its origin at the point of the first of them
        body = child if is_last else plant.AddRigidBody(f"after {name}", SpatialInertia.Zero())
        body_origin = child_origin if is_last else point
        on_parent = _frame(plant, f"{name} on parent", parent, point - origin)
        on_child = _frame(plant, f"{name} on child", body, point - body_origin)
        match motion.kind:
            case "hinge":
                added: Any = RevoluteJoint(name, on_parent, on_child, motion.axis)
            case "slide":
                added = PrismaticJoint(name, on_parent, on_child, motion.axis)
            case "ball":
                added = BallRpyJoint(name, on_parent, on_child)
        motions.append(plant.AddJoint(added))
        parent, origin = body, body_origin
    return motions[-1]


def _anchors(
    plant: Any, welded: WeldedMechanism, cut: int, bodies: list[Any], shifts: Mapping[str, Array]
) -> Anchors:
    """Add the frames of a joint that closes a loop."""
    joint, equations = welded.mechanism.joints[cut], welded.mechanism.equations[cut]
    kind = "rod" if isinstance(joint, Rod) else "ball" if joint.motions else "weld"
    points = joint.point, joint.point_on_second + shifts.get(joint.name, np.zeros(3))
    first, second = (
        _frame(plant, f"{joint.name} on {side}", bodies[body], point - _origin(welded, body))
        for side, body, point in zip(
            ("first", "second"), (equations.first, equations.second), points, strict=True
        )
    )
    return Anchors(cut, kind, first, second, joint.length if isinstance(joint, Rod) else 0.0)


def motion_of(built: Plant, joint: str, coordinate: int) -> Any:
    """Return Drake's joint of a joint coordinate."""
    place = built.welded.tree.place(joint, coordinate)
    assert place is not None  # joints with forces are in the tree
    starts = [on_v.start for _, _, on_v in built.welded.tree.motions]
    return built.motions[starts.index(place[1])]


def _add_rotors(scene: Scene, built: Plant) -> None:
    """Add the rotors on hinges and slides; rotors on balls are added to Drake's equations."""
    inertias = Counter[tuple[str, int]]()
    for armature in scene.armatures:
        if not armature.on_ball:
            inertias[armature.key] += armature.inertia  # type: ignore[assignment]
    for key, inertia in inertias.items():
        joint = motion_of(built, *key)
        actuator = built.plant.AddJointActuator(f"rotor of {joint.name()}", joint)
        actuator.set_default_rotor_inertia(inertia)
        actuator.set_default_gear_ratio(1.0)


def _add_springs(scene: Scene, built: Plant) -> None:
    """Add the springs of a scene that Drake has, and list them in `built.springs`."""
    plant, bodies = built.plant, built.bodies
    for force in scene.forces:
        match force:
            case JointSpring():
                joint = motion_of(built, *force.key)
                kind = RevoluteSpring if isinstance(joint, RevoluteJoint) else PrismaticSpring
                plant.AddForceElement(kind(joint, force.rest, force.stiffness))
                joint.set_default_damping(joint.default_damping() + force.damping)
            case PointSpring() if force.rest_length > 0.0:  # Drake refuses a rest length of zero
                ends = [scene.mechanism.body_index(name) for name in (force.first, force.second)]
                first, second = (
                    point - _origin(built.welded, body)
                    for body, point in zip(ends, (force.point_on_first, force.point_on_second), strict=True)
                )
                plant.AddForceElement(
                    LinearSpringDamper(
                        *(bodies[ends[0]], first, bodies[ends[1]], second),
                        *(force.rest_length, force.stiffness, force.damping),
                    )
                )
            case _:
                continue
        built.springs.append(force)
