"""What a URDF says of the elements that a scene does not hold as they are, in numbers."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET

import pinocchio as pin

from newton_euler.model.joint import Key
from newton_euler.verification.import_report import FRICTION, RANGE, Part, Value, value
from urdf.reading.bodies import GROUND, Tree
from urdf.reading.start import Start
from urdf.reading.visuals import origin


class Held:
    """Parts of import reports."""

    def __init__(self, start: Start, tree: Tree) -> None:
        self._start, self._tree = start, tree
        frames = enumerate(start.model.frames)
        self._frames = {frame.name: k for k, frame in frames if frame.type == pin.FrameType.BODY}
        self._moved = pin.difference(start.model, pin.neutral(start.model), start.q)

    def joint(self, joint: ET.Element, tag: str, *names: str) -> Part:
        """Attributes of a part of a joint; all that it has if none are named."""
        name, part = str(joint.get("name")), joint.find(tag)
        attributes = {} if part is None else part.attrib
        told = {key: _number(attributes.get(key, "0")) for key in names or sorted(attributes)}
        return Part(f"joint {name!r}", told, self.keys(name))

    def limits(self, joint: ET.Element) -> Part:
        """Of a hinge or slide, how far it may go from where it starts."""
        found = self.joint(joint, "limit", "lower", "upper", "effort", "velocity")
        place = self._start.place(str(joint.get("name")))
        at = 0.0 if place is None else float(self._moved[place])
        low, high = (found.values.pop(name)[0] for name in ("lower", "upper"))
        own = {RANGE: value([float(low) - at, float(high) - at])}
        return Part(found.element, own | found.values, found.joints)

    def friction(self, joint: ET.Element) -> Part:
        """Dry friction of a joint."""
        found = self.joint(joint, "dynamics", "friction")
        return Part(found.element, {FRICTION: found.values["friction"]}, found.joints)

    def keys(self, *names: str) -> tuple[Key, ...]:
        """The scene's coordinates of joints, as far as it has any."""
        return tuple(self._tree.keys[name] for name in names if name in self._tree.keys)

    def collision(self, link: ET.Element, number: int, element: ET.Element) -> Part:
        """Its shape, and where it is."""
        name = str(link.get("name"))
        told: dict[str, Value] = {}
        for shape in element.findall("geometry/*"):
            told["type"] = value(shape.tag)
            told |= {key: _number(text) for key, text in sorted(shape.attrib.items())}
        frame = self._frames.get(name)
        body = None
        if frame is not None:
            pose = self._start.data.oMf[frame] * origin(element.find("origin"))
            told |= {"pos": value(pose.translation), "axes": value(pose.rotation)}
            body = self._tree.names[self._start.model.frames[frame].parentJoint]
        own = element.get("name") or f"{number + 1} of link {name!r}"
        return Part(f"collision {own}", told, (), (body or GROUND,))


def _number(text: str) -> Value:
    """The numbers of an attribute, or its text."""
    try:
        numbers = [float(word) for word in text.split()]
    except ValueError:
        return value(text)
    return value(numbers) if numbers and all(map(math.isfinite, numbers)) else value(text)
