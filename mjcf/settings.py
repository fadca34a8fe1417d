"""Numbers of an MJCF file of which the description of a robot has no model, such as compensation of gravity.

In: a compiled model, and what the description of its robot covers. Out: the other numbers in the terms of the
file, for `Robot.settings`.
"""

from __future__ import annotations

from collections.abc import Collection

import mujoco
import numpy as np

from mjcf.loops import fixed_tendon_weights
from mjcf.point_springs import site_place
from newton_euler.reading.robot import FileDrive, FilePlace, PlaceKind, Placement, Setting, SettingValue
from newton_euler.scalars import Array


def settings(
    model: mujoco.MjModel,
    equalities: Collection[int],
    springs: Collection[int],
    drives: Collection[FileDrive],
) -> dict[Setting, SettingValue]:
    """Return the numbers that the description of a robot has no model for.

    Args:
        model: the compiled model.
        equalities: numbers of the active equalities that are not described.
        springs: numbers of the tendons that are described as springs.
        drives: the described actuators, in the order of the model.
    """
    found: dict[Setting, SettingValue] = {}
    if model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_ACTUATION:
        found[Setting("model", "", "flag actuation")] = "disable"
    if model.opt.density or model.opt.viscosity:
        for name in ("density", "viscosity", "wind"):
            found |= _numbers("model", "", name, np.atleast_1d(getattr(model.opt, name)), exerts=True)
    for count, name in ((model.nflex, "number of flexible bodies"), (model.nplugin, "number of plugins")):
        found |= _numbers("model", "", name, np.array([count]), exerts=True)
    for number in np.flatnonzero(model.body_gravcomp).tolist():
        name, factor = _body_name(model, number), model.body_gravcomp[[number]]
        found |= _numbers("body", name, "gravcomp", factor, exerts=True)
    for number in range(model.njnt):
        name = model.joint(number).name or _body_name(model, model.jnt_bodyid[number])
        dof = model.jnt_dofadr[number]
        for what, factors in (
            ("stiffness", model.jnt_stiffnesspoly[number]),
            ("damping", model.dof_dampingpoly[dof]),
        ):
            found |= _numbers("joint", name, f"polynomial of the {what}", factors, exerts=True)
    for number in equalities:
        name = model.equality(number).name or str(number)
        key = Setting("equality", name, "coefficients", exerts=True)
        found[key] = tuple(model.eq_data[number, :5].tolist())
    for number in sorted(_tendons(model, equalities, springs, drives)):
        found |= _tendon(model, number, is_spring=number in springs)
    return found


def _body_name(model: mujoco.MjModel, number: int) -> str:
    """Return the name of a body, or its number as `crosscheck diff` shows it, if it has no name."""
    return model.body(number).name or f"body {number}"


def _tendons(
    model: mujoco.MjModel,
    equalities: Collection[int],
    springs: Collection[int],
    drives: Collection[FileDrive],
) -> set[int]:
    """Return the numbers of the tendons with numbers that are not described; arguments as in `settings`."""
    acts = np.any([model.tendon_frictionloss, model.tendon_armature, model.tendon_limited], axis=0)
    has_spring = (model.tendon_stiffness != 0.0) | (model.tendon_damping != 0.0)
    has_spring[list(springs)] = False
    found = {*np.flatnonzero(acts | has_spring).tolist()}
    for number in equalities:
        if model.eq_type[number] == mujoco.mjtEq.mjEQ_TENDON:
            found |= {int(end[number]) for end in (model.eq_obj1id, model.eq_obj2id) if end[number] >= 0}
    for number, drive in enumerate(drives):
        if model.actuator_trntype[number] == mujoco.mjtTrn.mjTRN_TENDON and not drive.gears:
            found.add(int(model.actuator_trnid[number, 0]))
    return found


def _tendon(model: mujoco.MjModel, number: int, is_spring: bool) -> dict[Setting, SettingValue]:
    """Return the numbers of a tendon.

    Args:
        model: the compiled model.
        number: number of the tendon.
        is_spring: whether its spring, its damper and its points are described.
    """
    name = model.tendon(number).name or str(number)
    found = _numbers("tendon", name, "frictionloss", model.tendon_frictionloss[[number]], exerts=True)
    found |= _numbers("tendon", name, "armature", model.tendon_armature[[number]], exerts=True)
    if model.tendon_limited[number]:
        found |= _numbers("tendon", name, "range", model.tendon_range[number])
    if is_spring:
        return found
    for quantity in ("stiffness", "damping"):
        linear, others = (getattr(model, f"tendon_{quantity}{end}")[number] for end in ("", "poly"))
        found |= _numbers("tendon", name, quantity, np.append(linear, others), exerts=True)
    if model.tendon_stiffness[number]:
        found |= _numbers("tendon", name, "springlength", model.tendon_lengthspring[number])
    weights = fixed_tendon_weights(model, number)
    if weights is not None:
        for joint, weight in weights.items():
            what = f"coefficient of {model.joint(joint).name!r}"
            found |= _numbers("tendon", name, what, np.array([weight]))
        return found
    first, count = int(model.tendon_adr[number]), int(model.tendon_num[number])
    for place, wrap in enumerate(range(first, first + count), start=1):
        kind, index = mujoco.mjtWrap(model.wrap_type[wrap]), int(model.wrap_objid[wrap])
        if kind == mujoco.mjtWrap.mjWRAP_SITE:
            found[Setting("tendon", name, f"point {place}")] = site_place(model, index, PlaceKind.POINT)
        elif kind == mujoco.mjtWrap.mjWRAP_PULLEY:
            divisor = np.array([model.wrap_prm[wrap]])
            found |= _numbers("tendon", name, f"divisor of pulley {place}", divisor)
        else:
            found[Setting("tendon", name, f"shape {place}")] = _shape_place(model, index, kind)
            found |= _numbers("tendon", name, f"radius of shape {place}", model.geom_size[index, :1])
            side = round(model.wrap_prm[wrap])
            if side >= 0:
                key = Setting("tendon", name, f"side site of shape {place}")
                found[key] = site_place(model, side, PlaceKind.POINT)
    return found


def _shape_place(model: mujoco.MjModel, number: int, wrap: mujoco.mjtWrap) -> FilePlace:
    """Return the center of a sphere, or the axis of a cylinder, around which a tendon wraps."""
    kind = PlaceKind.POINT if wrap == mujoco.mjtWrap.mjWRAP_SPHERE else PlaceKind.LINE
    rotation = np.zeros(9)
    mujoco.mju_quat2Mat(rotation, model.geom_quat[number])
    frame = Placement(model.geom_pos[number].copy(), rotation.reshape(3, 3))
    return FilePlace(kind, int(model.geom_bodyid[number]) - 1, frame)


def _numbers(
    kind: str, element: str, name: str, values: Array, exerts: bool = False
) -> dict[Setting, SettingValue]:
    """Return numbers under the name of their setting, see `Setting`; nothing if all of them are zero."""
    return {Setting(kind, element, name, exerts): tuple(values.tolist())} if np.any(values) else {}
