"""The equations of motion in joint coordinates of a spanning tree, with closed loops.

The body equations are those of the Cartesian form; here they are projected onto the velocities
that the tree allows. With v_i = V_i qdot and omega_i = W_i qdot the velocity transformation of
body i, and a0_i, alpha0_i its acceleration at qddot = 0 (`newton_euler.equations.kinematics`),

    M qddot = f + J^T lambda
    J qddot = gamma - K_D (J qdot) - K_P Phi                    as in eq. (9)

    M = sum m V^T V + W^T I W
    f = sum V^T m (g - a0) - W^T (I alpha0 + omega x I omega) + applied forces
    J = Phi_r V + Phi_theta W                                   of the joints that close loops
    gamma = gamma_Phi - Phi_r a0 - Phi_theta alpha0

(Nikravesh, Computer-Aided Analysis of Mechanical Systems, 1988, chapter 13; Featherstone, Rigid
Body Dynamics Algorithms, 2008, section 8.1, for loops on top of a tree.)

Beyond that: couplings and prescribed motions are further rows of J, rotors further blocks of M.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from newton_euler.equations import dense, sparse
from newton_euler.equations.applied_forces import body_wrenches
from newton_euler.equations.formulation import Servos
from newton_euler.equations.kinematics import Link, TreeKinematics, drift, tree_links
from newton_euler.equations.model_control import model_control
from newton_euler.equations.reactions import pushes, tree_reactions
from newton_euler.equations.redundancy import rows_left_out, without
from newton_euler.equations.sparse import Block, Equations, Rows, RowsInUse, Solution
from newton_euler.errors import SingularityError
from newton_euler.model import balls
from newton_euler.model.joint import Key
from newton_euler.scalars import Array, Scalar, cross, zeros


class Relative(TreeKinematics):
    """Joint-coordinate formulation of a scene. State: q (nq,), v (nv,) of the spanning tree."""

    name = "relative"

    # M and f

    def world_inertia(self, body: int, link: Link) -> Array:
        """Compute the inertia (3, 3) of a body about its center of mass, world frame."""
        a = link.frame.rotation
        return a @ self.inertias[body] @ a.T

    def inertial_wrench(
        self, body: int, link: Link, acceleration: Array, alpha: Array
    ) -> tuple[Array, Array]:
        """Compute m (a - g) and I alpha + omega x I omega of a body, I in the world frame."""
        inertia, omega = self.world_inertia(body, link), link.frame.angular_velocity
        force = self.mechanism.bodies[body].mass * (acceleration - self.scene.gravity)
        return force, inertia @ alpha + cross(omega, inertia @ omega)

    def body_blocks(self, q: Array, v: Array) -> Iterator[Block]:
        """Compute the shares of bodies in M and f."""
        links = self.links(q, v)
        wrenches = body_wrenches(self.scene, self.seen(q, v))
        for body, link in enumerate(links[1:], start=1):
            inertia = self.world_inertia(body, link)
            block = (
                self.mechanism.bodies[body].mass * (link.linear.T @ link.linear)
                + link.angular.T @ inertia @ link.angular
            )
            f, n = self.inertial_wrench(body, link, link.acceleration, link.angular_acceleration)
            force, torque = wrenches[body][:3] - f, wrenches[body][3:] - n
            yield Block(link.path, block, link.linear.T @ force + link.angular.T @ torque)

    def actuation(self, q: Array, v: Array) -> Array:
        """Compute the share (nv,) of control laws and springs on joint coordinates in f."""
        measured, generalized = self.measured(q, v), zeros(self.nv, q, v)
        for law, u in zip(self.scene.joint_forces, self.joint_forces(q, v), strict=True):
            for k, entry in measured[law.key].jacobian.items():
                generalized[k] += entry * u
        return generalized

    def rotor_blocks(self, q: Array, v: Array) -> Iterator[Block]:
        """Compute the shares of armatures a in M and f, an extension: their force is -a (J vdot - gamma).

        Armatures of balls have three rows J, of the relative angular velocity's components.
        """
        measured = self.measured(q, v)
        for armature in self.scene.armatures:
            if armature.on_ball:
                terms = self._spin_terms(armature.joint, self.links(q, v))
            else:
                seen = measured[armature.key]
                terms = [(seen.jacobian, seen.gamma)]
            for row, gamma in terms:
                j = np.array(list(row.values()))
                yield Block(list(row), armature.inertia * np.outer(j, j), armature.inertia * gamma * j)

    def _spin_terms(self, joint: str, links: list[Link]) -> list[tuple[dict[int, Scalar], Scalar]]:
        """Compute J and gamma of the angular velocity at a ball, which is three of v if the tree has it."""
        place = self.tree.ball_place(joint)
        if place is not None:
            return [({k: 1.0}, 0.0) for k in range(place.start, place.stop)]
        first, second = (links[k] for k in balls.ends(self.mechanism, joint))
        gamma = balls.spin_gamma(first.frame, second.frame) - drift(balls.SPIN, first, second)
        return list(zip(self.project(balls.SPIN, first, second), gamma, strict=True))

    def blocks(self, q: Array, v: Array) -> Iterator[Block]:
        """Compute the shares of bodies and rotors in M and f."""
        yield from self.body_blocks(q, v)
        yield from self.rotor_blocks(q, v)

    def model_forces(self, q: Array, v: Array) -> Mapping[Key, Scalar]:
        return model_control(self).forces(self, q, v)

    # J, Phi and gamma

    def constraints(self, q: Array, v: Array) -> tuple[Rows, Array]:
        """Compute the nonzeros of J (k, nv), and gamma - K_D (J qdot) - K_P Phi (k,), as in eq. (9)."""
        return self._constraints(self.links(q, v), q, v)

    def _constraints(self, links: list[Link], q: Array, v: Array) -> tuple[Rows, Array]:
        """Compute J and the right side, of joints less J qddot for the accelerations of these links."""
        jacobian, right = list[dict[int, Scalar]](), [np.zeros(0)]
        for closure in self.constrained:
            first, second = links[closure.first], links[closure.second]
            blocks = closure.jacobian(first.frame, second.frame)
            phi = closure.phi(first.frame, second.frame)
            gamma = closure.gamma(first.frame, second.frame) - drift(blocks, first, second)
            if self.K_D or self.K_P:
                gamma = gamma - self.K_D * blocks.rate(first.frame, second.frame) - self.K_P * phi
            right.append(gamma)
            jacobian.extend(self.project(blocks, first, second))
        measured = self.measured(q, v)
        for coupling in self.couplings:
            phi, gamma = coupling.phi(measured, self.time), coupling.gamma(measured, self.time)
            if self.K_D or self.K_P:
                gamma = gamma - self.K_D * coupling.rate(measured, self.time) - self.K_P * phi
            right.append(np.array([gamma]))
            jacobian.append(self.coupled_row(coupling, measured))
        return jacobian, np.concatenate(right)

    def sparse_residuals(
        self, q: Array, v: Array, rows: RowsInUse, accelerations: Array, multipliers: Array
    ) -> tuple[Array, Array]:
        """Compute the residuals without M: from the ground to the leaves and back.

        By the recursive Newton-Euler algorithm (Featherstone, section 5.3).
        """
        links = tree_links(self.mechanism, self.tree, q, v, accelerations)
        applied, force = body_wrenches(self.scene, self.seen(q, v)), -self.actuation(q, v)
        jacobian, right = self._constraints(links, q, v)
        coupled = range(self.rows - len(self.couplings), self.rows)
        right, of_joints = right.astype(object), multipliers.copy()
        for k in coupled:
            of_joints[k] = 0.0
            right[k] = right[k] - sparse.dot(jacobian[k], sparse.sparse_vector(accelerations))
            for place, entry in jacobian[k].items():
                force[place] = force[place] - entry * multipliers[k]
        needed = [
            np.concatenate(self.inertial_wrench(body, link, link.acceleration, link.angular_acceleration))
            - applied[body]
            for body, link in enumerate(links)
        ]
        for push in pushes(self, self.frames(q, v), of_joints):
            needed[push.first] = needed[push.first] - push.on_first
            needed[push.second] = needed[push.second] - push.on_second
        for joint in reversed(self.tree.joints):
            link, parent, wrench = links[joint.child], links[joint.parent], needed[joint.child]
            own = slice(len(parent.path), len(link.path))
            share = link.linear[:, own].T @ wrench[:3] + link.angular[:, own].T @ wrench[3:]
            force[joint.v] = force[joint.v] + share
            moment = cross(link.frame.position - parent.frame.position, wrench[:3])
            needed[joint.parent] = needed[joint.parent] + wrench + np.concatenate([np.zeros(3), moment])
        for path, mass, share in self.rotor_blocks(q, v):
            force[path] = force[path] + mass @ accelerations[path] - share
        return force, -right

    # Solutions

    def mass_and_force(self, q: Array, v: Array) -> tuple[Array, Array]:
        return dense.assemble(self.blocks(q, v), self.actuation(q, v))

    def sparse_mass_and_force(self, q: Array, v: Array) -> tuple[Rows, Array]:
        """Compute the nonzeros of M (nv, nv), and f (nv,), over generic scalars."""
        return sparse.assemble(self.blocks(q, v), self.actuation(q, v))

    def mass_rows(self, q: Array) -> Rows:
        return self.sparse_mass_and_force(q, np.zeros(self.nv))[0]

    def solve(self, q: Array, v: Array) -> tuple[Array, Array]:
        """Solve for qddot (nv,) and lambda (k,) with dense matrices.

        Raises:
            SingularityError: if M is singular to working precision.
        """
        mass, force = self.mass_and_force(q, v)
        rows, right = self.constraints(q, v)
        unused = rows_left_out(self)
        jacobian, right = without(sparse.to_array(rows, self.nv), unused), without(right, unused)
        try:
            return dense.solve_constrained(mass, force, jacobian, right, self.phi_units, self.velocity_units)
        except np.linalg.LinAlgError as error:
            raise self._singularity(mass, force) from error

    def _singularity(self, mass: Array, force: Array) -> SingularityError:
        """Name the joint whose motion cannot be solved for, and the reason."""
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
        """Find the name of the joint that a velocity belongs to."""
        (kept,) = (kept for kept in self.tree.joints if kept.v.start <= velocity < kept.v.stop)
        return self.tree.joint(kept.joint).name

    def sparse_equations(self, q: Array, v: Array, rows: RowsInUse) -> Equations:
        """Factorize M, leaves first, over generic scalars; accelerations are qddot."""
        mass, force = self.sparse_mass_and_force(q, v)
        jacobian, right = self.constraints(q, v)
        factor = sparse.factorize(mass, range(self.nv - 1, -1, -1), rows.mass_scales)
        return Equations(factor, sparse.sparse_vector(force), jacobian, right, rows, refine=False)

    def sparse_coordinates(self, q: Array, v: Array, keys: Sequence[Key]) -> tuple[Rows, Array]:
        measured = self.measured(q, v)
        return [measured[key].jacobian for key in keys], np.array([measured[key].gamma for key in keys])

    def sparse_vdot(self, q: Array, v: Array, solution: Solution) -> Array:
        return np.array([solution.acceleration.get(k, 0.0) for k in range(self.nv)])

    def servo_velocities(self, q: Array, servos: Servos, rates: Sequence[Scalar]) -> tuple[Array, Scalar]:
        """Compute v (nv,) of least kinetic energy for rates (d,) of coordinates, and the pivot ratio."""
        rest = np.zeros(self.nv)
        equations = self.sparse_equations(q, rest, servos.rows)
        wanted, _ = self.sparse_coordinates(q, rest, servos.coordinates)
        gamma = np.concatenate([-self.phi_t(), np.array(rates)])
        solution = sparse.solve_constrained(
            equations.extended(wanted, gamma, servos.scales)._replace(force={})
        )
        return self.sparse_vdot(q, rest, solution), solution.pivot_ratio

    # Bodies and reactions at a solution

    def body_accelerations(self, q: Array, v: Array, vdot: Array) -> tuple[Array, Array]:
        """Compute linear and angular accelerations (b, 3): a0 + V qddot and alpha0 + W qddot."""
        links = self.links(q, v)
        return (
            np.array([k.acceleration + k.linear @ vdot[k.path] for k in links]),
            np.array([k.angular_acceleration + k.angular @ vdot[k.path] for k in links]),
        )

    def reactions(
        self, q: Array, v: Array, vdot: Array, bodies: tuple[Array, Array], multipliers: Array
    ) -> tuple[Array, Array]:
        frames, measured, (linear, angular) = self.frames(q, v), self.measured(q, v), bodies
        laws = [law.key for law in self.scene.joint_forces]
        joint_forces = list(zip(laws, self.joint_forces(q, v), strict=True))
        couples = []
        for armature in self.scene.armatures:
            if armature.on_ball:
                ends = balls.ends(self.mechanism, armature.joint)
                couples.append((ends, -armature.inertia * balls.spin_rate(frames, angular, ends)))
            else:
                seen = measured[armature.key]
                x_rates = (x * vdot[k] for k, x in seen.jacobian.items())
                acceleration = sum(x_rates, start=0.0) - seen.gamma
                joint_forces.append((armature.key, -(armature.inertia * acceleration)))
        wrenches = body_wrenches(self.scene, self.seen(q, v))
        needed = [
            np.concatenate(self.inertial_wrench(body, link, linear[body], angular[body])) - wrenches[body]
            for body, link in enumerate(self.links(q, v))
        ]
        return tree_reactions(self, frames, needed, multipliers, joint_forces, couples)
