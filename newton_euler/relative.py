"""The equations of motion in joint coordinates of a spanning tree, with closed loops.

The body equations are those of the Cartesian form; here they are projected onto the velocities
that the tree allows. With v_i = V_i qdot and omega_i = W_i qdot the velocity transformation of
body i, and a0_i, alpha0_i its acceleration at qddot = 0,

    M qddot = f + J^T lambda
    J qddot = gamma

    M = sum m V^T V + W^T I W
    f = sum V^T m (g - a0) - W^T (I alpha0 + omega x I omega) + actuation
    J = Phi_r V + Phi_theta W                          (of the joints that close loops)
    gamma = gamma_Phi - Phi_r a0 - Phi_theta alpha0 - K_D J qdot - K_P Phi

(Nikravesh, Computer-Aided Analysis of Mechanical Systems, 1988, chapter 13; Featherstone, Rigid
Body Dynamics Algorithms, 2008, section 8.1, for loops on top of a tree.)

Body frames are those of the tree: parallel to the world at the initial pose.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from newton_euler.constraints import Frame, Jacobian
from newton_euler.driven import carried_angles, carried_rates, driven
from newton_euler.errors import SingularityError
from newton_euler.euler_parameters import product
from newton_euler.links import Link, tree_links
from newton_euler.scalars import Array, Scalar, cross, zeros
from newton_euler.scene import Scene
from newton_euler.solve import solve_constrained
from newton_euler.sparse import Rows, RowsInUse, Solution, add, dense, factorise, sparse_vector
from newton_euler.sparse import solve_constrained as sparse_solve
from newton_euler.state import Evaluation, MassProperties, State, energies
from newton_euler.tree import SpanningTree


class Measured(NamedTuple):
    """The joint coordinate (m or rad) of a control law, its rate, and that as a row over v."""

    coordinate: Scalar
    rate: Scalar
    jacobian: dict[int, Scalar]


class Relative:
    """Joint-coordinate formulation of a scene. State: q (nq,), v (nv,) of the spanning tree."""

    name = "relative"

    def __init__(self, scene: Scene, alpha: float = 0.0) -> None:
        """Baumgarte gains of the loops are K_D = 2 alpha, K_P = alpha^2; none for alpha = 0."""
        self.scene = scene
        self.mechanism = scene.mechanism
        self.tree = SpanningTree(scene.mechanism)
        self.closures = [self.tree.equations(k) for k in self.tree.cuts]
        self.nq, self.nv = self.tree.nq, self.tree.nv
        self.damping, self.stiffness = 2.0 * alpha, alpha * alpha
        self.inertias = [
            a0 @ body.inertia @ a0.T
            for a0, body in zip(self.tree.initial_rotations, self.mechanism.bodies, strict=True)
        ]
        cut = [law for law in scene.control if self.mechanism.joint_index(law.joint) in self.tree.cuts]
        self.driven = driven(
            [(law, self.tree.equations(self.mechanism.joint_index(law.joint))) for law in cut], self.tree.nq
        )
        self.nq += sum(drive.carried is not None for drive in self.driven)
        size = self.mechanism.size
        self.phi_units = np.concatenate([np.zeros(0), *(closure.units(size) for closure in self.closures)])
        self.velocity_units = self.tree.velocity_units
        self.quaternions = [on_q for motion, on_q, _ in self.tree.motions if motion.kind == "ball"]

    # Kinematics

    def links(self, q: Array, v: Array) -> list[Link]:
        """Kinematics of all bodies, ground first."""
        return tree_links(self.mechanism, self.tree, q, v)

    # Terms of the equations of motion

    def world_inertia(self, body: int, link: Link) -> Array:
        """(3, 3) inertia of a body about its centre of mass, world frame."""
        a = link.frame.rotation
        return a @ self.inertias[body] @ a.T

    def inertial_wrench(
        self, body: int, link: Link, acceleration: Array, alpha: Array
    ) -> tuple[Array, Array]:
        """Force and torque about the centre of mass that a body needs to accelerate so, less gravity."""
        inertia = self.world_inertia(body, link)
        omega = link.frame.angular_velocity
        force = self.mechanism.bodies[body].mass * (acceleration - self.scene.gravity)
        return force, inertia @ alpha + cross(omega, inertia @ omega)

    def body_terms(self, links: list[Link]) -> Iterator[tuple[list[int], Array, Array]]:
        """What each body adds to M and to f: (path, block (p, p), (p,))."""
        for body, link in enumerate(links[1:], start=1):
            inertia = self.world_inertia(body, link)
            block = (
                self.mechanism.bodies[body].mass * (link.linear.T @ link.linear)
                + link.angular.T @ inertia @ link.angular
            )
            f, n = self.inertial_wrench(body, link, link.acceleration, link.angular_acceleration)
            yield link.path, block, -(link.linear.T @ f + link.angular.T @ n)

    def mass_and_force(self, q: Array, v: Array, links: list[Link]) -> tuple[Array, Array]:
        """M (nv, nv) and f (nv,) of the tree, actuation included."""
        mass, force = np.zeros((self.nv, self.nv)), self.actuation(q, v, links)[1]
        for path, block, share in self.body_terms(links):
            mass[np.ix_(path, path)] += block
            force[path] += share
        return mass, force

    def sparse_mass_and_force(self, q: Array, v: Array, links: list[Link]) -> tuple[Rows, Array]:
        """The same over generic scalars, M as its nonzeros."""
        mass: Rows = [{} for _ in range(self.nv)]
        force = self.actuation(q, v, links)[1].astype(object)
        for path, block, share in self.body_terms(links):
            for n, i in enumerate(path):
                force[i] = force[i] + share[n]
                for m, j in enumerate(path):
                    add(mass[i], j, block[n, m])
        return mass, force

    def measured(self, q: Array, v: Array, links: list[Link]) -> list[Measured]:
        """What each control law sees, and how a force on it acts on the joint coordinates."""
        found = []
        cut = iter(self.driven)
        for law in self.scene.control:
            place = self.tree.place(law.joint, law.coordinate)
            if place is not None:
                found.append(Measured(q[place[0]], v[place[1]], {place[1]: 1.0}))
            else:
                drive = next(cut)
                first, second = (links[body] for body in drive.bodies)
                x, rate, jacobian = drive.measure(q, first.frame, second.frame)
                found.append(Measured(x, rate, self._project(jacobian, first, second)[0]))
        return found

    def measure(self, q: Array, v: Array) -> list[tuple[Scalar, Scalar]]:
        """Coordinate (m or rad) and rate of each control law."""
        return [(seen.coordinate, seen.rate) for seen in self.measured(q, v, self.links(q, v))]

    def actuation(self, q: Array, v: Array, links: list[Link]) -> tuple[Array, Array]:
        """Actuator forces (a,), and what they do to the joint coordinates (nv,)."""
        forces, generalized = [], zeros(self.nv, q, v)
        for law, seen in zip(self.scene.control, self.measured(q, v, links), strict=True):
            u = law.force(seen.coordinate, seen.rate)
            for k, entry in seen.jacobian.items():
                generalized[k] += entry * u
            forces.append(u)
        return np.array(forces), generalized

    def _project(self, jacobian: Jacobian, first: Link, second: Link) -> Rows:
        """The rows of a two-body Jacobian in joint coordinates, as their nonzeros."""
        r_i, theta_i, r_j, theta_j = jacobian
        rows: Rows = [{} for _ in r_i]
        for link, block in (
            (first, r_i @ first.linear + theta_i @ first.angular),
            (second, r_j @ second.linear + theta_j @ second.angular),
        ):
            for row, entries in zip(rows, block, strict=True):
                for k, entry in zip(link.path, entries, strict=True):
                    add(row, k, entry)
        return rows

    def loop_terms(self, links: list[Link]) -> tuple[Array, Rows, Array]:
        """Phi (k,), the nonzeros of J (k, nv) and the stabilised gamma (k,) of the loop closures."""
        phis, gammas = [np.zeros(0)], [np.zeros(0)]
        jacobian: Rows = []
        for closure in self.closures:
            first, second = links[closure.first], links[closure.second]
            blocks = closure.jacobian(first.frame, second.frame)
            phi = closure.phi(first.frame, second.frame)
            gamma = (
                closure.gamma(first.frame, second.frame)
                - blocks.r_first @ first.acceleration
                - blocks.theta_first @ first.angular_acceleration
                - blocks.r_second @ second.acceleration
                - blocks.theta_second @ second.angular_acceleration
            )
            if self.damping or self.stiffness:
                rate = blocks.rate(first.frame, second.frame)
                gamma = gamma - self.damping * rate - self.stiffness * phi
            phis.append(phi)
            gammas.append(gamma)
            jacobian.extend(self._project(blocks, first, second))
        return np.concatenate(phis), jacobian, np.concatenate(gammas)

    # What integrators, projection and assembly ask for

    def rate(self, q: Array, v: Array) -> Array:
        """qdot (nq,)."""
        rates = self.tree.rate(q, v)
        if self.nq == self.tree.nq:
            return rates
        return np.concatenate([rates, carried_rates(self.driven, self._frames(q, v))])

    def _frames(self, q: Array, v: Array) -> list[Frame]:
        return [link.frame for link in self.links(q, v)]

    def acceleration(self, q: Array, v: Array) -> Array:
        """qddot (nv,)."""
        return self._solve(q, v, self.links(q, v))[0]

    def _solve(self, q: Array, v: Array, links: list[Link]) -> tuple[Array, Array]:
        mass, force = self.mass_and_force(q, v, links)
        _, rows, gamma = self.loop_terms(links)
        jacobian = dense(rows, self.nv)
        try:
            return solve_constrained(mass, force, jacobian, gamma, self.phi_units, self.velocity_units)
        except np.linalg.LinAlgError as error:
            raise self._singularity(mass, force) from error

    def _singularity(self, mass: Array, force: Array) -> SingularityError:
        """Which joint's motion cannot be solved for, and why."""
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
        """Name of the joint that a velocity belongs to."""
        (kept,) = (kept for kept in self.tree.joints if kept.v.start <= velocity < kept.v.stop)
        return self.mechanism.joint_names[kept.joint]

    def fastest_joint(self, q: Array, v: Array) -> str:
        """Name of the joint whose dimensionless velocity is largest."""
        return self._joint_of(int(np.argmax(np.abs(v) / self.velocity_units)))

    def sparse_solution(self, q: Array, v: Array, rows: RowsInUse) -> Solution:
        """Accelerations and multipliers by sparse elimination, leaves first, over generic scalars.

        `rows` of `phi` are used; the others must follow from them.
        """
        links = self.links(q, v)
        mass, force = self.sparse_mass_and_force(q, v, links)
        _, jacobian, gamma = self.loop_terms(links)
        factor = factorise(mass, range(self.nv - 1, -1, -1), rows.mass_scales)
        return sparse_solve(factor, sparse_vector(force), jacobian, gamma, rows, refine=False)

    def sparse_acceleration(self, q: Array, v: Array, rows: RowsInUse) -> tuple[Array, Scalar]:
        """qddot (nv,) and the health of the elimination, over generic scalars."""
        solution = self.sparse_solution(q, v, rows)
        return np.array([solution.acceleration.get(k, 0.0) for k in range(self.nv)]), solution.health

    def phi_and_jacobian(self, q: Array) -> tuple[Array, Rows]:
        """Residuals (k,) of the loop closures and the nonzeros of their Jacobian (k, nv)."""
        return self.loop_terms(self.links(q, np.zeros(self.nv)))[:2]

    def phi(self, q: Array) -> Array:
        """Residuals (k,) of the loop closures."""
        return self.phi_and_jacobian(q)[0]

    def phi_jacobian(self, q: Array) -> Array:
        """Derivative (k, nv) of `phi` along `retract`, and of `phi`'s rate by v."""
        return dense(self.phi_and_jacobian(q)[1], self.nv)

    def retract(self, q: Array, step: Array) -> Array:
        """q moved by a small step (nv,); quaternions come out with norm 1."""
        moved = self.tree.retract(q, step)
        if self.nq == self.tree.nq:
            return moved
        return np.concatenate([moved, q[self.tree.nq :] + carried_rates(self.driven, self._frames(q, step))])

    # Between this formulation's coordinates and what everybody understands

    def mass_properties(self) -> MassProperties:
        """What the bodies weigh: as the mechanism states."""
        return MassProperties.of(self.mechanism)

    def coordinates(self, state: State) -> tuple[Array, Array]:
        """q and v of a state; carried angles within half a turn."""
        q, v = self.tree.coordinates(state)
        if self.nq == self.tree.nq:
            return q, v
        return np.concatenate([q, carried_angles(self.driven, self._frames(q, v))]), v

    def state(self, q: Array, v: Array) -> State:
        """Body poses and velocities."""
        return self._state(self.links(q, v))

    def _state(self, links: list[Link]) -> State:
        frames = [link.frame for link in links]
        quaternions = [
            product(link.orientation, body.quaternion)
            for link, body in zip(links, self.mechanism.bodies, strict=True)
        ]
        return State(
            np.array([frame.position for frame in frames]),
            np.array(quaternions),
            np.array([frame.velocity for frame in frames]),
            np.array([frame.angular_velocity for frame in frames]),
        )

    def velocity_transformation(self, q: Array) -> Array:
        """(6 b, nv): v and omega of body 0, 1, ... for each joint velocity."""
        links = self.links(q, np.zeros(self.nv))
        rows = np.zeros((len(links), 6, self.nv))
        for body, link in enumerate(links):
            rows[body][:, link.path] = np.concatenate([link.linear, link.angular])
        return rows.reshape(6 * len(links), self.nv)

    def evaluate(self, q: Array, v: Array) -> Evaluation:
        """Accelerations, reactions and energies at a state."""
        links = self.links(q, v)
        return self._evaluation(q, v, links, *self._solve(q, v, links))

    def sparse_evaluation(self, q: Array, v: Array, rows: RowsInUse) -> tuple[Evaluation, Scalar]:
        """`evaluate` by sparse elimination over generic scalars, and the health of that."""
        solution = self.sparse_solution(q, v, rows)
        qddot = np.array([solution.acceleration.get(k, 0.0) for k in range(self.nv)])
        multipliers = np.array([solution.multipliers.get(k, 0.0) for k in range(len(self.phi_units))])
        return self._evaluation(q, v, self.links(q, v), qddot, multipliers), solution.health

    def _evaluation(
        self, q: Array, v: Array, links: list[Link], qddot: Array, multipliers: Array
    ) -> Evaluation:
        actuation = self.actuation(q, v, links)[0]
        linear = np.array([k.acceleration + k.linear @ qddot[k.path] for k in links])
        angular = np.array([k.angular_acceleration + k.angular @ qddot[k.path] for k in links])
        forces, torques = self._reactions(links, linear, angular, multipliers, actuation)
        state = self._state(links)
        bodies = energies(self.scene, [link.frame for link in links], self.inertias)
        return Evaluation(state, linear, angular, forces, torques, actuation, *bodies)

    def joint_phi(self, q: Array) -> Array:
        """Residuals of all joints, kept ones included."""
        frames = self._frames(q, np.zeros(self.nv))
        all_joints = [self.tree.equations(k) for k in range(len(self.mechanism.joints))]
        return np.concatenate([np.zeros(0), *(e.phi(frames[e.first], frames[e.second]) for e in all_joints)])

    def _reactions(
        self, links: list[Link], linear: Array, angular: Array, multipliers: Array, actuation: Array
    ) -> tuple[Array, Array]:
        """Forces and torques (j, 3) at the joint points on the second bodies.

        Loop closures have multipliers. Kept joints follow from the bodies' Newton-Euler equations,
        from the leaves to the ground: each carries what its child needs and nothing else supplies.
        """
        joints = self.mechanism.joints
        forces: list[Array] = [np.zeros(3)] * len(joints)
        torques = list(forces)
        need = [
            np.concatenate(self.inertial_wrench(body, link, linear[body], angular[body]))
            for body, link in enumerate(links)
        ]  # about each centre of mass
        row = 0
        for closure in self.closures:
            blocks = closure.jacobian(links[closure.first].frame, links[closure.second].frame)
            share = multipliers[row : row + closure.count]
            row += closure.count
            need[closure.first] = need[closure.first] - np.concatenate(
                [blocks.r_first.T @ share, blocks.theta_first.T @ share]
            )
            on_second = np.concatenate([blocks.r_second.T @ share, blocks.theta_second.T @ share])
            need[closure.second] = need[closure.second] - on_second
            index = joints.index(closure.joint)
            s = self._reaction_arm(index, links)
            forces[index] = on_second[:3]
            torques[index] = on_second[3:] - cross(s, on_second[:3])
        for law, u in zip(self.scene.control, actuation, strict=True):
            equations = self.tree.equations(self.mechanism.joint_index(law.joint))
            blocks = equations.coordinates[law.coordinate].jacobian(
                links[equations.first].frame, links[equations.second].frame
            )
            need[equations.first] = need[equations.first] - u * np.concatenate(
                [blocks.r_first[0], blocks.theta_first[0]]
            )
            need[equations.second] = need[equations.second] - u * np.concatenate(
                [blocks.r_second[0], blocks.theta_second[0]]
            )
        for kept in reversed(self.tree.joints):
            force, torque = need[kept.child][:3], need[kept.child][3:]
            arm = links[kept.child].frame.position - links[kept.parent].frame.position
            need[kept.parent] = need[kept.parent] + np.concatenate([force, torque + cross(arm, force)])
            sign = 1.0 if kept.forward else -1.0
            center = links[kept.child].frame.position
            index = kept.joint
            second = self.tree.equations(index).second
            point = links[second].frame.position + self._reaction_arm(index, links)
            forces[index] = sign * force
            torques[index] = sign * (torque - cross(point - center, force))
        return np.array(forces), np.array(torques)

    def _reaction_arm(self, joint: int, links: list[Link]) -> Array:
        """From the second body's centre of mass to the joint point, world frame."""
        second = self.tree.equations(joint).second
        s = self.mechanism.joints[joint].reaction_point - self.mechanism.bodies[second].center_of_mass
        return np.asarray(links[second].frame.rotation @ s)
