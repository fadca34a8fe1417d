"""Mass matrix and placements of a described robot at any joint coordinates, as plain sums over its bodies."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from newton_euler.reading.robot import JointKind, Placement, Robot
from newton_euler.scalars import Array


class Column(NamedTuple):
    """Unit velocity of one coordinate: of the body point at the world's origin, and angular, world frame."""

    name: str
    body: int
    linear: Array
    angular: Array
    armature: float


class Pose(NamedTuple):
    """Robot at joint coordinates: placements of its bodies, and the motion of each velocity coordinate."""

    placements: list[Placement]
    columns: list[Column]


def pose(robot: Robot, coordinates: dict[tuple[int, int], Array]) -> Pose:
    """Place the bodies of a robot.

    Args:
        robot: description.
        coordinates: by body and joint of the body: (1,) of a hinge or slide, (4,) quaternion (w, x, y, z) of
            a ball, (7,) position and quaternion of a free joint, in the world.
    """
    placements: list[Placement] = []
    columns: list[Column] = []
    for number, body in enumerate(robot.bodies):
        at = body.placement if body.parent < 0 else placements[body.parent] @ body.placement
        for k, joint in enumerate(body.joints):
            q = coordinates[number, k]
            turned = np.eye(3)
            shift = np.zeros(3)
            anchor, axis = at.position + at.rotation @ joint.point, at.rotation @ joint.axis
            if joint.kind == JointKind.HINGE:
                turned = Rotation.from_rotvec(joint.axis * (q[0] - joint.zero)).as_matrix()
                motions = [(np.cross(anchor, axis), axis)]
            elif joint.kind == JointKind.SLIDE:
                shift = joint.axis * (q[0] - joint.zero)
                motions = [(axis, np.zeros(3))]
            elif joint.kind == JointKind.BALL:
                turned = Rotation.from_quat(q, scalar_first=True).as_matrix()
                own_axes = (at.rotation @ turned).T
                motions = [(np.cross(anchor, own), own) for own in own_axes]
            else:
                at = Placement(q[:3], Rotation.from_quat(q[3:], scalar_first=True).as_matrix())
                motions = [(unit, np.zeros(3)) for unit in np.eye(3)]
                motions += [(np.cross(at.position, own), own) for own in at.rotation.T]
            columns += [Column(joint.name, number, *motion, joint.armature) for motion in motions]
            at = at @ Placement(joint.point - turned @ joint.point + shift, turned)
        placements.append(at)
    return Pose(placements, columns)


def mass_matrix(robot: Robot, at: Pose) -> Array:
    """Sum m Jv^T Jv + Jw^T I Jw over all bodies, with the armatures on the diagonal."""
    above: list[set[int]] = []
    for number, body in enumerate(robot.bodies):
        above.append({number} | (above[body.parent] if body.parent >= 0 else set()))
    total = np.diag([column.armature for column in at.columns]).astype(float)
    for number, (body, placed) in enumerate(zip(robot.bodies, at.placements, strict=True)):
        center = placed.position + placed.rotation @ body.center
        inertia = placed.rotation @ body.inertia @ placed.rotation.T
        moves = [column.body in above[number] for column in at.columns]
        linear = (
            np.array([c.linear + np.cross(c.angular, center) for c in at.columns]) * np.array(moves)[:, None]
        )
        angular = np.array([c.angular for c in at.columns]) * np.array(moves)[:, None]
        total += body.mass * linear @ linear.T + angular @ inertia @ angular.T
    return total
