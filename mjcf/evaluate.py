"""Evaluate a state in MuJoCo for given accelerations and constraint forces."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import mujoco
import numpy as np

from mjcf.loops import body_acceleration
from mjcf.model import CompiledScene
from mjcf.reactions import Reactions
from newton_euler.equations.system import Evaluation
from newton_euler.scalars import Array, cross


def mass_and_force(model: mujoco.MjModel, data: mujoco.MjData) -> tuple[Array, Array]:
    """Return M (nv, nv) and f (nv,) of M qacc = f + J^T lambda, after `mj_fwdVelocity`."""
    mujoco.mj_fwdActuation(model, data)
    mass = np.empty((model.nv, model.nv))
    mujoco.mj_fullM(model, data, mass)
    return mass, data.qfrc_passive + data.qfrc_actuator - data.qfrc_bias


def constraint_jacobian(model: Any, data: Any) -> Array:
    """Return MuJoCo's constraint Jacobian efc_J (nefc, nv), from dense or sparse storage."""
    columns = np.zeros((model.nv, data.nefc))
    for column, unit in zip(columns, np.eye(model.nv), strict=True):
        mujoco.mj_mulJacVec(model, data, column, unit)
    return columns.T


class EvaluatedScene(CompiledScene):
    """Compiled scene with joint reactions, which rigid and soft constraints share."""

    @cached_property
    def _reactions(self) -> Reactions:
        return Reactions(self)

    def evaluation(self, acceleration: Array, multipliers: Array) -> Evaluation:
        """Evaluate the state in `data`, after `mj_fwdActuation`.

        Args:
            acceleration: (nv,) accelerations qacc of MuJoCo's coordinates.
            multipliers: (nefc,) forces of MuJoCo's constraint rows.
        """
        data = self.data
        data.qacc[:] = acceleration
        data.efc_force[:] = multipliers
        data.xfrc_applied[:] = self._motor_wrenches()  # MuJoCo omits motors on sites from its balances
        mujoco.mj_rnePostConstraint(self.model, data)
        data.xfrc_applied[:] = 0.0
        linear, angular = self._body_accelerations()
        force, torque = self._reactions.now()
        return Evaluation(
            **vars(self.observation()),
            linear_acceleration=linear,
            angular_acceleration=angular,
            reaction_force=force,
            reaction_torque=torque,
            actuator_force=np.array(data.actuator_force[: len(self.scene.control)]),
        )

    def _body_accelerations(self) -> tuple[Array, Array]:
        """Return accelerations (b, 3) of the centers of mass and angular accelerations (b, 3)."""
        count = len(self.mechanism.bodies)
        linear, angular = np.zeros((2, count, 3))
        for k, index in enumerate(self.body_id[1:count], start=1):
            linear[k], angular[k] = body_acceleration(self.model, self.data, index)
        return linear, angular

    def _motor_wrenches(self) -> Array:
        """Return forces and torques (nbody, 6) of motors on sites about the centers of mass, world frame."""
        model, data = self.model, self.data
        wrenches = np.zeros((model.nbody, 6))
        for motor in range(len(self.scene.control), model.nu):
            site, reference = model.actuator_trnid[motor]
            frame = data.site_xmat[site if reference < 0 else reference].reshape(3, 3)
            force, torque = data.actuator_force[motor] * model.actuator_gear[motor].reshape(2, 3) @ frame.T
            body = model.site_bodyid[site]
            arm = data.site_xpos[site] - data.xipos[body]
            wrenches[body] += np.concatenate([force, torque + cross(arm, force)])
        return wrenches
