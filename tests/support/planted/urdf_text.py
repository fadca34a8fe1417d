"""URDF as XML whose elements a study changes."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from math import asin, atan2, inf

import numpy as np

from newton_euler.reading.robot import Placement
from newton_euler.scalars import Array
from tests.support.planted.model_text import Inertial, ModelText
from tests.support.planted.plant import NotApplicable, numbers, text, turn

NUMBERS = {
    "damping": ("dynamics", "damping"),
    "friction": ("dynamics", "friction"),
    "effort": ("limit", "effort"),
    "speed": ("limit", "velocity"),
}
"""Tag and attribute of numbers of a joint."""

ELEMENTS = ("xx", "xy", "xz", "yy", "yz", "zz")
"""Elements of an inertia, in the order of the attributes."""


class UrdfText(ModelText):
    """XML of a URDF."""

    format = "URDF"

    def __init__(self, text: str) -> None:
        super().__init__(text)
        self._read()

    def _read(self) -> None:
        """Find links and joints by their names."""
        self.links = {str(link.get("name")): link for link in self.root.findall("link")}
        self.joints = {str(joint.get("name")): joint for joint in self.root.findall("joint")}
        self.joint_above = {_link(joint, "child"): joint for joint in self.joints.values()}

    def bodies(self) -> list[str]:
        return list(self.links)

    def parent(self, body: str) -> str | None:
        joint = self.joint_above.get(body)
        return None if joint is None else _link(joint, "parent")

    def joints_above(self, body: str) -> list[str]:
        joint = self.joint_above.get(body)
        return [] if joint is None or joint.get("type") == "fixed" else [str(joint.get("name"))]

    def is_hinge(self, joint: str) -> bool:
        return self.joints[joint].get("type") in ("revolute", "continuous")

    def has_inertial(self, body: str) -> bool:
        return self.links[body].find("inertial/mass") is not None

    def inertial(self, body: str) -> Inertial:
        own = _child(self.links[body], "inertial")
        origin = _origin(own)
        given = _child(own, "inertia")
        xx, xy, xz, yy, yz, zz = (float(given.get(f"i{name}", "0")) for name in ELEMENTS)
        matrix = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        rotated = origin.rotation @ matrix @ origin.rotation.T
        return Inertial(float(_child(own, "mass").get("value", "0")), origin.position, rotated)

    def set_inertial(self, body: str, inertial: Inertial) -> None:
        own = _child(self.links[body], "inertial")
        self.set_mass(body, inertial.mass)
        _set_origin(own, Placement(inertial.center, np.eye(3)))
        matrix = inertial.inertia
        given = _child(own, "inertia")
        for name, value in zip(ELEMENTS, matrix[np.triu_indices(3)], strict=True):
            given.set(f"i{name}", text(value))

    def set_mass(self, body: str, mass: float) -> None:
        _child(self.links[body], "inertial/mass").set("value", text(mass))

    def set_center(self, body: str, center: Array) -> None:
        own = _child(self.links[body], "inertial")
        _child(own, "origin").set("xyz", text(*center))

    def placement(self, body: str) -> Placement:
        return _origin(self._joint(body))

    def set_placement(self, body: str, placement: Placement) -> None:
        _set_origin(self._joint(body), placement)

    def set_position(self, body: str, position: Array) -> None:
        _child(self._joint(body), "origin").set("xyz", text(*position))

    def axis(self, joint: str) -> Array:
        given = self.joints[joint].find("axis")
        return numbers(None if given is None else given.get("xyz"), "1 0 0")

    def set_axis(self, joint: str, axis: Array) -> None:
        _child(self.joints[joint], "axis").set("xyz", text(*axis))

    def point(self, joint: str) -> Array:
        return np.zeros(3)

    def set_point(self, joint: str, point: Array) -> None:
        along = self.axis(joint)
        if np.linalg.norm(np.cross(point, along)) > 1e-12:
            raise NotApplicable("the axis of a URDF's joint goes through the origin of the link")

    def limits(self, joint: str) -> tuple[float, float] | None:
        limit = self.joints[joint].find("limit")
        if limit is None or self.joints[joint].get("type") == "continuous":
            return None
        return float(limit.get("lower", "0")), float(limit.get("upper", "0"))

    def set_limits(self, joint: str, limits: tuple[float, float]) -> None:
        limit = _child(self.joints[joint], "limit")
        limit.set("lower", text(limits[0]))
        limit.set("upper", text(limits[1]))

    def scale_loops(self, factor: float) -> None:
        """Do nothing: a URDF has no loops."""

    def number(self, joint: str, name: str) -> float:
        tag, attribute = NUMBERS[name]
        found = self.joints[joint].find(tag)
        default = str(inf) if tag == "limit" else "0"
        return float(default if found is None else found.get(attribute, default))

    def set_number(self, joint: str, name: str, value: float) -> None:
        tag, attribute = NUMBERS[name]
        if tag == "limit" and self.joints[joint].find(tag) is None:
            raise NotApplicable(f"{joint} has no {tag}")
        _child(self.joints[joint], tag).set(attribute, text(value))

    def add_fixed(self, parent: str, name: str, position: Array, inertial: Inertial | None) -> None:
        link = ET.SubElement(self.root, "link", name=name)
        joint = ET.SubElement(self.root, "joint", name=f"{name}_joint", type="fixed")
        ET.SubElement(joint, "origin", xyz=text(*position), rpy="0 0 0")
        ET.SubElement(joint, "parent", link=parent)
        ET.SubElement(joint, "child", link=name)
        if inertial is not None:
            ET.SubElement(link, "inertial")
        self._read()
        if inertial is not None:
            self.set_inertial(name, inertial)

    def remove_branch(self, body: str) -> list[str]:
        gone = self.branch(body)
        joints = {str(self.joint_above[name].get("name")) for name in gone}
        if any(each.get("joint") in joints for each in self.root.iter("mimic")):
            raise NotApplicable("a joint of the branch is mimicked")
        for name in gone:
            self.root.remove(self.links[name])
            self.root.remove(self.joint_above[name])
        self._read()
        return []

    def remove_inertial(self, body: str) -> None:
        self.links[body].remove(_child(self.links[body], "inertial"))

    def reverse_order(self, bodies: list[str]) -> None:
        joints = [self.joint_above[body] for body in bodies]
        places = [list(self.root).index(joint) for joint in joints]
        for place, joint in zip(places, reversed(joints), strict=True):
            self.root[place] = joint

    def rename(self, names: dict[str, str]) -> None:
        for element in self.root.iter():
            keys = ("name",) if element.tag in ("link", "joint") else ("link", "joint")
            for key in keys:
                if element.get(key) in names:
                    element.set(key, names[element.attrib[key]])
        self._read()

    def reverse_drives(self, joint: str) -> None:
        if any(each.get("joint") == joint for each in self.root.iter("mimic")):
            raise NotApplicable("another joint mimics it")
        if self.joints[joint].find("mimic") is not None:
            raise NotApplicable("it mimics another joint")

    def is_servo_driven(self, joint: str) -> bool:
        try:
            self.reverse_drives(joint)
        except NotApplicable:
            return True
        return False

    def can_be_driven(self, joint: str) -> bool:
        return True  # a URDF has no drives, and limits those of its user

    def _joint(self, body: str) -> ET.Element:
        """Return the joint above a body."""
        if body not in self.joint_above:
            raise NotApplicable(f"{body} is the root")
        return self.joint_above[body]


def _link(joint: ET.Element, end: str) -> str:
    """Return the name of the "parent" or "child" of a joint."""
    return str(_child(joint, end).get("link"))


def _child(element: ET.Element, path: str) -> ET.Element:
    """Return the first element at a path in an element; elements that are missing are added."""
    for tag in path.split("/"):
        found = element.find(tag)
        element = ET.SubElement(element, tag) if found is None else found
    return element


def _origin(element: ET.Element) -> Placement:
    """Return the placement that the <origin> in an element states."""
    origin = element.find("origin")
    given = {} if origin is None else origin.attrib
    roll, pitch, yaw = numbers(given.get("rpy"), "0 0 0")
    x, y, z = np.eye(3)
    return Placement(numbers(given.get("xyz"), "0 0 0"), turn(z, yaw) @ turn(y, pitch) @ turn(x, roll))


def _set_origin(element: ET.Element, placement: Placement) -> None:
    """Write a placement into the <origin> in an element."""
    origin, r = _child(element, "origin"), placement.rotation
    origin.set("xyz", text(*placement.position))
    angles = atan2(r[2, 1], r[2, 2]), -asin(np.clip(r[2, 0], -1.0, 1.0)), atan2(r[1, 0], r[0, 0])
    origin.set("rpy", text(*angles))
