"""Statics: forces of actuators that hold a mechanism at rest, and reactions of its joints.

Statics is inverse dynamics with zero velocities and accelerations, and a check that no body accelerates.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from newton_euler.analysis.kinematics.poses import Poses
from newton_euler.analysis.loads.inverse_dynamics import Loads, compiled_dynamics, loads_of
from newton_euler.analysis.loads.states import States
from newton_euler.arguments import checked
from newton_euler.compiled.inverse_dynamics import InverseDynamics, SolvedStates
from newton_euler.equations.applied_forces import surroundings
from newton_euler.equations.parameters import measuring
from newton_euler.equations.redundancy import mobility
from newton_euler.equations.relative import Relative
from newton_euler.equations.servos import coordinate_rows, independent_rows, tangents
from newton_euler.errors import MechanismError
from newton_euler.model.elements import CoordinateForce
from newton_euler.model.joint import Key
from newton_euler.model.mechanism import Mechanism
from newton_euler.model.scene import Scene
from newton_euler.model.state import State
from newton_euler.model.trajectory import Trajectory
from newton_euler.runs.assemble import initial_state
from newton_euler.scalars import Array

MAX_UNBALANCED = 1e-7
"""Largest force on a body that may stay unbalanced, as a fraction of all forces on the body: round-off."""


@checked
def statics(
    scene: Scene,
    states: State | Trajectory | Poses | None = None,
    actuators: Sequence[str | Key] | None = None,
) -> Loads:
    """Compute the forces of actuators that hold a mechanism at rest, and all reactions of joints.

    Gravity, springs, wrenches and wind act; prescribed motions hold their coordinates; control laws do not
    act. Dry friction vanishes at rest, and elastic gears are rigid and without friction. Prescribed motions
    and wind have their values at time 0; in `rest_case` wind has its largest speed.

    Args:
        scene: the mechanism with its forces.
        states: one state, or a trajectory or poses of n states; velocities are ignored. The scene's initial
            state if None.
        actuators: joint coordinates that actuators act on, by the name of the joint, or by (name, number) for
            joints of several coordinates; those of the scene's control laws if None.

    Raises:
        MechanismError: naming the body that the actuators do not hold.
        NewtonEulerError: see `inverse_dynamics`.

    Examples:
        >>> held = statics(load("tracker_gravity"))
        >>> ball = held.joint_names.index("ball_67")
        >>> print(held.actuator_force.round(2), held.reaction_force[ball].round(2))  # N
        [7.06 5.77] [ 1.56 -2.48  4.66]
    """
    scene = scene.with_rigid_gears.with_unloaded_friction
    # states at rest, with prescribed motions that hold their coordinates
    given = States(scene, initial_state(scene) if states is None else states)
    given.velocities, original = None, scene
    if scene.motions:
        held_motions = tuple(motion.held_at_start() for motion in scene.motions)
        scene = replace(scene, motions=held_motions, initial_state=given.state(0))
    # inverse dynamics with zero accelerations of independent coordinates among those of the actuators
    keys = tuple(law.key for law in scene.control)
    if actuators is not None:
        keys = tuple(scene.mechanism.coordinate(name) for name in actuators)
    compiled = compiled_dynamics(scene, _independent(scene, given.state(0), keys), keys)
    zeros = [np.zeros(len(given))] * len(compiled.servos.coordinates)
    times = np.zeros(len(given))
    q, v = given.coordinates(compiled.system, times)
    solved = compiled.solve(q, v, zeros, times)
    _check_at_rest(compiled, given, solved)
    return loads_of(compiled, solved, original, given)


def _independent(scene: Scene, state: State, keys: tuple[Key, ...]) -> tuple[Key, ...]:
    """Choose as many of these joint coordinates as are independent at a state; return them in their order."""
    count = mobility(scene).degrees_of_freedom
    # `measuring` adds a control law of zero force for each key, so that the equations have this coordinate
    system = Relative(measuring(scene, keys))
    q, _ = system.coordinates(state)
    # derivatives of the coordinates along the motions that leave loops closed
    rows = coordinate_rows(system, q, keys) @ tangents(system, q)
    chosen = independent_rows(rows, chosen=[], candidates=range(len(keys)), count=count)
    return tuple(keys[k] for k in sorted(chosen))


def _check_at_rest(compiled: InverseDynamics, given: States, solved: SolvedStates) -> None:
    """Raise `MechanismError` for a body that accelerates although the actuators should hold it.

    Args:
        compiled: compiled inverse dynamics.
        given: the n states.
        solved: forces and accelerations at these states.
    """
    mechanism, size = compiled.scene.mechanism, compiled.scene.mechanism.size
    mass = np.array([body.mass for body in mechanism.bodies])
    inertia = np.array([np.linalg.norm(body.inertia, 2) for body in mechanism.bodies])
    linear = np.linalg.norm(solved.linear_acceleration, axis=-1)
    angular = np.linalg.norm(solved.angular_acceleration, axis=-1)
    # unbalanced force on each body (n, b), N: mass times acceleration; torques act at a lever of the
    # mechanism's characteristic length, m
    unbalanced = mass * linear + inertia * angular / size
    forces = _forces_on_bodies(compiled, solved)
    for row in np.flatnonzero(np.any(unbalanced > MAX_UNBALANCED * _scale(mechanism, forces), axis=1)):
        # the unbalanced force may be round-off of springs, wrenches and wind; these are computed only here,
        # because they take longer
        applied = _applied_forces(compiled.scene, given.state(int(row)))
        limits = MAX_UNBALANCED * _scale(mechanism, forces[row] + applied)
        accelerated = np.flatnonzero(unbalanced[row] > limits)
        if len(accelerated):
            body = accelerated[np.argmax(unbalanced[row, accelerated])]
            problem = f"is left with a force of {unbalanced[row, body]:.3g} N at state {row}"
            raise MechanismError(f"body {mechanism.body_names[body]!r}", problem, "actuators that hold it")


def _forces_on_bodies(compiled: InverseDynamics, solved: SolvedStates) -> Array:
    """Add up the magnitudes, N, of weights, reactions and actuators at each body (n, b).

    A torque counts as a force at a lever of the mechanism's size.
    """
    scene, mechanism, size = compiled.scene, compiled.scene.mechanism, compiled.scene.mechanism.size
    weights = [body.mass * np.linalg.norm(scene.gravity) for body in mechanism.bodies]
    on_bodies = np.tile(weights, (len(solved.reaction_force), 1))
    at_joints = np.linalg.norm(solved.reaction_force, axis=-1)
    at_joints = at_joints + np.linalg.norm(solved.reaction_torque, axis=-1) / size
    for key, force in zip(compiled.servos.actuators, solved.actuator_force.T, strict=True):
        lever = 1.0 if mechanism.is_slide(*key) else size
        at_joints[:, mechanism.joint_index(key[0])] += np.abs(force) / lever
    # `equations` of a joint have the indices of its two bodies
    for joint, equations in enumerate(mechanism.equations):
        on_bodies[:, [equations.first, equations.second]] += at_joints[:, [joint]]
    return on_bodies


def _applied_forces(scene: Scene, state: State) -> Array:
    """Add up the magnitudes, N, of springs, wrenches and wind at each body (b,)."""
    # `surroundings`: poses, velocities and joint coordinates on which forces depend
    mechanism, force_inputs = scene.mechanism, surroundings(scene, state)
    on_bodies = np.zeros(len(mechanism.bodies))
    for force in scene.forces:
        if isinstance(force, CoordinateForce):
            equations = mechanism.joint_equations(force.joint)
            bodies = [equations.first, equations.second]
        else:
            bodies = [body for body, _ in force.wrenches(force_inputs)]
        on_bodies[bodies] += force.magnitude(force_inputs)
    return on_bodies


def _scale(mechanism: Mechanism, forces: Array) -> Array:
    """Return the forces (..., b), N, with which unbalanced forces on bodies are compared.

    A body on which small forces act still has the round-off of its neighbors' accelerations. The scale of a
    body is at least its mass times (sum of all forces, divided by the sum of all masses).

    Args:
        mechanism: gives the masses of the b bodies.
        forces: (..., b) sums of the magnitudes of the forces on each body, N.
    """
    mass = np.array([body.mass for body in mechanism.bodies])
    return np.maximum(forces, mass * forces.sum(axis=-1, keepdims=True) / mass.sum())
