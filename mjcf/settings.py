"""Numbers of an MJCF file of which the description of a robot has no model, such as compensation of gravity.

In: a compiled model, and what the description of its robot covers. Out: the other numbers in the terms of the
file, for `Robot.settings`.
"""

from __future__ import annotations

from collections.abc import Collection
from typing import NamedTuple

import mujoco
import numpy as np

from mjcf.loops import fixed_tendon_weights
from mjcf.placements import rotation_of, site_place
from newton_euler.reading.names import body_names, unique_names
from newton_euler.reading.robot import FileDrive, FilePlace, PlaceKind, Placement, Setting, SettingValue
from newton_euler.scalars import Array


class Names(NamedTuple):
    """Names of the elements of a model by number, also of those without name; body 0 is the ground."""

    bodies: tuple[str, ...]
    joints: tuple[str, ...]
    tendons: tuple[str, ...]
    equalities: tuple[str, ...]

    @staticmethod
    def of(model: mujoco.MjModel) -> Names:
        """Collect the names of a model."""
        bodies = body_names([model.body(number).name for number in range(1, model.nbody)])
        joints = [model.joint(number).name for number in range(model.njnt)]
        tendons = [model.tendon(number).name for number in range(model.ntendon)]
        equalities = [model.equality(number).name for number in range(model.neq)]
        return Names(
            ("world", *bodies),
            tuple(unique_names(joints, [bodies[body - 1] for body in model.jnt_bodyid])),
            tuple(unique_names(tendons, (f"tendon {k}" for k in range(1, model.ntendon + 1)))),
            tuple(unique_names(equalities, (f"equality {k}" for k in range(1, model.neq + 1)))),
        )


def settings(
    model: mujoco.MjModel,
    names: Names,
    equalities: Collection[int],
    springs: Collection[int],
    drives: Collection[FileDrive],
    switched_off: Collection[str],
) -> dict[Setting, SettingValue]:
    """Return the numbers that the description of a robot has no model for.

    Args:
        model: the compiled model.
        names: names of its elements.
        equalities: numbers of the active equalities that are not described.
        springs: numbers of the tendons that are described as springs.
        drives: the described actuators, in the order of the model.
        switched_off: what the option flags of the model switch off, such as "limit".
    """
    found: dict[Setting, SettingValue] = {}
    if "actuation" in switched_off:
        found[Setting("model", "", "flag actuation")] = "disable"
    if model.opt.density or model.opt.viscosity:
        for name in ("density", "viscosity", "wind"):
            found |= _numbers("model", "", name, np.atleast_1d(getattr(model.opt, name)), exerts=True)
    for count, name in ((model.nflex, "number of flexible bodies"), (model.nplugin, "number of plugins")):
        found |= _numbers("model", "", name, np.array([count]), exerts=True)
    compensated = np.flatnonzero(model.body_gravcomp).tolist()
    for number in compensated:
        factor = model.body_gravcomp[[number]]
        found |= _numbers("body", names.bodies[number], "gravcomp", factor, exerts=True)
    for number, name in enumerate(names.joints):
        dof = model.jnt_dofadr[number]
        for what, factors in (
            ("polynomial of the stiffness", model.jnt_stiffnesspoly[number]),
            ("polynomial of the damping", model.dof_dampingpoly[dof]),
            ("springyield", model.jnt_springyield[[number]]),
        ):
            found |= _numbers("joint", name, what, factors, exerts=True)
        if compensated:
            found |= _numbers("joint", name, "actuatorgravcomp", model.jnt_actgravcomp[[number]])
    for number in equalities:
        key = Setting("equality", names.equalities[number], "coefficients", exerts=True)
        found[key] = tuple(model.eq_data[number, :5].tolist())
        if model.eq_type[number] == mujoco.mjtEq.mjEQ_TENDON:
            for which, end in (("first", model.eq_obj1id[number]), ("second", model.eq_obj2id[number])):
                if end >= 0:
                    found[key._replace(name=f"{which} tendon", exerts=False)] = names.tendons[end]
    for number in sorted(_tendons(model, equalities, springs, drives)):
        found |= _tendon(model, names, number, number in springs, switched_off)
    return found


def _tendons(
    model: mujoco.MjModel,
    equalities: Collection[int],
    springs: Collection[int],
    drives: Collection[FileDrive],
) -> set[int]:
    """Return the numbers of the tendons with numbers that are not described; arguments as in `settings`."""
    acts = np.any(
        [
            model.tendon_frictionloss,
            model.tendon_armature,
            model.tendon_limited,
            model.tendon_actfrclimited,
            model.tendon_springyield,
        ],
        axis=0,
    )
    has_spring = np.any(
        [
            model.tendon_stiffness,
            model.tendon_damping,
            *model.tendon_stiffnesspoly.T,
            *model.tendon_dampingpoly.T,
        ],
        axis=0,
    )
    has_spring[list(springs)] = False
    found = {*np.flatnonzero(acts | has_spring).tolist()}
    for number in equalities:
        if model.eq_type[number] == mujoco.mjtEq.mjEQ_TENDON:
            found |= {int(end[number]) for end in (model.eq_obj1id, model.eq_obj2id) if end[number] >= 0}
    for number, drive in enumerate(drives):
        if model.actuator_trntype[number] == mujoco.mjtTrn.mjTRN_TENDON and not drive.gears:
            found.add(int(model.actuator_trnid[number, 0]))
    return found


def _tendon(
    model: mujoco.MjModel, names: Names, number: int, is_spring: bool, switched_off: Collection[str]
) -> dict[Setting, SettingValue]:
    """Return the numbers of a tendon.

    Args:
        model: the compiled model.
        names: names of its elements.
        number: number of the tendon.
        is_spring: whether its spring, its damper and its points are described.
        switched_off: as in `settings`.
    """
    name = names.tendons[number]
    found = _numbers("tendon", name, "armature", model.tendon_armature[[number]], exerts=True)
    if "frictionloss" not in switched_off:
        found |= _numbers("tendon", name, "frictionloss", model.tendon_frictionloss[[number]], exerts=True)
    if model.tendon_limited[number] and "limit" not in switched_off:
        found |= _numbers("tendon", name, "range", model.tendon_range[number])
    if model.tendon_actfrclimited[number]:
        found |= _numbers("tendon", name, "actuatorfrcrange", model.tendon_actfrcrange[number])
    found |= _numbers("tendon", name, "springyield", model.tendon_springyield[[number]], exerts=True)
    if is_spring:
        return found
    for quantity, flag in (("stiffness", "spring"), ("damping", "damper")):
        linear, others = (getattr(model, f"tendon_{quantity}{end}")[number] for end in ("", "poly"))
        if flag not in switched_off:
            found |= _numbers("tendon", name, quantity, np.append(linear, others), exerts=True)
    if model.tendon_stiffness[number]:
        found |= _numbers("tendon", name, "springlength", model.tendon_lengthspring[number])
    weights = fixed_tendon_weights(model, number)
    if weights is not None:
        for joint, weight in weights.items():
            found[Setting("tendon", name, "coefficient", joint=names.joints[joint])] = (weight,)
        return found
    return found | _path(model, name, number)


def _path(model: mujoco.MjModel, name: str, number: int) -> dict[Setting, SettingValue]:
    """Return the points, shapes and pulleys of a spatial tendon, by its name and number."""
    found: dict[Setting, SettingValue] = {}
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
    frame = Placement(model.geom_pos[number].copy(), rotation_of(model.geom_quat[number]))
    return FilePlace(kind, int(model.geom_bodyid[number]) - 1, frame)


def _numbers(
    kind: str, element: str, name: str, values: Array, exerts: bool = False
) -> dict[Setting, SettingValue]:
    """Return numbers under the name of their setting, see `Setting`; nothing if all of them are zero."""
    return {Setting(kind, element, name, exerts): tuple(values.tolist())} if np.any(values) else {}
