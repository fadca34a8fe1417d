"""Dry friction and limits of a compiled MuJoCo model as forces, from MuJoCo's own constraint rows.

`mjcf.reference` verifies with these forces what `mjcf.reading.friction_and_limits` imports. The reader
computes the softness of friction and limits from `solref` and `solimp`; this module takes the numbers of the
rows in which MuJoCo simulates them, at a configuration in which all limits are exceeded.
"""

from __future__ import annotations

import copy
from typing import Any

import mujoco
import numpy as np

from mjcf.layout import element_name
from newton_euler.reading.friction_and_stops import (
    STICK_TIME,
    STOP_DISSIPATION,
    STOP_RATE,
    FrictionAndStops,
)
from newton_euler.reading.import_report import FRICTION, LIMITS, ImportReport
from newton_euler.scalars import Array

BEYOND = 1e3
"""Distance, m or rad, of a coordinate beyond its limit: deeper than the width of any impedance."""

MAX_NO_LIMIT = 1e9
"""Magnitude, m or rad, from which on a limit is none."""

DAMPED_DEPTH = 1e-3
"""Depth, m or rad, at which a stop has the damping of MuJoCo's row."""


def coordinates(model: Any, q: Array) -> Array:
    """Return the coordinate (nv,) of the hinge or slide of each velocity, 0 for balls and free joints."""
    single = _single_joints(model)
    x = np.zeros(model.nv)
    x[model.jnt_dofadr[single]] = q[model.jnt_qposadr[single]]
    return x


def _single_joints(model: Any) -> Array:
    """Return the numbers of hinges and slides."""
    kinds = (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE)
    return np.flatnonzero(np.isin(model.jnt_type, [int(kind) for kind in kinds]))


def approximated(model: Any, report: ImportReport) -> FrictionAndStops:
    """Return friction and limits of all hinges and slides that the report lists as approximated.

    Args:
        model: compiled model, which is not changed.
        report: import report.
    """
    found, topics = FrictionAndStops.none(model.nv), report.approximated_topics
    if not topics:
        return found
    rows = _rows(model)
    for k in _single_joints(model).tolist():
        dof, element = int(model.jnt_dofadr[k]), element_name(model, "joint", k)
        mobility = float(model.dof_invweight0[dof])  # acceleration per force
        if (element, FRICTION) in topics:
            damping, weight, friction, _ = rows[int(mujoco.mjtConstraint.mjCNSTR_FRICTION_DOF), dof]
            # rows without damping or stiffness: the numbers for formats without softness
            speed = friction / (weight * damping) if damping else STICK_TIME * friction * mobility
            found.friction[dof], found.speed[dof] = friction, speed
        if (element, LIMITS) in topics:
            damping, weight, _, stiffness = rows[int(mujoco.mjtConstraint.mjCNSTR_LIMIT_JOINT), k]
            low, high = model.jnt_range[k]
            margin = model.jnt_margin[k]
            found.low[dof] = low + margin if abs(low) < MAX_NO_LIMIT else -np.inf
            found.high[dof] = high - margin if abs(high) < MAX_NO_LIMIT else np.inf
            found.stiffness[dof] = weight * stiffness if stiffness else STOP_RATE / mobility
            found.dissipation[dof] = damping / (stiffness * DAMPED_DEPTH) if stiffness else STOP_DISSIPATION
    return found


def _rows(model: Any) -> dict[tuple[int, int], tuple[float, float, float, float]]:
    """Return damping, 1/s, weight D, friction and stiffness, 1/s^2, of MuJoCo's rows of friction and limits.

    Keys are the type of the row and the number of the degree of freedom (friction) or joint (limit).
    """
    model = copy.copy(model)
    for name in ("LIMIT", "FRICTIONLOSS"):
        model.opt.disableflags &= ~int(getattr(mujoco.mjtDisableBit, f"mjDSBL_{name}"))
    data = mujoco.MjData(model)
    single = _single_joints(model)
    data.qpos[model.jnt_qposadr[single]] = model.jnt_range[single, 1] + BEYOND
    mujoco.mj_fwdPosition(model, data)
    found = {}
    for row in range(data.nefc):
        stiffness, damping, impedance, _ = data.efc_KBIP[row]
        numbers = damping, data.efc_D[row], data.efc_frictionloss[row], stiffness * impedance
        found[int(data.efc_type[row]), int(data.efc_id[row])] = numbers
    return found
