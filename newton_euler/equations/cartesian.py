"""Equations of motion in Cartesian coordinates: centers of mass, quaternions and Lagrange multipliers.

Equation numbers are those of the paper S. Srang, S. Ath, M. Yamakita, Advances in Science, Technology and
Engineering Systems Journal 5(5), 709-716, 2020; `docs/explanation/errata.md` lists its errata. The
coordinates are q = (r, p) of each moving body: center of mass r and Euler parameters p, a unit quaternion (w,
x, y, z). Equation (21) without the ground is

    | M      B^T |            | g - b                                     |
    | P      0   | | qddot  | | -c                                        |
    |            | |        | =
    | Phi_q  0   | | -lambda| | gamma - K_D (Phi_q qdot) - K_P Phi(q)     |

with the multipliers lambda, and the gains K_D and K_P of Baumgarte's stabilization. Each other symbol is the
method of that name in `newton_euler.equations.cartesian_terms`: M is the mass matrix, Phi are the constraint
residuals, g the applied forces, and the rows P keep the quaternions at norm 1. For n moving bodies qddot has
7 n elements, and the upper rows are 6 n force and torque balances. Two errata change the printed equation:
the rows of the Euler parameters are stabilized like the others (erratum 11), and the ground has no
coordinates (erratum 4).
"""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np

from newton_euler.equations import dense, sparse
from newton_euler.equations.cartesian_terms import CartesianTerms
from newton_euler.equations.reactions import at_joint_points, constraint_wrenches
from newton_euler.equations.redundancy import constraint_rank, rows_left_out, with_zero_rows
from newton_euler.equations.sparse import Equations, Rows, RowsInUse, Solution, add, add_block, to_array
from newton_euler.equations.system import fastest_joint
from newton_euler.errors import SingularityError
from newton_euler.model.constraints import Frame
from newton_euler.model.euler_parameters import matrix_g, matrix_l
from newton_euler.model.joint import Key
from newton_euler.model.spanning_tree import SpanningTree
from newton_euler.model.state import State
from newton_euler.scalars import Array, Scalar, mapped, sqrt


class Cartesian(CartesianTerms):
    """Cartesian form of the equations of a scene: equation (21), solved with dense or sparse matrices.

    The form's own coordinates, those of the methods `own_...`, are (r, p). The base class may append counted
    angles and the work of forces to q; the first 7 n elements of q are (r, p).
    """

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
        # an armature of inertia a exerts the force -a (Phi_q qddot - gamma) on its joint coordinate; B^T
        # gives the forces on the bodies
        for inertia, on_q, on_b, gamma in zip(*self.rotors(q, v), strict=True):
            column = inertia * to_array([on_b], len(force))[0]
            M = M + np.outer(column, to_array([on_q], self.nv)[0])
            force = force + gamma * column
        return M, force

    def solve(self, q: Array, v: Array) -> tuple[Array, Array]:
        """Solve equation (21) for the accelerations qddot (7 n,) and the multipliers lambda (k,).

        The numbers are floats or `newton_euler.scalars.Stack`s. If constraints are redundant, lambda is the
        minimum-norm solution.

        Raises:
            SingularityError: if qddot is not unique, naming the joint with dependent constraints.
        """
        found = mapped(self._solution, *self.equation_21(q, v), q, v)
        return found[: self.nv], found[self.nv :]

    def _solution(self, matrix: Array, right: Array, q: Array, v: Array) -> Array:
        """Return qddot and lambda at the state q, v as one vector, over floats.

        `matrix` and `right` are those of equation (21).
        """
        # constraint rows begin after the 6 n rows of the bodies and the n rows of the quaternions' norms;
        # rows that are almost redundant are replaced by zeros
        start, left_out = self.nv, rows_left_out(self)
        matrix[start:] = with_zero_rows(matrix[start:], left_out)
        right[start:] = with_zero_rows(right[start:], left_out)
        try:
            qddot, multipliers = dense.solve_augmented(
                matrix,
                right,
                row_units=self.phi_units[: self.rows],
                column_units=self.velocity_units,
                force_units=np.concatenate([self.force_units, np.ones(len(self.bodies))]),
                max_rank=constraint_rank(self) - len(self.bodies),  # without rows of the quaternions' norms
            )
        except np.linalg.LinAlgError as error:
            raise SingularityError(self._weakest_joint(q), f"{error} in equation (21)") from error
        if not np.isfinite(qddot).all():
            joint = fastest_joint(self.mechanism, self.state(q, v))
            raise SingularityError(joint, "equation (21) or its solution is not finite")
        return np.concatenate([qddot, multipliers])

    def _weakest_joint(self, q: Array) -> str:
        """Find the joint with the largest share in the combination of constraint rows closest to zero."""
        _, b_rows = self.Phi_q_and_B(q, np.zeros(self.nv))
        combinations, _, _ = dense.singular_values(to_array(b_rows, 6 * len(self.bodies)))
        return dense.largest_share(self.row_owners[: self.rows], combinations[:, -1])

    # Equation (21), solved by sparse elimination

    def sparse_equations(self, q: Array, v: Array, rows: RowsInUse) -> Equations:
        """Compute the linear equations for (rddot, omegadot' / p^T p) of each body.

        omegadot' = 2 L pddot, equation (11), is the angular acceleration in the body frame. With these
        unknowns in place of qddot, M is block diagonal, and
        Phi_p pddot = Phi_theta R omegadot' / (p^T p). Here R is the rotation matrix of the body, and
        Phi_theta are the derivatives of Phi for small rotations of the body, world frame. The Jacobian of the
        constraints is then B.

        Args:
            q, v: (7 n,) each, (r, p) and their rates.
            rows: numbers of independent constraint rows, with reference magnitudes of their pivots
                (`scales`), and with flags that omit some of the rows at present.
        """
        _, B = self.Phi_q_and_B(q, v)
        right = self.right_side(q, v)
        force = self._applied(q, v)
        # mass matrix: m_i and p^T p J'_i of each body; p^T p enters after the factorization, which therefore
        # does not depend on q
        mass: Rows = [{} for _ in force]
        squared_norms = []
        for k, (body, (_, p)) in enumerate(zip(self.bodies, self.split(q), strict=True)):
            linear, angular = slice(6 * k, 6 * k + 3), slice(6 * k + 3, 6 * k + 6)
            squared_norms.append(p @ p)
            add_block(mass[linear], linear.start, body.mass * np.eye(3))  # N_i
            add_block(mass[angular], angular.start, body.inertia)  # J'_i
        factor = sparse.factorize(mass, range(len(mass)))
        for k, squared_norm in enumerate(squared_norms):
            for i in range(6 * k + 3, 6 * k + 6):
                factor.inverse_pivots[i] = factor.inverse_pivots[i] / squared_norm
        # selected rows, without those of the quaternions' norms: these unknowns do not contain d2|p|/dt2
        count = sum(number < self.rows for number in rows.numbers)
        # an armature of inertia a on a coordinate x is an additional row, the soft constraint
        # d2x/dt2 + lambda / a = 0; its multiplier is the armature's force -a d2x/dt2. In `scales`, the
        # armatures' rows follow the selected rows
        inertias, _, rotor_rows, gammas = self.rotors(q, v)
        softness = dict(enumerate([1.0 / inertia for inertia in inertias], start=self.rows))
        scales = rows.scales and rows.scales[: count + len(softness)]
        selected = RowsInUse([*rows.numbers[:count], *softness], scales, flags=rows.flags)
        return Equations(
            factor,
            reduced_force=factor.lower(sparse.sparse_vector(force)),
            jacobian=[*B, *rotor_rows],
            gamma=np.concatenate([right, gammas]),
            rows=selected,
            refine=True,
            softness=softness,
        )

    def _applied(self, q: Array, v: Array) -> Array:
        """Compute g - b (6 n,) of equation (21): applied forces minus gyroscopic torques (`l_h_pdot`)."""
        force = self.g(q, v)
        parts = zip(self.bodies, self.split(q), self.split(v), strict=True)
        for k, (body, (_, p), (_, pdot)) in enumerate(parts):
            angular = slice(6 * k + 3, 6 * k + 6)
            force[angular] = force[angular] - self.l_h_pdot(body, p, pdot)
        return force

    def sparse_residuals(
        self, q: Array, v: Array, rows: RowsInUse, accelerations: Array, multipliers: Array
    ) -> tuple[Array, Array]:
        """Compute the residuals of accelerations and multipliers, without B for joints.

        See `newton_euler.equations.formulation.Formulation.sparse_residuals` for arguments and results.
        """
        equations, frames = self.sparse_equations(q, v, rows), self.frames(q, v)
        # bodies: mass times acceleration minus applied forces
        force, right = -self._applied(q, v), -equations.gamma.astype(object)
        accelerated = frames[:1]  # frames with accelerations in place of velocities, to use `Jacobian.rate`
        for k, (body, (_, p)) in enumerate(zip(self.bodies, self.split(q), strict=True)):
            linear, angular = slice(6 * k, 6 * k + 3), slice(6 * k + 3, 6 * k + 6)
            angular_acceleration = accelerations[angular]  # omegadot' / p^T p, body frame
            force[linear] = force[linear] + body.mass * accelerations[linear]
            force[angular] = force[angular] + (p @ p) * (body.inertia @ angular_acceleration)
            r, rotation = frames[k + 1][:2]
            accelerated.append(Frame(r, rotation, accelerations[linear], rotation @ angular_acceleration))
        # joints: relative accelerations, and the wrenches of their multipliers
        start = 0
        for e in self.equations:
            own_rows = slice(start, start + e.count)
            blocks = e.jacobian(frames[e.first], frames[e.second])
            right[own_rows] = right[own_rows] + blocks.rate(accelerated[e.first], accelerated[e.second])
            start += e.count
        joint_multipliers = multipliers[: self.rows].copy()
        joint_multipliers[start:] = 0.0
        for pair in constraint_wrenches(self, frames, self.measured(q, v), joint_multipliers):
            for k, wrench in ((pair.first, pair.on_first), (pair.second, pair.on_second)):
                if k > 0:
                    # the torque in the body frame, as in the rows of `force`
                    in_body = np.concatenate([wrench[:3], frames[k].rotation.T @ wrench[3:]])
                    force[6 * k - 6 : 6 * k] = force[6 * k - 6 : 6 * k] - in_body
        # couplings, prescribed motions and armatures
        sparse_accelerations = sparse.sparse_vector(accelerations)
        for i in range(start, len(equations.jacobian)):
            softness = (equations.softness or {}).get(i, 0.0)
            j_a = sparse.dot(equations.jacobian[i], sparse_accelerations)
            right[i] = right[i] + j_a + softness * multipliers[i]
            for k, entry in equations.jacobian[i].items():
                force[k] = force[k] - entry * multipliers[i]
        return force, right

    def sparse_coordinates(self, q: Array, v: Array, keys: Sequence[Key]) -> tuple[Rows, Array]:
        """Compute sparse rows and gamma (k,) of joint coordinates; see `Formulation.sparse_coordinates`."""
        frames, measured, rows = self.frames(q, v), self.measured(q, v), list[dict[int, Scalar]]()
        for key in keys:
            first, second = self.between[key].first, self.between[key].second
            _, on_b = self._rows(q, frames, first, second, measured[key].jacobian)  # rows of Phi_q and of B
            rows.extend(on_b)
        return rows, np.array([measured[key].gamma for key in keys])

    def sparse_vdot(self, q: Array, v: Array, solution: Solution) -> Array:
        """Compute qddot (7 n,) from a sparse solution.

        pddot follows from 2 L pddot = omegadot' and from equation (2), p^T pddot = -c, whose right side
        `along_p` includes Baumgarte's stabilization of the norm.
        """
        qddot = []
        for k, ((_, p), (_, pdot)) in enumerate(zip(self.split(q), self.split(v), strict=True)):
            rddot = [solution.acceleration.get(6 * k + i, 0.0) for i in range(3)]
            # omegadot' / p^T p, because L L^T = p^T p
            angular = np.array([solution.acceleration.get(6 * k + 3 + i, 0.0) for i in range(3)])
            along_p = -(pdot @ pdot) - self.K_D * (p @ pdot) - self.K_P * (0.5 * (p @ p - 1.0))
            qddot.extend([*rddot, *(0.5 * matrix_l(p).T @ angular + p * (along_p / (p @ p)))])
        return np.array(qddot)

    def mass_rows(self, q: Array) -> Rows:
        """Compute the sparse mass matrix (7 n, 7 n) of the kinetic energy: m and 4 L^T J' L of each body."""
        rows: Rows = [{} for _ in range(self.nv)]
        for k, (body, (_, p)) in enumerate(zip(self.bodies, self.split(q), strict=True)):
            add_block(rows[7 * k : 7 * k + 3], 7 * k, body.mass * np.eye(3))
            add_block(
                rows[7 * k + 3 : 7 * k + 7], 7 * k + 3, 4.0 * matrix_l(p).T @ body.inertia @ matrix_l(p)
            )
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

    def phi(self, q: Array) -> Array:
        """Compute Phi(q), then 1/2 (p^T p - 1) of each body."""
        return np.concatenate([self.Phi(q, np.zeros(self.nv)), self.norms(q)])

    def phi_and_jacobian(self, q: Array) -> tuple[Array, Rows]:
        """Compute `phi`, and the sparse rows of its Jacobian."""
        jacobian = [*self.Phi_q_and_B(q, np.zeros(self.nv))[0], *self.P(q)]
        return self.phi(q), jacobian

    def rows_of(self, relative: Collection[int]) -> list[int]:
        """Translate row numbers of the joint-coordinate form; see `Formulation.rows_of`.

        Rows of `closing_rows` that are not in `relative` are left out.
        """
        left_out = set(np.delete(self.closing_rows(), list(relative)).tolist())
        return [row for row in range(len(self.phi_units)) if row not in left_out]

    def closing_rows(self) -> list[int]:
        """List the rows of loop-closing joints (cuts of the spanning tree), then those of couplings.

        Prescribed motions count as couplings.
        """
        # row numbers of each joint, then of all couplings
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
        """Compute rddot and omegadot of all bodies, (b, 3) each, world frame.

        omegadot is 2 G pddot, because Gdot pdot = 0.
        """
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
