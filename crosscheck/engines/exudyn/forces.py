"""Applied forces of a scene, computed from the attributes of its elements.

Exudyn's connectors have springs, dampers and PD laws of their own, see
`crosscheck.engines.exudyn.connectors`. The other forces are user functions in Python, which call this module.
It does not use the methods of the elements that newton_euler's equations use, so that a mistake in them shows
as a difference between engines.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple, assert_never

import numpy as np

from newton_euler.model.control import DeclaredLaw
from newton_euler.model.digital_control import HeldLaw, Law
from newton_euler.model.forces import BallSpring, Force, JointSpring, PointSpring, Wrench
from newton_euler.model.joint import Key
from newton_euler.model.mechanism import Mechanism
from newton_euler.model.motions import TimeFunction
from newton_euler.model.scene import Scene
from newton_euler.model.state import State
from newton_euler.model.switched_forces import ElasticGear, JointFriction, JointStop
from newton_euler.model.variable import altered
from newton_euler.model.wind import WindLoad
from newton_euler.reading.switched_loads import SwitchedLoad, switched_load
from newton_euler.reading.wrenches import Wrenches
from newton_euler.scalars import Array

CoordinateElement = Law | JointSpring | JointFriction | JointStop | ElasticGear
"""Element whose forces act along joint coordinates."""

Motions = Mapping[Key, tuple[float, float]]
"""Joint coordinates, m or rad with full revolutions, and their rates, by key."""


def coordinate_elements(scene: Scene) -> list[CoordinateElement]:
    """Return the control laws, then the other forces along joint coordinates; the order is the scene's."""
    kinds = (JointSpring, JointFriction, JointStop, ElasticGear)
    return [*scene.control, *(force for force in scene.forces if isinstance(force, kinds))]


def coordinate_load(
    element: CoordinateElement, motions: Motions, time: float, given: Mapping[Key, float]
) -> SwitchedLoad:
    """Compute the forces of an element along its joint coordinates `element.keys`.

    Args:
        element: control law, spring, friction, stop or elastic gear.
        motions: coordinates that the element acts on or reads.
        time: s.
        given: forces of laws that use a model of the mechanism, N or N m, by coordinate.
    """
    if isinstance(element, JointSpring):
        x, rate = motions[element.key]
        pull = element.stiffness * (element.rest - x)
        return SwitchedLoad([pull - element.damping * rate], [pull], 0.5 * pull * (element.rest - x))
    if isinstance(element, HeldLaw):
        return SwitchedLoad([element.held], [0.0], 0.0)
    if isinstance(element, DeclaredLaw):
        force, references = float(element.feedforward_at(time)), element.references(time)
        for key, (k_p, k_d) in element.feedback.items():
            x, rate = motions[key]
            force += k_p * (references[key].value - x) + k_d * (references[key].rate - rate)
        return SwitchedLoad([force + given[element.key] if element.uses_model else force], [0.0], 0.0)
    if isinstance(element, JointFriction | JointStop | ElasticGear):
        x_and_rates = zip(*(motions[key] for key in element.keys), strict=True)
        return switched_load(element, *x_and_rates)
    assert_never(element)


class BodyLoads(NamedTuple):
    """Forces on bodies at one state: springs of points and balls, wrenches and wind.

    Attributes:
        wrenches: (b, 6) forces and torques about the centers of mass, N and N m, world frame.
        power: W, of the forces without potential energy.
        energy: J, potential energy of the springs.
    """

    wrenches: Array
    power: float
    energy: float


def body_loads(scene: Scene, state: State, time: float, native: Sequence[object] = ()) -> BodyLoads:
    """Compute the forces on bodies at a state and a time, s.

    Args:
        scene: the scene.
        state: poses and velocities of the bodies.
        time: s.
        native: forces that Exudyn computes; `wrenches` is without them.
    """
    forces = [_at_time(force, time) for force in scene.body_forces]
    rates = np.hstack([state.linear_velocity, state.angular_velocity])
    wrenches, power, energy = np.zeros(rates.shape), 0.0, 0.0
    for force, given in zip(forces, scene.body_forces, strict=True):
        wrench = _wrenches(scene, state, force)
        power += float(np.sum(wrench * rates))
        if not any(given is each for each in native):
            wrenches += wrench
        if isinstance(force, PointSpring | BallSpring) and force.stiffness:
            # the force of an undamped spring is its stiffness times its deflection
            elastic = _wrenches(scene, state, altered(force, damping=0.0))
            power -= float(np.sum(elastic * rates))
            pull = elastic[_second_body(scene.mechanism, force)]
            part = pull[:3] if isinstance(force, PointSpring) else pull[3:]
            energy += 0.5 * float(part @ part) / force.stiffness
    return BodyLoads(wrenches, power, energy)


def _at_time(force: object, time: float) -> object:
    """Return a wind load with its speeds at a time, s; any other force unchanged."""
    if not isinstance(force, WindLoad):
        return force
    functions: dict[str, Any] = {
        name: float(getattr(force, name).value(time))
        for name in ("speed", "vertical_speed")
        if isinstance(getattr(force, name), TimeFunction)
    }
    return replace(force, **functions) if functions else force


def _wrenches(scene: Scene, state: State, force: object) -> Array:
    """Return the wrenches (b, 6) of one force on all bodies."""
    wrenches = Wrenches(scene.mechanism, state)
    wrenches.add_forces(altered(scene, control=(), forces=(force,)))
    return wrenches.total


def loaded_bodies(mechanism: Mechanism, force: Force) -> set[int]:
    """Return the numbers of the bodies on which a force of `Scene.body_forces` acts."""
    if isinstance(force, BallSpring):
        equations = mechanism.joint_equations(force.joint)
        return {equations.first, equations.second}
    if isinstance(force, PointSpring):
        return {mechanism.body_index(name) for name in (force.first, force.second)}
    if isinstance(force, Wrench | WindLoad):
        return {mechanism.body_index(force.body)}
    raise TypeError(f"{force!r} acts on no bodies")


def _second_body(mechanism: Mechanism, spring: PointSpring | BallSpring) -> int:
    """Return the number of the second body of a spring."""
    if isinstance(spring, PointSpring):
        return mechanism.body_index(spring.second)
    return mechanism.joint_equations(spring.joint).second


def motions_of(scene: Scene, state: State) -> Motions:
    """Return the joint coordinates that forces act on or that laws read, and their rates, by key."""
    frames, found = state.frames(), dict[Key, tuple[float, float]]()
    for key in dict.fromkeys((*scene.loaded_coordinates, *scene.sensed)):
        x, rate = scene.mechanism.measure(key, frames)
        found[key] = float(x + state.revolutions(key, x)), float(rate)
    return found


class AppliedForces(NamedTuple):
    """Forces on bodies at one state that Exudyn does not compute, and what all forces of a scene do.

    Attributes:
        on_bodies: (b, 6) forces and torques about the centers of mass, N and N m, world frame.
        control: (a,) forces of the control laws, N or N m.
        power: W, of all forces without potential energy.
        energy: J, of all springs.
    """

    on_bodies: Array
    control: Array
    power: float
    energy: float


def applied_forces(scene: Scene, state: State, time: float, native: Sequence[object]) -> AppliedForces:
    """Compute the applied forces of a scene at a state and a time, s.

    Args:
        scene: the scene.
        state: poses and velocities of the bodies, with full revolutions of the hinge angles.
        time: s.
        native: forces on bodies that Exudyn computes.
    """
    on_bodies, power, energy = body_loads(scene, state, time, native)
    motions, control = motions_of(scene, state), list[float]()
    elements = coordinate_elements(scene)
    for place, element in enumerate(elements):
        load = coordinate_load(element, motions, time, {})
        energy += load.energy
        for key, force, elastic in zip(element.keys, load.forces, load.elastic, strict=True):
            power += (force - elastic) * motions[key][1]
        if place < len(scene.control):
            control += load.forces
    return AppliedForces(on_bodies, np.array(control), power, energy)
