"""The paper's equations of motion: Cartesian coordinates, Euler parameters, Lagrange multipliers.

Equation (21), body 1 (the ground) left out:

    | M      B^T |            | g - b                                     |
    | P      0   | | qddot  | | -c                                        |
    |            | |        | =
    | Phi_q  0   | | -lambda| | gamma - K_D (Phi_q qdot) - K_P Phi(q)     |

with q = (r, p) of each body. Two terms go beyond the printed equation, as the list of errata says:
the Euler-parameter rows are stabilised like the others (erratum 11), and the ground takes no part
(erratum 4), which leaves 42 coordinates, 34 + 6 constraints and 2 degrees of freedom of the tracker.
"""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from newton_euler.equations.applied_forces import energies, power, rotors_energy, springs_energy
from newton_euler.equations.cartesian_terms import CartesianTerms
from newton_euler.equations.couplings import turns
from newton_euler.equations.dense import independent_rows, singular_values
from newton_euler.equations.joint_coordinates import carried_angles, carried_rates
from newton_euler.equations.reactions import at_joint_points, pushes
from newton_euler.equations.redundancy import rows_left_out, without
from newton_euler.equations.sparse import Rows, RowsInUse, Solution, add, factorise, sparse_vector, to_array
from newton_euler.equations.sparse import solve_constrained as sparse_solve
from newton_euler.equations.system import Evaluation, MassProperties, fastest_joint
from newton_euler.errors import SingularityError
from newton_euler.model.euler_parameters import matrix_g, matrix_l
from newton_euler.model.spanning_tree import SpanningTree
from newton_euler.model.state import State
from newton_euler.scalars import Array, Scalar, cross, sqrt, zeros


class Cartesian(CartesianTerms):
    """Cartesian formulation of a scene. State: q (7 n,), qdot (7 n,) of the n moving bodies."""

    name = "cartesian"

    def system(self, q: Array, qdot: Array) -> tuple[Array, Array]:
        """Matrix and right side of equation (21); its unknowns are (qddot, -lambda)."""
        frames = self.frames(q, qdot)
        mass, velocity = self.mass_matrix(q), self.velocity_terms(q, qdot)
        g = self.applied(q, frames)[1]
        phi, gamma, rate = self.joint_phi(q), self.joint_gamma(q, frames), self.joint_rate(q, frames)
        n6, n7 = len(mass), self.nv
        for inertia, on_q, on_b, drift in zip(*self.rotor_rows(q, frames), strict=True):
            push = inertia * to_array([on_b], n6)[0]  # -a (Phi_q qddot - gamma) on the coordinate
            mass = mass + np.outer(push, to_array([on_q], n7)[0])
            g = g + drift * push
        phi_q, b = (
            to_array(rows, n) for rows, n in zip(self.joint_jacobian(q, frames), (n7, n6), strict=True)
        )
        norm, p_rows, c = self.norm_terms(q, qdot)
        p_matrix = to_array(p_rows, n7)
        matrix = zeros((n7 + self.rows, n7 + self.rows), q)
        matrix[:n6, :n7], matrix[:n6, n7:] = mass, b.T
        matrix[n6:n7, :n7] = p_matrix
        matrix[n7:, :n7] = phi_q
        right = np.concatenate(
            [
                g - velocity,
                -c - self.damping * (p_matrix @ qdot) - self.stiffness * norm,
                gamma - self.damping * rate - self.stiffness * phi,
            ]
        )
        return matrix, right

    def solve(self, q: Array, qdot: Array) -> tuple[Array, Array]:
        """qddot (7 n,) and lambda (k,); lambda is the smallest one where constraints are redundant.

        Equation (21), its constraint rows combined into independent ones and all in dimensionless form.

        Raises:
            SingularityError: if it has no unique solution for qddot all the same.
        """
        matrix, right = self.system(q, qdot)
        n = self.nv
        unused = rows_left_out(self)
        matrix[n:], right[n:] = without(matrix[n:], unused), without(right[n:], unused)
        phi_q = matrix[n:, :n]
        combine = independent_rows(phi_q, self.row_units, self.velocity_units)
        force_rows = np.concatenate([self.force_units, np.ones(len(self.bodies))])
        left = np.zeros((n + combine.shape[1],) * 2)
        left[:n, :n] = matrix[:n, :n] * self.velocity_units / force_rows[:, None]
        left[n:, :n] = combine.T @ phi_q * self.velocity_units
        push = matrix[:n, n:] @ combine / force_rows[:, None]
        share = np.max(np.abs(push), axis=0, initial=1e-300)  # multipliers in units of their own
        left[:n, n:] = push / share
        try:
            unknowns = np.linalg.solve(left, np.concatenate([right[:n] / force_rows, combine.T @ right[n:]]))
        except np.linalg.LinAlgError as error:
            raise SingularityError(self._weakest_joint(q), f"{error} in equation (21)") from error
        if not np.isfinite(unknowns).all():
            joint = fastest_joint(self.mechanism, self.state(q, qdot))
            raise SingularityError(joint, "equation (21) holds or gives what is not finite")
        return self.velocity_units * unknowns[:n], -(combine @ (unknowns[n:] / share))

    def sparse_solution(self, q: Array, qdot: Array, rows: RowsInUse) -> Solution:
        """(rddot, omegadot'/p^T p) of each body and lambda, by sparse elimination over generic scalars.

        `rows` of `phi` are used; the others must follow from them.

        Equation (21) with qddot eliminated: M is block diagonal and B M^-1 Phi_q^T as sparse as the
        joints. omegadot' = 2 L pddot and Phi_p pddot = Phi_theta R omegadot' / (p^T p).
        """
        frames = self.frames(q, qdot)
        _, b = self.joint_jacobian(q, frames)
        right = self.joint_gamma(q, frames)
        if self.damping or self.stiffness:
            right = right - self.damping * self.joint_rate(q, frames) - self.stiffness * self.joint_phi(q)
        mass: Rows = [{} for _ in range(6 * len(self.bodies))]
        force = list(self.applied(q, frames)[1])
        scales = []
        for k, (body, (_, p), (_, pdot)) in enumerate(
            zip(self.bodies, self.split(q), self.split(qdot), strict=True)
        ):
            omega = 2.0 * matrix_l(p) @ pdot
            momentum = body.inertia @ omega
            # L H pdot = omega' x J' omega' + 2 (p^T pdot) J' omega', eqs (12) and (13)
            gyroscopic = cross(omega, momentum) + 2.0 * (p @ pdot) * momentum
            scales.append(p @ p)
            for i in range(3):
                mass[6 * k + i][6 * k + i] = body.mass
                force[6 * k + 3 + i] = force[6 * k + 3 + i] - gyroscopic[i]
                for j in range(3):
                    add(mass[6 * k + 3 + i], 6 * k + 3 + j, body.inertia[i, j])
        factor = factorise(mass, range(len(mass)))
        for k, scale in enumerate(scales):
            for i in range(6 * k + 3, 6 * k + 6):
                factor.inverse_pivots[i] = factor.inverse_pivots[i] / scale
        # the rows of the norms of p are met by construction
        count = sum(number < self.rows for number in rows.numbers)
        # a rotor is a constraint that gives way: x'' + lambda / a = 0
        inertias, _, of_rotors, drift = self.rotor_rows(q, frames)
        soft = dict(enumerate([1.0 / inertia for inertia in inertias], start=self.rows))
        used = RowsInUse([*rows.numbers[:count], *soft], rows.scales and rows.scales[: count + len(soft)])
        right = np.concatenate([right, drift])
        pushed = sparse_vector(np.array(force))
        return sparse_solve(factor, pushed, [*b, *of_rotors], right, used, refine=True, softness=soft)

    def sparse_acceleration(self, q: Array, qdot: Array, rows: RowsInUse) -> tuple[Array, Scalar]:
        """qddot (7 n,) and the health of the elimination, over generic scalars."""
        return self._qddot(q, qdot, self.sparse_solution(q, qdot, rows))

    def _qddot(self, q: Array, qdot: Array, solution: Solution) -> tuple[Array, Scalar]:
        qddot = []
        for k, ((_, p), (_, pdot)) in enumerate(zip(self.split(q), self.split(qdot), strict=True)):
            rddot = [solution.acceleration.get(6 * k + i, 0.0) for i in range(3)]
            spin = np.array([solution.acceleration.get(6 * k + 3 + i, 0.0) for i in range(3)])
            c = -(pdot @ pdot) - self.damping * (p @ pdot) - self.stiffness * (0.5 * (p @ p - 1.0))
            # 2 L pddot = omegadot' and p^T pddot = c
            qddot.extend([*rddot, *(0.5 * matrix_l(p).T @ spin + p * (c / (p @ p)))])
        return np.array(qddot), solution.health

    def fastest_joint(self, q: Array, v: Array) -> str:
        """Name of a joint of the body whose dimensionless velocity is largest."""
        body = int(np.argmax(np.abs(v) / self.velocity_units)) // 7 + 1
        joints = (e.joint.name for e in self.equations if body in (e.first, e.second))
        return next(joints)

    def _weakest_joint(self, q: Array) -> str:
        """Name of the joint that weighs most in the dependent combination of constraint rows."""
        frames = self.frames(q, np.zeros(self.nv))
        left = singular_values(to_array(self.joint_jacobian(q, frames)[1], 6 * len(self.bodies)))[0][:, -1]
        weights: dict[str, float] = {}
        for owner, share in zip(self.row_owners, left**2, strict=False):  # the norms are not among them
            weights[owner] = weights.get(owner, 0.0) + share
        return max(weights, key=lambda owner: weights[owner])

    # What integrators, projection and assembly ask for

    def rate(self, q: Array, v: Array) -> Array:
        """qdot (nq,): the velocities themselves, the rates of carried angles, and the power."""
        if self.nq == self.nv:
            return v
        work = [self._power(q, v)] if self.scene.tracks_work else []
        return np.concatenate([v, carried_rates(self.measured, self.frames(q, v)), work])

    def _power(self, q: Array, v: Array) -> Scalar:
        """Power, W, of what is not in the potential energy; that of constraints is -lambda . Phi_t."""
        total = power(self.scene, *self.seen(q, v))
        if not self.scene.motions:
            return total
        if self.in_use is None:
            return total - self.phi_t()[: self.rows] @ self.solve(q, v)[1]
        multipliers = self.sparse_solution(q, v, self.in_use).multipliers
        return total - sum(rate * multipliers.get(k, 0.0) for k, rate in enumerate(self.phi_t()))

    def acceleration(self, q: Array, v: Array) -> Array:
        """qddot (7 n,)."""
        return self.solve(q, v)[0]

    def phi(self, q: Array) -> Array:
        """All residuals: Phi(q) and 1/2 (p^T p - 1)."""
        zero = np.zeros(self.nv)
        return np.concatenate([self.joint_phi(q), self.norm_terms(q, zero)[0]])

    def phi_t(self) -> Array:
        """Partial derivative of `phi` by time."""
        opening = [coupling.phi_t(self.time) for coupling in self.couplings]
        scleronomic = np.zeros(self.rows - len(opening))
        return np.concatenate([scleronomic, opening, np.zeros(len(self.bodies))])

    def phi_jacobian(self, q: Array) -> Array:
        """Derivative of `phi` by q."""
        return to_array(self.phi_and_jacobian(q)[1], self.nv)

    def phi_and_jacobian(self, q: Array) -> tuple[Array, Rows]:
        """All residuals and the nonzeros of their Jacobian."""
        zero = np.zeros(self.nv)
        phi_q, _ = self.joint_jacobian(q, self.frames(q, zero))
        return self.phi(q), [*phi_q, *self.norm_terms(q, zero)[1]]

    def rows_of(self, relative: Collection[int]) -> list[int]:
        """Rows of `phi` that hold these of the joint-coordinate form, and all that its tree holds."""
        cuts, used, number = SpanningTree(self.mechanism).cuts, set(relative), 0
        numbers: list[int] = []
        starts = np.cumsum([0, *(equations.count for equations in self.equations)])
        for joint, start in enumerate(starts[:-1]):
            if joint not in cuts:
                numbers.extend(range(start, starts[joint + 1]))
        for joint in cuts:
            for row in range(starts[joint], starts[joint + 1]):
                if number in used:
                    numbers.append(int(row))
                number += 1
        coupled = range(starts[-1], self.rows)
        numbers.extend(row for k, row in enumerate(coupled, start=number) if k in used)
        return sorted([*map(int, numbers), *range(self.rows, self.rows + len(self.bodies))])

    def retract(self, q: Array, step: Array) -> Array:
        """q + step with Euler parameters of norm 1; carried angles follow."""
        moved = []
        for r, p in self.split(q[: self.nv] + step):
            moved.extend([r, p / sqrt(p @ p)])
        if self.nq > self.nv:
            moved.append(q[self.nv : self.work.start] + carried_rates(self.measured, self.frames(q, step)))
            moved.append(q[self.work])
        return np.concatenate(moved)

    # Between this formulation's coordinates and what everybody understands

    def mass_properties(self) -> MassProperties:
        """What the bodies weigh: as the mechanism states."""
        return MassProperties.of(self.mechanism)

    def coordinates(self, state: State) -> tuple[Array, Array]:
        """q and qdot of a state: pdot = 1/2 G^T omega; no work done.

        Carried angles are within half a turn, or where couplings ask for.
        """
        parts, v, frames = [], [], state.frames()
        for k in range(1, len(self.mechanism.bodies)):
            p = state.quaternion[k]
            parts.extend([state.position[k], p])
            v.extend([state.linear_velocity[k], 0.5 * matrix_g(p).T @ state.angular_velocity[k]])
        work = np.zeros(self.nq - self.work.start)
        q = np.concatenate([*parts, carried_angles(self.measured, frames), work])
        angles = {key: c.carried for key, c in self.measured.items() if c.carried is not None}
        x = {key: seen.x for key, seen in self._measurements(q, frames).items()}
        for key, turn in turns(self.couplings, x, angles, self.time).items():
            q[angles[key]] += turn
        return q, np.concatenate(v)

    def state(self, q: Array, v: Array) -> State:
        """Body poses and velocities; Euler parameters as they are, not normalised."""
        frames = self.frames(q, v)
        return State(
            np.array([frame.position for frame in frames]),
            np.array([self.mechanism.bodies[0].quaternion, *(p for _, p in self.split(q))]),
            np.array([frame.velocity for frame in frames]),
            np.array([frame.angular_velocity for frame in frames]),
        )

    def velocity_transformation(self, q: Array) -> Array:
        """(6 b, 7 n): v and omega = 2 G pdot of body 0, 1, ... for each velocity."""
        rows = np.zeros((6 * len(self.mechanism.bodies), self.nv))
        for k, (_, p) in enumerate(self.split(q)):
            rows[6 * k + 6 : 6 * k + 9, 7 * k : 7 * k + 3] = np.eye(3)
            rows[6 * k + 9 : 6 * k + 12, 7 * k + 3 : 7 * k + 7] = 2.0 * matrix_g(p)
        return rows

    def evaluate(self, q: Array, v: Array) -> Evaluation:
        """Accelerations, reactions and energies at a state."""
        return self._evaluation(q, v, *self.solve(q, v))

    def sparse_evaluation(self, q: Array, v: Array, rows: RowsInUse) -> tuple[Evaluation, Scalar]:
        """`evaluate` by sparse elimination over generic scalars, and the health of that."""
        solution = self.sparse_solution(q, v, rows)
        multipliers = np.array([solution.multipliers.get(k, 0.0) for k in range(self.rows)])
        return self._evaluation(q, v, self._qddot(q, v, solution)[0], multipliers), solution.health

    def _evaluation(self, q: Array, v: Array, qddot: Array, multipliers: Array) -> Evaluation:
        frames = self.frames(q, v)
        ground = [np.zeros(3)]
        linear = ground + [rddot for rddot, _ in self.split(qddot)]
        angular = ground + [
            2.0 * matrix_g(p) @ pddot  # omega-dot = 2 G pddot, because Gdot pdot = 0
            for (_, p), (_, pddot) in zip(self.split(q), self.split(qddot), strict=True)
        ]
        arms = []
        for e in self.equations:
            pose = self.mechanism.bodies[e.second].pose
            arms.append(frames[e.second].rotation @ pose.point_to_body(e.joint.reaction_point))
        found = pushes(self.mechanism, self.equations, self.couplings, self.measured, frames, multipliers)
        forces, torques = at_joint_points(self.mechanism, arms, found)
        kinetic, potential = energies(self.scene, frames, [body.inertia for body in self.mechanism.bodies])
        seen = self._measurements(q, frames)
        springs = springs_energy(self.scene, self.poses, frames, seen)
        return Evaluation(
            self.state(q, v),
            np.array(linear),
            np.array(angular),
            forces,
            torques,
            self.applied(q, frames)[0],
            kinetic + rotors_energy(self.scene, frames, seen),
            potential + springs,
            q[self.work][0] if self.scene.tracks_work else None,
        )
