"""Evaluate a state in MuJoCo for given accelerations and constraint forces.

`mjcf.rigid` and `mjcf.soft` compute the accelerations of MuJoCo's coordinates in different ways: with rigid
and with soft constraints. Both derive from `EvaluatedScene`, which computes accelerations of bodies, joint
reactions and energies from accelerations and constraint forces.
"""

from __future__ import annotations

from functools import cached_property
from typing import Any

import mujoco
import numpy as np

from mjcf.loops import body_acceleration
from mjcf.model import MujocoScene
from mjcf.reactions import Reactions
from newton_euler.equations.system import Evaluation
from newton_euler.scalars import Array, cross


def mass_and_force(model: mujoco.MjModel, data: mujoco.MjData) -> tuple[Array, Array]:
    """Return the mass matrix M (nv, nv) and the forces f (nv,) of M qacc = f + J^T lambda.

    `data` needs `mj_fwdVelocity`. J is the constraint Jacobian, lambda are the constraint forces.
    """
    mujoco.mj_fwdActuation(model, data)
    mass = np.empty((model.nv, model.nv))
    mujoco.mj_fullM(model, data, mass)
    return mass, data.qfrc_passive + data.qfrc_actuator + data.qfrc_applied - data.qfrc_bias


def constraint_jacobian(model: Any, data: Any) -> Array:
    """Return MuJoCo's constraint Jacobian efc_J (nefc, nv), from dense or sparse storage."""
    transposed = np.zeros((model.nv, data.nefc))
    for column, unit_velocity in zip(transposed, np.eye(model.nv), strict=True):
        mujoco.mj_mulJacVec(model, data, column, unit_velocity)
    return transposed.T


class EvaluatedScene(MujocoScene):
    """Compiled scene that evaluates accelerations of bodies and joint reactions."""

    @cached_property
    def _reactions(self) -> Reactions:
        """Reactions of the scene's joints, prepared once."""
        return Reactions(self)

    def evaluation(self, acceleration: Array, multipliers: Array) -> Evaluation:
        """Return motion, energies, reactions and actuator forces at the state in `data`.

        `data` needs `mj_fwdActuation`.

        Args:
            acceleration: (nv,) accelerations qacc of MuJoCo's coordinates.
            multipliers: (nefc,) forces of MuJoCo's constraint rows.
        """
        data = self.data
        data.qacc[:] = acceleration
        data.efc_force[:] = multipliers
        # mj_rnePostConstraint omits the forces of motors on sites, so that they are added as applied forces
        data.xfrc_applied[:] = self._motor_wrenches()
        mujoco.mj_rnePostConstraint(self.model, data)
        data.xfrc_applied[:] = 0.0
        linear, angular = self._body_accelerations()
        force, torque = self._reactions.evaluate()
        return Evaluation(
            **vars(self.observation()),  # state and energies
            linear_acceleration=linear,
            angular_acceleration=angular,
            reaction_force=force,
            reaction_torque=torque,
            actuator_force=np.array(data.actuator_force[: len(self.scene.control)]),
        )

    def _body_accelerations(self) -> tuple[Array, Array]:
        """Return accelerations (b, 3), m/s^2, of the centers of mass, and angular ones (b, 3), rad/s^2."""
        count = len(self.mechanism.bodies)
        linear, angular = np.zeros((2, count, 3))
        # MuJoCo's body numbers; body 0 is the ground, and numbers beyond the mechanism's bodies are halves of
        # bodies that are cut to open loops
        for k, index in enumerate(self.body_id[1:count], start=1):
            linear[k], angular[k] = body_acceleration(self.model, self.data, index)
        return linear, angular

    def _motor_wrenches(self) -> Array:
        """Return force and torque (nbody, 6) of motors on sites, about the centers of mass, world frame.

        Motors on sites apply the wrenches and the wind of the scene. In MuJoCo's list of actuators, they
        follow the actuators of control laws.
        """
        model, data = self.model, self.data
        wrenches = np.zeros((model.nbody, 6))
        for motor in range(len(self.scene.control), model.nu):
            # a gear is three forces and three torques in the axes of the site or of a reference site
            site, reference = model.actuator_trnid[motor]
            frame = data.site_xmat[site if reference < 0 else reference].reshape(3, 3)
            force, torque = data.actuator_force[motor] * model.actuator_gear[motor].reshape(2, 3) @ frame.T
            body = model.site_bodyid[site]
            arm = data.site_xpos[site] - data.xipos[body]
            wrenches[body] += np.concatenate([force, torque + cross(arm, force)])
        return wrenches
