"""Elements beyond rigid bodies and bilateral constraints: listed, not compared."""

from __future__ import annotations

import mujoco
import numpy as np

from mjcf.reading.bodies import Bodies
from mjcf.reading.joints import Joints
from mjcf.reading.loops import fixed
from mjcf.reading.poses import Poses, Stretched, Touching
from mjcf.reading.start import Start
from newton_euler.verification.activity import Bounds, Rest, Watch
from newton_euler.verification.import_report import CONTACTS, FRICTION, LIMITS, ImportReport

UNSEEN = {
    "sensor": "sensors",
    "cam": "cameras",
    "light": "lights",
    "skin": "skins",
    "text": "texts",
    "numeric": "numbers",
    "tuple": "tuples",
}
"""Elements that do not move anything."""


NO_CONTACTS = "contacts are no bilateral constraints"


def report_leftovers(start: Start, bodies: Bodies, joints: Joints, report: ImportReport) -> None:
    """Tell of everything else in the model."""
    model = start.model
    poses = Poses(start, bodies)
    _report_contacts(start, poses, report)
    meshes = int(np.sum(model.geom_dataid >= 0))
    if meshes:
        report.exactly(f"{meshes} geoms of meshes", "drawn where visible; their masses are in the bodies")
    for number in range(model.njnt):
        _report_joint(start, joints, number, report)
    for tendon in range(model.ntendon):
        element = f"tendon {model.tendon(tendon).name or tendon!r}"
        if model.tendon_limited[tendon]:
            why, off = "its limits: limits are no bilateral constraints", start.disabled("LIMIT")
            watches = [_of_tendon(start, joints, poses, tendon)]
            report.left_out(element, why, topic=LIMITS, inert=off, watches=watches)
        if model.tendon_frictionloss[tendon]:
            why, off = (
                f"its dry friction {model.tendon_frictionloss[tendon]:g}",
                start.disabled("FRICTIONLOSS"),
            )
            keys = [joints.keys.get(joint) for joint in fixed(start, tendon) or {-1: 0.0}]
            watches_of = [Rest(tuple(key for key in keys if key))] if all(keys) else []
            report.left_out(element, why, topic=FRICTION, inert=off, watches=watches_of)
    option = model.opt
    for name, number in (("density", option.density), ("viscosity", option.viscosity)):
        if number:
            why = f"{number:g}: nothing here moves in a fluid"
            report.left_out(f"option {name}", why, topic=name)
    if np.any(option.wind):
        report.left_out("option wind", "nothing here moves in a fluid")
    if model.nflex:
        why = "bodies are rigid: what holds their points together is missing"
        report.left_out(f"{model.nflex} flexes", why)
    if model.nplugin:
        report.left_out(f"{model.nplugin} plugins", "what they do is not known")
    if model.nkey > 1:
        names = ", ".join(repr(model.key(k).name or str(k)) for k in range(model.nkey))
        why = f"one is the start; --set key=NAME for another of {names}"
        report.left_out("other keyframes", why, inert=True)
    for prefix, what in UNSEEN.items():
        count = int(getattr(model, f"n{prefix}"))
        if count:
            report.left_out(f"{count} {what}", "they move nothing", inert=True)
    report.left_out("options of solver and integrator", "every engine has its own", inert=True)


def _of_tendon(start: Start, joints: Joints, poses: Poses, tendon: int) -> Watch:
    """Watches the limits of a tendon."""
    model, weights = start.model, fixed(start, tendon)
    if weights is None or any(joint not in joints.keys for joint in weights):
        return Stretched(poses, tendon)
    low, high = (float(x) for x in model.tendon_range[tendon])
    margin, length = float(model.tendon_margin[tendon]), float(start.data.ten_length[tendon])
    terms = tuple((joints.keys[joint], weight) for joint, weight in weights.items())
    return Bounds(terms, low + margin, high - margin, "m or rad", length)


def _report_contacts(start: Start, poses: Poses, report: ImportReport) -> None:
    model, off = start.model, start.disabled("CONTACT")
    touching = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
    if np.any(touching):
        element = f"{np.sum(touching)} geoms that can touch"
        watches = [Touching(poses)]
        report.left_out(element, NO_CONTACTS, topic=CONTACTS, inert=off, watches=watches)
    if model.npair:
        element = f"{model.npair} contact pairs"
        watches = [Touching(poses)]
        report.left_out(element, NO_CONTACTS, topic=CONTACTS, inert=off, watches=watches)


def _report_joint(start: Start, joints: Joints, number: int, report: ImportReport) -> None:
    model, element = start.model, joints.element(number)
    if model.jnt_limited[number]:
        low, high = model.jnt_range[number]
        where, watches = "", list[Watch]()
        if number in joints.keys:
            x = float(start.data.qpos[model.jnt_qposadr[number]])
            where = "" if low <= x <= high else f"; the start is outside of them, at {x:.4g}"
            unit = "m" if model.jnt_type[number] == mujoco.mjtJoint.mjJNT_SLIDE else "rad"
            margin = float(model.jnt_margin[number])
            watches.append(Bounds(((joints.keys[number], 1.0),), low + margin, high - margin, unit, x))
        why = f"its limits {low:.4g} to {high:.4g}{where}: limits are no bilateral constraints"
        off = start.disabled("LIMIT")
        report.left_out(element, why, topic=LIMITS, inert=off, watches=watches)
    dof = int(model.jnt_dofadr[number])
    if friction := float(model.dof_frictionloss[dof]):
        off = start.disabled("FRICTIONLOSS")
        why, key = f"its dry friction {friction:g}", joints.keys.get(number)
        resting = [Rest((key,))] if key else []
        report.left_out(element, why, topic=FRICTION, inert=off, watches=resting)
