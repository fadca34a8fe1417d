"""Terms of the paper's equations of motion, each a method named by its symbol.

Coordinates are q = (r, p) of each moving body: center of mass and Euler parameters. See
`newton_euler.equations.cartesian` for the equations and their solution. Couplings and prescribed motions are
further rows of Phi and B; armatures are in the last section.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from newton_euler.equations.applied_forces import applied_wrenches
from newton_euler.equations.couplings import Measured
from newton_euler.equations.formulation import Formulation
from newton_euler.equations.model_control import model_control
from newton_euler.equations.sparse import Rows, add, spread
from newton_euler.model import balls
from newton_euler.model.constraints import Frame, Jacobian
from newton_euler.model.euler_parameters import matrix_g, matrix_l, rotation
from newton_euler.model.joint import Key
from newton_euler.model.mechanism import Body
from newton_euler.model.scene import Scene
from newton_euler.scalars import Array, Scalar, cross, zeros


class Rotors(NamedTuple):
    """Constraint rows of armatures.

    An armature of inertia a on a coordinate x has d2x/dt2 = Phi_q qddot - gamma; a force on x acts through
    B^T.
    """

    inertias: list[Scalar]
    """kg m^2 or kg."""
    on_q: Rows
    """Rows of Phi_q."""
    on_b: Rows
    """Rows of B."""
    gammas: list[Scalar]


class CartesianTerms(Formulation):
    """Matrices and vectors of equation (21) in the Cartesian coordinates of a scene.

    State: q (7 n,), qdot (7 n,) of the n moving bodies: (r, p) of each body, world frame, m. The residuals
    `phi` are Phi(q) of joints and couplings, then 1/2 (p^T p - 1) of the bodies.
    """

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
        applied = applied_wrenches(self.scene, self.seen(q, qdot))
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

    # Extension: armatures

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

    def measured(self, q: Array, v: Array) -> dict[Key, Measured]:
        frames = self.frames(q, v)
        return {key: coordinate.measure(q, frames) for key, coordinate in self.between.items()}
