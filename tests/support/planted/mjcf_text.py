"""MJCF as XML whose elements a study changes. Present numbers come from MuJoCo's compiled model."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from copy import deepcopy
from functools import cached_property

import mujoco
import numpy as np

from newton_euler.reading.robot import Placement
from newton_euler.scalars import Array
from tests.support.planted.model_text import Inertial, ModelText
from tests.support.planted.plant import NotApplicable, numbers, text

ORIENTATIONS = ("quat", "euler", "axisangle", "xyaxes", "zaxis")
"""Attributes of which an element has at most one."""

UNUSED = ("sensor", "keyframe", "contact", "custom", "light", "camera")
"""Tags of elements that refer to others and change no mass, joint, loop or drive."""

REFERENCES = ("body", "body1", "body2", "joint", "joint1", "joint2")
"""Attributes that refer to bodies and joints."""


class MjcfText(ModelText):
    """XML of an MJCF. Every body and joint needs a name."""

    format = "MJCF"

    def __init__(self, text: str) -> None:
        super().__init__(text)
        for parent in list(self.root.iter()):
            for tag in UNUSED:
                for element in parent.findall(tag):
                    parent.remove(element)
        self._read()

    def _read(self) -> None:
        """Find bodies and joints by their names."""
        self.__dict__.pop("model", None)
        world = self.root.findall("worldbody")
        self.elements = {str(body.get("name")): body for part in world for body in part.iter("body")}
        self.parents = {
            str(child.get("name")): str(body.get("name"))
            for body in self.elements.values()
            for child in body.findall("body")
        }
        self.joint_elements = {
            str(joint.get("name")): joint
            for body in self.elements.values()
            for joint in body
            if joint.tag in ("joint", "freejoint")
        }

    def reduced(self) -> str:
        """Return the file without shapes of bodies whose mass it states, so that no mesh is loaded."""
        root = deepcopy(self.root)
        for body in root.iter("body"):
            if body.find("inertial") is not None:
                for geom in body.findall("geom"):
                    body.remove(geom)
        if not any(geom.get("mesh") for geom in root.iter("geom")):
            for section in root.findall("asset"):
                for asset in [*section.findall("mesh"), *section.findall("texture")]:
                    section.remove(asset)
        for material in root.iter("material"):
            material.attrib.pop("texture", None)
        return ET.tostring(root, encoding="unicode")

    @cached_property
    def model(self) -> mujoco.MjModel:
        """The compiled model; deleted with each change.

        Raises:
            NotApplicable: if MuJoCo refuses the changed file.
        """
        try:
            return mujoco.MjModel.from_xml_string(self.reduced())
        except ValueError as error:
            raise NotApplicable(f"MuJoCo refuses it: {error}") from error

    @property
    def angle_unit(self) -> float:
        """The file's unit of angles, rad."""
        compiler = self.root.find("compiler")
        is_radian = compiler is not None and compiler.get("angle") == "radian"
        return 1.0 if is_radian else math.radians(1.0)

    def set(self, element: ET.Element, **attributes: str) -> None:
        """Replace attributes of an element."""
        for name, value in attributes.items():
            element.set(name, value)
        self.__dict__.pop("model", None)

    def bodies(self) -> list[str]:
        return list(self.elements)

    def parent(self, body: str) -> str | None:
        return self.parents.get(body)

    def joints_above(self, body: str) -> list[str]:
        found = [each for each in self.elements[body] if each.tag in ("joint", "freejoint")]
        return [joint.get("name", "") for joint in found]

    def is_hinge(self, joint: str) -> bool:
        return bool(joint and self.model.joint(joint).type[0] == int(mujoco.mjtJoint.mjJNT_HINGE))

    def has_inertial(self, body: str) -> bool:
        return self.elements[body].find("inertial") is not None

    def inertial(self, body: str) -> Inertial:
        own = self.model.body(body)
        axes = _rotation(own.iquat)
        return Inertial(float(own.mass[0]), own.ipos.copy(), (axes * own.inertia) @ axes.T)

    def set_inertial(self, body: str, inertial: Inertial) -> None:
        own = self.elements[body].find("inertial")
        if own is None:
            raise NotApplicable(f"{body} has no <inertial>")
        for name in (*ORIENTATIONS, "diaginertia"):
            own.attrib.pop(name, None)
        (xx, xy, xz), (_, yy, yz), (_, _, zz) = inertial.inertia
        matrix = text(xx, yy, zz, xy, xz, yz)
        self.set(own, mass=text(inertial.mass), pos=text(*inertial.center), fullinertia=matrix)

    def set_mass(self, body: str, mass: float) -> None:
        self.set(self._inertial(body), mass=text(mass))

    def set_center(self, body: str, center: Array) -> None:
        self.set(self._inertial(body), pos=text(*center))

    def placement(self, body: str) -> Placement:
        own = self.model.body(body)
        return Placement(own.pos.copy(), _rotation(own.quat))

    def set_placement(self, body: str, placement: Placement) -> None:
        element = self.elements[body]
        for name in ORIENTATIONS:
            element.attrib.pop(name, None)
        quaternion = np.zeros(4)
        mujoco.mju_mat2Quat(quaternion, np.ascontiguousarray(placement.rotation).ravel())
        self.set(element, pos=text(*placement.position), quat=text(*quaternion))

    def set_position(self, body: str, position: Array) -> None:
        self.set(self.elements[body], pos=text(*position))

    def set_frame(self, body: str, inside: Placement) -> None:
        own = {body, *(str(site.get("name")) for site in self.elements[body].findall("site"))}
        for section in ("equality", "tendon"):
            for element in (each for part in self.root.findall(section) for each in part.iter()):
                if own & {*element.attrib.values()}:
                    raise NotApplicable(f"a loop or a tendon has its end on {body}")
        super().set_frame(body, inside)

    def axis(self, joint: str) -> Array:
        found: Array = self.model.joint(joint).axis.copy()
        return found

    def set_axis(self, joint: str, axis: Array) -> None:
        self.set(self.joint_elements[joint], axis=text(*axis))

    def point(self, joint: str) -> Array:
        found: Array = self.model.joint(joint).pos.copy()
        return found

    def set_point(self, joint: str, point: Array) -> None:
        self.set(self.joint_elements[joint], pos=text(*point))

    def limits(self, joint: str) -> tuple[float, float] | None:
        own = self.model.joint(joint)
        if not self.model.jnt_limited[own.id]:
            return None
        low, high = own.range.tolist()
        return low, high

    def set_limits(self, joint: str, limits: tuple[float, float]) -> None:
        self.set(self.joint_elements[joint], range=text(*(each / self.angle_unit for each in limits)))

    def zero(self, joint: str) -> float:
        return float(self.model.qpos0[self.model.joint(joint).qposadr[0]])

    def set_zero(self, joint: str, zero: float) -> None:
        self.set(self.joint_elements[joint], ref=text(zero / self.angle_unit))

    def _loops(self) -> list[ET.Element]:
        """Return the points that are equal in two bodies; MuJoCo finds the second one in the file's pose."""
        loops = [each for part in self.root.findall("equality") for each in part.findall("connect")]
        return [each for each in loops if each.get("anchor")]

    def is_in_loop(self, body: str) -> bool:
        branch = self.branch(body)
        ends = [(each.get("body1") in branch, each.get("body2") in branch) for each in self._loops()]
        return any(one != two for one, two in ends)

    def scale_loops(self, factor: float) -> None:
        for loop in self._loops():
            anchor = factor * numbers(loop.get("anchor"), "0 0 0")
            self.set(loop, anchor=text(*anchor))

    def number(self, joint: str, name: str) -> float:
        own = self.model.joint(joint)
        if name == "friction":
            return float(own.frictionloss[0])
        if name == "effort":
            is_limited = self.model.jnt_actfrclimited[own.id]
            return float(self.model.jnt_actfrcrange[own.id, 1]) if is_limited else math.inf
        return float(np.ravel(getattr(own, name))[0])

    def set_number(self, joint: str, name: str, value: float) -> None:
        element = self.joint_elements[joint]
        match name:
            case "friction":
                self.set(element, frictionloss=text(value))
            case "effort":
                self.set(element, actuatorfrcrange=text(-value, value), actuatorfrclimited="true")
            case _:
                self.set(element, **{name: text(value)})

    def add_fixed(self, parent: str, name: str, position: Array, inertial: Inertial | None) -> None:
        body = ET.SubElement(self.elements[parent], "body", name=name, pos=text(*position))
        if inertial is not None:
            ET.SubElement(body, "inertial")
        self._read()
        if inertial is not None:
            self.set_inertial(name, inertial)

    def remove_branch(self, body: str) -> list[str]:
        gone = self.branch(body)
        names = {*gone, *(joint for name in gone for joint in self.joints_above(name))}
        names |= {str(site.get("name")) for name in gone for site in self.elements[name].findall("site")}
        for section in ("equality", "tendon"):
            for element in (each for part in self.root.findall(section) for each in part.iter()):
                if names & {*element.attrib.values()}:
                    raise NotApplicable("a loop or a tendon has its end on the branch")
        drives = []
        for part in self.root.findall("actuator"):
            for drive in list(part):
                if names & {*drive.attrib.values()}:
                    part.remove(drive)
                    drives.append(str(drive.get("name")))
        parents = [self.elements[self.parents[body]]] if body in self.parents else []
        for parent in parents or self.root.findall("worldbody"):
            if self.elements[body] in list(parent):
                parent.remove(self.elements[body])
        self._read()
        return drives

    def remove_inertial(self, body: str) -> None:
        self.elements[body].remove(self._inertial(body))
        for geom in self.elements[body].findall("geom"):
            self.elements[body].remove(geom)
        self._read()

    def reverse_order(self, bodies: list[str]) -> None:
        parent = self.elements[self.parents[bodies[0]]]
        elements = [self.elements[body] for body in bodies]
        places = [list(parent).index(element) for element in elements]
        for place, element in zip(places, reversed(elements), strict=True):
            parent[place] = element
        self._read()

    def rename(self, names: dict[str, str]) -> None:
        named = [*self.elements.values(), *self.joint_elements.values()]
        for element in named:
            if element.get("name") in names:
                element.set("name", names[element.attrib["name"]])
        for element in self.root.iter():
            for key in REFERENCES:
                if element.get(key) in names:
                    element.set(key, names[element.attrib[key]])
        self._read()

    def drives(self, joint: str) -> list[ET.Element]:
        """Return the actuators that act on a joint."""
        return [each for part in self.root.findall("actuator") for each in part if each.get("joint") == joint]

    def reverse_drives(self, joint: str) -> None:
        self._refuse_coupled(joint)
        for drive in self.drives(joint):
            gear = self.model.actuator(str(drive.get("name"))).gear
            self.set(drive, gear=text(*-gear))

    def is_servo_driven(self, joint: str) -> bool:
        self._refuse_coupled(joint)
        bias = self.model.actuator_biastype
        servos = [bias[self.model.actuator(str(each.get("name"))).id] for each in self.drives(joint)]
        return any(servos) or self.number(joint, "stiffness") != 0.0

    def can_be_driven(self, joint: str) -> bool:
        return bool(self.drives(joint))

    def _refuse_coupled(self, joint: str) -> None:
        """Raise `NotApplicable` for a joint of a coupling or a tendon, or with a spring."""
        for section in ("equality", "tendon"):
            for element in (each for part in self.root.findall(section) for each in part.iter()):
                if joint in element.attrib.values():
                    raise NotApplicable(f"{joint} is coupled")
        if self.number(joint, "stiffness"):
            raise NotApplicable(f"{joint} has a spring")

    def _inertial(self, body: str) -> ET.Element:
        """Return the <inertial> of a body."""
        found = self.elements[body].find("inertial")
        if found is None:
            raise NotApplicable(f"{body} has no <inertial>")
        return found


def _rotation(quaternion: Array) -> Array:
    """Return the rotation matrix (3, 3) of a quaternion (w, x, y, z)."""
    matrix = np.zeros(9)
    mujoco.mju_quat2Mat(matrix, quaternion)
    return matrix.reshape(3, 3)
