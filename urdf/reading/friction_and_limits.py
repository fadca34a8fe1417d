"""Import or leave out the dry friction and the limits of joints, for `urdf.reader`.

Friction and limits of a URDF are ideal. On request, a scene has them as forces, with the softness of
`newton_euler.reading.approximations` and the inertia that the coordinate has at the start of the scene.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

from newton_euler.model.scene import Scene
from newton_euler.model.source_file import Request
from newton_euler.model.switched_forces import SwitchedElement
from newton_euler.reading.activity import Bounds, FrictionWatch
from newton_euler.reading.approximations import (
    DEFAULT_SOFTNESS,
    JointInFile,
    compliant,
    effective_inertias,
    regularized,
)
from newton_euler.reading.import_report import FRICTION, LIMITS, VELOCITY_LIMITS, ImportReport
from urdf.reading.bodies import Tree
from urdf.reading.source import JointProperties
from urdf.reading.start import RobotAtStart


def friction_and_limits(
    joints: list[JointProperties],
    start: RobotAtStart,
    tree: Tree,
    scene: Scene,
    request: Request,
    report: ImportReport,
) -> Iterator[SwitchedElement]:
    """Yield dry friction and stops of all joints that the options ask for, and report all of them.

    Friction and limits that are not simulated get watches, which test a run of any engine. Limits of velocity
    are never simulated.

    Args:
        joints: properties of the joints in the file.
        start: Pinocchio's model of the file, at the start state of the scene.
        tree: imported bodies and joints of the tree.
        scene: scene without dry friction and stops.
        request: options of the scene.
        report: report that receives the entries.
    """
    keys = {joint.name: tree.coordinate_keys.get(joint.name) for joint in joints}
    has_friction, has_stops = request.friction == "regularized", request.limits == "compliant"
    soft = [
        key
        for joint in joints
        if (key := keys[joint.name]) and ((joint.friction and has_friction) or (joint.limits and has_stops))
    ]
    inertias = effective_inertias(scene, soft) if soft else {}
    for joint in joints:
        element, key = f"joint {joint.name!r}", keys[joint.name]
        inertia = math.nan if key is None else inertias.get(key, math.nan)
        if joint.friction:
            why = f"its dry friction {joint.friction:g}"
            if has_friction and key:
                in_file = JointInFile(element, key, joint.unit, inertia, DEFAULT_SOFTNESS)
                yield from regularized(in_file, joint.friction, report)
            else:
                resting = [FrictionWatch((key,))] if key else []
                report.left_out(element, why, topic=FRICTION, watches=resting)
        if joint.limits:
            low, high, speed = joint.limits
            words = f"its limits {low:.4g} to {high:.4g}"
            bounds = None
            if key:  # of the file's coordinate: that of the scene is zero at the start
                x_start = start.displacement(joint.name)
                bounds = Bounds(((key, 1.0),), low, high, joint.unit, constant=x_start)
            if has_stops and bounds and key:
                in_file = JointInFile(element, key, joint.unit, inertia, DEFAULT_SOFTNESS)
                yield from compliant(in_file, bounds, words, report)
            else:
                why = f"{words}: limits are one-sided and not simulated"
                report.left_out(element, why, topic=LIMITS, watches=[bounds] if bounds else [])
            if math.isfinite(speed):
                why = f"its limit of velocity, {speed:.4g} {joint.unit}/s"
                watches = [_speed_bounds(joint, key, speed)] if key else []
                report.left_out(element, why, topic=VELOCITY_LIMITS, watches=watches)


def _speed_bounds(joint: JointProperties, key: tuple[str, int], speed: float) -> Bounds:
    """Return the watch of a joint's limit of velocity, a test after a run whether it would have acted."""
    terms, unit = ((key, 1.0),), f"{joint.unit}/s"
    return Bounds(terms, low=-speed, high=speed, unit=unit, by_value=0.0, by_rate=1.0)
