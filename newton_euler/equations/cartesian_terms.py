"""Terms of the equations of motion in Cartesian coordinates, each a method named by its symbol in the paper.

The paper is S. Srang, S. Ath, M. Yamakita, Advances in Science, Technology and Engineering Systems Journal
5(5), 709-716, 2020; `docs/explanation/errata.md` lists its errata. `newton_euler.equations.cartesian` has the
equations and their solution. The coordinates are q = (r, p) of each of n moving bodies: center of mass r and
Euler parameters p, a unit quaternion (w, x, y, z). Matrices of the paper: R rotation, G and L with R = G L^T,
omega = 2 G pdot (world frame), omega' = 2 L pdot (body frame), J' inertia in the body frame. Phi are the
constraint residuals; Phi_r and Phi_theta are their derivatives for displacements and small rotations (world
frame) of a body. Couplings (gears) and prescribed motions are further rows of Phi and B. The last section
adds armatures (rotor inertias), which the paper does not have.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from newton_euler.equations.applied_forces import applied_wrenches
from newton_euler.equations.couplings import Measured
from newton_euler.equations.formulation import Formulation
from newton_euler.equations.model_control import model_control
from newton_euler.equations.sparse import Rows, add, add_block
from newton_euler.model import balls
from newton_euler.model.constraints import Frame, Jacobian
from newton_euler.model.euler_parameters import matrix_g, matrix_l, rotation
from newton_euler.model.joint import Key
from newton_euler.model.mechanism import Body
from newton_euler.model.scene import Scene
from newton_euler.scalars import Array, Scalar, cross, zeros


class Rotors(NamedTuple):
    """Sparse rows of the r joint coordinates x on which armatures act: d2x/dt2 = Phi_q qddot - gamma.

    A force on x acts on the bodies through B^T. An armature on a ball joint has three rows.

    Attributes:
        inertias: (r,) kg m^2 or kg.
        on_q: r rows of Phi_q.
        on_b: r rows of B.
        gammas: (r,) m/s^2 or rad/s^2.
    """

    inertias: list[Scalar]
    on_q: Rows
    on_b: Rows
    gammas: list[Scalar]


class CartesianTerms(Formulation):
    """Matrices and vectors of the equations of motion, eq. (21), of a scene with n moving bodies.

    With Lagrange multipliers lambda and without stabilization, the equations are

        M qddot - B^T lambda = g - b,   P qddot = -c,   Phi_q qddot = gamma

    The state is q (7 n,) and v = qdot (7 n,): (r, p) of each moving body, world frame, and their rates. The
    residuals `phi` are Phi(q) of joints and couplings, then 1/2 (p^T p - 1) of each body.

    Attributes:
        bodies: the moving bodies, without the ground.
        force_units: (6 n,) divisors that make forces and torques dimensionless.
    """

    def __init__(self, scene: Scene, alpha: float = 0.0) -> None:
        """Collect the constraints of a scene.

        Args:
            scene: the scene.
            alpha: 1/s, gives Baumgarte's gains K_D = 2 alpha, K_P = alpha^2 (paper, Appendix B); 0 for no
                stabilization.
        """
        mechanism = scene.mechanism
        self.bodies = mechanism.bodies[1:]
        n, poses = len(self.bodies), [body.pose for body in mechanism.bodies]
        super().__init__(
            scene,
            alpha,
            poses,
            equations=mechanism.equations,
            constrained=mechanism.equations,  # the joints with Lagrange multipliers: all of them
            nq=7 * n,
            nv=7 * n,
        )
        self.inertias = [body.inertia for body in mechanism.bodies]
        self.phi_units = np.concatenate([self.phi_units, np.ones(n)])
        self.row_owners = (*self.row_owners, *(body.name for body in self.bodies))
        self.quaternions = [slice(k + 3, k + 7) for k in range(0, self.nv, 7)]
        size, mass = mechanism.size, sum(body.mass for body in self.bodies)
        self.velocity_units = self.coordinate_units = np.tile([size] * 3 + [1.0] * 4, n)
        self.force_units = np.tile([mass * size] * 3 + [mass * size**2] * 3, n)

    # Section 2 of the paper: coordinates

    def split(self, q: Array) -> list[tuple[Array, Array]]:
        """Split q (7 n,) into (r, p) of each moving body, or qdot into their rates."""
        return [(q[k : k + 3], q[k + 3 : k + 7]) for k in range(0, self.nv, 7)]

    def frames(self, q: Array, v: Array) -> list[Frame]:
        """Compute pose and velocity of all bodies, ground first; results of recent states are kept."""
        return self.remembered(q, v, self._frames)

    def _frames(self, q: Array, qdot: Array) -> list[Frame]:
        """Compute pose and velocity of all bodies: R = G L^T, eq. (3), and omega = 2 G pdot."""
        ground = self.mechanism.bodies[0]
        frames = [Frame(ground.center_of_mass, ground.pose.rotation, np.zeros(3), np.zeros(3))]
        for (r, p), (rdot, pdot) in zip(self.split(q), self.split(qdot), strict=True):
            frames.append(Frame(r, rotation(p), rdot, 2.0 * matrix_g(p) @ pdot))
        return frames

    def norms(self, q: Array) -> Array:
        """Compute the error of the quaternions' norms, 1/2 (p^T p - 1) of each body, (n,), eq. (1)."""
        return np.array([0.5 * (p @ p - 1.0) for _, p in self.split(q)])

    def c(self, qdot: Array) -> Array:
        """Compute c = pdot^T pdot of each body, (n,), eqs (2) and (20)."""
        return np.array([pdot @ pdot for _, pdot in self.split(qdot)])

    def P(self, q: Array) -> Rows:
        """Compute the sparse matrix P (n, 7 n), eqs (15) and (20): p_i^T of each body."""
        rows: Rows = [{} for _ in self.bodies]
        for k, (_, p) in enumerate(self.split(q)):
            add_block(rows[k : k + 1], 7 * k + 3, p[None])
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
        """Compute the sparse matrices Phi_q (k, 7 n), eq. (5), and B (k, 6 n), eqs (18) and (20).

        A small rotation is delta theta = 2 G delta p, and therefore Phi_p = 2 Phi_theta G. With G L^T = R,
        the paper's B = [Phi_r, 1/2 Phi_p L^T] equals [Phi_r, Phi_theta R].
        """
        # joints
        frames = self.frames(q, qdot)
        phi_q: Rows = []
        b: Rows = []
        for e in self.equations:
            blocks = e.jacobian(frames[e.first], frames[e.second])
            on_q, on_b = self._rows(q, frames, e.first, e.second, blocks)
            phi_q.extend(on_q)
            b.extend(on_b)
        # couplings: sums over their joint coordinates
        measured = self.measured(q, qdot)
        for coupling in self.couplings:
            totals: Rows = [{}, {}]  # the row of Phi_q and the row of B
            for key, slope in coupling.measured_slopes(measured).items():
                first, second = self.between[key].first, self.between[key].second
                blocks = Jacobian(*(slope * block for block in measured[key].jacobian))
                for total, (row,) in zip(totals, self._rows(q, frames, first, second, blocks), strict=True):
                    for k, entry in row.items():
                        add(total, k, entry)
            phi_q.append(totals[0])
            b.append(totals[1])
        return phi_q, b

    def right_side(self, q: Array, qdot: Array) -> Array:
        """Compute gamma - K_D (Phi_q qdot) - K_P Phi(q) (k,), eqs (6), (8) and (9) with erratum 1."""
        gamma = self.gamma(q, qdot)
        if not (self.K_D or self.K_P):
            return gamma
        return gamma - self.K_D * self.phi_rate(q, qdot) - self.K_P * self.Phi(q, qdot)

    def _rows(
        self, q: Array, frames: list[Frame], first: int, second: int, blocks: Jacobian
    ) -> tuple[Rows, Rows]:
        """Compute the sparse rows of Phi_q and of B for a Jacobian between two bodies.

        Args:
            q: (7 n,) coordinates.
            frames: pose and velocity of all bodies.
            first, second: numbers of the bodies.
            blocks: Jacobian blocks (k, 3) for displacements and rotations of both bodies.
        """
        r_i, theta_i, r_j, theta_j = blocks
        on_q: Rows = [{} for _ in r_i]
        on_b: Rows = [{} for _ in r_i]
        for body, phi_r, phi_theta in ((first, r_i, theta_i), (second, r_j, theta_j)):
            if body == 0:
                continue  # the ground has no coordinates
            k = body - 1
            p = q[7 * k + 3 : 7 * k + 7]
            add_block(on_q, 7 * k, np.hstack([phi_r, 2.0 * phi_theta @ matrix_g(p)]))
            add_block(on_b, 6 * k, np.hstack([phi_r, phi_theta @ frames[body].rotation]))
        return on_q, on_b

    # Section 3 of the paper: bodies

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
        """Compute the gyroscopic torque L H pdot (3,) of a body, N m, with H = 4 Ldot^T J' L, eq. (13).

        With omega' = 2 L pdot, eq. (11), L H pdot = omega' x J' omega' + 2 (p^T pdot) J' omega'. The last
        term is zero for a unit quaternion, and eq. (12) leaves it out.
        """
        omega = 2.0 * matrix_l(p) @ pdot
        momentum = body.inertia @ omega
        return cross(omega, momentum) + 2.0 * (p @ pdot) * momentum

    def g(self, q: Array, qdot: Array) -> Array:
        """Compute the applied forces g (6 n,), eqs (20) and (24).

        For each moving body: force f_i, world frame, N, and torque n'_i, body frame, N m.
        """
        # gravity and forces on bodies, which depend on `surroundings`: frames, joint coordinates and time
        frames = self.frames(q, qdot)
        applied = applied_wrenches(self.scene, self.surroundings(q, qdot))
        wrenches = [
            wrench + np.concatenate([body.mass * self.scene.gravity, np.zeros(3)])
            for body, wrench in zip(self.mechanism.bodies, applied, strict=True)
        ]
        # forces on joint coordinates
        measured = self.measured(q, qdot)
        for key, u in self.coordinate_forces(q, qdot):
            (r_i, theta_i, r_j, theta_j), bodies = measured[key].jacobian, self.between[key]
            for body, r, theta in ((bodies.first, r_i, theta_i), (bodies.second, r_j, theta_j)):
                wrenches[body] = wrenches[body] + u * np.concatenate([r[0], theta[0]])
        # torques in the body frame
        parts = [np.zeros(0)]
        for wrench, frame in zip(wrenches[1:], frames[1:], strict=True):
            parts += [wrench[:3], frame.rotation.T @ wrench[3:]]
        return np.concatenate(parts)

    def model_forces(self, q: Array, v: Array) -> Mapping[Key, Scalar]:
        """Compute the forces of control laws that use a model of the mechanism, by key, N or N m."""
        return model_control(self).forces(self, q, v)

    # Extension: armatures

    def rotors(self, q: Array, qdot: Array) -> Rotors:
        """Compute the rows of all armatures: one for each hinge or slide, three for each ball joint."""
        frames, measured = self.frames(q, qdot), self.measured(q, qdot)
        found = Rotors([], [], [], [])
        for armature in self.scene.armatures:
            if armature.on_ball:
                # rates x: components of the relative angular velocity, world frame
                first, second = balls.joint_bodies(self.mechanism, armature.joint)
                jacobian, gammas = balls.SPIN, balls.spin_gamma(frames[first], frames[second])
            else:
                first, second = self.between[armature.key].first, self.between[armature.key].second
                coordinate = measured[armature.key]
                jacobian, gammas = coordinate.jacobian, np.array([coordinate.gamma])
            on_q, on_b = self._rows(q, frames, first, second, jacobian)
            found.inertias.extend([armature.inertia] * len(gammas))
            found.on_q.extend(on_q)
            found.on_b.extend(on_b)
            found.gammas.extend(gammas)
        return found

    def measured(self, q: Array, v: Array) -> dict[Key, Measured]:
        """Measure the joint coordinates that forces, couplings and armatures depend on, by key.

        A key is (joint, number). The Jacobians of the coordinates have blocks (1, 3) between two bodies.
        """
        frames = self.frames(q, v)
        return {key: coordinate.measure(q, frames) for key, coordinate in self.between.items()}
