"""Limits of actuator forces in a compiled model: units, distances from limits, and watches.

Scenes do not simulate these limits. Reports name them, runs are watched for them, and excitation stays within
them.
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

JOINT_TRANSMISSIONS = (TRANSMISSION.mjTRN_JOINT, TRANSMISSION.mjTRN_JOINTINPARENT)

FORCE_LIMITS = ("actuator_force", "tendon_actfrc", "jnt_actfrc")
"""Prefixes of the force limits in MuJoCo's model."""


def joint_force_unit(model: Any, joint: int) -> str:
    """Return the unit of forces on a joint; a free joint has forces of both units."""
    units = {JOINT.mjJNT_SLIDE: "N", JOINT.mjJNT_FREE: "N, N m"}
    return units.get(JOINT(model.jnt_type[joint]), "N m")


def actuator_force_unit(model: Any, actuator: int) -> str:
    """Return the unit of an actuator's force on the length or angle of its transmission."""
    kind = TRANSMISSION(model.actuator_trntype[actuator])
    if kind in JOINT_TRANSMISSIONS:
        return joint_force_unit(model, int(model.actuator_trnid[actuator, 0]))
    turns = kind == TRANSMISSION.mjTRN_SITE and not np.any(model.actuator_gear[actuator, :3])
    return "N m" if turns else "N"


def limited_tendon(model: Any, actuator: int) -> int | None:
    """Return the number of an actuator's tendon if the tendon limits actuator forces, otherwise None."""
    tendon = int(model.actuator_trnid[actuator, 0])
    on_tendon = model.actuator_trntype[actuator] == TRANSMISSION.mjTRN_TENDON
    return tendon if on_tendon and model.tendon_actfrclimited[tendon] else None


def distances_from_limits(
    model: Any, data: Any, actuator: int, moments: Mapping[int, float]
) -> Iterator[tuple[float, Array]]:
    """Yield the distances of forces at the start from the limits of an actuator, its tendon and its joints.

    Args:
        model: `MjModel`.
        data: `MjData` with the forces at the start, without limits.
        actuator: number of the actuator.
        moments: moment arm of the actuator at each joint.

    Yields:
        The limited force per force of the actuator, and the distances (2,) from the lower and upper limit.
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


def joint_force_watch(acting: JointActuation, low: float, high: float, unit: str) -> Bounds | None:
    """Make the watch of a limit of actuator forces on a joint coordinate.

    Returns:
        The watch; None if stiffnesses and dampings of the feedback have different weights of coordinates.
    """
    keys, gains = list(acting.feedback), np.array(list(acting.feedback.values())).reshape(-1, 2)
    moving = constant_plus_sines(acting.constant, acting.swings)
    if not keys:
        return Bounds((), low, high, unit, moving)
    first = int(np.argmax(np.abs(gains).max(axis=1)))
    by_value, by_rate = gains[first]
    factors = gains @ gains[first] / (gains[first] @ gains[first]) if np.any(gains) else np.ones(len(gains))
    if not np.allclose(np.outer(factors, gains[first]), gains, rtol=1e-12, atol=0.0):
        return None
    terms = tuple(zip(keys, factors.tolist(), strict=True))
    return Bounds(terms, low, high, unit, moving, -float(by_value), -float(by_rate))
