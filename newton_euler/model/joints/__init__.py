"""Joints: what they have in common, and one class a kind."""

from newton_euler.model.joints.base import Joint, JointEquations, Key, Motion, Pose, perpendicular_pair
from newton_euler.model.joints.compound import Compound
from newton_euler.model.joints.kinds import (
    JOINT_KINDS,
    Cylindrical,
    Fixed,
    Free,
    Planar,
    PointOnLine,
    Prismatic,
    Revolute,
    Rod,
    Screw,
    Spherical,
    Translational,
    Universal,
)

__all__ = [
    "JOINT_KINDS",
    "Compound",
    "Cylindrical",
    "Fixed",
    "Free",
    "Joint",
    "JointEquations",
    "Key",
    "Motion",
    "Planar",
    "PointOnLine",
    "Pose",
    "Prismatic",
    "Revolute",
    "Rod",
    "Screw",
    "Spherical",
    "Translational",
    "Universal",
    "perpendicular_pair",
]
