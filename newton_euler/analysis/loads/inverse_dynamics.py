"""Inverse dynamics and statics: forces of actuators and reactions of joints for wanted accelerations.

The equations of motion are solved with the wanted accelerations as further constraints
(`newton_euler.equations.formulation.Formulation.servo_forces`), so that closed loops, freedoms that no
actuator holds and redundant actuators are all one case. Both programs are compiled once for a scene, and take
thousands of states at once.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Any, NamedTuple

import numpy as np

from newton_euler.analysis.kinematics.poses import Poses
from newton_euler.arguments import checked
from newton_euler.codegen.compile import LARGE, NativeFunction, Traced
from newton_euler.codegen.expression import Graph
from newton_euler.codegen.fingerprint import fingerprint
from newton_euler.compiled.equations import NEUTRAL
from newton_euler.compiled.outputs import at_rows
from newton_euler.equations.applied_forces import surroundings
from newton_euler.equations.couplings import counted_angles
from newton_euler.equations.formulation import Servos
from newton_euler.equations.parameters import measuring, numbered, pieces, with_values
from newton_euler.equations.redundancy import mobility
from newton_euler.equations.relative import Relative
from newton_euler.equations.row_choice import exchangeable_rows, flags_at
from newton_euler.equations.servos import coordinate_rows, fault, independent_rows, servos_of, tangents
from newton_euler.equations.system import Evaluation, at_time
from newton_euler.errors import MechanismError, SingularityError, finite_array, quoted
from newton_euler.integrators.projection import worst_joint
from newton_euler.model.elements import CoordinateForce
from newton_euler.model.joint import Key
from newton_euler.model.scene import Scene
from newton_euler.model.state import State, whole_revolutions
from newton_euler.model.trajectory import Trajectory
from newton_euler.runs.assemble import check_revolutions, initial_state
from newton_euler.scalars import Array, Floats, Scalar, minimum

NEAR = 1e-4  # dimensionless singular value, of the rows of which one is named, of a failed elimination
KEPT = 8  # scenes, most recently used, whose code stays in memory
AT_REST = 1e-7  # share of the forces on a body that may accelerate it in statics: round-off
OPEN = 1e-6  # sizes of the mechanism, or rad, that loops of a state may be open by: more than engines leave


@dataclass(frozen=True, eq=False)
class Loads:
    """Forces of actuators and reactions of joints at n states; b bodies, j joints, a actuators; SI.

    Of a single state arrays are without their first axis.

    Attributes:
        actuators: the coordinates that the actuators act on, by the name of the joint, or by (name, number)
            where it has several.
        joint_names: of the reactions.
        actuator_force: (n, a) N or N m.
        reaction_force, reaction_torque: (n, j, 3) on the second body, about its joint point, world frame; not
            unique where constraints are redundant, see `newton_euler.equations.reactions`.

    Examples:
        >>> held = statics(load("tracker_gravity"))
        >>> isinstance(held, Loads), held.actuator_force.shape
        (True, (2,))
    """

    actuators: tuple[str | Key, ...]
    joint_names: tuple[str, ...]
    actuator_force: Floats
    reaction_force: Floats
    reaction_torque: Floats

    def __repr__(self) -> str:
        states = len(self.actuator_force) if self.actuator_force.ndim == 2 else 1
        return (
            f"<Loads at {states} states: actuators: {len(self.actuators)}, joints: {len(self.joint_names)}>"
        )


@checked
def inverse_dynamics(
    scene: Scene,
    states: State | Trajectory | Poses,
    accelerations: Mapping[str | Key, Any],
    actuators: Sequence[str | Key] | None = None,
    rates: Mapping[str | Key, Any] | None = None,
    time: Any = None,
) -> Loads:
    """Compute the forces of actuators that give joint coordinates wanted accelerations, and all reactions.

    Gravity, springs, dampers, wrenches, rotors and prescribed motions act as in a run; control laws are left
    out. Freedoms that nothing is wanted of move freely, if the actuators are on the coordinates themselves.
    Of more actuators than coordinates the forces are the smallest: least sum of squares in N m, those on
    slides times the mechanism's size.

    Args:
        scene: the mechanism with its forces.
        states: a state, or n of them: a trajectory, or poses of `newton_euler.solve_poses`, which are at
            rest. Loops are closed.
        accelerations: m/s^2 or rad/s^2, one number or (n,), by the name of the joint, or by (name, number)
            for joints of several coordinates.
        actuators: coordinates that actuators act on; those of the scene's control laws if None, and if it
            has none those of `accelerations`.
        rates: m/s or rad/s of the same coordinates, 0 for those that are left out, in place of the velocities
            of the states. Other freedoms move with the least kinetic energy.
        time: s, of prescribed motions, one number or (n,); those of a trajectory, or 0, if None.

    Raises:
        UnknownNameError: for an unknown joint.
        MechanismError: naming the coordinate that cannot get any acceleration, a value that is no number, or
            a state that is none of the scene.
        SingularityError: naming the coordinate, at a state where its acceleration cannot be chosen.

    Examples:
        >>> scene = load("tracker")
        >>> run = simulate(scene)
        >>> found = inverse_dynamics(scene, run, {"slide_12": 0.0, "slide_13": np.zeros(len(run.time))})
        >>> found.actuators, found.actuator_force.shape
        (('slide_12', 'slide_13'), (501, 2))
    """
    mechanism = scene.mechanism
    coordinates = tuple(mechanism.coordinate(name) for name in accelerations)
    if actuators is None:
        acting = tuple(law.key for law in scene.control) or coordinates
    else:
        acting = tuple(mechanism.coordinate(name) for name in actuators)
    if set(acting) == set(coordinates):
        acting = coordinates
    compiled = _compiled(scene, coordinates, acting)
    given = States(scene, states)
    wanted = [given.column(f"acceleration of {quoted(name)}", value) for name, value in accelerations.items()]
    times = given.column("time", getattr(states, "time", 0.0) if time is None else time)
    if times.size:
        compiled.scene.check_functions(float(times.min()), float(times.max()), "the times asked for")
    q, v = given.coordinates(compiled.system, times)
    if rates is not None:
        moving = {mechanism.coordinate(name): (name, value) for name, value in rates.items()}
        for key in moving:
            if key not in coordinates:
                name = mechanism.coordinate_name(key)
                raise MechanismError(
                    f"rate of {quoted(name)}", "has no acceleration beside it", "both of them"
                )
        pairs = [moving.get(key, (key, 0.0)) for key in coordinates]
        v = compiled.velocities(
            q, [given.column(f"rate of {quoted(name)}", value) for name, value in pairs], times
        )
    return compiled.loads(given, (q, v), wanted, times).loads


@checked
def statics(
    scene: Scene,
    states: State | Trajectory | Poses | None = None,
    actuators: Sequence[str | Key] | None = None,
) -> Loads:
    """Compute the forces of actuators that hold a mechanism at rest, and all reactions of joints.

    Gravity, springs and wrenches act; prescribed motions hold what they move; control laws are left out.

    Args:
        scene: the mechanism with its forces.
        states: as of `inverse_dynamics`, velocities left out; the scene's initial pose if None.
        actuators: as of `inverse_dynamics`; those of the scene's control laws if None.

    Raises:
        MechanismError: naming the body that the actuators do not hold.
        NewtonEulerError: as of `inverse_dynamics`.

    Examples:
        >>> held = statics(load("tracker_gravity"))
        >>> held.actuators, held.reaction_force.shape
        (('slide_12', 'slide_13'), (8, 3))
    """
    given = States(scene, initial_state(scene) if states is None else states)
    given.velocities = None
    if scene.motions:
        still = tuple(motion.held() for motion in scene.motions)
        scene = replace(scene, motions=still, initial_state=given.state(0))
    keys = tuple(law.key for law in scene.control)
    if actuators is not None:
        keys = tuple(scene.mechanism.coordinate(name) for name in actuators)
    compiled = _compiled(scene, _independent(scene, given.state(0), keys), keys)
    zeros = [np.zeros(len(given))] * len(compiled.servos.coordinates)
    times = np.zeros(len(given))
    found = compiled.loads(given, given.coordinates(compiled.system, times), zeros, times)
    compiled.check_at_rest(given, found)
    return found.loads


def _independent(scene: Scene, state: State, keys: tuple[Key, ...]) -> tuple[Key, ...]:
    """Choose as many of these coordinates as are independent at a state, in their order."""
    count = mobility(scene).degrees_of_freedom
    system = Relative(measuring(scene, keys))
    q, _ = system.coordinates(state)
    rows = coordinate_rows(system, q, keys) @ tangents(system, q)
    chosen = independent_rows(rows, [], range(len(keys)), count)
    return tuple(keys[k] for k in sorted(chosen))


class States:
    """States of a scene, checked.

    Attributes:
        position, quaternion: (n, b, 3) and (n, b, 4).
        velocities: linear and angular ones (n, b, 3); None at rest.
        angles: (n,) rad with their revolutions, by joint coordinate, as far as they are given.
        is_single: True for one that was given alone.
    """

    def __init__(self, scene: Scene, given: Any) -> None:
        """Take states from a state or poses; raises `MechanismError` for anything else."""
        where = f"states of scene {quoted(scene.name)}"
        arrays: list[Any] = [getattr(given, name, None) for name in ("position", "quaternion")]
        if not all(isinstance(array, np.ndarray) and array.ndim in (2, 3) for array in arrays):
            raise MechanismError(
                where, f"is {quoted(given)}", "a State, a Trajectory or other poses of bodies"
            )
        moving = [getattr(given, name, None) for name in ("linear_velocity", "angular_velocity")]
        arrays += [each for each in moving if each is not None]
        self.is_single = arrays[0].ndim == 2
        self.position, self.quaternion, *both = (a[None] for a in arrays) if self.is_single else arrays
        self.velocities = both if len(both) == len(moving) else None
        self._solved = given if isinstance(given, Poses) else None
        self.angles: Mapping[Key, Array] = {}
        if self._solved is None:
            for row in range(len(self)):
                scene.check_numbers(self.state(row), where)
        if isinstance(given, State):
            scene.check_angles(given.angles, where)
            check_revolutions(scene, given)
        self.angles = _angles(scene, given)

    def __len__(self) -> int:
        return len(self.position)

    def state(self, row: int) -> State:
        """Return one of the states."""
        still = np.zeros_like(self.position[row])
        moving = (still, still) if self.velocities is None else (each[row] for each in self.velocities)
        angles = {key: float(angle[row]) for key, angle in self.angles.items()}
        return State(self.position[row], self.quaternion[row], *moving, angles=angles)

    def coordinates(self, system: Relative, times: Array) -> tuple[Array, Array]:
        """Compute q (n, nq) and v (n, nv) of a system of the scene at times (n,), s."""
        if self._solved is not None and system.nq == system.tree.nq:
            q = self._solved.tree_coordinates.copy()
            for key, place in system.angles.items():
                q[:, place] += whole_revolutions(self.angles.get(key, 0.0) - q[:, place])
            return q, np.zeros((len(self), system.nv))
        systems = (at_time(system, float(t)) for t in times)
        found = [each.coordinates(self.state(row)) for row, each in enumerate(systems)]
        return np.array([q for q, _ in found]), np.array([v for _, v in found])

    def column(self, name: str, value: Any) -> Array:
        """Return a number for each state, (n,); raises `MechanismError`."""
        shape = (len(self),) if isinstance(value, Sequence) or bool(getattr(value, "ndim", False)) else ()
        return np.broadcast_to(finite_array("inverse dynamics", name, value, shape), len(self))


def _angles(scene: Scene, given: Any) -> Mapping[Key, Array]:
    """Return the angles (n,) with their revolutions, rad, of states by joint coordinate, as far as given.

    Angles that a trajectory does not carry, as no force of its scene depended on them, follow their rates.
    """
    if isinstance(given, State):
        return {key: np.array([angle]) for key, angle in given.angles.items()}
    if isinstance(given, Poses):
        return given.angles
    if not isinstance(given, Trajectory):
        return {}
    run = replace(given, mechanism=scene.mechanism)
    return {(joint, k): run.joint(joint).coordinates[:, k] for joint, k in counted_angles(scene)}


class Solved(NamedTuple):
    """Loads, and the accelerations (n, b, 3) of the bodies with them."""

    loads: Loads
    linear_acceleration: Array
    angular_acceleration: Array


@lru_cache(maxsize=KEPT)
def _compiled(scene: Scene, coordinates: tuple[Key, ...], actuators: tuple[Key, ...]) -> InverseDynamics:
    return InverseDynamics(scene, coordinates, actuators)


class InverseDynamics:
    """Inverse dynamics of a scene in native code; see `inverse_dynamics`.

    Attributes:
        scene: with laws of no force on the coordinates and the actuators for its control.
        servos: the coordinates and the actuators.
        system: in joint coordinates.
    """

    def __init__(self, scene: Scene, coordinates: tuple[Key, ...], actuators: tuple[Key, ...]) -> None:
        self.scene = measuring(scene, [*actuators, *coordinates])
        self.servos = servos_of(scene, coordinates, actuators)
        self.system = Relative(self.scene)
        self._exchangeable = exchangeable_rows(self.system)

    @cached_property
    def forces(self) -> NativeFunction:
        """Of (q, v, flags, wanted accelerations, time, pieces): forces (a,), pivot ratio, squared loop
        residual."""
        return self._function("forces", self._trace_forces, len(self.servos.coordinates))

    @cached_property
    def motion(self) -> NativeFunction:
        """Of (q, anything, flags, rates, time, pieces): v (nv,) and pivot ratio."""
        return self._function("motion", self._trace_motion, len(self.servos.coordinates))

    @cached_property
    def evaluation(self) -> NativeFunction:
        """Of (q, v, flags, actuator forces, time, pieces): `Solved` arrays, one after the other."""
        return self._function("loads", self._trace_evaluation, len(self.servos.actuators))

    def _function(self, name: str, trace: Callable[..., list[Scalar]], inputs: int) -> NativeFunction:
        held = pieces(self.scene, 0.0)
        rows = self._exchangeable.numbers
        ends = np.cumsum([self.system.nq, self.system.nv, len(rows), inputs, 1, *map(len, held.values())])

        def traced() -> Traced:
            graph = Graph()
            q, v, flags, given, (time,), *numbers = np.split(graph.variables(int(ends[-1])), ends[:-1])
            scene = with_values(self.scene, dict(zip(held, numbers, strict=True)))
            servos = self.servos.with_flags(dict(zip(rows, flags, strict=True)))
            program = graph.prune(trace(scene, servos, q, v, given, time))
            return Traced(program, many=program.operations < LARGE)

        begun = [float(motion.function.value(0.0)) for motion in self.scene.motions]
        chosen = self.servos.coordinates, self.servos.actuators, begun
        known = fingerprint(self.scene, *chosen, neutral=NEUTRAL)
        return NativeFunction(traced, known and f"{known} inverse dynamics {name}")

    def _trace_forces(
        self, scene: Scene, servos: Servos, q: Array, v: Array, accelerations: Array, time: Scalar
    ) -> list[Scalar]:
        system = at_time(Relative(scene), time)
        forces, pivot_ratio = system.servo_forces(q, v, servos, list(accelerations))
        loops = system.rows - len(system.couplings)
        phi = (system.phi(q) / system.phi_units)[:loops]
        return [*forces, minimum(pivot_ratio, 1.0), phi @ phi]

    def _trace_motion(
        self, scene: Scene, servos: Servos, q: Array, v: Array, rates: Array, time: Scalar
    ) -> list[Scalar]:
        system = at_time(Relative(scene), time)
        found, pivot_ratio = system.servo_velocities(q, servos, list(rates))
        return [*found, minimum(pivot_ratio, 1.0)]

    def _trace_evaluation(
        self, scene: Scene, servos: Servos, q: Array, v: Array, forces: Array, time: Scalar
    ) -> list[Scalar]:
        found, _ = self._acting(scene, forces, time).sparse_evaluation(q, v, servos.rows)
        return [scalar for array in _arrays(found) for scalar in array.ravel()]

    def _acting(self, scene: Scene, forces: Array, time: Scalar) -> Relative:
        """Return the equations of the scene with these forces of actuators (a,)."""
        values = {numbered("control", k, "feedforward"): u for k, u in enumerate(forces)}
        return at_time(Relative(with_values(scene, values)), time)

    def _moments(self, time: Array) -> Array:
        """Return times (n,), s, with the pieces of functions there."""
        if not pieces(self.scene, 0.0):
            return time[:, None]
        return np.array([np.concatenate([[t], *pieces(self.scene, t).values()]) for t in time.tolist()])

    def flags(self, q: Array) -> Array:
        """Choose constraint rows at q (n, nq): flags (n, m) of exchangeable ones."""
        rows = self._exchangeable
        chosen = [flags_at(self.system, each, self.servos.rows.numbers, rows) for each in q if rows.numbers]
        return np.array(chosen).reshape(len(q), len(rows.numbers))

    def velocities(self, q: Array, rates: Sequence[Array], time: Array) -> Array:
        """Compute v (n, nv) of rates (n,) of each coordinate at q (n, nq) and times (n,)."""
        nothing, flags = np.zeros((len(q), self.system.nv)), self.flags(q)
        found = at_rows(self.motion, np.column_stack([q, nothing, flags, *rates, self._moments(time)]))
        self._check_pivots(found[:, -1], found, q)
        return found[:, :-1]

    def _check_pivots(self, pivot_ratio: Array, found: Array, q: Array) -> None:
        """Raise `SingularityError` for the first state whose pivot ratio (n,) or results are no good."""
        for row in np.flatnonzero(~(pivot_ratio > 0.0) | ~np.isfinite(found).all(axis=1))[:1]:
            flags = dict(zip(self._exchangeable.numbers, self.flags(q[[row]])[0].tolist(), strict=True))
            at = fault(self.system, q[row], self.servos.with_flags(flags), NEAR)
            if at is None and not len(self.servos.rows.numbers):
                problem = f"has no finite solution at state {row}"
                raise MechanismError("inverse dynamics", problem, "smaller rates and accelerations")
            if at is None:
                cut = self.system.row_owners[self.servos.rows.numbers[0]]
                raise SingularityError(cut, f"the loops at state {row} do not determine the motion")
            raise SingularityError(at[0][0], f"at state {row} the coordinate {at[1]}")

    def loads(
        self, given: States, own: tuple[Array, Array], accelerations: Sequence[Array], time: Array
    ) -> Solved:
        """Solve for wanted accelerations (n,) of each coordinate at n states, with own q and v, and times."""
        table, flags, moments = np.column_stack(own), self.flags(own[0]), self._moments(time)
        found = at_rows(self.forces, np.column_stack([table, flags, *accelerations, moments]))
        forces, pivot_ratio, opening = found[:, :-2], found[:, -2], found[:, -1]
        for row in np.flatnonzero(~(opening <= OPEN**2))[:1]:
            joint, distance = worst_joint(self.system, given.state(row))
            problem = f"joint {quoted(joint)} is open by {distance:.3g} (m or rad)"
            raise MechanismError(f"state {row}", problem, f"closed loops, to {OPEN:g} sizes of the mechanism")
        self._check_pivots(pivot_ratio, forces, own[0])
        shapes = [(len(self.scene.mechanism.joints), 3)] * 2 + [(len(self.scene.mechanism.bodies), 3)] * 2
        ends = np.cumsum([j * k for j, k in shapes])
        if mobility(self.scene).redundant:  # the float form knows the smallest reactions
            values = self._dense(table, forces, time)
        else:
            values = at_rows(self.evaluation, np.column_stack([table, flags, forces, moments]))
        arrays = [
            part.reshape(-1, *shape)
            for part, shape in zip(np.split(values, ends[:-1], 1), shapes, strict=True)
        ]
        if given.is_single:
            forces, arrays = forces[0], [array[0] for array in arrays]
        names = tuple(map(self.scene.mechanism.coordinate_name, self.servos.actuators))
        loads = Loads(names, self.scene.mechanism.joint_names, forces, *arrays[:2])
        return Solved(loads, *arrays[2:])

    def _dense(self, table: Array, forces: Array, time: Array) -> Array:
        rows = []
        for x, u, t in zip(table, forces, time, strict=True):
            system = self._acting(self.scene, u, float(t))
            found = system.evaluate(x[: system.nq], x[system.nq :])
            rows.append(np.concatenate([array.ravel() for array in _arrays(found)]))
        return np.array(rows)

    def check_at_rest(self, given: States, found: Solved) -> None:
        """Raise `MechanismError` for a body that forces accelerate."""
        mechanism, size = self.scene.mechanism, self.scene.mechanism.size
        mass = np.array([body.mass for body in mechanism.bodies])
        inertia = np.array([np.linalg.norm(body.inertia, 2) for body in mechanism.bodies])
        linear, angular = (
            np.linalg.norm(array, axis=-1)
            for array in (found.linear_acceleration, found.angular_acceleration)
        )
        left = np.atleast_2d(mass * linear + inertia * angular / size)
        known = self._forces_on_bodies(found.loads)
        for row in np.flatnonzero(np.any(left > AT_REST * self._scale(known), axis=1)):
            forces = self._scale(known[row] + self._applied(given.state(int(row))))
            moved = np.flatnonzero(left[row] > AT_REST * forces)
            if len(moved):
                body = moved[np.argmax(left[row, moved])]
                problem = f"is left with a force of {left[row, body]:.3g} N at state {row}"
                raise MechanismError(
                    f"body {mechanism.body_names[body]!r}", problem, "actuators that hold it"
                )

    def _forces_on_bodies(self, loads: Loads) -> Array:
        """Add up the sizes, N, of weights, reactions and actuators at each body (n, b).

        Torques act at arms of the mechanism's size.
        """
        mechanism, size = self.scene.mechanism, self.scene.mechanism.size
        forces, torques, acting = (
            array if array.ndim > single else array[None]
            for array, single in (
                (loads.reaction_force, 2),
                (loads.reaction_torque, 2),
                (loads.actuator_force, 1),
            )
        )
        weights = [body.mass * np.linalg.norm(self.scene.gravity) for body in mechanism.bodies]
        found = np.tile(weights, (len(forces), 1))
        at_joints = np.linalg.norm(forces, axis=-1) + np.linalg.norm(torques, axis=-1) / size
        for key, force in zip(self.servos.actuators, acting.T, strict=True):
            arm = 1.0 if mechanism.is_slide(*key) else size
            at_joints[:, mechanism.joint_index(key[0])] += np.abs(force) / arm
        for joint, equations in enumerate(mechanism.equations):
            found[:, [equations.first, equations.second]] += at_joints[:, [joint]]
        return found

    def _applied(self, state: State) -> Array:
        """Add up the sizes, N, of springs, wrenches and wind at each body (b,)."""
        mechanism, at = self.scene.mechanism, surroundings(self.scene, state)
        found = np.zeros(len(mechanism.bodies))
        for force in self.scene.forces:
            if isinstance(force, CoordinateForce):
                equations = mechanism.joint_equations(force.joint)
                bodies = [equations.first, equations.second]
            else:
                bodies = [body for body, _ in force.wrenches(at)]
            found[bodies] += force.magnitude(at)
        return found

    def _scale(self, forces: Array) -> Array:
        """Return the forces (..., b) that accelerations of bodies are measured against, N.

        A body on which little acts has the round-off of its neighbors' accelerations: those that all forces
        together give all masses.
        """
        mass = np.array([body.mass for body in self.scene.mechanism.bodies])
        return np.maximum(forces, mass * forces.sum(axis=-1, keepdims=True) / mass.sum())


def _arrays(found: Evaluation) -> tuple[Array, ...]:
    """Return the arrays of `Solved` but the forces, in their order."""
    return (
        found.reaction_force,
        found.reaction_torque,
        found.linear_acceleration,
        found.angular_acceleration,
    )
