"""Change of motion by plain MuJoCo or plain Pinocchio, for models whose joints correspond one to one."""

from __future__ import annotations

from collections.abc import Mapping

import mujoco
import numpy as np

from newton_euler.scalars import Array
from tests.support.planted.mjcf_text import MjcfText
from tests.support.planted.model_text import ModelText
from tests.support.planted.plant import Coordinate

STATES = 3
"""Number of random states."""

MIN_ACCELERATION = 1e-3
"""Part of the largest acceleration; smaller ones count as this large."""


def change_of_motion(first: ModelText, second: ModelText, coordinates: Mapping[str, Coordinate]) -> float:
    """Return the largest relative change of a joint's acceleration at random states.

    Args:
        first, second: the file and the changed file.
        coordinates: joints whose name, sign or zero is another one in the second file.
    """
    accelerations = _of_mujoco if isinstance(first, MjcfText) else _of_pinocchio
    zeros = {joint: first.zero(joint) for joint in first.hinges()}
    before, after = accelerations(first, {}, zeros), accelerations(second, coordinates, zeros)
    common = sorted(before.keys() & after.keys())
    one, other = (np.array([each[name] for name in common]) for each in (before, after))
    scale = np.maximum(np.abs(one), MIN_ACCELERATION * np.abs(one).max())
    return float((np.abs(other - one) / scale).max(initial=0.0))


def _state(name: str) -> Array:
    """Return random numbers in -1 to 1 for an element: the same ones in both files."""
    seed = [ord(letter) for letter in name]
    found: Array = np.random.default_rng(seed).uniform(-1.0, 1.0, (STATES, 3))
    return found


def _of_mujoco(
    file: ModelText, coordinates: Mapping[str, Coordinate], zeros: Mapping[str, float]
) -> dict[str, Array]:
    """Return the accelerations (STATES,) of hinges and slides, by the names of the first file.

    Args:
        file: the file.
        coordinates: joints whose name, sign or zero is not that of the first file.
        zeros: coordinates of hinges in the pose of the first file, rad; other joints have the same ones in
            both files.
    """
    assert isinstance(file, MjcfText)
    model = file.model
    # with REFSAFE, soft loops depend on the time step; soft dry friction depends on the zeros of the joints
    off = mujoco.mjtDisableBit
    for flag in (off.mjDSBL_LIMIT, off.mjDSBL_CONTACT, off.mjDSBL_REFSAFE, off.mjDSBL_FRICTIONLOSS):
        model.opt.disableflags |= int(flag)
    # weights from the pose of the file, which need not be the same pose, scale the softness of loops
    model.body_invweight0[:] = model.dof_invweight0[:] = 1.0
    # limits of controls and forces do not act at these states
    model.actuator_ctrllimited[:] = model.actuator_forcelimited[:] = model.jnt_actfrclimited[:] = 0
    first_name = {each.name: name for name, each in coordinates.items()}
    kinds = int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)
    single = [k for k in range(model.njnt) if model.jnt_type[k] in kinds]
    found: dict[str, list[float]] = {}
    for state in range(STATES):
        data = mujoco.MjData(model)
        senses = {}
        for k in single:
            own = model.joint(k).name
            name = first_name.get(own, own)
            where = coordinates.get(name, Coordinate(own))
            angle, rate, _ = 0.3 * _state(name)[state]
            # a loop stays closed only in the pose of the file
            zero = zeros.get(name, float(model.qpos0[model.jnt_qposadr[k]]))
            q = zero + (0.0 if model.neq else angle)
            data.qpos[model.jnt_qposadr[k]] = where.sense * q + where.offset
            data.qvel[model.jnt_dofadr[k]] = where.sense * rate
            senses[name] = (model.jnt_dofadr[k], where.sense)
        for k in range(model.nu):
            data.ctrl[k] = 0.5 * _state(model.actuator(k).name)[state, 2]
        mujoco.mj_forward(model, data)
        for name, (dof, sense) in senses.items():
            found.setdefault(name, []).append(sense * float(data.qacc[dof]))
    return {name: np.array(values) for name, values in found.items()}


def _of_pinocchio(
    file: ModelText, coordinates: Mapping[str, Coordinate], zeros: Mapping[str, float]
) -> dict[str, Array]:
    """Return the accelerations (STATES,) of hinges and slides of a URDF, as `_of_mujoco` does."""
    import pinocchio

    model = pinocchio.buildModelFromXML(file.text())
    data = model.createData()
    first_name = {each.name: name for name, each in coordinates.items()}
    found: dict[str, list[float]] = {}
    for state in range(STATES):
        q, v, senses = pinocchio.neutral(model), np.zeros(model.nv), {}
        for k in range(1, model.njoints):
            joint = model.joints[k]
            if joint.nv != 1:
                continue
            name = first_name.get(model.names[k], model.names[k])
            where = coordinates.get(name, Coordinate(name))
            angle, rate, _ = 0.3 * _state(name)[state]
            angle = where.sense * (zeros.get(name, 0.0) + angle) + where.offset
            values = [angle] if joint.nq == 1 else [np.cos(angle), np.sin(angle)]
            q[joint.idx_q : joint.idx_q + joint.nq] = values
            v[joint.idx_v] = where.sense * rate
            senses[name] = (joint.idx_v, where.sense)
        force = -model.damping * v - model.friction * np.sign(v)
        acceleration = pinocchio.aba(model, data, q, v, force)
        for name, (number, sense) in senses.items():
            found.setdefault(name, []).append(sense * float(acceleration[number]))
    return {name: np.array(values) for name, values in found.items()}
