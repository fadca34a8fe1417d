"""Reports of readings against a compiled MJCF file, element by element.

For `mjcf.original`: names of elements are all that is shared with the reading.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import mujoco
import numpy as np

from newton_euler.scalars import Array
from newton_euler.verification.import_report import CONTACTS, FRICTION, LIMITS, ImportReport


def name_of(model: Any, kind: str, number: int) -> str:
    """The name of an element in reports."""
    return f"{kind} {getattr(model, kind)(number).name or number!r}"


def unaccounted(model: Any, roots: Sequence[int], report: ImportReport) -> Iterator[str]:
    """Elements that a report says nothing of, or not what is outside of rigid dynamics.

    Args:
        model: as MuJoCo compiled it.
        roots: bodies with joints of their own.
        report: of a reading.
    """
    topics = {(entry.element, entry.topic) for entry in report.entries}
    told = {element for element, _ in topics}
    counts = {"joint": model.njnt, "equality": model.neq, "actuator": model.nactuator}
    for kind, count in counts.items():
        yield from (name for k in range(count) if (name := name_of(model, kind, k)) not in told)
    for k in roots:
        if name_of(model, "body", k) not in told:
            yield name_of(model, "body", k)
    for tendon in range(model.ntendon):
        acts = [model.tendon_stiffness, model.tendon_damping, model.tendon_armature]
        name = name_of(model, "tendon", tendon)
        if any(values[tendon] for values in acts) and name not in told:
            yield name
    frictions = model.dof_frictionloss[model.jnt_dofadr]
    for kind, limited, friction in (
        ("joint", model.jnt_limited, frictions),
        ("tendon", model.tendon_limited, model.tendon_frictionloss),
    ):
        for topic, has in ((LIMITS, limited), (FRICTION, friction)):
            for k in np.flatnonzero(has).tolist():
                yield from _told(name_of(model, kind, k), topic, topics)
    yield from _limits_of_forces(model, topics, without_force(report))
    touching = np.any(model.geom_contype) or np.any(model.geom_conaffinity) or model.npair
    if touching and CONTACTS not in {topic for _, topic in topics}:
        yield "contacts"


def without_force(report: ImportReport) -> set[str]:
    """Elements that a report says are left out with all that they do."""
    return {entry.element for entry in report.of("left out") if not entry.topic}


def _limits_of_forces(model: Any, topics: set[tuple[str, str]], known: set[str]) -> Iterator[str]:
    """Limits of forces that are no topics of a report; `known` are elements that need none."""
    on_tendons = model.actuator_trntype == mujoco.mjtTrn.mjTRN_TENDON
    on_joints = np.isin(
        model.actuator_trntype, [mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_JOINTINPARENT]
    )
    for k, target in enumerate(model.actuator_trnid[:, 0].tolist()):
        name = name_of(model, "actuator", k)
        if name in known:
            continue
        if model.actuator_forcelimited[k]:
            yield from _told(name, "limit of the force", topics)
        if on_tendons[k] and model.tendon_actfrclimited[target]:
            yield from _told(name, "limit of its tendon", topics)
        joints = [target] if on_joints[k] else []
        if on_tendons[k]:
            wraps = slice(model.tendon_adr[target], model.tendon_adr[target] + model.tendon_num[target])
            joints = model.wrap_objid[wraps][model.wrap_type[wraps] == mujoco.mjtWrap.mjWRAP_JOINT].tolist()
        for joint in joints:
            if model.jnt_actfrclimited[joint]:
                yield from _told(name_of(model, "joint", joint), "limit of actuator forces", topics)


def _told(element: str, topic: str, topics: set[tuple[str, str]]) -> Iterator[str]:
    if (element, topic) not in topics:
        yield f"{element}: {topic}"


def switch_off(model: Any, kind: str, k: int, topic: str) -> None:
    """Switch off what a report says is left out of element number k of a kind other than equalities."""
    match kind, topic:
        case "joint", "not linear":
            model.jnt_stiffnesspoly[k] = 0.0
            model.dof_dampingpoly[model.dof_jntid == k] = 0.0
        case "joint", "limit of actuator forces":
            model.jnt_actfrclimited[k] = 0
        case "tendon", "not linear":
            model.tendon_stiffnesspoly[k] = model.tendon_dampingpoly[k] = 0.0
        case "tendon", "armature":
            model.tendon_armature[k] = 0.0
        case "tendon", "":
            model.tendon_stiffness[k] = model.tendon_damping[k] = 0.0
            model.tendon_stiffnesspoly[k] = model.tendon_dampingpoly[k] = 0.0
        case "actuator", "":
            model.actuator_gainprm[k] = model.actuator_biasprm[k] = model.actuator_gear[k] = 0.0
            model.actuator_armature[k] = 0.0
            model.actuator_damping[k] = model.actuator_dampingpoly[k] = 0.0
        case "actuator", "damping":
            model.actuator_damping[k] = model.actuator_dampingpoly[k] = 0.0
        case "actuator", "limit of the force":
            model.actuator_forcelimited[k] = 0
        case "actuator", "limit of its tendon":
            model.tendon_actfrclimited[model.actuator_trnid[k, 0]] = 0
        case _, "density" | "viscosity":
            setattr(model.opt, topic, 0.0)
        case "option wind", _:
            model.opt.wind[:] = 0.0
        case _ if kind.endswith("flexes"):
            for field in ("stiffness", "bending", "edgestiffness", "damping", "edgedamping"):
                getattr(model, f"flex_{field}")[:] = 0.0


def straighten(model: Any, equality: int, start: Array) -> None:
    """Replace a polynomial of joint coordinates by its tangent at a start (nq,)."""
    driver = int(model.eq_obj2id[equality])
    place = model.jnt_qposadr[driver]
    x = float(start[place] - model.qpos0[place])
    whole = np.polynomial.Polynomial(model.eq_data[equality, :5])
    slope = float(whole.deriv()(x))
    model.eq_data[equality, :5] = [float(whole(x)) - slope * x, slope, 0.0, 0.0, 0.0]
