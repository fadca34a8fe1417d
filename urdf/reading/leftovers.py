"""Report the elements of a URDF that imported scenes do not simulate.

Scenes have no contacts, rotors of Pinocchio and safety controllers. The import report lists these elements as
left out.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET

from newton_euler.reading.import_report import CONTACTS, ImportReport
from urdf.reading.source import JointProperties


def report_joints(joints: list[JointProperties], report: ImportReport) -> None:
    """Report rotors and safety controllers of joints, which scenes do not simulate.

    An element whose action neither the file nor a run can show is not `examined`.
    """
    for joint in joints:
        element = f"joint {joint.name!r}"
        if joint.rotor:
            why = f"its rotor, rotorInertia times rotorGearRatio^2 of {joint.rotor:g}"
            remedy = "Pinocchio's dynamics use model.armature only; add the inertia there"
            report.left_out(element, f"{why}: {remedy}", topic="rotor")
        if joint.has_safety:
            why = "its safety controller, a program outside of the model"
            report.left_out(element, why, topic="safety controller", examined=False)


def report_collisions(root: ET.Element, report: ImportReport) -> None:
    """Report the collision elements of a URDF: contacts are not simulated."""
    if touching := root.findall("link/collision"):
        why = "contacts are not simulated; a URDF does not define which bodies may touch, an MJCF does"
        report.left_out(f"{len(touching)} collision elements", why, topic=CONTACTS, examined=False)
