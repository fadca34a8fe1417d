"""The equations of motion in joint coordinates of a spanning tree, with closed loops.

The body equations are those of the Cartesian form; here they are projected onto the velocities
that the tree allows. With v_i = V_i qdot and omega_i = W_i qdot the velocity transformation of
body i, and a0_i, alpha0_i its acceleration at qddot = 0,

    M qddot = f + J^T lambda
    J qddot = gamma

    M = sum m V^T V + W^T I W
    f = sum V^T m (g - a0) - W^T (I alpha0 + omega x I omega) + actuation
    J = Phi_r V + Phi_theta W                          (of the joints that close loops)
    gamma = gamma_Phi - Phi_r a0 - Phi_theta alpha0 - K_D J qdot - K_P Phi

(Nikravesh, Computer-Aided Analysis of Mechanical Systems, 1988, chapter 13; Featherstone, Rigid
Body Dynamics Algorithms, 2008, section 8.1, for loops on top of a tree.)

Body frames are those of the tree: parallel to the world at the initial pose.
"""

from __future__ import annotations

import numpy as np

from newton_euler.equations.applied_forces import energies, power, rotors_energy, springs_energy
from newton_euler.equations.balls import ends, spin_rate
from newton_euler.equations.dense import solve_constrained
from newton_euler.equations.joint_coordinates import carried_rates
from newton_euler.equations.kinematics import Link
from newton_euler.equations.reactions import tree_reactions
from newton_euler.equations.redundancy import rows_left_out, without
from newton_euler.equations.relative_terms import RelativeTerms
from newton_euler.equations.sparse import RowsInUse, Solution, factorise, sparse_vector, to_array
from newton_euler.equations.sparse import solve_constrained as sparse_solve
from newton_euler.equations.system import Evaluation, MassProperties
from newton_euler.errors import SingularityError
from newton_euler.model.forces import BallArmature
from newton_euler.scalars import Array, Scalar


class Relative(RelativeTerms):
    """Joint-coordinate formulation of a scene. State: q (nq,), v (nv,) of the spanning tree."""

    name = "relative"

    # What integrators, projection and assembly ask for

    def rate(self, q: Array, v: Array) -> Array:
        """qdot (nq,)."""
        rates = self.tree.rate(q, v)
        if self.nq == self.tree.nq:
            return rates
        work = [self._power(q, v)] if self.scene.tracks_work else []
        return np.concatenate([rates, carried_rates(self.between, self._frames(q, v)), work])

    def _power(self, q: Array, v: Array) -> Scalar:
        """Power, W, of what is not in the potential energy; that of constraints is -lambda . Phi_t."""
        total = power(self.scene, *self.seen(q, v))
        if not self.scene.motions:
            return total
        if self.in_use is None:
            return total - self.phi_t() @ self._solve(q, v, self.links(q, v))[1]
        multipliers = self.sparse_solution(q, v, self.in_use).multipliers
        return total - sum(rate * multipliers.get(k, 0.0) for k, rate in enumerate(self.phi_t()))

    def acceleration(self, q: Array, v: Array) -> Array:
        """qddot (nv,)."""
        return self._solve(q, v, self.links(q, v))[0]

    def _solve(self, q: Array, v: Array, links: list[Link]) -> tuple[Array, Array]:
        mass, force = self.mass_and_force(q, v, links)
        _, rows, gamma = self.loop_terms(q, v, links)
        unused = rows_left_out(self)
        jacobian, gamma = without(to_array(rows, self.nv), unused), without(gamma, unused)
        try:
            return solve_constrained(mass, force, jacobian, gamma, self.phi_units, self.velocity_units)
        except np.linalg.LinAlgError as error:
            raise self._singularity(mass, force) from error

    def _singularity(self, mass: Array, force: Array) -> SingularityError:
        """Which joint's motion cannot be solved for, and why."""
        finite = np.isfinite(mass).all(axis=1) & np.isfinite(force)
        if not finite.all():
            return SingularityError(self._joint_of(int(np.argmin(finite))), "inertia or force is not finite")
        scaled = mass * np.outer(self.velocity_units, self.velocity_units)
        values, modes = np.linalg.eigh(scaled)
        return SingularityError(
            self._joint_of(int(np.argmax(np.abs(modes[:, 0])))),
            f"inertias from {values[0]:.3g} to {values[-1]:.3g} are too far apart for double precision",
        )

    def _joint_of(self, velocity: int) -> str:
        """Name of the joint that a velocity belongs to."""
        (kept,) = (kept for kept in self.tree.joints if kept.v.start <= velocity < kept.v.stop)
        return self.tree.joint(kept.joint).name

    def fastest_joint(self, q: Array, v: Array) -> str:
        """Name of the joint whose dimensionless velocity is largest."""
        return self._joint_of(int(np.argmax(np.abs(v) / self.velocity_units)))

    def sparse_solution(self, q: Array, v: Array, rows: RowsInUse) -> Solution:
        """Accelerations and multipliers by sparse elimination, leaves first, over generic scalars.

        `rows` of `phi` are used; the others must follow from them.
        """
        links = self.links(q, v)
        mass, force = self.sparse_mass_and_force(q, v, links)
        _, jacobian, gamma = self.loop_terms(q, v, links)
        factor = factorise(mass, range(self.nv - 1, -1, -1), rows.mass_scales)
        return sparse_solve(factor, sparse_vector(force), jacobian, gamma, rows, refine=False)

    def sparse_acceleration(self, q: Array, v: Array, rows: RowsInUse) -> tuple[Array, Scalar]:
        """qddot (nv,) and the health of the elimination, over generic scalars."""
        solution = self.sparse_solution(q, v, rows)
        return np.array([solution.acceleration.get(k, 0.0) for k in range(self.nv)]), solution.health

    # Between this formulation's coordinates and what everybody understands

    def mass_properties(self) -> MassProperties:
        """What the bodies weigh: as the mechanism states."""
        return MassProperties.of(self.mechanism)

    def velocity_transformation(self, q: Array) -> Array:
        """(6 b, nv): v and omega of body 0, 1, ... for each joint velocity."""
        links = self.links(q, np.zeros(self.nv))
        rows = np.zeros((len(links), 6, self.nv))
        for body, link in enumerate(links):
            rows[body][:, link.path] = np.concatenate([link.linear, link.angular])
        return rows.reshape(6 * len(links), self.nv)

    def evaluate(self, q: Array, v: Array) -> Evaluation:
        """Accelerations, reactions and energies at a state."""
        links = self.links(q, v)
        return self._evaluation(q, v, links, *self._solve(q, v, links))

    def sparse_evaluation(self, q: Array, v: Array, rows: RowsInUse) -> tuple[Evaluation, Scalar]:
        """`evaluate` by sparse elimination over generic scalars, and the health of that."""
        solution = self.sparse_solution(q, v, rows)
        qddot = np.array([solution.acceleration.get(k, 0.0) for k in range(self.nv)])
        multipliers = np.array([solution.multipliers.get(k, 0.0) for k in range(len(self.phi_units))])
        return self._evaluation(q, v, self.links(q, v), qddot, multipliers), solution.health

    def _evaluation(
        self, q: Array, v: Array, links: list[Link], qddot: Array, multipliers: Array
    ) -> Evaluation:
        actuation = self.actuation(q, v, links)[0]
        linear = np.array([k.acceleration + k.linear @ qddot[k.path] for k in links])
        angular = np.array([k.angular_acceleration + k.angular @ qddot[k.path] for k in links])
        measured = self.measured(q, v, links)
        pushes = [
            ((law.joint, law.coordinate), u)
            for law, u in zip(self.scene.joint_forces, actuation, strict=True)
        ]
        frames = [link.frame for link in links]
        spun = []
        for armature in self.scene.armatures:
            if isinstance(armature, BallArmature):
                bodies = ends(self.mechanism, armature.joint)
                spun.append((bodies, -armature.inertia * spin_rate(frames, angular, bodies)))
            else:
                seen = measured[armature.key]
                x_rates = (x * qddot[k] for k, x in seen.jacobian.items())
                acceleration = sum(x_rates, start=0.0) - seen.gamma
                pushes.append((armature.key, -(armature.inertia * acceleration)))
        forces, torques = tree_reactions(self, links, linear, angular, multipliers, pushes, spun)
        state = self._state(links)
        kinetic, potential = energies(self.scene, frames, self.inertias)
        kinetic = kinetic + rotors_energy(self.scene, frames, measured)
        potential = potential + springs_energy(self.scene, self.tree.poses, frames, measured)
        return Evaluation(
            state,
            linear,
            angular,
            forces,
            torques,
            actuation[: len(self.scene.control)],
            kinetic,
            potential,
            q[self.work][0] if self.scene.tracks_work else None,
        )

    def joint_phi(self, q: Array) -> Array:
        """Residuals of all joints, kept ones included, and of the couplings."""
        v = np.zeros(self.nv)
        links = self.links(q, v)
        all_joints = [self.tree.equations(k) for k in range(len(self.mechanism.joints))]
        phis = [e.phi(links[e.first].frame, links[e.second].frame) for e in all_joints]
        return np.concatenate([np.zeros(0), *phis, self.coupling_terms(self.measured(q, v, links))[0]])
