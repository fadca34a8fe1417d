"""Model file as XML whose elements a study changes; the part that MJCF and URDF have in common."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from abc import ABC, abstractmethod
from typing import ClassVar, NamedTuple

import numpy as np

from newton_euler.reading.robot import Placement
from newton_euler.scalars import Array
from tests.support.planted.plant import NotApplicable


class Inertial(NamedTuple):
    """Mass, kg, center of mass (3,), m, and inertia (3, 3), kg m^2, about it, in the frame of the body."""

    mass: float
    center: Array
    inertia: Array


class ModelText(ABC):
    """XML of a model file. Names of bodies are those of links in a URDF.

    Attributes:
        root: root element; changes are made in it.
        format: "MJCF" or "URDF".
    """

    format: ClassVar[str]

    def __init__(self, text: str) -> None:
        self.root = ET.fromstring(text)

    def text(self) -> str:
        """Return the changed file."""
        return ET.tostring(self.root, encoding="unicode")

    def moving_bodies(self) -> list[str]:
        """Return the names of the bodies with inertia that a joint moves, directly or not."""
        return [body for body in self.bodies() if self.has_inertial(body) and self.is_moving(body)]

    def hinges(self) -> dict[str, str]:
        """Return the names of the hinges that are the only joint above their body, with the body."""
        found = {}
        for body in self.bodies():
            joints = self.joints_above(body)
            if len(joints) == 1 and self.is_hinge(joints[0]):
                found[joints[0]] = body
        return found

    def children(self, body: str) -> list[str]:
        """Return the names of the bodies whose parent a body is."""
        return [other for other in self.bodies() if self.parent(other) == body]

    def branch(self, body: str) -> list[str]:
        """Return the names of a body and all bodies that it carries."""
        return [body, *(name for child in self.children(body) for name in self.branch(child))]

    def is_moving(self, body: str) -> bool:
        """Return whether a joint is between a body and the ground."""
        parent = self.parent(body)
        return bool(self.joints_above(body)) or (parent is not None and self.is_moving(parent))

    def set_frame(self, body: str, inside: Placement) -> None:
        """Give a body another frame without a change of the robot.

        Args:
            body: name of the body.
            inside: the new frame in the present one.
        """
        back = inside.inverse()
        carried = {child: self.placement(child) for child in self.children(body)}
        joints = {joint: (self.axis(joint), self.point(joint)) for joint in self.joints_above(body)}
        inertial = self.inertial(body)
        self.set_placement(body, self.placement(body) @ inside)
        for child, placement in carried.items():
            self.set_placement(child, back @ placement)
        for joint, (axis, point) in joints.items():
            self.set_axis(joint, back.rotation @ axis)
            self.set_point(joint, back.position + back.rotation @ point)
        rotated = back.rotation @ inertial.inertia @ back.rotation.T
        center = back.position + back.rotation @ inertial.center
        self.set_inertial(body, Inertial(inertial.mass, center, rotated))

    def is_symmetric(self, joint: str) -> bool:
        """Return whether the limits of a joint do not change if they are mirrored."""
        limits = self.limits(joint)
        return limits is None or bool(np.isclose(limits[0], -limits[1]))

    def zero(self, joint: str) -> float:
        """Return the coordinate of a hinge in the pose of the file, rad."""
        return 0.0

    def set_zero(self, joint: str, zero: float) -> None:
        """Replace the coordinate of a hinge in the pose of the file, rad.

        Raises:
            NotApplicable: if the format has none.
        """
        if zero:
            raise NotApplicable(f"{self.format} has no coordinates of the pose of the file")

    def is_in_loop(self, body: str) -> bool:
        """Return whether a loop's end moves on its body if a body gets another place at its parent."""
        return False

    @abstractmethod
    def scale_loops(self, factor: float) -> None:
        """Multiply the points of all loops with a factor."""

    @abstractmethod
    def bodies(self) -> list[str]:
        """Return the names of all bodies."""

    @abstractmethod
    def parent(self, body: str) -> str | None:
        """Return the name of the parent of a body; None for the ground."""

    @abstractmethod
    def joints_above(self, body: str) -> list[str]:
        """Return the names of the joints, which are not fixed, between a body and its parent."""

    @abstractmethod
    def is_hinge(self, joint: str) -> bool:
        """Return whether a joint turns about an axis."""

    @abstractmethod
    def has_inertial(self, body: str) -> bool:
        """Return whether the file states the mass and the inertia of a body."""

    @abstractmethod
    def inertial(self, body: str) -> Inertial:
        """Return mass properties of a body."""

    @abstractmethod
    def set_inertial(self, body: str, inertial: Inertial) -> None:
        """Replace all mass properties of a body; the inertia is written as a full matrix."""

    @abstractmethod
    def set_mass(self, body: str, mass: float) -> None:
        """Replace the mass of a body, kg."""

    @abstractmethod
    def set_center(self, body: str, center: Array) -> None:
        """Replace the center of mass (3,) of a body, m."""

    @abstractmethod
    def placement(self, body: str) -> Placement:
        """Return the placement of a body in its parent, at the zeros of its joints."""

    @abstractmethod
    def set_placement(self, body: str, placement: Placement) -> None:
        """Replace the placement of a body in its parent."""

    @abstractmethod
    def set_position(self, body: str, position: Array) -> None:
        """Replace the position (3,) of a body in its parent, m."""

    @abstractmethod
    def axis(self, joint: str) -> Array:
        """Return the axis (3,) of a hinge in the frame of its body."""

    @abstractmethod
    def set_axis(self, joint: str, axis: Array) -> None:
        """Replace the axis (3,) of a hinge."""

    @abstractmethod
    def point(self, joint: str) -> Array:
        """Return a point (3,) of the axis of a hinge in the frame of its body, m."""

    @abstractmethod
    def set_point(self, joint: str, point: Array) -> None:
        """Replace the point (3,) of a hinge, m."""

    @abstractmethod
    def limits(self, joint: str) -> tuple[float, float] | None:
        """Return the limits of a hinge, rad; None without limits."""

    @abstractmethod
    def set_limits(self, joint: str, limits: tuple[float, float]) -> None:
        """Replace the limits of a hinge, rad."""

    @abstractmethod
    def number(self, joint: str, name: str) -> float:
        """Return the damping, the dry friction or the effort of a joint by its name."""

    @abstractmethod
    def set_number(self, joint: str, name: str, value: float) -> None:
        """Replace the damping, the dry friction or the effort of a joint by its name."""

    @abstractmethod
    def add_fixed(self, parent: str, name: str, position: Array, inertial: Inertial | None) -> None:
        """Add a body that is fixed to another one, with or without mass."""

    @abstractmethod
    def remove_branch(self, body: str) -> list[str]:
        """Remove a body, with all that it carries and its drives; return the names of the drives.

        Raises:
            NotApplicable: if a loop or a coupling refers to it.
        """

    @abstractmethod
    def remove_inertial(self, body: str) -> None:
        """Remove the mass of a body."""

    @abstractmethod
    def reverse_order(self, bodies: list[str]) -> None:
        """Write bodies that have one parent, or their joints, in the opposite order."""

    @abstractmethod
    def rename(self, names: dict[str, str]) -> None:
        """Give bodies and joints other names, also where the file refers to them."""

    @abstractmethod
    def reverse_drives(self, joint: str) -> None:
        """Let the drives of a joint push the other way."""

    @abstractmethod
    def is_servo_driven(self, joint: str) -> bool:
        """Return whether a drive or a spring of a joint depends on the zero of the joint's coordinate."""

    @abstractmethod
    def can_be_driven(self, joint: str) -> bool:
        """Return whether a limit of the effort of a joint may limit a drive."""
