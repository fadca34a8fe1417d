"""Report the elements of a URDF that imported scenes do not simulate, and watch these elements in runs.

Scenes have no contacts, limits, dry friction, rotors of Pinocchio and safety controllers. The import report
lists these elements as left out. A watch tests, after a run of any engine, whether an element would have
acted.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET

from newton_euler.model.joint import Key
from newton_euler.reading.activity import Bounds, FrictionWatch, Watch
from newton_euler.reading.import_report import CONTACTS, FRICTION, LIMITS, VELOCITY_LIMITS, ImportReport
from urdf.reading.bodies import Tree
from urdf.reading.source import JointProperties
from urdf.reading.start import RobotAtStart


def _limit_watches(start: RobotAtStart, joint: JointProperties, key: Key) -> list[Watch]:
    """Return the watch of a joint's limits, a test after a run whether the limits would have acted.

    `key` is the joint's coordinate in the scene, which is zero at the start.
    """
    assert joint.limits is not None
    x_start = start.displacement(joint.name)
    low, high = joint.limits.low - x_start, joint.limits.high - x_start
    return [Bounds(terms=((key, 1.0),), low=low, high=high, unit=joint.unit)]  # the coordinate, weight 1


def _speed_watches(joint: JointProperties, key: Key) -> list[Watch]:
    """Return the watch of a joint's limit of velocity; for the arguments see `_limit_watches`."""
    assert joint.limits is not None
    speed = joint.limits.speed
    terms, unit = ((key, 1.0),), f"{joint.unit}/s"
    return [Bounds(terms, low=-speed, high=speed, unit=unit, by_value=0.0, by_rate=1.0)]


def report_joints(
    joints: list[JointProperties], start: RobotAtStart, tree: Tree, report: ImportReport
) -> None:
    """Report dry friction, limits, rotors and safety controllers of joints, which scenes do not simulate.

    The watches test, after a run, whether a limit or friction would have acted. An element whose action
    neither the file nor a run can show is not `examined`.
    """
    for joint in joints:
        element, key = f"joint {joint.name!r}", tree.coordinate_keys.get(joint.name)
        if joint.friction:
            why = f"its dry friction {joint.friction:g}"
            resting = [FrictionWatch((key,))] if key else []
            report.left_out(element, why, topic=FRICTION, watches=resting)
        if joint.limits:
            low, high, speed = joint.limits
            why = f"its limits {low:.4g} to {high:.4g}: limits are one-sided and not simulated"
            watches = _limit_watches(start, joint, key) if key else []
            report.left_out(element, why, topic=LIMITS, watches=watches)
            if math.isfinite(speed):
                why = f"its limit of velocity, {speed:.4g} {joint.unit}/s"
                watches = _speed_watches(joint, key) if key else []
                report.left_out(element, why, topic=VELOCITY_LIMITS, watches=watches)
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
