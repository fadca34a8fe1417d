"""Equations of motion of a scene by Drake, with rigid loop closures.

Mass matrix, forces, Jacobians and bias accelerations come from a continuous `MultibodyPlant`. The
accelerations follow from

    M dv/dt = f + J^T lambda,    J dv/dt = gamma,

with the rows J of `crosscheck.engines.drake.closures` and of couplings. Reactions come from Drake's own
forward dynamics of the tree, loaded with the forces of the closures: if closures and accelerations
contradicted each other, its accelerations would differ.

Coordinates q (nq,) and velocities v (nv,) are those of the spanning tree. If the scene tracks the work of
forces without potential energy, this work, J, is the last element of q.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from crosscheck.engines.applied import (
    BodyLoads,
    Motions,
    body_loads,
    commands,
    coordinate_elements,
    coordinate_load,
)
from crosscheck.engines.drake.closures import Closures
from crosscheck.engines.drake.placed import PlacedPlant
from crosscheck.engines.drake.plant import NAME, build
from crosscheck.engines.drake.readings import joint_geometry, mass_properties
from newton_euler.equations.articulated import moved_wrench
from newton_euler.equations.coupling_equations import TreeCouplings
from newton_euler.equations.drives import drive_wrenches, joint_points
from newton_euler.equations.engine_solution import Redundancy, servo_forces, solve_rigidly, tree_rows
from newton_euler.equations.load_friction import EngineFriction, HeldFriction
from newton_euler.equations.model_control import EngineControl, roles
from newton_euler.equations.system import Energies, Evaluation, MassProperties, Observation
from newton_euler.errors import check_choice
from newton_euler.model.constraints import Frame
from newton_euler.model.euler_parameters import from_rotation, rotation
from newton_euler.model.joint import Key
from newton_euler.model.joint_geometry import JointGeometry
from newton_euler.model.scene import Scene
from newton_euler.model.spanning_tree import weld_loops
from newton_euler.model.state import State
from newton_euler.scalars import Array, Scalar


class TreeForces(NamedTuple):
    """Forces of a scene on the bodies and coordinates of the spanning tree at one state, except gravity.

    Attributes:
        along: (nv,) forces on the coordinates of the tree, N or N m, without those of Drake's springs.
        drives: (nv,) all forces on the coordinates of the tree, N or N m.
        wrenches: (b, 6) forces and torques on the bodies about the centers of mass, N and N m, world frame,
            without those of Drake's springs.
        control: (a,) forces of the control laws, N or N m.
        power: W, of all forces without potential energy.
        energy: J, of the springs that Drake does not have.
    """

    along: Array
    drives: Array
    wrenches: Array
    control: Array
    power: float
    energy: float


class Solution(NamedTuple):
    """Solution of the equations of motion at a state.

    Attributes:
        acceleration: (nv,) dv/dt.
        multipliers: (k,) of the constraint rows.
    """

    acceleration: Array
    multipliers: Array


class DrakeSystem:
    """Equations of a scene by Drake, a `newton_euler.equations.system.System`.

    Attributes:
        scene: the scene; a copy of this object may have another scene, with the present forces of sampled
            controllers and the present pieces of functions of time.
        placed: the plant at its present state.
        tree: spanning tree of the welded mechanism, which the plant models.
        couplings: gears, screws and prescribed motions; their rows follow those of the loops.
        held_friction: frictions that are given, N or N m, by identity; None to compute them.
    """

    name = NAME

    def __init__(self, scene: Scene, shifts: Mapping[str, Array] | None = None) -> None:
        """Build the plant.

        Args:
            scene: the scene.
            shifts: vectors (3,), m, world frame at the initial pose, by which anchors of loops are moved on
                their second bodies, by name of the joint that closes the loop.

        Raises:
            UnknownNameError: for a shift at a joint that closes no loop.
        """
        self.scene, self.mechanism, self.time = scene, scene.mechanism, 0.0
        # loaded: never close a loop by a ball with a spring, damper or armature
        welded = weld_loops(scene.mechanism, loaded=scene.loaded_balls)
        self.tree = welded.tree
        self._welded = welded
        closing, moved = welded.closing_joints, dict[str, Array]()
        for joint, shift in (shifts or {}).items():
            check_choice("joint that closes a loop", joint, closing)
            moved[closing[joint].name] = shift
        self.placed = PlacedPlant(build(scene, welded, shifts=moved))
        self._frames = [body.body_frame() for body in self.placed.built.bodies[1:]]
        self._closures = Closures(self.placed, scene.mechanism.size)
        self.couplings = TreeCouplings(scene, self.tree)
        self.quaternions = self.tree.quaternions
        self.nq, self.nv = self.tree.nq + int(scene.tracks_work), self.tree.nv
        self.phi_units = np.concatenate([self._closures.units, self.couplings.units])
        self.velocity_units = self.tree.velocity_units
        # all rotor inertias, and those on balls, which Drake's plant does not have
        self._rotors, self._ball_rotors = np.zeros((2, self.nv))
        for armature in scene.armatures:
            if armature.on_ball:
                self._ball_rotors[self.tree.ball_place(armature.joint)] += armature.inertia
            else:
                self._rotors[self._place(armature.key)[1]] += armature.inertia
        self._rotors += self._ball_rotors
        self._places = {key: self._place(key) for key in (*scene.loaded_coordinates, *scene.sensed)}
        self._control = EngineControl(scene, DrakeSystem) if roles(scene) else None
        self._friction = EngineFriction(scene, DrakeSystem)
        self.held_friction: HeldFriction | None = None
        self._redundancy: Redundancy | None = None
        self._latest_forces: tuple[Any, TreeForces] | None = None
        self._latest_solution: tuple[Any, Solution] | None = None

    def _place(self, key: Key) -> tuple[int, int]:
        """Return the indices in q and v of a joint coordinate, which is one of the tree."""
        place = self.tree.place(*key)
        assert place is not None
        return place

    # States

    def coordinates(self, state: State) -> tuple[Array, Array]:
        """Return q (nq,) and v (nv,) of a state; the work is zero."""
        q, v = self.tree.coordinates(self._welded.state(state))
        q = self.couplings.turned(q, state, self.time)
        return np.concatenate([q, np.zeros(self.nq - len(q))]), v

    def _set(self, q: Array, v: Array) -> None:
        """Set Drake's plant to a state."""
        self.placed.place(q[: self.tree.nq], v)

    def state(self, q: Array, v: Array) -> State:
        """Return the poses and velocities of the bodies; NaN for a state that is not finite."""
        if not (np.isfinite(q).all() and np.isfinite(v).all()):
            arrays = (np.full_like(array, np.nan) for array in State.initial(self.mechanism).arrays)
            return State(*arrays, angles=self.couplings.angles(q))
        self._set(q, v)
        return self._state(q, self._body_frames())

    def _body_frames(self) -> list[Frame]:
        """Return pose and velocity of each body of the welded mechanism at the present state."""
        ground = self.mechanism.bodies[0]
        found = [Frame(ground.center_of_mass, rotation(ground.quaternion), np.zeros(3), np.zeros(3))]
        for frame, initial in zip(self._frames, self.tree.initial_rotations[1:], strict=True):
            position, turn = self.placed.pose(frame)
            velocity = self.placed.velocity(frame)
            found.append(Frame(position, turn @ initial, velocity[:3], velocity[3:]))
        return found

    def _state(self, q: Array, frames: Sequence[Frame]) -> State:
        """Return the state of bodies with given frames."""
        frames = frames[: len(self.mechanism.bodies)]
        return State(
            np.array([frame.position for frame in frames]),
            np.array([from_rotation(frame.rotation) for frame in frames]),
            np.array([frame.velocity for frame in frames]),
            np.array([frame.angular_velocity for frame in frames]),
            angles=self.couplings.angles(q),
        )

    def _motions(self, q: Array, v: Array) -> Motions:
        """Return the joint coordinates that forces act on or that laws read, and their rates."""
        return {key: (float(q[on_q]), float(v[on_v])) for key, (on_q, on_v) in self._places.items()}

    def measure(self, q: Array, v: Array) -> list[tuple[Scalar, Scalar]]:
        """Return the coordinates that controllers read, and their rates."""
        motions = self._motions(q, v)
        return [motions[key] for key in self.scene.sensed]

    def rate(self, q: Array, v: Array) -> Array:
        """Return dq/dt (nq,); the rate of the work is the power."""
        rates = self.tree.rate(q[: self.tree.nq], v)
        return np.append(rates, self.power(q, v)) if self.scene.tracks_work else rates

    def power(self, q: Array, v: Array) -> float:
        """Return the power of forces without potential energy and of prescribed motions, W."""
        power = self.forces(q, v).power
        if self.scene.motions:
            of_couplings = self._solve(q, v).multipliers[len(self._closures.units) :]
            power += float(of_couplings @ self.couplings.rate(self.time))
        return power

    def retract(self, q: Array, step: Array) -> Array:
        """Move q by a small step (nv,)."""
        return np.concatenate([self.tree.retract(q, step), q[self.tree.nq :]])

    # Constraints

    def phi(self, q: Array) -> Array:
        """Return the residuals (k,) of loops, then of couplings, m or rad."""
        self._set(q, np.zeros(self.nv))
        return np.concatenate([self._closures.phi(), self.coupling_phi(q)])

    def phi_t(self) -> Array:
        """Return the partial derivative (k,) of `phi` with respect to time."""
        return np.concatenate([np.zeros(len(self._closures.units)), -self.couplings.rate(self.time)])

    def coupling_phi(self, q: Array) -> Array:
        """Return the residuals (c,) of the couplings, m or rad."""
        return self.couplings.phi(q, self.time)

    def phi_jacobian(self, q: Array) -> Array:
        """Return the constraint Jacobian (k, nv)."""
        self._set(q, np.zeros(self.nv))
        return self._jacobian(q)

    def _jacobian(self, q: Array) -> Array:
        """Return the constraint Jacobian (k, nv) at the present state, whose coordinates are q."""
        return np.concatenate([self._closures.jacobian(self.nv), self.couplings.jacobian(q)])

    def _gamma(self, q: Array, v: Array) -> Array:
        """Return gamma (k,) of J dv/dt = gamma at the present state, which is q and v."""
        return np.concatenate([self._closures.gamma(), self.couplings.gamma(q, v, self.time)])

    # Forces and accelerations

    def forces(self, q: Array, v: Array) -> TreeForces:
        """Compute the forces of the scene; those of the last state are kept."""
        key = self._key(q, v)
        if self._latest_forces is None or self._latest_forces[0] != key:
            self._set(q, v)
            self._latest_forces = key, self._forces(q, v)
        return self._latest_forces[1]

    def _key(self, q: Array, v: Array) -> tuple[Any, ...]:
        """Return a key of a state for results that are kept, with the scene, the time and frictions."""
        held = None if self.held_friction is None else tuple(self.held_friction.items())
        return self.scene, self.time, held, q.tobytes(), v.tobytes()

    def _forces(self, q: Array, v: Array) -> TreeForces:
        """Compute the forces of the scene at the present state, which is q and v."""
        scene, motions, time = self.scene, self._motions(q, v), self.time
        loads = BodyLoads.none(len(self.mechanism.bodies))
        if scene.body_forces:
            state = self._state(q, self._body_frames())
            loads = body_loads(scene, state, time, self.placed.built.springs)
        _, power, energy, _ = loads
        given: Mapping[Key, float] = {}
        if self._control:
            accelerations = list(commands(scene.control, motions, time))
            given = self._control.forces(q[: self.tree.nq], v, time, accelerations)
        friction = self.loaded_friction(q, v) if self._friction.elements else {}
        self._set(q, v)  # laws with a model and frictions have models of their own
        along, drives, control = np.zeros(self.nv), np.zeros(self.nv), list[float]()
        for place, element in enumerate(coordinate_elements(scene)):
            load = coordinate_load(element, motions, time, given)
            loaded = float(friction.get(element.identity, 0.0))
            is_native = any(element is each for each in self.placed.built.springs)
            energy += 0.0 if is_native else load.energy
            for key, force, elastic in zip(element.keys, load.forces, load.elastic, strict=True):
                _, on_v = self._places[key]
                drives[on_v] += force + loaded
                along[on_v] += 0.0 if is_native else force + loaded
                power += (force + loaded - elastic) * v[on_v]
            if place < len(scene.control):
                control += load.forces
        return TreeForces(along, drives, loads.wrenches, np.array(control), float(power), energy)

    def loaded_friction(self, q: Array, v: Array, factor: float = 1.0) -> HeldFriction:
        """Compute the frictions that grow with reactions, N or N m, by identity."""
        if self.held_friction is not None:
            return self.held_friction
        rates = [v[self._places[element.keys[0]][1]] for element in self._friction.elements]
        return self._friction.forces(self.scene, q, v, self.time, rates, factor)

    def mass_and_force(self, q: Array, v: Array) -> tuple[Array, Array]:
        """Return M (nv, nv) and f (nv,) of M dv/dt = f + J^T lambda."""
        forces = self.forces(q, v)
        self._set(q, v)
        mass = self.placed.mass_matrix() + np.diag(self._ball_rotors)
        return mass, self.placed.force(forces.along, forces.wrenches)

    def acceleration(self, q: Array, v: Array) -> Array:
        """Return dv/dt (nv,)."""
        return self._solve(q, v).acceleration

    def _solve(self, q: Array, v: Array) -> Solution:
        """Solve for accelerations and multipliers; those of the last state are kept."""
        key = self._key(q, v)
        if self._latest_solution is None or self._latest_solution[0] != key:
            if self._redundancy is None:
                self._redundancy = Redundancy.of(self)
            mass_and_force, rows = self.mass_and_force(q, v), (self._jacobian(q), self._gamma(q, v))
            found = solve_rigidly(self, self._redundancy, mass_and_force, rows)
            self._latest_solution = key, Solution(*found)
        return self._latest_solution[1]

    def servo_forces(self, q: Array, v: Array, keys: Sequence[Key], accelerations: Array) -> Array:
        """Return the forces on joint coordinates, N or N m, that cause given accelerations of them."""
        mass_and_force = self.mass_and_force(q, v)
        rows = self._jacobian(q), self._gamma(q, v)
        return servo_forces(self, mass_and_force, rows, keys, (tree_rows(self.tree, keys), accelerations))

    # Results for the bodies and joints of the scene

    def mass_properties(self) -> MassProperties:
        """Return the mass properties of Drake's plant at the initial pose."""
        self.placed.place_initially()
        return mass_properties(self.mechanism, self.placed)

    def joint_geometry(self) -> dict[str, JointGeometry]:
        """Return the joints of Drake's plant at the initial pose, by name."""
        self.placed.place_initially()
        return joint_geometry(self.placed)

    def velocity_transformation(self, q: Array) -> Array:
        """Return the Jacobian (6 b, nv) of the velocities of the bodies."""
        self._set(q, np.zeros(self.nv))
        moving = self._frames[: len(self.mechanism.bodies) - 1]
        return np.concatenate([np.zeros((6, self.nv)), *(self.placed.jacobian(frame) for frame in moving)])

    def observe(self, q: Array, v: Array) -> Observation:
        """Return poses, velocities and energies."""
        return Observation(state=self.state(q, v), **self._energies(q, v))

    def _energies(self, q: Array, v: Array) -> Energies:
        """Return the energies of a state."""
        energy = self.forces(q, v).energy
        self._set(q, v)
        kinetic, potential = self.placed.energies()
        return {
            "kinetic_energy": kinetic + 0.5 * float(self._ball_rotors @ v**2),
            "potential_energy": potential + energy,
            "work": float(q[self.tree.nq]) if self.scene.tracks_work else None,
        }

    def evaluate(self, q: Array, v: Array) -> Evaluation:
        """Return accelerations, reactions and energies.

        Raises:
            SingularityError: if the equations have no solution.
        """
        solution, forces = self._solve(q, v), self.forces(q, v)
        self._set(q, v)
        frames = self._body_frames()
        of_closures, of_couplings = np.split(solution.multipliers, [len(self._closures.units)])
        # wrenches on the bodies: applied ones, and those of the closures on both of their bodies
        wrenches = np.zeros((len(frames), 6))
        wrenches[: len(forces.wrenches)] += forces.wrenches
        of_loops = dict[int, Array]()
        for loop, wrench in self._closures.wrenches(of_closures):
            of_loops[loop.joint] = wrench
            point, _ = self.placed.pose(loop.second)
            ends = self._welded.mechanism.equations[loop.joint]
            for body, sign in ((ends.first, -1.0), (ends.second, 1.0)):
                wrenches[body] += sign * moved_wrench(wrench, point - frames[body].position)
        # forces on coordinates: applied ones, those of rotors on balls, and those of couplings
        on_balls = -self._ball_rotors * solution.acceleration
        along = forces.along + on_balls + self.couplings.jacobian(q).T @ of_couplings
        acceleration, transmitted = self.placed.transmitted(along, wrenches)
        bodies = self._frames[: len(self.mechanism.bodies) - 1]
        accelerations = np.zeros((len(self.mechanism.bodies), 6))
        for found, frame in zip(accelerations[1:], bodies, strict=True):
            found += self.placed.jacobian(frame) @ acceleration + self.placed.bias(frame)
        drives = forces.drives - self._rotors * solution.acceleration
        reaction = self._reactions(frames, transmitted, of_loops, drives)
        return Evaluation(
            state=self._state(q, frames),
            **self._energies(q, v),
            linear_acceleration=accelerations[:, :3],
            angular_acceleration=accelerations[:, 3:],
            reaction_force=reaction[:, :3],
            reaction_torque=reaction[:, 3:],
            actuator_force=forces.control,
        )

    def _reactions(
        self, frames: Sequence[Frame], transmitted: Array, of_loops: Mapping[int, Array], drives: Array
    ) -> Array:
        """Return the wrench (j, 6) of each joint on its second body, about its point there, without drives.

        Args:
            frames: frames of the bodies.
            transmitted: wrench (6,) of each joint of the tree on its child, about the origin of the world.
            of_loops: wrenches (6,) of the joints that close loops on their second bodies, about the anchors,
                by number of the joint.
            drives: (nv,) forces of drives, N or N m.
        """
        points, count = joint_points(self.mechanism, frames), len(self.mechanism.joints)
        found = np.zeros((count, 6))
        for joint, wrench in of_loops.items():
            if joint < count:  # welds between the halves of cut bodies follow
                found[joint] = wrench
        # columns: velocities of the children's material points at the origin of the world, and angular ones
        columns, on_axes = np.zeros((6, self.nv)), drives.copy()
        for tree_joint, wrench in zip(self.tree.joints, transmitted, strict=True):
            of_child = self.placed.jacobian(self._frames[tree_joint.child - 1])[:, tree_joint.v]
            arm = -frames[tree_joint.child].position
            columns[:3, tree_joint.v] = of_child[:3] + np.cross(of_child[3:], arm, axisa=0, axisc=0)
            columns[3:, tree_joint.v] = of_child[3:]
            if tree_joint.joint >= count:
                continue
            sign = 1.0 if tree_joint.forward else -1.0
            found[tree_joint.joint] = sign * moved_wrench(wrench, -points[tree_joint.joint])
            for motion, _, on_v in tree_joint.places:
                if motion.kind == "ball":
                    found[tree_joint.joint, 3:] -= sign * (columns[3:, on_v] @ drives[on_v])
                    on_axes[on_v] = 0.0
        for joint, wrench in drive_wrenches(self.tree, columns, points, on_axes):
            found[joint] -= wrench
        return found
