"""Inverse dynamics: forces of actuators and reactions of joints for given states and accelerations.

`inverse_dynamics` checks its arguments, calls compiled equations and names the results. The method is
described in `newton_euler.compiled.inverse_dynamics`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import numpy as np

from newton_euler.analysis.kinematics.crossings import beyond_start
from newton_euler.analysis.kinematics.poses import Poses
from newton_euler.analysis.loads.states import States
from newton_euler.arguments import checked
from newton_euler.compiled.equations import CACHED_SCENES
from newton_euler.compiled.inverse_dynamics import InverseDynamics, SolvedStates
from newton_euler.equations.load_friction import loaded_frictions
from newton_euler.errors import MechanismError, quoted
from newton_euler.model.joint import Key
from newton_euler.model.scene import Scene
from newton_euler.model.state import State
from newton_euler.model.trajectory import Trajectory
from newton_euler.scalars import Array, Floats


@dataclass(frozen=True, eq=False)
class Loads:
    """Forces of actuators and reactions of joints at n states; j joints, a actuators; SI.

    If a single state was given, the arrays have no first axis.

    Attributes:
        actuators: the coordinates that the actuators act on, by the name of the joint, or by (name, number)
            for joints of several coordinates.
        joint_names: names (j,) of the joints of the reactions.
        actuator_force: (n, a) N or N m.
        reaction_force, reaction_torque: (n, j, 3) N and N m, on the second body of each joint, the torque
            about its joint point, world frame. If constraints are redundant, reactions are not unique.

    Examples:
        >>> held: Loads = statics(load("tracker_gravity"))
        >>> print(held.actuators, held.actuator_force.round(2), "N")
        ('slide_12', 'slide_13') [7.06 5.77] N
    """

    actuators: tuple[str | Key, ...]
    joint_names: tuple[str, ...]
    actuator_force: Floats
    reaction_force: Floats
    reaction_torque: Floats
    _scene: Scene
    _states: States

    @cached_property
    def beyond(self) -> Array:
        """True (n,) for states on another assembly branch than the scene's initial state.

        The mechanism reaches them only through a configuration in which its independent joint coordinates,
        those of control laws first, do not determine the motion. The actuators cannot bring it there.
        """
        beyond = beyond_start(self._scene, self._states)
        return np.asarray(beyond[0]) if self.actuator_force.ndim == 1 else beyond

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

    Gravity, springs, dampers, wrenches, rotors and prescribed motions act as in a run; control laws do not.
    If the actuators act on the coordinates themselves, degrees of freedom without a wanted acceleration move
    freely. Otherwise there must be as many wanted accelerations as degrees of freedom. If there are more
    actuators than coordinates, the forces with the least sum of squares are taken, in N m: forces on slides
    are multiplied by the mechanism's size.

    Args:
        scene: the mechanism with its forces.
        states: one state; or n states: a trajectory, or poses of `newton_euler.solve_poses`, which are at
            rest. Loops must be closed.
        accelerations: m/s^2 or rad/s^2, one number or (n,), by the name of the joint, or by (name, number)
            for joints of several coordinates.
        actuators: joint coordinates that actuators act on. If None, the coordinates of the scene's control
            laws, or of `accelerations` if the scene has none.
        rates: m/s or rad/s of the same coordinates, in place of the velocities of the states; a coordinate
            without a rate has 0. Other degrees of freedom move with the least kinetic energy.
        time: s, of prescribed motions, one number or (n,); the times of a trajectory, or 0, if None.

    Raises:
        UnknownNameError: for an unknown joint.
        MechanismError: naming the coordinate that cannot get any acceleration, a value that is no number, a
            state that does not belong to the scene, or friction that grows with the reaction of its joint.
        SingularityError: naming the coordinate, at a state where its acceleration cannot be chosen.

    Examples:
        >>> scene = load("tracker")
        >>> run = simulate(scene)
        >>> found = inverse_dynamics(scene, run, {"slide_12": 0.0, "slide_13": np.zeros(len(run.time))})
        >>> print(found.actuators, abs(found.actuator_force).max(axis=0).round(3), "N")
        ('slide_12', 'slide_13') [0.235 0.014] N
    """
    for friction in loaded_frictions(scene):  # depends on the reactions, which the unknown forces change
        value = f"load_coefficient is {float(friction.load_coefficient):g}"
        raise MechanismError(friction.element, value, "0: inverse dynamics has only friction of known force")
    # coordinates and actuators
    mechanism = scene.mechanism
    coordinates = tuple(mechanism.coordinate(name) for name in accelerations)
    if actuators is None:
        actuator_keys = tuple(law.key for law in scene.control) or coordinates
    else:
        actuator_keys = tuple(mechanism.coordinate(name) for name in actuators)
    # if the actuators act on the coordinates themselves, the same order lets the compiled equations give the
    # forces without a further solution
    if set(actuator_keys) == set(coordinates):
        actuator_keys = coordinates
    compiled = compiled_dynamics(scene, coordinates, actuator_keys)
    # states, accelerations and times as arrays
    given = States(scene, states)
    wanted = [given.column(f"acceleration of {quoted(name)}", value) for name, value in accelerations.items()]
    times = given.column("time", getattr(states, "time", 0.0) if time is None else time)
    if times.size:
        compiled.scene.check_functions(float(times.min()), float(times.max()), "the times asked for")
    q, v = given.coordinates(compiled.system, times)
    # velocities from rates of the coordinates
    if rates is not None:
        by_key = {mechanism.coordinate(name): (name, value) for name, value in rates.items()}
        for key in by_key:
            if key not in coordinates:
                name = mechanism.coordinate_name(key)
                problem = "has no acceleration beside it"
                raise MechanismError(f"rate of {quoted(name)}", problem, "both of them")
        pairs = [by_key.get(key, (key, 0.0)) for key in coordinates]
        columns = [given.column(f"rate of {quoted(name)}", value) for name, value in pairs]
        v = compiled.velocities(q, columns, times)
    return loads_of(compiled, compiled.solve(q, v, wanted, times), scene, given)


@lru_cache(maxsize=CACHED_SCENES)
def compiled_dynamics(
    scene: Scene, coordinates: tuple[Key, ...], actuators: tuple[Key, ...]
) -> InverseDynamics:
    """Return the compiled inverse dynamics of a scene, from a cache if it was compiled before.

    Args:
        scene: the scene.
        coordinates: joint coordinates with given accelerations.
        actuators: joint coordinates that the unknown forces act on.
    """
    return InverseDynamics(scene, coordinates, actuators)


def loads_of(compiled: InverseDynamics, solved: SolvedStates, scene: Scene, given: States) -> Loads:
    """Return the loads of solved states as a record.

    Args:
        compiled: compiled inverse dynamics; its `servos` name the coordinates and the actuators.
        solved: results for n states.
        scene: the scene that the user gave.
        given: the states. If a single state was given, the arrays lose their first axis.
    """
    mechanism = compiled.scene.mechanism
    arrays = [solved.actuator_force, solved.reaction_force, solved.reaction_torque]
    names = tuple(map(mechanism.coordinate_name, compiled.servos.actuators))
    u, force, torque = (array[0] if given.is_single else array for array in arrays)
    return Loads(names, mechanism.joint_names, u, force, torque, scene, given)
