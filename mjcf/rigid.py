"""Equations of motion with rigid constraints, from the matrices of a MuJoCo model.

MuJoCo's equality constraints are soft, so that its own accelerations differ from those of rigid constraints
for any model. This module takes the mass matrix, bias forces, applied forces and constraint Jacobian of the
compiled MJCF, and solves

    M qacc = qfrc_passive + qfrc_actuator + qfrc_applied - qfrc_bias + J^T lambda
    J qacc = -Jdot qvel + f''(t)                 (f: functions of prescribed motions)

If these accelerations differ from those of another engine, the compiled model is wrong: softness cannot be
the reason.
"""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np

from mjcf.evaluate import EvaluatedScene, constraint_jacobian, mass_and_force
from mjcf.loops import active_loops, closes_loop, loops_with_rows
from newton_euler.equations.engine_solution import Redundancy, servo_forces, solve_rigidly, tree_rows
from newton_euler.equations.load_friction import EngineFriction
from newton_euler.equations.model_control import EngineControl
from newton_euler.equations.system import Evaluation
from newton_euler.errors import check_choice
from newton_euler.model.joint import Key
from newton_euler.model.joint_geometry import JointGeometry, geometry_in_tree, loop_closing_geometry
from newton_euler.model.scene import Scene
from newton_euler.scalars import Array


class RigidMuJoCo(EvaluatedScene):
    """A `newton_euler.equations.system.System` (an engine's equations) with rigid constraints and MuJoCo's
    matrices.

    `welded` describes the mechanism as MuJoCo models it: where it has no equality for a joint that closes a
    loop, one body is cut into two halves, which a weld joins. Coordinates q (nq,) and velocities v (nv,)
    belong to the spanning tree of this mechanism; MuJoCo's velocities are qvel = layout.to_qvel v.

    Constraint rows (k,) are those of MuJoCo's equalities, in the order of the MJCF: first all loop closures
    (balls, welds and rods, which are tendons of constant length), then all couplings (gears, screws and
    prescribed motions). `time` is the time, s, of prescribed motions.
    """

    name = "mujoco_rigid"

    def __init__(self, scene: Scene) -> None:
        """Compile a scene; raises `ModelError` with MuJoCo's reason."""
        super().__init__(scene)
        # units of the rows of each loop closure: the size of the mechanism for lengths, 1 for angles
        units_of_weld = np.repeat([self.welded.mechanism.size, 1.0], 3)
        units_of_closure = {
            mujoco.mjtEq.mjEQ_WELD: units_of_weld,
            mujoco.mjtEq.mjEQ_CONNECT: units_of_weld[:3],
            mujoco.mjtEq.mjEQ_TENDON: units_of_weld[:1],
        }
        closures = [index for index in range(self.model.neq) if closes_loop(self.model, index)]
        units = [units_of_closure[mujoco.mjtEq(self.model.eq_type[index])] for index in closures]
        # couplings follow the closures in MuJoCo's equalities, and have one row each
        units += list(self.couplings.units[:, None])
        self._equality_of_row = np.repeat(np.arange(len(units)), [len(unit) for unit in units])
        self.phi_units = np.concatenate([np.zeros(0), *units])
        self._coupling_rows = slice(len(self.phi_units) - len(self.couplings.units), None)
        self.velocity_units = self.tree.velocity_units

    def engine_control(self, scene: Scene) -> EngineControl:
        """Return the inverse dynamics of model-based control laws, which uses the matrices of this class."""
        return EngineControl(scene, RigidMuJoCo)

    def engine_friction(self, scene: Scene) -> EngineFriction:
        """Return the equations for friction that grows with reactions, with the matrices of this class."""
        return EngineFriction(scene, RigidMuJoCo)

    def rate(self, q: Array, v: Array) -> Array:
        """Return dq/dt (nq,) for velocities v (nv,)."""
        return self.tree.rate(q, v)

    def retract(self, q: Array, step: Array) -> Array:
        """Move q by a small step (nv,); quaternions keep norm 1."""
        return self.tree.retract(q, step)

    def _present_rows(self) -> Array:
        """Return a mask (k,) of the rows in `data`; MuJoCo drops rows of zeros."""
        if self.data.nefc == len(self._equality_of_row):
            return np.ones(self.data.nefc, dtype=bool)
        return np.isin(self._equality_of_row, self.data.efc_id)

    def phi(self, q: Array) -> Array:
        """Return the residuals (k,) of MuJoCo's equality constraints, m or rad."""
        self.compute_kinematics(q, np.zeros(self.nv))
        residuals = np.zeros(len(self._equality_of_row))
        residuals[self._present_rows()] = self.data.efc_pos
        # MuJoCo's equalities of joints are compiled with the values of prescribed motions at t = 0
        residuals[self._coupling_rows] += self.couplings.value(0.0) - self.couplings.value(self.time)
        return residuals

    def phi_t(self) -> Array:
        """Return the partial derivative (k,) of `phi` with respect to time."""
        rates = np.zeros(len(self._equality_of_row))
        rates[self._coupling_rows] = -self.couplings.rate(self.time)
        return rates

    def phi_jacobian(self, q: Array) -> Array:
        """Return the Jacobian J (k, nv) of `phi`: d phi = J step for q = retract(q, step).

        For a motion, d phi/dt = J v + phi_t.
        """
        self.compute_kinematics(q, np.zeros(self.nv))
        return self._jacobian()

    def _jacobian(self) -> Array:
        """Return MuJoCo's constraint Jacobian efc_J (k, nv) for tree velocities, at the state in `data`."""
        jacobian = np.zeros((len(self._equality_of_row), self.nv))
        jacobian[self._present_rows()] = constraint_jacobian(self.model, self.data) @ self.layout.to_qvel
        return jacobian

    def velocity_product(self, q: Array, v: Array) -> Array:
        """Return Jdot v (k,), the second time derivative of the residuals at zero acceleration."""
        self.compute_kinematics(q, v)
        # accelerations of bodies for qacc = 0, which `Loop.velocity_product` reads
        self.data.qacc[:] = 0.0
        mujoco.mj_rnePostConstraint(self.model, self.data)
        product = np.zeros(len(self._equality_of_row))  # stays 0 for linear couplings (fixed tendons)
        for index in np.flatnonzero(self.model.eq_type == mujoco.mjtEq.mjEQ_JOINT).tolist():
            product[self._equality_of_row == index] = self._polynomial_product(index)
        for loop in loops_with_rows(self.model, self.data):
            product[self._equality_of_row == loop.index] = loop.velocity_product()
        return product

    def _polynomial_product(self, equality: int) -> float:
        """Return Jdot v = -p''(x - x0) (dx/dt)^2 of an equality of joints y - y0 = p(x - x0)."""
        model, data = self.model, self.data
        driver = int(model.eq_obj2id[equality])
        if driver < 0:
            return 0.0
        qpos_index = model.jnt_qposadr[driver]
        x = data.qpos[qpos_index] - model.qpos0[qpos_index]
        second_derivative = np.polynomial.Polynomial(model.eq_data[equality, :5]).deriv(2)
        return float(-second_derivative(x) * data.qvel[model.jnt_dofadr[driver]] ** 2)

    def acceleration(self, q: Array, v: Array) -> Array:
        """Return dv/dt (nv,)."""
        acceleration, _ = self._solve(q, v)
        return acceleration

    def velocity_transformation(self, q: Array) -> Array:
        """Return the body Jacobian (6 b, nv) by MuJoCo: linear and angular velocity of each body per v.

        Bodies 0, 1, ... of the mechanism have six rows each; the rows of the ground, body 0, are zero.
        """
        self.compute_kinematics(q, np.zeros(self.nv))
        count = len(self.mechanism.bodies)
        jacobian = np.zeros((2 * count, 3, self.model.nv))
        for k, index in enumerate(self.body_id[1:count], start=1):
            mujoco.mj_jacBodyCom(self.model, self.data, jacobian[2 * k], jacobian[2 * k + 1], index)
        return jacobian.reshape(6 * count, self.model.nv) @ self.layout.to_qvel

    def joint_geometry(self) -> dict[str, JointGeometry]:
        """Return kinds, axes and points of the joints in the compiled model at its initial pose, by name."""
        model, data = self.model, self.data
        data.qpos[:] = model.qpos0
        mujoco.mj_fwdPosition(model, data)
        kinds = {
            int(mujoco.mjtJoint.mjJNT_HINGE): "hinge",
            int(mujoco.mjtJoint.mjJNT_SLIDE): "slide",
            int(mujoco.mjtJoint.mjJNT_BALL): "ball",
        }

        names = self.welded.tree.motion_names

        def read(number: int) -> tuple[str, Array, Array]:
            """Return kind, axis (3,) and anchor (3,), world frame, of a joint of MuJoCo."""
            index = model.joint(names[number]).id
            return kinds[int(model.jnt_type[index])], data.xaxis[index].copy(), data.xanchor[index].copy()

        geometry = geometry_in_tree(self.welded, read)
        # joints that close loops; welds join halves of cut bodies, and are no joints of the mechanism
        for loop in active_loops(model, data):
            if loop.kind != mujoco.mjtEq.mjEQ_WELD:
                kind = "rod" if loop.kind == mujoco.mjtEq.mjEQ_TENDON else "ball"
                geometry[loop.name] = loop_closing_geometry(
                    kind, (loop.points[0].copy(), loop.points[1].copy())
                )
        return geometry

    def evaluate(self, q: Array, v: Array) -> Evaluation:
        """Compute accelerations, reactions and energies at a state."""
        acceleration, multipliers = self._solve(q, v)
        return self.evaluation(self.layout.to_qvel @ acceleration, multipliers[self._present_rows()])

    def _solve(self, q: Array, v: Array) -> tuple[Array, Array]:
        """Solve for dv/dt (nv,) and the multipliers (k,) of MuJoCo's constraint rows."""
        redundancy = Redundancy.of(self)
        gamma = self._gamma(q, v)  # first, because it sets the state in `data`
        return solve_rigidly(self, redundancy, self._mass_and_force(), (self._jacobian(), gamma))

    def servo_forces(self, q: Array, v: Array, keys: Sequence[Key], accelerations: Array) -> Array:
        """Compute by inverse dynamics the forces on joint coordinates that cause given accelerations.

        Args:
            q: (nq,) tree coordinates.
            v: (nv,) tree velocities.
            keys: joint name and number of the coordinate of each force.
            accelerations: accelerations of these coordinates, m/s^2 or rad/s^2.

        Returns:
            Forces, N or N m.
        """
        gamma = self._gamma(q, v)  # first, because it sets the state in `data`
        matrices = self._mass_and_force(), (self._jacobian(), gamma)
        return servo_forces(self, *matrices, keys, (tree_rows(self.tree, keys), accelerations))

    def _gamma(self, q: Array, v: Array) -> Array:
        """Return gamma (k,), the right side of J vdot = gamma = -Jdot v + f''(t)."""
        gamma = -self.velocity_product(q, v)
        gamma[self._coupling_rows] += self.couplings.acceleration(self.time)
        return gamma

    def mass_and_force(self, q: Array, v: Array) -> tuple[Array, Array]:
        """Compute M (nv, nv) and f (nv,) of M vdot = f + J^T lambda at a state, by MuJoCo."""
        self.compute_kinematics(q, v)
        return self._mass_and_force()

    def _mass_and_force(self) -> tuple[Array, Array]:
        """Compute M (nv, nv) and f (nv,) at the state in `data`."""
        mass, force = mass_and_force(self.model, self.data)
        to_qvel = self.layout.to_qvel
        return to_qvel.T @ mass @ to_qvel, to_qvel.T @ force

    def move_anchor(self, joint: str, shift: Array) -> None:
        """Move the point of a loop closure on its second body, to inject a fault into the compiled model.

        Args:
            joint: name of the joint that closes the loop. MuJoCo has no equality for some joints, such as
                hinges; they stay in the tree, at the added half of a cut body, whose weld closes the loop.
            shift: (3,) m, world frame at the initial pose.

        Raises:
            UnknownNameError: for a joint that closes no loop, and for a rod, which has no anchors in MuJoCo's
                equality.
        """
        closing = {name: each for name, each in self.welded.closing_joints.items() if not each.only_closes}
        check_choice("joint that closes a loop", joint, closing)
        model, data = self.model, self.data
        data.qpos[:] = model.qpos0
        mujoco.mj_kinematics(model, data)
        equality = model.equality(closing[joint].name).id
        is_weld = model.eq_type[equality] == mujoco.mjtEq.mjEQ_WELD
        rotation = data.xmat[model.eq_obj2id[equality]].reshape(3, 3)
        # eq_data: a weld has its anchor in body 2, then in body 1; a connect in body 1, then in body 2
        anchor_in_second = slice(0, 3) if is_weld else slice(3, 6)
        model.eq_data[equality, anchor_in_second] += rotation.T @ shift
