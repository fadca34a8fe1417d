"""Equations of motion in Cartesian coordinates: centers of mass, quaternions and Lagrange multipliers.

Equation numbers are those of the paper S. Srang, S. Ath, M. Yamakita, Advances in Science, Technology and
Engineering Systems Journal 5(5), 709-716, 2020; `docs/explanation/errata.md` lists its errata. The
coordinates are q = (r, p) of each moving body: center of mass r and Euler parameters p, a unit quaternion (w,
x, y, z). Equation (21) without the ground is

    | M      B^T |            | g - b                                     |
    | P      0   | | qddot  | | -c                                        |
    |            | |        | =
    | Phi_q  0   | | -lambda| | gamma - K_D (Phi_q qdot) - K_P Phi(q)     |

with the multipliers lambda, and Baumgarte's gains K_D and K_P. Each other symbol is the method of that name
in `newton_euler.equations.cartesian_terms`. Two errata change the printed equation: the rows of the Euler
parameters are stabilized like the others (erratum 11), and the ground has no coordinates (erratum 4).
"""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np

from newton_euler.equations import dense, sparse
from newton_euler.equations.cartesian_terms import CartesianTerms
from newton_euler.equations.reactions import at_joint_points, constraint_wrenches
from newton_euler.equations.redundancy import constraint_rank, rows_left_out, with_zero_rows
from newton_euler.equations.sparse import Equations, Rows, RowsInUse, Solution, add, spread, to_array
from newton_euler.equations.system import fastest_joint
from newton_euler.errors import SingularityError
from newton_euler.model.constraints import Frame
from newton_euler.model.euler_parameters import matrix_g, matrix_l
from newton_euler.model.joint import Key
from newton_euler.model.spanning_tree import SpanningTree
from newton_euler.model.state import State
from newton_euler.scalars import Array, Scalar, sqrt


class Cartesian(CartesianTerms):
    """Cartesian form of the equations of a scene: equation (21), solved with dense or sparse matrices."""

    name = "cartesian"

    # Equation (21), solved with dense matrices

    def equation_21(self, q: Array, qdot: Array) -> tuple[Array, Array]:
        """Assemble the matrix and the right side of equation (21) at q (7 n,) and qdot (7 n,)."""
        n6, n7 = 6 * len(self.bodies), self.nv
        phi_q_rows, b_rows = self.Phi_q_and_B(q, qdot)
        Phi_q, B, P = to_array(phi_q_rows, n7), to_array(b_rows, n6), to_array(self.P(q), n7)
        M, force = self.mass_and_force(q, qdot)
        matrix = np.block(
            [
                [M, B.T],
                [P, np.zeros((len(P), len(B)))],
                [Phi_q, np.zeros((len(B), len(B)))],
            ]
        )
        right = [
            force,
            -self.c(qdot) - self.K_D * (P @ qdot) - self.K_P * self.norms(q),  # erratum 11
            self.right_side(q, qdot),
        ]
        return matrix, np.concatenate(right)

    def mass_and_force(self, q: Array, v: Array) -> tuple[Array, Array]:
        """Compute M (6 n, 7 n) and g - b (6 n,) of equation (21), armatures (rotor inertias) included."""
        M, force = self.M(q), self.g(q, v) - self.b(q, v)
        for inertia, on_q, on_b, gamma in zip(*self.rotors(q, v), strict=True):
            push = inertia * to_array([on_b], len(force))[0]  # -a (Phi_q qddot - gamma) on the coordinate
            M = M + np.outer(push, to_array([on_q], self.nv)[0])
            force = force + gamma * push
        return M, force

    def solve(self, q: Array, v: Array) -> tuple[Array, Array]:
        """Solve equation (21) for the accelerations qddot (7 n,) and the multipliers lambda (k,).

        If constraints are redundant, lambda is the minimum-norm solution.

        Raises:
            SingularityError: if qddot is not unique, naming the joint with dependent constraints.
        """
        matrix, right = self.equation_21(q, v)
        n, unused = self.nv, rows_left_out(self)
        matrix[n:], right[n:] = with_zero_rows(matrix[n:], unused), with_zero_rows(right[n:], unused)
        force_units = np.concatenate([self.force_units, np.ones(len(self.bodies))])
        units = self.phi_units[: self.rows], self.velocity_units, force_units
        try:
            max_rank = constraint_rank(self) - len(self.bodies)  # without the rows of the quaternions' norms
            qddot, multipliers = dense.solve_augmented(matrix, right, *units, max_rank)
        except np.linalg.LinAlgError as error:
            raise SingularityError(self._weakest_joint(q), f"{error} in equation (21)") from error
        if not np.isfinite(qddot).all():
            joint = fastest_joint(self.mechanism, self.state(q, v))
            raise SingularityError(joint, "equation (21) or its solution is not finite")
        return qddot, multipliers

    def _weakest_joint(self, q: Array) -> str:
        """Find the joint with the largest share in the dependent combination of constraint rows."""
        rows = self.Phi_q_and_B(q, np.zeros(self.nv))[1]
        left = dense.singular_values(to_array(rows, 6 * len(self.bodies)))[0][:, -1]
        return dense.largest_share(self.row_owners[: self.rows], left)

    # Equation (21), solved by sparse elimination

    def sparse_equations(self, q: Array, v: Array, rows: RowsInUse) -> Equations:
        """Compute the linear equations for (rddot, omegadot' / p^T p) of each body.

        omegadot' = 2 L pddot, equation (11), is the angular acceleration in the body frame. With these
        unknowns in place of qddot, M is block diagonal, and Phi_p pddot = Phi_theta R omegadot' / (p^T p).
        """
        _, B = self.Phi_q_and_B(q, v)
        right = self.right_side(q, v)
        force = self._applied(q, v)
        # mass matrix: m_i and J'_i of each body, the latter multiplied by p^T p after the factorization
        mass: Rows = [{} for _ in force]
        scales = []
        for k, (body, (_, p)) in enumerate(zip(self.bodies, self.split(q), strict=True)):
            linear, angular = slice(6 * k, 6 * k + 3), slice(6 * k + 3, 6 * k + 6)
            scales.append(p @ p)
            spread(mass[linear], linear.start, body.mass * np.eye(3))  # N_i
            spread(mass[angular], angular.start, body.inertia)  # J'_i
        factor = sparse.factorize(mass, range(len(mass)))
        for k, scale in enumerate(scales):
            for i in range(6 * k + 3, 6 * k + 6):
                factor.inverse_pivots[i] = factor.inverse_pivots[i] / scale
        # rows in use, without those of the quaternions' norms, which these unknowns keep at 1
        count = sum(number < self.rows for number in rows.numbers)
        # an armature of inertia a on a coordinate x is a soft constraint: x'' + lambda / a = 0
        inertias, _, of_rotors, gammas = self.rotors(q, v)
        soft = dict(enumerate([1.0 / inertia for inertia in inertias], start=self.rows))
        usual = rows.scales and rows.scales[: count + len(soft)]
        used = RowsInUse([*rows.numbers[:count], *soft], usual, flags=rows.flags)
        free, right = factor.lower(sparse.sparse_vector(force)), np.concatenate([right, gammas])
        return Equations(factor, free, [*B, *of_rotors], right, used, refine=True, softness=soft)

    def _applied(self, q: Array, v: Array) -> Array:
        """Compute g - b (6 n,) of equation (21): applied forces minus velocity terms."""
        force = self.g(q, v)
        parts = zip(self.bodies, self.split(q), self.split(v), strict=True)
        for k, (body, (_, p), (_, pdot)) in enumerate(parts):
            angular = slice(6 * k + 3, 6 * k + 6)
            force[angular] = force[angular] - self.l_h_pdot(body, p, pdot)
        return force

    def sparse_residuals(
        self, q: Array, v: Array, rows: RowsInUse, accelerations: Array, multipliers: Array
    ) -> tuple[Array, Array]:
        """Compute the residuals of accelerations and multipliers constraint by constraint, without B.

        See `newton_euler.equations.formulation.Formulation.sparse_residuals`.
        """
        equations, frames = self.sparse_equations(q, v, rows), self.frames(q, v)
        # bodies: accelerations minus applied forces
        force, right = -self._applied(q, v), -equations.gamma.astype(object)
        moving = frames[:1]  # frames with accelerations in place of velocities
        for k, (body, (_, p)) in enumerate(zip(self.bodies, self.split(q), strict=True)):
            linear, angular = slice(6 * k, 6 * k + 3), slice(6 * k + 3, 6 * k + 6)
            spin = accelerations[angular]
            force[linear] = force[linear] + body.mass * accelerations[linear]
            force[angular] = force[angular] + (p @ p) * (body.inertia @ spin)
            r, rotation = frames[k + 1][:2]
            moving.append(Frame(r, rotation, accelerations[linear], rotation @ spin))
        # joints: relative accelerations, and the wrenches of their multipliers
        given, start = sparse.sparse_vector(accelerations), 0
        for e in self.equations:
            own = slice(start, start + e.count)
            blocks = e.jacobian(frames[e.first], frames[e.second])
            right[own] = right[own] + blocks.rate(moving[e.first], moving[e.second])
            start += e.count
        of_joints = multipliers[: self.rows].copy()
        of_joints[start:] = 0.0
        for push in constraint_wrenches(self, frames, self.measured(q, v), of_joints):
            for k, wrench in ((push.first, push.on_first), (push.second, push.on_second)):
                if k > 0:
                    turned = np.concatenate([wrench[:3], frames[k].rotation.T @ wrench[3:]])
                    force[6 * k - 6 : 6 * k] = force[6 * k - 6 : 6 * k] - turned
        # couplings, prescribed motions and armatures
        for i in range(start, len(equations.jacobian)):
            soft = (equations.softness or {}).get(i, 0.0)
            right[i] = right[i] + sparse.dot(equations.jacobian[i], given) + soft * multipliers[i]
            for k, entry in equations.jacobian[i].items():
                force[k] = force[k] - entry * multipliers[i]
        return force, right

    def sparse_coordinates(self, q: Array, v: Array, keys: Sequence[Key]) -> tuple[Rows, Array]:
        """Compute sparse rows and gamma (k,) of joint coordinates; see `Formulation.sparse_coordinates`."""
        frames, measured, rows = self.frames(q, v), self.measured(q, v), list[dict[int, Scalar]]()
        for key in keys:
            first, second = self.between[key].first, self.between[key].second
            rows.extend(self._rows(q, frames, first, second, measured[key].jacobian)[1])
        return rows, np.array([measured[key].gamma for key in keys])

    def sparse_vdot(self, q: Array, v: Array, solution: Solution) -> Array:
        """Compute qddot (7 n,) from a sparse solution.

        pddot follows from 2 L pddot = omegadot' and from equation (2), p^T pddot = -c, with stabilization.
        """
        qddot = []
        for k, ((_, p), (_, pdot)) in enumerate(zip(self.split(q), self.split(v), strict=True)):
            rddot = [solution.acceleration.get(6 * k + i, 0.0) for i in range(3)]
            spin = np.array([solution.acceleration.get(6 * k + 3 + i, 0.0) for i in range(3)])
            minus_c = -(pdot @ pdot) - self.K_D * (p @ pdot) - self.K_P * (0.5 * (p @ p - 1.0))
            qddot.extend([*rddot, *(0.5 * matrix_l(p).T @ spin + p * (minus_c / (p @ p)))])
        return np.array(qddot)

    def mass_rows(self, q: Array) -> Rows:
        """Compute the sparse mass matrix (7 n, 7 n) of the kinetic energy: m and 4 L^T J' L of each body."""
        rows: Rows = [{} for _ in range(self.nv)]
        for k, (body, (_, p)) in enumerate(zip(self.bodies, self.split(q), strict=True)):
            spread(rows[7 * k : 7 * k + 3], 7 * k, body.mass * np.eye(3))
            spread(rows[7 * k + 3 : 7 * k + 7], 7 * k + 3, 4.0 * matrix_l(p).T @ body.inertia @ matrix_l(p))
        rotors = self.rotors(q, np.zeros(self.nv))
        for inertia, row in zip(rotors.inertias, rotors.on_q, strict=True):
            for i, x in row.items():
                for j, y in row.items():
                    add(rows[i], j, inertia * (x * y))
        return rows

    # Interface to integrators, projection and assembly

    def orientations(self, q: Array, v: Array) -> list[Array]:
        """Return the quaternions (4,) of all bodies, ground first, not normalized."""
        return [self.mechanism.bodies[0].quaternion, *(p for _, p in self.split(q))]

    def own_coordinates(self, state: State) -> tuple[Array, Array]:
        """Compute (r, p) of the moving bodies and their rates at a state: pdot = 1/2 G^T omega."""
        parts, v = [np.zeros(0)], [np.zeros(0)]
        for k in range(1, len(self.mechanism.bodies)):
            p = state.quaternion[k]
            parts += [state.position[k], p]
            v += [state.linear_velocity[k], 0.5 * matrix_g(p).T @ state.angular_velocity[k]]
        return np.concatenate(parts), np.concatenate(v)

    def own_rate(self, q: Array, v: Array) -> Array:
        """Return the rates of (r, p) of all moving bodies: v itself."""
        return v

    def own_retract(self, q: Array, step: Array) -> Array:
        """Return (r, p) moved by a small step (7 n,), with quaternions normalized."""
        moved = []
        for r, p in self.split(q[: self.nv] + step):
            moved.extend([r, p / sqrt(p @ p)])
        return np.concatenate(moved)

    def phi_and_jacobian(self, q: Array) -> tuple[Array, Rows]:
        """Compute Phi(q), then 1/2 (p^T p - 1) of each body, and the sparse rows of their Jacobian."""
        rest = np.zeros(self.nv)
        jacobian = [*self.Phi_q_and_B(q, rest)[0], *self.P(q)]
        return np.concatenate([self.Phi(q, rest), self.norms(q)]), jacobian

    def rows_of(self, relative: Collection[int]) -> list[int]:
        """Translate row numbers of the joint-coordinate form; see `Formulation.rows_of`."""
        left_out = set(np.delete(self.closing_rows(), list(relative)).tolist())
        return [row for row in range(len(self.phi_units)) if row not in left_out]

    def closing_rows(self) -> list[int]:
        """List the rows of loop-closing joints (cuts of the spanning tree), then those of couplings."""
        rows = np.split(np.arange(self.rows), np.cumsum([equations.count for equations in self.equations]))
        of_cuts = [rows[joint] for joint in SpanningTree(self.mechanism).cuts]
        closing: list[int] = np.concatenate([*of_cuts, rows[-1]]).tolist()
        return closing

    def velocity_transformation(self, q: Array) -> Array:
        """Compute the matrix (6 b, 7 n) from v to the velocities of all bodies: omega = 2 G pdot."""
        rows = np.zeros((6 * len(self.mechanism.bodies), self.nv))
        for k, (_, p) in enumerate(self.split(q)):
            rows[6 * k + 6 : 6 * k + 9, 7 * k : 7 * k + 3] = np.eye(3)
            rows[6 * k + 9 : 6 * k + 12, 7 * k + 3 : 7 * k + 7] = 2.0 * matrix_g(p)
        return rows

    def body_accelerations(self, q: Array, v: Array, vdot: Array) -> tuple[Array, Array]:
        """Compute rddot and omegadot = 2 G pddot of all bodies, (b, 3) each; Gdot pdot is zero."""
        linear, angular = [np.zeros(3)], [np.zeros(3)]
        for (_, p), (rddot, pddot) in zip(self.split(q), self.split(vdot), strict=True):
            linear.append(rddot)
            angular.append(2.0 * matrix_g(p) @ pddot)
        return np.array(linear), np.array(angular)

    def reactions(
        self, q: Array, v: Array, vdot: Array, bodies: tuple[Array, Array], multipliers: Array
    ) -> tuple[Array, Array]:
        """Compute forces and torques (j, 3) of joints at their joint points from equation (17)."""
        frames = self.frames(q, v)
        return at_joint_points(
            self, frames, constraint_wrenches(self, frames, self.measured(q, v), multipliers)
        )
