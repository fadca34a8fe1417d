"""MuJoCo's model under rigid constraints.

MuJoCo's equality constraints are soft, so its own accelerations are a little off whatever the
model. Here its mass matrix, bias and actuator forces and its constraint Jacobian, as it made them
from the MJCF, go into the equations of motion with hard constraints,

    M qacc = qfrc_passive + qfrc_actuator - qfrc_bias + J^T lambda
    J qacc = -Jdot qvel

which tells errors of a model from softness of a solver.
"""

from __future__ import annotations

import mujoco
import numpy as np

from mjcf.evaluate import constraint_jacobian, evaluation
from mjcf.loops import loops
from mjcf.model import CompiledScene
from newton_euler.scalars import Array
from newton_euler.solve import solve_constrained
from newton_euler.state import Evaluation


class RigidMuJoCo(CompiledScene):
    """A `newton_euler.system.System` in tree coordinates q (nq,), v (nv,)."""

    name = "mujoco_rigid"

    def rate(self, q: Array, v: Array) -> Array:
        """qdot (nq,)."""
        return self.tree.rate(q, v)

    def retract(self, q: Array, step: Array) -> Array:
        """q moved by a small step (nv,); quaternions come out with norm 1."""
        return self.tree.retract(q, step)

    def phi(self, q: Array) -> Array:
        """Residuals (k,) of MuJoCo's equality constraints."""
        self.state(q, np.zeros(self.nv))
        return np.array(self.data.efc_pos[: self.data.nefc])

    def phi_jacobian(self, q: Array) -> Array:
        """(k, nv): derivative of `phi` along `retract`, and of its rate by v."""
        self.state(q, np.zeros(self.nv))
        return constraint_jacobian(self) @ self.layout.to_qvel

    def velocity_product(self, q: Array, v: Array) -> Array:
        """(k,) Jdot v, the part of the constraints' second rate that holds no acceleration."""
        self.state(q, v)
        product = np.zeros(self.data.nefc)
        for loop in loops(self.model, self.data):
            product[loop.rows] = loop.velocity_product()
        return product

    def acceleration(self, q: Array, v: Array) -> Array:
        """vdot (nv,)."""
        return np.asarray(self.layout.to_qvel.T @ self._solve(q, v)[0])

    def velocity_transformation(self, q: Array) -> Array:
        """(6 b, nv): v and omega of body 0, 1, ... for each velocity, by MuJoCo's Jacobians."""
        self.state(q, np.zeros(self.nv))
        count = len(self.mechanism.bodies)
        rows = np.zeros((2 * count, 3, self.model.nv))
        for k, index in enumerate(self.body_id[1:count], start=1):
            mujoco.mj_jacBodyCom(self.model, self.data, rows[2 * k], rows[2 * k + 1], index)
        return rows.reshape(6 * count, self.model.nv) @ self.layout.to_qvel

    def evaluate(self, q: Array, v: Array) -> Evaluation:
        """Accelerations, reactions and energies at a state."""
        qacc, multipliers = self._solve(q, v)
        return evaluation(self, qacc, multipliers)

    def _solve(self, q: Array, v: Array) -> tuple[Array, Array]:
        """MuJoCo's qacc (nv,) and the multipliers (k,) of its constraint rows."""
        model, data = self.model, self.data
        gamma = -self.velocity_product(q, v)
        mujoco.mj_fwdActuation(model, data)
        mass = np.empty((model.nv, model.nv))
        mujoco.mj_fullM(model, data, mass)
        force = data.qfrc_passive + data.qfrc_actuator - data.qfrc_bias
        return solve_constrained(mass, force, constraint_jacobian(self), gamma)
