"""The paper's equations of motion: Cartesian coordinates, Euler parameters, Lagrange multipliers.

Equation (21), body 1 (the ground) left out:

    | M      B^T |            | g - b                                     |
    | P      0   | | qddot  | | -c                                        |
    |            | |        | =
    | Phi_q  0   | | -lambda| | gamma - K_D (Phi_q qdot) - K_P Phi(q)     |

with q = (r, p) of each body. Each symbol is the method of that name below. Two points go beyond the printed
equation, as the list of errata says: the Euler-parameter rows are stabilized like the others (erratum 11),
and the ground takes no part (erratum 4), which leaves 42 coordinates, 34 + 6 constraints and 2 degrees of
freedom of the tracker. Couplings and prescribed motions are further rows of Phi and B; rotors are a section
of their own.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from newton_euler.equations import dense, sparse
from newton_euler.equations.applied_forces import body_wrenches
from newton_euler.equations.couplings import Measured
from newton_euler.equations.formulation import Formulation
from newton_euler.equations.model_control import model_control
from newton_euler.equations.reactions import at_joint_points, pushes
from newton_euler.equations.redundancy import constraint_rank, rows_left_out, without
from newton_euler.equations.sparse import Equations, Rows, RowsInUse, Solution, add, spread, to_array
from newton_euler.equations.system import fastest_joint
from newton_euler.errors import SingularityError
from newton_euler.model import balls
from newton_euler.model.constraints import Frame, Jacobian
from newton_euler.model.euler_parameters import matrix_g, matrix_l, rotation
from newton_euler.model.joint import Key
from newton_euler.model.mechanism import Body
from newton_euler.model.scene import Scene
from newton_euler.model.spanning_tree import SpanningTree
from newton_euler.model.state import State
from newton_euler.scalars import Array, Scalar, cross, sqrt, zeros


class Rotors(NamedTuple):
    """Armatures a of coordinates x: d2x/dt2 = Phi_q qddot - gamma, and a force on x acts through B^T."""

    inertias: list[Scalar]  # kg m^2 or kg
    on_q: Rows  # of Phi_q
    on_b: Rows  # of B
    gammas: list[Scalar]


class Cartesian(Formulation):
    """Cartesian formulation of a scene. State: q (7 n,), qdot (7 n,) of the n moving bodies.

    The residuals `phi` are Phi(q) of joints and couplings, then 1/2 (p^T p - 1) of the bodies.
    """

    name = "cartesian"

    def __init__(self, scene: Scene, alpha: float = 0.0) -> None:
        """Baumgarte's gains are K_D = 2 alpha, K_P = alpha^2 (Appendix B); none for alpha = 0."""
        mechanism = scene.mechanism
        self.bodies = mechanism.bodies[1:]
        n, poses = len(self.bodies), [body.pose for body in mechanism.bodies]
        super().__init__(scene, alpha, poses, mechanism.equations, mechanism.equations, 7 * n, 7 * n)
        self.inertias = [body.inertia for body in mechanism.bodies]
        self.phi_units = np.concatenate([self.phi_units, np.ones(n)])
        self.row_owners = (*self.row_owners, *(body.name for body in self.bodies))
        self.quaternions = [slice(k + 3, k + 7) for k in range(0, self.nv, 7)]
        size, mass = mechanism.size, sum(body.mass for body in self.bodies)
        self.velocity_units = self.coordinate_units = np.tile([size] * 3 + [1.0] * 4, n)
        self.force_units = np.tile([mass * size] * 3 + [mass * size**2] * 3, n)

    # Section 2: coordinates

    def split(self, q: Array) -> list[tuple[Array, Array]]:
        """Return (r, p) of each moving body, or their rates."""
        return [(q[k : k + 3], q[k + 3 : k + 7]) for k in range(0, self.nv, 7)]

    def frames(self, q: Array, v: Array) -> list[Frame]:
        """Compute the frames of all bodies: R = G L^T, eq. (3), and omega = 2 G pdot."""
        return self.remembered(q, v, self._frames)

    def _frames(self, q: Array, qdot: Array) -> list[Frame]:
        ground = self.mechanism.bodies[0]
        frames = [Frame(ground.center_of_mass, ground.pose.rotation, np.zeros(3), np.zeros(3))]
        for (r, p), (rdot, pdot) in zip(self.split(q), self.split(qdot), strict=True):
            frames.append(Frame(r, rotation(p), rdot, 2.0 * matrix_g(p) @ pdot))
        return frames

    def norms(self, q: Array) -> Array:
        """Compute 1/2 (p^T p - 1) of each body, (n,), eq. (1)."""
        return np.array([0.5 * (p @ p - 1.0) for _, p in self.split(q)])

    def c(self, qdot: Array) -> Array:
        """Compute c = pdot^T pdot of each body, (n,), eqs (2) and (20)."""
        return np.array([pdot @ pdot for _, pdot in self.split(qdot)])

    def P(self, q: Array) -> Rows:
        """Compute the nonzeros of P (n, 7 n), eqs (15) and (20): p_i^T of each body."""
        rows: Rows = [{} for _ in self.bodies]
        for k, (_, p) in enumerate(self.split(q)):
            spread(rows[k : k + 1], 7 * k + 3, p[None])
        return rows

    # Section 2: constraints. Those of a joint are in `newton_euler.model.joint_kinds`, eqs (25) to (28).

    def Phi(self, q: Array, qdot: Array) -> Array:
        """Compute Phi(q) (k,), eq. (4): joints, then couplings."""
        frames, measured = self.frames(q, qdot), self.measured(q, qdot)
        phis = [e.phi(frames[e.first], frames[e.second]) for e in self.equations]
        return np.concatenate([*phis, [c.phi(measured, self.time) for c in self.couplings]])

    def gamma(self, q: Array, qdot: Array) -> Array:
        """Compute gamma (k,), eq. (5): joints, then couplings."""
        frames, measured = self.frames(q, qdot), self.measured(q, qdot)
        gammas = [e.gamma(frames[e.first], frames[e.second]) for e in self.equations]
        return np.concatenate([*gammas, [c.gamma(measured, self.time) for c in self.couplings]])

    def Phi_q_and_B(self, q: Array, qdot: Array) -> tuple[Rows, Rows]:
        """Compute the nonzeros of Phi_q (k, 7 n), eq. (5), and B (k, 6 n), eqs (18) and (20).

        Phi_p = 2 Phi_theta G, since delta theta = 2 G delta p. It makes the paper's
        B = [Phi_r, 1/2 Phi_p L^T] equal to [Phi_r, Phi_theta R], with no product to work out,
        because G L^T = R.
        """
        frames = self.frames(q, qdot)
        phi_q: Rows = []
        b: Rows = []
        for e in self.equations:
            blocks = e.jacobian(frames[e.first], frames[e.second])
            on_q, on_b = self._rows(q, frames, e.first, e.second, blocks)
            phi_q.extend(on_q)
            b.extend(on_b)
        measured = self.measured(q, qdot)
        for coupling in self.couplings:
            totals: Rows = [{}, {}]
            for key, slope in coupling.seen_slopes(measured).items():
                first, second = self.between[key].first, self.between[key].second
                blocks = Jacobian(*(slope * block for block in measured[key].jacobian))
                for total, (share,) in zip(totals, self._rows(q, frames, first, second, blocks), strict=True):
                    for k, entry in share.items():
                        add(total, k, entry)
            phi_q.append(totals[0])
            b.append(totals[1])
        return phi_q, b

    def right_side(self, q: Array, qdot: Array) -> Array:
        """Compute gamma - K_D (Phi_q qdot) - K_P Phi(q), eqs (6), (8) and (9) with erratum 1."""
        gamma = self.gamma(q, qdot)
        if not (self.K_D or self.K_P):
            return gamma
        return gamma - self.K_D * self.phi_rate(q, qdot) - self.K_P * self.Phi(q, qdot)

    def _rows(
        self, q: Array, frames: list[Frame], first: int, second: int, blocks: Jacobian
    ) -> tuple[Rows, Rows]:
        """Compute the nonzeros of rows of Phi_q and of B for a Jacobian between two bodies."""
        r_i, theta_i, r_j, theta_j = blocks
        on_q: Rows = [{} for _ in r_i]
        on_b: Rows = [{} for _ in r_i]
        for body, phi_r, phi_theta in ((first, r_i, theta_i), (second, r_j, theta_j)):
            if body == 0:
                continue
            k = body - 1
            p = q[7 * k + 3 : 7 * k + 7]
            spread(on_q, 7 * k, np.hstack([phi_r, 2.0 * phi_theta @ matrix_g(p)]))
            spread(on_b, 6 * k, np.hstack([phi_r, phi_theta @ frames[body].rotation]))
        return on_q, on_b

    # Section 3: bodies

    def M(self, q: Array) -> Array:
        """Compute M (6 n, 7 n), eq. (20): N_i = m_i I and 2 J'_i L_i on its diagonal, eqs (10) to (15)."""
        mass = zeros((6 * len(self.bodies), self.nv), q)
        for k, (body, (_, p)) in enumerate(zip(self.bodies, self.split(q), strict=True)):
            mass[6 * k : 6 * k + 3, 7 * k : 7 * k + 3] = body.mass * np.eye(3)
            mass[6 * k + 3 : 6 * k + 6, 7 * k + 3 : 7 * k + 7] = 2.0 * body.inertia @ matrix_l(p)
        return mass

    def b(self, q: Array, qdot: Array) -> Array:
        """Compute b (6 n,), eq. (20): 0 and L_i H_i pdot_i of each body, eq. (14)."""
        terms = [np.zeros(0)]
        for body, (_, p), (_, pdot) in zip(self.bodies, self.split(q), self.split(qdot), strict=True):
            terms += [np.zeros(3), self.l_h_pdot(body, p, pdot)]
        return np.concatenate(terms)

    def l_h_pdot(self, body: Body, p: Array, pdot: Array) -> Array:
        """Compute L H pdot (3,) of a body with H = 4 Ldot^T J' L, eq. (13).

        With omega' = 2 L pdot, eq. (11), L H pdot = omega' x J' omega' + 2 (p^T pdot) J' omega'. The last
        term is zero where eq. (1) holds, and eq. (12) leaves it out.
        """
        omega = 2.0 * matrix_l(p) @ pdot
        momentum = body.inertia @ omega
        return cross(omega, momentum) + 2.0 * (p @ pdot) * momentum

    def g(self, q: Array, qdot: Array) -> Array:
        """Compute g (6 n,), eqs (20) and (24): applied f_i in the world and n'_i in the body."""
        frames = self.frames(q, qdot)
        applied = body_wrenches(self.scene, self.seen(q, qdot))
        wrenches = [
            wrench + np.concatenate([body.mass * self.scene.gravity, np.zeros(3)])
            for body, wrench in zip(self.mechanism.bodies, applied, strict=True)
        ]
        measured = self.measured(q, qdot)
        for law, u in zip(self.scene.joint_forces, self.joint_forces(q, qdot), strict=True):
            (r_i, theta_i, r_j, theta_j), driven = measured[law.key].jacobian, self.between[law.key]
            for body, r, theta in ((driven.first, r_i, theta_i), (driven.second, r_j, theta_j)):
                wrenches[body] = wrenches[body] + u * np.concatenate([r[0], theta[0]])
        parts = [np.zeros(0)]
        for wrench, frame in zip(wrenches[1:], frames[1:], strict=True):
            parts += [wrench[:3], frame.rotation.T @ wrench[3:]]
        return np.concatenate(parts)

    def model_forces(self, q: Array, v: Array) -> Mapping[Key, Scalar]:
        return model_control(self).forces(self, q, v)

    # Extension: rotors

    def rotors(self, q: Array, qdot: Array) -> Rotors:
        """Compute the rows of armatures: of one coordinate each, of three angular velocities on balls."""
        frames, measured = self.frames(q, qdot), self.measured(q, qdot)
        found = Rotors([], [], [], [])
        for armature in self.scene.armatures:
            if armature.on_ball:
                first, second = balls.ends(self.mechanism, armature.joint)
                jacobian, gammas = balls.SPIN, balls.spin_gamma(frames[first], frames[second])
            else:
                first, second = self.between[armature.key].first, self.between[armature.key].second
                seen = measured[armature.key]
                jacobian, gammas = seen.jacobian, np.array([seen.gamma])
            on_q, on_b = self._rows(q, frames, first, second, jacobian)
            found.inertias.extend([armature.inertia] * len(gammas))
            found.on_q.extend(on_q)
            found.on_b.extend(on_b)
            found.gammas.extend(gammas)
        return found

    # Equation (21), solved with dense matrices

    def equation_21(self, q: Array, qdot: Array) -> tuple[Array, Array]:
        """Assemble the matrix and the right side of eq. (21) from eqs (16), (19) and (20) of the bodies."""
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
        """Compute M (6 n, 7 n) and g - b (6 n,), with rotors."""
        M, force = self.M(q), self.g(q, v) - self.b(q, v)
        for inertia, on_q, on_b, gamma in zip(*self.rotors(q, v), strict=True):
            push = inertia * to_array([on_b], len(force))[0]  # -a (Phi_q qddot - gamma) on the coordinate
            M = M + np.outer(push, to_array([on_q], self.nv)[0])
            force = force + gamma * push
        return M, force

    def solve(self, q: Array, v: Array) -> tuple[Array, Array]:
        """Solve equation (21), as eq. (22) does, for qddot (7 n,) and lambda (k,).

        lambda is the smallest one where constraints are redundant.

        Raises:
            SingularityError: if qddot is not unique all the same.
        """
        matrix, right = self.equation_21(q, v)
        n, unused = self.nv, rows_left_out(self)
        matrix[n:], right[n:] = without(matrix[n:], unused), without(right[n:], unused)
        force_units = np.concatenate([self.force_units, np.ones(len(self.bodies))])
        units = self.phi_units[: self.rows], self.velocity_units, force_units
        try:
            max_rank = constraint_rank(self) - len(self.bodies)  # Euler parameters' norms are rows of A
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
        """Factorize M over generic scalars; accelerations are (rddot, omegadot' / p^T p) of each body.

        With qddot eliminated from equation (21), M is block diagonal and B M^-1 B^T as sparse as the
        joints: omegadot' = 2 L pddot, eq. (11), and Phi_p pddot = Phi_theta R omegadot' / (p^T p).
        """
        _, B = self.Phi_q_and_B(q, v)
        right = self.right_side(q, v)
        force = self.g(q, v)
        mass: Rows = [{} for _ in force]
        scales = []
        parts = zip(self.bodies, self.split(q), self.split(v), strict=True)
        for k, (body, (_, p), (_, pdot)) in enumerate(parts):
            linear, angular = slice(6 * k, 6 * k + 3), slice(6 * k + 3, 6 * k + 6)
            term = self.l_h_pdot(body, p, pdot)
            scales.append(p @ p)
            force[angular] = force[angular] - term  # g - b
            spread(mass[linear], linear.start, body.mass * np.eye(3))  # N_i
            spread(mass[angular], angular.start, body.inertia)  # J'_i
        factor = sparse.factorize(mass, range(len(mass)))
        for k, scale in enumerate(scales):
            for i in range(6 * k + 3, 6 * k + 6):
                factor.inverse_pivots[i] = factor.inverse_pivots[i] / scale
        # the rows of the norms of p are met by construction
        count = sum(number < self.rows for number in rows.numbers)
        # a rotor is a constraint that gives way: x'' + lambda / a = 0
        inertias, _, of_rotors, gammas = self.rotors(q, v)
        soft = dict(enumerate([1.0 / inertia for inertia in inertias], start=self.rows))
        usual = rows.scales and rows.scales[: count + len(soft)]
        used = RowsInUse([*rows.numbers[:count], *soft], usual, flags=rows.flags)
        push, right = sparse.sparse_vector(force), np.concatenate([right, gammas])
        return Equations(factor, push, [*B, *of_rotors], right, used, refine=True, softness=soft)

    def sparse_residuals(
        self, q: Array, v: Array, rows: RowsInUse, accelerations: Array, multipliers: Array
    ) -> tuple[Array, Array]:
        """Compute the residuals without B: constraint by constraint."""
        equations, frames = self.sparse_equations(q, v, rows), self.frames(q, v)
        force, right = zeros(len(accelerations), accelerations), -equations.gamma.astype(object)
        for k, share in equations.force.items():
            force[k] = -share
        moving = frames[:1]  # with accelerations in place of velocities
        for k, (body, (_, p)) in enumerate(zip(self.bodies, self.split(q), strict=True)):
            linear, angular = slice(6 * k, 6 * k + 3), slice(6 * k + 3, 6 * k + 6)
            spin = accelerations[angular]
            force[linear] = force[linear] + body.mass * accelerations[linear]
            force[angular] = force[angular] + (p @ p) * (body.inertia @ spin)
            r, rotation = frames[k + 1][:2]
            moving.append(Frame(r, rotation, accelerations[linear], rotation @ spin))
        given, start = sparse.sparse_vector(accelerations), 0
        for e in self.equations:
            own = slice(start, start + e.count)
            blocks = e.jacobian(frames[e.first], frames[e.second])
            right[own] = right[own] + blocks.rate(moving[e.first], moving[e.second])
            start += e.count
        of_joints = multipliers[: self.rows].copy()
        of_joints[start:] = 0.0
        for push in pushes(self, frames, self.measured(q, v), of_joints):
            for k, wrench in ((push.first, push.on_first), (push.second, push.on_second)):
                if k > 0:
                    turned = np.concatenate([wrench[:3], frames[k].rotation.T @ wrench[3:]])
                    force[6 * k - 6 : 6 * k] = force[6 * k - 6 : 6 * k] - turned
        for i in range(start, len(equations.jacobian)):
            soft = (equations.softness or {}).get(i, 0.0)
            right[i] = right[i] + sparse.dot(equations.jacobian[i], given) + soft * multipliers[i]
            for k, entry in equations.jacobian[i].items():
                force[k] = force[k] - entry * multipliers[i]
        return force, right

    def sparse_coordinates(self, q: Array, v: Array, keys: Sequence[Key]) -> tuple[Rows, Array]:
        frames, measured, rows = self.frames(q, v), self.measured(q, v), list[dict[int, Scalar]]()
        for key in keys:
            first, second = self.between[key].first, self.between[key].second
            rows.extend(self._rows(q, frames, first, second, measured[key].jacobian)[1])
        return rows, np.array([measured[key].gamma for key in keys])

    def sparse_vdot(self, q: Array, v: Array, solution: Solution) -> Array:
        """Compute qddot (7 n,) from a sparse solution: 2 L pddot = omegadot' and p^T pddot = -c, eq. (2)."""
        qddot = []
        for k, ((_, p), (_, pdot)) in enumerate(zip(self.split(q), self.split(v), strict=True)):
            rddot = [solution.acceleration.get(6 * k + i, 0.0) for i in range(3)]
            spin = np.array([solution.acceleration.get(6 * k + 3 + i, 0.0) for i in range(3)])
            minus_c = -(pdot @ pdot) - self.K_D * (p @ pdot) - self.K_P * (0.5 * (p @ p - 1.0))
            qddot.extend([*rddot, *(0.5 * matrix_l(p).T @ spin + p * (minus_c / (p @ p)))])
        return np.array(qddot)

    def mass_rows(self, q: Array) -> Rows:
        """Compute the nonzeros of the matrix (7 n, 7 n) of the kinetic energy: m and 4 L^T J' L."""
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

    # As integrators, projection and assembly see it

    def orientations(self, q: Array, v: Array) -> list[Array]:
        """Return the Euler parameters (4,) of all bodies as they are, not normalized."""
        return [self.mechanism.bodies[0].quaternion, *(p for _, p in self.split(q))]

    def measured(self, q: Array, v: Array) -> dict[Key, Measured]:
        frames = self.frames(q, v)
        return {key: coordinate.measure(q, frames) for key, coordinate in self.between.items()}

    def own_coordinates(self, state: State) -> tuple[Array, Array]:
        """Compute (r, p) and their rates in a state: pdot = 1/2 G^T omega."""
        parts, v = [np.zeros(0)], [np.zeros(0)]
        for k in range(1, len(self.mechanism.bodies)):
            p = state.quaternion[k]
            parts += [state.position[k], p]
            v += [state.linear_velocity[k], 0.5 * matrix_g(p).T @ state.angular_velocity[k]]
        return np.concatenate(parts), np.concatenate(v)

    def own_rate(self, q: Array, v: Array) -> Array:
        return v

    def own_retract(self, q: Array, step: Array) -> Array:
        moved = []
        for r, p in self.split(q[: self.nv] + step):
            moved.extend([r, p / sqrt(p @ p)])
        return np.concatenate(moved)

    def phi_and_jacobian(self, q: Array) -> tuple[Array, Rows]:
        """Compute Phi(q) and 1/2 (p^T p - 1), and the nonzeros of their Jacobian."""
        rest = np.zeros(self.nv)
        jacobian = [*self.Phi_q_and_B(q, rest)[0], *self.P(q)]
        return np.concatenate([self.Phi(q, rest), self.norms(q)]), jacobian

    def rows_of(self, relative: Collection[int]) -> list[int]:
        left_out = set(np.delete(self.closing_rows(), list(relative)).tolist())
        return [row for row in range(len(self.phi_units)) if row not in left_out]

    def closing_rows(self) -> list[int]:
        rows = np.split(np.arange(self.rows), np.cumsum([equations.count for equations in self.equations]))
        of_cuts = [rows[joint] for joint in SpanningTree(self.mechanism).cuts]
        closing: list[int] = np.concatenate([*of_cuts, rows[-1]]).tolist()
        return closing

    def velocity_transformation(self, q: Array) -> Array:
        rows = np.zeros((6 * len(self.mechanism.bodies), self.nv))
        for k, (_, p) in enumerate(self.split(q)):
            rows[6 * k + 6 : 6 * k + 9, 7 * k : 7 * k + 3] = np.eye(3)
            rows[6 * k + 9 : 6 * k + 12, 7 * k + 3 : 7 * k + 7] = 2.0 * matrix_g(p)
        return rows

    def body_accelerations(self, q: Array, v: Array, vdot: Array) -> tuple[Array, Array]:
        """Compute rddot and omegadot = 2 G pddot, because Gdot pdot = 0, (b, 3) each."""
        linear, angular = [np.zeros(3)], [np.zeros(3)]
        for (_, p), (rddot, pddot) in zip(self.split(q), self.split(vdot), strict=True):
            linear.append(rddot)
            angular.append(2.0 * matrix_g(p) @ pddot)
        return np.array(linear), np.array(angular)

    def reactions(
        self, q: Array, v: Array, vdot: Array, bodies: tuple[Array, Array], multipliers: Array
    ) -> tuple[Array, Array]:
        """Compute forces and torques (j, 3) of joints from eq. (17)."""
        frames = self.frames(q, v)
        return at_joint_points(self, frames, pushes(self, frames, self.measured(q, v), multipliers))
