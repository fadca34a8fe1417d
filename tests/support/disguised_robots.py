"""Random robots, and the same robots as other files would describe them: names, frames, zeros, signs, order.

`random_robot` makes a tree of bodies. `disguise` describes it in other terms and tells which body and which
joint of the second description is which of the first, and how their frames and coordinates differ.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from newton_euler.reading.robot import IN_PLACE, FileBody, FileJoint, JointKind, Placement, Robot
from newton_euler.scalars import Array


@dataclass
class Disguise:
    """A robot in the terms of another file.

    Attributes:
        robot: the robot.
        bodies: name of each body in it, by the name in the original.
        joints: name of each joint in it, by the name in the original.
        senses: 1, or -1 if a joint counts the other way, by the name in the original.
        offsets: coordinate in it minus the sense times the coordinate in the original, by that name.
        frames: of each body's frame in that of the original, by the name in the original.
    """

    robot: Robot
    bodies: dict[str, str]
    joints: dict[str, str]
    senses: dict[str, int]
    offsets: dict[str, float]
    frames: dict[str, Placement]


def turned(axis: Array, angle: float) -> Array:
    """Return the matrix of a rotation about a unit vector, by the quaternion."""
    w, (x, y, z) = math.cos(angle / 2), math.sin(angle / 2) * axis
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def unit(rng: np.random.Generator) -> Array:
    """Draw a direction."""
    vector = rng.normal(size=3)
    return vector / np.linalg.norm(vector)


def random_placement(rng: np.random.Generator, distance: float) -> Placement:
    """Draw a frame at most `distance` m away per axis."""
    return Placement(rng.uniform(-distance, distance, 3), turned(unit(rng), rng.uniform(0.3, 3.0)))


def random_body(rng: np.random.Generator, name: str, parent: int, kinds: tuple[JointKind, ...]) -> FileBody:
    """Draw a body whose joints have the given kinds."""
    axes = rng.normal(size=(3, 3))
    joints = tuple(
        FileJoint(
            f"{name}_joint{number}",
            kind,
            unit(rng) if kind in (JointKind.HINGE, JointKind.SLIDE) else np.zeros(3),
            rng.uniform(-0.1, 0.1, 3) if kind is not JointKind.FREE else np.zeros(3),
            zero=float(rng.choice([0.0, rng.uniform(-1, 1)])) if kind.value in ("hinge", "slide") else 0.0,
        )
        for number, kind in enumerate(kinds)
    )
    mass = float(rng.uniform(0.5, 5.0))
    # inertia of three rods of random directions, so that it is that of a body
    inertia = mass * 0.01 * sum((row @ row) * np.eye(3) - np.outer(row, row) for row in axes)
    return FileBody(
        name, parent, random_placement(rng, 0.4), joints, mass, rng.uniform(-0.2, 0.2, 3), inertia
    )


def random_robot(rng: np.random.Generator, bodies: int, floating: bool) -> Robot:
    """Draw a tree of bodies with hinges, slides, balls and bodies with two or three hinges."""
    made = [random_body(rng, "body0", -1, (JointKind.FREE,) if floating else ())]
    choices = [
        (JointKind.HINGE,),
        (JointKind.SLIDE,),
        (JointKind.BALL,),
        (JointKind.HINGE, JointKind.HINGE),
        (JointKind.HINGE, JointKind.SLIDE, JointKind.HINGE),
    ]
    for index in range(1, bodies):
        # chains with some branches: mostly the body before is the parent
        parent = index - 1 if rng.uniform() < 0.7 else int(rng.integers(index))
        kinds = choices[int(rng.choice(5, p=[0.6, 0.1, 0.1, 0.1, 0.1]))]
        made.append(random_body(rng, f"body{index}", parent, kinds))
    return Robot("random", tuple(made))


def moved_joint(joint: FileJoint, change: float, turn: Array) -> Placement:
    """Return the motion of a body, in its frame, if its joint moves; `turn` is that of a ball."""
    if joint.kind is JointKind.HINGE:
        rotation = turned(joint.axis, change)
        return Placement(joint.point - rotation @ joint.point, rotation)
    if joint.kind is JointKind.SLIDE:
        return Placement(change * joint.axis, np.eye(3))
    return Placement(joint.point - turn @ joint.point, turn)


def moved_body(body: FileBody, changes: list[float], turn: Array) -> FileBody:
    """Describe a body in another pose: each joint's coordinate is changed, and balls are turned."""
    motion = IN_PLACE
    joints: list[FileJoint] = []
    for joint, change in zip(reversed(body.joints), reversed(changes), strict=True):
        # axes of joints before others are moved by the others, which are between them and the body
        back = motion.inverse()
        joints.insert(
            0,
            replace(
                joint,
                axis=back.rotation @ joint.axis,
                point=back.position + back.rotation @ joint.point,
                zero=joint.zero + change,
            ),
        )
        motion = moved_joint(joint, change, turn) @ motion
    return replace(body, placement=body.placement @ motion, joints=tuple(joints))


def with_frame(body: FileBody, frame: Placement, parent_frame: Placement) -> FileBody:
    """Describe a body in another frame, which is given in the frame of before, as the parent's is."""
    back = frame.inverse()
    joints = tuple(
        replace(k, axis=back.rotation @ k.axis, point=back.position + back.rotation @ k.point)
        for k in body.joints
    )
    return replace(
        body,
        placement=parent_frame.inverse() @ body.placement @ frame,
        joints=joints,
        center=back.position + back.rotation @ body.center,
        inertia=back.rotation @ body.inertia @ back.rotation.T,
    )


def disguise(
    robot: Robot,
    rng: np.random.Generator,
    *,
    names: bool = True,
    frames: float = 1.0,
    zeros: float = 1.0,
    order: bool = True,
) -> Disguise:
    """Describe a robot in the terms of another file.

    Args:
        robot: the robot.
        rng: source of the changes.
        names: whether bodies and joints get names without any likeness.
        frames: fraction of the bodies whose frames are turned and moved.
        zeros: fraction of the joints with another pose of the file and another zero.
        order: whether bodies are listed in another order.
    """
    count = len(robot.bodies)
    words = [f"{chr(97 + k % 26)}{chr(97 + k // 26)}x" for k in rng.permutation(400)[: 4 * count]]
    body_names = {k.name: words[i] if names else k.name for i, k in enumerate(robot.bodies)}
    all_joints = [joint for body in robot.bodies for joint in body.joints]
    joint_names = {k.name: words[count + i] + "q" if names else k.name for i, k in enumerate(all_joints)}
    placed = {
        k.name: random_placement(rng, 0.3) if rng.uniform() < frames else IN_PLACE for k in robot.bodies
    }
    senses, offsets = {}, {}
    made: list[FileBody] = []
    for body in robot.bodies:
        changes, own = [], []
        for joint in body.joints:
            change = rng.uniform(-1.5, 1.5) if rng.uniform() < zeros else 0.0
            measured = joint.kind in (JointKind.HINGE, JointKind.SLIDE)
            changes.append(change if measured else 0.0)
            senses[joint.name] = int(rng.choice([-1, 1])) if measured else 1
            offsets[joint.name] = float(rng.uniform(-1, 1)) if measured and rng.uniform() < zeros else 0.0
            own.append(joint.name)
        turn = turned(unit(rng), rng.uniform(0.5, 2.0)) if rng.uniform() < zeros else np.eye(3)
        moved = moved_body(body, changes, turn)
        signed = tuple(
            replace(
                k,
                name=joint_names[name],
                axis=senses[name] * k.axis,
                zero=senses[name] * k.zero + offsets[name],
            )
            for k, name in zip(moved.joints, own, strict=True)
        )
        above = placed[robot.bodies[body.parent].name] if body.parent >= 0 else IN_PLACE
        described = with_frame(replace(moved, joints=signed), placed[body.name], above)
        made.append(replace(described, name=body_names[body.name]))
    result = reordered(made, rng) if order else tuple(made)
    return Disguise(replace(robot, bodies=result), body_names, joint_names, senses, offsets, placed)


def reordered(bodies: list[FileBody], rng: np.random.Generator) -> tuple[FileBody, ...]:
    """List bodies in another order, parents still before their children."""
    order: list[int] = []
    ready = [k for k, body in enumerate(bodies) if body.parent < 0]
    while ready:
        order.append(ready.pop(int(rng.integers(len(ready)))))
        ready += [k for k, body in enumerate(bodies) if body.parent == order[-1]]
    place = {old: new for new, old in enumerate(order)} | {-1: -1}
    return tuple(replace(bodies[k], parent=place[bodies[k].parent]) for k in order)


def split(robot: Robot, name: str, part: str, rng: np.random.Generator) -> Robot:
    """Make a part of a body a body of its own that is fixed to it; the sum stays the same."""
    index = next(k for k, body in enumerate(robot.bodies) if body.name == name)
    body = robot.bodies[index]
    offset = random_placement(rng, 0.2)
    mass = 0.3 * body.mass
    center = body.center + rng.uniform(-0.05, 0.05, 3)  # of the part
    rest_center = (body.mass * body.center - mass * center) / (body.mass - mass)
    own = 0.2 * body.inertia
    arms = [(mass, center - body.center), (body.mass - mass, rest_center - body.center)]
    steiner = sum(m * ((arm @ arm) * np.eye(3) - np.outer(arm, arm)) for m, arm in arms)
    back = offset.inverse()
    fixed = FileBody(
        part,
        index,
        offset,
        (),
        mass,
        back.position + back.rotation @ center,
        back.rotation @ own @ back.rotation.T,
    )
    rest = replace(body, mass=body.mass - mass, center=rest_center, inertia=body.inertia - own - steiner)
    bodies = [*robot.bodies[:index], rest, *robot.bodies[index + 1 :], fixed]
    return replace(robot, bodies=tuple(bodies))


def chained(robot: Robot) -> Robot:
    """Give each body one joint only: further joints hold bodies without mass in between, as in URDF."""
    made: list[FileBody] = []
    place = {-1: -1}
    for index, body in enumerate(robot.bodies):
        parent, placement = place[body.parent], body.placement
        for joint in body.joints[:-1]:
            link = FileBody(
                f"{joint.name}_link", parent, placement, (joint,), 0.0, np.zeros(3), np.zeros((3, 3))
            )
            parent, placement = len(made), IN_PLACE
            made.append(link)
        place[index] = len(made)
        made.append(replace(body, parent=parent, placement=placement, joints=body.joints[-1:]))
    return replace(robot, bodies=tuple(made))
