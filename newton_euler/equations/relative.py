"""Equations of motion in joint coordinates of a spanning tree, with constraints that close the loops.

A spanning tree connects all bodies by joints without loops. The Newton-Euler equations of the bodies are
projected onto the velocities of its joints. These velocities are called qdot below, and v in the code,
because the coordinates q of a ball joint are a quaternion. Body i has mass m, inertia I, velocity v_i = V_i
qdot and angular velocity omega_i = W_i qdot. Its accelerations at qddot = 0 are a0_i and alpha0_i
(`newton_euler.equations.kinematics`). Then

    M qddot = f + J^T lambda
    J qddot = gamma - K_D (J qdot) - K_P Phi                    Baumgarte's gains K_D, K_P

    M = sum m V^T V + W^T I W
    f = sum V^T m (g - a0) - W^T (I alpha0 + omega x I omega) + applied forces
    J = Phi_r V + Phi_theta W                                   of the joints that close loops
    gamma = gamma_Phi - Phi_r a0 - Phi_theta alpha0             `drift` computes Phi_r a0 + Phi_theta alpha0

with gravity g, multipliers lambda, and the residuals Phi of the constraints. Phi_r and Phi_theta are their
derivatives for displacements and small rotations of the bodies, and gamma_Phi is the right side of
Phi_r a + Phi_theta alpha = gamma_Phi (P. E. Nikravesh, Computer-Aided Analysis of Mechanical Systems, 1988,
chapter 13; R. Featherstone, Rigid Body Dynamics Algorithms, 2008, section 8.1, for loops on top of a tree).
Each element of v has an axis. Recursions over the axes of the tree compute M, f, and the factor of M
(`newton_euler.equations.articulated`).

Couplings (gears) and prescribed motions are further rows of J. Armatures (rotor inertias) add to M. Joint
coordinates and rotors have accelerations j qddot - gamma, with a Jacobian row j and a number gamma for each.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from newton_euler.equations import dense, sparse
from newton_euler.equations.applied_forces import applied_wrenches
from newton_euler.equations.articulated import (
    Axis,
    AxisTree,
    Rotor,
    SpatialInertia,
    add_rotors,
    moved_wrench,
)
from newton_euler.equations.formulation import Servos
from newton_euler.equations.kinematics import Link, TreeKinematics, drift, tree_links
from newton_euler.equations.model_control import model_control
from newton_euler.equations.reactions import constraint_wrenches, tree_reactions
from newton_euler.equations.redundancy import constraint_rank, rows_left_out, with_zero_rows
from newton_euler.equations.sparse import Equations, Rows, RowsInUse, Solution, add
from newton_euler.errors import SingularityError
from newton_euler.model import balls
from newton_euler.model.joint import Key
from newton_euler.scalars import Array, Scalar, cross, mapped, symmetric, zeros


class Relative(TreeKinematics):
    """Joint-coordinate form of the equations of a scene: q (nq,) and v (nv,) are those of a spanning tree."""

    name = "relative"

    # M and f

    def world_inertia(self, body: int, link: Link) -> Array:
        """Compute the inertia (3, 3) of a body about its center of mass, world frame."""
        a = link.frame.rotation
        return symmetric(a @ self.inertias[body] @ a.T)

    def body_wrenches(
        self, q: Array, v: Array, linear: Sequence[Array] | Array, angular: Sequence[Array] | Array
    ) -> list[Array]:
        """Compute the wrenches that joints must supply to bodies with given accelerations.

        Args:
            q, v: (nq,) and (nv,), the state.
            linear, angular: (b, 3) accelerations of all bodies, world frame, m/s^2 and rad/s^2.

        Returns:
            (6,) for each body, ground first: force m (a - g) and torque I alpha + omega x I omega about the
            center of mass, minus applied forces, N and N m, world frame.
        """
        applied, wrenches = applied_wrenches(self.scene, self.surroundings(q, v)), []
        for body, link in enumerate(self.links(q, v)):
            inertia, omega = self.world_inertia(body, link), link.frame.angular_velocity
            force = self.mechanism.bodies[body].mass * (linear[body] - self.scene.gravity)
            torque = inertia @ angular[body] + cross(omega, inertia @ omega)
            wrenches.append(np.concatenate([force, torque]) - applied[body])
        return wrenches

    def axis_wrenches(self, links: list[Link], q: Array, v: Array) -> dict[int, Array]:
        """Sum the wrenches (6,) of `body_wrenches` by axis, for the accelerations of the links.

        Each wrench belongs to the last axis that moves its body, and is referred to the point of this axis.
        """
        linear, angular = [k.acceleration for k in links], [k.angular_acceleration for k in links]
        return on_axes(links, self.body_wrenches(q, v, linear, angular))

    def axis_inertias(self, links: list[Link]) -> list[SpatialInertia]:
        """Sum the inertias of bodies by the last axis that moves each body, about the point of the axis."""
        found = [SpatialInertia.none()] * self.nv
        for body, link in enumerate(links):
            if link.path:
                mass, k = self.mechanism.bodies[body].mass, link.path[-1]
                rigid = SpatialInertia.of_body(mass, self.world_inertia(body, link), link.lever)
                found[k] = found[k].joined(rigid)
        return found

    def _joint_forces(self, q: Array, v: Array) -> dict[int, Scalar]:
        """Compute the part of f, as a sparse vector, from control laws, springs and armatures at joints."""
        force = sparse.sparse_vector(self.actuation(q, v))
        for rotor in self._rotors(q, v):
            for i, x in rotor.jacobian.items():
                add(force, i, rotor.inertia * rotor.gamma * x)
        return force

    def actuation(self, q: Array, v: Array) -> Array:
        """Compute the part of f (nv,) from control laws and springs on joint coordinates."""
        measured, generalized = self.measured(q, v), zeros(self.nv, q, v)
        for key, u in self.coordinate_forces(q, v):
            for k, entry in measured[key].jacobian.items():
                generalized[k] += entry * u
        return generalized

    def _rotors(self, q: Array, v: Array) -> list[Rotor]:
        """List a rotor for each armature on a hinge or slide, and three rotors for each one on a ball joint.

        The rates of the three rotors are the components of the relative angular velocity.
        """
        measured, found = self.measured(q, v), list[Rotor]()
        for armature in self.scene.armatures:
            if armature.on_ball:
                terms = self._spin_terms(armature.joint, self.links(q, v))
            else:
                coordinate = measured[armature.key]
                terms = [(coordinate.jacobian, coordinate.gamma)]
            found.extend(Rotor(armature.inertia, jacobian, gamma) for jacobian, gamma in terms)
        return found

    def _spin_terms(self, joint: str, links: list[Link]) -> list[tuple[dict[int, Scalar], Scalar]]:
        """Compute a sparse Jacobian row and gamma for each component of a ball's relative angular velocity.

        If the joint belongs to the tree, the components are three elements of v. Otherwise they are in the
        world frame, with the Jacobian `balls.SPIN` between the two bodies.
        """
        place = self.tree.ball_place(joint)
        if place is not None:
            return [({k: 1.0}, 0.0) for k in range(place.start, place.stop)]
        first, second = (links[k] for k in balls.joint_bodies(self.mechanism, joint))
        gamma = balls.spin_gamma(first.frame, second.frame) - drift(balls.SPIN, first, second)
        return list(zip(self.project(balls.SPIN, first, second), gamma, strict=True))

    def model_forces(self, q: Array, v: Array) -> Mapping[Key, Scalar]:
        """Compute the forces of control laws that use a model of the mechanism, by key, N or N m."""
        return model_control(self).forces(self, q, v)

    # J, Phi and gamma

    def constraints(self, q: Array, v: Array) -> tuple[Rows, Array]:
        """Compute the sparse rows of J (k, nv), and the right side gamma - K_D (J qdot) - K_P Phi (k,)."""
        return self._constraints(self.links(q, v), q, v)

    def _constraints(self, links: list[Link], q: Array, v: Array) -> tuple[Rows, Array]:
        """Compute the sparse rows of J (k, nv), and the right side (k,).

        The right side is that of `constraints` for links at zero joint accelerations. If the links have
        joint accelerations qddot instead, the rows of loop-closing joints have the right side minus J
        qddot. The rows of couplings have the same right side.
        """
        jacobian, right = list[dict[int, Scalar]](), [np.zeros(0)]
        # loop-closing joints
        for closure in self.constrained:
            first, second = links[closure.first], links[closure.second]
            blocks = closure.jacobian(first.frame, second.frame)
            phi = closure.phi(first.frame, second.frame)
            gamma = closure.gamma(first.frame, second.frame) - drift(blocks, first, second)
            if self.K_D or self.K_P:
                gamma = gamma - self.K_D * blocks.rate(first.frame, second.frame) - self.K_P * phi
            right.append(gamma)
            jacobian.extend(self.project(blocks, first, second))
        # couplings and prescribed motions
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
        """Compute the residuals of accelerations and multipliers without M, by recursive Newton-Euler.

        See `newton_euler.equations.formulation.Formulation.sparse_residuals` for arguments and results.
        """
        # constraints: the right side minus J qddot. Of loop-closing joints it follows from the accelerations
        # of the bodies; of couplings J qddot is subtracted here, with their forces J^T lambda
        links = tree_links(self.mechanism, self.tree, q, v, accelerations)
        jacobian, right = self._constraints(links, q, v)
        right, qddot = right.astype(object), sparse.sparse_vector(accelerations)
        joint_multipliers, force = multipliers.copy(), -self.actuation(q, v)
        for row in range(self.rows - len(self.couplings), self.rows):
            joint_multipliers[row] = 0.0
            right[row] = right[row] - sparse.dot(jacobian[row], qddot)
            for k, entry in jacobian[row].items():
                force[k] = force[k] - entry * multipliers[row]
        # forces: wrenches of the bodies minus those of loop-closing joints, projected onto the axes
        linear, angular = [k.acceleration for k in links], [k.angular_acceleration for k in links]
        wrenches = self.body_wrenches(q, v, linear, angular)
        for pair in constraint_wrenches(self, self.frames(q, v), self.measured(q, v), joint_multipliers):
            wrenches[pair.first] = wrenches[pair.first] - pair.on_first
            wrenches[pair.second] = wrenches[pair.second] - pair.on_second
        for k, projected in axis_tree(links).rnea_backward(on_axes(links, wrenches)).items():
            force[k] = force[k] + projected
        # armatures
        for rotor in self._rotors(q, v):
            inertial_force = rotor.inertia * (sparse.dot(rotor.jacobian, qddot) - rotor.gamma)
            for k, entry in rotor.jacobian.items():
                force[k] = force[k] + inertial_force * entry
        return force, -right

    # Solutions

    def mass_and_force(self, q: Array, v: Array) -> tuple[Array, Array]:
        """Compute the mass matrix M (nv, nv) and the force f (nv,) of M qddot = f + J^T lambda."""
        links = self.links(q, v)
        force = self._joint_forces(q, v)
        for k, projected in axis_tree(links).rnea_backward(self.axis_wrenches(links, q, v)).items():
            add(force, k, -projected)
        return sparse.to_array(self.mass_rows(q), self.nv), sparse.to_array([force], self.nv)[0]

    def mass_rows(self, q: Array) -> Rows:
        """Compute the sparse rows of the mass matrix M (nv, nv), armatures included."""
        links, at_rest = self.links(q, np.zeros(self.nv)), np.zeros(self.nv)
        leaves_first = range(self.nv - 1, -1, -1)
        rows = axis_tree(links).crba(self.axis_inertias(links), leaves_first)
        add_rotors(rows, self._rotors(q, at_rest))
        return rows

    def solve(self, q: Array, v: Array) -> tuple[Array, Array]:
        """Solve for accelerations qddot (nv,) and multipliers lambda (k,) with dense matrices.

        The numbers are floats or `newton_euler.scalars.Stack`s.

        Raises:
            SingularityError: if M is singular to working precision or not finite, naming a joint.
        """
        rows, right = self.constraints(q, v)
        jacobian, left_out = sparse.to_array(rows, self.nv), rows_left_out(self)

        def solution(mass: Array, force: Array, jacobian: Array, right: Array) -> Array:
            """Return qddot and lambda as one vector, over floats."""
            try:
                return np.concatenate(
                    dense.solve_constrained(
                        mass,
                        force,
                        with_zero_rows(jacobian, left_out),  # rows that are almost redundant
                        with_zero_rows(right, left_out),
                        row_units=self.phi_units,
                        column_units=self.velocity_units,
                        max_rank=constraint_rank(self),
                    )
                )
            except np.linalg.LinAlgError as error:
                raise self._singularity(mass, force) from error

        found = mapped(solution, *self.mass_and_force(q, v), jacobian, right)
        return found[: self.nv], found[self.nv :]

    def _singularity(self, mass: Array, force: Array) -> SingularityError:
        """Return the error for a singular mass matrix M (nv, nv) or a force (nv,) that is not finite.

        The error names the joint of the first number that is not finite, or the joint that moves most in the
        mode of the smallest eigenvalue of M.
        """
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
        """Return the name of the joint that the velocity with an index in v belongs to."""
        (owner,) = (each for each in self.tree.joints if each.v.start <= velocity < each.v.stop)
        return self.tree.joint(owner.joint).name

    def sparse_equations(self, q: Array, v: Array, rows: RowsInUse) -> Equations:
        """Compute the linear equations for qddot, with M factorized from the leaves to the ground.

        `rows` selects constraint rows and has the reference magnitudes of the pivots of M.
        """
        links, rotors = self.links(q, v), self._rotors(q, v)
        jacobian, right = self._constraints(links, q, v)
        factor = axis_tree(links).factorize(self.axis_inertias(links), rotors, rows.mass_scales)
        # L^-1 f, with M = L D L^T and f = joint forces minus the projected wrenches of the bodies
        reduced_force = factor.lower(self._joint_forces(q, v), self.axis_wrenches(links, q, v))
        return Equations(factor, reduced_force, jacobian, right, rows, refine=False)

    def sparse_coordinates(self, q: Array, v: Array, keys: Sequence[Key]) -> tuple[Rows, Array]:
        """Compute sparse rows and gamma (k,) of joint coordinates; see `Formulation.sparse_coordinates`."""
        measured = self.measured(q, v)
        return [measured[key].jacobian for key in keys], np.array([measured[key].gamma for key in keys])

    def sparse_vdot(self, q: Array, v: Array, solution: Solution) -> Array:
        """Return qddot (nv,) of a sparse solution as an array."""
        return np.array([solution.acceleration.get(k, 0.0) for k in range(self.nv)])

    def servo_velocities(self, q: Array, servos: Servos, rates: Sequence[Scalar]) -> tuple[Array, Scalar]:
        """Compute all velocities from the rates of chosen joint coordinates.

        If the rates do not determine the motion, the result has the least kinetic energy.

        Args:
            q: (nq,) coordinates.
            servos: the chosen joint coordinates, constraint rows, and reference magnitudes of their pivots.
            rates: (d,) their rates, m/s or rad/s.

        Returns:
            v (nv,), and the pivot ratio, which is not positive at a singular configuration.
        """
        # the same equations as for accelerations, with velocities as unknowns and without forces:
        # M v = J^T lambda, J v = -Phi_t (partial derivative of Phi with respect to time), and the rows of the
        # chosen coordinates times v = rates
        at_rest = np.zeros(self.nv)
        equations = self.sparse_equations(q, at_rest, servos.rows)
        coordinate_rows, _ = self.sparse_coordinates(q, at_rest, servos.coordinates)
        right = np.concatenate([-self.phi_t(), np.array(rates)])
        solution = sparse.solve_constrained(
            equations.extended(coordinate_rows, right, servos.scales)._replace(reduced_force={})
        )
        return self.sparse_vdot(q, at_rest, solution), solution.pivot_ratio

    # Bodies and reactions at a solution

    def body_accelerations(self, q: Array, v: Array, vdot: Array) -> tuple[Array, Array]:
        """Compute the linear and angular accelerations of all bodies, (b, 3) each, world frame."""
        links = tree_links(self.mechanism, self.tree, q, v, vdot)
        return (
            np.array([link.acceleration for link in links]),
            np.array([link.angular_acceleration for link in links]),
        )

    def reactions(
        self, q: Array, v: Array, vdot: Array, bodies: tuple[Array, Array], multipliers: Array
    ) -> tuple[Array, Array]:
        """Compute the reaction forces and torques of all joints; see `Formulation.reactions`."""
        # forces of control laws, springs and armatures on joint coordinates, and torques of ball armatures
        frames, measured, (linear, angular) = self.frames(q, v), self.measured(q, v), bodies
        joint_forces = list(self.coordinate_forces(q, v))
        couples = []
        for armature in self.scene.armatures:
            if armature.on_ball:
                ends = balls.joint_bodies(self.mechanism, armature.joint)
                couples.append((ends, -armature.inertia * balls.spin_rate(frames, angular, ends)))
            else:
                coordinate = measured[armature.key]
                terms = (entry * vdot[k] for k, entry in coordinate.jacobian.items())
                acceleration = sum(terms, start=0.0) - coordinate.gamma
                joint_forces.append((armature.key, -(armature.inertia * acceleration)))
        # the other wrenches on the bodies are reactions
        needed = self.body_wrenches(q, v, linear, angular)
        return tree_reactions(self, frames, measured, needed, multipliers, joint_forces, couples)


def axis_tree(links: Sequence[Link]) -> AxisTree:
    """Collect the axes of all joint velocities, and their predecessors, from the kinematics of all bodies."""
    axes: dict[int, Axis] = {}
    before: dict[int, int] = {}  # index of the axis before each axis on the path from the ground; -1 for none
    for link in links:
        for n in reversed(range(len(link.path))):
            k = link.path[n]
            if k in axes:
                break  # another body has this axis and all axes before it
            axes[k], before[k] = link.axes[n], link.path[n - 1] if n else -1
    order = sorted(axes)
    return AxisTree([axes[k] for k in order], [before[k] for k in order])


def on_axes(links: Sequence[Link], wrenches: Sequence[Array]) -> dict[int, Array]:
    """Sum the wrenches on bodies by the last axis that moves each body.

    Args:
        links: kinematics of all bodies, ground first.
        wrenches: (6,) for each body: force, and torque about the center of mass, world frame.

    Returns:
        (6,) by index of the axis: force, and torque about the point of the axis.
    """
    found: dict[int, Array] = {}
    for link, wrench in zip(links, wrenches, strict=True):
        if link.path:
            k, moved = link.path[-1], moved_wrench(wrench, link.lever)
            found[k] = found[k] + moved if k in found else moved
    return found
