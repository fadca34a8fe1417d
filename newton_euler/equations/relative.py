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

The sums are worked out from the leaves to the ground: to an axis, all bodies beyond it are one rigid body
with one wrench on it (Featherstone, section 5.3, recursive Newton-Euler, and 6.2, composite rigid bodies).

Beyond that: couplings and prescribed motions are further rows of J, rotors further blocks of M.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from newton_euler.equations import balls, dense, sparse
from newton_euler.equations.applied_forces import body_wrenches
from newton_euler.equations.kinematics import Axis, Link, TreeKinematics, drift
from newton_euler.equations.reactions import tree_reactions
from newton_euler.equations.redundancy import rows_left_out, without
from newton_euler.equations.sparse import Rows, RowsInUse, Solution, add
from newton_euler.errors import SingularityError
from newton_euler.model.forces import BallArmature
from newton_euler.scalars import Array, Scalar, cross, zeros


class Subtree(NamedTuple):
    """Bodies beyond a point of the tree: one rigid body, the wrench on it, its momenta at unit velocities.

    Attributes:
        mass: kg; moment: (3,) first moment of mass, kg m; inertia: (3, 3) kg m^2, about the point.
        force, torque: (3,) N and N m about the point: applied, less those that give a0 and alpha0.
        places: of the joint velocities within the subtree.
        momentum, angular_momentum: (3, n) that these at 1 give the bodies, about the point.
    """

    mass: Scalar
    moment: Array
    inertia: Array
    force: Array
    torque: Array
    places: list[int]
    momentum: Array
    angular_momentum: Array

    def moved(self, d: Array) -> Subtree:
        """Refer to the point from which the present one is at d (3,)."""
        h, (xx, xy, xz), (_, yy, yz), (_, _, zz) = self.moment, *self.inertia
        moment = h + self.mass * d
        x, y, z = d * (h + moment)
        xy = xy - (d[0] * moment[1] + h[0] * d[1])
        xz = xz - (d[0] * moment[2] + h[0] * d[2])
        yz = yz - (d[1] * moment[2] + h[1] * d[2])
        return self._replace(
            moment=moment,
            inertia=np.array([[xx + (y + z), xy, xz], [xy, yy + (x + z), yz], [xz, yz, zz + (x + y)]]),
            torque=self.torque + cross(d, self.force),
            angular_momentum=self.angular_momentum + cross(d, self.momentum),
        )

    def joined(self, other: Subtree) -> Subtree:
        """Take another one about the same point into it."""
        return Subtree(
            self.mass + other.mass,
            self.moment + other.moment,
            self.inertia + other.inertia,
            self.force + other.force,
            self.torque + other.torque,
            self.places + other.places,
            np.hstack([self.momentum, other.momentum]),
            np.hstack([self.angular_momentum, other.angular_momentum]),
        )

    def driven(self, axis: Axis) -> Subtree:
        """Take the velocity about or along an axis through the point into it."""
        s = axis.direction
        if axis.turns:
            momentum, angular_momentum = cross(s, self.moment), self.inertia @ s
        else:
            momentum, angular_momentum = self.mass * s, cross(self.moment, s)
        return self._replace(
            places=[axis.place, *self.places],
            momentum=np.column_stack([momentum, self.momentum]),
            angular_momentum=np.column_stack([angular_momentum, self.angular_momentum]),
        )


class Relative(TreeKinematics):
    """Joint-coordinate formulation of a scene. State: q (nq,), v (nv,) of the spanning tree."""

    name = "relative"

    # M and f

    def inertial_wrench(
        self, body: int, link: Link, at_pivot: Array, at_center: Array, alpha: Array
    ) -> tuple[Array, Array]:
        """Compute the wrench (3,), (3,) about a body's pivot that gives it accelerations against gravity.

        Force m (a - g) and torque J alpha + omega x J omega + h x (a_pivot - g), with J the inertia about the
        pivot and h = m s the first moment of mass; world frame.
        """
        inertia, omega, mass = self.world_inertia(body, link), link.frame.angular_velocity, self.masses[body]
        gravity = self.scene.gravity
        torque = inertia @ alpha + cross(omega, inertia @ omega) + cross(mass * link.arm, at_pivot - gravity)
        return mass * (at_center - gravity), torque

    def world_inertia(self, body: int, link: Link) -> Array:
        """Compute the inertia (3, 3) of a body about its pivot, world frame."""
        a = link.frame.rotation
        half = a @ self.pivot_inertias[body]
        xx, yy, zz, xy, xz, yz = (half[i] @ a[j] for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)))
        return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])

    def applied_wrenches(self, q: Array, v: Array) -> list[tuple[Array, Array]]:
        """Compute applied forces and torques (3,) about the pivots of all bodies, ground first."""
        wrenches = body_wrenches(self.scene, self.poses, self.frames(q, v))
        return [
            (wrench[:3], wrench[3:] + cross(link.arm, wrench[:3]))
            for wrench, link in zip(wrenches, self.links(q, v), strict=True)
        ]

    def subtrees(self, q: Array, v: Array) -> Iterator[tuple[Axis, Subtree]]:
        """Compute what each axis moves, about the axis's point, from the leaves to the ground."""
        links, none = self.links(q, v), np.zeros((3, 0))
        found = []
        for body, (link, (force, torque)) in enumerate(zip(links, self.applied_wrenches(q, v), strict=True)):
            f, n = self.inertial_wrench(
                body, link, link.pivot.acceleration, link.acceleration, link.angular_acceleration
            )
            inertia, mass = self.world_inertia(body, link), self.masses[body]
            own = mass, mass * link.arm, inertia, force - f, torque - n
            found.append(Subtree(*own, [], none, none))
        for joint in reversed(self.tree.joints):
            subtree = found[joint.child]
            for axis in reversed(links[joint.child].axes):
                subtree = subtree.moved(axis.step).driven(axis)
                yield axis, subtree
            found[joint.parent] = found[joint.parent].joined(subtree.moved(links[joint.child].offset))

    def actuation(self, q: Array, v: Array) -> Array:
        """Compute the share (nv,) of control laws and springs on joint coordinates in f."""
        measured, generalized = self.measured(q, v), zeros(self.nv, q, v)
        for law, u in zip(self.scene.joint_forces, self.joint_forces(measured), strict=True):
            for k, entry in measured[law.joint, law.coordinate].jacobian.items():
                generalized[k] += entry * u
        return generalized

    def rotors(self, q: Array, v: Array) -> Iterator[tuple[Scalar, dict[int, Scalar], Scalar]]:
        """Compute inertia a, nonzeros of J, and gamma of armatures, an extension: force -a (J vdot - gamma).

        Armatures of balls have three rows J, of the relative angular velocity's components.
        """
        measured = self.measured(q, v)
        for armature in self.scene.armatures:
            if isinstance(armature, BallArmature):
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

    # J, Phi and gamma

    def constraints(self, q: Array, v: Array) -> tuple[Rows, Array]:
        """Compute the nonzeros of J (k, nv), and gamma - K_D (J qdot) - K_P Phi (k,), as in eq. (9)."""
        links, jacobian = self.links(q, v), list[dict[int, Scalar]]()
        right = [np.zeros(0)]
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

    # Solutions

    def mass_and_force(self, q: Array, v: Array) -> tuple[Array, Array]:
        """Compute M (nv, nv) and f (nv,)."""
        mass, force = self.sparse_mass_and_force(q, v)
        return sparse.to_array(mass, self.nv), force.astype(float)

    def sparse_mass_and_force(self, q: Array, v: Array) -> tuple[Rows, Array]:
        """Compute the nonzeros of M (nv, nv), and f (nv,), over generic scalars."""
        mass: Rows = [{} for _ in range(self.nv)]
        force = self.actuation(q, v)
        for axis, subtree in self.subtrees(q, v):
            i, s = axis.place, axis.direction
            turning, pushing = subtree.angular_momentum, subtree.momentum
            for j, entry in zip(subtree.places, s @ (turning if axis.turns else pushing), strict=True):
                add(mass[i], j, entry)
                if i != j:
                    add(mass[j], i, entry)
            force[i] = force[i] + s @ (subtree.torque if axis.turns else subtree.force)
        for inertia, row, gamma in self.rotors(q, v):
            for i, x in row.items():
                force[i] = force[i] + inertia * gamma * x
                for j, y in row.items():
                    add(mass[i], j, inertia * (x * y))
        return mass, force

    def mass_rows(self, q: Array) -> Rows:
        """Compute the nonzeros of M (nv, nv), over generic scalars."""
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

    def fastest_joint(self, q: Array, v: Array) -> str:
        """Find the name of the joint whose dimensionless velocity is largest."""
        return self._joint_of(int(np.argmax(np.abs(v) / self.velocity_units)))

    def sparse_solution(self, q: Array, v: Array, rows: RowsInUse) -> Solution:
        """Solve by sparse elimination, leaves first, over generic scalars.

        `rows` of `phi` are used; the others must follow from them.
        """
        mass, force = self.sparse_mass_and_force(q, v)
        jacobian, right = self.constraints(q, v)
        factor = sparse.factorise(mass, range(self.nv - 1, -1, -1), rows.mass_scales)
        return sparse.solve_constrained(
            factor, sparse.sparse_vector(force), jacobian, right, rows, refine=False
        )

    def sparse_vdot(self, q: Array, v: Array, solution: Solution) -> Array:
        """Compute qddot (nv,) from a sparse solution."""
        return np.array([solution.acceleration.get(k, 0.0) for k in range(self.nv)])

    # Bodies and reactions at a solution

    def accelerations(self, q: Array, v: Array, vdot: Array) -> list[tuple[Array, Array, Array]]:
        """Compute linear accelerations (3,) of pivots and centers, and angular ones, of all bodies."""
        links, zero = self.links(q, v), np.zeros(3)
        shares = [(zero, zero)] * len(links)  # of qddot, in those of pivots and in angular ones
        found = [(zero, zero, zero)] * len(links)
        for joint in self.tree.joints:
            link, (a, alpha) = links[joint.child], shares[joint.parent]
            a = a + cross(alpha, link.offset)
            for axis in link.axes:
                share = axis.direction * vdot[axis.place]
                a, alpha = (a, alpha + share) if axis.turns else (a + share, alpha)
                a = a + cross(alpha, axis.step)
            shares[joint.child] = a, alpha
            center = link.acceleration + (a + cross(alpha, link.arm))
            found[joint.child] = link.pivot.acceleration + a, center, link.angular_acceleration + alpha
        return found

    def body_accelerations(self, q: Array, v: Array, vdot: Array) -> tuple[Array, Array]:
        """Compute linear and angular accelerations (b, 3): a0 + V qddot and alpha0 + W qddot."""
        found = self.accelerations(q, v, vdot)
        return np.array([linear for _, linear, _ in found]), np.array([angular for _, _, angular in found])

    def reactions(
        self, q: Array, v: Array, vdot: Array, bodies: tuple[Array, Array], multipliers: Array
    ) -> tuple[Array, Array]:
        """Compute forces and torques (j, 3) of joints about their points, on the second bodies."""
        frames, measured, (_, angular) = self.frames(q, v), self.measured(q, v), bodies
        laws = [(law.joint, law.coordinate) for law in self.scene.joint_forces]
        joint_forces = list(zip(laws, self.joint_forces(measured), strict=True))
        couples = []
        for armature in self.scene.armatures:
            if isinstance(armature, BallArmature):
                ends = balls.ends(self.mechanism, armature.joint)
                couples.append((ends, -armature.inertia * balls.spin_rate(frames, angular, ends)))
            else:
                seen = measured[armature.key]
                x_rates = (x * vdot[k] for k, x in seen.jacobian.items())
                acceleration = sum(x_rates, start=0.0) - seen.gamma
                joint_forces.append((armature.key, -(armature.inertia * acceleration)))
        needed = []
        for body, (link, (force, torque), accelerations) in enumerate(
            zip(
                self.links(q, v),
                self.applied_wrenches(q, v),
                self.accelerations(q, v, vdot),
                strict=True,
            )
        ):
            f, n = self.inertial_wrench(body, link, *accelerations)
            needed.append(np.concatenate([f - force, n - torque]))
        return tree_reactions(self, self.links(q, v), needed, multipliers, joint_forces, couples)
