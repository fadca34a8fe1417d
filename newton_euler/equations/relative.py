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
Body Dynamics Algorithms, 2008, section 8.1, for loops on top of a tree.) M and f are summed up from the
leaves to the ground, by the composite-rigid-body and the recursive Newton-Euler algorithm (Featherstone,
sections 6.2 and 5.3).

Beyond that: couplings and prescribed motions are further rows of J, rotors further shares of M.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from newton_euler.equations import dense, sparse
from newton_euler.equations.applied_forces import body_wrenches
from newton_euler.equations.formulation import Servos
from newton_euler.equations.kinematics import Link, TreeKinematics, drift, tree_links
from newton_euler.equations.model_control import model_control
from newton_euler.equations.reactions import constraint_wrenches, tree_reactions
from newton_euler.equations.redundancy import constraint_rank, rows_left_out, without
from newton_euler.equations.sparse import Equations, Rows, RowsInUse, Solution, add_symmetric
from newton_euler.errors import SingularityError
from newton_euler.model import balls
from newton_euler.model.joint import Key
from newton_euler.scalars import Array, Scalar, cross, symmetric, tilde, zeros


class Composite(NamedTuple):
    """Mass, first moment (3,) and inertia (3, 3) of bodies that move as one, about one of their points."""

    mass: Scalar
    moment: Array
    inertia: Array

    def joined(self, other: Composite, arm: Array) -> Composite:
        """Join bodies whose point is at an arm (3,) from this one's."""
        moved = other.moment + other.mass * arm
        shift = tilde(other.moment) @ tilde(arm) + tilde(arm) @ tilde(moved)
        return Composite(
            self.mass + other.mass, self.moment + moved, self.inertia + other.inertia - symmetric(shift)
        )

    def momenta(self, velocity: Array, omega: Array) -> tuple[Array, Array]:
        """Compute linear and angular momentum (3,) about the point, which has this velocity."""
        return (
            self.mass * velocity + cross(omega, self.moment),
            self.inertia @ omega + cross(self.moment, velocity),
        )


class Relative(TreeKinematics):
    """Joint-coordinate formulation of a scene. State: q (nq,), v (nv,) of the spanning tree."""

    name = "relative"

    # M and f

    def world_inertia(self, body: int, link: Link) -> Array:
        """Compute the inertia (3, 3) of a body about its center of mass, world frame."""
        a = link.frame.rotation
        return symmetric(a @ self.inertias[body] @ a.T)

    def needed_wrenches(
        self, q: Array, v: Array, linear: Sequence[Array] | Array, angular: Sequence[Array] | Array
    ) -> list[Array]:
        """Compute the wrenches (6,) that joints supply to bodies of these accelerations (b, 3).

        m (a - g) and I alpha + omega x I omega about the center of mass, world frame, less applied forces.
        """
        applied, needed = body_wrenches(self.scene, self.seen(q, v)), []
        for body, link in enumerate(self.links(q, v)):
            inertia, omega = self.world_inertia(body, link), link.frame.angular_velocity
            force = self.mechanism.bodies[body].mass * (linear[body] - self.scene.gravity)
            torque = inertia @ angular[body] + cross(omega, inertia @ omega)
            needed.append(np.concatenate([force, torque]) - applied[body])
        return needed

    def _projected(self, links: list[Link], wrenches: Sequence[Array]) -> Array:
        """Project wrenches (6,) on bodies onto velocities: sum V^T f + W^T n (nv,).

        From the leaves to the ground each joint carries what acts beyond it (section 5.3).
        """
        force, carried = zeros(self.nv, *wrenches), list(wrenches)
        for joint in reversed(self.tree.joints):
            link, parent, wrench = links[joint.child], links[joint.parent], carried[joint.child]
            own = slice(len(parent.path), len(link.path))
            force[joint.v] = link.linear[:, own].T @ wrench[:3] + link.angular[:, own].T @ wrench[3:]
            moment = cross(link.frame.position - parent.frame.position, wrench[:3])
            carried[joint.parent] = carried[joint.parent] + wrench + np.concatenate([np.zeros(3), moment])
        return force

    def _mass_rows(self, links: list[Link], q: Array, v: Array) -> Rows:
        """Compute the nonzeros of M (nv, nv), with all that a joint moves as one body (section 6.2)."""
        composites = [
            Composite(body.mass, np.zeros(3), self.world_inertia(k, link))
            for k, (body, link) in enumerate(zip(self.mechanism.bodies, links, strict=True))
        ]
        rows: Rows = [{} for _ in range(self.nv)]
        for joint in reversed(self.tree.joints):
            link, parent, composite = links[joint.child], links[joint.parent], composites[joint.child]
            arm = link.frame.position - parent.frame.position
            composites[joint.parent] = composites[joint.parent].joined(composite, arm)
            for n in range(len(parent.path), len(link.path)):
                momentum, spin = composite.momenta(link.linear[:, n], link.angular[:, n])
                row = momentum @ link.linear[:, : n + 1] + spin @ link.angular[:, : n + 1]
                for j, entry in zip(link.path[: n + 1], row, strict=True):
                    add_symmetric(rows, link.path[n], j, entry)
        for inertia, jacobian, _ in self._rotors(q, v):
            for i, x in jacobian.items():
                for j, y in jacobian.items():
                    if j <= i:
                        add_symmetric(rows, i, j, inertia * (x * y))
        return rows

    def _force(self, links: list[Link], q: Array, v: Array) -> Array:
        """Compute f (nv,) of these links, whose accelerations are those at qddot = 0."""
        at_rest = [k.acceleration for k in links], [k.angular_acceleration for k in links]
        force = self.actuation(q, v) - self._projected(links, self.needed_wrenches(q, v, *at_rest))
        for inertia, jacobian, gamma in self._rotors(q, v):
            for i, x in jacobian.items():
                force[i] = force[i] + inertia * gamma * x
        return force

    def actuation(self, q: Array, v: Array) -> Array:
        """Compute the share (nv,) of control laws and springs on joint coordinates in f."""
        measured, generalized = self.measured(q, v), zeros(self.nv, q, v)
        for law, u in zip(self.scene.joint_forces, self.joint_forces(q, v), strict=True):
            for k, entry in measured[law.key].jacobian.items():
                generalized[k] += entry * u
        return generalized

    def _rotors(self, q: Array, v: Array) -> Iterator[tuple[Scalar, dict[int, Scalar], Scalar]]:
        """Compute a, J and gamma of armatures, an extension: their force is -a (J vdot - gamma).

        Those of balls have three rows J, of the relative angular velocity's components.
        """
        measured = self.measured(q, v)
        for armature in self.scene.armatures:
            if armature.on_ball:
                terms = self._spin_terms(armature.joint, self.links(q, v))
            else:
                seen = measured[armature.key]
                terms = [(seen.jacobian, seen.gamma)]
            for row, gamma in terms:
                yield armature.inertia, row, gamma

    def _spin_terms(self, joint: str, links: list[Link]) -> list[tuple[dict[int, Scalar], Scalar]]:
        """Compute J and gamma of the angular velocity at a ball, which is three of v if the tree has it."""
        place = self.tree.ball_place(joint)
        if place is not None:
            return [({k: 1.0}, 0.0) for k in range(place.start, place.stop)]
        first, second = (links[k] for k in balls.ends(self.mechanism, joint))
        gamma = balls.spin_gamma(first.frame, second.frame) - drift(balls.SPIN, first, second)
        return list(zip(self.project(balls.SPIN, first, second), gamma, strict=True))

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

        By the recursive Newton-Euler algorithm (section 5.3).
        """
        links = tree_links(self.mechanism, self.tree, q, v, accelerations)
        jacobian, right = self._constraints(links, q, v)
        right, known = right.astype(object), sparse.sparse_vector(accelerations)
        of_joints, force = multipliers.copy(), -self.actuation(q, v)
        for k in range(self.rows - len(self.couplings), self.rows):
            of_joints[k] = 0.0
            right[k] = right[k] - sparse.dot(jacobian[k], known)
            for place, entry in jacobian[k].items():
                force[place] = force[place] - entry * multipliers[k]
        moving = [k.acceleration for k in links], [k.angular_acceleration for k in links]
        needed = self.needed_wrenches(q, v, *moving)
        for push in constraint_wrenches(self, self.frames(q, v), self.measured(q, v), of_joints):
            needed[push.first] = needed[push.first] - push.on_first
            needed[push.second] = needed[push.second] - push.on_second
        force = force + self._projected(links, needed)
        for inertia, row, gamma in self._rotors(q, v):
            push_back = inertia * (sparse.dot(row, known) - gamma)
            for place, entry in row.items():
                force[place] = force[place] + push_back * entry
        return force, -right

    # Solutions

    def mass_and_force(self, q: Array, v: Array) -> tuple[Array, Array]:
        mass, force = self.sparse_mass_and_force(q, v)
        return sparse.to_array(mass, self.nv), force

    def sparse_mass_and_force(self, q: Array, v: Array) -> tuple[Rows, Array]:
        """Compute the nonzeros of M (nv, nv), and f (nv,), over generic scalars."""
        links = self.links(q, v)
        return self._mass_rows(links, q, v), self._force(links, q, v)

    def mass_rows(self, q: Array) -> Rows:
        rest = np.zeros(self.nv)
        return self._mass_rows(self.links(q, rest), q, rest)

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
            return dense.solve_constrained(
                mass, force, jacobian, right, self.phi_units, self.velocity_units, constraint_rank(self)
            )
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
        needed = self.needed_wrenches(q, v, linear, angular)
        return tree_reactions(self, frames, measured, needed, multipliers, joint_forces, couples)
