"""Limits of actuator forces in a compiled MuJoCo model.

Scenes that are imported from MuJoCo do not simulate these limits. The import report names each limit. A watch
(`Bounds`) tests, after a run, whether the force would have exceeded the limit. Excitation, which moves
controls so that a run tests the model, chooses controls whose forces stay within the limits.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import mujoco
import numpy as np

from mjcf.reading.laws import JointActuation, constant_plus_sines
from newton_euler.reading.activity import Bounds
from newton_euler.scalars import Array

TRANSMISSION, JOINT = mujoco.mjtTrn, mujoco.mjtJoint
"""MuJoCo's types of transmissions and joints."""

JOINT_TRANSMISSIONS = (TRANSMISSION.mjTRN_JOINT, TRANSMISSION.mjTRN_JOINTINPARENT)
"""Transmissions of actuators that act on one joint."""

FORCE_LIMITS = ("actuator_force", "tendon_actfrc", "jnt_actfrc")
"""Prefixes of the arrays `...limited` and `...range` of force limits in MuJoCo's model."""


def joint_force_unit(model: Any, joint: int) -> str:
    """Return the unit of generalized forces on a joint; a free joint has forces and torques."""
    units = {JOINT.mjJNT_SLIDE: "N", JOINT.mjJNT_FREE: "N, N m"}
    return units.get(JOINT(model.jnt_type[joint]), "N m")


def actuator_force_unit(model: Any, actuator: int) -> str:
    """Return the unit of an actuator's force on the length or angle of its transmission."""
    kind = TRANSMISSION(model.actuator_trntype[actuator])
    if kind in JOINT_TRANSMISSIONS:
        return joint_force_unit(model, int(model.actuator_trnid[actuator, 0]))
    # the gear of a site has three components of the force, then three of the torque
    is_torque = kind == TRANSMISSION.mjTRN_SITE and not np.any(model.actuator_gear[actuator, :3])
    return "N m" if is_torque else "N"


def limited_tendon(model: Any, actuator: int) -> int | None:
    """Return the number of an actuator's tendon if the tendon limits the forces of actuators, else None."""
    tendon = int(model.actuator_trnid[actuator, 0])
    on_tendon = model.actuator_trntype[actuator] == TRANSMISSION.mjTRN_TENDON
    return tendon if on_tendon and model.tendon_actfrclimited[tendon] else None


def distances_from_limits(
    model: Any, data: Any, actuator: int, moments: Mapping[int, float]
) -> Iterator[tuple[float, Array]]:
    """Yield the distances from the force at the start to each limit of a force that an actuator adds to.

    There can be a limit of the actuator itself, of its tendon, and of each joint that it moves.

    Args:
        model: `MjModel`. In MuJoCo 4 an actuator may have several forces; `actuator_outadr` is the index of
            the first one in `MjData.actuator_force`. Actuators that are imported have only one.
        data: `MjData` with the forces at the start, computed with the limits switched off.
        actuator: number of the actuator.
        moments: moment arm of the actuator at each of MuJoCo's joints, by number.

    Yields:
        For each limit, the limited force per unit force of the actuator: 1, or the moment arm at a joint.
        Then the signed distances (2,) from the force at the start to the lower and to the upper limit.
    """
    if model.actuator_forcelimited[actuator]:
        force = float(data.actuator_force[model.actuator_outadr[actuator]])
        yield 1.0, model.actuator_forcerange[actuator] - force
    if (tendon := limited_tendon(model, actuator)) is not None:
        on_tendons = model.actuator_trntype == TRANSMISSION.mjTRN_TENDON
        outputs = model.actuator_outadr[on_tendons & (model.actuator_trnid[:, 0] == tendon)]
        yield 1.0, model.tendon_actfrcrange[tendon] - float(np.sum(data.actuator_force[outputs]))
    for joint, moment in moments.items():
        if model.jnt_actfrclimited[joint] and moment:
            force = float(data.qfrc_actuator[model.jnt_dofadr[joint]])
            yield moment, model.jnt_actfrcrange[joint] - force


def joint_force_watch(actuation: JointActuation, low: float, high: float, unit: str) -> Bounds | None:
    """Return the watch of a limit of the actuator forces on a joint coordinate.

    A `Bounds` can watch a force of the form f(t) + a s + b ds/dt, where s = sum_j w_j x_j is a weighted sum
    of joint coordinates x_j. The force here is f(t) - sum_j (k_j x_j + d_j dx_j/dt), with the stiffness k_j
    and the damping d_j of the actuators' feedback. It has this form if all d_j / k_j are equal.

    Args:
        actuation: sum of the actuator forces.
        low: lower limit, N or N m.
        high: upper limit, N or N m.
        unit: unit of the limits.

    Returns:
        The watch; None if stiffnesses and dampings are not proportional, so that no weights w_j exist.
    """
    keys = list(actuation.feedback)
    gains = np.array(list(actuation.feedback.values())).reshape(-1, 2)  # rows (stiffness, damping)
    force_of_time = constant_plus_sines(actuation.constant, actuation.sines)
    if not keys:
        return Bounds(terms=(), low=low, high=high, unit=unit, constant=force_of_time)
    # weights w_j such that row j is w_j times the row with the largest gain
    largest_row = gains[int(np.argmax(np.abs(gains).max(axis=1)))]
    weights = gains @ largest_row / (largest_row @ largest_row) if np.any(gains) else np.ones(len(gains))
    if not np.allclose(np.outer(weights, largest_row), gains, rtol=1e-12, atol=0.0):
        return None
    terms = tuple(zip(keys, weights.tolist(), strict=True))
    stiffness, damping = largest_row
    return Bounds(
        terms,
        low,
        high,
        unit,
        constant=force_of_time,
        by_value=-float(stiffness),
        by_rate=-float(damping),
    )
