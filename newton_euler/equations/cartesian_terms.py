"""The blocks of equation (21) of `newton_euler.equations.cartesian`: what its terms are made of."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from newton_euler.equations import balls
from newton_euler.equations.applied_forces import Surroundings, body_wrenches
from newton_euler.equations.couplings import couplings, row_owners, row_units, wanted
from newton_euler.equations.joint_coordinates import Measured, coordinates
from newton_euler.equations.sparse import Rows, RowsInUse, add
from newton_euler.model.constraints import Frame, Jacobian
from newton_euler.model.euler_parameters import matrix_g, matrix_l, rotation
from newton_euler.model.forces import Armature, BallArmature
from newton_euler.model.joint import Key
from newton_euler.model.scene import Scene
from newton_euler.scalars import Array, Scalar, zeros


def _spread(rows: Rows, start: int, block: Array) -> None:
    """Add a block (rows, columns) whose first column is `start`."""
    for row, entries in zip(rows, block, strict=True):
        for k, entry in enumerate(entries):
            add(row, start + k, entry)


class Rotors(NamedTuple):
    """Armatures a of coordinates x: d2x/dt2 = Phi_q qddot - gamma, and a force on x acts through B^T."""

    inertias: list[Scalar]
    """kg m^2 or kg"""
    on_q: Rows
    """Rows of Phi_q."""
    on_b: Rows
    """Rows of B."""
    gammas: list[Scalar]


class CartesianTerms:
    """The terms of `Cartesian`. State: q (7 n,), qdot (7 n,) of the n moving bodies.

    After the bodies' own, q holds carried angles (`newton_euler.equations.joint_coordinates`) and the work,
    if it is tracked.

    Attributes:
        time: s, at which prescribed motions are looked at.
        in_use: constraint rows that imply all others, for the power of prescribed motions over generic
            scalars; None in floats.
        phi_units: of the rows of `phi`: joints, couplings, norms of Euler parameters.
        row_owners: the joint, gear or body that each of them belongs to.
    """

    def __init__(self, scene: Scene, alpha: float = 0.0) -> None:
        """Baumgarte gains are K_D = 2 alpha, K_P = alpha^2 (Appendix B); none for alpha = 0."""
        self.scene = scene
        self.mechanism = scene.mechanism
        self.equations = scene.mechanism.equations
        self.bodies = scene.mechanism.bodies[1:]
        self.poses = [body.pose for body in scene.mechanism.bodies]
        self.nq = self.nv = 7 * len(self.bodies)
        self.time: Scalar = 0.0
        self.in_use: RowsInUse | None = None
        self.omitted: list[int] | None = None
        self.couplings = couplings(scene)
        self.rows = sum(equations.count for equations in self.equations) + len(self.couplings)
        self.damping, self.stiffness = 2.0 * alpha, alpha * alpha
        counted = wanted(scene, self.couplings)
        rotors = (armature.key for armature in scene.armatures if isinstance(armature, Armature))
        keys = dict.fromkeys([*counted, *rotors])
        measured = {key: self.equations[self.mechanism.joint_index(key[0])] for key in keys}
        self.measured = coordinates(measured, self.nq, counted)
        self.nq += sum(coordinate.carried is not None for coordinate in self.measured.values())
        self.work = slice(self.nq, self.nq + int(scene.tracks_work))
        self.nq = self.work.stop
        size, mass = self.mechanism.size, sum(body.mass for body in self.bodies)
        self.row_units = row_units(self.equations, self.couplings, size)
        norms = (body.name for body in self.bodies)
        self.row_owners = (*row_owners(self.equations, self.couplings), *norms)
        self.phi_units = np.concatenate([self.row_units, np.ones(len(self.bodies))])
        self.quaternions = [slice(k + 3, k + 7) for k in range(0, self.nv, 7)]
        self.velocity_units = np.tile([size] * 3 + [1.0] * 4, len(self.bodies))
        self.force_units = np.tile([mass * size] * 3 + [mass * size**2] * 3, len(self.bodies))

    @property
    def turning(self) -> list[int]:
        """Where in q there are angles that nothing measures: Euler parameters do not count turns."""
        return []

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

    def mass_rows(self, q: Array) -> Rows:
        """The nonzeros of the matrix (7 n, 7 n) of the kinetic energy, m and 4 L^T J' L of each body."""
        rows: Rows = [{} for _ in range(self.nv)]
        for k, (body, (_, p)) in enumerate(zip(self.bodies, self.split(q), strict=True)):
            _spread(rows[7 * k : 7 * k + 3], 7 * k, body.mass * np.eye(3))
            _spread(rows[7 * k + 3 : 7 * k + 7], 7 * k + 3, 4.0 * matrix_l(p).T @ body.inertia @ matrix_l(p))
        rotors = self.rotor_rows(q, self.frames(q, np.zeros(self.nv)))
        for inertia, row in zip(rotors.inertias, rotors.on_q, strict=True):
            for i, x in row.items():
                for j, y in row.items():
                    add(rows[i], j, inertia * (x * y))
        return rows

    def velocity_terms(self, q: Array, qdot: Array) -> Array:
        """b (6 n,): 0 and L_i H_i pdot_i with H = 4 Ldot^T J' L, eqs (13) and (14)."""
        b = []
        for body, (_, p), (_, pdot) in zip(self.bodies, self.split(q), self.split(qdot), strict=True):
            h = 4.0 * matrix_l(pdot).T @ body.inertia @ matrix_l(p)
            b.append(np.concatenate([np.zeros(3), matrix_l(p) @ h @ pdot]))
        return np.concatenate(b)

    def applied(self, q: Array, frames: list[Frame]) -> tuple[Array, Array]:
        """Actuator forces (a,), and g (6 n,): f_i in the world and n'_i in the body, eq. (24)."""
        wrenches = [
            wrench + np.concatenate([body.mass * self.scene.gravity, np.zeros(3)])
            for body, wrench in zip(
                self.mechanism.bodies, body_wrenches(self.scene, self.poses, frames), strict=True
            )
        ]
        forces = []
        for law in self.scene.joint_forces:
            driven = self.measured[law.joint, law.coordinate]
            x, rate, (r_i, theta_i, r_j, theta_j), _ = driven.measure(q, frames)
            u = law.force(x, rate, self.time)
            for body, r, theta in ((driven.first, r_i, theta_i), (driven.second, r_j, theta_j)):
                wrenches[body] = wrenches[body] + u * np.concatenate([r[0], theta[0]])
            forces.append(u)
        g = [
            np.concatenate([wrench[:3], frame.rotation.T @ wrench[3:]])
            for wrench, frame in zip(wrenches[1:], frames[1:], strict=True)
        ]
        return np.array(forces[: len(self.scene.control)]), np.concatenate(g)

    def measure(self, q: Array, qdot: Array) -> list[tuple[Scalar, Scalar]]:
        """Coordinate (m or rad) and rate of each control law."""
        seen = self._measurements(q, self.frames(q, qdot))
        return [seen[law.joint, law.coordinate][:2] for law in self.scene.control]

    def _measurements(self, q: Array, frames: list[Frame]) -> dict[Key, Measured]:
        return {key: coordinate.measure(q, frames) for key, coordinate in self.measured.items()}

    def seen(self, q: Array, qdot: Array) -> Surroundings:
        """What forces depend on at a state."""
        frames = self.frames(q, qdot)
        return self.poses, frames, self._measurements(q, frames), self.time

    def joint_phi(self, q: Array) -> Array:
        """Phi(q) (k,), eq. (4): joints, then couplings."""
        frames = self.frames(q, np.zeros(self.nv))
        seen = self._measurements(q, frames)
        phis = [e.phi(frames[e.first], frames[e.second]) for e in self.equations]
        return np.concatenate([*phis, [c.phi(seen, self.time) for c in self.couplings]])

    def joint_gamma(self, q: Array, frames: list[Frame]) -> Array:
        """gamma (k,), eq. (5): joints, then couplings."""
        seen = self._measurements(q, frames)
        gammas = [e.gamma(frames[e.first], frames[e.second]) for e in self.equations]
        return np.concatenate([*gammas, [c.gamma(seen, self.time) for c in self.couplings]])

    def joint_rate(self, q: Array, frames: list[Frame]) -> Array:
        """dPhi/dt (k,): joints, then couplings."""
        seen = self._measurements(q, frames)
        rates = []
        for e in self.equations:
            first, second = frames[e.first], frames[e.second]
            rates.append(e.jacobian(first, second).rate(first, second))
        return np.concatenate([*rates, [c.rate(seen, self.time) for c in self.couplings]])

    def joint_jacobian(self, q: Array, frames: list[Frame]) -> tuple[Rows, Rows]:
        """Phi_q (k, 7 n) and B (k, 6 n), as their nonzeros: joints, then couplings.

        Phi_p = 2 Phi_theta G, since delta theta = 2 G delta p. It makes the paper's
        B = [Phi_r, 1/2 Phi_p L^T] equal to [Phi_r, Phi_theta R], with no product to work out,
        because G L^T = R.
        """
        phi_q: Rows = []
        b: Rows = []
        for e in self.equations:
            blocks = e.jacobian(frames[e.first], frames[e.second])
            on_q, on_b = self._rows(q, frames, e.first, e.second, blocks)
            phi_q.extend(on_q)
            b.extend(on_b)
        seen = self._measurements(q, frames)
        for coupling in self.couplings:
            totals: Rows = [{}, {}]
            for key, factor in coupling.factors.items():
                first, second = self.measured[key].first, self.measured[key].second
                blocks = Jacobian(*(factor * block for block in seen[key].jacobian))
                for total, (share,) in zip(totals, self._rows(q, frames, first, second, blocks), strict=True):
                    for k, entry in share.items():
                        add(total, k, entry)
            phi_q.append(totals[0])
            b.append(totals[1])
        return phi_q, b

    def rotor_rows(self, q: Array, frames: list[Frame]) -> Rotors:
        """What armatures are on: a coordinate each, those of balls the three of their angular velocity."""
        found = Rotors([], [], [], [])
        for armature in self.scene.armatures:
            if isinstance(armature, BallArmature):
                first, second = balls.ends(self.mechanism, armature.joint)
                jacobian, gammas = balls.SPIN, balls.spin_gamma(frames[first], frames[second])
            else:
                coordinate = self.measured[armature.key]
                first, second = coordinate.first, coordinate.second
                seen = coordinate.measure(q, frames)
                jacobian, gammas = seen.jacobian, np.array([seen.gamma])
            on_q, on_b = self._rows(q, frames, first, second, jacobian)
            found.inertias.extend([armature.inertia] * len(gammas))
            found.on_q.extend(on_q)
            found.on_b.extend(on_b)
            found.gammas.extend(gammas)
        return found

    def _rows(
        self, q: Array, frames: list[Frame], first: int, second: int, blocks: Jacobian
    ) -> tuple[Rows, Rows]:
        """Rows of Phi_q and of B, as their nonzeros, for a Jacobian between two bodies."""
        r_i, theta_i, r_j, theta_j = blocks
        on_q: Rows = [{} for _ in r_i]
        on_b: Rows = [{} for _ in r_i]
        for body, phi_r, phi_theta in ((first, r_i, theta_i), (second, r_j, theta_j)):
            if body == 0:
                continue
            k = body - 1
            p = q[7 * k + 3 : 7 * k + 7]
            _spread(on_q, 7 * k, np.hstack([phi_r, 2.0 * phi_theta @ matrix_g(p)]))
            _spread(on_b, 6 * k, np.hstack([phi_r, phi_theta @ frames[body].rotation]))
        return on_q, on_b

    def norm_terms(self, q: Array, qdot: Array) -> tuple[Array, Rows, Array]:
        """1/2 (p^T p - 1) (n,), its Jacobian P (n, 7 n) and c = pdot^T pdot (n,), eqs (1) and (2)."""
        residual, c = [], []
        p_rows: Rows = [{} for _ in self.bodies]
        for k, ((_, p), (_, pdot)) in enumerate(zip(self.split(q), self.split(qdot), strict=True)):
            residual.append(0.5 * (p @ p - 1.0))
            _spread(p_rows[k : k + 1], 7 * k + 3, p[None])
            c.append(pdot @ pdot)
        return np.array(residual), p_rows, np.array(c)
