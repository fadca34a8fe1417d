"""Numbers and places of actuators of an MJCF file that do not act on hinges, slides or fixed tendons."""

from __future__ import annotations

import mujoco
import numpy as np

from mjcf.placements import rotation_of, site_place
from mjcf.settings import Names
from newton_euler.reading.robot import FilePlace, PlaceKind, Placement
from newton_euler.scalars import Array

Numbers = dict[str, float | str | FilePlace]
"""Numbers, words and places of an actuator by name, as in `FileDrive.other`."""

TRANSMISSION = mujoco.mjtTrn
"""MuJoCo's types of transmissions."""

ROLES_OF_SITES = {
    TRANSMISSION.mjTRN_SITE: ("site", "reference site"),
    TRANSMISSION.mjTRN_SLIDERCRANK: ("site of the crank", "site of the slider"),
}
"""What the two sites of a transmission are; the second one may be missing."""


def transmission_numbers(model: mujoco.MjModel, names: Names, number: int) -> Numbers:
    """Return what a file says of the transmission of an actuator that has no gears at single coordinates.

    Args:
        model: the compiled model.
        names: names of its elements.
        number: number of the actuator.
    """
    kind = TRANSMISSION(model.actuator_trntype[number])
    target, gear = int(model.actuator_trnid[number, 0]), model.actuator_gear[number]
    word = kind.name.partition("_")[2].lower()
    if kind in (TRANSMISSION.mjTRN_JOINT, TRANSMISSION.mjTRN_JOINTINPARENT):
        named: Numbers = {"transmission": word, "joint": names.joints[target]}
        return named | _gear_of_joint(model, target, gear, kind == TRANSMISSION.mjTRN_JOINTINPARENT)
    if kind == TRANSMISSION.mjTRN_TENDON:
        return {"transmission": word, "tendon": names.tendons[target]} | numbered("gear", gear)
    if kind == TRANSMISSION.mjTRN_BODY:
        return {"transmission": word, "body": names.bodies[target]} | numbered("gear", gear)
    found: Numbers = {"transmission": word} | numbered("gear", gear)
    for role, site in zip(ROLES_OF_SITES[kind], model.actuator_trnid[number].tolist(), strict=True):
        if site >= 0:
            found[role] = site_place(model, site, PlaceKind.FRAME)
    if kind == TRANSMISSION.mjTRN_SLIDERCRANK:
        found["crank length"] = float(model.actuator_cranklength[number])
    return found


def _gear_of_joint(model: mujoco.MjModel, joint: int, gear: Array, is_in_parent: bool) -> Numbers:
    """Return the gear of an actuator on a ball or a free joint: factors, and directions of forces.

    Torques have the axes of the body. With `jointinparent` these are the axes that the body has in the pose
    of the file. Forces on a free joint, and torques on one with `jointinparent`, have the axes of the world.
    """
    body = int(model.jnt_bodyid[joint])
    is_free = model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_FREE
    carrier = int(model.body_parentid[body]) if is_in_parent else body
    torque = (gear[3:] if is_free else gear[:3]).copy()
    if is_in_parent and not is_free:
        mujoco.mju_rotVecQuat(torque, torque.copy(), model.body_quat[body])
    parts = {"torque": (carrier, torque)}
    if is_free:
        parts["force"] = 0, gear[:3]
    found: Numbers = {}
    for name, (carrier, vector) in parts.items():
        size = float(np.linalg.norm(vector))
        if size:
            found[f"gear of the {name}"] = size
            frame = Placement(np.zeros(3), _with_z_axis(vector / size))
            found[f"direction of the {name}"] = FilePlace(PlaceKind.DIRECTION, carrier - 1, frame)
    return found


def _with_z_axis(axis: Array) -> Array:
    """Return a rotation (3, 3) whose last column is a unit vector (3,)."""
    quaternion = np.zeros(4)
    mujoco.mju_quatZ2Vec(quaternion, axis)
    return rotation_of(quaternion)


def numbered(name: str, values: Array) -> Numbers:
    """Return the values but zeros by name and number, such as "gain 1"."""
    return {f"{name} {number}": value for number, value in enumerate(values.tolist(), start=1) if value}
