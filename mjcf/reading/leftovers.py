"""What a compiled model holds beyond rigid bodies and bilateral constraints: listed, not compared."""

from __future__ import annotations

import numpy as np

from mjcf.reading.joints import Joints
from mjcf.reading.start import Start
from newton_euler.mapping import Mapping

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


def report_leftovers(start: Start, joints: Joints, report: Mapping) -> None:
    """Tell of everything else in the model."""
    model = start.model
    colliding = int(np.sum((model.geom_contype != 0) | (model.geom_conaffinity != 0)))
    if colliding:
        report.left_out(f"{colliding} geoms that can touch", "contacts are no bilateral constraints")
    if model.npair:
        report.left_out(f"{model.npair} contact pairs", "contacts are no bilateral constraints")
    meshes = int(np.sum(model.geom_dataid >= 0))
    if meshes:
        report.exactly(f"{meshes} geoms of meshes", "drawn where visible; their masses are in the bodies")
    for number in range(model.njnt):
        _report_joint(start, joints, number, report)
    for tendon in range(model.ntendon):
        element = f"tendon {model.tendon(tendon).name or tendon!r}"
        if model.tendon_limited[tendon]:
            report.left_out(element, "its limits: limits are no bilateral constraints")
        if model.tendon_frictionloss[tendon]:
            report.left_out(element, f"its dry friction {model.tendon_frictionloss[tendon]:g}")
    option = model.opt
    for name, value in (("density", option.density), ("viscosity", option.viscosity)):
        if value:
            report.left_out(f"option {name}", f"{value:g}: nothing here moves in a fluid")
    if np.any(option.wind):
        report.left_out("option wind", "nothing here moves in a fluid")
        start.differ(option.wind, slice(None))
    if model.nflex:
        report.left_out(
            f"{model.nflex} flexes", "bodies are rigid: what holds their points together is missing"
        )
        for array in (model.flex_stiffness, model.flex_bending, model.flex_edgestiffness):
            start.differ(array, slice(None))
    if model.nplugin:
        report.left_out(f"{model.nplugin} plugins", "what they do is not known")
    if model.nkey > 1:
        names = ", ".join(repr(model.key(k).name or str(k)) for k in range(model.nkey))
        report.left_out("other keyframes", f"one is the start; --set key=NAME for another of {names}")
    for prefix, what in UNSEEN.items():
        count = int(getattr(model, f"n{prefix}"))
        if count:
            report.left_out(f"{count} {what}", "they move nothing")
    report.left_out("options of solver and integrator", "every engine has its own")


def _report_joint(start: Start, joints: Joints, number: int, report: Mapping) -> None:
    model, element = start.model, joints.element(number)
    if model.jnt_limited[number]:
        low, high = model.jnt_range[number]
        where = ""
        if number in joints.keys:
            x = float(start.data.qpos[model.jnt_qposadr[number]])
            where = "" if low <= x <= high else f"; the start is outside of them, at {x:.4g}"
        why = f"its limits {low:.4g} to {high:.4g}{where}: limits are no bilateral constraints"
        report.left_out(element, why)
    dof = int(model.jnt_dofadr[number])
    if model.dof_frictionloss[dof]:
        report.left_out(element, f"its dry friction {model.dof_frictionloss[dof]:g}")
