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

import numpy as np

from newton_euler.constraints import Frame
from newton_euler.driven import carried_angles, carried_rates, driven
from newton_euler.errors import SingularityError
from newton_euler.euler_parameters import matrix_g, matrix_l, rotation
from newton_euler.scalars import Array, Scalar, cross, sqrt, zeros
from newton_euler.scene import Scene
from newton_euler.solve import independent_rows
from newton_euler.sparse import Rows, RowsInUse, Solution, add, dense, factorise, sparse_vector
from newton_euler.sparse import solve_constrained as sparse_solve
from newton_euler.state import Evaluation, MassProperties, State, energies


def _spread(rows: Rows, start: int, block: Array) -> None:
    """Add a block (rows, columns) whose first column is `start`."""
    for row, entries in zip(rows, block, strict=True):
        for k, entry in enumerate(entries):
            add(row, start + k, entry)


class Cartesian:
    """Cartesian formulation of a scene. State: q (7 n,), qdot (7 n,) of the n moving bodies."""

    name = "cartesian"

    def __init__(self, scene: Scene, alpha: float = 0.0) -> None:
        """Baumgarte gains are K_D = 2 alpha, K_P = alpha^2 (Appendix B); none for alpha = 0."""
        self.scene = scene
        self.mechanism = scene.mechanism
        self.equations = scene.mechanism.equations
        self.bodies = scene.mechanism.bodies[1:]
        self.nq = self.nv = 7 * len(self.bodies)
        self.rows = sum(equations.count for equations in self.equations)
        self.damping, self.stiffness = 2.0 * alpha, alpha * alpha
        self.driven = driven(
            [(law, self.equations[self.mechanism.joint_index(law.joint)]) for law in scene.control], self.nq
        )
        self.nq += sum(drive.carried is not None for drive in self.driven)
        size, mass = self.mechanism.size, sum(body.mass for body in self.bodies)
        self.row_units = np.concatenate([np.zeros(0), *(e.units(size) for e in self.equations)])
        self.phi_units = np.concatenate([self.row_units, np.ones(len(self.bodies))])
        self.quaternions = [slice(k + 3, k + 7) for k in range(0, self.nv, 7)]
        self.velocity_units = np.tile([size] * 3 + [1.0] * 4, len(self.bodies))
        self.force_units = np.tile([mass * size] * 3 + [mass * size**2] * 3, len(self.bodies))

    # Bodies

    def split(self, q: Array) -> list[tuple[Array, Array]]:
        """(r, p) of each moving body, or their rates."""
        return [(q[k : k + 3], q[k + 3 : k + 7]) for k in range(0, self.nv, 7)]

    def frames(self, q: Array, qdot: Array) -> list[Frame]:
        """Frames of all bodies: R = G L^T, eq. (3), and omega = 2 G pdot."""
        ground = self.mechanism.bodies[0]
        frames = [Frame(ground.center_of_mass, ground.pose.rotation, np.zeros(3), np.zeros(3))]
        for (r, p), (rdot, pdot) in zip(self.split(q), self.split(qdot), strict=True):
            frames.append(Frame(r, rotation(p), rdot, 2.0 * matrix_g(p) @ pdot))
        return frames

    # The blocks of equation (21)

    def mass_matrix(self, q: Array) -> Array:
        """M (6 n, 7 n): N_i and 2 J' L_i on its diagonal."""
        mass = zeros((6 * len(self.bodies), self.nv), q)
        for k, (body, (_, p)) in enumerate(zip(self.bodies, self.split(q), strict=True)):
            mass[6 * k : 6 * k + 3, 7 * k : 7 * k + 3] = body.mass * np.eye(3)
            mass[6 * k + 3 : 6 * k + 6, 7 * k + 3 : 7 * k + 7] = 2.0 * body.inertia @ matrix_l(p)
        return mass

    def velocity_terms(self, q: Array, qdot: Array) -> Array:
        """b (6 n,): 0 and L_i H_i pdot_i with H = 4 Ldot^T J' L, eqs (13) and (14)."""
        b = []
        for body, (_, p), (_, pdot) in zip(self.bodies, self.split(q), self.split(qdot), strict=True):
            h = 4.0 * matrix_l(pdot).T @ body.inertia @ matrix_l(p)
            b.append(np.concatenate([np.zeros(3), matrix_l(p) @ h @ pdot]))
        return np.concatenate(b)

    def applied(self, q: Array, frames: list[Frame]) -> tuple[Array, Array]:
        """Actuator forces (a,), and g (6 n,): f_i in the world and n'_i in the body, eq. (24)."""
        weights = [body.mass * self.scene.gravity for body in self.mechanism.bodies]
        wrenches = [np.concatenate([weight, np.zeros(3)]) for weight in weights]
        forces = []
        for law, drive in zip(self.scene.control, self.driven, strict=True):
            first, second = drive.bodies
            x, rate, (r_i, theta_i, r_j, theta_j) = drive.measure(q, frames[first], frames[second])
            u = law.force(x, rate)
            wrenches[first] = wrenches[first] + u * np.concatenate([r_i[0], theta_i[0]])
            wrenches[second] = wrenches[second] + u * np.concatenate([r_j[0], theta_j[0]])
            forces.append(u)
        g = [
            np.concatenate([wrench[:3], frame.rotation.T @ wrench[3:]])
            for wrench, frame in zip(wrenches[1:], frames[1:], strict=True)
        ]
        return np.array(forces), np.concatenate(g)

    def measure(self, q: Array, qdot: Array) -> list[tuple[Scalar, Scalar]]:
        """Coordinate (m or rad) and rate of each control law."""
        frames = self.frames(q, qdot)
        return [drive.measure(q, *(frames[k] for k in drive.bodies))[:2] for drive in self.driven]

    def joint_phi(self, q: Array) -> Array:
        """Phi(q) (k,), eq. (4)."""
        frames = self.frames(q, np.zeros(self.nv))
        return np.concatenate([e.phi(frames[e.first], frames[e.second]) for e in self.equations])

    def joint_gamma(self, frames: list[Frame]) -> Array:
        """gamma (k,), eq. (5)."""
        return np.concatenate([e.gamma(frames[e.first], frames[e.second]) for e in self.equations])

    def joint_jacobian(self, q: Array, frames: list[Frame]) -> tuple[Rows, Rows]:
        """Phi_q (k, 7 n) and B (k, 6 n), as their nonzeros.

        Phi_p = 2 Phi_theta G, since delta theta = 2 G delta p. It makes the paper's
        B = [Phi_r, 1/2 Phi_p L^T] equal to [Phi_r, Phi_theta R], with no product to work out,
        because G L^T = R.
        """
        phi_q: Rows = []
        b: Rows = []
        for e in self.equations:
            r_i, theta_i, r_j, theta_j = e.jacobian(frames[e.first], frames[e.second])
            on_q: Rows = [{} for _ in range(e.count)]
            on_b: Rows = [{} for _ in range(e.count)]
            for body, phi_r, phi_theta in ((e.first, r_i, theta_i), (e.second, r_j, theta_j)):
                if body == 0:
                    continue
                k = body - 1
                p = q[7 * k + 3 : 7 * k + 7]
                _spread(on_q, 7 * k, np.hstack([phi_r, 2.0 * phi_theta @ matrix_g(p)]))
                _spread(on_b, 6 * k, np.hstack([phi_r, phi_theta @ frames[body].rotation]))
            phi_q.extend(on_q)
            b.extend(on_b)
        return phi_q, b

    def norm_terms(self, q: Array, qdot: Array) -> tuple[Array, Rows, Array]:
        """1/2 (p^T p - 1) (n,), its Jacobian P (n, 7 n) and c = pdot^T pdot (n,), eqs (1) and (2)."""
        residual, c = [], []
        p_rows: Rows = [{} for _ in self.bodies]
        for k, ((_, p), (_, pdot)) in enumerate(zip(self.split(q), self.split(qdot), strict=True)):
            residual.append(0.5 * (p @ p - 1.0))
            _spread(p_rows[k : k + 1], 7 * k + 3, p[None])
            c.append(pdot @ pdot)
        return np.array(residual), p_rows, np.array(c)

    def system(self, q: Array, qdot: Array) -> tuple[Array, Array]:
        """Matrix and right side of equation (21); its unknowns are (qddot, -lambda)."""
        frames = self.frames(q, qdot)
        mass, velocity = self.mass_matrix(q), self.velocity_terms(q, qdot)
        g = self.applied(q, frames)[1]
        phi, gamma = self.joint_phi(q), self.joint_gamma(frames)
        n6, n7 = len(mass), self.nv
        phi_q, b = (dense(rows, n) for rows, n in zip(self.joint_jacobian(q, frames), (n7, n6), strict=True))
        norm, p_rows, c = self.norm_terms(q, qdot)
        p_matrix = dense(p_rows, n7)
        matrix = zeros((n7 + self.rows, n7 + self.rows), q)
        matrix[:n6, :n7], matrix[:n6, n7:] = mass, b.T
        matrix[n6:n7, :n7] = p_matrix
        matrix[n7:, :n7] = phi_q
        right = np.concatenate(
            [
                g - velocity,
                -c - self.damping * (p_matrix @ qdot) - self.stiffness * norm,
                gamma - self.damping * (phi_q @ qdot) - self.stiffness * phi,
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
        return self.velocity_units * unknowns[:n], -(combine @ (unknowns[n:] / share))

    def sparse_solution(self, q: Array, qdot: Array, rows: RowsInUse) -> Solution:
        """(rddot, omegadot'/p^T p) of each body and lambda, by sparse elimination over generic scalars.

        `rows` of `phi` are used; the others must follow from them.

        Equation (21) with qddot eliminated: M is block diagonal and B M^-1 Phi_q^T as sparse as the
        joints. omegadot' = 2 L pddot and Phi_p pddot = Phi_theta R omegadot' / (p^T p).
        """
        frames = self.frames(q, qdot)
        _, b = self.joint_jacobian(q, frames)
        right = self.joint_gamma(frames)
        rates = np.concatenate(
            [
                e.jacobian(frames[e.first], frames[e.second]).rate(frames[e.first], frames[e.second])
                for e in self.equations
            ]
        )
        if self.damping or self.stiffness:
            right = right - self.damping * rates - self.stiffness * self.joint_phi(q)
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
        rows = RowsInUse(rows.numbers[:count], rows.scales and rows.scales[:count])
        return sparse_solve(factor, sparse_vector(np.array(force)), b, right, rows, refine=True)

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
        left = np.linalg.svd(dense(self.joint_jacobian(q, frames)[1], 6 * len(self.bodies)))[0][:, -1]
        owners = np.repeat(np.arange(len(self.equations)), [e.count for e in self.equations])
        weights = np.bincount(owners, weights=left**2, minlength=len(self.equations))
        return self.mechanism.joint_names[int(np.argmax(weights))]

    # What integrators, projection and assembly ask for

    def rate(self, q: Array, v: Array) -> Array:
        """qdot (nq,): the velocities themselves, and the rates of carried angles."""
        return v if self.nq == self.nv else np.concatenate([v, carried_rates(self.driven, self.frames(q, v))])

    def acceleration(self, q: Array, v: Array) -> Array:
        """qddot (7 n,)."""
        return self.solve(q, v)[0]

    def phi(self, q: Array) -> Array:
        """All residuals: Phi(q) and 1/2 (p^T p - 1)."""
        zero = np.zeros(self.nv)
        return np.concatenate([self.joint_phi(q), self.norm_terms(q, zero)[0]])

    def phi_jacobian(self, q: Array) -> Array:
        """Derivative of `phi` by q."""
        return dense(self.phi_and_jacobian(q)[1], self.nv)

    def phi_and_jacobian(self, q: Array) -> tuple[Array, Rows]:
        """All residuals and the nonzeros of their Jacobian."""
        zero = np.zeros(self.nv)
        phi_q, _ = self.joint_jacobian(q, self.frames(q, zero))
        return self.phi(q), [*phi_q, *self.norm_terms(q, zero)[1]]

    def retract(self, q: Array, step: Array) -> Array:
        """q + step with Euler parameters of norm 1; carried angles follow."""
        moved = []
        for r, p in self.split(q[: self.nv] + step):
            moved.extend([r, p / sqrt(p @ p)])
        if self.nq > self.nv:
            moved.append(q[self.nv :] + carried_rates(self.driven, self.frames(q, step)))
        return np.concatenate(moved)

    # Between this formulation's coordinates and what everybody understands

    def mass_properties(self) -> MassProperties:
        """What the bodies weigh: as the mechanism states."""
        return MassProperties.of(self.mechanism)

    def coordinates(self, state: State) -> tuple[Array, Array]:
        """q and qdot of a state: pdot = 1/2 G^T omega; carried angles within half a turn."""
        q, v = [], []
        for k in range(1, len(self.mechanism.bodies)):
            p = state.quaternion[k]
            q.extend([state.position[k], p])
            v.extend([state.linear_velocity[k], 0.5 * matrix_g(p).T @ state.angular_velocity[k]])
        return np.concatenate([*q, carried_angles(self.driven, state.frames())]), np.concatenate(v)

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
        forces, torques, row = [], [], 0
        for e in self.equations:
            blocks = e.jacobian(frames[e.first], frames[e.second])
            share = multipliers[row : row + e.count]
            row += e.count
            force, torque = blocks.r_second.T @ share, blocks.theta_second.T @ share  # eq. (17)
            pose = self.mechanism.bodies[e.second].pose
            s = frames[e.second].rotation @ pose.point_to_body(e.joint.reaction_point)
            forces.append(force)
            torques.append(torque - cross(s, force))
        return Evaluation(
            self.state(q, v),
            np.array(linear),
            np.array(angular),
            np.array(forces),
            np.array(torques),
            self.applied(q, frames)[0],
            *energies(self.scene, frames, [body.inertia for body in self.mechanism.bodies]),
        )
