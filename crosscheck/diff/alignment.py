"""Pairs of bodies and joints of two robots that play the same role, and how their frames and zeros differ.

In: two descriptions, `newton_euler.reading.robot.Robot`. Out: an `Alignment`, from which
`crosscheck.diff.rows` compares numbers and `crosscheck.diff.motion` compares motions.
"""

from __future__ import annotations

from dataclasses import dataclass

from newton_euler.reading.robot import Placement


@dataclass(frozen=True, eq=False)
class BodyPair:
    """Rigid bodies of two robots that play the same role.

    Attributes:
        first, second: indices of the bodies in `Robot.bodies`. Bodies that are fixed to each other are one
            rigid body; the first index is that of the body next to the root, whose frame counts.
        placement: of the second robot's body frame in the first robot's body frame.
    """

    first: tuple[int, ...]
    second: tuple[int, ...]
    placement: Placement


@dataclass(frozen=True)
class JointPair:
    """Joints of two robots that play the same role.

    Attributes:
        first, second: for each robot, index of the body and index of the joint in `FileBody.joints`.
        sense: 1, or -1 if the joint counts its coordinate the other way in the second robot.
        offset: coordinate in the second robot minus `sense` times the coordinate in the first, rad or m, if
            both are in the same pose.
    """

    first: tuple[int, int]
    second: tuple[int, int]
    sense: int
    offset: float


@dataclass(frozen=True, eq=False)
class Alignment:
    """Correspondence of two robots.

    Attributes:
        bodies: pairs of rigid bodies, parents before children.
        joints: pairs of joints.
        first_bodies, second_bodies: indices of bodies without partner in each robot.
        first_joints, second_joints: joints without partner, as in `JointPair`.
        base: how the roots are held, if that differs, such as "floating in the first, fixed in the second".
        renamed: pairs of other names, first and second, that were found by structure.
    """

    bodies: tuple[BodyPair, ...]
    joints: tuple[JointPair, ...]
    first_bodies: tuple[int, ...] = ()
    second_bodies: tuple[int, ...] = ()
    first_joints: tuple[tuple[int, int], ...] = ()
    second_joints: tuple[tuple[int, int], ...] = ()
    base: str = ""
    renamed: tuple[tuple[str, str], ...] = ()
