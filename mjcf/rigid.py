"""MuJoCo's model under rigid constraints.

MuJoCo's equality constraints are soft, so that its own accelerations have an error for any model. This module
takes MuJoCo's mass matrix, bias, actuator forces and constraint Jacobian of the compiled MJCF. They enter the
equations of motion with hard constraints,

    M qacc = qfrc_passive + qfrc_actuator - qfrc_bias + J^T lambda
    J qacc = -Jdot qvel + f''(t)                 (f of prescribed motions)

so that errors of the model can be distinguished from the softness of the solver.
"""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np

from mjcf.evaluate import EvaluatedScene, constraint_jacobian, mass_and_force
from mjcf.loops import active_loops, closes_loop, loops_with_rows
from newton_euler.equations.dense import solve_constrained
from newton_euler.equations.model_control import EngineControl, servo_forces
from newton_euler.equations.redundancy import constraint_rank, rows_left_out, with_zero_rows
from newton_euler.equations.system import Evaluation
from newton_euler.model.joint import Key
from newton_euler.model.joint_geometry import JointGeometry, geometry_in_tree, loop_closing_geometry
from newton_euler.model.scene import Scene
from newton_euler.scalars import Array


class RigidMuJoCo(EvaluatedScene):
    """A `newton_euler.equations.system.System` in tree coordinates q (nq,), v (nv,)."""

    name = "mujoco_rigid"

    def __init__(self, scene: Scene) -> None:
        """Compile a scene; raises `ModelError` with MuJoCo's reason."""
        super().__init__(scene)
        of_weld = np.repeat([self.welded.mechanism.size, 1.0], 3)
        closing = {
            mujoco.mjtEq.mjEQ_WELD: of_weld,
            mujoco.mjtEq.mjEQ_CONNECT: of_weld[:3],
            mujoco.mjtEq.mjEQ_TENDON: of_weld[:1],
        }
        cut = [index for index in range(self.model.neq) if closes_loop(self.model, index)]
        units = [closing[mujoco.mjtEq(self.model.eq_type[index])] for index in cut]
        units += list(self.couplings.units[:, None])
        self._constraint = np.repeat(np.arange(len(units)), [len(unit) for unit in units])
        self.phi_units = np.concatenate([np.zeros(0), *units])
        self._coupled = slice(len(self.phi_units) - len(self.couplings.units), None)
        self.velocity_units = self.tree.velocity_units

    def engine_control(self, scene: Scene) -> EngineControl:
        return EngineControl(scene, RigidMuJoCo)

    def rate(self, q: Array, v: Array) -> Array:
        """Return qdot (nq,)."""
        return self.tree.rate(q, v)

    def retract(self, q: Array, step: Array) -> Array:
        """Move q by a small step (nv,); quaternions keep norm 1."""
        return self.tree.retract(q, step)

    def _present(self) -> Array:
        """Mark the rows (k,) that MuJoCo has at this state; MuJoCo drops constraints with zero rows."""
        if self.data.nefc == len(self._constraint):
            return np.ones(self.data.nefc, dtype=bool)
        return np.isin(self._constraint, self.data.efc_id)

    def phi(self, q: Array) -> Array:
        """Return the residuals (k,) of MuJoCo's equality constraints."""
        self.move(q, np.zeros(self.nv))
        residuals = np.zeros(len(self._constraint))
        residuals[self._present()] = self.data.efc_pos
        # MuJoCo's equalities of joints hold the values at t = 0
        residuals[self._coupled] += self.couplings.value(0.0) - self.couplings.value(self.time)
        return residuals

    def phi_t(self) -> Array:
        """Return the partial derivative (k,) of `phi` with respect to time."""
        rates = np.zeros(len(self._constraint))
        rates[self._coupled] = -self.couplings.rate(self.time)
        return rates

    def phi_jacobian(self, q: Array) -> Array:
        """Return the derivative (k, nv) of `phi` along `retract`, also of its rate with respect to v."""
        self.move(q, np.zeros(self.nv))
        return self._jacobian()

    def _jacobian(self) -> Array:
        """Return efc_J (k, nv) for tree velocities at the state in `data`."""
        jacobian = np.zeros((len(self._constraint), self.nv))
        jacobian[self._present()] = constraint_jacobian(self.model, self.data) @ self.layout.to_qvel
        return jacobian

    def velocity_product(self, q: Array, v: Array) -> Array:
        """Return Jdot v (k,), the second rate of the constraints at zero acceleration."""
        self.move(q, v)
        self.data.qacc[:] = 0.0
        mujoco.mj_rnePostConstraint(self.model, self.data)
        product = np.zeros(len(self._constraint))  # stays 0 for sums of joint coordinates
        for index in np.flatnonzero(self.model.eq_type == mujoco.mjtEq.mjEQ_JOINT).tolist():
            product[self._constraint == index] = self._polynomial_product(index)
        for loop in loops_with_rows(self.model, self.data):
            product[self._constraint == loop.index] = loop.velocity_product()
        return product

    def _polynomial_product(self, equality: int) -> float:
        """Return Jdot v = -p''(x - x0) (dx/dt)^2 of an equality of joints y - y0 = p(x - x0)."""
        model, data = self.model, self.data
        driver = int(model.eq_obj2id[equality])
        if driver < 0:
            return 0.0
        place = model.jnt_qposadr[driver]
        x = data.qpos[place] - model.qpos0[place]
        bend = np.polynomial.Polynomial(model.eq_data[equality, :5]).deriv(2)
        return float(-bend(x) * data.qvel[model.jnt_dofadr[driver]] ** 2)

    def acceleration(self, q: Array, v: Array) -> Array:
        """Return vdot (nv,)."""
        return self._solve(q, v)[0]

    def velocity_transformation(self, q: Array) -> Array:
        """Return velocities (6 b, nv) of bodies 0, 1, ... per velocity v, by MuJoCo's Jacobians."""
        self.move(q, np.zeros(self.nv))
        count = len(self.mechanism.bodies)
        rows = np.zeros((2 * count, 3, self.model.nv))
        for k, index in enumerate(self.body_id[1:count], start=1):
            mujoco.mj_jacBodyCom(self.model, self.data, rows[2 * k], rows[2 * k + 1], index)
        return rows.reshape(6 * count, self.model.nv) @ self.layout.to_qvel

    def joint_geometry(self) -> dict[str, JointGeometry]:
        """Return the joints of the compiled model at its initial pose."""
        model, data = self.model, self.data
        data.qpos[:] = model.qpos0
        mujoco.mj_fwdPosition(model, data)
        kinds = {
            int(mujoco.mjtJoint.mjJNT_HINGE): "hinge",
            int(mujoco.mjtJoint.mjJNT_SLIDE): "slide",
            int(mujoco.mjtJoint.mjJNT_BALL): "ball",
        }

        def read(name: str) -> tuple[str, Array, Array]:
            index = model.joint(name).id
            return kinds[int(model.jnt_type[index])], data.xaxis[index].copy(), data.xanchor[index].copy()

        found = geometry_in_tree(self.welded, read)
        for loop in active_loops(model, data):
            if loop.kind != mujoco.mjtEq.mjEQ_WELD:
                kind = "rod" if loop.kind == mujoco.mjtEq.mjEQ_TENDON else "ball"
                found[loop.name] = loop_closing_geometry(kind, (loop.points[0].copy(), loop.points[1].copy()))
        return found

    def evaluate(self, q: Array, v: Array) -> Evaluation:
        """Compute accelerations, reactions and energies at a state."""
        acceleration, multipliers = self._solve(q, v)
        return self.evaluation(self.layout.to_qvel @ acceleration, multipliers[self._present()])

    def _solve(self, q: Array, v: Array) -> tuple[Array, Array]:
        """Solve for vdot (nv,) and the multipliers (k,) of MuJoCo's constraint rows."""
        unused = rows_left_out(self)
        gamma = self._gamma(q, v)
        mass, force = self._mass_and_force()
        rows, gamma = with_zero_rows(self._jacobian(), unused), with_zero_rows(gamma, unused)
        units = self.phi_units, self.velocity_units
        return solve_constrained(mass, force, rows, gamma, *units, constraint_rank(self))

    def servo_forces(self, q: Array, v: Array, keys: Sequence[Key], accelerations: Array) -> Array:
        """Compute the forces on joint coordinates, N or N m, for accelerations, by MuJoCo's matrices."""
        gamma = self._gamma(q, v)
        terms, jacobian = self._mass_and_force(), self._jacobian()
        return servo_forces(self, self.tree, terms, (jacobian, gamma), keys, accelerations)

    def _gamma(self, q: Array, v: Array) -> Array:
        """Return J vdot (k,) of MuJoCo's constraint rows."""
        gamma = -self.velocity_product(q, v)
        gamma[self._coupled] += self.couplings.acceleration(self.time)
        return gamma

    def mass_and_force(self, q: Array, v: Array) -> tuple[Array, Array]:
        """Compute M (nv, nv) and f (nv,) of M vdot = f + J^T lambda at a state, by MuJoCo."""
        self.move(q, v)
        return self._mass_and_force()

    def _mass_and_force(self) -> tuple[Array, Array]:
        """Compute M (nv, nv) and f (nv,) at the state in `data`."""
        mass, force = mass_and_force(self.model, self.data)
        to_qvel = self.layout.to_qvel
        return to_qvel.T @ mass @ to_qvel, to_qvel.T @ force

    def move_anchor(self, joint: str, shift: Array) -> None:
        """Move the point of a loop closure on its second body by `shift` (3,), m, world frame."""
        model, data = self.model, self.data
        data.qpos[:] = model.qpos0
        mujoco.mj_kinematics(model, data)
        loop = model.equality(self._closure(joint)).id
        welds = model.eq_type[loop] == mujoco.mjtEq.mjEQ_WELD
        turn = data.xmat[model.eq_obj2id[loop]].reshape(3, 3)
        anchor = slice(0, 3) if welds else slice(3, 6)
        model.eq_data[loop, anchor] += turn.T @ shift

    def _closure(self, joint: str) -> str:
        """Return the name of the equality that closes the loop of a joint: its own, or a weld of halves."""
        mechanism, welded = self.mechanism, self.welded.mechanism
        cut = welded.joints[mechanism.joint_index(joint)]
        for weld in welded.joints[len(mechanism.joints) :]:
            if weld.second in (cut.first, cut.second):
                return weld.name
        return joint
