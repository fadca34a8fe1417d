"""Read the transmissions of a URDF: which actuators drive which joints, with which reductions and interfaces.

ROS controllers read them, in `<transmission>` of the robot or of `<ros2_control>`. Engines ignore them: they
have no effect on the simulated motion.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Iterator

from newton_euler.reading.robot import FileTransmission, TransmissionEnd
from urdf.reading.vocabulary import tag_of

REDUCTION_TAGS = ("mechanicalReduction", "mechanical_reduction")
"""Names of a reduction, an element or an attribute, in ROS 1 and in ROS 2."""

MAX_NAMED = 3
"""Largest number of elements that a note names."""


def read_transmissions(root: ET.Element, notes: list[str]) -> tuple[FileTransmission, ...]:
    """Return the transmissions of a checked URDF.

    Args:
        root: root element.
        notes: list that receives joints that do not exist and numbers that are none.
    """
    known = {str(joint.get("name")) for joint in root.findall("joint")}
    wrong: list[str] = []
    elements = (*root.findall("transmission"), *root.findall("ros2_control/transmission"))
    transmissions = tuple(_transmission(element, wrong) for element in elements)
    lost = [
        f"{joint.name!r:.100} of transmission {transmission.name!r:.100}"
        for transmission in transmissions
        for joint in transmission.joints
        if joint.name not in known
    ]
    if lost:
        notes.append(f"no such joint: {_named(lost)}")
    if wrong:
        notes.append(f"no finite number: {_named(wrong)}")
    return transmissions


def _named(texts: list[str]) -> str:
    """Return the first texts of some, and the number of others."""
    more = f" and {len(texts) - MAX_NAMED} more" if len(texts) > MAX_NAMED else ""
    return f"{', '.join(texts[:MAX_NAMED])}{more}"


def _transmission(element: ET.Element, wrong: list[str]) -> FileTransmission:
    """Return the transmission of an element; `wrong` receives numbers that are none."""
    name = element.get("name", "")
    kind = element.get("type") or next(
        (_text(part) for part in element if tag_of(part) in ("type", "plugin")), ""
    )
    # roles, not the order of elements, tell the ends of a transmission with several joints apart
    parts = sorted((part for part in element if part.get("name")), key=lambda part: part.get("role", ""))
    actuators = [part for part in parts if tag_of(part).lower().endswith("actuator")]
    joints = [part for part in parts if tag_of(part).lower().endswith("joint")]
    interfaces: list[set[str]] = [{*_interfaces(joint)} for joint in joints]
    for number, actuator in enumerate(actuators[: None if joints else 0]):
        interfaces[min(number, len(joints) - 1)].update(_interfaces(actuator))
    where = f"transmission {name!r:.100}"
    ends = [
        TransmissionEnd(
            str(part.get("name")),
            _number(part, REDUCTION_TAGS, 1.0, f"{part.get('name')!r:.100} of {where}", wrong),
            _number(part, ("offset",), 0.0, f"{part.get('name')!r:.100} of {where}", wrong),
        )
        for part in (*joints, *actuators)
    ]
    return FileTransmission(
        name,
        kind,
        tuple(
            joint._replace(interfaces=tuple(sorted(names)))
            for joint, names in zip(ends[: len(joints)], interfaces, strict=True)
        ),
        tuple(ends[len(joints) :]),
        _number(element, REDUCTION_TAGS, 1.0, where, wrong),
    )


def _interfaces(end: ET.Element) -> Iterator[str]:
    """Yield the hardware interfaces of a joint or an actuator; their package may be left out."""
    for part in end:
        if tag_of(part) == "hardwareInterface":
            yield _text(part).removeprefix("hardware_interface/")


def _number(
    element: ET.Element, tags: tuple[str, ...], default: float, where: str, wrong: list[str]
) -> float | str:
    """Return a number in an element's part or attribute, as text if it is none.

    Args:
        element: transmission, or one of its ends.
        tags: names of the number.
        default: number of an element without it.
        where: the element in notes.
        wrong: receives a text that is no finite number.
    """
    texts = [element.get(tag, "").strip() for tag in tags if tag in element.attrib]
    texts += [_text(part) for part in element if tag_of(part) in tags]
    if not texts:
        return default
    try:
        number = float(texts[0])
    except ValueError:
        number = math.nan
    if math.isfinite(number):
        return number
    wrong.append(f"{tags[0]} {texts[0]!r:.100} of {where}")
    return f"{texts[0]!r:.100}"


def _text(element: ET.Element) -> str:
    """Return the text of an element without spaces around it."""
    return (element.text or "").strip()
