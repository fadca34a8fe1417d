"""Describe the robot of a scene in the terms of model files: bodies, joints, loops, couplings and drives.

A scene is a mechanism with its forces, control laws and start. Its spanning tree gives each body a parent;
joints outside of the tree close loops. If a loop closes at a joint for which descriptions have no word, such
as a universal joint, a body is cut in two halves instead, which a weld holds together. Body frames are at the
centers of mass. The pose of the file is the initial pose, where all joint coordinates are zero.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from newton_euler.model.armatures import Armature, BallArmature
from newton_euler.model.control import PD
from newton_euler.model.elements import OnJoint
from newton_euler.model.euler_parameters import rotation
from newton_euler.model.forces import BallSpring, JointSpring, PointSpring
from newton_euler.model.joint import Joint, perpendicular_pair
from newton_euler.model.joint_kinds import (
    Fixed,
    Free,
    Prismatic,
    Revolute,
    Rod,
    Screw,
    Spherical,
    Translational,
)
from newton_euler.model.mechanism import Body
from newton_euler.model.scene import Scene
from newton_euler.model.spanning_tree import (
    SpanningTree,
    TreeJoint,
    coordinate_name,
    motion_names,
    weld_loops,
)
from newton_euler.model.switched_forces import JointFriction, JointStop, acting_stops
from newton_euler.reading.robot import (
    IN_PLACE,
    PRESCRIBED_MOTION,
    FileBody,
    FileCoupling,
    FileDrive,
    FileJoint,
    FileLoop,
    FileSpring,
    JointKind,
    LoopKind,
    Placement,
    Robot,
    RobotFile,
    Setting,
)

LOOP_KINDS: dict[type[Joint], LoopKind] = {
    Spherical: LoopKind.POINT,
    Fixed: LoopKind.WELD,
    Revolute: LoopKind.HINGE,
    Translational: LoopKind.SLIDE,
    Prismatic: LoopKind.SLIDE,
    Rod: LoopKind.ROD,
}
"""Kind of a loop by the class of the joint that closes it."""


def describe(scene: Scene) -> RobotFile:
    """Describe the robot of a scene, which has no text and so no uncertainty.

    Examples:
        >>> robot = describe(load("four_bar")).robot
        >>> [body.name for body in robot.bodies], robot.loops[0].kind.value
        (['bar_0', 'bar_1', 'bar_2', 'coupler_0', 'coupler_1'], 'point')
    """
    description = _Description(scene)
    return RobotFile(description.robot, format="scene file", notes=tuple(description.notes))


class _Description:
    """Description of the robot of a scene.

    Attributes:
        robot: the robot.
        notes: what the scene has and the robot has not, one sentence each.
    """

    def __init__(self, scene: Scene) -> None:
        self._scene, self._mechanism = scene, scene.mechanism
        self.notes: list[str] = []
        self._tree = SpanningTree(scene.mechanism, loaded=scene.loaded_balls)
        cuts = [scene.mechanism.joints[index] for index in self._tree.cuts]
        if any(type(joint) not in LOOP_KINDS or joint.name in self._loaded_joints for joint in cuts):
            welded = weld_loops(scene.mechanism, loaded=scene.loaded_balls)
            self._mechanism, self._tree = welded.mechanism, welded.tree
        # index in the description by index in the mechanism, whose first body is the ground
        self._numbers = {0: -1} | {joint.child: k for k, joint in enumerate(self._tree.joints)}
        bodies = tuple(self._body(joint) for joint in self._tree.joints)
        self.robot = Robot(
            name=scene.name,
            bodies=bodies,
            loops=tuple(self._loops()),
            couplings=tuple(self._couplings()),
            drives=tuple(self._drives()),
            springs=tuple(self._springs()),
            gravity=np.array(scene.gravity),
            settings=dict(self._prescribed_motions()),
        )
        self._note_rest()

    @property
    def _loaded_joints(self) -> set[str]:
        """Names of joints whose coordinates have springs, rotors, controllers or couplings."""
        scene = self._scene
        on_joints = (*scene.forces, *scene.armatures, *scene.control)
        coupled = {joint for coupling in scene.mechanism.couplings for joint, _ in coupling.factors()}
        return coupled | {element.joint for element in on_joints if isinstance(element, OnJoint)}

    def _placement(self, body: int) -> Placement:
        """Return the placement of a body of the mechanism in the world."""
        if body == 0:
            return IN_PLACE
        described = self._mechanism.bodies[body]
        return Placement(np.array(described.center_of_mass), rotation(described.quaternion))

    def _body(self, tree_joint: TreeJoint) -> FileBody:
        """Describe the child of a joint of the tree."""
        body: Body = self._mechanism.bodies[tree_joint.child]
        return FileBody(
            body.name,
            parent=self._numbers[tree_joint.parent],
            placement=self._placement(tree_joint.parent).inverse() @ self._placement(tree_joint.child),
            joints=tuple(self._joints(tree_joint)),
            mass=float(body.mass),
            center=np.zeros(3),
            inertia=np.array(body.inertia),
        )

    def _joints(self, tree_joint: TreeJoint) -> Iterator[FileJoint]:
        """Yield the motions of a joint of the tree, the first one next to the parent."""
        joint = self._tree.joint(tree_joint.joint)
        to_body = self._placement(tree_joint.child).inverse()
        ball = FileJoint(
            joint.name,
            JointKind.BALL,
            axis=np.zeros(3),
            point=np.zeros(3),
            **self._ball_numbers(joint.name),
        )
        if isinstance(joint, Free):
            yield replace(ball, kind=JointKind.FREE)
            return
        names = motion_names(joint, tree_joint.forward)
        # number of the coordinate of each hinge and slide within its joint
        numbers = [k for k, motion in enumerate(joint.motions) if motion.kind != "ball"]
        coordinates = {motion_names(joint)[k]: number for number, k in enumerate(numbers)}
        for name, motion, point in zip(names, tree_joint.motions, tree_joint.points, strict=True):
            in_body = to_body.rotation @ point + to_body.position
            if motion.kind == "ball":
                yield replace(ball, name=name, point=in_body)
                continue
            yield FileJoint(
                name,
                JointKind(motion.kind),
                axis=to_body.rotation @ motion.axis,
                point=in_body,
                **self._coordinate_numbers(joint.name, coordinates[name]),
            )

    def _coordinate_numbers(self, joint: str, coordinate: int) -> dict[str, Any]:
        """Return the numbers of a joint coordinate, such as the stiffness, by names of `FileJoint`."""
        numbers: dict[str, Any] = {}
        for force in self._scene.switched_forces:
            if isinstance(force, JointFriction) and force.key == (joint, coordinate):
                numbers["friction"] = float(force.coulomb)
        if stops := acting_stops(self._scene.switched_forces).get((joint, coordinate)):
            limits = {"low": -math.inf, "high": math.inf}
            limits |= {stop.side: float(stop.limit) for stop in stops}
            numbers["limits"] = limits["low"], limits["high"]
        for element in (*self._scene.forces, *self._scene.armatures):
            if isinstance(element, JointSpring | Armature) and (
                (element.joint, element.coordinate) == (joint, coordinate)
            ):
                if isinstance(element, Armature):
                    numbers["armature"] = float(element.inertia)
                else:
                    numbers["rest"] = float(element.rest)
                    numbers |= _spring_and_damper(element)
        return numbers

    def _ball_numbers(self, joint: str) -> dict[str, Any]:
        """Return spring, damper and rotor of the ball of a joint, by names of `FileJoint`."""
        numbers: dict[str, Any] = {}
        for element in (*self._scene.forces, *self._scene.armatures):
            if isinstance(element, BallSpring | BallArmature) and element.joint == joint:
                if isinstance(element, BallArmature):
                    numbers["armature"] = float(element.inertia)
                else:
                    numbers |= _spring_and_damper(element)
        return numbers

    def _loops(self) -> Iterator[FileLoop]:
        """Yield the loops that joints outside of the tree close."""
        for index in self._tree.cuts:
            joint = self._mechanism.joints[index]
            # the x axis of the frames is the axis of the joint
            axes = np.eye(3)
            if isinstance(joint, Revolute | Translational):
                axes = np.column_stack([joint.axis, *perpendicular_pair(joint.axis)])
            first, second = (self._mechanism.body_index(name) for name in (joint.first, joint.second))
            length = float(joint.length) if isinstance(joint, Rod) else 0.0
            yield FileLoop(
                joint.name,
                LOOP_KINDS[type(joint)],
                first=self._numbers[first],
                second=self._numbers[second],
                first_frame=self._placement(first).inverse() @ Placement(np.array(joint.point), axes),
                second_frame=self._placement(second).inverse()
                @ Placement(np.array(joint.point_on_second), axes),
                length=length,
            )

    def _couplings(self) -> Iterator[FileCoupling]:
        """Yield the couplings of two coordinates, one of them linear, and the threads of screws."""
        for tree_joint in self._tree.joints:
            joint = self._tree.joint(tree_joint.joint)
            if isinstance(joint, Screw):
                slide, hinge = motion_names(joint)
                yield FileCoupling(joint.name, slide, hinge, (0.0, float(joint.pitch)))
        for coupling in self._mechanism.couplings:
            factors, powers = coupling.factors(), coupling.powers()
            linear = [key for key, factor in factors.items() if key not in powers and factor]
            keys = list(factors | powers)
            is_in_tree = all(self._tree.place(*key) is not None for key in keys)
            if len(keys) != 2 or not linear or not is_in_tree:
                self.notes.append(f"coupling {coupling.name!r} is not described")
                continue
            follower = linear[0]
            (leader,) = (key for key in keys if key != follower)
            terms = (factors.get(leader, 0.0), *powers.get(leader, ()))
            follower_name, leader_name = (
                coordinate_name(self._mechanism.joint(joint), number) for joint, number in (follower, leader)
            )
            scaled = (0.0, *(-term / factors[follower] for term in terms))
            yield FileCoupling(coupling.name, follower_name, leader_name, scaled)

    def _drives(self) -> Iterator[FileDrive]:
        """Yield the PD controllers with constant numbers; their control is the target coordinate."""
        for law in self._scene.control:
            if not isinstance(law, PD) or not isinstance(law.feedforward, float | int):
                self.notes.append(f"control law {type(law).__name__} is not described")
                continue
            name = coordinate_name(self._mechanism.joint(law.joint), law.coordinate)
            yield FileDrive(
                name,
                {name: 1.0},
                gain=float(law.stiffness),
                stiffness=-float(law.stiffness),
                damping=-float(law.damping),
                constant=float(law.feedforward),
            )

    def _springs(self) -> Iterator[FileSpring]:
        """Yield the springs and dampers between points of two bodies."""
        for spring in self._scene.forces:
            if isinstance(spring, PointSpring):
                first, second = (self._mechanism.body_index(name) for name in (spring.first, spring.second))
                one, two = (
                    self._placement(body).inverse() @ Placement(np.array(point), np.eye(3))
                    for body, point in ((first, spring.point_on_first), (second, spring.point_on_second))
                )
                yield FileSpring(
                    spring.name,
                    first=self._numbers[first],
                    second=self._numbers[second],
                    first_frame=one,
                    second_frame=two,
                    stiffness=float(spring.stiffness),
                    damping=float(spring.damping),
                    rest=(float(spring.rest_length), float(spring.rest_length)),
                )

    def _prescribed_motions(self) -> Iterator[tuple[Setting, str]]:
        """Yield the functions of prescribed motions, as text, by joint coordinate."""
        for motion in self._scene.motions:
            name = coordinate_name(self._mechanism.joint(motion.joint), motion.coordinate)
            yield Setting("joint", name, PRESCRIBED_MOTION, exerts=True), repr(motion.function)

    def _note_rest(self) -> None:
        """Add notes of what the scene has and the robot has not."""
        kinds = Counter(
            type(force).__name__
            for force in self._scene.forces
            if not isinstance(force, JointSpring | BallSpring | PointSpring | JointFriction | JointStop)
        )
        self.notes.extend(f"{count} forces of type {kind} are not described" for kind, count in kinds.items())
        if any(isinstance(force, JointFriction | JointStop) for force in self._scene.forces):
            self.notes.append(
                "of dry friction the Coulomb friction is described, of stops the limit, and no other numbers"
            )


def _spring_and_damper(spring: JointSpring | BallSpring) -> dict[str, float]:
    """Return stiffness and damping of a spring, by names of `FileJoint`."""
    return {"stiffness": float(spring.stiffness), "damping": float(spring.damping)}
