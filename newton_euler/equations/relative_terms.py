"""Kinematics of the tree and the terms of the equations of `newton_euler.equations.relative`."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator
from typing import Any, NamedTuple

import numpy as np

from newton_euler.equations import balls
from newton_euler.equations.applied_forces import Surroundings, body_wrenches
from newton_euler.equations.couplings import couplings, row_owners, row_units, turns, wanted
from newton_euler.equations.joint_coordinates import carried_angles, carried_rates, coordinates
from newton_euler.equations.kinematics import Link, tree_links
from newton_euler.equations.sparse import Rows, RowsInUse, add, to_array
from newton_euler.model.constraints import Frame, Jacobian
from newton_euler.model.euler_parameters import product
from newton_euler.model.forces import Armature, BallArmature
from newton_euler.model.joint import Key
from newton_euler.model.scene import Scene
from newton_euler.model.spanning_tree import SpanningTree
from newton_euler.model.state import State
from newton_euler.scalars import Array, Scalar, cross, zeros


class Measured(NamedTuple):
    """A joint coordinate (m or rad) at a state, with d2x/dt2 = jacobian . vdot - gamma."""

    x: Scalar
    rate: Scalar
    jacobian: dict[int, Scalar]
    """The nonzeros of a row over v: the coordinate's rate, and how a force on it acts."""
    gamma: Scalar


def _drift(jacobian: Jacobian, first: Link, second: Link) -> Array:
    """What the accelerations of two links at qddot = 0 add to the second rate of constraints, (k,)."""
    return np.asarray(
        jacobian.r_first @ first.acceleration
        + jacobian.theta_first @ first.angular_acceleration
        + jacobian.r_second @ second.acceleration
        + jacobian.theta_second @ second.angular_acceleration
    )


class RelativeTerms:
    """The terms of `Relative`. State: q (nq,), v (nv,) of the spanning tree.

    After the tree's own, q holds carried angles (`newton_euler.equations.joint_coordinates`) and the work, if
    it is tracked.

    Attributes:
        time: s, at which prescribed motions are looked at.
        in_use: constraint rows that imply all others, for the power of prescribed motions over generic
            scalars; None in floats.
        phi_units: (k,) of the rows of `phi`: loop closures, then couplings.
        row_owners: the joint or gear that each of them belongs to.
    """

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
        self._last: tuple[Any, tuple[Array, Array], list[Link]] | None = None
        self.time: Scalar = 0.0
        self.in_use: RowsInUse | None = None
        self.omitted: list[int] | None = None
        self.couplings = couplings(scene)
        counted = wanted(scene, self.couplings)
        rotors = (armature.key for armature in scene.armatures if isinstance(armature, Armature))
        keys = dict.fromkeys([*counted, *rotors])
        self.places = {key: self.tree.place(*key) for key in keys}
        cut = {
            key: self.tree.equations(self.mechanism.joint_index(key[0]))
            for key, place in self.places.items()
            if place is None
        }
        self.between = coordinates(cut, self.tree.nq, counted)
        self.angles = self._angles(counted)
        self.nq += sum(coordinate.carried is not None for coordinate in self.between.values())
        self.work = slice(self.nq, self.nq + int(scene.tracks_work))
        self.nq = self.work.stop
        self.phi_units = row_units(self.closures, self.couplings, self.mechanism.size)
        self.row_owners = row_owners(self.closures, self.couplings)
        self.velocity_units = self.tree.velocity_units
        self.quaternions = [on_q for motion, on_q, _ in self.tree.motions if motion.kind == "ball"]

    def _angles(self, counted: Iterable[Key]) -> dict[Key, int]:
        """Where in q the angles are whose turns are counted."""
        found = {}
        for joint, number in counted:
            place = self.places[joint, number]
            if self.tree.equations(self.mechanism.joint_index(joint)).coordinates[number].is_length:
                continue
            carried = self.between[joint, number].carried if place is None else place[0]
            assert carried is not None
            found[joint, number] = carried
        return found

    @property
    def turning(self) -> list[int]:
        """Where in q there are angles of hinges that nothing measures."""
        measured = set(self.angles.values())
        hinges = [on_q.start for motion, on_q, _ in self.tree.motions if motion.kind == "hinge"]
        return [place for place in hinges if place not in measured]

    # Kinematics

    def links(self, q: Array, v: Array) -> list[Link]:
        """Kinematics of all bodies, ground first; asked for the same state again, the same."""
        # over generic scalars the bytes tell which objects they are, which the copies keep alive
        state = (q.dtype, q.tobytes(), v.dtype, v.tobytes())
        if self._last is None or self._last[0] != state:
            self._last = state, (q.copy(), v.copy()), tree_links(self.mechanism, self.tree, q, v)
        return self._last[2]

    def _frames(self, q: Array, v: Array) -> list[Frame]:
        return [link.frame for link in self.links(q, v)]

    def coordinates(self, state: State) -> tuple[Array, Array]:
        """q and v of a state; angles within half a turn or where couplings ask for, no work done."""
        q, v = self.tree.coordinates(state)
        if self.nq == self.tree.nq and not self.couplings:
            return q, v
        links = self.links(q, v)
        work = np.zeros(self.nq - self.work.start)
        q = np.concatenate([q, carried_angles(self.between, [link.frame for link in links]), work])
        x = {key: seen.x for key, seen in self.measured(q, v, links).items()}
        for key, turn in turns(self.couplings, x, self.angles, self.time).items():
            q[self.angles[key]] += turn
        return q, v

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
        wrenches = body_wrenches(self.scene, self.tree.poses, [link.frame for link in links])
        for body, link in enumerate(links[1:], start=1):
            inertia = self.world_inertia(body, link)
            block = (
                self.mechanism.bodies[body].mass * (link.linear.T @ link.linear)
                + link.angular.T @ inertia @ link.angular
            )
            f, n = self.inertial_wrench(body, link, link.acceleration, link.angular_acceleration)
            force, torque = wrenches[body][:3] - f, wrenches[body][3:] - n
            yield link.path, block, link.linear.T @ force + link.angular.T @ torque

    def mass_and_force(self, q: Array, v: Array, links: list[Link]) -> tuple[Array, Array]:
        """M (nv, nv) and f (nv,) of the tree, actuation included."""
        mass, force = np.zeros((self.nv, self.nv)), self.actuation(q, v, links)[1]
        for path, block, share in self.body_terms(links):
            mass[np.ix_(path, path)] += block
            force[path] += share
        for inertia, row, gamma in self.rotor_terms(q, v, links):
            for i, x in row.items():
                force[i] += inertia * gamma * x
                for j, y in row.items():
                    mass[i, j] += inertia * x * y
        return mass, force

    def rotor_terms(
        self, q: Array, v: Array, links: list[Link]
    ) -> Iterator[tuple[Scalar, dict[int, Scalar], Scalar]]:
        """For each armature a, and J and gamma of its coordinate: its force is -a (J vdot - gamma).

        Those of balls have three, components of the angular velocity in one frame or the other.
        """
        measured = self.measured(q, v, links)
        for armature in self.scene.armatures:
            if isinstance(armature, BallArmature):
                for row, gamma in self._spin_terms(armature.joint, links):
                    yield armature.inertia, row, gamma
            else:
                seen = measured[armature.key]
                yield armature.inertia, seen.jacobian, seen.gamma

    def _spin_terms(self, joint: str, links: list[Link]) -> list[tuple[dict[int, Scalar], Scalar]]:
        """J and gamma of the relative angular velocity at a ball, which is three of v if the tree has it."""
        place = self.tree.ball_place(joint)
        if place is not None:
            return [({k: 1.0}, 0.0) for k in range(place.start, place.stop)]
        first, second = (links[k] for k in balls.ends(self.mechanism, joint))
        gamma = balls.spin_gamma(first.frame, second.frame) - _drift(balls.SPIN, first, second)
        return list(zip(self._project(balls.SPIN, first, second), gamma, strict=True))

    def mass_rows(self, q: Array) -> Rows:
        """The nonzeros of M (nv, nv), over generic scalars."""
        v = np.zeros(self.nv)
        return self.sparse_mass_and_force(q, v, self.links(q, v))[0]

    def sparse_mass_and_force(self, q: Array, v: Array, links: list[Link]) -> tuple[Rows, Array]:
        """`mass_and_force` over generic scalars, M as its nonzeros."""
        mass: Rows = [{} for _ in range(self.nv)]
        force = self.actuation(q, v, links)[1].astype(object)
        for path, block, share in self.body_terms(links):
            for n, i in enumerate(path):
                force[i] = force[i] + share[n]
                for m, j in enumerate(path[: n + 1]):  # both triangles alike, to the last bit and zero
                    add(mass[i], j, block[n, m])
                    if i != j:
                        add(mass[j], i, block[n, m])
        for inertia, row, gamma in self.rotor_terms(q, v, links):
            for i, x in row.items():
                force[i] = force[i] + inertia * gamma * x
                for j, y in row.items():
                    add(mass[i], j, inertia * (x * y))
        return mass, force

    def measured(self, q: Array, v: Array, links: list[Link]) -> dict[Key, Measured]:
        """The joint coordinates that something acts on."""
        found = {}
        for key, place in self.places.items():
            if place is not None:
                found[key] = Measured(q[place[0]], v[place[1]], {place[1]: 1.0}, 0.0)
            else:
                between = self.between[key]
                x, rate, jacobian, gamma = between.measure(q, [link.frame for link in links])
                first, second = links[between.first], links[between.second]
                row = self._project(jacobian, first, second)[0]
                found[key] = Measured(x, rate, row, gamma - _drift(jacobian, first, second)[0])
        return found

    def measure(self, q: Array, v: Array) -> list[tuple[Scalar, Scalar]]:
        """Coordinate (m or rad) and rate of each control law."""
        seen = self.measured(q, v, self.links(q, v))
        return [seen[law.joint, law.coordinate][:2] for law in self.scene.control]

    def seen(self, q: Array, v: Array) -> Surroundings:
        """What forces depend on at a state."""
        links = self.links(q, v)
        return self.tree.poses, [link.frame for link in links], self.measured(q, v, links), self.time

    def actuation(self, q: Array, v: Array, links: list[Link]) -> tuple[Array, Array]:
        """Forces of `Scene.joint_forces`, and what they do to the joint coordinates (nv,)."""
        forces, generalized = [], zeros(self.nv, q, v)
        measured = self.measured(q, v, links)
        for law in self.scene.joint_forces:
            seen = measured[law.joint, law.coordinate]
            u = law.force(seen.x, seen.rate, self.time)
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

    def coupling_terms(self, measured: dict[Key, Measured]) -> tuple[Array, Rows, Array]:
        """Phi (c,), the nonzeros of J (c, nv) and the stabilised gamma (c,) of the couplings."""
        phis, gammas = [np.zeros(0)], [np.zeros(0)]
        rows: Rows = [{} for _ in self.couplings]
        for coupling, row in zip(self.couplings, rows, strict=True):
            phi, gamma = coupling.phi(measured, self.time), coupling.gamma(measured, self.time)
            if self.damping or self.stiffness:
                rate = coupling.rate(measured, self.time)
                gamma = gamma - self.damping * rate - self.stiffness * phi
            for key, factor in coupling.factors.items():
                for k, entry in measured[key].jacobian.items():
                    add(row, k, factor * entry)
            phis.append(np.array([phi]))
            gammas.append(np.array([gamma]))
        return np.concatenate(phis), rows, np.concatenate(gammas)

    def loop_terms(self, q: Array, v: Array, links: list[Link]) -> tuple[Array, Rows, Array]:
        """Phi (k,), the nonzeros of J (k, nv) and the stabilised gamma (k,): loop closures, couplings."""
        phis, gammas = [np.zeros(0)], [np.zeros(0)]
        jacobian: Rows = []
        for closure in self.closures:
            first, second = links[closure.first], links[closure.second]
            blocks = closure.jacobian(first.frame, second.frame)
            phi = closure.phi(first.frame, second.frame)
            gamma = closure.gamma(first.frame, second.frame) - _drift(blocks, first, second)
            if self.damping or self.stiffness:
                rate = blocks.rate(first.frame, second.frame)
                gamma = gamma - self.damping * rate - self.stiffness * phi
            phis.append(phi)
            gammas.append(gamma)
            jacobian.extend(self._project(blocks, first, second))
        phi, rows, gamma = self.coupling_terms(self.measured(q, v, links))
        return np.concatenate([*phis, phi]), [*jacobian, *rows], np.concatenate([*gammas, gamma])

    def phi_t(self) -> Array:
        """Partial derivative (k,) of `phi` by time."""
        scleronomic = np.zeros(len(self.phi_units) - len(self.couplings))
        return np.concatenate([scleronomic, [coupling.phi_t(self.time) for coupling in self.couplings]])

    def phi_and_jacobian(self, q: Array) -> tuple[Array, Rows]:
        """Residuals (k,) of loop closures and couplings, and the nonzeros of their Jacobian (k, nv)."""
        v = np.zeros(self.nv)
        return self.loop_terms(q, v, self.links(q, v))[:2]

    def phi(self, q: Array) -> Array:
        """Residuals (k,) of loop closures and couplings."""
        return self.phi_and_jacobian(q)[0]

    def phi_jacobian(self, q: Array) -> Array:
        """Derivative (k, nv) of `phi` along `retract`, and of `phi`'s rate by v."""
        return to_array(self.phi_and_jacobian(q)[1], self.nv)

    def retract(self, q: Array, step: Array) -> Array:
        """q moved by a small step (nv,); quaternions come out with norm 1."""
        moved = self.tree.retract(q, step)
        if self.nq == self.tree.nq:
            return moved
        angles = q[self.tree.nq : self.work.start] + carried_rates(self.between, self._frames(q, step))
        return np.concatenate([moved, angles, q[self.work]])

    def rows_of(self, relative: Collection[int]) -> list[int]:
        """Rows of `phi` that hold these of the joint-coordinate form: themselves."""
        return sorted(relative)

    def row_scales(self, q: Array) -> Array:
        """(k,) natural magnitude of the dimensionless rows of the Jacobian, for decisions on their rank.

        A row of a loop is the difference of what its two branches do to the bodies that it joins. Its
        magnitude is the largest of these contributions, so that a row in which they cancel is seen to be
        small; that of a coupling is its own length.
        """
        links = self.links(q, np.zeros(self.nv))
        scales: list[float] = []
        for closure in self.closures:
            first, second = links[closure.first], links[closure.second]
            r_i, theta_i, r_j, theta_j = (
                np.linalg.norm(block, axis=1) for block in closure.jacobian(first.frame, second.frame)
            )
            largest = np.zeros(closure.count)
            for link, other, r, theta in ((first, second, r_i, theta_i), (second, first, r_j, theta_j)):
                own = [n for n, k in enumerate(link.path) if k not in other.path]
                units = self.velocity_units[[link.path[n] for n in own]]
                linear = np.linalg.norm(link.linear[:, own], axis=0) * units
                angular = np.linalg.norm(link.angular[:, own], axis=0) * units
                share = np.outer(r, linear) + np.outer(theta, angular)
                largest = np.maximum(largest, np.max(share, axis=1, initial=0.0))
            scales.extend(largest / closure.units(self.mechanism.size))
        rows = self.coupling_terms(self.measured(q, np.zeros(self.nv), links))[1]
        for row, unit in zip(rows, self.phi_units[len(scales) :], strict=True):
            scales.append(
                float(np.sqrt(sum((x * self.velocity_units[k] / unit) ** 2 for k, x in row.items())))
            )
        return np.array([scale or 1.0 for scale in scales])
